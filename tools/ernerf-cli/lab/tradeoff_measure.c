/* SPDX-License-Identifier: MIT */
#include "lab/tradeoff_measure.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lab/tradeoff_points.h"
#include "session/progress.h"

/* EXACT_STEPS: the largest number of samples a ray with the same step length as 16, the value of training. */
enum { DEFAULT_FRAMES = 4, EXACT_STEPS = 128, LEAST_FRAMES = 2, PLANNED_TURNS = 6, LEAST_CHOICES = 3 };

static const double most_db = 100; /* PSNR assigned to an identical picture */
/* Share of the time for single changes and their turns; the rest is for combinations. */
static const double single_share = 0.75;

/* ---- renderers --------------------------------------------------------------------------------------------------- */

static int backend_of(struct tradeoff *t, const struct settings *settings, ern_backend **backend) {
  for (size_t i = 0; i < t->unit_count; i++) {
    struct unit *unit = &t->units[i];
    if (strcmp(unit->backend, settings->backend) != 0 || strcmp(unit->isa, settings->isa) != 0) continue;
    ern_backend_config config = ern_backend_config_default();
    config.name = unit->backend;
    config.isa = unit->isa[0] != 0 ? unit->isa : NULL;
    config.device = unit->device;
    config.deterministic = t->session.deterministic;
    if (unit->made == NULL && ern_backend_create(&unit->made, t->session.context, &config) != ERN_OK)
      return session_fail(&t->session);
    *backend = unit->made;
    return 0;
  }
  return session_fail_with(&t->session, "no backend was opened as %s %s", settings->backend, settings->isa);
}

static int make_renderer(struct tradeoff *t, const struct settings *settings, ern_renderer **renderer) {
  ern_render_options options = t->portrait.render;
  ern_backend *backend = NULL;
  settings_apply(settings, &options);
  if (backend_of(t, settings, &backend) != 0) return EXIT_FAILURE;
  if (ern_renderer_create(renderer, backend, t->portrait.model, &options) != ERN_OK) return session_fail(&t->session);
  struct portrait thinned = t->portrait;
  thinned.renderer = *renderer;
  thinned.occupancy_threshold = settings->occupancy_threshold;
  return portrait_prune_occupancy(&thinned, &t->session, &t->speech, t->evaluation.features);
}

int tradeoff_measure_draw(struct tradeoff *t, struct point *point, size_t k) {
  struct evaluated evaluated;
  if (point->renderer == NULL) {
    const double began = session_seconds();
    if (make_renderer(t, &point->settings, &point->renderer) != 0) return EXIT_FAILURE;
    point->prepared = 1000 * (session_seconds() - began);
  }
  t->evaluation.bytes_alone = false;
  return evaluate_draw(&t->evaluation, point->renderer, t->portrait.model, k, &evaluated);
}

/* ---- truths ------------------------------------------------------------------------------------------------------ */

/* PSNR in dB of a mean squared error. */
static double decibels(double error) { return error > 0 ? fmin(-10 * log10(error), most_db) : most_db; }

/* Draws the exact frames in double with the reference kernels, the slowest: each frame once. */
static int draw_exact(struct tradeoff *t) {
  const size_t values = 3 * tradeoff_pixels(t), frames = tradeoff_frames(t);
  struct settings exact = t->base;
  struct progress progress;
  struct evaluated evaluated;
  ern_renderer *renderer = NULL;
  int status = 0;
  exact.max_steps = EXACT_STEPS;
  exact.transmittance_stop = exact.occupancy_threshold = 0;
  exact.image_scale = 1;
  exact.threads = t->cores;
  snprintf(exact.backend, sizeof exact.backend, "cpu");
  snprintf(exact.isa, sizeof exact.isa, "ref64");
  const double began = session_seconds();
  t->exact = malloc(frames * values * sizeof(float));
  if (t->exact == NULL) return session_fail_with(&t->session, "no memory for %zu exact frames", frames);
  progress_begin(&progress, &t->session, "exact", "frames");
  if (make_renderer(t, &exact, &renderer) != 0) status = EXIT_FAILURE;
  for (size_t k = 0; status == 0 && k < frames; k++) {
    status = session_interrupted() ? session_stop_with(&t->session, "stopped, nothing was written")
                                   : evaluate_draw(&t->evaluation, renderer, t->portrait.model, k, &evaluated);
    memcpy(t->exact + k * values, t->evaluation.rgb, values * sizeof(float));
    progress_at(&progress, k + 1, frames, "");
  }
  progress_end(&progress);
  ern_renderer_free(&renderer);
  t->exact_seconds = session_seconds() - began;
  return status;
}

