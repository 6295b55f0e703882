/* SPDX-License-Identifier: MIT
 * Synthetic speech: timed letters, their speech features, and the mouth, which depends on the features alone. */
#include "core/memory.h"
#include "lab/synth/synth_parts.h"

enum { SPACE = 0, BLANK = 28 };
enum { STREAM_TEXT = 21, STREAM_BASE = 22, STREAM_NOISE = 100 /* and up, two a letter */ };

/* ---- letters ------------------------------------------------------------------------------------- */

/* Articulation of a letter: jaw 0..1, lips -1 pursed .. 1 spread, voiced and unvoiced strength, formants in Hz. */
struct letter {
  float jaw, width, loud, hiss, formants[3];
};

static const struct letter letters[ERN_SYNTH_LETTERS] = {
    [SPACE] = {0.00f, 0.00f, 0.00f, 0.00f, {500, 1500, 2500}}, /* silence */
    [1] = {0.95f, 0.15f, 1.00f, 0.00f, {760, 1250, 2500}},     /* a */
    [2] = {0.00f, -0.05f, 0.25f, 0.00f, {300, 1000, 2300}},    /* b */
    [3] = {0.18f, 0.20f, 0.00f, 0.50f, {350, 1900, 2700}},     /* c */
    [4] = {0.20f, 0.10f, 0.30f, 0.05f, {320, 1700, 2600}},     /* d */
    [5] = {0.62f, 0.55f, 0.95f, 0.00f, {520, 1850, 2550}},     /* e */
    [6] = {0.10f, 0.05f, 0.00f, 0.45f, {350, 1200, 2400}},     /* f */
    [7] = {0.25f, 0.00f, 0.30f, 0.05f, {320, 1900, 2400}},     /* g */
    [8] = {0.40f, 0.00f, 0.05f, 0.35f, {500, 1500, 2500}},     /* h */
    [9] = {0.32f, 0.90f, 0.85f, 0.00f, {300, 2250, 2950}},     /* i */
    [10] = {0.22f, 0.10f, 0.30f, 0.30f, {320, 1900, 2600}},    /* j */
    [11] = {0.25f, 0.05f, 0.00f, 0.40f, {350, 1800, 2400}},    /* k */
    [12] = {0.34f, 0.20f, 0.60f, 0.00f, {380, 1150, 2700}},    /* l */
    [13] = {0.00f, 0.00f, 0.45f, 0.00f, {280, 1000, 2200}},    /* m */
    [14] = {0.22f, 0.15f, 0.45f, 0.00f, {290, 1500, 2500}},    /* n */
    [15] = {0.62f, -0.70f, 0.95f, 0.00f, {480, 850, 2400}},    /* o */
    [16] = {0.00f, -0.05f, 0.00f, 0.30f, {320, 1000, 2300}},   /* p */
    [17] = {0.25f, -0.30f, 0.00f, 0.35f, {350, 1000, 2300}},   /* q */
    [18] = {0.28f, -0.35f, 0.60f, 0.00f, {380, 1250, 1700}},   /* r */
    [19] = {0.14f, 0.40f, 0.00f, 0.80f, {350, 1900, 2800}},    /* s */
    [20] = {0.18f, 0.15f, 0.00f, 0.45f, {350, 1800, 2700}},    /* t */
    [21] = {0.28f, -1.00f, 0.85f, 0.00f, {310, 780, 2300}},    /* u */
    [22] = {0.10f, 0.05f, 0.40f, 0.20f, {320, 1200, 2400}},    /* v */
    [23] = {0.20f, -0.85f, 0.60f, 0.00f, {320, 700, 2200}},    /* w */
    [24] = {0.18f, 0.30f, 0.00f, 0.65f, {350, 1800, 2600}},    /* x */
    [25] = {0.30f, 0.60f, 0.75f, 0.00f, {320, 2100, 2800}},    /* y */
    [26] = {0.14f, 0.40f, 0.35f, 0.45f, {330, 1900, 2800}},    /* z */
    [27] = {0.20f, 0.00f, 0.30f, 0.00f, {500, 1500, 2500}},    /* ' */
    [BLANK] = {0.00f, 0.00f, 0.00f, 0.00f, {500, 1500, 2500}},
};

/* A letter in time, seconds. */
struct event {
  double start, end;
  int letter;
};

struct script {
  struct event *events;
  size_t count, capacity;
  double now;
};

static ern_status script_say(ern_context *context, struct script *script, int letter, double seconds) {
  if (script->count == script->capacity)
    return ern_fail(context, ERN_E_STATE, "made-up speech: more than %zu letters", script->capacity);
  script->events[script->count++] = (struct event){script->now, script->now + seconds, letter};
  script->now += seconds;
  return ERN_OK;
}

