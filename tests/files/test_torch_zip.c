/* SPDX-License-Identifier: MIT
 * The zip of torch.save: written and read again, views made contiguous, damage refused by name. */
#include "io/torch_zip.h"

#include <zip.h>

#include "core/memory.h"
#include "io/file.h"
#include "support.h"

struct part {
  const char *name;
  const void *bytes;
  size_t count;
  int packed;
};

#define TENSOR                                                                                           \
  "ctorch._utils\n_rebuild_tensor_v2\n((X\x07\x00\x00\x00storagectorch\nFloatStorage\nX\x01\x00\x00\x00" \
  "0X\x03\x00\x00\x00"                                                                                   \
  "cpuK\x0ctQ"
#define HOOKS \
  "\x89"      \
  "ccollections\nOrderedDict\n)RtR"
#define DICT(inside)           \
  "\x80\x02}X\x01\x00\x00\x00" \
  "a" inside "s."

static const float twelve[12] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11};
static const char plain[] = DICT(TENSOR "K\x00K\x03K\x04\x86K\x04K\x01\x86" HOOKS);

static void make_zip(const char *path, const struct part *parts, size_t count) {
  int code = 0;
  remove(path);
  zip_t *zip = zip_open(path, ZIP_CREATE | ZIP_TRUNCATE, &code);
  assert_non_null(zip);
  for (size_t i = 0; i < count; i++) {
    const zip_int64_t index =
        zip_file_add(zip, parts[i].name, zip_source_buffer(zip, parts[i].bytes, parts[i].count, 0), 0);
    assert_true(index >= 0);
    assert_int_equal(
        zip_set_file_compression(zip, (zip_uint64_t)index, parts[i].packed ? ZIP_CM_DEFLATE : ZIP_CM_STORE, 0), 0);
  }
  assert_int_equal(zip_close(zip), 0);
}

static ern_status open_bytes(ern_context *context, const uint8_t *bytes, size_t count, struct ern_tensor_file *file,
                             char **tree) {
  uint8_t *copy = NULL;
  struct ern_torch torch;
  *file = (struct ern_tensor_file){0};
  *tree = NULL;
  ern_status status = ERN_NEW(context, count, &copy);
  if (status != ERN_OK) return status;
  if (count > 0) memcpy(copy, bytes, count);
  status = ern_torch_open(context, "x.pth", copy, count, &torch);
  return status == ERN_OK ? ern_torch_tensors(context, &torch, "", file, tree) : status;
}

static ern_status open_path(ern_context *context, const char *path, struct ern_tensor_file *file, char **tree) {
  uint8_t *bytes = NULL;
  size_t count = 0;
  support_ok(context, ern_file_read(context, path, 1 << 24, &bytes, &count));
  const ern_status status = open_bytes(context, bytes, count, file, tree);
  ern_release(context, bytes);
  return status;
}

static void refused(const struct part *parts, size_t count, ern_status expected, const char *first,
                    const char *second) {
  ern_context *context = support_context();
  struct ern_tensor_file file;
  char *tree = NULL;
  make_zip("x.pth", parts, count);
  support_expect(context, open_path(context, "x.pth", &file, &tree), expected, first, second, NULL);
  ern_tensor_file_free(context, &file);
  ern_release(context, tree);
  ern_context_free(&context);
}

static void test_views(void **state) {
  (void)state;
  static const struct {
    const char *bytes;
    size_t size;
    float expected[12];
    size_t count;
  } rows[] = {{plain, sizeof plain - 1, {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11}, 12},
#define ROW(text) text, sizeof(text) - 1
              {ROW(DICT(TENSOR "K\x00K\x04K\x03\x86K\x01K\x04\x86" HOOKS)), {0, 4, 8, 1, 5, 9, 2, 6, 10, 3, 7, 11}, 12},
              {ROW(DICT(TENSOR "K\x05K\x02K\x02\x86K\x04K\x01\x86" HOOKS)), {5, 6, 9, 10}, 4},
              {ROW(DICT(TENSOR "K\x07K\x02K\x03\x86K\x00K\x00\x86" HOOKS)), {7, 7, 7, 7, 7, 7}, 6},
              {ROW(DICT(TENSOR "K\x0b))" HOOKS)), {11}, 1},
              {ROW(DICT(TENSOR "K\x63K\x00K\x03\x86K\x03K\x01\x86" HOOKS)), {0}, 0}};
  ern_context *context = support_context();
  for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
    const struct part parts[] = {{"f/data.pkl", rows[i].bytes, rows[i].size, 0},
                                 {"f/data/0", twelve, sizeof twelve, 0}};
    struct ern_tensor_file file;
    char *tree = NULL;
    make_zip("x.pth", parts, 2);
    support_ok(context, open_path(context, "x.pth", &file, &tree));
    assert_int_equal(file.tensor_count, 1);
    assert_int_equal(file.tensors[0].count, rows[i].count);
    assert_string_equal(tree, "{\"dict\":[[\"a\",{\"tensor\":\"a\"}]]}");
    if (rows[i].count > 0) assert_memory_equal(file.tensors[0].data, rows[i].expected, rows[i].count * sizeof(float));
    ern_tensor_file_free(context, &file);
    ern_release(context, tree);
  }
  ern_context_free(&context);
}

