/* SPDX-License-Identifier: MIT
 * Frames of input that no camera and no speech gives, through the public functions: refused in words, or finite
 * pictures (docs/numerics.md). */
#include "ernerf/render.h"
#include "machines.h"
#include "model/model.h"
#include "model/torso_ops.h"
#include "render/morton.h"

enum { SIDE = 16, PIXELS = SIDE * SIDE, WIDTH = 5, LENGTH = 16, WINDOWS = 8 * LENGTH * WIDTH };

/* A head with a torso, and a renderer of it on each machine. */
struct portrait {
  ern_model *model;
  ern_renderer *renderer[MACHINES];
  float windows[WINDOWS];
  uint8_t background[3 * PIXELS], rgba[4 * PIXELS];
  float rgb[3 * PIXELS], alpha[PIXELS], opacity[PIXELS], depth[PIXELS], attention[PIXELS];
};
static struct portrait portrait;
static const float facing[16] = {0, -1, 0, 0, 0, 0, -1, 3, 1, 0, 0, 0, 0, 0, 0, 1};

static ern_model *model_make(int codes) {
  ern_model *model = NULL;
  const struct ern_model_config config = {.levels = 2,
                                          .feature_width = WIDTH,
                                          .window_length = LENGTH,
                                          .head = true,
                                          .torso = true,
                                          .codes = codes,
                                          .bound = 1};
  support_ok(machines.context, ern_model_make(&model, machines.context, &config));
  ern_parameters_init(model->block, &model->table, false, 5);
  ern_parameters_init(model->block, &model->table, true, 5);
  for (uint32_t c = 0; c < ERN_OCCUPANCY_CELLS; c++) { /* a ball of radius 1/4 */
    const float x = (float)ern_morton_gather(c) / 64 - 1, y = (float)ern_morton_gather(c >> 1) / 64 - 1,
                z = (float)ern_morton_gather(c >> 2) / 64 - 1;
    if (x * x + y * y + z * z < 0.0625f) model->bits[c >> 3] |= (uint8_t)(1u << (c & 7));
  }
  const struct ern_field *field = &model->field;
  for (size_t i = 0; i < 64; i++) model->block[field->density.weight[2] + i] *= 100;
  for (int plane = 0; plane < ERN_PLANES; plane++) /* values of 1 make the density vary from cell to cell */
    for (uint32_t i = 0; i < field->encoder.grid[plane].entries; i++)
      model->block[field->encoder.table[plane] + i] = machines_random(9 + (uint64_t)plane, i, 1);
  for (size_t i = 0; i < ERN_TORSO_CELLS; i++) model->torso_grid[i] = i % 2 == 0 ? 1 : 0.001f;
  return model;
}

static int open_portrait(void **state) {
  open_hosts(state);
  portrait.model = model_make(0);
  for (int k = 0; k < machines.count; k++)
    support_ok(machines.context, ern_renderer_create(&portrait.renderer[k], machines.backend[k], portrait.model, NULL));
  for (size_t i = 0; i < WINDOWS; i++) portrait.windows[i] = sinf((float)i);
  memset(portrait.background, 128, sizeof portrait.background);
  return 0;
}
static int close_portrait(void **state) {
  for (int k = 0; k < machines.count; k++) ern_renderer_free(&portrait.renderer[k]);
  ern_model_free(&portrait.model);
  return close_machines(state);
}

static ern_frame_input usual(void) {
  ern_frame_input input = {.camera = {.focal = 3 * SIDE, .cx = SIDE / 2, .cy = SIDE / 2, .width = SIDE, .height = SIDE},
                           .windows = portrait.windows,
                           .window_length = LENGTH,
                           .background = portrait.background};
  memcpy(input.camera.pose, facing, sizeof facing);
  return input;
}

