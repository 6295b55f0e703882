/* SPDX-License-Identifier: MIT
 * A trainer in memory: data, model, its values on a backend, and the folder it writes to. Internal. */
#ifndef ERN_TRAIN_TRAINER_H
#define ERN_TRAIN_TRAINER_H

#include "core/backend.h"
#include "core/threads.h"
#include "ernerf/train.h"
#include "model/model.h"

/* Shares of a head's rays that are drawn in the lower face and around the eyes, and of its frames that are drawn among
 * those with shut eyes, found by trying (docs/history-training.md, docs/history-occupancy.md). */
#define ERN_LOWER_FACE_SHARE 0.3f
#define ERN_EYES_SHARE 0.1f
#define ERN_SILHOUETTE_SHARE 0.1f
#define ERN_HEAD_SHARE 0.2f
#define ERN_BLINK_SHARE 0.1f

enum {
  ERN_REFRESH_EVERY = 16,      /* steps between occupancy refreshes, as published */
  ERN_REFRESH_WARM_UP = 256,   /* steps in which each refresh looks at all cells */
  ERN_SMOOTH_EVERY = 16,       /* steps between smoothness terms */
  ERN_REFRESH_CHUNK = 1 << 18, /* cells that a refresh looks at in one go: a bound on the memory of their points */
  ERN_LEAST_EMA_UPDATES = 10   /* before which the average is no model: it is still full of its beginning */
};

#define ERN_TRAIN_MOST_RATE 1e3
#define ERN_TRAIN_MOST_SECONDS 1e9

/* Lines of a text file that are kept until the next save. */
struct ern_lines {
  char *text;
  size_t used, capacity;
};

/* X.run: the lock, and the names in it. All NULL without an output. */
struct ern_run_folder {
  char *folder, *state, *next, *previous, *good, *log, *curve;
  int lock;     /* descriptor, -1: none */
  bool made;    /* the folder was not there before */
  bool keep;    /* until the first save: a file at X is not replaced */
  bool damaged; /* the state does not verify: the next save replaces it, and not the whole one before it */
  bool fresh;   /* nothing of this training has been written yet: what lies there is an earlier one's */
  struct ern_lines log_lines, curve_lines;
};

/* A row a frame: three angles of the model's camera refinement, as radians, and a move, scene units, both about the
 * scene's origin. Their mean over the trained frames is 0. */
struct ern_trainer_poses {
  float *row;           /* [frames][ERN_POSE_SLOPES] */
  float *bend;          /* [frames][ERN_POSE_SLOPES]: second differences of the clip's own path, 0 at its gaps */
  size_t *beside;       /* [frames][2]: the frames before and after in time, the frame itself where there is none */
  int64_t *moment;      /* [frames]: their rows of the speech */
  float mean_square[2]; /* of the gradients by angles and by moves, all frames together; 0: no step yet */
};

/* What a step adds up to besides its gradient: means over its rays. A plain array of doubles for the communicator. */
struct ern_step_sum {
  double terms[ERN_LOSS_TERMS]; /* each frame's are means over its own rays */
  double squared_error, samples;
  double dpose[ERN_FRAMES_PER_STEP_MOST][ERN_POSE_SLOPES]; /* by frame of the step */
  double seconds, beside;                                  /* before the step, by the clock of rank 0 */
};

/* Sums of parts of a step, on the host: [levels] of a binary tree that wait for their other half. */
struct ern_trainer_parts {
  size_t begin, count; /* the values that this training changes are [begin, begin + count) of all */
  float *values;       /* [levels][count] */
  struct ern_step_sum *sums;
  float *gathered; /* of an occupancy refresh: [ERN_REFRESH_CHUNK]; NULL without a communicator */
};

struct ern_trainer {
  ern_context *context;
  struct ern_backend *backend;
  struct ern_stream *stream;
  ern_dataset data;
  ern_train_config config;
  char *output, identity[65], features[65]; /* SHA-256 of clip and speech features; the latter "" without an output */
  ern_model *model;                         /* configuration and table; its values are those of the last download */

  struct ern_buffer *reals, *bits_buffer, *cells_buffer;
  ern_span parameters, gradient, moment, average; /* [field.parameters] */
  ern_span grid, fresh, bits, cells;              /* occupancy of the head */
  size_t cell_count;                              /* cells that a refresh looks at */
  bool pruned;                                    /* `bits` are, and are refreshed no more */
  ern_span torso_grid;
  double torso_mean;

  bool bf16; /* products of bf16 (config.precision) */

