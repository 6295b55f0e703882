/* SPDX-License-Identifier: MIT
 * The fused kernel of rendering: march, field and compositing of a frame's rays in one kernel, from pixel numbers to
 * pixels.
 *
 * Each lane of an item (tile.cl) processes one ray at a time, and the next samples of all lanes are evaluated at once.
 * When the transmittance of a ray is below the stop, or it has no sample left, it is written out and its lane takes the
 * next ray from a shared counter. So lanes are full until the frame ends, and no sample past the stop is ever computed.
 * Rays are independent: the values of a ray do not depend on the lane that takes it.
 *
 * On a CPU a lane that takes a ray marches it to its first sample. On a GPU neighbouring lanes would wait for the one
 * with the longest march, so a kernel of its own, find_rays, lists the rays that have a sample before.
 *
 * Built for one model's shape: LEVELS; FEATURES = 3 LEVELS, ATTENTION, VALUES, EYE (0 or 1), EYE_HIDDEN, DENSITY,
 * COLOUR: widths; AT_x: where in `net` matrix x begins; ROW_x: where in a tile x begins, TILE_ROWS its rows; A0 B0 A1
 * B1 A2 B2: the axes of the planes. And for one device: GROUP, VECTORS, OUTPUTS, TENSOR. */
#define CHUNK (WIDTH == 1 ? 1 : 64) /* rays that are taken from the counter at once, on a CPU */
#define SIDE 8    /* pixels per edge of the blocks for which nearest[] has values */
#define CELLS 128 /* cells of the occupancy grid per axis */

/* Parameters of a frame; the same struct as in render_head.c. */
struct frame {
  float pose[12], focal, cx, cy, bound, inverse_bound, dt_gamma, near, shortest, longest, stop, eye_value;
  float fade[2]; /* of attention_fade; equal: none */
  int width, height, max_steps, picture; /* picture: rays are all pixels, dealt block by block */
  uint across, rays, tickets;            /* blocks per row; rays; numbers that the counter deals */
};

/* Where the results of rays are written. */
struct output {
  global float *pixel, *colour, *opacity, *depth, *attention, *eye;
  global const float *background;
  ulong pixel_stride, colour_stride, background_stride;
};

/* ---- marching: the reference's points bit for bit (march_ref.c) ---- */

/* dt(t) = clamp(gamma t, shortest, longest) */
INLINE floatw step_at(const struct frame *f, floatw t) {
#pragma OPENCL FP_CONTRACT OFF
  return clamped(t * f->dt_gamma, f->shortest, f->longest);
}

/* d = R c/|c|, c = ((i + 1/2 - cx)/f, (j + 1/2 - cy)/f, 1) */
INLINE void look(floatw d[3], const struct frame *f, uintw column, uintw row) {
#pragma OPENCL FP_CONTRACT OFF
  const floatw x = (REAL(column) + 0.5f - f->cx) / f->focal, y = (REAL(row) + 0.5f - f->cy) / f->focal;
  const floatw length = sqrt(x * x + y * y + 1.0f);
  const floatw unit[3] = {x / length, y / length, 1.0f / length};
  EACH_AXIS d[axis] = f->pose[4 * axis] * unit[0] + f->pose[4 * axis + 1] * unit[1] + f->pose[4 * axis + 2] * unit[2];
}

/* The part of each ray inside the box, near <= t <= far. Returns the lanes whose rays meet the box. */
INLINE intw enter(floatw *near, floatw *far, const struct frame *f, const floatw inverse[3]) {
#pragma OPENCL FP_CONTRACT OFF
  intw valid = NOT((intw)(0));
  floatw first = -INFINITY, last = INFINITY;
  EACH_AXIS {
    const float half_side = axis == 1 ? f->bound / 2 : f->bound, origin = f->pose[4 * axis + 3];
    const floatw t0 = (-half_side - origin) * inverse[axis], t1 = (half_side - origin) * inverse[axis];
    const floatw from = select(t1, t0, t0 < t1), to = select(t0, t1, t0 < t1);
    valid &= (t0 == t0) & (t1 == t1);
    first = select(first, from, from > first);
    last = select(last, to, to < last);
  }
  valid &= first <= last;
  first = select(first, (floatw)(f->near), first < f->near);
  const floatw most = first + 4 * f->bound;
  *near = first;
  *far = select(last, most, last > most);
  return valid;
}

