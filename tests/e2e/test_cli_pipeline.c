/* SPDX-License-Identifier: MIT
 * Rendering reads, draws and writes in threads of their own: frames in order, the same bytes however they are made, an
 * error on either side in words, and little memory. */
#define _GNU_SOURCE /* sched_setaffinity */
#include "cli.h"

#include <math.h>
#include <sched.h>
#include <time.h>

#include "ernerf/media.h"
#include "io/npy.h"

enum { SIZE = 64, FRAMES = 11, PIXEL_BYTES = SIZE * SIZE * 4 };

static struct cli cli;

static int make_clip(void **state) {
  (void)state;
  static const char *const old[] = {"clip", "head.safetensors", "head.run", "torso.safetensors", "torso.run"};
  for (size_t i = 0; i < sizeof old / sizeof old[0]; i++) support_clear(old[i]);
  cli_run(&cli, "synth clip --size %d --frames %d --seed 5 --quiet", SIZE, FRAMES);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli,
          "train clip -o head.safetensors --iters 20 --rays 256 --levels 4 --lr-net 0.004 --validate-frames 1 --quiet");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli,
          "train clip --torso --head head.safetensors -o torso.safetensors --iters 4 --rays 256 --validate-frames 1 "
          "--quiet");
  cli_expect(&cli, 0, NULL);
  return 0;
}

/* What `render ... -o -` writes; the caller frees it. */
static uint8_t *raw(const char *words, size_t bytes) {
  size_t count = 0;
  cli_run(&cli, "render %s -o - --quiet", words);
  cli_expect(&cli, 0, NULL);
  uint8_t *pixels = cli_bytes("cli_out.txt", &count);
  if (count != bytes) fail_msg("ernerf %s\n%zu bytes, expected %zu", cli.line, count, bytes);
  return pixels;
}

/* ---- bytes ------------------------------------------------------------------------------------------------------- */

static void test_order_long(void **state) {
  (void)state;
  static const char *const models[] = {"head", "torso"};
  char words[256];
  for (size_t m = 0; m < 2; m++) {
    snprintf(words, sizeof words, "%s.safetensors --clip clip --threads 2", models[m]);
    uint8_t *all = raw(words, FRAMES * PIXEL_BYTES);
    for (size_t a = 0; a < FRAMES; a++)
      for (size_t b = a + 1; b < FRAMES; b++)
        assert_memory_not_equal(all + a * PIXEL_BYTES, all + b * PIXEL_BYTES, PIXEL_BYTES);
    for (int threads = 1; threads <= 3; threads += 2) {
      snprintf(words, sizeof words, "%s.safetensors --clip clip --threads %d", models[m], threads);
      uint8_t *other = raw(words, FRAMES * PIXEL_BYTES);
      assert_memory_equal(all, other, FRAMES * PIXEL_BYTES);
      free(other);
    }
    for (size_t k = 5; k < FRAMES; k += 5) { /* alone: nothing is left over from the frame before */
      snprintf(words, sizeof words, "%s.safetensors --clip clip --frames %zu:%zu", models[m], k, k + 1);
      uint8_t *one = raw(words, PIXEL_BYTES);
      assert_memory_equal(all + k * PIXEL_BYTES, one, PIXEL_BYTES);
      free(one);
    }
    free(all);
  }
}

static double number(const json_t *object, const char *name) {
  const json_t *value = json_object_get(object, name);
  if (!json_is_number(value)) fail_msg("the field %s is missing or no number", name);
  return json_number_value(value);
}

/* On a device two renderers draw every other frame each. A frame alone is drawn by one. The report has the work of
 * both, and no time twice. */
static void test_two_at_a_time(void **state) {
  (void)state;
  char words[256];
  cli_run(&cli, "info devices");
  if (strstr(cli.out, "opencl") == NULL) skip();
  uint8_t *all = raw("head.safetensors --clip clip --backend opencl --json two.json -y", FRAMES * PIXEL_BYTES);
  json_t *report = cli_json(&cli, "two.json"), *stages = json_object_get(report, "ms_by_stage");
  assert_true(number(json_object_get(report, "ray_reuse"), "frames") == FRAMES);
  assert_true(number(stages, "audio") + number(stages, "torso") + number(stages, "head") + number(stages, "output") <=
              number(report, "ms_per_frame"));
  json_decref(report);
  for (size_t k = 4; k < 6; k++) {
    snprintf(words, sizeof words, "head.safetensors --clip clip --backend opencl --frames %zu:%zu", k, k + 1);
    uint8_t *one = raw(words, PIXEL_BYTES);
    assert_memory_equal(all + k * PIXEL_BYTES, one, PIXEL_BYTES);
    free(one);
  }
  free(all);
}

