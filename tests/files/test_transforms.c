/* SPDX-License-Identifier: MIT
 * transforms_*.json: every field present, of its type, in its range; and what is said where it is not. */
#include "../support.h"

#include "ernerf/data.h"

#define MATRIX "[[1, 0, 0, 0.25], [0, 1, 0, -2], [0, 0, 1, 3e-1], [0, 0, 0, 1]]"
#define FRAME "{\"img_id\": 7, \"aud_id\": 9, \"transform_matrix\": " MATRIX "}"
#define CAMERA "\"focal_len\": 1100.5, \"cx\": 225.0, \"cy\": 200"
#define WITH_FRAME(frame) "{" CAMERA ", \"frames\": [" FRAME ", " frame "]}"
#define WITH_MATRIX(matrix) WITH_FRAME("{\"img_id\": 0, \"aud_id\": 0, \"transform_matrix\": " matrix "}")

static void test_good(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_pose_list list;
  support_write_text("good.json", "{" CAMERA ", \"note\": \"\", \"frames\": [" FRAME ", " FRAME "]}");
  support_expect(context, ern_pose_list_load(context, "good.json", &list), ERN_OK, NULL);
  assert_true(list.focal == 1100.5 && list.cx == 225 && list.cy == 200);
  assert_int_equal(list.width, 450);
  assert_int_equal(list.height, 400);
  assert_int_equal(list.count, 2);
  assert_int_equal(list.poses[1].img_id, 7);
  assert_int_equal(list.poses[1].aud_id, 9);
  const float matrix[16] = {1, 0, 0, 0.25f, 0, 1, 0, -2, 0, 0, 1, 3e-1f, 0, 0, 0, 1};
  assert_memory_equal(list.poses[1].matrix, matrix, sizeof matrix);
  ern_pose_list_free(context, &list);
  assert_null(list.poses);
  ern_pose_list_free(context, &list);
  ern_pose_list_free(context, NULL);

  support_write_text("good.json", "\xef\xbb\xbf{" CAMERA ", \"w\": 512, \"h\": 300.0, \"frames\": [" FRAME "]}");
  support_expect(context, ern_pose_list_load(context, "good.json", &list), ERN_OK, NULL);
  assert_int_equal(list.width, 512);
  assert_int_equal(list.height, 300);
  ern_pose_list_free(context, &list);

  support_write_text("odd.json", "{\"focal_len\": 1, \"cx\": 225.5, \"cy\": 0.5, \"frames\": [" FRAME "]}");
  support_expect(context, ern_pose_list_load(context, "odd.json", &list), ERN_OK, NULL);
  assert_int_equal(list.width, 451);
  assert_int_equal(list.height, 1);
  ern_pose_list_free(context, &list);
  ern_context_free(&context);
}