  struct ern_view *views;          /* [training frames], as the clip has them */
  size_t *blinks, blink_count;     /* training frames with shut eyes; none where every frame is drawn alike */
  struct ern_trainer_poses *poses; /* NULL: they stay as they are */
  uint64_t step, ema_updates;
  uint64_t fine_from;              /* the first step of the fine stage; UINT64_MAX: none */
  struct ern_buffer *patch_filter; /* of patches_ops.h; NULL without a fine stage */
  ern_fine_loss fine_loss;         /* that config.fine_loss points to */
  char fine_name[32];              /* and its name */
  double seconds;                  /* of training, all runs together */
  double beside;                   /* seconds of validations and saves, all runs together */
  double late;                     /* with a communicator: seconds of the last step, not yet in `seconds` */
  struct ern_run_folder run;
  uint64_t saved; /* step of the newest state in it that is this training's; 0: none */
  bool diverged;  /* since the last save, with a state of before in the folder */

  struct ern_run_folder torso_run; /* of config.torso_output: locked, and nothing else */

  ern_communicator communicator;  /* size 1: this process is alone */
  struct ern_trainer_parts parts; /* all NULL where a step is one part */

  struct ern_pool *pool;   /* for work on the host */
  int32_t *host_pixels;    /* [rays] */
  float *host_rows;        /* [9][rays]: truth, background, face, jitter, rigid */
  float *host_windows;     /* [8][window_length][width] */
  float *speech_deviation; /* [width]: standard deviations of the features; NULL without noise */
};

/* What one step trains on, or a part of it: a frame and rays of it, on the backend (scratch). */
struct ern_batch {
  size_t frame, rays, patches; /* patches 0: rays are on their own */
  size_t of_step;              /* the frame's number among those of the step */
  float eye;
  ern_span pixel_number, jitter, face, windows;
  ern_rows truth, background;
  ern_span rigid;                /* real [rays]: 0 in the lower face, which moves against the head, else 1 */
  double dpose[ERN_POSE_SLOPES]; /* after the step, where ern_trainer_poses_due */
};

static inline struct ern_march_settings ern_trainer_march(const ern_trainer *t) {
  return (struct ern_march_settings){t->config.bound, t->config.max_steps, t->config.dt_gamma, ERN_NEAR_PLANE};
}

/* trainer_make.c */
/* Whether products are of bf16. `path`: who asks for it. */
ERN_NODISCARD ern_status ern_trainer_choose_precision(ern_trainer *t, const char *path, ern_precision wanted);
/* Whether the model says that it is of another clip. */
bool ern_trainer_is_foreign(const ern_trainer *t, const ern_model *model);
/* Takes over what the person agreed to, where nothing else is said and it is of the same clip. */
void ern_trainer_keep_consent(ern_trainer *t, const ern_model *from);
/* The rows of the torso, or those of the head, with what else belongs to either; of individual codes as many as both
 * have. Other rows have the same shape in both. */
void ern_trainer_copy_rows(ern_model *to, const ern_model *from, bool torso);
/* The camera refinement, into a model without one. */
ERN_NODISCARD ern_status ern_trainer_copy_camera(ern_model *to, const ern_model *from);
/* A line of the log where a file has another number of individual codes than this training. */
void ern_trainer_log_codes(const ern_trainer *t, const char *path, int found);

/* trainer_data.c: what the dataset's callbacks give, looked at. Internal code calls these, never the callbacks. */
ERN_NODISCARD ern_status ern_trainer_frame(const ern_trainer *t, int split, size_t frame, ern_dataset_frame *about);
/* *head as ern_dataset.head gives it for a training frame; NULL without it, and where the training does not use it. */
ERN_NODISCARD ern_status ern_trainer_head(const ern_trainer *t, size_t frame, const uint8_t **head);
ERN_NODISCARD ern_status ern_trainer_pixels(const ern_trainer *t, int split, size_t frame, const uint8_t **truth,
                                            const uint8_t **torso); /* *torso NULL: none */
/* Whether a callback of the caller that failed left the text of the error as it was `before`: the trainer then says
 * what failed, as that text is of something else. */
bool ern_trainer_said_nothing(const ern_trainer *t, const char before[ERN_ERROR_BYTES]);

/* trainer.c: with config.seconds, the steps in all become those that the pace so far gives: those that are made where
 * the time is past, but `least` at least. */
void ern_trainer_follow_time(ern_trainer *t, uint64_t least);

