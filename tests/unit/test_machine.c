/* SPDX-License-Identifier: MIT
 * What control groups allow, read from made-up trees of files as containers, services and batch systems have them. */
#define _GNU_SOURCE /* sched_getaffinity */
#include <math.h>
#include <sched.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/machine.h"
#include "ernerf/backend.h"
#include "support.h"

static const char tree[] = "tree";

/* TREE/PATH with the text, and the folders that it lies in. */
static void put(const char *path, const char *text) {
  char whole[1024];
  snprintf(whole, sizeof whole, "%s%s", tree, path);
  for (char *slash = strchr(whole, '/'); slash != NULL; slash = strchr(slash + 1, '/')) {
    *slash = 0;
    mkdir(whole, 0777);
    *slash = '/';
  }
  support_write_text(whole, text);
}

static void expect(double cores, double memory) {
  struct ern_machine_limits found;
  ern_machine_limits(tree, &found);
  if (found.cores != cores || (double)found.memory != memory)
    fail_msg("found %g cores and %g bytes, expected %g and %g", found.cores, (double)found.memory, cores, memory);
}

static const double any = 18446744073709551615.0;

static void begin(const char *groups, const char *mounts) {
  support_clear(tree);
  put("/proc/self/cgroup", groups);
  put("/proc/self/mountinfo", mounts);
}

#define MOUNT_2 "30 23 0:26 / /sys/fs/cgroup rw,nosuid shared:4 - cgroup2 cgroup2 rw,nsdelegate\n"

static void test_version_2(void **state) {
  (void)state;
  begin("0::/user.slice/job\n", "22 1 8:1 / / rw - ext4 /dev/sda1 rw\n" MOUNT_2);
  expect(INFINITY, any);
  put("/sys/fs/cgroup/user.slice/job/memory.max", "max\n");
  put("/sys/fs/cgroup/user.slice/job/cpu.max", "max 100000\n");
  expect(INFINITY, any);
  put("/sys/fs/cgroup/user.slice/job/memory.max", "4000000000\n");
  put("/sys/fs/cgroup/user.slice/job/cpu.max", "150000 100000\n");
  expect(1.5, 4e9);
  put("/sys/fs/cgroup/user.slice/job/memory.high", "3000000000\n");
  expect(1.5, 3e9);
  put("/sys/fs/cgroup/user.slice/memory.max", "2000000000\n"); /* a group has no more than those above it */
  put("/sys/fs/cgroup/user.slice/cpu.max", "400000 100000\n");
  expect(1.5, 2e9);
  put("/sys/fs/cgroup/cpu.max", "50000 100000\n");
  expect(0.5, 2e9);
  put("/sys/fs/cgroup/other/memory.max", "1000\n"); /* of others */
  put("/sys/fs/memory.max", "1000\n");              /* above the hierarchy */
  expect(0.5, 2e9);
}

/* As in Docker without a namespace of its own: the container sees its own part of the hierarchies alone. */
static void test_version_1(void **state) {
  (void)state;
  begin("5:memory:/docker/abc/sub\n4:cpu,cpuacct:/docker/abc\n1:name=systemd:/docker/abc\n0::/\n",
        "40 30 0:30 /docker/abc /sys/fs/cgroup/memory ro - cgroup cgroup rw,memory\n"
        "41 30 0:31 /docker/abc /sys/fs/cgroup/cpu,cpuacct ro master:9 - cgroup cgroup rw,cpu,cpuacct\n");
  put("/sys/fs/cgroup/memory/memory.limit_in_bytes", "9223372036854771712\n");
  put("/sys/fs/cgroup/cpu,cpuacct/cpu.cfs_quota_us", "-1\n");
  put("/sys/fs/cgroup/cpu,cpuacct/cpu.cfs_period_us", "100000\n");
  expect(INFINITY, 9223372036854771712.0);
  put("/sys/fs/cgroup/memory/memory.limit_in_bytes", "5000000000\n");
  put("/sys/fs/cgroup/memory/sub/memory.limit_in_bytes", "1000000000\n");
  put("/sys/fs/cgroup/cpu,cpuacct/cpu.cfs_quota_us", "250000\n");
  expect(2.5, 1e9);
}

