/* SPDX-License-Identifier: MIT
 * ernerf soak: stress test: trains with a series of extreme settings and checks all values after each step. */
#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "lab/soak.h"
#include "session/progress.h"
#include "session/session.h"
#include "verbs.h"

enum { OWN_OPTIONS = 4, SIDE = 40 /* pixels of the frames that are drawn */, PATH_BYTES = 4096, WORDS_BYTES = 768 };

struct soak_job {
  struct session session;
  const char *clip_path;
  uint64_t steps, first;
  float seconds;
  bool torso;
  /* made */
  char folder[PATH_BYTES], output[PATH_BYTES + 32];
  ern_clip *clip;
  ern_dataset data;
  ern_model *head;
  struct soak_buffers buffers;
  struct progress progress;
  double began;
  uint64_t done, rounds, resumes, frames; /* so far */
};

/* ---- a round ----------------------------------------------------------------------------------------------------- */

/* A torso's opacity is 1.002 times a sigmoid, minus 0.001 (as in the paper's program), plus rounding errors. */
static bool in_range(float value) { return value >= -0.0011f && value <= 1.0011f; }

/* Draws a whole picture with the trained model and checks it: all values finite, colours and opacity in 0..1. */
static int draw(struct soak_job *job, const struct soak_data *data, ern_trainer *trainer) {
  struct session *session = &job->session;
  const ern_dataset *d = &data->bent;
  static float rgb[3 * SIDE * SIDE], alpha[SIDE * SIDE], depth[SIDE * SIDE];
  const ern_frame_output output = {.rgb = rgb, .alpha = alpha, .depth = depth};
  ern_model *model = NULL;
  ern_renderer *renderer = NULL;
  ern_dataset_frame frame;
  const size_t windows = 8 * (size_t)d->features->window_length * (size_t)d->features->width;
  float *speech = malloc(windows * sizeof *speech);
  ern_status status = speech != NULL ? ern_trainer_model(trainer, &model) : ERN_E_NO_MEMORY;
  if (status == ERN_OK) status = ern_renderer_create(&renderer, session->backend, model, NULL);
  if (status == ERN_OK) status = d->frame(d->user, 0, job->done % d->frames[0], &frame);
  if (status == ERN_OK) {
    ern_camera camera = {
        .focal = (float)d->focal, .cx = (float)d->cx, .cy = (float)d->cy, .width = d->width, .height = d->height};
    ern_camera_pose(camera.pose, frame.matrix, d->scale);
    ern_audio_windows(speech, d->features, frame.aud_id, data->round->config.audio_pad);
    const ern_frame_input input = {.camera = ern_camera_resized(&camera, SIDE, SIDE),
                                   .windows = speech,
                                   .window_length = d->features->window_length,
                                   .eye = frame.eye};
    status = ern_renderer_frame(renderer, &input, &output, NULL);
  }
  free(speech);
  ern_renderer_free(&renderer);
  ern_model_free(&model);
  if (status != ERN_OK) return session_fail(session);
  job->frames++;
  for (size_t i = 0; i < SIDE * SIDE; i++)
    for (size_t c = 0; c < 3; c++)
      if (!in_range(rgb[3 * i + c]) || !in_range(alpha[i]) || !isfinite(depth[i]))
        return session_fail_with(session, "the frame drawn has colour %g, opacity %g, depth %g at pixel %zu",
                                 (double)rgb[3 * i + c], (double)alpha[i], (double)depth[i], i);
  return 0;
}

/* Saves the state, frees the trainer, and resumes with a new one. */
static int drop_and_resume(struct soak_job *job, struct soak_round *round, const ern_dataset *data,
                           ern_trainer **trainer) {
  ern_train_report before, after;
  ern_trainer_describe(*trainer, &before);
  if (ern_trainer_save(*trainer) != ERN_OK) return session_fail(&job->session);
  ern_trainer_free(trainer);
  round->config.resume = true;
  if (ern_trainer_create(trainer, job->session.backend, data, &round->config) != ERN_OK)
    return session_fail(&job->session);
  ern_trainer_describe(*trainer, &after);
  job->resumes++;
  if (before.step == after.step) return 0;
  return session_fail_with(&job->session, "resumed at step %" PRIu64 ", expected %" PRIu64, after.step, before.step);
}