static ern_status draw(int k, const ern_frame_input *input) {
  const ern_frame_output output = {.rgba = portrait.rgba,
                                   .rgb = portrait.rgb,
                                   .alpha = portrait.alpha,
                                   .opacity = portrait.opacity,
                                   .depth = portrait.depth,
                                   .attention = portrait.attention};
  return ern_renderer_frame(portrait.renderer[k], input, &output, NULL);
}

static void all_within(int k, const char *what, const float *values, size_t count, float low, float high) {
  for (size_t i = 0; i < count; i++)
    if (!(isfinite(values[i]) && values[i] >= low && values[i] <= high))
      fail_msg("%s: %s [%zu] is %g", machines.name[k], what, i, (double)values[i]);
}
static void expect_pixels(int k) {
  all_within(k, "rgb", portrait.rgb, 3 * PIXELS, 0, 1);
  all_within(k, "alpha", portrait.alpha, PIXELS, -0.001f, 1.001f);
  all_within(k, "opacity", portrait.opacity, PIXELS, 0, 1.0001f);
  all_within(k, "depth", portrait.depth, PIXELS, 0, FLT_MAX);
}
static void expect_picture(int k) {
  expect_pixels(k);
  all_within(k, "attention", portrait.attention, PIXELS, 0, FLT_MAX);
}
/* On each machine: a picture of finite numbers in their range. */
static void expect_drawn(const ern_frame_input *input) {
  for (int k = 0; k < machines.count; k++) {
    memset(portrait.rgb, 0xFF, sizeof portrait.rgb);
    const ern_status status = draw(k, input);
    if (status != ERN_OK) fail_msg("%s: %s", machines.name[k], ern_last_error(machines.context));
    expect_picture(k);
  }
}
/* On each machine: an error with these words. */
static void expect_refused(const ern_frame_input *input, ern_status status, const char *word, const char *other) {
  for (int k = 0; k < machines.count; k++) support_expect(machines.context, draw(k, input), status, word, other, NULL);
}
/* ---- individual codes ---- */

/* case: mean of individual codes of +-3e38 | plain code: the sum leaves float | here: sums in double | bound: same bits
 * as of a model with that row */
/* On each machine a frame of the mean of the codes is that of a model whose first row is the mean, also where sums
 * leave float; other rows are as before. */
static void test_frame_of_the_mean_code(void **state) {
  (void)state;
  enum { ROWS = 3 };
  static float mean[3 * PIXELS], first[3 * PIXELS];
  ern_model *model = model_make(ROWS), *same = model_make(ROWS);
  const struct ern_field *field = &model->field;
  for (size_t c = 0; c < ERN_CODE_WIDTH + ERN_TORSO_CODE_WIDTH; c++) {
    const bool head = c < ERN_CODE_WIDTH;
    const size_t at = head ? field->codes + c : field->torso_codes + c - ERN_CODE_WIDTH,
                 width = head ? ERN_CODE_WIDTH : ERN_TORSO_CODE_WIDTH;
    const float rows[ROWS] = {3e38f, -3e38f, machines_random(3, c, 2)};
    for (size_t r = 0; r < ROWS; r++) model->block[at + r * width] = rows[r];
    same->block[at] = (float)((double)rows[2] / ROWS);
    same->block[at + width] = rows[2];
  }
  for (int k = 0; k < machines.count; k++) {
    ern_renderer *renderer[2] = {NULL, NULL};
    ern_frame_input input = usual();
    const ern_frame_output to_mean = {.rgb = mean}, to_first = {.rgb = first};
    support_ok(machines.context, ern_renderer_create(&renderer[0], machines.backend[k], model, NULL));
    support_ok(machines.context, ern_renderer_create(&renderer[1], machines.backend[k], same, NULL));
    for (int turn = 0; turn < 2; turn++) {
      input.individual = turn == 0 ? ERN_INDIVIDUAL_MEAN : 2;
      support_ok(machines.context, ern_renderer_frame(renderer[0], &input, &to_mean, NULL));
      input.individual = (size_t)turn;
      support_ok(machines.context, ern_renderer_frame(renderer[1], &input, &to_first, NULL));
      if (memcmp(mean, first, sizeof mean) != 0) fail_msg("%s: turn %d: other pixels", machines.name[k], turn);
    }
    ern_renderer_free(&renderer[0]);
    ern_renderer_free(&renderer[1]);
  }
  ern_model_free(&model);
  ern_model_free(&same);
}

