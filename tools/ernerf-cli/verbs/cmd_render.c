/* SPDX-License-Identifier: MIT
 * ernerf render: renders a video or pictures from a model, speech and head poses. */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ernerf/speech.h"
#include "session/settings.h"
#include "verbs.h"
#include "verbs/render_job.h"

/* PICTURE_BYTES: memory for the clip's torso pictures without `memory`: practically none. They are read in advance, and
 * seldom used twice. */
enum { OWN_OPTIONS = 10, PICTURE_BYTES = 1 };

/* ---- words ------------------------------------------------------------------------------------------------------- */

static void own_options(struct render_job *job, struct option options[OWN_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_TEXT("clip", &job->portrait.source.path), .choices = "CLIP",
       .help = "folder of a preprocessed clip: poses, speech, sound, eye values, torso pictures and background"},
      {ARGS_TEXT("poses", &job->poses),
       .help = "poses without a clip, in the form of transforms_train.json; needs --audio"},
      {ARGS_TEXT("audio", &job->audio), .alias = "aud",
       .help = "other speech: a sound (wav, mp3, mp4 ...) or its features (.npy); the output is as long, and the "
               "poses run forward and backward"},
      {ARGS_TEXT("wav", &job->wav),
       .help = "sound for the video (default that of --audio, where it is a sound; without --audio that of the clip)"},
      {ARGS_TEXT("o", &job->out), .alias = "output", .choices = "OUT",
       .help =
           "NAME.mp4, .mov, .mkv, .webm or .gif; pictures such as out/%05d.png, .jpg or .exr, numbered as the output's "
           "frames; - for standard output"},
      {ARGS_DIMENSIONS("size", &job->size, 1, ERN_IMAGE_MAX_SIDE),
       .help = "size of the frames (default that of the poses)"},
      {ARGS_CHOICE("fit", &job->fit, "contain|cover"),
       .help =
           "how the clip's frame goes into a --size of another aspect: contain shows all of it, and its edges go on "
           "beside it; cover fills the picture and cuts off what is beside it (default contain)"},
      {ARGS_RATE("fps", &job->rate),
       .help = "frames a second of the output, 1 to 240, such as 30, 29.97 or 24000/1001 (default 25, as the clip): "
               "poses, speech and eyes are interpolated in time"},
      {ARGS_TEXT("bg-img", &job->background_file), .choices = "FILE|white|black",
       .help = "background (default the clip's; with --poses transparent)"},
      {ARGS_CHOICE("progress", &job->session.progress_form, "words|json"),
       .help = "form of the progress on standard error: words, or for programs a JSON object a line, twice a second "
               "and at the end, also with --quiet (default words)"}};
  job->rate = (struct rate){RATE_CLIP, 1};
  ARGS_FILL(options, rows, OWN_OPTIONS);
}

