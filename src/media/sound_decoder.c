/* SPDX-License-Identifier: MIT
 * The sound of a file, decoded piece by piece. */
#include "media/sound_decoder.h"

#include <libavutil/channel_layout.h>
#include <math.h>

#include "core/memory.h"
#include "media/truncation.h"

enum {
  MAX_RATE = 384000,
  MAX_CHANNELS = 8,
  MAX_SILENCE = 3600 /* s */,
  MOST_SOUND_HOURS = 4,
  SILENCE_BLOCK = 4096,
  MOST_REPORTED = 10 /* log messages */
};

/* Seconds. A timestamp error below TOLERATED is ignored: containers round times, and an offset of one picture at 25 a
 * second is not visible. A piece that begins BEGINS_ANEW or more before the end of the last one starts a new time line.
 */
#define TOLERATED 0.04
#define BEGINS_ANEW 1.0

ern_status ern_sound_check_form(ern_context *context, const char *path, int rate, int channels) {
  if (rate < 1 || rate > MAX_RATE || channels < 1 || channels > MAX_CHANNELS)
    return ern_fail(context, ERN_E_SHAPE,
                    "%s: sound has %d samples a second and %d channels, expected 1 to %d and 1 to %d", path, rate,
                    channels, MAX_RATE, MAX_CHANNELS);
  return ERN_OK;
}

ern_status ern_sound_decoder_open(ern_context *context, const char *path, enum AVSampleFormat format,
                                  struct ern_sound_decoder *sound) {
  *sound = (struct ern_sound_decoder){.format = format};
  return ern_decoder_open(context, path, AVMEDIA_TYPE_AUDIO, 1, &sound->decoder);
}

static ern_status take_form(struct ern_sound_decoder *sound, int rate, int channels) {
  sound->rate = rate;
  sound->channels = channels;
  return ern_sound_check_form(sound->decoder.context, sound->decoder.path, rate, channels);
}

/* Aligns the sound's start with the pictures': a later start gives silence, of an earlier one a part is skipped. The
 * first decoded piece has the start time, as a decoder returns nothing for the track's first packets. A file without
 * pictures starts with its first piece. */
static ern_status find_silence(struct ern_sound_decoder *sound) {
  const AVFormatContext *container = sound->decoder.container;
  const AVStream *stream = sound->decoder.stream;
  int64_t stamp = sound->decoder.frame->best_effort_timestamp;
  if (stamp == AV_NOPTS_VALUE) stamp = stream->start_time;
  if (container->nb_streams == 1 || container->start_time == AV_NOPTS_VALUE || stamp == AV_NOPTS_VALUE) return ERN_OK;
  const double late = (double)stamp * av_q2d(stream->time_base) - (double)container->start_time / AV_TIME_BASE;
  if (late > MAX_SILENCE)
    return ern_fail(sound->decoder.context, ERN_E_UNSUPPORTED, "%s: its sound begins at %.0f s, expected %d s at most",
                    sound->decoder.path, late, MAX_SILENCE);
  if (late > 0) sound->silence = (size_t)(late * sound->rate + 0.5);
  if (late < 0 && late > -BEGINS_ANEW) sound->skip = (size_t)(-late * sound->rate + 0.5);
  return ERN_OK;
}

/* Logs an irregular timestamp, at most MOST_REPORTED times a file. */
static void log_times(struct ern_sound_decoder *sound, const char *what, double from, double to) {
  if (sound->reported == MOST_REPORTED) return;
  sound->reported++;
  ern_log(sound->decoder.context, ERN_LOG_WARNING, "%s: at %.3f s %s %.3f s%s", sound->decoder.path, from, what, to,
          sound->reported == MOST_REPORTED ? "; further places are not reported" : "");
}

static void exchange_frames(struct ern_sound_decoder *sound) {
  AVFrame *frame = sound->decoder.frame;
  sound->decoder.frame = sound->ahead;
  sound->ahead = frame;
}

/* *fits: whether the piece after the present one begins at `end` seconds, where the present one would end if it were
 * contiguous. Then only the present timestamp is wrong. */
