/* SPDX-License-Identifier: MIT
 * The synthetic head as a signed distance function: a face at rest, deformed by jaw, lips and lids, with eyes, teeth,
 * tongue, hair. A point is first mapped back to the face at rest (inverse deformation), where the shapes are fixed. */
#include "lab/synth/synth_parts.h"

/* Positions on the face at rest, unit. */
static const float hinge_y = -0.045f, hinge_z = -0.02f; /* the axis of the jaw, along x */
static const float eye_radius = 0.060f, lid_radius = ERN_SYNTH_LID_RADIUS;
const struct vec3 ern_synth_eye_centre = {0.123f, 0.0f, 0.218f};
const struct vec3 ern_synth_head_middle = {0.0f, -0.01f, -0.02f}, ern_synth_head_radii = {0.36f, 0.50f, 0.44f};

/* Share of the jaw's rotation at a point away from the mouth opening, by its height at rest. */
static float jaw_share(float y) { return smoothf(-0.15f, -0.37f, y); }

float ern_synth_mouth_line(float x) {
  const float t = minf(fabsf(x) / ERN_SYNTH_MOUTH_HALF, 1.4f), dip = maxf(1.0f - 4.0f * t * t, 0.0f);
  return ERN_SYNTH_MOUTH_Y - 0.004f * (1.0f - t * t) + 0.0036f * dip * dip;
}

float ern_synth_lip_height(const struct ern_synth_person *person, float x, int which) {
  const float t = fabsf(x) / ERN_SYNTH_MOUTH_HALF;
  if (t >= 1.0f) return 0.0f;
  const float arch = 1.0f - t * t;
  if (which == ERN_SYNTH_LIP_LOWER) return person->lip_fullness * 0.040f * sqrtf(arch * sqrtf(arch));
  /* cupid's bow: two peaks beside a dip */
  const float dip = 1.0f - 0.22f * bell(t * t * 45.0f), rest = 1.0f - t;
  return person->lip_fullness * 0.031f * sqrtf(rest) * (0.88f + 0.12f * rest) * (1.0f + 0.35f * t) * dip;
}

void ern_synth_head_pose(struct ern_synth_head *head, const struct ern_synth_person *person,
                         const struct ern_synth_curve *curve) {
  head->person = person;
  head->angle = 0.21f * curve->jaw;
  head->width = curve->width;
  head->pucker = maxf(-curve->width, 0.0f);
  head->lids = clampf(curve->blink, 0.0f, 1.0f);
}

/* ---- the movement -------------------------------------------------------------------------------- */

/* Rotates p about the jaw's axis by -angle, the inverse of an opening; to third order in the angle. */
static struct vec3 unturn(struct vec3 p, float angle) {
  const float s = angle * (1.0f - angle * angle / 6.0f), c = 1.0f - 0.5f * angle * angle;
  const float dy = p.y - hinge_y, dz = p.z - hinge_z;
  return vec3_of(p.x, hinge_y + c * dy + s * dz, hinge_z - s * dy + c * dz);
}

/* How open the slit is at x: 1 in the middle, 0 at the corners and beyond. */
static float slit_profile(float x) {
  const float t = x / ERN_SYNTH_MOUTH_HALF;
  return maxf(1.0f - t * t, 0.0f);
}

/* Share of the jaw's rotation at a point with height y at rest, above (+1) or below (-1) the slit. */
static float turn_share(float x, float y, float side) {
  const float open = slit_profile(x), base = jaw_share(y) * (1.0f - open);
  if (side < 0.0f) return base + open;
  return base - 0.16f * open * (1.0f - smoothf(ERN_SYNTH_MOUTH_Y, ERN_SYNTH_MOUTH_Y + 0.09f, y));
}

