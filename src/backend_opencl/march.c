/* SPDX-License-Identifier: MIT
 * Slots of march.cl: rays, the march, the scan of sample counts, and samples. */
#include <assert.h>
#include <math.h>

#include "backend_opencl/device/limits.h"
#include "backend_opencl/opencl.h"
#include "render/march_ops.h"

ern_status ern_cl_rays(struct ern_stream *stream, struct ern_rays_args *a) {
  static_assert(sizeof(struct ern_view) == 21 * 4, "struct view in march.cl");
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_march, "rays", "");
  ERN_CL_ARGS(&call, a->dir, a->pixel);
  ern_cl_value(&call, &a->view, sizeof a->view);
  ern_cl_size(&call, a->n);
  return ern_cl_each(&call, a->n);
}

/* Common data of the rays of a march; the same struct is in march.cl. */
struct walk {
  cl_float origin[3];
  cl_float bound, inverse_bound;
  cl_float near;
  cl_float gamma, shortest, longest;
  cl_float cell;
  cl_int max_steps;
};
static_assert(sizeof(struct walk) == 11 * 4, "struct walk in march.cl");

/* Rounding errors of the distance to a cell's border are below 2^-15 of its width where the box has a usual size; the
 * tolerance is 2^-10. */
static struct walk walk_of(const float origin[3], const struct ern_march_settings *settings) {
  const double two_root_three = 3.46410161513775459; /* the diagonal of [-1, 1]^3 */
  const float bound = settings->bound;
  const bool is_usual = bound >= 0x1p-20f && bound <= 0x1p20f;
  struct walk walk = {.origin = {origin[0], origin[1], origin[2]},
                      .bound = bound,
                      .inverse_bound = 1 / bound,
                      .near = settings->near,
                      .gamma = settings->dt_gamma,
                      .shortest = (float)(two_root_three / settings->max_steps),
                      .longest = (float)(two_root_three / ERN_OCCUPANCY_SIDE),
                      .cell = is_usual ? 2 * bound / ERN_OCCUPANCY_SIDE * (1 + 1.0f / 1024) : INFINITY,
                      .max_steps = settings->max_steps};
  if (walk.shortest > walk.longest) walk.shortest = walk.longest;
  return walk;
}

ern_status ern_cl_march(struct ern_stream *stream, struct ern_march_args *a) {
  enum {
    CPU_GROUP = 4,
    GPU_GROUP = ERN_CL_LIMIT_group_items
  }; /* rays differ in length: small groups balance the load */
  const struct ern_cl_device *device = &ern_cl_backend_of(stream)->device;
  const size_t group = device->cpu ? CPU_GROUP : GPU_GROUP, rays_a_group = group * (size_t)device->width;
  const struct walk walk = walk_of(a->origin, &a->settings);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_march, "march", "");
  ERN_CL_ARGS(&call, a->t, a->count, a->dir, a->jitter, a->bits);
  ern_cl_value(&call, &walk, sizeof walk);
  ern_cl_size(&call, a->n);
  return ern_cl_run(&call, a->n / rays_a_group + (a->n % rays_a_group != 0), group);
}

ern_status ern_cl_samples(struct ern_stream *stream, struct ern_samples_args *a) {
  enum { TEAM = 16 }; /* work-items a ray */
  const struct walk walk = walk_of(a->origin, &a->settings);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_march, "samples", "");
  ERN_CL_ARGS(&call, a->x, a->dt, a->depth, a->ray, a->t, a->first, a->dir);
  ern_cl_value(&call, &walk, sizeof walk);
  ern_cl_size(&call, a->n);
  return ern_cl_each(&call, ern_cl_backend_of(stream)->device.cpu ? a->n : a->n * TEAM);
}

ern_status ern_cl_spread_rays(struct ern_stream *stream, struct ern_spread_rays_args *a) {
  if (a->n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_march, "spread_rays", "");
  ERN_CL_ARGS(&call, a->y, a->x, a->ray, a->y.rows, a->n);
  return ern_cl_each(&call, a->n);
}
