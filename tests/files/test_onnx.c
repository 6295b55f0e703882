/* SPDX-License-Identifier: MIT
 * ONNX files: what they say of their input and outputs; files that are cut, that lie, and that OpenCV takes wrongly. */
#include "io/onnx.h"

#include <stdbool.h>

#include "../made_onnx.h"
#include "core/memory.h"
#include "io/file.h"

enum { SAMPLES = 64, HOP = 8, SPAN = 10, WIDTH = 2, ROWS = 7 };

static ern_context *context;
static const float weight[WIDTH * SPAN] = {1, 2, 3};
static const struct made_convolution convolution = {SAMPLES, HOP, SPAN, WIDTH, weight};

/* The bytes are a copy of exactly their size, so that a sanitizer sees what is read behind them. */
static ern_status look_at(const uint8_t *bytes, size_t count, struct ern_onnx *onnx) {
  uint8_t *copy = malloc(count > 0 ? count : 1);
  assert_non_null(copy);
  if (count > 0) memcpy(copy, bytes, count);
  const ern_status status = ern_onnx_inspect(context, "x.onnx", copy, count, onnx);
  free(copy);
  return status;
}

/* Takes the graph. */
static ern_status look(struct made_message *graph, struct ern_onnx *onnx) {
  uint8_t *bytes = NULL;
  size_t count = 0;
  made_onnx("x.onnx", graph);
  support_ok(context, ern_file_read(context, "x.onnx", 1 << 20, &bytes, &count));
  const ern_status status = look_at(bytes, count, onnx);
  ern_release(context, bytes);
  return status;
}

static void expect(struct made_message *graph, ern_status expected, const char *first, const char *second) {
  struct ern_onnx onnx;
  support_expect(context, look(graph, &onnx), expected, "x.onnx", first, second, NULL);
}

static void test_fine(void **state) {
  (void)state;
  struct made_message graph = {0};
  struct ern_onnx onnx;
  made_convolve(&graph, &convolution, "rows");
  made_value(&graph, 11, "W", (const size_t[]){WIDTH, 1, SPAN, 0}); /* older files list weights among the inputs */
  made_value(&graph, 12, "convolved", (const size_t[]){1, WIDTH, SIZE_MAX, 0});
  support_ok(context, look(&graph, &onnx));
  assert_string_equal(onnx.input, "wave");
  assert_true(onnx.dims == 3 && onnx.shape[0] == 1 && onnx.shape[1] == 1 && onnx.shape[2] == SAMPLES);
  assert_int_equal(onnx.outputs, 2);
  assert_string_equal(onnx.output[0], "rows");
  assert_string_equal(onnx.output[1], "convolved");
}

/* However a file is cut or one of its bytes changed, it is refused, or all that it has was looked at. */
static void test_damaged(void **state) {
  (void)state;
  struct made_message graph = {0};
  struct ern_onnx onnx;
  uint8_t *bytes = NULL;
  size_t count = 0, refused = 0;
  made_convolve(&graph, &convolution, "rows");
  made_onnx("damaged.onnx", &graph);
  support_ok(context, ern_file_read(context, "damaged.onnx", 1 << 20, &bytes, &count));
  for (size_t cut = 0; cut < count; cut++)
    support_expect(context, look_at(bytes, cut, &onnx), ERN_E_FORMAT, "no ONNX file", NULL);
  for (size_t at = 0; at < count; at++)
    for (int bit = 0; bit < 8; bit++) {
      bytes[at] = (uint8_t)(bytes[at] ^ 1 << bit);
      refused += look_at(bytes, count, &onnx) != ERN_OK;
      bytes[at] = (uint8_t)(bytes[at] ^ 1 << bit);
    }
  assert_true(refused > count); /* most bits of the 80 bytes of weights are as good as others */
  support_ok(context, look_at(bytes, count, &onnx));
  ern_release(context, bytes);
}

static void test_values(void **state) {
  (void)state;
  struct made_message graph = {0};
  made_value(&graph, 11, "wave", (const size_t[]){1, SIZE_MAX, 0});
  made_value(&graph, 12, "rows", (const size_t[]){1, 2, 0});
  expect(&graph, ERN_E_UNSUPPORTED, "\"wave\" is [1, samples], and \"samples\" is not fixed", "fixed sizes");
  made_value(&graph, 11, "wave", (const size_t[]){1, 8, 0});
  made_value(&graph, 11, "mask", (const size_t[]){1, 8, 0});
  expect(&graph, ERN_E_UNSUPPORTED, "\"wave\" and \"mask\"", "expected one");
  made_value(&graph, 11, "wave", (const size_t[]){1, 2, 3, 4, 5, 6, 7, 8, 9, 0});
  expect(&graph, ERN_E_UNSUPPORTED, "9 sizes", "1 to 8");
  made_value(&graph, 11, "wave", (const size_t[]){1, 8, 0});
  expect(&graph, ERN_E_FORMAT, "without an output", "x.onnx");
  made_value(&graph, 12, "rows", (const size_t[]){1, 2, 0});
  expect(&graph, ERN_E_FORMAT, "without an input", "x.onnx");
  struct made_message value = {0};
  made_text(&value, 1, "rows");
  made_value(&graph, 11, "wave", (const size_t[]){1, 8, 0});
  made_inside(&graph, 12, &value);
  expect(&graph, ERN_E_UNSUPPORTED, "output \"rows\" has no sizes", "x.onnx");
}

