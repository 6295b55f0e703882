/* SPDX-License-Identifier: MIT
 * Compares a prepared clip with the truth's clip of the same video: poses, landmarks, layers, blinks.
 * Usage: preparecheck TRUTH CLIP [--json -|FILE] */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/memory.h"
#include "ernerf/media.h"
#include "io/file.h"
#include "io/landmarks.h"
#include "prepare_clip.h"

/* A measure that is NaN could not be taken. */
struct result {
  size_t frames, truth_frames; /* compared; of the truth */
  size_t mouths, maps;         /* frames with landmarks, with parsing, on both sides */
  double focal_ratio;
  struct path_alignment alignment;
  struct path_errors path;
  double mouth, person, head;
  size_t blinks[2], matched; /* truth, prepared */
  double blinks_found, blinks_false;
};

static ern_status frame_path(ern_context *context, const char *folder, const char *format, int64_t frame, char **path) {
  char name[64];
  snprintf(name, sizeof name, format, (long long)frame);
  return ern_path_join(context, folder, name, path);
}

/* *there is false where either clip lacks the file. */
static ern_status compare_mouth(ern_context *context, const struct prepared_clip clips[2], int64_t frame, double *error,
                                bool *there) {
  ern_status status = ERN_OK;
  float points[2][ERN_LANDMARKS][2];
  *there = true;
  for (int k = 0; k < 2 && *there && status == ERN_OK; k++) {
    char *path = NULL;
    status = frame_path(context, clips[k].folder, "ori_imgs/%lld.lms", frame, &path);
    if (status == ERN_OK) status = ern_landmarks_read(context, path, points[k]);
    ern_release(context, path);
    if (status == ERN_E_MISSING) *there = false;
  }
  if (!*there) return ERN_OK;
  if (status == ERN_OK) *error = mouth_error(points[0], points[1], &clips[1].crop);
  return status;
}

static ern_status read_map(ern_context *context, const struct prepared_clip *clip, int64_t frame, ern_image *image) {
  ern_status status = ERN_OK;
  char *path = NULL;
  ERN_TRY(frame_path(context, clip->folder, "parsing/%lld.png", frame, &path));
  ERN_TRY(ern_image_read(context, path, 3, image));
  if (image->width != clip->width || image->height != clip->height)
    ERN_TRY(ern_fail(context, ERN_E_SHAPE, "%s: %d x %d pixels, expected %d x %d", path, image->width, image->height,
                     clip->width, clip->height));
  for (size_t i = 0; i < (size_t)image->width * (size_t)image->height; i++)
    if (layer_of(image->data + 3 * i) == LAYER_OTHER)
      ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: pixel %zu is %d,%d,%d, expected a layer's colour", path, i,
                       image->data[3 * i], image->data[3 * i + 1], image->data[3 * i + 2]));
fail:
  ern_release(context, path);
  return status;
}

static ern_status compare_maps(ern_context *context, const struct prepared_clip clips[2], int64_t frame,
                               struct result *result, bool *there) {
  ern_status status = ERN_OK;
  ern_image images[2] = {{0}};
  *there = true;
  for (int k = 0; k < 2 && status == ERN_OK; k++) status = read_map(context, &clips[k], frame, &images[k]);
  if (status == ERN_E_MISSING) {
    *there = false;
    status = ERN_OK;
  } else if (status == ERN_OK) {
    double person = 0, head = 0;
    const struct layer_map maps[2] = {{images[0].data, images[0].width, images[0].height},
                                      {images[1].data, images[1].width, images[1].height}};
    compare_layers(maps[0], maps[1], &clips[1].crop, &person, &head);
    result->person += person;
    result->head += head;
  }
  for (int k = 0; k < 2; k++) ern_image_free(context, &images[k]);
  return status;
}

