/* SPDX-License-Identifier: MIT
 * LPIPS: reads the weights of its networks from untrusted files, and loads the library that computes with them. */
#include "ernerf/media.h"

#include <dlfcn.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>

#include "core/floats.h"
#include "core/memory.h"
#include "io/torch_zip.h"
#include "media/loaded_library.h"
#include "perceptual/perceptual.h"

#define TEXT_OF(x) #x
#define SONAME(major) "libernerf-perceptual.so." TEXT_OF(major)

struct ern_lpips {
  ern_context *context;
  void *library;
  const struct ern_perceptual *functions;
  struct ern_perceptual_network *network;
  const char *name;
};

/* A convolution of a network: the tensors features.NUMBER.weight and .bias. */
struct convolution {
  int number, in, out, size, stride, padding, pool;
  int head; /* linHEAD.model.1.weight, -1: none */
};

static const struct convolution alexnet[] = {{0, 3, 64, 11, 4, 2, 0, 0},
                                             {3, 64, 192, 5, 1, 2, 3, 1},
                                             {6, 192, 384, 3, 1, 1, 3, 2},
                                             {8, 384, 256, 3, 1, 1, 0, 3},
                                             {10, 256, 256, 3, 1, 1, 0, 4}};
static const struct convolution vgg16[] = {
    {0, 3, 64, 3, 1, 1, 0, -1},    {2, 64, 64, 3, 1, 1, 0, 0},     {5, 64, 128, 3, 1, 1, 2, -1},
    {7, 128, 128, 3, 1, 1, 0, 1},  {10, 128, 256, 3, 1, 1, 2, -1}, {12, 256, 256, 3, 1, 1, 0, -1},
    {14, 256, 256, 3, 1, 1, 0, 2}, {17, 256, 512, 3, 1, 1, 2, -1}, {19, 512, 512, 3, 1, 1, 0, -1},
    {21, 512, 512, 3, 1, 1, 0, 3}, {24, 512, 512, 3, 1, 1, 2, -1}, {26, 512, 512, 3, 1, 1, 0, -1},
    {28, 512, 512, 3, 1, 1, 0, 4}};

/* ---- weights ----------------------------------------------------------------------------------------------------- */

static ern_status read_tensors(ern_context *context, const char *path, struct ern_tensor_file *file) {
  static const size_t most = (size_t)1 << 30; /* bytes; VGG16 with its classifier has 2^29 */
  uint8_t *bytes = NULL;
  size_t count = 0;
  char *tree = NULL;
  struct ern_torch torch;
  *file = (struct ern_tensor_file){0};
  ern_status status = ern_file_read(context, path, most, &bytes, &count);
  if (status != ERN_OK) return status;
  if (!ern_torch_is_torch(bytes, count)) return ern_safetensors_open(context, path, bytes, count, file);
  status = ern_torch_open(context, path, bytes, count, &torch);
  if (status == ERN_OK) status = ern_torch_tensors(context, &torch, "", file, &tree);
  ern_release(context, tree);
  return status;
}

/* Reads a tensor; it must have 32-bit floats, all finite, and this shape. */
static ern_status take(ern_context *context, const char *path, const struct ern_tensor_file *file, const char *name,
                       int dims, const size_t *shape, const float **values) {
  const struct ern_tensor *tensor = ern_tensor_file_find(file, name);
  if (tensor == NULL)
    return ern_fail(context, ERN_E_MISSING, "%s: has no tensor %s, expected AlexNet or VGG16 with its heads", path,
                    name);
  char found[96] = "", expected[96] = "";
  size_t at = 0, to = 0;
  bool same = tensor->dims == dims;
  for (int d = 0; d < tensor->dims; d++)
    at += (size_t)snprintf(found + at, sizeof found - at, " %zu", tensor->shape[d]);
  for (int d = 0; d < dims; d++) to += (size_t)snprintf(expected + to, sizeof expected - to, " %zu", shape[d]);
  for (int d = 0; same && d < dims; d++) same = tensor->shape[d] == shape[d];
  if (!same || tensor->dtype != ERN_F32)
    return ern_fail(context, ERN_E_SHAPE, "%s: tensor %s is %s of%s, expected F32 of%s", path, name,
                    ern_dtype_name(tensor->dtype), found, expected);
  *values = tensor->data;
  for (size_t i = 0; i < tensor->count; i++)
    if (!isfinite((*values)[i]))
      return ern_fail(context, ERN_E_NONFINITE, "%s: tensor %s: value %zu is not finite", path, name, i);
  return ERN_OK;
}

static ern_status take_layer(ern_context *context, const struct convolution *c, const char *const paths[2],
                             const struct ern_tensor_file files[2], struct ern_perceptual_layer *layer) {
  const size_t weight[4] = {(size_t)c->out, (size_t)c->in, (size_t)c->size, (size_t)c->size},
               bias[1] = {(size_t)c->out}, head[4] = {1, (size_t)c->out, 1, 1};
  char name[64];
  *layer = (struct ern_perceptual_layer){
      .in = c->in, .out = c->out, .size = c->size, .stride = c->stride, .padding = c->padding, .pool = c->pool};
  snprintf(name, sizeof name, "features.%d.weight", c->number);
  ern_status status = take(context, paths[0], &files[0], name, 4, weight, &layer->weight);
  snprintf(name, sizeof name, "features.%d.bias", c->number);
  if (status == ERN_OK) status = take(context, paths[0], &files[0], name, 1, bias, &layer->bias);
  snprintf(name, sizeof name, "lin%d.model.1.weight", c->head);
  if (status == ERN_OK && c->head >= 0) status = take(context, paths[1], &files[1], name, 4, head, &layer->head);
  return status;
}

