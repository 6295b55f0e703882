/* SPDX-License-Identifier: MIT
 * ernerf eval: compares a model with the recorded frames of a clip. */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "ernerf/speech.h"
#include "evaluation/comparison.h"
#include "evaluation/evaluate.h"
#include "evaluation/frame_figures.h"
#include "evaluation/paper_metrics.h"
#include "evaluation/pose_fit.h"
#include "evaluation/setting.h"
#include "session/portrait.h"
#include "session/progress.h"
#include "verbs.h"

enum { OWN_OPTIONS = 7 + SETTING_OPTIONS };

enum compose { COMPOSE_WHOLE, COMPOSE_DUB };
enum against { AGAINST_RECORDED, AGAINST_CLIP };

/* Sums over the frames. */
struct totals {
  struct evaluated sum;
  size_t heads, mouths; /* frames that have the region */
  double turn, move;    /* with fitted poses: sums of pose_fit.turn and .move */
};

struct eval_job {
  struct session session;
  struct portrait portrait;
  struct evaluation evaluation;
  struct measures measures;
  struct dubbed dubbed;
  struct recorded_picture recorded;
  int compose; /* enum compose */
  int against; /* enum against */
  struct paper_metrics metrics;
  const char *video, *csv, *sheet; /* NULL: none */
  struct comparison comparison;
  struct totals own, fitted; /* by the clip's poses; by poses fitted to the frames */
  bool refine_poses;
  int setting; /* enum setting */
  json_t *frames;
  double first_use_ms; /* the first frame of a device, once before its measured time; negative: not drawn */
};

/* ---- frames ------------------------------------------------------------------------------------------------------ */

static void take_figures(struct totals *totals, const struct evaluated *evaluated) {
  struct evaluated *sum = &totals->sum;
  sum->psnr += evaluated->psnr;
  sum->ssim += evaluated->ssim;
  sum->ms += evaluated->ms;
  sum->times.audio += evaluated->times.audio;
  sum->times.torso += evaluated->times.torso;
  sum->times.head += evaluated->times.head;
  sum->times.output += evaluated->times.output;
  sum->times.samples += evaluated->times.samples;
  sum->head += evaluated->head;
  sum->mouth += evaluated->mouth;
  totals->heads += evaluated->has_head;
  totals->mouths += evaluated->has_mouth;
}

static json_t *region_number(double decibels, bool there) { return there ? session_number(decibels) : json_null(); }

static json_t *row_of(const struct source_frame *source_frame, const struct evaluated *evaluated) {
  return json_pack("{s:I, s:s, s:o, s:o, s:o, s:o, s:o}", "id", (json_int_t)source_frame->pose.img_id, "split",
                   source_frame->split == ERN_SPLIT_VAL ? "val" : "train", "psnr", session_number(evaluated->psnr),
                   "ssim", session_number(evaluated->ssim), "psnr_head",
                   region_number(evaluated->head, evaluated->has_head), "psnr_mouth",
                   region_number(evaluated->mouth, evaluated->has_mouth), "ms", session_number(evaluated->ms));
}

/* Draws frame k, and evaluates it if a recorded frame exists; else its figures are not known. */
static int evaluate_own(struct eval_job *job, size_t k, struct evaluated *evaluated) {
  if (job->setting != SETTING_SYNCHRONIZATION)
    return evaluate_frame(&job->evaluation, job->portrait.renderer, job->portrait.model, k, evaluated);
  const int status = evaluate_draw(&job->evaluation, job->portrait.renderer, job->portrait.model, k, evaluated);
  evaluated->psnr = evaluated->ssim = NAN;
  return status;
}

/* The first frame of a device builds kernels, so it is drawn once before the measured times. */
static int draw_first_use(struct eval_job *job) {
  struct evaluated evaluated = {.ms = -1};
  int status = 0;
  if (strcmp(job->session.backend_info.name, "opencl") == 0 && job->compose != COMPOSE_DUB)
    status = evaluate_draw(&job->evaluation, job->portrait.renderer, job->portrait.model, 0, &evaluated);
  job->first_use_ms = evaluated.ms;
  return status;
}

