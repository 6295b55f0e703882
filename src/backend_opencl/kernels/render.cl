/* SPDX-License-Identifier: MIT
 * The fused pass of rendering: march, field and composite of a frame's rays in one kernel, from pixel numbers to pixels.
 *
 * A work-item has LANES lanes (VECTORS vectors of WIDTH), each with a ray in flight, and evaluates the next sample of
 * all of them at once. A ray that is spent, or has no sample left, is written out and its lane takes the next ray off a
 * counter, so lanes are full until the frame ends, and no sample behind the light's end is ever computed. Rays do not
 * know of each other: whoever takes one, its values are the same.
 *
 * Built for one model's shape: LEVELS; FEATURES = 3 LEVELS, ATTENTION, VALUES, EYE (0 or 1), EYE_HIDDEN, DENSITY, COLOUR:
 * widths; AT_x: where in `net` matrix x begins; ROW_x: where in a lane's column x lies; A0 B0 A1 B1 A2 B2: the axes of the
 * planes. And for one device: GROUP items a group, VECTORS, OUTPUTS (of a layer that are summed at once).
 *
 * A matrix is packed in blocks of BLOCK(outputs) rows, in a block column by column: [outputs/BLOCK][inputs][BLOCK]. A
 * lane's activations are a column of `tile`, [rows][VECTORS][GROUP] vectors in local memory, which no other item looks at: nothing
 * waits for anything. */
/* Inlined before loops are unrolled, so that their bounds are constants. */
#define INLINE static inline __attribute__((always_inline))
#define LANES (WIDTH * VECTORS)
#define TILE (GROUP * VECTORS) /* vectors of a group */
#define BLOCK(n) ((n) < OUTPUTS ? (n) : OUTPUTS)
#define AT(row, v) ((row) * TILE + (v) * GROUP)
#define CHUNK (WIDTH == 1 ? 1 : 64) /* rays that are taken at once */
#define SH 16
#define SIDE 8    /* pixels an edge of a block that nearest[] has a value for */
#define CELLS 128 /* of the occupancy, an axis */

/* Vectors: a comparison gives a mask, 1 of a scalar and -1 of a vector; masks are joined by & and |, and NOT. */
#if WIDTH == 1
typedef float real;
typedef int mask;
typedef uint whole;
#define ANY(m) ((m) != 0)
#define WHOLE(x) convert_uint_rtz(x)
#define REAL(x) convert_float(x)
#define NUMBERS 0
#define GATHER(vector, p, i) ((p)[i])
#else
#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
typedef JOIN(float, WIDTH) real;
typedef JOIN(int, WIDTH) mask;
typedef JOIN(uint, WIDTH) whole;
#define ANY(m) any(m)
#define WHOLE(x) JOIN(JOIN(convert_uint, WIDTH), _rtz)(x)
#define REAL(x) JOIN(convert_float, WIDTH)(x)
#if WIDTH == 4
#define NUMBERS (whole)(0, 1, 2, 3)
#define GATHER(vector, p, i) (vector)((p)[i.s0], (p)[i.s1], (p)[i.s2], (p)[i.s3])
#elif WIDTH == 8
#define NUMBERS (whole)(0, 1, 2, 3, 4, 5, 6, 7)
#define GATHER(vector, p, i) \
  (vector)((p)[i.s0], (p)[i.s1], (p)[i.s2], (p)[i.s3], (p)[i.s4], (p)[i.s5], (p)[i.s6], (p)[i.s7])
#else
#define NUMBERS (whole)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
#define GATHER(vector, p, i)                                                                                       \
  (vector)((p)[i.s0], (p)[i.s1], (p)[i.s2], (p)[i.s3], (p)[i.s4], (p)[i.s5], (p)[i.s6], (p)[i.s7], (p)[i.s8], \
           (p)[i.s9], (p)[i.sa], (p)[i.sb], (p)[i.sc], (p)[i.sd], (p)[i.se], (p)[i.sf])
