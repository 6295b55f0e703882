/* SPDX-License-Identifier: MIT
 * What writing a file does to other files: nothing. Temporary files that are held, left over, or somebody else's;
 * links; files that are kept. */
#define _GNU_SOURCE /* unshare */
#include "../support.h"

#include <sched.h>
#include <signal.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "core/memory.h"
#include "ernerf/data.h"
#include "io/file.h"

static ern_context *context;

static int start(void **state) {
  (void)state;
  static const char *const old[] = {"d", "e"};
  for (size_t i = 0; i < sizeof old / sizeof *old; i++) support_clear(old[i]);
  assert_int_equal(mkdir("d", 0777), 0);
  assert_int_equal(mkdir("e", 0777), 0);
  context = support_context();
  return 0;
}

static int end(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

static ern_status put(const char *path, const char *text) {
  return ern_file_write(context, path, text, strlen(text), ERN_EXISTING_BY_CONTEXT);
}

static void expect_text(const char *path, const char *expected) {
  char text[256] = "";
  FILE *file = fopen(path, "rb");
  if (file == NULL) fail_msg("%s is not there", path);
  text[fread(text, 1, sizeof text - 1, file)] = 0;
  fclose(file);
  assert_string_equal(text, expected);
}

static bool is_there(const char *path) {
  struct stat about;
  return lstat(path, &about) == 0;
}

/* ---- the temporary file ------------------------------------------------------------------------------------------ */

/* Files that look like temporary ones, of this and of other outputs, stay as they are. */
static void test_neighbours(void **state) {
  (void)state;
  static const char *const names[] = {"d/thesis.tmp-99999", "d/.cache.tmp-77777.db",     "d/out.mp4.tmp-99999",
                                      "d/.out.tmp-9.mp4",   "d/out10.mp4.ernerf-tmp",    "d/out.mp4.ernerf-tmp2",
                                      "d/out.ernerf-tmp",   "d/out.mp4.ernerf-tmp.save", "d/.ernerf-tmp"};
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) support_write_text(names[i], "mine");
  support_ok(context, put("d/out.mp4", "made"));
  support_expect(context, put("d/no/out.mp4", "made"), ERN_E_MISSING, "d/no/out.mp4", NULL);
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) expect_text(names[i], "mine");
  expect_text("d/out.mp4", "made");
  assert_false(is_there("d/out.mp4.ernerf-tmp"));
}

/* What a killed process left is reused by the next one that writes the same file. */
static void test_left_over(void **state) {
  (void)state;
  support_write_text("d/out.mp4.ernerf-tmp", "the longer half of a video");
  assert_int_equal(chmod("d/out.mp4.ernerf-tmp", 01644), 0); /* the mark */
  support_ok(context, put("d/out.mp4", "made"));
  expect_text("d/out.mp4", "made");
  assert_false(is_there("d/out.mp4.ernerf-tmp"));
}

struct holder {
  pid_t child, holds; /* of this test; that which has the lock, the child or its child */
};

/* Writes half of d/held, says so with its process number, and waits. */
static void hold(int ready, pid_t number) {
  struct ern_file_writer writer;
  if (ern_file_writer_open(context, "d/held", ERN_EXISTING_REPLACE, &writer) != ERN_OK ||
      ern_file_writer_write(&writer, "half", 4) != ERN_OK)
    number = -1;
  (void)!write(ready, &number, sizeof number);
  for (;;) pause();
}

/* In a namespace of its own the holder has the process number 1. The parent there says which number it has here. */
static void hold_in_namespace(int ready) {
  pid_t number = 0;
  int inner[2];
  if (pipe(inner) != 0 || unshare(CLONE_NEWUSER | CLONE_NEWPID) != 0 || (number = fork()) < 0) {
    number = 0;
    (void)!write(ready, &number, sizeof number);
    _exit(0);
  }
  if (number == 0) hold(inner[1], getpid());
  pid_t seen = 0;
  if (read(inner[0], &seen, sizeof seen) != sizeof seen || seen != 1) number = -1;
  (void)!write(ready, &number, sizeof number);
  waitpid(number, NULL, 0);
  _exit(0);
}

