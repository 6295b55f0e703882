/* SPDX-License-Identifier: MIT
 * The head's position in each frame: landmarks, and the outline of the projected ellipsoid. */
#include <math.h>

#include "io/landmarks.h"
#include "prepare/head_shape.h"
#include "prepare/layers/layers.h"

/* The ellipsoid of the whole head: its top is 115 mm above the eyes, the chin as far below as in head_shape.h. */
static const double axes[3] = {ERN_HEAD_WIDE, ERN_HEAD_TALL + 0.012, ERN_HEAD_DEEP};
static const double middle[3] = {0, 0.012, 0};

static double length_of(const double a[3]) { return sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]); }

static void cross_of(const double a[3], const double b[3], double c[3]) {
  for (int i = 0; i < 3; i++) c[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

/* The outline of the unit sphere u = (X_head - middle) / axes, seen from the camera's position e: the circle u.e = 1,
 * |u| = 1. */
static bool outline_of(const struct ern_prepare_job *job, const struct ern_head_pose *pose,
                       struct ern_layer_face *face) {
  double e[3] = {0}, p[3], q[3], side[3] = {0};
  for (int i = 0; i < 3; i++) {
    for (int k = 0; k < 3; k++) e[i] -= pose->rotation[k][i] * pose->translation[k];
    e[i] = (e[i] - middle[i]) / axes[i];
  }
  const double far = length_of(e);
  if (!(far > 1.01)) return false;
  side[fabs(e[0]) < fabs(e[1]) ? 0 : 1] = 1;
  cross_of(e, side, p);
  cross_of(e, p, q);
  const double radius = sqrt(1 - 1 / (far * far)), lp = length_of(p), lq = length_of(q), c = 0.5 * job->side;
  face->centre[0] = face->centre[1] = 0;
  for (int k = 0; k < ERN_LAYER_OUTLINE; k++) {
    const double angle = 2 * 3.14159265358979 * k / ERN_LAYER_OUTLINE;
    double x[3];
    for (int i = 0; i < 3; i++) {
      x[i] = pose->translation[i];
      for (int j = 0; j < 3; j++)
        x[i] +=
            pose->rotation[i][j] *
            (middle[j] + axes[j] * (e[j] / (far * far) + radius * (cos(angle) * p[j] / lp + sin(angle) * q[j] / lq)));
    }
    if (!(x[2] < -1e-3)) return false;
    face->outline[k][0] = (float)(c - job->focal * x[0] / x[2]);
    face->outline[k][1] = (float)(c + job->focal * x[1] / x[2]);
    for (int i = 0; i < 2; i++) face->centre[i] += face->outline[k][i] / ERN_LAYER_OUTLINE;
  }
  const double limit = 4.0 * job->side;
  return fabs((double)face->centre[0] - c) < limit && fabs((double)face->centre[1] - c) < limit;
}

/* A pixel beside the ellipsoid moves like the nearest pixel on it towards its centre. */
void ern_layer_head_moved(const struct ern_layer_face *from, const struct ern_layer_face *to, const double pixel[2],
                          double moved[2]) {
  static const double origin[3] = {0};
  double home[2], at[2], point[3];
  moved[0] = pixel[0], moved[1] = pixel[1];
  if (!ern_head_project(&from->pose, from->focal, from->middle, origin, home)) return;
  for (double part = 1; part > 0.05; part *= 0.9) {
    for (int i = 0; i < 2; i++) at[i] = home[i] + part * (pixel[i] - home[i]);
    if (!ern_head_intersect(&from->pose, from->focal, from->middle, at, false, point)) continue;
    double to_pixel[2];
    if (!ern_head_project(&to->pose, to->focal, to->middle, point, to_pixel)) return;
    for (int i = 0; i < 2; i++) moved[i] += to_pixel[i] - at[i];
    return;
  }
}

/* Each point becomes (before + 2 at + after) / 4, which halves jitter. */
static void smooth(struct ern_layer_face *faces, size_t count) {
  for (int k = 0; k < ERN_LAYER_POINTS; k++)
    for (int i = 0; i < 2; i++) {
      float before = faces[0].points[k][i];
      for (size_t f = 0; f < count; f++) {
        const float at = faces[f].points[k][i], after = faces[f + 1 < count ? f + 1 : f].points[k][i];
        faces[f].points[k][i] = 0.25f * (before + 2 * at + after);
        before = at;
      }
    }
}

ern_status ern_layer_faces_read(struct ern_prepare_job *job, struct ern_layer_face *faces) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH];
  struct ern_head_pose *poses = NULL;
  ERN_TRY(ERN_NEW(job->context, job->frames, &poses));
  ERN_TRY(ern_prepare_poses_read(job, poses));
  const float limit = (float)(ERN_PREPARE_REACH * job->side);
  for (size_t f = 0; f < job->frames; f++) {
    ERN_TRY(ern_prepare_path(job, path, "ori_imgs/%zu.lms", f));
    ERN_TRY(ern_landmarks_read(job->context, path, faces[f].points));
    for (int k = 0; k < ERN_LAYER_POINTS; k++)
      if (!(fabsf(faces[f].points[k][0]) < limit) || !(fabsf(faces[f].points[k][1]) < limit))
        ERN_TRY(ern_fail(job->context, ERN_E_FORMAT, "%s: line %d: point (%g, %g), expected pixels of a picture of %d",
                         path, k + 1, (double)faces[f].points[k][0], (double)faces[f].points[k][1], job->side));
    faces[f].pose = poses[f];
    faces[f].focal = job->focal;
    faces[f].middle = 0.5 * job->side;
    if (!outline_of(job, &poses[f], &faces[f]))
      ERN_TRY(ern_fail(job->context, ERN_E_UNSUPPORTED,
                       "%s: the head of frame %zu is not before the camera, expected poses of a face that is seen",
                       job->folder, f));
  }
  smooth(faces, job->frames);
fail:
  ern_release(job->context, poses);
  return status;
}
