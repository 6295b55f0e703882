/* SPDX-License-Identifier: MIT
 * ernerf live: renders a talking portrait from live sound and streams it. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "ernerf/speech.h"
#include "live/live_job.h"
#include "verbs.h"

/* Factor of speed above the frame rate: reserve for encoding and reading, and to catch up after a late frame. */
static const float SPARE = 1.15f;

enum { IN_OPTIONS = 9, OUT_OPTIONS = 12, AUDIO_WINDOWS = 8, SOUND_RATE = 48000 };

/* ---- words ------------------------------------------------------------------------------------------------------- */

static void in_options(struct live_job *job, struct option options[IN_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_TEXT("clip", &job->portrait.source.path), .choices = "CLIP",
       .help = "folder of the clip that the model was trained on: poses, eyes, background, and how the mouth rests"},
      {ARGS_TEXT("video", &job->video.path), .choices = "VIDEO",
       .help = "the recorded video that CLIP was prepared from: its frames are shown, forward and backward, with a "
               "rendered mouth (docs/dub.md)"},
      {ARGS_TEXT("audio", &job->sound.url), .choices = "INPUT",
       .help = "the sound: a file, - for standard input, an address, or DEVICE:NAME of FFmpeg such as pulse:default or "
               "alsa:hw:0; the first frame waits for the sound of a file; without --audio the person rests, and speaks "
               "what --control says"},
      {ARGS_TEXT("audio-format", &job->sound.format), .choices = "NAME",
       .help =
           "FFmpeg's name of the sound's format, such as s16le or f32le, samples without a header (default: detected)"},
      {ARGS_INT("audio-rate", &job->sound.format_rate, 1000, 384000), .seldom = true,
       .help = "samples a second of sound without a header (default 16000)"},
      {ARGS_INT("audio-channels", &job->sound.format_channels, 1, 8), .seldom = true,
       .help = "channels of sound without a header (default 1)"},
      {ARGS_FLAG("stay", &job->sound.keeps_running),
       .help = "when the sound has ended, keep the stream going with the person at rest"},
      {ARGS_SECONDS("max-delay", &job->most_delay, 0.04, 10),
       .help = "skip frames, with their sound, while more than T of sound waits beyond the look-ahead, "
               "such as that of a microphone which started before the rendering (default: no limit; 0.2 for a DEVICE)"},
      {ARGS_INT("look-ahead", &job->look_ahead, ERN_LIVE_LEAST_LOOK_AHEAD, ERN_LIVE_LOOK_AHEAD),
       .help =
           "number of frames (40 ms each), 2 to 7, of sound after a frame that are used for it: each one less shows "
           "the frame 40 ms sooner and moves the mouth less accurately (default 7, all that the model takes)"}};
  ARGS_FILL(options, rows, IN_OPTIONS);
}

static void out_options(struct live_job *job, struct option options[OUT_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_TEXT("o", &job->output.url), .alias = "output", .choices = "OUT",
       .help = "a file, - for standard output, or an address: rtmp://, udp://, tcp://, srt://, or http://HOST:PORT/, "
               "to which a browser or player can connect"},
      {ARGS_TEXT("format", &job->output.format), .choices = "NAME",
       .help = "y4m, nut, mpegts, flv, mp4, matroska or raw (RGBA8) (default by the name)"},
      {ARGS_DIMENSIONS("size", &job->size, 1, ERN_IMAGE_MAX_SIDE),
       .help = "size of the frames (default that of the clip; with --video that of VIDEO alone)"},
      {ARGS_CHOICE("fit", &job->fit, "contain|cover"),
       .help = "how the clip's frame goes into a --size of another aspect: contain shows all of it and continues its "
               "edges, cover fills the picture and cuts the frame (default contain)"},
      {ARGS_RATE("fps", &job->rate), .help = "frames a second, 1 to 100 (default 25)"},
      {ARGS_TEXT("bg-img", &job->background_file), .choices = "FILE|white|black",
       .help = "background (default the clip's)"},
      {ARGS_INT("crf", &job->output.crf, 0, 51), .help = "H.264 quality, the lower the better"},
      {ARGS_CHOICE("slow-reader", &job->slow_reader, "wait|drop"),
       .help = "where the output is read too slowly: rendering waits, or frames are left out, with their sound "
               "(default drop; wait for a file, and with --as-fast)"},
      {ARGS_FLAG("as-fast", &job->unpaced),
       .help = "render each frame as soon as its sound is there, not in real time, with the settings as given"},
      {ARGS_SECONDS("duration", &job->seconds, 0.04, 1e9),
       .help = "end after T, such as 90, 90s, 10m or 1.5h (default: when the sound ends)"},
      {ARGS_TEXT("control", &job->commands.path), .choices = "-|SOCKET",
       .help = "reads lines from standard input, or makes a local socket for them: say TEXT, play FILE, stop, hold "
               "on|off, eyes 0..1|clip, background FILE|white|black|clip, statistics, quit"},
      {ARGS_TEXT("voice", &job->sound.voice), .choices = "NAME",
       .help = "espeak-ng's voice that says what --control asks for (default en)"}};
  job->rate = (struct rate){RATE_CLIP, 1};
  job->look_ahead = ERN_LIVE_LOOK_AHEAD;
  job->output.crf = ern_stream_options_default(1, 1).crf;
  ARGS_FILL(options, rows, OUT_OPTIONS);
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

