/* SPDX-License-Identifier: MIT
 * The torso's slots on an OpenCL device against the reference. */
#include "kernelcheck.h"
#include "twin.h"

#include "model/torso_ops.h"

static ern_context *context;
static struct twin twin;

/* Every product, sum and quotient but those of the pose is that of the reference in the same order, rounded alike where
 * the device divides correctly rounded: the same bits. */
static void expect_bits(const char *what, struct twin_rows rows) {
  twin_same_bits(&twin, what, (struct twin_span){{rows.on[0].span, rows.on[1].span}});
}

/* For simulators: whole pictures, of other sizes than twin_sizes has, are left out. */
static bool is_small(void) { return TWIN_SIZES < sizeof twin_sizes / sizeof *twin_sizes; }

/* ---- pose ---- */

/* The inverse comes to the device with 48 bits and X is summed with what each float operation loses, so X is the
 * reference's but where that lay within 2^-20 of the middle of two floats: then it is the neighbour, 2^-23 of it at
 * most. k has two X as divisors and one as dividend: 3 neighbours, and each of its three operations may round to
 * another neighbour: 6 * 2^-23. The gradients have h, a sum of two, and twice two more divisors: 12 * 2^-23. Where
 * terms of a sum cancel, 12 * 2^-23 of the largest gradient of the three anchors is still granted. */
static const double pose_tolerance = 6 * 0x1p-23, pose_gradient_tolerance = 12 * 0x1p-23;

static double largest_of(struct twin_span span) {
  float *values = twin_down(&twin, 0, span.on[0]);
  double most = 0;
  for (size_t i = TWIN_GUARD; i < TWIN_GUARD + span.on[0].count; i++)
    if (isfinite(values[i])) most = fmax(most, fabs((double)values[i]));
  free(values);
  return most;
}

static void check_pose(const float *pose, const float *anchors, bool has_gamma) {
  const float gamma_value = 1.375f, zeros[12] = {0};
  float dk_values[6];
  twin_fill(dk_values, 6, 3, 2);
  const struct twin_span k = twin_take(&twin, ERN_ELEMENT_REAL, 6), in = twin_reals(&twin, anchors, 12);
  const struct twin_span gamma = has_gamma ? twin_reals(&twin, &gamma_value, 1) : (struct twin_span){0};
  const struct twin_span danchors = twin_reals(&twin, zeros, 12), dk = twin_reals(&twin, dk_values, 6);
  const struct twin_span dgamma = has_gamma ? twin_reals(&twin, zeros, 1) : (struct twin_span){0};
  struct ern_torso_pose_fwd_args forward[2];
  struct ern_torso_pose_bwd_args backward[2];
  for (int b = 0; b < 2; b++) {
    forward[b] = (struct ern_torso_pose_fwd_args){.k = k.on[b], .anchors = in.on[b], .gamma = gamma.on[b]};
    memcpy(forward[b].pose, pose, sizeof forward[b].pose);
    backward[b] = (struct ern_torso_pose_bwd_args){
        .danchors = danchors.on[b], .dgamma = dgamma.on[b], .dk = dk.on[b], .forward = forward[b]};
  }
  TWIN_RUN(&twin, torso_pose_fwd, forward);
  twin_same(&twin, "k", k, pose_tolerance, 0);
  for (int twice = 0; twice < 2; twice++) TWIN_RUN(&twin, torso_pose_bwd, backward); /* they accumulate */
  twin_same(&twin, "danchors", danchors, pose_gradient_tolerance, pose_gradient_tolerance * largest_of(danchors));
  /* three sums of two terms each, added twice; k bounds the terms' factors h */
  if (has_gamma) twin_same(&twin, "dgamma", dgamma, pose_tolerance, pose_tolerance * 24 * largest_of(k));
  twin_clear(&twin);
}

