/* SPDX-License-Identifier: MIT
 * Pictures with an ICC profile: their colours become those of sRGB. PNGs that state other colours without a profile.
 * TIFFs whose colours are multiplied by alpha, or not. */
#include <libavutil/crc.h>
#include <stdbool.h>

#include "core/memory.h"
#include "ernerf/media.h"
#include "io/file.h"
#include "support.h"

static ern_context *context;

static int set_up(void **state) {
  (void)state;
  context = support_context();
  return 0;
}

static int tear_down(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

/* Writes `to`: the JPEG `from` with an ICC profile: colorants and one curve, a power of 2 + 51/256 (Adobe RGB) or that
 * of sRGB; `space` is "RGB " or another. */
static void add_profile(const char *from, const char *to, const char *space, const uint32_t colorants[9], bool srgb) {
  static const char *const names[6] = {"rXYZ", "gXYZ", "bXYZ", "rTRC", "gTRC", "bTRC"};
  /* parametricCurveType 3: g a b c d */
  static const uint32_t curves[2][7] = {{0x63757276, 0, 1, 0x02330000},
                                        {0x70617261, 0, 0x30000, 0x26666, 0xf2a7, 0xd59, 0x13d0}};
  enum { WORDS = (128 + 4 + 6 * 12) / 4, ALL = WORDS + 3 * 5 + 8, SEGMENT = 18 };
  uint32_t words[ALL] = {4 * ALL}, last = curves[srgb][6];
  uint8_t profile[SEGMENT + 4 * ALL] = {0xff, 0xe2, (SEGMENT - 2 + 4 * ALL) >> 8, (SEGMENT - 2 + 4 * ALL) & 255},
                                *bytes = NULL;
  size_t count = 0;
  memcpy(profile + 4, "ICC_PROFILE\0\1\1", 14);
  words[32] = 6;
  for (uint32_t i = 0; i < 6; i++)
    words[34 + 3 * i] = 4 * (WORDS + 5 * (i < 3 ? i : 3)), words[35 + 3 * i] = i < 3 ? 20 : 32;
  for (size_t i = 0; i < 3; i++) {
    words[WORDS + 5 * i] = 0x58595a20; /* "XYZ " */
    memcpy(words + WORDS + 5 * i + 2, colorants + 3 * i, 12);
  }
  memcpy(words + WORDS + 15, curves[srgb], 24);
  words[ALL - 2] = last;
  for (size_t i = 0; i < sizeof words; i++) profile[SEGMENT + i] = (uint8_t)(words[i / 4] >> (24 - 8 * (i % 4)));
  memcpy(profile + SEGMENT + 16, space, 4);
  memcpy(profile + SEGMENT + 20, "XYZ ", 4);
  memcpy(profile + SEGMENT + 36, "acsp", 4);
  for (size_t i = 0; i < 6; i++) memcpy(profile + SEGMENT + 132 + 12 * i, names[i], 4);
  support_ok(context, ern_file_read(context, from, 1 << 20, &bytes, &count));
  FILE *file = fopen(to, "wb");
  assert_non_null(file);
  fwrite(bytes, 1, 2, file);
  fwrite(profile, 1, sizeof profile, file);
  fwrite(bytes + 2, 1, count - 2, file);
  assert_int_equal(fclose(file), 0);
  ern_release(context, bytes);
}

/* Colours of a profile become those of sRGB, as NumPy computes them from primaries, white and power; those of a profile
 * of sRGB stay to the bit, and so do those of a profile of another form. */
static void test_colour_profile(void **state) {
  (void)state;
  static const uint32_t adobe[9] = {0x9c18, 0x4fa5, 0x4fc, 0x348d, 0xa02c, 0xf95, 0x2631, 0x102f, 0xbe9b},
                        own[9] = {0x6fa2, 0x38f5, 0x390, 0x6299, 0xb785, 0x18da, 0x24a0, 0xf84, 0xb6cf};
  static const uint8_t stored[3] = {100, 150, 80}, shown[3] = {66, 151, 74};
  enum { WIDE = 32, HIGH = 16, BYTES = 3 * WIDE * HIGH };
  uint8_t colours[BYTES];
  const ern_image made = {.width = WIDE, .height = HIGH, .channels = 3, .data = colours};
  ern_image plain = {0}, read = {0};
  for (size_t i = 0; i < BYTES; i++) colours[i] = stored[i % 3];
  support_ok(context, ern_image_write(context, "plain.jpg", &made, 100));
  support_ok(context, ern_image_read(context, "plain.jpg", 3, &plain));
  for (int k = 0; k < 3; k++) {
    add_profile("plain.jpg", "tagged.jpg", k < 2 ? "RGB " : "CMYK", k == 1 ? own : adobe, k == 1);
    support_ok(context, ern_image_read(context, "tagged.jpg", 3, &read));
    if (k == 0) assert_int_equal(rename("tagged.jpg", "adobe.jpg"), 0); /* of the next test */
    for (size_t i = 0; i < BYTES; i++) /* a JPEG's values are within 1, and the curves' slopes below 1.3 */
      assert_true(k == 0 ? abs(read.data[i] - shown[i % 3]) <= 2 : read.data[i] == plain.data[i]);
    ern_image_free(context, &read);
  }
  ern_image_free(context, &plain);
}

/* A WebP keeps its profile in a chunk: that of the JPEG `from`, before (200, 100, 50), 8 x 8 pixels, half transparent.
 */
static void test_profile_of_webp(void **state) {
  (void)state;
  static const char pixels[] = "VP8L\x11\0\0\0\x2f\x07\xc0\x01\x10\x07\x50\xb2\x22\x57\xa6\x80\x81\x88\xe8\x7f\0\0";
  static const uint8_t start[30] = {'R', 'I', 'F', 'F', 0, 0,    0, 0, 'W', 'E', 'B', 'P', 'V', 'P', '8',
                                    'X', 10,  0,   0,   0, 0x30, 0, 0, 0,   7,   0,   0,   7,   0,   0};
  /* NumPy, from primaries, white and power of Adobe RGB */
  static const uint8_t shown[3] = {227, 100, 42};
  uint8_t *jpeg = NULL, file[1024];
  size_t count = 0, at = sizeof start;
  ern_image read = {0};
  support_ok(context, ern_file_read(context, "adobe.jpg", 1 << 20, &jpeg, &count));
  const size_t profile = (size_t)jpeg[20] << 24 | (size_t)jpeg[21] << 16 | (size_t)jpeg[22] << 8 | jpeg[23];
  memcpy(file, start, at);
  memcpy(file + at, "ICCP", 4);
  for (size_t i = 0; i < 4; i++) file[at + 4 + i] = (uint8_t)(profile >> (8 * i));
  memcpy(file + at + 8, jpeg + 20, profile);
  at += 8 + profile;
  memcpy(file + at, pixels, sizeof pixels - 1);
  at += sizeof pixels - 1;
  for (size_t i = 0; i < 4; i++) file[4 + i] = (uint8_t)((at - 8) >> (8 * i));
  support_write("adobe.webp", file, at);
  support_ok(context, ern_image_read(context, "adobe.webp", 3, &read));
  for (int c = 0; c < 3; c++)
    if (abs(read.data[c] - shown[c]) > 2) fail_msg("channel %d is %d, expected %d", c, read.data[c], shown[c]);
  ern_image_free(context, &read);
  ern_release(context, jpeg);
}

/* A chunk of a PNG; words: those of 4 bytes of its data, big end first. */
struct chunk {
  const char *name;
  size_t bytes;
  uint32_t words[8];
};

static uint8_t *put_word(uint8_t *to, uint32_t word) {
  for (int shift = 24; shift >= 0; shift -= 8) *to++ = (uint8_t)(word >> shift);
  return to;
}

/* Writes `to`: the PNG `from` with these chunks after its header, up to one without a name. */
static void add_chunks(const char *from, const char *to, const struct chunk *chunks) {
  enum { HEAD = 33 };
  uint8_t *bytes = NULL, more[256], *at = more;
  size_t count = 0;
  support_ok(context, ern_file_read(context, from, 1 << 20, &bytes, &count));
  for (; chunks->name != NULL; chunks++) {
    uint8_t *start = put_word(at, (uint32_t)chunks->bytes);
    memcpy(start, chunks->name, 4);
    at = start + 4;
    for (size_t i = 0; i < (chunks->bytes + 3) / 4; i++) (void)put_word(at + 4 * i, chunks->words[i]);
    at += chunks->bytes;
    const size_t summed = (size_t)(at - start);
    at = put_word(at, av_crc(av_crc_get_table(AV_CRC_32_IEEE_LE), UINT32_MAX, start, summed) ^ UINT32_MAX);
  }
  FILE *file = fopen(to, "wb");
  assert_non_null(file);
  fwrite(bytes, 1, HEAD, file);
  fwrite(more, 1, (size_t)(at - more), file);
  fwrite(bytes + HEAD, 1, count - HEAD, file);
  assert_int_equal(fclose(file), 0);
  ern_release(context, bytes);
}

#define SRGB         \
  {                  \
    "sRGB", 1, { 0 } \
  }
#define P3                                                                \
  {                                                                       \
    "cHRM", 32, { 31270, 32900, 68000, 32000, 26500, 69000, 15000, 6000 } \
  }
#define GAMMA(value)     \
  {                      \
    "gAMA", 4, { value } \
  }

/* A PNG that states primaries or a gamma other than sRGB's is read as it is, with a warning that names what it states;
 * one that states those of sRGB, or of a television, is silent. */
static void test_stated_colours_of_png(void **state) {
  (void)state;
  static const struct {
    struct chunk chunks[3];
    const char *warning;
  } cases[] = {{{P3}, "cHRM"},
               {{SRGB, P3}, NULL},
               {{P3, SRGB}, NULL},
               {{P3, GAMMA(45455)}, "cHRM"},
               {{{"cHRM", 32, {31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000}}, GAMMA(45455)}, NULL},
               {{{"cHRM", 32, {31270, 32900, 63000, 34000, 31000, 59500, 15500, 7000}}}, NULL},   /* BT.601 */
               {{{"cHRM", 32, {31270, 32900, 64000, 33000, 21000, 71000, 15000, 6000}}}, "cHRM"}, /* Adobe RGB */
               {{{"cICP", 4, {0x010d0001}}}, NULL},
               {{{"cICP", 4, {0x01010001}}}, NULL},
               {{SRGB, {"cICP", 4, {0x0c0d0001}}}, "cICP"}, /* Display P3 */
               {{{"cICP", 4, {0x09100001}}}, "cICP"},       /* HDR: BT.2020, PQ */
               {{{"cICP", 4, {0x01080001}}}, "cICP"},       /* linear */
               {{GAMMA(50994)}, NULL},                      /* of BT.709, as FFmpeg writes it */
               {{GAMMA(55556)}, "gamma of 1.8"},
               {{GAMMA(100000)}, "gamma of 1;"}};
  static const uint8_t pixels[3] = {200, 100, 50};
  const ern_image made = {.width = 1, .height = 1, .channels = 3, .data = (uint8_t *)(uintptr_t)pixels};
  support_ok(context, ern_image_write(context, "plain.png", &made, 100));
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    char said[SUPPORT_LINES] = "";
    ern_image read = {0};
    ern_context *own = NULL;
    add_chunks("plain.png", "stated.png", cases[i].chunks);
    ern_context_config config = ern_context_config_default();
    config.log = support_keep_warnings;
    config.user = said;
    assert_int_equal(ern_context_create(&own, &config), ERN_OK);
    support_ok(own, ern_image_read(own, "stated.png", 3, &read));
    assert_memory_equal(read.data, pixels, 3);
    ern_image_free(own, &read);
    ern_context_free(&own);
    if (cases[i].warning == NULL ? said[0] != 0 : strstr(said, cases[i].warning) == NULL || strchr(said, '\n')[1] != 0)
      fail_msg("case %zu: expected a warning of %s, found: %s", i, cases[i].warning, said);
  }
}

