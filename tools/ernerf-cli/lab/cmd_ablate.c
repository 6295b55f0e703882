/* SPDX-License-Identifier: MIT
 * ernerf ablate: the paper's ablation on the user's clip. Every row is trained with the same steps, rays and seeds,
 * evaluated on the same frames, and drawn in turns with the others. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "ernerf/media.h"
#include "ernerf/train.h"
#include "evaluation/evaluate.h"
#include "lab/ablation.h"
#include "session/clip_source.h"
#include "session/pareto.h"
#include "session/progress.h"
#include "verbs.h"

enum { OWN_OPTIONS = 9 + CLIP_SOURCE_OPTIONS, PATH_BYTES = 4096 };

struct ablate_job {
  struct session session;
  struct clip_source source;
  const char *folder, *only;
  uint64_t iters;
  int rays, seeds, repeats;
  float lr_net;
  struct range frames;
  bool resume;
  /* made */
  ern_clip *clip;
  struct evaluation evaluation;
  struct ablation result;
  ern_model *model[ABLATION_ROWS]; /* model of the first seed, with its renderer */
  ern_renderer *renderer[ABLATION_ROWS];
  struct progress progress;
};

/* ---- words ------------------------------------------------------------------------------------------------------- */

static void own_options(struct ablate_job *job, struct option options[OWN_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_TEXT("o", &job->folder), .alias = "output", .choices = "DIR",
       .help = "the tables and all models; made where it is missing"},
      {ARGS_COUNT("iters", &job->iters, 1, 1e12), .help = "training steps of each model"},
      {ARGS_INT("rays", &job->rays, 1, 1048576), .alias = "num_rays", .help = "rays a step"},
      {ARGS_FLOAT("lr-net", &job->lr_net, 1e-9, 10),
       .help = "learning rate of the networks, as in train; with few steps a higher one is needed for lips that follow "
               "the speech"},
      {ARGS_INT("seeds", &job->seeds, 1, ABLATION_SEEDS),
       .help = "number of trainings of each row, with seeds from --seed on: their spread shows which differences may "
               "be chance"},
      {ARGS_TEXT("only", &job->only), .choices = "ROW,...",
       .help = "these rows alone: mlp-concat, triplane-concat, triplane-channel, hash3d-concat, hash3d-channel, "
               "trihash-concat, trihash-feature, trihash-channel"},
      {ARGS_RANGE("frames", &job->frames), .help = "evaluate validation frames [A, B) alone"},
      {ARGS_INT("repeats", &job->repeats, 3, ABLATION_TIMES),
       .help = "number of times that each row renders a frame for timing, in turns with the others"},
      {ARGS_FLAG("resume", &job->resume), .help = "go on with the trainings in DIR"}};
  ARGS_FILL(options, rows, OWN_OPTIONS - CLIP_SOURCE_OPTIONS);
  clip_source_options(&job->source, options + sizeof rows / sizeof *rows);
}

static const struct ablation_kind *kind_named(const char *name, size_t length) {
  for (int i = 0; i < ABLATION_ROWS; i++)
    if (strlen(ablation_kinds[i].name) == length && strncmp(ablation_kinds[i].name, name, length) == 0)
      return &ablation_kinds[i];
  return NULL;
}

/* Rows in the order of the table, whatever their order on the command line. */
static int choose_rows(struct ablate_job *job, const struct args *args) {
  bool chosen[ABLATION_ROWS] = {false};
  for (const char *at = job->only; at != NULL && *at != 0;) {
    const size_t length = strcspn(at, ",");
    const struct ablation_kind *kind = kind_named(at, length);
    if (kind == NULL)
      return args_refuse(args, "--only: there is no row \"%.*s\"", (int)(length < 60 ? length : 60), at);
    chosen[kind - ablation_kinds] = true;
    at += length + (at[length] == ',');
  }
  for (int i = 0; i < ABLATION_ROWS; i++)
    if (job->only == NULL || chosen[i])
      job->result.row[job->result.rows++] =
          (struct ablation_row){.kind = &ablation_kinds[i], .seeds = (size_t)job->seeds};
  return -1;
}

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static void take_processor(void *user, const ern_device_info *device) {
  struct ablate_job *job = user;
  if (strcmp(device->kind, "cpu") != 0) return;
  snprintf(job->result.processor, sizeof job->result.processor, "%s", device->name);
  if (job->result.threads == 0) job->result.threads = (int)device->compute_units;
}

