/* SPDX-License-Identifier: MIT */
#include "evaluation/inception.h"

#include <math.h>
#include <stdlib.h>

#include "evaluation/frechet.h"

enum { LEAST_SIDE = 16, MOST_SIDE = 1024, MOST_FEATURES = 8192 };

/* Linear interpolation of value i of `to` from `from` values: returns the index of the first; *share: weight of the
 * next. */
static int place_of(int i, int to, int from, float *share) {
  const float at = ((float)i + 0.5f) * (float)from / (float)to - 0.5f;
  const float inside = at < 0 ? 0 : at > (float)(from - 1) ? (float)(from - 1) : at;
  const int first = (int)inside;
  *share = inside - (float)first;
  return first;
}

void inception_input(float *input, int to_width, int to_height, const uint8_t *pixels, int channels, int width,
                     int height) {
  for (int y = 0; y < to_height; y++) {
    float down, across;
    const int top = place_of(y, to_height, height, &down), bottom = top + 1 < height ? top + 1 : top;
    for (int x = 0; x < to_width; x++) {
      const int left = place_of(x, to_width, width, &across), right = left + 1 < width ? left + 1 : left;
      for (int c = 0; c < 3; c++) {
#define AT(row, column) (float)pixels[((size_t)(row) * (size_t)width + (size_t)(column)) * (size_t)channels + (size_t)c]
        const float high = (1 - across) * AT(top, left) + across * AT(top, right);
        const float low = (1 - across) * AT(bottom, left) + across * AT(bottom, right);
#undef AT
        input[((size_t)c * (size_t)to_height + (size_t)y) * (size_t)to_width + (size_t)x] =
            2 * ((1 - down) * high + down * low) / 255 - 1;
      }
    }
  }
}

int inception_open(struct inception *inception, const struct evaluation *evaluation) {
  struct session *session = evaluation->session;
  int shape[ERN_NETWORK_DIMS] = {0};
  if (inception->path == NULL) return 0;
  inception->capacity = evaluation->frame_source.count;
  if (inception->capacity < 2)
    return session_fail_with(session, "--inception: %zu frame, expected 2 at least: a covariance is of several",
                             inception->capacity);
  if (ern_network_open(session->context, inception->path, &inception->network) != ERN_OK) return session_fail(session);
  const int dims = ern_network_input(inception->network, shape);
  if (dims != 4 || shape[0] != 1 || shape[1] != 3 || shape[2] < LEAST_SIDE || shape[2] > MOST_SIDE ||
      shape[3] < LEAST_SIDE || shape[3] > MOST_SIDE)
    return session_fail_with(session,
                             "%s: its input has %d sizes, [%d, %d, %d, %d], expected [1, 3, height, width] of %d to %d "
                             "a side, such as 299",
                             inception->path, dims, shape[0], shape[1], shape[2], shape[3], (int)LEAST_SIDE,
                             (int)MOST_SIDE);
  inception->height = shape[2];
  inception->width = shape[3];
  inception->input = malloc(3 * (size_t)shape[2] * (size_t)shape[3] * sizeof *inception->input);
  if (inception->input == NULL)
    return session_fail_with(session, "no memory for a picture of %d x %d", shape[3], shape[2]);
  return 0;
}

static int reserve(struct inception *inception, struct session *session, size_t features) {
  if (features == 0 || features > MOST_FEATURES)
    return session_fail_with(session, "%s: its first output has %zu numbers, expected features: 1 to %d",
                             inception->path, features, (int)MOST_FEATURES);
  inception->features = features;
  inception->drawn = malloc(inception->capacity * features * sizeof *inception->drawn);
  inception->truth = malloc(inception->capacity * features * sizeof *inception->truth);
  if (inception->drawn == NULL || inception->truth == NULL)
    return session_fail_with(session, "no memory for %zu features of %zu frames", features, inception->capacity);
  return 0;
}

static int run(struct inception *inception, struct session *session, double **features) {
  const float *output = NULL;
  size_t count = 0;
  if (ern_network_run(inception->network, inception->input, &output, &count) != ERN_OK) return session_fail(session);
  if (inception->features == 0 && reserve(inception, session, count) != 0) return EXIT_FAILURE;
  if (count != inception->features)
    return session_fail_with(session, "%s: its first output has %zu numbers, and had %zu before", inception->path,
                             count, inception->features);
  for (size_t i = 0; i < count; i++) (*features)[inception->frames * count + i] = (double)output[i];
  return 0;
}

int inception_add(struct inception *inception, const struct evaluation *evaluation, size_t k) {
  const struct source_frame *frame = &evaluation->frame_source.source_frame[k];
  const int width = evaluation->info.width, height = evaluation->info.height;
  struct session *session = evaluation->session;
  ern_image truth = {0};
  if (inception->path == NULL || inception->frames >= inception->capacity) return 0;
  if (evaluate_truth(evaluation, frame, &truth) != 0) return EXIT_FAILURE;
  inception_input(inception->input, inception->width, inception->height, truth.data, 3, width, height);
  if (run(inception, session, &inception->truth) != 0) return EXIT_FAILURE;
  inception_input(inception->input, inception->width, inception->height, evaluation->rgba, 4, width, height);
  if (run(inception, session, &inception->drawn) != 0) return EXIT_FAILURE;
  inception->frames++;
  return 0;
}

int inception_finish(struct inception *inception, struct session *session) {
  if (inception->path == NULL) return 0;
  inception->distance = frechet_distance(inception->drawn, inception->truth, inception->frames, inception->features);
  return isfinite(inception->distance)
             ? 0
             : session_fail_with(session,
                                 "%s: the distance of its features is not finite, or there is no memory for %zu "
                                 "x %zu numbers",
                                 inception->path, inception->frames, inception->frames);
}

void inception_close(struct inception *inception) {
  ern_network_free(&inception->network);
  free(inception->input);
  free(inception->drawn);
  free(inception->truth);
  *inception = (struct inception){.path = NULL};
}
