/* SPDX-License-Identifier: MIT
 * The best stretch of a long video: which one is taken for faces, cuts and sound that are known, and that a second call
 * takes the same. */
#include "prepare/segment.h"

#include "ernerf-lab/synth.h"
#include "prepare/footage.h"
#include "prepare/prepare_record.h"
#include "prepare_test.h"

enum { SIDE = 64, SECONDS = 20, RATE = 16000, EVERY = 5, LOOKS = SECONDS * ERN_PREPARE_RATE / EVERY, HEAD = 128 };

/* A picture that does not change; sound from `loud` to `end` seconds, none where both are 0. */
static void make_video(ern_context *context, const char *path, int seconds, double loud, double end) {
  static uint8_t rgba[4 * SIDE * SIDE];
  static int16_t data[RATE * SECONDS];
  const ern_sound sound = {.rate = RATE, .channels = 1, .frames = (size_t)(RATE * seconds), .data = data};
  ern_video_options options = ern_video_options_default(SIDE, SIDE);
  ern_video_writer *writer = NULL;
  memset(rgba, 120, sizeof rgba);
  for (int i = 0; i < RATE * seconds; i++) {
    const double at = (double)i / RATE;
    data[i] = (int16_t)((at >= loud && at < end ? 12000 : 60) * sin(2000 * at));
  }
  if (end > 0) options.sound = &sound;
  remove(path);
  support_ok(context, ern_video_writer_open(context, path, &options, &writer));
  for (int i = 0; i < seconds * ERN_PREPARE_RATE; i++) support_ok(context, ern_video_writer_frame(writer, rgba));
  support_ok(context, ern_video_writer_close(&writer));
}

/* What the looks find, by seconds. */
struct scene {
  double face, face_end;   /* a face is seen */
  double moves, move_end;  /* it moves */
  double loud, loud_end;   /* sound */
  double cuts[8];          /* 0: no more */
  double length, from;     /* of options->segment, of options->from */
  double expected, within; /* where the stretch begins; below 0: there is none */
};

static void expect_stretch(const struct scene *scene) {
  struct made_job m;
  struct ern_segment_search search = {0};
  bool found = false;
  made_job_open(&m, "clip", SIDE, 0);
  m.options.from = scene->from;
  char video[64];
  snprintf(video, sizeof video, "loud_at_%g.mp4", scene->loud);
  if (access(video, F_OK) != 0) make_video(m.job.context, video, SECONDS, scene->loud, scene->loud_end);
  m.job.video = video;
  for (size_t i = 0; i < LOOKS; i++) {
    const double at = (double)(i * EVERY) / ERN_PREPARE_RATE;
    struct ern_found_face face = {.frame = i * EVERY, .x = 100, .y = 80, .width = 50, .height = 50};
    if (at < scene->face - 1e-9 || at >= scene->face_end - 1e-9) face.width = 0;
    if (at >= scene->moves - 1e-9 && at < scene->move_end - 1e-9) face.x += (float)(10 * sin(3 * at));
    for (const double *cut = scene->cuts; *cut > 0; cut++)
      if (*cut <= at && *cut > at - (double)EVERY / ERN_PREPARE_RATE) search.cut = (size_t)lround(*cut * 25);
    support_ok(m.job.context, ern_segment_add(m.job.context, &search, &face));
    assert_true(search.cut == 0);
  }
  support_ok(m.job.context, ern_segment_choose(&m.job, &search, EVERY, scene->length, &found));
  if (found != (scene->expected >= 0)) fail_msg("a stretch was%s found", found ? "" : " not");
  if (found) {
    double from = 0, to = 0;
    ern_prepare_part(&m.job, &from, &to);
    if (!(fabs(from - scene->expected) <= scene->within + 1e-6) || !(fabs(to - from - scene->length) < 1e-6))
      fail_msg("the stretch is from %g to %g, expected %g s from %g on", from, to, scene->length, scene->expected);
  }
  ern_segment_free(m.job.context, &search);
  made_job_close(&m);
}

