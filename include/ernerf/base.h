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

#define ERN_VERSION_MAJOR 0
#define ERN_VERSION_MINOR 1
#define ERN_VERSION_PATCH 0

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
  ERN_E_STATE = 3,      /* right call, wrong time */
  ERN_E_CANCELLED = 4,  /* a callback of the caller asked to stop */
  ERN_E_IO = 10,        /* the operating system refused: open, read, write, rename */
  ERN_E_MISSING = 11,   /* a file or folder is not there */
  ERN_E_BUSY = 12,      /* another process holds the lock */
  ERN_E_EXISTS = 13,    /* a file is there already, and nobody allowed it to be replaced */
  ERN_E_FORMAT = 20,    /* a file is not what it claims to be */
  ERN_E_SHAPE = 21,     /* right format, wrong sizes */
  ERN_E_MISMATCH = 22,  /* two inputs that do not belong together */
  ERN_E_NONFINITE = 30, /* a NaN or an infinity where none may be */
  ERN_E_UNSUPPORTED = 40,
  ERN_E_DEVICE = 50, /* a compute device failed */
  ERN_E_MEDIA = 60   /* a picture, video or sound library failed */
} ern_status;

/* A short constant name such as "ERN_E_FORMAT"; never NULL. */
ERN_API const char *ern_status_name(ern_status status);

/* "0.1.0"; compare with the ERN_VERSION_* of the headers at start. */
ERN_API const char *ern_version(void);

typedef enum ern_log_level {
  ERN_LOG_ERROR = 0,
  ERN_LOG_WARNING = 1,
  ERN_LOG_INFO = 2,
  ERN_LOG_DEBUG = 3
} ern_log_level;

/* Functions that compute do so in the floating-point environment that C programs start in (to nearest, denormal numbers
 * kept, nothing trapped), whatever the caller's is, and leave the caller's as it was; hooks of the caller are called in
 * the former. */

/* How files are written. A function that writes a file writes a temporary file in the same folder, flushes it to the
 * disk, and then gives it its name: a reader sees the old file or the new one, never a part. The temporary file of
 * FOLDER/NAME is FOLDER/NAME.ernerf-tmp. It is locked while it is written, so a second process that writes the same
 * file gets ERN_E_BUSY. A process that is killed leaves it; the next one that writes FOLDER/NAME reuses it, and no
 * other file is ever removed. A symbolic link is followed: the file that it names is written. */

/* Holds allocator, log hook and the text of the last error. Every object is made from one context and must be freed
 * before it. One context may serve several threads; the text of the last error is then that of whoever failed last. */
typedef struct ern_context ern_context;

typedef struct ern_context_config {
  uint32_t cookie; /* set by ern_context_config_default(); proves that the struct was initialised */
  /* Memory hooks, both or neither; NULL: the C library. allocate returns at least `bytes` bytes aligned to
   * `alignment` (a power of two), or NULL. */
  void *(*allocate)(void *user, size_t bytes, size_t alignment);
  void (*release)(void *user, void *memory);
  /* Receives one line without a newline; NULL: silence. May be called from several threads. */
  void (*log)(void *user, ern_log_level level, const char *line);
  void *user;      /* handed to the hooks */
  bool keep_files; /* functions that write a file fail with ERN_E_EXISTS where it exists; false: they replace it */
} ern_context_config;

ERN_API ern_context_config ern_context_config_default(void);

/* Makes a context; `config` NULL means the defaults. On success the caller owns *context.
 * Errors: ERN_E_ARGUMENT (uninitialised config), ERN_E_NO_MEMORY. */
ERN_API ERN_NODISCARD ern_status ern_context_create(ern_context **context, const ern_context_config *config);

/* Frees and sets *context to NULL; accepts NULL and a pointer to NULL. */
ERN_API void ern_context_free(ern_context **context);

/* What went wrong last, as a sentence that names file, field, found and expected; "" when nothing did.
 * Valid until the next failing call on the context. */
ERN_API const char *ern_last_error(const ern_context *context);

#ifdef __cplusplus
}
#endif
#endif
