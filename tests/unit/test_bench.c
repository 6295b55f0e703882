/* SPDX-License-Identifier: MIT
 * The benchmarks' figures: what is counted, that each is there and makes sense, and how they refuse. How fast anything
 * is is not asserted: it is the machine's and its other users' affair, and so is a share of a peak. */
#include "../support.h"

#include <math.h>
#include <stdbool.h>

#include "core/status.h"
#include "lab/bench/bench_shared.h"

enum { SIDE = 40, RAYS = 96, MOST = 256 };
/* A ray ends at the sample after which T < 1e-4, on all in float: where log T, a sum of 16 terms up to 9, is that to
 * 1e-5, one sample more or less. Samples are 0.1 and more of it apart: of 1,600 rays one in five finds such a place. */
static const double SPENT = 2;

static ern_context *context;
static ern_backend *backends[2]; /* the reference, and the best that the machine has */
static size_t count;
static ern_bench_scene *scene;

static int set_up(void **state) {
  (void)state;
  context = support_context();
  ern_backend_config config = ern_backend_config_default();
  support_ok(context, ern_backend_create(&backends[1], context, &config));
  config.isa = "ref";
  support_ok(context, ern_backend_create(&backends[0], context, &config));
  count = strcmp(backends[1]->isa, "ref") == 0 ? 1 : 2;
  support_ok(context, ern_bench_scene_make(&scene, context, SIDE, SIDE, 1));
  return 0;
}

static int tear_down(void **state) {
  (void)state;
  ern_bench_scene_free(&scene);
  ern_backend_free(&backends[0]);
  ern_backend_free(&backends[1]);
  ern_context_free(&context);
  return 0;
}

static ern_bench_options quick(void) {
  ern_bench_options options = ern_bench_options_default();
  options.seconds = 0;
  options.threads = 2;
  options.frames = 2;
  options.rays = RAYS;
  return options;
}

static bool is_positive(double value) { return isfinite(value) && value > 0; }

static void check_timing(const ern_bench_timing *timing) {
  assert_true(is_positive(timing->least));
  assert_true(timing->median >= timing->least);
  assert_true(timing->cpu >= 0); /* a call may be shorter than the clock's tick */
  assert_true(timing->repeats >= 1 && timing->repeats <= ERN_BENCH_REPEATS);
}

/* ---- counting ---------------------------------------------------------------------------------------------------- */

static void test_macs(void **state) {
  (void)state;
  const struct ern_field *field = &scene->model->field;
  /* docs/bench.md: 24,048 multiply-adds of a sample with 14 levels and an eye; 168 reads of the tables */
  const double all = ern_bench_mlp_macs(&field->attention) + ern_bench_mlp_macs(&field->eye) +
                     ern_bench_mlp_macs(&field->density) + ern_bench_mlp_macs(&field->colour);
  assert_true(all == 24048);
  double reads = 0;
  for (int p = 0; p < ERN_PLANES; p++) reads += ern_bench_grid_reads(&field->encoder.grid[p]);
  assert_true(reads == 168);
  /* 3 -> 5 -> 2: 15 and 10. Backward: as many by the weights, 10 by the hidden layer, and 5 for each wanted input; the
   * hidden layer again is 15 */
  const struct ern_mlp mlp = {.layers = 2, .width = {3, 5, 2}};
  assert_true(ern_bench_mlp_macs(&mlp) == 25);
  assert_true(ern_bench_mlp_bwd_macs(&mlp, 0, false) == 35);
  assert_true(ern_bench_mlp_bwd_macs(&mlp, 3, false) == 50);
  assert_true(ern_bench_mlp_bwd_macs(&mlp, 3, true) == 65);
}

static void test_folding(void **state) {
  (void)state;
  const struct ern_field *field = &scene->model->field;
  const struct ern_bench_cost written = ern_bench_cost_written(field), folded = ern_bench_cost_folded(field);
  /* 24,048 - 18,672 = 5,376 multiply-adds: the geometry's 64 rows 4,096, SH and code 20 * 64 = 1,280; in exchange 64
   * sums a sample, and 32 products with the audio code less */
  const double less = written.density + written.colour - folded.density - folded.colour;
  assert_true(less == 2.0 * 5376 - 64 + 32);
  assert_true(folded.ray - written.ray == 2.0 * 1280);
  assert_true(ern_bench_cost_head_step(field, true) > ern_bench_cost_head_step(field, false));
  assert_true(ern_bench_cost_torso_step(field, true) > ern_bench_cost_torso_step(field, false));
}

