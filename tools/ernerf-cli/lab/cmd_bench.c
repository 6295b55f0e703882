/* SPDX-License-Identifier: MIT
 * ernerf bench: measures the machine's peaks, and how much of them kernels, a frame and a training step use. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "lab/bench_report.h"
#include "session/background.h"
#include "session/portrait.h"
#include "session/progress.h"
#include "verbs.h"

enum { AUDIO_WINDOWS = 8, LANDMARKS = 68, OWN_OPTIONS = 7, PLACE_OPTIONS = 4, NAME_BYTES = 128, SIDE = 450 };
static const double restless = 1.3; /* limit of median / least time of a compute-bound loop */
enum only { ONLY_ALL, ONLY_PEAKS, ONLY_KERNELS, ONLY_FRAME, ONLY_STEP };
enum place { PLACE_CPU, PLACE_OPENCL, PLACE_ALL };

/* Shares of the time of --seconds. */
static const struct { double peaks, kernels, frame, step, torso_step; } part = {0.1, 0.45, 0.2, 0.17, 0.08};

struct bench_job {
  struct session session;
  struct portrait portrait;
  struct frame_source frame_source;
  struct background background;
  /* from the command line */
  const char *isas;
  struct dimensions size;
  int only, frames, rays, place;
  float seconds;
  /* made */
  ern_backend *backends[ERN_BENCH_BACKENDS];
  size_t count;
  ern_bench_scene *scene;
  float *windows;
  ern_image truth;
  struct progress progress;
  bool terminal;
  char cpu[NAME_BYTES], sets[NAME_BYTES], device[NAME_BYTES], driver[NAME_BYTES];
  struct bench_results results;
};

/* ---- backends ---------------------------------------------------------------------------------------------------- */

static void take_names(void *user, const ern_device_info *device) {
  struct bench_job *job = user;
  if (strcmp(device->kind, "cpu") == 0) {
    snprintf(job->cpu, sizeof job->cpu, "%s", device->name);
    snprintf(job->sets, sizeof job->sets, "%s", device->instruction_sets);
  } else if (device->number == job->session.device) {
    snprintf(job->device, sizeof job->device, "%s", device->name);
    snprintf(job->driver, sizeof job->driver, "%s", device->driver);
  }
}

static int open_backend(struct bench_job *job, const ern_backend_config *config) {
  if (ern_backend_create(&job->backends[job->count], job->session.context, config) != ERN_OK)
    return session_fail(&job->session);
  job->count++;
  return 0;
}

static int open_isa(struct bench_job *job, const char *name) {
  ern_backend_config config = ern_backend_config_default();
  const size_t most = ERN_BENCH_BACKENDS - (job->place == PLACE_ALL);
  for (size_t k = 0; k < job->count; k++) {
    ern_backend_info info;
    ern_backend_describe(job->backends[k], &info);
    if (strcmp(info.isa, name) == 0) return session_fail_with(&job->session, "--isa names %s twice", name);
  }
  if (job->count == most) return session_fail_with(&job->session, "--isa names more than %zu instruction sets", most);
  config.name = "cpu";
  config.isa = name;
  return open_backend(job, &config);
}

/* Opens --isa; else all instruction sets of the machine except ref64, which is only for checking; if a device is
 * measured too, only the best one. */
static int open_isas(struct bench_job *job) {
  const char *list = job->isas, *cut = ",";
  if (list == NULL && job->place == PLACE_ALL) return open_isa(job, "auto");
  if (list == NULL) {
    list = job->sets;
    cut = " ";
  }
  for (const char *at = list; *at != 0;) {
    char name[NAME_BYTES];
    const size_t bytes = strcspn(at, cut);
    snprintf(name, sizeof name, "%.*s", (int)bytes, at);
    at += bytes + (at[bytes] != 0);
    if (job->isas == NULL && strcmp(name, "ref64") == 0) continue;
    const int status = open_isa(job, name);
    if (status != 0) return status;
  }
  return 0;
}

