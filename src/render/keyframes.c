/* SPDX-License-Identifier: MIT */
#include "render/keyframes.h"

#include <math.h>
#include <string.h>

#include "core/memory.h"
#include "core/status.h"

enum { SIDE = ERN_KEYFRAMES + 1 };

static const double kernel_width = 3; /* widths of the speech */
static const double nugget = 1e-10;   /* added to the diagonal so that the matrix can be inverted in double */

ern_status ern_speech_frame_code(struct ern_stream *stream, const struct ern_field *field, ern_span parameters,
                                 const struct ern_speech_frame *frame, ern_span *code) {
  const size_t values = (size_t)ERN_AUDIO_WINDOWS * (size_t)frame->window_length * (size_t)field->config.feature_width;
  struct ern_audio_fwd_args args = {.parameters = parameters, .net = field->audio};
  ern_status status = ERN_OK;
  args.net.window_length = frame->window_length;
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, ERN_AUDIO_CODE, &args.code));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, values, &args.windows));
  ERN_TRY(stream->backend->upload_reals(stream, args.windows, frame->windows, values));
  ERN_TRY(stream->backend->audio_fwd(stream, &args));
  *code = args.code;
fail:
  return status;
}

/* ---- distances --------------------------------------------------------------------------------------------------- */

/* Squared distance. */
static double apart(const float *a, const float *b) {
  double sum = 0;
  for (size_t c = 0; c < ERN_AUDIO_CODE; c++) sum += ((double)a[c] - (double)b[c]) * ((double)a[c] - (double)b[c]);
  return sum;
}

/* |z_k - z| */
static double distance(const struct ern_keyframes *m, size_t k, const float *code, float eye) {
  const double lids = (double)m->eye[k] - (double)eye;
  return sqrt(m->scale * m->scale * apart(m->code[k], code) + lids * lids);
}

/* Matern's 5/2 */
static double kernel(double distance) {
  const double r = sqrt(5) * distance / kernel_width;
  return (1 + r + r * r / 3) * exp(-r);
}

/* 1/(twice the distance from the mean of the codes to the farthest). A speech with a single code gets the width 1e-6,
 * so that every other code is far from it. */
static double scale_of(const float *code, size_t count) {
  float middle[ERN_AUDIO_CODE];
  double most = 0;
  for (size_t c = 0; c < ERN_AUDIO_CODE; c++) {
    double sum = 0;
    for (size_t k = 0; k < count; k++) sum += (double)code[k * ERN_AUDIO_CODE + c];
    middle[c] = (float)(sum / (double)count);
  }
  for (size_t k = 0; k < count; k++) most = fmax(most, apart(middle, code + k * ERN_AUDIO_CODE));
  return 0.5 / sqrt(fmax(most, 1e-12));
}

/* ---- the choice -------------------------------------------------------------------------------------------------- */

/* away: [count], how far each frame is from those that were chosen */
static void choose(struct ern_keyframes *m, const float *code, const struct ern_speech_frame *frame, double *away,
                   size_t count) {
  const double least = 1e-4; /* closer frames count as equal */
  for (size_t k = 0; k < count; k++) away[k] = INFINITY;
  for (size_t next = 0; m->count < ERN_KEYFRAMES;) {
    const size_t chosen = m->count++;
    memcpy(m->code[chosen], code + next * ERN_AUDIO_CODE, sizeof m->code[chosen]);
    m->eye[chosen] = frame[next].eye;
    for (size_t k = 0; k < count; k++)
      away[k] = fmin(away[k], distance(m, chosen, code + k * ERN_AUDIO_CODE, frame[k].eye));
    for (size_t k = 0; k < count; k++)
      if (away[k] > away[next]) next = k;
    if (!(away[next] > least)) break;
  }
}

