/* SPDX-License-Identifier: MIT
 * Frames of a video, evenly spaced, side by side in one picture. Uses libernerf-media.
 *
 *   cc -std=c17 contact_sheet.c $(pkg-config --cflags --libs libernerf-media) -o contact_sheet
 *   ./contact_sheet demo.mp4 sheet.png 4 2 */
#include <ernerf/media.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_TILES = 64 };

/* Copies `frame` to column `column`, row `row` of the sheet. */
static void place(ern_image *sheet, const ern_image *frame, int column, int row) {
  const size_t frame_bytes = 3 * (size_t)frame->width, sheet_bytes = 3 * (size_t)sheet->width;
  for (int y = 0; y < frame->height; y++)
    memcpy(sheet->data + ((size_t)row * (size_t)frame->height + (size_t)y) * sheet_bytes + (size_t)column * frame_bytes,
           frame->data + (size_t)y * frame_bytes, frame_bytes);
}

static ern_status fill(ern_video_reader *reader, ern_image *sheet, ern_image *frame, int columns, int rows) {
  ern_video_info info;
  ern_video_reader_info(reader, &info);
  const double rate = (double)info.rate_numerator / info.rate_denominator;
  const int total = (int)(info.duration * rate + 0.5), tiles = columns * rows;
  int placed = 0;
  for (int number = 0; placed < tiles; number++) {
    double seconds = 0;
    bool end = false;
    const ern_status status = ern_video_reader_frame(reader, frame, &seconds, &end);
    if (status != ERN_OK || end) return status;
    for (; placed < tiles && placed * total / tiles <= number; placed++)
      place(sheet, frame, placed % columns, placed / columns);
  }
  return ERN_OK;
}

int main(int count, char **words) {
  const int columns = count == 5 ? atoi(words[3]) : 0, rows = count == 5 ? atoi(words[4]) : 0;
  if (columns < 1 || rows < 1 || columns > MOST_TILES / rows) {
    fprintf(stderr, "usage: %s VIDEO SHEET.png COLUMNS ROWS, at most %d tiles\n", words[0], MOST_TILES);
    return 2;
  }
  ern_context *context = NULL;
  ern_video_reader *reader = NULL;
  ern_image sheet = {.channels = 3}, frame = {0};
  ern_status status = ern_context_create(&context, NULL);
  if (status == ERN_OK) status = ern_video_reader_open(context, words[1], &reader);
  if (status == ERN_OK) {
    ern_video_info info;
    ern_video_reader_info(reader, &info);
    sheet.width = columns * info.width;
    sheet.height = rows * info.height;
    sheet.data = calloc((size_t)sheet.width * (size_t)sheet.height, 3); /* ours: freed by us, not by ern_image_free */
    status = sheet.data != NULL ? fill(reader, &sheet, &frame, columns, rows) : ERN_E_NO_MEMORY;
  }
  if (status == ERN_OK) status = ern_image_write(context, words[2], &sheet, 0);
  if (status == ERN_OK)
    printf("%s: %d x %d pixels\n", words[2], sheet.width, sheet.height);
  else
    fprintf(stderr, "%s: %s\n", ern_status_name(status), ern_last_error(context));
  free(sheet.data);
  ern_image_free(context, &frame);
  ern_video_reader_free(&reader);
  ern_context_free(&context);
  return status == ERN_OK ? 0 : 1;
}