/* Evaluates frame k again, at the pose at which the model matches it best. */
static int evaluate_refined(struct eval_job *job, size_t k, json_t *row) {
  struct evaluation *evaluation = &job->evaluation;
  struct evaluated evaluated;
  struct pose_fit fit;
  int status = pose_fit(evaluation, job->portrait.renderer, job->portrait.model, k, &fit);
  if (status != 0) return status;
  evaluation->head_pose = fit.pose;
  evaluation->measures = NULL;
  status = evaluate_frame(evaluation, job->portrait.renderer, job->portrait.model, k, &evaluated);
  evaluation->head_pose = NULL;
  evaluation->measures = &job->measures;
  if (status != 0) return status;
  take_figures(&job->fitted, &evaluated);
  job->fitted.turn += fit.turn;
  job->fitted.move += fit.move;
  json_object_set_new(
      row, "refined",
      json_pack("{s:o, s:o, s:o, s:o, s:o, s:o}", "psnr", session_number(evaluated.psnr), "ssim",
                session_number(evaluated.ssim), "psnr_head", region_number(evaluated.head, evaluated.has_head),
                "psnr_mouth", region_number(evaluated.mouth, evaluated.has_mouth), "turned_degrees",
                session_number(fit.turn), "moved_mm", session_number(fit.move)));
  return 0;
}

/* ---- results ----------------------------------------------------------------------------------------------------- */

static double mean(double sum, size_t count) { return count > 0 ? sum / (double)count : 0; }

static void print_figure(double figure, int digits) {
  if (isfinite(figure))
    printf("  %10.*f", digits, figure);
  else
    printf("  %10s", "-");
}

static void print_decibels(double sum, size_t count) { print_figure(count > 0 ? sum / (double)count : NAN, 3); }

/* A number of a row of the report; NaN: null. */
static double value_of(const json_t *row, const char *name) {
  const json_t *value = json_object_get(row, name);
  return json_is_number(value) ? json_number_value(value) : NAN;
}

static void print_frame(const json_t *frame) {
  printf("%8" JSON_INTEGER_FORMAT, json_integer_value(json_object_get(frame, "id")));
  print_figure(value_of(frame, "psnr"), 3);
  print_figure(value_of(frame, "ssim"), 5);
  print_figure(value_of(frame, "psnr_head"), 3);
  print_figure(value_of(frame, "psnr_mouth"), 3);
  printf("  %10.2f\n", json_number_value(json_object_get(frame, "ms")));
}

static void print_refined(const struct eval_job *job) {
  const size_t n = job->evaluation.frame_source.count;
  const struct totals *fitted = &job->fitted;
  printf("%8s  %10.3f  %10.5f", "refined", mean(fitted->sum.psnr, n), mean(fitted->sum.ssim, n));
  print_decibels(fitted->sum.head, fitted->heads);
  print_decibels(fitted->sum.mouth, fitted->mouths);
  printf(
      "\n\n"
      "refined: each frame at the pose that the model draws it best at, %.2f degrees and %.2f mm from its own in "
      "the\n"
      "mean; not to be compared with the figures at the frames' own poses. All figures below are for the frames' own "
      "poses.\n",
      mean(fitted->turn, n), mean(fitted->move, n));
}

/* Prints below the means the half-widths of their 95 % confidence intervals. */
static void print_intervals(const struct eval_job *job) {
  const json_t *frames = job->frames;
  printf("%8s", "95 % +-");
  print_figure(frame_figures_interval(frames, "psnr"), 3);
  print_figure(frame_figures_interval(frames, "ssim"), 5);
  print_decibels(frame_figures_interval(frames, "psnr_head"), job->own.heads > 1);
  print_decibels(frame_figures_interval(frames, "psnr_mouth"), job->own.mouths > 1);
  printf("  %10.2f\n", frame_figures_interval(frames, "ms"));
}

static const char *against_words(const struct eval_job *job) {
  return job->against == AGAINST_RECORDED ? "the recorded pictures, ori_imgs" : "the clip's pictures, gt_imgs";
}