/* A group that the mount does not reach: the mount's root is what is left to look at. */
static void test_outside(void **state) {
  (void)state;
  begin("0::/../../host\n", MOUNT_2);
  put("/sys/fs/cgroup/memory.max", "7000000000\n");
  put("/sys/host/memory.max", "1000\n");
  expect(INFINITY, 7e9);
  begin("0::/elsewhere\n", "30 23 0:26 /mine /sys/fs/cgroup rw - cgroup2 cgroup2 rw\n");
  put("/sys/fs/cgroup/memory.max", "7000000000\n");
  put("/sys/fs/cgroup/elsewhere/memory.max", "1000\n");
  expect(INFINITY, 7e9);
  begin("0::/minefield\n", "30 23 0:26 /mine /sys/fs/cgroup rw - cgroup2 cgroup2 rw\n"); /* not below /mine */
  put("/sys/fs/cgroup/memory.max", "7000000000\n");
  put("/sys/fs/cgroup/field/memory.max", "1000\n");
  expect(INFINITY, 7e9);
}

static void test_nothing_there(void **state) {
  (void)state;
  support_clear(tree);
  expect(INFINITY, any);
  begin("", "");
  expect(INFINITY, any);
  begin("0::/a\n", MOUNT_2); /* folders that are not there */
  expect(INFINITY, any);
}

static void test_hostile(void **state) {
  (void)state;
  static const char *const junk[] = {"",           "-5 100000\n", "0\n",   "99999999999999999999999999\n",
                                     "12abc\n",    "1e3",         "5 0\n", "\n\n5 100000",
                                     "0x10 0x10\n"};
  static char line[20000];
  for (size_t i = 0; i < sizeof junk / sizeof *junk; i++) {
    begin("0::/a\n", MOUNT_2);
    put("/sys/fs/cgroup/a/memory.max", junk[i]);
    put("/sys/fs/cgroup/a/cpu.max", junk[i]);
    expect(INFINITY, any);
  }
  begin("0::/a\n::\n:\n4\nx:memory\n", "30 23\n- \n - cgroup2\n30 23 0:26 / /x rw - cgroup2\n" MOUNT_2);
  put("/sys/fs/cgroup/a/memory.max", "6000000000\n");
  put("/sys/fs/cgroup/a/cpu.max/x", "a folder in place of the file");
  expect(INFINITY, 6e9);
  memset(line, 'x', sizeof line - 1); /* a line that is longer than any is passed over, and the next is not */
  snprintf(line + 15000, 1000, "\n%s", MOUNT_2);
  begin("0::/a\n", line);
  put("/sys/fs/cgroup/a/memory.max", "6000000000\n");
  expect(INFINITY, 6e9);
  support_clear(tree);
  put("/proc/self/cgroup", "0::/a\n");
  assert_int_equal(mkfifo("tree/proc/self/mountinfo", 0600), 0); /* waits for no writer */
  expect(INFINITY, any);
}

static void keep_cpu(void *user, const ern_device_info *device) {
  if (strcmp(device->kind, "cpu") == 0) *(unsigned *)user = device->compute_units;
}

/* A thread that may run on one core is one core, whatever the machine has. */
static void test_this_machine(void **state) {
  (void)state;
  cpu_set_t before, one;
  unsigned units = 0;
  ern_context *context = support_context();
  ern_backend *backend = NULL;
  ern_backend_info info;
  assert_true(ern_machine_cores() >= 1);
  assert_true(ern_machine_memory() >= (uint64_t)1 << 20);
  assert_int_equal(sched_getaffinity(0, sizeof before, &before), 0);
  CPU_ZERO(&one);
  for (size_t i = 0; i < CPU_SETSIZE && CPU_COUNT(&one) == 0; i++)
    if (CPU_ISSET(i, &before)) CPU_SET(i, &one);
  assert_int_equal(sched_setaffinity(0, sizeof one, &one), 0);
  assert_int_equal(ern_machine_cores(), 1);
  support_ok(context, ern_devices_list(context, keep_cpu, &units));
  assert_int_equal(units, 1);
  support_ok(context, ern_backend_create(&backend, context, NULL));
  ern_backend_describe(backend, &info);
  assert_int_equal(info.threads, 1);
  assert_int_equal(sched_setaffinity(0, sizeof before, &before), 0);
  ern_backend_free(&backend);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_version_2), cmocka_unit_test(test_version_1),
                                     cmocka_unit_test(test_outside),   cmocka_unit_test(test_nothing_there),
                                     cmocka_unit_test(test_hostile),   cmocka_unit_test(test_this_machine)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
