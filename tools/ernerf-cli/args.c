/* SPDX-License-Identifier: MIT */
#include "args.h"

#include <ctype.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "help.h"
#include "option_words.h"
#include "public_options.h"
#include "setting_choice.h"

enum { NAME_BYTES = 64, TEXT_BYTES = 256 };

int args_refuse(const struct args *args, const char *format, ...) {
  va_list values;
  va_start(values, format);
  fprintf(stderr, "ernerf %s: ", args->verb);
  vfprintf(stderr, format, values);
  va_end(values);
  fprintf(stderr,
          "\n"
          "`ernerf %s --help` lists the options\n",
          args->verb);
  return EXIT_USAGE;
}

/* ---- names ------------------------------------------------------------------------------------------------------- */

static char plain(char c) { return c == '_' ? '-' : c; }

/* Whether the `length` letters at `a` are the name `b`. */
static bool same_name(const char *a, size_t length, const char *b) {
  if (strlen(b) != length) return false;
  for (size_t i = 0; i < length; i++)
    if (plain(a[i]) != plain(b[i])) return false;
  return true;
}

/* The name, or one of its other names. */
static bool names_option(const struct option *option, const char *name, size_t length) {
  if (same_name(name, length, option->name)) return true;
  char alias[NAME_BYTES];
  for (const char *at = option->alias; at != NULL && *at != 0;) {
    const size_t bytes = strcspn(at, " ");
    snprintf(alias, sizeof alias, "%.*s", (int)bytes, at);
    if (same_name(name, length, alias)) return true;
    at += bytes + strspn(at + bytes, " ");
  }
  return false;
}

static struct option *find_option(const struct args *args, const char *name, size_t length) {
  for (int g = 0; g < ARGS_GROUPS; g++)
    for (size_t i = 0; i < args->groups[g].count; i++)
      if (names_option(&args->groups[g].options[i], name, length)) return &args->groups[g].options[i];
  return NULL;
}

/* The option as it is written on the command line. */
static const char *written(const struct option *option, char text[NAME_BYTES + 8]) {
  const bool set = option->seldom && !option->published;
  snprintf(text, NAME_BYTES + 8, "%s%s", set ? "--set " : option_dashes(option->name), option->name);
  return text;
}

bool args_given(const struct args *args, const char *name) {
  const struct option *option = find_option(args, name, strlen(name));
  return option != NULL && option->given;
}

void args_unlist(struct args *args, const char *names) {
  for (const char *at = names; *at != 0;) {
    const size_t bytes = strcspn(at, " ");
    struct option *option = find_option(args, at, bytes);
    if (option != NULL) option->unlisted = true;
    at += bytes + strspn(at + bytes, " ");
  }
}

int args_forbid(const struct args *args, const char *names, const char *why) {
  for (const char *at = names; *at != 0;) {
    const size_t bytes = strcspn(at, " ");
    const struct option *option = find_option(args, at, bytes);
    char text[NAME_BYTES + 8];
    if (option != NULL && option->given) return args_refuse(args, "%s %s", written(option, text), why);
    at += bytes + strspn(at + bytes, " ");
  }
  return -1;
}

int args_forbid_setting(const struct args *args, const struct setting_choice *choice, const char *name,
                        const char *why) {
  if (!setting_given(choice, name)) return -1;
  for (int g = 0; g < ARGS_GROUPS; g++)
    for (size_t i = 0; i < args->groups[g].count; i++) {
      const struct option *option = &args->groups[g].options[i];
      if (option->given && option->kind == OPTION_SETTING && strcmp(option->setting, name) == 0)
        return args_refuse(args, "--%s %s", option->name, why);
    }
  char shown[SETTING_NAME_BYTES];
  return args_refuse(args, "--set %s %s", setting_option_name(name, shown), why);
}

int args_forbid_settings(const struct args *args, const struct setting_choice *choice, ern_setting_scope scope,
                         const char *why) {
  const ern_setting *setting;
  int status = -1;
  for (size_t i = 0; (setting = choice->row(i)) != NULL && status < 0; i++)
    if (setting->scope == scope) status = args_forbid_setting(args, choice, setting->name, why);
  return status;
}

