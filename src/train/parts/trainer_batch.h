/* SPDX-License-Identifier: MIT
 * Training data of a step. Internal. */
#ifndef ERN_TRAIN_TRAINER_BATCH_H
#define ERN_TRAIN_TRAINER_BATCH_H

#include "train/parts/trainer_poses.h"
#include "train/parts/trainer_speech.h"

/* Shares of a head's rays that are drawn in each region, and of its frames that are drawn among those with shut eyes,
 * found by experiment (docs/results.md). */
#define ERN_LOWER_FACE_SHARE 0.3f
#define ERN_EYES_SHARE 0.1f
#define ERN_SILHOUETTE_SHARE 0.1f
#define ERN_HEAD_SHARE 0.2f
#define ERN_DUB_LOWER_FACE_SHARE 0.4f /* of ERN_RAY_SAMPLING_DUB */
#define ERN_DUBBED_SHARE 0.55f
#define ERN_BLINK_SHARE 0.1f

/* Training data of a step, or of a part of it: a frame and some of its rays, on the backend (scratch). */
struct ern_batch {
  size_t frame, rays, patches; /* patches 0: single rays, no patches */
  size_t of_step;              /* the frame's number among those of the step */
  float eye;
  ern_span pixel_number, jitter, face, windows;
  ern_rows truth, background;
  ern_span rigid;                    /* real [rays]: 0 in the lower face, which moves relative to the head, else 1 */
  double dpose[ERN_POSE_PARAMETERS]; /* after the step, where ern_trainer_poses_due */
};

struct ern_trainer_batches {
  const struct ern_training *training;
  const struct ern_trainer_fine *fine;
  const struct ern_trainer_speech *speech;
  const struct ern_trainer_poses *poses; /* NULL: poses are not refined */
  size_t *blinks, blink_count;           /* training frames with shut eyes; none: all frames are drawn alike */
  int32_t *host_pixels;                  /* [rays] */
  float *host_rows;                      /* [9][ern_scratch_stride(rays)]: truth, background, face, jitter, rigid */
  struct {
    struct ern_batch batch;
    uint64_t step; /* 0: none */
    bool uploaded; /* the batch's spans are those of pixels[place] and reals[place] */
    int place;
    struct ern_buffer *pixels[2], *reals[2]; /* of two steps in turn; NULL: not needed yet */
  } drawn;                                   /* the batch that host_pixels and host_rows already hold */
};

/* Needs ern_trainer_batches_free also after an error. */
ERN_NODISCARD ern_status ern_trainer_batches_make(struct ern_trainer_batches *batches,
                                                  const struct ern_trainer_fine *fine,
                                                  const struct ern_trainer_speech *speech,
                                                  const struct ern_trainer_poses *poses);
void ern_trainer_batches_free(struct ern_trainer_batches *batches, struct ern_backend *backend);
/* Batch k of ern_trainer_step_batches. */
ERN_NODISCARD ern_status ern_trainer_batch(struct ern_trainer_batches *batches, size_t k, struct ern_batch *batch);
/* Draws the batch of the step after this one on the host and uploads it, for a backend that is still computing this one
 * (ern_head_step_args.meanwhile). Does nothing for a step of several batches or of patches. batches: struct
 * ern_trainer_batches */
void ern_trainer_draw_ahead(void *batches);
/* Frame k of ern_trainer_step_frames. */
size_t ern_trainer_step_frame(const struct ern_trainer_batches *batches, size_t k);

#endif
