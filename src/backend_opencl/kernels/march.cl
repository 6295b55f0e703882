/* SPDX-License-Identifier: MIT
 * Computes the rays of a camera, marches them through the occupancy grid and packs their samples; the reference is
 * march_ref.c. Products are not fused with sums, and every operation has the reference's order, so that all backends
 * sample the same points to the last bit. */
#pragma OPENCL FP_CONTRACT OFF

enum { SIDE = 128 }; /* cells per axis */

/* ---- rays -------------------------------------------------------------------------------------------------------- */

struct view { /* struct ern_view */
  float pose[16], focal, cx, cy;
  int width, height;
};

/* camera: c = ((i + 1/2 - cx)/f, (j + 1/2 - cy)/f, 1), then dir = R c/|c| */
kernel void rays(ROWS(float, dir), SPAN(const int, pixel), struct view view, ulong n) {
  OPEN(float, dir);
  OPEN(const int, pixel);
  const ulong r = get_global_id(0);
  if (r >= n) return;
  const int row = pixel[r] / view.width, column = pixel[r] - row * view.width;
  const float x = ((float)column + 0.5f - view.cx) / view.focal, y = ((float)row + 0.5f - view.cy) / view.focal;
  const float length = sqrt(x * x + y * y + 1.0f);
  const float unit_x = x / length, unit_y = y / length, unit_z = 1.0f / length;
  for (int axis = 0; axis < 3; axis++) {
    dir[axis * dir_stride + r] =
        view.pose[4 * axis] * unit_x + view.pose[4 * axis + 1] * unit_y + view.pose[4 * axis + 2] * unit_z;
  }
}

/* ---- a vector of rays: WIDTH of them -------------------------------------------------------------------------------
 *
 * Truth is -1 in an int, for one ray as for a vector, so that select and & mean the same. */

#if WIDTH == 1
typedef float reals;
typedef int ints;
#define TRUTH(condition) (-(condition))
#define LOAD(from) (*(from))
#define STORE(value, to) (*(to) = (value))
#define LANE(value, l) (value)
#define LANES(EACH) EACH(0)
#else
#define JOINED(a, b) a##b
#define JOIN(a, b) JOINED(a, b)
typedef JOIN(float, WIDTH) reals;
typedef JOIN(int, WIDTH) ints;
#define TRUTH(condition) (condition)
#define LOAD(from) JOIN(vload, WIDTH)(0, from)
#define STORE(value, to) JOIN(vstore, WIDTH)(value, 0, to)
#define LANE(value, l) (value).s##l
#if WIDTH == 4
#define LANES(EACH) EACH(0), EACH(1), EACH(2), EACH(3)
#elif WIDTH == 8
#define LANES(EACH) EACH(0), EACH(1), EACH(2), EACH(3), EACH(4), EACH(5), EACH(6), EACH(7)
#else
#define LANES(EACH) \
  EACH(0), EACH(1), EACH(2), EACH(3), EACH(4), EACH(5), EACH(6), EACH(7), \
  EACH(8), EACH(9), EACH(a), EACH(b), EACH(c), EACH(d), EACH(e), EACH(f)
#endif
#endif

#define INLINE __attribute__((always_inline))

/* Whether any lane is true. Combining halves takes fewer instructions than what compilers make of any(). */
INLINE bool one_of(ints truth) {
#if WIDTH == 1
  return truth != 0;
#else
#if WIDTH == 16
  const int8 eight = truth.lo | truth.hi;
  const int4 four = eight.lo | eight.hi;
#elif WIDTH == 8
  const int4 four = truth.lo | truth.hi;
#else
  const int4 four = truth;
#endif
  return as_long(four.lo | four.hi) != 0;
#endif
}

/* The first `count` of WIDTH values, 0 in the other lanes. */
reals load_first(global const float *from, ulong count) {
  float values[WIDTH];
  if (count >= WIDTH) return LOAD(from);
  for (ulong l = 0; l < WIDTH; l++) values[l] = l < count ? from[l] : 0.0f;
  return LOAD(values);
}

ints lanes_below(ulong count) {
  int truth[WIDTH];
  for (ulong l = 0; l < WIDTH; l++) truth[l] = l < count ? -1 : 0;
  return LOAD(truth);
}

/* value > low ? (value < high ? value : high) : low, so that NaN becomes `low` */
INLINE reals limit(reals value, float low, float high) {
  return select((reals)low, select((reals)high, value, TRUTH(value < high)), TRUTH(value > low));
}

/* ---- march ------------------------------------------------------------------------------------------------------- */

struct walk { /* struct walk in march.c */
  float origin[3];
  float bound, inverse_bound; /* of the box; 1/bound */
  float near;                 /* smallest distance of a sample */
  float gamma, shortest, longest; /* dt(t) = clamp(gamma t, shortest, longest) */
  float cell; /* a little more than the width of a cell; infinite where the box has an unusual size */
  int max_steps;
};

INLINE reals step_at(const struct walk *walk, reals t) { return limit(t * walk->gamma, walk->shortest, walk->longest); }

