/* SPDX-License-Identifier: MIT
 * What OpenCL devices and drivers do not do (backend_opencl/device/limits.h), simulated one by one by
 * faults/opencl_faults.c. A line of that list without a test here does not compile. */
#include "support.h"

#include <ctype.h>
#include <sys/resource.h>
#include <unistd.h>

#include "backend_opencl/device/kernel_sources.h"
#include "backend_opencl/device/limits.h"
#include "backend_opencl/device/peak.h"
#include "backend_opencl/device/program.h"
#include "backend_opencl/opencl.h"
#include "ernerf/backend.h"
#include "hashgrid/hashgrid.h"
#include "mlp/mlp_ops.h"
#include "train/optimizer_ops.h"

struct bench {
  ern_context *context;
  struct ern_backend *backend;
  struct ern_stream *stream;
};

static void set(const char *name, long long value) {
  char text[32];
  snprintf(text, sizeof text, "%lld", value);
  assert_int_equal(value != 0 ? setenv(name, text, 1) : unsetenv(name), 0);
}

static ern_status backend_make(struct bench *b, const char *form) {
  ern_backend_config config = ern_backend_config_default();
  const char *number = getenv("ERNERF_TEST_DEVICE");
  *b = (struct bench){.context = support_context()};
  config.name = "opencl";
  config.device = number != NULL ? atoi(number) : 0;
  assert_int_equal(setenv("ERNERF_OPENCL_FORM", form, 1), 0);
  const ern_status status = ern_backend_create(&b->backend, b->context, &config);
  assert_int_equal(unsetenv("ERNERF_OPENCL_FORM"), 0);
  return status;
}
static void bench_open(struct bench *b, const char *form) {
  const ern_status status = backend_make(b, form);
  support_ok(b->context, status);
  support_ok(b->context, b->backend->stream_make(b->backend, 1, &b->stream));
}
static void bench_close(struct bench *b) {
  if (b->stream != NULL) b->backend->stream_free(b->stream);
  ern_backend_free(&b->backend);
  ern_context_free(&b->context);
}
static struct ern_cl_device *device_of(const struct bench *b) { return &((struct ern_cl_backend *)b->backend)->device; }

static ern_span take(struct bench *b, size_t count, const float *values) {
  ern_span span;
  support_ok(b->context, ern_scratch_take(b->stream, ERN_ELEMENT_REAL, count, &span));
  support_ok(b->context, b->backend->upload_reals(b->stream, span, values, count));
  return span;
}

/* A small kernel: average + (1 - 0.5)(parameters - average). */
static void run_small(struct bench *b) {
  const float average[2] = {2, 4}, parameters[2] = {4, 8};
  struct ern_ema_args args = {take(b, 2, average), take(b, 2, parameters), 0.5f, 2};
  float found[2] = {0};
  support_ok(b->context, b->backend->ema(b->stream, &args));
  support_ok(b->context, b->backend->download_reals(b->stream, found, args.average, 2));
  assert_true(found[0] == 3 && found[1] == 6);
}

enum { SIDE = 256, SAMPLES = 50 };

/* A layer of 256 x 256, whose tile is larger than 32 KiB where the device has more. */
static ern_status run_layer(struct bench *b, float y[SIDE * SAMPLES]) {
  static float x[SIDE * SAMPLES], weights[SIDE * SIDE];
  for (size_t i = 0; i < SIDE * SAMPLES; i++) x[i] = (float)(i % 7);
  for (size_t i = 0; i < SIDE * SIDE; i++) weights[i] = (float)(i % 5) - 2;
  const struct ern_arena_mark mark = ern_arena_mark(b->stream);
  struct ern_mlp_fwd_args args = {.y = {take(b, SIDE * SAMPLES, y), SAMPLES, SIDE, ERN_PER_SAMPLE},
                                  .x = {{take(b, SIDE * SAMPLES, x), SAMPLES, SIDE, ERN_PER_SAMPLE}},
                                  .pieces = 1,
                                  .parameters = take(b, SIDE * SIDE, weights),
                                  .mlp = {.layers = 1, .width = {SIDE, SIDE}},
                                  .n = SAMPLES};
  const ern_status status = b->backend->mlp_fwd(b->stream, &args);
  support_ok(b->context, b->backend->download_reals(b->stream, y, args.y.span, SIDE * SAMPLES));
  ern_arena_release(b->stream, mark);
  return status;
}

