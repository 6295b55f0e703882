/* SPDX-License-Identifier: MIT
 * Reference of the 1D convolutions. */
#include "mlp/conv1d_ref.h"

enum { KERNEL = 3 };

void ERN_REF(ern_conv1d_fwd)(ern_real *y, const ern_real *x, const ern_real *w, const ern_real *b,
                             const struct ern_conv1d *conv) {
  const int length = ern_conv1d_length(conv->length, conv->stride);
  for (int o = 0; o < conv->out; o++) {
    for (int t = 0; t < length; t++) {
      ern_real sum = b[o];
      for (int k = 0; k < KERNEL; k++) {
        const int at = t * conv->stride + k - 1;
        if (at < 0 || at >= conv->length) continue;
        const ern_real *from = x + (size_t)at * conv->time;
        const ern_real *weight = w + (size_t)o * (size_t)conv->in * KERNEL + k;
        for (size_t c = 0; c < (size_t)conv->in; c++) sum += weight[c * KERNEL] * from[c * conv->channel];
      }
      y[o * length + t] = sum;
    }
  }
}

/* db[o] += dy[o][t], dW[o][c][k] += dy[o][t] x[c][at], dx[c][at] += W[o][c][k] dy[o][t] with at = t*stride + k - 1 */
void ERN_REF(ern_conv1d_bwd)(ern_real *dx, ern_real *dw, ern_real *db, const ern_real *dy, const ern_real *x,
                             const ern_real *w, const struct ern_conv1d *conv) {
  const int length = ern_conv1d_length(conv->length, conv->stride);
  for (int o = 0; o < conv->out; o++) {
    for (int t = 0; t < length; t++) {
      const ern_real gradient = dy[o * length + t];
      db[o] += gradient;
      for (int k = 0; k < KERNEL; k++) {
        const int at = t * conv->stride + k - 1;
        if (at < 0 || at >= conv->length) continue;
        const size_t weight = (size_t)o * (size_t)conv->in * KERNEL + (size_t)k;
        for (size_t c = 0; c < (size_t)conv->in; c++) {
          const size_t input = c * conv->channel + (size_t)at * conv->time;
          dw[weight + c * KERNEL] += gradient * x[input];
          if (dx != NULL) dx[input] += gradient * w[weight + c * KERNEL];
        }
      }
    }
  }
}
