/* SPDX-License-Identifier: MIT
 * ernerf eval: a model held against the frames of a clip. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "judge.h"
#include "portrait.h"
#include "progress.h"
#include "verbs.h"

enum { OWN_OPTIONS = 1 };

struct eval_job {
  struct session session;
  struct portrait portrait;
  struct judge judge;
  struct judged sum;    /* over all frames */
  size_t heads, mouths; /* frames that have the region */
  json_t *frames;
};

/* ---- frames ------------------------------------------------------------------------------------------------------ */

static void take_figures(struct eval_job *job, const struct shot *shot, const struct judged *judged) {
  struct judged *sum = &job->sum;
  sum->psnr += judged->psnr;
  sum->ssim += judged->ssim;
  sum->ms += judged->ms;
  sum->times.audio += judged->times.audio;
  sum->times.torso += judged->times.torso;
  sum->times.head += judged->times.head;
  sum->times.output += judged->times.output;
  sum->head += judged->head;
  sum->mouth += judged->mouth;
  job->heads += judged->has_head;
  job->mouths += judged->has_mouth;
  json_array_append_new(
      job->frames,
      json_pack("{s:I, s:s, s:o, s:o, s:o, s:o, s:o}", "id", (json_int_t)shot->pose.img_id, "split",
                shot->split == ERN_SPLIT_VAL ? "val" : "train", "psnr", session_number(judged->psnr), "ssim",
                session_number(judged->ssim), "psnr_head",
                judged->has_head ? session_number(judged->head) : json_null(), "psnr_mouth",
                judged->has_mouth ? session_number(judged->mouth) : json_null(), "ms", session_number(judged->ms)));
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
  const size_t n = job->judge.shots.count;
  const struct judged *sum = &job->sum;
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
  const size_t n = job->judge.shots.count;
  const struct judged *sum = &job->sum;
  const struct portrait *portrait = &job->portrait;
  json_t *by_stage =
      json_pack("{s:o, s:o, s:o, s:o}", "audio", session_number(mean(sum->times.audio, n)), "torso",
                session_number(mean(sum->times.torso, n)), "head", session_number(mean(sum->times.head, n)), "output",
                session_number(mean(sum->times.output, n)));
  return json_pack(
      "{s:o, s:o, s:s, s:s, s:i, s:i, s:I, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:I, s:I, s:s, s:s, s:O}", "model",
      session_text(portrait->model_path), "clip", session_text(portrait->source.path), "kind", portrait_kind(portrait),
      "split", splits[portrait->split], "width", portrait->clip_info.width, "height", portrait->clip_info.height,
      "count", (json_int_t)n, "psnr", session_number(mean(sum->psnr, n)), "ssim", session_number(mean(sum->ssim, n)),
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
  job->frames = json_array();
  if (job->frames == NULL) return session_fail_with(session, "no memory for a list of frames");
  status = judge_open(&job->judge, session, portrait->clip, (enum shot_split)portrait->split, portrait->scale,
                      (ern_audio_pad)portrait->audio_pad);
  if (status != 0) return status;
  const ern_features *features = job->judge.features;
  if (ern_renderer_accepts(portrait->renderer, features, portrait->features_path) != ERN_OK)
    return session_fail(session);
  if (!portrait->info.has_torso && !portrait->clip_info.has_torso)
    session_warn(session, "%s: has no torso_imgs, the head is drawn over the background alone", portrait->source.path);
  status = portrait_cut(portrait, session, args, &job->judge.shots, features);
  return status != 0 ? status : portrait_thin(portrait, session, &job->judge.shots, features);
}

static int judge_all(struct eval_job *job) {
  struct session *session = &job->session;
  struct progress progress;
  struct stat about;
  progress_begin(&progress, session, "eval", "frames");
  const struct shots *shots = &job->judge.shots;
  for (size_t k = 0; k < shots->count; k++) {
    struct judged judged;
    if (session_interrupted()) return session_stop_with(session, "stopped at frame %zu of %zu", k, shots->count);
    if (judge_frame(&job->judge, job->portrait.renderer, job->portrait.model, k, &judged) != 0) return EXIT_FAILURE;
    take_figures(job, &shots->shot[k], &judged);
    progress_at(&progress, k + 1, shots->count, "");
  }
  progress_end(&progress);
  const uint64_t model_bytes = stat(job->portrait.model_path, &about) == 0 ? (uint64_t)about.st_size : 0;
  if (!session_json_on_stdout(session)) print_table(job, model_bytes);
  return session_report(session, report(job, model_bytes));
}

static void close_all(struct eval_job *job) {
  json_decref(job->frames);
  judge_close(&job->judge);
  portrait_close(&job->portrait);
  session_close(&job->session);
}

int cmd_eval(int argc, char **argv) {
  struct eval_job job = {0};
  struct option own[OWN_OPTIONS] = {{.name = "audio",
                                     .alias = "aud",
                                     .kind = OPTION_TEXT,
                                     .target = &job.portrait.source.features,
                                     .help = "features (.npy) of the clip's speech, instead of the clip's own"}};
  struct option shared[PORTRAIT_OPTIONS], common[SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS];
  struct word words[] = {{"MODEL", &job.portrait.model_path, "a .safetensors or .pth file: a head, or head and torso"},
                         {"CLIP", &job.portrait.source.path, "folder of the preprocessed clip that it was trained on"}};
  struct args args = {
      .verb = "eval",
      .summary = "Holds what a model draws against the frames of its clip: PSNR, SSIM, frames a second.",
      .usage = "eval MODEL CLIP [--split val] [--json FILE.json]",
      .notes =
          "A head is drawn over the true torso pictures, head and torso over the background. Summaries are means of\n"
          "the frames' values. head: box of the 68 landmarks; mouth: square around landmarks 48..59. Frames a second\n"
          "count drawing to 8-bit pixels, without reading, judging and encoding.",
      .public_names = true,
      .words = words,
      .word_count = 2,
      .groups = {{"What is compared:", own, OWN_OPTIONS},
                 {"How:", shared, PORTRAIT_OPTIONS},
                 {"Common:", common, SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS}}};
  portrait_options(&job.portrait, SHOTS_VAL, shared);
  session_compute_options(&job.session, common);
  session_output_options(&job.session, common + SESSION_COMPUTE_OPTIONS);
  int status = args_parse(&args, argc, argv);
  if (status < 0 && job.portrait.source.features != NULL)
    status = args_forbid(&args, "asr_model", "chooses the clip's speech, not --audio");
  job.session.inputs[0] = job.portrait.model_path;
  job.session.inputs[1] = job.portrait.source.path;
  job.session.inputs[2] = job.portrait.source.features;
  if (status < 0) status = session_open(&job.session, &args);
  if (status >= 0) return status;
  status = open_all(&job, &args);
  if (status == 0) status = judge_all(&job);
  close_all(&job);
  return status;
}
