/* SPDX-License-Identifier: MIT */
#include "output/sink.h"

#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

enum { PATH_BYTES = 4096, EXR_CHANNELS = 7, JPEG_QUALITY = 95 };

/* ---- words ------------------------------------------------------------------------------------------------------- */

static const char *const codecs[] = {"h264", "hevc", "vp9", "av1", "ffv1"};
static const char *const presets[] = {"ultrafast", "superfast", "veryfast", "faster",   "fast",
                                      "medium",    "slow",      "slower",   "veryslow", "placebo"};
static const char *const formats[] = {"raw", "y4m", "nut", "mpegts", "flv", "mp4", "matroska"};
enum { COMPRESSED = 3 /* the first of the formats that are */ };

void sink_options(struct sink *sink, struct option options[SINK_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_INT("crf", &sink->crf, 0, 63),
       .help = "quality of a video, the lower the better; of h264 and hevc 51 at most"},
      {ARGS_CHOICE("preset", &sink->preset,
                   "ultrafast|superfast|veryfast|faster|fast|medium|slow|slower|veryslow|placebo"),
       .seldom = true,
       .help = "speed of the encoders of h264 and hevc: slower ones make smaller files (default veryfast)"},
      {ARGS_CHOICE("codec", &sink->codec, "h264|hevc|vp9|av1|ffv1"),
       .help = "codec of a video: .mp4 takes h264, hevc, vp9, av1; .mov h264, hevc; .webm vp9, av1; .mkv all; ffv1 "
               "is lossless (default h264, of a .webm vp9)"},
      {ARGS_CHOICE("format", &sink->format, "raw|y4m|nut|mpegts|flv|mp4|matroska"), .alias = "f",
       .help = "what -o - writes: raw is RGBA8 (default); y4m has no sound, nut is not compressed, the others are h264 "
               "and aac"}};
  sink->crf = ern_video_options_default(1, 1).crf;
  sink->codec = sink->preset = -1;
  ARGS_FILL(options, rows, SINK_OPTIONS);
}

void sink_code_fast(struct sink *sink) {
  const char *dot = strrchr(sink->path, '.');
  if (dot != NULL && strcasecmp(dot, ".webm") == 0) return; /* vp9 */
  sink->preset = 1;                                         /* superfast */
  sink->crf = 16;
}

bool sink_is_opaque(const struct sink *sink) {
  return sink->kind == SINK_VIDEO || sink->kind == SINK_JPEG || sink->kind == SINK_STREAM;
}

bool sink_on_stdout(const struct sink *sink) { return sink->kind == SINK_RAW || sink->kind == SINK_STREAM; }

/* ---- names ------------------------------------------------------------------------------------------------------- */

/* Whether the text between '%' and 'd' is a number format, "" or "05": at most 9 digits. */
static bool is_number_mark(const char *percent) {
  const size_t digits = strspn(percent + 1, "0123456789");
  return percent[1 + digits] == 'd' && (digits == 0 || (digits == 2 && percent[1] == '0' && percent[2] != '0'));
}

static int check_pattern(const struct args *args, const char *path) {
  const char *percent = strchr(path, '%'), *slash = strrchr(path, '/');
  if (percent == NULL || !is_number_mark(percent) || strchr(percent + 1, '%') != NULL ||
      (slash != NULL && percent < slash))
    return args_refuse(args,
                       "-o is \"%s\", expected one %%d or %%0Nd (N from 1 to 9) in the name of the pictures, such as "
                       "out/%%05d.png",
                       path);
  return -1;
}

/* File extensions, compared without regard to case. */
static const struct {
  const char *ending;
  enum sink_kind kind;
} kinds[] = {{".mp4", SINK_VIDEO},  {".m4v", SINK_VIDEO}, {".mov", SINK_VIDEO}, {".mkv", SINK_VIDEO},
             {".webm", SINK_VIDEO}, {".gif", SINK_VIDEO}, {".png", SINK_PNG},   {".jpg", SINK_JPEG},
             {".jpeg", SINK_JPEG},  {".exr", SINK_EXR}};

