/* SPDX-License-Identifier: MIT
 * JSON texts of files that are not trusted. */
#ifndef ERN_IO_JSON_H
#define ERN_IO_JSON_H

#include <jansson.h>
#include <stdbool.h>

#include "core/status.h"

/* Parses `length` bytes of text that hold one object, in which no key stands twice. What the parser would make of it is
 * estimated first: a value takes up to a hundred times the bytes of its text. The caller owns *root (json_decref).
 * ERN_E_FORMAT; ERN_E_SHAPE where it would take more than `most` bytes; ERN_E_NO_MEMORY. Messages name the file and
 * `part`: "", or what of it the text is, as in "header: ". */
ERN_NODISCARD ern_status ern_json_parse(ern_context *context, const char *path, const char *part, const char *text,
                                        size_t length, size_t most, json_t **root);

#endif
