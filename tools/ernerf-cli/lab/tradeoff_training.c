/* SPDX-License-Identifier: MIT
 * ernerf tradeoff --training: measures the training time for each decibel, by rays a step, ray sampling, levels and
 * compute unit. Each kind of training gets the same time and differs from the base in one setting, except the published
 * schedule and that of `train --time`. */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ernerf/media.h"
#include "ernerf/train.h"
#include "evaluation/measures.h"
#include "lab/fine_stage_cost.h"
#include "lab/tradeoff_training.h"
#include "output/curve.h"
#include "output/training_report.h"
#include "session/clip_source.h"
#include "session/pareto.h"
#include "session/progress.h"
#include "timed_training.h"
#include "verbs.h"

enum {
  OWN_OPTIONS = 9 + CLIP_SOURCE_OPTIONS + LPIPS_OPTIONS,
  PROBE_STEPS = 48,
  PROBE_WARM = 4,
  POINTS = 10,
  PUBLISHED_REFRESH = 16,               /* steps */
  LEAST_AVERAGED = 10 * TIMED_EMA_EVERY /* fewest steps for an EMA */
};

struct training_job {
  struct session session;
  struct clip_source source;
  const char *folder;
  int rays, levels, seeds;
  float seconds;
  bool training, opencl, in_double;
  struct lpips_weights weights;
  /* made */
  ern_clip *clip;
  struct training_study study;
  struct curve *taking; /* the curve that gets the validations */
  struct measures now;  /* of the current validation */
  ern_trainer *trainer;
  struct progress progress;
};

static void own_options(struct training_job *job, struct option options[OWN_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_FLAG("training", &job->training), .help = "compare trainings, not renders"},
      {ARGS_TEXT("o", &job->folder), .alias = "output", .choices = "DIR",
       .help = "folder for the table, curves and plots; made if it is missing"},
      {ARGS_FLOAT("seconds", &job->seconds, 0.1, 1e6), .help = "seconds of training for each curve and seed"},
      {ARGS_INT("rays", &job->rays, 16, 65536), .alias = "num_rays",
       .help = "rays a step of the training that the others are compared with, which take a quarter, 4 and 16 times as "
               "many"},
      {ARGS_INT("levels", &job->levels, 4, 20),
       .help = "levels of the hash encoder of that training; two others have 4 fewer and 4 more"},
      {ARGS_INT("seeds", &job->seeds, 1, TRAINING_SEEDS),
       .help = "number of trainings of each kind, with different seeds: their spread shows which differences may be "
               "chance"},
      {ARGS_FLAG("opencl", &job->opencl), .help = "OpenCL devices too"},
      {ARGS_FLAG("double", &job->in_double),
       .help = "double precision too, which the scalar reference alone has: hundreds of times slower"},
      {ARGS_COUNT("seed", &job->session.seed, 0, 0), .help = "seed of the first training of each kind"}};
  ARGS_FILL(options, rows, OWN_OPTIONS - CLIP_SOURCE_OPTIONS - LPIPS_OPTIONS);
  clip_source_options(&job->source, options + sizeof rows / sizeof *rows);
  lpips_weights_options(&job->weights, options + OWN_OPTIONS - LPIPS_OPTIONS);
}

/* ---- what is compared -------------------------------------------------------------------------------------------- */

static void add_kind(struct training_study *study, struct training_kind kind) {
  if (study->count < TRAINING_KINDS) study->kind[study->count++] = kind;
}

/* Whether the instruction set has its own training kernels. */
static bool trains(const char *isa) {
  return strcmp(isa, "avx2") == 0 || strcmp(isa, "avx512") == 0 || strcmp(isa, "avx512bf16") == 0 ||
         strcmp(isa, "neon") == 0;
}

/* Whether rays can be sampled by region. */
static bool has_regions(const ern_clip *clip) {
  ern_clip_info info;
  ern_clip_describe(clip, &info);
  for (size_t i = 0; i < info.frames[ERN_SPLIT_TRAIN]; i++)
    if (ern_clip_frame_at(clip, ERN_SPLIT_TRAIN, i)->has_landmarks) return true;
  return false;
}

