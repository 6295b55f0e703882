/* SPDX-License-Identifier: MIT
 * One numeric column of a comma-separated file with a header, such as OpenFace writes. */
#ifndef ERN_IO_CSV_H
#define ERN_IO_CSV_H

#include "core/status.h"

/* *values = the column whose header, trimmed of blanks and quotes, is `name`; owned by the caller (ern_release).
 * Blank lines at the end are passed over. Where there is a column `frame` too, it counts up by 1 from row to row, else
 * ERN_E_FORMAT. A missing column is ERN_E_MISSING and the message lists those there are;
 * a cell that is no finite number is ERN_E_FORMAT with line, found and expected. */
ERN_NODISCARD ern_status ern_csv_read_column(ern_context *context, const char *path, const char *name, float **values,
                                             size_t *count);

#endif
