/* SPDX-License-Identifier: MIT */
#include "clip_source.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

void clip_source_options(struct clip_source *source, struct option options[CLIP_SOURCE_OPTIONS]) {
  const struct option rows[] = {
      {.name = "asr_model",
       .kind = OPTION_TEXT,
       .target = &source->asr_model,
       .choices = "NAME",
       .help = "which features of the clip: deepspeech, esperanto, hubert (default the first that is there)"},
      {.name = "memory",
       .kind = OPTION_BYTES,
       .target = &source->memory,
       .help = "most that frames of the clip may take, such as 512M (default half of the memory it may use)"}};
  ARGS_FILL(options, rows, CLIP_SOURCE_OPTIONS);
}

int clip_source_keep(struct session *session, const char *clip, const char *output) {
  static const char *const files[] = {"transforms_train.json", "transforms_val.json"};
  static const char *const folders[] = {"gt_imgs", "torso_imgs", "ori_imgs"};
  char path[4096], folder[4096] = ".";
  struct stat one, other;
  if (output == NULL || strcmp(output, "-") == 0) return 0;
  for (size_t i = 0; i < sizeof files / sizeof *files; i++) {
    snprintf(path, sizeof path, "%s/%s", clip, files[i]);
    if (session_keep(session, path, output) != 0) return EXIT_FAILURE;
  }
  const char *slash = strrchr(output, '/');
  if (slash != NULL) snprintf(folder, sizeof folder, "%.*s", (int)(slash - output) + 1, output);
  for (size_t i = 0; i < sizeof folders / sizeof *folders; i++) {
    snprintf(path, sizeof path, "%s/%s", clip, folders[i]);
    if (stat(path, &one) != 0 || stat(folder, &other) != 0 || one.st_dev != other.st_dev || one.st_ino != other.st_ino)
      continue;
    return session_fail_with(session, "%s: lies among the clip's pictures in %s, expected another folder", output,
                             path);
  }
  return 0;
}

int clip_source_open(const struct clip_source *source, struct session *session, ern_clip **clip) {
  ern_clip_options options = ern_clip_options_default();
  options.memory_bytes = source->memory;
  options.features = source->features;
  options.asr_model = source->asr_model;
  if (clip_source_keep(session, source->path, session->json) != 0) return EXIT_FAILURE;
  return ern_clip_open(session->context, source->path, &options, clip) == ERN_OK ? 0 : session_fail(session);
}