/* Words of two or three syllables, each a consonant, a vowel and now and then a consonant. */
static ern_status script_phrase(ern_context *context, struct script *script, uint64_t seed, uint64_t *draws,
                                double until) {
  static const char consonants[] = "bdfgklmnprstvwzhmbps", vowels[] = "aaaeeiioouu", codas[] = "nmlrstk";
  while (script->now < until) {
    const int syllables = 1 + (int)(synth_hash(seed, STREAM_TEXT, (*draws)++) % 3);
    for (int k = 0; k < syllables; ++k) {
      const uint64_t h = synth_hash(seed, STREAM_TEXT, (*draws)++);
      const char onset = consonants[h % (sizeof consonants - 1)];
      const char vowel = vowels[(h >> 16) % (sizeof vowels - 1)];
      ern_status status = script_say(context, script, onset - 'a' + 1, 0.06 + 0.04 * (double)(h >> 32 & 255) / 255.0);
      if (status == ERN_OK)
        status = script_say(context, script, vowel - 'a' + 1, 0.10 + 0.09 * (double)(h >> 40 & 255) / 255.0);
      if (status == ERN_OK && (h >> 48) % 3 == 0)
        status = script_say(context, script, codas[(h >> 52) % (sizeof codas - 1)] - 'a' + 1, 0.07);
      if (status != ERN_OK) return status;
    }
    if (synth_hash(seed, STREAM_TEXT, (*draws)++) % 3 == 0) script->now += 0.04;
  }
  return ERN_OK;
}

/* Writes silence, then phrases with pauses, until `seconds`. Short clips get a short silence. */
static ern_status script_write(ern_context *context, struct script *script, uint64_t seed, double seconds) {
  uint64_t draws = 0;
  script->now = fmin(synth_uniform(seed, STREAM_TEXT, 1000000, 0.16, 0.28), 0.25 * seconds);
  bool first = true;
  while (script->now < seconds + 0.5) {
    const double long_for = first ? synth_uniform(seed, STREAM_TEXT, 1000001, 0.85, 1.05)
                                  : synth_uniform(seed, STREAM_TEXT, 1000002 + draws, 0.9, 2.6);
    const ern_status status = script_phrase(context, script, seed, &draws, script->now + long_for);
    if (status != ERN_OK) return status;
    script->now += first ? 0.36 : synth_uniform(seed, STREAM_TEXT, 2000000 + draws, 0.30, 0.75);
    first = false;
  }
  return ERN_OK;
}

/* ---- features ------------------------------------------------------------------------------------ */

/* Noise in one dimension, C1, in [-1, 1]. */
static double wander(uint64_t seed, uint64_t stream, double t) {
  const double whole = floor(t), part = t - whole;
  const uint64_t at = (uint64_t)(int64_t)whole;
  return synth_uniform(seed, stream, at, -1, 1) +
         part * part * (3 - 2 * part) *
             (synth_uniform(seed, stream, at + 1, -1, 1) - synth_uniform(seed, stream, at, -1, 1));
}

/* Loudness of a letter at `t`: 0..1, with ramps of 40 ms. */
static double sounding(const struct event *event, double t) {
  const double ramp = 0.040, from = (t - event->start + 0.5 * ramp) / ramp, to = (event->end + 0.5 * ramp - t) / ramp;
  const double a = fmin(fmin(from, to), 1.0);
  return a <= 0.0 ? 0.0 : a * a * (3.0 - 2.0 * a);
}

/* Step k is at (k - ERN_SYNTH_BEFORE) / 50 s. Logits like DeepSpeech's: most letters low, the one that sounds high,
 * silence in the space, the blank in between. */
static void speech_logits(const struct script *script, uint64_t seed, struct ern_synth_speech *speech) {
  size_t first = 0;
  for (size_t k = 0; k < speech->steps; ++k) {
    const double t = ((double)k - ERN_SYNTH_BEFORE) / ERN_SYNTH_STEPS;
    double active[ERN_SYNTH_LETTERS] = {0}, any = 0.0;
    while (first < script->count && script->events[first].end < t - 0.1) ++first;
    for (size_t j = first; j < script->count && script->events[j].start < t + 0.1; ++j) {
      const double a = sounding(&script->events[j], t);
      active[script->events[j].letter] = fmax(active[script->events[j].letter], a);
      any += a;
    }
    active[SPACE] = fmax(1.0 - any, 0.0);
    for (int c = 0; c < ERN_SYNTH_LETTERS; ++c) {
      const double base = synth_uniform(seed, STREAM_BASE, (uint64_t)c, -7.5, -4.0);
      const double noise = 0.8 * wander(seed, STREAM_NOISE + 2 * (uint64_t)c, t * 9.0) +
                           0.4 * wander(seed, STREAM_NOISE + 2 * (uint64_t)c + 1, t * 31.0);
      speech->logits[k][c] = (float)(base + noise + (5.0 - base) * active[c]);
    }
    speech->logits[k][BLANK] += (float)(8.0 * (1.0 - fmin(any, 1.0)) + 3.0);
  }
}