/* ---- memory ------------------------------------------------------------------------------------------------------ */

/* Buffers and spans of more bytes are cleared nevertheless. */
static void test_fill_bytes(void **state) {
  const size_t most = ERN_CL_LIMIT_fill_bytes, count = most / sizeof(float) + 64;
  const float one = 1;
  struct bench b;
  struct ern_buffer *buffer = NULL;
  (void)state;
  bench_open(&b, "cpu");
  set("ERNERF_FAULT_FILL", (long long)most + 1);
  support_ok(b.context, b.backend->buffer_make(b.backend, ERN_ELEMENT_REAL, count, &buffer));
  const ern_span all = {buffer, 0, count}, end[2] = {{buffer, 0, 1}, {buffer, count - 1, 1}};
  for (int i = 0; i < 2; i++) { /* cleared as it is made, then by `zero` */
    for (int e = 0; e < 2; e++) {
      float value = 1;
      support_ok(b.context, b.backend->download_reals(b.stream, &value, end[e], 1));
      assert_true(value == 0);
      support_ok(b.context, b.backend->upload_reals(b.stream, end[e], &one, 1));
    }
    support_ok(b.context, b.backend->zero(b.stream, all));
  }
  b.backend->buffer_free(b.backend, buffer);
  set("ERNERF_FAULT_FILL", 0);
  bench_close(&b);
}

static void refuse_buffer(struct bench *b, size_t bytes) {
  struct ern_buffer *buffer = NULL;
  char found[64];
  snprintf(found, sizeof found, "a buffer of %zu bytes is needed", bytes);
  support_expect(b->context, b->backend->buffer_make(b->backend, ERN_ELEMENT_BYTE, bytes, &buffer), ERN_E_NO_MEMORY,
                 "OpenCL", "too little memory", found, NULL);
  assert_null(buffer);
  assert_int_equal(atomic_load(&((struct ern_cl_backend *)b->backend)->taken), 0);
}

enum { LITTLE = 1 << 20 };

static void test_buffer_bytes(void **state) {
  struct bench b;
  struct ern_buffer *buffer = NULL;
  (void)state;
  set("ERNERF_FAULT_MEMORY", 2 * LITTLE);
  bench_open(&b, "cpu");
  assert_int_equal(device_of(&b)->buffer_bytes, LITTLE);
  refuse_buffer(&b, LITTLE + 1);
  support_ok(b.context, b.backend->buffer_make(b.backend, ERN_ELEMENT_BYTE, LITTLE, &buffer));
  b.backend->buffer_free(b.backend, buffer);
  set("ERNERF_FAULT_MEMORY", 0);
  bench_close(&b);
}

/* The same error as where a buffer is refused at once, and the buffer is given back. */
static void test_first_use(void **state) {
  struct bench b;
  (void)state;
  bench_open(&b, "cpu");
  set("ERNERF_FAULT_FIRST_USE", 1);
  set("ERNERF_FAULT_MEMORY", LITTLE);
  for (int i = 0; i < 3; i++) refuse_buffer(&b, LITTLE + 1);
  set("ERNERF_FAULT_MEMORY", 0);
  set("ERNERF_FAULT_FIRST_USE", 0);
  bench_close(&b);
}

