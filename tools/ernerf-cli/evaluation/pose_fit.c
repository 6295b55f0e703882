/* SPDX-License-Identifier: MIT */
#include "evaluation/pose_fit.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "ernerf/train.h"

enum {
  N = 6,           /* a rotation vector about the scene's origin, then a translation */
  ITERATIONS = 12, /* most */
  HALVINGS = 3     /* halvings of a step that makes the picture worse */
};

static const double degree = 3.14159265358979323846 / 180;
static const double probe_turn = 0.1, probe_move = 0.5; /* step of a central difference: degrees, mm */
static const double still_turn = 0.01, still_move = 0.05;
static const double most_turn = 5, most_move = 30; /* limits from the start: beyond, it is another view, not an error */
static const double huber = 0.1;                   /* threshold of the Huber loss, colours 0..1 */

struct search {
  struct evaluation *evaluation;
  ern_renderer *renderer;
  ern_frame_input input;
  size_t width, values; /* of a picture: pixels in a row; 3 width height */
  ern_box left_out;
  float *truth;   /* [height][width][3], as the pictures below */
  double unit[N]; /* unit of each of the six parameters: the length of a probe; radians, scene units */
  float *low, *high;
  double best; /* cost of the best pose so far */
};

/* out: the camera rotated by the rotation vector about the scene's origin, then translated. */
static void move_camera(float out[16], const float pose[16], const double by[N]) {
  const double angle = sqrt(by[0] * by[0] + by[1] * by[1] + by[2] * by[2]);
  const double s = angle > 0 ? sin(angle) / angle : 1, c = angle > 0 ? (1 - cos(angle)) / (angle * angle) : 0.5;
  float moved[16];
  memcpy(moved, pose, sizeof moved);
  for (int column = 0; column < 4; column++) {
    const double v[3] = {(double)pose[column], (double)pose[4 + column], (double)pose[8 + column]};
    const double along = by[0] * v[0] + by[1] * v[1] + by[2] * v[2];
    for (int r = 0; r < 3; r++) { /* Rodrigues */
      const double cross = by[(r + 1) % 3] * v[(r + 2) % 3] - by[(r + 2) % 3] * v[(r + 1) % 3];
      const double turned = cos(angle) * v[r] + s * cross + c * along * by[r];
      moved[4 * r + column] = (float)(turned + (column == 3 ? by[3 + r] : 0));
    }
  }
  memcpy(out, moved, sizeof moved);
}

static int draw(struct search *search, const float pose[16], float *rgb) {
  search->input.head_pose = pose;
  const ern_frame_output output = {.rgb = rgb};
  return ern_renderer_frame(search->renderer, &search->input, &output, NULL) == ERN_OK
             ? 0
             : session_fail(search->evaluation->session);
}

static bool counts(const struct search *search, size_t value) {
  const ern_box *box = &search->left_out;
  const int row = (int)(value / 3 / search->width), column = (int)(value / 3 % search->width);
  return row < box->top || row >= box->bottom || column < box->left || column >= box->right;
}

/* Weight of a residual in iteratively reweighted least squares for the Huber loss. */
static double weight_of(double residual) { return fabs(residual) > huber ? huber / fabs(residual) : 1; }

static double cost_of(const struct search *search, const float *rgb) {
  double cost = 0;
  for (size_t i = 0; i < search->values; i++) {
    if (!counts(search, i)) continue;
    const double size = fabs((double)rgb[i] - (double)search->truth[i]);
    cost += size > huber ? huber * (size - huber / 2) : size * size / 2;
  }
  return cost;
}

/* jacobian[k] = d rgb/d q_k at the pose, q in units of a probe; rows of pixels as in the picture. */
static int find_jacobian(struct search *search, const float pose[16], float *const jacobian[N]) {
  for (int k = 0; k < N; k++) {
    float moved[16];
    double by[N] = {0};
    by[k] = search->unit[k];
    move_camera(moved, pose, by);
    if (draw(search, moved, search->high) != 0) return EXIT_FAILURE;
    by[k] = -search->unit[k];
    move_camera(moved, pose, by);
    if (draw(search, moved, search->low) != 0) return EXIT_FAILURE;
    for (size_t i = 0; i < search->values; i++) jacobian[k][i] = (search->high[i] - search->low[i]) / 2;
  }
  return 0;
}

/* Builds the normal equations sum w J J^T q = -sum w J r; the last column is the right-hand side. */
static void add_up(const struct search *search, const float *rgb, float *const jacobian[N],
                   double equations[N][N + 1]) {
  memset(equations, 0, N * sizeof *equations);
  for (size_t i = 0; i < search->values; i++) {
    if (!counts(search, i)) continue;
    const double residual = (double)rgb[i] - (double)search->truth[i], weight = weight_of(residual);
    for (int a = 0; a < N; a++) {
      for (int b = 0; b < N; b++) equations[a][b] += weight * (double)jacobian[a][i] * (double)jacobian[b][i];
      equations[a][N] -= weight * (double)jacobian[a][i] * residual;
    }
  }
}

/* Gaussian elimination of symmetric equations. The diagonal grows by a thousandth (Levenberg-Marquardt damping), so
 * that parameters without effect on the picture do not move. False if the picture depends on none. */
static bool solve(double equations[N][N + 1], double q[N]) {
  double most = 0;
  for (int k = 0; k < N; k++) most = fmax(most, equations[k][k]);
  if (!(most > 0) || !isfinite(most)) return false;
  for (int k = 0; k < N; k++) equations[k][k] += 1e-3 * equations[k][k] + 1e-6 * most;
  for (int k = 0; k < N; k++)
    for (int below = k + 1; below < N; below++) {
      const double factor = equations[below][k] / equations[k][k];
      for (int c = k; c <= N; c++) equations[below][c] -= factor * equations[k][c];
    }
  for (int k = N - 1; k >= 0; k--) {
    q[k] = equations[k][N];
    for (int c = k + 1; c < N; c++) q[k] -= equations[k][c] * q[c];
    q[k] /= equations[k][k];
    if (!isfinite(q[k])) return false;
  }
  return true;
}

