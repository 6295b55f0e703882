/* SPDX-License-Identifier: MIT
 * ernerf dub: a recorded video in which the person says new words. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "dub/recorded_video.h"
#include "ernerf/speech.h"
#include "output/label.h"
#include "output/progress.h"
#include "output/provenance_output.h"
#include "output/sink.h"
#include "output/watermark_output.h"
#include "session/portrait.h"
#include "session/silence_pose.h"
#include "verbs.h"

enum { AUDIO_WINDOWS = 8, OWN_OPTIONS = 4 };

struct dub_job {
  struct session session;
  struct portrait portrait;
  struct silence_pose silence_pose;
  struct provenance provenance;
  struct label label;
  struct watermark watermark;
  /* from the command line */
  const char *video_path, *audio, *out;
  /* made */
  struct recorded_video video;
  struct sink sink;
  struct frame_source frame_source;
  struct rate rate;
  ern_features features; /* of --audio */
  ern_sound sound;
  float *windows, *opacity; /* opacity: [side][side] */
  uint8_t *head;            /* [side][side][4] */
  int side;                 /* of the whole square, as it would be rendered, pixels */
  float scale[2];           /* rendered pixels a pixel of the video, across and down */
  size_t left;              /* frames that were left as recorded */
};

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static void own_options(struct dub_job *job, struct option options[OWN_OPTIONS]) {
  const struct option rows[] = {
      {.name = "clip",
       .kind = OPTION_TEXT,
       .target = &job->portrait.source.path,
       .choices = "CLIP",
       .help = "the clip that `ernerf prepare` made of VIDEO, and that MODEL was trained on"},
      {.name = "audio",
       .alias = "aud",
       .kind = OPTION_TEXT,
       .target = &job->audio,
       .choices = "SOUND",
       .help = "the new words: a sound (wav, mp3, mp4 ...), no longer than the clip; the output is as long"},
      {.name = "o",
       .alias = "output",
       .kind = OPTION_TEXT,
       .target = &job->out,
       .choices = "OUT",
       .help = "NAME.mp4, .mov or .mkv"},
      {.name = "progress",
       .kind = OPTION_CHOICE,
       .target = &job->session.progress_form,
       .choices = "words|json",
       .help = "form of the progress on standard error: words, or for programs a JSON object a line, twice a second "
               "and at the end, also with --quiet (default words)"}};
  ARGS_FILL(options, rows, OWN_OPTIONS);
}

static int check_usage(struct dub_job *job, const struct args *args) {
  if (job->portrait.source.path == NULL) return args_refuse(args, "--clip CLIP is missing");
  if (job->audio == NULL) return args_refuse(args, "--audio SOUND is missing");
  if (!ern_speech_is_sound(job->audio))
    return args_refuse(args, "--audio is %s, expected a sound: the output has it", job->audio);
  if (job->out == NULL) return args_refuse(args, "-o OUT is missing");
  int status = args_forbid(args, "split", "chooses frames of the clip, and a dubbed video has them all");
  if (status < 0) status = args_forbid(args, "torso_shrink", "is about the torso, which stays as recorded");
  if (status < 0) status = sink_choose(&job->sink, args, job->out);
  if (status < 0 && job->sink.kind != SINK_VIDEO)
    status = args_refuse(args, "-o is %s, expected a video: NAME.mp4, .mov or .mkv", job->out);
  if (status < 0 && !sink_has_sound(&job->sink))
    status = args_refuse(args, "-o is %s, a file that holds no sound, expected NAME.mp4, .mov or .mkv", job->out);
  if (status < 0) status = label_check(&job->label, args);
  return status < 0 ? watermark_check(&job->watermark, args) : status;
}

static int open_features(struct dub_job *job) {
  struct session *session = &job->session;
  if (portrait_features(&job->portrait, session, job->audio, &job->features) != 0) return EXIT_FAILURE;
  speech_model_close(&job->portrait.source.speech_model);
  if (ern_renderer_accepts(job->portrait.renderer, &job->features, job->audio) != ERN_OK) return session_fail(session);
  job->windows =
      malloc((size_t)AUDIO_WINDOWS * (size_t)job->features.window_length * (size_t)job->features.width * sizeof(float));
  return job->windows != NULL ? 0 : session_fail_with(session, "no memory for windows of %s", job->audio);
}

