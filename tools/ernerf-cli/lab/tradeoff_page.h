/* SPDX-License-Identifier: MIT
 * The results of `ernerf tradeoff` as one HTML page that needs no other file: plots, tables, the machine, and pictures
 * of the front's points. */
#ifndef ERN_CLI_TRADEOFF_PAGE_H
#define ERN_CLI_TRADEOFF_PAGE_H

#include "bytes.h"
#include "lab/tradeoff.h"

/* Draws the pictures of the front again. Returns 0, or EXIT_FAILURE after a message. */
int tradeoff_page_make(struct tradeoff *t, struct bytes *page);

#endif
