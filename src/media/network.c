/* SPDX-License-Identifier: MIT
 * A network of the caller: its ONNX file, and the library that runs it. */
#include <dlfcn.h>
#include <math.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "ernerf/media.h"
#include "io/file.h"
#include "io/onnx.h"
#include "media/vision_library.h"

enum { FILE_LIMIT = INT32_MAX /* protobuf's limit */ };

struct ern_network {
  ern_context *context;
  char *path;
  struct ern_onnx onnx;
  void *library;
  const struct ern_vision *vision;
  struct ern_vision_network *network;
};

static ern_status open_file(ern_network *n) {
  uint8_t *bytes = NULL;
  size_t count = 0;
  char words[ERN_VISION_WORDS] = "";
  ern_status status = ERN_OK;
  ERN_TRY(ern_file_read(n->context, n->path, FILE_LIMIT, &bytes, &count));
  ERN_TRY(ern_onnx_inspect(n->context, n->path, bytes, count, &n->onnx));
  ERN_TRY(ern_vision_load(n->context, n->path, &n->library, &n->vision));
  status = n->vision->open(bytes, count, &n->network, words);
  if (status != ERN_OK)
    ern_fail(n->context, status, "%s: OpenCV %s does not take %s", n->path, n->vision->opencv, words);
fail:
  ern_release(n->context, bytes);
  return status;
}

ern_status ern_network_open(ern_context *context, const char *path, ern_network **network) {
  ERN_PLAIN_FLOATS;
  if (network != NULL) *network = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, network);
  ern_network *n = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(context, 1, &n));
  n->context = context;
  ERN_TRY(ern_string_copy(context, path, &n->path));
  ERN_TRY(open_file(n));
  *network = n;
  return ERN_OK;
fail:
  ern_network_free(&n);
  return status;
}

void ern_network_free(ern_network **network) {
  if (network == NULL || *network == NULL) return;
  ern_network *n = *network;
  *network = NULL;
  if (n->vision != NULL) n->vision->free(n->network);
  if (n->library != NULL) dlclose(n->library);
  ern_release(n->context, n->path);
  ern_release(n->context, n);
}

int ern_network_input(const ern_network *network, int shape[ERN_NETWORK_DIMS]) {
  if (network == NULL || shape == NULL) return 0;
  for (int d = 0; d < network->onnx.dims; d++) shape[d] = network->onnx.shape[d];
  return network->onnx.dims;
}

ern_status ern_network_run(ern_network *network, const float *input, const float **output, size_t *count) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, network);
  ERN_NEED(network->context, input);
  ERN_NEED(network->context, output);
  ERN_NEED(network->context, count);
  const struct ern_onnx *onnx = &network->onnx;
  struct ern_vision_array in = {.data = input, .dims = onnx->dims}, out = {0};
  char words[ERN_VISION_WORDS] = "";
  for (int d = 0; d < onnx->dims; d++) in.shape[d] = onnx->shape[d];
  const ern_status status = network->vision->run(network->network, &in, onnx->output[0], &out, words);
  if (status != ERN_OK)
    return ern_fail(network->context, status, "%s: OpenCV %s cannot compute its output \"%s\": %s", network->path,
                    network->vision->opencv, onnx->output[0], words);
  *output = out.data;
  *count = 1;
  for (int d = 0; d < out.dims; d++) *count *= (size_t)out.shape[d];
  for (size_t i = 0; i < *count; i++)
    if (!isfinite(out.data[i]))
      return ern_fail(network->context, ERN_E_NONFINITE,
                      "%s: its output \"%s\" is %g in place %zu, expected a finite number", network->path,
                      onnx->output[0], (double)out.data[i], i);
  return ERN_OK;
}
