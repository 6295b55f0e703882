/* SPDX-License-Identifier: MIT */
#include "session/control.h"

#include <inttypes.h>
#include <string.h>

void control_options(struct control *control, struct option options[CONTROL_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_FLOAT("fix-eye", &control->fix_eye, 0, 1),
       .help = "value of the eyes in all frames, 0 open, 1 closed (default those of the clip; with --poses 0)"},
      {ARGS_TEXT("eye", &control->eye), .choices = "FILE",
       .help = "eye values from a file, 25 for each second of the output: a table with a column AU45_r, such as au.csv "
               "(0 open, 2 to 5 closed); else 0 (open) to 1 (closed), one number a line without a header, or .npy of "
               "shape [T]"},
      {ARGS_FLAG("smooth-eye", &control->smooth_eye), .seldom = true, .published = true,
       .help = "smooth the blinks: each eye value is the mean of three frames"},
      {ARGS_FRAME("hold-pose", &control->hold), .seldom = true,
       .help = "the head held still: in all frames the pose of frame N, counted from 0, 25 a second"},
      {ARGS_PAIR("rotate", &control->turn, -90, 90), .choices = "YAW,PITCH",
       .help =
           "turn the head by so many degrees more, each -90 to 90: YAW > 0 to the right of the picture, PITCH > 0 up"},
      {ARGS_FLAG("smooth-path", &control->smooth_path), .seldom = true, .published = true,
       .help = "smooth the head's motion: each pose is the mean of those around it"},
      {ARGS_INT("smooth-path-window", &control->smooth_window, 1, 9999), .seldom = true, .published = true,
       .help = "frames of that mean, 25 a second, odd (default 7)"}};
  control->smooth_window = 7;
  ARGS_FILL(options, rows, CONTROL_OPTIONS);
}

int control_check(const struct control *control, const struct args *args) {
  int status = -1;
  if (!control->smooth_path) status = args_forbid(args, "smooth-path-window", "needs --smooth-path");
  if (status < 0 && control->smooth_window % 2 == 0)
    status = args_refuse(args, "--smooth-path-window is %d, expected an odd number", control->smooth_window);
  if (status < 0 && args_given(args, "fix-eye"))
    status = args_forbid(args, "smooth-eye eye", "has no effect with --fix-eye");
  if (status < 0 && control->eye != NULL)
    status = args_forbid(args, "smooth-eye", "smooths the clip's eye values, which --eye replaces");
  if (status < 0 && args_given(args, "hold-pose"))
    status = args_forbid(args, "smooth-path", "has no effect with --set hold-pose");
  return status;
}

int control_check_model(const struct control *control, struct session *session, const struct args *args,
                        const struct portrait *portrait) {
  const bool fixed = args_given(args, "fix-eye");
  if (portrait->info.has_eye) return 0;
  if (fixed || control->eye != NULL)
    return session_fail_with(
        session, "%s: was trained without eye values (no au.csv, or lids that do not move), so %s has no effect",
        portrait->model_path, fixed ? "--fix-eye" : "--eye");
  if (control->smooth_eye)
    session_warn(session, "--smooth-eye changes nothing: %s was trained without eye values", portrait->model_path);
  return 0;
}

int control_clip(const struct control *control, struct session *session, const struct args *args,
                 struct frame_source *frame_source) {
  int status = 0;
  if (args_given(args, "hold-pose") && control->hold >= frame_source->count)
    return args_refuse(args, "--set hold-pose is %" PRIu64 ", expected 0 to %zu, the number of the last pose",
                       control->hold, frame_source->count - 1);
  if (control->smooth_path) status = frame_source_smooth_path(frame_source, session, control->smooth_window);
  if (status == 0 && args_given(args, "hold-pose")) frame_source_hold_pose(frame_source, (size_t)control->hold);
  if (status == 0 && args_given(args, "rotate")) frame_source_turn(frame_source, control->turn);
  if (status == 0 && control->smooth_eye) status = frame_source_smooth_eye(frame_source, session);
  if (status == 0 && args_given(args, "fix-eye")) frame_source_fix_eye(frame_source, control->fix_eye);
  return status;
}

int control_output(const struct control *control, struct session *session, struct frame_source *frame_source) {
  ern_eyes eyes = {0};
  int status = 0;
  if (control->eye == NULL) return 0;
  if (ern_eyes_load(session->context, control->eye, &eyes) != ERN_OK) return session_fail(session);
  const struct source_frame *last = &frame_source->source_frame[frame_source->count - 1];
  const size_t needed = last->place + 1 + (last->toward > 0);
  if (eyes.count < needed)
    status =
        session_fail_with(session, "%s: has eyes for %zu frames, expected at least %zu, the frames of the output%s",
                          control->eye, eyes.count, needed, frame_source->frame != NULL ? " at 25 a second" : "");
  for (size_t k = 0; status == 0 && k < frame_source->count; k++) {
    struct source_frame *source_frame = &frame_source->source_frame[k];
    const float *eye = eyes.data + source_frame->place;
    source_frame->eye = source_frame->toward > 0 ? eye[0] + source_frame->toward * (eye[1] - eye[0]) : eye[0];
  }
  ern_eyes_free(session->context, &eyes);
  return status;
}
