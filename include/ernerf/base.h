/* SPDX-License-Identifier: MIT
 * Status codes, the context every object belongs to, and the hooks a program may set on it. */
#ifndef ERNERF_BASE_H
#define ERNERF_BASE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The version of these headers (docs/abi.md). */
#define ERN_VERSION_MAJOR 0
#define ERN_VERSION_MINOR 1
#define ERN_VERSION_PATCH 0

/* For the compiler: a function that the library exports, one whose result may not be ignored, and one that takes a
 * format of printf. */
#if defined(__GNUC__)
#define ERN_API __attribute__((visibility("default")))
#define ERN_NODISCARD __attribute__((warn_unused_result))
#define ERN_PRINTF(format_at, args_at) __attribute__((format(printf, format_at, args_at)))
#else
#define ERN_API
#define ERN_NODISCARD
#define ERN_PRINTF(format_at, args_at)
#endif

/* Values are pinned: new codes are added, old ones never renumbered. */
typedef enum ern_status {
  ERN_OK = 0,
  ERN_E_ARGUMENT = 1, /* the caller broke the contract of the function */
  ERN_E_NO_MEMORY = 2,
  ERN_E_STATE = 3,      /* the call is right, but not now: all steps of a training are done, a clip is not finished */
  ERN_E_CANCELLED = 4,  /* a callback of the program ended the call */
  ERN_E_IO = 10,        /* the operating system refused: open, read, write, rename */
  ERN_E_MISSING = 11,   /* a file or folder is not there */
  ERN_E_BUSY = 12,      /* another process, or another object of this one, writes there; or a file of somebody else has
                           the name of the temporary file ("How files are written") */
  ERN_E_EXISTS = 13,    /* a file is there already and may not be replaced (ern_context_config.keep_files) */
  ERN_E_FORMAT = 20,    /* a file is not what it claims to be */
  ERN_E_SHAPE = 21,     /* right format, wrong sizes */
  ERN_E_MISMATCH = 22,  /* two inputs that do not belong together */
  ERN_E_NONFINITE = 30, /* a NaN or an infinity where none may be */
  ERN_E_UNSUPPORTED = 40, /* this version, build or machine cannot do it, or the form of a file cannot hold it */
  ERN_E_DEVICE = 50,      /* a compute device failed */
  ERN_E_MEDIA = 60        /* a picture, video or sound library failed */
} ern_status;

/* A short constant name such as "ERN_E_FORMAT"; never NULL. */
ERN_API const char *ern_status_name(ern_status status);

/* "0.1.0"; compare with the ERN_VERSION_* of the headers at start. */
ERN_API const char *ern_version(void);

/* How important a line of the log is. */
typedef enum ern_log_level {
  ERN_LOG_ERROR = 0,
  ERN_LOG_WARNING = 1,
  ERN_LOG_INFO = 2,
  ERN_LOG_DEBUG = 3
} ern_log_level;

/* Arguments. The same rules hold for every function of every header; what a function says beside them is in addition.
 *
 * - A pointer is NULL, or points to what its comment describes. A pointer may be NULL where its comment says what NULL
 *   means; `user` of a callback always may.
 * - A function that returns ern_status answers ERN_E_ARGUMENT, before it does anything else, where any other pointer is
 *   NULL, where a number or an enum is out of its range, or where a structure was not made by its
 *   ..._default function, which its first member, `cookie`, shows. (A few ranges have a status of their own, which the
 *   function names.) The error text of the context names what is wrong: "ern_model_load: path is NULL". The context is
 *   the argument, or that of the object handed in; where that is NULL, there is the status alone.
 * - After an error, a pointer through which a new object is returned (ern_model **) is NULL, and a structure that
 *   would own memory (ern_features, ern_eyes, ern_pose_list, ern_image, ern_sound) is all zeros, unless the function
 *   keeps an earlier content and says so. All other outputs are undefined: some of them may have been written.
 * - A function that returns void or a value has no error. Where it needs a pointer that is NULL, it changes nothing but
 *   a structure to be filled, which becomes all zeros; its value is 0, false, NULL, or a structure of zeros; NaN where
 *   the function says so.
 * - A function ern_..._free accepts NULL and a pointer to NULL. It sets the pointer that it frees through to NULL, or
 *   the structure whose memory it frees to zeros. One that takes a context does nothing where that is NULL.
 * - A callback that returns ern_status answers ERN_OK to go on, and one that returns int answers 0. Any other value
 *   ends the call. What a callback writes is checked as arguments are. */

/* Types. "Plain data" is a struct without functions of its own. Any number of threads may read one at the same time.
 * While one thread writes it, or has a function write it, no other thread may read or write it. The comment of an
 * object's type says what threads may do with the object. Nothing checks either: where a program does otherwise,
 * results are wrong without an error, or the process ends. What is handed to a callback by pointer is valid until the
 * callback returns.
 *
 * "Final": no later version adds members to the struct. "May grow": a later version may add members at its end. A
 * program that was built with earlier headers still runs then, as the library knows which size the program's headers
 * give the struct. It learns that size from the member `size`, which ..._default sets beside the `cookie`. For a struct
 * without a cookie the size is an argument of the exported function ..._sized; the function that a program calls is
 * inline here and hands sizeof on. In the same way ..._default is inline over the exported ..._fill. Only bindings of
 * other languages call ..._sized and ..._fill themselves.
 *
 * Where the program's struct is shorter than the library's, the library takes the missing members as their defaults (a
 * struct with a cookie) or as 0 (one without), and never writes past the end. Where it is longer, as the program was
 * built with later headers, the library answers ERN_E_UNSUPPORTED if it would read the struct, and fills the rest with
 * zeros if it writes the struct. docs/abi.md has the rest. */

