/* SPDX-License-Identifier: MIT
 * Slots of whole training steps and densities, by the separate stages. */
#include "train/step.h"

#include "backend_cpu/slots.h"
#include "render/render_ops.h"
#include "train/step_ops.h"

ern_status ERN_REF(ern_cpu_head_density)(struct ern_stream *stream, struct ern_head_density_args *a) {
  return ern_head_density_stages(stream, a);
}
ern_status ERN_REF(ern_cpu_head_step)(struct ern_stream *stream, struct ern_head_step_args *a) {
  return ern_head_step_stages(stream, a);
}
ern_status ERN_REF(ern_cpu_torso_step)(struct ern_stream *stream, struct ern_torso_step_args *a) {
  return ern_torso_step_stages(stream, a);
}
