/* SPDX-License-Identifier: MIT */
#include "io/number.h"

#include <stdint.h>

static bool is_digit(const char *at, const char *end) { return at < end && *at >= '0' && *at <= '9'; }

/* digits * 10^scale. Powers up to 10^22 are exact in double, so one of them costs one rounding. */
static double scaled(uint64_t digits, long scale) {
  static const double tens[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                                1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
  const long widest = 400; /* past it the result is 0 or infinite whatever the digits */
  double value = (double)digits;
  if (digits == 0) return 0;
  if (scale > widest) scale = widest;
  if (scale < -widest) scale = -widest;
  for (; scale > 0; scale -= scale < 22 ? scale : 22) value *= tens[scale < 22 ? scale : 22];
  for (; scale<0; scale += scale> - 22 ? -scale : 22) value /= tens[scale > -22 ? -scale : 22];
  return value;
}

bool ern_number_read(const char **at, const char *end, double *value) {
  const char *p = *at;
  const bool negative = p < end && *p == '-';
  if (p < end && (*p == '-' || *p == '+')) p++;
  const uint64_t most = (UINT64_MAX - 9) / 10;
  uint64_t digits = 0;
  long scale = 0;
  bool any = false;
  for (; is_digit(p, end); p++, any = true) {
    if (digits <= most) {
      digits = digits * 10 + (uint64_t)(*p - '0');
    } else {
      scale++;
    }
  }
  if (p < end && *p == '.') {
    for (p++; is_digit(p, end); p++, any = true) {
      if (digits > most) continue;
      digits = digits * 10 + (uint64_t)(*p - '0');
      scale--;
    }
  }
  if (!any) return false;
  if (p < end && (*p == 'e' || *p == 'E')) {
    p++;
    const bool below = p < end && *p == '-';
    if (p < end && (*p == '-' || *p == '+')) p++;
    if (!is_digit(p, end)) return false;
    long exponent = 0;
    for (; is_digit(p, end); p++) exponent = exponent < 100000000 ? exponent * 10 + (*p - '0') : exponent;
    scale += below ? -exponent : exponent;
  }
  *value = negative ? -scaled(digits, scale) : scaled(digits, scale);
  *at = p;
  return true;
}
