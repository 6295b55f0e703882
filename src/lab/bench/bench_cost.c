/* SPDX-License-Identifier: MIT
 * Arithmetic of the model, counted from its shapes (docs/bench.md): ernerf-lab/bench.h says what counts. */
#include "lab/bench/bench_shared.h"

double ern_bench_mlp_macs(const struct ern_mlp *mlp) {
  double macs = 0;
  for (int l = 0; l < mlp->layers; l++) macs += (double)mlp->width[l] * mlp->width[l + 1];
  return macs;
}

double ern_bench_mlp_bwd_macs(const struct ern_mlp *mlp, int inputs, bool again) {
  const double all = ern_bench_mlp_macs(mlp), first = (double)mlp->width[0] * mlp->width[1];
  const double last = (double)mlp->width[mlp->layers - 1] * mlp->width[mlp->layers];
  const double by_input = all - first + (double)inputs * mlp->width[1];
  return all + by_input + (again ? all - last : 0);
}

static double corners(const struct ern_grid *grid) { return (double)(1 << grid->dims); }

/* A level, dims d: position u*scale + 0.5 and its fraction 3 d; weights: d subtractions, 2^d products of d factors;
 * 2^d multiply-adds a feature. The first level also has u = (x + bound)/(2 bound), 2 d. */
double ern_bench_grid_flops(const struct ern_grid *grid) {
  const double d = grid->dims;
  const double level = 3 * d + d + corners(grid) * (d - 1) + 2 * corners(grid) * grid->features;
  return level * grid->levels + 2 * d;
}
double ern_bench_grid_reads(const struct ern_grid *grid) {
  return corners(grid) * grid->features * (double)grid->levels;
}

enum { SH_FLOPS = 44, RAY_FLOPS = 31, COMPOSITE_FLOPS = 16, COMPOSITE_BWD_FLOPS = 32 };

/* region: A products, norm: a square and a sum a channel of v, a root; one product of the eye */
static double region_flops(const struct ern_field *field) {
  const int channels = field->config.attention == ERN_ATTENTION_CHANNEL ? ERN_AUDIO_CODE : 1;
  return (ern_field_attends(field) ? ERN_AUDIO_CODE + 2 * channels + 1 : 0) + (ern_field_attends_eye(field) ? 1 : 0);
}
static double eye_macs(const struct ern_field *field) {
  return ern_field_attends_eye(field) ? ern_bench_mlp_macs(&field->eye) : 0;
}
/* Sinusoidal encoding: a product and a sine each. */
static double encoder_flops(const struct ern_field *field) {
  double flops = 0;
  for (int p = 0; p < field->encoder.grids; p++) flops += ern_bench_grid_flops(&field->encoder.grid[p]);
  if (field->config.backbone != ERN_BACKBONE_MLP) return flops;
  for (int t = 0; t < ERN_TRUNKS; t++) flops += 2 * ern_bench_mlp_macs(&field->encoder.trunk[t]);
  return flops + 2 * (ERN_X_ROWS - 3);
}

struct ern_bench_cost ern_bench_cost_written(const struct ern_field *field) {
  const double attention = ern_field_attends(field) ? ern_bench_mlp_macs(&field->attention) : 0,
               density = attention + eye_macs(field) + ern_bench_mlp_macs(&field->density);
  return (struct ern_bench_cost){
      .density = encoder_flops(field) + 2 * density + region_flops(field) + (ern_field_attends_eye(field) ? 3 : 0) + 1,
      .colour = 2 * ern_bench_mlp_macs(&field->colour) + 3 * 4 + COMPOSITE_FLOPS,
      .ray = RAY_FLOPS + SH_FLOPS};
}

/* The audio code is folded into the density's weights once a frame, so samples need no products with it. A sample
 * computes only the density row of the density's last layer; its 64 geometry rows and the colour's first layer are
 * folded into one matrix. SH and individual code enter the colour's first layer once a ray. */
struct ern_bench_cost ern_bench_cost_folded(const struct ern_field *field) {
  const struct ern_mlp *d = &field->density, *c = &field->colour;
  const double hidden = (double)d->width[0] * d->width[1] + (double)d->width[1] * d->width[2];
  const double density = ern_bench_mlp_macs(&field->attention) + eye_macs(field) + hidden + d->width[2];
  const double colour = (double)d->width[2] * c->width[1] + (double)c->width[1] * c->width[2];
  return (struct ern_bench_cost){.density = encoder_flops(field) + 2 * density + region_flops(field) - ERN_AUDIO_CODE +
                                            (field->config.eye ? 3 : 0) + 1,
                                 .colour = 2 * colour + c->width[1] + 3 * 4 + COMPOSITE_FLOPS,
                                 .ray = RAY_FLOPS + SH_FLOPS + 2.0 * (c->width[0] - ERN_GEOMETRY) * c->width[1]};
}

double ern_bench_cost_head_step(const struct ern_field *field, bool again) {
  const struct ern_bench_cost forward = ern_bench_cost_written(field);
  const int f = field->feature_rows, code = field->config.codes > 0 ? ERN_CODE_WIDTH : 0;
  double macs = ern_bench_mlp_bwd_macs(&field->attention, f, again) +
                ern_bench_mlp_bwd_macs(&field->density, field->density.width[0], again) +
                ern_bench_mlp_bwd_macs(&field->colour, ERN_GEOMETRY + code, again) +
                ern_bench_mlp_macs(&field->uncertainty) + ern_bench_mlp_bwd_macs(&field->uncertainty, 0, again);
  if (field->config.eye) macs += ern_bench_mlp_bwd_macs(&field->eye, f, again);
  return forward.density + forward.colour + 2 * macs + encoder_flops(field) + 5 * ERN_AUDIO_CODE + COMPOSITE_BWD_FLOPS;
}

double ern_bench_cost_torso(const struct ern_field *field) {
  return 2 * (ern_bench_mlp_macs(&field->torso_deform) + ern_bench_mlp_macs(&field->torso_net)) +
         ern_bench_grid_flops(&field->torso_grid) + 4.0 * 2 * ERN_Q_OCTAVES + 4 * 4 + 9;
}

double ern_bench_cost_torso_step(const struct ern_field *field, bool again) {
  const int code = field->config.codes > 0 ? ERN_TORSO_CODE_WIDTH : 0,
            grid = field->torso_grid.levels * field->torso_grid.features;
  const double macs = ern_bench_mlp_bwd_macs(&field->torso_deform, ERN_K_ROWS + code, again) +
                      ern_bench_mlp_bwd_macs(&field->torso_net, grid + ERN_K_ROWS + code, again);
  return ern_bench_cost_torso(field) + 2 * macs + 2 * ern_bench_grid_flops(&field->torso_grid);
}

double ern_bench_sample_flops(const ern_model *model) {
  if (model == NULL) return 0;
  const struct ern_bench_cost cost = ern_bench_cost_written(&model->field);
  return cost.density + cost.colour;
}
