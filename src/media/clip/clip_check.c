/* SPDX-License-Identifier: MIT
 * `ernerf check`: reports in sentences what a clip has, what it lacks, the consequences, and which step of the public
 * preprocessing makes the missing files. */
#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include "core/floats.h"
#include "core/format.h"
#include "core/memory.h"
#include "io/landmarks.h"
#include "media/clip/clip.h"

enum { SENTENCE_BYTES = 2560, REASON_BYTES = 2048, PATH_BYTES = 4096, THERE = 1, OPTIONAL = 0, NEEDED = -1 };

static const double frame_rate = 25; /* a second, of the video and of the feature windows */

struct report {
  ern_context *context;
  const char *folder;
  void (*say)(void *user, int ok, const char *sentence);
  void *user;
  ern_status first; /* the first error of a required file */
  char first_reason[REASON_BYTES];
  ern_pose_list lists[2]; /* by ern_split; empty where they could not be read */
  bool poses, blink, torso, landmarks;
  bool lacks; /* the report named a missing or invalid file */
  const char *features_name;
  const char *speech; /* kind of the features */
};

static void add_line(struct report *report, int ok, const char *format, ...) ERN_PRINTF(3, 4);
static void add_line(struct report *report, int ok, const char *format, ...) {
  char sentence[SENTENCE_BYTES];
  va_list arguments;
  va_start(arguments, format);
  ern_format_list(sentence, sizeof sentence, format, arguments);
  va_end(arguments);
  report->say(report->user, ok, sentence);
  report->lacks = report->lacks || ok != THERE;
}

/* Reports the last error and the remedy. */
static void say_wrong(struct report *report, ern_status status, const char *help) {
  char reason[REASON_BYTES];
  (void)ern_last_error_copy(report->context, reason, sizeof reason);
  if (report->first == ERN_OK) {
    report->first = status;
    snprintf(report->first_reason, sizeof report->first_reason, "%s", reason);
  }
  add_line(report, NEEDED, "%s.%s%s", reason, help[0] != 0 ? " " : "", help);
}

static void check_poses(struct report *report) {
  ern_context *context = report->context;
  ern_pose_list *train = &report->lists[ERN_SPLIT_TRAIN], *val = &report->lists[ERN_SPLIT_VAL];
  size_t trained = 0;
  ern_status status = ern_clip_train_poses(context, report->folder, train);
  if (status != ERN_OK) {
    say_wrong(report, status,
              "The steps face tracking and save transforms (the public program's process.py, tasks 8 and 9) make it.");
    return;
  }
  report->poses = true;
  add_line(report, THERE, "transforms_train.json: %zu frames of %d x %d pixels to train on, focal length %.6g.",
           train->count, train->width, train->height, train->focal);
  status = ern_clip_val_poses(context, report->folder, train, val);
  if (status != ERN_OK) {
    say_wrong(report, status, "The step save transforms (the public program's process.py, task 9) makes it.");
  } else if (val->count == 0) {
    add_line(report, OPTIONAL,
             "transforms_val.json: missing. Nothing will be measured on unseen frames; the step save transforms "
             "(the public program's process.py, task 9) makes it.");
  } else if (ern_clip_trained_frames(context, report->lists, &trained) == ERN_OK && trained > 0) {
    add_line(
        report, OPTIONAL,
        "transforms_val.json: %zu of its %zu frames are in transforms_train.json too. What is measured on them is not "
        "measured on unseen frames.",
        trained, val->count);
  } else {
    add_line(report, THERE, "transforms_val.json: %zu frames to validate on.", val->count);
  }
}

static void check_background(struct report *report) {
  char path[PATH_BYTES];
  int width = 0, height = 0;
  const ern_pose_list *train = &report->lists[ERN_SPLIT_TRAIN];
  snprintf(path, sizeof path, "%s/%s", report->folder, ern_clip_content(ERN_CLIP_BACKGROUND));
  const ern_status status = ern_image_size(report->context, path, &width, &height);
  if (status != ERN_OK) {
    say_wrong(report, status, "The step extract background (the public program's process.py, task 5) makes it.");
  } else if (report->poses && (width != train->width || height != train->height)) {
    add_line(report, THERE, "bc.jpg: the background is %d x %d pixels and will be scaled to %d x %d.", width, height,
             train->width, train->height);
  } else {
    add_line(report, THERE, "bc.jpg: the background, %d x %d pixels.", width, height);
  }
}

