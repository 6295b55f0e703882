/* SPDX-License-Identifier: MIT
 * .npy files and speech features: every type, every version, and every way a file can lie. */
#include "../support.h"

#include <math.h>

#include "core/memory.h"
#include "ernerf/data.h"
#include "io/half.h"
#include "io/npy.h"

/* Writes a version-1 file of this header text and these bytes. */
static void write_npy(const char *path, const char *header, const void *data, size_t bytes) {
  char file[2048] = "\x93NUMPY\x01";
  const size_t length = strlen(header);
  assert_true(10 + length + bytes <= sizeof file);
  file[7] = 0;
  file[8] = (char)(length & 255);
  file[9] = (char)(length >> 8);
  memcpy(file + 10, header, length);
  memcpy(file + 10 + length, data, bytes);
  support_write(path, file, 10 + length + bytes);
}

static void test_types(void **state) {
  (void)state;
  ern_context *context = support_context();
  struct ern_npy array;
  const double doubles[] = {1.5, -2.25, 1e-3};
  write_npy("f8.npy", "{'descr': '<f8', 'fortran_order': False, 'shape': (3,), }     \n", doubles, sizeof doubles);
  assert_int_equal(ern_npy_read(context, "f8.npy", &array), ERN_OK);
  assert_int_equal(array.type, ERN_NPY_F64);
  assert_int_equal(array.dims, 1);
  assert_int_equal(array.count, 3);
  for (int i = 0; i < 3; i++) assert_true(((float *)array.data)[i] == (float)doubles[i]);
  ern_npy_free(context, &array);
  assert_null(array.data);

  const uint16_t halves[] = {0x3c00, 0xc000, 0x0001, 0x7bff, 0x7c00, 0x8000};
  const float expected[] = {1.0f, -2.0f, 0x1p-24f, 65504.0f, INFINITY, -0.0f};
  write_npy("f2.npy", "{\"shape\": (2, 3), 'fortran_order':False, 'descr': '<f2'}", halves, sizeof halves);
  assert_int_equal(ern_npy_read(context, "f2.npy", &array), ERN_OK);
  assert_int_equal(array.type, ERN_NPY_F16);
  assert_int_equal(array.shape[0], 2);
  assert_int_equal(array.shape[1], 3);
  assert_memory_equal(array.data, expected, sizeof expected);
  ern_npy_free(context, &array);

  const int64_t longs[] = {-1, INT64_MAX};
  write_npy("i8.npy", "{'descr': '<i8', 'fortran_order': False, 'shape': (2L, 1L), }", longs, sizeof longs);
  assert_int_equal(ern_npy_read(context, "i8.npy", &array), ERN_OK);
  assert_int_equal(array.type, ERN_NPY_I64);
  assert_memory_equal(array.data, longs, sizeof longs);
  ern_npy_free(context, &array);

  const int32_t ints[] = {-7};
  write_npy("i4.npy", "{'descr': '<i4', 'fortran_order': False, 'shape': (), }", ints, sizeof ints);
  assert_int_equal(ern_npy_read(context, "i4.npy", &array), ERN_OK);
  assert_int_equal(array.dims, 0);
  assert_int_equal(array.count, 1);
  assert_memory_equal(array.data, ints, sizeof ints);
  ern_npy_free(context, &array);

  write_npy("u1.npy", "{'descr': '|u1', 'fortran_order': False, 'shape': (2, 0), }", "", 0);
  assert_int_equal(ern_npy_read(context, "u1.npy", &array), ERN_OK);
  assert_int_equal(array.count, 0);
  ern_npy_free(context, &array);
  ern_npy_free(context, NULL);
  ern_context_free(&context);
}

/* Every finite half against its value from the definition, (-1)^s 2^(e-15) (1 + f/1024). */
static void test_half(void **state) {
  (void)state;
  for (unsigned bits = 0; bits < 0x7c00; bits++) {
    const int exponent = (int)(bits >> 10);
    const double fraction = (double)(bits & 1023) / 1024;
    const double value = exponent == 0 ? ldexp(fraction, -14) : ldexp(1 + fraction, exponent - 15);
    assert_true((double)ern_half_to_float((uint16_t)bits) == value);
    assert_true((double)ern_half_to_float((uint16_t)(bits | 0x8000)) == -value);
  }
  assert_true(isnan(ern_half_to_float(0x7e01)));
  assert_true(ern_half_to_float(0xfc00) == -INFINITY);
  assert_true(ern_bfloat16_to_float(0x3fc0) == 1.5f);
}

