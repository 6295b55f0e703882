/* SPDX-License-Identifier: MIT
 * Writes the tables of the ablation, as JSON, CSV and Markdown. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "lab/ablation.h"
#include "session/pareto.h"

const struct ablation_kind ablation_kinds[ABLATION_ROWS] = {
    {"mlp-concat", ERN_BACKBONE_MLP, ERN_ATTENTION_CONCAT, 30.75, 3.345},
    {"triplane-concat", ERN_BACKBONE_TRIPLANE, ERN_ATTENTION_CONCAT, 32.11, 2.960},
    {"triplane-channel", ERN_BACKBONE_TRIPLANE, ERN_ATTENTION_CHANNEL, 33.14, 2.825},
    {"hash3d-concat", ERN_BACKBONE_HASH3D, ERN_ATTENTION_CONCAT, 33.05, 2.919},
    {"hash3d-channel", ERN_BACKBONE_HASH3D, ERN_ATTENTION_CHANNEL, 33.12, 2.810},
    {"trihash-concat", ERN_BACKBONE_TRIHASH, ERN_ATTENTION_CONCAT, 33.25, 2.881},
    {"trihash-feature", ERN_BACKBONE_TRIHASH, ERN_ATTENTION_FEATURE, 33.14, 2.781},
    {"trihash-channel", ERN_BACKBONE_TRIHASH, ERN_ATTENTION_CHANNEL, 33.10, 2.740}};

const char *const ablation_files[ABLATION_FILES] = {"ablation.json", "ablation.csv", "ablation.md"};

/* The paper's supplement, "The Number of Hash Collisions": Instant-NGP; frontal, side 1, side 2. */
static const double paper_volume = 835186, paper_plane[3] = {138345, 31041, 26048};

/* Quartiles of the time of a frame, milliseconds. */
static struct quartiles frame_ms_of(const struct ablation_row *row) {
  double ms[ABLATION_TIMES];
  if (row->times == 0) return (struct quartiles){NAN, NAN, NAN};
  memcpy(ms, row->ms, row->times * sizeof *ms);
  return quartiles_of(ms, row->times);
}

/* Mean and deviation over the seeds; with one seed, the deviation over the frames. */
static struct mean_and_deviation figure_of(const double *values, size_t seeds, double frames) {
  const struct mean_and_deviation found = mean_of(values, seeds);
  return (struct mean_and_deviation){found.mean, seeds > 1 ? found.deviation : frames};
}

/* ---- JSON -------------------------------------------------------------------------------------------------------- */

static json_t *figure(const double *values, size_t count, double frames) {
  const struct mean_and_deviation found = mean_of(values, count);
  json_t *seeds = json_array();
  for (size_t i = 0; i < count; i++) json_array_append_new(seeds, session_number(values[i]));
  return json_pack("{s:o, s:o, s:o, s:o}", "mean", session_number(found.mean), "deviation_of_seeds",
                   count > 1 ? session_number(found.deviation) : json_null(), "deviation_of_frames",
                   session_number(frames), "seeds", seeds);
}

static json_t *row_json(const struct ablation_row *row) {
  const struct quartiles frame_ms = frame_ms_of(row);
  return json_pack("{s:s, s:s, s:s, s:o, s:o, s:o, s:o, s:{s:o, s:o, s:o, s:I}, s:b, s:o, s:I, s:I, s:o, s:o}", "name",
                   row->kind->name, "backbone", ern_backbone_name(row->kind->backbone), "attention",
                   ern_attention_name(row->kind->attention), "psnr", figure(row->psnr, row->seeds, row->psnr_frames),
                   "ssim", figure(row->ssim, row->seeds, row->ssim_frames), "psnr_mouth",
                   row->has_mouth ? figure(row->mouth, row->seeds, row->mouth_frames) : json_null(), "training_seconds",
                   figure(row->seconds, row->seeds, NAN), "ms_per_frame", "median", session_number(frame_ms.median),
                   "quartile_1", session_number(frame_ms.low), "quartile_3", session_number(frame_ms.high), "count",
                   (json_int_t)row->times, "fused", row->fused, "sample_flops", session_number(row->sample_flops),
                   "parameters", (json_int_t)row->parameters, "model_bytes", (json_int_t)row->bytes, "paper_psnr",
                   session_number(row->kind->paper_psnr), "paper_lmd", session_number(row->kind->paper_lmd));
}

