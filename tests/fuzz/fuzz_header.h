/* SPDX-License-Identifier: MIT
 * Safetensors files with an arbitrary header and data of zeros. The data has the size that the header claims, so that
 * inputs stay small and pass the size check. */
#ifndef ERN_TESTS_FUZZ_HEADER_H
#define ERN_TESTS_FUZZ_HEADER_H

#include "fuzz.h"

/* The largest second number of a "data_offsets": [a, b], at most 64 MiB. */
static inline size_t fuzz_header_claims(const char *text) {
  static const char key[] = "\"data_offsets\"";
  size_t most = 0;
  for (const char *at = strstr(text, key); at != NULL; at = strstr(at + 1, key)) {
    unsigned long long begin = 0, end = 0;
    if (sscanf(at + sizeof key - 1, " : [ %llu , %llu ]", &begin, &end) != 2 || end > (64u << 20)) continue;
    if (end > most) most = (size_t)end;
  }
  return most;
}

/* Writes such a file; the zeros are a sparse hole. */
static inline void fuzz_header_file(const char *path, const uint8_t *header, size_t count) {
  uint8_t length[8];
  char *text = (char *)malloc(count + 1);
  FUZZ_REQUIRE(text != NULL);
  memcpy(text, header, count);
  text[count] = 0;
  for (int i = 0; i < 8; i++) length[i] = (uint8_t)((uint64_t)count >> (8 * i));
  const int file = open(path, O_WRONLY | O_CREAT | O_TRUNC, 0644);
  FUZZ_REQUIRE(file >= 0);
  FUZZ_REQUIRE(write(file, length, 8) == 8 && write(file, header, count) == (ssize_t)count);
  FUZZ_REQUIRE(ftruncate(file, (off_t)(8 + count + fuzz_header_claims(text))) == 0);
  FUZZ_REQUIRE(close(file) == 0);
  free(text);
}

#endif
