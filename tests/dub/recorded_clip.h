/* SPDX-License-Identifier: MIT
 * The record that `ernerf prepare` would write of a made-up clip and its video, and a video whose frames can be told
 * apart. */
#ifndef ERN_TESTS_RECORDED_CLIP_H
#define ERN_TESTS_RECORDED_CLIP_H

#include "e2e/cli.h"

#include "ernerf/media.h"
#include "ernerf/model.h"

/* clip/prepare.json: the clip has `frames` frames of the video clip.mp4 from second `from` on, and is its square of
 * side x side pixels at column x. hash: NULL: that of clip.mp4. */
static inline void recorded_clip_write(const char *hash, double from, int x, int side, int frames) {
  ern_context *context = support_context();
  static const char *const steps[] = {"face", "pose", "landmarks", "layers", "eyes", "features"};
  char text[2048], done[1024] = "", own[65];
  struct stat about;
  assert_int_equal(stat("clip.mp4", &about), 0);
  support_ok(context, ern_file_sha256(context, "clip.mp4", own));
  for (size_t i = 0; i < sizeof steps / sizeof *steps; i++)
    snprintf(done + strlen(done), sizeof done - strlen(done), "%s\"%s\": {\"verdict\": \"good\", \"words\": \"\"}",
             i > 0 ? ", " : "", steps[i]);
  const int bytes = snprintf(
      text, sizeof text,
      "{\"version\": 2, \"video\": \"clip.mp4\", \"source\": {\"bytes\": %lld, \"from\": %.2f}, \"frames\": %d,"
      " \"steps\": {%s}, \"crop\": {\"x\": %d, \"y\": 0, \"width\": %d, \"side\": %d, \"sha256\": \"%s\"}}",
      (long long)about.st_size, from, frames, done, x, side, side, hash != NULL ? hash : own);
  cli_replace("clip/prepare.json", text, (size_t)bytes);
  ern_context_free(&context);
}

/* Of e2e/shared_clips: the clip as clip, 16 frames of 96 x 96 pixels; its video as clip.mp4, if wanted; its head as
 * h.safetensors. */
static inline void recorded_clip_take(bool with_video) {
  char path[2048];
  cli_shared_clip("recorded", "clip");
  cli_shared_model("recorded_head", "h");
  cli_shared_path(path, "recorded.mp4");
  if (with_video) assert_int_equal(symlink(path, "clip.mp4"), 0);
}

/* Frame k is grey, 15 k: `frames` is at most 17. */
static inline void recorded_clip_grey(const char *path, double pixel_aspect, int width, int height, int frames) {
  ern_context *context = support_context();
  const size_t bytes = (size_t)width * (size_t)height * 4;
  uint8_t *rgba = malloc(bytes);
  ern_video_options options = ern_video_options_default(width, height);
  ern_video_writer *writer = NULL;
  assert_non_null(rgba);
  options.pixel_aspect = pixel_aspect;
  support_ok(context, ern_video_writer_open(context, path, &options, &writer));
  for (int k = 0; k < frames; k++) {
    memset(rgba, 15 * k, bytes);
    support_ok(context, ern_video_writer_frame(writer, rgba));
  }
  support_ok(context, ern_video_writer_close(&writer));
  free(rgba);
  ern_context_free(&context);
}

#endif