static void test_versions(void **state) {
  (void)state;
  ern_context *context = support_context();
  struct ern_npy array;
  const char header[] = "{'descr': '<f4', 'fortran_order': False, 'shape': (1,)}\n";
  for (int version = 2; version <= 3; version++) {
    char file[256] = "\x93NUMPY";
    const float value = 4.0f;
    const size_t length = strlen(header);
    file[6] = (char)version;
    file[8] = (char)length;
    memcpy(file + 12, header, length);
    memcpy(file + 12 + length, &value, sizeof value);
    support_write("v.npy", file, 12 + length + sizeof value);
    assert_int_equal(ern_npy_read(context, "v.npy", &array), ERN_OK);
    assert_true(*(float *)array.data == 4.0f);
    ern_npy_free(context, &array);
    file[11] = (char)0x80; /* a header of 2 GB */
    support_write("v.npy", file, 12 + length + sizeof value);
    support_expect(context, ern_npy_read(context, "v.npy", &array), ERN_E_FORMAT, "v.npy",
                   "header length is 2147483704", NULL);
    support_write("v.npy", file, 11);
    support_expect(context, ern_npy_read(context, "v.npy", &array), ERN_E_FORMAT, "v.npy", "header's length", NULL);
  }
  ern_context_free(&context);
}

static void test_refused_headers(void **state) {
  (void)state;
  ern_context *context = support_context();
  static const struct {
    const char *header;
    ern_status status;
    const char *word;
  } cases[] = {
      {"{'descr': '<f4', 'fortran_order': True, 'shape': (2,), }", ERN_E_UNSUPPORTED, "fortran_order is True"},
      {"{'descr': '>f4', 'fortran_order': False, 'shape': (2,), }", ERN_E_UNSUPPORTED, "'>f4' (big endian)"},
      {"{'descr': '|O', 'fortran_order': False, 'shape': (2,), }", ERN_E_UNSUPPORTED, "'|O' (pickled Python objects)"},
      {"{'descr': '<c8', 'fortran_order': False, 'shape': (1,), }", ERN_E_UNSUPPORTED, "descr is '<c8'"},
      {"{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (2,), }", ERN_E_UNSUPPORTED, "descr is a structure"},
      {"{'descr': '<f4', 'fortran_order': False, 'shape': (3,), }", ERN_E_FORMAT, "claims 3 items of 4 bytes, found 8"},
      {"{'descr': '<f4', 'fortran_order': False, 'shape': (1,), }", ERN_E_FORMAT, "claims 1 items of 4 bytes, found 8"},
      {"{'descr': '<f4', 'fortran_order': False, 'shape': (4611686018427387906,), }", ERN_E_FORMAT, "claims"},
      {"{'descr': '<f4', 'fortran_order': False, 'shape': (9223372036854775808, 2, 2), }", ERN_E_FORMAT,
       "past the end"},
      {"{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999999999999,), }", ERN_E_FORMAT, "fits 64 bits"},
      {"{'descr': '<f4', 'fortran_order': False, 'shape': (-2,), }", ERN_E_FORMAT, "a size of shape"},
      {"{'descr': '<f4', 'fortran_order': False, 'shape': (1, 1, 1, 1, 2), }", ERN_E_SHAPE, "more than 4 sizes"},
      {"{'descr': '<f4', 'fortran_order': False, 'shape': (2 }", ERN_E_FORMAT, "in shape"},
      {"{'descr': '<f4', 'fortran_order': False, 'shape': 2, }", ERN_E_FORMAT, "the shape as a tuple"},
      {"{'descr': '<f4', 'fortran_order': 0, 'shape': (2,), }", ERN_E_FORMAT, "fortran_order as True or False"},
      {"{'descr': 4, 'fortran_order': False, 'shape': (2,), }", ERN_E_FORMAT, "a quoted word"},
      {"{'descr': '<f4, 'fortran_order: False, shape: (2,), }", ERN_E_FORMAT, "header: found"},
      {"{'descr': '<f4', 'fortran_order': False}", ERN_E_FORMAT, "shape is missing"},
      {"{'fortran_order': False, 'shape': (2,)}", ERN_E_FORMAT, "descr is missing"},
      {"{'descr': '<f4', 'shape': (2,)}", ERN_E_FORMAT, "fortran_order is missing"},
      {"{'descr': '<f4', 'descr': '<f4', 'fortran_order': False, 'shape': (2,)}", ERN_E_FORMAT, "second key 'descr'"},
      {"{'descr': '<f4', 'fortran_order': False, 'shape': (2,), 'extra': 1}", ERN_E_FORMAT, "unknown key 'extra'"},
      {"{'descr': '<f4', 'fortran_order': False, 'shape': (2,)} x", ERN_E_FORMAT, "the end of the header"},
      {"{'descr': '<f4' 'fortran_order': False, 'shape': (2,)}", ERN_E_FORMAT, "\",\" or \"}\""},
      {"{'descr' '<f4'}", ERN_E_FORMAT, "\":\""},
      {"", ERN_E_FORMAT, "\"{\""},
      {"{", ERN_E_FORMAT, "a quoted word"}};
  const float data[2] = {1, 2};
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    struct ern_npy array;
    write_npy("bad.npy", cases[i].header, data, sizeof data);
    support_expect(context, ern_npy_read(context, "bad.npy", &array), cases[i].status, "bad.npy", cases[i].word, NULL);
    assert_null(array.data);
  }
  ern_context_free(&context);
}

