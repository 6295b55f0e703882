/* SPDX-License-Identifier: MIT
 * Slots of the region attention. */
#include "backend_cpu/slots.h"
#include "model/attention_ops.h"

static struct ern_attention_shape shape_of(const struct ern_attention_fwd_args *a) {
  return (struct ern_attention_shape){a->region.rows, a->v.rows};
}

ERN_SHARDED_SLOT(attention_fwd, a->n, 64) {
  kernels->attention_fwd(after(reals(a->region.span), r.begin), after(reals(a->norm), r.begin),
                         after(reals(a->region_eye), r.begin), after(reals(a->v.span), r.begin), reals(a->code),
                         after(reals(a->eye_attention), r.begin), a->eye, shape_of(a), a->v.stride, r.end - r.begin);
}
ERN_SHARDED_SLOT(attention_fade, a->n, 64) {
  kernels->attention_fade(after(reals(a->v.span), r.begin), after(reals(a->height), r.begin), a->fade, a->v.rows,
                          a->v.stride, r.end - r.begin);
}
static void attention_bwd_task(void *user, size_t k, int worker) {
  (void)worker;
  const struct job *job = user;
  const struct ern_attention_bwd_args *a = job->args;
  const struct range r = shard(a->forward.n, 64, k);
  ern_real *dcode = a->dcode.buffer != NULL ? job->block + k * job->block_stride : NULL;
  job->kernels->attention_bwd(after(reals(a->dv.span), r.begin), dcode, after(reals(a->deye_attention), r.begin),
                              after(reals(a->dregion.span), r.begin), after(reals(a->dnorm), r.begin),
                              after(reals(a->dregion_eye), r.begin), after(reals(a->forward.v.span), r.begin),
                              after(reals(a->forward.norm), r.begin), reals(a->forward.code), a->forward.eye,
                              shape_of(&a->forward), a->forward.v.stride, r.end - r.begin);
}
ern_status ERN_REF(ern_cpu_attention_bwd)(struct ern_stream *stream, struct ern_attention_bwd_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  const size_t channels = (size_t)a->forward.region.rows;
  struct job job = {
      .stream = stream, .kernels = kernels_of(stream), .args = a, .block_stride = (channels + 15) / 16 * 16};
  const ern_status status = take_blocks(stream, job.block_stride, &job.block);
  if (status == ERN_OK) {
    memset(job.block, 0, job.block_stride * ERN_SHARDS * sizeof *job.block);
    ern_pool_run(pool_of(stream), ERN_SHARDS, attention_bwd_task, &job);
    ern_real *dcode = reals(a->dcode);
    for (size_t k = 0; dcode != NULL && k < ERN_SHARDS; k++)
      for (size_t c = 0; c < channels; c++) dcode[c] += job.block[k * job.block_stride + c];
  }
  ern_arena_release(stream, mark);
  return status;
}