/* Levenshtein's distance: letters to put in, take out or change. */
static size_t distance(const char *a, const char *b) {
  size_t row[NAME_BYTES + 1];
  const size_t length = strlen(b) < NAME_BYTES ? strlen(b) : NAME_BYTES;
  for (size_t j = 0; j <= length; j++) row[j] = j;
  for (size_t i = 0; a[i] != 0; i++) {
    size_t corner = row[0];
    row[0] = i + 1;
    for (size_t j = 1; j <= length; j++) {
      const size_t change = corner + (plain(a[i]) != plain(b[j - 1]));
      const size_t shift = (row[j] < row[j - 1] ? row[j] : row[j - 1]) + 1;
      corner = row[j];
      row[j] = change < shift ? change : shift;
    }
  }
  return row[length];
}

const char *args_nearest(const char *name, const char *const *names, size_t count) {
  const char *best = NULL;
  size_t least = (strlen(name) + 1) / 3 + 1;
  for (size_t i = 0; i < count; i++) {
    const size_t edits = distance(name, names[i]);
    if (edits >= least) continue;
    least = edits;
    best = names[i];
  }
  return best;
}

/* Puts the option name nearest to `name`, with its dashes, into `text`; "": none is near. */
static void nearest_option(const struct args *args, const char *name, char text[NAME_BYTES + 2]) {
  enum { NAMES = 256 };
  char copies[NAMES][NAME_BYTES];
  const char *names[NAMES];
  size_t count = 0;
  for (int g = 0; g < ARGS_GROUPS; g++)
    for (size_t i = 0; i < args->groups[g].count; i++) {
      const struct option *option = &args->groups[g].options[i];
      if (option->seldom && !option->published) continue;
      if (count < NAMES) names[count++] = option->name;
      for (const char *at = option->alias; at != NULL && *at != 0 && count < NAMES;) {
        const size_t bytes = strcspn(at, " ");
        snprintf(copies[count], NAME_BYTES, "%.*s", (int)bytes, at);
        names[count] = copies[count];
        count++;
        at += bytes + strspn(at + bytes, " ");
      }
    }
  const char *nearest = args_nearest(name, names, count);
  snprintf(text, NAME_BYTES + 2, "%s%s", nearest != NULL ? option_dashes(nearest) : "", nearest != NULL ? nearest : "");
}

static int refuse_unknown(const struct args *args, const char *word, size_t length) {
  char name[NAME_BYTES], nearest[NAME_BYTES + 2];
  snprintf(name, sizeof name, "%.*s", (int)length, word + strspn(word, "-"));
  const int bytes = (int)(length + strspn(word, "-"));
  const char *answer = args->public_names ? public_option(name, strlen(name)) : NULL;
  if (answer != NULL) return args_refuse(args, "%.*s %s", bytes, word, answer);
  const struct option *seldom = find_option(args, name, strlen(name));
  if (seldom != NULL && seldom->seldom) return args_refuse(args, "%.*s is --set %s=VALUE", bytes, word, seldom->name);
  size_t index;
  const ern_setting *setting = args->settings != NULL ? setting_find(args->settings, name, &index) : NULL;
  if (setting != NULL && setting_is_offered(args->settings, setting))
    return args_refuse(args, "%.*s is --set %s=VALUE", bytes, word, setting_option_name(setting->name, name));
  nearest_option(args, name, nearest);
  return args_refuse(args, "unknown option %.*s%s%s", bytes, word, nearest[0] != 0 ? ", the nearest is " : "", nearest);
}

/* ---- values ------------------------------------------------------------------------------------------------------ */

static int refuse_value(const struct args *args, const struct option *option, const char *found, const char *expected) {
  char text[NAME_BYTES + 8];
  return args_refuse(args, "%s is \"%s\", expected %s", written(option, text), found, expected);
}

/* The allowed range of a number, as text. */
static const char *limits(const struct option *option, const char *what, char text[TEXT_BYTES]) {
  if ((option->kind == OPTION_COUNT || option->kind == OPTION_FRAME) && option->high == 0)
    snprintf(text, TEXT_BYTES, "%s, %.0f or more", what, option->low);
  else
    snprintf(text, TEXT_BYTES, option->kind == OPTION_FLOAT ? "%s from %g to %g" : "%s from %.0f to %.0f", what,
             option->low, option->high);
  return text;
}

