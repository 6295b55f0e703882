/* SPDX-License-Identifier: MIT
 * ernerf render: a model, speech and head poses to a video or pictures. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "backdrop.h"
#include "control.h"
#include "governor.h"
#include "portrait.h"
#include "progress.h"
#include "rest.h"
#include "sink.h"
#include "stillness.h"
#include "verbs.h"

/* PICTURE_BYTES: torso pictures that stay in memory, without --memory: none. They are read ahead, and seldom come
 * twice.
 */
enum { AUDIO_WINDOWS = 8, OWN_OPTIONS = 9, PICTURE_BYTES = 1 };

struct render_job {
  struct session session;
  struct portrait portrait;
  struct governor governor;
  struct control control;
  struct rest rest;
  struct stillness stillness;
  /* from the command line */
  const char *poses, *audio, *wav, *background, *out;
  struct dimensions size;
  int fit; /* ern_fit */
  struct rate rate;
  /* made */
  struct sink sink;
  struct shots shots;
  struct backdrop backdrop;
  ern_features own_features; /* of --audio */
  const ern_features *features;
  ern_sound sound;
  double sound_start; /* seconds */
  float *windows;
  uint8_t *look;          /* [height][width][4]: the governor's quick look; NULL without one */
  ern_frame_times stages; /* of drawing, milliseconds, summed over the frames */
};

/* ---- words ------------------------------------------------------------------------------------------------------- */

static void own_options(struct render_job *job, struct option options[OWN_OPTIONS]) {
  const struct option rows[] = {
      {.name = "clip",
       .kind = OPTION_TEXT,
       .target = &job->portrait.source.path,
       .choices = "CLIP",
       .help = "folder of a preprocessed clip: poses, speech, sound, eyes and what stands behind the head"},
      {.name = "poses",
       .kind = OPTION_TEXT,
       .target = &job->poses,
       .help = "poses alone, in the form of transforms_train.json; with --audio"},
      {.name = "audio",
       .alias = "aud",
       .kind = OPTION_TEXT,
       .target = &job->audio,
       .help = "features of another speech (.npy): one frame a window, poses forward and back, sound from --wav"},
      {.name = "wav", .kind = OPTION_TEXT, .target = &job->wav, .help = "sound for the video"},
      {.name = "o",
       .alias = "output",
       .kind = OPTION_TEXT,
       .target = &job->out,
       .choices = "OUT",
       .help =
           "NAME.mp4; pictures such as out/%05d.png or out/%05d.exr, numbered as the output's frames; - for raw RGBA8"},
      {.name = "size",
       .kind = OPTION_DIMENSIONS,
       .target = &job->size,
       .low = 1,
       .high = ERN_IMAGE_MAX_SIDE,
       .help = "of the frames (default that of the poses)"},
      {.name = "fit",
       .kind = OPTION_CHOICE,
       .target = &job->fit,
       .choices = "contain|cover",
       .help =
           "how the clip's frame goes into a --size of another aspect: contain shows all of it, and its edges go on "
           "beside it; cover fills the picture and cuts off what is beside it (default contain)"},
      {.name = "fps",
       .kind = OPTION_RATE,
       .target = &job->rate,
       .help = "frames a second of the output, 1 to 240, such as 30, 29.97 or 24000/1001 (default 25, as the clip): "
               "poses, speech and eyes are interpolated in time"},
      {.name = "bg_img",
       .kind = OPTION_TEXT,
       .target = &job->background,
       .choices = "FILE|white|black",
       .help = "background (default the clip's; with --poses transparent)"}};
  job->rate = (struct rate){RATE_CLIP, 1};
  ARGS_FILL(options, rows, OWN_OPTIONS);
}

