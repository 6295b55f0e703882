/* SPDX-License-Identifier: MIT
 * Tracks points of a reference frame into other frames by dense optical flow. The flow always runs from the reference
 * itself, not from the neighbouring frame, so that errors do not accumulate (drift). */
#ifndef ERN_PREPARE_FLOW_TRACKS_H
#define ERN_PREPARE_FLOW_TRACKS_H

#include "prepare/prepare_job.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The face's rectangle in the reference frame, pixels. */
struct ern_flow_region {
  float x, y, width, height;
};

struct ern_flow_reference;

/* Chooses points every few pixels of the region where the grey picture [side][side] has texture; `keep` filters them.
 * where: what a message begins with. The caller owns *reference. */
ERN_NODISCARD ern_status ern_flow_reference_make(ern_context *context, const char *where, const uint8_t *grey, int side,
                                                 struct ern_flow_region region,
                                                 bool (*keep)(const void *user, float x, float y), const void *user,
                                                 struct ern_flow_reference **reference);
size_t ern_flow_reference_points(const struct ern_flow_reference *reference, const float (**points)[2]);

/* seen[points][2]: where the points are in another frame; NaN where forward and backward flow disagree. warp: on entry
 * the expected similarity transform from the reference (a, b, tx, ty: x' = a x - b y + tx, y' = b x + a y + ty); on
 * return the one fitted to the tracked points, unchanged where fewer than 20 are tracked. One thread at a time uses a
 * reference. */
ERN_NODISCARD ern_status ern_flow_reference_find(struct ern_flow_reference *reference, const uint8_t *grey,
                                                 double warp[4], float (*seen)[2]);
void ern_flow_reference_free(struct ern_flow_reference **reference); /* accepts NULL */

#ifdef __cplusplus
}
#endif
#endif