/* On a device eval draws its first frame once before the frames that it measures. */
static void test_first_use(void **state) {
  static const char *const backends[] = {"cpu", "opencl"};
  double psnr[2];
  (void)state;
  cli_run(&cli, "info devices");
  if (strstr(cli.out, "opencl") == NULL) skip();
  for (int i = 0; i < 2; i++) {
    cli_run(&cli, "eval head.safetensors clip --frames 0:1 --quiet --json - --backend %s", backends[i]);
    cli_expect(&cli, 0, NULL);
    json_t *report = cli_json(&cli, NULL);
    psnr[i] = number(report, "psnr");
    assert_true(json_is_null(json_object_get(report, "first_use_ms")) == (i == 0));
    if (i == 1) assert_true(number(report, "first_use_ms") > 0);
    json_decref(report);
  }
  assert_true(fabs(psnr[0] - psnr[1]) < 0.001);
}

/* Pictures that must be scaled, from memory or not, on the way forward and back. */
static void test_replay(void **state) {
  (void)state;
  static const char line[] = "head.safetensors --clip clip --split val --audio clip/aud_ds.npy --size 40x30";
  char words[256];
  enum { BYTES = FRAMES * 40 * 30 * 4 };
  uint8_t *all = raw(line, BYTES);
  snprintf(words, sizeof words, "%s --set memory=1 --threads 1", line);
  uint8_t *other = raw(words, BYTES);
  assert_memory_equal(all, other, BYTES);
  free(all), free(other);
}

static void test_numbered_long(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_image image = {0};
  char path[64];
  uint8_t *all = raw("head.safetensors --clip clip", FRAMES * PIXEL_BYTES);
  for (int threads = 1; threads <= 2; threads++) {
    support_clear("out");
    assert_int_equal(mkdir("out", 0777), 0);
    cli_run(&cli, "render head.safetensors --clip clip --threads %d -o out/%%03d.png --quiet", threads);
    cli_expect(&cli, 0, NULL);
    assert_int_equal(cli_count("out"), FRAMES + 1); /* the pictures, and what they were made of */
    for (size_t k = 0; k < FRAMES; k++) {
      snprintf(path, sizeof path, "out/%03zu.png", k);
      support_ok(context, ern_image_read(context, path, 4, &image));
      assert_memory_equal(image.data, all + k * PIXEL_BYTES, PIXEL_BYTES);
      ern_image_free(context, &image);
    }
  }
  free(all);
  ern_context_free(&context);
}

/* The video too: one thread encodes, in order. On one core one thread reads torso pictures, on more several do. */
static void test_video(void **state) {
  (void)state;
  cpu_set_t all, one;
  assert_int_equal(sched_getaffinity(0, sizeof all, &all), 0);
  CPU_ZERO(&one);
  for (size_t i = 0; i < CPU_SETSIZE && CPU_COUNT(&one) == 0; i++)
    if (CPU_ISSET(i, &all)) CPU_SET(i, &one);
  for (int threads = 1; threads <= 2; threads++) {
    assert_int_equal(sched_setaffinity(0, sizeof one, threads == 1 ? &one : &all), 0);
    cli_run(&cli, "render torso.safetensors --clip clip --threads %d -o %d.mp4 --quiet", threads, threads);
    cli_expect(&cli, 0, NULL);
  }
  cli_same_bytes("1.mp4", "2.mp4");
}

/* ---- errors ------------------------------------------------------------------------------------------------------ */

/* The writer fails long before the last frame is drawn: the words, and nothing left. */
static void test_full(void **state) {
  (void)state;
  static const char *const outs[] = {"full/x.mp4", "full/x%d.png", "full/x%d.exr"};
  static const char *const names[] = {"full/x.mp4", "full/x0.png", "full/x0.exr"};
  for (size_t i = 0; i < sizeof outs / sizeof outs[0]; i++) {
    support_clear("full");
    assert_int_equal(mkdir("full", 0777), 0);
    cli_run_full(&cli, 1000, "render head.safetensors --clip clip -o %s --quiet", outs[i]);
    cli_expect(&cli, 1, "ernerf render: ", names[i], NULL);
    assert_int_equal(cli_count("full"), 0);
  }
  snprintf(cli.line, sizeof cli.line, "render head.safetensors --clip clip -o - --quiet");
  cli_start(&cli, "/dev/full", 0);
  cli_wait(&cli);
  cli_expect(&cli, 1, "standard output", "cannot be written", NULL);
}

