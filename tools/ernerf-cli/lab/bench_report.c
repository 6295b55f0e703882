/* SPDX-License-Identifier: MIT */
#include "lab/bench_report.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* ---- the CPU and a device ---------------------------------------------------------------------------------------- */

static bool is_cpu(const char *backend) { return strcmp(backend, "cpu") == 0; }
/* The name of a device is too long for a column. */
static const char *place_of(const char *backend, const char *isa) { return is_cpu(backend) ? isa : backend; }
static bool both(const struct bench_results *results) { return results->cpu != NULL && results->device.name != NULL; }

/* The baseline for a device: the last instruction set of the CPU, by default the best; NULL: nothing to compare. */
static const char *compared_with(const struct bench_results *results) {
  const char *isa = NULL;
  for (size_t k = 0; both(results) && k < results->machine.peaks; k++)
    if (is_cpu(results->machine.peak[k].backend)) isa = results->machine.peak[k].isa;
  return isa;
}
/* Speed-up over the baseline; NaN: nothing to compare. */
static double speed_of_kernel(const struct bench_results *results, const ern_bench_kernel *kernel) {
  const char *isa = compared_with(results);
  for (size_t i = 0; isa != NULL && i < results->kernel_count; i++) {
    const ern_bench_kernel *k = &results->kernels[i];
    if (strcmp(k->isa, isa) == 0 && strcmp(k->name, kernel->name) == 0) return k->seconds.least / kernel->seconds.least;
  }
  return (double)NAN;
}
static double speed_of_pass(const struct bench_results *results, const ern_bench_pass *passes, size_t index) {
  const char *isa = compared_with(results);
  for (size_t i = 0; isa != NULL && i < results->backends; i++)
    if (strcmp(passes[i].isa, isa) == 0) return passes[i].seconds.least / passes[index].seconds.least;
  return (double)NAN;
}

/* ---- tables ------------------------------------------------------------------------------------------------------ */

static void print_share(double share) {
  if (isfinite(share))
    printf("  %5.1f %%", 100 * share);
  else
    printf("  %7s", "-");
}

void bench_print_scene(const struct bench_results *results) {
  const ern_bench_scene_info *s = &results->scene;
  const double pixels = (double)s->pixels;
  if (results->cpu != NULL) printf("%s\n", results->cpu);
  if (results->device.name != NULL)
    printf("OpenCL device %d: %s, driver %s\n", results->device.number, results->device.name, results->device.driver);
  if (results->model != NULL)
    printf("%s on a frame of %s", results->model, results->clip);
  else
    printf("a made-up scene");
  printf(": %d x %d pixels, %d levels, %zu numbers, %.2f %% of the cells occupied\n", s->width, s->height, s->levels,
         s->parameters, 100 * s->occupied);
  printf(
      "%zu rays of %zu have samples: %zu marched (%.2f a pixel), %zu of them before the transmittance of the ray "
      "is below 1e-4\n",
      s->hits, s->pixels, s->marched, (double)s->marched / pixels, s->lit);
  printf("a sample is %.0f FLOP as written, %.0f with layers folded\n\n", s->sample_flops, s->folded_flops);
}

/* A device has no figure for a single thread. */
static void print_rate(const char *name, const char *unit, const ern_bench_rate *rate, bool device) {
  char one[32] = "-";
  if (!device) snprintf(one, sizeof one, "%.1f", rate->one * 1e-9);
  printf("  %-32s  %10s  %10.1f  %s\n", name, one, rate->all * 1e-9, unit);
}

static void print_streams(const ern_bench_machine *m) {
  char name[64];
  snprintf(name, sizeof name, "stream inside L2 (%zu KiB)", m->l2_bytes >> 10);
  print_rate(name, "GB/s, read and written", &m->stream_l2, false);
  snprintf(name, sizeof name, "stream inside L3 (%zu MiB)", m->l3_bytes >> 20);
  print_rate(name, "GB/s", &m->stream_l3, false);
  print_rate("stream in memory", "GB/s", &m->stream_memory, false);
}

static void print_device_streams(const ern_bench_peak *peak) {
  char name[64];
  const bool large = peak->cache_bytes >= (size_t)1 << 20;
  if (peak->cache_bytes > 0) {
    snprintf(name, sizeof name, "opencl, stream in cache (%zu %s)", peak->cache_bytes >> (large ? 20 : 10),
             large ? "MiB" : "KiB");
    print_rate(name, "GB/s, read and written", &peak->stream_cache, true);
  }
  print_rate("opencl, stream in memory", "GB/s, read and written", &peak->stream_memory, true);
}

