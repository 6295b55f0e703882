/* SPDX-License-Identifier: MIT
 * ernerf eval: a model held against the frames of a clip. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "backdrop.h"
#include "portrait.h"
#include "progress.h"
#include "regions.h"
#include "verbs.h"

enum { AUDIO_WINDOWS = 8, OWN_OPTIONS = 1 };

/* Figures of one frame, or sums over many. */
struct figures {
  double psnr, ssim, head, mouth, ms; /* head, mouth: PSNR in dB of the regions */
  ern_frame_times times;
};

struct eval_job {
  struct session session;
  struct portrait portrait;
  struct shots shots;
  struct backdrop backdrop;
  const ern_features *features;
  float *windows, *rgb;
  uint8_t *rgba;
  struct figures sum;
  size_t heads, mouths; /* frames that have the region */
  json_t *frames;
};

/* ---- frames ------------------------------------------------------------------------------------------------------ */

static int draw(struct eval_job *job, size_t k, const uint8_t *torso, struct figures *figures) {
  const struct portrait *portrait = &job->portrait;
  shots_windows(&job->shots, k, job->features, (ern_audio_pad)portrait->audio_pad, job->windows);
  const ern_camera camera =
      shots_camera(&job->shots, k, portrait->scale, portrait->clip_info.width, portrait->clip_info.height);
  float refined[16];
  const ern_frame_input input = {.camera = camera,
                                 .head_pose = portrait_refined(portrait, &job->shots.shot[k], &camera, refined),
                                 .windows = job->windows,
                                 .window_length = job->features->window_length,
                                 .eye = job->shots.shot[k].eye,
                                 .background = job->backdrop.background.data,
                                 .torso = torso};
  const ern_frame_output output = {.rgba = job->rgba, .rgb = job->rgb};
  const double began = session_seconds();
  const ern_status status = ern_renderer_frame(portrait->renderer, &input, &output, &figures->times);
  figures->ms = 1000 * (session_seconds() - began);
  return status == ERN_OK ? 0 : session_fail(&job->session);
}

static void take_figures(struct eval_job *job, const struct shot *shot, const struct figures *figures, bool head,
                         bool mouth) {
  struct figures *sum = &job->sum;
  sum->psnr += figures->psnr;
  sum->ssim += figures->ssim;
  sum->ms += figures->ms;
  sum->times.audio += figures->times.audio;
  sum->times.torso += figures->times.torso;
  sum->times.head += figures->times.head;
  sum->times.output += figures->times.output;
  if (head) sum->head += figures->head;
  if (mouth) sum->mouth += figures->mouth;
  job->heads += head;
  job->mouths += mouth;
  json_array_append_new(
      job->frames,
      json_pack("{s:I, s:s, s:o, s:o, s:o, s:o, s:o}", "id", (json_int_t)shot->pose.img_id, "split",
                shot->split == ERN_SPLIT_VAL ? "val" : "train", "psnr", session_number(figures->psnr), "ssim",
                session_number(figures->ssim), "psnr_head", head ? session_number(figures->head) : json_null(),
                "psnr_mouth", mouth ? session_number(figures->mouth) : json_null(), "ms", session_number(figures->ms)));
}

static int judge(struct eval_job *job, size_t k) {
  const struct shot *shot = &job->shots.shot[k];
  struct session *session = &job->session;
  struct figures figures = {0};
  ern_image truth = {0};
  const uint8_t *torso = NULL;
  if (!job->portrait.info.has_torso &&
      backdrop_torso(&job->backdrop, session, job->portrait.clip, shot->split, shot->index, &torso) != 0)
    return EXIT_FAILURE;
  if (draw(job, k, torso, &figures) != 0) return EXIT_FAILURE;
  if (ern_clip_pixels(job->portrait.clip, shot->split, shot->index, &truth, NULL) != ERN_OK)
    return session_fail(session);
  figures.psnr = ern_psnr(job->rgb, truth.data, truth.width, truth.height, NULL);
  if (ern_ssim(session->context, job->rgb, truth.data, truth.width, truth.height, &figures.ssim) != ERN_OK)
    return session_fail(session);
  const ern_clip_frame *frame = ern_clip_frame_at(job->portrait.clip, shot->split, shot->index);
  ern_box box;
  const bool head = region_head(frame, truth.width, truth.height, &box);
  if (head) figures.head = ern_psnr(job->rgb, truth.data, truth.width, truth.height, &box);
  const bool mouth = region_mouth(frame, truth.width, truth.height, &box);
  if (mouth) figures.mouth = ern_psnr(job->rgb, truth.data, truth.width, truth.height, &box);
  take_figures(job, shot, &figures, head, mouth);
  return 0;
}

