/* SPDX-License-Identifier: MIT
 * The losses of model.md section 6, value and gradient together, and the points that the smoothness looks at.
 *
 * Sums are cut into as many parts as there are groups, each of consecutive elements, whatever the device: item k of a
 * group takes elements k, k + GROUP, ... of its part, and halves of the items are added. A part's sums go to the host,
 * which adds them up in double. */

#pragma OPENCL FP_CONTRACT OFF

#define GROUP 64 /* items; ERN_CL_SUM_GROUP */
#define PARTS 64 /* groups; ERN_CL_SUMS */
#define SUMMING kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))

/* Elements of a part of n. */
ulong part_of(ulong n) { return (n + PARTS - 1) / PARTS; }

/* The sum of the items' values. room: [GROUP] */
float group_sum(local float *room, float value) {
  const uint item = get_local_id(0);
  room[item] = value;
  for (uint apart = GROUP / 2; apart > 0; apart /= 2) {
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item < apart) room[item] += room[item + apart];
  }
  barrier(CLK_LOCAL_MEM_FENCE);
  const float sum = room[0];
  barrier(CLK_LOCAL_MEM_FENCE);
  return sum;
}

/* The largest of them; those that are no number do not count. */
float group_most(local float *room, float value) {
  const uint item = get_local_id(0);
  room[item] = value;
  for (uint apart = GROUP / 2; apart > 0; apart /= 2) {
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item < apart) room[item] = fmax(room[item], room[item + apart]);
  }
  barrier(CLK_LOCAL_MEM_FENCE);
  const float most = room[0];
  barrier(CLK_LOCAL_MEM_FENCE);
  return most;
}

/* ---- terms of the head ---- */

/* softmax(u)_r = exp(u_r - most)/sum over all rays: of each part its own most and sum, of a part of none -infinity and
 * 0. most, sum: [PARTS]; uncertainty: [n] */
SUMMING void head_softmax(SPAN(float, most), SPAN(float, sum), SPAN(const float, uncertainty), ulong n) {
  OPEN(float, most);
  OPEN(float, sum);
  OPEN(const float, uncertainty);
  local float room[GROUP];
  const ulong part = get_group_id(0), begin = min(part * part_of(n), n), end = min(begin + part_of(n), n);
  float own = -INFINITY, share = 0;
  for (ulong base = begin; base < end; base += GROUP) {
    const ulong r = base + get_local_id(0);
    if (r < end) own = fmax(own, uncertainty[r]);
  }
  own = group_most(room, own);
  const float from = own == -INFINITY ? 0 : own; /* exp(-infinity - 0) is 0 */
  for (ulong base = begin; base < end; base += GROUP) {
    const ulong r = base + get_local_id(0);
    if (r < end) share += exp(uncertainty[r] - from);
  }
  share = group_sum(room, share);
  if (get_local_id(0) != 0) return;
  most[part] = own;
  sum[part] = share;
}

/* struct head_factors of slots_train.c: of each term's gradient weight, schedule and 1/R; s in [0, 1]; 1/R; R. */
struct head_factors {
  float by_pixel, by_uncertainty, by_outside, by_entropy, by_audio, by_eye;
  float s, mean, rays;
  int adaptive;
};

enum { PHOTOMETRIC, UNCERTAINTY, OUTSIDE, ENTROPY, AUDIO, EYE, TERMS };

/* 0.2 + 0.8 clamp((1 - s) + s R softmax(u), 0, 10); no gradient goes through it. */
float photometric_weight(float u, float most, float sum, struct head_factors by) {
  const float blend = (1 - by.s) + by.s * (exp(u - most) / sum * by.rays);
  return 0.2f + 0.8f * (blend < 0 ? 0 : blend > 10 ? 10 : blend);
}

/* face (e/(2 beta^2) + log(beta)^2/2) with beta = u + 1 and e = |pixel - truth|_2 without gradient;
 * *du = face (log(beta)/beta - e/beta^3). */
