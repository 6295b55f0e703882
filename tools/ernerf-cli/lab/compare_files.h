/* SPDX-License-Identifier: MIT
 * The folder that `ernerf compare` fills: whether it may, and all files in it or none. */
#ifndef ERN_CLI_COMPARE_FILES_H
#define ERN_CLI_COMPARE_FILES_H

#include "lab/compare.h"

/* Before the work: fails where the folder holds files of others, where an earlier comparison may not be replaced, and
 * where an output is an input. Touches nothing. Returns 0, or EXIT_FAILURE after a message, as the next two do. */
int compare_files_check(struct compare *c);
/* Makes the folder where it is missing, and begins the video in it, under a name that is not its last. */
int compare_files_open(struct compare *c);
/* Draws the three frames again, and writes everything: no file gets its name before all are whole on the disk. */
int compare_files_write(struct compare *c);
/* Removes what was begun and is not done. `done`: the folder stays even where nothing is in it. */
void compare_files_close(struct compare *c, bool done);

#endif
