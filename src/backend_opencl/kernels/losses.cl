/* SPDX-License-Identifier: MIT
 * The losses of the head and the torso (docs/maths.md), value and gradient together, and the points at which the
 * smoothness term is evaluated.
 *
 * A sum is split into PARTS parts of consecutive elements, one group each, on every device alike. A part has GROUP
 * partial sums; partial sum k adds the elements k, k + GROUP, ... of the part. The partial sums are then added by
 * pairwise halving. The host adds the sums of the parts in double. */

#pragma OPENCL FP_CONTRACT OFF

#define GROUP 64              /* partial sums of a part; ERN_CL_SUM_GROUP */
#define ITEMS (GROUP / WIDTH) /* work-items of a group */
#define PARTS 64              /* of a sum; ERN_CL_SUMS */
#define SUMMING kernel __attribute__((reqd_work_group_size(ITEMS, 1, 1)))

/* Elements of a part, of n in all. */
ulong part_of(ulong n) { return (n + PARTS * GROUP - 1) / (PARTS * GROUP) * GROUP; }

/* Elements in an item's vector from r on, at most WIDTH. */
ulong count_of(ulong r, ulong end) { return r < end ? min(end - r, (ulong)WIDTH) : 0; }

/* The sum of a group's values. partial: [GROUP] */
float group_sum(local float *partial, floatw value) {
  const uint item = get_local_id(0);
  STOREW(value, partial + item * WIDTH);
  for (uint apart = GROUP / 2; apart > 0; apart /= 2) {
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint k = item; k < apart; k += ITEMS) partial[k] += partial[k + apart];
  }
  barrier(CLK_LOCAL_MEM_FENCE);
  const float sum = partial[0];
  barrier(CLK_LOCAL_MEM_FENCE);
  return sum;
}

/* The largest of a group's values; NaN is ignored. partial: [GROUP] */
float group_most(local float *partial, floatw value) {
  const uint item = get_local_id(0);
  STOREW(value, partial + item * WIDTH);
  for (uint apart = GROUP / 2; apart > 0; apart /= 2) {
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint k = item; k < apart; k += ITEMS) partial[k] = fmax(partial[k], partial[k + apart]);
  }
  barrier(CLK_LOCAL_MEM_FENCE);
  const float most = partial[0];
  barrier(CLK_LOCAL_MEM_FENCE);
  return most;
}

/* The value in the first `count` lanes, `other` in the rest. */
floatw first_of(ulong count, floatw value, float other) {
  return count >= WIDTH ? value : WHERE(lane_numbers() < (uint)count, value, other);
}

/* ---- terms of the head ---- */

/* softmax(u)_r = exp(u_r - most)/sum over all rays. This kernel gives each part's own most and sum; an empty part has
 * -infinity and 0. most, sum: [PARTS]; uncertainty: [n] */
SUMMING void head_softmax(SPAN(float, most), SPAN(float, sum), SPAN(const float, uncertainty), ulong n) {
  OPEN(float, most);
  OPEN(float, sum);
  OPEN(const float, uncertainty);
  local float partial[GROUP];
  const ulong part = get_group_id(0), begin = min(part * part_of(n), n), end = min(begin + part_of(n), n);
  const uint item = get_local_id(0);
  floatw own = -INFINITY, share = 0;
  for (ulong r = begin + item * WIDTH; r < end; r += GROUP)
    own = fmax(own, first_of(count_of(r, end), loadw_first(uncertainty + r, count_of(r, end)), -INFINITY));
  const float of_part = group_most(partial, own);
  const float from = of_part == -INFINITY ? 0 : of_part; /* exp(-infinity - 0) is 0 */
  for (ulong r = begin + item * WIDTH; r < end; r += GROUP)
    share += first_of(count_of(r, end), exp(loadw_first(uncertainty + r, count_of(r, end)) - from), 0);
  const float sum_of_part = group_sum(partial, share);
  if (item != 0) return;
  most[part] = of_part;
  sum[part] = sum_of_part;
}

/* struct head_factors of losses.c. by_*: factors of the gradient of each term: weight, schedule and 1/R; s in [0, 1];
 * mean = 1/R; rays = R. */
struct head_factors {
  float by_pixel, by_uncertainty, by_outside, by_entropy, by_audio, by_eye;
  float s, mean, rays;
  int adaptive;
};

