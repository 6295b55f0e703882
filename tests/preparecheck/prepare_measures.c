/* SPDX-License-Identifier: MIT
 * The measures of prepare_measures.h. */
#include "prepare_measures.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const double degree = 3.14159265358979323846 / 180.0;

static int by_size(const void *a, const void *b) {
  const double x = *(const double *)a, y = *(const double *)b;
  return (x > y) - (x < y);
}

double quantile(double *values, size_t count, double share) {
  if (count == 0) return (double)NAN;
  qsort(values, count, sizeof *values, by_size);
  const double at = share * (double)(count - 1);
  const size_t low = (size_t)at, high = low + 1 < count ? low + 1 : low;
  return values[low] + (at - (double)low) * (values[high] - values[low]);
}

/* ---- rotations --------------------------------------------------------------------------------------------------- */

/* c = a b, a^T b or a b^T. */
static void product(const double a[3][3], bool a_turned, const double b[3][3], bool b_turned, double c[3][3]) {
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) {
      c[i][j] = 0;
      for (int k = 0; k < 3; k++) c[i][j] += (a_turned ? a[k][i] : a[i][k]) * (b_turned ? b[j][k] : b[k][j]);
    }
}

static void apply(const double a[3][3], const double x[3], double y[3]) {
  for (int i = 0; i < 3; i++) y[i] = a[i][0] * x[0] + a[i][1] * x[1] + a[i][2] * x[2];
}

static double length(const double x[3]) { return sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]); }

void nearest_rotation(const double m[3][3], double rotation[3][3]) {
  double n[4][4] = {{m[0][0] + m[1][1] + m[2][2], m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]},
                    {m[2][1] - m[1][2], m[0][0] - m[1][1] - m[2][2], m[0][1] + m[1][0], m[0][2] + m[2][0]},
                    {m[0][2] - m[2][0], m[0][1] + m[1][0], m[1][1] - m[0][0] - m[2][2], m[1][2] + m[2][1]},
                    {m[1][0] - m[0][1], m[0][2] + m[2][0], m[1][2] + m[2][1], m[2][2] - m[0][0] - m[1][1]}};
  double norm = 0;
  for (int i = 0; i < 16; i++) norm += n[i / 4][i % 4] * n[i / 4][i % 4];
  norm = fmax(sqrt(norm), 1e-300);
  for (int i = 0; i < 4; i++) n[i][i] += norm; /* now no eigenvalue is negative: powers keep the largest one's vector */
  for (int power = 0; power < 40; power++) {
    double square[4][4], most = 1e-300;
    for (int i = 0; i < 4; i++)
      for (int j = 0; j < 4; j++) {
        square[i][j] = 0;
        for (int k = 0; k < 4; k++) square[i][j] += n[i][k] * n[k][j];
        most = fmax(most, fabs(square[i][j]));
      }
    for (int i = 0; i < 16; i++) n[i / 4][i % 4] = square[i / 4][i % 4] / most;
  }
  int column = 0;
  for (int j = 1; j < 4; j++)
    if (n[j][j] > n[column][column]) column = j;
  double w = n[0][column], x = n[1][column], y = n[2][column], z = n[3][column];
  const double size = sqrt(w * w + x * x + y * y + z * z);
  w /= size, x /= size, y /= size, z /= size;
  const double r[3][3] = {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
                          {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
                          {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}};
  memcpy(rotation, r, sizeof r);
}

/* Axis times angle (radians). Half turns, whose axis has no sign, do not come up between neighbours. */
static void log_rotation(const double r[3][3], double axis[3]) {
  const double twice[3] = {r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]};
  const double sine = 0.5 * length(twice), cosine = 0.5 * (r[0][0] + r[1][1] + r[2][2] - 1);
  const double scale = sine > 1e-12 ? atan2(sine, cosine) / (2 * sine) : 0.5;
  for (int i = 0; i < 3; i++) axis[i] = scale * twice[i];
}

