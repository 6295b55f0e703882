/* SPDX-License-Identifier: MIT */
#include "session/rate_calibration.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bytes.h"
#include "session/progress.h"

enum { LOOK_FRAMES = 2, LOOK_TURNS = 3, LOOK_RUNGS = 10 };

static const double most_db = 100;   /* PSNR assigned to identical pictures */
static const double apart = 1 / 0.9; /* time ratio of neighbouring rungs: the precision with which a rate is held */

/* The most accurate first. Settings with a long preparation are not included. */
static const struct {
  float image_scale, transmittance_stop;
} ladder[LOOK_RUNGS] = {{1, 1e-4f},   {1, 0.03f},   {0.9f, 0.03f}, {0.8f, 0.03f}, {0.7f, 0.03f},
                        {0.6f, 0.1f}, {0.5f, 0.1f}, {0.4f, 0.1f},  {0.3f, 0.1f},  {0.25f, 0.1f}};

struct look {
  float *exact, *rgb; /* [LOOK_FRAMES][height][width][3] of the first rung; [height][width][3] */
  size_t values;      /* of a frame */
  double db[LOOK_RUNGS][LOOK_FRAMES], readings[LOOK_RUNGS][LOOK_TURNS];
  struct progress progress;
  uint64_t drawn; /* frames */
};

static struct settings settings_of(const struct rate_control *g) {
  const ern_render_options *render = &g->portrait->render;
  const ern_backend_info *info = &g->session->backend_info;
  const bool device = strcmp(info->name, "opencl") == 0;
  struct settings own = {.max_steps = render->max_steps,
                         .transmittance_stop = render->transmittance_stop,
                         .image_scale = 1,
                         .device = device ? g->session->device : 0,
                         .threads = device ? 0 : g->session->threads};
  snprintf(own.backend, sizeof own.backend, "%s", info->name);
  snprintf(own.isa, sizeof own.isa, "%s", device ? "" : info->isa);
  return own;
}

/* Rounds to readable values: the scale to hundredths, the transmittance to two digits. */
static struct rung rung_of(const struct settings *base, double image_scale, double transmittance_stop) {
  struct rung rung = {.settings = *base, .price = NAN};
  struct bytes name = {0};
  const double unit = pow(10, floor(log10(transmittance_stop)) - 1);
  rung.settings.image_scale = (float)(round(100 * image_scale) / 100);
  rung.settings.transmittance_stop = (float)(round(transmittance_stop / unit) * unit);
  settings_name(&rung.settings, base, "default", &name);
  snprintf(rung.name, sizeof rung.name, "%s", name.data != NULL ? name.data : "");
  bytes_free(&name);
  return rung;
}

static double decibels(const float *a, const float *b, size_t values) {
  double sum = 0;
  for (size_t i = 0; i < values; i++) sum += ((double)a[i] - (double)b[i]) * ((double)a[i] - (double)b[i]);
  return sum > 0 ? fmin(-10 * log10(sum / (double)values), most_db) : most_db;
}

static size_t frame_at(const struct rate_control *g, size_t f) {
  return g->frame_source->count > 1 ? (g->frame_source->count - 1) * (f + 1) / (LOOK_FRAMES + 1) : 0;
}

static void count_frames(struct look *look) {
  look->drawn += LOOK_FRAMES;
  progress_at(&look->progress, look->drawn, (uint64_t)LOOK_RUNGS * LOOK_FRAMES * (1 + LOOK_TURNS), "");
}

/* Renders the pictures first: this is also the warm-up. */
static int compare_all(struct rate_control *g, struct look *look, rate_control_draw *draw, void *user) {
  for (size_t i = 0; i < g->count; i++) {
    if (rung_make(g, &g->rung[i]) != 0) return EXIT_FAILURE;
    for (size_t f = 0; f < LOOK_FRAMES; f++) {
      float *rgb = i == 0 ? look->exact + f * look->values : look->rgb;
      if (draw(user, g->rung[i].renderer, frame_at(g, f), rgb) != 0) return EXIT_FAILURE;
      look->db[i][f] = decibels(rgb, look->exact + f * look->values, look->values);
    }
    count_frames(look);
  }
  return 0;
}

static int time_all(struct rate_control *g, struct look *look, rate_control_draw *draw, void *user) {
  for (size_t turn = 0; turn < LOOK_TURNS; turn++)
    for (size_t i = 0; i < g->count; i++) {
      const double began = session_seconds();
      if (session_interrupted()) return session_stop_with(g->session, "stopped, nothing was written");
      for (size_t f = 0; f < LOOK_FRAMES; f++)
        if (draw(user, g->rung[i].renderer, frame_at(g, f), NULL) != 0) return EXIT_FAILURE;
      look->readings[i][turn] = 1000 * (session_seconds() - began) / LOOK_FRAMES;
      count_frames(look);
    }
  return 0;
}

