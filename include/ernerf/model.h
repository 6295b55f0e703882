/* SPDX-License-Identifier: MIT
 * A trained portrait and its file. */
#ifndef ERNERF_MODEL_H
#define ERNERF_MODEL_H

#include <stdbool.h>

#include "ernerf/base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Least and largest bound of a model: half the side of the cube that holds its scene, in scene units. A length in
 * scene units is ern_model_info.scale times the length in the transforms file (ern_camera_pose), which is in metres in
 * a clip of ern_prepare. */
#define ERN_BOUND_LEAST 0.125
#define ERN_BOUND_MOST 16.0

/* The parts of a head. The first of each enum is the paper's own; the others are what its ablation compares that with.
 * What encodes a position: */
typedef enum ern_backbone {
  ERN_BACKBONE_TRIHASH,  /* three hash grids of two dimensions: 2..24 levels of 1 feature each, 14 by default */
  ERN_BACKBONE_HASH3D,   /* one hash grid of three dimensions: 2..24 levels of 2 features each, 16 by default */
  ERN_BACKBONE_TRIPLANE, /* three dense planes of 128 x 128 entries with 12 features each */
  ERN_BACKBONE_MLP       /* a network: sines and cosines of the position through 8 hidden layers of 256 */
} ern_backbone;
/* How the audio code of a frame reaches a position. The audio code is 32 numbers that the model computes from the 8
 * windows of speech of a frame. */
typedef enum ern_attention {
  ERN_ATTENTION_CHANNEL, /* each number times a weight of its own, which depends on the position */
  ERN_ATTENTION_FEATURE, /* all numbers times one weight, which depends on the position */
  ERN_ATTENTION_CONCAT   /* unchanged, the same at every position */
} ern_attention;
/* How the eye value of a frame reaches a position, in a model that has_eye: */
typedef enum ern_eye_attention {
  ERN_EYE_ATTENTION_SIGMOID, /* times a weight, which depends on the position */
  ERN_EYE_ATTENTION_CONCAT   /* unchanged */
} ern_eye_attention;
/* A frame's input is 8 windows of speech: 4 before its own, its own and 3 after it. Which windows these are near the
 * ends of the speech: */
typedef enum ern_audio_pad {
  ERN_AUDIO_PAD_EDGE = 0, /* the windows of the feature file around the frame's own; before the first the first one,
                             past the last the last one */
  ERN_AUDIO_PAD_ZERO = 1  /* as in the public program: the windows of its neighbours in a list of frames, such as
                             one split of a clip; past the ends of that list, zeros. ern_audio_windows_of_rows does
                             this for a list whose frame k has window rows[k] of the feature file; where rows[k] is
                             k for the whole file, ern_audio_windows gives the same windows */
} ern_audio_pad;
/* The words of the command line and of model files ("trihash", "channel", "sigmoid"); NULL for no such kind. */
ERN_API const char *ern_backbone_name(ern_backbone backbone);
ERN_API const char *ern_attention_name(ern_attention attention);
ERN_API const char *ern_eye_attention_name(ern_eye_attention eye_attention);
ERN_API const char *ern_audio_pad_name(ern_audio_pad pad); /* "edge", "zero" */

/* Read-only once loaded: any number of renderers, in any threads, may share one. */
typedef struct ern_model ern_model;

/* Reads a .safetensors file of this library, or a .pth checkpoint of the public program, which is the PyTorch program
 * that the authors of ER-NeRF published. The file's content decides which it is, not its name. A .pth is the zip that
 * torch.save writes since PyTorch 1.6; nothing in it is executed. Every tensor must be there, with its shape and finite
 * values, else the error text names the first that is wrong. ERN_E_MISSING: no file, or a tensor is not in it.
 * ERN_E_IO: it cannot be read. ERN_E_FORMAT: it has neither form, its metadata is wrong, or it has a tensor that no
 * model has. ERN_E_SHAPE: a tensor has another shape, or the file is larger than 1 GiB. ERN_E_NONFINITE: a value is not
 * finite. ERN_E_MISMATCH: a tensor has another type, or one that the configuration determines (aabb_train, aabb_infer,
 * .offsets) has other values. ERN_E_UNSUPPORTED: a form that this version does not read. On success the caller owns
 * *model. */
