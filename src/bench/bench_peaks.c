/* SPDX-License-Identifier: MIT
 * The peaks of the machine: multiply-adds and random reads by instruction set, streams by the size of what they run
 * over. */
#include <string.h>
#include <unistd.h>

#include "backend_cpu/peak.h"
#include "bench/bench.h"
#include "core/cpu.h"
#include "core/memory.h"
#include "core/rng.h"
#include "core/status.h"
#include "core/threads.h"

enum {
  MULTIPLY_TURNS = 1 << 14, /* a call lasts a tenth of a millisecond or so */
  GATHER_TURNS = 1 << 12,
  PARTS = 5, /* of a progress: multiply, gather, three streams */
  STREAMS = 3
};

/* One loop on one or all threads. */
struct load {
  struct ern_pool *pool;
  ern_peak_multiply_loop *multiply;
  ern_peak_gather_loop *gather;
  const float *table; /* [ERN_PEAK_TABLE] */
  ern_peak_copy_loop *copy;
  ern_peak_update_loop *update;
  float *from, *to; /* of memcpy, a copy or an update: a slice a thread */
  size_t slice;     /* floats; 0: no copy */
  size_t times;
  double each; /* operations of a call on one thread */
};

struct sink {
  float value[16]; /* a cache line */
};

static void load_task(void *user, size_t index, int lane) {
  (void)lane;
  struct load *load = user;
  struct sink sink = {{0}};
  volatile float keep = 0;
  for (size_t k = 0; k < load->times; k++) {
    double done = 0;
    if (load->multiply != NULL) done = load->multiply(sink.value, MULTIPLY_TURNS);
    if (load->gather != NULL) done = load->gather(sink.value, load->table, GATHER_TURNS);
    if (load->slice > 0) {
      float *to = load->to + index * load->slice;
      const float *from = load->from + index * load->slice;
      if (load->copy != NULL)
        load->copy(to, from, load->slice);
      else if (load->update != NULL)
        load->update(to, load->slice);
      else
        memcpy(to, from, load->slice * sizeof *to);
      __asm__ volatile("" ::: "memory"); /* or a copy that is overwritten by the next may be left out */
      done = 2.0 * (double)load->slice * sizeof *to;
    }
    if (index == 0) load->each = done;
    keep = sink.value[0];
  }
  (void)keep;
}

/* Loads [0, count) on one thread, [count, 2 count) the same on all. */
struct peaks {
  struct load load[ERN_BENCH_TURNS];
  struct ern_pool *pool;
  size_t count;
  size_t threads;
};

static ern_status run_load(void *user, size_t which, size_t times) {
  struct peaks *peaks = user;
  struct load *load = &peaks->load[which % peaks->count];
  load->times = times;
  if (which < peaks->count)
    load_task(load, 0, 0);
  else
    ern_pool_run(peaks->pool, peaks->threads, load_task, load);
  return ERN_OK;
}

/* unrest: grows to the largest median over least of all threads; NULL: not wanted. */
static ern_status measure(struct peaks *peaks, double seconds, ern_bench_rate *rate, size_t rate_step, double *unrest) {
  ern_bench_timing timing[ERN_BENCH_TURNS];
  const struct ern_bench_turns turns = {.work = run_load,
                                        .user = peaks,
                                        .count = 2 * peaks->count,
                                        .alone = peaks->count,
                                        .seconds = seconds,
                                        .least = 1e-3,
                                        .most = ERN_BENCH_REPEATS};
  const ern_status status = ern_bench_take_turns(&turns, timing);
  for (size_t k = 0; k < peaks->count && status == ERN_OK; k++) {
    ern_bench_rate *out = (ern_bench_rate *)((uint8_t *)rate + k * rate_step);
    out->one = peaks->load[k].each / timing[k].least;
    const ern_bench_timing *together = &timing[peaks->count + k];
    if (unrest != NULL && together->median > *unrest * together->least) *unrest = together->median / together->least;
    out->all = peaks->load[k].each * (double)peaks->threads / timing[peaks->count + k].least;
    if (out->all < out->one) out->all = out->one; /* all of them can do what one can: they were not let */
  }
  return status;
}

