/* SPDX-License-Identifier: MIT
 * Rows of a table of settings (ernerf/setting.h), and what the library does with one: the compiler checks that a row
 * has its member's type. */
#ifndef ERN_CORE_SETTING_TABLE_H
#define ERN_CORE_SETTING_TABLE_H

#include "core/sized.h"
#include "ernerf/setting.h"

/* Name and place of a member of `config`, which does not compile where its type is another. */
#define ERN_SETTING_OF(config, kind, type_, member)                                                      \
  .name = #member, .type = (kind),                                                                       \
  .at = offsetof(config, member) + 0 * sizeof(char[_Generic(&((config *)0)->member, type_ * : 1, default \
                                                            : -1)])

/* Rows of the struct ERN_SETTINGS, which a file with a table defines: {ERN_ROW_INT(levels, 0, 24, 0), .help = "..."} */
#define ERN_ROW_BOOL(member) ERN_SETTING_OF(ERN_SETTINGS, ERN_SETTING_BOOL, bool, member), .most = 1
#define ERN_ROW_NUMBER(kind, type, member, low, high, value) \
  ERN_SETTING_OF(ERN_SETTINGS, kind, type, member), .least = (low), .most = (high), .fallback = (value)
#define ERN_ROW_INT(member, low, high, value) ERN_ROW_NUMBER(ERN_SETTING_INT, int, member, low, high, value)
#define ERN_ROW_COUNT(member, low, high, value) ERN_ROW_NUMBER(ERN_SETTING_UINT64, uint64_t, member, low, high, value)
#define ERN_ROW_FLOAT(member, low, high, value) ERN_ROW_NUMBER(ERN_SETTING_FLOAT, float, member, low, high, value)
#define ERN_ROW_DOUBLE(member, low, high, value) ERN_ROW_NUMBER(ERN_SETTING_DOUBLE, double, member, low, high, value)
#define ERN_ROW_SIZE(member) ERN_ROW_NUMBER(ERN_SETTING_SIZE, size_t, member, 0, ERN_ANY_COUNT, 0)
#define ERN_ROW_WORD(member, type, all, count, value) \
  ERN_ROW_NUMBER(ERN_SETTING_WORD, type, member, 0, (count)-1, value), .words = (all)
#define ERN_ROW_TEXT(member) ERN_SETTING_OF(ERN_SETTINGS, ERN_SETTING_TEXT, const char *, member)
#define ERN_ROW_POINTER(member, type) ERN_SETTING_OF(ERN_SETTINGS, ERN_SETTING_POINTER, type, member)

#define ERN_ANY_COUNT 18446744073709551616.0 /* 2^64 */

/* Sets all members of the table to their defaults. */
void ern_settings_reset(const ern_setting *table, size_t rows, void *config);

/* ERN_E_ARGUMENT where a member is outside of its range. `what`: the first word of the message. */
ERN_NODISCARD ern_status ern_settings_check(ern_context *context, const char *what, const ern_setting *table,
                                            size_t rows, const void *config);

/* What follows from `table`, the rows of all members of `type`: ern_NOUN_setting(index), TYPE_fill(options, bytes) and
 * ern_NOUN_settings_check(context, options). cookie: that of a struct whose defaults were filled in. */
#define ERN_SETTINGS_FUNCTIONS(noun, type, cookie_)                                          \
  const ern_setting *ern_##noun##_setting(size_t index) {                                    \
    return index < sizeof table / sizeof *table ? &table[index] : NULL;                      \
  }                                                                                          \
  void type##_fill(type *options, size_t bytes) {                                            \
    type own = {.cookie = (cookie_)};                                                        \
    ern_settings_reset(table, sizeof table / sizeof *table, &own);                           \
    ern_config_copy_out(options, bytes, &own, sizeof own);                                   \
  }                                                                                          \
  ern_status ern_##noun##_settings_check(ern_context *context, const type *options) {        \
    return ern_settings_check(context, #noun, table, sizeof table / sizeof *table, options); \
  }

#endif
