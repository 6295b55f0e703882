/* SPDX-License-Identifier: MIT
 * libernerf-mpi: an ern_communicator over the processes that mpirun started (MPI_COMM_WORLD). The program loads it only
 * where mpirun started it, so that other runs do not load MPI. It does not depend on libernerf: it reports an error as
 * a status and a text. */
#ifndef ERN_MPI_WORLD_H
#define ERN_MPI_WORLD_H

#include "ernerf/train.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A process's view of the other processes. */
struct ern_mpi_world {
  ern_communicator communicator;
  int place; /* rank of this process among those of its machine, from 0 (local rank) */
};

/* The functions of the library. */
struct ern_mpi {
  const char *version; /* ERN_INTERFACE_VERSION */
  const char *mpi;     /* "Open MPI v4.1.4, ..." */
  /* Call it once a process, before any other MPI call (MPI_Init). interrupted: polled while this process waits for
   * others; where it returns true, the wait continues for a moment and then ends. */
  ern_status (*open)(struct ern_mpi_world *world, bool (*interrupted)(void), char words[ERN_COMMUNICATOR_WORDS]);
  /* After success all processes end together (MPI_Finalize). A process that failed waits some seconds, in which the
   * others can fail too and save their work. Then it makes mpirun end them (MPI_Abort) and does not return. */
  void (*close)(struct ern_mpi_world *world, int exit_status);
};

/* The only exported symbol. */
extern ERN_API const struct ern_mpi ern_mpi;

#ifdef __cplusplus
}
#endif
#endif
