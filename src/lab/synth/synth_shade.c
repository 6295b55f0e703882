/* SPDX-License-Identifier: MIT
 * Colour and lighting of the synthetic head. The light is fixed to the head and hardly depends on the view direction,
 * so that a radiance field can learn the picture. */
#include "lab/synth/synth_parts.h"

const struct ern_synth_lamp ern_synth_key = {{-0.470f, 0.540f, 0.698f}, {1.18f, 1.10f, 1.00f}};
const struct ern_synth_lamp ern_synth_fill = {{0.800f, 0.150f, 0.581f}, {0.34f, 0.40f, 0.50f}};
static const struct ern_synth_lamp rim = {{0.640f, 0.420f, -0.643f}, {0.385f, 0.42f, 0.49f}};
static const struct vec3 sky = {0.50f, 0.54f, 0.60f}, ground = {0.30f, 0.24f, 0.20f};

struct vec3 ern_synth_ambient(float up) {
  return vec3_mix(ground, sky, 0.5f + 0.5f * up);
}

struct paint {
  struct vec3 albedo;
  float gloss; /* strength of the highlight */
  float tight; /* its exponent */
  float soft;  /* wrap lighting: how far light extends into the shade, 0..1 */
  float dark;  /* 0..1: share of outside light that reaches the place */
};

static struct vec3 normal_at(const struct ern_synth_head *head, struct vec3 p, float h) {
  static const float corner[4][3] = {{1, -1, -1}, {-1, -1, 1}, {-1, 1, -1}, {1, 1, 1}};
  struct vec3 n = {0.0f, 0.0f, 0.0f};
  for (int k = 0; k < 4; ++k) {
    const struct vec3 way = vec3_of(corner[k][0], corner[k][1], corner[k][2]);
    n = vec3_along(n, ern_synth_head_distance(head, vec3_along(p, h, way), NULL), way);
  }
  return vec3_unit(n);
}

/* Ambient occlusion: open share of the sky, from a few distances along the normal. */
static float openness(const struct ern_synth_head *head, struct vec3 p, struct vec3 n) {
  float blocked = 0.0f, weight = 1.0f;
  for (int k = 1; k <= 4; ++k) {
    const float reach = 0.018f * (float)k * (0.6f + 0.4f * (float)k * 0.6f);
    const float d = ern_synth_head_distance(head, vec3_along(p, reach, n), NULL);
    blocked += weight * maxf(reach - d, 0.0f) / reach;
    weight *= 0.75f;
  }
  return clampf(1.0f - 0.40f * blocked, 0.12f, 1.0f);
}

/* 0 in the full shadow of the head itself .. 1, with a soft rim. */
static float shadow(const struct ern_synth_head *head, struct vec3 p, struct vec3 n, struct vec3 way) {
  const float facing = vec3_dot(n, way);
  if (facing <= 0.0f) return 0.0f;
  float light = 1.0f, t = 0.014f;
  for (int k = 0; k < 14 && t < 0.40f; ++k) {
    const struct vec3 at = vec3_along(vec3_along(p, 0.006f, n), t, way);
    if (ellipsoid(at, ern_synth_head_middle, ern_synth_head_radii) > 0.0f) break;
    const float d = ern_synth_head_distance(head, at, NULL);
    light = minf(light, 0.5f + 0.5f * d / (0.22f * t));
    if (light <= 0.0f) break;
    t += clampf(d, 0.012f, 0.08f);
  }
  light = clampf(light, 0.0f, 1.0f);
  return light * light * (3.0f - 2.0f * light) * smoothf(0.0f, 0.30f, facing);
}

/* ---- paint --------------------------------------------------------------------------------------- */

float ern_synth_brow_line(float x) {
  const float t = (x - 0.042f) / (0.190f - 0.042f);
  return 0.066f + 0.030f * sinf(clampf(t, 0.0f, 1.0f) * 2.2f) - 0.012f * t;
}

