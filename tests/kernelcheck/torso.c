/* SPDX-License-Identifier: MIT
 * The torso's slots. */
#include "harness.h"

#include "model/torso_ops.h"

/* Every product, sum and quotient but those of the pose is that of the reference in the same order, rounded alike where
 * the device divides correctly rounded: the same bits. */
static void expect_rows(const char *what, struct many_rows rows) { expect_bits(what, of_rows(rows)); }

/* ---- pose ---- */

/* The inverse comes to the device with 48 bits and X is summed with what each float operation loses, so X is the
 * reference's but where that lay within 2^-20 of the middle of two floats: then it is the neighbour, 2^-23 of it at
 * most. k has two X as divisors and one as dividend: 3 neighbours, and each of its three operations may round to
 * another neighbour: 6 * 2^-23. The gradients have h, a sum of two, and twice two more divisors: 12 * 2^-23. Where
 * terms of a sum cancel, 12 * 2^-23 of the largest gradient of the three anchors is still granted. */
static const double pose_tolerance = 6 * 0x1p-23, pose_gradient_tolerance = 12 * 0x1p-23;

static double largest_of(struct many span) {
  const float *values = floats_of(0, span);
  double most = 0;
  for (size_t i = 0; i < span.on[0].count; i++)
    if (isfinite(values[i])) most = fmax(most, fabs((double)values[i]));
  return most;
}

static void check_pose(const float *pose, const float *anchors, bool has_gamma) {
  const float gamma_value = 1.375f, zeros[12] = {0};
  float dk_values[6];
  fill_random(dk_values, 6, 3, 2);
  const struct many k = many_empty(6), in = many_reals(anchors, 12);
  const struct many gamma = has_gamma ? many_reals(&gamma_value, 1) : (struct many){0};
  const struct many danchors = many_reals(zeros, 12), dk = many_reals(dk_values, 6);
  const struct many dgamma = has_gamma ? many_reals(zeros, 1) : (struct many){0};
  struct ern_torso_pose_fwd_args forward[MACHINES];
  struct ern_torso_pose_bwd_args backward[MACHINES];
  EACH_MACHINE (b) {
    forward[b] = (struct ern_torso_pose_fwd_args){.k = k.on[b], .anchors = in.on[b], .gamma = gamma.on[b]};
    memcpy(forward[b].pose, pose, sizeof forward[b].pose);
    backward[b] = (struct ern_torso_pose_bwd_args){
        .danchors = danchors.on[b], .dgamma = dgamma.on[b], .dk = dk.on[b], .forward = forward[b]};
  }
  RUN(torso_pose_fwd, forward);
  expect_near("k", k, pose_tolerance, 0);
  for (int twice = 0; twice < 2; twice++) RUN(torso_pose_bwd, backward); /* they accumulate */
  expect_near("danchors", danchors, pose_gradient_tolerance, pose_gradient_tolerance * largest_of(danchors));
  /* three sums of two terms each, added twice; k bounds the terms' factors h */
  if (has_gamma) expect_near("dgamma", dgamma, pose_tolerance, pose_tolerance * 24 * largest_of(k));
  machines_clear();
}