static void test_pose(void **state) {
  (void)state;
  static const float identity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
  static const float usual[16] = {0.1f, -0.99f, -0.03f, 0.19f, 0.06f,  0.04f, -1.02f, 3.04f,
                                  1.0f, 0.09f,  0.07f,  -0.2f, 0.003f, 0.01f, -0.02f, 1.0f};
  static const float corners[12] = {-0.5f, 0.25f, 0.7f, 1, 0.5f, 0.25f, 0.71f, 1, 0.01f, -0.3f, 0.72f, 1};
  float anchors[12], pose[16];
  for (uint64_t seed = 0; seed < 20; seed++) {
    twin_fill(pose, 16, seed, 1);
    for (int i = 0; i < 4; i++) pose[5 * i] += pose[5 * i] < 0 ? -1 : 1; /* far from singular */
    twin_fill(anchors, 12, 100 + seed, seed % 2 == 0 ? 1 : 100);
    check_pose(pose, anchors, seed % 3 != 0);
  }
  check_pose(identity, corners, false);
  check_pose(usual, corners, true);
  /* X_2 and X_3 zero: 0/0 and 1/0; huge; infinite; not a number */
  const float extremes[] = {0, -0.0f, 1e30f, -1e30f, 1e-30f, INFINITY, NAN};
  for (size_t e = 0; e < sizeof extremes / sizeof *extremes; e++) {
    for (int all = 0; all < 2; all++) {
      memcpy(anchors, corners, sizeof anchors);
      for (int i = 0; i < 12; i++)
        if (all || i == 6) anchors[i] = extremes[e];
      check_pose(identity, anchors, true);
      check_pose(usual, anchors, true);
    }
  }
}

/* ---- pixels ---- */

static const int pictures[][2] = {{1, 1}, {1, 40}, {40, 1}, {2, 2}, {3, 7}, {17, 19}, {128, 128}, {31, 450}};
static size_t picture_count(void) { return is_small() ? 6 : sizeof pictures / sizeof *pictures; }

/* n pixels of the picture: all in order where there are as many, else any. */
static int32_t *pixels_of(size_t n, int width, int height, uint64_t seed) {
  int32_t *pixel = malloc((n + 1) * sizeof *pixel);
  assert_non_null(pixel);
  const uint32_t all = (uint32_t)(width * height);
  for (size_t i = 0; i < n; i++)
    pixel[i] =
        (int32_t)(n == all ? (uint32_t)i : ern_below(ern_random_at(seed, 0, (uint32_t)i, ERN_RNG_PIXEL).word[0], all));
  return pixel;
}

static void check_coords(size_t n, int width, int height) {
  int32_t *pixels = pixels_of(n, width, height, n);
  const struct twin_span pixel = twin_int32s(&twin, pixels, n);
  const struct twin_rows q = twin_rows_of(&twin, NULL, 2, n, ERN_PER_SAMPLE);
  struct ern_torso_coords_args args[2];
  for (int b = 0; b < 2; b++)
    args[b] = (struct ern_torso_coords_args){
        .q = q.on[b], .pixel = pixel.on[b], .width = width, .height = height, .shrink = 0.8f, .n = n};
  TWIN_RUN(&twin, torso_coords, args);
  expect_bits("coordinates", q);
  twin_clear(&twin);
  free(pixels);
}

static void check_select(size_t n, int width, int height, const float *cells, float threshold) {
  int32_t *pixels = pixels_of(n, width, height, n);
  const struct twin_span pixel = twin_int32s(&twin, pixels, n), grid = twin_reals(&twin, cells, ERN_TORSO_CELLS);
  const struct twin_span index = twin_take(&twin, ERN_ELEMENT_INT32, n);
  const struct twin_span selected = twin_take(&twin, ERN_ELEMENT_INT32, n);
  struct ern_torso_select_args args[2];
  for (int b = 0; b < 2; b++)
    args[b] = (struct ern_torso_select_args){.index = index.on[b],
                                             .selected = selected.on[b],
                                             .pixel = pixel.on[b],
                                             .grid = grid.on[b],
                                             .threshold = threshold,
                                             .width = width,
                                             .height = height,
                                             .n = n,
                                             .count = 12345};
  TWIN_RUN(&twin, torso_select, args);
  assert_int_equal(args[1].count, args[0].count);
  /* what lies behind the count is the poison on both */
  twin_same_int32(&twin, "index", index);
  twin_same_int32(&twin, "selected", selected);
  twin_clear(&twin);
  free(pixels);
}

static void test_coords(void **state) {
  (void)state;
  for (size_t p = 0; p < picture_count(); p++) {
    const int width = pictures[p][0], height = pictures[p][1];
    check_coords((size_t)width * (size_t)height, width, height);
    check_coords(0, width, height);
    for (size_t s = 0; s < TWIN_SIZES; s++) check_coords(twin_sizes[s], width, height);
  }
}

