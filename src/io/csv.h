/* SPDX-License-Identifier: MIT
 * Numeric columns of a comma-separated file with a header, such as OpenFace writes. */
#ifndef ERN_IO_CSV_H
#define ERN_IO_CSV_H

#include <stdbool.h>

#include "core/status.h"

enum { ERN_CSV_COLUMNS = 256 };

/* *values = the column whose header, trimmed of blanks and quotes, is `name`; owned by the caller (ern_release). Two of
 * that name are ERN_E_FORMAT.
 * Blank lines at the end are skipped. A column `frame`, if there is one, must increase by 1 from row to row, else
 * ERN_E_FORMAT. A missing column is ERN_E_MISSING and the message lists those there are;
 * a cell that is no finite number is ERN_E_FORMAT with line, found and expected. */
ERN_NODISCARD ern_status ern_csv_read_column(ern_context *context, const char *path, const char *name, float **values,
                                             size_t *count);
/* The same for several columns, at most ERN_CSV_COLUMNS: values[wanted][*count], each owned by the caller; all NULL
 * where it fails. */
ERN_NODISCARD ern_status ern_csv_read_columns(ern_context *context, const char *path, const char *const *names,
                                              size_t wanted, float **values, size_t *count);
/* there[wanted]: which columns the header has. */
ERN_NODISCARD ern_status ern_csv_find_columns(ern_context *context, const char *path, const char *const *names,
                                              size_t wanted, bool *there);

#endif
