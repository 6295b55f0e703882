/* SPDX-License-Identifier: MIT
 * A clip as the data set of the trainer. */
#include <math.h>
#include <string.h>

#include "core/sized.h"
#include "ernerf/media.h"
#include "ernerf/speech.h"
#include "media/clip/clip.h"

/* The bounding box of landmarks [begin, end). */
static ern_box box_of(const float (*landmarks)[2], int begin, int end) {
  float low[2] = {landmarks[begin][0], landmarks[begin][1]}, high[2] = {low[0], low[1]};
  for (int p = begin + 1; p < end; p++)
    for (int axis = 0; axis < 2; axis++) {
      const float value = landmarks[p][axis];
      if (value < low[axis]) low[axis] = value;
      if (value > high[axis]) high[axis] = value;
    }
  return (ern_box){.top = (int)low[1], .bottom = (int)high[1], .left = (int)low[0], .right = (int)high[0]};
}

/* The jaw below the ears up to the bridge of the nose, as in the mask of ern_dub_frame, and a margin for its soft edge.
 */
static ern_box dubbed_of(const float (*landmarks)[2]) {
  const float width = hypotf(landmarks[16][0] - landmarks[0][0], landmarks[16][1] - landmarks[0][1]);
  const int margin = (int)(0.08F * fminf(width, ERN_IMAGE_MAX_SIDE));
  ern_box box = box_of(landmarks, 2, 15);
  if ((int)landmarks[29][1] < box.top) box.top = (int)landmarks[29][1];
  return (ern_box){
      .top = box.top - margin, .bottom = box.bottom + margin, .left = box.left - margin, .right = box.right + margin};
}

static ern_status frame(void *user, int split, size_t index, ern_dataset_frame *out) {
  const ern_clip_frame *from = ern_clip_frame_at(user, (ern_split)split, index);
  *out = (ern_dataset_frame){.aud_id = from->pose.aud_id, .eye = from->eye, .has_face = from->has_landmarks};
  memcpy(out->matrix, from->pose.matrix, sizeof out->matrix);
  memcpy(out->torso_motion, from->torso_motion, sizeof out->torso_motion);
  if (!from->has_landmarks) return ERN_OK;
  out->face = box_of(from->landmarks, 0, 68);
  out->lower_face = box_of(from->landmarks, 2, 15);  /* the jaw below the ears */
  out->lower_face.top = (int)from->landmarks[33][1]; /* the base of the nose */
  out->dubbed = dubbed_of(from->landmarks);
  out->lips = box_of(from->landmarks, 48, 68);
  out->eyes = box_of(from->landmarks, 36, 48);
  const int lids = (out->eyes.right - out->eyes.left) / 8; /* above and below: an eye is a third of the box wide */
  out->eyes.top -= lids;
  out->eyes.bottom += lids;
  return ERN_OK;
}

static ern_status pixels(void *user, int split, size_t index, const uint8_t **truth, const uint8_t **torso) {
  ern_image truth_image = {0}, torso_image = {0};
  const ern_status status = ern_clip_pixels(user, (ern_split)split, index, &truth_image, &torso_image);
  *truth = truth_image.data;
  *torso = torso_image.data;
  return status;
}

static ern_status head(void *user, int split, size_t index, const uint8_t **head) {
  ern_image image = {0};
  const ern_status status = ern_clip_head(user, (ern_split)split, index, &image);
  *head = image.data;
  return status;
}

static ern_dataset dataset_of(ern_clip *clip) {
  ern_clip_info info;
  ern_clip_describe(clip, &info);
  ern_dataset dataset = (ern_dataset){.user = clip,
                                      .frames = {info.frames[0], info.frames[1]},
                                      .focal = info.focal,
                                      .cx = info.cx,
                                      .cy = info.cy,
                                      .width = info.width,
                                      .height = info.height,
                                      .scale = 4,
                                      .has_eye = info.has_blink,
                                      .has_torso = info.has_torso,
                                      .features = ern_clip_features(clip),
                                      .background = ern_clip_background(clip)->data,
                                      .identity = ern_clip_identity(clip),
                                      .frame = frame,
                                      .pixels = pixels,
                                      .speech = info.speech,
                                      .speech_network = info.speech_network,
                                      .fingerprint = ern_clip_fingerprint(clip),
                                      .has_torso_motion = info.has_torso_motion};
  if (info.has_parsing) dataset.head = head;
  dataset.copies = ern_clip_speech_copies(clip, &dataset.copy_count);
  dataset.copy_share = dataset.copy_count > 0 ? 0.5f : 0;
  return dataset;
}

void ern_clip_dataset_sized(ern_clip *clip, ern_dataset *dataset, size_t bytes) {
  const ern_dataset own = clip != NULL ? dataset_of(clip) : (ern_dataset){0};
  ern_struct_copy_out(dataset, bytes, &own, sizeof own);
}
