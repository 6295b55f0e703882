/* SPDX-License-Identifier: MIT
 * The parser of the command line, in the test's own process: names, values of each kind, help. */
#include "../support.h"

#include <stdbool.h>
#include <unistd.h>

#include "../../tools/ernerf-cli/args.c"

/* One option of each kind. */
struct values {
  bool flag, off;
  int number, choice;
  uint64_t count, most, bytes;
  float real;
  const char *text, *json, *first, *second;
  bool rare, rare_off;
  int rare_number;
  struct range range, pair;
  struct dimensions size;
};

enum { OPTIONS = 16 };

static struct values got;
static struct option options[OPTIONS];
static struct word words[2];
static char said[4096];

static struct args fresh(void) {
  got = (struct values){.off = true};
  const struct option rows[OPTIONS] = {
      {.name = "flag", .kind = OPTION_FLAG, .target = &got.flag, .help = "a switch"},
      {.name = "no-off", .kind = OPTION_OFF, .target = &got.off, .help = "a switch that takes away"},
      {.name = "number", .kind = OPTION_INT, .target = &got.number, .low = -3, .high = 1000000, .help = "a number"},
      {.name = "count", .kind = OPTION_COUNT, .target = &got.count, .low = 1, .high = 1e12, .help = "a count"},
      {.name = "seed", .kind = OPTION_COUNT, .target = &got.most, .low = 0, .help = "a count without an end"},
      {.name = "real",
       .alias = "lr_net",
       .kind = OPTION_FLOAT,
       .target = &got.real,
       .low = 0,
       .high = 2,
       .help = "a real"},
      {.name = "o", .alias = "output out_put", .kind = OPTION_TEXT, .target = &got.text, .help = "a text"},
      {.name = "memory", .kind = OPTION_BYTES, .target = &got.bytes, .help = "bytes"},
      {.name = "audio-pad", .kind = OPTION_CHOICE, .target = &got.choice, .choices = "edge|zero", .help = "a choice"},
      {.name = "frames", .kind = OPTION_RANGE, .target = &got.range, .help = "a range"},
      {.name = "data_range", .kind = OPTION_RANGE_PAIR, .target = &got.pair, .help = "a range of two words"},
      {.name = "size", .kind = OPTION_DIMENSIONS, .target = &got.size, .low = 1, .high = 8192, .help = "a size"},
      {.name = "json",
       .kind = OPTION_JSON,
       .target = &got.json,
       .help =
           "a help text that is long enough to need a second line when it is printed beside the name of its option"},
      {.name = "rare-flag", .seldom = true, .kind = OPTION_FLAG, .target = &got.rare, .help = "a seldom one"},
      {.name = "rare-off", .seldom = true, .kind = OPTION_OFF, .target = &got.rare_off, .help = "one that takes away"},
      {.name = "rare_number",
       .seldom = true,
       .published = true,
       .kind = OPTION_INT,
       .target = &got.rare_number,
       .low = 1,
       .high = 9,
       .help = "a seldom number with a public name"}};
  memcpy(options, rows, sizeof rows);
  words[0] = (struct word){"FIRST", &got.first, "a word"};
  words[1] = (struct word){"SECOND", &got.second, "another word"};
  return (struct args){.verb = "test",
                       .summary = "A test.",
                       .usage = "test FIRST SECOND",
                       .words = words,
                       .word_count = 2,
                       .groups = {{"Some:", options, 7}, {"Others:", options + 7, OPTIONS - 7}}};
}

/* Parses "a b LINE", split at spaces, and keeps what is said on stderr. */
static int parse(const char *line) {
  static char copy[1024];
  char *argv[64] = {"a", "b"};
  int argc = 2;
  struct args args = fresh();
  snprintf(copy, sizeof copy, "%s", line);
  for (char *at = strtok(copy, " "); at != NULL; at = strtok(NULL, " ")) argv[argc++] = at;
  const int keep = dup(STDERR_FILENO);
  assert_non_null(freopen("said.txt", "w", stderr));
  const int status = args_parse(&args, argc, argv);
  fflush(stderr);
  dup2(keep, STDERR_FILENO);
  close(keep);
  FILE *file = fopen("said.txt", "r");
  assert_non_null(file);
  said[fread(said, 1, sizeof said - 1, file)] = 0;
  fclose(file);
  return status;
}