/* A process that may have little more: of a buffer and of a program it is said, and both are made once it may. */
static void test_host_bytes(void **state) {
  enum { ROOM = 32 << 20 };
  static float y[SIDE * SAMPLES];
  struct rlimit before, now;
  struct bench b;
  long pages = 0;
  (void)state;
  bench_open(&b, "cpu");
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  const bool limited = false; /* a sanitizer itself takes addresses */
#else
  const bool limited = device_of(&b)->host;
#endif
  if (!limited) {
    bench_close(&b);
    return;
  }
  support_ok(b.context, run_layer(&b, y)); /* with it the arena and the threads are there */
  FILE *about = fopen("/proc/self/statm", "r");
  assert_true(about != NULL && fscanf(about, "%ld", &pages) == 1);
  fclose(about);
  assert_int_equal(getrlimit(RLIMIT_AS, &before), 0);
  now = before;
  now.rlim_cur = (rlim_t)pages * (rlim_t)sysconf(_SC_PAGESIZE) + ROOM;
  struct ern_buffer *buffer = NULL;
  assert_int_equal(setrlimit(RLIMIT_AS, &now), 0);
  const ern_status made = b.backend->buffer_make(b.backend, ERN_ELEMENT_BYTE, 4 * (size_t)ROOM, &buffer);
  cl_program program = NULL;
  const ern_status built =
      ern_cl_program_get((struct ern_cl_backend *)b.backend, ERN_CL_picture, "-DOTHER=1", &program);
  assert_int_equal(setrlimit(RLIMIT_AS, &before), 0);
  assert_int_equal(made, ERN_E_NO_MEMORY);
  assert_null(buffer);
  support_expect(b.context, built, ERN_E_NO_MEMORY, "OpenCL", "no memory to compile picture.cl", NULL);
  support_ok(b.context, b.backend->buffer_make(b.backend, ERN_ELEMENT_BYTE, 4 * (size_t)ROOM, &buffer));
  support_ok(b.context, ern_cl_program_get((struct ern_cl_backend *)b.backend, ERN_CL_picture, "-DOTHER=1", &program));
  b.backend->buffer_free(b.backend, buffer);
  bench_close(&b);
}

/* Transfers go without pinned memory. */
static void test_pinned(void **state) {
  const float values[2] = {1, 2};
  float found[2] = {0};
  struct bench b;
  (void)state;
  bench_open(&b, "gpu");
  set("ERNERF_FAULT_PINNED", 1);
  support_ok(b.context, b.backend->download_reals(b.stream, found, take(&b, 2, values), 2));
  assert_memory_equal(found, values, sizeof found);
  for (int i = 0; i < 2; i++) assert_null(ern_cl_stream_of(b.stream)->staging[i].memory);
  set("ERNERF_FAULT_PINNED", 0);
  bench_close(&b);
}

/* ---- kernels ----------------------------------------------------------------------------------------------------- */

/* Smaller tiles give the same numbers; a device that had promised more than it has refuses the large ones. */
static void test_local_bytes(void **state) {
  static float expected[SIDE * SAMPLES], found[SIDE * SAMPLES];
  struct bench b;
  (void)state;
  bench_open(&b, "cpu");
  const size_t own = device_of(&b)->local_bytes;
  support_ok(b.context, run_layer(&b, expected));
  set("ERNERF_FAULT_LOCAL", ERN_CL_LIMIT_local_bytes);
  if (own > 2 * ERN_CL_LIMIT_local_bytes) assert_int_equal(run_layer(&b, found), ERN_E_NO_MEMORY);
  bench_close(&b);
  bench_open(&b, "cpu");
  assert_true(device_of(&b)->local_bytes <= ERN_CL_LIMIT_local_bytes);
  support_ok(b.context, run_layer(&b, found));
  assert_memory_equal(found, expected, sizeof found);
  set("ERNERF_FAULT_LOCAL", 0);
  bench_close(&b);
}

