/* SPDX-License-Identifier: MIT
 * Whole frames against PyTorch: the head over the true torso, head and torso over the background, the head's opacity;
 * for every instruction set that the machine has and OpenCL. The frames are left as PNG in the working folder, to be
 * looked at. */
#include "parity/parity.h"

/* parity's README: 2/255 at every pixel, 1/4096 in the mean. */
static double most_allowed(void) { return 2.0 / 255; }
static double mean_allowed(void) { return 1.0 / 4096; }

static void compare(const struct parity *p, const char *name, int k, const float *found, size_t count) {
  char file[64];
  struct ern_npy expected;
  snprintf(file, sizeof file, "val%d_%s.npy", k, name);
  parity_npy(p->context, file, &expected);
  assert_int_equal(expected.count, count);
  double most = 0, sum = 0;
  for (size_t i = 0; i < count; i++) {
    const double d = fabs((double)found[i] - (double)((const float *)expected.data)[i]);
    most = d > most ? d : most;
    sum += d;
  }
  print_message("%s frame %d: most %.6f, mean %.8f\n", name, k, most, sum / (double)count);
  assert_true(most <= most_allowed());
  assert_true(sum / (double)count <= mean_allowed());
  ern_npy_free(p->context, &expected);
}

static void render(const struct parity *p, ern_renderer *renderer, int k, bool torso_model, const char *isa) {
  const size_t pixels = (size_t)p->data.width * (size_t)p->data.height;
  float *windows = parity_windows(p, 1, (size_t)k), *rgb = (float *)calloc(3 * pixels, sizeof *rgb),
        *opacity = (float *)calloc(pixels, sizeof *opacity);
  uint8_t *rgba = (uint8_t *)calloc(4 * pixels, 1);
  ern_image truth, torso;
  support_ok(p->context, ern_clip_pixels(p->clip, ERN_SPLIT_VAL, (size_t)k, &truth, &torso));
  const ern_frame_input input = {.camera = parity_camera(p, 1, (size_t)k),
                                 .windows = windows,
                                 .window_length = p->data.features->window_length,
                                 .eye = ern_clip_frame_at(p->clip, ERN_SPLIT_VAL, (size_t)k)->eye,
                                 .background = p->data.background,
                                 .torso = torso_model ? NULL : torso.data};
  const ern_frame_output output = {.rgb = rgb, .opacity = opacity, .rgba = rgba};
  support_ok(p->context, ern_renderer_frame(renderer, &input, &output, NULL));
  compare(p, torso_model ? "head_and_torso" : "head_over_gt_torso", k, rgb, 3 * pixels);
  compare(p, "weights_sum", k, opacity, pixels);
  char file[128];
  snprintf(file, sizeof file, "val%d_%s_%s.png", k, torso_model ? "head_and_torso" : "head", isa);
  support_ok(p->context, ern_image_write(p->context, file, &(ern_image){p->data.width, p->data.height, 4, rgba}, 95));
  free(windows), free(rgb), free(opacity), free(rgba);
}

static void frames(const char *model, bool torso, const char *isa) {
  struct parity p;
  ern_renderer *renderer = NULL;
  parity_open(&p, model, isa);
  support_ok(p.context, ern_renderer_create(&renderer, p.backend, p.model, NULL));
  for (int k = 0; k < 3; k++) render(&p, renderer, k, torso, isa);
  ern_renderer_free(&renderer);
  parity_close(&p);
}

static void every_isa(const char *model, bool torso) {
  for (int k = 0; parity_isa(k) != NULL; k++) frames(model, torso, parity_isa(k));
}

static void test_head(void **state) {
  (void)state;
  every_isa("head.safetensors", false);
}

static void test_head_and_torso(void **state) {
  (void)state;
  every_isa("head_torso.safetensors", true);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_head), cmocka_unit_test(test_head_and_torso)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
