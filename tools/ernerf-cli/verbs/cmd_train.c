/* SPDX-License-Identifier: MIT
 * ernerf train: trains a head, or the torso for it, on a preprocessed clip. */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "ernerf/speech.h"
#include "timed_training.h"
#include "verbs.h"
#include "verbs/consent.h"
#include "verbs/head_and_torso.h"
#include "verbs/inherit.h"
#include "verbs/train_options.h"

enum { PREVIEW_SECONDS = 180 };

enum { VALIDATE_MOST = 1000, VALIDATE_LEAST = 50, TRAIN_MOST_RATE = 1000 /* of the settings lr, lr_net, lr_att */ };

static bool asks_auto(const struct train_job *job) { return strcmp(job->effects_list, "auto") == 0; }

static int check_effects(struct train_job *job, const struct args *args) {
  const int status = effects_read(args, job->effects_list, &job->effects);
  if (status < 0 && !job->effects.has[EFFECT_CODES] && job->config.codes > 0)
    return args_refuse(args, "--set codes is %d, but --effects has no codes", job->config.codes);
  return status;
}

/* A torso takes no options of a head. */
static int check_torso_usage(const struct train_job *job, const struct args *args) {
  static const char why[] = "is about the head, which --torso does not change";
  int status = args_forbid(args, "for effects speech-augment " FINE_STAGE_NAMES, why);
  if (status < 0) status = args_forbid_settings(args, &job->chosen, ERN_SCOPE_HEAD, why);
  if (status < 0) status = args_forbid_settings(args, &job->chosen, ERN_SCOPE_FINE, why);
  return status;
}

static int check_usage(struct train_job *job, const struct args *args) {
  const ern_train_config *config = &job->config;
  if (config->output == NULL) return args_refuse(args, "-o X.safetensors is missing");
  const char *dot = strrchr(config->output, '.');
  if (dot == NULL || strcmp(dot, ".safetensors") != 0)
    return args_refuse(args, "-o is \"%s\", expected a name that ends in .safetensors", config->output);
  int status = -1;
  if (config->torso && job->head_path == NULL) status = args_refuse(args, "--torso needs the head: --head MODEL");
  if (!config->torso) status = args_forbid(args, "head force", "is about the torso, so it needs --torso");
  if (status < 0 && !config->torso && !(job->seconds > 0))
    status =
        args_forbid_settings(args, &job->chosen, ERN_SCOPE_TORSO, "is about the torso, so it needs --torso or --time");
  if (status < 0 && config->torso) status = check_torso_usage(job, args);
  if (status < 0 && args_given(args, "for"))
    status = args_forbid_setting(args, &job->chosen, "ray_sampling", "and --for both choose rays");
  if (status < 0 && job->purpose == FOR_DUB)
    status = args_forbid_settings(args, &job->chosen, ERN_SCOPE_TORSO, "is about the torso, which --for dub lacks");
  if (status < 0 && job->source.features != NULL)
    status = args_forbid(args, "asr-model", "chooses the clip's speech, not --audio");
  if (status < 0 && (config->backbone == ERN_BACKBONE_TRIPLANE || config->backbone == ERN_BACKBONE_MLP))
    status = args_forbid_setting(args, &job->chosen, "levels", "is about hash grids, which this backbone has none of");
  if (status < 0 && !asks_auto(job)) status = check_effects(job, args);
  if (status < 0) status = fine_stage_check(&job->fine, args, &job->chosen, job->paper);
  if (status < 0 && config->resume) status = args_forbid(args, "from", "and --resume both say where to start");
  if (status < 0 && job->paper) status = args_forbid(args, "time resume", "and --paper both say how it is trained");
  if (status < 0 && job->seconds > 0)
    status = args_forbid(args, "iters save-every validate-every", "counts steps, and --time says when it ends");
  if (status < 0 && job->seconds > 0)
    status = args_forbid_setting(args, &job->chosen, "fine_steps", "counts steps, and --time says when it ends");
  return status;
}

/* ---- opening ----------------------------------------------------------------------------------------------------- */

/* Chooses the effects: those that the clip calls for, or those of --from, or those of --effects if the clip has data to
 * train them. */