/* Inverse of the lips' deformation (spreading, pursing) at a point. */
static struct vec3 unspread(const struct ern_synth_head *head, struct vec3 p) {
  const float dy = p.y - ERN_SYNTH_MOUTH_Y, away = p.x * p.x + dy * dy;
  if (p.z <= 0.0f || away > 6.0f * 0.15f * 0.15f) return p;
  const float front = smoothf(0.0f, 0.15f, p.z), near = front * bell(away / (0.15f * 0.15f));
  const float t = minf(fabsf(p.x) / ERN_SYNTH_MOUTH_HALF, 1.5f);
  const float stretch = head->width > 0.0f ? 0.20f : 0.42f;
  struct vec3 q = p;
  q.x = p.x * (1.0f - stretch * head->width * near);
  q.y = p.y - 0.010f * maxf(head->width, 0.0f) * near * t * t;
  if (head->pucker > 0.0f) q.z = p.z - 0.034f * head->pucker * front * hump(p.x, 0.085f) * hump(dy, 0.07f);
  return q;
}

/* Heights of the slit's edges at x (after unspread), for a point at depth z. */
static void slit_edges(const struct ern_synth_head *head, float x, float z, float *top, float *bottom) {
  /* the lower edge is kept level behind the lip, where the jaw's rotation would raise it */
  const float line = ern_synth_mouth_line(x);
  *top = *bottom = line;
  if (head->angle == 0.0f) return;
  const float level = mixf(z, maxf(z, 0.30f), minf(4.0f * slit_profile(x), 1.0f));
  *top = line - head->angle * (z - hinge_z) * turn_share(x, line, 1.0f);
  *bottom = line - head->angle * (level - hinge_z) * turn_share(x, line, -1.0f);
}

/* The point at rest for `p` (after unspread), by iteration, because the share depends on the height at rest. */
static struct vec3 unbend(const struct ern_synth_head *head, struct vec3 p, float side) {
  const float front = head->angle * smoothf(-0.17f, 0.02f, p.z);
  if (front <= 0.0f) return p;
  struct vec3 q = p;
  for (int pass = 0; pass < 3; ++pass) q = unturn(p, front * turn_share(p.x, q.y, side));
  return q;
}

/* ---- shapes at rest ------------------------------------------------------------------------------ */

/* A smooth |x|, without the crease in the middle. */
static struct vec3 mirrored(struct vec3 q) { return vec3_of(sqrtf(q.x * q.x + 0.0004f), q.y, q.z); }

static float skull_distance(const struct ern_synth_person *person, struct vec3 q) {
  const float wide = person->face_width;
  float d = ellipsoid(q, vec3_of(0.0f, 0.105f, -0.045f), vec3_of(0.268f * wide, 0.300f, 0.330f));
  d = join(d, ellipsoid(q, vec3_of(0.0f, -0.10f, 0.045f), vec3_of(0.208f * wide, 0.300f, 0.232f)), 0.10f);
  const struct vec3 m = mirrored(q);
  const float jaw = person->jaw_width;
  d = join(d, capsule(m, vec3_of(0.155f * jaw, -0.20f, 0.00f), vec3_of(0.062f * jaw, -0.345f, 0.175f), 0.066f, 0.054f),
           0.12f);
  d = join(d, ellipsoid(m, vec3_of(0.105f, -0.185f, 0.125f), vec3_of(0.085f, 0.115f, 0.100f)), 0.10f);
  d = join(d, ellipsoid(q, vec3_of(0.0f, -0.368f, 0.205f), vec3_of(0.066f, 0.052f, 0.060f)), 0.09f);
  return d;
}

static float nose_distance(const struct ern_synth_person *person, struct vec3 q, float d) {
  const struct vec3 m = vec3_of(fabsf(q.x), q.y, q.z);
  const float w = person->nose_width, l = person->nose_length;
  const float tip_y = -0.118f * l;
  d = join(d, capsule(q, vec3_of(0.0f, 0.055f, 0.262f), vec3_of(0.0f, tip_y + 0.02f, 0.343f), 0.020f, 0.029f), 0.050f);
  d = join(d, ellipsoid(q, vec3_of(0.0f, tip_y, 0.357f), vec3_of(0.033f * w, 0.030f, 0.033f)), 0.040f);
  d = join(d, ellipsoid(m, vec3_of(0.036f * w, tip_y - 0.009f, 0.318f), vec3_of(0.020f, 0.020f, 0.032f)), 0.026f);
  d = cut(d, ellipsoid(m, vec3_of(0.023f * w, tip_y - 0.038f, 0.340f), vec3_of(0.011f, 0.013f, 0.019f)), 0.012f);
  return d;
}

