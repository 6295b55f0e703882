/* SPDX-License-Identifier: MIT */
#include "output/sink.h"

#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { PATH_BYTES = 4096, EXR_CHANNELS = 7 };

/* ---- names ------------------------------------------------------------------------------------------------------- */

/* A number of digits between '%' and 'd', "" or "05": at most 9, as more are never needed. */
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

int sink_choose(struct sink *sink, const struct args *args, const char *path) {
  const char *dot = strrchr(path, '.');
  *sink = (struct sink){.path = path};
  if (strcmp(path, "-") == 0) {
    sink->kind = SINK_RAW;
    return -1;
  }
  if (dot != NULL && strcmp(dot, ".mp4") == 0) {
    sink->kind = SINK_VIDEO;
    return -1;
  }
  if (dot != NULL && (strcmp(dot, ".png") == 0 || strcmp(dot, ".exr") == 0)) {
    sink->kind = dot[1] == 'p' ? SINK_PNG : SINK_EXR;
    return check_pattern(args, path);
  }
  return args_refuse(
      args, "-o is \"%s\", expected NAME.mp4, numbered pictures such as out/%%05d.png or out/%%05d.exr, or -", path);
}

/* The path with the number in place of its mark, which sink_choose has checked. */
static bool numbered_path(const struct sink *sink, size_t number, char path[PATH_BYTES]) {
  const char *percent = strchr(sink->path, '%'), *rest = strchr(percent, 'd') + 1;
  const int digits = percent[1] == '0' ? percent[2] - '0' : 1;
  return snprintf(path, PATH_BYTES, "%.*s%0*zu%s", (int)(percent - sink->path), sink->path, digits, number, rest) <
         PATH_BYTES;
}

