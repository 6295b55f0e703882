/* SPDX-License-Identifier: MIT
 * The effects that a model may have, what a clip calls for, and the words for both. */
#ifndef ERN_CLI_EFFECTS_H
#define ERN_CLI_EFFECTS_H

#include "ernerf/media.h"
#include "session/session.h"

enum effect {
  EFFECT_EYE,   /* the lids follow an eye value */
  EFFECT_CODES, /* a code a training frame, for what no other effect explains: its light */
  EFFECT_VIEW,  /* colour depends on where it is seen from */
  EFFECT_TORSO, /* a layer of its own behind the head */
  EFFECTS
};

/* Which are there, by enum effect. */
struct effects {
  bool has[EFFECTS];
};

const char *effect_name(enum effect effect); /* "eye", as in --effects LIST */

/* What the measures call for, and whether the clip holds what an effect cannot be learnt without. */
void effects_choose(const ern_clip_measures *measures, struct effects *effects);
/* Whether anything is heard: a head that does not speak cannot be learnt. */
bool effects_has_speech(const ern_clip_measures *measures);

/* LIST of --effects: names between commas; "none" alone is none. Returns -1, or EXIT_USAGE after a sentence. */
int effects_read(const struct args *args, const char *list, struct effects *effects);

/* "eye, view", or "none". */
void effects_words(const struct effects *effects, char *words, size_t bytes);

/* A line each: what was measured, and what follows from it. `say` gets the effect's name or that of what was measured
 * ("audio", "camera"), whether it is there, and a sentence. */
void effects_explain(const ern_clip_measures *measures,
                     void (*say)(void *user, const char *name, bool there, const char *sentence), void *user);
/* The measures as numbers. */
json_t *effects_measures(const ern_clip_measures *measures);

#endif