/* Refuses options that contradict each other. */
static int check_usage(struct render_job *job, const struct args *args) {
  const bool clip = job->portrait.source.path != NULL, poses = job->poses != NULL;
  if (clip == poses)
    return args_refuse(args, "expected --clip CLIP or --poses FILE, found %s", clip ? "both" : "neither");
  if (job->out == NULL) return args_refuse(args, "-o OUT is missing");
  int status = sink_choose(&job->sink, args, job->out);
  if (status < 0 && poses && job->audio == NULL)
    status = args_refuse(args, "--poses has no speech of its own, expected --audio FILE");
  if (status < 0 && poses)
    status = args_forbid(args, "split asr-model memory force smooth-eye", "is about a clip, so it needs --clip");
  if (status < 0 && job->audio != NULL)
    status = args_forbid(args, "asr-model", "chooses the clip's speech, not --audio");
  if (status < 0 && !sink_has_sound(&job->sink))
    status = args_forbid(args, "wav", "is for a video with sound, and this output has none");
  if (status < 0) status = label_check(&job->label, args);
  if (status < 0) status = watermark_check(&job->watermark, args);
  if (status < 0 && job->sink.kind == SINK_EXR)
    status = args_forbid(args, "label watermark",
                         "is drawn on pictures of 8 bits, and an .exr holds values for further processing");
  if (status < 0 && !args_given(args, "size")) status = args_forbid(args, "fit", "needs --size");
  if (status < 0) status = control_check(&job->control, args);
  if (status < 0 && rate_control_asked(&job->rate_control))
    status = args_forbid(args, "reuse-rays", "is not for a budget, whose settings are timed by whole frames");
  if (status < 0) status = rate_control_check(&job->rate_control, args);
  if (status < 0 && sink_on_stdout(&job->sink) && session_json_on_stdout(&job->session))
    status = args_refuse(args, "--json and -o - both take standard output, expected --json FILE.json");
  return status;
}

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static int open_frames(struct render_job *job, const struct args *args) {
  struct session *session = &job->session;
  struct portrait *portrait = &job->portrait;
  struct frame_source *frame_source = &job->frame_source;
  int status = portrait->clip != NULL ? frame_source_of_clip(frame_source, session, portrait->clip,
                                                             (enum frame_source_split)portrait->split)
                                      : frame_source_of_poses(frame_source, session, job->poses);
  if (status == 0) status = control_clip(&job->control, session, args, frame_source);
  if (status == 0 && job->audio != NULL)
    status = frame_source_replay(frame_source, session, job->features->windows, NULL);
  if (status == 0) status = frame_source_resample(frame_source, session, job->rate, job->features);
  if (status == 0) status = portrait_cut(portrait, session, args, frame_source, job->features);
  return status == 0 ? control_output(&job->control, session, frame_source) : status;
}

static int open_features(struct render_job *job) {
  struct session *session = &job->session;
  const char *name = job->portrait.features_path;
  if (job->audio != NULL) {
    if (portrait_features(&job->portrait, session, job->audio, &job->own_features) != 0) return EXIT_FAILURE;
    job->features = &job->own_features;
    name = job->audio;
    if (!ern_speech_is_sound(name) &&
        speech_model_check_features(session, job->portrait.model_path, &job->portrait.info, name,
                                    speech_model_kind(name, job->features->width)) != 0)
      return EXIT_FAILURE;
  } else {
    job->features = ern_clip_features(job->portrait.clip);
  }
  speech_model_close(&job->portrait.source.speech_model); /* frees its memory for the frames */
  if (ern_renderer_accepts(job->portrait.renderer, job->features, name) != ERN_OK) return session_fail(session);
  job->windows = malloc(render_window_bytes(job));
  return job->windows != NULL ? 0 : session_fail_with(session, "no memory for windows of %s", name);
}

/* Sound can only be added if the pictures are consecutive. */
static void check_consecutive(struct render_job *job) {
  const struct source_frame *source_frame = job->frame_source.source_frame;
  for (size_t k = 1; k < job->frame_source.count; k++) {
    const int64_t steps = (int64_t)source_frame[k].place - (int64_t)source_frame[k - 1].place;
    if (source_frame[k].pose.aud_id == source_frame[k - 1].pose.aud_id + steps) continue;
    session_warn(&job->session,
                 "frames are not consecutive: aud_id %" PRId64 " is followed by %" PRId64
                 ", sound and picture drift apart",
                 source_frame[k - 1].pose.aud_id, source_frame[k].pose.aud_id);
    return;
  }
}

