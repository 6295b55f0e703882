/* SPDX-License-Identifier: MIT */
#include "session/rate_control.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "session/rate_calibration.h"

enum { QUALITY_EXACT, QUALITY_BALANCED, QUALITY_DRAFT };
static const double balanced_db = 40; /* least PSNR of "balanced" against the exact render; RMS 2.5 of 255 */

void rate_control_options(struct rate_control *g, struct option options[RATE_CONTROL_OPTIONS]) {
  g->quality = -1;
  const struct option rows[] = {
      {ARGS_FLOAT("hold-fps", &g->hold_fps, 0.01, 10000),
       .help = "choose the most accurate settings that render X frames a second or more, and adjust them while "
               "rendering (live without --quality: 1.15 times --fps)"},
      {ARGS_CHOICE("quality", &g->quality, "exact|balanced|draft"),
       .help = "settings that do not change: exact: the most accurate; balanced: the fastest whose frames have a "
               "PSNR of 40 dB or more against the exact render or, without a file of tradeoff, against those of exact; "
               "draft: the fastest"},
      {ARGS_TEXT("front", &g->front), .seldom = true, .choices = "FILE.json",
       .help = "file of an earlier `ernerf tradeoff` with the settings and their times (default MODEL without its "
               "ending + .tradeoff/tradeoff.json; without one a few frames are measured at the start)"}};
  ARGS_FILL(options, rows, RATE_CONTROL_OPTIONS);
}

bool rate_control_asked(const struct rate_control *g) { return g->hold_fps > 0 || g->quality >= 0; }

int rate_control_check(const struct rate_control *g, const struct args *args) {
  int status = -1;
  if (!rate_control_asked(g))
    return g->front != NULL ? args_refuse(args, "--set front needs --hold-fps or --quality") : -1;
  if (g->hold_fps > 0 && g->quality >= 0) return args_refuse(args, "--hold-fps and --quality: expected one of them");
  status = args_forbid(args, "max-steps transmittance-stop occupancy-threshold image-scale",
                       "is what --hold-fps and --quality choose");
  if (status < 0)
    status = args_forbid(args, "smooth-lips", "makes a frame depend on earlier frames, which may have other settings");
  if (status < 0 && g->front != NULL)
    status = args_forbid(args, "backend isa threads device", "is part of the settings in the file of --set front");
  return status;
}

/* ---- renderers --------------------------------------------------------------------------------------------------- */

void rate_control_close(struct rate_control *g) {
  for (size_t i = 0; i < RATE_CONTROL_RUNGS; i++) ern_renderer_free(&g->rung[i].renderer);
  for (size_t i = 0; i < g->units; i++) ern_backend_free(&g->unit[i].made);
}

/* ---- a stored front ---------------------------------------------------------------------------------------------- */

/* The path of MODEL's own front: MODEL without its extension, then .tradeoff/tradeoff.json. */
static bool own_front(const struct rate_control *g, char path[4096]) {
  const char *model = g->portrait->model_path, *slash = strrchr(model, '/'), *dot = strrchr(model, '.');
  const size_t stem =
      dot != NULL && dot > model && (slash == NULL || dot > slash + 1) ? (size_t)(dot - model) : strlen(model);
  return snprintf(path, 4096, "%.*s.tradeoff/tradeoff.json", (int)stem, model) < 4096 && access(path, R_OK) == 0;
}

enum { MOST_CORES = 256 }; /* as ern_backend_info.threads, which `tradeoff` writes */

struct machine {
  char cpu[PARETO_NAME_BYTES];
  int cores;
};
static void take_cpu(void *user, const ern_device_info *device) {
  struct machine *machine = user;
  if (strcmp(device->kind, "cpu") != 0) return;
  snprintf(machine->cpu, sizeof machine->cpu, "%s", device->name);
  machine->cores = device->compute_units < MOST_CORES ? (int)device->compute_units : MOST_CORES;
}

/* Tells in `why` if the front belongs to another model, machine or size; "": it matches. */
static int compare(struct rate_control *g, const struct pareto_front *front, struct dimensions size, char why[256]) {
  struct machine machine = {0};
  char sha256[65];
  if (ern_file_sha256(g->session->context, g->portrait->model_path, sha256) != ERN_OK ||
      ern_devices_list(g->session->context, take_cpu, &machine) != ERN_OK)
    return session_fail(g->session);
  why[0] = 0;
  if (strcmp(front->model_sha256, sha256) != 0)
    snprintf(why, 256, "it was measured with another model (%.12s..., this one is %.12s...)", front->model_sha256,
             sha256);
  else if (strcmp(front->cpu, machine.cpu) != 0 || front->cores != machine.cores)
    snprintf(why, 256, "it was measured on another machine (%.80s, %d cores)", front->cpu, front->cores);
  else if (front->width != size.width || front->height != size.height)
    snprintf(why, 256, "it was measured at %d x %d, the output is %d x %d", front->width, front->height, size.width,
             size.height);
  return 0;
}

