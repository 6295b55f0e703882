/* SPDX-License-Identifier: MIT
 * A preprocessed clip: all its files are checked when it is opened, its pixels are read on demand. */
#include "media/clip/clip.h"

#include <inttypes.h>
#include <pthread.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include "core/floats.h"
#include "core/machine.h"
#include "core/memory.h"
#include "core/sized.h"
#include "io/file.h"
#include "io/landmarks.h"
#include "media/image.h"

enum { TRANSFORMS_LIMIT = 1 << 26, BACKGROUND_LIMIT = 1 << 28 };

/* A cache for one kind of picture: those kept in memory, by split and frame, and the last one read that did not fit. */
struct pictures {
  ern_clip_part part;
  int channels;      /* in memory; parsing files have 3 */
  uint8_t **kept[2]; /* [split][frame], NULL: not in memory */
  uint64_t *ends[2]; /* [split][frame], hash of the file's first and last bytes when the clip was opened */
  ern_image last;
};

struct ern_clip {
  ern_context *context;
  char *folder, *features_file;
  ern_clip_info info;
  ern_features features;
  ern_features *copies; /* [copy_count] of ern_clip_vary_speech */
  size_t copy_count;
  char *speech_path;                  /* the file of the features, or the sound that a network computes them from */
  char *speech_kind, *speech_network; /* of the network that computed the features; NULL: none */
  ern_image background;
  ern_clip_frame *frames[2]; /* by ern_split */
  struct pictures truth, torso, head;
  uint64_t hash;      /* of sizes of pictures, of landmarks and eye values */
  uint64_t ends_hash; /* of the first and last bytes of pictures */
  char fingerprint[33];
  uint64_t budget, used; /* bytes of kept pictures */
  pthread_mutex_t mutex; /* guards `used` and torso.kept among calls of ern_clip_torso */
};

static uint64_t half_of_memory(void) {
  const uint64_t memory = ern_machine_memory();
  return memory > 0 ? memory / 2 : (uint64_t)1 << 31;
}

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static ern_status check_folder(ern_context *context, const char *folder) {
  struct stat about;
  if (stat(folder, &about) != 0) {
    return ern_fail(context, ERN_E_MISSING, "%s: is missing, expected the folder of a preprocessed clip", folder);
  }
  if (S_ISDIR(about.st_mode)) return ERN_OK;
  return ern_fail(context, ERN_E_IO, "%s: is no folder, expected that of a preprocessed clip", folder);
}

/* Computes the features of clip->speech_path by a network. */
static ern_status compute_features(ern_clip *clip, ern_speech_network *network) {
  ern_status status = ERN_OK;
  ERN_TRY(ern_string_copy(clip->context, ern_speech_network_kind(network), &clip->speech_kind));
  ERN_TRY(ern_string_copy(clip->context, ern_speech_network_description(network), &clip->speech_network));
  ERN_TRY(ern_speech_network_features(network, clip->speech_path, &clip->features));
  clip->info.hears_sound = true;
  clip->info.speech = clip->speech_kind;
  clip->info.speech_network = clip->speech_network;
fail:
  return status;
}

static ern_status open_features(ern_clip *clip, const ern_clip_options *options) {
  ern_status status = ERN_OK;
  const char *name = options->features;
  clip->info.speech_network = "";
  if (name != NULL) {
    ERN_TRY(ern_string_copy(clip->context, name, &clip->speech_path));
  } else {
    if (options->network != NULL)
      name = ern_clip_content(ERN_CLIP_SOUND);
    else
      ERN_TRY(ern_clip_features_name(clip->context, clip->folder, options->asr_model, &name));
    ERN_TRY(ern_path_join(clip->context, clip->folder, name, &clip->speech_path));
  }
  ERN_TRY(ern_string_copy(clip->context, name, &clip->features_file));
  if (options->network != NULL) return compute_features(clip, options->network);
  clip->info.hears_sound = ern_speech_is_sound(clip->speech_path);
  const char *kind = clip->info.hears_sound ? ern_clip_features_kind(name, options->asr_model, NULL, true) : NULL;
  ERN_TRY(ern_speech_open(clip->context, clip->speech_path, kind, &clip->features));
  clip->info.speech = kind != NULL ? kind : ern_clip_features_kind(name, NULL, &clip->features, false);
fail:
  return status;
}

