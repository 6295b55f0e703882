/* SPDX-License-Identifier: MIT
 * What media does with NULL, with numbers out of range and with structures that nobody initialised (base.h). */
#include <math.h>
#include "arguments.h"

#include "ernerf/media.h"
#include "made_onnx.h"

static struct world {
  ern_context *context;
  ern_clip *clip;
} w;

static const char *const junk = "no such file";
static uint8_t pixels[16 * 16 * 4];

static ern_image picture(void) { return (ern_image){.width = 16, .height = 16, .channels = 3, .data = pixels}; }

#include "arguments_video.h"

/* ---- pictures ---------------------------------------------------------------------------------------------------- */

CHECK(ern_image_read) {
  ern_image image = picture();
  REFUSED_ALONE(ern_image_read(NULL, junk, 3, &image));
  assert_null(image.data);
  image = picture();
  REFUSED(w.context, "ern_image_read: path is NULL", ern_image_read(w.context, NULL, 3, &image));
  assert_null(image.data);
  REFUSED(w.context, "ern_image_read: image is NULL", ern_image_read(w.context, junk, 3, NULL));
  REFUSED(w.context, "-1 channels", ern_image_read(w.context, junk, -1, &image));
}
CHECK(ern_image_size) {
  int side;
  REFUSED_ALONE(ern_image_size(NULL, junk, &side, &side));
  REFUSED(w.context, "ern_image_size: path is NULL", ern_image_size(w.context, NULL, &side, &side));
  REFUSED(w.context, "ern_image_size: width is NULL", ern_image_size(w.context, junk, NULL, &side));
  REFUSED(w.context, "ern_image_size: height is NULL", ern_image_size(w.context, junk, &side, NULL));
}
CHECK(ern_image_write) {
  ern_image image = picture();
  REFUSED_ALONE(ern_image_write(NULL, "a.png", &image, 90));
  REFUSED(w.context, "ern_image_write: path is NULL", ern_image_write(w.context, NULL, &image, 90));
  REFUSED(w.context, "ern_image_write: image is NULL", ern_image_write(w.context, "a.png", NULL, 90));
  REFUSED(w.context, "quality is -1", ern_image_write(w.context, "a.jpg", &image, -1));
  image.channels = -3;
  REFUSED(w.context, "-3 channels", ern_image_write(w.context, "a.png", &image, 90));
  image = picture();
  image.data = NULL;
  REFUSED(w.context, "empty", ern_image_write(w.context, "a.png", &image, 90));
  image = picture();
  image.width = -1;
  assert_int_equal(ern_image_write(w.context, "a.png", &image, 90), ERN_E_SHAPE);
}
CHECK(ern_image_write_exr) {
  const float data[4] = {0};
  const char *const names[] = {"A", NULL};
  REFUSED_ALONE(ern_image_write_exr(NULL, "a.exr", data, 2, 2, 1, names));
  REFUSED(w.context, "path is NULL", ern_image_write_exr(w.context, NULL, data, 2, 2, 1, names));
  REFUSED(w.context, "data is NULL", ern_image_write_exr(w.context, "a.exr", NULL, 2, 2, 1, names));
  REFUSED(w.context, "names is NULL", ern_image_write_exr(w.context, "a.exr", data, 2, 2, 1, NULL));
  REFUSED(w.context, "channel 1 has no name", ern_image_write_exr(w.context, "a.exr", data, 2, 1, 2, names));
  REFUSED(w.context, "-1 channels", ern_image_write_exr(w.context, "a.exr", data, 2, 2, -1, names));
  assert_int_equal(ern_image_write_exr(w.context, "a.exr", data, -2, 2, 1, names), ERN_E_SHAPE);
}
CHECK(ern_optical_flow) {
  static uint8_t from[16 * 16], to[16 * 16];
  static float flow[16 * 16 * 2];
  REFUSED_ALONE(ern_optical_flow(NULL, from, to, 16, 16, flow));
  REFUSED(w.context, "ern_optical_flow: from is NULL", ern_optical_flow(w.context, NULL, to, 16, 16, flow));
  REFUSED(w.context, "ern_optical_flow: to is NULL", ern_optical_flow(w.context, from, NULL, 16, 16, flow));
  REFUSED(w.context, "ern_optical_flow: flow is NULL", ern_optical_flow(w.context, from, to, 16, 16, NULL));
  REFUSED(w.context, "15 x 16", ern_optical_flow(w.context, from, to, 15, 16, flow));
  REFUSED(w.context, "16 x -1", ern_optical_flow(w.context, from, to, 16, -1, flow));
}
CHECK(ern_lpips_open) {
  ern_lpips *lpips = (ern_lpips *)&w;
  REFUSED_ALONE(ern_lpips_open(&lpips, NULL, "a.pth", "b.pth"));
  assert_null(lpips);
  REFUSED(w.context, "ern_lpips_open: lpips is NULL", ern_lpips_open(NULL, w.context, "a.pth", "b.pth"));
  REFUSED(w.context, "ern_lpips_open: network is NULL", ern_lpips_open(&lpips, w.context, NULL, "b.pth"));
  REFUSED(w.context, "ern_lpips_open: heads is NULL", ern_lpips_open(&lpips, w.context, "a.pth", NULL));
}
CHECK(ern_lpips_free) {
  ern_lpips *none = NULL;
  ern_lpips_free(NULL);
  ern_lpips_free(&none);
}
CHECK(ern_lpips_distance) { /* with weights: e2e/test_cli_lpips */
  static float picture[3 * 32 * 32];
  double distance = 3;
  REFUSED_ALONE(ern_lpips_distance(NULL, picture, picture, 32, 32, &distance, NULL));
  assert_true(distance == 3);
}
CHECK(ern_lpips_name) { assert_null(ern_lpips_name(NULL)); }
CHECK(ern_lpips_fine_loss) { assert_null(ern_lpips_fine_loss(NULL).compute); }
/* A network that means over a picture's colours. */
static ern_network *made_network(void) {
  struct made_message graph = {0};
  ern_network *network = NULL;
  made_node(&graph, "GlobalAveragePool", "picture", "mean", NULL);
  made_value(&graph, 11, "picture", (const size_t[]){1, 3, 4, 5, 0});
  made_value(&graph, 12, "mean", (const size_t[]){1, 3, 1, 1, 0});
  made_onnx("mean.onnx", &graph);
  support_ok(w.context, ern_network_open(w.context, "mean.onnx", &network));
  return network;
}

