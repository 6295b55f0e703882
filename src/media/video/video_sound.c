/* SPDX-License-Identifier: MIT */
#include "media/video/video_sound.h"

#include <libavutil/channel_layout.h>
#include <math.h>

/* The codec's sample rate for `rate`: `rate` itself where the codec supports it, else the nearest above, else the
 * highest. */
static int rate_for(const AVCodec *codec, int rate) {
  if (codec->supported_samplerates == NULL) return rate;
  int above = 0, highest = 0;
  for (const int *other = codec->supported_samplerates; *other != 0; other++) {
    if (*other >= rate && (above == 0 || *other < above)) above = *other;
    if (*other > highest) highest = *other;
  }
  return above != 0 ? above : highest;
}

/* Bits a second a channel: 3 a sample, within AAC-LC's useful range. */
static int64_t bit_rate_for(int rate) {
  const int64_t wanted = 3 * (int64_t)rate;
  return wanted < 32000 ? 32000 : wanted > 128000 ? 128000 : wanted;
}

/* Opus has layouts with a subwoofer only for 5.1, 6.1 and 7.1 (RFC 7845, 5.1.1.2); FFmpeg's defaults for 3 and 4
 * channels are not among Opus's layouts. */
static void choose_layout(AVChannelLayout *layout, enum AVCodecID id, int channels) {
  if (id == AV_CODEC_ID_OPUS && channels == 3)
    *layout = (AVChannelLayout)AV_CHANNEL_LAYOUT_SURROUND;
  else if (id == AV_CODEC_ID_OPUS && channels == 4)
    *layout = (AVChannelLayout)AV_CHANNEL_LAYOUT_QUAD;
  else
    av_channel_layout_default(layout, channels);
}

static ern_status open_codec(struct ern_muxer *muxer, struct ern_sound_track *track, int rate, enum AVCodecID id) {
  const AVCodec *codec = avcodec_find_encoder(id);
  if (codec == NULL || codec->sample_fmts == NULL) {
    return ern_fail(muxer->context, ERN_E_UNSUPPORTED, "%s: FFmpeg has no encoder for sound as %s", muxer->path,
                    avcodec_get_name(id));
  }
  AVCodecContext *made = track->codec = avcodec_alloc_context3(codec);
  track->stream = avformat_new_stream(muxer->container, NULL);
  if (made == NULL || track->stream == NULL) {
    return ern_fail(muxer->context, ERN_E_NO_MEMORY, "%s: no memory for an encoder of sound", muxer->path);
  }
  made->sample_fmt = codec->sample_fmts[0]; /* planar float for FFmpeg's own */
  made->sample_rate = rate_for(codec, rate);
  made->bit_rate = bit_rate_for(made->sample_rate) * track->channels;
  made->time_base = (AVRational){1, made->sample_rate};
  choose_layout(&made->ch_layout, id, track->channels);
  if (muxer->container->oformat->flags & AVFMT_GLOBALHEADER) made->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  int error = avcodec_open2(made, codec, NULL);
  if (error >= 0) error = avcodec_parameters_from_context(track->stream->codecpar, made);
  if (error < 0) return ern_av_fail(muxer->context, ERN_E_MEDIA, muxer->path, "open an encoder of sound", error);
  track->stream->time_base = made->time_base;
  return ERN_OK;
}

