/* SPDX-License-Identifier: MIT
 * A model's file of any kind that is known, as tensors with our names: safetensors, or what torch.save wrote. */
#ifndef ERN_MODEL_CHECKPOINT_H
#define ERN_MODEL_CHECKPOINT_H

#include "io/safetensors.h"
#include "io/torch_zip.h"

/* Decides by content. Of a .pth, the tensors of `model` (or of a bare state dict) keep their names; the optimizer's are
 * state.moment.NAME (exp_avg_sq), state.first.NAME (exp_avg) and state.count.NAME (step), the average's
 * state.average.NAME and state.collected.NAME, where their order and shapes say whose they are; others have the path to
 * them. Metadata: "torch" (the tree, io/torch_zip.h), "ernerf" where the file has ours, "ernerf.state" where it can be
 * trained on, "global_step". The caller owns the result (ern_tensor_file_free). */
ERN_NODISCARD ern_status ern_checkpoint_read(ern_context *context, const char *path, struct ern_tensor_file *file);

/* What the optimizer of the public program trains, in its order: how the names of a head's or torso's groups begin.
 * A group that has no tensors is left out here. NULL past the last. */
const char *ern_checkpoint_group(bool torso, size_t number);
/* Whether a tensor of the model is of that group. */
bool ern_checkpoint_in_group(const char *name, const char *group);
/* Whether a name is a buffer's, not a trained tensor's. */
bool ern_checkpoint_is_buffer(const char *name);

#endif