static ern_status look_ahead(struct ern_sound_decoder *sound, double end, bool *fits) {
  struct ern_decoder *decoder = &sound->decoder;
  const double length = (double)decoder->frame->nb_samples / sound->rate;
  if (sound->ahead == NULL) sound->ahead = av_frame_alloc();
  if (sound->ahead == NULL) return ern_fail(decoder->context, ERN_E_NO_MEMORY, "%s: no memory", decoder->path);
  exchange_frames(sound);
  const ern_status status = ern_decoder_next(decoder, &sound->ends_ahead);
  const int64_t stamp = decoder->frame->best_effort_timestamp;
  exchange_frames(sound);
  sound->has_ahead = true;
  *fits = status == ERN_OK && !sound->ends_ahead && stamp != AV_NOPTS_VALUE &&
          fabs((double)stamp * av_q2d(decoder->stream->time_base) - end - length) <= TOLERATED;
  return status;
}

static ern_status next_piece(struct ern_sound_decoder *sound, bool *end) {
  if (!sound->has_ahead) return ern_decoder_next(&sound->decoder, end);
  exchange_frames(sound);
  sound->has_ahead = false;
  *end = sound->ends_ahead;
  return ERN_OK;
}

/* Handles a present piece that begins after a gap in the track, or before the end of the last piece. */
static ern_status find_place(struct ern_sound_decoder *sound) {
  const struct ern_decoder *decoder = &sound->decoder;
  const int64_t stamp = decoder->frame->best_effort_timestamp;
  bool fits = false;
  if (stamp == AV_NOPTS_VALUE) return ERN_OK;
  const double at = (double)stamp * av_q2d(decoder->stream->time_base);
  if (!sound->has_begin) {
    sound->begin = at + ((double)sound->skip - (double)sound->silence) / sound->rate;
    sound->has_begin = true;
    return ERN_OK;
  }
  const double end = sound->begin + (double)sound->position / sound->rate, late = at - end;
  if (fabs(late) <= TOLERATED) return ERN_OK;
  const ern_status status = look_ahead(sound, end, &fits);
  if (status != ERN_OK) return status;
  if (fits) {
    log_times(sound, "one piece of its sound is kept in its place, though its time stamp is", end, at);
  } else if (late > MAX_SILENCE) {
    return ern_fail(decoder->context, ERN_E_UNSUPPORTED,
                    "%s: its sound has a gap from %.3f s to %.3f s, expected %d s at most", decoder->path, end, at,
                    MAX_SILENCE);
  } else if (late > 0) {
    log_times(sound, "a gap of its sound becomes silence, up to", end, at);
    sound->silence = (size_t)(late * sound->rate + 0.5);
  } else if (late < -BEGINS_ANEW) {
    log_times(sound, "its sound is continued, though its time stamps go back to", end, at);
    sound->begin = at - (double)sound->position / sound->rate;
  } else {
    log_times(sound, "the repeated part of its sound is left out, as its time stamps go back to", end, at);
    sound->skip = (size_t)(-late * sound->rate + 0.5);
  }
  return ERN_OK;
}

/* Makes the converter from the present frame's format. */
static ern_status make_converter(struct ern_sound_decoder *sound) {
  AVChannelLayout layout = {0};
  sound->from = (enum AVSampleFormat)sound->decoder.frame->format;
  swr_free(&sound->convert);
  av_channel_layout_default(&layout, sound->channels); /* the same on both sides: no mixing */
  int error = swr_alloc_set_opts2(&sound->convert, &layout, sound->format, sound->rate, &layout, sound->from,
                                  sound->rate, 0, NULL);
  if (error >= 0) error = swr_init(sound->convert);
  av_channel_layout_uninit(&layout);
  return error >= 0
             ? ERN_OK
             : ern_av_fail(sound->decoder.context, ERN_E_MEDIA, sound->decoder.path, "convert its samples", error);
}

/* An encoder pads its last packet; a container whose time base is the sample states how many samples are valid. */
static size_t surplus_of(const struct ern_decoder *decoder) {
  const AVFrame *frame = decoder->frame;
  const AVRational unit = decoder->stream->time_base;
  const bool counts_samples = unit.num == 1 && unit.den == frame->sample_rate;
  if (!counts_samples || frame->pkt_duration <= 0 || frame->pkt_duration >= frame->nb_samples) return 0;
  return (size_t)(frame->nb_samples - frame->pkt_duration);
}

/* Its edit list may leave out any part of a track: a shorter one is no error. */
static bool has_edits(const struct ern_decoder *decoder) {
  return strstr(decoder->container->iformat->name, "mp4") != NULL;
}

