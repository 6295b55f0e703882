/* SPDX-License-Identifier: MIT */
#include "help.h"

#include <stdio.h>
#include <string.h>

#include "completion.h"
#include "manual.h"
#include "option_words.h"
#include "setting_choice.h"

enum { TEXT_BYTES = 256 };

enum { HELP_COLUMN = 34, HELP_WIDTH = 100 };

/* Prints text from column HELP_COLUMN on, wrapped at HELP_WIDTH; `column`: the current column. */
static void print_wrapped(int column, const char *text) {
  if (column >= HELP_COLUMN) {
    printf("\n");
    column = 0;
  }
  printf("%*s", HELP_COLUMN - column, "");
  column = HELP_COLUMN;
  while (*text != 0) {
    const int bytes = (int)strcspn(text, " ");
    if (column > HELP_COLUMN && column + 1 + bytes > HELP_WIDTH) {
      printf("\n%*s", HELP_COLUMN, "");
      column = HELP_COLUMN;
    }
    column += printf(column > HELP_COLUMN ? " %.*s" : "%.*s", bytes, text);
    text += bytes;
    text += strspn(text, " ");
  }
  printf("\n");
}

static void print_option(const struct option *option) {
  char aliases[TEXT_BYTES] = "";
  size_t used = 0;
  for (const char *at = option->alias; at != NULL && *at != 0;) {
    const size_t bytes = strcspn(at, " ");
    used +=
        (size_t)snprintf(aliases + used, sizeof aliases - used, ", %s%.*s", bytes == 1 ? "-" : "--", (int)bytes, at);
    at += bytes + strspn(at + bytes, " ");
  }
  const char *value = option_value(option);
  const int column = printf("  %s%s%s%s%s", option_dashes(option->name), option->name, aliases,
                            value != NULL ? " " : "", value != NULL ? value : "");
  char text[HELP_BYTES];
  print_wrapped(column, option_text(option, text));
}

static bool in_group(const ern_setting *s, const char *group) {
  return s->group == group || (s->group != NULL && group != NULL && strcmp(s->group, group) == 0);
}

/* Whether row(index) is offered, and no offered row before it is of its group. */
static bool is_first_of_group(const struct setting_choice *choice, size_t index) {
  for (size_t i = 0; i < index; i++)
    if (setting_is_offered(choice, choice->row(i)) && in_group(choice->row(i), choice->row(index)->group)) return false;
  return setting_is_offered(choice, choice->row(index));
}

static void print_group(const struct setting_choice *choice, const char *group) {
  char text[HELP_BYTES], expected[TEXT_BYTES], preset[ERN_SETTING_TEXT_BYTES], name[SETTING_NAME_BYTES];
  const ern_setting *s;
  if (group != NULL) printf("%s:\n", group);
  for (size_t i = 0; (s = choice->row(i)) != NULL; i++) {
    if (!setting_is_offered(choice, s) || !in_group(s, group)) continue;
    ern_setting_expected(s, expected, sizeof expected);
    ern_setting_write(s, choice->config, preset);
    snprintf(text, sizeof text, "%s; %s (default %s)", s->help, expected, preset);
    print_wrapped(printf("  %s", setting_option_name(s->name, name)), text);
  }
}

void help_settings(const struct args *args) {
  char text[HELP_BYTES];
  const struct setting_choice *choice = args->settings;
  const ern_setting *s;
  for (int g = 0; g < ARGS_GROUPS; g++)
    for (size_t i = 0; i < args->groups[g].count; i++) {
      const struct option *option = &args->groups[g].options[i];
      if (!option->seldom || option->unlisted) continue;
      const char *value = option_value(option);
      const int column = printf("  %s=%s", option->name, value != NULL ? value : "yes|no");
      print_wrapped(column, option_text(option, text));
    }
  for (size_t i = 0; choice != NULL && (s = choice->row(i)) != NULL; i++)
    if (is_first_of_group(choice, i)) print_group(choice, s->group);
}

static void print_help(const struct args *args) {
  printf("%s\n\n", args->summary);
  for (const char *at = args->usage; *at != 0;) {
    const size_t bytes = strcspn(at, "\n");
    printf("  ernerf %.*s\n", (int)bytes, at);
    at += bytes + (at[bytes] == '\n');
  }
  printf("\n");
  for (size_t i = 0; i < args->word_count; i++) print_wrapped(printf("  %s", args->words[i].name), args->words[i].help);
  for (int g = 0; g < ARGS_GROUPS; g++) {
    if (args->groups[g].title == NULL) continue;
    printf("\n%s\n", args->groups[g].title);
    for (size_t i = 0; i < args->groups[g].count; i++)
      if (option_is_listed(&args->groups[g].options[i])) print_option(&args->groups[g].options[i]);
  }
  if (option_takes_set(args)) {
    printf("\nMore:\n");
    print_wrapped(printf("  --set NAME=VALUE"), OPTION_SET_HELP);
  }
  if (args->notes != NULL) printf("\n%s\n", args->notes);
}

bool help_asked(const struct args *args, const char *word) {
  if (strcmp(word, "--help") == 0 || strcmp(word, "-h") == 0)
    print_help(args);
  else if (strcmp(word, "--help=man") == 0)
    manual_print(args);
  else if (strcmp(word, "--help=bash") == 0)
    completion_print_bash(args);
  else if (strcmp(word, "--help=zsh") == 0)
    completion_print_zsh(args);
  else
    return false;
  return true;
}
