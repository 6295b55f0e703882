/* SPDX-License-Identifier: MIT
 * Landmarks without a network: a jaw that opens wide is followed; a mouth that is drawn sideways is noticed, and a hand
 * before the chin. */
#include "ernerf/media.h"
#include "io/landmarks.h"
#include "prepare_test.h"

enum { SIDE = 256, FRAMES = 22 };

static const double depth = 0.75; /* metres */

/* The mouth opens by `widest` metres until the frame `open`, and closes. In frames 12 to 17 it is drawn sideways by
 * `drawn` metres. In the last `hidden` frames a hand is before the chin. */
struct speech {
  double widest, open, drawn;
  size_t hidden;
};

/* Metres by which the jaw is lowered: nothing five frames before and after `open`, all in three frames. */
static double opening_at(const struct speech *speech, size_t frame) {
  return speech->widest * fmin(fmax(5 - fabs((double)frame - speech->open), 0) / 4, 1);
}

/* How red the lips are at rest, 0..1, `aside` of the mouth's middle. */
static double lips_at(double aside, double y) { return exp(-pow((y - 0.068) / 0.006, 2) - pow(aside / 0.02, 2)); }

/* Grey of the face `down` metres below the eyes, `aside` from its middle: lips and chin move with the jaw, and what
 * they leave is dark. */
static double grey_at(double aside, double down, double opening) {
  const double mouth = 0.068, jaw = down - opening;
  if (down > mouth && jaw < mouth && fabs(aside) < 0.02) return 40;
  const double y = down > mouth ? jaw : down;
  const double crease = exp(-pow((y - mouth - 0.014) / 0.003, 2)), chin = exp(-pow((y - mouth - 0.030) / 0.004, 2));
  return 170 - 50 * lips_at(aside, y) - 25 * crease - 40 * chin + 6 * sin(900 * aside) * sin(700 * y);
}

/* Lips absorb green and blue. */
static void colour_at(uint8_t *pixel, const double at[3], size_t frame, const struct speech *speech) {
  const double aside = at[0] - (frame >= 12 && frame < 18 ? speech->drawn : 0), down = ERN_HEAD_EYES_Y - at[1];
  memset(pixel, (int)grey_at(aside, down, opening_at(speech, frame)), 3);
  for (int c = 1; c < 3; c++) pixel[c] = (uint8_t)(pixel[c] * (1 - 0.25 * lips_at(aside, down)));
  if (frame + speech->hidden >= FRAMES && down > 0.06 && fabs(aside) < 0.03)
    memset(pixel, 130 + 30 * ((int)(down / 0.012) % 2), 3); /* fingers */
}

static void write_clip(struct made_job *m, const struct speech *speech) {
  static uint8_t pixels[3 * SIDE * SIDE];
  struct ern_head_pose poses[FRAMES];
  const ern_image image = {.width = SIDE, .height = SIDE, .channels = 3, .data = pixels};
  struct ern_found_face face = {.x = 60, .y = 60, .width = 140, .height = 140};
  made_job_open(m, "clip", SIDE, FRAMES);
  assert_int_equal(mkdir("clip/ori_imgs", 0777), 0);
  for (size_t i = 0; i < FRAMES; i++) {
    char path[64];
    poses[i] = made_pose(0, 0, 0, 0, 0, depth);
    for (int p = 0; p < SIDE * SIDE; p++) {
      const double pixel[2] = {p % SIDE + 0.5, p / SIDE + 0.5};
      double at[3];
      const bool hit = ern_head_intersect(&poses[i], m->job.focal, 0.5 * SIDE, pixel, false, at);
      memset(pixels + 3 * p, 90, 3);
      if (hit) colour_at(pixels + 3 * p, at, i, speech);
    }
    snprintf(path, sizeof path, "clip/ori_imgs/%zu.jpg", i);
    support_ok(m->job.context, ern_image_write(m->job.context, path, &image, 98));
  }
  support_ok(m->job.context, ern_prepare_poses_write(&m->job, poses));
  support_ok(m->job.context, ern_prepare_faces_write(&m->job, &face, 1));
}