/* How much of the brow's hair covers the skin at (x >= 0, y). */
static float brow_cover(const struct ern_synth_person *person, struct vec3 q) {
  const float x = fabsf(q.x), t = (x - 0.042f) / (0.190f - 0.042f);
  if (t < -0.1f || t > 1.1f || q.z < 0.0f) return 0.0f;
  const float line = ern_synth_brow_line(x);
  const float half = person->brow_weight * mixf(0.0185f, 0.0070f, clampf(t, 0.0f, 1.0f));
  const float hairs =
      ern_synth_noise(vec3_add(vec3_of(q.x * 150.0f + (q.y - line) * 130.0f, q.y * 60.0f, 3.0f), person->grain));
  const float edge = smoothf(1.25f, 0.45f, fabsf(q.y - line) / half + 0.30f * hairs);
  return edge * smoothf(-0.06f, 0.08f, t) * smoothf(1.06f, 0.85f, t) * (0.82f + 0.18f * hairs);
}

/* Round spots, one at most in a cell of the unit lattice: 0 beside, 1 in one. */
static float spots(struct vec3 p) {
  const struct vec3 cell = vec3_of(floorf(p.x), floorf(p.y), floorf(p.z));
  const uint64_t h = synth_hash((uint64_t)(int64_t)cell.x, (uint64_t)(int64_t)cell.y, (uint64_t)(int64_t)cell.z);
  if ((h & 3) != 0) return 0.0f;
  const struct vec3 off =
      vec3_of((float)(h >> 8 & 255) / 255.0f, (float)(h >> 16 & 255) / 255.0f, (float)(h >> 24 & 255) / 255.0f);
  const struct vec3 centre = vec3_along(vec3_add(cell, vec3_of(0.32f, 0.32f, 0.32f)), 0.36f, off);
  const float radius = 0.14f + 0.18f * (float)(h >> 32 & 255) / 255.0f;
  return smoothf(radius, 0.5f * radius, vec3_length(vec3_sub(p, centre)));
}

static void paint_lips(const struct ern_synth_person *person, const struct ern_synth_surface *s, struct paint *paint) {
  const struct vec3 q = s->rest;
  const float t = fabsf(q.x) / ERN_SYNTH_MOUTH_HALF;
  const float high = ern_synth_lip_height(person, q.x, ERN_SYNTH_LIP_UPPER);
  const float low = ern_synth_lip_height(person, q.x, ERN_SYNTH_LIP_LOWER);
  const float over = s->lip >= 0.0f ? s->lip - high : -s->lip - low; /* past the edge of the red */
  const float inside = smoothf(0.004f, -0.004f, over) * (t < 1.0f ? 1.0f : 0.0f);
  const float crease = ern_synth_noise(vec3_of(q.x * 130.0f + person->grain.x, s->lip * 25.0f, 7.0f));
  const struct vec3 red = vec3_scale(person->lip, (1.0f + 0.16f * crease) * (s->lip >= 0.0f ? 0.80f : 1.0f));
  paint->albedo = vec3_mix(paint->albedo, red, inside);
  paint->gloss = mixf(paint->gloss, 0.32f, inside);
  paint->tight = mixf(paint->tight, 30.0f, inside);
  const float line = hump(s->lip, 0.0030f) * smoothf(1.08f, 0.92f, t); /* where the lips meet */
  paint->albedo = vec3_scale(paint->albedo, 1.0f - 0.85f * line);
  paint->gloss *= 1.0f - line;
}

