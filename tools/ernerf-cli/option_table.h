/* SPDX-License-Identifier: MIT
 * Tables of a verb's options: one row for each option, one table for each group. */
#ifndef ERN_CLI_OPTION_TABLE_H
#define ERN_CLI_OPTION_TABLE_H

#include <assert.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* Half-open, counted from 0. open_end: up to the last one; `end` is unused. */
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

/* The values of an option that may be given more than once. */
enum { TEXT_LIST = 16 };
struct text_list {
  const char *text[TEXT_LIST];
  size_t count;
};

enum option_kind {
  OPTION_FLAG,       /* bool: set to true */
  OPTION_OFF,        /* bool: set to false */
  OPTION_INT,        /* int in [low, high] */
  OPTION_COUNT,      /* uint64_t in [low, high]; high 0: no end */
  OPTION_FLOAT,      /* float in [low, high] */
  OPTION_TEXT,       /* const char *, not empty */
  OPTION_LIST,       /* struct text_list: TEXT_LIST values at most, each of an option of its own */
  OPTION_BYTES,      /* uint64_t >= 1 with K, M, G for powers of 1024 */
  OPTION_SECONDS,    /* double: seconds in [low, high], written 90, 90s, 10m or 1.5h */
  OPTION_CHOICE,     /* int: index of the word in `choices`, split at '|' */
  OPTION_RANGE,      /* struct range: A:B, either may be left out */
  OPTION_RANGE_PAIR, /* struct range: A:B, or the two words A B; B -1: to the last */
  OPTION_DIMENSIONS, /* struct dimensions: WxH, each in [low, high] */
  OPTION_RATE,       /* struct rate: frames a second, 1 to 240, as a number or N/D */
  OPTION_PAIR,       /* struct pair: A,B, each in [low, high] */
  OPTION_FRAME,      /* uint64_t: a number from 0, or nothing (0 then) */
  OPTION_JSON,       /* const char *: "-", a name ending in .json, or nothing ("-" then) */
  OPTION_SETTING     /* struct setting_choice: the value of its member `setting` */
};

struct option {
  const char *name, *alias; /* without dashes; alias: other names, separated by spaces, or NULL */
  enum option_kind kind;
  void *target;
  double low, high;
  const char *choices; /* of OPTION_CHOICE; other kinds: the value's name in the help, NULL: a name by kind */
  const char *help;    /* NULL of OPTION_SETTING: the setting's own */
  const char *setting; /* of OPTION_SETTING: the member's name, range and default of which the help shows */
  bool seldom;         /* taken by --set NAME=VALUE, and listed by --set help alone */
  bool published;      /* of a seldom one: --NAME is a name of the public program's, and is taken too */
  bool given;          /* set by the parser */
  bool unlisted;       /* absent from the help: the verb rejects it with a reason */
};

/* The first members of a row, by its kind. Does not compile where the target's type is another. */
#define ARGS_ROW(kind_, type, name_, target_) .name = (name_), .kind = (kind_), .target = (1 ? (target_) : (type *)0)
#define ARGS_BOUNDED(kind_, type, name_, target_, least, most) \
  ARGS_ROW(kind_, type, name_, target_), .low = (least), .high = (most)
#define ARGS_FLAG(name, target) ARGS_ROW(OPTION_FLAG, bool, name, target)
#define ARGS_OFF(name, target) ARGS_ROW(OPTION_OFF, bool, name, target)
#define ARGS_INT(name, target, least, most) ARGS_BOUNDED(OPTION_INT, int, name, target, least, most)
#define ARGS_COUNT(name, target, least, most) ARGS_BOUNDED(OPTION_COUNT, uint64_t, name, target, least, most)
#define ARGS_FLOAT(name, target, least, most) ARGS_BOUNDED(OPTION_FLOAT, float, name, target, least, most)
#define ARGS_SECONDS(name, target, least, most) ARGS_BOUNDED(OPTION_SECONDS, double, name, target, least, most)
#define ARGS_DIMENSIONS(name, target, least, most) \
  ARGS_BOUNDED(OPTION_DIMENSIONS, struct dimensions, name, target, least, most)
#define ARGS_PAIR(name, target, least, most) ARGS_BOUNDED(OPTION_PAIR, struct pair, name, target, least, most)
#define ARGS_TEXT(name, target) ARGS_ROW(OPTION_TEXT, const char *, name, target)
#define ARGS_LIST(name, target) ARGS_ROW(OPTION_LIST, struct text_list, name, target)
#define ARGS_BYTES(name, target) ARGS_ROW(OPTION_BYTES, uint64_t, name, target)
#define ARGS_CHOICE(name, target, words) ARGS_ROW(OPTION_CHOICE, int, name, target), .choices = (words)
#define ARGS_RANGE(name, target) ARGS_ROW(OPTION_RANGE, struct range, name, target)
#define ARGS_RANGE_PAIR(name, target) ARGS_ROW(OPTION_RANGE_PAIR, struct range, name, target)
#define ARGS_RATE(name, target) ARGS_ROW(OPTION_RATE, struct rate, name, target)
#define ARGS_FRAME(name, target) ARGS_ROW(OPTION_FRAME, uint64_t, name, target)
#define ARGS_JSON(name, target) ARGS_ROW(OPTION_JSON, const char *, name, target)
#define ARGS_SETTING(choice, member) .kind = OPTION_SETTING, .target = (choice), .setting = (member)

/* options[count] = rows. Does not compile if the number of rows is not `count`. */
#define ARGS_FILL(options, rows, count)                                                              \
  do {                                                                                               \
    static_assert(sizeof(rows) / sizeof *(rows) == (count), "the table has another number of rows"); \
    memcpy((options), (rows), sizeof(rows));                                                         \
  } while (0)

struct word {
  const char *name; /* as in the help: "CLIP" */
  const char **target;
  const char *help;
};

enum { ARGS_GROUPS = 5 };

struct setting_choice;

struct args {
  const char *verb;                /* of `ernerf VERB`, for messages */
  const char *summary;             /* what the verb does, in one line */
  const char *usage;               /* the usage lines, without "ernerf " */
  const char *notes;               /* paragraphs after the options; NULL: none */
  struct setting_choice *settings; /* further names of --set; NULL: none */
  bool public_names; /* explain options of the public programs that the verb does not have (public_options.h) */
  struct word *words;
  size_t word_count, optional_words; /* optional_words: how many of the last ones may be missing */
  struct {
    const char *title; /* NULL: none of its options is in the help */
    struct option *options;
    size_t count;
  } groups[ARGS_GROUPS];
};

#endif