static bool is_gif(const struct sink *sink) {
  const char *dot = strrchr(sink->path, '.');
  return sink->kind == SINK_VIDEO && dot != NULL && strcasecmp(dot, ".gif") == 0;
}

bool sink_has_sound(const struct sink *sink) {
  if (sink->kind == SINK_STREAM) return strcmp(formats[sink->format], "y4m") != 0;
  return sink->kind == SINK_VIDEO && !is_gif(sink);
}

/* Refuses options that the kind of output does not use. */
static int check_coding(const struct sink *sink, const struct args *args) {
  int status = -1;
  if (sink->kind != SINK_STREAM && sink->kind != SINK_VIDEO) status = args_forbid(args, "crf", "is for a video");
  if (status < 0 && sink->kind == SINK_STREAM && sink->format < COMPRESSED)
    status = args_forbid(args, "crf", "is for a compressed video, which y4m and nut are not");
  if (status < 0 && sink->kind == SINK_VIDEO && sink->codec >= 0 && strcmp(codecs[sink->codec], "ffv1") == 0)
    status = args_forbid(args, "crf", "is for other codecs than ffv1, which is lossless");
  if (status < 0 && sink->kind != SINK_VIDEO)
    status = args_forbid(args, "preset codec", "is for a video that is written to a file");
  if (status < 0 && is_gif(sink)) status = args_forbid(args, "crf preset codec", "is not for a .gif, which has none");
  if (status < 0 && !sink_on_stdout(sink))
    status = args_forbid(args, "format", "is what -o - writes; for a file the ending of its name decides");
  if (status < 0 && sink->kind == SINK_STREAM && sink->crf > 51)
    status = args_refuse(args, "--crf is %d, expected 0 to 51, the range of h264", sink->crf);
  return status;
}

int sink_choose(struct sink *sink, const struct args *args, const char *path) {
  const char *dot = strrchr(path, '.');
  sink->path = path;
  if (strcmp(path, "-") == 0) {
    sink->kind = sink->format == 0 ? SINK_RAW : SINK_STREAM;
    return check_coding(sink, args);
  }
  for (size_t i = 0; dot != NULL && i < sizeof kinds / sizeof *kinds; i++) {
    if (strcasecmp(dot, kinds[i].ending) != 0) continue;
    sink->kind = kinds[i].kind;
    const int status = sink->kind != SINK_VIDEO ? check_pattern(args, path) : -1;
    return status < 0 ? check_coding(sink, args) : status;
  }
  return args_refuse(args,
                     "-o is \"%s\", expected NAME.mp4, .mov, .mkv, .webm or .gif, numbered pictures such as "
                     "out/%%05d.png, .jpg or .exr, or -",
                     path);
}

/* The path with the number in place of %d, which sink_choose has checked. */
static bool numbered_path(const struct sink *sink, size_t number, char path[PATH_BYTES]) {
  const char *percent = strchr(sink->path, '%'), *rest = strchr(percent, 'd') + 1;
  const int digits = percent[1] == '0' ? percent[2] - '0' : 1;
  return snprintf(path, PATH_BYTES, "%.*s%0*zu%s", (int)(percent - sink->path), sink->path, digits, number, rest) <
         PATH_BYTES;
}

/* Locks the range `number` .. `number` + `count` - 1 of the lock file, a byte for each picture. */
static bool lock_range(int file, size_t number, size_t count) {
  struct flock range = {
      .l_type = F_WRLCK, .l_whence = SEEK_SET, .l_start = (off_t)number, .l_len = (off_t)count /* 0: all */};
  return fcntl(file, F_SETLK, &range) == 0 || (errno != EAGAIN && errno != EACCES); /* no locks here: as if locked */
}