static void forget_copies(ern_clip *clip) {
  for (size_t k = 0; k < clip->copy_count; k++) ern_features_free(clip->context, &clip->copies[k]);
  ern_release(clip->context, clip->copies);
  clip->copies = NULL;
  clip->copy_count = 0;
}

/* The clip's identity: a SHA-256 of the bytes of transforms_train.json, then bc.jpg. */
static ern_status identity_of(ern_clip *clip, char identity[65]) {
  ern_status status = ERN_OK;
  ern_context *context = clip->context;
  char *transforms_path = NULL, *path = NULL;
  uint8_t *transforms = NULL, *picture = NULL;
  size_t transforms_bytes = 0, picture_bytes = 0;
  uint8_t *both = NULL;
  ERN_TRY(ern_clip_path(context, clip->folder, ERN_CLIP_TRAIN, &transforms_path));
  ERN_TRY(ern_clip_path(context, clip->folder, ERN_CLIP_BACKGROUND, &path));
  ERN_TRY(ern_file_read(context, transforms_path, TRANSFORMS_LIMIT, &transforms, &transforms_bytes));
  ERN_TRY(ern_file_read(context, path, BACKGROUND_LIMIT, &picture, &picture_bytes));
  ERN_TRY(ERN_NEW(context, transforms_bytes + picture_bytes, &both));
  memcpy(both, transforms, transforms_bytes);
  memcpy(both + transforms_bytes, picture, picture_bytes);
  ern_sha256_hex(both, transforms_bytes + picture_bytes, identity);
fail:
  ern_release(context, transforms_path);
  ern_release(context, path);
  ern_release(context, transforms);
  ern_release(context, picture);
  ern_release(context, both);
  return status;
}

/* Checks that the identity is still `before`: that the files have not changed since, while they were parsed. */
static ern_status verify_identity(ern_clip *clip, const char *before) {
  const ern_status status = identity_of(clip, clip->info.identity);
  if (status != ERN_OK || strcmp(before, clip->info.identity) == 0) return status;
  return ern_fail(clip->context, ERN_E_FORMAT, "%s/: transforms_train.json or bc.jpg changed while they were read",
                  clip->folder);
}

/* Reads the background picture and scales it to the clip's size. */
static ern_status open_background(ern_clip *clip) {
  ern_status status = ERN_OK;
  ern_context *context = clip->context;
  ern_image read = {0};
  char *path = NULL;
  ERN_TRY(ern_clip_path(context, clip->folder, ERN_CLIP_BACKGROUND, &path));
  ERN_TRY(ern_image_read(context, path, 3, &read));
  if (read.width == clip->info.width && read.height == clip->info.height) {
    clip->background = read;
    read = (ern_image){0};
  } else {
    ern_log(context, ERN_LOG_INFO, "%s: size is %d x %d, scaled to %d x %d", path, read.width, read.height,
            clip->info.width, clip->info.height);
    ERN_TRY(ern_image_resize(context, &read, clip->info.width, clip->info.height, &clip->background));
  }
fail:
  ern_image_free(context, &read);
  ern_release(context, path);
  return status;
}

static const uint64_t fold_begin = 0xcbf29ce484222325;
/* Continues a hash of the clip's fingerprint (FNV-1a) with bytes that belong to a frame. */
static void fold(uint64_t *hash, const void *bytes, size_t count) {
  const unsigned char *at = bytes;
  for (size_t i = 0; i < count; i++) *hash = (*hash ^ at[i]) * 0x100000001b3;
}

/* Folds a picture's size into one hash, its first bytes and its last ones into another: the end of a PNG has a checksum
 * of all its pixels, and that of a JPEG lies at other bits where anything before it is of another length. *own: a hash
 * of these bytes alone. */
static ern_status fold_picture(ern_context *context, const char *path, uint64_t *sizes, uint64_t *ends, uint64_t *own) {
  unsigned char end[4096];
  struct ern_file_reader reader;
  ern_status status = ern_file_reader_open(context, path, SIZE_MAX, &reader);
  if (status != ERN_OK) return status;
  const size_t count = reader.size < sizeof end ? reader.size : sizeof end;
  *own = fold_begin;
  fold(sizes, &reader.size, sizeof reader.size);
  for (int k = 0; k < 2; k++) {
    ERN_TRY(ern_file_reader_take(&reader, k == 0 ? 0 : reader.size - count, end, count));
    fold(ends, end, count);
    fold(own, end, count);
  }
fail:
  ern_file_reader_close(&reader);
  return status;
}

