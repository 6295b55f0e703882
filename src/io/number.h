/* SPDX-License-Identifier: MIT
 * Decimal numbers in untrusted text: no locale, no hexadecimal, no "nan" or "inf", no terminating 0 needed. */
#ifndef ERN_IO_NUMBER_H
#define ERN_IO_NUMBER_H

#include <stdbool.h>

/* Reads [sign] digits [. digits] [e [sign] digits] at *at and moves *at past it; returns false and leaves *at where
 * there is none. *value is the nearest double for up to 15 digits and exponents within 22, else within a few units of
 * its last place, and infinite where too large: the caller checks. */
bool ern_number_read(const char **at, const char *end, double *value);

#endif