double rotation_angle(const double a[3][3], const double b[3][3]) {
  double between[3][3], sum = 0;
  product(a, true, b, false, between);
  const double twice[3] = {between[2][1] - between[1][2], between[0][2] - between[2][0], between[1][0] - between[0][1]};
  for (int i = 0; i < 3; i++) sum += between[i][i];
  return atan2(0.5 * length(twice), 0.5 * (sum - 1)) / degree;
}

/* ---- paths ------------------------------------------------------------------------------------------------------- */

static void add(double sum[3][3], const double term[3][3]) {
  for (int i = 0; i < 9; i++) sum[i / 3][i % 3] += term[i / 3][i % 3];
}

/* Alternating: each of A and B is the nearest rotation while the other one stands. Of a head that turns by an angle v
 * (radians) a round takes about v^2 of what is missing. */
static void align_rotations(const struct head_pose *truth, const struct head_pose *prepared, size_t count,
                            struct path_alignment *alignment) {
  const double none[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  memcpy(alignment->camera, none, sizeof none);
  double change = 180;
  for (int round = 0; round < 5000 && change > 1e-9; round++) {
    double sum[3][3] = {{0}}, half[3][3], term[3][3], last[3][3];
    memcpy(last, alignment->camera, sizeof last);
    for (size_t i = 0; i < count; i++) {
      product(alignment->camera, false, truth[i].rotation, false, half);
      product(half, true, prepared[i].rotation, false, term);
      add(sum, term);
    }
    nearest_rotation(sum, alignment->head);
    memset(sum, 0, sizeof sum);
    for (size_t i = 0; i < count; i++) {
      product(truth[i].rotation, false, alignment->head, false, half);
      product(prepared[i].rotation, false, half, true, term);
      add(sum, term);
    }
    nearest_rotation(sum, alignment->camera);
    change = rotation_angle(last, alignment->camera);
  }
}

/* a x = b, 4 unknowns, a symmetric and positive. */
static void solve(double a[4][4], double b[4]) {
  for (int k = 0; k < 4; k++)
    for (int i = k + 1; i < 4; i++) {
      const double share = a[i][k] / a[k][k];
      for (int j = k; j < 4; j++) a[i][j] -= share * a[k][j];
      b[i] -= share * b[k];
    }
  for (int k = 3; k >= 0; k--) {
    for (int j = k + 1; j < 4; j++) b[k] -= a[k][j] * b[j];
    b[k] /= a[k][k];
  }
}

/* Scale s and origin o of: s p_i = A (R_i o + t_i), least squares. A path that hardly turns cannot tell a nearer origin
 * from a larger scale; a pull of the origin to 0 of a millionth decides then. */
static void align_places(const struct head_pose *truth, double (*places)[3], size_t count,
                         struct path_alignment *alignment) {
  double a[4][4] = {{0}}, b[4] = {0};
  for (size_t i = 0; i < count; i++) {
    double turned[3][3], at[3];
    product(alignment->camera, false, truth[i].rotation, false, turned);
    apply(alignment->camera, truth[i].place, at);
    for (int row = 0; row < 3; row++) {
      const double terms[4] = {places[i][row], -turned[row][0], -turned[row][1], -turned[row][2]};
      for (int j = 0; j < 4; j++) {
        for (int k = 0; k < 4; k++) a[j][k] += terms[j] * terms[k];
        b[j] += terms[j] * at[row];
      }
    }
  }
  for (int j = 0; j < 4; j++) a[j][j] += 1e-6 * (double)count * (j > 0 ? 1.0 : 1e-6);
  solve(a, b);
  alignment->scale = b[0];
  memcpy(alignment->origin, b + 1, sizeof alignment->origin);
}

/* Mean norm of what the step from frame i to i + 1 has over the step before it, over frames that follow each other. */
static double place_tremble(const struct head_pose *poses, double (*places)[3], size_t count, size_t *seconds) {
  double sum = 0;
  *seconds = 0;
  for (size_t i = 1; i + 1 < count; i++) {
    if (poses[i + 1].frame - poses[i - 1].frame != 2) continue;
    double second[3];
    for (int k = 0; k < 3; k++) second[k] = places[i + 1][k] - 2 * places[i][k] + places[i - 1][k];
    sum += length(second);
    ++*seconds;
  }
  return *seconds > 0 ? sum / (double)*seconds : (double)NAN;
}

/* Degrees. log(R_i^T R_{i+1}) keeps its length under A and B. */
static double rotation_tremble(const struct head_pose *poses, size_t count) {
  double sum = 0;
  size_t seconds = 0;
  for (size_t i = 1; i + 1 < count; i++) {
    if (poses[i + 1].frame - poses[i - 1].frame != 2) continue;
    double step[3][3], before[3], after[3], second[3];
    product(poses[i - 1].rotation, true, poses[i].rotation, false, step);
    log_rotation(step, before);
    product(poses[i].rotation, true, poses[i + 1].rotation, false, step);
    log_rotation(step, after);
    for (int k = 0; k < 3; k++) second[k] = after[k] - before[k];
    sum += length(second) / degree;
    ++seconds;
  }
  return seconds > 0 ? sum / (double)seconds : (double)NAN;
}

/* What is below a millionth of a degree, or of a unit, is rounding of the file: the truth stands still. */
static double ratio(const double tremble[2]) { return tremble[0] > 1e-6 ? tremble[1] / tremble[0] : (double)NAN; }

bool compare_paths(const struct head_pose *truth, const struct head_pose *prepared, size_t count, double focal_ratio,
                   struct path_alignment *alignment, struct path_errors *errors) {
  if (count < 3) return false;
  double *values = calloc(count, sizeof *values);
  double(*places)[3] = calloc(count, sizeof *places), (*expected)[3] = calloc(count, sizeof *expected);
  const bool allocated = values != NULL && places != NULL && expected != NULL;
  if (allocated) {
    const double none[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    align_rotations(truth, prepared, count, alignment);
    for (size_t i = 0; i < count; i++) {
      double half[3][3], aligned[3][3];
      product(alignment->camera, false, truth[i].rotation, false, half);
      product(half, false, alignment->head, false, aligned);
      values[i] = rotation_angle(aligned, prepared[i].rotation);
      for (int k = 0; k < 3; k++) places[i][k] = prepared[i].place[k] / (k == 2 ? focal_ratio : 1.0);
    }
    errors->rotation_median = quantile(values, count, 0.5);
    errors->rotation_p95 = quantile(values, count, 0.95);
    errors->camera_turn = rotation_angle(none, alignment->camera);
    align_places(truth, places, count, alignment);
    for (size_t i = 0; i < count; i++) {
      double at[3], off[3];
      apply(truth[i].rotation, alignment->origin, at);
      for (int k = 0; k < 3; k++) at[k] += truth[i].place[k];
      apply(alignment->camera, at, expected[i]);
      for (int k = 0; k < 3; k++) off[k] = (places[i][k] *= alignment->scale) - expected[i][k];
      values[i] = length(off) / length(expected[i]);
    }
    errors->place_median = quantile(values, count, 0.5);
    errors->place_tremble[0] = place_tremble(truth, expected, count, &errors->seconds);
    errors->place_tremble[1] = place_tremble(prepared, places, count, &errors->seconds);
    errors->rotation_tremble[0] = rotation_tremble(truth, count);
    errors->rotation_tremble[1] = rotation_tremble(prepared, count);
    errors->rotation_tremble_ratio = ratio(errors->rotation_tremble);
    errors->place_tremble_ratio = ratio(errors->place_tremble);
  }
  free(values);
  free(places);
  free(expected);
  return allocated;
}

/* ---- landmarks, layers, blinks ----------------------------------------------------------------------------------- */

static void middle(float points[68][2], int first, int last, double centre[2]) {
  centre[0] = centre[1] = 0;
  for (int k = first; k <= last; k++)
    for (int c = 0; c < 2; c++) centre[c] += (double)points[k][c] / (last - first + 1);
}

double mouth_error(float truth[68][2], float prepared[68][2], const struct crop *crop) {
  double eyes[2][2], mouth[2], found[2];
  middle(truth, 36, 41, eyes[0]);
  middle(truth, 42, 47, eyes[1]);
  middle(truth, 48, 67, mouth);
  middle(prepared, 48, 67, found);
  const double x = crop->x + found[0] * crop->side / crop->size, y = crop->y + found[1] * crop->side / crop->size;
  return hypot(x - mouth[0], y - mouth[1]) / hypot(eyes[0][0] - eyes[1][0], eyes[0][1] - eyes[1][1]);
}

enum layer layer_of(const uint8_t rgb[3]) {
  static const uint8_t colours[LAYER_OTHER][3] = {{255, 255, 255}, {0, 0, 255}, {0, 255, 0}, {255, 0, 0}};
  for (int k = 0; k < LAYER_OTHER; k++)
    if (memcmp(rgb, colours[k], 3) == 0) return (enum layer)k;
  return LAYER_OTHER;
}

void compare_layers(struct layer_map truth, struct layer_map prepared, const struct crop *crop, double *person,
                    double *head) {
  size_t both[2] = {0}, either[2] = {0};
  for (int y = 0; y < truth.height; y++)
    for (int x = 0; x < truth.width; x++) {
      const double column = (x + 0.5 - crop->x) * crop->size / crop->side;
      const double row = (y + 0.5 - crop->y) * crop->size / crop->side;
      if (!(column >= 0 && row >= 0 && column < prepared.width && row < prepared.height)) continue;
      const size_t from = (size_t)row * (size_t)prepared.width + (size_t)column;
      const enum layer is = layer_of(truth.rgb + 3 * ((size_t)y * (size_t)truth.width + (size_t)x));
      const enum layer found = layer_of(prepared.rgb + 3 * from);
      both[0] += is != LAYER_BACKGROUND && found != LAYER_BACKGROUND;
      either[0] += is != LAYER_BACKGROUND || found != LAYER_BACKGROUND;
      both[1] += is == LAYER_HEAD && found == LAYER_HEAD;
      either[1] += is == LAYER_HEAD || found == LAYER_HEAD;
    }
  *person = either[0] > 0 ? (double)both[0] / (double)either[0] : 1.0;
  *head = either[1] > 0 ? (double)both[1] / (double)either[1] : 1.0;
}

size_t find_blinks(const float *closed, size_t count, struct blink *blinks) {
  double *sorted = calloc(count > 0 ? count : 1, sizeof *sorted);
  if (sorted == NULL) return SIZE_MAX;
  for (size_t i = 0; i < count; i++) sorted[i] = (double)closed[i];
  const double threshold = count > 0 ? 0.5 * quantile(sorted, count, 0.99) : 0.0;
  size_t found = 0;
  free(sorted);
  if (threshold <= 0.0) return 0;
  for (size_t i = 0; i < count; i++) {
    if (!((double)closed[i] > threshold)) continue;
    if (found > 0 && i - blinks[found - 1].last <= 2)
      blinks[found - 1].last = i;
    else
      blinks[found++] = (struct blink){i, i};
  }
  return found;
}

size_t match_blinks(const struct blink *truth, size_t truths, const struct blink *prepared, size_t prepareds) {
  size_t matched = 0, at = 0;
  for (size_t i = 0; i < truths; i++) {
    while (at < prepareds && prepared[at].last + 1 < truth[i].first) at++;
    if (at < prepareds && prepared[at].first <= truth[i].last + 1) {
      matched++;
      at++;
    }
  }
  return matched;
}
