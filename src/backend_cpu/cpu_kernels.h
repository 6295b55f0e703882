/* SPDX-License-Identifier: MIT
 * What the CPU's slots call: one kernel a stage, in the scalar of the build. backend_cpu.c fills it with the reference
 * and lets an instruction set overwrite what it does faster. */
#ifndef ERN_CPU_KERNELS_H
#define ERN_CPU_KERNELS_H

#include <stdatomic.h>

#include "core/backend.h"
#include "core/threads.h"

/* kernel, its type: the ones that an instruction set may overwrite and those that only the reference has, alike */
#define ERN_CPU_KERNELS(KERNEL)                               \
  KERNEL(rays, ern_rays_kernel)                               \
  KERNEL(march, ern_march_kernel)                             \
  KERNEL(march_from, ern_march_from_kernel)                   \
  KERNEL(samples, ern_samples_kernel)                         \
  KERNEL(grid_fwd, ern_grid_fwd_kernel)                       \
  KERNEL(grid_bwd, ern_grid_bwd_kernel)                       \
  KERNEL(mlp_fwd, ern_mlp_fwd_kernel)                         \
  KERNEL(mlp_bwd, ern_mlp_bwd_kernel)                         \
  KERNEL(activate_fwd, ern_activate_fwd_kernel)               \
  KERNEL(activate_bwd, ern_activate_bwd_kernel)               \
  KERNEL(sh_fwd, ern_sh_kernel)                               \
  KERNEL(freq_fwd, ern_freq_fwd_kernel)                       \
  KERNEL(freq_bwd, ern_freq_bwd_kernel)                       \
  KERNEL(audio_fwd, ern_audio_fwd_kernel)                     \
  KERNEL(audio_bwd, ern_audio_bwd_kernel)                     \
  KERNEL(audio_window, ern_audio_window_kernel)               \
  KERNEL(audio_mix, ern_audio_mix_kernel)                     \
  KERNEL(attention_fwd, ern_attention_fwd_kernel)             \
  KERNEL(attention_bwd, ern_attention_bwd_kernel)             \
  KERNEL(composite_fwd, ern_composite_fwd_kernel)             \
  KERNEL(composite_bwd, ern_composite_bwd_kernel)             \
  KERNEL(occupancy_mark, ern_occupancy_mark_kernel)           \
  KERNEL(occupancy_list, ern_occupancy_list_kernel)           \
  KERNEL(occupancy_points, ern_occupancy_points_kernel)       \
  KERNEL(occupancy_update, ern_occupancy_update_kernel)       \
  KERNEL(occupancy_pack, ern_occupancy_pack_kernel)           \
  KERNEL(torso_pose_fwd, ern_torso_pose_fwd_kernel)           \
  KERNEL(torso_pose_bwd, ern_torso_pose_bwd_kernel)           \
  KERNEL(torso_coords, ern_torso_coords_kernel)               \
  KERNEL(torso_select, ern_torso_select_kernel)               \
  KERNEL(torso_deform_fwd, ern_torso_deform_fwd_kernel)       \
  KERNEL(torso_deform_bwd, ern_torso_deform_bwd_kernel)       \
  KERNEL(torso_composite_fwd, ern_torso_composite_fwd_kernel) \
  KERNEL(torso_composite_bwd, ern_torso_composite_bwd_kernel) \
  KERNEL(torso_points, ern_torso_points_kernel)               \
  KERNEL(torso_update, ern_torso_update_kernel)               \
  KERNEL(head_softmax, ern_head_softmax_kernel)               \
  KERNEL(head_loss, ern_head_loss_kernel)                     \
  KERNEL(smooth_loss, ern_smooth_loss_kernel)                 \
  KERNEL(smooth_points, ern_smooth_points_kernel)             \
  KERNEL(mse, ern_mse_kernel)                                 \
  KERNEL(key_points_loss, ern_key_points_loss_kernel)         \
  KERNEL(adamw, ern_adamw_kernel)                             \
  KERNEL(backdrop, ern_backdrop_kernel)                       \
  KERNEL(picture, ern_picture_kernel)                         \
  KERNEL(enlarge, ern_enlarge_kernel)                         \
  KERNEL(pick, ern_pick_kernel)                               \
  KERNEL(place, ern_pick_kernel)                              \
  KERNEL(blend, ern_blend_kernel)                             \
  KERNEL(overlay, ern_overlay_kernel)                         \
  KERNEL(ema, ern_ema_kernel)                                 \
  KERNEL(finite, ern_finite_kernel)

struct ern_cpu_kernels {
#define ERN_KERNEL_MEMBER(kernel, type) type *kernel;
  ERN_CPU_KERNELS(ERN_KERNEL_MEMBER)
#undef ERN_KERNEL_MEMBER
};

struct ern_buffer {
  ern_element element;
  size_t count;
  void *memory;
};

struct ern_frame_net;
struct ern_render_work;
struct ern_profile;

/* Takes rays off the work's order until none is left (render_lane.h). */
typedef void ern_render_lane_kernel(const struct ern_render_work *work, atomic_size_t *next, void *scratch,
                                    struct ern_profile *profile);

struct ern_train_kernels;
struct ern_train_room;

struct ern_cpu_backend {
  struct ern_backend table; /* first: a backend is one */
  const void *kernels;      /* struct ern_cpu_kernels of this build's scalar */
  void *kernel_room;
  /* the fused pass of rendering; NULL: render_rays goes through the stages */
  ern_render_lane_kernel *render_lane;
  bool render_pairs; /* it reads a net in pairs of bf16 (frame_net.h) */
  ern_status (*render_rays_stages)(struct ern_stream *, struct ern_render_rays_args *);
  const struct ern_train_kernels *train; /* of the fused training step; NULL: head_step goes through the stages */
};

struct ern_cpu_stream {
  struct ern_stream base;       /* first: a stream is one */
  struct ern_pool *pool;        /* NULL in a lane: its work is one task of its owner's pool */
  struct ern_cpu_stream **lane; /* serial streams for tasks that run whole stages; [threads], NULL in a lane */
  int lanes;
  struct ern_frame_net *net; /* what render_prepare made, of the parameters net_of; NULL: nothing */
  ern_span net_of;
  struct ern_train_room *train_room; /* memory of the fused training step; NULL: none was made */
};

/* Fills the slots, copies and fills of a table (memory.c, compiled once a scalar). */
void ern_cpu_fill_slots_ref(struct ern_backend *backend);
void ern_cpu_fill_slots_ref64(struct ern_backend *backend);
/* The kernels of the reference. */
void ern_cpu_fill_kernels_ref(void *kernels);
void ern_cpu_fill_kernels_ref64(void *kernels);

#endif
