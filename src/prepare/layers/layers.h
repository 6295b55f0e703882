/* SPDX-License-Identifier: MIT
 * Shared by the files of the step "layers". The mask of the person is computed on pictures of `work` pixels a side
 * (about half of the clip's side) and then upsampled to the clip's side. */
#ifndef ERN_PREPARE_LAYERS_H
#define ERN_PREPARE_LAYERS_H

#include "prepare/prepare_job.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { ERN_LAYER_POINTS = 68, ERN_LAYER_OUTLINE = 24 };
enum ern_layer_part { ERN_PART_BACKGROUND = 0, ERN_PART_HEAD = 1, ERN_PART_NECK = 2, ERN_PART_TORSO = 3 };

/* Where the head is in a frame, pixels of the clip. */
struct ern_layer_face {
  float points[ERN_LAYER_POINTS][2];   /* landmarks, smoothed in time */
  float outline[ERN_LAYER_OUTLINE][2]; /* of the projected head, an ellipsoid without hair and ears */
  float centre[2];                     /* of the outline */
  struct ern_head_pose pose;
  double focal, middle; /* pixels: of the camera, and half of a side */
};

/* faces[job->frames] of ori_imgs/ID.lms and the poses. */
ERN_NODISCARD ern_status ern_layer_faces_read(struct ern_prepare_job *job, struct ern_layer_face *faces);

/* moved = the position of the point at `pixel`, on or beside the head, after the head has moved from `from` to `to`. */
void ern_layer_head_moved(const struct ern_layer_face *from, const struct ern_layer_face *to, const double pixel[2],
                          double moved[2]);

/* A model of the person and the background. It learns from sample frames of the whole clip; then it segments each
 * frame, in order. Pictures are RGB of side x side, masks a byte a pixel. */
struct ern_person_model;
/* The side `work` of the small masks. */
int ern_person_work(int side);
ERN_NODISCARD ern_status ern_person_model_make(ern_context *context, int side, struct ern_person_model **model);
void ern_person_model_free(struct ern_person_model *model); /* accepts NULL */
/* Adds a frame as an example. supplied: a mask of the person, [side][side], 0..255; NULL: the model estimates one. */
ERN_NODISCARD ern_status ern_person_model_add(struct ern_person_model *model, const uint8_t *rgb,
                                              const struct ern_layer_face *face, const uint8_t *supplied);

/* Results of learning. */
struct ern_person_found {
  double never_seen; /* share of the background's pixels that the person covers in all or nearly all examples */
  double shift;      /* pixels of the clip: how far the background moves between the examples, 90th percentile */
  double shifted;    /* share of the examples in which the background certainly moves */
  double unlike;     /* share of pixels outside the person that differ from the background beyond noise */
  double unlike_lit; /* the same, where the background has each frame's light */
  double light;      /* grey values: how far the place's mean is from the background's, 90th percentile */
  double inset;      /* share of the picture: the largest part of the place that changes and is away from the person */
  double inset_edges[4];      /* its left, right, upper and lower edge, shares of the picture */
  double supplied_difference; /* grey values: root mean square, over the colours, of the difference between the supplied
                                 background and the learnt one, averaged over pixels; 0 where none was supplied */
};
/* Learns the colours, the person's position and the background from the examples. background: [side][side] RGB without
 * the person, or NULL. key: the background has one colour (chroma key). */
ERN_NODISCARD ern_status ern_person_model_learn(struct ern_person_model *model, const uint8_t *background, bool key,
                                                struct ern_person_found *found);
/* The background for the clip, [side][side] RGB; owned by the model. */
const uint8_t *ern_person_model_background(const struct ern_person_model *model);

/* mask[work][work] 0 or 255 of the next frame; `supplied` as above. */
ERN_NODISCARD ern_status ern_person_mask(struct ern_person_model *model, const uint8_t *rgb,
                                         const struct ern_layer_face *face, const uint8_t *supplied, uint8_t *mask);
/* voted[work][work], 0..255: the mean of the masks of neighbouring frames, each warped by the head's motion to frame
 * `which` of them. */
ERN_NODISCARD ern_status ern_person_temporal_mean(struct ern_person_model *model, const uint8_t *const *masks,
                                                  const struct ern_layer_face *const *faces, size_t count, size_t which,
                                                  uint8_t *voted);
/* Adds a frame, with its mask voted[work][work], to what ern_person_inset_find looks at: it sets found->inset and
 * inset_edges. */
ERN_NODISCARD ern_status ern_person_inset_add(struct ern_person_model *model, const uint8_t *rgb,
                                              const struct ern_layer_face *face, const uint8_t *voted);
