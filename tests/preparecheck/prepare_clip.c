/* SPDX-License-Identifier: MIT
 * Reads poses, crop and blinks of a clip's folder. */
#include "prepare_clip.h"

#include <stdlib.h>
#include <string.h>

#include "core/memory.h"
#include "ernerf/data.h"
#include "io/csv.h"
#include "io/file.h"
#include "io/json.h"

enum { JSON_LIMIT = 1 << 24, JSON_MEMORY = 1 << 28 };

/* The file has camera to world, [R^T | -R^T t]. Its numbers are floats here, so they are brought back to a rotation. */
static void from_matrix(const ern_pose *pose, struct head_pose *made) {
  double read[3][3];
  made->frame = pose->img_id;
  for (int i = 0; i < 3; i++) {
    made->place[i] = 0;
    for (int j = 0; j < 3; j++) {
      read[i][j] = (double)pose->matrix[4 * j + i];
      made->place[i] -= read[i][j] * (double)pose->matrix[4 * j + 3];
    }
  }
  nearest_rotation((const double(*)[3])read, made->rotation);
}

static int by_frame(const void *a, const void *b) {
  const struct head_pose *one = a, *other = b;
  return (one->frame > other->frame) - (one->frame < other->frame);
}

static ern_status read_poses(ern_context *context, struct prepared_clip *clip) {
  ern_status status = ERN_OK;
  ern_pose_list lists[2] = {{0}};
  char *path = NULL;
  for (int k = 0; k < 2; k++) {
    ERN_TRY(ern_path_join(context, clip->folder, k == 0 ? "transforms_train.json" : "transforms_val.json", &path));
    ERN_TRY(ern_pose_list_load(context, path, &lists[k]));
    ern_release(context, path);
    path = NULL;
  }
  ERN_TRY(ERN_NEW(context, lists[0].count + lists[1].count, &clip->poses));
  for (int k = 0; k < 2; k++)
    for (size_t i = 0; i < lists[k].count; i++) from_matrix(&lists[k].poses[i], &clip->poses[clip->count++]);
  qsort(clip->poses, clip->count, sizeof *clip->poses, by_frame);
  for (size_t i = 1; i < clip->count; i++)
    if (clip->poses[i].frame == clip->poses[i - 1].frame)
      ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: img_id %lld is there twice, expected once", clip->folder,
                       (long long)clip->poses[i].frame));
  clip->focal = lists[0].focal;
  clip->width = lists[0].width;
  clip->height = lists[0].height;
fail:
  ern_release(context, path);
  for (int k = 0; k < 2; k++) ern_pose_list_free(context, &lists[k]);
  return status;
}

static ern_status read_crop(ern_context *context, struct prepared_clip *clip) {
  static const char *const keys[4] = {"x", "y", "side", "size"};
  ern_status status = ERN_OK;
  char *path = NULL;
  uint8_t *text = NULL;
  size_t length = 0;
  json_t *root = NULL;
  double values[4];
  clip->crop = (struct crop){0, 0, clip->width, clip->width};
  ERN_TRY(ern_path_join(context, clip->folder, "prepare.json", &path));
  status = ern_file_read(context, path, JSON_LIMIT, &text, &length);
  if (status == ERN_E_MISSING) {
    ern_release(context, path);
    return ERN_OK;
  }
  if (status == ERN_OK) ERN_TRY(ern_json_parse(context, path, "", (const char *)text, length, JSON_MEMORY, &root));
  const json_t *crop = root != NULL ? json_object_get(root, "crop") : NULL;
  for (int k = 0; k < 4 && crop != NULL; k++) {
    const json_t *value = json_object_get(crop, keys[k]);
    values[k] = json_number_value(value);
    if (!json_is_number(value) || (k >= 2 && values[k] <= 0))
      ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: crop.%s is missing or no number, expected one%s", path, keys[k],
                       k >= 2 ? " above 0" : ""));
  }
  if (crop != NULL) clip->crop = (struct crop){values[0], values[1], values[2], values[3]};
  if (clip->crop.size != clip->width || clip->crop.size != clip->height)
    ERN_TRY(ern_fail(context, ERN_E_SHAPE, "%s: crop.size is %g, expected the pictures' %d x %d", path, clip->crop.size,
                     clip->width, clip->height));
fail:
  json_decref(root);
  ern_release(context, text);
  ern_release(context, path);
  return status;
}

static ern_status read_closed(ern_context *context, struct prepared_clip *clip) {
  static const char *const names[2][2] = {{"au.csv", "AU45_r"}, {"curves.csv", "blink"}};
  ern_status status = ERN_E_MISSING;
  for (int k = 0; k < 2 && status == ERN_E_MISSING; k++) {
    char *path = NULL;
    status = ern_path_join(context, clip->folder, names[k][0], &path);
    if (status == ERN_OK) status = ern_csv_read_column(context, path, names[k][1], &clip->closed, &clip->frames);
    ern_release(context, path);
  }
  return status == ERN_E_MISSING ? ERN_OK : status;
}

ern_status prepared_clip_read(ern_context *context, const char *folder, struct prepared_clip *clip) {
  ern_status status = ERN_OK;
  *clip = (struct prepared_clip){.folder = folder};
  ERN_TRY(read_poses(context, clip));
  ERN_TRY(read_crop(context, clip));
  ERN_TRY(read_closed(context, clip));
  return ERN_OK;
fail:
  prepared_clip_free(context, clip);
  return status;
}

void prepared_clip_free(ern_context *context, struct prepared_clip *clip) {
  ern_release(context, clip->poses);
  ern_release(context, clip->closed);
  *clip = (struct prepared_clip){0};
}