/* Locks the pictures that are written: a second process with --overwrite would mix its own into them. All ranges have
 * one file, NAMEall.png.claim.ernerf-tmp. Where that name is too long there is no lock. */
static int claim(struct sink *sink, struct session *session, const struct frame_source *frame_source) {
  char name[PATH_BYTES + 32], first[PATH_BYTES];
  struct stat opened, named;
  const size_t number = frame_source->source_frame[0].number;
  const char *percent = strchr(sink->path, '%'), *rest = strchr(percent, 'd') + 1;
  snprintf(name, sizeof name, "%.*sall%s.claim.ernerf-tmp", (int)(percent - sink->path), sink->path, rest);
  for (;;) {
    sink->claim = open(name, O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0666);
    if (sink->claim < 0 && errno == ENAMETOOLONG) return 0;
    if (sink->claim < 0) {
      const int error = errno;
      (void)numbered_path(sink, number, first);
      return session_fail_with(session, "%s: cannot write: %s", first, strerror(error));
    }
    const bool locked = lock_range(sink->claim, number, frame_source->count);
    /* a process that held a lock may have removed the file in between */
    if (locked && fstat(sink->claim, &opened) == 0 && lstat(name, &named) == 0 && opened.st_ino == named.st_ino) break;
    (void)close(sink->claim);
    if (!locked) return session_fail_with(session, "%s: another process writes these pictures", sink->path);
  }
  sink->claim_name = strdup(name);
  if (sink->claim_name != NULL) return 0;
  if (lock_range(sink->claim, 0, 0)) (void)unlink(name);
  (void)close(sink->claim);
  return session_fail_with(session, "%s: no memory for its lock", sink->path);
}

/* A file with contents is not this program's, and one with another process's lock stays. */
static void release_claim(const struct sink *sink) {
  struct stat about;
  if (sink->claim_name == NULL) return;
  if (fstat(sink->claim, &about) == 0 && about.st_size == 0 && lock_range(sink->claim, 0, 0))
    (void)unlink(sink->claim_name);
  (void)close(sink->claim);
}

int sink_check(struct sink *sink, struct session *session, const struct frame_source *frame_source) {
  char path[PATH_BYTES];
  if (sink_on_stdout(sink)) return 0;
  if (sink->kind == SINK_VIDEO) return frame_source == NULL ? session_check_output(session, sink->path) : 0;
  for (size_t k = 0; k < frame_source->count; k++) {
    if (!numbered_path(sink, frame_source->source_frame[k].number, path))
      return session_fail_with(session, "%s: the name is too long", sink->path);
    if (session_check_output(session, path) != 0) return EXIT_FAILURE;
  }
  return frame_source->count > 0 ? claim(sink, session, frame_source) : 0;
}

/* ---- writing: the writer's thread -------------------------------------------------------------------------------- */

static ern_status write_exr(const struct sink *sink, const struct sink_picture *picture, const char *path) {
  const char *names[EXR_CHANNELS] = {"R", "G", "B", "A", "Z"};
  const float *more[EXR_CHANNELS] = {[3] = picture->alpha, [4] = picture->depth};
  const size_t pixels = (size_t)sink->width * (size_t)sink->height;
  size_t channels = 5;
  if (sink->has_attention) names[channels] = "audio_attention", more[channels++] = picture->attention;
  if (sink->has_eye) names[channels] = "eye_attention", more[channels++] = picture->eye;
  for (size_t i = 0; i < pixels; i++) {
    float *to = sink->channels + i * channels;
    memcpy(to, picture->rgb + 3 * i, 3 * sizeof(float));
    for (size_t c = 3; c < channels; c++) to[c] = more[c][i];
  }
  return ern_image_write_exr_provenance(sink->context, path, sink->channels, sink->width, sink->height, (int)channels,
                                        names, sink->provenance);
}

