/* SPDX-License-Identifier: MIT
 * Training by several processes that mpirun started. libernerf-mpi is loaded only if there is more than one process. */
#ifndef ERN_CLI_DISTRIBUTED_H
#define ERN_CLI_DISTRIBUTED_H

#include "mpi/mpi_world.h"
#include "session/session.h"

struct distributed {
  void *library;
  const struct ern_mpi *functions; /* NULL: this process is alone */
  struct ern_mpi_world world;      /* if alone, communicator.size is 1 */
};

/* Waits for the other processes if Open MPI, MPICH, or another launcher with PMI or PMIx started the program. From then
 * on, processes of ranks above 0 print errors only. Returns 0, or EXIT_FAILURE after a message. */
int distributed_open(struct distributed *distributed, struct session *session);
/* With --backend opencl, assigns the OpenCL devices of a machine to its processes in turn. Returns as above. */
int distributed_choose_device(const struct distributed *distributed, struct session *session);
/* NULL where this process is alone. */
const ern_communicator *distributed_communicator(const struct distributed *distributed);
/* After a failure (status not 0) also ends the other processes, once they have had time to save. */
void distributed_close(struct distributed *distributed, int status);

#endif
