/* SPDX-License-Identifier: MIT
 * A trained portrait and its file. */
#ifndef ERNERF_MODEL_H
#define ERNERF_MODEL_H

#include <stdbool.h>

#include "ernerf/base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Least and largest half side of the scene. */
#define ERN_BOUND_LEAST 0.125
#define ERN_BOUND_MOST 16.0

/* What a head is made of: the paper's own, and what its ablation compares that with. What encodes a position: */
typedef enum ern_backbone {
  ERN_BACKBONE_TRIHASH,  /* three hashed planes of 2..24 levels, the paper's own */
  ERN_BACKBONE_HASH3D,   /* one hashed volume of 2..24 levels, two features each, 16 as a rule */
  ERN_BACKBONE_TRIPLANE, /* three dense planes of 128 x 128 places, 12 features each */
  ERN_BACKBONE_MLP       /* sines of the position through 8 layers of 256 */
} ern_backbone;
/* How speech reaches a position: */
typedef enum ern_attention {
  ERN_ATTENTION_CHANNEL, /* weighed channel by channel, by what the position is: the paper's own */
  ERN_ATTENTION_FEATURE, /* weighed as a whole */
  ERN_ATTENTION_CONCAT   /* as it is, the same everywhere */
} ern_attention;
/* And how the eye value does, where the clip has one: */
typedef enum ern_eye_attention {
  ERN_EYE_ATTENTION_SIGMOID, /* weighed by the position: the paper's own */
  ERN_EYE_ATTENTION_CONCAT   /* as it is */
} ern_eye_attention;
/* What stands in for speech past its ends: */
typedef enum ern_audio_pad {
  ERN_AUDIO_PAD_EDGE = 0, /* neighbours from the feature file by number; the nearest window past its ends */
  ERN_AUDIO_PAD_ZERO = 1  /* zeros past the ends of the list that is indexed: the public code's, with its ghosts */
} ern_audio_pad;
/* The words of the command line and of model files ("trihash", "channel", "sigmoid"); NULL for no such kind. */
ERN_API const char *ern_backbone_name(ern_backbone backbone);
ERN_API const char *ern_attention_name(ern_attention attention);
ERN_API const char *ern_eye_attention_name(ern_eye_attention eye_attention);
ERN_API const char *ern_audio_pad_name(ern_audio_pad pad); /* "edge", "zero" */

/* Read-only once loaded: any number of renderers, in any threads, may share one. */
typedef struct ern_model ern_model;

/* Reads a .safetensors file with the public checkpoint's tensor names, or a .pth file as PyTorch's public program saves
 * it (the zip that torch.save writes since 1.6; nothing in it is executed); the content decides. Strict: every tensor
 * with its shape and finite values, or an error that names the first that is wrong. On success the caller owns *model.
 */
ERN_API ERN_NODISCARD ern_status ern_model_load(ern_model **model, ern_context *context, const char *path);
ERN_API void ern_model_free(ern_model **model); /* accepts NULL and a pointer to NULL */

/* Writes the model: weights as float32, occupancy as bits, configuration and identity in the metadata. Atomic. */
ERN_API ERN_NODISCARD ern_status ern_model_save(const ern_model *model, const char *path);