CHECK(ern_network_open) {
  ern_network *network = (ern_network *)&w;
  REFUSED_ALONE(ern_network_open(NULL, junk, &network));
  assert_null(network);
  REFUSED(w.context, "ern_network_open: path is NULL", ern_network_open(w.context, NULL, &network));
  REFUSED(w.context, "ern_network_open: network is NULL", ern_network_open(w.context, junk, NULL));
  network = (ern_network *)&w;
  support_expect(w.context, ern_network_open(w.context, junk, &network), ERN_E_MISSING, junk, NULL);
  assert_null(network);
  support_write_text("none.onnx", "no network");
  support_expect(w.context, ern_network_open(w.context, "none.onnx", &network), ERN_E_FORMAT, "none.onnx", NULL);
}
CHECK(ern_network_free) {
  ern_network *network = NULL;
  ern_network_free(NULL);
  ern_network_free(&network);
}
CHECK(ern_network_input) {
  int shape[ERN_NETWORK_DIMS];
  assert_int_equal(ern_network_input(NULL, shape), 0);
  if (!ERN_VISION) return;
  ern_network *network = made_network();
  assert_int_equal(ern_network_input(network, NULL), 0);
  assert_int_equal(ern_network_input(network, shape), 4);
  assert_true(shape[0] == 1 && shape[1] == 3 && shape[2] == 4 && shape[3] == 5);
  ern_network_free(&network);
  assert_null(network);
}
CHECK(ern_network_run) {
  float input[60] = {0};
  const float *output = NULL;
  size_t count = 0;
  REFUSED_ALONE(ern_network_run(NULL, input, &output, &count));
  if (!ERN_VISION) return;
  ern_network *network = made_network();
  REFUSED(w.context, "ern_network_run: input is NULL", ern_network_run(network, NULL, &output, &count));
  REFUSED(w.context, "ern_network_run: output is NULL", ern_network_run(network, input, NULL, &count));
  REFUSED(w.context, "ern_network_run: count is NULL", ern_network_run(network, input, &output, NULL));
  for (size_t i = 20; i < 40; i++) input[i] = (float)i;
  support_ok(w.context, ern_network_run(network, input, &output, &count));
  assert_int_equal(count, 3);
  assert_true(output[0] == 0 && output[1] > 29.49f && output[1] < 29.51f && output[2] == 0);
  input[3] = HUGE_VALF;
  support_expect(w.context, ern_network_run(network, input, &output, &count), ERN_E_NONFINITE, "mean.onnx", "place 0",
                 NULL);
  ern_network_free(&network);
}
CHECK(ern_image_resize) {
  const ern_image image = picture();
  ern_image out = picture();
  REFUSED_ALONE(ern_image_resize(NULL, &image, 2, 2, &out));
  assert_null(out.data);
  REFUSED(w.context, "ern_image_resize: image is NULL", ern_image_resize(w.context, NULL, 2, 2, &out));
  REFUSED(w.context, "ern_image_resize: resized is NULL", ern_image_resize(w.context, &image, 2, 2, NULL));
  REFUSED(w.context, "the same struct", ern_image_resize(w.context, &image, 2, 2, (ern_image *)(uintptr_t)&image));
  assert_true(image.width == 16 && image.data == pixels);
  assert_int_equal(ern_image_resize(w.context, &image, -2, 2, &out), ERN_E_SHAPE);
  assert_null(out.data);
}
CHECK(ern_image_free) {
  ern_image image = picture();
  ern_image_free(NULL, &image);
  assert_non_null(image.data);
  ern_image_free(w.context, NULL);
  ern_image_free(w.context, &(ern_image){0});
}

