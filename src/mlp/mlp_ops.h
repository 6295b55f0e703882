/* SPDX-License-Identifier: MIT
 * Fully connected stacks without biases, ReLU between layers (paper section 3.3). */
#ifndef ERN_MLP_OPS_H
#define ERN_MLP_OPS_H

#include "core/operations.h"
#include "core/types.h"

/* y = W[layers-1] relu( ... relu(W[0] x)), W[l] is [width[l+1]][width[l]], row-major, as torch.nn.Linear stores it. */
struct ern_mlp {
  int layers;
  int width[ERN_MLP_MAX_LAYERS + 1];
  size_t weight[ERN_MLP_MAX_LAYERS]; /* first element of W[l], counted from the start of the parameter block; ascending,
                                        the layers of one MLP are contiguous */
};

/* The input is the concatenation of `pieces` row groups; the rows add up to width[0]. */
struct ern_mlp_fwd_args {
  ern_rows y; /* out: [width[layers]] per sample */
  ern_rows x[ERN_MAX_PIECES];
  int pieces;
  ern_span ray;        /* int32 [n], the ray of each sample; needed where a piece is ERN_PER_RAY */
  ern_span parameters; /* the whole block */
  struct ern_mlp mlp;
  size_t n;
};
#define ERN_COST_mlp_fwd(a) ERN_COST_ELSEWHERE

/* The backward pass recomputes hidden values: a third more arithmetic, but memory does not grow with the depth. */
struct ern_mlp_bwd_args {
  ern_rows dx[ERN_MAX_PIECES]; /* accumulates; zeroed: not wanted. ERN_PER_RAY pieces have no gradient. */
  ern_span dparameters;        /* the whole block, accumulates */
  ern_rows dy;
  struct ern_mlp_fwd_args forward; /* y is not used */
};
#define ERN_COST_mlp_bwd(a) ERN_COST_ELSEWHERE

/* Kernels. scratch: ern_mlp_scratch(mlp) reals of the caller's, 64-byte aligned. A PER_SAMPLE view points at the first
 * of the n samples; `ray` likewise. dx of a PER_BATCH piece is the sum over the n samples, accumulated. */
typedef void ern_mlp_fwd_kernel(ern_real *y, size_t y_stride, const struct ern_rows_view *x, int pieces,
                                const int32_t *ray, const ern_real *parameters, const struct ern_mlp *mlp, size_t n,
                                ern_real *scratch);
typedef void ern_mlp_bwd_kernel(const struct ern_rows_view *dx, ern_real *dparameters, const ern_real *dy,
                                size_t dy_stride, const struct ern_rows_view *x, int pieces, const int32_t *ray,
                                const ern_real *parameters, const struct ern_mlp *mlp, size_t n, ern_real *scratch);

ERN_DECLARE_KERNELS(ERN_MLP_OPERATIONS)

#endif
