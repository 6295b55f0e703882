/* SPDX-License-Identifier: MIT
 * Reads live sound from a pipe, a URL, a device or a file, resampled to the wanted rate. */
#include <dlfcn.h>
#include <libavutil/channel_layout.h>
#include <libswresample/swresample.h>
#include <math.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "core/sized.h"
#include "ernerf/stream.h"
#include "media/ffmpeg.h"
#include "media/live/address.h"
#include "media/live/descriptor_io.h"
#include "media/mono.h"
#include "media/truncation.h"

enum { LEAST_RATE = 1000, MOST_RATE = 384000, MOST_CHANNELS = ERN_MONO_MOST, MIXED = 4096 /* frames at a time */ };

struct ern_sound_reader {
  ern_context *context;
  ern_sound_reader_options options;
  struct ern_decoder decoder;
  struct ern_descriptor_io pipe;
  SwrContext *convert; /* from the format of the last decoded frame */
  int rate, channels;  /* that */
  enum AVSampleFormat format;
  struct ern_mono mono;
  float *wide; /* [MIXED][MOST_CHANNELS]: before they become one channel */
  bool ended;
};

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static ern_status check_options(ern_context *context, const ern_sound_reader_options *o) {
  const struct {
    const char *name;
    int value, least, most;
  } rows[] = {{"rate", o->rate, LEAST_RATE, MOST_RATE},
              {"channels", o->channels, 1, MOST_CHANNELS},
              {"format_rate", o->format_rate, LEAST_RATE, MOST_RATE},
              {"format_channels", o->format_channels, 1, MOST_CHANNELS}};
  for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
    if (rows[i].value < rows[i].least || rows[i].value > rows[i].most)
      return ern_fail(context, ERN_E_ARGUMENT, "sound: %s is %d, expected %d to %d", rows[i].name, rows[i].value,
                      rows[i].least, rows[i].most);
  return ERN_OK;
}

/* Loads FFmpeg's input devices, which register themselves in the process; the library stays loaded. */
static ern_status find_device(ern_context *context, const char *url, const AVInputFormat **format) {
  char library[64], name[32];
  const size_t length = strcspn(url, ":");
  snprintf(library, sizeof library, "libavdevice.so.%d", LIBAVFORMAT_VERSION_MAJOR); /* same major version */
  snprintf(name, sizeof name, "%.*s", (int)(length < sizeof name ? length : sizeof name - 1), url);
  void *handle = dlopen(library, RTLD_NOW | RTLD_NODELETE);
  void (*announce)(void) = NULL;
  if (handle != NULL) *(void **)&announce = dlsym(handle, "avdevice_register_all");
  if (announce == NULL)
    return ern_fail(context, ERN_E_UNSUPPORTED, "%s: \"%s\" would be a device, which needs %s (libavdevice)", url, name,
                    library);
  announce();
  *format = av_find_input_format(name);
  if (*format == NULL) return ern_fail(context, ERN_E_UNSUPPORTED, "%s: libavdevice has no device \"%s\"", url, name);
  return ERN_OK;
}

/* Options that describe raw samples, which have no header, and that keep packets short. */
static int describe(const ern_sound_reader_options *o, bool device, AVDictionary **options) {
  int error = device ? 0 : av_dict_set_int(options, "sample_rate", o->format_rate, 0);
  if (error >= 0 && !device) error = av_dict_set_int(options, "channels", o->format_channels, 0);
  if (error >= 0) error = av_dict_set_int(options, "max_size", 1024, 0); /* bytes of a WAV packet */
  if (error >= 0) error = av_dict_set_int(options, "indexmem", 4096, 0); /* bytes; only seeking needs it */
  return error;
}

