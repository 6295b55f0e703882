/* SPDX-License-Identifier: MIT
 * Whose folder it is: prepare.json, what an earlier call left, and what others have put there. */
#include <fcntl.h>

#include "prepare/prepare_record.h"
#include "prepare_test.h"

static void job_on(struct made_job *m, const char *folder) {
  made_job_open(m, folder, 128, 0);
  support_clear(folder);
  json_decref(m->job.record);
  m->job.record = NULL;
  support_write_text("made.mp4", "bytes of a video");
}

static ern_status open_record(struct made_job *m, int *lock) {
  json_decref(m->job.record);
  m->job.record = NULL;
  return ern_prepare_record_open(&m->job, lock);
}

static void shut(int *lock) {
  if (*lock >= 0) close(*lock);
  *lock = -1;
}

/* A step is done with the settings it was done with; what is behind it is forgotten when it is done again. */
static void test_steps(void **state) {
  (void)state;
  struct made_job m;
  ern_prepare_verdict verdict = {0};
  int lock = -1;
  job_on(&m, "clip");
  support_ok(m.job.context, open_record(&m, &lock));
  assert_false(ern_prepare_record_has(&m.job, "pose", "focal 1", &verdict));
  m.verdict = (ern_prepare_verdict){.step = "pose", .grade = ERN_PREPARE_DOUBTFUL, .words = "so \"so\""};
  support_ok(m.job.context, ern_prepare_record_enter(&m.job, "focal 1", NULL, 0));
  m.verdict = (ern_prepare_verdict){.step = "eyes"};
  support_ok(m.job.context, ern_prepare_record_enter(&m.job, "au ", NULL, 0));
  shut(&lock);
  support_ok(m.job.context, open_record(&m, &lock));
  assert_true(ern_prepare_record_has(&m.job, "pose", "focal 1", &verdict));
  assert_int_equal(verdict.grade, ERN_PREPARE_DOUBTFUL);
  assert_string_equal(verdict.words, "so \"so\"");
  assert_false(ern_prepare_record_has(&m.job, "pose", "focal 2", &verdict));
  assert_true(ern_prepare_record_has(&m.job, "eyes", "au ", &verdict));
  static const char *const stale[] = {"pose", "eyes"};
  m.verdict = (ern_prepare_verdict){.step = "pose", .grade = ERN_PREPARE_REFUSED, .words = "no"};
  support_ok(m.job.context, ern_prepare_record_enter(&m.job, "focal 2", stale, 2));
  shut(&lock);
  support_ok(m.job.context, open_record(&m, &lock));
  assert_false(ern_prepare_record_has(&m.job, "pose", "focal 2", &verdict)); /* refused: to be tried again */
  assert_false(ern_prepare_record_has(&m.job, "eyes", "au ", &verdict));
  shut(&lock);
  made_job_close(&m);
}

static void test_locked(void **state) {
  (void)state;
  struct made_job m, other;
  int lock = -1, second = -1;
  job_on(&m, "clip");
  other = m;
  other.job.record = NULL;
  support_ok(m.job.context, open_record(&m, &lock));
  support_expect(m.job.context, open_record(&other, &second), ERN_E_BUSY, "clip", "another process", NULL);
  shut(&second);
  shut(&lock);
  support_ok(m.job.context, open_record(&other, &second));
  shut(&second);
  json_decref(other.job.record);
  made_job_close(&m);
}

/* Another video, part or size; and the video itself, touched. */
static void test_another_video(void **state) {
  (void)state;
  struct made_job m;
  int lock = -1;
  job_on(&m, "clip");
  support_ok(m.job.context, open_record(&m, &lock));
  assert_int_equal(json_object_set_new(m.job.record, "frames", json_integer(40)), 0);
  support_ok(m.job.context, ern_prepare_record_save(&m.job));
  shut(&lock);
  for (int i = 0; i < 4; i++) {
    if (i == 0) m.options.from = 1;
    if (i == 1) m.options.to = 3;
    if (i == 2) m.job.side = 256;
    if (i == 3) support_write_text("made.mp4", "another video");
    support_expect(m.job.context, open_record(&m, &lock), ERN_E_EXISTS, "clip", "another video", "--overwrite", NULL);
    shut(&lock);
    m.options.from = m.options.to = 0;
    m.job.side = 128;
  }
  m.options.anew = true;
  support_ok(m.job.context, open_record(&m, &lock));
  assert_int_equal(json_integer_value(json_object_get(m.job.record, "frames")), 40); /* those to be cleared */
  shut(&lock);
  made_job_close(&m);
}