static ern_status check_picture(ern_clip *clip, struct pictures *pictures, ern_split split, size_t index) {
  ern_status status = ERN_OK;
  char *path = NULL;
  const int64_t img_id = clip->frames[split][index].pose.img_id;
  ERN_TRY(ern_clip_part_path(clip->context, clip->folder, pictures->part, img_id, &path));
  ERN_TRY(ern_clip_picture_check(clip->context, path, clip->info.width, clip->info.height));
  ERN_TRY(fold_picture(clip->context, path, &clip->hash, &clip->ends_hash, &pictures->ends[split][index]));
fail:
  ern_release(clip->context, path);
  return status;
}

/* Reads a frame's data without its pixels. It reads the headers of the pictures, so that a bad file is reported now and
 * not hours later. */
static ern_status open_frame(ern_clip *clip, ern_split split, size_t index, const float *blink,
                             const float (*motion)[ERN_MOTION_VALUES]) {
  ern_status status = ERN_OK;
  ern_clip_frame *frame = &clip->frames[split][index];
  char *path = NULL;
  if (blink != NULL) {
    const float raw = blink[frame->pose.img_id];
    frame->eye = (raw < 0 ? 0.0f : raw > 2 ? 2.0f : raw) / 2; /* clamp(AU45_r, 0, 2)/2 */
  }
  fold(&clip->hash, &frame->eye, sizeof frame->eye);
  if (motion != NULL) {
    memcpy(frame->torso_motion, motion[frame->pose.img_id], sizeof frame->torso_motion);
    fold(&clip->hash, frame->torso_motion, sizeof frame->torso_motion);
  }
  ERN_TRY(check_picture(clip, &clip->truth, split, index));
  if (clip->info.has_torso) ERN_TRY(check_picture(clip, &clip->torso, split, index));
  if (clip->info.has_parsing) ERN_TRY(check_picture(clip, &clip->head, split, index));
  if (clip->info.has_landmarks) {
    ERN_TRY(ern_clip_part_path(clip->context, clip->folder, ERN_PART_LANDMARKS, frame->pose.img_id, &path));
    ERN_TRY(ern_landmarks_read(clip->context, path, frame->landmarks));
    frame->has_landmarks = true;
    fold(&clip->hash, frame->landmarks, sizeof frame->landmarks);
  }
fail:
  ern_release(clip->context, path);
  return status;
}

static ern_status open_split(ern_clip *clip, ern_split split, const ern_pose_list *list, const float *blink,
                             const float (*motion)[ERN_MOTION_VALUES]) {
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(clip->context, list->count, &clip->frames[split]));
  struct pictures *const kinds[] = {&clip->truth, &clip->torso, &clip->head};
  for (size_t k = 0; k < sizeof kinds / sizeof *kinds; k++) {
    ERN_TRY(ERN_NEW(clip->context, list->count, &kinds[k]->kept[split]));
    ERN_TRY(ERN_NEW(clip->context, list->count, &kinds[k]->ends[split]));
  }
  clip->info.frames[split] = list->count;
  const int64_t windows = (int64_t)clip->features.windows;
  for (size_t i = 0; i < list->count; i++) {
    clip->frames[split][i].pose = list->poses[i];
    ERN_TRY(open_frame(clip, split, i, blink, motion));
    if (list->poses[i].aud_id >= windows) clip->frames[split][i].pose.aud_id = windows - 1;
  }
fail:
  return status;
}

/* Finds the clip's optional files. */
static ern_status find_optional(ern_clip *clip) {
  ern_status status = ERN_OK;
  ERN_TRY(ern_clip_has(clip->context, clip->folder, ERN_PART_TORSO, &clip->info.has_torso));
  ERN_TRY(ern_clip_has(clip->context, clip->folder, ERN_PART_LANDMARKS, &clip->info.has_landmarks));
  ERN_TRY(ern_clip_has(clip->context, clip->folder, ERN_PART_PARSING, &clip->info.has_parsing));
  ERN_TRY(ern_clip_has(clip->context, clip->folder, ERN_CLIP_SOUND, &clip->info.has_sound));
fail:
  return status;
}

