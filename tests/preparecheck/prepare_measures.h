/* SPDX-License-Identifier: MIT
 * How far a prepared clip is from the truth: poses, landmarks, layers, blinks. Numbers alone, no files. */
#ifndef ERN_TESTS_PREPARE_MEASURES_H
#define ERN_TESTS_PREPARE_MEASURES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Head to camera: X_camera = rotation X_head + place. */
struct head_pose {
  int64_t frame;
  double rotation[3][3], place[3];
};

/* The largest eigenvalue's quaternion: the rotation that is nearest to m (Horn 1987), in the sense of trace(R^T m). */
void nearest_rotation(const double m[3][3], double rotation[3][3]);
/* Degrees, 0..180. */
double rotation_angle(const double a[3][3], const double b[3][3]);

/* The prepared path is A R B where the truth's is R: B is another choice of the head's frame, A another optical axis,
 * as that of a crop that does not lie in the middle. One pair for the whole path, by least squares over the matrices.
 */
struct path_alignment {
  double camera[3][3], head[3][3]; /* A, B */
  double scale, origin[3];         /* of the prepared places; of the prepared head's origin in the truth's head */
};

struct path_errors {
  double rotation_median, rotation_p95;               /* degrees */
  double place_median;                                /* in the truth's distance from camera to head */
  double camera_turn;                                 /* degrees, of A: about the angle between the two axes */
  double rotation_tremble[2], place_tremble[2];       /* truth, prepared: degrees, units of the truth; a frame^2 */
  double rotation_tremble_ratio, place_tremble_ratio; /* prepared / truth; NaN where the truth stands still */
  size_t seconds;                                     /* triples of successive frames behind the tremble */
};

/* truth[count] and prepared[count] are of the same frames, in their order. `focal_ratio`: the prepared focal length
 * over the truth's, both in pixels of the prepared clip. A focal length that is k times the truth's puts the head k
 * times as far away at the same size, so prepared depths are divided by k before places are compared; rotations are
 * compared as they are, for what another focal length does to them is an error of the clip. False: no memory, or count
 * below 3. */
bool compare_paths(const struct head_pose *truth, const struct head_pose *prepared, size_t count, double focal_ratio,
                   struct path_alignment *alignment, struct path_errors *errors);

/* Pixels of the video are corner + side/size * pixels of the clip. */
struct crop {
  double x, y, side, size;
};

/* Distance of the mouths' centres (means of points 48..67) in pixels of the video over the distance of the truth's
 * eyes' centres. truth is in pixels of the video, prepared in those of the clip. */
double mouth_error(float truth[68][2], float prepared[68][2], const struct crop *crop);

enum layer { LAYER_BACKGROUND, LAYER_HEAD, LAYER_NECK, LAYER_TORSO, LAYER_OTHER };
/* Of an RGB pixel of parsing/ID.png. */
enum layer layer_of(const uint8_t rgb[3]);

/* RGB, [height][width][3]. */
struct layer_map {
  const uint8_t *rgb;
  int width, height;
};
/* Intersection over union of the person (all but the background) and of the head, over those pixels of the video that
 * lie in the crop; 1 where neither has any. A pixel of the video is compared with the pixel of the clip at its middle.
 */
void compare_layers(struct layer_map truth, struct layer_map prepared, const struct crop *crop, double *person,
                    double *head);

struct blink {
  size_t first, last; /* frames, both in it */
};
/* The stretches above half of the 99th percentile; those a single frame apart are one. blinks has room for count/2 + 1.
 * Returns how many; 0 where the percentile is 0; SIZE_MAX without memory. */
size_t find_blinks(const float *closed, size_t count, struct blink *blinks);
/* Pairs each of the truth's with at most one of the prepared ones that meets it or lies a frame beside it. */
size_t match_blinks(const struct blink *truth, size_t truths, const struct blink *prepared, size_t prepareds);

/* Of values[count], which it sorts; linear between two. NaN where count is 0. */
double quantile(double *values, size_t count, double share);

#endif
