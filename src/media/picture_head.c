/* SPDX-License-Identifier: MIT
 * What of a picture file is checked before an image library reads it. The header: the sides, and whether a file of this
 * size can hold so many pixels. Of a PNG: whether all of its chunks are there, as their checksums say, and whether its
 * colours are those of sRGB. */
#include <libavutil/crc.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include "media/image.h"

/* deflate's greatest expansion of a byte (from zlib's documentation). */
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
  static const uint8_t channels[7] = {1, 0, 3, 1, 2, 0, 4}; /* by colour type; 0: not valid */
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

/* Walks the segments to the one with the sides (SOF). A block of 8 x 8 pixels takes at least a bit with Huffman coding.
 * The decoder reports any other error. */
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

/* Reads a text of less than 256 bytes up to its 0; -1 on failure. */
static int read_text(FILE *file, char text[256]) {
  for (int i = 0; i < 256; i++) {
    const int c = fgetc(file);
    if (c == EOF) return -1;
    text[i] = (char)c;
    if (c == 0) return i;
  }
  return -1;
}

static uint32_t little_endian(const uint8_t *bytes) {
  return bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 | (uint32_t)bytes[3] << 24;
}

static ern_status check_window(const struct head *head) {
  uint8_t window[16];
  int64_t side[2];
  if (fread(window, 1, sizeof window, head->file) != sizeof window) return ERN_OK;
  for (int i = 0; i < 2; i++)
    side[i] = (int64_t)(int32_t)little_endian(window + 8 + 4 * i) - (int32_t)little_endian(window + 4 * i) + 1;
  return check_sides(head, side[0] > 0 ? (uint64_t)side[0] : 0, side[1] > 0 ? (uint64_t)side[1] : 0);
}

/* The size of an attribute of a type that OpenEXR parses itself, whatever size the file states; -1: any size, -2:
 * another type. */
static int64_t size_of_type(const char *type) {
  static const struct {
    const char *name;
    int bytes;
  } types[] = {{"box2i", 16},      {"box2f", 16}, {"chromaticities", 32},
               {"compression", 1}, {"double", 8}, {"envmap", 1},
               {"float", 4},       {"int", 4},    {"keycode", 28},
               {"lineOrder", 1},   {"m33f", 36},  {"m33d", 72},
               {"m44f", 64},       {"m44d", 128}, {"rational", 8},
               {"timecode", 8},    {"v2i", 8},    {"v2f", 8},
               {"v2d", 16},        {"v3i", 12},   {"v3f", 12},
               {"v3d", 24},        {"string", -1}};
  for (size_t i = 0; i < sizeof types / sizeof *types; i++)
    if (strcmp(type, types[i].name) == 0) return types[i].bytes;
  return -2;
}

/* OpenEXR reads a channel list up to its terminator, not by its stated size. Returns its bytes; 0 where it is
 * truncated. */
static uint64_t channels_bytes(FILE *file) {
  char name[256];
  uint64_t bytes = 0;
  for (;;) {
    const int length = read_text(file, name);
    if (length < 0) return 0;
    bytes += (uint64_t)length + 1;
    if (length == 0) return bytes;
    if (fseek(file, 16, SEEK_CUR) != 0) return 0;
    bytes += 16;
  }
}

static ern_status wrong_exr(const struct head *head, const char *what, const char *name) {
  return ern_fail(head->context, ERN_E_FORMAT, "%s: OpenEXR header: %.40s: %s", head->path, name, what);
}

/* Allows one flat scan-line picture. OpenEXR allocates any size that the header claims, so this checks each attribute
 * first: name, type, size, and data. */
static ern_status check_exr(const struct head *head) {
  char name[256], type[256];
  uint8_t size[4];
  uint64_t at = 8;
  if (fseek(head->file, 4, SEEK_SET) != 0 || fread(size, 1, 4, head->file) != 4 || size[0] != 2 ||
      (size[1] & ~4) != 0 || size[2] != 0 || size[3] != 0)
    return wrong_exr(head, "expected version 2 and one flat picture of scan lines", "flags");
  for (;;) {
    const int name_length = read_text(head->file, name);
    if (name_length == 0) return ERN_OK;
    const int type_length = name_length > 0 ? read_text(head->file, type) : -1;
    if (type_length < 0 || fread(size, 1, 4, head->file) != 4) return wrong_exr(head, "it is cut short", "attributes");
    at += (uint64_t)name_length + (uint64_t)type_length + 6;
    const uint64_t claimed = little_endian(size);
    const bool channels = strcmp(type, "chlist") == 0;
    const int64_t bytes = channels ? (int64_t)channels_bytes(head->file) : size_of_type(type);
    if (bytes == -2) return wrong_exr(head, "is of a type that is not read", name);
    if (at > head->bytes || claimed > head->bytes - at || (bytes >= 0 && claimed != (uint64_t)bytes))
      return wrong_exr(head, "its size is not that of its type, or past the end of the file", name);
    if (fseek(head->file, (long)at, SEEK_SET) != 0) return wrong_exr(head, "it is cut short", name);
    if (strcmp(type, "box2i") == 0 && strcmp(name, "dataWindow") == 0) {
      const ern_status status = check_window(head);
      if (status != ERN_OK) return status;
    }
    at += claimed;
    if (fseek(head->file, (long)at, SEEK_SET) != 0) return wrong_exr(head, "it is cut short", name);
  }
}

