/* SPDX-License-Identifier: MIT */
#include "verbs/head_and_torso.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

/* Resumes a torso only below the same head that it was begun with; that head is finished and is not changed. */
static int resume_torso(struct train_job *job, const ern_train_state *head, const ern_model_info *under) {
  struct session *session = &job->session;
  const bool same = head->step > 0 && head->step >= head->iters && under->head_steps == head->step;
  char trained[64];
  if (same && head->budget > 0 && fabs(head->budget - HEAD_SHARE * job->seconds) < 0.5) {
    job->head_seconds = head->budget;
    return 0;
  }
  job->restarts_torso = true;
  if (session->overwrite) return 0;
  if (!same)
    return session_fail_with(session,
                             "%s: its torso is trained for another head than that of %s; expected another -o, or "
                             "--overwrite, which restarts the torso",
                             job->portrait, job->head_output);
  snprintf(trained, sizeof trained, "%" PRIu64 " steps", head->step);
  if (head->budget > 0) {
    memcpy(trained, "--time ", sizeof "--time ");
    progress_duration(head->budget / HEAD_SHARE, trained + strlen(trained));
  }
  return session_fail_with(session,
                           "%s: its torso is trained for a head of %s, which would change; expected %sanother -o, or "
                           "--overwrite, which restarts the torso",
                           job->portrait, trained, head->budget > 0 ? "that time, " : "");
}

/* Resumes the head's training, unless X is the training of a head alone or the head has no state yet. */
static int resume_portrait(struct train_job *job) {
  struct session *session = &job->session;
  ern_train_state head = {0}, torso = {0};
  ern_model_info model, under = {0};
  const ern_status head_found = ern_train_state_describe(session->context, job->head_output, &head, &model);
  const ern_status found = ern_train_state_describe(session->context, job->portrait, &torso, &under);
  if (found != ERN_OK && found != ERN_E_MISSING) return session_fail(session);
  if (found == ERN_E_MISSING && !session->overwrite && access(job->portrait, F_OK) == 0)
    return session_fail_with(session,
                             "%s: is there, and no training of it can go on; expected its X.run beside it, or another "
                             "-o",
                             job->portrait);
  job->head_alone = found == ERN_OK && !torso.torso;
  if (job->head_alone) return 0;
  if (head_found != ERN_E_MISSING) job->config.output = job->head_output;
  if (head_found != ERN_OK && head_found != ERN_E_MISSING) return 0; /* reported when it is resumed */
  return found == ERN_OK ? resume_torso(job, &head, &under) : 0;
}

int head_and_torso_check(struct train_job *job) {
  struct session *session = &job->session;
  const char *output = job->config.output;
  const size_t stem = strlen(output) - strlen(".safetensors"), bytes = stem + sizeof ".head.safetensors";
  char folder[4096]; /* session_check_training has checked that the name fits */
  job->portrait = output;
  job->head_output = malloc(bytes);
  if (job->head_output == NULL) return session_fail_with(session, "out of memory");
  snprintf(job->head_output, bytes, "%.*s.head.safetensors", (int)stem, output);
  if (session_check_training(session, job->head_output) != 0) return EXIT_FAILURE;
  snprintf(folder, sizeof folder, "%.*s.run", (int)stem, output);
  if (session_check_folder_has_no_input(session, folder) != 0) return EXIT_FAILURE;
  return job->config.resume ? resume_portrait(job) : 0;
}

int head_and_torso_plan(struct train_job *job, const struct args *args) {
  const bool dub = job->config.ray_sampling == ERN_RAY_SAMPLING_DUB;
  if (dub && job->config.output == job->head_output)
    return session_fail_with(&job->session,
                             "%s: is the head of a portrait, and --for dub trains no torso; expected another -o",
                             job->head_output);
  if (!job->effects.has[EFFECT_TORSO] || dub) {
    const int status =
        args_forbid_settings(args, &job->chosen, ERN_SCOPE_TORSO, "is about the torso, and there is none");
    return status < 0 ? 0 : status;
  }
  if (job->head_alone)
    return session_fail_with(&job->session,
                             "%s: its training is that of a head alone, and this one adds a torso; expected --resume "
                             "without --time, --effects without torso, or another -o",
                             job->portrait);
  job->trains_torso_next = true;
  job->config.torso_output = job->portrait;
  job->config.output = job->head_output;
  job->config.seconds = job->head_seconds > 0 ? job->head_seconds : HEAD_SHARE * job->seconds;
  return 0;
}

void head_and_torso_switch_to_torso(struct train_job *job, const ern_train_config *asked) {
  job->config = *asked;
  job->config.torso = true;
  job->config.resume = asked->resume && !job->restarts_torso;
  job->config.from = NULL;
  job->config.frames_per_step = 1; /* the option is the head's, as --precision is */
  job->head_path = job->head_output;
  job->seconds *= 1 - HEAD_SHARE;
  job->source.speech_model.needs = NULL; /* the head's file decides */
  job->has_from = job->has_state;
  job->stepped = false;
}

int head_and_torso_check_resumed(struct train_job *job) {
  struct session *session = &job->session;
  const char *output = job->config.output;
  char head[4096];
  ern_train_state state;
  ern_model_info model;
  const int bytes =
      snprintf(head, sizeof head, "%.*s.head.safetensors", (int)(strlen(output) - strlen(".safetensors")), output);
  if (!job->config.resume || job->config.torso || bytes >= (int)sizeof head) return 0;
  if (ern_train_state_describe(session->context, output, &state, &model) != ERN_E_MISSING) return 0;
  if (ern_train_state_describe(session->context, head, &state, &model) != ERN_OK) return 0;
  return session_fail_with(session, "%s: has no saved state, but its head %s has one; expected --time beside --resume",
                           output, head);
}