static void take_device(void *user, const ern_device_info *device) {
  struct training_job *job = user;
  struct training_study *study = &job->study;
  struct training_kind kind = study->kind[0];
  kind.device = device->number;
  if (strcmp(device->kind, "cpu") == 0) {
    char sets[256];
    snprintf(study->processor, sizeof study->processor, "%s", device->name);
    study->cores = (int)device->compute_units;
    snprintf(sets, sizeof sets, "%s", device->instruction_sets);
    for (char *rest = sets, *isa; (isa = strtok_r(rest, " ", &rest)) != NULL;) {
      if (!trains(isa) || strcmp(isa, study->base_isa) == 0) continue;
      snprintf(kind.isa, sizeof kind.isa, "%s", isa);
      kind.bf16 = strcmp(isa, "avx512bf16") == 0; /* its float products equal those of avx512 */
      snprintf(kind.name, sizeof kind.name, "%s", kind.bf16 ? "bf16" : isa);
      add_kind(study, kind);
    }
  } else if (job->opencl) {
    kind.opencl = true;
    snprintf(kind.name, sizeof kind.name, "OpenCL device %d, %.40s", device->number, device->name);
    add_kind(study, kind);
  }
}

static int choose_kinds(struct training_job *job) {
  struct training_study *study = &job->study;
  const bool regions = has_regions(job->clip);
  const struct training_kind base = {.name = "base",
                                     .rays = job->rays,
                                     .levels = job->levels,
                                     .ray_sampling = regions ? ERN_RAY_SAMPLING_REGIONS : ERN_RAY_SAMPLING_UNIFORM};
  ern_backend *backend = NULL;
  ern_backend_info info;
  if (ern_backend_create(&backend, job->session.context, NULL) != ERN_OK) return session_fail(&job->session);
  ern_backend_describe(backend, &info);
  snprintf(study->base_isa, sizeof study->base_isa, "%s", strcmp(info.isa, "avx512bf16") == 0 ? "avx512" : info.isa);
  ern_backend_free(&backend);
  add_kind(study, base);
  snprintf(study->kind[0].name, sizeof study->kind[0].name, "%d rays, %d levels, %s", job->rays, job->levels,
           study->base_isa);
  for (int k = 0; k < 3; k++) {
    struct training_kind kind = base;
    kind.rays = k == 0 ? job->rays / 4 : k == 1 ? 4 * job->rays : 16 * job->rays;
    snprintf(kind.name, sizeof kind.name, "%d rays", kind.rays);
    add_kind(study, kind);
  }
  for (int k = 0; k < 2; k++) {
    struct training_kind kind = base;
    kind.levels = job->levels + (k == 0 ? -4 : 4);
    snprintf(kind.name, sizeof kind.name, "%d levels", kind.levels);
    if (kind.levels >= 2) add_kind(study, kind);
  }
  for (int k = regions ? 0 : 1; k < 2; k++) {
    struct training_kind kind = base;
    kind.ray_sampling = ERN_RAY_SAMPLING_UNIFORM;
    if (k == 1) kind.refresh_every = PUBLISHED_REFRESH;
    snprintf(kind.name, sizeof kind.name, "%s", k == 0 ? "uniform rays" : "as published");
    add_kind(study, kind);
  }
  struct training_kind timed = base;
  timed.timed = true;
  timed.rays = TIMED_RAYS;
  snprintf(timed.name, sizeof timed.name, "as train --time, %d rays", timed.rays);
  add_kind(study, timed);
  if (job->in_double) {
    struct training_kind kind = base;
    snprintf(kind.isa, sizeof kind.isa, "ref64");
    snprintf(kind.name, sizeof kind.name, "double precision, ref64");
    add_kind(study, kind);
  }
  if (ern_devices_list(job->session.context, take_device, job) != ERN_OK) return session_fail(&job->session);
  return 0;
}