/* The same bytes at another nanosecond are another video. */
static void test_nanoseconds(void **state) {
  (void)state;
  struct made_job m;
  struct timespec times[2] = {{.tv_sec = 1000, .tv_nsec = 5}, {.tv_sec = 1000, .tv_nsec = 5}};
  int lock = -1;
  job_on(&m, "clip");
  assert_int_equal(utimensat(AT_FDCWD, "made.mp4", times, 0), 0);
  support_ok(m.job.context, open_record(&m, &lock));
  support_ok(m.job.context, ern_prepare_record_save(&m.job));
  shut(&lock);
  times[1].tv_nsec = 6;
  assert_int_equal(utimensat(AT_FDCWD, "made.mp4", times, 0), 0);
  support_expect(m.job.context, open_record(&m, &lock), ERN_E_EXISTS, "clip", "another video", NULL);
  shut(&lock);
  times[1].tv_nsec = 5;
  assert_int_equal(utimensat(AT_FDCWD, "made.mp4", times, 0), 0);
  support_ok(m.job.context, open_record(&m, &lock));
  shut(&lock);
  made_job_close(&m);
}

/* A record of an earlier version does not name all that was made: the clip is the user's but for --overwrite. */
static void test_earlier_version(void **state) {
  (void)state;
  struct made_job m;
  int lock = -1;
  job_on(&m, "clip");
  support_ok(m.job.context, open_record(&m, &lock));
  assert_int_equal(json_object_set_new(m.job.record, "version", json_integer(1)), 0);
  assert_int_equal(json_object_set_new(m.job.record, "frames", json_integer(40)), 0);
  support_ok(m.job.context, ern_prepare_record_save(&m.job));
  shut(&lock);
  support_expect(m.job.context, open_record(&m, &lock), ERN_E_EXISTS, "clip", "earlier version", "--overwrite", NULL);
  shut(&lock);
  m.options.anew = true;
  support_ok(m.job.context, open_record(&m, &lock));
  assert_int_equal(json_integer_value(json_object_get(m.job.record, "version")), 2);
  assert_int_equal(json_integer_value(json_object_get(m.job.record, "frames")), 40); /* those to be cleared */
  shut(&lock);
  made_job_close(&m);
}

/* The folder is moved away while it is worked in, and another one has its name: nothing of that is touched. */
static void test_moved(void **state) {
  (void)state;
  struct made_job m;
  char path[ERN_PREPARE_PATH];
  int lock = -1;
  job_on(&m, "clip");
  support_clear("moved");
  support_ok(m.job.context, open_record(&m, &lock));
  support_ok(m.job.context, ern_prepare_register_output(&m.job, "report.html", path));
  assert_int_equal(rename("clip", "moved"), 0);
  for (int other = 0; other < 2; other++) {
    if (other > 0) {
      assert_int_equal(mkdir("clip", 0777), 0);
      support_write_text("clip/prepare.json", "mine");
      support_write_text("clip/au.csv", "mine");
    }
    m.job.frames = 3;
    support_expect(m.job.context, ern_prepare_record_save(&m.job), ERN_E_IO, "clip", "moved", NULL);
    support_expect(m.job.context, ern_prepare_path(&m.job, path, "au.csv"), ERN_E_IO, "clip", "moved", NULL);
    support_expect(m.job.context, ern_prepare_remove_made(&m.job, "report.html"), ERN_E_IO, "clip", "moved", NULL);
    support_expect(m.job.context, ern_prepare_clear(&m.job), ERN_E_IO, "clip", "moved", NULL);
  }
  assert_int_equal(system("printf mine | cmp - clip/prepare.json && printf mine | cmp - clip/au.csv"), 0);
  support_clear("clip");
  assert_int_equal(rename("moved", "clip"), 0); /* it is back */
  support_ok(m.job.context, ern_prepare_record_save(&m.job));
  shut(&lock);
  made_job_close(&m);
}

