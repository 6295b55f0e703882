/* SPDX-License-Identifier: MIT */
#include "backend_cpu/fused/frame_net.h"

#include <string.h>

#include "backend_cpu/fused/pack_pairs.h"
#include "core/memory.h"

bool ern_frame_net_fits(const struct ern_field *field) { return ern_field_is_standard(field); }

/* ---- grids ------------------------------------------------------------------------------------------------------- */

static size_t dense_count(const struct ern_grid *grid) {
  size_t count = 0;
  for (int l = 0; l < grid->levels; l++) {
    const size_t side = (size_t)grid->level[l].resolution + 1;
    count += side * side;
  }
  return count;
}

/* value (c0, c1) = table[index(c0, c1)]: dense while that fits, else the hash (docs/maths.md, Tri-plane hash grids) */
static void unhash_level(float *value, const float *table, const struct ern_grid *grid,
                         const struct ern_grid_level *level) {
  const uint32_t side = level->resolution + 1, prime = 2654435761u;
  const float *entry = table + level->offset;
  const bool dense = (uint64_t)side * side <= level->size;
  for (uint32_t c1 = 0; c1 < side; c1++, value += side) {
    for (uint32_t c0 = 0; c0 < side; c0++) {
      const uint32_t index = !dense && grid->hashed ? c0 ^ c1 * prime : c0 + c1 * side;
      value[c0] = entry[index % level->size];
    }
  }
}

static float *unhash(struct ern_frame_net *net, const struct ern_field *field, const float *parameters, float *memory) {
  for (int plane = 0; plane < ERN_PLANES; plane++) {
    const struct ern_grid *grid = &field->encoder.grid[plane];
    for (int d = 0; d < 2; d++) net->axis[plane][d] = field->encoder.axis[plane][d];
    for (int l = 0; l < grid->levels; l++) {
      const struct ern_grid_level *level = &grid->level[l];
      const uint32_t side = level->resolution + 1;
      unhash_level(memory, parameters + field->encoder.table[plane], grid, level);
      net->level[plane][l] = (struct ern_dense_level){level->scale, side, memory};
      memory += (size_t)side * side;
    }
  }
  return memory;
}

/* ---- weights ----------------------------------------------------------------------------------------------------- */

static const float *layer(const struct ern_mlp *mlp, const float *parameters, int l) {
  return parameters + mlp->weight[l];
}

/* out [rows][columns] = A [rows][count] diag(scale) B [count][columns]; scale NULL: ones. Row-major, A's rows `a_row`
 * apart. */
static void multiply(float *out, const float *a, size_t a_row, const float *scale, const float *b, size_t rows,
                     size_t count, size_t columns) {
  for (size_t r = 0; r < rows; r++) {
    float *to = out + r * columns;
    memset(to, 0, columns * sizeof *to);
    for (size_t k = 0; k < count; k++) {
      const float factor = a[r * a_row + k] * (scale != NULL ? scale[k] : 1);
      for (size_t c = 0; c < columns; c++) to[c] += factor * b[k * columns + c];
    }
  }
}

/* Packed columns of n inputs, and of all of the density's inputs. */
static size_t rows_padded(const struct ern_frame_net *net, size_t n) { return net->pairs ? ern_pairs(n) : n; }
static size_t density_rows(const struct ern_frame_net *net) {
  return rows_padded(net, net->features) + rows_padded(net, net->attention) + net->eye;
}

/* Packs A [rows][columns], rows `row_step` apart, as the columns from `at` on of a layer with `width` columns. */
static void pack_part(const struct ern_frame_net *net, float *packed, size_t width, size_t at, const float *a,
                      size_t row_step, size_t rows, size_t columns) {
  if (net->pairs)
    ern_pack_pairs(packed, width, at, a, row_step, rows, columns);
  else
    ern_pack_columns(packed, width, at, a, row_step, 1, rows, columns);
}
static void pack(const struct ern_frame_net *net, float *packed, const float *w, size_t rows, size_t columns) {
  pack_part(net, packed, rows_padded(net, columns), 0, w, columns, rows, columns);
}

/* The inputs of the colour's first layer are [SH, geometry, code]; the outputs of the density's last layer are [log
 * sigma, geometry]. */
static void pack_model(struct ern_frame_net *net, const struct ern_field *field, const float *parameters) {
  const size_t wide = (size_t)field->density.width[0], inputs = (size_t)field->colour.width[0];
  const float *last = layer(&field->density, parameters, 2), *first = layer(&field->colour, parameters, 0);
  pack(net, net->attention1, layer(&field->attention, parameters, 0), net->attention, net->features);
  pack(net, net->value, layer(&field->attention, parameters, 1), net->value_rows, net->attention);
  if (net->eye) {
    pack(net, net->eye1, layer(&field->eye, parameters, 0), net->eye_hidden, net->features);
    pack(net, net->eye2, layer(&field->eye, parameters, 1), 1, net->eye_hidden);
  }
  const size_t columns_padded = density_rows(net);
  const float *density = layer(&field->density, parameters, 0);
  pack_part(net, net->density1, columns_padded, 0, density, wide, net->density, net->features);
  if (net->eye)
    pack_part(net, net->density1, columns_padded, columns_padded - 1, density + net->features + net->value_rows, wide,
              net->density, 1);
  pack(net, net->density2, layer(&field->density, parameters, 1), net->density, net->density);
  pack(net, net->sigma, last, 1, net->density);
  multiply(net->folded, first + net->harmonics, inputs, NULL, last + net->density, net->colour, ERN_GEOMETRY,
           net->density);
  pack(net, net->colour1, net->folded, net->colour, net->density);
  if (net->harmonics > 0) ern_pack_columns(net->ray, net->harmonics, 0, first, inputs, 1, net->colour, net->harmonics);
  pack(net, net->colour2, layer(&field->colour, parameters, 1), 3, net->colour);
}

