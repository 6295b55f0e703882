/* SPDX-License-Identifier: MIT
 * The sum of libernerf-mpi against the binary tree that train.h defines it by, bit for bit, under mpirun: of values
 * that are all 0, hardly any 0, -0, denormal, huge or infinite, in counts around the groups that are sent. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "mpi/mpi_world.h"

enum { KINDS = 6, MOST = 4097, RANKS = 8 };

/* Value i of a rank, the same wherever it is asked for. */
static float value_of(int rank, size_t i, int kind) {
  uint32_t random = (uint32_t)rank * 2654435761u ^ (uint32_t)i * 2246822519u ^ (uint32_t)kind * 3266489917u;
  random = (random ^ random >> 15) * 2246822519u;
  random = (random ^ random >> 13) * 3266489917u;
  random ^= random >> 16;
  const float any = (float)(int32_t)random / 65536;
  switch (kind) {
    case 0: return 0;
    case 1: return any;
    case 2: return random % 3 == 0 ? any : 0; /* as a step's */
    case 3: return random % 2 == 0 ? -0.0f : 0.0f;
    case 4: return random % 2 == 0 ? any * 1e-44f : any * 1e33f;
    default: return random % 50 == 0 ? INFINITY : random % 3 == 0 ? any : 0;
  }
}

static float tree(int first, int ranks, size_t i, int kind) {
  if (ranks == 1) return value_of(first, i, kind);
  return tree(first, ranks / 2, i, kind) + tree(first + ranks / 2, ranks / 2, i, kind);
}

static int check(const ern_communicator *together, size_t count, int kind) {
  static float values[MOST];
  double figures[3] = {together->rank, 1, 0.5};
  char words[ERN_COMMUNICATOR_WORDS] = "";
  for (size_t i = 0; i < count; i++) values[i] = value_of(together->rank, i, kind);
  if (together->sum(together->user, values, count, figures, 3, words) != ERN_OK) {
    fprintf(stderr, "tree_sums: %s\n", words);
    return 1;
  }
  const int size = together->size;
  if (figures[0] != size * (size - 1) / 2 || figures[1] != size || figures[2] != 0.5 * size) {
    fprintf(stderr, "tree_sums: figures %g %g %g on %d processes\n", figures[0], figures[1], figures[2], size);
    return 1;
  }
  for (size_t i = 0; i < count; i++) {
    const float expected = tree(0, size, i, kind);
    if (memcmp(&expected, values + i, sizeof expected) == 0) continue;
    fprintf(stderr, "tree_sums: kind %d, value %zu of %zu on %d processes: %a, expected %a\n", kind, i, count, size,
            (double)values[i], (double)expected);
    return 1;
  }
  return 0;
}

int main(void) {
  static const size_t counts[] = {0, 1, 2, 3, 63, 64, 65, 127, 128, 129, 1000, MOST};
  char words[ERN_COMMUNICATOR_WORDS] = "";
  struct ern_mpi_world world;
  int faults = 0;
  if (ern_mpi.open(&world, NULL, words) != ERN_OK || world.communicator.size > RANKS) {
    fprintf(stderr, "tree_sums: expected 1 to %d processes of mpirun; %s\n", RANKS, words);
    return 1;
  }
  for (size_t c = 0; c < sizeof counts / sizeof *counts; c++)
    for (int kind = 0; kind < KINDS && faults == 0; kind++) faults += check(&world.communicator, counts[c], kind);
  if (faults == 0 && world.communicator.rank == 0) printf("sums on %d processes agree\n", world.communicator.size);
  ern_mpi.close(&world, faults);
  return faults != 0;
}
