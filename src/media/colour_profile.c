/* SPDX-License-Identifier: MIT
 * ICC profiles of a matrix and curves (ICC.1:2010, annex F.3), as cameras, phones and programs embed them: a value goes
 * through its curve to linear light, and the matrix gives XYZ under D50. */

#include <math.h>
#include <string.h>

#include "core/memory.h"
#include "media/image.h"

/* Steps of linear light: near black an 8-bit step of sRGB is 5 of them. */
enum { LINEAR_STEPS = 16384, MATRIX_TAGS = 3, HEADER = 128, TAG = 12 };

struct profile {
  const uint8_t *data;
  size_t bytes;
};

struct conversion {
  float linear[3][256];              /* a channel's value as linear light, 0..1 */
  float matrix[3][3];                /* from there to linear sRGB */
  uint8_t encoded[LINEAR_STEPS + 1]; /* linear sRGB as a value */
};

static uint32_t big_endian(const uint8_t *bytes, int count) {
  uint32_t value = 0;
  for (int i = 0; i < count; i++) value = value << 8 | bytes[i];
  return value;
}

/* s15Fixed16Number */
static double fixed(const uint8_t *bytes) { return (double)(int32_t)big_endian(bytes, 4) / 65536; }

/* The bytes of a tag; NULL where there is none of at least `least` bytes. */
static const uint8_t *find_tag(const struct profile *profile, const char *name, size_t least, size_t *bytes) {
  const uint32_t count = big_endian(profile->data + HEADER, 4);
  for (size_t i = 0; i < count && HEADER + 4 + TAG * (i + 1) <= profile->bytes; i++) {
    const uint8_t *tag = profile->data + HEADER + 4 + TAG * i;
    const size_t at = big_endian(tag + 4, 4), size = big_endian(tag + 8, 4);
    if (memcmp(tag, name, 4) != 0) continue;
    if (at > profile->bytes || size > profile->bytes - at || size < least) return NULL;
    *bytes = size;
    return profile->data + at;
  }
  return NULL;
}

/* parametricCurveType, x in 0..1: functions 0 to 4 have 1, 3, 4, 5 and 7 numbers g a b c d e f. */
static bool parametric(const uint8_t *tag, size_t bytes, float linear[256]) {
  static const size_t numbers[] = {1, 3, 4, 5, 7};
  double p[7] = {0};
  const unsigned kind = big_endian(tag + 8, 2);
  if (kind > 4 || bytes < 12 + 4 * numbers[kind]) return false;
  for (size_t i = 0; i < numbers[kind]; i++) p[i] = fixed(tag + 12 + 4 * i);
  const double g = p[0], a = kind > 0 ? p[1] : 1, b = p[2];
  const double from = kind == 0 ? 0 : kind < 3 ? -b / a : p[4]; /* below it the curve is a line */
  const double slope = kind < 3 ? 0 : p[3], above = kind == 2 ? p[3] : p[5], below = kind == 2 ? p[3] : p[6];
  for (int i = 0; i < 256; i++) {
    const double x = i / 255.0;
    linear[i] = (float)(x >= from ? pow(fmax(a * x + b, 0), g) + above : slope * x + below);
  }
  return true;
}

/* curveType: no entry: the identity; one: a power; more: a table. */
static bool tabulated(const uint8_t *tag, size_t bytes, float linear[256]) {
  const size_t count = big_endian(tag + 8, 4);
  if (count > (bytes - 12) / 2) return false;
  for (int i = 0; i < 256; i++) {
    const double x = i / 255.0;
    if (count < 2) {
      linear[i] = (float)(count == 0 ? x : pow(x, big_endian(tag + 12, 2) / 256.0));
      continue;
    }
    const double at = x * (double)(count - 1);
    const size_t k = at < (double)(count - 1) ? (size_t)at : count - 2;
    const double low = big_endian(tag + 12 + 2 * k, 2), high = big_endian(tag + 14 + 2 * k, 2);
    linear[i] = (float)((low + (at - (double)k) * (high - low)) / 65535);
  }
  return true;
}

static bool read_curve(const struct profile *profile, const char *name, float linear[256]) {
  size_t bytes = 0;
  const uint8_t *tag = find_tag(profile, name, 12, &bytes);
  bool read = false;
  if (tag != NULL && memcmp(tag, "curv", 4) == 0) read = tabulated(tag, bytes, linear);
  if (tag != NULL && memcmp(tag, "para", 4) == 0) read = parametric(tag, bytes, linear);
  for (int i = 0; read && i < 256; i++) read = isfinite(linear[i]);
  return read;
}

