/* SPDX-License-Identifier: MIT
 * Training steps on given pixels through the dispatch table, for comparison with recorded trainings. */
#ifndef ERN_TESTS_PARITY_STEP_H
#define ERN_TESTS_PARITY_STEP_H

#include "model/torso_ops.h"
#include "parity/parity.h"
#include "render/march_ops.h"
#include "train/step.h"

struct parity_step {
  struct parity *p;
  struct ern_stream *stream;
  size_t parameters, rays;
  ern_span values, gradient, moment, bits, torso_grid;
  ern_span pixel_number, jitter, face, windows;
  ern_rows truth, background;
};

static inline ern_span parity_reals(struct parity_step *s, size_t count) {
  ern_span span;
  support_ok(s->p->context, ern_scratch_take(s->stream, ERN_ELEMENT_REAL, count, &span));
  support_ok(s->p->context, s->p->backend->zero(s->stream, span));
  return span;
}

static inline void parity_step_open(struct parity_step *s, struct parity *p, size_t rays) {
  *s = (struct parity_step){.p = p, .parameters = p->model->field.parameters, .rays = rays};
  struct ern_backend *b = p->backend;
  support_ok(p->context, b->stream_make(b, 2, &s->stream));
  s->values = parity_reals(s, s->parameters);
  s->gradient = parity_reals(s, s->parameters);
  s->moment = parity_reals(s, s->parameters);
  s->face = parity_reals(s, rays);
  s->jitter = parity_reals(s, rays);
  s->windows = parity_reals(s, 8 * (size_t)p->data.features->window_length * (size_t)p->data.features->width);
  support_ok(p->context, ern_scratch_take_rows(s->stream, 3, rays, &s->truth));
  support_ok(p->context, ern_scratch_take_rows(s->stream, 3, rays, &s->background));
  support_ok(p->context, ern_scratch_take(s->stream, ERN_ELEMENT_INT32, rays, &s->pixel_number));
  support_ok(p->context, ern_scratch_take(s->stream, ERN_ELEMENT_BYTE, ERN_OCCUPANCY_BYTES, &s->bits));
  support_ok(p->context, b->upload_reals(s->stream, s->values, p->model->block, s->parameters));
  support_ok(p->context, b->upload_bytes(s->stream, s->bits, p->model->bits, ERN_OCCUPANCY_BYTES));
  if (p->model->torso_grid != NULL) {
    s->torso_grid = parity_reals(s, ERN_TORSO_CELLS);
    support_ok(p->context, b->upload_reals(s->stream, s->torso_grid, p->model->torso_grid, ERN_TORSO_CELLS));
  }
}

static inline void parity_step_close(struct parity_step *s) { s->p->backend->stream_free(s->stream); }

static inline struct ern_view parity_view(const struct parity *p, size_t frame) {
  const ern_camera camera = parity_camera(p, 0, frame);
  struct ern_view view = {
      .focal = camera.focal, .cx = camera.cx, .cy = camera.cy, .width = camera.width, .height = camera.height};
  memcpy(view.pose, camera.pose, sizeof view.pose);
  return view;
}

/* Uploads pixels, truth, background (torso image over bc.jpg; or bc.jpg itself, the torso image then being the truth)
 * and the face mask of the rays. */
