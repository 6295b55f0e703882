/* SPDX-License-Identifier: MIT
 * Settings: the members of a configuration, described. One table of them tells the library, a program and a language
 * binding what there is to set, within which range, and what it means.
 *
 * Threads: any, at the same time, on different configurations. */
#ifndef ERNERF_SETTING_H
#define ERNERF_SETTING_H

#include "ernerf/base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The C type of the member. */
typedef enum ern_setting_type {
  ERN_SETTING_BOOL,
  ERN_SETTING_INT,
  ERN_SETTING_UINT64,
  ERN_SETTING_SIZE, /* size_t */
  ERN_SETTING_FLOAT,
  ERN_SETTING_DOUBLE,
  ERN_SETTING_WORD,   /* an enum: one of `words` */
  ERN_SETTING_TEXT,   /* const char * */
  ERN_SETTING_POINTER /* to an object or a struct */
} ern_setting_type;

/* What a training that is resumed does where its state has another value. */
typedef enum ern_setting_resume {
  ERN_RESUME_FREE,   /* a state does not keep it */
  ERN_RESUME_KEPT,   /* a state keeps it for the program; the training does not compare it */
  ERN_RESUME_LOGGED, /* goes on with the new one, with a warning in the log */
  ERN_RESUME_SAME    /* ERN_E_MISMATCH */
} ern_setting_resume;

/* Which trainings have it. */
typedef enum ern_setting_scope {
  ERN_SCOPE_ANY,
  ERN_SCOPE_HEAD,  /* of a head */
  ERN_SCOPE_TORSO, /* of a torso */
  ERN_SCOPE_FINE   /* of a fine stage, once it has begun */
} ern_setting_scope;

/* A member of a configuration. Constant, in the library's memory. Plain data, may grow. */
typedef struct ern_setting {
  const char *name;          /* the member's, such as "refresh_every" */
  ern_setting_type type;     /* its C type */
  size_t at;                 /* bytes from the beginning of the configuration to the member */
  double least, most;        /* range of a number; of a word: of its index */
  double fallback;           /* the default; of a word: its index */
  const char *words;         /* of a word: those of the values 0, 1, ..., split at '|'; else NULL */
  const char *help;          /* unit and meaning, a sentence; NULL: chosen for each call, such as a file's name */
  ern_setting_resume resume; /* what a resume compares */
  ern_setting_scope scope;   /* which trainings have it */
  bool same_everywhere;      /* processes that train one model must agree on it */
  const char *group;         /* what it is about, such as "fine stage"; NULL: none */
} ern_setting;

enum { ERN_SETTING_TEXT_BYTES = 48 }; /* enough for the text of any number or word */

/* Sets the member of *config from text: a decimal number, a word, or yes or no of a bool. Returns false, and changes
 * nothing, where the text is none of these or lies outside of the range, or the type is TEXT or POINTER. NULL anywhere
 * is false. */
ERN_API bool ern_setting_read(const ern_setting *setting, const char *text, void *config);

/* Writes the value of the member in the form that ern_setting_read takes: two texts are the same exactly where the
 * values are. `text` becomes "" where the type is TEXT or POINTER. Does nothing where an argument is NULL. */
ERN_API void ern_setting_write(const ern_setting *setting, const void *config, char text[ERN_SETTING_TEXT_BYTES]);

/* Writes what ern_setting_read takes, such as "a whole number from 1 to 1024", shortened to `bytes` with the 0 behind
 * it. Does nothing where an argument is NULL or `bytes` is 0. */
ERN_API void ern_setting_expected(const ern_setting *setting, char *text, size_t bytes);

#ifdef __cplusplus
}
#endif

#endif
