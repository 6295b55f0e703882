/* SPDX-License-Identifier: MIT */
#include "render/frame_input.h"

#include <math.h>

#include "core/status.h"
#include "mlp/audio_ops.h"

enum { MAX_SIDE = 8192, MAX_WINDOW_LENGTH = 16 };

/* Determinant of the rotation part: what the torso's inverse needs to be away from 0. */
static double determinant(const float m[16]) {
  const double a = (double)m[0], b = (double)m[1], c = (double)m[2], d = (double)m[4], e = (double)m[5],
               f = (double)m[6], g = (double)m[8], h = (double)m[9], i = (double)m[10];
  return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g);
}

ern_status ern_frame_windows_check(ern_context *context, const struct ern_field *field, const ern_frame_input *input) {
  if (input->windows == NULL || input->window_length < 1 || input->window_length > MAX_WINDOW_LENGTH)
    return ern_fail(context, ERN_E_ARGUMENT, "render: window_length is %d, expected 1 to 16 and windows",
                    input->window_length);
  const size_t values = (size_t)ERN_AUDIO_WINDOWS * (size_t)input->window_length * (size_t)field->config.feature_width;
  for (size_t i = 0; i < values; i++)
    if (!isfinite(input->windows[i]))
      return ern_fail(context, ERN_E_NONFINITE, "render: speech window: value %zu is not finite", i);
  return ERN_OK;
}

ern_status ern_frame_input_check(ern_context *context, const struct ern_field *field, const ern_frame_input *input) {
  const ern_camera *camera = &input->camera;
  if (camera->width < 1 || camera->width > MAX_SIDE || camera->height < 1 || camera->height > MAX_SIDE)
    return ern_fail(context, ERN_E_ARGUMENT, "render: the size is %d x %d, expected 1 to %d a side", camera->width,
                    camera->height, MAX_SIDE);
  if (!(camera->focal > 0) || !isfinite(camera->focal) || !isfinite(camera->cx) || !isfinite(camera->cy))
    return ern_fail(context, ERN_E_ARGUMENT,
                    "render: camera: focal %g, centre %g, %g, expected finite numbers, focal above 0",
                    (double)camera->focal, (double)camera->cx, (double)camera->cy);
  for (int i = 0; i < 16; i++)
    if (!isfinite(camera->pose[i]))
      return ern_fail(context, ERN_E_NONFINITE, "render: pose: value %d is not finite", i);
  if (!(fabs(determinant(camera->pose)) > 1e-6))
    return ern_fail(context, ERN_E_ARGUMENT, "render: pose: its rotation cannot be inverted");
  for (int i = 0; i < 16; i++)
    if (input->head_pose != NULL && !isfinite(input->head_pose[i]))
      return ern_fail(context, ERN_E_NONFINITE, "render: head_pose: value %d is not finite", i);
  const ern_status heard = ern_frame_windows_check(context, field, input);
  if (heard != ERN_OK) return heard;
  if (!(input->eye >= 0 && input->eye <= 1))
    return ern_fail(context, ERN_E_ARGUMENT, "render: eye is %g, expected 0 to 1", (double)input->eye);
  if (!(input->rest >= 0 && input->rest <= 1) || (input->rest > 0 && input->rest_code == NULL))
    return ern_fail(context, ERN_E_ARGUMENT,
                    "render: rest is %g %s a rest_code, expected 0 to 1 and a code where above 0", (double)input->rest,
                    input->rest_code != NULL ? "with" : "without");
  for (int i = 0; i < ERN_AUDIO_CODE && input->rest > 0; i++)
    if (!isfinite(input->rest_code[i]))
      return ern_fail(context, ERN_E_NONFINITE, "render: rest_code: value %d is not finite", i);
  if (field->config.codes > 0 && input->individual >= (size_t)field->config.codes)
    return ern_fail(context, ERN_E_ARGUMENT, "render: individual code %zu, expected 0 to %d", input->individual,
                    field->config.codes - 1);
  return ERN_OK;
}
