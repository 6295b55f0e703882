/* SPDX-License-Identifier: MIT
 * `train --time` gone on with: the torso is trained as the head was, and what is in a portrait's way is told before
 * any work. */
#include "cli.h"

static struct cli cli;

#define SMALL "--rays 32 --levels 2 --validate-frames 1 "

static int make_clip(void **state) {
  (void)state;
  support_clear("clip");
  cli_run(&cli, "synth clip --size 64 --frames 22 --quiet");
  cli_expect(&cli, 0, NULL);
  return 0;
}

/* Nothing of the portrait NAME.safetensors. */
static void clear(const char *name) {
  static const char *const parts[] = {".safetensors", ".run", ".head.safetensors", ".head.run"};
  char path[64];
  for (size_t i = 0; i < sizeof parts / sizeof *parts; i++) {
    snprintf(path, sizeof path, "%s%s", name, parts[i]);
    support_clear(path);
  }
}

/* The metadata "ernerf.state" of a state; the caller owns it. */
static json_t *state_of(const char *path) {
  size_t count = 0;
  uint64_t bytes = 0;
  uint8_t *file = cli_bytes(path, &count);
  assert_true(count > 8);
  for (int i = 7; i >= 0; i--) bytes = bytes << 8 | file[i];
  assert_true(bytes <= count - 8);
  json_t *header = json_loadb((const char *)file + 8, (size_t)bytes, 0, NULL);
  const json_t *text = json_object_get(json_object_get(header, "__metadata__"), "ernerf.state");
  json_t *about = json_loads(json_string_value(text), 0, NULL);
  assert_non_null(about);
  json_decref(header);
  free(file);
  return about;
}

static void test_bf16(void **state) {
  (void)state;
  clear("b");
  cli_run(&cli, "train clip -o b.safetensors " SMALL "--time 0.5s --precision bf16");
  if (strstr(cli.err, "bf16 needs") != NULL) skip();
  cli_expect(&cli, 0, "done, b.safetensors", NULL);
  cli_run(&cli, "train clip -o b.safetensors --time 0.5s --precision bf16 --resume");
  cli_expect(&cli, 0, "were done before; b.safetensors", NULL);
  json_t *head = state_of("b.head.run/state.safetensors"), *torso = state_of("b.run/state.safetensors");
  const char *of_head = json_string_value(json_object_get(json_object_get(head, "training"), "precision"));
  const char *of_torso = json_string_value(json_object_get(json_object_get(torso, "training"), "precision"));
  assert_string_equal(of_head, "bf16");
  assert_string_equal(of_torso, "fp32");
  json_decref(head);
  json_decref(torso);
}

/* A time holds as many updates of the average as come: no call is refused for them. */
static void test_average(void **state) {
  (void)state;
  clear("e");
  cli_run(&cli, "train clip -o e.safetensors " SMALL "--time 0.5s --ema --ema-every 1000000");
  cli_expect(&cli, 0, "e.head.safetensors: step ", "e.safetensors: step ", "the average has seen 0 updates", NULL);
  cli_run(&cli, "train clip -o e.safetensors --time 0.5s --resume");
  cli_expect(&cli, 0, "the average has seen 0 updates", "were done before; e.safetensors", NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_bf16), cmocka_unit_test(test_average)};
  return cmocka_run_group_tests(tests, make_clip, NULL);
}