/* holds 0: the system refuses namespaces. */
static struct holder start_holder(bool in_namespace) {
  struct holder made = {0};
  int ready[2];
  assert_int_equal(pipe(ready), 0);
  made.child = fork();
  assert_true(made.child >= 0);
  if (made.child == 0 && in_namespace) hold_in_namespace(ready[1]);
  if (made.child == 0) hold(ready[1], getpid());
  assert_int_equal(read(ready[0], &made.holds, sizeof made.holds), sizeof made.holds);
  close(ready[0]);
  close(ready[1]);
  assert_true(made.holds >= 0);
  if (made.holds == 0) waitpid(made.child, NULL, 0);
  return made;
}

static void stop_holder(struct holder holder) {
  assert_int_equal(kill(holder.holds, SIGKILL), 0);
  assert_int_equal(waitpid(holder.child, NULL, 0), holder.child);
}

static void look_at_held(struct holder holder) {
  support_expect(context, put("d/held", "mine"), ERN_E_BUSY, "d/held", "d/held.ernerf-tmp", "another process", NULL);
  assert_false(is_there("d/held"));
  support_ok(context, put("d/held2", "mine"));
  expect_text("d/held.ernerf-tmp", "half");
  stop_holder(holder);
  expect_text("d/held.ernerf-tmp", "half"); /* left over by the kill */
  support_ok(context, put("d/held", "mine"));
  expect_text("d/held", "mine");
  assert_false(is_there("d/held.ernerf-tmp"));
}

static void test_held(void **state) {
  (void)state;
  look_at_held(start_holder(false));
}

static void test_held_in_namespace(void **state) {
  (void)state;
  const struct holder holder = start_holder(true);
  if (holder.holds == 0) skip();
  look_at_held(holder);
}

/* The lock lives as long as the descriptor is open anywhere: here in a child, after the process that took it is dead.
 */
static void test_held_by_descriptor(void **state) {
  (void)state;
  int stay[2];
  char end = 0;
  assert_int_equal(pipe(stay), 0);
  const pid_t taker = fork();
  assert_true(taker >= 0);
  if (taker == 0) {
    struct ern_file_writer writer;
    if (ern_file_writer_open(context, "d/held", ERN_EXISTING_REPLACE, &writer) != ERN_OK) _exit(1);
    if (fork() > 0) _exit(0);
    close(stay[1]);
    (void)!read(stay[0], &end, 1);
    _exit(0);
  }
  int status = 1;
  assert_int_equal(waitpid(taker, &status, 0), taker);
  assert_int_equal(status, 0);
  support_expect(context, put("d/held", "mine"), ERN_E_BUSY, "another process", NULL);
  close(stay[1]); /* the child ends */
  close(stay[0]);
  for (int i = 0; i < 500 && put("d/held", "mine") != ERN_OK; i++) usleep(10000);
  expect_text("d/held", "mine");
}

/* Something else under the temporary name: nothing behind it is touched. */
static void test_in_the_way(void **state) {
  (void)state;
  support_write_text("d/thesis", "years of work");
  assert_int_equal(symlink("thesis", "d/a.ernerf-tmp"), 0);
  assert_int_not_equal(put("d/a", "made"), ERN_OK);
  assert_int_equal(mkfifo("d/b.ernerf-tmp", 0600), 0);
  support_expect(context, put("d/b", "made"), ERN_E_BUSY, "no regular file", NULL);
  assert_int_equal(mkdir("d/c.ernerf-tmp", 0700), 0);
  assert_int_not_equal(put("d/c", "made"), ERN_OK);
  assert_true(is_there("d/b.ernerf-tmp") && is_there("d/c.ernerf-tmp") && is_there("d/a.ernerf-tmp"));
  /* a second name of a file, and a file of somebody's: neither has the mark */
  assert_int_equal(link("d/thesis", "d/e.ernerf-tmp"), 0);
  support_expect(context, put("d/e", "made"), ERN_E_BUSY, "not made by this program", NULL);
  support_write_text("d/f.ernerf-tmp", "mine");
  support_expect(context, put("d/f", "made"), ERN_E_BUSY, "d/f.ernerf-tmp", "not made by this program", NULL);
  expect_text("d/thesis", "years of work");
  expect_text("d/f.ernerf-tmp", "mine");
  assert_true(is_there("d/e.ernerf-tmp") && !is_there("d/e") && !is_there("d/f"));
}

