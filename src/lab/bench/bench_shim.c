/* SPDX-License-Identifier: MIT
 * A dispatch table that wraps another one and times each slot. Rendering and training run on it unchanged, so the
 * public functions themselves are measured. */
#include "lab/bench/bench_shared.h"

#include <string.h>

#include "backend_cpu/cpu_state.h"
#include "backend_opencl/device/peak.h"
#include "core/memory.h"
#include "core/profile.h"
#include "core/status.h"
#include "render/stages.h"
#include "train/step.h"

enum { MOST_LANES = 256 };

/* Sums of one thread; padded so that no two share a cache line. */
struct sums {
  double seconds[ERN_BENCH_SECTIONS][ERN_BENCH_SLOTS];
  double marched;
  double apart[8];
};

struct ern_bench_shim {
  struct ern_cpu_backend cpu; /* first: the shim is a backend with the real one's kernels; device: only a table */
  struct ern_backend *real;
  struct ern_stream *main;
  enum ern_bench_section section;
  bool staged, device;
  bool apart;  /* waits for each slot of a device */
  bool within; /* inside a device's slot that calls other slots: those count as part of it */
  struct ern_profile profile;
  ern_status (*on_call)(void *user, const struct ern_bench_call *call);
  void *user;
  struct ern_arena_mark furthest; /* largest use of the stream's scratch while calls were reported */
  struct sums *sums; /* [1 + MOST_LANES]: [0]: the stream, in wall-clock time with all its threads; its workers */
};

static const struct ern_cpu_stream *cpu_stream(const struct ern_bench_shim *shim) {
  return (const struct ern_cpu_stream *)shim->main;
}

/* The sums for calls on `stream`; NULL: not measured. */
static struct sums *sums_of(struct ern_bench_shim *shim, const struct ern_stream *stream) {
  if (shim->main == NULL) return NULL;
  if (stream == shim->main) return &shim->sums[0];
  for (int l = 0; !shim->device && l < cpu_stream(shim)->workers && l < MOST_LANES; l++)
    if (stream == &cpu_stream(shim)->worker[l]->base) return &shim->sums[1 + l];
  return NULL;
}

static struct ern_bench_shim *shim_of(struct ern_stream *stream) { return (struct ern_bench_shim *)stream->backend; }

static ern_status notify(struct ern_bench_shim *shim, const struct ern_stream *stream, enum ern_bench_slot slot,
                         const void *args, size_t bytes) {
  if (shim->on_call == NULL || stream != shim->main) return ERN_OK;
  const struct ern_arena_mark now = ern_arena_mark(stream);
  for (int e = 0; e < 3; e++) {
    const bool same = now.block[e] == shim->furthest.block[e];
    if (now.block[e] > shim->furthest.block[e] || (same && now.used[e] > shim->furthest.used[e])) {
      shim->furthest.block[e] = now.block[e];
      shim->furthest.used[e] = now.used[e];
    }
  }
  struct ern_bench_call call = {.slot = slot, .section = shim->section};
  memcpy(&call.args, args, bytes);
  return shim->on_call(shim->user, &call);
}

/* ---- slots ------------------------------------------------------------------------------------------------------- */

static bool is_fused(enum ern_bench_slot slot) {
  return slot == ERN_BENCH_SLOT_render_rays || slot == ERN_BENCH_SLOT_render_torso ||
         slot == ERN_BENCH_SLOT_head_density || slot == ERN_BENCH_SLOT_head_step || slot == ERN_BENCH_SLOT_torso_step;
}

