/* SPDX-License-Identifier: MIT
 * `prepare`: runs the steps that make a clip of a video. */
#define _XOPEN_SOURCE 700 /* realpath */
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/floats.h"
#include "core/format.h"
#include "core/sized.h"
#include "io/file.h"
#include "prepare/clip_sound.h"
#include "prepare/prepare_job.h"
#include "prepare/prepare_record.h"
#include "prepare/report.h"
#include "prepare/segment.h"

enum { SETTINGS = 2 * ERN_PREPARE_FINGERPRINT_BYTES + 600 };

static const struct step {
  const char *name;
  ern_status (*run)(struct ern_prepare_job *job);
  ern_status (*check)(struct ern_prepare_job *job); /* reads the files supplied for the step, and changes nothing */
} steps[ERN_PREPARE_STEPS] = {{"face", ern_prepare_face, NULL},
                              {"pose", ern_prepare_pose, ern_prepare_pose_check},
                              {"landmarks", ern_prepare_landmarks, ern_prepare_landmarks_check},
                              {"layers", ern_prepare_layers, ern_prepare_layers_check},
                              {"eyes", ern_prepare_eyes, ern_prepare_eyes_check},
                              {"features", ern_prepare_features, ern_prepare_features_check}};

/* Replaces non-ASCII bytes by '?' where a text is not UTF-8, as JSON needs: a file name need not be. */
static void keep_text(char *text) {
  json_t *string = json_string(text);
  for (char *at = text; *at != 0 && string == NULL; at++)
    if ((unsigned char)*at >= 0x80) *at = '?';
  json_decref(string);
}

/* The settings that a step's result depends on, beside the earlier steps. */
static void settings_of(const struct ern_prepare_job *job, size_t step, char settings[SETTINGS]) {
  const ern_prepare_options *o = job->options;
  char a[ERN_PREPARE_FINGERPRINT_BYTES], b[ERN_PREPARE_FINGERPRINT_BYTES];
  settings[0] = 0;
  switch (step) {
    case 0:
      if (o->detector != NULL) snprintf(settings, SETTINGS, "detector %s", ern_prepare_fingerprint(o->detector, a));
      break;
    case 1: /* supplied landmarks give the eyes from which tracking begins */
      ern_format(settings, SETTINGS, "focal %.9g poses %s%s%s", o->focal, ern_prepare_fingerprint(o->poses, a),
                 o->poses == NULL && o->landmarks != NULL ? " landmarks " : "",
                 o->poses == NULL ? ern_prepare_fingerprint(o->landmarks, b) : "");
      break;
    case 2: snprintf(settings, SETTINGS, "landmarks %s", ern_prepare_fingerprint(o->landmarks, a)); break;
    case 3:
      snprintf(settings, SETTINGS, "%smasks %s background %s", o->head_only ? "head only " : "",
               ern_prepare_fingerprint(o->masks, a), ern_prepare_fingerprint(o->background, b));
      break;
    case 4: snprintf(settings, SETTINGS, "au %s", ern_prepare_fingerprint(o->au, a)); break;
    case 5:
      ern_format(settings, SETTINGS, "features %s", ern_prepare_fingerprint(o->features, a));
      if (o->sound_offset != NULL && strcmp(o->sound_offset, "auto") != 0)
        snprintf(settings + strlen(settings), SETTINGS - strlen(settings), " sound offset %.20s", o->sound_offset);
      break;
    default: break;
  }
  keep_text(settings);
}

/* Refuses inputs (video, supplied files) inside folders where the clip's files are written and removed. */
static ern_status keep_inputs(const struct ern_prepare_job *job) {
  const ern_prepare_options *o = job->options;
  const char *const inputs[] = {job->video, o->background, o->landmarks, o->poses,
                                o->masks,   o->au,         o->features,  o->detector};
  char *folder = realpath(job->folder, NULL);
  ern_status status = ERN_OK;
  if (folder == NULL) return ERN_OK; /* it does not exist yet */
  const size_t length = strlen(folder);
  for (size_t i = 0; i < sizeof inputs / sizeof *inputs && status == ERN_OK; i++) {
    char *place = inputs[i] != NULL ? realpath(inputs[i], NULL) : NULL;
    if (place != NULL && strncmp(place, folder, length) == 0 && (place[length] == '/' || place[length] == 0))
      status = ern_fail(job->context, ERN_E_ARGUMENT,
                        "%s: is an input, and is in %s, whose files are written; expected it elsewhere", inputs[i],
                        job->folder);
    free(place);
  }
  free(folder);
  return status;
}

