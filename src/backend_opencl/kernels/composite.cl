/* SPDX-License-Identifier: MIT
 * Volume rendering of the samples of a ray, and its gradient (paper eq. 1-2, docs/maths.md, Compositing). A work-item
 * takes RAYS rays one after the other.
 *
 * tau_i = sigma_i dt_i, alpha_i = 1 - exp(-tau_i), T_i = exp(-sum_{j<i} tau_j), w_i = alpha_i T_i. A sample counts
 * where the transmittance before it has not fallen below the stop, T_i >= stop; with stop < 1 the first one always
 * does. */

/* No product is fused with a sum, as in the reference: a colour at an end of its range must be there in both. */
#pragma OPENCL FP_CONTRACT OFF

#if WIDTH == 1
enum { RAYS = 1, KNOWN_AHEAD = 1 };
#else
enum { RAYS = 64, KNOWN_AHEAD = 512 };
#endif

/* alpha_i = -expm1(-tau_i) keeps its digits for thin samples; rest_i = 1 - alpha_i = exp(-tau_i) keeps them for dense
 * ones. Rays are short: on a CPU both are computed ahead, in vectors, for the samples [from, until) of several rays.
 * For a ray of more than KNOWN_AHEAD samples they are computed sample by sample. */
struct light {
  global const float *sigma, *dt;
  float alpha[KNOWN_AHEAD], rest[KNOWN_AHEAD];
  ulong from, until;
  bool ahead;
};

/* Call before the samples [begin, end) of a ray are read; `last` is the end of the item's samples. */
void look_ahead(struct light *light, ulong begin, ulong end, ulong last) {
  light->ahead = WIDTH > 1 && end - begin <= KNOWN_AHEAD;
  if (!light->ahead || end <= light->until) return;
  light->from = begin;
  light->until = min(begin + KNOWN_AHEAD, last);
  for (ulong i = begin; i < light->until; i += WIDTH) {
    const ulong count = light->until - i;
    const floatw tau = loadw_first(light->sigma + i, count) * loadw_first(light->dt + i, count);
    const floatw alpha = -expm1(-tau), rest = exp(-tau);
    STOREW(alpha, light->alpha + (i - begin));
    STOREW(rest, light->rest + (i - begin));
  }
}

float alpha_of(const struct light *light, ulong i) {
  return light->ahead ? light->alpha[i - light->from] : -expm1(-light->sigma[i] * light->dt[i]);
}
float rest_of(const struct light *light, ulong i) {
  return light->ahead ? light->rest[i - light->from] : exp(-light->sigma[i] * light->dt[i]);
}

/* colour + (1 - opacity) background, before the clamp */
float blend(float colour, float opacity, float background) { return colour + (1 - opacity) * background; }

/* pixel, colour, background: [3] per ray; opacity, depth, attention, eye, uncertainty: [n]; first: [n+1]; the rest per
 * sample. Null: an output is not wanted, an input is 0. */
kernel void composite_fwd(ROWS(float, pixel), ROWS(float, colour), SPAN(float, opacity), SPAN(float, depth),
                          SPAN(float, attention), SPAN(float, eye), SPAN(float, uncertainty), SPAN(const int, first),
                          SPAN(const float, sigma), SPAN(const float, dt), SPAN(const float, sample_depth),
                          SPAN(const float, sample_attention), SPAN(const float, sample_eye),
                          SPAN(const float, sample_uncertainty), ROWS(const float, rgb), ROWS(const float, background),
                          float stop, ulong n) {
  OPEN(float, pixel);
  OPEN(float, colour);
  OPEN(float, opacity);
  OPEN(float, depth);
  OPEN(float, attention);
  OPEN(float, eye);
  OPEN(float, uncertainty);
  OPEN(const int, first);
  OPEN(const float, sigma);
  OPEN(const float, dt);
  OPEN(const float, sample_depth);
  OPEN(const float, sample_attention);
  OPEN(const float, sample_eye);
  OPEN(const float, sample_uncertainty);
  OPEN(const float, rgb);
  OPEN(const float, background);
  struct light light = {.sigma = sigma, .dt = dt, .until = 0};
  const ulong ray = get_global_id(0) * RAYS, rays_end = min(ray + RAYS, n);
  for (ulong r = ray; r < rays_end; r++) {
    const ulong begin = first[r], end = first[r + 1];
    float transmittance = 1, sum = 0, far = 0, attended = 0, eyed = 0, unsure = 0;
    float sums[3] = {0, 0, 0};
    look_ahead(&light, begin, end, first[rays_end]);
    for (ulong i = begin; i < end; i++) {
      if (transmittance < stop) break;
      const float w = alpha_of(&light, i) * transmittance;
      for (uint c = 0; c < 3; c++) sums[c] += w * rgb[c * rgb_stride + i];
      sum += w;
      if (sample_depth) far += w * sample_depth[i];
      if (sample_attention) attended += sample_attention[i];
      if (sample_eye) eyed += sample_eye[i];
      if (sample_uncertainty) unsure += w * sample_uncertainty[i];
      transmittance *= rest_of(&light, i);
    }
    if (opacity) opacity[r] = sum;
    if (depth) depth[r] = far;
    if (attention) attention[r] = attended;
    if (eye) eye[r] = eyed;
    if (uncertainty) uncertainty[r] = unsure;
    for (uint c = 0; c < 3; c++) {
      if (colour) colour[c * colour_stride + r] = sums[c];
      if (!pixel) continue;
      const float value = blend(sums[c], sum, background[c * background_stride + r]);
      pixel[c * pixel_stride + r] = value < 0 ? 0 : value > 1 ? 1 : value;
    }
  }
}

