/* SPDX-License-Identifier: MIT
 * The scene of the benchmarks: a user's model, or a synthetic one with the cost of a lightly trained portrait: position
 * and number of samples, and the sample at which the transmittance is used up. */
#include <math.h>
#include <string.h>

#include "backend_cpu/backend_cpu.h"
#include "core/floats.h"
#include "core/memory.h"
#include "core/rng.h"
#include "core/status.h"
#include "lab/bench/bench_shared.h"
#include "model/head.h"
#include "model/torso_ops.h"
#include "render/frame_input.h"
#include "render/morton.h"
#include "render/stages.h"

enum {
  MADE_LEVELS = 14,
  MADE_FEATURES = 29, /* DeepSpeech */
  MADE_WINDOW = 16,
  MADE_CODES = 8,
  CELLS = 128,
  TILE = 1 << 13, /* pixels processed in one batch */
  MAX_SIDE = 8192
};

/* The head is a shell about the ellipsoid q = (x/a)^2 + (y/b)^2 + (z/c)^2 = 1, log density HEIGHT - SLOPE |1 - q|.
 * Chosen so that 450 x 450 pixels give about 2.7 samples a pixel, 90 % of them before the transmittance is used up. */
static const float semi_axis[3] = {0.42f, 0.38f, 0.32f};
static const float shell_height = 5.1f, shell_slope = 24;

/* ---- the density ------------------------------------------------------------------------------------------------- */

/* Writes value(c0, c1) into the first level of a plane, which is dense: cell c is at u = (c - 0.5)/scale. */
static void fill_level(float *table, const struct ern_grid *grid, const float a[2], float constant) {
  const struct ern_grid_level *level = &grid->level[0];
  const uint32_t side = level->resolution + 1;
  for (uint32_t c1 = 0; c1 < side; c1++)
    for (uint32_t c0 = 0; c0 < side; c0++) {
      const float x0 = 2 * ((float)c0 - 0.5f) / level->scale - 1, x1 = 2 * ((float)c1 - 0.5f) / level->scale - 1;
      table[level->offset + c0 + c1 * side] = constant - a[0] * x0 * x0 - a[1] * x1 * x1;
    }
}

static void clear_row(float *weights, int columns, int row) {
  for (int c = 0; c < columns; c++) weights[row * columns + c] = 0;
}

/* Three hidden units carry 1 - q, q - 1 and 1 to the density; the other 61 keep their random weights. */
static void shape_density(float *block, const struct ern_field *field) {
  const int levels = field->config.levels, ins = field->density.width[0], hidden = field->density.width[1];
  const float s[3] = {1 / (semi_axis[0] * semi_axis[0]), 1 / (semi_axis[1] * semi_axis[1]),
                      1 / (semi_axis[2] * semi_axis[2])};
  fill_level(block + field->encoder.table[0], &field->encoder.grid[0], (const float[]){s[0], s[1]}, 1); /* xy */
  fill_level(block + field->encoder.table[1], &field->encoder.grid[1], (const float[]){0, 0}, 1);       /* yz */
  fill_level(block + field->encoder.table[2], &field->encoder.grid[2], (const float[]){0, s[2]}, 0);    /* xz */
  float *first = block + field->density.weight[0], *second = block + field->density.weight[1],
        *last = block + field->density.weight[2];
  for (int row = 0; row < 3; row++) {
    clear_row(first, ins, row);
    clear_row(second, hidden, row);
    second[row * hidden + row] = 1;
  }
  first[0] = first[2 * levels] = 1;
  first[ins] = first[ins + 2 * levels] = -1;
  first[2 * ins + levels] = 1;
  clear_row(last, hidden, 0);
  last[0] = last[1] = -shell_slope;
  last[2] = shell_height;
}

/* Marks the cells that a refresh would mark: density above min(mean over all cells, 10), dilated by one cell as by its
 * maximum over neighbours. */
static void shape_occupancy(uint8_t *bits) {
  const float grown = 2.0f / CELLS;
  double mean = 0;
  for (int pass = 0; pass < 2; pass++) {
    const float threshold = (float)fmin(mean / ERN_OCCUPANCY_CELLS, 10);
    for (uint32_t cell = 0; cell < ERN_OCCUPANCY_CELLS; cell++) {
      const uint32_t c[3] = {ern_morton_gather(cell), ern_morton_gather(cell >> 1), ern_morton_gather(cell >> 2)};
      float q = 0;
      float slope = 0;
      for (int axis = 0; axis < 3; axis++) {
        const float x = 2 * ((float)c[axis] + 0.5f) / CELLS - 1, a = semi_axis[axis];
        q += x * x / (a * a);
        slope = fmaxf(slope, 2 * fabsf(x) / (a * a));
      }
      const float away = fmaxf(fabsf(1 - q) - slope * grown, 0); /* of the nearest neighbour */
      const float sigma = expf(shell_height - shell_slope * away);
      if (pass == 0)
        mean += (double)sigma;
      else if (sigma > threshold)
        bits[cell / 8] = (uint8_t)(bits[cell / 8] | 1u << cell % 8);
    }
  }
}

