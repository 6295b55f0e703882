/* SPDX-License-Identifier: MIT
 * The verbs of the program. Each takes the command-line arguments after its name and returns an exit status. */
#ifndef ERN_CLI_VERBS_H
#define ERN_CLI_VERBS_H

struct verb {
  const char *name, *help;
  int (*run)(int argc, char **argv);
};

int cmd_prepare(int argc, char **argv);
int cmd_train(int argc, char **argv);
int cmd_render(int argc, char **argv);
int cmd_dub(int argc, char **argv);
int cmd_join(int argc, char **argv);
int cmd_detect(int argc, char **argv);
int cmd_live(int argc, char **argv);
int cmd_serve(int argc, char **argv);
int cmd_eval(int argc, char **argv);
int cmd_compare(int argc, char **argv);
int cmd_check(int argc, char **argv);
int cmd_info(int argc, char **argv);
int cmd_features(int argc, char **argv);
int cmd_convert(int argc, char **argv);
int cmd_synth(int argc, char **argv);
int cmd_bench(int argc, char **argv);
int cmd_soak(int argc, char **argv);
int cmd_ablate(int argc, char **argv);
int cmd_tradeoff(int argc, char **argv);

#endif
