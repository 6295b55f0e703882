/* SPDX-License-Identifier: MIT
 * Which instruction set is chosen: the best of this machine without a wish, the one that is named where the machine has
 * it, and a refusal in words where it has not. */
#include "kernelcheck.h"

#include "backend_cpu/backend_cpu.h"
#include "ernerf/backend.h"

static const struct {
  const char *name;
  machine_isa isa;
} sets[] = {
    {"ref", MACHINE_REF},
    {"ref64", MACHINE_REF},
    {"avx2", MACHINE_AVX2},
    {"avx512", MACHINE_AVX512},
    {"avx512bf16", MACHINE_AVX512BF16},
    {"neon", MACHINE_NEON},
};
enum { SETS = sizeof sets / sizeof *sets };

/* Whether this build has kernels for it, and the machine runs them. */
static bool expected_here(size_t s) {
#if defined(ERN_X86_KERNELS) || defined(ERN_ARM_KERNELS)
  return machine_has(sets[s].isa);
#else
  return sets[s].isa == MACHINE_REF;
#endif
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
    if (sets[s].isa == MACHINE_AVX512BF16 && !ern_cpu_bf16_is_faster()) continue;
    if (expected_here(s)) best = sets[s].name;
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
    if (expected_here(s)) {
      expect_choice(sets[s].name, sets[s].name);
      continue;
    }
    ern_context *context = support_context();
    ern_backend_config config = ern_backend_config_default();
    ern_backend *backend = NULL;
    config.isa = sets[s].name;
    support_expect(context, ern_backend_create(&backend, context, &config), ERN_E_UNSUPPORTED, "instruction set",
                   sets[s].name, "auto ref ref64", NULL);
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
