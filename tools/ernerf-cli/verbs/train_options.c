/* SPDX-License-Identifier: MIT */
#include "verbs/train_options.h"

/* Settings that --set does not take: those with an option of their own, and those that --time, --for, --effects and
 * --stage decide. */
static const char elsewhere[] =
    "iters rays levels seed threads save_every validate_every validate_frames data_begin data_end precision seconds "
    "fine_share no_view";

void train_set_defaults(struct train_job *job) {
  *job = (struct train_job){.config = ern_train_config_default(), .scale = 4, .effects_list = "auto"};
  job->chosen = (struct setting_choice){&job->config, ern_train_setting, elsewhere, 0};
  job->session.seed = job->config.seed;
}

void train_goal_options(struct train_job *job, struct option options[TRAIN_GOAL_OPTIONS]) {
  ern_train_config *config = &job->config;
  const struct option rows[] = {
      {ARGS_TEXT("o", &config->output), .alias = "output", .choices = "X.safetensors",
       .help = "the model; state, log and pictures go to the folder X.run beside it"},
      {ARGS_CHOICE("for", &job->purpose, "portrait|dub"),
       .help = "portrait: a model that renders whole pictures; dub: a head for `ernerf dub` alone, which learns the "
               "lower face and spends 95 % of its rays there (needs landmarks; default portrait, with --resume as "
               "before)"},
      {ARGS_FLAG("torso", &config->torso), .help = "train the torso for the head of --head"},
      {ARGS_TEXT("head", &job->head_path), .alias = "head_ckpt", .choices = "MODEL",
       .help = "the head that the torso is trained for; it does not change"},
      {ARGS_FLAG("force", &config->force), .help = "accept a --head that was trained on another clip"},
      {ARGS_TEXT("consent", &job->consent), .choices = "TEXT|FILE",
       .help = "what the person has agreed to, as text or as a file that holds the text; the model keeps it, and its "
               "videos and pictures carry it (default: that of --head, of the resumed state or of --from, if it is of "
               "this clip)"},
      {.name = "iters", ARGS_SETTING(&job->chosen, "iters")},
      {ARGS_SECONDS("time", &job->seconds, 0.1, 1e9),
       .help = "train for T in all, such as 10m, instead of --iters steps: five sixths of T the head, as "
               "X.head.safetensors, then the torso for it, as X.safetensors; if the clip has no torso, the head "
               "alone, as X.safetensors. With --resume or --from T includes the time before"},
      {ARGS_FLAG("paper", &job->paper),
       .help = "the published schedule, unless an option says otherwise: 100000 steps of 65536 rays, and by --set "
               "ray-sampling=uniform, refresh-every=16, head-random-background=no, torso-random-background=no, "
               "torso-motion=no, voice-fade=no; no data augmentation of the speech; with --fine-loss lpips a head has "
               "125000 steps, the last 25000 of them in "
               "the fine stage"},
      {ARGS_FLAG("resume", &config->resume),
       .help = "continue from the newest intact state in X.run, with the options that it was trained with unless they "
               "are given again"},
      {ARGS_TEXT("from", &config->from), .choices = "FILE",
       .help = "start another training from the weights of a .safetensors or .pth file, with its levels, individual "
               "codes (a longer clip gets new ones for the other frames) and variants (backbone, attention, "
               "eye-attention); if the file holds a training state, also from its step"},
      {.name = "save-every",
       ARGS_SETTING(&job->chosen, "save_every"),
       .help = "steps between saves; 0: only at the end; with --time every minute"},
      {.name = "validate-every",
       ARGS_SETTING(&job->chosen, "validate_every"),
       .help = "steps between validations, each with a picture and a point of the curve; 0: only at the end (default "
               "a tenth of --iters, 50 to 1000; with --time each tenth of the time, at most once a minute)"},
      {.name = "validate-frames", ARGS_SETTING(&job->chosen, "validate_frames")},
      {ARGS_TEXT("effects", &job->effects_list), .choices = "auto|none|LIST",
       .help = "what the head models, comma-separated: eye (blinks), codes (a learnt vector for each training "
               "frame), view (the colour depends on the direction of view), torso (the clip's torso picture lies "
               "behind the head); auto: what `ernerf check` finds in the clip (default auto)"}};
  ARGS_FILL(options, rows, TRAIN_GOAL_OPTIONS);
}

void train_number_options(struct train_job *job, struct option options[TRAIN_NUMBER_OPTIONS]) {
  const struct option rows[] = {
      {.name = "rays",
       .alias = "num_rays",
       ARGS_SETTING(&job->chosen, "rays"),
       .help = "rays a step (default 65536; with --time 512, but 2048 for a torso, with --backend opencl or under "
               "mpirun); a step of the fine stage has one patch at least, which may be more"},
      {.name = "levels",
       ARGS_SETTING(&job->chosen, "levels"),
       .help = "levels of the hash encoder, 2 to 24 (default 14; hash3d 16); public checkpoints have 12"},
      {ARGS_CHOICE("precision", &job->precision, "fp32|bf16|auto"),
       .help = "number format of the factors in a head's matrix products; auto: bf16 with --isa avx512bf16, else "
               "fp32 (default fp32, with --resume as before)"},
      {ARGS_FLOAT("scale", &job->scale, 0.001, 1000),
       .help = "factor of the poses' translations; kept in the model (default 4)"},
      {ARGS_RANGE_PAIR("data-range", &job->data), .choices = "A:B | A B",
       .help = "train on frames [A, B) of transforms_train.json alone; B -1: to the last"}};
  ARGS_FILL(options, rows,
            TRAIN_NUMBER_OPTIONS - SESSION_COMPUTE_OPTIONS - SESSION_SEED_OPTIONS - SESSION_OUTPUT_OPTIONS);
  struct option *common = options + sizeof rows / sizeof rows[0];
  session_compute_options(&job->session, common);
  session_seed_options(&job->session, common + SESSION_COMPUTE_OPTIONS);
  session_output_options(&job->session, common + SESSION_COMPUTE_OPTIONS + SESSION_SEED_OPTIONS);
}

void train_clip_options(struct train_job *job, struct option options[TRAIN_CLIP_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_TEXT("audio", &job->source.features), .alias = "aud",
       .help = "the clip's speech from another file: a sound, or speech features (.npy); instead of the clip's own"},
  };
  ARGS_FILL(options, rows, TRAIN_CLIP_OPTIONS - CLIP_SOURCE_OPTIONS - SPEECH_AUGMENTATION_OPTIONS);
  clip_source_options(&job->source, options + sizeof rows / sizeof *rows);
  speech_augmentation_options(&job->speech, options + sizeof rows / sizeof *rows + CLIP_SOURCE_OPTIONS);
}

void train_public_options(struct train_job *job, struct option options[TRAIN_PUBLIC_OPTIONS]) {
  static const struct {
    const char *name, *member;
  } names[] = {{"lr", "lr"},
               {"lr-net", "lr_net"},
               {"ind-num", "codes"},
               {"max-steps", "max_steps"},
               {"dt-gamma", "dt_gamma"},
               {"bound", "bound"},
               {"torso-shrink", "torso_shrink"},
               {"patch-size", "patch_size"},
               {"update-extra-interval", "refresh_every"}};
  static_assert(sizeof names / sizeof *names == TRAIN_PUBLIC_OPTIONS, "the table has another number of rows");
  for (size_t i = 0; i < TRAIN_PUBLIC_OPTIONS; i++)
    options[i] = (struct option){.name = names[i].name, ARGS_SETTING(&job->chosen, names[i].member), .unlisted = true};
}
