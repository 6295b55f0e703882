/* SPDX-License-Identifier: MIT
 * Files that claim much, and things that are no files, before every reader: refused in words, at once, and without the
 * memory that they claim. */
#include "../support.h"

#include <signal.h>
#include <stdbool.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "ernerf/data.h"
#include "ernerf/media.h"
#include "ernerf/model.h"
#include "io/csv.h"
#include "io/landmarks.h"
#include "io/npy.h"

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { LIMITED = 0 }; /* a sanitizer's own memory is terabytes of addresses */
#else
enum { LIMITED = 1 };
#endif

/* ---- readers ----------------------------------------------------------------------------------------------------- */

static ern_status read_npy(ern_context *context, const char *path) {
  struct ern_npy array;
  const ern_status status = ern_npy_read(context, path, &array);
  ern_npy_free(context, &array);
  return status;
}

static ern_status read_features(ern_context *context, const char *path) {
  ern_features features;
  const ern_status status = ern_features_load(context, path, &features);
  ern_features_free(context, &features);
  return status;
}

static ern_status read_poses(ern_context *context, const char *path) {
  ern_pose_list list;
  const ern_status status = ern_pose_list_load(context, path, &list);
  ern_pose_list_free(context, &list);
  return status;
}

static ern_status read_table(ern_context *context, const char *path) {
  float *values = NULL;
  size_t count = 0;
  const ern_status status = ern_csv_read_column(context, path, "AU45_r", &values, &count);
  if (status == ERN_OK) fail_msg("%s: %zu rows were read", path, count);
  return status;
}

static ern_status read_eyes(ern_context *context, const char *path) {
  ern_eyes eyes;
  const ern_status status = ern_eyes_load(context, path, &eyes);
  ern_eyes_free(context, &eyes);
  return status;
}

static ern_status read_landmarks(ern_context *context, const char *path) {
  float points[ERN_LANDMARKS][2];
  return ern_landmarks_read(context, path, points);
}

static ern_status read_model(ern_context *context, const char *path) {
  ern_model *model = NULL;
  const ern_status status = ern_model_load(&model, context, path);
  ern_model_free(&model);
  return status;
}

static ern_status read_image(ern_context *context, const char *path) {
  ern_image image = {0};
  const ern_status status = ern_image_read(context, path, 3, &image);
  ern_image_free(context, &image);
  return status;
}

static ern_status read_size(ern_context *context, const char *path) {
  int width = 0, height = 0;
  return ern_image_size(context, path, &width, &height);
}

static ern_status read_sound(ern_context *context, const char *path) {
  ern_sound sound = {0};
  const ern_status status = ern_sound_read(context, path, &sound);
  ern_sound_free(context, &sound);
  return status;
}

static ern_status read_video(ern_context *context, const char *path) {
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  double seconds = 0;
  bool end = false;
  ern_status status = ern_video_reader_open(context, path, &reader);
  if (status == ERN_OK) status = ern_video_reader_frame(reader, &image, &seconds, &end);
  ern_image_free(context, &image);
  ern_video_reader_free(&reader);
  return status;
}

typedef ern_status read_function(ern_context *context, const char *path);

/* ---- memory ------------------------------------------------------------------------------------------------------ */

static size_t addresses_used(void) {
  unsigned long long pages = 0;
  FILE *file = fopen("/proc/self/statm", "r");
  if (file == NULL || fscanf(file, "%llu", &pages) != 1) pages = 0;
  if (file != NULL) fclose(file);
  return (size_t)pages * (size_t)sysconf(_SC_PAGESIZE);
}

/* Reads in a child that may map `mebibytes` more than it has, and that is killed after a minute; the child says whether
 * all was as expected. ERN_E_NO_MEMORY is never expected: that would be a reader that tried. */
static void expect_refused(read_function *read, const char *path, size_t mebibytes, ern_status expected,
                           const char *word) {
  const pid_t child = fork();
  int found = 0;
  assert_true(child >= 0);
  if (child == 0) {
    ern_context *context = NULL;
    const size_t bytes = addresses_used() + (mebibytes << 20);
    const struct rlimit limit = {.rlim_cur = bytes, .rlim_max = bytes};
    alarm(60);
    if (ern_context_create(&context, NULL) != ERN_OK) _exit(2);
    if (LIMITED && setrlimit(RLIMIT_AS, &limit) != 0) _exit(3);
    const ern_status status = read(context, path);
    const char *said = ern_last_error(context);
    const bool right = status == expected && strstr(said, path) != NULL && strstr(said, word) != NULL;
    if (!right) fprintf(stderr, "%s: %s: %s\n", path, ern_status_name(status), said);
    _exit(right ? 0 : 1);
  }
  assert_int_equal(waitpid(child, &found, 0), child);
  if (!WIFEXITED(found) || WEXITSTATUS(found) != 0)
    fail_msg("%s: expected %s with \"%s\" within %zu MiB; the child ended with %d", path, ern_status_name(expected),
             word, mebibytes, found);
}

