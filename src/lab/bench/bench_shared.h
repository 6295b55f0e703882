/* SPDX-License-Identifier: MIT
 * Shared parts of the benchmarks: timing in turns, options, the scene. Internal. */
#ifndef ERN_LAB_BENCH_SHARED_H
#define ERN_LAB_BENCH_SHARED_H

#include "core/backend.h"
#include "ernerf-lab/bench.h"
#include "hashgrid/hashgrid_ops.h"
#include "mlp/activation_ops.h"
#include "mlp/audio_ops.h"
#include "mlp/encoding_ops.h"
#include "mlp/mlp_ops.h"
#include "model/attention_ops.h"
#include "model/model.h"
#include "model/torso_ops.h"
#include "render/composite_ops.h"
#include "render/march_ops.h"
#include "render/occupancy_ops.h"
#include "render/picture_ops.h"
#include "render/render_ops.h"
#include "render/upsample_ops.h"
#include "train/losses_ops.h"
#include "train/optimizer_ops.h"
#include "train/patches_ops.h"
#include "train/step_ops.h"

/* ---- timing in turns (bench_turns.c) ----------------------------------------------------------------------------- */

enum { ERN_BENCH_REPEATS = 64 /* most readings kept for one item */ };

/* Items to be timed against each other: `work` runs item `which` `times` times. */
struct ern_bench_turns {
  ern_status (*work)(void *user, size_t which, size_t times);
  void (*warm)(void *user, size_t which); /* called after the warm-up of `which`; may be NULL */
  void *user;
  size_t count;   /* at most ERN_BENCH_TURNS */
  size_t alone;   /* the first `alone` items have one thread; they are measured in CPU time */
  double seconds; /* for all of them together */
  double least;   /* least duration of a reading, seconds: calls are repeated to fill it */
  int most;       /* repeats, 1..ERN_BENCH_REPEATS */
};
enum { ERN_BENCH_TURNS = 2 * ERN_BENCH_BACKENDS };

/* Runs each item once to estimate its time, then all in turns until the time is used up. An item that takes longer than
 * its share of the time is run once more. An item that takes seconds is not: its first run is its reading. timing:
 * [count], seconds of one call. */
ERN_NODISCARD ern_status ern_bench_take_turns(const struct ern_bench_turns *turns, ern_bench_timing *timing);

/* ---- options ----------------------------------------------------------------------------------------------------- */

/* Copies the caller's options, or the defaults, to *chosen and validates them; validates the backends too. */
ERN_NODISCARD ern_status ern_bench_choose(ern_backend *const *backends, size_t count, const ern_bench_options *options,
                                          ern_bench_options *chosen);
/* Whether a backend is a device (not the CPU); compute units of a device; number of devices among the backends. */
bool ern_bench_is_device(const ern_backend *backend);
unsigned ern_bench_units(const ern_backend *device);
size_t ern_bench_devices(ern_backend *const *backends, size_t count);
/* Calls the caller's hook; ERN_E_CANCELLED if that returns non-zero. */
ERN_NODISCARD ern_status ern_bench_progress(ern_context *context, const ern_bench_options *options, size_t done,
                                            size_t all);

/* ---- the scene (bench_scene.c) ----------------------------------------------------------------------------------- */

struct ern_bench_scene {
  ern_context *context;
  const ern_model *model;
  ern_model *own; /* of a made-up scene: `model` */
  ern_frame_input frame;
  const uint8_t *truth; /* [height][width][3] */
  ern_box face;
  void *memory; /* of a made-up scene: windows, background, truth */
  bool made_up;
};

/* ern_bench_scene_describe on the CPU, for passes that do not count samples: all backends process the same points, and
 * a frame stops where `lit` does. */
ERN_NODISCARD ern_status ern_bench_scene_count(const struct ern_bench_scene *scene, ern_bench_scene_info *info);

static inline struct ern_view ern_bench_view(const struct ern_bench_scene *scene) {
  const ern_camera *camera = &scene->frame.camera;
  struct ern_view view = {
      .focal = camera->focal, .cx = camera->cx, .cy = camera->cy, .width = camera->width, .height = camera->height};
  const float *pose = scene->frame.head_pose != NULL ? scene->frame.head_pose : camera->pose;
  for (int i = 0; i < 16; i++) view.pose[i] = pose[i];
  return view;
}

/* ---- an instrumented backend (bench_shim.c) ---------------------------------------------------------------------- */

/* The pass that calls a slot. */
enum ern_bench_section {
  ERN_BENCH_OUTSIDE, /* none of the three below: speech, refresh, update */
  ERN_BENCH_HEAD,    /* render_rays, head_step, torso_step */
  ERN_BENCH_TORSO,   /* render_torso */
  ERN_BENCH_DENSITY, /* head_density */
  ERN_BENCH_SECTIONS
};
enum ern_bench_slot {
#define ERN_BENCH_SLOT(slot) ERN_BENCH_SLOT_##slot,
  ERN_SLOTS(ERN_BENCH_SLOT)
#undef ERN_BENCH_SLOT
      ERN_BENCH_SLOTS
};
union ern_bench_args {
#define ERN_BENCH_MEMBER(slot) struct ern_##slot##_args slot;
  ERN_SLOTS(ERN_BENCH_MEMBER)
#undef ERN_BENCH_MEMBER
};