/* Makes one step and checks all resulting values. */
static int step(struct soak_job *job, ern_trainer *trainer) {
  ern_train_report report;
  if (ern_trainer_step(trainer, &report) != ERN_OK) {
    (void)session_fail(&job->session);
    if (ern_trainer_save(trainer) == ERN_OK)
      session_note(&job->session, "the state before that step is in %s", ern_trainer_folder(trainer));
    return EXIT_FAILURE;
  }
  if (!isfinite(report.loss) || !isfinite(report.psnr) || !isfinite(report.samples_per_ray))
    return session_fail_with(&job->session, "step %" PRIu64 ": loss %g, PSNR %g, %g samples a ray", report.step,
                             report.loss, report.psnr, report.samples_per_ray);
  if (ern_trainer_check(trainer) != ERN_OK) return session_fail(&job->session);
  job->done++;
  return 0;
}

static bool over(const struct soak_job *job) {
  return job->done >= job->steps || session_interrupted() ||
         (job->seconds > 0 && session_seconds() - job->began > (double)job->seconds);
}

static int run_round(struct soak_job *job, struct soak_round *round) {
  struct soak_data data;
  ern_trainer *trainer = NULL;
  char more[64];
  soak_modify(&data, &job->data, round, &job->buffers);
  round->config.output = job->output;
  round->config.threads = job->session.threads;
  int status = 0;
  if (ern_trainer_create(&trainer, job->session.backend, &data.bent, &round->config) != ERN_OK)
    status = session_fail(&job->session);
  snprintf(more, sizeof more, "round %" PRIu64, round->number);
  for (uint64_t k = 0; k < round->steps && status == 0 && !over(job); k++) {
    if (k > 0 && k == round->resume_at) status = drop_and_resume(job, round, &data.bent, &trainer);
    if (status == 0) status = step(job, trainer);
    progress_at(&job->progress, job->done, job->steps, more);
  }
  if (status == 0) status = draw(job, &data, trainer);
  ern_trainer_free(&trainer);
  job->rounds += status == 0;
  return status;
}

/* ---- all rounds -------------------------------------------------------------------------------------------------- */

static void clear_folder(const struct soak_job *job) {
  static const char *const names[] = {"soak.run/state.safetensors",
                                      "soak.run/state.previous.safetensors",
                                      "soak.run/state.next.safetensors",
                                      "soak.run/log.jsonl",
                                      "soak.run/curve.csv",
                                      "soak.run/lock",
                                      "soak.run",
                                      "soak.safetensors"};
  char path[PATH_BYTES + 64];
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    snprintf(path, sizeof path, "%s/%s", job->folder, names[i]);
    (void)remove(path);
  }
}

static json_t *report(const struct soak_job *job) {
  return json_pack("{s:o, s:b, s:I, s:I, s:I, s:I, s:o, s:o, s:f, s:s, s:s}", "clip", session_text(job->clip_path),
                   "torso", job->torso, "steps", (json_int_t)job->done, "rounds", (json_int_t)job->rounds, "resumes",
                   (json_int_t)job->resumes, "frames", (json_int_t)job->frames, "seed",
                   session_whole(job->session.seed), "first", session_whole(job->first), "seconds",
                   session_seconds() - job->began, "backend", job->session.backend_info.name, "isa",
                   job->session.backend_info.isa);
}

static int run(struct soak_job *job) {
  struct session *session = &job->session;
  struct soak_round round = {0};
  char words[WORDS_BYTES], spent[32];
  int status = 0;
  job->began = session_seconds();
  progress_begin(&job->progress, session, "soak", "steps");
  for (uint64_t number = job->first; status == 0 && !over(job); number++) {
    clear_folder(job);
    soak_choose(&round, session->seed, number, &job->data, job->head);
    status = run_round(job, &round);
  }
  progress_end(&job->progress);
  if (status != 0) {
    soak_words(&round, words, sizeof words);
    session_note(session,
                 "round %" PRIu64 " of seed %" PRIu64 ": %s\n`ernerf soak %s%s --seed %" PRIu64 " --first %" PRIu64
                 "` repeats it; its files are in %s",
                 round.number, session->seed, words, job->clip_path, job->torso ? " --torso" : "", session->seed,
                 round.number, job->folder);
    return status;
  }
  clear_folder(job);
  progress_duration(session_seconds() - job->began, spent);
  session_note(session,
               "soak: %" PRIu64 " steps in %" PRIu64 " rounds, %" PRIu64 " resumes, %" PRIu64
               " frames, %s: all finite (seed %" PRIu64 ", %s)",
               job->done, job->rounds, job->resumes, job->frames, spent, session->seed, session->backend_info.isa);
  if (session_interrupted()) return session_stop_with(session, "stopped after step %" PRIu64, job->done);
  return session_report(session, report(job));
}

/* ---- beginning --------------------------------------------------------------------------------------------------- */

