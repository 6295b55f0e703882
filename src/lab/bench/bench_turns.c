/* SPDX-License-Identifier: MIT
 * Timing of several items in turns. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "backend_opencl/device/peak.h"
#include "core/profile.h"
#include "core/status.h"
#include "lab/bench/bench_shared.h"

enum { OPTIONS_COOKIE = 0x45524e62, MOST_TIMES = 1 << 20, COLD_IS_NOTHING = 4 /* seconds */ };

/* ---- options ----------------------------------------------------------------------------------------------------- */

ern_bench_options ern_bench_options_default(void) {
  return (ern_bench_options){.cookie = OPTIONS_COOKIE, .threads = 0, .seconds = 5, .frames = 16, .rays = 65536};
}

ern_status ern_bench_choose(ern_backend *const *backends, size_t count, const ern_bench_options *options,
                            ern_bench_options *chosen) {
  *chosen = options != NULL ? *options : ern_bench_options_default();
  ERN_NEED(NULL, backends);
  if (count < 1) return ERN_E_ARGUMENT; /* no context for a message */
  ERN_NEED(NULL, backends[0]);
  ern_context *context = backends[0]->context;
  if (count > ERN_BENCH_BACKENDS)
    return ern_fail(context, ERN_E_ARGUMENT, "bench: %zu backends, expected 1 to %d", count, ERN_BENCH_BACKENDS);
  for (size_t k = 1; k < count; k++) ERN_NEED(context, backends[k]);
  if (chosen->cookie != OPTIONS_COOKIE)
    return ern_fail(context, ERN_E_ARGUMENT, "bench: the options were not made by ern_bench_options_default");
  if (chosen->threads < 0 || chosen->threads > ERN_THREADS_MOST)
    return ern_fail(context, ERN_E_ARGUMENT, "bench: threads is %d, expected 0 to %d", chosen->threads,
                    ERN_THREADS_MOST);
  if (!(chosen->seconds >= 0 && chosen->seconds <= 86400))
    return ern_fail(context, ERN_E_ARGUMENT, "bench: seconds is %g, expected 0 to 86400", chosen->seconds);
  if (chosen->frames < 1 || chosen->frames > 1000)
    return ern_fail(context, ERN_E_ARGUMENT, "bench: frames is %d, expected 1 to 1000", chosen->frames);
  if (chosen->rays < 1 || chosen->rays > 1 << 20)
    return ern_fail(context, ERN_E_ARGUMENT, "bench: rays is %d, expected 1 to %d", chosen->rays, 1 << 20);
  return ERN_OK;
}

bool ern_bench_is_device(const ern_backend *backend) { return strcmp(backend->name, "cpu") != 0; }

unsigned ern_bench_units(const ern_backend *device) {
  struct ern_opencl_about about;
  ern_opencl_describe(device, &about);
  return about.units;
}

size_t ern_bench_devices(ern_backend *const *backends, size_t count) {
  size_t devices = 0;
  for (size_t k = 0; k < count; k++) devices += ern_bench_is_device(backends[k]);
  return devices;
}

ern_status ern_bench_progress(ern_context *context, const ern_bench_options *options, size_t done, size_t all) {
  if (options->progress == NULL || options->progress(options->user, done, all) == 0) return ERN_OK;
  return ern_fail(context, ERN_E_CANCELLED, "bench: stopped after %zu of %zu parts", done, all);
}

/* ---- turns ------------------------------------------------------------------------------------------------------- */

/* The readings of one item. */
struct reading {
  size_t times; /* calls in a reading */
  int wanted, taken;
  double seconds[ERN_BENCH_REPEATS]; /* of a call */
  double cpu;                        /* least CPU time of a call */
};

static double processor_seconds(void) {
  struct timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static ern_status read_one(const struct ern_bench_turns *turns, size_t which, struct reading *reading) {
  const double cpu_began = processor_seconds(), began = ern_profile_now();
  const ern_status status = turns->work(turns->user, which, reading->times);
  const double seconds = (ern_profile_now() - began) / (double)reading->times;
  const double cpu = (processor_seconds() - cpu_began) / (double)reading->times;
  reading->cpu = reading->taken == 0 ? cpu : fmin(cpu, reading->cpu);
  reading->seconds[reading->taken++] = which < turns->alone ? cpu : seconds;
  return status;
}

static int by_size(const void *a, const void *b) {
  const double left = *(const double *)a, right = *(const double *)b;
  return (left > right) - (left < right);
}

static ern_bench_timing summary(struct reading *reading) {
  const int n = reading->taken;
  qsort(reading->seconds, (size_t)n, sizeof(double), by_size);
  const double *s = reading->seconds;
  return (ern_bench_timing){
      .least = s[0], .median = (s[(n - 1) / 2] + s[n / 2]) / 2, .cpu = reading->cpu, .repeats = n};
}

/* Chooses how often a reading repeats its call, and the number of readings. The first call is cold (fresh memory, empty
 * caches), so it counts only if it takes so long that this does not matter. */
static ern_status look(const struct ern_bench_turns *turns, size_t which, struct reading *reading) {
  const double part = turns->seconds / (double)turns->count;
  reading->times = 1;
  ern_status status = read_one(turns, which, reading);
  if (status != ERN_OK || reading->seconds[0] > COLD_IS_NOTHING) return status;
  if (reading->seconds[0] < part / 16) status = read_one(turns, which, reading);
  const double once = reading->seconds[reading->taken - 1];
  const double times = ceil(turns->least / fmax(once, 1e-9));
  reading->times = times > MOST_TIMES ? MOST_TIMES : times < 1 ? 1 : (size_t)times;
  const double readings = part / fmax(once * (double)reading->times, 1e-9);
  reading->wanted = readings > turns->most ? turns->most : readings < 1 ? 1 : (int)readings;
  reading->taken = 0;
  if (turns->warm != NULL) turns->warm(turns->user, which);
  return status;
}

ern_status ern_bench_take_turns(const struct ern_bench_turns *turns, ern_bench_timing *timing) {
  struct reading reading[ERN_BENCH_TURNS] = {0};
  int rounds = 0;
  for (size_t k = 0; k < turns->count; k++) {
    const ern_status status = look(turns, k, &reading[k]);
    if (status != ERN_OK) return status;
    if (reading[k].wanted > rounds) rounds = reading[k].wanted;
  }
  for (int round = 0; round < rounds; round++)
    for (size_t k = 0; k < turns->count; k++) {
      /* spreads the readings of an item over the rounds: slow items run in few rounds, not all in the first */
      if ((round + 1) * reading[k].wanted / rounds == round * reading[k].wanted / rounds) continue;
      const ern_status status = read_one(turns, k, &reading[k]);
      if (status != ERN_OK) return status;
    }
  for (size_t k = 0; k < turns->count; k++) timing[k] = summary(&reading[k]);
  return ERN_OK;
}