static inline void parity_step_rays(struct parity_step *s, size_t frame, const int64_t *pixels, const float *jitter,
                                    bool for_torso) {
  struct parity *p = s->p;
  const size_t n = s->rays, width = (size_t)p->data.width;
  const uint8_t *truth = NULL, *torso = NULL;
  ern_dataset_frame about;
  float *rows = (float *)calloc(7 * n, sizeof *rows);
  int32_t *number = (int32_t *)calloc(n, sizeof *number);
  support_ok(p->context, p->data.frame(p->data.user, 0, frame, &about));
  support_ok(p->context, p->data.pixels(p->data.user, 0, frame, &truth, &torso));
  for (size_t i = 0; i < n; i++) {
    const size_t at = (size_t)pixels[i];
    const int row = (int)(at / width), column = (int)(at % width);
    const float a = (float)torso[4 * at + 3] / 255;
    number[i] = (int32_t)at;
    for (size_t c = 0; c < 3; c++) {
      const float bc = (float)p->data.background[3 * at + c] / 255,
                  over = (float)torso[4 * at + c] / 255 * a + bc * (1 - a);
      rows[c * n + i] = for_torso ? over : (float)truth[3 * at + c] / 255;
      rows[(3 + c) * n + i] = for_torso ? bc : over;
    }
    rows[6 * n + i] =
        row >= about.face.top && row < about.face.bottom && column >= about.face.left && column < about.face.right;
  }
  struct ern_backend *b = p->backend;
  for (int c = 0; c < 3; c++) {
    support_ok(p->context, b->upload_reals(s->stream, ern_span_of_row(s->truth, c, n), rows + (size_t)c * n, n));
    support_ok(p->context,
               b->upload_reals(s->stream, ern_span_of_row(s->background, c, n), rows + (size_t)(3 + c) * n, n));
  }
  support_ok(p->context, b->upload_reals(s->stream, s->face, rows + 6 * n, n));
  support_ok(p->context, b->upload_int32(s->stream, s->pixel_number, number, n));
  if (jitter != NULL) support_ok(p->context, b->upload_reals(s->stream, s->jitter, jitter, n));
  if (!for_torso) {
    float *windows = parity_windows(p, 0, frame);
    support_ok(p->context, b->upload_reals(s->stream, s->windows, windows, s->windows.count));
    free(windows);
  }
  free(rows), free(number);
}

/* Compares the gradient of each parameter that has a file <prefix><name>.npy: parity's README asks for 1e-3 relative L2
 * by name, 2e-3 for the tables.
 *
 * AudioAttNet's softmax is saturated in this model, so its gradient is a difference of numbers that agree in nearly all
 * digits: 1e-11, where the upstream gradient is 1e-3. PyTorch's float32 itself differs from the double truth there by
 * more than the tolerance; that distance is added to the tolerance. `truth`: the gradient of the double reference, NULL
 * while that is computed (finite differences check its AudioAttNet instead). */
static inline void parity_gradients(struct parity_step *s, const char *prefix, size_t code_row, bool torso,
                                    const float *truth) {
  struct parity *p = s->p;
  float *gradient = (float *)calloc(s->parameters, sizeof *gradient);
  int compared = 0;
  support_ok(p->context, p->backend->download_reals(s->stream, gradient, s->gradient, s->parameters));
  for (int r = 0; r < p->model->table.rows; r++) {
    const struct ern_parameter *row = &p->model->table.row[r];
    char name[160], path[1024];
    if (row->torso != torso) continue;
    snprintf(name, sizeof name, "%s%s.npy", prefix, row->name);
    parity_path(name, path);
    FILE *there = fopen(path, "rb");
    if (there == NULL) continue;
    fclose(there);
    struct ern_npy expected;
    parity_npy(p->context, name, &expected);
    const bool codes = strncmp(row->name, "individual_codes", 16) == 0, table = row->group == ERN_GROUP_GRID;
    const size_t at = row->at + (codes ? code_row * row->shape[1] : 0);
    const double relative = parity_relative(gradient + at, expected.data, expected.count);
    double allowed = table ? 2e-3 : 1e-3;
    if (row->group == ERN_GROUP_AUDIO_ATT)
      allowed += truth != NULL ? parity_relative(truth + at, expected.data, expected.count) : INFINITY;
    if (relative > 1e-4) print_message("gradient %s: relative %.2e, allowed %.2e\n", row->name, relative, allowed);
    if (!(relative <= allowed)) fail_msg("gradient %s: %.2e above %.0e", row->name, relative, allowed);
    compared++;
    ern_npy_free(p->context, &expected);
  }
  print_message("%d gradients compared\n", compared);
  assert_true(compared >= (torso ? 7 : 25));
  free(gradient);
}

#endif
