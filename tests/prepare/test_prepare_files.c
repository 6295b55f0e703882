/* SPDX-License-Identifier: MIT
 * What the steps of `prepare` hand on to each other: poses, faces, crops of the face that are held still; which files
 * a step has left, and by what brought ones are known. */
#include <fcntl.h>

#include "ernerf/media.h"
#include "prepare/stabilized_crop.h"
#include "prepare_test.h"

enum { MOST = 40, SIDE = 128 };

static void poses_of(struct ern_head_pose poses[MOST], size_t count) {
  uint64_t random = 11;
  for (size_t i = 0; i < count; i++)
    poses[i] = made_pose(40 * made_random(&random), 20 * made_random(&random), 20 * made_random(&random),
                         0.1 * made_random(&random), 0.1 * made_random(&random), 0.7 + 0.1 * made_random(&random));
}

/* What is read is what was written, to the floats of the file's reader; so it is from one file that is brought. */
static void test_poses(void **state) {
  (void)state;
  static const size_t counts[] = {2, 3, 11, 22, MOST};
  for (size_t n = 0; n < sizeof counts / sizeof *counts; n++) {
    struct made_job m;
    struct ern_head_pose poses[MOST], again[MOST];
    made_job_open(&m, "clip", SIDE, counts[n]);
    poses_of(poses, counts[n]);
    support_ok(m.job.context, ern_prepare_poses_write(&m.job, poses));
    m.job.focal = 1;
    support_ok(m.job.context, ern_prepare_poses_read(&m.job, again));
    assert_true(fabs(m.job.focal - 2.4 * SIDE) < 1e-3);
    for (size_t i = 0; i < counts[n]; i++) {
      assert_true(made_angle((const double(*)[3])poses[i].rotation, (const double(*)[3])again[i].rotation) < 1e-4);
      for (int c = 0; c < 3; c++) assert_true(fabs(poses[i].translation[c] - again[i].translation[c]) < 1e-6);
    }
    ern_pose_list train = {0}, val = {0};
    support_ok(m.job.context, ern_pose_list_load(m.job.context, "clip/transforms_train.json", &train));
    support_ok(m.job.context, ern_pose_list_load(m.job.context, "clip/transforms_val.json", &val));
    assert_int_equal(train.count + val.count, counts[n]);
    assert_int_equal(val.count, counts[n] / 11 > 0 ? counts[n] / 11 : 1);
    ern_pose_list_free(m.job.context, &train);
    ern_pose_list_free(m.job.context, &val);
    made_job_close(&m);
  }
}

