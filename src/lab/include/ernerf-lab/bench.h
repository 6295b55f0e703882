/* SPDX-License-Identifier: MIT
 * How fast this machine is, and how much of it the library uses: the machine's peaks, each kernel, a frame and a
 * training step, on instruction sets of the CPU, on OpenCL devices, or on both. All figures of a call come from one
 * run: what is compared is measured in turns.
 *
 * What is counted. FLOP: one addition or multiplication of the arithmetic of the model, two a multiply-add; a division,
 * a root, an exponential or a sine counts one; comparisons and index arithmetic none. `flops_written` is the model as
 * its equations stand, `flops` what is computed: the first is larger where a fused pass folds layers, the second where
 * hidden values are computed again in the backward pass. Bytes: every array that goes in or out, once; tables that are
 * read at random places are counted by reads instead (32 bits each, in the double build 64). */
#ifndef ERNERF_LAB_BENCH_H
#define ERNERF_LAB_BENCH_H

#include <stdbool.h>

#include "ernerf/backend.h"
#include "ernerf/model.h"
#include "ernerf/render.h"

enum { ERN_BENCH_BACKENDS = 8, ERN_BENCH_STAGES = 16 };

typedef struct ern_bench_options {
  uint32_t cookie;
  int threads;    /* of a frame and a step, and of the peaks of all threads, 0..ERN_THREADS_MOST; 0: one a core. Kernels
                     have one, or beside a device as many */
  double seconds; /* what a call may take, about; what takes longer is measured once all the same. 0..86400; 5 */
  int frames;     /* most repeats of a frame, 1..1000; 16 */
  int rays;       /* of a training step, 1..1048576; 65536 */
  uint64_t seed;  /* of random rays and values */
  /* Called with the number of parts done; a non-zero answer stops with ERN_E_CANCELLED. NULL: none. */
  int (*progress)(void *user, size_t done, size_t all);
  void *user;
} ern_bench_options;
ern_bench_options ern_bench_options_default(void);

/* Seconds of one call, on a device until it is done. What has one thread by itself (peaks of one, kernels) is read by
 * its processor time, which is the time that passes where nobody else runs; all else by the time that passes. */
typedef struct ern_bench_timing {
  double least, median;
  double cpu; /* the least processor time, of all threads together: tells on a machine that is shared with others */
  int repeats;
} ern_bench_timing;

/* ---- peaks ------------------------------------------------------------------------------------------------------- */

/* The best of several repeats, a second: of one thread, and of all threads at once. Of a device both are all of it. */
typedef struct ern_bench_rate {
  double one, all;
} ern_bench_rate;

typedef struct ern_bench_peak {
  const char *backend;  /* "cpu" or "opencl"; lives as long as its backend, as `isa` does */
  const char *isa;      /* of a device its name */
  ern_bench_rate flops; /* multiply-adds in registers, FLOP. Of ref and ref64: products and sums apart, without an
                           instruction set, as the reference is built */
  ern_bench_rate reads; /* of 32 bits at random places of a table of 64 KiB, the size of a level of the hash grid */
  /* Of a device; 0 of the CPU, whose streams are the machine's. */
  unsigned units;     /* compute units */
  size_t cache_bytes; /* of its memory; 0: not known */
  /* Bytes, read and written, by the best of a copy, an update in place and the driver's own copy: over half of the
   * cache (not known: the same as the next), and over four times as much (64 to 512 MiB). */
  ern_bench_rate stream_cache, stream_memory;
} ern_bench_peak;

typedef struct ern_bench_machine {
  int threads;               /* of the `all` figures */
  size_t l2_bytes, l3_bytes; /* what the system says; guesses (1 MiB, 32 MiB) where it does not */
  /* Bytes, read and written, by the best of memcpy, a copy and an update in place, of the last instruction set: over
   * half of L2, half of L3, and four times L3 (64 to 512 MiB), threads sharing the last two. 0 where no backend is the
   * CPU. */
  ern_bench_rate stream_l2, stream_l3, stream_memory;
  ern_bench_peak peak[ERN_BENCH_BACKENDS]; /* one a backend, in the order of the call */
  size_t peaks;
  double unrest; /* largest median over least of the multiply-adds on all threads: well above 1 where other programs
                    take the processor's time, and all figures are then too low */
} ern_bench_machine;

