/* SPDX-License-Identifier: MIT
 * Seconds of sums of a step by libernerf-mpi, and the processor's: link_sums VALUES SUMS SHARE, under mpirun; SHARE of
 * the values are not 0. */
#include <mpi.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/resource.h>

#include "mpi/mpi_world.h"

enum { FIGURES = 397 /* doubles of struct ern_step_sum */ };

static int by_size(const void *left, const void *right) {
  const double a = *(const double *)left, b = *(const double *)right;
  return (a > b) - (a < b);
}

static double processor(void) {
  struct rusage used;
  getrusage(RUSAGE_SELF, &used);
  return (double)(used.ru_utime.tv_sec + used.ru_stime.tv_sec) +
         1e-6 * (double)(used.ru_utime.tv_usec + used.ru_stime.tv_usec);
}

int main(int argc, char **argv) {
  static double figures[FIGURES];
  char words[ERN_COMMUNICATOR_WORDS] = "";
  struct ern_mpi_world world;
  const int sums = argc == 4 ? atoi(argv[2]) : 0;
  const size_t count = argc == 4 ? (size_t)atol(argv[1]) : 0;
  float *values = calloc(count + 1, sizeof *values);
  double *times = calloc((size_t)sums + 1, sizeof *times);
  if (values == NULL || times == NULL || sums <= 0 || ern_mpi.open(&world, NULL, words) != ERN_OK) {
    fprintf(stderr, "link_sums: usage: link_sums VALUES SUMS SHARE; %s\n", words);
    return 1;
  }
  for (uint32_t i = 0, random = 1; i < count; i++) {
    random = random * 1664525u + 1013904223u;
    values[i] = (random >> 8) < atof(argv[3]) * 16777216 ? 1 : 0;
  }
  const ern_communicator *together = &world.communicator;
  const double before = processor();
  ern_status status = ERN_OK;
  for (int k = 0; k < sums && status == ERN_OK; k++) {
    status = together->broadcast(together->user, figures, sizeof *figures, words); /* so that both begin at once */
    const double began = MPI_Wtime();
    if (status == ERN_OK) status = together->sum(together->user, values, count, figures, FIGURES, words);
    times[k] = MPI_Wtime() - began;
  }
  if (status != ERN_OK) fprintf(stderr, "link_sums: %s\n", words);
  qsort(times, (size_t)sums, sizeof *times, by_size);
  if (status == ERN_OK && together->rank == 0)
    printf("%zu values, %d processes, %d sums: median %.2f ms, least %.2f ms, processor %.2f ms a sum\n", count,
           together->size, sums, 1e3 * times[sums / 2], 1e3 * times[0], 1e3 * (processor() - before) / sums);
  ern_mpi.close(&world, status == ERN_OK ? 0 : 1);
  free(values);
  free(times);
  return status == ERN_OK ? 0 : 1;
}
