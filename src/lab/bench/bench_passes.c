/* SPDX-License-Identifier: MIT
 * A frame and a training step, whole and by stage. They run on the instrumented backend of bench_shim.c, so
 * ern_renderer_frame and ern_trainer_step themselves are timed. */
#include <math.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "core/profile.h"
#include "core/status.h"
#include "lab/bench/bench_shared.h"
#include "train/trainer.h"

/* The pass of one backend. */
struct subject {
  struct ern_bench_shim *shim;
  bool device;
  const struct ern_bench_scene *scene;
  ern_bench_pass *pass;
  /* of a frame */
  ern_renderer *renderer;
  uint8_t *rgba;
  ern_frame_times times; /* sums over calls */
  /* of a step */
  struct ern_trainer *trainer;
  struct ern_bench_data data;
  double samples; /* sum over calls */
  size_t calls;
};

struct passes {
  struct subject subject[ERN_BENCH_BACKENDS];
  size_t count;
  bool sixteenth;
};

/* ---- stages ------------------------------------------------------------------------------------------------------ */

/* Stages of a fused pass, then those of the surrounding step. */
enum { STAGE_UPDATE = ERN_PROFILE_STAGES, STAGE_FUSED, STAGE_REFRESH, STAGE_NONE, STAGES };
static const char *const stage_name[] = {"march",    "encode", "forward", "composite",
                                         "backward", "tables", "update",  "fused"};
enum { APART = 3 /* calls of a device that wait for each slot, if they take less than a second */ };

/* The stage of a slot called in the head's section. Outside that section all slots but the update belong to the
 * refresh. */
static int stage_of(enum ern_bench_slot slot) {
  switch (slot) {
    case ERN_BENCH_SLOT_rays:
    case ERN_BENCH_SLOT_march:
    case ERN_BENCH_SLOT_scan:
    case ERN_BENCH_SLOT_samples:
    case ERN_BENCH_SLOT_sh_fwd:
    case ERN_BENCH_SLOT_torso_select:
    case ERN_BENCH_SLOT_torso_coords:
    case ERN_BENCH_SLOT_smooth_points: return ERN_PROFILE_MARCH;
    case ERN_BENCH_SLOT_grid_fwd: return ERN_PROFILE_ENCODE;
    case ERN_BENCH_SLOT_mlp_fwd:
    case ERN_BENCH_SLOT_activate_fwd:
    case ERN_BENCH_SLOT_freq_fwd:
    case ERN_BENCH_SLOT_audio_fwd:
    case ERN_BENCH_SLOT_attention_fwd:
    case ERN_BENCH_SLOT_torso_pose_fwd:
    case ERN_BENCH_SLOT_torso_deform_fwd: return ERN_PROFILE_FORWARD;
    case ERN_BENCH_SLOT_composite_fwd:
    case ERN_BENCH_SLOT_composite_bwd:
    case ERN_BENCH_SLOT_torso_composite_fwd:
    case ERN_BENCH_SLOT_torso_composite_bwd:
    case ERN_BENCH_SLOT_head_loss:
    case ERN_BENCH_SLOT_mse:
    case ERN_BENCH_SLOT_smooth_loss:
    case ERN_BENCH_SLOT_key_points_loss: return ERN_PROFILE_COMPOSITE;
    case ERN_BENCH_SLOT_mlp_bwd:
    case ERN_BENCH_SLOT_activate_bwd:
    case ERN_BENCH_SLOT_freq_bwd:
    case ERN_BENCH_SLOT_audio_bwd:
    case ERN_BENCH_SLOT_attention_bwd:
    case ERN_BENCH_SLOT_torso_pose_bwd:
    case ERN_BENCH_SLOT_torso_deform_bwd: return ERN_PROFILE_BACKWARD;
    case ERN_BENCH_SLOT_grid_bwd: return ERN_PROFILE_TABLES;
    case ERN_BENCH_SLOT_adamw:
    case ERN_BENCH_SLOT_ema:
    case ERN_BENCH_SLOT_finite: return STAGE_UPDATE;
    default: return STAGE_NONE;
  }
}

