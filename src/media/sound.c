/* SPDX-License-Identifier: MIT
 * Sound files: read whole through FFmpeg, written as WAV. */
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "ernerf/media.h"
#include "io/file.h"
#include "media/sound_decoder.h"

enum { WAV_HEADER_BYTES = 44, WRITE_CHUNK_SAMPLES = 8192 };

/* Samples of all channels together, 4 GiB: a small file may decode to any length. */
static const size_t max_samples = (size_t)1 << 31;

/* A growing buffer for a sound of unknown length. */
struct growing {
  ern_sound sound;
  size_t capacity; /* frames */
};

/* Reserves space for `more` frames after the present ones. */
static ern_status reserve(ern_context *context, const char *path, struct growing *growing, size_t more) {
  ern_sound *sound = &growing->sound;
  const size_t channels = (size_t)sound->channels, most = max_samples / channels;
  if (more > most || sound->frames > most - more) {
    return ern_fail(context, ERN_E_SHAPE, "%s: sound is longer than %zu samples, the most that is read", path, most);
  }
  const size_t needed = sound->frames + more;
  if (needed <= growing->capacity && sound->data != NULL) return ERN_OK;
  size_t capacity = growing->capacity * 2 > needed ? growing->capacity * 2 : needed;
  if (capacity > most) capacity = most;
  int16_t *larger = NULL;
  const ern_status status = ERN_NEW(context, capacity * channels, &larger);
  if (status != ERN_OK) return status;
  if (sound->frames > 0) memcpy(larger, sound->data, sound->frames * channels * sizeof *sound->data);
  ern_release(context, sound->data);
  sound->data = larger;
  growing->capacity = capacity;
  return ERN_OK;
}

static ern_status append(ern_context *context, struct ern_sound_decoder *decoder, struct growing *growing) {
  ern_sound *sound = &growing->sound;
  ern_status status = ERN_OK;
  sound->channels = decoder->channels;
  ERN_TRY(reserve(context, decoder->decoder.path, growing, decoder->silence));
  sound->frames += decoder->silence; /* the memory is zeroed */
  ERN_TRY(reserve(context, decoder->decoder.path, growing, decoder->frames));
  ERN_TRY(ern_sound_decoder_take(decoder, sound->data + sound->frames * (size_t)sound->channels));
  sound->frames += decoder->frames;
fail:
  return status;
}

ern_status ern_sound_read(ern_context *context, const char *path, ern_sound *sound) {
  ERN_PLAIN_FLOATS;
  if (sound != NULL) *sound = (ern_sound){0};
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, sound);
  ern_status status = ERN_OK;
  struct ern_sound_decoder decoder = {0};
  struct growing growing = {0};
  bool end = false;
  ERN_TRY(ern_sound_decoder_open(context, path, AV_SAMPLE_FMT_S16, &decoder));
  for (;;) {
    ERN_TRY(ern_sound_decoder_next(&decoder, &end));
    if (end) break;
    ERN_TRY(append(context, &decoder, &growing));
  }
  growing.sound.rate = decoder.rate;
  growing.sound.channels = decoder.channels;
  ERN_TRY(reserve(context, path, &growing, 0)); /* where there are no samples: data is still allocated */
  growing.sound.frames -= decoder.surplus;
  *sound = growing.sound;
  growing.sound.data = NULL;
fail:
  ern_release(context, growing.sound.data);
  ern_sound_decoder_close(&decoder);
  return status;
}

static void put_little_endian(uint8_t *to, int bytes, uint32_t value) {
  for (int i = 0; i < bytes; i++) to[i] = (uint8_t)(value >> (8 * i));
}

/* Writes the RIFF header, "fmt " (16-bit PCM) and the header of "data". */
static void make_header(uint8_t header[WAV_HEADER_BYTES], const ern_sound *sound, uint32_t data_bytes) {
  const uint32_t frame_bytes = (uint32_t)sound->channels * 2, rate = (uint32_t)sound->rate;
  memcpy(header, "RIFF    WAVEfmt ", 16);
  put_little_endian(header + 4, 4, WAV_HEADER_BYTES - 8 + data_bytes);
  put_little_endian(header + 16, 4, 16);
  put_little_endian(header + 20, 2, 1);
  put_little_endian(header + 22, 2, (uint32_t)sound->channels);
  put_little_endian(header + 24, 4, rate);
  put_little_endian(header + 28, 4, rate * frame_bytes);
  put_little_endian(header + 32, 2, frame_bytes);
  put_little_endian(header + 34, 2, 16);
  memcpy(header + 36, "data", 4);
  put_little_endian(header + 40, 4, data_bytes);
}

ern_status ern_sound_write_wav(ern_context *context, const char *path, const ern_sound *sound) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, sound);
  if (sound->frames > 0) ERN_NEED(context, sound->data);
  ern_status status = ERN_OK;
  struct ern_file_writer writer = {0};
  uint8_t header[WAV_HEADER_BYTES], chunk[2 * WRITE_CHUNK_SAMPLES];
  ERN_TRY(ern_sound_check_form(context, path, sound->rate, sound->channels));
  const size_t frame_bytes = (size_t)sound->channels * 2, most = (UINT32_MAX - WAV_HEADER_BYTES) / frame_bytes;
  if (sound->frames > most) {
    ERN_TRY(ern_fail(context, ERN_E_SHAPE, "%s: sound has %zu samples a channel, a WAV file holds at most %zu", path,
                     sound->frames, most));
  }
  const size_t samples = sound->frames * (size_t)sound->channels;
  make_header(header, sound, (uint32_t)(2 * samples));
  ERN_TRY(ern_file_writer_open(context, path, ERN_EXISTING_BY_CONTEXT, &writer));
  ERN_TRY(ern_file_writer_write(&writer, header, sizeof header));
  for (size_t done = 0; done < samples;) {
    const size_t count = samples - done < WRITE_CHUNK_SAMPLES ? samples - done : WRITE_CHUNK_SAMPLES;
    for (size_t i = 0; i < count; i++) put_little_endian(chunk + 2 * i, 2, (uint16_t)sound->data[done + i]);
    ERN_TRY(ern_file_writer_write(&writer, chunk, 2 * count));
    done += count;
  }
  return ern_file_writer_commit(&writer);
fail:
  ern_file_writer_abandon(&writer);
  return status;
}

void ern_sound_free(ern_context *context, ern_sound *sound) {
  if (context == NULL || sound == NULL) return;
  ern_release(context, sound->data);
  *sound = (ern_sound){0};
}
