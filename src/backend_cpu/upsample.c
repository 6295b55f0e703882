/* SPDX-License-Identifier: MIT
 * The slot that enlarges a layer. */
#include "backend_cpu/slots.h"
#include "render/upsample_ops.h"

/* Shards of whole rows. */
ERN_SHARDED_SLOT(upsample, (size_t)a->height, 1) {
  const struct ern_upsample_view view = {.large = reals(a->large.span),
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
  kernels->upsample(&view, (int)r.begin, (int)r.end);
}
