/* SPDX-License-Identifier: MIT
 * safetensors: round trips, foreign files, and headers that lie about lengths, offsets, names and types. */
#include "../support.h"

#include <math.h>
#include <signal.h>
#include <sys/resource.h>
#include <unistd.h>

#include "io/safetensors.h"

/* Writes length, header text and `data_bytes` bytes 0, 1, 2 ... */
static void write_raw(const char *path, uint64_t length, const char *header, size_t data_bytes) {
  uint8_t file[2048];
  const size_t text = strlen(header);
  assert_true(8 + text + data_bytes <= sizeof file);
  for (int i = 0; i < 8; i++) file[i] = (uint8_t)(length >> (8 * i));
  memcpy(file + 8, header, text);
  for (size_t i = 0; i < data_bytes; i++) file[8 + text + i] = (uint8_t)i;
  support_write(path, file, 8 + text + data_bytes);
}

static void write_header(const char *path, const char *header, size_t data_bytes) {
  write_raw(path, strlen(header), header, data_bytes);
}

static void test_round_trip(void **state) {
  (void)state;
  ern_context *context = support_context();
  struct ern_tensor_file file;
  const float weights[6] = {1, -2, 3.5f, 0, INFINITY, 1e-40f};
  const uint8_t bits[3] = {1, 128, 255};
  const int64_t step = INT64_MIN;
  const double truth = 0.1;
  const int32_t ids[2] = {-1, 7};
  const struct ern_tensor tensors[] = {
      {"z.bits", ERN_U8, 1, {3}, 3, 0, bits},       {"net.0.weight", ERN_F32, 2, {2, 3}, 6, 0, weights},
      {"step", ERN_I64, 0, {0}, 1, 0, &step},       {"nothing", ERN_F16, 2, {0, 5}, 0, 0, weights},
      {"truth", ERN_F64, 1, {1}, 1, 0, &truth},     {"ids \"\xc3\xa9\"", ERN_I32, 1, {2}, 2, 0, ids},
      {"flags", ERN_BOOL, 3, {1, 1, 2}, 2, 0, bits}};
  const size_t count = sizeof tensors / sizeof tensors[0];
  const struct ern_metadata metadata[] = {{"format", "pt"}, {"consent", "line one\nline \"two\""}};
  assert_int_equal(
      ern_safetensors_write(context, "round.safetensors", tensors, count, metadata, 2, ERN_EXISTING_BY_CONTEXT),
      ERN_OK);
  support_expect(context, ern_safetensors_read(context, "round.safetensors", &file), ERN_OK, NULL);
  assert_int_equal(file.tensor_count, count);
  assert_int_equal(file.metadata_count, 2);
  assert_string_equal(ern_tensor_file_metadata(&file, "consent"), metadata[1].value);
  assert_null(ern_tensor_file_metadata(&file, "absent"));
  assert_null(ern_tensor_file_find(&file, "absent"));
  assert_string_equal(file.tensors[0].name, "z.bits"); /* by place, not by name */
  for (size_t i = 0; i < count; i++) {
    const struct ern_tensor *found = ern_tensor_file_find(&file, tensors[i].name);
    assert_non_null(found);
    assert_int_equal(found->dtype, tensors[i].dtype);
    assert_int_equal(found->dims, tensors[i].dims);
    for (int k = 0; k < found->dims; k++) assert_int_equal(found->shape[k], tensors[i].shape[k]);
    assert_int_equal(found->count, tensors[i].count);
    assert_int_equal((uintptr_t)found->data % ern_dtype_bytes(found->dtype), 0);
    assert_memory_equal(found->data, tensors[i].data, found->count * ern_dtype_bytes(found->dtype));
  }
  ern_tensor_file_free(context, &file);
  assert_null(file.tensors);
  ern_tensor_file_free(context, &file);
  ern_tensor_file_free(context, NULL);

  assert_int_equal(ern_safetensors_write(context, "none.safetensors", NULL, 0, NULL, 0, ERN_EXISTING_BY_CONTEXT),
                   ERN_OK);
  support_expect(context, ern_safetensors_read(context, "none.safetensors", &file), ERN_OK, NULL);
  assert_int_equal(file.tensor_count, 0);
  assert_int_equal(file.metadata_count, 0);
  ern_tensor_file_free(context, &file);
  ern_context_free(&context);
}