static void print_table(const struct eval_job *job, uint64_t model_bytes) {
  const size_t n = job->evaluation.frame_source.count;
  const struct evaluated *sum = &job->own.sum;
  size_t index;
  json_t *frame;
  printf("%8s  %10s  %10s  %10s  %10s  %10s\n", "frame", "PSNR", "SSIM", "PSNR head", "PSNR mouth", "ms");
  json_array_foreach(job->frames, index, frame) print_frame(frame);
  printf("%8s", "mean");
  print_figure(mean(sum->psnr, n), 3);
  print_figure(mean(sum->ssim, n), 5);
  print_decibels(sum->head, job->own.heads);
  print_decibels(sum->mouth, job->own.mouths);
  printf("  %10.2f\n", mean(sum->ms, n));
  if (n > 1) print_intervals(job);
  if (job->refine_poses) print_refined(job);
  printf("\nsetting: %s\n", setting_words(job->setting));
  if (job->setting != SETTING_SYNCHRONIZATION) printf("compared with %s\n", against_words(job));
  const struct measures_figures figures = measures_figures(&job->measures);
  if (job->setting == SETTING_SYNCHRONIZATION)
    printf("PSNR, SSIM, mouth, sharpness, seam, tremble: not computed: %s\n", setting_no_truth);
  else
    measures_print(&figures);
  if (job->compose == COMPOSE_DUB && job->setting != SETTING_SYNCHRONIZATION) dubbed_print(&job->dubbed);
  paper_metrics_print(&job->metrics, job->frames);
  if (isfinite(sum->times.samples)) printf("samples: %.0f a frame\n", mean(sum->times.samples, n));
  printf("%.2f frames a second of %d x %d: audio %.2f ms, torso %.2f ms, head %.2f ms, output %.2f ms\n",
         1000 / mean(sum->ms, n), job->portrait.clip_info.width, job->portrait.clip_info.height,
         mean(sum->times.audio, n), mean(sum->times.torso, n), mean(sum->times.head, n), mean(sum->times.output, n));
  printf("%s: %s, %" PRIu64 " bytes, of them %zu of trained numbers\n", job->portrait.model_path,
         portrait_kind(&job->portrait), model_bytes, job->portrait.info.parameter_bytes);
}

static json_t *region_mean(double sum, size_t count) { return region_number(mean(sum, count), count > 0); }

/* Results with fitted poses; NULL unless requested. */
static json_t *report_refined(const struct eval_job *job) {
  const size_t n = job->evaluation.frame_source.count;
  const struct totals *fitted = &job->fitted;
  if (!job->refine_poses) return NULL;
  return json_pack("{s:o, s:o, s:o, s:o, s:o, s:o}", "psnr", session_number(mean(fitted->sum.psnr, n)), "ssim",
                   session_number(mean(fitted->sum.ssim, n)), "psnr_head", region_mean(fitted->sum.head, fitted->heads),
                   "psnr_mouth", region_mean(fitted->sum.mouth, fitted->mouths), "turned_degrees",
                   session_number(mean(fitted->turn, n)), "moved_mm", session_number(mean(fitted->move, n)));
}

/* Half-widths of the means' 95 % confidence intervals; null if fewer than two frames have the figure. */
static json_t *report_intervals(const struct eval_job *job) {
  static const char *const names[] = {"psnr", "ssim", "psnr_head", "psnr_mouth"};
  json_t *made = json_object();
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    const double half = frame_figures_interval(job->frames, names[i]);
    json_object_set_new(made, names[i], region_number(half, isfinite(half)));
  }
  return made;
}

