/* SPDX-License-Identifier: MIT
 * A speech that falls silent for half a second: the mouth comes to rest as in the clip's own silence, and only there.
 */
#include "cli.h"

#include "../made_speech.h"

#include "ernerf/backend.h"
#include "ernerf/media.h"
#include "ernerf/model.h"
#include "ernerf/render.h"
#include "io/npy.h"

enum { SIZE = 64, PIXEL_BYTES = SIZE * SIZE * 4, WIDTH = 29, LENGTH = 16, POSE = 3, RATE = 16000 };
/* The speech: a pause of 7 frames, then silence from frame 60 to 72, of which 58 to 76 are drawn. */
enum { SILENT = 60, SAID = 72, FROM = 58, TO = 76, DRAWN = TO - FROM, CODE = 32 };
static const int clip_silent[] = {20, 45, 80, 85, 100, 120, MADE_FRAMES},
                 silent[] = {40, 47, SILENT, SAID, MADE_FRAMES};
#define FRAMES "--frames 58:76"

static struct cli cli;

static void write_features(ern_context *context, const char *path, const struct made_speech *speech) {
  support_ok(context, ern_npy_write_f32(context, path, speech->features.data, 3,
                                        (const size_t[]){MADE_FRAMES, LENGTH, (size_t)speech->features.width}));
}

/* A clip of few pictures whose speech goes on after them, with a hum as loud as the speech says. */
static int make_model(void **state) {
  (void)state;
  static const char *const old[] = {"clip", "m.safetensors", "m.run"};
  static struct made_speech clip, other;
  ern_context *context = support_context();
  for (size_t i = 0; i < sizeof old / sizeof old[0]; i++) support_clear(old[i]);
  cli_run(&cli, "synth clip --size %d --frames 12 --seed 3 --quiet", SIZE);
  cli_expect(&cli, 0, NULL);
  made_speech(&clip, LENGTH, WIDTH, 3, clip_silent);
  made_speech(&other, LENGTH, WIDTH, 30, silent);
  write_features(context, "clip/aud_ds.npy", &clip);
  write_features(context, "speech.npy", &other);
  ern_sound sound = {.rate = RATE, .channels = 1, .frames = MADE_FRAMES * RATE / 25};
  sound.data = malloc(sound.frames * sizeof *sound.data);
  assert_non_null(sound.data);
  for (size_t i = 0; i < sound.frames; i++)
    sound.data[i] = (int16_t)(powf(10, clip.loudness[i * 25 / RATE] / 20) * (i % 2 == 0 ? 1.0f : -1.0f));
  support_ok(context, ern_sound_write_wav(context, "clip/aud.wav", &sound));
  cli_run(&cli,
          "train clip -o m.safetensors --iters 40 --rays 256 --levels 6 --seed 7 --lr-net 0.004 --effects "
          "eye,codes,view --quiet");
  cli_expect(&cli, 0, NULL);
  free(sound.data);
  free(clip.features.data);
  free(other.features.data);
  ern_context_free(&context);
  return 0;
}

/* Frames 58 .. 75 of the speech with the head held still; the caller frees them. */
static uint8_t *raw(const char *words) {
  uint8_t *pixels = malloc(DRAWN * PIXEL_BYTES + 1);
  assert_non_null(pixels);
  support_clear("raw.bin");
  snprintf(cli.line, sizeof cli.line,
           "render m.safetensors --clip clip --set hold-pose=3 --fix-eye 0 " FRAMES
           " -o - --quiet -y --json rest.json %s",
           words);
  cli_start(&cli, "raw.bin", 0);
  cli_wait(&cli);
  cli_expect(&cli, 0, NULL);
  FILE *file = fopen("raw.bin", "rb");
  assert_non_null(file);
  assert_int_equal(fread(pixels, 1, DRAWN * PIXEL_BYTES + 1, file), DRAWN * PIXEL_BYTES);
  fclose(file);
  return pixels;
}

static void expect_resting(int64_t frames) {
  json_t *report = cli_json(&cli, "rest.json");
  assert_int_equal(json_integer_value(json_object_get(report, "silent_frames")), frames);
  json_decref(report);
}