static void test_select(void **state) {
  (void)state;
  float *cells = malloc(ERN_TORSO_CELLS * sizeof *cells);
  assert_non_null(cells);
  twin_fill(cells, ERN_TORSO_CELLS, 5, 1);
  for (size_t p = 0; p < picture_count(); p++) {
    const int width = pictures[p][0], height = pictures[p][1];
    const float thresholds[] = {0.01f, -2, 2, NAN, -INFINITY}; /* some, all, none, none, all */
    for (size_t t = 0; t < sizeof thresholds / sizeof *thresholds; t++)
      check_select((size_t)width * (size_t)height, width, height, cells, thresholds[t]);
    check_select(0, width, height, cells, 0.01f);
    for (size_t s = 0; s < TWIN_SIZES; s++) check_select(twin_sizes[s], width, height, cells, 0.01f);
  }
  if (!is_small()) check_select(202500, 450, 450, cells, 0.01f); /* a whole picture */
  cells[77] = NAN;
  cells[5000] = INFINITY;
  cells[ERN_TORSO_CELLS - 1] = 1e30f;
  check_select(16384, 128, 128, cells, 0.01f);
  if (!is_small()) check_select(64 * 450, 64, 450, cells, 0.01f);
  free(cells);
}

/* All cells alike and as high as the threshold: interpolation between equal values rounds to either side of them, and
 * which pixels are above is decided by the last bit. */
static void test_select_at_the_threshold(void **state) {
  (void)state;
  float *cells = malloc(ERN_TORSO_CELLS * sizeof *cells);
  assert_non_null(cells);
  const float levels[] = {0.01f, 0, -0.0f, 0.1f, 1e30f, 0x1p-140f};
  for (size_t k = 0; k < sizeof levels / sizeof *levels; k++) {
    for (size_t i = 0; i < ERN_TORSO_CELLS; i++) cells[i] = levels[k];
    for (size_t p = 0; p < picture_count(); p++)
      check_select((size_t)(pictures[p][0] * pictures[p][1]), pictures[p][0], pictures[p][1], cells, levels[k]);
    if (!is_small()) check_select(202500, 450, 450, cells, levels[k]);
  }
  free(cells);
}

/* ---- deformation ---- */

static void check_deform(size_t n, bool apart) {
  /* q + d at, just inside and just outside of the ends, far outside, and in no order at all */
  static const float edge[][2] = {{0.5f, 0.5f},
                                  {-0.5f, -0.5f},
                                  {0.75f, 0x1.000002p-2f},
                                  {0.75f, 0x1.fffffep-3f},
                                  {-1, -0x1p-149f},
                                  {-1, -0x1p-23f},
                                  {1, 0x1p-23f},
                                  {0, 1e30f},
                                  {0, -1e30f},
                                  {0, NAN},
                                  {NAN, 0},
                                  {0, INFINITY},
                                  {0, -INFINITY},
                                  {-0.0f, -0.0f},
                                  {0.3f, -0.2f},
                                  {1e30f, -1e30f}};
  enum { EDGES = sizeof edge / sizeof *edge };
  float *q = malloc(2 * n * sizeof *q + 1), *d = malloc(2 * n * sizeof *d + 1), *dx = malloc(2 * n * sizeof *dx + 1);
  assert_true(q != NULL && d != NULL && dx != NULL);
  for (size_t i = 0; i < 2 * n; i++) {
    const bool usual = i % 3 == 0;
    q[i] = usual ? twin_random(1, i, 0.8f) : edge[i % EDGES][0];
    d[i] = usual ? twin_random(2, i, 0.6f) : edge[i % EDGES][1];
    dx[i] = i % 31 == 30 ? NAN : twin_random(3, i, 1);
  }
  const struct twin_rows q_rows = twin_rows_of(&twin, q, 2, n, ERN_PER_SAMPLE);
  const struct twin_rows d_rows = twin_rows_of(&twin, d, 2, n, ERN_PER_SAMPLE);
  const struct twin_rows dx_rows = twin_rows_of(&twin, dx, 2, n, ERN_PER_SAMPLE);
  const struct twin_rows x = twin_rows_of(&twin, NULL, 2, n, ERN_PER_SAMPLE);
  /* dd over dx: as overwritten as elsewhere */
  const struct twin_rows dd = apart ? twin_rows_of(&twin, NULL, 2, n, ERN_PER_SAMPLE) : dx_rows;
  struct ern_torso_deform_fwd_args forward[2];
  struct ern_torso_deform_bwd_args backward[2];
  for (int b = 0; b < 2; b++) {
    forward[b] = (struct ern_torso_deform_fwd_args){.x = x.on[b], .q = q_rows.on[b], .d = d_rows.on[b], .n = n};
    backward[b] = (struct ern_torso_deform_bwd_args){.dd = dd.on[b], .dx = dx_rows.on[b], .forward = forward[b]};
  }
  TWIN_RUN(&twin, torso_deform_fwd, forward);
  expect_bits("deformed", x);
  TWIN_RUN(&twin, torso_deform_bwd, backward);
  expect_bits("dd", dd);
  twin_clear(&twin);
  free(q), free(d), free(dx);
}