static int choose_effects(struct train_job *job) {
  const bool chosen = asks_auto(job);
  struct effects *effects = &job->effects;
  ern_clip_measures measures;
  if (chosen && job->has_from && !job->config.torso) {
    bool layer = job->clip_info.has_torso && (!job->state.has_settings || job->state.torso_layer);
    if (layer && !job->has_state) { /* the clip decides, as no model file tells it */
      if (ern_clip_measure(job->clip, &measures) != ERN_OK) return session_fail(&job->session);
      effects_choose(&measures, effects);
      layer = effects->has[EFFECT_TORSO];
    }
    *effects = (struct effects){{job->from.has_eye, job->from.has_codes, job->from.has_view, layer}};
    return 0;
  }
  if (chosen) {
    if (ern_clip_measure(job->clip, &measures) != ERN_OK) return session_fail(&job->session);
    effects_choose(&measures, effects);
    if (!job->config.torso && !effects_has_speech(&measures))
      return session_fail_with(&job->session,
                               "%s: %s is the same in every window, so the mouth would not move; expected features "
                               "of speech, or --effects LIST, which trains the head nevertheless",
                               job->source.path, job->clip_info.features_file);
    if (job->config.torso && job->clip_info.has_torso && !effects->has[EFFECT_TORSO])
      return session_fail_with(&job->session, "%s: torso_imgs is transparent everywhere: there is no torso to learn",
                               job->source.path);
    return 0;
  }
  if (effects->has[EFFECT_EYE] && !job->clip_info.has_blink)
    return session_fail_with(&job->session, "%s: --effects has eye, and there is no au.csv to learn it from",
                             job->source.path);
  if (effects->has[EFFECT_TORSO] && !job->clip_info.has_torso)
    return session_fail_with(&job->session, "%s: --effects has torso, and there are no torso_imgs to put behind it",
                             job->source.path);
  return 0;
}

/* Only a head with eyes can have --set eye-attention=concat. */
static int check_eyes(struct train_job *job) {
  if (job->config.torso || job->config.eye_attention != ERN_EYE_ATTENTION_CONCAT || job->effects.has[EFFECT_EYE])
    return 0;
  const char *why = !job->clip_info.has_blink ? "there is no au.csv"
                    : !asks_auto(job)         ? "--effects has no eye"
                    : job->has_from           ? "the head that it begins with has no eyes"
                                              : "no lid moves in au.csv";
  return session_fail_with(&job->session, "%s: the eye attention is concat, and %s", job->source.path, why);
}

/* Puts the effects into the configuration of a head; a torso adopts those of its head. */
static void take_effects(struct train_job *job, ern_dataset *dataset) {
  const bool *has = job->effects.has;
  if (job->config.torso) return;
  dataset->has_eye = dataset->has_eye && has[EFFECT_EYE];
  dataset->has_torso = dataset->has_torso && has[EFFECT_TORSO];
  job->config.no_view = !has[EFFECT_VIEW];
  if (!has[EFFECT_CODES] && !setting_given(&job->chosen, "codes")) job->config.codes = 0;
  job->effects.has[EFFECT_EYE] = dataset->has_eye;
  job->effects.has[EFFECT_TORSO] = dataset->has_torso;
  job->effects.has[EFFECT_CODES] = job->config.codes != 0;
}

/* The schedule of the public code for the coarse stage; iters and rays are the defaults. */
static void follow_paper(const struct setting_choice *chosen, bool for_given, ern_train_config *config) {
  if (!setting_given(chosen, "refresh_every")) config->refresh_every = 16;
  if (!setting_given(chosen, "ray_sampling") && !for_given) config->ray_sampling = ERN_RAY_SAMPLING_UNIFORM;
  if (!setting_given(chosen, "torso_random_background")) config->torso_random_background = false;
  if (!setting_given(chosen, "head_random_background")) config->head_random_background = false;
  if (!setting_given(chosen, "torso_motion")) config->torso_motion = false;
  if (!setting_given(chosen, "voice_fade")) config->voice_fade = false;
}

