/* SPDX-License-Identifier: MIT */
#include "bench_report.h"

#include <math.h>
#include <stdio.h>

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
  printf("%s\n", results->cpu);
  if (results->model != NULL)
    printf("%s on a frame of %s", results->model, results->clip);
  else
    printf("a made-up scene");
  printf(": %d x %d pixels, %d levels, %zu numbers, %.2f %% of the cells occupied\n", s->width, s->height, s->levels,
         s->parameters, 100 * s->occupied);
  printf("%zu rays of %zu have samples: %zu marched (%.2f a pixel), %zu of them before the light is spent\n", s->hits,
         s->pixels, s->marched, (double)s->marched / pixels, s->lit);
  printf("a sample is %.0f FLOP as written, %.0f with layers folded\n\n", s->sample_flops, s->folded_flops);
}

static void print_rate(const char *name, const char *unit, const ern_bench_rate *rate) {
  printf("  %-28s  %10.1f  %10.1f  %s\n", name, rate->one * 1e-9, rate->all * 1e-9, unit);
}

void bench_print_peaks(const struct bench_results *results) {
  const ern_bench_machine *m = &results->machine;
  char name[64];
  printf("%-30s  %10s  %3d threads\n", "peaks", "one thread", m->threads);
  for (size_t k = 0; k < m->peaks; k++) {
    snprintf(name, sizeof name, "multiply-adds, %s", m->peak[k].isa);
    print_rate(name, "GFLOP/s", &m->peak[k].flops);
  }
  for (size_t k = 0; k < m->peaks; k++) {
    snprintf(name, sizeof name, "random reads, %s", m->peak[k].isa);
    print_rate(name, "G/s of 32 bits from 64 KiB", &m->peak[k].reads);
  }
  snprintf(name, sizeof name, "stream inside L2 (%zu KiB)", m->l2_bytes >> 10);
  print_rate(name, "GB/s, read and written", &m->stream_l2);
  snprintf(name, sizeof name, "stream inside L3 (%zu MiB)", m->l3_bytes >> 20);
  print_rate(name, "GB/s", &m->stream_l3);
  print_rate("stream in memory", "GB/s", &m->stream_memory);
  printf("\n");
}

void bench_print_kernels(const struct bench_results *results) {
  const char *last = "";
  printf("%-23s %-7s %-7s %10s %10s %9s %9s %9s  %7s  %-7s %s\n", "kernels, one thread", "", "isa", "M/s", "ns each",
         "GFLOP/s", "GB/s", "G reads/s", "share", "of", "median/least");
  for (size_t i = 0; i < results->kernel_count; i++) {
    const ern_bench_kernel *k = &results->kernels[i];
    const double s = k->seconds.least;
    printf("%-23s %-7s %-7s %10.3f %10.2f %9.2f %9.2f %9.3f", k->name == last ? "" : k->name, k->item, k->isa,
           k->items / s * 1e-6, s / k->items * 1e9, k->flops / s * 1e-9, k->bytes / s * 1e-9, k->reads / s * 1e-9);
    print_share(k->share);
    printf("  %-7s %.2f\n", k->bound, k->seconds.median / s);
    last = k->name;
  }
  printf("\n");
}

