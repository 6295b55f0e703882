/* SPDX-License-Identifier: MIT
 * A frame of the synthetic clip: composites its layers, and makes the segmentation. */
#include <string.h>

#include "core/memory.h"
#include "lab/synth/synth_parts.h"

uint8_t ern_synth_to_byte(float c) { return (uint8_t)(255.0f * clampf(c, 0.0f, 1.0f) + 0.5f); }

ern_status ern_synth_picture_make(ern_context *context, int size, int channels, ern_image *image) {
  *image = (ern_image){.width = size, .height = size, .channels = channels};
  return ERN_NEW(context, (size_t)size * (size_t)size * (size_t)channels, &image->data);
}

ern_status ern_synth_buffers_make(ern_context *context, int size, struct ern_synth_buffers *buffers) {
  ern_status status = ERN_OK;
  const size_t pixels = (size_t)size * (size_t)size;
  buffers->size = size;
  ERN_TRY(ERN_NEW(context, pixels, &buffers->head));
  ERN_TRY(ERN_NEW(context, pixels, &buffers->torso));
  ERN_TRY(ERN_NEW(context, pixels, &buffers->bare));
  ERN_TRY(ERN_NEW(context, pixels, &buffers->hidden));
  ERN_TRY(ern_synth_picture_make(context, size, 3, &buffers->truth));
  ERN_TRY(ern_synth_picture_make(context, size, 4, &buffers->cutout));
  ERN_TRY(ern_synth_picture_make(context, size, 3, &buffers->parsing));
fail:
  return status;
}

void ern_synth_buffers_free(ern_context *context, struct ern_synth_buffers *buffers) {
  ern_release(context, buffers->head);
  ern_release(context, buffers->torso);
  ern_release(context, buffers->bare);
  ern_release(context, buffers->hidden);
  ern_image_free(context, &buffers->truth);
  ern_image_free(context, &buffers->cutout);
  ern_image_free(context, &buffers->parsing);
}

/* The room at pixel i of the hand-held camera: bilinear, with repeated border pixels. */
static void look(float (*room)[4], int size, const struct ern_synth_curve *curve, size_t i, float seen[3]) {
  if (curve->pan == 0.0f && curve->nod == 0.0f) {
    memcpy(seen, room[i], 3 * sizeof *seen);
    return;
  }
  float u = ((float)(i % (size_t)size) + 0.5f) / (float)size, v = ((float)(i / (size_t)size) + 0.5f) / (float)size;
  ern_synth_camera_rest(curve, &u, &v);
  const float last = (float)(size - 1), x = clampf(u * (float)size - 0.5f, 0.0f, last),
              y = clampf(v * (float)size - 0.5f, 0.0f, last);
  const size_t left = (size_t)x, top = (size_t)y, right = left + (x < last), bottom = top + (y < last);
  const float tx = x - (float)left, ty = y - (float)top;
  const size_t row = top * (size_t)size, next = bottom * (size_t)size;
  for (int c = 0; c < 3; ++c)
    seen[c] = mixf(mixf(room[row + left][c], room[row + right][c], tx),
                   mixf(room[next + left][c], room[next + right][c], tx), ty);
}

void ern_synth_buffers_compose(struct ern_synth_buffers *buffers, float (*room)[4],
                               const struct ern_synth_curve *curve) {
  const size_t pixels = (size_t)buffers->size * (size_t)buffers->size;
  for (size_t i = 0; i < pixels; ++i) {
    const float *head = buffers->head[i], *torso = buffers->torso[i];
    const float alpha = torso[3];
    float seen[3];
    look(room, buffers->size, curve, i, seen);
    for (int c = 0; c < 3; ++c) {
      const float behind = torso[c] + (1.0f - alpha) * seen[c];
      buffers->truth.data[3 * i + (size_t)c] = ern_synth_to_byte(head[c] + (1.0f - head[3]) * behind);
      buffers->cutout.data[4 * i + (size_t)c] = alpha > 0.0f ? ern_synth_to_byte(torso[c] / alpha) : 0;
    }
    buffers->cutout.data[4 * i + 3] = ern_synth_to_byte(alpha);
  }
}

/* The rod enters at the lower edge of the picture, is slanted, and reaches the brows. */
void ern_synth_buffers_rod(struct ern_synth_buffers *buffers, struct vec3 skin, double time, double width) {
  const int size = buffers->size;
  const float third = 3.0f * (float)time - 1.0f; /* 0..1 while it passes */
  const float half = 0.5f * (float)width, tip = 0.38f, x = mixf(0.05f - half, 0.95f + half, third);
  memset(buffers->hidden, 0, (size_t)size * (size_t)size * sizeof *buffers->hidden);
  if (third < 0.0f || third > 1.0f) return;
  for (int j = 0; j < size; ++j)
    for (int i = 0; i < size; ++i) {
      const float u = ((float)i + 0.5f) / (float)size, v = ((float)j + 0.5f) / (float)size;
      const float across = (u - x - 0.25f * (v - tip)) / half; /* -1..1 on it */
      const float end = v - tip - half + half * sqrtf(maxf(1.0f - across * across, 0.0f));
      if (fabsf(across) > 1.0f || end < 0.0f) continue;
      const size_t at = (size_t)j * (size_t)size + (size_t)i;
      const struct vec3 light = vec3_scale(skin, 1.25f - 0.6f * across * across);
      buffers->truth.data[3 * at] = ern_synth_to_byte(synth_encode(light.x));
      buffers->truth.data[3 * at + 1] = ern_synth_to_byte(synth_encode(light.y));
      buffers->truth.data[3 * at + 2] = ern_synth_to_byte(synth_encode(light.z));
      buffers->hidden[at] = true;
    }
}

void ern_synth_buffers_parse(struct ern_synth_buffers *buffers) {
  static const uint8_t head[3] = {0, 0, 255}, neck[3] = {0, 255, 0}, torso[3] = {255, 0, 0}, none[3] = {255, 255, 255};
  const size_t pixels = (size_t)buffers->size * (size_t)buffers->size;
  for (size_t i = 0; i < pixels; ++i) {
    const float alpha = buffers->torso[i][3];
    const bool bare = buffers->bare[i] >= 0.5f * alpha;
    const uint8_t *colour = buffers->head[i][3] >= 0.5f ? head : alpha < 0.5f ? none : bare ? neck : torso;
    memcpy(buffers->parsing.data + 3 * i, buffers->hidden[i] ? none : colour, 3);
  }
}

void ern_synth_buffers_show(const struct ern_synth_buffers *buffers, uint8_t *shown) {
  const size_t pixels = (size_t)buffers->size * (size_t)buffers->size;
  for (size_t i = 0; i < pixels; ++i) {
    memcpy(shown + 4 * i, buffers->truth.data + 3 * i, 3);
    shown[4 * i + 3] = 255;
  }
}