/* With --time, the best settings for a limited time (docs/results.md) for options that were not given. */
static void choose_timed(const struct train_job *job, ern_train_config *config) {
  const struct setting_choice *chosen = &job->chosen;
  const bool at_once = job->session.backend_choice == SESSION_OPENCL || job->distributed.world.communicator.size > 1;
  if (!setting_given(chosen, "rays")) config->rays = at_once || config->torso ? TIMED_RAYS_AT_ONCE : TIMED_RAYS;
  if (!setting_given(chosen, "ema")) config->ema = true;
  if (!setting_given(chosen, "ema_every")) config->ema_every = TIMED_EMA_EVERY;
  if (config->torso) return;
  if (!setting_given(chosen, "frames_per_step") && at_once)
    config->frames_per_step = config->rays < TIMED_FRAMES_AT_ONCE ? config->rays : TIMED_FRAMES_AT_ONCE;
  if (!setting_given(chosen, "prune_share")) config->prune_share = TIMED_PRUNE_SHARE;
}

/* With several processes and without the option, divides a step into enough parts for all of them. */
static void choose_parts(struct train_job *job) {
  enum { PARTS = 4 };
  ern_train_config *config = &job->config;
  const int processes = job->distributed.world.communicator.size;
  config->communicator = distributed_communicator(&job->distributed);
  if (processes > 1 && !setting_given(&job->chosen, "step_parts") && config->step_parts == 1)
    config->step_parts = processes > PARTS ? processes : PARTS;
}

static void fill_config(struct train_job *job, const struct args *args) {
  ern_train_config *config = &job->config;
  config->seconds = job->seconds;
  if (job->seconds > 0) choose_timed(job, config);
  config->overwrite = job->session.overwrite;
  config->seed = job->session.seed;
  if (job->has_state) inherit_state(args, &job->chosen, &job->state, &job->from);
  const uint64_t tenth = config->iters / 10;
  if (!setting_given(&job->chosen, "validate_every"))
    config->validate_every = tenth > VALIDATE_MOST ? VALIDATE_MOST : tenth < VALIDATE_LEAST ? VALIDATE_LEAST : tenth;
  config->threads = job->session.threads;
  if (args_given(args, "for"))
    config->ray_sampling = job->purpose == FOR_DUB ? ERN_RAY_SAMPLING_DUB : ERN_RAY_SAMPLING_REGIONS;
  fine_stage_choose(&job->fine, args, &job->chosen, job->has_state);
  if (job->paper) follow_paper(&job->chosen, args_given(args, "for"), config);
  if (job->paper) fine_stage_follow_paper(&job->fine, args, config);
  if (args_given(args, "precision") && !job->trains_torso_next) /* that torso's is fp32 */
    config->precision = (ern_precision)(ERN_PRECISION_FP32 + job->precision);
  config->head = job->head;
  if (job->has_from) {
    const size_t frames = job->clip_info.frames[ERN_SPLIT_TRAIN];
    inherit_model(&job->chosen, &job->from, asks_auto(job));
    if (config->from != NULL && !setting_given(&job->chosen, "codes") && config->codes > 0 &&
        (size_t)config->codes < frames)
      config->codes = (int)frames; /* has more frames */
    inherit_camera_settings(args, &job->chosen, &job->from, job->from.has_torso || job->has_state, &job->scale);
  }
  if (job->head != NULL) {
    ern_model_info head;
    ern_model_describe(job->head, &head);
    inherit_camera_settings(args, &job->chosen, &head, false, &job->scale);
  }
  choose_parts(job);
  if (setting_given(&job->chosen, "lr_net") && !setting_given(&job->chosen, "lr_att"))
    config->lr_att = fminf(5 * config->lr_net, TRAIN_MOST_RATE);
  if (args_given(args, "data-range")) {
    config->data_begin = (size_t)job->data.begin;
    config->data_end = job->data.open_end ? job->clip_info.frames[ERN_SPLIT_TRAIN] : (size_t)job->data.end;
  }
}

/* Settings that were given and change nothing beside the others. */
static void warn_of_unused(struct train_job *job) {
  const ern_train_config *config = &job->config;
  if (setting_given(&job->chosen, "dt_gamma") && config->max_steps <= SESSION_EVEN_STEPS)
    session_warn(&job->session,
                 "--set dt-gamma=%g changes nothing in this training, with %d samples a ray, expected --set max-steps "
                 "above %d; the model keeps it",
                 (double)config->dt_gamma, config->max_steps, SESSION_EVEN_STEPS);
  if (setting_given(&job->chosen, "lr") && !config->torso && config->backbone == ERN_BACKBONE_MLP)
    session_warn(&job->session, "--set lr=%g is about hash grids, which the backbone mlp has none of",
                 (double)config->lr);
}

