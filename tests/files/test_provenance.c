/* SPDX-License-Identifier: MIT
 * What files say of how they were made: the packet, its places, and that pictures and sound are as without it. */
#include "media/provenance.h"

#include <libavutil/crc.h>
#include <stdbool.h>

#include "core/memory.h"
#include "ernerf/stream.h"
#include "io/file.h"
#include "media/ffmpeg.h"
#include "support.h"

enum { SIDE = 32, FRAMES = 5, LIMIT = 1 << 24 };

static ern_context *context;
static const char consent[] = "I agree to \"A & B\" <2026>, \xc3\xa4\n.";

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

static ern_provenance some(void) {
  ern_provenance provenance = ern_provenance_default();
  provenance.id = "0123abc-DEF";
  provenance.consent = consent;
  provenance.description = "a mouth & no more";
  return provenance;
}

static uint8_t *file_bytes(const char *path, size_t *count) {
  uint8_t *bytes = NULL;
  support_ok(context, ern_file_read(context, path, LIMIT, &bytes, count));
  return bytes;
}

/* Where `text` begins in the bytes; fails where it is not there. */
static size_t find(const uint8_t *bytes, size_t count, const char *text) {
  const size_t length = strlen(text);
  for (size_t i = 0; i + length <= count; i++)
    if (memcmp(bytes + i, text, length) == 0) return i;
  fail_msg("\"%s\" is not in the file", text);
  return 0;
}

static void test_texts(void **state) {
  (void)state;
  struct ern_provenance_texts texts;
  ern_provenance p = some();
  support_ok(context, ern_provenance_texts_make(context, &p, &texts));
  assert_non_null(strstr(texts.xmp, "I agree to \"A &amp; B\" &lt;2026&gt;, \xc3\xa4 ."));
  assert_non_null(strstr(texts.xmp, "digitalsourcetype/compositeWithTrainedAlgorithmicMedia<"));
  assert_non_null(strstr(texts.xmp, "\"ProduceID\":\"0123abc-DEF\""));
  ern_provenance_texts_free(context, &texts);
  p = ern_provenance_default();
  p.all_trained = true;
  support_ok(context, ern_provenance_texts_make(context, &p, &texts));
  assert_non_null(strstr(texts.xmp, "digitalsourcetype/trainedAlgorithmicMedia<"));
  assert_null(strstr(texts.xmp, "UsageTerms"));
  ern_provenance_texts_free(context, &texts);
  support_ok(context, ern_provenance_texts_make(context, NULL, &texts));
  assert_null(texts.xmp);
}

static void test_texts_refused(void **state) {
  (void)state;
  static const char *const ids[] = {"a b", "\"", "a\\", "<", "\xc3\xa4"};
  static const char *const consents[] = {"\xc3",         "\xff",         "\xc0\xaf",
                                         "\xe0\x80\x80", "\xed\xa0\x80", "\xf4\x90\x80\x80"};
  struct ern_provenance_texts texts;
  char most[ERN_CONSENT_BYTES + 1];
  for (size_t i = 0; i < sizeof ids / sizeof *ids; i++) {
    ern_provenance p = ern_provenance_default();
    p.id = ids[i];
    assert_int_equal(ern_provenance_texts_make(context, &p, &texts), ERN_E_ARGUMENT);
    assert_null(texts.xmp);
  }
  for (size_t i = 0; i < sizeof consents / sizeof *consents; i++) {
    ern_provenance p = ern_provenance_default();
    p.consent = consents[i];
    assert_int_equal(ern_provenance_texts_make(context, &p, &texts), ERN_E_ARGUMENT);
    assert_non_null(strstr(ern_last_error(context), "no UTF-8"));
  }
  ern_provenance p = ern_provenance_default();
  p.consent = memset(most, '&', sizeof most);
  most[ERN_CONSENT_BYTES - 1] = 0;
  support_ok(context, ern_provenance_texts_make(context, &p, &texts));
  ern_provenance_texts_free(context, &texts);
  most[ERN_CONSENT_BYTES - 1] = '&';
  most[ERN_CONSENT_BYTES] = 0;
  assert_int_equal(ern_provenance_texts_make(context, &p, &texts), ERN_E_ARGUMENT);
  assert_non_null(strstr(ern_last_error(context), "longer"));
}

static void draw(uint8_t *pixels, int channels, int k) {
  for (int i = 0; i < SIDE * SIDE * channels; i++) pixels[i] = (uint8_t)(i * 7 + k * 31 + i / 50);
}