/* Moves bits 0 to 6 of x to every third place. */
INLINE uintw spread(uintw x) {
  x = (x | x << 8) & 0x0F00F00Fu;
  x = (x | x << 4) & 0xC30C30C3u;
  return (x | x << 2) & 0x49249249u;
}

/* Advances along the sequence t_{k+1} = t_k + dt(t_k), from t on, to the first distance in an occupied cell. Returns
 * the lanes of `going` that have one before `far`. */
INLINE intw find(floatw *t_of, intw going, floatw far, const floatw d[3], const floatw inverse[3],
                 const struct frame *f, global const uchar *bits) {
#pragma OPENCL FP_CONTRACT OFF
  floatw t = *t_of;
  intw found = going & 0;
  while (ANY(going)) {
    floatw p[3];
    uintw cell[3];
    EACH_AXIS {
      p[axis] = clamped(f->pose[4 * axis + 3] + t * d[axis], -f->bound, f->bound);
      cell[axis] = WHOLE(clamped(0.5f * (p[axis] * f->inverse_bound + 1.0f) * CELLS, 0.0f, CELLS - 1));
    }
    const uintw number = spread(cell[0]) | spread(cell[1]) << 1 | spread(cell[2]) << 2, byte_at = number >> 3;
    const uintw eight = GATHER(uintw, bits, byte_at);
    const intw occupied = going & ((eight >> (number & 7) & 1) != 0);
    found |= occupied;
    going &= NOT(occupied);
    if (!ANY(going)) break;
    /* steps along the sequence until past the cell's border */
    floatw least = INFINITY;
    EACH_AXIS {
      const floatw ahead = select((floatw)(1), (floatw)(0), signbit(d[axis]));
      const floatw side = (REAL(cell[axis]) + ahead) / CELLS * 2.0f - 1.0f;
      const floatw distance = (side * f->bound - p[axis]) * inverse[axis];
      least = select(least, distance, distance < least);
    }
    const floatw border = t + select((floatw)(0), least, least > 0);
    floatw last = t, next = t + step_at(f, t);
    intw inside = going & (last < next) & (next < border) & (next < far);
    while (ANY(inside)) {
      const floatw after = next + step_at(f, next);
      last = select(last, next, inside);
      next = select(next, after, inside);
      inside &= (last < next) & (next < border) & (next < far);
    }
    going &= next > t;
    t = select(t, next, going);
    going &= t < far;
  }
  *t_of = t;
  return found;
}

/* ---- rays are taken and written out ---- */

struct flight { /* ray < 0: the lane is empty */
  floatw t[VECTORS], far[VECTORS], d[3][VECTORS], inverse[3][VECTORS];
  floatw transmittance[VECTORS], colour[3][VECTORS], opacity[VECTORS], depth[VECTORS], attention[VECTORS], eye[VECTORS];
  intw ray[VECTORS], count[VECTORS], found[VECTORS];
};

INLINE void put(const struct output *to, uint ray, const float colour[3], float opacity, float depth,
                float attention, float eye) {
  for (int c = 0; c < 3; c++) {
    const float value = colour[c] + (1 - opacity) * to->background[c * to->background_stride + ray];
    to->pixel[c * to->pixel_stride + ray] = value < 0 ? 0 : value > 1 ? 1 : value;
    if (to->colour) to->colour[c * to->colour_stride + ray] = colour[c];
  }
  if (to->opacity) to->opacity[ray] = opacity;
  if (to->depth) to->depth[ray] = depth;
  if (to->attention) to->attention[ray] = attention;
  if (EYE && to->eye) to->eye[ray] = eye;
}

struct start { /* of WIDTH rays, at their first samples */
  uintw ray;
  intw wanted, found; /* a ray of the frame; it has a sample */
  floatw t, far, d[3];
};

/* Direction and distances of the box of rays. Returns those that meet it. */
INLINE intw aim(struct start *s, const struct frame *f, uintw column, uintw row) {
  floatw inverse[3];
  look(s->d, f, column, row);
  EACH_AXIS inverse[axis] = 1 / s->d[axis];
  return enter(&s->t, &s->far, f, inverse);
}

