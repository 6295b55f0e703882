/* SPDX-License-Identifier: MIT
 * The sound stream of a video that is being written. It is encoded as the pictures arrive; a file's sound is cut where
 * the pictures end. */
#ifndef ERN_MEDIA_VIDEO_SOUND_H
#define ERN_MEDIA_VIDEO_SOUND_H

#include <libavutil/audio_fifo.h>
#include <libswresample/swresample.h>

#include "ernerf/media.h"
#include "media/ffmpeg.h"

struct ern_sound_track {
  const ern_sound *sound; /* NULL: no sound and all other members are zero, or a live track */
  size_t first, at;       /* frames of `sound`: that of the first picture's start; the next to encode */
  int channels;
  AVCodecContext *codec;
  AVStream *stream;
  SwrContext *convert; /* to the rate and sample format of the codec */
  AVAudioFifo *waiting;
  AVFrame *frame;
  int64_t encoded; /* samples at the codec's rate */
};

/* ERN_E_ARGUMENT where a caller's sound (NULL: none), or `start`, the second of it to begin at, is out of range. */
ERN_NODISCARD ern_status ern_sound_track_check(ern_context *context, const char *path, const ern_sound *sound,
                                               double start);
/* Adds a stream to the muxer's container, whose header is not written yet. Where nothing of the sound is left at
 * `start` seconds, the track is silent and no stream is added. */
ERN_NODISCARD ern_status ern_sound_track_open(struct ern_muxer *muxer, const ern_sound *sound, double start,
                                              enum AVCodecID id, struct ern_sound_track *track);
/* Encodes the sound of the first `pictures` pictures, `rate` a second: with `last` all of it, else only whole packets.
 * `pictures` grows from call to call. */
ERN_NODISCARD ern_status ern_sound_track_advance(struct ern_muxer *muxer, struct ern_sound_track *track,
                                                 int64_t pictures, AVRational rate, bool last);

/* Opens a track whose samples the caller passes to ern_sound_track_add. id: AAC, or 16-bit PCM. */
ERN_NODISCARD ern_status ern_sound_track_open_live(struct ern_muxer *muxer, int rate, int channels, enum AVCodecID id,
                                                   struct ern_sound_track *track);
/* samples: [frames][channels], clipped to full scale, -1..1; NULL: the sound ends. */
ERN_NODISCARD ern_status ern_sound_track_add(struct ern_muxer *muxer, struct ern_sound_track *track,
                                             const float *samples, size_t frames);
void ern_sound_track_close(struct ern_sound_track *track); /* accepts a zeroed one */

#endif
