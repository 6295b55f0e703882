/* SPDX-License-Identifier: MIT
 * Frames of a video, evenly spaced, made WIDTH pixels wide, side by side in one picture. Uses libernerf-media.
 *
 *   cc -std=c17 contact_sheet.c $(pkg-config --cflags --libs libernerf-media) -o contact_sheet
 *   ./contact_sheet demo.mp4 sheet.png 4 2 192 */
#include <ernerf/media.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_TILES = 64 };

struct sheet {
  ern_image picture;
  int columns, rows, tile_width, tile_height;
};

/* Puts `frame`, made smaller, to place number `tile` of the sheet. */
static ern_status place(ern_context *context, struct sheet *sheet, const ern_image *frame, int tile) {
  ern_image small = {0};
  const ern_status status = ern_image_resize(context, frame, sheet->tile_width, sheet->tile_height, &small);
  if (status != ERN_OK) return status;
  const size_t bytes = 3 * (size_t)small.width, sheet_bytes = 3 * (size_t)sheet->picture.width;
  const size_t left = (size_t)(tile % sheet->columns) * bytes, top = (size_t)(tile / sheet->columns * small.height);
  for (size_t y = 0; y < (size_t)small.height; y++)
    memcpy(sheet->picture.data + (top + y) * sheet_bytes + left, small.data + y * bytes, bytes);
  ern_image_free(context, &small);
  return ERN_OK;
}

static ern_status fill(ern_context *context, ern_video_reader *reader, struct sheet *sheet, ern_image *frame) {
  ern_video_info info;
  ern_video_reader_info(reader, &info);
  const double rate = (double)info.rate_numerator / info.rate_denominator;
  const int total = (int)(info.duration * rate + 0.5), tiles = sheet->columns * sheet->rows;
  int placed = 0;
  for (int number = 0; placed < tiles; number++) {
    double seconds = 0;
    bool end = false;
    ern_status status = ern_video_reader_frame(reader, frame, &seconds, &end);
    if (status != ERN_OK || end) return status;
    for (; placed < tiles && placed * total / tiles <= number; placed++) {
      status = place(context, sheet, frame, placed);
      if (status != ERN_OK) return status;
    }
  }
  return ERN_OK;
}

static ern_status make(ern_context *context, ern_video_reader *reader, struct sheet *sheet, ern_image *frame) {
  ern_video_info info;
  ern_video_reader_info(reader, &info);
  sheet->tile_height = sheet->tile_width * info.height / info.width;
  sheet->picture.channels = 3;
  sheet->picture.width = sheet->columns * sheet->tile_width;
  sheet->picture.height = sheet->rows * sheet->tile_height;
  sheet->picture.data = calloc((size_t)sheet->picture.width * (size_t)sheet->picture.height, 3);
  return sheet->picture.data != NULL ? fill(context, reader, sheet, frame) : ERN_E_NO_MEMORY;
}

int main(int count, char **words) {
  struct sheet sheet = {0};
  if (count == 6) {
    sheet.columns = atoi(words[3]);
    sheet.rows = atoi(words[4]);
    sheet.tile_width = atoi(words[5]);
  }
  if (sheet.columns < 1 || sheet.rows < 1 || sheet.columns > MOST_TILES / sheet.rows || sheet.tile_width < 1 ||
      sheet.tile_width > ERN_IMAGE_MAX_SIDE / sheet.columns) {
    fprintf(stderr, "usage: %s VIDEO SHEET.png COLUMNS ROWS WIDTH, at most %d tiles\n", words[0], MOST_TILES);
    return 2;
  }
  ern_context *context = NULL;
  ern_video_reader *reader = NULL;
  ern_image frame = {0};
  ern_status status = ern_context_create(&context, NULL);
  if (status == ERN_OK) status = ern_video_reader_open(context, words[1], &reader);
  if (status == ERN_OK) status = make(context, reader, &sheet, &frame);
  if (status == ERN_OK) status = ern_image_write(context, words[2], &sheet.picture, 0);
  if (status == ERN_OK)
    printf("%s: %d x %d pixels\n", words[2], sheet.picture.width, sheet.picture.height);
  else
    fprintf(stderr, "%s: %s\n", ern_status_name(status), ern_last_error(context));
  free(sheet.picture.data); /* ours, so not ern_image_free */
  ern_image_free(context, &frame);
  ern_video_reader_free(&reader);
  ern_context_free(&context);
  return status == ERN_OK ? 0 : 1;
}