/* Whole words only: digits, nothing before or after. */
static bool read_count(const char *text, size_t length, uint64_t *value) {
  *value = 0;
  if (length == 0) return false;
  for (size_t i = 0; i < length; i++) {
    if (text[i] < '0' || text[i] > '9') return false;
    const uint64_t digit = (uint64_t)(text[i] - '0');
    if (*value > (UINT64_MAX - digit) / 10) return false;
    *value = *value * 10 + digit;
  }
  return true;
}

static int take_number(const struct args *args, struct option *option, const char *text) {
  char expected[TEXT_BYTES];
  uint64_t count = 0;
  if (option->kind == OPTION_FLOAT) {
    char *end = NULL;
    const double value = strtod(text, &end);
    if (end == text || *end != 0 || !isfinite(value) || value < option->low || value > option->high)
      return refuse_value(args, option, text, limits(option, "a number", expected));
    *(float *)option->target = (float)value;
    return -1;
  }
  const bool minus = text[0] == '-';
  const bool read = read_count(text + minus, strlen(text + minus), &count);
  const double value = minus ? -(double)count : (double)count;
  if (!read || value < option->low || (value > option->high && (option->kind == OPTION_INT || option->high != 0)))
    return refuse_value(args, option, text, limits(option, "a whole number", expected));
  if (option->kind == OPTION_INT)
    *(int *)option->target = (int)value;
  else
    *(uint64_t *)option->target = count;
  return -1;
}

static int take_bytes(const struct args *args, struct option *option, const char *text) {
  static const char units[] = "kmgt";
  const size_t digits = strspn(text, "0123456789");
  const char *unit = text[digits] != 0 ? strchr(units, tolower((unsigned char)text[digits])) : NULL;
  const int shift = unit != NULL ? 10 * (int)(unit - units + 1) : 0;
  uint64_t count = 0;
  const bool read = read_count(text, digits, &count) && text[digits + (unit != NULL)] == 0;
  if (!read || count == 0 || count > UINT64_MAX >> shift)
    return refuse_value(args, option, text, "a number of bytes such as 800000000, 512M or 4G");
  *(uint64_t *)option->target = count << shift;
  return -1;
}

static int take_seconds(const struct args *args, struct option *option, const char *text) {
  static const struct {
    const char *unit;
    double seconds;
  } units[] = {{"", 1}, {"s", 1}, {"m", 60}, {"h", 3600}};
  const size_t digits = strspn(text, "0123456789.");
  char number[32], *end = NULL;
  double seconds = NAN;
  snprintf(number, sizeof number, "%.*s", (int)digits, text);
  for (size_t k = 0; k < sizeof units / sizeof *units; k++)
    if (strcmp(text + digits, units[k].unit) == 0) seconds = strtod(number, &end) * units[k].seconds;
  if (digits == 0 || digits >= sizeof number || end == NULL || *end != 0 ||
      !(seconds >= option->low && seconds <= option->high)) {
    char expected[TEXT_BYTES];
    snprintf(expected, sizeof expected, "a time such as 90s, 10m or 1.5h, from %gs to %.0fs", option->low,
             option->high);
    return refuse_value(args, option, text, expected);
  }
  *(double *)option->target = seconds;
  return -1;
}

static int take_choice(const struct args *args, struct option *option, const char *text) {
  char expected[TEXT_BYTES];
  int index = 0;
  for (const char *at = option->choices; *at != 0; index++) {
    const size_t bytes = strcspn(at, "|");
    if (strlen(text) == bytes && strncmp(text, at, bytes) == 0) {
      *(int *)option->target = index;
      return -1;
    }
    at += bytes + (at[bytes] == '|');
  }
  snprintf(expected, sizeof expected, "one of %s", option->choices);
  return refuse_value(args, option, text, expected);
}

static int take_range(const struct args *args, struct option *option, const char *text) {
  struct range *range = option->target;
  const char *colon = strchr(text, ':');
  *range = (struct range){0};
  bool read = colon != NULL && (colon == text || read_count(text, (size_t)(colon - text), &range->begin));
  if (read) {
    const bool last = strcmp(colon + 1, "-1") == 0 && option->kind == OPTION_RANGE_PAIR;
    range->open_end = colon[1] == 0 || last;
    read = range->open_end || read_count(colon + 1, strlen(colon + 1), &range->end);
  }
  if (!read || (!range->open_end && range->begin >= range->end))
    return refuse_value(args, option, text, "A:B with 0 <= A < B; A or B may be left out");
  return -1;
}

