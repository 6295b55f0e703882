/* SPDX-License-Identifier: MIT */
#include "io/torch_zip.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <zip.h>

#include "core/memory.h"
#include "io/json.h"
#include "io/torch_legacy.h"

enum { PICKLE_LIMIT = 1 << 26, DEPTH_LIMIT = 32, VISIT_LIMIT = 1 << 18, PATH_CAPACITY = 512 };
static const size_t words_limit = (size_t)1 << 24;  /* bytes of all texts of the tree, with repetitions */
static const size_t spread_limit = (size_t)1 << 28; /* bytes that copies of views may take in addition to the file's */

struct opened {
  const char *path;
  uint8_t *bytes;
  size_t count, read, spread;         /* read: bytes of entries extracted so far */
  zip_t *zip;                         /* NULL: the format before PyTorch 1.6 */
  char prefix[256];                   /* "archive/" */
  uint8_t **entry;                    /* [entries] bytes of those that were read */
  size_t entries;                     /* of the zip, or storages */
  struct ern_legacy_storage *storage; /* [entries] without a zip */
  struct named_entry {
    const char *name;
    zip_uint64_t index;
  } * named; /* [entries] by name */
  struct ern_pickle pickle;
  struct found_tensor {
    struct ern_pickle_value *value;
    char *name;
    uint8_t *copy; /* contiguous bytes of a view; NULL: contiguous in the storage */
  } * tensor;      /* all that have a name */
  size_t tensors, capacity;
};

bool ern_torch_is_zip(const uint8_t *bytes, size_t count) { return count >= 4 && memcmp(bytes, "PK\3\4", 4) == 0; }

bool ern_torch_is_tar(const uint8_t *bytes, size_t count) {
  return count >= 512 && memcmp(bytes + 257, "ustar", 5) == 0;
}

bool ern_torch_is_torch(const uint8_t *bytes, size_t count) {
  return ern_torch_is_zip(bytes, count) || ern_torch_is_legacy(bytes, count) || ern_torch_is_tar(bytes, count);
}

ern_status ern_torch_check_end(const struct ern_file_reader *reader) {
  static const uint8_t mark[] = {'P', 'K', 5, 6};
  enum { END_BYTES = 22 + 65535 /* with the longest comment */ };
  const size_t count = reader->size < END_BYTES ? reader->size : END_BYTES;
  uint8_t *bytes = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(reader->context, count, &bytes));
  ERN_TRY(ern_file_reader_take(reader, reader->size - count, bytes, count));
  size_t at = 0;
  while (at + sizeof mark <= count && memcmp(bytes + at, mark, sizeof mark) != 0) at++;
  if (at + sizeof mark > count)
    status = ern_fail(reader->context, ERN_E_FORMAT,
                      "%s: the zip is damaged: no list of entries at its end, so it is cut off", reader->path);
fail:
  ern_release(reader->context, bytes);
  return status;
}

static void release_opened(ern_context *context, void *private_data) {
  struct opened *o = private_data;
  if (o == NULL) return;
  if (o->zip != NULL) zip_discard(o->zip);
  for (size_t i = 0; o->entry != NULL && i < o->entries; i++) ern_release(context, o->entry[i]);
  for (size_t i = 0; i < o->tensors; i++) {
    ern_release(context, o->tensor[i].name);
    ern_release(context, o->tensor[i].copy);
  }
  ern_release(context, o->entry);
  ern_release(context, o->named);
  ern_release(context, o->storage);
  ern_release(context, o->tensor);
  ern_release(context, o->bytes);
  ern_pickle_free(context, &o->pickle);
  ern_release(context, o);
}

void ern_torch_close(ern_context *context, struct ern_torch *torch) {
  release_opened(context, torch->private_data);
  *torch = (struct ern_torch){0};
}

/* ---- the zip ----------------------------------------------------------------------------------------------------- */

static ern_status zip_wrong(ern_context *context, const struct opened *o, const char *what) {
  return ern_fail(context, ERN_E_FORMAT, "%s: the zip is damaged: %s", o->path, what);
}

