/* SPDX-License-Identifier: MIT */
#include "io/speech_description.h"

#include <stdlib.h>
#include <string.h>

#include "io/json.h"

enum { ROWS_A_SECOND = 50, MOST_RATE = 48000, MOST_SECONDS = 60, MOST_WIDTH = 4096, MOST_JSON = 1 << 20 };

static const char *const normalisations[] = {
    [ERN_SPEECH_AS_IT_IS] = "none", [ERN_SPEECH_PIECE] = "piece", [ERN_SPEECH_SOUND] = "sound"};
enum { NORMALISATIONS = sizeof normalisations / sizeof *normalisations };

static const char lower[] = "abcdefghijklmnopqrstuvwxyz0123456789._-", hexadecimal[] = "0123456789abcdef";

struct reading {
  ern_context *context;
  const char *where;
  const json_t *root;
};

static ern_status wrong(const struct reading *reading, const char *name, const char *expected) {
  const json_t *value = json_object_get(reading->root, name);
  char *found = value != NULL ? json_dumps(value, JSON_ENCODE_ANY | JSON_COMPACT) : NULL;
  const ern_status status = ern_fail(reading->context, ERN_E_FORMAT, "%s: %s is %.100s, expected %s", reading->where,
                                     name, found != NULL ? found : "missing", expected);
  free(found);
  return status;
}

static ern_status read_number(const struct reading *reading, const char *name, int low, int high, int each, int *to) {
  const json_t *value = json_object_get(reading->root, name);
  const json_int_t number = json_integer_value(value);
  char expected[80];
  if (json_is_integer(value) && number >= low && number <= high && number % each == 0) {
    *to = (int)number;
    return ERN_OK;
  }
  if (each > 1)
    snprintf(expected, sizeof expected, "a multiple of %d, %d to %d", each, low, high);
  else
    snprintf(expected, sizeof expected, "a whole number, %d to %d", low, high);
  return wrong(reading, name, expected);
}

/* Text of `letters` (NULL: printable ASCII without quotes and backslashes), `least` to `capacity` - 1 of them. */
static ern_status read_text(const struct reading *reading, const char *name, const char *letters, size_t least,
                            size_t capacity, const char *expected, char *to) {
  const char *text = json_string_value(json_object_get(reading->root, name));
  const size_t count = text != NULL ? strlen(text) : 0;
  bool fine = text != NULL && count >= least && count < capacity;
  for (size_t i = 0; fine && i < count; i++)
    fine = letters != NULL ? strchr(letters, text[i]) != NULL
                           : text[i] > 31 && text[i] < 127 && text[i] != '"' && text[i] != '\\';
  if (!fine) return wrong(reading, name, expected);
  memcpy(to, text, count + 1);
  return ERN_OK;
}

static ern_status check_names(const struct reading *reading) {
  static const char *const known[] = {"kind",        "rate",  "normalisation", "piece_samples", "context_samples",
                                      "row_samples", "width", "window_rows",   "output",        "sha256"};
  const char *name = ern_json_unknown_member((json_t *)reading->root, known, sizeof known / sizeof *known);
  if (name == NULL) return ERN_OK;
  return ern_fail(reading->context, ERN_E_FORMAT, "%s: %.60s is no field of a network's description", reading->where,
                  name);
}

static ern_status read_normalisation(const struct reading *reading, enum ern_speech_normalisation *to) {
  const char *text = json_string_value(json_object_get(reading->root, "normalisation"));
  for (int i = 0; text != NULL && i < NORMALISATIONS; i++) {
    if (strcmp(text, normalisations[i]) != 0) continue;
    *to = (enum ern_speech_normalisation)i;
    return ERN_OK;
  }
  return wrong(reading, "normalisation", "\"none\", \"piece\" or \"sound\"");
}

static ern_status read_all(const struct reading *reading, struct ern_speech_description *d) {
  ern_status status = ERN_OK;
  ERN_TRY(check_names(reading));
  ERN_TRY(read_text(reading, "kind", lower, 1, sizeof d->kind, "1 to 63 of a-z 0-9 . _ -", d->kind));
  if (strncmp(d->kind, "cepstra", 7) == 0 || strncmp(d->kind, "articulatory", 12) == 0)
    ERN_TRY(wrong(reading, "kind", "another name than that of a built-in kind"));
  ERN_TRY(read_number(reading, "rate", 8000, MOST_RATE, ROWS_A_SECOND, &d->rate));
  ERN_TRY(read_normalisation(reading, &d->normalisation));
  ERN_TRY(read_number(reading, "piece_samples", d->rate / ROWS_A_SECOND, MOST_SECONDS * d->rate, 1, &d->piece_samples));
  ERN_TRY(read_number(reading, "row_samples", 1, d->piece_samples, 1, &d->row_samples));
  ERN_TRY(
      read_number(reading, "context_samples", 0, d->piece_samples / 2, d->rate / ROWS_A_SECOND, &d->context_samples));
  if (d->piece_samples - 2 * d->context_samples < d->rate / ROWS_A_SECOND ||
      d->piece_samples - d->row_samples < d->context_samples)
    ERN_TRY(wrong(reading, "context_samples", "less: it leaves no row of a piece"));
  ERN_TRY(read_number(reading, "width", 1, MOST_WIDTH, 1, &d->width));
  ERN_TRY(read_number(reading, "window_rows", 2, 16, 1, &d->window_rows));
  if (d->window_rows != 2 && d->window_rows != 16) ERN_TRY(wrong(reading, "window_rows", "16 or 2"));
  if (json_object_get(reading->root, "output") != NULL)
    ERN_TRY(read_text(reading, "output", NULL, 1, sizeof d->output,
                      "1 to 127 characters of ASCII without quotes and backslashes", d->output));
  if (json_object_get(reading->root, "sha256") != NULL)
    ERN_TRY(read_text(reading, "sha256", hexadecimal, 64, sizeof d->sha256, "64 digits of 0-9 a-f", d->sha256));
fail:
  return status;
}

ern_status ern_speech_description_parse(ern_context *context, const char *where, const char *text,
                                        struct ern_speech_description *description) {
  json_t *root = NULL;
  *description = (struct ern_speech_description){0};
  ern_status status = ern_json_parse(context, where, "", text, strlen(text), MOST_JSON, &root);
  if (status == ERN_OK)
    status = read_all(&(struct reading){.context = context, .where = where, .root = root}, description);
  json_decref(root);
  return status;
}

ern_status ern_speech_description_text(ern_context *context, const struct ern_speech_description *d,
                                       char text[ERN_SPEECH_DESCRIPTION_BYTES]) {
  json_t *root =
      json_pack("{s:s, s:i, s:s, s:i, s:i, s:i, s:i, s:i}", "kind", d->kind, "rate", d->rate, "normalisation",
                normalisations[d->normalisation], "piece_samples", d->piece_samples, "context_samples",
                d->context_samples, "row_samples", d->row_samples, "width", d->width, "window_rows", d->window_rows);
  if (root != NULL && d->output[0] != 0) json_object_set_new(root, "output", json_string(d->output));
  if (root != NULL && d->sha256[0] != 0) json_object_set_new(root, "sha256", json_string(d->sha256));
  const size_t count = json_dumpb(root, text, ERN_SPEECH_DESCRIPTION_BYTES - 1, JSON_COMPACT);
  json_decref(root);
  if (count == 0 || count >= ERN_SPEECH_DESCRIPTION_BYTES)
    return ern_fail(context, ERN_E_NO_MEMORY, "speech: the description of a network could not be put together");
  text[count] = 0;
  return ERN_OK;
}