static void warn_of_doubt(void *user, const char *sentence) {
  const ern_clip *clip = user;
  ern_log(clip->context, ERN_LOG_WARNING, "%s/%s", clip->folder, sentence);
}

/* Warns of what is odd about the lists, though it is no error. */
static ern_status warn_of_lists(const ern_clip *clip, const ern_pose_list lists[2]) {
  ern_status status = ERN_OK;
  ern_context *context = clip->context;
  size_t trained = 0, doubled = 0;
  int64_t img_id = 0;
  if (lists[ERN_SPLIT_VAL].count == 0)
    ern_log(context, ERN_LOG_WARNING, "%s/transforms_val.json: is missing, no frames to validate on", clip->folder);
  ERN_TRY(ern_clip_trained_frames(context, lists, &trained));
  if (trained > 0)
    ern_log(
        context, ERN_LOG_WARNING,
        "%s/transforms_val.json: %zu of its %zu frames are in transforms_train.json too: figures of a validation are "
        "not of unseen frames",
        clip->folder, trained, lists[ERN_SPLIT_VAL].count);
  ERN_TRY(ern_clip_doubled_pictures(context, clip->folder, lists, &doubled, &img_id));
  if (doubled > 0)
    ern_log(context, ERN_LOG_WARNING,
            "%s/gt_imgs: %zu frames have several pictures, the first is img_id %" PRId64
            "; of .jpg, .png, .jpeg the first that is there is taken",
            clip->folder, doubled, img_id);
fail:
  return status;
}

static ern_status open_parts(ern_clip *clip, const ern_clip_options *options) {
  ern_status status = ERN_OK;
  ern_context *context = clip->context;
  ern_pose_list lists[2] = {0};
  float *blink = NULL, (*motion)[ERN_MOTION_VALUES] = NULL;
  size_t blink_count = 0;
  int64_t img_id = 0, aud_id = 0;
  char identity[65] = "";
  ERN_TRY(identity_of(clip, identity));
  ERN_TRY(ern_clip_train_poses(context, clip->folder, &lists[ERN_SPLIT_TRAIN]));
  ERN_TRY(ern_clip_val_poses(context, clip->folder, &lists[ERN_SPLIT_TRAIN], &lists[ERN_SPLIT_VAL]));
  ERN_TRY(warn_of_lists(clip, lists));
  const ern_pose_list *train = &lists[ERN_SPLIT_TRAIN];
  clip->info.width = train->width;
  clip->info.height = train->height;
  clip->info.focal = train->focal;
  clip->info.cx = train->cx;
  clip->info.cy = train->cy;
  ern_clip_largest_ids(lists, &img_id, &aud_id);
  ERN_TRY(open_features(clip, options));
  if ((uint64_t)aud_id >= clip->features.windows) {
    ern_log(context, ERN_LOG_WARNING,
            "%s: has %zu windows, the largest aud_id is %" PRId64 ": the last one is repeated", clip->features_file,
            clip->features.windows, aud_id);
  }
  ERN_TRY(open_background(clip));
  ERN_TRY(verify_identity(clip, identity));
  ERN_TRY(ern_clip_blink(context, clip->folder, img_id, &blink, &blink_count));
  clip->info.has_blink = blink != NULL;
  ERN_TRY(ern_clip_motion(context, clip->folder, img_id, &motion));
  clip->info.has_torso_motion = motion != NULL;
  ERN_TRY(find_optional(clip));
  ERN_TRY(ern_clip_doubts(context, clip->folder, train, warn_of_doubt, clip));
  clip->hash = clip->ends_hash = fold_begin;
  ERN_TRY(open_split(clip, ERN_SPLIT_TRAIN, &lists[ERN_SPLIT_TRAIN], blink, (const float(*)[ERN_MOTION_VALUES])motion));
  ERN_TRY(open_split(clip, ERN_SPLIT_VAL, &lists[ERN_SPLIT_VAL], blink, (const float(*)[ERN_MOTION_VALUES])motion));
  snprintf(clip->fingerprint, sizeof clip->fingerprint, "%016" PRIx64 "%016" PRIx64, clip->hash, clip->ends_hash);
fail:
  ern_release(context, blink);
  ern_release(context, motion);
  ern_pose_list_free(context, &lists[ERN_SPLIT_TRAIN]);
  ern_pose_list_free(context, &lists[ERN_SPLIT_VAL]);
  return status;
}

