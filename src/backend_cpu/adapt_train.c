/* SPDX-License-Identifier: MIT
 * Slots of the training: losses, optimizer, average, and whole steps. */
#include "backend_cpu/adapt.h"

#include <math.h>

#include "train/step.h"

static ern_status head_loss(struct ern_stream *stream, struct ern_head_loss_args *a) {
  const struct ern_head_loss_view view = {.dpixel = reals(a->dpixel.span),
                                          .dopacity = reals(a->dopacity),
                                          .dattention = reals(a->dattention),
                                          .deye = reals(a->deye),
                                          .duncertainty = reals(a->duncertainty),
                                          .pixel = reals(a->pixel.span),
                                          .truth = reals(a->truth.span),
                                          .opacity = reals(a->opacity),
                                          .attention = reals(a->attention),
                                          .eye = reals(a->eye),
                                          .uncertainty = reals(a->uncertainty),
                                          .face = reals(a->face),
                                          .stride = a->pixel.stride};
  kernels_of(stream)->head_loss(a->terms, &view, &a->weights, a->max_steps, a->n);
  return ERN_OK;
}
static ern_status smooth_loss(struct ern_stream *stream, struct ern_smooth_loss_args *a) {
  a->term = kernels_of(stream)->smooth_loss(reals(a->dmoved), reals(a->still), reals(a->moved), a->weight, a->n);
  return ERN_OK;
}
static ern_status smooth_points(struct ern_stream *stream, struct ern_smooth_points_args *a) {
  kernels_of(stream)->smooth_points(reals(a->moved.span), reals(a->x.span), a->x.stride, a->reach, a->seed, a->step, 0,
                                    a->n);
  return ERN_OK;
}
static ern_status mse(struct ern_stream *stream, struct ern_mse_args *a) {
  a->term =
      kernels_of(stream)->mse(reals(a->dpixel.span), reals(a->pixel.span), reals(a->truth.span), a->pixel.stride, a->n);
  return ERN_OK;
}
static ern_status key_points_loss(struct ern_stream *stream, struct ern_key_points_loss_args *a) {
  a->term = kernels_of(stream)->key_points_loss(reals(a->danchors), reals(a->anchors));
  return ERN_OK;
}

/* bias correction 1 - beta2^step, exact for a billion steps too: expm1 of the logarithm. */
struct adamw_job {
  const struct ern_cpu_kernels *kernels;
  const struct ern_adamw_args *args;
  double correction;
};
static void adamw_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct adamw_job *job = user;
  const struct ern_adamw_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->adamw(reals(a->parameters) + r.begin, reals(a->second_moment) + r.begin, reals(a->gradient) + r.begin,
                      a->rate, a->decay, a->beta2, a->eps, job->correction, r.end - r.begin);
}
static ern_status adamw(struct ern_stream *stream, struct ern_adamw_args *a) {
  struct adamw_job job = {kernels_of(stream), a, -expm1((double)a->step * log((double)a->beta2))};
  ern_pool_run(pool_of(stream), ERN_SHARDS, adamw_task, &job);
  return ERN_OK;
}
static ern_status ema(struct ern_stream *stream, struct ern_ema_args *a) {
  kernels_of(stream)->ema(reals(a->average), reals(a->parameters), a->decay, a->n);
  return ERN_OK;
}
static ern_status finite(struct ern_stream *stream, struct ern_finite_args *a) {
  a->finite = kernels_of(stream)->finite(reals(a->values), a->n);
  return ERN_OK;
}

void ERN_REF(ern_cpu_fill_train)(struct ern_backend *backend) {
  backend->head_loss = head_loss;
  backend->smooth_loss = smooth_loss;
  backend->smooth_points = smooth_points;
  backend->mse = mse;
  backend->key_points_loss = key_points_loss;
  backend->adamw = adamw;
  backend->ema = ema;
  backend->finite = finite;
  backend->head_step = ern_head_step_stages;
  backend->torso_step = ern_torso_step_stages;
}