#endif
#endif
#define NOT(m) ((m) == 0)
#define LANE(x, lane) (((float *)(x))[lane]) /* of private vectors */
#define LANE_INT(x, lane) (((int *)(x))[lane])
#define EACH_VECTOR _Pragma("unroll") for (int v = 0; v < VECTORS; v++)
#define EACH_AXIS _Pragma("unroll") for (int axis = 0; axis < 3; axis++)

/* A call with a vector as its argument lets LLVM use registers of 512 bits, which it otherwise splits. */
INLINE real full(real x) { return x; }

/* What a frame decides; as in slots_render.c. */
struct frame {
  float pose[12], focal, cx, cy, bound, inverse_bound, dt_gamma, near, shortest, longest, stop, eye_value;
  int width, height, max_steps, picture; /* picture: rays are all pixels, dealt block by block */
  uint across, rays, tickets;            /* blocks a row; rays; numbers that are dealt */
};

/* Where rays go. */
struct output {
  global float *pixel, *colour, *opacity, *depth, *attention, *eye;
  global const float *background;
  ulong pixel_stride, colour_stride, background_stride;
};

/* ---- marching: the reference's points bit for bit (march_ref.c, rays_ref.c) ---- */

/* NaN becomes `low`. */
INLINE real clamped(real x, float low, float high) {
  return select((real)(low), select((real)(high), x, x < high), x > low);
}

/* dt(t) = clamp(gamma t, shortest, longest) */
INLINE real step_at(const struct frame *f, real t) {
#pragma OPENCL FP_CONTRACT OFF
  return clamped(t * f->dt_gamma, f->shortest, f->longest);
}

/* d = R c/|c|, c = ((i + 1/2 - cx)/f, (j + 1/2 - cy)/f, 1) */
INLINE void look(real d[3], const struct frame *f, whole column, whole row) {
#pragma OPENCL FP_CONTRACT OFF
  const real x = (REAL(column) + 0.5f - f->cx) / f->focal, y = (REAL(row) + 0.5f - f->cy) / f->focal;
  const real length = sqrt(x * x + y * y + 1.0f);
  const real unit[3] = {x / length, y / length, 1.0f / length};
  EACH_AXIS d[axis] = f->pose[4 * axis] * unit[0] + f->pose[4 * axis + 1] * unit[1] + f->pose[4 * axis + 2] * unit[2];
}

/* Where a ray is inside the box, near <= t <= far; lanes where it is. */
INLINE mask enter(real *near, real *far, const struct frame *f, const real inverse[3]) {
#pragma OPENCL FP_CONTRACT OFF
  mask valid = NOT((mask)(0));
  real first = -INFINITY, last = INFINITY;
  EACH_AXIS {
    const float half_side = axis == 1 ? f->bound / 2 : f->bound, origin = f->pose[4 * axis + 3];
    const real t0 = (-half_side - origin) * inverse[axis], t1 = (half_side - origin) * inverse[axis];
    const real from = select(t1, t0, t0 < t1), to = select(t0, t1, t0 < t1);
    valid &= (t0 == t0) & (t1 == t1);
    first = select(first, from, from > first);
    last = select(last, to, to < last);
  }
  valid &= first <= last;
  first = select(first, (real)(f->near), first < f->near);
  const real most = first + 4 * f->bound;
  *near = first;
  *far = select(last, most, last > most);
  return valid;
}

/* Bits 0 to 6 of x, to every third place. */
INLINE whole spread(whole x) {
  x = (x | x << 8) & 0x0F00F00Fu;
  x = (x | x << 4) & 0xC30C30C3u;
  return (x | x << 2) & 0x49249249u;
}

/* Up the ladder t_{k+1} = t_k + dt(t_k), from t on, to the first rung in an occupied cell; lanes of `going` that have
 * one before `far`. */
