/* SPDX-License-Identifier: MIT
 * Files, whole: limits of reading, atomic writing, what is left when writing fails, folders, SHA-256. */
#include "../support.h"

#include <signal.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/memory.h"
#include "ernerf/model.h"
#include "io/file.h"
#include "io/number.h"

/* How many names in `folder` have `part` in them. */
static int count_names(const char *folder, const char *part) {
  DIR *list = opendir(folder);
  assert_non_null(list);
  int count = 0;
  for (struct dirent *entry = readdir(list); entry != NULL; entry = readdir(list)) {
    count += strstr(entry->d_name, part) != NULL;
  }
  closedir(list);
  return count;
}

static void expect_content(ern_context *context, const char *path, const char *expected) {
  uint8_t *bytes = NULL;
  size_t count = 0;
  assert_int_equal(ern_file_read(context, path, 1000, &bytes, &count), ERN_OK);
  assert_int_equal(count, strlen(expected));
  assert_string_equal((const char *)bytes, expected);
  ern_release(context, bytes);
}

static void test_read(void **state) {
  (void)state;
  ern_context *context = support_context();
  uint8_t *bytes = NULL;
  size_t count = 7;
  support_write_text("five.txt", "12345");
  expect_content(context, "five.txt", "12345");
  support_expect(context, ern_file_read(context, "five.txt", 4, &bytes, &count), ERN_E_SHAPE, "five.txt", "5 bytes",
                 "at most 4", NULL);
  assert_null(bytes);
  assert_int_equal(count, 0);
  support_expect(context, ern_file_read(context, "absent.txt", 4, &bytes, &count), ERN_E_MISSING, "absent.txt",
                 "No such file", NULL);
  support_expect(context, ern_file_read(context, ".", 4, &bytes, &count), ERN_E_IO, ".", "folder", NULL);
  support_expect(context, ern_file_read(context, "/dev/zero", 4, &bytes, &count), ERN_E_IO, "/dev/zero", "device",
                 NULL);
  support_clear("pipe");
  assert_int_equal(mkfifo("pipe", 0600), 0);
  support_expect(context, ern_file_read(context, "pipe", 4, &bytes, &count), ERN_E_IO, "pipe", "regular file", NULL);
  support_write_text("empty.txt", "");
  expect_content(context, "empty.txt", "");
  ern_context_free(&context);
}

static void test_write(void **state) {
  (void)state;
  ern_context *context = support_context();
  struct ern_file_writer writer;
  assert_int_equal(ern_file_write(context, "out.bin", "old", 3, ERN_EXISTING_BY_CONTEXT), ERN_OK);
  assert_int_equal(ern_file_writer_open(context, "out.bin", ERN_EXISTING_BY_CONTEXT, &writer), ERN_OK);
  assert_int_equal(ern_file_writer_write(&writer, "new", 3), ERN_OK);
  assert_int_equal(ern_file_writer_write(&writer, "er", 2), ERN_OK);
  expect_content(context, "out.bin", "old"); /* a reader sees the old file until the commit */
  assert_int_equal(count_names(".", "out.bin.ernerf-tmp"), 1);
  assert_int_equal(ern_file_writer_commit(&writer), ERN_OK);
  expect_content(context, "out.bin", "newer");
  assert_int_equal(count_names(".", ".ernerf-tmp"), 0);
  support_expect(context, ern_file_writer_write(&writer, "x", 1), ERN_E_STATE, "closed", NULL);
  support_expect(context, ern_file_writer_commit(&writer), ERN_E_STATE, "closed", NULL);
  ern_file_writer_abandon(&writer);

  assert_int_equal(ern_file_writer_open(context, "out.bin", ERN_EXISTING_BY_CONTEXT, &writer), ERN_OK);
  assert_int_equal(ern_file_writer_write(&writer, "lost", 4), ERN_OK);
  ern_file_writer_abandon(&writer);
  ern_file_writer_abandon(&writer);
  expect_content(context, "out.bin", "newer");
  assert_int_equal(count_names(".", ".ernerf-tmp"), 0);

  struct ern_file_writer zeroed = {0};
  ern_file_writer_abandon(&zeroed);
  ern_context_free(&context);
}

