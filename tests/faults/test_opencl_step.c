/* SPDX-License-Identifier: MIT
 * A training step or a frame on a device that has too little memory, fails for a moment, or is lost: the same gradient
 * or picture with fewer rays at a time, or an error in words; nothing is left behind, and the stream goes on
 * afterwards. */
#include "support.h"

#include <math.h>

#include "backend_opencl/opencl.h"
#include "core/rng.h"
#include "ernerf/backend.h"
#include "model/parameters.h"
#include "render/march_ops.h"
#include "render/render_ops.h"
#include "train/losses_ops.h"
#include "train/step_ops.h"

enum { RAYS = 300, SIDE = 24, FEATURES = 5, POINTS = 40000 };

/* The L2 norm of a tensor's error may be this much of the norm of what the step adds to it: sums over parts of the
 * 4,800 samples round in another order (5e-7 is seen) ... */
static const double TOLERANCE = 2e-6;
/* ... and this much of the norm of what was there before, to which each part adds half a unit in the last place, 6e-8.
 */
static const double ROUNDING = 1e-6;

struct bench {
  struct support_meter meter; /* first: the context's hooks get it; memory on the host */
  ern_context *context;
  struct ern_backend *backend;
  struct ern_stream *stream;
  struct ern_field field;
  struct ern_parameter_table table;
  struct ern_view view;
  struct ern_march_settings settings;
  struct ern_head_step_args args;
  float *before, *gradient; /* [parameters]: what the gradient is before and after a step */
  int lines;                /* said about memory */
};

static void take_line(void *user, ern_log_level level, const char *line) {
  struct bench *b = user;
  if (level == ERN_LOG_INFO && strstr(line, "at a time") != NULL) b->lines++;
}

static float value_at(uint64_t seed, size_t at, float low, float high) {
  return low + (high - low) * ern_uniform(ern_random_at(seed, 5, (uint32_t)at, ERN_RNG_INIT).word[0]);
}

static ern_span take(struct bench *b, size_t count, float low, float high, uint64_t seed) {
  ern_span span;
  float *values = malloc((count + 1) * sizeof *values);
  assert_non_null(values);
  for (size_t i = 0; i < count; i++) values[i] = value_at(seed, i, low, high);
  support_ok(b->context, ern_scratch_take(b->stream, ERN_ELEMENT_REAL, count, &span));
  support_ok(b->context, b->backend->upload_reals(b->stream, span, values, count));
  free(values);
  return span;
}

static ern_rows take_rows(struct bench *b, int rows, size_t n, uint64_t seed) {
  return (ern_rows){take(b, (size_t)rows * n, 0, 1, seed), n, rows, ERN_PER_SAMPLE};
}

/* Fresh values; tables and densities large enough to matter. */
static ern_span take_parameters(struct bench *b) {
  const size_t count = b->field.parameters;
  float *values = calloc(count, sizeof *values);
  ern_span span;
  assert_non_null(values);
  ern_parameters_init(values, &b->table, false, 3);
  for (int r = 0; r < b->table.rows; r++) {
    const struct ern_parameter *row = &b->table.row[r];
    for (size_t i = row->at; row->group == ERN_GROUP_GRID && i < row->at + row->count; i++) values[i] *= 3e3f;
  }
  support_ok(b->context, ern_scratch_take(b->stream, ERN_ELEMENT_REAL, count, &span));
  support_ok(b->context, b->backend->upload_reals(b->stream, span, values, count));
  free(values);
  return span;
}