static void test_bad(void **state) {
  (void)state;
  ern_context *context = support_context();
  static const struct {
    const char *text;
    ern_status status;
    const char *words[3];
  } cases[] = {
      {"", ERN_E_FORMAT, {"line 1", "", ""}},
      {"[]", ERN_E_FORMAT, {"no JSON object", "", ""}},
      {"{" CAMERA, ERN_E_FORMAT, {"line 1", "end of file", ""}},
      {"{" CAMERA ", \"cx\": 4, \"frames\": [" FRAME "]}", ERN_E_FORMAT, {"duplicate", "cx", ""}},
      {"{\"cx\": 1, \"cy\": 1, \"frames\": [" FRAME "]}", ERN_E_FORMAT, {"focal_len is missing", "positive", ""}},
      {"{\"focal_len\": 1, \"cy\": 1, \"frames\": [" FRAME "]}", ERN_E_FORMAT, {"cx is missing", "positive", ""}},
      {"{\"focal_len\": 1, \"cx\": 1, \"frames\": [" FRAME "]}", ERN_E_FORMAT, {"cy is missing", "positive", ""}},
      {"{\"focal_len\": -1, \"cx\": 1, \"cy\": 1}", ERN_E_FORMAT, {"focal_len is -1", "positive", ""}},
      {"{\"focal_len\": 0.0, \"cx\": 1, \"cy\": 1}", ERN_E_FORMAT, {"focal_len is 0.0", "positive", ""}},
      {"{\"focal_len\": \"1\", \"cx\": 1, \"cy\": 1}", ERN_E_FORMAT, {"focal_len is \"1\"", "positive", ""}},
      {"{\"focal_len\": 1e300, \"cx\": 1, \"cy\": 1}", ERN_E_FORMAT, {"focal_len is 1", "float32", ""}},
      {"{\"focal_len\": NaN, \"cx\": 1, \"cy\": 1}", ERN_E_FORMAT, {"line 1", "NaN", ""}},
      {"{\"focal_len\": 1e999, \"cx\": 1, \"cy\": 1}", ERN_E_FORMAT, {"line 1", "overflow", ""}},
      {"{\"focal_len\": 1, \"cx\": 5000, \"cy\": 1, \"frames\": []}", ERN_E_FORMAT, {"cx is 5000", "4096", ""}},
      {"{\"focal_len\": 1, \"cx\": 1, \"cy\": 1e30, \"frames\": []}", ERN_E_FORMAT, {"cy is 1e+30", "4096", ""}},
      {"{\"focal_len\": 1, \"cx\": 1, \"cy\": 0.1, \"frames\": []}", ERN_E_FORMAT, {"cy is 0.1", "0.5", ""}},
      {"{" CAMERA ", \"w\": 450, \"frames\": [" FRAME "]}", ERN_E_FORMAT, {"field h is missing", "both w and h", ""}},
      {"{" CAMERA ", \"h\": 450, \"frames\": [" FRAME "]}", ERN_E_FORMAT, {"field w is missing", "both w and h", ""}},
      {"{" CAMERA ", \"w\": 0, \"h\": 1}", ERN_E_FORMAT, {"field w is 0", "1 to 8192", ""}},
      {"{" CAMERA ", \"w\": 1, \"h\": 9000}", ERN_E_FORMAT, {"field h is 9000", "1 to 8192", ""}},
      {"{" CAMERA ", \"w\": 1.5, \"h\": 1}", ERN_E_FORMAT, {"field w is 1.5", "whole", ""}},
      {"{" CAMERA ", \"w\": true, \"h\": 1}", ERN_E_FORMAT, {"field w is true", "whole", ""}},
      {"{" CAMERA "}", ERN_E_FORMAT, {"frames is missing", "a list", ""}},
      {"{" CAMERA ", \"frames\": []}", ERN_E_FORMAT, {"frames is []", "at least one", ""}},
      {"{" CAMERA ", \"frames\": {\"a\": 1}}", ERN_E_FORMAT, {"frames is {", "at least one", ""}},
      {WITH_FRAME("3"), ERN_E_FORMAT, {"frame 1", "is 3", "an object"}},
      {WITH_FRAME("{\"aud_id\": 0, \"transform_matrix\": " MATRIX "}"),
       ERN_E_FORMAT,
       {"frame 1", "img_id is missing", "whole number"}},
      {WITH_FRAME("{\"img_id\": 0, \"transform_matrix\": " MATRIX "}"),
       ERN_E_FORMAT,
       {"frame 1", "aud_id is missing", "whole number"}},
      {WITH_FRAME("{\"img_id\": -4, \"aud_id\": 0}"), ERN_E_FORMAT, {"frame 1", "img_id is -4", "at least 0"}},
      {WITH_FRAME("{\"img_id\": 4.5, \"aud_id\": 0}"), ERN_E_FORMAT, {"frame 1", "img_id is 4.5", "at least 0"}},
      {WITH_FRAME("{\"img_id\": \"4\", \"aud_id\": 0}"), ERN_E_FORMAT, {"frame 1", "img_id is \"4\"", "whole number"}},
      {WITH_FRAME("{\"img_id\": 4, \"aud_id\": null}"), ERN_E_FORMAT, {"frame 1", "aud_id is null", "whole number"}},
      {WITH_FRAME("{\"img_id\": 99999999999999999999, \"aud_id\": 0}"), ERN_E_FORMAT, {"line 1", "too big", ""}},
      {WITH_FRAME("{\"img_id\": 4, \"aud_id\": 0}"),
       ERN_E_FORMAT,
       {"frame 1", "transform_matrix is missing", "4 rows"}},
      {WITH_MATRIX("[]"), ERN_E_SHAPE, {"frame 1", "transform_matrix is []", "4 rows"}},
      {WITH_MATRIX("[1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]"), ERN_E_SHAPE, {"frame 1", "transform_matrix is", "4 rows"}},
      {WITH_MATRIX("[1, 2, 3, 4]"), ERN_E_SHAPE, {"frame 1", "transform_matrix[0] is 1", "4 numbers"}},
      {WITH_MATRIX("[[1,0,0,0],[0,1,0],[0,0,1,0],[0,0,0,1]]"),
       ERN_E_SHAPE,
       {"frame 1", "transform_matrix[1] is [0, 1, 0]", "4 numbers"}},
      {WITH_MATRIX("[[1,0,0,0],[0,1,\"0\",0],[0,0,1,0],[0,0,0,1]]"),
       ERN_E_FORMAT,
       {"frame 1", "transform_matrix[1][2] is \"0\"", "a number"}},
      {WITH_MATRIX("[[1,0,0,0],[0,1,0,1e300],[0,0,1,0],[0,0,0,1]]"),
       ERN_E_FORMAT,
       {"frame 1", "transform_matrix[1][3] is 1", "at most 1e6"}},
      {WITH_MATRIX("[[1,0,0,0],[0,1,0,0],[0,0,1,-1000001],[0,0,0,1]]"),
       ERN_E_FORMAT,
       {"frame 1", "transform_matrix[2][3] is -1000001", "at most 1e6"}},
      {WITH_MATRIX("[[1,0,0,1e6],[0,1001,0,0],[0,0,1,0],[0,0,0,1]]"),
       ERN_E_FORMAT,
       {"frame 1", "transform_matrix[1][1] is 1001", "at most 1e3"}},
      {WITH_MATRIX("[[1,0,0,0],[0,1,0,Infinity],[0,0,1,0],[0,0,0,1]]"), ERN_E_FORMAT, {"line 1", "Infinity", ""}},
      {WITH_MATRIX("[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,2]]"),
       ERN_E_FORMAT,
       {"frame 1", "transform_matrix[3][3] is 2", "expected 1"}},
      {WITH_MATRIX("[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0.1,0,1]]"),
       ERN_E_FORMAT,
       {"frame 1", "transform_matrix[3][1] is 0.1", "expected 0"}},
      {WITH_MATRIX("[[0,0,0,1],[0,0,0,1],[0,0,0,1],[0,0,0,1]]"), ERN_E_FORMAT, {"frame 1", "is [[0", "a rotation"}},
      {WITH_MATRIX("[[1,0,0,1],[0,1,0,1],[0,0,-1,1],[0,0,0,1]]"), ERN_E_FORMAT, {"frame 1", "is [[1", "determinant 1"}},
      {WITH_MATRIX("[[1.01,0,0,1],[0,1,0,1],[0,0,1,1],[0,0,0,1]]"), ERN_E_FORMAT, {"frame 1", "is [[1", "length 1"}},
      {WITH_MATRIX("[[1,0.02,0,1],[0,1,0,1],[0,0,1,1],[0,0,0,1]]"), ERN_E_FORMAT, {"frame 1", "is [[1", "angles"}}};
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    ern_pose_list list;
    support_write_text("bad.json", cases[i].text);
    support_expect(context, ern_pose_list_load(context, "bad.json", &list), cases[i].status, "bad.json",
                   cases[i].words[0], cases[i].words[1], cases[i].words[2], NULL);
    assert_null(list.poses);
    assert_int_equal(list.count, 0);
  }
  ern_pose_list list;
  support_expect(context, ern_pose_list_load(context, "none.json", &list), ERN_E_MISSING, "none.json", NULL);
  ern_context_free(&context);
}

