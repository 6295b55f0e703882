/* SPDX-License-Identifier: MIT
 * A program that uses every public struct that may grow, through the public headers alone. test_growth.sh builds it
 * twice, once with headers whose structs lack their last members, and holds what it prints against each other. Every
 * struct that the library fills lies between guard bytes. Usage: growth CLIP FOLDER */
#include <ernerf/ernerf.h>
#include <ernerf/live.h>
#include <ernerf/media.h>
#include <ernerf/prepare.h>
#include <ernerf/stream.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { GUARD = 256, SIDE = 64, STEPS = 3 };

#define NEED(call)                                                                              \
  do {                                                                                          \
    const ern_status answer = (call);                                                           \
    if (answer != ERN_OK) {                                                                     \
      fprintf(stderr, "%s: %s: %s\n", #call, ern_status_name(answer), ern_last_error(context)); \
      exit(1);                                                                                  \
    }                                                                                           \
  } while (0)

/* A struct `name->it` between guards; UNTOUCHED ends the program where one of these has changed. They are volatile, as
 * a compiler may take it that a function that is given `it` leaves them alone. */
#define GUARDED(type, name)                        \
  static struct {                                  \
    volatile unsigned char before[GUARD];          \
    type it;                                       \
    volatile unsigned char after[GUARD];           \
  } name##_guarded, *const name = &name##_guarded; \
  memset((void *)name, 0xa5, sizeof *name)
#define UNTOUCHED(name)                                                                               \
  for (int i = 0; i < GUARD; i++)                                                                     \
    if (name->before[i] != 0xa5 || name->after[i] != 0xa5) {                                          \
      fprintf(stderr, "%s: %zu bytes, and a byte beside them was written\n", #name, sizeof name->it); \
      exit(1);                                                                                        \
    }

static uint64_t hash(const void *bytes, size_t count) { /* FNV-1a */
  uint64_t sum = 0xcbf29ce484222325u;
  for (size_t i = 0; i < count; i++) sum = (sum ^ ((const unsigned char *)bytes)[i]) * 0x100000001b3u;
  return sum;
}

/* ---- callbacks --------------------------------------------------------------------------------------------------- */

static void say_device(void *user, const ern_device_info *device) {
  (void)user;
  printf("device %s %d\n", device->kind, device->number);
}
static void say_tuning(void *user, const ern_tuning *tuning) {
  (void)user;
  printf("tuning %s\n", tuning->name);
}
static void say_tensor(void *user, const ern_tensor_info *tensor) {
  (void)user;
  printf("tensor %s %s\n", tensor->name, tensor->dtype);
}
/* Called now and then, and at the end. */
static int say_progress(void *user, const ern_train_report *report) {
  *(uint64_t *)user = report->step;
  return report->iters != STEPS;
}

/* The frames of a clip, as a program of its own would hand them over. */
static ern_status give_frame(void *user, int split, size_t index, ern_dataset_frame *frame) {
  const ern_clip_frame *from = ern_clip_frame_at(user, (ern_split)split, index);
  memcpy(frame->matrix, from->pose.matrix, sizeof frame->matrix);
  frame->aud_id = from->pose.aud_id;
  return ERN_OK;
}
static ern_status give_pixels(void *user, int split, size_t index, const uint8_t **truth, const uint8_t **torso) {
  ern_image picture;
  const ern_status status = ern_clip_pixels(user, (ern_split)split, index, &picture, NULL);
  *truth = picture.data;
  *torso = NULL;
  return status;
}

/* ---- each header ------------------------------------------------------------------------------------------------- */

static ern_backend *open_backend(ern_context *context) {
  ern_backend *backend = NULL;
  GUARDED(ern_backend_config, config);
  GUARDED(ern_backend_info, info);
  ern_backend_config_fill(&config->it, sizeof config->it);
  NEED(ern_backend_create(&backend, context, &config->it));
  ern_backend_describe(backend, &info->it);
  ern_backend_tuning(backend, say_tuning, NULL);
  NEED(ern_devices_list(context, say_device, NULL));
  UNTOUCHED(config);
  UNTOUCHED(info);
  printf("backend %s %s\n", info->it.name, info->it.isa);
  return backend;
}

static ern_clip *open_clip(ern_context *context, const char *folder) {
  ern_clip *clip = NULL;
  GUARDED(ern_clip_options, options);
  GUARDED(ern_clip_info, info);
  GUARDED(ern_clip_measures, measures);
  GUARDED(ern_dataset, dataset);
  ern_clip_options_fill(&options->it, sizeof options->it);
  NEED(ern_clip_open(context, folder, &options->it, &clip));
  ern_clip_describe(clip, &info->it);
  NEED(ern_clip_measure(clip, &measures->it));
  ern_clip_dataset(clip, &dataset->it);
  UNTOUCHED(options);
  UNTOUCHED(info);
  UNTOUCHED(measures);
  UNTOUCHED(dataset);
  printf("clip %d x %d, %zu frames, eyes to %g, scale %g\n", info->it.width, info->it.height, measures->it.frames,
         (double)measures->it.eye_high, (double)dataset->it.scale);
  return clip;
}

static ern_model *train(ern_context *context, ern_backend *backend, ern_clip *clip, const char *path) {
  ern_trainer *trainer = NULL;
  ern_model *model = NULL;
  ern_clip_info info;
  GUARDED(ern_train_config, config);
  GUARDED(ern_train_report, report);
  GUARDED(ern_train_state, state);
  GUARDED(ern_model_info, about);
  uint64_t told = 0;
  const ern_train_hooks hooks = {.user = &told, .progress = say_progress};
  ern_clip_describe(clip, &info);
  const ern_dataset dataset = {.user = clip,
                               .frames = {info.frames[0], info.frames[1]},
                               .focal = info.focal,
                               .cx = info.cx,
                               .cy = info.cy,
                               .width = info.width,
                               .height = info.height,
                               .scale = 4,
                               .features = ern_clip_features(clip),
                               .background = ern_clip_background(clip)->data,
                               .frame = give_frame,
                               .pixels = give_pixels};
  ern_train_config_fill(&config->it, sizeof config->it);
  const ern_setting *setting = NULL;
  for (size_t i = 0; (setting = ern_train_setting(i)) != NULL; i++)
    if (strcmp(setting->name, "iters") == 0) printf("%s at %zu\n", setting->name, setting->at);
  config->it.output = path;
  config->it.iters = STEPS;
  config->it.rays = 256;
  config->it.validate_frames = 1;
  NEED(ern_trainer_create(&trainer, backend, &dataset, &config->it));
  NEED(ern_trainer_step(trainer, &report->it));
  printf("step %" PRIu64 ": loss %.9g\n", report->it.step, report->it.loss);
  NEED(ern_trainer_run(trainer, &hooks));
  ern_trainer_describe(trainer, &report->it);
  printf("trained %" PRIu64 " steps, told of %" PRIu64 "\n", report->it.step, told);
  ern_trainer_free(&trainer);
  NEED(ern_train_state_describe(context, path, &state->it, &about->it));
  printf("state of step %" PRIu64 ", levels %d\n", state->it.step, about->it.levels);
  NEED(ern_model_load(&model, context, path));
  ern_model_describe(model, &about->it);
  printf("model: features %d wide\n", about->it.feature_width);
  NEED(ern_file_tensors(context, path, say_tensor, NULL));
  UNTOUCHED(config);
  UNTOUCHED(report);
  UNTOUCHED(state);
  UNTOUCHED(about);
  return model;
}

/* The frame's windows of a speech that is pushed: the same picture as from the clip. */
static void live(ern_context *context, ern_renderer *renderer, const ern_features *features, size_t window,
                 const ern_frame_input *input, const ern_frame_output *output) {
  ern_live *session = NULL;
  const ern_live_frame *frame = NULL;
  bool ended = false;
  GUARDED(ern_live_options, options);
  ern_live_options_fill(&options->it, sizeof options->it);
  options->it.window_length = features->window_length;
  options->it.width = features->width;
  NEED(ern_live_open(context, &options->it, &session));
  for (size_t t = 0; t <= window; t++) {
    NEED(ern_live_push_windows(session, features->data + t * (size_t)features->window_length * (size_t)features->width,
                               1));
    if (t == window) NEED(ern_live_end(session));
    NEED(ern_live_pull(session, 0, &frame, &ended));
  }
  if (frame != NULL) NEED(ern_live_draw(frame, renderer, input, output, NULL));
  printf("live frame %d, %016" PRIx64 "\n", frame != NULL ? (int)frame->number : -1,
         hash(output->rgba, SIDE * SIDE * 4));
  ern_live_free(&session);
  UNTOUCHED(options);
}

/* Pictures and sound out and in again. */
static void stream(ern_context *context, const uint8_t *rgba) {
  static const float sound[1920] = {0};
  float heard[256];
  size_t frames = 0;
  ern_stream_writer *writer = NULL;
  ern_sound_reader *reader = NULL;
  GUARDED(ern_stream_options, out);
  GUARDED(ern_sound_reader_options, in);
  ern_stream_options_fill(&out->it, sizeof out->it);
  out->it.width = out->it.height = SIDE;
  out->it.sound_rate = 48000;
  out->it.sound_channels = 1;
  NEED(ern_stream_writer_open(context, "stream.nut", &out->it, &writer));
  NEED(ern_stream_writer_frame(writer, rgba, sound, 1920));
  NEED(ern_stream_writer_close(&writer));
  ern_sound_reader_options_fill(&in->it, sizeof in->it);
  NEED(ern_sound_reader_open(context, "stream.nut", &in->it, &reader));
  NEED(ern_sound_reader_read(reader, heard, 256, &frames));
  printf("heard %d\n", frames > 0);
  ern_sound_reader_free(&reader);
  remove("stream.nut");
  UNTOUCHED(out);
  UNTOUCHED(in);
}

static void render(ern_context *context, ern_backend *backend, const ern_model *model, ern_clip *clip,
                   const char *path) {
  static uint8_t rgba[SIDE * SIDE * 4];
  static float rgb[SIDE * SIDE * 3];
  const ern_features *features = ern_clip_features(clip);
  const ern_clip_frame *frame = ern_clip_frame_at(clip, ERN_SPLIT_VAL, 0);
  float *windows = malloc((size_t)8 * (size_t)features->window_length * (size_t)features->width * sizeof *windows);
  ern_renderer *renderer = NULL;
  ern_video_writer *writer = NULL;
  ern_video_reader *reader = NULL;
  ern_clip_info info;
  GUARDED(ern_render_options, options);
  GUARDED(ern_frame_times, times);
  GUARDED(ern_ray_reuse_work, work);
  GUARDED(ern_video_options, video);
  GUARDED(ern_video_info, about);
  GUARDED(ern_provenance, provenance);
  if (windows == NULL) exit(1);
  ern_clip_describe(clip, &info);
  ern_render_options_fill(&options->it, sizeof options->it);
  NEED(ern_renderer_create(&renderer, backend, model, &options->it));
  NEED(ern_renderer_reuse_rays(renderer, NULL, 0, NULL, 0, 0));
  ern_audio_windows(windows, features, frame->pose.aud_id, ERN_AUDIO_PAD_EDGE);
  const ern_camera camera = {.focal = (float)info.focal,
                             .cx = (float)info.cx,
                             .cy = (float)info.cy,
                             .width = info.width,
                             .height = info.height};
  ern_frame_input input = {
      .camera = ern_camera_resized(&camera, SIDE, SIDE), .windows = windows, .window_length = features->window_length};
  const ern_frame_output output = {.rgba = rgba, .rgb = rgb};
  ern_camera_pose(input.camera.pose, frame->pose.matrix, 4);
  NEED(ern_renderer_frame(renderer, &input, &output, &times->it));
  ern_renderer_ray_reuse_work_sized(renderer, &work->it, sizeof work->it);
  printf("frame %016" PRIx64 " %016" PRIx64 ", %" PRIu64 " counted, in time: %d\n", hash(rgba, sizeof rgba),
         hash(rgb, sizeof rgb), ern_renderer_ray_reuse_work(renderer).frames, times->it.audio >= 0);
  live(context, renderer, features, 6, &input, &output);
  stream(context, rgba);
  ern_video_options_fill(&video->it, sizeof video->it);
  video->it.width = video->it.height = SIDE;
  ern_provenance_fill(&provenance->it, sizeof provenance->it);
  provenance->it.all_trained = true;
  NEED(ern_image_write_provenance(context, "provenance.png", &(ern_image){SIDE, SIDE, 4, rgba}, 100, &provenance->it));
  NEED(ern_video_writer_open(context, path, &video->it, &writer));
  NEED(ern_video_writer_frame(writer, rgba));
  NEED(ern_video_writer_close(&writer));
  NEED(ern_video_reader_open(context, path, &reader));
  ern_video_reader_info(reader, &about->it);
  printf("video %d x %d, %d/%d\n", about->it.width, about->it.height, about->it.rate_numerator,
         about->it.rate_denominator);
  ern_video_reader_free(&reader);
  ern_renderer_free(&renderer);
  free(windows);
  UNTOUCHED(options);
  UNTOUCHED(times);
  UNTOUCHED(work);
  UNTOUCHED(video);
  UNTOUCHED(about);
}

/* A frame without a face, which stays as recorded. */
static void dub(ern_context *context) {
  static uint8_t recorded[SIDE * SIDE * 3], rgba[SIDE * SIDE * 4];
  for (size_t i = 0; i < sizeof recorded; i++) recorded[i] = (uint8_t)i;
  ern_dub_input input = {.recorded = recorded, .width = SIDE, .height = SIDE, .square = {0, 0, SIDE, SIDE}};
  int box[4];
  bool drawn = true;
  NEED(ern_dub_box(context, &input, box));
  NEED(ern_dub_frame(context, &input, rgba, &drawn));
  printf("dub %d %d %016" PRIx64 "\n", box[2], drawn, hash(rgba, sizeof rgba));
}

#ifdef ERN_PREPARE
/* The video of `render` has no face: one step, which says so. */
static void prepare(ern_context *context, const char *video, const char *folder) {
  GUARDED(ern_prepare_options, options);
  GUARDED(ern_prepare_result, result);
  ern_prepare_options_fill(&options->it, sizeof options->it);
  options->it.side = 128;
  const ern_status status = ern_prepare(context, video, folder, &options->it, &result->it);
  printf("prepared: %s, %zu frames\n", ern_status_name(status), result->it.frames);
  UNTOUCHED(options);
  UNTOUCHED(result);
}
#endif

int main(int count, char **words) {
  char model_path[4096], video_path[4096];
  ern_context *context = NULL;
  GUARDED(ern_context_config, config);
  if (count != 3) return 2;
  snprintf(model_path, sizeof model_path, "%s/model.safetensors", words[2]);
  snprintf(video_path, sizeof video_path, "%s/video.mp4", words[2]);
  ern_context_config_fill(&config->it, sizeof config->it);
  UNTOUCHED(config);
  NEED(ern_context_create(&context, &config->it));
  ern_backend *backend = open_backend(context);
  ern_clip *clip = open_clip(context, words[1]);
  ern_model *model = train(context, backend, clip, model_path);
  render(context, backend, model, clip, video_path);
#ifdef ERN_PREPARE
  char prepared_path[4096];
  snprintf(prepared_path, sizeof prepared_path, "%s/prepared", words[2]);
  prepare(context, video_path, prepared_path);
#endif
  ern_model_free(&model);
  ern_clip_free(&clip);
  ern_backend_free(&backend);
  dub(context);
  ern_context_free(&context);
  return 0;
}