/* `backends`: 1..ERN_BENCH_BACKENDS, all of one context. options NULL: the defaults. */
ERN_NODISCARD ern_status ern_bench_peaks(ern_backend *const *backends, size_t count, const ern_bench_options *options,
                                         ern_bench_machine *machine);

/* ---- what is measured on ----------------------------------------------------------------------------------------- */

/* A model, a frame to draw and pixels to learn from. Read-only once made. */
typedef struct ern_bench_scene ern_bench_scene;

/* Made up, from nothing: a model with eye, codes and torso, 14 levels, whose density is a shell the size of a head and
 * otherwise random, seen from the front. width, height: 1..8192; a portrait has 450 x 450. On success the caller owns
 * *scene. */
ERN_NODISCARD ern_status ern_bench_scene_make(ern_bench_scene **scene, ern_context *context, int width, int height,
                                              uint64_t seed);

/* A model's own. The frame is what ern_renderer_frame takes, with a background. truth: [height][width][3] of the
 * picture to learn; face: the box of the landmarks, NULL: the whole picture. `model` and what the frame points to must
 * outlive the scene. */
ERN_NODISCARD ern_status ern_bench_scene_of(ern_bench_scene **scene, ern_context *context, const ern_model *model,
                                            const ern_frame_input *frame, const uint8_t *truth, const ern_box *face);
void ern_bench_scene_free(ern_bench_scene **scene); /* accepts NULL and a pointer to NULL */

typedef struct ern_bench_scene_info {
  bool made_up, has_torso;
  int width, height, levels;
  double occupied;     /* share of the cells of the scene */
  size_t parameters;   /* numbers of the model */
  size_t pixels;       /* of the frame */
  size_t hits;         /* rays with a sample */
  size_t marched;      /* samples in occupied cells */
  size_t lit;          /* of these, samples before the light is spent */
  double sample_flops; /* FLOP of one sample, encoder, attention, density and colour, as written */
  double folded_flops; /* the same as a fused pass computes them: what is one per ray or frame is left out, the last
                          layer of the density and the first of the colour are one */
} ern_bench_scene_info;
/* sample_flops for any head, the rows of the paper's ablation included, whose scenes are not benched. */
double ern_bench_sample_flops(const ern_model *model);

/* Counts by marching and shading the frame once, on `backend`. threads as in ern_bench_options. */
ERN_NODISCARD ern_status ern_bench_scene_describe(const ern_bench_scene *scene, ern_backend *backend, int threads,
                                                  ern_bench_scene_info *info);

/* ---- kernels ----------------------------------------------------------------------------------------------------- */

typedef struct ern_bench_kernel {
  const char *name;          /* "density_fwd"; lives for ever, as `item` */
  const char *item;          /* what it works on: "sample", "ray", "pixel", "cell", "value", "frame" */
  const char *backend, *isa; /* of its backend */
  int threads;               /* 1, or beside a device those of the options; of a device its compute units */
  double items;              /* of one call; so are the next four */
  double flops_written, flops;
  double bytes, reads;      /* 0: none are counted */
  ern_bench_timing seconds; /* of one call */
  double share;      /* of the peak that binds it: the largest of FLOP, bytes and reads over what as many threads,
                        or the device, reach of each, over the least time. NaN where nothing can be counted
                        before it ran */
  const char *bound; /* "flops", "l2", "l3", "cache" (of a device), "memory", "reads" or "": which that is. Bytes
                        are held against the stream of the smallest memory that has room for all arrays of the
                        kernel */
} ern_bench_kernel;

