/* SPDX-License-Identifier: MIT
 * Any header as that of X.run/state.safetensors, which a training goes on from; what does not begin as JSON is taken
 * for a whole file. */
#include <math.h>

#include "fuzz_header.h"
#include "made_clip.h"
#include "train/trainer.h"

static void make(struct made *m, ern_trainer **trainer) {
  ern_train_config config = small_config(100, "fuzz.safetensors");
  config.levels = 2;
  config.threads = 1;
  made_open(m);
  FUZZ_REQUIRE(ern_trainer_create(trainer, m->backend, &m->data, &config) == ERN_OK);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  static struct made m;
  static ern_trainer *trainer;
  bool resumed = false;
  if (trainer == NULL) make(&m, &trainer);
  if (count > 0 && bytes[0] == '{')
    fuzz_header_file(trainer->state.run.state, bytes, count);
  else
    fuzz_file(trainer->state.run.state, bytes, count);
  if (ern_trainer_resume(&trainer->state, &resumed) != ERN_OK) {
    fuzz_refused(m.context, trainer->state.run.state);
    FUZZ_REQUIRE(!resumed);
    return 0;
  }
  FUZZ_REQUIRE(resumed && trainer->shared.step <= (uint64_t)1 << 53 &&
               trainer->values.ema_updates <= (uint64_t)1 << 53);
  FUZZ_REQUIRE(isfinite(trainer->shared.seconds) && trainer->shared.seconds >= 0);
  return 0;
}
