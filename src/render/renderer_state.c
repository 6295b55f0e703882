/* SPDX-License-Identifier: MIT */
#include "render/renderer_state.h"

#include <string.h>

#include "model/torso.h"

ern_status ern_renderer_buffer(ern_renderer *r, enum buffer buffer, ern_element element, size_t count, ern_span *span) {
  ern_status status = ERN_OK;
  if (r->buffer[buffer] == NULL) status = r->backend->buffer_make(r->backend, element, count, &r->buffer[buffer]);
  *span = status == ERN_OK ? ern_whole(r->buffer[buffer], count) : (ern_span){0};
  return status;
}

void ern_renderer_torso_motion(const ern_renderer *r, const ern_frame_input *input, float motion[ERN_MOTION_VALUES]) {
  double predicted[ERN_MOTION_VALUES];
  float own[ERN_MOTION_VALUES] = {0};
  if (r->model->has_motion && input->torso_motion != NULL) {
    memcpy(own, input->torso_motion, sizeof own);
  } else if (r->model->has_motion) {
    ern_pose_regression_predict(r->model->motion[0], ERN_MOTION_VALUES, input->camera.pose, predicted);
    for (int i = 0; i < ERN_MOTION_VALUES; i++) own[i] = (float)predicted[i];
  }
  ern_torso_motion_of(motion, own, r->options.torso_shrink);
}