ERN_NODISCARD ern_status ern_person_inset_find(const struct ern_person_model *model, struct ern_person_found *found);
/* Refines the mask at the clip's resolution: alpha[side][side] 0..255, and the background behind the person,
 * behind[side][side][3]. Adds the colour distances along the person's border to the histogram border[16], bins 16 wide.
 */
ERN_NODISCARD ern_status ern_person_matte(const struct ern_person_model *model, const uint8_t *rgb,
                                          const uint8_t *voted, uint8_t *alpha, uint8_t *behind, size_t border[16]);

/* parts[side][side] of enum ern_layer_part, where alpha is 128 or more. */
ERN_NODISCARD ern_status ern_head_parts(ern_context *context, const uint8_t *rgb, const uint8_t *alpha,
                                        const struct ern_layer_face *face, int side, uint8_t *parts);

/* torso[side][side][4]: the person without the head, with the part that the head hides filled in. */
ERN_NODISCARD ern_status ern_layer_torso(ern_context *context, const uint8_t *rgb, const uint8_t *alpha,
                                         const uint8_t *behind, const uint8_t *parts, int side, uint8_t *torso);
/* frame[side][side][3]: the person, or the head alone, over the background. */
void ern_layer_frame(const uint8_t *rgb, const uint8_t *alpha, const uint8_t *behind, const uint8_t *parts,
                     const uint8_t *background, bool head_only, int side, uint8_t *frame);

/* What all frames are compared with to find where the body is: neck and torso over the background. rgba: a frame's
 * torso picture, [side][side][4]; parts: [side][side] of enum ern_layer_part, read where they are neck or torso. */
struct ern_body_reference;
/* The reference is that frame, until ern_body_reference_mean. background: [side][side] RGB. */
ERN_NODISCARD ern_status ern_body_reference_make(ern_context *context, int side, const uint8_t *background,
                                                 const uint8_t *rgba, const uint8_t *parts,
                                                 struct ern_body_reference **reference);
void ern_body_reference_free(struct ern_body_reference *reference); /* accepts NULL */
/* Adds a frame, moved onto the reference, to the mean picture, which ern_body_reference_mean makes the reference; it
 * may then be done again. */
ERN_NODISCARD ern_status ern_body_reference_add(struct ern_body_reference *reference, const uint8_t *rgba,
                                                const uint8_t *parts);
ERN_NODISCARD ern_status ern_body_reference_mean(struct ern_body_reference *reference);
/* motion: ern_frame_input.torso_motion of a frame; *found false: the frame shows too little of the body. */
ERN_NODISCARD ern_status ern_body_reference_find(struct ern_body_reference *reference, const uint8_t *rgba,
                                                 const uint8_t *parts, float motion[ERN_MOTION_VALUES], bool *found);

/* Writes torso.npy of the pictures that the step has written; reports progress from `done` of `total` on. */
ERN_NODISCARD ern_status ern_prepare_body_motion(struct ern_prepare_job *job, const struct ern_layer_face *faces,
                                                 const uint8_t *background, size_t done, size_t total);

/* A network that segments a person: one picture of three channels in (NCHW), one or two channels out. */
struct ern_person_network;
ERN_NODISCARD ern_status ern_person_network_open(ern_context *context, const char *path,
                                                 struct ern_person_network **network);
void ern_person_network_free(struct ern_person_network *network); /* accepts NULL */
/* mask[side][side] 0..255. The first call determines the network's colour normalisation. */
ERN_NODISCARD ern_status ern_person_network_run(struct ern_person_network *network, const uint8_t *rgb,
                                                const struct ern_layer_face *face, int side, uint8_t *mask);

/* The masks that the user supplied: a folder, or a network. */
struct ern_supplied_masks;
ERN_NODISCARD ern_status ern_supplied_masks_open(struct ern_prepare_job *job, struct ern_supplied_masks **masks);
/* Checks that all masks can be read, or that the network can be opened. */
ERN_NODISCARD ern_status ern_supplied_masks_check(struct ern_prepare_job *job);
void ern_supplied_masks_free(struct ern_supplied_masks *masks); /* accepts NULL */
/* mask[side][side] 0..255 of the person; parts[side][side] where *has_parts. */
ERN_NODISCARD ern_status ern_supplied_mask(struct ern_supplied_masks *masks, size_t frame, const uint8_t *rgb,
                                           const struct ern_layer_face *face, uint8_t *mask, uint8_t *parts,
                                           bool *has_parts);

#ifdef __cplusplus
}
#endif
#endif
