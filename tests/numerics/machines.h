/* SPDX-License-Identifier: MIT
 * One slot on everything that this machine can compute with: the reference in double (number 0, the truth), in float,
 * each instruction set, and the first OpenCL device in both forms of its kernels. Arrays lie between guards; results
 * are held against the truth, against bounds, and against limits that have a value. */
#ifndef ERN_TEST_MACHINES_H
#define ERN_TEST_MACHINES_H

#include <float.h>
#include <math.h>

#include "backend_cpu/cpu_kernels.h"
#include "core/rng.h"
#include "ernerf/backend.h"
#include "support.h"

enum { MACHINES = 8, MACHINE_SPANS = 256, MACHINE_GUARD = 21 };
#define MACHINE_POISON -7.25e7f /* no slot leaves it anywhere */

struct many {
  ern_span on[MACHINES];
};
struct many_rows {
  ern_rows on[MACHINES];
};

struct machines {
  ern_context *context;
  ern_backend *backend[MACHINES];
  struct ern_stream *stream[MACHINES];
  const char *name[MACHINES];
  int count;
  struct many span[MACHINE_SPANS];
  size_t spans;
};
static struct machines machines;

static inline void machines_add(const char *name, const char *isa, const char *form) {
  ern_backend_config config = ern_backend_config_default();
  config.name = isa != NULL ? "cpu" : "opencl";
  config.isa = isa;
  if (form != NULL) setenv("ERNERF_OPENCL_FORM", form, 1);
  const ern_status made = ern_backend_create(&machines.backend[machines.count], machines.context, &config);
  unsetenv("ERNERF_OPENCL_FORM");
  if (made == ERN_E_UNSUPPORTED && machines.count >= 2) return; /* not of this machine; anything else is a fault */
  support_ok(machines.context, made);
  support_ok(machines.context, machines.backend[machines.count]->stream_make(machines.backend[machines.count], 1,
                                                                             &machines.stream[machines.count]));
  machines.name[machines.count++] = name;
}

/* Says what it found, so that a log tells what was checked. */
static inline void machines_open_on(bool devices) {
  machines = (struct machines){.context = support_context()};
  static const char *const isas[] = {"ref64", "ref", "avx2", "avx512", "avx512bf16", "neon"};
  for (size_t k = 0; k < sizeof isas / sizeof *isas; k++) machines_add(isas[k], isas[k], NULL);
  if (devices) machines_add("opencl", NULL, "cpu");
  if (devices) machines_add("opencl_gpu", NULL, "gpu");
  for (int k = 0; k < machines.count; k++) printf("%s%s", machines.name[k], k + 1 < machines.count ? " " : "\n");
}

static inline void machines_open(void) { machines_open_on(true); }

static inline void machines_clear(void) {
  for (size_t i = 0; i < machines.spans; i++)
    for (int k = 0; k < machines.count; k++)
      machines.backend[k]->buffer_free(machines.backend[k], machines.span[i].on[k].buffer);
  machines.spans = 0;
}

static inline void machines_close(void) {
  machines_clear();
  for (int k = 0; k < machines.count; k++) {
    machines.backend[k]->stream_free(machines.stream[k]);
    ern_backend_free(&machines.backend[k]);
  }
  ern_context_free(&machines.context);
}

