/* SPDX-License-Identifier: MIT
 * ernerf dub: a recorded video in which the person says new words. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "dub/dubbed_frame.h"
#include "dub/recorded_video.h"
#include "dub/spliced_sound.h"
#include "dub/turning_path.h"
#include "ernerf/speech.h"
#include "output/label.h"
#include "output/provenance_output.h"
#include "output/sink.h"
#include "output/watermark_output.h"
#include "session/portrait.h"
#include "session/progress.h"
#include "session/silence_pose.h"
#include "verbs.h"

enum { AUDIO_WINDOWS = 8, OWN_OPTIONS = 7 };

struct dub_job {
  struct session session;
  struct portrait portrait;
  struct silence_pose silence_pose;
  struct provenance provenance;
  struct label label;
  struct watermark watermark;
  /* from the command line */
  const char *video_path, *audio, *out;
  float from, to; /* seconds of the video; to: 0 for the clip's end */
  int cut;        /* whether the output ends with the words */
  bool counted;   /* --frames: the output is a segment, whose frames are numbered as those of the whole */
  /* made */
  struct recorded_video video;
  struct sink sink;
  struct frame_source frame_source;
  struct frame_source clip_frames; /* all of the clip */
  struct source_frame shown;       /* what the recorded frame that is drawn on shows: between two of clip_frames */
  struct rate rate;
  ern_features features; /* of --audio */
  ern_sound sound;       /* of --audio */
  ern_sound spliced;     /* the words and the rest of the recorded sound; empty: `sound` is all */
  size_t begin, turns;   /* the clip's frame that is shown first; how often they turn back or forward */
  bool steady;           /* they neither turn nor stand still */
  size_t rest;           /* frames of the output after the words, as recorded */
  float *windows;
  struct dubbed_frame dubbed;
  bool in_place;      /* outside `region` the recorded pixels of a plain frame are coded as they were decoded */
  int region[4];      /* x, y, width, height of what is composed, pixels of the video: the box, or all */
  ern_image recorded; /* the region of a recorded frame */
  size_t left;        /* frames that were left as recorded */
};

/* ---- opening ----------------------------------------------------------------------------------------------------- */