static void test_to_float(void **state) {
  (void)state;
  ern_context *context = support_context();
  const uint16_t halves[2] = {0x3e00, 0xfc00}, brains[2] = {0x3fc0, 0xff80};
  const double doubles[2] = {1.5, -INFINITY};
  const float floats[2] = {1.5f, -INFINITY};
  const struct ern_tensor tensors[] = {{"a", ERN_F16, 1, {2}, 2, 0, halves},
                                       {"b", ERN_BF16, 1, {2}, 2, 0, brains},
                                       {"c", ERN_F64, 1, {2}, 2, 0, doubles},
                                       {"d", ERN_F32, 1, {2}, 2, 0, floats}};
  for (int i = 0; i < 4; i++) {
    float out[3] = {0, 0, 42};
    assert_int_equal(ern_tensor_to_float(context, &tensors[i], out), ERN_OK);
    assert_true(out[0] == 1.5f && out[1] == -INFINITY && out[2] == 42);
  }
  const struct ern_tensor whole = {"bitfield", ERN_U8, 1, {2}, 2, 0, halves};
  float out[2];
  support_expect(context, ern_tensor_to_float(context, &whole, out), ERN_E_MISMATCH, "bitfield", "U8", "F32", NULL);
  assert_string_equal(ern_dtype_name(ERN_BF16), "BF16");
  ern_context_free(&context);
}

/* Legal, though no writer of ours makes it: tensors out of order in the header, unaligned in the file, unknown keys. */
static void test_foreign(void **state) {
  (void)state;
  ern_context *context = support_context();
  struct ern_tensor_file file;
  write_header("foreign.safetensors",
               "{\"b\":{\"dtype\":\"F32\",\"shape\":[2],\"data_offsets\":[1,9],\"note\":1},"
               "\"c\":{\"dtype\":\"I64\",\"shape\":[],\"data_offsets\":[9,17]},"
               "\"a\":{\"dtype\":\"U8\",\"shape\":[1],\"data_offsets\":[0,1]}}   ",
               17);
  support_expect(context, ern_safetensors_read(context, "foreign.safetensors", &file), ERN_OK, NULL);
  assert_int_equal(file.tensor_count, 3);
  assert_string_equal(file.tensors[0].name, "a");
  assert_string_equal(file.tensors[1].name, "b");
  assert_string_equal(file.tensors[2].name, "c");
  for (size_t i = 0; i < 3; i++) {
    const struct ern_tensor *tensor = &file.tensors[i];
    assert_int_equal((uintptr_t)tensor->data % ern_dtype_bytes(tensor->dtype), 0);
  }
  const uint8_t b[8] = {1, 2, 3, 4, 5, 6, 7, 8}, c[8] = {9, 10, 11, 12, 13, 14, 15, 16};
  assert_memory_equal(file.tensors[1].data, b, sizeof b);
  assert_memory_equal(file.tensors[2].data, c, sizeof c);
  ern_tensor_file_free(context, &file);
  ern_context_free(&context);
}

#define ENTRY(name, dtype, shape, offsets) \
  "\"" name "\":{\"dtype\":\"" dtype "\",\"shape\":" shape ",\"data_offsets\":" offsets "}"

