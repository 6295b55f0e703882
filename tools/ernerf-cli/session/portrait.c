/* SPDX-License-Identifier: MIT */
#include "session/portrait.h"

#include "bytes.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "ernerf/speech.h"

enum { SPEECH_FRAMES = 6, AUDIO_WINDOWS = 8 };

/* Costs less than 0.01 dB on every measured clip, and saves a sixth of the samples (docs/results.md). */
static const float TRANSMITTANCE_STOP = 3e-3f;

void portrait_options(struct portrait *portrait, enum frame_source_split split,
                      struct option options[PORTRAIT_OPTIONS]) {
  portrait->render = ern_render_options_default();
  portrait->render.transmittance_stop = TRANSMITTANCE_STOP;
  portrait->split = (int)split;
  portrait->frames = (struct range){.open_end = true};
  portrait->chosen = (struct setting_choice){.config = &portrait->render, .row = ern_render_setting};
  const struct option rows[] = {
      {ARGS_CHOICE("split", &portrait->split, "train|val|all"),
       .help = split == FRAME_SOURCE_ALL ? "frames of the clip: train: those of transforms_train.json; val: those of "
                                           "transforms_val.json; all: both (default all)"
                                         : "frames of the clip: train: those of transforms_train.json; val: those of "
                                           "transforms_val.json; all: both (default val)"},
      {ARGS_RANGE("frames", &portrait->frames),
       .help = "frames [A, B) of the output (eval, compare: of those of --split), counted from 0 (default all)"},
      {ARGS_CHOICE("audio-pad", &portrait->audio_pad, "edge|zero"), .seldom = true,
       .help = "speech windows past the ends of the speech: edge repeats the nearest, zero has zeros, as published "
               "(default as in training)"},
      {.name = "max-steps", ARGS_SETTING(&portrait->chosen, "max_steps"), .seldom = true, .published = true},
      {.name = "dt-gamma", ARGS_SETTING(&portrait->chosen, "dt_gamma"), .seldom = true, .published = true},
      {.name = "transmittance-stop", ARGS_SETTING(&portrait->chosen, "transmittance_stop"), .seldom = true},
      {ARGS_FLOAT("occupancy-threshold", &portrait->occupancy_threshold, 0, 1e6), .seldom = true,
       .help = "skip the cells of the occupancy grid whose density, per scene unit, is below X in all frames of this "
               "speech, such as 0.1 (default 0: none)"},
      {ARGS_CHOICE("torso", &portrait->torso, "recorded|model"),
       .help = "the torso below a head that has the clip's own poses: recorded: the clip's torso pictures, where there "
               "are some; model: that of the model, where it has one (default recorded)"},
      {.name = "torso-shrink", ARGS_SETTING(&portrait->chosen, "torso_shrink"), .seldom = true, .published = true},
      {ARGS_FLOAT("scale", &portrait->scale, 0.001, 1000), .seldom = true, .published = true,
       .help = "factor of the poses' translations (default as in training)"},
      {.name = "image-scale", ARGS_SETTING(&portrait->chosen, "image_scale"), .seldom = true},
      {ARGS_FLAG("smooth-lips", &portrait->render.smooth_lips), .seldom = true, .published = true,
       .help = "smooth the lips: the audio code of a frame is 0.35 of the previous frame's and 0.65 of its own"},
      {ARGS_FLAG("force", &portrait->force), .help = "use the model although it was trained on another clip"}};
  ARGS_FILL(options, rows, PORTRAIT_OPTIONS - CLIP_SOURCE_OPTIONS);
  struct option *source = options + sizeof rows / sizeof *rows;
  clip_source_options(&portrait->source, source);
  if (split == FRAME_SOURCE_ALL)
    source[1].help = "maximum memory for decoded frames of the clip, such as 512M (default: none is kept)";
}

/* Settings that stand for the training's values take those. Others take precedence, with a warning if the model
 * differs. */
