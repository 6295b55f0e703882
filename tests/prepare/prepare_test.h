/* SPDX-License-Identifier: MIT
 * A job as input for the steps of `prepare`, without a video. */
#ifndef ERN_TESTS_PREPARE_TEST_H
#define ERN_TESTS_PREPARE_TEST_H

#include <math.h>
#include <stdbool.h>
#include <sys/stat.h>
#include <unistd.h>

#include "../support.h"
#include "prepare/head_shape.h"
#include "prepare/prepare_job.h"

struct made_job {
  struct ern_prepare_job job;
  ern_prepare_options options;
  ern_prepare_verdict verdict;
};

static inline void made_job_open(struct made_job *m, const char *folder, int side, size_t frames) {
  *m = (struct made_job){.options = ern_prepare_options_default(), .verdict = {.step = "made"}};
  m->options.side = side;
  m->job = (struct ern_prepare_job){.context = support_context(),
                                    .video = "made.mp4",
                                    .folder = folder,
                                    .options = &m->options,
                                    .side = side,
                                    .focal = 2.4 * side,
                                    .frames = frames,
                                    .record = json_object(),
                                    .verdict = &m->verdict,
                                    .figures = json_object()};
  support_clear(folder);
  assert_int_equal(mkdir(folder, 0777), 0);
}

static inline void made_job_close(struct made_job *m) {
  json_decref(m->job.record);
  json_decref(m->job.figures);
  ern_context_free(&m->job.context);
}

/* Uniform in -1..1. */
static inline double made_random(uint64_t *state) { /* xorshift64* */
  *state ^= *state >> 12;
  *state ^= *state << 25;
  *state ^= *state >> 27;
  return (double)((*state * 0x2545f4914f6cdd1du) >> 11) * 0x1p-52 - 1;
}

/* A head `depth` metres in front of the camera, rotated by yaw, pitch and roll, degrees. */
static inline struct ern_head_pose made_pose(double yaw, double pitch, double roll, double x, double y, double depth) {
  const double d = 0.017453292519943295;
  const double a = yaw * d, b = pitch * d, c = roll * d;
  const double turn[3][3] = {{cos(a), 0, sin(a)}, {0, 1, 0}, {-sin(a), 0, cos(a)}};
  const double nod[3][3] = {{1, 0, 0}, {0, cos(b), -sin(b)}, {0, sin(b), cos(b)}};
  const double tilt[3][3] = {{cos(c), -sin(c), 0}, {sin(c), cos(c), 0}, {0, 0, 1}};
  struct ern_head_pose pose = {.translation = {x, y, -depth}};
  for (int i = 0; i < 3; i++)
    for (int k = 0; k < 3; k++)
      for (int m = 0; m < 3; m++)
        for (int n = 0; n < 3; n++) pose.rotation[i][k] += tilt[i][m] * nod[m][n] * turn[n][k];
  return pose;
}

/* Degrees between two rotations: |A - B|_F^2 = 8 sin^2(angle/2), which is exact also for small ones. */
static inline double made_angle(const double a[3][3], const double b[3][3]) {
  double square = 0;
  for (int i = 0; i < 9; i++) square += pow(a[i / 3][i % 3] - b[i / 3][i % 3], 2);
  return 2 * asin(fmin(sqrt(square / 8), 1)) * 57.29577951308232;
}

#endif