/* For a device: the only stages of a fused pass are the slots that it calls. The remaining time is a separate stage,
 * unless it is only the overhead of running stage by stage. */
static void fused_seconds(const struct subject *s, double seconds[STAGES]) {
  static const enum ern_bench_slot passes[] = {ERN_BENCH_SLOT_render_rays, ERN_BENCH_SLOT_head_step,
                                               ERN_BENCH_SLOT_torso_step};
  double whole = 0, parts = 0;
  for (size_t i = 0; i < sizeof passes / sizeof *passes; i++)
    whole += ern_bench_shim_seconds(s->shim, ERN_BENCH_HEAD, passes[i]);
  for (int i = 0; i < ERN_PROFILE_STAGES; i++) parts += seconds[i];
  s->pass->fused = whole - parts > parts;
  if (s->pass->fused) seconds[STAGE_FUSED] = whole - parts;
}

/* Seconds of all calls since the shim was cleared. If a fused pass has filled its profile, the profile is used. */
static void stage_seconds(const struct subject *s, double seconds[STAGES]) {
  const struct ern_profile *profile = ern_bench_shim_profile(s->shim);
  double filled = 0;
  for (int i = 0; i < STAGES; i++) seconds[i] = 0;
  for (int i = 0; i < ERN_PROFILE_STAGES; i++) filled += profile->seconds[i];
  s->pass->fused = filled > 0;
  for (int slot = 0; slot < ERN_BENCH_SLOTS; slot++) {
    const int stage = stage_of((enum ern_bench_slot)slot);
    const double outside = ern_bench_shim_seconds(s->shim, ERN_BENCH_OUTSIDE, (enum ern_bench_slot)slot);
    seconds[stage == STAGE_UPDATE ? STAGE_UPDATE : STAGE_REFRESH] += outside;
    if (!s->pass->fused) seconds[stage] += ern_bench_shim_seconds(s->shim, ERN_BENCH_HEAD, (enum ern_bench_slot)slot);
  }
  seconds[STAGE_REFRESH] += ern_bench_shim_seconds(s->shim, ERN_BENCH_DENSITY, ERN_BENCH_SLOT_head_density);
  for (int i = 0; i < ERN_PROFILE_STAGES && s->pass->fused; i++)
    seconds[i] = profile->seconds[i] / ern_bench_shim_threads(s->shim);
  if (s->device && filled <= 0) fused_seconds(s, seconds);
}

static void add_stage(ern_bench_pass *pass, const char *name, double seconds) {
  if (seconds > 0 && pass->stages < ERN_BENCH_STAGES)
    pass->stage[pass->stages++] = (ern_bench_stage){.name = name, .seconds = seconds};
}

/* ---- set-up ------------------------------------------------------------------------------------------------------ */

static void free_subject(struct subject *s, ern_context *context) {
  ern_renderer_free(&s->renderer);
  ern_trainer_free(&s->trainer);
  ern_release(context, s->rgba);
  ern_bench_shim_free(s->shim);
}

static ern_status make_renderer(struct subject *s, struct ern_backend *backend, const ern_bench_options *options) {
  const ern_camera *camera = &s->scene->frame.camera;
  ern_render_options render = ern_render_options_default();
  if (!s->device) render.threads = options->threads;
  ern_status status = ERN_NEW(backend->context, 4 * (size_t)camera->width * (size_t)camera->height, &s->rgba);
  if (status == ERN_OK)
    status = ern_renderer_create(&s->renderer, ern_bench_shim_backend(s->shim), s->scene->model, &render);
  return status;
}

static ern_status make_trainer(struct subject *s, const ern_bench_options *options, bool torso) {
  return ern_bench_trainer_make(&s->trainer, &s->data, ern_bench_shim_backend(s->shim), s->scene, torso, options->rays,
                                options->threads, options->seed);
}

/* Compares with the peaks of all threads. */
static void compute_share(ern_bench_pass *pass, const ern_bench_machine *machine, size_t index) {
  pass->share = (double)NAN;
  if (machine != NULL && index < machine->peaks && pass->flops > 0)
    pass->share = pass->flops / pass->seconds.least / machine->peak[index].flops.all;
}

