/* SPDX-License-Identifier: MIT
 * The parts of a preprocessed clip, found and read one by one: shared by the code that opens a clip and the code that
 * checks one. */
#ifndef ERN_MEDIA_CLIP_H
#define ERN_MEDIA_CLIP_H

#include "core/status.h"
#include "ernerf/media.h"
#include "ernerf/speech.h"

/* What a clip is made of: every file and folder of it that is opened, by the index of ern_clip_content(). */
enum ern_clip_content {
  ERN_PART_TRUTH,
  ERN_PART_TORSO,
  ERN_PART_LANDMARKS,
  ERN_PART_PARSING,
  ERN_CLIP_TRAIN,
  ERN_CLIP_VAL,
  ERN_CLIP_BACKGROUND,
  ERN_CLIP_SOUND,
  ERN_CLIP_BLINKS,
  ERN_CLIP_RECORD, /* of `prepare` */
  ERN_CLIP_DEEPSPEECH,
  ERN_CLIP_ESPERANTO,
  ERN_CLIP_HUBERT,
  ERN_CLIP_FEATURES,
  ERN_CLIP_CEPSTRA,
  ERN_CLIP_ARTICULATORY,
  ERN_CLIP_MOTION
};
/* *path = that file or folder of the clip, owned by the caller (ern_release). */
ERN_NODISCARD ern_status ern_clip_path(ern_context *context, const char *folder, enum ern_clip_content content,
                                       char **path);
/* *there = whether it exists. */
ERN_NODISCARD ern_status ern_clip_has(ern_context *context, const char *folder, enum ern_clip_content content,
                                      bool *there);

/* The folders of frames: gt_imgs/ID.jpg (or .png, .jpeg), torso_imgs/ID.png, ori_imgs/ID.lms, parsing/ID.png. */
typedef enum ern_clip_content ern_clip_part;

/* *path = the frame's file, owned by the caller (ern_release); ERN_E_MISSING where there is none. */
ERN_NODISCARD ern_status ern_clip_part_path(ern_context *context, const char *folder, ern_clip_part part,
                                            int64_t img_id, char **path);

/* ERN_E_STATE where FOLDER/prepare.json says that a step of `prepare` is not done or was refused; ERN_OK where there is
 * no such file: another program made the clip. */
ERN_NODISCARD ern_status ern_clip_check_prepared(ern_context *context, const char *folder);

/* ERN_E_SHAPE where the picture's header does not say width x height. */
ERN_NODISCARD ern_status ern_clip_picture_check(ern_context *context, const char *path, int width, int height);

/* transforms_train.json. */
ERN_NODISCARD ern_status ern_clip_train_poses(ern_context *context, const char *folder, ern_pose_list *train);
/* transforms_val.json, whose camera must be the training's; an empty list where there is no such file. */
ERN_NODISCARD ern_status ern_clip_val_poses(ern_context *context, const char *folder, const ern_pose_list *train,
                                            ern_pose_list *val);
/* The largest img_id and aud_id of both lists. */
void ern_clip_largest_ids(const ern_pose_list lists[2], int64_t *img_id, int64_t *aud_id);
/* *trained: number of validation frames that are training frames too. */
ERN_NODISCARD ern_status ern_clip_trained_frames(ern_context *context, const ern_pose_list lists[2], size_t *trained);

/* *name = the clip's feature file for this model (NULL: the first that exists); the text of ERN_E_MISSING names the
 * files that were looked for. */
ERN_NODISCARD ern_status ern_clip_features_name(ern_context *context, const char *folder, const char *asr_model,
                                                const char **name);

/* The kind of features (speech.h); "": not known. `sound`: they are to be made of a sound, and `features` may be NULL.
 * Other programs write 13 values a row too, so a file holds a built-in kind by its name alone. */
const char *ern_clip_features_kind(const char *name, const char *asr_model, const ern_features *features, bool sound);

/* *blink = column AU45_r of au.csv, owned by the caller, with a row for every img_id up to the largest; NULL where
 * there is no au.csv. */
ERN_NODISCARD ern_status ern_clip_blink(ern_context *context, const char *folder, int64_t largest_img_id, float **blink,
                                        size_t *count);

/* ern_clip_measures.eye_low and .eye_high of values[count]; both 0 where count is 0. */
void ern_clip_eye_range(const float *values, size_t count, float *low, float *high);

/* *motion [rows][ERN_MOTION_VALUES], of torso.npy, owned by the caller, with a row for every img_id up to the largest;
 * NULL where there is no torso.npy. */
ERN_NODISCARD ern_status ern_clip_motion(ern_context *context, const char *folder, int64_t largest_img_id,
                                         float (**motion)[ERN_MOTION_VALUES]);

/* RMS deviation of the features from their mean over the windows, over their RMS. */
ERN_NODISCARD ern_status ern_clip_feature_change(ern_context *context, const ern_features *features, double *relative);

/* Whether a pixel of parsing/ID.png has AD-NeRF's colour of the head, 0 0 255. */
static inline bool ern_clip_is_head(const uint8_t *rgb) { return rgb[0] < 128 && rgb[1] < 128 && rgb[2] >= 128; }
/* Values of ern_clip_head(). */
enum { ERN_HEAD_UNSURE = 128, ERN_HEAD_WHOLE = 255 };
/* Replaces the RGB picture of parsing/ID.png by one channel of those values; the size stays. ERN_E_FORMAT, with `path`
 * in the text: another colour. */
ERN_NODISCARD ern_status ern_clip_head_of_parsing(ern_context *context, const char *path, ern_image *image);

/* How many frames have more than one picture in gt_imgs, of which the first of .jpg, .png, .jpeg is taken, and the
 * img_id of the first of them. */
ERN_NODISCARD ern_status ern_clip_doubled_pictures(ern_context *context, const char *folder,
                                                   const ern_pose_list lists[2], size_t *doubled, int64_t *img_id);

/* Calls `say` for each thing that is well formed and still looks wrong: landmarks that are no face, masks that are all
 * person or have no head, a sound that is no speech. Looks at no more than 48 training frames. A file that is missing
 * or cannot be read is no doubt: what opens a clip reports it. ERN_E_NO_MEMORY alone. */
ERN_NODISCARD ern_status ern_clip_doubts(ern_context *context, const char *folder, const ern_pose_list *train,
                                         void (*say)(void *user, const char *sentence), void *user);

/* ern_dataset.fingerprint, of when the clip was opened. */
const char *ern_clip_fingerprint(const ern_clip *clip);

/* The context that a clip was opened with, and its sound (ERN_E_MISSING where there is none; the caller calls
 * ern_sound_free). */
ern_context *ern_clip_context(const ern_clip *clip);
ERN_NODISCARD ern_status ern_clip_sound(const ern_clip *clip, ern_sound *sound);

#endif
