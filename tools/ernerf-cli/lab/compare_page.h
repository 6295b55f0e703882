/* SPDX-License-Identifier: MIT
 * The results of `ernerf compare` as an HTML page beside its pictures and its video. */
#ifndef ERN_CLI_COMPARE_PAGE_H
#define ERN_CLI_COMPARE_PAGE_H

#include "bytes.h"
#include "lab/compare.h"

/* Adds the page; page->failed without memory. */
void compare_page(const struct compare *c, struct bytes *page);

#endif
