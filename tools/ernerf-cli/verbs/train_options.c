/* SPDX-License-Identifier: MIT */
#include "verbs/train_options.h"

void train_set_defaults(struct train_job *job) {
  *job = (struct train_job){.config = ern_train_config_default(), .scale = 4};
  job->effects_list = "auto";
  job->iters = job->config.iters;
  job->save_every = job->config.save_every;
  job->ema_every = job->config.ema_every;
  job->refresh_every = job->config.refresh_every;
  job->session.seed = job->config.seed;
}

void train_goal_options(struct train_job *job, struct option options[TRAIN_GOAL_OPTIONS]) {
  ern_train_config *config = &job->config;
  const struct option rows[] = {
      {.name = "o",
       .alias = "output",
       .kind = OPTION_TEXT,
       .target = &config->output,
       .choices = "X.safetensors",
       .help = "the model; state, log and pictures go to the folder X.run beside it"},
      {.name = "for",
       .kind = OPTION_CHOICE,
       .target = &job->purpose,
       .choices = "portrait|dub",
       .help = "portrait: a model that renders whole pictures; dub: a head for `ernerf dub` alone, which learns the "
               "lower face and spends 95 % of its rays there (needs landmarks; default portrait, with --resume as "
               "before)"},
      {.name = "torso",
       .kind = OPTION_FLAG,
       .target = &config->torso,
       .help = "train the torso for the head of --head"},
      {.name = "head",
       .alias = "head_ckpt",
       .kind = OPTION_TEXT,
       .target = &job->head_path,
       .choices = "MODEL",
       .help = "the head that the torso is trained for; it does not change"},
      {.name = "force",
       .kind = OPTION_FLAG,
       .target = &config->force,
       .help = "accept a --head that was trained on another clip"},
      {.name = "torso-gamma",
       .kind = OPTION_FLAG,
       .target = &config->torso_gamma,
       .help = "train gamma, the factor of the torso's key points, as in the paper (default: it is 1)"},
      {.name = "head-background",
       .kind = OPTION_CHOICE,
       .target = &job->head_background,
       .choices = "random|clip",
       .help = "background behind the head during training, if the clip has parsing/: random: a random colour for "
               "each ray, so that the head keeps no pieces of the clip's background; clip: the clip's torso picture "
               "and background, as published (default random)"},
      {.name = "torso-background",
       .kind = OPTION_CHOICE,
       .target = &job->torso_background,
       .choices = "random|clip",
       .help = "background behind the torso during training: random: a random colour for each ray, so that it is "
               "opaque before any background; clip: the clip's background, as published (default random)"},
      {.name = "consent",
       .kind = OPTION_TEXT,
       .target = &job->consent,
       .choices = "TEXT|FILE",
       .help = "what the person has agreed to, as text or as a file that holds the text; the model keeps it, and its "
               "videos and pictures carry it (default: that of --head, of the resumed state or of --from, if it is of "
               "this clip)"},
      {.name = "iters",
       .kind = OPTION_COUNT,
       .target = &job->iters,
       .low = 1,
       .high = 1e12,
       .help = "steps in all, also when resuming"},
      {.name = "time",
       .kind = OPTION_SECONDS,
       .target = &job->seconds,
       .low = 0.1,
       .high = 1e9,
       .help = "train for T in all, such as 10m, instead of --iters steps: five sixths of T the head, as "
               "X.head.safetensors, then the torso for it, as X.safetensors; if the clip has no torso, the head "
               "alone, as X.safetensors. With --resume or --from T includes the time before"},
      {.name = "paper",
       .kind = OPTION_FLAG,
       .target = &job->paper,
       .help = "the published schedule, unless an option says otherwise: 100000 steps of 65536 rays, --ray-sampling "
               "uniform, --refresh-every 16, --head-background clip, --torso-background clip, no data augmentation of "
               "the speech; with --fine-loss lpips a head has 125000 steps, the last 25000 of them in the fine stage"},
      {.name = "resume",
       .kind = OPTION_FLAG,
       .target = &config->resume,
       .help = "continue from the newest intact state in X.run, with the options that it was trained with unless they "
               "are given again"},
      {.name = "from",
       .kind = OPTION_TEXT,
       .target = &config->from,
       .choices = "FILE",
       .help = "start another training from the weights of a .safetensors or .pth file, with its levels, individual "
               "codes (a longer clip gets new ones for the other frames) and variants (--backbone, --attention, "
               "--eye-attention); if the file holds a training state, also from its step"},
      {.name = "save-every",
       .kind = OPTION_COUNT,
       .target = &job->save_every,
       .low = 0,
       .high = 1e12,
       .help = "steps between saves; 0: only at the end; with --time every minute"},
      {.name = "validate-every",
       .kind = OPTION_COUNT,
       .target = &job->validate_every,
       .low = 0,
       .high = 1e12,
       .help = "steps between validations, each with a picture and a point of the curve; 0: only at the end (default "
               "a tenth of --iters, 50 to 1000; with --time each tenth of the time, at most once a minute)"},
      {.name = "validate-frames",
       .kind = OPTION_INT,
       .target = &config->validate_frames,
       .low = 0,
       .high = 1000000,
       .help = "maximum number of frames that a validation renders; 0: all"},
      {.name = "ema",
       .kind = OPTION_FLAG,
       .target = &config->ema,
       .help = "write the moving average of the weights as the model, once it has 10 updates; with --resume after "
               "the last step the model is only written again (default with --time)"},
      {.name = "no-ema",
       .kind = OPTION_OFF,
       .target = &config->ema,
       .help = "the weights as they are (default without --time)"},
      {.name = "ema-every",
       .kind = OPTION_COUNT,
       .target = &job->ema_every,
       .low = 1,
       .high = 1e12,
       .help = "steps between updates of that average, of which it needs 10; 40 with --time"},
      {.name = "effects",
       .kind = OPTION_TEXT,
       .target = &job->effects_list,
       .choices = "auto|none|LIST",
       .help = "what the head models, comma-separated: eye (blinks), codes (a learnt vector for each training "
               "frame), view (the colour depends on the direction of view), torso (the clip's torso picture lies "
               "behind the head); auto: what `ernerf check` finds in the clip (default auto)"},
      {.name = "levels",
       .kind = OPTION_INT,
       .target = &config->levels,
       .low = 2,
       .high = 24,
       .help = "levels of the hash encoder, 2 to 24 (default 14; hash3d 16); public checkpoints have 12"},
      {.name = "backbone",
       .kind = OPTION_CHOICE,
       .target = &job->backbone,
       .choices = "trihash|hash3d|triplane|mlp",
       .help = "encoder of positions: trihash, as in the paper, or one of its ablation (default trihash)"},
      {.name = "attention",
       .kind = OPTION_CHOICE,
       .target = &job->attention,
       .choices = "channel|feature|concat",
       .help = "how the audio code enters at a position: channel: each of its numbers times a weight of its own, as "
               "in the paper; feature: all times one weight; concat: unchanged (default channel)"},
      {.name = "eye-attention",
       .kind = OPTION_CHOICE,
       .target = &job->eye_attention,
       .choices = "sigmoid|concat",
       .help =
           "how the eye value enters: sigmoid: times a weight, as in the paper; concat: unchanged (default sigmoid)"}};
  ARGS_FILL(options, rows, TRAIN_GOAL_OPTIONS);
}

