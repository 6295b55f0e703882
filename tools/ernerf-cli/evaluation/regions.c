/* SPDX-License-Identifier: MIT */
#include "evaluation/regions.h"

enum { EYES_BEGIN = 36, EYES_END = 48, LIPS_BEGIN = 48, LIPS_END = 60, LANDMARKS = 68 };

static int clip_to(int value, int most) { return value < 0 ? 0 : value > most ? most : value; }

/* Truncates toward zero, and clamps so that extreme values do not overflow. */
static int whole(float value) { return value < -1e6f ? -1000000 : value > 1e6f ? 1000000 : (int)value; }

/* Bounding box of the landmarks [begin, end), not yet clipped to the picture. */
static ern_box box_of(const float landmarks[][2], int begin, int end) {
  const int first_x = whole(landmarks[begin][0]), first_y = whole(landmarks[begin][1]);
  ern_box box = {.top = first_y, .bottom = first_y, .left = first_x, .right = first_x};
  for (int i = begin + 1; i < end; i++) {
    const int x = whole(landmarks[i][0]), y = whole(landmarks[i][1]);
    if (x < box.left) box.left = x;
    if (x > box.right) box.right = x;
    if (y < box.top) box.top = y;
    if (y > box.bottom) box.bottom = y;
  }
  return box;
}

static bool cut(ern_box whole_box, int width, int height, ern_box *box) {
  *box = (ern_box){.top = clip_to(whole_box.top, height),
                   .bottom = clip_to(whole_box.bottom, height),
                   .left = clip_to(whole_box.left, width),
                   .right = clip_to(whole_box.right, width)};
  return box->top < box->bottom && box->left < box->right;
}

bool region_head(const ern_clip_frame *frame, int width, int height, ern_box *box) {
  return frame->has_landmarks && cut(box_of(frame->landmarks, 0, LANDMARKS), width, height, box);
}

/* The square around the centre of the lips' box, with its longer side. */
bool region_mouth(const ern_clip_frame *frame, int width, int height, ern_box *box) {
  if (!frame->has_landmarks) return false;
  const ern_box lips = box_of(frame->landmarks, LIPS_BEGIN, LIPS_END);
  const int tall = lips.bottom - lips.top, wide = lips.right - lips.left, half = (tall > wide ? tall : wide) / 2;
  const int row = (lips.top + lips.bottom) / 2, column = (lips.left + lips.right) / 2;
  const ern_box square = {.top = row - half, .bottom = row + half, .left = column - half, .right = column + half};
  return cut(square, width, height, box);
}

bool region_eyes(const ern_clip_frame *frame, int width, int height, ern_box *box) {
  if (!frame->has_landmarks) return false;
  const ern_box eyes = box_of(frame->landmarks, EYES_BEGIN, EYES_END);
  const int margin = (eyes.right - eyes.left) / 4;
  const ern_box wide = {.top = eyes.top - margin,
                        .bottom = eyes.bottom + margin,
                        .left = eyes.left - margin,
                        .right = eyes.right + margin};
  return cut(wide, width, height, box);
}