/* Checks that a frame's file of one part exists and is valid, without decoding pixels. */
static ern_status check_file(struct report *report, ern_clip_part part, int64_t img_id) {
  ern_status status = ERN_OK;
  const ern_pose_list *train = &report->lists[ERN_SPLIT_TRAIN];
  float points[ERN_LANDMARKS][2];
  char *path = NULL;
  ERN_TRY(ern_clip_part_path(report->context, report->folder, part, img_id, &path));
  if (part == ERN_PART_LANDMARKS) {
    ERN_TRY(ern_landmarks_read(report->context, path, points));
  } else {
    ERN_TRY(ern_clip_picture_check(report->context, path, train->width, train->height));
  }
fail:
  ern_release(report->context, path);
  return status;
}

/* Checks all frames' files of one part; reports all errors in one sentence. Returns whether all are valid. */
static bool check_files(struct report *report, ern_clip_part part, const char *what, const char *help) {
  ern_status first = ERN_OK;
  char reason[REASON_BYTES] = "";
  size_t wrong = 0, count = 0;
  for (int split = 0; split < 2; split++) {
    for (size_t i = 0; i < report->lists[split].count; i++, count++) {
      const ern_status status = check_file(report, part, report->lists[split].poses[i].img_id);
      if (status == ERN_OK) continue;
      if (wrong++ == 0) {
        first = status;
        (void)ern_last_error_copy(report->context, reason, sizeof reason);
      }
    }
  }
  if (wrong == 0) {
    add_line(report, THERE, "%s: %s of all %zu frames.", ern_clip_content(part), what, count);
    return true;
  }
  ern_fail(report->context, first, "%s: %zu of %zu frames have no good file, the first is %s", ern_clip_content(part),
           wrong, count, reason);
  say_wrong(report, first, help);
  return false;
}

/* The alpha of the first torso picture: if it is opaque everywhere or transparent everywhere, the file is probably
 * wrong. */
static void check_alpha(struct report *report) {
  char *path = NULL;
  ern_image image = {0};
  size_t opaque = 0, transparent = 0;
  ern_status status = ERN_OK;
  ERN_TRY(ern_clip_part_path(report->context, report->folder, ERN_PART_TORSO,
                             report->lists[ERN_SPLIT_TRAIN].poses[0].img_id, &path));
  ERN_TRY(ern_image_read(report->context, path, 4, &image));
  const size_t pixels = (size_t)image.width * (size_t)image.height;
  for (size_t i = 0; i < pixels; i++) {
    opaque += image.data[4 * i + 3] == 255;
    transparent += image.data[4 * i + 3] == 0;
  }
  if (opaque == pixels) {
    add_line(
        report, OPTIONAL,
        "%s: no pixel is transparent, so it hides the background and leaves the head nothing to learn; expected RGBA, "
        "transparent outside the torso (the public program's process.py, task 6).",
        path);
  } else if (transparent == pixels) {
    add_line(report, OPTIONAL, "%s: every pixel is transparent: there is no torso to learn.", path);
    report->torso = false;
  }
fail:
  if (status != ERN_OK) say_wrong(report, status, "");
  ern_image_free(report->context, &image);
  ern_release(report->context, path);
}

static void check_doubled(struct report *report) {
  size_t doubled = 0;
  int64_t img_id = 0;
  const ern_status status =
      ern_clip_doubled_pictures(report->context, report->folder, report->lists, &doubled, &img_id);
  if (status != ERN_OK) say_wrong(report, status, "");
  if (status == ERN_OK && doubled > 0)
    add_line(report, OPTIONAL,
             "gt_imgs: %zu frames have several pictures, the first is img_id %" PRId64
             ". Of .jpg, .png, .jpeg the first that is there is taken; delete the others.",
             doubled, img_id);
}

