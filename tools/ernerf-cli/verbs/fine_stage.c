/* SPDX-License-Identifier: MIT */
#include "verbs/fine_stage.h"

#include <inttypes.h>
#include <stdlib.h>

enum { STAGE_COARSE, STAGE_FINE };
enum { LOSS_SSIM, LOSS_LPIPS };

static const double timed_share = 0.2;            /* share of the head's time */
static const float published_lips_weight = 0.01f; /* weight of LPIPS on the lips */

void fine_stage_options(struct fine_stage *fine, struct option options[FINE_STAGE_OPTIONS]) {
  *fine = (struct fine_stage){.stage = STAGE_COARSE};
  const struct option rows[] = {
      {ARGS_CHOICE("stage", &fine->stage, "coarse|fine"),
       .help = "fine: the rays of a head's step are square patches, in turn anywhere in the picture and at the lips, "
               "with a loss of their own (docs/maths.md): from the step at which this run begins; with --time in the "
               "last fifth of the head's time, or with --resume or --from in all of the rest. With 2048 rays a step "
               "mostly sharper and the mouth less accurate, with the 512 of --time a lower PSNR (default coarse, with "
               "--resume as before)"},
      {ARGS_CHOICE("fine-loss", &fine->loss, "ssim|lpips"),
       .help = "loss of the patches: ssim: structural similarity at three scales; lpips: LPIPS, as published, with "
               "--lpips-network and --lpips-heads (default ssim)"}};
  ARGS_FILL(options, rows, FINE_STAGE_OPTIONS - LPIPS_OPTIONS);
  lpips_weights_options(&fine->weights, options + FINE_STAGE_OPTIONS - LPIPS_OPTIONS);
}

/* Refuses settings of the fine stage, and the options of its loss, where there is none. */
static int forbid_details(const struct args *args, const struct setting_choice *chosen, const char *why) {
  const int status = args_forbid(args, "fine-loss lpips-network lpips-heads", why);
  return status < 0 ? args_forbid_settings(args, chosen, ERN_SCOPE_FINE, why) : status;
}

int fine_stage_check(const struct fine_stage *fine, const struct args *args, const struct setting_choice *chosen,
                     bool paper) {
  const ern_train_config *config = chosen->config;
  int status = lpips_weights_check(&fine->weights, args);
  const bool published = paper && fine->loss == LOSS_LPIPS;
  if (status < 0 && paper) status = args_forbid(args, "stage", "and --paper both say how it is trained");
  if (status < 0 && paper)
    status = args_forbid_setting(args, chosen, "fine_steps", "and --paper both say how it is trained");
  if (status < 0 && fine->stage == STAGE_COARSE && config->fine_steps == 0 && !config->resume && !published)
    status = forbid_details(args, chosen,
                            "is about the fine stage, which is off; expected --stage fine or --set fine-steps=N too");
  if (status < 0 && args_given(args, "stage"))
    status = args_forbid_setting(args, chosen, "fine_steps", "and --stage both say when the fine stage begins");
  if (status < 0 && fine->loss == LOSS_SSIM)
    status = args_forbid(args, "lpips-network lpips-heads", "is for --fine-loss lpips");
  if (status < 0 && fine->loss == LOSS_LPIPS && fine->weights.network == NULL)
    status = args_refuse(args, "--fine-loss lpips needs --lpips-network and --lpips-heads");
  return status;
}

void fine_stage_follow_paper(const struct fine_stage *fine, const struct args *args, ern_train_config *config) {
  if (fine->loss != LOSS_LPIPS || config->torso) return;
  if (!args_given(args, "iters")) config->iters = 125000;
  config->fine_steps = config->iters / 5;
}

void fine_stage_choose(const struct fine_stage *fine, const struct args *args, const struct setting_choice *chosen,
                       bool resumed) {
  ern_train_config *config = chosen->config;
  const bool given = args_given(args, "stage"), wanted = fine->stage == STAGE_FINE;
  if (config->torso) return;
  if (given && config->seconds > 0)
    config->fine_share = !wanted ? 0 : resumed || config->from != NULL ? 1 : timed_share;
  if (given && !(config->seconds > 0)) config->fine_steps = wanted ? ERN_FINE_ALL : 0;
  if (!setting_given(chosen, "fine_lips_weight") && (!resumed || setting_given(chosen, "fine_weight")))
    config->fine_lips_weight = fine->loss == LOSS_LPIPS ? published_lips_weight : config->fine_weight;
}

int fine_stage_check_resumed(const struct args *args, const struct setting_choice *chosen, struct session *session,
                             const ern_train_state *state, const struct fine_stage *fine) {
  const ern_train_config *config = chosen->config;
  const uint64_t from = state->iters - state->fine_steps;
  if (args_given(args, "stage") && fine->stage == STAGE_COARSE && state->fine_steps > 0 && state->step > from)
    return session_fail_with(session,
                             "--stage coarse: %s is in its fine stage since step %" PRIu64
                             ", and does not leave it; expected --stage fine, or neither",
                             config->output, from);
  if (state->fine_steps > 0 || config->fine_steps > 0 || config->fine_share > 0) return 0;
  const int status = forbid_details(
      args, chosen,
      "is about the fine stage, which this training does not have; expected --stage fine or --set fine-steps=N too");
  return status < 0 ? 0 : status;
}

int fine_stage_open(struct fine_stage *fine, struct session *session, ern_train_config *config) {
  if (fine->loss != LOSS_LPIPS || config->torso) return 0;
  const int status = lpips_weights_open(&fine->weights, session);
  if (status != 0) return status;
  fine->function = ern_lpips_fine_loss(fine->weights.lpips);
  config->fine_loss = &fine->function;
  return 0;
}

void fine_stage_close(struct fine_stage *fine) { lpips_weights_close(&fine->weights); }
