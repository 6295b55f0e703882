/* SPDX-License-Identifier: MIT */
#include "io/speech_share.h"

#include <math.h>

enum {
  BLOCKS_A_SECOND = 50,
  LOUD = 10,     /* blocks of a loud stretch */
  LEVELS = 144,  /* decibels of a block's sum of squares */
  OVER_NOISE = 6 /* of them, by which speech is louder than the quietest tenth of the blocks */
};

/* Samples of a block, those of all channels. */
static size_t block_of(const ern_sound *sound) {
  const size_t frames = (size_t)(sound->rate / BLOCKS_A_SECOND);
  return (frames > 0 ? frames : 1) * (size_t)sound->channels;
}

/* Sum of squares of a block. */
static double energy_of(const ern_sound *sound, size_t block) {
  const size_t samples = block_of(sound);
  double sum = 0;
  for (size_t i = block * samples; i < (block + 1) * samples; i++) sum += (double)sound->data[i] * sound->data[i];
  return sum;
}

static int decibels_of(double energy) { return (int)fmin(10 * log10(energy + 1), LEVELS - 1); }

double ern_speech_share(const ern_sound *sound) {
  const size_t blocks = sound->frames * (size_t)sound->channels / block_of(sound);
  double loudest = 0, stretch = 0;
  size_t spoken = 0, quieter = 0, levels[LEVELS] = {0};
  int quiet = 0; /* decibels that a tenth of the blocks have at most */
  for (size_t b = 0; b < blocks; b++) {
    stretch += energy_of(sound, b) - (b >= LOUD ? energy_of(sound, b - LOUD) : 0);
    loudest = fmax(loudest, stretch / LOUD);
    levels[decibels_of(energy_of(sound, b))]++;
  }
  while (10 * (quieter + levels[quiet]) < blocks) quieter += levels[quiet++];
  for (size_t b = 0; b < blocks; b++) {
    const double energy = energy_of(sound, b);
    spoken += energy > 1e-3 * loudest && decibels_of(energy) >= quiet + OVER_NOISE;
  }
  return blocks > 0 ? (double)spoken / (double)blocks : 0;
}
