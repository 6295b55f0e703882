/* SPDX-License-Identifier: MIT
 * Procedural noise of the synthetic clip: skin, hair and cloth. */
#include "lab/synth/synth_parts.h"

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
