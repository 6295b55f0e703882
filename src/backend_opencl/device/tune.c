/* SPDX-License-Identifier: MIT
 * The tuner: times work sizes on the device, alternating with the standard, and keeps the results in the cache folder
 * by device, driver, form and kernels.
 *
 * Most sizes do not change the order of sums, and so not a bit of any result. Where the order changes (`reorders`), a
 * deterministic backend uses the standard. */
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "backend_opencl/device/cache.h"
#include "backend_opencl/device/peak.h"
#include "backend_opencl/device/program.h"
#include "backend_opencl/device/tune.h"
#include "backend_opencl/device/tune_workloads.h"
#include "core/memory.h"
#include "io/file.h"

enum {
  SIZES = 4,           /* most sizes that are tried */
  TURNS = 5,           /* alternations of a size and the standard */
  READING_NS = 2000000 /* shortest measurement: calls are repeated to fill it */
};
static const int64_t clearly = 105; /* percent of the best time: a smaller difference is noise */

struct form {
  int most;         /* largest size that kernels can be built with */
  int tried[SIZES]; /* the standard first; 0: none */
};
static const struct tunable {
  const char *name;
  bool reorders;     /* changes the order of sums, and so the rounding of results */
  bool power_of_two; /* only such sizes can be built */
  struct form gpu, cpu;
} tunables[ERN_CL_TUNABLE_COUNT] = {
    [ERN_CL_SIZE_mlp_fwd] = {"mlp_fwd", false, false, {256, {64, 32, 128, 256}}, {3, {3, 2, 1}}},
    [ERN_CL_SIZE_mlp_bwd] = {"mlp_bwd", true, false, {256, {64, 32, 128}}, {3, {3, 2}}},
    [ERN_CL_SIZE_grid_fwd] = {"grid_fwd", false, true, {512, {64, 32, 128, 256}}, {256, {64, 16, 256}}},
    [ERN_CL_SIZE_grid_bwd] = {"grid_bwd", false, true, {512, {64, 32, 128, 256}}, {256, {64, 16, 256}}},
    [ERN_CL_SIZE_rays_tile] = {"rays_tile", false, false, {256, {64, 32, 128}}, {8, {3, 2, 4}}},
    [ERN_CL_SIZE_rays_groups] = {"rays_groups", false, false, {1024, {16, 4, 8, 32}}, {1024, {2, 1, 4, 8}}},
    [ERN_CL_SIZE_torso_tile] = {"torso_tile", false, false, {256, {64, 32, 128}}, {8, {3, 2, 4}}},
    [ERN_CL_SIZE_torso_groups] = {"torso_groups", false, false, {1024, {16, 4, 8, 32}}, {1024, {2, 1, 4, 8}}},
};

static const struct form *form_of(const struct ern_cl_device *device, ern_cl_tunable tunable) {
  return device->cpu ? &tunables[tunable].cpu : &tunables[tunable].gpu;
}

int ern_cl_standard_size(const struct ern_cl_device *device, ern_cl_tunable tunable) {
  return form_of(device, tunable)->tried[0];
}

int ern_cl_size_selected(const struct ern_cl_measured *m) {
  return m->standard_ns > m->best_ns / 100 * clearly ? m->best : m->standard;
}

/* ---- what is kept ------------------------------------------------------------------------------------------------ */

ern_status ern_cl_tune_key(ern_context *context, const struct ern_cl_device *device, char key[ERN_CL_KEY_BYTES]) {
  static const ern_cl_source sources[] = {ERN_CL_mlp, ERN_CL_hashgrid, ERN_CL_render, ERN_CL_render_torso};
  enum { COUNT = sizeof sources / sizeof *sources };
  char keys[COUNT][ERN_CL_KEY_BYTES] = {{0}}, options[ERN_CL_KEY_BYTES];
  ern_status status = ERN_OK;
  for (size_t i = 0; i < COUNT; i++) {
    ern_cl_base_options(device, sources[i], options, sizeof options);
    ERN_TRY(ern_cl_program_key(context, device, sources[i], options, keys[i]));
  }
  ern_sha256_hex(keys, sizeof keys, key);
fail:
  return status;
}

