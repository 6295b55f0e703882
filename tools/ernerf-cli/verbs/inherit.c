/* SPDX-License-Identifier: MIT */
#include "verbs/inherit.h"

#include <inttypes.h>
#include <string.h>

#include "session/speech_model.h"

/* The member of the configuration becomes the model's, unless it was on the command line. */
#define FROM_MODEL(member) \
  if (!setting_given(chosen, #member)) config->member = model->member

void inherit_model(const struct setting_choice *chosen, const ern_model_info *model, bool codes) {
  ern_train_config *config = chosen->config;
  FROM_MODEL(levels);
  FROM_MODEL(bound);
  FROM_MODEL(backbone);
  FROM_MODEL(attention);
  FROM_MODEL(eye_attention);
  if (codes) FROM_MODEL(codes);
}

void inherit_camera_settings(const struct args *args, const struct setting_choice *chosen, const ern_model_info *model,
                             bool torso, float *scale) {
  ern_train_config *config = chosen->config;
  if (!model->has_view_settings) return;
  if (!args_given(args, "scale")) *scale = model->scale;
  FROM_MODEL(dt_gamma);
  FROM_MODEL(max_steps);
  FROM_MODEL(audio_pad);
  if (torso) FROM_MODEL(torso_shrink);
}

/* Whether an option decides a setting that the state has too. */
static bool is_decided(const struct args *args, const struct setting_choice *chosen, const ern_setting *s,
                       const ern_train_state *state, const ern_train_config *config) {
  static const struct {
    const char *setting, *option;
  } deciding[] = {{"seed", "seed"},    {"data_begin", "data_range"}, {"data_end", "data_range"}, {"seconds", "iters"},
                  {"seconds", "time"}, {"ray_sampling", "for"},      {"fine_share", "stage"}};
  if (setting_given(chosen, s->name) || strcmp(s->name, "precision") == 0) return true; /* the library's to resume */
  if (strcmp(s->name, "frames_per_step") == 0 && state->torso != config->torso) return true;
  if (strcmp(s->name, "fine_share") == 0 && setting_given(chosen, "fine_steps")) return true;
  for (size_t i = 0; i < sizeof deciding / sizeof *deciding; i++)
    if (strcmp(s->name, deciding[i].setting) == 0 && args_given(args, deciding[i].option)) return true;
  return false;
}

void inherit_state(const struct args *args, const struct setting_choice *chosen, const ern_train_state *state,
                   const ern_model_info *model) {
  ern_train_config *config = chosen->config;
  const ern_setting *s;
  char text[ERN_SETTING_TEXT_BYTES];
  if (!state->has_settings) {
    if (!setting_given(chosen, "torso_gamma")) config->torso_gamma = state->torso && model->has_gamma;
    return;
  }
  for (size_t i = 0; (s = ern_train_setting(i)) != NULL; i++) {
    if (s->resume == ERN_RESUME_FREE || is_decided(args, chosen, s, state, config)) continue;
    ern_setting_write(s, &state->config, text);
    (void)ern_setting_read(s, text, config);
  }
  if (!args_given(args, "stage") && !setting_given(chosen, "fine_steps"))
    config->fine_steps = config->seconds > 0 ? 0 : state->config.fine_steps;
}

int inherit_frames(const struct args *args, struct session *session, const ern_train_state *state,
                   const char *model_path, const char *clip_path, size_t frames) {
  if (!state->has_settings || args_given(args, "data-range") || state->data_end <= frames) return 0;
  return session_fail_with(session,
                           "%s: has %zu training frames, %s was trained on those from %" PRIu64 " to %" PRIu64
                           "; expected as many, or --data-range A:B",
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