/* ---- frames that are kept ---- */

/* case: frames kept from one of speech 0, 1e4, +-1e30 | plain code: a scale of 0 or 1/infinity | here: as drawn from
 * nothing | bound: 0.5/255 */
/* Each speech twice, so often that the view counts as standing: against the same frames drawn from nothing. */
static void test_kept_frames_of_silent_and_huge_speech(void **state) {
  (void)state;
  enum { SPEECHES = 5, FRAMES = 4 * SPEECHES };
  static const float size[SPEECHES] = {0, 1, 1e4f, 1e30f, -1e30f}, half_a_level = 0.5f / 255;
  static float said[SPEECHES][WINDOWS], whole[SPEECHES][3 * PIXELS];
  const float eyes[SPEECHES] = {0};
  for (size_t s = 0; s < SPEECHES; s++)
    for (size_t i = 0; i < WINDOWS; i++) said[s][i] = size[s] * portrait.windows[i];
  for (int k = 0; k < machines.count; k++) {
    ern_frame_input input = usual();
    for (int f = -SPEECHES; f < FRAMES; f++) { /* the first ones keep nothing */
      const int s = f < 0 ? f + SPEECHES : f / 2 % SPEECHES;
      if (f == 0)
        support_ok(machines.context,
                   ern_renderer_reuse_rays(portrait.renderer[k], said[0], LENGTH, eyes, SPEECHES, half_a_level));
      input.windows = said[s];
      support_ok(machines.context, draw(k, &input));
      expect_picture(k);
      if (f < 0) memcpy(whole[s], portrait.rgb, sizeof portrait.rgb);
      for (size_t i = 0; i < 3 * PIXELS; i++)
        if (!(fabsf(portrait.rgb[i] - whole[s][i]) <= half_a_level))
          fail_msg("%s: frame %d, speech times %g: value %zu is %g, expected %g", machines.name[k], f, (double)size[s],
                   i, (double)portrait.rgb[i], (double)whole[s][i]);
    }
    support_ok(machines.context, ern_renderer_reuse_rays(portrait.renderer[k], NULL, LENGTH, NULL, 0, -1));
  }
}

/* ---- poses ---- */

/* case: an ordinary frame | plain code: - | here: the others have something to lose | bound: in [0, 1] */
static void test_frame_of_the_usual_long(void **state) {
  (void)state;
  const ern_frame_input input = usual();
  expect_drawn(&input);
  float most = 0;
  for (size_t i = 0; i < PIXELS; i++) most = fmaxf(most, portrait.opacity[i]);
  if (!(most > 0.3f)) fail_msg("opacity up to %g", (double)most); /* the other cases have something to draw */
}

/* case: singular poses | plain code: infinite inverse, black frame | here: refused: pose or head_pose, "cannot be
 * inverted" | bound: determinant 1e-6 */
static void test_frame_of_a_singular_pose(void **state) {
  (void)state;
  static const float poses[][16] = {{0},
                                    {0, -1, 0, 0, 0, -1, 0, 3, 1, 0, 0, 0, 0, 0, 0, 1},
                                    {1, 2, 3, 0, 2, 4, 6, 3, 1, 0, 0, 0, 0, 0, 0, 1},
                                    {0, -1, 0, 0, 0, 0, -1, 3, 1, 0, 0, 0, 0, 0, 0, 0},
                                    {0, -1, 0, 0, 0, 0, -1, 3, 1, 0, 0, 0, 0, -1, 0, 0}};
  for (size_t p = 0; p < COUNT_OF(poses); p++) {
    ern_frame_input input = usual();
    memcpy(input.camera.pose, poses[p], sizeof poses[p]);
    expect_refused(&input, ERN_E_ARGUMENT, "pose", "inverted");
    input = usual();
    input.head_pose = poses[p];
    expect_refused(&input, ERN_E_ARGUMENT, "head_pose", "inverted");
  }
}

