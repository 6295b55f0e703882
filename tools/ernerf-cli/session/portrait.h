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
#include "setting_choice.h"

/* The torso below the head. */
enum portrait_torso {
  PORTRAIT_TORSO_RECORDED, /* the clip's pictures, where there are some and the head has recorded poses */
  PORTRAIT_TORSO_MODEL     /* the model's, where it has one */
};

struct portrait {
  const char *model_path;
  /* from the command line */
  ern_render_options render;
  struct setting_choice chosen; /* of `render` */
  float scale, occupancy_threshold;
  int audio_pad, split; /* ern_audio_pad, enum frame_source_split */
  int torso;            /* enum portrait_torso */
  struct range frames;
  struct clip_source source; /* source.path NULL: no clip */
  bool force;
  ern_model *lent;   /* set by the verb: is the model, and outlives the portrait; NULL: it is loaded */
  bool dubs;         /* set by the verb: a head that was trained for dubbing is what it wants */
  bool other_speech; /* set by the verb: other sound than the clip's drives the model; the clip only serves to learn
                        silence */
  /* made */
  ern_model *model;
  ern_model_info info; /* has_torso: the model's torso is drawn */
  ern_clip *clip;
  ern_clip_info clip_info;
  char features_path[4096]; /* of the clip's features, for messages */
  ern_renderer *renderer;
};

enum { PORTRAIT_OPTIONS = 13 + CLIP_SOURCE_OPTIONS };
/* The defaults, and --split --frames --max-steps --dt-gamma --torso --torso-shrink --scale --smooth-lips --force, --set
 * audio-pad, transmittance_stop, occupancy_threshold, image_scale, and those of a clip's source. */
void portrait_options(struct portrait *portrait, enum frame_source_split split,
                      struct option options[PORTRAIT_OPTIONS]);

/* Opens the model, the clip (if any), the backend (unless open) and the renderer. A model of another clip is refused;
 * with --force it causes only a warning. Returns 0, or EXIT_FAILURE after a message. */
int portrait_open(struct portrait *portrait, struct session *session, const struct args *args);
void portrait_close(struct portrait *portrait);

/* With occupancy_threshold, prunes occupancy cells whose density is below it at moments sampled from these frames.
 * Returns 0, or EXIT_FAILURE after a message. */
int portrait_prune_occupancy(struct portrait *portrait, struct session *session,
                             const struct frame_source *frame_source, const ern_features *features);

/* If the model has a camera refinement and frame k is a clip's, puts the refined pose of the head into `refined` and
 * returns it; else NULL. */
const float *portrait_refined(const struct portrait *portrait, const struct frame_source *frame_source, size_t k,
                              float refined[16]);

/* The kind of speech features that drives the model: ern_model_info.speech, or guessed from the feature width; "":
 * unknown. */
const char *portrait_speech(const struct portrait *portrait);
/* Prints that the model does not take the built-in features of a sound, and which input it takes. Returns EXIT_FAILURE.
 */
int portrait_refuse_sound(const struct portrait *portrait, struct session *session);

/* The features of a file of sound or of features, as the model takes them: by the speech network that is open, else the
 * built-in ones. Returns 0, or EXIT_FAILURE after a message. The caller owns *features. */
int portrait_features(struct portrait *portrait, struct session *session, const char *path, ern_features *features);

/* "head" or "head+torso". */
const char *portrait_kind(const struct portrait *portrait);
/* Keeps frames [begin, end) of --frames. With --smooth-lips the speech of the earlier frames is processed without
 * drawing, so that the first frames are the same as in the whole output. Returns 0, or an exit status after a message.
 */
int portrait_cut(const struct portrait *portrait, struct session *session, const struct args *args,
                 struct frame_source *frame_source, const ern_features *features);

#endif