/* A weight of the sizes 2 x 3 with one field more. */
static void weigh(struct made_message *graph, uint64_t type, unsigned field, const void *bytes, size_t count) {
  struct made_message tensor = {0};
  made_number(&tensor, 1, 2);
  made_number(&tensor, 1, 3);
  made_number(&tensor, 2, type);
  made_text(&tensor, 8, "V");
  made_bytes(&tensor, field, bytes, count);
  made_inside(graph, 5, &tensor);
  made_convolve(graph, &convolution, "rows");
}

/* OpenCV 4.6 reads as many numbers as the sizes say, whatever is there. */
static void test_weights(void **state) {
  (void)state;
  static const uint8_t zeros[64] = {0};
  static const struct {
    uint64_t type;
    unsigned field;
    size_t bytes;
    bool fine;
  } cases[] = {{1, 9, 24, true},   {1, 9, 23, false},   {1, 4, 24, true}, {1, 4, 20, false},
               {1, 7, 6, false},                                                            /* float */
               {6, 9, 24, true},   {6, 9, 8, false},    {6, 5, 6, true},  {6, 5, 5, false}, /* int32 */
               {7, 9, 48, true},   {7, 9, 24, false},   {7, 7, 6, true},  {7, 7, 7, false}, /* int64 */
               {11, 10, 48, true}, {11, 10, 40, false}, {3, 9, 6, true},  {3, 9, 5, false},
               {2, 5, 6, true}, /* double, 8 bits */
               {1, 9, 0, true},    {99, 9, 24, false}};
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    struct made_message graph = {0};
    struct ern_onnx onnx;
    weigh(&graph, cases[i].type, cases[i].field, zeros, cases[i].bytes);
    const ern_status status = look(&graph, &onnx);
    if ((status == ERN_OK) != cases[i].fine) fail_msg("case %zu: %s", i, ern_last_error(context));
    if (!cases[i].fine && cases[i].type != 99)
      support_expect(context, status, ERN_E_FORMAT, "the weight \"V\"", "as many numbers", NULL);
  }
  struct made_message graph = {0};
  weigh(&graph, 1, 13, "weights.bin", 11);
  expect(&graph, ERN_E_UNSUPPORTED, "\"V\" lies in another file", "2 GiB");
}

/* OpenCV 4.6 ends the process where a convolution's weight is not there. */
static void test_names(void **state) {
  (void)state;
  struct made_message graph = {0};
  made_convolve(&graph, &convolution, "rows");
  made_node(&graph, "Conv", "wave V", "other", NULL);
  expect(&graph, ERN_E_FORMAT, "a node uses \"V\", which is not there", "x.onnx");
  made_node(&graph, "Relu", "rows", "early", NULL); /* what a later node gives */
  made_convolve(&graph, &convolution, "rows");
  expect(&graph, ERN_E_FORMAT, "\"rows\", which is not there", "x.onnx");
}

/* OpenCV 4.6 divides by a group and by sizes of 0, writes at an axis that is not there, and takes inputs that are not.
 */
static void test_nodes(void **state) {
  (void)state;
  static const struct {
    const char *kind, *inputs;
    struct made_attribute attributes[2];
    const char *words;
  } cases[] = {
      {"Conv", "wave W", {{"group", 1, {0}}}, "the operator Conv (node \"more\") has group 0, expected 1 or more"},
      {"Conv", "wave W", {{"group", 1, {(uint64_t)-3}}}, "has group -3, expected 1 or more"},
      {"Gather", "rows W", {{"axis", 1, {77}}}, "the operator Gather (node \"more\") has axis 77, expected -8 to 7"},
      {"ReduceMean", "rows", {{"axes", 2, {1, (uint64_t)-9}}}, "has axes -9, expected -8 to 7"},
      {"Conv", "wave V", {{NULL, 0, {0}}}, "the operator Conv (node \"more\") uses \"V\", which has a size of 0"},
      {"Resize", "rows", {{NULL, 0, {0}}}, "the operator Resize (node \"more\") has 1 inputs, expected at least 2"},
      {"Resize", "rows V W", {{NULL, 0, {0}}}, NULL},
      {"Conv", "wave W", {{"group", 1, {1}}}, NULL},
      {"Gather", "rows W", {{"axis", 1, {(uint64_t)-8}}}, NULL},
      {"Gather", "rows W", {{"axis", 1, {7}}}, NULL}};
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    struct made_message graph = {0}, tensor = {0};
    struct ern_onnx onnx;
    made_number(&tensor, 1, 5);
    made_number(&tensor, 1, 0);
    made_number(&tensor, 2, 1);
    made_text(&tensor, 8, "V");
    made_inside(&graph, 5, &tensor);
    made_convolve(&graph, &convolution, "rows");
    made_node(&graph, cases[i].kind, cases[i].inputs, "more", cases[i].attributes);
    const ern_status status = look(&graph, &onnx);
    if (cases[i].words == NULL)
      support_ok(context, status);
    else
      support_expect(context, status, ERN_E_FORMAT, "x.onnx", cases[i].words, NULL);
  }
}

static int set_up(void **state) {
  (void)state;
  context = support_context();
  return 0;
}

static int tear_down(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_fine),   cmocka_unit_test(test_damaged),
                                     cmocka_unit_test(test_values), cmocka_unit_test(test_weights),
                                     cmocka_unit_test(test_names),  cmocka_unit_test(test_nodes)};
  return cmocka_run_group_tests(tests, set_up, tear_down);
}