static void check_frames(struct report *report) {
  static const struct {
    ern_clip_part part;
    const char *sentence;
  } optional[] = {
      {ERN_PART_TORSO,
       "torso_imgs: missing. A head can be trained, over the plain background, but no torso; the step extract torso "
       "and ground truth (the public program's process.py, task 6) makes it."},
      {ERN_PART_LANDMARKS,
       "ori_imgs: missing. In training the face is not distinguished from the rest, and eval gives no figures of "
       "head and mouth; the step landmarks (the public program's process.py, task 7) makes its .lms files."},
      {ERN_PART_PARSING,
       "parsing: missing. The head will be learnt over the clip's background alone, and may keep pieces of it; the "
       "step face parsing (the public program's process.py, task 4) makes it."}};
  bool there[3] = {false, false, false};
  for (int i = 0; i < 3; i++) {
    const ern_status status = ern_clip_has(report->context, report->folder, optional[i].part, &there[i]);
    if (status != ERN_OK) say_wrong(report, status, "");
  }
  if (report->poses) {
    check_files(report, ERN_PART_TRUTH, "the pictures",
                "The steps extract images, and extract torso and ground truth (the public program's process.py, tasks "
                "3 and 6), make them.");
    check_doubled(report);
  }
  if (!there[0]) add_line(report, OPTIONAL, "%s", optional[0].sentence);
  if (there[0] && report->poses) {
    report->torso =
        check_files(report, ERN_PART_TORSO, "the torso pictures",
                    "The step extract torso and ground truth (the public program's process.py, task 6) makes them.");
    if (report->torso) check_alpha(report);
  }
  if (!there[1]) add_line(report, OPTIONAL, "%s", optional[1].sentence);
  if (there[1] && report->poses) {
    report->landmarks = check_files(report, ERN_PART_LANDMARKS, "the landmarks",
                                    "The step landmarks (the public program's process.py, task 7) makes them.");
  }
  if (!there[2]) add_line(report, OPTIONAL, "%s", optional[2].sentence);
  if (there[2] && report->poses)
    check_files(report, ERN_PART_PARSING, "the head, neck and torso",
                "The step face parsing (the public program's process.py, task 4) makes them; without the folder the "
                "head is learnt over the clip's background alone.");
}

/* There is one window for every 1/25 s of sound and one frame for every picture of the video. Where these counts differ
 * much, the video does not have 25 frames a second, or its sound and pictures differ in length. */
static void check_lengths(struct report *report, size_t windows) {
  int64_t img_id = 0, aud_id = 0;
  ern_clip_largest_ids(report->lists, &img_id, &aud_id);
  const double frames = (double)aud_id + 1, difference = fabs(frames - (double)windows);
  if (!report->poses || difference <= fmax(8, 0.01 * frames)) return;
  static const double rates[] = {23.976, 24, 30, 48, 50, 60};
  const double rate = frame_rate * frames / (double)windows;
  for (size_t i = 0; i < sizeof rates / sizeof rates[0]; i++) {
    if (fabs(rate / rates[i] - 1) > 0.01) continue;
    add_line(report, OPTIONAL,
             "%s: %zu windows, but frames up to aud_id %" PRId64
             ": the video looks like one of %.5g frames a second, so sound "
             "and picture drift apart. Convert it to 25 (ffmpeg -r 25) and preprocess it again.",
             report->features_name, windows, aud_id, rates[i]);
    return;
  }
  if ((double)windows < frames) {
    add_line(
        report, OPTIONAL,
        "%s: %zu windows, but frames up to aud_id %" PRId64
        ": the frames past the end repeat the last window. Sound and "
        "picture may drift apart; extract audio and its features again (the public program's process.py, tasks 1 and "
        "2).",
        report->features_name, windows, aud_id);
  } else {
    add_line(report, OPTIONAL,
             "%s: %zu windows, but frames only up to aud_id %" PRId64
             ": this is right if only a part "
             "of the video was tracked, else sound and picture drift apart.",
             report->features_name, windows, aud_id);
  }
}