/* Drops the sums of the cold calls so far. */
static void forget(void *user, size_t which) {
  struct passes *passes = user;
  struct subject *s = &passes->subject[which];
  ern_bench_shim_clear(s->shim);
  s->times = (ern_frame_times){0};
  s->samples = 0;
  s->calls = 0;
}

/* Calls each pass once, because a device builds its kernels at the first call. That can take so long that it would
 * count as a reading. */
static ern_status build(struct passes *passes, ern_status (*work)(void *user, size_t which, size_t times)) {
  ern_status status = ERN_OK;
  for (size_t k = 0; k < passes->count && status == ERN_OK; k++)
    if (passes->subject[k].device) status = work(passes, k, 1);
  return status;
}

/* Measures the stages of a device in calls after the timed ones, because waiting for each slot adds time. */
static ern_status call_apart(struct passes *passes, size_t which, const ern_bench_timing *timing,
                             ern_status (*work)(void *user, size_t which, size_t times)) {
  struct subject *s = &passes->subject[which];
  if (!s->device) return ERN_OK;
  forget(passes, which);
  ern_bench_shim_apart(s->shim, true);
  const ern_status status = work(passes, which, timing->least * APART < 1 ? APART : 1);
  ern_bench_shim_apart(s->shim, false);
  return status;
}

static struct subject begin_subject(ern_backend *backend, const struct ern_bench_scene *scene, ern_bench_pass *pass) {
  *pass = (ern_bench_pass){.backend = backend->name, .isa = backend->isa};
  return (struct subject){.device = ern_bench_is_device(backend), .scene = scene, .pass = pass};
}

/* ---- a frame ----------------------------------------------------------------------------------------------------- */

static ern_status draw(void *user, size_t which, size_t times) {
  struct passes *passes = user;
  struct subject *s = &passes->subject[which];
  ern_status status = ERN_OK;
  for (size_t k = 0; k < times && status == ERN_OK; k++) {
    const ern_frame_output output = {.rgba = s->rgba};
    ern_frame_times part;
    status = ern_renderer_frame(s->renderer, &s->scene->frame, &output, &part);
    if (status != ERN_OK) break;
    s->times.audio += part.audio;
    s->times.torso += part.torso;
    s->times.head += part.head;
    s->times.output += part.output;
    s->calls++;
  }
  return status == ERN_OK ? ern_bench_shim_finish(s->shim) : status;
}

static void sum_frame(struct subject *s) {
  const double n = (double)s->calls;
  ern_bench_pass *pass = s->pass;
  double seconds[STAGES];
  stage_seconds(s, seconds);
  add_stage(pass, "audio", s->times.audio * 1e-3 / n);
  add_stage(pass, "torso", s->times.torso * 1e-3 / n);
  for (int i = 0; i <= ERN_PROFILE_COMPOSITE; i++) add_stage(pass, stage_name[i], seconds[i] / n);
  add_stage(pass, stage_name[STAGE_FUSED], seconds[STAGE_FUSED] / n);
  add_stage(pass, "output", s->times.output * 1e-3 / n);
}

/* Counts the samples of a frame: from the profile of a fused pass; for a device's fused pass, which has none, from the
 * scene; stage by stage, all marched samples. */
static ern_status count_frame(struct subject *s) {
  const struct ern_profile *profile = ern_bench_shim_profile(s->shim);
  const struct ern_field *field = &s->scene->model->field;
  const struct ern_bench_cost written = ern_bench_cost_written(field), folded = ern_bench_cost_folded(field);
  const double n = (double)s->calls;
  ern_bench_pass *pass = s->pass;
  ern_bench_scene_info info = {.hits = 0};
  double hits = (double)profile->count[ERN_PROFILE_HITS] / n;
  pass->rays = (double)s->scene->frame.camera.width * s->scene->frame.camera.height;
  pass->marched = pass->evaluated = pass->colours = ern_bench_shim_marched(s->shim) / n;
  if (pass->fused && s->device) {
    const ern_status status = ern_bench_scene_count(s->scene, &info);
    if (status != ERN_OK) return status;
    pass->marched = (double)info.marched;
    pass->evaluated = pass->colours = (double)info.lit;
    hits = (double)info.hits;
  } else if (pass->fused) {
    pass->marched = (double)profile->count[ERN_PROFILE_MARCHED] / n;
    pass->evaluated = (double)profile->count[ERN_PROFILE_SAMPLES] / n;
    pass->colours = (double)profile->count[ERN_PROFILE_COLOURS] / n;
  }
  pass->flops_written = pass->evaluated * (written.density + written.colour) + pass->rays * written.ray;
  pass->flops = pass->flops_written;
  if (pass->fused) pass->flops = pass->evaluated * folded.density + pass->colours * folded.colour + hits * folded.ray;
  return ERN_OK;
}

