/* SPDX-License-Identifier: MIT
 * HDR and wide-gamut videos: colours of an SDR picture are taken to HLG, PQ, BT.2020 and Display P3 by the equations of
 * BT.2100 and BT.2087, in double, and must be read as they were. */
#include <math.h>

#include "ernerf/media.h"
#include "media/ffmpeg.h"
#include "support.h"

enum { PATCH = 16, PATCHES = 10, WIDTH = PATCH * PATCHES, HEIGHT = PATCH };

/* skin, shades, saturated colours; the last three are above the knee, 0.5 of SDR white */
static const uint8_t sdr_colours[PATCHES][3] = {{190, 140, 120}, {90, 60, 50},   {0, 0, 0},     {20, 20, 20},
                                                {128, 128, 128}, {180, 40, 40},  {30, 160, 60}, {200, 200, 200},
                                                {230, 230, 230}, {255, 255, 255}};
enum { BELOW_KNEE = 7 };

static const double to_bt2020[3][3] = {
    {0.62740, 0.32928, 0.04331}, {0.06910, 0.91954, 0.01136}, {0.01639, 0.08801, 0.89560}};
static const double to_p3[3][3] = {{0.82246, 0.17754, 0}, {0.03319, 0.96681, 0}, {0.01708, 0.07240, 0.91052}};

struct form {
  enum AVColorTransferCharacteristic transfer;
  enum AVColorPrimaries primaries; /* as tagged */
  const double (*matrix)[3];       /* to the primaries' linear RGB; NULL: the colours as they are */
  enum AVColorSpace space;
  const char *words; /* of the log, NULL: none */
};

/* Light in units of SDR white, 100 cd/m2, to the values of HLG for a display of 1000 cd/m2. */
static void to_hlg(double rgb[3]) {
  const double a = 0.17883277, b = 1 - 4 * a, c = 0.5 - a * log(4 * a);
  const double luminance = (0.2627 * rgb[0] + 0.6780 * rgb[1] + 0.0593 * rgb[2]) / 10;
  for (int i = 0; i < 3; i++) {
    const double scene = luminance > 0 ? fmax(rgb[i], 0) / 10 * pow(luminance, 1 / 1.2 - 1) : 0;
    rgb[i] = scene <= 1 / 12.0 ? sqrt(3 * scene) : a * log(12 * scene - b) + c;
  }
}

static double to_pq(double light) {
  const double power = pow(fmax(light, 0) / 100, 0.1593017578125);
  return pow((0.8359375 + 18.8515625 * power) / (1 + 18.6875 * power), 78.84375);
}

/* The colour's Y'CbCr of 10 bit, limited range. */
static void encode_colour(const struct form *form, const uint8_t colour[3], uint16_t yuv[3]) {
  double value[3];
  if (form->matrix == NULL) {
    for (int i = 0; i < 3; i++) value[i] = colour[i] / 255.0;
  } else {
    for (int i = 0; i < 3; i++) {
      value[i] = 0;
      for (int j = 0; j < 3; j++) value[i] += form->matrix[i][j] * pow(colour[j] / 255.0, 2.4);
    }
    if (form->transfer == AVCOL_TRC_ARIB_STD_B67) to_hlg(value);
    for (int i = 0; i < 3 && form->transfer != AVCOL_TRC_ARIB_STD_B67; i++)
      value[i] = form->transfer == AVCOL_TRC_SMPTE2084 ? to_pq(value[i]) : pow(fmax(value[i], 0), 1 / 2.4);
  }
  const bool wide = form->space == AVCOL_SPC_BT2020_NCL;
  const double kr = wide ? 0.2627 : 0.2126, kb = wide ? 0.0593 : 0.0722;
  const double y = kr * value[0] + (1 - kr - kb) * value[1] + kb * value[2];
  yuv[0] = (uint16_t)lrint(64 + 876 * y);
  yuv[1] = (uint16_t)lrint(512 + 448 * (value[2] - y) / (1 - kb));
  yuv[2] = (uint16_t)lrint(512 + 448 * (value[0] - y) / (1 - kr));
}

