/* SPDX-License-Identifier: MIT
 * Whether the system has what a viewer needs. GLib ends the process where it gets no open file, no thread or no memory,
 * so these are looked for before. */
#define _GNU_SOURCE /* MAP_ANONYMOUS */
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/resource.h>

#include "serve/webrtc/webrtc_shared.h"

enum {
  FILES = 64 /* a viewer takes 9 on a machine of three addresses */,
  THREADS = 16 /* it takes 7 */,
  MEMORY =
      640 << 20 /* the first one, with GStreamer, takes addresses of 815 MB where there are so many, and died of 470 */
};

static bool are_files_free(size_t count) {
  struct rlimit files;
  if (getrlimit(RLIMIT_NOFILE, &files) != 0) return true;
  for (rlim_t k = 0; k < files.rlim_cur && count > 0; k++) count -= fcntl((int)k, F_GETFD) < 0;
  return count == 0;
}

static void *pass(void *gate) {
  (void)pthread_mutex_lock(gate);
  (void)pthread_mutex_unlock(gate);
  return NULL;
}

static bool do_threads_start(void) {
  pthread_mutex_t gate = PTHREAD_MUTEX_INITIALIZER;
  pthread_t threads[THREADS];
  int started = 0;
  (void)pthread_mutex_lock(&gate);
  while (started < THREADS && pthread_create(&threads[started], NULL, pass, &gate) == 0) started++;
  (void)pthread_mutex_unlock(&gate);
  for (int k = 0; k < started; k++) (void)pthread_join(threads[k], NULL);
  return started == THREADS;
}

/* Addresses: what `ulimit -v` limits. */
static bool is_memory_free(void) {
  void *room = mmap(NULL, MEMORY, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (room == MAP_FAILED) return false;
  (void)munmap(room, MEMORY);
  return true;
}

bool webrtc_room_is_there(size_t spare_files) {
  return are_files_free(FILES + spare_files) && is_memory_free() && do_threads_start();
}