static ern_status open_input(ern_sound_reader *r, const char *url) {
  ern_context *context = r->context;
  struct ern_decoder_input input = {.url = url, .interrupt = {r->options.stop, r->options.user}};
  const char *path = NULL;
  ern_status status = ERN_OK;
  char *file = NULL;
  ERN_TRY(ern_address_parse(context, url, &path));
  const bool pipe = path != NULL && ern_is_pipe(path), device = !pipe && ern_sound_reader_is_device(url);
  if (r->options.format != NULL) {
    input.format = av_find_input_format(r->options.format);
    if (input.format == NULL)
      return ern_fail(context, ERN_E_UNSUPPORTED, "%s: FFmpeg has no format \"%s\"", url, r->options.format);
  } else if (strncmp(url, "rtsp://", 7) == 0) {
    input.format = av_find_input_format("rtsp"); /* not probed: it refers to further URLs (allow_formats) */
  }
  if (pipe) {
    r->pipe.stop = r->options.stop;
    r->pipe.user = r->options.user;
    ERN_TRY(ern_descriptor_io_open(context, path, false, &r->pipe));
    input.io = r->pipe.io;
    input.url = NULL;
  } else if (device) {
    ERN_TRY(find_device(context, url, &input.format));
    input.url = strchr(url, ':') + 1;
  } else if (path != NULL) {
    ERN_TRY(ern_av_url(context, path, &file));
    input.url = file;
  }
  input.whole = path != NULL; /* a file or a pipe */
  int error = av_dict_set(&input.options, "protocol_whitelist", file != NULL ? "file" : NULL, 0);
  if (error >= 0) error = describe(&r->options, device, &input.options);
  if (error < 0) ERN_TRY(ern_fail(context, ERN_E_NO_MEMORY, "%s: no memory", url));
  r->pipe.opens = r->options.format == NULL;
  status = ern_decoder_open_live(context, url, &input, &r->decoder);
  r->pipe.opens = false;
  r->decoder.piped = pipe;
  if (pipe) (void)ern_truncation_is_wav(r->pipe.head, r->pipe.head_bytes, &r->decoder.open_ended);
fail:
  av_dict_free(&input.options);
  ern_release(context, file);
  return status;
}

static bool asks_to_stop(const ern_sound_reader *r) {
  return r->options.stop != NULL && r->options.stop(r->options.user) != 0;
}

/* Replaces an error that the caller's request to stop caused by ERN_E_CANCELLED. */
static ern_status or_stopped(const ern_sound_reader *r, const char *url, ern_status status) {
  if (status == ERN_OK || status == ERN_E_CANCELLED || !asks_to_stop(r)) return status;
  return ern_fail(r->context, ERN_E_CANCELLED, "%s: stopped", url);
}

ern_status ern_sound_reader_open(ern_context *context, const char *url, const ern_sound_reader_options *options,
                                 ern_sound_reader **reader) {
  ERN_PLAIN_FLOATS;
  if (reader != NULL) *reader = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, url);
  ERN_NEED(context, reader);
  ern_sound_reader_options chosen = ern_sound_reader_options_default();
  ern_sound_reader *made = NULL;
  ern_status status = ERN_OK;
  if (options != NULL) ERN_TRY(ERN_COPY_IN_CONFIG(context, ern_sound_reader_options, &chosen, options));
  ERN_TRY(check_options(context, &chosen));
  ERN_TRY(ERN_NEW(context, 1, &made));
  made->context = context;
  made->options = chosen;
  ERN_TRY(ERN_NEW(context, (size_t)MIXED * MOST_CHANNELS, &made->wide));
  ERN_TRY(or_stopped(made, url, open_input(made, url)));
  *reader = made;
  return ERN_OK;
fail:
  ern_sound_reader_free(&made);
  return status;
}

void ern_sound_reader_free(ern_sound_reader **reader) {
  if (reader == NULL || *reader == NULL) return;
  ern_sound_reader *r = *reader;
  *reader = NULL;
  swr_free(&r->convert);
  ern_release(r->context, r->wide);
  ern_decoder_close(&r->decoder);
  ern_descriptor_io_close(&r->pipe);
  ern_release(r->context, r);
}

/* ---- reading ----------------------------------------------------------------------------------------------------- */

