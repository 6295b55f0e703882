/* SPDX-License-Identifier: MIT
 * Volume rendering and its gradient for any instruction set (simd/isa.h).
 *
 * It makes two passes over groups of rays. The first is vectorised over samples, whichever ray they belong to, and
 * stores exp(-tau) and 1 - exp(-tau) of each. The second walks along each ray in the reference's order; only products
 * and sums are left for it. A training batch has two or three samples a ray, so with one ray a lane most lanes would be
 * idle. */
#include "backend_cpu/simd/isa.h"
#include "backend_cpu/simd/lanes_math.h"
#include "render/composite_ops.h"

/* The size of a group of rays; no marched ray has more samples. */
enum { COMPOSITE_SAMPLES = ERN_MAX_STEPS, COMPOSITE_RAYS = 512 };

struct ray_group {
  float alpha[COMPOSITE_SAMPLES + LANES];   /* 1 - exp(-tau) */
  float through[COMPOSITE_SAMPLES + LANES]; /* exp(-tau) */
  float colour[3][COMPOSITE_RAYS], opacity[COMPOSITE_RAYS];
};

/* The number of rays from r on that fit a group; 0: one ray's samples alone do not fit. */
static size_t rays_that_fit(const int32_t *first, size_t r, size_t n) {
  const size_t most = n - r < COMPOSITE_RAYS ? n : r + COMPOSITE_RAYS;
  size_t end = r;
  if (first[most] - first[r] <= COMPOSITE_SAMPLES) return most - r;
  while (first[end + 1] - first[r] <= COMPOSITE_SAMPLES) end++;
  return end - r;
}

/* The first pass over the samples of rays [r, r + rays). */
static void weigh(struct ray_group *hand, const struct ern_composite_view *v, size_t r, size_t rays) {
  const size_t begin = (size_t)v->first[r], count = (size_t)v->first[r + rays] - begin;
  for (size_t i = 0; i < count; i += LANES) {
    const size_t left = count - i < LANES ? count - i : LANES;
    const vf tau = vf_load_partial(v->sigma + begin + i, left) * vf_load_partial(v->dt + begin + i, left);
    vf expm1;
    const vf through = vf_exp_expm1(-tau, &expm1);
    vf_store(hand->through + i, through);
    vf_store(hand->alpha + i, -expm1);
  }
}

/* An optional array of a value a sample: index & mask is the sample, or 0, which reads a single 0. */
struct optional {
  const float *values;
  size_t mask;
};
static const float nothing = 0;

static inline struct optional optional(const float *values) {
  return values != NULL ? (struct optional){values, SIZE_MAX} : (struct optional){&nothing, 0};
}
static inline float at(struct optional of, size_t i) { return of.values[i & of.mask]; }
static inline void put(float *values, size_t i, float value) {
  if (values != NULL) values[i] = value;
}
/* Rounded as in the reference, so that both clamp the same channels. */
LANES_INLINE vf blend(vf colour, vf opacity, vf background) {
  return colour + vf_multiply_rounded(1 - opacity, background);
}

/* ---- forward ---- */

static void composite_rays(const struct ern_composite_view *v, struct ray_group *hand, size_t begin, size_t rays) {
  const size_t from = (size_t)v->first[begin];
  const struct optional depths = optional(v->sample_depth), attentions = optional(v->sample_attention),
                        eyes = optional(v->sample_eye), uncertainties = optional(v->sample_uncertainty);
  const float *const reds = v->rgb, *const greens = v->rgb + v->rgb_stride, *const blues = greens + v->rgb_stride;
  const float stop = v->transmittance_stop;
  for (size_t k = 0; k < rays; k++) {
    const size_t r = begin + k, end = (size_t)v->first[r + 1];
    float red = 0, green = 0, blue = 0, opacity = 0, depth = 0, attention = 0, eye = 0, uncertainty = 0;
    float transmittance = 1;
    for (size_t i = (size_t)v->first[r]; i < end; i++) {
      if (transmittance < stop) break;
      const float w = hand->alpha[i - from] * transmittance;
      red += w * reds[i];
      green += w * greens[i];
      blue += w * blues[i];
      opacity += w;
      depth += w * at(depths, i);
      attention += at(attentions, i);
      eye += at(eyes, i);
      uncertainty += w * at(uncertainties, i);
      transmittance *= hand->through[i - from];
    }
    hand->colour[0][k] = red;
    hand->colour[1][k] = green;
    hand->colour[2][k] = blue;
    hand->opacity[k] = opacity;
    put(v->depth, r, depth);
    put(v->attention, r, attention);
    put(v->eye, r, eye);
    put(v->uncertainty, r, uncertainty);
  }
}

