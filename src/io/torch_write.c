/* SPDX-License-Identifier: MIT
 * Writes a tree of values and tensors as the zip that torch.load opens: data.pkl in protocol 2, with only the opcodes
 * that torch.load(weights_only=True) supports, and one uncompressed entry per tensor. */
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <zip.h>

#include "core/memory.h"
#include "io/file.h"
#include "io/torch_zip.h"

enum { DEPTH_LIMIT = 64 };

/* A number that is written as a zero-dimensional tensor. */
struct number {
  struct number *before;
  struct ern_tensor tensor;
  double value;
};

struct writing {
  bool numbers; /* write floats as such tensors */
  struct number *number;
  ern_context *context;
  const char *path;
  const struct ern_tensor *tensors;
  size_t tensor_count;
  uint8_t *bytes; /* of data.pkl */
  size_t count, capacity;
  struct named_tensor {
    const struct ern_tensor *tensor;
    size_t key;                   /* 1 + the number of its entry; 0: it has none yet */
  } * named;                      /* [tensor_count] by name */
  const struct ern_tensor **used; /* [ERN_TORCH_ENTRIES] in the order of their keys */
  size_t used_count;
  ern_status status; /* of the first failure; later calls then do nothing */
};

static void put(struct writing *w, const void *bytes, size_t count) {
  uint8_t *fresh = NULL;
  if (w->status != ERN_OK) return;
  if (count > w->capacity - w->count) {
    const size_t capacity = 2 * w->capacity + count + 4096;
    w->status = ERN_NEW(w->context, capacity, &fresh);
    if (w->status != ERN_OK) return;
    if (w->count > 0) memcpy(fresh, w->bytes, w->count);
    ern_release(w->context, w->bytes);
    w->bytes = fresh;
    w->capacity = capacity;
  }
  memcpy(w->bytes + w->count, bytes, count);
  w->count += count;
}

static void put_byte(struct writing *w, int byte) { put(w, &(uint8_t){(uint8_t)byte}, 1); }

static void put_little(struct writing *w, uint64_t number, int bytes) {
  for (int i = 0; i < bytes; i++) put_byte(w, (int)(number >> (8 * i) & 255));
}

static void put_text(struct writing *w, const char *text) {
  put_byte(w, 'X');
  put_little(w, strlen(text), 4);
  put(w, text, strlen(text));
}

static void put_integer(struct writing *w, int64_t number) {
  if (number >= 0 && number < 256) {
    put_byte(w, 'K');
    put_little(w, (uint64_t)number, 1);
  } else if (number >= INT32_MIN && number <= INT32_MAX) {
    put_byte(w, 'J');
    put_little(w, (uint64_t)number, 4);
  } else {
    put_byte(w, 0x8a);
    put_byte(w, 8);
    put_little(w, (uint64_t)number, 8);
  }
}

static void put_float(struct writing *w, double number) {
  uint64_t bits;
  memcpy(&bits, &number, sizeof bits);
  put_byte(w, 'G');
  for (int i = 7; i >= 0; i--) put_byte(w, (int)(bits >> (8 * i) & 255));
}

static void put_global(struct writing *w, const char *module, const char *name) {
  put_byte(w, 'c');
  put(w, module, strlen(module));
  put_byte(w, '\n');
  put(w, name, strlen(name));
  put_byte(w, '\n');
}

static void put_ordered(struct writing *w) {
  put_global(w, "collections", "OrderedDict");
  put_byte(w, ')');
  put_byte(w, 'R');
}

static void wrong(struct writing *w, const char *what) {
  if (w->status == ERN_OK) w->status = ern_fail(w->context, ERN_E_FORMAT, "%s: the tree to write: %s", w->path, what);
}

/* ---- tensors ----------------------------------------------------------------------------------------------------- */

static const char *storage_type(ern_dtype dtype) {
  switch (dtype) {
    case ERN_F32: return "FloatStorage";
    case ERN_F16: return "HalfStorage";
    case ERN_BF16: return "BFloat16Storage";
    case ERN_F64: return "DoubleStorage";
    case ERN_U8: return "ByteStorage";
    case ERN_I8: return "CharStorage";
    case ERN_BOOL: return "BoolStorage";
    case ERN_I16: return "ShortStorage";
    case ERN_I32: return "IntStorage";
    case ERN_I64: return "LongStorage";
  }
  return "";
}

static int compare_tensors(const void *left, const void *right) {
  return strcmp(((const struct named_tensor *)left)->tensor->name, ((const struct named_tensor *)right)->tensor->name);
}

