/* SPDX-License-Identifier: MIT
 * The pickle machine: what it builds, and what it refuses with opcode and offset. */
#include "io/pickle.h"

#include "support.h"

struct fixture {
  ern_context *context;
  struct ern_pickle pickle;
};

static int setup(void **state) {
  struct fixture *f = calloc(1, sizeof *f);
  f->context = support_context();
  *state = f;
  return 0;
}

static int teardown(void **state) {
  struct fixture *f = *state;
  ern_pickle_free(f->context, &f->pickle);
  ern_context_free(&f->context);
  free(f);
  return 0;
}

static ern_status read_bytes(struct fixture *f, const char *bytes, size_t count) {
  ern_pickle_free(f->context, &f->pickle);
  /* exactly as long as it is, so that a read past its end is seen */
  uint8_t *copy = malloc(count > 0 ? count : 1);
  memcpy(copy, bytes, count);
  const ern_status status = ern_pickle_read(f->context, "test", copy, count, &f->pickle);
  free(copy);
  return status;
}

#define READ(f, text) read_bytes(f, text, sizeof(text) - 1)

static void test_values(void **state) {
  struct fixture *f = *state;
  support_ok(f->context, READ(f,
                              "\x80\x02]q\x00(K\x07M\x01\x02J\xfe\xff\xff\xff\x8a\x02\x00\x80\x88\x89NG?\xf8\x00\x00"
                              "\x00\x00\x00\x00X\x02\x00\x00\x00hi\x8c\x01zC\x02\x00\xff)\x85h\x00\x86"
                              "e."));
  const struct ern_pickle_value *root = f->pickle.root;
  assert_int_equal(root->kind, ERN_PICKLE_LIST);
  assert_int_equal(root->as.list.count, 12);
  struct ern_pickle_value *const *item = root->as.list.item;
  static const int64_t integers[] = {7, 513, -2, -32768, 1, 0};
  for (size_t i = 0; i < 6; i++) assert_int_equal(item[i]->as.integer, integers[i]);
  assert_int_equal(item[4]->kind, ERN_PICKLE_BOOL);
  assert_int_equal(item[6]->kind, ERN_PICKLE_NONE);
  assert_true(item[7]->as.real == 1.5);
  assert_string_equal(item[8]->as.words.text, "hi");
  assert_string_equal(item[9]->as.words.text, "z");
  assert_int_equal(item[10]->kind, ERN_PICKLE_BYTES);
  assert_int_equal(item[10]->as.words.length, 2);
  assert_int_equal(item[11]->kind, ERN_PICKLE_TUPLE); /* ((()), the list itself) */
  assert_ptr_equal(item[11]->as.list.item[1], root);
}

static void test_dicts(void **state) {
  struct fixture *f = *state;
  support_ok(f->context, READ(f,
                              "\x80\x02"
                              "ccollections\nOrderedDict\n)R(X\x01\x00\x00\x00"
                              "aK\x01X\x01\x00\x00\x00"
                              "bK\x02"
                              "uX\x01\x00\x00\x00"
                              "aK\x03s}X\x01\x00\x00\x00xNsb."));
  assert_int_equal(f->pickle.root->kind, ERN_PICKLE_ORDERED);
  assert_int_equal(ern_pickle_get(f->pickle.root, "a")->as.integer, 3); /* the last one counts, as in Python */
  assert_int_equal(ern_pickle_get(f->pickle.root, "b")->as.integer, 2);
  assert_null(ern_pickle_get(f->pickle.root, "c"));
}

#define STORAGE                                                       \
  "((X\x07\x00\x00\x00storagectorch\nFloatStorage\nX\x01\x00\x00\x00" \
  "0X\x03\x00\x00\x00"                                                \
  "cpuK\x0ctQ"

