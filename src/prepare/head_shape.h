/* SPDX-License-Identifier: MIT
 * A generic head in the head's own frame (prepare_job.h): metres, x right in the picture, y up, z out of the face,
 * origin in the middle of the head. The eyes' distance, 63 mm (the adults' mean), is the unit of every clip. */
#ifndef ERN_PREPARE_HEAD_SHAPE_H
#define ERN_PREPARE_HEAD_SHAPE_H

#include <stdbool.h>

#include "prepare/prepare_job.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ERN_HEAD_EYES 0.063 /* between the middles of the eyes */
/* Semi-axes of the ellipsoid that models skull and face without the nose, centred on the origin. */
#define ERN_HEAD_WIDE 0.075
#define ERN_HEAD_TALL 0.115
#define ERN_HEAD_DEEP 0.100
/* The point midway between the eyes. */
#define ERN_HEAD_EYES_Y 0.030
#define ERN_HEAD_EYES_Z 0.085

/* Projects a point of the head to pixels; false where it is behind the camera. `centre`: pixels, half of a side. */
bool ern_head_project(const struct ern_head_pose *pose, double focal, double centre, const double point[3],
                      double pixel[2]);
/* Degrees between the directions in which two heads face, ignoring roll. */
double ern_head_turn(const struct ern_head_pose *a, const struct ern_head_pose *b);
/* point = the first intersection of the ray through a pixel with the ellipsoid, or with the face (ellipsoid, forehead
 * and nose) where `face` is set; false where the ray misses the ellipsoid. */
bool ern_head_intersect(const struct ern_head_pose *pose, double focal, double centre, const double pixel[2], bool face,
                        double point[3]);
/* point = the point of the ray through a pixel that is nearest to the ellipsoid's centre, lengths along its axes in
 * semi-axes; returns that distance, which is 1 on the ellipsoid's outline. */
double ern_head_nearest(const struct ern_head_pose *pose, double focal, double centre, const double pixel[2],
                        double point[3]);
/* z of the face (ellipsoid, forehead and nose) at x, y; 0 outside the ellipsoid's outline. */
double ern_head_surface(double x, double y);
/* The bounding box of the projected ellipsoid: least x, least y, greatest x, greatest y, pixels. */
void ern_head_box(const struct ern_head_pose *pose, double focal, double centre, double box[4]);
/* The pose of a head that faces the camera, from the eyes' centres in the picture, the left one first. */
void ern_head_pose_of_eyes(const float eyes[2][2], double focal, double centre, struct ern_head_pose *pose);

#ifdef __cplusplus
}
#endif
#endif
