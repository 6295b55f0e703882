/* SPDX-License-Identifier: MIT */
#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "core/memory.h"
#include "io/csv.h"
#include "io/file.h"
#include "io/json.h"
#include "io/npy.h"
#include "media/clip/clip.h"

/* Extensions looked for, in order. */
static const char *const part_endings[][3] = {[ERN_PART_TRUTH] = {"jpg", "png", "jpeg"},
                                              [ERN_PART_TORSO] = {"png"},
                                              [ERN_PART_LANDMARKS] = {"lms"},
                                              [ERN_PART_PARSING] = {"png"}};

ern_status ern_clip_path(ern_context *context, const char *folder, enum ern_clip_content content, char **path) {
  return ern_path_join(context, folder, ern_clip_content(content), path);
}

/* A link without a target, and what cannot be looked up, such as a file on a disk that fails, are there: opening them
 * gives the error. Taken for missing, the clip would be used without them. */
static ern_status is_there(ern_context *context, const char *folder, const char *name, bool *there) {
  char *path = NULL;
  struct stat about;
  const ern_status status = ern_path_join(context, folder, name, &path);
  *there = status == ERN_OK && (lstat(path, &about) == 0 || (errno != ENOENT && errno != ENOTDIR));
  ern_release(context, path);
  return status;
}

ern_status ern_clip_has(ern_context *context, const char *folder, enum ern_clip_content content, bool *there) {
  return is_there(context, folder, ern_clip_content(content), there);
}

ern_status ern_clip_part_path(ern_context *context, const char *folder, ern_clip_part part, int64_t img_id,
                              char **path) {
  ern_status status = ERN_OK;
  char name[64];
  *path = NULL;
  for (size_t i = 0; i < 3 && part_endings[part][i] != NULL; i++) {
    bool there = false;
    snprintf(name, sizeof name, "%s/%" PRId64 ".%s", ern_clip_content(part), img_id, part_endings[part][i]);
    ERN_TRY(is_there(context, folder, name, &there));
    if (there) return ern_path_join(context, folder, name, path);
  }
  return ern_fail(context, ERN_E_MISSING, "%s/%s/%" PRId64 ".%s: is missing, and img_id %" PRId64 " needs it", folder,
                  ern_clip_content(part), img_id, part_endings[part][0], img_id);
fail:
  return status;
}

ern_status ern_clip_doubled_pictures(ern_context *context, const char *folder, const ern_pose_list lists[2],
                                     size_t *doubled, int64_t *img_id) {
  ern_status status = ERN_OK;
  char name[64];
  *doubled = 0;
  for (int split = 0; split < 2; split++)
    for (size_t i = 0; i < lists[split].count; i++) {
      const int64_t id = lists[split].poses[i].img_id;
      int pictures = 0;
      for (int k = 0; k < 3 && pictures < 2; k++) {
        bool there = false;
        snprintf(name, sizeof name, "%s/%" PRId64 ".%s", ern_clip_content(ERN_PART_TRUTH), id,
                 part_endings[ERN_PART_TRUTH][k]);
        ERN_TRY(is_there(context, folder, name, &there));
        pictures += there;
      }
      if (pictures > 1 && (*doubled)++ == 0) *img_id = id;
    }
fail:
  return status;
}

ern_status ern_clip_check_prepared(ern_context *context, const char *folder) {
  static const char *const steps[] = {"face", "pose", "landmarks", "layers", "eyes", "features"};
  enum { RECORD_LIMIT = 1 << 22, JSON_LIMIT = 1 << 28 };
  ern_status status = ERN_OK;
  char *path = NULL;
  uint8_t *text = NULL;
  size_t length = 0;
  json_t *record = NULL;
  char kept[ERN_ERROR_BYTES];
  bool there = false;
  ERN_TRY(ern_clip_has(context, folder, ERN_CLIP_RECORD, &there));
  if (!there) return ERN_OK;
  ERN_TRY(ern_clip_path(context, folder, ERN_CLIP_RECORD, &path));
  ERN_TRY(ern_file_read(context, path, RECORD_LIMIT, &text, &length));
  ern_error_keep(context, kept);
  status = ern_json_parse(context, path, "", (const char *)text, length, JSON_LIMIT, &record);
  if (status == ERN_E_FORMAT) ern_error_restore(context, kept); /* no JSON object: another program's file */
  if (status != ERN_E_FORMAT) ERN_TRY(status);
  status = ERN_OK;
  const json_t *done = json_object_get(record, "steps");
  const bool ours = json_is_integer(json_object_get(record, "version")) && json_is_object(done);
  for (size_t i = 0; i < sizeof steps / sizeof *steps && ours; i++) {
    const char *verdict = json_string_value(json_object_get(json_object_get(done, steps[i]), "verdict"));
    if (verdict == NULL || strcmp(verdict, "refused") == 0)
      ERN_TRY(ern_fail(context, ERN_E_STATE,
                       "%s: the step \"%s\" %s, so files of the clip are missing or of earlier results; expected a "
                       "call of ernerf prepare that does the steps that are left",
                       path, steps[i], verdict == NULL ? "is not done" : "was refused"));
  }
fail:
  ern_release(context, path);
  ern_release(context, text);
  json_decref(record);
  return status;
}

