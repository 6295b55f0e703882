/* SPDX-License-Identifier: MIT */
#include "core/setting_table.h"

#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/floats.h"
#include "core/format.h"
#include "core/status.h"

static size_t bytes_of(const ern_setting *s) {
  static const size_t bytes[] = {
      [ERN_SETTING_BOOL] = sizeof(bool),   [ERN_SETTING_INT] = sizeof(int),     [ERN_SETTING_UINT64] = 8,
      [ERN_SETTING_SIZE] = sizeof(size_t), [ERN_SETTING_FLOAT] = sizeof(float), [ERN_SETTING_DOUBLE] = sizeof(double),
      [ERN_SETTING_WORD] = sizeof(int),    [ERN_SETTING_TEXT] = sizeof(char *), [ERN_SETTING_POINTER] = sizeof(void *)};
  return bytes[s->type];
}

/* A value of any type. */
union value {
  bool flag;
  int whole;
  uint64_t count;
  size_t size;
  float real;
  double wide;
};
static union value value_of(const ern_setting *s, const void *config) {
  union value value = {0};
  memcpy(&value, (const char *)config + s->at, bytes_of(s));
  return value;
}
static double number_of(const ern_setting *s, union value value) {
  switch (s->type) {
    case ERN_SETTING_BOOL: return value.flag;
    case ERN_SETTING_INT:
    case ERN_SETTING_WORD: return value.whole;
    case ERN_SETTING_UINT64: return (double)value.count;
    case ERN_SETTING_SIZE: return (double)value.size;
    case ERN_SETTING_FLOAT: return (double)value.real;
    case ERN_SETTING_DOUBLE: return value.wide;
    case ERN_SETTING_TEXT:
    case ERN_SETTING_POINTER: break;
  }
  return 0;
}

static bool is_value(const ern_setting *s) { return s->type != ERN_SETTING_TEXT && s->type != ERN_SETTING_POINTER; }

/* A bound of a float's range is the float nearest to it. */
static bool is_within(const ern_setting *s, double number) {
  const bool is_float = s->type == ERN_SETTING_FLOAT;
  return number >= (is_float ? (double)(float)s->least : s->least) &&
         number <= (is_float ? (double)(float)s->most : s->most);
}

static void reset(const ern_setting *s, void *config) {
  union value value = {0};
  switch (s->type) {
    case ERN_SETTING_BOOL: value.flag = s->fallback != 0; break;
    case ERN_SETTING_INT:
    case ERN_SETTING_WORD: value.whole = (int)s->fallback; break;
    case ERN_SETTING_UINT64: value.count = (uint64_t)s->fallback; break;
    case ERN_SETTING_SIZE: value.size = (size_t)s->fallback; break;
    case ERN_SETTING_FLOAT: value.real = (float)s->fallback; break;
    case ERN_SETTING_DOUBLE: value.wide = s->fallback; break;
    case ERN_SETTING_TEXT:
    case ERN_SETTING_POINTER: break;
  }
  memcpy((char *)config + s->at, &value, bytes_of(s));
}

/* What the help says of 0, with the ';' before it; "" where it says nothing. */
static const char *meaning_of_0(const ern_setting *s) {
  const char *at = s->help != NULL ? strstr(s->help, "0: ") : NULL;
  while (at != NULL && at > s->help && *at != ';') at--;
  return at != NULL ? at : "";
}

static ern_status check(ern_context *context, const char *what, const ern_setting *s, const void *config) {
  if (!is_value(s) || s->type == ERN_SETTING_BOOL) return ERN_OK;
  const double found = number_of(s, value_of(s, config));
  if (is_within(s, found)) return ERN_OK;
  if (s->type == ERN_SETTING_FLOAT || s->type == ERN_SETTING_DOUBLE)
    return ern_fail(context, ERN_E_ARGUMENT, "%s: %s is %g, expected %g to %g%s", what, s->name, found, s->least,
                    s->most, meaning_of_0(s));
  const bool word = s->type == ERN_SETTING_WORD;
  return ern_fail(context, ERN_E_ARGUMENT, "%s: %s is %.0f, expected %.0f to %.0f%s%s", what, s->name, found, s->least,
                  s->most, word ? ", which are " : meaning_of_0(s), word ? s->words : "");
}

void ern_settings_reset(const ern_setting *table, size_t rows, void *config) {
  ERN_PLAIN_FLOATS;
  for (size_t i = 0; i < rows; i++) reset(&table[i], config);
}

ern_status ern_settings_check(ern_context *context, const char *what, const ern_setting *table, size_t rows,
                              const void *config) {
  ern_status status = ERN_OK;
  for (size_t i = 0; i < rows && status == ERN_OK; i++) status = check(context, what, &table[i], config);
  return status;
}

/* ---- text -------------------------------------------------------------------------------------------------------- */

/* The index of the word `text`; -1: it is none of them. */
static int index_of(const char *words, const char *text) {
  int index = 0;
  for (const char *at = words; *at != 0; index++) {
    const size_t length = strcspn(at, "|");
    if (strlen(text) == length && strncmp(text, at, length) == 0) return index;
    at += length + (at[length] == '|');
  }
  return -1;
}

