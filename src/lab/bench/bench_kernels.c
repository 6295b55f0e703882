/* SPDX-License-Identifier: MIT
 * Benchmarks single kernels: runs a training step of the head and one of the torso, records the calls of their slots,
 * and repeats each call with its arguments. */
#include <math.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "core/status.h"
#include "lab/bench/bench_shared.h"
#include "train/optimizer_ops.h"
#include "train/trainer.h"

enum {
  HEAD_RAYS = 3072,   /* about 8000 samples: the batch of one thread, which fits its L2 */
  TORSO_RAYS = 16384, /* a third of them on the torso */
  SOME_CELLS = 8192,  /* cells of an occupancy refresh */
  CELLS_A_RAY = 2,    /* with several threads: a sixteenth of all cells in a step of 65,536 rays */
  MOST_KERNELS = 96
};

/* Problem sizes: small for one thread; for a device, and CPU backends compared with it, those of a whole step. */
struct sizes {
  int threads, head_rays, torso_rays;
  size_t cells;
  uint64_t seed;
};

/* Several sources for each backend, each with its own scratch memory, to which the arguments of recorded calls point.
 */
enum source_kind { HEAD_STEP, HEAD_REFRESH, FRAME, TORSO_STEP, TORSO_REFRESH, SOURCES };

struct source {
  enum source_kind kind;
  struct ern_bench_shim *shim;
  struct ern_trainer *trainer;   /* NULL: source of a frame */
  struct ern_renderer *renderer; /* source of a frame */
  struct ern_bench_data data;
  struct subject *subject;
};

struct kept {
  struct ern_bench_call call;
  struct ern_bench_call_cost cost;
  struct source *source;
};

/* A backend and its recorded calls. */
struct subject {
  struct ern_backend *backend;
  struct source source[SOURCES];
  struct kept kept[MOST_KERNELS];
  size_t count;
};

struct kernels {
  struct subject *subject; /* [count] */
  size_t count;
  bool alone;                    /* each on one thread */
  size_t at[ERN_BENCH_BACKENDS]; /* index of the current kernel in each subject's list */
};

/* ---- keeping calls ----------------------------------------------------------------------------------------------- */

/* Whether the source records the call: another source records a step's refresh; calls after the step are its update. */
static bool wanted(const struct source *source, const struct ern_bench_call *call) {
  const bool update =
      call->slot == ERN_BENCH_SLOT_adamw || call->slot == ERN_BENCH_SLOT_finite || call->slot == ERN_BENCH_SLOT_ema;
  const bool step = source->kind == HEAD_STEP || source->kind == TORSO_STEP;
  if (source->kind == FRAME) return call->slot == ERN_BENCH_SLOT_background || call->slot == ERN_BENCH_SLOT_picture;
  return step ? call->section == ERN_BENCH_HEAD || update : true;
}

/* Keeps, of several calls of one kernel in one source, the one with the most work. */
static ern_status keep(void *user, const struct ern_bench_call *call) {
  struct source *source = user;
  struct subject *subject = source->subject;
  if (!wanted(source, call)) return ERN_OK;
  const struct ern_bench_call_cost cost = ern_bench_call_cost(
      call, source->trainer != NULL ? &source->trainer->shared.model->field : &source->data.scene->model->field,
      subject->backend->real_bytes);
  if (cost.name == NULL) return ERN_OK;
  size_t at = 0;
  while (at < subject->count && strcmp(subject->kept[at].cost.name, cost.name) != 0) at++;
  if (at == MOST_KERNELS) return ERN_OK;
  if (at < subject->count && (subject->kept[at].source != source || subject->kept[at].cost.items >= cost.items))
    return ERN_OK;
  subject->kept[at] = (struct kept){.call = *call, .cost = cost, .source = source};
  if (at == subject->count) subject->count++;
  return ERN_OK;
}

static ern_status make_calls(struct source *source, size_t cells) {
  struct ern_trainer *t = source->trainer;
  ern_train_report report;
  ern_status status = ERN_OK;
  ern_bench_shim_listen(source->shim, keep, source);
  if (source->kind == HEAD_REFRESH) {
    ERN_TRY(ern_trainer_mark(&t->occupancy));
    ERN_TRY(ern_trainer_list(&t->occupancy));
  }
  if (t->occupancy.cell_count > cells) t->occupancy.cell_count = cells;
  t->shared.step = ERN_REFRESH_EVERY;
  if (source->kind == HEAD_REFRESH || source->kind == TORSO_REFRESH) {
    ERN_TRY(ern_trainer_refresh(&t->occupancy));
  } else {
    ERN_TRY(ern_trainer_step(t, &report));
    struct ern_ema_args ema = {.average = t->values.average,
                               .parameters = t->shared.parameters,
                               .decay = 0.95f,
                               .n = t->shared.model->field.parameters};
    ERN_TRY(t->shared.backend->ema(t->shared.stream, &ema));
  }
fail:
  ern_bench_shim_listen(source->shim, NULL, NULL);
  return status;
}