static void check_features(struct report *report) {
  static const char help[] =
      "Put the sound of the video there as aud.wav (ffmpeg -i VIDEO -ac 1 -ar 16000 aud.wav); training makes features "
      "of it.";
  ern_features features = {0};
  double change = 0;
  bool sound = false;
  char path[PATH_BYTES];
  ern_status status = ern_clip_features_name(report->context, report->folder, NULL, &report->features_name);
  if (status == ERN_OK) {
    snprintf(path, sizeof path, "%s/%s", report->folder, report->features_name);
    sound = ern_speech_is_sound(path);
    if (sound) report->speech = ern_clip_features_kind(report->features_name, NULL, NULL, true);
    status = ern_speech_open(report->context, path, report->speech, &features);
  }
  if (status != ERN_OK) {
    say_wrong(report, status, help);
    return;
  }
  if (!sound) report->speech = ern_clip_features_kind(report->features_name, NULL, &features, false);
  if (report->speech[0] == 0) report->speech = "an unknown kind";
  if (sound)
    add_line(report, THERE, "%s: no file of speech features; %s is made of the sound, %zu windows.",
             report->features_name, report->speech, features.windows);
  else
    add_line(report, THERE, "%s: speech features of %s, %zu windows of %d vectors of %d values.", report->features_name,
             report->speech, features.windows, features.window_length, features.width);
  check_lengths(report, features.windows);
  status = ern_clip_feature_change(report->context, &features, &change);
  if (status == ERN_OK && change < ERN_CLIP_SPEECH)
    status = ern_fail(report->context, ERN_E_FORMAT, "%s: %s the same in every window, so the mouth would not move",
                      report->features_name, sound ? "is silent: its features are" : "is");
  if (status != ERN_OK) say_wrong(report, status, sound ? "Take a video whose sound is not muted." : "");
  ern_features_free(report->context, &features);
}

static void check_blink(struct report *report) {
  static const char help[] = "OpenFace's FeatureExtraction (-aus) makes it from the whole video.";
  int64_t img_id = 0, aud_id = 0;
  float *blink = NULL, most = 0, least = 0;
  size_t count = 0;
  ern_clip_largest_ids(report->lists, &img_id, &aud_id);
  const ern_status status = ern_clip_blink(report->context, report->folder, img_id, &blink, &count);
  if (status != ERN_OK) {
    say_wrong(report, status, help);
    return;
  }
  if (blink == NULL) {
    add_line(report, OPTIONAL,
             "au.csv: missing. No blinking will be learnt; OpenFace's FeatureExtraction makes it (column AU45_r).");
    return;
  }
  ern_clip_eye_range(blink, count, &least, &most); /* the eye value clamps it at 2 */
  report->blink = (double)fminf(most, 2) - (double)fmaxf(least, 0) >= 2 * ERN_CLIP_BLINK;
  if (report->blink) {
    add_line(report, THERE, "au.csv: AU45_r in %zu rows, up to %.3g.", count, (double)most);
  } else {
    add_line(report, OPTIONAL,
             "au.csv: AU45_r stays from %.3g to %.3g in %zu rows, the two largest and the two least left out: nobody "
             "blinks, so no blinking will be learnt.",
             (double)least, (double)most, count);
  }
  ern_release(report->context, blink);
}

static void check_motion(struct report *report) {
  int64_t img_id = 0, aud_id = 0;
  float(*motion)[ERN_MOTION_VALUES] = NULL;
  ern_clip_largest_ids(report->lists, &img_id, &aud_id);
  const ern_status status = ern_clip_motion(report->context, report->folder, img_id, &motion);
  if (status != ERN_OK)
    say_wrong(report, status, "`ernerf prepare` makes it from the video.");
  else if (motion != NULL)
    add_line(report, THERE, "torso.npy: where the body is in each frame; the torso moves with it.");
  else if (report->torso)
    add_line(report, OPTIONAL,
             "torso.npy: missing. The torso follows the head's pose alone, and is soft where the body moves by itself; "
             "`ernerf prepare` makes it from the video.");
  ern_release(report->context, motion);
}

