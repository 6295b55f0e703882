/* SPDX-License-Identifier: MIT
 * Renders the synthetic head by sphere tracing of its distance function. */
#include "lab/synth/synth_parts.h"

/* Finds the first surface on the ray. Steps are shorter than the distance, because the deformation stretches space. */
static bool head_hit(const struct ern_synth_head *head, struct vec3 origin, struct vec3 way, float *at) {
  const struct vec3 r = ern_synth_head_radii, o = vec3_sub(origin, ern_synth_head_middle);
  const struct vec3 a = vec3_of(o.x / r.x, o.y / r.y, o.z / r.z), b = vec3_of(way.x / r.x, way.y / r.y, way.z / r.z);
  const float bb = vec3_dot(b, b), ab = vec3_dot(a, b), inside = ab * ab - bb * (vec3_dot(a, a) - 1.0f);
  if (inside < 0.0f) return false;
  const float root = sqrtf(inside), leave = (root - ab) / bb;
  float t = (-root - ab) / bb;
  for (int k = 0; k < 100 && t < leave; ++k) {
    const float d = ern_synth_head_distance(head, vec3_along(origin, t, way), NULL);
    if (d < 0.0006f) {
      *at = t;
      return true;
    }
    t += 0.75f * d;
  }
  return false;
}

/* Sample positions in a pixel: 4 rooks, no two in one row or column. */
enum { PLACES = 4 };
static const double places[PLACES][2] = {{0.375, 0.125}, {0.875, 0.375}, {0.125, 0.625}, {0.625, 0.875}};

void ern_synth_head_draw(const struct ern_synth_head *head, const struct ern_synth_camera *camera, int size,
                         float (*pixels)[4]) {
  const float weight = 1.0f / PLACES;
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      float *pixel = pixels[(size_t)y * (size_t)size + (size_t)x];
      for (int c = 0; c < 4; ++c) pixel[c] = 0.0f;
      for (int k = 0; k < PLACES; ++k) {
        struct vec3 origin, way;
        float at;
        ern_synth_camera_ray(camera, x + places[k][0], y + places[k][1], &origin, &way);
        if (!head_hit(head, origin, way, &at)) continue;
        const struct vec3 light = ern_synth_head_shade(head, vec3_along(origin, at, way), vec3_scale(way, -1.0f));
        pixel[0] += weight * synth_encode(light.x);
        pixel[1] += weight * synth_encode(light.y);
        pixel[2] += weight * synth_encode(light.z);
        pixel[3] += weight;
      }
    }
}