/* Protrusion of the red of the lips; `v`: height above the mouth's line. */
static float lip_bulge(const struct ern_synth_person *person, float x, float v) {
  const float up = ern_synth_lip_height(person, x, ERN_SYNTH_LIP_UPPER);
  const float low = ern_synth_lip_height(person, x, ERN_SYNTH_LIP_LOWER);
  const float t = minf(fabsf(x) / ERN_SYNTH_MOUTH_HALF, 1.0f), fade = 1.0f - t * t * t;
  const float a = v >= 0.0f ? v / maxf(up, 1e-4f) : -v / maxf(low, 1e-4f);
  const float roll = a < 1.0f ? sqrtf(maxf(a * (1.6f - a) * 1.5625f, 0.0f)) : 0.0f; /* 0 on the line, 1 at a = 0.8 */
  const float tail = a >= 1.0f ? bell((a - 1.0f) * 1.8f) * 0.9682f : 1.0f;
  const float bulge = (v >= 0.0f ? 0.015f : 0.019f) * (a < 1.0f ? roll : tail);
  return smoothf(0.115f, 0.07f, fabsf(v)) * fade * (bulge - 0.006f * hump(v, 0.006f));
}

static float face_distance(const struct ern_synth_person *person, struct vec3 q, float v) {
  float d = skull_distance(person, q);
  if (d > 0.20f) return d - 0.09f; /* the nose may be nearer */
  if (q.z < 0.0f) return d;
  const struct vec3 m = mirrored(q);
  d = join(d, ellipsoid(m, vec3_of(0.138f, -0.088f, 0.196f), vec3_of(0.066f, 0.052f, 0.058f)), 0.08f);
  d = join(d, capsule(m, vec3_of(0.030f, 0.068f, 0.272f), vec3_of(0.165f, 0.066f, 0.205f), 0.022f, 0.020f), 0.06f);
  d = join(d, ellipsoid(q, vec3_of(0.0f, -0.235f, 0.222f), vec3_of(0.105f, 0.085f, 0.085f)), 0.06f);
  d = cut(d, ball(m, vec3_of(0.116f, 0.010f, 0.322f), 0.058f), 0.055f); /* the hollow of the eye */
  d = nose_distance(person, q, d);
  if (d > 0.06f) return d;
  d += 0.006f * hump(q.x, 0.012f) * hump(q.y + 0.185f, 0.022f); /* the groove under the nose */
  /* fold from the nose's wing to the mouth's corner */
  const float fold = m.x - mixf(0.068f, 0.118f, clampf((-0.145f - q.y) / 0.12f, 0.0f, 1.0f));
  d += 0.004f * hump(fold, 0.010f) * smoothf(-0.12f, -0.16f, q.y) * smoothf(-0.29f, -0.23f, q.y);
  d += 0.010f * hump(q.x, 0.06f) * hump(q.y + 0.322f, 0.020f); /* under the lip */
  if (fabsf(q.x) < 1.3f * ERN_SYNTH_MOUTH_HALF && fabsf(v) < 0.12f) d -= lip_bulge(person, q.x, v);
  return d;
}

