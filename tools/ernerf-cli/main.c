/* SPDX-License-Identifier: MIT
 * ernerf: trains, renders and evaluates talking portraits. Finds the verb and calls it. */
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "args.h"
#include "completion.h"
#include "ernerf/base.h"
#include "manual.h"
#include "session/session.h"
#include "verbs.h"

static const struct verb verbs[] = {
    {"prepare", "make a clip, the input of train, from the video of a person", cmd_prepare},
    {"train", "learn a head, or the torso for it, from a clip", cmd_train},
    {"render", "render a model, speech and head poses as a video or pictures", cmd_render},
    {"dub", "let the person in a recorded video say new words", cmd_dub},
    {"join", "join videos of successive frames into one, without re-encoding", cmd_join},
    {"detect", "find the watermark of a key in a video", cmd_detect},
    {"live", "render speech while it is spoken, as a stream", cmd_live},
    {"serve", "serve talking portraits over HTTP to many viewers", cmd_serve},
    {"eval", "compare a model with the frames of a clip: PSNR, SSIM, frames a second", cmd_eval},
    {"compare", "compare two portraits on the same frames: figures, pictures, a video, a page", cmd_compare},
    {"check", "list what a clip has, what it lacks, and what follows from that", cmd_check},
    {"info", "describe a file, or list the devices that can compute", cmd_info},
    {"features", "compute speech features of a sound", cmd_features},
    {"convert", "convert a model from .safetensors to PyTorch's .pth, or back", cmd_convert},
    {"synth", "make up a clip to try things on", cmd_synth},
    {"bench", "measure kernels, a frame and a training step against the peaks of the machine", cmd_bench},
    {"tradeoff", "measure accuracy against render time, or with --training PSNR against training time", cmd_tradeoff},
    {"soak", "stress test: thousands of training steps with extreme settings, all values checked", cmd_soak},
    {"ablate", "repeat the paper's ablation on a clip: train its rows, write its tables", cmd_ablate},
};
enum { VERBS = sizeof verbs / sizeof verbs[0] };

static const char summary[] = "Talking portraits, trained and rendered (ER-NeRF).";
static const char notes[] =
    "`ernerf VERB --help` or `ernerf help VERB` lists the options of a verb; `ernerf --version` prints the version.\n"
    "Exit status: 0 done, 1 failed, 2 wrong usage; 130 stopped by Ctrl-C, 129 by SIGHUP, 143 by SIGTERM, whether or\n"
    "not the state of a training was saved.";

static void print_help(FILE *to) {
  fprintf(to, "%s\n\n  ernerf VERB ...\n\n", summary);
  for (int i = 0; i < VERBS; i++) fprintf(to, "  %-8s %s\n", verbs[i].name, verbs[i].help);
  fprintf(to, "\n%s\n", notes);
}

static int refuse_verb(const char *name) {
  const char *names[VERBS];
  for (int i = 0; i < VERBS; i++) names[i] = verbs[i].name;
  const char *nearest = args_nearest(name, names, VERBS);
  if (name[0] == '-')
    fprintf(stderr, "ernerf: unknown option %s, expected a verb, --help or --version\n", name);
  else if (nearest == NULL)
    fprintf(stderr, "ernerf: unknown verb \"%s\"\n", name);
  else
    fprintf(stderr, "ernerf: unknown verb \"%s\", the nearest is %s\n", name, nearest);
  fprintf(stderr, "`ernerf --help` lists the verbs\n");
  return EXIT_USAGE;
}

static int run_verb(const char *name, int argc, char **argv) {
  for (int i = 0; i < VERBS; i++)
    if (strcmp(name, verbs[i].name) == 0) return session_exit_status(verbs[i].run(argc, argv));
  return refuse_verb(name);
}

/* `ernerf help --man [VERB]`, --bash, --zsh: prints the manual pages and completion scripts to be installed. */
static int print_installed(const char *form, const char *verb) {
  char bash[] = "--help=bash", zsh[] = "--help=zsh", man[] = "--help=man", *ask[] = {man};
  int status = EXIT_SUCCESS;
  if (strcmp(form, "--man") == 0) {
    if (verb != NULL) return run_verb(verb, 1, ask);
    manual_print_program(summary, verbs, VERBS, notes);
    return EXIT_SUCCESS;
  }
  const bool is_bash = strcmp(form, "--bash") == 0;
  if (!is_bash && strcmp(form, "--zsh") != 0) return -1;
  ask[0] = is_bash ? bash : zsh;
  is_bash ? completion_begin_bash(verbs, VERBS) : completion_begin_zsh(verbs, VERBS);
  for (int i = 0; i < VERBS && status == EXIT_SUCCESS; i++) status = verbs[i].run(1, ask);
  is_bash ? completion_end_bash() : completion_end_zsh();
  return status;
}

static bool is_one_of(const char *word, const char *one, const char *other) {
  return strcmp(word, one) == 0 || strcmp(word, other) == 0;
}

static int run(int argc, char **argv) {
  char help[] = "--help", *ask[] = {help};
  if (argc < 2) { /* on stderr and as wrong usage: a script that lost its verb must not take this for success */
    print_help(stderr);
    return EXIT_USAGE;
  }
  const char *first = argv[1];
  const bool asks_help = is_one_of(first, "--help", "-h") || strcmp(first, "help") == 0;
  if (asks_help && argc > 2 && argv[2][0] == '-') {
    const int status = print_installed(argv[2], argc > 3 ? argv[3] : NULL);
    if (status >= 0) return status;
  }
  if (asks_help && argc > 2 && argv[2][0] != '-') return run_verb(argv[2], 1, ask);
  if (asks_help) {
    print_help(stdout);
    return EXIT_SUCCESS;
  }
  if (is_one_of(first, "--version", "-V")) {
    printf("ernerf %s\n", ern_version());
    return EXIT_SUCCESS;
  }
  return run_verb(first, argc - 2, argv + 2);
}

/* If a standard stream is closed, occupies its descriptor, so that no file of the program gets it and receives
 * messages. Reads and writes on it still fail. False: the descriptor cannot be occupied. */
static bool streams_are_taken(void) {
  for (int stream = STDIN_FILENO; stream <= STDERR_FILENO; stream++) {
    if (fcntl(stream, F_GETFD) != -1 || errno != EBADF) continue;
    if (open("/dev/null", stream == STDIN_FILENO ? O_WRONLY : O_RDONLY) != stream) return false;
  }
  return true;
}

int main(int argc, char **argv) {
  char expected[32];
  if (!streams_are_taken()) return EXIT_FAILURE; /* without a stream for a message */
  snprintf(expected, sizeof expected, "%d.%d.%d", ERN_VERSION_MAJOR, ERN_VERSION_MINOR, ERN_VERSION_PATCH);
  if (strcmp(ern_version(), expected) != 0) {
    fprintf(stderr, "ernerf: the library's version is %s, expected %s\n", ern_version(), expected);
    return EXIT_FAILURE;
  }
  session_watch_json();
  const int status = run(argc, argv);
  if (status == EXIT_SUCCESS && session_json_refused()) {
    fprintf(stderr, "ernerf: no memory for a JSON value, which what was printed or written may lack\n");
    return EXIT_FAILURE;
  }
  if (status != EXIT_SUCCESS || (fflush(stdout) == 0 && !ferror(stdout))) return status;
  fprintf(stderr, "ernerf: standard output: cannot be written: %s\n", strerror(errno));
  return EXIT_FAILURE;
}
