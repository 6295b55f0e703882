/* SPDX-License-Identifier: MIT
 * PyTorch files that are small to write down and would take the square of it to read: each is refused, or read without
 * its optimizer, before anything is looked up in it. */
#include <zip.h>

#include "core/memory.h"
#include "io/torch_zip.h"
#include "model/checkpoint.h"
#include "support.h"

/* ---- a pickle, written by hand ----------------------------------------------------------------------------------- */

struct words {
  char *bytes;
  size_t count, capacity;
};

static void put(struct words *w, const void *bytes, size_t count) {
  if (w->count + count > w->capacity) {
    w->capacity = 2 * w->capacity + count;
    w->bytes = realloc(w->bytes, w->capacity);
    assert_non_null(w->bytes);
  }
  memcpy(w->bytes + w->count, bytes, count);
  w->count += count;
}

#define PUT(w, literal) put(w, literal, sizeof(literal) - 1)

static void put_text(struct words *w, const char *text) {
  const uint32_t length = (uint32_t)strlen(text);
  PUT(w, "X");
  put(w, &length, 4);
  put(w, text, length);
}

/* A float, of the entry data/0. */
static void put_tensor(struct words *w) {
  PUT(w,
      "ctorch._utils\n_rebuild_tensor_v2\n((X\x07\x00\x00\x00storagectorch\nFloatStorage\nX\x01\x00\x00\x00"
      "0X\x03\x00\x00\x00"
      "cpuK\x01tQK\x00))\x89"
      "ccollections\nOrderedDict\n)RtR");
}

/* A dict's pair of a text that begins with `name` and counts, and a tensor of its own. */
static void put_named(struct words *w, const char *name, int number) {
  char text[64];
  snprintf(text, sizeof text, "%s%d", name, number);
  put_text(w, text);
  put_tensor(w);
}

static void write_pth(const char *path, const struct words *pickle, int more) {
  const float one = 1;
  int code = 0;
  remove(path);
  zip_t *zip = zip_open(path, ZIP_CREATE | ZIP_TRUNCATE, &code);
  assert_non_null(zip);
  for (int i = 0; i < 2 + more; i++) {
    char name[32];
    snprintf(name, sizeof name, i == 0 ? "a/data.pkl" : "a/data/%d", i - 1);
    zip_source_t *source =
        zip_source_buffer(zip, i == 0 ? (const void *)pickle->bytes : &one, i == 0 ? pickle->count : sizeof one, 0);
    const zip_int64_t index = zip_file_add(zip, name, source, 0);
    assert_true(index >= 0);
    assert_int_equal(zip_set_file_compression(zip, (zip_uint64_t)index, ZIP_CM_STORE, 0), 0);
  }
  assert_int_equal(zip_close(zip), 0);
}

/* ---- a context that keeps its warnings --------------------------------------------------------------------------- */

static void keep_warning(void *user, ern_log_level level, const char *line) {
  if (level == ERN_LOG_WARNING) snprintf(user, 512, "%s", line);
}

static ern_context *listening_context(char warning[512]) {
  ern_context *context = NULL;
  ern_context_config config = ern_context_config_default();
  config.log = keep_warning;
  config.user = warning;
  warning[0] = 0;
  assert_int_equal(ern_context_create(&context, &config), ERN_OK);
  return context;
}

static void refused(const struct words *pickle, int more, ern_status expected, const char *words) {
  struct ern_tensor_file file;
  ern_context *context = support_context();
  write_pth("limits.pth", pickle, more);
  support_expect(context, ern_checkpoint_read(context, "limits.pth", &file), expected, "limits.pth", words, NULL);
  ern_context_free(&context);
}

/* Reads a file whose training is not looked for; the warning says why. */
static void read_without_training(const struct words *pickle, const char *why) {
  char warning[512];
  struct ern_tensor_file file;
  ern_context *context = listening_context(warning);
  write_pth("limits.pth", pickle, 0);
  support_ok(context, ern_checkpoint_read(context, "limits.pth", &file));
  if (strstr(warning, why) == NULL) fail_msg("the warning \"%s\" does not say \"%s\"", warning, why);
  assert_null(ern_tensor_file_metadata(&file, "ernerf.state"));
  ern_tensor_file_free(context, &file);
  ern_context_free(&context);
}

/* ------------------------------------------------------------------------------------------------------------------ */

/* The names of a zip's entries may be crafted to fall into one place of the hash of the library that reads it. */
static void test_entries(void **state) {
  (void)state;
  struct words w = {0};
  PUT(&w, "\x80\x02}(");
  put_named(&w, "t", 0);
  PUT(&w, "u.");
  refused(&w, ERN_TORCH_ENTRIES - 1, ERN_E_SHAPE, "the zip has more than 8192 entries");
  free(w.bytes);
}

