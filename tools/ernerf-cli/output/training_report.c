/* SPDX-License-Identifier: MIT */
#include "output/training_report.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>

void training_free(struct training_study *study) {
  for (size_t k = 0; k < study->count; k++)
    for (int seed = 0; seed < TRAINING_SEEDS; seed++) curve_free(&study->kind[k].curve[seed]);
}

/* Number of points that all seeds have. */
static size_t common_points(const struct training_kind *kind, size_t seeds) {
  size_t least = seeds > 0 ? kind->curve[0].count : 0;
  for (size_t seed = 1; seed < seeds; seed++)
    if (kind->curve[seed].count < least) least = kind->curve[seed].count;
  return least;
}

static struct curve_point mean_point(const struct training_kind *kind, size_t seeds, size_t i) {
  struct curve_point mean = {.step = kind->curve[0].point[i].step};
  for (size_t seed = 0; seed < seeds; seed++) {
    mean.seconds += kind->curve[seed].point[i].seconds / (double)seeds;
    mean.psnr += kind->curve[seed].point[i].psnr / (double)seeds;
    mean.mouth += kind->curve[seed].point[i].mouth / (double)seeds;
  }
  return mean;
}

struct training_end training_final(const struct training_kind *kind, size_t seeds) {
  double psnr[TRAINING_SEEDS], mouth[TRAINING_SEEDS];
  const size_t points = common_points(kind, seeds);
  if (points == 0) return (struct training_end){{NAN, NAN}, {NAN, NAN}};
  for (size_t seed = 0; seed < seeds; seed++) {
    psnr[seed] = kind->curve[seed].point[points - 1].psnr;
    mouth[seed] = kind->curve[seed].point[points - 1].mouth;
  }
  return (struct training_end){mean_of(psnr, seeds), mean_of(mouth, seeds)};
}

double training_seconds_to(const struct training_kind *kind, size_t seeds, double psnr) {
  const size_t points = common_points(kind, seeds);
  struct curve_point before = {0};
  for (size_t i = 0; i < points; i++) {
    const struct curve_point point = mean_point(kind, seeds, i);
    if (point.psnr >= psnr) {
      if (i == 0) return point.seconds;
      const double part = (psnr - before.psnr) / (point.psnr - before.psnr);
      return before.seconds + part * (point.seconds - before.seconds);
    }
    before = point;
  }
  return NAN;
}

/* Chooses integer decibels up to the best final PSNR, the highest last. */
static void marks_of(const struct training_study *study, double marks[TRAINING_MARKS]) {
  double best = 0;
  for (size_t k = 0; k < study->count; k++) best = fmax(best, training_final(&study->kind[k], study->seeds).psnr.mean);
  for (int m = 0; m < TRAINING_MARKS; m++) marks[m] = floor(best) - (TRAINING_MARKS - 1 - m);
}

static const char *isa_of(const struct training_study *study, const struct training_kind *kind) {
  return kind->opencl ? "" : kind->isa[0] != 0 ? kind->isa : study->base_isa;
}

static const char *precision_of(const struct training_kind *kind) { return kind->bf16 ? "bf16" : "fp32"; }

/* ---- JSON -------------------------------------------------------------------------------------------------------- */

static json_t *curve_json(const struct curve *curve) {
  json_t *points = json_array();
  for (size_t i = 0; i < curve->count; i++)
    json_array_append_new(
        points, json_pack("{s:I, s:o, s:o, s:o}", "step", (json_int_t)curve->point[i].step, "seconds",
                          session_number(curve->point[i].seconds), "psnr_db", session_number(curve->point[i].psnr),
                          "mouth_explained", session_number(curve->point[i].mouth)));
  return points;
}

static json_t *kind_json(const struct training_study *study, const struct training_kind *kind) {
  const struct training_end end = training_final(kind, study->seeds);
  const bool spread = study->seeds > 1;
  double marks[TRAINING_MARKS];
  json_t *curves = json_array(), *reached = json_array();
  for (size_t seed = 0; seed < study->seeds; seed++) json_array_append_new(curves, curve_json(&kind->curve[seed]));
  marks_of(study, marks);
  for (int m = 0; m < TRAINING_MARKS; m++)
    json_array_append_new(reached, json_pack("{s:o, s:o}", "psnr_db", session_number(marks[m]), "seconds",
                                             session_number(training_seconds_to(kind, study->seeds, marks[m]))));
  return json_pack("{s:s, s:i, s:i, s:s, s:I, s:s, s:s, s:s, s:I, s:o, s:o, s:o, s:o, s:o, s:o}", "name", kind->name,
                   "rays", kind->rays, "levels", kind->levels, "ray_sampling",
                   ern_ray_sampling_name(kind->ray_sampling), "refresh_every", (json_int_t)kind->refresh_every,
                   "precision", precision_of(kind), "backend", kind->opencl ? "opencl" : "cpu", "isa",
                   isa_of(study, kind), "steps", (json_int_t)kind->iters, "psnr_db_mean", session_number(end.psnr.mean),
                   "psnr_db_deviation", spread ? session_number(end.psnr.deviation) : json_null(),
                   "mouth_explained_mean", session_number(end.mouth.mean), "mouth_explained_deviation",
                   spread ? session_number(end.mouth.deviation) : json_null(), "reached", reached, "seeds", curves);
}