ern_status ern_clip_picture_check(ern_context *context, const char *path, int width, int height) {
  ern_status status = ERN_OK;
  int found_width = 0, found_height = 0;
  ERN_TRY(ern_image_size(context, path, &found_width, &found_height));
  if (found_width == width && found_height == height) return ERN_OK;
  return ern_fail(context, ERN_E_SHAPE, "%s: size is %d x %d, expected %d x %d, the size in transforms_train.json",
                  path, found_width, found_height, width, height);
fail:
  return status;
}

ern_status ern_clip_train_poses(ern_context *context, const char *folder, ern_pose_list *train) {
  ern_status status = ERN_OK;
  char *path = NULL;
  *train = (ern_pose_list){0};
  ERN_TRY(ern_clip_path(context, folder, ERN_CLIP_TRAIN, &path));
  ERN_TRY(ern_pose_list_load(context, path, train));
fail:
  ern_release(context, path);
  return status;
}

static ern_status check_same(ern_context *context, const char *path, const char *field, double found, double expected) {
  if (fabs(found - expected) <= 1e-6 * fabs(expected)) return ERN_OK;
  return ern_fail(context, ERN_E_MISMATCH, "%s: field %s is %.9g, expected %.9g as in transforms_train.json", path,
                  field, found, expected);
}

ern_status ern_clip_val_poses(ern_context *context, const char *folder, const ern_pose_list *train,
                              ern_pose_list *val) {
  ern_status status = ERN_OK;
  char *path = NULL;
  bool there = false;
  *val = (ern_pose_list){0};
  ERN_TRY(ern_clip_has(context, folder, ERN_CLIP_VAL, &there));
  if (!there) return ERN_OK;
  ERN_TRY(ern_clip_path(context, folder, ERN_CLIP_VAL, &path));
  ERN_TRY(ern_pose_list_load(context, path, val));
  ERN_TRY(check_same(context, path, "focal_len", val->focal, train->focal));
  ERN_TRY(check_same(context, path, "cx", val->cx, train->cx));
  ERN_TRY(check_same(context, path, "cy", val->cy, train->cy));
  ERN_TRY(check_same(context, path, "w", val->width, train->width));
  ERN_TRY(check_same(context, path, "h", val->height, train->height));
  ern_release(context, path);
  return ERN_OK;
fail:
  ern_pose_list_free(context, val);
  ern_release(context, path);
  return status;
}

void ern_clip_largest_ids(const ern_pose_list lists[2], int64_t *img_id, int64_t *aud_id) {
  *img_id = *aud_id = 0;
  for (int split = 0; split < 2; split++) {
    for (size_t i = 0; i < lists[split].count; i++) {
      const ern_pose *pose = &lists[split].poses[i];
      if (pose->img_id > *img_id) *img_id = pose->img_id;
      if (pose->aud_id > *aud_id) *aud_id = pose->aud_id;
    }
  }
}

static int compare_numbers(const void *a, const void *b) {
  const int64_t *first = a, *second = b;
  return (*first > *second) - (*first < *second);
}

ern_status ern_clip_trained_frames(ern_context *context, const ern_pose_list lists[2], size_t *trained) {
  const ern_pose_list *train = &lists[ERN_SPLIT_TRAIN], *val = &lists[ERN_SPLIT_VAL];
  int64_t *ids = NULL;
  const ern_status status = ERN_NEW(context, train->count, &ids);
  *trained = 0;
  if (status != ERN_OK) return status;
  for (size_t i = 0; i < train->count; i++) ids[i] = train->poses[i].img_id;
  qsort(ids, train->count, sizeof *ids, compare_numbers);
  for (size_t i = 0; i < val->count; i++)
    *trained += bsearch(&val->poses[i].img_id, ids, train->count, sizeof *ids, compare_numbers) != NULL;
  ern_release(context, ids);
  return ERN_OK;
}

