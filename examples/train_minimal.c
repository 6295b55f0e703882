/* SPDX-License-Identifier: MIT
 * A portrait trained on frames that the program makes itself: a ball with a mouth that opens with the "speech", seen by
 * a camera that moves. Uses libernerf alone; a program with footage of its own fills an ern_dataset in the same way.
 *
 *   cc -std=c17 train_minimal.c $(pkg-config --cflags --libs libernerf) -lm -o train_minimal
 *   ./train_minimal FOLDER [STEPS]
 *
 * 1000 steps unless told otherwise: the ball is there after a hundred, the mouth follows the speech after some
 * hundreds. Writes to FOLDER, which must be there: ball.safetensors, and speech.npy and poses.json for render_minimal.
 */
#include <ernerf/ernerf.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { SIDE = 64, TRAIN = 40, VALIDATE = 5, FRAMES = TRAIN + VALIDATE, VECTORS = 16, WIDTH = 4, PATH_BYTES = 4096 };

static const float focal = 150, radius = 0.4f, distance = 3.2f; /* pixels; scene units */
static const float world_scale = 4;                             /* of the poses' translations, as in public clips */

struct scene {
  float matrix[FRAMES][16]; /* camera to world: x right, y up, z toward the camera */
  float opening[FRAMES];    /* of the mouth, 0..1 */
  float speech[FRAMES][VECTORS][WIDTH];
  uint8_t background[SIDE * SIDE * 3];
  uint8_t truth[SIDE * SIDE * 3]; /* of the frame asked for last */
};

/* How far the mouth is open at `time`, in frames. */
static float opening_at(float time) { return 0.5f - 0.5f * cosf(0.25f * time); }

static void make_scene(struct scene *scene) {
  for (int f = 0; f < FRAMES; f++) {
    const float turn = 0.35f * sinf(0.9f * (float)f), c = cosf(turn), s = sinf(turn);
    const float back = distance / world_scale;
    const float matrix[16] = {c, 0, s, s * back, 0, 1, 0, 0, -s, 0, c, c * back, 0, 0, 0, 1};
    memcpy(scene->matrix[f], matrix, sizeof matrix);
    scene->opening[f] = opening_at((float)f);
    for (int v = 0; v < VECTORS; v++) { /* 50 vectors a second around the frame's moment, 25 frames a second */
      const float open = opening_at((float)f + ((float)v - 7.5f) / 2);
      const float values[WIDTH] = {8 * open - 4, 4 - 8 * open, 4 * open * open, 1}; /* about as large as real ones */
      memcpy(scene->speech[f][v], values, sizeof values);
    }
  }
  for (int i = 0; i < SIDE * SIDE; i++) {
    scene->background[3 * i] = 40;
    scene->background[3 * i + 1] = (uint8_t)(60 + 2 * (i / SIDE));
    scene->background[3 * i + 2] = 110;
  }
}

/* The colour of the ball where a ray leaves the camera in direction d (world axes); 0 where it misses. */
static int ball_colour(const float origin[3], const float d[3], float opening, uint8_t rgb[3]) {
  const float dd = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
  const float od = origin[0] * d[0] + origin[1] * d[1] + origin[2] * d[2];
  const float oo = origin[0] * origin[0] + origin[1] * origin[1] + origin[2] * origin[2];
  const float inside = od * od - dd * (oo - radius * radius);
  if (inside < 0) return 0;
  const float t = (-od - sqrtf(inside)) / dd;
  float n[3];
  for (int a = 0; a < 3; a++) n[a] = (origin[a] + t * d[a]) / radius;
  const float across = n[0] / 0.35f, along = (n[1] + 0.3f) / (0.03f + 0.2f * opening);
  const int mouth = n[2] > 0 && across * across + along * along < 1;
  const float shade = 0.55f + 0.45f * n[1];
  rgb[0] = mouth ? 90 : (uint8_t)(230 * shade);
  rgb[1] = mouth ? 10 : (uint8_t)(170 * shade);
  rgb[2] = mouth ? 20 : (uint8_t)(60 + 60 * n[0]);
  return 1;
}

/* ---- the dataset: two functions that the trainer calls ---- */

static ern_status give_frame(void *user, int split, size_t index, ern_dataset_frame *frame) {
  const struct scene *scene = user;
  const size_t f = split == 0 ? index : TRAIN + index;
  *frame = (ern_dataset_frame){.aud_id = (int64_t)f, .has_face = true, .face = {SIDE / 4, SIDE - 8, 8, SIDE - 8}};
  memcpy(frame->matrix, scene->matrix[f], sizeof frame->matrix);
  return ERN_OK;
}

static ern_status give_pixels(void *user, int split, size_t index, const uint8_t **truth, const uint8_t **torso) {
  struct scene *scene = user;
  const size_t f = split == 0 ? index : TRAIN + index;
  const float *m = scene->matrix[f];
  const float origin[3] = {m[3] * world_scale, m[7] * world_scale, m[11] * world_scale};
  for (int i = 0; i < SIDE * SIDE; i++) {
    const float right = ((float)(i % SIDE) + 0.5f - SIDE / 2) / focal,
                up = -((float)(i / SIDE) + 0.5f - SIDE / 2) / focal;
    float d[3];
    for (int a = 0; a < 3; a++) d[a] = m[4 * a] * right + m[4 * a + 1] * up - m[4 * a + 2];
    uint8_t *pixel = scene->truth + 3 * i;
    if (!ball_colour(origin, d, scene->opening[f], pixel)) memcpy(pixel, scene->background + 3 * i, 3);
  }
  *truth = scene->truth;
  *torso = NULL;
  return ERN_OK;
}