/* truth[n] and prepared[n]: the poses of the frames that both have. */
static ern_status compare_frames(ern_context *context, const struct prepared_clip clips[2], struct head_pose *truth,
                                 struct head_pose *prepared, double *mouths, struct result *result) {
  ern_status status = ERN_OK;
  bool there = false;
  for (size_t i = 0, j = 0; i < clips[0].count; i++) {
    const int64_t frame = clips[0].poses[i].frame;
    while (j < clips[1].count && clips[1].poses[j].frame < frame) j++;
    if (j == clips[1].count || clips[1].poses[j].frame != frame) continue;
    truth[result->frames] = clips[0].poses[i];
    prepared[result->frames++] = clips[1].poses[j];
    ERN_TRY(compare_mouth(context, clips, frame, &mouths[result->mouths], &there));
    result->mouths += there;
    ERN_TRY(compare_maps(context, clips, frame, result, &there));
    result->maps += there;
  }
fail:
  return status;
}

static ern_status compare_blinks(ern_context *context, const struct prepared_clip clips[2], struct result *result) {
  ern_status status = ERN_OK;
  struct blink *blinks[2] = {NULL, NULL};
  result->blinks_found = result->blinks_false = (double)NAN;
  for (int k = 0; k < 2; k++) {
    ERN_TRY(ERN_NEW(context, clips[k].frames / 2 + 1, &blinks[k]));
    result->blinks[k] = find_blinks(clips[k].closed, clips[k].frames, blinks[k]);
    if (result->blinks[k] == SIZE_MAX) ERN_TRY(ern_fail(context, ERN_E_NO_MEMORY, "no memory for blinks"));
  }
  result->matched = match_blinks(blinks[0], result->blinks[0], blinks[1], result->blinks[1]);
  if (result->blinks[0] > 0) result->blinks_found = (double)result->matched / (double)result->blinks[0];
  if (clips[1].closed != NULL) /* of none that are there, none are false */
    result->blinks_false =
        result->blinks[1] > 0 ? (double)(result->blinks[1] - result->matched) / (double)result->blinks[1] : 0.0;
fail:
  for (int k = 0; k < 2; k++) ern_release(context, blinks[k]);
  return status;
}

static ern_status compare(ern_context *context, const struct prepared_clip clips[2], struct result *result) {
  ern_status status = ERN_OK;
  struct head_pose *poses[2] = {NULL, NULL};
  double *mouths = NULL;
  const struct crop *crop = &clips[1].crop, *whole = &clips[0].crop;
  *result = (struct result){.truth_frames = clips[0].count};
  if (whole->x != 0 || whole->y != 0 || whole->side != whole->size)
    ERN_TRY(ern_fail(context, ERN_E_ARGUMENT, "%s: has a crop of its own, expected the whole video", clips[0].folder));
  result->focal_ratio = clips[1].focal / (clips[0].focal * crop->size / crop->side);
  for (int k = 0; k < 2; k++) ERN_TRY(ERN_NEW(context, clips[0].count, &poses[k]));
  ERN_TRY(ERN_NEW(context, clips[0].count, &mouths));
  ERN_TRY(compare_frames(context, clips, poses[0], poses[1], mouths, result));
  if (result->frames < 3)
    ERN_TRY(ern_fail(context, ERN_E_SHAPE, "%s: %zu frames (img_id) of %s, expected 3 or more", clips[1].folder,
                     result->frames, clips[0].folder));
  if (!compare_paths(poses[0], poses[1], result->frames, result->focal_ratio, &result->alignment, &result->path))
    ERN_TRY(ern_fail(context, ERN_E_NO_MEMORY, "no memory for %zu poses", result->frames));
  result->mouth = quantile(mouths, result->mouths, 0.5);
  result->person = result->maps > 0 ? result->person / (double)result->maps : (double)NAN;
  result->head = result->maps > 0 ? result->head / (double)result->maps : (double)NAN;
  ERN_TRY(compare_blinks(context, clips, result));
fail:
  for (int k = 0; k < 2; k++) ern_release(context, poses[k]);
  ern_release(context, mouths);
  return status;
}

/* ---- what is said ------------------------------------------------------------------------------------------------ */

static json_t *number(double value) { return isfinite(value) ? json_real(value) : json_null(); }