/* ---- sound ------------------------------------------------------------------------------------------------------- */

CHECK(ern_sound_read) {
  ern_sound sound = {.rate = 7};
  REFUSED_ALONE(ern_sound_read(NULL, junk, &sound));
  assert_int_equal(sound.rate, 0);
  sound.rate = 7;
  REFUSED(w.context, "ern_sound_read: path is NULL", ern_sound_read(w.context, NULL, &sound));
  assert_int_equal(sound.rate, 0);
  REFUSED(w.context, "ern_sound_read: sound is NULL", ern_sound_read(w.context, junk, NULL));
}
CHECK(ern_sound_write_wav) {
  int16_t sample = 0;
  ern_sound sound = {.rate = 16000, .channels = 1, .frames = 1, .data = &sample};
  REFUSED_ALONE(ern_sound_write_wav(NULL, "a.wav", &sound));
  REFUSED(w.context, "path is NULL", ern_sound_write_wav(w.context, NULL, &sound));
  REFUSED(w.context, "sound is NULL", ern_sound_write_wav(w.context, "a.wav", NULL));
  sound.data = NULL;
  REFUSED(w.context, "data is NULL", ern_sound_write_wav(w.context, "a.wav", &sound));
  sound.data = &sample;
  sound.channels = -1;
  assert_int_not_equal(ern_sound_write_wav(w.context, "a.wav", &sound), ERN_OK);
}
CHECK(ern_sound_free) {
  int16_t sample = 0;
  ern_sound sound = {.rate = 16000, .channels = 1, .frames = 1, .data = &sample};
  ern_sound_free(NULL, &sound);
  assert_non_null(sound.data);
  ern_sound_free(w.context, NULL);
  ern_sound_free(w.context, &(ern_sound){0});
}

/* ---- dubbing ----------------------------------------------------------------------------------------------------- */

static const ern_dub_input faceless = {
    .recorded = pixels, .width = 16, .height = 16, .square = {0, 0, 16, 16}, .box = {0, 0, 8, 8}};