/* Opens the CPU's backends first, the device last. */
static int open_backends(struct bench_job *job) {
  ern_backend_config config = ern_backend_config_default();
  int status = 0;
  if (ern_devices_list(job->session.context, take_names, job) != ERN_OK) return session_fail(&job->session);
  if (job->place != PLACE_OPENCL) status = open_isas(job);
  if (job->place == PLACE_CPU || status != 0) return status;
  config.name = "opencl";
  config.device = job->session.device;
  return open_backend(job, &config);
}

/* ---- the scene --------------------------------------------------------------------------------------------------- */

/* Bounding box of the landmarks, clipped to the picture; without landmarks the whole picture. */
static ern_box face_of(const ern_clip_frame *frame, int width, int height) {
  ern_box box = {.top = height, .bottom = 0, .left = width, .right = 0};
  for (int i = 0; i < LANDMARKS && frame->has_landmarks; i++) {
    const float x = frame->landmarks[i][0], y = frame->landmarks[i][1];
    if (!(x >= 0 && x < (float)width && y >= 0 && y < (float)height)) continue;
    if ((int)x < box.left) box.left = (int)x;
    if ((int)x + 1 > box.right) box.right = (int)x + 1;
    if ((int)y < box.top) box.top = (int)y;
    if ((int)y + 1 > box.bottom) box.bottom = (int)y + 1;
  }
  return box.top < box.bottom && box.left < box.right ? box : (ern_box){0, height, 0, width};
}

/* Makes the scene from the first frame of the clip. */
static int scene_of_clip(struct bench_job *job) {
  struct portrait *portrait = &job->portrait;
  struct session *session = &job->session;
  const ern_clip_info *info = &portrait->clip_info;
  const ern_features *features = ern_clip_features(portrait->clip);
  const uint8_t *torso = NULL;
  float refined[16];
  int status = frame_source_of_clip(&job->frame_source, session, portrait->clip, FRAME_SOURCE_ALL);
  if (status == 0)
    status =
        background_open(&job->background, session, NULL, portrait->clip, info->width, info->height, ERN_FIT_CONTAIN);
  if (status != 0) return status;
  const struct source_frame *source_frame = &job->frame_source.source_frame[0];
  if (ern_renderer_accepts(portrait->renderer, features, portrait->features_path) != ERN_OK)
    return session_fail(session);
  if (background_torso(&job->background, session, portrait->clip, source_frame->split, source_frame->index, &torso) !=
      0)
    return EXIT_FAILURE;
  job->windows =
      malloc((size_t)AUDIO_WINDOWS * (size_t)features->window_length * (size_t)features->width * sizeof(float));
  if (job->windows == NULL) return session_fail_with(session, "no memory for a window of speech");
  frame_source_windows(&job->frame_source, 0, features, (ern_audio_pad)portrait->audio_pad, job->windows);
  if (ern_clip_pixels(portrait->clip, source_frame->split, source_frame->index, &job->truth, NULL) != ERN_OK)
    return session_fail(session);
  const ern_camera camera =
      frame_source_camera(&job->frame_source, 0, portrait->scale, info->width, info->height, ERN_FIT_CONTAIN);
  const ern_frame_input frame = {.camera = camera,
                                 .head_pose = portrait_refined(portrait, &job->frame_source, 0, refined),
                                 .windows = job->windows,
                                 .window_length = features->window_length,
                                 .eye = source_frame->eye,
                                 .background = job->background.image.data,
                                 .torso = torso};
  const ern_box face =
      face_of(ern_clip_frame_at(portrait->clip, source_frame->split, source_frame->index), info->width, info->height);
  if (ern_bench_scene_of(&job->scene, session->context, portrait->model, &frame, job->truth.data, &face) != ERN_OK)
    return session_fail(session);
  return 0;
}

static int open_scene(struct bench_job *job, const struct args *args) {
  struct session *session = &job->session;
  job->results.model = job->portrait.model_path;
  job->results.clip = job->portrait.source.path;
  if (job->portrait.model_path == NULL) {
    if (ern_bench_scene_make(&job->scene, session->context, job->size.width, job->size.height, session->seed) != ERN_OK)
      return session_fail(session);
    return 0;
  }
  const int status = portrait_open(&job->portrait, session, args);
  return status == 0 ? scene_of_clip(job) : status;
}

