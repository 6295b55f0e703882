/* SPDX-License-Identifier: MIT */
#include "evaluation/action_units.h"

#include <math.h>
#include <stdlib.h>

#include "ernerf-lab/measured_files.h"

/* The 17 intensities that OpenFace 2 writes, those of the upper face first, divided as in the script auerror.py of the
 * paper's authors. */
enum { UPPER = 8, UNITS = 17, SUCCESS = UNITS, COLUMNS };
static const char *const names[COLUMNS] = {"AU01_r", "AU02_r", "AU04_r", "AU05_r", "AU06_r", "AU07_r",
                                           "AU09_r", "AU45_r", "AU10_r", "AU12_r", "AU14_r", "AU15_r",
                                           "AU17_r", "AU20_r", "AU23_r", "AU25_r", "AU26_r", "success"};

static int read_table(struct session *session, const char *path, size_t count, ern_table *table) {
  if (ern_table_read(session->context, path, names, COLUMNS, table) != ERN_OK) return session_fail(session);
  if (table->rows != count)
    return session_fail_with(session, "%s: has %zu rows, expected %zu: one a frame that is evaluated, in their order",
                             path, table->rows, count);
  for (size_t k = 0; k < UNITS; k++)
    for (size_t i = 0; i < count && table->columns[k] != NULL; i++)
      if (!(table->columns[k][i] >= 0 && table->columns[k][i] <= 5))
        return session_fail_with(session, "%s: row %zu: %s is %g, expected an intensity of 0 to 5", path, i + 1,
                                 names[k], (double)table->columns[k][i]);
  return 0;
}

static bool succeeds(const ern_table *table, size_t row) {
  return table->columns[SUCCESS] == NULL || table->columns[SUCCESS][row] > 0.5f;
}

/* Mean squared difference over the frames, summed over the units in [begin, end) that both tables have. */
static double sum_of(const ern_table *drawn, const ern_table *truth, int begin, int end, size_t frames) {
  double sum = 0;
  bool any = false;
  for (int k = begin; k < end; k++) {
    const float *a = drawn->columns[k], *b = truth->columns[k];
    if (a == NULL || b == NULL) continue;
    any = true;
    for (size_t i = 0; i < drawn->rows; i++)
      if (succeeds(drawn, i) && succeeds(truth, i)) sum += pow((double)a[i] - (double)b[i], 2) / (double)frames;
  }
  return any ? sum : NAN;
}

static int compare(struct action_units *units, struct session *session, const ern_table *drawn,
                   const ern_table *truth) {
  const char *absent = NULL;
  for (size_t k = 0; k < UNITS; k++) {
    if (drawn->columns[k] != NULL && truth->columns[k] != NULL)
      units->units++;
    else if (absent == NULL)
      absent = names[k];
  }
  if (units->units == 0)
    return session_fail_with(session,
                             "%s and %s have no intensity of an action unit in common, expected AU01_r to "
                             "AU45_r as OpenFace writes them",
                             units->rendered_path, units->recorded_path);
  for (size_t i = 0; i < drawn->rows; i++) units->frames += succeeds(drawn, i) && succeeds(truth, i);
  units->left_out = drawn->rows - units->frames;
  if (units->frames == 0)
    return session_fail_with(session, "%s and %s: no row has success in both, expected 1 where the face was found",
                             units->rendered_path, units->recorded_path);
  if (absent != NULL)
    session_warn(session,
                 "%s and %s have %zu of the %d action units in common (%s is absent): the sum is of fewer "
                 "terms than others have",
                 units->rendered_path, units->recorded_path, units->units, (int)UNITS, absent);
  units->upper = sum_of(drawn, truth, 0, UPPER, units->frames);
  units->lower = sum_of(drawn, truth, UPPER, UNITS, units->frames);
  units->all = sum_of(drawn, truth, 0, UNITS, units->frames);
  return 0;
}

int action_units_compare(struct action_units *units, struct session *session, size_t count) {
  ern_table drawn = {.rows = 0}, truth = {.rows = 0};
  int status = 0;
  if (units->rendered_path == NULL) return 0;
  status = read_table(session, units->rendered_path, count, &drawn);
  if (status == 0) status = read_table(session, units->recorded_path, count, &truth);
  if (status == 0) status = compare(units, session, &drawn, &truth);
  ern_table_free(session->context, &drawn);
  ern_table_free(session->context, &truth);
  return status;
}
