/* SPDX-License-Identifier: MIT
 * A trainer in memory: data, model, its values on a backend, and the folder it writes to. Internal. */
#ifndef ERN_TRAIN_TRAINER_H
#define ERN_TRAIN_TRAINER_H

#include "train/losses_ops.h"
#include "train/parts/trainer_data.h"
#include "train/parts/trainer_processes.h"
#include "train/parts/trainer_prune.h"
#include "train/parts/trainer_values.h"

/* Shares of a head's rays that are drawn in each region, and of its frames that are drawn among those with shut eyes,
 * found by experiment (docs/results.md). */
#define ERN_LOWER_FACE_SHARE 0.3f
#define ERN_EYES_SHARE 0.1f
#define ERN_SILHOUETTE_SHARE 0.1f
#define ERN_HEAD_SHARE 0.2f
#define ERN_DUB_LOWER_FACE_SHARE 0.4f /* of ERN_RAY_SAMPLING_DUB */
#define ERN_DUBBED_SHARE 0.55f
#define ERN_BLINK_SHARE 0.1f

enum { ERN_SMOOTH_EVERY = 16 /* steps between smoothness terms */ };

#define ERN_TRAIN_MOST_RATE 1e3
#define ERN_TRAIN_MOST_SECONDS 1e9

/* Lines of a text file that are kept until the next save. */
struct ern_lines {
  char *text;
  size_t used, capacity;
};

/* The run folder X.run: its lock, and the paths in it. All NULL without an output. */
struct ern_run_folder {
  char *folder, *state, *next, *previous, *good, *log, *curve;
  int lock;        /* descriptor, -1: none */
  bool made;       /* the folder was not there before */
  bool keep;       /* until the first save: a file at X is not replaced */
  bool damaged;    /* the state is corrupt: the next save replaces it, not the intact previous one */
  bool fresh;      /* this training has written nothing yet: files in the folder are an earlier one's */
  bool unmeasured; /* resumed at a step that the curve lacks: its validation may have been stopped */
  struct ern_lines log_lines, curve_lines;
};

/* Results of a step besides its gradient: means over its rays. A plain array of doubles for the communicator. */
struct ern_step_sum {
  double terms[ERN_LOSS_TERMS]; /* each frame's are means over its own rays */
  double squared_error, samples;
  double dpose[ERN_FRAMES_PER_STEP_MOST][ERN_POSE_PARAMETERS]; /* by frame of the step */
  double seconds, beside;                                      /* before the step, by the clock of rank 0 */
};

/* Sums of parts of a step, on the host: [levels] of a binary tree, each waiting for its sibling. */
struct ern_trainer_parts {
  size_t begin, count; /* the values that this training changes are [begin, begin + count) of all */
  float *values;       /* [levels][count] */
  struct ern_step_sum *sums;
};

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

struct ern_trainer {
  struct ern_training shared;
  char *output;

  struct ern_trainer_values values;
  struct ern_trainer_occupancy occupancy;
  size_t *blinks, blink_count;     /* training frames with shut eyes; none: all frames are drawn alike */
  struct ern_trainer_poses *poses; /* NULL: poses are not refined */
  struct ern_trainer_fine fine;
  struct ern_run_folder run;
  uint64_t saved; /* step of this training's newest state in the run folder; 0: none */
  bool diverged;  /* since the last save, and the folder has a state from before */

  struct ern_run_folder torso_run; /* of config.torso_output: only locked */

  struct ern_trainer_speech speech;
  struct ern_trainer_parts parts; /* all NULL where a step is one part */

  int32_t *host_pixels; /* [rays] */
  float *host_rows;     /* [9][ern_scratch_stride(rays)]: truth, background, face, jitter, rigid */
  struct {
    struct ern_batch batch;
    uint64_t step; /* 0: none */
    bool uploaded; /* the batch's spans are those of pixels[place] and reals[place] */
    int place;
    struct ern_buffer *pixels[2], *reals[2]; /* of two steps in turn; NULL: not needed yet */
  } drawn;                                   /* the batch that host_pixels and host_rows already hold */
};

/* trainer_make.c */
/* Sets t->shared.bf16, whether products are in bf16. `path`: the origin of the request, for messages. */
ERN_NODISCARD ern_status ern_trainer_choose_precision(ern_trainer *t, const char *path, ern_precision wanted);
/* Whether the model is known to be of another clip. */
bool ern_trainer_is_foreign(const ern_trainer *t, const ern_model *model);
/* Copies the consent text of a model that is not of another clip, where the configuration gives none. */
void ern_trainer_keep_consent(ern_trainer *t, const ern_model *from);
/* Copies the rows of the torso or those of the head, with the other data that belongs to either; of individual codes as
 * many as both have. Other rows have the same shape in both. */
void ern_trainer_copy_rows(ern_model *to, const ern_model *from, bool torso);
/* Copies the camera refinement into a model without one. */
ERN_NODISCARD ern_status ern_trainer_copy_camera(ern_model *to, const ern_model *from);
/* Logs that a file has another number of individual codes than this training, where it has. */
void ern_trainer_log_codes(const ern_trainer *t, const char *path, int found);