static json_t *report(struct eval_job *job, uint64_t model_bytes) {
  static const char *const splits[] = {"train", "val", "all"};
  const size_t n = job->evaluation.frame_source.count;
  const struct evaluated *sum = &job->own.sum;
  const struct portrait *portrait = &job->portrait;
  const struct measures_figures figures = measures_figures(&job->measures);
  const char *name = setting_name(job->setting);
  json_t *by_stage =
      json_pack("{s:o, s:o, s:o, s:o}", "audio", session_number(mean(sum->times.audio, n)), "torso",
                session_number(mean(sum->times.torso, n)), "head", session_number(mean(sum->times.head, n)), "output",
                session_number(mean(sum->times.output, n)));
  return json_pack(
      "{s:o, s:o, s:s, s:o, s:s, s:i, s:i, s:I, s:o, s:o, s:o, s:o, s:o, s:o*, s:o, s:o, s:o, s:o, s:o, s:I, s:I, s:s, "
      "s:s, "
      "s:o, s:o*, s:o, s:o, s:O}",
      "model", session_text(portrait->model_path), "clip", session_text(portrait->source.path), "kind",
      portrait_kind(portrait), "setting", name != NULL ? json_string(name) : json_null(), "split",
      splits[portrait->split], "width", portrait->clip_info.width, "height", portrait->clip_info.height, "count",
      (json_int_t)n, "psnr", session_number(mean(sum->psnr, n)), "ssim", session_number(mean(sum->ssim, n)),
      "psnr_head", region_mean(sum->head, job->own.heads), "psnr_mouth", region_mean(sum->mouth, job->own.mouths),
      "interval95", report_intervals(job), "refined", report_refined(job), "measures", measures_json(&figures),
      "samples_per_frame", session_number(mean(sum->times.samples, n)), "fps", session_number(1000 / mean(sum->ms, n)),
      "ms_per_frame", session_number(mean(sum->ms, n)), "ms_by_stage", by_stage, "model_bytes", (json_int_t)model_bytes,
      "param_bytes", (json_int_t)portrait->info.parameter_bytes, "backend", job->session.backend_info.name, "isa",
      job->session.backend_info.isa, "metrics", paper_metrics_json(&job->metrics, job->frames), "dubbed",
      job->compose == COMPOSE_DUB ? dubbed_json(&job->dubbed) : NULL, "against",
      job->setting == SETTING_SYNCHRONIZATION ? json_null()
                                              : json_string(job->against == AGAINST_RECORDED ? "recorded" : "clip"),
      "first_use_ms", job->first_use_ms >= 0 ? session_number(job->first_use_ms) : json_null(), "frames", job->frames);
}

/* ---- the verb ---------------------------------------------------------------------------------------------------- */

/* The recorded pictures, where the clip has those of all frames; for the paper's figures the clip's. */
static void choose_against(struct eval_job *job, const struct args *args) {
  const struct frame_source *frame_source = &job->evaluation.frame_source;
  job->against = AGAINST_RECORDED;
  if (job->compose == COMPOSE_DUB) return;
  if (args_given(args, "setting")) job->against = AGAINST_CLIP;
  for (size_t k = 0; k < frame_source->count && job->against == AGAINST_RECORDED; k++)
    if (!recorded_picture_there(&job->recorded, frame_source->source_frame[k].pose.img_id)) job->against = AGAINST_CLIP;
}

static int open_all(struct eval_job *job, const struct args *args) {
  struct portrait *portrait = &job->portrait;
  struct session *session = &job->session;
  const int status = evaluate_open_portrait(&job->evaluation, portrait, session, args, &job->measures);
  if (status != 0) return status;
  job->recorded = recorded_picture_of(portrait->source.path, portrait->clip_info.width, portrait->clip_info.height);
  if (!args_given(args, "against")) choose_against(job, args);
  if (job->against == AGAINST_RECORDED) job->evaluation.recorded = &job->recorded;
  if (job->compose == COMPOSE_DUB) {
    if (dubbed_open(&job->dubbed, session, portrait->clip, &job->recorded) != 0) return EXIT_FAILURE;
    job->evaluation.dubbed = &job->dubbed;
  }
  if (setting_open(job->setting, &job->evaluation, portrait) != 0) return EXIT_FAILURE;
  job->frames = json_array();
  if (job->frames == NULL) return session_fail_with(session, "no memory for a list of frames");
  char sound[4096];
  const bool fits = snprintf(sound, sizeof sound, "%s/aud.wav", portrait->source.path) < (int)sizeof sound;
  const char *speech = portrait->source.features != NULL ? portrait->source.features : sound, *heard = sound;
  job->metrics.other_speech = job->setting == SETTING_SYNCHRONIZATION;
  if (paper_metrics_open(&job->metrics, &job->evaluation, speech) != 0) return EXIT_FAILURE;
  if (job->video == NULL) return 0;
  if (job->setting == SETTING_SYNCHRONIZATION) heard = ern_speech_is_sound(speech) ? speech : NULL;
  return comparison_open(&job->comparison, &job->evaluation, 1, job->video, fits ? heard : NULL);
}

static int write_files(struct eval_job *job) {
  struct session *session = &job->session;
  int status = 0;
  if (job->csv != NULL) {
    struct bytes csv = {0};
    frame_figures_csv(job->frames, &csv);
    status = csv.failed ? session_fail_with(session, "no memory for %s", job->csv)
                        : session_write(session, job->csv, csv.data, csv.count);
    bytes_free(&csv);
  }
  if (status == 0 && job->sheet != NULL)
    status =
        frame_figures_sheet(&job->evaluation, job->portrait.renderer, job->portrait.model, job->frames, job->sheet);
  return status;
}