ern_status ern_clip_open(ern_context *context, const char *folder, const ern_clip_options *options, ern_clip **clip) {
  ERN_PLAIN_FLOATS;
  if (clip != NULL) *clip = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, folder);
  ERN_NEED(context, clip);
  ern_clip_options chosen = ern_clip_options_default();
  ern_status status = ERN_OK;
  ern_clip *made = NULL;
  if (options != NULL) ERN_TRY(ERN_COPY_IN_CONFIG(context, ern_clip_options, &chosen, options));
  ERN_TRY(check_folder(context, folder));
  ERN_TRY(ern_clip_check_prepared(context, folder));
  ERN_TRY(ERN_NEW(context, 1, &made));
  pthread_mutex_init(&made->mutex, NULL); /* does not fail on Linux */
  made->context = context;
  made->budget = chosen.memory_bytes != 0 ? chosen.memory_bytes : half_of_memory();
  made->truth = (struct pictures){.part = ERN_PART_TRUTH, .channels = 3};
  made->torso = (struct pictures){.part = ERN_PART_TORSO, .channels = 4};
  made->head = (struct pictures){.part = ERN_PART_PARSING, .channels = 1};
  ERN_TRY(ern_string_copy(context, folder, &made->folder));
  ERN_TRY(open_parts(made, &chosen));
  made->info.features_file = made->features_file;
  *clip = made;
  return ERN_OK;
fail:
  ern_clip_free(&made);
  return status;
}

static void free_pictures(ern_clip *clip, struct pictures *pictures) {
  for (int split = 0; split < 2; split++) {
    for (size_t i = 0; pictures->kept[split] != NULL && i < clip->info.frames[split]; i++) {
      ern_release(clip->context, pictures->kept[split][i]);
    }
    ern_release(clip->context, pictures->kept[split]);
    ern_release(clip->context, pictures->ends[split]);
  }
  ern_image_free(clip->context, &pictures->last);
}

void ern_clip_free(ern_clip **clip) {
  if (clip == NULL || *clip == NULL) return;
  ern_clip *dying = *clip;
  *clip = NULL;
  free_pictures(dying, &dying->truth);
  free_pictures(dying, &dying->torso);
  free_pictures(dying, &dying->head);
  ern_image_free(dying->context, &dying->background);
  forget_copies(dying);
  ern_release(dying->context, dying->speech_path);
  ern_release(dying->context, dying->speech_kind);
  ern_release(dying->context, dying->speech_network);
  ern_features_free(dying->context, &dying->features);
  ern_release(dying->context, dying->frames[ERN_SPLIT_TRAIN]);
  ern_release(dying->context, dying->frames[ERN_SPLIT_VAL]);
  ern_release(dying->context, dying->features_file);
  ern_release(dying->context, dying->folder);
  pthread_mutex_destroy(&dying->mutex);
  ern_release(dying->context, dying);
}

/* ---- looking ----------------------------------------------------------------------------------------------------- */

void ern_clip_describe_sized(const ern_clip *clip, ern_clip_info *info, size_t bytes) {
  const ern_clip_info none = {0};
  ern_struct_copy_out(info, bytes, clip != NULL ? &clip->info : &none, sizeof none);
}

const char *ern_clip_identity(const ern_clip *clip) { return clip != NULL ? clip->info.identity : NULL; }

const char *ern_clip_fingerprint(const ern_clip *clip) { return clip->fingerprint; }

ern_context *ern_clip_context(const ern_clip *clip) { return clip->context; }

ern_status ern_clip_sound(const ern_clip *clip, ern_sound *sound) {
  char *path = NULL;
  ern_status status = ern_clip_path(clip->context, clip->folder, ERN_CLIP_SOUND, &path);
  if (status == ERN_OK) status = ern_sound_read(clip->context, path, sound);
  ern_release(clip->context, path);
  return status;
}

