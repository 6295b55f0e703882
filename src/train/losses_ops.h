/* SPDX-License-Identifier: MIT
 * Losses, value and gradient together (docs/maths.md, Losses of the head). */
#ifndef ERN_LOSSES_OPS_H
#define ERN_LOSSES_OPS_H

#include "core/operations.h"
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
  ERN_LOSS_PATCHES,
  ERN_LOSS_TERMS
} ern_loss_term;

/* s is the progress step/steps in [0, 1]; the other numbers are the factors of docs/maths.md before s. */
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
  double terms[ERN_LOSS_TERMS]; /* out, on the host, weights included; terms of other operations are not changed */
  ern_rows pixel, truth;        /* [3] per ray */
  ern_span opacity, attention, eye, uncertainty; /* real [n], of the composite */
  ern_span face;                                 /* real [n]: 1 in the box of the landmarks, else 0 */
  struct ern_loss_weights weights;
  int max_steps; /* the divisor of the eye term */
  size_t n;
};
#define ERN_COST_head_loss(a) ern_cost("ray", (a)->n, 60, 18, 0, 0)
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
 * batch; used only where weights->adaptive. */
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
#define ERN_COST_smooth_loss(a) ern_cost("sample", (a)->n, 4, 3, 0, 0)
/* n samples of a batch: their share of its term. */
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
#define ERN_COST_smooth_points(a) ern_cost("sample", (a)->n, 0, 0, 0, 0) /* its time is Philox's integer arithmetic */
typedef void ern_smooth_points_kernel(ern_real *moved, const ern_real *x, size_t stride, float reach, uint64_t seed,
                                      uint64_t step, size_t sample_begin, size_t n);

/* mean over rays and channels of (pixel - truth)^2. */
struct ern_mse_args {
  ern_rows dpixel; /* out (overwritten): [3] per ray */
  double term;     /* out, on the host */
  ern_rows pixel, truth;
  size_t n;
};
#define ERN_COST_mse(a) ern_cost("ray", (a)->n, 12, 9, 0, 0)
/* n rays of a batch: their share of its term. */
typedef double ern_mse_kernel(ern_real *dpixel, const ern_real *pixel, const ern_real *truth, size_t stride,
                              size_t batch, size_t n);

/* mean over the key points of (1 - w)^2, w the last coordinate; danchors accumulates. */
struct ern_key_points_loss_args {
  ern_span danchors; /* [3][4] */
  double term;       /* out, on the host */
  ern_span anchors;
};
#define ERN_COST_key_points_loss(a) ERN_COST_ELSEWHERE
typedef double ern_key_points_loss_kernel(ern_real *danchors, const ern_real *anchors);

enum { ERN_POSE_PARAMETERS = 6 };

/* Gradient of the loss by a small camera motion about the scene's origin, with rotation vector w (radians) and
 * translation m:
 * x -> x + w cross x + m, d -> d + w cross d, while the distances t stay as marched.
 *
 *   dL/dw = sum over samples of u (x cross dx + d cross dd),   dL/dm = sum of u dx */
struct ern_pose_bwd_args {
  double dpose[ERN_POSE_PARAMETERS]; /* out, on the host: dL/dw, dL/dm; valid after `synchronize` */
  ern_rows dx, x;                    /* [3] per sample */
  ern_rows dd, d;                    /* [3] per sample; zeroed: the colour does not depend on d */
  ern_span weight;                   /* u, real [n]; zeroed: 1 */
  size_t n;
};
#define ERN_COST_pose_bwd(a) ERN_COST_ELSEWHERE
/* Adds to dpose. dd, d NULL: none; weight NULL: 1. All rows at one stride each. */
typedef void ern_pose_bwd_kernel(double dpose[ERN_POSE_PARAMETERS], const ern_real *dx, size_t dx_stride,
                                 const ern_real *x, size_t x_stride, const ern_real *dd, size_t dd_stride,
                                 const ern_real *d, size_t d_stride, const ern_real *weight, size_t n);

ERN_DECLARE_KERNELS(ERN_LOSSES_OPERATIONS)

#endif
