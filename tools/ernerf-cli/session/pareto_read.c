/* SPDX-License-Identifier: MIT */
#include "session/pareto_read.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

/* a point takes about 60 values, so a file of `ernerf tradeoff` has 16,000 at most */
enum { FILE_LIMIT = 4 << 20, MOST_VALUES = 1 << 17, MOST_POINTS = 256, MOST_SIDE = 8192, HEX = 64 };
static const double most_ms = 1e9, most_db = 100;

void pareto_free(struct pareto_front *front) {
  free(front->points);
  *front = (struct pareto_front){.count = 0};
}

/* ---- members ----------------------------------------------------------------------------------------------------- */

/* The file and the position in it, for messages. */
struct reading {
  struct session *session;
  const char *path;
  char place[64]; /* "points[3]" */
};

static int refuse(const struct reading *r, const char *what) {
  return session_fail_with(r->session, "%s: %s%s%s", r->path, r->place, r->place[0] != 0 ? ": " : "", what);
}

static int take_number(const struct reading *r, const json_t *object, const char *name, double low, double high,
                       double *value) {
  const json_t *member = json_object_get(object, name);
  char expected[96];
  *value = json_number_value(member);
  if (json_is_number(member) && *value >= low && *value <= high) return 0;
  snprintf(expected, sizeof expected, "%s, expected a number from %g to %g", name, low, high);
  return refuse(r, expected);
}

static int take_int(const struct reading *r, const json_t *object, const char *name, int low, int high, int *value) {
  double number = 0;
  if (take_number(r, object, name, low, high, &number) != 0) return EXIT_FAILURE;
  *value = (int)number;
  return number == (double)*value ? 0 : refuse(r, "expected a whole number");
}

static int take_text(const struct reading *r, const json_t *object, const char *name, char *text, size_t bytes) {
  const char *value = json_string_value(json_object_get(object, name));
  char expected[96];
  snprintf(expected, sizeof expected, "%s, expected text of less than %zu bytes", name, bytes);
  if (value == NULL || strlen(value) >= bytes) return refuse(r, expected);
  strcpy(text, value);
  return 0;
}

/* ---- points ------------------------------------------------------------------------------------------------------ */

static int read_point(const struct reading *r, const json_t *object, struct pareto_point *point) {
  const json_t *ms = json_object_get(object, "ms_per_frame");
  const json_t *exact = json_object_get(object, "exact"), *clip = json_object_get(object, "clip");
  if (take_text(r, object, "name", point->name, sizeof point->name) != 0) return EXIT_FAILURE;
  const char *wrong = settings_of_json(&point->settings, json_object_get(object, "settings"));
  if (wrong != NULL) return refuse(r, wrong);
  if (take_number(r, ms, "median", 1e-6, most_ms, &point->ms.median) != 0 ||
      take_number(r, ms, "quartile_1", 1e-6, point->ms.median, &point->ms.low) != 0 ||
      take_number(r, ms, "quartile_3", point->ms.median, most_ms, &point->ms.high) != 0)
    return EXIT_FAILURE;
  if (take_number(r, exact, "psnr_db_mean", -most_db, most_db, &point->exact_db) != 0) return EXIT_FAILURE;
  return take_number(r, clip, "psnr_db_mean", -most_db, most_db, &point->clip_db);
}

static int read_points(struct reading *r, const json_t *file, struct pareto_front *front) {
  const json_t *points = json_object_get(file, "points"), *numbers = json_object_get(file, "front");
  const size_t there = json_array_size(points), count = json_array_size(numbers);
  if (there < 1 || there > MOST_POINTS) return refuse(r, "points, expected a list of 1 to 256");
  if (count < 1 || count > there) return refuse(r, "front, expected a list of numbers of points");
  front->points = calloc(count, sizeof *front->points);
  if (front->points == NULL) return refuse(r, "no memory for its points");
  for (size_t i = 0; i < count; i++) {
    const json_t *number = json_array_get(numbers, i);
    const json_int_t k = json_integer_value(number);
    r->place[0] = 0;
    if (!json_is_integer(number) || k < 0 || (size_t)k >= there)
      return refuse(r, "front, expected numbers of points, counted from 0");
    snprintf(r->place, sizeof r->place, "points[%d]", (int)k);
    if (read_point(r, json_array_get(points, (size_t)k), &front->points[i]) != 0) return EXIT_FAILURE;
    if (i > 0 && front->points[i].ms.median < front->points[i - 1].ms.median)
      return refuse(r, "it is faster than the one before it on the front, expected the fastest first");
    front->count = i + 1;
  }
  r->place[0] = 0;
  return 0;
}

