/* SPDX-License-Identifier: MIT
 * The person of the synthetic clip, by the seed: colours, proportions, voice. */
#include "lab/synth/synth_parts.h"

enum { STREAM_PERSON = 11 };

static float draw(uint64_t seed, uint64_t which, double low, double high) {
  return (float)synth_uniform(seed, STREAM_PERSON, which, low, high);
}

void ern_synth_person_make(uint64_t seed, struct ern_synth_person *person) {
  static const struct vec3 skins[] = {{0.70f, 0.42f, 0.31f},
                                      {0.62f, 0.36f, 0.25f},
                                      {0.50f, 0.28f, 0.18f},
                                      {0.33f, 0.17f, 0.105f},
                                      {0.19f, 0.095f, 0.06f}};
  static const struct vec3 hairs[] = {{0.020f, 0.013f, 0.010f},
                                      {0.060f, 0.030f, 0.016f},
                                      {0.13f, 0.062f, 0.026f},
                                      {0.28f, 0.16f, 0.065f},
                                      {0.11f, 0.105f, 0.10f}};
  static const struct vec3 irises[] = {{0.10f, 0.045f, 0.018f},
                                       {0.10f, 0.20f, 0.33f},
                                       {0.10f, 0.18f, 0.09f},
                                       {0.20f, 0.12f, 0.045f},
                                       {0.16f, 0.20f, 0.22f}};
  static const struct vec3 shirts[] = {
      {0.62f, 0.64f, 0.68f}, {0.24f, 0.36f, 0.58f}, {0.58f, 0.53f, 0.43f}, {0.42f, 0.17f, 0.16f}};
  static const struct vec3 jackets[] = {
      {0.030f, 0.042f, 0.085f}, {0.085f, 0.080f, 0.078f}, {0.050f, 0.080f, 0.060f}, {0.13f, 0.060f, 0.048f}};
  static const struct vec3 walls[] = {
      {0.30f, 0.36f, 0.40f}, {0.42f, 0.36f, 0.28f}, {0.26f, 0.34f, 0.29f}, {0.36f, 0.31f, 0.38f}};
  /* neighbouring seeds differ in everything: separate digits of the hash index the tables */
  const uint64_t choice = synth_hash(seed, STREAM_PERSON, 0);
  person->skin = skins[choice % 5];
  person->hair = hairs[(choice / 5) % 5];
  person->iris = irises[(choice / 25) % 5];
  person->shirt = shirts[(choice / 125) % 4];
  person->jacket = jackets[(choice / 500) % 4];
  person->wall = walls[(choice / 2000) % 4];
  person->lamp = vec3_of(1.0f, draw(seed, 1, 0.70, 0.85), draw(seed, 2, 0.40, 0.60));
  person->lip = vec3_mix(vec3_mul(person->skin, vec3_of(0.92f, 0.55f, 0.58f)), vec3_of(0.42f, 0.09f, 0.09f), 0.35f);
  person->face_width = draw(seed, 3, 0.96, 1.04);
  person->jaw_width = draw(seed, 4, 0.90, 1.05);
  person->nose_width = draw(seed, 5, 0.88, 1.12);
  person->nose_length = draw(seed, 6, 0.94, 1.06);
  person->lip_fullness = draw(seed, 7, 0.85, 1.15);
  person->eye_size = draw(seed, 8, 0.95, 1.06);
  person->brow_weight = draw(seed, 9, 0.8, 1.2);
  person->freckles = draw(seed, 10, 0.0, 1.0);
  person->hair_volume = draw(seed, 11, 0.0, 0.02);
  person->part_side = (synth_hash(seed, STREAM_PERSON, 12) & 1) != 0 ? 1.0f : -1.0f;
  person->voice = draw(seed, 13, 95.0, 205.0);
  person->grain = vec3_of(draw(seed, 14, 0.0, 200.0), draw(seed, 15, 0.0, 200.0), draw(seed, 16, 0.0, 200.0));
}