#define SHIM_SLOT(slot)                                                                                 \
  static ern_status timed_##slot(struct ern_stream *stream, struct ern_##slot##_args *args) {           \
    struct ern_bench_shim *shim = shim_of(stream);                                                      \
    if (shim->within) return shim->real->slot(stream, args);                                            \
    struct sums *sums = sums_of(shim, stream);                                                          \
    const bool whole = shim->device && !is_fused(ERN_BENCH_SLOT_##slot);                                \
    if (whole) shim->within = true;                                                                     \
    const double began = ern_profile_now();                                                             \
    ern_status status = shim->real->slot(stream, args);                                                 \
    if (status == ERN_OK && shim->apart) status = ern_opencl_finish(stream);                            \
    if (sums != NULL) sums->seconds[shim->section][ERN_BENCH_SLOT_##slot] += ern_profile_now() - began; \
    if (whole) shim->within = false;                                                                    \
    if (status == ERN_OK) status = notify(shim, stream, ERN_BENCH_SLOT_##slot, args, sizeof *args);     \
    return status;                                                                                      \
  }
ERN_SLOTS(SHIM_SLOT)
#undef SHIM_SLOT

static ern_status counted_scan(struct ern_stream *stream, struct ern_scan_args *args) {
  struct ern_bench_shim *shim = shim_of(stream);
  if (shim->within) return shim->real->scan(stream, args); /* not a scan over samples */
  const ern_status status = timed_scan(stream, args);
  struct sums *sums = sums_of(shim, stream);
  if (sums != NULL && status == ERN_OK) sums->marched += (double)args->total;
  return status;
}

/* Fused slots open a section; if they take a profile, it is the shim's. */
#define SHIM_SECTION(slot, opened, prepare)                                                                  \
  static ern_status section_##slot(struct ern_stream *stream, struct ern_##slot##_args *args) {              \
    struct ern_bench_shim *shim = shim_of(stream);                                                           \
    if (stream != shim->main) return shim->real->slot(stream, args);                                         \
    const enum ern_bench_section before = shim->section;                                                     \
    prepare;                                                                                                 \
    shim->section = opened;                                                                                  \
    const ern_status status = shim->staged ? ern_##slot##_stages(stream, args) : timed_##slot(stream, args); \
    shim->section = before;                                                                                  \
    return status;                                                                                           \
  }
SHIM_SECTION(render_rays, ERN_BENCH_HEAD, args->profile = &shim->profile)
SHIM_SECTION(head_step, ERN_BENCH_HEAD, args->profile = &shim->profile)
SHIM_SECTION(torso_step, ERN_BENCH_HEAD, (void)0)
SHIM_SECTION(render_torso, ERN_BENCH_TORSO, (void)0)
SHIM_SECTION(head_density, ERN_BENCH_DENSITY, (void)0)
#undef SHIM_SECTION

/* The CPU's slots find their kernels through the stream's table, so the stream is created on the shim. A device's
 * stream stores its backend, so it is created on that and then gets the shim's table. */
static ern_status stream_make(struct ern_backend *backend, int threads, struct ern_stream **stream) {
  struct ern_bench_shim *shim = (struct ern_bench_shim *)backend;
  const ern_status status = shim->real->stream_make(shim->device ? shim->real : backend, threads, stream);
  if (status != ERN_OK) return status;
  (*stream)->backend = backend;
  if (shim->main == NULL) shim->main = *stream;
  return ERN_OK;
}
static void stream_free(struct ern_stream *stream) {
  if (stream == NULL) return;
  struct ern_bench_shim *shim = shim_of(stream);
  if (stream == shim->main) shim->main = NULL;
  shim->real->stream_free(stream);
}

static ern_status buffer_make(struct ern_backend *backend, ern_element element, size_t count,
                              struct ern_buffer **buffer) {
  struct ern_backend *real = ((struct ern_bench_shim *)backend)->real;
  return real->buffer_make(real, element, count, buffer);
}
static void buffer_free(struct ern_backend *backend, struct ern_buffer *buffer) {
  struct ern_backend *real = ((struct ern_bench_shim *)backend)->real;
  real->buffer_free(real, buffer);
}

/* ---- the shim ---------------------------------------------------------------------------------------------------- */

ern_status ern_bench_shim_make(struct ern_backend *backend, bool staged, struct ern_bench_shim **shim) {
  struct ern_bench_shim *made = NULL;
  ern_status status = ERN_OK;
  *shim = NULL;
  ERN_TRY(ERN_NEW(backend->context, 1, &made));
  made->real = backend;
  made->staged = staged;
  made->device = ern_bench_is_device(backend);
  struct ern_backend *table = &made->cpu.table;
  if (made->device)
    *table = *backend;
  else
    made->cpu = *(struct ern_cpu_backend *)backend;
#define SHIM_FILL(slot) table->slot = timed_##slot;
  ERN_SLOTS(SHIM_FILL)
#undef SHIM_FILL
  table->scan = counted_scan;
  table->render_rays = section_render_rays;
  table->render_torso = section_render_torso;
  table->head_step = section_head_step;
  table->torso_step = section_torso_step;
  table->head_density = section_head_density;
  table->stream_make = stream_make;
  table->stream_free = stream_free;
  table->buffer_make = buffer_make;
  table->buffer_free = buffer_free;
  status = ERN_NEW(backend->context, 1 + MOST_LANES, &made->sums);
  if (status != ERN_OK) {
    ern_release(backend->context, made);
    return status;
  }
  *shim = made;
fail:
  return status;
}

void ern_bench_shim_free(struct ern_bench_shim *shim) {
  if (shim == NULL) return;
  ern_context *context = shim->real->context;
  ern_release(context, shim->sums);
  ern_release(context, shim);
}

struct ern_backend *ern_bench_shim_backend(struct ern_bench_shim *shim) {
  return &shim->cpu.table;
}
const struct ern_profile *ern_bench_shim_profile(const struct ern_bench_shim *shim) { return &shim->profile; }

int ern_bench_shim_threads(const struct ern_bench_shim *shim) {
  if (shim->device) return (int)ern_bench_units(shim->real);
  return shim->main != NULL ? cpu_stream(shim)->workers : 1;
}

void ern_bench_shim_apart(struct ern_bench_shim *shim, bool apart) { shim->apart = apart && shim->device; }

ern_status ern_bench_shim_finish(struct ern_bench_shim *shim) {
  if (shim->main == NULL) return ERN_OK;
  const ern_status status = shim->real->synchronize(shim->main);
  return status == ERN_OK && shim->device ? ern_opencl_finish(shim->main) : status;
}

void ern_bench_shim_clear(struct ern_bench_shim *shim) {
  memset(shim->sums, 0, (1 + MOST_LANES) * sizeof *shim->sums);
  shim->profile = (struct ern_profile){.timed = true};
}

double ern_bench_shim_seconds(const struct ern_bench_shim *shim, enum ern_bench_section section,
                              enum ern_bench_slot slot) {
  double workers = 0;
  for (int l = 1; l <= MOST_LANES; l++) workers += shim->sums[l].seconds[section][slot];
  return shim->sums[0].seconds[section][slot] + workers / ern_bench_shim_threads(shim);
}

double ern_bench_shim_marched(const struct ern_bench_shim *shim) {
  double samples = 0;
  for (int l = 0; l <= MOST_LANES; l++) samples += shim->sums[l].marched;
  return samples;
}

void ern_bench_shim_listen(struct ern_bench_shim *shim,
                           ern_status (*on_call)(void *user, const struct ern_bench_call *), void *user) {
  if (on_call != NULL && shim->main != NULL) shim->furthest = ern_arena_mark(shim->main);
  shim->on_call = on_call;
  shim->user = user;
  /* reported arguments point to scratch memory that was released since: keeps it from being allocated again */
  if (on_call == NULL && shim->main != NULL) ern_arena_release(shim->main, shim->furthest);
}

ern_status ern_bench_shim_repeat(struct ern_bench_shim *shim, struct ern_bench_call *call) {
  struct ern_stream *stream = shim->main;
  switch (call->slot) {
#define SHIM_REPEAT(slot) \
  case ERN_BENCH_SLOT_##slot: return shim->real->slot(stream, &call->args.slot);
    ERN_SLOTS(SHIM_REPEAT)
#undef SHIM_REPEAT
    case ERN_BENCH_SLOTS: break;
  }
  return ERN_E_ARGUMENT;
}
