/* SPDX-License-Identifier: MIT
 * Region attention: how much the audio code and the eye value count at a point (paper eq. 6-8). */
#ifndef ERN_ATTENTION_OPS_H
#define ERN_ATTENTION_OPS_H

#include "core/operations.h"
#include "core/types.h"

/* region = v * code by channel; norm = |v|_2; region_eye = eye * eye_attention. */
struct ern_attention_fwd_args {
  ern_rows region;        /* out: [A] per sample */
  ern_span norm;          /* out: real [n] */
  ern_span region_eye;    /* out: real [n]; zeroed: no eye branch */
  ern_rows v;             /* [A] per sample, or [1] for all channels; zeroed with region and norm: only the eye */
  ern_span code;          /* real [A] */
  ern_span eye_attention; /* real [n] in (0, 1); zeroed: no eye branch */
  float eye;
  size_t n;
};
#define ERN_COST_attention_fwd(a) ern_cost("sample", (a)->n, 3 * ERN_AUDIO_CODE + 2, 2 * ERN_AUDIO_CODE + 3, 0, 0)
struct ern_attention_bwd_args {
  ern_rows dv;                           /* out, overwritten */
  ern_span dcode;                        /* accumulates; zeroed: not wanted (the smoothness term detaches the code) */
  ern_span deye_attention;               /* accumulates; zeroed: no eye branch */
  ern_rows dregion;                      /* zeroed: none */
  ern_span dnorm;                        /* zeroed: none; at v = 0 the gradient of the norm is 0 */
  ern_span dregion_eye;                  /* zeroed: none */
  struct ern_attention_fwd_args forward; /* with norm as the forward pass left it */
};
#define ERN_COST_attention_bwd(a) \
  ern_cost("sample", (a)->forward.n, 5 * ERN_AUDIO_CODE + 3, 3 * ERN_AUDIO_CODE + 5, 0, 0)

/* The voice of a head ends at a height: v_c *= g(height), forward, and dv_c *= g(height), backward. With t =
 * (height - fade[0])/(fade[1] - fade[0]), g is 1 for t <= 0, 0 for t >= 1, else 1 - t^2 (3 - 2t). fade[0] < fade[1]. */
struct ern_attention_fade_args {
  ern_rows v; /* in and out: [A] per sample */
  ern_span height;
  float fade[2];
  size_t n;
};
#define ERN_COST_attention_fade(a) ern_cost("sample", (a)->n, ERN_AUDIO_CODE + 9, 2 * ERN_AUDIO_CODE + 1, 0, 0)

/* Kernels on n samples; NULL where a span is zeroed. dcode [A] accumulates. `stride` is that of v, dv, region and
 * dregion alike. shape: rows of the region, and of v: as many, 1, or 0. */
struct ern_attention_shape {
  int channels, values;
};
typedef void ern_attention_fwd_kernel(ern_real *region, ern_real *norm, ern_real *region_eye, const ern_real *v,
                                      const ern_real *code, const ern_real *eye_attention, ern_real eye,
                                      struct ern_attention_shape shape, size_t stride, size_t n);
typedef void ern_attention_bwd_kernel(ern_real *dv, ern_real *dcode, ern_real *deye_attention, const ern_real *dregion,
                                      const ern_real *dnorm, const ern_real *dregion_eye, const ern_real *v,
                                      const ern_real *norm, const ern_real *code, ern_real eye,
                                      struct ern_attention_shape shape, size_t stride, size_t n);

typedef void ern_attention_fade_kernel(ern_real *v, const ern_real *height, const float fade[2], int rows,
                                       size_t stride, size_t n);

ERN_DECLARE_KERNELS(ERN_ATTENTION_OPERATIONS)

#endif