static int open_clip(struct train_job *job, const struct args *args) {
  const int opened = clip_source_open(&job->source, &job->session, &job->clip);
  speech_model_close(&job->source.speech_model); /* frees its memory for the training */
  if (opened != 0) return EXIT_FAILURE;
  ern_clip_describe(job->clip, &job->clip_info);
  const char *earlier = job->config.from != NULL ? job->config.from : job->config.output;
  if (inherit_speech(&job->session, job->head, job->head_path, job->has_from ? &job->from : NULL, earlier, job->clip) !=
      0)
    return EXIT_FAILURE;
  const size_t frames = job->clip_info.frames[ERN_SPLIT_TRAIN];
  if (args_given(args, "data-range") && (job->data.begin >= frames || (!job->data.open_end && job->data.end > frames)))
    return args_refuse(
        args, "--data-range is %" PRIu64 ":%" PRIu64 ", expected A:B with 0 <= A < B <= %zu, the training frames",
        job->data.begin, job->data.open_end ? (uint64_t)frames : job->data.end, frames);
  return job->has_state ? inherit_frames(args, &job->session, &job->state, earlier, job->source.path, frames) : 0;
}

static void say_length(struct train_job *job) {
  const ern_train_config *config = &job->config;
  char length[64], time[32];
  progress_duration(config->seconds, time);
  if (config->seconds > 0)
    snprintf(length, sizeof length, "%s in all, steps", time);
  else
    snprintf(length, sizeof length, "%" PRIu64 " steps", config->iters);
  session_note(&job->session, "train: %s of %d rays, seed %" PRIu64 ", %s (%s); writes %s and %s", length, config->rays,
               config->seed, job->session.backend_info.name, job->session.backend_info.isa, config->output,
               ern_trainer_folder(job->trainer));
  if (job->seconds > 0 && job->seconds < PREVIEW_SECONDS && !config->torso)
    session_note(&job->session,
                 "train: a preview: the mouth moves, and details are soft; some 5 min make them sharper");
}

/* Prints what is trained, on which data, and the output file. */
static void say_plan(struct train_job *job) {
  const ern_communicator *communicator = &job->distributed.world.communicator;
  const int each = job->config.rays / communicator->size;
  if (communicator->size > 1)
    session_note_rank(&job->session, "train: rank %d of %d: rays %d to %d of the %d of a step", communicator->rank,
                      communicator->size, communicator->rank * each, (communicator->rank + 1) * each - 1,
                      job->config.rays);
  if (communicator->rank > 0) return;
  const ern_clip_info *info = &job->clip_info;
  const ern_train_config *config = &job->config;
  const ern_features *features = ern_clip_features(job->clip);
  const size_t frames = config->data_end > 0 ? config->data_end - config->data_begin : info->frames[ERN_SPLIT_TRAIN];
  if (config->torso)
    session_note(&job->session, "train: the torso for %s, from %zu frames of %d x %d", job->head_path, frames,
                 info->width, info->height);
  else
    session_note(&job->session,
                 "train: a head from %zu frames of %d x %d; the mouth follows %s (%s, %d wide), the lids %s; %s",
                 frames, info->width, info->height, info->features_file,
                 info->speech[0] != 0 ? info->speech : "unknown kind", features->width,
                 job->effects.has[EFFECT_EYE] ? "follow au.csv"
                 : info->has_blink            ? "are not modelled"
                                              : "stay still (no au.csv)",
                 info->has_landmarks ? "the face is known by its landmarks" : "no landmarks");
  if (!config->torso) {
    char list[64];
    effects_words(&job->effects, list, sizeof list);
    session_note(&job->session, "train: effects %s%s", list, asks_auto(job) ? " (`ernerf check` says why)" : "");
  }
  say_length(job);
}

/* Reads the description of the --from file: its training settings are adopted. */
static int describe_from(struct train_job *job) {
  ern_model *model = NULL;
  if (ern_model_load(&model, job->session.context, job->config.from) != ERN_OK) return EXIT_FAILURE;
  ern_model_describe(model, &job->from);
  job->has_from = true;
  ern_model_free(&model);
  return 0;
}

