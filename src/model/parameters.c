/* SPDX-License-Identifier: MIT */
#include "model/parameters.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/rng.h"
#include "hashgrid/hashgrid.h"
#include "model/kinds.h"

enum { USUAL_WINDOW_LENGTH = 16 }; /* of DeepSpeech's and wav2vec's features; each frame gives its own */

/* Adds a row; returns where its values begin. Rows start on a cache line. */
static size_t add(struct ern_field *field, struct ern_parameter_table *table, struct ern_parameter row) {
  row.count = 1;
  for (int d = 0; d < row.dims; d++) row.count *= row.shape[d];
  row.at = field->parameters;
  field->parameters += (row.count + 15) / 16 * 16;
  table->row[table->rows++] = row;
  return row.at;
}

static size_t add_named(struct ern_field *field, struct ern_parameter_table *table, const char *prefix,
                        const char *suffix, struct ern_parameter row) {
  snprintf(row.name, sizeof row.name, "%s%s", prefix, suffix);
  return add(field, table, row);
}

/* torch's initial values of Linear and Conv1d: uniform in +-1/sqrt(inputs), for weights and biases alike. */
static float fan_range(size_t inputs) { return (float)(1.0 / sqrt((double)inputs)); }

/* The layers are numbered from `first` on: two stacks may share one network's name. */
static void add_stack(struct ern_field *field, struct ern_parameter_table *table, struct ern_mlp *mlp, const char *name,
                      int first, bool torso, int layers, const int *width) {
  mlp->layers = layers;
  for (int l = 0; l <= layers; l++) mlp->width[l] = width[l];
  for (int l = 0; l < layers; l++) {
    char suffix[24];
    snprintf(suffix, sizeof suffix, ".net.%d.weight", first + l);
    const struct ern_parameter row = {.dims = 2,
                                      .shape = {(size_t)width[l + 1], (size_t)width[l]},
                                      .group = ERN_GROUP_NET,
                                      .torso = torso,
                                      .init = ERN_INIT_UNIFORM,
                                      .range = fan_range((size_t)width[l])};
    mlp->weight[l] = add_named(field, table, name, suffix, row);
  }
}

static void add_mlp(struct ern_field *field, struct ern_parameter_table *table, struct ern_mlp *mlp, const char *name,
                    bool torso, int layers, const int *width) {
  add_stack(field, table, mlp, name, 0, torso, layers, width);
}

/* `kernel` is 3 for a convolution [out][in][3], 1 for a linear layer [out][in]. */
static void add_affine(struct ern_field *field, struct ern_parameter_table *table, size_t *weight, size_t *bias,
                       const char *name, ern_group group, int out, int in, int kernel) {
  struct ern_parameter row = {.dims = kernel > 1 ? 3 : 2,
                              .shape = {(size_t)out, (size_t)in, (size_t)kernel},
                              .group = group,
                              .init = ERN_INIT_UNIFORM,
                              .range = fan_range((size_t)in * (size_t)kernel)};
  *weight = add_named(field, table, name, ".weight", row);
  row.dims = 1;
  *bias = add_named(field, table, name, ".bias", row);
}

static void add_audio(struct ern_field *field, struct ern_parameter_table *table) {
  struct ern_audio_net *net = &field->audio;
  net->width = field->config.feature_width;
  net->window_length = field->config.window_length > 0 ? field->config.window_length : USUAL_WINDOW_LENGTH;
  net->code = ERN_AUDIO_CODE;
  net->first = field->parameters;
  const int conv[ERN_AUDIO_CONVS + 1] = {net->width, 32, 32, 64, 64};
  const int att[ERN_AUDIO_ATT_CONVS + 1] = {net->code, 16, 8, 4, 2, 1};
  char name[ERN_PARAMETER_NAME - 16];
  for (int k = 0; k < ERN_AUDIO_CONVS; k++) {
    snprintf(name, sizeof name, "audio_net.encoder_conv.%d", 2 * k);
    add_affine(field, table, &net->conv_weight[k], &net->conv_bias[k], name, ERN_GROUP_NET, conv[k + 1], conv[k], 3);
  }
  add_affine(field, table, &net->fc_weight[0], &net->fc_bias[0], "audio_net.encoder_fc1.0", ERN_GROUP_NET, 64, 64, 1);
  add_affine(field, table, &net->fc_weight[1], &net->fc_bias[1], "audio_net.encoder_fc1.2", ERN_GROUP_NET, net->code,
             64, 1);
  for (int k = 0; k < ERN_AUDIO_ATT_CONVS; k++) {
    snprintf(name, sizeof name, "audio_att_net.attentionConvNet.%d", 2 * k);
    add_affine(field, table, &net->att_conv_weight[k], &net->att_conv_bias[k], name, ERN_GROUP_AUDIO_ATT, att[k + 1],
               att[k], 3);
  }
  add_affine(field, table, &net->att_fc_weight, &net->att_fc_bias, "audio_att_net.attentionNet.0", ERN_GROUP_AUDIO_ATT,
             ERN_AUDIO_WINDOWS, ERN_AUDIO_WINDOWS, 1);
  net->count = field->parameters - net->first;
}