/* Opens AlexNet or VGG16: VGG16's first kernels are 3 x 3. */
static ern_status open_network(ern_lpips *lpips, const char *const paths[2], const struct ern_tensor_file files[2]) {
  const struct ern_tensor *first = ern_tensor_file_find(&files[0], "features.0.weight");
  const bool is_vgg16 = first != NULL && first->dims == 4 && first->shape[3] == 3;
  const struct convolution *list = is_vgg16 ? vgg16 : alexnet;
  const size_t count = is_vgg16 ? sizeof vgg16 / sizeof *vgg16 : sizeof alexnet / sizeof *alexnet;
  struct ern_perceptual_layer layers[ERN_PERCEPTUAL_LAYERS];
  char words[ERN_PERCEPTUAL_WORDS] = "";
  lpips->name = is_vgg16 ? "lpips-vgg16" : "lpips-alexnet";
  for (size_t i = 0; i < count; i++) {
    const ern_status status = take_layer(lpips->context, &list[i], paths, files, &layers[i]);
    if (status != ERN_OK) return status;
  }
  const ern_status status = lpips->functions->open(layers, (int)count, &lpips->network, words);
  return status == ERN_OK
             ? ERN_OK
             : ern_fail(lpips->context, status, "%s: oneDNN %s: %s", paths[0], lpips->functions->onednn, words);
}

/* ---- the metric -------------------------------------------------------------------------------------------------- */

ern_status ern_lpips_open(ern_lpips **lpips, ern_context *context, const char *network, const char *heads) {
  ERN_PLAIN_FLOATS;
  if (lpips != NULL) *lpips = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, lpips);
  ERN_NEED(context, network);
  ERN_NEED(context, heads);
  static const struct ern_loaded_library about = {SONAME(ERN_VERSION_MAJOR), "ern_perceptual",
                                                  "ERNERF_PERCEPTUAL (oneDNN)", NULL};
  const char *const paths[2] = {network, heads};
  struct ern_tensor_file files[2] = {{0}};
  const void *table = NULL;
  ern_lpips *made = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(context, 1, &made));
  made->context = context;
  ERN_TRY(ern_library_load(context, "LPIPS", &about, &made->library, &table));
  made->functions = table;
  for (int i = 0; i < 2; i++) ERN_TRY(read_tensors(context, paths[i], &files[i]));
  ERN_TRY(open_network(made, paths, files));
fail:
  for (int i = 0; i < 2; i++) ern_tensor_file_free(context, &files[i]);
  if (status != ERN_OK) ern_lpips_free(&made);
  *lpips = made;
  return status;
}

void ern_lpips_free(ern_lpips **lpips) {
  if (lpips == NULL || *lpips == NULL) return;
  ern_lpips *own = *lpips;
  if (own->functions != NULL) own->functions->free(own->network);
  if (own->library != NULL) (void)dlclose(own->library);
  ern_release(own->context, own);
  *lpips = NULL;
}

const char *ern_lpips_name(const ern_lpips *lpips) { return lpips != NULL ? lpips->name : NULL; }

ern_status ern_lpips_distance(ern_lpips *lpips, const float *picture, const float *truth, int width, int height,
                              double *distance, float *dpicture) {
  ERN_PLAIN_FLOATS;
  if (lpips == NULL) return ERN_E_ARGUMENT;
  ERN_NEED(lpips->context, picture);
  ERN_NEED(lpips->context, truth);
  ERN_NEED(lpips->context, distance);
  enum { MOST = 8192 };
  char words[ERN_PERCEPTUAL_WORDS] = "";
  if (width < 1 || height < 1 || width > MOST || height > MOST)
    return ern_fail(lpips->context, ERN_E_ARGUMENT, "%s: the pictures are %d x %d, expected 1 to %d a side",
                    lpips->name, width, height, MOST);
  const ern_status status =
      lpips->functions->distance(lpips->network, picture, truth, width, height, distance, dpicture, words);
  return status == ERN_OK
             ? ERN_OK
             : ern_fail(lpips->context, status, "%s: of %d x %d pixels: %s", lpips->name, width, height, words);
}

static ern_status fine_loss(void *user, const float *pixel, const float *truth, int side, double *loss, float *dpixel) {
  return ern_lpips_distance(user, pixel, truth, side, side, loss, dpixel);
}

ern_fine_loss ern_lpips_fine_loss(ern_lpips *lpips) {
  if (lpips == NULL) return (ern_fine_loss){.name = NULL};
  return (ern_fine_loss){.name = ern_lpips_name(lpips), .compute = fine_loss, .user = lpips};
}