static void test_poses_refused(void **state) {
  (void)state;
  struct made_job m;
  struct ern_head_pose poses[MOST];
  size_t audio_mismatches = 0;
  made_job_open(&m, "clip", SIDE, 22);
  poses_of(poses, 22);
  support_ok(m.job.context, ern_prepare_poses_write(&m.job, poses));
  m.options.poses = "clip/transforms_train.json"; /* not all frames */
  support_expect(m.job.context, ern_prepare_poses_supplied(&m.job, poses, &audio_mismatches), ERN_E_MISSING,
                 "transforms_train.json", "no pose of frame 20", "0 to 21", NULL);
  m.job.frames = 20;
  support_ok(m.job.context, ern_prepare_poses_supplied(&m.job, poses, &audio_mismatches));
  m.job.frames = 19;
  support_expect(m.job.context, ern_prepare_poses_supplied(&m.job, poses, &audio_mismatches), ERN_E_MISMATCH,
                 "transforms_train.json", "img_id 19", "0 to 18", NULL);
  m.job.frames = 20;
  m.job.side = 2 * SIDE;
  support_expect(m.job.context, ern_prepare_poses_supplied(&m.job, poses, &audio_mismatches), ERN_E_MISMATCH,
                 "transforms_train.json", "128 x 128", "256 x 256", NULL);
  m.job.side = SIDE;
  /* each frame once, and before the camera */
  m.options.poses = "clip/transforms_train.json";
  assert_int_equal(system("sed -i 's/\"img_id\": 3,/\"img_id\": 2,/' clip/transforms_train.json"), 0);
  support_expect(m.job.context, ern_prepare_poses_supplied(&m.job, poses, &audio_mismatches), ERN_E_FORMAT,
                 "transforms_train.json", "frame 3: img_id 2 has a pose already", NULL);
  poses_of(poses, 20);
  poses[7].translation[2] = 0.5;
  support_ok(m.job.context, ern_prepare_poses_write(&m.job, poses));
  support_expect(m.job.context, ern_prepare_poses_supplied(&m.job, poses, &audio_mismatches), ERN_E_FORMAT,
                 "transforms_train.json", "frame 7: field transform_matrix", "0.5 behind the camera", NULL);
  /* a camera and a distance at which a head can be seen */
  static const double focals[] = {0.01, 1e6};
  for (int i = 0; i < 2; i++) {
    poses_of(poses, 20);
    m.job.focal = focals[i];
    support_ok(m.job.context, ern_prepare_poses_write(&m.job, poses));
    support_expect(m.job.context, ern_prepare_poses_supplied(&m.job, poses, &audio_mismatches), ERN_E_FORMAT,
                   "transforms_train.json: field focal_len", "expected 25.6 to 2560 pixels", NULL);
    m.job.focal = 2.4 * SIDE;
    for (int k = 0; k < 20; k++) poses[k] = made_pose(0, 0, 0, 0, 0, i == 0 ? 700 : 0.07);
    support_ok(m.job.context, ern_prepare_poses_write(&m.job, poses));
    support_expect(m.job.context, ern_prepare_poses_supplied(&m.job, poses, &audio_mismatches), ERN_E_FORMAT,
                   "transforms_train.json: frame 0: field transform_matrix has the head",
                   i == 0 ? "700 m before" : "0.07 m before", NULL);
  }
  /* in the picture, most of them upright, and most faces towards the camera */
  static const struct {
    double yaw, pitch, roll, y;
    int begin;
    const char *words;
  } most[] = {{0, 0, 59, -1, 0, "frame 0: field transform_matrix has the head's middle at pixel 64, 503"},
              {0, 0, 170, 0, 9, "img_id 9: field transform_matrix has the head rolled by 170 degrees, and 11 of"},
              {0, 0, 170, 0, 10, NULL},
              {180, 0, 0, 0, 9, "img_id 9: field transform_matrix has the head turned away from the camera by 180"},
              {180, 0, 0, 0, 10, NULL},
              {0, 80, 0, 0, 9, "img_id 9: field transform_matrix has the head turned away from the camera by 80"},
              {30, 50, 0, 0, 0, NULL}};
  for (size_t i = 0; i < sizeof most / sizeof *most; i++) {
    for (int k = 0; k < 22; k++)
      poses[k] = k < most[i].begin ? made_pose(0, 0, 59, 0, 0, 0.7)
                                   : made_pose(most[i].yaw, most[i].pitch, most[i].roll, 0, most[i].y, 0.7);
    m.job.frames = 22;
    support_ok(m.job.context, ern_prepare_poses_write(&m.job, poses));
    m.job.frames = 20;
    support_expect(m.job.context, ern_prepare_poses_supplied(&m.job, poses, &audio_mismatches),
                   most[i].words != NULL ? ERN_E_FORMAT : ERN_OK, most[i].words, NULL);
  }
  m.options.poses = "nowhere.json";
  support_expect(m.job.context, ern_prepare_poses_supplied(&m.job, poses, &audio_mismatches), ERN_E_MISSING,
                 "nowhere.json", NULL);
  remove("clip/transforms_val.json");
  support_expect(m.job.context, ern_prepare_poses_read(&m.job, poses), ERN_E_MISSING, "transforms_val.json", NULL);
  made_job_close(&m);
}

