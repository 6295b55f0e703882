/* SPDX-License-Identifier: MIT
 * Rows of a table of settings (ernerf/setting.h), and what the library does with one: the compiler checks that a row
 * has its member's type. */
#ifndef ERN_CORE_SETTING_TABLE_H
#define ERN_CORE_SETTING_TABLE_H

#include "core/types.h"
#include "ernerf/setting.h"

/* Name and place of a member of `config`, which does not compile where its type is another. */
#define ERN_SETTING_OF(config, kind, type_, member)                                                      \
  .name = #member, .type = (kind),                                                                       \
  .at = offsetof(config, member) + 0 * sizeof(char[_Generic(&((config *)0)->member, type_ * : 1, default \
                                                            : -1)])

/* Sets the member to the setting's default. */
void ern_setting_reset(const ern_setting *setting, void *config);

/* ERN_E_ARGUMENT where the member is outside of its range. `what`: the first word of the message. */
ERN_NODISCARD ern_status ern_setting_check(ern_context *context, const char *what, const ern_setting *setting,
                                           const void *config);

#endif
