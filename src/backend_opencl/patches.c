/* SPDX-License-Identifier: MIT
 * Slot of the loss over patches: downsamples scale by scale, computes the gradient at each, and passes it back up. */
#include "backend_opencl/opencl.h"
#include "train/patches_ops.h"

enum { SCALES = ERN_PATCH_SCALES, PRODUCTS = 5, GRADIENTS = 4 };

struct patch_pass {
  struct ern_stream *stream;
  struct ern_patch_loss_args *args;
  size_t planes;
  size_t side[SCALES], total[SCALES]; /* total: values of all planes of a scale */
  ern_span x[SCALES], y[SCALES], d[SCALES], filter[SCALES];
  ern_span base, between, gradient;
};

static ern_status take(struct patch_pass *p) {
  ern_status status = ERN_OK;
  size_t at = 0;
  ERN_TRY(ern_scratch_take(p->stream, ERN_ELEMENT_REAL, p->planes, &p->base));
  for (size_t k = 0; k < SCALES; k++) {
    const size_t side = (size_t)p->args->side >> k, total = p->planes * side * side;
    p->side[k] = side;
    p->total[k] = total;
    p->filter[k] = ern_span_part(p->args->filter, at, side * side);
    at += 2 * side * side; /* skips the transpose: kernels read the matrix both ways */
    ERN_TRY(ern_scratch_take(p->stream, ERN_ELEMENT_REAL, total, &p->x[k]));
    ERN_TRY(ern_scratch_take(p->stream, ERN_ELEMENT_REAL, total, &p->y[k]));
    if (k > 0) ERN_TRY(ern_scratch_take(p->stream, ERN_ELEMENT_REAL, total, &p->d[k]));
  }
  ERN_TRY(ern_scratch_take(p->stream, ERN_ELEMENT_REAL, PRODUCTS * p->total[0], &p->between));
  ERN_TRY(ern_scratch_take(p->stream, ERN_ELEMENT_REAL, GRADIENTS * p->total[0], &p->gradient));
fail:
  return status;
}

static struct ern_cl_call begin(const struct patch_pass *p, const char *kernel) {
  return ern_cl_begin(p->stream, ERN_CL_patches, kernel, "");
}

static ern_status run(const struct patch_pass *p, struct ern_cl_call *call, size_t k) {
  ERN_CL_ARGS(call, p->side[k], p->total[k]);
  return ern_cl_each(call, p->total[k]);
}

/* The patches minus their means, and their smaller scales. */
static ern_status make_scales(const struct patch_pass *p) {
  const struct ern_patch_loss_args *a = p->args;
  const size_t n = p->side[0] * p->side[0];
  ern_status status = ERN_OK;
  struct ern_cl_call base = begin(p, "patch_base");
  ERN_CL_ARGS(&base, p->base, a->truth, n, p->planes);
  ERN_TRY(ern_cl_each(&base, p->planes));
  struct ern_cl_call shift = begin(p, "patch_shift");
  ERN_CL_ARGS(&shift, p->x[0], p->y[0], a->pixel, a->truth, p->base, n, p->total[0]);
  ERN_TRY(ern_cl_each(&shift, p->total[0]));
  for (size_t k = 1; k < SCALES; k++) {
    struct ern_cl_call halve = begin(p, "patch_halve");
    ERN_CL_ARGS(&halve, p->x[k], p->y[k], p->x[k - 1], p->y[k - 1]);
    ERN_TRY(run(p, &halve, k));
  }
fail:
  return status;
}

static double part_of(const struct ern_patch_loss_args *a, size_t k) {
  const double side = (double)(a->side >> k);
  return (double)a->weight / (SCALES * 3 * (double)a->patches * side * side);
}

static void deliver(void *args, const float *values, size_t count) {
  struct ern_patch_loss_args *a = args;
  for (size_t i = 0; i < count; i++) a->term += (double)values[i];
}

/* Gradients at one scale, and its sums of 1 - SSIM. */
static ern_status make_gradients(const struct patch_pass *p, size_t k) {
  const size_t lines = p->planes * p->side[k];
  ern_span figures;
  ern_status status = ERN_OK;
  struct ern_cl_call columns = begin(p, "patch_columns");
  ERN_CL_ARGS(&columns, p->between, p->x[k], p->y[k], p->filter[k]);
  ERN_TRY(run(p, &columns, k));
  struct ern_cl_call gradients = begin(p, "patch_gradients");
  ERN_CL_ARGS(&gradients, p->gradient, p->between, p->base, p->filter[k]);
  ERN_TRY(run(p, &gradients, k));
  ERN_TRY(ern_cl_figures(p->stream, lines, deliver, p->args, &figures));
  struct ern_cl_call sums = begin(p, "patch_sums");
  ERN_CL_ARGS(&sums, figures, p->gradient, (float)part_of(p->args, k), p->side[k], p->total[k]);
  status = ern_cl_each(&sums, lines);
  if (status != ERN_OK) { /* discards the pending results */
    sums.stream->pending_count--;
    sums.stream->figures_used -= lines;
  }
fail:
  return status;
}

/* From the gradients to those by the scale's pixels, or by the rays. */
static ern_status backward(const struct patch_pass *p, size_t k) {
  ern_status status = ERN_OK;
  struct ern_cl_call columns = begin(p, "patch_columns_bwd");
  ERN_CL_ARGS(&columns, p->between, p->gradient, p->filter[k]);
  ERN_TRY(run(p, &columns, k));
  struct ern_cl_call back = begin(p, k > 0 ? "patch_bwd" : "patch_rays_bwd");
  if (k > 0)
    ern_cl_span(&back, p->d[k]);
  else
    ern_cl_rows(&back, p->args->dpixel);
  ERN_CL_ARGS(&back, p->x[k], p->y[k], p->between, p->filter[k], k + 1 < SCALES ? p->d[k + 1] : (ern_span){0},
              (float)part_of(p->args, k));
  ERN_TRY(run(p, &back, k));
fail:
  return status;
}

ern_status ern_cl_patch_loss(struct ern_stream *stream, struct ern_patch_loss_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  struct patch_pass pass = {.stream = stream, .args = a, .planes = 3 * a->patches};
  ern_status status = ERN_OK;
  a->term = 0;
  if (a->patches == 0) return ERN_OK;
  ERN_TRY(take(&pass));
  ERN_TRY(make_scales(&pass));
  for (size_t k = SCALES; k-- > 0;) {
    ERN_TRY(make_gradients(&pass, k));
    ERN_TRY(backward(&pass, k));
  }
fail:
  ern_arena_release(stream, mark);
  return status;
}
