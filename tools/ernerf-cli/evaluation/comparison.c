/* SPDX-License-Identifier: MIT */
#include "evaluation/comparison.h"

#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* Whether the frames are consecutive. */
static bool follow(const struct frame_source *source) {
  for (size_t k = 1; k < source->count; k++)
    if (source->source_frame[k].pose.img_id != source->source_frame[k - 1].pose.img_id + 1) return false;
  return source->count > 0;
}

int comparison_open(struct comparison *comparison, const struct evaluation *evaluation, size_t drawn, const char *path,
                    const char *sound) {
  struct session *session = comparison->session = evaluation->session;
  const int width = (int)(drawn + 1) * evaluation->info.width, height = evaluation->info.height;
  comparison->rgba = malloc(4 * (size_t)width * (size_t)height);
  if (comparison->rgba == NULL) return session_fail_with(session, "no memory for a picture of %d x %d", width, height);
  comparison->drawn = drawn;
  const ern_provenance made = ern_provenance_default(); /* drawn frames beside true ones */
  ern_video_options options = ern_video_options_default(width, height);
  options.provenance = &made;
  if (sound != NULL && access(sound, F_OK) == 0 && follow(&evaluation->frame_source)) {
    if (ern_sound_read(session->context, sound, &comparison->sound) != ERN_OK) return session_fail(session);
    options.sound = &comparison->sound;
    options.sound_start = frame_source_seconds(&evaluation->frame_source, 0);
  }
  if (ern_video_writer_open(session->context, path, &options, &comparison->writer) != ERN_OK)
    return session_fail(session);
  return 0;
}

int comparison_add(struct comparison *comparison, const struct evaluation *evaluation, const uint8_t *const *drawn,
                   size_t k) {
  const struct source_frame *frame = &evaluation->frame_source.source_frame[k];
  const size_t width = (size_t)evaluation->info.width, height = (size_t)evaluation->info.height;
  ern_image truth = {0};
  if (evaluate_truth(evaluation, frame, &truth) != 0) return EXIT_FAILURE;
  for (size_t y = 0; y < height; y++) {
    uint8_t *to = comparison->rgba + 4 * (comparison->drawn + 1) * y * width;
    for (size_t i = 0; i < comparison->drawn; i++, to += 4 * width) memcpy(to, drawn[i] + 4 * y * width, 4 * width);
    for (size_t x = 0; x < width; x++) {
      memcpy(to + 4 * x, truth.data + 3 * (y * width + x), 3);
      to[4 * x + 3] = 255;
    }
  }
  if (ern_video_writer_frame(comparison->writer, comparison->rgba) != ERN_OK) return session_fail(comparison->session);
  return 0;
}

int comparison_finish(struct comparison *comparison) {
  return ern_video_writer_close(&comparison->writer) == ERN_OK ? 0 : session_fail(comparison->session);
}

void comparison_close(struct comparison *comparison) {
  if (comparison->session == NULL) return;
  ern_video_writer_abandon(&comparison->writer);
  ern_sound_free(comparison->session->context, &comparison->sound);
  free(comparison->rgba);
}