/* Brackets without end must neither overflow the stack nor pass. */
static void test_deep(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_pose_list list;
  static char text[1000000];
  memset(text, '[', sizeof text);
  support_write("deep.json", text, sizeof text);
  support_expect(context, ern_pose_list_load(context, "deep.json", &list), ERN_E_FORMAT, "deep.json", "depth", NULL);
  ern_context_free(&context);
}

static void test_real(void **state) {
  (void)state;
  support_needs_shared();
  static const struct {
    const char *name;
    size_t count;
    double focal;
    int side;
  } cases[] = {{"real/poses.json", 728, 1100, 450},
               {"real/presenter/transforms_train.json", 200, 1100, 472},
               {"real/presenter/transforms_val.json", 20, 1100, 472},
               {"parity/clip/transforms_train.json", 60, 312.8888888888889, 128}};
  ern_context *context = support_context();
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    char path[1024];
    ern_pose_list list;
    support_shared(cases[i].name, path);
    support_expect(context, ern_pose_list_load(context, path, &list), ERN_OK, NULL);
    assert_int_equal(list.count, cases[i].count);
    assert_true(list.focal == cases[i].focal);
    assert_int_equal(list.width, cases[i].side);
    assert_int_equal(list.height, cases[i].side);
    assert_true(list.poses[list.count - 1].matrix[15] == 1.0f);
    ern_pose_list_free(context, &list);
  }
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_good), cmocka_unit_test(test_bad),
                                     cmocka_unit_test(test_deep), cmocka_unit_test(test_real)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
