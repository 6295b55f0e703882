/* SPDX-License-Identifier: MIT
 * Training data of a step: one or several frames, each with its speech and random rays.
 *
 * The rays are sorted by tiles of the picture: rays of a tile pass through the same cells, so the table entries that
 * they read and update stay in the cache. The choice of rays does not depend on it. */
#include "train/parts/trainer_batch.h"

#include "core/memory.h"
#include "core/rng.h"
#include "core/status.h"
#include "train/parts/trainer_data.h"

/* ---- rays -------------------------------------------------------------------------------------------------------- */

enum {
  MOST_TILES = 4096, /* of a picture */
  LEAST_TILE = 16,   /* pixels a side */
  HOST_ROWS = 9      /* of host_rows */
};

/* The part inside the picture of a box in which a share of the rays is drawn; width 0: empty. */
struct region {
  uint32_t left, top, width, height;
};

/* The pixels of a frame for whose value in draw->head `has` returns true. */
struct part {
  bool (*has)(uint8_t of_head);
  uint32_t *above; /* [height + 1]: how many lie above a row; NULL: not counted */
};

/* A batch while it is drawn. */
struct draw {
  const struct ern_training *t;
  const struct ern_trainer_batches *b;
  uint64_t step;
  size_t first, rays;           /* range within the step */
  size_t stride;                /* of a row of host_rows */
  const uint8_t *truth, *torso; /* torso NULL: none */
  const uint8_t *head;          /* as of ern_dataset.head; NULL: not known, or not asked for */
  const ern_dataset_frame *about;
  struct region lower_face, eyes, dubbed;
  struct part silhouette, whole_head;
  uint32_t side, across, tiles; /* of a tile; tiles a row, in all */
  int32_t *pixel;               /* [rays], as drawn */
  float *jitter;
  int32_t *place;  /* [tiles][ERN_SHARDS]: number of rays of a tile that a shard drew, then their destinations */
  float part[256]; /* n/255 */
};

struct range {
  size_t begin, end;
};
static struct range range_of(const struct draw *draw, size_t shard) {
  return (struct range){draw->rays * shard / ERN_SHARDS, draw->rays * (shard + 1) / ERN_SHARDS};
}

static uint32_t tile_of(const struct draw *draw, int32_t pixel) {
  const uint32_t width = (uint32_t)draw->t->data.width, row = (uint32_t)pixel / width;
  return row / draw->side * draw->across + ((uint32_t)pixel - row * width) / draw->side;
}

static struct region region_of(const struct ern_training *t, const ern_box *box) {
  const int left = box->left > 0 ? box->left : 0, right = box->right < t->data.width ? box->right : t->data.width;
  const int top = box->top > 0 ? box->top : 0, bottom = box->bottom < t->data.height ? box->bottom : t->data.height;
  if (left >= right || top >= bottom) return (struct region){0};
  return (struct region){(uint32_t)left, (uint32_t)top, (uint32_t)(right - left), (uint32_t)(bottom - top)};
}

static void find_regions(struct draw *draw) {
  const struct ern_training *t = draw->t;
  if (t->config.torso || t->config.ray_sampling == ERN_RAY_SAMPLING_UNIFORM) return;
  draw->lower_face = region_of(t, &draw->about->lower_face);
  if (t->config.ray_sampling == ERN_RAY_SAMPLING_DUB)
    draw->dubbed = region_of(t, &draw->about->dubbed);
  else if (t->data.has_eye)
    draw->eyes = region_of(t, &draw->about->eyes);
}

static bool is_known(uint8_t of_head) { return of_head == 0 || of_head == 255; }

static bool is_silhouette(uint8_t of_head) { return !is_known(of_head); }
static bool is_head(uint8_t of_head) { return of_head != 0; }

static ern_status find_parts(struct draw *draw) {
  const struct ern_training *t = draw->t;
  const size_t width = (size_t)t->data.width, height = (size_t)t->data.height;
  ern_status status = ERN_OK;
  if (draw->head == NULL || t->config.ray_sampling != ERN_RAY_SAMPLING_REGIONS) return ERN_OK;
  ERN_TRY(ERN_NEW(t->context, height + 1, &draw->silhouette.above));
  ERN_TRY(ERN_NEW(t->context, height + 1, &draw->whole_head.above));
  for (size_t row = 0; row < height; row++) { /* runs over all pixels at each step: without a call for each */
    const uint8_t *head = draw->head + row * width;
    uint32_t silhouette = 0, whole_head = 0;
    for (size_t column = 0; column < width; column++) {
      silhouette += is_silhouette(head[column]);
      whole_head += is_head(head[column]);
    }
    draw->silhouette.above[row + 1] = draw->silhouette.above[row] + silhouette;
    draw->whole_head.above[row + 1] = draw->whole_head.above[row] + whole_head;
  }
fail:
  return status;
}

