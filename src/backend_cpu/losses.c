/* SPDX-License-Identifier: MIT
 * Slots of the losses: each shard's share of the terms, added in the order of the shards. */
#include <math.h>

#include "backend_cpu/slots.h"
#include "train/losses_ops.h"

struct head_loss_job {
  const struct ern_cpu_kernels *kernels;
  struct ern_head_loss_args *args;
  struct ern_softmax part[ERN_SHARDS], softmax;
  double terms[ERN_SHARDS][ERN_LOSS_TERMS];
};

static void head_softmax_task(void *user, size_t k, int worker) {
  (void)worker;
  struct head_loss_job *job = user;
  const struct range r = shard(job->args->n, 64, k);
  job->part[k] = job->kernels->head_softmax(after(reals(job->args->uncertainty), r.begin), r.end - r.begin);
}

/* Combines the shards' parts: each sum is of exp(u - the part's maximum). */
static struct ern_softmax softmax_of_parts(const struct ern_softmax part[ERN_SHARDS]) {
  struct ern_softmax all = {part[0].most, 0};
  for (int k = 1; k < ERN_SHARDS; k++) {
    if (part[k].most > all.most) all.most = part[k].most;
  }
  for (int k = 0; k < ERN_SHARDS; k++) {
    if (part[k].sum != 0) all.sum += part[k].sum * exp((double)part[k].most - (double)all.most);
  }
  return all;
}

static void head_loss_task(void *user, size_t k, int worker) {
  (void)worker;
  struct head_loss_job *job = user;
  struct ern_head_loss_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  const struct ern_head_loss_view view = {.dpixel = after(reals(a->dpixel.span), r.begin),
                                          .dopacity = after(reals(a->dopacity), r.begin),
                                          .dattention = after(reals(a->dattention), r.begin),
                                          .deye = after(reals(a->deye), r.begin),
                                          .duncertainty = after(reals(a->duncertainty), r.begin),
                                          .pixel = after(reals(a->pixel.span), r.begin),
                                          .truth = after(reals(a->truth.span), r.begin),
                                          .opacity = after(reals(a->opacity), r.begin),
                                          .attention = after(reals(a->attention), r.begin),
                                          .eye = after(reals(a->eye), r.begin),
                                          .uncertainty = after(reals(a->uncertainty), r.begin),
                                          .face = after(reals(a->face), r.begin),
                                          .stride = a->pixel.stride};
  job->kernels->head_loss(job->terms[k], &view, &a->weights, a->max_steps, &job->softmax, a->n, r.end - r.begin);
}

ern_status ERN_REF(ern_cpu_head_loss)(struct ern_stream *stream, struct ern_head_loss_args *a) {
  static const ern_loss_term own[] = {ERN_LOSS_PHOTOMETRIC, ERN_LOSS_UNCERTAINTY,   ERN_LOSS_STATIC_UNCERTAINTY,
                                      ERN_LOSS_ENTROPY,     ERN_LOSS_AUDIO_AMBIENT, ERN_LOSS_EYE_AMBIENT};
  struct head_loss_job job = {.kernels = kernels_of(stream), .args = a};
  if (a->weights.adaptive) {
    ern_pool_run(pool_of(stream), ERN_SHARDS, head_softmax_task, &job);
    job.softmax = softmax_of_parts(job.part);
  }
  ern_pool_run(pool_of(stream), ERN_SHARDS, head_loss_task, &job);
  for (size_t t = 0; t < sizeof own / sizeof *own; t++) {
    a->terms[own[t]] = 0;
    for (int k = 0; k < ERN_SHARDS; k++) a->terms[own[t]] += job.terms[k][own[t]];
  }
  return ERN_OK;
}

static void smooth_loss_task(void *user, size_t k, int worker) {
  (void)worker;
  struct figure_job *job = user;
  const struct ern_smooth_loss_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->part[k] = job->kernels->smooth_loss(reals(a->dmoved) + r.begin, reals(a->still) + r.begin,
                                           reals(a->moved) + r.begin, a->weight, a->batch, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_smooth_loss)(struct ern_stream *stream, struct ern_smooth_loss_args *a) {
  a->term = sum_of_parts(stream, a, smooth_loss_task);
  return ERN_OK;
}

ERN_SHARDED_SLOT(smooth_points, a->n, 64) {
  kernels->smooth_points(reals(a->moved.span) + r.begin, reals(a->x.span) + r.begin, a->x.stride, a->reach, a->seed,
                         a->step, a->first + r.begin, r.end - r.begin);
}

static void mse_task(void *user, size_t k, int worker) {
  (void)worker;
  struct figure_job *job = user;
  const struct ern_mse_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->part[k] = job->kernels->mse(reals(a->dpixel.span) + r.begin, reals(a->pixel.span) + r.begin,
                                   reals(a->truth.span) + r.begin, a->pixel.stride, a->n, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_mse)(struct ern_stream *stream, struct ern_mse_args *a) {
  a->term = sum_of_parts(stream, a, mse_task);
  return ERN_OK;
}

ern_status ERN_REF(ern_cpu_key_points_loss)(struct ern_stream *stream, struct ern_key_points_loss_args *a) {
  a->term = kernels_of(stream)->key_points_loss(reals(a->danchors), reals(a->anchors));
  return ERN_OK;
}

struct pose_job {
  const struct ern_cpu_kernels *kernels;
  const struct ern_pose_bwd_args *args;
  double part[ERN_SHARDS][ERN_POSE_PARAMETERS];
};
static void pose_task(void *user, size_t k, int worker) {
  (void)worker;
  struct pose_job *job = user;
  const struct ern_pose_bwd_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->pose_bwd(job->part[k], reals(a->dx.span) + r.begin, a->dx.stride, reals(a->x.span) + r.begin,
                         a->x.stride, after(reals(a->dd.span), r.begin), a->dd.stride, after(reals(a->d.span), r.begin),
                         a->d.stride, after(reals(a->weight), r.begin), r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_pose_bwd)(struct ern_stream *stream, struct ern_pose_bwd_args *a) {
  struct pose_job job = {.kernels = kernels_of(stream), .args = a};
  ern_pool_run(pool_of(stream), ERN_SHARDS, pose_task, &job);
  for (size_t i = 0; i < ERN_POSE_PARAMETERS; i++) {
    a->dpose[i] = 0;
    for (size_t k = 0; k < ERN_SHARDS; k++) a->dpose[i] += job.part[k][i];
  }
  return ERN_OK;
}
