/* SPDX-License-Identifier: MIT */
#include "prepare/head_shape.h"

#include <math.h>

double ern_head_turn(const struct ern_head_pose *a, const struct ern_head_pose *b) {
  double dot = 0;
  for (int i = 0; i < 3; i++) dot += a->rotation[i][2] * b->rotation[i][2];
  return acos(fmin(fmax(dot, -1), 1)) * 57.29577951308232;
}

bool ern_head_project(const struct ern_head_pose *pose, double focal, double centre, const double point[3],
                      double pixel[2]) {
  double seen[3];
  for (int i = 0; i < 3; i++) {
    seen[i] = pose->translation[i];
    for (int k = 0; k < 3; k++) seen[i] += pose->rotation[i][k] * point[k];
  }
  if (seen[2] > -1e-3) return false;
  pixel[0] = centre + focal * seen[0] / -seen[2];
  pixel[1] = centre - focal * seen[1] / -seen[2];
  return true;
}

/* The tip of the nose is 20 mm outside the ellipsoid, and so 23 mm in front of the root of the upper lip. */
static const double nose = 0.020;
/* Above the origin the face follows an ellipsoid with this vertical semi-axis, as a forehead is nearly upright: from
 * brows to hair it slopes by 18 degrees, where the head's ellipsoid slopes by 38. */
static const double forehead = 0.160;

/* Height of the nose above the ellipsoid, metres. The tip is 43 mm below the eyes; the height falls to 0 at the bridge
 * between them. */
static double nose_height(double x, double y) {
  const double below = ERN_HEAD_EYES_Y - y; /* 0 at the bridge, 0.043 at the tip */
  const double along = below < 0.043 ? below / 0.043 : (0.060 - below) / 0.017;
  if (along <= 0) return 0;
  const double half = 0.007 + 0.006 * along;
  return nose * along * exp(-0.5 * x * x / (half * half));
}

double ern_head_surface(double x, double y) {
  const double a = x / ERN_HEAD_WIDE, b = y / ERN_HEAD_TALL, c = y > 0 ? y / forehead : b;
  return a * a + b * b < 1 ? ERN_HEAD_DEEP * sqrt(1 - a * a - c * c) + nose_height(x, y) : 0;
}

/* The first intersection of the ray o + along d, in the head's frame, with an ellipsoid. */
static bool intersect(const double axes[3], const double o[3], const double d[3], double point[3]) {
  double dd = 0, od = 0, oo = 0;
  for (int i = 0; i < 3; i++) {
    dd += d[i] * d[i] / (axes[i] * axes[i]);
    od += o[i] * d[i] / (axes[i] * axes[i]);
    oo += o[i] * o[i] / (axes[i] * axes[i]);
  }
  const double inside = od * od - dd * (oo - 1);
  if (inside < 0) return false;
  const double along = (-od - sqrt(inside)) / dd;
  for (int i = 0; i < 3; i++) point[i] = o[i] + along * d[i];
  return true;
}

/* The ray through a pixel, o + along d, in the head's frame. */
static void ray_of(const struct ern_head_pose *pose, double focal, double centre, const double pixel[2], double o[3],
                   double d[3]) {
  const double way[3] = {(pixel[0] - centre) / focal, (centre - pixel[1]) / focal, -1};
  for (int i = 0; i < 3; i++) {
    o[i] = d[i] = 0;
    for (int k = 0; k < 3; k++) {
      o[i] -= pose->rotation[k][i] * pose->translation[k];
      d[i] += pose->rotation[k][i] * way[k];
    }
  }
}

double ern_head_nearest(const struct ern_head_pose *pose, double focal, double centre, const double pixel[2],
                        double point[3]) {
  static const double axes[3] = {ERN_HEAD_WIDE, ERN_HEAD_TALL, ERN_HEAD_DEEP};
  double o[3], d[3], dd = 0, od = 0, square = 0;
  ray_of(pose, focal, centre, pixel, o, d);
  for (int i = 0; i < 3; i++) {
    dd += d[i] * d[i] / (axes[i] * axes[i]);
    od += o[i] * d[i] / (axes[i] * axes[i]);
  }
  for (int i = 0; i < 3; i++) {
    point[i] = o[i] - od / dd * d[i];
    square += point[i] * point[i] / (axes[i] * axes[i]);
  }
  return sqrt(square);
}

bool ern_head_intersect(const struct ern_head_pose *pose, double focal, double centre, const double pixel[2], bool face,
                        double point[3]) {
  static const double axes[3] = {ERN_HEAD_WIDE, ERN_HEAD_TALL, ERN_HEAD_DEEP};
  const double high[3] = {ERN_HEAD_WIDE, forehead, ERN_HEAD_DEEP};
  double o[3], d[3];
  ray_of(pose, focal, centre, pixel, o, d);
  if (!intersect(axes, o, d, point)) return false;
  if (!face) return true;
  if (point[1] > 0) (void)intersect(high, o, d, point);
  /* the nose's height is along z; one step along the ray is accurate enough where the ray is nearly parallel to z */
  if (point[2] > 0 && fabs(d[2]) > 0.5) {
    const double step = nose_height(point[0], point[1]) / fabs(d[2]);
    for (int i = 0; i < 3; i++) point[i] -= step * d[i];
  }
  return true;
}

void ern_head_box(const struct ern_head_pose *pose, double focal, double centre, double box[4]) {
  enum { ROUND = 24, HIGH = 12 };
  box[0] = box[1] = HUGE_VAL;
  box[2] = box[3] = -HUGE_VAL;
  for (int i = 0; i < ROUND; i++)
    for (int k = 0; k <= HIGH; k++) {
      const double a = 6.283185307179586 * i / ROUND, b = 3.141592653589793 * ((double)k / HIGH - 0.5);
      const double point[3] = {ERN_HEAD_WIDE * cos(b) * cos(a), ERN_HEAD_TALL * sin(b),
                               ERN_HEAD_DEEP * cos(b) * sin(a)};
      double pixel[2];
      if (!ern_head_project(pose, focal, centre, point, pixel)) continue;
      for (int c = 0; c < 2; c++) {
        box[c] = fmin(box[c], pixel[c]);
        box[2 + c] = fmax(box[2 + c], pixel[c]);
      }
    }
}

void ern_head_pose_of_eyes(const float eyes[2][2], double focal, double centre, struct ern_head_pose *pose) {
  const double dx = (double)eyes[1][0] - (double)eyes[0][0], dy = (double)eyes[1][1] - (double)eyes[0][1];
  const double distance = fmax(hypot(dx, dy), 1.0), depth = focal * ERN_HEAD_EYES / distance;
  const double c = dx / distance, s = -dy / distance; /* y is up in space, down in the picture */
  const double rotation[3][3] = {{c, -s, 0}, {s, c, 0}, {0, 0, 1}}, middle[3] = {0, ERN_HEAD_EYES_Y, ERN_HEAD_EYES_Z};
  const double at[3] = {(0.5 * ((double)eyes[0][0] + (double)eyes[1][0]) - centre) / focal * depth,
                        (centre - 0.5 * ((double)eyes[0][1] + (double)eyes[1][1])) / focal * depth, -depth};
  for (int i = 0; i < 3; i++) {
    pose->translation[i] = at[i];
    for (int k = 0; k < 3; k++) {
      pose->rotation[i][k] = rotation[i][k];
      pose->translation[i] -= rotation[i][k] * middle[k];
    }
  }
}
