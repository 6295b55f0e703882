/* SPDX-License-Identifier: MIT
 * The coded picture in a part of the stream, a fragment of mp4 that libernerf-media has written: its first track has
 * one picture. */
#ifndef ERN_SERVE_FRAGMENT_H
#define ERN_SERVE_FRAGMENT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* The avcC of the head: what a decoder of H.264 needs first. False: there is none. */
bool fragment_avcc(const uint8_t *head, size_t count, const uint8_t **avcc, size_t *bytes);
/* The picture of a part: NAL units, each behind its length. False: there is none. */
bool fragment_picture(const uint8_t *part, size_t count, const uint8_t **unit, size_t *bytes);

#endif
