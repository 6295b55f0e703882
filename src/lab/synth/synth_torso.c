/* SPDX-License-Identifier: MIT
 * The synthetic torso: neck, shirt and jacket, drawn once and then warped by the head's pose. */
#include "core/memory.h"
#include "lab/synth/synth_parts.h"

/* ---- the body as a distance, in the frame of the head at rest ------------------------------------ */

struct body {
  float neck, shirt, jacket;
};

/* Half the width of the jacket's opening at height y: a V from the collar down. */
static float opening(float y) { return clampf(0.40f * (y + 1.00f), 0.0f, 0.19f); }

static float neck_distance(struct vec3 p, struct vec3 m) {
  float d = capsule(p, vec3_of(0.0f, -0.32f, -0.088f), vec3_of(0.0f, -0.66f, -0.130f), 0.150f, 0.160f);
  d = join(d, capsule(m, vec3_of(0.135f, -0.30f, -0.08f), vec3_of(0.035f, -0.62f, 0.010f), 0.020f, 0.022f), 0.05f);
  d = join(d, capsule(p, vec3_of(0.0f, -0.43f, 0.052f), vec3_of(0.0f, -0.48f, 0.042f), 0.012f, 0.010f),
           0.05f); /* Adam's apple */
  return join(d, ellipsoid(p, vec3_of(0.0f, -0.80f, -0.085f), vec3_of(0.28f, 0.20f, 0.120f)), 0.06f);
}

static float trunk_distance(struct vec3 p, struct vec3 m) {
  float d = capsule(m, vec3_of(0.10f, -0.53f, -0.17f), vec3_of(0.46f, -0.74f, -0.17f), 0.100f, 0.120f);
  d = join(d, ball(m, vec3_of(0.545f, -0.83f, -0.15f), 0.135f), 0.10f);
  d = join(d, ellipsoid(p, vec3_of(0.0f, -1.10f, -0.10f), vec3_of(0.55f, 0.50f, 0.235f)), 0.14f);
  return join(d, capsule(m, vec3_of(0.60f, -0.86f, -0.15f), vec3_of(0.66f, -1.30f, -0.12f), 0.125f, 0.12f), 0.06f);
}

static struct body body_distance(struct vec3 p) {
  const struct vec3 m = vec3_of(sqrtf(p.x * p.x + 0.0004f), p.y, p.z);
  const float trunk = trunk_distance(p, m);
  struct body b = {.neck = neck_distance(p, m)};
  /* the shirt lies over the trunk, open at the throat; > 0 inside the V */
  const float throat = 0.80f * (0.062f + 0.42f * (p.y + 0.60f) - fabsf(p.x));
  b.shirt = cut(trunk - 0.014f, maxf(-throat, -p.z - 0.05f), 0.010f);
  /* its collar stands round the neck and falls outwards in two leaves, lower and longer in front */
  const float back = p.z + 0.115f, round_neck = sqrtf(p.x * p.x + 0.9f * back * back);
  const float height = p.y + 0.575f + 0.22f * back, leaf = smoothf(0.02f, 0.16f, back);
  const float radius = 0.182f - 0.10f * height + 0.10f * maxf(-0.03f - height, 0.0f);
  float collar = maxf(fabsf(round_neck - radius) - 0.010f,
                      maxf(height - 0.058f, -0.055f - leaf * (0.030f - 0.20f * (fabsf(p.x) - 0.03f)) - height));
  collar = cut(collar, maxf(-throat - 0.10f * maxf(-height, 0.0f), -p.z - 0.05f), 0.008f);
  b.shirt = minf(b.shirt, 0.9f * collar);
  if (p.z > 0.0f && p.y < -0.74f) { /* buttons */
    const float row = p.y - floorf(p.y / 0.11f + 0.5f) * 0.11f;
    b.shirt = minf(b.shirt, maxf(fabsf(trunk - 0.018f) - 0.006f, sqrtf(p.x * p.x + row * row) - 0.010f));
  }
  /* the jacket, its lapels thicker */
  const float v = fabsf(p.x) - opening(p.y);
  const float lapel = smoothf(0.130f, 0.120f, v + 0.30f * maxf(p.y + 0.80f, 0.0f)) * (p.z > -0.1f ? 1.0f : 0.0f);
  b.jacket = cut(trunk - 0.030f - 0.016f * lapel, 0.8f * v, 0.010f);
  return b;
}

static bool is_bare(struct body b) { return b.neck <= b.shirt && b.neck <= b.jacket; }

static float nearest(struct body b) { return minf(b.neck, minf(b.shirt, b.jacket)); }

/* The head at rest, approximate and slightly smaller: casts the shadow on the neck. */
static float chin_distance(struct vec3 p) {
  return minf(ellipsoid(p, vec3_of(0.0f, -0.12f, 0.05f), vec3_of(0.18f, 0.26f, 0.20f)),
              ellipsoid(p, vec3_of(0.0f, 0.10f, -0.05f), vec3_of(0.26f, 0.30f, 0.32f)));
}