static int evaluate_all(struct eval_job *job) {
  struct session *session = &job->session;
  struct progress progress;
  struct stat about;
  progress_begin(&progress, session, "eval", "frames");
  const struct frame_source *frame_source = &job->evaluation.frame_source;
  const uint8_t *drawn = job->evaluation.rgba;
  if (draw_first_use(job) != 0) return EXIT_FAILURE;
  for (size_t k = 0; k < frame_source->count; k++) {
    struct evaluated evaluated;
    if (session_interrupted()) return session_stop_with(session, "stopped at frame %zu of %zu", k, frame_source->count);
    if (evaluate_own(job, k, &evaluated) != 0) return EXIT_FAILURE;
    take_figures(&job->own, &evaluated);
    if (job->video != NULL && comparison_add(&job->comparison, &job->evaluation, &drawn, k) != 0) return EXIT_FAILURE;
    json_t *row = row_of(&frame_source->source_frame[k], &evaluated);
    int status = paper_metrics_add(&job->metrics, &job->evaluation, k, row);
    if (status == 0 && job->refine_poses) status = evaluate_refined(job, k, row);
    json_array_append_new(job->frames, row);
    if (status != 0) return status;
    progress_at(&progress, k + 1, frame_source->count, "");
  }
  progress_end(&progress);
  if (job->dubbed.left > 0)
    session_warn(
        session,
        "%zu of %zu frames are left as recorded, so their PSNR and SSIM say nothing about the model: the face is "
        "too small or too near the edge, or the model has no head there",
        job->dubbed.left, frame_source->count);
  if (job->video != NULL && comparison_finish(&job->comparison) != 0) return EXIT_FAILURE;
  if (paper_metrics_finish(&job->metrics, session) != 0 || write_files(job) != 0) return EXIT_FAILURE;
  const uint64_t model_bytes = stat(job->portrait.model_path, &about) == 0 ? (uint64_t)about.st_size : 0;
  if (!session_json_on_stdout(session)) print_table(job, model_bytes);
  return session_report(session, report(job, model_bytes));
}

static void close_all(struct eval_job *job) {
  json_decref(job->frames);
  comparison_close(&job->comparison);
  evaluate_close(&job->evaluation);
  measures_free(&job->measures);
  dubbed_close(&job->dubbed);
  recorded_picture_free(&job->recorded, &job->session);
  paper_metrics_close(&job->metrics);
  portrait_close(&job->portrait);
  session_close(&job->session);
}

/* EXIT_USAGE if options contradict each other, else -1. Registers the input files with the session. */
static int check_words(struct eval_job *job, const struct args *args) {
  struct portrait *portrait = &job->portrait;
  int status = setting_check(&job->setting, args, portrait);
  if (status < 0) status = speech_model_check(&portrait->source.speech_model, args, portrait->source.features);
  if (status < 0 && portrait->source.features != NULL)
    status = args_forbid(args, "asr-model", "chooses the clip's speech, not --audio");
  if (status < 0 && job->refine_poses)
    status =
        args_forbid(args, "smooth-lips", "needs frames one after the other, which --refine-poses draws many times");
  portrait->dubs = portrait->render.no_torso = job->compose == COMPOSE_DUB;
  if (status < 0 && portrait->dubs)
    status = args_forbid(args, "refine-poses torso torso-shrink against", "is about frames that are rendered whole");
  const char *dot = job->sheet != NULL ? strrchr(job->sheet, '.') : NULL;
  if (status < 0 && job->sheet != NULL && (dot == NULL || strcmp(dot, ".png") != 0))
    status = args_refuse(args, "--sheet is \"%s\", expected a name that ends in .png", job->sheet);
  if (status < 0 && job->sheet != NULL)
    status = args_forbid(args, "smooth-lips", "needs frames one after the other, and --sheet draws some again");
  job->session.inputs[0] = portrait->model_path;
  job->session.inputs[1] = portrait->source.path;
  job->session.inputs[2] = portrait->source.features;
  job->session.inputs[3] = portrait->source.speech_model.path;
  job->session.inputs[4] = speech_model_file(&portrait->source.speech_model);
  return status < 0 ? paper_metrics_check(&job->metrics, args, &job->session) : status;
}