/* Killed after it had its final name: only the temporary name goes. */
static void test_killed_between_names(void **state) {
  (void)state;
  support_write_text("d/g", "whole");
  assert_int_equal(link("d/g", "d/g.ernerf-tmp"), 0);
  assert_int_equal(chmod("d/g", 01644), 0);
  support_expect(context, ern_file_write(context, "d/g", "new", 3, ERN_EXISTING_KEEP), ERN_E_EXISTS, "d/g", NULL);
  support_ok(context, put("d/g", "new"));
  expect_text("d/g", "new");
  assert_false(is_there("d/g.ernerf-tmp"));
}

/* The temporary file is removed while it is written, and another writer makes it again: its half is not put in place.
 */
static void test_taken_away(void **state) {
  (void)state;
  struct ern_file_writer first, second;
  support_write_text("d/a", "old");
  support_ok(context, ern_file_writer_open(context, "d/a", ERN_EXISTING_REPLACE, &first));
  support_ok(context, ern_file_writer_write(&first, "first", 5));
  assert_int_equal(unlink("d/a.ernerf-tmp"), 0);
  support_ok(context, ern_file_writer_open(context, "d/a", ERN_EXISTING_REPLACE, &second));
  support_ok(context, ern_file_writer_write(&second, "sec", 3));
  support_expect(context, ern_file_writer_commit(&first), ERN_E_IO, "d/a", "removed or replaced", NULL);
  expect_text("d/a", "old");
  support_ok(context, ern_file_writer_write(&second, "ond", 3));
  support_ok(context, ern_file_writer_commit(&second));
  expect_text("d/a", "second");
}

/* The folder is moved while a file is written: nothing of the file stays in it. */
static void test_folder_is_moved(void **state) {
  (void)state;
  struct ern_file_writer writer;
  support_clear("before");
  support_clear("after");
  for (int commits = 0; commits < 2; commits++) {
    assert_int_equal(mkdir("before", 0777), 0);
    support_ok(context, ern_file_writer_open(context, "before/a", ERN_EXISTING_REPLACE, &writer));
    support_ok(context, ern_file_writer_write(&writer, "half", 4));
    assert_int_equal(rename("before", "after"), 0);
    if (commits != 0)
      support_expect(context, ern_file_writer_commit(&writer), ERN_E_IO, "before/a", NULL);
    else
      ern_file_writer_abandon(&writer);
    assert_int_equal(rmdir("after"), 0); /* is empty */
  }
}

/* Of one name twice the second would be taken for another process's. */
static void test_same_name_twice(void **state) {
  (void)state;
  const char *const paths[] = {"d/b", "d/c", "d/b"};
  const void *const bytes[] = {"1", "2", "3"};
  const size_t sizes[] = {1, 1, 1};
  support_expect(context, ern_files_save(context, 3, paths, bytes, sizes), ERN_E_ARGUMENT, "d/b", "paths[0]",
                 "paths[2]", NULL);
  assert_false(is_there("d/b") || is_there("d/c"));
}

/* An empty path is no name for a file beside .ernerf-tmp of the working folder. */
static void test_no_name(void **state) {
  (void)state;
  support_write_text(".ernerf-tmp", "mine");
  support_expect(context, ern_file_save(context, "", "text", 4), ERN_E_ARGUMENT, "empty", NULL);
  expect_text(".ernerf-tmp", "mine");
  assert_int_equal(unlink(".ernerf-tmp"), 0);
}