/* What does not go together. */
static int check_usage(struct render_job *job, const struct args *args) {
  const bool clip = job->portrait.source.path != NULL, poses = job->poses != NULL;
  if (clip == poses)
    return args_refuse(args, "expected --clip CLIP or --poses FILE, found %s", clip ? "both" : "neither");
  if (job->out == NULL) return args_refuse(args, "-o OUT is missing");
  int status = sink_choose(&job->sink, args, job->out);
  if (status < 0 && poses && job->audio == NULL)
    status = args_refuse(args, "--poses has no speech of its own, expected --audio FILE.npy");
  if (status < 0 && poses)
    status = args_forbid(args, "split asr_model memory force smooth_eye", "is about a clip, so it needs --clip");
  if (status < 0 && job->audio != NULL)
    status = args_forbid(args, "asr_model", "chooses the clip's speech, not --audio");
  if (status < 0 && job->sink.kind != SINK_VIDEO)
    status = args_forbid(args, "wav", "is for an .mp4, the others are silent");
  if (status < 0 && !args_given(args, "size")) status = args_forbid(args, "fit", "is about another --size");
  if (status < 0) status = control_check(&job->control, args);
  if (status < 0) status = stillness_check(args);
  if (status < 0 && governor_asked(&job->governor))
    status = args_forbid(args, "still no-still", "is not for a budget, whose settings are timed by whole frames");
  if (status < 0) status = governor_check(&job->governor, args);
  if (status < 0 && job->sink.kind == SINK_RAW && session_json_on_stdout(&job->session))
    status = args_refuse(args, "--json and -o - both take standard output, expected --json FILE.json");
  return status;
}

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static int open_shots(struct render_job *job, const struct args *args) {
  struct session *session = &job->session;
  struct portrait *portrait = &job->portrait;
  struct shots *shots = &job->shots;
  int status = portrait->clip != NULL ? shots_of_clip(shots, session, portrait->clip, (enum shot_split)portrait->split)
                                      : shots_of_poses(shots, session, job->poses);
  if (status == 0) status = control_clip(&job->control, session, args, shots);
  if (status == 0 && job->audio != NULL) status = shots_replay(shots, session, job->features->windows);
  if (status == 0) status = shots_resample(shots, session, job->rate, job->features);
  if (status == 0) status = portrait_cut(portrait, session, args, shots, job->features);
  return status == 0 ? control_output(&job->control, session, shots) : status;
}

static int open_features(struct render_job *job) {
  struct session *session = &job->session;
  const char *name = job->portrait.features_path;
  if (job->audio != NULL) {
    if (ern_features_load(session->context, job->audio, &job->own_features) != ERN_OK) return session_fail(session);
    job->features = &job->own_features;
    name = job->audio;
  } else {
    job->features = ern_clip_features(job->portrait.clip);
  }
  if (ern_renderer_accepts(job->portrait.renderer, job->features, name) != ERN_OK) return session_fail(session);
  job->windows = malloc((size_t)AUDIO_WINDOWS * (size_t)job->features->window_length * (size_t)job->features->width *
                        sizeof(float));
  return job->windows != NULL ? 0 : session_fail_with(session, "no memory for windows of %s", name);
}

/* The sound belongs to the pictures as long as they are consecutive. */
static void check_consecutive(struct render_job *job) {
  const struct shot *shot = job->shots.shot;
  for (size_t k = 1; k < job->shots.count; k++) {
    const int64_t steps = (int64_t)shot[k].place - (int64_t)shot[k - 1].place;
    if (shot[k].pose.aud_id == shot[k - 1].pose.aud_id + steps) continue;
    session_warn(&job->session,
                 "frames are not consecutive: aud_id %" PRId64 " is followed by %" PRId64
                 ", sound and picture drift apart",
                 shot[k - 1].pose.aud_id, shot[k].pose.aud_id);
    return;
  }
}

static int open_sound(struct render_job *job) {
  struct session *session = &job->session;
  const struct portrait *portrait = &job->portrait;
  const bool own = job->wav == NULL && job->audio == NULL && portrait->clip_info.has_sound;
  char path[4096];
  if (job->sink.kind != SINK_VIDEO || (job->wav == NULL && !own)) return 0;
  const int bytes = own ? snprintf(path, sizeof path, "%s/aud.wav", portrait->source.path)
                        : snprintf(path, sizeof path, "%s", job->wav);
  if (bytes >= (int)sizeof path) return session_fail_with(session, "%s: the name is too long", path);
  const ern_status status = ern_sound_read(session->context, path, &job->sound);
  if (status != ERN_OK && own) {
    session_warn(session, "%s: the video is silent", ern_last_error(session->context));
    return 0;
  }
  if (status != ERN_OK) return session_fail(session);
  job->sound_start = shots_seconds(&job->shots, 0);
  const double there = (double)job->sound.frames / job->sound.rate - job->sound_start;
  const double needed = (double)job->shots.count / rate_value(job->rate);
  const double spare =
      job->shots.frame != NULL ? 1 : 0.5; /* frames; at another rate the last one may outlast the clip */
  if (there < needed - spare / rate_value(job->rate))
    session_warn(session, "%s: %.2f s of sound from the first frame on, the pictures last %.2f s: the rest is silent",
                 path, there > 0 ? there : 0, needed);
  check_consecutive(job);
  return 0;
}

