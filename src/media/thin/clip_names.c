/* SPDX-License-Identifier: MIT
 * The names of the files and folders that make a clip. */
#include "media/clip/clip.h"

static const char *const contents[] = {[ERN_PART_TRUTH] = "gt_imgs",
                                       [ERN_PART_TORSO] = "torso_imgs",
                                       [ERN_PART_LANDMARKS] = "ori_imgs",
                                       [ERN_PART_PARSING] = "parsing",
                                       [ERN_CLIP_TRAIN] = "transforms_train.json",
                                       [ERN_CLIP_VAL] = "transforms_val.json",
                                       [ERN_CLIP_BACKGROUND] = "bc.jpg",
                                       [ERN_CLIP_SOUND] = "aud.wav",
                                       [ERN_CLIP_BLINKS] = "au.csv",
                                       [ERN_CLIP_RECORD] = "prepare.json",
                                       [ERN_CLIP_DEEPSPEECH] = "aud_ds.npy",
                                       [ERN_CLIP_ESPERANTO] = "aud_eo.npy",
                                       [ERN_CLIP_HUBERT] = "aud_hu.npy",
                                       [ERN_CLIP_FEATURES] = "aud.npy",
                                       [ERN_CLIP_CEPSTRA] = "aud_cep.npy",
                                       [ERN_CLIP_ARTICULATORY] = "aud_art.npy",
                                       [ERN_CLIP_MOTION] = "torso.npy"};

const char *ern_clip_content(size_t index) {
  return index < sizeof contents / sizeof *contents ? contents[index] : NULL;
}
