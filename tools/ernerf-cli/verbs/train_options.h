/* SPDX-License-Identifier: MIT
 * What a call of `ernerf train` is about, and its options. */
#ifndef ERN_CLI_TRAIN_OPTIONS_H
#define ERN_CLI_TRAIN_OPTIONS_H

#include "ernerf/media.h"
#include "ernerf/train.h"
#include "output/forecast.h"
#include "output/progress.h"
#include "session/clip_source.h"
#include "session/effects.h"
#include "session/session.h"
#include "verbs/distributed.h"
#include "verbs/fine_stage.h"
#include "verbs/speech_augmentation.h"
#include "verbs/validations.h"

enum {
  TRAIN_GOAL_OPTIONS = 24,
  TRAIN_NUMBER_OPTIONS = 28,
  TRAIN_CLIP_OPTIONS = 1 + CLIP_SOURCE_OPTIONS + SPEECH_AUGMENTATION_OPTIONS
};

struct train_job {
  struct session session;
  struct distributed distributed;
  ern_train_config config;
  struct clip_source source;
  const char *head_path, *effects_list, *consent; /* consent: as asked, text or file */
  char consent_text[ERN_CONSENT_BYTES];
  double seconds;       /* of --time, 0: none */
  const char *portrait; /* with --time: --output */
  char *head_output;    /* where the head goes whose torso goes to that */
  double head_seconds;  /* of a head that is done, and stays as it is; 0: its share */
  bool head_alone;      /* a head that has --output to itself is resumed */
  bool torso_anew;      /* what the torso could be resumed from is of another head */
  bool torso_follows;   /* the head is trained, and its torso will be, or is */
  bool paper;
  struct speech_augmentation speech;
  struct validations validations;
  struct effects effects; /* of the head; the torso's is whether its layer lies behind the head */
  uint64_t save_every, validate_every, ema_every, refresh_every, iters;
  struct range data;
  float scale;
  int audio_pad, backbone, attention, eye_attention, precision, ray_sampling, head_background,
      torso_background; /* places among the words of their options */
  struct fine_stage fine;
  ern_model_info from;   /* of --from, or of the state that is resumed */
  ern_train_state state; /* that is resumed */
  bool has_from, has_state;
  /* made */
  ern_clip *clip;
  ern_clip_info clip_info;
  ern_model *head;
  ern_trainer *trainer;
  struct progress progress;
  struct forecast forecast;
  ern_train_report last; /* the newest one */
  bool stepped;          /* there is one */
};

void train_set_defaults(struct train_job *job);

/* What is trained and where to, how, and of which clip. */
void train_goal_options(struct train_job *job, struct option options[TRAIN_GOAL_OPTIONS]);
void train_number_options(struct train_job *job, struct option options[TRAIN_NUMBER_OPTIONS]);
void train_clip_options(struct train_job *job, struct option options[TRAIN_CLIP_OPTIONS]);

#endif
