/* SPDX-License-Identifier: MIT */
#include "public_options.h"

#include <stdbool.h>
#include <string.h>

/* Each line follows "--NAME ". */
#define NOT_NEEDED "is not needed here: "
#define TRAINING "is an option of `ernerf train`"
#define DRAWING "is an option of `ernerf render`"
#define LOSS "is not a choice here: the losses and their weights are fixed (docs/maths.md)"
#define FIXED "is not a choice here: it is the public code's default"
#define FINE "is `--stage fine` of `ernerf train` here: patches of the picture and of the lips in turn"
#define WINDOW \
  "belongs to the public program's window, which this one does not have: `ernerf render -o out.mp4` draws a video"
#define SPEECH "belongs to live speech, which `ernerf live` takes; --audio FILE takes a sound or its features (.npy)"

static const struct {
  const char *name, *answer;
} rows[] = {
    {"O",
     NOT_NEEDED "the fastest arithmetic is chosen, empty space is skipped, eyes are learnt where the clip has them"},
    {"path", NOT_NEEDED "the clip is an argument without an option, as in `ernerf train CLIP -o head.safetensors`"},
    {"test",
     NOT_NEEDED "`ernerf render MODEL --clip CLIP -o out.mp4` renders a model, `ernerf eval MODEL CLIP` evaluates it"},
    {"test_train", "is `--split train` of `ernerf render` and `ernerf eval` here"},
    {"workspace", "is `-o X.safetensors` of `ernerf train` here; state, log and pictures go to X.run beside it"},
    {"ckpt",
     "is `--resume` or `--from FILE` of `ernerf train` here; `ernerf render MODEL` and `ernerf eval MODEL` take the "
     "model without an option"},
    {"fp16", NOT_NEEDED "the arithmetic follows the instruction set (--isa)"},
    {"cuda_ray", NOT_NEEDED "empty space is always skipped"},
    {"num_steps", "belongs to rendering without skipping empty space; --max-steps bounds the samples of a ray"},
    {"upsample_steps", "belongs to rendering without skipping empty space; --max-steps bounds the samples of a ray"},
    {"max_ray_batch", NOT_NEEDED "rays are cut into tiles that fit the memory"},
    {"warmup_step", LOSS},
    {"amb_aud_loss", LOSS},
    {"amb_eye_loss", LOSS},
    {"unc_loss", LOSS},
    {"lambda_amb", LOSS},
    {"fbg",
     "(a background of its own for each frame) is not supported; --bg-img of `ernerf render` chooses one for all"},
    {"exp_eye",
     NOT_NEEDED "eyes are learnt where the clip has an au.csv that moves; `ernerf train --effects` says otherwise"},
    {"color_space", "is not a choice here: colours are those of the pictures (sRGB)"},
    {"preload", "is `--set memory=BYTES` here: the most that frames of the clip may take"},
    {"offset", FIXED " (0 0 0)"},
    {"min_near", FIXED " (0.05)"},
    {"density_thresh", FIXED " (10)"},
    {"density_thresh_torso", FIXED " (0.01)"},
    {"init_lips", FINE},
    {"finetune_lips", FINE},
    {"gui", WINDOW},
    {"radius", WINDOW},
    {"fovy", WINDOW},
    {"max_spp", WINDOW},
    {"W", "is `--size WxH` of `ernerf render` here"},
    {"H", "is `--size WxH` of `ernerf render` here"},
    {"att", FIXED " (2: attention over eight windows)"},
    {"emb", "(speech as class numbers) is not supported: features are vectors"},
    {"ind_dim", FIXED " (4)"},
    {"ind_dim_torso", FIXED " (8)"},
    {"amb_dim", FIXED " (2)"},
    {"part", "(every tenth frame) is not supported; --data-range A:B of `ernerf train` takes a range of frames"},
    {"part2", "is `--data-range 0:375` of `ernerf train` here"},
    {"train_camera", "is `--set refine-poses=yes` of `ernerf train` here; corrections of poses in a .pth are applied"},
    {"asr", SPEECH},
    {"asr_wav", SPEECH},
    {"asr_play", SPEECH},
    {"asr_save_feats", SPEECH},
    {"l", SPEECH},
    {"m", SPEECH},
    {"r", SPEECH},
    {"fps", "is an option of `ernerf render`: the rate of its video; speech features have 50 vectors a second"},
    /* options of other verbs: the public program has one option list for both */
    {"head_ckpt", TRAINING "; a model with a torso has its head in it"},
    {"iters", TRAINING},
    {"lr", TRAINING},
    {"lr_net", TRAINING},
    {"num_rays", TRAINING},
    {"patch_size", TRAINING},
    {"update_extra_interval", TRAINING},
    {"ind_num", TRAINING},
    {"bound", TRAINING "; the model says its own"},
    {"data_range", TRAINING "; --frames A:B chooses what is drawn"},
    {"seed", "is not taken: drawing takes no random numbers"},
    {"bg_img", DRAWING "; a training takes bc.jpg of the clip"},
    {"fix_eye", DRAWING},
    {"smooth_eye", DRAWING},
    {"smooth_lips", DRAWING " and `ernerf eval`"},
    {"smooth_path", DRAWING},
    {"smooth_path_window", DRAWING},
};

static char plain(char c) { return c == '-' ? '_' : c; }

static bool same(const char *name, size_t length, const char *row) {
  if (strlen(row) != length) return false;
  for (size_t i = 0; i < length; i++)
    if (plain(name[i]) != row[i]) return false;
  return true;
}

const char *public_option(const char *name, size_t length) {
  for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
    if (same(name, length, rows[i].name)) return rows[i].answer;
  return NULL;
}