/* Where nobody may make a file, root neither. */
static void test_unwritable(void **state) {
  (void)state;
  if (!cli_there("/proc/self")) skip();
  cli_run(&cli, "render head.safetensors --clip clip -o /proc/x.mp4 --quiet");
  cli_expect(&cli, 1, "ernerf render: /proc/x.mp4", NULL);
  cli_run(&cli, "render head.safetensors --clip clip -o /proc/x%%d.png --quiet");
  cli_expect(&cli, 1, "ernerf render: /proc/x0.png", NULL);
}

/* The header is whole, the pixels are not: found by threads that read, while others draw. The first frame's error is
 * told, whichever thread fails first. */
static void test_damaged_torso(void **state) {
  (void)state;
  cli_copy("clip", "damaged");
  for (int id = 9; id < FRAMES; id++) {
    char path[64];
    size_t count = 0;
    snprintf(path, sizeof path, "damaged/torso_imgs/%d.png", id);
    uint8_t *bytes = cli_bytes(path, &count);
    for (size_t i = count / 3; i < count / 2; i++) bytes[i] ^= 0x5a;
    cli_replace(path, bytes, count);
    free(bytes);
  }
  support_clear("damaged.mp4");
  cli_run(&cli, "render head.safetensors --clip damaged -o damaged.mp4 --quiet");
  cli_expect(&cli, 1, "damaged/torso_imgs/9.png", NULL);
  assert_false(cli_there("damaged.mp4"));
  cli_run(&cli, "render head.safetensors --clip damaged --frames :9 -o damaged.mp4 --quiet");
  cli_expect(&cli, 0, NULL);
}

/* ---- memory ------------------------------------------------------------------------------------------------------ */

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { MEASURABLE = 0 }; /* their own memory is most of it */
#else
enum { MEASURABLE = 1 };
#endif

/* A field of /proc/PID/status in kB; 0 where there is none. */
static size_t kilobytes(pid_t pid, const char *field) {
  char path[64], line[256];
  size_t found = 0;
  snprintf(path, sizeof path, "/proc/%d/status", (int)pid);
  FILE *file = fopen(path, "r");
  while (file != NULL && fgets(line, sizeof line, file) != NULL)
    if (strncmp(line, field, strlen(field)) == 0 && line[strlen(field)] == ':')
      found = strtoul(line + strlen(field) + 1, NULL, 10);
  if (file != NULL) fclose(file);
  return found;
}

/* The largest value of the field while the program runs, looked at every 2 ms; its status is in cli. */
static size_t peak_of(pid_t pid, const char *field) {
  const struct timespec rest = {.tv_nsec = 2000000};
  size_t peak = 0;
  siginfo_t about = {0};
  while (waitid(P_PID, (id_t)pid, &about, WEXITED | WNOHANG | WNOWAIT) == 0 && about.si_pid == 0) {
    const size_t now = kilobytes(pid, field);
    peak = now > peak ? now : peak;
    nanosleep(&rest, NULL);
  }
  return peak;
}

/* A head and a whole portrait of the clip in the repository, drawn as large as portraits are. */
static void make_tiny(void) {
  const char *source = getenv("ERNERF_SOURCE");
  assert_non_null(source);
  static bool made;
  if (made) return;
  cli_run(&cli,
          "train '%s/data/tiny' -o tiny.safetensors --iters 50 --rays 512 --lr-net 0.004 --validate-every 0 "
          "--validate-frames 1 --quiet",
          source);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli,
          "train '%s/data/tiny' --torso --head tiny.safetensors -o whole.safetensors --iters 2 --rays 256 "
          "--validate-frames 1 --quiet",
          source);
  cli_expect(&cli, 0, NULL);
  made = true;
}

enum { RENDER_KB = 150 * 1000, MINIMAL_KB = 64 * 1000, DRAWN = 20 /* frames */ };

/* That clip, its head too far away to be seen in most of the frames that are drawn: they cost little, and their
 * pictures are as large. */
static void make_mostly_far(void) {
  char path[1024];
  json_error_t error;
  snprintf(path, sizeof path, "%s/data/tiny", getenv("ERNERF_SOURCE"));
  cli_copy(path, "far");
  json_t *file = json_load_file("far/transforms_train.json", 0, &error), *frame;
  size_t k;
  assert_non_null(file);
  json_array_foreach(json_object_get(file, "frames"), k, frame) for (size_t row = 0; row < 3 && k % 10 != 5; row++) {
    json_t *values = json_array_get(json_object_get(frame, "transform_matrix"), row);
    assert_int_equal(json_array_set_new(values, 3, json_real(100 * json_number_value(json_array_get(values, 3)))), 0);
  }
  char *text = json_dumps(file, 0);
  assert_non_null(text);
  cli_replace("far/transforms_train.json", text, strlen(text));
  free(text);
  json_decref(file);
}