/* Each kernel on each backend, with the sizes and the samples of the scene; calls `say` for each. A non-zero answer of
 * `say` stops with ERN_E_CANCELLED. `machine`: peaks of the same backends; NULL: every share is NaN. Instruction sets
 * alone run on one thread and on as much as its L2 holds; where one of the backends is a device, all run on all of
 * their threads and on the samples of options.rays rays. */
ERN_NODISCARD ern_status ern_bench_kernels(ern_backend *const *backends, size_t count, const ern_bench_scene *scene,
                                           const ern_bench_machine *machine, const ern_bench_options *options,
                                           int (*say)(void *user, const ern_bench_kernel *kernel), void *user);

/* ---- a frame, a step --------------------------------------------------------------------------------------------- */

typedef struct ern_bench_stage {
  const char *name; /* lives for ever */
  double seconds;   /* of a call, in the mean; of all threads together, over their number */
} ern_bench_stage;

/* A device's stages are calls after those that are timed: each slot is waited for, so their sum may be more than the
 * whole, which is not. */
typedef struct ern_bench_pass {
  const char *backend, *isa; /* of its backend */
  int threads;               /* of a device its compute units */
  bool fused;                /* one pass of its own, not stage by stage */
  ern_bench_timing seconds;  /* of a call */
  double rays;               /* of a call: pixels of a frame, rays of a step; so are the next ones, 0: not counted */
  double marched, evaluated, colours; /* samples in occupied cells, whose density was computed, whose colour was */
  double flops_written, flops;
  double share;                            /* of the peak of all threads or of the device; NaN without peaks */
  ern_bench_stage stage[ERN_BENCH_STAGES]; /* of the whole; what is left over is in none of them */
  int stages;
} ern_bench_pass;

/* results: [count]. A frame from speech and pose to 8-bit pixels, options.frames times at most. */
ERN_NODISCARD ern_status ern_bench_frame(ern_backend *const *backends, size_t count, const ern_bench_scene *scene,
                                         const ern_bench_machine *machine, const ern_bench_options *options,
                                         ern_bench_pass *results);

/* A training step of the head, or of the torso (ERN_E_ARGUMENT where the scene has none): rays, forward, backward,
 * update, and its share of an occupancy refresh and of the smoothness term, both in stages of their own.
 * The model stays as it is: the rates of the update are 0. Processor time is that of a plain step. */
ERN_NODISCARD ern_status ern_bench_step(ern_backend *const *backends, size_t count, const ern_bench_scene *scene,
                                        const ern_bench_machine *machine, const ern_bench_options *options, bool torso,
                                        ern_bench_pass *results);

/* ---- hash collisions --------------------------------------------------------------------------------------------- */

typedef struct ern_bench_collision_count {
  size_t cells;      /* distinct cells that the points lie in */
  double collisions; /* look-ups of their corners whose entry another vertex took before, times 1/8 or 1/4 */
} ern_bench_collision_count;

typedef struct ern_bench_collision_table {
  size_t points; /* samples of the frame in occupied cells, 16 a ray at most */
  double scale;  /* by which their coordinates are scaled up, about their middle, so that the longest side of their box
                    is that of the scene: the supplement scales too and does not say by how much */
  ern_bench_collision_count volume;   /* one 3D grid of 2^14 entries */
  ern_bench_collision_count plane[3]; /* of 2^14/3 entries each: frontal (xz), and the sides xy and yz */
} ern_bench_collision_table;

/* Hash collisions of one look-up step of the scene's frame at resolution 512, everything hashed: the table of the
 * paper's supplement ("The Number of Hash Collisions"; there 835186 against 138345 + 31041 + 26048). Points in one cell
 * look up the same and count once. */
ERN_NODISCARD ern_status ern_bench_collisions(ern_backend *backend, const ern_bench_scene *scene,
                                              ern_bench_collision_table *table);

#endif