/* ---- results ----------------------------------------------------------------------------------------------------- */

static double mean(double sum, size_t count) { return count > 0 ? sum / (double)count : 0; }

static void print_decibels(double sum, size_t count) {
  if (count > 0)
    printf("  %10.3f", sum / (double)count);
  else
    printf("  %10s", "-");
}

static void print_table(const struct eval_job *job, uint64_t model_bytes) {
  const size_t n = job->shots.count;
  const struct figures *sum = &job->sum;
  size_t index;
  json_t *frame;
  printf("%8s  %10s  %10s  %10s  %10s  %10s\n", "frame", "PSNR", "SSIM", "PSNR head", "PSNR mouth", "ms");
  json_array_foreach(job->frames, index, frame) {
    const json_t *head = json_object_get(frame, "psnr_head"), *mouth = json_object_get(frame, "psnr_mouth");
    printf("%8" JSON_INTEGER_FORMAT "  %10.3f  %10.5f", json_integer_value(json_object_get(frame, "id")),
           json_number_value(json_object_get(frame, "psnr")), json_number_value(json_object_get(frame, "ssim")));
    print_decibels(json_number_value(head), json_is_number(head));
    print_decibels(json_number_value(mouth), json_is_number(mouth));
    printf("  %10.2f\n", json_number_value(json_object_get(frame, "ms")));
  }
  printf("%8s  %10.3f  %10.5f", "mean", mean(sum->psnr, n), mean(sum->ssim, n));
  print_decibels(sum->head, job->heads);
  print_decibels(sum->mouth, job->mouths);
  printf("  %10.2f\n\n", mean(sum->ms, n));
  printf("%.2f frames a second of %d x %d: audio %.2f ms, torso %.2f ms, head %.2f ms, output %.2f ms\n",
         1000 / mean(sum->ms, n), job->portrait.clip_info.width, job->portrait.clip_info.height,
         mean(sum->times.audio, n), mean(sum->times.torso, n), mean(sum->times.head, n), mean(sum->times.output, n));
  printf("%s: %s, %" PRIu64 " bytes, of them %zu of trained numbers\n", job->portrait.model_path,
         portrait_kind(&job->portrait), model_bytes, job->portrait.info.parameter_bytes);
}

static json_t *report(struct eval_job *job, uint64_t model_bytes) {
  static const char *const splits[] = {"train", "val", "all"};
  const size_t n = job->shots.count;
  const struct figures *sum = &job->sum;
  const struct portrait *portrait = &job->portrait;
  json_t *by_stage =
      json_pack("{s:o, s:o, s:o, s:o}", "audio", session_number(mean(sum->times.audio, n)), "torso",
                session_number(mean(sum->times.torso, n)), "head", session_number(mean(sum->times.head, n)), "output",
                session_number(mean(sum->times.output, n)));
  return json_pack(
      "{s:s, s:s, s:s, s:s, s:i, s:i, s:I, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:I, s:I, s:s, s:s, s:O}", "model",
      portrait->model_path, "clip", portrait->clip_path, "kind", portrait_kind(portrait), "split",
      splits[portrait->split], "width", portrait->clip_info.width, "height", portrait->clip_info.height, "count",
      (json_int_t)n, "psnr", session_number(mean(sum->psnr, n)), "ssim", session_number(mean(sum->ssim, n)),
      "psnr_head", job->heads > 0 ? session_number(mean(sum->head, job->heads)) : json_null(), "psnr_mouth",
      job->mouths > 0 ? session_number(mean(sum->mouth, job->mouths)) : json_null(), "fps",
      session_number(1000 / mean(sum->ms, n)), "ms_per_frame", session_number(mean(sum->ms, n)), "ms_by_stage",
      by_stage, "model_bytes", (json_int_t)model_bytes, "param_bytes", (json_int_t)portrait->info.parameter_bytes,
      "backend", job->session.backend_info.name, "isa", job->session.backend_info.isa, "frames", job->frames);
}

/* ---- the verb ---------------------------------------------------------------------------------------------------- */