static bool same(const uint8_t *a, const uint8_t *b, int frame) {
  return memcmp(a + (frame - FROM) * PIXEL_BYTES, b + (frame - FROM) * PIXEL_BYTES, PIXEL_BYTES) == 0;
}

static bool like_next(const uint8_t *a, int frame) {
  return memcmp(a + (frame - FROM) * PIXEL_BYTES, a + (frame + 1 - FROM) * PIXEL_BYTES, PIXEL_BYTES) == 0;
}

/* ---- the frame that is meant ------------------------------------------------------------------------------------- */

/* The mean code of the clip's silent frames, those that the test has made silent for longer than a pause. */
static void resting_code(ern_context *context, ern_renderer *renderer, const ern_features *features, float *code) {
  static float windows[8 * LENGTH * WIDTH];
  double sum[CODE] = {0};
  int count = 0;
  for (int t = 0; t < MADE_FRAMES; t++) {
    if (!((t >= 20 && t < 45) || (t >= 100 && t < 120))) continue;
    ern_audio_windows(windows, features, t, ERN_AUDIO_PAD_EDGE);
    support_ok(context, ern_renderer_code(renderer, windows, LENGTH, code));
    for (int c = 0; c < CODE; c++) sum[c] += (double)code[c];
    count++;
  }
  for (int c = 0; c < CODE; c++) code[c] = (float)(sum[c] / count);
}

/* Pose 3 with the resting code, and the region of its mouth. */
static void draw_meant(float *rgb, ern_box *mouth) {
  ern_context *context = support_context();
  ern_backend *backend = NULL;
  ern_model *model = NULL;
  ern_renderer *renderer = NULL;
  ern_clip *clip = NULL;
  ern_clip_info info;
  ern_image torso = {0};
  static float windows[8 * LENGTH * WIDTH];
  float code[CODE];
  size_t index = 0;
  support_ok(context, ern_backend_create(&backend, context, NULL));
  support_ok(context, ern_model_load(&model, context, "m.safetensors"));
  support_ok(context, ern_renderer_create(&renderer, backend, model, NULL));
  support_ok(context, ern_clip_open(context, "clip", NULL, &clip));
  ern_clip_describe(clip, &info);
  while (ern_clip_frame_at(clip, ERN_SPLIT_TRAIN, index)->pose.img_id != POSE) index++;
  const ern_clip_frame *frame = ern_clip_frame_at(clip, ERN_SPLIT_TRAIN, index);
  support_ok(context, ern_clip_pixels(clip, ERN_SPLIT_TRAIN, index, NULL, &torso));
  resting_code(context, renderer, ern_clip_features(clip), code);
  ern_audio_windows(windows, ern_clip_features(clip), 60, ERN_AUDIO_PAD_EDGE);
  ern_frame_input input = {
      .camera = {.focal = (float)info.focal, .cx = (float)info.cx, .cy = (float)info.cy, .width = SIZE, .height = SIZE},
      .windows = windows,
      .window_length = LENGTH,
      .background = ern_clip_background(clip)->data,
      .torso = torso.data,
      .silence_code = code,
      .silence_weight = 1};
  ern_camera_pose(input.camera.pose, frame->pose.matrix, 4);
  const ern_frame_output output = {.rgb = rgb};
  support_ok(context, ern_renderer_frame(renderer, &input, &output, NULL));
  *mouth = (ern_box){SIZE, 0, SIZE, 0};
  for (int k = 48; k < 68; k++) {
    const int x = (int)frame->landmarks[k][0], y = (int)frame->landmarks[k][1];
    mouth->left = x - 2 < mouth->left ? x - 2 : mouth->left;
    mouth->right = x + 3 > mouth->right ? x + 3 : mouth->right;
    mouth->top = y - 2 < mouth->top ? y - 2 : mouth->top;
    mouth->bottom = y + 3 > mouth->bottom ? y + 3 : mouth->bottom;
  }
  ern_clip_free(&clip);
  ern_renderer_free(&renderer);
  ern_model_free(&model);
  ern_backend_free(&backend);
  ern_context_free(&context);
}

