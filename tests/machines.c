/* SPDX-License-Identifier: MIT
 * The machines that a test computes on, arrays on all of them, and comparisons. */
#include "machines.h"

#include <signal.h>
#include <unistd.h>

#include "backend_cpu/cpu_kernels.h"
#include "backend_cpu/cpu_state.h"

struct machines machines;

/* A signalling NaN: what is added to it, even where that should not be touched at all, makes it a quiet one. */
#define POISON_BITS 0x7fa5a5a5u
#define QUIET_BIT 0x00400000u

float machines_poison(void) {
  const uint32_t bits = POISON_BITS;
  float value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

bool is_poison(float value) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  return bits == POISON_BITS;
}

/* ---- machines ---- */

bool is_device(int k) { return strcmp(machines.backend[k]->name, "opencl") == 0; }
bool in_double(int k) { return machines.backend[k]->real_bytes == sizeof(double); }

const struct ern_cpu_kernels *kernels_of(int k) {
  if (is_device(k) || in_double(k)) return NULL;
  return ((const struct ern_cpu_backend *)machines.backend[k])->kernels;
}

/* The double build's memory converts it, which makes it quiet. */
static void restore_poison(int k, float *values, size_t count) {
  for (size_t i = 0; i < count && in_double(k); i++) {
    uint32_t bits;
    memcpy(&bits, values + i, sizeof bits);
    if (bits != (POISON_BITS | QUIET_BIT)) continue;
    bits = POISON_BITS;
    memcpy(values + i, &bits, sizeof bits);
  }
}

float *host_reals(int k, ern_span span) { return host_memory(k, span); }

void *host_memory(int k, ern_span span) {
  static const size_t bytes[] = {[ERN_ELEMENT_REAL] = 4, [ERN_ELEMENT_INT32] = 4, [ERN_ELEMENT_BYTE] = 1};
  if (kernels_of(k) == NULL) return NULL;
  return (uint8_t *)span.buffer->memory + span.at * bytes[span.buffer->element];
}

void machines_add(const char *name, const char *isa, const char *form) {
  ern_backend_config config = ern_backend_config_default();
  const char *device = getenv("ERNERF_TEST_DEVICE"), *asked = getenv("ERNERF_OPENCL_FORM");
  const int k = machines.count;
  config.name = isa != NULL ? "cpu" : "opencl";
  config.isa = isa;
  config.device = device != NULL ? atoi(device) : 0;
  if (form != NULL && asked != NULL && strcmp(form, asked) != 0) return;
  assert_true(k < MACHINES);
  if (form != NULL) setenv("ERNERF_OPENCL_FORM", form, 1);
  const ern_status made = ern_backend_create(&machines.backend[k], machines.context, &config);
  if (form != NULL && asked == NULL) unsetenv("ERNERF_OPENCL_FORM");
  if (made == ERN_E_UNSUPPORTED && k > 0) return; /* not of this machine; anything else is a fault */
  support_ok(machines.context, made);
  support_ok(machines.context, machines.backend[k]->stream_make(machines.backend[k], 1, &machines.stream[k]));
  machines.name[machines.count++] = name;
}

void machines_open_as(const struct machines_wish *wish) {
  static const char *const isas[] = {"avx2", "avx512", "avx512bf16", "neon"};
  const bool cpu = wish->backend == NULL || strcmp(wish->backend, "cpu") == 0;
  const bool opencl = (wish->backend == NULL || strcmp(wish->backend, "opencl") == 0) && wish->isa == NULL;
  machines = (struct machines){.context = support_context(), .seed = machines.seed, .checks = machines.checks};
  if (wish->in_double) machines_add("ref64", "ref64", NULL);
  machines_add("ref", "ref", NULL);
  for (size_t i = 0; i < COUNT_OF(isas) && cpu; i++) {
    if (wish->isa != NULL && strcmp(wish->isa, isas[i]) != 0) continue;
    if (wish->bf16 || strcmp(isas[i], "avx512bf16") != 0) machines_add(isas[i], isas[i], NULL);
  }
  if (cpu && wish->more != NULL && wish->isa == NULL) wish->more();
  const char *asked = getenv("ERNERF_OPENCL_FORM");
  if (opencl) machines_add("opencl_gpu", NULL, "gpu");
  if (opencl && has_form_for_cpus(machines.backend[machines.count - 1])) machines_add("opencl", NULL, "cpu");
  if (opencl && (wish->tensor || (asked != NULL && strcmp(asked, "tensor") == 0)))
    machines_add("opencl_tensor", NULL, "tensor");
}