/* A good file cut at every length, and with every byte of its header changed, is refused or read, never worse. */
static void test_cut_and_changed(void **state) {
  (void)state;
  ern_context *context = support_context();
  struct ern_npy array;
  const float data[2] = {1, 2};
  uint8_t whole[128];
  write_npy("good.npy", "{'descr': '<f4', 'fortran_order': False, 'shape': (2,), }\n", data, sizeof data);
  FILE *file = fopen("good.npy", "rb");
  assert_non_null(file);
  const size_t size = fread(whole, 1, sizeof whole, file);
  fclose(file);
  for (size_t length = 0; length < size; length++) {
    support_write("cut.npy", whole, length);
    support_expect(context, ern_npy_read(context, "cut.npy", &array), ERN_E_FORMAT, "cut.npy", NULL);
  }
  for (size_t at = 0; at < size - sizeof data; at++) {
    for (int to = 0; to < 256; to += 5) {
      const uint8_t kept = whole[at];
      whole[at] = (uint8_t)to;
      support_write("changed.npy", whole, size);
      const ern_status status = ern_npy_read(context, "changed.npy", &array);
      if (status == ERN_OK) assert_true(array.count <= 8);
      ern_npy_free(context, &array);
      whole[at] = kept;
    }
  }
  support_write_text("text.npy", "<html>404 not found</html>");
  support_expect(context, ern_npy_read(context, "text.npy", &array), ERN_E_FORMAT, "text.npy", "no .npy file", NULL);
  support_write("v9.npy", "\x93NUMPY\x09\x00\x00\x00", 10);
  support_expect(context, ern_npy_read(context, "v9.npy", &array), ERN_E_UNSUPPORTED, "v9.npy", "version is 9", NULL);
  ern_context_free(&context);
}

static void test_write(void **state) {
  (void)state;
  ern_context *context = support_context();
  struct ern_npy array;
  const float data[6] = {0, 1, 2, 3, 4, -5};
  const size_t shape[4] = {1, 3, 2, 1};
  for (int dims = 3; dims <= 4; dims++) {
    assert_int_equal(ern_npy_write_f32(context, "w.npy", data, dims, shape), ERN_OK);
    assert_int_equal(ern_npy_read(context, "w.npy", &array), ERN_OK);
    assert_int_equal(array.dims, dims);
    assert_memory_equal(array.shape, shape, sizeof(size_t) * (size_t)dims);
    assert_memory_equal(array.data, data, sizeof data);
    ern_npy_free(context, &array);
  }
  uint8_t start[16];
  FILE *file = fopen("w.npy", "rb");
  assert_non_null(file);
  assert_int_equal(fread(start, 1, sizeof start, file), sizeof start);
  fseek(file, 0, SEEK_END);
  assert_int_equal(ftell(file), 128 + 24);
  fclose(file);
  assert_int_equal((start[8] | start[9] << 8) + 10, 128); /* the data is aligned to 64 bytes */
  support_expect(context, ern_npy_write_f32(context, "w.npy", data, 5, shape), ERN_E_ARGUMENT, "w.npy", "5 dimensions",
                 NULL);
  support_expect(context, ern_npy_write_f32(context, "absent/w.npy", data, 1, shape), ERN_E_MISSING, "absent/w.npy",
                 NULL);
  const size_t huge[2] = {SIZE_MAX / 2, 3};
  support_expect(context, ern_npy_write_f32(context, "w.npy", data, 2, huge), ERN_E_ARGUMENT, "w.npy", "memory", NULL);
  ern_context_free(&context);
}

