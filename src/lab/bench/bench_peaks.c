/* SPDX-License-Identifier: MIT
 * Measures the machine's peaks: multiply-adds and random reads for each instruction set and device, and stream
 * bandwidth by working-set size. */
#include <string.h>
#include <unistd.h>

#include "backend_cpu/peak.h"
#include "backend_opencl/device/peak.h"
#include "core/cpu.h"
#include "core/floats.h"
#include "core/memory.h"
#include "core/rng.h"
#include "core/status.h"
#include "core/threads.h"
#include "lab/bench/bench_shared.h"

enum {
  MULTIPLY_TURNS = 1 << 14, /* a call lasts a tenth of a millisecond or so */
  GATHER_TURNS = 1 << 12,
  PARTS = 5, /* of the progress: multiply, gather, streams of L2, of L3 and device caches, of memory */
  STREAMS = 3
};

/* A device to be measured, and the buffers of its loops. */
struct device {
  struct ern_backend *backend; /* NULL: the CPU */
  struct ern_stream *stream;
  struct ern_buffer *sink, *table, *to, *from;
  struct ern_opencl_about about;
};

/* One loop on one or all threads, or on a device. */
struct load {
  struct ern_stream *stream; /* of a device; NULL: the CPU */
  struct ern_opencl_peak on_device;
  struct ern_pool *pool;
  ern_peak_multiply_loop *multiply;
  ern_peak_gather_loop *gather;
  const float *table; /* [ERN_PEAK_TABLE] */
  ern_peak_copy_loop *copy;
  ern_peak_update_loop *update;
  float *from, *to; /* of memcpy, a copy or an update: one slice for each thread */
  size_t slice;     /* floats; 0: no copy */
  size_t times;
  double each; /* operations of a call on one thread */
};

struct sink {
  float value[16]; /* a cache line */
};

static void load_task(void *user, size_t index, int worker) {
  (void)worker;
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
      __asm__ volatile("" ::: "memory"); /* else the compiler may drop a copy that the next one overwrites */
      done = 2.0 * (double)load->slice * sizeof *to;
    }
    if (index == 0) load->each = done;
    keep = sink.value[0];
  }
  (void)keep;
}

struct peaks {
  struct load load[ERN_BENCH_BACKENDS];
  size_t count;
  struct ern_pool *pool;
  size_t threads;
  /* readings: those of one thread first */
  size_t turn[ERN_BENCH_TURNS]; /* number of the load */
  size_t alone, turns;
};

static ern_status run_on_device(struct load *load) {
  ern_status status = ERN_OK;
  for (size_t k = 0; k < load->times && status == ERN_OK; k++)
    status = ern_opencl_peak_run(load->stream, &load->on_device, &load->each);
  return status == ERN_OK ? ern_opencl_finish(load->stream) : status;
}

static ern_status run_load(void *user, size_t which, size_t times) {
  struct peaks *peaks = user;
  struct load *load = &peaks->load[peaks->turn[which]];
  load->times = times;
  if (load->stream != NULL) return run_on_device(load);
  if (which < peaks->alone)
    load_task(load, 0, 0);
  else
    ern_pool_run(peaks->pool, peaks->threads, load_task, load);
  return ERN_OK;
}

/* Plans each load on all threads or its device; before that, each CPU load on one thread. */
static void plan(struct peaks *peaks) {
  peaks->turns = 0;
  for (size_t k = 0; k < peaks->count; k++)
    if (peaks->load[k].stream == NULL) peaks->turn[peaks->turns++] = k;
  peaks->alone = peaks->turns;
  for (size_t k = 0; k < peaks->count; k++) peaks->turn[peaks->turns++] = k;
}