static void test_long_names(void **state) {
  (void)state;
  char path[300] = "d/";
  memset(path + 2, 'n', 255);
  support_ok(context, put(path, "made"));
  expect_text(path, "made");
  path[2 + 244] = 0;
  support_ok(context, put(path, "made"));
  expect_text(path, "made");
}

/* ---- the place --------------------------------------------------------------------------------------------------- */

static void expect_link(const char *path) {
  struct stat about;
  assert_int_equal(lstat(path, &about), 0);
  assert_true(S_ISLNK(about.st_mode));
}

static void test_links(void **state) {
  (void)state;
  support_write_text("e/real", "old");
  assert_int_equal(symlink("../e/real", "d/one"), 0);
  assert_int_equal(symlink("one", "d/two"), 0);
  assert_int_equal(symlink("../e/later", "d/dangling"), 0);
  assert_int_equal(symlink("round", "d/round"), 0);
  support_ok(context, put("d/two", "new"));
  expect_link("d/one");
  expect_link("d/two");
  expect_text("e/real", "new");
  support_ok(context, put("d/dangling", "new"));
  expect_link("d/dangling");
  expect_text("e/later", "new");
  support_expect(context, put("d/round", "new"), ERN_E_IO, "d/round", "symbolic links", NULL);
  assert_int_equal(unlink("d/one"), 0);
  assert_int_equal(unlink("d/two"), 0);
}

static void test_modes(void **state) {
  (void)state;
  struct stat about;
  support_write_text("d/private", "old");
  assert_int_equal(chmod("d/private", 0600), 0);
  support_ok(context, put("d/private", "new"));
  assert_int_equal(stat("d/private", &about), 0);
  assert_int_equal(about.st_mode & 07777, 0600);
  assert_int_equal(chmod("d/private", 0400), 0);
  if (geteuid() == 0) return; /* who may write anything */
  support_expect(context, put("d/private", "newer"), ERN_E_IO, "write-protected", NULL);
  expect_text("d/private", "new");
}

/* A rename into an append-only folder or over one is refused by the kernel, so it is refused before the work. */
static void test_append_only(void **state) {
  (void)state;
  support_write_text("d/log", "old");
  if (system("chattr +a d/log 2>/dev/null") != 0) skip(); /* needs root, and a file system with attributes */
  const ern_status asked = ern_file_check_output(context, "d/log");
  assert_int_equal(system("chattr -a d/log && mkdir -p d/logs && chattr +a d/logs"), 0);
  support_expect(context, asked, ERN_E_IO, "d/log", "append-only", NULL);
  const ern_status in_folder = ern_file_check_output(context, "d/logs/new");
  assert_int_equal(system("chattr -a d/logs"), 0);
  support_expect(context, in_folder, ERN_E_IO, "d/logs/new", "append-only", NULL);
  support_ok(context, put("d/log", "new"));
  expect_text("d/log", "new");
}

static void test_mounted(void **state) {
  (void)state;
  support_write_text("d/source", "old");
  support_write_text("d/mounted.json", "old");
  if (system("unshare -m mount --bind d/source d/mounted.json 2>/dev/null") != 0) skip(); /* needs root */
  assert_int_equal(system("unshare -m sh -c 'mount --bind d/source d/mounted.json && "
                          "\"$ERNERF_BIN\" info devices --json=d/mounted.json -y' 2>d/words >d/out"),
                   256);
  assert_int_equal(system("grep -q 'd/mounted.json: cannot write: a file is mounted there' d/words"), 0);
  expect_text("d/source", "old");
}

/* ---- files that are kept ----------------------------------------------------------------------------------------- */