/* ---- measuring --------------------------------------------------------------------------------------------------- */

static int at_part(void *user, size_t done, size_t all) {
  struct bench_job *job = user;
  if (job->terminal) progress_at(&job->progress, done, all, "");
  return session_interrupted();
}

static ern_bench_options options_of(struct bench_job *job, double seconds) {
  ern_bench_options options = ern_bench_options_default();
  options.threads = job->session.threads;
  options.seconds = seconds;
  options.frames = job->frames;
  options.rays = job->rays;
  options.seed = job->session.seed;
  options.progress = at_part;
  options.user = job;
  return options;
}

static void begin(struct bench_job *job, const char *what, const char *unit) {
  if (job->terminal) progress_begin(&job->progress, &job->session, what, unit);
}
static int end(struct bench_job *job, ern_status status) {
  if (job->terminal) progress_end(&job->progress);
  if (status == ERN_E_CANCELLED && session_interrupted())
    return session_stop_with(&job->session, "%s", ern_last_error(job->session.context));
  return status == ERN_OK ? 0 : session_fail(&job->session);
}

static bool wants(const struct bench_job *job, enum only part_of) {
  return job->only == ONLY_ALL || job->only == (int)part_of;
}

/* Scales the shares so that the requested parts use the whole time. */
static double stretched(const struct bench_job *job, double of) {
  double all = part.peaks;
  if (wants(job, ONLY_KERNELS)) all += part.kernels;
  if (wants(job, ONLY_FRAME)) all += part.frame;
  if (wants(job, ONLY_STEP)) all += part.step + (job->results.scene.has_torso ? part.torso_step : 0);
  return (double)job->seconds * of / all;
}

static int measure_peaks(struct bench_job *job) {
  const ern_bench_options options = options_of(job, stretched(job, part.peaks));
  begin(job, "bench: peaks", "parts");
  const int status = end(job, ern_bench_peaks(job->backends, job->count, &options, &job->results.machine));
  if (status == 0 && job->results.machine.unrest > restless)
    session_warn(
        &job->session,
        "other programs use the %s too: the same loop took %.2f times its least time; figures come out too low",
        job->place == PLACE_OPENCL ? "device" : "processor", job->results.machine.unrest);
  if (status == 0 && !session_json_on_stdout(&job->session)) bench_print_peaks(&job->results);
  return status;
}

static int take_kernel(void *user, const ern_bench_kernel *kernel) {
  struct bench_results *results = user;
  ern_bench_kernel *more = realloc(results->kernels, (results->kernel_count + 1) * sizeof *more);
  if (more == NULL) return 1;
  results->kernels = more;
  more[results->kernel_count++] = *kernel;
  return 0;
}

static int measure_kernels(struct bench_job *job) {
  const ern_bench_options options = options_of(job, stretched(job, part.kernels));
  begin(job, "bench: kernels", "kernels");
  const int status = end(job, ern_bench_kernels(job->backends, job->count, job->scene, &job->results.machine, &options,
                                                take_kernel, &job->results));
  if (status == 0 && !session_json_on_stdout(&job->session)) bench_print_kernels(&job->results);
  return status;
}

static int measure_frame(struct bench_job *job) {
  const ern_bench_options options = options_of(job, stretched(job, part.frame));
  begin(job, "bench: a frame", "parts");
  const int status = end(
      job, ern_bench_frame(job->backends, job->count, job->scene, &job->results.machine, &options, job->results.frame));
  job->results.has_frame = status == 0;
  if (status == 0 && !session_json_on_stdout(&job->session))
    bench_print_passes(&job->results, "a frame", job->results.frame);
  return status;
}

static int measure_step(struct bench_job *job, bool torso) {
  struct bench_results *results = &job->results;
  const ern_bench_options options = options_of(job, stretched(job, torso ? part.torso_step : part.step));
  ern_bench_pass *passes = torso ? results->torso_step : results->step;
  begin(job, torso ? "bench: a step of the torso" : "bench: a step of the head", "parts");
  const int status =
      end(job, ern_bench_step(job->backends, job->count, job->scene, &results->machine, &options, torso, passes));
  *(torso ? &results->has_torso_step : &results->has_step) = status == 0;
  if (status == 0 && !session_json_on_stdout(&job->session))
    bench_print_passes(results, torso ? "a step of the torso" : "a step of the head", passes);
  return status;
}

