/* SPDX-License-Identifier: MIT
 * Any bytes as the folder of a preprocessed clip: a good one of 8 x 8 pixels whose files the input takes away and
 * replaces. Bytes 0 and 1: a bit for each file that is taken away. Then, again and again: which file, two bytes of
 * length, and so many bytes that become its content. */
#include <math.h>
#include <sys/stat.h>

#include "ernerf/media.h"
#include "fuzz.h"

enum { FILES = 14, SIDE = 8 };
static const char *const names[FILES] = {"transforms_train.json",
                                         "transforms_val.json",
                                         "bc.jpg",
                                         "aud_ds.npy",
                                         "aud_eo.npy",
                                         "au.csv",
                                         "aud.wav",
                                         "gt_imgs/0.jpg",
                                         "gt_imgs/1.png",
                                         "torso_imgs/0.png",
                                         "torso_imgs/1.png",
                                         "ori_imgs/0.lms",
                                         "ori_imgs/1.lms",
                                         "torso.npy"};

struct good {
  uint8_t *bytes[FILES];
  size_t count[FILES];
  bool spoiled[FILES]; /* what lies in the folder is another */
};

static void path_of(int file, char path[64]) { snprintf(path, 64, "clip/%s", names[file]); }

static void keep(struct good *good, int file, const void *bytes, size_t count) {
  good->bytes[file] = (uint8_t *)malloc(count + 1);
  FUZZ_REQUIRE(good->bytes[file] != NULL);
  memcpy(good->bytes[file], bytes, count);
  good->count[file] = count;
  good->spoiled[file] = true;
}

static void keep_picture(struct good *good, ern_context *context, int file, int channels) {
  static uint8_t pixels[SIDE * SIDE * 4], bytes[1 << 16];
  const char *path = strstr(names[file], ".png") != NULL ? "made.png" : "made.jpg";
  for (int i = 0; i < SIDE * SIDE * 4; i++) pixels[i] = (uint8_t)(i * 37 + file);
  const ern_image image = {.width = SIDE, .height = SIDE, .channels = channels, .data = pixels};
  FUZZ_REQUIRE(ern_image_write(context, path, &image, 90) == ERN_OK);
  FILE *made = fopen(path, "rb");
  FUZZ_REQUIRE(made != NULL);
  keep(good, file, bytes, fread(bytes, 1, sizeof bytes, made));
  fclose(made);
}

static void keep_text(struct good *good, int file, const char *text) { keep(good, file, text, strlen(text)); }

/* Zeros of that shape, `values` of them. */
static void keep_numbers(struct good *good, int file, const char *shape, size_t values) {
  enum { HEADER = 118, MOST = 2 * ERN_MOTION_VALUES };
  static uint8_t bytes[10 + HEADER + MOST * sizeof(float)];
  char header[HEADER];
  snprintf(header, sizeof header, "{'descr': '<f4', 'fortran_order': False, 'shape': (%s), }", shape);
  memcpy(bytes, "\x93NUMPY\x01", 7);
  bytes[8] = HEADER;
  memset(bytes + 10, ' ', HEADER);
  memcpy(bytes + 10, header, strlen(header));
  keep(good, file, bytes, 10 + HEADER + values * sizeof(float));
}

