/* SPDX-License-Identifier: MIT
 * Reads and writes prepare/faces.csv, the table of detected faces. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/format.h"
#include "io/csv.h"
#include "io/file.h"
#include "prepare/landmarks/landmarks_supplied.h"
#include "prepare/prepare_job.h"

/* Eyes that were not found are -1. */
enum { COLUMNS = 9 };
static const char *const columns[COLUMNS] = {"img_id",     "x",          "y",           "width",      "height",
                                             "left_eye_x", "left_eye_y", "right_eye_x", "right_eye_y"};

ern_status ern_prepare_faces_write(struct ern_prepare_job *job, const struct ern_found_face *faces, size_t count) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH], line[256];
  struct ern_file_writer file = {0};
  ERN_TRY(ern_prepare_path(job, path, "prepare"));
  ERN_TRY(ern_folder_make(job->context, path));
  ERN_TRY(ern_prepare_register_output(job, "prepare/faces.csv", path));
  ERN_TRY(ern_file_writer_open(job->context, path, ERN_EXISTING_REPLACE, &file));
  for (int i = 0; i < COLUMNS; i++) {
    const int length = snprintf(line, sizeof line, "%s%s", columns[i], i + 1 < COLUMNS ? "," : "\n");
    ERN_TRY(ern_file_writer_write(&file, line, (size_t)length));
  }
  for (size_t i = 0; i < count; i++) {
    const struct ern_found_face *f = &faces[i];
    static const float none[2] = {-1, -1};
    const float *left = f->has_eyes ? f->eyes[0] : none, *right = f->has_eyes ? f->eyes[1] : none;
    const int length = ern_format(line, sizeof line, "%zu,%.2f,%.2f,%.2f,%.2f,%.2f,%.2f,%.2f,%.2f\n", f->frame,
                                  (double)f->x, (double)f->y, (double)f->width, (double)f->height, (double)left[0],
                                  (double)left[1], (double)right[0], (double)right[1]);
    ERN_TRY(ern_file_writer_write(&file, line, (size_t)length));
  }
  return ern_file_writer_commit(&file);
fail:
  ern_file_writer_abandon(&file);
  return status;
}

ern_status ern_prepare_faces_read(struct ern_prepare_job *job, struct ern_found_face **faces, size_t *count) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH];
  float *values[COLUMNS] = {NULL};
  struct ern_found_face *made = NULL;
  *faces = NULL;
  *count = 0;
  ERN_TRY(ern_prepare_path(job, path, "prepare/faces.csv"));
  size_t rows = 0;
  ERN_TRY(ern_csv_read_columns(job->context, path, columns, COLUMNS, values, &rows));
  ERN_TRY(ERN_NEW(job->context, rows, &made));
  for (size_t i = 0; i < rows; i++) {
    if (!(values[0][i] >= 0) || !(values[0][i] < (float)job->frames) || floorf(values[0][i]) != values[0][i] ||
        (i > 0 && values[0][i] <= values[0][i - 1]))
      ERN_TRY(ern_fail(job->context, ERN_E_FORMAT,
                       "%s: row %zu: img_id is %g, expected whole numbers of 0 to %zu that rise", path, i + 1,
                       (double)values[0][i], job->frames - 1));
    made[i] = (struct ern_found_face){.frame = (size_t)values[0][i],
                                      .x = values[1][i],
                                      .y = values[2][i],
                                      .width = values[3][i],
                                      .height = values[4][i],
                                      .has_eyes = values[5][i] >= 0 && values[7][i] >= 0,
                                      .eyes = {{values[5][i], values[6][i]}, {values[7][i], values[8][i]}}};
  }
  if (job->options->landmarks != NULL) ERN_TRY(ern_landmarks_supplied_eyes(job, made, rows));
  *faces = made;
  *count = rows;
  made = NULL;
fail:
  for (int i = 0; i < COLUMNS; i++) ern_release(job->context, values[i]);
  ern_release(job->context, made);
  return status;
}
