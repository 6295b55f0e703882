/* SPDX-License-Identifier: MIT
 * Rays, marching and samples for any instruction set (simd/isa.h).
 *
 * A lane is a ray (in ern_samples: a sample of one ray). Products are rounded separately, so on every instruction set
 * the results are bit-identical to the reference's. The reference handles rays that t += dt cannot advance (infinite,
 * or so far away that t + dt = t). */
#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes.h"
#include "render/march_ops.h"

enum { AXES = 3 };

/* Bits of the first `count` lanes. */
LANES_INLINE uint32_t bits_below(size_t count) { return count < LANES ? (1u << count) - 1 : (1u << LANES) - 1; }

/* ---- rays of a camera -------------------------------------------------------------------------------------------- */

/* pixel = row*width + column. In double, whose quotient is never rounded up to the next whole number: they are 1/width
 * apart at least, and its error is below 2^31/width * 2^-53. */
LANES_INLINE void pixel_place(vf *column, vf *row, const int32_t *pixel, size_t count, int width) {
  typedef double vd __attribute__((vector_size(LANES * 8)));
  const vi number = (vi)vf_load_first((const float *)pixel, count);
  const vi quotient = __builtin_convertvector(__builtin_convertvector(number, vd) / (double)width, vi);
  *row = __builtin_convertvector(quotient, vf);
  *column = __builtin_convertvector(number - quotient * width, vf);
}

void ERN_ISA(ern_rays)(float *dir, size_t stride, const int32_t *pixel, const struct ern_view *view, size_t n) {
  for (size_t r = 0; r < n; r += LANES) {
    vf column, row;
    pixel_place(&column, &row, pixel + r, n - r, view->width);
    const vf x = (column + 0.5f - view->cx) / view->focal, y = (row + 0.5f - view->cy) / view->focal;
    const vf length = vf_sqrt(vf_multiply_rounded(x, x) + vf_multiply_rounded(y, y) + 1.0f);
    const vf unit[AXES] = {x / length, y / length, 1.0f / length};
#pragma GCC unroll 3
    for (size_t axis = 0; axis < AXES; axis++) {
      const float *rotation = &view->pose[4 * axis];
      const vf sum =
          vf_multiply_rounded(vf_all(rotation[0]), unit[0]) + vf_multiply_rounded(vf_all(rotation[1]), unit[1]);
      vf_store_first(dir + axis * stride + r, sum + vf_multiply_rounded(vf_all(rotation[2]), unit[2]), n - r);
    }
  }
}

/* ---- the sequence t_{k+1} = t_k + dt(t_k) --------------------------------------------------------------------------
 */

static const double two_root_three = 3.46410161513775459; /* the diagonal of [-1, 1]^3 */

/* dt(t) = clamp(gamma t, shortest, longest) */
struct stepping {
  float gamma, shortest, longest;
  bool constant; /* dt(t) = shortest for every t that is a number */
};

static struct stepping stepping_of(const struct ern_march_settings *settings) {
  struct stepping stepping = {settings->dt_gamma, (float)(two_root_three / settings->max_steps),
                              (float)(two_root_three / ERN_OCCUPANCY_SIDE), false};
  if (stepping.shortest > stepping.longest) stepping.shortest = stepping.longest;
  stepping.constant = !(stepping.shortest < stepping.longest) || stepping.gamma == 0;
  return stepping;
}

LANES_INLINE vf step_at(const struct stepping *stepping, vf t, const bool constant) {
  if (constant) return vf_all(stepping->shortest);
  return vf_min(vf_max(vf_multiply_rounded(t, vf_all(stepping->gamma)), vf_all(stepping->shortest)),
                vf_all(stepping->longest));
}

/* ---- march ------------------------------------------------------------------------------------------------------- */

struct walk {
  const uint8_t *bits; /* of the cells */
  const struct ern_march_settings *settings;
  struct stepping stepping;
  vf origin[AXES], d[AXES], inverse[AXES]; /* inverse = 1/d */
  vf t, far;
  uint32_t live; /* lanes that are still marching */
};

/* The ray is inside the box for near <= t <= far. Lanes that miss the box, or lie in the plane of a face, are not live.
 */