/* case: NaN or infinity at each place of a pose | plain code: an empty frame | here: refused with its place | bound:
 * exact */
static void test_frame_of_a_pose_that_is_no_number(void **state) {
  (void)state;
  for (size_t i = 0; i < 16; i++) {
    ern_frame_input input = usual();
    float pose[16];
    memcpy(pose, facing, sizeof pose);
    pose[i] = i % 2 == 0 ? NAN : -INFINITY;
    input.head_pose = pose;
    expect_refused(&input, ERN_E_NONFINITE, "head_pose", "not finite");
    input = usual();
    input.camera.pose[i] = pose[i];
    expect_refused(&input, ERN_E_NONFINITE, "pose", "not finite");
  }
}

/* case: mirrored, sheared, stretched poses, odd last rows | plain code: the transpose as inverse | here: drawn as they
 * are | bound: in [0, 1] */
static void test_frame_of_mirrored_and_sheared_poses(void **state) {
  (void)state;
  static const float poses[][16] = {{0, 1, 0, 0, 0, 0, -1, 3, 1, 0, 0, 0, 0, 0, 0, 1},
                                    {0, -1, 0, 0, 0, 0, 1, -3, 1, 0, 0, 0, 0, 0, 0, 1},
                                    {0.5f, -1, 0, 0, 0, 0.3f, -1, 3, 1, 0, 0.7f, 0, 0, 0, 0, 1},
                                    {0, -20, 0, 0, 0, 0, -0.01f, 3, 30, 0, 0, 0, 0, 0, 0, 1},
                                    {0, -1, 0, 0, 0, 0, -1, 3, 1, 0, 0, 0, 0.1f, 0.2f, 0.3f, 2}};
  for (size_t p = 0; p < COUNT_OF(poses); p++) {
    ern_frame_input input = usual();
    memcpy(input.camera.pose, poses[p], sizeof poses[p]);
    expect_drawn(&input);
    input.head_pose = poses[(p + 1) % COUNT_OF(poses)];
    expect_drawn(&input);
  }
}

/* case: places to 1e38; rotations with entries to 1e3, and to 1e38 | plain code: an endless march; inf - inf | here:
 * empty far away; drawn to 1,000, above refused with its place | bound: in [0, 1] */
/* Places 1e3 to 1e38 away; rotations with entries of up to 1,000, and longer ones. */
static void test_frame_of_huge_poses(void **state) {
  (void)state;
  static const float far[] = {1e3f, 1e10f, 1e20f, 1e30f, 1e38f, -1e38f};
  static const float longer[] = {2, 1e2f, 1e3f, 1.001e3f, 1e12f, 1e38f};
  for (size_t i = 0; i < COUNT_OF(far); i++) {
    ern_frame_input input = usual();
    for (size_t axis = 0; axis < 3; axis++) input.camera.pose[4 * axis + 3] = far[i];
    expect_drawn(&input);
    input = usual();
    for (size_t axis = 0; axis < 3; axis++)
      for (size_t c = 0; c < 3; c++) input.camera.pose[4 * axis + c] *= longer[i];
    if (i < 3)
      expect_drawn(&input);
    else
      expect_refused(&input, ERN_E_ARGUMENT, "render: pose: value 1, of the rotation", "expected 1000 at most");
  }
  ern_frame_input input = usual();
  float pose[16];
  memcpy(pose, facing, sizeof pose);
  pose[8] = -1e4f;
  input.head_pose = pose;
  expect_refused(&input, ERN_E_ARGUMENT, "head_pose: value 8, of the rotation", "expected 1000 at most");
}