static int open_sound(struct render_job *job) {
  struct session *session = &job->session;
  const struct portrait *portrait = &job->portrait;
  const bool own = job->wav == NULL && job->audio == NULL && portrait->clip_info.has_sound;
  const bool heard = job->wav == NULL && job->audio != NULL && ern_speech_is_sound(job->audio);
  char path[4096];
  if (!sink_has_sound(&job->sink) || (job->wav == NULL && !own && !heard)) return 0;
  const int bytes = own ? snprintf(path, sizeof path, "%s/aud.wav", portrait->source.path)
                        : snprintf(path, sizeof path, "%s", heard ? job->audio : job->wav);
  if (bytes >= (int)sizeof path) return session_fail_with(session, "%s: the name is too long", path);
  const ern_status status = ern_sound_read(session->context, path, &job->sound);
  if (status != ERN_OK && own) {
    session_warn(session, "%s: the video is silent", ern_last_error(session->context));
    return 0;
  }
  if (status != ERN_OK) return session_fail(session);
  if (job->sound.frames == 0) {
    ern_sound_free(session->context, &job->sound);
    if (!own) return session_fail_with(session, "%s: has no sound, 0 samples", path);
    session_warn(session, "%s: has no sound, 0 samples: the video is silent", path);
    return 0;
  }
  job->sound_start = frame_source_seconds(&job->frame_source, 0);
  const double there = (double)job->sound.frames / job->sound.rate - job->sound_start;
  const double needed = (double)job->frame_source.count / rate_value(job->rate);
  /* less than a frame, of the output or of the speech, 25 a second: the last one may outlast the sound */
  const double spare = fmax(1 / rate_value(job->rate), 1.0 / RATE_CLIP);
  if (there < needed - spare)
    session_warn(session, "%s: %.2f s of sound from the first frame on, the pictures last %.2f s: the rest is silent",
                 path, there > 0 ? there : 0, needed);
  check_consecutive(job);
  return 0;
}

static int open_background(struct render_job *job) {
  const int width = job->size.width, height = job->size.height;
  int status = background_open(&job->background, &job->session, job->background_file, job->portrait.clip, width, height,
                               (ern_fit)job->fit);
  if (status != 0 || job->background.image.data != NULL || !sink_is_opaque(&job->sink)) return status;
  session_warn(&job->session, "%s has no transparency: frames are drawn over black; --bg-img chooses a background",
               job->sink.kind == SINK_JPEG ? "a jpg" : "a video");
  return background_fill(&job->background, &job->session);
}

static void say_plan(struct render_job *job) {
  const struct portrait *portrait = &job->portrait;
  if (portrait->clip != NULL && !portrait->info.has_torso && !portrait->clip_info.has_torso)
    session_warn(&job->session, "%s: has no torso_imgs, the head is rendered over the background alone",
                 portrait->source.path);
  char rate[RATE_TEXT_BYTES];
  rate_words(job->rate, rate);
  session_note(&job->session, "render: %zu frames of %d x %d, %s a second, %s, %s, %s (%s) to %s",
               job->frame_source.count, job->size.width, job->size.height, rate, portrait_kind(portrait),
               !sink_has_sound(&job->sink) ? "pictures alone"
               : job->sound.data != NULL   ? "with sound"
                                           : "without sound",
               job->session.backend_info.name, job->session.backend_info.isa, job->out);
  if (render_is_behind(job) && job->frame_source.frame != NULL)
    session_note(&job->session,
                 "render: the head is drawn for each frame, over the nearest of the clip's torso pictures");
  const size_t silent = silence_pose_count(&job->silence_pose, &job->frame_source);
  if (silent > 0)
    session_note(&job->session,
                 "render: in %zu of %zu frames nothing is said: the mouth rests (--set silence-pose=no: it does not)",
                 silent, job->frame_source.count);
}

/* ---- drawing ----------------------------------------------------------------------------------------------------- */

/* For the rate control's calibration: without the clip's torso picture, which takes the same time with all settings. */
static int draw_for_calibration(void *user, ern_renderer *renderer, size_t k, float *rgb) {
  struct render_job *job = user;
  const ern_frame_output output = {.rgba = job->look, .rgb = rgb};
  return render_frame(job, renderer, k, NULL, job->windows, &output, NULL) == ERN_OK ? 0 : render_fail(job, k);
}

static int open_rate_control(struct render_job *job, const struct args *args) {
  if (!rate_control_asked(&job->rate_control)) return 0;
  job->look = malloc((size_t)job->size.width * (size_t)job->size.height * 4);
  if (job->look == NULL)
    return session_fail_with(&job->session, "no memory for a picture of %d x %d", job->size.width, job->size.height);
  return rate_control_open(&job->rate_control, &job->session, args, &job->portrait, &job->frame_source, job->features,
                           job->size, draw_for_calibration, job);
}

