/* SPDX-License-Identifier: MIT
 * THE table of a training's settings: one row for each member of ern_train_config, in their order. Defaults, range
 * checks, what a state keeps, what a resume and what processes compare, the program's options and the Python module's
 * structure follow from it. */
#include "core/setting_table.h"
#include "core/sized.h"
#include "render/march_ops.h"
#include "train/patches_ops.h"
#include "train/trainer.h"

enum { CONFIG_COOKIE = 0x45524e34 };

static const double any_count = 18446744073709551616.0; /* 2^64 */

#define ROW(kind, type, member) ERN_SETTING_OF(ern_train_config, kind, type, member)
#define BOOL(member) ROW(ERN_SETTING_BOOL, bool, member), .most = 1
#define INT(member, low, high, value) \
  ROW(ERN_SETTING_INT, int, member), .least = (low), .most = (high), .fallback = (value)
#define COUNT(member, low, high, value) \
  ROW(ERN_SETTING_UINT64, uint64_t, member), .least = (low), .most = (high), .fallback = (value)
#define SIZE(member) ROW(ERN_SETTING_SIZE, size_t, member), .most = any_count
#define FLOAT(member, low, high, value) \
  ROW(ERN_SETTING_FLOAT, float, member), .least = (low), .most = (high), .fallback = (value)
#define DOUBLE(member, low, high, value) \
  ROW(ERN_SETTING_DOUBLE, double, member), .least = (low), .most = (high), .fallback = (value)
#define WORD(member, type, all, count, value) \
  ROW(ERN_SETTING_WORD, type, member), .words = (all), .most = (count)-1, .fallback = (value)
#define TEXT(member) ROW(ERN_SETTING_TEXT, const char *, member)
#define POINTER(member, type) ROW(ERN_SETTING_POINTER, type, member)

