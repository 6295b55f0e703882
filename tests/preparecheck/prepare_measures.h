/* SPDX-License-Identifier: MIT
 * Errors of a prepared clip against the ground truth: poses, landmarks, layers, blinks. Computation only, no files. */
#ifndef ERN_TESTS_PREPARE_MEASURES_H
#define ERN_TESTS_PREPARE_MEASURES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Pose, head to camera: X_camera = rotation X_head + place. */
struct head_pose {
  int64_t frame;
  double rotation[3][3], place[3];
};

/* The rotation nearest to m, which maximises trace(R^T m): the quaternion of the largest eigenvalue (Horn 1987). */
void nearest_rotation(const double m[3][3], double rotation[3][3]);
/* Angle between the rotations, degrees, 0..180. */
double rotation_angle(const double a[3][3], const double b[3][3]);

/* The prepared rotations are A R B, where R are the true ones. B is another choice of the head's frame, A another
 * optical axis, as with an off-centre crop. One pair A, B for all frames, by least squares over the matrices. */
struct path_alignment {
  double camera[3][3], head[3][3]; /* A, B */
  double scale, origin[3]; /* scale of the prepared positions; origin of the prepared head in the true head's frame */
};

struct path_errors {
  double rotation_median, rotation_p95; /* degrees */
  double place_median;                  /* in units of the true distance from camera to head */
  double camera_turn;                   /* degrees, of A: approximately the angle between the two optical axes */
  double rotation_tremble[2], place_tremble[2]; /* jitter of truth, prepared: degrees, units of the truth; a frame^2 */
  double rotation_tremble_ratio, place_tremble_ratio; /* prepared / truth; NaN if the truth does not move */
  size_t seconds;                                     /* number of triples of consecutive frames for the jitter */
};

/* truth[count] and prepared[count]: the same frames, in order. `focal_ratio`: prepared / true focal length, both in
 * pixels of the prepared clip. A focal length k times the true one puts the head k times as far away at the same size,
 * so prepared depths are divided by k before positions are compared. Rotations are compared unchanged: the effect of a
 * wrong focal length on them is an error of the clip. False: no memory, or count below 3. */
bool compare_paths(const struct head_pose *truth, const struct head_pose *prepared, size_t count, double focal_ratio,
                   struct path_alignment *alignment, struct path_errors *errors);

/* Crop: pixels of the video = corner + side/size * pixels of the clip. */
struct crop {
  double x, y, side, size;
};

/* Distance of the mouths' centres (means of points 48..67) in pixels of the video over the distance of the truth's
 * eyes' centres. truth is in pixels of the video, prepared in those of the clip. */
double mouth_error(float truth[68][2], float prepared[68][2], const struct crop *crop);

enum layer { LAYER_BACKGROUND, LAYER_HEAD, LAYER_NECK, LAYER_TORSO, LAYER_OTHER };
/* The class of an RGB pixel of parsing/ID.png. */
enum layer layer_of(const uint8_t rgb[3]);

/* RGB, [height][width][3]. */
struct layer_map {
  const uint8_t *rgb;
  int width, height;
};
/* Intersection over union of the person (all but the background) and of the head, over those pixels of the video that
 * lie in the crop; 1 where neither has any. A pixel of the video is compared with the clip's pixel at its centre. */
void compare_layers(struct layer_map truth, struct layer_map prepared, const struct crop *crop, double *person,
                    double *head);

struct blink {
  size_t first, last; /* frames, both inclusive */
};
/* Finds blinks: intervals above half of the 99th percentile; intervals one frame apart are merged. blinks has room for
 * count/2 + 1. Returns their number; 0 if the percentile is 0; SIZE_MAX without memory. */
size_t find_blinks(const float *closed, size_t count, struct blink *blinks);
/* Pairs each true blink with at most one prepared blink that overlaps it or is at most one frame apart. */
size_t match_blinks(const struct blink *truth, size_t truths, const struct blink *prepared, size_t prepareds);

/* Quantile of values[count], which it sorts; linear interpolation. NaN if count is 0. */
double quantile(double *values, size_t count, double share);

#endif