/* A recorded call of a slot, for repetition; its arguments point to memory of the stream. */
struct ern_bench_call {
  enum ern_bench_slot slot;
  enum ern_bench_section section;
  union ern_bench_args args;
};

/* A backend that wraps another one and times its slots. Streams are created on the shim and passed to it; the first
 * stream, with its workers, is the one measured. `staged`: fused slots run stage by stage, so that their kernels are
 * called.
 *
 * A device's slots return before their kernels have run. Waiting for each slot slows all of them down, so the shim
 * waits, and the times of slots are valid, only in the mode of ern_bench_shim_apart. */
struct ern_bench_shim;
ERN_NODISCARD ern_status ern_bench_shim_make(struct ern_backend *backend, bool staged, struct ern_bench_shim **shim);
void ern_bench_shim_free(struct ern_bench_shim *shim);               /* accepts NULL */
struct ern_backend *ern_bench_shim_backend(struct ern_bench_shim *); /* lives as long as the shim */

/* For a device: switches waiting after each slot on or off. No effect on the CPU. */
void ern_bench_shim_apart(struct ern_bench_shim *shim, bool apart);
/* Ends a timed call: waits for all work on the measured stream and collects its figures. */
ERN_NODISCARD ern_status ern_bench_shim_finish(struct ern_bench_shim *shim);

struct ern_profile;
/* Sets all sums to 0. */
void ern_bench_shim_clear(struct ern_bench_shim *shim);
/* Seconds since ern_bench_shim_clear in calls of one slot in one section: sum over all threads / number of threads. */
double ern_bench_shim_seconds(const struct ern_bench_shim *shim, enum ern_bench_section section,
                              enum ern_bench_slot slot);
/* The profile that fused passes filled in. */
const struct ern_profile *ern_bench_shim_profile(const struct ern_bench_shim *shim);
/* Samples that stages marched since ern_bench_shim_clear, where no fused pass counted them. */
double ern_bench_shim_marched(const struct ern_bench_shim *shim);
int ern_bench_shim_threads(const struct ern_bench_shim *shim); /* for a device its compute units */

/* Reports each call from now on to on_call; NULL: stops. The arguments have their values after the call; their scratch
 * memory remains the stream's. */
void ern_bench_shim_listen(struct ern_bench_shim *shim,
                           ern_status (*on_call)(void *user, const struct ern_bench_call *), void *user);
/* Repeats a call on the stream that it was made on, untimed. */
ERN_NODISCARD ern_status ern_bench_shim_repeat(struct ern_bench_shim *shim, struct ern_bench_call *call);

/* ---- a trainer on the scene (bench_trainer.c) -------------------------------------------------------------------- */

struct ern_trainer;
/* The trainer's data, which callbacks return. */
struct ern_bench_data {
  const struct ern_bench_scene *scene;
  ern_features features;
  float matrix[16];
};
/* A trainer with learning rates of 0 that holds the scene's model. Each step repeats step 1 or, with refresh and
 * smoothness, a later one. */
ERN_NODISCARD ern_status ern_bench_trainer_make(struct ern_trainer **trainer, struct ern_bench_data *data,
                                                struct ern_backend *backend, const struct ern_bench_scene *scene,
                                                bool torso, int rays, int threads, uint64_t seed);
/* Restores the scene's occupancy after a refresh. */
ERN_NODISCARD ern_status ern_bench_trainer_restore(struct ern_trainer *trainer, const struct ern_bench_scene *scene);

/* ---- cost of a call (bench_calls.c) ------------------------------------------------------------------------------ */

struct ern_bench_call_cost {
  const char *name, *item; /* name NULL: too small to report */
  double items, flops_written, flops, bytes, reads;
};
struct ern_bench_call_cost ern_bench_call_cost(const struct ern_bench_call *call, const struct ern_field *field,
                                               size_t real_bytes);

/* ---- cost of the model (bench_cost.c) ---------------------------------------------------------------------------- */

/* Multiply-adds of one sample. */
double ern_bench_mlp_macs(const struct ern_mlp *mlp);
/* Multiply-adds of the backward pass: gradients of the weights, of the hidden values, and of `inputs` rows of the
 * input. `again`: also the recomputation of the hidden values by the kernels, without the last layer, whose output is
 * not needed. */
double ern_bench_mlp_bwd_macs(const struct ern_mlp *mlp, int inputs, bool again);
/* FLOP of interpolation, weights and position of one sample in all levels of a grid; reads of its table. */
double ern_bench_grid_flops(const struct ern_grid *grid);
double ern_bench_grid_reads(const struct ern_grid *grid);

/* FLOP of the head's model. */
struct ern_bench_cost {
  double density, colour; /* for each sample: from the encoder to the density; the additional cost of the colour */
  double ray;             /* for each ray */
};
struct ern_bench_cost ern_bench_cost_written(const struct ern_field *field);
struct ern_bench_cost ern_bench_cost_folded(const struct ern_field *field);
/* FLOP of a sample in a training step, forward and backward. */
double ern_bench_cost_head_step(const struct ern_field *field, bool again);
/* FLOP of a pixel of the torso: forward; forward and backward. */
double ern_bench_cost_torso(const struct ern_field *field);
double ern_bench_cost_torso_step(const struct ern_field *field, bool again);

#endif
