/* SPDX-License-Identifier: MIT
 * Each allocation of the context that is refused, in turn, on whole ways: a head trained with saves and a validation,
 * gone on from, a torso under it, a model loaded, drawn and converted, videos joined. The answer is ERN_E_NO_MEMORY
 * with its words, or it does with less; nothing is left over in memory, what lies on the disk is whole, and the next
 * try goes on from it. And each allocation of the JSON library while a converted model is written, and while the
 * program describes one.
 *
 *   ERNERF_TEST_CALLS=1   every allocation, not one of many (0)
 *   ERNERF_TEST_SEED=7    of those that are taken (1) */
#define _GNU_SOURCE /* RTLD_NEXT */
#include <dlfcn.h>
#include <errno.h>
#include <jansson.h>

#include "../made_clip.h"
#include "core/memory.h"
#include "ernerf/media.h"
#include "journey.h"
#include "model/model.h"

static struct made data; /* its context and backend are not used */

static ern_status open_made(ern_context *context, ern_backend **backend) {
  return ern_backend_create(backend, context, NULL);
}

static ern_status train_with(ern_context *context, ern_train_config *config) {
  ern_backend *backend = NULL;
  ern_trainer *trainer = NULL;
  ern_status status = open_made(context, &backend);
  if (status == ERN_OK) status = ern_trainer_create(&trainer, backend, &data.data, config);
  if (status == ERN_OK) status = ern_trainer_run(trainer, NULL);
  ern_trainer_free(&trainer);
  ern_backend_free(&backend);
  return status;
}

static ern_status way_train(ern_context *context) {
  ern_train_config config = small_config(3, "short.safetensors");
  config.save_every = 1;
  config.validate_every = 2;
  return train_with(context, &config);
}

static ern_status way_resume(ern_context *context) {
  ern_train_config config = small_config(5, "short.safetensors");
  config.save_every = 1;
  config.resume = true;
  return train_with(context, &config);
}

static ern_status way_torso(ern_context *context) {
  ern_train_config config = small_config(2, "body.safetensors");
  ern_model *head = NULL;
  config.torso = true;
  ern_status status = ern_model_load(&head, context, "kept.safetensors");
  config.head = head;
  if (status == ERN_OK) status = train_with(context, &config);
  ern_model_free(&head);
  return status;
}

static ern_status way_from(ern_context *context) {
  ern_train_config config = small_config(2, NULL);
  config.from = "kept.pth";
  config.codes = 10000; /* as many as the public program has */
  return train_with(context, &config);
}

static ern_status way_render(ern_context *context) {
  static float rgb[SIDE * SIDE * 3];
  ern_backend *backend = NULL;
  ern_model *model = NULL;
  ern_renderer *renderer = NULL;
  ern_dataset_frame frame;
  ern_camera camera = {.focal = 48, .cx = SIDE / 2, .cy = SIDE / 2, .width = SIDE, .height = SIDE};
  static float windows[8 * 16 * WIDTH];
  (void)made_frame(&data, 0, 1, &frame);
  ern_camera_pose(camera.pose, frame.matrix, 4);
  ern_audio_windows(windows, &data.features, 1, ERN_AUDIO_PAD_EDGE);
  const ern_frame_input input = {
      .camera = camera, .windows = windows, .window_length = 16, .background = data.background};
  const ern_frame_output output = {.rgb = rgb};
  ern_status status = open_made(context, &backend);
  if (status == ERN_OK) status = ern_model_load(&model, context, "portrait.safetensors");
  if (status == ERN_OK) status = ern_renderer_create(&renderer, backend, model, NULL);
  if (status == ERN_OK) status = ern_renderer_prune_occupancy(renderer, windows, 16, (float[]){0}, 1, 0.01f);
  if (status == ERN_OK) status = ern_renderer_reuse_rays(renderer, windows, 16, (float[]){0}, 1, 0);
  for (int k = 0; k < 2 && status == ERN_OK; k++) status = ern_renderer_frame(renderer, &input, &output, NULL);
  ern_renderer_free(&renderer);
  ern_model_free(&model);
  ern_backend_free(&backend);
  return status;
}

/* Two videos to one with sound. */
static ern_status way_join(ern_context *context) {
  static const char *const segments[] = {"one.mp4", "two.mp4"};
  static int16_t samples[1600];
  const ern_sound sound = {.rate = 16000, .channels = 1, .frames = 1600, .data = samples};
  return ern_video_join(context, "joined.mp4", segments, 2, &sound, 0);
}

static ern_status way_convert(ern_context *context) {
  ern_status status = ern_file_convert(context, "portrait.safetensors", "there.pth");
  if (status == ERN_OK) status = ern_file_convert(context, "there.pth", "back.safetensors");
  return status;
}

