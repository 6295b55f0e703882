/* SPDX-License-Identifier: MIT */
#include "io/safetensors.h"

#include <jansson.h>
#include <stdlib.h>
#include <string.h>

#include "core/memory.h"
#include "io/file.h"
#include "io/half.h"
#include "io/json.h"

static const size_t file_limit = (size_t)1 << 30; /* the largest model's training state is half of that */
enum { LENGTH_BYTES = 8, HEADER_LIMIT = 1 << 24, JSON_LIMIT = 1 << 27 };
static const char metadata_key[] = "__metadata__";

static const struct {
  const char *name;
  size_t bytes;
} dtypes[] = {[ERN_F32] = {"F32", 4}, [ERN_F16] = {"F16", 2},   [ERN_BF16] = {"BF16", 2}, [ERN_U8] = {"U8", 1},
              [ERN_I32] = {"I32", 4}, [ERN_BOOL] = {"BOOL", 1}, [ERN_I64] = {"I64", 8},   [ERN_F64] = {"F64", 8},
              [ERN_I8] = {"I8", 1},   [ERN_I16] = {"I16", 2}};
enum { DTYPES = sizeof dtypes / sizeof dtypes[0] };

const char *ern_dtype_name(ern_dtype dtype) { return (unsigned)dtype < DTYPES ? dtypes[dtype].name : "?"; }
size_t ern_dtype_bytes(ern_dtype dtype) { return (unsigned)dtype < DTYPES ? dtypes[dtype].bytes : 0; }

/* Memory of a file besides its lists. */
struct storage {
  uint8_t *bytes;   /* bytes of the tensors: the whole file, or the part after its header */
  uint8_t *aligned; /* copies of the tensors that are unaligned in it; NULL: none are */
  json_t *header;   /* names and metadata point into it */
};

/* Common arguments of the functions below. */
struct reading {
  ern_context *context;
  const char *path;
  size_t data_bytes; /* of the file, after the header */
};

/* A JSON number as a size; false where it is none. */
static bool read_size(const json_t *value, size_t *size) {
  if (!json_is_integer(value) || json_integer_value(value) < 0) return false;
  *size = (size_t)json_integer_value(value);
  return true;
}

static ern_status read_dtype(const struct reading *reading, const char *name, const json_t *entry, ern_dtype *dtype) {
  const json_t *word = json_object_get(entry, "dtype");
  if (!json_is_string(word)) {
    return ern_fail(reading->context, ERN_E_FORMAT, "%s: tensor %s: dtype is missing or no string", reading->path,
                    name);
  }
  for (int i = 0; i < DTYPES; i++) {
    if (strcmp(json_string_value(word), dtypes[i].name) != 0) continue;
    *dtype = (ern_dtype)i;
    return ERN_OK;
  }
  return ern_fail(reading->context, ERN_E_UNSUPPORTED,
                  "%s: tensor %s: dtype is %s, expected F32, F16, BF16, F64, U8, BOOL, I8, I16, I32 or I64",
                  reading->path, name, json_string_value(word));
}

static ern_status read_shape(const struct reading *reading, struct ern_tensor *tensor, const json_t *entry) {
  const json_t *shape = json_object_get(entry, "shape");
  if (!json_is_array(shape)) {
    return ern_fail(reading->context, ERN_E_FORMAT, "%s: tensor %s: shape is missing or no list", reading->path,
                    tensor->name);
  }
  const size_t dims = json_array_size(shape);
  if (dims > ERN_TENSOR_MAX_DIMS) {
    return ern_fail(reading->context, ERN_E_SHAPE, "%s: tensor %s: shape has %zu sizes, expected at most %d",
                    reading->path, tensor->name, dims, ERN_TENSOR_MAX_DIMS);
  }
  tensor->dims = (int)dims;
  tensor->count = 1;
  for (size_t i = 0; i < dims; i++) {
    const bool valid = read_size(json_array_get(shape, i), &tensor->shape[i]) &&
                       ern_size_multiply(tensor->count, tensor->shape[i], &tensor->count);
    if (valid) continue;
    return ern_fail(reading->context, ERN_E_FORMAT,
                    "%s: tensor %s: shape[%zu] is negative, no whole number or too large", reading->path, tensor->name,
                    i);
  }
  return ERN_OK;
}