/* The format by the first bytes. The readers of the formats after GIF in the table allocate nothing before check_claim
 * has checked the size. */
static const char *format_of(const uint8_t *start, size_t count) {
  static const struct {
    const char *start;
    size_t bytes, least; /* of `start`; least size of a file whose header is parsed */
    const char *format;
  } kinds[] = {{"\x89PNG\r\n\x1a\n", 8, 26, "png"},
               {"\xff\xd8", 2, 4, "jpeg"},
               {"\x76\x2f\x31\x01", 4, 8, "openexr"},
               {"GIF8", 4, 10, "gif"},
               {"BM", 2, 2, "bmp"},
               {"II*\0", 4, 4, "tiff"},
               {"MM\0*", 4, 4, "tiff"},
               {"RIFF", 4, 4, "webp"}};
  for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++)
    if (count >= kinds[i].least && memcmp(start, kinds[i].start, kinds[i].bytes) == 0) return kinds[i].format;
  return count >= 3 && start[0] == 'P' && start[1] >= '1' && start[1] <= '7' ? "pnm" : "";
}

static ern_status check_by_format(const struct head *head, const uint8_t *start, const char *format) {
  if (strcmp(format, "png") == 0) return check_png(head, start);
  if (strcmp(format, "jpeg") == 0) return check_jpeg(head);
  if (strcmp(format, "openexr") == 0) return check_exr(head);
  if (strcmp(format, "gif") == 0)
    return check_sides(head, start[6] | (unsigned)start[7] << 8, start[8] | (unsigned)start[9] << 8);
  return ERN_OK;
}

ern_status ern_image_check_head(ern_context *context, const char *path, const char **format) {
  struct head head = {.context = context, .path = path, .file = fopen(path, "rb")};
  uint8_t start[32] = {0};
  struct stat about;
  ern_status status = ERN_OK;
  *format = "";
  if (head.file == NULL) return ern_fail(context, ERN_E_IO, "%s: cannot open", path);
  const size_t count = fread(start, 1, sizeof start, head.file);
  head.bytes = fstat(fileno(head.file), &about) == 0 ? (uint64_t)about.st_size : 0;
  const char *found = format_of(start, count);
  if (count == 0)
    status = ern_fail(context, ERN_E_FORMAT, "%s: is empty, expected a picture", path);
  else if (found[0] == 0)
    status = ern_fail(context, ERN_E_FORMAT,
                      "%s: is no picture, expected PNG, JPEG, OpenEXR, TIFF, BMP, GIF, WebP or PNM", path);
  else
    status = check_by_format(&head, start, found);
  fclose(head.file);
  if (status == ERN_OK) *format = found;
  return status;
}

/* ---- the alpha of a TIFF ----------------------------------------------------------------------------------------- */

static uint32_t number(const uint8_t *bytes, int count, bool little) {
  return !little ? big_endian(bytes, count) : count == 2 ? bytes[0] | (uint32_t)bytes[1] << 8 : little_endian(bytes);
}

bool ern_image_tiff_is_multiplied(const char *path) {
  enum { EXTRA_SAMPLES = 338, ASSOCIATED = 1 };
  uint8_t start[8], entry[12];
  bool multiplied = false;
  FILE *file = fopen(path, "rb");
  if (file == NULL) return false;
  if (fread(start, 1, sizeof start, file) == sizeof start) {
    const bool little = start[0] == 'I';
    if (fseek(file, (long)number(start + 4, 4, little), SEEK_SET) == 0 && fread(entry, 1, 2, file) == 2)
      for (uint32_t left = number(entry, 2, little); left > 0 && fread(entry, 1, sizeof entry, file) == sizeof entry;
           left--)
        if (number(entry, 2, little) == EXTRA_SAMPLES && number(entry + 8, 2, little) == ASSOCIATED) multiplied = true;
  }
  fclose(file);
  return multiplied;
}

/* ---- the chunks of a PNG ----------------------------------------------------------------------------------------- */

