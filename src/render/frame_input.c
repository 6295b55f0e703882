/* SPDX-License-Identifier: MIT */
#include "render/frame_input.h"

#include <math.h>

#include "core/status.h"
#include "mlp/audio_ops.h"

enum { MAX_SIDE = 8192, MAX_FRAME_SIDE = 32768, MAX_WINDOW_LENGTH = 16 };
/* Largest magnitude of an entry of the pose's 3x3 part (1 in a true rotation): limits a ray's direction, so that its
 * cubes and values computed from them do not overflow a float. */
static const float MAX_ROTATION = 1000;

/* Determinant of the columns a, b, c of the first three rows. */
static double determinant(const float m[16], int a, int b, int c) {
  const float *x = m, *y = m + 4, *z = m + 8;
  return (double)x[a] * ((double)y[b] * (double)z[c] - (double)y[c] * (double)z[b]) -
         (double)x[b] * ((double)y[a] * (double)z[c] - (double)y[c] * (double)z[a]) +
         (double)x[c] * ((double)y[a] * (double)z[b] - (double)y[b] * (double)z[a]);
}

/* Rays need the inverse of the 3x3 part, the torso's key points that of the whole matrix. */
static bool can_be_inverted(const float m[16]) {
  const double rotation = determinant(m, 0, 1, 2);
  const double whole = (double)m[15] * rotation - (double)m[14] * determinant(m, 0, 1, 3) +
                       (double)m[13] * determinant(m, 0, 2, 3) - (double)m[12] * determinant(m, 1, 2, 3);
  return fabs(rotation) > 1e-6 && fabs(whole) > 1e-6;
}

ern_status ern_pose_check(ern_context *context, const char *name, const float pose[16]) {
  for (int i = 0; i < 16; i++)
    if (!isfinite(pose[i])) return ern_fail(context, ERN_E_NONFINITE, "%s: value %d is not finite", name, i);
  for (int i = 0; i < 12; i++)
    if (i % 4 < 3 && fabsf(pose[i]) > MAX_ROTATION)
      return ern_fail(context, ERN_E_ARGUMENT, "%s: value %d, of the rotation, is %g, expected %g at most", name, i,
                      (double)pose[i], (double)MAX_ROTATION);
  if (!can_be_inverted(pose))
    return ern_fail(context, ERN_E_ARGUMENT, "%s: the matrix, or its rotation, cannot be inverted", name);
  return ERN_OK;
}

ern_status ern_feature_refuse(ern_context *context, const char *where, size_t i, float value) {
  if (!isfinite(value)) return ern_fail(context, ERN_E_NONFINITE, "%s: value %zu is not finite", where, i);
  return ern_fail(context, ERN_E_ARGUMENT, "%s: value %zu is %g, expected -1e30 to 1e30", where, i, (double)value);
}

ern_status ern_window_length_check(ern_context *context, const struct ern_field *field, const char *where,
                                   int window_length) {
  const int own = field->config.window_length;
  if (window_length < 1 || window_length > MAX_WINDOW_LENGTH)
    return ern_fail(context, ERN_E_ARGUMENT, "%s: window_length is %d, expected 1 to 16", where, window_length);
  if (own == 0 || window_length == own) return ERN_OK;
  return ern_fail(context, ERN_E_MISMATCH,
                  "%s: the windows of the speech are %d vectors long, expected %d: those that the model was trained on",
                  where, window_length, own);
}

ern_status ern_frame_windows_check(ern_context *context, const struct ern_field *field, const ern_frame_input *input) {
  const ern_status status = ern_window_length_check(context, field, "render", input->window_length);
  if (status != ERN_OK) return status;
  if (input->windows == NULL) return ern_fail(context, ERN_E_ARGUMENT, "render: windows is NULL, expected the speech");
  const size_t values = (size_t)ERN_AUDIO_WINDOWS * (size_t)input->window_length * (size_t)field->config.feature_width;
  for (size_t i = 0; i < values; i++)
    if (!ern_feature_fits(input->windows[i]))
      return ern_feature_refuse(context, "render: speech window", i, input->windows[i]);
  return ERN_OK;
}