float uncertainty_term(float *du, float u, float error, float face) {
  const float beta = u + 1, log_beta = log1p(u);
  *du = face * ((log_beta - error / beta / beta) / beta);
  return face * (error / beta / beta / 2 + log_beta * log_beta / 2);
}

/* H(w) = -w log2 w - (1-w) log2(1-w), w = clamp(opacity, 1e-5, 1 - 1e-5); dH/dw = log2((1-w)/w), 0 outside the clamp.
 */
float entropy_term(float *dopacity, float opacity) {
  const float low = 1e-5f, high = 1 - low;
  const float w = opacity < low ? low : opacity > high ? high : opacity;
  const float own = log2(w), other = log2(1 - w);
  *dopacity = opacity >= low && opacity <= high ? other - own : 0;
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
  local float room[GROUP];
  const uint item = get_local_id(0);
  float all_most = 0, all_sum = 1;
  if (by.adaptive) { /* each part's sum was of exp(u - its own most) */
    all_most = group_most(room, most[item]);
    all_sum = group_sum(room, sum[item] != 0 ? sum[item] * exp(most[item] - all_most) : 0);
  }
  const ulong part = get_group_id(0), begin = min(part * part_of(n), n), end = min(begin + part_of(n), n);
  float share[TERMS] = {0, 0, 0, 0, 0, 0};
  for (ulong base = begin; base < end; base += GROUP) {
    const ulong r = base + item;
    if (r >= end) continue;
    const float u = uncertainty[r], inside = face[r], attended = attention ? attention[r] : 0;
    const float weight = by.adaptive ? photometric_weight(u, all_most, all_sum, by) : 1;
    float squares = 0, du, dsum;
    for (uint c = 0; c < 3; c++) {
      const float difference = pixel[c * pixel_stride + r] - truth[c * truth_stride + r];
      squares += difference * difference;
      dpixel[c * dpixel_stride + r] = by.by_pixel * weight * difference;
    }
    /* 1/R first: sums of large values stay finite where the reference's, in double, do */
    share[PHOTOMETRIC] += weight * (squares / 3) * by.mean;
    share[UNCERTAINTY] += uncertainty_term(&du, u, sqrt(squares), inside) * by.mean;
    share[OUTSIDE] += u * (1 - inside) * by.mean;
    duncertainty[r] = by.by_uncertainty * du + by.by_outside * (1 - inside);
    share[ENTROPY] += entropy_term(&dsum, opacity[r]) * by.mean;
    dopacity[r] = by.by_entropy * dsum;
    share[AUDIO] += attended * (1 - inside) * by.mean;
    if (dattention) dattention[r] = by.by_audio * (1 - inside);
    if (eye) share[EYE] += eye[r] * attended * inside * by.mean;
    if (deye) deye[r] = by.by_eye * attended * inside; /* no gradient to the attention */
  }
  for (uint term = 0; term < TERMS; term++) {
    const float of_group = group_sum(room, share[term]);
    if (item == 0) terms[part * TERMS + term] = of_group;
  }
}

/* ---- squared differences ---- */

/* Squares of huge and of tiny values are summed by themselves, scaled, for the reference's sums are in double: of
 * values beyond 2^40, of those within 2^-40, and of the rest (struct squares of slots_train.c). */
float4 scaled_square(float x) {
  const float size = fabs(x), huge = x * 0x1p-80f, tiny = x * 0x1p80f;
  if (size > 0x1p40f) return (float4)(0, huge * huge, 0, 0);
  if (size < 0x1p-40f) return (float4)(0, 0, tiny * tiny, 0);
  return (float4)(x * x, 0, 0, 0);
}

void write_squares(global float *squares, local float *room, float4 own) {
  const float usual = group_sum(room, own.x), huge = group_sum(room, own.y), tiny = group_sum(room, own.z);
  if (get_local_id(0) == 0) vstore3((float3)(usual, huge, tiny), get_group_id(0), squares);
}

