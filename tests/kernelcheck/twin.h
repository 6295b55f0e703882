/* SPDX-License-Identifier: MIT
 * The same slots on two backends, the CPU's reference (0) and an OpenCL device (1): what one computes must be what the
 * other does. Spans lie at odd offsets between guards; whatever is written outside of one fails. */
#ifndef ERN_TEST_TWIN_H
#define ERN_TEST_TWIN_H

#include <math.h>

#include "../support.h"
#include "core/backend.h"
#include "core/rng.h"
#include "ernerf/backend.h"

enum { TWIN_GUARD = 37, TWIN_SPANS = 256 };
#define TWIN_POISON -7.25e7f /* no slot leaves it anywhere */

struct twin_span {
  ern_span on[2];
};
struct twin_rows {
  ern_rows on[2];
};

struct twin {
  ern_context *context;
  ern_backend *backend[2];
  struct ern_stream *stream[2];
  struct twin_span span[TWIN_SPANS];
  size_t spans;
};

/* Sizes around the edges of vectors and work-groups. */
static const size_t twin_sizes[] = {1, 2, 3, 7, 8, 15, 16, 17, 31, 33, 63, 64, 65, 127, 129, 255, 257, 1000};
enum { TWIN_MOST = 1000 };

/* ERNERF_TEST_SMALL is set, for simulators. */
static inline bool twin_is_small(void) {
  const char *small = getenv("ERNERF_TEST_SMALL");
  return small != NULL && small[0] != 0;
}
/* All of them; if small, those up to 65. */
static inline size_t twin_size_count(void) { return twin_is_small() ? 13 : sizeof twin_sizes / sizeof *twin_sizes; }
#define TWIN_SIZES twin_size_count()

/* The device is ERNERF_TEST_DEVICE, else 0; a build with OpenCL and no device fails. */
static inline void twin_open(struct twin *twin, ern_context *context) {
  const char *const names[] = {"cpu", "opencl"};
  const char *number = getenv("ERNERF_TEST_DEVICE");
  *twin = (struct twin){.context = context};
  for (int k = 0; k < 2; k++) {
    ern_backend_config config = ern_backend_config_default();
    config.name = names[k];
    config.isa = "ref";
    config.device = number != NULL ? atoi(number) : 0;
    support_ok(context, ern_backend_create(&twin->backend[k], context, &config));
    support_ok(context, twin->backend[k]->stream_make(twin->backend[k], 1, &twin->stream[k]));
  }
}

/* Frees the spans that were made since twin_open or the last twin_clear. */
static inline void twin_clear(struct twin *twin) {
  for (size_t i = 0; i < twin->spans; i++)
    for (int k = 0; k < 2; k++) twin->backend[k]->buffer_free(twin->backend[k], twin->span[i].on[k].buffer);
  twin->spans = 0;
}

static inline void twin_close(struct twin *twin) {
  twin_clear(twin);
  for (int k = 0; k < 2; k++) {
    twin->backend[k]->stream_free(twin->stream[k]);
    ern_backend_free(&twin->backend[k]);
  }
}

/* Poisoned room for `count` elements on both. */
static inline struct twin_span twin_take(struct twin *twin, ern_element element, size_t count) {
  const size_t all = count + 2 * TWIN_GUARD;
  struct twin_span made;
  assert_true(twin->spans < TWIN_SPANS);
  for (int k = 0; k < 2; k++) {
    struct ern_backend *backend = twin->backend[k];
    ern_span whole = {NULL, 0, all};
    support_ok(twin->context, backend->buffer_make(backend, element, all, &whole.buffer));
    float *reals = malloc(all * sizeof *reals);
    int32_t *ints = malloc(all * sizeof *ints);
    uint8_t *bytes = malloc(all);
    assert_true(reals != NULL && ints != NULL && bytes != NULL);
    for (size_t i = 0; i < all; i++) reals[i] = TWIN_POISON, ints[i] = -123456789, bytes[i] = 0xA5;
    if (element == ERN_ELEMENT_REAL)
      support_ok(twin->context, backend->upload_reals(twin->stream[k], whole, reals, all));
    if (element == ERN_ELEMENT_INT32)
      support_ok(twin->context, backend->upload_int32(twin->stream[k], whole, ints, all));
    if (element == ERN_ELEMENT_BYTE)
      support_ok(twin->context, backend->upload_bytes(twin->stream[k], whole, bytes, all));
    free(reals), free(ints), free(bytes);
    made.on[k] = (ern_span){whole.buffer, TWIN_GUARD, count};
  }
  return twin->span[twin->spans++] = made;
}

static inline struct twin_span twin_reals(struct twin *twin, const float *values, size_t count) {
  const struct twin_span made = twin_take(twin, ERN_ELEMENT_REAL, count);
  for (int k = 0; k < 2; k++)
    support_ok(twin->context, twin->backend[k]->upload_reals(twin->stream[k], made.on[k], values, count));
  return made;
}
static inline struct twin_span twin_int32s(struct twin *twin, const int32_t *values, size_t count) {
  const struct twin_span made = twin_take(twin, ERN_ELEMENT_INT32, count);
  for (int k = 0; k < 2; k++)
    support_ok(twin->context, twin->backend[k]->upload_int32(twin->stream[k], made.on[k], values, count));
  return made;
}
static inline struct twin_span twin_bytes(struct twin *twin, const uint8_t *values, size_t count) {
  const struct twin_span made = twin_take(twin, ERN_ELEMENT_BYTE, count);
  for (int k = 0; k < 2; k++)
    support_ok(twin->context, twin->backend[k]->upload_bytes(twin->stream[k], made.on[k], values, count));
  return made;
}

