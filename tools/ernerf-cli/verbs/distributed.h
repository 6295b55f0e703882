/* SPDX-License-Identifier: MIT
 * The other processes that mpirun started beside this one: libernerf-mpi, loaded where there are any. */
#ifndef ERN_CLI_DISTRIBUTED_H
#define ERN_CLI_DISTRIBUTED_H

#include "mpi/mpi_world.h"
#include "session/session.h"

struct distributed {
  void *library;
  const struct ern_mpi *functions; /* NULL: this process is alone */
  struct ern_mpi_world world;      /* communicator.size 1 then */
};

/* Where Open MPI, MPICH, or another launcher by PMI or PMIx started the program: waits for the others. Processes of
 * other ranks than 0 say errors alone from then on. Returns 0, or EXIT_FAILURE after a message. */
int distributed_open(struct distributed *distributed, struct session *session);
/* With --backend opencl the processes of a machine take its devices in turn. Returns as above. */
int distributed_choose_device(const struct distributed *distributed, struct session *session);
/* NULL where this process is alone. */
const ern_communicator *distributed_communicator(const struct distributed *distributed);
/* After a failure the others are ended too, once they had the time to save. */
void distributed_close(struct distributed *distributed, int status);

#endif
