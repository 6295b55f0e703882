/* SPDX-License-Identifier: MIT
 * Halves: fp16 and bf16 as files hold them, and bf16 as networks are rendered with (docs/numerics.md). */
#include <float.h>
#include <math.h>

#include "backend_cpu/fused/pack_pairs.h"
#include "ernerf/data.h"
#include "io/half.h"
#include "support.h"

enum { PATTERNS = 65536 };

/* The definition: (-1)^s 2^(e - 15) (1 + f/1024), 2^-14 f/1024 where e is 0. */
static double half_by_definition(uint32_t bits) {
  const double sign = bits >> 15 != 0 ? -1 : 1;
  const int exponent = (int)(bits >> 10 & 31);
  const double fraction = bits & 1023;
  if (exponent == 31) return fraction != 0 ? (double)NAN : sign * (double)INFINITY;
  return sign * (exponent == 0 ? ldexp(fraction, -24) : ldexp(1024 + fraction, exponent - 25));
}

/* case: every fp16 of a file | plain code: denormals wrong by 2 | here: exact for all 65,536 | bound: exact */
static void test_every_fp16_of_a_file(void **state) {
  (void)state;
  for (uint32_t bits = 0; bits < PATTERNS; bits++) {
    const double found = (double)ern_half_to_float((uint16_t)bits), expected = half_by_definition(bits);
    if (isnan(expected) ? !isnan(found) : found != expected || signbit(found) != signbit(expected))
      fail_msg("0x%04x: found %g, expected %g", bits, found, expected);
  }
  assert_true(ern_half_to_float(1) == 0x1p-24f && ern_half_to_float(0x7bff) == 65504);
  assert_true(isinf(ern_half_to_float(0xfc00)) && signbit(ern_half_to_float(0x8000)));
}

/* case: every bf16 of a file | plain code: the low half first on another byte order | here: exact for all 65,536 |
 * bound: exact */
static void test_every_bf16_of_a_file(void **state) {
  (void)state;
  for (uint32_t bits = 0; bits < PATTERNS; bits++) {
    const float value = ern_bfloat16_to_float((uint16_t)bits);
    const uint32_t exponent = bits >> 7 & 255, fraction = bits & 127;
    assert_true(isfinite(value) == (exponent != 255) && (isnan(value) != 0) == (exponent == 255 && fraction != 0));
    if (exponent == 0) assert_true(fabsf(value) == (float)fraction * 0x1p-133f);
  }
}

/* case: to bf16: ties, overflow, denormals, NaN with low bits alone | plain code: truncation makes such a NaN infinite
 * | here: ties to even, infinite from 3.396e38 on, NaN stays, denormals become 0 of their sign, as processors convert |
 * bound: exact */
/* To bf16: ties to even, infinity only from beyond the largest, NaN never to infinity, denormals to zeros. */
static void test_rounding_to_bf16(void **state) {
  (void)state;
  static const struct {
    uint32_t from, to;
  } cases[] = {{0x3f800000, 0x3f80}, {0x3f808000, 0x3f80}, {0x3f808001, 0x3f81}, {0x3f818000, 0x3f82},
               {0x7f7f0000, 0x7f7f}, {0x7f7f7fff, 0x7f7f}, {0x7f7f8000, 0x7f80}, {0x7f7fffff, 0x7f80},
               {0x7f800000, 0x7f80}, {0xff800000, 0xff80}, {0x7f800001, 0x7fc0}, {0xffffffff, 0xffff},
               {0x00000001, 0x0000}, {0x807fffff, 0x8000}, {0x00800000, 0x0080}, {0x007fffff, 0x0000},
               {0x00000000, 0x0000}, {0x80000000, 0x8000}};
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    const uint32_t found = ern_bf16(ern_float_of_bits(cases[i].from));
    if (found != cases[i].to) fail_msg("0x%08x: found 0x%04x, expected 0x%04x", cases[i].from, found, cases[i].to);
  }
  for (uint32_t bits = 0; bits < PATTERNS; bits++) { /* what is one already stays as it is, but for denormals and NaN */
    const bool normal = (bits >> 7 & 255) != 0 && ((bits >> 7 & 255) != 255 || (bits & 127) == 0);
    if (normal) assert_int_equal(ern_bf16(ern_bfloat16_to_float((uint16_t)bits)), bits);
  }
}

/* Speech of two windows of 16 times one value in fp16, of which one is `odd`. */
static ern_status load_with(ern_context *context, uint16_t odd, ern_features *features) {
  static const char header[] = "{'descr': '<f2', 'fortran_order': False, 'shape': (2, 16, 1), }";
  uint8_t file[128 + 64];
  memset(file, ' ', 128);
  memcpy(file, "\x93NUMPY\x01\x00\x76\x00", 10);
  memcpy(file + 10, header, sizeof header - 1);
  file[127] = '\n';
  for (size_t i = 0; i < 32; i++) {
    const uint16_t bits = i == 21 ? odd : 0x3c00;
    file[128 + 2 * i] = (uint8_t)bits, file[129 + 2 * i] = (uint8_t)(bits >> 8);
  }
  support_write("halves.npy", file, sizeof file);
  return ern_features_load(context, "halves.npy", features);
}

/* case: speech in fp16, its denormals, infinities, NaN | plain code: features train to NaN | here: denormals exact,
 * others refused with the file's name | bound: exact */
static void test_speech_in_fp16(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_features features = {0};
  static const uint16_t fine[] = {0x0001, 0x8001, 0x03ff, 0x7bff, 0xfbff, 0x8000}, broken[] = {0x7c00, 0xfc00, 0x7e00};
  for (size_t i = 0; i < sizeof fine / sizeof *fine; i++) {
    support_ok(context, load_with(context, fine[i], &features));
    assert_true((double)features.data[21] == half_by_definition(fine[i]) && features.data[20] == 1);
    ern_features_free(context, &features);
  }
  for (size_t i = 0; i < sizeof broken / sizeof *broken; i++)
    support_expect(context, load_with(context, broken[i], &features), ERN_E_NONFINITE, "halves.npy", NULL);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_every_fp16_of_a_file),
      cmocka_unit_test(test_every_bf16_of_a_file),
      cmocka_unit_test(test_rounding_to_bf16),
      cmocka_unit_test(test_speech_in_fp16),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