/* Draws a frame of the scene's size, for kernels over all pixels. */
static ern_status draw_frame(struct source *source, const struct ern_bench_scene *scene, int threads) {
  const ern_camera *camera = &scene->frame.camera;
  ern_context *context = source->subject->backend->context;
  ern_render_options options = ern_render_options_default();
  uint8_t *rgba = NULL;
  ern_status status = ERN_OK;
  if (!ern_bench_is_device(source->subject->backend)) options.threads = threads;
  source->data.scene = scene;
  ERN_TRY(ern_renderer_create(&source->renderer, ern_bench_shim_backend(source->shim), scene->model, &options));
  ERN_TRY(ERN_NEW(context, 4 * (size_t)camera->width * (size_t)camera->height, &rgba));
  const ern_frame_output output = {.rgba = rgba};
  ern_bench_shim_listen(source->shim, keep, source);
  status = ern_renderer_frame(source->renderer, &scene->frame, &output, NULL);
fail:
  ern_bench_shim_listen(source->shim, NULL, NULL);
  ern_release(context, rgba);
  return status;
}

static ern_status make_source(struct source *source, enum source_kind kind, struct subject *subject,
                              const struct ern_bench_scene *scene, const struct sizes *sizes) {
  const bool torso = kind == TORSO_STEP || kind == TORSO_REFRESH;
  ern_status status = ERN_OK;
  source->kind = kind;
  source->subject = subject;
  ERN_TRY(ern_bench_shim_make(subject->backend, kind != FRAME, &source->shim));
  if (kind == FRAME) return draw_frame(source, scene, sizes->threads);
  ERN_TRY(ern_bench_trainer_make(&source->trainer, &source->data, ern_bench_shim_backend(source->shim), scene, torso,
                                 torso ? sizes->torso_rays : sizes->head_rays, sizes->threads, sizes->seed));
  ERN_TRY(make_calls(source, sizes->cells));
fail:
  return status;
}

static void free_subject(struct subject *subject) {
  for (int s = 0; s < SOURCES; s++) {
    ern_trainer_free(&subject->source[s].trainer);
    ern_renderer_free(&subject->source[s].renderer);
    ern_bench_shim_free(subject->source[s].shim);
  }
}

/* ---- figures ----------------------------------------------------------------------------------------------------- */

/* Stream rate in bytes a second of the smallest memory level that holds `bytes`; *name: of the level. */
static double stream_of(double bytes, const ern_bench_machine *machine, const ern_bench_peak *peak, bool alone,
                        const char **name) {
  const bool device = peak->units > 0;
  const double near =
      device ? (double)peak->cache_bytes / 2 : (double)machine->l2_bytes * (alone ? 1 : machine->threads);
  const double far = device ? near : (double)machine->l3_bytes / 2;
  const ern_bench_rate *rate = device ? &peak->stream_memory : &machine->stream_memory;
  *name = "memory";
  if (bytes <= near) {
    *name = device ? "cache" : "l2";
    rate = device ? &peak->stream_cache : &machine->stream_l2;
  } else if (bytes <= far) {
    *name = "l3";
    rate = &machine->stream_l3;
  }
  return alone ? rate->one : rate->all;
}

/* Compares the time with the least times at the machine's peaks: for arithmetic, arrays and random reads. */
static void compute_share(ern_bench_kernel *kernel, const ern_bench_machine *machine, size_t index, bool alone,
                          size_t real) {
  kernel->share = (double)NAN;
  kernel->bound = "";
  if (machine == NULL || index >= machine->peaks) return;
  const ern_bench_peak *peak = &machine->peak[index];
  const char *memory = "";
  const double stream = stream_of(kernel->bytes, machine, peak, alone, &memory);
  const double words = (double)real / sizeof(float); /* a double is two reads of 32 bits */
  const struct {
    const char *name;
    double seconds;
  } needs[] = {{"flops", kernel->flops / (alone ? peak->flops.one : peak->flops.all)},
               {memory, kernel->bytes / stream},
               {"reads", kernel->reads * words / (alone ? peak->reads.one : peak->reads.all)}};
  double most = 0;
  for (size_t i = 0; i < sizeof needs / sizeof *needs; i++)
    if (needs[i].seconds > most) {
      most = needs[i].seconds;
      kernel->bound = needs[i].name;
    }
  if (most > 0) kernel->share = most / kernel->seconds.least;
}

static ern_status repeat(void *user, size_t which, size_t times) {
  struct kernels *kernels = user;
  struct kept *kept = &kernels->subject[which].kept[kernels->at[which]];
  ern_status status = ERN_OK;
  for (size_t k = 0; k < times && status == ERN_OK; k++)
    status = ern_bench_shim_repeat(kept->source->shim, &kept->call);
  return status == ERN_OK ? ern_bench_shim_finish(kept->source->shim) : status;
}

