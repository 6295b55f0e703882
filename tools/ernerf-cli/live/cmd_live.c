/* SPDX-License-Identifier: MIT
 * ernerf live: renders a talking portrait from live sound and streams it. */
#include <stdlib.h>
#include <string.h>

#include "live/live_job.h"
#include "verbs.h"

enum { IN_OPTIONS = 6, OUT_OPTIONS = 6 };

/* ---- words ------------------------------------------------------------------------------------------------------- */

static void in_options(struct live_job *job, struct option options[IN_OPTIONS]) {
  const struct option rows[] = {
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
       .help =
           "skip frames, with their sound, while more than T of sound waits beyond the look-ahead, "
           "such as that of a microphone which started before the rendering (default: no limit; 0.2 for a DEVICE)"}};
  ARGS_FILL(options, rows, IN_OPTIONS);
}

static void out_options(struct live_job *job, struct option options[OUT_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_TEXT("o", &job->output.url), .alias = "output", .choices = "OUT",
       .help = "a file, - for standard output, or an address: rtmp://, udp://, tcp://, srt://, or http://HOST:PORT/, "
               "to which a browser or player can connect"},
      {ARGS_TEXT("format", &job->output.format), .choices = "NAME",
       .help = "y4m, nut, mpegts, flv, mp4, matroska or raw (RGBA8) (default by the name)"},
      {ARGS_CHOICE("slow-reader", &job->slow_reader, "wait|drop"),
       .help = "where the output is read too slowly: rendering waits, or frames are left out, with their sound "
               "(default drop; wait for a file, and with --as-fast)"},
      {ARGS_FLAG("as-fast", &job->unpaced),
       .help = "render each frame as soon as its sound is there, not in real time, with the settings as given"},
      {ARGS_SECONDS("duration", &job->seconds, 0.04, 1e9),
       .help = "end after T, such as 90, 90s, 10m or 1.5h (default: when the sound ends)"},
      {ARGS_TEXT("control", &job->commands.path), .choices = "-|SOCKET",
       .help = "reads lines from standard input, or makes a local socket for them: say TEXT, play FILE, stop, hold "
               "on|off, eyes 0..1|clip, background FILE|white|black|clip, statistics, quit"}};
  ARGS_FILL(options, rows, OUT_OPTIONS);
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
  if (status < 0 && job->commands.path == NULL) status = args_forbid(args, "voice", "is about --control");
  if (status < 0 && is_uncompressed(&job->output))
    status = args_forbid(args, "crf preset", "is for a compressed stream, which y4m, nut and raw are not");
  if (status < 0 && job->unpaced && rate_control_asked(&job->rate_control))
    status = args_refuse(args, "--as-fast has no frame rate to reach, so --hold-fps and --quality are not for it");
  if (status < 0 && job->unpaced && job->sound.url == NULL)
    status = args_refuse(args, "--as-fast without --audio would rest without an end");
  if (status < 0 && job->unpaced && job->sound.keeps_running)
    status = args_refuse(args, "--as-fast and --stay: choose one");
  if (status < 0) status = live_check(job, args);
  if (status < 0 && strcmp(job->output.url, "-") == 0 && session_json_on_stdout(&job->session))
    status = args_refuse(args, "--json and -o - both take standard output, expected --json FILE.json");
  if (!args_given(args, "max-delay") && job->sound.url != NULL && ern_sound_reader_is_device(job->sound.url))
    job->most_delay = 0.2;
  job->output.drops = args_given(args, "slow-reader") ? job->slow_reader == 1
                                                      : !job->unpaced && live_output_file(job->output.url) == NULL;
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
  if (status == 0 && stopped && job->frames == 0) status = session_stop_with(session, "stopped before the first frame");
  if (status != 0) live_output_fail(&job->output);
  live_sound_stop(&job->sound);
  live_control_stop(&job->commands);
  if (status == 0) live_output_close(&job->output, stopped && live_output_file(job->output.url) == NULL);
  const bool is_there = job->output.kept || (status == 0 && job->output.error == NULL);
  if (is_there && provenance_write(&job->provenance, session, about_output(job)) != 0) status = EXIT_FAILURE;
  if (job->output.error != NULL) status = session_fail_with(session, "%s", job->output.error); /* the last line */
  if (status != 0 && !job->output.cut) return status;
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
  if (mute) return EXIT_FAILURE;                /* already reported */
  if (session_interrupted() && job->output.cut) /* also where the signal came after the last frame */
    return session_stop_with(session, "stopped; its reader did not take the end of the stream, which is cut");
  if (job->output.cut)
    return session_fail_with(session, "%s: did not take the last %llu frames in %d s; the stream is cut",
                             job->output.url, (unsigned long long)(job->drawn + job->repeated) - written,
                             LIVE_PATIENCE);
  return stopped ? session_stop_with(session, "stopped; what was written is whole") : 0;
}

static int run(struct live_job *job, const struct args *args) {
  struct session *session = &job->session;
  const char *file = live_output_file(job->output.url);
  int status = file != NULL ? session_check_output(session, file) : 0;
  if (status == 0 && file != NULL) status = provenance_check(&job->provenance, session, file);
  if (status == 0) status = live_open(job, args);
  if (status == 0)
    session_note(session, "live: %d x %d, %.4g frames a second, %d ms of sound ahead, %s to %s", job->size.width,
                 job->size.height, rate_value(job->rate), 40 * (job->look_ahead + 1),
                 job->sound.url != NULL ? job->sound.url : "rest and --control", job->output.url);
  if (status == 0) status = finish(job, live_run(job));
  live_close(job);
  session_close(session);
  return status;
}

int cmd_live(int argc, char **argv) {
  struct live_job *job = calloc(1, sizeof *job);
  struct live_tables *tables = calloc(1, sizeof *tables);
  int status = EXIT_FAILURE;
  if (job == NULL || tables == NULL) {
    fprintf(stderr, "ernerf live: no memory\n");
    goto fail;
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
      .word_count = 1};
  job->slow_reader = 1;
  in_options(job, tables->in);
  out_options(job, tables->out);
  live_tables_fill(tables, job, IN_OPTIONS, OUT_OPTIONS, &args);
  status = args_parse(&args, argc, argv);
  if (status < 0) status = check_usage(job, &args);
  const char *const inputs[SESSION_INPUTS] = {
      job->portrait.model_path, job->portrait.source.path,        job->background_file,
      job->rate_control.front,  live_output_file(job->sound.url), job->video.path};
  memcpy(job->session.inputs, inputs, sizeof inputs);
  if (job->sound.url == NULL) job->sound.keeps_running = true;
  if (status < 0) status = session_open(&job->session, &args);
  if (status < 0) status = run(job, &args);
fail:
  free(tables);
  free(job);
  return status;
}