/* Whether another rung is as fast and as accurate; of two equal rungs the later one is removed. Two frames are too few
 * for a test of significance, so mean qualities are compared. */
static bool is_dominated(const struct rate_control *g, size_t i) {
  for (size_t k = 0; k < g->count; k++) {
    const struct rung *a = &g->rung[k], *b = &g->rung[i];
    if (k != i && a->ms <= b->ms && a->db >= b->db && (a->ms < b->ms || a->db > b->db || k < i)) return true;
  }
  return false;
}

static int by_accuracy(const void *left, const void *right) {
  const struct rung *a = left, *b = right;
  return (a->db < b->db) - (a->db > b->db);
}

static void keep_useful(struct rate_control *g, struct look *look) {
  bool out[LOOK_RUNGS];
  size_t kept = 0;
  for (size_t i = 0; i < g->count; i++) {
    g->rung[i].ms = fmax(quartiles_of(look->readings[i], LOOK_TURNS).median, 1e-3); /* a clock may stand still */
    g->rung[i].db = mean_of(look->db[i], LOOK_FRAMES).mean;
  }
  for (size_t i = 0; i < g->count; i++) out[i] = is_dominated(g, i);
  for (size_t i = 0; i < g->count; i++) {
    const struct rung rung = g->rung[i];
    g->rung[i].renderer = NULL;
    if (out[i])
      ern_renderer_free(&(ern_renderer *){rung.renderer});
    else
      g->rung[kept++] = rung;
  }
  g->count = kept;
  qsort(g->rung, g->count, sizeof *g->rung, by_accuracy);
}

static double between(double from, double to, double share) { return from * pow(to / from, share); }

/* Adds rungs between neighbours that are too far apart: scale, transmittance and time are interpolated in equal ratios,
 * because the time follows a power of the scale; the quality in equal steps. */
static void fill_gaps(struct rate_control *g, const struct settings *base) {
  struct rung measured[LOOK_RUNGS];
  const size_t count = g->count;
  memcpy(measured, g->rung, count * sizeof *measured);
  const double spaces = (double)(RATE_CONTROL_RUNGS - count), range = log(measured[0].ms / measured[count - 1].ms);
  const double step = fmax(log(apart), range / spaces);
  g->count = 0;
  for (size_t i = 0; i < count; i++) {
    const struct rung *from = &measured[i], *to = from + 1;
    g->rung[g->count++] = *from;
    const size_t parts = i + 1 < count ? (size_t)ceil(log(from->ms / to->ms) / step) : 1;
    for (size_t part = 1; part < parts; part++) {
      const double share = (double)part / (double)parts;
      struct rung rung =
          rung_of(base, between((double)from->settings.image_scale, (double)to->settings.image_scale, share),
                  between((double)from->settings.transmittance_stop, (double)to->settings.transmittance_stop, share));
      rung.ms = between(from->ms, to->ms, share);
      rung.db = from->db + share * (to->db - from->db);
      g->rung[g->count++] = rung;
    }
  }
}

int rate_control_calibrate(struct rate_control *g, struct dimensions size, rate_control_draw *draw, void *user) {
  struct look look = {.values = 3 * (size_t)size.width * (size_t)size.height};
  const struct settings base = settings_of(g);
  for (g->count = 0; g->count < LOOK_RUNGS; g->count++)
    g->rung[g->count] =
        rung_of(&base, (double)ladder[g->count].image_scale, (double)ladder[g->count].transmittance_stop);
  session_note(g->session, "%s: measures the cost of the settings briefly; `ernerf tradeoff` measures it better, once",
               g->session->verb);
  progress_begin(&look.progress, g->session, "speed", "frames");
  look.exact = malloc(LOOK_FRAMES * look.values * sizeof(float));
  look.rgb = malloc(look.values * sizeof(float));
  int status = look.exact != NULL && look.rgb != NULL
                   ? compare_all(g, &look, draw, user)
                   : session_fail_with(g->session, "no memory for pictures of %d x %d", size.width, size.height);
  if (status == 0) status = time_all(g, &look, draw, user);
  if (status == 0) {
    keep_useful(g, &look);
    fill_gaps(g, &base);
  }
  progress_end(&look.progress);
  free(look.exact);
  free(look.rgb);
  return status;
}