/* The duration in seconds by the header; 0: it has none, or FFmpeg guessed it from the bit rate. */
static double length_by_header(const struct ern_decoder *decoder) {
  const AVFormatContext *container = decoder->container;
  if (container->duration_estimation_method == AVFMT_DURATION_FROM_BITRATE) return 0;
  if (decoder->stream->duration > 0) return (double)decoder->stream->duration * av_q2d(decoder->stream->time_base);
  /* the container's duration is that of its only stream */
  return container->nb_streams == 1 && container->duration > 0 ? (double)container->duration / AV_TIME_BASE : 0;
}

static ern_status take_next(struct ern_sound_decoder *sound, bool *end) {
  struct ern_decoder *decoder = &sound->decoder;
  const AVCodecContext *codec = decoder->codec;
  ern_status status = next_piece(sound, end);
  sound->silence = sound->skip = 0;
  if (status != ERN_OK) return status;
  if (*end && sound->convert == NULL) status = take_form(sound, codec->sample_rate, codec->ch_layout.nb_channels);
  const double length = *end && status == ERN_OK ? (double)sound->position / sound->rate : 0;
  if (*end && status == ERN_OK && has_edits(decoder))
    ern_truncation_warn_end(decoder->context, decoder->path, "sound", length, length_by_header(decoder));
  else if (*end && status == ERN_OK)
    status = ern_truncation_check_end(decoder->context, decoder->path, decoder->container->iformat->name, length,
                                      length_by_header(decoder));
  if (*end) return status;
  const AVFrame *frame = decoder->frame;
  if (sound->convert == NULL) {
    status = take_form(sound, frame->sample_rate, frame->ch_layout.nb_channels);
    if (status == ERN_OK) status = find_silence(sound);
    if (status != ERN_OK) return status;
  }
  if (frame->sample_rate != sound->rate || frame->ch_layout.nb_channels != sound->channels)
    return ern_fail(decoder->context, ERN_E_UNSUPPORTED,
                    "%s: sound turns from %d Hz and %d channels to %d Hz and %d channels", decoder->path, sound->rate,
                    sound->channels, frame->sample_rate, frame->ch_layout.nb_channels);
  if (sound->convert == NULL || sound->from != (enum AVSampleFormat)frame->format) status = make_converter(sound);
  return status == ERN_OK ? find_place(sound) : status;
}

ern_status ern_sound_decoder_next(struct ern_sound_decoder *sound, bool *end) {
  size_t decoded = 0;
  do {
    const ern_status status = take_next(sound, end);
    if (status != ERN_OK || *end) return status;
    decoded = (size_t)sound->decoder.frame->nb_samples;
  } while (sound->skip >= decoded && decoded > 0);
  sound->frames = decoded - sound->skip;
  sound->surplus = surplus_of(&sound->decoder);
  if (sound->surplus > sound->frames) sound->surplus = sound->frames;
  sound->position += sound->silence + sound->frames;
  return ERN_OK;
}

/* Clips samples that are floating-point numbers to full scale, as integers of swresample wrap beyond it. */
static ern_status clip_samples(struct ern_sound_decoder *sound) {
  const struct ern_decoder *decoder = &sound->decoder;
  AVFrame *frame = decoder->frame;
  const enum AVSampleFormat packed = av_get_packed_sample_fmt(sound->from);
  const bool planar = av_sample_fmt_is_planar(sound->from) != 0;
  const size_t planes = planar ? (size_t)sound->channels : 1;
  const size_t count = (size_t)frame->nb_samples * (size_t)sound->channels / planes;
  if (packed != AV_SAMPLE_FMT_FLT && packed != AV_SAMPLE_FMT_DBL) return ERN_OK;
  const int error = av_frame_make_writable(frame);
  if (error < 0) return ern_av_fail(decoder->context, ERN_E_MEDIA, decoder->path, "convert its samples", error);
  for (size_t c = 0; c < planes; c++)
    for (size_t i = 0; i < count; i++) {
      float *single = (float *)(void *)frame->extended_data[c] + i;
      double *twofold = (double *)(void *)frame->extended_data[c] + i;
      const double value = packed == AV_SAMPLE_FMT_FLT ? (double)*single : *twofold;
      if (!isfinite(value))
        return ern_fail(decoder->context, ERN_E_NONFINITE, "%s: its sound has a sample that is no finite number",
                        decoder->path);
      if (fabs(value) <= 1) continue;
      if (packed == AV_SAMPLE_FMT_FLT)
        *single = value > 0 ? 1 : -1;
      else
        *twofold = value > 0 ? 1 : -1;
    }
  return ERN_OK;
}