/* Whether the head is drawn over the torso pictures of the clip. */
static bool is_behind(const struct render_job *job) {
  return job->portrait.clip != NULL && !job->portrait.info.has_torso && job->portrait.clip_info.has_torso;
}

static int open_backdrop(struct render_job *job) {
  const int width = job->size.width, height = job->size.height;
  int status = backdrop_open(&job->backdrop, &job->session, job->background, job->portrait.clip, width, height,
                             (ern_fit)job->fit);
  if (status != 0 || job->backdrop.background.data != NULL || job->sink.kind != SINK_VIDEO) return status;
  session_warn(&job->session, "an mp4 has no transparency: frames are drawn over black; --bg_img chooses a background");
  return backdrop_fill(&job->backdrop, &job->session);
}

static void say_plan(struct render_job *job) {
  const struct portrait *portrait = &job->portrait;
  if (portrait->clip != NULL && !portrait->info.has_torso && !portrait->clip_info.has_torso)
    session_warn(&job->session, "%s: has no torso_imgs, the head is drawn over the background alone",
                 portrait->source.path);
  char rate[RATE_TEXT_BYTES];
  rate_words(job->rate, rate);
  session_note(&job->session, "render: %zu frames of %d x %d, %s a second, %s, %s, %s (%s) to %s", job->shots.count,
               job->size.width, job->size.height, rate, portrait_kind(portrait),
               job->sink.kind != SINK_VIDEO ? "pictures alone"
               : job->sound.data != NULL    ? "with sound"
                                            : "without sound",
               job->session.backend_info.name, job->session.backend_info.isa, job->out);
  if (is_behind(job) && job->shots.frame != NULL)
    session_note(&job->session,
                 "render: the head is drawn for each frame, over the nearest of the clip's torso pictures");
  const size_t resting = rest_count(&job->rest, &job->shots);
  if (resting > 0)
    session_note(&job->session,
                 "render: in %zu of %zu frames nothing is said: the mouth rests (--no_rest: it does not)", resting,
                 job->shots.count);
}

/* ---- drawing ----------------------------------------------------------------------------------------------------- */

/* Frame k over `torso`, which may be NULL. */
static ern_status draw_frame(struct render_job *job, ern_renderer *renderer, size_t k, const uint8_t *torso,
                             const ern_frame_output *output, ern_frame_times *times) {
  const struct shot *shot = &job->shots.shot[k];
  float refined[16];
  shots_windows(&job->shots, k, job->features, (ern_audio_pad)job->portrait.audio_pad, job->windows);
  const ern_camera camera =
      shots_camera(&job->shots, k, job->portrait.scale, job->size.width, job->size.height, (ern_fit)job->fit);
  const ern_frame_input input = {.camera = camera,
                                 .head_pose = portrait_refined(&job->portrait, &job->shots, k, refined),
                                 .windows = job->windows,
                                 .window_length = job->features->window_length,
                                 .eye = shot->eye,
                                 .background = job->backdrop.background.data,
                                 .torso = torso,
                                 .rest_code = job->rest.code,
                                 .rest = rest_of(&job->rest, &job->shots, k)};
  return ern_renderer_frame(renderer, &input, output, times);
}

static int fail_frame(struct render_job *job, size_t k) {
  return session_fail_with(&job->session, "%s, frame %zu: %s", job->portrait.model_path, job->shots.shot[k].number,
                           ern_last_error(job->session.context));
}

/* For the governor's quick look: without the clip's torso picture, which takes the same time with all settings. */
static int draw_look(void *user, ern_renderer *renderer, size_t k, float *rgb) {
  struct render_job *job = user;
  const ern_frame_output output = {.rgba = job->look, .rgb = rgb};
  return draw_frame(job, renderer, k, NULL, &output, NULL) == ERN_OK ? 0 : fail_frame(job, k);
}

static int open_governor(struct render_job *job, const struct args *args) {
  if (!governor_asked(&job->governor)) return 0;
  job->look = malloc((size_t)job->size.width * (size_t)job->size.height * 4);
  if (job->look == NULL)
    return session_fail_with(&job->session, "no memory for a picture of %d x %d", job->size.width, job->size.height);
  return governor_open(&job->governor, &job->session, args, &job->portrait, &job->shots, job->features, job->size,
                       draw_look, job);
}