void train_number_options(struct train_job *job, struct option options[TRAIN_NUMBER_OPTIONS]) {
  ern_train_config *config = &job->config;
  const struct option rows[] = {
      {.name = "rays",
       .alias = "num_rays",
       .kind = OPTION_INT,
       .target = &config->rays,
       .low = 1,
       .high = 1048576,
       .help = "rays a step (default 65536; with --time 512, but 2048 for a torso, with --backend opencl or under "
               "mpirun); a step of the fine stage has one patch at least, which may be more"},
      {.name = "lr",
       .kind = OPTION_FLOAT,
       .target = &config->lr,
       .low = 1e-9,
       .high = 10,
       .help = "learning rate of the hash grids"},
      {.name = "lr_net",
       .kind = OPTION_FLOAT,
       .target = &config->lr_net,
       .low = 1e-9,
       .high = 10,
       .help = "learning rate of the networks (default 0.001); the network that weighs the windows of speech "
               "(audio_att_net) has 5 times this"},
      {.name = "max_steps",
       .kind = OPTION_INT,
       .target = &config->max_steps,
       .low = 1,
       .high = 1024,
       .help = "samples a ray at most; kept in the model (default 16)"},
      {.name = "refresh-every",
       .alias = "update_extra_interval",
       .kind = OPTION_COUNT,
       .target = &job->refresh_every,
       .low = 0,
       .high = 1e12,
       .help = "steps between refreshes of the whole occupancy grid, as published 16; 0: every 16 to 128 steps, less "
               "often with fewer rays, and after step 256 only a part of it"},
      {.name = "precision",
       .kind = OPTION_CHOICE,
       .target = &job->precision,
       .choices = "fp32|bf16|auto",
       .help = "number format of the factors in a head's matrix products; auto: bf16 with --isa avx512bf16, else "
               "fp32 (default fp32, with --resume as before)"},
      {.name = "ray-sampling",
       .kind = OPTION_CHOICE,
       .target = &job->ray_sampling,
       .choices = "regions|uniform",
       .help =
           "which pixels the rays of a head go through: regions: 30 % the lower face (if the clip has landmarks), 10 % "
           "the eyes (if it also has au.csv; frames with shut eyes are sampled more often), 20 % the head and 10 % its "
           "edge (if it has parsing/), the others any pixel; uniform: all any pixel, as published (default regions)"},
      {.name = "frames-per-step",
       .kind = OPTION_INT,
       .target = &config->frames_per_step,
       .low = 1,
       .high = ERN_FRAMES_PER_STEP_MOST,
       .help = "number of frames that share the rays of a step, each with its own speech; a torso that follows with "
               "--time has 1 (default 1, as published; 4 with --time under mpirun or with --backend opencl)"},
      {.name = "prune-occupancy",
       .kind = OPTION_FLOAT,
       .target = &config->prune_share,
       .low = 0,
       .high = 1,
       .help = "at 85 % of a head's steps (of those before a fine stage) an occupancy cell is marked empty if in "
               "every ray its samples have less than X times the ray's largest compositing weight, so that a frame "
               "has fewer samples; 0: none (default 0, as published; 0.3 with --time)"},
      {.name = "step-parts",
       .kind = OPTION_INT,
       .target = &config->step_parts,
       .low = 1,
       .high = ERN_STEP_PARTS_MOST,
       .help =
           "parts that a step's rays are cut into, a power of 2 up to 64: with the same number the model is the same "
           "for any number of processes (mpirun) that divides it (default 1; under mpirun 4, or the number of "
           "processes if that is more)"},
      {.name = "refine-poses",
       .kind = OPTION_FLAG,
       .target = &config->refine_poses,
       .help = "a head also learns corrections of the poses of the training frames, which the model keeps; --resume "
               "continues with them (default with --time)"},
      {.name = "no-refine-poses",
       .kind = OPTION_OFF,
       .target = &config->refine_poses,
       .help = "the poses as the clip has them (default without --time)"},
      {.name = "ind_num",
       .kind = OPTION_INT,
       .target = &config->codes,
       .low = 0,
       .high = 1000000,
       .help = "number of individual codes, a learnt vector for each training frame; 0: no codes (default one a "
               "training frame)"},
      {.name = "dt_gamma",
       .kind = OPTION_FLOAT,
       .target = &config->dt_gamma,
       .low = 0,
       .high = 1,
       .help = "growth of the sample spacing along a ray with distance; kept in the model (default 1/256)"},
      {.name = "bound",
       .kind = OPTION_FLOAT,
       .target = &config->bound,
       .low = ERN_BOUND_LEAST,
       .high = ERN_BOUND_MOST,
       .help = "half of the side of the scene's cube"},
      {.name = "torso_shrink",
       .kind = OPTION_FLOAT,
       .target = &config->torso_shrink,
       .low = 0.001,
       .high = 1,
       .help = "factor of the torso's coordinates; kept in the model (default 0.8)"},
      {.name = "scale",
       .kind = OPTION_FLOAT,
       .target = &job->scale,
       .low = 0.001,
       .high = 1000,
       .help = "factor of the poses' translations; kept in the model (default 4)"},
      {.name = "data_range",
       .kind = OPTION_RANGE_PAIR,
       .target = &job->data,
       .choices = "A:B | A B",
       .help = "train on frames [A, B) of transforms_train.json alone; B -1: to the last"},
      {.name = "audio-pad",
       .kind = OPTION_CHOICE,
       .target = &job->audio_pad,
       .choices = "edge|zero",
       .help = "speech windows past the ends of the speech: edge repeats the nearest, zero has zeros, as published; "
               "kept in the model (default edge)"}};
  ARGS_FILL(options, rows,
            TRAIN_NUMBER_OPTIONS - SESSION_COMPUTE_OPTIONS - SESSION_SEED_OPTIONS - SESSION_OUTPUT_OPTIONS);
  struct option *common = options + sizeof rows / sizeof rows[0];
  session_compute_options(&job->session, common);
  session_seed_options(&job->session, common + SESSION_COMPUTE_OPTIONS);
  session_output_options(&job->session, common + SESSION_COMPUTE_OPTIONS + SESSION_SEED_OPTIONS);
}

void train_clip_options(struct train_job *job, struct option options[TRAIN_CLIP_OPTIONS]) {
  const struct option rows[] = {
      {.name = "audio",
       .alias = "aud",
       .kind = OPTION_TEXT,
       .target = &job->source.features,
       .help = "the clip's speech from another file: a sound, or speech features (.npy); instead of the clip's own"},
  };
  ARGS_FILL(options, rows, TRAIN_CLIP_OPTIONS - CLIP_SOURCE_OPTIONS - SPEECH_AUGMENTATION_OPTIONS);
  clip_source_options(&job->source, options + sizeof rows / sizeof *rows);
  speech_augmentation_options(&job->speech, options + sizeof rows / sizeof *rows + CLIP_SOURCE_OPTIONS);
}
