/* SPDX-License-Identifier: MIT
 * The stress-test settings of `ernerf soak`: random extremes, a function of the seed and the number of the round; and
 * their description as text. */
#ifndef ERN_CLI_SOAK_H
#define ERN_CLI_SOAK_H

#include "ernerf/media.h"
#include "ernerf/train.h"

/* Random numbers, a function of seed, round and counter: the same on every machine. */
struct soak_random {
  uint64_t state;
};
struct soak_random soak_random_of(uint64_t seed, uint64_t round);
uint64_t soak_below(struct soak_random *random, uint64_t most); /* 0 .. most - 1 */
double soak_between(struct soak_random *random, double low, double high);

enum soak_pixels { SOAK_PIXELS_AS_THEY_ARE, SOAK_PIXELS_BLACK, SOAK_PIXELS_WHITE, SOAK_PIXELS_NOISE, SOAK_PIXELS };
enum soak_lids { SOAK_LIDS_AS_THEY_ARE, SOAK_LIDS_OPEN, SOAK_LIDS_CLOSED, SOAK_LIDS_FLUTTER, SOAK_LIDS };

/* The settings of one round. */
struct soak_round {
  uint64_t number, steps;
  ern_train_config config;
  bool eye, layer;        /* the head blinks; a torso layer lies behind it */
  float loud, near, turn; /* factors of the features and of the camera's distance; rotation of the head, degrees */
  enum soak_lids lids;
  enum soak_pixels pixels;
  uint64_t resume_at; /* step after which the trainer is saved, freed and resumed; 0: never */
};

/* Chooses a round for the clip's data: a torso below `head`; NULL: a head. */
void soak_choose(struct soak_round *round, uint64_t seed, uint64_t number, const ern_dataset *clip,
                 const ern_model *head);
/* "rays 3, lr 0.41, ..." */
void soak_words(const struct soak_round *round, char *text, size_t capacity);

/* Buffers for data that a round substitutes for the clip's. */
struct soak_buffers {
  float *speech;  /* the features */
  uint8_t *truth; /* [height][width][3] */
};

/* The clip's data as modified by a round. */
struct soak_data {
  ern_dataset clip, bent;
  const struct soak_round *round;
  ern_features features;
  const uint8_t *truth; /* of all frames; NULL: each frame's own */
};
void soak_modify(struct soak_data *data, const ern_dataset *clip, const struct soak_round *round,
                 const struct soak_buffers *buffers);

#endif