static ern_status add_grid(struct ern_field *field, struct ern_parameter_table *table, struct ern_grid *grid,
                           size_t *at, const char *name, bool torso, const struct ern_grid_shape *shape) {
  const ern_status status = ern_grid_build(grid, shape);
  if (status != ERN_OK) return status;
  const struct ern_parameter row = {.dims = 2,
                                    .shape = {grid->entries, (size_t)grid->features},
                                    .group = ERN_GROUP_GRID,
                                    .torso = torso,
                                    .init = ERN_INIT_UNIFORM,
                                    .range = 1e-4f};
  *at = add_named(field, table, name, ".embeddings", row);
  return ERN_OK;
}

static size_t add_codes(struct ern_field *field, struct ern_parameter_table *table, const char *name, bool torso,
                        int width) {
  const struct ern_parameter row = {.dims = 2,
                                    .shape = {(size_t)field->config.codes, (size_t)width},
                                    .group = ERN_GROUP_NET,
                                    .torso = torso,
                                    .init = ERN_INIT_NORMAL,
                                    .range = 0.1f};
  return add_named(field, table, name, "", row);
}

/* ---- head -------------------------------------------------------------------------------------------------------- */

static const int plane_axis[ERN_PLANES][ERN_GRID_MAX_DIMS] = {{0, 1}, {1, 2}, {0, 2}};
static const int volume_axis[ERN_GRID_MAX_DIMS] = {0, 1, 2};

const char *ern_encoder_grid_name(const struct ern_field *field, int grid) {
  static const char *const planes[ERN_PLANES] = {"encoder_xy", "encoder_yz", "encoder_xz"};
  return field->config.backbone == ERN_BACKBONE_HASH3D ? "encoder" : planes[grid];
}

static struct ern_grid_shape encoder_shape(const struct ern_model_config *config) {
  struct ern_grid_shape shape = {.dims = 2,
                                 .levels = config->levels,
                                 .features = 1,
                                 .base = 64,
                                 .finest = (int)lrintf(512 * config->bound),
                                 .table_limit = 1u << 14,
                                 .hashed = true,
                                 .bound = config->bound};
  if (config->backbone == ERN_BACKBONE_HASH3D) {
    shape.dims = 3;
    shape.features = 2;
  } else if (config->backbone == ERN_BACKBONE_TRIPLANE) {
    shape.features = 12;
    shape.base = shape.finest = 127; /* cells a side: (127 + 1)^2 = 2^14 grid points, each with its own entry */
    shape.hashed = false;
  }
  return shape;
}

static ern_status add_grids(struct ern_field *field, struct ern_parameter_table *table) {
  struct ern_encoder *encoder = &field->encoder;
  const struct ern_grid_shape shape = encoder_shape(&field->config);
  encoder->grids = shape.dims == 3 ? 1 : ERN_PLANES;
  for (int g = 0; g < encoder->grids; g++) {
    memcpy(encoder->axis[g], shape.dims == 3 ? volume_axis : plane_axis[g], sizeof encoder->axis[g]);
    const ern_status status =
        add_grid(field, table, &encoder->grid[g], &encoder->table[g], ern_encoder_grid_name(field, g), false, &shape);
    if (status != ERN_OK) return status;
  }
  field->feature_rows = encoder->grids * shape.levels * shape.features;
  return ERN_OK;
}