static void expect_same_picture(const char *a, const char *b, int channels) {
  ern_image x, y;
  support_ok(context, ern_image_read(context, a, channels, &x));
  support_ok(context, ern_image_read(context, b, channels, &y));
  assert_int_equal(x.width, y.width);
  assert_memory_equal(x.data, y.data, (size_t)(SIDE * SIDE * channels));
  ern_image_free(context, &x);
  ern_image_free(context, &y);
}

/* The first chunk behind IHDR, whose CRC FFmpeg computes too. */
static void test_png(void **state) {
  (void)state;
  uint8_t pixels[SIDE * SIDE * 4];
  const ern_image image = {SIDE, SIDE, 4, pixels};
  const ern_provenance p = some();
  size_t count = 0;
  draw(pixels, 4, 0);
  support_ok(context, ern_image_write_provenance(context, "said.png", &image, 100, &p));
  support_ok(context, ern_image_write(context, "plain.png", &image, 100));
  expect_same_picture("said.png", "plain.png", 4);
  uint8_t *bytes = file_bytes("said.png", &count);
  const uint8_t *chunk = bytes + 33;
  const size_t length = (size_t)chunk[0] << 24 | (size_t)chunk[1] << 16 | (size_t)chunk[2] << 8 | chunk[3];
  assert_true(33 + 12 + length < count);
  assert_memory_equal(chunk + 4, "iTXtXML:com.adobe.xmp\0\0\0\0\0<?xpacket", 35);
  const uint32_t crc = av_crc(av_crc_get_table(AV_CRC_32_IEEE_LE), UINT32_MAX, chunk + 4, 4 + length) ^ UINT32_MAX;
  const uint8_t *end = chunk + 8 + length;
  assert_int_equal(crc, (uint32_t)end[0] << 24 | (uint32_t)end[1] << 16 | (uint32_t)end[2] << 8 | end[3]);
  assert_memory_equal(end - 4, "r\"?>", 4);
  (void)find(bytes, count, "UsageTerms");
  ern_release(context, bytes);
}

static void test_jpeg(void **state) {
  (void)state;
  uint8_t pixels[SIDE * SIDE * 3];
  const ern_image image = {SIDE, SIDE, 3, pixels};
  const ern_provenance p = some();
  size_t count = 0;
  draw(pixels, 3, 1);
  support_ok(context, ern_image_write_provenance(context, "said.jpg", &image, 90, &p));
  support_ok(context, ern_image_write(context, "plain.jpg", &image, 90));
  expect_same_picture("said.jpg", "plain.jpg", 3);
  uint8_t *bytes = file_bytes("said.jpg", &count);
  const size_t length = (size_t)bytes[4] << 8 | bytes[5];
  assert_memory_equal(bytes, "\xff\xd8\xff\xe1", 4);
  assert_memory_equal(bytes + 6, "http://ns.adobe.com/xap/1.0/\0<?xpacket", 38);
  assert_int_equal(bytes[4 + length], 0xff); /* the next segment */
  ern_release(context, bytes);
}

static void test_exr(void **state) {
  (void)state;
  float data[SIDE * SIDE * 3];
  static const char *const names[] = {"R", "G", "B"};
  const ern_provenance p = some();
  size_t count = 0;
  for (int i = 0; i < SIDE * SIDE * 3; i++) data[i] = (float)(i % 100) / 100;
  support_ok(context, ern_image_write_exr_provenance(context, "said.exr", data, SIDE, SIDE, 3, names, &p));
  support_ok(context, ern_image_write_exr(context, "plain.exr", data, SIDE, SIDE, 3, names));
  expect_same_picture("said.exr", "plain.exr", 3);
  uint8_t *bytes = file_bytes("said.exr", &count);
  const size_t at = find(bytes, count, "xmp");
  assert_memory_equal(bytes + at, "xmp\0string", 11);
  (void)find(bytes, count, "UsageTerms");
  (void)find(bytes, count, "<dc:description><rdf:Alt><rdf:li xml:lang=\"x-default\">a mouth &amp; no more</rdf:li>");
  ern_release(context, bytes);
}

static void write_video(const char *path, const ern_provenance *provenance) {
  uint8_t pixels[SIDE * SIDE * 4];
  ern_video_options options = ern_video_options_default(SIDE, SIDE);
  ern_video_writer *writer = NULL;
  options.provenance = provenance;
  support_ok(context, ern_video_writer_open(context, path, &options, &writer));
  for (int k = 0; k < FRAMES; k++) {
    draw(pixels, 4, k);
    support_ok(context, ern_video_writer_frame(writer, pixels));
  }
  support_ok(context, ern_video_writer_close(&writer));
}

