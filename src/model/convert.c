/* SPDX-License-Identifier: MIT
 * Converts a model file between safetensors and the public program's PyTorch format. */
#include <inttypes.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "ernerf/data.h"
#include "io/json.h"
#include "model/checkpoint.h"
#include "model/model.h"
#include "model/torch_layout.h"

static bool ends_with(const char *path, const char *ending) {
  const size_t length = strlen(path), end = strlen(ending);
  return length > end && strcmp(path + length - end, ending) == 0;
}

static bool has_model(const struct ern_tensor_file *file) {
  return ern_tensor_file_find(file, "encoder_xy.embeddings") != NULL ||
         ern_tensor_file_find(file, "sigma_net.net.0.weight") != NULL ||
         ern_tensor_file_metadata(file, "ernerf") != NULL;
}

/* ---- to safetensors ---------------------------------------------------------------------------------------------- */

/* Copies everything, and adds our description of the model where the file has none. */
static ern_status write_safetensors(ern_context *context, const struct ern_tensor_file *file, const ern_model *model,
                                    const char *path) {
  struct ern_metadata *metadata = NULL;
  char *text = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(context, file->metadata_count + 2, &metadata));
  size_t count = 0;
  for (size_t i = 0; i < file->metadata_count; i++) metadata[count++] = file->metadata[i];
  if (model != NULL && ern_tensor_file_metadata(file, "ernerf") == NULL) {
    ERN_TRY(ern_model_metadata(model, &text));
    metadata[count++] = (struct ern_metadata){"ernerf", text};
  }
  if (ern_tensor_file_metadata(file, "format") == NULL)
    metadata[count++] = (struct ern_metadata){"format", model != NULL ? "ernerf" : "pt"};
  status =
      ern_safetensors_write(context, path, file->tensors, file->tensor_count, metadata, count, ERN_EXISTING_BY_CONTEXT);
fail:
  ern_release(context, text);
  ern_release(context, metadata);
  return status;
}

/* ---- to PyTorch -------------------------------------------------------------------------------------------------- */

static ern_status write_plain(ern_context *context, const struct ern_tensor_file *file, const char *path) {
  char *text = NULL;
  json_t *pairs = json_array();
  bool whole = true;
  for (size_t i = 0; i < file->tensor_count; i++) {
    const char *name = file->tensors[i].name;
    whole &= json_array_append_new(pairs, json_pack("[s, {s:s}]", name, "tensor", name)) == 0;
  }
  json_t *root = json_pack("{s:o}", "ordered", pairs);
  text = whole && root != NULL ? ern_json_text(context, root, JSON_COMPACT) : NULL;
  json_decref(root);
  if (text == NULL) return ern_fail(context, ERN_E_NO_MEMORY, "%s: no memory for the tree", path);
  const ern_status status = ern_torch_write(context, path, text, file->tensors, file->tensor_count);
  ern_release(context, text);
  return status;
}

static ern_status write_torch(ern_context *context, const struct ern_tensor_file *file, const ern_model *model,
                              const char *path) {
  const char *tree = ern_tensor_file_metadata(file, "torch");
  if (tree != NULL) return ern_torch_write(context, path, tree, file->tensors, file->tensor_count);
  if (model == NULL) return write_plain(context, file, path);
  struct ern_torch_layout layout = {.context = context, .file = file, .model = model, .path = path};
  ern_status status = ern_torch_layout_make(&layout);
  if (status == ERN_OK) status = ern_torch_write_tree(context, path, layout.tree, layout.tensor, layout.tensors);
  ern_torch_layout_free(&layout);
  return status;
}

ern_status ern_file_convert(ern_context *context, const char *in, const char *out) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(context, context);
  ERN_NEED(context, in);
  ERN_NEED(context, out);
  struct ern_tensor_file file = {0};
  ern_model *model = NULL;
  const bool torch = ends_with(out, ".pth") || ends_with(out, ".pt");
  ern_status status = ERN_OK;
  if (!torch && !ends_with(out, ".safetensors"))
    return ern_fail(context, ERN_E_ARGUMENT, "%s: expected a name that ends in .safetensors, .pth or .pt", out);
  ERN_TRY(ern_checkpoint_read(context, in, &file));
  if (has_model(&file))
    ERN_TRY(ern_model_from_file(&model, context, &file, in));
  else
    ern_log(context, ERN_LOG_WARNING, "%s: is no model; its %zu tensors are carried over as they are", in,
            file.tensor_count);
  status = torch ? write_torch(context, &file, model, out) : write_safetensors(context, &file, model, out);
fail:
  ern_model_free(&model);
  ern_tensor_file_free(context, &file);
  return status;
}
