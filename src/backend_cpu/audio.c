/* SPDX-License-Identifier: MIT
 * Slots of the audio networks. */
#include "backend_cpu/slots.h"
#include "mlp/audio_ops.h"

ern_status ERN_REF(ern_cpu_audio_fwd)(struct ern_stream *stream, struct ern_audio_fwd_args *a) {
  kernels_of(stream)->audio_fwd(reals(a->code), reals(a->windows), reals(a->parameters), &a->net);
  return ERN_OK;
}
ern_status ERN_REF(ern_cpu_audio_bwd)(struct ern_stream *stream, struct ern_audio_bwd_args *a) {
  kernels_of(stream)->audio_bwd(reals(a->dparameters), reals(a->dcode), reals(a->forward.windows),
                                reals(a->forward.parameters), &a->forward.net);
  return ERN_OK;
}
static void audio_window_task(void *user, size_t t, int worker) {
  (void)worker;
  const struct job *job = user;
  const struct ern_audio_frame_args *a = job->args;
  const struct ern_audio_net *net = &a->audio.net;
  if ((a->known >> t & 1) != 0) return;
  job->kernels->audio_window(reals(a->codes) + t * (size_t)net->code,
                             reals(a->audio.windows) + t * (size_t)net->window_length * (size_t)net->width,
                             reals(a->audio.parameters), net);
}
ern_status ERN_REF(ern_cpu_audio_frame)(struct ern_stream *stream, struct ern_audio_frame_args *a) {
  run(stream, a, ERN_AUDIO_WINDOWS, audio_window_task);
  kernels_of(stream)->audio_mix(reals(a->audio.code), reals(a->codes), reals(a->audio.parameters), &a->audio.net);
  return ERN_OK;
}