void machines_open_on(bool devices) {
  machines_open_as(&(struct machines_wish){.in_double = true, .bf16 = true, .backend = devices ? NULL : "cpu"});
  EACH_MACHINE (k) printf("%s%s", machines.name[k], k + 1 < machines.count ? " " : "\n");
}

int open_machines(void **state) {
  (void)state;
  machines_open_on(true);
  return 0;
}

int open_hosts(void **state) {
  (void)state;
  machines_open_on(getenv("ERNERF_TEST_LONG") != NULL);
  return 0;
}

struct machines_mark machines_mark(void) {
  return (struct machines_mark){machines.spans, machines.holds};
}

void machines_clear_to(struct machines_mark mark) {
  for (; machines.spans > mark.spans; machines.spans--)
    EACH_MACHINE (k)
      machines.backend[k]->buffer_free(machines.backend[k], machines.span[machines.spans - 1].on[k].buffer);
  for (; machines.holds > mark.holds; machines.holds--) free(machines.held[machines.holds - 1]);
}

void machines_clear(void) { machines_clear_to((struct machines_mark){0, 0}); }

void machines_close(void) {
  machines_clear();
  EACH_MACHINE (k) {
    machines.backend[k]->stream_free(machines.stream[k]);
    ern_backend_free(&machines.backend[k]);
  }
  ern_context_free(&machines.context);
}

int close_machines(void **state) {
  (void)state;
  machines_close();
  return 0;
}

static char running[128]; /* a sentence on the slot that runs */
static const int crashes[] = {SIGSEGV, SIGBUS, SIGILL, SIGFPE, SIGABRT};
static struct sigaction handlers[COUNT_OF(crashes)]; /* cmocka's */

/* Raised once more, for the answer of the system, which SA_RESETHAND has put back. */
static void name_the_slot(int number) {
  if (write(STDERR_FILENO, running, strlen(running)) < 0) _exit(128 + number);
  raise(number);
}

void machines_begin(int k, const char *slot) {
  struct sigaction named = {.sa_handler = name_the_slot, .sa_flags = (int)SA_RESETHAND};
  snprintf(running, sizeof running, "crashed in %s on %s\n", slot, machines.name[k]);
  for (size_t i = 0; i < COUNT_OF(crashes); i++) sigaction(crashes[i], &named, &handlers[i]);
}

void machines_done(int k, const char *slot, ern_status status) {
  if (status == ERN_OK) status = machines.backend[k]->synchronize(machines.stream[k]);
  for (size_t i = 0; i < COUNT_OF(crashes); i++) sigaction(crashes[i], &handlers[i], NULL);
  if (status != ERN_OK) fail_msg("%s: %s: %s", machines.name[k], slot, ern_last_error(machines.context));
}

/* ---- arrays ---- */

void *held_memory(size_t count, size_t bytes) {
  assert_true(machines.holds < COUNT_OF(machines.held));
  void *memory = calloc(count > 0 ? count : 1, bytes);
  assert_non_null(memory);
  return machines.held[machines.holds++] = memory;
}

