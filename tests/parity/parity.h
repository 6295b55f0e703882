/* SPDX-License-Identifier: MIT
 * Shared code of the tests against PyTorch: its arrays, its clip, and a head's training step on a backend. */
#ifndef ERN_TESTS_PARITY_H
#define ERN_TESTS_PARITY_H

#include <math.h>

#include "core/backend.h"
#include "core/cpu.h"
#include "ernerf/ernerf.h"
#include "ernerf/media.h"
#include "io/npy.h"
#include "model/model.h"
#include "support.h"

static inline void parity_path(const char *name, char path[1024]) {
  char inside[512];
  snprintf(inside, sizeof inside, "parity/%s", name);
  support_shared(inside, path);
}

static inline void parity_npy(ern_context *context, const char *name, struct ern_npy *array) {
  char path[1024];
  parity_path(name, path);
  support_ok(context, ern_npy_read(context, path, array));
}

/* |a - b| / |b|, L2. */
static inline double parity_relative(const float *a, const float *b, size_t count) {
  double difference = 0, size = 0;
  for (size_t i = 0; i < count; i++) {
    difference += ((double)a[i] - (double)b[i]) * ((double)a[i] - (double)b[i]);
    size += (double)b[i] * (double)b[i];
  }
  return sqrt(difference) / sqrt(size > 0 ? size : 1e-300);
}

struct parity {
  ern_context *context;
  ern_clip *clip;
  ern_clip_info info;
  ern_dataset data;
  ern_model *model;
  ern_backend *backend;
};

/* The backends for a frame or a step: the instruction sets of this machine, and the OpenCL device if the build has
 * OpenCL. NULL past the last. */
static inline const char *parity_isa(int number) {
  for (ern_isa isa = ERN_ISA_REF; isa < ERN_ISAS; isa++)
    if (ern_isa_available(isa) && number-- == 0) return ern_isa_name(isa);
#if defined(ERN_OPENCL)
  if (number == 0) return "opencl";
#endif
  return NULL;
}

/* Opens the clip, the model parity/NAME and the backend with that instruction set, or the OpenCL device. */
static inline void parity_open(struct parity *p, const char *model, const char *isa) {
  char path[1024];
  *p = (struct parity){.context = NULL};
  parity_path("clip", path);
  p->context = support_context();
  const ern_clip_options options = ern_clip_options_default();
  support_ok(p->context, ern_clip_open(p->context, path, &options, &p->clip));
  ern_clip_describe(p->clip, &p->info);
  ern_clip_dataset(p->clip, &p->data);
  parity_path(model, path);
  support_ok(p->context, ern_model_load(&p->model, p->context, path));
  ern_backend_config config = ern_backend_config_default();
  if (strcmp(isa, "opencl") == 0)
    config.name = isa;
  else
    config.isa = isa;
  support_ok(p->context, ern_backend_create(&p->backend, p->context, &config));
}

static inline void parity_close(struct parity *p) {
  ern_backend_free(&p->backend);
  ern_model_free(&p->model);
  ern_clip_free(&p->clip);
  ern_context_free(&p->context);
}

/* The zero-padded windows of frame `index` of a split, [8][window_length][width]; the caller frees them. */
static inline float *parity_windows(const struct parity *p, int split, size_t index) {
  const ern_features *features = p->data.features;
  int64_t *rows = (int64_t *)calloc(p->data.frames[split], sizeof *rows);
  float *windows = (float *)calloc(8 * (size_t)features->window_length * (size_t)features->width, sizeof *windows);
  for (size_t k = 0; k < p->data.frames[split]; k++)
    rows[k] = ern_clip_frame_at(p->clip, (ern_split)split, k)->pose.aud_id;
  ern_audio_windows_of_rows(windows, features, rows, p->data.frames[split], (int64_t)index);
  free(rows);
  return windows;
}

static inline ern_camera parity_camera(const struct parity *p, int split, size_t index) {
  ern_camera camera = {.focal = (float)p->data.focal,
                       .cx = (float)p->data.cx,
                       .cy = (float)p->data.cy,
                       .width = p->data.width,
                       .height = p->data.height};
  ern_camera_pose(camera.pose, ern_clip_frame_at(p->clip, (ern_split)split, index)->pose.matrix, p->data.scale);
  return camera;
}

#endif