/* Writes the wanted outputs: colours and opacities. */
static void put_rays(const struct ern_composite_view *v, const struct ray_group *hand, size_t begin, size_t rays) {
  for (size_t k = 0; k < rays; k += LANES) {
    const size_t count = rays - k < LANES ? rays - k : LANES, r = begin + k;
    const vf opacity = vf_load_partial(hand->opacity + k, count);
    if (v->opacity != NULL) vf_store_partial(v->opacity + r, opacity, count);
    for (size_t c = 0; c < 3; c++) {
      const size_t to = c * v->ray_stride + r;
      const vf colour = vf_load_partial(hand->colour[c] + k, count);
      if (v->colour != NULL) vf_store_partial(v->colour + to, colour, count);
      if (v->pixel == NULL) continue;
      const vf value = blend(colour, opacity, vf_load_partial(v->background + to, count));
      vf_store_partial(v->pixel + to, vf_clamp(value, 0, 1), count);
    }
  }
}

/* The view of a single ray. */
static struct ern_composite_view view_of_ray(const struct ern_composite_view *from, size_t r) {
  struct ern_composite_view v = *from;
  float **const out[] = {&v.pixel, &v.colour, &v.opacity, &v.depth, &v.attention, &v.eye, &v.uncertainty};
  for (size_t k = 0; k < sizeof out / sizeof *out; k++)
    if (*out[k] != NULL) *out[k] += r;
  if (v.background != NULL) v.background += r;
  v.first += r;
  return v;
}

void ERN_ISA(ern_composite_fwd)(const struct ern_composite_view *view, size_t n) {
  struct ray_group hand;
  for (size_t r = 0; r < n;) {
    const size_t rays = rays_that_fit(view->first, r, n);
    if (rays == 0) {
      const struct ern_composite_view lone = view_of_ray(view, r++);
      ern_composite_fwd_ref(&lone, 1);
      continue;
    }
    weigh(&hand, view, r, rays);
    composite_rays(view, &hand, r, rays);
    put_rays(view, &hand, r, rays);
    r += rays;
  }
}

/* ---- backward ---- */

/* For the rays of the group: hand->colour becomes dL/dcolour, hand->opacity dL/dopacity. */
static void gradients_of_rays(const struct ern_composite_bwd_view *v, struct ray_group *hand, size_t begin,
                              size_t rays) {
  const struct ern_composite_view *f = &v->forward;
  for (size_t k = 0; k < rays; k += LANES) {
    const size_t count = rays - k < LANES ? rays - k : LANES, r = begin + k;
    const vf opacity = vf_load_partial(f->opacity + r, count);
    vf dopacity = v->dopacity != NULL ? vf_load_partial(v->dopacity + r, count) : (vf){0};
    for (size_t c = 0; c < 3; c++) {
      const size_t from = c * f->ray_stride + r;
      const vf background = vf_load_partial(f->background + from, count);
      const vf value = blend(vf_load_partial(f->colour + from, count), opacity, background);
      const vf dcolour = vf_select((value >= 0) & (value <= 1), vf_load_partial(v->dpixel + from, count), (vf){0});
      dopacity -= dcolour * background;
      vf_store_partial(hand->colour[c] + k, dcolour, count);
    }
    vf_store_partial(hand->opacity + k, dopacity, count);
  }
}

