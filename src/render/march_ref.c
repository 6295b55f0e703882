/* SPDX-License-Identifier: MIT
 * Rays, their march through the occupancy grid, and their samples (docs/maths.md, Rays and samples). In float in every
 * build, so that float and double builds use the same rays and evaluate the model at the same points. */
#include <math.h>

#include "render/march_ops.h"
#include "render/morton.h"

/* Of a pinhole camera (docs/maths.md, Rays and samples): c = ((i + 1/2 - cx)/f, (j + 1/2 - cy)/f, 1), then d = R c/|c|,
 * R the rotation of the pose. */
void ERN_REF(ern_rays)(ern_real *dir, size_t stride, const int32_t *pixel, const struct ern_view *view, size_t n) {
  for (size_t r = 0; r < n; r++) {
    const float column = (float)(pixel[r] % view->width), row = (float)(pixel[r] / view->width);
    const float x = (column + 0.5f - view->cx) / view->focal, y = (row + 0.5f - view->cy) / view->focal;
    const float length = sqrtf(x * x + y * y + 1.0f);
    const float unit[3] = {x / length, y / length, 1.0f / length};
    for (size_t axis = 0; axis < 3; axis++) {
      const float *rotation = &view->pose[4 * axis];
      dir[axis * stride + r] = rotation[0] * unit[0] + rotation[1] * unit[1] + rotation[2] * unit[2];
    }
  }
}

static const double two_root_three = 3.46410161513775459; /* the diagonal of [-1, 1]^3 */

struct stepping {
  float gamma, shortest, longest;
};

static struct stepping stepping_of(const struct ern_march_settings *settings) {
  struct stepping stepping = {settings->dt_gamma, (float)(two_root_three / settings->max_steps),
                              (float)(two_root_three / ERN_OCCUPANCY_SIDE)};
  if (stepping.shortest > stepping.longest) stepping.shortest = stepping.longest;
  return stepping;
}

/* NaN becomes `low`, so that a cell number is always one of the grid. */
static float clamp(float value, float low, float high) { return value > low ? (value < high ? value : high) : low; }

/* dt(t) = clamp(gamma t, shortest, longest) */
static float step_at(const struct stepping *stepping, float t) {
  return clamp(t * stepping->gamma, stepping->shortest, stepping->longest);
}

struct ray {
  float origin[3], d[3], inverse[3]; /* inverse = 1/d */
};

static struct ray ray_of(const float origin[3], const ern_real *dir, size_t stride) {
  struct ray ray;
  for (size_t axis = 0; axis < 3; axis++) {
    ray.origin[axis] = origin[axis];
    ray.d[axis] = (float)dir[axis * stride];
    ray.inverse[axis] = 1 / ray.d[axis];
  }
  return ray;
}

/* Where the ray is inside the box: near <= t <= far. False where it misses, and where it runs within the plane of a
 * face (0 * infinity). */
static bool box_enter(float *near, float *far, const struct ray *ray, float bound) {
  const float half[3] = {bound, bound / 2, bound};
  *near = -INFINITY, *far = INFINITY;
  for (int axis = 0; axis < 3; axis++) {
    const float t0 = (-half[axis] - ray->origin[axis]) * ray->inverse[axis];
    const float t1 = (half[axis] - ray->origin[axis]) * ray->inverse[axis];
    if (isnan(t0) || isnan(t1)) return false;
    const float enter = t0 < t1 ? t0 : t1, leave = t0 < t1 ? t1 : t0;
    if (enter > *near) *near = enter;
    if (leave < *far) *far = leave;
  }
  return *near <= *far;
}

/* The cell of point p on one axis: clamp(int(64 (p/bound + 1)), 0, 127). */
static uint32_t cell_of(float p, float inverse_bound) {
  return (uint32_t)(int)clamp(0.5f * (p * inverse_bound + 1.0f) * ERN_OCCUPANCY_SIDE, 0.0f, ERN_OCCUPANCY_SIDE - 1);
}

/* Distance from p to where the ray leaves the cell. An axis along which the ray does not move gives infinity or,
 * exactly on a border, NaN; neither is ever the smallest. */
static float cell_leave(const struct ray *ray, const float p[3], const uint32_t cell[3], float bound) {
  float least = INFINITY;
  for (int axis = 0; axis < 3; axis++) {
    const float side = ((float)cell[axis] + (signbit(ray->d[axis]) ? 0.0f : 1.0f)) / ERN_OCCUPANCY_SIDE * 2.0f - 1.0f;
    const float distance = (side * bound - p[axis]) * ray->inverse[axis];
    if (distance < least) least = distance;
  }
  return least > 0 ? least : 0;
}