/* Each entry of the central directory begins with this mark. Bytes of tensors equal it by chance once in 2^32. */
static ern_status check_count(ern_context *context, const struct opened *o) {
  static const uint8_t mark[] = {'P', 'K', 1, 2};
  size_t marks = 0;
  const uint8_t *at = o->bytes, *const end = o->bytes + o->count;
  while (marks <= ERN_TORCH_ENTRIES && (at = memchr(at, mark[0], (size_t)(end - at))) != NULL) {
    if ((size_t)(end - at) >= sizeof mark && memcmp(at, mark, sizeof mark) == 0) marks++;
    at++;
  }
  if (marks <= ERN_TORCH_ENTRIES) return ERN_OK;
  return ern_fail(context, ERN_E_SHAPE, "%s: the zip has more than %d entries", o->path, ERN_TORCH_ENTRIES);
}

static ern_status open_zip(ern_context *context, struct opened *o) {
  zip_error_t error;
  zip_error_init(&error);
  zip_source_t *source = zip_source_buffer_create(o->bytes, o->count, 0, &error);
  o->zip = source != NULL ? zip_open_from_source(source, ZIP_RDONLY, &error) : NULL;
  ern_status status = ERN_OK;
  if (o->zip == NULL) {
    zip_source_free(source);
    status = zip_wrong(context, o, zip_error_strerror(&error));
  }
  zip_error_fini(&error);
  return status;
}

/* Bytes of an entry, extracted once. Sizes are checked first: uncompressed entries together cannot be larger than the
 * file. */
static ern_status read_entry(ern_context *context, struct opened *o, zip_uint64_t index, size_t most, size_t *size) {
  zip_stat_t about;
  ern_status status = ERN_OK;
  zip_file_t *file = NULL;
  const zip_uint64_t needed = ZIP_STAT_NAME | ZIP_STAT_SIZE | ZIP_STAT_COMP_SIZE | ZIP_STAT_COMP_METHOD;
  if (zip_stat_index(o->zip, index, 0, &about) != 0 || (about.valid & needed) != needed)
    return zip_wrong(context, o, "an entry without its sizes");
  if (about.comp_method != ZIP_CM_STORE || about.comp_size != about.size)
    return ern_fail(context, ERN_E_UNSUPPORTED, "%s: entry %.200s is compressed, expected stored as torch.save does",
                    o->path, about.name);
  if (about.size > most)
    return ern_fail(context, ERN_E_SHAPE, "%s: entry %.200s has %llu bytes, expected at most %zu", o->path, about.name,
                    (unsigned long long)about.size, most);
  *size = (size_t)about.size;
  if (o->entry[index] != NULL) return ERN_OK;
  if (*size > o->count - o->read) return zip_wrong(context, o, "its entries overlap or are longer than the file");
  o->read += *size;
  ERN_TRY(ERN_NEW(context, *size + 1, &o->entry[index]));
  file = zip_fopen_index(o->zip, index, 0);
  if (file == NULL) ERN_TRY(zip_wrong(context, o, zip_strerror(o->zip)));
  char more;
  if (zip_fread(file, o->entry[index], *size) != (zip_int64_t)*size || zip_fread(file, &more, 1) != 0)
    ERN_TRY(
        ern_fail(context, ERN_E_FORMAT, "%s: entry %.200s is cut off or its checksum is wrong", o->path, about.name));
fail:
  if (file != NULL) zip_fclose(file);
  return status;
}

static int compare_entries(const void *left, const void *right) {
  const struct named_entry *a = left, *b = right;
  return strcmp(a->name, b->name);
}

static ern_status find_entry(ern_context *context, const struct opened *o, const char *name, zip_uint64_t *index) {
  char whole[400];
  snprintf(whole, sizeof whole, "%s%s", o->prefix, name);
  const struct named_entry wanted = {.name = whole}, *found = NULL;
  found = bsearch(&wanted, o->named, o->entries, sizeof wanted, compare_entries);
  if (found == NULL) return ern_fail(context, ERN_E_MISSING, "%s: the zip has no entry %.300s", o->path, whole);
  *index = found->index;
  return ERN_OK;
}

