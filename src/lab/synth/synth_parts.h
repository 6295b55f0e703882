/* SPDX-License-Identifier: MIT
 * Parts of the synthetic clip: a person, the animation curves, a head and a torso that can be rendered.
 *
 * Frame of the head, used in all these files: x right in the picture, y up, z out of the face; the unit is the
 * renderer's (world * 4). So the renderer's (x, y, z) is (y, z, x) here. The head is about 0.9 tall. */
#ifndef ERN_LAB_SYNTH_PARTS_H
#define ERN_LAB_SYNTH_PARTS_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/status.h"
#include "core/threads.h"
#include "ernerf-lab/spoken.h"
#include "ernerf-lab/synth.h"
#include "ernerf/media.h"
#include "io/landmarks.h"

/* ---- numbers and small vectors ------------------------------------------------------------------- */

static inline float minf(float a, float b) { return a < b ? a : b; }
static inline float maxf(float a, float b) { return a > b ? a : b; }

struct vec3 {
  float x, y, z;
};

static inline struct vec3 vec3_of(float x, float y, float z) { return (struct vec3){x, y, z}; }
static inline struct vec3 vec3_add(struct vec3 a, struct vec3 b) { return vec3_of(a.x + b.x, a.y + b.y, a.z + b.z); }
static inline struct vec3 vec3_sub(struct vec3 a, struct vec3 b) { return vec3_of(a.x - b.x, a.y - b.y, a.z - b.z); }
static inline struct vec3 vec3_mul(struct vec3 a, struct vec3 b) { return vec3_of(a.x * b.x, a.y * b.y, a.z * b.z); }
static inline struct vec3 vec3_scale(struct vec3 a, float s) { return vec3_of(a.x * s, a.y * s, a.z * s); }
/* a + s*b */
static inline struct vec3 vec3_along(struct vec3 a, float s, struct vec3 b) {
  return vec3_of(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}
static inline float vec3_dot(struct vec3 a, struct vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline float vec3_length(struct vec3 a) { return sqrtf(vec3_dot(a, a)); }
static inline struct vec3 vec3_unit(struct vec3 a) { return vec3_scale(a, 1.0f / maxf(vec3_length(a), 1e-12f)); }
static inline struct vec3 vec3_mix(struct vec3 a, struct vec3 b, float t) { return vec3_along(a, t, vec3_sub(b, a)); }

static inline float clampf(float x, float low, float high) { return x < low ? low : x > high ? high : x; }
static inline float mixf(float a, float b, float t) { return a + t * (b - a); }
/* 0 at a, 1 at b (a > b falls), slope 0 at both. */
static inline float smoothf(float a, float b, float x) {
  const float t = clampf((x - a) / (b - a), 0.0f, 1.0f);
  return t * t * (3.0f - 2.0f * t);
}

/* ---- signed distances of shapes; unions with a fillet of about k --------------------------------- */

static inline float join(float a, float b, float k) { /* union; quadratic fillet */
  const float h = maxf(k - fabsf(a - b), 0.0f) / k;
  return minf(a, b) - h * h * k * 0.25f;
}
static inline float cut(float a, float b, float k) { return -join(-a, b, k); } /* a without b */
static inline float ball(struct vec3 p, struct vec3 centre, float radius) {
  return vec3_length(vec3_sub(p, centre)) - radius;
}
/* First-order distance to an ellipsoid: exact on its surface. */
static inline float ellipsoid(struct vec3 p, struct vec3 centre, struct vec3 radii) {
  const struct vec3 d = vec3_sub(p, centre);
  const struct vec3 a = vec3_of(d.x / radii.x, d.y / radii.y, d.z / radii.z);
  const struct vec3 b = vec3_of(a.x / radii.x, a.y / radii.y, a.z / radii.z);
  const float k = vec3_length(a);
  return k * (k - 1.0f) / maxf(vec3_length(b), 1e-6f);
}
/* A segment from a to b whose radius goes from ra to rb. */
static inline float capsule(struct vec3 p, struct vec3 a, struct vec3 b, float ra, float rb) {
  const struct vec3 pa = vec3_sub(p, a), ba = vec3_sub(b, a);
  const float t = clampf(vec3_dot(pa, ba) / vec3_dot(ba, ba), 0.0f, 1.0f);
  return vec3_length(vec3_along(pa, -t, ba)) - mixf(ra, rb, t);
}

/* About e^-u for u >= 0, and 0 from 6 on. */
static inline float bell(float u) {
  const float t = maxf(1.0f - u * (1.0f / 6.0f), 0.0f);
  return t * t * t * t * t * t;
}
/* The same of (x/width)^2. */
static inline float hump(float x, float width) { return bell(x * x / (width * width)); }

/* ---- random numbers, a pure function of (seed, stream, counter) ---------------------------------- */

static inline uint64_t synth_hash(uint64_t seed, uint64_t stream, uint64_t counter) {
  uint64_t z = seed + 0x9e3779b97f4a7c15u * (stream * 0x100000001b3u + counter + 1);
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u; /* splitmix64 */
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
  return z ^ (z >> 31);
}
/* In [low, high). */
static inline double synth_uniform(uint64_t seed, uint64_t stream, uint64_t counter, double low, double high) {
  return low + (high - low) * ((double)(synth_hash(seed, stream, counter) >> 11) * 0x1p-53);
}

/* Value noise on the unit lattice, in [-1, 1], C1. */
float ern_synth_noise(struct vec3 p);
/* sum of octaves of this noise, each with half the wavelength and amplitude; in about [-1, 1] */
float ern_synth_noise_sum(struct vec3 p, int octaves);

/* ---- the person: appearance by the seed ---------------------------------------------------------- */

struct ern_synth_person {
  /* Linear light, 0..1. */
  struct vec3 skin, lip, hair, iris, shirt, jacket, wall, lamp;
  /* Shape, 1 = middling. */
  float face_width, jaw_width, nose_width, nose_length, lip_fullness, eye_size, brow_weight;
  float freckles;    /* 0..1 */
  float hair_volume; /* 0.. about 0.03, unit */
  float part_side;   /* -1 or 1: side of the parting */
  float voice;       /* Hz, fundamental */
  struct vec3 grain; /* offset of all noise */
};

void ern_synth_person_make(uint64_t seed, struct ern_synth_person *person);

/* ---- animation ----------------------------------------------------------------------------------- */

enum { ERN_SYNTH_LETTERS = 29, ERN_SYNTH_WINDOW = 16, ERN_SYNTH_FPS = 25, ERN_SYNTH_RATE = 16000 };
/* Speech is cut into steps of 20 ms; step ERN_SYNTH_BEFORE is time 0, so that frame t's window is steps 2t .. 2t + 15.
 */
enum { ERN_SYNTH_STEPS = 50, ERN_SYNTH_BEFORE = 8 };

/* Motion of the mouth and sound of the voice. */
struct ern_synth_speech {
  size_t steps;
  float (*logits)[ERN_SYNTH_LETTERS]; /* [steps]: the features */
  float *jaw, *width;                 /* [steps], functions of the five surrounding logits */
  float *loud, *hiss;                 /* [steps], 0..1: strength of voiced and unvoiced sound */
  float (*formants)[3];               /* [steps], Hz */
};
ERN_NODISCARD ern_status ern_synth_speech_make(ern_context *context, uint64_t seed, size_t frames,
                                               struct ern_synth_speech *speech);
/* Fills only jaw and width, of a mouth that follows the phonemes of espeak-ng. */
ERN_NODISCARD ern_status ern_synth_speech_follow(ern_context *context, const ern_spoken *spoken, size_t frames,
                                                 struct ern_synth_speech *speech);
void ern_synth_speech_free(ern_context *context, struct ern_synth_speech *speech);
/* sound[samples] at 16 kHz of the speech; `voice` is its pitch in Hz. */
void ern_synth_sound_make(uint64_t seed, float voice, const struct ern_synth_speech *speech, int16_t *sound,
                          size_t samples);

/* One frame. */
struct ern_synth_curve {
  float jaw;              /* 0 closed .. 1 wide open */
  float width;            /* -1 pursed .. 1 spread */
  float blink;            /* 0 open .. 1 shut; above 1 squeezed */
  float yaw, pitch, roll; /* degrees; turned to the picture's right, up, clockwise as seen */
  float shift[3];         /* of the head's pivot, unit, along picture right, up, towards the camera */
  float pan, nod;         /* degrees, of a hand-held camera: to the picture's right, up */
};
/* Fills jaw and width of curves[frames] from the speech, the rest from the seed. `turn`: degrees, the largest yaw to
 * either side, with nods up to a half and tilts up to a third of it; 0: as the seed has it. */
void ern_synth_motion_make(uint64_t seed, const struct ern_synth_speech *speech, bool blink, bool moving, double turn,
                           struct ern_synth_curve *curves, size_t frames);

/* Applies the options' fault to curves[frames], except a rod. *cut: the first frame with another person; unchanged if
 * there is none. */
ERN_NODISCARD ern_status ern_synth_fault_move(ern_context *context, const ern_synth_options *options,
                                              const struct ern_synth_speech *speech, struct ern_synth_curve *curves,
                                              size_t frames, size_t *cut);

/* ---- the head ------------------------------------------------------------------------------------ */

/* A face at one moment, with the precomputed values of its distance function. */
struct ern_synth_head {
  const struct ern_synth_person *person;
  float angle;  /* of the jaw, radians */
  float width;  /* -1..1 */
  float pucker; /* 0..1, lips forward */
  float lids;   /* 0 open .. 1 shut */
};

enum ern_synth_part {
  ERN_SYNTH_SKIN,
  ERN_SYNTH_LID,
  ERN_SYNTH_EYE,
  ERN_SYNTH_MOUTH,
  ERN_SYNTH_TONGUE,
  ERN_SYNTH_TEETH,
  ERN_SYNTH_HAIR
};

struct ern_synth_surface {
  enum ern_synth_part part;
  struct vec3 rest;           /* position of the point on the face at rest, by which it is coloured */
  float lip;                  /* height above (+) or below (-) the line of the mouth at rest, unit */
  struct vec3 eye;            /* from the nearer eye's centre, x towards the temple */
  float lid_upper, lid_lower; /* heights of the lids' edges at eye.x */
};

void ern_synth_head_pose(struct ern_synth_head *head, const struct ern_synth_person *person,
                         const struct ern_synth_curve *curve);
/* A lower bound of the distance to the head's surface, negative inside; *surface (may be NULL) describes the surface
 * there. */
float ern_synth_head_distance(const struct ern_synth_head *head, struct vec3 p, struct ern_synth_surface *surface);
/* A bounding ellipsoid of the head with its hair. */
extern const struct vec3 ern_synth_head_middle, ern_synth_head_radii;
/* Where a point of the face at rest has moved to; side: above (1) or below (-1) the slit between the lips. */
struct vec3 ern_synth_head_moved(const struct ern_synth_head *head, struct vec3 rest, float side);
/* The 68 points in the frame of the head. */
void ern_synth_head_landmarks(const struct ern_synth_head *head, struct vec3 points[ERN_LANDMARKS]);

/* Parts at rest: skin without lids and ears; hair, and its strands in about [-1, 1]. */
float ern_synth_skin_distance(const struct ern_synth_person *person, struct vec3 q);
/* Exact where it is below `nearest`; elsewhere only not below it: strands are left out. */
float ern_synth_hair_distance(const struct ern_synth_person *person, struct vec3 q, float nearest);
float ern_synth_strands(const struct ern_synth_person *person, struct vec3 q);

/* Outlines at rest, shared by shape, colouring and landmarks. Lengths in units. */
#define ERN_SYNTH_MOUTH_Y (-0.245f)
#define ERN_SYNTH_MOUTH_HALF 0.094f
#define ERN_SYNTH_EYE_HALF 0.0585f
#define ERN_SYNTH_LID_RADIUS 0.0675f
extern const struct vec3 ern_synth_eye_centre; /* the one at positive x */
float ern_synth_mouth_line(float x);           /* y of the closed mouth */
enum { ERN_SYNTH_LIP_UPPER, ERN_SYNTH_LIP_LOWER };
float ern_synth_lip_height(const struct ern_synth_person *person, float x, int which); /* of the red, >= 0 */
/* Heights of the two lids' edges from the eye's centre; x from it towards the temple. */
void ern_synth_lid_edges(const struct ern_synth_head *head, float x, float *upper, float *lower);
float ern_synth_brow_line(float x); /* y of the brow's middle, x >= 0 */

/* Lamps are fixed in the frame of the head. */
struct ern_synth_lamp {
  struct vec3 way; /* towards it, unit vector */
  struct vec3 light;
};
extern const struct ern_synth_lamp ern_synth_key, ern_synth_fill;
/* Ambient light on a surface whose normal has y = up. */
struct vec3 ern_synth_ambient(float up);
/* Linear light that leaves `p` towards `towards` (unit vector from p to the camera). */
struct vec3 ern_synth_head_shade(const struct ern_synth_head *head, struct vec3 p, struct vec3 towards);

/* ---- torso and room ------------------------------------------------------------------------------ */

/* Layers hold four floats a pixel: red, green, blue times alpha, and alpha; colours as in the files (sRGB's curve),
 * since that is how the layers of a clip are put over each other. */
struct ern_synth_layer {
  int width, height;
  int samples; /* a pixel of the frames and axis */
  float (*pixels)[4];
  bool *bare; /* [height][width]: skin, not cloth */
};

static inline float synth_encode(float linear) {
  const float c = clampf(linear, 0.0f, 1.0f);
  return c <= 0.0031308f ? 12.92f * c : 1.055f * powf(c, 1.0f / 2.4f) - 0.055f;
}

/* Draws the torso once, at rest, with a margin of a quarter of `size` on every side; frames warp it by a smooth
 * displacement. The caller owns it (ern_synth_torso_free). */
ERN_NODISCARD ern_status ern_synth_torso_make(ern_context *context, struct ern_pool *pool,
                                              const struct ern_synth_person *person, int size,
                                              struct ern_synth_layer *torso);
void ern_synth_torso_free(ern_context *context, struct ern_synth_layer *torso); /* accepts an empty one */
/* The torso [size][size] for a pose: the shoulders follow a part of the head's motion, the top of the neck all of it.
 * bare[size][size]: the share of the pixel that is the neck's skin, 0..1. */
void ern_synth_torso_draw(const struct ern_synth_layer *torso, const struct ern_synth_curve *curve, int size,
                          float (*pixels)[4], float *bare);
void ern_synth_room_draw(const struct ern_synth_person *person, uint64_t seed, enum ern_synth_room room, int size,
                         float (*pixels)[4]);

/* ---- camera -------------------------------------------------------------------------------------- */

enum { ERN_SYNTH_SCALE = 4 }; /* unit / world */

struct ern_synth_camera {
  double focal, centre; /* pixels; the centre is the same in x and y */
  double matrix[4][4];  /* camera to world as transforms_*.json has it: columns right, up, back, place */
};

void ern_synth_camera_make(int size, const struct ern_synth_curve *curve, struct ern_synth_camera *camera);
/* Pixels of a point of the head's frame. */
void ern_synth_camera_project(const struct ern_synth_camera *camera, struct vec3 p, float pixel[2]);
/* The ray through a place of the picture, in the head's frame. */
void ern_synth_camera_ray(const struct ern_synth_camera *camera, double x, double y, struct vec3 *origin,
                          struct vec3 *direction);

/* Maps (u, v) from the frame's camera to a camera at rest; in units of the picture's side. */
void ern_synth_camera_rest(const struct ern_synth_curve *curve, float *u, float *v);

/* Draws the head alone, [size][size]. */
void ern_synth_head_draw(const struct ern_synth_head *head, const struct ern_synth_camera *camera, int size,
                         float (*pixels)[4]);

/* ---- a frame ------------------------------------------------------------------------------------- */

/* Buffers to draw a frame in. */
struct ern_synth_buffers {
  int size;
  float (*head)[4], (*torso)[4], *bare; /* [size][size] */
  bool *hidden;                         /* [size][size], behind the rod */
  ern_image truth, cutout, parsing;     /* RGB, RGBA, RGB */
};

/* 255 c, rounded and clamped to a byte. */
uint8_t ern_synth_to_byte(float c);
ERN_NODISCARD ern_status ern_synth_picture_make(ern_context *context, int size, int channels, ern_image *image);
ERN_NODISCARD ern_status ern_synth_buffers_make(ern_context *context, int size, struct ern_synth_buffers *buffers);
void ern_synth_buffers_free(ern_context *context, struct ern_synth_buffers *buffers); /* accepts a half-made one */
/* truth: head over torso over room; cutout: the torso alone, its colours divided by its alpha. */
void ern_synth_buffers_compose(struct ern_synth_buffers *buffers, float (*room)[4],
                               const struct ern_synth_curve *curve);
/* Draws a rod in front of the face, in the middle third of the clip; `time`: 0..1 of the clip; `width` in sides of the
 * picture. */
void ern_synth_buffers_rod(struct ern_synth_buffers *buffers, struct vec3 skin, double time, double width);
/* parsing: the topmost layer whose alpha is at least 0.5. */
void ern_synth_buffers_parse(struct ern_synth_buffers *buffers);
/* truth as RGBA, [size][size][4]. */
void ern_synth_buffers_show(const struct ern_synth_buffers *buffers, uint8_t *shown);

#endif