/* Marches WIDTH rays, from number k on, to their first samples. */
INLINE void start_rays(struct start *s, uint k, const struct frame *f, global const int *pixel_number,
                       global const float *nearest, global const uchar *bits) {
  s->ray = k + lane_numbers();
  s->wanted = s->ray < f->rays;
  if (f->picture) {
    const uint block = k / (SIDE * SIDE), top = block / f->across * SIDE, left = block % f->across * SIDE;
    const uintw within = (k % (SIDE * SIDE)) + lane_numbers(), row = top + within / SIDE, column = left + within % SIDE;
    s->wanted = (row < (uint)f->height) & (column < (uint)f->width);
    s->ray = row * (uint)f->width + column;
  }
  s->ray = select((uintw)(0), s->ray, s->wanted);
  const uintw pixel = GATHER(uintw, pixel_number, s->ray);
  const uintw row = pixel / (uint)f->width, column = pixel - row * (uint)f->width;
  floatw not_before = -INFINITY;
  if (nearest) {
    const intw known = row < (uint)f->height;
    const uintw block = select((uintw)(0), row / SIDE * f->across + column / SIDE, known);
    not_before = select((floatw)(-INFINITY), GATHER(floatw, nearest, block), known);
  }
  intw going = s->wanted & (not_before < INFINITY);
  s->found = going;
  if (!ANY(going)) return;
  going &= aim(s, f, column, row);
  intw climbing = going & (s->t < not_before) & (s->t < s->far);
  while (ANY(climbing)) {
    const floatw next = s->t + step_at(f, s->t);
    climbing &= next > s->t;
    s->t = select(s->t, next, climbing);
    climbing &= (s->t < not_before) & (s->t < s->far);
  }
  floatw inverse[3];
  EACH_AXIS inverse[axis] = 1 / s->d[axis];
  s->found = find(&s->t, going & (s->t < s->far), s->far, s->d, inverse, f, bits);
}

INLINE void put_nothing(const struct output *to, uint ray) {
  const float black[3] = {0, 0, 0};
  put(to, ray, black, 0, 0, 0, 0);
}

/* Starts a ray in a lane. */
INLINE void begin(struct flight *flight, int lane, int ray, float t, float far, const float d[3]) {
  LANE(flight->t, lane) = t, LANE(flight->far, lane) = far;
  EACH_AXIS {
    LANE(flight->d[axis], lane) = d[axis];
    LANE(flight->inverse[axis], lane) = 1 / d[axis];
    LANE(flight->colour[axis], lane) = 0;
  }
  LANE_INT(flight->ray, lane) = ray, LANE_INT(flight->count, lane) = 0;
  LANE(flight->transmittance, lane) = 1;
  LANE(flight->opacity, lane) = LANE(flight->depth, lane) = 0;
  LANE(flight->attention, lane) = LANE(flight->eye, lane) = 0;
}

/* Rays and where they are taken from. counter[0]: numbers dealt. On a GPU counter[1] rays are listed, with the
 * distances of their first samples. */
struct source {
  global int *counter, *ray;
  global float *t;
  global const int *pixel_number;
  global const float *nearest;
  global const uchar *bits;
};

#if CPU
struct queue { /* rays that have a sample, at distance t, and wait for a lane */
  float t[CHUNK], far[CHUNK], d[3][CHUNK];
  int ray[CHUNK];
  int taken, hits;
};

/* Marches WIDTH rays, from number k on, to their first samples; those without one are written out. */
INLINE void meet(struct queue *q, uint k, const struct frame *f, const struct output *to, const struct source *from) {
  struct start s;
  start_rays(&s, k, f, from->pixel_number, from->nearest, from->bits);
  for (int l = 0; l < WIDTH; l++) {
    if (LANE_INT(&s.found, l)) {
      const int h = q->hits++;
      q->ray[h] = LANE_INT(&s.ray, l), q->t[h] = LANE(&s.t, l), q->far[h] = LANE(&s.far, l);
      EACH_AXIS q->d[axis][h] = LANE(&s.d[axis], l);
    } else if (LANE_INT(&s.wanted, l)) {
      put_nothing(to, (uint)LANE_INT(&s.ray, l));
    }
  }
}