static json_t *count_json(const ern_bench_collision_count *count, double paper) {
  return json_pack("{s:I, s:o, s:o}", "cells", (json_int_t)count->cells, "collisions",
                   session_number(count->collisions), "paper", session_number(paper));
}

static json_t *collisions_json(const ern_bench_collision_table *table) {
  return json_pack(
      "{s:I, s:o, s:o, s:o, s:o, s:o}", "points", (json_int_t)table->points, "scale", session_number(table->scale),
      "volume", count_json(&table->volume, paper_volume), "frontal_xz", count_json(&table->plane[0], paper_plane[0]),
      "side_xy", count_json(&table->plane[1], paper_plane[1]), "side_yz", count_json(&table->plane[2], paper_plane[2]));
}

json_t *ablation_json(const struct ablation *ablation) {
  json_t *rows = json_array();
  for (size_t i = 0; i < ablation->rows; i++) json_array_append_new(rows, row_json(&ablation->row[i]));
  return json_pack("{s:o, s:i, s:i, s:I, s:I, s:i, s:o, s:I, s:s, s:s, s:s, s:i, s:o, s:o}", "clip",
                   session_text(ablation->clip), "width", ablation->width, "height", ablation->height, "frames",
                   (json_int_t)ablation->frames, "iters", (json_int_t)ablation->iters, "rays", ablation->rays, "lr_net",
                   session_number((double)ablation->lr_net), "seed", (json_int_t)ablation->seed, "processor",
                   ablation->processor, "backend", ablation->backend, "isa", ablation->isa, "threads",
                   ablation->threads, "rows", rows, "collisions",
                   ablation->counted ? collisions_json(&ablation->collisions) : json_null());
}

/* ---- text -------------------------------------------------------------------------------------------------------- */

static void add_row(struct bytes *text, const struct ablation_row *row) {
  const struct mean_and_deviation psnr = figure_of(row->psnr, row->seeds, row->psnr_frames),
                                  ssim = figure_of(row->ssim, row->seeds, row->ssim_frames),
                                  mouth = figure_of(row->mouth, row->seeds, row->mouth_frames),
                                  seconds = figure_of(row->seconds, row->seeds, 0);
  const struct quartiles frame_ms = frame_ms_of(row);
  bytes_print(text, "| %s | %s | %.2f ± %.2f | %.4f ± %.4f |", ern_backbone_name(row->kind->backbone),
              ern_attention_name(row->kind->attention), psnr.mean, psnr.deviation, ssim.mean, ssim.deviation);
  if (row->has_mouth)
    bytes_print(text, " %.2f ± %.2f |", mouth.mean, mouth.deviation);
  else
    bytes_print(text, " - |");
  bytes_print(text, " %.1f", seconds.mean);
  if (row->seeds > 1) bytes_print(text, " ± %.1f", seconds.deviation);
  bytes_print(text, " | %.2f (%.2f to %.2f)%s | %.1f | %.3f | %.2f | %.2f |\n", 1000 / frame_ms.median,
              1000 / frame_ms.high, 1000 / frame_ms.low, row->fused ? "" : " *", row->sample_flops / 1000,
              (double)row->parameters / 1e6, (double)row->bytes / 1e6, row->kind->paper_psnr);
}