/* Takes the front's points as rungs, the most accurate first. If there are too many, repeatedly removes the faster one
 * of the two neighbours nearest in time. */
static void take_front(struct rate_control *g, struct pareto_front *front) {
  double best = -INFINITY;
  while (front->count > RATE_CONTROL_RUNGS) {
    size_t nearest = 1;
    for (size_t i = 1; i + 1 < front->count; i++)
      if (front->points[i].ms.median / front->points[i - 1].ms.median <
          front->points[nearest].ms.median / front->points[nearest - 1].ms.median)
        nearest = i;
    memmove(front->points + nearest, front->points + nearest + 1, (front->count - nearest - 1) * sizeof *front->points);
    front->count--;
  }
  for (size_t i = 0; i < front->count; i++) best = fmax(best, front->points[i].clip_db);
  for (size_t i = front->count; i > 0; i--) {
    const struct pareto_point *point = &front->points[i - 1];
    struct rung *rung = &g->rung[g->count++];
    *rung = (struct rung){
        .settings = point->settings, .ms = point->ms.median, .db = point->exact_db, .price = best - point->clip_db};
    snprintf(rung->name, sizeof rung->name, "%s", point->name);
  }
}

/* *found: rungs were taken from the front. A front given by --set front must match; MODEL's own is ignored if it does
 * not match. */
static int read_front(struct rate_control *g, struct dimensions size, bool *found) {
  struct pareto_front front = {0};
  char why[256] = "";
  *found = false;
  int status = session_check_not_input(g->session, g->source, g->session->json);
  if (status == 0) status = pareto_read(&front, g->session, g->source);
  if (status == 0) status = compare(g, &front, size, why);
  if (status == 0 && why[0] != 0 && g->front != NULL) status = session_fail_with(g->session, "%s: %s", g->source, why);
  if (status == 0 && why[0] != 0) session_note(g->session, "%s is not used: %s", g->source, why);
  if (status == 0 && why[0] == 0) {
    take_front(g, &front);
    *found = true;
  }
  pareto_free(&front);
  return status;
}

static void take_like(struct rate_control *g) {
  memcpy(g->rung, g->like->rung, sizeof g->rung);
  g->count = g->like->count;
  memcpy(g->source, g->like->source, sizeof g->source);
  for (size_t i = 0; i < RATE_CONTROL_RUNGS; i++) {
    g->rung[i].renderer = NULL;
    g->rung[i].frames = 0;
  }
}

/* ---- choosing ---------------------------------------------------------------------------------------------------- */

/* Keeps only the rung that --quality names. */
static void keep_quality(struct rate_control *g) {
  size_t at = g->quality == QUALITY_DRAFT ? g->count - 1 : 0;
  if (g->quality == QUALITY_BALANCED)
    while (at + 1 < g->count && g->rung[at + 1].db >= balanced_db) at++;
  for (size_t i = 0; i < g->count; i++)
    if (i != at) ern_renderer_free(&g->rung[i].renderer);
  g->rung[0] = g->rung[at];
  if (at > 0) g->rung[at].renderer = NULL;
  g->count = 1;
}

static double budget_of(const struct rate_control *g) {
  return g->hold_fps > 0 ? 1000 / (double)g->hold_fps : INFINITY;
}

static int refuse_budget(const struct rate_control *g) {
  const struct rung *last = &g->rung[g->count - 1];
  return session_fail_with(
      g->session,
      "--hold-fps %g: no settings reach it on this machine: the fastest, \"%s\", take %.1f ms a frame, %.1f frames a "
      "second",
      (double)g->hold_fps, last->name, last->ms, 1000 / last->ms);
}

static void say_choice(const struct rate_control *g) {
  const struct rung *rung = &g->rung[g->controller.at];
  char price[96] = "";
  if (isfinite(rung->price))
    snprintf(price, sizeof price, ", %.2f dB less than the best against the clip's frames", rung->price);
  session_note(g->session, "%s: settings \"%s\": %.1f ms a frame, PSNR %s%.1f dB against %s%s (%s)", g->session->verb,
               rung->name, rung->ms, rung->db >= 100 ? "over " : "", rung->db,
               g->source[0] != 0 ? "the exact render" : "the most accurate", price,
               g->source[0] != 0 ? g->source : "measured now");
}