static int take_dimensions(const struct args *args, struct option *option, const char *text) {
  struct dimensions *size = option->target;
  const size_t digits = strspn(text, "0123456789");
  uint64_t width = 0, height = 0;
  const bool read = read_count(text, digits, &width) && tolower((unsigned char)text[digits]) == 'x' &&
                    read_count(text + digits + 1, strlen(text + digits + 1), &height);
  const double low = option->low, high = option->high;
  if (!read || (double)width < low || (double)width > high || (double)height < low || (double)height > high) {
    char expected[TEXT_BYTES];
    snprintf(expected, sizeof expected, "WxH in pixels, each from %.0f to %.0f, such as 512x512", low, high);
    return refuse_value(args, option, text, expected);
  }
  *size = (struct dimensions){.width = (int)width, .height = (int)height};
  return -1;
}

static int take_pair(const struct args *args, struct option *option, const char *text) {
  struct pair *pair = option->target;
  char expected[TEXT_BYTES], *comma = NULL, *end = NULL;
  const double first = strtod(text, &comma), second = *comma == ',' ? strtod(comma + 1, &end) : 0;
  const bool read = comma != text && *comma == ',' && end != comma + 1 && *end == 0;
  if (!read || !(fmin(first, second) >= option->low && fmax(first, second) <= option->high) || isnan(first + second)) {
    snprintf(expected, sizeof expected, "two numbers A,B from %g to %g", option->low, option->high);
    return refuse_value(args, option, text, expected);
  }
  *pair = (struct pair){(float)first, (float)second};
  return -1;
}

static int take_rate(const struct args *args, struct option *option, const char *text) {
  if (rate_read(text, option->target)) return -1;
  return refuse_value(args, option, text, "frames a second from 1 to 240, such as 30, 29.97, 12.5 or 24000/1001");
}

/* The value of setting number `index`; `shown`: the option, for messages. */
static int take_setting_value(const struct args *args, struct setting_choice *choice, size_t index, const char *shown,
                              const char *text) {
  const ern_setting *setting = choice->row(index);
  char expected[TEXT_BYTES];
  if (ern_setting_read(setting, text, choice->config)) {
    choice->given |= UINT64_C(1) << index;
    return -1;
  }
  ern_setting_expected(setting, expected, sizeof expected);
  const char *zero = setting->help != NULL ? strstr(setting->help, "0: ") : NULL; /* what 0 means: to the end */
  while (zero != NULL && zero > setting->help && *zero != ';') zero--;
  return args_refuse(args, "%s is \"%s\", expected %s%s", shown, text, expected, zero != NULL ? zero : "");
}

static int take_setting(const struct args *args, struct option *option, const char *text) {
  char name[NAME_BYTES + 8];
  size_t index = 0;
  (void)setting_find(option->target, option->setting, &index);
  return take_setting_value(args, option->target, index, written(option, name), text);
}

static int take_list(const struct args *args, struct option *option, const char *text) {
  struct text_list *list = option->target;
  if (list->count == TEXT_LIST) return args_refuse(args, "--%s is given more than %d times", option->name, TEXT_LIST);
  list->text[list->count++] = text;
  return -1;
}

static bool ends_in(const char *text, const char *ending) {
  const size_t bytes = strlen(text), tail = strlen(ending);
  return bytes > tail && strcmp(text + bytes - tail, ending) == 0;
}

