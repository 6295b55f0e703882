/* SPDX-License-Identifier: MIT
 * What PyTorch wrote before 1.6: tensors in storages behind their pickles, as Python 2 and 3 wrote them; torn and
 * contradictory files refused by name. */
#include "io/torch_legacy.h"

#include "core/memory.h"
#include "io/torch_zip.h"
#include "support.h"

#define MAGIC "\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19."
#define VERSION "\x80\x02M\xe9\x03."
#define MACHINE(little) "\x80\x02}U\x0dlittle_endian" little "s."
#define STORAGE(key, count)                      \
  "(U\x07storagectorch\nFloatStorage\nU\x01" key \
  "U\x03"                                        \
  "cpuK" count "NtQ"
#define TENSOR(key, count, view) "ctorch._utils\n_rebuild_tensor_v2\n(" STORAGE(key, count) view "\x89NtR"
#define FIRST_TENSOR(key, count, view) "ctorch._utils\n_rebuild_tensor\n(" STORAGE(key, count) view "tR"
#define WHOLE "K\x00K\x02K\x03\x86K\x03K\x01\x86"
#define TURNED "K\x00K\x03K\x02\x86K\x01K\x03\x86" /* the transpose */
#define ORDERED(pairs) \
  "\x80\x02"           \
  "ccollections\nOrderedDict\n](" pairs "e\x85R."
#define PAIR(name, value) "](U\x01" name value "e"
#define KEYS "\x80\x02](U\x01xU\x01ye."
#define SIX "\x06\0\0\0\0\0\0\0"
#define DATA                                                                           \
  ORDERED(PAIR("a", TENSOR("x", "\x06", WHOLE)) PAIR("b", TENSOR("x", "\x06", TURNED)) \
              PAIR("c", FIRST_TENSOR("y", "\x06", WHOLE)))

static const float values[2][6] = {{0, 1, 2, 3, 4, 5}, {-7, 8, 9, 0.5f, 6, 1e30f}};

struct bytes {
  uint8_t at[1024];
  size_t count;
};

static void put(struct bytes *b, const void *bytes, size_t count) {
  assert_true(b->count + count <= sizeof b->at);
  memcpy(b->at + b->count, bytes, count);
  b->count += count;
}
#define PUT(b, text) put(b, text, sizeof(text) - 1)

static struct bytes make(const char *head, size_t head_count) {
  struct bytes b = {.count = 0};
  put(&b, head, head_count);
  for (int k = 0; k < 2; k++) {
    PUT(&b, SIX);
    put(&b, values[k], sizeof values[k]);
  }
  return b;
}
#define MAKE(head) make(head, sizeof(head) - 1)
#define GOOD MAGIC VERSION MACHINE("\x88") DATA KEYS

static ern_status read_all(ern_context *context, const uint8_t *bytes, size_t count, struct ern_tensor_file *file) {
  uint8_t *copy = NULL;
  char *tree = NULL;
  struct ern_torch torch;
  *file = (struct ern_tensor_file){0};
  support_ok(context, ERN_NEW(context, count + 1, &copy));
  memcpy(copy, bytes, count);
  ern_status status = ern_torch_open(context, "x.pth", copy, count, &torch);
  if (status == ERN_OK) status = ern_torch_tensors(context, &torch, "", file, &tree);
  ern_release(context, tree);
  return status;
}

static void test_tensors(void **state) {
  (void)state;
  ern_context *context = support_context();
  struct ern_tensor_file file;
  const struct bytes b = MAKE(GOOD);
  support_ok(context, read_all(context, b.at, b.count, &file));
  assert_int_equal(file.tensor_count, 3);
  const struct ern_tensor *a = ern_tensor_file_find(&file, "a"), *turned = ern_tensor_file_find(&file, "b"),
                          *c = ern_tensor_file_find(&file, "c");
  assert_true(a != NULL && turned != NULL && c != NULL);
  assert_true(a->dims == 2 && a->shape[0] == 2 && a->shape[1] == 3 && a->dtype == ERN_F32);
  assert_true(turned->shape[0] == 3 && turned->shape[1] == 2);
  assert_memory_equal(a->data, values[0], sizeof values[0]);
  assert_memory_equal(c->data, values[1], sizeof values[1]);
  for (int i = 0; i < 6; i++) assert_true(((const float *)turned->data)[i] == values[0][i % 2 * 3 + i / 2]);
  ern_tensor_file_free(context, &file);
  ern_context_free(&context);
}