/* train_settings.c: the ranges of all numbers and words. */
ERN_NODISCARD ern_status ern_train_settings_check(ern_context *context, const ern_train_config *config);

/* trainer.c: with config.seconds, sets config.iters to the steps that fit into the time at the pace so far; where the
 * time is over, to the steps already made; at least `least`. */
void ern_trainer_follow_time(ern_trainer *t, uint64_t least);

/* trainer.c: forward and backward of a batch, added to gradient and sum. */
ERN_NODISCARD ern_status ern_trainer_batch_step(ern_trainer *t, struct ern_batch *batch, struct ern_step_sum *sum);

/* trainer_parts.c (docs/scaling.md, "Parts of a step") */
ERN_NODISCARD ern_status ern_trainer_parts_check(ern_context *context, const ern_train_config *config);
ERN_NODISCARD ern_status ern_trainer_parts_make(ern_trainer *t);
void ern_trainer_parts_free(ern_trainer *t);
/* Gradient and sum of a step from this process's batches and those of the others. */
ERN_NODISCARD ern_status ern_trainer_parts_step(ern_trainer *t, struct ern_batch *batches, struct ern_step_sum *sum);

/* trainer_distributed.c */
/* Copies the state of rank 0 to all processes, after checking that they have the same settings and data. Waits for
 * all. */
ERN_NODISCARD ern_status ern_trainer_share_state(ern_trainer *t);
/* trainer_batch.c */
/* Batch k of ern_trainer_step_batches. */
ERN_NODISCARD ern_status ern_trainer_batch(ern_trainer *t, size_t k, struct ern_batch *batch);
/* Draws the batch of the step after this one on the host and uploads it, for a backend that is still computing this one
 * (ern_head_step_args.meanwhile). Does nothing for a step of several batches or of patches. */
void ern_trainer_draw_ahead(void *trainer);
/* Frame k of ern_trainer_step_frames. */
size_t ern_trainer_step_frame(const ern_trainer *t, size_t k);
/* trainer_state.c */
ERN_NODISCARD ern_status ern_trainer_download(ern_trainer *t,
                                              ern_span from); /* values and occupancy into t->shared.model */
ERN_NODISCARD ern_status ern_trainer_resume(ern_trainer *t, bool *resumed);
ERN_NODISCARD ern_status ern_trainer_take_file(ern_trainer *t, const char *path); /* --from */

/* ERN_E_IO where X.run/lock is not the file that this training locked. The folder was then moved and made again, or the
 * program has changed its working directory: the files there are another training's. */
ERN_NODISCARD ern_status ern_run_folder_check_held(ern_context *context, const struct ern_run_folder *run);

/* ERN_E_ARGUMENT where `path`, a file that a training starts from, is one that its saves would replace. path NULL:
 * none. */
ERN_NODISCARD ern_status ern_run_folder_check_outside(ern_context *context, const struct ern_run_folder *run,
                                                      const char *path);

/* run_folder.c */
/* Fills in the paths only; makes and locks nothing. Needs ern_run_folder_close also after an error. */
ERN_NODISCARD ern_status ern_run_folder_name(ern_context *context, const char *output, struct ern_run_folder *run);
ERN_NODISCARD ern_status ern_run_folder_open(ern_context *context, const char *output, struct ern_run_folder *run);
/* ERN_E_EXISTS where an earlier training is at X or in X.run, whose lock is held. `resume`: a resume was requested and
 * found no state. */
ERN_NODISCARD ern_status ern_run_folder_check_free(ern_context *context, const char *output,
                                                   const struct ern_run_folder *run, bool resume);
/* Locks the folder of a later training, and reports now the errors that it would meet there. Needs ern_run_folder_close
 * also after an error. */
ERN_NODISCARD ern_status ern_run_folder_reserve(ern_context *context, const char *output, bool resume, bool overwrite,
                                                struct ern_run_folder *run);
void ern_run_folder_close(ern_context *context, struct ern_run_folder *run);
ERN_NODISCARD ern_status ern_lines_add(ern_context *context, struct ern_lines *lines, const char *format, ...)
    ERN_PRINTF(3, 4);
/* Appends the kept lines to their files. */
ERN_NODISCARD ern_status ern_run_folder_flush(ern_context *context, struct ern_run_folder *run);
/* Removes the files of an earlier training, except state.next. */
void ern_run_folder_clear(struct ern_run_folder *run);
/* Truncates log and curve to their length at `step`: a killed training may have written more, even half a line. */
ERN_NODISCARD ern_status ern_run_folder_trim(ern_context *context, struct ern_run_folder *run, uint64_t step);

/* trainer_validate.c */
ERN_NODISCARD ern_status ern_trainer_validate(ern_trainer *t, const ern_train_hooks *hooks, double *psnr);

#endif