static ern_status make_model(ern_context *context, uint64_t seed, ern_model **model) {
  const struct ern_model_config config = {.levels = MADE_LEVELS,
                                          .feature_width = MADE_FEATURES,
                                          .window_length = MADE_WINDOW,
                                          .head = true,
                                          .eye = true,
                                          .torso = true,
                                          .codes = MADE_CODES,
                                          .bound = 1};
  const ern_status status = ern_model_make(model, context, &config);
  if (status != ERN_OK) return status;
  const struct ern_field *field = &(*model)->field;
  float *block = (*model)->block;
  ern_parameters_init(block, &(*model)->table, false, seed);
  ern_parameters_init(block, &(*model)->table, true, seed);
  for (int p = 0; p < ERN_PLANES; p++) /* from 1e-4, the initial scale, to the scale of a trained model */
    for (size_t i = 0; i < field->encoder.grid[p].entries; i++) block[field->encoder.table[p] + i] *= 1e3f;
  shape_density(block, field);
  shape_occupancy((*model)->bits);
  memset((*model)->clip, '0', sizeof(*model)->clip - 1); /* a placeholder identity: no code checks its clip */
  /* the torso: the lower third, from left to right */
  for (size_t c = 0; c < ERN_TORSO_SIDE; c++)
    for (size_t r = ERN_TORSO_SIDE * 2 / 3; r < ERN_TORSO_SIDE; r++)
      (*model)->torso_grid[c * ERN_TORSO_SIDE + r] = 0.9f;
  return ERN_OK;
}

/* ---- the frame --------------------------------------------------------------------------------------------------- */

/* A front view at the distance and focal length of a clip: the picture is 1.5 wide at the head. */
static ern_camera front_camera(int width, int height) {
  return (ern_camera){.pose = {0, -1, 0, 0, 0, 0, -1, 3.6f, 1, 0, 0, 0, 0, 0, 0, 1},
                      .focal = 2.4f * (float)height,
                      .cx = (float)width / 2,
                      .cy = (float)height / 2,
                      .width = width,
                      .height = height};
}

static ern_status make_frame(struct ern_bench_scene *scene, int width, int height, uint64_t seed) {
  const size_t pixels = (size_t)width * (size_t)height,
               values = (size_t)ERN_AUDIO_WINDOWS * MADE_WINDOW * MADE_FEATURES;
  scene->memory = ern_allocate(scene->context, values * sizeof(float) + 6 * pixels, 1);
  if (scene->memory == NULL) return ERN_E_NO_MEMORY;
  float *windows = scene->memory;
  uint8_t *background = (uint8_t *)(windows + values), *truth = background + 3 * pixels;
  for (size_t i = 0; i < values; i++)
    windows[i] = 2 * ern_uniform(ern_random_at(seed, 1, (uint32_t)i, ERN_RNG_INIT).word[0]) - 1;
  for (size_t i = 0; i < 3 * pixels; i++) {
    background[i] = (uint8_t)(i / 3 % (size_t)width * 200 / (size_t)width);
    truth[i] = (uint8_t)(255 - i / 3 / (size_t)width * 200 / (size_t)height);
  }
  scene->frame = (ern_frame_input){.camera = front_camera(width, height),
                                   .windows = windows,
                                   .window_length = MADE_WINDOW,
                                   .eye = 0.25f,
                                   .background = background};
  scene->truth = truth;
  scene->face = (ern_box){height / 4, height * 3 / 4, width / 4, width * 3 / 4};
  return ERN_OK;
}

ern_status ern_bench_scene_make(ern_bench_scene **scene, ern_context *context, int width, int height, uint64_t seed) {
  ERN_PLAIN_FLOATS;
  if (scene != NULL) *scene = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, scene);
  struct ern_bench_scene *made = NULL;
  ern_status status = ERN_OK;
  if (width < 1 || width > MAX_SIDE || height < 1 || height > MAX_SIDE)
    return ern_fail(context, ERN_E_ARGUMENT, "bench: the size is %d x %d, expected 1 to %d a side", width, height,
                    MAX_SIDE);
  ERN_TRY(ERN_NEW(context, 1, &made));
  made->context = context;
  made->made_up = true;
  ERN_TRY(make_model(context, seed, &made->own));
  made->model = made->own;
  ERN_TRY(make_frame(made, width, height, seed));
  *scene = made;
  return ERN_OK;
