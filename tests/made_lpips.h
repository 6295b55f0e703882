/* SPDX-License-Identifier: MIT
 * Random weights for LPIPS: an AlexNet with torchvision's shapes, and heads for it. */
#ifndef ERN_TESTS_MADE_LPIPS_H
#define ERN_TESTS_MADE_LPIPS_H

#include "support.h"

#include <math.h>

#include "io/safetensors.h"

enum { MADE_CONVOLUTIONS = 5, MADE_TENSORS = 2 * MADE_CONVOLUTIONS };

/* Number in the file, channels in and out, side of the kernel. */
static const int made_convolution[MADE_CONVOLUTIONS][4] = {
    {0, 3, 64, 11}, {3, 64, 192, 5}, {6, 192, 384, 3}, {8, 384, 256, 3}, {10, 256, 256, 3}};

static inline void made_tensor(struct ern_tensor *tensor, char *name, const size_t *shape, int dims, float low,
                               float high) {
  static uint32_t state = 1;
  *tensor = (struct ern_tensor){.name = name, .dtype = ERN_F32, .dims = dims, .count = 1};
  for (int d = 0; d < dims; d++) {
    tensor->shape[d] = shape[d];
    tensor->count *= shape[d];
  }
  float *values = malloc(tensor->count * sizeof *values);
  assert_non_null(values);
  for (size_t i = 0; i < tensor->count; i++) {
    state = state * 1664525u + 1013904223u;
    values[i] = low + (high - low) * (float)(state >> 8) / 16777216.0f;
  }
  tensor->data = values;
}

/* Writes the files of the network and of the heads. `wrong`: 1: a head is too short, 2: a value is not finite, 3: a
 * tensor is missing, else both are valid. */
static inline void made_lpips(const char *network, const char *heads, int wrong) {
  ern_context *context = support_context();
  struct ern_tensor tensor[MADE_TENSORS], head[MADE_CONVOLUTIONS];
  char name[MADE_TENSORS][64], head_name[MADE_CONVOLUTIONS][64];
  for (int i = 0; i < MADE_CONVOLUTIONS; i++) {
    const int *c = made_convolution[i];
    const size_t shape[4] = {(size_t)c[2], (size_t)c[1], (size_t)c[3], (size_t)c[3]},
                 one[4] = {1, (size_t)c[2] - (wrong == 1 && i == 2), 1, 1};
    const float most = sqrtf(6.0f / (float)(c[1] * c[3] * c[3]));
    snprintf(name[2 * i], sizeof name[0], "features.%d.weight", c[0]);
    snprintf(name[2 * i + 1], sizeof name[0], "features.%d.bias", c[0]);
    snprintf(head_name[i], sizeof head_name[0], "lin%d.model.1.weight", i);
    made_tensor(&tensor[2 * i], name[2 * i], shape, 4, -most, most);
    made_tensor(&tensor[2 * i + 1], name[2 * i + 1], shape, 1, -0.1f, 0.3f);
    made_tensor(&head[i], head_name[i], one, 4, 0, 1);
  }
  if (wrong == 2) *(float *)(uintptr_t)tensor[4].data = NAN;
  support_ok(context, ern_safetensors_write(context, network, tensor, wrong == 3 ? MADE_TENSORS - 1 : MADE_TENSORS,
                                            NULL, 0, ERN_EXISTING_REPLACE));
  support_ok(context, ern_safetensors_write(context, heads, head, MADE_CONVOLUTIONS, NULL, 0, ERN_EXISTING_REPLACE));
  for (int i = 0; i < MADE_TENSORS; i++) free((void *)(uintptr_t)tensor[i].data);
  for (int i = 0; i < MADE_CONVOLUTIONS; i++) free((void *)(uintptr_t)head[i].data);
  ern_context_free(&context);
}

#endif
