/* SPDX-License-Identifier: MIT
 * The training that test_module.py does once more. Usage: steps CLIP MODEL STEPS; prints the loss of each step. What
 * reads the clip is loaded in an environment that traps every rounding. */
#define _GNU_SOURCE /* feenableexcept */
#include <ernerf/ernerf.h>
#include <ernerf/media.h>
#include <fenv.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

int main(int count, char **words) {
  if (count != 4) return 2;
  ern_context *context = NULL;
  ern_backend *backend = NULL;
  ern_clip *clip = NULL;
  ern_trainer *trainer = NULL;
  ern_dataset dataset;
  ern_train_config config = ern_train_config_default();
  config.output = words[2];
  config.iters = strtoull(words[3], NULL, 10);
  config.rays = 256;
  config.levels = 4;
  config.seed = 7;
  ern_status status = ern_context_create(&context, NULL);
  if (status == ERN_OK) status = ern_backend_create(&backend, context, NULL);
#if defined __GLIBC__
  feclearexcept(FE_ALL_EXCEPT);
  (void)feenableexcept(FE_ALL_EXCEPT); /* processors may have no traps */
#endif
  if (status == ERN_OK) status = ern_clip_open(context, words[1], NULL, &clip);
  fesetenv(FE_DFL_ENV);
  if (status == ERN_OK) ern_clip_dataset(clip, &dataset);
  if (status == ERN_OK) status = ern_trainer_create(&trainer, backend, &dataset, &config);
  for (uint64_t i = 0; status == ERN_OK && i < config.iters; i++) {
    ern_train_report report;
    status = ern_trainer_step(trainer, &report);
    if (status == ERN_OK) printf("%" PRIu64 " %a\n", report.step, report.loss);
  }
  if (status == ERN_OK) status = ern_trainer_save(trainer);
  if (status != ERN_OK) fprintf(stderr, "%s: %s\n", ern_status_name(status), ern_last_error(context));
  ern_trainer_free(&trainer);
  ern_clip_free(&clip);
  ern_backend_free(&backend);
  ern_context_free(&context);
  return status == ERN_OK ? 0 : 1;
}