/* That of the video, where a file may have it. */
static void choose_rate(struct dub_job *job) {
  job->rate = (struct rate){job->video.info.rate_numerator, job->video.info.rate_denominator};
  if (rate_value(job->rate) >= 1 && rate_value(job->rate) <= 240) return;
  session_warn(&job->session, "%s: %d/%d frames a second, expected 1 to 240: the output has %d", job->video_path,
               job->rate.numerator, job->rate.denominator, RATE_CLIP);
  job->rate = (struct rate){RATE_CLIP, 1};
}

/* The frames of the output: poses and eyes of the clip at the video's rate, and the new words. */
static int open_frames(struct dub_job *job, const struct args *args) {
  struct session *session = &job->session;
  int status = frame_source_of_clip(&job->frame_source, session, job->portrait.clip, FRAME_SOURCE_ALL);
  if (status != 0) return status;
  const double there = (double)job->frame_source.count / RATE_CLIP, words = (double)job->features.windows / RATE_CLIP;
  if (job->features.windows > job->frame_source.count)
    return session_fail_with(session, "%s: the new words last %.2f s, expected at most the %.2f s of %s", job->audio,
                             words, there, job->portrait.source.path);
  status = frame_source_replay(&job->frame_source, session, job->features.windows);
  if (status == 0) status = frame_source_resample(&job->frame_source, session, job->rate, &job->features);
  return status == 0 ? portrait_cut(&job->portrait, session, args, &job->frame_source, &job->features) : status;
}

/* The head is rendered in the square's own pixels, but in no more than it was trained on: more cost time and show
 * nothing new. */
static int open_pictures(struct dub_job *job) {
  const int *square = job->video.square, trained = job->portrait.clip_info.width;
  job->side = square[3] < trained ? square[3] : trained;
  job->scale[0] = (float)job->side / (float)square[2];
  job->scale[1] = (float)job->side / (float)square[3];
  const size_t pixels = ((size_t)job->side + 1) * ((size_t)job->side + 1); /* a part may be rounded up */
  job->head = malloc(pixels * 4);
  job->opacity = malloc(pixels * sizeof *job->opacity);
  if (job->head == NULL || job->opacity == NULL)
    return session_fail_with(&job->session, "no memory for a head of %d x %d", job->side, job->side);
  return 0;
}

static int open_all(struct dub_job *job, const struct args *args) {
  struct session *session = &job->session;
  struct portrait *portrait = &job->portrait;
  if (!session_folder_there(job->out)) return session_fail_with(session, "%s: its folder is not there", job->out);
  portrait->other_speech = portrait->dubs = portrait->render.no_torso = true;
  int status = sink_check(&job->sink, session, NULL);
  if (status == 0) status = provenance_check(&job->provenance, session, job->out);
  if (status == 0) status = recorded_video_open(&job->video, session, job->video_path, portrait->source.path);
  if (status == 0) {
    choose_rate(job);
    portrait->render.frame_rate = (float)rate_value(job->rate);
    status = portrait_open(portrait, session, args);
  }
  if (status == 0 && !portrait->clip_info.has_landmarks)
    status = session_fail_with(session, "%s: has no landmarks (ori_imgs/ID.lms), which place the mouth",
                               portrait->source.path);
  if (status == 0) status = open_features(job);
  if (status == 0) status = silence_pose_open(&job->silence_pose, session, portrait, &job->features);
  if (status == 0) status = open_frames(job, args);
  if (status == 0) status = portrait_prune_occupancy(portrait, session, &job->frame_source, &job->features);
  if (status == 0) status = open_pictures(job);
  if (status == 0 && ern_sound_read(session->context, job->audio, &job->sound) != ERN_OK)
    status = session_fail(session);
  const ern_video_info *info = &job->video.info;
  if (status == 0) status = provenance_learn(&job->provenance, session, portrait, job->audio, false);
  if (status == 0) status = label_make(&job->label, session, info->width, info->height);
  if (status == 0) status = watermark_make(&job->watermark, session, info->width, info->height);
  if (status != 0) return status;
  return sink_open(&job->sink, session, info->width, info->height, job->rate, &portrait->info, &job->sound,
                   frame_source_seconds(&job->frame_source, 0), provenance_of(&job->provenance));
}

