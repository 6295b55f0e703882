/* SPDX-License-Identifier: MIT
 * ernerf convert: converts a model's file to the other file format. */
#include <stdio.h>
#include <stdlib.h>

#include "ernerf/model.h"
#include "session/session.h"
#include "verbs.h"

struct tensor_sum {
  size_t count;
};

static void count_tensor(void *user, const ern_tensor_info *tensor) {
  (void)tensor;
  ((struct tensor_sum *)user)->count++;
}

static int convert(struct session *session, const char *in, const char *out) {
  struct tensor_sum sum = {0};
  if (session_check_output(session, out) != 0) return EXIT_FAILURE;
  if (ern_file_convert(session->context, in, out) != ERN_OK) return session_fail(session);
  if (ern_file_tensors(session->context, out, count_tensor, &sum) != ERN_OK) return session_fail(session);
  session_note(session, "%s: %zu tensors, from %s", out, sum.count, in);
  return session_report(session, json_pack("{s:o, s:o, s:I}", "in", session_text(in), "out", session_text(out),
                                           "tensors", (json_int_t)sum.count));
}

int cmd_convert(int argc, char **argv) {
  struct session session = {0};
  const char *in = NULL, *out = NULL;
  struct option output[SESSION_OUTPUT_OPTIONS];
  struct word words[] = {{"IN", &in, "a .safetensors or .pth file; its content decides"},
                         {"OUT", &out, "what to write: a name that ends in .safetensors, .pth or .pt"}};
  struct args args = {
      .verb = "convert",
      .summary = "Converts a model from .safetensors to the .pth of the public program (PyTorch), or back.",
      .usage = "convert IN OUT",
      .notes =
          "The optimizer's state and the average of the weights are kept, so that a training can be continued. A "
          ".pth that is written\n"
          "has 10,000 individual codes and an eye branch, as the public program expects; what it cannot\n"
          "hold is refused, and named. Nothing in a .pth is executed.",
      .words = words,
      .word_count = 2,
      .groups = {{"Output:", output, SESSION_OUTPUT_OPTIONS}}};
  session_output_options(&session, output);
  int status = args_parse(&args, argc, argv);
  session.inputs[0] = in;
  if (status < 0) status = session_open(&session, &args);
  if (status >= 0) return status;
  status = convert(&session, in, out);
  session_close(&session);
  return status;
}