static ern_status check_paths(ern_context *context, const ern_prepare_options *o) {
  const struct {
    const char *name, *path;
  } paths[] = {{"background", o->background},
               {"landmarks", o->landmarks},
               {"poses", o->poses},
               {"masks", o->masks},
               {"au", o->au},
               {"features", o->features},
               {"detector", o->detector}};
  for (size_t i = 0; i < sizeof paths / sizeof *paths; i++)
    if (paths[i].path != NULL && paths[i].path[0] == 0)
      return ern_fail(context, ERN_E_ARGUMENT, "prepare: %s is \"\", expected a path, or NULL for none", paths[i].name);
  return ERN_OK;
}

/* Checks, before the frames exist, that each supplied file and folder can be opened. */
static ern_status open_supplied(const struct ern_prepare_job *job) {
  const ern_prepare_options *o = job->options;
  const char *place = o->background != NULL && strcmp(o->background, "key") == 0 ? NULL : o->background;
  const char *const paths[] = {place, o->landmarks, o->poses, o->masks, o->au, o->features, o->detector};
  for (size_t i = 0; i < sizeof paths / sizeof *paths; i++) {
    const int file = paths[i] != NULL ? open(paths[i], O_RDONLY | O_CLOEXEC | O_NONBLOCK) : -1;
    if (paths[i] != NULL && file < 0) return ern_file_fail(job->context, paths[i], "open");
    if (file >= 0) close(file);
  }
  return ERN_OK;
}

/* Reads the supplied files before `step` (the first due step after "face") or "face" itself removes the files of an
 * earlier call. Files of steps that are already done are not read again. */
static ern_status check_supplied(struct ern_prepare_job *job, size_t step) {
  ern_status status = ERN_OK;
  const size_t frames = job->frames;
  if (step == 0) ERN_TRY(open_supplied(job));
  if (step == 0) job->frames = 0; /* the frames of an earlier call */
  for (size_t k = step == 0 ? ERN_PREPARE_STEPS - 1 : 1; k < ERN_PREPARE_STEPS; k++) { /* features need no frames */
    char settings[SETTINGS];
    ern_prepare_verdict verdict;
    settings_of(job, k, settings);
    if (!ern_prepare_record_has(job, steps[k].name, settings, &verdict)) ERN_TRY(steps[k].check(job));
  }
fail:
  job->frames = frames;
  return status;
}

/* Refuses to run where `step` or a later step would overwrite the user's own files. */
static ern_status check_files(struct ern_prepare_job *job, size_t step, size_t only) {
  ern_status status = ERN_OK;
  for (size_t k = step; k < ERN_PREPARE_STEPS; k++) {
    char settings[SETTINGS];
    ern_prepare_verdict verdict;
    settings_of(job, k, settings);
    const bool stale = k == step || step == 0 || (step < 3 && k < 5) || /* the same steps as in run_step() */
                       !ern_prepare_record_has(job, steps[k].name, settings, &verdict);
    if (stale && (only == ERN_PREPARE_STEPS || k == only)) ERN_TRY(ern_prepare_check_files(job, k, step == 0));
  }
fail:
  return status;
}

