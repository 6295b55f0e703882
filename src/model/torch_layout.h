/* SPDX-License-Identifier: MIT
 * One of our models laid out as the public program's checkpoint: its names, its order, its paddings. */
#ifndef ERN_MODEL_TORCH_LAYOUT_H
#define ERN_MODEL_TORCH_LAYOUT_H

#include <jansson.h>

#include "model/model.h"

enum { ERN_TORCH_LAYOUT_TENSORS = 5 * ERN_MAX_PARAMETERS };

struct ern_torch_layout {
  ern_context *context;
  const struct ern_tensor_file *file; /* what the model was read from: its grid and training state */
  const ern_model *model;
  const char *path; /* of what is written, for messages */
  /* made */
  json_t *tree; /* io/torch_zip.h */
  bool lost;    /* a value of the tree found no memory */
  struct ern_tensor tensor[ERN_TORCH_LAYOUT_TENSORS];
  char name[ERN_TORCH_LAYOUT_TENSORS][ERN_PARAMETER_NAME + 24];
  void *owned[ERN_TORCH_LAYOUT_TENSORS]; /* bytes that were made here, NULL: they are the file's */
  size_t tensors;
};

/* ERN_E_UNSUPPORTED names a feature that the public program lacks; the log names those that it supports only with an
 * option. */
ERN_NODISCARD ern_status ern_torch_layout_make(struct ern_torch_layout *layout);
void ern_torch_layout_free(struct ern_torch_layout *layout);

#endif