/* unrest: raised to the largest median / least of the readings of all threads; NULL: not requested. */
static ern_status measure(struct peaks *peaks, double seconds, ern_bench_rate *rate, size_t rate_step, double *unrest) {
  ern_bench_timing timing[ERN_BENCH_TURNS];
  plan(peaks);
  for (size_t k = 0; k < peaks->count; k++) { /* warm-up: a device may build the loop first, which can take seconds */
    peaks->load[k].times = 1;
    const ern_status built = peaks->load[k].stream != NULL ? run_on_device(&peaks->load[k]) : ERN_OK;
    if (built != ERN_OK) return built;
  }
  const struct ern_bench_turns turns = {.work = run_load,
                                        .user = peaks,
                                        .count = peaks->turns,
                                        .alone = peaks->alone,
                                        .seconds = seconds,
                                        .least = 1e-3,
                                        .most = ERN_BENCH_REPEATS};
  const ern_status status = ern_bench_take_turns(&turns, timing);
  for (size_t t = 0; t < peaks->turns && status == ERN_OK; t++) {
    const size_t k = peaks->turn[t];
    const struct load *load = &peaks->load[k];
    ern_bench_rate *out = (ern_bench_rate *)((uint8_t *)rate + k * rate_step);
    if (t < peaks->alone) {
      out->one = load->each / timing[t].least;
      continue;
    }
    if (unrest != NULL && timing[t].median > *unrest * timing[t].least) *unrest = timing[t].median / timing[t].least;
    out->all = load->each * (load->stream != NULL ? 1 : (double)peaks->threads) / timing[t].least;
    if (load->stream != NULL) out->one = out->all;
    if (out->all < out->one) out->all = out->one; /* all threads can do what one can: other programs interfered */
  }
  return status;
}

/* ---- devices ----------------------------------------------------------------------------------------------------- */

static void free_device(struct device *device) {
  struct ern_backend *backend = device->backend;
  if (backend == NULL) return;
  backend->buffer_free(backend, device->sink);
  backend->buffer_free(backend, device->table);
  backend->buffer_free(backend, device->to);
  backend->buffer_free(backend, device->from);
  backend->stream_free(device->stream);
}

/* table: [ERN_OPENCL_PEAK_TABLE] */
static ern_status open_device(struct device *device, struct ern_backend *backend, const float *table) {
  ern_status status = ERN_OK;
  device->backend = backend;
  ern_opencl_describe(backend, &device->about);
  ERN_TRY(backend->stream_make(backend, 0, &device->stream));
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, device->about.sink, &device->sink));
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, ERN_OPENCL_PEAK_TABLE, &device->table));
  ERN_TRY(backend->upload_reals(device->stream, (ern_span){device->table, 0, ERN_OPENCL_PEAK_TABLE}, table,
                                ERN_OPENCL_PEAK_TABLE));
fail:
  return status;
}

static struct load load_of_device(const struct device *device, enum ern_opencl_loop loop) {
  return (struct load){.stream = device->stream,
                       .on_device = {.loop = loop,
                                     .sink = {device->sink, 0, device->about.sink},
                                     .table = {device->table, 0, ERN_OPENCL_PEAK_TABLE}}};
}

/* `bytes`: of each of the two arrays. Takes the fastest of a copy, an update in place and the driver's copy. */
static ern_status stream_device(struct device *device, size_t bytes, double seconds, ern_bench_rate *rate) {
  static const enum ern_opencl_loop loops[STREAMS] = {ERN_OPENCL_COPY, ERN_OPENCL_UPDATE, ERN_OPENCL_MOVE};
  const size_t block = ERN_OPENCL_PEAK_BLOCK * sizeof(float), blocks = bytes / block > 0 ? bytes / block : 1;
  const size_t count = blocks * ERN_OPENCL_PEAK_BLOCK;
  struct ern_backend *backend = device->backend;
  struct peaks peaks = {.count = STREAMS};
  ern_bench_rate found[STREAMS] = {{0, 0}};
  ern_status status = ERN_OK;
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, count, &device->to));
  ERN_TRY(backend->buffer_make(backend, ERN_ELEMENT_REAL, count, &device->from));
  for (size_t k = 0; k < STREAMS; k++) {
    peaks.load[k] = load_of_device(device, loops[k]);
    peaks.load[k].on_device.to = (ern_span){device->to, 0, count};
    peaks.load[k].on_device.from = (ern_span){device->from, 0, count};
  }
  ERN_TRY(measure(&peaks, seconds, found, sizeof *found, NULL));
  for (size_t k = 0; k < STREAMS; k++)
    if (found[k].all > rate->all) *rate = found[k];
