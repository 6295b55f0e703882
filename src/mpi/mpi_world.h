/* SPDX-License-Identifier: MIT
 * libernerf-mpi: the processes that mpirun starts as an ern_communicator. The program opens it when mpirun started it,
 * so that nobody else loads MPI. It needs nothing of libernerf: an error is a status and words. */
#ifndef ERN_MPI_WORLD_H
#define ERN_MPI_WORLD_H

#include "ernerf/train.h"

#ifdef __cplusplus
extern "C" {
#endif

/* What a process knows of the others. */
struct ern_mpi_world {
  ern_communicator communicator;
  int place; /* of this process among those of its machine, from 0 */
};

/* The functions of the library. */
struct ern_mpi {
  const char *version; /* of the library: "0.1.0" */
  const char *mpi;     /* "Open MPI v4.1.4, ..." */
  /* Once a process, before anything else of MPI (MPI_Init). interrupted: asked while this process waits for others;
   * true: the wait goes on for a moment and is then given up. */
  ern_status (*open)(struct ern_mpi_world *world, bool (*interrupted)(void), char words[ERN_COMMUNICATOR_WORDS]);
  /* After success all processes end together. A process that failed gives the others some seconds to fail likewise,
   * and to save what they have, then has mpirun end them (MPI_Abort), and does not return. */
  void (*close)(struct ern_mpi_world *world, int exit_status);
};

/* The one symbol. */
extern ERN_API const struct ern_mpi ern_mpi;

#ifdef __cplusplus
}
#endif
#endif
