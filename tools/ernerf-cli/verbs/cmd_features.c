/* SPDX-License-Identifier: MIT
 * ernerf features: speech features of a sound. */
#include <stdio.h>
#include <stdlib.h>

#include "ernerf/media.h"
#include "ernerf/speech.h"
#include "session/session.h"
#include "verbs.h"

static int make(struct session *session, const char *sound, const char *out, float warp) {
  ern_features features = {0};
  const double began = session_seconds();
  if (session_check_output(session, out) != 0) return EXIT_FAILURE;
  ern_status status = ern_speech_features(session->context, sound, warp, &features);
  if (status == ERN_OK) status = ern_features_save(session->context, out, &features);
  const size_t windows = features.windows;
  const int length = features.window_length, width = features.width;
  ern_features_free(session->context, &features);
  if (status != ERN_OK) return session_fail(session);
  session_note(session, "%s: %s, %zu windows of %d rows of %d values, for %.2f s of sound", out, ERN_SPEECH_CEPSTRA,
               windows, length, width, (double)windows / 25);
  return session_report(
      session, json_pack("{s:o, s:o, s:s, s:I, s:i, s:i, s:o}", "in", session_text(sound), "out", session_text(out),
                         "kind", ERN_SPEECH_CEPSTRA, "windows", (json_int_t)windows, "window_length", length, "width",
                         width, "seconds", session_number(session_seconds() - began)));
}

int cmd_features(int argc, char **argv) {
  struct session session = {0};
  const char *sound = NULL, *out = NULL;
  float warp = 1;
  struct option own[] = {{.name = "o",
                          .alias = "output",
                          .kind = OPTION_TEXT,
                          .target = &out,
                          .choices = "FILE.npy",
                          .help = "the features; a clip takes them as aud_cep.npy"},
                         {.name = "warp",
                          .kind = OPTION_FLOAT,
                          .target = &warp,
                          .low = 0.5,
                          .high = 2,
                          .help = "factor of all frequencies that are listened at, as of another throat"}};
  struct option output[SESSION_OUTPUT_OPTIONS];
  struct word words[] = {{"SOUND", &sound, "wav, mp3, mp4 or whatever else FFmpeg reads, up to 4 hours"}};
  struct args args = {
      .verb = "features",
      .summary = "Makes speech features of a sound: what a head is trained on and speaks from.",
      .usage = "features SOUND -o aud_cep.npy",
      .notes =
          "train, eval and render take a sound where they take features, so this verb is for looking at them and\n"
          "for clips without their sound.",
      .words = words,
      .word_count = 1,
      .groups = {{"The features:", own, sizeof own / sizeof *own}, {"Output:", output, SESSION_OUTPUT_OPTIONS}}};
  session_output_options(&session, output);
  int status = args_parse(&args, argc, argv);
  if (status < 0 && out == NULL) status = args_refuse(&args, "-o FILE.npy is missing");
  session.inputs[0] = sound;
  if (status < 0) status = session_open(&session, &args);
  if (status >= 0) return status;
  status = make(&session, sound, out, warp);
  session_close(&session);
  return status;
}
