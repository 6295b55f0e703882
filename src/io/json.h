/* SPDX-License-Identifier: MIT
 * JSON texts of untrusted files. */
#ifndef ERN_IO_JSON_H
#define ERN_IO_JSON_H

#include <jansson.h>
#include <stdbool.h>

#include "core/status.h"

/* Parses `length` bytes of text that hold one object without duplicate keys. Estimates the memory of the parsed values
 * first: a value takes up to a hundred times the bytes of its text. The caller owns *root (json_decref). ERN_E_FORMAT;
 * ERN_E_SHAPE where they would take more than `most` bytes; ERN_E_NO_MEMORY. Messages name the file and `part`: "" or
 * the part of the file, such as "header: ". */
ERN_NODISCARD ern_status ern_json_parse(ern_context *context, const char *path, const char *part, const char *text,
                                        size_t length, size_t most, json_t **root);
/* The first member of an object that is not one of known[count], in the memory of `root`; NULL: none. */
const char *ern_json_unknown_member(json_t *root, const char *const *known, size_t count);
/* The text of `root`, owned by the caller (ern_release); NULL where there is no memory for it, or `root` is NULL. Of
 * json_dumps, jansson 2.14 ignores that the text could not grow for an object's key, and leaves the key out. */
char *ern_json_text(ern_context *context, const json_t *root, size_t flags);

#endif