void machines_fill(int k, ern_span whole, const void *values, ern_element element) {
  struct ern_backend *backend = machines.backend[k];
  struct ern_stream *stream = machines.stream[k];
  ern_status status = ERN_OK;
  if (element == ERN_ELEMENT_REAL) status = backend->upload_reals(stream, whole, values, whole.count);
  if (element == ERN_ELEMENT_INT32) status = backend->upload_int32(stream, whole, values, whole.count);
  if (element == ERN_ELEMENT_BYTE) status = backend->upload_bytes(stream, whole, values, whole.count);
  support_ok(machines.context, status);
}

static struct many many_between(ern_element element, const void *values, size_t count, size_t before, size_t after) {
  const size_t all = before + count + after;
  struct many made = {0};
  assert_true(machines.spans < MACHINE_SPANS);
  float *poison = malloc((all + 1) * sizeof *poison); /* for integers and bytes any bits will do */
  assert_non_null(poison);
  for (size_t i = 0; i < all; i++) poison[i] = machines_poison();
  EACH_MACHINE (k) {
    struct ern_buffer *buffer = NULL;
    support_ok(machines.context, machines.backend[k]->buffer_make(machines.backend[k], element, all, &buffer));
    machines_fill(k, (ern_span){buffer, 0, all}, poison, element);
    made.on[k] = (ern_span){buffer, before, count};
    if (values != NULL && count > 0) machines_fill(k, made.on[k], values, element);
  }
  free(poison);
  return machines.span[machines.spans++] = made;
}

struct many many_of(ern_element element, const void *values, size_t count) {
  return many_between(element, values, count, machines.spans % 2 ? 64 : MACHINE_GUARD, MACHINE_GUARD);
}

struct many many_exact(ern_element element, const void *values, size_t count) {
  return many_between(element, values, count, machines.spans % 2 ? 64 : MACHINE_GUARD, count == 0);
}

struct many many_zeros(size_t count) {
  const struct many made = many_empty(count);
  EACH_MACHINE (k) support_ok(machines.context, machines.backend[k]->zero(machines.stream[k], made.on[k]));
  return made;
}

void many_set(struct many span, size_t at, const float *values, size_t count) {
  EACH_MACHINE (k) machines_fill(k, ern_span_part(span.on[k], at, count), values, ERN_ELEMENT_REAL);
}

struct many_rows many_rows_of(struct many span, int rows, size_t n, ern_per per) {
  struct many_rows made = {0};
  EACH_MACHINE (k) made.on[k] = (ern_rows){span.on[k], n, rows, per};
  return made;
}

struct many_rows many_strided(const float *values, int rows, size_t n, ern_per per) {
  const size_t stride = n + 5;
  const struct many span = many_empty(stride * (size_t)rows);
  struct many_rows made = {0};
  EACH_MACHINE (k) {
    made.on[k] = (ern_rows){span.on[k], stride, rows, per};
    for (int c = 0; c < rows && values != NULL && n > 0; c++)
      machines_fill(k, ern_span_of_row(made.on[k], c, n), values + (size_t)c * n, ERN_ELEMENT_REAL);
  }
  return made;
}

static void written_outside(int k, struct many span, size_t i) {
  fail_msg("%s: written at %ld of an array of %zu", machines.name[k], (long)i - MACHINE_GUARD, span.on[k].count);
}

static ern_span with_guards(ern_span span) {
  return (ern_span){span.buffer, span.at - MACHINE_GUARD, span.count + 2 * MACHINE_GUARD};
}

double *many_values(int k, struct many span) {
  const ern_span whole = with_guards(span.on[k]);
  double *values = malloc(whole.count * sizeof *values);
  float *floats = malloc(whole.count * sizeof *floats);
  assert_true(values != NULL && floats != NULL);
  support_ok(machines.context, machines.backend[k]->download_reals(machines.stream[k], floats, whole, whole.count));
  restore_poison(k, floats, whole.count);
  for (size_t i = 0; i < MACHINE_GUARD; i++) {
    if (!is_poison(floats[i])) written_outside(k, span, i);
    if (!is_poison(floats[whole.count - 1 - i])) written_outside(k, span, whole.count - 1 - i);
  }
  for (size_t i = 0; i < whole.count; i++) values[i] = (double)floats[i];
  if (in_double(k)) /* of the CPU, as it lies there */
    memcpy(values, (const double *)whole.buffer->memory + whole.at, whole.count * sizeof *values);
  free(floats);
  return values;
}

