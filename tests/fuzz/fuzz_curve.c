/* SPDX-License-Identifier: MIT
 * Any bytes as the curve.csv that a training left, and that a plot is made from. */
#include "fuzz.h"
#include "output/curve.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  struct session session = {.verb = "fuzz"};
  struct curve curve = {0};
  fuzz_file("fuzz.csv", bytes, count);
  if (curve_read(&curve, &session, "fuzz.csv") == 0) {
    for (size_t i = 1; i < curve.count; i++) FUZZ_REQUIRE(curve.point[i].step > curve.point[i - 1].step);
  }
  curve_free(&curve);
  return 0;
}