/* A kernel of the slots, and one of those that measure peaks, which have larger groups elsewhere. */
static void test_group_items(void **state) {
  struct bench b;
  double done = 0;
  (void)state;
  set("ERNERF_FAULT_GROUP", ERN_CL_LIMIT_group_items);
  bench_open(&b, "gpu");
  assert_int_equal(device_of(&b)->group_most, ERN_CL_LIMIT_group_items);
  run_small(&b);
  const float zeros[1 << 12] = {0};
  const struct ern_opencl_peak peak = {
      .loop = ERN_OPENCL_COPY, .to = take(&b, 1 << 12, zeros), .from = take(&b, 1 << 12, zeros)};
  support_ok(b.context, ern_opencl_peak_run(b.stream, &peak, &done));
  bench_close(&b);
  set("ERNERF_FAULT_GROUP", ERN_CL_LIMIT_group_items - 1);
  support_expect(b.context, backend_make(&b, "gpu"), ERN_E_UNSUPPORTED, "OpenCL", "has work-groups of 63 items",
                 "expected 64", NULL);
  set("ERNERF_FAULT_GROUP", 0);
  bench_close(&b);
}

/* kernelcheck runs all kernels with this limit (CMakeLists.txt); here one shows that the layer holds it. */
static void test_argument_bytes(void **state) {
  static float y[SIDE * SAMPLES];
  struct bench b;
  (void)state;
  bench_open(&b, "cpu");
  set("ERNERF_FAULT_ARGUMENTS", ERN_CL_LIMIT_argument_bytes);
  support_ok(b.context, run_layer(&b, y));
  set("ERNERF_FAULT_ARGUMENTS", 100);
  assert_int_equal(run_layer(&b, y), ERN_E_NO_MEMORY);
  set("ERNERF_FAULT_ARGUMENTS", 0);
  bench_close(&b);
}

static void test_options(void **state) {
  struct bench b;
  (void)state;
  set("ERNERF_FAULT_OPTIONS", 1);
  bench_open(&b, "cpu");
  assert_false(device_of(&b)->exact_divide);
  run_small(&b);
  set("ERNERF_FAULT_OPTIONS", 0);
  bench_close(&b);
}

/* The text without comments. */
static char *code_of(const unsigned char *text, size_t bytes) {
  char *code = calloc(bytes + 1, 1);
  size_t used = 0;
  assert_non_null(code);
  for (size_t i = 0; i < bytes; i++) {
    if (i + 1 < bytes && text[i] == '/' && text[i + 1] == '*') {
      for (i += 2; i + 1 < bytes && (text[i] != '*' || text[i + 1] != '/'); i++) continue;
      i++;
    } else {
      code[used++] = (char)text[i];
    }
  }
  return code;
}

static bool is_letter(char c) { return isalpha((unsigned char)c) || c == '_'; }

/* A word that ends with _ is the beginning of one. After others a number may follow: double4. */
static bool has_word(const char *code, const char *word) {
  const size_t length = strlen(word);
  for (const char *at = strstr(code, word); at != NULL; at = strstr(at + 1, word))
    if ((at == code || (!is_letter(at[-1]) && !isdigit((unsigned char)at[-1]))) &&
        (word[length - 1] == '_' || !is_letter(at[length])))
      return true;
  return false;
}

static void test_extensions(void **state) {
  static const char *const optional[] = {"half", "double", "sub_group_", "atom_", "image2d_t", "printf", "cl_khr_"};
  static const struct {
    const char *name;
    const unsigned char *text;
    const size_t *bytes;
  } sources[] = {
#define SOURCE(name) {#name, ern_cl_text_##name, &ern_cl_bytes_##name},
      SOURCE(common) SOURCE(float_add) SOURCE(samples) SOURCE(tensor) SOURCE(tile) ERN_CL_SOURCES(SOURCE)
#undef SOURCE
  };
  (void)state;
  for (size_t i = 0; i < sizeof sources / sizeof *sources; i++) {
    char *code = code_of(sources[i].text, *sources[i].bytes);
    for (size_t w = 0; w < sizeof optional / sizeof *optional; w++)
      if (has_word(code, optional[w])) fail_msg("%s.cl uses %s", sources[i].name, optional[w]);
    free(code);
  }
}

/* ---- additions to floats ----------------------------------------------------------------------------------------- */

