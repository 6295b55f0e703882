/* SPDX-License-Identifier: MIT
 * What the benchmarks share: taking turns with a clock, options, the scene. Internal. */
#ifndef ERN_LAB_BENCH_SHARED_H
#define ERN_LAB_BENCH_SHARED_H

#include "core/backend.h"
#include "ernerf-lab/bench.h"
#include "model/model.h"

/* ---- taking turns (bench_turns.c) -------------------------------------------------------------------------------- */

enum { ERN_BENCH_REPEATS = 64 /* most that are kept of one */ };

/* Things to be timed against each other: `work` does the one of number `which`, `times` times over. */
struct ern_bench_turns {
  ern_status (*work)(void *user, size_t which, size_t times);
  void (*warm)(void *user, size_t which); /* the next readings of `which` count, the ones before did not; may be NULL */
  void *user;
  size_t count;   /* at most ERN_BENCH_TURNS */
  size_t alone;   /* the first so many have one thread and are read by processor time: others' work is not in it */
  double seconds; /* for all of them together */
  double least;   /* seconds that a reading should last at least: calls are repeated to fill it */
  int most;       /* repeats, 1..ERN_BENCH_REPEATS */
};
enum { ERN_BENCH_TURNS = 2 * ERN_BENCH_BACKENDS };

/* Runs each once to see how long it takes, then in turns until the time is spent. What takes longer than its part of
 * the time is run once more, what takes seconds is not: the look is its reading. timing: [count], seconds of one call.
 */
ERN_NODISCARD ern_status ern_bench_take_turns(const struct ern_bench_turns *turns, ern_bench_timing *timing);

/* ---- options ----------------------------------------------------------------------------------------------------- */

/* The caller's or the defaults, checked, into *chosen; backends checked too. */
ERN_NODISCARD ern_status ern_bench_choose(ern_backend *const *backends, size_t count, const ern_bench_options *options,
                                          ern_bench_options *chosen);
/* Whether a backend is not the CPU; compute units of such a one; how many of them there are. */
bool ern_bench_is_device(const ern_backend *backend);
unsigned ern_bench_units(const ern_backend *device);
size_t ern_bench_devices(ern_backend *const *backends, size_t count);
/* Tells the caller's hook; its answer becomes ERN_E_CANCELLED. */
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

/* ern_bench_scene_describe on the CPU, for passes that do not count: all backends look at the same points, and a frame
 * stops where `lit` does. */
ERN_NODISCARD ern_status ern_bench_scene_count(const struct ern_bench_scene *scene, ern_bench_scene_info *info);

static inline struct ern_view ern_bench_view(const struct ern_bench_scene *scene) {
  const ern_camera *camera = &scene->frame.camera;
  struct ern_view view = {
      .focal = camera->focal, .cx = camera->cx, .cy = camera->cy, .width = camera->width, .height = camera->height};
  const float *pose = scene->frame.head_pose != NULL ? scene->frame.head_pose : camera->pose;
  for (int i = 0; i < 16; i++) view.pose[i] = pose[i];
  return view;
}

/* ---- a table that looks on (bench_shim.c) --------------------------------------------------------------------------
 */