static void test_folders_of_others(void **state) {
  (void)state;
  struct made_job m;
  int lock = -1;
  job_on(&m, "clip");
  assert_int_equal(mkdir("clip", 0777), 0);
  support_ok(m.job.context, open_record(&m, &lock)); /* empty */
  shut(&lock);
  support_write_text("clip/prepare.json.ernerf-tmp", ""); /* of a call that was killed in its first write */
  support_ok(m.job.context, open_record(&m, &lock));
  shut(&lock);
  support_write_text("clip/thesis.txt", "mine");
  m.options.anew = true; /* not even then */
  support_expect(m.job.context, open_record(&m, &lock), ERN_E_EXISTS, "clip", "did not make", NULL);
  shut(&lock);
  support_clear("clip");
  support_write_text("clip", "a file");
  assert_int_not_equal(open_record(&m, &lock), ERN_OK);
  assert_non_null(strstr(ern_last_error(m.job.context), "clip"));
  shut(&lock);
  support_clear("clip");
  remove("made.mp4");
  support_expect(m.job.context, open_record(&m, &lock), ERN_E_MISSING, "made.mp4", NULL);
  assert_int_not_equal(access("clip", F_OK), 0);
  made_job_close(&m);
}

static void test_damaged(void **state) {
  (void)state;
  static const char *const bad[] = {"",
                                    "{",
                                    "[]",
                                    "text",
                                    "{\"version\": 1}",
                                    "{\"version\": 3, \"source\": {}, \"steps\": {}}",
                                    "{\"version\": 0, \"source\": {}, \"steps\": {}}",
                                    "{\"version\": 2, \"source\": [], \"steps\": {}}",
                                    "{\"version\": 2, \"source\": {}, \"steps\": []}",
                                    "{\"version\": 2, \"source\": {}, \"steps\": {}, \"steps\": {}}",
                                    "{\"version\": 2, \"source\": {}, \"steps\": {}, \"frames\": -1}",
                                    "{\"version\": 2, \"source\": {}, \"steps\": {}, \"frames\": 45001}",
                                    "{\"version\": 2, \"source\": {}, \"steps\": {}, \"frames\": \"9\"}",
                                    "{\"version\": 2, \"source\": {}, \"steps\": {}, \"frames\": 1e3}"};
  struct made_job m;
  int lock = -1;
  job_on(&m, "clip");
  m.options.anew = true;
  assert_int_equal(mkdir("clip", 0777), 0);
  for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
    support_write_text("clip/prepare.json", bad[i]);
    support_expect(m.job.context, open_record(&m, &lock), ERN_E_FORMAT, "clip/prepare.json", NULL);
    shut(&lock);
  }
  /* steps that say nothing of use are not done */
  static const char odd[] =
      "{\"version\": 2, \"source\": {}, \"steps\": {\"face\": 3, \"pose\": {\"verdict\": \"good\"},"
      " \"eyes\": {\"verdict\": \"fine\", \"words\": \"\", \"settings\": \"au \"}}}";
  ern_prepare_verdict verdict = {0};
  support_write_text("clip/prepare.json", odd);
  m.options.anew = false;
  support_expect(m.job.context, open_record(&m, &lock), ERN_E_EXISTS, "another video", NULL);
  shut(&lock);
  assert_false(ern_prepare_record_has(&m.job, "face", "", &verdict));
  assert_false(ern_prepare_record_has(&m.job, "pose", "", &verdict));
  assert_false(ern_prepare_record_has(&m.job, "eyes", "au ", &verdict));
  made_job_close(&m);
}

static bool there(const char *path) { return access(path, F_OK) == 0; }