static const struct {
  const char *name;
  ern_status (*go)(ern_context *context);
  const char *outputs[4]; /* files that are whole whatever happened */
} ways[] = {{"train", way_train, {"short.safetensors", "short.run/state.safetensors"}},
            {"resume", way_resume, {"short.safetensors", "short.run/state.safetensors"}},
            {"torso", way_torso, {"body.safetensors", "body.run/state.safetensors"}},
            {"from a .pth", way_from, {NULL}},
            {"render", way_render, {NULL}},
            {"convert", way_convert, {"there.pth", "back.safetensors"}},
            {"join", way_join, {NULL}}};

static void expect_whole(ern_context *context, size_t way, size_t at) {
  char left[1024];
  for (const char *const *path = ways[way].outputs; *path != NULL; path++) {
    ern_model *model = NULL;
    if (journey_there(*path) && ern_model_load(&model, context, *path) != ERN_OK)
      fail_msg("%s, allocation %zu: %s", ways[way].name, at, ern_last_error(context));
    ern_model_free(&model);
  }
  if (journey_leftovers(".", "", left) > 0) fail_msg("%s, allocation %zu: %s is left over", ways[way].name, at, left);
}

/* Starts each try from the same files. */
static void reset(size_t way) {
  if (ways[way].go != way_resume) return;
  clear_run("short");
  ern_context *context = support_context();
  support_ok(context, way_train(context));
  ern_context_free(&context);
}

static void refuse_each(size_t way, size_t most) {
  struct support_meter meter = {0};
  const uint32_t all = journey_number("ERNERF_TEST_CALLS", 0), seed = journey_number("ERNERF_TEST_SEED", 1);
  ern_context *plain = support_context(), *context = support_metered_context(&meter);
  const size_t empty = meter.now;
  size_t refused = 0, without = 0;
  reset(way);
  meter.count = 0;
  support_ok(context, ways[way].go(context));
  const size_t count = meter.count, stride = all != 0 || count <= most ? 1 : count / most + 1;
  for (size_t at = 1 + journey_random(seed, (uint32_t)way, (uint32_t)stride); at <= count; at += stride) {
    if (at % (8 * stride) <= stride) reset(way);
    meter.count = 0;
    meter.refuse_at = at;
    const ern_status status = ways[way].go(context);
    meter.refuse_at = 0;
    if (status != ERN_OK && (status != ERN_E_NO_MEMORY || ern_last_error(context)[0] == 0))
      fail_msg("%s, allocation %zu: %s: %s", ways[way].name, at, ern_status_name(status), ern_last_error(context));
    if (meter.now != empty) fail_msg("%s, allocation %zu: %zu bytes are left", ways[way].name, at, meter.now - empty);
    refused += status != ERN_OK;
    without += status == ERN_OK;
    expect_whole(plain, way, at);
  }
  support_ok(context, ways[way].go(context)); /* and then it works */
  assert_int_equal(meter.now, empty);
  assert_true(refused > 0);
  print_message("%s: %zu allocations, %zu refused: ERN_E_NO_MEMORY; %zu done without\n", ways[way].name, count, refused,
                without);
  ern_context_free(&context);
  ern_context_free(&plain);
}

static void test_train(void **state) { (void)state, refuse_each(0, 2); }
static void test_resume_long(void **state) { (void)state, refuse_each(1, 2); }
static void test_torso(void **state) { (void)state, refuse_each(2, 3); }
static void test_from_long(void **state) { (void)state, refuse_each(3, 2); }
static void test_render(void **state) { (void)state, refuse_each(4, 1); }
static void test_convert(void **state) { (void)state, refuse_each(5, 8); }

static void test_join(void **state) { (void)state, refuse_each(6, 20); }

static void make_video(const char *path) {
  static uint8_t rgba[SIDE * SIDE * 4];
  ern_video_options options = ern_video_options_default(SIDE, SIDE);
  const ern_provenance made = ern_provenance_default(); /* which the whole takes over */
  ern_video_writer *writer = NULL;
  options.provenance = &made;
  support_ok(data.context, ern_video_writer_open(data.context, path, &options, &writer));
  for (int k = 0; k < 2; k++) support_ok(data.context, ern_video_writer_frame(writer, rgba));
  support_ok(data.context, ern_video_writer_close(&writer));
}

/* ---- the JSON library's own allocations -------------------------------------------------------------------------- */

static json_malloc_t json_given; /* of whoever uses the library */
static size_t json_at, json_count;
static bool json_counts;

/* Refuses as the C library does, so that whoever watches notices. */
static void *json_refusing(size_t bytes) {
  return json_given(json_counts && ++json_count == json_at ? (size_t)PTRDIFF_MAX : bytes);
}

/* In place of the JSON library's, also for the program's code in this executable. */
void json_set_alloc_funcs(json_malloc_t allocate, json_free_t release) {
  void (*real)(json_malloc_t, json_free_t) = NULL;
  void *found = dlsym(RTLD_NEXT, "json_set_alloc_funcs");
  memcpy(&real, &found, sizeof real);
  json_given = allocate;
  real(json_refusing, release);
}