/* Floating point. A function that computes sets the floating-point environment that C programs start in: rounding to
 * nearest, denormal numbers kept, nothing trapped. It restores the caller's environment before it returns. Hooks and
 * callbacks that it calls run in the environment that it has set. One exception: a program that uses OpenCV itself must
 * do so first in that environment, as OpenCV's threads, which are those of the process, keep the one that they begin
 * in. */

/* Stack. A function needs up to 512 KiB of the stack of the thread that calls it. Where the default of threads is less,
 * as with a small limit of the stack (ulimit -s) or in C libraries other than glibc, the program gives its threads
 * more. */

/* How files are written. A function that writes a file writes a temporary file in the same folder, flushes it to the
 * disk, and then gives it its name: a reader sees the old file or the new one, never a part. The temporary file of
 * FOLDER/NAME is FOLDER/NAME.ernerf-tmp. It is locked while it is written, so a second process that writes the same
 * file gets ERN_E_BUSY. The temporary file has the sticky bit as a mark. A process that is killed leaves it behind; the
 * next one that writes FOLDER/NAME removes it. A file of that name without the mark is not removed, and the call ends
 * with ERN_E_BUSY. No other file is ever removed. Where another process removed or replaced the temporary file while it
 * was written, the function fails with ERN_E_IO. A symbolic link is followed: the file that it names is written.
 * "Atomic" in the comment of a function means all of this. */

/* Processes. A child process that fork() makes while no other thread is in a call may use the parent's contexts,
 * models, features, poses and pictures, and the parent's backends of the CPU: on these it makes renderers and trainers
 * of its own. It may neither use nor free the parent's renderers, trainers and video writers. These have threads, which
 * the child lacks, and a call that waits for one would never return. It may not use the parent's backends of OpenCL
 * devices either. Where the parent has used libernerf-media, the child ends with _exit(): in exit() libraries that
 * libernerf-media needs wait for threads of theirs, for ever. */

/* Holds the allocator, the log hook and the error text. Every object is made from one context and must be freed before
 * it. Several threads may use one context at the same time. They share its one error text, which is that of the call
 * that failed last in any thread. A thread reads it with ern_last_error_copy, not with ern_last_error, while other
 * threads use the context. */
typedef struct ern_context ern_context;

/* Plain data, may grow. */
typedef struct ern_context_config {
  uint32_t cookie; /* set by ern_context_config_default(); proves that the struct was initialised */
  uint32_t size;   /* set beside it: bytes of the struct in the program's headers */
  /* Memory hooks, both or neither; NULL: the C library. Both may be called from several threads at a time. allocate
   * returns at least `bytes` (> 0) bytes aligned to `alignment` (a power of two), or NULL. */
  void *(*allocate)(void *user, size_t bytes, size_t alignment);
  void (*release)(void *user, void *memory); /* never gets NULL */
  /* Receives one line without control characters: those of a file's name or content are spaces in it. NULL: silence.
   * May be called from several threads at a time. */
  void (*log)(void *user, ern_log_level level, const char *line);
  void *user;      /* handed to the hooks */
  bool keep_files; /* true: a function that writes a file fails with ERN_E_EXISTS where a file of that name exists;
                      false (default): it replaces that file. Trainings and ern_prepare go by options of their own */
} ern_context_config;

/* The defaults. */
ERN_API void ern_context_config_fill(ern_context_config *config, size_t bytes);
static inline ern_context_config ern_context_config_default(void) {
  ern_context_config config;
  ern_context_config_fill(&config, sizeof config);
  return config;
}

/* Makes a context; `config` NULL means the defaults. On success the caller owns *context.
 * Errors: ERN_E_ARGUMENT (uninitialised config), ERN_E_NO_MEMORY. */
ERN_API ERN_NODISCARD ern_status ern_context_create(ern_context **context, const ern_context_config *config);

/* Frees and sets *context to NULL; accepts NULL and a pointer to NULL. */
ERN_API void ern_context_free(ern_context **context);

/* What went wrong last, as a sentence that names the file, the field, what was found and what was expected, without
 * control characters as a line of the log; "" when nothing did, and for NULL. Valid until the next failing call on the
 * context, in any thread: a program whose threads share a context calls ern_last_error_copy. */
ERN_API const char *ern_last_error(const ern_context *context);

/* Copies that sentence, with its end cut off where it does not fit, and a 0 behind it, into text[bytes]. Returns its
 * length without the 0, as snprintf does: a result of `bytes` or more says that it was cut. Any thread may call it at
 * any time; the sentence is whole, and is that of whichever thread failed last. text may be NULL where bytes is 0. */
ERN_API size_t ern_last_error_copy(const ern_context *context, char *text, size_t bytes);

/* Where the body is in a frame (ern_frame_input.torso_motion): a displacement at each of ERN_MOTION_SIDE rows and
 * columns of control points, which are spread evenly over the picture, the outermost in its corners. */
enum { ERN_MOTION_SIDE = 16, ERN_MOTION_VALUES = 2 * ERN_MOTION_SIDE * ERN_MOTION_SIDE };

#ifdef __cplusplus
}
#endif
#endif