/* One frame of patches, FFV1 (without loss) in Matroska, which keeps the tags. */
static void write_patches(const char *path, const struct form *form) {
  AVFormatContext *container = NULL;
  AVFrame *frame = av_frame_alloc();
  AVPacket *packet = av_packet_alloc();
  const AVCodec *codec = avcodec_find_encoder(AV_CODEC_ID_FFV1);
  AVCodecContext *encoder = avcodec_alloc_context3(codec);
  assert_int_equal(avformat_alloc_output_context2(&container, NULL, "matroska", path), 0);
  encoder->width = frame->width = WIDTH;
  encoder->height = frame->height = HEIGHT;
  encoder->pix_fmt = AV_PIX_FMT_YUV444P10;
  encoder->bits_per_raw_sample = 10;
  frame->format = encoder->pix_fmt;
  encoder->time_base = (AVRational){1, 25};
  encoder->color_range = AVCOL_RANGE_MPEG;
  encoder->colorspace = form->space;
  encoder->color_trc = form->transfer;
  encoder->color_primaries = form->primaries;
  assert_int_equal(avcodec_open2(encoder, codec, NULL), 0);
  AVStream *stream = avformat_new_stream(container, NULL);
  stream->time_base = encoder->time_base;
  assert_true(avcodec_parameters_from_context(stream->codecpar, encoder) >= 0);
  assert_true(avio_open(&container->pb, path, AVIO_FLAG_WRITE) >= 0);
  assert_true(avformat_write_header(container, NULL) >= 0);
  assert_int_equal(av_frame_get_buffer(frame, 0), 0);
  for (int x = 0; x < WIDTH; x++) {
    uint16_t yuv[3];
    encode_colour(form, sdr_colours[x / PATCH], yuv);
    for (int y = 0; y < HEIGHT; y++)
      for (int c = 0; c < 3; c++) memcpy(frame->data[c] + y * frame->linesize[c] + 2 * x, &yuv[c], sizeof yuv[c]);
  }
  frame->pts = 0;
  assert_int_equal(avcodec_send_frame(encoder, frame), 0);
  assert_int_equal(avcodec_send_frame(encoder, NULL), 0);
  assert_int_equal(avcodec_receive_packet(encoder, packet), 0);
  assert_int_equal(av_interleaved_write_frame(container, packet), 0);
  assert_int_equal(av_write_trailer(container), 0);
  avio_closep(&container->pb);
  avformat_free_context(container);
  avcodec_free_context(&encoder);
  av_packet_free(&packet);
  av_frame_free(&frame);
}

static void keep_notes(void *user, ern_log_level level, const char *line) {
  if (level == ERN_LOG_INFO) snprintf(user, SUPPORT_LINES, "%s", line);
}

/* Reads the patches' colours, and checks the log. */
static void read_patches(const struct form *form, uint8_t found[PATCHES][3]) {
  static char notes[SUPPORT_LINES];
  ern_context_config config = ern_context_config_default();
  ern_context *context = NULL;
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  double seconds = 0;
  bool end = false;
  notes[0] = 0;
  config.log = keep_notes;
  config.user = notes;
  assert_int_equal(ern_context_create(&context, &config), ERN_OK);
  write_patches("patches.mkv", form);
  support_ok(context, ern_video_reader_open(context, "patches.mkv", &reader));
  support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
  assert_false(end);
  for (int i = 0; i < PATCHES; i++)
    memcpy(found[i], image.data + 3 * (HEIGHT / 2 * WIDTH + i * PATCH + PATCH / 2), sizeof found[i]);
  if (form->words == NULL) assert_string_equal(notes, "");
  if (form->words != NULL && strstr(notes, form->words) == NULL)
    fail_msg("\"%s\", expected \"%s\"", notes, form->words);
  ern_image_free(context, &image);
  ern_video_reader_free(&reader);
  ern_context_free(&context);
}