/* The only folder with a data.pkl; every entry must have a name. */
static ern_status find_prefix(ern_context *context, struct opened *o) {
  static const char pickle[] = "/data.pkl";
  for (size_t i = 0; i < o->entries; i++) {
    const char *name = zip_get_name(o->zip, i, ZIP_FL_ENC_RAW);
    if (name == NULL) return zip_wrong(context, o, "an entry without a name");
    const char *slash = strchr(name, '/');
    if (slash == NULL || strcmp(slash, pickle) != 0) continue;
    if (o->prefix[0] != 0) return zip_wrong(context, o, "it has two entries data.pkl");
    if ((size_t)(slash - name) + 2 > sizeof o->prefix)
      return zip_wrong(context, o, "the name of its folder is too long");
    memcpy(o->prefix, name, (size_t)(slash - name) + 1);
  }
  if (o->prefix[0] != 0) return ERN_OK;
  return ern_fail(context, ERN_E_FORMAT, "%s: is a zip without FOLDER/data.pkl, so torch.save did not write it",
                  o->path);
}

/* Sorts the names for look-up, and refuses duplicates: one entry would hide the other. */
static ern_status sort_names(ern_context *context, struct opened *o) {
  const ern_status status = ERN_NEW(context, o->entries, &o->named);
  if (status != ERN_OK) return status;
  for (size_t i = 0; i < o->entries; i++)
    o->named[i] =
        (struct named_entry){zip_get_name(o->zip, i, ZIP_FL_ENC_RAW), i}; /* find_prefix saw that all have one */
  qsort(o->named, o->entries, sizeof *o->named, compare_entries);
  for (size_t i = 1; i < o->entries; i++)
    if (strcmp(o->named[i].name, o->named[i - 1].name) == 0)
      return ern_fail(context, ERN_E_FORMAT, "%s: the zip has the entry %.200s twice", o->path, o->named[i].name);
  return ERN_OK;
}

static ern_status check_byte_order(ern_context *context, struct opened *o) {
  zip_uint64_t index = 0;
  size_t size = 0;
  if (find_entry(context, o, "byteorder", &index) != ERN_OK) return ERN_OK; /* written since PyTorch 2.1 */
  const ern_status status = read_entry(context, o, index, 16, &size);
  if (status != ERN_OK) return status;
  if (size == 6 && memcmp(o->entry[index], "little", 6) == 0) return ERN_OK;
  return ern_fail(context, ERN_E_UNSUPPORTED, "%s: byteorder is \"%.16s\", expected little", o->path,
                  (const char *)o->entry[index]);
}

static ern_status open_entries(ern_context *context, struct opened *o) {
  ern_status status = ERN_OK;
  zip_uint64_t index = 0;
  size_t size = 0;
  char where[1024];
  ERN_TRY(check_count(context, o));
  ERN_TRY(open_zip(context, o));
  const zip_int64_t entries = zip_get_num_entries(o->zip, 0);
  if (entries < 1) ERN_TRY(ern_fail(context, ERN_E_SHAPE, "%s: the zip has no entries", o->path));
  o->entries = (size_t)entries;
  ERN_TRY(ERN_NEW(context, o->entries, &o->entry));
  ERN_TRY(find_prefix(context, o));
  ERN_TRY(sort_names(context, o));
  ERN_TRY(check_byte_order(context, o));
  ERN_TRY(find_entry(context, o, "data.pkl", &index));
  ERN_TRY(read_entry(context, o, index, PICKLE_LIMIT, &size));
  snprintf(where, sizeof where, "%s: data.pkl", o->path);
  ERN_TRY(ern_pickle_read(context, where, o->entry[index], size, &o->pickle));
fail:
  return status;
}

static ern_status open_legacy(ern_context *context, struct opened *o) {
  const ern_status status =
      ern_torch_legacy_read(context, o->path, o->bytes, o->count, &o->pickle, &o->storage, &o->entries);
  return status == ERN_OK && o->entries > 0 ? ERN_NEW(context, o->entries, &o->entry) : status;
}

