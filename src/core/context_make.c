/* SPDX-License-Identifier: MIT
 * Creates and frees a context. */
#include <stdlib.h>
#include <string.h>

#include "core/context.h"
#include "core/memory.h"
#include "core/sized.h"

enum { CONFIG_COOKIE = 0x45524e31 };

static void *libc_allocate(void *user, size_t bytes, size_t alignment) {
  (void)user;
  return aligned_alloc(alignment, bytes);
}

static void libc_release(void *user, void *memory) {
  (void)user;
  free(memory);
}

void ern_context_config_fill(ern_context_config *config, size_t bytes) {
  const ern_context_config own = {.cookie = CONFIG_COOKIE, .allocate = libc_allocate, .release = libc_release};
  ern_config_copy_out(config, bytes, &own, sizeof own);
}

ern_status ern_context_create(ern_context **context, const ern_context_config *config) {
  if (context == NULL) return ERN_E_ARGUMENT;
  *context = NULL;
  ern_context_config chosen = ern_context_config_default();
  const ern_status status = config != NULL ? ERN_COPY_IN_CONFIG(NULL, ern_context_config, &chosen, config)
                                           : ERN_OK; /* no context to say why */
  if (status != ERN_OK) return status;
  if ((chosen.allocate == NULL) != (chosen.release == NULL)) return ERN_E_ARGUMENT;
  if (chosen.allocate == NULL) {
    chosen.allocate = libc_allocate;
    chosen.release = libc_release;
  }
  const size_t bytes = (sizeof(ern_context) + ERN_ALIGNMENT - 1) / ERN_ALIGNMENT * ERN_ALIGNMENT;
  ern_context *made = chosen.allocate(chosen.user, bytes, ERN_ALIGNMENT);
  if (made == NULL) return ERN_E_NO_MEMORY;
  memset(made, 0, bytes);
  made->config = chosen;
  if (pthread_mutex_init(&made->mutex, NULL) != 0) {
    chosen.release(chosen.user, made);
    return ERN_E_NO_MEMORY;
  }
  *context = made;
  return ERN_OK;
}

void ern_context_free(ern_context **context) {
  if (context == NULL || *context == NULL) return;
  ern_context *dying = *context;
  *context = NULL;
  pthread_mutex_destroy(&dying->mutex);
  dying->config.release(dying->config.user, dying);
}
