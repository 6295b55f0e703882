/* SPDX-License-Identifier: MIT
 * Text in which a real number has a point, whatever the locale of the host program: vsnprintf writes 0,5 under some. */
#ifndef ERN_CORE_FORMAT_H
#define ERN_CORE_FORMAT_H

#include <locale.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>

#include "ernerf/base.h"

/* snprintf and vsnprintf in the locale "C". */
int ern_format(char *text, size_t bytes, const char *format, ...) ERN_PRINTF(3, 4);
int ern_format_list(char *text, size_t bytes, const char *format, va_list values) ERN_PRINTF(3, 0);

/* The whole text as a decimal number in the locale "C": no blanks, hexadecimal, infinite or NaN. False: it is none. */
bool ern_format_read(const char *text, double *value);

/* For other libraries that write text: this thread alone is in the locale "C" until it restores the host's. Returns 0,
 * and changes nothing, where the C library has no memory for it. */
locale_t ern_locale_plain(void);
void ern_locale_restore(locale_t host);

#endif