/* trainer_fine.c (docs/maths.md, "The fine stage") */
/* Copies config.fine_loss, after a look at it. */
ERN_NODISCARD ern_status ern_trainer_fine_take(ern_trainer *t);
const char *ern_trainer_fine_name(const ern_trainer *t); /* "ssim" without config.fine_loss */
/* Whether the next step is of it. */
static inline bool ern_trainer_is_fine(const ern_trainer *t) { return t->step >= t->fine_from; }
/* When it begins; `found`: where a resumed state had it begin, UINT64_MAX: nowhere. */
ERN_NODISCARD ern_status ern_trainer_fine_begin(ern_trainer *t, uint64_t found);
/* Steps before it, all where there is none; with `seconds` as the pace so far gives them. */
uint64_t ern_trainer_coarse_steps(const ern_trainer *t);
/* With `seconds`, before a step: lets it begin where its share of the time has come. */
void ern_trainer_fine_due(ern_trainer *t);
size_t ern_trainer_most_rays(const ern_trainer *t); /* of any step */
/* Of the next step. */
size_t ern_trainer_step_frames(const ern_trainer *t);
size_t ern_trainer_step_rays(const ern_trainer *t);
size_t ern_trainer_step_patches(const ern_trainer *t); /* 0: its rays are no patches */
/* Pixels of patches [first, first + count) of the step, one patch after the other. lips: of the frame */
void ern_trainer_place_patches(const ern_trainer *t, const ern_box *lips, size_t first, size_t count, int32_t *pixel);

/* trainer.c: forward and backward of a batch, added to gradient and sum. */
ERN_NODISCARD ern_status ern_trainer_batch_step(ern_trainer *t, struct ern_batch *batch, struct ern_step_sum *sum);

/* trainer_parts.c (docs/scaling.md, "Parts of a step") */
enum { ERN_STEP_BATCHES_MOST = 64 };
/* Batches of the next step, of all processes: a frame each, or more of a frame where a step has more parts than
 * frames. */
size_t ern_trainer_step_batches(const ern_trainer *t);
/* Those of this process, a range. */
size_t ern_trainer_first_batch(const ern_trainer *t);
static inline size_t ern_trainer_own_batches(const ern_trainer *t) {
  return ern_trainer_step_batches(t) / (size_t)t->communicator.size;
}
ERN_NODISCARD ern_status ern_trainer_parts_check(ern_context *context, const ern_train_config *config);
ERN_NODISCARD ern_status ern_trainer_parts_make(ern_trainer *t);
void ern_trainer_parts_free(ern_trainer *t);
/* Gradient and sum of a step from this process's batches and those of the others. */
ERN_NODISCARD ern_status ern_trainer_parts_step(ern_trainer *t, struct ern_batch *batches, struct ern_step_sum *sum);

/* trainer_distributed.c */
/* Of `count` values on the backend this process has those that ern_communicator.gather says; afterwards all. */
ERN_NODISCARD ern_status ern_trainer_gather(ern_trainer *t, ern_span values, size_t count);
/* The state of rank 0 in all processes, after a look at whether they train the same on the same. Waits for all. */
ERN_NODISCARD ern_status ern_trainer_share_state(ern_trainer *t);
/* Returns after rank 0 has called it. */
ERN_NODISCARD ern_status ern_trainer_wait_for_first(ern_trainer *t);
ERN_NODISCARD ern_status ern_trainer_sum(ern_trainer *t, float *values, size_t count, struct ern_step_sum *sum);

/* trainer_batch.c */
/* Batch k of ern_trainer_step_batches. */
ERN_NODISCARD ern_status ern_trainer_batch(ern_trainer *t, size_t k, struct ern_batch *batch);
/* Frame k of ern_trainer_step_frames. */
size_t ern_trainer_step_frame(const ern_trainer *t, size_t k);
/* The camera of a frame. */
ERN_NODISCARD ern_status ern_trainer_view(const ern_trainer *t, int split, size_t frame, struct ern_view *view);
/* A training frame of [data_begin, data_end), by a random word. */
size_t ern_trainer_random_frame(const ern_trainer *t, uint32_t word);
/* Row of the individual codes of a training frame. */
static inline size_t ern_trainer_code(const ern_trainer *t, size_t frame) {
  return t->model->field.config.codes > 0 ? frame : 0;
}

/* trainer_speech.c */
ERN_NODISCARD ern_status ern_trainer_speech_make(ern_trainer *t);
/* The speech of a frame: host [8][window_length][width]. */
ERN_NODISCARD ern_status ern_trainer_windows(ern_trainer *t, int split, size_t frame, float *host);
/* That of a training frame for part k of the step, with data augmentation, uploaded to `windows` (taken from scratch).
 */
ERN_NODISCARD ern_status ern_trainer_upload_windows(ern_trainer *t, size_t frame, size_t k, ern_span *windows);

/* trainer_poses.c (docs/maths.md, "Poses") */
/* Nothing where config.refine_poses is not set. */
ERN_NODISCARD ern_status ern_trainer_poses_make(ern_trainer *t);
void ern_trainer_poses_free(ern_trainer *t);