static ern_status read_tensor(const struct reading *reading, const char *name, const json_t *entry,
                              struct ern_tensor *tensor) {
  ern_status status = ERN_OK;
  size_t begin = 0, end = 0, bytes = 0;
  tensor->name = name;
  if (name[0] == 0) return ern_fail(reading->context, ERN_E_FORMAT, "%s: a tensor has an empty name", reading->path);
  if (!json_is_object(entry)) {
    return ern_fail(reading->context, ERN_E_FORMAT, "%s: tensor %s: entry is no object", reading->path, name);
  }
  ERN_TRY(read_dtype(reading, name, entry, &tensor->dtype));
  ERN_TRY(read_shape(reading, tensor, entry));
  const json_t *offsets = json_object_get(entry, "data_offsets");
  if (json_array_size(offsets) != 2 || !read_size(json_array_get(offsets, 0), &begin) ||
      !read_size(json_array_get(offsets, 1), &end)) {
    return ern_fail(reading->context, ERN_E_FORMAT, "%s: tensor %s: data_offsets is no pair of sizes", reading->path,
                    name);
  }
  if (begin > end || end > reading->data_bytes) {
    return ern_fail(reading->context, ERN_E_FORMAT,
                    "%s: tensor %s: data_offsets are [%zu, %zu], expected rising and at most %zu", reading->path, name,
                    begin, end, reading->data_bytes);
  }
  if (!ern_size_multiply(tensor->count, dtypes[tensor->dtype].bytes, &bytes) || bytes != end - begin) {
    return ern_fail(reading->context, ERN_E_FORMAT,
                    "%s: tensor %s: data_offsets hold %zu bytes, expected %zu items of %zu bytes", reading->path, name,
                    end - begin, tensor->count, dtypes[tensor->dtype].bytes);
  }
  tensor->at = begin;
fail:
  return status;
}

static size_t tensor_bytes(const struct ern_tensor *tensor) { return tensor->count * dtypes[tensor->dtype].bytes; }

/* By position in the file; an empty tensor before the one that starts at the same position. */
static int compare_places(const void *left, const void *right) {
  const struct ern_tensor *a = left, *b = right;
  if (a->at != b->at) return a->at < b->at ? -1 : 1;
  const size_t bytes_a = tensor_bytes(a), bytes_b = tensor_bytes(b);
  return bytes_a != bytes_b ? (bytes_a < bytes_b ? -1 : 1) : strcmp(a->name, b->name);
}

/* The sorted tensors must cover the data without overlap, gap or remainder. */
static ern_status check_places(const struct reading *reading, const struct ern_tensor_file *file) {
  size_t covered = 0;
  for (size_t i = 0; i < file->tensor_count; i++) {
    const struct ern_tensor *tensor = &file->tensors[i];
    if (tensor->at != covered) {
      return ern_fail(reading->context, ERN_E_FORMAT, "%s: tensor %s: data_offsets begin at %zu, expected %zu: %s",
                      reading->path, tensor->name, tensor->at, covered,
                      tensor->at < covered ? "it overlaps the one before" : "there is a gap before it");
    }
    covered += tensor_bytes(tensor);
  }
  if (covered == reading->data_bytes) return ERN_OK;
  return ern_fail(reading->context, ERN_E_FORMAT, "%s: the tensors hold %zu bytes, found %zu after the header",
                  reading->path, covered, reading->data_bytes);
}

static ern_status read_metadata(const struct reading *reading, json_t *entry, struct ern_tensor_file *file) {
  ern_status status = ERN_OK;
  const char *key;
  json_t *value;
  if (entry == NULL) return ERN_OK;
  if (!json_is_object(entry)) {
    return ern_fail(reading->context, ERN_E_FORMAT, "%s: %s is no object", reading->path, metadata_key);
  }
  ERN_TRY(ERN_NEW(reading->context, json_object_size(entry), &file->metadata));
  json_object_foreach(entry, key, value) {
    if (!json_is_string(value)) {
      return ern_fail(reading->context, ERN_E_FORMAT, "%s: %s: %s is no string", reading->path, metadata_key, key);
    }
    file->metadata[file->metadata_count++] = (struct ern_metadata){key, json_string_value(value)};
  }
fail:
  return status;
}

static bool is_aligned(const struct ern_tensor *tensor) {
  return (uintptr_t)tensor->data % dtypes[tensor->dtype].bytes == 0;
}

/* Points the tensors to their bytes, `data` being those after the header. A file may have a tensor at any offset, but
 * struct ern_tensor guarantees alignment to the size of its items. */