/* What an earlier call made goes; files of other names, later frames, links and what is behind them stay. */
static void test_clear(void **state) {
  (void)state;
  struct made_job m;
  made_job_open(&m, "clip", 128, 3);
  static const char *const folders[] = {"ori_imgs", "gt_imgs", "torso_imgs", "prepare"};
  char path[ERN_PREPARE_PATH];
  for (size_t i = 0; i < sizeof folders / sizeof *folders; i++) {
    snprintf(path, sizeof path, "clip/%s", folders[i]);
    assert_int_equal(mkdir(path, 0777), 0);
  }
  static const char *const goes[] = {"ori_imgs/0.jpg",   "ori_imgs/2.lms",      "gt_imgs/1.jpg", "torso_imgs/2.png",
                                     "prepare/pose.csv", "prepare/shown_7.jpg", "aud.wav",       "bc.jpg",
                                     "overlay.mp4",      "transforms_val.json", "report.html",   "gt_imgs/2.jpg",
                                     "gt_imgs/0.jpg",    "torso_imgs/0.png"};
  static const char *const stays[] = {"ori_imgs/3.jpg", "ori_imgs/00.jpg", "prepare/notes.txt",
                                      "prepare.json",   "aud_ds.npy",      "ori_imgs/0.png",
                                      "thesis.txt",     "au.csv",          "aud.npy" /* no call made them */};
  for (size_t i = 0; i < sizeof goes / sizeof *goes; i++) {
    assert_true(ern_prepare_register_output(&m.job, goes[i], path) == ERN_OK);
    support_write_text(path, "made");
  }
  for (size_t i = 0; i < sizeof stays / sizeof *stays; i++) {
    snprintf(path, sizeof path, "clip/%s", stays[i]);
    support_write_text(path, "mine");
  }
  support_clear("elsewhere");
  assert_int_equal(mkdir("elsewhere", 0777), 0);
  support_write_text("elsewhere/0.png", "mine");
  assert_int_equal(symlink("../elsewhere", "clip/parsing"), 0);
  assert_int_equal(symlink("../../elsewhere/0.png", "clip/ori_imgs/1.jpg"), 0);
  assert_int_equal(mkdir("clip/ori_imgs/2.jpg", 0777), 0);
  assert_int_equal(json_object_set_new(m.job.record, "frames", json_integer(3)), 0);
  support_ok(m.job.context, ern_prepare_clear(&m.job));
  for (size_t i = 0; i < sizeof goes / sizeof *goes; i++) {
    snprintf(path, sizeof path, "clip/%s", goes[i]);
    if (there(path)) fail_msg("%s is left", path);
  }
  for (size_t i = 0; i < sizeof stays / sizeof *stays; i++) {
    snprintf(path, sizeof path, "clip/%s", stays[i]);
    if (!there(path)) fail_msg("%s is gone", path);
  }
  assert_true(there("elsewhere/0.png") && there("clip/parsing") && there("clip/ori_imgs/1.jpg"));
  assert_true(there("clip/ori_imgs/2.jpg") && !there("clip/gt_imgs") && !there("clip/torso_imgs"));
  assert_true(m.job.frames == 0 && json_object_get(m.job.record, "frames") == NULL);
  support_ok(m.job.context, ern_prepare_clear(&m.job));
  support_clear("elsewhere");
  made_job_close(&m);
}

/* Files by the names of a clip's in a folder without frames are the user's: no step writes them, and none goes. Nor
 * does one that lies in a clip where a step is not done yet, or beyond its frames. */