/* ---- what is no file --------------------------------------------------------------------------------------------- */

static void test_no_files(void **state) {
  (void)state;
  static const struct {
    const char *ending;
    read_function *read;
  } readers[] = {{"npy", read_npy},   {"npy", read_features}, {"json", read_poses},    {"csv", read_table},
                 {"csv", read_eyes},  {"npy", read_eyes},     {"lms", read_landmarks}, {"safetensors", read_model},
                 {"pth", read_model}, {"png", read_image},    {"jpg", read_size},      {"wav", read_sound},
                 {"mp4", read_video}};
  static const char *const kinds[] = {"folder", "pipe", "zeros", "loop", "empty"};
  ern_context *context = support_context();
  alarm(120);
  for (size_t r = 0; r < sizeof readers / sizeof *readers; r++) {
    for (size_t k = 0; k < sizeof kinds / sizeof *kinds; k++) {
      char path[64];
      snprintf(path, sizeof path, "%s.%s", kinds[k], readers[r].ending);
      support_clear(path);
      if (k == 0) assert_int_equal(mkdir(path, 0755), 0);
      if (k == 1) assert_int_equal(mkfifo(path, 0600), 0);
      if (k == 2) assert_int_equal(symlink("/dev/zero", path), 0);
      if (k == 3) assert_int_equal(symlink(path, path), 0);
      if (k == 4) support_write(path, "", 0);
      const ern_status status = readers[r].read(context, path);
      if (status == ERN_OK || status == ERN_E_NO_MEMORY) fail_msg("%s: %s", path, ern_status_name(status));
      if (strncmp(ern_last_error(context), path, strlen(path)) != 0)
        fail_msg("%s is not named in \"%s\"", path, ern_last_error(context));
    }
  }
  alarm(0);
  ern_context_free(&context);
}

/* ---- pictures and videos ----------------------------------------------------------------------------------------- */

static uint32_t crc_of(const uint8_t *bytes, size_t count) {
  uint32_t crc = 0xffffffffu;
  for (size_t i = 0; i < count; i++) {
    crc ^= bytes[i];
    for (int bit = 0; bit < 8; bit++) crc = crc >> 1 ^ ((crc & 1) != 0 ? 0xedb88320u : 0);
  }
  return ~crc;
}

static void put_big(uint8_t *to, uint32_t value, int bytes) {
  for (int i = 0; i < bytes; i++) to[i] = (uint8_t)(value >> (8 * (bytes - 1 - i)));
}

/* A whole PNG by its chunks, of 70 bytes. */
static void write_png(const char *path, uint32_t width, uint32_t height, int depth, int colour) {
  uint8_t png[70] = "\x89PNG\r\n\x1a\n\0\0\0\15IHDR";
  put_big(png + 16, width, 4);
  put_big(png + 20, height, 4);
  png[24] = (uint8_t)depth;
  png[25] = (uint8_t)colour;
  put_big(png + 29, crc_of(png + 12, 17), 4);
  put_big(png + 33, 1, 4);
  memcpy(png + 37, "IDAT\x78", 5);
  put_big(png + 42, crc_of(png + 37, 5), 4);
  memcpy(png + 46, "\0\0\0\0IEND\xae\x42\x60\x82", 12);
  support_write(path, png, 58);
}

/* Start, an application's segment, the frame's header and the end. */
static void write_jpeg(const char *path, unsigned width, unsigned height, int marker) {
  uint8_t jpeg[] = {0xff, 0xd8, 0xff, 0xe1, 0, 4,    'x', 'y',  0xff, (uint8_t)marker, 0, 17, 8, 0, 0, 0, 0, 3, 1, 0x11,
                    0,    2,    0x11, 0,    3, 0x11, 0,   0xff, 0xd9};
  put_big(jpeg + 13, height, 2);
  put_big(jpeg + 15, width, 2);
  support_write(path, jpeg, sizeof jpeg);
}

