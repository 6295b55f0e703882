/* SPDX-License-Identifier: MIT
 * Pictures at their ends: enlarging, bytes, one picture over another, and what they are judged by (docs/numerics.md).
 */
#include "ernerf/render.h"
#include "machines.h"
#include "render/march_ops.h"
#include "render/picture_ops.h"
#include "render/upsample_ops.h"

static ern_rows rows_on(struct many span, int k, int rows, size_t n) {
  return (ern_rows){span.on[k], n, rows, ERN_PER_RAY};
}

/* A small picture of one channel, drawn larger. */
static struct many upsample(const float *small, int width, int height, int large_width, int large_height) {
  const size_t n = (size_t)width * (size_t)height, many = (size_t)large_width * (size_t)large_height;
  machines_clear();
  const struct many from = many_reals(small, n), to = many_empty(many);
  ON_EACH(upsample, ern_upsample_args,
          {.large = rows_on(to, k, 1, many),
           .small = rows_on(from, k, 1, n),
           .width = large_width,
           .height = large_height,
           .small_width = width,
           .small_height = height,
           .ratio = (float)width / (float)large_width})
  return to;
}

/* case: enlarging flat pictures of 1e-45 to -1e37, single pixels | plain code: weights do not sum to 1 | here: the
 * value | bound: 16 x 2^-23 */
/* The cubic's weights sum to 1 and none is above 1, so a picture of one value keeps it; a side of one pixel too. */
static void test_upsampled_single_pixels_and_flat_pictures(void **state) {
  (void)state;
  static const float values[] = {0, 1, 1e-38f, 1e30f, -1e37f, FLT_TRUE_MIN};
  static const int sides[][4] = {{1, 1, 1, 1}, {1, 1, 7, 5}, {2, 1, 9, 3}, {1, 3, 4, 11}, {5, 4, 33, 17}};
  for (size_t v = 0; v < COUNT_OF(values); v++) {
    for (size_t s = 0; s < COUNT_OF(sides); s++) {
      float small[20];
      for (size_t i = 0; i < 20; i++) small[i] = values[v];
      const struct many out = upsample(small, sides[s][0], sides[s][1], sides[s][2], sides[s][3]);
      const double size = fabs((double)values[v]), off = 16 * 0x1p-23 * size + 1.2e-38;
      expect_within("upsampled", out, (double)values[v] - off, (double)values[v] + off);
    }
  }
}

/* case: enlarging a NaN, infinity, 3e38 | plain code: spread over the picture | here: within 2 pixels of the small
 * picture | bound: exact */
/* A cubic over 4 x 4 pixels: a NaN or a huge one reaches 2 pixels of the small picture far, and no further. */
static void test_upsampled_nan_stays_near(void **state) {
  (void)state;
  static const float odd[] = {NAN, INFINITY, 3e38f};
  enum { S = 8, L = 32 };
  for (size_t o = 0; o < COUNT_OF(odd); o++) {
    float small[S * S];
    for (size_t i = 0; i < S * S; i++) small[i] = 0.5f;
    small[3 * S + 4] = odd[o];
    const struct many out = upsample(small, S, S, L, L);
    for (int k = 0; k < machines.count; k++) {
      double *values = many_values(k, out);
      bool reached = false;
      for (size_t i = 0; i < L * L; i++) {
        const double row = ((double)(i / L) + 0.5) / 4 - 0.5, column = ((double)(i % L) + 0.5) / 4 - 0.5;
        const double value = values[MACHINE_GUARD + i];
        const bool near = fabs(row - 3) < 2 && fabs(column - 4) < 2, usual = fabs(value - 0.5) < 1e-6;
        reached = reached || !usual;
        if (!near && !usual) fail_msg("%s: pixel %zu is %g", machines.name[k], i, value);
      }
      assert_true(reached);
      free(values);
    }
  }
}

/* case: bytes of +-1e30, infinity, NaN, -0, halves; opacities of 0, denormal, NaN | plain code: undefined conversion;
 * colour/0 | here: nearest of 0 to 255, ties to even, NaN 0 | bound: exact */