void bench_print_peaks(const struct bench_results *results) {
  const ern_bench_machine *m = &results->machine;
  char name[64], all[64] = "all of it";
  if (results->device.name == NULL) snprintf(all, sizeof all, "%d threads", m->threads);
  printf("%-34s  %10s  %10s\n", "peaks", results->cpu != NULL ? "one thread" : "", all);
  for (size_t k = 0; k < m->peaks; k++) {
    snprintf(name, sizeof name, "multiply-adds, %s", place_of(m->peak[k].backend, m->peak[k].isa));
    print_rate(name, "GFLOP/s", &m->peak[k].flops, m->peak[k].units > 0);
  }
  for (size_t k = 0; k < m->peaks; k++) {
    snprintf(name, sizeof name, "random reads, %s", place_of(m->peak[k].backend, m->peak[k].isa));
    print_rate(name, "G/s of 32 bits from 64 KiB", &m->peak[k].reads, m->peak[k].units > 0);
  }
  if (results->cpu != NULL) print_streams(m);
  for (size_t k = 0; k < m->peaks; k++)
    if (m->peak[k].units > 0) print_device_streams(&m->peak[k]);
  printf("\n");
}

static void print_kernels_head(const struct bench_results *results) {
  const char *title = "kernels, one thread";
  if (results->cpu == NULL) title = "kernels, the device";
  if (both(results)) title = "kernels, all threads";
  printf("%-23s %-7s %-10s %10s %10s %9s %9s %9s  %7s  %-7s %s", title, "", "on", "M/s", "ns each", "GFLOP/s", "GB/s",
         "G reads/s", "share", "of", "median/least");
  if (both(results)) printf("  times %s", compared_with(results));
  printf("\n");
}

void bench_print_kernels(const struct bench_results *results) {
  const char *last = "";
  print_kernels_head(results);
  for (size_t i = 0; i < results->kernel_count; i++) {
    const ern_bench_kernel *k = &results->kernels[i];
    const double s = k->seconds.least, speed = speed_of_kernel(results, k);
    printf("%-23s %-7s %-10s %10.3f %10.2f %9.2f %9.2f %9.3f", k->name == last ? "" : k->name, k->item,
           place_of(k->backend, k->isa), k->items / s * 1e-6, s / k->items * 1e9, k->flops / s * 1e-9,
           k->bytes / s * 1e-9, k->reads / s * 1e-9);
    print_share(k->share);
    printf("  %-7s %12.2f", k->bound, k->seconds.median / s);
    if (isfinite(speed)) printf("  %10.2f", speed);
    printf("\n");
    last = k->name;
  }
  printf("\n");
}

static void print_stages(const ern_bench_pass *pass) {
  double staged = 0;
  for (int k = 0; k < pass->stages; k++) {
    printf(" %s %.2f ms%s", pass->stage[k].name, 1e3 * pass->stage[k].seconds, k + 1 < pass->stages ? "," : "");
    staged += pass->stage[k].seconds;
  }
  printf("; the rest %.2f ms\n", 1e3 * fmax(pass->seconds.median - staged, 0));
}

void bench_print_passes(const struct bench_results *results, const char *title, const ern_bench_pass *passes) {
  for (size_t i = 0; i < results->backends; i++) {
    const ern_bench_pass *p = &passes[i];
    const bool cpu = is_cpu(p->backend);
    const double s = p->seconds.least, speed = speed_of_pass(results, passes, i);
    printf("%s, %s, %d %s: %.2f ms least, %.2f median of %d, %.2f of processor time; %.2f a second", title,
           place_of(p->backend, p->isa), p->threads, cpu ? "threads" : "compute units", 1e3 * s,
           1e3 * p->seconds.median, p->seconds.repeats, 1e3 * p->seconds.cpu, 1 / s);
    if (isfinite(speed)) printf(", %.2f times %s", speed, compared_with(results));
    printf("%s\n", p->fused ? ", fused" : ", stage by stage");
    printf("  %.0f rays, %.0f samples marched, %.0f evaluated, %.0f coloured: %.2f M samples a second\n", p->rays,
           p->marched, p->evaluated, p->colours, p->evaluated / s * 1e-6);
    printf("  GFLOP/s: %.1f computed, %.1f as written;", p->flops / s * 1e-9, p->flops_written / s * 1e-9);
    print_share(p->share);
    printf(" of the peak of %s\n ", cpu ? "all threads" : "the device");
    print_stages(p);
  }
  printf("\n");
}

/* ---- JSON -------------------------------------------------------------------------------------------------------- */

static json_t *rate_json(const ern_bench_rate *rate) {
  return json_pack("{s:o, s:o}", "one", session_number(rate->one), "all", session_number(rate->all));
}

static json_t *timing_json(const ern_bench_timing *timing) {
  return json_pack("{s:o, s:o, s:o, s:i}", "least", session_number(timing->least), "median",
                   session_number(timing->median), "cpu", session_number(timing->cpu), "repeats", timing->repeats);
}

static json_t *peak_json(const ern_bench_peak *peak) {
  json_t *object = json_pack("{s:s, s:s, s:o, s:o}", "backend", peak->backend, "isa", peak->isa, "flops",
                             rate_json(&peak->flops), "reads", rate_json(&peak->reads));
  if (peak->units == 0) return object;
  json_object_update_new(
      object,
      json_pack("{s:i, s:I, s:o, s:o}", "units", (int)peak->units, "cache_bytes", (json_int_t)peak->cache_bytes,
                "stream_cache", rate_json(&peak->stream_cache), "stream_memory", rate_json(&peak->stream_memory)));
  return object;
}