/* Brought poses are held against the faces that were found, and against each other. */
static void test_poses_judged(void **state) {
  (void)state;
  enum { ALL = 22, CLIP = 20, FOUND = 10 };
  static const struct {
    const char *name, *words; /* NULL: nothing of the faces is said */
    double scale, side;
    int shift;
    bool still, stray;
  } ways[] = {{"as found", NULL, 1, 1, 0, false, false},
              {"one elsewhere", "in 1 of the 10 frames where a face was found", 1, 1, 0, false, true},
              {"half the distance", "are 0.60 times as wide", 0.5, 1, 0, false, false},
              {"twice the distance", "are 2.40 times as wide", 2, 1, 0, false, false},
              {"mirrored", "do not move sideways", 1, -1, 0, false, false},
              {"other frames", "do not move", 1, 1, 9, false, false},
              {"one for all", "the head turns by 0.0 degrees in all", 1, 1, 0, true, false}};
  struct made_job m;
  struct ern_head_pose own[ALL], brought[ALL];
  struct ern_found_face faces[FOUND];
  made_job_open(&m, "clip", SIDE, ALL);
  for (int i = 0; i < ALL; i++) own[i] = made_pose(i, 3, 2, 0.04 * sin(0.5 * i), 0.02, 0.7);
  for (size_t w = 0; w < sizeof ways / sizeof *ways; w++) {
    m.job.focal = 2.4 * SIDE;
    for (size_t i = 0; i < FOUND; i++) {
      const float wide = 1.2f * (float)(0.15 * m.job.focal / 0.7);
      const double *at = own[2 * i].translation;
      const float x = (float)(0.5 * SIDE + m.job.focal * at[0] / 0.7),
                  y = (float)(0.5 * SIDE - m.job.focal * at[1] / 0.7);
      faces[i] = (struct ern_found_face){2 * i, x - wide / 2, y - wide / 2, wide, wide, false, {{0}}, 0};
    }
    for (int i = 0; i < ALL; i++) {
      brought[i] = own[ways[w].still ? 0 : (i + ways[w].shift) % ALL];
      for (int c = 0; c < 3; c++) brought[i].translation[c] *= ways[w].scale;
      brought[i].translation[0] *= ways[w].side;
    }
    if (ways[w].stray) brought[6].translation[0] += 0.1;
    m.options.poses = NULL;
    m.job.frames = ALL;
    support_ok(m.job.context, ern_prepare_poses_write(&m.job, brought));
    m.job.frames = CLIP;
    support_ok(m.job.context, ern_prepare_faces_write(&m.job, faces, FOUND));
    m.options.poses = "clip/transforms_train.json";
    m.verdict = (ern_prepare_verdict){.step = "pose"};
    support_ok(m.job.context, ern_prepare_pose(&m.job));
    const char *words = ways[w].words != NULL ? ways[w].words : "";
    if (strstr(m.verdict.words, words) == NULL || (m.verdict.grade == ERN_PREPARE_GOOD) != (ways[w].words == NULL))
      fail_msg("%s: expected \"%s\", found \"%s\"", ways[w].name, words, m.verdict.words);
  }
  m.job.frames = ALL;
  m.options.poses = NULL;
  support_ok(m.job.context, ern_prepare_poses_write(&m.job, own));
  m.job.frames = CLIP;
  m.options.poses = "clip/transforms_train.json";
  assert_int_equal(system("sed -i 's/\"aud_id\": 1/\"aud_id\": 2/' clip/transforms_train.json"), 0); /* 1, 10 to 19 */
  support_ok(m.job.context, ern_prepare_pose(&m.job));
  assert_int_equal(m.verdict.grade, ERN_PREPARE_DOUBTFUL);
  assert_non_null(strstr(m.verdict.words, "aud_id is not img_id in 11 of 20 frames of clip/transforms_train.json"));
  made_job_close(&m);
}