static void take_scene(struct bench *b) {
  int32_t pixel_number[RAYS];
  uint8_t *cells = malloc(ERN_OCCUPANCY_BYTES);
  ern_span pixels, bits;
  assert_non_null(cells);
  memset(cells, 0xff, ERN_OCCUPANCY_BYTES);
  for (int i = 0; i < RAYS; i++) pixel_number[i] = (i * 37 + 60) % (SIDE * SIDE);
  support_ok(b->context, ern_scratch_take(b->stream, ERN_ELEMENT_INT32, RAYS, &pixels));
  support_ok(b->context, ern_scratch_take(b->stream, ERN_ELEMENT_BYTE, ERN_OCCUPANCY_BYTES, &bits));
  support_ok(b->context, b->backend->upload_int32(b->stream, pixels, pixel_number, RAYS));
  support_ok(b->context, b->backend->upload_bytes(b->stream, bits, cells, ERN_OCCUPANCY_BYTES));
  free(cells);
  b->args = (struct ern_head_step_args){.parameters = take_parameters(b),
                                        .dparameters = take(b, b->field.parameters, 0, 0, 0),
                                        .field = &b->field,
                                        .view = &b->view,
                                        .settings = &b->settings,
                                        .bits = bits,
                                        .pixel_number = pixels,
                                        .jitter = take(b, RAYS, 0, 0.999f, 1),
                                        .truth = take_rows(b, 3, RAYS, 2),
                                        .background = take_rows(b, 3, RAYS, 3),
                                        .face = take(b, RAYS, 0, 1, 4),
                                        .windows = take(b, (size_t)8 * 16 * FEATURES, -1, 1, 5),
                                        .eye_value = 0.4f,
                                        .individual = 1,
                                        .weights = {0.5f, 1, 0.5f, 0.5f, 0.1f, 0.1f, 1e3f, true},
                                        .transmittance_stop = 1e-4f,
                                        .smooth = true,
                                        .seed = 9,
                                        .step = 4,
                                        .n = RAYS};
}

static void bench_open(struct bench *b) {
  const struct ern_model_config model = {
      .levels = 4, .feature_width = FEATURES, .window_length = 16, .head = true, .eye = true, .codes = 3, .bound = 1};
  ern_context_config context = ern_context_config_default();
  ern_backend_config backend = ern_backend_config_default();
  const char *number = getenv("ERNERF_TEST_DEVICE");
  *b = (struct bench){.settings = {.bound = 1, .max_steps = 16, .dt_gamma = 1.0f / 256, .near = 0.05f},
                      .view = {.pose = {1, 0, 0, 0.02f, 0, 0, -1, 3.4f, 0, 1, 0, 0.03f, 0, 0, 0, 1},
                               .focal = 60,
                               .cx = SIDE / 2,
                               .cy = SIDE / 2,
                               .width = SIDE,
                               .height = SIDE}};
  context.allocate = support_meter_allocate;
  context.release = support_meter_release;
  context.log = take_line;
  context.user = b;
  assert_int_equal(ern_context_create(&b->context, &context), ERN_OK);
  backend.name = "opencl";
  backend.device = number != NULL ? atoi(number) : 0;
  backend.deterministic = true;
  support_ok(b->context, ern_backend_create(&b->backend, b->context, &backend));
  support_ok(b->context, b->backend->stream_make(b->backend, 1, &b->stream));
  support_ok(b->context, ern_parameters_build(b->context, &model, &b->field, &b->table));
  take_scene(b);
  b->before = malloc(b->field.parameters * sizeof(float));
  b->gradient = malloc(b->field.parameters * sizeof(float));
  assert_true(b->before != NULL && b->gradient != NULL);
  for (size_t i = 0; i < b->field.parameters; i++) b->before[i] = value_at(6, i, -1e-4f, 1e-4f);
}
static void bench_close(struct bench *b) {
  free(b->before);
  free(b->gradient);
  b->backend->stream_free(b->stream);
  assert_int_equal(atomic_load(&((struct ern_cl_backend *)b->backend)->taken), 0);
  ern_backend_free(&b->backend);
  ern_context_free(&b->context);
  assert_int_equal(b->meter.now, 0);
}

/* What the layer does (opencl_faults.c); 0: not. */
struct faults {
  long long memory, launch, count, code;
};

static void set(const char *name, long long value) {
  char text[32];
  snprintf(text, sizeof text, "%lld", value);
  assert_int_equal(value != 0 ? setenv(name, text, 1) : unsetenv(name), 0);
}
static void set_faults(struct faults faults) {
  set("ERNERF_FAULT_MEMORY", faults.memory);
  set("ERNERF_FAULT_LAUNCH", faults.launch);
  set("ERNERF_FAULT_COUNT", faults.count);
  set("ERNERF_FAULT_CODE", faults.code);
}

static long long taken(const struct bench *b) {
  return (long long)atomic_load(&((struct ern_cl_backend *)b->backend)->taken);
}
static size_t rays_at_once(const struct bench *b) { return ern_cl_stream_of(b->stream)->rays_at_once; }

/* Of the gradient, which a step keeps, and a little more. */
static long long copy_bytes(const struct bench *b) { return (long long)(b->field.parameters * sizeof(float)) + 4096; }

