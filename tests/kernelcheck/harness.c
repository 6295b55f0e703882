/* SPDX-License-Identifier: MIT
 * What the nouns of kernelcheck need of the backends' insides, and the clock. */
#include "harness.h"

#include <time.h>

#if defined(ERN_OPENCL)
#include "backend_opencl/opencl.h"
#endif

#if defined(ERN_OPENCL)
static struct ern_cl_device *device_of(int k) { return &((struct ern_cl_backend *)machines.backend[k])->device; }

bool divides_exactly(int k) { return !is_device(k) || device_of(k)->exact_divide; }
bool compiles_for_cpus(int k) { return is_device(k) && device_of(k)->cpu; }
size_t set_local_bytes(int k, size_t bytes) {
  const size_t own = device_of(k)->local_bytes;
  if (bytes > 0) device_of(k)->local_bytes = bytes;
  return own;
}
int set_vector_width(int k, int width) {
  const int own = device_of(k)->width;
  if (width > 0) device_of(k)->width = width;
  return own;
}
#else
bool divides_exactly(int k) { return k >= 0; }
bool compiles_for_cpus(int k) { return k < 0; }
size_t set_local_bytes(int k, size_t bytes) { return (void)k, bytes; }
int set_vector_width(int k, int width) { return (void)k, width; }
#endif

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
  support_ok(machines.context, backend->settle(machines.stream[k]));
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
    printf("%-32s %-12s %12.2f ns each, %6.2f times %s\n", line->what, machines.name[line->k],
           1e9 * line->least / line->items, line->reference / line->least, machines.name[0]);
    line->k++;
    line->calls = 0;
  }
  if (line->k == machines.count) return false;
  if (line->calls == 0) line->least = INFINITY, line->total = 0;
  line->calls++;
  line->began = seconds_now();
  return true;
}
