/* SPDX-License-Identifier: MIT
 * Any bytes as a file of torch.save. What does not begin as a zip is taken for a data.pkl and put into one with sound
 * checksums and one storage, so that the pickle machine and the views are reached. */
#include "fuzz.h"
#include "io/torch_legacy.h"
#include "io/torch_zip.h"

enum { STORAGE_BYTES = 240, PICKLE_MOST = 1 << 16 };

static uint32_t checksum(const uint8_t *bytes, size_t count) {
  static uint32_t table[256];
  if (table[1] == 0) {
    for (uint32_t i = 0; i < 256; i++) {
      table[i] = i;
      for (int k = 0; k < 8; k++) table[i] = table[i] >> 1 ^ ((table[i] & 1) != 0 ? 0xedb88320u : 0);
    }
  }
  uint32_t sum = ~0u;
  for (size_t i = 0; i < count; i++) sum = sum >> 8 ^ table[(sum ^ bytes[i]) & 255];
  return ~sum;
}

static uint8_t *put(uint8_t *at, uint32_t number, int bytes) {
  for (int i = 0; i < bytes; i++) *at++ = (uint8_t)(number >> (8 * i));
  return at;
}

/* The common part of a local and a central header. */
static uint8_t *put_sizes(uint8_t *at, const uint8_t *bytes, size_t count, const char *name) {
  at = put(at, 20, 2);
  at = put(at, 0, 4);
  at = put(at, 33u << 16, 4);
  at = put(at, checksum(bytes, count), 4);
  at = put(at, (uint32_t)count, 4);
  at = put(at, (uint32_t)count, 4);
  at = put(at, (uint32_t)strlen(name), 2);
  return put(at, 0, 2);
}

static size_t make_zip(uint8_t *zip, const uint8_t *pickle, size_t pickle_bytes) {
  static uint8_t storage[STORAGE_BYTES];
  const struct {
    const char *name;
    const uint8_t *bytes;
    size_t count;
  } entry[2] = {{"a/data.pkl", pickle, pickle_bytes}, {"a/data/0", storage, STORAGE_BYTES}};
  uint32_t begin[2];
  uint8_t *at = zip;
  for (int i = 0; i < 2; i++) {
    begin[i] = (uint32_t)(at - zip);
    at = put(at, 0x04034b50, 4);
    at = put_sizes(at, entry[i].bytes, entry[i].count, entry[i].name);
    memcpy(at, entry[i].name, strlen(entry[i].name));
    at += strlen(entry[i].name);
    if (entry[i].count > 0) memcpy(at, entry[i].bytes, entry[i].count);
    at += entry[i].count;
  }
  const uint32_t directory = (uint32_t)(at - zip);
  for (int i = 0; i < 2; i++) {
    at = put(at, 0x02014b50, 4);
    at = put(at, 20, 2);
    at = put_sizes(at, entry[i].bytes, entry[i].count, entry[i].name);
    at = put(at, 0, 4);
    at = put(at, 0, 2);
    at = put(at, 0, 4);
    at = put(at, begin[i], 4);
    memcpy(at, entry[i].name, strlen(entry[i].name));
    at += strlen(entry[i].name);
  }
  const uint32_t size = (uint32_t)(at - zip) - directory;
  at = put(at, 0x06054b50, 4);
  at = put(at, 0, 4);
  at = put(at, 2, 2);
  at = put(at, 2, 2);
  at = put(at, size, 4);
  at = put(at, directory, 4);
  at = put(at, 0, 2);
  return (size_t)(at - zip);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  ern_context *context = fuzz_context();
  static uint8_t zip[PICKLE_MOST + 1024];
  struct ern_torch torch;
  struct ern_tensor_file file;
  char *tree = NULL;
  if (!ern_torch_is_zip(bytes, count) && !ern_torch_is_legacy(bytes, count)) {
    if (count > PICKLE_MOST) return 0;
    count = make_zip(zip, bytes, count);
    bytes = zip;
  }
  if (ern_torch_open(context, "fuzz", fuzz_copy(context, bytes, count), count, &torch) != ERN_OK) return 0;
  if (ern_torch_tensors(context, &torch, "", &file, &tree) == ERN_OK) {
    for (size_t i = 0; i < file.tensor_count; i++)
      fuzz_touch(file.tensors[i].data, file.tensors[i].count * ern_dtype_bytes(file.tensors[i].dtype));
  }
  ern_release(context, tree);
  ern_tensor_file_free(context, &file);
  return 0;
}