/* Eight layers of 256, with the frequency encoding again at the fifth: AD-NeRF's network before its outputs. */
static ern_status add_trunk(struct ern_field *field, struct ern_parameter_table *table) {
  enum { W = ERN_TRUNK_WIDTH };
  struct ern_mlp *trunk = field->encoder.trunk;
  add_stack(field, table, &trunk[0], "encoder_mlp", 0, false, 4, (int[]){ERN_X_ROWS, W, W, W, W});
  add_stack(field, table, &trunk[1], "encoder_mlp", 4, false, 5,
            (int[]){ERN_X_ROWS + W, W, W, W, W, ERN_TRUNK_FEATURES});
  field->feature_rows = ERN_TRUNK_FEATURES;
  return ERN_OK;
}

static ern_status add_head(struct ern_field *field, struct ern_parameter_table *table) {
  const struct ern_model_config *config = &field->config;
  if (config->codes > 0) field->codes = add_codes(field, table, "individual_codes", false, ERN_CODE_WIDTH);
  add_audio(field, table);
  const ern_status status = config->backbone == ERN_BACKBONE_MLP ? add_trunk(field, table) : add_grids(field, table);
  if (status != ERN_OK) return status;
  const int f = field->feature_rows, code = config->codes > 0 ? ERN_CODE_WIDTH : 0;
  if (ern_field_attends_eye(field)) add_mlp(field, table, &field->eye, "eye_att_net", false, 2, (int[]){f, 16, 1});
  add_mlp(field, table, &field->density, "sigma_net", false, 3,
          (int[]){f + ERN_AUDIO_CODE + (config->eye ? 1 : 0), 64, 64, 1 + ERN_GEOMETRY});
  add_mlp(field, table, &field->colour, "color_net", false, 2,
          (int[]){ern_field_view_rows(field) + ERN_GEOMETRY + code, 64, 3});
  add_mlp(field, table, &field->uncertainty, "unc_net", false, 2, (int[]){f, 32, 1});
  if (ern_field_attends(field))
    add_mlp(field, table, &field->attention, "aud_ch_att_net", false, 2,
            (int[]){f, 64, config->attention == ERN_ATTENTION_FEATURE ? 1 : ERN_AUDIO_CODE});
  return ERN_OK;
}

/* ---- torso ------------------------------------------------------------------------------------------------------- */

static ern_status add_torso(struct ern_field *field, struct ern_parameter_table *table) {
  const struct ern_grid_shape shape = {.dims = 2,
                                       .levels = 16,
                                       .features = 2,
                                       .base = 16,
                                       .finest = 2048,
                                       .table_limit = 1u << 16,
                                       .hashed = false,
                                       .bound = 1};
  const int code = field->config.codes > 0 ? ERN_TORSO_CODE_WIDTH : 0, encoded = ERN_Q_ROWS + ERN_K_ROWS + code;
  const struct ern_parameter anchors = {.name = "anchor_points",
                                        .dims = 2,
                                        .shape = {3, 4},
                                        .group = ERN_GROUP_NET,
                                        .torso = true,
                                        .init = ERN_INIT_ANCHORS};
  const struct ern_parameter gamma = {
      .name = "torso_gamma", .dims = 1, .shape = {1}, .group = ERN_GROUP_NET, .torso = true, .init = ERN_INIT_ONE};
  if (field->config.codes > 0)
    field->torso_codes = add_codes(field, table, "individual_codes_torso", true, ERN_TORSO_CODE_WIDTH);
  field->anchors = add(field, table, anchors);
  if (field->config.torso_gamma) field->gamma = add(field, table, gamma);
  add_mlp(field, table, &field->torso_deform, "torso_deform_net", true, 3, (int[]){encoded, 32, 32, 2});
  const ern_status status =
      add_grid(field, table, &field->torso_grid, &field->torso_table, "torso_encoder", true, &shape);
  if (status != ERN_OK) return status;
  add_mlp(field, table, &field->torso_net, "torso_net", true, 3,
          (int[]){field->torso_grid.levels * field->torso_grid.features + encoded, 32, 32, 4});
  return ERN_OK;
}

/* ---- all --------------------------------------------------------------------------------------------------------- */

static ern_status check_kinds(ern_context *context, const struct ern_model_config *config) {
  for (int k = 0; k < ERN_KINDS; k++)
    if (ern_kind_of(config, (ern_kind)k) == NULL)
      return ern_fail(context, ERN_E_ARGUMENT, "model: %s is of no known kind, expected %s",
                      ern_kind_field((ern_kind)k), ern_kind_words((ern_kind)k));
  if (!config->eye && config->eye_attention != ERN_EYE_ATTENTION_SIGMOID)
    return ern_fail(context, ERN_E_ARGUMENT, "model: eye_attention is %s, but there is no eye value",
                    ern_eye_attention_name(config->eye_attention));
  return ERN_OK;
}