/* Computes the PSNR of every frame against both references. */
static int evaluate_point(struct tradeoff *t, struct point *point) {
  const size_t values = 3 * tradeoff_pixels(t), frames = tradeoff_frames(t);
  point->error = point->worst = 0;
  for (size_t k = 0; k < frames; k++) {
    const struct source_frame *source_frame = &t->evaluation.frame_source.source_frame[k];
    const float *exact = t->exact + k * values;
    ern_image truth = {0};
    double sum = 0;
    if (session_interrupted()) return session_stop_with(&t->session, "stopped, nothing was written");
    if (tradeoff_measure_draw(t, point, k) != 0) return EXIT_FAILURE;
    if (ern_clip_pixels(t->evaluation.clip, source_frame->split, source_frame->index, &truth, NULL) != ERN_OK)
      return session_fail(&t->session);
    for (size_t i = 0; i < values; i++) {
      const double off = fabs((double)t->evaluation.rgb[i] - (double)exact[i]);
      sum += off * off;
      point->worst = fmax(point->worst, off);
    }
    point->db[REFERENCE_EXACT][k] = decibels(sum / (double)values);
    point->db[REFERENCE_CLIP][k] = ern_psnr(t->evaluation.rgb, truth.data, truth.width, truth.height, NULL);
    point->error += sum / (double)values / (double)frames;
  }
  return 0;
}

/* ---- the clock --------------------------------------------------------------------------------------------------- */

/* Times the frames, to 8-bit pixels. *ms: the mean in milliseconds. */
static int read_clock(struct tradeoff *t, struct point *point, double *ms) {
  const size_t frames = tradeoff_frames(t);
  struct evaluated evaluated;
  t->evaluation.bytes_alone = true;
  *ms = 0;
  for (size_t k = 0; k < frames; k++) {
    if (session_interrupted()) return session_stop_with(&t->session, "stopped, nothing was written");
    if (evaluate_draw(&t->evaluation, point->renderer, t->portrait.model, k, &evaluated) != 0) return EXIT_FAILURE;
    *ms += evaluated.ms / (double)frames;
  }
  return 0;
}

static int add_point(struct tradeoff *t, const struct settings *settings) {
  struct bytes name = {0};
  struct point *point = &t->points[t->count];
  *point = (struct point){.settings = *settings, .changes = settings_changes(settings, &t->base)};
  settings_name(settings, &t->base, t->base_name, &name);
  snprintf(point->name, sizeof point->name, "%s", name.data != NULL ? name.data : "");
  bytes_free(&name);
  t->count++;
  if (evaluate_point(t, point) != 0) return EXIT_FAILURE;
  return read_clock(t, point, &point->first_ms);
}

/* Expected time of a turn of all points, milliseconds. */
static double turn_ms(const struct tradeoff *t) {
  double sum = 0;
  for (size_t i = 0; i < t->count; i++) sum += t->points[i].first_ms * (double)tradeoff_frames(t);
  return sum;
}

/* Tries the base and single changes: the first few always, the others while their turns will end before `until`. */
static int try_choices(struct tradeoff *t, double until, struct effect *effects, size_t *effect_count) {
  struct choice choices[TRADEOFF_POINTS_CHOICES];
  const size_t count = tradeoff_points_choices(t, choices);
  struct progress progress;
  *effect_count = 0;
  progress_begin(&progress, &t->session, "look", "settings");
  if (add_point(t, &t->base) != 0) return EXIT_FAILURE;
  const struct point *base = &t->points[0];
  for (size_t i = 0; i < count; i++) {
    if (i >= LEAST_CHOICES && session_seconds() + PLANNED_TURNS * turn_ms(t) / 1000 >= until) {
      t->not_reached[0] = count - i;
      break;
    }
    const struct settings settings = settings_with(t->base, &choices[i]);
    if (add_point(t, &settings) != 0) return EXIT_FAILURE;
    const struct point *point = &t->points[t->count - 1];
    effects[(*effect_count)++] =
        (struct effect){choices[i], point->first_ms / base->first_ms, point->error - base->error};
    progress_at(&progress, i + 1, count, point->name);
  }
  progress_end(&progress);
  return 0;
}

/* Expected time to create a renderer with these settings, milliseconds. The search for cells of low density takes most
 * of it. */
static double preparing_ms(const struct tradeoff *t, const struct settings *settings) {
  double most = 0;
  for (size_t i = 0; i < t->count; i++)
    if (t->points[i].settings.occupancy_threshold == settings->occupancy_threshold)
      most = fmax(most, t->points[i].prepared);
  return most;
}