int rate_control_open(struct rate_control *g, struct session *session, const struct args *args,
                      const struct portrait *portrait, const struct frame_source *frame_source,
                      const ern_features *features, struct dimensions size, rate_control_draw *draw, void *user) {
  const bool measures =
      g->no_stored_front || args_given(args, "isa") || args_given(args, "threads") || args_given(args, "backend");
  bool found = false;
  int status = 0;
  g->session = session;
  g->portrait = portrait;
  g->frame_source = frame_source;
  g->features = features;
  if (g->like != NULL) take_like(g);
  found = g->like != NULL;
  if (!found && g->front != NULL) snprintf(g->source, sizeof g->source, "%s", g->front);
  if (!found && (g->front != NULL || (!measures && own_front(g, g->source)))) status = read_front(g, size, &found);
  if (status == 0 && !found) {
    g->source[0] = 0;
    status = rate_control_calibrate(g, size, draw, user);
  }
  if (status != 0) return status;
  if (g->quality >= 0 && g->like == NULL) keep_quality(g);
  for (size_t i = 0; i < g->count; i++) g->cost[i] = g->rung[i].ms;
  ern_rate_controller_begin(&g->controller, g->cost, g->count, budget_of(g));
  if (!ern_rate_controller_holds(&g->controller) && !g->warns_if_unreachable) return refuse_budget(g);
  if (!ern_rate_controller_holds(&g->controller))
    session_warn(session,
                 "no settings reach %.4g frames a second on this machine: the fastest, \"%s\", take %.1f ms a frame",
                 1000 / budget_of(g), g->rung[g->count - 1].name, g->rung[g->count - 1].ms);
  /* created before live frames begin: the first, and those that are slow to create; others take only a copy of the
   * model */
  for (size_t i = g->controller.at > 0 ? g->controller.at - 1 : 0; i < g->count; i++)
    if ((i == g->controller.at || g->rung[i].settings.occupancy_threshold > 0) && rung_make(g, &g->rung[i]) != 0)
      return EXIT_FAILURE;
  say_choice(g);
  return 0;
}

/* ---- drawing ----------------------------------------------------------------------------------------------------- */

ern_renderer *rate_control_renderer(struct rate_control *g) {
  struct rung *rung = &g->rung[g->controller.at];
  rung->frames++;
  return rung_make(g, rung) == 0 ? rung->renderer : NULL;
}

double rate_control_least(const struct rate_control *g, int cores) {
  const struct rung *last = &g->rung[g->count - 1];
  return last->ms * (last->settings.threads > 0 ? last->settings.threads : cores);
}

const char *rate_control_name(const struct rate_control *g) { return g->rung[g->controller.at].name; }

void rate_control_took(struct rate_control *g, double ms) {
  const size_t before = g->controller.at;
  g->changes += ern_rate_controller_next(&g->controller, ms) != before;
}

void rate_control_late(struct rate_control *g, double ms) { g->controller.late = ms > 0 ? ms : 0; }

void rate_control_summary(const struct rate_control *g, double ms_per_frame) {
  for (size_t i = 0; i < g->count; i++)
    if (g->rung[i].frames > 0)
      session_note(g->session, "%s: %zu frames with \"%s\", PSNR %.1f dB", g->session->verb, g->rung[i].frames,
                   g->rung[i].name, g->rung[i].db);
  const double budget = budget_of(g);
  if (isfinite(budget) && ms_per_frame > 1.1 * budget)
    session_warn(g->session,
                 "asked for %.1f ms a frame, reached %.1f: the machine became slower, and faster settings did not make "
                 "up for it",
                 budget, ms_per_frame);
}

json_t *rate_control_json(const struct rate_control *g) {
  json_t *rungs = json_array();
  for (size_t i = 0; i < g->count; i++) {
    const struct rung *rung = &g->rung[i];
    json_array_append_new(rungs,
                          json_pack("{s:s, s:o, s:f, s:f, s:o, s:I}", "name", rung->name, "settings",
                                    settings_json(&rung->settings), "ms", rung->ms, "psnr_db", rung->db, "price_db",
                                    session_number(rung->price), "frames", (json_int_t)rung->frames));
  }
  return json_pack("{s:o, s:o, s:I, s:o}", "budget_ms", session_number(budget_of(g)), "front", session_text(g->source),
                   "changes", (json_int_t)g->changes, "settings", rungs);
}
