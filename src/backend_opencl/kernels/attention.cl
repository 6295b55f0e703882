/* SPDX-License-Identifier: MIT
 * Region attention (paper eq. 6-8): region_c = v_c code_c, norm = sqrt(sum_c v_c^2), region_eye = eye * eye_attention. */

/* Loops over the samples of an item: vector k holds WIDTH of them, from i on. */
#define EACH_VECTOR(i, k)                                                                        \
  for (ulong k = 0, i = get_global_id(0) * ITEM; k < VECTORS && i < n; k++, i += WIDTH)

/* region: [channels] rows; v: as many rows, or one for all channels, or none (`values` is their number); norm,
 * region_eye, eye_attention: [n]; code: [channels]
 *
 * The reference sums the squares in double. Here the largest |v_c| selects one of three scale factors, so that no
 * square overflows and no significant square underflows. The sum is compensated: `lost` collects the rounding errors of
 * its products and additions. It is accurate to 2^-40, and the norm to one unit in the last place. */
KERNEL attention_fwd(ROWS(float, region), SPAN(float, norm), SPAN(float, region_eye), ROWS(const float, v),
                     SPAN(const float, code), SPAN(const float, eye_attention), float eye, uint channels, uint values,
                     ulong n) {
  OPEN(float, region);
  OPEN(float, norm);
  OPEN(float, region_eye);
  OPEN(const float, v);
  OPEN(const float, code);
  OPEN(const float, eye_attention);
  floatw most[VECTORS], sum[VECTORS], lost[VECTORS];
  for (uint k = 0; k < VECTORS; k++) most[k] = sum[k] = lost[k] = 0;
  for (uint c = 0; c < channels; c++) {
    const float weight = code[c];
    EACH_VECTOR(i, k) {
      const floatw value = loadw_first(v + (c < values ? c : 0) * v_stride + i, n - i);
      storew_first(region + c * region_stride + i, value * weight, n - i);
      most[k] = fmax(most[k], fabs(value));
    }
  }
  for (uint c = 0; c < values; c++) {
    EACH_VECTOR(i, k) {
      const floatw scale = WHERE(most[k] > 0x1p50f, 0x1p-70f, WHERE(most[k] < 0x1p-40f, 0x1p90f, 1));
      const floatw value = loadw_first(v + c * v_stride + i, n - i) * scale, square = value * value;
      const floatw next = sum[k] + square, taken = next - sum[k];
      lost[k] += (sum[k] - (next - taken)) + (square - taken) + fma(value, value, -square);
      sum[k] = next;
    }
  }
  EACH_VECTOR(i, k) {
    const floatw inverse = WHERE(most[k] > 0x1p50f, 0x1p70f, WHERE(most[k] < 0x1p-40f, 0x1p-90f, 1));
    /* where the sum is not finite, `lost` is NaN */
    if (norm) storew_first(norm + i, sqrt(WHERE(isfinite(sum[k]), sum[k] + lost[k], sum[k])) * inverse, n - i);
    if (region_eye && eye_attention) storew_first(region_eye + i, eye * loadw_first(eye_attention + i, n - i), n - i);
  }
}

/* v_c *= g(height): attention_ops.h */
KERNEL attention_fade(ROWS(float, v), SPAN(const float, height), float begin, float end, uint rows, ulong n) {
  OPEN(float, v);
  OPEN(const float, height);
  EACH_VECTOR(i, k) {
    const floatw t = fmin(fmax((loadw_first(height + i, n - i) - begin) / (end - begin), 0.0f), 1.0f);
    const floatw g = 1 - t * t * (3 - 2 * t);
    for (uint c = 0; c < rows; c++)
      storew_first(v + c * v_stride + i, g * loadw_first(v + c * v_stride + i, n - i), n - i);
  }
}

#define LANES 64 /* partial sums of a part */
#define PARTS 64 /* parts of the samples, as in attention.c */

/* sum[0] += all others, by pairwise halving; the order does not depend on the number of items. */
static inline void fold(float *sum) {
  for (uint half_of = LANES / 2; half_of > 0; half_of /= 2)
    for (uint k = 0; k < half_of; k++) sum[k] += sum[k + half_of];
}

/* dv_c = code_c dregion_c + dnorm v_c/norm, where v/norm is taken as 0 at v = 0; parts[c][p] = sum over the samples of
 * part p of dregion_c v_c. group = p*channels + c. Lane k of a part sums its samples k, k + LANES, .. With one v for
 * all channels (values 1) this kernel computes only the parts: dv is null, and attention_one_bwd computes it. */
