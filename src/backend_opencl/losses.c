/* SPDX-License-Identifier: MIT
 * Slots of the losses: the parts' shares of a result are added up in double when the stream is synchronized. */
#include "backend_opencl/opencl.h"
#include "core/rng.h"
#include "train/losses_ops.h"

/* After the launch that fills the `count` results requested last: where it failed, `synchronize` must not deliver
 * them. */
static ern_status filled(struct ern_cl_call *call, size_t count, ern_status status) {
  if (status == ERN_OK) return ERN_OK;
  call->stream->pending_count--;
  call->stream->figures_used -= count;
  return status;
}

/* Layout of struct head_factors in kernels/losses.cl. */
struct head_factors {
  cl_float by_pixel, by_uncertainty, by_outside, by_entropy, by_audio, by_eye;
  cl_float s, mean, rays;
  cl_int adaptive;
};
_Static_assert(sizeof(struct head_factors) == 10 * 4, "the same in losses.cl");

static struct head_factors factors_of(const struct ern_head_loss_args *a) {
  const struct ern_loss_weights *w = &a->weights;
  const double mean = 1 / (double)a->n, s = (double)w->s;
  return (struct head_factors){.by_pixel = (float)(2 * mean / 3),
                               .by_uncertainty = (float)((double)(w->uncertainty * w->s) * mean),
                               .by_outside = (float)((double)(w->static_uncertainty * w->s) * mean),
                               .by_entropy = (float)((double)w->entropy * mean),
                               .by_audio = (float)((double)(w->audio_ambient * w->s) * mean),
                               .by_eye = (float)((double)(w->eye_ambient * w->s) * mean / a->max_steps),
                               .s = (float)s,
                               .mean = (float)mean,
                               .rays = (float)a->n,
                               .adaptive = w->adaptive};
}

/* The order of a part's results. */
static const ern_loss_term head_term[] = {ERN_LOSS_PHOTOMETRIC, ERN_LOSS_UNCERTAINTY,   ERN_LOSS_STATIC_UNCERTAINTY,
                                          ERN_LOSS_ENTROPY,     ERN_LOSS_AUDIO_AMBIENT, ERN_LOSS_EYE_AMBIENT};
enum { HEAD_TERMS = sizeof head_term / sizeof *head_term };

static void head_loss_deliver(void *args, const float *values, size_t count) {
  struct ern_head_loss_args *a = args;
  const struct ern_loss_weights *w = &a->weights;
  const double s = (double)w->s;
  const double weight[HEAD_TERMS] = {1,
                                     (double)w->uncertainty * s,
                                     (double)w->static_uncertainty * s,
                                     (double)w->entropy,
                                     (double)w->audio_ambient * s,
                                     (double)w->eye_ambient * s / a->max_steps};
  for (size_t t = 0; t < HEAD_TERMS; t++) {
    double sum = 0;
    for (size_t part = 0; part < count / HEAD_TERMS; part++) sum += (double)values[part * HEAD_TERMS + t];
    a->terms[head_term[t]] = weight[t] * sum;
  }
}

static ern_status head_softmax(struct ern_stream *stream, ern_span most, ern_span sum, ern_span uncertainty, size_t n) {
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_losses, "head_softmax", "");
  ERN_CL_ARGS(&call, most, sum, uncertainty, n);
  return ern_cl_run_sums(&call);
}

ern_status ern_cl_head_loss(struct ern_stream *stream, struct ern_head_loss_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  ern_status status = ERN_OK;
  ern_span most = {0}, sum = {0}, terms;
  for (size_t t = 0; t < HEAD_TERMS; t++) a->terms[head_term[t]] = 0;
  if (a->n == 0) return ERN_OK;
  const struct head_factors factors = factors_of(a);
  if (a->weights.adaptive) {
    ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, ERN_CL_SUMS, &most));
    ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, ERN_CL_SUMS, &sum));
    ERN_TRY(head_softmax(stream, most, sum, a->uncertainty, a->n));
  }
  ERN_TRY(ern_cl_figures(stream, ERN_CL_SUMS * HEAD_TERMS, head_loss_deliver, a, &terms));
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_losses, "head_loss", "");
  ERN_CL_ARGS(&call, terms, a->dpixel, a->dopacity, a->dattention, a->deye, a->duncertainty, a->pixel, a->truth,
              a->opacity, a->attention, a->eye, a->uncertainty, a->face, most, sum);
  ern_cl_value(&call, &factors, sizeof factors);
  ern_cl_size(&call, a->n);
  ERN_TRY(filled(&call, ERN_CL_SUMS * HEAD_TERMS, ern_cl_run_sums(&call)));
fail:
  ern_arena_release(stream, mark);
  return status;
}