/* Where nothing else is asked for, a sound is heard as the earlier model heard it. */
static void choose_kind(struct clip_source *source, const char *kind) {
  if (source->asr_model != NULL || source->speech_model.path != NULL) return;
  if (strcmp(kind, ERN_SPEECH_CEPSTRA) == 0) source->asr_model = ERN_SPEECH_CEPSTRA;
  if (strcmp(kind, ERN_SPEECH_ARTICULATORY) == 0) source->asr_model = ERN_SPEECH_ARTICULATORY;
}

/* Describes the model or state that the training continues, and selects its speech network unless an option selects
 * one. */
static int open_earlier(struct train_job *job) {
  struct session *session = &job->session;
  struct speech_model *speech_model = &job->source.speech_model;
  ern_train_state state;
  ern_model_info head, model;
  if (job->head_path != NULL && ern_model_load(&job->head, session->context, job->head_path) != ERN_OK)
    return session_fail(session);
  if (job->config.from != NULL && describe_from(job) != 0) return session_fail(session);
  /* A state that is unreadable or of the other kind is reported when it is resumed. */
  if (job->config.resume && ern_train_state_describe(session->context, job->config.output, &state, &model) == ERN_OK &&
      state.torso == job->config.torso) {
    job->state = state;
    job->from = model;
    job->has_from = job->has_state = true;
  }
  if (job->head != NULL) {
    ern_model_describe(job->head, &head);
    choose_kind(&job->source, head.speech);
    return speech_model_open(speech_model, session, job->head_path, &head);
  }
  if (job->has_from) choose_kind(&job->source, job->from.speech);
  if (!job->has_from || speech_model->needs != NULL) return 0;
  return speech_model_open(speech_model, session, job->has_state ? job->config.output : job->config.from, &job->from);
}

static int open_all(struct train_job *job, const struct args *args) {
  struct session *session = &job->session;
  ern_dataset dataset;
  int status = open_earlier(job);
  if (status == 0) status = open_clip(job, args);
  if (status != 0) return status;
  fill_config(job, args);
  warn_of_unused(job);
  if (job->has_state && !job->config.torso)
    status = fine_stage_check_resumed(args, &job->chosen, session, &job->state, &job->fine);
  if (status == 0) status = fine_stage_open(&job->fine, session, &job->config);
  if (status != 0) return status;
  if ((status = choose_effects(job)) != 0 || (status = check_eyes(job)) != 0) return status;
  if (job->config.ray_sampling == ERN_RAY_SAMPLING_DUB && !job->config.torso && !job->clip_info.has_landmarks)
    return session_fail_with(session, "%s: has no landmarks (ori_imgs/ID.lms), and --for dub needs them",
                             job->source.path);
  if (setting_given(&job->chosen, "head_random_background") && job->config.head_random_background &&
      !job->clip_info.has_parsing)
    return session_fail_with(session, "%s/parsing: is missing, and --set head-random-background=yes needs it",
                             job->source.path);
  ern_clip_dataset(job->clip, &dataset);
  if (job->paper && !args_given(args, "speech-augment")) job->speech.off = true;
  if (!job->config.torso) status = speech_augmentation_make(&job->speech, session, job->clip, &dataset);
  if (status != 0) return status;
  take_effects(job, &dataset);
  if (job->seconds > 0 && !job->config.torso && (status = head_and_torso_plan(job, args)) != 0) return status;
  dataset.scale = job->scale;
  if (session_backend(session) != ERN_OK) return session_fail(session);
  if (ern_trainer_create(&job->trainer, session->backend, &dataset, &job->config) != ERN_OK)
    return session_fail(session);
  return session->rank == 0 ? session_check_folder_has_no_input(session, ern_trainer_folder(job->trainer)) : 0;
}

/* ---- running ----------------------------------------------------------------------------------------------------- */

static int say_progress(void *user, const ern_train_report *report) {
  struct train_job *job = user;
  char more[64];
  if (!(job->config.seconds > 0)) forecast_say(&job->forecast, &job->session, report, &job->config);
  job->progress.rate = report->steps_per_second;
  job->last = *report;
  job->stepped = true;
  snprintf(more, sizeof more, "loss %.5g  PSNR %.2f", report->loss, report->psnr);
  progress_at(&job->progress, report->step, report->iters, more);
  return session_interrupted();
}