/* case: from inside the head, on faces, corners, the key points' plane | plain code: X/0, samples behind the camera |
 * here: drawn | bound: in [0, 1] */
/* The camera in the head, on faces and corners of the box, on the plane of the torso's key points. */
static void test_frame_from_inside_the_head(void **state) {
  (void)state;
  static const float places[][3] = {{0, 0, 0},      {0, 0.2f, 0},        {0, 0.5f, 0},       {1, 0.5f, 1},
                                    {-1, -0.5f, 0}, {0, 0.50000006f, 0}, {0.1f, 0.1f, 0.1f}, {0, 0.05f, 0}};
  for (size_t p = 0; p < COUNT_OF(places); p++) {
    ern_frame_input input = usual();
    for (size_t axis = 0; axis < 3; axis++) input.camera.pose[4 * axis + 3] = places[p][axis];
    expect_drawn(&input);
  }
  /* key points are at z = 0.1 of the torso's own frame */
  ern_frame_input input = usual();
  const float beside[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.1f, 0, 0, 0, 1};
  memcpy(input.camera.pose, beside, sizeof beside);
  expect_drawn(&input);
}

/* ---- speech ---- */

/* A code that is mixed into the next frame's must not ruin all that follow. No speech that is let through does that to
 * a usual model: this one has weights of 1e20 and -1e20, whose products are infinite and have no sum. */
static void expect_smooth_lips_recover(const ern_frame_input *loud) {
  ern_render_options options = ern_render_options_default();
  struct ern_model *model = portrait.model;
  float *first = model->block + model->field.audio.conv_weight[0];
  const float kept[2] = {first[0], first[3]}; /* [channel][3] */
  options.smooth_lips = true;
  first[0] = 1e20f, first[3] = -1e20f;
  for (int k = 1; k < machines.count; k++) { /* in double nothing overflows */
    ern_renderer *own = portrait.renderer[k];
    const ern_frame_input input = usual();
    support_ok(machines.context, ern_renderer_create(&portrait.renderer[k], machines.backend[k], model, &options));
    support_ok(machines.context, draw(k, &input));
    support_expect(machines.context, draw(k, loud), ERN_E_NONFINITE, "audio code", "not finite", NULL);
    support_ok(machines.context, draw(k, &input));
    expect_picture(k);
    ern_renderer_free(&portrait.renderer[k]);
    portrait.renderer[k] = own;
  }
  first[0] = kept[0], first[3] = kept[1];
}

/* case: speech of 0, 1e-45, 1e5 to FLT_MAX | plain code: NaN pixels, black bytes | here: drawn to 1e30, above refused
 * with its place; the next frame is as ever, with smooth_lips too | bound: in [0, 1] */
static void test_frame_of_silent_and_huge_speech(void **state) {
  (void)state;
  static const float drawn[] = {0, -0.0f, FLT_TRUE_MIN, 1e5f, -1e10f, 1e20f, 1e30f, -1e30f};
  static const float refused[] = {1.0001e30f, -1e35f, FLT_MAX};
  static float windows[WINDOWS];
  ern_frame_input input = usual();
  input.windows = windows;
  for (size_t s = 0; s < COUNT_OF(drawn); s++) {
    for (size_t i = 0; i < WINDOWS; i++) windows[i] = drawn[s] * (i % 3 == 0 ? -1.0f : 1.0f);
    expect_drawn(&input);
    for (size_t i = 0; i < WINDOWS; i++) windows[i] = drawn[s];
    expect_drawn(&input);
  }
  expect_smooth_lips_recover(&input);
  for (size_t s = 0; s < COUNT_OF(refused); s++) {
    memcpy(windows, portrait.windows, sizeof windows);
    windows[17] = refused[s];
    expect_refused(&input, ERN_E_ARGUMENT, "render: speech window: value 17 is ", "expected -1e30 to 1e30");
  }
  input = usual(); /* and the next frame is as ever */
  expect_drawn(&input);
}