enum { PHOTOMETRIC, UNCERTAINTY, OUTSIDE, ENTROPY, AUDIO, EYE, TERMS };

/* 0.2 + 0.8 clamp((1 - s) + s R softmax(u), 0, 10); no gradient goes through it. */
floatw photometric_weight(floatw u, float most, float sum, struct head_factors by) {
  const floatw blend = (1 - by.s) + by.s * (exp(u - most) / sum * by.rays);
  return 0.2f + 0.8f * WHERE(blend < 0, 0, WHERE(blend > 10, 10, blend));
}

/* face (e/(2 beta^2) + log(beta)^2/2) with beta = u + 1 and e = |pixel - truth|_2 without gradient;
 * *du = face (log(beta)/beta - e/beta^3). */
floatw uncertainty_term(floatw *du, floatw u, floatw error, floatw face) {
  const floatw beta = u + 1, log_beta = log1p(u), once = error / beta / beta;
  *du = face * ((log_beta - once) / beta);
  return face * (once / 2 + log_beta * log_beta / 2);
}

/* H(w) = -w log2 w - (1-w) log2(1-w), w = clamp(opacity, 1e-5, 1 - 1e-5); dH/dw = log2((1-w)/w), 0 outside the
 * clamp. */
floatw entropy_term(floatw *dopacity, floatw opacity) {
  const float low = 1e-5f, high = 1 - low;
  const floatw w = WHERE(opacity < low, low, WHERE(opacity > high, high, opacity));
  const floatw own = log2(w), other = log2(1 - w);
  *dopacity = WHERE((opacity >= low) & (opacity <= high), other - own, 0);
  return -w * own - (1 - w) * other;
}

/* terms: [PARTS][TERMS], the parts' shares of each term's mean, before weights. most, sum: [PARTS], of head_softmax;
 * dpixel, pixel, truth: [3] per ray; the others [n]; attention, dattention, eye, deye may be null. */
SUMMING void head_loss(SPAN(float, terms), ROWS(float, dpixel), SPAN(float, dopacity), SPAN(float, dattention),
                       SPAN(float, deye), SPAN(float, duncertainty), ROWS(const float, pixel), ROWS(const float, truth),
                       SPAN(const float, opacity), SPAN(const float, attention), SPAN(const float, eye),
                       SPAN(const float, uncertainty), SPAN(const float, face), SPAN(const float, most),
                       SPAN(const float, sum), struct head_factors by, ulong n) {
  OPEN(float, terms);
  OPEN(float, dpixel);
  OPEN(float, dopacity);
  OPEN(float, dattention);
  OPEN(float, deye);
  OPEN(float, duncertainty);
  OPEN(const float, pixel);
  OPEN(const float, truth);
  OPEN(const float, opacity);
  OPEN(const float, attention);
  OPEN(const float, eye);
  OPEN(const float, uncertainty);
  OPEN(const float, face);
  OPEN(const float, most);
  OPEN(const float, sum);
  local float partial[GROUP];
  const uint item = get_local_id(0);
  float all_most = 0, all_sum = 1;
  if (by.adaptive) { /* each part's sum is of exp(u - its own most) */
    const floatw its_most = LOADW(most + item * WIDTH), its_sum = LOADW(sum + item * WIDTH);
    all_most = group_most(partial, its_most);
    all_sum = group_sum(partial, WHERE(its_sum != 0, its_sum * exp(its_most - all_most), 0));
  }
  const ulong part = get_group_id(0), begin = min(part * part_of(n), n), end = min(begin + part_of(n), n);
  floatw share[TERMS] = {0, 0, 0, 0, 0, 0};
  for (ulong r = begin + item * WIDTH; r < end; r += GROUP) {
    const ulong count = count_of(r, end);
    const floatw u = loadw_first(uncertainty + r, count), inside = loadw_first(face + r, count);
    const floatw attended = attention ? loadw_first(attention + r, count) : 0;
    const floatw weight = by.adaptive ? photometric_weight(u, all_most, all_sum, by) : 1;
    floatw term[TERMS] = {0, 0, 0, 0, 0, 0}, squares = 0, du, dsum;
    for (uint c = 0; c < 3; c++) {
      const floatw difference =
          loadw_first(pixel + c * pixel_stride + r, count) - loadw_first(truth + c * truth_stride + r, count);
      squares += difference * difference;
      storew_first(dpixel + c * dpixel_stride + r, by.by_pixel * weight * difference, count);
    }
    term[PHOTOMETRIC] = weight * (squares / 3);
    term[UNCERTAINTY] = uncertainty_term(&du, u, sqrt(squares), inside);
    term[OUTSIDE] = u * (1 - inside);
    term[ENTROPY] = entropy_term(&dsum, loadw_first(opacity + r, count));
    term[AUDIO] = attended * (1 - inside);
    if (eye) term[EYE] = loadw_first(eye + r, count) * attended * inside;
    storew_first(duncertainty + r, by.by_uncertainty * du + by.by_outside * (1 - inside), count);
    storew_first(dopacity + r, by.by_entropy * dsum, count);
    if (dattention) storew_first(dattention + r, by.by_audio * (1 - inside), count);
    if (deye) storew_first(deye + r, by.by_eye * attended * inside, count); /* no gradient to the attention */
    /* multiplied by 1/R before the summation: sums of large values stay finite where those of the reference, in double,
     * do */
    for (uint t = 0; t < TERMS; t++) share[t] += first_of(count, term[t] * by.mean, 0);
  }
  for (uint t = 0; t < TERMS; t++) {
    const float of_part = group_sum(partial, share[t]);
    if (item == 0) terms[part * TERMS + t] = of_part;
  }
}