static void make_bmp(const char *path, uint32_t side) {
  uint8_t bmp[58] = "BM";
  const uint32_t words[] = {58, 0, 54, 40, side, side, 1 | 24u << 16, 0, 4};
  for (int i = 0; i < 9; i++)
    for (int k = 0; k < 4; k++) bmp[2 + 4 * i + k] = (uint8_t)(words[i] >> (8 * k));
  support_write(path, bmp, sizeof bmp);
}

/* A picture that is read uses what a reader needs once and for all. */
static void warm_up(void) {
  ern_context *context = support_context();
  uint8_t pixels[8 * 8 * 3] = {7};
  const ern_image image = {.width = 8, .height = 8, .channels = 3, .data = pixels};
  support_ok(context, ern_image_write(context, "good.png", &image, 90));
  support_ok(context, ern_image_write(context, "good.jpg", &image, 90));
  support_ok(context, read_image(context, "good.png"));
  support_ok(context, read_image(context, "good.jpg"));
  ern_context_free(&context);
}

static void test_absurd_pictures(void **state) {
  (void)state;
  enum { MIB = 64 }; /* 8192 x 8192 pixels of three bytes are 192 */
  static read_function *const reads[] = {read_image, read_size};
  warm_up();
  write_png("sides.png", 60000, 60000, 8, 2);
  write_png("sides_2_to_31.png", 0x80000000u, 0x80000000u, 8, 2);
  write_png("sides_0.png", 0, 8, 8, 2);
  write_png("pixels.png", 8192, 8192, 8, 2);
  write_png("pixels_16.png", 8192, 8192, 16, 6);
  write_png("depth.png", 8, 8, 7, 2);
  write_png("png.jpg", 60000, 60000, 8, 2);
  write_jpeg("sides.jpg", 60000, 60000, 0xc0);
  write_jpeg("rows.jpg", 8, 0, 0xc0);
  write_jpeg("pixels.jpg", 8192, 8192, 0xc0);
  write_jpeg("progressive.jpg", 8192, 8192, 0xc2);
  support_write("sides.gif", "GIF89a\xff\xff\xff\xff\x80\0\0\0\0\0\xff\xff\xff,\0\0\0\0\xff\xff\xff\xff\0\2\1\0;", 33);
  make_bmp("sides.bmp", 60000);
  make_bmp("pixels.bmp", 8192);
  support_write_text("sides.ppm", "P6\n60000 60000\n255\nxxx");
  support_write_text("pixels.ppm", "P6\n8192 8192\n255\nxxx");
  for (int r = 0; r < 2; r++) {
    expect_refused(reads[r], "sides.png", MIB, ERN_E_SHAPE, "60000 x 60000");
    expect_refused(reads[r], "sides_2_to_31.png", MIB, ERN_E_SHAPE, "2147483648");
    expect_refused(reads[r], "sides_0.png", MIB, ERN_E_SHAPE, "0 x 8");
    expect_refused(reads[r], "pixels.png", MIB, ERN_E_FORMAT, "8192 x 8192 pixels, found 58 bytes");
    expect_refused(reads[r], "pixels_16.png", MIB, ERN_E_FORMAT, "8192 x 8192 pixels, found 58 bytes");
    expect_refused(reads[r], "depth.png", MIB, ERN_E_FORMAT, "depth is 7");
    expect_refused(reads[r], "png.jpg", MIB, ERN_E_SHAPE, "60000 x 60000");
    expect_refused(reads[r], "sides.jpg", MIB, ERN_E_SHAPE, "60000 x 60000");
    expect_refused(reads[r], "rows.jpg", MIB, ERN_E_SHAPE, "8 x 0");
    expect_refused(reads[r], "pixels.jpg", MIB, ERN_E_FORMAT, "8192 x 8192 pixels, found 29 bytes");
    expect_refused(reads[r], "progressive.jpg", MIB, ERN_E_FORMAT, "8192 x 8192 pixels, found 29 bytes");
    expect_refused(reads[r], "sides.gif", MIB, ERN_E_SHAPE, "65535 x 65535");
    expect_refused(reads[r], "sides.bmp", MIB, ERN_E_SHAPE, "60000 x 60000");
    expect_refused(reads[r], "pixels.bmp", MIB, ERN_E_FORMAT, "8192 x 8192");
    expect_refused(reads[r], "sides.ppm", MIB, ERN_E_SHAPE, "60000 x 60000");
    expect_refused(reads[r], "pixels.ppm", MIB, ERN_E_FORMAT, "8192 x 8192");
  }
}