/* ---- the file ---------------------------------------------------------------------------------------------------- */

static int read_object(struct reading *r, const json_t *file, struct pareto_front *front) {
  const json_t *machine = json_object_get(file, "machine"), *clip = json_object_get(file, "clip");
  const char *format = json_string_value(json_object_get(file, "format"));
  if (format == NULL || strcmp(format, "ernerf.tradeoff") != 0)
    return refuse(r, "format, expected \"ernerf.tradeoff\"");
  int version = 0;
  if (take_int(r, file, "version", 1, 1, &version) != 0) return EXIT_FAILURE;
  if (take_text(r, json_object_get(file, "model"), "sha256", front->model_sha256, sizeof front->model_sha256) != 0)
    return EXIT_FAILURE;
  if (strlen(front->model_sha256) != HEX || strspn(front->model_sha256, "0123456789abcdef") != HEX)
    return refuse(r, "model.sha256, expected 64 hex digits");
  if (take_text(r, machine, "cpu", front->cpu, sizeof front->cpu) != 0 ||
      take_int(r, machine, "cores", 1, 65536, &front->cores) != 0 ||
      take_int(r, clip, "width", 1, MOST_SIDE, &front->width) != 0 ||
      take_int(r, clip, "height", 1, MOST_SIDE, &front->height) != 0)
    return EXIT_FAILURE;
  return read_points(r, file, front);
}

/* Upper bound of the number of values that jansson would allocate (about 160 bytes each, lists up to 480): counts the
 * characters that begin or separate values, also inside strings. */
static size_t count_values(const char *text, size_t count) {
  size_t values = 0;
  for (size_t i = 0; i < count; i++) values += text[i] == ',' || text[i] == '[' || text[i] == '{';
  return values;
}

/* Reads a file of at most FILE_LIMIT bytes; *count: its size. NULL after a message. */
static char *read_text(const struct reading *r, size_t *count) {
  FILE *file = fopen(r->path, "rb");
  char *text = malloc(FILE_LIMIT + 1);
  bool whole = file != NULL && text != NULL;
  if (whole) {
    *count = fread(text, 1, FILE_LIMIT + 1, file);
    whole = !ferror(file) && *count <= FILE_LIMIT;
  }
  if (!whole) {
    refuse(r, file == NULL || text == NULL || ferror(file) ? "cannot be read"
                                                           : "is too long for a front, expected 4 MiB at most");
    free(text);
    text = NULL;
  }
  if (file != NULL) fclose(file);
  return text;
}

int pareto_read(struct pareto_front *front, struct session *session, const char *path) {
  struct reading r = {session, path, ""};
  struct stat about;
  json_error_t error;
  size_t count = 0;
  *front = (struct pareto_front){.count = 0};
  if (stat(path, &about) != 0 || !S_ISREG(about.st_mode)) return refuse(&r, "is not there, or is no file");
  char *text = read_text(&r, &count);
  if (text == NULL) return EXIT_FAILURE;
  const bool many = count_values(text, count) > MOST_VALUES;
  json_t *file = many ? NULL : json_loadb(text, count, JSON_REJECT_DUPLICATES, &error);
  free(text);
  if (many) return refuse(&r, "has too many values for a front, expected 131072 at most");
  if (file == NULL) return session_fail_with(session, "%s: line %d: is no JSON: %s", path, error.line, error.text);
  const int status = read_object(&r, file, front);
  json_decref(file);
  return status;
}