static void test_pose(void **state) {
  (void)state;
  static const float identity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
  static const float usual[16] = {0.1f, -0.99f, -0.03f, 0.19f, 0.06f,  0.04f, -1.02f, 3.04f,
                                  1.0f, 0.09f,  0.07f,  -0.2f, 0.003f, 0.01f, -0.02f, 1.0f};
  static const float corners[12] = {-0.5f, 0.25f, 0.7f, 1, 0.5f, 0.25f, 0.71f, 1, 0.01f, -0.3f, 0.72f, 1};
  float anchors[12], pose[16];
  for (uint64_t seed = 0; seed < 20; seed++) {
    fill_random(pose, 16, seed, 1);
    for (int i = 0; i < 4; i++) pose[5 * i] += pose[5 * i] < 0 ? -1 : 1; /* far from singular */
    fill_random(anchors, 12, 100 + seed, seed % 2 == 0 ? 1 : 100);
    check_pose(pose, anchors, seed % 3 != 0);
  }
  check_pose(identity, corners, false);
  check_pose(usual, corners, true);
  /* X_2 and X_3 zero: 0/0 and 1/0; huge; infinite; not a number */
  const float extremes[] = {0, -0.0f, 1e30f, -1e30f, 1e-30f, INFINITY, NAN};
  for (size_t e = 0; e < COUNT_OF(extremes); e++) {
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
static size_t picture_count(void) { return is_small() ? 6 : COUNT_OF(pictures); }

/* n pixels of the picture: all in order where there are as many, else any. */
static int32_t *pixels_of(size_t n, int width, int height, uint64_t seed) {
  int32_t *pixel = held_memory(n, sizeof *pixel);
  const uint32_t all = (uint32_t)(width * height);
  for (size_t i = 0; i < n; i++)
    pixel[i] = (int32_t)(n == all ? (uint32_t)i : ern_below(words_at(seed, 0, i).word[0], all));
  return pixel;
}

static void check_coords(size_t n, int width, int height) {
  int32_t *pixels = pixels_of(n, width, height, n);
  const struct many pixel = many_int32s(pixels, n);
  const struct many_rows q = many_strided(NULL, 2, n, ERN_PER_SAMPLE);
  struct ern_torso_coords_args args[MACHINES];
  EACH_MACHINE (b)
    args[b] = (struct ern_torso_coords_args){
        .q = q.on[b], .pixel = pixel.on[b], .width = width, .height = height, .shrink = 0.8f, .n = n};
  RUN(torso_coords, args);
  expect_rows("coordinates", q);
  machines_clear();
}

static void check_select(size_t n, int width, int height, const float *cells, float threshold) {
  int32_t *pixels = pixels_of(n, width, height, n);
  const struct many pixel = many_int32s(pixels, n), grid = many_reals(cells, ERN_TORSO_CELLS);
  const struct many index = many_of(ERN_ELEMENT_INT32, NULL, n);
  const struct many selected = many_of(ERN_ELEMENT_INT32, NULL, n);
  struct ern_torso_select_args args[MACHINES];
  EACH_MACHINE (b)
    args[b] = (struct ern_torso_select_args){.index = index.on[b],
                                             .selected = selected.on[b],
                                             .pixel = pixel.on[b],
                                             .grid = grid.on[b],
                                             .threshold = threshold,
                                             .width = width,
                                             .height = height,
                                             .n = n,
                                             .count = 12345};
  RUN(torso_select, args);
  EACH_OTHER (k) assert_int_equal(args[k].count, args[0].count);
  /* what lies behind the count is the poison on both */
  expect_same_int32s("index", index);
  expect_same_int32s("selected", selected);
  machines_clear();
}

static void test_coords(void **state) {
  (void)state;
  for (size_t p = 0; p < picture_count(); p++) {
    const int width = pictures[p][0], height = pictures[p][1];
    check_coords((size_t)width * (size_t)height, width, height);
    check_coords(0, width, height);
    for (size_t s = 0; s < size_count(); s++) check_coords(test_sizes[s], width, height);
  }
}

static void test_select(void **state) {
  (void)state;
  static float cells[ERN_TORSO_CELLS];
  fill_random(cells, ERN_TORSO_CELLS, 5, 1);
  for (size_t p = 0; p < picture_count(); p++) {
    const int width = pictures[p][0], height = pictures[p][1];
    const float thresholds[] = {0.01f, -2, 2, NAN, -INFINITY}; /* some, all, none, none, all */
    for (size_t t = 0; t < COUNT_OF(thresholds); t++)
      check_select((size_t)width * (size_t)height, width, height, cells, thresholds[t]);
    check_select(0, width, height, cells, 0.01f);
    for (size_t s = 0; s < size_count(); s++) check_select(test_sizes[s], width, height, cells, 0.01f);
  }
  if (!is_small()) check_select(202500, 450, 450, cells, 0.01f); /* a whole picture */
  cells[77] = NAN;
  cells[5000] = INFINITY;
  cells[ERN_TORSO_CELLS - 1] = 1e30f;
  check_select(16384, 128, 128, cells, 0.01f);
  if (!is_small()) check_select(64 * 450, 64, 450, cells, 0.01f);
}

/* All cells alike and as high as the threshold: interpolation between equal values rounds to either side of them, and
 * which pixels are above is decided by the last bit. */
static void test_select_at_the_threshold(void **state) {
  (void)state;
  static float cells[ERN_TORSO_CELLS];
  const float levels[] = {0.01f, 0, -0.0f, 0.1f, 1e30f, 0x1p-140f};
  for (size_t k = 0; k < COUNT_OF(levels); k++) {
    for (size_t i = 0; i < ERN_TORSO_CELLS; i++) cells[i] = levels[k];
    for (size_t p = 0; p < picture_count(); p++)
      check_select((size_t)(pictures[p][0] * pictures[p][1]), pictures[p][0], pictures[p][1], cells, levels[k]);
    if (!is_small()) check_select(202500, 450, 450, cells, levels[k]);
  }
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
  enum { EDGES = COUNT_OF(edge) };
  float *q = floats(2 * n), *d = floats(2 * n), *dx = floats(2 * n);
  for (size_t i = 0; i < 2 * n; i++) {
    const bool usual = i % 3 == 0;
    q[i] = usual ? random_at(1, i, 0.8f) : edge[i % EDGES][0];
    d[i] = usual ? random_at(2, i, 0.6f) : edge[i % EDGES][1];
    dx[i] = i % 31 == 30 ? NAN : random_at(3, i, 1);
  }
  const struct many_rows q_rows = many_strided(q, 2, n, ERN_PER_SAMPLE);
  const struct many_rows d_rows = many_strided(d, 2, n, ERN_PER_SAMPLE);
  const struct many_rows dx_rows = many_strided(dx, 2, n, ERN_PER_SAMPLE);
  const struct many_rows x = many_strided(NULL, 2, n, ERN_PER_SAMPLE);
  /* dd over dx: as overwritten as elsewhere */
  const struct many_rows dd = apart ? many_strided(NULL, 2, n, ERN_PER_SAMPLE) : dx_rows;
  struct ern_torso_deform_fwd_args forward[MACHINES];
  struct ern_torso_deform_bwd_args backward[MACHINES];
  EACH_MACHINE (b) {
    forward[b] = (struct ern_torso_deform_fwd_args){.x = x.on[b], .q = q_rows.on[b], .d = d_rows.on[b], .n = n};
    backward[b] = (struct ern_torso_deform_bwd_args){.dd = dd.on[b], .dx = dx_rows.on[b], .forward = forward[b]};
  }
  RUN(torso_deform_fwd, forward);
  expect_rows("deformed", x);
  RUN(torso_deform_bwd, backward);
  expect_rows("dd", dd);
  machines_clear();
}

static void check_move(size_t n) {
  static float motion[3][ERN_MOTION_VALUES]; /* none; usual; the most that is accepted */
  for (size_t i = 0; i < ERN_MOTION_VALUES; i++) {
    motion[1][i] = random_at(4, i, 0.3f);
    motion[2][i] = i % 3 == 0 ? 1e3f : -1e3f;
  }
  float *q = floats(2 * n);
  for (size_t i = 0; i < 2 * n; i++) q[i] = random_at(1, i, 0.8f);
  const struct many_rows q_rows = many_strided(q, 2, n, ERN_PER_SAMPLE);
  for (size_t k = 0; k < COUNT_OF(motion); k++) {
    const struct many_rows moved = many_strided(NULL, 2, n, ERN_PER_SAMPLE);
    struct ern_torso_move_args args[MACHINES];
    EACH_MACHINE (b) {
      args[b] = (struct ern_torso_move_args){
          .moved = moved.on[b], .q = q_rows.on[b], .motion = motion[k], .shrink = 0.75f, .n = n};
    }
    RUN(torso_move, args);
    expect_rows("moved", moved);
  }
  machines_clear();
}

static void test_move(void **state) {
  (void)state;
  check_move(0);
  for (size_t s = 0; s < size_count(); s++) check_move(test_sizes[s]);
}

static void test_deform(void **state) {
  (void)state;
  check_deform(0, true);
  for (size_t s = 0; s < size_count(); s++) check_deform(test_sizes[s], s % 2 == 0);
}

/* ---- compositing ---- */

struct composite_values {
  float *layer, *background, *dpixel;
  int32_t *index;
};

/* Every `step`-th ray has a layer. */
static struct composite_values composite_values(size_t rays, size_t n, size_t step) {
  struct composite_values values = {floats(4 * n), floats(3 * rays), floats(3 * rays), held_memory(n, sizeof(int32_t))};
  for (size_t i = 0; i < 4 * n; i++) values.layer[i] = i < n ? 0.5f + random_at(1, i, 0.5f) : random_at(1, i, 1);
  for (size_t i = 0; i < n; i++) values.index[i] = (int32_t)(i * step);
  fill_random(values.background, 3 * rays, 2, 1);
  fill_random(values.dpixel, 3 * rays, 3, 1);
  if (n > 2) values.layer[1] = NAN, values.layer[2] = 1e30f, values.layer[0] = 0, values.layer[n + 1] = INFINITY;
  if (rays > 4) values.background[4] = NAN, values.dpixel[rays / 2] = -1e30f;
  return values;
}

static void check_composite(size_t rays, size_t n, size_t step, bool in_place, bool has_opacity) {
  struct composite_values values = composite_values(rays, n, step);
  const struct many_rows layer = many_strided(values.layer, 4, n, ERN_PER_SAMPLE);
  const struct many_rows background = many_strided(values.background, 3, rays, ERN_PER_SAMPLE);
  const struct many_rows dpixel = many_strided(values.dpixel, 3, rays, ERN_PER_SAMPLE);
  /* the background of the reference has the same stride as its pixels */
  const struct many_rows pixel = in_place ? background : many_strided(NULL, 3, rays, ERN_PER_SAMPLE);
  const struct many_rows dlayer = many_strided(NULL, 4, n, ERN_PER_SAMPLE);
  const struct many index = many_int32s(values.index, n);
  const struct many opacity = has_opacity ? many_empty(rays) : (struct many){0};
  struct ern_torso_composite_fwd_args forward[MACHINES];
  struct ern_torso_composite_bwd_args backward[MACHINES];
  EACH_MACHINE (b) {
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
  RUN(torso_composite_bwd, backward);
  expect_rows("dlayer", dlayer);
  RUN(torso_composite_fwd, forward);
  expect_rows("pixel", pixel);
  if (has_opacity) expect_bits("opacity", opacity);
  machines_clear();
}

static void test_composite(void **state) {
  (void)state;
  check_composite(0, 0, 1, false, true);
  for (size_t s = 0; s < size_count(); s++) {
    const size_t rays = test_sizes[s];
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
    const struct many_rows q = many_strided(NULL, 2, ERN_TORSO_CELLS, ERN_PER_SAMPLE);
    struct ern_torso_points_args args[MACHINES];
    EACH_MACHINE (b)
      args[b] = (struct ern_torso_points_args){.q = q.on[b], .shrink = 0.8f, .seed = keys[k][0], .step = keys[k][1]};
    RUN(torso_points, args);
    expect_rows("points", q);
    machines_clear();
  }
}

static void check_update(const float *grid_values, const float *alpha_values, float decay) {
  const struct many grid = many_reals(grid_values, ERN_TORSO_CELLS);
  const struct many alpha = many_reals(alpha_values, ERN_TORSO_CELLS);
  struct ern_torso_update_args args[MACHINES];
  EACH_MACHINE (b)
    args[b] = (struct ern_torso_update_args){.grid = grid.on[b], .alpha = alpha.on[b], .decay = decay, .mean = -1};
  for (int again = 0; again < 2; again++) {
    RUN(torso_update, args);
    expect_bits("occupancy", grid);
    /* added in double, in the same order */
    EACH_OTHER (k) assert_true(args[0].mean == args[k].mean || (isnan(args[0].mean) && isnan(args[k].mean)));
  }
  machines_clear();
}

static void test_update(void **state) {
  (void)state;
  static float grid[ERN_TORSO_CELLS], alpha[ERN_TORSO_CELLS];
  for (size_t i = 0; i < ERN_TORSO_CELLS; i++) grid[i] = 0, alpha[i] = 0.5f + random_at(4, i, 0.5f);
  check_update(grid, alpha, 0.95f);
  /* a few cells, among them the corners: each reaches two cells far and not over an edge */
  for (size_t i = 0; i < ERN_TORSO_CELLS; i++) grid[i] = 0.5f + random_at(6, i, 0.5f), alpha[i] = 0;
  alpha[0] = 3, alpha[127] = 4, alpha[127 * 128] = 5, alpha[128 * 128 - 1] = 6, alpha[64 * 128 + 2] = 7;
  check_update(grid, alpha, 0.95f);
  check_update(grid, alpha, 0);
  alpha[300] = NAN, alpha[9000] = INFINITY, alpha[12000] = -INFINITY, alpha[700] = 1e30f;
  check_update(grid, alpha, 0.95f);
  grid[5000] = -0.0f, grid[5001] = 0x1p-148f, grid[400] = NAN;
  check_update(grid, alpha, 0.95f);
}

/* A picture of 450 x 450: what its torso takes beside the field, and a refresh. */
static void bench(void) {
  enum { SIDE = 450, PIXELS = SIDE * SIDE };
  static float cells[ERN_TORSO_CELLS];
  const int32_t *numbers = pixels_of(PIXELS, SIDE, SIDE, 1);
  const float *reals = floats(4 * PIXELS);
  fill_random(cells, ERN_TORSO_CELLS, 5, 1);
  const struct many pixel = many_int32s(numbers, PIXELS), index = many_int32s(numbers, PIXELS),
                    chosen = many_int32s(numbers, PIXELS), grid = many_reals(cells, ERN_TORSO_CELLS),
                    alpha = many_reals(cells, ERN_TORSO_CELLS), opacity = many_empty(PIXELS);
  const struct many_rows layer = many_strided(reals, 4, PIXELS, ERN_PER_SAMPLE),
                         image = many_strided(reals, 3, PIXELS, ERN_PER_SAMPLE),
                         q = many_strided(reals, 2, PIXELS, ERN_PER_SAMPLE);
  struct ern_torso_select_args selects[MACHINES];
  struct ern_torso_coords_args coords[MACHINES];
  struct ern_torso_composite_fwd_args composite[MACHINES];
  struct ern_torso_update_args update[MACHINES];
  EACH_MACHINE (k) {
    selects[k] = (struct ern_torso_select_args){index.on[k], chosen.on[k], pixel.on[k], grid.on[k], 0.01f,
                                                SIDE,        SIDE,         PIXELS,      0};
    coords[k] = (struct ern_torso_coords_args){q.on[k], pixel.on[k], SIDE, SIDE, 0.8f, PIXELS};
    update[k] = (struct ern_torso_update_args){.grid = grid.on[k], .alpha = alpha.on[k], .decay = 0.95f};
  }
  RUN(torso_select, selects);
  EACH_MACHINE (k)
    composite[k] = (struct ern_torso_composite_fwd_args){image.on[k], opacity.on[k], layer.on[k],     index.on[k],
                                                         image.on[k], PIXELS,        selects[k].count};
  BENCH("select", PIXELS, torso_select, selects);
  BENCH("coords", PIXELS, torso_coords, coords);
  BENCH("composite", selects[0].count, torso_composite_fwd, composite);
  BENCH("update", ERN_TORSO_CELLS, torso_update, update);
  machines_clear();
}

static const struct CMUnitTest tests[] = {
    cmocka_unit_test(test_pose),      cmocka_unit_test(test_coords),
    cmocka_unit_test(test_select),    cmocka_unit_test(test_select_at_the_threshold),
    cmocka_unit_test(test_move),      cmocka_unit_test(test_deform),
    cmocka_unit_test(test_composite), cmocka_unit_test(test_points),
    cmocka_unit_test(test_update)};
NOUN(torso, bench, .isa = NULL)
