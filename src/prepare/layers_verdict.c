/* SPDX-License-Identifier: MIT
 * What the step "layers" says of its own work. The bounds are those of footage that was looked at. */
#include <stdlib.h>

#include "prepare/layers.h"

static int rising(const void *a, const void *b) {
  const float x = *(const float *)a, y = *(const float *)b;
  return (x > y) - (x < y);
}

static void judge_place(struct ern_prepare_job *job, const struct ern_person_found *found) {
  const double shift = found->shift * 512 / job->side;
  if (found->shifted >= 0.5 && shift > 1.5)
    ern_prepare_judge(job, shift > 12 ? ERN_PREPARE_REFUSED : ERN_PREPARE_DOUBTFUL,
                      "the camera moves: what is behind the person shifts by %.1f pixels of %d, expected a camera that "
                      "stands still (1.5 at most); footage from a tripod helps, or a stretch of it (--from, --to)",
                      found->shift, job->side);
  else if (found->unlike > 0.15)
    ern_prepare_judge(job, ERN_PREPARE_DOUBTFUL,
                      "the background changes: %.0f %% of it differs from frame to frame, expected 15 %% at most; "
                      "--masks helps, or a stretch where it stands still (--from, --to)",
                      100 * found->unlike);
  if (found->brought_difference > 40)
    ern_prepare_judge(job, ERN_PREPARE_DOUBTFUL,
                      "--background %s differs from what is seen beside the person by %.0f grey values, expected 40 at "
                      "most: a picture of the same place from the same camera",
                      job->options->background, found->brought_difference);
}

void ern_layers_judge(struct ern_prepare_job *job, const struct ern_person_found *found, double covered,
                      float *trembles, const size_t border[16]) {
  size_t all = 0;
  for (int i = 0; i < 16; i++) all += border[i];
  const double faint = all > 0 ? (double)(border[0] + border[1]) / (double)all : 1;
  qsort(trembles, job->frames, sizeof *trembles, rising);
  const double tremble = (double)trembles[job->frames * 9 / 10];
  ern_prepare_figure(job, "person_share", covered);
  ern_prepare_figure(job, "area_tremble", tremble);
  ern_prepare_figure(job, "background_never_seen", found->never_seen);
  ern_prepare_figure(job, "background_unlike", found->unlike);
  ern_prepare_figure(job, "background_shift", found->shift);
  ern_prepare_figure(job, "background_shift_told", found->shifted);
  ern_prepare_figure(job, "border_faint", faint);
  if (job->options->background != NULL) ern_prepare_figure(job, "background_difference", found->brought_difference);
  if (covered < 0.08 || covered > 0.92)
    ern_prepare_judge(job, covered < 0.02 || covered > 0.98 ? ERN_PREPARE_REFUSED : ERN_PREPARE_DOUBTFUL,
                      "the person takes %.0f %% of the picture, expected 8 to 92 %%; --masks or --background helps",
                      100 * covered);
  judge_place(job, found);
  if (tremble > 0.04)
    ern_prepare_judge(
        job, ERN_PREPARE_DOUBTFUL,
        "the person's outline trembles: its area changes by %.1f %% from frame to frame, expected 4 %% at "
        "most; --masks or --background helps, or --head-only where only the shoulders are wrong",
        100 * tremble);
  if (faint > 0.4)
    ern_prepare_judge(job, ERN_PREPARE_DOUBTFUL,
                      "%.0f %% of the person's outline has the colour of what is behind it, expected 40 %% at most; "
                      "--masks helps, or footage before another background",
                      100 * faint);
}