static void refuse_json_from(size_t at) {
  json_at = at;
  json_count = 0;
  json_counts = at > 0;
}

/* The first line of the log comes between reading and writing. */
static void begin_to_count(void *user, ern_log_level level, const char *line) {
  (void)user, (void)level, (void)line;
  json_counts = json_at > 0;
}

static void test_json_of_a_model(void **state) {
  (void)state;
  ern_context *context = NULL, *plain = support_context();
  ern_context_config config = ern_context_config_default();
  char good[65], made[65];
  size_t refused = 0;
  config.log = begin_to_count;
  assert_int_equal(ern_context_create(&context, &config), ERN_OK);
  json_set_alloc_funcs(malloc, free);
  support_ok(plain, ern_file_convert(plain, "kept.run/state.safetensors", "good.pth"));
  support_ok(plain, ern_file_sha256(plain, "good.pth", good));
  for (size_t at = 1; at == 1 || json_count >= json_at; at += journey_number("ERNERF_TEST_CALLS", 0) != 0 ? 1 : 97) {
    refuse_json_from(at);
    json_counts = false;
    const ern_status status = ern_file_convert(context, "kept.run/state.safetensors", "made.pth");
    json_counts = false;
    if (status != ERN_OK && (status != ERN_E_NO_MEMORY || ern_last_error(context)[0] == 0))
      fail_msg("JSON allocation %zu: %s: %s", at, ern_status_name(status), ern_last_error(context));
    refused += status != ERN_OK;
    if (status != ERN_OK) continue;
    support_ok(plain, ern_file_sha256(plain, "made.pth", made));
    if (strcmp(made, good) != 0) fail_msg("JSON allocation %zu: another file, and no error", at);
  }
  assert_true(refused > 10);
  refuse_json_from(0);
  ern_context_free(&context);
  ern_context_free(&plain);
}

static void test_json_of_metadata(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_model *model = NULL;
  char *good = NULL, *text = NULL;
  json_set_alloc_funcs(malloc, free);
  support_ok(context, ern_model_load(&model, context, "portrait.safetensors"));
  support_ok(context, ern_model_metadata(model, &good));
  size_t refused = 0;
  for (size_t at = 1; at == 1 || json_count >= json_at; at++) {
    refuse_json_from(at);
    const ern_status status = ern_model_metadata(model, &text);
    json_counts = false;
    refused += status != ERN_OK;
    if (status == ERN_OK && strcmp(text, good) != 0) fail_msg("JSON allocation %zu: no error, but %s", at, text);
    if (status == ERN_OK) ern_release(context, text);
  }
  assert_true(refused > 10);
  refuse_json_from(0);
  ern_release(context, good);
  ern_model_free(&model);
  ern_context_free(&context);
}

static void test_json_of_the_program(void **state) {
  (void)state;
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  skip(); /* a sanitizer's malloc ends the process instead of refusing */
#endif
  static const size_t tries[] = {1, 40, 300};
  struct journey j;
  journey_open(&j);
  for (size_t i = 0; i < sizeof tries / sizeof *tries; i++) {
    refuse_json_from(tries[i]);
    journey_start(&j, NULL, "info portrait.safetensors");
    journey_wait(&j);
    refuse_json_from(0);
    if (j.status != 1 || j.err[0] == 0) fail_msg("JSON allocation %zu: exit status %d: %s", tries[i], j.status, j.err);
  }
  journey_ok(&j, "info portrait.safetensors");
}

/* ---- all --------------------------------------------------------------------------------------------------------- */

static int prepare(void **state) {
  (void)state;
  static const char *const old[] = {"short", "body", "kept", "portrait"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) clear_run(old[i]);
  made_open(&data);
  ern_train_config config = small_config(2, "kept.safetensors");
  ern_model *head = NULL;
  support_ok(data.context, train(&data, &config, NULL));
  support_ok(data.context, ern_model_load(&head, data.context, "kept.safetensors"));
  config.output = "portrait.safetensors";
  config.torso = true;
  config.head = head;
  support_ok(data.context, train(&data, &config, NULL));
  ern_model_free(&head);
  support_ok(data.context, ern_file_convert(data.context, "kept.safetensors", "kept.pth"));
  make_video("one.mp4");
  make_video("two.mp4");
  return 0;
}

static int close_all(void **state) {
  (void)state;
  made_close(&data);
  return 0;
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_train),
                                     cmocka_unit_test(test_resume_long),
                                     cmocka_unit_test(test_torso),
                                     cmocka_unit_test(test_from_long),
                                     cmocka_unit_test(test_render),
                                     cmocka_unit_test(test_convert),
                                     cmocka_unit_test(test_join),
                                     cmocka_unit_test(test_json_of_a_model),
                                     cmocka_unit_test(test_json_of_metadata),
                                     cmocka_unit_test(test_json_of_the_program)};
  return cmocka_run_group_tests(tests, prepare, close_all);
}