/* Makes a head for the torso; any head will do. */
static int make_head(struct soak_job *job) {
  ern_train_config config = ern_train_config_default();
  ern_trainer *trainer = NULL;
  ern_train_report last;
  config.iters = 1;
  config.rays = 64;
  ern_status status = ern_trainer_create(&trainer, job->session.backend, &job->data, &config);
  if (status == ERN_OK) status = ern_trainer_step(trainer, &last);
  if (status == ERN_OK) status = ern_trainer_model(trainer, &job->head);
  ern_trainer_free(&trainer);
  return status == ERN_OK ? 0 : session_fail(&job->session);
}

static int open_all(struct soak_job *job) {
  struct session *session = &job->session;
  const char *place = getenv("TMPDIR");
  if (ern_clip_open(session->context, job->clip_path, NULL, &job->clip) != ERN_OK) return session_fail(session);
  ern_clip_dataset(job->clip, &job->data);
  job->data.scale = 4;
  const ern_features *features = job->data.features;
  const size_t each = (size_t)features->window_length * (size_t)features->width;
  job->buffers.speech = malloc(features->windows * each * sizeof(float));
  job->buffers.truth = malloc(3 * (size_t)job->data.width * (size_t)job->data.height);
  if (job->buffers.speech == NULL || job->buffers.truth == NULL)
    return session_fail_with(session, "no memory for speech and pixels");
  if (job->torso && !job->data.has_torso)
    return session_fail_with(session, "%s: has no torso_imgs, so no torso can be learnt", job->clip_path);
  if (session_backend(session) != ERN_OK) return session_fail(session);
  snprintf(job->folder, sizeof job->folder,
           "%s/ernerf-soak-"
           "XX"
           "XX"
           "XX",
           place != NULL && place[0] != 0 ? place : "/tmp");
  if (mkdtemp(job->folder) == NULL)
    return session_fail_with(session, "%s: cannot be made: %s", job->folder, strerror(errno));
  snprintf(job->output, sizeof job->output, "%s/soak.safetensors", job->folder);
  return job->torso ? make_head(job) : 0;
}

static void close_all(struct soak_job *job) {
  (void)rmdir(job->folder); /* fails if the folder is not empty */
  ern_model_free(&job->head);
  ern_clip_free(&job->clip);
  free(job->buffers.speech);
  free(job->buffers.truth);
  session_close(&job->session);
}

static void own_options(struct soak_job *job, struct option options[OWN_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_COUNT("steps", &job->steps, 1, 1e12), .help = "training steps in all (default 10000)"},
      {ARGS_FLOAT("seconds", &job->seconds, 0, 1e9), .help = "after which it ends, whatever --steps says; 0: never"},
      {ARGS_FLAG("torso", &job->torso), .help = "train torsos, under a head of one step"},
      {ARGS_COUNT("first", &job->first, 0, 1e12),
       .help = "round to begin with: a round and its settings follow from --seed and its number"}};
  ARGS_FILL(options, rows, OWN_OPTIONS);
}

int cmd_soak(int argc, char **argv) {
  struct soak_job job = {.steps = 10000};
  struct option own[OWN_OPTIONS], how[SESSION_COMPUTE_OPTIONS + SESSION_SEED_OPTIONS + SESSION_OUTPUT_OPTIONS];
  struct word words[] = {{"CLIP", &job.clip_path, "folder of a preprocessed clip"}};
  struct args args = {
      .verb = "soak",
      .summary = "Trains with one set of extreme settings after another, and checks all values after each step.",
      .usage = "soak CLIP --steps 100000",
      .notes =
          "Each round chooses at random: variants and effects of the head, rays a step, learning rates up to 100 "
          "times the\n"
          "usual, distance and turn of the head, loudness of the speech, eye values and pixels; some are saved, "
          "freed and\n"
          "resumed. Values, gradients, the optimizer's moments, averages, occupancy and a rendered frame must be "
          "finite. Else\n"
          "it stops with exit status 1, the name of the tensor, and the command that repeats the round.",
      .words = words,
      .word_count = 1,
      .groups = {{"What is done:", own, OWN_OPTIONS},
                 {"How:", how, SESSION_COMPUTE_OPTIONS + SESSION_SEED_OPTIONS + SESSION_OUTPUT_OPTIONS}}};
  own_options(&job, own);
  session_compute_options(&job.session, how);
  session_seed_options(&job.session, how + SESSION_COMPUTE_OPTIONS);
  session_output_options(&job.session, how + SESSION_COMPUTE_OPTIONS + SESSION_SEED_OPTIONS);
  int status = args_parse(&args, argc, argv);
  job.session.inputs[0] = job.clip_path;
  if (status < 0) status = session_open(&job.session, &args);
  if (status >= 0) return status;
  status = open_all(&job);
  if (status == 0) status = run(&job);
  close_all(&job);
  return status;
}