/* Whether this step asks for the camera's gradient. */
bool ern_trainer_poses_due(const ern_trainer *t);
/* The camera of a training frame as it is refined now. */
struct ern_view ern_trainer_poses_view(ern_trainer *t, size_t frame);
/* A step of the frame that was visited. dpose: [ERN_POSE_SLOPES], finite */
void ern_trainer_poses_step(ern_trainer *t, size_t frame, const double *dpose);

/* The rows as the model keeps them, and their regression, into t->model. */
ERN_NODISCARD ern_status ern_trainer_poses_download(ern_trainer *t);
/* The reverse, of the rows that `model` has. */
ERN_NODISCARD ern_status ern_trainer_poses_take(ern_trainer *t, const ern_model *model);

/* trainer_refresh.c */
ERN_NODISCARD ern_status ern_trainer_mark(ern_trainer *t); /* a new training: cells that no camera sees */
ERN_NODISCARD ern_status ern_trainer_list(ern_trainer *t); /* all cells to look at */
uint64_t ern_trainer_refresh_every(const ern_trainer *t);  /* steps, around the next one */
/* real [ERN_AUDIO_CODE], taken from scratch: the code of a training frame's speech. */
ERN_NODISCARD ern_status ern_trainer_audio_code(ern_trainer *t, size_t frame, ern_span *code);
ERN_NODISCARD ern_status ern_trainer_refresh(ern_trainer *t);
/* Before a step: a refresh where one is due, or the pruning. */
ERN_NODISCARD ern_status ern_trainer_occupancy(ern_trainer *t);

/* trainer_prune.c */
/* Whether the next step is one of the last part of a head's training, in which the occupancy grid stays pruned. */
bool ern_trainer_prune_due(const ern_trainer *t);
/* Leaves the cells out of t->bits that contribute less than config.prune_share. */
ERN_NODISCARD ern_status ern_trainer_prune(ern_trainer *t);

/* trainer_state.c */
bool ern_trainer_is_averaged(const ern_trainer *t); /* whether a save writes the moving average */
ERN_NODISCARD ern_status ern_trainer_download(ern_trainer *t, ern_span from); /* values and occupancy into t->model */
ERN_NODISCARD ern_status ern_trainer_resume(ern_trainer *t, bool *resumed);
ERN_NODISCARD ern_status ern_trainer_take_file(ern_trainer *t, const char *path); /* --from */

/* Whether X.run/lock is the file that this training locked. It is another one where the folder was moved and made
 * again, or where the program has changed its working folder: what lies there is then another training's. ERN_E_IO. */
ERN_NODISCARD ern_status ern_run_folder_check_held(ern_context *context, const struct ern_run_folder *run);

/* A file that a training starts from may not be one that its saves replace. path NULL: none. ERN_E_ARGUMENT. */
ERN_NODISCARD ern_status ern_run_folder_check_outside(ern_context *context, const struct ern_run_folder *run,
                                                      const char *path);

/* run_folder.c */
/* The names alone; nothing is made or locked. ern_run_folder_close also after an error. */
ERN_NODISCARD ern_status ern_run_folder_name(ern_context *context, const char *output, struct ern_run_folder *run);
ERN_NODISCARD ern_status ern_run_folder_open(ern_context *context, const char *output, struct ern_run_folder *run);
/* ERN_E_EXISTS where an earlier training is at X or in X.run, whose lock is held. `resume`: it was asked for, in vain.
 */
ERN_NODISCARD ern_status ern_run_folder_check_free(ern_context *context, const char *output,
                                                   const struct ern_run_folder *run, bool resume);
/* The folder of a training that is still to come, locked: what that would be refused for there is told now.
 * ern_run_folder_close also after an error. */
ERN_NODISCARD ern_status ern_run_folder_reserve(ern_context *context, const char *output, bool resume, bool overwrite,
                                                struct ern_run_folder *run);
void ern_run_folder_close(ern_context *context, struct ern_run_folder *run);
ERN_NODISCARD ern_status ern_lines_add(ern_context *context, struct ern_lines *lines, const char *format, ...)
    ERN_PRINTF(3, 4);
/* Appends the kept lines to their files. */
ERN_NODISCARD ern_status ern_run_folder_flush(ern_context *context, struct ern_run_folder *run);
/* Removes what an earlier training left, but for state.next. */
void ern_run_folder_clear(struct ern_run_folder *run);
/* Log and curve back to where they were at `step`: a killed training has written more, perhaps half a line. */
ERN_NODISCARD ern_status ern_run_folder_trim(ern_context *context, const struct ern_run_folder *run, uint64_t step);

/* trainer_validate.c */
ERN_NODISCARD ern_status ern_trainer_validate(ern_trainer *t, const ern_train_hooks *hooks, double *psnr);

#endif