static void test_not_made(void **state) {
  (void)state;
  static const struct {
    const char *name;
    size_t step;
  } mine[] = {
      {"ori_imgs/3.jpg", 0}, {"prepare/shown_0.jpg", 0}, {"aud.wav", 5}, {"overlay.mp4", 0}, {"transforms_val.json", 1},
      {"ori_imgs/0.lms", 2}, {"parsing/12.png", 3},      {"bc.jpg", 3},  {"au.csv", 4},      {"aud.npy", 5}};
  struct made_job m;
  char path[ERN_PREPARE_PATH];
  made_job_open(&m, "clip", 128, 0);
  m.options.features = "own.npy";
  for (size_t i = 0; i < sizeof mine / sizeof *mine; i++) {
    snprintf(path, sizeof path, "clip/%s", mine[i].name);
    assert_int_equal(system("mkdir -p clip/ori_imgs clip/prepare clip/parsing"), 0);
    for (int anew = 0; anew < 2; anew++) {
      support_write_text(path, "mine");
      m.options.anew = anew > 0;
      support_expect(m.job.context, ern_prepare_check_files(&m.job, mine[i].step, true),
                     anew > 0 ? ERN_OK : ERN_E_EXISTS, anew > 0 ? NULL : path, "did not make it", NULL);
      if (anew == 0) support_ok(m.job.context, ern_prepare_clear(&m.job));
      assert_true(there(path));
      assert_int_equal(remove(path), 0);
    }
    for (size_t step = 0; step < ERN_PREPARE_STEPS; step++)
      support_ok(m.job.context, ern_prepare_check_files(&m.job, step, true));
  }
  m.options.anew = false;
  assert_int_equal(system("mkdir -p clip/ori_imgs"), 0);
  assert_int_equal(json_object_set_new(m.job.record, "frames", json_integer(3)), 0);
  support_ok(m.job.context,
             ern_prepare_register_output(&m.job, "ori_imgs/0.jpg", path)); /* "face" is done, and nothing else */
  assert_string_equal(path, "clip/ori_imgs/0.jpg");
  m.job.frames = 3;
  support_write_text("clip/ori_imgs/2.jpg", "made");
  support_ok(m.job.context, ern_prepare_check_files(&m.job, 0, true));
  support_write_text("clip/ori_imgs/3.jpg", "mine");
  support_expect(m.job.context, ern_prepare_check_files(&m.job, 0, true), ERN_E_EXISTS, "ori_imgs/3.jpg", NULL);
  support_write_text("clip/ori_imgs/3.lms", "mine");
  support_ok(m.job.context, ern_prepare_check_files(&m.job, 2, false));
  support_write_text("clip/ori_imgs/2.lms", "mine");
  support_expect(m.job.context, ern_prepare_check_files(&m.job, 2, false), ERN_E_EXISTS, "ori_imgs/2.lms", NULL);
  support_expect(m.job.context, ern_prepare_register_output(&m.job, "ori_imgs/0.lms", path), ERN_E_EXISTS,
                 "ori_imgs/2.lms", NULL);
  support_expect(m.job.context, ern_prepare_register_output(&m.job, "thesis.txt", path), ERN_E_ARGUMENT, "thesis.txt",
                 NULL);
  support_write_text("clip/bc.jpg", "mine");
  support_ok(m.job.context, ern_prepare_remove_made(&m.job, "bc.jpg"));
  support_ok(m.job.context, ern_prepare_clear(&m.job));
  assert_true(there("clip/bc.jpg") && there("clip/ori_imgs/2.lms") && there("clip/ori_imgs/3.jpg"));
  assert_false(there("clip/ori_imgs/2.jpg"));
  made_job_close(&m);
}

/* A call that was stopped has noted files which it did not come to write: those that the user puts there stay, and so
 * do those of ours that the user changes. */
static void test_noted_not_written(void **state) {
  (void)state;
  static const char *const names[] = {
      "overlay.mp4", "transforms_val.json", "report.html", "gt_imgs/1.jpg", "ori_imgs/2.jpg", "bc.jpg", "au.csv"};
  enum { NAMES = sizeof names / sizeof *names, SAME = NAMES - 1 }; /* au.csv stays as it was written */
  struct made_job m;
  char path[ERN_PREPARE_PATH];
  made_job_open(&m, "clip", 128, 3);
  assert_int_equal(json_object_set_new(m.job.record, "frames", json_integer(3)), 0);
  assert_int_equal(system("mkdir clip/gt_imgs clip/ori_imgs"), 0);
  for (size_t i = 0; i < NAMES; i++) support_ok(m.job.context, ern_prepare_register_output(&m.job, names[i], path));
  support_write_text("clip/bc.jpg", "made");
  support_write_text("clip/au.csv", "made");
  support_write_text("clip/ori_imgs/0.jpg", "made"); /* and 1 and 2 are not */
  support_ok(m.job.context, ern_prepare_note_made(&m.job));
  for (size_t i = 0; i < NAMES; i++) {
    snprintf(path, sizeof path, "clip/%s", names[i]);
    if (i != SAME) support_write_text(path, "mine");
    support_expect(m.job.context, ern_prepare_register_output(&m.job, names[i], path),
                   i == SAME ? ERN_OK : ERN_E_EXISTS, i == SAME ? NULL : names[i], "did not make it", NULL);
  }
  support_ok(m.job.context, ern_prepare_remove_made(&m.job, "bc.jpg"));
  support_ok(m.job.context, ern_prepare_clear(&m.job));
  for (size_t i = 0; i < NAMES; i++) {
    snprintf(path, sizeof path, "clip/%s", names[i]);
    assert_true(there(path) == (i != SAME));
  }
  assert_false(there("clip/ori_imgs/0.jpg"));
  made_job_close(&m);
}