static void test_write_refused(void **state) {
  (void)state;
  ern_context *context = support_context();
  struct stat about;
  support_expect(context, ern_file_write(context, "no/such/out.bin", "x", 1, ERN_EXISTING_BY_CONTEXT), ERN_E_MISSING,
                 "no/such/out.bin", "write", "No such file", NULL);
  support_expect(context, ern_file_write(context, ".", "x", 1, ERN_EXISTING_BY_CONTEXT), ERN_E_IO, ".", "folder", NULL);
  support_expect(context, ern_file_write(context, "/dev/full", "x", 1, ERN_EXISTING_BY_CONTEXT), ERN_E_IO, "/dev/full",
                 "device", NULL);
  assert_int_equal(stat("/dev/full", &about), 0);
  assert_true(S_ISCHR(about.st_mode));
  ern_context_free(&context);
}

/* A limit on the size of files stands in for a full disk: write() is short, then fails. */
static void test_write_full(void **state) {
  (void)state;
  ern_context *context = support_context();
  static const char block[8192];
  struct rlimit before, tiny;
  struct ern_file_writer writer;
  assert_int_equal(ern_file_write(context, "full.bin", "old", 3, ERN_EXISTING_BY_CONTEXT), ERN_OK);
  signal(SIGXFSZ, SIG_IGN);
  assert_int_equal(getrlimit(RLIMIT_FSIZE, &before), 0);
  tiny = before;
  tiny.rlim_cur = 5000;
  assert_int_equal(setrlimit(RLIMIT_FSIZE, &tiny), 0);
  const ern_status whole = ern_file_write(context, "full.bin", block, sizeof block, ERN_EXISTING_BY_CONTEXT);
  char words[512];
  snprintf(words, sizeof words, "%s", ern_last_error(context));
  assert_int_equal(ern_file_writer_open(context, "full.bin", ERN_EXISTING_BY_CONTEXT, &writer), ERN_OK);
  const ern_status part = ern_file_writer_write(&writer, block, sizeof block);
  const ern_status after = ern_file_writer_commit(&writer);
  assert_int_equal(setrlimit(RLIMIT_FSIZE, &before), 0);
  assert_int_equal(whole, ERN_E_IO);
  assert_int_equal(part, ERN_E_IO);
  assert_int_equal(after, ERN_E_STATE);
  assert_non_null(strstr(words, "full.bin: cannot write"));
  assert_non_null(strstr(words, "File too large"));
  expect_content(context, "full.bin", "old");
  assert_int_equal(count_names(".", ".ernerf-tmp"), 0);
  ern_context_free(&context);
}

static void test_folders(void **state) {
  (void)state;
  ern_context *context = support_context();
  struct stat about;
  char *path = NULL;
  support_clear("one");
  assert_int_equal(ern_folder_make(context, "one/two//three/"), ERN_OK);
  assert_int_equal(ern_folder_make(context, "one/two/three"), ERN_OK);
  assert_int_equal(stat("one/two/three", &about), 0);
  assert_true(S_ISDIR(about.st_mode));
  support_write_text("one/file", "x");
  support_expect(context, ern_folder_make(context, "one/file/four"), ERN_E_IO, "one/file", "is a file", NULL);
  support_expect(context, ern_folder_make(context, ""), ERN_E_ARGUMENT, "empty", NULL);
  assert_int_equal(ern_path_join(context, "a", "b.c", &path), ERN_OK);
  assert_string_equal(path, "a/b.c");
  ern_release(context, path);
  assert_int_equal(ern_path_join(context, "/", "b", &path), ERN_OK);
  assert_string_equal(path, "/b");
  ern_release(context, path);
  ern_context_free(&context);
}

