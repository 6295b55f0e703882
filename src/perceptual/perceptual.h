/* SPDX-License-Identifier: MIT
 * libernerf-perceptual: the perceptual distance of two pictures by the features of a convolutional network (LPIPS), and
 * its gradient, by oneDNN. libernerf-media loads it on first use, so that other programs do not load oneDNN. It does
 * not depend on libernerf: it reports an error as a status and a text. */
#ifndef ERN_PERCEPTUAL_PERCEPTUAL_H
#define ERN_PERCEPTUAL_PERCEPTUAL_H

#include "ernerf/base.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { ERN_PERCEPTUAL_LAYERS = 16, ERN_PERCEPTUAL_WORDS = 512 };

/* y = max(0, W * x + b), where x is the output of the previous layer. With `pool`, x is first max-pooled over windows
 * of pool x pool pixels with stride 2. */
struct ern_perceptual_layer {
  const float *weight;                      /* [out][in][size][size] */
  const float *bias;                        /* [out] */
  const float *head;                        /* w [out] of the distance; NULL: the layer's features are not compared */
  int in, out, size, stride, padding, pool; /* pool 0: none */
};

/* Not thread-safe: one thread at a time uses a network. It computes on that thread alone. */
struct ern_perceptual_network;

/* The functions of the library. A function that fails writes an error text to `words`. */
struct ern_perceptual {
  const char *version; /* ERN_INTERFACE_VERSION */
  const char *onednn;  /* "2.6.3" */
  /* Copies the weights. `in` of the first layer is 3, of each other one the `out` before it. */
  ern_status (*open)(const struct ern_perceptual_layer *layer, int layers, struct ern_perceptual_network **network,
                     char words[ERN_PERCEPTUAL_WORDS]);
  /* Of pictures [3][height][width], red, green, blue in 0..1, which enter the first layer as ((2v - 1) - shift)/scale:
   *
   *   distance = sum over compared layers of mean over pixels of sum_c w_c (f_c/(|f| + 1e-10) - g_c/(|g| + 1e-10))^2
   *
   * f, g: the layer's features of picture and truth at a pixel; |.| their L2 norm over channels; Zhang et al. 2018,
   * "The Unreasonable Effectiveness of Deep Features as a Perceptual Metric", equation 1, version 0.1. gradient: d
   * distance/d picture [3][height][width], overwritten; NULL: not wanted. ERN_E_ARGUMENT: a picture that is too small
   * for a layer. */
  ern_status (*distance)(struct ern_perceptual_network *network, const float *picture, const float *truth, int width,
                         int height, double *distance, float *gradient, char words[ERN_PERCEPTUAL_WORDS]);
  void (*free)(struct ern_perceptual_network *network); /* accepts NULL */
};

/* The only exported symbol. */
extern ERN_API const struct ern_perceptual ern_perceptual;

#ifdef __cplusplus
}
#endif
#endif