static void accept(const char *line) {
  if (parse(line) != -1) fail_msg("%s: refused: %s", line, said);
  assert_string_equal(said, "");
}

static void refuse(const char *line, const char *word, const char *other) {
  if (parse(line) != EXIT_USAGE) fail_msg("%s: accepted", line);
  if (strstr(said, word) == NULL || strstr(said, other) == NULL)
    fail_msg("%s: said \"%s\", expected \"%s\" and \"%s\"", line, said, word, other);
}

/* Seldom options: by --set, and by their own name where it is published. */
static void test_set(void **state) {
  (void)state;
  accept("--set rare-flag=yes --set=rare_number=3 --flag");
  assert_true(got.rare && got.rare_number == 3 && got.flag);
  accept("--rare-number 4 --set rare-off=yes --set rare-flag=no");
  assert_true(got.rare_number == 4 && !got.rare_off && !got.rare);
  accept("--set rare-off=no");
  assert_true(got.rare_off);
  refuse("--rare-flag", "--rare-flag is --set rare-flag=VALUE", "");
  refuse("--set rare-flag=1", "--set rare-flag is \"1\"", "yes or no");
  refuse("--set rare-number=10", "--rare_number is \"10\"", "from 1 to 9");
  refuse("--set rare-numbr=1", "there is no such setting, the nearest is rare_number", "--set help");
  refuse("--set flag=yes", "--set flag: there is no such setting", "--set help");
  refuse("--set rare-flag", "expected NAME=VALUE", "--set help");
  refuse("--set =yes", "expected NAME=VALUE", "");
  refuse("--set", "--set is \"\"", "expected NAME=VALUE");
}

static void test_names(void **state) {
  (void)state;
  accept("--flag --no_off --audio-pad zero --data-range 1:2 --lr-net 1.5");
  assert_true(got.flag && !got.off && got.choice == 1 && got.real == 1.5f);
  assert_string_equal(got.first, "a");
  assert_string_equal(got.second, "b");
  accept("--audio-pad=edge --out-put=x=y");
  assert_string_equal(got.text, "x=y");
  accept("-o name");
  assert_string_equal(got.text, "name");
  accept("-oname --flag");
  assert_string_equal(got.text, "name");
  assert_true(got.flag);
  accept("-oa=b");
  assert_string_equal(got.text, "a=b");
  accept("-o-");
  assert_string_equal(got.text, "-");
  accept("-o=name");
  assert_string_equal(got.text, "name");
  refuse("-output name", "unknown option -output", "nearest is --output"); /* not -o with "utput" */
  accept("--output - --number 5");
  assert_string_equal(got.text, "-");
  struct args args = fresh();
  char *argv[] = {"a", "--", "--flag"};
  assert_int_equal(args_parse(&args, 3, argv), -1); /* all are words after "--" */
  assert_string_equal(got.second, "--flag");
  assert_false(args_given(&args, "flag"));
  char *given[] = {"a", "--lr-net", "1", "b"};
  args = fresh();
  assert_int_equal(args_parse(&args, 4, given), -1);
  assert_true(args_given(&args, "real") && args_given(&args, "lr-net"));
  refuse("-o one --output two", "is given twice", "\"one\" and as \"two\"");
  accept("-o one -oone --number 1 --number 2");
  refuse("--flags", "--flags", "nearest is --flag");
  refuse("--memroy 5", "--memroy", "nearest is --memory");
  refuse("--outptu 5", "--outptu", "nearest is --output");
  refuse("--width 5", "unknown option --width\n", "--help"); /* nothing is near */
  refuse("--x", "unknown option --x\n", "--help");
  accept("--");
}

static void test_words(void **state) {
  (void)state;
  struct args args = fresh();
  char *argv[] = {"a"};
  assert_int_equal(args_parse(&args, 0, argv), EXIT_USAGE);
  assert_int_equal(args_parse(&args, 1, argv), EXIT_USAGE);
  refuse("c", "\"c\"", "expected 2 at most");
  refuse("--flag=yes", "--flag", "switch");
  refuse("-flag", "unknown option -flag", "--flag");
  refuse("--o x", "unknown option --o", "nearest is -o");
  refuse("--number", "--number", "needs a value");
  refuse("--number --flag", "--number", "needs a value");
}

