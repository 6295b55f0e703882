/* SPDX-License-Identifier: MIT */
#include "manual.h"

#include <ctype.h>
#include <stdio.h>
#include <string.h>

#include "ernerf/base.h"
#include "option_words.h"

/* Prints text escaped for troff, on one line: newlines become spaces. */
static void print_text(const char *text, size_t bytes) {
  for (size_t i = 0; i < bytes; i++) {
    const bool begins = i == 0 || text[i - 1] == '\n';
    if (begins && (text[i] == '.' || text[i] == '\'')) fputs("\\&", stdout); /* else troff reads a macro */
    if (text[i] == '\\')
      fputs("\\e", stdout);
    else if (text[i] == '-')
      fputs("\\-", stdout);
    else
      putchar(text[i]);
  }
}

static void print_all(const char *text) { print_text(text, strlen(text)); }

/* Prints paragraphs, which empty lines separate. */
static void print_paragraphs(const char *text) {
  for (const char *at = text; *at != 0;) {
    const char *end = strstr(at, "\n\n");
    const size_t bytes = end != NULL ? (size_t)(end - at) : strlen(at);
    if (at != text) printf(".PP\n");
    print_text(at, bytes);
    printf("\n");
    at += bytes + (end != NULL ? 2 : 0);
  }
}

static void print_head(const char *verb, const char *summary) {
  printf(".TH ERNERF");
  if (verb != NULL) printf("\\-");
  for (const char *at = verb; at != NULL && *at != 0; at++) putchar(toupper((unsigned char)*at));
  printf(" 1 \"\" \"libernerf %s\" \"User Commands\"\n.SH NAME\nernerf%s%s \\- ", ern_version(),
         verb != NULL ? "\\-" : "", verb != NULL ? verb : "");
  print_all(summary);
  printf("\n");
}

static void print_usage(const char *usage) {
  printf(".SH SYNOPSIS\n.nf\n");
  for (const char *at = usage; *at != 0;) {
    const size_t bytes = strcspn(at, "\n");
    printf("\\fBernerf\\fR ");
    print_text(at, bytes);
    printf("\n");
    at += bytes + (at[bytes] == '\n');
  }
  printf(".fi\n");
}

static void print_option(const struct option *option) {
  char text[HELP_BYTES];
  printf(".TP\n\\fB");
  print_all(option_dashes(option->name));
  print_all(option->name);
  printf("\\fR");
  for (const char *at = option->alias; at != NULL && *at != 0;) {
    const size_t bytes = strcspn(at, " ");
    printf(", \\fB");
    print_all(bytes == 1 ? "-" : "--");
    print_text(at, bytes);
    printf("\\fR");
    at += bytes + strspn(at + bytes, " ");
  }
  if (option_value(option) != NULL) {
    printf(" \\fI");
    print_all(option_value(option));
    printf("\\fR");
  }
  printf("\n");
  print_all(option_text(option, text));
  printf("\n");
}

void manual_print(const struct args *args) {
  print_head(args->verb, args->summary);
  print_usage(args->usage);
  if (args->word_count > 0) printf(".SH ARGUMENTS\n");
  for (size_t i = 0; i < args->word_count; i++) {
    printf(".TP\n\\fI");
    print_all(args->words[i].name);
    printf("\\fR\n");
    print_all(args->words[i].help);
    printf("\n");
  }
  printf(".SH OPTIONS\n");
  for (int g = 0; g < ARGS_GROUPS; g++) {
    if (args->groups[g].title == NULL) continue;
    printf(".SS ");
    print_all(args->groups[g].title);
    printf("\n");
    for (size_t i = 0; i < args->groups[g].count; i++)
      if (option_is_listed(&args->groups[g].options[i])) print_option(&args->groups[g].options[i]);
  }
  if (option_takes_set(args)) {
    printf(".SS More:\n.TP\n\\fB\\-\\-set\\fR \\fINAME=VALUE\\fR\n");
    print_all(OPTION_SET_HELP);
    printf("\n");
  }
  if (args->notes != NULL) {
    printf(".SH NOTES\n");
    print_paragraphs(args->notes);
  }
  printf(".SH SEE ALSO\n.BR ernerf (1),\n.BR ernerf\\-formats (5)\n");
}

void manual_print_program(const char *summary, const struct verb *verbs, size_t count, const char *end) {
  print_head(NULL, summary);
  print_usage("VERB ...");
  printf(".SH VERBS\n");
  for (size_t i = 0; i < count; i++) {
    printf(".TP\n\\fB%s\\fR\n", verbs[i].name);
    print_all(verbs[i].help);
    printf("\n");
  }
  printf(".SH NOTES\n");
  print_paragraphs(end);
  printf(".SH SEE ALSO\n");
  for (size_t i = 0; i < count; i++) printf(".BR ernerf\\-%s (1),\n", verbs[i].name);
  printf(".BR ernerf\\-formats (5)\n");
}