static void test_faces(void **state) {
  (void)state;
  struct made_job m;
  struct ern_found_face faces[MOST], *again = NULL;
  size_t count = 0;
  uint64_t random = 2;
  made_job_open(&m, "clip", SIDE, 5 * MOST);
  for (size_t i = 0; i < MOST; i++) {
    faces[i] = (struct ern_found_face){.frame = 5 * i, .x = -3.25f, .y = (float)i, .width = 50.5f, .height = 51};
    faces[i].has_eyes = i % 3 > 0;
    for (int k = 0; k < 4; k++) faces[i].eyes[k / 2][k % 2] = (float)(40 + 30 * made_random(&random));
  }
  support_ok(m.job.context, ern_prepare_faces_write(&m.job, faces, MOST));
  support_ok(m.job.context, ern_prepare_faces_read(&m.job, &again, &count));
  assert_int_equal(count, MOST);
  for (size_t i = 0; i < MOST; i++) {
    assert_int_equal(again[i].frame, faces[i].frame);
    assert_true(again[i].has_eyes == faces[i].has_eyes);
    const float differ[] = {again[i].x - faces[i].x, again[i].y - faces[i].y, again[i].width - faces[i].width,
                            again[i].height - faces[i].height};
    for (int k = 0; k < 4; k++) {
      assert_true(fabsf(differ[k]) < 0.006f);
      if (faces[i].has_eyes) assert_true(fabsf(again[i].eyes[k / 2][k % 2] - faces[i].eyes[k / 2][k % 2]) < 0.006f);
    }
  }
  ern_release(m.job.context, again);
  m.job.frames = 5 * MOST - 5; /* the last face's is no frame of the clip */
  support_expect(m.job.context, ern_prepare_faces_read(&m.job, &again, &count), ERN_E_FORMAT, "faces.csv", "row 40",
                 "img_id is 195", "0 to 194", NULL);
  assert_true(again == NULL && count == 0);
  made_job_close(&m);
}

static void test_faces_refused(void **state) {
  (void)state;
  static const char head[] = "img_id,x,y,width,height,left_eye_x,left_eye_y,right_eye_x,right_eye_y\n";
  static const struct {
    const char *rows, *word;
  } bad[] = {{"0,1,1,9,9,2,2,5,2\n0,1,1,9,9,2,2,5,2\n", "row 2"},
             {"5,1,1,9,9,2,2,5,2\n4,1,1,9,9,2,2,5,2\n", "row 2"},
             {"-1,1,1,9,9,2,2,5,2\n", "row 1"},
             {"nan,1,1,9,9,2,2,5,2\n", "faces.csv"},
             {"0.5,1,1,9,9,2,2,5,2\n", "row 1"},
             {"0,1,1,9,9,2,2\n", "faces.csv"},
             {"1e9,1,1,9,9,2,2,5,2\n", "row 1"}};
  struct made_job m;
  struct ern_found_face *faces = NULL;
  size_t count = 0;
  made_job_open(&m, "clip", SIDE, 50);
  support_expect(m.job.context, ern_prepare_faces_read(&m.job, &faces, &count), ERN_E_MISSING, "faces.csv", NULL);
  assert_int_equal(mkdir("clip/prepare", 0777), 0);
  for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
    char text[512];
    snprintf(text, sizeof text, "%s%s", head, bad[i].rows);
    support_write_text("clip/prepare/faces.csv", text);
    support_expect(m.job.context, ern_prepare_faces_read(&m.job, &faces, &count), ERN_E_FORMAT, "faces.csv",
                   bad[i].word, NULL);
    assert_true(faces == NULL && count == 0);
  }
  made_job_close(&m);
}

/* A picture whose level rises by 1 a pixel: the crop of a head that looks into the camera rises with it; that of a head
 * outside the picture is its edge's. */
