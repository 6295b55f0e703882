/* SPDX-License-Identifier: MIT
 * The floating-point environment that this code assumes: rounding to nearest, denormal numbers kept, no traps. A
 * program that links the library may have set another one (usually by linking with -ffast-math) and gets it back when
 * the call returns. */
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

/* Lasts to the end of the scope. The first statement of each public function that computes. */
#define ERN_PLAIN_FLOATS \
  __attribute__((cleanup(ern_floats_restore), unused)) const fenv_t ern_host_floats = ern_floats_plain()

#endif