fail:
  ern_bench_scene_free(&made);
  return status;
}

ern_status ern_bench_scene_of(ern_bench_scene **scene, ern_context *context, const ern_model *model,
                              const ern_frame_input *frame, const uint8_t *truth, const ern_box *face) {
  ERN_PLAIN_FLOATS;
  if (scene != NULL) *scene = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, scene);
  ERN_NEED(context, model);
  ERN_NEED(context, frame);
  ERN_NEED(context, truth);
  ERN_NEED(context, frame->background);
  struct ern_bench_scene *made = NULL;
  const ern_camera *camera = &frame->camera;
  ern_status status = ern_frame_input_check(context, &model->field, frame);
  if (status != ERN_OK) return status;
  if (!ern_field_is_standard(&model->field))
    return ern_fail(
        context, ERN_E_UNSUPPORTED,
        "bench: the head is of backbone %s, attention %s; expected trihash and channel, whose arithmetic is "
        "counted",
        ern_backbone_name(model->field.config.backbone), ern_attention_name(model->field.config.attention));
  status = ERN_NEW(context, 1, &made);
  if (status != ERN_OK) return status;
  *made = (struct ern_bench_scene){.context = context,
                                   .model = model,
                                   .frame = *frame,
                                   .truth = truth,
                                   .face = face != NULL ? *face : (ern_box){0, camera->height, 0, camera->width}};
  *scene = made;
  return ERN_OK;
}

void ern_bench_scene_free(ern_bench_scene **scene) {
  if (scene == NULL || *scene == NULL) return;
  struct ern_bench_scene *made = *scene;
  *scene = NULL;
  ern_model_free(&made->own);
  ern_release(made->context, made->memory);
  ern_release(made->context, made);
}

/* ---- what is in it ----------------------------------------------------------------------------------------------- */

/* The scene on a backend, while its samples are counted. */
struct count {
  struct ern_stream *stream;
  struct ern_buffer *reals, *bytes, *numbers;
  struct ern_head_inputs in;
  ern_span bits, code;
  float *sigma, *dt; /* [16 TILE]; sigma begins the block of all three */
  int32_t *first;    /* [TILE + 1] */
};

static void free_count(struct ern_backend *backend, struct count *count) {
  ern_release(backend->context, count->sigma);
  backend->buffer_free(backend, count->reals);
  backend->buffer_free(backend, count->bytes);
  backend->buffer_free(backend, count->numbers);
  backend->stream_free(count->stream);
}

enum { COUNT_STEPS = 16 };

static ern_status make_count(const struct ern_bench_scene *scene, struct ern_backend *backend, int threads,
                             struct count *count) {
  const struct ern_model *model = scene->model;
  const size_t n = model->field.parameters, at = (n + 63) / 64 * 64,
               windows = (size_t)ERN_AUDIO_WINDOWS * (size_t)scene->frame.window_length *
                         (size_t)model->field.config.feature_width;
  ern_status status = ERN_OK;
  *count = (struct count){0};
  ERN_TRY(backend->stream_make(backend, threads, &count->stream));
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, at + 64 + windows, &count->reals));
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_BYTE, ERN_OCCUPANCY_BYTES, &count->bytes));
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_INT32, TILE, &count->numbers));
  ERN_TRY(ERN_NEW(backend->context, (size_t)TILE * (2 * COUNT_STEPS + 1) + 1, &count->sigma));
  count->dt = count->sigma + (size_t)TILE * COUNT_STEPS;
  count->first = (int32_t *)(count->dt + (size_t)TILE * COUNT_STEPS);
  count->bits = (ern_span){count->bytes, 0, ERN_OCCUPANCY_BYTES};
  count->in = (struct ern_head_inputs){.field = &model->field,
                                       .parameters = {count->reals, 0, n},
                                       .code = {count->reals, at, ERN_AUDIO_CODE},
                                       .eye = scene->frame.eye};
  struct ern_audio_fwd_args audio = {.code = count->in.code,
                                     .windows = {count->reals, at + 64, windows},
                                     .parameters = count->in.parameters,
                                     .net = model->field.audio};
  audio.net.window_length = scene->frame.window_length;
  ERN_TRY(backend->upload_reals(count->stream, count->in.parameters, model->block, n));
  ERN_TRY(backend->upload_bytes(count->stream, count->bits, model->bits, ERN_OCCUPANCY_BYTES));
  ERN_TRY(backend->upload_reals(count->stream, audio.windows, scene->frame.windows, windows));
  ERN_TRY(backend->audio_fwd(count->stream, &audio));