/* A step onto the gradient `before`, with the faults during it alone. */
static ern_status step(struct bench *b, struct faults faults) {
  const size_t count = b->field.parameters;
  support_ok(b->context, b->backend->upload_reals(b->stream, b->args.dparameters, b->before, count));
  set_faults(faults);
  const ern_status status = b->backend->head_step(b->stream, &b->args);
  set_faults((struct faults){0});
  assert_int_equal(ern_cl_stream_of(b->stream)->pending_count, 0); /* whose arguments are gone */
  if (status == ERN_OK)
    support_ok(b->context, b->backend->download_reals(b->stream, b->gradient, b->args.dparameters, count));
  return status;
}

/* As if no step had been made yet. */
static void forget(struct bench *b) {
  ern_cl_stream_of(b->stream)->rays_at_once = 0;
  ern_arena_trim(b->stream);
  b->lines = 0;
}

/* What a step without faults leaves behind. */
struct expected {
  float *gradient;
  double terms[ERN_LOSS_TERMS], squared_error;
  size_t samples;
  long long before, most; /* bytes on the device before it, and with it */
};

static void expect_open(struct bench *b, struct expected *e) {
  const size_t bytes = b->field.parameters * sizeof(float);
  support_ok(b->context, step(b, (struct faults){0})); /* makes the buffer of figures, which stays */
  forget(b);
  e->before = taken(b);
  support_ok(b->context, step(b, (struct faults){0}));
  e->most = taken(b);
  assert_true(e->most > e->before && rays_at_once(b) == 0);
  e->gradient = malloc(bytes);
  assert_non_null(e->gradient);
  memcpy(e->gradient, b->gradient, bytes);
  memcpy(e->terms, b->args.terms, sizeof e->terms);
  e->squared_error = b->args.squared_error;
  e->samples = b->args.samples;
}

static void expect_same(const struct bench *b, const struct expected *e, const char *what) {
  assert_int_equal(b->args.samples, e->samples);
  for (int i = 0; i < ERN_LOSS_TERMS; i++)
    if (fabs(b->args.terms[i] - e->terms[i]) > 1e-6 * fabs(e->terms[i]))
      fail_msg("%s: term %d is %.9g, expected %.9g", what, i, b->args.terms[i], e->terms[i]);
  assert_true(fabs(b->args.squared_error - e->squared_error) <= 1e-6 * e->squared_error);
  for (int r = 0; r < b->table.rows; r++) {
    const struct ern_parameter *row = &b->table.row[r];
    double difference = 0, added = 0, before = 0;
    for (size_t i = row->at; i < row->at + row->count; i++) {
      difference += pow((double)b->gradient[i] - (double)e->gradient[i], 2);
      added += pow((double)e->gradient[i] - (double)b->before[i], 2);
      before += pow((double)b->before[i], 2);
    }
    if (sqrt(difference) > TOLERANCE * sqrt(added) + ROUNDING * sqrt(before))
      fail_msg("%s: the gradient of %s is off by %g, the step adds %g to %g", what, row->name, sqrt(difference),
               sqrt(added), sqrt(before));
  }
}

static void test_too_little(void **state) {
  static const double shares[] = {0.4, 0.2, 0.1};
  struct bench b;
  struct expected e;
  (void)state;
  bench_open(&b);
  expect_open(&b, &e);
  size_t rays = RAYS;
  for (size_t i = 0; i < sizeof shares / sizeof *shares; i++) {
    const struct faults faults = {.memory = e.before + (long long)(shares[i] * (double)(e.most - e.before))};
    char what[64];
    snprintf(what, sizeof what, "with %g of its memory", shares[i]);
    forget(&b);
    support_ok(b.context, step(&b, faults));
    assert_true(rays_at_once(&b) > 0 && rays_at_once(&b) < RAYS && rays_at_once(&b) <= rays);
    rays = rays_at_once(&b);
    expect_same(&b, &e, what);
    support_ok(b.context, step(&b, faults)); /* begins with the rays that had memory */
    expect_same(&b, &e, what);
    assert_true(rays_at_once(&b) == rays && b.lines == 1);
  }
  free(e.gradient);
  bench_close(&b);
}

