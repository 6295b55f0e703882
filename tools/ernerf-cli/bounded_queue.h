/* SPDX-License-Identifier: MIT
 * A queue between two threads: a few places for items, filled by one thread and emptied by another in the same order.
 * What lies in the places is the users' own. */
#ifndef ERN_CLI_BOUNDED_QUEUE_H
#define ERN_CLI_BOUNDED_QUEUE_H

#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>

struct bounded_queue {
  pthread_mutex_t mutex;
  pthread_cond_t moved;
  size_t places;
  size_t filled, emptied; /* items so far */
  bool ended;             /* nothing more will be filled */
  bool broken;            /* one side gave up */
};

enum { QUEUE_OVER = -1 };

void queue_make(struct bounded_queue *queue, size_t places);
void queue_free(struct bounded_queue *queue);

/* Filling: the place for the next item, once it is free, or QUEUE_OVER when the other side gave up. */
int queue_wait_for_slot(struct bounded_queue *queue);
bool queue_has_slot(struct bounded_queue *queue); /* whether queue_wait_for_slot would not wait */
void queue_fill(struct bounded_queue *queue);     /* that place */
void queue_end(struct bounded_queue *queue);      /* nothing more comes */

/* Emptying: the place of the oldest item, once there is one, or QUEUE_OVER: nothing more comes, or the other side gave
 * up. */
int queue_item(struct bounded_queue *queue);
bool queue_is_empty(struct bounded_queue *queue); /* whether queue_item would wait, or say QUEUE_OVER */
void queue_empty(struct bounded_queue *queue);    /* that place */

/* Either side: no more work; whoever waits is told. */
void queue_break(struct bounded_queue *queue);

#endif
