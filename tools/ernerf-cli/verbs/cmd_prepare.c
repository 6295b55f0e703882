/* SPDX-License-Identifier: MIT
 * ernerf prepare: makes a clip from a video. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "session/prepare_library.h"
#include "session/progress.h"
#include "verbs.h"

struct prepare_job {
  struct session session;
  struct progress progress;
  const char *step; /* the step whose progress is shown */
  ern_prepare_options options;
  float from, to, focal; /* values of the command line */
  int only;
  const char *video, *folder;
};

static const char only_choices[] = "face|pose|landmarks|layers|eyes|features";
static const char *const steps[ERN_PREPARE_STEPS] = {"face", "pose", "landmarks", "layers", "eyes", "features"};

static int say_progress(void *user, const char *step, size_t done, size_t total) {
  struct prepare_job *job = user;
  if (job->step == NULL || strcmp(job->step, step) != 0) {
    if (job->step != NULL) progress_end(&job->progress);
    job->step = step;
    progress_begin(&job->progress, &job->session, step, "frames");
  }
  progress_at(&job->progress, done, total, "");
  return session_interrupted();
}

/* Prints each verdict, and returns them for --json; NULL without memory. */
static json_t *print_verdicts(struct session *session, const ern_prepare_result *result) {
  static const char *const grades[] = {"good", "doubtful", "refused"};
  json_t *list = json_array();
  for (int i = 0; i < ERN_PREPARE_STEPS; i++) {
    const ern_prepare_verdict *verdict = &result->verdicts[i];
    if (verdict->step == NULL) continue;
    const char *grade = grades[verdict->grade];
    if (verdict->grade == ERN_PREPARE_DOUBTFUL)
      session_warn(session, "%s: %s: %s", verdict->step, grade, verdict->words);
    else if (verdict->grade == ERN_PREPARE_GOOD)
      session_note(session, "%s: %s%s%s", verdict->step, grade, verdict->words[0] != 0 ? ": " : "", verdict->words);
    json_array_append_new(list, json_pack("{s:s, s:s, s:o}", "step", verdict->step, "verdict", grade, "words",
                                          session_text(verdict->words)));
  }
  return list;
}

static int make(struct prepare_job *job) {
  struct session *session = &job->session;
  struct prepare_library library = {0};
  ern_prepare_result result = {0};
  const double began = session_seconds();
  if (session_check_json_not_input(session, job->folder) != 0) return EXIT_FAILURE;
  if (prepare_library_load(&library, session) != 0) return EXIT_FAILURE;
  const uint32_t cookie = library.options.cookie, size = library.options.size;
  ern_prepare_options *options = &job->options;
  options->cookie = cookie;
  options->size = size;
  options->from = (double)job->from;
  options->to = (double)job->to;
  options->focal = (double)job->focal;
  options->only = job->only >= 0 ? steps[job->only] : NULL;
  options->anew = session->overwrite;
  options->progress = say_progress;
  options->user = job;
  const ern_status status = library.run(session->context, job->video, job->folder, options, &result, sizeof result);
  if (job->step != NULL) progress_end(&job->progress);
  json_t *verdicts = print_verdicts(session, &result);
  if (status == ERN_E_CANCELLED && session_interrupted()) {
    json_decref(verdicts);
    return session_stop_with(session, "stopped; the same command goes on from here");
  }
  if (status != ERN_OK) {
    json_decref(verdicts);
    return session_fail(session);
  }
  char left[64] = ""; /* large enough for all names */
  for (size_t i = 0, used = 0; i < ERN_PREPARE_STEPS; i++)
    if (result.verdicts[i].step == NULL)
      used += (size_t)snprintf(left + used, sizeof left - used, "%s%s", used > 0 ? ", " : "", steps[i]);
  session_note(session, "%s: %zu frames of %d x %d; next: ernerf %s %s%s%s", job->folder, result.frames, options->side,
               options->side, left[0] == 0 ? "train" : "prepare VIDEO -o", job->folder,
               left[0] == 0 ? " --time 10m -o portrait.safetensors"
                            : " with the same options, for the steps that are left or depend on changed ones: ",
               left);
  return session_report(session,
                        json_pack("{s:o, s:o, s:I, s:i, s:o, s:o}", "video", session_text(job->video), "clip",
                                  session_text(job->folder), "frames", (json_int_t)result.frames, "size", options->side,
                                  "verdicts", verdicts, "seconds", session_number(session_seconds() - began)));
}

static int check_usage(const struct prepare_job *job, const struct args *args) {
  if (job->folder == NULL) return args_refuse(args, "-o CLIP is missing");
  if (job->to > 0 && job->to <= job->from)
    return args_refuse(args, "--from %g is not before --to %g", (double)job->from, (double)job->to);
  if (job->focal > 0 && job->options.poses != NULL)
    return args_refuse(args, "--focal and --poses exclude each other: the file of poses has its focal length");
  return -1;
}