/* Rotation of the camera about the origin, and its translation after that rotation. */
static void find_way(const struct search *search, const float from[16], const float to[16], double *turn,
                     double *move) {
  double trace = 0, square = 0;
  for (int r = 0; r < 3; r++) {
    double there = 0;
    for (int i = 0; i < 3; i++) {
      double turned = 0; /* of to from^T */
      for (int c = 0; c < 3; c++) turned += (double)to[4 * r + c] * (double)from[4 * i + c];
      if (i == r) trace += turned;
      there += turned * (double)from[4 * i + 3];
    }
    square += ((double)to[4 * r + 3] - there) * ((double)to[4 * r + 3] - there);
  }
  *turn = acos(fmax(-1, fmin(1, (trace - 1) / 2))) / degree;
  *move = 1000 * sqrt(square) / (double)search->evaluation->scale;
}

/* Takes the step, halved until it improves the picture. *length: in probes; 0: no improvement. rgb: the picture at the
 * new pose. */
static int take_step(struct search *search, const float start[16], float pose[16], float *rgb, double q[N],
                     double *length) {
  *length = 0;
  for (int half = 0; half <= HALVINGS; half++) {
    double by[N], turn, move;
    float moved[16];
    for (int k = 0; k < N; k++) by[k] = q[k] * search->unit[k];
    move_camera(moved, pose, by);
    find_way(search, start, moved, &turn, &move);
    if (turn <= most_turn && move <= most_move) {
      if (draw(search, moved, search->high) != 0) return EXIT_FAILURE;
      const double cost = cost_of(search, search->high);
      if (cost < search->best) {
        search->best = cost;
        memcpy(pose, moved, sizeof moved);
        memcpy(rgb, search->high, search->values * sizeof *rgb);
        for (int k = 0; k < N; k++) *length = fmax(*length, fabs(q[k]));
        return 0;
      }
    }
    for (int k = 0; k < N; k++) q[k] /= 2;
  }
  return 0;
}

static int iterate(struct search *search, float *memory, struct pose_fit *fit) {
  float *jacobian[N], *rgb = memory, start[16];
  for (size_t k = 0; k < N; k++) jacobian[k] = memory + (1 + k) * search->values;
  memcpy(start, search->input.head_pose != NULL ? search->input.head_pose : search->input.camera.pose, sizeof start);
  memcpy(fit->pose, start, sizeof start);
  if (draw(search, start, rgb) != 0) return EXIT_FAILURE;
  search->best = cost_of(search, rgb);
  for (int i = 0; i < ITERATIONS; i++) {
    double equations[N][N + 1], q[N], length;
    if (find_jacobian(search, fit->pose, jacobian) != 0) return EXIT_FAILURE;
    add_up(search, rgb, jacobian, equations);
    if (!solve(equations, q)) break;
    if (take_step(search, start, fit->pose, rgb, q, &length) != 0) return EXIT_FAILURE;
    if (length * probe_turn < still_turn && length * probe_move < still_move) break;
  }
  find_way(search, start, fit->pose, &fit->turn, &fit->move);
  return 0;
}

/* Takes the recorded frame and the mask of excluded pixels. Copies the picture, because evaluate_input may read another
 * one. */
static int take_truth(struct search *search, size_t k) {
  struct evaluation *evaluation = search->evaluation;
  const struct source_frame *source_frame = &evaluation->frame_source.source_frame[k];
  ern_image truth;
  if (evaluate_truth(evaluation, source_frame, &truth) != 0) return EXIT_FAILURE;
  for (size_t i = 0; i < search->values; i++) search->truth[i] = (float)truth.data[i] / 255;
  /* the lower face as in training; empty if the landmarks are not known */
  ern_dataset dataset;
  ern_dataset_frame frame;
  ern_clip_dataset(evaluation->clip, &dataset);
  if (dataset.frame(dataset.user, (int)source_frame->split, source_frame->index, &frame) != ERN_OK)
    return session_fail(evaluation->session);
  search->left_out = frame.lower_face;
  return 0;
}

int pose_fit(struct evaluation *evaluation, ern_renderer *renderer, const ern_model *model, size_t k,
             struct pose_fit *fit) {
  enum { PICTURES = N + 4 }; /* jacobian; the recorded frame, the best, two of a central difference */
  const int width = evaluation->info.width, height = evaluation->info.height;
  struct search search = {.evaluation = evaluation,
                          .renderer = renderer,
                          .width = (size_t)width,
                          .values = 3 * (size_t)width * (size_t)height};
  *fit = (struct pose_fit){.turn = 0};
  for (int i = 0; i < N; i++)
    search.unit[i] = i < 3 ? probe_turn * degree : probe_move / 1000 * (double)evaluation->scale;
  float *memory = malloc(PICTURES * search.values * sizeof *memory);
  if (memory == NULL)
    return session_fail_with(evaluation->session, "no memory for %d pictures of %d x %d", (int)PICTURES, width, height);
  search.truth = memory;
  search.low = memory + search.values;
  search.high = search.low + search.values;
  int status = take_truth(&search, k);
  if (status == 0) status = evaluate_input(evaluation, model, k, &search.input);
  if (status == 0) status = iterate(&search, search.high + search.values, fit);
  free(memory);
  return status;
}