static void test_tensor(void **state) {
  struct fixture *f = *state;
  support_ok(f->context, READ(f,
                              "\x80\x02"
                              "ctorch._utils\n_rebuild_tensor_v2\n" STORAGE "K\x02K\x02K\x05\x86K\x05K\x01\x86\x89"
                              "ccollections\nOrderedDict\n)RtR."));
  const struct ern_pickle_value *tensor = f->pickle.root;
  assert_int_equal(tensor->kind, ERN_PICKLE_TENSOR);
  assert_int_equal(tensor->as.tensor.offset, 2);
  assert_int_equal(tensor->as.tensor.shape[1], 5);
  assert_int_equal(tensor->as.tensor.stride[0], 5);
  assert_string_equal(tensor->as.tensor.storage->as.storage.key, "0");
  /* the same from element 3 on reaches one too far */
  support_expect(f->context,
                 READ(f,
                      "\x80\x02"
                      "ctorch._utils\n_rebuild_tensor_v2\n" STORAGE "K\x03K\x02K\x05\x86K\x05K\x01\x86\x89"
                      "ccollections\nOrderedDict\n)RtR."),
                 ERN_E_SHAPE, "element 12", "has 12", NULL);
  /* a stride that overflows */
  support_expect(f->context,
                 READ(f,
                      "\x80\x02"
                      "ctorch._utils\n_rebuild_tensor_v2\n" STORAGE
                      "K\x00K\x05\x85\x8a\x08\xff\xff\xff\xff\xff\xff\xff\x7f\x85\x89"
                      "ccollections\nOrderedDict\n)RtR."),
                 ERN_E_FORMAT, "too large", NULL);
  support_expect(f->context,
                 READ(f,
                      "\x80\x02"
                      "ctorch._utils\n_rebuild_tensor_v2\n" STORAGE "K\x00J\xff\xff\xff\xff\x85K\x01\x85\x89"
                      "ccollections\nOrderedDict\n)RtR."),
                 ERN_E_FORMAT, "size or stride", NULL);
}

static void test_numpy(void **state) {
  struct fixture *f = *state;
  support_ok(f->context, READ(f,
                              "\x80\x02"
                              "cnumpy.core.multiarray\nscalar\ncnumpy\ndtype\nX\x02\x00\x00\x00"
                              "f4\x89\x88\x87R(K\x03"
                              "X\x01\x00\x00\x00<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
                              "c_codecs\nencode\nX\x06\x00\x00"
                              "\x00\x00\x00\xc3\x80\xc2\xbfX\x06\x00\x00\x00latin1\x86R\x86R."));
  assert_int_equal(f->pickle.root->kind, ERN_PICKLE_FLOAT);
  assert_true(f->pickle.root->as.real == -1.5);
}

static void test_refused(void **state) {
  struct fixture *f = *state;
  support_expect(f->context,
                 READ(f,
                      "\x80\x02"
                      "cos\nsystem\nX\x02\x00\x00\x00ls\x85R."),
                 ERN_E_UNSUPPORTED, "0x63", "offset 2", "os.system", NULL);
  support_expect(f->context, READ(f, "\x80\x04\x8c\x02os\x8c\x06system\x93."), ERN_E_UNSUPPORTED, "0x93", "offset 14",
                 "os.system", NULL);
  support_expect(f->context,
                 READ(f,
                      "\x80\x02"
                      "c__builtin__\neval\n)R."),
                 ERN_E_UNSUPPORTED, "__builtin__.eval", NULL);
  support_expect(f->context,
                 READ(f,
                      "\x80\x02"
                      "ctorch\nload\n)R."),
                 ERN_E_UNSUPPORTED, "torch.load", NULL);
  static const char unknown[] = "iIFSVPgp2\x81\x82\x83\x84\x8b\x8f\x90\x91\x92\x96\x97\x98\xff";
  for (size_t i = 0; i + 1 < sizeof unknown; i++) {
    const char bytes[] = {'\x80', 2, 'N', unknown[i], '.'};
    char word[8];
    snprintf(word, sizeof word, "0x%02x", (unsigned)(uint8_t)unknown[i]);
    support_expect(f->context, read_bytes(f, bytes, sizeof bytes), ERN_E_UNSUPPORTED, word, "offset 3", NULL);
  }
  support_expect(f->context, READ(f, "\x80\x01N."), ERN_E_UNSUPPORTED, "protocol 1", NULL);
  support_expect(f->context,
                 READ(f,
                      "\x80\x02"
                      "ctorch\nFloatStorage\n)R."),
                 ERN_E_FORMAT, "not called", NULL);
}