/* case: one NaN or infinity in the speech | plain code: a black frame | here: refused with its place | bound: exact */
static void test_frame_of_speech_with_a_nan(void **state) {
  (void)state;
  static const size_t places[] = {0, 77, WINDOWS - 1};
  for (size_t p = 0; p < COUNT_OF(places); p++) {
    static float windows[WINDOWS];
    char number[32];
    memcpy(windows, portrait.windows, sizeof windows);
    windows[places[p]] = p == 1 ? INFINITY : NAN;
    snprintf(number, sizeof number, "value %zu", places[p]);
    ern_frame_input input = usual();
    input.windows = windows;
    expect_refused(&input, ERN_E_NONFINITE, "speech", number);
    for (int k = 0; k < machines.count; k++) {
      float code[32];
      support_expect(machines.context, ern_renderer_code(portrait.renderer[k], windows, LENGTH, code), ERN_E_NONFINITE,
                     number, NULL);
    }
  }
}

/* case: eye and silence weight NaN, infinite, 1.0001, -0.1; a silence code not finite | plain code: NaN passes `x < 0
 * or x > 1` | here: `!(x >= 0 && x <= 1)`: refused | bound: exact */
static void test_frame_of_odd_eye_and_silence(void **state) {
  (void)state;
  static const float odd[] = {NAN, INFINITY, -0.1f, 1.0001f};
  static float code[32];
  for (size_t i = 0; i < COUNT_OF(odd); i++) {
    ern_frame_input input = usual();
    input.eye = odd[i];
    expect_refused(&input, ERN_E_ARGUMENT, "eye", "expected 0 to 1");
    input = usual();
    input.silence_weight = odd[i];
    input.silence_code = code;
    expect_refused(&input, ERN_E_ARGUMENT, "silence_weight", "expected 0 to 1");
  }
  ern_frame_input input = usual();
  float broken[32] = {0};
  broken[31] = NAN;
  input.silence_weight = 0.5f, input.silence_code = broken;
  expect_refused(&input, ERN_E_NONFINITE, "silence_code", "31");
}

/* ---- networks ---- */

static void scale_last(const struct ern_mlp *net, float times) {
  const int last = net->layers - 1;
  const size_t values = (size_t)net->width[last] * (size_t)net->width[last + 1];
  for (size_t i = 0; i < values; i++) portrait.model->block[net->weight[last] + i] *= times;
}

/* A frame with the block as it is now, on machine k. */
static ern_status draw_changed(int k) {
  const ern_frame_input input = usual();
  ern_renderer *own = portrait.renderer[k];
  support_ok(machines.context, ern_renderer_create(&portrait.renderer[k], machines.backend[k], portrait.model, NULL));
  const ern_status status = draw(k, &input);
  ern_renderer_free(&portrait.renderer[k]);
  portrait.renderer[k] = own;
  return status;
}

/* Each network's last weights `times` as large, alone. */
static void draw_times(float times) {
  struct ern_model *model = portrait.model;
  const struct ern_field *f = &model->field;
  const struct ern_mlp *const nets[] = {&f->density, &f->colour, &f->attention, &f->torso_deform, &f->torso_net};
  const size_t count = f->parameters;
  float *kept = malloc(count * sizeof *kept);
  assert_non_null(kept);
  memcpy(kept, model->block, count * sizeof *kept);
  for (size_t n = 0; n < COUNT_OF(nets); n++) {
    scale_last(nets[n], times);
    for (int k = 0; k < machines.count; k++) {
      support_ok(machines.context, draw_changed(k));
      expect_picture(k);
    }
    memcpy(model->block, kept, count * sizeof *kept);
  }
  free(kept);
}