static void expect_tags(const char *path, const char *track) {
  AVFormatContext *container = NULL;
  assert_true(avformat_open_input(&container, path, NULL, NULL) >= 0);
  assert_true(avformat_find_stream_info(container, NULL) >= 0);
  const AVDictionaryEntry *type = av_dict_get(container->metadata, "DigitalSourceType", NULL, 0);
  const AVDictionaryEntry *aigc = av_dict_get(container->metadata, "AIGC", NULL, 0);
  if (type == NULL || aigc == NULL) fail_msg("%s: has no tags", path);
  assert_non_null(strstr(type->value, "/compositeWithTrainedAlgorithmicMedia"));
  assert_non_null(strstr(aigc->value, "\"ProduceID\":\"0123abc-DEF\""));
  const AVDictionaryEntry *description = av_dict_get(container->metadata, "description", NULL, 0);
  assert_non_null(description);
  assert_string_equal(description->value, "a mouth & no more");
  if (track != NULL) {
    const AVDictionaryEntry *name = av_dict_get(container->streams[0]->metadata, "handler_name", NULL, 0);
    assert_non_null(name);
    assert_non_null(strstr(name->value, track));
  }
  avformat_close_input(&container);
}

/* The pictures are those without it; the packet is the file's last box, right to its end. */
static void test_mp4(void **state) {
  (void)state;
  const ern_provenance p = some();
  size_t count = 0;
  write_video("said.mp4", &p);
  write_video("plain.mp4", NULL);
  expect_tags("said.mp4", "compositeWithTrainedAlgorithmicMedia");
  ern_video_reader *a = NULL, *b = NULL;
  ern_image x = {0}, y = {0};
  support_ok(context, ern_video_reader_open(context, "said.mp4", &a));
  support_ok(context, ern_video_reader_open(context, "plain.mp4", &b));
  int frames = 0;
  for (bool end = false;; frames++) {
    double s = 0, t = 0;
    bool other = false;
    support_ok(context, ern_video_reader_frame(a, &x, &s, &end));
    support_ok(context, ern_video_reader_frame(b, &y, &t, &other));
    assert_int_equal(end, other);
    if (end) break;
    assert_true(s == t);
    assert_memory_equal(x.data, y.data, SIDE * SIDE * 3);
  }
  assert_int_equal(frames, FRAMES);
  ern_image_free(context, &x);
  ern_image_free(context, &y);
  ern_video_reader_free(&a);
  ern_video_reader_free(&b);
  uint8_t *bytes = file_bytes("said.mp4", &count);
  const size_t packet = find(bytes, count, "<?xpacket begin"), box = packet - 24;
  const size_t length =
      (size_t)bytes[box] << 24 | (size_t)bytes[box + 1] << 16 | (size_t)bytes[box + 2] << 8 | bytes[box + 3];
  assert_int_equal(box + length, count);
  assert_memory_equal(bytes + box + 4, "uuid\xbe\x7a\xcf\xcb", 8);
  ern_release(context, bytes);
}

static void test_streams(void **state) {
  (void)state;
  static const char *const names[] = {"said_live.mp4", "said.mkv", "said.flv", "said.nut"};
  uint8_t pixels[SIDE * SIDE * 4];
  const ern_provenance p = some();
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    ern_stream_options options = ern_stream_options_default(SIDE, SIDE);
    ern_stream_writer *writer = NULL;
    options.provenance = &p;
    support_ok(context, ern_stream_writer_open(context, names[i], &options, &writer));
    for (int k = 0; k < FRAMES; k++) {
      draw(pixels, 4, k);
      support_ok(context, ern_stream_writer_frame(writer, pixels, NULL, 0));
    }
    support_ok(context, ern_stream_writer_close(&writer));
    expect_tags(names[i], i == 0 ? "compositeWith" : NULL);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_texts),  cmocka_unit_test(test_texts_refused),
                                     cmocka_unit_test(test_png),    cmocka_unit_test(test_jpeg),
                                     cmocka_unit_test(test_exr),    cmocka_unit_test(test_mp4),
                                     cmocka_unit_test(test_streams)};
  return cmocka_run_group_tests(tests, set_up, tear_down);
}