static void test_refused(void **state) {
  (void)state;
  static const char system_call[] =
      "\x80\x02"
      "cos\nsystem\nX\x02\x00\x00\x00ls\x85R.";
  static const char deep[] =
      "\x80\x02"
      "]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]]"
      "aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa.";
  static const char own[] =
      "\x80\x02]q\x00h\x00"
      "a.";
  static const char huge[] = DICT(TENSOR "K\x00J\x00\x00\x00\x40\x85K\x00\x85" HOOKS);
  const struct part pickle = {"f/data.pkl", plain, sizeof plain - 1, 0}, bytes = {"f/data/0", twelve, sizeof twelve, 0};
#define REFUSED(code, first, second, ...)                                                                             \
  refused((const struct part[]){__VA_ARGS__}, sizeof((const struct part[]){__VA_ARGS__}) / sizeof(struct part), code, \
          first, second)
  REFUSED(ERN_E_UNSUPPORTED, "os.system", "offset 2", {"f/data.pkl", system_call, sizeof system_call - 1, 0});
  REFUSED(ERN_E_SHAPE, "nested more than 32", "x.pth", {"f/data.pkl", deep, sizeof deep - 1, 0});
  REFUSED(ERN_E_SHAPE, "nested more than 32", "x.pth", {"f/data.pkl", own, sizeof own - 1, 0});
  REFUSED(ERN_E_SHAPE, "repeats its storage", "tensor a", {"f/data.pkl", huge, sizeof huge - 1, 0}, bytes);
  REFUSED(ERN_E_MISSING, "f/data/0", "no entry", pickle);
  REFUSED(ERN_E_SHAPE, "f/data/0", "44 bytes, expected 12 items", pickle, {"f/data/0", twelve, 44, 0});
  REFUSED(ERN_E_FORMAT, "data.pkl", "torch.save did not write it", bytes);
  REFUSED(ERN_E_FORMAT, "two entries data.pkl", "x.pth", pickle, {"g/data.pkl", plain, sizeof plain - 1, 0});
  REFUSED(ERN_E_UNSUPPORTED, "compressed", "f/data.pkl", {"f/data.pkl", plain, sizeof plain - 1, 1});
  REFUSED(ERN_E_UNSUPPORTED, "byteorder", "big", pickle, bytes, {"f/byteorder", "big", 3, 0});
  REFUSED(ERN_E_FORMAT, "without the opcode", "data.pkl", {"f/data.pkl", plain, sizeof plain - 2, 0}, bytes);
}

/* Any beginning of the file, and any single byte that is another one. */
static void test_damaged(void **state) {
  (void)state;
  const struct part parts[] = {{"f/data.pkl", plain, sizeof plain - 1, 0}, {"f/data/0", twelve, sizeof twelve, 0}};
  ern_context *context = support_context();
  struct ern_tensor_file file;
  uint8_t *bytes = NULL;
  char *tree = NULL;
  size_t count = 0, same = 0;
  make_zip("x.pth", parts, 2);
  support_ok(context, ern_file_read(context, "x.pth", 1 << 20, &bytes, &count));
  for (size_t i = 0; i < count; i++) assert_int_not_equal(open_bytes(context, bytes, i, &file, &tree), ERN_OK);
  for (size_t i = 0; i < count; i++) {
    bytes[i] ^= 0x55;
    if (open_bytes(context, bytes, count, &file, &tree) ==
        ERN_OK) { /* a date, a flag: what was read must be the same */
      assert_int_equal(file.tensor_count, 1);
      assert_memory_equal(file.tensors[0].data, twelve, sizeof twelve);
      same++;
    }
    ern_tensor_file_free(context, &file);
    ern_release(context, tree);
    bytes[i] ^= 0x55;
  }
  assert_true(same < count / 2);
  ern_release(context, bytes);
  ern_context_free(&context);
}

