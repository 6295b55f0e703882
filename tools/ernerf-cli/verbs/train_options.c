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
      {.name = "torso",
       .kind = OPTION_FLAG,
       .target = &config->torso,
       .help = "train the torso under the head of --head"},
      {.name = "head",
       .alias = "head_ckpt",
       .kind = OPTION_TEXT,
       .target = &job->head_path,
       .choices = "MODEL",
       .help = "the head that the torso is trained under; it does not change"},
      {.name = "force",
       .kind = OPTION_FLAG,
       .target = &config->force,
       .help = "take a head of another clip all the same"},
      {.name = "torso-gamma",
       .kind = OPTION_FLAG,
       .target = &config->torso_gamma,
       .help = "the paper's trained scale of the torso's key points"},
      {.name = "head-background",
       .kind = OPTION_CHOICE,
       .target = &job->head_background,
       .choices = "random|clip",
       .help = "what the head is learnt over, where the clip has parsing: a random colour for each ray, so that it has "
               "no pieces of the clip's background, or that background as published (default random)"},
      {.name = "torso-background",
       .kind = OPTION_CHOICE,
       .target = &job->torso_background,
       .choices = "random|clip",
       .help = "what the torso is learnt over: a random colour for each ray, so that it can be drawn over any "
               "background, or the clip's background as published (default random)"},
      {.name = "consent",
       .kind = OPTION_TEXT,
       .target = &job->consent,
       .choices = "TEXT|FILE",
       .help = "what the person has agreed to, or a file that says it: the model keeps it, and its videos and pictures "
               "carry it (default: as the model says that the training goes on from)"},
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
       .help = "train for so long, such as 10m, instead of --iters: a head, as X.head.safetensors, and the torso under "
               "it, where the clip has one; with --resume in all"},
      {.name = "paper",
       .kind = OPTION_FLAG,
       .target = &job->paper,
       .help =
           "the published schedule, where no option says otherwise: 100000 steps of 65536 rays anywhere alike, "
           "--refresh-every 16, --head-background clip, --torso-background clip, no data augmentation of the speech"},
      {.name = "resume",
       .kind = OPTION_FLAG,
       .target = &config->resume,
       .help = "go on from the newest good state in X.run, as it was trained where no option says otherwise"},
      {.name = "from",
       .kind = OPTION_TEXT,
       .target = &config->from,
       .choices = "FILE",
       .help =
           "start from the weights of a .safetensors or .pth file, from its levels, codes (what a longer clip needs "
           "more is fresh) and kinds, and where it holds a state from its step"},
      {.name = "save-every",
       .kind = OPTION_COUNT,
       .target = &job->save_every,
       .low = 0,
       .high = 1e12,
       .help = "steps between saves; 0 only at the end"},
      {.name = "validate-every",
       .kind = OPTION_COUNT,
       .target = &job->validate_every,
       .low = 0,
       .high = 1e12,
       .help = "steps between validations, each with a picture and a point of the curve; 0 only at the end (default a "
               "tenth of --iters, 50 to 1000)"},
      {.name = "validate-frames",
       .kind = OPTION_INT,
       .target = &config->validate_frames,
       .low = 0,
       .high = 1000000,
       .help = "most frames that a validation draws; 0 all"},
      {.name = "ema",
       .kind = OPTION_FLAG,
       .target = &config->ema,
       .help = "write the moving average of the weights as the model, from its 10th update on; with --resume at the "
               "last step it only writes (default with --time)"},
      {.name = "no-ema",
       .kind = OPTION_OFF,
       .target = &config->ema,
       .help = "the weights as they are (default without --time)"},
      {.name = "ema-every",
       .kind = OPTION_COUNT,
       .target = &job->ema_every,
       .low = 1,
       .high = 1e12,
       .help = "steps between its updates, of which it needs 10; 40 with --time"},
      {.name = "effects",
       .kind = OPTION_TEXT,
       .target = &job->effects_list,
       .choices = "auto|none|LIST",
       .help = "what the head models, of eye,codes,view,torso (the torso as a layer of its own behind it); auto: what "
               "`ernerf check` finds in the clip"},
      {.name = "levels",
       .kind = OPTION_INT,
       .target = &config->levels,
       .low = 2,
       .high = 24,
       .help = "of the hash encoder (default trihash 14, hash3d 16); public checkpoints have 12"},
      {.name = "backbone",
       .kind = OPTION_CHOICE,
       .target = &job->backbone,
       .choices = "trihash|hash3d|triplane|mlp",
       .help = "what encodes a position: the paper's planes, or what its ablation has in their place"},
      {.name = "attention",
       .kind = OPTION_CHOICE,
       .target = &job->attention,
       .choices = "channel|feature|concat",
       .help = "how the audio code enters at a position: each number times a weight of its own, all times one weight, "
               "or as it is"},
      {.name = "eye-attention",
       .kind = OPTION_CHOICE,
       .target = &job->eye_attention,
       .choices = "sigmoid|concat",
       .help = "how the eye value does: weighed, or as it is"}};
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
       .help = "a step; with --time 512, but 2048 of a torso, with --backend opencl or under mpirun; a patch of the "
               "fine stage may have more"},
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
       .help = "learning rate of the networks; the one over speech windows learns at 5 times this"},
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
       .help =
           "steps between refreshes of the whole occupancy grid, as published 16; 0: by the number of rays, in parts"},
      {.name = "precision",
       .kind = OPTION_CHOICE,
       .target = &job->precision,
       .choices = "fp32|bf16|auto",
       .help = "of a head's products; auto: bf16 with --isa avx512bf16 (default fp32, with --resume as before)"},
      {.name = "ray-sampling",
       .kind = OPTION_CHOICE,
       .target = &job->ray_sampling,
       .choices = "regions|uniform",
       .help =
           "where the rays of a head go: where the clip has landmarks 30 of 100 through the lower face, 10 "
           "through the eyes, whose blinks are shown more often, and where it has parsing/ 20 through the head and 10 "
           "along its edge; or anywhere alike as published (default regions)"},
      {.name = "frames-per-step",
       .kind = OPTION_INT,
       .target = &config->frames_per_step,
       .low = 1,
       .high = ERN_FRAMES_PER_STEP_MOST,
       .help = "frames that a step's rays are divided among, each with its own speech; with --time of the "
               "head (default 1 as published; 4 with --time where --rays is 2048 by default)"},
      {.name = "prune-occupancy",
       .kind = OPTION_FLOAT,
       .target = &config->prune_share,
       .low = 0,
       .high = 1,
       .help = "at 85 % of a head's steps, space whose samples have less than this share of the largest weight in each "
               "ray becomes empty, so that a frame has fewer samples; 0: none (default 0 as published; 0.3 with "
               "--time)"},
      {.name = "step-parts",
       .kind = OPTION_INT,
       .target = &config->step_parts,
       .low = 1,
       .high = ERN_STEP_PARTS_MOST,
       .help =
           "parts that a step's rays are cut into, a power of 2: with the same number the model is the same for any "
           "number of processes under mpirun, which divides it (default 1; under mpirun 4, or the processes)"},
      {.name = "refine-poses",
       .kind = OPTION_FLAG,
       .target = &config->refine_poses,
       .help =
           "a head learns corrections to the poses of the training frames too, which the model keeps; --resume goes "
           "on so (default with --time)"},
      {.name = "no-refine-poses",
       .kind = OPTION_OFF,
       .target = &config->refine_poses,
       .help = "the poses as the clip has them (default without --time)"},
      {.name = "ind_num",
       .kind = OPTION_INT,
       .target = &config->codes,
       .low = 0,
       .high = 1000000,
       .help = "rows of the individual codes; 0: no codes (default one a training frame)"},
      {.name = "dt_gamma",
       .kind = OPTION_FLOAT,
       .target = &config->dt_gamma,
       .low = 0,
       .high = 1,
       .help = "growth of the step with distance; kept in the model (default 1/256)"},
      {.name = "bound",
       .kind = OPTION_FLOAT,
       .target = &config->bound,
       .low = ERN_BOUND_LEAST,
       .high = ERN_BOUND_MOST,
       .help = "half side of the scene"},
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
       .help = "factor of the camera's place; kept in the model (default 4)"},
      {.name = "data_range",
       .kind = OPTION_RANGE_PAIR,
       .target = &job->data,
       .choices = "A:B | A B",
       .help = "train on frames [A, B) of transforms_train.json alone; B -1: to the last"},
      {.name = "audio-pad",
       .kind = OPTION_CHOICE,
       .target = &job->audio_pad,
       .choices = "edge|zero",
       .help = "past the ends of the speech: its nearest window, or zeros as the public code; kept in the model "
               "(default edge)"}};
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
       .help = "the clip's speech as another sound, or its features (.npy), instead of the clip's own"},
  };
  ARGS_FILL(options, rows, TRAIN_CLIP_OPTIONS - CLIP_SOURCE_OPTIONS - SPEECH_AUGMENTATION_OPTIONS);
  clip_source_options(&job->source, options + sizeof rows / sizeof *rows);
  speech_augmentation_options(&job->speech, options + sizeof rows / sizeof *rows + CLIP_SOURCE_OPTIONS);
}
