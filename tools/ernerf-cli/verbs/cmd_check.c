/* SPDX-License-Identifier: MIT
 * ernerf check: reports what a clip contains, what it lacks, and which effects can be trained on it. */
#include <stdio.h>
#include <stdlib.h>

#include "ernerf/media.h"
#include "session/clip_source.h"
#include "session/effects.h"
#include "session/session.h"
#include "verbs.h"

struct findings {
  struct session *session;
  json_t *list, *effects;
};

static void take_finding(void *user, int ok, const char *sentence) {
  struct findings *findings = user;
  const char *mark = ok > 0 ? "ok" : ok == 0 ? "missing" : "wrong";
  if (!session_json_on_stdout(findings->session) && (ok <= 0 || !findings->session->quiet))
    printf("%-8s %s\n", mark, sentence);
  json_array_append_new(findings->list, json_pack("{s:s, s:o}", "mark", mark, "sentence", session_text(sentence)));
}

/* ---- effects ----------------------------------------------------------------------------------------------------- */

static void take_effect(void *user, const char *name, bool there, const char *sentence) {
  struct findings *findings = user;
  if (!session_json_on_stdout(findings->session) && !findings->session->quiet)
    printf("%-8s %-7s %s\n", there ? "holds" : "lacks", name, sentence);
  json_object_set_new(findings->effects, name,
                      json_pack("{s:b, s:o}", "there", there, "sentence", session_text(sentence)));
}

/* Measures what the clip contains; *measures: the measures as numbers. */
static ern_status look_at_effects(struct findings *findings, const char *path, json_t **measures) {
  ern_clip *clip = NULL;
  ern_clip_measures found;
  ern_status status = ern_clip_open(findings->session->context, path, NULL, &clip);
  if (status == ERN_OK) status = ern_clip_measure(clip, &found);
  if (status == ERN_OK) {
    effects_explain(&found, take_effect, findings);
    *measures = effects_measures(&found);
  }
  ern_clip_free(&clip);
  return status;
}

int cmd_check(int argc, char **argv) {
  struct session session = {0};
  const char *clip = NULL;
  struct option output[SESSION_OUTPUT_OPTIONS];
  struct word words[] = {{"CLIP", &clip, "folder of a preprocessed clip"}};
  struct args args = {
      .verb = "check",
      .summary = "Says what a clip has, what it lacks, what will be learnt and which step makes what is missing.",
      .usage = "check CLIP",
      .notes =
          "Marks: ok, missing (not needed: it says what a training then leaves out), wrong. Exit status 1 where a "
          "training could\n"
          "not start. With --quiet the lines marked ok are left out.\n"
          "Then, of a clip that can be trained on: which effects it holds or lacks, with what was measured. That is\n"
          "what `ernerf train --effects auto` models.",
      .words = words,
      .word_count = 1,
      .groups = {{"Output:", output, SESSION_OUTPUT_OPTIONS}}};
  session_output_options(&session, output);
  int status = args_parse(&args, argc, argv);
  session.inputs[0] = clip;
  if (status < 0) status = session_open(&session, &args);
  if (status >= 0) return status;
  struct findings findings = {.session = &session, .list = json_array(), .effects = json_object()};
  json_t *measures = json_null();
  ern_status found = ern_clip_check(session.context, clip, take_finding, &findings);
  if (found == ERN_OK) found = look_at_effects(&findings, clip, &measures);
  fflush(stdout);
  status = found == ERN_OK ? EXIT_SUCCESS : session_fail(&session);
  const int written =
      session_report(&session, json_pack("{s:o, s:b, s:o, s:o, s:o}", "clip", session_text(clip), "ok", found == ERN_OK,
                                         "findings", findings.list, "effects", findings.effects, "measures", measures));
  session_close(&session);
  return status != EXIT_SUCCESS ? status : written;
}