static void make(struct good *good, ern_context *context) {
#define POSE "[[1,0,0,0],[0,1,0,0],[0,0,1,1],[0,0,0,1]]"
  static const char transforms[] =
      "{\"focal_len\": 20, \"cx\": 4, \"cy\": 4, \"w\": 8, \"h\": 8, \"frames\": [{\"img_id\": %d, \"aud_id\": %d, "
      "\"transform_matrix\": " POSE "}]}";
  char text[1024] = "";
  const int16_t samples[8] = {0, 1, -1, 300, -300, 0, 0, 7};
  for (int i = 0; i < 2; i++) {
    snprintf(text, sizeof text, transforms, i, i);
    keep_text(good, i, text);
  }
  keep_picture(good, context, 2, 3);
  keep_numbers(good, 3, "3, 16, 2", 3 * 16 * 2);
  keep_numbers(good, 4, "3, 16, 2", 3 * 16 * 2);
  keep_text(good, 5, "frame, AU45_r\n1, 0.5\n2, 5\n");
  const ern_sound sound = {.data = (int16_t *)(uintptr_t)samples, .frames = 8, .rate = 16000, .channels = 1};
  FUZZ_REQUIRE(ern_sound_write_wav(context, "made.wav", &sound) == ERN_OK);
  FILE *wav = fopen("made.wav", "rb");
  FUZZ_REQUIRE(wav != NULL);
  keep(good, 6, text, fread(text, 1, sizeof text, wav));
  fclose(wav);
  for (int file = 7; file < 11; file++) keep_picture(good, context, file, file < 9 ? 3 : 4);
  text[0] = 0;
  for (int i = 0; i < 68; i++) snprintf(text + strlen(text), sizeof text - strlen(text), "%d %d.5\n", i % 8, i / 9);
  for (int file = 11; file < 13; file++) keep_text(good, file, text);
  keep_numbers(good, 13, "2, 2, 16, 16", 2 * ERN_MOTION_VALUES);
  const char *const folders[] = {"clip", "clip/gt_imgs", "clip/torso_imgs", "clip/ori_imgs"};
  for (size_t i = 0; i < 4; i++) mkdir(folders[i], 0755);
}

/* The folder as the input says. */
static void lay_out(struct good *good, const uint8_t *bytes, size_t count) {
  char path[64];
  const unsigned gone = count >= 2 ? (unsigned)bytes[0] | (unsigned)bytes[1] << 8 : 0;
  for (int file = 0; file < FILES; file++) {
    path_of(file, path);
    if ((gone >> file & 1) != 0) {
      unlink(path);
    } else if (good->spoiled[file]) {
      fuzz_file(path, good->bytes[file], good->count[file]);
    }
    good->spoiled[file] = (gone >> file & 1) != 0;
  }
  for (size_t at = 2; at + 3 <= count;) {
    const int file = bytes[at] % FILES;
    size_t length = (size_t)bytes[at + 1] | (size_t)bytes[at + 2] << 8;
    at += 3;
    if (length > count - at) length = count - at;
    path_of(file, path);
    fuzz_file(path, bytes + at, length);
    good->spoiled[file] = true;
    at += length;
  }
}

static void look_at(ern_context *context, ern_clip *clip) {
  ern_clip_info info;
  ern_dataset data;
  ern_image truth, torso;
  ern_clip_describe(clip, &info);
  ern_clip_dataset(clip, &data);
  for (int split = 0; split < 2; split++) {
    for (size_t i = 0; i < info.frames[split]; i++) {
      ern_dataset_frame frame;
      FUZZ_REQUIRE(data.frame(data.user, split, i, &frame) == ERN_OK);
      FUZZ_REQUIRE(frame.eye >= 0 && frame.eye <= 1 && frame.aud_id < (int64_t)data.features->windows);
      for (int k = 0; k < ERN_MOTION_VALUES; k++) FUZZ_REQUIRE(fabsf(frame.torso_motion[k]) <= 1e3f);
      if (ern_clip_pixels(clip, (ern_split)split, i, &truth, &torso) != ERN_OK) {
        fuzz_refused(context, "clip/");
        continue;
      }
      FUZZ_REQUIRE(truth.width == info.width && truth.height == info.height);
      fuzz_touch(truth.data, (size_t)truth.width * (size_t)truth.height * 3);
    }
  }
}

static void say(void *user, int ok, const char *sentence) {
  (void)ok;
  *(size_t *)user += strlen(sentence);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  static struct good good;
  ern_context *context = fuzz_context();
  ern_clip *clip = NULL;
  size_t said = 0;
  if (good.bytes[0] == NULL) make(&good, context);
  lay_out(&good, bytes, count);
  const ern_status opened = ern_clip_open(context, "clip", NULL, &clip);
  if (opened == ERN_OK)
    look_at(context, clip);
  else
    fuzz_refused(context, "clip");
  const ern_status checked = ern_clip_check(context, "clip", say, &said);
  FUZZ_REQUIRE(said > 0);
  if (opened == ERN_OK && checked != ERN_OK) /* readable, but nothing that a mouth could follow */
    FUZZ_REQUIRE(strstr(ern_last_error(context), "the same in every window") != NULL);
  ern_clip_free(&clip);
  return 0;
}