static ern_status check_levels(ern_context *context, const struct ern_model_config *config) {
  const int levels = config->levels, only = config->backbone == ERN_BACKBONE_TRIPLANE ? 1 : 0;
  const bool hashed = config->backbone == ERN_BACKBONE_TRIHASH || config->backbone == ERN_BACKBONE_HASH3D;
  if (hashed && (levels < 2 || levels > ERN_GRID_MAX_LEVELS))
    return ern_fail(context, ERN_E_ARGUMENT, "model: levels is %d, expected 2 to %d", levels, ERN_GRID_MAX_LEVELS);
  if (!hashed && levels != only)
    return ern_fail(context, ERN_E_ARGUMENT, "model: levels is %d, but the backbone %s has no levels to choose", levels,
                    ern_backbone_name(config->backbone));
  return ERN_OK;
}

static ern_status check(ern_context *context, const struct ern_model_config *config) {
  ern_status status = check_kinds(context, config);
  if (status == ERN_OK) status = check_levels(context, config);
  if (status != ERN_OK) return status;
  if (config->feature_width < 1 || config->feature_width > 4096)
    return ern_fail(context, ERN_E_ARGUMENT, "model: feature width is %d, expected 1 to 4096", config->feature_width);
  if (config->window_length < 0 || config->window_length > 16)
    return ern_fail(context, ERN_E_ARGUMENT, "model: window length is %d, expected 1 to 16, or 0 where it is not known",
                    config->window_length);
  if (config->codes < 0 || config->codes > 1000000)
    return ern_fail(context, ERN_E_ARGUMENT, "model: individual codes are %d, expected 0 to 1000000", config->codes);
  if (!((double)config->bound >= ERN_BOUND_LEAST && (double)config->bound <= ERN_BOUND_MOST))
    return ern_fail(context, ERN_E_ARGUMENT, "model: bound is %g, expected %g to %g", (double)config->bound,
                    ERN_BOUND_LEAST, ERN_BOUND_MOST);
  return ERN_OK;
}

ern_status ern_parameters_build(ern_context *context, const struct ern_model_config *config, struct ern_field *field,
                                struct ern_parameter_table *table) {
  *field = (struct ern_field){.config = *config};
  *table = (struct ern_parameter_table){.rows = 0};
  ern_status status = check(context, config);
  if (status == ERN_OK && config->head) status = add_head(field, table);
  if (status == ERN_OK && config->torso) status = add_torso(field, table);
  return status;
}

const struct ern_parameter *ern_parameters_find(const struct ern_parameter_table *table, const char *name) {
  for (int i = 0; i < table->rows; i++)
    if (strcmp(table->row[i].name, name) == 0) return &table->row[i];
  return NULL;
}

/* Box and Muller: one standard normal number from two uniform ones. */
static float normal(uint32_t a, uint32_t b) {
  const double u = ((double)a + 1.0) / 4294967296.0, angle = 6.283185307179586 * (double)b / 4294967296.0;
  return (float)(sqrt(-2.0 * log(u)) * cos(angle));
}

void ern_parameters_init(float *block, const struct ern_parameter_table *table, bool torso, uint64_t seed) {
  static const float anchors[12] = {0.01f, 0.01f, 0.1f, 1, -0.1f, -0.1f, 0.1f, 1, 0.1f, -0.1f, 0.1f, 1};
  for (int r = 0; r < table->rows; r++) {
    const struct ern_parameter *row = &table->row[r];
    if (row->torso != torso) continue;
    for (size_t i = 0; i < row->count; i++) {
      const struct ern_random random = ern_random_at(seed, (uint64_t)r, (uint32_t)i, ERN_RNG_INIT);
      switch (row->init) {
        case ERN_INIT_UNIFORM: block[row->at + i] = row->range * (2 * ern_uniform(random.word[0]) - 1); break;
        case ERN_INIT_NORMAL: block[row->at + i] = row->range * normal(random.word[0], random.word[1]); break;
        case ERN_INIT_ANCHORS: block[row->at + i] = anchors[i]; break;
        case ERN_INIT_ONE: block[row->at + i] = 1; break;
      }
    }
  }
}
