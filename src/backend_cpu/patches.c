/* SPDX-License-Identifier: MIT
 * Slot of the loss over patches: channels of patches one after another, sums in the order of the shards. */
#include "backend_cpu/slots.h"
#include "train/patches_ops.h"

struct patch_job {
  const struct ern_cpu_kernels *kernels;
  const struct ern_patch_loss_args *args;
  ern_real *scratch; /* [ERN_SHARDS][ERN_PATCH_SCRATCH side^2] */
  double part[ERN_SHARDS];
};

static void patch_task(void *user, size_t k, int worker) {
  (void)worker;
  struct patch_job *job = user;
  const struct ern_patch_loss_args *a = job->args;
  const size_t n = (size_t)a->side * (size_t)a->side, channels = 3 * a->patches;
  const struct range r = shard(channels, 1, k);
  const float weight = (float)((double)a->weight / (double)(ERN_PATCH_SCALES * channels));
  for (size_t i = r.begin; i < r.end; i++) {
    const size_t row = i % 3, at = i / 3 * n;
    job->part[k] += ERN_REF(ern_patch_pyramid)(
        job->kernels->patch_scale, reals(a->dpixel.span) + row * a->dpixel.stride + at,
        reals(a->pixel.span) + row * a->pixel.stride + at, reals(a->truth.span) + row * a->truth.stride + at,
        reals(a->filter), a->side, weight, job->scratch + k * ERN_PATCH_SCRATCH * n);
  }
}

ern_status ERN_REF(ern_cpu_patch_loss)(struct ern_stream *stream, struct ern_patch_loss_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  struct patch_job job = {.kernels = kernels_of(stream), .args = a};
  ern_span scratch;
  ern_status status = ERN_OK;
  a->term = 0;
  if (a->patches == 0) return ERN_OK;
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL,
                           (size_t)ERN_SHARDS * ERN_PATCH_SCRATCH * (size_t)a->side * (size_t)a->side, &scratch));
  job.scratch = reals(scratch);
  ern_pool_run(pool_of(stream), ERN_SHARDS, patch_task, &job);
  for (int k = 0; k < ERN_SHARDS; k++) a->term += job.part[k];
fail:
  ern_arena_release(stream, mark);
  return status;
}
