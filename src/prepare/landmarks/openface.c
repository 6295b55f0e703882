/* SPDX-License-Identifier: MIT */
#include "prepare/landmarks/openface.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "io/csv.h"

enum { POINT_COLUMNS = 2 * ERN_LANDMARKS, ALL_COLUMNS = POINT_COLUMNS + 2, NAME = 8 };
/* Most seconds from a frame of the clip to the nearest row: a slow video has a frame each 0.2 s. */
static const double most_away = 0.25;

/* rows[job->frames]: the row nearest in time. */
static ern_status rows_by_time(struct ern_prepare_job *job, const char *path, const float *times, size_t count,
                               size_t *rows) {
  double from = 0, to = 0;
  size_t row = 0;
  ern_prepare_part(job, &from, &to);
  for (size_t k = 1; k < count; k++)
    if (!(times[k] > times[k - 1]))
      return ern_fail(job->context, ERN_E_FORMAT, "%s: row %zu: timestamp is %g after %g, expected seconds that rise",
                      path, k + 1, (double)times[k], (double)times[k - 1]);
  for (size_t i = 0; i < job->frames; i++) {
    const double at = from + (double)i / ERN_PREPARE_RATE;
    while (row + 1 < count && fabs((double)times[row + 1] - at) <= fabs((double)times[row] - at)) row++;
    if (count == 0 || fabs((double)times[row] - at) > most_away)
      return ern_fail(
          job->context, ERN_E_MISMATCH,
          "%s: has no row near %.2f s, where frame %zu of the clip is; its %zu rows end at %.2f s; expected "
          "a table of the whole video",
          path, at, i, count, count > 0 ? (double)times[count - 1] : 0.0);
    rows[i] = row;
  }
  return ERN_OK;
}

/* Replaces a row without success by the last row before it with success, at the beginning by the first such row. */
static ern_status fill_failed_rows(struct ern_prepare_job *job, const char *path, const float *success, size_t *rows,
                                   size_t *held) {
  size_t last = 0;
  *held = 0;
  while (last < job->frames && !(success[rows[last]] > 0.5f)) last++;
  if (last == job->frames)
    return ern_fail(job->context, ERN_E_FORMAT,
                    "%s: success is 0 in all rows of the clip, expected 1 where the face was found", path);
  size_t good = rows[last];
  for (size_t i = 0; i < job->frames; i++) {
    if (success[rows[i]] > 0.5f)
      good = rows[i];
    else
      rows[i] = good, ++*held;
  }
  return ERN_OK;
}

ern_status ern_openface_landmarks(struct ern_prepare_job *job, const char *path, float (*points)[ERN_LANDMARKS][2],
                                  size_t *held) {
  ern_status status = ERN_OK;
  char names[POINT_COLUMNS][NAME];
  const char *list[ALL_COLUMNS];
  float *values[ALL_COLUMNS] = {NULL};
  size_t count = 0, *rows = NULL;
  double x = 0, y = 0, side = 0, width = 0;
  const json_t *crop = json_object_get(job->record, "crop");
  if (json_unpack((json_t *)crop, "{s:F, s:F, s:F}", "x", &x, "y", &y, "side", &side) != 0 || !(side > 0))
    ERN_TRY(ern_fail(job->context, ERN_E_FORMAT, "%s/prepare.json: has no crop of the video, expected x, y and side",
                     job->folder));
  if (json_unpack((json_t *)crop, "{s:F}", "width", &width) != 0 || !(width > 0)) width = side;
  for (int k = 0; k < POINT_COLUMNS; k++) {
    snprintf(names[k], NAME, "%c_%d", "xy"[k % 2], k / 2);
    list[k] = names[k];
  }
  list[POINT_COLUMNS] = "timestamp";
  list[POINT_COLUMNS + 1] = "success";
  ERN_TRY(ern_csv_read_columns(job->context, path, list, ALL_COLUMNS, values, &count));
  ERN_TRY(ERN_NEW(job->context, job->frames, &rows));
  ERN_TRY(rows_by_time(job, path, values[POINT_COLUMNS], count, rows));
  ERN_TRY(fill_failed_rows(job, path, values[POINT_COLUMNS + 1], rows, held));
  const double begin[2] = {x, y}, size[2] = {width, side};
  for (size_t i = 0; i < job->frames; i++)
    for (int k = 0; k < POINT_COLUMNS; k++) {
      const double value = (double)values[k][rows[i]], in_clip = (value - begin[k % 2]) / size[k % 2];
      if (!(fabs(in_clip) < ERN_PREPARE_REACH))
        ERN_TRY(ern_fail(job->context, ERN_E_FORMAT,
                         "%s: row %zu: %s is %g, expected a pixel of the video, %g to %g at most", path, rows[i] + 1,
                         list[k], value, begin[k % 2] - ERN_PREPARE_REACH * size[k % 2],
                         begin[k % 2] + ERN_PREPARE_REACH * size[k % 2]));
      points[i][k / 2][k % 2] = (float)(in_clip * job->side);
    }
fail:
  for (int k = 0; k < ALL_COLUMNS; k++) ern_release(job->context, values[k]);
  ern_release(job->context, rows);
  return status;
}

