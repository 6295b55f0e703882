/* SPDX-License-Identifier: MIT
 * The data of a training: calls the dataset's callbacks and checks their results. Other code calls these, never the
 * callbacks. Internal. */
#ifndef ERN_TRAIN_TRAINER_DATA_H
#define ERN_TRAIN_TRAINER_DATA_H

#include "train/parts/trainer_shared.h"

ERN_NODISCARD ern_status ern_trainer_frame(const struct ern_training *t, int split, size_t frame,
                                           ern_dataset_frame *about);
/* *head as ern_dataset.head gives it for a training frame; NULL without it, and where the training does not use it. */
ERN_NODISCARD ern_status ern_trainer_head(const struct ern_training *t, size_t frame, const uint8_t **head);
ERN_NODISCARD ern_status ern_trainer_pixels(const struct ern_training *t, int split, size_t frame,
                                            const uint8_t **truth, const uint8_t **torso); /* *torso NULL: none */
/* The camera of a frame. */
ERN_NODISCARD ern_status ern_trainer_view(const struct ern_training *t, int split, size_t frame, struct ern_view *view);
/* A training frame of [data_begin, data_end), by a random word. */
size_t ern_trainer_random_frame(const struct ern_training *t, uint32_t word);
/* Whether a callback that failed left the error text as it was `before`. That text is about something else, so the
 * trainer then writes one of its own. */
bool ern_trainer_error_is(ern_context *context, const char before[ERN_ERROR_BYTES]);

#endif