/* DIR/trihash-channel.safetensors; with several seeds DIR/trihash-channel-s0.safetensors. */
static int path_of(struct ablate_job *job, const struct ablation_row *row, uint64_t seed, char path[PATH_BYTES]) {
  const int written =
      job->seeds > 1 ? snprintf(path, PATH_BYTES, "%s/%s-s%" PRIu64 ".safetensors", job->folder, row->kind->name, seed)
                     : snprintf(path, PATH_BYTES, "%s/%s.safetensors", job->folder, row->kind->name);
  return written < PATH_BYTES ? 0 : session_fail_with(&job->session, "%s: the name is too long", job->folder);
}

/* Replaces no file of an earlier ablation without --overwrite; --resume continues it. */
/* The tables of an earlier call are rewritten, so they must not be symbolic links or inputs. */
static int check_tables(struct ablate_job *job) {
  char path[PATH_BYTES];
  struct stat about;
  for (size_t i = 0; i < ABLATION_FILES; i++) {
    if (snprintf(path, sizeof path, "%s/%s", job->folder, ablation_files[i]) >= (int)sizeof path)
      return session_fail_with(&job->session, "%s: the name is too long", job->folder);
    if (lstat(path, &about) == 0 && !S_ISREG(about.st_mode))
      return session_fail_with(&job->session, "%s: is no regular file, expected a table of an earlier call, or nothing",
                               path);
    if (session_check_not_inputs(&job->session, path) != 0 || session_check_distinct_output(&job->session, path) != 0)
      return EXIT_FAILURE;
  }
  return 0;
}

static int check_outputs(struct ablate_job *job) {
  char path[PATH_BYTES];
  struct stat about;
  const bool again = job->resume && !job->session.overwrite; /* ablation_check_earlier checks the rows */
  for (size_t r = 0; again && r < job->result.rows; r++)
    for (int seed = 0; seed < job->seeds; seed++) {
      if (path_of(job, &job->result.row[r], job->session.seed + (uint64_t)seed, path) != 0) return EXIT_FAILURE;
      if (lstat(path, &about) == 0 && S_ISLNK(about.st_mode))
        return session_fail_with(&job->session, "%s: is a symbolic link, expected a model of an earlier call", path);
    }
  if (again) return check_tables(job) != 0 ? EXIT_FAILURE : session_check_json_not_input(&job->session, job->folder);
  for (size_t r = 0; r < job->result.rows; r++)
    for (int seed = 0; seed < job->seeds; seed++)
      if (path_of(job, &job->result.row[r], job->session.seed + (uint64_t)seed, path) != 0 ||
          session_check_outputs(&job->session, job->folder, &(const char *){path + strlen(job->folder) + 1}, 1) != 0)
        return EXIT_FAILURE;
  if (session_check_outputs(&job->session, job->folder, ablation_files, ABLATION_FILES) != 0) return EXIT_FAILURE;
  return session_check_json_not_input(&job->session, job->folder);
}

static int open_all(struct ablate_job *job, const struct args *args) {
  struct session *session = &job->session;
  if (check_outputs(job) != 0) return EXIT_FAILURE;
  const int opened = clip_source_open(&job->source, session, &job->clip);
  speech_model_close(&job->source.speech_model);
  if (opened != 0) return EXIT_FAILURE;
  int status = evaluate_open(&job->evaluation, session, job->clip, FRAME_SOURCE_VAL, 4, ERN_AUDIO_PAD_EDGE);
  if (status == 0 && args_given(args, "frames"))
    status = frame_source_cut(&job->evaluation.frame_source, args, &job->frames);
  if (status == 0) status = session_folder(session, job->folder);
  if (status != 0) return status;
  if (session_backend(session) != ERN_OK) return session_fail(session);
  struct ablation *result = &job->result;
  result->threads = session->threads;
  if (ern_devices_list(session->context, take_processor, job) != ERN_OK) return session_fail(session);
  result->clip = job->source.path;
  result->width = job->evaluation.info.width;
  result->height = job->evaluation.info.height;
  result->rays = job->rays;
  result->lr_net = job->lr_net;
  result->seed = job->session.seed;
  result->iters = job->iters;
  result->frames = job->evaluation.frame_source.count;
  if (job->resume && !session->overwrite && ablation_check_earlier(result, session, job->folder) != 0)
    return EXIT_FAILURE;
  result->backend = session->backend_info.name;
  result->isa = session->backend_info.isa;
  return 0;
}

/* ---- training ---------------------------------------------------------------------------------------------------- */