/* Pixel number `place` of the part, in the order of the picture. */
static int32_t pixel_of_part(const struct draw *draw, const struct part *part, uint32_t place) {
  const uint32_t width = (uint32_t)draw->t->data.width;
  uint32_t row = 0, end = (uint32_t)draw->t->data.height;
  while (end - row > 1) {
    const uint32_t middle = row + (end - row) / 2;
    if (part->above[middle] <= place)
      row = middle;
    else
      end = middle;
  }
  const uint8_t *head = draw->head + (size_t)row * width;
  uint32_t left = place - part->above[row], column = 0;
  while (!part->has(head[column]) || left-- > 0) column++;
  return (int32_t)(row * width + column);
}

static const struct region *region_at(const struct draw *draw, float at) {
  if (draw->t->config.ray_sampling == ERN_RAY_SAMPLING_DUB)
    return at < ERN_DUB_LOWER_FACE_SHARE                      ? &draw->lower_face
           : at < ERN_DUB_LOWER_FACE_SHARE + ERN_DUBBED_SHARE ? &draw->dubbed
                                                              : NULL;
  return at < ERN_LOWER_FACE_SHARE ? &draw->lower_face : at >= 1 - ERN_EYES_SHARE ? &draw->eyes : NULL;
}

/* word[2] chooses the region, so that a missing region does not change the rays of the others. */
static int32_t draw_pixel(const struct draw *draw, const struct ern_random *random) {
  const uint32_t width = (uint32_t)draw->t->data.width, height = (uint32_t)draw->t->data.height;
  const float at = ern_uniform(random->word[2]);
  const float eyes = 1 - ERN_EYES_SHARE, silhouette = eyes - ERN_SILHOUETTE_SHARE;
  const struct part *part = at >= eyes                          ? NULL
                            : at >= silhouette                  ? &draw->silhouette
                            : at >= silhouette - ERN_HEAD_SHARE ? &draw->whole_head
                                                                : NULL;
  if (part != NULL && part->above != NULL && part->above[height] > 0)
    return pixel_of_part(draw, part, ern_below(random->word[0], part->above[height]));
  const struct region *in = region_at(draw, at);
  if (in == NULL || in->width == 0) return (int32_t)ern_below(random->word[0], width * height);
  const uint32_t place = ern_below(random->word[0], in->width * in->height);
  return (int32_t)((in->top + place / in->width) * width + in->left + place % in->width);
}

static void draw_task(void *user, size_t shard, int worker) {
  (void)worker;
  const struct draw *draw = user;
  const struct ern_training *t = draw->t;
  const struct range p = range_of(draw, shard);
  for (uint32_t tile = 0; tile < draw->tiles; tile++) draw->place[tile * ERN_SHARDS + shard] = 0;
  for (size_t i = p.begin; i < p.end; i++) {
    const struct ern_random random =
        ern_random_at(t->config.seed, draw->step, (uint32_t)(draw->first + i), ERN_RNG_PIXEL);
    draw->pixel[i] = draw_pixel(draw, &random);
    draw->jitter[i] = ern_uniform(random.word[1]);
    draw->place[tile_of(draw, draw->pixel[i]) * ERN_SHARDS + shard]++;
  }
}

static bool lies_in(ern_box box, int row, int column) {
  return row >= box.top && row < box.bottom && column >= box.left && column < box.right;
}

/* Channel c of the torso image over `back`; `back` where there is no image. */
static float over_torso(const struct draw *draw, size_t pixel, size_t c, float back) {
  if (draw->torso == NULL) return back;
  const float alpha = draw->part[draw->torso[4 * pixel + 3]];
  return draw->part[draw->torso[4 * pixel + c]] * alpha + back * (1 - alpha);
}

/* Rows of host_rows for ray i: the torso image over the background is the head's background and the torso's target.
 * With a fixed background, any opacity has a colour that reproduces the recorded picture; with random backgrounds only
 * the true opacity does. The torso image tells whether the opacity is 0 or 1 for a torso, draw->head for a head. */