ern_status ern_bench_frame(ern_backend *const *backends, size_t count, const ern_bench_scene *scene,
                           const ern_bench_machine *machine, const ern_bench_options *options,
                           ern_bench_pass *results) {
  ERN_PLAIN_FLOATS;
  ern_bench_options chosen;
  ern_bench_timing timing[ERN_BENCH_TURNS];
  struct passes passes = {.count = count};
  ern_status status = ern_bench_choose(backends, count, options, &chosen);
  if (status != ERN_OK) return status;
  ern_context *context = backends[0]->context;
  ERN_NEED(context, scene);
  ERN_NEED(context, results);
  const struct ern_bench_turns turns = {.work = draw,
                                        .warm = forget,
                                        .user = &passes,
                                        .count = count,
                                        .seconds = chosen.seconds,
                                        .most = chosen.frames < ERN_BENCH_REPEATS ? chosen.frames : ERN_BENCH_REPEATS};
  for (size_t k = 0; k < count; k++) {
    struct subject *s = &passes.subject[k];
    *s = begin_subject(backends[k], scene, &results[k]);
    ERN_TRY(ern_bench_shim_make(backends[k], false, &s->shim));
    ERN_TRY(make_renderer(s, backends[k], &chosen));
    results[k].threads = ern_bench_shim_threads(s->shim);
  }
  ERN_TRY(ern_bench_progress(context, &chosen, 0, 1));
  ERN_TRY(build(&passes, draw));
  ERN_TRY(ern_bench_take_turns(&turns, timing));
  for (size_t k = 0; k < count; k++) {
    results[k].seconds = timing[k];
    ERN_TRY(call_apart(&passes, k, &timing[k], draw));
    sum_frame(&passes.subject[k]);
    ERN_TRY(count_frame(&passes.subject[k]));
    compute_share(&results[k], machine, k);
  }
  status = ern_bench_progress(context, &chosen, 1, 1);
fail:
  for (size_t k = 0; k < count; k++) free_subject(&passes.subject[k], context);
  return status;
}

/* ---- a step ------------------------------------------------------------------------------------------------------ */

/* Runs step 1, or a step with a refresh (after the first refreshes, which visit all cells) and the smoothness term. */
static ern_status step(void *user, size_t which, size_t times) {
  struct passes *passes = user;
  struct subject *s = &passes->subject[which];
  struct ern_trainer *t = s->trainer;
  ern_train_report report;
  ern_status status = ERN_OK;
  for (size_t k = 0; k < times && status == ERN_OK; k++) {
    t->shared.step = passes->sixteenth ? ERN_REFRESH_WARM_UP : 1;
    /* Every backend steps with the batch that is drawn ahead for the next step, so all compute the same rays. One that
     * does not draw during a step draws here. */
    if (t->batches.drawn.step == 0) ern_trainer_draw_ahead(&t->batches);
    if (t->batches.drawn.step > 0) t->batches.drawn.step = t->shared.step;
    status = ern_trainer_step(t, &report);
    s->samples += report.samples_per_ray * t->shared.config.rays;
    s->calls++;
    if (status == ERN_OK && passes->sixteenth) status = ern_bench_trainer_restore(t, s->scene);
  }
  return status == ERN_OK ? ern_bench_shim_finish(s->shim) : status;
}