/* Measures kernel `number` of the first subject on all subjects. */
static ern_status measure(struct kernels *kernels, size_t number, double seconds, const ern_bench_machine *machine,
                          int (*say)(void *user, const ern_bench_kernel *kernel), void *user) {
  const struct kept *first = &kernels->subject[0].kept[number];
  ern_bench_timing timing[ERN_BENCH_TURNS];
  const struct ern_bench_turns turns = {.work = repeat,
                                        .user = kernels,
                                        .count = kernels->count,
                                        .alone = kernels->alone ? kernels->count : 0,
                                        .seconds = seconds,
                                        .least = 1e-3,
                                        .most = ERN_BENCH_REPEATS};
  for (size_t k = 0; k < kernels->count; k++) {
    const struct subject *subject = &kernels->subject[k];
    size_t at = 0;
    while (at < subject->count && strcmp(subject->kept[at].cost.name, first->cost.name) != 0) at++;
    if (at == subject->count) return ERN_OK; /* not called by all */
    kernels->at[k] = at;
    /* gradients accumulate: they are cleared before they overflow */
    const struct ern_trainer *t = subject->kept[at].source->trainer;
    const ern_status zeroed = t != NULL ? t->shared.backend->zero(t->shared.stream, t->values.gradient) : ERN_OK;
    if (zeroed != ERN_OK) return zeroed;
  }
  ern_status status = ern_bench_take_turns(&turns, timing);
  for (size_t k = 0; k < kernels->count && status == ERN_OK; k++) {
    const struct subject *subject = &kernels->subject[k];
    const struct ern_bench_call_cost *cost = &subject->kept[kernels->at[k]].cost;
    const struct ern_bench_shim *shim = subject->kept[kernels->at[k]].source->shim;
    ern_bench_kernel kernel = {.name = cost->name,
                               .item = cost->item,
                               .backend = subject->backend->name,
                               .isa = subject->backend->isa,
                               .threads = ern_bench_shim_threads(shim),
                               .items = cost->items,
                               .flops_written = cost->flops_written,
                               .flops = cost->flops,
                               .bytes = cost->bytes,
                               .reads = cost->reads,
                               .seconds = timing[k]};
    compute_share(&kernel, machine, k, kernels->alone, subject->backend->real_bytes);
    if (say(user, &kernel) != 0)
      status = ern_fail(subject->backend->context, ERN_E_CANCELLED, "bench: stopped at the kernel %s", cost->name);
  }
  return status;
}

static struct sizes sizes_of(const ern_bench_options *chosen, bool alone) {
  const size_t rays = (size_t)chosen->rays;
  return alone ? (struct sizes){1, HEAD_RAYS, TORSO_RAYS, SOME_CELLS, chosen->seed}
               : (struct sizes){chosen->threads, chosen->rays, chosen->rays, CELLS_A_RAY * rays, chosen->seed};
}

ern_status ern_bench_kernels(ern_backend *const *backends, size_t count, const ern_bench_scene *scene,
                             const ern_bench_machine *machine, const ern_bench_options *options,
                             int (*say)(void *user, const ern_bench_kernel *kernel), void *user) {
  ERN_PLAIN_FLOATS;
  ern_bench_options chosen;
  struct kernels kernels = {.count = count};
  ern_status status = ern_bench_choose(backends, count, options, &chosen);
  if (status != ERN_OK) return status;
  ern_context *context = backends[0]->context;
  ERN_NEED(context, scene);
  ERN_NEED(context, say);
  kernels.alone = ern_bench_devices(backends, count) == 0;
  const struct sizes sizes = sizes_of(&chosen, kernels.alone);
  const int sources = scene->model->field.config.torso ? SOURCES : TORSO_STEP;
  ERN_TRY(ERN_NEW(context, count, &kernels.subject));
  for (size_t k = 0; k < count; k++) {
    kernels.subject[k].backend = backends[k];
    for (int s = 0; s < sources; s++)
      ERN_TRY(make_source(&kernels.subject[k].source[s], (enum source_kind)s, &kernels.subject[k], scene, &sizes));
  }
  const size_t all = kernels.subject[0].count;
  for (size_t number = 0; number < all; number++) {
    ERN_TRY(ern_bench_progress(context, &chosen, number, all));
    ERN_TRY(measure(&kernels, number, chosen.seconds / (double)all, machine, say, user));
  }
  status = ern_bench_progress(context, &chosen, all, all);
fail:
  for (size_t k = 0; kernels.subject != NULL && k < count; k++) free_subject(&kernels.subject[k]);
  ern_release(context, kernels.subject);
  return status;
}