ern_status ern_clip_vary_speech(ern_clip *clip, const float *warps, size_t count) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, clip);
  if (count > 0) ERN_NEED(clip->context, warps);
  ern_status status = ERN_OK;
  forget_copies(clip);
  if (count == 0) return ERN_OK;
  if (!clip->info.hears_sound)
    return ern_fail(clip->context, ERN_E_STATE,
                    "%s: holds features, expected a sound, the only thing that copies of "
                    "the speech can be made from",
                    clip->speech_path);
  if (clip->speech_network != NULL)
    return ern_fail(clip->context, ERN_E_STATE,
                    "%s: its features are computed by a network, and copies of the "
                    "speech can only be of a built-in kind",
                    clip->speech_path);
  ERN_TRY(ERN_NEW(clip->context, count, &clip->copies));
  for (; clip->copy_count < count; clip->copy_count++)
    ERN_TRY(ern_speech_features_kind(clip->context, clip->speech_path, clip->info.speech, warps[clip->copy_count],
                                     &clip->copies[clip->copy_count]));
  return ERN_OK;
fail:
  forget_copies(clip);
  return status;
}

const ern_features *ern_clip_speech_copies(const ern_clip *clip, size_t *count) {
  if (count != NULL) *count = clip != NULL ? clip->copy_count : 0;
  return clip != NULL ? clip->copies : NULL;
}

const ern_features *ern_clip_features(const ern_clip *clip) { return clip != NULL ? &clip->features : NULL; }

const ern_image *ern_clip_background(const ern_clip *clip) { return clip != NULL ? &clip->background : NULL; }

static bool has_frame(const ern_clip *clip, ern_split split, size_t index) {
  return clip != NULL && (split == ERN_SPLIT_TRAIN || split == ERN_SPLIT_VAL) && index < clip->info.frames[split];
}

const ern_clip_frame *ern_clip_frame_at(const ern_clip *clip, ern_split split, size_t index) {
  return has_frame(clip, split, index) ? &clip->frames[split][index] : NULL;
}

/* *image = one picture of a frame, read from its file, which is still that of when the clip was opened: poses and
 * landmarks belong to it. */
static ern_status read_picture(const ern_clip *clip, const struct pictures *pictures, ern_split split, size_t index,
                               ern_image *image) {
  ern_status status = ERN_OK;
  uint64_t ends = 0, unused[2] = {0};
  ern_context *context = clip->context;
  char *path = NULL;
  const int width = clip->info.width, height = clip->info.height;
  ERN_TRY(ern_clip_part_path(context, clip->folder, pictures->part, clip->frames[split][index].pose.img_id, &path));
  ERN_TRY(ern_image_read(context, path, pictures->part == ERN_PART_PARSING ? 3 : pictures->channels, image));
  if (image->width != width || image->height != height)
    ERN_TRY(ern_fail(context, ERN_E_SHAPE,
                     "%s: size is %d x %d, expected %d x %d: it changed since the clip was opened", path, image->width,
                     image->height, width, height));
  ERN_TRY(fold_picture(context, path, &unused[0], &unused[1], &ends)); /* after it was read, as it may change then */
  if (ends != pictures->ends[split][index])
    ERN_TRY(
        ern_fail(context, ERN_E_STATE, "%s: was replaced since the clip was opened, expected the same picture", path));
  if (pictures->part == ERN_PART_PARSING) ERN_TRY(ern_clip_head_of_parsing(context, path, image));
fail:
  if (status != ERN_OK) ern_image_free(context, image);
  ern_release(context, path);
  return status;
}

static uint64_t picture_bytes(const ern_clip *clip, const struct pictures *pictures) {
  return (uint64_t)clip->info.width * (uint64_t)clip->info.height * (uint64_t)pictures->channels;
}

/* Keeps the picture in memory and empties *image, where the budget allows it and the frame has none there yet. */
static void keep_picture(ern_clip *clip, const struct pictures *pictures, uint8_t **kept, ern_image *image) {
  const uint64_t bytes = picture_bytes(clip, pictures);
  if (*kept != NULL || clip->budget - clip->used < bytes) return;
  *kept = image->data;
  *image = (ern_image){0};
  clip->used += bytes;
}

