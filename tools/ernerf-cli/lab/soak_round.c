/* SPDX-License-Identifier: MIT */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "lab/soak.h"

/* ---- random --------------------------------------------------------------------------------------------------------
 */

/* splitmix64 (Steele, Lea, Flood 2014). */
static uint64_t next(struct soak_random *random) {
  uint64_t z = random->state += 0x9E3779B97F4A7C15u;
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
  return z ^ (z >> 31);
}

struct soak_random soak_random_of(uint64_t seed, uint64_t round) {
  struct soak_random random = {seed};
  random.state = next(&random) + round;
  return random;
}

uint64_t soak_below(struct soak_random *random, uint64_t most) { return next(random) % most; }

double soak_between(struct soak_random *random, double low, double high) {
  return low + (high - low) * (double)(next(random) >> 11) * 0x1p-53;
}

/* Log-uniform between low and high. */
static double magnitude(struct soak_random *random, double low, double high) {
  return exp(soak_between(random, log(low), log(high)));
}

static bool random_bool(struct soak_random *random) { return soak_below(random, 2) == 0; }

/* ---- rounds ------------------------------------------------------------------------------------------------------ */

static void choose_head(struct soak_random *random, struct soak_round *round) {
  ern_train_config *config = &round->config;
  config->backbone = random_bool(random) ? ERN_BACKBONE_TRIHASH : (ern_backbone)soak_below(random, 4);
  config->attention = random_bool(random) ? ERN_ATTENTION_CHANNEL : (ern_attention)soak_below(random, 3);
  config->eye_attention =
      round->eye && soak_below(random, 4) == 0 ? ERN_EYE_ATTENTION_CONCAT : ERN_EYE_ATTENTION_SIGMOID;
  const bool hashed = config->backbone == ERN_BACKBONE_TRIHASH || config->backbone == ERN_BACKBONE_HASH3D;
  if (hashed) config->levels = 2 + (int)soak_below(random, 15);
  config->no_view = soak_below(random, 3) == 0;
  if (soak_below(random, 3) == 0) config->codes = 0;
  config->bound = (float)magnitude(random, 0.3, 4);
  config->head_random_background = random_bool(random);
}

/* Chooses the number of steps and the interval of occupancy refreshes over all cells. A refresh costs as much as a
 * hundred steps of few rays; for the backbone `mlp`, with 1 MFLOP for each of 2 million cells, as thousands of steps.
 * So there are at most 20 refreshes, with `mlp` one. */
static void choose_length(struct soak_random *random, struct soak_round *round) {
  const bool slow = !round->config.torso && round->config.backbone == ERN_BACKBONE_MLP;
  const double every = magnitude(random, 16, 1024), longest = 20 * every;
  round->config.refresh_every = (uint64_t)(slow ? 64 * every : every);
  round->steps = (uint64_t)magnitude(random, 20, slow ? 200 : longest < 5000 ? longest : 5000);
  round->resume_at = random_bool(random) ? 1 + soak_below(random, round->steps - 2) : 0;
  round->config.iters = round->steps;
}

void soak_choose(struct soak_round *round, uint64_t seed, uint64_t number, const ern_dataset *clip,
                 const ern_model *head) {
  static const int steps_a_ray[] = {1, 2, 16, 16, 64, 256};
  struct soak_random random = soak_random_of(seed, number);
  ern_train_config *config = &round->config;
  *round = (struct soak_round){.number = number, .config = ern_train_config_default()};
  round->eye = clip->has_eye && !random_bool(&random);
  round->layer = clip->has_torso && random_bool(&random);
  round->loud = soak_below(&random, 3) == 0 ? 0 : (float)magnitude(&random, 1e-6, 1e4);
  round->near = random_bool(&random) ? 1 : (float)magnitude(&random, 0.1, 8);
  round->turn = random_bool(&random) ? 0 : (float)soak_between(&random, -180, 180);
  round->lids = (enum soak_lids)soak_below(&random, SOAK_LIDS);
  round->pixels = random_bool(&random) ? SOAK_PIXELS_AS_THEY_ARE : (enum soak_pixels)soak_below(&random, SOAK_PIXELS);
  config->seed = soak_below(&random, UINT32_MAX);
  config->rays = (int)magnitude(&random, 1, 300);
  config->lr *= (float)magnitude(&random, 0.1, 100);
  config->lr_net *= (float)magnitude(&random, 0.1, 100);
  config->lr_att *= (float)magnitude(&random, 0.1, 100);
  config->max_steps = steps_a_ray[soak_below(&random, sizeof steps_a_ray / sizeof *steps_a_ray)];
  config->dt_gamma = random_bool(&random) ? config->dt_gamma : (float)soak_between(&random, 0, 1);
  config->audio_pad = random_bool(&random) ? ERN_AUDIO_PAD_EDGE : ERN_AUDIO_PAD_ZERO;
  config->ema_every = 1 + soak_below(&random, 50);
  config->torso = head != NULL;
  config->head = head;
  if (head != NULL) {
    ern_model_info about;
    ern_model_describe(head, &about);
    config->max_steps = about.max_steps; /* a torso has the head's value */
    config->dt_gamma = about.dt_gamma;
    config->audio_pad = about.audio_pad;
    config->torso_gamma = random_bool(&random);
    config->torso_random_background = random_bool(&random);
    config->torso_shrink = (float)magnitude(&random, 0.01, 1);
  } else {
    choose_head(&random, round);
  }
  choose_length(&random, round);
}