fail:
  backend->buffer_free(backend, device->to);
  backend->buffer_free(backend, device->from);
  device->to = device->from = NULL;
  return status;
}

static size_t between(size_t value, size_t low, size_t high) { return value < low ? low : value > high ? high : value; }

/* Measures one of the two streams. If the driver does not report the cache size, the cache's stream is the memory's. */
static ern_status stream_devices(struct device *devices, ern_bench_machine *machine, bool memory, double seconds) {
  for (size_t k = 0; k < machine->peaks; k++) {
    struct device *device = &devices[k];
    ern_bench_peak *peak = &machine->peak[k];
    const size_t cache = device->about.cache_bytes, half = (size_t)device->about.buffer_bytes / 2;
    if (device->backend == NULL || (!memory && cache == 0)) continue;
    const size_t large = between(4 * cache, (size_t)64 << 20, (size_t)512 << 20);
    const size_t bytes = memory ? (large < half ? large : half) : cache / 4;
    const ern_status status =
        stream_device(device, bytes, seconds, memory ? &peak->stream_memory : &peak->stream_cache);
    if (status != ERN_OK) return status;
    if (cache == 0) peak->stream_cache = peak->stream_memory;
  }
  return ERN_OK;
}

/* ---- by instruction set ------------------------------------------------------------------------------------------ */

/* The loops of an instruction set. */
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

static ern_status measure_isas(ern_backend *const *backends, size_t count, struct device *devices,
                               const ern_bench_options *options, struct ern_pool *pool, ern_bench_machine *machine) {
  ern_context *context = backends[0]->context;
  struct peaks multiply = {.pool = pool, .count = count, .threads = (size_t)machine->threads}, gather = multiply;
  float *table = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(context, ERN_PEAK_TABLE, &table));
  for (uint32_t i = 0; i < ERN_PEAK_TABLE; i++)
    table[i] = ern_uniform(ern_random_at(options->seed, 0, i, ERN_RNG_INIT).word[0]);
  for (size_t k = 0; k < count; k++) {
    machine->peak[k] = (ern_bench_peak){.backend = backends[k]->name, .isa = backends[k]->isa};
    if (ern_bench_is_device(backends[k])) {
      ERN_TRY(open_device(&devices[k], backends[k], table));
      machine->peak[k].units = devices[k].about.units;
      machine->peak[k].cache_bytes = devices[k].about.cache_bytes;
      multiply.load[k] = load_of_device(&devices[k], ERN_OPENCL_MULTIPLY);
      gather.load[k] = load_of_device(&devices[k], ERN_OPENCL_GATHER);
      continue;
    }
    const struct loops loops = loops_of(backends[k]->isa);
    multiply.load[k].multiply = loops.multiply;
    gather.load[k].gather = loops.gather;
    gather.load[k].table = table;
  }
  ERN_TRY(
      measure(&multiply, options->seconds / PARTS, &machine->peak[0].flops, sizeof machine->peak[0], &machine->unrest));
  ERN_TRY(ern_bench_progress(context, options, 1, PARTS));
  ERN_TRY(measure(&gather, options->seconds / PARTS, &machine->peak[0].reads, sizeof machine->peak[0], NULL));
  ERN_TRY(ern_bench_progress(context, options, 2, PARTS));
fail:
  ern_release(context, table);
  return status;
}

/* ---- streams ------------------------------------------------------------------------------------------------------
 */

static size_t cache_bytes(int name, size_t otherwise) {
  const long bytes = sysconf(name);
  return bytes > 0 ? (size_t)bytes : otherwise;
}

/* The instruction set of the last backend that is the CPU; NULL: none is. */
static const char *last_isa(const ern_bench_machine *machine) {
  const char *isa = NULL;
  for (size_t k = 0; k < machine->peaks; k++)
    if (machine->peak[k].units == 0) isa = machine->peak[k].isa;
  return isa;
}

