/* SPDX-License-Identifier: MIT
 * Measures a clip's variety: how far eyes, head, torso, speech and light change from frame to frame. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "core/sized.h"
#include "media/clip/clip.h"

enum { LOOKED_MOST = 48, POSE_TERMS = 4, BLINK_FRAMES = 3 /* a blink lasts 0.1 to 0.4 s */ };

static const double degree = 3.14159265358979323846 / 180;

/* ---- poses ------------------------------------------------------------------------------------------------------- */

/* The angle between two unit vectors, in degrees; accurate for small angles, where arccos is not. */
static double angle_between(const double a[3], const double b[3]) {
  double far = 0, near = 0;
  for (int i = 0; i < 3; i++) {
    far += (a[i] - b[i]) * (a[i] - b[i]);
    near += (a[i] + b[i]) * (a[i] + b[i]);
  }
  return 2 * atan2(sqrt(far), sqrt(near)) / degree;
}

/* The direction from the head (the scene's origin) to the camera: a unit vector, or 0 where the camera is at the
 * origin. */
static void direction_of(const float pose[16], double direction[3]) {
  double length = 0;
  for (int i = 0; i < 3; i++) length += (double)pose[4 * i + 3] * (double)pose[4 * i + 3];
  length = sqrt(length);
  for (int i = 0; i < 3; i++) direction[i] = length > 0 ? (double)pose[4 * i + 3] / length : 0;
}

/* The angle of the rotation between two poses: |R - S| (Frobenius) = 2 sqrt(2) sin(angle/2). */
static double rotation_between(const float a[16], const float b[16]) {
  double sum = 0;
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) {
      const double difference = (double)a[4 * i + j] - (double)b[4 * i + j];
      sum += difference * difference;
    }
  return 2 * asin(fmin(1, sqrt(sum / 8))) / degree;
}

/* The widest angle between two camera directions, that of the least cosine. A clip of 45,000 frames takes a second. */
static ern_status measure_turn(const ern_clip *clip, ern_clip_measures *m) {
  double(*direction)[3] = NULL, least = 1;
  size_t one = 0, other = 0;
  const ern_status status = ERN_NEW(ern_clip_context(clip), m->frames, &direction);
  if (status != ERN_OK) return status;
  for (size_t i = 0; i < m->frames; i++) {
    const double *here = direction[i];
    direction_of(ern_clip_frame_at(clip, ERN_SPLIT_TRAIN, i)->pose.matrix, direction[i]);
    for (size_t j = 0; j < i; j++) {
      const double cosine = here[0] * direction[j][0] + here[1] * direction[j][1] + here[2] * direction[j][2];
      if (cosine < least) least = cosine, one = j, other = i;
    }
  }
  if (m->frames > 0) m->turn = angle_between(direction[one], direction[other]);
  ern_release(ern_clip_context(clip), direction);
  return ERN_OK;
}

static void measure_poses(const ern_clip *clip, ern_clip_measures *m) {
  const float *first = ern_clip_frame_at(clip, ERN_SPLIT_TRAIN, 0)->pose.matrix;
  double distance = 0;
  for (int i = 0; i < 3; i++) distance += (double)first[4 * i + 3] * (double)first[4 * i + 3];
  for (size_t f = 0; f < m->frames; f++) {
    const float *pose = ern_clip_frame_at(clip, ERN_SPLIT_TRAIN, f)->pose.matrix;
    double way = 0;
    for (int i = 0; i < 3; i++) {
      const double step = (double)pose[4 * i + 3] - (double)first[4 * i + 3];
      way += step * step;
    }
    m->camera_turn = fmax(m->camera_turn, rotation_between(first, pose));
    if (distance > 0) m->camera_shift = fmax(m->camera_shift, sqrt(way / distance));
  }
}

/* Inserts a value into the BLINK_FRAMES least ones, in ascending order. */
static void keep_least(float least[BLINK_FRAMES], float value) {
  for (int i = 0; i < BLINK_FRAMES; i++)
    if (value < least[i]) {
      const float next = least[i];
      least[i] = value;
      value = next;
    }
}

void ern_clip_eye_range(const float *values, size_t count, float *low, float *high) {
  float least[BLINK_FRAMES] = {FLT_MAX, FLT_MAX, FLT_MAX}, greatest[BLINK_FRAMES] = {FLT_MAX, FLT_MAX, FLT_MAX};
  *low = *high = 0;
  if (count == 0) return;
  for (size_t i = 0; i < count; i++) {
    keep_least(least, values[i]);
    keep_least(greatest, -values[i]);
  }
  const size_t half = (count + 1) / 2, last = (half < BLINK_FRAMES ? half : BLINK_FRAMES) - 1; /* *low <= *high */
  *low = least[last];
  *high = -greatest[last];
}

static ern_status measure_eyes(const ern_clip *clip, ern_clip_measures *m) {
  float *values = NULL;
  const ern_status status = ERN_NEW(ern_clip_context(clip), m->frames, &values);
  if (status != ERN_OK) return status;
  for (size_t f = 0; f < m->frames; f++) values[f] = ern_clip_frame_at(clip, ERN_SPLIT_TRAIN, f)->eye;
  ern_clip_eye_range(values, m->frames, &m->eye_low, &m->eye_high);
  ern_release(ern_clip_context(clip), values);
  return ERN_OK;
}