ern_status ern_sound_decoder_take(struct ern_sound_decoder *sound, void *samples) {
  const AVFrame *frame = sound->decoder.frame;
  const bool planar = av_sample_fmt_is_planar(sound->from) != 0;
  const size_t before =
      sound->skip * (size_t)av_get_bytes_per_sample(sound->from) * (planar ? 1 : (size_t)sound->channels);
  const uint8_t *from[MAX_CHANNELS] = {NULL};
  uint8_t *to = samples;
  const ern_status status = sound->format == AV_SAMPLE_FMT_S16 ? clip_samples(sound) : ERN_OK;
  if (status != ERN_OK) return status;
  for (int c = 0; c < (planar ? sound->channels : 1); c++) from[c] = frame->extended_data[c] + before;
  const int count = (int)sound->frames, made = swr_convert(sound->convert, &to, count, from, count);
  if (made < 0)
    return ern_av_fail(sound->decoder.context, ERN_E_MEDIA, sound->decoder.path, "convert its samples", made);
  sound->frames = (size_t)made;
  return ERN_OK;
}

void ern_sound_decoder_close(struct ern_sound_decoder *sound) {
  swr_free(&sound->convert);
  av_frame_free(&sound->ahead);
  ern_decoder_close(&sound->decoder);
}

/* ---- the whole --------------------------------------------------------------------------------------------------- */

struct sound_decode_job {
  ern_context *context;
  struct ern_sound_decoder sound;
  ern_sound_taker *take;
  void *user;
  float *samples; /* [capacity][channels]: the piece that was decoded last */
  size_t capacity;
  size_t waiting; /* frames of it that are not passed on yet: the last piece's padding is left out */
  uint64_t frames;
};

static ern_status give_waiting(struct sound_decode_job *job) {
  const struct ern_sound_decoder *sound = &job->sound;
  ern_status status = ERN_OK;
  if (job->waiting > 0) status = job->take(job->user, sound->rate, sound->channels, job->samples, job->waiting);
  job->frames += job->waiting;
  job->waiting = 0;
  return status;
}

static ern_status give_silence(struct sound_decode_job *job) {
  const struct ern_sound_decoder *sound = &job->sound;
  static const float zeros[SILENCE_BLOCK * MAX_CHANNELS] = {0};
  ern_status status = ERN_OK;
  for (size_t left = sound->silence; left > 0 && status == ERN_OK;) {
    const size_t count = left < SILENCE_BLOCK ? left : SILENCE_BLOCK;
    status = job->take(job->user, sound->rate, sound->channels, zeros, count);
    left -= count;
  }
  job->frames += sound->silence;
  return status;
}

/* Stores the last decoded piece as the waiting one. */
static ern_status take_piece(struct sound_decode_job *job) {
  struct ern_sound_decoder *sound = &job->sound;
  const size_t count = sound->frames;
  ern_status status = ERN_OK;
  if (sound->position > (uint64_t)MOST_SOUND_HOURS * 3600 * (uint64_t)sound->rate)
    ERN_TRY(ern_fail(job->context, ERN_E_SHAPE, "%s: sound is longer than %d hours, the most that features are made of",
                     sound->decoder.path, MOST_SOUND_HOURS));
  ERN_TRY(give_waiting(job));
  ERN_TRY(give_silence(job));
  if (count > job->capacity) {
    ern_release(job->context, job->samples);
    job->capacity = 0;
    ERN_TRY(ERN_NEW(job->context, count * (size_t)sound->channels, &job->samples));
    job->capacity = count;
  }
  ERN_TRY(ern_sound_decoder_take(sound, job->samples));
  job->waiting = sound->frames;
fail:
  return status;
}

ern_status ern_sound_decode(ern_context *context, const char *path, ern_sound_taker *take, void *user) {
  struct sound_decode_job job = {.context = context, .take = take, .user = user};
  ern_status status = ERN_OK;
  bool end = false;
  ERN_TRY(ern_sound_decoder_open(context, path, AV_SAMPLE_FMT_FLT, &job.sound));
  for (;;) {
    ERN_TRY(ern_sound_decoder_next(&job.sound, &end));
    if (end) break;
    ERN_TRY(take_piece(&job));
  }
  job.waiting -= job.sound.surplus < job.waiting ? job.sound.surplus : job.waiting;
  ERN_TRY(give_waiting(&job));
  if (job.frames == 0) ERN_TRY(ern_fail(context, ERN_E_SHAPE, "%s: has no sound, 0 samples", path));
fail:
  ern_release(context, job.samples);
  ern_sound_decoder_close(&job.sound);
  return status;
}