/* ---- by instruction set ------------------------------------------------------------------------------------------ */

/* What an instruction set does. */
struct loops {
  ern_peak_multiply_loop *multiply;
  ern_peak_gather_loop *gather;
  ern_peak_copy_loop *copy;
  ern_peak_update_loop *update;
};

static struct loops loops_of(const char *isa) {
  static const struct {
    const char *isa;
    struct loops loops;
  } known[] = {
    {"ref64", {ern_peak_multiply_base64, ern_peak_gather_base, ern_peak_copy_base, ern_peak_update_base}},
#if defined(ERN_X86_KERNELS)
    {"avx2", {ern_peak_multiply_avx2, ern_peak_gather_avx2, ern_peak_copy_avx2, ern_peak_update_avx2}},
    {"avx512", {ern_peak_multiply_avx512, ern_peak_gather_avx512, ern_peak_copy_avx512, ern_peak_update_avx512}},
    {"avx512bf16",
     {ern_peak_multiply_avx512bf16, ern_peak_gather_avx512, ern_peak_copy_avx512, ern_peak_update_avx512}},
#endif
#if defined(ERN_ARM_KERNELS)
    {"neon", {ern_peak_multiply_neon, ern_peak_gather_neon, ern_peak_copy_neon, ern_peak_update_neon}},
#endif
  };
  for (size_t i = 0; i < sizeof known / sizeof *known; i++)
    if (strcmp(isa, known[i].isa) == 0) return known[i].loops;
  return (struct loops){ern_peak_multiply_base, ern_peak_gather_base, ern_peak_copy_base, ern_peak_update_base};
}

static ern_status measure_isas(ern_backend *const *backends, size_t count, const ern_bench_options *options,
                               struct ern_pool *pool, ern_bench_machine *machine) {
  ern_context *context = backends[0]->context;
  struct peaks multiply = {.pool = pool, .count = count, .threads = (size_t)machine->threads}, gather = multiply;
  void *room = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ern_allocate(context, ERN_PEAK_TABLE, sizeof(float), &room));
  for (size_t k = 0; k < count; k++) {
    machine->peak[k].isa = backends[k]->isa;
    const struct loops loops = loops_of(backends[k]->isa);
    multiply.load[k].multiply = loops.multiply;
    gather.load[k].gather = loops.gather;
    gather.load[k].table = room;
  }
  for (uint32_t i = 0; i < ERN_PEAK_TABLE; i++)
    ((float *)room)[i] = ern_uniform(ern_random_at(options->seed, 0, i, ERN_RNG_INIT).word[0]);
  ERN_TRY(
      measure(&multiply, options->seconds / PARTS, &machine->peak[0].flops, sizeof machine->peak[0], &machine->unrest));
  ERN_TRY(ern_bench_tell(context, options, 1, PARTS));
  ERN_TRY(measure(&gather, options->seconds / PARTS, &machine->peak[0].reads, sizeof machine->peak[0], NULL));
  ERN_TRY(ern_bench_tell(context, options, 2, PARTS));
fail:
  ern_release(context, room);
  return status;
}

/* ---- streams ------------------------------------------------------------------------------------------------------
 */

static size_t cache_bytes(int name, size_t otherwise) {
  const long bytes = sysconf(name);
  return bytes > 0 ? (size_t)bytes : otherwise;
}

