/* SPDX-License-Identifier: MIT
 * train --consent: what the person has agreed to. */
#ifndef ERN_CLI_CONSENT_H
#define ERN_CLI_CONSENT_H

#include "ernerf/model.h"
#include "session/session.h"

/* If `asked` names a file, text is its content without trailing white space; else text is `asked` itself. Returns 0, or
 * EXIT_FAILURE after a message: the file is empty, or longer than ERN_CONSENT_BYTES allows. */
int consent_read(struct session *session, const char *asked, char text[ERN_CONSENT_BYTES]);

#endif