static void take_view(struct portrait *portrait, struct session *session, const struct args *args) {
  const ern_model_info *info = &portrait->info;
  ern_render_options *render = &portrait->render;
  struct bytes trained = {0}, asked = {0};
  if (render->torso_shrink == 0) render->torso_shrink = info->torso_shrink;
  if (!args_given(args, "scale")) portrait->scale = info->scale;
  if (render->dt_gamma < 0) render->dt_gamma = info->dt_gamma;
  if (render->max_steps == 0) render->max_steps = info->max_steps;
  if (!args_given(args, "audio-pad")) portrait->audio_pad = (int)info->audio_pad;
  const bool spaced = render->max_steps > SESSION_EVEN_STEPS;
  const struct {
    const char *name;
    double trained, asked;
  } numbers[] = {{"scale", (double)info->scale, (double)portrait->scale},
                 {"dt-gamma", (double)info->dt_gamma, (double)render->dt_gamma},
                 {"max-steps", info->max_steps, render->max_steps}};
  for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) {
    if (numbers[i].trained == numbers[i].asked || (i == 1 && !spaced)) continue;
    bytes_print(&trained, " --%s %.6g", numbers[i].name, numbers[i].trained);
    bytes_print(&asked, " --%s %.6g", numbers[i].name, numbers[i].asked);
  }
  if ((int)info->audio_pad != portrait->audio_pad) {
    bytes_print(&trained, " --set audio-pad=%s", ern_audio_pad_name(info->audio_pad));
    bytes_print(&asked, " --set audio-pad=%s", ern_audio_pad_name((ern_audio_pad)portrait->audio_pad));
  }
  if (info->has_view_settings && asked.count > 0)
    session_warn(session, "%s was trained with%.*s; it is drawn with%.*s, as asked", portrait->model_path,
                 (int)trained.count, (const char *)trained.data, (int)asked.count, (const char *)asked.data);
  if (!spaced && render->dt_gamma != info->dt_gamma)
    session_warn(session, "--dt-gamma %g changes nothing with %d samples a ray, expected --max-steps above %d",
                 (double)render->dt_gamma, render->max_steps, SESSION_EVEN_STEPS);
  bytes_free(&trained);
  bytes_free(&asked);
}

static int open_model(struct portrait *portrait, struct session *session, const struct args *args) {
  portrait->model = portrait->lent;
  if (portrait->model == NULL && ern_model_load(&portrait->model, session->context, portrait->model_path) != ERN_OK)
    return session_fail(session);
  ern_model_describe(portrait->model, &portrait->info);
  take_view(portrait, session, args);
  if (portrait->info.dub && !portrait->dubs)
    session_warn(session, "%s: was trained for `ernerf dub`: outside the lower face it is blurred",
                 portrait->model_path);
  return 0;
}

/* A torso of the model is left out where the clip's pictures show it. */
static void choose_torso(struct portrait *portrait, struct session *session, const struct args *args) {
  const bool moved = args_given(args, "rotate") || args_given(args, "hold-pose") || args_given(args, "smooth-path");
  const bool recorded = portrait->torso == PORTRAIT_TORSO_RECORDED && (!moved || args_given(args, "torso"));
  if (!recorded || portrait->clip == NULL || !portrait->clip_info.has_torso || !portrait->info.has_torso) return;
  if (!portrait->dubs)
    session_note(session, "%s: below the head are the torso pictures of %s; --torso model draws the model's torso",
                 portrait->model_path, portrait->source.path);
  portrait->render.no_torso = true;
  portrait->info.has_torso = false;
}

/* After choose_torso. */
static void report_motion(const struct portrait *portrait, struct session *session) {
  const ern_model_info *info = &portrait->info;
  if (!portrait->dubs && portrait->clip != NULL && info->has_torso && info->has_torso_motion &&
      !portrait->clip_info.has_torso_motion)
    session_warn(session,
                 "%s: has no torso.npy, and %s was trained with the body's motion: its torso follows the head's pose "
                 "alone",
                 portrait->source.path, portrait->model_path);
}

/* After choose_torso: which torso is drawn depends on the clip and the motion too. */
static void report_torso_shrink(const struct portrait *portrait, struct session *session) {
  const ern_model_info *info = &portrait->info;
  const float asked = portrait->render.torso_shrink;
  if (asked == info->torso_shrink) return;
  if (portrait->render.no_torso)
    session_warn(session,
                 "--torso-shrink changes nothing: below the head are the torso pictures of %s; --torso model draws the "
                 "model's torso",
                 portrait->source.path);
  else if (!info->has_torso)
    session_warn(session, "--torso-shrink changes nothing: %s has no torso", portrait->model_path);
  else if (info->has_view_settings)
    session_warn(session, "%s was trained with --torso-shrink %.6g; it is drawn with --torso-shrink %.6g, as asked",
                 portrait->model_path, (double)info->torso_shrink, (double)asked);
}

