/* SPDX-License-Identifier: MIT
 * ernerf features: computes the speech features of a sound. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ernerf/media.h"
#include "ernerf/speech.h"
#include "session/speech_model.h"
#include "verbs.h"

struct features_job {
  struct session session;
  struct speech_model speech_model;
  const char *sound, *out;
  int cepstra; /* 0: articulatory */
  float warp;
};

static int make(struct features_job *job) {
  struct session *session = &job->session;
  struct speech_model *speech_model = &job->speech_model;
  ern_features features = {0};
  const double began = session_seconds();
  session->makes_features = true;
  if (session_check_output(session, job->out) != 0 || speech_model_open(speech_model, session, NULL, NULL) != 0)
    return EXIT_FAILURE;
  const char *kind = speech_model->network != NULL ? ern_speech_network_kind(speech_model->network)
                     : job->cepstra                ? ERN_SPEECH_CEPSTRA
                                                   : ERN_SPEECH_ARTICULATORY;
  ern_status status = speech_model->network != NULL
                          ? ern_speech_network_features(speech_model->network, job->sound, &features)
                          : ern_speech_features_kind(session->context, job->sound, kind, job->warp, &features);
  if (status == ERN_OK) status = ern_features_save(session->context, job->out, &features);
  const size_t windows = features.windows;
  const int length = features.window_length, width = features.width;
  ern_features_free(session->context, &features);
  if (status != ERN_OK) return speech_model_fail(session, status);
  session_note(session, "%s: %s, %zu windows of %d rows of %d values, for %.2f s of sound", job->out, kind, windows,
               length, width, (double)windows / 25);
  return session_report(
      session, json_pack("{s:o, s:o, s:s, s:I, s:i, s:i, s:o}", "in", session_text(job->sound), "out",
                         session_text(job->out), "kind", kind, "windows", (json_int_t)windows, "window_length", length,
                         "width", width, "seconds", session_number(session_seconds() - began)));
}

int cmd_features(int argc, char **argv) {
  struct features_job job = {.warp = 1};
  struct option own[] = {
      {ARGS_TEXT("o", &job.out), .alias = "output", .choices = "FILE.npy",
       .help = "the features; in a clip their file has the name aud_art.npy, aud_cep.npy for "
               "cepstra, or aud_eo.npy or aud_hu.npy for those of a network"},
      {ARGS_CHOICE("kind", &job.cepstra, "articulatory|cepstra"), .help = "built-in kind (default articulatory)"},
      {ARGS_FLOAT("warp", &job.warp, 0.5, 2),
       .help = "factor of all frequencies, 0.5 to 2, as if the speaker's vocal tract had another "
               "length; only for built-in kinds"}};
  struct option network[SPEECH_MODEL_OPTIONS], output[SESSION_OUTPUT_OPTIONS];
  struct word words[] = {{"SOUND", &job.sound, "wav, mp3, mp4 or whatever else FFmpeg reads, up to 4 hours"}};
  struct args args = {
      .verb = "features",
      .summary = "Computes the speech features of a sound, from which a head is trained and rendered.",
      .usage =
          "features SOUND [--kind cepstra] -o aud_art.npy\n"
          "features SOUND --speech-model FILE.onnx [--speech-preset NAME|FILE.json] -o aud_eo.npy",
      .notes =
          "train, eval and render take a sound where they take features, so this verb is for looking at them and\n"
          "for clips without their sound.",
      .words = words,
      .word_count = 1,
      .groups = {{"The features:", own, sizeof own / sizeof *own},
                 {"A network:", network, SPEECH_MODEL_OPTIONS},
                 {"Output:", output, SESSION_OUTPUT_OPTIONS}}};
  speech_model_options(&job.speech_model, network);
  session_output_options(&job.session, output);
  int status = args_parse(&args, argc, argv);
  if (status < 0 && job.out == NULL) status = args_refuse(&args, "-o FILE.npy is missing");
  const char *dot = job.out != NULL ? strrchr(job.out, '.') : NULL;
  if (status < 0 && (dot == NULL || strcmp(dot, ".npy") != 0))
    status = args_refuse(&args, "-o is \"%s\", expected a name that ends in .npy", job.out);
  if (status < 0) status = speech_model_check(&job.speech_model, &args, job.sound);
  if (status < 0 && job.speech_model.path != NULL)
    status = args_forbid(&args, "warp kind", "is for built-in kinds, and --speech-model is a network of yours");
  job.session.inputs[0] = job.sound;
  job.session.inputs[1] = job.speech_model.path;
  job.session.inputs[2] = speech_model_file(&job.speech_model);
  if (status < 0) status = session_open(&job.session, &args);
  if (status >= 0) return status;
  status = make(&job);
  speech_model_close(&job.speech_model);
  session_close(&job.session);
  return status;
}
