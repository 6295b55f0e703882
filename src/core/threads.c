/* SPDX-License-Identifier: MIT */
#include "core/threads.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>

#include "core/floats.h"
#include "core/machine.h"
#include "core/memory.h"
#include "ernerf/backend.h"

enum {
  MAX_THREADS = ERN_THREADS_MOST,
  SPINS = 400,            /* checks before a thread sleeps: about 20 us, which is less than waking it takes */
  STACK_BYTES = 512 << 10 /* what a caller has too (base.h); of some systems the default of threads is less */
};

struct ern_pool {
  ern_context *context;
  int threads;
  int started; /* helper threads that must be joined */
  pthread_t helper[MAX_THREADS];
  struct worker {
    struct ern_pool *pool;
    int number;
  } worker[MAX_THREADS];
  pthread_mutex_t mutex;
  pthread_cond_t work, done;
  atomic_uint_least64_t round; /* grows by one a run */
  bool open;                   /* helpers may still join the round */
  atomic_int busy;             /* helpers that have joined it and have not finished */
  int spins; /* 0 where there are more threads than cores: spinning would then keep another thread from working */
  bool closing;
  void (*task)(void *user, size_t index, int worker);
  void *user;
  size_t count;
  atomic_size_t next;
};

/* A short pause, which leaves the core to its other hardware thread. */
static void pause_shortly(void) {
#if defined(__x86_64__)
  __builtin_ia32_pause();
#elif defined(__aarch64__)
  __asm__ volatile("yield");
#endif
}

static void work_through(struct ern_pool *pool, int worker) {
  for (;;) {
    const size_t index = atomic_fetch_add(&pool->next, 1);
    if (index >= pool->count) return;
    pool->task(pool->user, index, worker);
  }
}

static void *helper_main(void *argument) {
  ERN_PLAIN_FLOATS;
  const struct worker *worker = argument;
  struct ern_pool *pool = worker->pool;
  uint64_t seen = 0;
  for (;;) {
    for (int k = 0; k < pool->spins && atomic_load(&pool->round) == seen; k++) pause_shortly();
    pthread_mutex_lock(&pool->mutex);
    while (!pool->closing && (!pool->open || atomic_load(&pool->round) == seen))
      pthread_cond_wait(&pool->work, &pool->mutex);
    const bool closing = pool->closing;
    seen = atomic_load(&pool->round);
    if (!closing) atomic_fetch_add(&pool->busy, 1);
    pthread_mutex_unlock(&pool->mutex);
    if (closing) return NULL;
    work_through(pool, worker->number);
    pthread_mutex_lock(&pool->mutex);
    if (atomic_fetch_sub(&pool->busy, 1) == 1) pthread_cond_signal(&pool->done);
    pthread_mutex_unlock(&pool->mutex);
  }
}

static bool start(pthread_t *thread, struct worker *worker) {
  pthread_attr_t attributes;
  size_t bytes = 0;
  if (pthread_attr_init(&attributes) != 0) return false;
  if (pthread_attr_getstacksize(&attributes, &bytes) == 0 && bytes < STACK_BYTES)
    (void)pthread_attr_setstacksize(&attributes, STACK_BYTES);
  const bool started = pthread_create(thread, &attributes, helper_main, worker) == 0;
  pthread_attr_destroy(&attributes);
  return started;
}

ern_status ern_pool_make(ern_context *context, int threads, struct ern_pool **pool) {
  *pool = NULL;
  if (threads < 0 || threads > MAX_THREADS)
    return ern_fail(context, ERN_E_ARGUMENT, "threads: found %d, expected 0 to %d", threads, MAX_THREADS);
  struct ern_pool *made = NULL;
  const ern_status status = ERN_NEW(context, 1, &made);
  if (status != ERN_OK) return status;
  made->context = context;
  made->threads = threads > 0 ? threads : ern_machine_cores();
  if (made->threads > MAX_THREADS) made->threads = MAX_THREADS;
  made->spins = made->threads <= ern_machine_cores() ? SPINS : 0;
  pthread_mutex_init(&made->mutex, NULL);
  pthread_cond_init(&made->work, NULL);
  pthread_cond_init(&made->done, NULL);
  for (int i = 1; i < made->threads; i++) {
    made->worker[i] = (struct worker){made, i};
    if (!start(&made->helper[i], &made->worker[i])) {
      const int wanted = made->threads;
      ern_pool_free(made);
      return ern_fail(context, ERN_E_NO_MEMORY, "threads: the system refused thread %d of %d", i + 1, wanted);
    }
    made->started++;
  }
  *pool = made;
  return ERN_OK;
}

void ern_pool_free(struct ern_pool *pool) {
  if (pool == NULL) return;
  pthread_mutex_lock(&pool->mutex);
  pool->closing = true;
  pthread_cond_broadcast(&pool->work);
  pthread_mutex_unlock(&pool->mutex);
  for (int i = 1; i <= pool->started; i++) pthread_join(pool->helper[i], NULL);
  pthread_cond_destroy(&pool->done);
  pthread_cond_destroy(&pool->work);
  pthread_mutex_destroy(&pool->mutex);
  ern_release(pool->context, pool);
}

int ern_pool_threads(const struct ern_pool *pool) { return pool != NULL ? pool->threads : 1; }

void ern_pool_run(struct ern_pool *pool, size_t count, void (*task)(void *user, size_t index, int worker), void *user) {
  if (pool == NULL || pool->started == 0 || count < 2) {
    for (size_t i = 0; i < count; i++) task(user, i, 0);
    return;
  }
  pthread_mutex_lock(&pool->mutex);
  pool->task = task;
  pool->user = user;
  pool->count = count;
  atomic_store(&pool->next, 0);
  pool->open = true;
  atomic_fetch_add(&pool->round, 1);
  pthread_cond_broadcast(&pool->work);
  pthread_mutex_unlock(&pool->mutex);
  work_through(pool, 0);
  for (int k = 0; k < pool->spins && atomic_load(&pool->busy) > 0; k++) pause_shortly();
  pthread_mutex_lock(&pool->mutex);
  pool->open = false; /* threads that are not awake yet are not waited for */
  while (atomic_load(&pool->busy) > 0) pthread_cond_wait(&pool->done, &pool->mutex);
  pthread_mutex_unlock(&pool->mutex);
}