/* ---- speech ------------------------------------------------------------------------------------------------------ */

ern_status ern_clip_feature_change(ern_context *context, const ern_features *features, double *relative) {
  const size_t width = (size_t)features->window_length * (size_t)features->width;
  double *mean = NULL, change = 0, all = 0;
  const ern_status status = ERN_NEW(context, width, &mean);
  if (status != ERN_OK) return status;
  for (size_t t = 0; t < features->windows; t++)
    for (size_t i = 0; i < width; i++) mean[i] += (double)features->data[t * width + i] / (double)features->windows;
  for (size_t t = 0; t < features->windows; t++)
    for (size_t i = 0; i < width; i++) {
      const double value = (double)features->data[t * width + i];
      change += (value - mean[i]) * (value - mean[i]);
      all += value * value;
    }
  *relative = all > 0 ? sqrt(change / all) : 0;
  ern_release(context, mean);
  return ERN_OK;
}

/* Only the viewer needs the sound, so one that cannot be read counts as none. */
static ern_status measure_sound(const ern_clip *clip, ern_clip_measures *m) {
  static const double least = 0.00316227766 * 32768; /* -50 dB of full scale */
  ern_sound sound = {0};
  m->loud = -1;
  const ern_status status = ern_clip_sound(clip, &sound);
  if (status != ERN_OK) return status == ERN_E_NO_MEMORY ? status : ERN_OK;
  const size_t piece = (size_t)(sound.rate / 25 > 0 ? sound.rate / 25 : 1), channels = (size_t)sound.channels;
  size_t loud = 0, pieces = 0;
  for (size_t at = 0; at + piece <= sound.frames; at += piece, pieces++) {
    double power = 0;
    for (size_t i = at * channels; i < (at + piece) * channels; i++)
      power += (double)sound.data[i] * (double)sound.data[i];
    loud += sqrt(power / (double)(piece * channels)) > least;
  }
  m->loud = pieces > 0 ? (double)loud / (double)pieces : -1;
  ern_sound_free(ern_clip_context(clip), &sound);
  return ERN_OK;
}

/* ---- pictures ---------------------------------------------------------------------------------------------------- */

/* Measurements of a sampled frame. */
struct look {
  double cover;             /* share of the picture under the torso */
  double torso[2], head[2]; /* centres in the picture, pixels */
  double cheeks[3];         /* mean colour, 0..255 */
  double pose[POSE_TERMS];  /* 1, and the direction of the camera */
  bool has_cheeks;
};

static void look_at_torso(const ern_image *layer, struct look *look) {
  double sum = 0, x = 0, y = 0;
  for (int row = 0; row < layer->height; row++)
    for (int column = 0; column < layer->width; column++) {
      const double alpha = layer->data[4 * ((size_t)row * (size_t)layer->width + (size_t)column) + 3];
      sum += alpha;
      x += alpha * column;
      y += alpha * row;
    }
  look->cover = sum / (255.0 * layer->width * layer->height);
  if (sum > 0) look->torso[0] = x / sum, look->torso[1] = y / sum;
}

/* Projects the head's origin to pixels. */
static void look_at_pose(const float pose[16], const ern_clip_info *info, struct look *look) {
  double seen[3] = {0};
  for (int i = 0; i < 3; i++)
    for (int k = 0; k < 3; k++) seen[i] -= (double)pose[4 * k + i] * (double)pose[4 * k + 3];
  if (seen[2] < 0) {
    look->head[0] = info->cx - info->focal * seen[0] / seen[2];
    look->head[1] = info->cy + info->focal * seen[1] / seen[2];
  }
  look->pose[0] = 1;
  direction_of(pose, look->pose + 1);
}

/* The mean colour of a box of skin without eyelids and lips: in width between the outer corners of the eyes, in height
 * from the middle of the nose's bridge to its base. */
static void look_at_cheeks(const ern_clip_frame *frame, const ern_image *truth, struct look *look) {
  enum { EYE_RIGHT = 36, EYE_LEFT = 45, BRIDGE = 29, NOSE = 33 };
  if (!frame->has_landmarks) return;
  const float(*p)[2] = frame->landmarks;
  const double left = fmax(0, (double)p[EYE_RIGHT][0]), right = fmin(truth->width, (double)p[EYE_LEFT][0]);
  const double top = fmax(0, (double)p[BRIDGE][1]), bottom = fmin(truth->height, (double)p[NOSE][1]);
  if (!(right - left >= 1) || !(bottom - top >= 1)) return;
  size_t count = 0;
  for (size_t row = (size_t)top; row < (size_t)bottom; row++)
    for (size_t column = (size_t)left; column < (size_t)right; column++, count++)
      for (size_t c = 0; c < 3; c++) look->cheeks[c] += truth->data[3 * (row * (size_t)truth->width + column) + c];
  for (size_t c = 0; c < 3 && count > 0; c++) look->cheeks[c] /= (double)count;
  look->has_cheeks = count > 0;
}