static void add_collisions(struct bytes *text, const ern_bench_collision_table *table) {
  const double planes = table->plane[0].collisions + table->plane[1].collisions + table->plane[2].collisions,
               paper_planes = paper_plane[0] + paper_plane[1] + paper_plane[2];
  bytes_print(
      text,
      "\n## Hash collisions of one look-up step\n\n"
      "One level of resolution 512 in which everything is hashed; %zu samples of one frame, their coordinates scaled "
      "up\n"
      "%.2f times so that the longest side of their box is that of the scene. A look-up collides where another vertex\n"
      "took its entry before; points in one cell look up the same and count once. Times 1/8 (volume) and 1/4 "
      "(planes),\n"
      "as in the paper, which does not say by how much it scaled. Counts are exact, without spread.\n\n"
      "| | volume, 16,384 entries | frontal (xz), 5,461 | side (xy), 5,461 | side (yz), 5,461 | planes in all | volume "
      "/ "
      "planes |\n| --- | ---: | ---: | ---: | ---: | ---: | ---: |\n",
      table->points, table->scale);
  bytes_print(text, "| here | %.0f | %.0f | %.0f | %.0f | %.0f | %.2f |\n", table->volume.collisions,
              table->plane[0].collisions, table->plane[1].collisions, table->plane[2].collisions, planes,
              planes > 0 ? table->volume.collisions / planes : 0);
  bytes_print(text, "| paper | %.0f | %.0f | %.0f | %.0f | %.0f | %.2f |\n", paper_volume, paper_plane[0],
              paper_plane[1], paper_plane[2], paper_planes, paper_volume / paper_planes);
}

void ablation_text(const struct ablation *ablation, struct bytes *text) {
  const size_t seeds = ablation->rows > 0 ? ablation->row[0].seeds : 0;
  bytes_print(text,
              "# Ablation\n\n%s, %d x %d; heads of %llu steps of %d rays each, networks at a rate of %g, %zu seed%s; "
              "evaluated on\n%zu frames.\n",
              ablation->clip, ablation->width, ablation->height, (unsigned long long)ablation->iters, ablation->rays,
              (double)ablation->lr_net, seeds, seeds == 1 ? "" : "s", ablation->frames);
  bytes_print(text,
              "%s, %d threads, %s (%s). ± is the standard deviation over %s; frames a second: median and quartiles of\n"
              "frames drawn in turns.\n\n",
              ablation->processor, ablation->threads, ablation->backend, ablation->isa,
              seeds > 1 ? "the seeds" : "the frames");
  bytes_print(text,
              "| backbone | attention | PSNR, dB | SSIM | PSNR mouth, dB | training, s | frames/s | kFLOP a sample | "
              "parameters, "
              "million | file, MB | paper's PSNR, dB |\n"
              "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |\n");
  for (size_t i = 0; i < ablation->rows; i++) add_row(text, &ablation->row[i]);
  bytes_print(
      text,
      "\n\\* drawn stage by stage; the paper's own model has a pass of its own, so frames a second compare what one\n"
      "gets, and FLOP a sample compare the models. The paper's PSNR is of its own clips and 125,000 steps.\n");
  if (ablation->counted) add_collisions(text, &ablation->collisions);
}

/* ---- files ------------------------------------------------------------------------------------------------------- */

static void add_csv(const struct ablation *ablation, struct bytes *text) {
  bytes_print(
      text,
      "backbone,attention,psnr_db,psnr_spread_db,ssim,ssim_spread,psnr_mouth_db,psnr_mouth_spread_db,training_s,"
      "training_spread_s,ms_median,ms_quartile_1,ms_quartile_3,fused,flop_a_sample,parameters,bytes,paper_psnr_db\n");
  for (size_t i = 0; i < ablation->rows; i++) {
    const struct ablation_row *row = &ablation->row[i];
    const struct mean_and_deviation psnr = figure_of(row->psnr, row->seeds, row->psnr_frames),
                                    ssim = figure_of(row->ssim, row->seeds, row->ssim_frames),
                                    mouth = figure_of(row->mouth, row->seeds, row->mouth_frames),
                                    seconds = figure_of(row->seconds, row->seeds, 0);
    const struct quartiles frame_ms = frame_ms_of(row);
    bytes_print(text, "%s,%s,%.4f,%.4f,%.6f,%.6f,", ern_backbone_name(row->kind->backbone),
                ern_attention_name(row->kind->attention), psnr.mean, psnr.deviation, ssim.mean, ssim.deviation);
    if (row->has_mouth)
      bytes_print(text, "%.4f,%.4f,", mouth.mean, mouth.deviation);
    else
      bytes_print(text, ",,");
    bytes_print(text, "%.3f,%.3f,%.3f,%.3f,%.3f,%d,%.0f,%zu,%zu,%.2f\n", seconds.mean, seconds.deviation,
                frame_ms.median, frame_ms.low, frame_ms.high, row->fused, row->sample_flops, row->parameters,
                row->bytes, row->kind->paper_psnr);
  }
}

