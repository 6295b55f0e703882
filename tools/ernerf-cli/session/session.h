/* SPDX-License-Identifier: MIT
 * What every verb needs around the library: the options they have in common, messages on stderr, the backend, a look at
 * whether Ctrl-C was pressed, and the object that --json asks for. */
#ifndef ERN_CLI_SESSION_H
#define ERN_CLI_SESSION_H

#include <jansson.h>

#include "args.h"
#include "bytes.h"
#include "ernerf/backend.h"
#include "ernerf/base.h"

enum { SESSION_INPUTS = 16, SESSION_STAGED = 9 };
enum session_choice { SESSION_AUTO, SESSION_CPU, SESSION_OPENCL };

struct session {
  const char *verb;
  ern_context *context;
  ern_backend *backend; /* NULL before session_backend */
  ern_backend_info backend_info;
  /* from the command line */
  int backend_choice; /* enum session_choice */
  int device, threads;
  const char *isa;
  bool beside_cpu; /* the CPU computes too beside --backend's device, so its options count; set by the verb */
  uint64_t seed;
  int progress_form; /* 1: JSON lines */
  bool quiet, deterministic, tune;
  int rank;       /* of this process among those that mpirun started; others than 0 say and write errors alone */
  bool overwrite; /* files that are there are replaced */
  bool rewrites;  /* set by a verb before session_open: it writes files of its own again and again, and looks after
                     those of others itself */
  const char *inputs[SESSION_INPUTS]; /* files and clips that are read, NULL: none; set by a verb before session_open */
  const char *json;                   /* NULL: none, "-": standard output, else a file */
  json_t *outputs;                    /* where each output leads, and its device and inode: its name */
  bool staging;                       /* files wait for session_write_staged */
  size_t staged, staged_size[SESSION_STAGED];
  char *staged_path[SESSION_STAGED];
  void *staged_bytes[SESSION_STAGED];
  bool line_open; /* the progress line stands on the terminal without its newline */
};

enum { SESSION_OUTPUT_OPTIONS = 3, SESSION_COMPUTE_OPTIONS = 5, SESSION_SEED_OPTIONS = 1 };
/* --quiet --json --overwrite. */
void session_output_options(struct session *session, struct option options[SESSION_OUTPUT_OPTIONS]);
/* --backend --device --deterministic --isa --threads. */
void session_compute_options(struct session *session, struct option options[SESSION_COMPUTE_OPTIONS]);
/* --seed, of verbs that draw random numbers. */
void session_seed_options(struct session *session, struct option options[SESSION_SEED_OPTIONS]);

/* Makes the context, and catches Ctrl-C and the signals of a full disk and a closed pipe. Returns -1 to go on, else the
 * exit status. */
int session_open(struct session *session, const struct args *args);
/* Makes the backend that the options ask for. */
ERN_NODISCARD ern_status session_backend(struct session *session);
void session_close(struct session *session);

/* Says "ernerf VERB: ..." with the library's last error, and returns EXIT_FAILURE. */
int session_fail(struct session *session);
/* The same in the program's own words. */
int session_fail_with(struct session *session, const char *format, ...) ERN_PRINTF(2, 3);
/* The same where session_interrupted ended the work. */
int session_stop_with(struct session *session, const char *format, ...) ERN_PRINTF(2, 3);
/* `status`, but 128 and the number of the signal (Ctrl-C: 130, SIGTERM: 143), as shells have it, in place of
 * EXIT_FAILURE after session_stop_with. */
int session_exit_status(int status);
/* A line on stderr, ended here. Notes are not said with --quiet. */
void session_warn(struct session *session, const char *format, ...) ERN_PRINTF(2, 3);
void session_note(struct session *session, const char *format, ...) ERN_PRINTF(2, 3);
/* A note of any rank. */
void session_note_rank(struct session *session, const char *format, ...) ERN_PRINTF(2, 3);

/* Whether Ctrl-C, SIGTERM or the end of the terminal (SIGHUP) was caught; the next of the first two kills. */
bool session_interrupted(void);

/* Whether the object of --json takes standard output, which is then kept free of anything else. */
bool session_json_on_stdout(const struct session *session);
/* Writes the object where --json says, whole or not at all; nothing without --json. Takes the reference. Returns 0 or
 * EXIT_FAILURE after a message; a NULL object (no memory) fails. */
int session_report(struct session *session, json_t *object);
/* Writes a file, whole or not at all: beside its place first. Returns 0 or EXIT_FAILURE after a message, as the next
 * ones do. */
int session_write(struct session *session, const char *path, const void *bytes, size_t count);
/* The same of FOLDER/NAME; takes the bytes. */
int session_write_in(struct session *session, const char *folder, const char *name, struct bytes *bytes);
/* The same of an object, "-" being standard output; takes the reference. A NULL object (no memory) fails. */
int session_write_json(struct session *session, const char *path, json_t *object);
/* From here on what the three write waits for session_write_staged, which then writes all of it, or nothing where one
 * file cannot be written or `status` is not 0. Returns `status`, or EXIT_FAILURE after a message. */
void session_stage(struct session *session);
int session_write_staged(struct session *session, int status);
/* Fails where a file is at `path` and --overwrite was not given, where it is an input or another output, where a file
 * cannot be, and where the folder of `path` is not there. To be asked once for each output, before the work begins. */
int session_check_output(struct session *session, const char *path);
/* The same of FOLDER/NAME for each of `count` names; the folder may be missing. */
int session_check_outputs(struct session *session, const char *folder, const char *const *names, size_t count);
/* The same of a training's X.safetensors, which the trainer looks after where it is there, and of --json beside it and
 * X.run. */
int session_check_training(struct session *session, const char *path);
/* Makes the folder where it is missing, and finds out whether files can be put there. Returns as above. */
int session_folder(struct session *session, const char *path);
/* A text such as a path, in which U+FFFD stands for each byte that is no UTF-8. NULL without memory. */
json_t *session_text(const char *text);
/* A number, or null where it is not finite. */
json_t *session_number(double value);
/* A whole number; from 2^63 on, which is more than the JSON library's numbers hold, a string of its digits. */
json_t *session_whole(uint64_t value);

/* Fails where `output` is the file `input`, or one that the clip `input` has, whatever the two are called, or lies
 * among the clip's pictures; NULL is none. */
int session_keep(struct session *session, const char *input, const char *output);
/* The same of all inputs. */
int session_keep_inputs(struct session *session, const char *output);
/* Fails where `output` leads to the same file as an output that was asked about before, there or not. */
int session_distinct(struct session *session, const char *output);
/* Fails where the file of --json leads into the folder, there or not, which the verb fills. */
int session_keep_json_out(struct session *session, const char *folder);
/* Fails where an input lies in the folder, whose files are replaced. Returns 0, or EXIT_FAILURE after a message. */
int session_keep_folder(struct session *session, const char *folder);
/* Whether a symbolic link is at `path`, after a warning that it is not written through: for files that a training names
 * itself. */
bool session_skips_link(struct session *session, const char *path);
/* The same, and whether any file is there that --overwrite does not let go, after a note. */
bool session_keeps_file(struct session *session, const char *path);
/* Whether the file, or what it leads to where it is a symbolic link, lies in the folder. */
bool session_lies_in(const char *path, const char *folder);
/* Whether the folder that `path` lies in is there. */
bool session_folder_there(const char *path);

/* Seconds of a clock that only runs forward. */
double session_seconds(void);

#endif