/* Returns one picture of a frame, from the cache or from its file. The first pictures read stay in the cache while they
 * fit the budget. Training samples frames uniformly, so it does not matter which ones stay. */
static ern_status get_picture(ern_clip *clip, struct pictures *pictures, ern_split split, size_t index,
                              ern_image *image) {
  ern_status status = ERN_OK;
  uint8_t **kept = &pictures->kept[split][index];
  if (*kept == NULL) {
    ern_image_free(clip->context, &pictures->last);
    ERN_TRY(read_picture(clip, pictures, split, index, &pictures->last));
    keep_picture(clip, pictures, kept, &pictures->last);
  }
  *image = (ern_image){.width = clip->info.width, .height = clip->info.height, .channels = pictures->channels};
  image->data = *kept != NULL ? *kept : pictures->last.data;
fail:
  return status;
}

static ern_status check_frame(const ern_clip *clip, ern_split split, size_t index) {
  if (has_frame(clip, split, index)) return ERN_OK;
  return ern_fail(clip->context, ERN_E_ARGUMENT, "%s: frame %zu of split %d was asked for, it has %zu", clip->folder,
                  index, (int)split, split == ERN_SPLIT_TRAIN || split == ERN_SPLIT_VAL ? clip->info.frames[split] : 0);
}

ern_status ern_clip_pixels(ern_clip *clip, ern_split split, size_t index, ern_image *truth, ern_image *torso) {
  ERN_PLAIN_FLOATS;
  ern_status status = ERN_OK;
  if (truth != NULL) *truth = (ern_image){0};
  if (torso != NULL) *torso = (ern_image){0};
  ERN_NEED(NULL, clip);
  ERN_TRY(check_frame(clip, split, index));
  if (truth != NULL) ERN_TRY(get_picture(clip, &clip->truth, split, index, truth));
  if (torso != NULL && clip->info.has_torso) ERN_TRY(get_picture(clip, &clip->torso, split, index, torso));
fail:
  return status;
}

static ern_status copy_picture(const ern_clip *clip, const struct pictures *pictures, const uint8_t *from,
                               ern_image *copy) {
  const ern_status status =
      ern_image_make(clip->context, clip->folder, clip->info.width, clip->info.height, pictures->channels, copy);
  if (status == ERN_OK) memcpy(copy->data, from, (size_t)picture_bytes(clip, pictures));
  return status;
}

ern_status ern_clip_torso(ern_clip *clip, ern_split split, size_t index, ern_image *torso) {
  ERN_PLAIN_FLOATS;
  ern_status status = ERN_OK;
  ern_image copy = {0};
  if (torso != NULL) *torso = (ern_image){0};
  ERN_NEED(NULL, clip);
  ERN_NEED(clip->context, torso);
  ERN_TRY(check_frame(clip, split, index));
  if (!clip->info.has_torso) return ERN_OK;
  struct pictures *pictures = &clip->torso;
  uint8_t **kept = &pictures->kept[split][index];
  pthread_mutex_lock(&clip->mutex);
  const uint8_t *there = *kept; /* stays as long as the clip */
  const bool fits = clip->budget - clip->used >= picture_bytes(clip, pictures);
  pthread_mutex_unlock(&clip->mutex);
  if (there != NULL) return copy_picture(clip, pictures, there, torso);
  ERN_TRY(read_picture(clip, pictures, split, index, torso));
  if (!fits) return ERN_OK;
  ERN_TRY(copy_picture(clip, pictures, torso->data, &copy));
  pthread_mutex_lock(&clip->mutex);
  keep_picture(clip, pictures, kept, &copy);
  pthread_mutex_unlock(&clip->mutex);
  ern_image_free(clip->context, &copy);
  return ERN_OK;
fail:
  ern_image_free(clip->context, torso);
  return status;
}

ern_status ern_clip_head(ern_clip *clip, ern_split split, size_t index, ern_image *head) {
  ERN_PLAIN_FLOATS;
  ern_status status = ERN_OK;
  if (head != NULL) *head = (ern_image){0};
  ERN_NEED(NULL, clip);
  ERN_NEED(clip->context, head);
  ERN_TRY(check_frame(clip, split, index));
  if (clip->info.has_parsing) ERN_TRY(get_picture(clip, &clip->head, split, index, head));
fail:
  return status;
}
