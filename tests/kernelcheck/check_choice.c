/* SPDX-License-Identifier: MIT
 * Which instruction set is chosen: the best of this machine without a wish, the one that is named where the machine has
 * it, and a refusal in words where it has not. */
#include <stdbool.h>

#include "../support.h"

#include "backend_cpu/backend_cpu.h"
#include "ernerf/backend.h"

static const char *const sets[] = {"ref", "ref64", "avx2", "avx512", "avx512bf16", "neon"};
enum { SETS = sizeof sets / sizeof *sets };

/* Whether this build has kernels for it, and the machine runs them; by the compiler's own look at the processor. */
static bool expected_here(const char *set) {
#if defined(ERN_X86_KERNELS)
  const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  const bool avx512 = avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
                      __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl");
  if (strcmp(set, "avx2") == 0) return avx2;
  if (strcmp(set, "avx512") == 0) return avx512;
  if (strcmp(set, "avx512bf16") == 0) return avx512 && __builtin_cpu_supports("avx512bf16");
#elif defined(ERN_ARM_KERNELS)
  if (strcmp(set, "neon") == 0) return true;
#endif
  return strncmp(set, "ref", 3) == 0;
}

static void expect_choice(const char *wanted, const char *expected) {
  ern_context *context = support_context();
  ern_backend_config config = ern_backend_config_default();
  ern_backend *backend = NULL;
  ern_backend_info info;
  config.isa = wanted;
  support_ok(context, ern_backend_create(&backend, context, &config));
  ern_backend_describe(backend, &info);
  assert_string_equal(info.name, "cpu");
  assert_string_equal(info.isa, expected);
  ern_backend_free(&backend);
  ern_context_free(&context);
}

static void test_best(void **state) {
  (void)state;
  const char *best = "ref";
  for (size_t s = 2; s < SETS; s++) {
    if (strcmp(sets[s], "avx512bf16") == 0 && !ern_cpu_bf16_is_faster()) continue;
    if (expected_here(sets[s])) best = sets[s];
  }
  print_message("the best here: %s\n", best);
  assert_int_equal(unsetenv("ERNERF_ISA"), 0);
  expect_choice(NULL, best);
  expect_choice("auto", best);
  assert_int_equal(setenv("ERNERF_ISA", "ref64", 1), 0);
  expect_choice("auto", "ref64");
  expect_choice(best, best);
  assert_int_equal(unsetenv("ERNERF_ISA"), 0);
}

static void test_named(void **state) {
  (void)state;
  for (size_t s = 0; s < SETS; s++) {
    if (expected_here(sets[s])) {
      expect_choice(sets[s], sets[s]);
      continue;
    }
    ern_context *context = support_context();
    ern_backend_config config = ern_backend_config_default();
    ern_backend *backend = NULL;
    config.isa = sets[s];
    support_expect(context, ern_backend_create(&backend, context, &config), ERN_E_UNSUPPORTED, "instruction set",
                   sets[s], "auto ref ref64", NULL);
    assert_null(backend);
    ern_context_free(&context);
  }
}

/* A name that is none is refused before a device is looked for, whether there is one or not. */
static void test_named_beside_opencl(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_backend_config config = ern_backend_config_default();
  ern_backend *backend = NULL;
  config.name = "opencl";
  config.isa = "nonsense";
  support_expect(context, ern_backend_create(&backend, context, &config), ERN_E_UNSUPPORTED, "instruction set",
                 "nonsense", "auto ref ref64", NULL);
  assert_null(backend);
  ern_context_free(&context);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_best),
      cmocka_unit_test(test_named),
      cmocka_unit_test(test_named_beside_opencl),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