static void paint_skin(const struct ern_synth_person *person, const struct ern_synth_surface *s, struct paint *paint) {
  const struct vec3 q = s->rest, place = vec3_add(q, person->grain);
  const float x = fabsf(q.x);
  struct vec3 c = person->skin;
  /* blotches, pores, freckles */
  const float blotch = ern_synth_noise_sum(vec3_scale(place, 16.0f), 3);
  const float pore = ern_synth_noise(vec3_scale(place, 150.0f));
  c = vec3_mul(c, vec3_of(1.0f + 0.10f * blotch + 0.05f * pore, 1.0f + 0.16f * blotch + 0.07f * pore,
                          1.0f + 0.16f * blotch + 0.07f * pore));
  const float spot = spots(vec3_scale(place, 48.0f));
  const float where = hump(q.y + 0.08f, 0.09f) * smoothf(0.10f, 0.22f, q.z);
  c = vec3_mul(c, vec3_mix(vec3_of(1, 1, 1), vec3_of(0.78f, 0.62f, 0.52f), 0.75f * person->freckles * spot * where));
  /* blood under the skin: cheeks, nose, ears, round the eyes */
  const float blush = 0.55f * hump(x - 0.145f, 0.07f) * hump(q.y + 0.10f, 0.07f) +
                      0.50f * hump(q.x, 0.05f) * hump(q.y + 0.12f, 0.05f) * smoothf(0.25f, 0.35f, q.z) +
                      0.6f * smoothf(0.25f, 0.29f, x) + 0.3f * hump(q.x, 0.06f) * hump(q.y + 0.39f, 0.05f);
  c = vec3_mul(c, vec3_mix(vec3_of(1, 1, 1), vec3_of(1.02f, 0.76f, 0.74f), clampf(blush, 0.0f, 1.0f)));
  const float socket = hump(x - 0.120f, 0.06f) * hump(q.y, 0.04f) * smoothf(0.1f, 0.2f, q.z);
  c = vec3_mul(c, vec3_mix(vec3_of(1, 1, 1), vec3_of(0.82f, 0.70f, 0.68f), 0.6f * socket));
  paint->gloss = 0.10f + 0.10f * hump(q.x, 0.05f);
  paint->tight = 14.0f;
  paint->soft = 0.35f;
  /* the hairline: skin between the first hairs */
  const float roots =
      smoothf(0.040f, 0.0f, ern_synth_hair_distance(person, q, INFINITY) + 0.012f * ern_synth_strands(person, q));
  const float brow = maxf(brow_cover(person, q), 0.85f * roots * smoothf(0.26f, 0.20f, x));
  c = vec3_mix(c, vec3_scale(person->hair, 0.55f), 0.94f * brow);
  paint->gloss *= 1.0f - brow;
  paint->albedo = c;
  if (q.z > 0.15f) paint_lips(person, s, paint);
  /* nostrils */
  const float tip_y = -0.118f * person->nose_length;
  const struct vec3 hole = vec3_of(x - 0.021f * person->nose_width, q.y - (tip_y - 0.033f), q.z - 0.345f);
  const float nostril = hump(hole.x, 0.013f) * hump(hole.y, 0.010f) * hump(hole.z, 0.022f);
  paint->albedo = vec3_scale(paint->albedo, 1.0f - 0.85f * clampf(1.5f * nostril, 0.0f, 1.0f));
}

static void paint_lid(const struct ern_synth_head *head, const struct ern_synth_surface *s, struct paint *paint) {
  paint_skin(head->person, s, paint);
  if (s->eye.z < 0.0f) return;
  const bool above = s->eye.y > 0.5f * (s->lid_upper + s->lid_lower);
  const float away = above ? s->eye.y - s->lid_upper : s->lid_lower - s->eye.y; /* from the rim, into the lid */
  const float inner = smoothf(0.059f, 0.047f, fabsf(s->eye.x));
  const float hairs = 0.5f + 0.5f * ern_synth_noise(vec3_of(s->eye.x * 260.0f, 5.0f, s->eye.x > 0 ? 1.0f : 2.0f));
  const float lash =
      smoothf(above ? 0.0075f + 0.004f * hairs : 0.0030f, 0.0010f, away) * inner * (above ? 0.96f : 0.55f);
  paint->albedo = vec3_mix(paint->albedo, vec3_of(0.012f, 0.009f, 0.008f), lash);
  if (!above) paint->albedo = vec3_mul(paint->albedo, vec3_of(0.98f, 0.88f, 0.86f));
  const float crease = above ? hump(away - 0.020f, 0.0035f) * (1.0f - 0.8f * head->lids) : 0.0f;
  paint->albedo = vec3_scale(paint->albedo, 1.0f - 0.45f * crease * inner);
  paint->gloss *= 1.0f - lash;
}