/* A pixel of a TIFF, R G B A. extra: its tag ExtraSamples: 0 not said, 1 multiplied by alpha, 2 not; -1: no tag. */
static void write_tiff(const char *path, const uint8_t rgba[4], int extra) {
  enum { TAGS = 10, BITS = 8 + 2 + 12 * TAGS + 4, PIXEL = BITS + 8 };
  const uint16_t values[TAGS][3] = {
      {256, 1, 1},     {257, 1, 1}, {258, 4, BITS}, {259, 1, 1}, {262, 1, 2},
      {273, 1, PIXEL}, {277, 1, 4}, {278, 1, 1},    {279, 1, 4}, {338, 1, (uint16_t)extra}};
  uint8_t bytes[PIXEL + 4] = {'M', 'M', 0, 42, 0, 0, 0, 8, 0, (uint8_t)(extra < 0 ? TAGS - 1 : TAGS)};
  for (size_t i = 0; i < TAGS; i++) {
    uint8_t *tag = bytes + 10 + 12 * i;
    const bool far = values[i][1] > 1; /* the value is where four values of 2 bytes are */
    tag[0] = (uint8_t)(values[i][0] >> 8), tag[1] = (uint8_t)values[i][0];
    tag[3] = 3; /* SHORT */
    tag[7] = (uint8_t)values[i][1];
    tag[far ? 10 : 8] = (uint8_t)(values[i][2] >> 8), tag[far ? 11 : 9] = (uint8_t)values[i][2];
  }
  if (extra < 0) memset(bytes + 10 + 12 * (TAGS - 1), 0, 12); /* no further picture */
  for (size_t i = 0; i < 4; i++) bytes[BITS + 2 * i + 1] = 8, bytes[PIXEL + i] = rgba[i];
  support_write(path, bytes, sizeof bytes);
}

static void test_alpha_of_tiff(void **state) {
  (void)state;
  static const uint8_t stored[4] = {100, 50, 25, 128}, divided[4] = {199, 100, 50, 128};
  for (int extra = -1; extra <= 2; extra++) {
    ern_image read = {0};
    write_tiff("alpha.tiff", stored, extra);
    support_ok(context, ern_image_read(context, "alpha.tiff", 4, &read));
    for (int c = 0; c < (extra == 0 ? 3 : 4); c++) /* what is not said to be alpha may be anything */
      if (read.data[c] != (extra == 1 ? divided : stored)[c])
        fail_msg("ExtraSamples %d: channel %d is %d", extra, c, read.data[c]);
    ern_image_free(context, &read);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_colour_profile), cmocka_unit_test(test_profile_of_webp),
                                     cmocka_unit_test(test_stated_colours_of_png),
                                     cmocka_unit_test(test_alpha_of_tiff)};
  return cmocka_run_group_tests(tests, set_up, tear_down);
}
