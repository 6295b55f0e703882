/* SPDX-License-Identifier: MIT
 * Landmarks and lids out of tables as OpenFace writes them: pixels and rows of the video become those of the clip. */
#include "io/csv.h"
#include "io/landmarks.h"
#include "prepare/landmarks/openface.h"
#include "prepare_test.h"

enum { SIDE = 256, FRAMES = 20, POINTS = ERN_LANDMARKS };

/* x, y of a point at a time: pixels of the video. */
static double point_at(double seconds, int k, int c) { return 300 + 3 * k + 40 * seconds + (c > 0 ? 7 * (k % 9) : 0); }

/* A table of `rows` rows at `rate`; those of [gap, gap_end) have no success and wild points. */
static void write_table(const char *path, size_t rows, double rate, size_t gap, size_t gap_end) {
  FILE *file = fopen(path, "wb");
  assert_non_null(file);
  fprintf(file, "frame, face_id, timestamp, confidence, success");
  for (int c = 0; c < 2; c++)
    for (int k = 0; k < POINTS; k++) fprintf(file, ", %c_%d", "xy"[c], k);
  fprintf(file, ", AU45_r, AU45_c\n");
  for (size_t i = 0; i < rows; i++) {
    const bool gone = i >= gap && i < gap_end;
    fprintf(file, "%zu, 0, %.3f, %s, %d", i + 1, (double)i / rate, gone ? "0.02" : "0.98", !gone);
    for (int c = 0; c < 2; c++)
      for (int k = 0; k < POINTS; k++) fprintf(file, ", %.1f", gone ? 0 : point_at((double)i / rate, k, c));
    fprintf(file, ", %.2f, 0\n", gone ? 5 : (double)(i % 50) / 10);
  }
  assert_int_equal(fclose(file), 0);
}

static void open_clip(struct made_job *m) {
  made_job_open(m, "clip", SIDE, FRAMES);
  /* pixels twice as high as wide: the square is 200 of them wide, 400 high */
  assert_int_equal(json_object_set_new(m->job.record, "crop",
                                       json_pack("{s:f, s:f, s:f, s:f, s:i}", "x", 250.0, "y", 300.0, "width", 200.0,
                                                 "side", 400.0, "size", SIDE)),
                   0);
}

static void expect_points(const float points[FRAMES][POINTS][2], size_t frame, double seconds) {
  for (int k = 0; k < POINTS; k++) {
    const double x = (point_at(seconds, k, 0) - 250) * SIDE / 200, y = (point_at(seconds, k, 1) - 300) * SIDE / 400;
    if (fabs((double)points[frame][k][0] - x) > 0.1 || fabs((double)points[frame][k][1] - y) > 0.1)
      fail_msg("frame %zu, point %d: %g %g, expected %g %g", frame, k, (double)points[frame][k][0],
               (double)points[frame][k][1], x, y);
  }
}

static void test_landmarks(void **state) {
  (void)state;
  static const struct { double rate, from; } videos[] = {{25, 0}, {50, 0}, {50, 1.2}, {30, 0}, {25, 3}};
  for (size_t n = 0; n < sizeof videos / sizeof *videos; n++) {
    struct made_job m;
    float points[FRAMES][POINTS][2];
    size_t held = 9;
    open_clip(&m);
    m.options.from = videos[n].from;
    write_table("video.csv", 200, videos[n].rate, 0, 0);
    support_ok(m.job.context, ern_openface_landmarks(&m.job, "video.csv", points, &held));
    assert_int_equal(held, 0);
    for (size_t i = 0; i < FRAMES; i++) {
      const double at = videos[n].from + (double)i / 25;
      /* of two rows as near, the later one */
      const double row = floor(at * videos[n].rate + 0.5 + 1e-9) / videos[n].rate;
      expect_points((const float(*)[POINTS][2])points, i, row);
    }
    made_job_close(&m);
  }
}

