/* SPDX-License-Identifier: MIT
 * Any bytes as a table of action units, and as a curve of the lids in text. */
#include <math.h>

#include "ernerf/data.h"
#include "fuzz.h"
#include "io/csv.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  static const char path[] = "fuzz.csv";
  ern_context *context = fuzz_context();
  float *values = NULL;
  size_t rows = 0;
  ern_eyes eyes;
  fuzz_file(path, bytes, count);
  if (ern_csv_read_column(context, path, "AU45_r", &values, &rows) == ERN_OK) {
    for (size_t i = 0; i < rows; i++) FUZZ_REQUIRE(isfinite(values[i]));
  } else {
    fuzz_refused(context, path);
    FUZZ_REQUIRE(values == NULL && rows == 0);
  }
  ern_release(context, values);
  if (ern_eyes_load(context, path, &eyes) == ERN_OK) {
    FUZZ_REQUIRE(eyes.count > 0);
    for (size_t i = 0; i < eyes.count; i++) FUZZ_REQUIRE(eyes.data[i] >= 0 && eyes.data[i] <= 1);
  } else {
    fuzz_refused(context, path);
  }
  ern_eyes_free(context, &eyes);
  return 0;
}