static void test_choice(void **state) {
  (void)state;
  static const struct scene scenes[] = {
      {.face_end = 20, .length = 5, .expected = 0},                                             /* all the same */
      {.face_end = 20, .loud = 8, .loud_end = 14, .length = 5, .expected = 8.5, .within = 0.5}, /* sound */
      {.face = 12, .face_end = 17, .length = 5, .expected = 12},                                /* a face */
      {.face_end = 20, .moves = 7, .move_end = 12, .length = 5, .expected = 7, .within = 1},    /* it moves */
      {.face_end = 20, .moves = 9, .move_end = 13, .cuts = {9, 13}, .length = 4, .expected = 9},
      {.face_end = 20, .moves = 9, .move_end = 13, .cuts = {9, 12.92}, .length = 4, .expected = 0},
      {.face_end = 20, .cuts = {3, 6, 9, 12, 15, 18}, .length = 5, .expected = -1},
      {.face_end = 20, .moves = 9, .move_end = 12, .cuts = {3, 6, 9, 12, 15, 18}, .length = 3, .expected = 9},
      {.face = 12, .face_end = 17, .length = 5, .from = 2, .expected = 14},
      /* a face in all looks is worth more than sound */
      {.face = 2, .face_end = 7, .loud = 7, .loud_end = 12, .length = 5, .expected = 2.5, .within = 0.5},
  };
  for (size_t i = 0; i < sizeof scenes / sizeof *scenes; i++) {
    print_message("scene %zu\n", i);
    expect_stretch(&scenes[i]);
  }
}

static void test_words(void **state) {
  (void)state;
  static const char *const bad[] = {"", "Auto", "-5", "0.5", "7201", "1e9", "10s", "nan", "0x20", " 5", "auto "};
  ern_context *context = support_context();
  double length = 0, longer = 0;
  support_ok(context, ern_segment_read(context, "auto", &length, &longer));
  assert_true(length == 180 && longer == 300);
  support_ok(context, ern_segment_read(context, "42.5", &length, &longer));
  assert_true(length == 42.5 && longer == 42.5);
  for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
    support_expect(context, ern_segment_read(context, bad[i], &length, &longer), ERN_E_ARGUMENT, "segment is",
                   "\"auto\"", "1 to 1800", NULL);
    ern_prepare_options options = ern_prepare_options_default();
    ern_prepare_result result;
    options.segment = bad[i];
    support_expect(context, ern_prepare(context, "none.mp4", "none", &options, &result), ERN_E_ARGUMENT, "segment is",
                   NULL);
  }
  ern_context_free(&context);
}

static void set_segment(struct made_job *m, const char *text) {
  assert_int_equal(json_object_set_new(m->job.record, "segment", json_loads(text, JSON_DECODE_ANY, NULL)), 0);
  support_ok(m->job.context, ern_prepare_record_save(&m->job));
}

static void shut(struct made_job *m, int lock) {
  close(lock);
  json_decref(m->job.record);
  m->job.record = NULL;
  m->job.segment[0] = m->job.segment[1] = 0;
}

/* The stretch of an earlier call is in the record; another --segment is another clip; damaged ones are refused. */
static void test_record(void **state) {
  (void)state;
  static const char *const bad[] = {"5", "{}", "{\"from\": 4, \"to\": 2}", "{\"from\": -1, \"to\": 2}",
                                    "{\"from\": 1, \"to\": 1e300}"};
  struct made_job m;
  const ern_image *image = NULL;
  struct ern_footage footage;
  size_t frames = 0;
  int lock = -1;
  made_job_open(&m, "clip", SIDE, 0);
  make_video(m.job.context, "made.mp4", 6, 0, 0);
  m.options.segment = "2";
  support_ok(m.job.context, ern_prepare_record_open(&m.job, &lock));
  assert_true(m.job.segment[1] <= 0);
  set_segment(&m, "{\"from\": 3.2, \"to\": 5.2}");
  shut(&m, lock);
  support_ok(m.job.context, ern_prepare_record_open(&m.job, &lock));
  assert_true(m.job.segment[0] == 3.2 && m.job.segment[1] == 5.2);
  support_ok(m.job.context, ern_footage_open(&m.job, &footage));
  assert_int_equal(ern_footage_expected(&footage), 50);
  for (;; frames++) {
    support_ok(m.job.context, ern_footage_next(&footage, &image));
    if (image == NULL) break;
  }
  assert_int_equal(frames, 50);
  ern_footage_close(&footage);
  for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
    set_segment(&m, bad[i]);
    shut(&m, lock);
    support_expect(m.job.context, ern_prepare_record_open(&m.job, &lock), ERN_E_FORMAT, "clip/prepare.json",
                   "segment is from", NULL);
  }
  shut(&m, lock);
  static const char *const others[] = {NULL, "3", "auto"};
  for (size_t i = 0; i < sizeof others / sizeof *others; i++) {
    m.options.segment = others[i];
    support_expect(m.job.context, ern_prepare_record_open(&m.job, &lock), ERN_E_EXISTS, "clip", "--segment", NULL);
    shut(&m, lock);
  }
  made_job_close(&m);
}

