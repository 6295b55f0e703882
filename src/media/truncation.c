/* SPDX-License-Identifier: MIT */
#include "media/truncation.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "core/memory.h"

/* Tolerance in seconds: headers round lengths, and encoders pad the last packet. */
#define SHORTER 1.0

static uint32_t little(const uint8_t *at) {
  return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

/* Whether it is a WAV file: the size of its "data" chunk, at whose bytes `file` then is, and that of the file, both by
 * its headers. */
static bool find_data(FILE *file, uint32_t *claimed, uint64_t *declared) {
  uint8_t head[12] = {0};
  bool read = fread(head, 1, 12, file) == 12 && memcmp(head, "RIFF", 4) == 0 && memcmp(head + 8, "WAVE", 4) == 0;
  *declared = (uint64_t)little(head + 4) + 8;
  while (read && fread(head, 1, 8, file) == 8) {
    *claimed = little(head + 4);
    if (memcmp(head, "data", 4) == 0) return true;
    read = fseeko(file, (off_t)*claimed + (*claimed & 1), SEEK_CUR) == 0;
  }
  return false;
}

/* The size of the "data" chunk of a WAV file by its header, and the bytes that exist; *whole: the file is as long as
 * its RIFF header states. Returns false where it is not a WAV file. */
static bool wav_data(const char *path, uint32_t *claimed, uint64_t *there, bool *whole) {
  uint64_t declared = 0;
  FILE *file = fopen(path, "rb");
  if (file == NULL) return false;
  bool found = find_data(file, claimed, &declared);
  const off_t begin = ftello(file);
  found = found && fseeko(file, 0, SEEK_END) == 0 && begin >= 0 && ftello(file) >= begin;
  if (found) {
    *there = (uint64_t)(ftello(file) - begin);
    *whole = (uint64_t)ftello(file) == declared;
  }
  fclose(file);
  return found;
}

/* Sizes that programs give which write into a pipe: */
static bool is_open(uint32_t claimed) {
  static const uint32_t sizes[] = {0, UINT32_MAX,                     /* FFmpeg */
                                   0x7ffff000,                        /* espeak-ng */
                                   0x7fffff00, UINT32_C(0x80000000)}; /* arecord */
  for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++)
    if (claimed == sizes[i]) return true;
  return false;
}

bool ern_truncation_is_wav(const void *head, size_t bytes, bool *open_ended) {
  uint8_t copy[ERN_TRUNCATION_HEAD];
  uint32_t claimed = 0;
  uint64_t declared = 0;
  *open_ended = false;
  if (bytes == 0 || bytes > sizeof copy) return false;
  memcpy(copy, head, bytes);
  FILE *file = fmemopen(copy, bytes, "rb");
  if (file == NULL) return false;
  const bool found = find_data(file, &claimed, &declared);
  fclose(file);
  *open_ended = found && is_open(claimed);
  return found;
}

ern_status ern_truncation_check_packet(ern_context *context, const char *path, const char *format) {
  uint32_t claimed = 0;
  uint64_t there = 0;
  bool whole = false;
  if (strcmp(format, "wav") != 0 || !wav_data(path, &claimed, &there, &whole))
    return ern_fail(context, ERN_E_FORMAT, "%s: is damaged or cut short", path);
  if (claimed == 0 && whole)
    return ern_fail(context, ERN_E_SHAPE, "%s: has no sound, 0 samples, and other chunks after it", path);
  if (is_open(claimed)) return ERN_OK;
  return ern_fail(context, ERN_E_FORMAT,
                  "%s: is damaged or cut short: its chunk \"data\" has %" PRIu64 " bytes, expected %" PRIu32
                  " as it says",
                  path, there, claimed);
}

/* ---- Ogg: RFC 3533, section 6 ------------------------------------------------------------------------------------ */

enum {
  PAGE_HEAD = 27,
  MOST_PAGE = PAGE_HEAD + 255 + 255 * 255, /* header, lengths of segments, segments */
  IS_LAST = 4                              /* header flag: the page ends a stream */
};

enum ogg_end { OGG_ENDS, OGG_GOES_ON, OGG_CUT };

/* Whether the last page in the last bytes of an Ogg file ends the stream. */
static enum ogg_end end_of_pages(const uint8_t *tail, size_t bytes) {
  for (size_t at = bytes; at-- > 0;) {
    if (bytes - at < 4 || memcmp(tail + at, "OggS", 4) != 0) continue;
    const uint8_t *page = tail + at;
    const size_t left = bytes - at;
    if (left < PAGE_HEAD || left < PAGE_HEAD + (size_t)page[26]) return OGG_CUT;
    size_t size = PAGE_HEAD + (size_t)page[26];
    for (size_t k = 0; k < page[26]; k++) size += page[PAGE_HEAD + k];
    return left < size ? OGG_CUT : (page[5] & IS_LAST) != 0 ? OGG_ENDS : OGG_GOES_ON;
  }
  return OGG_CUT;
}

static ern_status check_ogg(ern_context *context, const char *path) {
  ern_status status = ERN_OK;
  uint8_t *tail = NULL;
  enum ogg_end found = OGG_CUT;
  FILE *file = fopen(path, "rb");
  if (file == NULL) return ERN_OK; /* the file was read to its end, and deleted since */
  ERN_TRY(ERN_NEW(context, MOST_PAGE, &tail));
  if (fseeko(file, 0, SEEK_END) == 0) {
    const off_t length = ftello(file), begin = length > MOST_PAGE ? length - MOST_PAGE : 0;
    if (fseeko(file, begin, SEEK_SET) == 0) found = end_of_pages(tail, fread(tail, 1, MOST_PAGE, file));
  }
  if (found == OGG_CUT)
    ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: is damaged or cut short: its last page is not whole", path));
  if (found == OGG_GOES_ON)
    ern_log(context, ERN_LOG_WARNING,
            "%s: may be cut short: its last page does not say that it is the last, as when a recording was broken off",
            path);
fail:
  ern_release(context, tail);
  fclose(file);
  return status;
}

void ern_truncation_warn_end(ern_context *context, const char *path, const char *stream, double seconds,
                             double expected) {
  if (seconds + SHORTER < expected)
    ern_log(context, ERN_LOG_WARNING,
            "%s: may be cut short: its %s ends at %.2f s of the %.2f s that its header promises", path, stream, seconds,
            expected);
}

ern_status ern_truncation_check_end(ern_context *context, const char *path, const char *format, double seconds,
                                    double expected) {
  if (seconds + SHORTER < expected)
    return ern_fail(context, ERN_E_FORMAT,
                    "%s: is damaged or cut short: it ends after %.2f s, expected %.2f s as its header says", path,
                    seconds, expected);
  return strcmp(format, "ogg") == 0 ? check_ogg(context, path) : ERN_OK;
}
