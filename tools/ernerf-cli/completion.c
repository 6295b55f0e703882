/* SPDX-License-Identifier: MIT */
#include "completion.h"

#include <stdio.h>

#include "option_words.h"

/* Calls `print` for each name of an option, with its dashes. */
static void each_name(const struct option *option, const char *format) {
  char name[64];
  snprintf(name, sizeof name, "%s%s", option_dashes(option->name), option->name);
  printf(format, name);
  for (const char *at = option->alias; at != NULL && *at != 0;) {
    const int bytes = (int)strcspn(at, " ");
    snprintf(name, sizeof name, "%s%.*s", bytes == 1 ? "-" : "--", bytes, at);
    printf(format, name);
    at += bytes + (int)strspn(at + bytes, " ");
  }
}

static bool is_choice(const struct option *option) { return option->kind == OPTION_CHOICE; }

/* "contain|cover" as "contain cover". */
static void print_choices(const char *choices) {
  for (const char *at = choices; *at != 0; at++) putchar(*at == '|' ? ' ' : *at);
}

typedef void option_printer(const struct option *option);

static void each_option(const struct args *args, option_printer *print) {
  for (int g = 0; g < ARGS_GROUPS; g++)
    for (size_t i = 0; i < args->groups[g].count; i++)
      if (option_is_listed(&args->groups[g].options[i])) print(&args->groups[g].options[i]);
  const struct option set = {.name = "set", .kind = OPTION_RANGE, .choices = "NAME=VALUE", .help = OPTION_SET_HELP};
  if (option_takes_set(args)) print(&set);
}

/* ---- bash -------------------------------------------------------------------------------------------------------- */

void completion_begin_bash(const struct verb *verbs, size_t count) {
  printf(
      "# bash completion of ernerf\n"
      "_ernerf() {\n"
      "  local current=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD - 1]} options='--help' values=\n"
      "  if [ \"$COMP_CWORD\" -eq 1 ]; then\n"
      "    options='");
  for (size_t i = 0; i < count; i++) printf("%s ", verbs[i].name);
  printf(
      "help --help --version'\n"
      "    COMPREPLY=($(compgen -W \"$options\" -- \"$current\"))\n"
      "    return\n"
      "  fi\n"
      "  case ${COMP_WORDS[1]} in\n");
}

static void print_bash_names(const struct option *option) { each_name(option, " %s"); }

static void print_bash_pattern(const struct option *option) {
  if (!is_choice(option)) return;
  printf("    %s%s", option_dashes(option->name), option->name);
  for (const char *at = option->alias; at != NULL && *at != 0;) {
    const int bytes = (int)strcspn(at, " ");
    printf(" | %s%.*s", bytes == 1 ? "-" : "--", bytes, at);
    at += bytes + (int)strspn(at + bytes, " ");
  }
  printf(") values='");
  print_choices(option->choices);
  printf("' ;;\n");
}

void completion_print_bash(const struct args *args) {
  printf("  %s)\n    options+='", args->verb);
  each_option(args, print_bash_names);
  printf("'\n    case $before in\n");
  each_option(args, print_bash_pattern);
  printf("    esac\n    ;;\n");
}

void completion_end_bash(void) {
  printf(
      "  esac\n"
      "  if [ -n \"$values\" ]; then\n"
      "    COMPREPLY=($(compgen -W \"$values\" -- \"$current\"))\n"
      "  elif [[ $current == -* ]]; then\n"
      "    COMPREPLY=($(compgen -W \"$options\" -- \"$current\"))\n"
      "  fi\n"
      "} # else files\n"
      "complete -o default -F _ernerf ernerf\n");
}

/* ---- zsh --------------------------------------------------------------------------------------------------------- */

/* Prints text escaped for single quotes of the shell, inside a specification of _arguments or _describe. */
static void print_zsh(const char *text) {
  for (; *text != 0; text++) {
    if (*text == '\'') fputs("'\\'", stdout);
    if (strchr("[]:\\", *text) != NULL) putchar('\\');
    putchar(*text);
  }
}

void completion_begin_zsh(const struct verb *verbs, size_t count) {
  printf("#compdef ernerf\n_ernerf() {\n  local -a verbs=(\n");
  for (size_t i = 0; i < count; i++) {
    printf("    '%s:", verbs[i].name);
    print_zsh(verbs[i].help);
    printf("'\n");
  }
  printf(
      "  )\n"
      "  if (( CURRENT == 2 )); then\n"
      "    _describe verb verbs\n"
      "    return\n"
      "  fi\n"
      "  shift words\n"
      "  (( CURRENT-- ))\n"
      "  case $words[1] in\n");
}

static void print_zsh_option(const struct option *option) {
  char text[HELP_BYTES];
  const char *value = option_value(option);
  const bool file = option->kind == OPTION_TEXT || option->kind == OPTION_JSON;
  for (const char *at = option->name, *rest = option->alias; at != NULL;) {
    const int bytes = (int)strcspn(at, " ");
    printf(" \\\n      '%s%.*s[", bytes == 1 ? "-" : "--", bytes, at);
    print_zsh(option_text(option, text));
    printf("]");
    if (value != NULL) {
      printf(":");
      print_zsh(value);
      printf(":");
      if (is_choice(option)) {
        printf("(");
        print_choices(option->choices);
        printf(")");
      } else {
        printf(file ? "_files" : " ");
      }
    }
    printf("'");
    at = at == option->name ? rest : at + bytes + (int)strspn(at + bytes, " ");
    if (at != NULL && *at == 0) at = NULL;
  }
}

void completion_print_zsh(const struct args *args) {
  printf("  %s)\n    _arguments '--help[tell the options]'", args->verb);
  each_option(args, print_zsh_option);
  printf(" \\\n      '*:file:_files'\n    ;;\n");
}

void completion_end_zsh(void) { printf("  esac\n}\n_ernerf \"$@\"\n"); }
