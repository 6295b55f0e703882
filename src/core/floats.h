/* SPDX-License-Identifier: MIT
 * Floating point as everything here is written for: rounded to nearest, denormal numbers kept, nothing trapped. A
 * program that links the library may have chosen otherwise (being linked with -ffast-math is the usual way) and has its
 * choice back when the call returns. */
#ifndef ERN_CORE_FLOATS_H
#define ERN_CORE_FLOATS_H

#include <fenv.h>

static inline fenv_t ern_floats_plain(void) {
  fenv_t host;
  fegetenv(&host);
  fesetenv(FE_DFL_ENV);
  return host;
}

static inline void ern_floats_restore(const fenv_t *host) { fesetenv(host); }

/* To the end of the scope. Stands first in each public function that computes. */
#define ERN_PLAIN_FLOATS \
  __attribute__((cleanup(ern_floats_restore), unused)) const fenv_t ern_host_floats = ern_floats_plain()

#endif
