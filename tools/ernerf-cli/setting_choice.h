/* SPDX-License-Identifier: MIT
 * The settings of a configuration (ernerf/setting.h) that are chosen on the command line: --set NAME=VALUE, and options
 * of their own. */
#ifndef ERN_CLI_SETTING_CHOICE_H
#define ERN_CLI_SETTING_CHOICE_H

#include "ernerf/setting.h"

struct setting_choice {
  void *config;
  const ern_setting *(*row)(size_t index); /* of at most 64 */
  const char *elsewhere; /* names, separated by spaces, that --set does not take: another option decides */
  uint64_t given;        /* bit i: row(i) was on the command line */
};

/* The member's name with hyphens, as the command line has it. */
enum { SETTING_NAME_BYTES = 64 };
const char *setting_option_name(const char *member, char text[SETTING_NAME_BYTES]);

/* The row of that name, written with dashes or underscores, and its number; NULL: none. */
const ern_setting *setting_find(const struct setting_choice *choice, const char *name, size_t *index);

/* Whether --set takes it. */
bool setting_is_offered(const struct setting_choice *choice, const ern_setting *setting);

/* Whether the member was on the command line. `name` must be in the table. */
bool setting_given(const struct setting_choice *choice, const char *name);

#endif