static bool is_size(const struct ern_cl_device *device, ern_cl_tunable tunable, int size) {
  return size >= 1 && size <= form_of(device, tunable)->most &&
         (!tunables[tunable].power_of_two || (size & (size - 1)) == 0);
}

/* Nanoseconds of a call: below eleven days, so that arithmetic with it does not overflow. */
static bool is_time(int64_t ns) { return ns > 0 && ns < (int64_t)1000000000000000; }

static bool is_sound(const struct ern_cl_device *device, const struct ern_cl_measured *measured) {
  for (ern_cl_tunable tunable = 0; tunable < ERN_CL_TUNABLE_COUNT; tunable++) {
    const struct ern_cl_measured *m = &measured[tunable];
    if (m->standard_ns == 0) continue;
    if (!is_time(m->standard_ns) || !is_time(m->best_ns) || m->standard != ern_cl_standard_size(device, tunable) ||
        !is_size(device, tunable, m->best))
      return false;
  }
  return true;
}

void ern_cl_tune_read(ern_context *context, const struct ern_cl_device *device, struct ern_cl_measured *measured) {
  const size_t expected = ERN_CL_TUNABLE_COUNT * sizeof *measured;
  char key[ERN_CL_KEY_BYTES];
  uint8_t *bytes = NULL;
  size_t count = 0;
  memset(measured, 0, expected);
  if (ern_cl_tune_key(context, device, key) == ERN_OK) ern_cl_cache_read(context, key, &bytes, &count);
  if (bytes != NULL && count == expected) memcpy(measured, bytes, expected);
  if (!is_sound(device, measured)) memset(measured, 0, expected);
  ern_release(context, bytes);
}

bool ern_cl_tune_write(ern_context *context, const struct ern_cl_device *device,
                       const struct ern_cl_measured *measured) {
  char key[ERN_CL_KEY_BYTES];
  return ern_cl_tune_key(context, device, key) == ERN_OK &&
         ern_cl_cache_write(context, key, measured, ERN_CL_TUNABLE_COUNT * sizeof *measured);
}

/* ---- measuring --------------------------------------------------------------------------------------------------- */

