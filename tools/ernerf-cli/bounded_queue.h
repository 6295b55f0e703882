/* SPDX-License-Identifier: MIT
 * A bounded FIFO queue between one producer thread and one consumer thread. It manages the indices of a few places; the
 * items in the places belong to the user. */
#ifndef ERN_CLI_BOUNDED_QUEUE_H
#define ERN_CLI_BOUNDED_QUEUE_H

#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>

struct bounded_queue {
  pthread_mutex_t mutex;
  pthread_cond_t moved;
  size_t places;
  size_t filled, emptied; /* items filled and emptied so far */
  bool ended;             /* the producer will fill no more places */
  bool broken;            /* one side gave up */
};

enum { QUEUE_CLOSED = -1 };

void queue_make(struct bounded_queue *queue, size_t places);
void queue_free(struct bounded_queue *queue);

/* Producer: waits for a free place and returns its index, or QUEUE_CLOSED if the consumer gave up. */
int queue_wait_for_slot(struct bounded_queue *queue);
/* The same for item number `item`, counted from 0, which is filled after those before it. */
int queue_wait_for_slot_of(struct bounded_queue *queue, size_t item);
bool queue_has_slot(struct bounded_queue *queue); /* whether queue_wait_for_slot would not wait */
void queue_push(struct bounded_queue *queue);     /* hands that place to the consumer */
void queue_end(struct bounded_queue *queue);      /* no more items follow */

/* Consumer: waits for an item and returns the place of the oldest, or QUEUE_CLOSED: the producer ended the queue or
 * gave up. */
int queue_wait_for_item(struct bounded_queue *queue);
bool queue_is_empty(struct bounded_queue *queue); /* whether queue_wait_for_item would wait, or say QUEUE_CLOSED */
void queue_pop(struct bounded_queue *queue);      /* frees that place */

/* Either side gives up: wakes the other side if it waits. */
void queue_break(struct bounded_queue *queue);

#endif