/* One text of a MiB, in a list 20 times: 3 bytes each. */
static void test_shared_texts(void **state) {
  (void)state;
  struct words w = {0};
  char *text = malloc((1 << 20) + 1);
  assert_non_null(text);
  memset(text, 'y', 1 << 20);
  text[1 << 20] = 0;
  PUT(&w, "\x80\x02}(");
  put_text(&w, "list");
  PUT(&w, "](");
  put_text(&w, text);
  PUT(&w, "q\x01");
  for (int i = 1; i < 20; i++) PUT(&w, "h\x01");
  PUT(&w, "eu.");
  refused(&w, 0, ERN_E_SHAPE, "texts take more than 16 MiB");
  free(text);
  free(w.bytes);
}

/* Every look at a name reads all of it. */
static void test_long_name(void **state) {
  (void)state;
  struct words w = {0};
  char name[300];
  memset(name, 'x', sizeof name - 1);
  name[sizeof name - 1] = 0;
  PUT(&w, "\x80\x02}(");
  put_text(&w, name);
  put_tensor(&w);
  PUT(&w, "u.");
  refused(&w, 0, ERN_E_FORMAT, "name of over 255 bytes");
  free(w.bytes);
}

/* {"model": {sigma_net.0, ...}, "optimizer": {"state": {0: S, ...}, "param_groups": [{"params": [0, ...]}]}}, all of
 * `tensors` tensors; S holds `keys` keys beside exp_avg_sq, and so does the group beside params. */
static void put_training(struct words *w, int tensors, int keys) {
  PUT(w, "\x80\x02}(");
  put_text(w, "model");
  PUT(w, "}(");
  for (int i = 0; i < tensors; i++) put_named(w, "sigma_net.", i);
  PUT(w, "u");
  put_text(w, "optimizer");
  PUT(w, "}(");
  put_text(w, "state");
  PUT(w, "}(");
  for (int i = 0; i < tensors; i++) {
    put(w, "J", 1);
    put(w, &i, 4);
    PUT(w, "}(");
    put_text(w, "exp_avg_sq");
    put_tensor(w);
    for (int k = 0; k < keys; k++) {
      char key[16];
      snprintf(key, sizeof key, "k%d", k);
      put_text(w, key);
      PUT(w, "N");
    }
    PUT(w, "u");
  }
  PUT(w, "u");
  put_text(w, "param_groups");
  PUT(w, "](}(");
  for (int k = 0; k < keys; k++) {
    char key[16];
    snprintf(key, sizeof key, "k%d", k);
    put_text(w, key);
    PUT(w, "N");
  }
  put_text(w, "params");
  PUT(w, "](");
  for (int i = 0; i < tensors; i++) {
    put(w, "J", 1);
    put(w, &i, 4);
  }
  PUT(w, "eueuu.");
}

static void test_trainings(void **state) {
  (void)state;
  struct ern_tensor_file file;
  struct words w = {0};
  ern_context *context = support_context();
  put_training(&w, 3, 10); /* one as PyTorch writes it is read with its training */
  write_pth("limits.pth", &w, 0);
  support_ok(context, ern_checkpoint_read(context, "limits.pth", &file));
  assert_non_null(ern_tensor_file_metadata(&file, "ernerf.state"));
  assert_non_null(ern_tensor_file_find(&file, "state.moment.sigma_net.2"));
  ern_tensor_file_free(context, &file);
  ern_context_free(&context);
  w.count = 0;
  put_training(&w, 3, 70); /* dicts of more keys than PyTorch writes */
  read_without_training(&w, "in no order that is known");
  w.count = 0;
  put_training(&w, 4097, 0); /* more tensors than any model's */
  read_without_training(&w, "has 4097 tensors, which are no model's");
  free(w.bytes);
}

/* What would not be read again is not written. */
static void test_writing(void **state) {
  (void)state;
  static struct ern_tensor tensor[ERN_TORCH_ENTRIES];
  static char name[ERN_TORCH_ENTRIES][16];
  static const float one = 1;
  struct words tree = {0};
  ern_context *context = support_context();
  PUT(&tree, "[");
  for (int i = 0; i < ERN_TORCH_ENTRIES; i++) {
    char item[64];
    snprintf(name[i], sizeof name[i], "t%d", i);
    tensor[i] = (struct ern_tensor){.name = name[i], .dtype = ERN_F32, .count = 1, .data = &one};
    put(&tree, item, (size_t)snprintf(item, sizeof item, "%s{\"tensor\":\"t%d\"}", i > 0 ? "," : "", i));
  }
  put(&tree, "]", 2);
  support_expect(context, ern_torch_write(context, "written.pth", tree.bytes, tensor, ERN_TORCH_ENTRIES),
                 ERN_E_UNSUPPORTED, "written.pth: more than 8189 tensors", NULL);
  free(tree.bytes);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_entries), cmocka_unit_test(test_shared_texts),
                                     cmocka_unit_test(test_long_name), cmocka_unit_test(test_trainings),
                                     cmocka_unit_test(test_writing)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
