/* SPDX-License-Identifier: MIT
 * Fully connected stacks without biases, ReLU between layers (paper section 3.3), output activations, and positional
 * encodings. */
#ifndef ERN_MLP_OPS_H
#define ERN_MLP_OPS_H

#include "core/types.h"

/* y = W[layers-1] relu( ... relu(W[0] x)), W[l] is [width[l+1]][width[l]], row-major, as torch.nn.Linear stores it. */
struct ern_mlp {
  int layers;
  int width[ERN_MLP_MAX_LAYERS + 1];
  size_t weight[ERN_MLP_MAX_LAYERS]; /* first element of W[l], counted from the start of the parameter block;
                                        ascending, the layers of one MLP lie behind each other */
};

/* The input is the concatenation of `pieces` row groups; the rows add up to width[0]. */
struct ern_mlp_args {
  ern_rows y; /* out: [width[layers]] per sample */
  ern_rows x[ERN_MAX_PIECES];
  int pieces;
  ern_span ray;        /* int32 [n], the ray of each sample; needed where a piece is ERN_PER_RAY */
  ern_span parameters; /* the whole block */
  struct ern_mlp mlp;
  size_t n;
};

/* Hidden values are computed again, not kept: a third more arithmetic, and memory that does not grow with the depth. */
struct ern_mlp_bwd_args {
  ern_rows dx[ERN_MAX_PIECES]; /* accumulates; zeroed: not wanted. ERN_PER_RAY pieces have no gradient. */
  ern_span dparameters;        /* the whole block, accumulates */
  ern_rows dy;
  struct ern_mlp_args forward; /* y is not looked at */
};

/* Kernels. scratch: ern_mlp_scratch(mlp) reals of the caller's, 64-byte aligned. A PER_SAMPLE view points at the first
 * of the n samples; `ray` likewise. dx of a PER_BATCH piece is the sum over the n samples, accumulated. */
typedef void ern_mlp_fwd_kernel(ern_real *y, size_t y_stride, const struct ern_rows_view *x, int pieces,
                                const int32_t *ray, const ern_real *parameters, const struct ern_mlp *mlp, size_t n,
                                ern_real *scratch);
typedef void ern_mlp_bwd_kernel(const struct ern_rows_view *dx, ern_real *dparameters, const ern_real *dy,
                                size_t dy_stride, const struct ern_rows_view *x, int pieces, const int32_t *ray,
                                const ern_real *parameters, const struct ern_mlp *mlp, size_t n, ern_real *scratch);

typedef enum ern_activation {
  ERN_ACT_DENSITY,  /* exp(min(x, 80)); dx = dy * exp(clamp(x, -15, 15)): the gradient is clamped on purpose */
  ERN_ACT_COLOUR,   /* 1.002/(1 + exp(-x)) - 0.001 */
  ERN_ACT_SIGMOID,  /* 1/(1 + exp(-x)) */
  ERN_ACT_SOFTPLUS, /* log(1 + exp(x)), without overflow */
  ERN_ACT_RELU      /* max(x, 0); no gradient at 0, so that y serves the backward pass as well as x */
} ern_activation;

struct ern_activate_args {
  ern_rows y; /* out; may be the same rows as x */
  ern_rows x;
  ern_activation kind;
  size_t n;
};
struct ern_activate_bwd_args {
  ern_rows dx; /* overwritten; may be the same rows as dy */
  ern_rows dy;
  ern_rows x; /* the input of the forward pass */
  ern_activation kind;
  size_t n;
};
typedef void ern_activate_fwd_kernel(ern_real *y, const ern_real *x, ern_activation kind, size_t n);
typedef void ern_activate_bwd_kernel(ern_real *dx, const ern_real *dy, const ern_real *x, ern_activation kind,
                                     size_t n);

/* Real spherical harmonics of degrees 0..3 of unit directions; 16 rows. */
struct ern_sh_args {
  ern_rows y; /* out: [16], per ray or per sample as d is */
  ern_rows d; /* [3] */
  size_t n;
};
typedef void ern_sh_kernel(ern_real *y, size_t y_stride, const ern_real *d, size_t d_stride, size_t n);

/* Rows: x (dims), then for octave o = 0 .. octaves-1: sin(2^o x) (dims), sin(2^o x + pi/2) (dims). */
struct ern_freq_args {
  ern_rows y; /* out: [dims*(1 + 2*octaves)] */
  ern_rows x; /* [dims] */
  int octaves;
  size_t n;
};
struct ern_freq_bwd_args {
  ern_rows dx; /* accumulates */
  ern_rows dy, x;
  int octaves;
  size_t n;
};
typedef void ern_freq_fwd_kernel(ern_real *y, size_t y_stride, const ern_real *x, size_t x_stride, int dims,
                                 int octaves, size_t n);
typedef void ern_freq_bwd_kernel(ern_real *dx, size_t dx_stride, const ern_real *dy, size_t dy_stride,
                                 const ern_real *x, size_t x_stride, int dims, int octaves, size_t n);

#endif
