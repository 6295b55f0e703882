/* SPDX-License-Identifier: MIT */
#include "io/torch_legacy.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/memory.h"

static const uint8_t magic[] = {0x80, 2, 0x8a, 10, 0x6c, 0xfc, 0x9c, 0x46, 0xf9, 0x20, 0x6a, 0xa8, 0x50, 0x19, '.'};
enum { VERSION = 1001, MOST_KEYS = 1 << 13 /* a training's state has 300 */ };

bool ern_torch_is_legacy(const uint8_t *bytes, size_t count) {
  return count > sizeof magic && memcmp(bytes, magic, sizeof magic) == 0;
}

struct reading {
  ern_context *context;
  const char *path;
  const uint8_t *bytes;
  size_t count, at;
};

static ern_status wrong(const struct reading *r, const char *what) {
  return ern_fail(r->context, ERN_E_FORMAT, "%s: at byte %zu: %s", r->path, r->at, what);
}

static ern_status next_pickle(struct reading *r, const char *name, struct ern_pickle *pickle) {
  char where[1024];
  size_t used = 0;
  snprintf(where, sizeof where, "%s: %s at byte %zu", r->path, name, r->at);
  const ern_status status = ern_pickle_read_first(r->context, where, r->bytes + r->at, r->count - r->at, pickle, &used);
  r->at += used;
  return status;
}

/* Checks the version of the format, and that numbers are little endian. */
static ern_status check_head(struct reading *r) {
  struct ern_pickle version, machine = {0};
  ern_status status = next_pickle(r, "the version", &version);
  if (status != ERN_OK) return status;
  if (version.root->kind != ERN_PICKLE_INT || version.root->as.integer != VERSION)
    ERN_TRY(wrong(r, "the version of the form is not 1001"));
  ERN_TRY(next_pickle(r, "the machine", &machine));
  const struct ern_pickle_value *little = ern_pickle_get(machine.root, "little_endian");
  if (little == NULL || little->kind != ERN_PICKLE_BOOL || little->as.integer != 1)
    ERN_TRY(ern_fail(r->context, ERN_E_UNSUPPORTED, "%s: little_endian is not true, expected a file of such a machine",
                     r->path));
fail:
  ern_pickle_free(r->context, &version);
  ern_pickle_free(r->context, &machine);
  return status;
}

static int compare_storages(const void *left, const void *right) {
  const struct ern_legacy_storage *a = left, *b = right;
  return strcmp(a->key, b->key);
}

static int compare_values(const void *left, const void *right) {
  const struct ern_pickle_value *const *a = left, *const *b = right;
  return strcmp((*a)->as.storage.key, (*b)->as.storage.key);
}

static int compare_key(const void *key, const void *value) {
  const struct ern_pickle_value *const *storage = value;
  return strcmp(key, (*storage)->as.storage.key);
}

const struct ern_legacy_storage *ern_torch_legacy_find(const struct ern_legacy_storage *storage, size_t storages,
                                                       const char *key) {
  const struct ern_legacy_storage wanted = {.key = key};
  return storages > 0 ? bsearch(&wanted, storage, storages, sizeof wanted, compare_storages) : NULL;
}

/* The pickle may name a storage many times; each time with the same type and size. */
static ern_status check_names(const struct reading *r, struct ern_pickle *pickle) {
  if (pickle->storages > 0) qsort(pickle->storage, pickle->storages, sizeof *pickle->storage, compare_values);
  for (size_t i = 1; i < pickle->storages; i++) {
    const struct ern_pickle_value *a = pickle->storage[i - 1], *b = pickle->storage[i];
    if (strcmp(a->as.storage.key, b->as.storage.key) == 0 &&
        (a->as.storage.dtype != b->as.storage.dtype || a->as.storage.count != b->as.storage.count))
      return ern_fail(r->context, ERN_E_FORMAT, "%s: storage %s has two types or sizes", r->path, a->as.storage.key);
  }
  return ERN_OK;
}

