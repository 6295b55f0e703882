/* SPDX-License-Identifier: MIT
 * The run folder X.run of a training. Internal. */
#ifndef ERN_TRAIN_RUN_FOLDER_H
#define ERN_TRAIN_RUN_FOLDER_H

#include "ernerf/train.h"

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

/* ERN_E_IO where X.run/lock is not the file that this training locked. The folder was then moved and made again, or the
 * program has changed its working directory: the files there are another training's. */
ERN_NODISCARD ern_status ern_run_folder_check_held(ern_context *context, const struct ern_run_folder *run);

/* ERN_E_ARGUMENT where `path`, a file that a training starts from, is one that its saves would replace. path NULL:
 * none. */
ERN_NODISCARD ern_status ern_run_folder_check_outside(ern_context *context, const struct ern_run_folder *run,
                                                      const char *path);

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

#endif