LANES_INLINE vf walk_enter(struct walk *walk, size_t count) {
  const float bound = walk->settings->bound, half[AXES] = {bound, bound / 2, bound};
  vf near = vf_all(-__builtin_inff()), far = vf_all(__builtin_inff());
  vi met = (vi){0} == (vi){0};
#pragma GCC unroll 3
  for (int axis = 0; axis < AXES; axis++) {
    const vf t0 = (-half[axis] - walk->origin[axis]) * walk->inverse[axis];
    const vf t1 = (half[axis] - walk->origin[axis]) * walk->inverse[axis];
    met &= (t0 == t0) & (t1 == t1);
    near = vf_max(vf_min(t0, t1), near);
    far = vf_min(vf_max(t1, t0), far);
  }
  met &= near <= far;
  near = vf_max(vf_all(walk->settings->near), near);
  walk->far = vf_min(near + 4 * bound, far);
  walk->live = vi_bits(met) & bits_below(count);
  return near;
}

/* Looks up the occupancy: negative in the lanes whose cell at t is occupied. Where `borders` is set, cell and p are
 * outputs for the distance to the cell's border. The cell is clamp(int(64 (p/bound + 1)), 0, 127), also for an
 * unclamped p: outside the cube it is the last cell. */
LANES_INLINE vi walk_lookup(const struct walk *walk, vf t, vi cell[AXES], vf p[AXES], const bool borders) {
  const float bound = walk->settings->bound, half_side = ERN_OCCUPANCY_SIDE / 2;
  const vf inverse_bound = vf_all(1 / bound);
  vu number = {0};
#pragma GCC unroll 3
  for (int axis = 0; axis < AXES; axis++) {
    p[axis] = walk->origin[axis] + vf_multiply_rounded(t, walk->d[axis]);
    if (borders) p[axis] = vf_min(vf_max(p[axis], vf_all(-bound)), vf_all(bound));
    /* 64 q is exact, so contraction to a multiply-add changes nothing */
    const vf place = vf_multiply_rounded(p[axis], inverse_bound) * half_side + half_side;
    cell[axis] = __builtin_convertvector(vf_min(vf_max(place, vf_all(0)), vf_all(ERN_OCCUPANCY_SIDE - 1)), vi);
    vu v = (vu)cell[axis]; /* spreads 7 bits as in morton.h */
    v = (v | v << 8) & 0x0000F00Fu;
    v = (v | v << 4) & 0x000C30C3u;
    v = (v | v << 2) & 0x00249249u;
    number |= v << axis;
  }
  const vu word = vu_gather_words(walk->bits, number >> 5);
  return (vi)(word << (~number & 31u)); /* the sign is the cell's bit */
}

/* Distance from p to where the ray leaves the cell. */
LANES_INLINE vf walk_leave(const struct walk *walk, const vi cell[AXES], const vf p[AXES]) {
  vf least = vf_all(__builtin_inff());
#pragma GCC unroll 3
  for (int axis = 0; axis < AXES; axis++) {
    const vi forward = ((vi)walk->d[axis] >= 0) & 1; /* by the sign bit, also of zeros */
    const vf side = __builtin_convertvector(cell[axis] + forward, vf) / ERN_OCCUPANCY_SIDE * 2.0f - 1.0f;
    const vf way = vf_multiply_rounded(side, vf_all(walk->settings->bound)) - p[axis];
    least = vf_min(vf_multiply_rounded(way, walk->inverse[axis]), least);
  }
  return vf_max(least, vf_all(0));
}

/* The samples of the lanes, in rows with room for one more than a ray can have: every lane writes each distance, but
 * only lanes in an occupied cell advance their index. */
struct found {
  vu next; /* where in `t` the lane writes */
  size_t stride;
  float t[LANES * (ERN_MAX_STEPS + 1)];
};

#define LANE_NUMBER(l, d) l
LANES_INLINE vu found_begin(const struct found *found) {
  return (vu){LANES_EACH(LANE_NUMBER, 0)} * (uint32_t)found->stride;
}
#undef LANE_NUMBER

/* Adds a distance; returns the bits of the lanes with room left. */
LANES_INLINE uint32_t found_add(struct found *found, vf t, uint32_t hit) {
  float distance[LANES];
  uint32_t next[LANES];
  vf_store(distance, t);
  memcpy(next, &found->next, sizeof next);
#pragma GCC unroll 16
  for (int l = 0; l < LANES; l++) found->t[next[l]] = distance[l];
  found->next -= (vu)vi_of_bits(hit);
  const vu last = found_begin(found) + (uint32_t)(found->stride - 1);
  return ~vi_bits((vi)found->next == (vi)last);
}