void bench_print_passes(const struct bench_results *results, const char *title, const ern_bench_pass *passes) {
  for (size_t i = 0; i < results->backends; i++) {
    const ern_bench_pass *p = &passes[i];
    const double s = p->seconds.least;
    printf("%s, %s, %d threads: %.2f ms least, %.2f median of %d, %.2f of processor time; %.2f a second%s\n", title,
           p->isa, p->threads, 1e3 * s, 1e3 * p->seconds.median, p->seconds.repeats, 1e3 * p->seconds.cpu, 1 / s,
           p->fused ? ", fused" : ", stage by stage");
    printf("  %.0f rays, %.0f samples marched, %.0f evaluated, %.0f coloured: %.2f M samples a second\n", p->rays,
           p->marched, p->evaluated, p->colours, p->evaluated / s * 1e-6);
    printf("  GFLOP/s: %.1f computed, %.1f as written;", p->flops / s * 1e-9, p->flops_written / s * 1e-9);
    print_share(p->share);
    printf(" of the peak of all threads\n ");
    double staged = 0;
    for (int k = 0; k < p->stages; k++) {
      printf(" %s %.2f ms%s", p->stage[k].name, 1e3 * p->stage[k].seconds, k + 1 < p->stages ? "," : "");
      staged += p->stage[k].seconds;
    }
    printf("; the rest %.2f ms\n", 1e3 * fmax(p->seconds.median - staged, 0));
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

static json_t *peaks_json(const ern_bench_machine *m) {
  json_t *isas = json_array();
  for (size_t k = 0; k < m->peaks; k++)
    json_array_append_new(isas, json_pack("{s:s, s:o, s:o}", "isa", m->peak[k].isa, "flops",
                                          rate_json(&m->peak[k].flops), "reads", rate_json(&m->peak[k].reads)));
  return json_pack("{s:i, s:o, s:I, s:I, s:o, s:o, s:o, s:o}", "threads", m->threads, "unrest",
                   session_number(m->unrest), "l2_bytes", (json_int_t)m->l2_bytes, "l3_bytes", (json_int_t)m->l3_bytes,
                   "stream_l2", rate_json(&m->stream_l2), "stream_l3", rate_json(&m->stream_l3), "stream_memory",
                   rate_json(&m->stream_memory), "isas", isas);
}

static json_t *scene_json(const struct bench_results *results) {
  const ern_bench_scene_info *s = &results->scene;
  return json_pack("{s:s?, s:s?, s:i, s:i, s:i, s:o, s:I, s:I, s:I, s:I, s:I, s:o, s:o}", "model", results->model,
                   "clip", results->clip, "width", s->width, "height", s->height, "levels", s->levels, "occupied",
                   session_number(s->occupied), "parameters", (json_int_t)s->parameters, "pixels",
                   (json_int_t)s->pixels, "hits", (json_int_t)s->hits, "marched", (json_int_t)s->marched, "lit",
                   (json_int_t)s->lit, "sample_flops", session_number(s->sample_flops), "folded_flops",
                   session_number(s->folded_flops));
}

static json_t *kernel_json(const ern_bench_kernel *k) {
  const double s = k->seconds.least;
  return json_pack("{s:s, s:s, s:s, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:s}", "name", k->name,
                   "isa", k->isa, "item", k->item, "items", session_number(k->items), "seconds",
                   timing_json(&k->seconds), "items_per_second", session_number(k->items / s), "flops",
                   session_number(k->flops), "flops_written", session_number(k->flops_written), "flops_per_second",
                   session_number(k->flops / s), "bytes", session_number(k->bytes), "bytes_per_second",
                   session_number(k->bytes / s), "reads", session_number(k->reads), "reads_per_second",
                   session_number(k->reads / s), "share", session_number(k->share), "bound", k->bound);
}

static json_t *pass_json(const ern_bench_pass *p) {
  const double s = p->seconds.least;
  json_t *stages = json_object();
  for (int k = 0; k < p->stages; k++)
    json_object_set_new(stages, p->stage[k].name, session_number(p->stage[k].seconds));
  return json_pack("{s:s, s:i, s:b, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "isa", p->isa,
                   "threads", p->threads, "fused", p->fused, "seconds", timing_json(&p->seconds), "per_second",
                   session_number(1 / s), "rays", session_number(p->rays), "marched", session_number(p->marched),
                   "evaluated", session_number(p->evaluated), "colours", session_number(p->colours),
                   "samples_per_second", session_number(p->evaluated / s), "flops", session_number(p->flops),
                   "flops_written", session_number(p->flops_written), "flops_per_second", session_number(p->flops / s),
                   "share", session_number(p->share), "stages", stages);
}

static json_t *passes_json(const struct bench_results *results, const ern_bench_pass *passes, bool there) {
  json_t *list = there ? json_array() : json_null();
  for (size_t i = 0; there && i < results->backends; i++) json_array_append_new(list, pass_json(&passes[i]));
  return list;
}

json_t *bench_json(const struct bench_results *results) {
  json_t *kernels = json_array();
  for (size_t i = 0; i < results->kernel_count; i++) json_array_append_new(kernels, kernel_json(&results->kernels[i]));
  return json_pack("{s:s, s:o, s:o, s:o, s:o, s:{s:o, s:o}}", "cpu", results->cpu, "scene", scene_json(results),
                   "peaks", peaks_json(&results->machine), "kernels", kernels, "frame",
                   passes_json(results, results->frame, results->has_frame), "step", "head",
                   passes_json(results, results->step, results->has_step), "torso",
                   passes_json(results, results->torso_step, results->has_torso_step));
}
