/* SPDX-License-Identifier: MIT
 * The camera of the synthetic clip, in the frame of the head: the head is fixed and the camera moves around it. */
#include <string.h>

#include "lab/synth/synth_parts.h"

static const double focal_share = 2.4;              /* focal length / side of the picture */
static const double pivot[3] = {0.0, -0.34, -0.10}; /* the top of the spine, in the head's frame, unit */
static const double place[3] = {0.0, 0.105, -3.6};  /* position of the head's origin in the camera's frame, unit */

/* Rotation from the axes of the hand-held camera to those of a camera at rest: R = Ry(-pan) Rx(nod). */
static void held_rotation(const struct ern_synth_curve *curve, double r[3][3]) {
  const double degree = 3.14159265358979323846 / 180.0;
  const double cy = cos(-curve->pan * degree), sy = sin(-curve->pan * degree);
  const double cx = cos(curve->nod * degree), sx = sin(curve->nod * degree);
  const double made[3][3] = {{cy, sy * sx, sy * cx}, {0.0, cx, -sx}, {-sy, cy * sx, cy * cx}};
  memcpy(r, made, sizeof made);
}

/* Rotates the camera about its own position. */
static void hold(const struct ern_synth_curve *curve, struct ern_synth_camera *camera) {
  double held[3][3];
  held_rotation(curve, held);
  for (int i = 0; i < 3; ++i) {
    double row[3] = {0.0, 0.0, 0.0};
    for (int j = 0; j < 3; ++j)
      for (int k = 0; k < 3; ++k) row[j] += camera->matrix[i][k] * held[k][j];
    for (int j = 0; j < 3; ++j) camera->matrix[i][j] = row[j];
  }
}

void ern_synth_camera_make(int size, const struct ern_synth_curve *curve, struct ern_synth_camera *camera) {
  const double degree = 3.14159265358979323846 / 180.0;
  const double cy = cos(curve->yaw * degree), sy = sin(curve->yaw * degree);
  const double cp = cos(curve->pitch * degree), sp = sin(curve->pitch * degree);
  const double cr = cos(curve->roll * degree), sr = sin(curve->roll * degree);
  /* head to camera: R = Ry(yaw) Rx(-pitch) Rz(-roll) */
  const double ry[3][3] = {{cy, 0, sy}, {0, 1, 0}, {-sy, 0, cy}};
  const double rx[3][3] = {{1, 0, 0}, {0, cp, sp}, {0, -sp, cp}};
  const double rz[3][3] = {{cr, sr, 0}, {-sr, cr, 0}, {0, 0, 1}};
  double yx[3][3] = {{0}}, r[3][3] = {{0}};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      for (int k = 0; k < 3; ++k) yx[i][j] += ry[i][k] * rx[k][j];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      for (int k = 0; k < 3; ++k) r[i][j] += yx[i][k] * rz[k][j];
  /* rotated about the pivot, then translated: p -> R (p - pivot) + pivot + place + shift */
  double t[3];
  for (int i = 0; i < 3; ++i) {
    t[i] = pivot[i] + place[i] + (double)curve->shift[i];
    for (int k = 0; k < 3; ++k) t[i] -= r[i][k] * pivot[k];
  }
  camera->focal = focal_share * size;
  camera->centre = 0.5 * size;
  for (int i = 0; i < 3; ++i) { /* the inverse, in world units */
    double back = 0.0;
    for (int k = 0; k < 3; ++k) {
      camera->matrix[i][k] = r[k][i];
      back -= r[k][i] * t[k];
    }
    camera->matrix[i][3] = back / ERN_SYNTH_SCALE;
    camera->matrix[3][i] = 0.0;
  }
  camera->matrix[3][3] = 1.0;
  if (curve->pan != 0.0f || curve->nod != 0.0f) hold(curve, camera);
}

void ern_synth_camera_rest(const struct ern_synth_curve *curve, float *u, float *v) {
  if (curve->pan == 0.0f && curve->nod == 0.0f) return;
  double r[3][3], seen[3];
  const double way[3] = {((double)*u - 0.5) / focal_share, -((double)*v - 0.5) / focal_share, -1.0};
  held_rotation(curve, r);
  for (int i = 0; i < 3; ++i) seen[i] = r[i][0] * way[0] + r[i][1] * way[1] + r[i][2] * way[2];
  *u = (float)(0.5 - focal_share * seen[0] / seen[2]);
  *v = (float)(0.5 + focal_share * seen[1] / seen[2]);
}

void ern_synth_camera_project(const struct ern_synth_camera *camera, struct vec3 p, float pixel[2]) {
  const double world[3] = {(double)p.x / ERN_SYNTH_SCALE, (double)p.y / ERN_SYNTH_SCALE, (double)p.z / ERN_SYNTH_SCALE};
  double seen[3] = {0.0, 0.0, 0.0};
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) seen[i] += camera->matrix[k][i] * (world[k] - camera->matrix[k][3]);
  pixel[0] = (float)(camera->centre - camera->focal * seen[0] / seen[2]);
  pixel[1] = (float)(camera->centre + camera->focal * seen[1] / seen[2]);
}

void ern_synth_camera_ray(const struct ern_synth_camera *camera, double x, double y, struct vec3 *origin,
                          struct vec3 *direction) {
  const double way[3] = {(x - camera->centre) / camera->focal, -(y - camera->centre) / camera->focal, -1.0};
  double turned[3], from[3];
  for (int i = 0; i < 3; ++i) {
    turned[i] = camera->matrix[i][0] * way[0] + camera->matrix[i][1] * way[1] + camera->matrix[i][2] * way[2];
    from[i] = camera->matrix[i][3] * ERN_SYNTH_SCALE;
  }
  *origin = vec3_of((float)from[0], (float)from[1], (float)from[2]);
  *direction = vec3_unit(vec3_of((float)turned[0], (float)turned[1], (float)turned[2]));
}
