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
/* Half axes of the ellipsoid that stands for skull and face without the nose, about the origin. */
#define ERN_HEAD_WIDE 0.075
#define ERN_HEAD_TALL 0.115
#define ERN_HEAD_DEEP 0.100
/* Middle of the eyes. */
#define ERN_HEAD_EYES_Y 0.030
#define ERN_HEAD_EYES_Z 0.085

/* Pixels of a point of the head; false where it is behind the camera. `centre`: pixels, half of a side. */
bool ern_head_project(const struct ern_head_pose *pose, double focal, double centre, const double point[3],
                      double pixel[2]);
/* Degrees between the directions in which two heads face, roll left out. */
double ern_head_turn(const struct ern_head_pose *a, const struct ern_head_pose *b);
/* Where the line of sight through a pixel meets the ellipsoid first, or with `face` the face on it, forehead and nose;
 * false where it passes the ellipsoid by. */
bool ern_head_intersect(const struct ern_head_pose *pose, double focal, double centre, const double pixel[2], bool face,
                        double point[3]);
/* z of the face (ellipsoid, forehead and nose) over x, y; 0 past the ellipsoid's outline. */
double ern_head_surface(double x, double y);
/* The box around the projected ellipsoid: least x, least y, greatest x, greatest y, pixels. */
void ern_head_box(const struct ern_head_pose *pose, double focal, double centre, double box[4]);
/* The pose of a head that looks into the camera, from the eyes' middles in the picture, the left one first. */
void ern_head_pose_of_eyes(const float eyes[2][2], double focal, double centre, struct ern_head_pose *pose);

#ifdef __cplusplus
}
#endif
#endif