int32_t *many_int32_values(int k, struct many span) {
  int32_t *values = calloc(span.on[k].count + 1, sizeof *values);
  assert_non_null(values);
  memcpy(values, int32s_of(k, span), span.on[k].count * sizeof *values);
  return values;
}

const float *floats_of(int k, struct many span) {
  const ern_span whole = with_guards(span.on[k]);
  float *values = held_memory(whole.count, sizeof *values);
  support_ok(machines.context, machines.backend[k]->download_reals(machines.stream[k], values, whole, whole.count));
  restore_poison(k, values, whole.count);
  for (size_t i = 0; i < whole.count; i++)
    if ((i < MACHINE_GUARD || i >= whole.count - MACHINE_GUARD) && !is_poison(values[i])) written_outside(k, span, i);
  machines.checks += k > 0;
  return values + MACHINE_GUARD;
}

const int32_t *int32s_of(int k, struct many span) {
  const ern_span whole = with_guards(span.on[k]);
  int32_t *values = held_memory(whole.count, sizeof *values);
  support_ok(machines.context, machines.backend[k]->download_int32(machines.stream[k], values, whole, whole.count));
  for (size_t i = 0; i < whole.count; i++)
    if ((i < MACHINE_GUARD || i >= whole.count - MACHINE_GUARD) && values[i] != (int32_t)POISON_BITS)
      written_outside(k, span, i);
  machines.checks += k > 0;
  return values + MACHINE_GUARD;
}

/* Guards of bytes are the bytes of floats from the buffer's begin on. */
const uint8_t *bytes_of(int k, struct many span) {
  const ern_span whole = with_guards(span.on[k]);
  const float poison = machines_poison();
  uint8_t *values = held_memory(whole.count, 1), mark[sizeof poison];
  memcpy(mark, &poison, sizeof mark);
  support_ok(machines.context, machines.backend[k]->download_bytes(machines.stream[k], values, whole, whole.count));
  for (size_t i = 0; i < whole.count; i++)
    if ((i < MACHINE_GUARD || i >= whole.count - MACHINE_GUARD) && values[i] != mark[(whole.at + i) % sizeof mark])
      written_outside(k, span, i);
  machines.checks += k > 0;
  return values + MACHINE_GUARD;
}

/* ---- what is expected ---- */

bool is_near(float found, float expected, double relative, double absolute) {
  if (found == expected) return true;
  if (isnan(found) && isnan(expected)) return is_poison(found) == is_poison(expected);
  return fabs((double)found - (double)expected) <= absolute + relative * fabs((double)expected);
}

bool same_bits(float found, float expected) {
  return memcmp(&found, &expected, sizeof found) == 0 ||
         (isnan(found) && isnan(expected) && !is_poison(found) && !is_poison(expected));
}

void expect_bits(const char *what, struct many span) {
  const float *expected = floats_of(0, span);
  EACH_OTHER (k) {
    const float *found = floats_of(k, span);
    for (size_t i = 0; i < span.on[k].count; i++)
      if (!same_bits(found[i], expected[i]))
        fail_msg("%s: %s [%zu] of %zu: %.9g, reference %.9g", machines.name[k], what, i, span.on[k].count,
                 (double)found[i], (double)expected[i]);
  }
}

