/* SPDX-License-Identifier: MIT
 * A model, speech features and head poses in; frames out. Uses libernerf alone, no media library.
 *
 *   cc -std=c17 render_minimal.c $(pkg-config --cflags --libs libernerf) -o render_minimal
 *   ernerf features speech.wav -o speech.npy          (for a model of the built-in speech features)
 *   ./render_minimal portrait.safetensors speech.npy transforms_val.json frames.rgba
 *
 * frames.rgba: one frame after the other, 8-bit RGBA, transparent where there is no portrait. A name that ends in .ppm
 * gives portable pixmaps instead, one after the other, over grey. */
#include <ernerf/ernerf.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { GREY = 96, NEIGHBOURS = 8 };

struct job {
  ern_renderer *renderer;
  ern_model_info model; /* how it was trained to be seen */
  ern_features speech;
  ern_pose_list poses;
  float *windows;      /* [NEIGHBOURS][window_length][width] of one frame */
  uint8_t *rgba;       /* [height][width][4] of one frame */
  uint8_t *background; /* [height][width][3]; NULL: transparent */
};

static int write_ppm(FILE *file, const uint8_t *rgba, int width, int height) {
  fprintf(file, "P6\n%d %d\n255\n", width, height);
  for (size_t i = 0; i < (size_t)width * (size_t)height; i++) fwrite(rgba + 4 * i, 1, 3, file);
  return ferror(file);
}

/* Frame t of the video: window t of the speech, and the pose that belongs to it; poses run back and forth when the
 * speech is longer. */
static ern_status render_frame(struct job *job, size_t t) {
  const ern_pose_list *poses = &job->poses;
  const ern_pose *pose = &poses->poses[ern_pose_index(t, poses->count)];
  ern_audio_windows(job->windows, &job->speech, (int64_t)t, job->model.audio_pad);
  ern_frame_input input = {
      .camera = {.focal = (float)poses->focal,
                 .cx = (float)poses->cx,
                 .cy = (float)poses->cy,
                 .width = poses->width,
                 .height = poses->height},
      .windows = job->windows,
      .window_length = job->speech.window_length,
      .individual = ERN_INDIVIDUAL_MEAN,
      .background = job->background,
  };
  ern_camera_pose(input.camera.pose, pose->matrix, job->model.scale);
  const ern_frame_output output = {.rgba = job->rgba};
  return ern_renderer_frame(job->renderer, &input, &output, NULL);
}

static ern_status render_all(struct job *job, const char *path) {
  const int width = job->poses.width, height = job->poses.height;
  const size_t pixels = (size_t)width * (size_t)height;
  const size_t length = strlen(path);
  const int pixmaps = length > 4 && strcmp(path + length - 4, ".ppm") == 0;
  ern_status status = ERN_OK;
  FILE *file = fopen(path, "wb");
  job->windows =
      calloc((size_t)NEIGHBOURS * (size_t)job->speech.window_length * (size_t)job->speech.width, sizeof(float));
  job->rgba = malloc(4 * pixels);
  if (pixmaps) job->background = malloc(3 * pixels);
  if (job->windows == NULL || job->rgba == NULL || (pixmaps && job->background == NULL)) status = ERN_E_NO_MEMORY;
  if (file == NULL) status = ERN_E_IO;
  if (status == ERN_OK && pixmaps) memset(job->background, GREY, 3 * pixels);
  for (size_t t = 0; status == ERN_OK && t < job->speech.windows; t++) {
    status = render_frame(job, t);
    if (status != ERN_OK) break;
    if (pixmaps ? write_ppm(file, job->rgba, width, height) : fwrite(job->rgba, 4, pixels, file) != pixels)
      status = ERN_E_IO;
  }
  if (file != NULL && fclose(file) != 0 && status == ERN_OK) status = ERN_E_IO;
  if (status == ERN_E_IO) fprintf(stderr, "%s: cannot be written\n", path);
  return status;
}

int main(int count, char **words) {
  if (count != 5) {
    fprintf(stderr, "usage: %s MODEL.safetensors FEATURES.npy POSES.json OUT.rgba|OUT.ppm\n", words[0]);
    return 2;
  }
  ern_context *context = NULL;
  ern_backend *backend = NULL;
  ern_model *model = NULL;
  struct job job = {0};
  ern_status status = ern_context_create(&context, NULL);
  if (status == ERN_OK) status = ern_backend_create(&backend, context, NULL);
  if (status == ERN_OK) status = ern_model_load(&model, context, words[1]);
  if (status == ERN_OK) ern_model_describe(model, &job.model);
  if (status == ERN_OK) status = ern_renderer_create(&job.renderer, backend, model, NULL);
  if (status == ERN_OK) status = ern_features_load(context, words[2], &job.speech);
  if (status == ERN_OK) status = ern_renderer_accepts(job.renderer, &job.speech, words[2]);
  if (status == ERN_OK) status = ern_pose_list_load(context, words[3], &job.poses);
  if (status == ERN_OK) status = render_all(&job, words[4]);
  if (status == ERN_OK)
    printf("%s: %zu frames of %d x %d\n", words[4], job.speech.windows, job.poses.width, job.poses.height);
  else
    fprintf(stderr, "%s: %s\n", ern_status_name(status), ern_last_error(context));

  free(job.windows);
  free(job.rgba);
  free(job.background);
  ern_features_free(context, &job.speech);
  ern_pose_list_free(context, &job.poses);
  ern_renderer_free(&job.renderer);
  ern_model_free(&model);
  ern_backend_free(&backend);
  ern_context_free(&context);
  return status == ERN_OK ? 0 : 1;
}