static double figure(const struct made_job *m, const char *name) {
  return json_number_value(json_object_get(m->job.figures, name));
}

/* The chin (landmark 8) is as much lower than in frame 0, whose mouth is closed, as the jaw: but for a pixel of the
 * crop in which it is looked for, 0.6 mm. */
static void expect_followed(struct made_job *m, const struct speech *speech) {
  float points[ERN_LANDMARKS][2], closed = 0;
  for (size_t i = 0; i < FRAMES; i++) {
    char path[64];
    snprintf(path, sizeof path, "clip/ori_imgs/%zu.lms", i);
    support_ok(m->job.context, ern_landmarks_read(m->job.context, path, points));
    if (i == 0) closed = points[8][1];
    const double pixels = m->job.focal / (depth - ERN_HEAD_EYES_Z), /* of a metre */
        drop = ((double)points[8][1] - (double)closed) / pixels;
    if (!(fabs(drop - opening_at(speech, i)) < 0.0006))
      fail_msg("open in frame %g: frame %zu: the chin is %g m lower, expected %g", speech->open, i, drop,
               opening_at(speech, i));
  }
}

/* A mouth that opens wide is followed, also where the middle frame has it open. One that opens more than a mouth does
 * is doubtful. */
static void test_wide(void **state) {
  (void)state;
  static const struct speech cases[] = {
      {.widest = 0.022, .open = 6}, {.widest = 0.022, .open = 11}, {.widest = 0.027, .open = 6}};
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    struct made_job m;
    write_clip(&m, &cases[i]);
    support_ok(m.job.context, ern_prepare_landmarks(&m.job));
    expect_followed(&m, &cases[i]);
    const bool wide = cases[i].widest > 0.025, said = strstr(m.verdict.words, "opens by 27 mm") != NULL;
    if (said != wide || (m.verdict.grade == ERN_PREPARE_DOUBTFUL) != wide)
      fail_msg("open by %g m: grade %d, \"%s\"", cases[i].widest, (int)m.verdict.grade, m.verdict.words);
    made_job_close(&m);
  }
}

/* A mouth that only opens is where its landmarks are. One that is 8 mm aside in 6 of the 22 frames is not, and the
 * verdict says in how many. */
static void test_sideways(void **state) {
  (void)state;
  static const double drawn[] = {0, 0.008, -0.008};
  for (size_t i = 0; i < sizeof drawn / sizeof *drawn; i++) {
    const struct speech speech = {.widest = 0.022, .open = 6, .drawn = drawn[i]};
    struct made_job m;
    write_clip(&m, &speech);
    support_ok(m.job.context, ern_prepare_landmarks(&m.job));
    const bool aside = drawn[i] != 0, said = strstr(m.verdict.words, "in 6 of 22 frames") != NULL;
    if (said != aside || (m.verdict.grade == ERN_PREPARE_DOUBTFUL) != aside ||
        !(fabs(figure(&m, "mouth_aside") - (aside ? 6.0 / FRAMES : 0)) < 1e-9))
      fail_msg("a mouth %g m aside: grade %d, \"%s\", mouth_aside %g", drawn[i], (int)m.verdict.grade, m.verdict.words,
               figure(&m, "mouth_aside"));
    made_job_close(&m);
  }
}

/* A hand before the chin in 3 of the 22 frames is told. */
static void test_hidden(void **state) {
  (void)state;
  const struct speech speech = {.widest = 0.022, .open = 6, .hidden = 3};
  struct made_job m;
  write_clip(&m, &speech);
  support_ok(m.job.context, ern_prepare_landmarks(&m.job));
  if (m.verdict.grade != ERN_PREPARE_DOUBTFUL || !(fabs(figure(&m, "chin_hidden") - 3.0 / FRAMES) < 1e-9) ||
      strstr(m.verdict.words, "the chin looks otherwise in 3 of 22 frames, the first is 19,") == NULL)
    fail_msg("a hand: grade %d, \"%s\", chin_hidden %g", (int)m.verdict.grade, m.verdict.words,
             figure(&m, "chin_hidden"));
  made_job_close(&m);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_wide), cmocka_unit_test(test_sideways),
                                     cmocka_unit_test(test_hidden)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