/* Limits the frame so that pixel numbers fit into 32 bits. */
static bool frame_is_placed(const ern_box *frame) {
  const int ends[] = {frame->top, frame->bottom, frame->left, frame->right};
  if (frame->top == 0 && frame->bottom == 0 && frame->left == 0 && frame->right == 0) return true;
  for (size_t i = 0; i < sizeof ends / sizeof *ends; i++)
    if (ends[i] < -MAX_FRAME_SIDE || ends[i] > MAX_FRAME_SIDE) return false;
  const int height = frame->bottom - frame->top, width = frame->right - frame->left;
  return height >= 1 && height <= MAX_FRAME_SIDE && width >= 1 && width <= MAX_FRAME_SIDE;
}

ern_status ern_frame_input_check(ern_context *context, const struct ern_field *field, const ern_frame_input *input) {
  const ern_camera *camera = &input->camera;
  if (camera->width < 1 || camera->width > MAX_SIDE || camera->height < 1 || camera->height > MAX_SIDE)
    return ern_fail(context, ERN_E_ARGUMENT, "render: the size is %d x %d, expected 1 to %d a side", camera->width,
                    camera->height, MAX_SIDE);
  if (!frame_is_placed(&camera->frame))
    return ern_fail(context, ERN_E_ARGUMENT,
                    "render: camera: the frame is at rows [%d, %d), columns [%d, %d), expected sides of 1 to %d within "
                    "%d, or zeros",
                    camera->frame.top, camera->frame.bottom, camera->frame.left, camera->frame.right, MAX_FRAME_SIDE,
                    MAX_FRAME_SIDE);
  if (!(camera->focal > 0) || !isfinite(camera->focal) || !isfinite(camera->cx) || !isfinite(camera->cy))
    return ern_fail(context, ERN_E_ARGUMENT,
                    "render: camera: focal %g, centre %g, %g, expected finite numbers, focal above 0",
                    (double)camera->focal, (double)camera->cx, (double)camera->cy);
  ern_status status = ern_pose_check(context, "render: pose", camera->pose);
  if (status == ERN_OK && input->head_pose != NULL)
    status = ern_pose_check(context, "render: head_pose", input->head_pose);
  if (status == ERN_OK) status = ern_frame_windows_check(context, field, input);
  if (status != ERN_OK) return status;
  if (!(input->eye >= 0 && input->eye <= 1))
    return ern_fail(context, ERN_E_ARGUMENT, "render: eye is %g, expected 0 to 1", (double)input->eye);
  for (int i = 0; i < ERN_MOTION_VALUES && input->torso_motion != NULL; i++)
    if (!(fabsf(input->torso_motion[i]) <= 1e3f))
      return ern_fail(context, ERN_E_ARGUMENT, "render: torso_motion: value %d is %g, expected -1000 to 1000", i,
                      (double)input->torso_motion[i]);
  if (!(input->silence_weight >= 0 && input->silence_weight <= 1) ||
      (input->silence_weight > 0 && input->silence_code == NULL))
    return ern_fail(context, ERN_E_ARGUMENT,
                    "render: silence_weight is %g %s a silence_code, expected 0 to 1 and a code where above 0",
                    (double)input->silence_weight, input->silence_code != NULL ? "with" : "without");
  for (int i = 0; i < ERN_AUDIO_CODE && input->silence_weight > 0; i++)
    if (!isfinite(input->silence_code[i]))
      return ern_fail(context, ERN_E_NONFINITE, "render: silence_code: value %d is not finite", i);
  if (field->config.codes > 0 && input->individual != ERN_INDIVIDUAL_MEAN &&
      input->individual >= (size_t)field->config.codes)
    return ern_fail(context, ERN_E_ARGUMENT, "render: individual code %zu, expected 0 to %d", input->individual,
                    field->config.codes - 1);
  return ERN_OK;
}