static void test_deform(void **state) {
  (void)state;
  check_deform(0, true);
  for (size_t s = 0; s < TWIN_SIZES; s++) check_deform(twin_sizes[s], s % 2 == 0);
}

/* ---- compositing ---- */

struct composite_values {
  float *layer, *background, *dpixel;
  int32_t *index;
};

/* Every `step`-th ray has a layer. */
static struct composite_values composite_values(size_t rays, size_t n, size_t step) {
  struct composite_values values = {malloc((4 * n + 1) * sizeof(float)), malloc((3 * rays + 1) * sizeof(float)),
                                    malloc((3 * rays + 1) * sizeof(float)), malloc((n + 1) * sizeof(int32_t))};
  assert_true(values.layer && values.background && values.dpixel && values.index);
  for (size_t i = 0; i < 4 * n; i++) values.layer[i] = i < n ? 0.5f + twin_random(1, i, 0.5f) : twin_random(1, i, 1);
  for (size_t i = 0; i < n; i++) values.index[i] = (int32_t)(i * step);
  twin_fill(values.background, 3 * rays, 2, 1);
  twin_fill(values.dpixel, 3 * rays, 3, 1);
  if (n > 2) values.layer[1] = NAN, values.layer[2] = 1e30f, values.layer[0] = 0, values.layer[n + 1] = INFINITY;
  if (rays > 4) values.background[4] = NAN, values.dpixel[rays / 2] = -1e30f;
  return values;
}

static void check_composite(size_t rays, size_t n, size_t step, bool in_place, bool has_opacity) {
  struct composite_values values = composite_values(rays, n, step);
  const struct twin_rows layer = twin_rows_of(&twin, values.layer, 4, n, ERN_PER_SAMPLE);
  const struct twin_rows background = twin_rows_of(&twin, values.background, 3, rays, ERN_PER_SAMPLE);
  const struct twin_rows dpixel = twin_rows_of(&twin, values.dpixel, 3, rays, ERN_PER_SAMPLE);
  /* the background of the reference has the same stride as its pixels */
  const struct twin_rows pixel = in_place ? background : twin_rows_of(&twin, NULL, 3, rays, ERN_PER_SAMPLE);
  const struct twin_rows dlayer = twin_rows_of(&twin, NULL, 4, n, ERN_PER_SAMPLE);
  const struct twin_span index = twin_int32s(&twin, values.index, n);
  const struct twin_span opacity = has_opacity ? twin_take(&twin, ERN_ELEMENT_REAL, rays) : (struct twin_span){0};
  struct ern_torso_composite_fwd_args forward[2];
  struct ern_torso_composite_bwd_args backward[2];
  for (int b = 0; b < 2; b++) {
    forward[b] = (struct ern_torso_composite_fwd_args){.pixel = pixel.on[b],
                                                       .opacity = opacity.on[b],
                                                       .layer = layer.on[b],
                                                       .index = index.on[b],
                                                       .background = background.on[b],
                                                       .rays = rays,
                                                       .n = n};
    backward[b] =
        (struct ern_torso_composite_bwd_args){.dlayer = dlayer.on[b], .dpixel = dpixel.on[b], .forward = forward[b]};
  }
  TWIN_RUN(&twin, torso_composite_bwd, backward);
  expect_bits("dlayer", dlayer);
  TWIN_RUN(&twin, torso_composite_fwd, forward);
  expect_bits("pixel", pixel);
  if (has_opacity) twin_same_bits(&twin, "opacity", opacity);
  twin_clear(&twin);
  free(values.layer), free(values.background), free(values.dpixel), free(values.index);
}