/* `bytes` of each of the two arrays, on each thread: the best of memcpy, a copy and an update in place. */
static ern_status measure_stream(ern_backend *const *backends, struct ern_pool *pool, const ern_bench_machine *machine,
                                 size_t bytes, double seconds, ern_bench_rate *rate) {
  ern_context *context = backends[0]->context;
  const size_t threads = (size_t)machine->threads;
  const struct loops loops = loops_of(backends[machine->peaks - 1]->isa);
  struct peaks peaks = {.pool = pool, .count = STREAMS, .threads = threads};
  ern_bench_rate found[STREAMS] = {{0, 0}};
  void *from = NULL, *to = NULL;
  size_t all = 0;
  ern_status status = ERN_OK;
  if (!ern_size_multiply(bytes, threads, &all))
    return ern_fail(context, ERN_E_NO_MEMORY, "bench: %zu arrays of %zu bytes do not fit", threads, bytes);
  ERN_TRY(ern_allocate(context, all, 1, &from));
  ERN_TRY(ern_allocate(context, all, 1, &to));
  memset(from, 1, all); /* pages of their own: fresh ones are all the same page of zeros */
  memset(to, 2, all);
  for (size_t k = 0; k < STREAMS; k++)
    peaks.load[k] = (struct load){.from = from, .to = to, .slice = bytes / sizeof(float)};
  peaks.load[1].copy = loops.copy;
  peaks.load[2].update = loops.update;
  ERN_TRY(measure(&peaks, seconds, found, sizeof *found, NULL));
  for (size_t k = 0; k < STREAMS; k++) {
    if (found[k].one > rate->one) rate->one = found[k].one;
    if (found[k].all > rate->all) rate->all = found[k].all;
  }
fail:
  ern_release(context, from);
  ern_release(context, to);
  return status;
}

static size_t between(size_t value, size_t low, size_t high) { return value < low ? low : value > high ? high : value; }

static ern_status measure_streams(ern_backend *const *backends, const ern_bench_options *options, struct ern_pool *pool,
                                  ern_bench_machine *machine) {
  ern_context *context = backends[0]->context;
  const size_t threads = (size_t)machine->threads, line = 64 * sizeof(float);
  const double seconds = options->seconds / PARTS;
  /* L2 is a core's own; L3 and memory are shared, so threads divide them */
  const size_t l2 = machine->l2_bytes / 4 / line * line;
  const size_t l3 = between(machine->l3_bytes / 4 / threads, l2, machine->l3_bytes) / line * line;
  const size_t memory = between(4 * machine->l3_bytes, (size_t)64 << 20, (size_t)512 << 20) / threads / line * line;
  ern_status status = ERN_OK;
  ERN_TRY(measure_stream(backends, pool, machine, l2, seconds, &machine->stream_l2));
  ERN_TRY(ern_bench_tell(context, options, 3, PARTS));
  ERN_TRY(measure_stream(backends, pool, machine, l3, seconds, &machine->stream_l3));
  ERN_TRY(ern_bench_tell(context, options, 4, PARTS));
  ERN_TRY(measure_stream(backends, pool, machine, memory, seconds, &machine->stream_memory));
  ERN_TRY(ern_bench_tell(context, options, 5, PARTS));
fail:
  return status;
}

ern_status ern_bench_peaks(ern_backend *const *backends, size_t count, const ern_bench_options *options,
                           ern_bench_machine *machine) {
  ern_bench_options chosen;
  struct ern_pool *pool = NULL;
  *machine = (ern_bench_machine){.peaks = count};
  ern_status status = ern_bench_choose(backends, count, options, &chosen);
  if (status != ERN_OK) return status;
  machine->l2_bytes = (size_t)1 << 20;
  machine->l3_bytes = (size_t)32 << 20;
#if defined(_SC_LEVEL2_CACHE_SIZE)
  machine->l2_bytes = cache_bytes(_SC_LEVEL2_CACHE_SIZE, machine->l2_bytes);
  machine->l3_bytes = cache_bytes(_SC_LEVEL3_CACHE_SIZE, machine->l3_bytes);
#endif
  ERN_TRY(ern_pool_make(backends[0]->context, chosen.threads, &pool));
  machine->threads = ern_pool_threads(pool);
  ERN_TRY(measure_isas(backends, count, &chosen, pool, machine));
  ERN_TRY(measure_streams(backends, &chosen, pool, machine));
fail:
  ern_pool_free(pool);
  return status;
}
