/* SPDX-License-Identifier: MIT
 * Every kernel on every machine against the reference: a file a noun, one program. Without options all of them. */
#include "harness.h"

#define NOUN_ENTRY(which) extern const struct noun noun_##which;
#include "noun_list.h"
#undef NOUN_ENTRY
#define NOUN_ENTRY(which) &noun_##which,
static const struct noun *const nouns[] = {
#include "noun_list.h"
};
#undef NOUN_ENTRY

enum { PASSED = 0, FAILED = 1, MISUSED = 2, SKIPPED = 77 };

struct options {
  const char *op, *isa, *backend;
  uint64_t seed;
  bool bench, list;
};
static struct options options;

static int usage(void) {
  fprintf(stderr,
          "kernelcheck [--op NOUN] [--isa avx2|avx512|avx512bf16|neon] [--backend cpu|opencl] [--seed N] [--bench]\n"
          "kernelcheck --list\n");
  return MISUSED;
}

static bool read_options(int argc, char **argv) {
  for (int i = 1; i < argc; i++) {
    const char *const value = i + 1 < argc ? argv[i + 1] : NULL;
    char *end = NULL;
    if (strcmp(argv[i], "--bench") == 0) {
      options.bench = true;
      continue;
    }
    if (strcmp(argv[i], "--list") == 0) {
      options.list = true;
      continue;
    }
    if (value == NULL) return false;
    i++;
    if (strcmp(argv[i - 1], "--op") == 0) {
      options.op = value;
    } else if (strcmp(argv[i - 1], "--isa") == 0) {
      options.isa = value;
    } else if (strcmp(argv[i - 1], "--backend") == 0) {
      options.backend = value;
    } else if (strcmp(argv[i - 1], "--seed") == 0) {
      options.seed = strtoull(value, &end, 10);
      if (end == value || *end != 0) return false;
    } else {
      return false;
    }
  }
  if (options.backend != NULL && strcmp(options.backend, "cpu") != 0 && strcmp(options.backend, "opencl") != 0)
    return false;
  return true;
}

static struct machines_wish wish_of(const struct noun *noun) {
  struct machines_wish wish = noun->wish;
  wish.isa = options.isa;
  wish.backend = options.isa != NULL ? "cpu" : options.backend;
  if (options.isa != NULL && strcmp(options.isa, "avx512bf16") == 0) wish.bf16 = true;
  return wish;
}

static const struct noun *running;
static int set_up(void **state) {
  (void)state;
  const struct machines_wish wish = wish_of(running);
  machines_open_as(&wish);
  printf("%s:", running->name);
  EACH_MACHINE (k) printf(" %s", machines.name[k]);
  printf("\n");
  return 0;
}

/* A build with OpenCL whose device is not there fails; an instruction set that this machine lacks is skipped. */
static int machines_of(const struct noun *noun) {
  const struct machines_wish wish = wish_of(noun);
  machines_open_as(&wish);
  const int others = machines.count - 1 - wish.in_double;
  machines_close();
  if (others > 0 || (options.isa == NULL && (options.backend == NULL || strcmp(options.backend, "cpu") == 0)))
    return PASSED;
  fprintf(stderr, "%s: not on this machine\n", options.isa != NULL ? options.isa : options.backend);
  return options.isa != NULL ? SKIPPED : FAILED;
}

static int list(void) {
  for (size_t i = 0; i < COUNT_OF(nouns); i++) printf("%s\n", nouns[i]->name);
  machines_open_as(&(struct machines_wish){.in_double = true, .bf16 = true});
  printf("on:");
  EACH_MACHINE (k) printf(" %s", machines.name[k]);
  printf("\n");
  machines_close();
  return PASSED;
}

static int run(const struct noun *noun) {
  const int here = machines_of(noun);
  if (here != PASSED) return here;
  running = noun;
  if (options.bench) {
    set_up(NULL);
    if (noun->bench != NULL) noun->bench();
    machines_close();
    return PASSED;
  }
  const size_t before = machines.checks;
  const int failed = _cmocka_run_group_tests(noun->name, noun->tests, noun->count, set_up, close_machines);
  printf("%s: %zu checks of an array on a machine\n", noun->name, machines.checks - before);
  return failed != 0 ? FAILED : PASSED;
}

int main(int argc, char **argv) {
  int worst = PASSED;
  bool found = false;
  if (!read_options(argc, argv)) return usage();
  machines.seed = options.seed;
  if (!is_long() && !is_small()) cmocka_set_skip_filter("*_long");
  if (options.list) return list();
  for (size_t i = 0; i < COUNT_OF(nouns); i++) {
    if (options.op != NULL && strcmp(options.op, nouns[i]->name) != 0) continue;
    found = true;
    const int status = run(nouns[i]);
    if (status != PASSED && worst != FAILED) worst = status;
  }
  if (!found) fprintf(stderr, "kernelcheck: no noun \"%s\" (--list names them)\n", options.op);
  return found ? worst : MISUSED;
}
