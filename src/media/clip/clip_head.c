/* SPDX-License-Identifier: MIT
 * The head mask of a frame, from parsing/ID.png. */
#include <string.h>

#include "core/memory.h"
#include "media/clip/clip.h"

static bool is_near(const uint8_t *rgb, const uint8_t colour[3]) {
  for (int c = 0; c < 3; c++)
    if (rgb[c] > colour[c] + 63 || rgb[c] < colour[c] - 63) return false;
  return true;
}

/* Refuses a picture in other colours, which would look like one without a head. A scaled picture has mixed colours
 * along its edges. */
static ern_status check_colours(ern_context *context, const char *path, const ern_image *parsing) {
  static const uint8_t colours[4][3] = {{0, 0, 255}, {0, 255, 0}, {255, 0, 0}, {255, 255, 255}};
  const size_t pixels = (size_t)parsing->width * (size_t)parsing->height;
  size_t others = 0;
  for (size_t i = 0; i < pixels; i++) {
    bool known = false;
    for (int k = 0; k < 4 && !known; k++) known = is_near(parsing->data + 3 * i, colours[k]);
    others += !known;
  }
  if (others <= pixels / 20) return ERN_OK;
  return ern_fail(context, ERN_E_FORMAT,
                  "%s: %zu of %zu pixels have no colour of a parsing, expected head 0 0 255, neck 0 255 0, torso 255 0 "
                  "0 and background 255 255 255",
                  path, others, pixels);
}

/* Indices [begin, end) of 0..count-1 that are at most `reach` from `at`. */
struct window {
  int begin, end;
};
static struct window window_at(int at, int reach, int count) {
  return (struct window){at > reach ? at - reach : 0, at < count - reach ? at + reach + 1 : count};
}

/* sums[y][x]: head pixels of row y in the window at x. */
static void sum_rows(const ern_image *parsing, int reach, uint8_t *sums) {
  const int width = parsing->width;
  for (int y = 0; y < parsing->height; y++) {
    const uint8_t *row = parsing->data + 3 * (size_t)y * (size_t)width;
    for (int x = 0; x < width; x++) {
      const struct window across = window_at(x, reach, width);
      int sum = 0;
      for (int k = across.begin; k < across.end; k++) sum += ern_clip_is_head(row + 3 * (size_t)k);
      sums[(size_t)y * (size_t)width + (size_t)x] = (uint8_t)sum;
    }
  }
}

/* The width of the unsure band. At the head's edge the camera mixed head and background, and the parsing is less
 * reliable. Measured with widths of 256 and 512: 1 and 2 pixels (docs/results.md). */
static int edge_of(int width) {
  const int edge = (width + 128) / 256;
  return edge > 1 ? edge : 1;
}

ern_status ern_clip_head_of_parsing(ern_context *context, const char *path, ern_image *image) {
  const int width = image->width, height = image->height, reach = edge_of(width);
  const size_t stride = (size_t)width, pixels = stride * (size_t)height;
  ern_status status = ERN_OK;
  uint8_t *sums = NULL, *head = NULL;
  bool any = false;
  ERN_TRY(check_colours(context, path, image));
  ERN_TRY(ERN_NEW(context, pixels, &sums));
  ERN_TRY(ERN_NEW(context, pixels, &head));
  sum_rows(image, reach, sums);
  for (int y = 0; y < height; y++) {
    const struct window down = window_at(y, reach, height);
    for (int x = 0; x < width; x++) {
      const struct window across = window_at(x, reach, width);
      const int whole = (across.end - across.begin) * (down.end - down.begin);
      int sum = 0;
      for (int k = down.begin; k < down.end; k++) sum += sums[(size_t)k * stride + (size_t)x];
      any = any || sum > 0;
      head[(size_t)y * stride + (size_t)x] = sum == 0 ? 0 : sum == whole ? ERN_HEAD_WHOLE : ERN_HEAD_UNSURE;
    }
  }
  if (!any) memset(head, ERN_HEAD_UNSURE, pixels);
  ern_image_free(context, image);
  *image = (ern_image){.width = width, .height = height, .channels = 1, .data = head};
  head = NULL;
fail:
  ern_release(context, sums);
  ern_release(context, head);
  return status;
}