/* The output contains recorded pictures if it shows the clip's torso, or a background that is not a single colour. */
static int learn_provenance(struct render_job *job) {
  const char *behind = job->background_file;
  const bool one_colour =
      behind != NULL ? strcmp(behind, "white") == 0 || strcmp(behind, "black") == 0 : job->portrait.clip == NULL;
  if (job->sink.kind == SINK_RAW) job->provenance.off = true;
  return provenance_learn(&job->provenance, &job->session, &job->portrait,
                          job->audio != NULL ? job->audio : job->portrait.features_path,
                          one_colour && !render_is_behind(job));
}

static int open_all(struct render_job *job, const struct args *args) {
  struct session *session = &job->session;
  if (!sink_on_stdout(&job->sink) && !session_folder_there(job->out))
    return session_fail_with(session, "%s: its folder is not there", job->out);
  if (!args_given(args, "memory")) job->portrait.source.memory = PICTURE_BYTES;
  job->portrait.render.frame_rate = (float)rate_value(job->rate);
  int status = job->sink.kind == SINK_VIDEO ? sink_check(&job->sink, session, NULL) : 0;
  job->provenance.numbered = job->sink.kind != SINK_VIDEO;
  if (status == 0 && !sink_on_stdout(&job->sink)) status = provenance_check(&job->provenance, session, job->out);
  if (status == 0) status = portrait_open(&job->portrait, session, args);
  if (status == 0) status = control_check_model(&job->control, session, args, &job->portrait);
  if (status == 0) status = open_features(job);
  if (status == 0) status = silence_pose_open(&job->silence_pose, session, &job->portrait, job->features);
  if (status == 0) status = open_frames(job, args);
  if (status == 0) status = sink_check(&job->sink, session, &job->frame_source);
  if (status == 0) status = portrait_prune_occupancy(&job->portrait, &job->session, &job->frame_source, job->features);
  if (status == 0)
    status = frame_reuse_open(&job->frame_reuse, &job->portrait, &job->session, &job->frame_source, job->features);
  if (status == 0 && job->size.width == 0)
    job->size = (struct dimensions){job->frame_source.camera.width, job->frame_source.camera.height};
  if (status == 0) status = open_background(job);
  if (status == 0) status = open_rate_control(job, args);
  if (status == 0) status = open_sound(job);
  if (status == 0 && render_is_behind(job))
    status = background_read(&job->background, session, job->portrait.clip, &job->frame_source);
  if (status == 0) status = learn_provenance(job);
  if (status == 0) status = label_make(&job->label, session, job->size.width, job->size.height);
  if (status == 0) status = watermark_make(&job->watermark, session, job->size.width, job->size.height);
  if (status == 0) status = session_check_inputs_kept(session);
  if (status != 0) return status;
  return sink_open(&job->sink, &job->session, job->size.width, job->size.height, job->rate, &job->portrait.info,
                   job->sound.data != NULL ? &job->sound : NULL, job->sound_start, provenance_of(&job->provenance));
}

/* Mean times of a frame by stage; reading and encoding run in parallel with the others. */
static json_t *report_stages(const struct render_job *job) {
  const ern_frame_times *draw = &job->stages;
  const double frames = (double)job->frame_source.count;
  return json_pack("{s:o, s:o, s:o, s:o, s:o, s:o}", "read", session_number(1000 * job->background.seconds / frames),
                   "audio", session_number(draw->audio / frames), "torso", session_number(draw->torso / frames), "head",
                   session_number(draw->head / frames), "output", session_number(draw->output / frames), "encode",
                   session_number(1000 * job->sink.seconds / frames));
}