/* The part of each ray inside the box: near <= t <= far. False where a ray misses the box or lies in the plane of a
 * face (0 * infinity). */
INLINE ints box_enter(reals *near, reals *far, const struct walk *walk, const reals inverse[3]) {
  ints met = (ints)(-1);
  *near = (reals)(-INFINITY);
  *far = (reals)INFINITY;
  for (int axis = 0; axis < 3; axis++) {
    const float half_side = axis == 1 ? walk->bound / 2 : walk->bound;
    const reals t0 = (-half_side - walk->origin[axis]) * inverse[axis];
    const reals t1 = (half_side - walk->origin[axis]) * inverse[axis];
    met &= TRUTH(t0 == t0) & TRUTH(t1 == t1);
    const reals enter = select(t1, t0, TRUTH(t0 < t1)), leave = select(t0, t1, TRUTH(t0 < t1));
    *near = select(*near, enter, TRUTH(enter > *near));
    *far = select(*far, leave, TRUTH(leave < *far));
  }
  return met & TRUTH(*near <= *far);
}

/* Numbers of cells, 0 to 127 as floats: clamp(int(64 (p/bound + 1)), 0, 127). Adding 2^23 rounds to a whole number. */
INLINE reals cell_of(reals p, float inverse_bound) {
  const reals place = limit(0.5f * (p * inverse_bound + 1.0f) * SIDE, 0.0f, SIDE - 1);
  const reals whole = (place + 0x1p23f) - 0x1p23f;
  return select(whole, whole - 1.0f, TRUTH(whole > place));
}

/* Spreads the 7 bits of a cell number so that two zeros lie between neighbours (morton.h). In 2^23 + cell they are the
 * lowest bits of the mantissa. */
INLINE ints spread(reals cell) {
#if WIDTH == 1
  ints v = as_int(cell + 0x1p23f) & (SIDE - 1);
#else
  ints v = JOIN(as_int, WIDTH)(cell + 0x1p23f) & (SIDE - 1);
#endif
  v = (v | v << 8) & 0x00F00F;
  v = (v | v << 4) & 0x0C30C3;
  return (v | v << 2) & 0x249249;
}

/* Returns -1 where the cell at t is occupied. Also gives the point p and its cell, for cell_leave. */
INLINE ints look(reals p[3], reals cell[3], const struct walk *walk, const reals d[3], reals t,
                 global const uchar *bits) {
  ints number = (ints)0;
#pragma unroll
  for (int axis = 0; axis < 3; axis++) {
    p[axis] = limit(walk->origin[axis] + t * d[axis], -walk->bound, walk->bound);
    cell[axis] = cell_of(p[axis], walk->inverse_bound);
    number |= spread(cell[axis]) << axis;
  }
  const ints byte = number >> 3;
#define BYTE(l) bits[LANE(byte, l)]
  const ints around = (ints)(LANES(BYTE));
#undef BYTE
  return -(around >> (number & 7) & 1);
}

/* Distance from p to where the ray leaves the cell. An axis along which the ray does not move gives infinity or,
 * exactly on a border, NaN; neither is taken as the smallest. */
INLINE reals cell_leave(const struct walk *walk, const reals d[3], const reals inverse[3], const reals p[3],
                        const reals cell[3]) {
  reals least = (reals)INFINITY;
#pragma unroll
  for (int axis = 0; axis < 3; axis++) {
    const reals ahead = select((reals)1.0f, (reals)0.0f, TRUTH(signbit(d[axis])));
    const reals side = (cell[axis] + ahead) / SIDE * 2.0f - 1.0f;
    const reals distance = (side * walk->bound - p[axis]) * inverse[axis];
    least = select(least, distance, TRUTH(distance < least));
  }
  return select((reals)0.0f, least, TRUTH(least > 0.0f));
}

/* -1 where a step may be shorter than the distance through a cell. The reference's |side - p| is below the cell's width
 * except for rounding errors, for which `cell` has a margin; elsewhere the next distance is past the border anyway. */
INLINE ints are_short(const struct walk *walk, const reals inverse[3]) {
  const reals least = fmin(fmin(fabs(inverse[0]), fabs(inverse[1])), fabs(inverse[2]));
  return ~TRUTH(least * walk->cell < walk->shortest);
}

/* t[row + l*max_steps + count] = now in the lanes that hit */
INLINE void keep(global float *t, const struct walk *walk, reals now, ints count, ints hit) {
  float distance[WIDTH];
  int number[WIDTH], yes[WIDTH];
  STORE(now, distance);
  STORE(count, number);
  STORE(hit, yes);
#pragma unroll
  for (int l = 0; l < WIDTH; l++) {
    if (yes[l]) t[l * walk->max_steps + number[l]] = distance[l];
  }
}

/* Marches those of WIDTH rays that are in `live`; returns their numbers of samples. t: the rays' rows. Steps through an
 * empty cell continue until past its border, so that a ray's samples stay on its own sequence t_{k+1} = t_k +
 * dt(t_k). */
