/* SPDX-License-Identifier: MIT */
#include "bounded_queue.h"

void queue_make(struct bounded_queue *queue, size_t places) {
  *queue = (struct bounded_queue){.places = places};
  pthread_mutex_init(&queue->mutex, NULL); /* neither fails on Linux */
  pthread_cond_init(&queue->moved, NULL);
}

void queue_free(struct bounded_queue *queue) {
  pthread_cond_destroy(&queue->moved);
  pthread_mutex_destroy(&queue->mutex);
}

int queue_wait_for_slot_of(struct bounded_queue *queue, size_t item) {
  pthread_mutex_lock(&queue->mutex);
  while (!queue->broken && item - queue->emptied >= queue->places) pthread_cond_wait(&queue->moved, &queue->mutex);
  const int place = queue->broken ? QUEUE_CLOSED : (int)(item % queue->places);
  pthread_mutex_unlock(&queue->mutex);
  return place;
}

int queue_wait_for_slot(struct bounded_queue *queue) { return queue_wait_for_slot_of(queue, queue->filled); }

bool queue_has_slot(struct bounded_queue *queue) {
  (void)pthread_mutex_lock(&queue->mutex);
  const bool has = queue->broken || queue->filled - queue->emptied < queue->places;
  (void)pthread_mutex_unlock(&queue->mutex);
  return has;
}

bool queue_is_empty(struct bounded_queue *queue) {
  (void)pthread_mutex_lock(&queue->mutex);
  const bool empty = queue->broken || queue->filled == queue->emptied;
  (void)pthread_mutex_unlock(&queue->mutex);
  return empty;
}

int queue_wait_for_item(struct bounded_queue *queue) {
  pthread_mutex_lock(&queue->mutex);
  while (!queue->broken && !queue->ended && queue->filled == queue->emptied)
    pthread_cond_wait(&queue->moved, &queue->mutex);
  const bool over = queue->broken || queue->filled == queue->emptied;
  const int place = over ? QUEUE_CLOSED : (int)(queue->emptied % queue->places);
  pthread_mutex_unlock(&queue->mutex);
  return place;
}

/* Changes a member of the queue, such as `filled += 1` or `ended = true`, and wakes the waiting threads. */
#define QUEUE_CHANGE(queue, change)        \
  pthread_mutex_lock(&(queue)->mutex);     \
  (queue)->change;                         \
  pthread_cond_broadcast(&(queue)->moved); \
  pthread_mutex_unlock(&(queue)->mutex)

void queue_push(struct bounded_queue *queue) { QUEUE_CHANGE(queue, filled++); }
void queue_pop(struct bounded_queue *queue) { QUEUE_CHANGE(queue, emptied++); }
void queue_end(struct bounded_queue *queue) { QUEUE_CHANGE(queue, ended = true); }
void queue_break(struct bounded_queue *queue) { QUEUE_CHANGE(queue, broken = true); }