static void test_far_too_little(void **state) {
  struct bench b;
  struct expected e;
  (void)state;
  bench_open(&b);
  expect_open(&b, &e);
  forget(&b);
  support_expect(b.context, step(&b, (struct faults){.memory = e.before + 1000}), ERN_E_NO_MEMORY, "OpenCL", "bytes",
                 "is needed", "all memory is", NULL);
  /* room for the copy of the gradient, and for little else */
  support_expect(b.context, step(&b, (struct faults){.memory = e.before + copy_bytes(&b)}), ERN_E_NO_MEMORY,
                 "even with one ray at a time", "is needed", NULL);
  assert_int_equal(b.lines, 0);
  support_ok(b.context, step(&b, (struct faults){0}));
  expect_same(&b, &e, "after two steps without memory");
  free(e.gradient);
  bench_close(&b);
}

/* One launch is refused for want of resources: each third in turn. */
static void test_each_launch(void **state) {
  struct bench b;
  struct expected e;
  int fired = 0;
  (void)state;
  bench_open(&b);
  expect_open(&b, &e);
  for (int launch = 1;; launch += 3) {
    char what[64];
    snprintf(what, sizeof what, "after launch %d was refused", launch);
    forget(&b);
    support_ok(b.context, step(&b, (struct faults){.launch = launch, .count = 1, .code = CL_OUT_OF_RESOURCES}));
    expect_same(&b, &e, what);
    if (rays_at_once(&b) == 0) break;
    fired++;
  }
  assert_true(fired > 10);
  free(e.gradient);
  bench_close(&b);
}

/* The device is lost at each launch in turn, and comes back. */
static void test_lost(void **state) {
  static const long long codes[] = {CL_DEVICE_NOT_AVAILABLE, CL_OUT_OF_RESOURCES};
  struct bench b;
  struct expected e;
  int launch = 1;
  (void)state;
  bench_open(&b);
  expect_open(&b, &e);
  forget(&b);
  for (;; launch++) {
    const ern_status status = step(&b, (struct faults){.launch = launch, .code = codes[launch % 2]});
    if (status == ERN_OK) break;
    support_expect(b.context, status, ERN_E_DEVICE, "OpenCL", "the device is lost", NULL);
    /* scratch of the failed step is given back, but for the block of the copy, which doubles the one before */
    assert_true(taken(&b) <= e.before + 4 * copy_bytes(&b));
  }
  assert_true(launch > 20 && rays_at_once(&b) == 0);
  /* with the smoothness term; on a GPU a step of few rays takes as long as its launches */
  assert_true(launch - 1 <= 73);
  expect_same(&b, &e, "after the device was lost");
  free(e.gradient);
  bench_close(&b);
}

static void test_density(void **state) {
  static float expected[POINTS], found[POINTS];
  struct bench b;
  (void)state;
  bench_open(&b);
  struct ern_head_density_args args = {.x = {take(&b, 3 * POINTS, -0.9f, 0.9f, 8), POINTS, 3, ERN_PER_SAMPLE},
                                       .parameters = b.args.parameters,
                                       .field = &b.field,
                                       .code = take(&b, ERN_AUDIO_CODE, -1, 1, 9),
                                       .eye_value = 0.3f,
                                       .n = POINTS};
  support_ok(b.context, ern_scratch_take(b.stream, ERN_ELEMENT_REAL, POINTS, &args.sigma));
  const long long before = taken(&b);
  support_ok(b.context, b.backend->head_density(b.stream, &args));
  support_ok(b.context, b.backend->download_reals(b.stream, expected, args.sigma, POINTS));
  const long long most = taken(&b);
  ern_arena_trim(b.stream);
  set_faults((struct faults){.memory = before + (most - before) / 3});
  support_ok(b.context, b.backend->zero(b.stream, args.sigma));
  support_ok(b.context, b.backend->head_density(b.stream, &args));
  support_ok(b.context, b.backend->download_reals(b.stream, found, args.sigma, POINTS));
  assert_true(taken(&b) < most);
  assert_memory_equal(found, expected, sizeof found);
  set_faults((struct faults){0});
  args.at_once = POINTS; /* as on a GPU */
  support_ok(b.context, b.backend->zero(b.stream, args.sigma));
  support_ok(b.context, b.backend->head_density(b.stream, &args));
  support_ok(b.context, b.backend->download_reals(b.stream, found, args.sigma, POINTS));
  assert_true(taken(&b) > most);
  assert_memory_equal(found, expected, sizeof found);
  bench_close(&b);
}