CHECK(ern_dub_box) {
  REFUSED_ALONE(ern_dub_box(NULL, &faceless, (int[4]){0}));
  REFUSED(w.context, "input is NULL", ern_dub_box(w.context, NULL, (int[4]){0}));
  REFUSED(w.context, "box is NULL", ern_dub_box(w.context, &faceless, NULL));
}
CHECK(ern_dub_box_sized) {
  assert_int_equal(ern_dub_box_sized(w.context, &faceless, sizeof faceless + 8, (int[4]){0}), ERN_E_UNSUPPORTED);
}
CHECK(ern_dub_wanted) {
  REFUSED_ALONE(ern_dub_wanted(NULL, &faceless, pixels));
  REFUSED(w.context, "input is NULL", ern_dub_wanted(w.context, NULL, pixels));
  REFUSED(w.context, "wanted is NULL", ern_dub_wanted(w.context, &faceless, NULL));
}
CHECK(ern_dub_wanted_sized) {
  assert_int_equal(ern_dub_wanted_sized(w.context, &faceless, sizeof faceless + 8, pixels), ERN_E_UNSUPPORTED);
}
CHECK(ern_dub_frame) {
  bool drawn = true;
  REFUSED_ALONE(ern_dub_frame(NULL, &faceless, pixels, &drawn));
  REFUSED(w.context, "rgba is NULL", ern_dub_frame(w.context, &faceless, NULL, &drawn));
  REFUSED(w.context, "drawn is NULL", ern_dub_frame(w.context, &faceless, pixels, NULL));
  REFUSED(w.context, "head is NULL", ern_dub_frame(w.context, &faceless, pixels, &drawn));
}
CHECK(ern_dub_frame_sized) {
  assert_int_equal(ern_dub_frame_sized(w.context, &faceless, sizeof faceless + 8, pixels, &(bool){true}),
                   ERN_E_UNSUPPORTED);
}

/* ---- a watermark ------------------------------------------------------------------------------------------------- */

CHECK(ern_watermark_open) {
  ern_watermark *watermark = (ern_watermark *)(void *)&w;
  REFUSED_ALONE(ern_watermark_open(NULL, "key", 128, 128, &watermark));
  assert_null(watermark);
  REFUSED(w.context, "key is NULL", ern_watermark_open(w.context, NULL, 128, 128, &watermark));
  REFUSED(w.context, "watermark is NULL", ern_watermark_open(w.context, "key", 128, 128, NULL));
  assert_int_equal(ern_watermark_open(w.context, "key", 128, -1, &watermark), ERN_E_SHAPE);
  assert_null(watermark);
}
CHECK(ern_watermark_put) {
  ern_watermark *watermark = NULL;
  REFUSED_ALONE(ern_watermark_put(NULL, pixels));
  support_ok(w.context, ern_watermark_open(w.context, "key", 128, 128, &watermark));
  REFUSED(w.context, "ern_watermark_put: rgba is NULL", ern_watermark_put(watermark, NULL));
  ern_watermark_free(&watermark);
  assert_null(watermark);
}
CHECK(ern_watermark_free) {
  ern_watermark *none = NULL;
  ern_watermark_free(NULL);
  ern_watermark_free(&none);
}
CHECK(ern_watermark_detector_open) {
  ern_watermark_detector *detector = (ern_watermark_detector *)(void *)&w;
  REFUSED_ALONE(ern_watermark_detector_open(NULL, "key", &detector));
  assert_null(detector);
  REFUSED(w.context, "key is NULL", ern_watermark_detector_open(w.context, NULL, &detector));
  REFUSED(w.context, "detector is NULL", ern_watermark_detector_open(w.context, "key", NULL));
  REFUSED(w.context, "0 bytes", ern_watermark_detector_open(w.context, "", &detector));
}
CHECK(ern_watermark_detector_frame) {
  const ern_image small = picture();
  ern_image none = picture();
  ern_watermark_detector *detector = NULL;
  REFUSED_ALONE(ern_watermark_detector_frame(NULL, &small));
  support_ok(w.context, ern_watermark_detector_open(w.context, "key", &detector));
  REFUSED(w.context, "frame is NULL", ern_watermark_detector_frame(detector, NULL));
  assert_int_equal(ern_watermark_detector_frame(detector, &small), ERN_E_SHAPE);
  none.data = NULL;
  REFUSED(w.context, "empty", ern_watermark_detector_frame(detector, &none));
  ern_watermark_detector_free(&detector);
}
CHECK(ern_watermark_detector_search) {
  ern_watermark_detector *detector = NULL;
  double a, b, c;
  REFUSED_ALONE(ern_watermark_detector_search(NULL, &a, &b, &c));
  support_ok(w.context, ern_watermark_detector_open(w.context, "key", &detector));
  REFUSED(w.context, "score is NULL", ern_watermark_detector_search(detector, NULL, &b, &c));
  REFUSED(w.context, "false_positive is NULL", ern_watermark_detector_search(detector, &a, NULL, &c));
  REFUSED(w.context, "scale is NULL", ern_watermark_detector_search(detector, &a, &b, NULL));
  assert_int_equal(ern_watermark_detector_search(detector, &a, &b, &c), ERN_E_STATE);
  assert_true(a == 0 && b == 1 && c == 1);
  ern_watermark_detector_free(&detector);
}
CHECK(ern_watermark_detector_free) {
  ern_watermark_detector *none = NULL;
  ern_watermark_detector_free(NULL);
  ern_watermark_detector_free(&none);
}