/* *values stays NULL where there is no such column. */
static ern_status optional_column(struct ern_prepare_job *job, const char *path, const char *name, float **values,
                                  size_t *count) {
  char kept[ERN_ERROR_BYTES];
  ern_error_keep(job->context, kept);
  const ern_status status = ern_csv_read_column(job->context, path, name, values, count);
  if (status != ERN_E_MISSING) return status;
  ern_error_restore(job->context, kept);
  return ERN_OK;
}

ern_status ern_openface_blinks(struct ern_prepare_job *job, const char *path, float *values, size_t *held) {
  ern_status status = ERN_OK;
  float *lids = NULL, *times = NULL, *success = NULL;
  size_t count = 0, again = 0, *rows = NULL;
  *held = 0;
  ERN_TRY(ern_csv_read_column(job->context, path, "AU45_r", &lids, &count));
  ERN_TRY(optional_column(job, path, "timestamp", &times, &again));
  ERN_TRY(optional_column(job, path, "success", &success, &again));
  ERN_TRY(ERN_NEW(job->context, job->frames, &rows));
  if (times != NULL) {
    ERN_TRY(rows_by_time(job, path, times, count, rows));
  } else {
    if (count < job->frames)
      ERN_TRY(ern_fail(job->context, ERN_E_MISMATCH,
                       "%s: has %zu rows, expected one for each of the clip's %zu frames, or a column timestamp", path,
                       count, job->frames));
    if (count > job->frames + ERN_PREPARE_MORE)
      ERN_TRY(ern_fail(job->context, ERN_E_MISMATCH,
                       "%s: has %zu rows, and the clip has %zu frames; expected one row for each of them, or a column "
                       "timestamp",
                       path, count, job->frames));
    for (size_t i = 0; i < job->frames; i++) rows[i] = i;
  }
  if (success != NULL) ERN_TRY(fill_failed_rows(job, path, success, rows, held));
  for (size_t i = 0; i < job->frames; i++) {
    values[i] = lids[rows[i]];
    if (!(values[i] >= 0 && values[i] <= 5))
      ERN_TRY(ern_fail(job->context, ERN_E_FORMAT, "%s: row %zu: AU45_r is %g, expected 0 (open) to 5", path,
                       rows[i] + 1, (double)values[i]));
  }
fail:
  ern_release(job->context, lids);
  ern_release(job->context, times);
  ern_release(job->context, success);
  ern_release(job->context, rows);
  return status;
}

void ern_openface_check(struct ern_prepare_job *job, const char *path, size_t held) {
  const double share = (double)held / (double)job->frames;
  ern_prepare_figure(job, "held", share);
  if (share > 0.1)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL,
                           "%s: success is 0 in %.0f %% of the frames, which get the values of the last frame with 1; "
                           "expected 10 %% at most",
                           path, 100 * share);
}
