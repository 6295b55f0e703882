/* SPDX-License-Identifier: MIT
 * Mouth shapes of phonemes, and their course in time. */
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "ernerf-lab/spoken.h"

/* By the first letter of espeak-ng's mnemonic, which most of its languages share. Others: a consonant of the tongue. */
static const struct target {
  char letter;
  float jaw, width; /* as in ern_spoken_mouth */
} targets[] = {{'a', 1, 0.15f},    {'A', 1, 0},         {'V', 0.8f, 0.05f}, {'E', 0.7f, 0.4f},   {'e', 0.6f, 0.5f},
               {'@', 0.45f, 0},    {'3', 0.5f, -0.3f},  {'I', 0.4f, 0.5f},  {'i', 0.35f, 0.9f},  {'O', 0.8f, -0.5f},
               {'0', 0.8f, -0.3f}, {'o', 0.65f, -0.7f}, {'U', 0.4f, -0.8f}, {'u', 0.3f, -1},     {'y', 0.3f, -0.9f},
               {'Y', 0.4f, -0.7f}, {'W', 0.5f, -0.6f},  {'9', 0.5f, -0.4f}, {'8', 0.5f, -0.3f},  {'6', 0.5f, 0},
               {'h', 0.4f, 0},     {'l', 0.3f, 0.1f},   {'L', 0.3f, 0.1f},  {'r', 0.25f, -0.3f}, {'R', 0.3f, 0},
               {'n', 0.2f, 0.1f},  {'N', 0.25f, 0},     {'J', 0.3f, 0.2f},  {'d', 0.2f, 0.1f},   {'D', 0.2f, 0},
               {'t', 0.2f, 0.1f},  {'T', 0.2f, 0},      {'s', 0.12f, 0.3f}, {'z', 0.12f, 0.3f},  {'S', 0.2f, -0.4f},
               {'Z', 0.2f, -0.4f}, {'k', 0.25f, 0},     {'g', 0.25f, 0},    {'x', 0.3f, 0},      {'C', 0.2f, 0.2f},
               {'c', 0.2f, 0.2f},  {'j', 0.3f, 0.5f},   {'w', 0.2f, -0.9f}, {'f', 0.08f, 0},     {'v', 0.08f, 0},
               {'B', 0.05f, 0},    {'m', 0, 0},         {'b', 0, 0},        {'p', 0, 0},         {'_', 0, 0}};
static const struct target of_tongue = {0, 0.2f, 0};
static const char vowels[] = "aAVEe@3IiO0oUuyYW986";

static const struct target *target_of(char letter) {
  for (size_t i = 0; i < sizeof targets / sizeof *targets; i++)
    if (targets[i].letter == letter) return &targets[i];
  return &of_tongue;
}

static bool is_vowel(char letter) { return letter != 0 && strchr(vowels, letter) != NULL; }

/* The integral over start..end of a Gaussian around `seconds`. */
static double share(double start, double end, double seconds) {
  const double unit = 0.020 * sqrt(2.0);
  return 0.5 * (erf((end - seconds) / unit) - erf((start - seconds) / unit));
}

void ern_spoken_mouth(const ern_spoken *spoken, double seconds, float *jaw, float *width) {
  const double reach = 0.12; /* six standard deviations */
  double open = 0, wide = 0;
  for (size_t i = 0; i < spoken->count && spoken->phoneme[i].start < seconds + reach; i++) {
    const ern_phoneme *p = &spoken->phoneme[i];
    if (p->end < seconds - reach) continue;
    const bool diphthong = is_vowel(p->name[0]) && is_vowel(p->name[1]) && p->name[0] != p->name[1];
    const struct target *from = target_of(p->name[0]), *to = diphthong ? target_of(p->name[1]) : from;
    const double half = 0.5 * (p->start + p->end), first = share(p->start, half, seconds),
                 second = share(half, p->end, seconds);
    open += first * (double)from->jaw + second * (double)to->jaw;
    wide += first * (double)from->width + second * (double)to->width;
  }
  *jaw = (float)open;
  *width = (float)wide;
}