static float ear_distance(const struct ern_synth_person *person, struct vec3 q) {
  const struct vec3 m = vec3_of(fabsf(q.x) - 0.262f * person->face_width, q.y + 0.030f, q.z + 0.020f);
  if (vec3_length(m) > 0.16f) return vec3_length(m) - 0.10f;
  /* its plane holds y, a little tilted, and leans out backwards by half a right angle */
  const struct vec3 e = vec3_of(0.80f * m.x + 0.60f * m.z, m.y - 0.15f * m.z, -0.60f * m.x + 0.80f * m.z);
  float d = ellipsoid(e, vec3_of(0.000f, 0.0f, -0.030f), vec3_of(0.020f, 0.080f, 0.052f));
  d = cut(d, ellipsoid(e, vec3_of(0.024f, 0.012f, -0.026f), vec3_of(0.020f, 0.054f, 0.036f)), 0.010f);
  d = join(d, capsule(e, vec3_of(0.006f, -0.020f, -0.040f), vec3_of(0.004f, 0.040f, -0.016f), 0.008f, 0.007f), 0.014f);
  d = join(d, ball(e, vec3_of(0.004f, -0.010f, 0.012f), 0.014f), 0.02f);
  return join(d, ball(e, vec3_of(0.000f, -0.064f, -0.012f), 0.018f), 0.02f);
}

/* ---- eyes ---------------------------------------------------------------------------------------- */

/* Heights of the two lids' edges at e.x, from the eye's centre. */
void ern_synth_lid_edges(const struct ern_synth_head *head, float x, float *upper, float *lower) {
  const float size = head->person->eye_size, half = ERN_SYNTH_EYE_HALF * size;
  const float t = clampf((x + 0.001f) / half, -1.0f, 1.0f);
  const float axis = 0.045f * x - 0.003f;
  const float arch = 1.0f - t * t, lean = 1.0f - 0.18f * t; /* highest towards the nose */
  const float open = axis + size * 0.0245f * sqrtf(arch * sqrtf(arch)) * lean;
  const float floor = axis - size * 0.0165f * arch * (1.0f + 0.2f * t);
  *lower = floor + 0.12f * head->lids * (open - floor);
  *upper = mixf(open, *lower - 0.0015f, head->lids);
}

struct eye_parts {
  float ball, lids;
};

static struct eye_parts eye_distance(struct vec3 e, float upper, float lower) {
  struct eye_parts parts = {vec3_length(e) - eye_radius, 0.0f};
  /* cornea */
  parts.ball = join(parts.ball, ball(e, vec3_of(0.0f, 0.0f, 0.030f), 0.034f), 0.008f);
  const float gap = e.z > 0.0f ? 0.8f * maxf(e.y - upper, lower - e.y) + 0.6f * maxf(fabsf(e.x) - 0.053f, 0.0f)
                               : 1.0f; /* negative between the lids */
  const float over = e.y > 0.5f * (upper + lower)
                         ? 0.0035f * hump(e.y - upper, 0.010f) * smoothf(0.057f, 0.038f, fabsf(e.x))
                         : 0.0f; /* the upper lid's rim is thicker */
  parts.lids = cut(vec3_length(e) - lid_radius - over, gap, 0.004f);
  return parts;
}

/* ---- mouth --------------------------------------------------------------------------------------- */

/* A row of teeth around an arch that is open to the back; `height` from the middle of the row. */
static float teeth_distance(struct vec3 p, float arch, float height, float half_height) {
  const float x = p.x / (0.072f * arch), z = (p.z - 0.205f) / (0.090f * arch);
  const float ring = (sqrtf(x * x + z * z) - 1.0f) * 0.075f * arch;
  const float angle = atan2f(p.x, maxf(p.z - 0.205f, 1e-3f));
  const float tooth = fabsf(sinf(angle * 7.5f)); /* 0 between two teeth */
  const float face = fabsf(ring) - 0.008f + 0.0025f * (1.0f - smoothf(0.0f, 0.25f, tooth));
  return maxf(-join(-face, -(fabsf(height) - half_height), 0.006f), 0.19f - p.z);
}

struct mouth_parts {
  float hollow, slit, teeth, tongue;
};