/* squares: [PARTS][3], of moved - still; dmoved = factor (moved - still); all [n] */
SUMMING void smooth_loss(SPAN(float, squares), SPAN(float, dmoved), SPAN(const float, still), SPAN(const float, moved),
                         float factor, ulong n) {
  OPEN(float, squares);
  OPEN(float, dmoved);
  OPEN(const float, still);
  OPEN(const float, moved);
  local float room[GROUP];
  const ulong begin = min(get_group_id(0) * part_of(n), n), end = min(begin + part_of(n), n);
  float4 own = 0;
  for (ulong base = begin; base < end; base += GROUP) {
    const ulong i = base + get_local_id(0);
    if (i >= end) continue;
    const float difference = moved[i] - still[i];
    own += scaled_square(difference);
    dmoved[i] = factor * difference;
  }
  write_squares(squares, room, own);
}

/* squares: [PARTS][3], of pixel - truth; dpixel = factor (pixel - truth); [3] per ray */
SUMMING void mse(SPAN(float, squares), ROWS(float, dpixel), ROWS(const float, pixel), ROWS(const float, truth),
                 float factor, ulong n) {
  OPEN(float, squares);
  OPEN(float, dpixel);
  OPEN(const float, pixel);
  OPEN(const float, truth);
  local float room[GROUP];
  const ulong begin = min(get_group_id(0) * part_of(n), n), end = min(begin + part_of(n), n);
  float4 own = 0;
  for (ulong base = begin; base < end; base += GROUP) {
    const ulong r = base + get_local_id(0);
    if (r >= end) continue;
    for (uint c = 0; c < 3; c++) {
      const float difference = pixel[c * pixel_stride + r] - truth[c * truth_stride + r];
      own += scaled_square(difference);
      dpixel[c * dpixel_stride + r] = factor * difference;
    }
  }
  write_squares(squares, room, own);
}

/* short_of: [3], 1 - w of each key point, whose squares are the host's; anchors, danchors: [3][4], danchors accumulates
 */
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

/* Philox 4x32-10, as core/rng.h */
uint4 random_at(ulong seed, ulong step, uint index, uint purpose) {
  uint4 c = (uint4)((uint)step, (uint)(step >> 32), index, purpose);
  uint k0 = (uint)seed, k1 = (uint)(seed >> 32);
  for (int round = 0; round < 10; round++) {
    const uint low0 = 0xD2511F53u * c.x, high0 = mul_hi(0xD2511F53u, c.x);
    const uint low1 = 0xCD9E8D57u * c.z, high1 = mul_hi(0xCD9E8D57u, c.z);
    c = (uint4)(high1 ^ c.y ^ k0, low1, high0 ^ c.w ^ k1, low0);
    k0 += 0x9E3779B9u;
    k1 += 0xBB67AE85u;
  }
  return c;
}

/* uniform(-reach, reach), of 24 bits */
float offset_of(uint word, float reach) { return (2 * ((float)(word >> 8) * 0x1p-24f) - 1) * reach; }

/* moved, x: [3] per sample; `first` is the number of the first sample, `purpose` the fourth word of its counter */
kernel void smooth_points(ROWS(float, moved), ROWS(const float, x), float reach, ulong seed, ulong step, ulong first,
                          uint purpose, ulong n) {
  OPEN(float, moved);
  OPEN(const float, x);
  const ulong i = get_global_id(0);
  if (i >= n) return;
  const uint4 random = random_at(seed, step, (uint)(first + i), purpose);
  moved[i] = x[i] + offset_of(random.x, reach);
  moved[moved_stride + i] = x[x_stride + i] + offset_of(random.y, reach);
  moved[2 * moved_stride + i] = x[2 * x_stride + i] + offset_of(random.z, reach);
}