static void test_stabilized_crop(void **state) {
  (void)state;
  enum { COLUMNS = 9, ROWS = 5 };
  struct made_job m;
  static uint8_t grey[SIDE * SIDE], pixels[3 * SIDE * SIDE];
  float values[ROWS * COLUMNS];
  const struct ern_stabilized_crop crop = {.x = 0, .y = 0.03, .step = 0.004, .columns = COLUMNS, .rows = ROWS};
  made_job_open(&m, "clip", SIDE, 1);
  for (int i = 0; i < SIDE * SIDE; i++) grey[i] = (uint8_t)(i % SIDE + i / SIDE / 2);
  for (int turn = -1; turn <= 1; turn++) {
    const struct ern_head_pose pose = made_pose(10 * turn, 5 * turn, 3 * turn, 0.01 * turn, 0, 0.7);
    ern_stabilized_crop_take(&crop, &pose, &m.job, grey, values);
    for (int r = 0; r < ROWS; r++)
      for (int c = 0; c < COLUMNS; c++) {
        const double x = crop.x + (c - 4) * crop.step, y = crop.y - (r - 2) * crop.step;
        const double point[3] = {x, y, ern_head_surface(x, y)};
        double pixel[2];
        assert_true(ern_head_project(&pose, m.job.focal, 0.5 * SIDE, point, pixel));
        /* linear in x; each second row repeats the level, so half a level may be off */
        assert_true(fabs((double)values[r * COLUMNS + c] - (pixel[0] - 0.5 + 0.5 * (pixel[1] - 0.5))) < 0.51);
      }
  }
  const struct ern_head_pose away = made_pose(0, 0, 0, 5, -5, 0.7), behind = made_pose(0, 0, 0, 0, 0, -1);
  ern_stabilized_crop_take(&crop, &away, &m.job, grey, values);
  for (int i = 0; i < ROWS * COLUMNS; i++) assert_true(fabsf(values[i] - grey[SIDE * SIDE - 1]) < 0.01f);
  ern_stabilized_crop_take(&crop, &behind, &m.job, grey, values);
  for (int i = 0; i < ROWS * COLUMNS; i++) assert_true(values[i] >= 0 && values[i] <= 255);
  /* the frame itself, in grey (BT.601), and refused in another size */
  uint8_t read[SIDE * SIDE];
  for (int i = 0; i < SIDE * SIDE; i++) {
    pixels[3 * i] = 200;
    pixels[3 * i + 1] = 100;
    pixels[3 * i + 2] = 50;
  }
  ern_image image = {.width = SIDE, .height = SIDE, .channels = 3, .data = pixels};
  assert_int_equal(mkdir("clip/ori_imgs", 0777), 0);
  support_ok(m.job.context, ern_image_write(m.job.context, "clip/ori_imgs/0.jpg", &image, 98));
  support_ok(m.job.context, ern_frame_grey(&m.job, 0, read));
  for (int i = 0; i < SIDE * SIDE; i++) assert_in_range(read[i], 121, 126); /* 0.299*200 + 0.587*100 + 0.114*50 = 124 */
  image.height = SIDE / 2;
  support_ok(m.job.context, ern_image_write(m.job.context, "clip/ori_imgs/0.jpg", &image, 98));
  support_expect(m.job.context, ern_frame_grey(&m.job, 0, read), ERN_E_SHAPE, "ori_imgs/0.jpg", "128 x 64", "128 x 128",
                 NULL);
  support_expect(m.job.context, ern_frame_grey(&m.job, 1, read), ERN_E_MISSING, "ori_imgs/1.jpg", NULL);
  made_job_close(&m);
}

static void test_quantile(void **state) {
  (void)state;
  float values[5] = {5, 1, 4, 2, 3};
  assert_true(ern_quantile(values, 5, 0.5) == 3 && ern_quantile(values, 5, 0) == 1 && ern_quantile(values, 5, 1) == 5);
  assert_true(ern_quantile(values, 1, 0.9) == 1);
  assert_true(isnan(ern_quantile(values, 0, 0.5)));
}

