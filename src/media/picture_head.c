/* SPDX-License-Identifier: MIT
 * What a picture's file claims in its first bytes, before a library of formats sees it and takes memory for it: the
 * sides, and whether the file can hold so many pixels at all. */
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include "media/image.h"

/* What deflate can make of a byte, at most (zlib's own figure). */
enum { DEFLATE_MOST = 1032 };

struct head {
  ern_context *context;
  const char *path;
  FILE *file;
  uint64_t bytes; /* of the file */
};

static uint32_t big_endian(const uint8_t *bytes, int count) {
  uint32_t value = 0;
  for (int i = 0; i < count; i++) value = value << 8 | bytes[i];
  return value;
}

static ern_status check_sides(const struct head *head, uint64_t width, uint64_t height) {
  if (width >= 1 && height >= 1 && width <= ERN_IMAGE_MAX_SIDE && height <= ERN_IMAGE_MAX_SIDE) return ERN_OK;
  return ern_fail(head->context, ERN_E_SHAPE, "%s: picture is %llu x %llu pixels, expected sides of 1 to %d",
                  head->path, (unsigned long long)width, (unsigned long long)height, ERN_IMAGE_MAX_SIDE);
}

static ern_status check_bytes(const struct head *head, uint64_t width, uint64_t height, uint64_t least) {
  if (head->bytes >= least) return ERN_OK;
  return ern_fail(head->context, ERN_E_FORMAT,
                  "%s: picture claims %llu x %llu pixels, found %llu bytes, expected at least %llu: it is cut short",
                  head->path, (unsigned long long)width, (unsigned long long)height, (unsigned long long)head->bytes,
                  (unsigned long long)least);
}

/* `start`: signature, the first chunk's length and name, and that chunk: IHDR. */
static ern_status check_png(const struct head *head, const uint8_t *start) {
  static const uint8_t channels[7] = {1, 0, 3, 1, 2, 0, 4}; /* by colour type; 0: there is none */
  const uint64_t width = big_endian(start + 16, 4), height = big_endian(start + 20, 4);
  const unsigned depth = start[24], colour = start[25];
  const bool known = (depth == 1 || depth == 2 || depth == 4 || depth == 8 || depth == 16) && colour < 7 &&
                     channels[colour] > 0 && memcmp(start + 8, "\0\0\0\15IHDR", 8) == 0;
  if (!known)
    return ern_fail(head->context, ERN_E_FORMAT,
                    "%s: PNG header: depth is %u, colour type %u: there is no such picture", head->path, depth, colour);
  const ern_status status = check_sides(head, width, height);
  if (status != ERN_OK) return status;
  return check_bytes(head, width, height, height * ((width * channels[colour] * depth + 7) / 8) / DEFLATE_MOST);
}

/* Goes from segment to segment to the one with the sides. A block of 8 x 8 pixels takes a bit at least, where
 * Huffman's codes are used. What is amiss otherwise is left for the decoder to say. */
static ern_status check_jpeg(const struct head *head) {
  uint8_t part[9];
  for (long at = 2; fseek(head->file, at, SEEK_SET) == 0 && fread(part, 1, 4, head->file) == 4 && part[0] == 0xff;) {
    const unsigned marker = part[1];
    if (marker == 0xff) { /* a filling byte */
      at++;
      continue;
    }
    if (marker == 0xda || marker == 0xd9) break;
    const bool frame = marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc;
    if (frame && fread(part + 4, 1, 5, head->file) == 5) {
      const uint64_t height = big_endian(part + 5, 2), width = big_endian(part + 7, 2);
      const ern_status status = check_sides(head, width, height);
      if (status != ERN_OK || marker > 0xc2) return status;
      return check_bytes(head, width, height, (width + 7) / 8 * ((height + 7) / 8) / 8);
    }
    at += marker >= 0xd0 && marker <= 0xd7 ? 2 : 2 + (long)big_endian(part + 2, 2);
  }
  return ERN_OK;
}

ern_status ern_image_check_head(ern_context *context, const char *path) {
  struct head head = {.context = context, .path = path, .file = fopen(path, "rb")};
  uint8_t start[32] = {0};
  struct stat about;
  ern_status status = ERN_OK;
  if (head.file == NULL) return ern_fail(context, ERN_E_IO, "%s: cannot open", path);
  const size_t count = fread(start, 1, sizeof start, head.file);
  head.bytes = fstat(fileno(head.file), &about) == 0 ? (uint64_t)about.st_size : 0;
  if (count == 0)
    status = ern_fail(context, ERN_E_FORMAT, "%s: is empty, expected a picture", path);
  else if (count >= 26 && memcmp(start, "\x89PNG\r\n\x1a\n", 8) == 0)
    status = check_png(&head, start);
  else if (count >= 4 && start[0] == 0xff && start[1] == 0xd8)
    status = check_jpeg(&head);
  else if (count >= 10 && memcmp(start, "GIF8", 4) == 0)
    status = check_sides(&head, start[6] | (unsigned)start[7] << 8, start[8] | (unsigned)start[9] << 8);
  fclose(head.file);
  return status;
}