ern_status ern_torch_open(ern_context *context, const char *path, uint8_t *bytes, size_t count,
                          struct ern_torch *torch) {
  struct opened *o = NULL;
  *torch = (struct ern_torch){0};
  ern_status status = ERN_OK;
  if (ern_torch_is_tar(bytes, count))
    status = ern_fail(context, ERN_E_UNSUPPORTED,
                      "%s: is a tar, as PyTorch wrote before 0.2; load it in PyTorch and save it again", path);
  if (status == ERN_OK) status = ERN_NEW(context, 1, &o);
  if (status != ERN_OK) {
    ern_release(context, bytes);
    return status;
  }
  o->path = path;
  o->bytes = bytes;
  o->count = count;
  status = ern_torch_is_legacy(bytes, count) ? open_legacy(context, o) : open_entries(context, o);
  if (status != ERN_OK) {
    release_opened(context, o);
    return status;
  }
  torch->pickle = o->pickle;
  torch->private_data = o;
  return ERN_OK;
}

/* ---- tensors ----------------------------------------------------------------------------------------------------- */

/* A copy, as the elements may be unaligned in the file. The pickle was checked against the file when it was opened. */
static ern_status copy_storage(ern_context *context, struct opened *o, const struct ern_pickle_value *storage,
                               const uint8_t **bytes) {
  const struct ern_legacy_storage *found = ern_torch_legacy_find(o->storage, o->entries, storage->as.storage.key);
  const size_t index = (size_t)(found - o->storage),
               size = storage->as.storage.count * ern_dtype_bytes(storage->as.storage.dtype);
  if (o->entry[index] == NULL) {
    const ern_status status = ERN_NEW(context, size + 1, &o->entry[index]);
    if (status != ERN_OK) return status;
    memcpy(o->entry[index], o->bytes + found->at, size);
  }
  *bytes = o->entry[index];
  return ERN_OK;
}

static ern_status read_storage(ern_context *context, struct opened *o, const struct ern_pickle_value *storage,
                               const uint8_t **bytes) {
  if (o->zip == NULL) return copy_storage(context, o, storage, bytes);
  char name[128];
  zip_uint64_t index = 0;
  size_t expected = 0, size = 0;
  ern_status status = ERN_OK;
  snprintf(name, sizeof name, "data/%s", storage->as.storage.key);
  ERN_TRY(find_entry(context, o, name, &index));
  if (!ern_size_multiply(storage->as.storage.count, ern_dtype_bytes(storage->as.storage.dtype), &expected))
    expected = SIZE_MAX;
  ERN_TRY(read_entry(context, o, index, o->count, &size));
  if (size != expected)
    ERN_TRY(ern_fail(context, ERN_E_SHAPE, "%s: entry %s%s has %zu bytes, expected %zu items of %zu bytes", o->path,
                     o->prefix, name, size, storage->as.storage.count, ern_dtype_bytes(storage->as.storage.dtype)));
  *bytes = o->entry[index];
fail:
  return status;
}

static bool is_contiguous(const struct ern_pickle_value *tensor) {
  size_t step = 1;
  for (int d = tensor->as.tensor.dims; d > 0; d--) {
    if (tensor->as.tensor.shape[d - 1] != 1 && tensor->as.tensor.stride[d - 1] != step) return false;
    step *= tensor->as.tensor.shape[d - 1];
  }
  return true;
}

/* out[count] = the elements of the view in row-major order. The pickle machine checked that all lie in the storage. */
static void gather(uint8_t *out, const uint8_t *from, const struct ern_pickle_value *tensor, size_t count,
                   size_t bytes) {
  size_t at[ERN_TENSOR_MAX_DIMS] = {0}, place = 0;
  for (size_t i = 0; i < count; i++) {
    memcpy(out + i * bytes, from + place * bytes, bytes);
    for (int d = tensor->as.tensor.dims - 1; d >= 0; d--) {
      place += tensor->as.tensor.stride[d];
      if (++at[d] < tensor->as.tensor.shape[d]) break;
      place -= tensor->as.tensor.stride[d] * tensor->as.tensor.shape[d];
      at[d] = 0;
    }
  }
}

