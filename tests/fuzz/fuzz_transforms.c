/* SPDX-License-Identifier: MIT
 * Any bytes as a transforms_*.json file. */
#include <float.h>
#include <math.h>

#include "ernerf/data.h"
#include "fuzz.h"

static void check_pose(const ern_pose *pose) {
  FUZZ_REQUIRE(pose->img_id >= 0 && pose->aud_id >= 0);
  for (int i = 0; i < 16; i++) FUZZ_REQUIRE(fabsf(pose->matrix[i]) <= (i % 4 == 3 ? 1e6f : 1e3f));
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  static const char path[] = "fuzz.json";
  ern_context *context = fuzz_context();
  ern_pose_list list;
  fuzz_file(path, bytes, count);
  if (ern_pose_list_load(context, path, &list) != ERN_OK) {
    fuzz_refused(context, path);
    FUZZ_REQUIRE(list.poses == NULL && list.count == 0);
    return 0;
  }
  FUZZ_REQUIRE(list.count > 0 && list.width >= 1 && list.width <= 8192 && list.height >= 1 && list.height <= 8192);
  FUZZ_REQUIRE(list.focal > 0 && list.cx > 0 && list.cy > 0);
  FUZZ_REQUIRE(list.focal <= (double)FLT_MAX && list.cx <= (double)FLT_MAX && list.cy <= (double)FLT_MAX);
  for (size_t i = 0; i < list.count; i++) check_pose(&list.poses[i]);
  ern_pose_list_free(context, &list);
  return 0;
}