static void found_copy(float *t, int32_t *count, const struct found *found, size_t lanes, size_t row) {
  const vu number = found->next - found_begin(found);
  for (size_t l = 0; l < lanes; l++) {
    const size_t n = number[l];
    for (size_t i = 0; i < n; i += LANES) {
      vf_store_first(t + l * row + i, vf_load_first(found->t + l * found->stride + i, n - i), n - i);
    }
  }
  memcpy(count, &number, lanes * sizeof *count);
}

/* Tests every distance of the sequence: for lanes in which no step is shorter than the longest path through a cell. */
LANES_INLINE void walk_all(struct found *found, const struct walk *from, const bool constant) {
  const struct walk walk = *from;
  vf t = walk.t, p[AXES];
  vi cell[AXES];
  for (uint32_t live = walk.live; live != 0;) {
    const uint32_t hit = vi_bits(walk_lookup(&walk, t, cell, p, false)) & live;
    if (hit != 0) live &= found_add(found, t, hit);
    t += step_at(&walk.stepping, t, constant);
    live &= vf_less_bits(t, walk.far);
  }
}

/* Steps past the border of an empty cell, as the reference does; lanes synchronise before each look-up. */
LANES_INLINE void walk_cells(struct found *found, const struct walk *from) {
  const struct walk walk = *from;
  vf t = walk.t, p[AXES];
  vi cell[AXES];
  for (uint32_t live = walk.live; live != 0;) {
    const uint32_t hit = vi_bits(walk_lookup(&walk, t, cell, p, true)) & live;
    const vf border = t + walk_leave(&walk, cell, p);
    if (hit != 0) live &= found_add(found, t, hit);
    t += step_at(&walk.stepping, t, false);
    for (uint32_t inside = live & ~hit;;) {
      inside &= vf_less_bits(t, border) & vf_less_bits(t, walk.far);
      if (inside == 0) break;
      t = vf_select(vi_of_bits(inside), t + step_at(&walk.stepping, t, false), t);
    }
    live &= vf_less_bits(t, walk.far);
  }
}

/* Advances along the sequence without look-ups while t < not_before. */
LANES_INLINE void walk_skip(struct walk *walk, vf not_before, const bool constant) {
  const vf far = walk->far, end = vf_min(far, not_before); /* NaN: no bound known */
  vf t = walk->t;
  for (uint32_t below = walk->live;;) {
    below &= vf_less_bits(t, end);
    if (below == 0) break;
    t = vf_select(vi_of_bits(below), t + step_at(&walk->stepping, t, constant), t);
  }
  walk->t = t;
  walk->live &= vf_less_bits(t, far);
}

/* Bits of the lanes whose steps may be shorter than the path through a cell. |side - p| of the reference's cell_leave
 * is below the cell's width (2/128 bound), except for rounding errors of less than 2^-15 of it: the test allows 2^-10.
 */
LANES_INLINE uint32_t walk_short(const struct walk *walk) {
  vf least = vf_all(__builtin_inff());
  for (int axis = 0; axis < AXES; axis++) least = vf_min((vf)((vi)walk->inverse[axis] & INT32_MAX), least);
  const float width = 2 * walk->settings->bound / ERN_OCCUPANCY_SIDE * (1 + 1.0f / 1024);
  return ~vf_less_bits(least * width, vf_all(walk->stepping.shortest)) & walk->live;
}

/* Bits of the lanes where t + dt > t may fail before the far end: at t < 2^22 dt a step is two units of t's last place.
 */
LANES_INLINE uint32_t walk_cannot_advance(const struct walk *walk) {
  const vf limit = vf_all(walk->stepping.shortest * 4194304.0f);
  const vf t = (vf)((vi)walk->t & INT32_MAX), far = (vf)((vi)walk->far & INT32_MAX);
  return ~(vf_less_bits(t, limit) & vf_less_bits(far, limit)) & walk->live;
}

/* Whether the settings are in the range that these kernels assume; otherwise the reference marches. */
static bool is_usual(const struct ern_march_settings *settings) {
  return settings->bound >= 0x1p-20f && settings->bound <= 0x1p20f && settings->max_steps >= 1 &&
         settings->max_steps <= ERN_MAX_STEPS;
}

