/* SPDX-License-Identifier: MIT */
#include "output/watermark_output.h"

#include <stdlib.h>
#include <string.h>

void watermark_options(struct watermark *watermark, struct option options[WATERMARK_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_TEXT("watermark", &watermark->key), .choices = "KEY",
       .help = "a faint pattern on the frames, which `ernerf detect` finds again with the same KEY, a text of at most "
               "255 bytes (default none)"}};
  ARGS_FILL(options, rows, WATERMARK_OPTIONS);
}

int watermark_check(const struct watermark *watermark, const struct args *args) {
  const size_t bytes = watermark->key != NULL ? strlen(watermark->key) : 1;
  if (bytes > 0 && bytes < ERN_WATERMARK_KEY_BYTES) return -1;
  return args_refuse(args, "--watermark: the key has %zu bytes, expected 1 to %d", bytes, ERN_WATERMARK_KEY_BYTES - 1);
}

int watermark_make(struct watermark *watermark, struct session *session, int width, int height) {
  if (watermark->key == NULL) return 0;
  return ern_watermark_open(session->context, watermark->key, width, height, &watermark->pattern) == ERN_OK
             ? 0
             : session_fail(session);
}

int watermark_put(const struct watermark *watermark, struct session *session, uint8_t *rgba) {
  if (watermark->pattern == NULL) return 0;
  return ern_watermark_put(watermark->pattern, rgba) == ERN_OK ? 0 : session_fail(session);
}

void watermark_free(struct watermark *watermark) { ern_watermark_free(&watermark->pattern); }
