/* SPDX-License-Identifier: MIT */
#include "io/csv.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/memory.h"
#include "io/file.h"
#include "io/number.h"

enum { FILE_LIMIT = 1 << 30, LISTED_BYTES = 1024, MOST_COLUMNS = 16384, MOST_ROWS = 1 << 24 };

/* A piece of the file's text, [begin, end). */
struct piece {
  const char *begin, *end;
};

static bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\r'; }

static struct piece trimmed(struct piece text) {
  while (text.begin < text.end && (is_blank(*text.begin) || *text.begin == '"')) text.begin++;
  while (text.begin < text.end && (is_blank(text.end[-1]) || text.end[-1] == '"')) text.end--;
  return text;
}

/* Takes the next line off the text; false at its end. */
static bool take_line(struct piece *text, struct piece *line) {
  if (text->begin == text->end) return false;
  const char *newline = memchr(text->begin, '\n', (size_t)(text->end - text->begin));
  line->begin = text->begin;
  line->end = newline != NULL ? newline : text->end;
  text->begin = newline != NULL ? newline + 1 : text->end;
  return true;
}

/* Takes the next cell off a line; false where there is none. A comma between quotes belongs to the cell. */
static bool take_cell(struct piece *line, struct piece *cell) {
  if (line->begin == NULL) return false;
  bool quoted = false;
  const char *at = line->begin;
  for (; at < line->end && (quoted || *at != ','); at++) quoted ^= *at == '"';
  *cell = trimmed((struct piece){line->begin, at});
  line->begin = at < line->end ? at + 1 : NULL;
  return true;
}

/* The place of the column called `name` among the first MOST_COLUMNS, or -1; `listed` receives the names there are, as
 * far as they fit. */
static int find_column(struct piece header, const char *name, char listed[LISTED_BYTES]) {
  struct piece cell;
  size_t used = 0;
  listed[0] = 0;
  for (int column = 0; column < MOST_COLUMNS && take_cell(&header, &cell); column++) {
    const size_t length = (size_t)(cell.end - cell.begin);
    if (length == strlen(name) && memcmp(cell.begin, name, length) == 0) return column;
    if (used + length + 3 > LISTED_BYTES) continue;
    used +=
        (size_t)snprintf(listed + used, LISTED_BYTES - used, "%s%.*s", used > 0 ? ", " : "", (int)length, cell.begin);
  }
  return -1;
}

static ern_status read_cell(ern_context *context, const char *path, const char *name, size_t number, struct piece line,
                            int column, float *value) {
  struct piece cell = {NULL, NULL};
  int cells = 0;
  while (cells <= column && take_cell(&line, &cell)) cells++;
  if (cells <= column) {
    return ern_fail(context, ERN_E_FORMAT, "%s: line %zu has %d cells, expected at least %d: column %s is missing",
                    path, number, cells, column + 1, name);
  }
  double found = 0;
  const char *at = cell.begin;
  const bool whole = ern_number_read(&at, cell.end, &found) && at == cell.end;
  if (!whole || !(fabs(found) <= (double)FLT_MAX)) {
    const int length = (int)(cell.end - cell.begin < 60 ? cell.end - cell.begin : 60);
    return ern_fail(context, ERN_E_FORMAT, "%s: line %zu, column %s is \"%.*s\", expected a finite number", path,
                    number, name, length, cell.begin);
  }
  *value = (float)found;
  return ERN_OK;
}

/* Rows stand for frames by their place. Where they are numbered too, the numbers must say the same. */
static ern_status check_frames(ern_context *context, const char *path, size_t number, struct piece line, int column,
                               double *frame) {
  float found = 0;
  const ern_status status = read_cell(context, path, "frame", number, line, column, &found);
  const double before = *frame;
  *frame = (double)found;
  if (status != ERN_OK || number == 2 || *frame == before + 1) return status;
  return ern_fail(context, ERN_E_FORMAT,
                  "%s: line %zu, column frame is %.9g, expected %.9g: rows are taken one a frame", path, number, *frame,
                  before + 1);
}

ern_status ern_csv_read_column(ern_context *context, const char *path, const char *name, float **values,
                               size_t *count) {
  ern_status status = ERN_OK;
  uint8_t *bytes = NULL;
  float *cells = NULL;
  size_t size = 0, lines = 0;
  char listed[LISTED_BYTES];
  struct piece line;
  double frame = 0;
  *values = NULL;
  *count = 0;
  ERN_TRY(ern_file_read(context, path, FILE_LIMIT, &bytes, &size));
  struct piece text = {(const char *)bytes, (const char *)bytes + size};
  text.begin += ern_text_mark(bytes, size);
  while (text.end > text.begin && (is_blank(text.end[-1]) || text.end[-1] == '\n')) text.end--;
  if (!take_line(&text, &line)) ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: is empty, expected a header line", path));
  const int frames = find_column(line, "frame", listed), column = find_column(line, name, listed);
  if (column < 0) {
    ERN_TRY(ern_fail(context, ERN_E_MISSING, "%s: column %s is missing, found: %s", path, name, listed));
  }
  for (const char *at = text.begin; at < text.end; at++) lines += *at == '\n';
  if (text.begin < text.end) lines++;
  if (lines > MOST_ROWS)
    ERN_TRY(ern_fail(context, ERN_E_SHAPE, "%s: has %zu rows, expected at most %d", path, lines, MOST_ROWS));
  ERN_TRY(ERN_NEW(context, lines, &cells));
  for (size_t row = 0; take_line(&text, &line); row++) {
    ERN_TRY(read_cell(context, path, name, row + 2, line, column, cells + row));
    if (frames >= 0) ERN_TRY(check_frames(context, path, row + 2, line, frames, &frame));
  }
  ern_release(context, bytes);
  *values = cells;
  *count = lines;
  return ERN_OK;
fail:
  ern_release(context, bytes);
  ern_release(context, cells);
  return status;
}