static int64_t now_ns(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

/* The standard and another size, each prepared on its stream. */
struct comparison {
  struct ern_cl_backend *bench;
  struct ern_cl_workloads *loads;
  struct ern_stream *stream[2];
  ern_cl_tunable tunable;
  int size[2];
};

static ern_status time_calls(struct comparison *c, int side, int64_t calls, int64_t *ns) {
  const int64_t began = now_ns();
  ern_status status = ERN_OK;
  c->bench->size[c->tunable] = c->size[side];
  for (int64_t i = 0; i < calls; i++) ERN_TRY(ern_cl_workload_run(c->loads, c->tunable, c->stream[side]));
  ERN_TRY(ern_opencl_finish(c->stream[side]));
  *ns = now_ns() - began;
fail:
  return status;
}

/* Builds with a size, and runs once, to see whether the device accepts it. */
static ern_status build_and_time(struct comparison *c, int side, int size, int64_t *ns) {
  ern_status status = ERN_OK;
  c->bench->size[c->tunable] = c->size[side] = size;
  ERN_TRY(ern_cl_workload_prepare(c->loads, c->tunable, c->stream[side]));
  ERN_TRY(time_calls(c, side, 1, ns));
  status = time_calls(c, side, 1, ns);
fail:
  return status;
}

/* The shortest time of a call with each size, in nanoseconds. */
static ern_status time_alternately(struct comparison *c, int64_t call_ns, int64_t least[2]) {
  const int64_t calls = 1 + READING_NS / (call_ns > 0 ? call_ns : 1);
  ern_status status = ERN_OK;
  least[0] = least[1] = INT64_MAX;
  for (int turn = 0; turn < 2 * TURNS; turn++) {
    const int side = turn % 2;
    int64_t ns = 0;
    ERN_TRY(time_calls(c, side, calls, &ns));
    if (ns / calls < least[side]) least[side] = ns / calls > 0 ? ns / calls : 1;
  }
fail:
  return status;
}

/* *m: result of the size that is fastest relative to the standard. *m is not changed where the time runs out. */
static ern_status measure_tunable(struct comparison *c, int64_t end, struct ern_cl_measured *m) {
  const struct form *form = form_of(&c->bench->device, c->tunable);
  const int standard = form->tried[0];
  struct ern_cl_measured found = {.standard = standard, .best = standard};
  double best_ratio = 0;
  int64_t ns = 0, least[2];
  ern_status status = ERN_OK;
  if (now_ns() >= end) return ERN_OK;
  ERN_TRY(build_and_time(c, 0, standard, &ns));
  found.standard_ns = found.best_ns = ns > 0 ? ns : 1;
  for (int i = 1; i < SIZES && form->tried[i] > 0; i++) {
    if (now_ns() >= end) goto fail;
    if (build_and_time(c, 1, form->tried[i], &ns) != ERN_OK) continue;
    ERN_TRY(time_alternately(c, ns, least));
    const double ratio = (double)least[0] / (double)least[1];
    if (ratio <= best_ratio) continue;
    best_ratio = ratio;
    found = (struct ern_cl_measured){standard, form->tried[i], least[0], least[1]};
  }
  *m = found;
fail:
  c->bench->size[c->tunable] = m->standard_ns > 0 ? ern_cl_size_selected(m) : standard;
  return status;
}

ern_status ern_cl_measure(struct ern_cl_backend *bench, unsigned wanted, double seconds,
                          struct ern_cl_measured *measured) {
  const int64_t end = now_ns() + (int64_t)(seconds * 1e9);
  struct comparison comparison = {.bench = bench};
  struct ern_backend *table = &bench->table;
  ern_status status = ERN_OK;
  if (!(seconds > 0)) return ERN_OK;
  ERN_TRY(ern_cl_loads_make(bench, &comparison.loads));
  for (int side = 0; side < 2; side++) ERN_TRY(table->stream_make(table, 1, &comparison.stream[side]));
  for (ern_cl_tunable tunable = 0; tunable < ERN_CL_TUNABLE_COUNT; tunable++) {
    comparison.tunable = tunable;
    if ((wanted >> tunable & 1) != 0) ERN_TRY(measure_tunable(&comparison, end, &measured[tunable]));
  }
fail:
  for (int side = 0; side < 2; side++) table->stream_free(comparison.stream[side]);
  ern_cl_loads_free(comparison.loads);
  return status;
}

/* ---- what is known ------------------------------------------------------------------------------------------- */

unsigned ern_cl_unknown_tunables(const struct ern_cl_measured *measured) {
  unsigned unknown = 0;
  for (int tunable = 0; tunable < ERN_CL_TUNABLE_COUNT; tunable++)
    unknown |= (unsigned)(measured[tunable].standard_ns == 0) << tunable;
  return unknown;
}

bool ern_cl_is_tuned(const struct ern_cl_measured *measured) { return ern_cl_unknown_tunables(measured) == 0; }

void ern_cl_sizes_set(struct ern_cl_backend *backend) {
  for (ern_cl_tunable tunable = 0; tunable < ERN_CL_TUNABLE_COUNT; tunable++) {
    const struct ern_cl_measured *m = &backend->measured[tunable];
    const bool usable = m->standard_ns > 0 && !(tunables[tunable].reorders && backend->table.deterministic);
    backend->size[tunable] = usable ? ern_cl_size_selected(m) : ern_cl_standard_size(&backend->device, tunable);
  }
}

const char *ern_cl_tunable_name(ern_cl_tunable tunable) { return tunables[tunable].name; }
