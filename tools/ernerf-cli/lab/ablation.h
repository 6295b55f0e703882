/* SPDX-License-Identifier: MIT
 * The paper's ablation: its rows, the measurements of each, and the result files. */
#ifndef ERN_CLI_ABLATION_H
#define ERN_CLI_ABLATION_H

#include <jansson.h>

#include "bytes.h"
#include "ernerf-lab/bench.h"
#include "ernerf/model.h"
#include "session/session.h"

enum { ABLATION_ROWS = 8, ABLATION_SEEDS = 16, ABLATION_TIMES = 64 };

struct ablation_kind {
  const char *name; /* "trihash-channel" */
  ern_backbone backbone;
  ern_attention attention;
  double paper_psnr, paper_lmd; /* dB; landmark distance: from the paper's table, on the paper's clips */
};
/* The rows of the paper's two tables, in their order. */
extern const struct ablation_kind ablation_kinds[ABLATION_ROWS];

enum { ABLATION_FILES = 3 };
extern const char *const ablation_files[ABLATION_FILES]; /* names in DIR */

struct ablation_row {
  const struct ablation_kind *kind;
  /* One figure for each seed: the mean over the frames. */
  double psnr[ABLATION_SEEDS], ssim[ABLATION_SEEDS], mouth[ABLATION_SEEDS], seconds[ABLATION_SEEDS];
  size_t seeds;
  bool has_mouth;
  /* The standard deviation over the frames, averaged over the seeds. */
  double psnr_frames, ssim_frames, mouth_frames;
  double ms[ABLATION_TIMES]; /* times of frames, drawn in turns with the other rows */
  size_t times;
  bool fused;               /* drawn by one fused pass; other rows stage by stage */
  double sample_flops;      /* of the model as its equations stand */
  size_t parameters, bytes; /* trained parameters; bytes of the file */
};

struct ablation {
  struct ablation_row row[ABLATION_ROWS];
  size_t rows;
  const char *clip;
  int width, height, rays, threads;
  float lr_net;  /* learning rate of the networks */
  uint64_t seed; /* of the first training of each row; the next one has one more */
  size_t frames; /* evaluated frames */
  uint64_t iters;
  const char *backend, *isa;
  char processor[128];
  bool counted; /* collisions */
  ern_bench_collision_table collisions;
};

/* The object of --json and of ablation.json; NULL without memory. */
json_t *ablation_json(const struct ablation *ablation);
/* Writes DIR/ablation.csv, ablation.json and ablation.md, each atomically. Returns 0, or EXIT_FAILURE after a message.
 */
int ablation_write(const struct ablation *ablation, struct session *session, const char *folder);
/* Checks that --resume may replace the tables in the folder: there are none, or all rows of ablation.json are among the
 * present rows. Returns 0, or EXIT_FAILURE after a message. */
int ablation_check_earlier(const struct ablation *ablation, struct session *session, const char *folder);
/* Adds the tables as Markdown, the content of ablation.md. */
void ablation_text(const struct ablation *ablation, struct bytes *text);

#endif
