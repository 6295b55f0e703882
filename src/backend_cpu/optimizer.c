/* SPDX-License-Identifier: MIT
 * Slots of the optimizer and of the moving average. */
#include <math.h>

#include "backend_cpu/slots.h"
#include "train/optimizer_ops.h"

enum { ALONE = 1 << 13 /* below this, one thread is done before another has woken up */ };

/* bias correction 1 - beta2^step, accurate even after a billion steps, by expm1 of the logarithm. */
struct adamw_job {
  const struct ern_cpu_kernels *kernels;
  const struct ern_adamw_args *args;
  double correction;
};
static void adamw_task(void *user, size_t k, int worker) {
  (void)worker;
  const struct adamw_job *job = user;
  const struct ern_adamw_args *a = job->args;
  const struct range r = shard(a->n, 64, k);
  job->kernels->adamw(reals(a->parameters) + r.begin, reals(a->second_moment) + r.begin, reals(a->gradient) + r.begin,
                      a->rate, a->decay, a->beta2, a->eps, job->correction, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_adamw)(struct ern_stream *stream, struct ern_adamw_args *a) {
  struct adamw_job job = {kernels_of(stream), a, -expm1((double)a->step * log((double)a->beta2))};
  ern_pool_run(a->n > ALONE ? pool_of(stream) : NULL, ERN_SHARDS, adamw_task, &job);
  return ERN_OK;
}

ERN_SHARDED_SLOT(ema, a->n, 64) {
  kernels->ema(reals(a->average) + r.begin, reals(a->parameters) + r.begin, a->decay, r.end - r.begin);
}
