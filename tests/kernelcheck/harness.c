/* SPDX-License-Identifier: MIT
 * What the nouns of kernelcheck need of the backends' insides, and the clock. */
#include "harness.h"

#include <time.h>

#if defined(ERN_LAB)
#include "ernerf-lab/bench.h"
#endif
#if defined(ERN_OPENCL)
#include "backend_opencl/opencl.h"
#endif

#if defined(ERN_OPENCL)
static struct ern_cl_device *device_of(int k) { return &((struct ern_cl_backend *)machines.backend[k])->device; }

bool divides_exactly(int k) { return !is_device(k) || device_of(k)->exact_divide; }
bool compiles_for_cpus(int k) { return is_device(k) && device_of(k)->cpu; }
bool is_gpu(int k) { return is_device(k) && !device_of(k)->host; }
size_t set_local_bytes(int k, size_t bytes) {
  const size_t own = device_of(k)->local_bytes;
  if (bytes > 0) device_of(k)->local_bytes = bytes;
  return own;
}
/* What was uploaded on a stream is there for another one once the first has been waited for. */
static void stream_wait(int k) {
  if (is_device(k)) assert_int_equal(clFinish(ern_cl_stream_of(machines.stream[k])->queue), CL_SUCCESS);
}
int set_vector_width(int k, int width) {
  const int own = device_of(k)->width;
  if (width > 0) device_of(k)->width = width;
  return own;
}
#else
bool divides_exactly(int k) { return k >= 0; }
bool compiles_for_cpus(int k) { return k < 0; }
bool is_gpu(int k) { return k < 0; }
size_t set_local_bytes(int k, size_t bytes) { return (void)k, bytes; }
static void stream_wait(int k) { (void)k; }
int set_vector_width(int k, int width) { return (void)k, width; }
#endif

struct ern_stream *stream_replace(int k, int threads) {
  struct ern_stream *own = machines.stream[k];
  stream_wait(k);
  support_ok(machines.context, machines.backend[k]->stream_make(machines.backend[k], threads, &machines.stream[k]));
  return own;
}

void stream_restore(int k, struct ern_stream *own) {
  machines.backend[k]->stream_free(machines.stream[k]);
  machines.stream[k] = own;
}

/* ---- speed ---- */

double products_of(const struct ern_mlp *mlp, bool backward) {
  double all = 0, hidden = 0;
  for (int l = 0; l < mlp->layers; l++) {
    const double weights = (double)mlp->width[l] * mlp->width[l + 1];
    all += weights;
    if (l + 1 < mlp->layers) hidden += weights;
  }
  return backward ? 2 * all + hidden : all;
}

/* Floating-point operations a second of one core, by its instruction set; all are measured at the first question. 0 of
 * a device, and in a build without the laboratory. */
static double peak_of(int k) {
#if defined(ERN_LAB)
  ern_bench_options options = ern_bench_options_default();
  ern_bench_machine found;
  size_t cpus = 0;
  options.threads = 1;
  options.seconds = 1;
  while ((int)cpus < machines.count && !is_device((int)cpus)) cpus++; /* they come first */
  if (machines.peak[0] == 0) {
    support_ok(machines.context, ern_bench_peaks(machines.backend, cpus, &options, &found));
    for (size_t i = 0; i < cpus; i++) machines.peak[i] = found.peak[i].flops.one;
  }
#endif
  return machines.peak[k];
}

static double seconds_now(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* A small blocking read, so that the time is of work that is done. */
static void wait_for(int k) {
  struct ern_backend *backend = machines.backend[k];
  struct ern_buffer *buffer = NULL;
  float value;
  support_ok(machines.context, backend->synchronize(machines.stream[k]));
  support_ok(machines.context, backend->buffer_make(backend, ERN_ELEMENT_REAL, 1, &buffer));
  support_ok(machines.context, backend->download_reals(machines.stream[k], &value, (ern_span){buffer, 0, 1}, 1));
  backend->buffer_free(backend, buffer);
}

/* Before the first call of a machine, and after each: the first one, which may build a program, does not count. */
bool bench_again(struct bench_line *line) {
  if (line->calls > 0) {
    wait_for(line->k);
    const double seconds = seconds_now() - line->began;
    if (line->calls > 1) {
      line->least = fmin(line->least, seconds);
      line->total += seconds;
    }
  }
  if (line->calls > 8 && (line->total > 0.1 || line->calls > 2000)) {
    if (line->k == 0) line->reference = line->least;
    const double peak = line->products > 0 ? peak_of(line->k) : 0;
    printf("%-32s %-12s %12.2f ns each, %6.2f times %s", line->what, machines.name[line->k],
           1e9 * line->least / line->items, line->reference / line->least, machines.name[0]);
    if (peak > 0) printf(", %3.0f %% of the peak", 100 * 2 * line->products / line->least / peak);
    printf("\n");
    line->k++;
    line->calls = 0;
  }
  if (line->k == machines.count) return false;
  if (line->calls == 0) line->least = INFINITY, line->total = 0;
  line->calls++;
  line->began = seconds_now();
  return true;
}