static ern_status take_frame(void *user, int split, size_t frame, const float *rgb, const uint8_t *truth) {
  struct train_job *job = user;
  const ern_status status = validations_frame(&job->validations, split, frame, rgb, truth);
  return status == ERN_OK && session_interrupted() ? ERN_E_CANCELLED : status;
}

static ern_status take_validation(void *user, uint64_t step, double psnr, size_t frames, const uint8_t *picture,
                                  int width, int height, const char *name) {
  struct train_job *job = user;
  return validations_end(&job->validations, step, psnr, frames, picture, width, height, name);
}

static json_t *report(const struct train_job *job) {
  const ern_train_report *last = &job->last;
  json_t *effects = json_array();
  for (int e = 0; e < EFFECTS && !job->config.torso; e++)
    if (job->effects.has[e]) json_array_append_new(effects, json_string(effect_name((enum effect)e)));
  return json_pack("{s:o, s:o, s:o, s:o, s:b, s:I, s:I, s:o, s:o, s:o, s:o, s:o, s:I, s:o, s:s, s:s}", "effects",
                   effects, "output", session_text(job->config.output), "run",
                   session_text(ern_trainer_folder(job->trainer)), "clip", session_text(job->source.path), "torso",
                   job->config.torso, "step", (json_int_t)(job->stepped ? last->step : job->config.iters), "iters",
                   (json_int_t)job->config.iters, "loss", job->stepped ? session_number(last->loss) : json_null(),
                   "psnr", job->stepped ? session_number(last->psnr) : json_null(), "seconds",
                   job->stepped ? session_number(last->seconds) : json_null(), "samples_per_ray",
                   job->stepped ? session_number(last->samples_per_ray) : json_null(), "val_psnr",
                   job->validations.frames > 0 ? session_number(job->validations.psnr) : json_null(), "val_frames",
                   (json_int_t)job->validations.frames, "seed", session_whole(job->config.seed), "backend",
                   job->session.backend_info.name, "isa", job->session.backend_info.isa);
}

static int run(struct train_job *job) {
  struct session *session = &job->session;
  char spent[32];
  const ern_train_hooks hooks = {
      .user = job, .progress = say_progress, .validation = take_validation, .validation_frame = take_frame};
  say_plan(job);
  ern_train_report start;
  ern_trainer_describe(job->trainer, &start);
  if (session->rank == 0)
    validations_begin(&job->validations, session, job->trainer, job->clip, job->config.output, job->config.resume);
  forecast_begin(&job->forecast, session_seconds(), start.step);
  progress_begin(&job->progress, session, "train", "steps");
  const ern_status status = ern_trainer_run(job->trainer, &hooks);
  progress_end(&job->progress);
  if (status != ERN_OK && session->rank == 0) validations_take_back(&job->validations);
  if (status == ERN_E_CANCELLED && session_interrupted()) {
    ern_train_report end; /* one step after the last progress report if a validation was interrupted */
    ern_trainer_describe(job->trainer, &end);
    return session_stop_with(session,
                             "stopped after step %" PRIu64 " of %" PRIu64 "; the state is saved, --resume goes on",
                             end.step, end.iters);
  }
  if (status != ERN_OK) return session_fail(session);
  progress_duration(job->last.seconds, spent);
  if (job->stepped)
    session_note(session, "train: done, %s; %s of training", job->config.output, spent);
  else
    session_note(session, "train: all %" PRIu64 " steps were done before; %s is written again", job->config.iters,
                 job->config.output);
  if (session->rank == 0 && !job->config.torso) validations_say_mouth(&job->validations);
  const bool more = job->trains_torso_next && !job->config.torso;
  return more || session->rank > 0 ? 0 : session_report(session, report(job));
}

static void close_training(struct train_job *job) {
  ern_trainer_free(&job->trainer);
  ern_model_free(&job->head);
  ern_clip_free(&job->clip);
  speech_model_close(&job->source.speech_model);
  fine_stage_close(&job->fine);
  validations_free(&job->validations);
}

static int train(struct train_job *job, const struct args *args) {
  int status = open_all(job, args);
  if (status == 0) status = run(job);
  close_training(job);
  return status;
}

