/* SPDX-License-Identifier: MIT
 * Same seed, same bytes, of heads of every backbone, for 1, 2 and 4 threads and on every run. Occupancy is refreshed in
 * one of 512 cells: all of them take the mlp backbone a minute. */
#include "../made_clip.h"

#include "train/trainer.h"

enum { SPARSER = 512, STEPS = 2 };

static struct made data;

/* Leaves one of so many cells, evenly, in the list of those that a refresh looks at. */
static void thin_out(ern_trainer *trainer) {
  const struct ern_backend *backend = trainer->backend;
  const size_t count = trainer->cell_count, left = count / SPARSER;
  int32_t *cells = malloc(count * sizeof *cells);
  assert_non_null(cells);
  support_ok(data.context, backend->download_int32(trainer->stream, cells, trainer->cells, count));
  for (size_t i = 0; i < left; i++) cells[i] = cells[SPARSER * i];
  support_ok(data.context, backend->upload_int32(trainer->stream, trainer->cells, cells, left));
  trainer->cell_count = left;
  free(cells);
}

/* The model after some steps, as the bytes of its file; the caller frees them. */
static char *train_kind(ern_backbone backbone, int threads, uint64_t seed, size_t *count) {
  ern_train_config config = small_config(STEPS, NULL);
  ern_trainer *trainer = NULL;
  ern_train_report report;
  ern_model *model = NULL;
  config.backbone = backbone;
  config.threads = threads;
  config.seed = seed;
  config.rays = 256;
  if (backbone == ERN_BACKBONE_TRIPLANE || backbone == ERN_BACKBONE_MLP) config.levels = 0;
  support_ok(data.context, ern_trainer_create(&trainer, data.backend, &data.data, &config));
  thin_out(trainer);
  for (int step = 0; step < STEPS; step++) support_ok(data.context, ern_trainer_step(trainer, &report));
  assert_true(isfinite(report.loss) && report.loss > 0 && trainer->cell_count > 100);
  support_ok(data.context, ern_trainer_model(trainer, &model));
  support_ok(data.context, ern_model_save(model, "kind.safetensors"));
  ern_model_free(&model);
  ern_trainer_free(&trainer);
  return read_file("kind.safetensors", count);
}

static void same_for_all(ern_backbone backbone) {
  static const int threads[] = {1, 2, 4, 1};
  size_t first = 0, count = 0;
  char *expected = train_kind(backbone, 1, 7, &first), *other = train_kind(backbone, 1, 8, &count);
  assert_true(first != count || memcmp(expected, other, first) != 0);
  free(other);
  for (size_t i = 0; i < sizeof threads / sizeof *threads; i++) {
    char *found = train_kind(backbone, threads[i], 7, &count);
    if (first != count || memcmp(expected, found, first) != 0)
      fail_msg("%s: %d threads give other bytes than one", ern_backbone_name(backbone), threads[i]);
    free(found);
  }
  free(expected);
}

static void test_trihash(void **state) { (void)state, same_for_all(ERN_BACKBONE_TRIHASH); }
static void test_hash3d(void **state) { (void)state, same_for_all(ERN_BACKBONE_HASH3D); }
static void test_triplane(void **state) { (void)state, same_for_all(ERN_BACKBONE_TRIPLANE); }
static void test_mlp(void **state) { (void)state, same_for_all(ERN_BACKBONE_MLP); }

static int prepare(void **state) {
  (void)state;
  made_open(&data);
  return 0;
}

static int close_all(void **state) {
  (void)state;
  made_close(&data);
  return 0;
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_trihash), cmocka_unit_test(test_hash3d),
                                     cmocka_unit_test(test_triplane), cmocka_unit_test(test_mlp)};
  return cmocka_run_group_tests(tests, prepare, close_all);
}