static ern_status place_tensors(const struct reading *reading, const uint8_t *data, struct ern_tensor_file *file) {
  struct storage *storage = file->private_data;
  ern_status status = ERN_OK;
  size_t aligned_bytes = 0;
  for (size_t i = 0; i < file->tensor_count; i++) file->tensors[i].data = data + file->tensors[i].at;
  for (size_t i = 0; i < file->tensor_count; i++) {
    if (!is_aligned(&file->tensors[i])) aligned_bytes += (tensor_bytes(&file->tensors[i]) + 7) / 8 * 8;
  }
  if (aligned_bytes == 0) return ERN_OK;
  ERN_TRY(ERN_NEW(reading->context, aligned_bytes, &storage->aligned));
  uint8_t *at = storage->aligned;
  for (size_t i = 0; i < file->tensor_count; i++) {
    struct ern_tensor *tensor = &file->tensors[i];
    if (is_aligned(tensor)) continue;
    const size_t bytes = tensor_bytes(tensor);
    memcpy(at, tensor->data, bytes);
    tensor->data = at;
    at += (bytes + 7) / 8 * 8;
  }
fail:
  return status;
}

/* The 8 bytes that a file of `size` bytes begins with: how many bytes of JSON text follow. */
static ern_status read_length(struct reading *reading, const uint8_t *bytes, size_t size, size_t *length) {
  if (size < LENGTH_BYTES) {
    return ern_fail(reading->context, ERN_E_FORMAT, "%s: is no safetensors file: found %zu bytes, expected at least %d",
                    reading->path, size, LENGTH_BYTES);
  }
  uint64_t claimed = 0;
  for (int i = 0; i < LENGTH_BYTES; i++) claimed |= (uint64_t)bytes[i] << (8 * i);
  const size_t left = size - LENGTH_BYTES, most = left < HEADER_LIMIT ? left : HEADER_LIMIT;
  if (claimed > most) {
    return ern_fail(reading->context, ERN_E_FORMAT, "%s: header length is %llu, expected at most %zu", reading->path,
                    (unsigned long long)claimed, most);
  }
  *length = (size_t)claimed;
  reading->data_bytes = left - *length;
  return ERN_OK;
}

/* Metadata and tensors from the JSON text, except the pointers to their bytes. */
static ern_status read_header(const struct reading *reading, const char *text, size_t length,
                              struct ern_tensor_file *file) {
  struct storage *storage = file->private_data;
  ern_status status = ERN_OK;
  const char *name;
  json_t *entry;
  ERN_TRY(ern_json_parse(reading->context, reading->path, "header: ", text, length, JSON_LIMIT, &storage->header));
  ERN_TRY(ERN_NEW(reading->context, json_object_size(storage->header), &file->tensors));
  ERN_TRY(read_metadata(reading, json_object_get(storage->header, metadata_key), file));
  json_object_foreach(storage->header, name, entry) {
    if (strcmp(name, metadata_key) == 0) continue;
    ERN_TRY(read_tensor(reading, name, entry, &file->tensors[file->tensor_count]));
    file->tensor_count++;
  }
  qsort(file->tensors, file->tensor_count, sizeof *file->tensors, compare_places);
  status = check_places(reading, file);
fail:
  return status;
}

ern_status ern_safetensors_read(ern_context *context, const char *path, struct ern_tensor_file *file) {
  struct reading reading = {.context = context, .path = path};
  struct ern_file_reader reader;
  uint8_t start[LENGTH_BYTES] = {0};
  char *text = NULL;
  struct storage *storage = NULL;
  size_t length = 0;
  *file = (struct ern_tensor_file){0};
  ern_status status = ern_file_reader_open(context, path, file_limit, &reader);
  if (status != ERN_OK) return status;
  ERN_TRY(ERN_NEW(context, 1, &storage));
  file->private_data = storage;
  ERN_TRY(ern_file_reader_take(&reader, 0, start, reader.size < LENGTH_BYTES ? reader.size : LENGTH_BYTES));
  ERN_TRY(read_length(&reading, start, reader.size, &length));
  ERN_TRY(ERN_NEW(context, length, &text));
  ERN_TRY(ern_file_reader_take(&reader, LENGTH_BYTES, text, length));
  ERN_TRY(read_header(&reading, text, length, file));
  ERN_TRY(ERN_NEW(context, reading.data_bytes, &storage->bytes));
  ERN_TRY(ern_file_reader_take(&reader, LENGTH_BYTES + length, storage->bytes, reading.data_bytes));
  status = place_tensors(&reading, storage->bytes, file);
fail:
  ern_release(context, text);
  ern_file_reader_close(&reader);
  if (status != ERN_OK) ern_tensor_file_free(context, file);
  return status;
}

