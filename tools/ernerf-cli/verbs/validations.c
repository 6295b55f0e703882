/* SPDX-License-Identifier: MIT */
#include "verbs/validations.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static const char table_name[] = "measures.csv",
                  head[] =
                      "step,mouth_explained,mouth_correlation,mouth_amplitude,sharpness_head,sharpness_mouth,"
                      "seam\n";
enum { LINE_BYTES = 256, PATH_BYTES = 4096 };

/* Reads lines with increasing steps up to `step`. */
static bool read_lines(struct bytes *table, FILE *file, uint64_t step) {
  char line[LINE_BYTES];
  uint64_t last = 0;
  for (bool first = true; fgets(line, sizeof line, file) != NULL; first = false) {
    uint64_t at = 0;
    if (strchr(line, '\n') == NULL || (first && strcmp(line, head) != 0)) return false;
    if (first) continue;
    if (sscanf(line, "%" SCNu64 ",", &at) != 1 || at <= last) return false;
    if (at > step) break;
    last = at;
    bytes_add(table, line, strlen(line));
  }
  return ferror(file) == 0;
}

/* NULL: no table. *foreign: the path exists but is not a file of this program: a link, a pipe, another first line. */
static FILE *open_table(const char *path, bool *foreign) {
  struct stat about;
  char line[LINE_BYTES];
  const int descriptor = open(path, O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
  *foreign = descriptor < 0 ? errno != ENOENT : fstat(descriptor, &about) != 0 || !S_ISREG(about.st_mode);
  FILE *file = descriptor >= 0 && !*foreign ? fdopen(descriptor, "r") : NULL;
  if (file == NULL) {
    if (descriptor >= 0) close(descriptor);
    return NULL;
  }
  *foreign = fgets(line, sizeof line, file) == NULL || strcmp(line, head) != 0;
  rewind(file);
  return file;
}

/* If a file of that name is not a table of this program, it is kept and no table is written. */
static void read_table(struct validations *v, const char *path, bool resume, uint64_t step) {
  bool foreign = false;
  FILE *file = open_table(path, &foreign);
  bytes_add(&v->table, head, strlen(head));
  if (foreign || (file != NULL && resume && !read_lines(&v->table, file, step))) {
    session_warn(v->session, "%s: is no table of measures, whose first line is %.*s; it is kept, and none is written",
                 path, (int)strlen(head) - 1, head);
    v->no_table = true;
  }
  if (file != NULL) fclose(file);
}

void validations_begin(struct validations *v, struct session *session, const ern_trainer *trainer, const ern_clip *clip,
                       const char *title, bool resume) {
  char table[PATH_BYTES], curve[PATH_BYTES];
  ern_train_report start;
  const char *folder = ern_trainer_folder(trainer);
  *v = (struct validations){.session = session, .trainer = trainer, .clip = clip, .title = title};
  ern_trainer_describe(trainer, &start);
  snprintf(table, sizeof table, "%s/%s", folder, table_name);
  read_table(v, table, resume, start.step);
  snprintf(curve, sizeof curve, "%s/curve.csv", folder);
  if (resume) (void)curve_read(&v->curve, session, curve);
}

ern_status validations_frame(struct validations *v, int split, size_t frame, const float *rgb, const uint8_t *truth) {
  ern_clip_info info;
  ern_clip_describe(v->clip, &info);
  const ern_clip_frame *about = ern_clip_frame_at(v->clip, (ern_split)split, frame);
  return measures_add(&v->now, about, info.width, info.height, truth, rgb) ? ERN_OK : ERN_E_NO_MEMORY;
}

static void extend_curve(struct validations *v, uint64_t step, double psnr) {
  const struct curve_named named = {v->title, &v->curve};
  ern_train_report now;
  ern_trainer_describe(v->trainer, &now);
  const struct curve_point point = {step, now.seconds, psnr, NAN}; /* the mouth is in measures.csv */
  if (curve_add(&v->curve, v->session, point) != 0) return;
  v->plotted = true; /* may be partly written even after an error */
  (void)curve_plot(&named, 1, v->session, ern_trainer_folder(v->trainer), "curve", v->title);
}

static void extend_table(struct validations *v, uint64_t step, const struct measures_figures *f) {
  const bool known = f->mouth.known;
  const double figures[] = {known ? f->mouth.explained : NAN,
                            known ? f->mouth.correlation : NAN,
                            known ? f->mouth.amplitude : NAN,
                            f->sharpness_head,
                            f->sharpness_mouth,
                            f->seam};
  struct bytes copy = {0}; /* the write frees it */
  bytes_print(&v->table, "%" PRIu64, step);
  for (size_t i = 0; i < sizeof figures / sizeof *figures; i++) {
    bytes_print(&v->table, ",");
    if (isfinite(figures[i])) bytes_print(&v->table, "%.5g", figures[i]);
  }
  bytes_print(&v->table, "\n");
  bytes_add(&copy, v->table.data, v->table.count);
  v->tabled |= session_write_in(v->session, ern_trainer_folder(v->trainer), table_name, &copy) == 0;
}

ern_status validations_end(struct validations *v, uint64_t step, double psnr, size_t frames, const uint8_t *picture,
                           int width, int height, const char *name) {
  char path[PATH_BYTES], moves[64] = "";
  const ern_image image = {.width = width, .height = height, .channels = 3, .data = (uint8_t *)(uintptr_t)picture};
  const struct measures_figures figures = measures_figures(&v->now);
  measures_free(&v->now);
  v->psnr = psnr;
  v->frames = frames;
  if (figures.mouth.known)
    snprintf(moves, sizeof moves, ", %.1f %% of the mouth's motion", 100 * figures.mouth.explained);
  session_note(v->session, "step %" PRIu64 ": PSNR %.3f%s over %zu validation frames, %s", step, psnr, moves, frames,
               name);
  snprintf(path, sizeof path, "%s/%s", ern_trainer_folder(v->trainer), name);
  extend_curve(v, step, psnr);
  if (!v->no_table) extend_table(v, step, &figures);
  if (session_keeps_file(v->session, path)) return ERN_OK;
  const ern_provenance made = ern_provenance_default(); /* the drawn frame beside the true one */
  const ern_status status = ern_image_write_provenance(v->session->context, path, &image, 100, &made);
  if (status == ERN_OK) bytes_add(&v->pictures, name, strlen(name) + 1);
  return status;
}

/* What two trainings with other seeds differ by (docs/dub.md). */
static const double mouth_noise = 0.1;

void validations_say_mouth(const struct validations *v) {
  double best = -INFINITY, last = NAN;
  unsigned long long best_step = 0, step = 0;
  for (const char *line = v->table.data; line != NULL; line = strchr(line, '\n')) {
    double explained;
    if (*line == '\n') line++;
    if (sscanf(line, "%llu,%lf", &step, &explained) != 2) continue; /* the head of the table, or not known */
    last = explained;
    if (explained > best) best = explained, best_step = step;
  }
  if (last < best - mouth_noise)
    session_note(v->session,
                 "train: the mouth of unseen frames was best at step %llu, %.0f %% of its motion, now %.0f %%: more "
                 "steps make the picture sharper, and overfit this speech; longer footage helps",
                 best_step, 100 * best, 100 * last);
}

/* Whether X.run holds a state, under any of its names. */
static bool has_state(const char *folder) {
  static const char *const names[] = {"state", "state.next", "state.previous", "state.good"};
  char path[PATH_BYTES];
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    snprintf(path, sizeof path, "%s/%s.safetensors", folder, names[i]);
    if (access(path, F_OK) == 0) return true;
  }
  return false;
}

static void take_away(const char *folder, const char *name) {
  char path[PATH_BYTES];
  struct stat about;
  if (snprintf(path, sizeof path, "%s/%s", folder, name) >= (int)sizeof path) return;
  if (lstat(path, &about) == 0 && S_ISREG(about.st_mode)) (void)unlink(path);
}

void validations_take_back(struct validations *v) {
  static const char *const plots[] = {"curve_seconds.svg", "curve_seconds.png", "curve_steps.svg", "curve_steps.png"};
  const char *folder = ern_trainer_folder(v->trainer);
  if (has_state(folder)) return;
  for (size_t at = 0; at < v->pictures.count; at += strlen(v->pictures.data + at) + 1)
    take_away(folder, v->pictures.data + at);
  for (size_t i = 0; v->plotted && i < sizeof plots / sizeof *plots; i++) take_away(folder, plots[i]);
  if (v->tabled) take_away(folder, table_name);
}

void validations_free(struct validations *v) {
  curve_free(&v->curve);
  measures_free(&v->now);
  bytes_free(&v->table);
  bytes_free(&v->pictures);
}
