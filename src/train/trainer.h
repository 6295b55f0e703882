/* SPDX-License-Identifier: MIT
 * A trainer in memory: data, model, its values on a backend, and the folder it writes to. Internal. */
#ifndef ERN_TRAIN_TRAINER_H
#define ERN_TRAIN_TRAINER_H

#include "train/parts/trainer_batch.h"
#include "train/parts/trainer_parts.h"
#include "train/parts/trainer_processes.h"
#include "train/parts/trainer_prune.h"
#include "train/parts/trainer_values.h"

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

struct ern_trainer {
  struct ern_training shared;
  char *output;

  struct ern_trainer_values values;
  struct ern_trainer_occupancy occupancy;
  struct ern_trainer_poses *poses; /* NULL: poses are not refined */
  struct ern_trainer_fine fine;
  struct ern_run_folder run;
  uint64_t saved; /* step of this training's newest state in the run folder; 0: none */
  bool diverged;  /* since the last save, and the folder has a state from before */

  struct ern_run_folder torso_run; /* of config.torso_output: only locked */

  struct ern_trainer_speech speech;
  struct ern_trainer_batches batches;
  struct ern_trainer_parts parts; /* all NULL where a step is one part */
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

/* trainer_distributed.c */
/* Copies the state of rank 0 to all processes, after checking that they have the same settings and data. Waits for
 * all. */
ERN_NODISCARD ern_status ern_trainer_share_state(ern_trainer *t);
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