ern_status ern_safetensors_open(ern_context *context, const char *path, uint8_t *bytes, size_t size,
                                struct ern_tensor_file *file) {
  struct reading reading = {.context = context, .path = path};
  struct storage *storage = NULL;
  size_t length = 0;
  *file = (struct ern_tensor_file){0};
  ern_status status = ERN_NEW(context, 1, &storage);
  if (status != ERN_OK) {
    ern_release(context, bytes);
    return status;
  }
  file->private_data = storage;
  storage->bytes = bytes;
  ERN_TRY(read_length(&reading, bytes, size, &length));
  ERN_TRY(read_header(&reading, (const char *)bytes + LENGTH_BYTES, length, file));
  ERN_TRY(place_tensors(&reading, bytes + LENGTH_BYTES + length, file));
  return ERN_OK;
fail:
  ern_tensor_file_free(context, file);
  return status;
}

void ern_tensor_file_free(ern_context *context, struct ern_tensor_file *file) {
  if (file == NULL) return;
  struct storage *storage = file->private_data;
  if (file->release != NULL) {
    file->release(context, file->private_data);
  } else if (storage != NULL) {
    json_decref(storage->header);
    ern_release(context, storage->bytes);
    ern_release(context, storage->aligned);
    ern_release(context, storage);
  }
  ern_release(context, file->tensors);
  ern_release(context, file->metadata);
  *file = (struct ern_tensor_file){0};
}

const struct ern_tensor *ern_tensor_file_find(const struct ern_tensor_file *file, const char *name) {
  for (size_t i = 0; i < file->tensor_count; i++) {
    if (strcmp(file->tensors[i].name, name) == 0) return &file->tensors[i];
  }
  return NULL;
}

const char *ern_tensor_file_metadata(const struct ern_tensor_file *file, const char *key) {
  for (size_t i = 0; i < file->metadata_count; i++) {
    if (strcmp(file->metadata[i].key, key) == 0) return file->metadata[i].value;
  }
  return NULL;
}

ern_status ern_tensor_to_float(ern_context *context, const struct ern_tensor *tensor, float *out) {
  const uint16_t *words = tensor->data;
  const double *doubles = tensor->data;
  switch (tensor->dtype) {
    case ERN_F32:
      if (tensor->count > 0) memcpy(out, tensor->data, tensor->count * sizeof(float));
      return ERN_OK;
    case ERN_F16:
      for (size_t i = 0; i < tensor->count; i++) out[i] = ern_half_to_float(words[i]);
      return ERN_OK;
    case ERN_BF16:
      for (size_t i = 0; i < tensor->count; i++) out[i] = ern_bfloat16_to_float(words[i]);
      return ERN_OK;
    case ERN_F64:
      for (size_t i = 0; i < tensor->count; i++) out[i] = (float)doubles[i];
      return ERN_OK;
    case ERN_U8:
    case ERN_BOOL:
    case ERN_I8:
    case ERN_I16:
    case ERN_I32:
    case ERN_I64: break;
  }
  return ern_fail(context, ERN_E_MISMATCH, "tensor %s: dtype is %s, expected F32, F16, BF16 or F64", tensor->name,
                  ern_dtype_name(tensor->dtype));
}

/* ---- writing ----------------------------------------------------------------------------------------------------- */

static ern_status check_tensor(ern_context *context, const char *path, const struct ern_tensor *tensor,
                               const json_t *header) {
  if ((unsigned)tensor->dtype >= DTYPES || tensor->dims < 0 || tensor->dims > ERN_TENSOR_MAX_DIMS) {
    return ern_fail(context, ERN_E_ARGUMENT, "%s: tensor %s: dtype %d with %d sizes cannot be written", path,
                    tensor->name, (int)tensor->dtype, tensor->dims);
  }
  size_t count = 1, bytes = 0;
  for (int i = 0; i < tensor->dims; i++) {
    if (!ern_size_multiply(count, tensor->shape[i], &count)) count = SIZE_MAX;
  }
  if (count != tensor->count || !ern_size_multiply(count, dtypes[tensor->dtype].bytes, &bytes)) {
    return ern_fail(context, ERN_E_ARGUMENT, "%s: tensor %s: count is %zu, expected %zu, the product of its shape",
                    path, tensor->name, tensor->count, count);
  }
  if (tensor->name[0] == 0 || strcmp(tensor->name, metadata_key) == 0 ||
      json_object_get(header, tensor->name) != NULL) {
    return ern_fail(context, ERN_E_ARGUMENT, "%s: tensor name \"%s\" is empty, reserved or there twice", path,
                    tensor->name);
  }
  return ERN_OK;
}