/* Counts the samples of the scene on the CPU's last, fastest backend, so that a device need not build kernels for this.
 */
static int describe(struct bench_job *job) {
  struct session *session = &job->session;
  if (job->place == PLACE_OPENCL && session->backend == NULL && session_backend(session) != ERN_OK)
    return session_fail(session);
  ern_backend *cpu = session->backend;
  if (job->place != PLACE_OPENCL) cpu = job->backends[job->count - 1 - (job->place == PLACE_ALL)];
  if (ern_bench_scene_describe(job->scene, cpu, session->threads, &job->results.scene) != ERN_OK)
    return session_fail(session);
  return 0;
}

static int tradeoff_measure_all(struct bench_job *job) {
  struct bench_results *results = &job->results;
  struct session *session = &job->session;
  results->cpu = job->place != PLACE_OPENCL ? job->cpu : NULL;
  if (job->place != PLACE_CPU) results->device = (struct bench_device){job->device, job->driver, session->device};
  results->backends = job->count;
  int status = describe(job);
  if (status == 0 && !session_json_on_stdout(session)) bench_print_scene(results);
  if (status == 0) status = measure_peaks(job);
  if (status == 0 && wants(job, ONLY_KERNELS)) status = measure_kernels(job);
  if (status == 0 && wants(job, ONLY_FRAME)) status = measure_frame(job);
  if (status == 0 && wants(job, ONLY_STEP)) status = measure_step(job, false);
  if (status == 0 && wants(job, ONLY_STEP) && results->scene.has_torso) status = measure_step(job, true);
  return status == 0 ? session_report(session, bench_json(results)) : status;
}

/* ---- the verb ---------------------------------------------------------------------------------------------------- */

static void close_all(struct bench_job *job) {
  ern_bench_scene_free(&job->scene);
  free(job->results.kernels);
  free(job->windows);
  background_free(&job->background, &job->session);
  frame_source_free(&job->frame_source);
  portrait_close(&job->portrait);
  for (size_t k = 0; k < job->count; k++) ern_backend_free(&job->backends[k]);
  session_close(&job->session);
}

static void own_options(struct bench_job *job, struct option options[OWN_OPTIONS]) {
  struct session *session = &job->session;
  const struct option rows[] = {
      {ARGS_CHOICE("only", &job->only, "all|peaks|kernels|frame|step"),
       .help = "what to measure; the peaks always are (default all)"},
      {ARGS_FLOAT("seconds", &job->seconds, 0, 86400),
       .help = "seconds for all measurements, about: a measurement that takes longer is made once nevertheless"},
      {ARGS_INT("frames", &job->frames, 1, 1000), .help = "maximum number of repeats of a frame"},
      {ARGS_INT("rays", &job->rays, 1, 1 << 20),
       .help = "rays of a training step, and of kernels where a device is measured"},
      {ARGS_DIMENSIONS("size", &job->size, 1, 8192), .help = "size of the made-up frame (default 450x450)"},
      {ARGS_FLAG("force", &job->portrait.force), .help = "use the model although it was trained on another clip"},
      {ARGS_COUNT("seed", &session->seed, 0, 0), .help = "seed of the made-up scene and of the rays"}};
  ARGS_FILL(options, rows, OWN_OPTIONS);
}