/* Makes the lists. */
static ern_status sort_tensors(struct writing *w) {
  ern_status status = ERN_NEW(w->context, w->tensor_count, &w->named);
  if (status == ERN_OK) status = ERN_NEW(w->context, ERN_TORCH_ENTRIES, &w->used);
  if (status != ERN_OK) return status;
  for (size_t i = 0; i < w->tensor_count; i++) w->named[i].tensor = &w->tensors[i];
  qsort(w->named, w->tensor_count, sizeof *w->named, compare_tensors);
  return ERN_OK;
}

/* The number of a new entry for the tensor. Three entries of the zip are not tensors. */
static size_t take_entry(struct writing *w, const struct ern_tensor *tensor) {
  if (w->used_count + 3 > ERN_TORCH_ENTRIES) {
    if (w->status == ERN_OK)
      w->status = ern_fail(w->context, ERN_E_UNSUPPORTED, "%s: more than %d tensors, which would not be read again",
                           w->path, ERN_TORCH_ENTRIES - 3);
    return 0;
  }
  w->used[w->used_count] = tensor;
  return w->used_count++;
}

static void put_entry(struct writing *w, const struct ern_tensor *tensor, size_t entry);

/* A tensor that is named twice has one entry. */
static void put_tensor(struct writing *w, const char *name) {
  const struct ern_tensor like = {.name = name};
  const struct named_tensor wanted = {.tensor = &like};
  struct named_tensor *found =
      name != NULL ? bsearch(&wanted, w->named, w->tensor_count, sizeof wanted, compare_tensors) : NULL;
  if (found == NULL) {
    if (w->status == ERN_OK)
      w->status = ern_fail(w->context, ERN_E_MISSING, "%s: the tree to write names a tensor %s that is not there",
                           w->path, name != NULL ? name : "(none)");
    return;
  }
  if (found->key == 0) found->key = 1 + take_entry(w, found->tensor);
  put_entry(w, found->tensor, found->key - 1);
}

static void put_entry(struct writing *w, const struct ern_tensor *tensor, size_t entry) {
  char key[32];
  snprintf(key, sizeof key, "%zu", entry);
  put_global(w, "torch._utils", "_rebuild_tensor_v2");
  put(w, "((", 2);
  put_text(w, "storage");
  put_global(w, "torch", storage_type(tensor->dtype));
  put_text(w, key);
  put_text(w, "cpu");
  put_integer(w, (int64_t)tensor->count);
  put(w, "tQ", 2);
  put_integer(w, 0);
  put_byte(w, '(');
  for (int d = 0; d < tensor->dims; d++) put_integer(w, (int64_t)tensor->shape[d]);
  put(w, "t(", 2);
  for (int d = 0; d < tensor->dims; d++) {
    size_t stride = 1;
    for (int e = d + 1; e < tensor->dims; e++) stride *= tensor->shape[e] > 0 ? tensor->shape[e] : 1;
    put_integer(w, (int64_t)stride);
  }
  put_byte(w, 't');
  put_byte(w, 0x89); /* requires no gradient */
  put_ordered(w);    /* no hooks */
  put(w, "tR", 2);
}

static void put_number(struct writing *w, double value) {
  struct number *number = NULL;
  if (!w->numbers) {
    put_float(w, value);
    return;
  }
  w->status = ERN_NEW(w->context, 1, &number);
  if (w->status != ERN_OK) return;
  *number = (struct number){.before = w->number, .value = value};
  number->tensor = (struct ern_tensor){.name = "", .dtype = ERN_F64, .count = 1, .data = &number->value};
  w->number = number;
  put_entry(w, &number->tensor, take_entry(w, &number->tensor));
}

/* ---- the tree ---------------------------------------------------------------------------------------------------- */

static void put_value(struct writing *w, const json_t *value, int depth);

/* `end` is the opcode that takes the values above the mark. */
static void put_items(struct writing *w, const json_t *array, int end, int depth) {
  put_byte(w, '(');
  for (size_t i = 0; i < json_array_size(array); i++) put_value(w, json_array_get(array, i), depth + 1);
  put_byte(w, end);
}

static void put_pairs(struct writing *w, const json_t *array, int depth) {
  if (json_array_size(array) == 0) return;
  put_byte(w, '(');
  for (size_t i = 0; i < json_array_size(array); i++) {
    const json_t *pair = json_array_get(array, i);
    if (json_array_size(pair) != 2) {
      wrong(w, "a dict holds something that is no pair");
      return;
    }
    put_value(w, json_array_get(pair, 0), depth + 1);
    put_value(w, json_array_get(pair, 1), depth + 1);
  }
  put_byte(w, 'u');
}