/* Gauss-Jordan elimination with the largest pivot of a column. False where the matrix cannot be inverted. */
static bool invert(double inverse[SIDE][SIDE], double a[SIDE][SIDE], size_t n) {
  for (size_t i = 0; i < n; i++)
    for (size_t j = 0; j < n; j++) inverse[i][j] = i == j;
  for (size_t column = 0; column < n; column++) {
    size_t best = column;
    for (size_t i = column + 1; i < n; i++)
      if (fabs(a[i][column]) > fabs(a[best][column])) best = i;
    const double pivot = a[best][column];
    if (!(fabs(pivot) > 0)) return false;
    for (size_t j = 0; j < n; j++) {
      const double upper = a[best][j], right = inverse[best][j];
      a[best][j] = a[column][j], inverse[best][j] = inverse[column][j];
      a[column][j] = upper / pivot, inverse[column][j] = right / pivot;
    }
    for (size_t i = 0; i < n; i++) {
      const double factor = a[i][column];
      if (i == column) continue;
      for (size_t j = 0; j < n; j++) {
        a[i][j] -= factor * a[column][j];
        inverse[i][j] -= factor * inverse[column][j];
      }
    }
  }
  return true;
}

static bool solve(struct ern_keyframes *m) {
  double matrix[SIDE][SIDE] = {{0}};
  const size_t n = m->count;
  for (size_t i = 0; i < n; i++) {
    for (size_t j = 0; j < n; j++) matrix[i][j] = kernel(distance(m, i, m->code[j], m->eye[j])) + (i == j ? nugget : 0);
    matrix[i][n] = matrix[n][i] = 1;
  }
  if (!invert(m->inverse, matrix, n + 1)) return false;
  for (size_t k = 0; k < n; k++) m->variance = fmax(m->variance, 1 / m->inverse[k][k]);
  return true;
}

ern_status ern_keyframes_choose(struct ern_keyframes *keyframes, struct ern_stream *stream,
                                const struct ern_field *field, ern_span parameters,
                                const struct ern_speech_frame *frame, size_t count) {
  ern_context *context = stream->backend->context;
  float *code = NULL;
  double *away = NULL;
  ern_status status = ERN_OK;
  *keyframes = (struct ern_keyframes){0};
  ERN_TRY(ERN_NEW(context, count * ERN_AUDIO_CODE, &code));
  ERN_TRY(ERN_NEW(context, count, &away));
  for (size_t k = 0; k < count && status == ERN_OK; k++) {
    const struct ern_arena_mark mark = ern_arena_mark(stream);
    ern_span span;
    status = ern_speech_frame_code(stream, field, parameters, &frame[k], &span);
    if (status == ERN_OK)
      status = stream->backend->download_reals(stream, code + k * ERN_AUDIO_CODE, span, ERN_AUDIO_CODE);
    ern_arena_release(stream, mark);
  }
  if (status != ERN_OK) goto fail;
  keyframes->scale = scale_of(code, count);
  choose(keyframes, code, frame, away, count);
  if (!solve(keyframes))
    status = ern_fail(context, ERN_E_NONFINITE, "render: the audio codes of the speech's frames are not numbers");
fail:
  ern_release(context, away);
  ern_release(context, code);
  return status;
}

/* ---- between them ------------------------------------------------------------------------------------------------ */

bool ern_keyframes_weigh(float weight[ERN_KEYFRAMES], const struct ern_keyframes *m, const float code[ERN_AUDIO_CODE],
                         float eye) {
  const size_t n = m->count;
  double near[SIDE] = {0}, explained = 0;
  for (size_t k = 0; k < n; k++) near[k] = kernel(distance(m, k, code, eye));
  near[n] = 1;
  for (size_t k = 0; k <= n; k++) {
    double sum = 0;
    for (size_t j = 0; j <= n; j++) sum += m->inverse[k][j] * near[j];
    explained += near[k] * sum;
    if (k < n) weight[k] = (float)sum;
  }
  return kernel(0) - explained <= m->variance; /* the kriging variance at z */
}

void ern_keyframes_error(float error[ERN_KEYFRAMES], const struct ern_keyframes *m, const float *value, size_t stride) {
  for (size_t k = 0; k < m->count; k++) {
    double sum = 0;
    for (size_t j = 0; j < m->count; j++) sum += m->inverse[k][j] * (double)value[j * stride];
    error[k] = m->count < 3 ? INFINITY : (float)(sum / m->inverse[k][k]);
  }
}