static int open_all(struct eval_job *job, const struct args *args) {
  struct portrait *portrait = &job->portrait;
  struct session *session = &job->session;
  int status = portrait_open(portrait, session, args);
  if (status != 0) return status;
  const ern_clip_info *info = &portrait->clip_info;
  const size_t pixels = (size_t)info->width * (size_t)info->height;
  job->features = ern_clip_features(portrait->clip);
  if (ern_renderer_accepts(portrait->renderer, job->features, portrait->features_path) != ERN_OK)
    return session_fail(session);
  job->windows = malloc((size_t)AUDIO_WINDOWS * (size_t)job->features->window_length * (size_t)job->features->width *
                        sizeof(float));
  job->rgb = malloc(pixels * 3 * sizeof(float));
  job->rgba = malloc(pixels * 4);
  job->frames = json_array();
  if (job->windows == NULL || job->rgb == NULL || job->rgba == NULL || job->frames == NULL)
    return session_fail_with(session, "no memory for a picture of %d x %d", info->width, info->height);
  if (!portrait->info.has_torso && !info->has_torso)
    session_warn(session, "%s: has no torso_imgs, the head is drawn over the background alone", portrait->clip_path);
  status = shots_of_clip(&job->shots, session, portrait->clip, (enum shot_split)portrait->split);
  if (status == 0) status = portrait_cut(portrait, args, &job->shots);
  if (status == 0) status = portrait_thin(portrait, session, &job->shots, job->features);
  if (status == 0) status = backdrop_open(&job->backdrop, session, NULL, portrait->clip, info->width, info->height);
  return status;
}

static int judge_all(struct eval_job *job) {
  struct session *session = &job->session;
  struct progress progress;
  struct stat about;
  progress_begin(&progress, session, "eval", "frames");
  for (size_t k = 0; k < job->shots.count; k++) {
    if (session_interrupted()) return session_fail_with(session, "stopped at frame %zu of %zu", k, job->shots.count);
    if (judge(job, k) != 0) return EXIT_FAILURE;
    progress_at(&progress, k + 1, job->shots.count, "");
  }
  progress_end(&progress);
  const uint64_t model_bytes = stat(job->portrait.model_path, &about) == 0 ? (uint64_t)about.st_size : 0;
  if (!session_json_on_stdout(session)) print_table(job, model_bytes);
  return session_report(session, report(job, model_bytes));
}

static void close_all(struct eval_job *job) {
  json_decref(job->frames);
  free(job->windows);
  free(job->rgb);
  free(job->rgba);
  backdrop_free(&job->backdrop, &job->session);
  shots_free(&job->shots);
  portrait_close(&job->portrait);
  session_close(&job->session);
}

int cmd_eval(int argc, char **argv) {
  struct eval_job job = {0};
  struct option own[OWN_OPTIONS] = {{.name = "audio",
                                     .alias = "aud",
                                     .kind = OPTION_TEXT,
                                     .target = &job.portrait.clip_features,
                                     .help = "features (.npy) of the clip's speech, instead of the clip's own"}};
  struct option shared[PORTRAIT_OPTIONS], common[SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS];
  struct word words[] = {{"MODEL", &job.portrait.model_path, "a .safetensors or .pth file: a head, or head and torso"},
                         {"CLIP", &job.portrait.clip_path, "folder of the preprocessed clip that it was trained on"}};
  struct args args = {
      .verb = "eval",
      .summary = "Holds what a model draws against the frames of its clip: PSNR, SSIM, frames a second.",
      .usage = "eval MODEL CLIP [--split val] [--json FILE.json]",
      .notes =
          "A head is drawn over the true torso pictures, head and torso over the background. Summaries are means of\n"
          "the frames' values. head: box of the 68 landmarks; mouth: square around landmarks 48..59. Frames a second\n"
          "count drawing to 8-bit pixels, without reading, judging and encoding.",
      .words = words,
      .word_count = 2,
      .groups = {{"What is compared:", own, OWN_OPTIONS},
                 {"How:", shared, PORTRAIT_OPTIONS},
                 {"Common:", common, SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS}}};
  portrait_options(&job.portrait, SHOTS_VAL, shared);
  session_compute_options(&job.session, common);
  session_output_options(&job.session, common + SESSION_COMPUTE_OPTIONS);
  int status = args_parse(&args, argc, argv);
  if (status < 0 && job.portrait.clip_features != NULL)
    status = args_forbid(&args, "asr_model", "chooses the clip's speech, not --audio");
  if (status < 0) status = session_open(&job.session, &args);
  if (status >= 0) return status;
  status = open_all(&job, &args);
  if (status == 0) status = judge_all(&job);
  close_all(&job);
  return status;
}