static void test_absurd_videos(void **state) {
  (void)state;
  support_write_text("sides.y4m", "YUV4MPEG2 W60000 H60000 F25:1 C420\nFRAME\nxxxx");
  support_write_text("sides.mp4", "YUV4MPEG2 W16000 H16000 F25:1 C420\nFRAME\nxxxx");
  expect_refused(read_video, "sides.y4m", 64, ERN_E_IO, "cannot read it"); /* its size overflows in FFmpeg */
  expect_refused(read_video, "sides.mp4", 64, ERN_E_SHAPE, "16000 x 16000");
}

/* ---- holes ------------------------------------------------------------------------------------------------------- */

/* `head`, and then zeros that take no room on the disk. */
static void write_hole(const char *path, const void *head, size_t count, size_t bytes) {
  support_write(path, head, count);
  assert_int_equal(truncate(path, (off_t)bytes), 0);
}

/* Gigabytes that are there and claim nothing, or less than there is: what the head says is looked at first. */
static void test_holes(void **state) {
  (void)state;
  enum { MIB = 32 };
  const size_t huge = (size_t)8 << 30, large = ((size_t)1 << 30) - 4096;
  static const char npy[] = "\x93NUMPY\1\0\x40\0{'descr': '<f4', 'fortran_order': False, 'shape': (3, 16, 29), }";
  static const char numbers[] = "\x93NUMPY\2\0\xff\xff\xff\x0f{";
  static const char tensors[] = "\x38\0\0\0\0\0\0\0{\"a\":{\"dtype\":\"F32\",\"shape\":[16],\"data_offsets\":[0,64]}}";
  static const struct {
    const char *name;
    read_function *read;
    ern_status status;
    const char *word;
  } kinds[] = {{"hole.npy", read_features, ERN_E_SHAPE, "8589934592 bytes"},
               {"hole.json", read_poses, ERN_E_SHAPE, "8589934592 bytes"},
               {"hole.csv", read_table, ERN_E_SHAPE, "8589934592 bytes"},
               {"hole.csv", read_eyes, ERN_E_SHAPE, "8589934592 bytes"},
               {"hole.lms", read_landmarks, ERN_E_SHAPE, "8589934592 bytes"},
               {"hole.safetensors", read_model, ERN_E_SHAPE, "8589934592 bytes"}};
  for (size_t k = 0; k < sizeof kinds / sizeof *kinds; k++) {
    write_hole(kinds[k].name, "", 0, huge);
    expect_refused(kinds[k].read, kinds[k].name, MIB, kinds[k].status, kinds[k].word);
    remove(kinds[k].name);
  }
  write_hole("hole.npy", npy, sizeof npy - 1, large);
  expect_refused(read_npy, "hole.npy", MIB, ERN_E_FORMAT, "claims");
  write_hole("hole.npy", numbers, sizeof numbers - 1, large);
  expect_refused(read_npy, "hole.npy", MIB, ERN_E_FORMAT, "header length is 268435455");
  write_hole("hole.npy", "", 0, large);
  expect_refused(read_npy, "hole.npy", MIB, ERN_E_FORMAT, "is no .npy file");
  write_hole("hole.safetensors", tensors, sizeof tensors - 1, large);
  expect_refused(read_model, "hole.safetensors", MIB, ERN_E_FORMAT, "the tensors hold 64 bytes");
  write_hole("hole.safetensors", "", 0, large);
  expect_refused(read_model, "hole.safetensors", MIB, ERN_E_FORMAT, "header");
  write_hole("hole.pth", "PK\3\4", 4, large);
  expect_refused(read_model, "hole.pth", MIB, ERN_E_FORMAT, "at its end");
  remove("hole.npy"), remove("hole.safetensors"), remove("hole.pth");
}

/* ---- JSON -------------------------------------------------------------------------------------------------------- */

/* `head`, then `count` times `part`. */
static void write_many(const char *path, const char *head, const char *part, size_t count) {
  FILE *file = fopen(path, "wb");
  assert_non_null(file);
  fputs(head, file);
  for (size_t i = 0; i < count; i++) fputs(part, file);
  assert_int_equal(fclose(file), 0);
}