static const ern_setting table[] = {
    {BOOL(torso)},
    {TEXT(output)},
    {BOOL(resume)},
    {BOOL(overwrite)},
    {TEXT(from)},
    {POINTER(head, const ern_model *)},
    {COUNT(iters, 1, 1e12, 100000), .resume = ERN_RESUME_LOGGED, .help = "steps in all, also when resuming"},
    {INT(rays, 1, 1 << 20, 65536), .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "rays a step; a step of the fine stage has one patch at least, which may be more"},
    {WORD(backbone, ern_backbone, "trihash|hash3d|triplane|mlp", 4, ERN_BACKBONE_TRIHASH), .scope = ERN_SCOPE_HEAD,
     .help = "encoder of positions: trihash, as in the paper, or one of its ablation"},
    {WORD(attention, ern_attention, "channel|feature|concat", 3, ERN_ATTENTION_CHANNEL), .scope = ERN_SCOPE_HEAD,
     .help = "how the audio code enters at a position: channel: each of its numbers times a weight of its own, as in "
             "the paper; feature: all times one weight; concat: unchanged"},
    {WORD(eye_attention, ern_eye_attention, "sigmoid|concat", 2, ERN_EYE_ATTENTION_SIGMOID), .scope = ERN_SCOPE_HEAD,
     .help = "how the eye value enters: sigmoid: times a weight, as in the paper; concat: unchanged"},
    {INT(levels, 0, ERN_GRID_MAX_LEVELS, 0), .scope = ERN_SCOPE_HEAD,
     .help = "levels of the hash encoder, 2 to 24; 0: the backbone's own, trihash 14, hash3d 16"},
    {BOOL(no_view), .help = "the head's colour does not depend on the direction of view"},
    {COUNT(seed, 0, any_count, 0), .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "of all random numbers"},
    {INT(threads, 0, ERN_THREADS_MOST, 0), .help = "threads; 0: one a core"},
    {FLOAT(lr, 0, ERN_TRAIN_MOST_RATE, 1e-2), .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "learning rate of the hash grids"},
    {FLOAT(lr_net, 0, ERN_TRAIN_MOST_RATE, 1e-3), .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "learning rate of the networks"},
    {FLOAT(lr_att, 0, ERN_TRAIN_MOST_RATE, 5e-3), .scope = ERN_SCOPE_HEAD, .resume = ERN_RESUME_LOGGED,
     .same_everywhere = true, .help = "learning rate of the network that weighs the windows of speech (audio_att_net)"},
    {INT(codes, -1, 1e6, -1), .scope = ERN_SCOPE_HEAD,
     .help = "number of individual codes, a learnt vector for each training frame; 0: no codes; -1: one a frame"},
    {BOOL(torso_gamma), .scope = ERN_SCOPE_TORSO, .resume = ERN_RESUME_KEPT,
     .help = "train gamma, the factor of the torso's key points, as in the paper; no: it is 1"},
    {BOOL(torso_random_background), .fallback = true, .resume = ERN_RESUME_LOGGED, .scope = ERN_SCOPE_TORSO,
     .same_everywhere = true,
     .help = "a random colour for each ray behind the torso, so that it is opaque before any background; no: the "
             "clip's background, as published"},
    {INT(max_steps, 1, ERN_MAX_STEPS, 16), .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "samples a ray at most; kept in the model"},
    {FLOAT(dt_gamma, 0, 1, 1.0 / 256), .same_everywhere = true,
     .help = "growth of the sample spacing along a ray with distance; kept in the model"},
    {FLOAT(bound, ERN_BOUND_LEAST, ERN_BOUND_MOST, 1), .scope = ERN_SCOPE_HEAD, .same_everywhere = true,
     .help = "half of the side of the scene's cube"},
    {FLOAT(torso_shrink, ERN_LEAST_SHRINK, 1, 0.8), .scope = ERN_SCOPE_TORSO, .same_everywhere = true,
     .help = "factor of the torso's coordinates; kept in the model"},
    {WORD(audio_pad, ern_audio_pad, "edge|zero", 2, ERN_AUDIO_PAD_EDGE), .same_everywhere = true,
     .help = "speech windows past the ends of the speech: edge repeats the nearest, zero has zeros, as published; kept "
             "in the model"},
    {SIZE(data_begin), .resume = ERN_RESUME_SAME, .same_everywhere = true, .help = "first training frame to use"},
    {SIZE(data_end), .resume = ERN_RESUME_SAME, .same_everywhere = true,
     .help = "the frame after the last to use; 0: all"},
    {COUNT(save_every, 0, any_count, 1000), .help = "steps between saves; 0: only at the end"},
    {COUNT(validate_every, 0, any_count, 1000), .help = "steps between validations; 0: only at the end"},
    {INT(validate_frames, 0, 1e9, 16), .help = "maximum number of frames that a validation renders; 0: all"},
    {BOOL(force)},
    {BOOL(ema), .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "write the moving average of the weights as the model, once it has 10 updates"},
    {COUNT(ema_every, 1, 1e12, 1000), .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "steps between updates of that average"},
    {COUNT(refresh_every, 0, 1e12, 0), .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "steps between refreshes of the whole occupancy grid, as published 16; 0: every 16 to 128 steps, less "
             "often with fewer rays, and after step 256 only a part of it"},
    {WORD(precision, ern_precision, "default|fp32|bf16|auto", 4, ERN_PRECISION_DEFAULT), .resume = ERN_RESUME_LOGGED,
     .same_everywhere = true,
     .help = "number format of the factors in a head's matrix products; auto: bf16 with the instruction set "
             "avx512bf16, else fp32"},
    {WORD(ray_sampling, ern_ray_sampling, "uniform|regions|dub", 3, ERN_RAY_SAMPLING_REGIONS),
     .resume = ERN_RESUME_LOGGED, .scope = ERN_SCOPE_HEAD, .same_everywhere = true,
     .help = "which pixels the rays of a head go through: regions: 30 % the lower face (if the clip has landmarks), "
             "10 % the eyes (if it also has au.csv), 20 % the head and 10 % its edge (if it has parsing/), the others "
             "any pixel; uniform: all any pixel, as published; dub: as `--for dub` does"},
    {DOUBLE(seconds, 0, ERN_TRAIN_MOST_SECONDS, 0), .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "seconds of training in all; 0: as many as the steps take"},
    {BOOL(refine_poses), .scope = ERN_SCOPE_HEAD, .resume = ERN_RESUME_SAME, .same_everywhere = true,
     .help = "a head also learns corrections of the poses of the training frames, which the model keeps"},
    {TEXT(torso_output)},
    {INT(frames_per_step, 1, ERN_FRAMES_PER_STEP_MOST, 1), .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "number of frames that share the rays of a step, each with its own speech"},
    {COUNT(fine_steps, 0, any_count, 0), .scope = ERN_SCOPE_FINE,
     .help = "the last steps of all that are the fine stage"},
    {DOUBLE(fine_share, 0, 1, 0), .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "share of the time, at its end, that is the fine stage"},
    {INT(patch_size, ERN_PATCH_UNIT, ERN_PATCH_MOST_SIDE, 32), .resume = ERN_RESUME_LOGGED, .scope = ERN_SCOPE_FINE,
     .same_everywhere = true, .help = "pixels a side of the fine stage's patches, a multiple of 16"},
    {FLOAT(fine_weight, 0, 1e3, 0.1), .resume = ERN_RESUME_LOGGED, .scope = ERN_SCOPE_FINE, .same_everywhere = true,
     .help = "weight of the patches' loss, which is added to the others"},
    {FLOAT(fine_lips_weight, 0, 1e3, 0.1), .resume = ERN_RESUME_LOGGED, .scope = ERN_SCOPE_FINE,
     .same_everywhere = true, .help = "the same in patches of the lips"},
    {POINTER(fine_loss, const ern_fine_loss *)},
    {TEXT(consent)},
    {FLOAT(prune_share, 0, 1, 0), .scope = ERN_SCOPE_HEAD, .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "at 85 % of a head's steps (of those before a fine stage) an occupancy cell is marked empty if in every "
             "ray its samples have less than this share of the ray's largest compositing weight, so that a frame has "
             "fewer samples; 0: none, as published"},
    {INT(step_parts, 1, ERN_STEP_PARTS_MOST, 1), .resume = ERN_RESUME_LOGGED, .same_everywhere = true,
     .help = "parts that a step's rays are cut into, a power of 2: with the same number the model is the same for any "
             "number of processes (mpirun) that divides it"},
    {POINTER(communicator, const ern_communicator *)},
    {BOOL(head_random_background), .fallback = true, .resume = ERN_RESUME_LOGGED, .scope = ERN_SCOPE_HEAD,
     .same_everywhere = true,
     .help = "a random colour for each ray behind the head, if the clip has parsing/, so that the head keeps no pieces "
             "of the clip's background; no: the clip's torso picture and background, as published"},
};

const ern_setting *ern_train_setting(size_t index) {
  return index < sizeof table / sizeof *table ? &table[index] : NULL;
}

void ern_train_config_fill(ern_train_config *config, size_t bytes) {
  ern_train_config own = {.cookie = CONFIG_COOKIE};
  for (size_t i = 0; i < sizeof table / sizeof *table; i++) ern_setting_reset(&table[i], &own);
  ern_config_copy_out(config, bytes, &own, sizeof own);
}

ern_status ern_train_settings_check(ern_context *context, const ern_train_config *config) {
  ern_status status = ERN_OK;
  for (size_t i = 0; i < sizeof table / sizeof *table && status == ERN_OK; i++)
    status = ern_setting_check(context, "train", &table[i], config);
  return status;
}

const char *ern_ray_sampling_name(ern_ray_sampling sampling) {
  static const char *const names[] = {"uniform", "regions", "dub"};
  const int index = (int)sampling;
  return index >= 0 && index < (int)(sizeof names / sizeof *names) ? names[index] : NULL;
}
