/* SPDX-License-Identifier: MIT */
#include "evaluation/paper_metrics.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "evaluation/frame_figures.h"
#include "evaluation/setting.h"

enum { FID_FRAMES = 2048 /* number of features of Inception-v3; with fewer frames the distance is too high */ };
static const char lpips_needs[] = "needs --lpips-network and --lpips-heads: AlexNet or VGG16 with the heads of LPIPS";
static const char lmd_needs[] = "needs --landmarks: a network, FILE.onnx, or a folder of ID.lms of the rendered frames";
static const char aue_needs[] = "needs --action-units and --recorded-action-units: OpenFace's tables";
static const char fid_needs[] = "needs --inception: a network of features, FILE.onnx, and 2 frames at least";
static const char sync_needs[] = "needs --syncnet-video and --syncnet-audio: the two networks of SyncNet, FILE.onnx";

void paper_metrics_options(struct paper_metrics *metrics, struct option options[PAPER_METRICS_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_TEXT("landmarks", &metrics->lmd.path), .choices = "FILE.onnx|DIR",
       .help = "LMD (landmark distance): a network that finds landmarks, or a folder of ID.lms of the rendered frames"},
      {ARGS_TEXT("action-units", &metrics->aue.rendered_path), .choices = "FILE.csv",
       .help = "AUE (action unit error): OpenFace's table of the rendered frames, a row each"},
      {ARGS_TEXT("recorded-action-units", &metrics->aue.recorded_path), .alias = "true-action-units",
       .choices = "FILE.csv", .help = "AUE: OpenFace's table of the same frames of the clip"},
      {ARGS_TEXT("inception", &metrics->fid.path), .choices = "FILE.onnx",
       .help = "FID (Frechet inception distance): a network of features; for figures that can be compared with "
               "published ones Inception-v3 up to its last pooling"},
      {ARGS_TEXT("syncnet-video", &metrics->sync.video_path), .choices = "FILE.onnx",
       .help = "Sync (SyncNet's lip synchronization confidence): the part of SyncNet for video: five frames"},
      {ARGS_TEXT("syncnet-audio", &metrics->sync.audio_path), .choices = "FILE.onnx",
       .help = "Sync: the part of SyncNet for sound: 20 rows of cepstra"}};
  ARGS_FILL(options, rows, PAPER_METRICS_OPTIONS - LPIPS_OPTIONS);
  lpips_weights_options(&metrics->lpips.weights, options + PAPER_METRICS_OPTIONS - LPIPS_OPTIONS);
}

int paper_metrics_check(const struct paper_metrics *metrics, const struct args *args, struct session *session) {
  const char *const inputs[] = {metrics->lmd.path,
                                metrics->aue.rendered_path,
                                metrics->aue.recorded_path,
                                metrics->fid.path,
                                metrics->sync.video_path,
                                metrics->sync.audio_path,
                                metrics->lpips.weights.network,
                                metrics->lpips.weights.heads};
  for (size_t i = 0, next = 0; i < sizeof inputs / sizeof *inputs; i++) {
    while (next < SESSION_INPUTS && session->inputs[next] != NULL) next++;
    if (inputs[i] != NULL && next < SESSION_INPUTS) session->inputs[next] = inputs[i];
  }
  if ((metrics->aue.rendered_path == NULL) != (metrics->aue.recorded_path == NULL))
    return args_refuse(args, "--action-units and --recorded-action-units: one is given, expected both or neither");
  if ((metrics->sync.video_path == NULL) != (metrics->sync.audio_path == NULL))
    return args_refuse(args, "--syncnet-video and --syncnet-audio: one is given, expected both or neither");
  return lpips_weights_check(&metrics->lpips.weights, args);
}

int paper_metrics_open(struct paper_metrics *metrics, const struct evaluation *evaluation, const char *sound) {
  metrics->sync.drawn_alone = metrics->other_speech;
  int status = action_units_compare(&metrics->aue, evaluation->session, evaluation->frame_source.count);
  if (status == 0) status = perceptual_distance_open(&metrics->lpips, evaluation);
  if (status == 0) status = landmark_distance_open(&metrics->lmd, evaluation);
  if (status == 0) status = inception_open(&metrics->fid, evaluation);
  return status != 0 ? status : syncnet_open(&metrics->sync, evaluation, sound);
}