/* One ray; t_out gets the distances of its samples, and their number is returned. */
static int march_ray(ern_real *t_out, const struct ray *ray, float jitter, float not_before, const uint8_t *bits,
                     const struct ern_march_settings *settings, const struct stepping *stepping) {
  const float bound = settings->bound, inverse_bound = 1 / bound;
  float near, far;
  if (!box_enter(&near, &far, ray, bound)) return 0;
  if (near < settings->near) near = settings->near;
  /* Longer than any path through the box, so this limit acts only where d is not a unit vector, and then ends the
   * loops. */
  if (far > near + 4 * bound) far = near + 4 * bound;
  float t = near + step_at(stepping, near) * jitter;
  for (float last = -INFINITY; t > last && t < not_before && t < far;) {
    last = t;
    t += step_at(stepping, last);
  }
  int count = 0;
  while (t < far && count < settings->max_steps) {
    float p[3];
    uint32_t cell[3];
    for (int axis = 0; axis < 3; axis++) {
      p[axis] = clamp(ray->origin[axis] + t * ray->d[axis], -bound, bound);
      cell[axis] = cell_of(p[axis], inverse_bound);
    }
    const uint32_t number = ern_morton(cell[0], cell[1], cell[2]);
    float next = t + step_at(stepping, t);
    if (bits[number >> 3] >> (number & 7) & 1) {
      t_out[count++] = t;
    } else {
      /* steps until past the border, so that a ray's samples stay on its own sequence t_{k+1} = t_k + dt(t_k) */
      const float border = t + cell_leave(ray, p, cell, bound);
      for (float last = t; last < next && next < border && next < far;) {
        last = next;
        next += step_at(stepping, last);
      }
    }
    if (!(next > t)) break; /* so far away that t + dt = t */
    t = next;
  }
  return count;
}

void ERN_REF(ern_march)(ern_real *t, int32_t *count, const ern_real *dir, size_t stride, const ern_real *jitter,
                        const uint8_t *bits, const float origin[3], const struct ern_march_settings *settings,
                        size_t n) {
  const struct stepping stepping = stepping_of(settings);
  for (size_t r = 0; r < n; r++) {
    const struct ray ray = ray_of(origin, dir + r, stride);
    const float start = jitter ? (float)jitter[r] : 0.0f;
    count[r] = march_ray(&t[r * (size_t)settings->max_steps], &ray, start, -INFINITY, bits, settings, &stepping);
  }
}

void ERN_REF(ern_march_from)(ern_real *t, int32_t *count, const ern_real *dir, size_t stride, const ern_real *jitter,
                             const float *not_before, const uint8_t *bits, const float origin[3],
                             const struct ern_march_settings *settings, size_t n) {
  const struct stepping stepping = stepping_of(settings);
  for (size_t r = 0; r < n; r++) {
    const struct ray ray = ray_of(origin, dir + r, stride);
    const float start = jitter ? (float)jitter[r] : 0.0f;
    count[r] = march_ray(&t[r * (size_t)settings->max_steps], &ray, start, not_before ? not_before[r] : -INFINITY, bits,
                         settings, &stepping);
  }
}

/* x = clamp(o + t d), dt = dt(t), depth = t + dt, for the samples of ray r packed from first[r] on. */
void ERN_REF(ern_samples)(ern_real *x, size_t x_stride, ern_real *dt, ern_real *depth, int32_t *ray, const ern_real *t,
                          const int32_t *first, const ern_real *dir, size_t dir_stride, const float origin[3],
                          const struct ern_march_settings *settings, size_t ray_begin, size_t n) {
  const struct stepping stepping = stepping_of(settings);
  const float bound = settings->bound;
  for (size_t r = 0; r < n; r++) {
    const float d[3] = {(float)dir[r], (float)dir[dir_stride + r], (float)dir[2 * dir_stride + r]};
    const ern_real *t_ray = &t[r * (size_t)settings->max_steps];
    const size_t begin = (size_t)first[r], end = (size_t)first[r + 1];
    for (size_t i = begin; i < end; i++) {
      const float distance = (float)t_ray[i - begin], step = step_at(&stepping, distance);
      for (size_t axis = 0; axis < 3; axis++) {
        x[axis * x_stride + i] = clamp(origin[axis] + distance * d[axis], -bound, bound);
      }
      dt[i] = step;
      depth[i] = distance + step;
      ray[i] = (int32_t)(ray_begin + r);
    }
  }
}

void ERN_REF(ern_spread_rays)(ern_real *y, size_t y_stride, const ern_real *x, size_t x_stride, const int32_t *ray,
                              int rows, size_t n) {
  for (size_t r = 0; r < (size_t)rows; r++)
    for (size_t i = 0; i < n; i++) y[r * y_stride + i] = x[r * x_stride + (size_t)ray[i]];
}
