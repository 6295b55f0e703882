/* SPDX-License-Identifier: MIT */
#include "session/effects.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* Thresholds of the measures. Changes of features below a thousandth of their size are noise. The highlight of a
 * surface moves by twice the angle between two views. Half a level of 255 is the resolution of 8 bits. */
static const double least_turn = 2, least_light = 0.5;
static const double least_move = 0.25; /* pixels */

static const char *const names[EFFECTS] = {"eye", "codes", "view", "torso"};
const char *effect_name(enum effect effect) { return names[effect]; }

static bool camera_moves(const ern_clip_measures *m) { return m->camera_turn > 1e-3 || m->camera_shift > 1e-5; }

bool effects_has_speech(const ern_clip_measures *m) { return m->feature_change >= ERN_CLIP_SPEECH; }

void effects_choose(const ern_clip_measures *m, struct effects *effects) {
  effects->has[EFFECT_EYE] = (double)m->eye_high - (double)m->eye_low >= ERN_CLIP_BLINK;
  effects->has[EFFECT_CODES] = m->light < 0 || m->light >= least_light;
  effects->has[EFFECT_VIEW] = m->turn >= least_turn;
  effects->has[EFFECT_TORSO] = m->torso_cover > 0;
}

int effects_read(const struct args *args, const char *list, struct effects *effects) {
  *effects = (struct effects){{false}};
  if (strcmp(list, "none") == 0) return -1;
  for (const char *at = list;; at++) {
    const size_t length = strcspn(at, ",");
    int found = 0;
    while (found < EFFECTS && (strlen(names[found]) != length || strncmp(names[found], at, length) != 0)) found++;
    if (found == EFFECTS)
      return args_refuse(args,
                         "--effects is \"%s\", expected auto, none, or some of eye, codes, view, torso between "
                         "commas; \"%.*s\" is none of them",
                         list, (int)length, at);
    if (effects->has[found]) return args_refuse(args, "--effects is \"%s\": %s is there twice", list, names[found]);
    effects->has[found] = true;
    at += length;
    if (*at == 0) return -1;
  }
}

void effects_words(const struct effects *effects, char *words, size_t bytes) {
  size_t used = (size_t)snprintf(words, bytes, "none");
  for (int e = 0, count = 0; e < EFFECTS; e++) {
    if (!effects->has[e]) continue;
    used = (count++ > 0 ? used : 0);
    used += (size_t)snprintf(words + used, bytes - used, "%s%s", count > 1 ? ", " : "", names[e]);
  }
}

/* ---- words ------------------------------------------------------------------------------------------------------- */

struct effect_lines {
  void (*say)(void *user, const char *name, bool there, const char *sentence);
  void *user;
};

static void print_effect(const struct effect_lines *lines, const char *name, bool there, const char *format, ...)
    ERN_PRINTF(4, 5);
static void print_effect(const struct effect_lines *lines, const char *name, bool there, const char *format, ...) {
  char sentence[512];
  va_list values;
  va_start(values, format);
  vsnprintf(sentence, sizeof sentence, format, values);
  va_end(values);
  lines->say(lines->user, name, there, sentence);
}

static void print_speech(const struct effect_lines *lines, const ern_clip_measures *m) {
  char sound[64] = "there is no sound to measure";
  if (m->loud >= 0) snprintf(sound, sizeof sound, "the sound is above -50 dB for %.0f %% of its time", 100 * m->loud);
  if (effects_has_speech(m))
    print_effect(lines, "audio", true, "the features change by %.0f %% of their size, %s.", 100 * m->feature_change,
                 sound);
  else
    print_effect(lines, "audio", false, "the features are the same in every window, %s: nothing for a mouth to follow.",
                 sound);
}

static void print_eyes(const struct effect_lines *lines, const ern_clip_measures *m, bool there) {
  if (there)
    print_effect(lines, "eye", true, "the lids move: eye values from %.2f to %.2f.", (double)m->eye_low,
                 (double)m->eye_high);
  else if (m->eye_low == 0 && m->eye_high == 0)
    print_effect(lines, "eye", false, "no lid moves: there is no au.csv, or AU45_r is 0 throughout.");
  else
    print_effect(lines, "eye", false,
                 "the lids rest: eye values from %.2f to %.2f, a blink moves them by %.1f at least.",
                 (double)m->eye_low, (double)m->eye_high, ERN_CLIP_BLINK);
}

static void print_head(const struct effect_lines *lines, const ern_clip_measures *m, const struct effects *called) {
  if (camera_moves(m))
    print_effect(lines, "camera", true, "the head moves: it turns by up to %.1f degrees from its first pose.",
                 m->camera_turn);
  else
    print_effect(lines, "camera", false, "every frame has the first one's pose.");
  print_effect(lines, "view", called->has[EFFECT_VIEW],
               "the head is seen from directions up to %.1f degrees apart; from %.0f on colour may depend on it.",
               m->turn, least_turn);
  if (m->light < 0)
    print_effect(lines, "codes", called->has[EFFECT_CODES],
                 "no frame has landmarks, so the light on the face is not known: each frame may have its own.");
  else
    print_effect(
        lines, "codes", called->has[EFFECT_CODES],
        "the cheeks' colour changes by %.2f of 255 from frame to frame beyond what the pose explains; from %.1f on "
        "each frame gets a code of its own.",
        m->light, least_light);
}

static void print_torso(const struct effect_lines *lines, const ern_clip_measures *m) {
  const char *how = "moves on its own";
  if (m->torso_cover <= 0) {
    print_effect(lines, "torso", false, "there is no torso layer, or it is transparent everywhere.");
    return;
  }
  if (m->torso_move < least_move)
    how = "stands still";
  else if (m->torso_against < 0.25 * m->torso_move)
    how = "moves as the head does";
  print_effect(
      lines, "torso", true,
      "the layer covers %.1f %% of the picture and %s: its centre moves by %.2f pixels, relative to the head by %.2f.",
      100 * m->torso_cover, how, m->torso_move, m->torso_against);
}

void effects_explain(const ern_clip_measures *m,
                     void (*say)(void *user, const char *name, bool there, const char *sentence), void *user) {
  const struct effect_lines lines = {say, user};
  struct effects called;
  effects_choose(m, &called);
  print_speech(&lines, m);
  print_eyes(&lines, m, called.has[EFFECT_EYE]);
  print_head(&lines, m, &called);
  print_torso(&lines, m);
}

json_t *effects_measures(const ern_clip_measures *m) {
  return json_pack("{s:I, s:I, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f}", "frames", (json_int_t)m->frames,
                   "looked", (json_int_t)m->looked, "eye_low", (double)m->eye_low, "eye_high", (double)m->eye_high,
                   "turn", m->turn, "camera_turn", m->camera_turn, "camera_shift", m->camera_shift, "feature_change",
                   m->feature_change, "loud", m->loud, "torso_cover", m->torso_cover, "torso_move", m->torso_move,
                   "torso_against", m->torso_against, "light", m->light);
}
