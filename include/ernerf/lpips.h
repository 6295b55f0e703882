/* SPDX-License-Identifier: MIT
 * libernerf-media: LPIPS, how different two pictures look, with weights that the user brings. Version 0.1 of Zhang et
 * al., "The Unreasonable Effectiveness of Deep Features as a Perceptual Metric" (CVPR 2018). */
#ifndef ERNERF_LPIPS_H
#define ERNERF_LPIPS_H

#include "ernerf/base.h"
#include "ernerf/train.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct ern_lpips ern_lpips; /* one thread at a time */

/* network: AlexNet or VGG16 as torchvision stores it (tensors features.N.weight, features.N.bias), which of the two the
 * tensors say. heads: the weights of its channels as LPIPS stores them (lin0.model.1.weight to lin4.model.1.weight).
 * Either a .pth file, also of before PyTorch 1.6, or a .safetensors file. On success the caller owns *lpips.
 * Computed by libernerf-perceptual, which is loaded for it; ERN_E_UNSUPPORTED where it is not there. ERN_E_SHAPE,
 * ERN_E_MISSING, ERN_E_NONFINITE: not the weights of such a network; the error names file and tensor. */
ERN_API ERN_NODISCARD ern_status ern_lpips_open(ern_lpips **lpips, ern_context *context, const char *network,
                                                const char *heads);
ERN_API void ern_lpips_free(ern_lpips **lpips); /* accepts NULL and a pointer to NULL */

/* "lpips-alexnet" or "lpips-vgg16"; lives as long as `lpips`. */
ERN_API const char *ern_lpips_name(const ern_lpips *lpips);

/* Pictures [3][height][width], red, green, blue, 0..1; at least 31 pixels a side with AlexNet, 16 with VGG16. *distance
 * is 0 for equal pictures and larger the less alike they look; it has no unit. dpicture: d distance/d picture
 * [3][height][width], overwritten; NULL: not wanted. Equation: docs/maths.md, "The fine stage". */
ERN_API ERN_NODISCARD ern_status ern_lpips_distance(ern_lpips *lpips, const float *picture, const float *truth,
                                                    int width, int height, double *distance, float *dpicture);

/* As the loss of the patches of a training's fine stage (ern_train_config.fine_loss). `lpips` must outlive the
 * trainer. */
ERN_API ern_fine_loss ern_lpips_fine_loss(ern_lpips *lpips);

#ifdef __cplusplus
}
#endif
#endif
