/* SPDX-License-Identifier: MIT
 * What PSNR does not tell, over the frames of a clip: whether the mouth follows, how sharp it is, the seam at the neck.
 */
#ifndef ERN_CLI_MEASURES_H
#define ERN_CLI_MEASURES_H

#include <jansson.h>

#include "evaluation/mouth_motion.h"
#include "evaluation/picture_measures.h"
#include "evaluation/tremble.h"

/* Over several frames. Zeroed: none yet. */
struct measures {
  struct mouth_motion mouth;
  double head_truth, head_rendered, mouth_truth, mouth_rendered; /* gradient energies of the regions */
  double neck;                                                   /* sum of squared differences of grey in the band */
  size_t neck_pixels;
  double eyes[2]; /* sums of PSNR in dB of the eyes: open, and shut: an eye value of 0.5 or more */
  size_t eye_frames[2];
  struct tremble tremble;
  ern_context *flow; /* computes the optical flow for `tremble`; NULL: it is not wanted, or cannot be had */
};

/* Values of the frames; NaN where the clip does not tell. */
struct measures_figures {
  struct mouth_figures mouth;
  double sharpness_head, sharpness_mouth; /* gradient energy over the recorded frame's */
  double eyes[2];                         /* mean PSNR in dB of the eyes, open and shut */
  size_t eye_frames[2];                   /* that these are of */
  double seam;                            /* root mean square of the band's differences, of 255 */
  double tremble;                         /* unevenness of the face's motion over the recorded frame's */
};

/* Adds a frame. Without optical flow, which is no reason to stop, `flow` becomes NULL. truth 0..255, rendered 0..1:
 * [height][width][3]. False without memory. */
bool measures_add(struct measures *measures, const ern_clip_frame *frame, int width, int height, const uint8_t *truth,
                  const float *rendered);
struct measures_figures measures_figures(const struct measures *measures);
/* To standard output, a line each; what is not known is left out, or said of the mouth. */
void measures_print(const struct measures_figures *figures);
/* Null where the clip does not tell. */
json_t *measures_json(const struct measures_figures *figures);
void measures_free(struct measures *measures);

#endif