/* ---- a frame ----------------------------------------------------------------------------------------------------- */

enum { PIXELS = SIDE * SIDE };

static struct ern_render_rays_args frame_of(struct bench *b) {
  int32_t number[PIXELS];
  struct ern_render_rays_args args = {.pixel = take_rows(b, 3, PIXELS, 20),
                                      .background = take_rows(b, 3, PIXELS, 21),
                                      .view = b->view,
                                      .bits = b->args.bits,
                                      .parameters = b->args.parameters,
                                      .field = &b->field,
                                      .code = take(b, ERN_AUDIO_CODE, -1, 1, 22),
                                      .eye_value = 0.4f,
                                      .settings = b->settings,
                                      .transmittance_stop = 1e-4f,
                                      .n = PIXELS};
  for (int i = 0; i < PIXELS; i++) number[i] = i;
  support_ok(b->context, ern_scratch_take(b->stream, ERN_ELEMENT_INT32, PIXELS, &args.pixel_number));
  support_ok(b->context, b->backend->upload_int32(b->stream, args.pixel_number, number, PIXELS));
  return args;
}

/* Renders with the faults during it alone; the picture before is gone. */
static ern_status render(struct bench *b, struct ern_render_rays_args *args, struct faults faults,
                         float picture[3 * PIXELS]) {
  support_ok(b->context, b->backend->zero(b->stream, args->pixel.span));
  set_faults(faults);
  const ern_status status = b->backend->render_rays(b->stream, args);
  set_faults((struct faults){0});
  support_ok(b->context, b->backend->download_reals(b->stream, picture, args->pixel.span, 3 * PIXELS));
  return status;
}

/* Through the stages, all rays at once and then by parts: the same picture to the bit, and no error is left. */
static void test_picture_by_parts(void **state) {
  static float expected[3 * PIXELS], found[3 * PIXELS];
  static const double shares[] = {0.6, 0.3, 0.1};
  struct bench b;
  (void)state;
  bench_open(&b);
  struct ern_render_rays_args args = frame_of(&b);
  ern_arena_trim(b.stream);
  const long long before = taken(&b);
  support_ok(b.context, render(&b, &args, (struct faults){0}, expected));
  const long long most = taken(&b);
  assert_true(most > before);
  for (size_t i = 0; i < sizeof shares / sizeof *shares; i++) {
    ern_arena_trim(b.stream);
    support_ok(
        b.context,
        render(&b, &args, (struct faults){.memory = before + (long long)(shares[i] * (double)(most - before))}, found));
    assert_true(taken(&b) < most);
    assert_memory_equal(found, expected, sizeof found);
    assert_string_equal(ern_last_error(b.context), "");
  }
  ern_arena_trim(b.stream);
  const struct ern_arena_mark mark = ern_arena_mark(b.stream);
  const struct faults nothing_more = {.memory = 1};
  ern_span rest;
  set_faults(nothing_more);
  while (ern_scratch_take(b.stream, ERN_ELEMENT_REAL, 64, &rest) == ERN_OK) {
  }
  support_expect(b.context, render(&b, &args, nothing_more, found), ERN_E_NO_MEMORY, "OpenCL", "bytes", "is needed",
                 NULL);
  ern_arena_release(b.stream, mark);
  support_ok(b.context, render(&b, &args, (struct faults){0}, found));
  assert_memory_equal(found, expected, sizeof found);
  bench_close(&b);
}