static int take_value(const struct args *args, struct option *option, const char *text) {
  switch (option->kind) {
    case OPTION_INT:
    case OPTION_COUNT:
    case OPTION_FRAME:
    case OPTION_FLOAT: return take_number(args, option, text);
    case OPTION_BYTES: return take_bytes(args, option, text);
    case OPTION_SECONDS: return take_seconds(args, option, text);
    case OPTION_CHOICE: return take_choice(args, option, text);
    case OPTION_RANGE:
    case OPTION_RANGE_PAIR: return take_range(args, option, text);
    case OPTION_DIMENSIONS: return take_dimensions(args, option, text);
    case OPTION_RATE: return take_rate(args, option, text);
    case OPTION_PAIR: return take_pair(args, option, text);
    case OPTION_SETTING: return take_setting(args, option, text);
    case OPTION_LIST: return take_list(args, option, text);
    case OPTION_JSON:
      if (strcmp(text, "-") != 0 && !ends_in(text, ".json"))
        return refuse_value(args, option, text, "- or a name that ends in .json");
      *(const char **)option->target = text;
      return -1;
    default:
      if (text[0] == 0) return refuse_value(args, option, text, "a value");
      *(const char **)option->target = text;
      return -1;
  }
}

/* ---- an option --------------------------------------------------------------------------------------------------- */

/* Takes the option in argv[0] and its values; *used: number of arguments taken. `value`: the text after '='. */
static int take_option(const struct args *args, struct option *option, const char *value, int argc, char **argv,
                       int *used) {
  const bool again = option->given;
  char name[NAME_BYTES + 8];
  *used = 1;
  option->given = true;
  if (option->kind == OPTION_FLAG || option->kind == OPTION_OFF) {
    if (value != NULL) return refuse_value(args, option, value, "nothing: it is a switch");
    *(bool *)option->target = option->kind == OPTION_FLAG;
    return -1;
  }
  if (option->kind == OPTION_FRAME && value == NULL) {
    const bool takes = argc > 1 && argv[1][0] != 0 && argv[1][strspn(argv[1], "0123456789")] == 0;
    *used += takes;
    return take_value(args, option, takes ? argv[1] : "0");
  }
  if (option->kind == OPTION_JSON && value == NULL) {
    const bool takes = argc > 1 && (strcmp(argv[1], "-") == 0 || (argv[1][0] != '-' && ends_in(argv[1], ".json")));
    *used += takes;
    return take_value(args, option, takes ? argv[1] : "-");
  }
  if (value == NULL) {
    if (argc < 2 || strncmp(argv[1], "--", 2) == 0)
      return args_refuse(args, "%s%s needs a value", option_dashes(option->name), option->name);
    value = argv[1];
    *used = 2;
  }
  if (again && option->kind == OPTION_TEXT && strcmp(value, *(const char **)option->target) != 0)
    return args_refuse(args, "%s is given twice, as \"%s\" and as \"%s\"", written(option, name),
                       *(const char **)option->target, value);
  if (option->kind == OPTION_RANGE_PAIR && strchr(value, ':') == NULL && argc > *used) {
    char pair[TEXT_BYTES];
    if (snprintf(pair, sizeof pair, "%s:%s", value, argv[*used]) < (int)sizeof pair) {
      *used += 1;
      return take_value(args, option, pair);
    }
  }
  return take_value(args, option, value);
}

/* ---- --set ------------------------------------------------------------------------------------------------------- */

static int refuse_set(const struct args *args, const char *name) {
  enum { NAMES = 128 };
  char copies[NAMES][SETTING_NAME_BYTES];
  const char *names[NAMES];
  const ern_setting *setting;
  size_t count = 0;
  for (int g = 0; g < ARGS_GROUPS; g++)
    for (size_t i = 0; i < args->groups[g].count; i++) {
      const struct option *option = &args->groups[g].options[i];
      if (option->seldom && !option->unlisted && count < NAMES) names[count++] = option->name;
    }
  for (size_t i = 0; args->settings != NULL && (setting = args->settings->row(i)) != NULL && count < NAMES; i++)
    if (setting_is_offered(args->settings, setting))
      names[count] = setting_option_name(setting->name, copies[count]), count++;
  const char *nearest = args_nearest(name, names, count);
  return args_refuse(args, "--set %s: there is no such setting%s%s; --set help lists them", name,
                     nearest != NULL ? ", the nearest is " : "", nearest != NULL ? nearest : "");
}

static int take_switch(const struct args *args, struct option *option, const char *text) {
  const bool yes = strcmp(text, "yes") == 0;
  if (!yes && strcmp(text, "no") != 0) return refuse_value(args, option, text, "yes or no");
  option->given = true;
  *(bool *)option->target = yes == (option->kind == OPTION_FLAG);
  return -1;
}