ern_status ern_clip_features_name(ern_context *context, const char *folder, const char *asr_model, const char **name) {
  static const struct {
    const char *model; /* the public code recognises a model by a part of its name */
    enum ern_clip_content file;
  } kinds[] = {{"deepspeech", ERN_CLIP_DEEPSPEECH}, {"esperanto", ERN_CLIP_ESPERANTO},
               {"hubert", ERN_CLIP_HUBERT},         {NULL, ERN_CLIP_FEATURES},
               {"cepstra", ERN_CLIP_CEPSTRA},       {"articulatory", ERN_CLIP_ARTICULATORY},
               {"cepstra", ERN_CLIP_SOUND},         {"articulatory", ERN_CLIP_SOUND}};
  ern_status status = ERN_OK;
  bool known = asr_model == NULL;
  *name = NULL;
  for (size_t i = 0; i < sizeof kinds / sizeof kinds[0]; i++) {
    bool there = false;
    if (asr_model != NULL && (kinds[i].model == NULL || strstr(asr_model, kinds[i].model) == NULL)) continue;
    known = true;
    *name = ern_clip_content(kinds[i].file);
    ERN_TRY(ern_clip_has(context, folder, kinds[i].file, &there));
    if (there) return ERN_OK;
  }
  if (!known) {
    return ern_fail(context, ERN_E_ARGUMENT,
                    "asr_model is \"%s\", expected deepspeech, esperanto, hubert, articulatory or cepstra", asr_model);
  }
  if (asr_model != NULL) {
    return ern_fail(context, ERN_E_MISSING, "%s/%s: is missing, and asr_model \"%s\" needs it", folder, *name,
                    asr_model);
  }
  *name = NULL;
  return ern_fail(context, ERN_E_MISSING,
                  "%s: no speech features, expected one of aud_ds.npy, aud_eo.npy, aud_hu.npy, aud.npy, aud_cep.npy, "
                  "aud_art.npy, or the sound aud.wav to make them of",
                  folder);
fail:
  return status;
}

const char *ern_clip_features_kind(const char *name, const char *asr_model, const ern_features *features, bool sound) {
  static const struct {
    const char *name, *kind;
  } own[] = {{"aud_cep.npy", ERN_SPEECH_CEPSTRA}, {"aud_art.npy", ERN_SPEECH_ARTICULATORY}};
  if (sound)
    return asr_model != NULL && strstr(asr_model, "cepstra") != NULL ? ERN_SPEECH_CEPSTRA : ERN_SPEECH_ARTICULATORY;
  for (size_t i = 0; i < sizeof own / sizeof *own; i++) {
    const size_t length = strlen(name), tail = strlen(own[i].name);
    if (length >= tail && strcmp(name + length - tail, own[i].name) == 0 &&
        features->width == ern_speech_width(own[i].kind))
      return own[i].kind;
  }
  return ern_speech_kind(features);
}

ern_status ern_clip_blink(ern_context *context, const char *folder, int64_t largest_img_id, float **blink,
                          size_t *count) {
  ern_status status = ERN_OK;
  char *path = NULL;
  bool there = false;
  *blink = NULL;
  *count = 0;
  ERN_TRY(ern_clip_has(context, folder, ERN_CLIP_BLINKS, &there));
  if (!there) return ERN_OK;
  ERN_TRY(ern_clip_path(context, folder, ERN_CLIP_BLINKS, &path));
  ERN_TRY(ern_csv_read_column(context, path, "AU45_r", blink, count));
  if ((uint64_t)largest_img_id >= *count) {
    ERN_TRY(ern_fail(context, ERN_E_SHAPE,
                     "%s: column AU45_r has %zu rows, expected at least %" PRId64 ": the largest img_id is %" PRId64,
                     path, *count, largest_img_id + 1, largest_img_id));
  }
  ern_release(context, path);
  return ERN_OK;
fail:
  ern_release(context, path);
  ern_release(context, *blink);
  *blink = NULL;
  *count = 0;
  return status;
}

ern_status ern_clip_motion(ern_context *context, const char *folder, int64_t largest_img_id,
                           float (**motion)[ERN_MOTION_VALUES]) {
  enum { SIDE = ERN_MOTION_SIDE };
  static const float most = 1e3f;
  ern_status status = ERN_OK;
  char *path = NULL;
  struct ern_npy array = {0};
  bool there = false;
  *motion = NULL;
  ERN_TRY(ern_clip_has(context, folder, ERN_CLIP_MOTION, &there));
  if (!there) return ERN_OK;
  ERN_TRY(ern_clip_path(context, folder, ERN_CLIP_MOTION, &path));
  ERN_TRY(ern_npy_read(context, path, &array));
  if (array.type != ERN_NPY_F32 || array.dims != 4 || array.shape[1] != 2 || array.shape[2] != SIDE ||
      array.shape[3] != SIDE)
    ERN_TRY(ern_fail(context, ERN_E_SHAPE, "%s: expected float32 [frames][2][%d][%d]", path, SIDE, SIDE));
  if ((uint64_t)largest_img_id >= array.shape[0])
    ERN_TRY(ern_fail(context, ERN_E_SHAPE,
                     "%s: has %zu frames, expected at least %" PRId64 ": the largest img_id is %" PRId64, path,
                     array.shape[0], largest_img_id + 1, largest_img_id));
  const float *value = array.data;
  for (size_t i = 0; i < array.count; i++)
    if (!(fabsf(value[i]) <= most))
      ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: frame %zu, value %zu is %g, expected -1000 to 1000", path,
                       i / ERN_MOTION_VALUES, i % ERN_MOTION_VALUES, (double)value[i]));
  *motion = array.data;
  array.data = NULL;
fail:
  ern_release(context, path);
  ern_npy_free(context, &array);
  return status;
}