static ern_status fill_tensor(ern_context *context, struct opened *o, size_t number, struct ern_tensor *out) {
  const struct ern_pickle_value *value = o->tensor[number].value, *storage = value->as.tensor.storage;
  const size_t item = ern_dtype_bytes(storage->as.storage.dtype);
  const uint8_t *bytes = NULL;
  size_t size = 0;
  *out = (struct ern_tensor){
      .name = value->as.tensor.name, .dtype = storage->as.storage.dtype, .dims = value->as.tensor.dims, .count = 1};
  memcpy(out->shape, value->as.tensor.shape, sizeof out->shape);
  for (int d = 0; d < out->dims; d++) out->count *= out->shape[d]; /* checked by the pickle machine */
  ern_status status = read_storage(context, o, storage, &bytes);
  if (status != ERN_OK) return status;
  if (out->count == 0 || is_contiguous(value)) {
    out->data = bytes + (out->count == 0 ? 0 : value->as.tensor.offset * item);
    return ERN_OK;
  }
  if (!ern_size_multiply(out->count, item, &size) || size > o->count + spread_limit - o->spread)
    return ern_fail(context, ERN_E_SHAPE, "%s: tensor %.200s repeats its storage: views take more than %zu bytes",
                    o->path, out->name, o->count + spread_limit);
  o->spread += size;
  status = ERN_NEW(context, size, &o->tensor[number].copy);
  if (status != ERN_OK) return status;
  gather(o->tensor[number].copy, bytes + value->as.tensor.offset * item, value, out->count, item);
  out->data = o->tensor[number].copy;
  return ERN_OK;
}

/* ---- the tree ---------------------------------------------------------------------------------------------------- */

struct walk {
  ern_context *context;
  struct opened *o;
  const char *prefix;
  char path[PATH_CAPACITY];
  size_t visits, words; /* values and bytes of texts so far */
  ern_status status;
};

static json_t *walk_fail(struct walk *w, ern_status code, const char *what) {
  if (w->status == ERN_OK)
    w->status = ern_fail(w->context, code, "%s: data.pkl: %s%s%.200s", w->o->path, what, w->path[0] != 0 ? " at " : "",
                         w->path);
  return NULL;
}

/* Returns the new object; NULL, with an error, where there was no memory for it. */
static json_t *made(struct walk *w, json_t *object) {
  return object != NULL ? object : walk_fail(w, ERN_E_NO_MEMORY, "no memory for the tree");
}

/* Counts the bytes of a text: any number of values may refer to the same one. */
static bool take_words(struct walk *w, const struct ern_pickle_value *value) {
  if (value->as.words.length > words_limit - w->words) {
    walk_fail(w, ERN_E_SHAPE, "texts take more than 16 MiB");
    return false;
  }
  w->words += value->as.words.length;
  return true;
}

static json_t *walk_words(struct walk *w, const struct ern_pickle_value *value) {
  if (!take_words(w, value)) return NULL;
  if (memchr(value->as.words.text, 0, value->as.words.length) != NULL)
    return walk_fail(w, ERN_E_FORMAT, "a text with a 0 in it");
  json_t *text = json_stringn(value->as.words.text, value->as.words.length);
  return text != NULL ? text : walk_fail(w, ERN_E_FORMAT, "a text that is no UTF-8");
}

static json_t *walk_bytes(struct walk *w, const struct ern_pickle_value *value) {
  char *text = NULL;
  if (!take_words(w, value)) return NULL;
  w->status = ERN_NEW(w->context, 2 * value->as.words.length + 1, &text);
  if (w->status != ERN_OK) return NULL;
  for (size_t i = 0; i < value->as.words.length; i++)
    snprintf(text + 2 * i, 3, "%02x", (unsigned)(uint8_t)value->as.words.text[i]);
  json_t *object = made(w, json_pack("{s:s}", "bytes", text));
  ern_release(w->context, text);
  return object;
}

