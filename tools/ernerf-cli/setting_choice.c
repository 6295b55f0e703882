/* SPDX-License-Identifier: MIT */
#include "setting_choice.h"

#include <assert.h>
#include <string.h>

const char *setting_option_name(const char *member, char text[SETTING_NAME_BYTES]) {
  size_t at = 0;
  for (; member[at] != 0 && at + 1 < SETTING_NAME_BYTES; at++) text[at] = member[at] == '_' ? '-' : member[at];
  text[at] = 0;
  return text;
}

const ern_setting *setting_find(const struct setting_choice *choice, const char *name, size_t *index) {
  const ern_setting *s;
  for (*index = 0; (s = choice->row(*index)) != NULL; (*index)++) {
    size_t at = 0;
    while (name[at] != 0 && (name[at] == '-' ? '_' : name[at]) == s->name[at]) at++;
    if (name[at] == 0 && s->name[at] == 0) return s;
  }
  return NULL;
}

bool setting_is_offered(const struct setting_choice *choice, const ern_setting *s) {
  const size_t bytes = strlen(s->name);
  for (const char *at = choice->elsewhere; *at != 0; at += strspn(at, " ")) {
    const size_t word = strcspn(at, " ");
    if (word == bytes && strncmp(at, s->name, bytes) == 0) return false;
    at += word;
  }
  return s->help != NULL;
}

bool setting_given(const struct setting_choice *choice, const char *name) {
  size_t index;
  const ern_setting *s = setting_find(choice, name, &index);
  assert(s != NULL && index < 64);
  return s != NULL && (choice->given >> index & 1) != 0;
}