/* ---- drawing ----------------------------------------------------------------------------------------------------- */

/* Seconds of the whole output before frame k. */
static double seconds_of(const struct dub_job *job, size_t k) {
  return (double)job->frame_source.source_frame[k].number / rate_value(job->rate);
}

/* The camera of frame k for the part of the frame in `box`. */
static ern_camera camera_of(const struct dub_job *job, size_t k, const int box[4]) {
  const int *square = job->video.square;
  ern_camera camera =
      frame_source_camera(&job->frame_source, k, job->portrait.scale, job->side, job->side, ERN_FIT_CONTAIN);
  camera.cx -= (float)(box[0] - square[0]) * job->scale[0];
  camera.cy -= (float)(box[1] - square[1]) * job->scale[1];
  camera.width = (int)ceilf((float)box[2] * job->scale[0]);
  camera.height = (int)ceilf((float)box[3] * job->scale[1]);
  camera.frame.left = -(int)lroundf((float)(box[0] - square[0]) * job->scale[0]); /* the whole square, for the torso */
  camera.frame.top = -(int)lroundf((float)(box[1] - square[1]) * job->scale[1]);
  camera.frame.right = camera.frame.left + job->side;
  camera.frame.bottom = camera.frame.top + job->side;
  return camera;
}

/* The head of frame k in the box: its colours, and its own opacity as alpha, which a torso of the model has no part
 * in. */
static ern_status draw_head(struct dub_job *job, size_t k, const ern_camera *camera) {
  const struct frame_source *frame_source = &job->frame_source;
  float refined[16];
  frame_source_windows(frame_source, k, &job->features, (ern_audio_pad)job->portrait.audio_pad, job->windows);
  const ern_frame_input input = {.camera = *camera,
                                 .head_pose = portrait_refined(&job->portrait, frame_source, k, refined),
                                 .windows = job->windows,
                                 .window_length = job->features.window_length,
                                 .eye = frame_source->source_frame[k].eye,
                                 .individual = ERN_INDIVIDUAL_MEAN,
                                 .silence_code = job->silence_pose.code,
                                 .silence_weight = silence_pose_weight(&job->silence_pose, frame_source, k)};
  const ern_frame_output output = {.rgba = job->head, .opacity = job->opacity};
  const ern_status status = ern_renderer_frame(job->portrait.renderer, &input, &output, NULL);
  const size_t pixels = (size_t)camera->width * (size_t)camera->height;
  for (size_t i = 0; status == ERN_OK && i < pixels; i++)
    job->head[4 * i + 3] = (uint8_t)(255 * job->opacity[i] + 0.5F);
  return status;
}

/* The recorded landmarks at the time of frame k, in shares of the square. */
static void place_landmarks(const struct dub_job *job, size_t k, float landmarks[68][2]) {
  const struct source_frame *before = frame_source_before(&job->frame_source, k),
                            *after = frame_source_after(&job->frame_source, k);
  const ern_clip_frame *from = ern_clip_frame_at(job->portrait.clip, before->split, before->index),
                       *to = ern_clip_frame_at(job->portrait.clip, after->split, after->index);
  const float toward = job->frame_source.source_frame[k].toward;
  const float size[2] = {(float)job->portrait.clip_info.width, (float)job->portrait.clip_info.height};
  for (int i = 0; i < 68; i++)
    for (int c = 0; c < 2; c++)
      landmarks[i][c] = (from->landmarks[i][c] + toward * (to->landmarks[i][c] - from->landmarks[i][c])) / size[c];
}

