/* SPDX-License-Identifier: MIT
 * The data of one call of `ernerf train`, and its options. */
#ifndef ERN_CLI_TRAIN_OPTIONS_H
#define ERN_CLI_TRAIN_OPTIONS_H

#include "ernerf/media.h"
#include "ernerf/train.h"
#include "output/forecast.h"
#include "session/clip_source.h"
#include "session/effects.h"
#include "session/progress.h"
#include "session/session.h"
#include "setting_choice.h"
#include "verbs/distributed.h"
#include "verbs/fine_stage.h"
#include "verbs/speech_augmentation.h"
#include "verbs/validations.h"

enum {
  TRAIN_GOAL_OPTIONS = 15,
  TRAIN_NUMBER_OPTIONS = 5 + SESSION_COMPUTE_OPTIONS + SESSION_SEED_OPTIONS + SESSION_OUTPUT_OPTIONS,
  TRAIN_CLIP_OPTIONS = 1 + CLIP_SOURCE_OPTIONS + SPEECH_AUGMENTATION_OPTIONS,
  TRAIN_PUBLIC_OPTIONS = 9
};

enum { FOR_PORTRAIT, FOR_DUB };

struct train_job {
  struct session session;
  struct distributed distributed;
  ern_train_config config;
  struct clip_source source;
  const char *head_path, *effects_list, *consent; /* consent: the text, or the name of its file */
  char consent_text[ERN_CONSENT_BYTES];
  double seconds;         /* of --time, 0: none */
  const char *portrait;   /* with --time: --output */
  char *head_output;      /* with --time: the file of the head; its torso goes to --output */
  double head_seconds;    /* training time of a finished head, which is not changed; 0: HEAD_SHARE of `seconds` */
  bool head_alone;        /* the resumed training is of a head alone, written to --output */
  bool restarts_torso;    /* the saved torso belongs to another head: the torso restarts */
  bool trains_torso_next; /* this call trains a head and its torso */
  bool paper;
  struct speech_augmentation speech;
  struct validations validations;
  struct effects effects;       /* of the head; EFFECT_TORSO: whether a torso layer lies behind it */
  struct setting_choice chosen; /* members of `config` that were on the command line */
  struct range data;
  float scale;
  int purpose, precision; /* indices into the choices of their options */
  struct fine_stage fine;
  ern_model_info from;   /* of --from, or of the resumed state */
  ern_train_state state; /* the resumed one */
  bool has_from, has_state;
  /* made */
  ern_clip *clip;
  ern_clip_info clip_info;
  ern_model *head;
  ern_trainer *trainer;
  struct progress progress;
  struct forecast forecast;
  ern_train_report last; /* the newest report */
  bool stepped;          /* `last` is set */
};

void train_set_defaults(struct train_job *job);

/* Options in four groups: what to train and where to write it; numbers of the training; the clip; the public program's
 * names of settings, which the help leaves out. */
void train_goal_options(struct train_job *job, struct option options[TRAIN_GOAL_OPTIONS]);
void train_number_options(struct train_job *job, struct option options[TRAIN_NUMBER_OPTIONS]);
void train_clip_options(struct train_job *job, struct option options[TRAIN_CLIP_OPTIONS]);
void train_public_options(struct train_job *job, struct option options[TRAIN_PUBLIC_OPTIONS]);

#endif