/* Stores the error for the drawing thread. */
static bool give_up(struct sink *sink, const char *format, ...) ERN_PRINTF(2, 3);
static bool give_up(struct sink *sink, const char *format, ...) {
  char text[PATH_BYTES];
  va_list values;
  va_start(values, format);
  vsnprintf(text, sizeof text, format, values);
  va_end(values);
  sink->error = strdup(text);
  return false;
}

/* Writes picture `streamed` with its samples: from its time to the next picture's; silence after the sound's end. */
static ern_status write_streamed(struct sink *sink, const uint8_t *rgba) {
  const ern_sound *sound = sink->sound;
  size_t count = 0;
  if (sound != NULL) {
    const size_t channels = (size_t)sound->channels;
    const double each = (double)sound->rate / rate_value(sink->rate);
    const size_t from = (size_t)((double)sink->streamed * each + 0.5),
                 to = (size_t)((double)(sink->streamed + 1) * each + 0.5);
    count = to - from;
    for (size_t i = 0; i < count * channels; i++) {
      const size_t frame = sink->first + from + i / channels;
      sink->samples[i] = frame < sound->frames ? (float)sound->data[frame * channels + i % channels] / 32768 : 0;
    }
  }
  sink->streamed++;
  return ern_stream_writer_frame(sink->stream, rgba, sink->samples, count);
}

/* Converts RGBA to RGB in place; the writer owns the picture until it is returned. */
static void drop_alpha(uint8_t *rgba, size_t pixels) {
  for (size_t i = 1; i < pixels; i++) memmove(rgba + 3 * i, rgba + 4 * i, 3);
}

/* Writes the picture of a video, and gives its recorded frame back. */
static ern_status write_video(struct sink *sink, struct sink_picture *picture) {
  if (picture->recorded == NULL) return ern_video_writer_frame(sink->video, picture->rgba);
  const ern_status status = ern_video_writer_patch(sink->video, picture->recorded,
                                                   picture->part[2] > 0 ? picture->part : NULL, picture->rgba);
  ern_video_frame_free(&picture->recorded);
  return status;
}

static bool write_picture(struct sink *sink, struct sink_picture *picture) {
  const size_t bytes = (size_t)sink->width * (size_t)sink->height * 4;
  char path[PATH_BYTES];
  ern_status status = ERN_OK;
  if (sink->kind == SINK_RAW) {
    if (fwrite(picture->rgba, 1, bytes, stdout) == bytes && fflush(stdout) == 0) return true;
    return give_up(sink, "standard output: cannot be written: %s", strerror(errno));
  }
  if (sink->kind == SINK_VIDEO) {
    status = write_video(sink, picture);
  } else if (sink->kind == SINK_STREAM) {
    status = write_streamed(sink, picture->rgba);
  } else {
    (void)numbered_path(sink, picture->number, path); /* fits: checked by sink_check */
    const bool jpeg = sink->kind == SINK_JPEG;
    const ern_image image = {
        .width = sink->width, .height = sink->height, .channels = jpeg ? 3 : 4, .data = picture->rgba};
    if (jpeg) drop_alpha(picture->rgba, bytes / 4);
    status = sink->kind == SINK_EXR
                 ? write_exr(sink, picture, path)
                 : ern_image_write_provenance(sink->context, path, &image, JPEG_QUALITY, sink->provenance);
  }
  if (status == ERN_OK) return true;
  (void)ern_last_error_copy(sink->context, path, sizeof path); /* the drawing thread may fail at the same time */
  return give_up(sink, "%s", path);
}

static void *writer_main(void *argument) {
  struct sink *sink = argument;
  for (int place = queue_wait_for_item(&sink->queue); place != QUEUE_CLOSED;
       place = queue_wait_for_item(&sink->queue)) {
    const double began = session_seconds();
    const bool written = write_picture(sink, &sink->pictures[place]);
    sink->seconds += session_seconds() - began;
    if (!written) {
      queue_break(&sink->queue);
      break;
    }
    queue_pop(&sink->queue);
  }
  return NULL;
}

