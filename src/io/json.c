/* SPDX-License-Identifier: MIT */
#include "io/json.h"

#include <jansson.h>
#include <string.h>

#include "core/memory.h"
#include "io/file.h"

/* Bytes that jansson 2.14 allocates on a machine of 64 bits: an object with its first buckets, an array with its first
 * places, and a key with its value or a value in an array. */
enum { OBJECT_BYTES = 320, ARRAY_BYTES = 160, VALUE_BYTES = 160 };

/* An upper bound, without the texts of strings: each value except the first follows a bracket or a comma. */
static size_t memory_of(const char *text, size_t length) {
  size_t bytes = 0;
  bool quoted = false;
  for (size_t i = 0; i < length; i++) {
    const char c = text[i];
    if (quoted && c == '\\')
      i++;
    else if (c == '"')
      quoted = !quoted;
    else if (!quoted)
      bytes += c == '{'   ? OBJECT_BYTES + VALUE_BYTES
               : c == '[' ? ARRAY_BYTES + VALUE_BYTES
               : c == ',' ? VALUE_BYTES
                          : (size_t)0;
  }
  return bytes;
}

ern_status ern_json_parse(ern_context *context, const char *path, const char *part, const char *text, size_t length,
                          size_t most, json_t **root) {
  json_error_t error;
  const size_t bytes = memory_of(text, length);
  *root = NULL;
  if (bytes > most)
    return ern_fail(context, ERN_E_SHAPE, "%s: %sJSON values for about %zu MiB of memory, expected at most %zu MiB",
                    path, part, (bytes >> 20) + 1, most >> 20);
  const size_t mark = ern_text_mark((const uint8_t *)text, length);
  *root = json_loadb(text + mark, length - mark, JSON_REJECT_DUPLICATES, &error);
  if (*root == NULL && json_error_code(&error) == json_error_out_of_memory)
    return ern_fail(context, ERN_E_NO_MEMORY, "%s: %sno memory", path, part);
  if (*root == NULL)
    return ern_fail(context, ERN_E_FORMAT, "%s: %sline %d: %s, at byte %d", path, part, error.line, error.text,
                    error.position);
  if (json_is_object(*root)) return ERN_OK;
  json_decref(*root);
  *root = NULL;
  return ern_fail(context, ERN_E_FORMAT, "%s: %sis no JSON object", path, part);
}

const char *ern_json_unknown_member(json_t *root, const char *const *known, size_t count) {
  const char *name;
  json_t *value;
  json_object_foreach(root, name, value) {
    size_t i = 0;
    while (i < count && strcmp(known[i], name) != 0) i++;
    if (i == count) return name;
  }
  return NULL;
}

char *ern_json_text(ern_context *context, const json_t *root, size_t flags) {
  const size_t bytes = json_dumpb(root, NULL, 0, flags);
  char *text = bytes > 0 ? ern_allocate(context, bytes + 1, 1) : NULL;
  if (text == NULL || json_dumpb(root, text, bytes, flags) == bytes) return text;
  ern_release(context, text);
  return NULL;
}
