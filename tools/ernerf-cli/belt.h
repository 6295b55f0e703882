/* SPDX-License-Identifier: MIT
 * A belt between two threads: a few places for items, filled by one thread and emptied by another in the same order.
 * What lies in the places is the users' own. */
#ifndef ERN_CLI_BELT_H
#define ERN_CLI_BELT_H

#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>

struct belt {
  pthread_mutex_t mutex;
  pthread_cond_t moved;
  size_t places;
  size_t filled, emptied; /* items so far */
  bool ended;             /* nothing more will be filled */
  bool broken;            /* one side gave up */
};

enum { BELT_OVER = -1 };

void belt_make(struct belt *belt, size_t places);
void belt_free(struct belt *belt);

/* Filling: the place for the next item, once it is free, or BELT_OVER when the other side gave up. */
int belt_free_place(struct belt *belt);
void belt_fill(struct belt *belt); /* that place */
void belt_end(struct belt *belt);  /* nothing more comes */

/* Emptying: the place of the oldest item, once there is one, or BELT_OVER: nothing more comes, or the other side gave
 * up. */
int belt_item(struct belt *belt);
void belt_empty(struct belt *belt); /* that place */

/* Either side: no more work; whoever waits is told. */
void belt_break(struct belt *belt);

#endif
