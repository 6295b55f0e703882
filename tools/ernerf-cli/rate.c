/* SPDX-License-Identifier: MIT */
#include "rate.h"

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_PART = 1000000, LOWEST = 1, HIGHEST = 240, DECIMALS = 3 };

static const struct {
  const char *text;
  int thousands; /* the rate is thousands * 1000 / 1001 */
} ntsc[] = {{"23.976", 24}, {"23.98", 24}, {"29.97", 30}, {"47.952", 48}, {"59.94", 60}, {"119.88", 120}};

static long common_divisor(long a, long b) {
  while (b != 0) {
    const long rest = a % b;
    a = b;
    b = rest;
  }
  return a;
}

/* Reads one to seven digits at *text and advances it past them. */
static bool read_digits(const char **text, long *value) {
  const size_t digits = strspn(*text, "0123456789");
  if (digits < 1 || digits > 7) return false;
  *value = strtol(*text, NULL, 10);
  *text += digits;
  return true;
}

bool rate_read(const char *text, struct rate *rate) {
  long numerator = 0, denominator = 1;
  for (size_t i = 0; i < sizeof ntsc / sizeof *ntsc; i++)
    if (strcmp(text, ntsc[i].text) == 0) {
      *rate = (struct rate){ntsc[i].thousands * 1000, 1001};
      return true;
    }
  if (!read_digits(&text, &numerator)) return false;
  if (*text == '/') {
    text++;
    if (!read_digits(&text, &denominator)) return false;
  } else if (*text == '.') {
    text++;
    for (int i = 0; i < DECIMALS && *text >= '0' && *text <= '9'; i++, text++) {
      numerator = 10 * numerator + (*text - '0');
      denominator *= 10;
    }
  }
  if (*text != 0 || denominator < 1) return false;
  if (numerator < LOWEST * denominator || numerator > HIGHEST * denominator) return false;
  const long divisor = common_divisor(numerator, denominator);
  numerator /= divisor;
  denominator /= divisor;
  if (numerator > MOST_PART || denominator > MOST_PART) return false;
  *rate = (struct rate){(int)numerator, (int)denominator};
  return true;
}

void rate_words(struct rate rate, char text[RATE_TEXT_BYTES]) {
  if (rate.denominator == 1)
    snprintf(text, RATE_TEXT_BYTES, "%d", rate.numerator);
  else
    snprintf(text, RATE_TEXT_BYTES, "%d/%d", rate.numerator, rate.denominator);
}

double rate_value(struct rate rate) { return (double)rate.numerator / rate.denominator; }

size_t rate_frames(struct rate rate, size_t count) {
  const uint64_t numerator = (uint64_t)rate.numerator, denominator = RATE_CLIP * (uint64_t)rate.denominator;
  if (count > (SIZE_MAX - (size_t)denominator) / numerator) return 0;
  return (size_t)((count * numerator + denominator - 1) / denominator);
}

struct rate_place rate_at(struct rate rate, size_t k, size_t count) {
  const uint64_t numerator = (uint64_t)rate.numerator, at = (uint64_t)k * RATE_CLIP * (uint64_t)rate.denominator;
  const size_t place = (size_t)(at / numerator);
  if (place + 1 >= count) return (struct rate_place){count - 1, 0};
  return (struct rate_place){place, (double)(at % numerator) / (double)numerator};
}