static json_t *as_json(const struct result *r) {
  json_t *object = json_object();
  const struct {
    const char *name;
    double value;
  } numbers[] = {{"focal_ratio", r->focal_ratio},
                 {"rotation_median", r->path.rotation_median},
                 {"rotation_p95", r->path.rotation_p95},
                 {"camera_turn", r->path.camera_turn},
                 {"place_median", r->path.place_median},
                 {"rotation_tremble", r->path.rotation_tremble_ratio},
                 {"place_tremble", r->path.place_tremble_ratio},
                 {"mouth", r->mouth},
                 {"person_iou", r->person},
                 {"head_iou", r->head},
                 {"blinks_found", r->blinks_found},
                 {"blinks_false", r->blinks_false}};
  const struct {
    const char *name;
    size_t value;
  } counts[] = {{"frames", r->frames},          {"truth_frames", r->truth_frames},  {"mouth_frames", r->mouths},
                {"parsing_frames", r->maps},    {"truth_blinks", r->blinks[0]},     {"prepared_blinks", r->blinks[1]},
                {"matched_blinks", r->matched}, {"tremble_frames", r->path.seconds}};
  int wrong = object == NULL;
  for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++)
    wrong |= json_object_set_new(object, numbers[i].name, number(numbers[i].value));
  for (size_t i = 0; i < sizeof counts / sizeof *counts; i++)
    wrong |= json_object_set_new(object, counts[i].name, json_integer((json_int_t)counts[i].value));
  if (wrong != 0) {
    json_decref(object);
    return NULL;
  }
  return object;
}

static void say(const struct result *r) {
  const struct path_errors *p = &r->path;
  printf("frames         %zu of %zu\n", r->frames, r->truth_frames);
  printf("focal length   %.4f of the truth's\n", r->focal_ratio);
  printf("rotation       median %.3f, 95th percentile %.3f degrees (axis of the camera %.3f degrees off)\n",
         p->rotation_median, p->rotation_p95, p->camera_turn);
  printf("place          median %.4f of the distance\n", p->place_median);
  printf("tremble        rotation %.3f (%.5f of %.5f degrees), place %.3f (%.6f of %.6f)\n", p->rotation_tremble_ratio,
         p->rotation_tremble[1], p->rotation_tremble[0], p->place_tremble_ratio, p->place_tremble[1],
         p->place_tremble[0]);
  printf("mouth          median %.4f eye distances (%zu frames)\n", r->mouth, r->mouths);
  printf("layers         person %.4f, head %.4f (%zu frames)\n", r->person, r->head, r->maps);
  printf("blinks         %zu of %zu found, %zu of %zu false\n", r->matched, r->blinks[0], r->blinks[1] - r->matched,
         r->blinks[1]);
}

static int say_json(const struct result *result, const char *path) {
  json_t *object = as_json(result);
  const bool standard = strcmp(path, "-") == 0;
  const int wrong = object == NULL || (standard ? json_dumpf(object, stdout, JSON_INDENT(1))
                                                : json_dump_file(object, path, JSON_INDENT(1)));
  json_decref(object);
  if (wrong != 0) fprintf(stderr, "preparecheck: %s: cannot be written\n", path);
  if (standard) printf("\n");
  return wrong;
}

int main(int argc, char **argv) {
  const bool json = argc == 5 && strcmp(argv[3], "--json") == 0;
  if (argc != 3 && !json) {
    fprintf(stderr, "usage: preparecheck TRUTH CLIP [--json -|FILE]\n");
    return 2;
  }
  ern_context *context = NULL;
  struct prepared_clip clips[2] = {{0}};
  struct result result;
  if (ern_context_create(&context, NULL) != ERN_OK) return EXIT_FAILURE;
  ern_status status = ERN_OK;
  for (int k = 0; k < 2 && status == ERN_OK; k++) status = prepared_clip_read(context, argv[1 + k], &clips[k]);
  if (status == ERN_OK) status = compare(context, clips, &result);
  int outcome = status == ERN_OK ? EXIT_SUCCESS : EXIT_FAILURE;
  if (status != ERN_OK) fprintf(stderr, "preparecheck: %s\n", ern_last_error(context));
  if (status == ERN_OK && (!json || strcmp(argv[4], "-") != 0)) say(&result);
  if (status == ERN_OK && json && say_json(&result, argv[4]) != 0) outcome = EXIT_FAILURE;
  for (int k = 0; k < 2; k++) prepared_clip_free(context, &clips[k]);
  ern_context_free(&context);
  return outcome;
}