static void test_bad(void **state) {
  (void)state;
  ern_context *context = support_context();
  static const struct {
    const char *header; /* before 16 bytes of data */
    ern_status status;
    const char *words[2];
  } cases[] = {
      {"", ERN_E_FORMAT, {"header", ""}},
      {"[]", ERN_E_FORMAT, {"no JSON object", ""}},
      {"{\"a\":", ERN_E_FORMAT, {"header: ", "at byte"}},
      {"{} x", ERN_E_FORMAT, {"header: ", "end of file expected"}},
      {"{}", ERN_E_FORMAT, {"hold 0 bytes", "found 16"}},
      {"{\"a\":3}", ERN_E_FORMAT, {"tensor a", "no object"}},
      {"{" ENTRY("", "U8", "[16]", "[0,16]") "}", ERN_E_FORMAT, {"empty name", ""}},
      {"{\"a\":{\"shape\":[16],\"data_offsets\":[0,16]}}", ERN_E_FORMAT, {"tensor a", "dtype is missing"}},
      {"{\"a\":{\"dtype\":7,\"shape\":[16],\"data_offsets\":[0,16]}}", ERN_E_FORMAT, {"tensor a", "no string"}},
      {"{" ENTRY("a", "F8_E4M3", "[16]", "[0,16]") "}", ERN_E_UNSUPPORTED, {"tensor a", "dtype is F8_E4M3"}},
      {"{\"a\":{\"dtype\":\"U8\",\"data_offsets\":[0,16]}}", ERN_E_FORMAT, {"tensor a", "shape is missing"}},
      {"{" ENTRY("a", "U8", "16", "[0,16]") "}", ERN_E_FORMAT, {"tensor a", "no list"}},
      {"{" ENTRY("a", "U8", "[1,1,1,1,16]", "[0,16]") "}", ERN_E_SHAPE, {"tensor a", "5 sizes"}},
      {"{" ENTRY("a", "U8", "[-16]", "[0,16]") "}", ERN_E_FORMAT, {"tensor a", "shape[0]"}},
      {"{" ENTRY("a", "U8", "[16.0]", "[0,16]") "}", ERN_E_FORMAT, {"tensor a", "shape[0]"}},
      {"{" ENTRY("a", "U8", "[4611686018427387904,4611686018427387904]", "[0,16]") "}",
       ERN_E_FORMAT,
       {"tensor a", "shape[1]"}},
      {"{" ENTRY("a", "F64", "[2305843009213693954]", "[0,16]") "}", ERN_E_FORMAT, {"tensor a", "hold 16 bytes"}},
      {"{" ENTRY("a", "U8", "[99999999999999999999]", "[0,16]") "}", ERN_E_FORMAT, {"too big integer", ""}},
      {"{\"a\":{\"dtype\":\"U8\",\"shape\":[16]}}", ERN_E_FORMAT, {"tensor a", "data_offsets is no pair"}},
      {"{" ENTRY("a", "U8", "[16]", "[0,16,16]") "}", ERN_E_FORMAT, {"tensor a", "no pair"}},
      {"{" ENTRY("a", "U8", "[16]", "[0,\"16\"]") "}", ERN_E_FORMAT, {"tensor a", "no pair"}},
      {"{" ENTRY("a", "U8", "[16]", "[-1,15]") "}", ERN_E_FORMAT, {"tensor a", "no pair"}},
      {"{" ENTRY("a", "U8", "[17]", "[0,17]") "}",
       ERN_E_FORMAT,
       {"tensor a", "[0, 17], expected rising and at most 16"}},
      {"{" ENTRY("a", "U8", "[16]", "[16,0]") "}", ERN_E_FORMAT, {"tensor a", "[16, 0], expected rising"}},
      {"{" ENTRY("a", "F32", "[3]", "[0,16]") "}", ERN_E_FORMAT, {"tensor a", "16 bytes, expected 3 items of 4"}},
      {"{" ENTRY("a", "U8", "[8]", "[0,8]") "}", ERN_E_FORMAT, {"hold 8 bytes", "found 16"}},
      {"{" ENTRY("a", "U8", "[8]", "[8,16]") "}", ERN_E_FORMAT, {"tensor a", "gap"}},
      {"{" ENTRY("a", "U8", "[6]", "[0,6]") "," ENTRY("b", "U8", "[8]", "[8,16]") "}",
       ERN_E_FORMAT,
       {"tensor b", "begin at 8, expected 6: there is a gap"}},
      {"{" ENTRY("a", "U8", "[9]", "[0,9]") "," ENTRY("b", "U8", "[8]", "[8,16]") "}",
       ERN_E_FORMAT,
       {"tensor b", "begin at 8, expected 9: it overlaps"}},
      {"{" ENTRY("a", "U8", "[16]", "[0,16]") "," ENTRY("b", "U8", "[16]", "[0,16]") "}",
       ERN_E_FORMAT,
       {"tensor b", "overlaps"}},
      {"{" ENTRY("a", "U8", "[8]", "[0,8]") "," ENTRY("a", "U8", "[8]", "[8,16]") "}",
       ERN_E_FORMAT,
       {"duplicate", "a"}},
      {"{\"__metadata__\":3," ENTRY("a", "U8", "[16]", "[0,16]") "}", ERN_E_FORMAT, {"__metadata__", "no object"}},
      {"{\"__metadata__\":{\"k\":3}," ENTRY("a", "U8", "[16]", "[0,16]") "}", ERN_E_FORMAT, {"__metadata__: k", ""}},
      {"{\"\xff\":{}}", ERN_E_FORMAT, {"header: ", "decode"}}};
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    struct ern_tensor_file file;
    write_header("bad.safetensors", cases[i].header, 16);
    support_expect(context, ern_safetensors_read(context, "bad.safetensors", &file), cases[i].status, "bad.safetensors",
                   cases[i].words[0], cases[i].words[1], NULL);
    assert_null(file.tensors);
    assert_null(file.private_data);
  }
  ern_context_free(&context);
}