/* ---- squared differences ---- */

/* The reference sums squares in double. To cover its range, squares of huge and of tiny values have sums of their own:
 * values above 2^40 are scaled by 2^-80, values below 2^-40 by 2^80; the others are not scaled. */
struct squares {
  floatw usual, huge, tiny;
};

void add_square(struct squares *sum, floatw x) {
  const floatw size = fabs(x), huge = WHERE(size > 0x1p40f, x * 0x1p-80f, 0);
  const floatw tiny = WHERE(size < 0x1p-40f, x * 0x1p80f, 0);
  const floatw usual = WHERE((size > 0x1p40f) | (size < 0x1p-40f), 0, x);
  sum->usual += usual * usual;
  sum->huge += huge * huge;
  sum->tiny += tiny * tiny;
}

/* squares: [PARTS][3] */
void write_squares(global float *squares, local float *partial, struct squares *own) {
  const float usual = group_sum(partial, own->usual), huge = group_sum(partial, own->huge), tiny = group_sum(partial, own->tiny);
  if (get_local_id(0) == 0) vstore3((float3)(usual, huge, tiny), get_group_id(0), squares);
}

/* squares: [PARTS][3], of moved - still; dmoved = factor (moved - still); all [n] */
SUMMING void smooth_loss(SPAN(float, squares), SPAN(float, dmoved), SPAN(const float, still), SPAN(const float, moved),
                         float factor, ulong n) {
  OPEN(float, squares);
  OPEN(float, dmoved);
  OPEN(const float, still);
  OPEN(const float, moved);
  local float partial[GROUP];
  const ulong begin = min(get_group_id(0) * part_of(n), n), end = min(begin + part_of(n), n);
  struct squares own = {0, 0, 0};
  for (ulong i = begin + get_local_id(0) * WIDTH; i < end; i += GROUP) {
    const ulong count = count_of(i, end);
    const floatw difference = loadw_first(moved + i, count) - loadw_first(still + i, count);
    add_square(&own, difference);
    storew_first(dmoved + i, factor * difference, count);
  }
  write_squares(squares, partial, &own);
}

/* squares: [PARTS][3], of pixel - truth; dpixel = factor (pixel - truth); [3] per ray */
SUMMING void mse(SPAN(float, squares), ROWS(float, dpixel), ROWS(const float, pixel), ROWS(const float, truth),
                 float factor, ulong n) {
  OPEN(float, squares);
  OPEN(float, dpixel);
  OPEN(const float, pixel);
  OPEN(const float, truth);
  local float partial[GROUP];
  const ulong begin = min(get_group_id(0) * part_of(n), n), end = min(begin + part_of(n), n);
  struct squares own = {0, 0, 0};
  for (ulong r = begin + get_local_id(0) * WIDTH; r < end; r += GROUP) {
    const ulong count = count_of(r, end);
    for (uint c = 0; c < 3; c++) {
      const floatw difference =
          loadw_first(pixel + c * pixel_stride + r, count) - loadw_first(truth + c * truth_stride + r, count);
      add_square(&own, difference);
      storew_first(dpixel + c * dpixel_stride + r, factor * difference, count);
    }
  }
  write_squares(squares, partial, &own);
}

