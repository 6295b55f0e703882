/* SPDX-License-Identifier: MIT
 * Measures that complement PSNR, over the frames of a clip: motion of the mouth, sharpness, the seam at the neck. */
#ifndef ERN_CLI_MEASURES_H
#define ERN_CLI_MEASURES_H

#include <jansson.h>

#include "evaluation/mouth_motion.h"
#include "evaluation/picture_measures.h"
#include "evaluation/tremble.h"

/* Sums over several frames. Zeroed: no frame yet. */
struct measures {
  struct mouth_motion mouth;
  double head_truth, head_rendered, mouth_truth, mouth_rendered; /* gradient energies of the regions */
  double neck;                                                   /* sum of squared differences of grey in the band */
  size_t neck_pixels;
  double eyes[2]; /* sums of PSNR in dB of the eyes: [0] open, [1] shut (eye value >= 0.5) */
  size_t eye_frames[2];
  struct tremble tremble;
  ern_context *flow; /* computes the optical flow for `tremble`; NULL: not requested, or not available */
};

/* Results over the frames; NaN: not known for this clip. */
struct measures_figures {
  struct mouth_figures mouth;
  double sharpness_head, sharpness_mouth; /* gradient energy over the recorded frame's */
  double eyes[2];                         /* mean PSNR in dB of the eyes, open and shut */
  size_t eye_frames[2];                   /* number of frames in each mean */
  double seam;                            /* root mean square of the band's differences, of 255 */
  double tremble;                         /* unevenness of the face's motion over the recorded frame's */
};

/* Adds a frame. If optical flow is not available, `flow` becomes NULL and the work continues. truth 0..255, rendered
 * 0..1: [height][width][3]. False without memory. */
bool measures_add(struct measures *measures, const ern_clip_frame *frame, int width, int height, const uint8_t *truth,
                  const float *rendered);
struct measures_figures measures_figures(const struct measures *measures);
/* Prints one line for each figure to standard output. Unknown figures are omitted; for the mouth a line says so. */
void measures_print(const struct measures_figures *figures);
/* null for figures that are not known. */
json_t *measures_json(const struct measures_figures *figures);
void measures_free(struct measures *measures);

#endif