static void paint_eye(const struct ern_synth_person *person, const struct ern_synth_surface *s, struct paint *paint) {
  const struct vec3 e = s->eye;
  const float r = sqrtf(e.x * e.x + e.y * e.y) / 0.0250f; /* 1 at the rim of the iris */
  const float veins = ern_synth_noise_sum(vec3_scale(vec3_add(s->rest, person->grain), 60.0f), 2);
  struct vec3 c = vec3_of(0.74f, 0.70f, 0.68f);
  c = vec3_mix(c, vec3_of(0.72f, 0.42f, 0.38f), clampf((fabsf(e.x) - 0.030f) * 18.0f + 0.15f * veins, 0.0f, 0.6f));
  const float angle = atan2f(e.y, e.x);
  const float spokes = ern_synth_noise(vec3_of(angle * 9.0f + person->grain.x, r * 2.0f, e.x > 0 ? 1.0f : 4.0f));
  struct vec3 iris = vec3_scale(person->iris, (1.05f + 0.5f * spokes) * mixf(1.5f, 0.75f, smoothf(0.4f, 1.0f, r)));
  iris = vec3_scale(iris, 1.0f - 0.72f * smoothf(0.80f, 1.0f, r));
  c = vec3_mix(iris, c, smoothf(0.96f, 1.08f, r));
  c = vec3_mix(vec3_of(0.004f, 0.004f, 0.004f), c, smoothf(0.38f, 0.47f, r));
  /* the upper lid's shadow */
  const float under = s->lid_upper - e.y;
  const float shade = mixf(0.32f, 1.0f, smoothf(-0.002f, 0.018f, under));
  c = vec3_scale(c, shade * mixf(0.7f, 1.0f, smoothf(-0.001f, 0.007f, e.y - s->lid_lower)));
  /* the window that the eye mirrors, upper left of the pupil whichever eye */
  const float side = s->rest.x >= 0.0f ? 1.0f : -1.0f;
  const float gx = e.x * side + 0.0085f, gy = e.y - 0.0085f;
  const float glint = smoothf(0.0062f, 0.0040f, sqrtf(gx * gx + gy * gy));
  c = vec3_mix(c, vec3_of(1.6f, 1.6f, 1.6f), glint);
  paint->albedo = c;
  paint->gloss = 0.06f;
  paint->tight = 60.0f;
  paint->soft = 0.45f;
}

static void paint_mouth(const struct ern_synth_head *head, const struct ern_synth_surface *s, struct vec3 p,
                        struct paint *paint) {
  /* light falls in from the front only */
  const float below = smoothf(ERN_SYNTH_MOUTH_Y - 0.01f, ERN_SYNTH_MOUTH_Y - 0.07f, p.y);
  const float depth = 0.310f - p.z - 0.22f * head->angle * below; /* the floor goes back with the jaw */
  paint->dark = mixf(1.0f, 0.10f, smoothf(0.0f, 0.13f, depth)) * mixf(0.30f, 1.0f, smoothf(0.0f, 0.10f, head->angle));
  paint->soft = 0.3f;
  if (s->part == ERN_SYNTH_TEETH) {
    const float angle = atan2f(p.x, maxf(p.z - 0.205f, 1e-3f));
    const float tooth = fabsf(sinf(angle * 7.5f));
    const float side = mixf(1.0f, 0.45f, smoothf(0.25f, 1.0f, fabsf(angle)));
    paint->albedo = vec3_scale(vec3_of(0.80f, 0.75f, 0.66f), side * mixf(0.55f, 1.0f, smoothf(0.0f, 0.30f, tooth)));
    paint->gloss = 0.25f;
    paint->tight = 40.0f;
  } else if (s->part == ERN_SYNTH_TONGUE) {
    const float bump = ern_synth_noise(vec3_scale(p, 120.0f));
    paint->albedo = vec3_scale(vec3_of(0.50f, 0.16f, 0.15f), 1.0f + 0.15f * bump);
    paint->gloss = 0.2f;
    paint->tight = 25.0f;
  } else {
    paint->albedo = vec3_of(0.20f, 0.045f, 0.045f);
    paint->gloss = 0.02f;
    paint->tight = 20.0f;
  }
}

