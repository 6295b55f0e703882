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
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_average)};
  return cmocka_run_group_tests(tests, make_clip, NULL);
}
