/* SPDX-License-Identifier: MIT
 * Noise of the made-up clip, and the person that a seed stands for. */
#include "media/synth.h"

static uint32_t lattice_hash(int32_t x, int32_t y, int32_t z) {
  uint32_t h = (uint32_t)x * 0x8da6b343u ^ (uint32_t)y * 0xd8163841u ^ (uint32_t)z * 0xcb1ab31fu;
  h = (h ^ (h >> 15)) * 0x2c1b3c6du;
  h = (h ^ (h >> 12)) * 0x297a2d39u;
  return h ^ (h >> 15);
}

static float lattice_value(int32_t x, int32_t y, int32_t z) {
  return (float)(lattice_hash(x, y, z) >> 8) * (2.0f / 16777216.0f) - 1.0f;
}

float ern_synth_noise(struct vec3 p) {
  const float fx = floorf(p.x), fy = floorf(p.y), fz = floorf(p.z);
  const int32_t x = (int32_t)fx, y = (int32_t)fy, z = (int32_t)fz;
  const float tx = p.x - fx, ty = p.y - fy, tz = p.z - fz;
  const float u = tx * tx * (3.0f - 2.0f * tx), v = ty * ty * (3.0f - 2.0f * ty), w = tz * tz * (3.0f - 2.0f * tz);
  float plane[2];
  for (int k = 0; k < 2; ++k) {
    const float a = mixf(lattice_value(x, y, z + k), lattice_value(x + 1, y, z + k), u);
    const float b = mixf(lattice_value(x, y + 1, z + k), lattice_value(x + 1, y + 1, z + k), u);
    plane[k] = mixf(a, b, v);
  }
  return mixf(plane[0], plane[1], w);
}

float ern_synth_noise_sum(struct vec3 p, int octaves) {
  float sum = 0.0f, strength = 0.5f;
  for (int k = 0; k < octaves; ++k) {
    sum += strength * ern_synth_noise(p);
    p = vec3_along(vec3_of(17.3f, 5.1f, 9.7f), 2.03f, p);
    strength *= 0.5f;
  }
  return sum;
}

enum { STREAM_PERSON = 11 };

static float draw(uint64_t seed, uint64_t which, double low, double high) {
  return (float)synth_uniform(seed, STREAM_PERSON, which, low, high);
}

void ern_synth_person_make(uint64_t seed, struct ern_synth_person *person) {
  static const struct vec3 skins[] = {{0.70f, 0.42f, 0.31f}, {0.62f, 0.36f, 0.25f}, {0.50f, 0.28f, 0.18f},
                                      {0.33f, 0.17f, 0.105f}, {0.19f, 0.095f, 0.06f}};
  static const struct vec3 hairs[] = {{0.020f, 0.013f, 0.010f}, {0.060f, 0.030f, 0.016f}, {0.13f, 0.062f, 0.026f},
                                      {0.28f, 0.16f, 0.065f}, {0.11f, 0.105f, 0.10f}};
  static const struct vec3 irises[] = {{0.10f, 0.045f, 0.018f}, {0.10f, 0.20f, 0.33f}, {0.10f, 0.18f, 0.09f},
                                       {0.20f, 0.12f, 0.045f}, {0.16f, 0.20f, 0.22f}};
  static const struct vec3 shirts[] = {{0.80f, 0.82f, 0.85f}, {0.32f, 0.48f, 0.72f}, {0.72f, 0.66f, 0.55f},
                                       {0.55f, 0.22f, 0.20f}};
  static const struct vec3 jackets[] = {{0.030f, 0.042f, 0.085f}, {0.085f, 0.080f, 0.078f}, {0.050f, 0.080f, 0.060f},
                                        {0.13f, 0.060f, 0.048f}};
  static const struct vec3 walls[] = {{0.30f, 0.36f, 0.40f}, {0.42f, 0.36f, 0.28f}, {0.26f, 0.34f, 0.29f},
                                      {0.36f, 0.31f, 0.38f}};
  /* seed 1 and its kin differ in everything; the tables are walked by separate digits of the hash */
  const uint64_t pick = synth_hash(seed, STREAM_PERSON, 0);
  person->skin = skins[pick % 5];
  person->hair = hairs[(pick / 5) % 5];
  person->iris = irises[(pick / 25) % 5];
  person->shirt = shirts[(pick / 125) % 4];
  person->jacket = jackets[(pick / 500) % 4];
  person->wall = walls[(pick / 2000) % 4];
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
