/* SPDX-License-Identifier: MIT
 * THE table of a training's settings: one row for each member of ern_train_config, in their order. Defaults, range
 * checks, what a state keeps, what a resume and what processes compare, the program's options and the Python module's
 * structure follow from it. */
#define ERN_SETTINGS ern_train_config
#include "train/train_settings.h"

#include "core/setting_table.h"
#include "model/view_settings.h"
#include "render/march_ops.h"
#include "train/patches_ops.h"

static const ern_setting table[] = {
    {ERN_ROW_BOOL(torso), .group = "files"},
    {ERN_ROW_TEXT(output), .group = "files"},
    {ERN_ROW_BOOL(resume), .group = "files"},
    {ERN_ROW_BOOL(overwrite), .group = "files"},
    {ERN_ROW_TEXT(from), .group = "files"},
    {ERN_ROW_POINTER(head, const ern_model *), .group = "files"},
    {ERN_ROW_COUNT(iters, 1, 1e12, 100000), .group = "schedule", .resume = ERN_RESUME_LOGGED,
     .help = "steps in all, also when resuming"},
    {ERN_ROW_INT(rays, 1, 1 << 20, 65536), .group = "schedule", .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "rays a step; a step of the fine stage has one patch at least, which may be more"},
    {ERN_ROW_WORD(backbone, ern_backbone, "trihash|hash3d|triplane|mlp", 4, ERN_BACKBONE_TRIHASH), .group = "model",
     .scope = ERN_SCOPE_HEAD, .help = "encoder of positions: trihash, as in the paper, or one of its ablation"},
    {ERN_ROW_WORD(attention, ern_attention, "channel|feature|concat", 3, ERN_ATTENTION_CHANNEL), .group = "model",
     .scope = ERN_SCOPE_HEAD,
     .help = "how the audio code enters at a position: channel: each of its numbers times a weight of its own, as in "
             "the paper; feature: all times one weight; concat: unchanged"},
    {ERN_ROW_WORD(eye_attention, ern_eye_attention, "sigmoid|concat", 2, ERN_EYE_ATTENTION_SIGMOID), .group = "model",
     .scope = ERN_SCOPE_HEAD,
     .help = "how the eye value enters: sigmoid: times a weight, as in the paper; concat: unchanged"},
    {ERN_ROW_INT(levels, 0, ERN_GRID_MAX_LEVELS, 0), .group = "model", .scope = ERN_SCOPE_HEAD,
     .help = "levels of the hash encoder, 2 to 24; 0: the backbone's own, trihash 14, hash3d 16"},
    {ERN_ROW_BOOL(no_view), .group = "model", .help = "the head's colour does not depend on the direction of view"},
    {ERN_ROW_COUNT(seed, 0, ERN_ANY_COUNT, 0), .group = "schedule", .resume = ERN_RESUME_LOGGED,
     .same_everywhere = true, .help = "of all random numbers"},
    {ERN_ROW_INT(threads, 0, ERN_THREADS_MOST, 0), .group = "schedule", .help = "threads; 0: one a core"},
    {ERN_ROW_FLOAT(lr, 0, ERN_TRAIN_MOST_RATE, 1e-2), .group = "rates and averages", .resume = ERN_RESUME_LOGGED,
     .same_everywhere = true, .help = "learning rate of the hash grids"},
    {ERN_ROW_FLOAT(lr_net, 0, ERN_TRAIN_MOST_RATE, 1e-3), .group = "rates and averages", .resume = ERN_RESUME_LOGGED,
     .same_everywhere = true, .help = "learning rate of the networks"},
    {ERN_ROW_FLOAT(lr_att, 0, ERN_TRAIN_MOST_RATE, 5e-3), .group = "rates and averages", .scope = ERN_SCOPE_HEAD,
     .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "learning rate of the network that weighs the windows of speech (audio_att_net)"},
    {ERN_ROW_INT(codes, -1, 1e6, -1), .group = "model", .scope = ERN_SCOPE_HEAD,
     .help = "number of individual codes, a learnt vector for each training frame; 0: no codes; -1: one a frame"},
    {ERN_ROW_BOOL(torso_gamma), .group = "torso", .scope = ERN_SCOPE_TORSO, .resume = ERN_RESUME_KEPT,
     .help = "train gamma, the factor of the torso's key points, as in the paper; no: it is 1"},
    {ERN_ROW_BOOL(torso_random_background), .group = "torso", .fallback = true, .resume = ERN_RESUME_LOGGED,
     .scope = ERN_SCOPE_TORSO, .same_everywhere = true,
     .help = "a random colour for each ray behind the torso, so that it is opaque before any background; no: the "
             "clip's background, as published"},
    {ERN_ROW_INT(max_steps, 1, ERN_MAX_STEPS, 16), .group = "model", .resume = ERN_RESUME_LOGGED,
     .same_everywhere = true, .help = "samples a ray at most; kept in the model"},
    {ERN_ROW_FLOAT(dt_gamma, 0, 1, 1.0 / 256), .group = "model", .same_everywhere = true,
     .help = "growth of the sample spacing along a ray with distance; kept in the model"},
    {ERN_ROW_FLOAT(bound, ERN_BOUND_LEAST, ERN_BOUND_MOST, 1), .group = "model", .scope = ERN_SCOPE_HEAD,
     .same_everywhere = true, .help = "half of the side of the scene's cube"},
    {ERN_ROW_FLOAT(torso_shrink, ERN_LEAST_SHRINK, 1, 0.8), .group = "torso", .scope = ERN_SCOPE_TORSO,
     .same_everywhere = true, .help = "factor of the torso's coordinates; kept in the model"},
    {ERN_ROW_WORD(audio_pad, ern_audio_pad, "edge|zero", 2, ERN_AUDIO_PAD_EDGE), .group = "model",
     .same_everywhere = true,
     .help = "speech windows past the ends of the speech: edge repeats the nearest, zero has zeros, as published; kept "
             "in the model"},
    {ERN_ROW_SIZE(data_begin), .group = "clip", .resume = ERN_RESUME_SAME, .same_everywhere = true,
     .help = "first training frame to use"},
    {ERN_ROW_SIZE(data_end), .group = "clip", .resume = ERN_RESUME_SAME, .same_everywhere = true,
     .help = "the frame after the last to use; 0: all"},
    {ERN_ROW_COUNT(save_every, 0, ERN_ANY_COUNT, 1000), .group = "schedule",
     .help = "steps between saves; 0: only at the end"},
    {ERN_ROW_COUNT(validate_every, 0, ERN_ANY_COUNT, 1000), .group = "schedule",
     .help = "steps between validations; 0: only at the end"},
    {ERN_ROW_INT(validate_frames, 0, 1e9, 16), .group = "schedule",
     .help = "maximum number of frames that a validation renders; 0: all"},
    {ERN_ROW_BOOL(force), .group = "files"},
    {ERN_ROW_BOOL(ema), .group = "rates and averages", .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "write the moving average of the weights as the model, once it has 10 updates"},
    {ERN_ROW_COUNT(ema_every, 1, 1e12, 1000), .group = "rates and averages", .resume = ERN_RESUME_LOGGED,
     .same_everywhere = true, .help = "steps between updates of that average"},
    {ERN_ROW_COUNT(refresh_every, 0, 1e12, 0), .group = "rays and occupancy", .resume = ERN_RESUME_LOGGED,
     .same_everywhere = true,
     .help = "steps between refreshes of the whole occupancy grid, as published 16; 0: every 16 to 128 steps, less "
             "often with fewer rays, and after step 256 only a part of it"},
    {ERN_ROW_WORD(precision, ern_precision, "default|fp32|bf16|auto", 4, ERN_PRECISION_DEFAULT), .group = "schedule",
     .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "number format of the factors in a head's matrix products; auto: bf16 with the instruction set "
             "avx512bf16, else fp32"},
    {ERN_ROW_WORD(ray_sampling, ern_ray_sampling, "uniform|regions|dub", 3, ERN_RAY_SAMPLING_REGIONS),
     .group = "rays and occupancy", .resume = ERN_RESUME_LOGGED, .scope = ERN_SCOPE_HEAD, .same_everywhere = true,
     .help = "which pixels the rays of a head go through: regions: 30 % the lower face (if the clip has landmarks), "
             "10 % the eyes (if it also has au.csv), 20 % the head and 10 % its edge (if it has parsing/), the others "
             "any pixel; uniform: all any pixel, as published; dub: as `--for dub` does"},
    {ERN_ROW_DOUBLE(seconds, 0, ERN_TRAIN_MOST_SECONDS, 0), .group = "schedule", .resume = ERN_RESUME_LOGGED,
     .same_everywhere = true, .help = "seconds of training in all; 0: as many as the steps take"},
    {ERN_ROW_BOOL(refine_poses), .group = "clip", .scope = ERN_SCOPE_HEAD, .resume = ERN_RESUME_SAME,
     .same_everywhere = true,
     .help = "a head also learns corrections of the poses of the training frames, which the model keeps"},
    {ERN_ROW_TEXT(torso_output), .group = "files"},
    {ERN_ROW_INT(frames_per_step, 1, ERN_FRAMES_PER_STEP_MOST, 1), .group = "schedule", .resume = ERN_RESUME_LOGGED,
     .same_everywhere = true, .help = "number of frames that share the rays of a step, each with its own speech"},
    {ERN_ROW_COUNT(fine_steps, 0, ERN_ANY_COUNT, 0), .group = "fine stage", .scope = ERN_SCOPE_FINE,
     .help = "the last steps of all that are the fine stage"},
    {ERN_ROW_DOUBLE(fine_share, 0, 1, 0), .group = "fine stage", .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "share of the time, at its end, that is the fine stage"},
    {ERN_ROW_INT(patch_size, ERN_PATCH_UNIT, ERN_PATCH_MOST_SIDE, 32), .group = "fine stage",
     .resume = ERN_RESUME_LOGGED, .scope = ERN_SCOPE_FINE, .same_everywhere = true,
     .help = "pixels a side of the fine stage's patches, a multiple of 16"},
    {ERN_ROW_FLOAT(fine_weight, 0, 1e3, 0.1), .group = "fine stage", .resume = ERN_RESUME_LOGGED,
     .scope = ERN_SCOPE_FINE, .same_everywhere = true,
     .help = "weight of the patches' loss, which is added to the others"},
    {ERN_ROW_FLOAT(fine_lips_weight, 0, 1e3, 0.1), .group = "fine stage", .resume = ERN_RESUME_LOGGED,
     .scope = ERN_SCOPE_FINE, .same_everywhere = true, .help = "the same in patches of the lips"},
    {ERN_ROW_POINTER(fine_loss, const ern_fine_loss *), .group = "fine stage"},
    {ERN_ROW_TEXT(consent), .group = "files"},
    {ERN_ROW_FLOAT(prune_share, 0, 1, 0), .group = "rays and occupancy", .scope = ERN_SCOPE_HEAD,
     .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "at 85 % of a head's steps (of those before a fine stage) an occupancy cell is marked empty if in every "
             "ray its samples have less than this share of the ray's largest compositing weight, so that a frame has "
             "fewer samples; with parsing/ also one that is seen over twice as much beside the head as in it, so that "
             "nothing flies there; 0: none, as published"},
    {ERN_ROW_INT(step_parts, 1, ERN_STEP_PARTS_MOST, 1), .group = "schedule", .resume = ERN_RESUME_LOGGED,
     .same_everywhere = true,
     .help = "parts that a step's rays are cut into, a power of 2: with the same number the model is the same for any "
             "number of processes (mpirun) that divides it"},
    {ERN_ROW_POINTER(communicator, const ern_communicator *), .group = "schedule"},
    {ERN_ROW_BOOL(head_random_background), .group = "rays and occupancy", .fallback = true, .resume = ERN_RESUME_LOGGED,
     .scope = ERN_SCOPE_HEAD, .same_everywhere = true,
     .help = "a random colour for each ray behind the head, if the clip has parsing/, so that the head keeps no pieces "
             "of the clip's background; no: the clip's torso picture and background, as published"},
    {ERN_ROW_BOOL(torso_motion), .group = "torso", .fallback = true, .resume = ERN_RESUME_KEPT,
     .scope = ERN_SCOPE_TORSO, .same_everywhere = true,
     .help =
         "a torso moves with the body's motion, if the clip has torso.npy; no: as published. A resumed torso goes on "
         "as it began"},
    {ERN_ROW_BOOL(voice_fade), .group = "model", .fallback = true, .resume = ERN_RESUME_KEPT, .scope = ERN_SCOPE_HEAD,
     .same_everywhere = true,
     .help = "the voice moves nothing of a head above the nose, if the clip has landmarks; not with --for dub, where "
             "nothing above the nose is seen; no: as published. A resumed head goes on as it began; kept in the model"},
};

ERN_SETTINGS_FUNCTIONS(train, ern_train_config, 0x45524e34)

const char *ern_ray_sampling_name(ern_ray_sampling sampling) {
  static const char *const names[] = {"uniform", "regions", "dub"};
  const int index = (int)sampling;
  return index >= 0 && index < (int)(sizeof names / sizeof *names) ? names[index] : NULL;
}