static void paint_hair(const struct ern_synth_person *person, const struct ern_synth_surface *s, struct paint *paint) {
  const float strand = ern_synth_strands(person, s->rest);
  const float tone = ern_synth_noise_sum(vec3_scale(vec3_add(s->rest, person->grain), 9.0f), 2);
  paint->albedo = vec3_scale(person->hair, clampf(1.0f + 0.75f * strand + 0.3f * tone, 0.25f, 2.2f));
  paint->gloss = 0.10f * clampf(0.7f + strand, 0.0f, 1.6f);
  paint->tight = 12.0f;
  paint->soft = 0.25f;
}

/* ---- light --------------------------------------------------------------------------------------- */

static float highlight(struct vec3 n, struct vec3 way, struct vec3 towards, float tight) {
  return powf(maxf(vec3_dot(n, vec3_unit(vec3_add(way, towards))), 0.0f), tight * 2.0f);
}

/* Lambertian wrap lighting: light extends by `soft` past the terminator, and is redder the further it extends. */
static struct vec3 diffuse(float facing, float soft) {
  const float red = maxf((facing + soft) / (1.0f + soft), 0.0f);
  const float rest = maxf((facing + 0.45f * soft) / (1.0f + 0.45f * soft), 0.0f);
  return vec3_of(red, rest, rest);
}

struct vec3 ern_synth_head_shade(const struct ern_synth_head *head, struct vec3 p, struct vec3 towards) {
  struct ern_synth_surface s;
  (void)ern_synth_head_distance(head, p, &s);
  struct paint paint = {.dark = 1.0f};
  switch (s.part) {
    case ERN_SYNTH_SKIN: paint_skin(head->person, &s, &paint); break;
    case ERN_SYNTH_LID: paint_lid(head, &s, &paint); break;
    case ERN_SYNTH_EYE: paint_eye(head->person, &s, &paint); break;
    case ERN_SYNTH_HAIR: paint_hair(head->person, &s, &paint); break;
    case ERN_SYNTH_MOUTH:
    case ERN_SYNTH_TONGUE:
    case ERN_SYNTH_TEETH: paint_mouth(head, &s, p, &paint); break;
  }
  const struct vec3 n = normal_at(head, p, 0.0016f);
  const float open = openness(head, p, n) * paint.dark;
  /* mostly for a frontal view: the highlight keeps its place when the head turns */
  const struct vec3 eye = vec3_unit(vec3_of(0.35f * towards.x, 0.35f * towards.y, 1.0f));

  const float lit = shadow(head, p, n, ern_synth_key.way) * paint.dark;
  struct vec3 light = vec3_scale(ern_synth_ambient(n.y), open);
  light = vec3_add(light, vec3_scale(vec3_mul(ern_synth_key.light, diffuse(vec3_dot(n, ern_synth_key.way), paint.soft)),
                                     mixf(lit, open, 0.25f)));
  light = vec3_add(
      light, vec3_scale(vec3_mul(ern_synth_fill.light, diffuse(vec3_dot(n, ern_synth_fill.way), paint.soft)), open));
  light = vec3_along(light, maxf(vec3_dot(n, rim.way), 0.0f) * open * paint.dark, rim.light);
  struct vec3 c = vec3_mul(paint.albedo, light);
  c = vec3_along(c, paint.gloss * lit * highlight(n, ern_synth_key.way, eye, paint.tight), ern_synth_key.light);
  return vec3_along(c, 0.5f * paint.gloss * open * highlight(n, ern_synth_fill.way, eye, paint.tight),
                    ern_synth_fill.light);
}