/* Gives a lane the next ray that has a sample. False where there is none. */
INLINE bool take(struct flight *flight, int lane, struct queue *q, const struct frame *f, const struct output *to,
                 const struct source *from) {
  while (q->taken == q->hits) {
    const uint k = (uint)atomic_add(from->counter, CHUNK);
    if (k >= f->tickets) return false;
    q->taken = q->hits = 0;
    for (int i = 0; i < CHUNK; i += WIDTH) meet(q, k + i, f, to, from);
  }
  const int h = q->taken++;
  const float d[3] = {q->d[0][h], q->d[1][h], q->d[2][h]};
  begin(flight, lane, q->ray[h], q->t[h], q->far[h], d);
  return true;
}
#else
struct queue {
  int taken, hits;
};

INLINE bool take(struct flight *flight, int lane, struct queue *q, const struct frame *f, const struct output *to,
                 const struct source *from) {
  const int k = atomic_inc(from->counter);
  if (k >= from->counter[1]) return false;
  struct start s;
  const int ray = from->ray[k];
  const uint pixel = (uint)from->pixel_number[ray], row = pixel / (uint)f->width;
  aim(&s, f, pixel - row * (uint)f->width, row);
  begin(flight, lane, ray, from->t[k], s.far, s.d);
  return true;
}
#endif

/* Marks a lane as empty. It computes with zeros from then on, and its results are not read. */
INLINE void leave_empty(struct flight *flight, int lane) {
  LANE_INT(flight->ray, lane) = -1;
  LANE(flight->t, lane) = LANE(flight->transmittance, lane) = 0;
  EACH_AXIS LANE(flight->d[axis], lane) = LANE(flight->inverse[axis], lane) = 0;
}

/* ---- the field of a tile ---- */

struct level { /* [resolution + 1][row] values from `at` on: (c0, c1) at c0 + c1*row, row = resolution + 1 */
  float scale; /* position = u*scale + 0.5 */
  uint row, at, unused;
};

/* Features of one plane, by bilinear interpolation in each level. a, b: the plane's coordinates on [0, 1]. The cells of
 * a level are computed first and stored in memory, from where scalar loads read them: extracting them from vector
 * registers would keep the shuffle unit busy. */
INLINE void encode_plane(local floatw *tile, const floatw a[VECTORS], const floatw b[VECTORS],
                         global const struct level *level, global const float *dense) {
#pragma OPENCL FP_CONTRACT OFF
  for (int l = 0; l < LEVELS; l++) {
    const float scale = level[l].scale;
    const uint row = level[l].row;
    global const float *value = dense + level[l].at;
    uintw cell[VECTORS];
    floatw s[VECTORS], t[VECTORS];
    EACH_VECTOR {
      const floatw p = full(a[v]) * scale + 0.5f, q = full(b[v]) * scale + 0.5f;
      const uintw c0 = WHOLE(p), c1 = WHOLE(q);
      s[v] = p - REAL(c0), t[v] = q - REAL(c1);
      cell[v] = c0 + c1 * row;
    }
    EACH_VECTOR {
      floatw near[2], far[2];
      KEPT *i = (KEPT *)(cell + v);
      PAIRS(near[0], near[1], value, i);
      PAIRS(far[0], far[1], value + row, i);
      const floatw nearer = near[0] + s[v] * (near[1] - near[0]), farther = far[0] + s[v] * (far[1] - far[0]);
      tile[AT(l, v)] = nearer + t[v] * (farther - nearer);
    }
  }
}

WIDE_LAYER(attention_layer, ATTENTION, FEATURES)
WIDE_LAYER(density_layer, DENSITY, FEATURES + ATTENTION + EYE)
WIDE_LAYER(second_density_layer, DENSITY, DENSITY)
WIDE_LAYER(colour_layer, COLOUR, DENSITY + SH)
PRODUCT(product_value, BLOCK(VALUES))
PRODUCT(product_one, 1)
PRODUCT(product_three, 3)
#if EYE
WIDE_LAYER(eye_layer, EYE_HIDDEN, FEATURES)
#endif

/* |W_v h|. The squares may overflow or underflow float where the norm does not: two further sums are of values scaled
 * down and of values scaled up. */
