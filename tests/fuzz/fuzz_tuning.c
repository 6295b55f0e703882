/* SPDX-License-Identifier: MIT
 * Any bytes as what the cache folder keeps of an OpenCL device's sizes: the whole entry, or what a head that fits
 * stands before. No device is needed. */
#include <sys/stat.h>

#include "backend_opencl/device/tune.h"
#include "fuzz.h"
#include "io/file.h"

enum { SUM = 64, HEAD = 2 * SUM, MOST = 1 << 12 };

static void make_path(ern_context *context, const struct ern_cl_device *device, char key[ERN_CL_KEY_BYTES],
                      char path[256]) {
  char folder[128];
  FUZZ_REQUIRE(getcwd(folder, sizeof folder) != NULL);
  FUZZ_REQUIRE(setenv("XDG_CACHE_HOME", folder, 1) == 0);
  (void)mkdir("libernerf", 0777);
  FUZZ_REQUIRE(ern_cl_tune_key(context, device, key) == ERN_OK);
  snprintf(path, 256, "libernerf/%s.clbin", key);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  static struct ern_cl_device device = {.cpu = true, .host = true, .width = 8};
  static char key[ERN_CL_KEY_BYTES], path[256];
  static uint8_t entry[HEAD + MOST];
  ern_context *context = fuzz_context();
  struct ern_cl_measured measured[ERN_CL_TUNABLE_COUNT];
  if (path[0] == 0) make_path(context, &device, key, path);
  if (count == 0 || count > MOST) return 0;
  const bool fits = bytes[0] % 2 != 0;
  char sum[SUM + 1];
  memcpy(entry + SUM, key, SUM);
  memcpy(entry + HEAD, bytes + 1, count - 1);
  ern_sha256_hex(entry + SUM, SUM + count - 1, sum);
  memcpy(entry, sum, SUM);
  if (fits)
    fuzz_file(path, entry, HEAD + count - 1);
  else
    fuzz_file(path, bytes + 1, count - 1);
  ern_cl_tune_read(context, &device, measured);
  for (int tunable = 0; tunable < ERN_CL_TUNABLE_COUNT; tunable++) {
    const struct ern_cl_measured *m = &measured[tunable];
    if (m->standard_ns == 0) continue;
    FUZZ_REQUIRE(fits && m->standard_ns > 0 && m->best_ns > 0 && m->best_ns < INT64_MAX / 105 && m->best >= 1 &&
                 m->best <= 1024);
    FUZZ_REQUIRE(m->standard == ern_cl_standard_size(&device, (ern_cl_tunable)tunable));
    FUZZ_REQUIRE(ern_cl_size_selected(m) >= 1);
  }
  return 0;
}