/* Frame k over the recorded picture into rgba. */
static ern_status compose(struct dub_job *job, size_t k, const ern_image *recorded, uint8_t *rgba) {
  const struct source_frame *frame = &job->frame_source.source_frame[k];
  ern_context *context = job->session.context;
  ern_image head = {0};
  bool drawn = false;
  ern_dub_input input = {.recorded = recorded->data, .width = recorded->width, .height = recorded->height};
  memcpy(input.square, job->video.square, sizeof input.square);
  place_landmarks(job, k, input.landmarks);
  ern_status status = ern_clip_head(job->portrait.clip, frame->split, frame->index, &head);
  input.recorded_head = head.data != NULL ? &head : NULL;
  if (status == ERN_OK) status = ern_dub_box(context, &input, input.box);
  if (status == ERN_OK && input.box[2] > 0) {
    const ern_camera camera = camera_of(job, k, input.box);
    status = draw_head(job, k, &camera);
    input.head = job->head;
    input.head_width = camera.width;
    input.head_height = camera.height;
    memcpy(input.head_scale, job->scale, sizeof input.head_scale);
  }
  if (status == ERN_OK) status = ern_dub_frame(context, &input, rgba, &drawn);
  if (!drawn) job->left++;
  return status;
}

static int draw(struct dub_job *job, size_t k, const ern_image *recorded) {
  ern_frame_output output;
  if (recorded->width != job->video.info.width || recorded->height != job->video.info.height)
    return session_fail_with(&job->session, "%s: a picture has %d x %d pixels, the first one %d x %d", job->video_path,
                             recorded->width, recorded->height, job->video.info.width, job->video.info.height);
  if (sink_next(&job->sink, &job->session, &output) != 0) return EXIT_FAILURE;
  if (compose(job, k, recorded, output.rgba) != ERN_OK)
    return session_fail_with(&job->session, "frame %zu: %s", k, ern_last_error(job->session.context));
  if (watermark_put(&job->watermark, &job->session, output.rgba) != 0) return EXIT_FAILURE;
  label_put(&job->label, seconds_of(job, k), output.rgba, recorded->width);
  sink_put(&job->sink, job->frame_source.source_frame[k].number);
  return 0;
}

/* Content of the provenance file: which seconds have a synthetic mouth. */
static json_t *about_output(const struct dub_job *job, size_t frames) {
  const char *slash = strrchr(job->out, '/'), *folder = strrchr(job->video_path, '/');
  char rate[RATE_TEXT_BYTES];
  rate_words(job->rate, rate);
  return json_pack("{s:o, s:I, s:s, s:i, s:i, s:b, s:o, s:[[o,o]]}", "output",
                   session_text(slash != NULL ? slash + 1 : job->out), "frames", (json_int_t)frames, "rate", rate,
                   "width", job->video.info.width, "height", job->video.info.height, "sound", 1, "recorded",
                   session_text(folder != NULL ? folder + 1 : job->video_path), "synthetic_seconds", session_number(0),
                   session_number((double)frames / rate_value(job->rate)));
}

static int draw_all(struct dub_job *job) {
  struct session *session = &job->session;
  struct progress progress;
  const size_t count = job->frame_source.count;
  const double began = session_seconds();
  char rate[RATE_TEXT_BYTES];
  rate_words(job->rate, rate);
  session_note(session, "dub: %zu frames of %d x %d, %s a second, the square of %d pixels at %d, %d, %s (%s) to %s",
               count, job->video.info.width, job->video.info.height, rate, job->side, job->video.square[0],
               job->video.square[1], session->backend_info.name, session->backend_info.isa, job->out);
  progress_begin(&progress, session, "dub", "frames");
  for (size_t k = 0; k < count; k++) {
    const ern_image *recorded = NULL;
    if (session_interrupted())
      return session_stop_with(session, "stopped at frame %zu of %zu, no video was written", k, count);
    if (recorded_video_frame(&job->video, session, seconds_of(job, k), &recorded) != 0) return EXIT_FAILURE;
    if (recorded == NULL)
      return session_fail_with(session, "%s: ends before frame %zu of %zu", job->video_path, k, count);
    if (draw(job, k, recorded) != 0) return EXIT_FAILURE;
    progress_at(&progress, k + 1, count, "");
  }
  if (sink_close(&job->sink, session) != 0) return EXIT_FAILURE;
  if (provenance_write(&job->provenance, session, about_output(job, count)) != 0) return EXIT_FAILURE;
  progress_end(&progress);
  const double seconds = session_seconds() - began;
  if (job->left > 0)
    session_warn(session,
                 "%zu of %zu frames are left as recorded: the face is too small or too near the edge, or the "
                 "model has no head there",
                 job->left, count);
  session_note(session, "dub: %zu frames in %.2f s, %.2f a second with reading and writing: %s", count, seconds,
               (double)count / seconds, job->out);
  return session_report(
      session, json_pack("{s:o, s:s, s:I, s:I, s:i, s:i, s:s, s:o, s:o, s:s, s:s}", "output", session_text(job->out),
                         "rate", rate, "frames", (json_int_t)count, "left", (json_int_t)job->left, "width",
                         job->video.info.width, "height", job->video.info.height, "kind", portrait_kind(&job->portrait),
                         "seconds", session_number(seconds), "fps", session_number((double)count / seconds), "backend",
                         session->backend_info.name, "isa", session->backend_info.isa));
}