/* One entry of the header; `begin` moves on to the end of the tensor's bytes. */
static ern_status add_tensor(ern_context *context, const char *path, const struct ern_tensor *tensor, json_t *header,
                             size_t *begin) {
  ern_status status = ERN_OK;
  size_t end = 0;
  ERN_TRY(check_tensor(context, path, tensor, header));
  if (!ern_size_add(*begin, tensor_bytes(tensor), &end) || end > file_limit) {
    return ern_fail(context, ERN_E_ARGUMENT, "%s: tensor %s: the file would be longer than %zu bytes", path,
                    tensor->name, file_limit);
  }
  json_t *shape = json_array();
  for (int i = 0; i < tensor->dims; i++) {
    if (json_array_append_new(shape, json_integer((json_int_t)tensor->shape[i])) == 0) continue;
    json_decref(shape);
    return ern_fail(context, ERN_E_NO_MEMORY, "%s: header: no memory", path);
  }
  json_t *entry = json_pack("{s:s, s:o, s:[I, I]}", "dtype", ern_dtype_name(tensor->dtype), "shape", shape,
                            "data_offsets", (json_int_t)*begin, (json_int_t)end);
  if (entry == NULL || json_object_set_new(header, tensor->name, entry) != 0) {
    return ern_fail(context, ERN_E_ARGUMENT, "%s: tensor name \"%s\" is no UTF-8, or no memory", path, tensor->name);
  }
  *begin = end;
fail:
  return status;
}

static ern_status add_metadata(ern_context *context, const char *path, const struct ern_metadata *metadata,
                               size_t count, json_t *header) {
  if (count == 0) return ERN_OK;
  json_t *object = json_object();
  if (json_object_set_new(header, metadata_key, object) != 0) {
    return ern_fail(context, ERN_E_NO_MEMORY, "%s: header: no memory", path);
  }
  for (size_t i = 0; i < count; i++) {
    if (json_object_get(object, metadata[i].key) == NULL &&
        json_object_set_new(object, metadata[i].key, json_string(metadata[i].value)) == 0) {
      continue;
    }
    return ern_fail(context, ERN_E_ARGUMENT, "%s: %s: key or value of \"%s\" is no UTF-8, or it is there twice", path,
                    metadata_key, metadata[i].key);
  }
  return ERN_OK;
}

/* The length, the text, and blanks up to a multiple of 8 so that the data is aligned. */
static ern_status write_header(struct ern_file_writer *writer, const char *text) {
  ern_status status = ERN_OK;
  const size_t length = strlen(text), padded = (length + 7) / 8 * 8;
  uint8_t start[LENGTH_BYTES];
  if (padded > HEADER_LIMIT) {
    return ern_fail(writer->context, ERN_E_ARGUMENT, "%s: header is %zu bytes, expected at most %d", writer->path,
                    padded, HEADER_LIMIT);
  }
  for (int i = 0; i < LENGTH_BYTES; i++) start[i] = (uint8_t)((uint64_t)padded >> (8 * i));
  ERN_TRY(ern_file_writer_write(writer, start, LENGTH_BYTES));
  ERN_TRY(ern_file_writer_write(writer, text, length));
  ERN_TRY(ern_file_writer_write(writer, "       ", padded - length));
fail:
  return status;
}

ern_status ern_safetensors_write(ern_context *context, const char *path, const struct ern_tensor *tensors,
                                 size_t tensor_count, const struct ern_metadata *metadata, size_t metadata_count,
                                 enum ern_existing existing) {
  ern_status status = ERN_OK;
  struct ern_file_writer writer = {0};
  char *text = NULL;
  size_t bytes = 0;
  json_t *header = json_object();
  ERN_TRY(add_metadata(context, path, metadata, metadata_count, header));
  for (size_t i = 0; i < tensor_count; i++) ERN_TRY(add_tensor(context, path, &tensors[i], header, &bytes));
  text = ern_json_text(context, header, JSON_COMPACT);
  if (text == NULL) ERN_TRY(ern_fail(context, ERN_E_NO_MEMORY, "%s: header: no memory", path));
  ERN_TRY(ern_file_writer_open(context, path, existing, &writer));
  ERN_TRY(write_header(&writer, text));
  for (size_t i = 0; i < tensor_count; i++) {
    ERN_TRY(ern_file_writer_write(&writer, tensors[i].data, tensor_bytes(&tensors[i])));
  }
  status = ern_file_writer_commit(&writer);
fail:
  ern_file_writer_abandon(&writer);
  ern_release(context, text);
  json_decref(header);
  return status;
}