/* Only the viewer needs the sound: an error in it does not prevent training. */
static void check_sound(struct report *report) {
  char path[PATH_BYTES];
  bool there = false;
  ern_sound sound = {0};
  int64_t img_id = 0, aud_id = 0;
  ern_status status = ern_clip_has(report->context, report->folder, ERN_CLIP_SOUND, &there);
  if (status == ERN_OK && !there) {
    add_line(report, OPTIONAL,
             "aud.wav: missing. Rendered videos will have no sound; the step extract audio (the public program's "
             "process.py, task 1) makes it.");
    return;
  }
  snprintf(path, sizeof path, "%s/%s", report->folder, ern_clip_content(ERN_CLIP_SOUND));
  if (status == ERN_OK) status = ern_sound_read(report->context, path, &sound);
  if (status == ERN_E_NO_MEMORY) {
    say_wrong(report, status, "");
    return;
  }
  if (status != ERN_OK) {
    char reason[REASON_BYTES];
    (void)ern_last_error_copy(report->context, reason, sizeof reason);
    add_line(
        report, OPTIONAL,
        "%s. Rendered videos will have no sound; extract audio (the public program's process.py, task 1) makes it.",
        reason);
    return;
  }
  if (sound.frames == 0) {
    add_line(
        report, OPTIONAL,
        "aud.wav: 0 samples. Rendered videos will have no sound; extract audio (the public program's process.py, task "
        "1) makes it.");
    ern_sound_free(report->context, &sound);
    return;
  }
  ern_clip_largest_ids(report->lists, &img_id, &aud_id);
  const double seconds = (double)sound.frames / sound.rate, pictures = ((double)aud_id + 1) / frame_rate;
  add_line(report, THERE, "aud.wav: %.2f s of sound at %d Hz for rendered videos.", seconds, sound.rate);
  if (report->poses && seconds < pictures - 0.4) {
    add_line(report, OPTIONAL,
             "aud.wav: %.2f s, but pictures up to %.2f s at 25 frames a second: the rest will be silent.", seconds,
             pictures);
  }
  ern_sound_free(report->context, &sound);
}

static void add_doubt(void *user, const char *sentence) { add_line(user, OPTIONAL, "%s.", sentence); }

static void check_doubts(struct report *report) {
  if (!report->poses) return;
  const ern_status status =
      ern_clip_doubts(report->context, report->folder, &report->lists[ERN_SPLIT_TRAIN], add_doubt, report);
  if (status != ERN_OK) say_wrong(report, status, "");
}

/* Reports that `prepare` made the clip: the other sentences name the public script process.py, which did not. */
static void report_prepare(struct report *report) {
  bool there = false;
  const ern_status status = ern_clip_has(report->context, report->folder, ERN_CLIP_RECORD, &there);
  if (status != ERN_OK) say_wrong(report, status, "");
  if (status != ERN_OK || !there || !report->lacks) return;
  add_line(
      report, THERE,
      "prepare.json: `ernerf prepare` made this clip; the same call again, `ernerf prepare VIDEO -o CLIP` with its "
      "options, makes the files that are missing.");
}

static void summarise(struct report *report) {
  if (report->first != ERN_OK) {
    add_line(report, NEEDED, "Not ready: `ernerf train` would refuse this clip.");
    return;
  }
  add_line(
      report, THERE,
      "`ernerf train` will learn a head from %zu frames, its mouth from %s features%s%s; `ernerf train --torso` %s.",
      report->lists[ERN_SPLIT_TRAIN].count, report->speech,
      report->blink ? ", its blinking from au.csv" : ", no blinking",
      report->landmarks ? ", the face distinguished by its landmarks" : "",
      report->torso ? "will learn the torso" : "cannot run on it");
}

static ern_status check_folder(struct report *report) {
  struct stat about;
  if (stat(report->folder, &about) == 0 && S_ISDIR(about.st_mode)) return ERN_OK;
  const ern_status status = ern_fail(report->context, ERN_E_MISSING,
                                     "%s: is no folder, expected that of a preprocessed clip", report->folder);
  say_wrong(report, status, "");
  return status;
}

ern_status ern_clip_check(ern_context *context, const char *folder,
                          void (*say)(void *user, int ok, const char *sentence), void *user) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(context, context);
  ERN_NEED(context, folder);
  ERN_NEED(context, say);
  struct report report = {.context = context, .folder = folder, .say = say, .user = user};
  if (check_folder(&report) == ERN_OK) {
    const ern_status prepared = ern_clip_check_prepared(context, folder);
    if (prepared != ERN_OK) say_wrong(&report, prepared, "");
    check_poses(&report);
    check_features(&report);
    check_background(&report);
    check_frames(&report);
    check_blink(&report);
    check_motion(&report);
    check_sound(&report);
    check_doubts(&report);
    report_prepare(&report);
    summarise(&report);
  }
  ern_pose_list_free(context, &report.lists[ERN_SPLIT_TRAIN]);
  ern_pose_list_free(context, &report.lists[ERN_SPLIT_VAL]);
  if (report.first == ERN_OK) return ERN_OK;
  return ern_fail(context, report.first, "%s", report.first_reason);
}