static double square_deviation(const struct look *looks, size_t count, size_t axis, bool torso, bool head) {
  double mean = 0, sum = 0;
  for (int pass = 0; pass < 2; pass++)
    for (size_t i = 0; i < count; i++) {
      const double at = (torso ? looks[i].torso[axis] : 0) - (head ? looks[i].head[axis] : 0);
      if (pass == 0)
        mean += at / (double)count;
      else
        sum += (at - mean) * (at - mean);
    }
  return sum / (double)count;
}

/* RMS distance from the mean position. */
static double way(const struct look *looks, size_t count, bool torso, bool head) {
  return sqrt(square_deviation(looks, count, 0, torso, head) + square_deviation(looks, count, 1, torso, head));
}

/* Solves a x = b for a symmetric positive matrix, overwriting a and b, by elimination without pivoting: the ridge term
 * keeps a regular. */
static void solve(double a[POSE_TERMS][POSE_TERMS], double b[POSE_TERMS]) {
  for (int k = 0; k < POSE_TERMS; k++) a[k][k] += 1e-9;
  for (int k = 0; k < POSE_TERMS; k++)
    for (int i = k + 1; i < POSE_TERMS; i++) {
      const double factor = a[i][k] / a[k][k];
      for (int j = k; j < POSE_TERMS; j++) a[i][j] -= factor * a[k][j];
      b[i] -= factor * b[k];
    }
  for (int k = POSE_TERMS - 1; k >= 0; k--) {
    for (int j = k + 1; j < POSE_TERMS; j++) b[k] -= a[k][j] * b[j];
    b[k] /= a[k][k];
  }
}

/* RMS residual, over frames and channels, of a linear fit of the cheeks' colour to the camera's direction. The fit
 * removes the changes of a head that turns in fixed light. */
static double light_of(const struct look *looks, size_t count) {
  double sum = 0;
  size_t used = 0;
  for (size_t c = 0; c < 3; c++) {
    double a[POSE_TERMS][POSE_TERMS] = {{0}}, b[POSE_TERMS] = {0};
    for (size_t f = 0; f < count; f++)
      for (int i = 0; looks[f].has_cheeks && i < POSE_TERMS; i++) {
        b[i] += looks[f].pose[i] * looks[f].cheeks[c];
        for (int j = 0; j < POSE_TERMS; j++) a[i][j] += looks[f].pose[i] * looks[f].pose[j];
      }
    solve(a, b);
    for (size_t f = 0; f < count; f++) {
      double left = looks[f].cheeks[c];
      for (int i = 0; i < POSE_TERMS; i++) left -= b[i] * looks[f].pose[i];
      if (looks[f].has_cheeks) sum += left * left, used++;
    }
  }
  return used > 0 ? sqrt(sum / (double)used) : -1;
}

static ern_status measure_pictures(ern_clip *clip, ern_clip_measures *m) {
  struct look looks[LOOKED_MOST] = {{0}};
  ern_clip_info info;
  ern_clip_describe(clip, &info);
  m->looked = m->frames < LOOKED_MOST ? m->frames : LOOKED_MOST;
  for (size_t i = 0; i < m->looked; i++) {
    const size_t f = i * m->frames / m->looked;
    const ern_clip_frame *frame = ern_clip_frame_at(clip, ERN_SPLIT_TRAIN, f);
    ern_image truth, layer;
    const ern_status status = ern_clip_pixels(clip, ERN_SPLIT_TRAIN, f, &truth, &layer);
    if (status != ERN_OK) return status;
    look_at_pose(frame->pose.matrix, &info, &looks[i]);
    look_at_cheeks(frame, &truth, &looks[i]);
    if (layer.data != NULL) look_at_torso(&layer, &looks[i]);
    m->torso_cover += looks[i].cover / (double)m->looked;
  }
  if (m->torso_cover > 0) {
    m->torso_move = way(looks, m->looked, true, false);
    m->torso_against = way(looks, m->looked, true, true);
  }
  m->light = light_of(looks, m->looked);
  return ERN_OK;
}

ern_status ern_clip_measure_sized(ern_clip *clip, ern_clip_measures *measures, size_t bytes) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, clip);
  ERN_NEED(ern_clip_context(clip), measures);
  ern_clip_info info;
  ern_clip_describe(clip, &info);
  ern_clip_measures own = {.frames = info.frames[ERN_SPLIT_TRAIN]};
  ern_status status = ERN_OK;
  ERN_TRY(measure_turn(clip, &own));
  measure_poses(clip, &own);
  ERN_TRY(measure_eyes(clip, &own));
  ERN_TRY(measure_sound(clip, &own));
  ERN_TRY(ern_clip_feature_change(ern_clip_context(clip), ern_clip_features(clip), &own.feature_change));
  ERN_TRY(measure_pictures(clip, &own));
  ern_struct_copy_out(measures, bytes, &own, sizeof own);
fail:
  return status;
}