static json_t *walk_float(struct walk *w, double real) {
  if (isfinite(real)) return made(w, json_real(real));
  return made(w, json_pack("{s:s}", "float", isnan(real) ? "nan" : (real > 0 ? "inf" : "-inf")));
}

static json_t *walk_tensor(struct walk *w, struct ern_pickle_value *value) {
  if (value->as.tensor.name == NULL) {
    struct ern_torch torch = {.private_data = w->o};
    w->status = ern_torch_name(w->context, &torch, value, w->prefix, w->path[0] != 0 ? w->path : "tensor");
    if (w->status != ERN_OK) return NULL;
  }
  json_t *object = json_pack("{s:s}", "tensor", value->as.tensor.name);
  return object != NULL ? object : walk_fail(w, ERN_E_FORMAT, "a tensor's name that is no UTF-8");
}

static json_t *walk(struct walk *w, struct ern_pickle_value *value, int depth);

/* Adds ".part" to the path; returns the length that the path had before. */
static size_t go_in(struct walk *w, const char *part) {
  const size_t length = strlen(w->path);
  snprintf(w->path + length, sizeof w->path - length, "%s%s", length > 0 ? "." : "", part);
  return length;
}

static json_t *walk_items(struct walk *w, const struct ern_pickle_value *list, int depth) {
  json_t *array = made(w, json_array());
  for (size_t i = 0; i < list->as.list.count && w->status == ERN_OK; i++) {
    char part[32];
    snprintf(part, sizeof part, "%zu", i);
    const size_t length = go_in(w, part);
    json_t *item = walk(w, list->as.list.item[i], depth + 1);
    if (item != NULL && json_array_append_new(array, item) != 0) walk_fail(w, ERN_E_NO_MEMORY, "no memory");
    w->path[length] = 0;
  }
  return array;
}

/* [[key, value], ...] */
static json_t *walk_pairs(struct walk *w, const struct ern_pickle_value *dict, int depth) {
  json_t *array = made(w, json_array());
  for (size_t i = 0; i + 1 < dict->as.list.count && w->status == ERN_OK; i += 2) {
    const struct ern_pickle_value *key = dict->as.list.item[i];
    char part[32] = "?";
    if (key->kind == ERN_PICKLE_INT) snprintf(part, sizeof part, "%lld", (long long)key->as.integer);
    json_t *first = walk(w, dict->as.list.item[i], depth + 1);
    if (w->status != ERN_OK) {
      json_decref(first);
      break;
    }
    const size_t length = go_in(w, key->kind == ERN_PICKLE_TEXT ? key->as.words.text : part);
    json_t *second = w->status == ERN_OK ? walk(w, dict->as.list.item[i + 1], depth + 1) : NULL;
    json_t *pair = json_array();
    json_array_append_new(pair, first);
    json_array_append_new(pair, second);
    if (json_array_append_new(array, pair) != 0 || json_array_size(pair) != 2)
      walk_fail(w, ERN_E_NO_MEMORY, "no memory");
    w->path[length] = 0;
  }
  return array;
}

static json_t *wrapped(struct walk *w, const char *name, json_t *list) {
  return list != NULL ? made(w, json_pack("{s:o}", name, list)) : NULL;
}

/* NULL only where w->status says why. */
static json_t *walk(struct walk *w, struct ern_pickle_value *value, int depth) {
  if (depth > DEPTH_LIMIT) return walk_fail(w, ERN_E_SHAPE, "values nested more than 32 deep");
  if (++w->visits > VISIT_LIMIT) return walk_fail(w, ERN_E_SHAPE, "more than 262144 values");
  switch (value->kind) {
    case ERN_PICKLE_NONE: return json_null();
    case ERN_PICKLE_BOOL: return json_boolean(value->as.integer != 0);
    case ERN_PICKLE_INT: return made(w, json_integer((json_int_t)value->as.integer));
    case ERN_PICKLE_FLOAT: return walk_float(w, value->as.real);
    case ERN_PICKLE_TEXT: return walk_words(w, value);
    case ERN_PICKLE_BYTES: return walk_bytes(w, value);
    case ERN_PICKLE_LIST: return walk_items(w, value, depth);
    case ERN_PICKLE_TUPLE: return wrapped(w, "tuple", walk_items(w, value, depth));
    case ERN_PICKLE_DICT: return wrapped(w, "dict", walk_pairs(w, value, depth));
    case ERN_PICKLE_ORDERED: return wrapped(w, "ordered", walk_pairs(w, value, depth));
    case ERN_PICKLE_TENSOR: return walk_tensor(w, value);
    default: return walk_fail(w, ERN_E_UNSUPPORTED, "a bare storage, type or function");
  }
}