/* The elements of the next storage, which are skipped. */
static ern_status take_elements(struct reading *r, const struct ern_pickle *pickle, const char *key,
                                struct ern_legacy_storage *to) {
  uint64_t elements = 0;
  size_t bytes = 0;
  struct ern_pickle_value *const *found =
      pickle->storages > 0 ? bsearch(key, pickle->storage, pickle->storages, sizeof *pickle->storage, compare_key)
                           : NULL;
  if (found == NULL) return ern_fail(r->context, ERN_E_FORMAT, "%s: no tensor lies in storage %.100s", r->path, key);
  const struct ern_pickle_value *storage = *found;
  if (r->count - r->at < sizeof elements) return wrong(r, "the file ends before the size of a storage");
  for (size_t i = 0; i < sizeof elements; i++) elements |= (uint64_t)r->bytes[r->at + i] << (8 * i);
  r->at += sizeof elements;
  if (elements != storage->as.storage.count)
    return ern_fail(r->context, ERN_E_SHAPE, "%s: storage %s has %" PRIu64 " elements, expected %zu", r->path,
                    storage->as.storage.key, elements, storage->as.storage.count);
  if (!ern_size_multiply(storage->as.storage.count, ern_dtype_bytes(storage->as.storage.dtype), &bytes) ||
      bytes > r->count - r->at)
    return wrong(r, "the file ends inside a storage");
  *to = (struct ern_legacy_storage){storage->as.storage.key, r->at};
  r->at += bytes;
  return ERN_OK;
}

static ern_status take_storages(struct reading *r, struct ern_pickle *pickle, struct ern_legacy_storage **storage,
                                size_t *storages) {
  struct ern_pickle keys;
  ern_status status = next_pickle(r, "the keys", &keys);
  if (status != ERN_OK) return status;
  const size_t count = keys.root->kind == ERN_PICKLE_LIST ? keys.root->as.list.count : SIZE_MAX;
  if (count > MOST_KEYS) ERN_TRY(wrong(r, "the keys are no list of at most 8192"));
  ERN_TRY(check_names(r, pickle));
  if (count > 0) ERN_TRY(ERN_NEW(r->context, count, storage));
  for (size_t i = 0; i < count; i++) {
    const struct ern_pickle_value *key = keys.root->as.list.item[i];
    if (key->kind != ERN_PICKLE_TEXT) ERN_TRY(wrong(r, "a key is no text"));
    ERN_TRY(take_elements(r, pickle, key->as.words.text, &(*storage)[i]));
  }
  if (r->at != r->count) ERN_TRY(wrong(r, "bytes follow the last storage"));
  if (count > 0) qsort(*storage, count, sizeof **storage, compare_storages);
  *storages = count;
  for (size_t i = 1; i < count; i++)
    if (strcmp((*storage)[i - 1].key, (*storage)[i].key) == 0) ERN_TRY(wrong(r, "a storage is there twice"));
  for (size_t i = 0; i < pickle->storages; i++)
    if (ern_torch_legacy_find(*storage, count, pickle->storage[i]->as.storage.key) == NULL)
      ERN_TRY(ern_fail(r->context, ERN_E_FORMAT, "%s: has no bytes of storage %s", r->path,
                       pickle->storage[i]->as.storage.key));
fail:
  ern_pickle_free(r->context, &keys);
  return status;
}

ern_status ern_torch_legacy_read(ern_context *context, const char *path, const uint8_t *bytes, size_t count,
                                 struct ern_pickle *pickle, struct ern_legacy_storage **storage, size_t *storages) {
  struct reading r = {.context = context, .path = path, .bytes = bytes, .count = count, .at = sizeof magic};
  ern_status status = ERN_OK;
  *pickle = (struct ern_pickle){0};
  *storage = NULL;
  *storages = 0;
  ERN_TRY(check_head(&r));
  ERN_TRY(next_pickle(&r, "the data", pickle));
  ERN_TRY(take_storages(&r, pickle, storage, storages));
  return ERN_OK;
fail:
  ern_pickle_free(context, pickle);
  ern_release(context, *storage);
  *storage = NULL;
  return status;
}