/* ---- clips ------------------------------------------------------------------------------------------------------- */

static void say_line(void *user, int ok, const char *sentence) { (void)user, (void)ok, (void)sentence; }

CHECK(ern_clip_options_default) { assert_int_not_equal(ern_clip_options_default().cookie, 0); }
CHECK(ern_clip_options_fill) { FILLS(ern_clip_options, ern_clip_options_fill); }
CHECK(ern_clip_content) {
  size_t count = 0;
  while (ern_clip_content(count) != NULL) count++;
  assert_int_equal(count, 17);
  assert_null(ern_clip_content(SIZE_MAX));
}
CHECK(ern_clip_open) {
  ern_clip *clip = w.clip;
  REFUSED_ALONE(ern_clip_open(NULL, junk, NULL, &clip));
  assert_null(clip);
  REFUSED(w.context, "folder is NULL", ern_clip_open(w.context, NULL, NULL, &clip));
  REFUSED(w.context, "clip is NULL", ern_clip_open(w.context, junk, NULL, NULL));
  REFUSED(w.context, "ern_clip_options_default", ern_clip_open(w.context, junk, &(ern_clip_options){0}, &clip));
  ern_clip_options options = ern_clip_options_default();
  options.size += 8;
  REFUSED_LATER(w.context, ern_clip_options, ern_clip_open(w.context, junk, &options, &clip));
}
CHECK(ern_clip_free) {
  ern_clip *none = NULL;
  ern_clip_free(NULL);
  ern_clip_free(&none);
}
CHECK(ern_clip_describe) {
  ern_clip_info info = {.width = 7};
  ern_clip_describe(NULL, &info);
  assert_int_equal(info.width, 0);
  ern_clip_describe(w.clip, NULL);
}
CHECK(ern_clip_describe_sized) {
  ern_clip_describe_sized(w.clip, NULL, sizeof(ern_clip_info));
  KEEPS_TO(ern_clip_info, ern_clip_describe_sized(w.clip, it, bytes));
}
CHECK(ern_clip_identity) { assert_null(ern_clip_identity(NULL)); }
CHECK(ern_clip_vary_speech) {
  const float warp = 1;
  REFUSED_ALONE(ern_clip_vary_speech(NULL, &warp, 1));
  REFUSED(w.context, "warps is NULL", ern_clip_vary_speech(w.clip, NULL, 1));
}
CHECK(ern_clip_speech_copies) {
  size_t count = 7;
  assert_null(ern_clip_speech_copies(NULL, &count));
  assert_int_equal(count, 0);
  assert_null(ern_clip_speech_copies(w.clip, NULL));
}
CHECK(ern_clip_features) { assert_null(ern_clip_features(NULL)); }
CHECK(ern_clip_background) { assert_null(ern_clip_background(NULL)); }
CHECK(ern_clip_frame_at) {
  assert_null(ern_clip_frame_at(NULL, ERN_SPLIT_TRAIN, 0));
  assert_null(ern_clip_frame_at(w.clip, (ern_split)-1, 0));
  assert_null(ern_clip_frame_at(w.clip, (ern_split)9, 0));
  assert_null(ern_clip_frame_at(w.clip, ERN_SPLIT_VAL, SIZE_MAX));
}
CHECK(ern_clip_pixels) {
  ern_image truth = picture(), torso = picture();
  REFUSED_ALONE(ern_clip_pixels(NULL, ERN_SPLIT_TRAIN, 0, &truth, &torso));
  assert_null(truth.data);
  assert_null(torso.data);
  REFUSED(w.context, "frame 0 of split 9", ern_clip_pixels(w.clip, (ern_split)9, 0, &truth, &torso));
  REFUSED(w.context, "of split 0", ern_clip_pixels(w.clip, ERN_SPLIT_TRAIN, SIZE_MAX, &truth, &torso));
  support_ok(w.context, ern_clip_pixels(w.clip, ERN_SPLIT_TRAIN, 0, NULL, NULL));
}
CHECK(ern_clip_torso) {
  ern_image torso = picture();
  REFUSED_ALONE(ern_clip_torso(NULL, ERN_SPLIT_TRAIN, 0, &torso));
  assert_null(torso.data);
  REFUSED(w.context, "frame 0 of split 9", ern_clip_torso(w.clip, (ern_split)9, 0, &torso));
  REFUSED(w.context, "torso", ern_clip_torso(w.clip, ERN_SPLIT_TRAIN, 0, NULL));
}
CHECK(ern_clip_head) {
  ern_image head = picture();
  REFUSED_ALONE(ern_clip_head(NULL, ERN_SPLIT_TRAIN, 0, &head));
  assert_null(head.data);
  REFUSED(w.context, "frame 0 of split 9", ern_clip_head(w.clip, (ern_split)9, 0, &head));
  REFUSED(w.context, "head", ern_clip_head(w.clip, ERN_SPLIT_TRAIN, 0, NULL));
}
CHECK(ern_clip_dataset) {
  ern_dataset data = {.width = 7};
  ern_clip_dataset(NULL, &data);
  assert_int_equal(data.width, 0);
  ern_clip_dataset(w.clip, NULL);
}
CHECK(ern_clip_dataset_sized) {
  ern_clip_dataset_sized(w.clip, NULL, sizeof(ern_dataset));
  KEEPS_TO(ern_dataset, ern_clip_dataset_sized(w.clip, it, bytes));
}
CHECK(ern_clip_measure_sized) {
  REFUSED_ALONE(ern_clip_measure_sized(NULL, &(ern_clip_measures){0}, sizeof(ern_clip_measures)));
  KEEPS_TO(ern_clip_measures, support_ok(w.context, ern_clip_measure_sized(w.clip, it, bytes)));
}
CHECK(ern_clip_measure) {
  ern_clip_measures measures;
  REFUSED_ALONE(ern_clip_measure(NULL, &measures));
  REFUSED(w.context, "measures is NULL", ern_clip_measure(w.clip, NULL));
}
CHECK(ern_clip_check) {
  REFUSED_ALONE(ern_clip_check(NULL, junk, say_line, NULL));
  REFUSED(w.context, "folder is NULL", ern_clip_check(w.context, NULL, say_line, NULL));
  REFUSED(w.context, "say is NULL", ern_clip_check(w.context, junk, NULL, NULL));
}

