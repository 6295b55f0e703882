/* SPDX-License-Identifier: MIT
 * Slots of the audio networks. */
#include "backend_opencl/opencl.h"
#include "mlp/audio_ops.h"

/* As kernels/audio.cl has them. */
enum { GROUP = 64, WINDOWS = ERN_AUDIO_WINDOWS, BLOCK = 8, HIDDEN = 64, WINDOW_VALUES = 640, ATT_VALUES = 256 };

struct audio_net {
  cl_ulong conv_weight[ERN_AUDIO_CONVS], conv_bias[ERN_AUDIO_CONVS], fc_weight[2], fc_bias[2];
  cl_ulong att_conv_weight[ERN_AUDIO_ATT_CONVS], att_conv_bias[ERN_AUDIO_ATT_CONVS], att_fc_weight, att_fc_bias;
  cl_int width, window_length, code, padding;
};
_Static_assert(sizeof(struct audio_net) == 24 * sizeof(cl_ulong) + 4 * sizeof(cl_int), "as the kernels have it");

static struct audio_net net_of(const struct ern_audio_net *from) {
  struct audio_net net = {.att_fc_weight = from->att_fc_weight,
                          .att_fc_bias = from->att_fc_bias,
                          .width = from->width,
                          .window_length = from->window_length,
                          .code = from->code};
  for (int l = 0; l < ERN_AUDIO_CONVS; l++) {
    net.conv_weight[l] = from->conv_weight[l];
    net.conv_bias[l] = from->conv_bias[l];
  }
  for (int l = 0; l < 2; l++) {
    net.fc_weight[l] = from->fc_weight[l];
    net.fc_bias[l] = from->fc_bias[l];
  }
  for (int l = 0; l < ERN_AUDIO_ATT_CONVS; l++) {
    net.att_conv_weight[l] = from->att_conv_weight[l];
    net.att_conv_bias[l] = from->att_conv_bias[l];
  }
  return net;
}

/* Intermediate values of a forward pass on the device. */
struct workspace {
  ern_span codes;  /* [8][A] */
  ern_span values; /* [8][WINDOW_VALUES]: values of AudioNet's layers */
  ern_span att;    /* [ATT_VALUES]: values of AudioAttNet's layers, and the windows' weights */
};

static ern_status take_workspace(struct ern_stream *stream, const struct ern_audio_net *net,
                                 struct workspace *workspace) {
  ern_status status = ERN_OK;
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, (size_t)WINDOWS * (size_t)net->code, &workspace->codes));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, (size_t)WINDOWS * WINDOW_VALUES, &workspace->values));
  ERN_TRY(ern_scratch_take(stream, ERN_ELEMENT_REAL, ATT_VALUES, &workspace->att));
fail:
  return status;
}

/* Codes of the windows whose bit of `known` is not set. */
static ern_status windows_fwd(struct ern_stream *stream, const struct workspace *workspace,
                              const struct ern_audio_fwd_args *a, unsigned known) {
  const struct audio_net net = net_of(&a->net);
  cl_uint order = 0;
  size_t groups = 0;
  for (cl_uint t = 0; t < WINDOWS; t++) {
    if ((known >> t & 1) == 0) order |= t << 4 * groups++;
  }
  if (groups == 0) return ERN_OK;
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_audio, "audio_windows", "");
  ERN_CL_ARGS(&call, workspace->codes, workspace->values, a->windows, a->parameters);
  ern_cl_value(&call, &net, sizeof net);
  ern_cl_value(&call, &order, sizeof order);
  return ern_cl_run(&call, groups, GROUP);
}

static ern_status mix_fwd(struct ern_stream *stream, ern_span code, const struct workspace *workspace,
                          const struct ern_audio_fwd_args *a) {
  const struct audio_net net = net_of(&a->net);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_audio, "audio_mix", "");
  ERN_CL_ARGS(&call, code, workspace->att, workspace->codes, a->parameters);
  ern_cl_value(&call, &net, sizeof net);
  return ern_cl_run(&call, 1, GROUP);
}