/* "isas": instruction sets of the CPU; "devices": the others. */
static json_t *peaks_json(const ern_bench_machine *m) {
  json_t *isas = json_array(), *devices = json_array();
  for (size_t k = 0; k < m->peaks; k++)
    json_array_append_new(m->peak[k].units == 0 ? isas : devices, peak_json(&m->peak[k]));
  return json_pack("{s:i, s:o, s:I, s:I, s:o, s:o, s:o, s:o, s:o}", "threads", m->threads, "unrest",
                   session_number(m->unrest), "l2_bytes", (json_int_t)m->l2_bytes, "l3_bytes", (json_int_t)m->l3_bytes,
                   "stream_l2", rate_json(&m->stream_l2), "stream_l3", rate_json(&m->stream_l3), "stream_memory",
                   rate_json(&m->stream_memory), "isas", isas, "devices", devices);
}

static json_t *text_or_null(const char *text) { return text != NULL ? session_text(text) : json_null(); }

static json_t *scene_json(const struct bench_results *results) {
  const ern_bench_scene_info *s = &results->scene;
  return json_pack("{s:o, s:o, s:i, s:i, s:i, s:o, s:I, s:I, s:I, s:I, s:I, s:o, s:o}", "model",
                   text_or_null(results->model), "clip", text_or_null(results->clip), "width", s->width, "height",
                   s->height, "levels", s->levels, "occupied", session_number(s->occupied), "parameters",
                   (json_int_t)s->parameters, "pixels", (json_int_t)s->pixels, "hits", (json_int_t)s->hits, "marched",
                   (json_int_t)s->marched, "lit", (json_int_t)s->lit, "sample_flops", session_number(s->sample_flops),
                   "folded_flops", session_number(s->folded_flops));
}

static json_t *kernel_json(const struct bench_results *results, const ern_bench_kernel *k) {
  const double s = k->seconds.least;
  return json_pack(
      "{s:s, s:s, s:s, s:i, s:s, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:s, s:o}", "name", k->name,
      "backend", k->backend, "isa", k->isa, "threads", k->threads, "item", k->item, "items", session_number(k->items),
      "seconds", timing_json(&k->seconds), "items_per_second", session_number(k->items / s), "flops",
      session_number(k->flops), "flops_written", session_number(k->flops_written), "flops_per_second",
      session_number(k->flops / s), "bytes", session_number(k->bytes), "bytes_per_second", session_number(k->bytes / s),
      "reads", session_number(k->reads), "reads_per_second", session_number(k->reads / s), "share",
      session_number(k->share), "bound", k->bound, "times_cpu", session_number(speed_of_kernel(results, k)));
}

static json_t *pass_json(const ern_bench_pass *p, double speed) {
  const double s = p->seconds.least;
  json_t *stages = json_object();
  for (int k = 0; k < p->stages; k++)
    json_object_set_new(stages, p->stage[k].name, session_number(p->stage[k].seconds));
  return json_pack("{s:s, s:s, s:i, s:b, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "backend",
                   p->backend, "isa", p->isa, "threads", p->threads, "fused", p->fused, "seconds",
                   timing_json(&p->seconds), "per_second", session_number(1 / s), "rays", session_number(p->rays),
                   "marched", session_number(p->marched), "evaluated", session_number(p->evaluated), "colours",
                   session_number(p->colours), "samples_per_second", session_number(p->evaluated / s), "flops",
                   session_number(p->flops), "flops_written", session_number(p->flops_written), "flops_per_second",
                   session_number(p->flops / s), "share", session_number(p->share), "times_cpu", session_number(speed),
                   "stages", stages);
}

static json_t *passes_json(const struct bench_results *results, const ern_bench_pass *passes, bool there) {
  json_t *list = there ? json_array() : json_null();
  for (size_t i = 0; there && i < results->backends; i++)
    json_array_append_new(list, pass_json(&passes[i], speed_of_pass(results, passes, i)));
  return list;
}

json_t *bench_json(const struct bench_results *results) {
  json_t *kernels = json_array();
  for (size_t i = 0; i < results->kernel_count; i++)
    json_array_append_new(kernels, kernel_json(results, &results->kernels[i]));
  json_t *device = json_null();
  if (results->device.name != NULL)
    device = json_pack("{s:i, s:s, s:s}", "number", results->device.number, "name", results->device.name, "driver",
                       results->device.driver);
  return json_pack("{s:s?, s:o, s:o, s:o, s:o, s:o, s:{s:o, s:o}}", "cpu", results->cpu, "device", device, "scene",
                   scene_json(results), "peaks", peaks_json(&results->machine), "kernels", kernels, "frame",
                   passes_json(results, results->frame, results->has_frame), "step", "head",
                   passes_json(results, results->step, results->has_step), "torso",
                   passes_json(results, results->torso_step, results->has_torso_step));
}