static void close_all(struct dub_job *job) {
  sink_free(&job->sink);
  provenance_free(&job->provenance);
  label_free(&job->label);
  watermark_free(&job->watermark);
  silence_pose_free(&job->silence_pose);
  free(job->windows);
  free(job->opacity);
  free(job->head);
  frame_source_free(&job->frame_source);
  recorded_video_close(&job->video, &job->session);
  ern_sound_free(job->session.context, &job->sound);
  ern_features_free(job->session.context, &job->features);
  portrait_close(&job->portrait);
  session_close(&job->session);
}

int cmd_dub(int argc, char **argv) {
  struct dub_job job = {0};
  struct option own[OWN_OPTIONS + SINK_OPTIONS + PROVENANCE_OPTIONS + LABEL_OPTIONS + WATERMARK_OPTIONS],
      shared[PORTRAIT_OPTIONS], silence[SILENCE_POSE_OPTIONS], common[SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS];
  struct word words[] = {{"MODEL", &job.portrait.model_path, "a .safetensors or .pth file: a head, or head and torso"},
                         {"VIDEO", &job.video_path, "the recorded video that the clip was prepared from"}};
  struct args args = {
      .verb = "dub",
      .summary = "Lets the person in a recorded video say new words: its frames, with a new mouth and sound.",
      .usage = "dub MODEL VIDEO --clip CLIP --audio SOUND -o out.mp4",
      .notes =
          "The output has the size and rate of VIDEO, begins where the clip begins, and ends with the new words.\n"
          "Outside the lower face each frame is the recorded one, coded anew.",
      .words = words,
      .word_count = 2,
      .groups = {{"What is said, and where to:", own,
                  OWN_OPTIONS + SINK_OPTIONS + PROVENANCE_OPTIONS + LABEL_OPTIONS + WATERMARK_OPTIONS},
                 {"Mouth:", silence, SILENCE_POSE_OPTIONS},
                 {"How:", shared, PORTRAIT_OPTIONS},
                 {"Common:", common, SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS}}};
  own_options(&job, own);
  sink_options(&job.sink, own + OWN_OPTIONS);
  provenance_options(&job.provenance, own + OWN_OPTIONS + SINK_OPTIONS);
  label_options(&job.label, own + OWN_OPTIONS + SINK_OPTIONS + PROVENANCE_OPTIONS);
  watermark_options(&job.watermark, own + OWN_OPTIONS + SINK_OPTIONS + PROVENANCE_OPTIONS + LABEL_OPTIONS);
  portrait_options(&job.portrait, FRAME_SOURCE_ALL, shared);
  silence_pose_options(&job.silence_pose, silence);
  session_compute_options(&job.session, common);
  session_output_options(&job.session, common + SESSION_COMPUTE_OPTIONS);
  args_unlist(&args, "split torso_shrink format");
  int status = args_parse(&args, argc, argv);
  if (status < 0) status = check_usage(&job, &args);
  if (status < 0) status = speech_model_check(&job.portrait.source.speech_model, &args, job.audio);
  const char *const inputs[SESSION_INPUTS] = {job.portrait.model_path,
                                              job.portrait.source.path,
                                              job.video_path,
                                              job.audio,
                                              job.portrait.source.speech_model.path,
                                              speech_model_file(&job.portrait.source.speech_model)};
  memcpy(job.session.inputs, inputs, sizeof inputs);
  if (status < 0) status = session_open(&job.session, &args);
  if (status >= 0) return status;
  status = open_all(&job, &args);
  if (status == 0) status = draw_all(&job);
  close_all(&job);
  return status;
}
