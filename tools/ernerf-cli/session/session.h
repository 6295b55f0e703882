/* SPDX-License-Identifier: MIT
 * What every verb needs around the library: common options, messages on stderr, the backend, the check for Ctrl-C, and
 * the output of --json. */
#ifndef ERN_CLI_SESSION_H
#define ERN_CLI_SESSION_H

#include <jansson.h>
#include <stdatomic.h>
#include <sys/stat.h>
#include <time.h>

#include "args.h"
#include "bytes.h"
#include "ernerf/backend.h"
#include "ernerf/base.h"

enum { SESSION_INPUTS = 16, SESSION_STAGED = 9, SESSION_REMARKS = 16, SESSION_HELD = 4096 };
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
  bool beside_cpu; /* set by the verb: the CPU works beside --backend's device, so its options are valid */
  uint64_t seed;
  int progress_form; /* 1: JSON lines */
  bool quiet, deterministic, tune;
  int rank;       /* MPI rank of this process; ranks above 0 print errors only */
  bool overwrite; /* replace existing files */
  bool rewrites; /* set by a verb before session_open: it rewrites its own files repeatedly, and protects other existing
                    files itself */
  bool makes_features;                /* set by a verb: its outputs may replace the features of a clip */
  const char *inputs[SESSION_INPUTS]; /* input files and clips, NULL: none; set by a verb before session_open */
  struct stat seen[SESSION_INPUTS];   /* of the input files by session_open; all 0: no regular file */
  const char *json;                   /* NULL: none, "-": standard output, else a file */
  json_t *outputs;                    /* by resolved path, and by device and inode: the name of each output */
  bool staging;                       /* files are held for session_write_staged */
  size_t staged, staged_size[SESSION_STAGED];
  char *staged_path[SESSION_STAGED];
  void *staged_bytes[SESSION_STAGED];
  atomic_uint remark_count;
  _Atomic uint64_t remarks[SESSION_REMARKS]; /* hashes of the library's last remarks */
  atomic_bool line_open;                     /* the terminal shows the progress line without its newline */
  char *held; /* [SESSION_HELD] of a copy whose work may turn out not to be needed: session_fail and the like put their
                 text here, and print nothing; NULL: they print */
};

enum { SESSION_OUTPUT_OPTIONS = 3, SESSION_COMPUTE_OPTIONS = 5, SESSION_SEED_OPTIONS = 1 };
/* --quiet --json --overwrite. */
void session_output_options(struct session *session, struct option options[SESSION_OUTPUT_OPTIONS]);
/* --backend --device --isa --threads, and --set deterministic. */
void session_compute_options(struct session *session, struct option options[SESSION_COMPUTE_OPTIONS]);
/* --seed, for verbs that use random numbers. */
void session_seed_options(struct session *session, struct option options[SESSION_SEED_OPTIONS]);

/* Up to so many samples a ray, all steps along it have one length (docs/maths.md, Rays and samples). */
enum { SESSION_EVEN_STEPS = 128 };

/* Creates the context, and installs handlers for Ctrl-C, for the file size limit and for a closed pipe. Returns -1 to
 * continue, else the exit status. */
int session_open(struct session *session, const struct args *args);
/* Creates the backend that the options select. */
ERN_NODISCARD ern_status session_backend(struct session *session);
void session_close(struct session *session);

/* Prints "ernerf VERB: ..." with the library's last error, and returns EXIT_FAILURE. */
int session_fail(struct session *session);
/* The same with a message of the program. */
int session_fail_with(struct session *session, const char *format, ...) ERN_PRINTF(2, 3);
/* The same if session_interrupted ended the work. */
int session_stop_with(struct session *session, const char *format, ...) ERN_PRINTF(2, 3);
/* `status`, but 128 and the number of the signal (Ctrl-C: 130, SIGTERM: 143), as in shells, in place of EXIT_FAILURE
 * after session_stop_with. */
int session_exit_status(int status);
/* Prints a line on stderr and adds the newline. Notes are suppressed by --quiet. */
void session_warn(struct session *session, const char *format, ...) ERN_PRINTF(2, 3);
void session_note(struct session *session, const char *format, ...) ERN_PRINTF(2, 3);
/* A note that processes of any rank print. */
void session_note_rank(struct session *session, const char *format, ...) ERN_PRINTF(2, 3);