/* As a latin1-encoded text, which is how protocol 2 represents bytes. */
static void put_bytes(struct writing *w, const char *hex) {
  const size_t digits = strlen(hex), length = digits / 2, mark = w->count + 1;
  if (digits % 2 != 0 || strspn(hex, "0123456789abcdef") != digits) {
    wrong(w, "bytes that are no hex digits");
    return;
  }
  put_global(w, "_codecs", "encode");
  put(w, "(X", 2);
  const size_t at = w->count;
  put_little(w, 0, 4);
  for (size_t i = 0; i < length; i++) {
    unsigned byte = 0;
    sscanf(hex + 2 * i, "%2x", &byte);
    if (byte >= 0x80) put_byte(w, (int)(0xc0 | byte >> 6));
    put_byte(w, byte >= 0x80 ? (int)(0x80 | (byte & 0x3f)) : (int)byte);
  }
  if (w->status != ERN_OK || w->count < mark) return;
  const size_t written = w->count - at - 4;
  for (int i = 0; i < 4; i++) w->bytes[at + (size_t)i] = (uint8_t)(written >> (8 * i));
  put_text(w, "latin1");
  put(w, "tR", 2);
}

static void put_object(struct writing *w, const json_t *object, int depth) {
  const char *name = json_object_iter_key(json_object_iter((json_t *)(uintptr_t)object));
  const json_t *value = name != NULL ? json_object_get(object, name) : NULL;
  const char *text = json_string_value(value);
  if (json_object_size(object) != 1) {
    wrong(w, "an object without its one name");
  } else if (strcmp(name, "dict") == 0 && json_is_array(value)) {
    put_byte(w, '}');
    put_pairs(w, value, depth);
  } else if (strcmp(name, "ordered") == 0 && json_is_array(value)) {
    put_ordered(w);
    put_pairs(w, value, depth);
  } else if (strcmp(name, "tuple") == 0 && json_is_array(value)) {
    put_items(w, value, 't', depth);
  } else if (strcmp(name, "tensor") == 0) {
    put_tensor(w, text);
  } else if (strcmp(name, "float") == 0 && text != NULL) {
    put_number(w, strcmp(text, "nan") == 0 ? (double)NAN : (text[0] == '-' ? -(double)INFINITY : (double)INFINITY));
  } else if (strcmp(name, "bytes") == 0 && text != NULL) {
    put_bytes(w, text);
  } else {
    wrong(w, "an object of an unknown kind");
  }
}

static void put_value(struct writing *w, const json_t *value, int depth) {
  if (w->status != ERN_OK) return;
  if (value == NULL || depth > DEPTH_LIMIT) {
    wrong(w, "it is nested too deep");
    return;
  }
  switch (json_typeof(value)) {
    case JSON_NULL: put_byte(w, 'N'); break;
    case JSON_TRUE: put_byte(w, 0x88); break;
    case JSON_FALSE: put_byte(w, 0x89); break;
    case JSON_INTEGER: put_integer(w, (int64_t)json_integer_value(value)); break;
    case JSON_REAL: put_number(w, json_real_value(value)); break;
    case JSON_STRING: put_text(w, json_string_value(value)); break;
    case JSON_ARRAY:
      put_byte(w, ']');
      if (json_array_size(value) > 0) put_items(w, value, 'e', depth);
      break;
    case JSON_OBJECT: put_object(w, value, depth); break;
  }
}

/* ---- the zip ----------------------------------------------------------------------------------------------------- */

static ern_status add_entry(struct writing *w, zip_t *zip, const char *name, const void *bytes, size_t count) {
  zip_source_t *source = zip_source_buffer(zip, count > 0 ? bytes : "", count, 0);
  const zip_int64_t index = source != NULL ? zip_file_add(zip, name, source, ZIP_FL_ENC_UTF_8) : -1;
  /* 1980-01-01: the same input gives the same file */
  if (index >= 0 && zip_set_file_compression(zip, (zip_uint64_t)index, ZIP_CM_STORE, 0) == 0 &&
      zip_file_set_dostime(zip, (zip_uint64_t)index, 0, 33, 0) == 0)
    return ERN_OK;
  if (index < 0) zip_source_free(source);
  return ern_fail(w->context, ERN_E_IO, "%s: %s: %s", w->path, name, zip_strerror(zip));
}

static ern_status fail_zip(const struct writing *w, zip_error_t *error) {
  const ern_status status =
      ern_fail(w->context, ERN_E_NO_MEMORY, "%s: cannot be made: %s", w->path, zip_error_strerror(error));
  zip_error_fini(error);
  return status;
}

