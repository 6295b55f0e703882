/* SPDX-License-Identifier: MIT
 * The options of a live portrait, whoever takes its frames, and its opening and closing. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "ernerf/speech.h"
#include "live/live_job.h"

/* Factor of speed above the frame rate: reserve for encoding and reading, and to catch up after a late frame. */
static const float SPARE = 1.15f;

enum { AUDIO_WINDOWS = 8, SOUND_RATE = 48000 };

/* ---- words ------------------------------------------------------------------------------------------------------- */

static void source_options(struct live_job *job, struct option options[LIVE_SOURCE_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_TEXT("clip", &job->portrait.source.path), .choices = "CLIP",
       .help = "folder of the clip that the model was trained on: poses, eyes, background, and how the mouth rests"},
      {ARGS_TEXT("video", &job->video.path), .choices = "VIDEO",
       .help = "the recorded video that CLIP was prepared from: its frames are shown, forward and backward, with a "
               "rendered mouth (docs/dub.md)"},
      {ARGS_INT("look-ahead", &job->look_ahead, ERN_LIVE_LEAST_LOOK_AHEAD, ERN_LIVE_LOOK_AHEAD),
       .help =
           "number of frames (40 ms each), 2 to 7, of sound after a frame that are used for it: each one less shows "
           "the frame 40 ms sooner and moves the mouth less accurately (default 7, all that the model takes)"}};
  job->look_ahead = ERN_LIVE_LOOK_AHEAD;
  ARGS_FILL(options, rows, LIVE_SOURCE_OPTIONS);
}

static void picture_options(struct live_job *job, struct option options[LIVE_PICTURE_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_DIMENSIONS("size", &job->size, 1, ERN_IMAGE_MAX_SIDE),
       .help = "size of the frames (default that of the clip; with --video that of VIDEO alone)"},
      {ARGS_CHOICE("fit", &job->fit, "contain|cover"),
       .help = "how the clip's frame goes into a --size of another aspect: contain shows all of it and continues its "
               "edges, cover fills the picture and cuts the frame (default contain)"},
      {ARGS_RATE("fps", &job->rate), .help = "frames a second, 1 to 100 (default 25)"},
      {ARGS_TEXT("bg-img", &job->background_file), .choices = "FILE|white|black",
       .help = "background (default the clip's)"},
      {ARGS_INT("crf", &job->output.crf, job->output.profile == NULL ? 0 : 1, 51),
       .help = "H.264 quality, the lower the better"},
      {ARGS_TEXT("voice", &job->sound.tts.voice), .choices = "NAME",
       .help = "espeak-ng's voice that says what --control asks for (default en)"}};
  job->rate = (struct rate){RATE_CLIP, 1};
  job->output.crf = ern_stream_options_default(1, 1).crf;
  job->sound.tts.voice = "en";
  job->sound.channels = 1;
  job->eye = -1;
  job->portrait.other_speech = true;
  ARGS_FILL(options, rows, LIVE_PICTURE_OPTIONS);
}

void live_tables_fill(struct live_tables *tables, struct live_job *job, size_t in, size_t out, struct args *args) {
  struct option *picture = tables->out + out, *common = tables->common + SESSION_COMPUTE_OPTIONS;
  const struct args groups = {
      .groups = {{"What comes in:", tables->in, in + LIVE_SOURCE_OPTIONS},
                 {"What goes out, and how fast:", tables->out, out + LIVE_OUT_OPTIONS},
                 {"Eyes, mouth and pose:", tables->control, CONTROL_OPTIONS + SILENCE_POSE_OPTIONS},
                 {"How:", tables->shared, PORTRAIT_OPTIONS},
                 {"Common:", tables->common, SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS}}};
  memcpy(args->groups, groups.groups, sizeof args->groups);
  source_options(job, tables->in + in);
  picture_options(job, picture);
  rate_control_options(&job->rate_control, picture += LIVE_PICTURE_OPTIONS);
  provenance_options(&job->provenance, picture += RATE_CONTROL_OPTIONS);
  label_options(&job->label, picture += PROVENANCE_OPTIONS);
  watermark_options(&job->watermark, picture + LABEL_OPTIONS);
  portrait_options(&job->portrait, FRAME_SOURCE_ALL, tables->shared);
  control_options(&job->control, tables->control);
  silence_pose_options(&job->silence_pose, tables->control + CONTROL_OPTIONS);
  session_compute_options(&job->session, tables->common);
  session_output_options(&job->session, common);
  args_unlist(args, "split frames eye smooth-lips speech-model speech-preset");
}