static json_t *quartiles_json(const struct quartiles *of) {
  return json_pack("{s:f, s:f, s:f}", "median", of->median, "quartile_1", of->low, "quartile_3", of->high);
}

/* null if no fine step was possible. */
static json_t *fine_json(const struct fine_stage_cost *price) {
  json_t *steps = json_array();
  for (size_t i = 0; i < price->count; i++)
    json_array_append_new(
        steps, json_pack("{s:s, s:o, s:o}", "loss", price->step[i].loss, "ms", quartiles_json(&price->step[i].ms),
                         "times_coarse", quartiles_json(&price->step[i].times)));
  json_t *made = json_pack("{s:i, s:i, s:I, s:o}", "rays", price->rays, "patch_size", price->patch, "turns",
                           (json_int_t)price->turns, "steps", steps);
  if (price->count > 0) return made;
  json_decref(made);
  return json_null();
}

json_t *training_json(const struct training_study *study) {
  json_t *kinds = json_array();
  for (size_t k = 0; k < study->count; k++) json_array_append_new(kinds, kind_json(study, &study->kind[k]));
  return json_pack("{s:o, s:s, s:i, s:f, s:I, s:I, s:o, s:o}", "clip", session_text(study->clip), "processor",
                   study->processor, "cores", study->cores, "seconds", study->seconds, "seeds",
                   (json_int_t)study->seeds, "frames", (json_int_t)study->frames, "trainings", kinds, "fine_stage",
                   fine_json(&study->fine));
}

/* ---- table ------------------------------------------------------------------------------------------------------- */

static void add_cell(struct bytes *text, struct mean_and_deviation value, size_t seeds, int digits) {
  if (isfinite(value.mean))
    bytes_print(text, " %.*f", digits, value.mean);
  else
    bytes_print(text, " -");
  if (isfinite(value.mean) && seeds > 1) bytes_print(text, " ± %.*f", digits, value.deviation);
  bytes_print(text, " |");
}

static void add_table(const struct training_study *study, struct bytes *text) {
  double marks[TRAINING_MARKS];
  marks_of(study, marks);
  bytes_print(text,
              "# Quality against cost\n\n"
              "%s; %g s of training for each curve, %zu seed%s; PSNR over %zu validation frame%s.\n"
              "%s, %d cores. Seconds are those of training, without validations. ± is the standard deviation over\n"
              "the seeds; seconds to a PSNR are read off the mean curve between its points, at the first point at "
              "the earliest.\n"
              "The mouth's motion is explained by 1 where the rendered mouth moves as the recorded one; -: not known "
              "without\n"
              "landmarks of three validation frames in which it moves. As published: ray_sampling uniform, and a\n"
              "refresh of the whole occupancy grid every 16 steps. As train --time: small steps, pruning, and from 400 "
              "steps on the average of the weights.\n\n"
              "| training | steps | steps/s | PSNR at the end, dB | mouth's motion explained at the end |",
              study->clip, study->seconds, study->seeds, study->seeds == 1 ? "" : "s", study->frames,
              study->frames == 1 ? "" : "s", study->processor, study->cores);
  for (int m = 0; m < TRAINING_MARKS; m++) bytes_print(text, " s to %.0f dB |", marks[m]);
  bytes_print(text, "\n| --- | ---: | ---: | ---: | ---: |");
  for (int m = 0; m < TRAINING_MARKS; m++) bytes_print(text, " ---: |");
  for (size_t k = 0; k < study->count; k++) {
    const struct training_kind *kind = &study->kind[k];
    const struct training_end end = training_final(kind, study->seeds);
    const size_t points = common_points(kind, study->seeds);
    const double seconds = points > 0 ? mean_point(kind, study->seeds, points - 1).seconds : NAN;
    bytes_print(text, "\n| %s | %" PRIu64 " | %.1f |", kind->name, kind->iters, (double)kind->iters / seconds);
    add_cell(text, end.psnr, study->seeds, 2);
    add_cell(text, end.mouth, study->seeds, 3);
    for (int m = 0; m < TRAINING_MARKS; m++) {
      const double needed = training_seconds_to(kind, study->seeds, marks[m]);
      if (isfinite(needed))
        bytes_print(text, " %.1f |", needed);
      else
        bytes_print(text, " - |");
    }
  }
  bytes_print(text, "\n");
}