/* Whether Ctrl-C (SIGINT), SIGTERM or SIGHUP (terminal closed) was caught. A second SIGINT or SIGTERM kills the
 * process. */
bool session_interrupted(void);

/* From the first call on, session_json_refused tells whether an allocation of the JSON library was refused: objects may
 * then lack values, as that library does not always say so. Before all other JSON. */
void session_watch_json(void);
bool session_json_refused(void);

/* Whether --json writes to standard output, which then must receive nothing else. */
bool session_json_on_stdout(const struct session *session);
/* Writes the object to the target of --json, atomically; does nothing without --json. Takes the reference. Returns 0 or
 * EXIT_FAILURE after a message; a NULL object (no memory) fails. */
int session_report(struct session *session, json_t *object);
/* Writes a file atomically: to a temporary file beside it, which is then renamed. Returns 0 or EXIT_FAILURE after a
 * message, as the next ones do. */
int session_write(struct session *session, const char *path, const void *bytes, size_t count);
/* The same for FOLDER/NAME; takes the bytes. */
int session_write_in(struct session *session, const char *folder, const char *name, struct bytes *bytes);
/* The same for a JSON object; path "-": standard output; takes the reference. A NULL object (no memory) fails. */
int session_write_json(struct session *session, const char *path, json_t *object);
/* After session_stage, the three functions above only hold their files. session_write_staged then writes all of them,
 * or none if one cannot be written or `status` is not 0. Returns `status`, or EXIT_FAILURE after a message. */
void session_stage(struct session *session);
int session_write_staged(struct session *session, int status);
/* Fails if a file exists at `path` without --overwrite, if it is an input, a part of any clip or another output, if
 * `path` cannot be a file, or if its folder does not exist. Call it once for each output, before the work begins. */
int session_check_output(struct session *session, const char *path);
/* The same for FOLDER/NAME with each of `count` names; the folder may be missing. */
int session_check_outputs(struct session *session, const char *folder, const char *const *names, size_t count);
/* The same for a training's X.safetensors, whose replacement the trainer itself checks, and for --json, which must
 * differ from it and lie outside X.run. */
int session_check_training(struct session *session, const char *path);
/* Creates the folder if it is missing, and checks that files can be created in it. Returns as above. */
int session_folder(struct session *session, const char *path);
/* A JSON string of a text such as a path; each byte that is not UTF-8 becomes U+FFFD. NULL without memory. */
json_t *session_text(const char *text);
/* A number, or null where it is not finite. */
json_t *session_number(double value);
/* An integer; from 2^63 on, which exceeds the JSON library's integers, a string of its digits. */
json_t *session_whole(uint64_t value);

/* Fails if `output` is the file `input` or a file of the clip `input`, even under another name, if it lies in a picture
 * folder of the clip, or if it is there in another folder `input`, such as one of landmarks. NULL: none. */
int session_check_not_input(struct session *session, const char *input, const char *output);
/* The same for all inputs. */
int session_check_not_inputs(struct session *session, const char *output);
/* Fails if an input file was replaced or changed since session_open: a part may have been read before it, a part after.
 * Call it when all are read. */
int session_check_inputs_kept(struct session *session);
/* Fails if `output` resolves to the same file, existing or not, as an output that was checked before. */
int session_check_distinct_output(struct session *session, const char *output);
/* Fails if the file of --json lies in the folder, existing or not, into which the verb writes. */
int session_check_json_not_input(struct session *session, const char *folder);
/* Fails if an input lies in the folder, whose files will be replaced. Returns 0, or EXIT_FAILURE after a message. */
int session_check_folder_has_no_input(struct session *session, const char *folder);
/* Whether `path` is a symbolic link; if so, warns that the file is not written. For files whose names the training
 * chooses. */
bool session_skips_link(struct session *session, const char *path);
/* The same; also true, after a note, if a file exists there and --overwrite was not given. */
bool session_keeps_file(struct session *session, const char *path);
/* Whether the file, or the target of a symbolic link, lies in the folder. */
bool session_lies_in(const char *path, const char *folder);
/* Whether the folder of `path` exists. */
bool session_folder_there(const char *path);

/* Seconds of a monotonic clock. */
static inline double session_seconds(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

#endif