static struct vec3 body_albedo(const struct ern_synth_person *person, struct body b, struct vec3 p, float *gloss) {
  const struct vec3 place = vec3_add(p, person->grain);
  *gloss = 0.02f;
  if (is_bare(b)) {
    const float blotch = ern_synth_noise_sum(vec3_scale(place, 16.0f), 3);
    *gloss = 0.08f;
    return vec3_mul(person->skin, vec3_of(0.97f + 0.08f * blotch, 0.93f + 0.13f * blotch, 0.92f + 0.13f * blotch));
  }
  if (b.shirt <= b.jacket) {
    const float stripe = smoothf(-0.2f, 0.6f, sinf(p.x * 190.0f)), weave = ern_synth_noise(vec3_scale(place, 120.0f));
    *gloss = 0.04f;
    return vec3_scale(person->shirt, 1.0f - 0.12f * stripe + 0.05f * weave);
  }
  const float bone = sinf(p.x * 330.0f + 2.2f * asinf(clampf(sinf(p.y * 150.0f), -1.0f, 1.0f)));
  const float wool = ern_synth_noise_sum(vec3_scale(place, 90.0f), 2);
  return vec3_scale(person->jacket, 1.0f + 0.28f * bone + 0.45f * wool);
}

static struct vec3 body_light(const struct ern_synth_person *person, struct vec3 p) {
  const struct vec3 key_way = ern_synth_key.way, fill_way = ern_synth_fill.way;
  const float h = 0.002f;
  const struct vec3 n = vec3_unit(
      vec3_of(nearest(body_distance(vec3_of(p.x + h, p.y, p.z))) - nearest(body_distance(vec3_of(p.x - h, p.y, p.z))),
              nearest(body_distance(vec3_of(p.x, p.y + h, p.z))) - nearest(body_distance(vec3_of(p.x, p.y - h, p.z))),
              nearest(body_distance(vec3_of(p.x, p.y, p.z + h))) - nearest(body_distance(vec3_of(p.x, p.y, p.z - h)))));
  float blocked = 0.0f, weight = 1.0f;
  for (int k = 1; k <= 5; ++k) {
    const float reach = 0.022f * (float)k * (float)(k + 1) * 0.5f;
    const struct vec3 q = vec3_along(p, reach, n);
    const float d = minf(nearest(body_distance(q)), maxf(chin_distance(q), 0.25f * reach)); /* never pitch dark */
    blocked += weight * maxf(reach - d, 0.0f) / reach;
    weight *= 0.8f;
  }
  const float open = clampf(1.0f - 0.30f * blocked, 0.15f, 1.0f);
  float lit = 1.0f;
  for (float t = 0.03f; t < 0.8f;) {
    const struct vec3 q = vec3_along(vec3_along(p, 0.008f, n), t, key_way);
    const float d = minf(nearest(body_distance(q)), chin_distance(q));
    lit = minf(lit, 0.5f + 0.5f * d / (0.22f * t));
    if (lit <= 0.0f) break;
    t += clampf(d, 0.015f, 0.1f);
  }
  lit = smoothf(0.0f, 1.0f, lit) * smoothf(0.0f, 0.3f, vec3_dot(n, key_way));
  float gloss;
  const struct vec3 albedo = body_albedo(person, body_distance(p), p, &gloss);
  struct vec3 light = vec3_scale(ern_synth_ambient(n.y), open);
  light = vec3_along(light, maxf(vec3_dot(n, key_way), 0.0f) * lit, ern_synth_key.light);
  light = vec3_along(light, maxf(vec3_dot(n, fill_way), 0.0f) * open, ern_synth_fill.light);
  const struct vec3 half = vec3_unit(vec3_add(key_way, vec3_of(0.0f, 0.0f, 1.0f)));
  const float shine = gloss * lit * powf(maxf(vec3_dot(n, half), 0.0f), 24.0f);
  return vec3_along(vec3_mul(albedo, light), shine, ern_synth_key.light);
}

/* ---- the layer ----------------------------------------------------------------------------------- */

static bool body_hit(struct vec3 origin, struct vec3 way, float *at) {
  float t = 3.0f;
  for (int k = 0; k < 96 && t < 4.6f; ++k) {
    const float d = nearest(body_distance(vec3_along(origin, t, way)));
    if (d < 0.0008f) {
      *at = t;
      return true;
    }
    t += 0.8f * d;
  }
  return false;
}

struct drawing {
  const struct ern_synth_person *person;
  struct ern_synth_camera camera;
  const struct ern_synth_layer *torso;
  double margin; /* pixels of the frames */
};

