/* SPDX-License-Identifier: MIT
 * Poses and the path they make. */
#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "ernerf/render.h"

void ern_camera_pose(float pose[16], const float m[16], float scale) {
  ERN_PLAIN_FLOATS;
  static const int row[3] = {1, 2, 0};
  for (int r = 0; r < 3; r++) {
    const float *from = m + 4 * row[r];
    pose[4 * r] = from[0];
    pose[4 * r + 1] = -from[1];
    pose[4 * r + 2] = -from[2];
    pose[4 * r + 3] = from[3] * scale;
  }
  memcpy(pose + 12, (float[]){0, 0, 0, 1}, 4 * sizeof(float));
}

/* matrix <- Ry(-yaw) Rx(pitch) matrix. The world of a transforms file has x to the right of the face's picture, y up
 * and z out of the face, so Rx takes a camera before the face below it and Ry then takes it to the picture's left. */
void ern_pose_turn(float matrix[16], double yaw, double pitch) {
  ERN_PLAIN_FLOATS;
  const double degree = 3.14159265358979323846 / 180;
  const double cy = cos(yaw * degree), sy = -sin(yaw * degree), cp = cos(pitch * degree), sp = sin(pitch * degree);
  const double turn[3][3] = {{cy, sy * sp, sy * cp}, {0, cp, -sp}, {-sy, cy * sp, cy * cp}};
  float out[12];
  for (int r = 0; r < 3; r++)
    for (int c = 0; c < 4; c++) {
      double sum = 0;
      for (int k = 0; k < 3; k++) sum += turn[r][k] * (double)matrix[4 * k + c];
      out[4 * r + c] = (float)sum;
    }
  memcpy(matrix, out, sizeof out);
}

ern_camera ern_camera_resized(const ern_camera *camera, int width, int height) {
  ERN_PLAIN_FLOATS;
  ern_camera out = *camera;
  const float scale = (float)height / (float)camera->height;
  out.focal = camera->focal * scale;
  out.cy = camera->cy * scale;
  out.cx = (float)width / 2 + (camera->cx - (float)camera->width / 2) * scale;
  out.width = width;
  out.height = height;
  return out;
}

size_t ern_pose_index(size_t frame, size_t count) {
  if (count < 2) return 0;
  const size_t period = 2 * (count - 1), place = frame % period;
  return place < count ? place : period - place;
}

/* The inverse transpose of a 3x3 matrix, or false where it is singular. */
static bool inverse_transpose(double out[9], const double m[9]) {
  const double c[9] = {m[4] * m[8] - m[5] * m[7], m[5] * m[6] - m[3] * m[8], m[3] * m[7] - m[4] * m[6],
                       m[2] * m[7] - m[1] * m[8], m[0] * m[8] - m[2] * m[6], m[1] * m[6] - m[0] * m[7],
                       m[1] * m[5] - m[2] * m[4], m[2] * m[3] - m[0] * m[5], m[0] * m[4] - m[1] * m[3]};
  const double det = m[0] * c[0] + m[1] * c[1] + m[2] * c[2];
  if (!(fabs(det) > 1e-12)) return false;
  for (int i = 0; i < 9; i++) out[i] = c[i] / det;
  return true;
}

/* The rotation nearest to m: Newton's iteration of the polar decomposition, M <- (M + M^-T)/2 (Higham 1986). */
static bool nearest_rotation(double m[9]) {
  enum { MOST_ROUNDS = 60 };
  for (int round = 0; round < MOST_ROUNDS; round++) {
    double inverse[9], change = 0;
    if (!inverse_transpose(inverse, m)) return false;
    for (int i = 0; i < 9; i++) {
      const double next = 0.5 * (m[i] + inverse[i]);
      change += fabs(next - m[i]);
      m[i] = next;
    }
    if (change < 1e-13) return true;
  }
  return false;
}

ern_status ern_poses_smooth(ern_context *context, ern_pose *poses, size_t count, int window) {
  ERN_PLAIN_FLOATS;
  if (window < 1 || window % 2 == 0)
    return ern_fail(context, ERN_E_ARGUMENT, "smooth path: window is %d, expected an odd number from 1", window);
  void *room = NULL;
  ern_status status = ern_allocate(context, count, sizeof(ern_pose), &room);
  if (status != ERN_OK) return status;
  ern_pose *smooth = room;
  const size_t half = (size_t)window / 2;
  for (size_t i = 0; i < count; i++) {
    const size_t begin = i < half ? 0 : i - half, end = i + half + 1 < count ? i + half + 1 : count;
    double rotation[9] = {0}, move[3] = {0};
    for (size_t k = begin; k < end; k++)
      for (int r = 0; r < 3; r++) {
        for (int c = 0; c < 3; c++) rotation[3 * r + c] += (double)poses[k].matrix[4 * r + c] / (double)(end - begin);
        move[r] += (double)poses[k].matrix[4 * r + 3] / (double)(end - begin);
      }
    if (!nearest_rotation(rotation))
      ERN_TRY(ern_fail(context, ERN_E_FORMAT, "smooth path: the rotations around frame %zu have no mean", i));
    smooth[i] = poses[i];
    for (int r = 0; r < 3; r++) {
      for (int c = 0; c < 3; c++) smooth[i].matrix[4 * r + c] = (float)rotation[3 * r + c];
      smooth[i].matrix[4 * r + 3] = (float)move[r];
    }
  }
  memcpy(poses, smooth, count * sizeof *poses);
fail:
  ern_release(context, room);
  return status;
}