/* All parameters `times` as large: a product of twelve layers is no float, and is said not to be one. */
static void refuse_times(float times) {
  struct ern_model *model = portrait.model;
  const size_t count = model->field.parameters;
  float *kept = malloc(count * sizeof *kept);
  assert_non_null(kept);
  memcpy(kept, model->block, count * sizeof *kept);
  for (size_t i = 0; i < count; i++) model->block[i] *= times;
  for (int k = 1; k < machines.count; k++) /* it is one in double */
    support_expect(machines.context, draw_changed(k), ERN_E_NONFINITE, "the picture is not finite", NULL);
  memcpy(model->block, kept, count * sizeof *kept);
  free(kept);
}

/* case: last weights times 0, +-1e3, 1e5, fused | plain code: inf/inf in colours | here: clamped as stage by stage |
 * bound: in [0, 1] */
/* Exponents of thousands, colours and alphas at both ends, deformations to the border: the fused passes' own
 * arithmetic. */
static void test_frame_of_saturated_networks(void **state) {
  (void)state;
  draw_times(0);
  draw_times(-1e3f);
  draw_times(1e3f);
  draw_times(1e5f);
}
/* case: last weights of one network times 1e20 and -1e37; all parameters times 1e5 and more | plain code: black frames
 * | here: one: drawn; all: refused, "the picture is not finite" | bound: in [0, 1] */
static void test_frame_of_overflowing_networks(void **state) {
  (void)state;
  draw_times(1e20f);
  draw_times(-1e37f);
  refuse_times(1e5f);
  refuse_times(1e20f);
  refuse_times(-1e37f);
}

/* case: attention whose sum over a ray is beyond floats | plain code: an infinite map | here: refused: "the attention
 * map is not finite" | bound: exact */
/* A head whose attention alone is beyond all floats: its map is refused where it is asked for. */
static void test_frame_of_an_attention_map_without_end(void **state) {
  (void)state;
  struct ern_model *model = portrait.model;
  const struct ern_field *f = &model->field;
  const size_t count = f->parameters;
  float *kept = malloc(count * sizeof *kept);
  assert_non_null(kept);
  memcpy(kept, model->block, count * sizeof *kept);
  for (int r = 0; r < f->density.width[1]; r++) /* which nothing else looks at */
    for (int c = 0; c < ERN_AUDIO_CODE; c++)
      model->block[f->density.weight[0] + (size_t)(r * f->density.width[0] + f->feature_rows + c)] = 0;
  const size_t values = (size_t)(f->attention.width[1] * f->attention.width[2]);
  for (size_t i = 0; i < values; i++) model->block[f->attention.weight[1] + i] = 4e36f;
  for (int k = 1; k < machines.count; k++)
    support_expect(machines.context, draw_changed(k), ERN_E_NONFINITE, "the attention map is not finite", NULL);
  memcpy(model->block, kept, count * sizeof *kept);
  free(kept);
}

/* case: cells of NaN density, thin ones left out | plain code: NaN >= 1 is false: empty | here: NaN counts as dense,
 * the frame is refused | bound: exact */
/* Cells whose density is NaN must not be taken for empty ones. Which cells are left out is found by plain C. */
static void test_frame_of_a_nan_after_thinning(void **state) {
  (void)state;
  struct ern_model *model = portrait.model;
  const int k = machines.count > 2 ? 2 : 1;
  float *weight = &model->block[model->field.density.weight[1]];
  const float kept = *weight, eye = 0;
  const ern_frame_input input = usual();
  ern_renderer *own = portrait.renderer[k];
  *weight = NAN;
  support_ok(machines.context, ern_renderer_create(&portrait.renderer[k], machines.backend[k], model, NULL));
  support_ok(machines.context,
             ern_renderer_prune_occupancy(portrait.renderer[k], portrait.windows, LENGTH, &eye, 1, 0.5f));
  support_expect(machines.context, draw(k, &input), ERN_E_NONFINITE, "the picture is not finite", NULL);
  ern_renderer_free(&portrait.renderer[k]);
  portrait.renderer[k] = own;
  *weight = kept;
}