/* dsigma, drgb ([3]), dsample_*: per sample; the others per ray. With dw_i = dL/dw_i:
 * dL/dtau_i = dw_i T_{i+1} - sum_{j>i} dw_j w_j. The sum is accumulated from the last sample backwards: no division by
 * 1 - alpha, and no difference of large sums. A clamped colour passes no gradient, and samples past the stop get
 * zeros. */
kernel void composite_bwd(SPAN(float, dsigma), ROWS(float, drgb), SPAN(float, dsample_attention),
                          SPAN(float, dsample_eye), SPAN(float, dsample_uncertainty), ROWS(const float, dpixel),
                          SPAN(const float, dopacity), SPAN(const float, dattention), SPAN(const float, deye),
                          SPAN(const float, duncertainty), ROWS(const float, colour), SPAN(const float, opacity),
                          SPAN(const int, first), SPAN(const float, sigma), SPAN(const float, dt),
                          SPAN(const float, sample_uncertainty), ROWS(const float, rgb), ROWS(const float, background),
                          float stop, ulong n) {
  OPEN(float, dsigma);
  OPEN(float, drgb);
  OPEN(float, dsample_attention);
  OPEN(float, dsample_eye);
  OPEN(float, dsample_uncertainty);
  OPEN(const float, dpixel);
  OPEN(const float, dopacity);
  OPEN(const float, dattention);
  OPEN(const float, deye);
  OPEN(const float, duncertainty);
  OPEN(const float, colour);
  OPEN(const float, opacity);
  OPEN(const int, first);
  OPEN(const float, sigma);
  OPEN(const float, dt);
  OPEN(const float, sample_uncertainty);
  OPEN(const float, rgb);
  OPEN(const float, background);
  struct light light = {.sigma = sigma, .dt = dt, .until = 0};
  const ulong ray = get_global_id(0) * RAYS, rays_end = min(ray + RAYS, n);
  for (ulong r = ray; r < rays_end; r++) {
    const float attended = dattention ? dattention[r] : 0, eyed = deye ? deye[r] : 0;
    const float unsure = duncertainty ? duncertainty[r] : 0;
    float dcolour[3], dsum = dopacity ? dopacity[r] : 0;
    for (uint c = 0; c < 3; c++) {
      const float behind = background[c * background_stride + r];
      const float value = blend(colour[c * colour_stride + r], opacity[r], behind);
      dcolour[c] = value >= 0 && value <= 1 ? dpixel[c * dpixel_stride + r] : 0;
      dsum -= dcolour[c] * behind;
    }

    /* dsigma[i] holds T_{i+1} until the backward loop overwrites it */
    const ulong begin = first[r], end = first[r + 1];
    float transmittance = 1;
    ulong counted = begin;
    look_ahead(&light, begin, end, first[rays_end]);
    for (; counted < end; counted++) {
      if (transmittance < stop) break;
      transmittance *= rest_of(&light, counted);
      dsigma[counted] = transmittance;
    }
    for (ulong i = counted; i < end; i++) {
      dsigma[i] = 0;
      for (uint c = 0; c < 3; c++) drgb[c * drgb_stride + i] = 0;
      if (dsample_attention) dsample_attention[i] = 0;
      if (dsample_eye) dsample_eye[i] = 0;
      if (dsample_uncertainty) dsample_uncertainty[i] = 0;
    }

    float behind = 0, after = transmittance; /* sum_{j>i} dw_j w_j; T_{i+1} */
    for (ulong i = counted; i-- > begin;) {
      const float before = i > begin ? dsigma[i - 1] : 1, w = alpha_of(&light, i) * before;
      float dw = dsum + unsure * (sample_uncertainty ? sample_uncertainty[i] : 0);
      for (uint c = 0; c < 3; c++) {
        dw += dcolour[c] * rgb[c * rgb_stride + i];
        drgb[c * drgb_stride + i] = dcolour[c] * w;
      }
      dsigma[i] = dt[i] * (dw * after - behind);
      if (dsample_attention) dsample_attention[i] = attended;
      if (dsample_eye) dsample_eye[i] = eyed;
      if (dsample_uncertainty) dsample_uncertainty[i] = unsure * w;
      behind += dw * w;
      after = before;
    }
  }
}