/* ---- a training -------------------------------------------------------------------------------------------------- */

static ern_status take_frame(void *user, int split, size_t frame, const float *rgb, const uint8_t *truth) {
  struct training_job *job = user;
  ern_clip_info info;
  ern_clip_describe(job->clip, &info);
  const ern_clip_frame *about = ern_clip_frame_at(job->clip, (ern_split)split, frame);
  if (!measures_add(&job->now, about, info.width, info.height, truth, rgb)) return ERN_E_NO_MEMORY;
  return session_interrupted() ? ERN_E_CANCELLED : ERN_OK;
}

static ern_status take_validation(void *user, uint64_t step, double psnr, size_t frames, const uint8_t *picture,
                                  int width, int height, const char *name) {
  struct training_job *job = user;
  ern_train_report now;
  (void)picture, (void)width, (void)height, (void)name;
  job->study.frames = frames;
  ern_trainer_describe(job->trainer, &now);
  const struct mouth_figures mouth = measures_figures(&job->now).mouth;
  measures_free(&job->now);
  const struct curve_point point = {step, now.seconds, psnr, mouth.known ? mouth.explained : NAN};
  return curve_add(job->taking, &job->session, point) == 0 ? ERN_OK : ERN_E_NO_MEMORY;
}

static int say_progress(void *user, const ern_train_report *report) {
  struct training_job *job = user;
  char more[64];
  job->progress.rate = report->steps_per_second;
  snprintf(more, sizeof more, "PSNR %.2f", report->psnr);
  progress_at(&job->progress, report->step, report->iters, more);
  return session_interrupted();
}

static ern_train_config config_of(const struct training_job *job, const struct training_kind *kind, uint64_t seed) {
  ern_train_config config = ern_train_config_default();
  config.rays = kind->rays;
  config.levels = kind->levels;
  config.ray_sampling = kind->ray_sampling;
  config.refresh_every = kind->refresh_every;
  config.precision = kind->bf16 ? ERN_PRECISION_BF16 : ERN_PRECISION_FP32;
  config.seed = seed;
  config.threads = job->session.threads;
  return config;
}

static ern_status make_trainer(struct training_job *job, const struct training_kind *kind, ern_backend *backend,
                               uint64_t seed, uint64_t iters) {
  ern_train_config config = config_of(job, kind, seed);
  ern_dataset dataset;
  ern_clip_dataset(job->clip, &dataset);
  config.iters = iters;
  config.validate_every = iters / POINTS > 0 ? iters / POINTS : 1;
  if (kind->timed) {
    config.ema = iters >= LEAST_AVERAGED;
    config.ema_every = TIMED_EMA_EVERY;
    config.prune_share = TIMED_PRUNE_SHARE;
  }
  return ern_trainer_create(&job->trainer, backend, &dataset, &config);
}

/* Estimates how many steps fit into the time, which the learning rate schedule needs. The first steps, including a
 * refresh of the occupancy, are a warm-up. The estimate takes at most half of the time. */
static ern_status probe(struct training_job *job, const struct training_kind *kind, ern_backend *backend,
                        uint64_t *iters) {
  const double began = session_seconds(), most = 0.5 * (double)job->seconds;
  ern_train_report report;
  double warm = began; /* start of the timed steps */
  uint64_t steps = 0;
  ern_status status = make_trainer(job, kind, backend, job->session.seed, 100000);
  for (int step = 0; status == ERN_OK && step < PROBE_STEPS && !session_interrupted(); step++) {
    status = ern_trainer_step(job->trainer, &report);
    const double now = session_seconds();
    if (step < PROBE_WARM) warm = now;
    steps += step >= PROBE_WARM;
    if (now - began > most && (steps > 0 || now - began > 2 * most)) break;
  }
  const double spent = session_seconds() - (steps > 0 ? warm : began);
  const double fit = (double)job->seconds * (double)(steps > 0 ? steps : 1) / (spent > 0 ? spent : 1);
  *iters = fit > POINTS ? (uint64_t)fmin(fit, 1e9) : POINTS;
  ern_trainer_free(&job->trainer);
  return status;
}

