/* SPDX-License-Identifier: MIT
 * Reads a model file of any supported format, safetensors or torch.save, as tensors with our names. */
#ifndef ERN_MODEL_CHECKPOINT_H
#define ERN_MODEL_CHECKPOINT_H

#include "io/safetensors.h"
#include "io/torch_zip.h"

/* The content decides the format. In a .pth, the tensors of `model` (or of a bare state dict) keep their names; the
 * optimizer's are state.moment.NAME (exp_avg_sq), state.first.NAME (exp_avg) and state.count.NAME (step), the average's
 * state.average.NAME and state.collected.NAME, where order and shapes identify the parameter; other tensors are named
 * by their path. Metadata: "torch" (the tree, io/torch_zip.h), "ernerf" where the file has ours, "ernerf.state" where
 * the training can be resumed, "global_step". The caller owns the result (ern_tensor_file_free). */
ERN_NODISCARD ern_status ern_checkpoint_read(ern_context *context, const char *path, struct ern_tensor_file *file);

/* Name prefixes of the public program's optimizer groups for a head or torso, in its order. Groups without tensors are
 * left out. NULL past the last. */
const char *ern_checkpoint_group(bool torso, size_t number);
/* Whether a tensor of the model belongs to that group. */
bool ern_checkpoint_in_group(const char *name, const char *group);
/* Whether a name is a buffer's, not a trained tensor's. */
bool ern_checkpoint_is_buffer(const char *name);

#endif
