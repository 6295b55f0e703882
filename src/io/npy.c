/* SPDX-License-Identifier: MIT */
#include "io/npy.h"

#include <stdio.h>
#include <string.h>

#include "core/memory.h"
#include "io/file.h"
#include "io/half.h"

static const size_t file_limit = (size_t)1 << 31; /* 400,000 frames of [16][44] doubles are 2.2 GB */
enum { HEADER_LIMIT = 1 << 16 };                  /* bytes, the start included; NumPy reads headers of 10,000 */

static const struct {
  const char *descr; /* as the header names it; all little endian */
  ern_npy_type type;
  size_t bytes;        /* an item in the file */
  size_t loaded_bytes; /* an item in memory: all floats are converted to float */
} types[] = {{"<f2", ERN_NPY_F16, 2, 4}, {"<f4", ERN_NPY_F32, 4, 4}, {"<f8", ERN_NPY_F64, 8, 4},
             {"|u1", ERN_NPY_U8, 1, 1},  {"<i4", ERN_NPY_I32, 4, 4}, {"<i8", ERN_NPY_I64, 8, 8}};
enum { TYPES = sizeof types / sizeof types[0], TEXT_BYTES = 64 };

/* The header being parsed: a Python dictionary of three entries in any order. */
struct header {
  ern_context *context;
  const char *path, *at, *end;
  char descr[TEXT_BYTES];
  bool fortran, has_descr, has_order, has_shape;
  int dims;
  size_t shape[ERN_NPY_MAX_DIMS];
};

static ern_status malformed(const struct header *header, const char *expected) {
  const size_t left = (size_t)(header->end - header->at);
  return ern_fail(header->context, ERN_E_FORMAT, "%s: header: found \"%.*s\", expected %s", header->path,
                  (int)(left < 24 ? left : 24), header->at, expected);
}

static void skip_blanks(struct header *header) {
  while (header->at < header->end && strchr(" \t\r\n", *header->at) != NULL && *header->at != 0) header->at++;
}

/* Skips blanks, then takes `c` if it is next. */
static bool take(struct header *header, char c) {
  skip_blanks(header);
  if (header->at == header->end || *header->at != c) return false;
  header->at++;
  return true;
}

/* A quoted word without escapes, of less than TEXT_BYTES. */
static ern_status take_text(struct header *header, char text[TEXT_BYTES]) {
  skip_blanks(header);
  const char quote = header->at < header->end ? *header->at : 0;
  if (quote != '\'' && quote != '"') return malformed(header, "a quoted word");
  const char *start = header->at + 1;
  const char *stop = memchr(start, quote, (size_t)(header->end - start));
  if (stop == NULL || stop - start >= TEXT_BYTES) return malformed(header, "a short quoted word");
  memcpy(text, start, (size_t)(stop - start));
  text[stop - start] = 0;
  header->at = stop + 1;
  return ERN_OK;
}

static ern_status take_shape(struct header *header) {
  if (!take(header, '(')) return malformed(header, "the shape as a tuple of numbers");
  while (!take(header, ')')) {
    size_t side = 0;
    skip_blanks(header);
    if (header->at == header->end || *header->at < '0' || *header->at > '9')
      return malformed(header, "a size of shape");
    for (; header->at < header->end && *header->at >= '0' && *header->at <= '9'; header->at++) {
      const bool fits = ern_size_multiply(side, 10, &side) && ern_size_add(side, (size_t)(*header->at - '0'), &side);
      if (!fits) return malformed(header, "a size of shape that fits 64 bits");
    }
    take(header, 'L'); /* Python 2 */
    if (header->dims == ERN_NPY_MAX_DIMS) {
      return ern_fail(header->context, ERN_E_SHAPE, "%s: shape has more than %d sizes", header->path, ERN_NPY_MAX_DIMS);
    }
    header->shape[header->dims++] = side;
    if (take(header, ',')) continue;
    if (!take(header, ')')) return malformed(header, "\",\" or \")\" in shape");
    break;
  }
  return ERN_OK;
}

static ern_status take_order(struct header *header) {
  skip_blanks(header);
  const size_t left = (size_t)(header->end - header->at);
  header->fortran = left >= 4 && memcmp(header->at, "True", 4) == 0;
  if (!header->fortran && !(left >= 5 && memcmp(header->at, "False", 5) == 0)) {
    return malformed(header, "fortran_order as True or False");
  }
  header->at += header->fortran ? 4 : 5;
  return ERN_OK;
}