static struct mouth_parts mouth_distance(const struct ern_synth_head *head, struct vec3 p, float top, float bottom) {
  struct mouth_parts parts;
  const struct vec3 low = unturn(p, head->angle), half = unturn(p, 0.5f * head->angle);
  /* the cavity extends from the palate to the floor, which moves with the jaw */
  const struct vec3 middle = vec3_of(0.0f, ERN_SYNTH_MOUTH_Y, 0.200f), radii = vec3_of(0.088f, 0.045f, 0.096f);
  const float between = ellipsoid(half, middle, vec3_of(0.088f, 0.045f + 0.13f * head->angle, 0.096f));
  parts.hollow = minf(minf(ellipsoid(p, middle, radii), ellipsoid(low, middle, radii)), between);
  parts.slit =
      maxf(0.75f * maxf(p.y - top, bottom - p.y) + 0.5f * maxf(fabsf(p.x) - 0.96f * ERN_SYNTH_MOUTH_HALF, 0.0f),
           0.20f - p.z); /* negative between the lips */
  const float upper = teeth_distance(p, 1.0f, p.y - (ERN_SYNTH_MOUTH_Y + 0.018f), 0.024f);
  const float lower = teeth_distance(low, 0.88f, low.y - (ERN_SYNTH_MOUTH_Y - 0.027f), 0.022f);
  parts.teeth = minf(upper, lower);
  parts.tongue = ellipsoid(low, vec3_of(0.0f, ERN_SYNTH_MOUTH_Y - 0.042f, 0.190f), vec3_of(0.050f, 0.022f, 0.076f));
  return parts;
}

/* ---- hair ---------------------------------------------------------------------------------------- */

/* Strands along the direction of combing, from the brow back and down both sides of the parting: locks, and hairs in
 * them. In about [-1, 1]. */
float ern_synth_strands(const struct ern_synth_person *person, struct vec3 q) {
  const struct vec3 c = vec3_of(q.x - 0.07f * person->part_side, q.y - 0.02f, q.z + 0.06f);
  const float across = atan2f(c.x, c.y), radius = vec3_length(c);
  const struct vec3 place = person->grain;
  const float wave = ern_synth_noise(vec3_add(vec3_of(across * 3.0f, radius * 5.0f, c.z * 7.0f), place));
  const float turn = across + 0.05f * wave;
  const float lock = ern_synth_noise(vec3_add(vec3_of(turn * 10.0f + 2.0f * c.z, radius * 6.0f, c.z * 2.5f), place));
  const float hair = ern_synth_noise(vec3_add(vec3_of(turn * 38.0f + 2.0f * lock, radius * 9.0f, c.z * 3.5f), place));
  const float fine = ern_synth_noise(vec3_add(vec3_of(turn * 90.0f, radius * 30.0f, c.z * 5.0f), place));
  return 0.50f * lock + 0.32f * hair + 0.18f * fine;
}

float ern_synth_hair_distance(const struct ern_synth_person *person, struct vec3 q, float nearest) {
  const float wide = person->face_width, more = person->hair_volume;
  float d = ellipsoid(q, vec3_of(0.0f, 0.118f, -0.055f), vec3_of(0.286f * wide + more, 0.310f + more, 0.345f + more));
  if (d > 0.12f) return d - 0.02f;
  /* a mass swept up from the brow, away from the parting */
  const float side = -person->part_side;
  d = join(d, ellipsoid(q, vec3_of(0.050f * side, 0.315f, 0.140f), vec3_of(0.180f, 0.080f + more, 0.125f)), 0.07f);
  d = join(d, ellipsoid(q, vec3_of(0.120f * side, 0.265f, 0.175f), vec3_of(0.095f, 0.065f, 0.070f)), 0.06f);
  /* the face, the temples, the ears and the neck are free of it */
  d = cut(d, ellipsoid(q, vec3_of(0.0f, -0.07f, 0.30f), vec3_of(0.226f * wide, 0.315f, 0.24f)), 0.030f);
  d = cut(d, 0.9f * (q.y - mixf(-0.30f, -0.05f, smoothf(-0.16f, 0.03f, q.z))), 0.03f);
  const struct vec3 m = vec3_of(fabsf(q.x), q.y, q.z);
  d = cut(d, ellipsoid(m, vec3_of(0.300f * wide, -0.065f, -0.050f), vec3_of(0.06f, 0.085f, 0.060f)), 0.02f);
  if (fabsf(d) < 0.03f && d - 0.011f < nearest) d -= 0.010f * ern_synth_strands(person, q);
  return d;
}

