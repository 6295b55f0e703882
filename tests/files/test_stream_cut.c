/* SPDX-License-Identifier: MIT
 * Files of streams whose disk is full, whose process is killed and whose name is taken: what was written is there and
 * plays. */
#include <sys/resource.h>
#include <sys/wait.h>

#include "stream_support.h"

/* Closes it after an error too. */
static ern_status write_and_close(const char *url, const ern_stream_options *options) {
  ern_stream_writer *writer;
  const ern_status status = ern_stream_writer_open(context, url, options, &writer);
  if (status != ERN_OK) return status;
  (void)write_frames(writer);
  return ern_stream_writer_close(&writer);
}

static const char *const cut_forms[] = {"mp4", "matroska", "mpegts", "flv", "nut", "y4m"};

/* least: pictures that must be there, all at their times. */
static void expect_plays(const char *path, const char *form, int least) {
  const struct times times = times_of(path);
  if (times.pictures < least || times.pictures > FRAMES || times.wrong != 0)
    fail_msg("%s: %d pictures, %d of them at a wrong time, expected %d or more", form, times.pictures, times.wrong,
             least);
}

static int64_t bytes_of(const char *path) {
  struct stat there;
  assert_int_equal(stat(path, &there), 0);
  return there.st_size;
}

/* A disk that is full at 60 % of the file, and just before its end: what was written plays. */
static void test_a_full_disk_keeps_what_was_written(void **state) {
  (void)state;
  struct rlimit limit, full;
  assert_int_equal(getrlimit(RLIMIT_FSIZE, &limit), 0);
  (void)signal(SIGXFSZ, SIG_IGN);
  for (size_t i = 0; i < sizeof cut_forms / sizeof *cut_forms; i++) {
    const ern_stream_options options = options_of_stream(cut_forms[i]);
    (void)unlink("whole");
    support_ok(context, write_stream("whole", &options));
    const int64_t whole = bytes_of("whole");
    for (int late = 0; late < 2; late++) {
      const int64_t most = late ? whole - 1 : whole * 6 / 10;
      (void)unlink("full");
      full = (struct rlimit){(rlim_t)most, limit.rlim_max};
      assert_int_equal(setrlimit(RLIMIT_FSIZE, &full), 0);
      const ern_status status = write_and_close("full", &options);
      assert_int_equal(setrlimit(RLIMIT_FSIZE, &limit), 0);
      support_expect(context, status, ERN_E_IO, "full", "too large", "it is cut", NULL);
      assert_true(bytes_of("full") <= most);
      expect_plays("full", cut_forms[i], late ? FRAMES / 2 : FRAMES / 4);
      assert_int_equal(access("full.ernerf-tmp", F_OK), -1);
    }
  }
  const ern_stream_options options = options_of_stream("raw");
  full = (struct rlimit){4 * SIDE * SIDE * 3 + 7, limit.rlim_max};
  (void)unlink("full");
  assert_int_equal(setrlimit(RLIMIT_FSIZE, &full), 0);
  const ern_status status = write_and_close("full", &options);
  full.rlim_cur = 100; /* not one packet: no file */
  assert_int_equal(setrlimit(RLIMIT_FSIZE, &full), 0);
  const ern_status none = write_and_close("none", &options);
  assert_int_equal(setrlimit(RLIMIT_FSIZE, &limit), 0);
  assert_int_equal(status, ERN_E_IO);
  assert_int_equal(bytes_of("full"), 4 * SIDE * SIDE * 3);
  assert_int_equal(none, ERN_E_IO);
  assert_int_equal(access("none", F_OK), -1);
}

static int stops(void *user) {
  (void)user;
  return 1;
}

/* A program that is being stopped when the disk is full: a file waits for nobody, so the disk is the error. */
static void test_a_full_disk_while_it_stops(void **state) {
  (void)state;
  struct rlimit limit;
  ern_stream_options options = options_of_stream("raw");
  options.stop = stops;
  assert_int_equal(getrlimit(RLIMIT_FSIZE, &limit), 0);
  const struct rlimit full = {4 * SIDE * SIDE * 3 + 7, limit.rlim_max};
  (void)unlink("stopped");
  assert_int_equal(setrlimit(RLIMIT_FSIZE, &full), 0);
  const ern_status status = write_and_close("stopped", &options);
  assert_int_equal(setrlimit(RLIMIT_FSIZE, &limit), 0);
  support_expect(context, status, ERN_E_IO, "stopped", "it is cut", NULL);
  assert_int_equal(bytes_of("stopped"), 4 * SIDE * SIDE * 3);
}

/* A process that is killed leaves a temporary file that plays, but for its last second. */
static void test_a_killed_process_leaves_what_plays(void **state) {
  (void)state;
  for (size_t i = 0; i < sizeof cut_forms / sizeof *cut_forms; i++) {
    const ern_stream_options options = options_of_stream(cut_forms[i]);
    int how = 0;
    (void)unlink("killed");
    fflush(NULL);
    const pid_t child = fork();
    assert_true(child >= 0);
    if (child == 0) {
      ern_stream_writer *writer;
      if (ern_stream_writer_open(context, "killed", &options, &writer) == ERN_OK && write_frames(writer) == ERN_OK)
        (void)raise(SIGKILL);
      _exit(1);
    }
    assert_int_equal(waitpid(child, &how, 0), child);
    assert_true(WIFSIGNALED(how));
    assert_int_equal(access("killed", F_OK), -1);
    expect_plays("killed.ernerf-tmp", cut_forms[i], FRAMES - FPS - 1);
  }
}

/* A file of the stream's name appears while it is written: both are kept. Where the temporary file was removed, only
 * the error of that is told. */
static void test_a_taken_name_keeps_the_recording(void **state) {
  (void)state;
  const ern_stream_options options = options_of_stream("nut");
  ern_context *keeping = NULL;
  ern_context_config config = ern_context_config_default();
  config.keep_files = true;
  assert_int_equal(ern_context_create(&keeping, &config), ERN_OK);
  for (int removed = 0; removed < 2; removed++) {
    ern_stream_writer *writer;
    (void)unlink("taken");
    support_ok(keeping, ern_stream_writer_open(keeping, "taken", &options, &writer));
    support_ok(keeping, write_frames(writer));
    support_write_text("taken", "theirs");
    if (removed) assert_int_equal(unlink("taken.ernerf-tmp"), 0);
    support_expect(keeping, ern_stream_writer_close(&writer), removed ? ERN_E_IO : ERN_E_EXISTS,
                   removed ? "removed or replaced by another process" : "it is kept", "taken.ernerf-tmp", NULL);
    assert_int_equal(bytes_of("taken"), 6);
    if (!removed) expect_plays("taken.ernerf-tmp", "nut", FRAMES);
    assert_int_equal(access("taken.ernerf-tmp", F_OK), removed ? -1 : 0);
  }
  ern_context_free(&keeping);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_a_taken_name_keeps_the_recording),
                                     cmocka_unit_test(test_a_full_disk_keeps_what_was_written),
                                     cmocka_unit_test(test_a_full_disk_while_it_stops),
                                     cmocka_unit_test(test_a_killed_process_leaves_what_plays)};
  return cmocka_run_group_tests(tests, set_up, tear_down);
}
