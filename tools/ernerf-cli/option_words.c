/* SPDX-License-Identifier: MIT */
#include "option_words.h"

#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

#include "setting_choice.h"

enum {
  TEXT_BYTES = 256,
  MUCH = 1000000 /* bounds from here on only catch typing errors and are not shown */
};

const char *option_dashes(const char *name) { return strlen(name) == 1 ? "-" : "--"; }

bool option_is_listed(const struct option *option) { return !option->unlisted && !option->seldom; }

bool option_takes_set(const struct args *args) {
  for (int g = 0; g < ARGS_GROUPS; g++)
    for (size_t i = 0; i < args->groups[g].count; i++)
      if (args->groups[g].options[i].seldom && !args->groups[g].options[i].unlisted) return true;
  return args->settings != NULL;
}

static const ern_setting *setting_of(const struct option *option) {
  size_t index;
  return setting_find(option->target, option->setting, &index);
}

static const char *help_of(const struct option *option) {
  return option->help != NULL ? option->help : setting_of(option)->help;
}

const char *option_value(const struct option *option) {
  if (option->choices != NULL) return option->choices;
  if (option->kind == OPTION_SETTING) {
    const ern_setting *setting = setting_of(option);
    const bool real = setting->type == ERN_SETTING_FLOAT || setting->type == ERN_SETTING_DOUBLE;
    return setting->type == ERN_SETTING_WORD ? setting->words : real ? "X" : "N";
  }
  switch (option->kind) {
    case OPTION_INT:
    case OPTION_COUNT: return "N";
    case OPTION_FLOAT: return "X";
    case OPTION_LIST:
    case OPTION_TEXT: return "FILE";
    case OPTION_BYTES: return "BYTES";
    case OPTION_SECONDS: return "T";
    case OPTION_RANGE:
    case OPTION_RANGE_PAIR: return "A:B";
    case OPTION_DIMENSIONS: return "WxH";
    case OPTION_RATE: return "R";
    case OPTION_PAIR: return "A,B";
    case OPTION_FRAME: return "[N]";
    case OPTION_JSON: return "[FILE.json|-]";
    default: return NULL;
  }
}

/* The default of a number, unless the help text contains it. A default of 0 that the option would refuse means "not
 * set". */
static const char *preset_of(const struct option *option, char text[TEXT_BYTES]) {
  text[0] = 0;
  if (strstr(help_of(option), "default") != NULL) return text;
  if (option->kind == OPTION_SETTING) {
    char preset[ERN_SETTING_TEXT_BYTES];
    ern_setting_write(setting_of(option), ((struct setting_choice *)option->target)->config, preset);
    snprintf(text, TEXT_BYTES, " (default %s)", preset);
  }
  if (option->kind == OPTION_INT) snprintf(text, TEXT_BYTES, " (default %d)", *(int *)option->target);
  if (option->kind == OPTION_COUNT) snprintf(text, TEXT_BYTES, " (default %" PRIu64 ")", *(uint64_t *)option->target);
  if (option->kind == OPTION_FLOAT && !(*(float *)option->target < (float)option->low))
    snprintf(text, TEXT_BYTES, " (default %g)", (double)*(float *)option->target);
  return text;
}

/* The range of a number, unless the help text contains it. */
static const char *range_of(const struct option *option, char text[TEXT_BYTES]) {
  double low = option->low, high = option->high;
  text[0] = 0;
  switch (option->kind) {
    case OPTION_SETTING:
      if (setting_of(option)->type == ERN_SETTING_WORD) return text;
      low = setting_of(option)->least;
      high = setting_of(option)->most;
      break;
    case OPTION_INT:
    case OPTION_COUNT:
    case OPTION_FLOAT:
    case OPTION_SECONDS:
    case OPTION_DIMENSIONS:
    case OPTION_PAIR: break;
    default: return text;
  }
  const bool endless = high >= MUCH || (high == 0 && option->kind == OPTION_COUNT);
  if (endless && low == 0) return text;
  if (endless)
    snprintf(text, TEXT_BYTES, "%.10g or more", low);
  else
    snprintf(text, TEXT_BYTES, "%.10g to %.10g", low, high);
  if (strstr(help_of(option), text) != NULL) text[0] = 0;
  return text;
}

/* Range and default are printed in one pair of parentheses at the end. */
const char *option_text(const struct option *option, char text[HELP_BYTES]) {
  char preset[TEXT_BYTES], range[TEXT_BYTES];
  snprintf(text, HELP_BYTES, "%s%s", help_of(option), preset_of(option, preset));
  if (range_of(option, range)[0] == 0) return text;
  char *last = strrchr(text, '(');
  const size_t length = strlen(text);
  const bool joins = last != NULL && strncmp(last, "(default", 8) == 0 && strchr(last, ')') == text + length - 1;
  const size_t end = joins ? length - 1 : length;
  snprintf(text + end, HELP_BYTES - end, "%s%s)", joins ? "; " : " (", range);
  return text;
}