static int say_progress(void *user, const ern_train_report *report) {
  struct ablate_job *job = user;
  char more[64];
  job->progress.rate = report->steps_per_second;
  snprintf(more, sizeof more, "loss %.5g  PSNR %.2f", report->loss, report->psnr);
  progress_at(&job->progress, report->step, report->iters, more);
  return session_interrupted();
}

/* A resumed training must belong to the table: it must have the same rays, rate and seed as all rows. */
static int check_state(struct ablate_job *job, const char *path, uint64_t seed) {
  ern_train_state state;
  ern_model_info info;
  if (!job->resume) return 0;
  const ern_status status = ern_train_state_describe(job->session.context, path, &state, &info);
  if (status == ERN_E_MISSING) return 0;
  if (status != ERN_OK) return session_fail(&job->session);
  if (state.rays == job->rays && state.seed == seed && (!state.has_settings || state.lr_net == job->lr_net)) return 0;
  return session_fail_with(&job->session,
                           "%s: was trained with %d rays, --lr-net %g and seed %" PRIu64
                           ", expected %d, %g and %" PRIu64 ", as all rows",
                           path, state.rays, (double)state.lr_net, state.seed, job->rays, (double)job->lr_net, seed);
}

/* *seconds: training time of the model, without saving and validation. */
static ern_status train(struct ablate_job *job, const struct ablation_row *row, uint64_t seed, const char *path,
                        double *seconds) {
  ern_train_config config = ern_train_config_default();
  const ern_train_hooks hooks = {.user = job, .progress = say_progress};
  ern_train_report report = {0};
  ern_trainer *trainer = NULL;
  ern_dataset dataset;
  ern_clip_dataset(job->clip, &dataset);
  config.output = path;
  config.resume = job->resume;
  config.overwrite = job->session.overwrite;
  config.iters = job->iters;
  config.rays = job->rays;
  config.lr_net = job->lr_net;
  config.lr_att = 5 * job->lr_net;
  config.backbone = row->kind->backbone;
  config.attention = row->kind->attention;
  config.voice_fade = false; /* as published; `concat` could not have it */
  config.seed = seed;
  config.threads = job->session.threads;
  config.validate_every = 0;
  config.validate_frames = 1;
  ern_status status = ern_trainer_create(&trainer, job->session.backend, &dataset, &config);
  if (status == ERN_OK) status = ern_trainer_run(trainer, &hooks);
  if (status == ERN_OK) ern_trainer_describe(trainer, &report);
  ern_trainer_free(&trainer);
  *seconds = report.seconds;
  return status;
}

/* ---- evaluation -------------------------------------------------------------------------------------------------- */

/* Evaluates all frames with one model, and puts means and deviations into the row. values: scratch, 3 for each frame.
 */
static int evaluate_frames(struct ablate_job *job, struct ablation_row *row, size_t seed, const ern_model *model,
                           ern_renderer *renderer, double *values) {
  const size_t frames = job->evaluation.frame_source.count;
  double *psnr = values, *ssim = values + frames, *mouth = values + 2 * frames;
  size_t mouths = 0;
  for (size_t k = 0; k < frames; k++) {
    struct evaluated evaluated;
    if (session_interrupted()) return session_stop_with(&job->session, "stopped; --resume goes on");
    if (evaluate_frame(&job->evaluation, renderer, model, k, &evaluated) != 0) return EXIT_FAILURE;
    psnr[k] = evaluated.psnr;
    ssim[k] = evaluated.ssim;
    if (evaluated.has_mouth) mouth[mouths++] = evaluated.mouth;
  }
  const struct mean_and_deviation of_psnr = mean_of(psnr, frames), of_ssim = mean_of(ssim, frames),
                                  of_mouth = mouths > 0 ? mean_of(mouth, mouths) : (struct mean_and_deviation){0, 0};
  const double part = 1 / (double)row->seeds;
  row->has_mouth = mouths > 0;
  row->psnr[seed] = of_psnr.mean;
  row->ssim[seed] = of_ssim.mean;
  row->mouth[seed] = of_mouth.mean;
  row->psnr_frames += part * of_psnr.deviation;
  row->ssim_frames += part * of_ssim.deviation;
  row->mouth_frames += part * of_mouth.deviation;
  return 0;
}

static int evaluate_row(struct ablate_job *job, struct ablation_row *row, size_t seed, const ern_model *model,
                        ern_renderer *renderer) {
  double *values = malloc(3 * job->evaluation.frame_source.count * sizeof *values);
  if (values == NULL)
    return session_fail_with(&job->session, "no memory for %zu frames", job->evaluation.frame_source.count);
  const int status = evaluate_frames(job, row, seed, model, renderer, values);
  free(values);
  return status;
}