static void test_composite(void **state) {
  (void)state;
  check_composite(0, 0, 1, false, true);
  for (size_t s = 0; s < TWIN_SIZES; s++) {
    const size_t rays = twin_sizes[s];
    for (int way = 0; way < 4; way++) {
      const bool in_place = way % 2 != 0, has_opacity = way / 2 != 0;
      check_composite(rays, 0, 1, in_place, has_opacity);
      check_composite(rays, rays, 1, in_place, has_opacity);
      check_composite(rays, (rays + 2) / 3, 3, in_place, has_opacity);
    }
  }
}

/* ---- occupancy ---- */

static void test_points(void **state) {
  (void)state;
  const uint64_t keys[][2] = {{0, 0}, {1, 16}, {0xFFFFFFFFFFFFFFFF, 0x123456789ABCDEF0}, {1ull << 32, 1ull << 32}};
  for (size_t k = 0; k < 4; k++) {
    const struct twin_rows q = twin_rows_of(&twin, NULL, 2, ERN_TORSO_CELLS, ERN_PER_SAMPLE);
    struct ern_torso_points_args args[2];
    for (int b = 0; b < 2; b++)
      args[b] = (struct ern_torso_points_args){.q = q.on[b], .shrink = 0.8f, .seed = keys[k][0], .step = keys[k][1]};
    TWIN_RUN(&twin, torso_points, args);
    expect_bits("points", q);
    twin_clear(&twin);
  }
}

static void check_update(const float *grid_values, const float *alpha_values, float decay) {
  const struct twin_span grid = twin_reals(&twin, grid_values, ERN_TORSO_CELLS);
  const struct twin_span alpha = twin_reals(&twin, alpha_values, ERN_TORSO_CELLS);
  struct ern_torso_update_args args[2];
  for (int b = 0; b < 2; b++)
    args[b] = (struct ern_torso_update_args){.grid = grid.on[b], .alpha = alpha.on[b], .decay = decay, .mean = -1};
  for (int again = 0; again < 2; again++) {
    TWIN_RUN(&twin, torso_update, args);
    twin_same_bits(&twin, "occupancy", grid);
    /* added in double, in the same order */
    assert_true(args[0].mean == args[1].mean || (isnan(args[0].mean) && isnan(args[1].mean)));
  }
  twin_clear(&twin);
}

static void test_update(void **state) {
  (void)state;
  float *grid = malloc(ERN_TORSO_CELLS * sizeof *grid), *alpha = malloc(ERN_TORSO_CELLS * sizeof *alpha);
  assert_true(grid != NULL && alpha != NULL);
  for (size_t i = 0; i < ERN_TORSO_CELLS; i++) grid[i] = 0, alpha[i] = 0.5f + twin_random(4, i, 0.5f);
  check_update(grid, alpha, 0.95f);
  /* a few cells, among them the corners: each reaches two cells far and not over an edge */
  for (size_t i = 0; i < ERN_TORSO_CELLS; i++) grid[i] = 0.5f + twin_random(6, i, 0.5f), alpha[i] = 0;
  alpha[0] = 3, alpha[127] = 4, alpha[127 * 128] = 5, alpha[128 * 128 - 1] = 6, alpha[64 * 128 + 2] = 7;
  check_update(grid, alpha, 0.95f);
  check_update(grid, alpha, 0);
  alpha[300] = NAN, alpha[9000] = INFINITY, alpha[12000] = -INFINITY, alpha[700] = 1e30f;
  check_update(grid, alpha, 0.95f);
  grid[5000] = -0.0f, grid[5001] = 0x1p-148f, grid[400] = NAN;
  check_update(grid, alpha, 0.95f);
  free(grid), free(alpha);
}

/* ---- measuring --------------------------------------------------------------------------------------------------- */

/* A picture of 450 x 450: what its torso takes beside the field, and a refresh. */
struct bench {
  struct ern_torso_select_args select;
  struct ern_torso_coords_args coords;
  struct ern_torso_composite_fwd_args composite;
  struct ern_torso_update_args update;
  ern_span seen;
  int backend;
};