static void fill_ray(const struct draw *draw, size_t i, size_t pixel) {
  const float *part = draw->part;
  const struct ern_training *t = draw->t;
  const ern_dataset_frame *about = draw->about;
  const size_t stride = draw->stride, width = (size_t)t->data.width;
  const int row = (int)(pixel / width), column = (int)(pixel % width);
  const uint8_t of_head = draw->head != NULL ? draw->head[pixel] : 128;
  const bool any =
      t->config.torso ? t->config.torso_random_background : t->config.head_random_background && is_known(of_head);
  struct ern_random colour = {{0}};
  if (any) colour = ern_random_at(t->config.seed, draw->step, (uint32_t)(draw->first + i), ERN_RNG_BACKGROUND);
  for (size_t c = 0; c < 3; c++) {
    const float random = ern_uniform(colour.word[c]), clip = part[t->data.background[3 * pixel + c]];
    float *truth = &draw->b->host_rows[c * stride + i], *behind = &draw->b->host_rows[(3 + c) * stride + i];
    if (t->config.torso) {
      *behind = any ? random : clip;
      *truth = over_torso(draw, pixel, c, *behind);
    } else {
      *behind = any ? random : over_torso(draw, pixel, c, clip);
      *truth = any && of_head == 0 ? *behind : part[draw->truth[3 * pixel + c]];
    }
  }
  draw->b->host_rows[6 * stride + i] = about->has_face && row >= about->face.top && row < about->face.bottom &&
                                               column >= about->face.left && column < about->face.right
                                           ? 1
                                           : 0;
  draw->b->host_rows[8 * stride + i] = lies_in(about->lower_face, row, column) ? 0 : 1;
}

static void fill_task(void *user, size_t shard, int worker) {
  (void)worker;
  const struct draw *draw = user;
  const struct range p = range_of(draw, shard);
  for (size_t i = p.begin; i < p.end; i++) {
    const size_t to = (size_t)draw->place[tile_of(draw, draw->pixel[i]) * ERN_SHARDS + shard]++;
    draw->b->host_pixels[to] = draw->pixel[i];
    draw->b->host_rows[7 * draw->stride + to] = draw->jitter[i];
    fill_ray(draw, to, (size_t)draw->pixel[i]);
  }
}

/* Within a tile the rays keep the order in which they were drawn. */
static ern_status draw_rays(struct draw *draw) {
  const struct ern_training *t = draw->t;
  const uint32_t width = (uint32_t)t->data.width, height = (uint32_t)t->data.height;
  const size_t rays = draw->rays;
  ern_status status = ERN_OK;
  for (draw->side = LEAST_TILE;; draw->side *= 2) {
    draw->across = (width + draw->side - 1) / draw->side;
    draw->tiles = draw->across * ((height + draw->side - 1) / draw->side);
    if (draw->tiles <= MOST_TILES) break;
  }
  ERN_TRY(ERN_NEW(t->context, 2 * rays + draw->tiles * (size_t)ERN_SHARDS, &draw->pixel));
  draw->jitter = (float *)(void *)(draw->pixel + rays);
  draw->place = draw->pixel + 2 * rays;
  ern_pool_run(t->pool, ERN_SHARDS, draw_task, draw);
  int32_t next = 0;
  for (size_t i = 0; i < draw->tiles * (size_t)ERN_SHARDS; i++) {
    const int32_t count = draw->place[i];
    draw->place[i] = next;
    next += count;
  }
  ern_pool_run(t->pool, ERN_SHARDS, fill_task, draw);
fail:
  ern_release(t->context, draw->pixel);
  return status;
}

static void fill_patches_task(void *user, size_t shard, int worker) {
  (void)worker;
  const struct draw *draw = user;
  const struct ern_training *t = draw->t;
  const struct range p = range_of(draw, shard);
  for (size_t i = p.begin; i < p.end; i++) {
    const struct ern_random random =
        ern_random_at(t->config.seed, draw->step, (uint32_t)(draw->first + i), ERN_RNG_PIXEL);
    draw->b->host_rows[7 * draw->stride + i] = ern_uniform(random.word[1]);
    fill_ray(draw, i, (size_t)draw->b->host_pixels[i]);
  }
}

/* In the fine stage: draws `count` patches of the step from number `first` on. */
static void draw_patches(struct draw *draw, size_t first, size_t count) {
  ern_trainer_place_patches(draw->b->fine, draw->about, first, count, draw->b->host_pixels);
  ern_pool_run(draw->t->pool, ERN_SHARDS, fill_patches_task, draw);
}

static int uploaded_rows(const struct ern_trainer_batches *b) { return b->poses != NULL ? HOST_ROWS : HOST_ROWS - 1; }

