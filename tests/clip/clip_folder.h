/* SPDX-License-Identifier: MIT
 * A clip made by hand, file by file. */
#ifndef ERN_TESTS_CLIP_FOLDER_H
#define ERN_TESTS_CLIP_FOLDER_H

#include "../support.h"
#include "ernerf/media.h"
#include "io/file.h"
#include "io/npy.h"

enum { WIDTH = 24, HEIGHT = 16, TRAIN = 4, VAL = 2, FRAMES = TRAIN + VAL };

/* `count` frames from `first` on; the aud_id is the img_id. */
static inline void write_transforms(const char *path, int first, int count, double focal) {
  FILE *file = fopen(path, "w");
  assert_non_null(file);
  fprintf(file, "{\"focal_len\": %.6f, \"cx\": %d, \"cy\": %d, \"frames\": [", focal, WIDTH / 2, HEIGHT / 2);
  for (int i = first; i < first + count; i++) {
    fprintf(file,
            "%s{\"img_id\": %d, \"aud_id\": %d, \"transform_matrix\": "
            "[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, %d], [0, 0, 0, 1]]}",
            i > first ? ", " : "", i, i, i);
  }
  fprintf(file, "]}");
  assert_int_equal(fclose(file), 0);
}

/* A picture of one colour that tells the frame: with k = frame + 1 it is (10 k, 20 k, 30 k), alpha 40 k. */
static inline void write_picture(ern_context *context, const char *path, int width, int height, int channels,
                                 int frame) {
  ern_image image = {.width = width, .height = height, .channels = channels};
  const size_t bytes = (size_t)(width * height * channels);
  image.data = malloc(bytes);
  assert_non_null(image.data);
  for (size_t i = 0; i < bytes; i++) image.data[i] = (uint8_t)((int)(i % (size_t)channels + 1) * 10 * (frame + 1));
  assert_int_equal(ern_image_write(context, path, &image, 100), ERN_OK);
  free(image.data);
}

static inline void write_landmarks(const char *path, int count, int frame) {
  FILE *file = fopen(path, "w");
  assert_non_null(file);
  for (int i = 0; i < count; i++) fprintf(file, "%d.25 %d\n", i % WIDTH, frame);
  assert_int_equal(fclose(file), 0);
}

static inline void write_features(ern_context *context, const char *path, size_t windows, size_t length, size_t width) {
  float *data = calloc(windows * length * width, sizeof *data);
  assert_non_null(data);
  for (size_t t = 0; t < windows; t++) data[t * length * width] = (float)(t % 2); /* speech changes */
  assert_int_equal(ern_npy_write_f32(context, path, data, 3, (const size_t[]){windows, length, width}), ERN_OK);
  free(data);
}

static inline void write_blink(const char *path, const char *header, int rows) {
  FILE *file = fopen(path, "w");
  assert_non_null(file);
  fprintf(file, "%s\n", header);
  for (int i = 0; i < rows; i++) fprintf(file, "%d, %.2f\n", i + 1, i * 0.75);
  assert_int_equal(fclose(file), 0);
}

static inline const char *in_folder(const char *folder, const char *name) {
  static char path[256];
  snprintf(path, sizeof path, "%s/%s", folder, name);
  return path;
}

static inline void write_clip(ern_context *context, const char *folder) {
  static const char *const parts[] = {"gt_imgs", "torso_imgs", "ori_imgs"};
  char name[64];
  for (int i = 0; i < 3; i++) assert_int_equal(ern_folder_make(context, in_folder(folder, parts[i])), ERN_OK);
  write_transforms(in_folder(folder, "transforms_train.json"), 0, TRAIN, 100);
  write_transforms(in_folder(folder, "transforms_val.json"), TRAIN, VAL, 100);
  for (int i = 0; i < FRAMES; i++) {
    snprintf(name, sizeof name, "gt_imgs/%d.jpg", i);
    write_picture(context, in_folder(folder, name), WIDTH, HEIGHT, 3, i);
    snprintf(name, sizeof name, "torso_imgs/%d.png", i);
    write_picture(context, in_folder(folder, name), WIDTH, HEIGHT, 4, i);
    snprintf(name, sizeof name, "ori_imgs/%d.lms", i);
    write_landmarks(in_folder(folder, name), 68, i);
  }
  write_picture(context, in_folder(folder, "bc.jpg"), WIDTH, HEIGHT, 3, 5);
  write_features(context, in_folder(folder, "aud_ds.npy"), FRAMES, 16, 29);
  write_blink(in_folder(folder, "au.csv"), "frame, AU45_r", FRAMES);
  static const int16_t silence[FRAMES * 640];
  const ern_sound sound = {.rate = 16000, .channels = 1, .frames = FRAMES * 640, .data = (int16_t *)silence};
  assert_int_equal(ern_sound_write_wav(context, in_folder(folder, "aud.wav"), &sound), ERN_OK);
}

#endif
