/* SPDX-License-Identifier: MIT
 * The sound of a file, decoded piece by piece into interleaved samples of one format, at its own rate and channels. */
#ifndef ERN_MEDIA_SOUND_DECODER_H
#define ERN_MEDIA_SOUND_DECODER_H

#include <libswresample/swresample.h>

#include "media/ffmpeg.h"

struct ern_sound_decoder {
  struct ern_decoder decoder;
  enum AVSampleFormat format; /* wanted: interleaved */
  SwrContext *convert;        /* NULL before the first piece */
  enum AVSampleFormat from;   /* the sample format that the decoder returns now */
  int rate, channels;         /* of the first piece, or of the header where the file ends before one */
  size_t silence; /* silent frames to insert before the last decoded piece, where the file starts late or has a gap */
  size_t skip;    /* frames at the start of that piece that overlap the piece before it */
  size_t frames;  /* of that piece, without `skip` */
  size_t surplus; /* the last of `frames`: padding, if the piece is the file's last */
  double begin;   /* s: the file's time of frame 0 */
  bool has_begin;
  uint64_t position; /* frames so far, with silence */
  int reported;      /* warnings logged about irregular timestamps */
  AVFrame *ahead;    /* the piece after the last one, where its timestamp was needed */
  bool has_ahead, ends_ahead;
};

/* 1 to 384000 samples a second and 1 to 8 channels, else ERN_E_SHAPE. */
ERN_NODISCARD ern_status ern_sound_check_form(ern_context *context, const char *path, int rate, int channels);

ERN_NODISCARD ern_status ern_sound_decoder_open(ern_context *context, const char *path, enum AVSampleFormat format,
                                                struct ern_sound_decoder *sound);
/* Decodes the next piece; *end is set where there is none. ERN_E_UNSUPPORTED where rate or channels change. */
ERN_NODISCARD ern_status ern_sound_decoder_next(struct ern_sound_decoder *sound, bool *end);
/* Converts the last decoded piece into samples[frames][channels] of `format`. Call it once for each piece. */
ERN_NODISCARD ern_status ern_sound_decoder_take(struct ern_sound_decoder *sound, void *samples);
void ern_sound_decoder_close(struct ern_sound_decoder *sound); /* accepts a zeroed one */

/* Receives a part of a sound: samples[frames][channels], full scale is 1. */
typedef ern_status ern_sound_taker(void *user, int rate, int channels, const float *samples, size_t frames);
/* Passes the whole sound of a file to `take` part by part, without the padding of its last piece. ERN_E_SHAPE where
 * there are no samples, or more than 4 hours. */
ERN_NODISCARD ern_status ern_sound_decode(ern_context *context, const char *path, ern_sound_taker *take, void *user);

#endif
