/* SPDX-License-Identifier: MIT
 * A pool of threads that works through numbered tasks. The assignment of tasks to threads varies from run to run;
 * results must not depend on it. */
#ifndef ERN_CORE_THREADS_H
#define ERN_CORE_THREADS_H

#include "core/status.h"

struct ern_pool;

/* threads 1..ERN_THREADS_MOST, the caller included; 0: ern_machine_cores. */
ERN_NODISCARD ern_status ern_pool_make(ern_context *context, int threads, struct ern_pool **pool);
void ern_pool_free(struct ern_pool *pool);         /* accepts NULL */
int ern_pool_threads(const struct ern_pool *pool); /* NULL: 1 */

/* Calls task(user, index, worker) for index 0..count-1 and returns when all are done; worker is 0..threads-1, one at a
 * time. pool NULL: in order, by the caller alone. Not to be called from within a task of the same pool. */
void ern_pool_run(struct ern_pool *pool, size_t count, void (*task)(void *user, size_t index, int worker), void *user);

#endif