/* round(255 clamp(value, 0, 1)) of anything; what is not premultiplied is not divided by 0. */
static void test_bytes_of_odd_pixels(void **state) {
  (void)state;
  static const float values[] = {0,         -0.0f, 1,          1.0000001f, -1e30f,     1e30f,        INFINITY,
                                 -INFINITY, NAN,   0.5f / 255, 1.5f / 255, 2.5f / 255, FLT_TRUE_MIN, 254.5f / 255,
                                 0.25f,     2};
  enum { N = 19, VALUES = 16 };
  float pixel[3 * N], head[N], torso[N];
  for (size_t i = 0; i < N; i++) {
    for (size_t c = 0; c < 3; c++) pixel[c * N + i] = values[(i + c) % VALUES];
    head[i] = values[(i * 5 + 3) % VALUES], torso[i] = i % 3 == 0 ? 0 : values[(i * 7) % VALUES];
  }
  for (int opaque = 0; opaque < 2; opaque++) {
    machines_clear();
    const struct many at = many_reals(pixel, 3 * N), heads = many_reals(head, N), torsos = many_reals(torso, N);
    const struct many rgba = many_of(ERN_ELEMENT_BYTE, NULL, 4 * N);
    ON_EACH(picture, ern_picture_args,
            {.rgba = rgba.on[k],
             .pixel = rows_on(at, k, 3, N),
             .head = opaque ? (ern_span){0} : heads.on[k],
             .torso = opaque ? (ern_span){0} : torsos.on[k],
             .n = N})
    uint8_t truth[4 * N], found[4 * N];
    for (int k = 0; k < machines.count; k++) {
      support_ok(machines.context,
                 machines.backend[k]->download_bytes(machines.stream[k], k == 0 ? truth : found, rgba.on[k], 4 * N));
      for (size_t i = 0; k > 0 && i < 4 * N; i++)
        if (found[i] != truth[i])
          fail_msg("%s: byte %zu of pixel %zu is %d, expected %d", machines.name[k], i % 4, i / 4, found[i], truth[i]);
    }
    for (size_t i = 0; opaque == 1 && i < N; i++) {
      const float value = values[i % VALUES];
      const int expected = value >= 1 ? 255 : value > 0 ? (int)lrintf(255 * value) : 0;
      if (truth[4 * i] != expected) fail_msg("%g is %d, expected %d", (double)value, truth[4 * i], expected);
      assert_int_equal(truth[4 * i + 3], 255);
    }
  }
}

/* case: overlay of opacities 1.0000002, -0.001, 1e30, NaN | plain code: light from nowhere | here: in [0, 1]; NaN stays
 * one | bound: 4 x 2^-23 */
/* Opacities beyond both ends, colours of any size, and a NaN, which stays one. */
static void test_overlay_of_odd_values(void **state) {
  (void)state;
  static const float values[] = {0, 1, 1.0000002f, -0.001f, 1e30f, -1e30f, FLT_TRUE_MIN, NAN, 0.5f};
  enum { N = 37, VALUES = 9 };
  float colour[3 * N], opacity[N], background[3 * N];
  for (size_t i = 0; i < N; i++) opacity[i] = values[i % VALUES];
  for (size_t i = 0; i < 3 * N; i++) colour[i] = values[(i * 4 + 1) % (VALUES - 2)], background[i] = 0.25f;
  machines_clear();
  const struct many from = many_reals(colour, 3 * N), alpha = many_reals(opacity, N);
  const struct many back = many_reals(background, 3 * N), to = many_empty(3 * N);
  ON_EACH(overlay, ern_overlay_args,
          {.pixel = rows_on(to, k, 3, N),
           .colour = rows_on(from, k, 3, N),
           .opacity = alpha.on[k],
           .background = rows_on(back, k, 3, N),
           .n = N})
  expect_truth("pixel", to, 4 * 0x1p-23, 0x1p-23);
  for (size_t i = 0; i < N; i++) {
    double *truth = many_values(0, to);
    const double value = truth[MACHINE_GUARD + i];
    free(truth);
    if (isnan(opacity[i]) ? !isnan(value) : !(value >= 0 && value <= 1)) fail_msg("pixel %zu is %g", i, value);
  }
}

/* ---- evaluation ---- */

/* case: PSNR and SSIM of equal, black, broken pictures | plain code: log of 0; a NaN gives 100 dB | here: 100 dB and 1;
 * a NaN is NaN | bound: 1e-12 */
/* Equal pictures are 100 dB and an SSIM of 1; a NaN anywhere is a NaN, which is no agreement. */
static void test_metrics_of_equal_and_broken_pictures(void **state) {
  (void)state;
  enum { SIDE = 16, VALUES = 3 * SIDE * SIDE };
  static const float odd[] = {NAN, INFINITY, 1e30f};
  float rgb[VALUES];
  uint8_t truth[VALUES];
  double ssim = 0;
  for (size_t i = 0; i < VALUES; i++) truth[i] = (uint8_t)(i * 7 % 256), rgb[i] = (float)truth[i] / 255;
  assert_true(ern_psnr(rgb, truth, SIDE, SIDE, NULL) == 100);
  support_ok(machines.context, ern_ssim(machines.context, rgb, truth, SIDE, SIDE, &ssim));
  assert_true(fabs(ssim - 1) < 1e-5);
  for (size_t i = 0; i < VALUES; i++) rgb[i] = 0, truth[i] = 0; /* no variance on either side: 0/0 without constants */
  support_ok(machines.context, ern_ssim(machines.context, rgb, truth, SIDE, SIDE, &ssim));
  assert_true(fabs(ssim - 1) < 1e-12);
  for (size_t o = 0; o < COUNT_OF(odd); o++) {
    rgb[VALUES / 2] = odd[o];
    const double psnr = ern_psnr(rgb, truth, SIDE, SIDE, NULL);
    support_ok(machines.context, ern_ssim(machines.context, rgb, truth, SIDE, SIDE, &ssim));
    if (o == 0) assert_true(isnan(psnr) && isnan(ssim));
    if (o == 1) assert_true(psnr == -INFINITY && isnan(ssim));
    if (o == 2) assert_true(psnr < -500 && isfinite(psnr) && ssim > -1 && ssim < 1);
  }
}