ern_status ern_torch_name(ern_context *context, struct ern_torch *torch, struct ern_pickle_value *tensor,
                          const char *prefix, const char *name) {
  struct opened *o = torch->private_data;
  struct found_tensor *larger = NULL;
  char *full = NULL;
  ern_status status = ERN_OK;
  if (tensor->as.tensor.name != NULL) return ERN_OK;
  if (o->tensors == o->capacity) {
    const size_t capacity = o->capacity > 0 ? 2 * o->capacity : 64;
    ERN_TRY(ERN_NEW(context, capacity, &larger));
    if (o->tensors > 0) memcpy(larger, o->tensor, o->tensors * sizeof *o->tensor);
    ern_release(context, o->tensor);
    o->tensor = larger;
    o->capacity = capacity;
  }
  const size_t length = strlen(prefix) + strlen(name) + 1;
  ERN_TRY(ERN_NEW(context, length, &full));
  snprintf(full, length, "%s%s", prefix, name);
  o->tensor[o->tensors++] = (struct found_tensor){.value = tensor, .name = full};
  tensor->as.tensor.name = full;
fail:
  return status;
}

static int compare_names(const void *left, const void *right) {
  return strcmp(*(const char *const *)left, *(const char *const *)right);
}

static ern_status check_tensor_names(ern_context *context, const struct opened *o) {
  const char **name = NULL;
  ern_status status = ERN_NEW(context, o->tensors, &name);
  if (status != ERN_OK) return status;
  for (size_t i = 0; i < o->tensors; i++) name[i] = o->tensor[i].name;
  qsort(name, o->tensors, sizeof *name, compare_names);
  for (size_t i = 0; i < o->tensors && status == ERN_OK; i++) {
    if (name[i][0] == 0) status = ern_fail(context, ERN_E_FORMAT, "%s: a tensor has an empty name", o->path);
    if (i > 0 && strcmp(name[i], name[i - 1]) == 0)
      status = ern_fail(context, ERN_E_FORMAT, "%s: the tensor %.200s is there twice", o->path, name[i]);
  }
  ern_release(context, name);
  return status;
}

ern_status ern_torch_tensors(ern_context *context, struct ern_torch *torch, const char *prefix,
                             struct ern_tensor_file *file, char **tree) {
  struct opened *o = torch->private_data;
  struct walk w = {.context = context, .o = o, .prefix = prefix};
  ern_status status = ERN_OK;
  *file = (struct ern_tensor_file){.private_data = o, .release = release_opened};
  *torch = (struct ern_torch){0};
  *tree = NULL;
  json_t *json = walk(&w, o->pickle.root, 0);
  ERN_TRY(w.status);
  ERN_TRY(check_tensor_names(context, o));
  *tree = ern_json_text(context, json, JSON_COMPACT | JSON_ENCODE_ANY | JSON_REAL_PRECISION(17));
  if (*tree == NULL) ERN_TRY(ern_fail(context, ERN_E_NO_MEMORY, "%s: no memory for the tree", o->path));
  ERN_TRY(ERN_NEW(context, o->tensors, &file->tensors));
  for (size_t i = 0; i < o->tensors; i++) {
    ERN_TRY(fill_tensor(context, o, i, &file->tensors[i]));
    file->tensor_count++;
  }
fail:
  json_decref(json);
  if (status != ERN_OK) {
    ern_release(context, *tree);
    *tree = NULL;
    ern_tensor_file_free(context, file);
  }
  return status;
}