static void test_render_memory_long(void **state) {
  (void)state;
  if (!MEASURABLE || kilobytes(getpid(), "RssAnon") == 0) skip();
  make_tiny();
  make_mostly_far();
  /* more frames than the encoder looks ahead; head and torso: the head alone takes less */
  snprintf(cli.line, sizeof cli.line,
           "render whole.safetensors --clip far --force --backend cpu --threads 2 --size 450x450 --frames 0:%d "
           "--set transmittance-stop=0.3 -o tiny.mp4 -y --quiet",
           DRAWN);
  cli_start(&cli, NULL, 0);
  const size_t peak = peak_of(cli.pid, "RssAnon");
  cli_wait(&cli);
  cli_expect(&cli, 0, NULL);
  print_message("render: %zu kB of anonymous memory\n", peak);
  if (peak >= RENDER_KB) fail_msg("%zu kB of anonymous memory, expected under %d", peak, RENDER_KB);
}

/* speech.npy of two windows, poses.json for frames of 450 x 450. */
static void write_inputs(const char *source) {
  enum { WINDOWS = 2, LENGTH = 16, WIDTH = 29 };
  char path[1024];
  ern_context *context = support_context();
  ern_features features = {0};
  ern_pose_list list = {0};
  snprintf(path, sizeof path, "%s/data/tiny/aud_ds.npy", source);
  support_ok(context, ern_features_load(context, path, &features));
  assert_true(features.windows >= WINDOWS && features.window_length == LENGTH && features.width == WIDTH);
  support_ok(context,
             ern_npy_write_f32(context, "speech.npy", features.data, 3, (const size_t[]){WINDOWS, LENGTH, WIDTH}));
  snprintf(path, sizeof path, "%s/data/tiny/transforms_val.json", source);
  support_ok(context, ern_pose_list_load(context, path, &list));
  FILE *file = fopen("poses.json", "w");
  assert_non_null(file);
  const double larger = 450.0 / list.width;
  fprintf(file, "{\"focal_len\": %.9g, \"cx\": 225, \"cy\": 225, \"w\": 450, \"h\": 450, \"frames\": [",
          list.focal * larger);
  fprintf(file, "{\"img_id\": 0, \"aud_id\": 0, \"transform_matrix\": [");
  for (int i = 0; i < 16; i++)
    fprintf(file, "%s%.9g%s", i % 4 == 0 ? "[" : "", (double)list.poses[0].matrix[i],
            i == 15      ? "]"
            : i % 4 == 3 ? "], "
                         : ", ");
  fprintf(file, "]}]}\n");
  assert_int_equal(fclose(file), 0);
  ern_features_free(context, &features);
  ern_pose_list_free(context, &list);
  ern_context_free(&context);
}

/* A program with libernerf alone: all its pages count, those of the libraries too. */
static void test_minimal_memory_long(void **state) {
  (void)state;
  const char *program = getenv("ERNERF_RENDER_MINIMAL");
  if (!MEASURABLE || program == NULL || kilobytes(getpid(), "VmHWM") == 0) skip();
  static const char *const models[] = {"tiny.safetensors", "whole.safetensors"};
  make_tiny();
  write_inputs(getenv("ERNERF_SOURCE"));
  for (size_t i = 0; i < sizeof models / sizeof models[0]; i++) {
    const pid_t pid = fork();
    assert_true(pid >= 0);
    if (pid == 0) {
      execl(program, program, models[i], "speech.npy", "poses.json", "minimal.rgba", (char *)NULL);
      _exit(127);
    }
    const size_t peak = peak_of(pid, "VmHWM");
    int status = 1;
    assert_int_equal(waitpid(pid, &status, 0), pid);
    assert_true(WIFEXITED(status) && WEXITSTATUS(status) == 0);
    print_message("render_minimal %s: %zu kB in all\n", models[i], peak);
    if (peak >= MINIMAL_KB) fail_msg("%s: %zu kB in all, expected under %d", models[i], peak, MINIMAL_KB);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_order_long),
                                     cmocka_unit_test(test_two_at_a_time),
                                     cmocka_unit_test(test_first_use),
                                     cmocka_unit_test(test_replay),
                                     cmocka_unit_test(test_numbered_long),
                                     cmocka_unit_test(test_video),
                                     cmocka_unit_test(test_full),
                                     cmocka_unit_test(test_unwritable),
                                     cmocka_unit_test(test_damaged_torso),
                                     cmocka_unit_test(test_render_memory_long),
                                     cmocka_unit_test(test_minimal_memory_long)};
  return cmocka_run_group_tests(tests, make_clip, NULL);
}