static void test_numbers(void **state) {
  (void)state;
  accept("--number -3 --count 1000000000000 --seed 18446744073709551615 --real 0");
  assert_true(got.number == -3 && got.count == 1000000000000 && got.most == UINT64_MAX && got.real == 0);
  refuse("--number -4", "\"-4\"", "-3 to 1000000");
  refuse("--number 1000001", "\"1000001\"", "-3 to 1000000");
  refuse("--number 1.5", "\"1.5\"", "whole number");
  refuse("--number 5x", "\"5x\"", "whole number");
  refuse("--number 0x10", "\"0x10\"", "whole number");
  refuse("--count 0", "\"0\"", "from 1 to 1000000000000");
  refuse("--count 99999999999999999999", "9999", "whole number");
  refuse("--seed 18446744073709551616", "1616", "0 or more");
  refuse("--seed -1", "\"-1\"", "0 or more");
  refuse("--real 2.1", "\"2.1\"", "from 0 to 2");
  refuse("--real nan", "\"nan\"", "from 0 to 2");
  refuse("--real inf", "\"inf\"", "from 0 to 2");
  refuse("--real 1,5", "\"1,5\"", "number");
  refuse("-o=", "-o is \"\"", "value");
}

static void test_kinds(void **state) {
  (void)state;
  accept("--memory 512M --frames 3:9 --data-range 0 -1 --size 640x480");
  assert_true(got.bytes == 512u << 20 && got.range.begin == 3 && got.range.end == 9 && !got.range.open_end);
  assert_true(got.pair.begin == 0 && got.pair.open_end && got.size.width == 640 && got.size.height == 480);
  accept("--memory 2k --frames :4 --data-range 5 8");
  assert_true(got.bytes == 2048 && got.range.begin == 0 && got.range.end == 4);
  assert_true(got.pair.begin == 5 && got.pair.end == 8 && !got.pair.open_end);
  accept("--memory 7 --frames 4: --data-range 5:8 --flag");
  assert_true(got.bytes == 7 && got.range.begin == 4 && got.range.open_end && got.pair.end == 8 && got.flag);
  refuse("--memory 0", "\"0\"", "bytes");
  refuse("--memory 5MB", "\"5MB\"", "bytes");
  refuse("--memory M", "\"M\"", "bytes");
  refuse("--memory 99999999999G", "99999999999G", "bytes");
  refuse("--frames 5:5", "\"5:5\"", "A < B");
  refuse("--frames 5", "\"5\"", "A:B");
  refuse("--frames 5:-1", "\"5:-1\"", "A:B");
  refuse("--frames 1:2:3", "\"1:2:3\"", "A:B");
  refuse("--data-range 5 2", "\"5:2\"", "A < B");
  refuse("--size 64", "\"64\"", "WxH");
  refuse("--size 64x", "\"64x\"", "WxH");
  refuse("--size 0x64", "\"0x64\"", "from 1 to 8192");
  refuse("--size 64x8193", "\"64x8193\"", "from 1 to 8192");
  refuse("--audio-pad none", "\"none\"", "edge|zero");
  refuse("--audio-pad edg", "\"edg\"", "edge|zero");
  refuse("--audio-pad edge|zero", "\"edge|zero\"", "one of");
}

/* The next word is taken only if it is - or ends in .json. */
static void test_json(void **state) {
  (void)state;
  accept("--json");
  assert_string_equal(got.json, "-");
  accept("--json - --flag");
  assert_string_equal(got.json, "-");
  accept("--json out.json");
  assert_string_equal(got.json, "out.json");
  accept("--json=out.json");
  assert_string_equal(got.json, "out.json");
  accept("--json --flag");
  assert_true(got.flag);
  refuse("--json out.txt", "\"out.txt\"", "expected 2 at most");
  refuse("--json=out.txt", "\"out.txt\"", ".json");
  refuse("--json=.json", "\".json\"", ".json");
}

static void test_forbid(void **state) {
  (void)state;
  struct args args = fresh();
  char *argv[] = {"a", "b", "--flag"};
  assert_int_equal(args_parse(&args, 3, argv), -1);
  assert_int_equal(args_forbid(&args, "number memory", "is not for here"), -1);
  assert_int_equal(args_forbid(&args, "number flag", "is not for here"), EXIT_USAGE);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_set),   cmocka_unit_test(test_names),
                                     cmocka_unit_test(test_words), cmocka_unit_test(test_numbers),
                                     cmocka_unit_test(test_kinds), cmocka_unit_test(test_json),
                                     cmocka_unit_test(test_forbid)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