/* The examples of FIPS 180-4, and lengths around the block of 64 bytes (values from another implementation). */
static void test_sha256(void **state) {
  (void)state;
  char hex[65], text[130];
  static char million[1000000];
  memset(million, 'a', sizeof million);
  ern_sha256_hex("", 0, hex);
  assert_string_equal(hex, "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  ern_sha256_hex("abc", 3, hex);
  assert_string_equal(hex, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  ern_sha256_hex("abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq", 56, hex);
  assert_string_equal(hex, "248d6a61d20638b8e5c026930c3e6039a33ce45964ff2167f6ecedd419db06c1");
  ern_sha256_hex(million, sizeof million, hex);
  assert_string_equal(hex, "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
  memset(text, 'x', sizeof text);
  const struct {
    size_t count;
    const char *hex;
  } cases[] = {{1, "2d711642b726b04401627ca9fbac32f5c8530fb1903cc4db02258717921a4881"},
               {55, "d5e285683cd4efc02d021a5c62014694958901005d6f71e89e0989fac77e4072"},
               {56, "04c26261370ee7541549d16dee320c723e3fd14671e66a099afe0a377c16888e"},
               {63, "75220b47218278e656f2013bb8f0c455a25eaf01e86c64924e9d48d89776d6f2"},
               {64, "7ce100971f64e7001e8fe5a51973ecdfe1ced42befe7ee8d5fd6219506b5393c"},
               {65, "9537c5fdf120482f7d58d25e9ed583f52c02b4e304ea814db1633ad565aed7e9"},
               {119, "000b48d4edf0fa7bee3c6236ecd2785baa5db4eeb8bb54341b029e0d9fa5fb0c"},
               {120, "13f05a0b594787f5ecd315edc96141bd3243203d1b7d4f0836f37308b276ba98"},
               {128, "24da1b81d0b16df6428eee73c69fcb2a93c76bc6df706f0c6670fe6bfe800464"},
               {130, "3afbb132863c57f08bdc32205eb6c63775397a9953819218a1f4b7cbdc0ff90f"}};
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    ern_sha256_hex(text, cases[i].count, hex);
    assert_string_equal(hex, cases[i].hex);
  }
}

/* A file that is longer than the pieces in which it is read, and one that is a piece long; without its bytes in
 * memory. */
static void test_sha256_of_file(void **state) {
  (void)state;
  static char bytes[1000000];
  const size_t counts[] = {0, 16384, 16385, sizeof bytes};
  struct support_meter meter = {0};
  ern_context *context = support_metered_context(&meter);
  const size_t empty = meter.now;
  char hex[65], expected[65];
  for (size_t i = 0; i < sizeof bytes; i++) bytes[i] = (char)(i * i >> 7);
  for (size_t i = 0; i < sizeof counts / sizeof *counts; i++) {
    support_write("hashed", bytes, counts[i]);
    support_ok(context, ern_file_sha256(context, "hashed", hex));
    ern_sha256_hex(bytes, counts[i], expected);
    assert_string_equal(hex, expected);
  }
  assert_true(meter.most - empty < 65536);
  ern_context_free(&context);
}

static void test_numbers(void **state) {
  (void)state;
  static const char *const good[] = {"0",
                                     "-0.5",
                                     "+3",
                                     "44.557555",
                                     "1e3",
                                     "1.25E-2",
                                     ".5",
                                     "5.",
                                     "123456789012345678901234567890",
                                     "0.000000000000000000000000001",
                                     "1e-400",
                                     "9007199254740993",
                                     "2.2250738585072014e-308"};
  for (size_t i = 0; i < sizeof good / sizeof good[0]; i++) {
    const char *at = good[i], *end = at + strlen(at);
    double value = -1;
    assert_true(ern_number_read(&at, end, &value));
    assert_ptr_equal(at, end);
    const double expected = strtod(good[i], NULL);
    const double error = value > expected ? value - expected : expected - value;
    const double size = expected < 0 ? -expected : expected;
    assert_true(error <= 1e-15 * size + 5e-324);
  }
  static const char *const bad[] = {"", "-", ".", "nan", "inf", "-inf", "e5", "1e", "1e+", " 1", "x"};
  for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
    const char *at = bad[i];
    double value = 0;
    assert_false(ern_number_read(&at, bad[i] + strlen(bad[i]), &value));
    assert_ptr_equal(at, bad[i]);
  }
  const char *huge = "1e999";
  double value = 0;
  assert_true(ern_number_read(&huge, huge + 5, &value));
  assert_true(value > 1e308);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_read),           cmocka_unit_test(test_write),
                                     cmocka_unit_test(test_write_refused),  cmocka_unit_test(test_write_full),
                                     cmocka_unit_test(test_folders),        cmocka_unit_test(test_sha256),
                                     cmocka_unit_test(test_sha256_of_file), cmocka_unit_test(test_numbers)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
