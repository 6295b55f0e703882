/* SPDX-License-Identifier: MIT */
#include "session/clip_source.h"

#include <stdlib.h>

void clip_source_options(struct clip_source *source, struct option options[CLIP_SOURCE_OPTIONS]) {
  const struct option rows[] = {{ARGS_TEXT("asr-model", &source->asr_model), .choices = "NAME",
                                 .help = "kind of the clip's speech features: deepspeech, esperanto, hubert, "
                                         "articulatory or cepstra (default: the first that there is of aud_ds.npy, "
                                         "aud_eo.npy, aud_hu.npy, aud.npy, aud_cep.npy, aud_art.npy, and aud.wav, from "
                                         "which articulatory features are computed)"},
                                {ARGS_BYTES("memory", &source->memory), .seldom = true,
                                 .help = "maximum memory for decoded frames of the clip, such as 512M (default half of "
                                         "the memory that the process may use)"}};
  ARGS_FILL(options, rows, CLIP_SOURCE_OPTIONS - SPEECH_MODEL_OPTIONS);
  speech_model_options(&source->speech_model, options + sizeof rows / sizeof *rows);
}

int clip_source_open(struct clip_source *source, struct session *session, ern_clip **clip) {
  ern_clip_options options = ern_clip_options_default();
  if (speech_model_open(&source->speech_model, session, NULL, NULL) != 0) return EXIT_FAILURE;
  options.memory_bytes = source->memory;
  options.features = source->features;
  options.asr_model = source->asr_model;
  if (source->asr_model == NULL) options.network = source->speech_model.network;
  const ern_status status = ern_clip_open(session->context, source->path, &options, clip);
  return status == ERN_OK ? 0 : speech_model_fail(session, status);
}