static json_t *report(const struct render_job *job, double seconds) {
  const double frames = (double)job->frame_source.count;
  json_t *rate_control = rate_control_asked(&job->rate_control) ? rate_control_json(&job->rate_control) : json_null();
  json_t *ray_reuse = frame_reuse_report(&job->frame_reuse);
  char rate[RATE_TEXT_BYTES];
  rate_words(job->rate, rate);
  return json_pack("{s:s, s:o, s:o, s:s, s:I, s:i, s:i, s:I, s:o, s:o, s:o, s:o, s:b, s:s, s:s, s:o, s:o}", "rate",
                   rate, "output", session_text(job->out), "model", session_text(job->portrait.model_path), "kind",
                   portrait_kind(&job->portrait), "frames", (json_int_t)job->frame_source.count, "width",
                   job->size.width, "height", job->size.height, "silent_frames",
                   (json_int_t)silence_pose_count(&job->silence_pose, &job->frame_source), "seconds",
                   session_number(seconds), "fps", session_number(frames / seconds), "ms_per_frame",
                   session_number(1000 * seconds / frames), "ms_by_stage", report_stages(job), "sound",
                   job->sound.data != NULL, "backend", job->session.backend_info.name, "isa",
                   job->session.backend_info.isa, "rate_control", rate_control, "ray_reuse", ray_reuse);
}

/* The settings of all frames; with rate control, each setting with the number of frames that it drew. */
static json_t *settings_used(const struct render_job *job) {
  const ern_render_options *render = &job->portrait.render;
  const ern_backend_info *backend = &job->session.backend_info;
  struct settings settings = {.max_steps = render->max_steps > 0 ? render->max_steps : job->portrait.info.max_steps,
                              .transmittance_stop = render->transmittance_stop,
                              .occupancy_threshold = job->portrait.occupancy_threshold,
                              .image_scale = render->image_scale,
                              .threads = job->session.threads};
  if (rate_control_asked(&job->rate_control)) return rate_control_json(&job->rate_control);
  const bool device = strcmp(backend->name, "opencl") == 0; /* whose `isa` is its name */
  settings.device = device ? job->session.device : 0;
  if (device) settings.threads = 0;
  snprintf(settings.backend, sizeof settings.backend, "%s", backend->name);
  snprintf(settings.isa, sizeof settings.isa, "%s", device ? "" : backend->isa);
  return settings_json(&settings);
}

/* Content of the provenance file. Rendering uses no random numbers, so there is no seed. */
static json_t *about_output(const struct render_job *job) {
  const struct source_frame *first = job->frame_source.source_frame;
  const char *slash = strrchr(job->out, '/');
  char rate[RATE_TEXT_BYTES];
  rate_words(job->rate, rate);
  return json_pack("{s:o, s:I, s:I, s:s, s:i, s:i, s:b, s:o}", "output",
                   session_text(slash != NULL ? slash + 1 : job->out), "first_frame", (json_int_t)first[0].number,
                   "frames", (json_int_t)job->frame_source.count, "rate", rate, "width", job->size.width, "height",
                   job->size.height, "sound", job->sound.data != NULL, "settings", settings_used(job));
}

static int draw_all(struct render_job *job) {
  struct session *session = &job->session;
  struct progress progress;
  const double began = session_seconds();
  say_plan(job);
  progress_begin(&progress, session, "render", "frames");
  if (render_frames(job, &progress) != 0) return EXIT_FAILURE;
  if (sink_close(&job->sink, session) != 0) return EXIT_FAILURE;
  if (provenance_write(&job->provenance, session, about_output(job)) != 0) return EXIT_FAILURE;
  progress_end(&progress);
  const double seconds = session_seconds() - began;
  char kept[128];
  frame_reuse_say(&job->frame_reuse, kept, sizeof kept);
  session_note(session, "render: %zu frames in %.2f s, %.2f a second with reading and writing%s: %s",
               job->frame_source.count, seconds, (double)job->frame_source.count / seconds, kept, job->out);
  if (rate_control_asked(&job->rate_control))
    rate_control_summary(&job->rate_control, 1000 * seconds / (double)job->frame_source.count);
  return session_report(session, report(job, seconds));
}

static void close_all(struct render_job *job) {
  sink_free(&job->sink);
  provenance_free(&job->provenance);
  label_free(&job->label);
  watermark_free(&job->watermark);
  silence_pose_free(&job->silence_pose);
  free(job->windows);
  free(job->look);
  rate_control_close(&job->rate_control);
  background_free(&job->background, &job->session);
  frame_source_free(&job->frame_source);
  ern_sound_free(job->session.context, &job->sound);
  ern_features_free(job->session.context, &job->own_features);
  portrait_close(&job->portrait);
  session_close(&job->session);
}