static void test_damaged(void **state) {
  struct fixture *f = *state;
  static const struct {
    const char *bytes;
    size_t count;
    const char *word;
  } rows[] = {{"", 0, "ends at 0"},
              {"N.", 2, "the protocol"},
              {"\x80\x02", 2, "without the opcode of its end"},
              {"\x80\x02.", 3, "the stack is empty"},
              {"\x80\x02NN.", 5, "left on the stack"},
              {"\x80\x02N.N", 5, "bytes follow"},
              {"\x80\x02"
               "0.",
               4, "the stack is empty"},
              {"\x80\x02(0.", 5, "the stack is empty"},
              {"\x80\x02t.", 4, "no mark"},
              {"\x80\x02h\x05.", 5, "memo"},
              {"\x80\x02j\xff\xff\xff\xff.", 8, "memo"},
              {"\x80\x02X\xff\xff\xff\xff"
               "a.",
               9, "longer than the pickle"},
              {"\x80\x02X\x05\x00\x00\x00"
               "a.",
               9, "ends inside"},
              {"\x80\x02K", 3, "ends inside"},
              {"\x80\x02"
               "cos",
               5, "ends inside a name"},
              {"\x80\x02}(Nu.", 7, "key without"},
              {"\x80\x02NNs.", 6, "the stack is empty"},
              {"\x80\x02NNNs.", 7, "expected a dict"},
              {"\x80\x02NNa.", 6, "expected a list"},
              {"\x80\x02NNR.", 6, "callable"},
              {"\x80\x02NNb.", 6, "attributes"},
              {"\x80\x02NQ.", 5, "storage"},
              {"\x80\x04\x95\xff\xff\xff\xff\xff\xff\xff\xffN.", 13, "frame"}};
  for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
    support_expect(f->context, read_bytes(f, rows[i].bytes, rows[i].count), ERN_E_FORMAT, rows[i].word, NULL);
    assert_null(f->pickle.root);
  }
  support_expect(f->context,
                 READ(f,
                      "\x80\x02\x8a\x09"
                      "123456789."),
                 ERN_E_UNSUPPORTED, "9 bytes", NULL);
  support_expect(f->context, READ(f, "\x80\x02Nr\xff\xff\xff\x7f."), ERN_E_SHAPE, "memo", NULL);
}

/* Every beginning of a sound pickle is refused, and none reads past its end (under the address sanitizer). */
static void test_cut(void **state) {
  struct fixture *f = *state;
  static const char whole[] =
      "\x80\x02"
      "ctorch._utils\n_rebuild_tensor_v2\n" STORAGE
      "K\x02K\x02K\x05\x86K\x05K\x01\x86\x89"
      "ccollections\nOrderedDict\n)RtR.";
  for (size_t i = 0; i + 1 < sizeof whole - 1; i++) assert_int_not_equal(read_bytes(f, whole, i), ERN_OK);
  support_ok(f->context, read_bytes(f, whole, sizeof whole - 1));
}

static void test_limits(void **state) {
  struct fixture *f = *state;
  const size_t count = ((size_t)1 << 20) + 16;
  char *bytes = malloc(count);
  memset(bytes, '(', count);
  memcpy(bytes, "\x80\x02", 2);
  support_expect(f->context, read_bytes(f, bytes, count), ERN_E_SHAPE, "on the stack", NULL);
  free(bytes);
}

static ern_status read_again(ern_context *context) {
  static const char whole[] =
      "\x80\x02}(X\x01\x00\x00\x00"
      "aK\x01X\x01\x00\x00\x00"
      "b]K\x01"
      "au.";
  struct ern_pickle pickle;
  const ern_status status = ern_pickle_read(context, "test", (const uint8_t *)whole, sizeof whole - 1, &pickle);
  ern_pickle_free(context, &pickle);
  return status;
}

static void test_memory(void **state) {
  (void)state;
  support_refuse_each(read_again);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test_setup_teardown(test_values, setup, teardown),
                                     cmocka_unit_test_setup_teardown(test_dicts, setup, teardown),
                                     cmocka_unit_test_setup_teardown(test_tensor, setup, teardown),
                                     cmocka_unit_test_setup_teardown(test_numpy, setup, teardown),
                                     cmocka_unit_test_setup_teardown(test_refused, setup, teardown),
                                     cmocka_unit_test_setup_teardown(test_damaged, setup, teardown),
                                     cmocka_unit_test_setup_teardown(test_cut, setup, teardown),
                                     cmocka_unit_test_setup_teardown(test_limits, setup, teardown),
                                     cmocka_unit_test(test_memory)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