/* The slot on all of them; `call` is an expression of k that gives its arguments. */
#define ON_EACH(slot, type, ...)                                                                              \
  for (int k = 0; k < machines.count; k++) {                                                                  \
    struct type args_ = __VA_ARGS__;                                                                          \
    ern_status status_ = machines.backend[k]->slot(machines.stream[k], &args_);                               \
    if (status_ == ERN_OK) status_ = machines.backend[k]->settle(machines.stream[k]);                         \
    if (status_ != ERN_OK) fail_msg("%s: " #slot ": %s", machines.name[k], ern_last_error(machines.context)); \
  }

/* ---- arrays ---- */

static inline void machines_fill(int k, ern_span whole, const void *values, ern_element element) {
  ern_status status = ERN_OK;
  if (element == ERN_ELEMENT_REAL)
    status = machines.backend[k]->upload_reals(machines.stream[k], whole, values, whole.count);
  if (element == ERN_ELEMENT_INT32)
    status = machines.backend[k]->upload_int32(machines.stream[k], whole, values, whole.count);
  if (element == ERN_ELEMENT_BYTE)
    status = machines.backend[k]->upload_bytes(machines.stream[k], whole, values, whole.count);
  support_ok(machines.context, status);
}

/* Poisoned room for `count` elements between guards, filled with values unless they are NULL. */
static inline struct many many_of(ern_element element, const void *values, size_t count) {
  const size_t all = count + 2 * MACHINE_GUARD;
  struct many made = {0};
  assert_true(machines.spans < MACHINE_SPANS);
  float *poison = (float *)malloc(all * sizeof *poison); /* for integers and bytes any bits will do */
  assert_non_null(poison);
  for (size_t i = 0; i < all; i++) poison[i] = MACHINE_POISON;
  for (int k = 0; k < machines.count; k++) {
    struct ern_buffer *buffer = NULL;
    support_ok(machines.context, machines.backend[k]->buffer_make(machines.backend[k], element, all, &buffer));
    machines_fill(k, (ern_span){buffer, 0, all}, poison, element);
    made.on[k] = (ern_span){buffer, MACHINE_GUARD, count};
    if (values != NULL && count > 0) machines_fill(k, made.on[k], values, element);
  }
  free(poison);
  return machines.span[machines.spans++] = made;
}
static inline struct many many_reals(const float *values, size_t count) {
  return many_of(ERN_ELEMENT_REAL, values, count);
}
static inline struct many many_int32s(const int32_t *values, size_t count) {
  return many_of(ERN_ELEMENT_INT32, values, count);
}
static inline struct many many_room(size_t count) { return many_of(ERN_ELEMENT_REAL, NULL, count); }
static inline struct many many_zeros(size_t count) {
  const struct many made = many_room(count);
  for (int k = 0; k < machines.count; k++)
    support_ok(machines.context, machines.backend[k]->zero(machines.stream[k], made.on[k]));
  return made;
}

/* `rows` rows of n values, [rows][n], without room between them. */
static inline struct many_rows many_rows_of(struct many span, int rows, size_t n, ern_per per) {
  struct many_rows made = {0};
  for (int k = 0; k < machines.count; k++) made.on[k] = (ern_rows){span.on[k], n, rows, per};
  return made;
}

/* What machine k has there, in double: [count] with MACHINE_GUARD before and after it. The caller frees. */
static inline double *many_values(int k, struct many span) {
  const size_t all = span.on[k].count + 2 * MACHINE_GUARD;
  double *values = (double *)malloc(all * sizeof *values);
  float *floats = (float *)malloc(all * sizeof *floats);
  assert_true(values != NULL && floats != NULL);
  const ern_span whole = {span.on[k].buffer, 0, all};
  if (machines.backend[k]->real_bytes == sizeof *values) { /* of the CPU, as it lies there */
    memcpy(values, whole.buffer->memory, all * sizeof *values);
  } else {
    support_ok(machines.context, machines.backend[k]->download_reals(machines.stream[k], floats, whole, all));
    for (size_t i = 0; i < all; i++) values[i] = (double)floats[i];
  }
  free(floats);
  for (size_t i = 0; i < MACHINE_GUARD; i++)
    if (values[i] != (double)MACHINE_POISON || values[all - 1 - i] != (double)MACHINE_POISON)
      fail_msg("%s: written outside of an array of %zu", machines.name[k], span.on[k].count);
  return values;
}

/* Integers that machine k has there, [count]. The caller frees. */
static inline int32_t *many_int32_values(int k, struct many span) {
  int32_t *values = (int32_t *)calloc(span.on[k].count + 1, sizeof *values);
  assert_non_null(values);
  support_ok(machines.context,
             machines.backend[k]->download_int32(machines.stream[k], values, span.on[k], span.on[k].count));
  return values;
}

/* ---- what is expected ---- */

/* All values on all machines are finite and in [low, high]. */
static inline void expect_within(const char *what, struct many span, double low, double high) {
  for (int k = 0; k < machines.count; k++) {
    double *values = many_values(k, span);
    for (size_t i = 0; i < span.on[k].count; i++) {
      const double value = values[MACHINE_GUARD + i];
      if (!(isfinite(value) && value >= low && value <= high))
        fail_msg("%s: %s [%zu]: found %.9g, expected in [%g, %g]", machines.name[k], what, i, value, low, high);
    }
    free(values);
  }
}

/* Each as in double, but for relative |expected| + absolute; NaN where that has NaN, infinite where that is or does not
 * fit a float. */
static inline void expect_truth(const char *what, struct many span, double relative, double absolute) {
  double *truth = many_values(0, span);
  for (int k = 1; k < machines.count; k++) {
    double *values = many_values(k, span);
    for (size_t i = MACHINE_GUARD; i < span.on[k].count + MACHINE_GUARD; i++) {
      const double found = values[i], expected = truth[i];
      if ((isnan(found) && isnan(expected)) || (float)found == (float)expected) continue;
      if (fabs(found - expected) <= relative * fabs(expected) + absolute) continue;
      fail_msg("%s: %s [%zu]: found %.9g, in double %.9g +- %.1e", machines.name[k], what, i - MACHINE_GUARD, found,
               expected, relative * fabs(expected) + absolute);
    }
    free(values);
  }
  free(truth);
}

/* The same integers everywhere, in [low, high]. */
static inline void expect_int32s(const char *what, struct many span, int32_t low, int32_t high) {
  int32_t *truth = many_int32_values(0, span);
  for (int k = 0; k < machines.count; k++) {
    int32_t *values = many_int32_values(k, span);
    for (size_t i = 0; i < span.on[k].count; i++)
      if (values[i] != truth[i] || values[i] < low || values[i] > high)
        fail_msg("%s: %s [%zu]: found %d, in double %d, expected in [%d, %d]", machines.name[k], what, i, values[i],
                 truth[i], low, high);
    free(values);
  }
  free(truth);
}

/* Value `at` on all machines: `expected` but for `absolute`, or NaN where NaN is expected. */
static inline void expect_at(const char *what, struct many span, size_t at, double expected, double absolute) {
  for (int k = 0; k < machines.count; k++) {
    double *values = many_values(k, span);
    const double found = values[MACHINE_GUARD + at];
    free(values);
    if ((isnan(found) && isnan(expected)) || found == expected || fabs(found - expected) <= absolute) continue;
    fail_msg("%s: %s [%zu]: found %.9g, expected %.9g +- %.1e", machines.name[k], what, at, found, expected, absolute);
  }
}

/* [-scale, scale), the same for the same (seed, at) */
static inline float machines_random(uint64_t seed, size_t at, float scale) {
  return (2 * ern_uniform(ern_random_at(seed, 77, (uint32_t)at, ERN_RNG_INIT).word[0]) - 1) * scale;
}

/* For cmocka_run_group_tests. */
static inline int open_machines(void **state) {
  (void)state;
  machines_open();
  return 0;
}
static inline int close_machines(void **state) {
  (void)state;
  machines_close();
  return 0;
}

#define COUNT_OF(array) (sizeof(array) / sizeof *(array))

#endif