void expect_near_on(int k, const char *what, struct many span, double relative, double absolute) {
  const float *expected = floats_of(0, span), *found = floats_of(k, span);
  for (size_t i = 0; i < span.on[k].count; i++)
    if (!is_near(found[i], expected[i], relative, absolute))
      fail_msg("%s: %s [%zu] of %zu: %.9g, reference %.9g +- %.1e", machines.name[k], what, i, span.on[k].count,
               (double)found[i], (double)expected[i], relative * fabs((double)expected[i]) + absolute);
}

void expect_near(const char *what, struct many span, double relative, double absolute) {
  EACH_OTHER (k) expect_near_on(k, what, span, relative, absolute);
}

void expect_same_int32s(const char *what, struct many span) {
  const int32_t *expected = int32s_of(0, span);
  EACH_OTHER (k) {
    const int32_t *found = int32s_of(k, span);
    for (size_t i = 0; i < span.on[k].count; i++)
      if (found[i] != expected[i])
        fail_msg("%s: %s [%zu]: %d, reference %d", machines.name[k], what, i, found[i], expected[i]);
  }
}

void expect_same_bytes(const char *what, struct many span) {
  const uint8_t *expected = bytes_of(0, span);
  EACH_OTHER (k) {
    const uint8_t *found = bytes_of(k, span);
    for (size_t i = 0; i < span.on[k].count; i++)
      if (found[i] != expected[i])
        fail_msg("%s: %s [%zu]: %d, reference %d", machines.name[k], what, i, found[i], expected[i]);
  }
}

double distance_of(int k, struct many span) {
  const float *expected = floats_of(0, span), *found = floats_of(k, span);
  double difference = 0, size = 0;
  for (size_t i = 0; i < span.on[k].count; i++) {
    difference += pow((double)found[i] - (double)expected[i], 2);
    size += pow((double)expected[i], 2);
  }
  return difference == 0 ? 0 : sqrt(difference / size);
}

void expect_within(const char *what, struct many span, double low, double high) {
  EACH_MACHINE (k) {
    double *values = many_values(k, span);
    for (size_t i = 0; i < span.on[k].count; i++) {
      const double value = values[MACHINE_GUARD + i];
      if (!(isfinite(value) && value >= low && value <= high))
        fail_msg("%s: %s [%zu]: found %.9g, expected in [%g, %g]", machines.name[k], what, i, value, low, high);
    }
    free(values);
  }
}

void expect_truth(const char *what, struct many span, double relative, double absolute) {
  double *truth = many_values(0, span);
  EACH_OTHER (k) {
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

void expect_int32s(const char *what, struct many span, int32_t low, int32_t high) {
  int32_t *truth = many_int32_values(0, span);
  EACH_MACHINE (k) {
    int32_t *values = many_int32_values(k, span);
    for (size_t i = 0; i < span.on[k].count; i++)
      if (values[i] != truth[i] || values[i] < low || values[i] > high)
        fail_msg("%s: %s [%zu]: found %d, in double %d, expected in [%d, %d]", machines.name[k], what, i, values[i],
                 truth[i], low, high);
    free(values);
  }
  free(truth);
}

void expect_at(const char *what, struct many span, size_t at, double expected, double absolute) {
  EACH_MACHINE (k) {
    double *values = many_values(k, span);
    const double found = values[MACHINE_GUARD + at];
    free(values);
    if ((isnan(found) && isnan(expected)) || found == expected || fabs(found - expected) <= absolute) continue;
    fail_msg("%s: %s [%zu]: found %.9g, expected %.9g +- %.1e", machines.name[k], what, at, found, expected, absolute);
  }
}

/* ---- random numbers ---- */

uint64_t machines_seed(uint64_t seed) { return seed + (machines.seed << 32); }

struct ern_random words_at(uint64_t seed, uint64_t step, size_t at) {
  return ern_random_at(machines_seed(seed), step, (uint32_t)at, ERN_RNG_INIT);
}

float machines_random(uint64_t seed, size_t at, float scale) {
  return (2 * ern_uniform(words_at(seed, 77, at).word[0]) - 1) * scale;
}
