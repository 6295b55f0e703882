/* SPDX-License-Identifier: MIT
 * Prints the results of `bench` as tables on standard output and as a JSON object. */
#ifndef ERN_CLI_BENCH_REPORT_H
#define ERN_CLI_BENCH_REPORT_H

#include "ernerf-lab/bench.h"
#include "session/session.h"

struct bench_device {
  const char *name, *driver; /* name NULL: no device is measured */
  int number;
};

struct bench_results {
  const char *cpu; /* NULL: the CPU is not measured */
  struct bench_device device;
  const char *model, *clip; /* NULL: made up */
  ern_bench_scene_info scene;
  ern_bench_machine machine;
  ern_bench_kernel *kernels;
  size_t kernel_count;
  size_t backends;
  bool has_frame, has_step, has_torso_step;
  ern_bench_pass frame[ERN_BENCH_BACKENDS], step[ERN_BENCH_BACKENDS], torso_step[ERN_BENCH_BACKENDS];
};

void bench_print_scene(const struct bench_results *results);
void bench_print_peaks(const struct bench_results *results);
void bench_print_kernels(const struct bench_results *results);
/* `title`: for example "a frame". */
void bench_print_passes(const struct bench_results *results, const char *title, const ern_bench_pass *passes);

/* A new reference; NULL: no memory. */
json_t *bench_json(const struct bench_results *results);

#endif