/* Refuses options of a video that do not apply to live rendering. */
static int check_unlisted(const struct args *args) {
  int status = args_forbid(args, "split frames", "is about a video; a live person has all poses");
  if (status < 0) status = args_forbid(args, "eye", "is a curve for a video of known length; --control sets eyes");
  if (status < 0)
    status = args_forbid(args, "smooth-lips", "makes a frame depend on earlier frames, which may have other settings");
  if (status < 0)
    status = args_forbid(args, "speech-model speech-preset", "needs the whole sound before the first frame");
  return status;
}

/* With --video only the mouth is rendered. */
static int check_video(struct live_job *job, const struct args *args) {
  if (job->video.path == NULL) return -1;
  job->portrait.dubs = job->portrait.render.no_torso = job->rate_control.no_stored_front = true;
  int status = args_forbid(args, "bg-img fit", "places what is not drawn with --video: the background is as recorded");
  if (status < 0)
    status = args_forbid(args, "torso torso-shrink", "is about the torso, which is as recorded with --video");
  if (status < 0)
    status = args_forbid(args, "fix-eye smooth-eye smooth-path smooth-path-window hold-pose rotate",
                         "changes pose or eyes, which are as recorded with --video");
  return status < 0 ? args_forbid(args, "front", "has times of frames without --video") : status;
}

int live_check(struct live_job *job, const struct args *args) {
  int status = check_unlisted(args);
  if (status < 0) status = check_video(job, args);
  if (status < 0 && job->size.width == 0) status = args_forbid(args, "fit", "needs --size");
  if (status < 0 && rate_value(job->rate) > 100) status = args_refuse(args, "--fps is above 100, expected 1 to 100");
  if (status < 0) status = label_check(&job->label, args);
  if (status < 0) status = watermark_check(&job->watermark, args);
  if (status < 0) status = control_check(&job->control, args);
  return status < 0 ? rate_control_check(&job->rate_control, args) : status;
}

/* ---- opening ----------------------------------------------------------------------------------------------------- */

/* Makes one period of the poses, forward and backward, and repeats its first frame, so that the last one has a
 * successor. */
static int open_poses(struct live_job *job, const struct args *args) {
  struct session *session = &job->session;
  struct frame_source *poses = &job->poses;
  int status = frame_source_of_clip(poses, session, job->portrait.clip, FRAME_SOURCE_ALL);
  if (status == 0) status = control_clip(&job->control, session, args, poses);
  if (status == 0 && job->video.path != NULL)
    status = live_video_keep_poses(&job->video, session, &job->portrait, poses);
  if (status == 0) status = frame_source_replay(poses, session, poses->count > 1 ? 2 * poses->count - 1 : 2, NULL);
  if (status != 0) return status;
  job->now = job->video.path != NULL ? job->video.clip_frames : *poses;
  job->now.frame = job->now.source_frame;
  job->now.source_frame = &job->place;
  job->now.count = 1;
  if (job->size.width == 0) job->size = (struct dimensions){poses->camera.width, poses->camera.height};
  return 0;
}

static int open_video(struct live_job *job) {
  const struct dimensions asked = job->size;
  const ern_video_info *info = &job->video.recorded.info;
  if (job->video.path == NULL) return 0;
  if (live_video_open(&job->video, &job->session, job->portrait.source.path) != 0) return EXIT_FAILURE;
  job->size = (struct dimensions){info->width, info->height};
  job->output.pixel_aspect = info->pixel_aspect;
  job->output.preset = "superfast"; /* as in dub: with the default whole frames take half as long again */
  if (asked.width == 0 || (asked.width == info->width && asked.height == info->height)) return 0;
  return session_fail_with(&job->session,
                           "--size is %dx%d, expected %dx%d, that of %s: recorded frames keep their size", asked.width,
                           asked.height, info->width, info->height, job->video.path);
}

static int open_portrait(struct live_job *job, const struct args *args) {
  struct session *session = &job->session;
  struct portrait *portrait = &job->portrait;
  int status = portrait_open(portrait, session, args);
  if (status == 0) status = control_check_model(&job->control, session, args, portrait);
  if (status != 0) return status;
  if (ern_speech_width(portrait_speech(portrait)) == 0)
    return session_fail_with(
        session,
        "%s: was trained on speech features of the kind \"%s\", which need a network and the whole sound; live sound "
        "needs a model that was trained on a built-in kind: `ernerf train CLIP --asr-model articulatory`",
        portrait->model_path, portrait_speech(portrait));
  job->features = ern_clip_features(portrait->clip);
  if (ern_renderer_accepts(portrait->renderer, job->features, portrait->features_path) != ERN_OK)
    return session_fail(session);
  return silence_pose_learn(&job->silence_pose, session, portrait);
}

