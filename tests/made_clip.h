/* SPDX-License-Identifier: MIT
 * A synthetic clip in memory, and trainings on it. */
#ifndef ERN_TESTS_MADE_CLIP_H
#define ERN_TESTS_MADE_CLIP_H

#include <math.h>

#include "ernerf/ernerf.h"
#include "support.h"

enum { SIDE = 20, FRAMES = 4, WINDOWS = 6, WIDTH = 5 };

/* A clip in memory: the pixels are a different pattern in each frame; the camera rotates slightly from frame to frame.
 */
struct made {
  ern_context *context;
  ern_backend *backend;
  ern_features features;
  ern_dataset data;
  float speech[WINDOWS * 16 * WIDTH];
  uint8_t background[SIDE * SIDE * 3], truth[FRAMES][SIDE * SIDE * 3], torso[FRAMES][SIDE * SIDE * 4];
  ern_box lips, lower_face, eyes, dubbed; /* of every frame */
  float poison;                           /* if not 0, replaces the eye value of every frame */
};

static inline ern_status made_frame(void *user, int split, size_t index, ern_dataset_frame *frame) {
  const struct made *m = (const struct made *)user;
  const float angle = 0.1f * (float)index - 0.1f, s = sinf(angle), c = cosf(angle);
  (void)split;
  *frame = (ern_dataset_frame){.matrix = {c, 0, s, s * 0.8f, 0, 1, 0, 0, -s, 0, c, c * 0.8f, 0, 0, 0, 1},
                               .aud_id = (int64_t)index,
                               .eye = m->poison != 0 ? m->poison : 0.2f * (float)index,
                               .has_face = true,
                               .face = {4, 16, 4, 16},
                               .lips = m->lips,
                               .lower_face = m->lower_face,
                               .eyes = m->eyes,
                               .dubbed = m->dubbed};
  return ERN_OK;
}

static inline ern_status made_pixels(void *user, int split, size_t index, const uint8_t **truth,
                                     const uint8_t **torso) {
  struct made *m = (struct made *)user;
  (void)split;
  *truth = m->truth[index];
  *torso = m->torso[index];
  return ERN_OK;
}

static inline void made_open(struct made *m) {
  memset(m, 0, sizeof *m);
  m->context = support_context();
  support_ok(m->context, ern_backend_create(&m->backend, m->context, NULL));
  for (int i = 0; i < WINDOWS * 16 * WIDTH; i++) m->speech[i] = sinf(0.37f * (float)i);
  for (int i = 0; i < SIDE * SIDE * 3; i++) m->background[i] = (uint8_t)(i % 97 + 60);
  for (int f = 0; f < FRAMES; f++) {
    for (int i = 0; i < SIDE * SIDE * 3; i++) m->truth[f][i] = (uint8_t)((i * (f + 3)) % 201 + 20);
    for (int i = 0; i < SIDE * SIDE * 4; i++)
      m->torso[f][i] = (uint8_t)(i % 4 == 3 && i > SIDE * SIDE * 2 ? 255 : i % 181);
  }
  m->features = (ern_features){m->speech, WINDOWS, 16, WIDTH};
  m->data = (ern_dataset){.user = m,
                          .frames = {FRAMES, 1},
                          .focal = 48,
                          .cx = SIDE / 2,
                          .cy = SIDE / 2,
                          .width = SIDE,
                          .height = SIDE,
                          .scale = 4,
                          .has_eye = true,
                          .has_torso = true,
                          .features = &m->features,
                          .background = m->background,
                          .identity = "11112222333344445555666677778888aaaabbbbccccddddeeeeffff00009999",
                          .frame = made_frame,
                          .pixels = made_pixels};
}

static inline void made_close(struct made *m) {
  ern_backend_free(&m->backend);
  ern_context_free(&m->context);
}

/* Another context and backend, whose warnings are kept in `lines` (support_keep_warnings). */
static inline void made_listen(struct made *m, char *lines) {
  ern_context_config config = ern_context_config_default();
  config.log = support_keep_warnings;
  config.user = lines;
  assert_int_equal(ern_context_create(&m->context, &config), ERN_OK);
  support_ok(m->context, ern_backend_create(&m->backend, m->context, NULL));
}

static inline ern_train_config small_config(uint64_t iters, const char *output) {
  ern_train_config config = ern_train_config_default();
  config.iters = iters;
  config.rays = 96;
  config.levels = 4;
  config.output = output;
  config.overwrite = true; /* many tests train repeatedly to one name */
  config.threads = 2;
  config.ema_every = 2;
  config.save_every = 0;
  config.validate_every = 0;
  return config;
}

static inline void clear_run(const char *name) {
  char path[64];
  snprintf(path, sizeof path, "%s.run", name);
  support_clear(path);
  snprintf(path, sizeof path, "%s.safetensors", name);
  support_clear(path);
}

static inline ern_status train(struct made *m, const ern_train_config *config, const ern_train_hooks *hooks) {
  ern_trainer *trainer = NULL;
  ern_status status = ern_trainer_create(&trainer, m->backend, &m->data, config);
  if (status == ERN_OK) status = ern_trainer_run(trainer, hooks);
  ern_trainer_free(&trainer);
  return status;
}

static inline char *read_file(const char *path, size_t *count) {
  FILE *file = fopen(path, "rb");
  if (file == NULL) fail_msg("%s: cannot be opened", path);
  fseek(file, 0, SEEK_END);
  *count = (size_t)ftell(file);
  rewind(file);
  char *bytes = (char *)malloc(*count + 1);
  assert_int_equal(fread(bytes, 1, *count, file), *count);
  bytes[*count] = 0;
  fclose(file);
  return bytes;
}

static inline void expect_same(const char *a, const char *b) {
  size_t a_count = 0, b_count = 0;
  char *a_bytes = read_file(a, &a_count), *b_bytes = read_file(b, &b_count);
  assert_int_equal(a_count, b_count);
  if (memcmp(a_bytes, b_bytes, a_count) != 0) fail_msg("%s and %s differ", a, b);
  free(a_bytes), free(b_bytes);
}

#endif