enum { FACE, POSE, LANDMARKS, LAYERS, EYES, FEATURES };

static void expect_there(const struct made_job *m, const char *what, size_t step, bool there) {
  for (size_t i = 0; i < ERN_PREPARE_STEPS; i++)
    if (ern_prepare_files_there(&m->job, i) != (there || i != step))
      fail_msg("%s: step %zu has %s its files", what, i, there || i != step ? "not all" : "all");
}

/* Every file of every step counts, those between the first and the last frame too. */
static void test_files_there(void **state) {
  (void)state;
  static const char *const folders[] = {"ori_imgs", "parsing", "gt_imgs", "torso_imgs", "prepare"};
  static const struct {
    size_t step;
    const char *name;
  } all[] = {{FACE, "ori_imgs/0.jpg"},      {FACE, "ori_imgs/1.jpg"},
             {FACE, "ori_imgs/2.jpg"},      {FEATURES, "aud.wav"},
             {FACE, "prepare/faces.csv"},   {POSE, "transforms_train.json"},
             {POSE, "transforms_val.json"}, {POSE, "prepare/pose.csv"},
             {LANDMARKS, "ori_imgs/0.lms"}, {LANDMARKS, "ori_imgs/1.lms"},
             {LANDMARKS, "ori_imgs/2.lms"}, {LAYERS, "bc.jpg"},
             {LAYERS, "parsing/0.png"},     {LAYERS, "parsing/1.png"},
             {LAYERS, "parsing/2.png"},     {LAYERS, "gt_imgs/0.jpg"},
             {LAYERS, "gt_imgs/1.jpg"},     {LAYERS, "gt_imgs/2.jpg"},
             {LAYERS, "torso_imgs/0.png"},  {LAYERS, "torso_imgs/1.png"},
             {LAYERS, "torso_imgs/2.png"},  {EYES, "au.csv"},
             {FEATURES, "aud.npy"}};
  struct made_job m;
  char path[256];
  made_job_open(&m, "clip", 128, 3);
  m.options.features = "own.npy";
  for (size_t i = 0; i < sizeof folders / sizeof *folders; i++) {
    snprintf(path, sizeof path, "clip/%s", folders[i]);
    assert_int_equal(mkdir(path, 0777), 0);
  }
  for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
    snprintf(path, sizeof path, "clip/%s", all[i].name);
    support_write_text(path, "made");
  }
  expect_there(&m, "all", 0, true);
  for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
    snprintf(path, sizeof path, "clip/%s", all[i].name);
    assert_int_equal(remove(path), 0);
    expect_there(&m, path, all[i].step, false);
    assert_int_equal(mkdir(path, 0777), 0); /* no file */
    expect_there(&m, path, all[i].step, false);
    assert_int_equal(rmdir(path), 0);
    support_write_text(path, "made");
  }
  m.job.frames = 4;
  assert_false(ern_prepare_files_there(&m.job, FACE) || ern_prepare_files_there(&m.job, LAYERS));
  m.job.frames = 0;
  assert_false(ern_prepare_files_there(&m.job, FACE));
  made_job_close(&m);
}