static int check_identity(struct portrait *portrait, struct session *session) {
  const char *model = portrait->info.clip, *clip = portrait->clip_info.identity;
  if (model[0] == 0)
    session_note(session, "%s: does not say which clip it was trained on; it is used with %s all the same",
                 portrait->model_path, portrait->source.path);
  if (model[0] == 0 || clip[0] == 0 || strcmp(model, clip) == 0) return 0;
  if (!portrait->force)
    return session_fail_with(session,
                             "%s: trained on another clip: its clip is %.12s..., expected %.12s..., that of %s; "
                             "--force uses it nevertheless",
                             portrait->model_path, model, clip, portrait->source.path);
  session_warn(session, "%s: trained on another clip (%.12s..., not %.12s...)%s", portrait->model_path, model, clip,
               portrait->info.cameras > 0 ? "; its pose corrections are of that clip's frames, and are left out" : "");
  return 0;
}

const char *portrait_speech(const struct portrait *portrait) {
  const ern_features features = {.width = portrait->info.feature_width};
  return portrait->info.speech[0] != 0 ? portrait->info.speech : ern_speech_kind(&features);
}

int portrait_refuse_sound(const struct portrait *portrait, struct session *session) {
  char wanted[192];
  speech_model_wanted(&portrait->info, wanted);
  return session_fail_with(session,
                           "%s: was trained on speech features of another kind than %s and %s, which are computed "
                           "from a sound without a network; expected --audio FILE.npy, or --speech-model FILE.onnx%s",
                           portrait->model_path, ERN_SPEECH_ARTICULATORY, ERN_SPEECH_CEPSTRA, wanted);
}

/* Whether the clip has a file of these features, which equals the features computed from its sound. */
static bool has_file(const char *clip, const char *kind) {
  char path[4096];
  const char *name = strcmp(kind, "esperanto") == 0 ? "aud_eo" : strcmp(kind, "hubert") == 0 ? "aud_hu" : NULL;
  if (name == NULL || snprintf(path, sizeof path, "%s/%s.npy", clip, name) >= (int)sizeof path) return false;
  return access(path, R_OK) == 0;
}

static int open_clip(struct portrait *portrait, struct session *session) {
  struct clip_source *source = &portrait->source;
  const char *kind = ern_speech_network_kind(source->speech_model.network);
  if (portrait->other_speech && has_file(source->path, kind)) source->asr_model = kind;
  /* a clip may have features of another kind too */
  if (source->asr_model == NULL && source->speech_model.network == NULL &&
      ern_speech_width(portrait_speech(portrait)) > 0)
    source->asr_model = portrait_speech(portrait);
  if (clip_source_open(&portrait->source, session, &portrait->clip) != 0) return EXIT_FAILURE;
  ern_clip_describe(portrait->clip, &portrait->clip_info);
  if (portrait->clip_info.hears_sound && portrait->clip_info.speech_network[0] == 0 &&
      ern_speech_width(portrait_speech(portrait)) == 0)
    return portrait_refuse_sound(portrait, session);
  const bool own = portrait->source.features == NULL;
  snprintf(portrait->features_path, sizeof portrait->features_path, "%s%s%s", own ? portrait->source.path : "",
           own ? "/" : "", portrait->clip_info.features_file);
  if (!portrait->other_speech &&
      speech_model_check_features(session, portrait->model_path, &portrait->info, portrait->features_path,
                                  speech_model_clip_kind(portrait->clip)) != 0)
    return EXIT_FAILURE;
  return check_identity(portrait, session);
}

int portrait_open(struct portrait *portrait, struct session *session, const struct args *args) {
  int status = open_model(portrait, session, args);
  if (status == 0)
    status = speech_model_open(&portrait->source.speech_model, session, portrait->model_path, &portrait->info);
  if (status == 0 && portrait->source.path != NULL) status = open_clip(portrait, session);
  if (status != 0) return status;
  choose_torso(portrait, session, args);
  report_motion(portrait, session);
  report_torso_shrink(portrait, session);
  portrait->render.threads = session->threads;
  if (session->backend == NULL && session_backend(session) != ERN_OK) return session_fail(session);
  if (ern_renderer_create(&portrait->renderer, session->backend, portrait->model, &portrait->render) != ERN_OK)
    return session_fail(session);
  return 0;
}