static ern_status open_buffers(struct ern_muxer *muxer, struct ern_sound_track *track, enum AVSampleFormat from,
                               int rate) {
  AVCodecContext *codec = track->codec;
  int error = swr_alloc_set_opts2(&track->convert, &codec->ch_layout, codec->sample_fmt, codec->sample_rate,
                                  &codec->ch_layout, from, rate, 0, NULL);
  if (error >= 0) error = swr_init(track->convert);
  track->waiting = av_audio_fifo_alloc(codec->sample_fmt, codec->ch_layout.nb_channels, 4096);
  track->frame = av_frame_alloc();
  if (error >= 0 && (track->waiting == NULL || track->frame == NULL)) error = AVERROR(ENOMEM);
  if (error >= 0) {
    track->frame->nb_samples = codec->frame_size > 0 ? codec->frame_size : 1024;
    track->frame->format = codec->sample_fmt;
    track->frame->sample_rate = codec->sample_rate;
    error = av_channel_layout_copy(&track->frame->ch_layout, &codec->ch_layout);
  }
  if (error >= 0) error = av_frame_get_buffer(track->frame, 0);
  return error >= 0 ? ERN_OK : ern_av_fail(muxer->context, ERN_E_MEDIA, muxer->path, "convert the sound", error);
}

ern_status ern_sound_track_check(ern_context *context, const char *path, const ern_sound *sound, double start) {
  if (!(start >= 0 && start < 1e9))
    return ern_fail(context, ERN_E_ARGUMENT, "%s: sound starts at %g s, expected 0 to 1e9", path, start);
  if (sound == NULL || (sound->rate >= 1 && sound->rate <= 384000 && sound->channels >= 1 && sound->channels <= 8 &&
                        (sound->data != NULL || sound->frames == 0)))
    return ERN_OK;
  return ern_fail(context, ERN_E_ARGUMENT, "%s: sound has %d Hz and %d channels%s, expected 1 to 384000 and 1 to 8",
                  path, sound->rate, sound->channels, sound->data == NULL ? ", no samples" : "");
}

ern_status ern_sound_track_open(struct ern_muxer *muxer, const ern_sound *sound, double start, enum AVCodecID id,
                                struct ern_sound_track *track) {
  ern_status status = ERN_OK;
  *track = (struct ern_sound_track){0};
  if (sound == NULL) return ERN_OK;
  const double first = floor(start * sound->rate + 0.5);
  if (first >= (double)sound->frames) return ERN_OK;
  track->sound = sound;
  track->first = track->at = (size_t)first;
  track->channels = sound->channels;
  ERN_TRY(open_codec(muxer, track, sound->rate, id));
  ERN_TRY(open_buffers(muxer, track, AV_SAMPLE_FMT_S16, sound->rate));
  return ERN_OK;
fail:
  ern_sound_track_close(track);
  return status;
}

/* Converts `count` frames of sound (0: flushes the resampler) and appends them to track->waiting. */
static ern_status convert(struct ern_muxer *muxer, struct ern_sound_track *track, const uint8_t *from, int count) {
  uint8_t **to = NULL;
  const int most = swr_get_out_samples(track->convert, count) + 64;
  int error = av_samples_alloc_array_and_samples(&to, NULL, track->channels, most, track->codec->sample_fmt, 0);
  if (error >= 0) error = swr_convert(track->convert, to, most, count > 0 ? &from : NULL, count);
  if (error > 0) error = av_audio_fifo_write(track->waiting, (void **)to, error);
  if (to != NULL) av_freep(&to[0]);
  av_freep(&to);
  return error >= 0 ? ERN_OK : ern_av_fail(muxer->context, ERN_E_MEDIA, muxer->path, "convert the sound", error);
}

/* Encodes the next `count` samples that wait, at most a packet's. */
static ern_status encode(struct ern_muxer *muxer, struct ern_sound_track *track, int count) {
  AVFrame *frame = track->frame;
  int error = av_frame_make_writable(frame); /* the codec may still hold a reference to the last frame */
  if (error >= 0) error = av_audio_fifo_read(track->waiting, (void **)frame->extended_data, count);
  if (error < 0) return ern_av_fail(muxer->context, ERN_E_MEDIA, muxer->path, "encode the sound", error);
  const int whole = frame->nb_samples;
  frame->nb_samples = count;
  frame->pts = track->encoded;
  track->encoded += count;
  const ern_status status = ern_muxer_encode(muxer, track->codec, track->stream, frame);
  frame->nb_samples = whole;
  return status;
}

