/* SPDX-License-Identifier: MIT
 * The sound of a video being written: encoded as the pictures arrive; that of a file is cut where they end. */
#ifndef ERN_MEDIA_VIDEO_SOUND_H
#define ERN_MEDIA_VIDEO_SOUND_H

#include <libavutil/audio_fifo.h>
#include <libswresample/swresample.h>

#include "ernerf/media.h"
#include "media/ffmpeg.h"

struct ern_sound_track {
  const ern_sound *sound; /* NULL: silent, and all the rest is zero; or samples are handed over */
  size_t first, at;       /* frame of `sound` that the first picture begins with; the one to be taken next */
  int channels;
  AVCodecContext *codec;
  AVStream *stream;
  SwrContext *convert; /* to the rate and sample format of the codec */
  AVAudioFifo *waiting;
  AVFrame *frame;
  int64_t encoded; /* samples at the codec's rate */
};

/* ERN_E_ARGUMENT where a caller's sound (NULL: none) or the second in it at which to begin is out of its range. */
ERN_NODISCARD ern_status ern_sound_track_check(ern_context *context, const char *path, const ern_sound *sound,
                                               double start);
/* Adds a stream to the muxer's container, whose header is not written yet. Where nothing of the sound is left at
 * `start` seconds, the track is silent and no stream is added. */
ERN_NODISCARD ern_status ern_sound_track_open(struct ern_muxer *muxer, const ern_sound *sound, double start,
                                              enum AVCodecID id, struct ern_sound_track *track);
/* Encodes what belongs to the first `pictures` pictures of `rate` a second; with `last` exactly that, else as much of
 * it as fills whole packets. Calls have growing `pictures`. */
ERN_NODISCARD ern_status ern_sound_track_advance(struct ern_muxer *muxer, struct ern_sound_track *track,
                                                 int64_t pictures, AVRational rate, bool last);

/* The same for samples that are handed over, coded by `id` (AAC, or 16-bit samples as they are). */
ERN_NODISCARD ern_status ern_sound_track_open_live(struct ern_muxer *muxer, int rate, int channels, enum AVCodecID id,
                                                   struct ern_sound_track *track);
/* samples: [frames][channels], full scale is 1; NULL: the sound ends. */
ERN_NODISCARD ern_status ern_sound_track_add(struct ern_muxer *muxer, struct ern_sound_track *track,
                                             const float *samples, size_t frames);
void ern_sound_track_close(struct ern_sound_track *track); /* accepts a zeroed one */

#endif
