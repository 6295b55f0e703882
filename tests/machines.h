/* SPDX-License-Identifier: MIT
 * Runs one slot on every compute unit of this computer: the reference, each instruction set, and the OpenCL device with
 * both forms of its kernels. Number 0 is the reference for the others, in float or in double. Arrays lie between
 * guards. They are filled with, and surrounded by, a special NaN ("poison"). */
#ifndef ERN_TEST_MACHINES_H
#define ERN_TEST_MACHINES_H

#include <float.h>
#include <math.h>
#include <stdbool.h>

#include "core/backend.h"
#include "core/rng.h"
#include "ernerf/backend.h"
#include "support.h"

enum { MACHINES = 8, MACHINE_SPANS = 256, MACHINE_GUARD = 37 };
#define COUNT_OF(array) (sizeof(array) / sizeof *(array))

struct many {
  ern_span on[MACHINES];
};
struct many_rows {
  ern_rows on[MACHINES];
};

/* The requested machines (compute units). NULL: all. */
struct machines_wish {
  bool in_double; /* number 0 is the double build, number 1 the float build */
  bool bf16;      /* also avx512bf16, which differs from avx512 only in rendered networks */
  bool tensor;    /* also the form of a device that computes layers by tensor cores */
  const char *isa;
  const char *backend; /* "cpu", "opencl" */
  void (*more)(void);  /* adds others, unless one instruction set or a device is requested; NULL: none */
};

struct machines {
  ern_context *context;
  ern_backend *backend[MACHINES];
  struct ern_stream *stream[MACHINES];
  const char *name[MACHINES];
  int count;
  struct many span[MACHINE_SPANS];
  size_t spans;
  uint64_t seed;         /* of all random numbers of a run; 0 unless asked for */
  size_t checks;         /* arrays of machines other than number 0 that were compared */
  double peak[MACHINES]; /* operations a second, measured by kernelcheck's harness; 0: not measured */
  void *held[4096];      /* memory that machines_clear frees */
  size_t holds;
};
extern struct machines machines;

#define EACH_MACHINE(k) for (int k = 0; k < machines.count; k++)
#define EACH_OTHER(k) for (int k = 1; k < machines.count; k++)

/* Opens the machines of the wish that this computer has. */
void machines_open_as(const struct machines_wish *wish);
/* Opens all of them, number 0 in double, and prints them, so that a log shows what was checked. */
void machines_open_on(bool devices);
void machines_add(const char *name, const char *isa, const char *form);
/* Whether the kernels' form for CPUs is checked too: not on a GPU, whose compiler takes minutes for its vectors of 16.
 */
bool has_form_for_cpus(const ern_backend *backend);
/* Free the arrays, and the memory of held_memory, that were created since machines were opened, or since a mark. */
struct machines_mark {
  size_t spans, holds;
};
void machines_clear(void);
struct machines_mark machines_mark(void);
void machines_clear_to(struct machines_mark mark);
void machines_close(void);
int open_machines(void **state); /* for cmocka_run_group_tests */
int open_hosts(void **state); /* without devices, which build kernels for seconds; with ERNERF_TEST_LONG also these */
int close_machines(void **state);
bool is_device(int k); /* one of OpenCL */
bool in_double(int k);
/* The kernels that the slots of machine k call; NULL for a device and for the double build. */
struct ern_cpu_kernels;
const struct ern_cpu_kernels *kernels_of(int k);
/* The elements of a span in the memory of such a kernel. */
float *host_reals(int k, ern_span span);
void *host_memory(int k, ern_span span); /* of integers and bytes too */

/* Around a slot of machine k: a crash in between names both on standard error before it ends the process. The second
 * waits for the slot, which returned `status`, and fails the test unless it is ERN_OK. */