INLINE ints march_rays(global float *t, const struct walk *walk, const reals d[3], reals jitter, ints live,
                       global const uchar *bits) {
  const reals inverse[3] = {1.0f / d[0], 1.0f / d[1], 1.0f / d[2]};
  const float longest_way = 4 * walk->bound; /* through the box; it binds only where d is not a unit vector */
  reals near, far, p[3], cell[3];
  ints count = (ints)0;
  live &= box_enter(&near, &far, walk, inverse);
  near = select(near, (reals)walk->near, TRUTH(near < walk->near));
  far = select(far, near + longest_way, TRUTH(far > near + longest_way));
  const bool short_steps = one_of(are_short(walk, inverse) & live);
  reals now = near + step_at(walk, near) * jitter;
  live &= TRUTH(now < far);
  while (one_of(live)) {
    const ints hit = look(p, cell, walk, d, now, bits) & live;
    reals next = now + step_at(walk, now);
    if (one_of(hit)) {
      keep(t, walk, now, count, hit);
      count -= hit;
      live &= TRUTH(count < walk->max_steps);
    }
    if (short_steps) {
      const reals border = now + cell_leave(walk, d, inverse, p, cell);
      reals last = now;
      for (ints inside = live & ~hit;;) {
        inside &= TRUTH(last < next) & TRUTH(next < border) & TRUTH(next < far);
        if (!one_of(inside)) break;
        last = select(last, next, inside);
        next = select(next, next + step_at(walk, last), inside);
      }
    }
    live &= TRUTH(next > now) & TRUTH(next < far); /* the march ends where t + dt = t */
    now = next;
  }
  return count;
}

/* t [n][max_steps] and count [n]; jitter null: none. A work-item takes WIDTH rays. */
kernel void march(SPAN(float, t), SPAN(int, count), ROWS(const float, dir), SPAN(const float, jitter),
                  SPAN(const uchar, bits), const struct walk walk, ulong n) {
  OPEN(float, t);
  OPEN(int, count);
  OPEN(const float, dir);
  OPEN(const float, jitter);
  OPEN(const uchar, bits);
  const ulong r = get_global_id(0) * WIDTH;
  if (r >= n) return;
  const ulong left = n - r;
  const reals d[3] = {load_first(dir + r, left), load_first(dir + dir_stride + r, left),
                      load_first(dir + 2 * dir_stride + r, left)};
  const reals start = jitter ? load_first(jitter + r, left) : (reals)0.0f;
  const ints found = march_rays(t + r * walk.max_steps, &walk, d, start, lanes_below(left), bits);
  int number[WIDTH];
  STORE(found, number);
  for (ulong l = 0; l < WIDTH && l < left; l++) count[r + l] = number[l];
}

/* ---- samples ----------------------------------------------------------------------------------------------------- */

/* The same as limit, for one number. */
float limit_one(float value, float low, float high) { return value > low ? (value < high ? value : high) : low; }

#define TEAM (CPU ? 1 : 16) /* work-items that share a ray's samples: neighbouring items write neighbouring elements */

/* x = clamp(o + t d), dt = dt(t), depth = t + dt, for the samples of ray r packed from first[r] on. */
kernel void samples(ROWS(float, x), SPAN(float, dt), SPAN(float, depth), SPAN(int, ray), SPAN(const float, t),
                    SPAN(const int, first), ROWS(const float, dir), const struct walk walk, ulong n) {
  OPEN(float, x);
  OPEN(float, dt);
  OPEN(float, depth);
  OPEN(int, ray);
  OPEN(const float, t);
  OPEN(const int, first);
  OPEN(const float, dir);
  const ulong r = get_global_id(0) / TEAM;
  if (r >= n) return;
  const float dx = dir[r], dy = dir[dir_stride + r], dz = dir[2 * dir_stride + r];
  const ulong begin = first[r], count = first[r + 1] - begin;
  for (ulong i = get_global_id(0) % TEAM; i < count; i += TEAM) {
    const float distance = t[r * walk.max_steps + i];
    const float step = limit_one(distance * walk.gamma, walk.shortest, walk.longest);
    x[begin + i] = limit_one(walk.origin[0] + distance * dx, -walk.bound, walk.bound);
    x[x_stride + begin + i] = limit_one(walk.origin[1] + distance * dy, -walk.bound, walk.bound);
    x[2 * x_stride + begin + i] = limit_one(walk.origin[2] + distance * dz, -walk.bound, walk.bound);
    dt[begin + i] = step;
    depth[begin + i] = distance + step;
    ray[begin + i] = (int)r;
  }
}

/* y of sample i is x of its ray. */
kernel void spread_rays(ROWS(float, y), ROWS(const float, x), SPAN(const int, ray), int rows, ulong n) {
  OPEN(float, y);
  OPEN(const float, x);
  OPEN(const int, ray);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  for (int r = 0; r < rows; r++) y[r * y_stride + i] = x[r * x_stride + ray[i]];
}