ERN_API ERN_NODISCARD ern_status ern_model_load(ern_model **model, ern_context *context, const char *path);
ERN_API void ern_model_free(ern_model **model); /* accepts NULL and a pointer to NULL */

/* Writes the model as .safetensors: weights as float32, occupancy as bits, configuration and identity of the clip in
 * the metadata. Atomic. path ends in .safetensors, else ERN_E_ARGUMENT (ern_file_convert writes .pth). */
ERN_API ERN_NODISCARD ern_status ern_model_save(const ern_model *model, const char *path);

enum { ERN_CONSENT_BYTES = 1024 }; /* most bytes of the text of consent, with the 0 at its end */

/* Plain data, may grow. */
typedef struct ern_model_info {
  bool has_torso; /* head and torso; false: the head alone */
  bool has_eye;   /* the eye value of a frame is an input */
  bool has_view;  /* the colour depends on the direction from which a point is seen */
  bool has_codes; /* each training frame has an individual code: learnt numbers for what its pose, speech and eye value
                     do not determine (ERN_INDIVIDUAL_MEAN) */
  bool has_gamma; /* gamma was trained, the factor of the three projected points that tell the torso the pose of the
                     head (ern_train_config.torso_gamma; docs/maths.md); false: it is 1 */
  ern_backbone backbone;           /* its kind of encoder */
  ern_attention attention;         /* how speech reaches a position */
  ern_eye_attention eye_attention; /* meaningful with has_eye */
  int levels;                      /* of the encoder's grids; `triplane`: 1, `mlp`: 0 */
  int feature_width;               /* D of the speech features it was trained on (ern_features.width) */
  int window_length;               /* of those features: vectors in a window; 0 where the file does not say */
  int codes;                       /* number of individual codes; 0 without has_codes */
  float bound;                     /* ERN_BOUND_LEAST..ERN_BOUND_MOST; the scene is the cube [-bound, bound]^3. Samples
                                      of the head lie in its part |y| <= bound/2; y points from the face to the
                                      camera (ern_camera) */
  /* The settings that it was trained with. A renderer uses max_steps, dt_gamma and torso_shrink unless its
   * ern_render_options have others. A program passes `scale` to ern_camera_pose, and takes the windows of speech as
   * `audio_pad` says; other values give wrong pictures. */
  bool has_view_settings;  /* true: the file has these five; false: it has none of them, and they are the defaults in
                              brackets */
  int max_steps;           /* samples a ray at most, 1..1024 (16) */
  float dt_gamma;          /* growth of the sample spacing with distance, 0..1 (1/256) */
  float torso_shrink;      /* factor of the torso coordinates, 0.001..1 (0.8); meaningful with has_torso */
  float scale;             /* factor of the poses' translations, 1e-3..1e3 (4) */
  ern_audio_pad audio_pad; /* (edge) */
  size_t cameras;          /* training frames whose poses have trained corrections (ern_model_refine); 0: none */
  uint64_t head_steps, torso_steps; /* training steps behind it; 0 where the file does not say */
  char clip[65];            /* identity of the clip it was trained on (ern_clip_info.identity, ern_dataset.identity);
                               "" where the file does not say */
  size_t parameters;        /* number of trained values */
  size_t parameter_bytes;   /* of these as 32-bit floats */
  char speech[64];          /* kind of the speech features it was trained on, such as "cepstra-1"; "": unknown */
  char speech_network[512]; /* description of the network that made them, with its SHA-256, for
                               ern_speech_network_open; "": no network made them, or it is not known */
  char consent[ERN_CONSENT_BYTES]; /* what the person has agreed to (ern_train_config.consent); "": it does not say */
  bool dub;                        /* a head that was trained for ern_dub_frame (ERN_RAY_SAMPLING_DUB): it is exact in
                                      the lower face alone */
  bool has_torso_motion;           /* the torso was trained with the body's motion (ern_frame_input.torso_motion) */
  float voice_fade[2];             /* speech reaches the head as a whole up to the first of these heights, not at all
                                      from the second on: x of the scene, which points up (ern_camera); equal: it
                                      reaches the whole head */
} ern_model_info;