/* ------------------------------------------------------------------------------------------------------------------ */

CHECK(ern_provenance_default) { assert_false(ern_provenance_default().all_trained); }
CHECK(ern_provenance_fill) { FILLS(ern_provenance, ern_provenance_fill); }
CHECK(ern_image_write_provenance) {
  const ern_image image = picture();
  ern_provenance said = ern_provenance_default();
  REFUSED_ALONE(ern_image_write_provenance(NULL, "a.png", &image, 90, &said));
  REFUSED(w.context, "path is NULL", ern_image_write_provenance(w.context, NULL, &image, 90, &said));
  REFUSED(w.context, "image is NULL", ern_image_write_provenance(w.context, "a.png", NULL, 90, &said));
  REFUSED(w.context, "ern_provenance_default",
          ern_image_write_provenance(w.context, "a.png", &image, 90, &(ern_provenance){.id = "a"}));
  said.id = "a b";
  REFUSED(w.context, "the id is", ern_image_write_provenance(w.context, "a.png", &image, 90, &said));
  said.size = sizeof said + 8;
  REFUSED_LATER(w.context, ern_provenance, ern_image_write_provenance(w.context, "a.png", &image, 90, &said));
}
CHECK(ern_image_write_exr_provenance) {
  const float data[4] = {0};
  const char *names[] = {"R"};
  ern_provenance said = ern_provenance_default();
  REFUSED_ALONE(ern_image_write_exr_provenance(NULL, "a.exr", data, 2, 2, 1, names, &said));
  REFUSED(w.context, "path is NULL", ern_image_write_exr_provenance(w.context, NULL, data, 2, 2, 1, names, &said));
  said.description = "\xff";
  REFUSED(w.context, "description is no UTF-8",
          ern_image_write_exr_provenance(w.context, "a.exr", data, 2, 2, 1, names, &said));
  said.description = NULL;
  said.consent = "\xff";
  REFUSED(w.context, "consent is no UTF-8",
          ern_image_write_exr_provenance(w.context, "a.exr", data, 2, 2, 1, names, &said));
}

