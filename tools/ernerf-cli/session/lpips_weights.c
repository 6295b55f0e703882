/* SPDX-License-Identifier: MIT */
#include "session/lpips_weights.h"

#include <stdlib.h>

void lpips_weights_options(struct lpips_weights *weights, struct option options[LPIPS_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_TEXT("lpips-network", &weights->network), .choices = "FILE",
       .help = "the weights of AlexNet or VGG16, as torchvision stores them (.pth or .safetensors)"},
      {ARGS_TEXT("lpips-heads", &weights->heads), .choices = "FILE",
       .help = "the weights of LPIPS v0.1 for that network (alex.pth or vgg.pth)"}};
  *weights = (struct lpips_weights){0};
  ARGS_FILL(options, rows, LPIPS_OPTIONS);
}

int lpips_weights_check(const struct lpips_weights *weights, const struct args *args) {
  if ((weights->network == NULL) == (weights->heads == NULL)) return -1;
  return args_refuse(args, "LPIPS needs both --lpips-network and --lpips-heads");
}

int lpips_weights_open(struct lpips_weights *weights, struct session *session) {
  if (weights->network == NULL) return 0;
  return ern_lpips_open(&weights->lpips, session->context, weights->network, weights->heads) == ERN_OK
             ? 0
             : session_fail(session);
}

void lpips_weights_close(struct lpips_weights *weights) { ern_lpips_free(&weights->lpips); }