KERNEL attention_bwd(ROWS(float, dv), SPAN(float, parts), ROWS(const float, dregion), SPAN(const float, dnorm),
                     ROWS(const float, v), SPAN(const float, norm), SPAN(const float, code), uint channels, uint values,
                     ulong n) {
  OPEN(float, dv);
  OPEN(float, parts);
  OPEN(const float, dregion);
  OPEN(const float, dnorm);
  OPEN(const float, v);
  OPEN(const float, norm);
  OPEN(const float, code);
  const uint c = (uint)get_group_id(0) % channels, part = (uint)get_group_id(0) / channels;
  const ulong units = (n + LANES - 1) / LANES;
  const ulong begin = units * part / PARTS * LANES, end = min(units * (part + 1) / PARTS * LANES, n);
  const float weight = code[c];
#if CPU
  floatw sum[LANES / WIDTH];
  for (uint k = 0; k < LANES / WIDTH; k++) sum[k] = 0;
#else
  local float sum[LANES];
  float own = 0;
#endif
  for (ulong first = begin; first < end; first += LANES) {
    for (ulong k = get_local_id(0); k < LANES / WIDTH; k += GROUP) {
      const ulong i = first + k * WIDTH;
      if (i >= end) break;
      const floatw value = loadw_first(v + (c < values ? c : 0) * v_stride + i, n - i);
      floatw gradient = 0;
      if (dregion) {
        const floatw dy = loadw_first(dregion + c * dregion_stride + i, n - i);
        gradient += weight * dy;
#if CPU
        sum[k] += dy * value;
#else
        own += dy * value;
#endif
      }
      if (dnorm) {
        const floatw length = loadw_first(norm + i, n - i), dy = loadw_first(dnorm + i, n - i);
        gradient = WHERE(length > 0, gradient + dy * (value / length), gradient);
      }
      if (dv) storew_first(dv + c * dv_stride + i, gradient, n - i);
    }
  }
  if (!parts) return;
#if CPU
  float lane[LANES];
  for (uint k = 0; k < LANES / WIDTH; k++) STOREW(sum[k], lane + k * WIDTH);
  fold(lane);
  parts[c * PARTS + part] = lane[0];
#else
  const uint item = get_local_id(0);
  sum[item] = own;
  for (uint half_of = LANES / 2; half_of > 0; half_of /= 2) {
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item < half_of) sum[item] += sum[item + half_of];
  }
  if (item == 0) parts[c * PARTS + part] = sum[0];
#endif
}

/* dv = sum_c code_c dregion_c + dnorm v/norm, of one v for all channels */
KERNEL attention_one_bwd(SPAN(float, dv), ROWS(const float, dregion), SPAN(const float, dnorm), SPAN(const float, v),
                         SPAN(const float, norm), SPAN(const float, code), uint channels, ulong n) {
  OPEN(float, dv);
  OPEN(const float, dregion);
  OPEN(const float, dnorm);
  OPEN(const float, v);
  OPEN(const float, norm);
  OPEN(const float, code);
  EACH_VECTOR(i, k) {
    floatw gradient = 0;
    for (uint c = 0; dregion && c < channels; c++)
      gradient += code[c] * loadw_first(dregion + c * dregion_stride + i, n - i);
    if (dnorm) {
      const floatw length = loadw_first(norm + i, n - i), dy = loadw_first(dnorm + i, n - i);
      gradient = WHERE(length > 0, gradient + dy * (loadw_first(v + i, n - i) / length), gradient);
    }
    storew_first(dv + i, gradient, n - i);
  }
}

/* dcode_c += sum of its parts; one item per channel */
kernel void attention_code_bwd(SPAN(float, dcode), SPAN(const float, parts), uint channels) {
  OPEN(float, dcode);
  OPEN(const float, parts);
  const uint c = get_global_id(0);
  if (c >= channels) return;
  float sum[PARTS];
  for (uint p = 0; p < PARTS; p++) sum[p] = parts[c * PARTS + p];
  fold(sum);
  dcode[c] += sum[0];
}

/* deye_attention += eye dregion_eye */
KERNEL attention_eye_bwd(SPAN(float, deye_attention), SPAN(const float, dregion_eye), float eye, ulong n) {
  OPEN(float, deye_attention);
  OPEN(const float, dregion_eye);
  EACH_VECTOR(i, k) {
    const floatw before = loadw_first(deye_attention + i, n - i);
    storew_first(deye_attention + i, before + eye * loadw_first(dregion_eye + i, n - i), n - i);
  }
}