/* As PyTorch does, the reader names by place; the bytes of a tensor that is there twice are written once. */
#define TREE(x, y)                                                                                                     \
  "{\"dict\":[[\"a\",{\"tensor\":\"a\"}],[1,{\"tuple\":[1,-2,70000,5000000000,true,false,null,[]]}],[\"o\",{"          \
  "\"ordered\":[["                                                                                                     \
  "\"x\",{\"tensor\":\"" x "\"}],[\"y\",{\"tensor\":\"" y                                                              \
  "\"}]]}],[\"w\",\"\xc3\xa9\"],[\"r\",{\"bytes\":\"0080ff41\"}],["                                                    \
  "\"optimizer\",{\"dict\":[[\"lr\",0.10000000000000001],[\"n\",{\"float\":\"nan\"}],[\"i\",{\"float\":\"-inf\"}]]}]]" \
  "}"
static const char tree_text[] = TREE("h", "a"), expected_tree[] = TREE("o.x", "o.y");

static ern_status write_and_read(ern_context *context) {
  static const uint16_t half[2] = {1, 2};
  const struct ern_tensor tensors[] = {
      {.name = "a", .dtype = ERN_F32, .dims = 3, .shape = {2, 3, 2}, .count = 12, .data = twelve},
      {.name = "h", .dtype = ERN_BF16, .dims = 1, .shape = {2}, .count = 2, .data = half}};
  struct ern_tensor_file file = {0};
  uint8_t *bytes = NULL;
  size_t count = 0;
  char *tree = NULL;
  ern_status status = ern_torch_write(context, "w.pth", tree_text, tensors, 2);
  if (status == ERN_OK) status = ern_file_read(context, "w.pth", 1 << 20, &bytes, &count);
  if (status == ERN_OK) status = open_bytes(context, bytes, count, &file, &tree);
  if (status == ERN_OK) {
    assert_string_equal(tree, expected_tree);
    assert_int_equal(file.tensor_count, 3);
    assert_memory_equal(file.tensors[0].data, twelve, sizeof twelve);
    assert_int_equal(file.tensors[1].dtype, ERN_BF16);
    assert_memory_equal(file.tensors[1].data, half, sizeof half);
  }
  ern_release(context, bytes);
  ern_release(context, tree);
  ern_tensor_file_free(context, &file);
  return status;
}

static void test_round_trip(void **state) {
  (void)state;
  ern_context *context = support_context();
  support_ok(context, write_and_read(context));
  ern_context_free(&context);
}

static void test_memory(void **state) {
  (void)state;
  support_refuse_each(write_and_read);
}

static void test_bad_trees(void **state) {
  (void)state;
  static const char *const trees[] = {"{",  "{\"dict\":[[1]]}", "{\"dict\":1}", "{\"what\":[]}",
                                      "{}", "{\"a\":1,\"b\":2}"};
  ern_context *context = support_context();
  remove("bad.pth");
  for (size_t i = 0; i < sizeof trees / sizeof *trees; i++)
    support_expect(context, ern_torch_write(context, "bad.pth", trees[i], NULL, 0), ERN_E_FORMAT, "tree", NULL);
  support_expect(context, ern_torch_write(context, "bad.pth", "{\"tensor\":\"q\"}", NULL, 0), ERN_E_MISSING, "q", NULL);
  assert_null(fopen("bad.pth", "rb"));
  ern_context_free(&context);
}

static void test_kinds(void **state) {
  (void)state;
  uint8_t tar[512] = {0};
  memcpy(tar + 257, "ustar", 5);
  assert_true(ern_torch_is_tar(tar, sizeof tar));
  assert_false(ern_torch_is_tar(tar, 300));
  ern_context *context = support_context();
  struct ern_tensor_file file;
  char *tree = NULL;
  assert_true(ern_torch_is_torch(tar, sizeof tar));
  support_expect(context, open_bytes(context, tar, sizeof tar, &file, &tree), ERN_E_UNSUPPORTED, "x.pth: is a tar",
                 NULL);
  ern_context_free(&context);
  assert_true(ern_torch_is_zip((const uint8_t *)"PK\3\4", 4));
  assert_false(ern_torch_is_zip((const uint8_t *)"PK\3", 3));
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_views),   cmocka_unit_test(test_refused),
                                     cmocka_unit_test(test_damaged), cmocka_unit_test(test_round_trip),
                                     cmocka_unit_test(test_memory),  cmocka_unit_test(test_bad_trees),
                                     cmocka_unit_test(test_kinds)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