/* 10 bit, a matrix and an 8-bit result are each rounded; a level of HLG and PQ is up to 1.5 of SDR's */
static const int TOLERANCE = 3;

static void check_same(const struct form *form, int patches, uint8_t found[PATCHES][3]) {
  for (int i = 0; i < patches; i++)
    for (int c = 0; c < 3; c++)
      if (abs(found[i][c] - sdr_colours[i][c]) > TOLERANCE)
        fail_msg("transfer %d, primaries %d, patch %d, component %d: %d, expected %d", form->transfer, form->primaries,
                 i, c, found[i][c], sdr_colours[i][c]);
}

static void test_hdr(void **state) {
  (void)state;
  static const struct form forms[] = {
      {AVCOL_TRC_ARIB_STD_B67, AVCOL_PRI_BT2020, to_bt2020, AVCOL_SPC_BT2020_NCL, "patches.mkv: is HDR (HLG)"},
      {AVCOL_TRC_SMPTE2084, AVCOL_PRI_BT2020, to_bt2020, AVCOL_SPC_BT2020_NCL, "HDR (PQ)"},
      {AVCOL_TRC_ARIB_STD_B67, AVCOL_PRI_UNSPECIFIED, to_bt2020, AVCOL_SPC_BT2020_NCL, "HDR (HLG)"},
      {AVCOL_TRC_SMPTE2084, AVCOL_PRI_SMPTE432, to_p3, AVCOL_SPC_BT709, "HDR (PQ)"}};
  for (size_t i = 0; i < sizeof forms / sizeof *forms; i++) {
    uint8_t found[PATCHES][3];
    read_patches(&forms[i], found);
    check_same(&forms[i], BELOW_KNEE, found);
    for (int k = BELOW_KNEE; k < PATCHES; k++) { /* bright: compressed for what HDR has above SDR white */
      const int grey = found[k][1], sdr = sdr_colours[k][1];
      if (grey > sdr + TOLERANCE || grey < sdr - 30 || (k > BELOW_KNEE && grey <= found[k - 1][1]))
        fail_msg("form %zu: grey %d of SDR is shown as %d", i, sdr, grey);
      for (int c = 0; c < 3; c++) assert_true(abs(found[k][c] - grey) <= 1);
    }
  }
}

static void test_wide_gamut(void **state) {
  (void)state;
  static const struct form forms[] = {
      {AVCOL_TRC_BT2020_10, AVCOL_PRI_BT2020, to_bt2020, AVCOL_SPC_BT2020_NCL, "wide gamut"},
      {AVCOL_TRC_BT709, AVCOL_PRI_SMPTE432, to_p3, AVCOL_SPC_BT709, "wide gamut"}};
  for (size_t i = 0; i < sizeof forms / sizeof *forms; i++) {
    uint8_t found[PATCHES][3];
    read_patches(&forms[i], found);
    check_same(&forms[i], PATCHES, found);
  }
}

static void test_sdr_stays(void **state) {
  (void)state;
  static const struct form forms[] = {{AVCOL_TRC_BT709, AVCOL_PRI_BT709, NULL, AVCOL_SPC_BT709, NULL},
                                      {AVCOL_TRC_UNSPECIFIED, AVCOL_PRI_UNSPECIFIED, NULL, AVCOL_SPC_BT709, NULL},
                                      {AVCOL_TRC_SMPTE170M, AVCOL_PRI_SMPTE170M, NULL, AVCOL_SPC_BT709, NULL}};
  for (size_t i = 0; i < sizeof forms / sizeof *forms; i++) {
    uint8_t found[PATCHES][3];
    read_patches(&forms[i], found);
    check_same(&forms[i], PATCHES, found);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_hdr),
      cmocka_unit_test(test_wide_gamut),
      cmocka_unit_test(test_sdr_stays),
  };
  return cmocka_run_group_tests_name("video_hdr", tests, NULL, NULL);
}
