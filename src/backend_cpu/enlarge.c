/* SPDX-License-Identifier: MIT
 * The slot that draws a layer larger. */
#include "backend_cpu/slots.h"

/* Shards of whole rows. */
static void enlarge_task(void *user, size_t k, int lane) {
  (void)lane;
  const struct job *job = user;
  const struct ern_enlarge_args *a = job->args;
  const struct range r = shard((size_t)a->height, 1, k);
  const struct ern_enlarge_view view = {.large = reals(a->large.span),
                                        .small = reals(a->small.span),
                                        .background = reals(a->background.span),
                                        .large_stride = a->large.stride,
                                        .small_stride = a->small.stride,
                                        .background_stride = a->background.stride,
                                        .channels = a->large.rows,
                                        .width = a->width,
                                        .small_width = a->small_width,
                                        .small_height = a->small_height,
                                        .ratio = a->ratio};
  job->kernels->enlarge(&view, (int)r.begin, (int)r.end);
}
ern_status ERN_REF(ern_cpu_enlarge)(struct ern_stream *stream, struct ern_enlarge_args *a) {
  run(stream, a, ERN_SHARDS, enlarge_task);
  return ERN_OK;
}
