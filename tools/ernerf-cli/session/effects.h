/* SPDX-License-Identifier: MIT
 * The optional effects of a model, the choice of effects for a clip, and their names and explanations. */
#ifndef ERN_CLI_EFFECTS_H
#define ERN_CLI_EFFECTS_H

#include "ernerf/media.h"
#include "session/session.h"

enum effect {
  EFFECT_EYE,   /* the lids follow an eye value */
  EFFECT_CODES, /* one latent code for each training frame, for what no other effect explains, such as light */
  EFFECT_VIEW,  /* colour depends on the view direction */
  EFFECT_TORSO, /* a separate layer behind the head */
  EFFECTS
};

/* Which effects are present, by enum effect. */
struct effects {
  bool has[EFFECTS];
};

const char *effect_name(enum effect effect); /* "eye", as in --effects LIST */

/* Chooses the effects that the clip's measures call for, and drops those whose training data the clip lacks. */
void effects_choose(const ern_clip_measures *measures, struct effects *effects);
/* Whether the clip has audible speech, without which no head can be trained. */
bool effects_has_speech(const ern_clip_measures *measures);

/* Reads the LIST of --effects: names separated by commas; "none" alone: no effects. Returns -1, or EXIT_USAGE after a
 * message. */
int effects_read(const struct args *args, const char *list, struct effects *effects);

/* "eye, view", or "none". */
void effects_words(const struct effects *effects, char *words, size_t bytes);

/* Calls `say` once for each measure, with the name of the effect or of the measure ("audio", "camera"), whether it is
 * present, and a sentence that gives the measured value and the conclusion. */
void effects_explain(const ern_clip_measures *measures,
                     void (*say)(void *user, const char *name, bool there, const char *sentence), void *user);
/* The measures as numbers. */
json_t *effects_measures(const ern_clip_measures *measures);

#endif