fail:
  return status;
}

/* The composite's rule: samples until the transmittance is below 1e-4. */
static size_t lit_samples(const struct count *count, size_t rays, size_t *hits) {
  size_t lit = 0;
  for (size_t r = 0; r < rays; r++) {
    double light = 1;
    *hits += count->first[r + 1] > count->first[r];
    for (int32_t i = count->first[r]; i < count->first[r + 1] && light >= 1e-4; i++, lit++)
      light *= exp(-(double)count->sigma[i] * (double)count->dt[i]);
  }
  return lit;
}

static ern_status count_tile(const struct ern_bench_scene *scene, struct count *count, size_t begin, size_t n,
                             ern_bench_scene_info *info) {
  struct ern_stream *stream = count->stream;
  const struct ern_backend *backend = stream->backend;
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  const struct ern_march_settings settings = {scene->model->field.config.bound, COUNT_STEPS,
                                              scene->model->view.dt_gamma, ERN_NEAR_PLANE};
  const ern_span numbers = {count->numbers, 0, n};
  const struct ern_view view = ern_bench_view(scene);
  struct ern_marched marched;
  struct ern_head_batch batch;
  ern_status status = ERN_OK;
  for (size_t i = 0; i < n; i++) count->first[i] = (int32_t)(begin + i);
  ERN_TRY(backend->upload_int32(stream, numbers, count->first, n));
  ERN_TRY(ern_march_rays(stream, numbers, &view, (ern_span){0}, count->bits, &settings, n, &marched));
  ERN_TRY(backend->download_int32(stream, count->first, marched.first, n + 1));
  if (marched.total > 0) {
    ERN_TRY(ern_head_batch_take(stream, count->in.field, marched.total, ERN_BATCH_DENSITY, &batch));
    count->in.ray = marched.ray;
    ERN_TRY(ern_head_density_fwd(stream, &count->in, marched.x, &batch));
    ERN_TRY(backend->download_reals(stream, count->sigma, batch.sigma.span, marched.total));
    ERN_TRY(backend->download_reals(stream, count->dt, marched.dt, marched.total));
  }
  info->marched += marched.total;
  info->lit += lit_samples(count, n, &info->hits);
fail:
  ern_arena_release(stream, mark);
  return status;
}

ern_status ern_bench_scene_describe(const ern_bench_scene *scene, ern_backend *backend, int threads,
                                    ern_bench_scene_info *info) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(scene != NULL ? scene->context : NULL, backend);
  ERN_NEED(backend->context, scene);
  ERN_NEED(backend->context, info);
  const ern_camera *camera = &scene->frame.camera;
  const struct ern_field *field = &scene->model->field;
  const struct ern_bench_cost written = ern_bench_cost_written(field), folded = ern_bench_cost_folded(field);
  struct count count = {0};
  size_t occupied = 0;
  ern_status status = ERN_OK;
  *info = (ern_bench_scene_info){.made_up = scene->made_up,
                                 .has_torso = field->config.torso,
                                 .width = camera->width,
                                 .height = camera->height,
                                 .levels = field->config.levels,
                                 .parameters = field->parameters,
                                 .pixels = (size_t)camera->width * (size_t)camera->height,
                                 .sample_flops = written.density + written.colour,
                                 .folded_flops = folded.density + folded.colour};
  for (size_t i = 0; i < ERN_OCCUPANCY_BYTES; i++) occupied += (size_t)__builtin_popcount(scene->model->bits[i]);
  info->occupied = (double)occupied / ERN_OCCUPANCY_CELLS;
  ERN_TRY(make_count(scene, backend, threads, &count));
  for (size_t begin = 0; begin < info->pixels; begin += TILE) {
    const size_t left = info->pixels - begin;
    ERN_TRY(count_tile(scene, &count, begin, left < TILE ? left : TILE, info));
  }
fail:
  free_count(backend, &count);
  return status;
}

ern_status ern_bench_scene_count(const struct ern_bench_scene *scene, ern_bench_scene_info *info) {
  static const ern_isa fast[] = {ERN_ISA_AVX512, ERN_ISA_AVX2, ERN_ISA_NEON};
  struct ern_backend *cpu = NULL;
  ern_isa isa = ERN_ISA_REF;
  for (size_t i = 0; i < sizeof fast / sizeof *fast && isa == ERN_ISA_REF; i++)
    if (ern_isa_available(fast[i])) isa = fast[i];
  ern_status status = ern_cpu_backend_make(scene->context, isa, &cpu);
  if (status == ERN_OK) status = ern_bench_scene_describe(scene, cpu, 0, info);
  ern_backend_free(&cpu);
  return status;
}
