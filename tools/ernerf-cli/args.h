/* SPDX-License-Identifier: MIT
 * The words of a command line, read by tables: a row an option, a table a group. Dashes and underscores are the same in
 * names; `--name value` and `--name=value` both do, and of one letter `-n value` and `-nvalue`. */
#ifndef ERN_CLI_ARGS_H
#define ERN_CLI_ARGS_H

#include <assert.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "ernerf/base.h"
#include "session/rate.h"

enum { EXIT_USAGE = 2 }; /* wrong words; 1 (EXIT_FAILURE) is for work that failed */

/* Half-open, counted from 0. open_end: to the last, `end` is then unused. */
struct range {
  uint64_t begin, end;
  bool open_end;
};

/* Pixels. */
struct dimensions {
  int width, height;
};

/* Two numbers, such as angles. */
struct pair {
  float first, second;
};

enum option_kind {
  OPTION_FLAG,       /* bool: set to true */
  OPTION_OFF,        /* bool: set to false */
  OPTION_INT,        /* int in [low, high] */
  OPTION_COUNT,      /* uint64_t in [low, high]; high 0: no end */
  OPTION_FLOAT,      /* float in [low, high] */
  OPTION_TEXT,       /* const char *, not empty */
  OPTION_BYTES,      /* uint64_t >= 1 with K, M, G for powers of 1024 */
  OPTION_SECONDS,    /* double: seconds in [low, high], as 90, 90s, 10m or 1.5h */
  OPTION_CHOICE,     /* int: index of the word in `choices`, split at '|' */
  OPTION_RANGE,      /* struct range: A:B, either may be left out */
  OPTION_RANGE_PAIR, /* struct range: A:B, or the two words A B; B -1: to the last */
  OPTION_DIMENSIONS, /* struct dimensions: WxH, each in [low, high] */
  OPTION_RATE,       /* struct rate: frames a second, 1 to 240, as a number or N/D */
  OPTION_PAIR,       /* struct pair: A,B, each in [low, high] */
  OPTION_FRAME,      /* uint64_t: a number from 0, or nothing (0 then) */
  OPTION_JSON        /* const char *: "-", a name ending in .json, or nothing ("-" then) */
};

struct option {
  const char *name, *alias; /* without dashes; alias NULL or other names split at spaces */
  enum option_kind kind;
  void *target;
  double low, high;
  const char *choices; /* of OPTION_CHOICE; of others what the help calls the value, NULL: by kind */
  const char *help;
  bool given;    /* set by the parser */
  bool unlisted; /* not in the help: the verb refuses it, and says why */
};

/* options[count] = rows. A table of more or fewer rows does not compile. */
#define ARGS_FILL(options, rows, count)                                                              \
  do {                                                                                               \
    static_assert(sizeof(rows) / sizeof *(rows) == (count), "the table has another number of rows"); \
    memcpy((options), (rows), sizeof(rows));                                                         \
  } while (0)

struct word {
  const char *name; /* as the help says it: "CLIP" */
  const char **target;
  const char *help;
};

enum { ARGS_GROUPS = 5 };

struct args {
  const char *verb;    /* for messages; of `ernerf VERB` */
  const char *summary; /* what the verb does, in a line */
  const char *usage;   /* how it is called, lines without "ernerf " */
  const char *notes;   /* paragraphs after the options; NULL: none */
  bool public_names;   /* answer options of the public programs that the verb does not have (public_options.h) */
  struct word *words;
  size_t word_count, optional_words; /* the last so many may be missing */
  struct {
    const char *title;
    struct option *options;
    size_t count;
  } groups[ARGS_GROUPS];
};

/* Reads argv[0 .. argc - 1], the words after the verb. Returns -1 to go on, else the exit status: EXIT_SUCCESS after
 * --help, EXIT_USAGE after a sentence on stderr. */
int args_parse(struct args *args, int argc, char **argv);

/* Whether the option was on the command line. `name` must be one of the tables. */
bool args_given(const struct args *args, const char *name);

/* Says "ernerf VERB: ..." and where the help is, on stderr. Returns EXIT_USAGE. */
int args_refuse(const struct args *args, const char *format, ...) ERN_PRINTF(2, 3);

/* Leaves `names` (split at spaces) of a shared table out of the help. */
void args_unlist(struct args *args, const char *names);

/* EXIT_USAGE with a sentence when one of `names` (split at spaces) was given, for the reason `why`; else -1. */
int args_forbid(const struct args *args, const char *names, const char *why);

/* Of `count` names the one nearest to `name` by edits; NULL where more than a third of its letters would change. */
const char *args_nearest(const char *name, const char *const *names, size_t count);

#endif