/* matrix: from the profile's linear light over XYZ (D50) to linear sRGB. */
static bool read_matrix(const struct profile *profile, float matrix[3][3]) {
  /* the inverse of sRGB's colorants under D50 (Bradford) */
  static const double to_srgb[3][3] = {
      {3.1341359, -1.6173863, -0.4906619}, {-0.9787955, 1.9162544, 0.0334429}, {0.0719554, -0.2289769, 1.4053860}};
  static const char *const names[MATRIX_TAGS] = {"rXYZ", "gXYZ", "bXYZ"};
  for (int c = 0; c < MATRIX_TAGS; c++) {
    size_t bytes = 0;
    const uint8_t *tag = find_tag(profile, names[c], 20, &bytes);
    if (tag == NULL || memcmp(tag, "XYZ ", 4) != 0) return false;
    for (int row = 0; row < 3; row++) {
      matrix[row][c] = 0;
      for (size_t k = 0; k < 3; k++) matrix[row][c] += (float)(to_srgb[row][k] * fixed(tag + 8 + 4 * k));
    }
  }
  return true;
}

/* A profile of grey has one curve, and its white is sRGB's. */
static bool read_conversion(const struct profile *profile, struct conversion *conversion) {
  static const char *const curves[3] = {"rTRC", "gTRC", "bTRC"};
  if (profile->bytes < HEADER + 4 || memcmp(profile->data + 36, "acsp", 4) != 0 ||
      memcmp(profile->data + 20, "XYZ ", 4) != 0)
    return false;
  const bool grey = memcmp(profile->data + 16, "GRAY", 4) == 0;
  if (!grey && memcmp(profile->data + 16, "RGB ", 4) != 0) return false;
  for (int c = 0; c < 3; c++) {
    for (int k = 0; k < 3; k++) conversion->matrix[c][k] = c == k;
    if (!read_curve(profile, grey ? "kTRC" : curves[c], conversion->linear[c])) return false;
  }
  return grey || read_matrix(profile, conversion->matrix);
}

static double srgb_encoded(double x) { return x <= 0.0031308 ? 12.92 * x : 1.055 * pow(x, 1 / 2.4) - 0.055; }

/* Whether curves and matrix differ from sRGB's by roundings only: of 1/65536 in the profile, and of the published
 * colorants. */
static bool is_srgb(const struct conversion *conversion) {
  for (int c = 0; c < 3; c++) {
    for (int k = 0; k < 3; k++)
      if (fabsf(conversion->matrix[c][k] - (c == k)) > 2e-3F) return false;
    for (int i = 0; i < 256; i++)
      if (fabs(srgb_encoded(fmax((double)conversion->linear[c][i], 0)) * 255 - i) > 0.5) return false;
  }
  return true;
}

static void convert(struct conversion *conversion, ern_image *image) {
  const size_t count = (size_t)image->width * (size_t)image->height, channels = (size_t)image->channels;
  for (int i = 0; i <= LINEAR_STEPS; i++)
    conversion->encoded[i] = (uint8_t)(srgb_encoded((double)i / LINEAR_STEPS) * 255 + 0.5);
  uint8_t *pixel = image->data;
  for (size_t i = 0; i < count; i++, pixel += channels) {
    float linear[3];
    for (int c = 0; c < 3; c++) linear[c] = conversion->linear[c][pixel[c]];
    for (int c = 0; c < 3; c++) {
      const float *row = conversion->matrix[c];
      const float value = row[0] * linear[0] + row[1] * linear[1] + row[2] * linear[2];
      const float within = value > 0 ? value < 1 ? value : 1 : 0;
      pixel[c] = conversion->encoded[(int)(within * LINEAR_STEPS + 0.5F)];
    }
  }
}

ern_status ern_colour_profile_apply(ern_context *context, const char *path, const uint8_t *profile, size_t bytes,
                                    ern_image *image) {
  struct conversion *conversion = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(context, 1, &conversion));
  if (!read_conversion(&(struct profile){profile, bytes}, conversion))
    ern_log(
        context, ERN_LOG_WARNING,
        "%s: has a colour profile that is not one of RGB or grey by a matrix and curves; its colours are taken as sRGB",
        path);
  else if (!is_srgb(conversion))
    convert(conversion, image);
fail:
  ern_release(context, conversion);
  return status;
}