static int train_one(struct training_job *job, struct training_kind *kind, ern_backend *backend, int seed) {
  const ern_train_hooks hooks = {
      .user = job, .progress = say_progress, .validation = take_validation, .validation_frame = take_frame};
  struct session *session = &job->session;
  job->taking = &kind->curve[seed];
  ern_status status = seed == 0 ? probe(job, kind, backend, &kind->iters) : ERN_OK;
  if (status == ERN_OK) status = make_trainer(job, kind, backend, session->seed + (uint64_t)seed, kind->iters);
  if (status == ERN_OK) {
    progress_begin(&job->progress, session, kind->name, "steps");
    status = ern_trainer_run(job->trainer, &hooks);
    progress_end(&job->progress);
  }
  measures_free(&job->now); /* of an unfinished validation */
  ern_trainer_free(&job->trainer);
  if (session_interrupted()) return session_stop_with(session, "stopped: nothing is written");
  return status == ERN_OK ? 0 : session_fail(session);
}

static int open_backend(struct training_job *job, const struct training_kind *kind, ern_backend **backend) {
  ern_backend_config config = ern_backend_config_default();
  config.name = kind->opencl ? "opencl" : "cpu";
  config.isa = kind->opencl ? NULL : kind->isa[0] != 0 ? kind->isa : job->study.base_isa;
  config.device = kind->device;
  return ern_backend_create(backend, job->session.context, &config) == ERN_OK ? 0 : session_fail(&job->session);
}

/* Measures the fine stage with the settings of the first kind. */
static int measure_fine(struct training_job *job) {
  ern_backend *backend = NULL;
  ern_dataset dataset;
  ern_clip_dataset(job->clip, &dataset);
  const struct training_kind *base = &job->study.kind[0];
  const ern_train_config config = config_of(job, base, job->session.seed);
  int status = open_backend(job, base, &backend);
  if (status == 0)
    status = fine_stage_cost_measure(&job->study.fine, &job->session, backend, &dataset, &config, &job->weights,
                                     (double)job->seconds);
  ern_backend_free(&backend);
  return status;
}

static int train_kind(struct training_job *job, struct training_kind *kind) {
  ern_backend *backend = NULL;
  int status = open_backend(job, kind, &backend);
  if (status != 0) return status;
  for (int seed = 0; seed < job->seeds && status == 0; seed++) status = train_one(job, kind, backend, seed);
  ern_backend_free(&backend);
  if (status != 0) return status;
  const struct training_end end = training_final(kind, (size_t)job->seeds);
  char moves[64] = "";
  if (isfinite(end.mouth.mean)) snprintf(moves, sizeof moves, ", %.1f %% of the mouth's motion", 100 * end.mouth.mean);
  session_note(&job->session, "%s: %" PRIu64 " steps, PSNR %.2f dB%s", kind->name, kind->iters, end.psnr.mean, moves);
  return 0;
}

/* ---- the verb ---------------------------------------------------------------------------------------------------- */

static int open_all(struct training_job *job) {
  struct session *session = &job->session;
  static const char *const names[] = {"training.md",
                                      "training.csv",
                                      "training.json",
                                      "training_seconds.svg",
                                      "training_seconds.png",
                                      "training_steps.svg",
                                      "training_steps.png",
                                      "training_mouth_seconds.svg",
                                      "training_mouth_seconds.png"};
  if (session_check_outputs(session, job->folder, names, sizeof names / sizeof *names) != 0) return EXIT_FAILURE;
  const int opened = clip_source_open(&job->source, session, &job->clip);
  speech_model_close(&job->source.speech_model);
  if (opened != 0 || lpips_weights_open(&job->weights, session) != 0) return EXIT_FAILURE;
  if (session_folder(session, job->folder) != 0) return EXIT_FAILURE;
  job->study.clip = job->source.path;
  job->study.seconds = (double)job->seconds;
  job->study.seeds = (size_t)job->seeds;
  return choose_kinds(job);
}