/* ---- opening and closing ----------------------------------------------------------------------------------------- */

static bool make_picture(const struct sink *sink, struct sink_picture *picture) {
  const size_t pixels = (size_t)sink->width * (size_t)sink->height; /* at most 2^26 */
  if (sink->kind != SINK_EXR) return (picture->rgba = malloc(pixels * 4)) != NULL;
  picture->rgb = malloc(pixels * 3 * sizeof(float));
  picture->alpha = malloc(pixels * sizeof(float));
  picture->depth = malloc(pixels * sizeof(float));
  picture->attention = malloc(pixels * sizeof(float));
  picture->eye = malloc(pixels * sizeof(float));
  return picture->rgb != NULL && picture->alpha != NULL && picture->depth != NULL && picture->attention != NULL &&
         picture->eye != NULL;
}

static bool make_pictures(struct sink *sink) {
  const size_t pixels = (size_t)sink->width * (size_t)sink->height;
  bool made = true;
  for (size_t i = 0; i < SINK_PICTURES; i++) made = made && make_picture(sink, &sink->pictures[i]);
  if (sink->kind != SINK_EXR) return made;
  sink->channels = malloc(pixels * EXR_CHANNELS * sizeof(float));
  return made && sink->channels != NULL;
}

static int open_video(struct sink *sink, struct session *session, const ern_sound *sound, double sound_start) {
  ern_video_options options = ern_video_options_default(sink->width, sink->height);
  options.rate_numerator = sink->rate.numerator;
  options.rate_denominator = sink->rate.denominator;
  options.sound = sound;
  options.sound_start = sound_start;
  options.provenance = sink->provenance;
  options.crf = sink->crf;
  if (sink->pixel_aspect > 0) options.pixel_aspect = sink->pixel_aspect;
  if (sink->codec >= 0) options.codec = codecs[sink->codec];
  if (sink->preset >= 0) options.preset = presets[sink->preset];
  return ern_video_writer_open(session->context, sink->path, &options, &sink->video) == ERN_OK ? 0
                                                                                               : session_fail(session);
}

static int open_stream(struct sink *sink, struct session *session, const ern_sound *sound, double sound_start) {
  ern_stream_options options = ern_stream_options_default(sink->width, sink->height);
  options.rate_numerator = sink->rate.numerator;
  options.rate_denominator = sink->rate.denominator;
  options.format = formats[sink->format];
  options.provenance = sink->provenance;
  options.crf = sink->crf;
  if (sound != NULL) {
    const size_t most = (size_t)(sound->rate / rate_value(sink->rate)) + 2; /* of a picture */
    options.sound_rate = sound->rate;
    options.sound_channels = sound->channels;
    sink->sound = sound;
    sink->first = (size_t)(sound_start * sound->rate + 0.5);
    sink->samples = malloc(most * (size_t)sound->channels * sizeof *sink->samples);
    if (sink->samples == NULL) return session_fail_with(session, "no memory for the sound of a picture");
  }
  return ern_stream_writer_open(session->context, "-", &options, &sink->stream) == ERN_OK ? 0 : session_fail(session);
}

int sink_open(struct sink *sink, struct session *session, int width, int height, struct rate rate,
              const ern_model_info *model, const ern_sound *sound, double sound_start,
              const ern_provenance *provenance) {
  sink->provenance = provenance;
  sink->context = session->context;
  sink->width = width;
  sink->height = height;
  sink->rate = rate;
  sink->has_attention = model->attention != ERN_ATTENTION_CONCAT;
  sink->has_eye = model->has_eye && model->eye_attention == ERN_EYE_ATTENTION_SIGMOID;
  if (!make_pictures(sink)) return session_fail_with(session, "no memory for pictures of %d x %d", width, height);
  if (sink->kind == SINK_VIDEO && open_video(sink, session, sound, sound_start) != 0) return EXIT_FAILURE;
  if (sink->kind == SINK_STREAM && open_stream(sink, session, sound, sound_start) != 0) return EXIT_FAILURE;
  queue_make(&sink->queue, SINK_PICTURES);
  if (pthread_create(&sink->writer, NULL, writer_main, sink) != 0)
    return session_fail_with(session, "the system refused a thread that writes");
  sink->running = true;
  return 0;
}

