/* SPDX-License-Identifier: MIT
 * Errors: the function that detects an error records its text once; every caller passes the status code on. */
#ifndef ERN_CORE_STATUS_H
#define ERN_CORE_STATUS_H

#include "ernerf/base.h"

/* Leaves the function through its one `fail:` label. Needs a local `ern_status status`. */
#define ERN_TRY(expression)          \
  do {                               \
    status = (expression);           \
    if (status != ERN_OK) goto fail; \
  } while (0)

/* At the beginning of a public function: refuses a NULL argument; the message names function and argument. */
#define ERN_NEED(context, argument)                                                                          \
  do {                                                                                                       \
    if ((argument) == NULL) return ern_fail(context, ERN_E_ARGUMENT, "%s: %s is NULL", __func__, #argument); \
  } while (0)

/* Records the text of the error and returns `code`, so that `return ern_fail(...)` and ERN_TRY(ern_fail(...)) read
 * well. */
ern_status ern_fail(ern_context *context, ern_status code, const char *format, ...) ERN_PRINTF(3, 4);

/* For work whose failure does not make its caller fail: saves the last error's text before it, and restores it
 * afterwards. */
enum { ERN_ERROR_BYTES = 2048 };
void ern_error_keep(ern_context *context, char text[ERN_ERROR_BYTES]);
void ern_error_restore(ern_context *context, const char text[ERN_ERROR_BYTES]);

/* The context's keep_files. */
bool ern_keeps_files(const ern_context *context);

/* Logs the text of the last error, with `before` in front of it. */
void ern_log_error(ern_context *context, ern_log_level level, const char *before);

/* Sends one line to the context's log hook, if it has one. */
void ern_log(ern_context *context, ern_log_level level, const char *format, ...) ERN_PRINTF(3, 4);

#endif
