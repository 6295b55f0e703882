/* SPDX-License-Identifier: MIT
 * What X.run shows of a training's validations: the curve of PSNR, a table of measures, a picture each. */
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
  struct measures now;   /* of the validation that is under way */
  struct bytes table;    /* measures.csv so far */
  bool no_table;         /* a file of that name is somebody's */
  bool plotted, tabled;  /* curve plots, the table were written */
  struct bytes pictures; /* names of those that were, each with its 0 */
  double psnr;           /* dB, of the newest one, over that many frames */
  size_t frames;
};

/* What a training that goes on has of earlier validations is read from X.run. What cannot be read, as what cannot be
 * drawn, is told of: it is no reason to stop a training. */
void validations_begin(struct validations *v, struct session *session, const ern_trainer *trainer, const ern_clip *clip,
                       const char *title, bool resume);
/* As the hooks of ern_train_hooks have it. */
ern_status validations_frame(struct validations *v, int split, size_t frame, const float *rgb, const uint8_t *truth);
ern_status validations_end(struct validations *v, uint64_t step, double psnr, size_t frames, const uint8_t *picture,
                           int width, int height, const char *name);
/* After a training that failed: removes what it wrote here where X.run has no state, so that the same training can be
 * begun again. */
void validations_take_back(struct validations *v);
void validations_free(struct validations *v);

#endif