/* All frames' files that a call has written are its own, also where one of them is gone and a later call, which writes
 * them again, is stopped; not where none is left. */
static void test_noted_with_gap(void **state) {
  (void)state;
  struct made_job m;
  char path[ERN_PREPARE_PATH];
  made_job_open(&m, "clip", 128, 3);
  assert_int_equal(json_object_set_new(m.job.record, "frames", json_integer(3)), 0);
  assert_int_equal(system("mkdir clip/parsing"), 0);
  support_ok(m.job.context, ern_prepare_register_output(&m.job, "parsing/0.png", path));
  for (int i = 0; i < 3; i++) {
    snprintf(path, sizeof path, "clip/parsing/%d.png", i);
    support_write_text(path, "made");
  }
  support_ok(m.job.context, ern_prepare_note_made(&m.job));
  assert_int_equal(remove("clip/parsing/1.png"), 0);
  for (int call = 0; call < 2; call++) {
    support_ok(m.job.context, ern_prepare_note_made(&m.job));
    support_ok(m.job.context, ern_prepare_register_output(&m.job, "parsing/0.png", path));
    support_ok(m.job.context, ern_prepare_note_made(&m.job)); /* it was stopped */
    support_ok(m.job.context, ern_prepare_register_output(&m.job, "parsing/2.png", path));
  }
  assert_int_equal(system("rm clip/parsing/*"), 0);
  support_ok(m.job.context, ern_prepare_note_made(&m.job));
  support_write_text("clip/parsing/2.png", "mine");
  support_expect(m.job.context, ern_prepare_register_output(&m.job, "parsing/0.png", path), ERN_E_EXISTS,
                 "parsing/2.png", NULL);
  made_job_close(&m);
}

/* The public call: a step whose inputs are not there, options out of range, and a folder that nothing came into. */
static void test_call(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_prepare_options options = ern_prepare_options_default();
  ern_prepare_result result;
  support_clear("clip");
  support_write_text("made.mp4", "no video");
  static const char *const later[] = {"pose", "landmarks", "layers", "eyes", "features"};
  for (size_t i = 0; i < sizeof later / sizeof *later; i++) {
    options.only = later[i];
    support_expect(context, ern_prepare(context, "made.mp4", "clip", &options, &result), ERN_E_STATE, "clip",
                   "\"face\"", later[i], NULL);
    assert_false(there("clip"));
  }
  options.only = NULL;
  assert_int_not_equal(ern_prepare(context, "made.mp4", "clip", &options, &result), ERN_OK);
  assert_non_null(strstr(ern_last_error(context), "made.mp4"));
  assert_false(there("clip"));
  assert_int_equal(mkdir("clip", 0777), 0); /* the user's own empty one stays */
  assert_int_not_equal(ern_prepare(context, "made.mp4", "clip", &options, &result), ERN_OK);
  assert_true(there("clip"));
  assert_true(result.frames == 0 && result.verdicts[0].step == NULL);
  /* what a record claims and is not there is made again */
  struct stat about;
  char text[512];
  assert_int_equal(stat("made.mp4", &about), 0);
  snprintf(text, sizeof text,
           "{\"version\": 2, \"source\": {\"bytes\": %lld, \"modified\": %lld, \"nanoseconds\": %ld, \"from\": 0.0,"
           " \"to\": 0.0, \"side\": 512},"
           "\"frames\": 45000, \"steps\": {\"face\": {\"verdict\": \"good\", \"words\": \"\", \"settings\": \"\"}}}",
           (long long)about.st_size, (long long)about.st_mtim.tv_sec, about.st_mtim.tv_nsec);
  support_write_text("clip/prepare.json", text);
  support_expect(context, ern_prepare(context, "made.mp4", "clip", &options, &result), ERN_E_FORMAT, "made.mp4", NULL);
  ern_context_free(&context);
}