void soak_words(const struct soak_round *round, char *text, size_t capacity) {
  static const char *const lids[] = {"as they are", "open", "closed", "fluttering"};
  static const char *const pixels[] = {"as they are", "black", "white", "noise"};
  const ern_train_config *c = &round->config;
  char head[160] = "";
  if (!c->torso)
    snprintf(head, sizeof head, "%s, %s attention, eyes %s, %d levels, view %s, codes %s, bound %.3g, ",
             ern_backbone_name(c->backbone), ern_attention_name(c->attention),
             round->eye ? ern_eye_attention_name(c->eye_attention) : "none", c->levels, c->no_view ? "no" : "yes",
             c->codes == 0 ? "no" : "yes", (double)c->bound);
  else
    snprintf(head, sizeof head, "torso, gamma %s, over %s, shrink %.3g, ", c->torso_gamma ? "yes" : "no",
             c->torso_random_background ? "random colours" : "the background", (double)c->torso_shrink);
  snprintf(text, capacity,
           "%s%d rays, %d samples a ray, dt_gamma %.3g, lr %.3g, lr_net %.3g, lr_att %.3g, speech times %.3g, distance "
           "times %.3g, turned by %.3g, lids %s, pixels %s, %s, %" PRIu64 " steps, average every %" PRIu64
           ", occupancy every %" PRIu64 ", resumed after %" PRIu64 ", seed %" PRIu64,
           head, c->rays, c->max_steps, (double)c->dt_gamma, (double)c->lr, (double)c->lr_net, (double)c->lr_att,
           (double)round->loud, (double)round->near, (double)round->turn, lids[round->lids], pixels[round->pixels],
           round->layer ? "torso layer" : "no torso layer", round->steps, c->ema_every, c->refresh_every,
           round->resume_at, c->seed);
}

/* ---- data -------------------------------------------------------------------------------------------------------- */

static ern_status bent_frame(void *user, int split, size_t index, ern_dataset_frame *frame) {
  const struct soak_data *data = user;
  const ern_status status = data->clip.frame(data->clip.user, split, index, frame);
  if (status != ERN_OK) return status;
  const float eyes[SOAK_LIDS] = {frame->eye, 0, 1, (float)(index % 2)};
  frame->eye = eyes[data->round->lids];
  ern_pose_turn(frame->matrix, (double)data->round->turn, 0);
  for (int row = 0; row < 3; row++) frame->matrix[4 * row + 3] *= data->round->near;
  return ERN_OK;
}

static ern_status bent_pixels(void *user, int split, size_t index, const uint8_t **truth, const uint8_t **torso) {
  const struct soak_data *data = user;
  const ern_status status = data->clip.pixels(data->clip.user, split, index, truth, torso);
  if (status == ERN_OK && data->truth != NULL) *truth = data->truth;
  return status;
}

static ern_status bent_head(void *user, int split, size_t index, const uint8_t **head) {
  const struct soak_data *data = user;
  return data->clip.head(data->clip.user, split, index, head);
}

static void paint(uint8_t *truth, size_t bytes, const struct soak_round *round) {
  struct soak_random random = {round->config.seed};
  if (round->pixels != SOAK_PIXELS_NOISE) memset(truth, round->pixels == SOAK_PIXELS_WHITE ? 255 : 0, bytes);
  for (size_t i = 0; i < bytes && round->pixels == SOAK_PIXELS_NOISE; i++) truth[i] = (uint8_t)soak_below(&random, 256);
}

void soak_modify(struct soak_data *data, const ern_dataset *clip, const struct soak_round *round,
                 const struct soak_buffers *buffers) {
  const ern_features *from = clip->features;
  const size_t count = from->windows * (size_t)from->window_length * (size_t)from->width;
  *data = (struct soak_data){.clip = *clip, .bent = *clip, .round = round, .features = *from};
  data->features.data = buffers->speech;
  for (size_t i = 0; i < count; i++) buffers->speech[i] = from->data[i] * round->loud;
  if (round->pixels != SOAK_PIXELS_AS_THEY_ARE) {
    paint(buffers->truth, 3 * (size_t)clip->width * (size_t)clip->height, round);
    data->truth = buffers->truth;
  }
  data->bent.user = data;
  data->bent.features = &data->features;
  data->bent.frame = bent_frame;
  data->bent.pixels = bent_pixels;
  if (clip->head != NULL) data->bent.head = bent_head;
  data->bent.has_eye = round->eye;
  if (!round->config.torso) data->bent.has_torso = round->layer;
}