static const struct arguments_check table[] = {ROW(ern_provenance_default),
                                               ROW(ern_provenance_fill),
                                               ROW(ern_image_write_provenance),
                                               ROW(ern_image_write_exr_provenance),
                                               ROW(ern_lpips_open),
                                               ROW(ern_lpips_free),
                                               ROW(ern_lpips_distance),
                                               ROW(ern_lpips_name),
                                               ROW(ern_lpips_fine_loss),
                                               ROW(ern_image_read),
                                               ROW(ern_image_size),
                                               ROW(ern_image_write),
                                               ROW(ern_image_write_exr),
                                               ROW(ern_network_open),
                                               ROW(ern_network_free),
                                               ROW(ern_network_input),
                                               ROW(ern_network_run),
                                               ROW(ern_image_resize),
                                               ROW(ern_optical_flow),
                                               ROW(ern_image_free),
                                               ROW(ern_sound_read),
                                               ROW(ern_sound_write_wav),
                                               ROW(ern_sound_free),
                                               ROW(ern_video_options_default),
                                               ROW(ern_video_options_fill),
                                               ROW(ern_clip_options_fill),
                                               ROW(ern_clip_describe_sized),
                                               ROW(ern_clip_dataset_sized),
                                               ROW(ern_clip_measure_sized),
                                               ROW(ern_video_writer_open),
                                               ROW(ern_video_writer_frame),
                                               ROW(ern_video_writer_patch),
                                               ROW(ern_video_writer_close),
                                               ROW(ern_video_writer_abandon),
                                               ROW(ern_video_join),
                                               ROW(ern_video_reader_open),
                                               ROW(ern_video_reader_info),
                                               ROW(ern_video_reader_info_sized),
                                               ROW(ern_video_reader_frame),
                                               ROW(ern_video_reader_seek),
                                               ROW(ern_video_reader_decode),
                                               ROW(ern_video_reader_rgb),
                                               ROW(ern_video_frame_is_plain),
                                               ROW(ern_video_frame_clone),
                                               ROW(ern_video_frame_free),
                                               ROW(ern_video_reader_free),
                                               ROW(ern_dub_box),
                                               ROW(ern_dub_box_sized),
                                               ROW(ern_dub_wanted),
                                               ROW(ern_dub_wanted_sized),
                                               ROW(ern_dub_frame),
                                               ROW(ern_dub_frame_sized),
                                               ROW(ern_watermark_open),
                                               ROW(ern_watermark_put),
                                               ROW(ern_watermark_free),
                                               ROW(ern_watermark_detector_open),
                                               ROW(ern_watermark_detector_frame),
                                               ROW(ern_watermark_detector_search),
                                               ROW(ern_watermark_detector_free),
                                               ROW(ern_clip_options_default),
                                               ROW(ern_clip_content),
                                               ROW(ern_clip_open),
                                               ROW(ern_clip_free),
                                               ROW(ern_clip_describe),
                                               ROW(ern_clip_identity),
                                               ROW(ern_clip_features),
                                               ROW(ern_clip_vary_speech),
                                               ROW(ern_clip_speech_copies),
                                               ROW(ern_clip_background),
                                               ROW(ern_clip_frame_at),
                                               ROW(ern_clip_pixels),
                                               ROW(ern_clip_torso),
                                               ROW(ern_clip_head),
                                               ROW(ern_clip_dataset),
                                               ROW(ern_clip_measure),
                                               ROW(ern_clip_check)};
enum { CHECKS = sizeof table / sizeof *table };

static void test_every_function_has_a_check(void **state) {
  (void)state;
  assert_int_equal(arguments_cover("include/ernerf/media.h", table, CHECKS), CHECKS);
}

static void test_arguments(void **state) {
  (void)state;
  char folder[1024];
  snprintf(folder, sizeof folder, "%s/data/tiny", getenv("ERNERF_SOURCE"));
  w.context = support_context();
  support_ok(w.context, ern_clip_open(w.context, folder, NULL, &w.clip));
  arguments_run(table, CHECKS);
  ern_clip_free(&w.clip);
  ern_context_free(&w.context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_every_function_has_a_check),
                                     cmocka_unit_test(test_arguments)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
