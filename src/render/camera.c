/* SPDX-License-Identifier: MIT
 * Camera poses, and the path that they form. */
#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "ernerf/render.h"

void ern_camera_pose(float pose[16], const float m[16], float scale) {
  ERN_PLAIN_FLOATS;
  if (pose == NULL || m == NULL) return;
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
 * and z out of the face, so Rx moves a camera in front of the face below it, and Ry then moves it to the picture's
 * left. */
void ern_pose_turn(float matrix[16], double yaw, double pitch) {
  ERN_PLAIN_FLOATS;
  if (matrix == NULL) return;
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

/* A side that differs by less than a pixel, from the rounding of a size, counts as fitting. */
ern_box ern_fit_box(int from_width, int from_height, int width, int height, ern_fit fit) {
  ERN_PLAIN_FLOATS;
  if (from_width < 1 || from_height < 1 || width < 1 || height < 1) return (ern_box){0};
  const double across = (double)width / from_width, down = (double)height / from_height;
  const double scale = (fit == ERN_FIT_COVER) == (across > down) ? across : down;
  const double wide = fmin(scale * from_width, 1e9), high = fmin(scale * from_height, 1e9); /* sums stay ints */
  if (fabs(wide - width) < 1 && fabs(high - height) < 1) return (ern_box){0, height, 0, width};
  const int w = wide < 1 ? 1 : (int)lrint(wide), h = high < 1 ? 1 : (int)lrint(high);
  const int left = (int)floor((width - w) / 2.0), top = (int)floor((height - h) / 2.0);
  return (ern_box){top, top + h, left, left + w};
}

ern_camera ern_camera_fitted(const ern_camera *camera, int width, int height, ern_fit fit) {
  ERN_PLAIN_FLOATS;
  if (camera == NULL || camera->width < 1 || camera->height < 1 || width < 1 || height < 1) return (ern_camera){0};
  const ern_box box = ern_fit_box(camera->width, camera->height, width, height, fit);
  const int wide = box.right - box.left, high = box.bottom - box.top;
  const float scale = high == height ? (float)height / (float)camera->height : (float)width / (float)camera->width;
  ern_camera out = *camera;
  out.focal = camera->focal * scale;
  out.cy = (float)box.top + camera->cy * scale;
  out.cx = (float)box.left + (float)wide / 2 + (camera->cx - (float)camera->width / 2) * scale;
  out.width = width;
  out.height = height;
  out.frame = box;
  return out;
}

ern_camera ern_camera_resized(const ern_camera *camera, int width, int height) {
  return ern_camera_fitted(camera, width, height, ERN_FIT_CONTAIN);
}

size_t ern_pose_index(size_t frame, size_t count) {
  if (count < 2) return 0;
  const size_t last = count - 1, place = frame % last;
  return frame / last % 2 == 0 ? place : last - place;
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
  ERN_NEED(context, context);
  ERN_NEED(context, poses);
  if (window < 1 || window % 2 == 0)
    return ern_fail(context, ERN_E_ARGUMENT, "smooth path: window is %d, expected an odd number from 1", window);
  ern_pose *smooth = NULL;
  ern_status status = ERN_NEW(context, count, &smooth);
  if (status != ERN_OK) return status;
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
  ern_release(context, smooth);
  return status;
}

/* ---- between two poses ------------------------------------------------------------------------------------------- */

/* The unit quaternion (w, x, y, z) of a rotation (Shepperd 1978: by its largest member). */
static void quaternion_of(double q[4], const double m[9]) {
  static const int next[3] = {1, 2, 0};
  const double trace = m[0] + m[4] + m[8];
  if (trace > 0) {
    const double twice = sqrt(1 + trace);
    q[0] = twice / 2;
    q[1] = (m[7] - m[5]) / (2 * twice);
    q[2] = (m[2] - m[6]) / (2 * twice);
    q[3] = (m[3] - m[1]) / (2 * twice);
    return;
  }
  int i = m[4] > m[0] ? 1 : 0;
  if (m[8] > m[4 * i]) i = 2;
  const int j = next[i], k = next[j];
  const double twice = sqrt(1 + m[4 * i] - m[4 * j] - m[4 * k]);
  q[0] = (m[3 * k + j] - m[3 * j + k]) / (2 * twice);
  q[1 + i] = twice / 2;
  q[1 + j] = (m[3 * j + i] + m[3 * i + j]) / (2 * twice);
  q[1 + k] = (m[3 * k + i] + m[3 * i + k]) / (2 * twice);
}

static void rotation_of(double m[9], const double q[4]) {
  const double w = q[0], x = q[1], y = q[2], z = q[3];
  const double out[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                         2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                         2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
  memcpy(m, out, sizeof out);
}

/* q(share) = (sin((1 - share) a) q0 + sin(share a) q1) / sin a, a the angle between q0 and q1 (Shoemake 1985); of q1
 * and -q1, the same rotation, the nearer one. */
static void slerp(double m[9], const double from[9], const double to[9], double share) {
  double a[4], b[4], dot = 0, norm = 0;
  quaternion_of(a, from);
  quaternion_of(b, to);
  for (int i = 0; i < 4; i++) dot += a[i] * b[i];
  const double sign = dot < 0 ? -1 : 1, angle = acos(fmin(fabs(dot), 1)), size = sin(angle);
  const bool near = size < 1e-8; /* sin x = x to the last bit of a double */
  const double first = near ? 1 - share : sin((1 - share) * angle) / size;
  const double second = sign * (near ? share : sin(share * angle) / size);
  for (int i = 0; i < 4; i++) {
    a[i] = first * a[i] + second * b[i];
    norm += a[i] * a[i];
  }
  for (int i = 0; i < 4; i++) a[i] /= sqrt(norm);
  rotation_of(m, a);
}

static double determinant(const double m[9]) {
  return m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) + m[2] * (m[3] * m[7] - m[4] * m[6]);
}

/* The nearest rotation of a pose's 3x3 part; false where there is none. */
static bool rotation_in(double m[9], const float pose[16]) {
  for (int i = 0; i < 9; i++) m[i] = (double)pose[4 * (i / 3) + i % 3];
  return determinant(m) > 0 && nearest_rotation(m);
}

void ern_pose_interpolate(float out[16], const float from[16], const float to[16], double share) {
  ERN_PLAIN_FLOATS;
  if (out == NULL || from == NULL || to == NULL) return;
  if (!(share > 0) || memcmp(from, to, 16 * sizeof *from) == 0) {
    memmove(out, from, 16 * sizeof *out);
    return;
  }
  if (share >= 1) {
    memmove(out, to, 16 * sizeof *out);
    return;
  }
  double a[9], b[9], between[9];
  float made[16];
  const bool turns = rotation_in(a, from) && rotation_in(b, to);
  if (turns) slerp(between, a, b, share);
  for (int i = 0; i < 16; i++) {
    const int r = i / 4, c = i % 4, k = 3 * r + c;
    const bool rotation = turns && r < 3 && c < 3;
    const double rest_from = (double)from[i] - (rotation ? a[k] : 0), rest_to = (double)to[i] - (rotation ? b[k] : 0);
    made[i] = (float)((rotation ? between[k] : 0) + (1 - share) * rest_from + share * rest_to);
  }
  memcpy(out, made, sizeof made);
}