/* What the model is. */
ERN_API void ern_model_describe_sized(const ern_model *model, ern_model_info *info, size_t bytes);
static inline void ern_model_describe(const ern_model *model, ern_model_info *info) {
  ern_model_describe_sized(model, info, sizeof *info);
}

/* One tensor of a file, for listing. Plain data, may grow. */
typedef struct ern_tensor_info {
  const char *name, *dtype; /* dtype as safetensors writes it: "F32" */
  int dims;                 /* 0..4 */
  size_t shape[4];          /* the first `dims` of it; the others are 0 */
} ern_tensor_info;

/* Calls `say` for each tensor of a .safetensors, .pth or .npy file (the last has one, whose name is ""), after checking
 * the file as a whole. */
ERN_API ERN_NODISCARD ern_status ern_file_tensors(ern_context *context, const char *path,
                                                  void (*say)(void *user, const ern_tensor_info *tensor), void *user);

/* SHA-256 of the bytes of a file, as 64 lower-case hex digits: tells one model or video from another. */
ERN_API ERN_NODISCARD ern_status ern_file_sha256(ern_context *context, const char *path, char hex[65]);

/* Applies the correction that training found for the pose of a training frame, in place; the model stays as it is.
 * pose: a camera pose in scene units (ern_camera_pose). index: the training frame, counted from 0 in split 0 of the
 * ern_dataset (for a clip transforms_train.json); any past the last corrected frame stands for the last. The
 * correction is three angles, about x, then y, then z, in degrees, and a move in scene units. With dR = Rx Ry Rz of the
 * angles, rotation R and origin o of the pose become transpose(dR) R and o + move. A renderer takes such a pose as
 * ern_frame_input.head_pose: the torso keeps the pose of the clip. The pose stays as it is where ern_model_info.cameras
 * is 0. */
ERN_API void ern_model_refine(const ern_model *model, size_t index, float pose[16]);

/* Corrects the pose of a frame that was not trained on, in place, by the corrections of the training frames near it in
 * time, and by what the model predicts from the pose: the correction (angles and move) is
 * (p + sum_i w_i c_i)/(1 + sum_i w_i), w_i = exp(-((frames[i] - frame)/3)^2/2), with c_i that of training frame i, and
 * p predicted by a regression that training made (docs/poses.md), 0 in a model without one. So a frame far
 * from all of them gets p. frames: [count] numbers of the training frames, in the order of ern_model_refine; any past
 * ern_model_info.cameras are ignored; they and `frame` are img_id, or count frames in another way; NULL where count is
 * 0, as for a new pose. The pose stays as it is where ern_model_info.cameras is 0. */
ERN_API void ern_model_refine_unseen(const ern_model *model, const int64_t *frames, size_t count, int64_t frame,
                                     float pose[16]);

/* Writes the model of file `in` to file `out` in the form that the name of `out` asks for: .safetensors, or .pth and
 * .pt, which the public program loads, and torch.load(weights_only=True) too. `in` is of either form. A training
 * state's optimizer moments and moving average of the weights are written too. An `in` that is no model is written with
 * its tensors as they are, and a warning goes to the log. Atomic. The log also has what must be told to the public
 * program, such as --scale. ERN_E_ARGUMENT: another ending. ERN_E_UNSUPPORTED: the error text names what the public
 * program cannot hold. Otherwise errors are those of ern_model_load and of writing a file. */
ERN_API ERN_NODISCARD ern_status ern_file_convert(ern_context *context, const char *in, const char *out);

#ifdef __cplusplus
}
#endif
#endif