static void place_options(struct bench_job *job, struct option options[PLACE_OPTIONS]) {
  struct session *session = &job->session;
  const struct option rows[] = {
      {ARGS_CHOICE("backend", &job->place, "cpu|opencl|all"),
       .help = "what is measured; all: both, in turns, and how many times as fast the device is (default cpu)"},
      {ARGS_INT("device", &session->device, 0, 255),
       .help = "number of an OpenCL device, as `ernerf info devices` counts; with --backend opencl or all"},
      {ARGS_TEXT("isa", &job->isas), .choices = "LIST",
       .help = "instruction sets of the CPU, with commas between (default all that the machine has, but ref64; with "
               "--backend all the best)"},
      {ARGS_INT("threads", &session->threads, 0, ERN_THREADS_MOST),
       .help = "threads of the CPU for a frame and a step; kernels are measured on one thread, but with --backend "
               "all on all of them (default 0: one a core)"}};
  ARGS_FILL(options, rows, PLACE_OPTIONS);
}

static int check_words(const struct bench_job *job, const struct args *args) {
  int status = -1;
  if (job->place == PLACE_OPENCL)
    status = args_forbid(args, "isa threads", "is of the CPU, which --backend opencl leaves out");
  if (status >= 0) return status;
  if (job->portrait.model_path != NULL && job->portrait.source.path == NULL)
    return args_refuse(args, "CLIP is missing: a model is measured on a frame of its clip");
  if (job->portrait.model_path != NULL) return args_forbid(args, "size", "is of the made-up frame; a clip has its own");
  status = args_forbid(args, "force", "needs MODEL CLIP");
  if (status < 0 && job->only != ONLY_ALL && job->only != ONLY_FRAME)
    status = args_forbid(args, "frames", "repeats a frame, which --only leaves out");
  /* if a device is measured too, kernels get a step's samples */
  const bool kernels = job->only == ONLY_KERNELS && job->place != PLACE_CPU;
  if (status < 0 && job->only != ONLY_ALL && job->only != ONLY_STEP && !kernels)
    status = args_forbid(args, "rays", "is of a training step, which --only leaves out");
  return status;
}

int cmd_bench(int argc, char **argv) {
  struct bench_job job = {.size = {SIDE, SIDE}, .frames = 16, .rays = 65536, .seconds = 30};
  struct option own[OWN_OPTIONS], place[PLACE_OPTIONS], unused[PORTRAIT_OPTIONS], common[SESSION_OUTPUT_OPTIONS];
  struct word words[] = {{.name = "MODEL", .target = &job.portrait.model_path, .help = "a .safetensors or .pth file"},
                         {.name = "CLIP", .target = &job.portrait.source.path, .help = "the clip it was trained on"}};
  struct args args = {
      .verb = "bench",
      .summary =
          "Measures the peaks of a machine or device, and each kernel, a frame and a training step against them.",
      .usage = "bench [--only kernels] [--backend opencl] [--json FILE.json]\nbench MODEL CLIP",
      .notes =
          "Without MODEL CLIP a made-up scene is measured, which needs no files. Times are the minimum and the median "
          "of\n"
          "repeats; what is compared takes turns. FLOP: a multiply-add counts as two. docs/bench.md explains the "
          "columns.",
      .words = words,
      .word_count = 2,
      .optional_words = 2,
      .groups = {{"What and how:", own, OWN_OPTIONS},
                 {"Where:", place, PLACE_OPTIONS},
                 {"Common:", common, SESSION_OUTPUT_OPTIONS}}};
  portrait_options(&job.portrait, FRAME_SOURCE_ALL, unused);
  job.portrait.torso = PORTRAIT_TORSO_MODEL;
  own_options(&job, own);
  place_options(&job, place);
  session_output_options(&job.session, common);
  int status = args_parse(&args, argc, argv);
  if (status < 0) status = check_words(&job, &args);
  if (job.place != PLACE_CPU) job.session.backend_choice = SESSION_OPENCL;
  job.session.beside_cpu = job.place == PLACE_ALL;
  job.session.inputs[0] = job.portrait.model_path;
  job.session.inputs[1] = job.portrait.source.path;
  if (status < 0) status = session_open(&job.session, &args);
  if (status >= 0) return status;
  job.session.backend_choice = SESSION_CPU; /* for reading and counting the scene; measured backends are separate */
  job.terminal = isatty(STDERR_FILENO) != 0;
  status = open_backends(&job);
  if (status == 0) status = open_scene(&job, &args);
  if (status == 0) status = tradeoff_measure_all(&job);
  close_all(&job);
  return status;
}