/* Writes the JSON first: a folder with any of the tables then has the file that ablation_check_earlier reads. */
int ablation_write(const struct ablation *ablation, struct session *session, const char *folder) {
  struct bytes csv = {0}, text = {0};
  char path[4096];
  if (snprintf(path, sizeof path, "%s/%s", folder, ablation_files[0]) >= (int)sizeof path)
    return session_fail_with(session, "%s: the name is too long", folder);
  int status = session_write_json(session, path, ablation_json(ablation));
  if (status != 0) return status;
  add_csv(ablation, &csv);
  status = session_write_in(session, folder, ablation_files[1], &csv);
  if (status != 0) return status;
  ablation_text(ablation, &text);
  return session_write_in(session, folder, ablation_files[2], &text);
}

static bool has_row(const struct ablation *ablation, const char *name) {
  for (size_t r = 0; name != NULL && r < ablation->rows; r++)
    if (strcmp(ablation->row[r].kind->name, name) == 0) return true;
  return false;
}

/* Checks that an earlier table has the same conditions, except the number of steps, which may grow. */
static int check_terms(const struct ablation *ablation, struct session *session, const json_t *root, const char *path) {
  const json_t *psnr = json_object_get(json_array_get(json_object_get(root, "rows"), 0), "psnr");
  const struct {
    const char *name;
    double found, expected;
  } terms[] = {{"frames", json_number_value(json_object_get(root, "frames")), (double)ablation->frames},
               {"rays", json_number_value(json_object_get(root, "rays")), ablation->rays},
               {"lr_net", (double)(float)json_number_value(json_object_get(root, "lr_net")), (double)ablation->lr_net},
               {"seed", (double)json_integer_value(json_object_get(root, "seed")), (double)ablation->seed},
               {"seeds", (double)json_array_size(json_object_get(psnr, "seeds")), (double)ablation->row[0].seeds}};
  for (size_t i = 0; i < sizeof terms / sizeof *terms; i++)
    if (terms[i].found != terms[i].expected)
      return session_fail_with(session, "%s: has %s %g, expected %g; --overwrite (-y) replaces the tables", path,
                               terms[i].name, terms[i].found, terms[i].expected);
  return 0;
}

int ablation_check_earlier(const struct ablation *ablation, struct session *session, const char *folder) {
  char path[ABLATION_FILES][4096];
  bool any = false;
  for (int i = 0; i < ABLATION_FILES; i++) {
    if (snprintf(path[i], sizeof path[i], "%s/%s", folder, ablation_files[i]) >= (int)sizeof path[i])
      return session_fail_with(session, "%s: the name is too long", folder);
    any = any || access(path[i], F_OK) == 0;
  }
  if (!any) return 0;
  json_t *root = json_load_file(path[0], 0, NULL);
  const json_t *rows = json_object_get(root, "rows");
  const char *lost = NULL;
  int status = 0;
  for (size_t i = 0; lost == NULL && i < json_array_size(rows); i++) {
    lost = json_string_value(json_object_get(json_array_get(rows, i), "name"));
    if (has_row(ablation, lost)) lost = NULL;
  }
  if (json_array_size(rows) == 0)
    status = session_fail_with(session,
                               "%s: holds no tables of an earlier ablation, but %s, %s or %s is there; "
                               "--overwrite (-y) replaces them",
                               folder, ablation_files[0], ablation_files[1], ablation_files[2]);
  else if (lost != NULL)
    status = session_fail_with(
        session, "%s: holds the row %s, which --only leaves out; --overwrite (-y) replaces the tables", path[0], lost);
  else
    status = check_terms(ablation, session, root, path[0]);
  json_decref(root);
  return status;
}