void ERN_ISA(ern_march_from)(float *t, int32_t *count, const float *dir, size_t stride, const float *jitter,
                             const float *not_before, const uint8_t *bits, const float origin[3],
                             const struct ern_march_settings *settings, size_t n) {
  if (!is_usual(settings)) {
    ern_march_from_ref(t, count, dir, stride, jitter, not_before, bits, origin, settings, n);
    return;
  }
  struct walk walk = {.bits = bits, .settings = settings, .stepping = stepping_of(settings)};
  const size_t row = (size_t)settings->max_steps;
  struct found found;
  found.stride = row + 1;
  for (size_t r = 0; r < n; r += LANES) {
    const size_t lanes = n - r < LANES ? n - r : LANES;
    for (size_t axis = 0; axis < AXES; axis++) {
      walk.origin[axis] = vf_all(origin[axis]);
      walk.d[axis] = vf_load_first(dir + axis * stride + r, lanes);
      walk.inverse[axis] = 1 / walk.d[axis];
    }
    const vf near = walk_enter(&walk, lanes), start = jitter ? vf_load_first(jitter + r, lanes) : (vf){0};
    walk.t = near + vf_multiply_rounded(step_at(&walk.stepping, near, false), start);
    walk.live &= vf_less_bits(walk.t, walk.far);
    const uint32_t stuck = walk_cannot_advance(&walk);
    walk.live &= ~stuck;
    if (not_before != NULL) {
      const vf known = vf_load_first(not_before + r, lanes);
      walk.stepping.constant ? walk_skip(&walk, known, true) : walk_skip(&walk, known, false);
    }
    found.next = found_begin(&found);
    if (walk_short(&walk) != 0) {
      walk_cells(&found, &walk);
    } else if (walk.stepping.constant) {
      walk_all(&found, &walk, true);
    } else {
      walk_all(&found, &walk, false);
    }
    found_copy(t + r * row, count + r, &found, lanes, row);
    for (uint32_t left = stuck; left != 0; left &= left - 1) {
      const size_t ray = r + (size_t)__builtin_ctz(left);
      ern_march_from_ref(t + ray * row, count + ray, dir + ray, stride, jitter ? jitter + ray : NULL,
                         not_before ? not_before + ray : NULL, bits, origin, settings, 1);
    }
  }
}

void ERN_ISA(ern_march)(float *t, int32_t *count, const float *dir, size_t stride, const float *jitter,
                        const uint8_t *bits, const float origin[3], const struct ern_march_settings *settings,
                        size_t n) {
  ERN_ISA(ern_march_from)(t, count, dir, stride, jitter, NULL, bits, origin, settings, n);
}

/* ---- samples ----------------------------------------------------------------------------------------------------- */

/* x = clamp(o + t d), dt = dt(t), depth = t + dt, for the samples of ray r packed from first[r] on. */
void ERN_ISA(ern_samples)(float *x, size_t x_stride, float *dt, float *depth, int32_t *ray, const float *t,
                          const int32_t *first, const float *dir, size_t dir_stride, const float origin[3],
                          const struct ern_march_settings *settings, size_t ray_begin, size_t n) {
  if (!is_usual(settings)) {
    ern_samples_ref(x, x_stride, dt, depth, ray, t, first, dir, dir_stride, origin, settings, ray_begin, n);
    return;
  }
  const struct stepping stepping = stepping_of(settings);
  const vf low = vf_all(-settings->bound), high = vf_all(settings->bound);
  for (size_t r = 0; r < n; r++) {
    const size_t begin = (size_t)first[r], end = (size_t)first[r + 1];
    const float *t_ray = &t[r * (size_t)settings->max_steps];
    for (size_t i = begin; i < end; i += LANES) {
      const size_t left = end - i;
      const vf distance = vf_load_first(t_ray + (i - begin), left), step = step_at(&stepping, distance, false);
#pragma GCC unroll 3
      for (size_t axis = 0; axis < AXES; axis++) {
        const vf p = origin[axis] + vf_multiply_rounded(distance, vf_all(dir[axis * dir_stride + r]));
        vf_store_first(x + axis * x_stride + i, vf_min(vf_max(p, low), high), left);
      }
      vf_store_first(dt + i, step, left);
      vf_store_first(depth + i, distance + step, left);
      vf_store_first((float *)(ray + i), (vf)vu_all((uint32_t)(ray_begin + r)), left);
    }
  }
}
