/* SPDX-License-Identifier: MIT
 * The reference kernels of mlp_ops.h and audio_ops.h. */
#ifndef ERN_MLP_H
#define ERN_MLP_H

#include "mlp/audio_ops.h"
#include "mlp/mlp_ops.h"

/* Reals of scratch that a forward or backward kernel of any instruction set needs. */
size_t ern_mlp_scratch(const struct ern_mlp *mlp);

ern_mlp_fwd_kernel ERN_REF(ern_mlp_fwd);
ern_mlp_bwd_kernel ERN_REF(ern_mlp_bwd);
ern_activate_fwd_kernel ERN_REF(ern_activate_fwd);
ern_activate_bwd_kernel ERN_REF(ern_activate_bwd);
ern_sh_kernel ERN_REF(ern_sh_fwd);
ern_freq_fwd_kernel ERN_REF(ern_freq_fwd);
ern_freq_bwd_kernel ERN_REF(ern_freq_bwd);
ern_audio_fwd_kernel ERN_REF(ern_audio_fwd);
ern_audio_bwd_kernel ERN_REF(ern_audio_bwd);
ern_audio_window_kernel ERN_REF(ern_audio_window);
ern_audio_mix_kernel ERN_REF(ern_audio_mix);

#endif