/* ---- turns ------------------------------------------------------------------------------------------------------- */

struct tally {
  size_t calls[2], times[2], warmed[2];
  size_t fail_at; /* call of number 1 that fails; 0: none */
};

static ern_status work(void *user, size_t which, size_t times) {
  struct tally *tally = user;
  tally->calls[which]++;
  tally->times[which] += times;
  return which == 1 && tally->calls[1] == tally->fail_at ? ERN_E_DEVICE : ERN_OK;
}
static void warm(void *user, size_t which) {
  struct tally *tally = user;
  tally->warmed[which]++;
}

static void test_turns(void **state) {
  (void)state;
  struct tally tally = {0};
  struct ern_bench_turns turns = {
      .work = work, .warm = warm, .user = &tally, .count = 2, .seconds = 0.02, .least = 1e-5, .most = 5};
  ern_bench_timing timing[2];
  assert_int_equal(ern_bench_take_turns(&turns, timing), ERN_OK);
  for (int k = 0; k < 2; k++) {
    assert_true(timing[k].repeats >= 1 && timing[k].repeats <= 5);
    assert_true(timing[k].median >= timing[k].least && timing[k].least >= 0);
    assert_int_equal(tally.warmed[k], 1);
    assert_true(tally.calls[k] > (size_t)timing[k].repeats); /* the cold ones do not count */
    assert_true(tally.times[k] > tally.calls[k]);            /* calls this short are repeated within a reading */
  }
  tally = (struct tally){0};
  turns.seconds = 0; /* no time at all: each is still measured */
  assert_int_equal(ern_bench_take_turns(&turns, timing), ERN_OK);
  assert_int_equal(timing[0].repeats, 1);
  assert_int_equal(timing[1].repeats, 1);
  for (size_t at = 1; at < 4; at++) {
    tally = (struct tally){.fail_at = at};
    turns.seconds = 0.02;
    assert_int_equal(ern_bench_take_turns(&turns, timing), ERN_E_DEVICE);
  }
}

/* ---- scene ------------------------------------------------------------------------------------------------------- */

static void test_scene(void **state) {
  (void)state;
  ern_bench_scene_info info[2];
  for (size_t k = 0; k < count; k++) support_ok(context, ern_bench_scene_describe(scene, backends[k], 2, &info[k]));
  assert_true(info[0].made_up && info[0].has_torso);
  assert_int_equal(info[0].pixels, SIDE * SIDE);
  assert_true(info[0].occupied > 0.01 && info[0].occupied < 0.04); /* a shell, not a cube of fog */
  /* the counts that the scene was chosen for: 2.74 samples a pixel, 0.91 of them lit; a small picture looks at the same
   * places, but at few of them: hence the width */
  const double marched = (double)info[0].marched / (SIDE * SIDE), lit = (double)info[0].lit / (double)info[0].marched;
  assert_true(marched > 2.2 && marched < 3.3);
  assert_true(lit > 0.8 && lit < 1);
  if (count == 2) {
    assert_int_equal(info[0].hits, info[1].hits);
    assert_int_equal(info[0].marched, info[1].marched); /* all look at the same points */
  }
}

static void test_scene_of(void **state) {
  (void)state;
  ern_bench_scene *own = NULL;
  ern_bench_scene_info made, found;
  support_ok(context, ern_bench_scene_of(&own, context, scene->model, &scene->frame, scene->truth, NULL));
  support_ok(context, ern_bench_scene_describe(scene, backends[0], 1, &made));
  support_ok(context, ern_bench_scene_describe(own, backends[0], 1, &found));
  assert_int_equal(found.marched, made.marched);
  assert_int_equal(found.lit, made.lit);
  assert_false(found.made_up);
  ern_bench_scene_free(&own);
  support_expect(context, ern_bench_scene_of(&own, context, scene->model, &scene->frame, NULL, NULL), ERN_E_ARGUMENT,
                 "truth is NULL", NULL);
  support_expect(context, ern_bench_scene_make(&own, context, 0, 10, 0), ERN_E_ARGUMENT, "0 x 10", "8192", NULL);
  assert_null(own);
}