/* What runs while a slot is called. */
enum ern_bench_section {
  ERN_BENCH_OUTSIDE, /* of the three below: speech, refresh, update */
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

/* One call of a slot, kept to be repeated; what its arguments point to is the stream's. */
struct ern_bench_call {
  enum ern_bench_slot slot;
  enum ern_bench_section section;
  union ern_bench_args args;
};

/* A backend whose slots are another's, timed. Its streams are made on it and given to it; the first is the one that
 * is looked at, with its workers. `staged`: fused slots go through the stages, so that their kernels are called.
 *
 * A device's slots return before their kernels have run, and waiting for each makes all of them slower: so they are
 * waited for, and their seconds are true, only while the shim holds them apart. */
struct ern_bench_shim;
ERN_NODISCARD ern_status ern_bench_shim_make(struct ern_backend *backend, bool staged, struct ern_bench_shim **shim);
void ern_bench_shim_free(struct ern_bench_shim *shim);               /* accepts NULL */
struct ern_backend *ern_bench_shim_backend(struct ern_bench_shim *); /* lives as long as the shim */

/* Of a device: from now on each slot is waited for, or no longer is. Nothing to the CPU. */
void ern_bench_shim_apart(struct ern_bench_shim *shim, bool apart);
/* All that was called on the stream that is looked at is done, and its figures are there: the end of a timed call. */
ERN_NODISCARD ern_status ern_bench_shim_finish(struct ern_bench_shim *shim);

struct ern_profile;
/* Sets all sums to 0. */
void ern_bench_shim_clear(struct ern_bench_shim *shim);
/* Seconds since then in calls of one slot in one section: of all threads together, over their number. */
double ern_bench_shim_seconds(const struct ern_bench_shim *shim, enum ern_bench_section section,
                              enum ern_bench_slot slot);
/* What fused passes filled in. */
const struct ern_profile *ern_bench_shim_profile(const struct ern_bench_shim *shim);
/* Samples that stages marched since then, where no fused pass counted them. */
double ern_bench_shim_marched(const struct ern_bench_shim *shim);
int ern_bench_shim_threads(const struct ern_bench_shim *shim); /* of a device its compute units */

/* Keeps the calls made from now on, inside the head's and the torso's sections or outside too; NULL: no more. The call
 * is told with its arguments as they were after it; their scratch stays theirs. */
void ern_bench_shim_listen(struct ern_bench_shim *shim,
                           ern_status (*on_call)(void *user, const struct ern_bench_call *), void *user);
/* Repeats a call on the stream that it was made on, untimed. */
ERN_NODISCARD ern_status ern_bench_shim_repeat(struct ern_bench_shim *shim, struct ern_bench_call *call);

/* ---- a trainer on the scene (bench_trainer.c) ----------------------------------------------------------------------
 */

struct ern_trainer;
/* Where the trainer's data lives: it is handed out by callbacks. */
struct ern_bench_data {
  const struct ern_bench_scene *scene;
  ern_features features;
  float matrix[16];
};
/* A trainer that learns nothing (rates of 0) and holds the scene's model. Each step is the one of number 1, or with
 * refresh and smoothness a later one. */
ERN_NODISCARD ern_status ern_bench_trainer_make(struct ern_trainer **trainer, struct ern_bench_data *data,
                                                struct ern_backend *backend, const struct ern_bench_scene *scene,
                                                bool torso, int rays, int threads, uint64_t seed);
/* The scene's occupancy again, after a refresh. */
ERN_NODISCARD ern_status ern_bench_trainer_restore(struct ern_trainer *trainer, const struct ern_bench_scene *scene);

/* ---- what a call costs (bench_calls.c) -----------------------------------------------------------------------------
 */

struct ern_bench_call_cost {
  const char *name, *item; /* name NULL: too small to be worth a line */
  double items, flops_written, flops, bytes, reads;
};
struct ern_bench_call_cost ern_bench_call_cost(const struct ern_bench_call *call, const struct ern_field *field,
                                               size_t real_bytes);

/* ---- what the model costs (bench_cost.c) ------------------------------------------------------------------------- */

/* Multiply-adds of one sample. */
double ern_bench_mlp_macs(const struct ern_mlp *mlp);
/* Of the backward pass: gradients of the weights and of the hidden values, and of `inputs` rows of the input. The
 * kernels compute the hidden values again on top (`again`: without the last layer, whose output is not needed). */
double ern_bench_mlp_bwd_macs(const struct ern_mlp *mlp, int inputs, bool again);
/* FLOP of interpolation, weights and position of one sample in all levels of a grid; reads of its table. */
double ern_bench_grid_flops(const struct ern_grid *grid);
double ern_bench_grid_reads(const struct ern_grid *grid);

/* FLOP of the head's model. */
struct ern_bench_cost {
  double density, colour; /* of a sample: encoder to density; colour on top */
  double ray;             /* of a ray */
};
struct ern_bench_cost ern_bench_cost_written(const struct ern_field *field);
struct ern_bench_cost ern_bench_cost_folded(const struct ern_field *field);
/* Of a sample of a training step, forward and backward. */
double ern_bench_cost_head_step(const struct ern_field *field, bool again);
/* Of a pixel of the torso: forward; and backward too. */
double ern_bench_cost_torso(const struct ern_field *field);
double ern_bench_cost_torso_step(const struct ern_field *field, bool again);

#endif
