/* SPDX-License-Identifier: MIT */
#include "io/csv.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/memory.h"
#include "io/file.h"
#include "io/number.h"

enum { FILE_LIMIT = 1 << 30, LISTED_BYTES = 1024, MOST_COLUMNS = 16384, MOST_ROWS = 1 << 24, TWO_COLUMNS = -2 };

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

/* The place of the column called `name` among the first MOST_COLUMNS; -1: none; TWO_COLUMNS: which of them is not
 * known. `listed` receives the names there are, as far as they fit. */
static int find_column(struct piece header, const char *name, char listed[LISTED_BYTES]) {
  struct piece cell;
  size_t used = 0;
  int found = -1;
  listed[0] = 0;
  for (int column = 0; column < MOST_COLUMNS && take_cell(&header, &cell); column++) {
    const size_t length = (size_t)(cell.end - cell.begin);
    if (length == strlen(name) && memcmp(cell.begin, name, length) == 0) {
      if (found >= 0) return TWO_COLUMNS;
      found = column;
    }
    if (used + length + 3 > LISTED_BYTES) continue;
    used +=
        (size_t)snprintf(listed + used, LISTED_BYTES - used, "%s%.*s", used > 0 ? ", " : "", (int)length, cell.begin);
  }
  return found;
}

static ern_status read_cell(ern_context *context, const char *path, const char *name, size_t number, struct piece cell,
                            float *value) {
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

/* Row i belongs to frame i. A column of frame numbers must therefore increase by 1 from row to row. */
static ern_status check_frame(ern_context *context, const char *path, size_t number, float found, double *frame) {
  const double before = *frame;
  *frame = (double)found;
  if (number == 2 || *frame == before + 1) return ERN_OK;
  return ern_fail(context, ERN_E_FORMAT,
                  "%s: line %zu, column frame is %.9g, expected %.9g: rows are taken one a frame", path, number, *frame,
                  before + 1);
}

/* Which columns of a file are read. */
struct columns {
  const char *const *names;
  size_t count;
  int places[ERN_CSV_COLUMNS + 1]; /* of the names, then of the column `frame`, which may be -1 */
  int last;                        /* the greatest of them */
  int all;                         /* number of cells of the header */
};

static ern_status find_columns(ern_context *context, const char *path, struct piece header, struct columns *columns) {
  char listed[LISTED_BYTES];
  struct piece rest = header, cell;
  columns->last = -1;
  for (columns->all = 0; take_cell(&rest, &cell);) columns->all++;
  for (size_t k = 0; k <= columns->count; k++) {
    const char *name = k < columns->count ? columns->names[k] : "frame";
    const int place = find_column(header, name, listed);
    if (place == TWO_COLUMNS)
      return ern_fail(context, ERN_E_FORMAT, "%s: has two columns %s or more, expected one", path, name);
    columns->places[k] = place;
    if (place > columns->last) columns->last = place;
    if (place < 0 && k < columns->count)
      return ern_fail(context, ERN_E_MISSING, "%s: column %s is missing, found: %s", path, name, listed);
  }
  return ERN_OK;
}

/* cells[last + 1] receives the pieces of the line. */
static ern_status read_row(ern_context *context, const char *path, const struct columns *columns, struct piece line,
                           size_t row, struct piece *cells, float **values, double *frame) {
  ern_status status = ERN_OK;
  int count = 0;
  while (count <= columns->last && take_cell(&line, &cells[count])) count++;
  for (size_t k = 0; k <= columns->count; k++) {
    const char *name = k < columns->count ? columns->names[k] : "frame";
    const int place = columns->places[k];
    float value = 0;
    if (place < 0) continue;
    if (count <= place)
      ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: line %zu has %d cells, expected at least %d: column %s is missing",
                       path, row + 2, count, place + 1, name));
    ERN_TRY(read_cell(context, path, name, row + 2, cells[place], &value));
    if (k < columns->count)
      values[k][row] = value;
    else
      ERN_TRY(check_frame(context, path, row + 2, value, frame));
  }
  for (struct piece cell; take_cell(&line, &cell); count++)
    if (count >= columns->all && cell.begin < cell.end)
      ERN_TRY(ern_fail(context, ERN_E_FORMAT,
                       "%s: line %zu has more cells than the %d of the header, as where numbers are written with a "
                       "decimal comma; expected a decimal point",
                       path, row + 2, columns->all));
fail:
  return status;
}

ern_status ern_csv_read_columns(ern_context *context, const char *path, const char *const *names, size_t wanted,
                                float **values, size_t *count) {
  ern_status status = ERN_OK;
  uint8_t *bytes = NULL;
  size_t size = 0, lines = 0;
  struct piece line, *cells = NULL;
  struct columns columns = {.names = names, .count = wanted};
  double frame = 0;
  for (size_t k = 0; k < wanted; k++) values[k] = NULL;
  *count = 0;
  if (wanted > ERN_CSV_COLUMNS)
    ERN_TRY(ern_fail(context, ERN_E_ARGUMENT, "%s: %zu columns, expected at most %d", path, wanted, ERN_CSV_COLUMNS));
  ERN_TRY(ern_file_read(context, path, FILE_LIMIT, &bytes, &size));
  struct piece text = {(const char *)bytes, (const char *)bytes + size};
  text.begin += ern_text_mark(bytes, size);
  while (text.end > text.begin && (is_blank(text.end[-1]) || text.end[-1] == '\n')) text.end--;
  if (!take_line(&text, &line)) ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: is empty, expected a header line", path));
  ERN_TRY(find_columns(context, path, line, &columns));
  for (const char *at = text.begin; at < text.end; at++) lines += *at == '\n';
  if (text.begin < text.end) lines++;
  if (lines > MOST_ROWS)
    ERN_TRY(ern_fail(context, ERN_E_SHAPE, "%s: has %zu rows, expected at most %d", path, lines, MOST_ROWS));
  ERN_TRY(ERN_NEW(context, (size_t)(columns.last + 1), &cells));
  for (size_t k = 0; k < wanted; k++) ERN_TRY(ERN_NEW(context, lines, &values[k]));
  for (size_t row = 0; take_line(&text, &line); row++)
    ERN_TRY(read_row(context, path, &columns, line, row, cells, values, &frame));
  *count = lines;
fail:
  for (size_t k = 0; k < wanted && status != ERN_OK && wanted <= ERN_CSV_COLUMNS; k++) {
    ern_release(context, values[k]);
    values[k] = NULL;
  }
  ern_release(context, cells);
  ern_release(context, bytes);
  return status;
}

ern_status ern_csv_read_column(ern_context *context, const char *path, const char *name, float **values,
                               size_t *count) {
  return ern_csv_read_columns(context, path, &name, 1, values, count);
}

ern_status ern_csv_find_columns(ern_context *context, const char *path, const char *const *names, size_t wanted,
                                bool *there) {
  ern_status status = ERN_OK;
  uint8_t *bytes = NULL;
  size_t size = 0;
  struct piece line;
  char listed[LISTED_BYTES];
  ERN_TRY(ern_file_read(context, path, FILE_LIMIT, &bytes, &size));
  struct piece text = {(const char *)bytes, (const char *)bytes + size};
  text.begin += ern_text_mark(bytes, size);
  if (!take_line(&text, &line)) ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: is empty, expected a header line", path));
  for (size_t k = 0; k < wanted; k++) there[k] = find_column(line, names[k], listed) != -1;
fail:
  ern_release(context, bytes);
  return status;
}