INLINE mask find(real *t_of, mask going, real far, const real d[3], const real inverse[3], const struct frame *f,
                        global const uchar *bits) {
#pragma OPENCL FP_CONTRACT OFF
  real t = *t_of;
  mask found = going & 0;
  while (ANY(going)) {
    real p[3];
    whole cell[3];
    EACH_AXIS {
      p[axis] = clamped(f->pose[4 * axis + 3] + t * d[axis], -f->bound, f->bound);
      cell[axis] = WHOLE(clamped(0.5f * (p[axis] * f->inverse_bound + 1.0f) * CELLS, 0.0f, CELLS - 1));
    }
    const whole number = spread(cell[0]) | spread(cell[1]) << 1 | spread(cell[2]) << 2, byte_at = number >> 3;
    const whole eight = GATHER(whole, bits, byte_at);
    const mask occupied = going & ((eight >> (number & 7) & 1) != 0);
    found |= occupied;
    going &= NOT(occupied);
    if (!ANY(going)) break;
    /* on along the ladder until past the cell's border */
    real least = INFINITY;
    EACH_AXIS {
      const real ahead = select((real)(1), (real)(0), signbit(d[axis]));
      const real side = (REAL(cell[axis]) + ahead) / CELLS * 2.0f - 1.0f;
      const real distance = (side * f->bound - p[axis]) * inverse[axis];
      least = select(least, distance, distance < least);
    }
    const real border = t + select((real)(0), least, least > 0);
    real last = t, next = t + step_at(f, t);
    mask inside = going & (last < next) & (next < border) & (next < far);
    while (ANY(inside)) {
      const real after = next + step_at(f, next);
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

/* ---- rays coming in and going out ---- */

struct queue { /* rays that have a sample, at distance t, and wait for a lane */
  float t[CHUNK], far[CHUNK], d[3][CHUNK];
  int ray[CHUNK];
  int taken, hits;
};

struct flight { /* ray < 0: the lane is empty */
  real t[VECTORS], far[VECTORS], d[3][VECTORS], inverse[3][VECTORS];
  real transmittance[VECTORS], colour[3][VECTORS], opacity[VECTORS], depth[VECTORS], attention[VECTORS], eye[VECTORS];
  mask ray[VECTORS], count[VECTORS], found[VECTORS];
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

/* Marches WIDTH rays, from number k on, to their first samples; those without one are written out. */
INLINE void meet(struct queue *q, uint k, const struct frame *f, const struct output *to,
                        global const int *pixel_number, global const float *nearest, global const uchar *bits) {
  whole ray = k + NUMBERS;
  mask wanted = ray < f->rays;
  if (f->picture) {
    const uint block = k / (SIDE * SIDE), top = block / f->across * SIDE, left = block % f->across * SIDE;
    const whole within = (k % (SIDE * SIDE)) + NUMBERS, row = top + within / SIDE, column = left + within % SIDE;
    wanted = (row < (uint)f->height) & (column < (uint)f->width);
    ray = row * (uint)f->width + column;
  }
  ray = select((whole)(0), ray, wanted);
  const whole pixel = GATHER(whole, pixel_number, ray);
  const whole row = pixel / (uint)f->width, column = pixel - row * (uint)f->width;
  const mask known = row < (uint)f->height;
  const whole block = select((whole)(0), row / SIDE * f->across + column / SIDE, known);
  const real not_before = select((real)(-INFINITY), GATHER(real, nearest, block), known);
  mask going = wanted & (not_before < INFINITY), found = going;
  real d[3], inverse[3], t = 0, far = 0;
  if (ANY(going)) {
    look(d, f, column, row);
    EACH_AXIS inverse[axis] = 1 / d[axis];
    going &= enter(&t, &far, f, inverse);
    mask climbing = going & (t < not_before) & (t < far);
    while (ANY(climbing)) {
      const real next = t + step_at(f, t);
      climbing &= next > t;
      t = select(t, next, climbing);
      climbing &= (t < not_before) & (t < far);
    }
    found = find(&t, going & (t < far), far, d, inverse, f, bits);
  }
  for (int l = 0; l < WIDTH; l++) {
    if (LANE_INT(&found, l)) {
      const int h = q->hits++;
      q->ray[h] = LANE_INT(&ray, l), q->t[h] = LANE(&t, l), q->far[h] = LANE(&far, l);
      EACH_AXIS q->d[axis][h] = LANE(&d[axis], l);
    } else if (LANE_INT(&wanted, l)) {
      const float black[3] = {0, 0, 0};
      put(to, (uint)LANE_INT(&ray, l), black, 0, 0, 0, 0);
    }
  }
}

/* Gives a lane the next ray that has a sample. False where there is none. */
INLINE bool take(struct flight *flight, int lane, struct queue *q, const struct frame *f, const struct output *to,
                        global const int *pixel_number, global const float *nearest, global const uchar *bits,
                        global int *counter) {
  while (q->taken == q->hits) {
    const uint k = (uint)atomic_add(counter, CHUNK);
    if (k >= f->tickets) return false;
    q->taken = q->hits = 0;
    for (int i = 0; i < CHUNK; i += WIDTH) meet(q, k + i, f, to, pixel_number, nearest, bits);
  }
  const int h = q->taken++;
  LANE(flight->t, lane) = q->t[h], LANE(flight->far, lane) = q->far[h];
  EACH_AXIS {
    LANE(flight->d[axis], lane) = q->d[axis][h];
    LANE(flight->inverse[axis], lane) = 1 / q->d[axis][h];
    LANE(flight->colour[axis], lane) = 0;
  }
  LANE_INT(flight->ray, lane) = q->ray[h], LANE_INT(flight->count, lane) = 0;
  LANE(flight->transmittance, lane) = 1;
  LANE(flight->opacity, lane) = LANE(flight->depth, lane) = 0;
  LANE(flight->attention, lane) = LANE(flight->eye, lane) = 0;
  return true;
}

/* An empty lane goes on with zeros, and nobody reads what becomes of it. */
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

/* first[l], second[l] = p[i[l]], p[i[l] + 1], for indices in memory. */
#if WIDTH == 1
#define KEPT uint
#define PAIRS(first, second, p, i) first = (p)[(i)[0]], second = (p)[(i)[0] + 1]
#else
#define KEPT volatile uint
#define PAIR(p, i) vload2(0, (p) + (i))
#define PAIRS(first, second, p, i)                                        \
  do {                                                                    \
    const real low_ = HALF(p, i, 0), high_ = HALF(p, i, WIDTH / 2);       \
    first = (real)(low_.even, high_.even), second = (real)(low_.odd, high_.odd); \
  } while (0)
#if WIDTH == 4
#define HALF(p, i, l) (real)(PAIR(p, i[l]), PAIR(p, i[l + 1]))
#elif WIDTH == 8
#define HALF(p, i, l) (real)(PAIR(p, i[l]), PAIR(p, i[l + 1]), PAIR(p, i[l + 2]), PAIR(p, i[l + 3]))
#else
#define HALF(p, i, l)                                                                               \
  (real)(PAIR(p, i[l]), PAIR(p, i[l + 1]), PAIR(p, i[l + 2]), PAIR(p, i[l + 3]), PAIR(p, i[l + 4]), \
         PAIR(p, i[l + 5]), PAIR(p, i[l + 6]), PAIR(p, i[l + 7]))
#endif
#endif

/* Features of one plane, bilinear in its levels. a, b: the plane's coordinates on [0, 1]. All cells of a level first;
 * they go through memory, from where scalar loads take them: out of registers they would hold up the shuffles. */
INLINE void encode_plane(local real *tile, const real a[VECTORS], const real b[VECTORS],
                                global const struct level *level, global const float *dense) {
#pragma OPENCL FP_CONTRACT OFF
  for (int l = 0; l < LEVELS; l++) {
    const float scale = level[l].scale;
    const uint row = level[l].row;
    global const float *value = dense + level[l].at;
    whole cell[VECTORS];
    real s[VECTORS], t[VECTORS];
    EACH_VECTOR {
      const real p = full(a[v]) * scale + 0.5f, q = full(b[v]) * scale + 0.5f;
      const whole c0 = WHOLE(p), c1 = WHOLE(q);
      s[v] = p - REAL(c0), t[v] = q - REAL(c1);
      cell[v] = c0 + c1 * row;
    }
    EACH_VECTOR {
      real near[2], far[2];
      KEPT *i = (KEPT *)(cell + v);
      PAIRS(near[0], near[1], value, i);
      PAIRS(far[0], far[1], value + row, i);
      const real nearer = near[0] + s[v] * (near[1] - near[0]), farther = far[0] + s[v] * (far[1] - far[0]);
      tile[AT(l, v)] = nearer + t[v] * (farther - nearer);
    }
  }
}

#define EACH_ROW(rows) _Pragma("unroll") for (int r = 0; r < (rows); r++)

/* sum += A x over `count` inputs: a block of `rows`, known before functions are inlined, so that loops over it are
 * unrolled and the sums are registers. GPUs read weights by fours. */
#if WIDTH == 1
#define WEIGH(r, weight) EACH_VECTOR sum[r][v] += (weight) * value[v];
#define FOUR(rows)                                                                                                    \
  if ((rows) % 4 == 0) {                                                                                              \
    global const float4 *weights = (global const float4 *)(a + k * (rows));                                           \
    _Pragma("unroll") for (int r = 0; r < (rows) / 4 * 4; r += 4) {                                                   \
      const float4 weight = weights[r / 4];                                                                           \
      WEIGH(r, weight.s0) WEIGH(r + 1, weight.s1) WEIGH(r + 2, weight.s2) WEIGH(r + 3, weight.s3)                     \
    }                                                                                                                 \
    continue;                                                                                                         \
  }
#else
#define FOUR(rows)
#endif
#define PRODUCT(name, rows)                                                                                           \
  INLINE void name(real (*sum)[VECTORS], global const float *a, local const real *x, const int count) {              \
    for (int k = 0; k < count; k++) {                                                                                 \
      real value[VECTORS];                                                                                            \
      EACH_VECTOR value[v] = x[AT(k, v)];                                                                             \
      FOUR(rows)                                                                                                      \
      EACH_ROW(rows) {                                                                                                \
        const real weight = (real)(a[k * (rows) + r]);                                                                \
        EACH_VECTOR sum[r][v] += weight * value[v];                                                                   \
      }                                                                                                               \
    }                                                                                                                 \
  }

/* y = relu(start + A x); start [outputs]: of the frame, 0: none. y may be x where all outputs are one block. A NaN
 * stays one. */
#define LAYER(name, outputs, count)                                                                                   \
  PRODUCT(product_##name, BLOCK(outputs))                                                                             \
  INLINE void name(local real *y, global const float *start, global const float *a, local const real *x) {          \
    for (int row = 0; row < (outputs); row += BLOCK(outputs), a += BLOCK(outputs) * (count)) {                        \
      real sum[BLOCK(outputs)][VECTORS];                                                                              \
      EACH_ROW(BLOCK(outputs)) EACH_VECTOR sum[r][v] = start ? (real)(start[row + r]) : (real)(0);                    \
      product_##name(sum, a, x, count);                                                                               \
      EACH_ROW(BLOCK(outputs))                                                                                        \
        EACH_VECTOR y[AT(row + r, v)] = full(select(sum[r][v], (real)(0), sum[r][v] < 0));                            \
    }                                                                                                                 \
  }

LAYER(attention_layer, ATTENTION, FEATURES)
LAYER(density_layer, DENSITY, FEATURES + ATTENTION + EYE)
LAYER(second_density_layer, DENSITY, DENSITY)
LAYER(colour_layer, COLOUR, DENSITY + SH)
PRODUCT(product_value, BLOCK(VALUES))
PRODUCT(product_one, 1)
PRODUCT(product_three, 3)
#if EYE
LAYER(eye_layer, EYE_HIDDEN, FEATURES)
#endif

/* |W_v h| */
INLINE void attention_norm(real norm[VECTORS], global const float *a, local const real *hidden) {
  real total[VECTORS];
  EACH_VECTOR total[v] = 0;
  for (int row = 0; row < VALUES; row += BLOCK(VALUES), a += BLOCK(VALUES) * ATTENTION) {
    real sum[BLOCK(VALUES)][VECTORS];
    EACH_ROW(BLOCK(VALUES)) EACH_VECTOR sum[r][v] = 0;
    product_value(sum, a, hidden, ATTENTION);
    EACH_ROW(BLOCK(VALUES)) EACH_VECTOR total[v] += sum[r][v] * sum[r][v];
  }
  EACH_VECTOR norm[v] = sqrt(total[v]);
}

INLINE real sigmoid(real x) { return 1 / (1 + exp(-x)); }

struct values { /* of a tile's samples */
  real sigma[VECTORS], rgb[3][VECTORS], norm[VECTORS], eye[VECTORS];
};

/* Spherical harmonics of degrees 0 to 3 of the unit vector (x, v, z) (posenc_ref.c). */
INLINE void harmonics(local real *y, real x, real v, real z) {
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

/* From features to sigma and rgb; d: directions of the rays. */
INLINE void field(struct values *out, local real *tile, const struct flight *flight, global const float *net,
                  float eye_value, bool norm_wanted) {
  local real *attention = tile + AT(FEATURES, 0), *first = tile + AT(ROW_FIRST, 0), *second = tile + AT(ROW_SECOND, 0);
  real one[1][VECTORS], three[3][VECTORS];
#if EYE
  eye_layer(attention, 0, net + AT_EYE1, tile);
  EACH_VECTOR one[0][v] = 0;
  product_one(one, net + AT_EYE2, attention, EYE_HIDDEN);
  EACH_VECTOR {
    out->eye[v] = sigmoid(full(one[0][v]));
    tile[AT(FEATURES + ATTENTION, v)] = out->eye[v] * eye_value;
  }
#endif
  attention_layer(attention, 0, net + AT_ATTENTION1, tile);
  if (norm_wanted) attention_norm(out->norm, net + AT_VALUE, attention);
  density_layer(first, 0, net + AT_DENSITY1, tile);
  second_density_layer(second, 0, net + AT_DENSITY2, first);
  EACH_VECTOR one[0][v] = 0;
  product_one(one, net + AT_SIGMA, second, DENSITY);
  EACH_VECTOR out->sigma[v] = exp(full(select(one[0][v], (real)(80), one[0][v] > 80)));
  EACH_VECTOR harmonics(second + AT(DENSITY, v), flight->d[0][v], flight->d[1][v], flight->d[2][v]);
  colour_layer(first, net + AT_START, net + AT_COLOUR1, second);
  EACH_ROW(3) EACH_VECTOR three[r][v] = 0;
  product_three(three, net + AT_COLOUR2, first, COLOUR);
  EACH_ROW(3) EACH_VECTOR out->rgb[r][v] = 1.002f * sigmoid(full(three[r][v])) - 0.001f;
}

/* Encoder and field of the samples that the lanes are at. */
INLINE void evaluate(struct values *out, local real *tile, const struct flight *flight, const struct frame *f,
                            global const struct level *level, global const float *dense, global const float *net,
                            bool norm_wanted) {
#pragma OPENCL FP_CONTRACT OFF
  real u[3][VECTORS];
  EACH_AXIS EACH_VECTOR {
    const real x = f->pose[4 * axis + 3] + flight->t[v] * flight->d[axis][v];
    u[axis][v] = (clamped(x, -f->bound, f->bound) + f->bound) / (2 * f->bound);
  }
  encode_plane(tile, u[A0], u[B0], level, dense);
  encode_plane(tile + AT(LEVELS, 0), u[A1], u[B1], level + LEVELS, dense);
  encode_plane(tile + AT(2 * LEVELS, 0), u[A2], u[B2], level + 2 * LEVELS, dense);
  field(out, tile, flight, net, f->eye_value, norm_wanted);
}

/* w = alpha T, T *= 1 - alpha (paper eq. 1-2), then on to the next sample of each ray; found[]: there is one. */
INLINE void advance(struct flight *flight, const struct values *values, const struct frame *f, bool norm_wanted,
                           global const uchar *bits) {
#pragma OPENCL FP_CONTRACT OFF
  EACH_VECTOR {
    const real t = flight->t[v], far = flight->far[v], before = flight->transmittance[v];
    const real step = step_at(f, t), tau = values->sigma[v] * step, next = t + step;
    const real w = -expm1(full(-tau)) * before, after = before * exp(-tau);
    const real d[3] = {flight->d[0][v], flight->d[1][v], flight->d[2][v]};
    const real inverse[3] = {flight->inverse[0][v], flight->inverse[1][v], flight->inverse[2][v]};
    EACH_AXIS flight->colour[axis][v] += w * values->rgb[axis][v];
    flight->opacity[v] += w;
    flight->depth[v] += w * next;
    if (norm_wanted) flight->attention[v] += values->norm[v];
    if (EYE) flight->eye[v] += values->eye[v];
    flight->transmittance[v] = after;
    flight->count[v] += 1;
    const mask going =
        (flight->ray[v] >= 0) & NOT(after < f->stop) & (flight->count[v] < f->max_steps) & (next > t) & (next < far);
    flight->t[v] = next;
    flight->found[v] = find(&flight->t[v], going, far, d, inverse, f, bits);
  }
}

/* ---- the frame ---- */

kernel __attribute__((reqd_work_group_size(GROUP, 1, 1))) void
render_rays(ROWS(float, pixel), ROWS(float, colour), SPAN(float, opacity), SPAN(float, depth), SPAN(float, attention),
            SPAN(float, eye), ROWS(const float, background), SPAN(const int, pixel_number), SPAN(const uchar, bits),
            SPAN(const float, nearest), SPAN(const float, net), SPAN(const float, dense), SPAN(const uchar, levels),
            SPAN(int, counter), const struct frame frame) {
  local real tiles[TILE_ROWS * TILE];
  local real *tile = tiles + get_local_id(0);
  OPEN(float, pixel);
  OPEN(float, colour);
  OPEN(float, opacity);
  OPEN(float, depth);
  OPEN(float, attention);
  OPEN(float, eye);
  OPEN(const float, background);
  OPEN(const int, pixel_number);
  OPEN(const uchar, bits);
  OPEN(const float, nearest);
  OPEN(const float, net);
  OPEN(const float, dense);
  OPEN(const uchar, levels);
  OPEN(int, counter);
  const struct output output = {pixel,      colour,       opacity,       depth,            attention, eye,
                                background, pixel_stride, colour_stride, background_stride};
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
      more = more && take(&flight, lane, &queue, &frame, &output, pixel_number, nearest, bits, counter);
      if (more)
        flying++;
      else
        leave_empty(&flight, lane);
    }
    if (flying == 0) break;
    evaluate(&values, tile, &flight, &frame, (global const struct level *)levels, dense, net, attention != 0);
    advance(&flight, &values, &frame, attention != 0, bits);
  }
}

/* ---- before frames ---- */

/* value (c0, c1) = table[index(c0, c1)], for a level of [side][side] values: dense while that fits, else the hash. */
kernel void render_unhash(SPAN(float, value), SPAN(const float, table), uint side, uint size, int hashed, ulong n) {
  OPEN(float, value);
  OPEN(const float, table);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  const uint c1 = (uint)(i / side), c0 = (uint)(i % side);
  value[i] = table[(hashed ? c0 ^ c1 * 2654435761u : c0 + c1 * side) % size];
}

/* packed (r, at + c) = A (r, c), a block of `block` rows being `width` columns wide; A: rows `row_step` apart. */
kernel void render_pack(SPAN(float, packed), SPAN(const float, a), ulong row_step, uint rows, uint columns, uint block,
                        uint width, uint at) {
  OPEN(float, packed);
  OPEN(const float, a);
  const uint r = (uint)get_global_id(0) / columns, c = (uint)get_global_id(0) % columns;
  if (r >= rows) return;
  packed[(r / block * width + at + c) * block + r % block] = a[r * row_step + c];
}

/* packed (r, at + c) = sum_k A (r, k) scale_k B (k, c); no scale: ones. B: [count][columns]. */
kernel void render_multiply(SPAN(float, packed), SPAN(const float, a), SPAN(const float, scale), SPAN(const float, b),
                            ulong row_step, uint count, uint rows, uint columns, uint block, uint width, uint at) {
  OPEN(float, packed);
  OPEN(const float, a);
  OPEN(const float, scale);
  OPEN(const float, b);
  const uint r = (uint)get_global_id(0) / columns, c = (uint)get_global_id(0) % columns;
  if (r >= rows) return;
  float sum = 0;
  for (uint k = 0; k < count; k++) sum += a[r * row_step + k] * (scale ? scale[k] : 1) * b[k * columns + c];
  packed[(r / block * width + at + c) * block + r % block] = sum;
}