/* A head that speaks after a cut: its stretch is taken, and again by a call that does the step again. */
static void test_face_step_long(void **state) {
  (void)state;
  enum { BEFORE = 30, AFTER = 35 };
  static uint8_t rgba[4 * HEAD * HEAD];
  ern_context *context = support_context();
  ern_synth_options synth = ern_synth_options_default();
  ern_video_options shape = ern_video_options_default(HEAD, HEAD);
  ern_prepare_options options = ern_prepare_options_default();
  ern_prepare_result result;
  ern_video_writer *writer = NULL;
  support_clear("truth");
  support_clear("clip");
  remove("head.mp4");
  synth.size = HEAD;
  synth.frames = AFTER;
  synth.seed = 5;
  support_ok(context, ern_synth_write(context, "truth", &synth));
  support_ok(context, ern_video_writer_open(context, "head.mp4", &shape, &writer));
  for (int i = 0; i < BEFORE + AFTER; i++) {
    char path[64];
    ern_image image = {0};
    snprintf(path, sizeof path, "truth/gt_imgs/%d.jpg", i < BEFORE ? i : i - BEFORE);
    support_ok(context, ern_image_read(context, path, 3, &image));
    for (size_t k = 0; k < sizeof rgba; k++) /* before the cut a negative, upside down */
      rgba[k] = k % 4 == 3   ? 255
                : i < BEFORE ? (uint8_t)(255 - image.data[3 * (HEAD * HEAD - 1 - k / 4) + k % 4])
                             : image.data[3 * (k / 4) + k % 4];
    support_ok(context, ern_video_writer_frame(writer, rgba));
    ern_image_free(context, &image);
  }
  support_ok(context, ern_video_writer_close(&writer));
  options.side = HEAD;
  options.only = "face";
  options.features = "truth/aud_ds.npy"; /* the video has no sound */
  support_expect(context, ern_prepare(context, "head.mp4", "clip", &options, &result), ERN_E_UNSUPPORTED, "cut", NULL);
  support_clear("clip");
  options.segment = "2";
  support_expect(context, ern_prepare(context, "head.mp4", "clip", &options, &result), ERN_E_UNSUPPORTED,
                 "no stretch of 2 s is without a cut", NULL);
  support_clear("clip");
  options.segment = "1";
  for (int call = 0; call < 2; call++) {
    support_ok(context, ern_prepare(context, "head.mp4", "clip", &options, &result));
    assert_int_equal(result.frames, 25);
    json_t *record = json_load_file("clip/prepare.json", 0, NULL), *segment = json_object_get(record, "segment");
    const double from = json_real_value(json_object_get(segment, "from"));
    assert_true(from >= (double)BEFORE / 25 && from <= (double)(BEFORE + 10) / 25 + 1e-9);
    if (call == 0) { /* what the second call reads */
      json_object_set_new(segment, "from", json_real(1.28));
      json_object_set_new(segment, "to", json_real(2.28));
      assert_int_equal(json_dump_file(record, "clip/prepare.json", 0), 0);
    } else {
      assert_true(from == 1.28);
    }
    json_decref(record);
  }
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_choice), cmocka_unit_test(test_words),
                                     cmocka_unit_test(test_record), cmocka_unit_test(test_face_step_long)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