int sink_check(const struct sink *sink, struct session *session, const struct frame_source *frame_source) {
  char path[PATH_BYTES];
  if (sink->kind == SINK_RAW) return 0;
  if (sink->kind == SINK_VIDEO) return frame_source == NULL ? session_check_output(session, sink->path) : 0;
  for (size_t k = 0; k < frame_source->count; k++) {
    if (!numbered_path(sink, frame_source->source_frame[k].number, path))
      return session_fail_with(session, "%s: the name is too long", sink->path);
    if (session_check_output(session, path) != 0) return EXIT_FAILURE;
  }
  return 0;
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

/* Remembers why, for the thread that draws. */
static bool give_up(struct sink *sink, const char *format, ...) ERN_PRINTF(2, 3);
static bool give_up(struct sink *sink, const char *format, ...) {
  char text[PATH_BYTES];
  va_list values;
  va_start(values, format);
  vsnprintf(text, sizeof text, format, values);
  va_end(values);
  sink->trouble = strdup(text);
  return false;
}

static bool write_picture(struct sink *sink, const struct sink_picture *picture) {
  const size_t bytes = (size_t)sink->width * (size_t)sink->height * 4;
  char path[PATH_BYTES];
  ern_status status = ERN_OK;
  if (sink->kind == SINK_RAW) {
    if (fwrite(picture->rgba, 1, bytes, stdout) == bytes && fflush(stdout) == 0) return true;
    return give_up(sink, "standard output: cannot be written: %s", strerror(errno));
  }
  if (sink->kind == SINK_VIDEO) {
    status = ern_video_writer_frame(sink->video, picture->rgba);
  } else {
    (void)numbered_path(sink, picture->number, path); /* fits: sink_check has tried it */
    const ern_image image = {.width = sink->width, .height = sink->height, .channels = 4, .data = picture->rgba};
    status = sink->kind == SINK_PNG ? ern_image_write_provenance(sink->context, path, &image, 100, sink->provenance)
                                    : write_exr(sink, picture, path);
  }
  if (status == ERN_OK) return true;
  (void)ern_last_error_copy(sink->context, path, sizeof path); /* the thread that draws may fail at the same time */
  return give_up(sink, "%s", path);
}

static void *writer_main(void *argument) {
  struct sink *sink = argument;
  for (int place = queue_item(&sink->queue); place != QUEUE_OVER; place = queue_item(&sink->queue)) {
    const double began = session_seconds();
    const bool written = write_picture(sink, &sink->pictures[place]);
    sink->seconds += session_seconds() - began;
    if (!written) {
      queue_break(&sink->queue);
      break;
    }
    queue_empty(&sink->queue);
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

int sink_open(struct sink *sink, struct session *session, int width, int height, struct rate rate,
              const ern_model_info *model, const ern_sound *sound, double sound_start,
              const ern_provenance *provenance) {
  sink->provenance = provenance;
  sink->context = session->context;
  sink->width = width;
  sink->height = height;
  sink->has_attention = model->attention != ERN_ATTENTION_CONCAT;
  sink->has_eye = model->has_eye && model->eye_attention == ERN_EYE_ATTENTION_SIGMOID;
  if (!make_pictures(sink)) return session_fail_with(session, "no memory for pictures of %d x %d", width, height);
  if (sink->kind == SINK_VIDEO) {
    ern_video_options options = ern_video_options_default(width, height);
    options.rate_numerator = rate.numerator;
    options.rate_denominator = rate.denominator;
    options.sound = sound;
    options.sound_start = sound_start;
    options.provenance = provenance;
    if (ern_video_writer_open(session->context, sink->path, &options, &sink->video) != ERN_OK)
      return session_fail(session);
  }
  queue_make(&sink->queue, SINK_PICTURES);
  if (pthread_create(&sink->writer, NULL, writer_main, sink) != 0) {
    queue_free(&sink->queue);
    return session_fail_with(session, "the system refused a thread that writes");
  }
  sink->running = true;
  return 0;
}

/* Waits until the writer is done with what it was given. */
static void end_writer(struct sink *sink) {
  if (!sink->running) return;
  queue_end(&sink->queue);
  pthread_join(sink->writer, NULL);
  queue_free(&sink->queue);
  sink->running = false;
}

static int say_trouble(const struct sink *sink, struct session *session) {
  return session_fail_with(session, "%s", sink->trouble != NULL ? sink->trouble : "no memory while writing");
}

int sink_next(struct sink *sink, struct session *session, ern_frame_output *output) {
  const int place = sink->running ? queue_free_place(&sink->queue) : QUEUE_OVER;
  if (place == QUEUE_OVER) {
    end_writer(sink);
    return say_trouble(sink, session);
  }
  const struct sink_picture *picture = &sink->pictures[place];
  *output = (ern_frame_output){.rgba = picture->rgba,
                               .rgb = picture->rgb,
                               .alpha = picture->alpha,
                               .depth = picture->depth,
                               .attention = sink->has_attention ? picture->attention : NULL,
                               .eye = sink->has_eye ? picture->eye : NULL};
  return 0;
}

void sink_put(struct sink *sink, size_t number) {
  const int place = queue_free_place(&sink->queue); /* that of sink_next */
  if (place == QUEUE_OVER) return;                  /* the next sink_next says why */
  sink->pictures[place].number = number;
  queue_fill(&sink->queue);
}

int sink_close(struct sink *sink, struct session *session) {
  end_writer(sink);
  if (sink->queue.broken) return say_trouble(sink, session);
  if (sink->kind != SINK_VIDEO) return 0;
  return ern_video_writer_close(&sink->video) == ERN_OK ? 0 : session_fail(session);
}

void sink_free(struct sink *sink) {
  if (sink->running) queue_break(&sink->queue);
  end_writer(sink);
  ern_video_writer_abandon(&sink->video);
  for (size_t i = 0; i < SINK_PICTURES; i++) {
    struct sink_picture *picture = &sink->pictures[i];
    free(picture->rgba);
    free(picture->rgb);
    free(picture->alpha);
    free(picture->depth);
    free(picture->attention);
    free(picture->eye);
  }
  free(sink->channels);
  free(sink->trouble);
  *sink = (struct sink){0};
}
