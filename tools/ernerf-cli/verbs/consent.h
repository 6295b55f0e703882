/* SPDX-License-Identifier: MIT
 * train --consent: what the person has agreed to. */
#ifndef ERN_CLI_CONSENT_H
#define ERN_CLI_CONSENT_H

#include "ernerf/model.h"
#include "session/session.h"

/* text = the file `asked` without blanks at its end where one is there, else `asked` itself. Returns 0, or EXIT_FAILURE
 * after a message: a file that is empty, or has more than ERN_CONSENT_BYTES allows. */
int consent_read(struct session *session, const char *asked, char text[ERN_CONSENT_BYTES]);

#endif
