/* SPDX-License-Identifier: MIT
 * Files, whole: read with a size limit, written so that a reader sees the old one or the new one, never half. */
#ifndef ERN_IO_FILE_H
#define ERN_IO_FILE_H

#include "core/status.h"

/* Reads a regular file of at most `limit` bytes. On success the caller owns *bytes (ern_release), which has a 0 after
 * its last byte. ERN_E_MISSING, ERN_E_IO, ERN_E_SHAPE (longer than limit). */
ERN_NODISCARD ern_status ern_file_read(ern_context *context, const char *path, size_t limit, uint8_t **bytes,
                                       size_t *count);

/* A regular file of at most `limit` bytes that is read in parts, so that the sizes in its header are checked against
 * `size` before memory is allocated for the rest. `path` must outlive it. */
struct ern_file_reader {
  ern_context *context;
  const char *path;
  int descriptor;
  size_t size;
};
ERN_NODISCARD ern_status ern_file_reader_open(ern_context *context, const char *path, size_t limit,
                                              struct ern_file_reader *reader);
/* `count` bytes from byte `at` on; ERN_E_IO where they are not there. */
ERN_NODISCARD ern_status ern_file_reader_take(const struct ern_file_reader *reader, size_t at, void *bytes,
                                              size_t count);
/* Does nothing on a closed reader. */
void ern_file_reader_close(struct ern_file_reader *reader);

/* The bytes before the first character of a text: 3 of UTF-8's byte-order mark, else 0. */
size_t ern_text_mark(const uint8_t *bytes, size_t count);

/* Records a failed system call as an error: the path, `verb` and errno's text. */
ern_status ern_file_fail(ern_context *context, const char *path, const char *verb);

/* Whether a name is that of a writer's temporary file. */
bool ern_file_is_temporary(const char *name);

/* ERN_E_IO where `path` is a folder, a device or a pipe, or a file that may not be written. */
ERN_NODISCARD ern_status ern_file_check_replaceable(ern_context *context, const char *path);

/* What happens to a file that exists already: keep_files of the context decides, it is replaced, or it is kept. */
enum ern_existing { ERN_EXISTING_BY_CONTEXT, ERN_EXISTING_REPLACE, ERN_EXISTING_KEEP };

/* A file being written (base.h, "How files are written"). A zeroed one is closed. A library that opens its output
 * itself may write to `temporary` by its name. */
struct ern_file_writer {
  ern_context *context;
  char *path;      /* as the caller named it */
  char *place;     /* the path after following symbolic links */
  char *temporary; /* PLACE.ernerf-tmp */
  int descriptor;  /* of `temporary`, which it keeps locked */
  int folder;      /* a descriptor of its folder; -1: none */
  bool keep;       /* an existing file is not replaced */
  bool stays;      /* where it cannot be put in place, the whole file keeps its temporary name; set after opening */
};
ERN_NODISCARD ern_status ern_file_writer_open(ern_context *context, const char *path, enum ern_existing existing,
                                              struct ern_file_writer *writer);
ERN_NODISCARD ern_status ern_file_writer_write(struct ern_file_writer *writer, const void *bytes, size_t count);
/* Moves the file to `place`. On failure too, closes the writer; it removes the temporary file unless that `stays`. */
ERN_NODISCARD ern_status ern_file_writer_commit(struct ern_file_writer *writer);
/* Removes what was written; harmless on a writer that is closed or zeroed. */
void ern_file_writer_abandon(struct ern_file_writer *writer);

/* open, write, commit in one. */
ERN_NODISCARD ern_status ern_file_write(ern_context *context, const char *path, const void *bytes, size_t count,
                                        enum ern_existing existing);

/* The text "DIR/NAME"; owned by the caller (ern_release). */
ERN_NODISCARD ern_status ern_path_join(ern_context *context, const char *dir, const char *name, char **path);
/* Makes a folder and its missing parents. */
ERN_NODISCARD ern_status ern_folder_make(ern_context *context, const char *path);

/* SHA-256 over bytes, as 64 lower-case hex digits and a 0. */
void ern_sha256_hex(const void *bytes, size_t count, char hex[65]);

#endif
