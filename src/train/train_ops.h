/* SPDX-License-Identifier: MIT
 * Losses (value and gradient together), AdamW, the moving average (model.md section 6). */
#ifndef ERN_TRAIN_OPS_H
#define ERN_TRAIN_OPS_H

#include "core/types.h"

typedef enum ern_loss_term {
  ERN_LOSS_PHOTOMETRIC,
  ERN_LOSS_UNCERTAINTY,
  ERN_LOSS_STATIC_UNCERTAINTY,
  ERN_LOSS_ENTROPY,
  ERN_LOSS_AUDIO_AMBIENT,
  ERN_LOSS_EYE_AMBIENT,
  ERN_LOSS_SMOOTHNESS,
  ERN_LOSS_KEY_POINTS,
  ERN_LOSS_TERMS
} ern_loss_term;

/* s is the progress step/steps in [0, 1]; the other numbers are the factors of model.md section 6 before s. */
struct ern_loss_weights {
  float s;
  float uncertainty;        /* 1 */
  float static_uncertainty; /* 1e-3 */
  float entropy;            /* 1e-4 */
  float audio_ambient;      /* 1e-4 */
  float eye_ambient;        /* 1e-4 */
  float smoothness;         /* 1e-5 */
  bool adaptive; /* photometric weight by uncertainty: 0.2 + 0.8*clamp((1-s) + s*R*softmax(u), 0, 10); else 1 */
};

/* All means run over all n rays. */
struct ern_head_loss_args {
  ern_rows dpixel;                                   /* out (overwritten): [3] per ray */
  ern_span dopacity, dattention, deye, duncertainty; /* out: real [n]; deye zeroed where there is no eye branch */
  double
      terms[ERN_LOSS_TERMS]; /* out, on the host, weights included; the terms that are not this op's are left alone */
  ern_rows pixel, truth;     /* [3] per ray */
  ern_span opacity, attention, eye, uncertainty; /* real [n], of the composite */
  ern_span face;                                 /* real [n]: 1 in the box of the landmarks, else 0 */
  struct ern_loss_weights weights;
  int max_steps; /* the divisor of the eye term */
  size_t n;
};
/* softmax(u)_r = exp(u_r - most)/sum, sum = sum_k exp(u_k - most). */
struct ern_softmax {
  ern_real most;
  double sum;
};
/* Of n rays; of none: most = -infinity, sum = 0. */
typedef struct ern_softmax ern_head_softmax_kernel(const ern_real *uncertainty, size_t n);

/* With pointers; eye and deye may be NULL. */
struct ern_head_loss_view {
  ern_real *dpixel, *dopacity, *dattention, *deye, *duncertainty;
  const ern_real *pixel, *truth, *opacity, *attention, *eye, *uncertainty, *face;
  size_t stride; /* of dpixel, pixel and truth */
};
/* n rays of a batch: their share of the terms of the whole batch, sums in double in ray order. softmax: of the whole
 * batch; looked at where weights->adaptive. */
typedef void ern_head_loss_kernel(double terms[ERN_LOSS_TERMS], const struct ern_head_loss_view *view,
                                  const struct ern_loss_weights *weights, int max_steps,
                                  const struct ern_softmax *softmax, size_t batch, size_t n);

/* weight * s * mean((moved - still)^2) for each of three quantities; gradient by the moved one only. */
struct ern_smooth_loss_args {
  ern_span dmoved;       /* out (overwritten): real [n] */
  double term;           /* out, on the host */
  ern_span still, moved; /* real [n] */
  float weight;          /* smoothness * s */
  size_t batch;          /* samples that the mean runs over: these and others */
  size_t n;
};
/* n of a batch: their share of its term. */
typedef double ern_smooth_loss_kernel(ern_real *dmoved, const ern_real *still, const ern_real *moved, float weight,
                                      size_t batch, size_t n);

/* Points moved by uniform(-1e-3, 1e-3) an axis: Philox (seed, step, sample, ERN_RNG_SMOOTH), words 0, 1, 2. */
struct ern_smooth_points_args {
  ern_rows moved; /* out: [3] per sample */
  ern_rows x;
  float reach; /* 1e-3 */
  uint64_t seed, step;
  size_t first; /* number of the first sample */
  size_t n;
};
typedef void ern_smooth_points_kernel(ern_real *moved, const ern_real *x, size_t stride, float reach, uint64_t seed,
                                      uint64_t step, size_t sample_begin, size_t n);