static ern_status check_options(ern_context *context, const ern_prepare_options *o, size_t *only) {
  *only = ERN_PREPARE_STEPS;
  const ern_status ranges = ern_prepare_settings_check(context, o);
  if (ranges != ERN_OK) return ranges;
  for (size_t i = 0; i < ERN_PREPARE_STEPS && o->only != NULL; i++)
    if (strcmp(o->only, steps[i].name) == 0) *only = i;
  if (o->only != NULL && *only == ERN_PREPARE_STEPS)
    return ern_fail(context, ERN_E_ARGUMENT,
                    "prepare: only is \"%s\", expected face, pose, landmarks, layers, eyes or features", o->only);
  double length = 0, longer_than = 0;
  const ern_status status = o->segment != NULL ? ern_segment_read(context, o->segment, &length, &longer_than) : ERN_OK;
  if (status != ERN_OK) return status;
  bool automatic = false;
  const ern_status offset = ern_sound_offset_read(context, o->sound_offset, &length, &automatic);
  if (offset != ERN_OK) return offset;
  if (o->to > 0 && o->to <= o->from)
    return ern_fail(context, ERN_E_ARGUMENT,
                    "prepare: from %g to %g, expected seconds of the video, with from less than to", o->from, o->to);
  if (!(o->focal == 0 ||
        (o->focal >= ERN_PREPARE_FOCAL_LEAST * o->side && o->focal <= ERN_PREPARE_FOCAL_MOST * o->side)))
    return ern_fail(context, ERN_E_ARGUMENT, "prepare: focal is %g, expected 0, or %g to %g pixels", o->focal,
                    ERN_PREPARE_FOCAL_LEAST * o->side, ERN_PREPARE_FOCAL_MOST * o->side);
  if (o->focal > 0 && o->poses != NULL)
    return ern_fail(context, ERN_E_ARGUMENT,
                    "prepare: focal is %g beside poses (%s), whose file has the focal length they were found with; "
                    "expected one of the two",
                    o->focal, o->poses);
  return ERN_OK;
}

/* Makes the clip unusable for training while it has files of older results: removes poses or bc.jpg, which training
 * needs. */
static ern_status invalidate_clip(struct ern_prepare_job *job, size_t step) {
  static const char *const poses[] = {"transforms_train.json", "transforms_val.json"};
  ern_status status = ERN_OK;
  for (int i = 0; i < 2 && step == 1; i++) ERN_TRY(ern_prepare_remove_made(job, poses[i]));
  if (step <= 3) ERN_TRY(ern_prepare_remove_made(job, "bc.jpg"));
fail:
  return status;
}

static ern_status run_step(struct ern_prepare_job *job, size_t step, const char *settings) {
  const char *stale[ERN_PREPARE_STEPS];
  size_t count = 0;
  ern_status status = ERN_OK;
  job->figures = json_object();
  if (job->figures == NULL) return ern_fail(job->context, ERN_E_NO_MEMORY, "%s: no memory", job->folder);
  /* all steps depend on the frames; layers and eyes depend on poses and landmarks */
  stale[count++] = steps[step].name;
  for (size_t i = step + 1; i < ERN_PREPARE_STEPS - (step > 0) && step < 3; i++) stale[count++] = steps[i].name;
  if (step > 0) { /* else an interrupted step would count as done */
    ERN_TRY(ern_prepare_record_strike(job, stale, count));
    ERN_TRY(invalidate_clip(job, step));
  }
  ERN_TRY(steps[step].run(job));
  ERN_TRY(ern_prepare_record_check_video(job));
  const bool refused = job->verdict->grade == ERN_PREPARE_REFUSED;
  if (refused && step == 0 && job->frames > 0) goto refuse; /* the files and the record of an earlier call stay */
  if (job->frames > 0) (void)json_object_set_new(job->record, "frames", json_integer((json_int_t)job->frames));
  ERN_TRY(ern_prepare_record_enter(job, settings, stale, count));
  if (refused) ERN_TRY(invalidate_clip(job, step));
  job->refused = refused;
refuse:
  if (refused)
    status =
        ern_fail(job->context, ERN_E_UNSUPPORTED, "%s: %s: %s", job->video, job->verdict->step, job->verdict->words);
fail:
  json_decref(job->figures);
  job->figures = NULL;
  return status;
}