/* `bytes`: of each of the two arrays, on each thread. Takes the fastest of memcpy, a copy and an update in place. */
static ern_status measure_stream(ern_context *context, struct ern_pool *pool, const ern_bench_machine *machine,
                                 size_t bytes, double seconds, ern_bench_rate *rate) {
  const size_t threads = (size_t)machine->threads;
  if (last_isa(machine) == NULL) return ERN_OK;
  const struct loops loops = loops_of(last_isa(machine));
  struct peaks peaks = {.pool = pool, .count = STREAMS, .threads = threads};
  ern_bench_rate found[STREAMS] = {{0, 0}};
  float *from = NULL, *to = NULL;
  size_t all = 0;
  ern_status status = ERN_OK;
  if (!ern_size_multiply(bytes, threads, &all))
    return ern_fail(context, ERN_E_NO_MEMORY, "bench: %zu arrays of %zu bytes do not fit", threads, bytes);
  ERN_TRY(ERN_NEW(context, all / sizeof *from, &from));
  ERN_TRY(ERN_NEW(context, all / sizeof *to, &to));
  memset(from, 1, all); /* commits the pages: fresh ones all map to one page of zeros */
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

static ern_status measure_streams(ern_context *context, struct device *devices, const ern_bench_options *options,
                                  struct ern_pool *pool, ern_bench_machine *machine) {
  const size_t threads = (size_t)machine->threads, line = 64 * sizeof(float);
  const double seconds = options->seconds / PARTS;
  /* each core has its own L2; L3 and memory are shared, so the threads divide them */
  const size_t l2 = machine->l2_bytes / 4 / line * line;
  const size_t l3 = between(machine->l3_bytes / 4 / threads, l2, machine->l3_bytes) / line * line;
  const size_t memory = between(4 * machine->l3_bytes, (size_t)64 << 20, (size_t)512 << 20) / threads / line * line;
  ern_status status = ERN_OK;
  ERN_TRY(measure_stream(context, pool, machine, l2, seconds, &machine->stream_l2));
  ERN_TRY(ern_bench_progress(context, options, 3, PARTS));
  ERN_TRY(measure_stream(context, pool, machine, l3, seconds, &machine->stream_l3));
  ERN_TRY(stream_devices(devices, machine, false, seconds));
  ERN_TRY(ern_bench_progress(context, options, 4, PARTS));
  ERN_TRY(measure_stream(context, pool, machine, memory, seconds, &machine->stream_memory));
  ERN_TRY(stream_devices(devices, machine, true, seconds));
  ERN_TRY(ern_bench_progress(context, options, 5, PARTS));
fail:
  return status;
}

ern_status ern_bench_peaks(ern_backend *const *backends, size_t count, const ern_bench_options *options,
                           ern_bench_machine *machine) {
  ERN_PLAIN_FLOATS;
  ern_bench_options chosen;
  struct ern_pool *pool = NULL;
  struct device devices[ERN_BENCH_BACKENDS] = {{0}};
  ern_status status = ern_bench_choose(backends, count, options, &chosen);
  if (status != ERN_OK) return status;
  ERN_NEED(backends[0]->context, machine);
  *machine = (ern_bench_machine){.peaks = count};
  machine->l2_bytes = (size_t)1 << 20;
  machine->l3_bytes = (size_t)32 << 20;
#if defined(_SC_LEVEL2_CACHE_SIZE)
  machine->l2_bytes = cache_bytes(_SC_LEVEL2_CACHE_SIZE, machine->l2_bytes);
  machine->l3_bytes = cache_bytes(_SC_LEVEL3_CACHE_SIZE, machine->l3_bytes);
#endif
  ERN_TRY(ern_pool_make(backends[0]->context, chosen.threads, &pool));
  machine->threads = ern_pool_threads(pool);
  ERN_TRY(measure_isas(backends, count, devices, &chosen, pool, machine));
  ERN_TRY(measure_streams(backends[0]->context, devices, &chosen, pool, machine));
fail:
  for (size_t k = 0; k < ERN_BENCH_BACKENDS; k++) free_device(&devices[k]);
  ern_pool_free(pool);
  return status;
}