static ern_status add_entries(struct writing *w, zip_t *zip) {
  ern_status status = add_entry(w, zip, "archive/data.pkl", w->bytes, w->count);
  for (size_t i = 0; i < w->used_count && status == ERN_OK; i++) {
    char name[48];
    snprintf(name, sizeof name, "archive/data/%zu", i);
    status = add_entry(w, zip, name, w->used[i]->data, w->used[i]->count * ern_dtype_bytes(w->used[i]->dtype));
  }
  return status == ERN_OK ? add_entry(w, zip, "archive/version", "3\n", 2) : status;
}

/* Writes the zip into memory: libzip would make its own temporary file beside the output. */
static ern_status make_zip(struct writing *w, zip_source_t *memory) {
  zip_error_t error;
  zip_error_init(&error);
  zip_t *zip = zip_open_from_source(memory, ZIP_TRUNCATE, &error);
  if (zip == NULL) return fail_zip(w, &error);
  zip_source_keep(memory); /* the archive takes over one reference */
  const ern_status status = add_entries(w, zip);
  if (status != ERN_OK)
    zip_discard(zip);
  else if (zip_close(zip) != 0) {
    const ern_status failed = ern_fail(w->context, ERN_E_IO, "%s: cannot be made: %s", w->path, zip_strerror(zip));
    zip_discard(zip);
    return failed;
  }
  return status;
}

static ern_status copy_source(struct writing *w, zip_source_t *memory, struct ern_file_writer *writer) {
  uint8_t chunk[1 << 14];
  zip_int64_t got = zip_source_open(memory) == 0 ? 1 : -1;
  while (got > 0) {
    got = zip_source_read(memory, chunk, sizeof chunk);
    const ern_status status = got > 0 ? ern_file_writer_write(writer, chunk, (size_t)got) : ERN_OK;
    if (status != ERN_OK) return status;
  }
  if (got < 0) return ern_fail(w->context, ERN_E_IO, "%s: cannot be made: libzip cannot read its own archive", w->path);
  return ERN_OK;
}

static ern_status write_zip(struct writing *w) {
  struct ern_file_writer writer = {0};
  ern_status status = ERN_OK;
  zip_error_t error;
  zip_error_init(&error);
  zip_source_t *memory = zip_source_buffer_create(NULL, 0, 0, &error);
  if (memory == NULL) return fail_zip(w, &error);
  ERN_TRY(ern_file_writer_open(w->context, w->path, ERN_EXISTING_BY_CONTEXT, &writer));
  ERN_TRY(make_zip(w, memory));
  ERN_TRY(copy_source(w, memory, &writer));
  status = ern_file_writer_commit(&writer);
fail:
  ern_file_writer_abandon(&writer);
  zip_source_free(memory);
  return status;
}

/* PyTorch 1.13 refuses floats with weights_only=True, even in its own files. Without an optimizer, a float is replaced
 * by a zero-dimensional tensor. An optimizer needs real floats, so they stay, and only PyTorch 2 opens the file with
 * weights_only=True. */
static bool has_optimizer(const json_t *tree) {
  const json_t *pairs = json_object_get(tree, "dict");
  for (size_t i = 0; i < json_array_size(pairs); i++) {
    const char *key = json_string_value(json_array_get(json_array_get(pairs, i), 0));
    if (key != NULL && strcmp(key, "optimizer") == 0) return true;
  }
  return false;
}

ern_status ern_torch_write_tree(ern_context *context, const char *path, const json_t *tree,
                                const struct ern_tensor *tensors, size_t tensor_count) {
  struct writing w = {.context = context, .path = path, .tensors = tensors, .tensor_count = tensor_count};
  ern_status status = ERN_OK;
  w.numbers = !has_optimizer(tree);
  ERN_TRY(sort_tensors(&w));
  put(&w, "\x80\x02", 2);
  put_value(&w, tree, 0);
  put_byte(&w, '.');
  ERN_TRY(w.status);
  status = write_zip(&w);
fail:
  ern_release(context, w.bytes);
  while (w.number != NULL) {
    struct number *before = w.number->before;
    ern_release(context, w.number);
    w.number = before;
  }
  ern_release(context, w.named);
  ern_release(context, (void *)(uintptr_t)w.used);
  return status;
}

ern_status ern_torch_write(ern_context *context, const char *path, const char *tree, const struct ern_tensor *tensors,
                           size_t tensor_count) {
  json_error_t error;
  json_t *json = json_loads(tree, JSON_DECODE_ANY | JSON_REJECT_DUPLICATES, &error);
  if (json == NULL)
    return ern_fail(context, json_error_code(&error) == json_error_out_of_memory ? ERN_E_NO_MEMORY : ERN_E_FORMAT,
                    "%s: the tree to write is no JSON: %s", path, error.text);
  const ern_status status = ern_torch_write_tree(context, path, json, tensors, tensor_count);
  json_decref(json);
  return status;
}
