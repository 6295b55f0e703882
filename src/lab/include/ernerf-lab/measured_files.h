/* SPDX-License-Identifier: MIT
 * Reads files that other tools write for drawn frames: OpenFace's table, and 68 points for each frame. */
#ifndef ERNERF_LAB_MEASURED_FILES_H
#define ERNERF_LAB_MEASURED_FILES_H

#include <stddef.h>

#include "ernerf/base.h"

enum { ERN_TABLE_COLUMNS = 32 };

/* Columns of a comma-separated file with a header. */
typedef struct ern_table {
  size_t rows;
  float *columns[ERN_TABLE_COLUMNS]; /* [rows]; NULL: the file has no such column */
} ern_table;

/* Reads the columns of these names, at most ERN_TABLE_COLUMNS; ignores blanks and quotes around a header. A cell that
 * is no finite number is ERN_E_FORMAT with line, column, found and expected, and so is a column `frame` that does not
 * count up by 1. The caller frees the table; it is all zeros after an error. */
ERN_NODISCARD ern_status ern_table_read(ern_context *context, const char *path, const char *const *names, size_t count,
                                        ern_table *table);
void ern_table_free(ern_context *context, ern_table *table);

/* Exactly 68 lines "x y" of finite numbers. */
ERN_NODISCARD ern_status ern_points_read(ern_context *context, const char *path, float points[68][2]);

#endif