static int run(struct training_job *job) {
  struct training_study *study = &job->study;
  session_note(&job->session, "tradeoff: %zu kinds of training, %g s and %d seed%s each; writes %s", study->count,
               (double)job->seconds, job->seeds, job->seeds == 1 ? "" : "s", job->folder);
  if (measure_fine(job) != 0) return EXIT_FAILURE; /* first, so that errors appear before hours of training */
  for (size_t k = 0; k < study->count; k++)
    if (train_kind(job, &study->kind[k]) != 0) return EXIT_FAILURE;
  session_stage(&job->session);
  if (session_write_staged(&job->session, training_write(study, &job->session, job->folder)) != 0) return EXIT_FAILURE;
  return session_report(&job->session, job->session.json != NULL ? training_json(study) : NULL);
}

int tradeoff_training(int argc, char **argv) {
  struct training_job job = {.rays = 4096, .levels = 14, .seeds = 2, .seconds = 30};
  struct option own[OWN_OPTIONS], common[SESSION_OUTPUT_OPTIONS + 1];
  struct word words[] = {{"CLIP", &job.source.path, "folder of a preprocessed clip"}};
  struct args args = {
      .verb = "tradeoff",
      .summary = "Compares trainings of a clip: PSNR against training time.",
      .usage = "tradeoff --training CLIP -o DIR [--seconds 30] [--seeds 2]",
      .notes =
          "One thing is changed at a time: rays a step, levels, where the rays go, instruction set, with --opencl "
          "devices,\n"
          "with --double precision; bf16 where there is avx512bf16. One training is as published: ray_sampling "
          "uniform and\n"
          "a refresh of the whole occupancy grid every 16 steps. DIR gets training.md, .csv, .json and the curves as "
          "training_seconds,\n"
          "training_steps and training_mouth_seconds, .svg and .png: PSNR, and the share of the mouth's motion that "
          "is rendered.\n"
          "First the steps of a fine stage are timed beside coarse ones, with LPIPS where its weights are given.",
      .words = words,
      .word_count = 1,
      .groups = {{"What is compared:", own, OWN_OPTIONS}, {"Common:", common, SESSION_OUTPUT_OPTIONS + 1}}};
  own_options(&job, own);
  session_output_options(&job.session, common);
  common[SESSION_OUTPUT_OPTIONS] = (struct option){ARGS_INT("threads", &job.session.threads, 1, ERN_THREADS_MOST),
                                                   .help = "of the CPU (default one a core)"};
  int status = args_parse(&args, argc, argv);
  if (status < 0 && job.folder == NULL) status = args_refuse(&args, "-o DIR is missing");
  if (status < 0) status = speech_model_check(&job.source.speech_model, &args, NULL);
  if (status < 0) status = lpips_weights_check(&job.weights, &args);
  const int side = ern_train_config_default().patch_size;
  if (status < 0 && job.rays < side * side && job.weights.network != NULL)
    status =
        args_refuse(&args, "--rays is %d, expected %d at least, for the patch of a fine step, with --lpips-network",
                    job.rays, side * side);
  job.session.inputs[0] = job.source.path;
  job.session.inputs[1] = job.source.speech_model.path;
  job.session.inputs[2] = speech_model_file(&job.source.speech_model);
  job.session.inputs[3] = job.weights.network;
  job.session.inputs[4] = job.weights.heads;
  if (status < 0) status = session_open(&job.session, &args);
  if (status >= 0) return status;
  status = open_all(&job);
  if (status == 0) status = run(&job);
  training_free(&job.study);
  lpips_weights_close(&job.weights);
  ern_clip_free(&job.clip);
  session_close(&job.session);
  return status;
}