/* A clip is opened once its steps are done; one whose prepare.json is somebody else's, as one without. */
static void test_unfinished(void **state) {
  (void)state;
#define DONE(step) "\"" step "\": {\"verdict\": \"good\"}"
  static const char early[] = DONE("face") ", " DONE("pose") ", " DONE("landmarks") ", " DONE("layers");
  static const struct {
    const char *last, *word;
  } steps[] = {{DONE("features"), "the step \"eyes\" is not done"},
               {DONE("eyes") ", \"features\": {\"verdict\": \"refused\"}", "the step \"features\" was refused"},
               {DONE("eyes") ", " DONE("features"), NULL}};
  static const char *const others[] = {"{\"camera\": 3}", "{\"steps\": {}}", "[]", "Notes of the day.", ""};
  ern_context *context = support_context();
  ern_clip *clip = NULL;
  char text[1024];
  support_clear("tiny");
  assert_int_equal(system("cp -r \"$ERNERF_SOURCE/data/tiny\" tiny"), 0);
  for (int i = 0; i < 3; i++) {
    snprintf(text, sizeof text, "{\"version\": 1, \"steps\": {%s, %s}}", early, steps[i].last);
    support_write_text("tiny/prepare.json", text);
    support_expect(context, ern_clip_open(context, "tiny", NULL, &clip), i < 2 ? ERN_E_STATE : ERN_OK,
                   i < 2 ? "tiny/prepare.json" : NULL, steps[i].word, NULL);
    ern_clip_free(&clip);
  }
  for (size_t i = 0; i < sizeof others / sizeof *others; i++) {
    support_write_text("tiny/prepare.json", others[i]);
    support_ok(context, ern_clip_open(context, "tiny", NULL, &clip));
    ern_clip_free(&clip);
  }
  ern_context_free(&context);
}

/* The frames of a video that was refused are none: another part of it may follow, and needs no -y. */
static void test_refused_before(void **state) {
  (void)state;
  struct made_job m;
  int lock = -1;
  job_on(&m, "clip");
  for (int refused = 1; refused >= 0; refused--) {
    m.options.from = refused;
    support_ok(m.job.context, open_record(&m, &lock));
    m.verdict =
        (ern_prepare_verdict){.step = "face", .grade = refused ? ERN_PREPARE_REFUSED : ERN_PREPARE_GOOD, .words = "so"};
    support_ok(m.job.context, ern_prepare_record_enter(&m.job, "", NULL, 0));
    shut(&lock);
  }
  m.options.from = 1;
  support_expect(m.job.context, open_record(&m, &lock), ERN_E_EXISTS, "another --from", NULL);
  shut(&lock);
  made_job_close(&m);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_steps),           cmocka_unit_test(test_locked),
                                     cmocka_unit_test(test_another_video),   cmocka_unit_test(test_nanoseconds),
                                     cmocka_unit_test(test_moved),           cmocka_unit_test(test_folders_of_others),
                                     cmocka_unit_test(test_damaged),         cmocka_unit_test(test_clear),
                                     cmocka_unit_test(test_not_made),        cmocka_unit_test(test_call),
                                     cmocka_unit_test(test_unfinished),      cmocka_unit_test(test_refused_before),
                                     cmocka_unit_test(test_earlier_version), cmocka_unit_test(test_noted_not_written),
                                     cmocka_unit_test(test_noted_with_gap)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