enum { SQUARES = 3 }; /* sums of a part: normal values; huge ones times 2^-160; tiny ones times 2^160 */

static double squares_of(const float *values, size_t count) {
  double sum = 0;
  for (size_t i = 0; i < count; i += SQUARES)
    sum += (double)values[i] + (double)values[i + 1] * 0x1p160 + (double)values[i + 2] * 0x1p-160;
  return sum;
}

static void smooth_loss_deliver(void *args, const float *values, size_t count) {
  struct ern_smooth_loss_args *a = args;
  a->term = (double)a->weight / (double)a->batch * squares_of(values, count);
}

ern_status ern_cl_smooth_loss(struct ern_stream *stream, struct ern_smooth_loss_args *a) {
  ern_span squares;
  a->term = 0;
  if (a->n == 0 || a->batch == 0) return ERN_OK;
  const ern_status status = ern_cl_figures(stream, ERN_CL_SUMS * SQUARES, smooth_loss_deliver, a, &squares);
  if (status != ERN_OK) return status;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_losses, "smooth_loss", "");
  ERN_CL_ARGS(&call, squares, a->dmoved, a->still, a->moved, (float)(2 * ((double)a->weight / (double)a->batch)), a->n);
  return filled(&call, ERN_CL_SUMS * SQUARES, ern_cl_run_sums(&call));
}

ern_status ern_cl_smooth_points(struct ern_stream *stream, struct ern_smooth_points_args *a) {
  if (a->n == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_losses, "smooth_points", "");
  ERN_CL_ARGS(&call, a->moved, a->x, a->reach);
  ern_cl_value(&call, &a->seed, sizeof a->seed);
  ern_cl_value(&call, &a->step, sizeof a->step);
  ERN_CL_ARGS(&call, a->first, ERN_RNG_SMOOTH, a->n);
  const size_t width = (size_t)ern_cl_stream_of(stream)->owner->device.width;
  return ern_cl_each(&call, (a->n + width - 1) / width);
}

static void mse_deliver(void *args, const float *values, size_t count) {
  struct ern_mse_args *a = args;
  a->term = squares_of(values, count) * (1 / (3 * (double)a->n));
}

ern_status ern_cl_mse(struct ern_stream *stream, struct ern_mse_args *a) {
  ern_span squares;
  a->term = 0;
  if (a->n == 0) return ERN_OK;
  const ern_status status = ern_cl_figures(stream, ERN_CL_SUMS * SQUARES, mse_deliver, a, &squares);
  if (status != ERN_OK) return status;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_losses, "mse", "");
  ERN_CL_ARGS(&call, squares, a->dpixel, a->pixel, a->truth, (float)(2 * (1 / (3 * (double)a->n))), a->n);
  return filled(&call, ERN_CL_SUMS * SQUARES, ern_cl_run_sums(&call));
}

static void key_points_loss_deliver(void *args, const float *values, size_t count) {
  struct ern_key_points_loss_args *a = args;
  double sum = 0;
  for (size_t point = 0; point < count; point++) sum += (double)values[point] * (double)values[point];
  a->term = sum / (double)count;
}

ern_status ern_cl_key_points_loss(struct ern_stream *stream, struct ern_key_points_loss_args *a) {
  enum { POINTS = 3 };
  ern_span short_of;
  const ern_status status = ern_cl_figures(stream, POINTS, key_points_loss_deliver, a, &short_of);
  if (status != ERN_OK) return status;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_losses, "key_points_loss", "");
  ERN_CL_ARGS(&call, short_of, a->danchors, a->anchors);
  return filled(&call, POINTS, ern_cl_each(&call, POINTS));
}

static void pose_bwd_deliver(void *args, const float *values, size_t count) {
  struct ern_pose_bwd_args *a = args;
  for (size_t i = 0; i < count; i++) a->dpose[i % ERN_POSE_PARAMETERS] += (double)values[i];
}

ern_status ern_cl_pose_bwd(struct ern_stream *stream, struct ern_pose_bwd_args *a) {
  ern_span sums;
  for (size_t k = 0; k < ERN_POSE_PARAMETERS; k++) a->dpose[k] = 0;
  if (a->n == 0) return ERN_OK;
  const ern_status status = ern_cl_figures(stream, ERN_CL_SUMS * ERN_POSE_PARAMETERS, pose_bwd_deliver, a, &sums);
  if (status != ERN_OK) return status;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_losses, "pose_bwd", "");
  ERN_CL_ARGS(&call, sums, a->dx, a->x, a->dd, a->d, a->weight, a->n);
  return filled(&call, ERN_CL_SUMS * ERN_POSE_PARAMETERS, ern_cl_run_sums(&call));
}