static int open_model(struct ablate_job *job, const char *path, ern_model **model, ern_renderer **renderer) {
  struct session *session = &job->session;
  ern_render_options options = ern_render_options_default();
  options.threads = session->threads;
  if (ern_model_load(model, session->context, path) != ERN_OK ||
      ern_renderer_create(renderer, session->backend, *model, &options) != ERN_OK)
    return session_fail(session);
  return 0;
}

/* Trains and evaluates one model; the model of the first seed is kept for timing. */
static int run_one(struct ablate_job *job, size_t r, size_t seed) {
  struct session *session = &job->session;
  struct ablation_row *row = &job->result.row[r];
  char path[PATH_BYTES], what[64];
  ern_model *model = NULL;
  ern_renderer *renderer = NULL;
  if (path_of(job, row, session->seed + seed, path) != 0 || check_state(job, path, session->seed + seed) != 0)
    return EXIT_FAILURE;
  snprintf(what, sizeof what, "%s (%zu of %zu)", row->kind->name, r * row->seeds + seed + 1,
           job->result.rows * row->seeds);
  progress_begin(&job->progress, session, what, "steps");
  const ern_status trained = train(job, row, session->seed + seed, path, &row->seconds[seed]);
  progress_end(&job->progress);
  if (trained == ERN_E_CANCELLED && session_interrupted())
    return session_stop_with(session, "stopped; the state is saved, --resume goes on");
  if (trained != ERN_OK) return session_fail(session);
  int status = open_model(job, path, &model, &renderer);
  if (status == 0) status = evaluate_row(job, row, seed, model, renderer);
  if (status == 0)
    session_note(session, "%s, seed %" PRIu64 ": PSNR %.2f dB, SSIM %.4f, mouth %.2f dB, %.1f s of training",
                 row->kind->name, session->seed + seed, row->psnr[seed], row->ssim[seed], row->mouth[seed],
                 row->seconds[seed]);
  if (status == 0 && seed == 0) {
    job->model[r] = model;
    job->renderer[r] = renderer;
    return 0;
  }
  ern_renderer_free(&renderer);
  ern_model_free(&model);
  return status;
}

/* ---- time, size, collisions -------------------------------------------------------------------------------------- */

/* Times frames in turns: each row draws a frame, then each draws the next one; the first round is a warm-up. */
static int take_turns(struct ablate_job *job) {
  struct ablation *result = &job->result;
  progress_begin(&job->progress, &job->session, "drawing in turns", "rounds");
  for (size_t turn = 0; turn <= (size_t)job->repeats; turn++) {
    for (size_t r = 0; r < result->rows; r++) {
      struct evaluated evaluated;
      if (session_interrupted()) return session_stop_with(&job->session, "stopped; --resume goes on");
      if (evaluate_draw(&job->evaluation, job->renderer[r], job->model[r], turn % job->evaluation.frame_source.count,
                        &evaluated) != 0)
        return EXIT_FAILURE;
      if (turn > 0) result->row[r].ms[result->row[r].times++] = evaluated.ms;
    }
    progress_at(&job->progress, turn, (uint64_t)job->repeats, "");
  }
  progress_end(&job->progress);
  return 0;
}

/* Counts hash collisions for the samples of the first frame. */
static int count_collisions(struct ablate_job *job, const ern_model *model) {
  struct session *session = &job->session;
  const struct source_frame *source_frame = &job->evaluation.frame_source.source_frame[0];
  ern_frame_input input;
  ern_image truth = {0};
  ern_bench_scene *scene = NULL;
  if (ern_clip_pixels(job->clip, source_frame->split, source_frame->index, &truth, NULL) != ERN_OK)
    return session_fail(session);
  if (evaluate_input(&job->evaluation, model, 0, &input) != 0) return EXIT_FAILURE;
  ern_status status = ern_bench_scene_of(&scene, session->context, model, &input, truth.data, NULL);
  if (status == ERN_OK) status = ern_bench_collisions(session->backend, scene, &job->result.collisions);
  ern_bench_scene_free(&scene);
  job->result.counted = status == ERN_OK;
  return status == ERN_OK ? 0 : session_fail(session);
}