/* `rows` rows of n values, stride n + 5; values NULL: poison. values: [rows][n] */
static inline struct twin_rows twin_rows_of(struct twin *twin, const float *values, int rows, size_t n, ern_per per) {
  const size_t stride = n + 5;
  struct twin_rows made;
  const struct twin_span span = twin_take(twin, ERN_ELEMENT_REAL, stride * (size_t)rows);
  for (int k = 0; k < 2; k++) {
    made.on[k] = (ern_rows){span.on[k], stride, rows, per};
    for (int c = 0; c < rows && values != NULL; c++)
      support_ok(twin->context, twin->backend[k]->upload_reals(twin->stream[k], ern_span_of_row(made.on[k], c, n),
                                                               values + (size_t)c * n, n));
  }
  return made;
}

/* A guarded span with its guards, from backend k; the caller frees. */
static inline float *twin_down(struct twin *twin, int k, ern_span span) {
  const size_t all = span.count + 2 * TWIN_GUARD;
  float *values = malloc(all * sizeof *values);
  assert_non_null(values);
  const ern_span whole = {span.buffer, 0, all};
  support_ok(twin->context, twin->backend[k]->download_reals(twin->stream[k], values, whole, all));
  return values;
}

/* Equal infinities and NaN with NaN are near; else |found - expected| <= absolute + relative*|expected|. */
static inline bool twin_near(float found, float expected, double relative, double absolute) {
  if (found == expected || (isnan(found) && isnan(expected))) return true;
  return fabs((double)found - (double)expected) <= absolute + relative * fabs((double)expected);
}

/* Both computed the same, and nothing outside was touched. `count` may be less than the span's: the rest is untouched.
 */
static inline void twin_same(struct twin *twin, const char *what, struct twin_span span, double relative,
                             double absolute) {
  float *expected = twin_down(twin, 0, span.on[0]), *found = twin_down(twin, 1, span.on[1]);
  for (size_t i = 0; i < span.on[0].count + 2 * TWIN_GUARD; i++) {
    const bool guard = i < TWIN_GUARD || i >= span.on[0].count + TWIN_GUARD;
    if (guard ? found[i] == TWIN_POISON : twin_near(found[i], expected[i], relative, absolute)) continue;
    fail_msg("%s [%ld] of %zu: device %.9g, reference %.9g", what, (long)i - TWIN_GUARD, span.on[0].count,
             (double)found[i], (double)expected[i]);
  }
  free(expected);
  free(found);
}
static inline void twin_same_rows(struct twin *twin, const char *what, struct twin_rows rows, double relative,
                                  double absolute) {
  const struct twin_span span = {{rows.on[0].span, rows.on[1].span}};
  twin_same(twin, what, span, relative, absolute);
}

/* The same bits, zeros of different signs being different; which NaN comes of an operation is not settled. */
static inline void twin_same_bits(struct twin *twin, const char *what, struct twin_span span) {
  float *expected = twin_down(twin, 0, span.on[0]), *found = twin_down(twin, 1, span.on[1]);
  for (size_t i = 0; i < span.on[0].count + 2 * TWIN_GUARD; i++) {
    uint32_t a, b;
    memcpy(&a, expected + i, sizeof a);
    memcpy(&b, found + i, sizeof b);
    if (a == b || (isnan(expected[i]) && isnan(found[i]))) continue;
    fail_msg("%s [%ld] of %zu: device %.9g, reference %.9g", what, (long)i - TWIN_GUARD, span.on[0].count,
             (double)found[i], (double)expected[i]);
  }
  free(expected);
  free(found);
}

static inline void twin_same_int32(struct twin *twin, const char *what, struct twin_span span) {
  const size_t all = span.on[0].count + 2 * TWIN_GUARD;
  int32_t *values[2];
  for (int k = 0; k < 2; k++) {
    values[k] = malloc(all * sizeof(int32_t));
    assert_non_null(values[k]);
    const ern_span whole = {span.on[k].buffer, 0, all};
    support_ok(twin->context, twin->backend[k]->download_int32(twin->stream[k], values[k], whole, all));
  }
  for (size_t i = 0; i < all; i++)
    if (values[0][i] != values[1][i])
      fail_msg("%s [%ld]: device %d, reference %d", what, (long)i - TWIN_GUARD, values[1][i], values[0][i]);
  free(values[0]);
  free(values[1]);
}

/* |found - expected|_2 / |expected|_2; 0 where both are zero. */
static inline double twin_distance(struct twin *twin, struct twin_span span) {
  float *expected = twin_down(twin, 0, span.on[0]), *found = twin_down(twin, 1, span.on[1]);
  double difference = 0, size = 0;
  for (size_t i = TWIN_GUARD; i < span.on[0].count + TWIN_GUARD; i++) {
    difference += pow((double)found[i] - (double)expected[i], 2);
    size += pow((double)expected[i], 2);
  }
  free(expected);
  free(found);
  return difference == 0 ? 0 : sqrt(difference / size);
}

/* The same slot on both: f(backend, stream, k). */
#define TWIN_RUN(twin, slot, args)                                                           \
  for (int k_ = 0; k_ < 2; k_++) {                                                           \
    support_ok((twin)->context, (twin)->backend[k_]->slot((twin)->stream[k_], &(args)[k_])); \
    support_ok((twin)->context, (twin)->backend[k_]->settle((twin)->stream[k_]));            \
  }

/* (-scale, scale), the same for the same (seed, at). */
static inline float twin_random(uint64_t seed, size_t at, float scale) {
  return (2 * ern_uniform(ern_random_at(seed, 77, (uint32_t)at, ERN_RNG_INIT).word[0]) - 1) * scale;
}
static inline void twin_fill(float *values, size_t count, uint64_t seed, float scale) {
  for (size_t i = 0; i < count; i++) values[i] = twin_random(seed, i, scale);
}

#endif
