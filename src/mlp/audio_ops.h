/* SPDX-License-Identifier: MIT
 * From eight windows of speech features to one audio code: AudioNet on each window, AudioAttNet over the eight
 * (docs/maths.md, Speech; after AD-NeRF). */
#ifndef ERN_AUDIO_OPS_H
#define ERN_AUDIO_OPS_H

#include "core/operations.h"
#include "core/types.h"

enum {
  ERN_AUDIO_WINDOWS = 8,
  ERN_AUDIO_CONVS = 4,      /* width -> 32 -> 32 -> 64 -> 64; kernel 3, stride 2, padding 1, LeakyReLU(0.02) */
  ERN_AUDIO_ATT_CONVS = 5,  /* code -> 16 -> 8 -> 4 -> 2 -> 1; kernel 3, stride 1, padding 1, LeakyReLU(0.02) */
  ERN_AUDIO_MAX_CODE = 256, /* most channels of a code: kernels keep eight of them on the stack */
  /* Layers and codes are clamped to this magnitude, and have no gradient beyond it. Eleven consecutive layers would
   * overflow a float once their weights have grown a hundredfold; a useful network's values are below 1e3. */
  ERN_AUDIO_LIMIT = 1000000
};

/* Offsets count from the start of the parameter block; weights as torch stores them: Conv1d [out][in][3], Linear
 * [out][in]. */
struct ern_audio_net {
  int width;         /* D of the features */
  int window_length; /* vectors a window, 1..16 */
  int code;          /* A = 32, at most ERN_AUDIO_MAX_CODE */
  size_t conv_weight[ERN_AUDIO_CONVS], conv_bias[ERN_AUDIO_CONVS];
  size_t fc_weight[2], fc_bias[2]; /* 64 -> 64, LeakyReLU(0.02), 64 -> A */
  size_t att_conv_weight[ERN_AUDIO_ATT_CONVS], att_conv_bias[ERN_AUDIO_ATT_CONVS];
  size_t att_fc_weight, att_fc_bias; /* 8 -> 8, softmax */
  size_t first, count;               /* the part of the block that holds all of these */
};

struct ern_audio_fwd_args {
  ern_span code;       /* out: [A] */
  ern_span windows;    /* [8][window_length][width], as in the file */
  ern_span parameters; /* the whole block */
  struct ern_audio_net net;
  bool keep;        /* a backend may keep values of the layers for the backward pass, in scratch of the caller */
  ern_span kept[3]; /* out: these; zeroed: none */
};
#define ERN_COST_audio_fwd(a) ERN_COST_ELSEWHERE
struct ern_audio_bwd_args {
  ern_span dparameters;              /* the whole block, accumulates */
  ern_span dcode;                    /* [A] */
  struct ern_audio_fwd_args forward; /* code is not used */
};
#define ERN_COST_audio_bwd(a) ERN_COST_ELSEWHERE
/* The same code for consecutive frames, which share windows: AudioNet encodes only the windows that are not known. */
struct ern_audio_frame_args {
  struct ern_audio_fwd_args audio;
  ern_span codes; /* in and out: [8][A], codes of the windows */
  unsigned known; /* bit t: `codes` already holds the code of window t */
};
#define ERN_COST_audio_frame(a) ERN_COST_ELSEWHERE

/* Each of the four strided convolutions turns a window of length L into one of ceil(L/2). L <= 16 leaves exactly one
 * position after the fourth; longer windows are refused before they get here. */
typedef void ern_audio_fwd_kernel(ern_real *code, const ern_real *windows, const ern_real *parameters,
                                  const struct ern_audio_net *net);
typedef void ern_audio_bwd_kernel(ern_real *dparameters, const ern_real *dcode, const ern_real *windows,
                                  const ern_real *parameters, const struct ern_audio_net *net);
/* The two halves of audio_fwd: AudioNet on one window, and AudioAttNet on the codes of all eight. */
typedef void ern_audio_window_kernel(ern_real *code, const ern_real *window, const ern_real *parameters,
                                     const struct ern_audio_net *net);
typedef void ern_audio_mix_kernel(ern_real *code, const ern_real *codes, const ern_real *parameters,
                                  const struct ern_audio_net *net);
/* Backward pass of AudioAttNet: dcodes [8][A] = the gradient by each of the codes [8][A], 0 where a code is clamped;
 * the gradients of its own weights accumulate. */
typedef void ern_audio_mix_bwd_kernel(ern_real *dparameters, ern_real *dcodes, const ern_real *dcode,
                                      const ern_real *codes, const ern_real *parameters,
                                      const struct ern_audio_net *net);

ERN_DECLARE_KERNELS(ERN_AUDIO_OPERATIONS)

#endif