/* Tries combinations while there is time for their turns. */
static int try_combinations(struct tradeoff *t, double until, const struct effect *effects, size_t effect_count) {
  struct settings found[TRADEOFF_POINTS_COMBINATIONS];
  double ms[TRADEOFF_POINTS_COMBINATIONS];
  const struct point *base = &t->points[0];
  const size_t count = tradeoff_points_combine(&t->base, base->first_ms, base->error, effects, effect_count, found, ms);
  struct progress progress;
  progress_begin(&progress, &t->session, "combine", "settings");
  for (size_t i = 0; i < count; i++) {
    const double left = 1000 * (until - session_seconds());
    const double needed = PLANNED_TURNS * turn_ms(t) + preparing_ms(t, &found[i]) +
                          (PLANNED_TURNS + 2) * ms[i] * (double)tradeoff_frames(t);
    if (needed > left || t->count == TRADEOFF_POINTS) {
      t->not_reached[1] = count - i;
      break;
    }
    if (add_point(t, &found[i]) != 0) return EXIT_FAILURE;
    progress_at(&progress, i + 1, count, t->points[t->count - 1].name);
  }
  progress_end(&progress);
  return 0;
}

/* Shuffles (Fisher and Yates); the low bits of a linear congruential generator are the weak ones. */
static void shuffle(size_t *order, size_t count, uint64_t *seed) {
  for (size_t i = count; i > 1; i--) {
    *seed = *seed * 6364136223846793005u + 1442695040888963407u;
    const size_t k = (size_t)(*seed >> 33) % i, was = order[i - 1];
    order[i - 1] = order[k];
    order[k] = was;
  }
}

/* Times all points in turns, each turn in a random order, so that a change of the machine's speed affects all points
 * equally and the readings of one point are spread in time. */
static int take_turns(struct tradeoff *t, double until) {
  const double began = session_seconds();
  double sorted[TRADEOFF_TURNS];
  size_t order[TRADEOFF_POINTS];
  uint64_t seed = 0;
  for (size_t i = 0; i < t->count; i++) order[i] = i;
  struct progress progress;
  progress_begin(&progress, &t->session, "turns", "s");
  for (size_t turn = 0; turn < TRADEOFF_TURNS; turn++) {
    const double now = session_seconds();
    if (turn >= TRADEOFF_LEAST && now + (now - began) / (double)turn > until) break;
    shuffle(order, t->count, &seed);
    for (size_t i = 0; i < t->count; i++) {
      struct point *point = &t->points[order[i]];
      if (read_clock(t, point, &point->readings[turn]) != 0) return EXIT_FAILURE;
      const double spent = session_seconds() - began, all = fmax(until - began, spent + 0.1);
      progress_at(&progress, (uint64_t)(1 + spent), (uint64_t)(2 + all), "");
    }
    t->turns = turn + 1;
  }
  progress_end(&progress);
  for (size_t i = 0; i < t->count; i++) {
    t->points[i].turns = t->turns;
    memcpy(sorted, t->points[i].readings, t->turns * sizeof *sorted);
    t->points[i].ms = quartiles_of(sorted, t->turns);
  }
  return 0;
}

static void find_fronts(struct tradeoff *t) {
  struct candidate candidates[TRADEOFF_POINTS];
  struct place places[TRADEOFF_POINTS];
  for (int reference = 0; reference < TRUTHS; reference++) {
    for (size_t i = 0; i < t->count; i++)
      candidates[i] = (struct candidate){.ms = t->points[i].ms,
                                         .turns = t->points[i].readings,
                                         .turn_count = t->points[i].turns,
                                         .db = t->points[i].db[reference],
                                         .changes = t->points[i].changes};
    pareto_find(places, candidates, t->count, tradeoff_frames(t));
    for (size_t i = 0; i < t->count; i++) t->points[i].place[reference] = places[i];
  }
}

size_t tradeoff_front(const struct tradeoff *t, enum reference reference, size_t order[TRADEOFF_POINTS]) {
  size_t count = 0;
  for (size_t i = 0; i < t->count; i++) {
    if (t->points[i].place[reference].standing != STANDING_FRONT) continue;
    size_t at = count++;
    for (; at > 0 && t->points[order[at - 1]].ms.median > t->points[i].ms.median; at--) order[at] = order[at - 1];
    order[at] = i;
  }
  return count;
}

int tradeoff_measure_all(struct tradeoff *t) {
  struct effect effects[TRADEOFF_POINTS_CHOICES];
  size_t effect_count = 0;
  const double began = session_seconds(), budget = (double)t->seconds;
  t->points = calloc(TRADEOFF_POINTS, sizeof *t->points);
  if (t->points == NULL) return session_fail_with(&t->session, "no memory for %d points", TRADEOFF_POINTS);
  int status = draw_exact(t);
  /* points get at least half of the time, even if the exact frames took long */
  const double now = session_seconds(), until = fmax(began + budget, now + budget / 2);
  if (status == 0) status = try_choices(t, now + single_share * (until - now), effects, &effect_count);
  if (status == 0) status = try_combinations(t, until, effects, effect_count);
  if (status == 0) status = take_turns(t, until);
  if (status != 0) return status;
  find_fronts(t);
  t->spent_seconds = session_seconds() - began;
  return 0;
}

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static void add_unit(struct tradeoff *t, const char *backend, const char *isa, int device) {
  for (size_t i = 0; i < t->unit_count; i++)
    if (strcmp(t->units[i].backend, backend) == 0 && strcmp(t->units[i].isa, isa) == 0) return;
  if (t->unit_count == TRADEOFF_UNITS) return;
  struct unit *unit = &t->units[t->unit_count++];
  *unit = (struct unit){.device = device};
  snprintf(unit->backend, sizeof unit->backend, "%s", backend);
  snprintf(unit->isa, sizeof unit->isa, "%s", isa);
}