ern_status ern_cl_audio_fwd(struct ern_stream *stream, struct ern_audio_fwd_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  struct workspace workspace;
  ern_status status = ERN_OK;
  ERN_TRY(take_workspace(stream, &a->net, &workspace));
  ERN_TRY(windows_fwd(stream, &workspace, a, 0));
  ERN_TRY(mix_fwd(stream, a->code, &workspace, a));
  if (a->keep) {
    a->kept[0] = workspace.codes, a->kept[1] = workspace.values, a->kept[2] = workspace.att;
    return ERN_OK;
  }
fail:
  ern_arena_release(stream, mark);
  return status;
}

ern_status ern_cl_audio_frame(struct ern_stream *stream, struct ern_audio_frame_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  struct workspace workspace;
  ern_status status = ERN_OK;
  ERN_TRY(take_workspace(stream, &a->audio.net, &workspace));
  workspace.codes = a->codes;
  ERN_TRY(windows_fwd(stream, &workspace, &a->audio, a->known));
  ERN_TRY(mix_fwd(stream, a->audio.code, &workspace, &a->audio));
fail:
  ern_arena_release(stream, mark);
  return status;
}

/* ---- backward ---------------------------------------------------------------------------------------------------- */

/* d: gradients by the codes, and by the values of the workspace */
static ern_status mix_bwd(struct ern_stream *stream, const struct ern_audio_bwd_args *a,
                          const struct workspace *workspace, const struct workspace *d) {
  const struct audio_net net = net_of(&a->forward.net);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_audio, "audio_mix_bwd", "");
  ERN_CL_ARGS(&call, a->dparameters, d->codes, d->att, a->dcode, workspace->codes, workspace->att,
              a->forward.parameters);
  ern_cl_value(&call, &net, sizeof net);
  return ern_cl_run(&call, 1, GROUP);
}

static ern_status windows_bwd(struct ern_stream *stream, const struct ern_audio_bwd_args *a,
                              const struct workspace *workspace, const struct workspace *d) {
  const struct audio_net net = net_of(&a->forward.net);
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_audio, "audio_windows_bwd", "");
  ERN_CL_ARGS(&call, d->values, d->codes, workspace->values, a->forward.parameters);
  ern_cl_value(&call, &net, sizeof net);
  return ern_cl_run(&call, WINDOWS, GROUP);
}

static ern_status windows_weights(struct ern_stream *stream, const struct ern_audio_bwd_args *a,
                                  const struct workspace *workspace, const struct workspace *d) {
  static const size_t out[ERN_AUDIO_CONVS] = {32, 32, 64, 64};
  const struct audio_net net = net_of(&a->forward.net);
  size_t items = (HIDDEN + (size_t)a->forward.net.code) * (HIDDEN / BLOCK);
  for (int l = 0; l < ERN_AUDIO_CONVS; l++) {
    const size_t in = l > 0 ? out[l - 1] : (size_t)a->forward.net.width;
    items += out[l] * ((in + BLOCK - 1) / BLOCK);
  }
  struct ern_cl_call call = ern_cl_begin(stream, ERN_CL_audio, "audio_windows_weights", "");
  ERN_CL_ARGS(&call, a->dparameters, d->values, d->codes, workspace->values, a->forward.windows);
  ern_cl_value(&call, &net, sizeof net);
  ern_cl_size(&call, items);
  return ern_cl_each(&call, items);
}

ern_status ern_cl_audio_bwd(struct ern_stream *stream, struct ern_audio_bwd_args *a) {
  const struct ern_arena_mark mark = ern_arena_mark(stream);
  struct workspace workspace, d;
  ern_status status = ERN_OK;
  ERN_TRY(take_workspace(stream, &a->forward.net, &d));
  if (a->forward.kept[0].buffer != NULL) {
    workspace = (struct workspace){a->forward.kept[0], a->forward.kept[1], a->forward.kept[2]};
  } else {
    ERN_TRY(take_workspace(stream, &a->forward.net, &workspace));
    ERN_TRY(windows_fwd(stream, &workspace, &a->forward, 0));
    ERN_TRY(mix_fwd(stream, (ern_span){0}, &workspace, &a->forward));
  }
  ERN_TRY(mix_bwd(stream, a, &workspace, &d));
  ERN_TRY(windows_bwd(stream, a, &workspace, &d));
  ERN_TRY(windows_weights(stream, a, &workspace, &d));
fail:
  ern_arena_release(stream, mark);
  return status;
}
