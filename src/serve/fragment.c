/* SPDX-License-Identifier: MIT */
#include "serve/fragment.h"

#include <string.h>

enum { HEADER = 8 /* bytes of size and kind of a box */ };

struct bytes {
  const uint8_t *at, *end;
};

static size_t left(const struct bytes *b) { return (size_t)(b->end - b->at); }

static uint32_t read_32(const uint8_t *at) {
  return (uint32_t)at[0] << 24 | (uint32_t)at[1] << 16 | (uint32_t)at[2] << 8 | at[3];
}

/* The content of the first box of that kind. */
static bool find(struct bytes in, const char kind[4], struct bytes *content) {
  while (left(&in) >= HEADER) {
    const size_t size = read_32(in.at);
    if (size < HEADER || size > left(&in)) return false;
    *content = (struct bytes){in.at + HEADER, in.at + size};
    if (memcmp(in.at + 4, kind, 4) == 0) return true;
    in.at += size;
  }
  return false;
}

/* The next number of 32 bits. */
static bool take(struct bytes *from, uint32_t *value) {
  if (left(from) < 4) return false;
  *value = read_32(from->at);
  from->at += 4;
  return true;
}

static bool pass(struct bytes *from, size_t count) {
  if (left(from) < count) return false;
  from->at += count;
  return true;
}

bool fragment_avcc(const uint8_t *head, size_t count, const uint8_t **avcc, size_t *bytes) {
  /* Boxes of the path down to it: behind stsd and avc1 stand fields of their own, so the kind is looked for. */
  for (size_t at = 4; at + 4 <= count; at++) {
    if (memcmp(head + at, "avcC", 4) != 0) continue;
    const size_t size = read_32(head + at - 4);
    if (size < HEADER || size > count - (at - 4)) return false;
    *avcc = head + at + 4;
    *bytes = size - HEADER;
    return true;
  }
  return false;
}

/* tfhd: where it has the size of a sample of the track. */
static bool read_usual_size(struct bytes tfhd, uint32_t *size) {
  uint32_t flags = 0, track = 0;
  if (!take(&tfhd, &flags) || !take(&tfhd, &track)) return false;
  const size_t before = (flags & 1 ? 8U : 0) + (flags & 2 ? 4U : 0) + (flags & 8 ? 4U : 0);
  return !(flags & 0x10) || (pass(&tfhd, before) && take(&tfhd, size));
}

/* trun: where the one sample of the track is, from the beginning of moof, and its size. */
static bool read_run(struct bytes trun, uint32_t *offset, uint32_t *size) {
  uint32_t flags = 0, samples = 0;
  if (!take(&trun, &flags) || !take(&trun, &samples) || samples != 1) return false;
  if (!(flags & 1) || !take(&trun, offset)) return false;
  if (!pass(&trun, (flags & 4 ? 4U : 0) + (flags & 0x100 ? 4U : 0))) return false;
  return !(flags & 0x200) || take(&trun, size);
}

bool fragment_picture(const uint8_t *part, size_t count, const uint8_t **unit, size_t *bytes) {
  const struct bytes whole = {part, part + count};
  struct bytes moof, traf, tfhd, trun;
  uint32_t offset = 0, size = 0;
  if (!find(whole, "moof", &moof) || !find(moof, "traf", &traf)) return false;
  if (!find(traf, "tfhd", &tfhd) || !read_usual_size(tfhd, &size)) return false;
  if (!find(traf, "trun", &trun) || !read_run(trun, &offset, &size)) return false;
  const uint8_t *base = moof.at - HEADER; /* default-base-is-moof */
  if (size == 0 || offset > (size_t)(whole.end - base) || size > (size_t)(whole.end - base) - offset) return false;
  *unit = base + offset;
  *bytes = size;
  return true;
}
