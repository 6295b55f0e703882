/* SPDX-License-Identifier: MIT
 * SHA-256 as FIPS 180-4 defines it. */
#include <stdint.h>
#include <string.h>

#include "core/status.h"
#include "ernerf/model.h"
#include "io/file.h"

enum { BLOCK_BYTES = 64, LENGTH_AT = 56, PIECE_BYTES = 16384 /* of a file, whole blocks */ };

/* FIPS 180-4, 5.3.3: the first 32 bits of the fractional parts of the square roots of the first 8 primes. */
static const uint32_t initial[8] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                                    0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};

/* FIPS 180-4, 4.2.2: the first 32 bits of the fractional parts of the cube roots of the first 64 primes. */
static const uint32_t round_constants[64] = {
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
    0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
    0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
    0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
    0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
    0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
    0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
    0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2};

static uint32_t rotate_right(uint32_t x, int by) { return (x >> by) | (x << (32 - by)); }

/* 6.2.2: one block of 64 bytes into the state. */
static void absorb(uint32_t state[8], const uint8_t *block) {
  uint32_t schedule[64];
  for (int t = 0; t < 16; t++) {
    schedule[t] = (uint32_t)block[4 * t] << 24 | (uint32_t)block[4 * t + 1] << 16 | (uint32_t)block[4 * t + 2] << 8 |
                  (uint32_t)block[4 * t + 3];
  }
  for (int t = 16; t < 64; t++) {
    const uint32_t x = schedule[t - 15], y = schedule[t - 2];
    const uint32_t small0 = rotate_right(x, 7) ^ rotate_right(x, 18) ^ (x >> 3);
    const uint32_t small1 = rotate_right(y, 17) ^ rotate_right(y, 19) ^ (y >> 10);
    schedule[t] = small1 + schedule[t - 7] + small0 + schedule[t - 16];
  }
  uint32_t a = state[0], b = state[1], c = state[2], d = state[3];
  uint32_t e = state[4], f = state[5], g = state[6], h = state[7];
  for (int t = 0; t < 64; t++) {
    const uint32_t big1 = rotate_right(e, 6) ^ rotate_right(e, 11) ^ rotate_right(e, 25);
    const uint32_t choose = (e & f) ^ (~e & g);
    const uint32_t first = h + big1 + choose + round_constants[t] + schedule[t];
    const uint32_t big0 = rotate_right(a, 2) ^ rotate_right(a, 13) ^ rotate_right(a, 22);
    const uint32_t majority = (a & b) ^ (a & c) ^ (b & c);
    h = g, g = f, f = e, e = d + first;
    d = c, c = b, b = a, a = first + big0 + majority;
  }
  state[0] += a, state[1] += b, state[2] += c, state[3] += d;
  state[4] += e, state[5] += f, state[6] += g, state[7] += h;
}

/* The last `left` of `count` bytes, and the digest. */
static void finish(uint32_t state[8], const uint8_t *at, size_t left, size_t count, char hex[65]) {
  for (; left >= BLOCK_BYTES; at += BLOCK_BYTES, left -= BLOCK_BYTES) absorb(state, at);
  /* 5.1.1: a one bit, zeros, the length in bits as 64 bits, big endian; one more block or two */
  uint8_t tail[2 * BLOCK_BYTES] = {0};
  if (left > 0) memcpy(tail, at, left);
  tail[left] = 0x80;
  const size_t length_at = left < LENGTH_AT ? LENGTH_AT : BLOCK_BYTES + LENGTH_AT;
  const uint64_t bits = (uint64_t)count * 8;
  for (int i = 0; i < 8; i++) tail[length_at + (size_t)i] = (uint8_t)(bits >> (56 - 8 * i));
  absorb(state, tail);
  if (length_at > BLOCK_BYTES) absorb(state, tail + BLOCK_BYTES);
  static const char digits[] = "0123456789abcdef";
  for (int i = 0; i < 64; i++) hex[i] = digits[state[i / 8] >> (28 - 4 * (i % 8)) & 15];
  hex[64] = 0;
}

void ern_sha256_hex(const void *bytes, size_t count, char hex[65]) {
  uint32_t state[8];
  memcpy(state, initial, sizeof state);
  finish(state, bytes, count, count, hex);
}

/* In pieces, as a video may be larger than the memory. */
ern_status ern_file_sha256(ern_context *context, const char *path, char hex[65]) {
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, hex);
  ern_status status = ERN_OK;
  struct ern_file_reader reader;
  uint32_t state[8];
  uint8_t piece[PIECE_BYTES];
  size_t at = 0;
  memcpy(state, initial, sizeof state);
  ERN_TRY(ern_file_reader_open(context, path, SIZE_MAX, &reader));
  for (; reader.size - at > PIECE_BYTES; at += PIECE_BYTES) {
    ERN_TRY(ern_file_reader_take(&reader, at, piece, PIECE_BYTES));
    for (size_t i = 0; i < PIECE_BYTES; i += BLOCK_BYTES) absorb(state, piece + i);
  }
  ERN_TRY(ern_file_reader_take(&reader, at, piece, reader.size - at));
  finish(state, piece, reader.size - at, reader.size, hex);
fail:
  ern_file_reader_close(&reader);
  return status;
}