int paper_metrics_add(struct paper_metrics *metrics, const struct evaluation *evaluation, size_t k, json_t *row) {
  int status = perceptual_distance_add(&metrics->lpips, evaluation, k, row);
  if (status == 0) status = landmark_distance_add(&metrics->lmd, evaluation, k, row);
  if (status == 0) status = inception_add(&metrics->fid, evaluation, k);
  return status != 0 ? status : syncnet_add(&metrics->sync, evaluation, k);
}

int paper_metrics_finish(struct paper_metrics *metrics, struct session *session) {
  syncnet_finish(&metrics->sync);
  return inception_finish(&metrics->fid, session);
}

void paper_metrics_close(struct paper_metrics *metrics) {
  perceptual_distance_close(&metrics->lpips);
  landmark_distance_close(&metrics->lmd);
  inception_close(&metrics->fid);
  syncnet_close(&metrics->sync);
}

/* ---- results ----------------------------------------------------------------------------------------------------- */

/* The text that tells what a metric with recorded frames needs. */
static const char *truth_or(const struct paper_metrics *metrics, const char *needs) {
  return metrics->other_speech ? setting_no_truth : needs;
}

static double lmd_mean(const struct landmark_distance *lmd, double sum) {
  return lmd->frames > 0 ? sum / (double)lmd->frames : NAN;
}

static void print_left_out(size_t frames, size_t left_out) {
  printf(" (%zu frames", frames);
  if (left_out > 0) printf(", %zu left out", left_out);
  printf(")\n");
}

static void print_interval(const json_t *frames, const char *name) {
  const double half = frame_figures_interval(frames, name);
  if (isfinite(half)) printf(" +- %.3f", half);
}

static void print_sync(const struct syncnet *sync) {
  const struct sync_score *drawn = &sync->score[SYNC_DRAWN], *truth = &sync->score[SYNC_TRUE];
  if (!sync->known) {
    printf("Sync: not computed: %s\n", sync_needs);
    return;
  }
  printf("Sync: confidence %.3f, distance %.3f at %d frames", drawn->confidence, drawn->distance, drawn->offset);
  if (!sync->drawn_alone)
    printf("; of the recorded frames %.3f, %.3f at %d", truth->confidence, truth->distance, truth->offset);
  printf(" (%zu windows)\n", sync->windows);
}

void paper_metrics_print(const struct paper_metrics *metrics, const json_t *frames) {
  const struct landmark_distance *lmd = &metrics->lmd;
  const struct action_units *aue = &metrics->aue;
  const struct perceptual_distance *lpips = &metrics->lpips;
  if (lpips->frames > 0)
    printf("LPIPS: %.5f +- %.5f (%s)\n", lpips->sum / (double)lpips->frames, frame_figures_interval(frames, "lpips"),
           ern_lpips_name(lpips->weights.lpips));
  else
    printf("LPIPS: not computed: %s\n", truth_or(metrics, lpips_needs));
  if (lmd->frames > 0) {
    printf("LMD: mouth %.3f", lmd_mean(lmd, lmd->mouth));
    print_interval(frames, "lmd_mouth");
    printf(", face %.3f", lmd_mean(lmd, lmd->face));
    print_interval(frames, "lmd_face");
    printf(" pixels");
    print_left_out(lmd->frames, lmd->left_out);
  } else {
    printf("LMD: not computed: %s\n", truth_or(metrics, lmd_needs));
  }
  if (aue->frames > 0) {
    printf("AUE: %.3f", aue->all);
    if (isfinite(aue->lower)) printf(", lower face %.3f", aue->lower);
    if (isfinite(aue->upper)) printf(", upper face %.3f", aue->upper);
    printf(", of %zu action units", aue->units);
    print_left_out(aue->frames, aue->left_out);
  } else {
    printf("AUE: not computed: %s\n", truth_or(metrics, aue_needs));
  }
  if (metrics->fid.frames > 0)
    printf("FID: %.3f, of %zu features (%zu frames%s)\n", metrics->fid.distance, metrics->fid.features,
           metrics->fid.frames, metrics->fid.frames < FID_FRAMES ? "; biased upwards under 2048" : "");
  else
    printf("FID: not computed: %s\n", fid_needs);
  print_sync(&metrics->sync);
}

