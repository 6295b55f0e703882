/* SPDX-License-Identifier: MIT
 * Sound files of FFmpeg's encoders. */
#ifndef ERN_TESTS_ENCODED_SOUND_H
#define ERN_TESTS_ENCODED_SOUND_H

#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/channel_layout.h>

#include "ernerf/media.h"
#include "support.h"

struct encoded {
  enum AVCodecID codec;
  const char *form; /* of FFmpeg's */
  int tracks;       /* 2: and one of pictures, without any */
  int64_t page;     /* of Ogg: the longest, microseconds */
};

static inline AVCodecContext *open_encoder(enum AVCodecID id, int rate) {
  const AVCodec *how = avcodec_find_encoder(id);
  AVCodecContext *codec = avcodec_alloc_context3(how);
  assert_true(how != NULL && codec != NULL);
  codec->sample_rate = rate;
  codec->sample_fmt = how->sample_fmts[0];
  codec->time_base = (AVRational){1, rate};
  codec->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  av_channel_layout_default(&codec->ch_layout, 1);
  assert_true(avcodec_open2(codec, NULL, NULL) >= 0);
  return codec;
}

static inline AVFormatContext *open_file(const char *path, const struct encoded *how, const AVCodecContext *codec) {
  AVFormatContext *container = NULL;
  AVDictionary *options = NULL;
  assert_true(avformat_alloc_output_context2(&container, NULL, how->form, path) >= 0 &&
              av_dict_set_int(&options, "page_duration", how->page, 0) >= 0);
  AVStream *stream = avformat_new_stream(container, NULL);
  assert_true(stream != NULL && avcodec_parameters_from_context(stream->codecpar, codec) >= 0);
  if (how->tracks == 2) {
    AVStream *pictures = avformat_new_stream(container, NULL);
    assert_non_null(pictures);
    pictures->codecpar->codec_type = AVMEDIA_TYPE_VIDEO;
    pictures->codecpar->codec_id = AV_CODEC_ID_MJPEG;
    pictures->codecpar->width = pictures->codecpar->height = 16;
  }
  assert_true(avio_open(&container->pb, path, AVIO_FLAG_WRITE) >= 0);
  assert_true(avformat_write_header(container, &options) >= 0);
  av_dict_free(&options);
  return container;
}

/* One track; returns how much the file's times are later than the samples' own, s. */
static inline double write_encoded(const char *path, const struct encoded *how, const ern_sound *sound) {
  AVCodecContext *codec = open_encoder(how->codec, sound->rate);
  AVFormatContext *container = open_file(path, how, codec);
  AVFrame *frame = av_frame_alloc();
  AVPacket *packet = av_packet_alloc();
  int64_t first = AV_NOPTS_VALUE;
  const int total = (int)sound->frames;
  assert_true(frame != NULL && packet != NULL);
  for (int at = 0; at <= total;) {
    frame->format = codec->sample_fmt;
    frame->sample_rate = sound->rate;
    frame->nb_samples = total - at < codec->frame_size ? total - at : codec->frame_size;
    frame->pts = at;
    const bool last = frame->nb_samples == 0;
    if (!last)
      assert_true(av_channel_layout_copy(&frame->ch_layout, &codec->ch_layout) >= 0 &&
                  av_frame_get_buffer(frame, 0) >= 0);
    for (int i = 0; i < frame->nb_samples; i++) {
      const int16_t value = sound->data[at + i];
      if (av_get_bytes_per_sample(codec->sample_fmt) == 2)
        ((int16_t *)(void *)frame->data[0])[i] = value;
      else
        ((float *)(void *)frame->data[0])[i] = (float)value / 32768;
    }
    at += last ? 1 : frame->nb_samples;
    assert_true(avcodec_send_frame(codec, last ? NULL : frame) >= 0);
    while (avcodec_receive_packet(codec, packet) >= 0) {
      if (first == AV_NOPTS_VALUE) first = packet->pts;
      packet->stream_index = 0;
      av_packet_rescale_ts(packet, (AVRational){1, sound->rate}, container->streams[0]->time_base);
      assert_true(av_write_frame(container, packet) >= 0);
    }
    av_frame_unref(frame);
  }
  assert_true(av_write_trailer(container) >= 0);
  avio_closep(&container->pb);
  avformat_free_context(container);
  av_packet_free(&packet);
  av_frame_free(&frame);
  avcodec_free_context(&codec);
  return first < 0 ? (double)-first / sound->rate : 0; /* a file's times begin at 0 */
}

#endif
