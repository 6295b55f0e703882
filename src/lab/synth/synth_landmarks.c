/* SPDX-License-Identifier: MIT
 * The 68 landmarks of the synthetic face: located on the face at rest, then moved with jaw, lips and lids. The 300-W
 * order; "left" is the left of the picture. */
#include "lab/synth/synth_parts.h"

/* The point of the skin at (x, y), seen from the front. */
static struct vec3 on_front(const struct ern_synth_person *person, float x, float y) {
  struct vec3 p = vec3_of(x, y, 0.45f);
  for (int k = 0; k < 64; ++k) p.z -= 0.7f * ern_synth_skin_distance(person, p);
  return p;
}

/* The skin's surface in the plane through `from`, in the direction (cos, sin) of `angle`. */
static struct vec3 on_outline(const struct ern_synth_person *person, struct vec3 from, float angle) {
  const struct vec3 way = vec3_of(cosf(angle), sinf(angle), 0.0f);
  struct vec3 p = from;
  for (int k = 0; k < 64; ++k) p = vec3_along(p, -0.7f * ern_synth_skin_distance(person, p), way);
  return p;
}

/* A point on a lid's edge; side -1 is the left eye, x towards the temple, upper or lower edge or, at the corners, both.
 */
static struct vec3 on_lid(const struct ern_synth_head *head, float side, float x, bool above) {
  const float at = x * ERN_SYNTH_EYE_HALF * head->person->eye_size;
  float upper, lower;
  ern_synth_lid_edges(head, at, &upper, &lower);
  const float y = above ? upper : lower, r = ERN_SYNTH_LID_RADIUS;
  const struct vec3 centre = ern_synth_eye_centre;
  return vec3_of(side * (centre.x + at), centre.y + y, centre.z + sqrtf(maxf(r * r - at * at - y * y, 0.0f)));
}

static struct vec3 on_lip(const struct ern_synth_head *head, float x, float side, bool outer) {
  const float at = x * ERN_SYNTH_MOUTH_HALF;
  float y = ern_synth_mouth_line(at);
  if (outer) {
    const int which = side > 0.0f ? ERN_SYNTH_LIP_UPPER : ERN_SYNTH_LIP_LOWER;
    y += side * ern_synth_lip_height(head->person, at, which);
  }
  return ern_synth_head_moved(head, on_front(head->person, at, y), side);
}

void ern_synth_head_landmarks(const struct ern_synth_head *head, struct vec3 points[ERN_LANDMARKS]) {
  static const float brow_x[5] = {0.182f, 0.150f, 0.116f, 0.080f, 0.048f};
  static const float outer_x[12] = {-1.0f, -0.62f, -0.25f, 0.0f, 0.25f,  0.62f,
                                    1.0f,  0.62f,  0.27f,  0.0f, -0.27f, -0.62f};
  static const float inner_x[8] = {-0.90f, -0.42f, 0.0f, 0.42f, 0.90f, 0.42f, 0.0f, -0.42f};
  static const float lid_x[6] = {1.0f, 0.36f, -0.36f, -1.0f, -0.36f, 0.36f}; /* the left eye's, from its outer corner */
  const struct ern_synth_person *person = head->person;
  const float pi = 3.14159265f, tip = -0.118f * person->nose_length, wing = 0.036f * person->nose_width;
  for (int k = 0; k < 17; ++k) {
    const float angle = pi * (1.0f + (float)k / 16.0f);
    const struct vec3 from = vec3_of(0.0f, -0.03f, 0.02f - 0.13f * sinf(angle));
    points[k] = ern_synth_head_moved(head, on_outline(person, from, angle), -1.0f);
  }
  for (int k = 0; k < 5; ++k) {
    points[17 + k] = on_front(person, -brow_x[k], ern_synth_brow_line(brow_x[k]));
    points[26 - k] = on_front(person, brow_x[k], ern_synth_brow_line(brow_x[k]));
  }
  for (int k = 0; k < 4; ++k) points[27 + k] = on_front(person, 0.0f, mixf(0.030f, tip, (float)k / 3.0f));
  for (int k = 0; k < 5; ++k) {
    const float x = 0.5f * (float)(k - 2) * wing * 1.15f;
    points[31 + k] = on_front(person, x, tip - 0.032f - 0.006f * (1.0f - fabsf((float)k - 2.0f) / 2.0f));
  }
  for (int k = 0; k < 6; ++k) {
    points[36 + k] = on_lid(head, -1.0f, lid_x[k], k < 3);
    points[42 + k] = on_lid(head, 1.0f, lid_x[k < 4 ? 3 - k : 9 - k], k < 3);
  }
  for (int k = 0; k < 12; ++k) points[48 + k] = on_lip(head, outer_x[k], k < 7 ? 1.0f : -1.0f, true);
  for (int k = 0; k < 8; ++k) points[60 + k] = on_lip(head, inner_x[k], k < 5 ? 1.0f : -1.0f, false);
}