/* Waits until the writer has written the queued pictures. */
static void end_writer(struct sink *sink) {
  if (!sink->running) return;
  queue_end(&sink->queue);
  pthread_join(sink->writer, NULL);
  sink->running = false;
}

static int report_error(const struct sink *sink, struct session *session) {
  return session_fail_with(session, "%s", sink->error != NULL ? sink->error : "no memory while writing");
}

int sink_next(struct sink *sink, struct session *session, ern_frame_output *output) {
  const int place = sink->running ? queue_wait_for_slot_of(&sink->queue, sink->begun) : QUEUE_CLOSED;
  if (place == QUEUE_CLOSED) {
    end_writer(sink);
    return report_error(sink, session);
  }
  const struct sink_picture *picture = &sink->pictures[place];
  sink->begun++;
  *output = (ern_frame_output){.rgba = picture->rgba,
                               .rgb = picture->rgb,
                               .alpha = picture->alpha,
                               .depth = picture->depth,
                               .attention = sink->has_attention ? picture->attention : NULL,
                               .eye = sink->has_eye ? picture->eye : NULL};
  return 0;
}

void sink_put(struct sink *sink, size_t number) {
  const int place = queue_wait_for_slot(&sink->queue); /* the place of the oldest sink_next */
  if (place == QUEUE_CLOSED) return;                   /* the next sink_next reports the error */
  sink->pictures[place].number = number;
  queue_push(&sink->queue);
}

bool sink_takes_recorded(const struct sink *sink) {
  return sink->kind == SINK_VIDEO && !is_gif(sink) && (sink->codec < 0 || strcmp(codecs[sink->codec], "ffv1") != 0);
}

int sink_put_patched(struct sink *sink, struct session *session, const ern_video_frame *recorded, const int part[4]) {
  const int place = queue_wait_for_slot(&sink->queue); /* the place of the oldest sink_next */
  if (place == QUEUE_CLOSED) return 0;                 /* the next sink_next reports the error */
  struct sink_picture *picture = &sink->pictures[place];
  if (ern_video_frame_clone(session->context, recorded, &picture->recorded) != ERN_OK) return session_fail(session);
  memcpy(picture->part, part, sizeof picture->part);
  queue_push(&sink->queue);
  return 0;
}

int sink_close(struct sink *sink, struct session *session) {
  end_writer(sink);
  if (sink->queue.broken) return report_error(sink, session);
  if (sink->kind == SINK_STREAM) return ern_stream_writer_close(&sink->stream) == ERN_OK ? 0 : session_fail(session);
  if (sink->kind != SINK_VIDEO) return 0;
  return ern_video_writer_close(&sink->video) == ERN_OK ? 0 : session_fail(session);
}

void sink_free(struct sink *sink) {
  if (sink->running) queue_break(&sink->queue);
  end_writer(sink);
  if (sink->queue.places > 0) queue_free(&sink->queue);
  ern_video_writer_abandon(&sink->video);
  ern_stream_writer_abandon(&sink->stream);
  free(sink->samples);
  for (size_t i = 0; i < SINK_PICTURES; i++) {
    struct sink_picture *picture = &sink->pictures[i];
    ern_video_frame_free(&picture->recorded);
    free(picture->rgba);
    free(picture->rgb);
    free(picture->alpha);
    free(picture->depth);
    free(picture->attention);
    free(picture->eye);
  }
  free(sink->channels);
  free(sink->error);
  release_claim(sink);
  free(sink->claim_name);
  *sink = (struct sink){0};
}