static void bench_wait(const struct bench *bench) { /* until the device is done */
  float value;
  support_ok(context,
             twin.backend[bench->backend]->download_reals(twin.stream[bench->backend], &value, bench->seen, 1));
}
#define BENCH_RUN(slot)                                                                                         \
  static void run_##slot(void *user) {                                                                          \
    struct bench *bench = user;                                                                                 \
    support_ok(context, twin.backend[bench->backend]->torso_##slot(twin.stream[bench->backend], &bench->slot)); \
    bench_wait(bench);                                                                                          \
  }
BENCH_RUN(select)
BENCH_RUN(coords)
BENCH_RUN(update)
static void run_composite(void *user) {
  struct bench *bench = user;
  support_ok(context,
             twin.backend[bench->backend]->torso_composite_fwd(twin.stream[bench->backend], &bench->composite));
  bench_wait(bench);
}

static int set_up(void **state) {
  (void)state;
  context = support_context();
  twin_open(&twin, context);
  return 0;
}
static int tear_down(void **state) {
  (void)state;
  twin_close(&twin);
  ern_context_free(&context);
  return 0;
}

static int measure(void) {
  enum { SIDE = 450, PIXELS = SIDE * SIDE };
  float *cells = malloc(ERN_TORSO_CELLS * sizeof *cells), *reals = calloc(4 * PIXELS, sizeof *reals);
  int32_t *numbers = pixels_of(PIXELS, SIDE, SIDE, 1);
  assert_true(cells != NULL && reals != NULL);
  set_up(NULL);
  twin_fill(cells, ERN_TORSO_CELLS, 5, 1);
  const struct twin_span pixel = twin_int32s(&twin, numbers, PIXELS), index = twin_int32s(&twin, numbers, PIXELS);
  const struct twin_span selected = twin_int32s(&twin, numbers, PIXELS);
  const struct twin_span grid = twin_reals(&twin, cells, ERN_TORSO_CELLS);
  const struct twin_span alpha = twin_reals(&twin, cells, ERN_TORSO_CELLS);
  const struct twin_rows layer = twin_rows_of(&twin, reals, 4, PIXELS, ERN_PER_SAMPLE);
  const struct twin_rows image = twin_rows_of(&twin, reals, 3, PIXELS, ERN_PER_SAMPLE);
  const struct twin_rows q = twin_rows_of(&twin, reals, 2, PIXELS, ERN_PER_SAMPLE);
  const struct twin_span opacity = twin_take(&twin, ERN_ELEMENT_REAL, PIXELS);
  for (int b = 0; b < 2; b++) {
    struct bench bench = {
        .select = {index.on[b], selected.on[b], pixel.on[b], grid.on[b], 0.01f, SIDE, SIDE, PIXELS, 0},
        .coords = {q.on[b], pixel.on[b], SIDE, SIDE, 0.8f, PIXELS},
        .update = {.grid = grid.on[b], .alpha = alpha.on[b], .decay = 0.95f},
        .seen = alpha.on[b],
        .backend = b};
    const double select = seconds_of(run_select, &bench), coords = seconds_of(run_coords, &bench);
    bench.composite = (struct ern_torso_composite_fwd_args){image.on[b], opacity.on[b], layer.on[b],       index.on[b],
                                                            image.on[b], PIXELS,        bench.select.count};
    const double composite = seconds_of(run_composite, &bench), update = seconds_of(run_update, &bench);
    printf("%-6s: of %d pixels, %zu chosen: select %.0f us, coords of all %.0f, composite %.0f; update %.0f\n",
           b == 0 ? "ref" : "device", PIXELS, bench.select.count, 1e6 * select, 1e6 * coords, 1e6 * composite,
           1e6 * update);
  }
  tear_down(NULL);
  free(cells), free(reals), free(numbers);
  return 0;
}

int main(int argc, char **argv) {
  if (argc == 2 && strcmp(argv[1], "--bench") == 0) return measure();
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_pose),   cmocka_unit_test(test_coords),
                                     cmocka_unit_test(test_select), cmocka_unit_test(test_select_at_the_threshold),
                                     cmocka_unit_test(test_deform), cmocka_unit_test(test_composite),
                                     cmocka_unit_test(test_points), cmocka_unit_test(test_update)};
  return cmocka_run_group_tests_name("opencl torso", tests, set_up, tear_down);
}