static ern_status make_scene(ern_context *metered) {
  ern_bench_scene *made = NULL;
  const ern_status status = ern_bench_scene_make(&made, metered, 8, 8, 0);
  ern_bench_scene_free(&made);
  return status;
}
static void test_no_memory(void **state) {
  (void)state;
  support_refuse_each(make_scene);
}

/* ---- peaks, kernels ---------------------------------------------------------------------------------------------- */

static void test_peaks_long(void **state) {
  (void)state;
  const ern_bench_options options = quick();
  ern_bench_machine machine;
  support_ok(context, ern_bench_peaks(backends, count, &options, &machine));
  assert_int_equal(machine.threads, 2);
  assert_int_equal(machine.peaks, count);
  assert_true(machine.l2_bytes > 0 && machine.l3_bytes > 0);
  const ern_bench_rate *rates[] = {&machine.stream_l2, &machine.stream_l3, &machine.stream_memory};
  for (size_t i = 0; i < 3; i++) assert_true(is_positive(rates[i]->one) && rates[i]->all >= rates[i]->one);
  for (size_t k = 0; k < count; k++) {
    assert_string_equal(machine.peak[k].isa, backends[k]->isa);
    assert_true(is_positive(machine.peak[k].flops.one) && machine.peak[k].flops.all >= machine.peak[k].flops.one);
    assert_true(is_positive(machine.peak[k].reads.one) && machine.peak[k].reads.all >= machine.peak[k].reads.one);
  }
  assert_true(machine.unrest >= 1);
}

#if defined(ERN_OPENCL)
/* The CPU and a device; the loops of a device are one small program. Kernels, frames and steps on one are looked at by
 * e2e/test_cli_bench and test_bench_opencl_long. */
static void test_device_peaks_long(void **state) {
  (void)state;
  const ern_bench_options options = quick();
  ern_backend_config config = ern_backend_config_default();
  ern_backend *both[2] = {backends[0], NULL};
  ern_bench_machine machine;
  config.name = "opencl";
  support_ok(context, ern_backend_create(&both[1], context, &config));
  support_ok(context, ern_bench_peaks(both, 2, &options, &machine));
  const ern_bench_peak *cpu = &machine.peak[0], *device = &machine.peak[1];
  assert_true(machine.peaks == 2 && cpu->units == 0 && device->units > 0);
  assert_string_equal(device->backend, "opencl");
  assert_true(is_positive(machine.stream_memory.one) && cpu->stream_memory.one == 0);
  const ern_bench_rate *rates[] = {&device->flops, &device->reads, &device->stream_cache, &device->stream_memory};
  for (size_t i = 0; i < sizeof rates / sizeof *rates; i++)
    assert_true(is_positive(rates[i]->one) && rates[i]->all == rates[i]->one);
  support_ok(context, ern_bench_peaks(&both[1], 1, &options, &machine));
  assert_true(machine.stream_memory.all == 0); /* the CPU was not asked for */
  ern_backend_free(&both[1]);
}
#endif

struct rows {
  ern_bench_kernel row[MOST];
  size_t count, stop_at;
};

static int take_row(void *user, const ern_bench_kernel *kernel) {
  struct rows *rows = user;
  assert_true(rows->count < MOST);
  rows->row[rows->count++] = *kernel;
  return rows->count == rows->stop_at;
}

/* Peaks that make the shares easy: one of each a second. */
static ern_bench_machine plain_machine(void) {
  ern_bench_machine machine = {.threads = 2, .l2_bytes = 1 << 20, .l3_bytes = 32 << 20, .peaks = 1};
  machine.stream_l2 = machine.stream_l3 = machine.stream_memory = (ern_bench_rate){1, 1};
  machine.peak[0] = (ern_bench_peak){.isa = backends[1]->isa, .flops = {1, 1}, .reads = {1, 1}};
  return machine;
}