/* Makes the converter from the present frame's format. For mono it keeps the channels, which convert() mixes. */
static ern_status make_converter(ern_sound_reader *r) {
  const AVFrame *frame = r->decoder.frame;
  AVChannelLayout from = {0}, to = {0};
  r->rate = frame->sample_rate;
  r->channels = frame->ch_layout.nb_channels;
  r->format = (enum AVSampleFormat)frame->format;
  if (r->rate < 1 || r->rate > MOST_RATE || r->channels < 1 || r->channels > MOST_CHANNELS)
    return ern_fail(r->context, ERN_E_SHAPE,
                    "%s: sound has %d samples a second and %d channels, expected 1 to %d and 1 to %d", r->decoder.path,
                    r->rate, r->channels, MOST_RATE, MOST_CHANNELS);
  swr_free(&r->convert);
  r->mono = (struct ern_mono){0};
  av_channel_layout_default(&from, r->channels);
  av_channel_layout_default(&to, r->options.channels == 1 ? r->channels : r->options.channels);
  int error =
      swr_alloc_set_opts2(&r->convert, &to, AV_SAMPLE_FMT_FLT, r->options.rate, &from, r->format, r->rate, 0, NULL);
  if (error >= 0) error = swr_init(r->convert);
  av_channel_layout_uninit(&from);
  av_channel_layout_uninit(&to);
  return error >= 0 ? ERN_OK : ern_av_fail(r->context, ERN_E_MEDIA, r->decoder.path, "convert its samples", error);
}

static ern_status convert(ern_sound_reader *r, const uint8_t *const *from, int count, float *samples, size_t capacity,
                          size_t *frames) {
  const bool mixes = r->options.channels == 1 && r->channels > 1;
  uint8_t *to[1] = {(uint8_t *)(mixes ? r->wide : samples)};
  const size_t limit = mixes ? MIXED : 65536;
  const int most = (int)(capacity < limit ? capacity : limit);
  const int made = swr_convert(r->convert, to, most, (const uint8_t **)from, count);
  if (made < 0) return ern_av_fail(r->context, ERN_E_MEDIA, r->decoder.path, "convert its samples", made);
  if (mixes && ern_mono_mix(&r->mono, samples, r->wide, r->channels, (size_t)made, r->options.rate))
    ern_log(r->context, ERN_LOG_WARNING, "%s: " ERN_MONO_WORDS, r->decoder.path);
  for (size_t i = 0; i < (size_t)made * (size_t)r->options.channels; i++)
    if (!isfinite(samples[i]))
      return ern_fail(r->context, ERN_E_NONFINITE, "%s: its sound has a sample that is no finite number",
                      r->decoder.path);
  *frames = (size_t)made;
  return ERN_OK;
}

/* Reads the converter's buffered samples, then the decoder's next frames. */
static ern_status read_some(ern_sound_reader *r, float *samples, size_t capacity, size_t *frames) {
  static const uint8_t nothing[1] = {0};
  const uint8_t *const none[MOST_CHANNELS] = {nothing, nothing, nothing, nothing, nothing, nothing, nothing, nothing};
  ern_status status = ERN_OK;
  if (r->convert != NULL) ERN_TRY(convert(r, r->ended ? NULL : none, 0, samples, capacity, frames));
  while (*frames == 0 && !r->ended) {
    if (asks_to_stop(r)) return ern_fail(r->context, ERN_E_CANCELLED, "%s: stopped", r->decoder.path);
    ERN_TRY(ern_decoder_next(&r->decoder, &r->ended));
    const AVFrame *frame = r->decoder.frame;
    if (r->ended) {
      if (r->convert != NULL) ERN_TRY(convert(r, NULL, 0, samples, capacity, frames));
      break;
    }
    if (r->convert == NULL || frame->sample_rate != r->rate || frame->ch_layout.nb_channels != r->channels ||
        (enum AVSampleFormat)frame->format != r->format)
      ERN_TRY(make_converter(r));
    ERN_TRY(convert(r, (const uint8_t *const *)frame->extended_data, frame->nb_samples, samples, capacity, frames));
  }
fail:
  return or_stopped(r, r->decoder.path, status);
}

ern_status ern_sound_reader_read(ern_sound_reader *reader, float *samples, size_t capacity, size_t *frames) {
  ERN_PLAIN_FLOATS;
  if (frames != NULL) *frames = 0;
  ERN_NEED(NULL, reader);
  ERN_NEED(reader->context, samples);
  ERN_NEED(reader->context, frames);
  if (capacity == 0)
    return ern_fail(reader->context, ERN_E_ARGUMENT, "sound: capacity is 0, expected room for 1 frame or more");
  return read_some(reader, samples, capacity, frames);
}