INLINE void attention_norm(floatw norm[VECTORS], global const float *a, local const floatw *hidden) {
  floatw total[VECTORS], of_huge[VECTORS], of_tiny[VECTORS];
  EACH_VECTOR total[v] = of_huge[v] = of_tiny[v] = 0;
  for (int row = 0; row < VALUES; row += BLOCK(VALUES), a += BLOCK(VALUES) * ATTENTION) {
    floatw sum[BLOCK(VALUES)][VECTORS];
    EACH_ROW(BLOCK(VALUES)) EACH_VECTOR sum[r][v] = 0;
    product_value(sum, a, hidden, ATTENTION);
    EACH_ROW(BLOCK(VALUES)) EACH_VECTOR {
      const floatw less = sum[r][v] * 0x1p-70f, more = sum[r][v] * 0x1p100f;
      total[v] += sum[r][v] * sum[r][v];
      of_huge[v] += less * less;
      of_tiny[v] += more * more;
    }
  }
  EACH_VECTOR {
    const floatw small = WHERE(total[v] < 0x1p-100f, sqrt(of_tiny[v]) * 0x1p-100f, sqrt(total[v]));
    norm[v] = WHERE(total[v] > FLT_MAX, sqrt(of_huge[v]) * 0x1p70f, small);
  }
}

struct values { /* of a tile's samples */
  floatw sigma[VECTORS], rgb[3][VECTORS], norm[VECTORS], eye[VECTORS];
};

#if SH
/* Spherical harmonics of degrees 0 to 3 of the unit vector (x, v, z) (encoding_ref.c). */
INLINE void harmonics(local floatw *y, floatw x, floatw v, floatw z) {
  const float c00 = 0.28209479177387814f, c1 = 0.48860251190291992f, c2 = 1.0925484305920792f,
              c20 = 0.31539156525252005f, c33 = 0.59004358992664352f, c32 = 2.8906114426405538f,
              c31 = 0.45704579946446572f, c30 = 0.37317633259011546f;
  y[0] = c00;
  y[TILE] = -c1 * v;
  y[2 * TILE] = c1 * z;
  y[3 * TILE] = -c1 * x;
  y[4 * TILE] = c2 * x * v;
  y[5 * TILE] = -c2 * v * z;
  y[6 * TILE] = c20 * (3 * z * z - 1);
  y[7 * TILE] = -c2 * x * z;
  y[8 * TILE] = c2 / 2 * (x * x - v * v);
  y[9 * TILE] = c33 * v * (v * v - 3 * x * x);
  y[10 * TILE] = c32 * x * v * z;
  y[11 * TILE] = c31 * v * (1 - 5 * z * z);
  y[12 * TILE] = c30 * z * (5 * z * z - 3);
  y[13 * TILE] = c31 * x * (1 - 5 * z * z);
  y[14 * TILE] = c32 / 2 * z * (x * x - v * v);
  y[15 * TILE] = c33 * x * (3 * v * v - x * x);
}
#endif

/* The attention's hidden units times the voice at each sample: v = W h has no bias, so that g v = W (g h). */
INLINE void fade(local floatw *hidden, const struct frame *f, const floatw height[VECTORS]) {
  if (!(f->fade[1] > f->fade[0])) return;
  EACH_VECTOR {
    const floatw t = clamped((height[v] - f->fade[0]) / (f->fade[1] - f->fade[0]), 0, 1);
    const floatw g = 1 - t * t * (3 - 2 * t);
    for (int row = 0; row < ATTENTION; row++) hidden[AT(row, v)] *= g;
  }
}

