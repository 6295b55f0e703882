/* SPDX-License-Identifier: MIT */
#include "ernerf-lab/measured_files.h"

#include "core/floats.h"
#include "core/memory.h"
#include "io/csv.h"
#include "io/landmarks.h"

ern_status ern_table_read(ern_context *context, const char *path, const char *const *names, size_t count,
                          ern_table *table) {
  ERN_PLAIN_FLOATS;
  bool there[ERN_TABLE_COLUMNS] = {false};
  const char *found[ERN_TABLE_COLUMNS];
  float *values[ERN_TABLE_COLUMNS] = {NULL};
  size_t wanted = 0;
  if (table != NULL) *table = (ern_table){.rows = 0};
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, names);
  ERN_NEED(context, table);
  if (count > ERN_TABLE_COLUMNS)
    return ern_fail(context, ERN_E_ARGUMENT, "%s: %zu columns, expected at most %d", path, count, ERN_TABLE_COLUMNS);
  for (size_t k = 0; k < count; k++) ERN_NEED(context, names[k]);
  ern_status status = ern_csv_find_columns(context, path, names, count, there);
  if (status != ERN_OK) return status;
  for (size_t k = 0; k < count; k++)
    if (there[k]) found[wanted++] = names[k];
  status = ern_csv_read_columns(context, path, found, wanted, values, &table->rows);
  if (status != ERN_OK) {
    table->rows = 0;
    return status;
  }
  for (size_t k = 0, next = 0; k < count; k++)
    if (there[k]) table->columns[k] = values[next++];
  return ERN_OK;
}

void ern_table_free(ern_context *context, ern_table *table) {
  if (context == NULL || table == NULL) return;
  for (size_t k = 0; k < ERN_TABLE_COLUMNS; k++) ern_release(context, table->columns[k]);
  *table = (ern_table){.rows = 0};
}

ern_status ern_points_read(ern_context *context, const char *path, float points[68][2]) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, points);
  return ern_landmarks_read(context, path, points);
}