/* What a step has not written, with its options and by its own figures, is not missed. */
static void test_files_not_written(void **state) {
  (void)state;
  struct made_job m;
  made_job_open(&m, "clip", 128, 1);
  assert_int_equal(mkdir("clip/ori_imgs", 0777), 0);
  assert_int_equal(mkdir("clip/prepare", 0777), 0);
  static const char *const made[] = {"ori_imgs/0.jpg", "prepare/faces.csv", "transforms_train.json",
                                     "transforms_val.json"};
  for (size_t i = 0; i < sizeof made / sizeof *made; i++) {
    char path[256];
    snprintf(path, sizeof path, "clip/%s", made[i]);
    support_write_text(path, "made");
  }
  for (int found = 0; found < 2; found++) {
    json_decref(m.job.record);
    m.job.record = json_pack("{s:{s:{s:{s:f}}, s:{s:{s:f}}}}", "steps", "face", "figures", "sound", (double)found,
                             "eyes", "figures", "blinks", 3.0 * found);
    assert_non_null(m.job.record);
    assert_true(ern_prepare_files_there(&m.job, FACE));
    assert_true(ern_prepare_files_there(&m.job, FEATURES) == (found == 0));
    assert_true(ern_prepare_files_there(&m.job, EYES) == (found == 0));
  }
  assert_false(ern_prepare_files_there(&m.job, POSE));
  m.options.poses = "own.json";
  assert_true(ern_prepare_files_there(&m.job, POSE));
  support_write_text("clip/aud.wav", "made");
  assert_true(ern_prepare_files_there(&m.job, FEATURES));
  m.options.features = "own.npy";
  assert_false(ern_prepare_files_there(&m.job, FEATURES));
  made_job_close(&m);
}

static void set_time(const char *path, long long seconds, long nanoseconds) {
  const struct timespec times[2] = {{.tv_sec = seconds, .tv_nsec = nanoseconds},
                                    {.tv_sec = seconds, .tv_nsec = nanoseconds}};
  assert_int_equal(utimensat(AT_FDCWD, path, times, 0), 0);
}

/* A file has another mark by a byte or a nanosecond more, a folder by any of its files. */
static void test_marks(void **state) {
  (void)state;
  char first[ERN_PREPARE_FINGERPRINT_BYTES], mark[ERN_PREPARE_FINGERPRINT_BYTES];
  support_clear("own");
  assert_int_equal(mkdir("own", 0777), 0);
  for (int i = 0; i < 3; i++) {
    char path[64];
    snprintf(path, sizeof path, "own/%d.lms", i);
    support_write_text(path, "1 2");
    set_time(path, 1000, 5);
  }
  set_time("own", 1000, 5);
  static const char *const paths[] = {"own/1.lms", "own"};
  for (int k = 0; k < 2; k++) {
    assert_ptr_equal(ern_prepare_fingerprint(paths[k], first), first);
    assert_string_equal(ern_prepare_fingerprint(paths[k], mark), first);
    set_time("own/1.lms", 1000, 6);
    assert_string_not_equal(ern_prepare_fingerprint(paths[k], mark), first);
    set_time("own/1.lms", 1000, 5);
    assert_string_equal(ern_prepare_fingerprint(paths[k], mark), first);
    support_write_text("own/1.lms", "1 2 3");
    set_time("own/1.lms", 1000, 5);
    assert_string_not_equal(ern_prepare_fingerprint(paths[k], mark), first);
    support_write_text("own/1.lms", "1 2");
    set_time("own/1.lms", 1000, 5);
    assert_string_equal(ern_prepare_fingerprint(paths[k], mark), first);
  }
  support_write_text("own/3.lms", "");
  set_time("own/3.lms", 1000, 5);
  set_time("own", 1000, 5);
  assert_string_not_equal(ern_prepare_fingerprint("own", mark), first);
  assert_string_equal(ern_prepare_fingerprint(NULL, mark), "");
  assert_string_equal(ern_prepare_fingerprint("nowhere", mark), "nowhere");
  support_clear("own");
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_poses),    cmocka_unit_test(test_poses_refused), cmocka_unit_test(test_poses_judged),
      cmocka_unit_test(test_faces),    cmocka_unit_test(test_faces_refused), cmocka_unit_test(test_stabilized_crop),
      cmocka_unit_test(test_quantile), cmocka_unit_test(test_files_there),   cmocka_unit_test(test_files_not_written),
      cmocka_unit_test(test_marks)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