/* A stretch of the video, whose seconds count from the video's first frame. */
static void test_segment(void **state) {
  (void)state;
  struct made_job m;
  float points[FRAMES][POINTS][2];
  size_t held = 0;
  open_clip(&m);
  m.options.from = 1;
  m.job.segment[0] = 3;
  m.job.segment[1] = 3.8;
  write_table("video.csv", 200, 25, 0, 0);
  support_ok(m.job.context, ern_openface_landmarks(&m.job, "video.csv", points, &held));
  for (size_t i = 0; i < FRAMES; i++) expect_points((const float(*)[POINTS][2])points, i, 3 + (double)i / 25);
  made_job_close(&m);
}

/* Rows without success: the last good one before them, the first good one at the beginning. */
static void test_held(void **state) {
  (void)state;
  static const struct { size_t gap, end; } gaps[] = {{5, 9}, {0, 3}, {17, 20}};
  for (size_t n = 0; n < sizeof gaps / sizeof *gaps; n++) {
    struct made_job m;
    float points[FRAMES][POINTS][2];
    size_t held = 0;
    open_clip(&m);
    write_table("video.csv", FRAMES, 25, gaps[n].gap, gaps[n].end);
    support_ok(m.job.context, ern_openface_landmarks(&m.job, "video.csv", points, &held));
    assert_int_equal(held, gaps[n].end - gaps[n].gap);
    for (size_t i = 0; i < FRAMES; i++) {
      const bool gone = i >= gaps[n].gap && i < gaps[n].end;
      const size_t row = !gone ? i : gaps[n].gap > 0 ? gaps[n].gap - 1 : gaps[n].end;
      expect_points((const float(*)[POINTS][2])points, i, (double)row / 25);
    }
    ern_openface_check(&m.job, "video.csv", held);
    assert_int_equal(m.verdict.grade, ERN_PREPARE_DOUBTFUL);
    assert_non_null(strstr(m.verdict.words, "success is 0 in"));
    made_job_close(&m);
  }
}

static void test_landmarks_refused(void **state) {
  (void)state;
  struct made_job m;
  static float points[FRAMES][POINTS][2];
  size_t held = 0;
  open_clip(&m);
  write_table("far.csv", FRAMES, 25, 0, 0);
  assert_int_equal(system("awk 'NR == 21 { $9 = \"2000,\" } 1' far.csv >moved.csv && mv moved.csv far.csv"), 0);
  write_table("bad.csv", FRAMES, 25, 0, FRAMES);
  support_expect(m.job.context, ern_openface_landmarks(&m.job, "bad.csv", points, &held), ERN_E_FORMAT, "bad.csv",
                 "success is 0 in all", NULL);
  write_table("bad.csv", FRAMES - 8, 25, 0, 0);
  support_expect(m.job.context, ern_openface_landmarks(&m.job, "bad.csv", points, &held), ERN_E_MISMATCH, "bad.csv",
                 "no row near 0.72 s, where frame 18", "12 rows end at 0.44 s", NULL);
  write_table("bad.csv", 0, 25, 0, 0);
  support_expect(m.job.context, ern_openface_landmarks(&m.job, "bad.csv", points, &held), ERN_E_MISMATCH, "bad.csv",
                 "frame 0", NULL);
  support_write_text("bad.csv", "frame, timestamp, success, x_0, y_0\n1, 0, 1, 5, 5\n");
  support_expect(m.job.context, ern_openface_landmarks(&m.job, "bad.csv", points, &held), ERN_E_MISSING, "bad.csv",
                 "column x_1 is missing", NULL);
  support_expect(m.job.context, ern_openface_landmarks(&m.job, "none.csv", points, &held), ERN_E_MISSING, "none.csv",
                 NULL);
  support_expect(m.job.context, ern_openface_landmarks(&m.job, "far.csv", points, &held), ERN_E_FORMAT,
                 "far.csv: row 20: x_3 is 2000", "pixel of the video, -550 to 1050", NULL);
  write_table("bad.csv", FRAMES, 1e9, 0, 0); /* all at 0.000 s */
  support_expect(m.job.context, ern_openface_landmarks(&m.job, "bad.csv", points, &held), ERN_E_FORMAT, "bad.csv",
                 "row 2: timestamp is 0 after 0", NULL);
  json_object_del(m.job.record, "crop");
  support_expect(m.job.context, ern_openface_landmarks(&m.job, "bad.csv", points, &held), ERN_E_FORMAT,
                 "clip/prepare.json", "no crop", NULL);
  made_job_close(&m);
}

