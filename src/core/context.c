/* SPDX-License-Identifier: MIT */
#include "core/context.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "core/format.h"
#include "core/memory.h"

size_t ern_last_error_copy(const ern_context *context, char *text, size_t bytes) {
  char kept[ERN_ERROR_BYTES] = "";
  if (context != NULL) {
    pthread_mutex_t *mutex = &((ern_context *)context)->mutex; /* no context object is const */
    pthread_mutex_lock(mutex);
    memcpy(kept, context->error_text, sizeof kept);
    pthread_mutex_unlock(mutex);
  }
  if (text != NULL && bytes > 0) snprintf(text, bytes, "%s", kept);
  return strlen(kept);
}

const char *ern_last_error(const ern_context *context) { return context != NULL ? context->error_text : ""; }

bool ern_keeps_files(const ern_context *context) { return context != NULL && context->config.keep_files; }

/* A name in a file may hold anything: control characters, which a terminal would interpret, become spaces. */
static void format_line(char line[ERN_ERROR_BYTES], const char *format, va_list arguments) {
  ern_format_list(line, ERN_ERROR_BYTES, format, arguments);
  for (unsigned char *at = (unsigned char *)line; *at != 0; at++) {
    const bool second = at[0] == 0xc2 && at[1] >= 0x80 && at[1] < 0xa0; /* U+0080 to U+009F */
    if (second) *at++ = ' ';
    if (second || *at < 0x20 || *at == 0x7f) *at = ' ';
  }
}

ern_status ern_fail(ern_context *context, ern_status code, const char *format, ...) {
  if (context == NULL) return code;
  char text[ERN_ERROR_BYTES];
  va_list arguments;
  va_start(arguments, format);
  format_line(text, format, arguments);
  va_end(arguments);
  pthread_mutex_lock(&context->mutex);
  memcpy(context->error_text, text, sizeof text);
  pthread_mutex_unlock(&context->mutex);
  if (context->config.log != NULL) context->config.log(context->config.user, ERN_LOG_DEBUG, text);
  return code;
}

void ern_error_keep(ern_context *context, char text[ERN_ERROR_BYTES]) {
  (void)ern_last_error_copy(context, text, ERN_ERROR_BYTES);
}

void ern_error_restore(ern_context *context, const char text[ERN_ERROR_BYTES]) {
  if (context == NULL) return;
  pthread_mutex_lock(&context->mutex);
  memcpy(context->error_text, text, ERN_ERROR_BYTES);
  pthread_mutex_unlock(&context->mutex);
}

void ern_log(ern_context *context, ern_log_level level, const char *format, ...) {
  if (context == NULL || context->config.log == NULL) return;
  char text[ERN_ERROR_BYTES];
  va_list arguments;
  va_start(arguments, format);
  format_line(text, format, arguments);
  va_end(arguments);
  context->config.log(context->config.user, level, text);
}

void ern_log_error(ern_context *context, ern_log_level level, const char *before) {
  char text[ERN_ERROR_BYTES];
  (void)ern_last_error_copy(context, text, sizeof text);
  ern_log(context, level, "%s%s", before, text);
}

void *ern_allocate(ern_context *context, size_t count, size_t item_bytes) {
  size_t bytes = 0, padded = 0;
  if (context == NULL) return NULL;
  const bool fits = ern_size_multiply(count, item_bytes, &bytes) &&
                    ern_size_add(bytes, 2 * (size_t)ERN_ALIGNMENT - 1, &padded) && padded <= PTRDIFF_MAX;
  padded = padded / ERN_ALIGNMENT * ERN_ALIGNMENT;
  void *memory = fits ? context->config.allocate(context->config.user, padded, ERN_ALIGNMENT) : NULL;
  if (memory != NULL) return memset(memory, 0, padded);
  if (fits) ern_fail(context, ERN_E_NO_MEMORY, "memory: %zu bytes were refused", padded);
  if (!fits) ern_fail(context, ERN_E_NO_MEMORY, "memory: %zu items of %zu bytes do not fit", count, item_bytes);
  return NULL;
}

void ern_release(ern_context *context, void *memory) {
  if (context != NULL && memory != NULL) context->config.release(context->config.user, memory);
}

ern_status ern_string_copy(ern_context *context, const char *text, char **copy) {
  const size_t bytes = strlen(text) + 1;
  const ern_status status = ERN_NEW(context, bytes, copy);
  if (status == ERN_OK) memcpy(*copy, text, bytes);
  return status;
}

const char *ern_version(void) { return "0.1.0"; }

const char *ern_status_name(ern_status status) {
  switch (status) {
    case ERN_OK: return "ERN_OK";
    case ERN_E_ARGUMENT: return "ERN_E_ARGUMENT";
    case ERN_E_NO_MEMORY: return "ERN_E_NO_MEMORY";
    case ERN_E_STATE: return "ERN_E_STATE";
    case ERN_E_CANCELLED: return "ERN_E_CANCELLED";
    case ERN_E_IO: return "ERN_E_IO";
    case ERN_E_MISSING: return "ERN_E_MISSING";
    case ERN_E_BUSY: return "ERN_E_BUSY";
    case ERN_E_EXISTS: return "ERN_E_EXISTS";
    case ERN_E_FORMAT: return "ERN_E_FORMAT";
    case ERN_E_SHAPE: return "ERN_E_SHAPE";
    case ERN_E_MISMATCH: return "ERN_E_MISMATCH";
    case ERN_E_NONFINITE: return "ERN_E_NONFINITE";
    case ERN_E_UNSUPPORTED: return "ERN_E_UNSUPPORTED";
    case ERN_E_DEVICE: return "ERN_E_DEVICE";
    case ERN_E_MEDIA: return "ERN_E_MEDIA";
  }
  return "ERN_E_UNKNOWN";
}