/* ---- camera ---- */

/* case: focal NaN, 0, -1; centres NaN; 1e-45 to FLT_MAX | plain code: division by 0, endless loop | here: refused;
 * finite ones are drawn | bound: in [0, 1] */
static void test_frame_of_odd_intrinsics(void **state) {
  (void)state;
  static const float refused[] = {NAN, INFINITY, -INFINITY, 0, -1, -0.0f};
  static const float drawn[] = {FLT_TRUE_MIN, 1e-30f, 1e-10f, 1e-3f, 1e10f, 1e30f, FLT_MAX};
  for (size_t i = 0; i < COUNT_OF(refused); i++) {
    ern_frame_input input = usual();
    input.camera.focal = refused[i];
    expect_refused(&input, ERN_E_ARGUMENT, "focal", "camera");
    input = usual();
    if (isfinite(refused[i])) continue;
    input.camera.cx = refused[i];
    expect_refused(&input, ERN_E_ARGUMENT, "centre", "camera");
    input = usual();
    input.camera.cy = refused[i];
    expect_refused(&input, ERN_E_ARGUMENT, "centre", "camera");
  }
  for (size_t i = 0; i < COUNT_OF(drawn); i++) {
    ern_frame_input input = usual();
    input.camera.focal = drawn[i];
    expect_drawn(&input);
    input = usual();
    input.camera.cx = i % 2 == 0 ? drawn[i] : -drawn[i];
    expect_drawn(&input);
  }
}

/* case: sides 0, -1, 8193, INT_MIN, 1 x 1 | plain code: a product of sizes overflows | here: refused; 1 x 1 is drawn |
 * bound: exact */
static void test_frame_of_no_size(void **state) {
  (void)state;
  static const int sides[] = {0, -1, 8193, INT32_MAX, INT32_MIN};
  for (size_t i = 0; i < COUNT_OF(sides); i++) {
    ern_frame_input input = usual();
    input.camera.width = sides[i];
    expect_refused(&input, ERN_E_ARGUMENT, "size", "expected 1 to 8192");
    input = usual();
    input.camera.height = sides[i];
    expect_refused(&input, ERN_E_ARGUMENT, "size", "expected 1 to 8192");
  }
  ern_frame_input input = usual();
  input.camera.width = input.camera.height = 1;
  for (int k = 0; k < machines.count; k++) {
    support_ok(machines.context, draw(k, &input));
    all_within(k, "the pixel", portrait.rgb, 3, 0, 1);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_frame_of_the_usual_long),
      cmocka_unit_test(test_frame_of_the_mean_code),
      cmocka_unit_test(test_kept_frames_of_silent_and_huge_speech),
      cmocka_unit_test(test_frame_of_a_singular_pose),
      cmocka_unit_test(test_frame_of_a_pose_that_is_no_number),
      cmocka_unit_test(test_frame_of_mirrored_and_sheared_poses),
      cmocka_unit_test(test_frame_of_huge_poses),
      cmocka_unit_test(test_frame_from_inside_the_head),
      cmocka_unit_test(test_frame_of_silent_and_huge_speech),
      cmocka_unit_test(test_frame_of_speech_with_a_nan),
      cmocka_unit_test(test_frame_of_odd_eye_and_silence),
      cmocka_unit_test(test_frame_of_saturated_networks),
      cmocka_unit_test(test_frame_of_overflowing_networks),
      cmocka_unit_test(test_frame_of_an_attention_map_without_end),
      cmocka_unit_test(test_frame_of_a_nan_after_thinning),
      cmocka_unit_test(test_frame_of_odd_intrinsics),
      cmocka_unit_test(test_frame_of_no_size),
  };
  return cmocka_run_group_tests(tests, open_portrait, close_portrait);
}