static void expect_lids(struct made_job *m, size_t held_expected, size_t first, size_t each) {
  float values[FRAMES];
  size_t held = 9;
  support_ok(m->job.context, ern_openface_blinks(&m->job, "lids.csv", values, &held));
  assert_int_equal(held, held_expected);
  for (size_t i = 0; i < FRAMES; i++) assert_true(fabsf(values[i] - (float)((first + each * i) % 50) / 10) < 1e-5f);
}

static void test_lids(void **state) {
  (void)state;
  struct made_job m;
  float values[FRAMES];
  size_t held = 0;
  open_clip(&m);
  write_table("lids.csv", 200, 50, 0, 0); /* a video of 50 a second */
  expect_lids(&m, 0, 0, 2);
  m.options.from = 1;
  expect_lids(&m, 0, 50, 2);
  write_table("lids.csv", FRAMES, 50, 0, 0); /* as many rows as frames, and not of them */
  support_expect(m.job.context, ern_openface_blinks(&m.job, "lids.csv", values, &held), ERN_E_MISMATCH, "lids.csv",
                 "no row near 1.00 s", "20 rows end at 0.38 s", NULL);
  m.options.from = 0;
  write_table("lids.csv", FRAMES, 20, 0, 0);
  support_ok(m.job.context, ern_openface_blinks(&m.job, "lids.csv", values, &held));
  for (size_t i = 0; i < FRAMES; i++) assert_true(fabs((double)values[i] - floor(0.8 * (double)i + 0.5) / 10) < 1e-5);
  FILE *plain = fopen("lids.csv", "wb"); /* a row a frame of the clip, wherever that is */
  assert_non_null(plain);
  fprintf(plain, "AU45_r\n");
  for (int i = 0; i < FRAMES; i++) fprintf(plain, "%.1f\n", 0.1 * i);
  assert_int_equal(fclose(plain), 0);
  m.options.from = 7;
  expect_lids(&m, 0, 0, 1);
  m.options.from = 0;
  write_table("lids.csv", FRAMES, 25, 4, 6);
  support_ok(m.job.context, ern_openface_blinks(&m.job, "lids.csv", values, &held));
  assert_int_equal(held, 2);
  assert_true(fabsf(values[5] - 0.3f) < 1e-5f);
  static const char *const beyond[] = {"1e30", "-3", "5.1"}; /* row 4 */
  for (int i = 0; i < 3; i++) {
    char line[128], words[64];
    snprintf(line, sizeof line, "(echo AU45_r; yes 5 | head -n 3; echo %s; yes 0 | head -n 16) >lids.csv", beyond[i]);
    assert_int_equal(system(line), 0);
    snprintf(words, sizeof words, "lids.csv: row 4: AU45_r is %g, expected 0", strtod(beyond[i], NULL));
    support_expect(m.job.context, ern_openface_blinks(&m.job, "lids.csv", values, &held), ERN_E_FORMAT, words, NULL);
  }
  support_write_text("lids.csv", "AU45_r\n1\n2\n");
  support_expect(m.job.context, ern_openface_blinks(&m.job, "lids.csv", values, &held), ERN_E_MISMATCH, "lids.csv",
                 "has 2 rows", "20 frames", NULL);
  support_write_text("lids.csv", "timestamp, success\n1, 1\n");
  support_expect(m.job.context, ern_openface_blinks(&m.job, "lids.csv", values, &held), ERN_E_MISSING, "lids.csv",
                 "AU45_r", NULL);
  made_job_close(&m);
}

