/* SPDX-License-Identifier: MIT
 * Renders rays to pixels in one fused pass. */
#ifndef ERN_RENDER_OPS_H
#define ERN_RENDER_OPS_H

#include "core/types.h"
#include "render/march_ops.h"

struct ern_field;
struct ern_profile;

/* Prepares a model on a stream: a fast backend lays out weights and tables for its fused pass, and keeps them from
 * frame to frame. Call it before render_rays, and again when the parameters have changed. */
struct ern_render_prepare_args {
  ern_span parameters;
  const struct ern_field *field;
};
#define ERN_COST_render_prepare(a) ERN_COST_ELSEWHERE

/* Marches n rays, evaluates the field and composites; keeps only the outputs. All rays share the frame's audio code,
 * eye value and individual code. */
struct ern_render_rays_args {
  ern_rows pixel;                 /* out: [3] per ray, over the background, clamped */
  ern_rows colour;                /* out: [3] per ray, sum w rgb; zeroed: not wanted */
  ern_span opacity;               /* out: real [n] */
  ern_span depth, attention, eye; /* out: real [n] */
  ern_span pixel_number;          /* int32 [n] */
  ern_span wanted;                /* byte [n]; 0: the ray may be left out, as one without samples; zeroed: none may */
  struct ern_view view;
  ern_rows background; /* [3] per ray */
  ern_span bits;
  ern_span parameters;
  const struct ern_field *field;
  ern_span code; /* real [A], the audio code */
  float eye_value;
  size_t individual; /* row of the individual codes */
  struct ern_march_settings settings;
  float transmittance_stop;
  struct ern_profile *profile; /* added to; NULL: not wanted. The CPU's fused passes count everything, stages only
                                  pixels and samples, a device nothing */
  size_t n;
};
#define ERN_COST_render_rays(a) ERN_COST_ELSEWHERE

/* Density at points. */
struct ern_head_density_args {
  ern_span sigma; /* out: real [n] */
  ern_rows x;     /* [3] per point */
  ern_span parameters;
  const struct ern_field *field;
  ern_span code; /* real [A], the audio code */
  float eye_value;
  bool bf16; /* products in bf16, sums in float; only where the backend trains_bf16 and the head is the paper's own */
  size_t n;
  size_t at_once; /* points that go through a stage together; 0: as many as suit the cache of a CPU */
};
#define ERN_COST_head_density(a) ERN_COST_ELSEWHERE

#endif