static int draw(struct render_job *job, size_t k) {
  const uint8_t *torso = NULL;
  ern_frame_output output;
  ern_frame_times times;
  ern_renderer *renderer = governor_asked(&job->governor) ? governor_renderer(&job->governor) : job->portrait.renderer;
  if (renderer == NULL) return EXIT_FAILURE;
  if (is_behind(job) && backdrop_next_torso(&job->backdrop, &job->session, &torso) != 0) return EXIT_FAILURE;
  if (sink_room(&job->sink, &job->session, &output) != 0) return EXIT_FAILURE;
  if (draw_frame(job, renderer, k, torso, &output, &times) != ERN_OK) return fail_frame(job, k);
  sink_put(&job->sink, job->shots.shot[k].number);
  job->stages.audio += times.audio;
  job->stages.torso += times.torso;
  job->stages.head += times.head;
  job->stages.output += times.output;
  return 0;
}

static int open_all(struct render_job *job, const struct args *args) {
  struct session *session = &job->session;
  if (job->sink.kind != SINK_RAW && !session_folder_there(job->out))
    return session_fail_with(session, "%s: its folder is not there", job->out);
  if (!args_given(args, "memory")) job->portrait.source.memory = PICTURE_BYTES;
  job->portrait.render.frame_rate = (float)rate_value(job->rate);
  int status = job->sink.kind == SINK_VIDEO ? sink_check(&job->sink, session, NULL) : 0;
  if (status == 0) status = portrait_open(&job->portrait, session, args);
  if (status == 0) status = control_check_model(&job->control, session, args, &job->portrait);
  if (status == 0) status = open_features(job);
  if (status == 0) status = rest_open(&job->rest, session, &job->portrait, job->features);
  if (status == 0) status = open_shots(job, args);
  if (status == 0) status = sink_check(&job->sink, session, &job->shots);
  if (status == 0) status = portrait_thin(&job->portrait, &job->session, &job->shots, job->features);
  if (status == 0) status = stillness_open(&job->stillness, &job->portrait, &job->session, &job->shots, job->features);
  if (status == 0 && job->size.width == 0)
    job->size = (struct dimensions){job->shots.camera.width, job->shots.camera.height};
  if (status == 0) status = open_backdrop(job);
  if (status == 0) status = open_governor(job, args);
  if (status == 0) status = open_sound(job);
  if (status == 0 && is_behind(job)) status = backdrop_read(&job->backdrop, session, job->portrait.clip, &job->shots);
  if (status != 0) return status;
  return sink_open(&job->sink, &job->session, job->size.width, job->size.height, job->rate, &job->portrait.info,
                   job->sound.data != NULL ? &job->sound : NULL, job->sound_start);
}

/* Of a frame; reading and encoding go on beside the others. */
static json_t *report_stages(const struct render_job *job) {
  const ern_frame_times *draw = &job->stages;
  const double frames = (double)job->shots.count;
  return json_pack("{s:o, s:o, s:o, s:o, s:o, s:o}", "read", session_number(1000 * job->backdrop.seconds / frames),
                   "audio", session_number(draw->audio / frames), "torso", session_number(draw->torso / frames), "head",
                   session_number(draw->head / frames), "output", session_number(draw->output / frames), "encode",
                   session_number(1000 * job->sink.seconds / frames));
}

static json_t *report(const struct render_job *job, double seconds) {
  const double frames = (double)job->shots.count;
  json_t *pace = governor_asked(&job->governor) ? governor_json(&job->governor) : json_null();
  json_t *still = stillness_report(&job->stillness, &job->portrait);
  char rate[RATE_TEXT_BYTES];
  rate_words(job->rate, rate);
  return json_pack("{s:s, s:o, s:o, s:s, s:I, s:i, s:i, s:I, s:o, s:o, s:o, s:o, s:b, s:s, s:s, s:o, s:o}", "rate",
                   rate, "output", session_text(job->out), "model", session_text(job->portrait.model_path), "kind",
                   portrait_kind(&job->portrait), "frames", (json_int_t)job->shots.count, "width", job->size.width,
                   "height", job->size.height, "rest_frames", (json_int_t)rest_count(&job->rest, &job->shots),
                   "seconds", session_number(seconds), "fps", session_number(frames / seconds), "ms_per_frame",
                   session_number(1000 * seconds / frames), "ms_by_stage", report_stages(job), "sound",
                   job->sound.data != NULL, "backend", job->session.backend_info.name, "isa",
                   job->session.backend_info.isa, "pace", pace, "still", still);
}