/* Plain data, may grow. */
typedef struct ern_model_info {
  bool has_torso; /* head and torso, else the head alone */
  bool has_eye;   /* follows the eye value */
  bool has_view;  /* colour depends on the direction it is seen from */
  bool has_codes; /* individual codes of the training frames */
  bool has_gamma; /* trained scale of the torso's key points */
  ern_backbone backbone;
  ern_attention attention;
  ern_eye_attention eye_attention; /* meaningful with has_eye */
  int levels;                      /* of the encoder's grids; `triplane`: 1, `mlp`: 0 */
  int feature_width;               /* D of the speech features it was trained on */
  int window_length;               /* L of them, vectors a window; 0 where the file does not say */
  int codes;                       /* rows of the individual codes */
  float bound;                     /* half side of the scene, ERN_BOUND_LEAST..ERN_BOUND_MOST */
  /* What it was trained with, so that it is seen the same way. A renderer takes the first three by itself
   * (ern_render_options); a program hands `scale` to ern_camera_pose and `audio_pad` to ern_audio_windows. */
  bool has_view_settings;  /* the file says these five; else they are those in brackets */
  int max_steps;           /* samples a ray at most, 1..1024 (16) */
  float dt_gamma;          /* step growth with distance, 0..1 (1/256) */
  float torso_shrink;      /* factor of the torso coordinates, above 0, at most 1 (0.8); meaningful with has_torso */
  float scale;             /* of the poses' translation, 1e-3..1e3 (4) */
  ern_audio_pad audio_pad; /* (edge) */
  size_t cameras;          /* training poses with a trained refinement (ern_model_refine); 0: none */
  uint64_t head_steps, torso_steps; /* training steps behind it; 0 where the file does not say */
  char clip[65];                    /* identity of the clip it was trained on, "" where the file does not say */
  size_t parameters;                /* trained numbers */
  size_t parameter_bytes;
  char speech[64];          /* kind of the speech features it was trained on, such as "cepstra-1"; "": unknown */
  char speech_network[512]; /* description of the network that made them, with its SHA-256, for
                               ern_speech_network_open; "": no network made them, or it is not known */
} ern_model_info;
ERN_API void ern_model_describe_sized(const ern_model *model, ern_model_info *info, size_t bytes);
static inline void ern_model_describe(const ern_model *model, ern_model_info *info) {
  ern_model_describe_sized(model, info, sizeof *info);
}

/* One tensor of a file, for listing. Plain data, may grow. */
typedef struct ern_tensor_info {
  const char *name, *dtype; /* dtype as safetensors writes it: "F32" */
  int dims;
  size_t shape[4];
} ern_tensor_info;

/* Lists the tensors of a .safetensors, .pth or .npy file (the last has one, without a name), after checking the file as
 * a whole.
 */
ERN_API ERN_NODISCARD ern_status ern_file_tensors(ern_context *context, const char *path,
                                                  void (*say)(void *user, const ern_tensor_info *tensor), void *user);

/* SHA-256 of a file's bytes as 64 lower-case hex digits: tells one model from another. */
ERN_API ERN_NODISCARD ern_status ern_file_sha256(ern_context *context, const char *path, char hex[65]);

/* The pose of training frame `index` as the model's camera refinement has it (where ern_model_info.cameras is not 0;
 * index past the last: the last): the rotation dR of its three angles (about x, then y, then z, in degrees) turns the
 * rays, d' = transpose(dR) d, and its move is added to the origin. Scene units, after ern_camera_pose. The torso of a
 * model does not take part. */
ERN_API void ern_model_refine(const ern_model *model, size_t index, float pose[16]);

/* The pose of a frame that was not trained on, as its neighbours in time have it: the mean of the refinements of the
 * training frames, weighted by exp(-(d/3)^2/2), d being the distance to `frame`, and of none, weighted by 1. So a frame
 * far from all of them keeps its pose. frames: [count] numbers of the training frames, in the order of the model's
 * rows; they and `frame` are img_id, or any other count of frames. Nothing where the model has no refinement. */
ERN_API void ern_model_refine_unseen(const ern_model *model, const int64_t *frames, size_t count, int64_t frame,
                                     float pose[16]);

/* Turns a model's file into the other form; the name of `out` decides: .safetensors, or .pth and .pt, which PyTorch's
 * torch.load(weights_only=True) opens and the public program loads. Optimizer and average go with it. What the public
 * program cannot hold is refused by name (ERN_E_UNSUPPORTED); what it needs to be told is said in the log. Files of
 * other tensors are carried over as they are. Atomic. */
ERN_API ERN_NODISCARD ern_status ern_file_convert(ern_context *context, const char *in, const char *out);

#ifdef __cplusplus
}
#endif
#endif
