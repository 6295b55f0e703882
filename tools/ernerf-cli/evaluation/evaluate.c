/* SPDX-License-Identifier: MIT */
#include "evaluation/evaluate.h"

#include <stdlib.h>
#include <string.h>

#include "evaluation/regions.h"

enum { AUDIO_WINDOWS = 8 };

int evaluate_open(struct evaluation *evaluation, struct session *session, ern_clip *clip, enum frame_source_split split,
                  float scale, ern_audio_pad pad) {
  *evaluation = (struct evaluation){.session = session, .clip = clip, .scale = scale, .pad = pad};
  ern_clip_describe(clip, &evaluation->info);
  evaluation->features = ern_clip_features(clip);
  const int width = evaluation->info.width, height = evaluation->info.height;
  const size_t pixels = (size_t)width * (size_t)height, values = (size_t)AUDIO_WINDOWS *
                                                                 (size_t)evaluation->features->window_length *
                                                                 (size_t)evaluation->features->width;
  evaluation->windows = malloc(values * sizeof(float));
  evaluation->rgb = malloc(pixels * 3 * sizeof(float));
  evaluation->rgba = malloc(pixels * 4);
  if (evaluation->windows == NULL || evaluation->rgb == NULL || evaluation->rgba == NULL)
    return session_fail_with(session, "no memory for a picture of %d x %d", width, height);
  const int status = frame_source_of_clip(&evaluation->frame_source, session, clip, split);
  return status != 0 ? status
                     : background_open(&evaluation->background, session, NULL, clip, width, height, ERN_FIT_CONTAIN);
}

int evaluate_open_portrait(struct evaluation *evaluation, struct portrait *portrait, struct session *session,
                           const struct args *args, struct measures *measures) {
  int status = portrait_open(portrait, session, args);
  speech_model_close(&portrait->source.speech_model);
  if (status == 0)
    status = evaluate_open(evaluation, session, portrait->clip, (enum frame_source_split)portrait->split,
                           portrait->scale, (ern_audio_pad)portrait->audio_pad);
  if (status != 0) return status;
  evaluation->measures = measures;
  evaluation->recorded_torso = portrait->render.no_torso;
  measures->flow = session->context;
  const ern_features *features = evaluation->features;
  if (ern_renderer_accepts(portrait->renderer, features, portrait->features_path) != ERN_OK)
    return session_fail(session);
  if (!portrait->info.has_torso && !portrait->clip_info.has_torso)
    session_warn(session, "%s: has no torso_imgs, the head is rendered over the background alone",
                 portrait->source.path);
  status = portrait_cut(portrait, session, args, &evaluation->frame_source, features);
  return status == 0 ? portrait_prune_occupancy(portrait, session, &evaluation->frame_source, features) : status;
}

void evaluate_close(struct evaluation *evaluation) {
  if (evaluation->session == NULL) return;
  free(evaluation->windows);
  free(evaluation->rgb);
  free(evaluation->rgba);
  background_free(&evaluation->background, evaluation->session);
  frame_source_free(&evaluation->frame_source);
}

int evaluate_input(struct evaluation *evaluation, const ern_model *model, size_t k, ern_frame_input *input) {
  const struct source_frame *source_frame = &evaluation->frame_source.source_frame[k];
  const uint8_t *torso = NULL;
  ern_model_info about;
  ern_model_describe(model, &about);
  const bool behind = evaluation->recorded_torso || !about.has_torso;
  if (behind && background_torso(&evaluation->background, evaluation->session, evaluation->clip, source_frame->split,
                                 source_frame->index, &torso) != 0)
    return EXIT_FAILURE;
  frame_source_windows(&evaluation->frame_source, k, evaluation->features, evaluation->pad, evaluation->windows);
  const ern_camera camera = frame_source_camera(&evaluation->frame_source, k, evaluation->scale, evaluation->info.width,
                                                evaluation->info.height, ERN_FIT_CONTAIN);
  *input = (ern_frame_input){.camera = camera,
                             .windows = evaluation->windows,
                             .window_length = evaluation->features->window_length,
                             .eye = source_frame->eye,
                             .individual = ERN_INDIVIDUAL_MEAN,
                             .background = evaluation->background.image.data,
                             .torso = torso,
                             .torso_motion = frame_source_motion(&evaluation->frame_source, k)};
  if (frame_source_refines(&about, &evaluation->info)) {
    memcpy(evaluation->refined, camera.pose, sizeof evaluation->refined);
    frame_source_refine(&evaluation->frame_source, model, source_frame, evaluation->refined);
    input->head_pose = evaluation->refined;
  }
  if (evaluation->head_pose != NULL) input->head_pose = evaluation->head_pose;
  return 0;
}

