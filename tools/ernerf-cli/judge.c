/* SPDX-License-Identifier: MIT */
#include "judge.h"

#include <stdlib.h>
#include <string.h>

#include "regions.h"

enum { AUDIO_WINDOWS = 8 };

int judge_open(struct judge *judge, struct session *session, ern_clip *clip, enum shot_split split, float scale,
               ern_audio_pad pad) {
  *judge = (struct judge){.session = session, .clip = clip, .scale = scale, .pad = pad};
  ern_clip_describe(clip, &judge->info);
  judge->features = ern_clip_features(clip);
  const int width = judge->info.width, height = judge->info.height;
  const size_t pixels = (size_t)width * (size_t)height,
               values = (size_t)AUDIO_WINDOWS * (size_t)judge->features->window_length * (size_t)judge->features->width;
  judge->windows = malloc(values * sizeof(float));
  judge->rgb = malloc(pixels * 3 * sizeof(float));
  judge->rgba = malloc(pixels * 4);
  if (judge->windows == NULL || judge->rgb == NULL || judge->rgba == NULL)
    return session_fail_with(session, "no memory for a picture of %d x %d", width, height);
  const int status = shots_of_clip(&judge->shots, session, clip, split);
  return status != 0 ? status : backdrop_open(&judge->backdrop, session, NULL, clip, width, height, ERN_FIT_CONTAIN);
}

void judge_close(struct judge *judge) {
  if (judge->session == NULL) return;
  free(judge->windows);
  free(judge->rgb);
  free(judge->rgba);
  backdrop_free(&judge->backdrop, judge->session);
  shots_free(&judge->shots);
}

int judge_input(struct judge *judge, const ern_model *model, size_t k, ern_frame_input *input) {
  const struct shot *shot = &judge->shots.shot[k];
  const uint8_t *torso = NULL;
  ern_model_info about;
  ern_model_describe(model, &about);
  if (!about.has_torso &&
      backdrop_torso(&judge->backdrop, judge->session, judge->clip, shot->split, shot->index, &torso) != 0)
    return EXIT_FAILURE;
  shots_windows(&judge->shots, k, judge->features, judge->pad, judge->windows);
  const ern_camera camera =
      shots_camera(&judge->shots, k, judge->scale, judge->info.width, judge->info.height, ERN_FIT_CONTAIN);
  *input = (ern_frame_input){.camera = camera,
                             .windows = judge->windows,
                             .window_length = judge->features->window_length,
                             .eye = shot->eye,
                             .background = judge->backdrop.background.data,
                             .torso = torso};
  if (about.cameras > 0 && shot->split == ERN_SPLIT_TRAIN) {
    memcpy(judge->refined, camera.pose, sizeof judge->refined);
    ern_model_refine(model, shot->index, judge->refined);
    input->head_pose = judge->refined;
  }
  return 0;
}

int judge_draw(struct judge *judge, ern_renderer *renderer, const ern_model *model, size_t k, struct judged *judged) {
  ern_frame_input input;
  *judged = (struct judged){.has_head = false};
  if (judge_input(judge, model, k, &input) != 0) return EXIT_FAILURE;
  const ern_frame_output output = {.rgba = judge->rgba, .rgb = judge->bytes_alone ? NULL : judge->rgb};
  const double began = session_seconds();
  const ern_status status = ern_renderer_frame(renderer, &input, &output, &judged->times);
  judged->ms = 1000 * (session_seconds() - began);
  return status == ERN_OK ? 0 : session_fail(judge->session);
}

int judge_frame(struct judge *judge, ern_renderer *renderer, const ern_model *model, size_t k, struct judged *judged) {
  const struct shot *shot = &judge->shots.shot[k];
  ern_image truth = {0};
  ern_box box;
  if (judge_draw(judge, renderer, model, k, judged) != 0) return EXIT_FAILURE;
  if (ern_clip_pixels(judge->clip, shot->split, shot->index, &truth, NULL) != ERN_OK)
    return session_fail(judge->session);
  judged->psnr = ern_psnr(judge->rgb, truth.data, truth.width, truth.height, NULL);
  if (ern_ssim(judge->session->context, judge->rgb, truth.data, truth.width, truth.height, &judged->ssim) != ERN_OK)
    return session_fail(judge->session);
  const ern_clip_frame *frame = ern_clip_frame_at(judge->clip, shot->split, shot->index);
  judged->has_head = region_head(frame, truth.width, truth.height, &box);
  if (judged->has_head) judged->head = ern_psnr(judge->rgb, truth.data, truth.width, truth.height, &box);
  judged->has_mouth = region_mouth(frame, truth.width, truth.height, &box);
  if (judged->has_mouth) judged->mouth = ern_psnr(judge->rgb, truth.data, truth.width, truth.height, &box);
  return 0;
}
