/* SPDX-License-Identifier: MIT */
#include "verbs/distributed.h"

#include <dlfcn.h>
#include <stdlib.h>
#include <string.h>

#include "core/interface_version.h"

#define TEXT_OF(x) #x
#define SONAME(major) "libernerf-mpi.so." TEXT_OF(major)

/* Checks environment variables that launchers set in each process, and the number of processes if it is among them. A
 * single process needs no MPI. */
static bool was_launched_with_others(void) {
  static const char *const names[] = {"OMPI_COMM_WORLD_SIZE", "PMI_RANK", "PMI_SIZE", "PMIX_RANK"};
  static const char *const counts[] = {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS"};
  bool launched = false;
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) launched |= getenv(names[i]) != NULL;
  for (size_t i = 0; i < sizeof counts / sizeof *counts; i++)
    if (getenv(counts[i]) != NULL) return launched && strcmp(getenv(counts[i]), "1") != 0;
  return launched;
}

/* RTLD_GLOBAL: MPI's own modules resolve its symbols in the program's global scope. */
static int load(struct distributed *distributed, struct session *session) {
  static const char file[] = SONAME(ERN_VERSION_MAJOR);
  distributed->library = dlopen(file, RTLD_NOW | RTLD_GLOBAL | RTLD_NODELETE);
  if (distributed->library == NULL)
    return session_fail_with(session,
                             "started by mpirun, and %s cannot be loaded: %s; expected an ernerf that was built with "
                             "ERNERF_MPI",
                             file, dlerror());
  const struct ern_mpi *functions = dlsym(distributed->library, "ern_mpi");
  if (functions == NULL || strcmp(functions->version, ERN_INTERFACE_VERSION) != 0)
    return session_fail_with(session, "%s is of version %s, expected %s", file,
                             functions != NULL ? functions->version : "unknown", ERN_INTERFACE_VERSION);
  distributed->functions = functions;
  return 0;
}

int distributed_open(struct distributed *distributed, struct session *session) {
  char words[ERN_COMMUNICATOR_WORDS] = "";
  *distributed = (struct distributed){.world = {.communicator = {.size = 1}}};
  if (!was_launched_with_others()) return 0;
  if (load(distributed, session) != 0) return EXIT_FAILURE;
  if (distributed->functions->open(&distributed->world, session_interrupted, words) != ERN_OK) {
    distributed->functions = NULL;
    return session_fail_with(session, "%s", words);
  }
  session->rank = distributed->world.communicator.rank;
  if (session->rank == 0)
    session_note(session, "%s: %d processes", distributed->functions->mpi, distributed->world.communicator.size);
  return 0;
}

static void count_device(void *user, const ern_device_info *device) {
  int *devices = user;
  if (strcmp(device->kind, "opencl") == 0) (*devices)++;
}

int distributed_choose_device(const struct distributed *distributed, struct session *session) {
  int devices = 0;
  if (distributed->world.communicator.size == 1 || session->backend_choice != SESSION_OPENCL) return 0;
  if (ern_devices_list(session->context, count_device, &devices) != ERN_OK) return session_fail(session);
  session->device = devices > 0 ? distributed->world.place % devices : 0;
  return 0;
}

const ern_communicator *distributed_communicator(const struct distributed *distributed) {
  return distributed->world.communicator.size > 1 ? &distributed->world.communicator : NULL;
}

void distributed_close(struct distributed *distributed, int status) {
  if (distributed->functions != NULL) distributed->functions->close(&distributed->world, status);
  distributed->functions = NULL;
}
