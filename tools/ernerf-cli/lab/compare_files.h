/* SPDX-License-Identifier: MIT
 * The output folder of `ernerf compare`: checks that it may be used, and writes all files or none. */
#ifndef ERN_CLI_COMPARE_FILES_H
#define ERN_CLI_COMPARE_FILES_H

#include "lab/compare.h"

/* Called before the work. Fails if the folder holds other files, if an earlier comparison may not be replaced, or if an
 * output is an input. Changes no file. Returns 0, or EXIT_FAILURE after a message, as the next two do. */
int compare_files_check(struct compare *c);
/* Creates the folder if it is missing, and begins the video in it under a temporary name. */
int compare_files_open(struct compare *c);
/* Draws the three shown frames again, and writes all files under temporary names; renames them only after all are
 * complete on the disk. */
int compare_files_write(struct compare *c);
/* Removes unfinished files, and an empty folder unless `done`. */
void compare_files_close(struct compare *c, bool done);

#endif
