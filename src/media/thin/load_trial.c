/* SPDX-License-Identifier: MIT */
#define _GNU_SOURCE /* MAP_ANONYMOUS */
#include "media/thin/load_trial.h"

#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

/* libernerf-media-impl starts 4, those of log4cplus (measured on two cores); OpenBLAS may start one a core. */
enum { THREADS = 8 };

static bool is_limited(int resource) {
  struct rlimit limit;
  return getrlimit(resource, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY;
}

static void *hold(void *user) {
  pthread_mutex_t *mutex = user;
  (void)pthread_mutex_lock(mutex);
  (void)pthread_mutex_unlock(mutex);
  return NULL;
}

/* Whether so many threads can run at a time. */
static bool has_threads(void) {
  pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
  pthread_t thread[THREADS];
  int made = 0;
  (void)pthread_mutex_lock(&mutex);
  while (made < THREADS && pthread_create(&thread[made], NULL, hold, &mutex) == 0) made++;
  (void)pthread_mutex_unlock(&mutex);
  for (int i = 0; i < made; i++) (void)pthread_join(thread[i], NULL);
  return made == THREADS;
}

/* Address space of the other threads of the process: glibc's fork gives their stacks (8 MiB) and heaps (64 MiB) to the
 * threads of the child, which so needs less than the process will. */
static rlim_t bytes_of_threads(void) {
  DIR *threads = opendir("/proc/self/task");
  rlim_t count = 0;
  for (const struct dirent *entry = threads != NULL ? readdir(threads) : NULL; entry != NULL; entry = readdir(threads))
    count += entry->d_name[0] != '.';
  if (threads != NULL) (void)closedir(threads);
  return count > 1 ? (count - 1) * 72 * 1024 * 1024 : 0;
}

/* What the child says, in memory that it shares: waitpid does not know it where the program ignores or collects its
 * children. */
enum answer { ENDED = 0, REFUSED, LOADED };

/* The child: only glibc's fork allows dlopen after it in a process with threads. */
static void load(const char *file, const char *const *first, rlim_t reserve, volatile char *answer) {
  const struct rlimit no_core = {0, 0};
  struct rlimit limit;
  const int silence = open("/dev/null", O_WRONLY);
  (void)setrlimit(RLIMIT_CORE, &no_core);
  if (getrlimit(RLIMIT_AS, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY) {
    limit.rlim_cur -= reserve < limit.rlim_cur ? reserve : limit.rlim_cur;
    (void)setrlimit(RLIMIT_AS, &limit);
  }
  (void)signal(SIGABRT, SIG_DFL);
  if (silence >= 0) (void)dup2(silence, STDERR_FILENO);
  for (; first != NULL && *first != NULL; first++) (void)dlopen(*first, RTLD_LAZY | RTLD_LOCAL);
  *answer = dlopen(file, RTLD_LAZY | RTLD_LOCAL) != NULL ? LOADED : REFUSED;
  _exit(0); /* the forked child alone */
}

bool ern_load_trial(const char *file, const char *const *first) {
  if (!is_limited(RLIMIT_AS) && !is_limited(RLIMIT_DATA) && has_threads()) return true;
  const rlim_t reserve = bytes_of_threads();
  volatile char *answer = mmap(NULL, 1, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  if (answer == MAP_FAILED) return false;
  const pid_t child = fork();
  if (child == 0) load(file, first, reserve, answer);
  while (child > 0 && waitpid(child, NULL, 0) < 0 && errno == EINTR) continue;
  const char found = *answer;
  (void)munmap((void *)answer, 1);
  /* a refusal by dlopen is left to the caller's dlopen, which says why, unless the child had less memory */
  return found == LOADED || (found == REFUSED && reserve == 0);
}