void machines_begin(int k, const char *slot);
void machines_done(int k, const char *slot, ern_status status);
/* Run the slot on one machine, or on all; args: one for each machine. */
#define RUN_ON(k, slot, args) \
  (machines_begin(k, #slot), machines_done(k, #slot, machines.backend[k]->slot(machines.stream[k], args)))
#define RUN(slot, args) \
  EACH_MACHINE (k_) RUN_ON(k_, slot, &(args)[k_])
/* Runs the slot on all machines; the last argument is an expression of k for the slot's arguments. */
#define ON_EACH(slot, type, ...)     \
  EACH_MACHINE (k) {                 \
    struct type args_ = __VA_ARGS__; \
    RUN_ON(k, slot, &args_);         \
  }

/* ---- arrays ---- */

float machines_poison(void);
bool is_poison(float value);
/* Zeroed memory that lives until machines_clear. */
void *held_memory(size_t count, size_t bytes);

void machines_fill(int k, ern_span whole, const void *values, ern_element element);
/* Poisoned memory for `count` elements between guards, every second one aligned to 64 elements, filled with values
 * unless they are NULL. */
struct many many_of(ern_element element, const void *values, size_t count);
static inline struct many many_reals(const float *values, size_t count) {
  return many_of(ERN_ELEMENT_REAL, values, count);
}
static inline struct many many_int32s(const int32_t *values, size_t count) {
  return many_of(ERN_ELEMENT_INT32, values, count);
}
static inline struct many many_empty(size_t count) { return many_of(ERN_ELEMENT_REAL, NULL, count); }
struct many many_zeros(size_t count);
/* Inputs that end at the end of their memory, so that a sanitizer detects reads past them. */
struct many many_exact(ern_element element, const void *values, size_t count);
/* Overwrites values. */
void many_set(struct many span, size_t at, const float *values, size_t count);

/* `rows` rows of n values, [rows][n], without room between them. */
struct many_rows many_rows_of(struct many span, int rows, size_t n, ern_per per);
/* The same with n + 5 from row to row, poison between them; values NULL: poison. */
struct many_rows many_strided(const float *values, int rows, size_t n, ern_per per);
static inline struct many of_rows(struct many_rows rows) {
  struct many made = {0};
  EACH_MACHINE (k) made.on[k] = rows.on[k].span;
  return made;
}

/* The values of machine k in double: [count], with MACHINE_GUARD values before and after, which must be intact. The
 * caller frees them. */
double *many_values(int k, struct many span);
int32_t *many_int32_values(int k, struct many span); /* [count]; the caller frees */
/* The values of machine k, [count], within intact guards; valid until machines_clear. Counts as a check for machines
 * other than number 0. */
const float *floats_of(int k, struct many span);
const int32_t *int32s_of(int k, struct many span);
const uint8_t *bytes_of(int k, struct many span);

/* ---- expectations ---- */

/* Equal numbers, NaN with NaN, or |found - expected| <= relative |expected| + absolute; poison with poison alone. */
bool is_near(float found, float expected, double relative, double absolute);
bool same_bits(float found, float expected); /* but NaN equals NaN: machines differ in which NaN an operation gives */
/* Each other machine must give the values of number 0. */
void expect_bits(const char *what, struct many span);
void expect_near(const char *what, struct many span, double relative, double absolute);
void expect_near_on(int k, const char *what, struct many span, double relative, double absolute);
void expect_same_int32s(const char *what, struct many span);
void expect_same_bytes(const char *what, struct many span);
/* |found - expected|_2 / |expected|_2; 0 where both are zero. A check. */
double distance_of(int k, struct many span);

/* All values on all machines are finite and in [low, high]. */
void expect_within(const char *what, struct many span, double low, double high);
/* Each machine must give the values of the double build within relative |expected| + absolute; NaN where it has NaN,
 * infinite where it is infinite or does not fit a float. */
void expect_truth(const char *what, struct many span, double relative, double absolute);
/* All machines must give the same integers, in [low, high]. */
void expect_int32s(const char *what, struct many span, int32_t low, int32_t high);
/* Value `at` on all machines must be `expected` within `absolute`, or NaN if NaN is expected. */
void expect_at(const char *what, struct many span, size_t at, double expected, double absolute);

/* ---- random numbers, the same for the same (seed, at) ---- */

uint64_t machines_seed(uint64_t seed); /* derived from the seed of the run */
struct ern_random words_at(uint64_t seed, uint64_t step, size_t at);
float machines_random(uint64_t seed, size_t at, float scale); /* [-scale, scale) */

#endif
