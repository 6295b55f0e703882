/* SPDX-License-Identifier: MIT
 * Files that X.run holds about a training's validations: the PSNR curve, a table of measures, and one picture for each
 * validation. */
#ifndef ERN_CLI_VALIDATIONS_H
#define ERN_CLI_VALIDATIONS_H

#include "bytes.h"
#include "ernerf/train.h"
#include "evaluation/measures.h"
#include "output/curve.h"
#include "session/session.h"

struct validations {
  struct session *session;
  const ern_trainer *trainer;
  const ern_clip *clip; /* whose frames are validated */
  const char *title;    /* of the plots */
  struct curve curve;
  struct measures now;   /* of the current validation */
  struct bytes table;    /* measures.csv so far */
  bool no_table;         /* measures.csv exists and was not written by this program: it is left alone */
  bool plotted, tabled;  /* whether the curve plots, and the table, were written */
  struct bytes pictures; /* names of the pictures that were written, each with its terminating 0 */
  double psnr;           /* dB, of the newest validation, the mean of `frames` frames */
  size_t frames;
};

/* A resumed training reads its earlier validations from X.run. Files that cannot be read, and plots that cannot be
 * drawn, cause a warning: they do not stop a training. */
void validations_begin(struct validations *v, struct session *session, const ern_trainer *trainer, const ern_clip *clip,
                       const char *title, bool resume);
/* These have the arguments of the hooks of ern_train_hooks. */
ern_status validations_frame(struct validations *v, int split, size_t frame, const float *rgb, const uint8_t *truth);
ern_status validations_end(struct validations *v, uint64_t step, double psnr, size_t frames, const uint8_t *picture,
                           int width, int height, const char *name);
/* Says where the mouth of frames that are not trained on has got worse, by more than other seeds do. */
void validations_say_mouth(const struct validations *v);
/* After a failed training: if X.run holds no state, removes the files that this training wrote there, so that the same
 * command can start again. */
void validations_take_back(struct validations *v);
void validations_free(struct validations *v);

#endif