/* ---- cameras and paths ---- */

/* case: cameras of 1 x 1, 1 x 8192, resized | plain code: centres off | here: the centre stays, at whole pixels;
 * directions of length 1 | bound: half a pixel; 1e-6 */
static void test_cameras_of_one_pixel_and_resized(void **state) {
  (void)state;
  const ern_camera camera = {.focal = 1000, .cx = 225, .cy = 225, .width = 450, .height = 450};
  static const int sides[][2] = {{1, 1}, {1, 8192}, {8192, 1}, {8192, 8192}, {449, 451}};
  for (size_t s = 0; s < COUNT_OF(sides); s++) {
    const ern_camera out = ern_camera_resized(&camera, sides[s][0], sides[s][1]);
    assert_int_equal(out.width, sides[s][0]);
    const int least = sides[s][0] < sides[s][1] ? sides[s][0] : sides[s][1];
    assert_true(fabsf(out.focal - 1000 * (float)least / 450) <= 4 * 0x1p-23f * out.focal);
    /* the frame is placed at whole pixels */
    assert_true(fabsf(out.cx - (float)sides[s][0] / 2) <= 0.501f && fabsf(out.cy - (float)sides[s][1] / 2) <= 0.501f);
    float direction[3];
    const struct ern_view view = {.pose = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1},
                                  .focal = out.focal,
                                  .cx = out.cx,
                                  .cy = out.cy,
                                  .width = out.width,
                                  .height = out.height};
    const int32_t last = (int32_t)((size_t)out.width * (size_t)out.height - 1);
    machines_clear();
    const struct many pixel = many_int32s(&last, 1), dir = many_empty(3);
    ON_EACH(rays, ern_rays_args, {.dir = rows_on(dir, k, 3, 1), .pixel = pixel.on[k], .view = view, .n = 1})
    expect_within("direction", dir, -1 - 1e-6, 1 + 1e-6);
    for (int k = 0; k < machines.count; k++) {
      double *d = many_values(k, dir) + MACHINE_GUARD;
      for (size_t a = 0; a < 3; a++) direction[a] = (float)d[a];
      free(d - MACHINE_GUARD);
      assert_true(fabsf(sqrtf(direction[0] * direction[0] + direction[1] * direction[1] + direction[2] * direction[2]) -
                        1) < 1e-6f);
    }
  }
}

/* case: paths of matrices of NaN, infinity, 0; of half a turn | plain code: a mean that is no rotation | here: refused
 * with the frame's number; the path is as it was | bound: exact */
/* The mean of rotations that have none, and of matrices that are none: refused, and the path is as it was. */
static void test_path_of_rotations_without_a_mean(void **state) {
  (void)state;
  static const float odd[] = {NAN, INFINITY, 0, 1e30f};
  for (size_t o = 0; o < COUNT_OF(odd); o++) {
    ern_pose poses[3] = {0}, before[3];
    for (size_t p = 0; p < 3; p++)
      for (size_t i = 0; i < 4; i++) poses[p].matrix[5 * i] = 1;
    for (size_t i = 0; i < 11; i++) poses[1].matrix[i] = odd[o];
    memcpy(before, poses, sizeof poses);
    support_expect(machines.context, ern_poses_smooth(machines.context, poses, 3, 1), ERN_E_FORMAT, "smooth path",
                   NULL);
    assert_memory_equal(before, poses, sizeof poses);
  }
  ern_pose poses[2] = {{.matrix = {1, 0, 0, 1e30f, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}},
                       {.matrix = {-1, 0, 0, -1e30f, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}}}; /* half a turn apart */
  support_expect(machines.context, ern_poses_smooth(machines.context, poses, 2, 3), ERN_E_FORMAT, "have no mean", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_upsampled_single_pixels_and_flat_pictures),
      cmocka_unit_test(test_upsampled_nan_stays_near),
      cmocka_unit_test(test_bytes_of_odd_pixels),
      cmocka_unit_test(test_overlay_of_odd_values),
      cmocka_unit_test(test_metrics_of_equal_and_broken_pictures),
      cmocka_unit_test(test_cameras_of_one_pixel_and_resized),
      cmocka_unit_test(test_path_of_rotations_without_a_mean),
  };
  return cmocka_run_group_tests(tests, open_machines, close_machines);
}
