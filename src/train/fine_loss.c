/* SPDX-License-Identifier: MIT
 * The loss of a step's patches: the backend's, or a callback of the program on the host. */
#include <string.h>

#include "core/backend.h"
#include "core/memory.h"
#include "core/status.h"
#include "ernerf/train.h"
#include "train/step.h"

/* d [3][side^2] of patch `number`, times factor, is added to dpixel; to: [side^2] */
static ern_status add_gradients(struct ern_stream *stream, const struct ern_patch_loss_args *p, size_t number,
                                const float *d, double factor, float *to) {
  const size_t n = (size_t)p->side * (size_t)p->side;
  ern_status status = ERN_OK;
  for (int c = 0; c < 3; c++) {
    const ern_span row = ern_span_part(ern_span_of_row(p->dpixel, c, (number + 1) * n), number * n, n);
    ERN_TRY(stream->backend->download_reals(stream, to, row, n));
    for (size_t i = 0; i < n; i++) to[i] = (float)((double)to[i] + factor * (double)d[(size_t)c * n + i]);
    ERN_TRY(stream->backend->upload_reals(stream, row, to, n));
  }
fail:
  return status;
}

ern_status ern_fine_loss_compute(ern_context *context, const struct ern_fine_loss *loss, const float *pixel,
                                 const float *truth, int side, double *value, float *dpixel) {
  char before[ERN_ERROR_BYTES], after[ERN_ERROR_BYTES];
  ern_error_keep(context, before);
  const ern_status status = loss->compute(loss->user, pixel, truth, side, value, dpixel);
  if (status == ERN_OK) return ERN_OK;
  ern_error_keep(context, after);
  if (strcmp(before, after) != 0) return status;
  return ern_fail(context, status, "train: the loss of patches \"%s\" answered %s", loss->name,
                  ern_status_name(status));
}

static ern_status on_the_host(struct ern_stream *stream, const struct ern_fine_loss *loss,
                              struct ern_patch_loss_args *p) {
  ern_context *context = stream->backend->context;
  const size_t n = (size_t)p->side * (size_t)p->side;
  const double factor = (double)p->weight / (double)p->patches;
  float *pixel = NULL;
  ern_status status = ERN_OK;
  p->term = 0;
  ERN_TRY(ERN_NEW(context, 10 * n, &pixel));
  float *const truth = pixel + 3 * n, *const d = pixel + 6 * n, *const row = pixel + 9 * n;
  for (size_t k = 0; k < p->patches; k++) {
    double value = 0;
    for (int c = 0; c < 3; c++) {
      const ern_span x = ern_span_of_row(p->pixel, c, (k + 1) * n), y = ern_span_of_row(p->truth, c, (k + 1) * n);
      ERN_TRY(stream->backend->download_reals(stream, pixel + (size_t)c * n, ern_span_part(x, k * n, n), n));
      ERN_TRY(stream->backend->download_reals(stream, truth + (size_t)c * n, ern_span_part(y, k * n, n), n));
    }
    ERN_TRY(ern_fine_loss_compute(context, loss, pixel, truth, p->side, &value, d));
    p->term += factor * value;
    ERN_TRY(add_gradients(stream, p, k, d, factor, row));
  }
fail:
  ern_release(context, pixel);
  return status;
}

ern_status ern_step_patch_loss(struct ern_stream *stream, const struct ern_fine_loss *loss,
                               struct ern_patch_loss_args *p) {
  return loss == NULL || p->patches == 0 ? stream->backend->patch_loss(stream, p) : on_the_host(stream, loss, p);
}