/* ---- what the trainer tells ---- */

static int say_progress(void *user, const ern_train_report *report) {
  (void)user;
  printf("step %llu of %llu: loss %.5f, PSNR %.2f dB\n", (unsigned long long)report->step,
         (unsigned long long)report->iters, report->loss, report->psnr);
  return 0;
}

static ern_status say_validation(void *user, uint64_t step, double psnr, size_t frames, const uint8_t *picture,
                                 int width, int height, const char *name) {
  (void)picture, (void)width, (void)height, (void)name;
  *(double *)user = psnr;
  printf("step %llu: PSNR %.2f dB over %zu frames that were not trained on\n", (unsigned long long)step, psnr, frames);
  return ERN_OK;
}

/* ---- files for render_minimal ---- */

static int write_speech(const struct scene *scene, const char *path) {
  char header[118];
  FILE *file = fopen(path, "wb");
  if (file == NULL) return 0;
  const int used = snprintf(header, sizeof header, "{'descr': '<f4', 'fortran_order': False, 'shape': (%d, %d, %d), }",
                            FRAMES, VECTORS, WIDTH);
  memset(header + used, ' ', sizeof header - (size_t)used);
  header[sizeof header - 1] = '\n';
  fwrite("\x93NUMPY\x01\x00\x76\x00", 1, 10, file); /* version 1.0, a header of 0x76 bytes */
  fwrite(header, 1, sizeof header, file);
  fwrite(scene->speech, 1, sizeof scene->speech, file);
  return fclose(file) == 0;
}

static int write_poses(const struct scene *scene, const char *path) {
  FILE *file = fopen(path, "wb");
  if (file == NULL) return 0;
  fprintf(file, "{\"focal_len\": %g, \"cx\": %d, \"cy\": %d, \"frames\": [", (double)focal, SIDE / 2, SIDE / 2);
  for (int f = 0; f < FRAMES; f++) {
    fprintf(file, "%s\n{\"img_id\": %d, \"aud_id\": %d, \"transform_matrix\": [", f > 0 ? "," : "", f, f);
    for (int i = 0; i < 16; i++)
      fprintf(file, "%s%.9g%s", i % 4 == 0 ? "[" : "", (double)scene->matrix[f][i],
              i == 15      ? "]"
              : i % 4 == 3 ? "],"
                           : ",");
    fprintf(file, "]}");
  }
  fprintf(file, "]}\n");
  return fclose(file) == 0;
}

int main(int count, char **words) {
  if (count != 2 && count != 3) {
    fprintf(stderr, "usage: %s FOLDER [STEPS]\n", words[0]);
    return 2;
  }
  static struct scene scene;
  char model_path[PATH_BYTES], speech_path[PATH_BYTES], poses_path[PATH_BYTES];
  snprintf(model_path, sizeof model_path, "%s/ball.safetensors", words[1]);
  snprintf(speech_path, sizeof speech_path, "%s/speech.npy", words[1]);
  snprintf(poses_path, sizeof poses_path, "%s/poses.json", words[1]);
  make_scene(&scene);
  if (!write_speech(&scene, speech_path) || !write_poses(&scene, poses_path)) {
    fprintf(stderr, "%s: cannot be written to\n", words[1]);
    return 1;
  }
  const ern_features speech = {
      .data = &scene.speech[0][0][0], .windows = FRAMES, .window_length = VECTORS, .width = WIDTH};
  const ern_dataset dataset = {.user = &scene,
                               .frames = {TRAIN, VALIDATE},
                               .focal = (double)focal,
                               .cx = SIDE / 2.0,
                               .cy = SIDE / 2.0,
                               .width = SIDE,
                               .height = SIDE,
                               .scale = world_scale,
                               .features = &speech,
                               .background = scene.background,
                               .frame = give_frame,
                               .pixels = give_pixels};
  ern_train_config config = ern_train_config_default();
  config.output = model_path;
  config.iters = count == 3 ? strtoull(words[2], NULL, 10) : 1000;
  config.rays = 512;

  double psnr = 0;
  const ern_train_hooks hooks = {.user = &psnr, .progress = say_progress, .validation = say_validation};
  ern_context *context = NULL;
  ern_backend *backend = NULL;
  ern_trainer *trainer = NULL;
  ern_status status = ern_context_create(&context, NULL);
  if (status == ERN_OK) status = ern_backend_create(&backend, context, NULL);
  if (status == ERN_OK) status = ern_trainer_create(&trainer, backend, &dataset, &config);
  if (status == ERN_OK) status = ern_trainer_run(trainer, &hooks); /* validates and saves at the end */
  if (status == ERN_OK)
    printf("%s: PSNR %.2f dB\n", model_path, psnr);
  else
    fprintf(stderr, "%s: %s\n", ern_status_name(status), ern_last_error(context));
  ern_trainer_free(&trainer);
  ern_backend_free(&backend);
  ern_context_free(&context);
  return status == ERN_OK ? 0 : 1;
}