void ern_frame_net_fold(struct ern_frame_net *net, const struct ern_field *field, const float *parameters,
                        const float *code, float eye_value, size_t individual) {
  const size_t wide = (size_t)field->density.width[0], inputs = (size_t)field->colour.width[0];
  net->eye_value = eye_value;
  multiply(net->folded, layer(&field->density, parameters, 0) + net->features, wide, code,
           layer(&field->attention, parameters, 1), net->density, net->value_rows, net->attention);
  pack_part(net, net->density1, density_rows(net), rows_padded(net, net->features), net->folded, net->attention,
            net->density, net->attention);
  memset(net->code, 0, net->colour * sizeof *net->code);
  if (field->config.codes == 0) return;
  const float *own = parameters + field->codes + individual * ERN_CODE_WIDTH;
  const float *first = layer(&field->colour, parameters, 0) + net->harmonics + ERN_GEOMETRY;
  for (size_t r = 0; r < net->colour; r++)
    for (size_t c = 0; c < ERN_CODE_WIDTH; c++) net->code[r] += first[r * inputs + c] * own[c];
}

/* ---- making ------------------------------------------------------------------------------------------------------ */

struct part {
  float **at;
  size_t count;
};

static size_t parts_of(struct ern_frame_net *net, struct part part[12]) {
  const size_t features = rows_padded(net, net->features), hidden = rows_padded(net, net->attention);
  const size_t density = rows_padded(net, net->density), eye_hidden = rows_padded(net, net->eye_hidden);
  const struct part all[] = {
      {&net->attention1, ern_pack_count(net->attention, features)},
      {&net->eye1, ern_pack_count(net->eye_hidden, features)},
      {&net->eye2, ern_pack_count(net->eye, eye_hidden)},
      {&net->value, ern_pack_count(net->value_rows, hidden)},
      {&net->density1, ern_pack_count(net->density, density_rows(net))},
      {&net->density2, ern_pack_count(net->density, density)},
      {&net->sigma, ern_pack_count(1, density)},
      {&net->colour1, ern_pack_count(net->colour, density)},
      {&net->ray, ern_pack_count(net->colour, net->harmonics)},
      {&net->colour2, ern_pack_count(3, rows_padded(net, net->colour))},
      {&net->code, ern_pack_count(net->colour, 1)},
      {&net->folded, ern_pack_count(net->density > net->colour ? net->density : net->colour,
                                    net->density > net->attention ? net->density : net->attention)},
  };
  memcpy(part, all, sizeof all);
  return sizeof all / sizeof *all;
}

static void set_widths(struct ern_frame_net *net, const struct ern_field *field) {
  net->levels = field->config.levels;
  net->bound = field->config.bound;
  net->fades = ern_field_fades(field);
  memcpy(net->fade, field->config.voice_fade, sizeof net->fade);
  net->eye = field->config.eye;
  net->features = (size_t)field->feature_rows;
  net->attention = (size_t)field->attention.width[1];
  net->value_rows = (size_t)field->attention.width[2];
  net->eye_hidden = net->eye ? (size_t)field->eye.width[1] : 0;
  net->density = (size_t)field->density.width[1];
  net->harmonics = (size_t)ern_field_view_rows(field);
  net->colour = (size_t)field->colour.width[1];
}

ern_status ern_frame_net_make(ern_context *context, const struct ern_field *field, const float *parameters, bool pairs,
                              struct ern_frame_net **net) {
  struct ern_frame_net *made = NULL;
  *net = NULL;
  ern_status status = ERN_NEW(context, 1, &made);
  if (status != ERN_OK) return status;
  set_widths(made, field);
  made->pairs = pairs;
  struct part part[12];
  const size_t parts = parts_of(made, part);
  size_t count = 0;
  for (size_t i = 0; i < parts; i++) count += (part[i].count + 15) / 16 * 16;
  for (int plane = 0; plane < ERN_PLANES; plane++) count += dense_count(&field->encoder.grid[plane]);
  status = ERN_NEW(context, count, &made->memory);
  if (status != ERN_OK) {
    ern_release(context, made);
    return status;
  }
  float *at = made->memory;
  for (size_t i = 0; i < parts; i++) {
    *part[i].at = at;
    at += (part[i].count + 15) / 16 * 16;
  }
  unhash(made, field, parameters, at);
  pack_model(made, field, parameters);
  *net = made;
  return ERN_OK;
}

void ern_frame_net_free(ern_context *context, struct ern_frame_net *net) {
  if (net == NULL) return;
  ern_release(context, net->memory);
  ern_release(context, net);
}