static void test_kernels(void **state) {
  (void)state;
  static const char *const expected[] = {"rays",
                                         "sh_fwd",
                                         "march",
                                         "samples",
                                         "plane_fwd",
                                         "plane_bwd",
                                         "attention_fwd",
                                         "attention_bwd",
                                         "eye_mlp_fwd",
                                         "eye_mlp_bwd",
                                         "density_mlp_fwd",
                                         "density_mlp_bwd",
                                         "sigmoid_fwd",
                                         "sigmoid_bwd",
                                         "softplus_fwd",
                                         "softplus_bwd",
                                         "colour_mlp_fwd",
                                         "colour_mlp_bwd",
                                         "composite_fwd",
                                         "composite_bwd",
                                         "head_loss",
                                         "smooth_loss",
                                         "uncertainty_mlp_fwd",
                                         "attention_mlp_bwd",
                                         "adamw",
                                         "ema",
                                         "finite",
                                         "audio_fwd",
                                         "audio_bwd",
                                         "occupancy_update",
                                         "occupancy_list",
                                         "occupancy_mark",
                                         "occupancy_points",
                                         "torso_mlp_fwd",
                                         "torso_mlp_bwd",
                                         "torso_deform_mlp_bwd",
                                         "torso_select",
                                         "torso_grid_fwd",
                                         "torso_grid_bwd",
                                         "torso_composite_fwd",
                                         "torso_update",
                                         "freq_fwd",
                                         "background",
                                         "picture"};
  const ern_bench_options options = quick();
  const ern_bench_machine machine = plain_machine();
  static struct rows rows;
  rows = (struct rows){.count = 0};
  support_ok(context, ern_bench_kernels(&backends[1], 1, scene, &machine, &options, take_row, &rows));
  for (size_t i = 0; i < rows.count; i++) {
    const ern_bench_kernel *k = &rows.row[i];
    assert_true(strlen(k->name) > 0 && strlen(k->item) > 0);
    assert_string_equal(k->isa, backends[1]->isa);
    check_timing(&k->seconds);
    assert_true(is_positive(k->items));
    assert_true(k->flops >= 0 && k->bytes >= 0 && k->reads >= 0 && k->flops_written <= k->flops);
    const double most = fmax(k->flops, fmax(k->bytes, k->reads));
    if (most > 0) { /* a second each: the share is the largest count over the time */
      assert_true(fabs(k->share * k->seconds.least / most - 1) < 1e-9);
      assert_true(strlen(k->bound) > 0);
    } else {
      assert_true(isnan(k->share));
      assert_string_equal(k->bound, "");
    }
  }
  for (size_t e = 0; e < sizeof expected / sizeof *expected; e++) {
    size_t found = 0;
    for (size_t i = 0; i < rows.count; i++) found += strcmp(rows.row[i].name, expected[e]) == 0;
    if (found != 1) fail_msg("the kernel %s: found %zu rows, expected 1", expected[e], found);
  }
}

static void test_kernels_stop(void **state) {
  (void)state;
  const ern_bench_options options = quick();
  static struct rows rows;
  rows = (struct rows){.stop_at = 2};
  support_expect(context, ern_bench_kernels(&backends[1], 1, scene, NULL, &options, take_row, &rows), ERN_E_CANCELLED,
                 "stopped", NULL);
  assert_int_equal(rows.count, 2);
  assert_true(isnan(rows.row[0].share)); /* without peaks there is none */
}

/* ---- passes ------------------------------------------------------------------------------------------------------ */

static void check_pass(const ern_bench_pass *pass, const char *isa) {
  assert_string_equal(pass->isa, isa);
  assert_int_equal(pass->threads, 2);
  check_timing(&pass->seconds);
  assert_true(is_positive(pass->flops) && is_positive(pass->flops_written));
  assert_true(pass->marched >= pass->evaluated && pass->evaluated >= pass->colours && pass->colours > 0);
  assert_true(pass->stages >= 5 && pass->stages <= ERN_BENCH_STAGES);
  for (int k = 0; k < pass->stages; k++) assert_true(is_positive(pass->stage[k].seconds));
}