/* short_of: [3], 1 - w of each key point, which the host squares; anchors, danchors: [3][4], danchors accumulates */
kernel void key_points_loss(SPAN(float, short_of), SPAN(float, danchors), SPAN(const float, anchors)) {
  OPEN(float, short_of);
  OPEN(float, danchors);
  OPEN(const float, anchors);
  const uint point = get_global_id(0);
  if (point >= 3) return;
  const float own = 1 - anchors[4 * point + 3];
  short_of[point] = own;
  danchors[4 * point + 3] -= 2 * own / 3;
}

/* ---- points beside the samples ---- */

/* moved, x: [3] per sample; an item takes WIDTH samples; `first` is the number of the first sample, `purpose` the
 * fourth word of the Philox counter. Offsets are uniform(-reach, reach), from 24 random bits. */
kernel void smooth_points(ROWS(float, moved), ROWS(const float, x), float reach, ulong seed, ulong step, ulong first,
                          uint purpose, ulong n) {
  OPEN(float, moved);
  OPEN(const float, x);
  const ulong i = get_global_id(0) * WIDTH, count = count_of(i, n);
  if (count == 0) return;
  uintw word[3];
  random_at(word, seed, step, (uint)(first + i) + lane_numbers(), purpose);
  for (uint axis = 0; axis < 3; axis++) {
    const floatw uniform = JOINW(convert_float)(word[axis] >> 8) * 0x1p-24f;
    const floatw offset = (2 * uniform - 1) * reach;
    storew_first(moved + axis * moved_stride + i, loadw_first(x + axis * x_stride + i, count) + offset, count);
  }
}

/* ---- the camera ---- */

/* sum += u (a cross da) */
void add_moment(floatw sum[3], floatw u, global const float *da, ulong da_stride, global const float *a, ulong a_stride,
                ulong count) {
  const floatw x = loadw_first(a, count), y = loadw_first(a + a_stride, count),
               z = loadw_first(a + 2 * a_stride, count);
  const floatw dx = loadw_first(da, count), dy = loadw_first(da + da_stride, count),
               dz = loadw_first(da + 2 * da_stride, count);
  sum[0] += u * (y * dz - z * dy);
  sum[1] += u * (z * dx - x * dz);
  sum[2] += u * (x * dy - y * dx);
}

/* sums: [PARTS][6], of u (x cross dx + d cross dd), and of u dx; [3] per sample; dd null: none; weight u [n], null: 1 */
SUMMING void pose_bwd(SPAN(float, sums), ROWS(const float, dx), ROWS(const float, x), ROWS(const float, dd),
                      ROWS(const float, d), SPAN(const float, weight), ulong n) {
  OPEN(float, sums);
  OPEN(const float, dx);
  OPEN(const float, x);
  OPEN(const float, dd);
  OPEN(const float, d);
  OPEN(const float, weight);
  local float partial[GROUP];
  const ulong begin = min(get_group_id(0) * part_of(n), n), end = min(begin + part_of(n), n);
  floatw own[6] = {0, 0, 0, 0, 0, 0};
  for (ulong i = begin + get_local_id(0) * WIDTH; i < end; i += GROUP) {
    const ulong count = count_of(i, end);
    const floatw u = weight ? loadw_first(weight + i, count) : 1;
    add_moment(own, u, dx + i, dx_stride, x + i, x_stride, count);
    if (dd) add_moment(own, u, dd + i, dd_stride, d + i, d_stride, count);
    for (ulong axis = 0; axis < 3; axis++) own[3 + axis] += u * loadw_first(dx + axis * dx_stride + i, count);
  }
  for (uint k = 0; k < 6; k++) {
    const float sum = group_sum(partial, own[k]);
    if (get_local_id(0) == 0) sums[6 * get_group_id(0) + k] = sum;
  }
}
