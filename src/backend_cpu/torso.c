/* SPDX-License-Identifier: MIT
 * Slots of the torso. */
#include "backend_cpu/slots.h"
#include "model/torso_ops.h"
#include "render/stages.h"

ern_status ERN_REF(ern_cpu_torso_pose_fwd)(struct ern_stream *stream, struct ern_torso_pose_fwd_args *a) {
  kernels_of(stream)->torso_pose_fwd(reals(a->k), reals(a->anchors), reals(a->gamma), a->pose);
  return ERN_OK;
}
ern_status ERN_REF(ern_cpu_torso_pose_bwd)(struct ern_stream *stream, struct ern_torso_pose_bwd_args *a) {
  kernels_of(stream)->torso_pose_bwd(reals(a->danchors), reals(a->dgamma), reals(a->dk), reals(a->forward.anchors),
                                     reals(a->forward.gamma), a->forward.pose);
  return ERN_OK;
}
ern_status ERN_REF(ern_cpu_torso_coords)(struct ern_stream *stream, struct ern_torso_coords_args *a) {
  kernels_of(stream)->torso_coords(reals(a->q.span), a->q.stride, int32s(a->pixel), a->width, a->height, a->shrink,
                                   a->n);
  return ERN_OK;
}
ern_status ERN_REF(ern_cpu_torso_select)(struct ern_stream *stream, struct ern_torso_select_args *a) {
  a->count = kernels_of(stream)->torso_select(int32s(a->index), int32s(a->selected), int32s(a->pixel), reals(a->grid),
                                              a->threshold, a->width, a->height, a->n);
  return ERN_OK;
}
ern_status ERN_REF(ern_cpu_torso_move)(struct ern_stream *stream, struct ern_torso_move_args *a) {
  kernels_of(stream)->torso_move(reals(a->moved.span), reals(a->q.span), a->motion, a->shrink, a->moved.stride, a->n);
  return ERN_OK;
}
ern_status ERN_REF(ern_cpu_torso_deform_fwd)(struct ern_stream *stream, struct ern_torso_deform_fwd_args *a) {
  kernels_of(stream)->torso_deform_fwd(reals(a->x.span), reals(a->q.span), reals(a->d.span), a->x.stride, a->n);
  return ERN_OK;
}
ern_status ERN_REF(ern_cpu_torso_deform_bwd)(struct ern_stream *stream, struct ern_torso_deform_bwd_args *a) {
  kernels_of(stream)->torso_deform_bwd(reals(a->dd.span), reals(a->dx.span), reals(a->forward.q.span),
                                       reals(a->forward.d.span), a->dd.stride, a->forward.n);
  return ERN_OK;
}
ern_status ERN_REF(ern_cpu_torso_composite_fwd)(struct ern_stream *stream, struct ern_torso_composite_fwd_args *a) {
  ern_real *pixel = reals(a->pixel.span);
  const ern_real *background = reals(a->background.span);
  for (size_t c = 0; c < 3 && pixel != background; c++)
    memcpy(pixel + c * a->pixel.stride, background + c * a->background.stride, a->rays * sizeof *pixel);
  if (a->opacity.buffer != NULL) memset(reals(a->opacity), 0, a->rays * sizeof *pixel);
  kernels_of(stream)->torso_composite_fwd(pixel, reals(a->opacity), reals(a->layer.span), a->layer.stride,
                                          int32s(a->index), background, a->background.stride, a->n);
  return ERN_OK;
}
ern_status ERN_REF(ern_cpu_torso_composite_bwd)(struct ern_stream *stream, struct ern_torso_composite_bwd_args *a) {
  kernels_of(stream)->torso_composite_bwd(
      reals(a->dlayer.span), a->dlayer.stride, reals(a->dpixel.span), reals(a->forward.layer.span),
      int32s(a->forward.index), reals(a->forward.background.span), a->forward.background.stride, a->forward.n);
  return ERN_OK;
}
ern_status ERN_REF(ern_cpu_torso_points)(struct ern_stream *stream, struct ern_torso_points_args *a) {
  kernels_of(stream)->torso_points(reals(a->q.span), a->q.stride, a->shrink, a->seed, a->step);
  return ERN_OK;
}
ern_status ERN_REF(ern_cpu_torso_update)(struct ern_stream *stream, struct ern_torso_update_args *a) {
  a->mean = kernels_of(stream)->torso_update(reals(a->grid), reals(a->alpha), a->decay);
  return ERN_OK;
}
ern_status ERN_REF(ern_cpu_render_torso)(struct ern_stream *stream, struct ern_render_torso_args *a) {
  return ern_render_torso_stages(stream, a);
}