/* Weights of the letters in a step: softmax of 0.6 times the logits, without the blank. */
static void letter_weights(const float *logits, float weights[ERN_SYNTH_LETTERS]) {
  float high = logits[0], sum = 0.0f;
  for (int c = 1; c < BLANK; ++c) high = maxf(high, logits[c]);
  for (int c = 0; c < BLANK; ++c) sum += weights[c] = expf(0.6f * (logits[c] - high));
  for (int c = 0; c < BLANK; ++c) weights[c] /= sum;
  weights[BLANK] = 0.0f;
}

/* Jaw and lips are weighted means over the letters, smoothed over five steps (80 ms); the voice is not smoothed.
 * raw[steps][2]. */
static void speech_articulate(struct ern_synth_speech *speech, float (*raw)[2]) {
  static const float taps[5] = {0.0625f, 0.25f, 0.375f, 0.25f, 0.0625f};
  for (size_t k = 0; k < speech->steps; ++k) {
    float weights[ERN_SYNTH_LETTERS];
    letter_weights(speech->logits[k], weights);
    for (int c = 0; c < BLANK; ++c) {
      raw[k][0] += weights[c] * letters[c].jaw;
      raw[k][1] += weights[c] * letters[c].width;
      speech->loud[k] += weights[c] * letters[c].loud;
      speech->hiss[k] += weights[c] * letters[c].hiss;
      for (int f = 0; f < 3; ++f) speech->formants[k][f] += weights[c] * letters[c].formants[f];
    }
  }
  for (size_t k = 2; k + 2 < speech->steps; ++k) {
    float jaw = 0.0f, width = 0.0f;
    for (size_t j = 0; j < 5; ++j) {
      jaw += taps[j] * raw[k + j - 2][0];
      width += taps[j] * raw[k + j - 2][1];
    }
    speech->jaw[k] = clampf((jaw - 0.03f) / 0.90f, 0.0f, 1.0f); /* removes the small opening that leaks into silence */
    speech->width[k] = clampf(width, -1.0f, 1.0f);
  }
}

ern_status ern_synth_speech_make(ern_context *context, uint64_t seed, size_t frames, struct ern_synth_speech *speech) {
  ern_status status = ERN_OK;
  const double seconds = (double)frames / ERN_SYNTH_FPS;
  struct script script = {.capacity =
                              (size_t)(seconds * 16.0) + 64}; /* letters last 60 ms or more, mostly twice that */
  float(*raw)[2] = NULL;
  *speech = (struct ern_synth_speech){.steps = 2 * frames + ERN_SYNTH_BEFORE + ERN_SYNTH_WINDOW};
  ERN_TRY(ERN_NEW(context, script.capacity, &script.events));
  ERN_TRY(ERN_NEW(context, speech->steps, &raw));
  ERN_TRY(ERN_NEW(context, speech->steps, &speech->logits));
  ERN_TRY(ERN_NEW(context, 7 * speech->steps, &speech->jaw));
  speech->width = speech->jaw + speech->steps;
  speech->loud = speech->width + speech->steps;
  speech->hiss = speech->loud + speech->steps;
  speech->formants = (float(*)[3])(void *)(speech->hiss + speech->steps);
  ERN_TRY(script_write(context, &script, seed, seconds));
  speech_logits(&script, seed, speech);
  speech_articulate(speech, raw);
fail:
  ern_release(context, script.events);
  ern_release(context, raw);
  if (status != ERN_OK) ern_synth_speech_free(context, speech);
  return status;
}

ern_status ern_synth_speech_follow(ern_context *context, const ern_spoken *spoken, size_t frames,
                                   struct ern_synth_speech *speech) {
  ern_status status = ERN_OK;
  *speech = (struct ern_synth_speech){.steps = 2 * frames + ERN_SYNTH_BEFORE + ERN_SYNTH_WINDOW};
  ERN_TRY(ERN_NEW(context, 2 * speech->steps, &speech->jaw));
  speech->width = speech->jaw + speech->steps;
  for (size_t k = 0; k < speech->steps; ++k)
    ern_spoken_mouth(spoken, ((double)k - ERN_SYNTH_BEFORE) / ERN_SYNTH_STEPS, &speech->jaw[k], &speech->width[k]);
fail:
  return status;
}

void ern_synth_speech_free(ern_context *context, struct ern_synth_speech *speech) {
  ern_release(context, speech->logits);
  ern_release(context, speech->jaw); /* the other curves are in the same block */
  *speech = (struct ern_synth_speech){0};
}