/* A sound in a file whose space was reserved: FFmpeg took 8 bytes of the zeros at a time, for hours. */
static void test_zeros_after_sound(void **state) {
  (void)state;
  static const off_t sizes[] = {1 << 20, (off_t)1 << 40};
  int16_t samples[1600] = {0};
  ern_context *context = support_context();
  const ern_sound made = {.data = samples, .frames = 1600, .rate = 16000, .channels = 1};
  ern_sound sound = {0};
  support_ok(context, ern_sound_write_wav(context, "reserved.wav", &made));
  assert_int_equal(truncate("reserved.wav", sizes[0]), 0);
  support_ok(context, ern_sound_read(context, "reserved.wav", &sound));
  assert_int_equal(sound.frames, 1600);
  ern_sound_free(context, &sound);
  assert_int_equal(truncate("reserved.wav", sizes[1]), 0);
  support_expect(context, ern_sound_read(context, "reserved.wav", &sound), ERN_E_FORMAT, "reserved.wav",
                 "hold no sound", NULL);
  assert_int_equal(truncate("reserved.wav", 0), 0);
  ern_context_free(&context);
}

static void test_json(void **state) {
  (void)state;
  enum { MANY = 10000000 };
  const struct {
    const char *head, *part, *word;
    size_t count;
    ern_status status;
  } cases[] = {{"{\"frames\":[", "{},", "MiB of memory", MANY / 3, ERN_E_SHAPE},
               {"{\"frames\":[", "0,", "MiB of memory", MANY, ERN_E_SHAPE},
               {"", "[", "MiB of memory", MANY, ERN_E_SHAPE},
               {"", "[", "depth", 100000, ERN_E_FORMAT},
               {"", "{\"a\":", "depth", 100000, ERN_E_FORMAT},
               {"{\"a\":\"", "\\\"[{,", "line 1", 100000, ERN_E_FORMAT},
               {"{\"cx\":1,\"cx\":2}", "", "duplicate", 0, ERN_E_FORMAT},
               {"{\"focal_len\":1e999}", "", "overflow", 0, ERN_E_FORMAT},
               {"{\"focal_len\":NaN}", "", "NaN", 0, ERN_E_FORMAT}};
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    write_many("many.json", cases[i].head, cases[i].part, cases[i].count);
    expect_refused(read_poses, "many.json", 128, cases[i].status, cases[i].word);
  }
  remove("many.json");
}

static void write_safetensors(const char *path, const char *header) {
  uint8_t bytes[1024];
  const size_t length = strlen(header);
  assert_true(8 + length <= sizeof bytes);
  for (int i = 0; i < 8; i++) bytes[i] = (uint8_t)((uint64_t)length >> (8 * i));
  memcpy(bytes + 8, header, length);
  support_write(path, bytes, 8 + length);
}

#define ABOUT(width, codes)                                                        \
  "{\"__metadata__\":{\"ernerf\":\"{\\\"levels\\\":2,\\\"feature_width\\\":" width \
  ",\\\"window_length\\\":16,"                                                     \
  "\\\"codes\\\":" codes ",\\\"eye\\\":false,\\\"torso\\\":false,\\\"torso_gamma\\\":false,\\\"bound\\\":1}\"}}"

/* Words that claim a model of 400 MiB, and no tensor. */
static void test_model_of_words(void **state) {
  (void)state;
  write_safetensors("words.safetensors", ABOUT("1000000", "0"));
  expect_refused(read_model, "words.safetensors", 64, ERN_E_FORMAT, "feature width");
  write_safetensors("words.safetensors", ABOUT("29", "1000000"));
  expect_refused(read_model, "words.safetensors", 64, ERN_E_MISSING, "is missing");
}

static void test_tables(void **state) {
  (void)state;
  write_many("columns.csv", "frame", ",", 20000);
  FILE *file = fopen("columns.csv", "ab");
  assert_non_null(file);
  fputs("AU45_r\n1\n", file);
  assert_int_equal(fclose(file), 0);
  expect_refused(read_table, "columns.csv", 64, ERN_E_MISSING, "AU45_r");
  write_many("rows.csv", "AU45_r\n", "1\n", (1 << 24) + 1);
  expect_refused(read_table, "rows.csv", 80, ERN_E_SHAPE, "16777217 rows");
  write_many("rows.csv", "", "1\n", (1 << 24) + 1);
  expect_refused(read_eyes, "rows.csv", 80, ERN_E_SHAPE, "16777217 lines");
  remove("rows.csv");
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_no_files),      cmocka_unit_test(test_absurd_pictures),
                                     cmocka_unit_test(test_absurd_videos), cmocka_unit_test(test_holes),
                                     cmocka_unit_test(test_json),          cmocka_unit_test(test_model_of_words),
                                     cmocka_unit_test(test_tables),        cmocka_unit_test(test_zeros_after_sound)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