static void test_bad_lengths(void **state) {
  (void)state;
  ern_context *context = support_context();
  struct ern_tensor_file file;
  const char header[] = "{" ENTRY("a", "U8", "[4]", "[0,4]") "}";
  write_raw("long.safetensors", UINT64_C(1) << 63, header, 4);
  support_expect(context, ern_safetensors_read(context, "long.safetensors", &file), ERN_E_FORMAT, "long.safetensors",
                 "header length is 9223372036854775808", NULL);
  write_raw("long.safetensors", UINT64_MAX, header, 4);
  support_expect(context, ern_safetensors_read(context, "long.safetensors", &file), ERN_E_FORMAT, "long.safetensors",
                 "header length is 18446744073709551615", NULL);
  write_raw("long.safetensors", strlen(header) + 5, header, 4);
  support_expect(context, ern_safetensors_read(context, "long.safetensors", &file), ERN_E_FORMAT, "long.safetensors",
                 "header length is", "expected at most", NULL);
  /* a good file cut at every length */
  uint8_t whole[256];
  write_header("whole.safetensors", header, 4);
  FILE *stream = fopen("whole.safetensors", "rb");
  assert_non_null(stream);
  const size_t size = fread(whole, 1, sizeof whole, stream);
  fclose(stream);
  support_expect(context, ern_safetensors_read(context, "whole.safetensors", &file), ERN_OK, NULL);
  ern_tensor_file_free(context, &file);
  for (size_t length = 0; length < size; length++) {
    support_write("cut.safetensors", whole, length);
    support_expect(context, ern_safetensors_read(context, "cut.safetensors", &file), ERN_E_FORMAT, "cut.safetensors",
                   NULL);
  }
  support_expect(context, ern_safetensors_read(context, "absent.safetensors", &file), ERN_E_MISSING,
                 "absent.safetensors", NULL);
  ern_context_free(&context);
}

static void test_write_refused(void **state) {
  (void)state;
  ern_context *context = support_context();
  const float data[2] = {1, 2};
  const struct ern_tensor good = {"a", ERN_F32, 1, {2}, 2, 0, data};
  const struct ern_tensor twice[2] = {good, good};
  const struct ern_tensor wrong = {"w", ERN_F32, 1, {3}, 2, 0, data},
                          reserved = {"__metadata__", ERN_F32, 1, {2}, 2, 0, data};
  const struct ern_tensor latin = {"\xe9", ERN_F32, 1, {2}, 2, 0, data};
  const struct ern_metadata same[2] = {{"k", "1"}, {"k", "2"}};
  support_clear("o.safetensors");
  support_expect(context, ern_safetensors_write(context, "o.safetensors", twice, 2, NULL, 0, ERN_EXISTING_BY_CONTEXT),
                 ERN_E_ARGUMENT, "o.safetensors", "\"a\"", "twice", NULL);
  support_expect(context, ern_safetensors_write(context, "o.safetensors", &wrong, 1, NULL, 0, ERN_EXISTING_BY_CONTEXT),
                 ERN_E_ARGUMENT, "tensor w", "count is 2, expected 3", NULL);
  support_expect(context,
                 ern_safetensors_write(context, "o.safetensors", &reserved, 1, NULL, 0, ERN_EXISTING_BY_CONTEXT),
                 ERN_E_ARGUMENT, "__metadata__", "reserved", NULL);
  support_expect(context, ern_safetensors_write(context, "o.safetensors", &latin, 1, NULL, 0, ERN_EXISTING_BY_CONTEXT),
                 ERN_E_ARGUMENT, "UTF-8", NULL);
  support_expect(context, ern_safetensors_write(context, "o.safetensors", &good, 1, same, 2, ERN_EXISTING_BY_CONTEXT),
                 ERN_E_ARGUMENT, "__metadata__", "\"k\"", NULL);
  support_expect(context,
                 ern_safetensors_write(context, "no/o.safetensors", &good, 1, NULL, 0, ERN_EXISTING_BY_CONTEXT),
                 ERN_E_MISSING, "no/o.safetensors", NULL);
  assert_int_not_equal(access("o.safetensors", F_OK), 0);

  /* a full disk: the old file stays whole */
  struct ern_tensor_file file;
  static const float many[4096];
  const struct ern_tensor large = {"a", ERN_F32, 1, {4096}, 4096, 0, many};
  struct rlimit before, tiny;
  assert_int_equal(ern_safetensors_write(context, "o.safetensors", &good, 1, NULL, 0, ERN_EXISTING_BY_CONTEXT), ERN_OK);
  signal(SIGXFSZ, SIG_IGN);
  assert_int_equal(getrlimit(RLIMIT_FSIZE, &before), 0);
  tiny = before;
  tiny.rlim_cur = 5000;
  assert_int_equal(setrlimit(RLIMIT_FSIZE, &tiny), 0);
  const ern_status status =
      ern_safetensors_write(context, "o.safetensors", &large, 1, NULL, 0, ERN_EXISTING_BY_CONTEXT);
  assert_int_equal(setrlimit(RLIMIT_FSIZE, &before), 0);
  support_expect(context, status, ERN_E_IO, "o.safetensors", "File too large", NULL);
  support_expect(context, ern_safetensors_read(context, "o.safetensors", &file), ERN_OK, NULL);
  assert_int_equal(file.tensors[0].count, 2);
  ern_tensor_file_free(context, &file);
  ern_context_free(&context);
}