int evaluate_truth(const struct evaluation *evaluation, const struct source_frame *frame, ern_image *truth) {
  if (evaluation->recorded != NULL)
    return recorded_picture_read(evaluation->recorded, evaluation->session, frame->pose.img_id, truth);
  const ern_status status = ern_clip_pixels(evaluation->clip, frame->split, frame->index, truth, NULL);
  return status == ERN_OK ? 0 : session_fail(evaluation->session);
}

int evaluate_draw(struct evaluation *evaluation, ern_renderer *renderer, const ern_model *model, size_t k,
                  struct evaluated *evaluated) {
  ern_frame_input input;
  *evaluated = (struct evaluated){.has_head = false};
  if (evaluate_input(evaluation, model, k, &input) != 0) return EXIT_FAILURE;
  const ern_frame_output output = {.rgba = evaluation->rgba, .rgb = evaluation->bytes_alone ? NULL : evaluation->rgb};
  const double began = session_seconds();
  int status = 0;
  if (evaluation->dubbed != NULL)
    status = dubbed_draw(evaluation->dubbed, renderer, &evaluation->frame_source, k, &input, output.rgba, output.rgb,
                         &evaluated->times);
  else if (ern_renderer_frame(renderer, &input, &output, &evaluated->times) != ERN_OK)
    status = session_fail(evaluation->session);
  evaluated->ms = 1000 * (session_seconds() - began);
  return status;
}

int evaluate_picture(struct evaluation *evaluation, size_t k, struct evaluated *evaluated) {
  const struct source_frame *source_frame = &evaluation->frame_source.source_frame[k];
  ern_image truth = {0};
  ern_box box;
  if (evaluate_truth(evaluation, source_frame, &truth) != 0) return EXIT_FAILURE;
  evaluated->psnr = ern_psnr(evaluation->rgb, truth.data, truth.width, truth.height, NULL);
  if (ern_ssim(evaluation->session->context, evaluation->rgb, truth.data, truth.width, truth.height,
               &evaluated->ssim) != ERN_OK)
    return session_fail(evaluation->session);
  const ern_clip_frame *frame = ern_clip_frame_at(evaluation->clip, source_frame->split, source_frame->index);
  evaluated->has_head = region_head(frame, truth.width, truth.height, &box);
  if (evaluated->has_head) evaluated->head = ern_psnr(evaluation->rgb, truth.data, truth.width, truth.height, &box);
  evaluated->has_mouth = region_mouth(frame, truth.width, truth.height, &box);
  if (evaluated->has_mouth) evaluated->mouth = ern_psnr(evaluation->rgb, truth.data, truth.width, truth.height, &box);
  if (evaluation->dubbed != NULL && !dubbed_add(evaluation->dubbed, source_frame, evaluation->rgb))
    return session_fail_with(evaluation->session, "no memory for the measures of a dubbed frame");
  if (evaluation->measures != NULL &&
      !measures_add(evaluation->measures, frame, truth.width, truth.height, truth.data, evaluation->rgb))
    return session_fail_with(evaluation->session, "no memory for the measures of a frame");
  return 0;
}

int evaluate_frame(struct evaluation *evaluation, ern_renderer *renderer, const ern_model *model, size_t k,
                   struct evaluated *evaluated) {
  const int status = evaluate_draw(evaluation, renderer, model, k, evaluated);
  return status == 0 ? evaluate_picture(evaluation, k, evaluated) : status;
}