static void test_kept(void **state) {
  (void)state;
  ern_context *keeping = NULL;
  struct ern_file_writer writer;
  ern_context_config config = ern_context_config_default();
  config.keep_files = true;
  assert_int_equal(ern_context_create(&keeping, &config), ERN_OK);
  support_write_text("d/old", "old");
  support_expect(keeping, ern_file_save(keeping, "d/old", "new", 3), ERN_E_EXISTS, "d/old", "is there already", NULL);
  support_expect(keeping, ern_file_check_output(keeping, "d/old"), ERN_E_EXISTS, "d/old", NULL);
  support_ok(keeping, ern_file_check_output(keeping, "d/free"));
  support_expect(keeping, ern_file_check_output(keeping, "d"), ERN_E_IO, "folder", NULL);
  char name[300] = "d/"; /* 256 bytes after the folder */
  memset(name + 2, 'a', 256);
  support_expect(keeping, ern_file_check_output(keeping, name), ERN_E_IO, "too long", NULL);
  support_expect(keeping, ern_file_check_output(keeping, "d/old/new"), ERN_E_IO, "d/old/new", NULL);
  expect_text("d/old", "old");
  /* one that comes while the new one is being written */
  support_ok(keeping, ern_file_writer_open(keeping, "d/soon", ERN_EXISTING_BY_CONTEXT, &writer));
  support_ok(keeping, ern_file_writer_write(&writer, "new", 3));
  support_write_text("d/soon", "theirs");
  support_expect(keeping, ern_file_writer_commit(&writer), ERN_E_EXISTS, "d/soon", NULL);
  expect_text("d/soon", "theirs");
  assert_false(is_there("d/soon.ernerf-tmp"));
  support_ok(keeping, ern_file_save(keeping, "d/fresh", "new", 3));
  expect_text("d/fresh", "new");
  assert_false(is_there("d/fresh.ernerf-tmp"));
  support_ok(keeping, ern_file_write(keeping, "d/old", "new", 3, ERN_EXISTING_REPLACE));
  expect_text("d/old", "new");
  assert_int_equal(ern_file_write(context, "d/old", "newer", 5, ERN_EXISTING_KEEP), ERN_E_EXISTS);
  ern_context_free(&keeping);
}

static void test_devices(void **state) {
  (void)state;
  struct stat about;
  support_expect(context, ern_file_save(context, "/dev/null", "text", 4), ERN_E_IO, "/dev/null", "device", NULL);
  assert_int_equal(symlink("/dev/null", "d/null"), 0);
  support_expect(context, ern_file_save(context, "d/null", "text", 4), ERN_E_IO, "d/null", "device", NULL);
  assert_int_equal(stat("/dev/null", &about), 0);
  assert_true(S_ISCHR(about.st_mode));
  assert_int_equal(ern_file_save(context, NULL, "text", 4), ERN_E_ARGUMENT);
  assert_int_equal(ern_file_save(context, "d/x", NULL, 4), ERN_E_ARGUMENT);
}

/* A leftover gives a new file no rights that the umask denies. */
static void test_rights_of_a_leftover(void **state) {
  (void)state;
  struct stat about;
  support_clear("private");
  support_write_text("private.ernerf-tmp", "half");
  assert_int_equal(chmod("private.ernerf-tmp", 01644), 0); /* the mark */
  const mode_t mask = umask(077);
  support_ok(context, ern_file_save(context, "private", "whole", 5));
  umask(mask);
  assert_int_equal(stat("private", &about), 0);
  assert_int_equal(about.st_mode & 07777, 0600);
}

/* What is replaced keeps its group and owner, where the process may give them. */
static void test_owner(void **state) {
  (void)state;
  if (geteuid() != 0) skip();
  struct stat about;
  support_clear("theirs");
  support_write_text("theirs", "old");
  assert_int_equal(chown("theirs", 1000, 2000), 0);
  assert_int_equal(chmod("theirs", 0640), 0);
  support_ok(context, ern_file_save(context, "theirs", "new", 3));
  assert_int_equal(stat("theirs", &about), 0);
  assert_true(about.st_uid == 1000 && about.st_gid == 2000 && (about.st_mode & 07777) == 0640);
}