/* The steps themselves take both options. */
static void test_steps(void **state) {
  (void)state;
  struct made_job m;
  struct ern_head_pose poses[FRAMES];
  float points[POINTS][2], *lids = NULL;
  size_t count = 0;
  open_clip(&m);
  assert_int_equal(mkdir("clip/ori_imgs", 0777), 0);
  write_table("video.csv", 100, 25, 3, 4);
  for (size_t i = 0; i < FRAMES; i++) poses[i] = made_pose(0, 0, 0, 0.3, 0, 0.7); /* the head is elsewhere */
  support_ok(m.job.context, ern_prepare_poses_write(&m.job, poses));
  m.options.landmarks = m.options.au = "video.csv";
  support_ok(m.job.context, ern_prepare_landmarks(&m.job));
  assert_int_equal(m.verdict.grade, ERN_PREPARE_DOUBTFUL);
  assert_non_null(strstr(m.verdict.words, "half an eye distance"));
  support_ok(m.job.context, ern_landmarks_read(m.job.context, "clip/ori_imgs/19.lms", points));
  assert_true(fabs((double)points[5][0] - (point_at(0.76, 5, 0) - 250) * SIDE / 200) < 0.1);
  support_ok(m.job.context, ern_prepare_eyes(&m.job));
  support_ok(m.job.context, ern_csv_read_column(m.job.context, "clip/au.csv", "AU45_r", &lids, &count));
  assert_int_equal(count, FRAMES);
  assert_true(fabsf(lids[3] - 0.2f) < 1e-5f && fabsf(lids[10] - 1) < 1e-5f);
  ern_release(m.job.context, lids);
  /* the step's own table is replaced, the user's with -y alone */
  support_ok(m.job.context, ern_prepare_eyes(&m.job));
  assert_int_equal(json_object_del(m.job.record, "made"), 0);
  support_write_text("clip/au.csv", "mine");
  support_expect(m.job.context, ern_prepare_eyes(&m.job), ERN_E_EXISTS, "clip/au.csv", "--overwrite", NULL);
  assert_int_equal(system("printf mine | cmp - clip/au.csv"), 0);
  m.options.anew = true;
  support_ok(m.job.context, ern_prepare_eyes(&m.job));
  /* the table of a part, brought again, is taken as it is */
  m.options.from = 1;
  for (int i = 0; i < 2; i++) {
    support_ok(m.job.context, ern_prepare_eyes(&m.job));
    support_ok(m.job.context, ern_csv_read_column(m.job.context, "clip/au.csv", "AU45_r", &lids, &count));
    assert_true(count == FRAMES && fabsf(lids[0] - 2.5f) < 1e-5f && fabsf(lids[19] - 4.4f) < 1e-5f);
    ern_release(m.job.context, lids);
    m.options.au = "own.csv";
    assert_int_equal(rename("clip/au.csv", "own.csv"), 0);
  }
  /* points far outside are told by the file that has them */
  assert_int_equal(system("rm -rf points && cp -r clip/ori_imgs points && sed -i '4s/.*/5 -1024/' points/7.lms"), 0);
  m.options.landmarks = "points";
  support_expect(m.job.context, ern_prepare_landmarks(&m.job), ERN_E_FORMAT, "points/7.lms: line 4: point (5, -1024)",
                 "of 256", NULL);
  support_write_text("points/020.lms", ""); /* of a longer video */
  support_write_text("points/x20.lms", "");
  support_expect(m.job.context, ern_prepare_landmarks(&m.job), ERN_E_MISMATCH, "points: has 21 files ID.lms",
                 "20 frames", NULL);
  made_job_close(&m);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_landmarks), cmocka_unit_test(test_segment),
                                     cmocka_unit_test(test_held),      cmocka_unit_test(test_landmarks_refused),
                                     cmocka_unit_test(test_lids),      cmocka_unit_test(test_steps)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