/* No room for what a model lays out, or for its kernel's launch: the picture of the stages. */
static void test_picture_unprepared(void **state) {
  static float expected[3 * PIXELS], fused[3 * PIXELS], found[3 * PIXELS];
  struct bench b;
  (void)state;
  bench_open(&b);
  struct ern_render_rays_args args = frame_of(&b);
  struct ern_render_prepare_args prepare = {args.parameters, &b.field};
  support_ok(b.context, render(&b, &args, (struct faults){0}, expected));
  set_faults((struct faults){.memory = taken(&b) + 20000}); /* the net alone has 80,000 bytes */
  support_ok(b.context, b.backend->render_prepare(b.stream, &prepare));
  set_faults((struct faults){0});
  support_ok(b.context, render(&b, &args, (struct faults){0}, found));
  assert_memory_equal(found, expected, sizeof found);
  support_ok(b.context, b.backend->render_prepare(b.stream, &prepare));
  support_ok(b.context, render(&b, &args, (struct faults){0}, fused));
  assert_memory_not_equal(fused, expected, sizeof fused); /* in the last places, or it is not another way */
  for (int launch = 1; launch < 4; launch++) {
    const struct faults faults = {.launch = launch, .count = 1, .code = CL_OUT_OF_RESOURCES};
    support_ok(b.context, render(&b, &args, faults, found));
    assert_memory_equal(found, expected, sizeof found);
  }
  support_ok(b.context, render(&b, &args, (struct faults){0}, found));
  assert_memory_equal(found, fused, sizeof found);
  assert_string_equal(ern_last_error(b.context), "");
  bench_close(&b);
}

/* Scratch grows by doubling; where there is no room for that, by what is needed. */
static void test_scratch(void **state) {
  enum { MANY = 1 << 20 };
  struct bench b;
  ern_span span;
  (void)state;
  bench_open(&b);
  const struct ern_arena_mark mark = ern_arena_mark(b.stream);
  support_ok(b.context, ern_scratch_take(b.stream, ERN_ELEMENT_INT32, MANY, &span));
  set_faults((struct faults){.memory = taken(&b) + 5 * MANY});
  support_ok(b.context, ern_scratch_take(b.stream, ERN_ELEMENT_INT32, MANY + 64, &span));
  support_expect(b.context, ern_scratch_take(b.stream, ERN_ELEMENT_INT32, MANY, &span), ERN_E_NO_MEMORY,
                 "4194304 bytes", NULL);
  set_faults((struct faults){0});
  ern_arena_release(b.stream, mark);
  bench_close(&b);
}

/* Sums in any order are only for the form of kernels that suits GPUs, and only unless asked. */
static void test_deterministic(void **state) {
  static const char *const forms[] = {"cpu", "gpu"};
  ern_context *context = support_context();
  (void)state;
  for (int asked = 0; asked < 2; asked++) {
    for (int form = 0; form < 2; form++) {
      ern_backend_config config = ern_backend_config_default();
      ern_backend *backend = NULL;
      ern_backend_info info;
      config.name = "opencl";
      config.deterministic = asked == 1;
      assert_int_equal(setenv("ERNERF_OPENCL_FORM", forms[form], 1), 0);
      support_ok(context, ern_backend_create(&backend, context, &config));
      ern_backend_describe(backend, &info);
      assert_true(info.deterministic == (asked == 1 || form == 0));
      ern_backend_free(&backend);
    }
  }
  assert_int_equal(unsetenv("ERNERF_OPENCL_FORM"), 0);
  ern_context_free(&context);
}

/* Blocks of scratch memory do not double without end. */
static void test_large_blocks(void **state) {
  (void)state;
  const size_t count = (size_t)1 << 26, bytes = count * sizeof(float);
  struct bench b;
  ern_span span;
  bench_open(&b);
  ern_arena_trim(b.stream);
  const struct ern_arena_mark mark = ern_arena_mark(b.stream);
  const long long before = taken(&b);
  support_ok(b.context, ern_scratch_take(b.stream, ERN_ELEMENT_REAL, count + 1, &span));
  support_ok(b.context, ern_scratch_take(b.stream, ERN_ELEMENT_REAL, 128, &span));
  assert_true(taken(&b) - before < (long long)(2 * bytes + 4096));
  ern_arena_release(b.stream, mark);
  bench_close(&b);
}

int main(void) {
  const char *layer = getenv("ERNERF_FAULTS");
  if (layer == NULL || setenv("OPENCL_LAYERS", layer, 1) != 0) return 1;
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_too_little),
                                     cmocka_unit_test(test_far_too_little),
                                     cmocka_unit_test(test_each_launch),
                                     cmocka_unit_test(test_lost),
                                     cmocka_unit_test(test_density),
                                     cmocka_unit_test(test_scratch),
                                     cmocka_unit_test(test_deterministic),
                                     cmocka_unit_test(test_picture_by_parts),
                                     cmocka_unit_test(test_picture_unprepared),
                                     cmocka_unit_test(test_large_blocks)};
  return cmocka_run_group_tests_name("opencl step", tests, NULL, NULL);
}