static void refuse(struct bytes b, ern_status expected, const char *words) {
  ern_context *context = support_context();
  struct ern_tensor_file file;
  support_expect(context, read_all(context, b.at, b.count, &file), expected, "x.pth", words, NULL);
  ern_tensor_file_free(context, &file);
  ern_context_free(&context);
}

static void test_refused(void **state) {
  (void)state;
  refuse(MAKE(MAGIC "\x80\x02K\x07." MACHINE("\x88") DATA KEYS), ERN_E_FORMAT, "version");
  refuse(MAKE(MAGIC VERSION MACHINE("\x89") DATA KEYS), ERN_E_UNSUPPORTED, "little_endian");
  refuse(MAKE(MAGIC VERSION "\x80\x02K\x01." DATA KEYS), ERN_E_UNSUPPORTED, "little_endian");
  refuse(MAKE(MAGIC VERSION MACHINE("\x88") DATA "\x80\x02K\x02."), ERN_E_FORMAT, "keys");
  refuse(MAKE(MAGIC VERSION MACHINE("\x88") DATA "\x80\x02](U\x01xU\x01xe."), ERN_E_FORMAT, "twice");
  refuse(MAKE(MAGIC VERSION MACHINE("\x88") DATA "\x80\x02](U\x01xU\x01ze."), ERN_E_FORMAT, "storage z");
  refuse(MAKE(MAGIC VERSION MACHINE("\x88") DATA "\x80\x02](U\x01xe."), ERN_E_FORMAT, "bytes follow");
  refuse(MAKE(MAGIC VERSION MACHINE("\x88")
                  ORDERED(PAIR("a", TENSOR("x", "\x06", WHOLE)) PAIR("b", TENSOR("x", "\x07", WHOLE))) KEYS),
         ERN_E_FORMAT, "two types or sizes");
  refuse(MAKE(MAGIC VERSION MACHINE("\x88")
                  ORDERED(PAIR("a", TENSOR("x", "\x09", WHOLE)) PAIR("b", TENSOR("y", "\x06", WHOLE))) KEYS),
         ERN_E_SHAPE, "6 elements, expected 9");
  refuse(MAKE(MAGIC VERSION MACHINE("\x88") "\x80\x02"
                                            "cposix\nsystem\n(U\x02lstR." KEYS),
         ERN_E_UNSUPPORTED, "posix");
  struct bytes more = MAKE(GOOD);
  PUT(&more, "x");
  refuse(more, ERN_E_FORMAT, "bytes follow");
}

/* Cut off anywhere it is refused; with any byte changed it is refused or read, and nothing breaks. */
static void test_damaged(void **state) {
  (void)state;
  ern_context *context = support_context();
  const struct bytes good = MAKE(GOOD);
  struct ern_tensor_file file;
  for (size_t count = 16; count < good.count; count++) {
    assert_true(read_all(context, good.at, count, &file) != ERN_OK);
    assert_non_null(strstr(ern_last_error(context), "x.pth"));
  }
  for (size_t at = 15; at < good.count; at++)
    for (int bit = 0; bit < 8; bit++) {
      struct bytes b = good;
      b.at[at] ^= (uint8_t)(1 << bit);
      if (read_all(context, b.at, b.count, &file) == ERN_OK) ern_tensor_file_free(context, &file);
    }
  ern_context_free(&context);
}

static void test_kind(void **state) {
  (void)state;
  const struct bytes b = MAKE(GOOD);
  assert_true(ern_torch_is_legacy(b.at, 16));
  assert_false(ern_torch_is_legacy(b.at, 14));
  assert_false(ern_torch_is_legacy((const uint8_t *)"PK\3\4 and so on......", 20));
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_tensors), cmocka_unit_test(test_refused),
                                     cmocka_unit_test(test_damaged), cmocka_unit_test(test_kind)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