ern_status ern_sound_track_advance(struct ern_muxer *muxer, struct ern_sound_track *track, int64_t pictures,
                                   AVRational rate, bool last) {
  if (track->sound == NULL) return ERN_OK;
  ern_status status = ERN_OK;
  const AVRational seconds_each = {rate.den, rate.num};
  const int64_t end =
      av_rescale_q_rnd(pictures, seconds_each, (AVRational){1, track->codec->sample_rate}, AV_ROUND_DOWN);
  const int64_t source = av_rescale_q_rnd(pictures, seconds_each, (AVRational){1, track->sound->rate}, AV_ROUND_UP);
  const size_t left = track->sound->frames - track->first;
  const size_t until = track->first + ((uint64_t)source < left ? (size_t)source : left);
  const int packet = track->frame->nb_samples;
  while (track->at < until) {
    const size_t rest = until - track->at, part = rest < 65536 ? rest : 65536;
    const int16_t *from = track->sound->data + track->at * (size_t)track->channels;
    ERN_TRY(convert(muxer, track, (const uint8_t *)from, (int)part));
    track->at += part;
    while (av_audio_fifo_size(track->waiting) >= packet && track->encoded + packet <= end) {
      ERN_TRY(encode(muxer, track, packet));
    }
  }
  if (!last) return ERN_OK;
  ERN_TRY(convert(muxer, track, NULL, 0));
  while (track->encoded < end && av_audio_fifo_size(track->waiting) > 0) {
    int64_t count = end - track->encoded;
    if (count > av_audio_fifo_size(track->waiting)) count = av_audio_fifo_size(track->waiting);
    ERN_TRY(encode(muxer, track, count < packet ? (int)count : packet));
  }
  ERN_TRY(ern_muxer_encode(muxer, track->codec, track->stream, NULL));
fail:
  return status;
}

ern_status ern_sound_track_open_live(struct ern_muxer *muxer, int rate, int channels, enum AVCodecID id,
                                     struct ern_sound_track *track) {
  ern_status status = ERN_OK;
  *track = (struct ern_sound_track){.channels = channels};
  ERN_TRY(open_codec(muxer, track, rate, id));
  ERN_TRY(open_buffers(muxer, track, AV_SAMPLE_FMT_FLT, rate));
  return ERN_OK;
fail:
  ern_sound_track_close(track);
  return status;
}

ern_status ern_sound_track_add(struct ern_muxer *muxer, struct ern_sound_track *track, const float *samples,
                               size_t frames) {
  enum { PART = 512 };
  const int packet = track->frame->nb_samples;
  const size_t channels = (size_t)track->channels; /* at most 8 */
  float clipped[PART * 8];                         /* integers of swresample wrap, and AAC refuses large numbers */
  ern_status status = ERN_OK;
  for (size_t done = 0, part; samples != NULL && done < frames; done += part) {
    part = frames - done < PART ? frames - done : PART;
    for (size_t i = 0; i < part * channels; i++) clipped[i] = fminf(fmaxf(samples[done * channels + i], -1), 1);
    ERN_TRY(convert(muxer, track, (const uint8_t *)clipped, (int)part));
  }
  if (samples == NULL) ERN_TRY(convert(muxer, track, NULL, 0));
  while (av_audio_fifo_size(track->waiting) >= packet) ERN_TRY(encode(muxer, track, packet));
  if (samples != NULL) return ERN_OK;
  if (av_audio_fifo_size(track->waiting) > 0) ERN_TRY(encode(muxer, track, av_audio_fifo_size(track->waiting)));
  ERN_TRY(ern_muxer_encode(muxer, track->codec, track->stream, NULL));
fail:
  return status;
}

void ern_sound_track_close(struct ern_sound_track *track) {
  av_frame_free(&track->frame);
  av_audio_fifo_free(track->waiting);
  swr_free(&track->convert);
  avcodec_free_context(&track->codec);
  *track = (struct ern_sound_track){0};
}