static void own_options(struct dub_job *job, struct option options[OWN_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_TEXT("clip", &job->portrait.source.path), .choices = "CLIP",
       .help = "the clip that `ernerf prepare` made of VIDEO, and that MODEL was trained on"},
      {ARGS_TEXT("audio", &job->audio), .alias = "aud", .choices = "SOUND",
       .help =
           "the new words: a sound (wav, mp3, mp4 ...); where they last longer than the video, it is shown backward "
           "and forward"},
      {ARGS_CHOICE("rest", &job->cut, "recorded|cut"),
       .help = "what follows where the words end before the video: recorded: the rest of it as it was recorded, with "
               "its sound; cut: nothing (default recorded)"},
      {ARGS_FLOAT("from", &job->from, 0, 1e6), .choices = "SECONDS",
       .help = "where in VIDEO to begin (default: where the clip begins)"},
      {ARGS_FLOAT("to", &job->to, 0, 1e6), .choices = "SECONDS",
       .help = "where in VIDEO to end (default: where the clip ends)"},
      {ARGS_TEXT("o", &job->out), .alias = "output", .choices = "OUT", .help = "NAME.mp4, .mov or .mkv"},
      {ARGS_CHOICE("progress", &job->session.progress_form, "words|json"),
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
  int status = -1;
  if (args_given(args, "frames"))
    status = args_forbid(args, "rest from to", "is not with --frames, which chooses frames of the new words");
  if (status < 0) status = args_forbid(args, "split", "chooses frames of the clip, and a dubbed video has them all");
  if (status < 0) status = args_forbid(args, "torso torso-shrink", "is about the torso, which stays as recorded");
  if (status < 0) status = sink_choose(&job->sink, args, job->out);
  if (status < 0 && !args_given(args, "codec") && !args_given(args, "crf") && !args_given(args, "preset"))
    sink_code_fast(&job->sink);
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

/* *begin, *end: the clip's frames from --from up to --to. */
static int choose_part(struct dub_job *job, const struct args *args, size_t *begin, size_t *end) {
  const size_t count = job->frame_source.count;
  const double clip = job->video.from, last = clip + (double)count / RATE_CLIP;
  const double from = args_given(args, "from") ? (double)job->from : clip;
  const double to = args_given(args, "to") ? (double)job->to : last;
  const double first = round((from - clip) * RATE_CLIP), past = round((to - clip) * RATE_CLIP);
  if (!(first >= 0) || !(past > first) || past > (double)count)
    return args_refuse(args, "--from %.2f --to %.2f, expected a part of the seconds %.2f to %.2f of %s, which %s has",
                       from, to, clip, last, job->video_path, job->portrait.source.path);
  *begin = (size_t)first;
  *end = (size_t)past;
  return 0;
}

/* The frames of the output: poses and eyes of the clip at the video's rate, and the new words. */
static int open_frames(struct dub_job *job, const struct args *args) {
  struct session *session = &job->session;
  const size_t windows = job->features.windows;
  size_t end = 0;
  job->counted = args_given(args, "frames");
  int status = frame_source_of_clip(&job->frame_source, session, job->portrait.clip, FRAME_SOURCE_ALL);
  if (status == 0) status = recorded_video_check(session, job->portrait.source.path, &job->frame_source);
  if (status == 0) status = frame_source_of_clip(&job->clip_frames, session, job->portrait.clip, FRAME_SOURCE_ALL);
  if (status == 0) status = choose_part(job, args, &job->begin, &end);
  if (status != 0) return status;
  size_t *order = malloc(windows * sizeof *order); /* frames of the clip */
  if (order == NULL) return session_fail_with(session, "no memory for %zu frames", windows);
  job->turns = turning_path(job->portrait.clip, job->frame_source.source_frame, job->begin, end, windows, order);
  if (job->turns > 0) status = recorded_video_keep(&job->video, session);
  if (status == 0) status = frame_source_replay(&job->frame_source, session, windows, order);
  job->steady = order[windows - 1] == job->begin + windows - 1;
  free(order);
  if (status == 0) status = frame_source_resample(&job->frame_source, session, job->rate, &job->features);
  if (status == 0 && !job->cut && !job->counted && end - job->begin > windows)
    job->rest = rate_frames(job->rate, end - job->begin) - job->frame_source.count;
  return status == 0 ? portrait_cut(&job->portrait, session, args, &job->frame_source, &job->features) : status;
}

static double synthetic_seconds(const struct dub_job *job) {
  return (double)job->frame_source.count / rate_value(job->rate);
}

/* The new words; where recorded frames follow them, the recorded sound too. */
static int open_sound(struct dub_job *job) {
  struct session *session = &job->session;
  const struct recorded_video *video = &job->video;
  if (job->rest > 0 && video->info.has_sound) {
    const double words = synthetic_seconds(job),
                 begin = video->first + video->from + (double)job->begin / RATE_CLIP - video->info.start;
    return spliced_sound_read(session, job->audio, words, job->video_path, begin + words,
                              (double)job->rest / rate_value(job->rate), &job->spliced);
  }
  return ern_sound_read(session->context, job->audio, &job->sound) == ERN_OK ? 0 : session_fail(session);
}

/* Whether this frame, which may have another form than the one before, is coded as it was decoded, and its box is
 * composed (choose_box); else all of it is. */
static bool is_in_place(struct dub_job *job, const ern_video_frame *recorded) {
  const ern_video_info *info = &job->video.info;
  if (job->in_place && ern_video_frame_is_plain(recorded)) return true;
  memcpy(job->region, (const int[4]){0, 0, info->width, info->height}, sizeof job->region);
  return false;
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
  if (status == 0)
    status = dubbed_frame_open(&job->dubbed, session, portrait->clip, portrait->source.path, job->video.square);
  if (status == 0) status = open_features(job);
  if (status == 0) status = silence_pose_open(&job->silence_pose, session, portrait, &job->features);
  if (status == 0) status = open_frames(job, args);
  if (status == 0) status = portrait_prune_occupancy(portrait, session, &job->frame_source, &job->features);
  if (status == 0) status = open_sound(job);
  const ern_video_info *info = &job->video.info;
  snprintf(job->provenance.description, sizeof job->provenance.description,
           "a trained model drew the mouth from 0 s to %.2f s over a recorded video", synthetic_seconds(job));
  if (status == 0) status = provenance_learn(&job->provenance, session, portrait, job->audio, false);
  if (status == 0) status = label_make(&job->label, session, info->width, info->height);
  if (status == 0) status = watermark_make(&job->watermark, session, info->width, info->height);
  if (status == 0) status = session_check_inputs_kept(session);
  if (status != 0) return status;
  if (info->other_streams[0] != 0)
    session_warn(session, "%s: %s: not in the output, which has the recorded pictures and one sound", job->video_path,
                 info->other_streams);
  job->in_place = sink_takes_recorded(&job->sink) && job->label.pixels == NULL && job->watermark.pattern == NULL;
  job->sink.pixel_aspect = info->pixel_aspect;
  return sink_open(&job->sink, session, info->width, info->height, job->rate, &portrait->info,
                   job->spliced.data != NULL ? &job->spliced : &job->sound, frame_source_seconds(&job->frame_source, 0),
                   provenance_of(&job->provenance));
}

/* ---- drawing ----------------------------------------------------------------------------------------------------- */

/* Seconds of the whole output before frame k. */
static double seconds_of(const struct dub_job *job, size_t k) {
  return (double)job->frame_source.source_frame[k].number / rate_value(job->rate);
}

/* The clip's second whose recorded frame frame k of the output shows. */
static double recorded_second(const struct dub_job *job, size_t k) {
  const double began = (double)job->begin / RATE_CLIP;
  if (k >= job->frame_source.count) return began + (double)k / rate_value(job->rate);
  if (job->steady) return began + seconds_of(job, k);
  return recorded_video_second(&job->frame_source, k);
}

/* The shown frame as the only one of a source. */
static struct frame_source shown_alone(struct dub_job *job) {
  struct frame_source alone = job->clip_frames;
  alone.frame = alone.source_frame;
  alone.source_frame = &job->shown;
  alone.count = 1;
  return alone;
}

/* The words of frame k over job->recorded, the region of the shown frame, into rgba. */
static ern_status compose(struct dub_job *job, size_t k, uint8_t *rgba) {
  const struct frame_source *frame_source = &job->frame_source, shown = shown_alone(job);
  struct dubbed_frame *dubbed = &job->dubbed;
  int square[4];
  float refined[16];
  memcpy(square, job->video.square, sizeof square);
  for (int c = 0; c < 2; c++) square[c] -= job->region[c];
  frame_source_windows(frame_source, k, &job->features, (ern_audio_pad)job->portrait.audio_pad, job->windows);
  const ern_frame_input whole = {
      .camera = frame_source_camera(&shown, 0, job->portrait.scale, dubbed->size[0], dubbed->size[1], ERN_FIT_CONTAIN),
      .head_pose = portrait_refined(&job->portrait, &shown, 0, refined),
      .windows = job->windows,
      .window_length = job->features.window_length,
      .eye = job->shown.eye,
      .individual = ERN_INDIVIDUAL_MEAN,
      .silence_code = job->silence_pose.code,
      .silence_weight = silence_pose_weight(&job->silence_pose, frame_source, k)};
  return dubbed_frame_draw(dubbed, job->portrait.renderer, &shown, 0, &whole, &job->recorded, square, rgba, NULL);
}

/* job->region = the box of the shown frame, grown to even numbers; no width: there is none. */
static int choose_box(struct dub_job *job, size_t k) {
  const ern_video_info *info = &job->video.info;
  const struct frame_source shown = shown_alone(job);
  int *region = job->region, box[4];
  if (dubbed_frame_box(&job->dubbed, &shown, 0, info->width, info->height, job->video.square, box) != ERN_OK)
    return session_fail_with(&job->session, "frame %zu: %s", k, ern_last_error(job->session.context));
  for (int c = 0; c < 2; c++) {
    region[c] = box[c] & ~1;
    region[c + 2] = box[c + 2] > 0 ? ((box[c] + box[c + 2] + 1) & ~1) - region[c] : 0;
  }
  return 0;
}

/* The region of a recorded frame, into job->recorded. */
static int read_region(struct dub_job *job, const ern_video_frame *recorded, bool in_place) {
  return recorded_video_rgb(&job->video, &job->session, recorded, in_place ? job->region : NULL, &job->recorded);
}

static int draw(struct dub_job *job, size_t k, const ern_video_frame *recorded) {
  struct session *session = &job->session;
  ern_frame_output output;
  const struct frame_source *clip = &job->clip_frames;
  job->shown = frame_source_between(clip->source_frame, recorded_video_place(&job->video, clip->count), k);
  const bool in_place = is_in_place(job, recorded);
  if (in_place && choose_box(job, k) != 0) return EXIT_FAILURE;
  const bool any = job->region[2] > 0;
  if (any && read_region(job, recorded, in_place) != 0) return EXIT_FAILURE;
  if (sink_next(&job->sink, session, &output) != 0) return EXIT_FAILURE;
  if (any && compose(job, k, output.rgba) != ERN_OK)
    return session_fail_with(session, "frame %zu: %s", k, ern_last_error(session->context));
  const bool drawn = any && job->dubbed.box[2] > 0;
  job->left += !drawn;
  if (in_place) return sink_put_patched(&job->sink, session, recorded, drawn ? job->region : (const int[4]){0});
  if (watermark_put(&job->watermark, session, output.rgba) != 0) return EXIT_FAILURE;
  label_put(&job->label, seconds_of(job, k), output.rgba, job->video.info.width);
  sink_put(&job->sink, job->frame_source.source_frame[k].number);
  return 0;
}

/* A frame after the words. */
static int copy_recorded(struct dub_job *job, size_t k, const ern_video_frame *recorded) {
  struct session *session = &job->session;
  ern_frame_output output;
  if (sink_next(&job->sink, session, &output) != 0) return EXIT_FAILURE;
  const bool in_place = is_in_place(job, recorded);
  if (in_place) return sink_put_patched(&job->sink, session, recorded, (const int[4]){0});
  if (read_region(job, recorded, in_place) != 0) return EXIT_FAILURE;
  const size_t pixels = (size_t)job->recorded.width * (size_t)job->recorded.height;
  for (size_t i = 0; i < pixels; i++) {
    memcpy(output.rgba + 4 * i, job->recorded.data + 3 * i, 3);
    output.rgba[4 * i + 3] = 255;
  }
  sink_put(&job->sink, k);
  return 0;
}

/* Content of the provenance file: which seconds have a synthetic mouth. */
static json_t *about_output(const struct dub_job *job, size_t frames) {
  const char *slash = strrchr(job->out, '/'), *folder = strrchr(job->video_path, '/');
  char rate[RATE_TEXT_BYTES];
  rate_words(job->rate, rate);
  const json_int_t first = (json_int_t)job->frame_source.source_frame[0].number;
  return json_pack("{s:o, s:o*, s:I, s:s, s:i, s:i, s:b, s:o, s:[[o,o]]}", "output",
                   session_text(slash != NULL ? slash + 1 : job->out), "first_frame",
                   job->counted ? json_integer(first) : NULL, "frames", (json_int_t)frames, "rate", rate, "width",
                   job->video.info.width, "height", job->video.info.height, "sound", 1, "recorded",
                   session_text(folder != NULL ? folder + 1 : job->video_path), "synthetic_seconds", session_number(0),
                   session_number(synthetic_seconds(job)));
}

static int draw_all(struct dub_job *job) {
  struct session *session = &job->session;
  struct progress progress;
  const size_t words = job->frame_source.count, count = words + job->rest;
  const double began = session_seconds();
  char rate[RATE_TEXT_BYTES];
  rate_words(job->rate, rate);
  session_note(session, "dub: %zu frames of %d x %d, %s a second, the square of %d pixels at %d, %d, %s (%s) to %s",
               count, job->video.info.width, job->video.info.height, rate, job->dubbed.size[0], job->video.square[0],
               job->video.square[1], session->backend_info.name, session->backend_info.isa, job->out);
  progress_begin(&progress, session, "dub", "frames");
  for (size_t k = 0; k < count; k++) {
    const ern_video_frame *recorded = NULL;
    if (session_interrupted())
      return session_stop_with(session, "stopped at frame %zu of %zu, no video was written", k, count);
    if (recorded_video_frame(&job->video, session, recorded_second(job, k), &recorded) != 0) return EXIT_FAILURE;
    if (recorded == NULL)
      return session_fail_with(session, "%s: ends before frame %zu of %zu", job->video_path, k, count);
    if ((k < words ? draw(job, k, recorded) : copy_recorded(job, k, recorded)) != 0) return EXIT_FAILURE;
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
                 job->left, words);
  session_note(session, "dub: %zu frames in %.2f s, %.2f a second with reading and writing: %s", count, seconds,
               (double)count / seconds, job->out);
  return session_report(
      session, json_pack("{s:o, s:s, s:I, s:I, s:I, s:I, s:i, s:i, s:s, s:o, s:o, s:s, s:s}", "output",
                         session_text(job->out), "rate", rate, "frames", (json_int_t)count, "left",
                         (json_int_t)job->left, "rest", (json_int_t)job->rest, "turns", (json_int_t)job->turns, "width",
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
  free(job->spliced.data);
  dubbed_frame_close(&job->dubbed);
  frame_source_free(&job->frame_source);
  frame_source_free(&job->clip_frames);
  recorded_video_close(&job->video);
  ern_image_free(job->session.context, &job->recorded);
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
          "The output has the size and rate of VIDEO, and begins where the clip begins.\n"
          "Outside the lower face each frame is the recorded one, re-encoded: without --codec, --crf and preset\n"
          "with preset superfast and --crf 16, which is faster than the defaults of these options.",
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
  args_unlist(&args, "split torso torso-shrink format");
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