static int open_rate_control(struct live_job *job, const struct args *args) {
  const size_t values = AUDIO_WINDOWS * (size_t)job->features->window_length * (size_t)job->features->width;
  struct rate_control *control = &job->rate_control;
  const int *region = job->video.region;
  const struct dimensions size = job->video.path != NULL ? (struct dimensions){region[2], region[3]} : job->size;
  if (job->unpaced) return 0;
  job->look = malloc((size_t)size.width * (size_t)size.height * 4);
  job->windows = malloc(values * sizeof *job->windows);
  if (job->look == NULL || job->windows == NULL)
    return session_fail_with(&job->session, "no memory for a picture of %d x %d", size.width, size.height);
  if (!rate_control_asked(control)) control->hold_fps = SPARE * (float)rate_value(job->rate);
  control->warns_if_unreachable = true;
  return rate_control_open(control, &job->session, args, &job->portrait, &job->poses, job->features, size,
                           live_calibration_draw, job);
}

static int open_live(struct live_job *job) {
  ern_live_options options = ern_live_options_default();
  options.rate = SOUND_RATE;
  options.channels = 1;
  options.look_ahead = job->look_ahead;
  options.rate_numerator = job->rate.numerator;
  options.rate_denominator = job->rate.denominator;
  options.pad = (ern_audio_pad)job->portrait.audio_pad;
  options.speech = portrait_speech(&job->portrait);
  options.silence = job->silence_pose.silence;
  options.silence_code = job->silence_pose.known ? job->silence_pose.code : NULL;
  options.insert_silence = !job->unpaced;
  return ern_live_open(job->session.context, &options, &job->live) == ERN_OK ? 0 : session_fail(&job->session);
}

int live_open(struct live_job *job, const struct args *args) {
  struct session *session = &job->session;
  job->portrait.source.memory = 1;
  job->portrait.render.frame_rate = (float)rate_value(job->rate);
  int status = open_video(job);
  if (status == 0) status = open_portrait(job, args);
  if (status == 0) status = open_poses(job, args);
  if (status == 0 && job->video.path != NULL)
    status = live_video_start(
        &job->video, session, &job->portrait, &job->poses, job->rate,
        live_output_takes_recorded(&job->output) && job->label.text == NULL && job->watermark.key == NULL);
  if (status == 0 && job->video.path != NULL) status = live_video_show(&job->video, 0);
  if (status == 0) status = portrait_prune_occupancy(&job->portrait, session, &job->poses, job->features);
  if (status == 0 && job->video.path == NULL)
    status = background_open(&job->background, session, job->background_file, job->portrait.clip, job->size.width,
                             job->size.height, (ern_fit)job->fit);
  if (status == 0) status = open_rate_control(job, args);
  if (status == 0) status = open_live(job);
  if (status == 0) /* a command may set a background picture at any time */
    status = provenance_learn(&job->provenance, session, &job->portrait, NULL, false);
  job->output.provenance = provenance_of(&job->provenance);
  if (status == 0) status = label_make(&job->label, session, job->size.width, job->size.height);
  if (status == 0) status = watermark_make(&job->watermark, session, job->size.width, job->size.height);
  if (status == 0) status = live_control_start(&job->commands, session);
  if (status == 0) status = live_output_open(&job->output, session, job->size, job->rate, SOUND_RATE, 1);
  if (status == 0) status = live_sound_start(&job->sound, session, job->live, SOUND_RATE, 1);
  return status;
}

void live_close(struct live_job *job) {
  live_sound_stop(&job->sound);
  live_control_stop(&job->commands);
  live_output_free(&job->output);
  provenance_free(&job->provenance);
  label_free(&job->label);
  watermark_free(&job->watermark);
  ern_live_free(&job->live);
  silence_pose_free(&job->silence_pose);
  rate_control_close(&job->rate_control);
  background_free(&job->background, &job->session);
  live_video_close(&job->video);
  job->poses.frame = NULL;
  frame_source_free(&job->poses);
  free(job->look);
  free(job->windows);
  portrait_close(&job->portrait);
}