/* All rows in one transfer: an H100 waits about 20 us for each. */
static ern_status upload(const struct ern_trainer_batches *b, struct ern_batch *batch, ern_span pixel_number,
                         ern_rows rows) {
  const struct ern_training *t = b->training;
  const size_t rays = batch->rays;
  ern_status status = ERN_OK;
  ERN_TRY(t->backend->upload_int32(t->stream, pixel_number, b->host_pixels, rays));
  ERN_TRY(t->backend->upload_reals(t->stream, rows.span, b->host_rows, rows.span.count));
  batch->pixel_number = pixel_number;
  batch->truth = ern_rows_part(rows, 0, 3);
  batch->background = ern_rows_part(rows, 3, 3);
  batch->face = ern_span_of_row(rows, 6, rays);
  batch->jitter = ern_span_of_row(rows, 7, rays);
  if (b->poses != NULL) batch->rigid = ern_span_of_row(rows, 8, rays);
fail:
  return status;
}

static ern_status upload_now(const struct ern_trainer_batches *b, struct ern_batch *batch) {
  const struct ern_training *t = b->training;
  ern_span pixel_number;
  ern_rows rows;
  ern_status status = ERN_OK;
  ERN_TRY(ern_scratch_take(t->stream, ERN_ELEMENT_INT32, batch->rays, &pixel_number));
  ERN_TRY(ern_scratch_take_rows(t->stream, uploaded_rows(b), batch->rays, &rows));
  status = upload(b, batch, pixel_number, rows);
fail:
  return status;
}

/* To memory that the step under way does not use: a device may have to repeat that step. */
static ern_status upload_ahead(struct ern_trainer_batches *b, struct ern_batch *batch) {
  const struct ern_training *t = b->training;
  const size_t stride = ern_scratch_stride(batch->rays), values = (size_t)uploaded_rows(b) * stride;
  struct ern_backend *backend = t->backend;
  ern_status status = ERN_OK;
  b->drawn.place = 1 - b->drawn.place;
  struct ern_buffer **pixels = &b->drawn.pixels[b->drawn.place], **reals = &b->drawn.reals[b->drawn.place];
  if (*pixels == NULL) ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_INT32, batch->rays, pixels));
  if (*reals == NULL) ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, values, reals));
  const ern_rows rows = {{*reals, 0, values}, stride, uploaded_rows(b), ERN_PER_SAMPLE};
  status = upload(b, batch, (ern_span){*pixels, 0, batch->rays}, rows);
fail:
  return status;
}

/* ---- a batch ----------------------------------------------------------------------------------------------------- */

/* Only a few in a hundred frames have shut eyes: too few of them would be drawn in a short training. */
static ern_status find_blinks(struct ern_trainer_batches *b) {
  const struct ern_training *t = b->training;
  const size_t frames = t->config.data_end - t->config.data_begin;
  ern_status status = ERN_OK;
  if (t->config.torso || t->config.ray_sampling != ERN_RAY_SAMPLING_REGIONS || !t->data.has_eye) return ERN_OK;
  ERN_TRY(ERN_NEW(t->context, frames, &b->blinks));
  for (size_t i = t->config.data_begin; i < t->config.data_end; i++) {
    ern_dataset_frame about;
    ERN_TRY(ern_trainer_frame(t, 0, i, &about));
    if (about.eye >= 0.5f) b->blinks[b->blink_count++] = i;
  }
fail:
  return status;
}

ern_status ern_trainer_batches_make(struct ern_trainer_batches *b, const struct ern_trainer_fine *fine,
                                    const struct ern_trainer_speech *speech, const struct ern_trainer_poses *poses) {
  const size_t rays = ern_trainer_most_rays(fine);
  ern_context *context = fine->training->context;
  ern_status status = ERN_OK;
  *b = (struct ern_trainer_batches){.training = fine->training, .fine = fine, .speech = speech, .poses = poses};
  ERN_TRY(find_blinks(b));
  ERN_TRY(ERN_NEW(context, rays, &b->host_pixels));
  ERN_TRY(ERN_NEW(context, HOST_ROWS * ern_scratch_stride(rays), &b->host_rows));
fail:
  return status;
}

void ern_trainer_batches_free(struct ern_trainer_batches *b, struct ern_backend *backend) {
  for (int i = 0; i < 2; i++) {
    backend->buffer_free(backend, b->drawn.pixels[i]);
    backend->buffer_free(backend, b->drawn.reals[i]);
  }
  ern_release(backend->context, b->blinks);
  ern_release(backend->context, b->host_pixels);
  ern_release(backend->context, b->host_rows);
}