static json_t *lpips_json(const struct perceptual_distance *lpips, const json_t *frames) {
  if (lpips->frames == 0) return json_null();
  return json_pack("{s:o, s:o, s:s}", "mean", session_number(lpips->sum / (double)lpips->frames), "interval95",
                   session_number(frame_figures_interval(frames, "lpips")), "network",
                   ern_lpips_name(lpips->weights.lpips));
}

static json_t *lmd_json(const struct landmark_distance *lmd, const json_t *frames) {
  if (lmd->frames == 0) return json_null();
  return json_pack("{s:o, s:o, s:o, s:o, s:I, s:I}", "mouth", session_number(lmd_mean(lmd, lmd->mouth)), "face",
                   session_number(lmd_mean(lmd, lmd->face)), "interval95_mouth",
                   session_number(frame_figures_interval(frames, "lmd_mouth")), "interval95_face",
                   session_number(frame_figures_interval(frames, "lmd_face")), "frames", (json_int_t)lmd->frames,
                   "left_out", (json_int_t)lmd->left_out);
}

static json_t *aue_json(const struct action_units *aue) {
  if (aue->frames == 0) return json_null();
  return json_pack("{s:o, s:o, s:o, s:I, s:I, s:I}", "all", session_number(aue->all), "lower",
                   session_number(aue->lower), "upper", session_number(aue->upper), "units", (json_int_t)aue->units,
                   "frames", (json_int_t)aue->frames, "left_out", (json_int_t)aue->left_out);
}

static json_t *fid_json(const struct inception *fid) {
  if (fid->frames == 0) return json_null();
  return json_pack("{s:o, s:I, s:I, s:b}", "distance", session_number(fid->distance), "features",
                   (json_int_t)fid->features, "frames", (json_int_t)fid->frames, "biased", fid->frames < FID_FRAMES);
}

static json_t *score_json(const struct sync_score *score) {
  return json_pack("{s:o, s:o, s:i}", "confidence", session_number(score->confidence), "distance",
                   session_number(score->distance), "offset", score->offset);
}

static json_t *sync_json(const struct syncnet *sync) {
  if (!sync->known) return json_null();
  return json_pack("{s:o, s:o, s:I}", "drawn", score_json(&sync->score[SYNC_DRAWN]), "truth",
                   sync->drawn_alone ? json_null() : score_json(&sync->score[SYNC_TRUE]), "windows",
                   (json_int_t)sync->windows);
}

json_t *paper_metrics_json(const struct paper_metrics *metrics, const json_t *frames) {
  static const char *const of_truth[] = {"psnr", "ssim", "psnr_head", "psnr_mouth", "measures", "sync.truth"};
  json_t *absent = json_object();
  for (size_t i = 0; metrics->other_speech && i < sizeof of_truth / sizeof *of_truth; i++)
    json_object_set_new(absent, of_truth[i], json_string(setting_no_truth));
  if (metrics->lpips.frames == 0) json_object_set_new(absent, "lpips", json_string(truth_or(metrics, lpips_needs)));
  if (metrics->lmd.frames == 0) json_object_set_new(absent, "lmd", json_string(truth_or(metrics, lmd_needs)));
  if (metrics->aue.frames == 0) json_object_set_new(absent, "aue", json_string(truth_or(metrics, aue_needs)));
  if (metrics->fid.frames == 0) json_object_set_new(absent, "fid", json_string(fid_needs));
  if (!metrics->sync.known) json_object_set_new(absent, "sync", json_string(sync_needs));
  return json_pack("{s:o, s:o, s:o, s:o, s:o, s:o}", "lpips", lpips_json(&metrics->lpips, frames), "lmd",
                   lmd_json(&metrics->lmd, frames), "aue", aue_json(&metrics->aue), "fid", fid_json(&metrics->fid),
                   "sync", sync_json(&metrics->sync), "not_computed", absent);
}