static ern_status take_entry(struct header *header) {
  ern_status status = ERN_OK;
  char key[TEXT_BYTES];
  ERN_TRY(take_text(header, key));
  bool *seen = strcmp(key, "descr") == 0           ? &header->has_descr
               : strcmp(key, "fortran_order") == 0 ? &header->has_order
               : strcmp(key, "shape") == 0         ? &header->has_shape
                                                   : NULL;
  if (seen == NULL || *seen) {
    return ern_fail(header->context, ERN_E_FORMAT, "%s: header: %s key '%s', expected descr, fortran_order, shape",
                    header->path, seen == NULL ? "unknown" : "second", key);
  }
  *seen = true;
  if (!take(header, ':')) return malformed(header, "\":\"");
  skip_blanks(header);
  if (seen == &header->has_shape) return take_shape(header);
  if (seen == &header->has_order) return take_order(header);
  if (header->at < header->end && *header->at == '[') {
    return ern_fail(header->context, ERN_E_UNSUPPORTED, "%s: descr is a structure, expected one number type",
                    header->path);
  }
  return take_text(header, header->descr);
fail:
  return status;
}

static ern_status parse_header(struct header *header) {
  ern_status status = ERN_OK;
  if (!take(header, '{')) return malformed(header, "\"{\"");
  while (!take(header, '}')) {
    ERN_TRY(take_entry(header));
    if (take(header, ',')) continue;
    if (!take(header, '}')) return malformed(header, "\",\" or \"}\"");
    break;
  }
  skip_blanks(header);
  if (header->at != header->end) return malformed(header, "the end of the header");
  const char *absent = !header->has_descr ? "descr" : !header->has_order ? "fortran_order" : "shape";
  if (!header->has_descr || !header->has_order || !header->has_shape) {
    return ern_fail(header->context, ERN_E_FORMAT, "%s: header: %s is missing", header->path, absent);
  }
fail:
  return status;
}

/* Magic, version and the length of the header; on success header->at and ->end bound its text. `bytes` are the first
 * `count` of the file's `size`. */
static ern_status find_header(struct header *header, const uint8_t *bytes, size_t count, size_t size) {
  if (size < 10 || memcmp(bytes, "\x93NUMPY", 6) != 0) {
    return ern_fail(header->context, ERN_E_FORMAT, "%s: is no .npy file: found %zu bytes without its 10-byte start",
                    header->path, size);
  }
  const int version = bytes[6];
  if (version < 1 || version > 3) {
    return ern_fail(header->context, ERN_E_UNSUPPORTED, "%s: .npy version is %d, expected 1, 2 or 3", header->path,
                    version);
  }
  const size_t start = version == 1 ? 10 : 12;
  if (size < start) return ern_fail(header->context, ERN_E_FORMAT, "%s: ends in the header's length", header->path);
  size_t length = (size_t)bytes[8] | (size_t)bytes[9] << 8;
  if (version > 1) length |= (size_t)bytes[10] << 16 | (size_t)bytes[11] << 24;
  if (length > count - start) {
    return ern_fail(header->context, ERN_E_FORMAT, "%s: header length is %zu, expected at most %zu, %s", header->path,
                    length, count - start, count < size ? "for an array of numbers" : "the rest of the file");
  }
  header->at = (const char *)bytes + start;
  header->end = header->at + length;
  return ERN_OK;
}

static ern_status find_type(const struct header *header, int *type) {
  for (*type = 0; *type < TYPES; (*type)++) {
    if (strcmp(header->descr, types[*type].descr) == 0) return ERN_OK;
  }
  const char *why = strchr(header->descr, 'O') != NULL ? " (pickled Python objects)"
                    : header->descr[0] == '>'          ? " (big endian)"
                                                       : "";
  return ern_fail(header->context, ERN_E_UNSUPPORTED, "%s: descr is '%s'%s, expected <f2, <f4, <f8, |u1, <i4 or <i8",
                  header->path, header->descr, why);
}

/* F16 and F64 become float. Values past float's range become infinite. */
static void load_items(void *data, const uint8_t *from, ern_npy_type type, size_t count, size_t bytes) {
  float *out = data;
  if (type == ERN_NPY_F16) {
    for (size_t i = 0; i < count; i++) out[i] = ern_half_to_float((uint16_t)(from[2 * i] | from[2 * i + 1] << 8));
  } else if (type == ERN_NPY_F64) {
    for (size_t i = 0; i < count; i++) {
      double value;
      memcpy(&value, from + 8 * i, sizeof value);
      out[i] = (float)value;
    }
  } else if (count > 0) {
    memcpy(data, from, count * bytes);
  }
}