/* mean over rays and channels of (pixel - truth)^2. */
struct ern_mse_args {
  ern_rows dpixel; /* out (overwritten): [3] per ray */
  double term;     /* out, on the host */
  ern_rows pixel, truth;
  size_t n;
};
/* n rays of a batch: their share of its term. */
typedef double ern_mse_kernel(ern_real *dpixel, const ern_real *pixel, const ern_real *truth, size_t stride,
                              size_t batch, size_t n);

/* mean over the key points of (1 - w)^2, w the last coordinate; danchors accumulates. */
struct ern_key_points_loss_args {
  ern_span danchors; /* [3][4] */
  double term;       /* out, on the host */
  ern_span anchors;
};
typedef double ern_key_points_loss_kernel(ern_real *danchors, const ern_real *anchors);

/* AdamW with beta1 = 0, so that the first moment is the gradient and is not kept (Loshchilov and Hutter 2019):
 * p -= rate*decay*p; v = beta2*v + (1-beta2)*g^2; p -= rate*g/(sqrt(v/(1 - beta2^step)) + eps). */
struct ern_adamw_args {
  ern_span parameters, second_moment; /* in and out: real [n] */
  ern_span gradient;
  float rate, decay, beta2, eps;
  uint64_t step; /* of this update, from 1 */
  size_t n;
};
typedef void ern_adamw_kernel(ern_real *parameters, ern_real *second_moment, const ern_real *gradient, float rate,
                              float decay, float beta2, float eps, double bias_correction, size_t n);

/* average += (1 - decay)*(parameters - average) */
struct ern_ema_args {
  ern_span average; /* in and out */
  ern_span parameters;
  float decay;
  size_t n;
};
typedef void ern_ema_kernel(ern_real *average, const ern_real *parameters, float decay, size_t n);

/* Whether all values are finite. */
struct ern_finite_args {
  ern_span values;
  size_t n;
  bool finite; /* out, on the host */
};
typedef bool ern_finite_kernel(const ern_real *values, size_t n);

/* ---- fused: the head's density at points, and a whole step of the head, forward and backward ---- */

struct ern_field;
struct ern_view;
struct ern_march_settings;

struct ern_profile;
struct ern_head_density_args {
  ern_span sigma; /* out: real [n] */
  ern_rows x;     /* [3] per point */
  ern_span parameters;
  const struct ern_field *field;
  ern_span code; /* real [A], the audio code */
  float eye_value;
  size_t n;
};

struct ern_head_step_args {
  ern_span dparameters;         /* accumulates, the whole block */
  double terms[ERN_LOSS_TERMS]; /* out, on the host, weights included */
  size_t samples;               /* out, on the host */
  double squared_error;         /* out, on the host: mean over rays and channels of (pixel - truth)^2, unweighted */
  ern_span parameters;
  const struct ern_field *field;
  const struct ern_view *view;
  const struct ern_march_settings *settings;
  ern_span bits;
  ern_span pixel_number;      /* int32 [n] */
  ern_span jitter;            /* real [n]; zeroed: none */
  ern_rows truth, background; /* [3] per ray */
  ern_span face;              /* real [n] */
  ern_span windows;           /* real [8][window_length][width] */
  float eye_value;
  size_t individual; /* row of the individual codes */
  struct ern_loss_weights weights;
  float transmittance_stop;
  bool smooth; /* with the smoothness term */
  const float
      *smooth_offsets; /* recorded offsets [samples][3], on the host, to repeat another program's step; NULL: Philox */
  uint64_t seed, step;
  struct ern_profile *profile; /* added to; NULL: not wanted. Filled by fused passes alone */
  size_t n;                    /* rays */
};

/* ---- and of the torso ---- */

struct ern_torso_step_args {
  ern_span dparameters;
  double terms[ERN_LOSS_TERMS]; /* photometric and key points */
  size_t samples;               /* pixels inside the torso's occupancy */
  ern_span parameters;
  const struct ern_field *field;
  const struct ern_view *view;
  ern_span grid; /* the torso's occupancy */
  float threshold, shrink;
  ern_span pixel_number;
  ern_rows truth, background;
  size_t individual;
  size_t n;
};

#endif