static void draw_row(void *user, size_t index, int worker) {
  const struct drawing *drawing = user;
  const struct ern_synth_layer *torso = drawing->torso;
  (void)worker;
  for (int x = 0; x < torso->width; ++x) {
    float *pixel = torso->pixels[index * (size_t)torso->width + (size_t)x];
    struct vec3 origin, way;
    float at;
    ern_synth_camera_ray(&drawing->camera, (x + 0.5) / torso->samples - drawing->margin,
                         ((double)index + 0.5) / torso->samples - drawing->margin, &origin, &way);
    if (!body_hit(origin, way, &at)) continue;
    const struct vec3 place = vec3_along(origin, at, way), light = body_light(drawing->person, place);
    torso->bare[index * (size_t)torso->width + (size_t)x] = is_bare(body_distance(place));
    pixel[0] = synth_encode(light.x);
    pixel[1] = synth_encode(light.y);
    pixel[2] = synth_encode(light.z);
    pixel[3] = 1.0f;
  }
}

ern_status ern_synth_torso_make(ern_context *context, struct ern_pool *pool, const struct ern_synth_person *person,
                                int size, struct ern_synth_layer *torso) {
  const int samples = size <= 256 ? 3 : 2;
  const int side = size * samples * 3 / 2;
  *torso = (struct ern_synth_layer){.width = side, .height = side, .samples = samples};
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(context, (size_t)side * (size_t)side, &torso->pixels));
  ERN_TRY(ERN_NEW(context, (size_t)side * (size_t)side, &torso->bare));
  struct drawing drawing = {.person = person, .torso = torso, .margin = 0.25 * size};
  ern_synth_camera_make(size, &(struct ern_synth_curve){0}, &drawing.camera);
  ern_pool_run(pool, (size_t)side, draw_row, &drawing);
fail:
  return status;
}

void ern_synth_torso_free(ern_context *context, struct ern_synth_layer *torso) {
  ern_release(context, torso->pixels);
  ern_release(context, torso->bare);
  *torso = (struct ern_synth_layer){0};
}

/* Adds `weight` times the layer at (x, y), in layer pixels, bilinear; outside it adds nothing. */
static void layer_add(const struct ern_synth_layer *layer, float x, float y, float weight, float pixel[4]) {
  const float fx = floorf(x - 0.5f), fy = floorf(y - 0.5f), tx = x - 0.5f - fx, ty = y - 0.5f - fy;
  const int left = (int)fx, top = (int)fy;
  if (left < 0 || top < 0 || left + 1 >= layer->width || top + 1 >= layer->height) return;
  const float(*row)[4] = (const float(*)[4])layer->pixels + (size_t)top * (size_t)layer->width + (size_t)left;
  const float(*next)[4] = row + layer->width;
  for (int c = 0; c < 4; ++c)
    pixel[c] += weight * mixf(mixf(row[0][c], row[1][c], tx), mixf(next[0][c], next[1][c], tx), ty);
}

/* Whether the layer's nearest pixel is bare skin. */
static bool layer_bare(const struct ern_synth_layer *layer, float x, float y) {
  const int column = (int)floorf(x), row = (int)floorf(y);
  if (column < 0 || row < 0 || column >= layer->width || row >= layer->height) return false;
  return layer->bare[(size_t)row * (size_t)layer->width + (size_t)column];
}

void ern_synth_torso_draw(const struct ern_synth_layer *torso, const struct ern_synth_curve *curve, int size,
                          float (*pixels)[4], float *bare) {
  /* All in sides of the picture. A shift of the head by 1 unit is 2.4/3.6 of the side; the shoulders go 0.45 of its
   * way, lean with the roll and turn a little under the yaw; the top of the neck goes with the head. */
  const float way_x = 0.667f * curve->shift[0], way_y = -0.667f * curve->shift[1];
  const float lean = -0.0030f * curve->roll, turn = 0.0007f * curve->yaw, dip = -0.0009f * curve->pitch;
  const float grow = 1.0f + 0.10f * curve->shift[2];
  const int samples = torso->samples;
  const float step = 1.0f / (float)samples, weight = step * step;
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      const size_t at = (size_t)y * (size_t)size + (size_t)x;
      float *pixel = pixels[at];
      for (int c = 0; c < 4; ++c) pixel[c] = 0.0f;
      bare[at] = 0.0f;
      for (int k = 0; k < samples * samples; ++k) {
        float u = ((float)x + ((float)(k % samples) + 0.5f) * step) / (float)size;
        float v = ((float)y + ((float)(k / samples) + 0.5f) * step) / (float)size;
        ern_synth_camera_rest(curve, &u, &v);
        const float up = smoothf(0.86f, 0.66f, v); /* 0 at the shoulders .. 1 under the chin */
        const float follow = mixf(0.45f, 1.0f, up);
        const float from_x = 0.5f + (u - 0.5f - follow * way_x - turn * (1.0f - up)) / grow - lean * (v - 0.95f);
        const float from_y = 0.95f + (v - 0.95f - follow * way_y - dip * up) / grow + 0.4f * lean * (u - 0.5f);
        const float column = (from_x + 0.25f) * (float)(size * samples),
                    row = (from_y + 0.25f) * (float)(size * samples);
        layer_add(torso, column, row, weight, pixel);
        if (layer_bare(torso, column, row)) bare[at] += weight;
      }
    }
}