static void write_word(const char *words, int index, char text[ERN_SETTING_TEXT_BYTES]) {
  const char *at = words;
  for (; index > 0 && *at != 0; index--) at += strcspn(at, "|"), at += *at == '|';
  snprintf(text, ERN_SETTING_TEXT_BYTES, "%.*s", index == 0 ? (int)strcspn(at, "|") : 0, at);
}

static bool read_count(const char *text, uint64_t *value) {
  if (text[0] == 0 || strspn(text, "0123456789") != strlen(text)) return false;
  errno = 0;
  *value = strtoull(text, NULL, 10);
  return errno == 0;
}

bool ern_setting_read(const ern_setting *s, const char *text, void *config) {
  ERN_PLAIN_FLOATS;
  union value value = {0};
  uint64_t count = 0;
  double real = 0;
  if (s == NULL || text == NULL || config == NULL || !is_value(s)) return false;
  switch (s->type) {
    case ERN_SETTING_BOOL:
      value.flag = strcmp(text, "yes") == 0;
      if (!value.flag && strcmp(text, "no") != 0) return false;
      break;
    case ERN_SETTING_WORD:
      value.whole = index_of(s->words, text);
      if (value.whole < 0) return false;
      break;
    case ERN_SETTING_INT:
      if (!read_count(text + (text[0] == '-'), &count) || count > INT32_MAX) return false;
      value.whole = text[0] == '-' ? -(int)count : (int)count;
      break;
    case ERN_SETTING_UINT64:
      if (!read_count(text, &value.count)) return false;
      break;
    case ERN_SETTING_SIZE:
      if (!read_count(text, &count) || count > SIZE_MAX) return false;
      value.size = (size_t)count;
      break;
    case ERN_SETTING_FLOAT:
    case ERN_SETTING_DOUBLE:
      if (!ern_format_read(text, &real)) return false;
      if (s->type == ERN_SETTING_FLOAT)
        value.real = (float)real;
      else
        value.wide = real;
      break;
    case ERN_SETTING_TEXT:
    case ERN_SETTING_POINTER: return false;
  }
  if (s->type != ERN_SETTING_BOOL && !is_within(s, number_of(s, value))) return false;
  memcpy((char *)config + s->at, &value, bytes_of(s));
  return true;
}

/* The fewest digits that read as the same number; of -0 those of 0, which is the same value. */
static void write_real(double value, bool wide, char text[ERN_SETTING_TEXT_BYTES]) {
  double read = 0;
  int digits = 3;
  if (value == 0) value = 0;
  do ern_format(text, ERN_SETTING_TEXT_BYTES, "%.*g", digits, value);
  while (digits++ < (wide ? 17 : 9) &&
         !(ern_format_read(text, &read) && (wide ? read == value : (float)read == (float)value)));
}

void ern_setting_write(const ern_setting *s, const void *config, char text[ERN_SETTING_TEXT_BYTES]) {
  ERN_PLAIN_FLOATS;
  if (s == NULL || config == NULL || text == NULL) return;
  const union value value = value_of(s, config);
  switch (s->type) {
    case ERN_SETTING_BOOL: strcpy(text, value.flag ? "yes" : "no"); return;
    case ERN_SETTING_INT: snprintf(text, ERN_SETTING_TEXT_BYTES, "%d", value.whole); return;
    case ERN_SETTING_UINT64: snprintf(text, ERN_SETTING_TEXT_BYTES, "%" PRIu64, value.count); return;
    case ERN_SETTING_SIZE: snprintf(text, ERN_SETTING_TEXT_BYTES, "%zu", value.size); return;
    case ERN_SETTING_FLOAT: write_real((double)value.real, false, text); return;
    case ERN_SETTING_DOUBLE: write_real(value.wide, true, text); return;
    case ERN_SETTING_WORD: write_word(s->words, value.whole, text); return;
    case ERN_SETTING_TEXT:
    case ERN_SETTING_POINTER: text[0] = 0; return;
  }
}

void ern_setting_expected(const ern_setting *s, char *text, size_t bytes) {
  ERN_PLAIN_FLOATS;
  if (s == NULL || text == NULL || bytes == 0) return;
  const bool real = s->type == ERN_SETTING_FLOAT || s->type == ERN_SETTING_DOUBLE;
  if (s->type == ERN_SETTING_BOOL)
    snprintf(text, bytes, "yes or no");
  else if (s->type == ERN_SETTING_WORD)
    snprintf(text, bytes, "one of %s", s->words);
  else if (!is_value(s))
    snprintf(text, bytes, "nothing");
  else if (real)
    ern_format(text, bytes, "a number from %g to %g", s->least, s->most);
  else if (s->most >= 1.8e19) /* 2^64 */
    ern_format(text, bytes, "a whole number, %.0f or more", s->least);
  else
    ern_format(text, bytes, "a whole number from %.0f to %.0f", s->least, s->most);
}
