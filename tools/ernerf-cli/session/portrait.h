/* SPDX-License-Identifier: MIT
 * What `render` and `eval` share: a model, a clip that it should belong to, a renderer, and their options. */
#ifndef ERN_CLI_PORTRAIT_H
#define ERN_CLI_PORTRAIT_H

#include "ernerf/media.h"
#include "ernerf/model.h"
#include "ernerf/render.h"
#include "session/clip_source.h"
#include "session/frame_source.h"
#include "session/session.h"

struct portrait {
  const char *model_path;
  /* from the command line */
  ern_render_options render;
  float scale, occupancy_threshold;
  int audio_pad, split; /* ern_audio_pad, enum frame_source_split */
  struct range frames;
  struct clip_source source; /* its path NULL: no clip */
  bool force;
  bool other_speech; /* set by the verb: the model speaks from another sound than the clip's, which only its silence is
                        learnt from */
  /* made */
  ern_model *model;
  ern_model_info info;
  ern_clip *clip;
  ern_clip_info clip_info;
  char features_path[4096]; /* of the clip's features, for messages */
  ern_renderer *renderer;
};

enum { PORTRAIT_OPTIONS = 12 + CLIP_SOURCE_OPTIONS };
/* The defaults, and --split --frames --audio-pad --max_steps --dt_gamma --transmittance_stop --occupancy_threshold
 * --torso_shrink --scale --image_scale --smooth_lips --force, and those of a clip's source. */
void portrait_options(struct portrait *portrait, enum frame_source_split split,
                      struct option options[PORTRAIT_OPTIONS]);

/* Opens model, clip (where there is one), backend (where none is open) and renderer. A model of another clip is
 * refused, with --force only told of. Returns 0, or EXIT_FAILURE after a message. */
int portrait_open(struct portrait *portrait, struct session *session, const struct args *args);
void portrait_close(struct portrait *portrait);

/* Leaves out cells that hold next to nothing while these frames speak, where --occupancy_threshold asks for it. Returns
 * 0, or EXIT_FAILURE after a message. */
int portrait_thin(struct portrait *portrait, struct session *session, const struct frame_source *frame_source,
                  const ern_features *features);

/* The pose of the head in `refined` where the model has a camera refinement and frame k is one of a clip; else NULL. */
const float *portrait_refined(const struct portrait *portrait, const struct frame_source *frame_source, size_t k,
                              float refined[16]);

/* The kind of features that the model speaks from: ern_model_info.speech, or what its width says; "" unknown. */
const char *portrait_speech(const struct portrait *portrait);
/* Says that the model does not speak from the built-in features of a sound, and what it takes. Returns EXIT_FAILURE. */
int portrait_refuse_sound(const struct portrait *portrait, struct session *session);

/* "head" or "head+torso". */
const char *portrait_kind(const struct portrait *portrait);
/* Frames [begin, end) that --frames asks for. With --smooth_lips the speech of those before is heard, not drawn, so
 * that the first ones are as in the whole. Returns 0, or an exit status after a message. */
int portrait_cut(const struct portrait *portrait, struct session *session, const struct args *args,
                 struct frame_source *frame_source, const ern_features *features);

#endif
