/* SPDX-License-Identifier: MIT
 * Landmarks without a network: a jaw that opens wide is followed; a mouth that is drawn sideways is noticed. */
#include "ernerf/media.h"
#include "io/landmarks.h"
#include "prepare_test.h"

enum { SIDE = 256, FRAMES = 22 };

static const double widest = 0.022, depth = 0.75; /* metres */

/* Metres by which the jaw is lowered: closed, wide open five frames later, and closed again, also in the middle frame.
 */
static double opening_at(size_t frame) {
  return frame > 1 && frame < 11 ? widest * (5 - fabs((double)frame - 6)) / 5 : 0;
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

/* Lips absorb green and blue. In frames 12 to 17 the mouth is drawn sideways by `drawn` metres. */
static void colour_at(uint8_t *pixel, const double at[3], size_t frame, double drawn) {
  const double aside = at[0] - (frame >= 12 && frame < 18 ? drawn : 0), down = ERN_HEAD_EYES_Y - at[1];
  memset(pixel, (int)grey_at(aside, down, opening_at(frame)), 3);
  for (int c = 1; c < 3; c++) pixel[c] = (uint8_t)(pixel[c] * (1 - 0.25 * lips_at(aside, down)));
}

static void write_clip(struct made_job *m, double drawn) {
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
      if (hit) colour_at(pixels + 3 * p, at, i, drawn);
    }
    snprintf(path, sizeof path, "clip/ori_imgs/%zu.jpg", i);
    support_ok(m->job.context, ern_image_write(m->job.context, path, &image, 98));
  }
  support_ok(m->job.context, ern_prepare_poses_write(&m->job, poses));
  support_ok(m->job.context, ern_prepare_faces_write(&m->job, &face, 1));
}

/* The chin (landmark 8) is as much lower than in frame 0, whose mouth is closed, as the jaw: but for a pixel of the
 * crop in which it is looked for, 0.6 mm. */
static void test_wide(void **state) {
  (void)state;
  struct made_job m;
  float points[ERN_LANDMARKS][2], closed = 0;
  write_clip(&m, 0);
  support_ok(m.job.context, ern_prepare_landmarks(&m.job));
  for (size_t i = 0; i < FRAMES; i++) {
    char path[64];
    snprintf(path, sizeof path, "clip/ori_imgs/%zu.lms", i);
    support_ok(m.job.context, ern_landmarks_read(m.job.context, path, points));
    if (i == 0) closed = points[8][1];
    const double pixels = m.job.focal / (depth - ERN_HEAD_EYES_Z), /* of a metre */
        drop = ((double)points[8][1] - (double)closed) / pixels;
    if (!(fabs(drop - opening_at(i)) < 0.0006))
      fail_msg("frame %zu: the chin is %g m lower, expected %g", i, drop, opening_at(i));
  }
  made_job_close(&m);
}

static double figure(const struct made_job *m, const char *name) {
  return json_number_value(json_object_get(m->job.figures, name));
}

/* A mouth that only opens is where its landmarks are. One that is 8 mm aside in 6 of the 22 frames is not, and the
 * verdict says in how many. */
static void test_sideways(void **state) {
  (void)state;
  static const double drawn[] = {0, 0.008, -0.008};
  for (size_t i = 0; i < sizeof drawn / sizeof *drawn; i++) {
    struct made_job m;
    write_clip(&m, drawn[i]);
    support_ok(m.job.context, ern_prepare_landmarks(&m.job));
    const bool aside = drawn[i] != 0, said = strstr(m.verdict.words, "in 6 of 22 frames") != NULL;
    if (said != aside || (m.verdict.grade == ERN_PREPARE_DOUBTFUL) != aside ||
        !(fabs(figure(&m, "mouth_aside") - (aside ? 6.0 / FRAMES : 0)) < 1e-9))
      fail_msg("a mouth %g m aside: grade %d, \"%s\", mouth_aside %g", drawn[i], (int)m.verdict.grade, m.verdict.words,
               figure(&m, "mouth_aside"));
    made_job_close(&m);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_wide), cmocka_unit_test(test_sideways)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