/* Reads `length` bytes and the checksum after them; *sum: of `name` and these bytes. False: the file ends before. */
static bool read_chunk(FILE *file, const uint8_t name[4], uint32_t length, uint32_t *sum, uint32_t *stated) {
  const AVCRC *table = av_crc_get_table(AV_CRC_32_IEEE_LE);
  uint8_t bytes[16384];
  *sum = av_crc(table, UINT32_MAX, name, 4);
  for (size_t left = length; left > 0;) {
    const size_t part = left < sizeof bytes ? left : sizeof bytes;
    if (fread(bytes, 1, part, file) != part) return false;
    *sum = av_crc(table, *sum, bytes, part);
    left -= part;
  }
  *sum = ~*sum;
  if (fread(bytes, 1, 4, file) != 4) return false;
  *stated = big_endian(bytes, 4);
  return true;
}

/* Where the last byte of the checksum is there, the chunk is whole. */
static bool skip_chunk(FILE *file, uint32_t length) {
  return fseek(file, (long)length + 3, SEEK_CUR) == 0 && fgetc(file) != EOF;
}

ern_status ern_image_check_png_whole(ern_context *context, const char *path, bool pixels) {
  static const uint8_t signature[8] = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};
  ern_status status = ERN_OK;
  uint8_t head[8];
  uint64_t at = sizeof signature;
  FILE *file = fopen(path, "rb");
  if (file == NULL) return ern_fail(context, ERN_E_IO, "%s: cannot open", path);
  if (fread(head, 1, sizeof head, file) != sizeof head || memcmp(head, signature, sizeof head) != 0) goto fail;
  /* a chunk: length (4 bytes, big end first), name (4), that many bytes, checksum (4) */
  for (bool ended = false; !ended;) {
    const uint8_t *name = head + 4;
    const bool headed = fread(head, 1, sizeof head, file) == sizeof head;
    const uint32_t length = big_endian(head, 4);
    uint32_t sum = 0, stated = 0;
    ended = headed && memcmp(name, "IEND", 4) == 0;
    /* a small letter: a decoder leaves the chunk out where it is damaged */
    const bool summed = headed && (name[0] & 0x20) == 0 && (pixels || memcmp(name, "IDAT", 4) != 0);
    if (!headed || length > INT32_MAX ||
        !(summed ? read_chunk(file, name, length, &sum, &stated) : skip_chunk(file, length)))
      ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: PNG is cut short: the chunk at byte %llu is not whole", path,
                       (unsigned long long)at));
    if (sum != stated)
      ERN_TRY(ern_fail(context, ERN_E_FORMAT,
                       "%s: PNG is damaged: the chunk at byte %llu has checksum %08x, expected %08x", path,
                       (unsigned long long)at, (unsigned)sum, (unsigned)stated));
    at += sizeof head + length + 4;
  }
fail:
  fclose(file);
  return status;
}

/* cICP: codes of primaries and of the curve (ITU-T H.273): not said, sRGB's, and those of televisions, which are taken
 * as sRGB's as those of a video are. */
static bool is_television(const uint8_t *code) {
  return (code[0] <= 2 || (code[0] >= 5 && code[0] <= 7)) && (code[1] <= 2 || code[1] == 6 || code[1] >= 13) &&
         code[1] <= 15;
}

/* cHRM: x and y of white, red, green and blue, in 1/100000. A primary of BT.601 is within 0.01 of sRGB's. */
static bool has_primaries_of_srgb(const uint8_t chromaticities[32]) {
  static const uint32_t own[8] = {31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000};
  for (size_t i = 0; i < 8; i++) {
    const uint32_t value = big_endian(chromaticities + 4 * i, 4);
    if (value + 1500 < own[i] || value > own[i] + 1500) return false;
  }
  return true;
}

const char *ern_image_png_other_colours(const char *path) {
  uint8_t head[8], data[32];
  bool srgb = false, chromaticities = false;
  const char *other = NULL;
  FILE *file = fopen(path, "rb");
  if (file == NULL) return NULL;
  /* the chunks of colours come before those of pixels */
  for (long at = 8; fseek(file, at, SEEK_SET) == 0 && fread(head, 1, sizeof head, file) == sizeof head &&
                    memcmp(head + 4, "IDAT", 4) != 0 && other == NULL;
       at += 12 + (long)big_endian(head, 4)) {
    const uint32_t length = big_endian(head, 4);
    if (length > INT32_MAX) break;
    if (memcmp(head + 4, "sRGB", 4) == 0) srgb = true;
    if (length == 4 && memcmp(head + 4, "cICP", 4) == 0 && fread(data, 1, 4, file) == 4 && !is_television(data))
      other = "cICP";
    if (length == 32 && memcmp(head + 4, "cHRM", 4) == 0 && fread(data, 1, 32, file) == 32)
      chromaticities = !has_primaries_of_srgb(data);
  }
  fclose(file);
  return other != NULL ? other : chromaticities && !srgb ? "cHRM" : NULL;
}
