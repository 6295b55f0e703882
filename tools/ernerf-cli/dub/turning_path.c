/* SPDX-License-Identifier: MIT */
#include "dub/turning_path.h"

#include <math.h>

/* Landmarks whose motion shows: jaw, brows, nose, eyes. The mouth, 48 to 67, is rendered again. */
enum { SEEN_LANDMARKS = 48 };

static const ern_clip_frame *frame_at(const ern_clip *clip, const struct source_frame *frame) {
  return ern_clip_frame_at(clip, frame->split, frame->index);
}

/* Mean way of the landmarks from the frame before k to the one after it, pixels a frame. At a turn this way is gone
 * back, so it is what a turn shows. */
static double speed_at(const ern_clip *clip, const struct source_frame *frames, size_t begin, size_t end, size_t k) {
  const size_t before = k > begin ? k - 1 : k, after = k + 1 < end ? k + 1 : k;
  const ern_clip_frame *from = frame_at(clip, &frames[before]), *to = frame_at(clip, &frames[after]);
  double sum = 0;
  for (int i = 0; i < SEEN_LANDMARKS; i++)
    sum += hypot((double)to->landmarks[i][0] - (double)from->landmarks[i][0],
                 (double)to->landmarks[i][1] - (double)from->landmarks[i][1]);
  return after > before ? sum / SEEN_LANDMARKS / (double)(after - before) : 0;
}

/* The slowest of the frames from `first` to `last`. */
static size_t slowest(const ern_clip *clip, const struct source_frame *frames, size_t begin, size_t end, size_t first,
                      size_t last) {
  size_t best = first;
  double least = INFINITY;
  for (size_t k = first; k <= last; k++) {
    const double speed = speed_at(clip, frames, begin, end, k);
    if (speed >= least) continue;
    least = speed;
    best = k;
  }
  return best;
}

void turning_path_ends(const ern_clip *clip, const struct source_frame *frames, size_t begin, size_t end, size_t *low,
                       size_t *high) {
  const size_t quarter = (end - begin - 1) / 4;
  const size_t near = quarter < 2 * RATE_CLIP ? quarter : 2 * RATE_CLIP; /* a turn is in the two seconds at an end */
  *low = slowest(clip, frames, begin, end, begin, begin + near);
  *high = slowest(clip, frames, begin, end, end - 1 - near, end - 1);
}

size_t turning_path(const ern_clip *clip, const struct source_frame *frames, size_t begin, size_t end, size_t windows,
                    size_t *order) {
  const size_t count = end - begin;
  size_t low = begin, high = end - 1, turns = 0, at = begin;
  if (windows > count) turning_path_ends(clip, frames, begin, end, &low, &high);
  bool forward = true;
  for (size_t t = 0; t < windows; t++) {
    order[t] = at;
    if (t + 1 == windows || low == high) continue;
    if (windows > count && at == (forward ? high : low)) {
      forward = !forward;
      turns++;
    }
    at = forward ? at + 1 : at - 1;
  }
  return turns;
}