static size_t frame_of_step(const struct ern_trainer_batches *b, uint64_t step, size_t k) {
  const struct ern_training *t = b->training;
  const struct ern_random random = ern_random_at(t->config.seed, step, (uint32_t)k, ERN_RNG_FRAME);
  if (b->blink_count > 0 && ern_uniform(random.word[2]) < ERN_BLINK_SHARE)
    return b->blinks[ern_below(random.word[0], (uint32_t)b->blink_count)];
  return ern_trainer_random_frame(t, random.word[0]);
}

size_t ern_trainer_step_frame(const struct ern_trainer_batches *b, size_t k) {
  return frame_of_step(b, b->training->step, k);
}

/* Fills host_pixels and host_rows with batch k of a step; patches only of the next one. */
static ern_status draw_batch(const struct ern_trainer_batches *b, uint64_t step, size_t k, struct ern_batch *batch) {
  const struct ern_training *t = b->training;
  const size_t batches = ern_trainer_step_batches(b->fine), patches = ern_trainer_step_patches(b->fine);
  const size_t frame = k * ern_trainer_step_frames(b->fine) / batches;
  const struct ern_random of_frame = ern_random_at(t->config.seed, step, (uint32_t)frame, ERN_RNG_FRAME);
  const size_t each = patches > 0 ? (size_t)t->config.patch_size * (size_t)t->config.patch_size : 1;
  const size_t units = patches > 0 ? patches : (size_t)t->config.rays; /* divided among the batches */
  const size_t first = units * k / batches, count = units * (k + 1) / batches - first;
  ern_dataset_frame about;
  struct draw draw = {.t = t,
                      .b = b,
                      .step = step,
                      .about = &about,
                      .first = first * each,
                      .rays = count * each,
                      .stride = ern_scratch_stride(count * each),
                      .silhouette = {.has = is_silhouette},
                      .whole_head = {.has = is_head}};
  ern_status status = ERN_OK;
  *batch = (struct ern_batch){
      .frame = frame_of_step(b, step, frame), .rays = draw.rays, .patches = patches > 0 ? count : 0, .of_step = frame};
  ERN_TRY(ern_trainer_frame(t, 0, batch->frame, &about));
  ERN_TRY(ern_trainer_pixels(t, 0, batch->frame, &draw.truth, &draw.torso));
  if (batch->patches == 0) ERN_TRY(ern_trainer_head(t, batch->frame, &draw.head));
  batch->eye = about.eye + 0.1f * (ern_uniform(of_frame.word[1]) - 0.5f);
  for (int value = 0; value < 256; value++) draw.part[value] = (float)value / 255;
  find_regions(&draw);
  ERN_TRY(find_parts(&draw));
  if (batch->patches > 0)
    draw_patches(&draw, first, count);
  else
    ERN_TRY(draw_rays(&draw));
fail:
  ern_release(t->context, draw.silhouette.above);
  ern_release(t->context, draw.whole_head.above);
  return status;
}

/* A step has one batch of single rays. */
static bool is_simple(const struct ern_trainer_batches *b) {
  return ern_trainer_step_batches(b->fine) == 1 && ern_trainer_step_patches(b->fine) == 0;
}

void ern_trainer_draw_ahead(void *batches) {
  struct ern_trainer_batches *b = batches;
  const struct ern_training *t = b->training;
  char before[ERN_ERROR_BYTES];
  if (!is_simple(b) || b->drawn.step == t->step + 1 || t->step + 1 >= t->config.iters) return;
  ern_error_keep(t->context, before);
  b->drawn.step = draw_batch(b, t->step + 1, 0, &b->drawn.batch) == ERN_OK ? t->step + 1 : 0;
  b->drawn.uploaded = b->drawn.step > 0 && upload_ahead(b, &b->drawn.batch) == ERN_OK;
  ern_error_restore(t->context, before); /* that step will fail again, and report it */
}

ern_status ern_trainer_batch(struct ern_trainer_batches *b, size_t k, struct ern_batch *batch) {
  const struct ern_training *t = b->training;
  const bool drawn = is_simple(b) && t->step > 0 && b->drawn.step == t->step;
  ern_status status = ERN_OK;
  if (drawn)
    *batch = b->drawn.batch;
  else
    ERN_TRY(draw_batch(b, t->step, k, batch));
  b->drawn.step = 0;
  if (!drawn || !b->drawn.uploaded) ERN_TRY(upload_now(b, batch));
  if (!ern_trainer_poses_due(b->poses)) batch->rigid = (ern_span){0};
  if (!t->config.torso) ERN_TRY(ern_trainer_upload_windows(b->speech, batch->frame, batch->of_step, &batch->windows));
fail:
  return status;
}