static int run(struct render_job *job, const struct args *args) {
  int status = open_all(job, args);
  if (status == 0) status = draw_all(job);
  close_all(job);
  return status;
}

int cmd_render(int argc, char **argv) {
  struct render_job job = {0};
  struct option own[OWN_OPTIONS + SINK_OPTIONS + PROVENANCE_OPTIONS + LABEL_OPTIONS + WATERMARK_OPTIONS],
      shared[PORTRAIT_OPTIONS + FRAME_REUSE_OPTIONS], control[CONTROL_OPTIONS + SILENCE_POSE_OPTIONS],
      rate[RATE_CONTROL_OPTIONS], common[SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS];
  struct word words[] = {{"MODEL", &job.portrait.model_path, "a .safetensors or .pth file: a head, or head and torso"}};
  struct args args = {
      .verb = "render",
      .summary = "Renders a model as a video with sound, or as pictures.",
      .usage =
          "render MODEL --clip CLIP [--audio SOUND|F.npy] [--wav W] -o out.mp4\n"
          "render MODEL --poses FILE --audio SOUND|F.npy [--wav W] [--bg-img FILE] -o out.mp4 | out/%05d.png | -",
      .notes =
          "A head alone is drawn over the torso pictures of the clip, and those over the background.\n"
          "mp4, mov, mkv: H.264 yuv420p, AAC. webm: VP9, Opus. gif: 256 colours, silent. png: RGBA. jpg: RGB. exr: R G "
          "B A\n"
          "(as the model gives them, not linearised, alpha multiplied in), Z depth, audio_attention, and "
          "eye_attention\n"
          "where the model has it.",
      .public_names = true,
      .words = words,
      .word_count = 1,
      .groups = {{"What is drawn, and where to:", own,
                  OWN_OPTIONS + SINK_OPTIONS + PROVENANCE_OPTIONS + LABEL_OPTIONS + WATERMARK_OPTIONS},
                 {"Eyes, mouth and pose:", control, CONTROL_OPTIONS + SILENCE_POSE_OPTIONS},
                 {"How:", shared, PORTRAIT_OPTIONS + FRAME_REUSE_OPTIONS},
                 {"A time budget instead of single settings:", rate, RATE_CONTROL_OPTIONS},
                 {"Common:", common, SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS}}};
  own_options(&job, own);
  sink_options(&job.sink, own + OWN_OPTIONS);
  provenance_options(&job.provenance, own + OWN_OPTIONS + SINK_OPTIONS);
  label_options(&job.label, own + OWN_OPTIONS + SINK_OPTIONS + PROVENANCE_OPTIONS);
  watermark_options(&job.watermark, own + OWN_OPTIONS + SINK_OPTIONS + PROVENANCE_OPTIONS + LABEL_OPTIONS);
  portrait_options(&job.portrait, FRAME_SOURCE_ALL, shared);
  control_options(&job.control, control);
  silence_pose_options(&job.silence_pose, control + CONTROL_OPTIONS);
  frame_reuse_options(&job.frame_reuse, shared + PORTRAIT_OPTIONS);
  rate_control_options(&job.rate_control, rate);
  session_compute_options(&job.session, common);
  session_output_options(&job.session, common + SESSION_COMPUTE_OPTIONS);
  int status = args_parse(&args, argc, argv);
  if (status < 0) status = check_usage(&job, &args);
  if (status < 0) status = speech_model_check(&job.portrait.source.speech_model, &args, job.audio);
  job.portrait.other_speech = job.audio != NULL;
  const char *const inputs[SESSION_INPUTS] = {job.portrait.model_path,
                                              job.portrait.source.path,
                                              job.poses,
                                              job.audio,
                                              job.wav,
                                              job.background_file,
                                              job.control.eye,
                                              job.rate_control.front,
                                              job.portrait.source.speech_model.path,
                                              speech_model_file(&job.portrait.source.speech_model)};
  memcpy(job.session.inputs, inputs, sizeof inputs);
  if (status < 0) status = session_open(&job.session, &args);
  return status < 0 ? run(&job, &args) : status;
}