/* Outputs are checked before the work: what cannot be put in place at its end is refused. */
static void test_folder_of_others(void **state) {
  (void)state;
  if (geteuid() != 0) skip();
  support_clear("shared");
  support_clear("closed");
  assert_int_equal(mkdir("shared", 0755) | mkdir("closed", 0755), 0);
  support_write_text("shared/theirs", "old");
  support_write_text("closed/open", "old");
  assert_int_equal(chmod("shared/theirs", 0666), 0);
  assert_int_equal(chmod("closed/open", 0666), 0);
  assert_int_equal(chmod("shared", 01777), 0);
  assert_int_equal(chmod("closed", 0555), 0);
  assert_int_equal(symlink("../shared/theirs", "d/to_theirs"), 0);
  assert_int_equal(seteuid(1000), 0);
  const ern_status free_name = ern_file_check_output(context, "shared/ours");
  support_expect(context, ern_file_check_output(context, "shared/theirs"), ERN_E_IO, "another user's", NULL);
  support_expect(context, ern_file_check_output(context, "d/to_theirs"), ERN_E_IO, "another user's", NULL);
  support_expect(context, ern_file_check_output(context, "closed/open"), ERN_E_IO, "Permission denied", NULL);
  support_expect(context, ern_file_check_output(context, "closed/new"), ERN_E_IO, "Permission denied", NULL);
  assert_int_equal(seteuid(0), 0);
  support_ok(context, free_name);
  support_ok(context, ern_file_check_output(context, "shared/theirs"));
  assert_int_equal(unlink("d/to_theirs"), 0);
}

static ern_status write_pair(ern_context *metered) {
  static const char *const paths[] = {"d/one", "d/two"};
  const void *const bytes[] = {"new", "new"};
  const size_t sizes[] = {3, 3};
  for (size_t i = 0; i < 2; i++) support_write_text(paths[i], "old");
  const ern_status status = ern_files_save(metered, 2, paths, bytes, sizes);
  for (size_t i = 0; i < 2; i++) expect_text(paths[i], status == ERN_OK ? "new" : "old");
  return status;
}

/* Want of memory leaves all files as they were: there is none to be had after the first has its name. */
static void test_no_memory(void **state) {
  (void)state;
  support_refuse_each(write_pair);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test_setup_teardown(test_neighbours, start, end),
                                     cmocka_unit_test_setup_teardown(test_left_over, start, end),
                                     cmocka_unit_test_setup_teardown(test_held, start, end),
                                     cmocka_unit_test_setup_teardown(test_held_in_namespace, start, end),
                                     cmocka_unit_test_setup_teardown(test_held_by_descriptor, start, end),
                                     cmocka_unit_test_setup_teardown(test_in_the_way, start, end),
                                     cmocka_unit_test_setup_teardown(test_taken_away, start, end),
                                     cmocka_unit_test_setup_teardown(test_folder_is_moved, start, end),
                                     cmocka_unit_test_setup_teardown(test_same_name_twice, start, end),
                                     cmocka_unit_test_setup_teardown(test_no_name, start, end),
                                     cmocka_unit_test_setup_teardown(test_killed_between_names, start, end),
                                     cmocka_unit_test_setup_teardown(test_long_names, start, end),
                                     cmocka_unit_test_setup_teardown(test_links, start, end),
                                     cmocka_unit_test_setup_teardown(test_modes, start, end),
                                     cmocka_unit_test_setup_teardown(test_append_only, start, end),
                                     cmocka_unit_test_setup_teardown(test_mounted, start, end),
                                     cmocka_unit_test_setup_teardown(test_kept, start, end),
                                     cmocka_unit_test_setup_teardown(test_devices, start, end),
                                     cmocka_unit_test_setup_teardown(test_rights_of_a_leftover, start, end),
                                     cmocka_unit_test_setup_teardown(test_owner, start, end),
                                     cmocka_unit_test_setup_teardown(test_folder_of_others, start, end),
                                     cmocka_unit_test_setup_teardown(test_no_memory, start, end)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