int cmd_prepare(int argc, char **argv) {
  struct prepare_job job = {.options = {.side = 512}, .only = -1};
  ern_prepare_options *o = &job.options;
  struct option own[] = {
      {ARGS_TEXT("o", &job.folder), .alias = "output", .choices = "CLIP",
       .help = "folder of the clip: new, empty, or that of an earlier call, which is continued"},
      {ARGS_FLOAT("from", &job.from, 0, 1e6), .choices = "SECONDS", .help = "where in the video to begin"},
      {ARGS_FLOAT("to", &job.to, 0, 1e6), .choices = "SECONDS", .help = "where to end (default: the end of the video)"},
      {ARGS_TEXT("segment", &o->segment), .choices = "auto|SECONDS",
       .help = "take only the best part of the video, of this length (1 to 1800 s); auto: of 180 "
               "s, if the part from --from to --to is longer than 300 s"},
      {ARGS_INT("size", &o->side, 128, 1024), .choices = "S",
       .help = "pixels a side of the clip's square pictures, 128 to 1024"},
      {ARGS_FLOAT("focal", &job.focal, 0, 1e5), .choices = "PIXELS",
       .help = "focal length in pixels of the clip's pictures (default 1100/450 of their side)"},
      {ARGS_TEXT("sound-offset", &o->sound_offset), .choices = "auto|SECONDS",
       .help = "how much later the sound is than the mouth, -2 to 2, which the clip's sound makes up for; auto: as "
               "measured, where that is certain (default auto)"},
      {ARGS_FLAG("head-only", &o->head_only),
       .help = "make a clip of the head alone: for footage that does not show the shoulders"},
      {ARGS_CHOICE("only", &job.only, only_choices), .help = "this step alone, also where it was done already"}};
  struct option supplied[] = {
      {ARGS_TEXT("detector", &o->detector), .choices = "FILE.onnx",
       .help = "faces and eyes: the network YuNet, in place of OpenCV's cascades"},
      {ARGS_TEXT("landmarks", &o->landmarks), .choices = "DIR|FILE.csv|FILE.onnx",
       .help = "68 landmarks of each frame: a folder of ID.lms (ID: the frame's number, from 0), OpenFace's table of "
               "the video, or a network"},
      {ARGS_TEXT("poses", &o->poses), .choices = "FILE.json", .help = "head poses of all frames, as transforms_*.json"},
      {ARGS_TEXT("masks", &o->masks), .choices = "DIR|FILE.onnx",
       .help = "head, neck and torso of each frame: a folder of ID.png in the colours of AD-NeRF's parsing, or a "
               "network that finds the person"},
      {ARGS_TEXT("background", &o->background), .choices = "FILE|key",
       .help = "a picture of the place without the person, or key: the person is in front of a screen of one colour"},
      {ARGS_TEXT("au", &o->au), .choices = "FILE.csv",
       .help = "how far the eyes are closed: a table with a column AU45_r, such as OpenFace's"},
      {ARGS_TEXT("features", &o->features), .choices = "FILE.npy",
       .help = "speech features, in place of those that are made of the sound"}};
  struct option output[SESSION_OUTPUT_OPTIONS];
  struct word words[] = {{"VIDEO", &job.video, "one person who speaks to a camera that stands still"}};
  struct args args = {.verb = "prepare",
                      .summary = "Makes a clip, the input of `ernerf train`, from the video of a person.",
                      .usage = "prepare VIDEO -o CLIP",
                      .notes =
                          "Each step gives a verdict: good, doubtful with the reason and what helps, or refused, "
                          "which ends the\nwork. A second call does what is left to do.",
                      .words = words,
                      .word_count = 1,
                      .groups = {{"The clip:", own, sizeof own / sizeof *own},
                                 {"Your own files or networks, in place of what a step computes:", supplied,
                                  sizeof supplied / sizeof *supplied},
                                 {"Output:", output, SESSION_OUTPUT_OPTIONS}}};
  session_output_options(&job.session, output);
  int status = args_parse(&args, argc, argv);
  if (status < 0) status = check_usage(&job, &args);
  job.session.inputs[0] = job.video;
  const char *const inputs[] = {o->landmarks, o->poses, o->masks, o->au, o->features, o->background, o->detector};
  for (size_t i = 0; i < sizeof inputs / sizeof *inputs; i++) job.session.inputs[1 + i] = inputs[i];
  job.session.rewrites = true;
  if (status < 0) status = session_open(&job.session, &args);
  if (status >= 0) return status;
  status = make(&job);
  session_close(&job.session);
  return status;
}