static void test_features(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_features features;
  float data[32] = {0};
  static const struct {
    const char *header;
    size_t bytes;
    ern_status status;
    const char *word;
  } cases[] = {
      {"{'descr': '<f4', 'fortran_order': False, 'shape': (2, 16)}", 128, ERN_E_SHAPE, "has 2 sizes, expected 3"},
      {"{'descr': '<f4', 'fortran_order': False, 'shape': (0, 16, 1)}", 0, ERN_E_SHAPE,
       "[0, 16, 1], expected [T, 1..16"},
      {"{'descr': '<f4', 'fortran_order': False, 'shape': (1, 17, 1)}", 68, ERN_E_SHAPE, "[1, 17, 1]"},
      {"{'descr': '<f4', 'fortran_order': False, 'shape': (1, 0, 1)}", 0, ERN_E_SHAPE, "[1, 0, 1]"},
      {"{'descr': '<f4', 'fortran_order': False, 'shape': (2, 16, 0)}", 0, ERN_E_SHAPE, "[2, 16, 0]"},
      {"{'descr': '<i8', 'fortran_order': False, 'shape': (1, 2, 8)}", 128, ERN_E_UNSUPPORTED, "whole numbers"}};
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    write_npy("features.npy", cases[i].header, data, cases[i].bytes);
    support_expect(context, ern_features_load(context, "features.npy", &features), cases[i].status, "features.npy",
                   cases[i].word, NULL);
    assert_null(features.data);
  }
  const char two[] = "{'descr': '<f4', 'fortran_order': False, 'shape': (4, 2, 4)}";
  write_npy("features.npy", two, data, sizeof data);
  assert_int_equal(ern_features_load(context, "features.npy", &features), ERN_OK);
  assert_int_equal(features.windows, 4);
  assert_int_equal(features.window_length, 2);
  assert_int_equal(features.width, 4);
  ern_features_free(context, &features);
  data[8 + 4 + 3] = NAN;
  write_npy("features.npy", two, data, sizeof data);
  support_expect(context, ern_features_load(context, "features.npy", &features), ERN_E_NONFINITE, "features.npy",
                 "[1, 1, 3] is nan", NULL);
  data[8 + 4 + 3] = -1.5e30f; /* a number, of no speech, whose sums would be infinite */
  write_npy("features.npy", two, data, sizeof data);
  support_expect(context, ern_features_load(context, "features.npy", &features), ERN_E_FORMAT, "features.npy",
                 "[1, 1, 3] is -1.5e+30", "-1e30 to 1e30", NULL);
  const double large[2] = {0, 1e300}; /* finite, not a finite float32 */
  write_npy("large.npy", "{'descr': '<f8', 'fortran_order': False, 'shape': (1, 1, 2)}", large, sizeof large);
  support_expect(context, ern_features_load(context, "large.npy", &features), ERN_E_NONFINITE, "large.npy",
                 "[0, 0, 1] is inf", NULL);
  support_expect(context, ern_features_load(context, "none.npy", &features), ERN_E_MISSING, "none.npy", NULL);
  ern_features_free(context, &features);
  ern_features_free(context, NULL);
  ern_context_free(&context);
}

static void test_real_features(void **state) {
  (void)state;
  support_needs_shared();
  static const struct {
    const char *name;
    size_t windows;
    int width;
  } cases[] = {{"real/deepspeech/acapella.npy", 0, 29},
               {"real/deepspeech/speech.npy", 0, 29},
               {"real/presenter/aud_eo.npy", 220, 44},
               {"parity/clip/aud_ds.npy", 66, 29}};
  ern_context *context = support_context();
  for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
    char path[1024];
    ern_features features;
    support_shared(cases[i].name, path);
    assert_int_equal(ern_features_load(context, path, &features), ERN_OK);
    if (cases[i].windows > 0) assert_int_equal(features.windows, cases[i].windows);
    assert_true(features.windows >= 66);
    assert_int_equal(features.window_length, 16);
    assert_int_equal(features.width, cases[i].width);
    ern_features_free(context, &features);
  }
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_types),    cmocka_unit_test(test_half),
                                     cmocka_unit_test(test_versions), cmocka_unit_test(test_refused_headers),
                                     cmocka_unit_test(test_write),    cmocka_unit_test(test_cut_and_changed),
                                     cmocka_unit_test(test_features), cmocka_unit_test(test_real_features)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
