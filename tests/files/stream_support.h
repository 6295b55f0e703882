/* SPDX-License-Identifier: MIT
 * What the tests of streams share: a short stream of known pictures and sound, its times, and waits that end. */
#ifndef ERN_TESTS_FILES_STREAM_SUPPORT_H
#define ERN_TESTS_FILES_STREAM_SUPPORT_H

#include <arpa/inet.h>
#include <math.h>
#include <netinet/in.h>
#include <signal.h>
#include <stdatomic.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include "ernerf/media.h"
#include "ernerf/stream.h"
#include "media/ffmpeg.h"
#include "support.h"

enum { SIDE = 32, FRAMES = 50, FPS = 25, RATE = 16000, SAMPLES = RATE / FPS, REPEATED = 20, PATIENCE = 600 };

static ern_context *context;

static inline int set_up(void **state) {
  (void)state;
  (void)signal(SIGPIPE, SIG_IGN);
  context = support_context();
  return 0;
}

static inline int tear_down(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

/* Asked ten times a second: ends a wait that nothing else ends. */
struct patience {
  atomic_int left;
};

static inline int loses_patience(void *user) {
  struct patience *patience = user;
  return atomic_fetch_sub(&patience->left, 1) <= 0 ? 1 : 0;
}

static inline size_t descriptors(void) {
  size_t count = 0;
  DIR *list = opendir("/proc/self/fd");
  assert_non_null(list);
  while (readdir(list) != NULL) count++;
  (void)closedir(list);
  return count;
}

/* Grey that rises by 4 a frame. */
static inline void paint(uint8_t *rgba, int k) {
  for (size_t i = 0; i < (size_t)SIDE * SIDE * 4; i++) rgba[i] = (uint8_t)(i % 4 == 3 ? 255 : 20 + 4 * k);
}

static inline void tone(float *samples, int k) {
  for (int i = 0; i < SAMPLES; i++) samples[i] = 0.5f * (float)sin(0.1 * (k * SAMPLES + i));
}

static inline ern_stream_options options_of_stream(const char *format) {
  ern_stream_options options = ern_stream_options_default(SIDE, SIDE);
  options.format = format;
  options.sound_rate = RATE;
  options.sound_channels = 1;
  return options;
}

/* FRAMES pictures, REPEATED is the one before again. The first `silent` have silence. */
static inline ern_status write_frames_after(ern_stream_writer *writer, int silent) {
  static uint8_t rgba[SIDE * SIDE * 4];
  float samples[SAMPLES];
  ern_status status = ERN_OK;
  for (int k = 0; status == ERN_OK && k < FRAMES; k++) {
    paint(rgba, k);
    tone(samples, k);
    if (k < silent) memset(samples, 0, sizeof samples);
    status = ern_stream_writer_frame(writer, k == REPEATED ? NULL : rgba, samples, SAMPLES);
  }
  return status;
}

static inline ern_status write_frames(ern_stream_writer *writer) { return write_frames_after(writer, 0); }

static inline ern_status write_stream_after(const char *url, const ern_stream_options *options, int silent) {
  ern_stream_writer *writer;
  ern_status status = ern_stream_writer_open(context, url, options, &writer);
  if (status == ERN_OK) status = write_frames_after(writer, silent);
  if (status == ERN_OK) return ern_stream_writer_close(&writer);
  ern_stream_writer_abandon(&writer);
  return status;
}

static inline ern_status write_stream(const char *url, const ern_stream_options *options) {
  return write_stream_after(url, options, 0);
}

/* ---- times ------------------------------------------------------------------------------------------------------- */

struct times {
  int pictures, wrong; /* wrong: not at first + k / 25 s */
  double first_picture, first_sound, last_sound;
};

/* A coded sound begins with up to `priming` seconds that decoders leave out. */
static inline struct times times_of(const char *path) {
  struct times times = {.first_picture = NAN, .first_sound = NAN};
  AVFormatContext *input = NULL;
  AVPacket *packet = av_packet_alloc();
  assert_non_null(packet);
  assert_int_equal(avformat_open_input(&input, path, NULL, NULL), 0);
  assert_true(avformat_find_stream_info(input, NULL) >= 0);
  while (av_read_frame(input, packet) >= 0) {
    const AVStream *stream = input->streams[packet->stream_index];
    const double seconds = (double)packet->pts * av_q2d(stream->time_base);
    if (stream->codecpar->codec_type == AVMEDIA_TYPE_VIDEO) {
      if (times.pictures == 0) times.first_picture = seconds;
      times.wrong += fabs(seconds - times.first_picture - (double)times.pictures / FPS) > 1e-6;
      times.pictures++;
    } else {
      if (isnan(times.first_sound)) times.first_sound = seconds;
      times.last_sound = seconds + (double)packet->duration * av_q2d(stream->time_base);
    }
    av_packet_unref(packet);
  }
  av_packet_free(&packet);
  avformat_close_input(&input);
  return times;
}

/* The first sample above a quarter of full scale in the packets that were given to the decoder; NaN: none. */
static inline double first_loud(AVCodecContext *decoder, AVFrame *frame, AVRational base) {
  double loud = NAN;
  while (avcodec_receive_frame(decoder, frame) >= 0) {
    const float *samples = (const float *)(const void *)frame->extended_data[0];
    assert_int_equal(frame->format, AV_SAMPLE_FMT_FLTP);
    for (int i = 0; i < frame->nb_samples && isnan(loud); i++)
      if (fabsf(samples[i]) > 0.25f) loud = (double)frame->pts * av_q2d(base) + (double)i / frame->sample_rate;
    av_frame_unref(frame);
  }
  return loud;
}

/* Seconds from the first picture to the first loud sample of a sound in AAC; NaN: there is none. */
static inline double loud_after_picture(const char *path) {
  AVFormatContext *input = NULL;
  AVPacket *packet = av_packet_alloc();
  AVFrame *frame = av_frame_alloc();
  AVCodecContext *decoder = avcodec_alloc_context3(avcodec_find_decoder(AV_CODEC_ID_AAC));
  double picture = NAN, loud = NAN;
  assert_true(packet != NULL && frame != NULL && decoder != NULL);
  assert_int_equal(avformat_open_input(&input, path, NULL, NULL), 0);
  assert_true(avformat_find_stream_info(input, NULL) >= 0);
  while (av_read_frame(input, packet) >= 0) {
    const AVStream *stream = input->streams[packet->stream_index];
    if (stream->codecpar->codec_type == AVMEDIA_TYPE_VIDEO) {
      if (isnan(picture)) picture = (double)packet->pts * av_q2d(stream->time_base);
    } else {
      if (!avcodec_is_open(decoder)) {
        assert_true(avcodec_parameters_to_context(decoder, stream->codecpar) >= 0);
        decoder->pkt_timebase = stream->time_base;
        assert_int_equal(avcodec_open2(decoder, NULL, NULL), 0);
      }
      assert_int_equal(avcodec_send_packet(decoder, packet), 0);
      const double found = first_loud(decoder, frame, stream->time_base);
      if (isnan(loud)) loud = found;
    }
    av_packet_unref(packet);
  }
  avcodec_free_context(&decoder);
  av_frame_free(&frame);
  av_packet_free(&packet);
  avformat_close_input(&input);
  return loud - picture;
}

/* A port that was free a moment ago. */
static inline uint16_t free_port(void) {
  struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
  socklen_t bytes = sizeof address;
  const int made = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  assert_true(made >= 0);
  assert_int_equal(bind(made, (const struct sockaddr *)&address, bytes), 0);
  assert_int_equal(getsockname(made, (struct sockaddr *)&address, &bytes), 0);
  (void)close(made);
  return ntohs(address.sin_port);
}

#endif