/* NAME=VALUE, or `help`. */
static int take_set(const struct args *args, const char *text) {
  struct setting_choice *choice = args->settings;
  const size_t length = strcspn(text, "=");
  char name[NAME_BYTES], shown[NAME_BYTES + 8];
  size_t index = 0;
  if (strcmp(text, "help") == 0) {
    help_settings(args);
    return EXIT_SUCCESS;
  }
  if (text[length] == 0 || length == 0 || length >= NAME_BYTES)
    return args_refuse(args, "--set is \"%s\", expected NAME=VALUE; --set help lists the names", text);
  snprintf(name, sizeof name, "%.*s", (int)length, text);
  struct option *option = find_option(args, name, length);
  if (option != NULL && option->seldom && !option->unlisted) {
    const bool is_switch = option->kind == OPTION_FLAG || option->kind == OPTION_OFF;
    int used;
    text += length + 1;
    return is_switch ? take_switch(args, option, text) : take_option(args, option, text, 1, NULL, &used);
  }
  const ern_setting *setting = choice != NULL ? setting_find(choice, name, &index) : NULL;
  if (setting == NULL || !setting_is_offered(choice, setting)) return refuse_set(args, name);
  snprintf(shown, sizeof shown, "--set %s", setting_option_name(setting->name, name));
  return take_setting_value(args, choice, index, shown, text + length + 1);
}

/* The VALUE of --set VALUE or --set=VALUE; *used: number of arguments taken. NULL: the argument is another. */
static const char *value_of_set(const struct args *args, int argc, char **argv, int *used) {
  if (!option_takes_set(args)) return NULL;
  if (strncmp(argv[0], "--set=", 6) == 0) return argv[0] + 6;
  if (strcmp(argv[0], "--set") != 0) return NULL;
  *used = argc > 1 ? 2 : 1;
  return argc > 1 ? argv[1] : "";
}

/* ---- the line ---------------------------------------------------------------------------------------------------- */

/* The option of the argument "--NAME", "--NAME=VALUE", "-N", "-N=VALUE" or "-NVALUE"; *length: letters of its name;
 * *value stays NULL if the argument has none. Returns NULL for an unknown name. */
static struct option *split_option(const struct args *args, const char *word, size_t *length, const char **value) {
  const size_t dashes = word[1] == '-' ? 2 : 1;
  *length = strcspn(word + dashes, "=");
  struct option *option = find_option(args, word + dashes, *length);
  if (word[dashes + *length] == '=') *value = word + dashes + *length + 1;
  if (option != NULL && option->seldom && !option->published) return NULL;
  if (dashes == 2) return *length > 1 ? option : NULL; /* one letter has one dash */
  if (*length == 1) return option;
  if (option != NULL) return NULL; /* "-output" lacks a dash: it is not -o with the value "utput" */
  option = find_option(args, word + 1, 1);
  if (option == NULL || option->kind == OPTION_FLAG || option->kind == OPTION_OFF) return NULL;
  *value = word + 2;
  *length = 1;
  return option;
}

int args_parse(struct args *args, int argc, char **argv) {
  size_t words = 0;
  bool options_end = false;
  for (int i = 0; i < argc; i++)
    if (help_asked(args, argv[i])) return EXIT_SUCCESS;
  for (int i = 0, used = 1; i < argc; i += used) {
    const char *word = argv[i];
    used = 1;
    if (!options_end && strcmp(word, "--") == 0) {
      options_end = true;
    } else if (!options_end && word[0] == '-' && word[1] != 0) {
      const char *value = NULL, *set = value_of_set(args, argc - i, argv + i, &used);
      size_t length = 0;
      struct option *option = set != NULL ? NULL : split_option(args, word, &length, &value);
      if (set == NULL && option == NULL) return refuse_unknown(args, word, length);
      const int status =
          set != NULL ? take_set(args, set) : take_option(args, option, value, argc - i, argv + i, &used);
      if (status >= 0) return status;
    } else if (words < args->word_count && word[0] != 0) {
      *args->words[words++].target = word;
    } else {
      return args_refuse(args, "unexpected argument \"%s\", expected %zu at most (besides options)", word,
                         args->word_count);
    }
  }
  if (words + args->optional_words < args->word_count)
    return args_refuse(args, "%s is missing", args->words[words].name);
  return -1;
}