/* ---- all of it ----------------------------------------------------------------------------------- */

/* `point` between spreading and bending, `rest` after both, and the edges of the slit at `point`. */
struct carried {
  struct vec3 point, rest;
  float top, bottom;
};

/* side: above (1) or below (-1) the slit; 0: by the position of p. A point between the lips counts as on the nearer
 * edge. */
static struct carried carry_back(const struct ern_synth_head *head, struct vec3 p, float side) {
  struct carried c = {.point = unspread(head, p)};
  slit_edges(head, c.point.x, c.point.z, &c.top, &c.bottom);
  struct vec3 clear = c.point;
  if (side == 0.0f) {
    side = clear.y >= 0.5f * (c.top + c.bottom) ? 1.0f : -1.0f;
    clear.y = side > 0.0f ? maxf(clear.y, c.top) : minf(clear.y, c.bottom);
  }
  c.rest = unbend(head, clear, side);
  return c;
}

struct vec3 ern_synth_head_moved(const struct ern_synth_head *head, struct vec3 rest, float side) {
  struct vec3 p = rest;
  for (int pass = 0; pass < 24; ++pass)
    p = vec3_add(p, vec3_scale(vec3_sub(rest, carry_back(head, p, side).rest), 0.8f));
  return p;
}

float ern_synth_skin_distance(const struct ern_synth_person *person, struct vec3 q) {
  return face_distance(person, q, q.y - ern_synth_mouth_line(q.x));
}

float ern_synth_head_distance(const struct ern_synth_head *head, struct vec3 p, struct ern_synth_surface *surface) {
  const struct ern_synth_person *person = head->person;
  const struct carried c = carry_back(head, p, 0.0f);
  const struct vec3 s = c.point, q = c.rest;
  const float v = q.y - ern_synth_mouth_line(q.x);

  float d = face_distance(person, q, v);
  enum ern_synth_part part = ERN_SYNTH_SKIN;
  const bool by_mouth = d < 0.03f && q.z > 0.05f && fabsf(s.x) < 0.14f && s.y > -0.42f && s.y < -0.12f;
  const struct vec3 e = vec3_sub(vec3_of(fabsf(q.x), q.y, q.z), ern_synth_eye_centre);
  float upper = 0.0f, lower = 0.0f;

  if (vec3_dot(e, e) < 0.12f * 0.12f) {
    ern_synth_lid_edges(head, e.x, &upper, &lower);
    const struct eye_parts eye = eye_distance(e, upper, lower);
    d = cut(d, vec3_length(e) - lid_radius + 0.003f, 0.010f);
    if (eye.lids < d) part = ERN_SYNTH_LID;
    d = join(d, eye.lids, 0.016f);
    if (eye.ball < d) {
      d = eye.ball;
      part = ERN_SYNTH_EYE;
    }
  }
  if (by_mouth && head->angle > 0.0f) {
    const struct mouth_parts mouth = mouth_distance(head, s, c.top, c.bottom);
    const float opening = minf(mouth.hollow, mouth.slit);
    if (-opening > d && mouth.hollow < mouth.slit) part = ERN_SYNTH_MOUTH;
    d = cut(d, opening, 0.005f);
    if (mouth.tongue < d) {
      d = mouth.tongue;
      part = ERN_SYNTH_TONGUE;
    }
    if (mouth.teeth < d) {
      d = mouth.teeth;
      part = ERN_SYNTH_TEETH;
    }
  }
  d = join(d, ear_distance(person, q), 0.018f);
  const float hair = ern_synth_hair_distance(person, q, d);
  if (hair < d) {
    d = hair;
    part = ERN_SYNTH_HAIR;
  }
  if (surface != NULL) *surface = (struct ern_synth_surface){part, q, v, e, upper, lower};
  return d;
}