static void take_device(void *user, const ern_device_info *device) {
  if (strcmp(device->kind, "opencl") == 0) *(bool *)user |= device->adds_floats;
}

/* The table's gradient of samples that all lie in one cell of three entries, with integers: sums are exact. */
static void run_grid(struct bench *b, float dtable[4]) {
  enum { N = 200 };
  struct ern_grid grid = {.dims = 1, .levels = 1, .features = 1, .bound = 1, .entries = 4};
  float x[N] = {0}, df[N];
  grid.level[0] = (struct ern_grid_level){.scale = 1, .resolution = 2, .offset = 0, .size = 4};
  for (int i = 0; i < N; i++) df[i] = (float)(i % 9);
  struct ern_grid_bwd_args args = {
      .dtable = take(b, 4, dtable),
      .df = {take(b, N, df), N, 1, ERN_PER_SAMPLE},
      .forward = {.x = {take(b, N, x)}, .table = take(b, 4, dtable), .grid = &grid, .n = N}};
  b->backend->deterministic = false; /* a CPU's is always so */
  support_ok(b->context, b->backend->grid_bwd(b->stream, &args));
  support_ok(b->context, b->backend->download_reals(b->stream, dtable, args.dtable, 4));
}

/* Which way is taken, what it computes, and what the list of devices says. A device that announces a way which its
 * compiler does not have takes the loop. */
static void test_float_add(void **state) {
  static const struct {
    int fault;
    ern_cl_float_add expected;
  } cases[] = {{0, ERN_CL_FLOAT_ADD_LOOP},
               {2, ERN_CL_FLOAT_ADD_EXTENSION},
               {3, ERN_CL_FLOAT_ADD_AMD},
               {-2, ERN_CL_FLOAT_ADD_LOOP},
               {-3, ERN_CL_FLOAT_ADD_LOOP}};
  float expected[4] = {0};
  (void)state;
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    float found[4] = {0};
    bool adds = false;
    struct bench b;
    if (cases[i].expected == ERN_CL_FLOAT_ADD_AMD && getenv("ERNERF_TEST_LONG") == NULL) continue; /* one more build */
    set("ERNERF_FAULT_FLOAT_ADD", cases[i].fault);
    bench_open(&b, "cpu");
    if (i == 0 && device_of(&b)->float_add != ERN_CL_FLOAT_ADD_LOOP) skip(); /* no device for simulations */
    assert_int_equal(device_of(&b)->float_add, cases[i].expected);
    run_grid(&b, i == 0 ? expected : found);
    if (i > 0) assert_memory_equal(found, expected, sizeof found);
    support_ok(b.context, ern_devices_list(b.context, take_device, &adds));
    assert_true(adds == (cases[i].expected != ERN_CL_FLOAT_ADD_LOOP));
    bench_close(&b);
  }
  assert_true(expected[0] + expected[1] + expected[2] + expected[3] == 793);
  set("ERNERF_FAULT_FLOAT_ADD", 0);
}

/* Stage times are then the host's. */
static void test_times(void **state) {
  double ms[2] = {-1, -1};
  struct bench b;
  (void)state;
  bench_open(&b, "cpu");
  set("ERNERF_FAULT_TIMES", 1);
  for (int i = 0; i < 2; i++) support_ok(b.context, b.backend->mark(b.stream, i));
  support_ok(b.context, b.backend->marks_read(b.stream, ms, 2));
  assert_true(ms[0] == -1 && ms[1] == -1);
  set("ERNERF_FAULT_TIMES", 0);
  bench_close(&b);
}

int main(void) {
  const char *layer = getenv("ERNERF_FAULTS");
  if (layer == NULL || setenv("OPENCL_LAYERS", layer, 1) != 0) return 1;
#define TEST(name, value) cmocka_unit_test(test_##name),
  const struct CMUnitTest tests[] = {ERN_CL_LIMITS(TEST)};
#undef TEST
  return cmocka_run_group_tests_name("opencl limits", tests, NULL, NULL);
}
