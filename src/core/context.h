/* SPDX-License-Identifier: MIT
 * What a context holds. Internal. */
#ifndef ERN_CORE_CONTEXT_H
#define ERN_CORE_CONTEXT_H

#include <pthread.h>

#include "core/status.h"

struct ern_context {
  ern_context_config config;
  pthread_mutex_t mutex; /* guards error_text */
  char error_text[ERN_ERROR_BYTES];
};

#endif