static void test_frame(void **state) {
  (void)state;
  const ern_bench_options options = quick();
  ern_bench_pass pass[2];
  support_ok(context, ern_bench_frame(backends, count, scene, NULL, &options, pass));
  for (size_t k = 0; k < count; k++) {
    check_pass(&pass[k], backends[k]->isa);
    assert_true(pass[k].rays == SIDE * SIDE);
    assert_true(isnan(pass[k].share));
    assert_true(pass[k].seconds.repeats <= 2);
  }
  assert_false(pass[0].fused); /* the reference goes by stages, and says so */
  assert_true(pass[0].flops == pass[0].flops_written);
  if (count == 2) assert_true(pass[0].marched == pass[1].marched);
  ern_bench_scene_info info; /* what a pass that does not count is given is what one that does has found */
  support_ok(context, ern_bench_scene_count(scene, &info));
  assert_true(pass[count - 1].marched == (double)info.marched);
  if (pass[count - 1].fused && strcmp(backends[count - 1]->isa, "avx512bf16") != 0)
    assert_true(fabs(pass[count - 1].evaluated - (double)info.lit) <= SPENT);
}

static void test_step_long(void **state) {
  (void)state;
  const ern_bench_options options = quick();
  ern_bench_pass pass[2], again[2];
  for (int torso = 0; torso < 2; torso++) {
    support_ok(context, ern_bench_step(backends, count, scene, NULL, &options, torso, pass));
    support_ok(context, ern_bench_step(backends, count, scene, NULL, &options, torso, again));
    for (size_t k = 0; k < count; k++) {
      check_pass(&pass[k], backends[k]->isa);
      assert_true(pass[k].rays == RAYS);
      assert_true(pass[k].flops > pass[k].flops_written); /* hidden values are computed again */
      assert_true(pass[k].marched == again[k].marched);   /* nothing is learnt from one to the next */
      assert_true(pass[k].marched == pass[0].marched);
    }
  }
}

/* ---- refusals ---------------------------------------------------------------------------------------------------- */

static int stop(void *user, size_t done, size_t all) {
  (void)user;
  return done == 0 && all > 0;
}

static void test_refused(void **state) {
  (void)state;
  ern_bench_machine machine;
  ern_bench_pass pass[2];
  ern_bench_options options = quick();
  options.cookie = 0;
  support_expect(context, ern_bench_peaks(backends, 1, &options, &machine), ERN_E_ARGUMENT, "ern_bench_options_default",
                 NULL);
  options = quick();
  options.rays = 0;
  support_expect(context, ern_bench_step(backends, 1, scene, NULL, &options, false, pass), ERN_E_ARGUMENT, "rays is 0",
                 NULL);
  options = quick();
  options.frames = 1001;
  support_expect(context, ern_bench_frame(backends, 1, scene, NULL, &options, pass), ERN_E_ARGUMENT, "frames is 1001",
                 NULL);
  options = quick();
  options.seconds = (double)NAN;
  support_expect(context, ern_bench_frame(backends, 1, scene, NULL, &options, pass), ERN_E_ARGUMENT, "seconds", NULL);
  options = quick();
  options.threads = -1;
  support_expect(context, ern_bench_frame(backends, 1, scene, NULL, &options, pass), ERN_E_ARGUMENT, "threads is -1",
                 NULL);
  options = quick();
  assert_int_equal(ern_bench_frame(backends, 0, scene, NULL, &options, pass), ERN_E_ARGUMENT);
  assert_int_equal(ern_bench_frame(backends, ERN_BENCH_BACKENDS + 1, scene, NULL, &options, pass), ERN_E_ARGUMENT);
  options.progress = stop;
  support_expect(context, ern_bench_frame(backends, 1, scene, NULL, &options, pass), ERN_E_CANCELLED, "stopped", NULL);
  support_expect(context, ern_bench_step(backends, 1, scene, NULL, &options, false, pass), ERN_E_CANCELLED, "stopped",
                 NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {
    cmocka_unit_test(test_macs),
    cmocka_unit_test(test_folding),
    cmocka_unit_test(test_turns),
    cmocka_unit_test(test_scene),
    cmocka_unit_test(test_scene_of),
    cmocka_unit_test(test_no_memory),
    cmocka_unit_test(test_peaks_long),
    cmocka_unit_test(test_kernels),
    cmocka_unit_test(test_kernels_stop),
#if defined(ERN_OPENCL)
    cmocka_unit_test(test_device_peaks_long),
#endif
    cmocka_unit_test(test_frame),
    cmocka_unit_test(test_step_long),
    cmocka_unit_test(test_refused),
  };
  return cmocka_run_group_tests(tests, set_up, tear_down);
}