/* The path of a file that `url` names, which is created or replaced; NULL: an address, a pipe or a device, which is
 * written to directly. */
static const char *file_of(const char *url) {
  const char *path = url != NULL ? ern_stream_file(url) : NULL;
  struct stat there;
  if (path == NULL || strcmp(path, "-") == 0) return NULL;
  return stat(path, &there) != 0 || S_ISREG(there.st_mode) || S_ISDIR(there.st_mode) ? path : NULL;
}

/* Of a format that is not compressed, by its name or else that of the output (docs/live.md). */
static bool is_uncompressed(const struct live_output *output) {
  static const char *const formats[] = {"y4m", "nut", "raw"}, *const endings[] = {".y4m", ".nut", ".rgba"};
  const char *dot = strrchr(output->url, '.');
  bool is = output->format == NULL && strncmp(output->url, "tcp://", 6) == 0;
  if (output->format == NULL && !is && strstr(output->url, "://") != NULL) return false;
  for (size_t i = 0; i < sizeof formats / sizeof *formats && !is; i++)
    is = output->format != NULL ? strcmp(output->format, formats[i]) == 0 : dot != NULL && strcmp(dot, endings[i]) == 0;
  return is;
}

/* Checks the options. The policy for a slow reader is an option whose default depends on --as-fast. */
static int check_usage(struct live_job *job, const struct args *args) {
  int status = -1;
  if (job->portrait.source.path == NULL) return args_refuse(args, "--clip CLIP is missing");
  if (job->output.url == NULL) return args_refuse(args, "-o OUT is missing");
  if (job->sound.url == NULL && job->commands.path == NULL && job->seconds <= 0)
    return args_refuse(args,
                       "nothing would ever be said: expected --audio INPUT, --control, or --duration for a "
                       "person who rests");
  if (job->sound.url != NULL && job->commands.path != NULL && strcmp(job->sound.url, "-") == 0 &&
      strcmp(job->commands.path, "-") == 0)
    return args_refuse(args, "--audio - and --control - both take standard input");
  if (job->sound.url == NULL) status = args_forbid(args, "audio-format audio-rate audio-channels", "is about --audio");
  if (status < 0 && job->sound.format == NULL)
    status = args_forbid(args, "audio-rate audio-channels", "is about sound without a header: --audio-format names it");
  if (status < 0) status = check_unlisted(args);
  if (status < 0) status = check_video(job, args);
  if (status < 0 && job->size.width == 0) status = args_forbid(args, "fit", "needs --size");
  if (status < 0 && job->commands.path == NULL) status = args_forbid(args, "voice", "is about --control");
  if (status < 0 && is_uncompressed(&job->output))
    status = args_forbid(args, "crf preset", "is for a compressed stream, which y4m, nut and raw are not");
  if (status < 0 && rate_value(job->rate) > 100) status = args_refuse(args, "--fps is above 100, expected 1 to 100");
  if (status < 0 && job->unpaced && rate_control_asked(&job->rate_control))
    status = args_refuse(args, "--as-fast has no frame rate to reach, so --hold-fps and --quality are not for it");
  if (status < 0 && job->unpaced && job->sound.url == NULL)
    status = args_refuse(args, "--as-fast without --audio would rest without an end");
  if (status < 0 && job->unpaced && job->sound.keeps_running)
    status = args_refuse(args, "--as-fast and --stay: choose one");
  if (status < 0) status = label_check(&job->label, args);
  if (status < 0) status = watermark_check(&job->watermark, args);
  if (status < 0) status = control_check(&job->control, args);
  if (status < 0) status = rate_control_check(&job->rate_control, args);
  if (status < 0 && strcmp(job->output.url, "-") == 0 && session_json_on_stdout(&job->session))
    status = args_refuse(args, "--json and -o - both take standard output, expected --json FILE.json");
  if (!args_given(args, "max-delay") && job->sound.url != NULL && ern_sound_reader_is_device(job->sound.url))
    job->most_delay = 0.2;
  job->output.drops =
      args_given(args, "slow-reader") ? job->slow_reader == 1 : !job->unpaced && file_of(job->output.url) == NULL;
  return status;
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

static int open_all(struct live_job *job, const struct args *args) {
  struct session *session = &job->session;
  const char *file = file_of(job->output.url);
  int status = 0;
  if (file != NULL) status = session_check_output(session, file);
  if (status == 0 && file != NULL) status = provenance_check(&job->provenance, session, file);
  job->portrait.source.memory = 1;
  job->portrait.render.frame_rate = (float)rate_value(job->rate);
  if (status == 0) status = open_video(job);
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
  if (status == 0)
    session_note(session, "live: %d x %d, %.4g frames a second, %d ms of sound ahead, %s to %s", job->size.width,
                 job->size.height, rate_value(job->rate), 40 * (job->look_ahead + 1),
                 job->sound.url != NULL ? job->sound.url : "rest and --control", job->output.url);
  return status;
}

/* ---- the end ----------------------------------------------------------------------------------------------------- */

/* Content of the provenance file; without times, so that repeated runs (--as-fast) give the same file. */
static json_t *about_output(const struct live_job *job) {
  const char *slash = strrchr(job->output.url, '/'), *video = job->video.path, *folder = NULL;
  if (video != NULL) folder = strrchr(video, '/');
  char rate[RATE_TEXT_BYTES];
  rate_words(job->rate, rate);
  return json_pack("{s:o, s:I, s:I, s:s, s:i, s:i, s:b, s:o*, s:o, s:o*}", "output",
                   session_text(slash != NULL ? slash + 1 : job->output.url), "frames",
                   (json_int_t)atomic_load(&job->output.written), "drawn", (json_int_t)job->drawn, "rate", rate,
                   "width", job->size.width, "height", job->size.height, "sound", true, "recorded",
                   video != NULL ? session_text(folder != NULL ? folder + 1 : video) : NULL, "rate_control",
                   job->unpaced ? json_null() : rate_control_json(&job->rate_control), "cut",
                   job->output.kept ? json_true() : NULL);
}

static int finish(struct live_job *job, int status) {
  struct session *session = &job->session;
  const bool stopped = session_interrupted(), mute = atomic_load(&job->sound.failed);
  char *error = live_sound_take_error(&job->sound);
  if (error != NULL && mute && job->frames == 0) status = session_fail_with(session, "%s", error);
  if (error != NULL && status == 0) session_warn(session, "%s", error);
  free(error);
  if (status != 0) live_output_fail(&job->output);
  live_sound_stop(&job->sound);
  live_control_stop(&job->commands);
  if (status == 0) live_output_close(&job->output, stopped && file_of(job->output.url) == NULL);
  const bool is_there = job->output.kept || (status == 0 && job->output.error == NULL);
  if (is_there && provenance_write(&job->provenance, session, about_output(job)) != 0) status = EXIT_FAILURE;
  if (job->output.error != NULL) status = session_fail_with(session, "%s", job->output.error); /* the last line */
  if (status != 0) return status;
  const unsigned long long written = atomic_load(&job->output.written), left = atomic_load(&job->output.left_out);
  if (left > 0)
    session_warn(session, "%llu frames were left out, with their sound, as %s did not take them in time", left,
                 job->output.url);
  if (job->as_recorded > 0)
    session_warn(session,
                 "%llu of %llu frames are left as recorded: the face is too small or too near the edge, or the "
                 "model has no head there",
                 (unsigned long long)job->as_recorded, (unsigned long long)job->drawn);
  if (job->sound.url != NULL && !mute && atomic_load(&job->sound.samples_pushed) == 0)
    session_warn(session, "%s: no sound came from it", job->sound.url);
  session_note(session, "live: %llu frames written, %llu repeated, %llu left out, %llu skipped: %s", written,
               (unsigned long long)job->repeated, left, (unsigned long long)job->skipped, job->output.url);
  if (!job->unpaced) rate_control_summary(&job->rate_control, 0);
  if (session_report(session, live_statistics(job)) != 0) return EXIT_FAILURE;
  if (mute) return EXIT_FAILURE; /* already reported */
  if (stopped && job->output.cut)
    return session_stop_with(session, "stopped; its reader did not take the end of the stream, which is cut");
  return stopped ? session_stop_with(session, "stopped; what was written is whole") : 0;
}

static void close_all(struct live_job *job) {
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
  session_close(&job->session);
}

static int run(struct live_job *job, const struct args *args) {
  int status = open_all(job, args);
  if (status == 0) status = finish(job, live_run(job));
  close_all(job);
  return status;
}

int cmd_live(int argc, char **argv) {
  struct live_job *job = calloc(1, sizeof *job);
  struct option in[IN_OPTIONS],
      out[OUT_OPTIONS + RATE_CONTROL_OPTIONS + PROVENANCE_OPTIONS + LABEL_OPTIONS + WATERMARK_OPTIONS],
      shared[PORTRAIT_OPTIONS], control[CONTROL_OPTIONS + SILENCE_POSE_OPTIONS],
      common[SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS];
  if (job == NULL) {
    fprintf(stderr, "ernerf live: no memory\n");
    return EXIT_FAILURE;
  }
  struct word words[] = {
      {"MODEL", &job->portrait.model_path, "a .safetensors or .pth file: a head, or head and torso"}};
  struct args args = {
      .verb = "live",
      .summary = "Renders speech while it is spoken, as a video stream.",
      .usage =
          "live MODEL --clip CLIP --audio - | FILE | ADDRESS | DEVICE:NAME -o - | FILE | ADDRESS\n"
          "live MODEL --clip CLIP --control - | SOCKET -o http://127.0.0.1:8080/\n"
          "live MODEL --clip CLIP --video VIDEO --audio - | FILE | ADDRESS | DEVICE:NAME -o - | FILE | ADDRESS",
      .notes = "docs/live.md: from a microphone to a browser, late frames, slow readers, formats.",
      .words = words,
      .word_count = 1,
      .groups = {{"What comes in:", in, IN_OPTIONS},
                 {"What goes out, and how fast:", out,
                  OUT_OPTIONS + RATE_CONTROL_OPTIONS + PROVENANCE_OPTIONS + LABEL_OPTIONS + WATERMARK_OPTIONS},
                 {"Eyes, mouth and pose:", control, CONTROL_OPTIONS + SILENCE_POSE_OPTIONS},
                 {"How:", shared, PORTRAIT_OPTIONS},
                 {"Common:", common, SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS}}};
  job->slow_reader = 1;
  in_options(job, in);
  out_options(job, out);
  portrait_options(&job->portrait, FRAME_SOURCE_ALL, shared);
  control_options(&job->control, control);
  silence_pose_options(&job->silence_pose, control + CONTROL_OPTIONS);
  rate_control_options(&job->rate_control, out + OUT_OPTIONS);
  provenance_options(&job->provenance, out + OUT_OPTIONS + RATE_CONTROL_OPTIONS);
  label_options(&job->label, out + OUT_OPTIONS + RATE_CONTROL_OPTIONS + PROVENANCE_OPTIONS);
  watermark_options(&job->watermark, out + OUT_OPTIONS + RATE_CONTROL_OPTIONS + PROVENANCE_OPTIONS + LABEL_OPTIONS);
  session_compute_options(&job->session, common);
  session_output_options(&job->session, common + SESSION_COMPUTE_OPTIONS);
  job->sound.voice = "en";
  job->sound.channels = 1;
  job->eye = -1;
  job->portrait.other_speech = true;
  args_unlist(&args, "split frames eye smooth-lips speech-model speech-preset");
  int status = args_parse(&args, argc, argv);
  if (status < 0) status = check_usage(job, &args);
  const char *const inputs[SESSION_INPUTS] = {job->portrait.model_path, job->portrait.source.path, job->background_file,
                                              job->rate_control.front,  file_of(job->sound.url),   job->video.path};
  memcpy(job->session.inputs, inputs, sizeof inputs);
  if (job->sound.url == NULL) job->sound.keeps_running = true;
  if (status < 0) status = session_open(&job->session, &args);
  if (status < 0) status = run(job, &args);
  free(job);
  return status;
}