static void add_fine(const struct fine_stage_cost *price, struct bytes *text) {
  bytes_print(text, "\n# What a step of the fine stage costs\n\n");
  if (price->count == 0) {
    bytes_print(text,
                "Not measured: a patch is %d x %d pixels, so it needs pictures of that size and %d rays a step; the "
                "first training has %d.\n",
                price->patch, price->patch, price->patch * price->patch, price->rays);
    return;
  }
  bytes_print(
      text,
      "Steps of the first training, %d rays, in %zu turns of one step each, after the same coarse steps; patches "
      "of %d x %d\npixels. Median and quartiles. Times coarse: over the coarse step of the same turn.\n\n"
      "| step | ms | times coarse |\n| --- | ---: | ---: |\n",
      price->rays, price->turns, price->patch, price->patch);
  for (size_t i = 0; i < price->count; i++) {
    const struct fine_step *of = &price->step[i];
    bytes_print(text, "| %s%s | %.2f (%.2f to %.2f) |", i > 0 ? "fine, " : "", of->loss, of->ms.median, of->ms.low,
                of->ms.high);
    if (i == 0)
      bytes_print(text, " 1 |\n");
    else
      bytes_print(text, " %.2f (%.2f to %.2f) |\n", of->times.median, of->times.low, of->times.high);
  }
  if (price->count < FINE_STEPS) bytes_print(text, "\nLPIPS: not measured: needs --lpips-network and --lpips-heads.\n");
}

static void add_csv(const struct training_study *study, struct bytes *csv) {
  bytes_print(csv,
              "training,rays,levels,ray_sampling,refresh_every,precision,backend,isa,seed,step,seconds,psnr_db,"
              "mouth_explained\n");
  for (size_t k = 0; k < study->count; k++)
    for (size_t seed = 0; seed < study->seeds; seed++) {
      const struct training_kind *kind = &study->kind[k];
      const struct curve *curve = &kind->curve[seed];
      for (size_t i = 0; i < curve->count; i++) {
        bytes_print_csv(csv, kind->name);
        bytes_print(csv, ",%d,%d,%s,%" PRIu64 ",%s,%s,%s,%zu,%" PRIu64 ",%.3f,%.4f,", kind->rays, kind->levels,
                    ern_ray_sampling_name(kind->ray_sampling), kind->refresh_every, precision_of(kind),
                    kind->opencl ? "opencl" : "cpu", isa_of(study, kind), seed, curve->point[i].step,
                    curve->point[i].seconds, curve->point[i].psnr);
        if (isfinite(curve->point[i].mouth)) bytes_print(csv, "%.5g", curve->point[i].mouth);
        bytes_print(csv, "\n");
      }
    }
}

/* ---- files ------------------------------------------------------------------------------------------------------- */

/* Plots the mean curves over the seeds. If the mouth is unknown, its plot is an empty frame with a note. */
static int plot_all(const struct training_study *study, struct session *session, const char *folder) {
  struct curve mean[TRAINING_KINDS] = {{0}};
  struct curve_named named[TRAINING_KINDS];
  int status = 0;
  for (size_t k = 0; k < study->count; k++) {
    const struct training_kind *kind = &study->kind[k];
    const size_t points = common_points(kind, study->seeds);
    for (size_t i = 0; i < points && status == 0; i++)
      status = curve_add(&mean[k], session, mean_point(kind, study->seeds, i));
    named[k] = (struct curve_named){kind->name, &mean[k]};
  }
  const bool several = study->seeds > 1, known = isfinite(training_final(&study->kind[0], study->seeds).mouth.mean);
  if (status == 0)
    status = curve_plot(named, study->count, session, folder, "training",
                        several ? "Quality against cost (mean over the seeds)" : "Quality against cost");
  if (status == 0)
    status = curve_plot_mouth(named, known ? study->count : 0, session, folder, "training",
                              !known    ? "Nothing is known of the mouth's motion"
                              : several ? "How soon the mouth moves (mean over the seeds)"
                                        : "How soon the mouth moves");
  for (size_t k = 0; k < study->count; k++) curve_free(&mean[k]);
  return status;
}

int training_write(const struct training_study *study, struct session *session, const char *folder) {
  struct bytes table = {0}, csv = {0};
  char path[4096];
  add_table(study, &table);
  add_fine(&study->fine, &table);
  if (!session_json_on_stdout(session) && !table.failed) fwrite(table.data, 1, table.count, stdout);
  int status = session_write_in(session, folder, "training.md", &table);
  if (status != 0) return status;
  add_csv(study, &csv);
  status = session_write_in(session, folder, "training.csv", &csv);
  if (status == 0) status = plot_all(study, session, folder);
  if (status != 0) return status;
  if (snprintf(path, sizeof path, "%s/training.json", folder) >= (int)sizeof path)
    return session_fail_with(session, "%s: the name is too long", folder);
  return session_write_json(session, path, training_json(study));
}
