/* SPDX-License-Identifier: MIT
 * Any bytes as the tradeoff.json that the command line picks points from. */
#include <math.h>

#include "fuzz.h"
#include "session/pareto_read.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  struct session session = {.verb = "fuzz"};
  struct pareto_front front;
  fuzz_file("fuzz.json", bytes, count);
  if (pareto_read(&front, &session, "fuzz.json") == 0) {
    FUZZ_REQUIRE(front.count > 0 && front.cores >= 1 && front.width >= 1 && front.height >= 1);
    for (size_t i = 0; i < front.count; i++) {
      const struct pareto_point *point = &front.points[i];
      FUZZ_REQUIRE(point->ms.low > 0 && point->ms.low <= point->ms.median && point->ms.median <= point->ms.high);
      FUZZ_REQUIRE(isfinite(point->exact_db) && isfinite(point->clip_db));
      FUZZ_REQUIRE(point->settings.max_steps >= 1 && point->settings.image_scale > 0);
    }
  }
  pareto_free(&front);
  return 0;
}