static ern_status write_and_read(ern_context *context) {
  struct ern_tensor_file file = {0};
  const uint8_t data[16] = {1};
  const struct ern_tensor tensors[] = {{"a", ERN_U8, 1, {3}, 3, 0, data}, {"b", ERN_F32, 1, {2}, 2, 0, data}};
  const struct ern_metadata metadata = {"k", "v"};
  ern_status status =
      ern_safetensors_write(context, "refused.safetensors", tensors, 2, &metadata, 1, ERN_EXISTING_BY_CONTEXT);
  if (status == ERN_OK) status = ern_safetensors_read(context, "refused.safetensors", &file);
  ern_tensor_file_free(context, &file);
  return status;
}

static void test_no_memory(void **state) {
  (void)state;
  support_refuse_each(write_and_read);
}

static void test_real(void **state) {
  (void)state;
  support_needs_shared();
  ern_context *context = support_context();
  static const char *const names[] = {"parity/head.safetensors", "parity/head_torso.safetensors"};
  for (size_t i = 0; i < 2; i++) {
    char path[1024];
    struct ern_tensor_file file, again;
    support_shared(names[i], path);
    support_expect(context, ern_safetensors_read(context, path, &file), ERN_OK, NULL);
    assert_string_equal(ern_tensor_file_metadata(&file, "format"), "pt");
    const struct ern_tensor *bits = ern_tensor_file_find(&file, "density_bitfield");
    assert_non_null(bits);
    assert_int_equal(bits->dtype, ERN_U8);
    assert_int_equal(bits->count, 262144);
    assert_int_equal(ern_safetensors_write(context, "copy.safetensors", file.tensors, file.tensor_count, file.metadata,
                                           file.metadata_count, ERN_EXISTING_BY_CONTEXT),
                     ERN_OK);
    support_expect(context, ern_safetensors_read(context, "copy.safetensors", &again), ERN_OK, NULL);
    assert_int_equal(again.tensor_count, file.tensor_count);
    for (size_t k = 0; k < file.tensor_count; k++) {
      assert_string_equal(again.tensors[k].name, file.tensors[k].name);
      assert_memory_equal(again.tensors[k].data, file.tensors[k].data,
                          file.tensors[k].count * ern_dtype_bytes(file.tensors[k].dtype));
    }
    ern_tensor_file_free(context, &again);
    ern_tensor_file_free(context, &file);
  }
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_round_trip),  cmocka_unit_test(test_to_float),
                                     cmocka_unit_test(test_foreign),     cmocka_unit_test(test_bad),
                                     cmocka_unit_test(test_bad_lengths), cmocka_unit_test(test_write_refused),
                                     cmocka_unit_test(test_no_memory),   cmocka_unit_test(test_real)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
