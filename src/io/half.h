/* SPDX-License-Identifier: MIT
 * IEEE 754 binary16 and bfloat16 as stored in files, to float. */
#ifndef ERN_IO_HALF_H
#define ERN_IO_HALF_H

#include <math.h>
#include <stdint.h>
#include <string.h>

static inline float ern_float_of_bits(uint32_t bits) {
  float value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

static inline float ern_bfloat16_to_float(uint16_t bits) { return ern_float_of_bits((uint32_t)bits << 16); }

/* sign 1, exponent 5 (bias 15), fraction 10; exact. */
static inline float ern_half_to_float(uint16_t bits) {
  const uint32_t sign = (uint32_t)(bits >> 15) << 31, exponent = bits >> 10 & 31, fraction = bits & 1023;
  if (exponent == 31) return ern_float_of_bits(sign | 0x7f800000u | fraction << 13);
  if (exponent == 0) {
    const float small = ldexpf((float)fraction, -24);
    return sign != 0 ? -small : small;
  }
  return ern_float_of_bits(sign | (exponent + 112) << 23 | fraction << 13);
}

#endif