static ern_status run_steps(struct ern_prepare_job *job, size_t only, ern_prepare_result *result) {
  char settings[SETTINGS];
  bool checked = false;
  ern_status status = ERN_OK;
  for (size_t i = 0; i < ERN_PREPARE_STEPS; i++) {
    job->verdict = &result->verdicts[i];
    settings_of(job, i, settings);
    const bool done =
        ern_prepare_record_has(job, steps[i].name, settings, job->verdict) && ern_prepare_files_there(job, i);
    if (done) job->verdict->step = steps[i].name;
    if (only < ERN_PREPARE_STEPS ? i != only : done) {
      if (done || i > only) continue;
      ERN_TRY(ern_fail(job->context, ERN_E_STATE,
                       "%s: the step \"%s\" has not been done with these options, or files of it are gone, and \"%s\" "
                       "needs it; expected a call without --only first",
                       job->folder, steps[i].name, steps[only].name));
    }
    *job->verdict = (ern_prepare_verdict){.step = steps[i].name};
    status = ern_prepare_progress(job, 0, 1);
    if (!checked && status == ERN_OK) status = check_files(job, i, only);
    if (!checked && status == ERN_OK) status = check_supplied(job, i);
    checked = i > 0;
    if (status == ERN_OK) status = run_step(job, i, settings);
    if (status != ERN_OK && job->verdict->grade != ERN_PREPARE_REFUSED) *job->verdict = (ern_prepare_verdict){0};
    result->frames = job->frames;
    ERN_TRY(status);
  }
fail:
  return status;
}

/* Writes report.html, also after a refusal, whose error stays; overlay.mp4 only where every step is done. */
static ern_status report(struct ern_prepare_job *job, const ern_prepare_result *result, ern_status outcome) {
  char kept[ERN_ERROR_BYTES];
  ern_error_keep(job->context, kept);
  ern_status status = ern_report_write(job, result);
  if (status == ERN_OK && outcome == ERN_OK && result->verdicts[ERN_PREPARE_STEPS - 1].step != NULL) {
    ern_prepare_verdict overlay = {.step = "overlay"};
    job->verdict = &overlay;
    status = ern_report_overlay(job);
  }
  if (outcome == ERN_OK) return status;
  ern_error_restore(job->context, kept);
  return outcome;
}

/* Runs at the end of a call and keeps the call's error. */
static void note_made(struct ern_prepare_job *job) {
  char kept[ERN_ERROR_BYTES];
  if (!ern_prepare_folder_unchanged(job)) return;
  ern_error_keep(job->context, kept);
  if (ern_prepare_note_made(job) != ERN_OK) ern_error_restore(job->context, kept);
}

ern_status ern_prepare_sized(ern_context *context, const char *video, const char *folder,
                             const ern_prepare_options *options, ern_prepare_result *result, size_t bytes) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(context, context);
  ERN_NEED(context, video);
  ERN_NEED(context, folder);
  ERN_NEED(context, options);
  ERN_NEED(context, result);
  ern_prepare_options own = ern_prepare_options_default();
  ern_prepare_result found = {0};
  struct ern_prepare_job job = {.context = context, .video = video, .folder = folder, .options = &own};
  size_t only = 0;
  int lock = -1;
  bool opened = false;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_COPY_IN_CONFIG(context, ern_prepare_options, &own, options));
  ERN_TRY(check_paths(context, &own));
  ERN_TRY(check_options(context, &own, &only));
  job.side = own.side;
  job.focal = own.focal > 0 ? own.focal : 1100.0 / 450.0 * own.side;
  ERN_TRY(keep_inputs(&job));
  ERN_TRY(ern_prepare_record_open(&job, &lock));
  opened = true;
  job.frames = (size_t)json_integer_value(json_object_get(job.record, "frames"));
  found.frames = job.frames;
  ERN_TRY(ern_prepare_note_made(&job)); /* for an earlier call that was killed */
  status = run_steps(&job, only, &found);
  if (status == ERN_OK || job.refused) ERN_TRY(report(&job, &found, status));
fail:
  if (opened) note_made(&job);
  if (status != ERN_OK && job.made && ern_prepare_folder_unchanged(&job))
    (void)rmdir(folder); /* only where it is empty */
  if (lock >= 0) close(lock);
  json_decref(job.record);
  ern_struct_copy_out(result, bytes, &found, sizeof found);
  return status;
}
