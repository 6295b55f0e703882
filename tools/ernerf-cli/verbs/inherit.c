/* SPDX-License-Identifier: MIT */
#include "verbs/inherit.h"

#include <inttypes.h>

#include "session/speech_model.h"

void inherit_model(const struct args *args, const ern_model_info *model, bool chosen, ern_train_config *config) {
  if (!args_given(args, "levels")) config->levels = model->levels;
  if (!args_given(args, "ind_num") && !chosen) config->codes = model->codes;
  if (!args_given(args, "bound")) config->bound = model->bound;
  if (!args_given(args, "backbone")) config->backbone = model->backbone;
  if (!args_given(args, "attention")) config->attention = model->attention;
  if (!args_given(args, "eye-attention")) config->eye_attention = model->eye_attention;
}

void inherit_camera_settings(const struct args *args, const ern_model_info *model, bool torso, ern_train_config *config,
                             float *scale) {
  if (!model->has_view_settings) return;
  if (!args_given(args, "scale")) *scale = model->scale;
  if (!args_given(args, "dt_gamma")) config->dt_gamma = model->dt_gamma;
  if (!args_given(args, "max_steps")) config->max_steps = model->max_steps;
  if (!args_given(args, "audio-pad")) config->audio_pad = model->audio_pad;
  if (torso && !args_given(args, "torso_shrink")) config->torso_shrink = model->torso_shrink;
}

void inherit_head(const struct args *args, const ern_model *head, ern_train_config *config, float *scale) {
  ern_model_info info;
  ern_model_describe(head, &info);
  inherit_camera_settings(args, &info, false, config, scale);
}

void inherit_state(const struct args *args, const ern_train_state *state, const ern_model_info *model,
                   ern_train_config *config) {
  if (!args_given(args, "seed")) config->seed = state->seed;
  if (!args_given(args, "rays") && state->rays > 0) config->rays = state->rays;
  if (!args_given(args, "torso-gamma")) config->torso_gamma = state->torso_gamma || (state->torso && model->has_gamma);
  if (!state->has_settings) return;
  if (!args_given(args, "head-background")) config->head_random_background = state->head_random_background;
  if (!args_given(args, "torso-background")) config->torso_random_background = state->torso_random_background;
  if (!args_given(args, "iters")) config->iters = state->iters;
  if (!args_given(args, "iters") && !args_given(args, "time")) config->seconds = state->budget;
  if (!args_given(args, "lr")) config->lr = state->lr;
  if (!args_given(args, "lr_net")) {
    config->lr_net = state->lr_net;
    config->lr_att = state->lr_att;
  }
  if (!args_given(args, "refresh-every")) config->refresh_every = state->refresh_every;
  if (!args_given(args, "ema") && !args_given(args, "no-ema")) config->ema = state->ema;
  if (!args_given(args, "frames-per-step") && state->torso == config->torso)
    config->frames_per_step = state->frames_per_step;
  if (!args_given(args, "prune-occupancy")) config->prune_share = state->prune_share;
  if (!args_given(args, "step-parts")) config->step_parts = state->step_parts;
  if (!args_given(args, "ray-sampling") && !args_given(args, "for")) config->ray_sampling = state->ray_sampling;
  if (!args_given(args, "stage") && !args_given(args, "fine-steps")) {
    config->fine_steps = config->seconds > 0 ? 0 : state->fine_steps;
    config->fine_share = state->fine_share;
  }
  if (!args_given(args, "patch-size") && state->patch_size > 0) config->patch_size = state->patch_size;
  if (!args_given(args, "fine-weight") && state->patch_size > 0) config->fine_weight = state->fine_weight;
  if (!args_given(args, "fine-lips-weight") && state->patch_size > 0)
    config->fine_lips_weight = state->fine_lips_weight;
  if (!args_given(args, "refine-poses") && !args_given(args, "no-refine-poses"))
    config->refine_poses = state->refine_poses;
  if (!args_given(args, "ema-every")) config->ema_every = state->ema_every;
  if (!args_given(args, "data_range")) {
    config->data_begin = state->data_begin;
    config->data_end = state->data_end;
  }
}

int inherit_frames(const struct args *args, struct session *session, const ern_train_state *state,
                   const char *model_path, const char *clip_path, size_t frames) {
  if (!state->has_settings || args_given(args, "data_range") || state->data_end <= frames) return 0;
  return session_fail_with(session,
                           "%s: has %zu training frames, %s was trained on those from %" PRIu64 " to %" PRIu64
                           "; expected as many, or --data_range A:B",
                           clip_path, frames, model_path, (uint64_t)state->data_begin, (uint64_t)state->data_end);
}

int inherit_speech(struct session *session, const ern_model *head, const char *head_path, const ern_model_info *from,
                   const char *from_path, const ern_clip *clip) {
  ern_clip_info info;
  ern_model_info under;
  ern_clip_describe(clip, &info);
  if (head != NULL) ern_model_describe(head, &under);
  if (head == NULL && from == NULL) return 0;
  return speech_model_check_features(session, head != NULL ? head_path : from_path, head != NULL ? &under : from,
                                     info.features_file, speech_model_clip_kind(clip));
}
