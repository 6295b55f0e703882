/* SPDX-License-Identifier: MIT
 * Loads libernerf-serve for the verb `serve` alone, so that no other needs libmicrohttpd. */
#ifndef ERN_CLI_SERVE_LIBRARY_H
#define ERN_CLI_SERVE_LIBRARY_H

#include "serve/http_server.h"
#include "session/session.h"

/* Returns 0, or EXIT_FAILURE after a message. The library stays loaded until the program ends. */
int serve_library_load(const struct ern_http_functions **functions, struct session *session);

#endif