/* Computes sigma and rgb from the features in the tile and the directions of the rays. */
INLINE void field(struct values *out, local floatw *tile, const struct flight *flight, const struct frame *f,
                  const floatw height[VECTORS], global const float *net, bool norm_wanted) {
  local floatw *attention = tile + AT(FEATURES, 0);
  local floatw *first = tile + AT(ROW_FIRST, 0), *second = tile + AT(ROW_SECOND, 0);
  floatw one[1][VECTORS], three[3][VECTORS];
#if EYE
  eye_layer(attention, 0, 0, net + AT_EYE1, tile);
  EACH_VECTOR one[0][v] = 0;
  product_one(one, net + AT_EYE2, attention, EYE_HIDDEN);
  EACH_VECTOR {
    out->eye[v] = sigmoid(full(one[0][v]));
    tile[AT(FEATURES + ATTENTION, v)] = out->eye[v] * f->eye_value;
  }
#endif
  attention_layer(attention, 0, 0, net + AT_ATTENTION1, tile);
  fade(attention, f, height);
  if (norm_wanted) attention_norm(out->norm, net + AT_VALUE, attention);
  density_layer(first, 0, 0, net + AT_DENSITY1, tile);
  second_density_layer(second, 0, 0, net + AT_DENSITY2, first);
  EACH_VECTOR one[0][v] = 0;
  product_one(one, net + AT_SIGMA, second, DENSITY);
  EACH_VECTOR out->sigma[v] = exp(full(select(one[0][v], (floatw)(80), one[0][v] > 80)));
#if SH
  EACH_VECTOR harmonics(second + AT(DENSITY, v), flight->d[0][v], flight->d[1][v], flight->d[2][v]);
#endif
  colour_layer(first, net + AT_START, 0, net + AT_COLOUR1, second);
  EACH_ROW(3) EACH_VECTOR three[r][v] = 0;
  product_three(three, net + AT_COLOUR2, first, COLOUR);
  EACH_ROW(3) EACH_VECTOR out->rgb[r][v] = 1.002f * sigmoid(full(three[r][v])) - 0.001f;
}

/* Encoder and field of the current samples of the lanes. */
INLINE void evaluate(struct values *out, local floatw *tile, const struct flight *flight, const struct frame *f,
                     global const struct level *level, global const float *dense, global const float *net,
                     bool norm_wanted) {
#pragma OPENCL FP_CONTRACT OFF
  floatw u[3][VECTORS], height[VECTORS];
  EACH_AXIS EACH_VECTOR {
    const floatw x = clamped(f->pose[4 * axis + 3] + flight->t[v] * flight->d[axis][v], -f->bound, f->bound);
    u[axis][v] = (x + f->bound) / (2 * f->bound);
    if (axis == 0) height[v] = x;
  }
  encode_plane(tile, u[A0], u[B0], level, dense);
  encode_plane(tile + AT(LEVELS, 0), u[A1], u[B1], level + LEVELS, dense);
  encode_plane(tile + AT(2 * LEVELS, 0), u[A2], u[B2], level + 2 * LEVELS, dense);
  field(out, tile, flight, f, height, net, norm_wanted);
}

/* w = alpha T, T *= 1 - alpha (paper eq. 1-2); then each ray advances to its next sample; found[]: whether there is
 * one. */
INLINE void advance(struct flight *flight, const struct values *values, const struct frame *f, bool norm_wanted,
                    global const uchar *bits) {
#pragma OPENCL FP_CONTRACT OFF
  EACH_VECTOR {
    const floatw t = flight->t[v], far = flight->far[v], before = flight->transmittance[v];
    const floatw step = step_at(f, t), tau = values->sigma[v] * step, next = t + step;
    const floatw w = -expm1(full(-tau)) * before, after = before * exp(-tau);
    const floatw d[3] = {flight->d[0][v], flight->d[1][v], flight->d[2][v]};
    const floatw inverse[3] = {flight->inverse[0][v], flight->inverse[1][v], flight->inverse[2][v]};
    EACH_AXIS flight->colour[axis][v] += w * values->rgb[axis][v];
    flight->opacity[v] += w;
    flight->depth[v] += w * next;
    if (norm_wanted) flight->attention[v] += values->norm[v];
    if (EYE) flight->eye[v] += values->eye[v];
    flight->transmittance[v] = after;
    flight->count[v] += 1;
    const intw going =
        (flight->ray[v] >= 0) & NOT(after < f->stop) & (flight->count[v] < f->max_steps) & (next > t) & (next < far);
    flight->t[v] = next;
    flight->found[v] = find(&flight->t[v], going, far, d, inverse, f, bits);
  }
}

