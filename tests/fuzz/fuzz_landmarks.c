/* SPDX-License-Identifier: MIT
 * Any bytes as a .lms file. */
#include <math.h>

#include "fuzz.h"
#include "io/landmarks.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  static const char path[] = "fuzz.lms";
  ern_context *context = fuzz_context();
  float points[ERN_LANDMARKS][2];
  fuzz_file(path, bytes, count);
  if (ern_landmarks_read(context, path, points) != ERN_OK) {
    fuzz_refused(context, path);
    return 0;
  }
  for (int i = 0; i < ERN_LANDMARKS; i++) FUZZ_REQUIRE(isfinite(points[i][0]) && isfinite(points[i][1]));
  return 0;
}