/* Samples moments over the whole speech, with eye values from open to closed regardless of the frames' own. */
int portrait_prune_occupancy(struct portrait *portrait, struct session *session,
                             const struct frame_source *frame_source, const ern_features *features) {
  const size_t values = (size_t)AUDIO_WINDOWS * (size_t)features->window_length * (size_t)features->width;
  float eyes[SPEECH_FRAMES];
  if (portrait->occupancy_threshold <= 0 || frame_source->count == 0) return 0;
  float *windows = malloc(SPEECH_FRAMES * values * sizeof *windows);
  if (windows == NULL) return session_fail_with(session, "no memory for %d frames of the speech", SPEECH_FRAMES);
  for (size_t k = 0; k < SPEECH_FRAMES; k++) {
    frame_source_windows(frame_source, (frame_source->count - 1) * k / (SPEECH_FRAMES - 1), features,
                         (ern_audio_pad)portrait->audio_pad, windows + k * values);
    eyes[k] = (float)(k % 3) / 2;
  }
  const ern_status status = ern_renderer_prune_occupancy(portrait->renderer, windows, features->window_length, eyes,
                                                         SPEECH_FRAMES, portrait->occupancy_threshold);
  free(windows);
  return status == ERN_OK ? 0 : session_fail(session);
}

void portrait_close(struct portrait *portrait) {
  ern_renderer_free(&portrait->renderer);
  ern_clip_free(&portrait->clip);
  speech_model_close(&portrait->source.speech_model);
  if (portrait->lent == NULL) ern_model_free(&portrait->model);
}

const float *portrait_refined(const struct portrait *portrait, const struct frame_source *frame_source, size_t k,
                              float refined[16]) {
  const struct source_frame *from = frame_source_before(frame_source, k), *to = frame_source_after(frame_source, k);
  float second[16];
  if (!frame_source_refines(&portrait->info, &portrait->clip_info)) return NULL;
  ern_camera_pose(refined, from->pose.matrix, portrait->scale);
  frame_source_refine(frame_source, portrait->model, from, refined);
  if (from == to) return refined;
  ern_camera_pose(second, to->pose.matrix, portrait->scale);
  frame_source_refine(frame_source, portrait->model, to, second);
  ern_pose_interpolate(refined, refined, second, (double)frame_source->source_frame[k].toward);
  return refined;
}

int portrait_features(struct portrait *portrait, struct session *session, const char *path, ern_features *features) {
  ern_speech_network *network = portrait->source.speech_model.network;
  const char *kind = portrait_speech(portrait);
  if (network == NULL && ern_speech_is_sound(path) && ern_speech_width(kind) == 0)
    return portrait_refuse_sound(portrait, session);
  const ern_status status = network != NULL ? ern_speech_network_features(network, path, features)
                                            : ern_speech_open(session->context, path, kind, features);
  return status == ERN_OK ? 0 : speech_model_fail(session, status);
}

const char *portrait_kind(const struct portrait *portrait) { return portrait->info.has_torso ? "head+torso" : "head"; }

static int encode_earlier_frames(const struct portrait *portrait, struct session *session,
                                 const struct frame_source *frame_source, const ern_features *features) {
  const size_t values = (size_t)AUDIO_WINDOWS * (size_t)features->window_length * (size_t)features->width;
  const size_t begin =
      portrait->frames.begin < frame_source->count ? (size_t)portrait->frames.begin : frame_source->count;
  ern_status status = ERN_OK;
  float *windows = malloc(values * sizeof *windows);
  if (windows == NULL) return session_fail_with(session, "no memory for a window of speech");
  for (size_t k = 0; k < begin && status == ERN_OK && !session_interrupted(); k++) {
    frame_source_windows(frame_source, k, features, (ern_audio_pad)portrait->audio_pad, windows);
    status = ern_renderer_skip(portrait->renderer, windows, features->window_length);
  }
  free(windows);
  return status == ERN_OK ? 0 : session_fail(session);
}

int portrait_cut(const struct portrait *portrait, struct session *session, const struct args *args,
                 struct frame_source *frame_source, const ern_features *features) {
  int status = 0;
  if (!args_given(args, "frames")) return 0;
  if (portrait->render.smooth_lips) status = encode_earlier_frames(portrait, session, frame_source, features);
  return status == 0 ? frame_source_cut(frame_source, args, &portrait->frames) : status;
}