/* Writes zero gradients to the samples past the stop. */
static void clear_samples(const struct ern_composite_bwd_view *v, size_t begin, size_t end) {
  for (size_t i = begin; i < end; i++) {
    v->dsigma[i] = 0;
    for (size_t c = 0; c < 3; c++) v->drgb[c * v->forward.rgb_stride + i] = 0;
    put(v->dsample_attention, i, 0);
    put(v->dsample_eye, i, 0);
    put(v->dsample_uncertainty, i, 0);
  }
}

/* dL/dtau_i = dw_i T_{i+1} - sum_{j>i} dw_j w_j, as in the reference; on the forward walk hand->alpha becomes the
 * weight w and hand->through becomes T_{i+1}. */
static void composite_rays_bwd(const struct ern_composite_bwd_view *v, struct ray_group *hand, size_t begin,
                               size_t rays) {
  const struct ern_composite_view *f = &v->forward;
  const size_t from = (size_t)f->first[begin], stride = f->rgb_stride;
  const struct optional uncertainties = optional(f->sample_uncertainty), dattentions = optional(v->dattention),
                        deyes = optional(v->deye), duncertainties = optional(v->duncertainty);
  for (size_t k = 0; k < rays; k++) {
    const size_t r = begin + k, ray_begin = (size_t)f->first[r], ray_end = (size_t)f->first[r + 1];
    if (ray_begin == ray_end) continue;
    const float dred = hand->colour[0][k], dgreen = hand->colour[1][k], dblue = hand->colour[2][k];
    const float dopacity = hand->opacity[k], duncertainty = at(duncertainties, r);
    const float dattention = at(dattentions, r), deye = at(deyes, r);
    float transmittance = 1;
    size_t counted = ray_begin;
    for (; counted < ray_end; counted++) {
      if (transmittance < f->transmittance_stop) break;
      hand->alpha[counted - from] *= transmittance;
      transmittance *= hand->through[counted - from];
      hand->through[counted - from] = transmittance;
    }
    if (counted < ray_end) clear_samples(v, counted, ray_end);
    float behind = 0; /* sum_{j>i} dw_j w_j */
    for (size_t i = counted; i-- > ray_begin;) {
      const float w = hand->alpha[i - from], *rgb = f->rgb + i;
      float *drgb = v->drgb + i;
      const float dw = dopacity + duncertainty * at(uncertainties, i) + dred * rgb[0] + dgreen * rgb[stride] +
                       dblue * rgb[2 * stride];
      drgb[0] = dred * w;
      drgb[stride] = dgreen * w;
      drgb[2 * stride] = dblue * w;
      v->dsigma[i] = f->dt[i] * (dw * hand->through[i - from] - behind);
      put(v->dsample_attention, i, dattention);
      put(v->dsample_eye, i, deye);
      put(v->dsample_uncertainty, i, duncertainty * w);
      behind += dw * w;
    }
  }
}

void ERN_ISA(ern_composite_bwd)(const struct ern_composite_bwd_view *view, size_t n) {
  struct ray_group hand;
  for (size_t r = 0; r < n;) {
    const size_t rays = rays_that_fit(view->forward.first, r, n);
    if (rays == 0) {
      struct ern_composite_bwd_view lone = *view;
      lone.forward = view_of_ray(&view->forward, r);
      const float **const in[] = {&lone.dpixel, &lone.dopacity, &lone.dattention, &lone.deye, &lone.duncertainty};
      for (size_t k = 0; k < sizeof in / sizeof *in; k++)
        if (*in[k] != NULL) *in[k] += r;
      ern_composite_bwd_ref(&lone, 1);
      r++;
      continue;
    }
    weigh(&hand, &view->forward, r, rays);
    gradients_of_rays(view, &hand, r, rays);
    composite_rays_bwd(view, &hand, r, rays);
    r += rays;
  }
}
