/* SPDX-License-Identifier: MIT
 * What bf16 costs a rendered frame: its PSNR against the truth with layers in float less that with layers in pairs of
 * bf16, and how far apart the two pictures are. Where AVX512_BF16 is missing its emulation renders; the price is the
 * same, bit for bit. With the environment's ERNERF_TEST_MODEL and ERNERF_TEST_CLIP: of that model and clip, over
 * ERNERF_TEST_FRAMES validation frames (6).
 */
#include <math.h>

#include "backend_cpu/cpu_state.h"
#include "core/cpu.h"
#include "ernerf/ernerf.h"
#include "ernerf/media.h"
#include "kernelcheck/bf16_kernels.h"
#include "support.h"

/* Below this much bf16 may be chosen unasked (backend/registry.c). */
static double most_allowed(void) { return 0.05; }

#if defined(ERN_X86_KERNELS)

struct viewer {
  ern_context *context;
  ern_clip *clip;
  ern_dataset data;
  bool has_torso_images;
  ern_model *model;
  ern_model_info info;
  ern_backend *backend[2]; /* floats, pairs of bf16 */
  ern_renderer *renderer[2];
  float *windows, *rgb[2];
  size_t values; /* of a picture */
};

static void make_backend(struct viewer *v, int k, const char *isa) {
  ern_backend_config config = ern_backend_config_default();
  config.isa = isa;
  support_ok(v->context, ern_backend_create(&v->backend[k], v->context, &config));
}

static void viewer_open(struct viewer *v, const char *model, const char *clip) {
  const ern_clip_options options = ern_clip_options_default();
  ern_clip_info info;
  *v = (struct viewer){.context = support_context()};
  support_ok(v->context, ern_clip_open(v->context, clip, &options, &v->clip));
  ern_clip_describe(v->clip, &info);
  v->has_torso_images = info.has_torso;
  ern_clip_dataset(v->clip, &v->data);
  support_ok(v->context, ern_model_load(&v->model, v->context, model));
  ern_model_describe(v->model, &v->info);
  make_backend(v, 0, "avx512");
  if (ern_isa_available(ERN_ISA_AVX512BF16)) {
    make_backend(v, 1, "avx512bf16");
  } else {
    make_backend(v, 1, "avx512");
    struct ern_cpu_backend *cpu = (struct ern_cpu_backend *)v->backend[1];
    cpu->render_worker = ern_render_worker_bf16_emulated;
    cpu->render_pairs = true;
  }
  const ern_features *features = v->data.features;
  v->values = 3 * (size_t)v->data.width * (size_t)v->data.height;
  v->windows = (float *)calloc(8 * (size_t)features->window_length * (size_t)features->width, sizeof *v->windows);
  assert_non_null(v->windows);
  for (int k = 0; k < 2; k++) {
    support_ok(v->context, ern_renderer_create(&v->renderer[k], v->backend[k], v->model, NULL));
    v->rgb[k] = (float *)calloc(v->values, sizeof *v->rgb[k]);
    assert_non_null(v->rgb[k]);
  }
}

static void viewer_close(struct viewer *v) {
  for (int k = 0; k < 2; k++) {
    ern_renderer_free(&v->renderer[k]);
    ern_backend_free(&v->backend[k]);
    free(v->rgb[k]);
  }
  free(v->windows);
  ern_model_free(&v->model);
  ern_clip_free(&v->clip);
  ern_context_free(&v->context);
}

