/* SPDX-License-Identifier: MIT */
#include "dub/dubbed_frame.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

int dubbed_frame_open(struct dubbed_frame *dubbed, struct session *session, ern_clip *clip, const char *folder,
                      const int square[4]) {
  ern_clip_info info;
  ern_clip_describe(clip, &info);
  const int high = square[3] < info.height ? square[3] : info.height, wide = info.width * high / info.height;
  *dubbed = (struct dubbed_frame){.context = session->context,
                                  .clip = clip,
                                  .clip_size = {info.width, info.height},
                                  .size = {wide, high},
                                  .scale = {(float)wide / (float)square[2], (float)high / (float)square[3]}};
  if (!info.has_landmarks)
    return session_fail_with(session, "%s: has no landmarks (ori_imgs/ID.lms), which place the mouth", folder);
  if (!info.has_parsing)
    session_warn(session, "%s: has no parsing/, so the mouth is also drawn on what is before the face, such as a hand",
                 folder);
  const size_t pixels = ((size_t)wide + 1) * ((size_t)high + 1); /* a part may be rounded up */
  dubbed->head = malloc(pixels * 4);
  dubbed->wanted = malloc(pixels);
  dubbed->opacity = malloc(pixels * sizeof *dubbed->opacity);
  if (dubbed->head == NULL || dubbed->wanted == NULL || dubbed->opacity == NULL)
    return session_fail_with(session, "no memory for a head of %d x %d", wide, high);
  return 0;
}

/* The recorded landmarks at the time of frame k, in shares of the square. */
static void place_landmarks(const struct dubbed_frame *dubbed, const struct frame_source *frame_source, size_t k,
                            float landmarks[68][2]) {
  const struct source_frame *before = frame_source_before(frame_source, k),
                            *after = frame_source_after(frame_source, k);
  const ern_clip_frame *from = ern_clip_frame_at(dubbed->clip, before->split, before->index),
                       *to = ern_clip_frame_at(dubbed->clip, after->split, after->index);
  const float toward = frame_source->source_frame[k].toward;
  for (int i = 0; i < 68; i++)
    for (int c = 0; c < 2; c++)
      landmarks[i][c] = (from->landmarks[i][c] + toward * (to->landmarks[i][c] - from->landmarks[i][c])) /
                        (float)dubbed->clip_size[c];
}

ern_status dubbed_frame_box(const struct dubbed_frame *dubbed, const struct frame_source *frame_source, size_t k,
                            int width, int height, const int square[4], int box[4]) {
  ern_dub_input dub = {.width = width, .height = height};
  memcpy(dub.square, square, sizeof dub.square);
  place_landmarks(dubbed, frame_source, k, dub.landmarks);
  return ern_dub_box(dubbed->context, &dub, box);
}

/* The part of the whole square's view that is in dub->box. */
static ern_camera cut_camera(const struct dubbed_frame *dubbed, const ern_camera *whole, const ern_dub_input *dub) {
  const float left = (float)(dub->box[0] - dub->square[0]) * dubbed->scale[0],
              top = (float)(dub->box[1] - dub->square[1]) * dubbed->scale[1];
  ern_camera camera = *whole;
  camera.cx -= left;
  camera.cy -= top;
  camera.width = (int)ceilf((float)dub->box[2] * dubbed->scale[0]);
  camera.height = (int)ceilf((float)dub->box[3] * dubbed->scale[1]);
  camera.frame.left = -(int)lroundf(left); /* the whole square */
  camera.frame.top = -(int)lroundf(top);
  camera.frame.right = camera.frame.left + dubbed->size[0];
  camera.frame.bottom = camera.frame.top + dubbed->size[1];
  return camera;
}

/* The head in the box: its colours, and its own opacity as alpha, which a torso of the model has no part in. */
static ern_status draw_head(struct dubbed_frame *dubbed, ern_renderer *renderer, const ern_frame_input *whole,
                            ern_dub_input *dub, ern_frame_times *times) {
  ern_frame_input input = *whole;
  input.camera = cut_camera(dubbed, &whole->camera, dub);
  input.background = input.torso = NULL;
  input.wanted = dubbed->wanted;
  dub->head = dubbed->head;
  dub->head_width = input.camera.width;
  dub->head_height = input.camera.height;
  memcpy(dub->head_scale, dubbed->scale, sizeof dub->head_scale);
  const ern_frame_output output = {.rgba = dubbed->head, .opacity = dubbed->opacity};
  ern_status status = ern_dub_wanted(dubbed->context, dub, dubbed->wanted);
  if (status == ERN_OK) status = ern_renderer_frame(renderer, &input, &output, times);
  const size_t pixels = (size_t)input.camera.width * (size_t)input.camera.height;
  for (size_t i = 0; status == ERN_OK && i < pixels; i++)
    dubbed->head[4 * i + 3] = (uint8_t)(255 * dubbed->opacity[i] + 0.5F);
  return status;
}

ern_status dubbed_frame_draw(struct dubbed_frame *dubbed, ern_renderer *renderer,
                             const struct frame_source *frame_source, size_t k, const ern_frame_input *whole,
                             const ern_image *recorded, const int square[4], uint8_t *rgba, ern_frame_times *times) {
  const struct source_frame *frame = &frame_source->source_frame[k];
  ern_image head = {0};
  bool drawn = false;
  ern_dub_input dub = {.recorded = recorded->data, .width = recorded->width, .height = recorded->height};
  memcpy(dub.square, square, sizeof dub.square);
  place_landmarks(dubbed, frame_source, k, dub.landmarks);
  ern_status status = ern_clip_head(dubbed->clip, frame->split, frame->index, &head);
  dub.recorded_head = head.data != NULL ? &head : NULL;
  if (status == ERN_OK) status = ern_dub_box(dubbed->context, &dub, dub.box);
  if (status == ERN_OK && dub.box[2] > 0) status = draw_head(dubbed, renderer, whole, &dub, times);
  if (status == ERN_OK) status = ern_dub_frame(dubbed->context, &dub, rgba, &drawn);
  memcpy(dubbed->box, dub.box, sizeof dub.box);
  if (!drawn) dubbed->box[2] = 0;
  return status;
}

void dubbed_frame_cut(const struct dubbed_frame *dubbed, const int region[4], uint8_t *rgba, int part[4]) {
  const int *box = dubbed->box, left = box[0] & ~1, top = box[1] & ~1;
  part[0] = region[0] + left;
  part[1] = region[1] + top;
  part[2] = box[2] > 0 ? ((box[0] + box[2] + 1) & ~1) - left : 0;
  part[3] = ((box[1] + box[3] + 1) & ~1) - top;
  const size_t bytes = (size_t)part[2] * 4, row = (size_t)region[2] * 4;
  for (size_t y = 0; bytes > 0 && y < (size_t)part[3]; y++)
    memmove(rgba + y * bytes, rgba + ((size_t)top + y) * row + (size_t)left * 4, bytes);
}

void dubbed_frame_close(struct dubbed_frame *dubbed) {
  free(dubbed->head);
  free(dubbed->wanted);
  free(dubbed->opacity);
}