/* With --time: trains the head and then, if the clip has a torso, the torso in the remaining time. */
static int train_portrait(struct train_job *job, const struct args *args) {
  const ern_train_config asked = job->config;
  int status = head_and_torso_check(job);
  if (status == 0) status = train(job, args);
  if (status != 0 || !job->trains_torso_next) return status;
  head_and_torso_switch_to_torso(job, &asked);
  return train(job, args);
}

static int run_verb(struct train_job *job, const struct args *args) {
  int status = distributed_open(&job->distributed, &job->session);
  if (status == 0 && !args_given(args, "device")) status = distributed_choose_device(&job->distributed, &job->session);
  if (status == 0) status = session_check_training(&job->session, job->config.output);
  if (status == 0 && job->consent != NULL) {
    status = consent_read(&job->session, job->consent, job->consent_text);
    job->config.consent = job->consent_text;
  }
  const bool portrait = job->seconds > 0 && !job->config.torso;
  if (status == 0 && !portrait) status = head_and_torso_check_resumed(job);
  if (status == 0) status = portrait ? train_portrait(job, args) : train(job, args);
  free(job->head_output);
  distributed_close(&job->distributed, status);
  session_close(&job->session);
  return status;
}

int cmd_train(int argc, char **argv) {
  struct train_job job;
  struct option goal[TRAIN_GOAL_OPTIONS], numbers[TRAIN_NUMBER_OPTIONS], clip[TRAIN_CLIP_OPTIONS],
      fine[FINE_STAGE_OPTIONS], published[TRAIN_PUBLIC_OPTIONS];
  struct word words[] = {
      {"CLIP", &job.source.path, "folder of a preprocessed clip; `ernerf check CLIP` lists what it has"}};
  struct args args = {
      .verb = "train",
      .summary = "Learns a head from a preprocessed clip, or the torso for it.",
      .usage =
          "train CLIP --time 10m -o portrait.safetensors\n"
          "train CLIP -o head.safetensors\n"
          "train CLIP --torso --head head.safetensors -o portrait.safetensors",
      .notes =
          "Ctrl-C saves the state and stops with exit status 130; --resume goes on as if nothing had happened.\n"
          "X.run holds state.safetensors and its predecessor, log.jsonl, measures.csv, curve.csv and its plots over\n"
          "seconds and steps, and val_NNNNNN.png: rendered, recorded, 4 times their difference, attention of speech "
          "and\n"
          "of the eyes.\n"
          "With --time other settings are the default: ema=yes ema-every=40 prune-share=0.3, with\n"
          "--backend opencl or under mpirun frames-per-step=4, and under mpirun step-parts=4, or the number of "
          "processes\n"
          "if that is more (without --time too).",
      .settings = &job.chosen,
      .public_names = true,
      .words = words,
      .word_count = 1,
      .groups = {{"What is trained, and where to:", goal, TRAIN_GOAL_OPTIONS},
                 {"Of the clip:", clip, TRAIN_CLIP_OPTIONS},
                 {"How:", numbers, TRAIN_NUMBER_OPTIONS},
                 {"The fine stage of a head:", fine, FINE_STAGE_OPTIONS},
                 {NULL, published, TRAIN_PUBLIC_OPTIONS}}};
  train_set_defaults(&job);
  train_goal_options(&job, goal);
  train_clip_options(&job, clip);
  train_number_options(&job, numbers);
  fine_stage_options(&job.fine, fine);
  train_public_options(&job, published);
  int status = args_parse(&args, argc, argv);
  if (status < 0) status = check_usage(&job, &args);
  if (status < 0) status = speech_model_check(&job.source.speech_model, &args, job.source.features);
  job.session.rewrites = true; /* concerns X.run; the trainer protects X itself */
  const char *const inputs[] = {
      job.source.path,          job.source.features,          job.head_path,
      job.config.from,          job.source.speech_model.path, speech_model_file(&job.source.speech_model),
      job.fine.weights.network, job.fine.weights.heads,       job.consent};
  memcpy(job.session.inputs, inputs, sizeof inputs);
  if (status < 0) status = session_open(&job.session, &args);
  return status < 0 ? run_verb(&job, &args) : status;
}