static void look_at_device(void *user, const ern_device_info *device) {
  struct tradeoff *t = user;
  if (strcmp(device->kind, "cpu") == 0) {
    snprintf(t->cpu, sizeof t->cpu, "%s", device->name);
    snprintf(t->instruction_sets, sizeof t->instruction_sets, "%s", device->instruction_sets);
  } else if (t->session.backend_choice == SESSION_OPENCL && device->number == t->session.device) {
    snprintf(t->device_name, sizeof t->device_name, "%s", device->name);
  }
}

/* Finds all compute units of this machine except the reference kernels, which are too slow to choose. */
static int find_units(struct tradeoff *t) {
  struct session *session = &t->session;
  const bool quiet = session->quiet;
  session->quiet = true; /* each backend would print its name */
  const ern_status status = ern_devices_list(session->context, look_at_device, t);
  session->quiet = quiet;
  if (status != ERN_OK) return session_fail(session);
  add_unit(t, t->base.backend, t->base.isa, t->base.device);
  for (const char *at = t->instruction_sets; *at != 0;) {
    const size_t bytes = strcspn(at, " ");
    char isa[24];
    snprintf(isa, sizeof isa, "%.*s", (int)bytes, at);
    if (strncmp(isa, "ref", 3) != 0) add_unit(t, "cpu", isa, 0);
    at += bytes + strspn(at + bytes, " ");
  }
  add_unit(t, "cpu", "ref64", 0); /* for the exact frames */
  return 0;
}

static int choose_frames(struct tradeoff *t, const struct args *args) {
  struct frame_source *frame_source = &t->evaluation.frame_source;
  if (args_given(args, "frames")) {
    const int status = portrait_cut(&t->portrait, &t->session, args, frame_source, t->evaluation.features);
    if (status != 0) return status;
    if (frame_source->count > TRADEOFF_FRAMES)
      return args_refuse(args, "--frames has %zu frames, expected %d at most: they are rendered with every setting",
                         frame_source->count, TRADEOFF_FRAMES);
  } else if (frame_source->count > DEFAULT_FRAMES) {
    for (size_t k = 0; k < DEFAULT_FRAMES; k++)
      frame_source->source_frame[k] = frame_source->source_frame[(frame_source->count - 1) * k / (DEFAULT_FRAMES - 1)];
    frame_source->count = DEFAULT_FRAMES;
  }
  if (frame_source->count >= LEAST_FRAMES) return 0;
  return session_fail_with(
      &t->session, "%zu frame is too few to compare settings, expected %d or more: --split train or all has more",
      frame_source->count, LEAST_FRAMES);
}

int tradeoff_measure_open(struct tradeoff *t, const struct args *args) {
  const ern_render_options *render = &t->portrait.render;
  const ern_backend_info *info = &t->session.backend_info;
  const bool device = strcmp(info->name, "opencl") == 0;
  t->cores = info->threads;
  t->base = (struct settings){.max_steps = render->max_steps,
                              .transmittance_stop = render->transmittance_stop,
                              .occupancy_threshold = t->portrait.occupancy_threshold,
                              .image_scale = render->image_scale,
                              .device = device ? t->session.device : 0,
                              .threads = device                   ? 0
                                         : t->session.threads > 0 ? t->session.threads
                                                                  : t->cores};
  snprintf(t->base.backend, sizeof t->base.backend, "%s", info->name);
  snprintf(t->base.isa, sizeof t->base.isa, "%s", device ? "" : info->isa);
  const bool asked = args_given(args, "max-steps") || args_given(args, "transmittance-stop") ||
                     args_given(args, "occupancy-threshold") || args_given(args, "image-scale") ||
                     args_given(args, "isa") || args_given(args, "threads") || device;
  t->base_name = asked ? "as asked" : "default";
  const int status = find_units(t);
  return status != 0 ? status : choose_frames(t, args);
}

void tradeoff_measure_close(struct tradeoff *t) {
  for (size_t i = 0; i < t->count; i++) ern_renderer_free(&t->points[i].renderer);
  for (size_t i = 0; i < t->unit_count; i++) ern_backend_free(&t->units[i].made);
  free(t->points);
  free(t->exact);
}
