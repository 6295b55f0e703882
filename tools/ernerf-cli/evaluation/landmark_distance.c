/* SPDX-License-Identifier: MIT */
#include "evaluation/landmark_distance.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "ernerf-lab/measured_files.h"

enum { EXAMPLES = 6, MOUTH = 48, POINTS = 68, PATH_BYTES = 4096 };

double landmark_distance(const float a[68][2], const float b[68][2], int begin, int end) {
  double shift[2] = {0, 0}, sum = 0;
  const int n = end - begin;
  for (int k = begin; k < end; k++)
    for (int c = 0; c < 2; c++) shift[c] += ((double)a[k][c] - (double)b[k][c]) / n;
  for (int k = begin; k < end; k++)
    sum += hypot((double)a[k][0] - (double)b[k][0] - shift[0], (double)a[k][1] - (double)b[k][1] - shift[1]) / n;
  return sum;
}

static const ern_clip_frame *frame_of(const struct evaluation *evaluation, size_t k) {
  const struct source_frame *frame = &evaluation->frame_source.source_frame[k];
  return ern_clip_frame_at(evaluation->clip, frame->split, frame->index);
}

static int truth_of(const struct evaluation *evaluation, size_t k, ern_image *truth) {
  return evaluate_truth(evaluation, &evaluation->frame_source.source_frame[k], truth);
}

/* ---- a folder ---------------------------------------------------------------------------------------------------- */

/* The file of frame k: ID.lms, or the number of the picture for pictures of `render -o DIR/%05d.png`. False: the path
 * is too long. */
static bool points_path(const struct landmark_distance *lmd, const struct evaluation *evaluation, size_t k,
                        bool by_number, char path[PATH_BYTES]) {
  const struct source_frame *frame = &evaluation->frame_source.source_frame[k];
  const int bytes = by_number
                        ? snprintf(path, PATH_BYTES, "%s/%05zu.lms", lmd->path, (size_t)frame->number)
                        : snprintf(path, PATH_BYTES, "%s/%" PRId64 ".lms", lmd->path, (int64_t)frame->pose.img_id);
  return bytes < PATH_BYTES;
}

/* Whether files are named by number: the first frame decides for all. */
static bool are_by_number(const struct landmark_distance *lmd, const struct evaluation *evaluation) {
  char by_id[PATH_BYTES], by_number[PATH_BYTES];
  size_t k = 0;
  while (k < evaluation->frame_source.count && !frame_of(evaluation, k)->has_landmarks) k++;
  return k < evaluation->frame_source.count && points_path(lmd, evaluation, k, false, by_id) &&
         points_path(lmd, evaluation, k, true, by_number) && access(by_id, F_OK) != 0 && access(by_number, F_OK) == 0;
}

static int open_folder(struct landmark_distance *lmd, const struct evaluation *evaluation) {
  struct session *session = evaluation->session;
  const size_t count = evaluation->frame_source.count;
  char path[PATH_BYTES];
  struct stat about;
  if (stat(lmd->path, &about) != 0 || !S_ISDIR(about.st_mode))
    return session_fail_with(session, "%s: is no folder, expected a folder of ID.lms, or a network, FILE.onnx",
                             lmd->path);
  lmd->points = malloc((count > 0 ? count : 1) * sizeof *lmd->points);
  if (lmd->points == NULL) return session_fail_with(session, "no memory for the landmarks of %zu frames", count);
  const bool by_number = are_by_number(lmd, evaluation);
  for (size_t k = 0; k < count; k++) {
    if (!frame_of(evaluation, k)->has_landmarks) continue;
    if (!points_path(lmd, evaluation, k, by_number, path))
      return session_fail_with(session, "%s: the path is too long", lmd->path);
    if (ern_points_read(session->context, path, lmd->points[k]) != ERN_OK) return session_fail(session);
  }
  return 0;
}

/* ---- a network --------------------------------------------------------------------------------------------------- */