static int run(struct eval_job *job, const struct args *args) {
  const char *const outputs[] = {job->video, job->csv, job->sheet};
  int status = 0;
  for (size_t i = 0; i < sizeof outputs / sizeof *outputs && status == 0; i++)
    if (outputs[i] != NULL) status = session_check_output(&job->session, outputs[i]);
  if (status == 0) status = open_all(job, args);
  if (status == 0) status = evaluate_all(job);
  close_all(job);
  return status;
}

int cmd_eval(int argc, char **argv) {
  struct eval_job job = {0};
  struct option own[OWN_OPTIONS] = {
      {ARGS_TEXT("audio", &job.portrait.source.features), .alias = "aud",
       .help =
           "the clip's speech from another file, a sound or speech features (.npy), instead of the clip's own; other "
           "speech with --setting synchronization"},
      {ARGS_TEXT("video", &job.video), .choices = "FILE.mp4",
       .help = "write a video of the rendered frames beside the clip's, with the clip's sound, or that of --audio "
               "with --setting synchronization"},
      {ARGS_CHOICE("compose", &job.compose, "whole|dub"),
       .help = "the frames: whole: rendered whole; dub: the rendered lower face in the recorded pictures "
               "(ori_imgs/ID.jpg), with which they are compared, as `ernerf dub` makes them (default whole)"},
      {ARGS_CHOICE("against", &job.against, "recorded|clip"),
       .help = "what frames are compared with: recorded: the pictures as they were recorded (ori_imgs/ID.jpg); clip: "
               "those that the model is trained on, put together of the person and a still background (gt_imgs) "
               "(default recorded, where the clip has them; with --setting clip, as in the paper)"},
      {ARGS_TEXT("csv", &job.csv), .choices = "FILE.csv", .help = "write the figures of each frame as a table"},
      {ARGS_TEXT("sheet", &job.sheet), .choices = "FILE.png",
       .help = "write a picture of the best, the median and the worst frame by PSNR, each beside the recorded one "
               "and 4 times their difference"},
      {ARGS_FLAG("refine-poses", &job.refine_poses),
       .help = "also fit the pose of each frame, and report the figures at that pose too; renders a frame up to 200 "
               "times"}};
  setting_options(&job.setting, own + OWN_OPTIONS - SETTING_OPTIONS);
  struct option shared[PORTRAIT_OPTIONS], common[SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS],
      metrics[PAPER_METRICS_OPTIONS];
  struct word words[] = {{"MODEL", &job.portrait.model_path, "a .safetensors or .pth file: a head, or head and torso"},
                         {"CLIP", &job.portrait.source.path, "folder of the preprocessed clip that it was trained on"}};
  struct args args = {
      .verb = "eval",
      .summary = "Compares what a model renders with the frames of its clip: PSNR, SSIM, frames a second.",
      .usage =
          "eval MODEL CLIP [--split val] [--json FILE.json]\n"
          "eval MODEL CLIP --setting synchronization --audio SOUND",
      .notes =
          "A head is rendered over the clip's torso pictures, with --torso model head and torso over the background.\n"
          "Summaries are means of the frames' values. head: box of the 68 landmarks; mouth: square around landmarks "
          "48..59.\n"
          "Frames a second count rendering to 8-bit pixels, without reading, comparing and encoding.",
      .public_names = true,
      .words = words,
      .word_count = 2,
      .groups = {
          {"What is compared:", own, OWN_OPTIONS},
          {"Metrics of the paper's tables, by what you bring (docs/evaluation.md):", metrics, PAPER_METRICS_OPTIONS},
          {"How:", shared, PORTRAIT_OPTIONS},
          {"Common:", common, SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS}}};
  portrait_options(&job.portrait, FRAME_SOURCE_VAL, shared);
  paper_metrics_options(&job.metrics, metrics);
  session_compute_options(&job.session, common);
  session_output_options(&job.session, common + SESSION_COMPUTE_OPTIONS);
  int status = args_parse(&args, argc, argv);
  if (status < 0) status = check_words(&job, &args);
  if (status < 0) status = session_open(&job.session, &args);
  return status < 0 ? run(&job, &args) : status;
}