/* Whether a ray is in flight: in an item, or, for tensor cores, in any item of the group. */
INLINE bool is_any_flying(int flying, local int *of_group) {
#if TENSOR
  if (get_local_id(0) == 0) *of_group = 0;
  barrier(CLK_LOCAL_MEM_FENCE);
  if (flying > 0) *of_group = 1;
  barrier(CLK_LOCAL_MEM_FENCE);
  flying = *of_group;
  barrier(CLK_LOCAL_MEM_FENCE);
#endif
  return flying > 0;
}

/* ---- the frame ---- */

#define OUTPUTS_OF_RAYS                                                                                        \
  ROWS(float, pixel), ROWS(float, colour), SPAN(float, opacity), SPAN(float, depth), SPAN(float, attention),   \
      SPAN(float, eye), ROWS(const float, background)
#define RAYS                                                                                             \
  SPAN(const int, pixel_number), SPAN(const uchar, bits), SPAN(const float, nearest), SPAN(int, counter), \
      SPAN(int, listed_ray), SPAN(float, listed_t)
#define OPEN_OUTPUTS                                                                                             \
  OPEN(float, pixel);                                                                                            \
  OPEN(float, colour);                                                                                           \
  OPEN(float, opacity);                                                                                          \
  OPEN(float, depth);                                                                                            \
  OPEN(float, attention);                                                                                        \
  OPEN(float, eye);                                                                                              \
  OPEN(const float, background);                                                                                 \
  const struct output output = {pixel,      colour,       opacity,       depth,            attention, eye,       \
                                background, pixel_stride, colour_stride, background_stride}
#define OPEN_RAYS           \
  OPEN(const int, pixel_number); \
  OPEN(const uchar, bits);       \
  OPEN(const float, nearest);    \
  OPEN(int, counter);            \
  OPEN(int, listed_ray);         \
  OPEN(float, listed_t);         \
  const struct source source = {counter, listed_ray, listed_t, pixel_number, nearest, bits}

#if !CPU
/* Lists the rays that have a sample, in any order; the others are written out. An item has one ray. */
kernel void find_rays(OUTPUTS_OF_RAYS, RAYS, const struct frame frame) {
  OPEN_OUTPUTS;
  OPEN_RAYS;
  struct start s;
  const uint k = (uint)get_global_id(0);
  if (k >= frame.tickets) return;
  start_rays(&s, k, &frame, pixel_number, nearest, bits);
  if (s.found) {
    const int place = atomic_inc(source.counter + 1);
    source.ray[place] = (int)s.ray, source.t[place] = s.t;
  } else if (s.wanted) {
    put_nothing(&output, s.ray);
  }
}
#endif

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void
render_rays(OUTPUTS_OF_RAYS, RAYS, SPAN(const float, net), SPAN(const float, dense), SPAN(const uchar, levels),
            const struct frame frame) {
  local floatw tiles[TILE_ROWS * TILE];
  local int of_group;
  local floatw *tile = tiles + get_local_id(0);
  OPEN_OUTPUTS;
  OPEN_RAYS;
  OPEN(const float, net);
  OPEN(const float, dense);
  OPEN(const uchar, levels);
  struct flight flight;
  struct queue queue;
  struct values values;
  int flying = 0;
  bool more = true;
  queue.taken = queue.hits = 0;
  EACH_VECTOR flight.ray[v] = -1, flight.found[v] = 0;
  for (;;) {
    for (int lane = 0; lane < LANES; lane++) {
      if (LANE_INT(flight.found, lane)) continue;
      if (LANE_INT(flight.ray, lane) >= 0) {
        const float sum[3] = {LANE(flight.colour[0], lane), LANE(flight.colour[1], lane), LANE(flight.colour[2], lane)};
        put(&output, (uint)LANE_INT(flight.ray, lane), sum, LANE(flight.opacity, lane), LANE(flight.depth, lane),
            LANE(flight.attention, lane), LANE(flight.eye, lane));
        flying--;
      }
      more = more && take(&flight, lane, &queue, &frame, &output, &source);
      if (more)
        flying++;
      else
        leave_empty(&flight, lane);
    }
    if (!is_any_flying(flying, &of_group)) break;
    evaluate(&values, tile, &flight, &frame, (global const struct level *)levels, dense, net, attention != 0);
    advance(&flight, &values, &frame, attention != 0, bits);
  }
}