/* Checks the header against the size of the file: *count items of types[*type] are its last `*bytes` bytes. */
static ern_status read_claims(const struct ern_file_reader *reader, struct header *header, int *type, size_t *count,
                              size_t *bytes) {
  const size_t head = reader->size < HEADER_LIMIT ? reader->size : HEADER_LIMIT;
  ern_context *context = reader->context;
  const char *path = reader->path;
  uint8_t *start = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(context, head, &start));
  ERN_TRY(ern_file_reader_take(reader, 0, start, head));
  ERN_TRY(find_header(header, start, head, reader->size));
  const size_t left = reader->size - (size_t)(header->end - (const char *)start);
  ERN_TRY(parse_header(header));
  ERN_TRY(find_type(header, type));
  if (header->fortran) {
    ERN_TRY(ern_fail(context, ERN_E_UNSUPPORTED, "%s: fortran_order is True, expected False (numpy.ascontiguousarray)",
                     path));
  }
  *count = 1;
  for (int i = 0; i < header->dims; i++) {
    if (ern_size_multiply(*count, header->shape[i], count)) continue;
    ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: shape: size %zu is past the end of the file", path, header->shape[i]));
  }
  const bool fits = ern_size_multiply(*count, types[*type].bytes, bytes);
  if (!fits || *bytes != left) {
    ERN_TRY(ern_fail(context, ERN_E_FORMAT, "%s: shape claims %zu items of %zu bytes, found %zu bytes", path, *count,
                     types[*type].bytes, left));
  }
fail:
  ern_release(context, start);
  return status;
}

ern_status ern_npy_read(ern_context *context, const char *path, struct ern_npy *array) {
  ern_status status = ERN_OK;
  struct header header = {.context = context, .path = path};
  struct ern_file_reader reader;
  uint8_t *from = NULL;
  size_t count = 0, bytes = 0;
  int type = 0;
  *array = (struct ern_npy){0};
  ERN_TRY(ern_file_reader_open(context, path, file_limit, &reader));
  ERN_TRY(read_claims(&reader, &header, &type, &count, &bytes));
  ERN_TRY(ERN_NEW(context, bytes, &from));
  ERN_TRY(ern_file_reader_take(&reader, reader.size - bytes, from, bytes));
  array->data = ern_allocate(context, count, types[type].loaded_bytes);
  ERN_TRY(ern_allocation_status(context, array->data));
  load_items(array->data, from, types[type].type, count, types[type].bytes);
  array->type = types[type].type;
  array->dims = header.dims;
  array->count = count;
  memcpy(array->shape, header.shape, sizeof header.shape);
fail:
  ern_file_reader_close(&reader);
  ern_release(context, from);
  return status;
}

void ern_npy_free(ern_context *context, struct ern_npy *array) {
  if (array == NULL) return;
  ern_release(context, array->data);
  *array = (struct ern_npy){0};
}

ern_status ern_npy_write_f32(ern_context *context, const char *path, const float *data, int dims, const size_t *shape) {
  ern_status status = ERN_OK;
  struct ern_file_writer writer = {0};
  enum { START = 10, HEADER_BYTES = 256 };
  char sizes[128] = "", start[START + HEADER_BYTES];
  size_t count = 1, bytes = 0;
  int used = 0;
  if (dims < 0 || dims > ERN_NPY_MAX_DIMS) {
    return ern_fail(context, ERN_E_ARGUMENT, "%s: %d dimensions, expected 0 to %d", path, dims, ERN_NPY_MAX_DIMS);
  }
  for (int i = 0; i < dims; i++) {
    if (!ern_size_multiply(count, shape[i], &count)) count = SIZE_MAX;
    used += snprintf(sizes + used, sizeof sizes - (size_t)used, "%zu, ", shape[i]);
  }
  if (!ern_size_multiply(count, sizeof(float), &bytes)) {
    return ern_fail(context, ERN_E_ARGUMENT, "%s: shape (%s) does not fit memory", path, sizes);
  }
  /* the data starts at a multiple of 64 bytes, as NumPy's own files do; the padding is blanks, its last byte a newline
   */
  const int length =
      snprintf(start + START, HEADER_BYTES, "{'descr': '<f4', 'fortran_order': False, 'shape': (%s), }", sizes);
  const size_t padded = (size_t)(START + length + 1 + 63) / 64 * 64;
  memcpy(start, "\x93NUMPY\x01\x00", 8);
  start[8] = (char)((padded - START) & 255);
  start[9] = (char)((padded - START) >> 8);
  memset(start + START + length, ' ', padded - START - (size_t)length);
  start[padded - 1] = '\n';
  ERN_TRY(ern_file_writer_open(context, path, ERN_EXISTING_BY_CONTEXT, &writer));
  ERN_TRY(ern_file_writer_write(&writer, start, padded));
  ERN_TRY(ern_file_writer_write(&writer, data, bytes));
  return ern_file_writer_commit(&writer);
fail:
  ern_file_writer_abandon(&writer);
  return status;
}
