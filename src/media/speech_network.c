/* SPDX-License-Identifier: MIT
 * Networks that compute speech features: the ONNX file, its description, and the library that runs it. */
#include "media/speech_network.h"

#include <dlfcn.h>
#include <stdio.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "io/file.h"
#include "io/onnx.h"
#include "media/vision_library.h"

enum { FILE_LIMIT = INT32_MAX /* protobuf's limit */, DESCRIPTION_LIMIT = 1 << 16 };

/* ---- the description --------------------------------------------------------------------------------------------- */

/* NETWORK.json of NETWORK.onnx. */
static ern_status path_beside(ern_context *context, const char *path, char **beside) {
  static const char from[] = ".onnx", to[] = ".json";
  const size_t count = strlen(path), tail = sizeof from - 1;
  const size_t stem = count > tail && strcmp(path + count - tail, from) == 0 ? count - tail : count;
  const ern_status status = ERN_NEW(context, stem + sizeof to, beside);
  if (status != ERN_OK) return status;
  memcpy(*beside, path, stem);
  memcpy(*beside + stem, to, sizeof to);
  return ERN_OK;
}

static ern_status read_description(struct ern_speech_network *n, const char *description) {
  ern_context *context = n->context;
  uint8_t *bytes = NULL;
  size_t count = 0;
  char *beside = NULL, where[512];
  ern_status status = ERN_OK;
  if (description != NULL && description[0] == '{') {
    snprintf(where, sizeof where, "%.400s: its description", n->path);
    return ern_speech_description_parse(context, where, description, &n->description);
  }
  if (description == NULL) {
    ERN_TRY(path_beside(context, n->path, &beside));
    description = beside;
  }
  status = ern_file_read(context, description, DESCRIPTION_LIMIT, &bytes, &count);
  if (status == ERN_E_MISSING && beside != NULL)
    ern_fail(context, status, "%s: what it needs is not said: expected a preset, or its description in %s", n->path,
             beside);
  if (status == ERN_OK)
    status = ern_speech_description_parse(context, description, (const char *)bytes, &n->description);
fail:
  ern_release(context, beside);
  ern_release(context, bytes);
  return status;
}

/* ---- the file ---------------------------------------------------------------------------------------------------- */

static ern_status check_hash(struct ern_speech_network *n, const uint8_t *bytes, size_t count) {
  char hex[65], *wanted = n->description.sha256;
  ern_sha256_hex(bytes, count, hex);
  if (wanted[0] != 0 && strcmp(hex, wanted) != 0)
    return ern_fail(n->context, ERN_E_MISMATCH,
                    "%s: is another network than \"%s\", or a changed one: its SHA-256 is %s, expected %s", n->path,
                    n->description.kind, hex, wanted);
  memcpy(wanted, hex, sizeof hex);
  return ERN_OK;
}

static void shape_words(int dims, const int *shape, char *words, size_t bytes) {
  size_t used = 0;
  words[0] = 0;
  for (int d = 0; d < dims && used < bytes; d++)
    used += (size_t)snprintf(words + used, bytes - used, "%s%d", d > 0 ? ", " : "", shape[d]);
}

static ern_status check_input(struct ern_speech_network *n, const struct ern_onnx *onnx) {
  const int last = onnx->dims - 1, samples = n->description.piece_samples;
  bool wave = onnx->shape[last] == samples;
  char words[160];
  for (int d = 0; d < last; d++) wave &= onnx->shape[d] == 1;
  n->dims = onnx->dims;
  for (int d = 0; d <= last; d++) n->shape[d] = onnx->shape[d];
  if (wave) return ERN_OK;
  shape_words(onnx->dims, onnx->shape, words, sizeof words);
  return ern_fail(n->context, ERN_E_SHAPE,
                  "%s: its input \"%s\" is [%s], and pieces of \"%s\" have %d samples (piece_samples); export it with "
                  "torch.zeros(1, %d)",
                  n->path, onnx->input, words, n->description.kind, samples, samples);
}

static ern_status choose_output(struct ern_speech_network *n, const struct ern_onnx *onnx) {
  const char *wanted = n->description.output;
  const size_t named = onnx->outputs < ERN_ONNX_OUTPUTS ? onnx->outputs : ERN_ONNX_OUTPUTS;
  char list[ERN_ONNX_OUTPUTS * (ERN_ONNX_NAME + 4)] = "";
  for (size_t i = 0; i < named; i++) {
    const size_t used = strlen(list);
    snprintf(list + used, sizeof list - used, "%s\"%s\"", i > 0 ? ", " : "", onnx->output[i]);
    if (onnx->outputs > 1 && strcmp(onnx->output[i], wanted) != 0) continue;
    if (wanted[0] != 0 && strcmp(onnx->output[i], wanted) != 0) continue;
    memcpy(n->output, onnx->output[i], sizeof n->output);
    return ERN_OK;
  }
  if (wanted[0] == 0)
    return ern_fail(n->context, ERN_E_MISSING, "%s: has the outputs %s; expected a description that names one (output)",
                    n->path, list);
  return ern_fail(n->context, ERN_E_MISSING, "%s: has no output \"%s\", expected %s", n->path, wanted, list);
}

static ern_status open_file(struct ern_speech_network *n) {
  uint8_t *bytes = NULL;
  size_t count = 0;
  struct ern_onnx onnx;
  char words[ERN_VISION_WORDS] = "";
  ern_status status = ERN_OK;
  ERN_TRY(ern_file_read(n->context, n->path, FILE_LIMIT, &bytes, &count));
  ERN_TRY(ern_onnx_inspect(n->context, n->path, bytes, count, &onnx));
  ERN_TRY(check_hash(n, bytes, count));
  ERN_TRY(check_input(n, &onnx));
  ERN_TRY(choose_output(n, &onnx));
  ERN_TRY(ern_vision_load(n->context, n->path, &n->library, &n->vision));
  status = n->vision->open(bytes, count, &n->network, words);
  if (status != ERN_OK)
    ern_fail(n->context, status, "%s: OpenCV %s does not take %s; docs/speech.md says how to export it", n->path,
             n->vision->opencv, words);
fail:
  ern_release(n->context, bytes);
  return status;
}

/* ---- the network ------------------------------------------------------------------------------------------------- */

ern_status ern_speech_network_open(ern_context *context, const char *path, const char *description,
                                   ern_speech_network **network) {
  ERN_PLAIN_FLOATS;
  if (network != NULL) *network = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, network);
  ern_speech_network *n = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(context, 1, &n));
  n->context = context;
  ERN_TRY(ern_string_copy(context, path, &n->path));
  ERN_TRY(read_description(n, description));
  ERN_TRY(open_file(n));
  ERN_TRY(ern_speech_description_text(context, &n->description, n->text));
  *network = n;
  return ERN_OK;
fail:
  ern_speech_network_free(&n);
  return status;
}

void ern_speech_network_free(ern_speech_network **network) {
  if (network == NULL || *network == NULL) return;
  ern_speech_network *n = *network;
  *network = NULL;
  if (n->vision != NULL) n->vision->free(n->network);
  if (n->library != NULL) dlclose(n->library);
  ern_release(n->context, n->path);
  ern_release(n->context, n);
}

const char *ern_speech_network_kind(const ern_speech_network *network) {
  return network != NULL ? network->description.kind : "";
}

const char *ern_speech_network_description(const ern_speech_network *network) {
  return network != NULL ? network->text : "";
}

void ern_speech_network_watch(ern_speech_network *network, int (*watch)(void *user, size_t done, size_t pieces),
                              void *user) {
  if (network == NULL) return;
  network->watch = watch;
  network->user = user;
}