/* Calibrates the network on some recorded frames, evenly spaced, with the clip's landmarks as the initial guess. */
static int learn(struct landmark_distance *lmd, const struct evaluation *evaluation, size_t known) {
  const size_t examples = known < EXAMPLES ? known : EXAMPLES;
  size_t seen = 0, taken = 0;
  for (size_t k = 0; k < evaluation->frame_source.count && taken < examples; k++) {
    const ern_clip_frame *frame = frame_of(evaluation, k);
    ern_image truth = {0};
    if (!frame->has_landmarks || seen++ != taken * known / examples) continue;
    taken++;
    if (truth_of(evaluation, k, &truth) != 0) return EXIT_FAILURE;
    if (lmd->library.learn(lmd->network, truth.data, truth.width, truth.height, frame->landmarks) != ERN_OK)
      return session_fail(evaluation->session);
  }
  return lmd->library.decide(lmd->network) == ERN_OK ? 0 : session_fail(evaluation->session);
}

static int open_network(struct landmark_distance *lmd, const struct evaluation *evaluation, size_t known) {
  struct session *session = evaluation->session;
  const int width = evaluation->info.width, height = evaluation->info.height;
  lmd->rgb = malloc(3 * (size_t)width * (size_t)height);
  if (lmd->rgb == NULL) return session_fail_with(session, "no memory for a picture of %d x %d", width, height);
  if (prepare_library_landmarks(&lmd->library, session) != 0) return EXIT_FAILURE;
  if (lmd->library.open(session->context, lmd->path, &lmd->network) != ERN_OK) return session_fail(session);
  return learn(lmd, evaluation, known);
}

static int find_both(struct landmark_distance *lmd, const struct evaluation *evaluation, size_t k, float drawn[68][2],
                     float truth[68][2]) {
  const int width = evaluation->info.width, height = evaluation->info.height;
  const size_t pixels = (size_t)width * (size_t)height;
  const ern_clip_frame *frame = frame_of(evaluation, k);
  ern_image image = {0};
  if (truth_of(evaluation, k, &image) != 0) return EXIT_FAILURE;
  for (size_t i = 0; i < pixels; i++) memcpy(lmd->rgb + 3 * i, evaluation->rgba + 4 * i, 3);
  if (lmd->library.find(lmd->network, lmd->rgb, width, height, frame->landmarks, drawn) != ERN_OK ||
      lmd->library.find(lmd->network, image.data, width, height, frame->landmarks, truth) != ERN_OK)
    return session_fail(evaluation->session);
  return 0;
}

/* ---- both -------------------------------------------------------------------------------------------------------- */

int landmark_distance_open(struct landmark_distance *lmd, const struct evaluation *evaluation) {
  size_t known = 0;
  if (lmd->path == NULL) return 0;
  for (size_t k = 0; k < evaluation->frame_source.count; k++) known += frame_of(evaluation, k)->has_landmarks;
  if (known == 0)
    return session_fail_with(evaluation->session,
                             "--landmarks %s: the clip has no landmarks of these frames, expected its ori_imgs/ID.lms",
                             lmd->path);
  const char *dot = strrchr(lmd->path, '.');
  return dot != NULL && strcmp(dot, ".onnx") == 0 ? open_network(lmd, evaluation, known) : open_folder(lmd, evaluation);
}

int landmark_distance_add(struct landmark_distance *lmd, const struct evaluation *evaluation, size_t k, json_t *row) {
  const ern_clip_frame *frame = frame_of(evaluation, k);
  float drawn[POINTS][2], truth[POINTS][2];
  if (lmd->path == NULL) return 0;
  if (!frame->has_landmarks) {
    lmd->left_out++;
    json_object_set_new(row, "lmd_mouth", json_null());
    json_object_set_new(row, "lmd_face", json_null());
    return 0;
  }
  if (lmd->network == NULL) {
    memcpy(drawn, lmd->points[k], sizeof drawn);
    memcpy(truth, frame->landmarks, sizeof truth);
  } else if (find_both(lmd, evaluation, k, drawn, truth) != 0) {
    return EXIT_FAILURE;
  }
  const double mouth = landmark_distance((const float(*)[2])drawn, (const float(*)[2])truth, MOUTH, POINTS);
  const double face = landmark_distance((const float(*)[2])drawn, (const float(*)[2])truth, 0, POINTS);
  lmd->mouth += mouth;
  lmd->face += face;
  lmd->frames++;
  json_object_set_new(row, "lmd_mouth", session_number(mouth));
  json_object_set_new(row, "lmd_face", session_number(face));
  return 0;
}

void landmark_distance_close(struct landmark_distance *lmd) {
  if (lmd->network != NULL) lmd->library.free(&lmd->network);
  free(lmd->rgb);
  free(lmd->points);
  *lmd = (struct landmark_distance){.path = NULL};
}
