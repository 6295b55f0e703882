/* SPDX-License-Identifier: MIT
 * A made-up clip with its true poses, landmarks and masks, and the step "layers" of prepare on it. */
#ifndef ERN_TESTS_MADE_LAYERS_H
#define ERN_TESTS_MADE_LAYERS_H

#include "../support.h"

#include <math.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/memory.h"
#include "ernerf-lab/synth.h"
#include "io/file.h"
#include "prepare/prepare_job.h"

enum { FRAMES = 22 };

/* Of a picture. In the quick test the smallest side that prepare takes, as the cost of a run goes with the area. */
static int side, pixels;
struct truth {
  ern_context *context;
  uint8_t *person, *head; /* [FRAMES][pixels] */
  ern_image background;
};
static struct truth made; /* the one of all tests */

static inline const char *name_of(const char *folder, const char *format, int frame) {
  static char path[4][512];
  static int turn = 0;
  char name[128];
  snprintf(name, sizeof name, format, frame);
  turn = (turn + 1) % 4;
  snprintf(path[turn], sizeof path[turn], "%s/%s", folder, name);
  return path[turn];
}

static inline ern_image picture(ern_context *context, const char *path, int channels) {
  ern_image image = {0};
  support_ok(context, ern_image_read(context, path, channels, &image));
  assert_int_equal(image.width, side);
  assert_int_equal(image.height, side);
  return image;
}

/* A clip without its layers, and what they are: its parsing/ is blue where the head is, white where nobody is. */
static inline int make_truth(void **state) {
  side = getenv("ERNERF_TEST_LONG") != NULL ? 256 : 128;
  pixels = side * side;
  made.context = support_context();
  ern_synth_options options = ern_synth_options_default();
  options.size = side;
  options.frames = FRAMES;
  options.seed = 3;
  options.parsing = true;
  support_ok(made.context, ern_synth_write(made.context, "clip", &options));
  support_ok(made.context, ERN_NEW(made.context, FRAMES * (size_t)pixels, &made.person));
  support_ok(made.context, ERN_NEW(made.context, FRAMES * (size_t)pixels, &made.head));
  made.background = picture(made.context, "clip/bc.jpg", 3);
  for (int f = 0; f < FRAMES; f++) {
    ern_image parts = picture(made.context, name_of("clip", "parsing/%d.png", f), 3);
    for (int k = 0; k < pixels; k++) {
      const uint8_t *rgb = parts.data + 3 * k;
      made.person[f * pixels + k] = rgb[0] == 0 || rgb[1] == 0;
      made.head[f * pixels + k] = rgb[0] == 0 && rgb[2] == 255;
    }
    ern_image_free(made.context, &parts);
    assert_int_equal(rename(name_of("clip", "gt_imgs/%d.jpg", f), name_of("clip", "ori_imgs/%d.jpg", f)), 0);
  }
  support_clear("clip/parsing");
  *state = &made;
  return 0;
}

static inline int free_truth(void **state) {
  struct truth *t = *state;
  ern_release(t->context, t->person);
  ern_release(t->context, t->head);
  ern_image_free(t->context, &t->background);
  ern_context_free(&t->context);
  return 0;
}

struct run {
  ern_prepare_options options;
  ern_prepare_verdict verdict;
  struct ern_prepare_job job;
  json_t *crop; /* the job's own from then on; NULL: none */
};

static inline ern_status run_layers(struct run *run, ern_context *context, size_t frames) {
  run->verdict = (ern_prepare_verdict){.step = "layers"};
  run->options.anew = true; /* files of a made-up clip, and of the run before */
  run->job = (struct ern_prepare_job){.context = context,
                                      .video = "made up",
                                      .folder = "clip",
                                      .options = &run->options,
                                      .side = side,
                                      .frames = frames,
                                      .record = json_object(),
                                      .verdict = &run->verdict,
                                      .figures = json_object()};
  if (run->crop != NULL) assert_int_equal(json_object_set_new(run->job.record, "crop", run->crop), 0);
  const ern_status status = ern_prepare_layers(&run->job);
  json_decref(run->job.record);
  json_decref(run->job.figures);
  return status;
}

/* Masks of the truth, of the person or of the head alone, in `folder`. */
static inline void write_masks(const struct truth *t, const char *folder, bool person) {
  uint8_t *grey = calloc(1, (size_t)pixels);
  const ern_image image = {.width = side, .height = side, .channels = 1, .data = grey};
  assert_non_null(grey);
  mkdir(folder, 0755);
  for (int f = 0; f < FRAMES; f++) {
    for (int k = 0; k < pixels; k++) grey[k] = (person ? t->person : t->head)[f * pixels + k] ? 255 : 0;
    support_ok(t->context, ern_image_write(t->context, name_of(folder, "%d.png", f), &image, 100));
  }
  free(grey);
}

#endif