/* Both pictures of validation frame `index`. */
static void look(struct viewer *v, size_t index, ern_image *truth) {
  const ern_clip_frame *frame = ern_clip_frame_at(v->clip, ERN_SPLIT_VAL, index);
  ern_image torso = {0};
  support_ok(v->context, ern_clip_pixels(v->clip, ERN_SPLIT_VAL, index, truth, v->has_torso_images ? &torso : NULL));
  ern_audio_windows(v->windows, v->data.features, frame->pose.aud_id, ERN_AUDIO_PAD_EDGE);
  ern_camera camera = {.focal = (float)v->data.focal,
                       .cx = (float)v->data.cx,
                       .cy = (float)v->data.cy,
                       .width = v->data.width,
                       .height = v->data.height};
  ern_camera_pose(camera.pose, frame->pose.matrix, v->data.scale);
  const ern_frame_input input = {.camera = camera,
                                 .windows = v->windows,
                                 .window_length = v->data.features->window_length,
                                 .eye = frame->eye,
                                 .background = v->data.background,
                                 .torso = v->info.has_torso ? NULL : torso.data};
  for (int k = 0; k < 2; k++) {
    const ern_frame_output output = {.rgb = v->rgb[k]};
    support_ok(v->context, ern_renderer_frame(v->renderer[k], &input, &output, NULL));
  }
}

/* The mean price of `frames` validation frames, evenly spread, in dB. */
static double price_of(const char *model, const char *clip, size_t frames) {
  struct viewer v;
  viewer_open(&v, model, clip);
  if (frames > v.data.frames[1]) frames = v.data.frames[1];
  double sum[2] = {0}, worst = -INFINITY, most = 0, square = 0;
  for (size_t f = 0; f < frames; f++) {
    ern_image truth;
    look(&v, f * v.data.frames[1] / frames, &truth);
    double psnr[2];
    for (int k = 0; k < 2; k++) {
      psnr[k] = ern_psnr(v.rgb[k], truth.data, v.data.width, v.data.height, NULL);
      sum[k] += psnr[k];
    }
    worst = fmax(worst, psnr[0] - psnr[1]);
    for (size_t i = 0; i < v.values; i++) {
      const double off = (double)v.rgb[1][i] - (double)v.rgb[0][i];
      most = fmax(most, fabs(off));
      square += off * off / (double)v.values;
    }
  }
  const double n = (double)frames, price = (sum[0] - sum[1]) / n;
  print_message(
      "%s, %zu frames: %.4f dB in float; bf16 costs %.4f dB, the worst frame %.4f dB; the pictures are "
      "%.1f dB apart, at most %.2f/255\n",
      model, frames, sum[0] / n, price, worst, -10 * log10(square / n), 255 * most);
  assert_true(square > 0); /* they are not the same renderer */
  viewer_close(&v);
  return price;
}

static void price_of_shared(const char *model) {
  char file[1024], clip[1024], name[128];
  if (!ern_isa_available(ERN_ISA_AVX512)) skip();
  snprintf(name, sizeof name, "parity/%s", model);
  support_shared(name, file);
  support_shared("parity/clip", clip);
  assert_true(fabs(price_of(file, clip, 6)) < most_allowed());
}

/* case: a head's picture in bf16 | plain code: each rounding of 2^-9 adds up | here: products of bf16 pairs, sums in
 * float | bound: 0.05 dB of the picture's PSNR */
static void test_bf16_price_of_a_head(void **state) {
  (void)state;
  price_of_shared("head.safetensors");
}
/* case: head and torso, the same | plain code: the same | here: the same | bound: 0.05 dB */
static void test_bf16_price_of_head_and_torso(void **state) {
  (void)state;
  price_of_shared("head_torso.safetensors");
}
static void price_of_given(void **state) {
  (void)state;
  const char *frames = getenv("ERNERF_TEST_FRAMES");
  (void)price_of(getenv("ERNERF_TEST_MODEL"), getenv("ERNERF_TEST_CLIP"), frames != NULL ? (size_t)atoi(frames) : 6);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_bf16_price_of_a_head),
                                     cmocka_unit_test(test_bf16_price_of_head_and_torso)};
  const struct CMUnitTest one[] = {cmocka_unit_test(price_of_given)};
  const bool given = getenv("ERNERF_TEST_MODEL") != NULL && getenv("ERNERF_TEST_CLIP") != NULL;
  return given ? cmocka_run_group_tests(one, NULL, NULL) : cmocka_run_group_tests(tests, NULL, NULL);
}

#else
int main(void) {
  print_message("this build has no kernels for AVX-512; bf16 is chosen below %.2f dB\n", most_allowed());
  return 0;
}
#endif