/* ---- what is held ------------------------------------------------------------------------------------------------ */

/* From the fifth silent frame on the mouth is within 45 dB of the resting one, and stands still; speech around it, and
 * the four frames on the way, are not it; and nothing but the silence differs from --set silence-pose=no. */
static void test_silence(void **state) {
  (void)state;
  static float meant[SIZE * SIZE * 3];
  static uint8_t rgb[SIZE * SIZE * 3];
  ern_box mouth;
  draw_meant(meant, &mouth);
  uint8_t *rested = raw("--audio speech.npy");
  expect_resting(SAID - SILENT);
  for (int t = SILENT + 4; t < SAID; t++) {
    const uint8_t *pixels = rested + (t - FROM) * PIXEL_BYTES;
    for (size_t i = 0; i < SIZE * SIZE; i++) memcpy(rgb + 3 * i, pixels + 4 * i, 3);
    const double found = ern_psnr(meant, rgb, SIZE, SIZE, &mouth);
    if (found < 45) fail_msg("frame %d: the mouth is at %g dB of the resting one, expected 45", t, found);
    assert_true(t + 1 == SAID || like_next(rested, t));
  }
  uint8_t *off = raw("--audio speech.npy --set silence-pose=no");
  expect_resting(0);
  for (int t = FROM; t < TO; t++)
    if (same(rested, off, t) != (t < SILENT || t >= SAID)) fail_msg("frame %d: same %d", t, same(rested, off, t));
  assert_false(like_next(off, SILENT + 5) && like_next(off, SILENT + 6) && like_next(off, SILENT + 7));
  free(off);
  off = raw("--audio speech.npy --smooth-lips");
  for (int t = SILENT + 4; t < SAID; t++) assert_true(same(rested, off, t));
  free(off);
  free(rested);
}

/* A pause of 7 frames is none: there are the 12 frames of the silence and no more. Without a clip there are none. */
static void test_words(void **state) {
  (void)state;
  cli_run(&cli,
          "render m.safetensors --clip clip --audio speech.npy --frames 35:80 --size 16x16 -o all.mp4 "
          "-y --json rest.json");
  cli_expect(&cli, 0, "in 12 of 45 frames nothing is said", "--set silence-pose=no", NULL);
  expect_resting(12);
  cli_run(&cli,
          "render m.safetensors --poses clip/transforms_val.json --audio speech.npy --frames 58:62 --size 16x16 -o "
          "all.mp4 -y --json rest.json");
  cli_expect(&cli, 0, "without --clip", "follows the speech alone", NULL);
  expect_resting(0);
}

/* A clip in which silence cannot be recognised, and a speech in features of another kind, are drawn all the same; it is
 * speech.
 */
static void test_unrecognised(void **state) {
  (void)state;
  static struct made_speech speech;
  ern_context *context = support_context();
  made_speech(&speech, LENGTH, WIDTH, 3, (const int[]){MADE_FRAMES});
  support_clear("loud");
  cli_copy("clip", "loud");
  support_clear("loud/aud_ds.npy");
  support_clear("loud/aud.wav");
  write_features(context, "loud/aud_ds.npy", &speech);
  cli_run(&cli, "render m.safetensors --clip loud --audio speech.npy --frames 58:60 -y -o x%%d.png");
  cli_expect(&cli, 0, "loud: silence cannot be recognised", "follows the speech alone", "differ by", NULL);
  free(speech.features.data);
  made_speech(&speech, LENGTH, WIDTH + 1, 3, (const int[]){MADE_FRAMES});
  support_clear("loud/aud_ds.npy");
  write_features(context, "loud/aud_ds.npy", &speech);
  cli_run(&cli, "render m.safetensors --clip loud --audio speech.npy --frames 58:60 -y -o x%%d.png");
  cli_expect(&cli, 0, "aud_ds.npy: 30 wide", "are 29", "follows the speech alone", NULL);
  free(speech.features.data);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_silence), cmocka_unit_test(test_words),
                                     cmocka_unit_test(test_unrecognised)};
  return cmocka_run_group_tests(tests, make_model, NULL);
}