static int count_row(struct ablate_job *job, size_t r) {
  struct ablation_row *row = &job->result.row[r];
  const bool own = row->kind->backbone == ERN_BACKBONE_TRIHASH && row->kind->attention == ERN_ATTENTION_CHANNEL;
  ern_model_info about;
  struct stat file;
  char path[PATH_BYTES];
  ern_model_describe(job->model[r], &about);
  row->parameters = about.parameters;
  row->sample_flops = ern_bench_sample_flops(job->model[r]);
  if (path_of(job, row, job->session.seed, path) != 0) return EXIT_FAILURE;
  row->bytes = stat(path, &file) == 0 ? (size_t)file.st_size : 0;
  row->fused = own && strncmp(job->session.backend_info.isa, "ref", 3) != 0;
  return own ? count_collisions(job, job->model[r]) : 0;
}

/* ---- the verb ---------------------------------------------------------------------------------------------------- */

static int run(struct ablate_job *job) {
  struct session *session = &job->session;
  struct ablation *result = &job->result;
  session_note(session, "ablate: %zu rows of %" PRIu64 " steps of %d rays, %d seed%s, on %s (%s); writes %s",
               result->rows, job->iters, job->rays, job->seeds, job->seeds == 1 ? "" : "s", result->backend,
               result->isa, job->folder);
  for (size_t r = 0; r < result->rows; r++)
    for (size_t seed = 0; seed < (size_t)job->seeds; seed++)
      if (run_one(job, r, seed) != 0) return EXIT_FAILURE;
  if (take_turns(job) != 0) return EXIT_FAILURE;
  for (size_t r = 0; r < result->rows; r++)
    if (count_row(job, r) != 0) return EXIT_FAILURE;
  session_stage(session);
  if (session_write_staged(session, ablation_write(result, session, job->folder)) != 0) return EXIT_FAILURE;
  if (!session_json_on_stdout(session)) {
    struct bytes text = {0};
    ablation_text(result, &text);
    if (!text.failed) fwrite(text.data, 1, text.count, stdout);
    bytes_free(&text);
  }
  return session->json != NULL ? session_report(session, ablation_json(result)) : 0;
}

static void close_all(struct ablate_job *job) {
  for (int r = 0; r < ABLATION_ROWS; r++) {
    ern_renderer_free(&job->renderer[r]);
    ern_model_free(&job->model[r]);
  }
  evaluate_close(&job->evaluation);
  ern_clip_free(&job->clip);
  session_close(&job->session);
}

int cmd_ablate(int argc, char **argv) {
  struct ablate_job job = {
      .lr_net = ern_train_config_default().lr_net, .iters = 2000, .rays = 4096, .seeds = 1, .repeats = 15};
  struct option own[OWN_OPTIONS], common[SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS + SESSION_SEED_OPTIONS];
  struct word words[] = {{"CLIP", &job.source.path, "folder of a preprocessed clip"}};
  struct args args = {
      .verb = "ablate",
      .summary = "Trains the rows of the paper's ablation on a clip, and writes its tables.",
      .usage = "ablate CLIP -o DIR [--iters 2000] [--seeds 3]",
      .notes =
          "All rows get the same steps, rays and seeds, and are evaluated on the same validation frames. DIR holds\n"
          "ablation.md, ablation.csv and ablation.json, each model and its training. The tables: PSNR, SSIM, PSNR of\n"
          "the mouth, training time, frames a second, size; and the hash collisions of one look-up step.",
      .words = words,
      .word_count = 1,
      .groups = {{"What is compared:", own, OWN_OPTIONS},
                 {"Common:", common, SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS + SESSION_SEED_OPTIONS}}};
  own_options(&job, own);
  session_compute_options(&job.session, common);
  session_seed_options(&job.session, common + SESSION_COMPUTE_OPTIONS);
  session_output_options(&job.session, common + SESSION_COMPUTE_OPTIONS + SESSION_SEED_OPTIONS);
  int status = args_parse(&args, argc, argv);
  if (status < 0 && job.folder == NULL) status = args_refuse(&args, "-o DIR is missing");
  if (status < 0) status = speech_model_check(&job.source.speech_model, &args, NULL);
  if (status < 0) status = choose_rows(&job, &args);
  job.session.rewrites = job.resume;
  job.session.inputs[0] = job.source.path;
  job.session.inputs[1] = job.source.speech_model.path;
  job.session.inputs[2] = speech_model_file(&job.source.speech_model);
  if (status < 0) status = session_open(&job.session, &args);
  if (status >= 0) return status;
  status = open_all(&job, &args);
  if (status == 0) status = run(&job);
  close_all(&job);
  return status;
}