static void sum_plain_step(struct subject *s, bool torso) {
  const struct ern_field *field = &s->scene->model->field;
  const double n = (double)s->calls;
  ern_bench_pass *pass = s->pass;
  double seconds[STAGES];
  stage_seconds(s, seconds);
  for (int i = 0; i <= STAGE_FUSED; i++) add_stage(pass, stage_name[i], seconds[i] / n);
  pass->rays = s->trainer->shared.config.rays;
  pass->marched = pass->evaluated = pass->colours = s->samples / n;
  pass->flops_written =
      pass->evaluated * (torso ? ern_bench_cost_torso_step(field, false) : ern_bench_cost_head_step(field, false));
  pass->flops =
      pass->evaluated * (torso ? ern_bench_cost_torso_step(field, true) : ern_bench_cost_head_step(field, true));
}

/* Adds to a plain step its share of the extra work that only some steps do. */
static void add_sixteenth(struct subject *s, const ern_bench_timing *more, bool torso) {
  ern_bench_pass *pass = s->pass;
  double seconds[STAGES];
  stage_seconds(s, seconds);
  const double outside = seconds[STAGE_REFRESH] / (double)s->calls;
  const double refresh = outside / (double)ern_trainer_refresh_every(&s->trainer->shared);
  const double smooth = torso ? 0 : fmax(more->median - pass->seconds.median - outside, 0) / ERN_SMOOTH_EVERY;
  add_stage(pass, "refresh", refresh);
  add_stage(pass, "smoothness", smooth);
  pass->seconds.least += refresh + smooth;
  pass->seconds.median += refresh + smooth; /* the CPU time stays that of the plain step */
}

static ern_status take_steps(struct passes *passes, bool sixteenth, double seconds, ern_bench_timing *timing) {
  const struct ern_bench_turns turns = {.work = step,
                                        .warm = forget,
                                        .user = passes,
                                        .count = passes->count,
                                        .seconds = seconds,
                                        .most = ERN_BENCH_REPEATS};
  passes->sixteenth = sixteenth;
  const ern_status built = build(passes, step);
  if (built != ERN_OK) return built;
  for (size_t k = 0; k < passes->count; k++) forget(passes, k);
  return ern_bench_take_turns(&turns, timing);
}

ern_status ern_bench_step(ern_backend *const *backends, size_t count, const ern_bench_scene *scene,
                          const ern_bench_machine *machine, const ern_bench_options *options, bool torso,
                          ern_bench_pass *results) {
  ERN_PLAIN_FLOATS;
  ern_bench_options chosen;
  ern_bench_timing timing[ERN_BENCH_TURNS];
  struct passes passes = {.count = count};
  ern_status status = ern_bench_choose(backends, count, options, &chosen);
  if (status != ERN_OK) return status;
  ern_context *context = backends[0]->context;
  ERN_NEED(context, scene);
  ERN_NEED(context, results);
  if (torso && !scene->model->field.config.torso)
    return ern_fail(context, ERN_E_ARGUMENT, "bench: the model has no torso whose training could be measured");
  for (size_t k = 0; k < count; k++) {
    struct subject *s = &passes.subject[k];
    *s = begin_subject(backends[k], scene, &results[k]);
    ERN_TRY(ern_bench_shim_make(backends[k], false, &s->shim));
    ERN_TRY(make_trainer(s, &chosen, torso));
    results[k].threads = ern_bench_shim_threads(s->shim);
  }
  ERN_TRY(ern_bench_progress(context, &chosen, 0, 2));
  ERN_TRY(take_steps(&passes, false, 0.7 * chosen.seconds, timing));
  for (size_t k = 0; k < count; k++) {
    results[k].seconds = timing[k];
    ERN_TRY(call_apart(&passes, k, &timing[k], step));
    sum_plain_step(&passes.subject[k], torso);
  }
  ERN_TRY(ern_bench_progress(context, &chosen, 1, 2));
  ERN_TRY(take_steps(&passes, true, 0.3 * chosen.seconds, timing));
  for (size_t k = 0; k < count; k++) {
    ERN_TRY(call_apart(&passes, k, &timing[k], step));
    add_sixteenth(&passes.subject[k], &timing[k], torso);
    compute_share(&results[k], machine, k);
  }
  status = ern_bench_progress(context, &chosen, 2, 2);
fail:
  for (size_t k = 0; k < count; k++) free_subject(&passes.subject[k], context);
  return status;
}
