/* SPDX-License-Identifier: MIT */
#include "belt.h"

void belt_make(struct belt *belt, size_t places) {
  *belt = (struct belt){.places = places};
  pthread_mutex_init(&belt->mutex, NULL); /* neither fails on Linux */
  pthread_cond_init(&belt->moved, NULL);
}

void belt_free(struct belt *belt) {
  pthread_cond_destroy(&belt->moved);
  pthread_mutex_destroy(&belt->mutex);
}

int belt_free_place(struct belt *belt) {
  pthread_mutex_lock(&belt->mutex);
  while (!belt->broken && belt->filled - belt->emptied == belt->places) pthread_cond_wait(&belt->moved, &belt->mutex);
  const int place = belt->broken ? BELT_OVER : (int)(belt->filled % belt->places);
  pthread_mutex_unlock(&belt->mutex);
  return place;
}

int belt_item(struct belt *belt) {
  pthread_mutex_lock(&belt->mutex);
  while (!belt->broken && !belt->ended && belt->filled == belt->emptied) pthread_cond_wait(&belt->moved, &belt->mutex);
  const bool over = belt->broken || belt->filled == belt->emptied;
  const int place = over ? BELT_OVER : (int)(belt->emptied % belt->places);
  pthread_mutex_unlock(&belt->mutex);
  return place;
}

/* Changes the belt and wakes whoever waits for it; by name of the member, as `+= 1` or `= true`. */
#define BELT_CHANGE(belt, change)      \
  pthread_mutex_lock(&(belt)->mutex);  \
  (belt)->change;                      \
  pthread_cond_signal(&(belt)->moved); \
  pthread_mutex_unlock(&(belt)->mutex)

void belt_fill(struct belt *belt) { BELT_CHANGE(belt, filled++); }
void belt_empty(struct belt *belt) { BELT_CHANGE(belt, emptied++); }
void belt_end(struct belt *belt) { BELT_CHANGE(belt, ended = true); }
void belt_break(struct belt *belt) { BELT_CHANGE(belt, broken = true); }
