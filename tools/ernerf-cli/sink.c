/* SPDX-License-Identifier: MIT */
#include "sink.h"

#include <errno.h>
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

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static bool make_room(struct sink *sink) {
  const size_t pixels = (size_t)sink->width * (size_t)sink->height; /* at most 2^26 */
  if (sink->kind != SINK_EXR) return (sink->rgba = malloc(pixels * 4)) != NULL;
  sink->rgb = malloc(pixels * 3 * sizeof(float));
  sink->alpha = malloc(pixels * sizeof(float));
  sink->depth = malloc(pixels * sizeof(float));
  sink->attention = malloc(pixels * sizeof(float));
  sink->eye = malloc(pixels * sizeof(float));
  sink->channels = malloc(pixels * EXR_CHANNELS * sizeof(float));
  return sink->rgb != NULL && sink->alpha != NULL && sink->depth != NULL && sink->attention != NULL &&
         sink->eye != NULL && sink->channels != NULL;
}

int sink_open(struct sink *sink, struct session *session, int width, int height, bool has_eye, const ern_sound *sound,
              double sound_start) {
  sink->width = width;
  sink->height = height;
  sink->has_eye = has_eye;
  if (!make_room(sink)) return session_fail_with(session, "no memory for a picture of %d x %d", width, height);
  if (sink->kind != SINK_VIDEO) return 0;
  ern_video_options options = ern_video_options_default(width, height);
  options.sound = sound;
  options.sound_start = sound_start;
  if (ern_video_writer_open(session->context, sink->path, &options, &sink->video) != ERN_OK)
    return session_fail(session);
  return 0;
}

ern_frame_output sink_room(const struct sink *sink) {
  return (ern_frame_output){.rgba = sink->rgba,
                            .rgb = sink->rgb,
                            .alpha = sink->alpha,
                            .depth = sink->depth,
                            .attention = sink->attention,
                            .eye = sink->has_eye ? sink->eye : NULL};
}

/* ---- frames ------------------------------------------------------------------------------------------------------ */

static ern_status write_exr(const struct sink *sink, struct session *session, const char *path) {
  static const char *const names[EXR_CHANNELS] = {"R", "G", "B", "A", "Z", "audio_attention", "eye_attention"};
  const size_t pixels = (size_t)sink->width * (size_t)sink->height;
  const size_t channels = sink->has_eye ? EXR_CHANNELS : EXR_CHANNELS - 1;
  for (size_t i = 0; i < pixels; i++) {
    float *to = sink->channels + i * channels;
    memcpy(to, sink->rgb + 3 * i, 3 * sizeof(float));
    to[3] = sink->alpha[i];
    to[4] = sink->depth[i];
    to[5] = sink->attention[i];
    if (sink->has_eye) to[6] = sink->eye[i];
  }
  return ern_image_write_exr(session->context, path, sink->channels, sink->width, sink->height, (int)channels, names);
}

/* The path with the number in place of its mark, which sink_choose has checked. */
static bool numbered_path(const struct sink *sink, size_t number, char path[PATH_BYTES]) {
  const char *percent = strchr(sink->path, '%'), *rest = strchr(percent, 'd') + 1;
  const int digits = percent[1] == '0' ? percent[2] - '0' : 1;
  return snprintf(path, PATH_BYTES, "%.*s%0*zu%s", (int)(percent - sink->path), sink->path, digits, number, rest) <
         PATH_BYTES;
}

static int put_raw(const struct sink *sink, struct session *session) {
  const size_t bytes = (size_t)sink->width * (size_t)sink->height * 4;
  if (fwrite(sink->rgba, 1, bytes, stdout) == bytes && fflush(stdout) == 0) return 0;
  return session_fail_with(session, "standard output: cannot be written: %s", strerror(errno));
}

int sink_put(struct sink *sink, struct session *session, size_t number) {
  char path[PATH_BYTES];
  ern_status status = ERN_OK;
  if (sink->kind == SINK_RAW) return put_raw(sink, session);
  if (sink->kind == SINK_VIDEO) {
    status = ern_video_writer_frame(sink->video, sink->rgba);
  } else {
    if (!numbered_path(sink, number, path)) return session_fail_with(session, "%s: the name is too long", sink->path);
    const ern_image image = {.width = sink->width, .height = sink->height, .channels = 4, .data = sink->rgba};
    status =
        sink->kind == SINK_PNG ? ern_image_write(session->context, path, &image, 100) : write_exr(sink, session, path);
  }
  return status == ERN_OK ? 0 : session_fail(session);
}

int sink_close(struct sink *sink, struct session *session) {
  if (sink->kind != SINK_VIDEO) return 0;
  return ern_video_writer_close(&sink->video) == ERN_OK ? 0 : session_fail(session);
}

void sink_free(struct sink *sink) {
  ern_video_writer_abandon(&sink->video);
  free(sink->rgba);
  free(sink->rgb);
  free(sink->alpha);
  free(sink->depth);
  free(sink->attention);
  free(sink->eye);
  free(sink->channels);
  *sink = (struct sink){0};
}
