/* SPDX-License-Identifier: MIT */
#include "verbs/consent.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

static int read_file(struct session *session, const char *path, char text[ERN_CONSENT_BYTES]) {
  FILE *file = fopen(path, "rb");
  if (file == NULL) return session_fail_with(session, "%s: cannot be read: %s", path, strerror(errno));
  size_t count = fread(text, 1, ERN_CONSENT_BYTES, file);
  const bool failed = ferror(file) != 0;
  fclose(file);
  if (failed) return session_fail_with(session, "%s: cannot be read", path);
  if (count == ERN_CONSENT_BYTES)
    return session_fail_with(session, "%s: is a consent of more than %d bytes", path, ERN_CONSENT_BYTES - 1);
  while (count > 0 && strchr(" \t\r\n", text[count - 1]) != NULL) count--;
  text[count] = 0;
  if (count == 0 || strlen(text) != count)
    return session_fail_with(session, "%s: %s, expected the text of a consent", path,
                             count == 0 ? "is empty" : "has a byte of 0");
  return 0;
}

int consent_read(struct session *session, const char *asked, char text[ERN_CONSENT_BYTES]) {
  struct stat about;
  const bool there = stat(asked, &about) == 0;
  if (there && S_ISREG(about.st_mode)) return read_file(session, asked, text);
  if (there)
    return session_fail_with(session, "%s: is no regular file, expected one with the text of a consent", asked);
  if (strpbrk(asked, " \t\n") == NULL && strpbrk(asked, "./") != NULL) /* a misspelt name is no consent */
    return session_fail_with(session, "--consent %s: there is no such file, expected one, or a text with blanks",
                             asked);
  if (snprintf(text, ERN_CONSENT_BYTES, "%s", asked) >= ERN_CONSENT_BYTES)
    return session_fail_with(session, "--consent has %zu bytes, expected at most %d", strlen(asked),
                             ERN_CONSENT_BYTES - 1);
  return 0;
}
