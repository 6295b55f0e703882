/* SPDX-License-Identifier: MIT */
#include "session/clip_source.h"

void clip_source_options(struct clip_source *source, struct option options[CLIP_SOURCE_OPTIONS]) {
  const struct option rows[] = {
      {.name = "asr_model",
       .kind = OPTION_TEXT,
       .target = &source->asr_model,
       .choices = "NAME",
       .help = "which features of the clip: deepspeech, esperanto, hubert, cepstra (from its sound; default the first "
               "that is "
               "there)"},
      {.name = "memory",
       .kind = OPTION_BYTES,
       .target = &source->memory,
       .help = "most that frames of the clip may take, such as 512M (default half of the memory it may use)"}};
  ARGS_FILL(options, rows, CLIP_SOURCE_OPTIONS);
}

int clip_source_open(const struct clip_source *source, struct session *session, ern_clip **clip) {
  ern_clip_options options = ern_clip_options_default();
  options.memory_bytes = source->memory;
  options.features = source->features;
  options.asr_model = source->asr_model;
  return ern_clip_open(session->context, source->path, &options, clip) == ERN_OK ? 0 : session_fail(session);
}