static int draw_all(struct render_job *job) {
  struct session *session = &job->session;
  struct progress progress;
  const double began = session_seconds();
  say_plan(job);
  progress_begin(&progress, session, "render", "frames");
  double before = began;
  for (size_t k = 0; k < job->shots.count; k++) {
    if (session_interrupted())
      return session_stop_with(session, "stopped at frame %zu of %zu%s", k, job->shots.count,
                               job->sink.kind == SINK_VIDEO ? ", no video was written" : "");
    if (draw(job, k) != 0) return EXIT_FAILURE;
    const double now = session_seconds();
    if (governor_asked(&job->governor)) governor_took(&job->governor, 1000 * (now - before));
    before = now;
    progress_at(&progress, k + 1, job->shots.count,
                governor_asked(&job->governor) ? governor_name(&job->governor) : "");
  }
  if (sink_close(&job->sink, session) != 0) return EXIT_FAILURE;
  progress_end(&progress);
  const double seconds = session_seconds() - began;
  char kept[128];
  stillness_say(&job->stillness, &job->portrait, kept, sizeof kept);
  session_note(session, "render: %zu frames in %.2f s, %.2f a second with reading and writing%s: %s", job->shots.count,
               seconds, (double)job->shots.count / seconds, kept, job->out);
  if (governor_asked(&job->governor)) governor_summary(&job->governor, 1000 * seconds / (double)job->shots.count);
  return session_report(session, report(job, seconds));
}

static void close_all(struct render_job *job) {
  sink_free(&job->sink);
  rest_free(&job->rest);
  free(job->windows);
  free(job->look);
  governor_close(&job->governor);
  backdrop_free(&job->backdrop, &job->session);
  shots_free(&job->shots);
  ern_sound_free(job->session.context, &job->sound);
  ern_features_free(job->session.context, &job->own_features);
  portrait_close(&job->portrait);
  session_close(&job->session);
}

int cmd_render(int argc, char **argv) {
  struct render_job job = {0};
  struct option own[OWN_OPTIONS], shared[PORTRAIT_OPTIONS + STILLNESS_OPTIONS], control[CONTROL_OPTIONS + REST_OPTIONS],
      pace[GOVERNOR_OPTIONS], common[SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS];
  struct word words[] = {{"MODEL", &job.portrait.model_path, "a .safetensors or .pth file: a head, or head and torso"}};
  struct args args = {
      .verb = "render",
      .summary = "Draws a model to a video with sound, or to pictures.",
      .usage =
          "render MODEL --clip CLIP [--audio F.npy] [--wav W] -o out.mp4\n"
          "render MODEL --poses FILE --audio F.npy [--wav W] [--bg_img FILE] -o out.mp4 | out/%05d.png | -",
      .notes =
          "A head alone is drawn over the torso pictures of the clip, and those over the background.\n"
          "mp4: H.264 yuv420p, AAC. png: RGBA. exr: R G B A (as the model gives them, not\n"
          "linearised, alpha multiplied in), Z depth, audio_attention, and eye_attention where the model has it.",
      .public_names = true,
      .words = words,
      .word_count = 1,
      .groups = {{"What is drawn, and where to:", own, OWN_OPTIONS},
                 {"Eyes, mouth and pose:", control, CONTROL_OPTIONS + REST_OPTIONS},
                 {"How:", shared, PORTRAIT_OPTIONS + STILLNESS_OPTIONS},
                 {"A budget instead of knobs:", pace, GOVERNOR_OPTIONS},
                 {"Common:", common, SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS}}};
  own_options(&job, own);
  portrait_options(&job.portrait, SHOTS_ALL, shared);
  control_options(&job.control, control);
  rest_options(&job.rest, control + CONTROL_OPTIONS);
  stillness_options(&job.stillness, shared + PORTRAIT_OPTIONS);
  governor_options(&job.governor, pace);
  session_compute_options(&job.session, common);
  session_output_options(&job.session, common + SESSION_COMPUTE_OPTIONS);
  int status = args_parse(&args, argc, argv);
  if (status < 0) status = check_usage(&job, &args);
  const char *const inputs[SESSION_INPUTS] = {
      job.portrait.model_path, job.portrait.source.path, job.poses,         job.audio, job.wav,
      job.background,          job.control.eye,          job.governor.front};
  memcpy(job.session.inputs, inputs, sizeof inputs);
  if (status < 0) status = session_open(&job.session, &args);
  if (status >= 0) return status;
  status = open_all(&job, &args);
  if (status == 0) status = draw_all(&job);
  close_all(&job);
  return status;
}
