/* SPDX-License-Identifier: MIT
 * ernerf detect: finds out whether a video has the watermark of a key. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "ernerf/media.h"
#include "output/watermark_output.h"
#include "session/session.h"
#include "verbs.h"

enum { OWN_OPTIONS = 1 };

/* Result of a search in consecutive frames. */
struct window {
  size_t frames;
  double begin; /* seconds from the first frame on */
  double score, false_positive, scale;
};

struct detect_job {
  struct session session;
  struct watermark watermark;
  const char *video;
  double seconds; /* duration of a window; 0: the whole video is one window */
  ern_video_reader *reader;
  ern_watermark_detector *detector;
  ern_image frame;
  struct window *windows;
  size_t count;
};

static int end_window(struct detect_job *job, size_t frames, double begin) {
  struct window *more = realloc(job->windows, (job->count + 1) * sizeof *more);
  if (more == NULL) return session_fail_with(&job->session, "no memory for %zu windows", job->count + 1);
  job->windows = more;
  struct window *window = &job->windows[job->count++];
  *window = (struct window){.frames = frames, .begin = begin};
  return ern_watermark_detector_search(job->detector, &window->score, &window->false_positive, &window->scale) == ERN_OK
             ? 0
             : session_fail(&job->session);
}

/* A remainder of less than half a window is ignored, unless it is the whole video. */
static int search(struct detect_job *job) {
  size_t frames = 0;
  double first = NAN, begin = 0, seconds = 0;
  for (;;) {
    bool end = false;
    if (session_interrupted()) return session_stop_with(&job->session, "stopped");
    if (ern_video_reader_frame(job->reader, &job->frame, &seconds, &end) != ERN_OK) return session_fail(&job->session);
    if (end) break;
    if (isnan(first)) first = seconds;
    if (job->seconds > 0 && frames > 0 && seconds - first >= begin + job->seconds - 1e-3) {
      if (end_window(job, frames, begin) != 0) return EXIT_FAILURE;
      begin += job->seconds * floor((seconds - first - begin) / job->seconds + 1e-3);
      frames = 0;
    }
    if (ern_watermark_detector_frame(job->detector, &job->frame) != ERN_OK)
      return session_fail_with(&job->session, "%s: %s", job->video, ern_last_error(job->session.context));
    frames++;
  }
  if (frames == 0) return session_fail_with(&job->session, "%s: has no frames", job->video);
  const bool is_whole = job->seconds <= 0 || seconds - first >= begin + job->seconds / 2;
  return is_whole || job->count == 0 ? end_window(job, frames, begin) : 0;
}

/* The best window; *false_positive: its bound, corrected for the number of searches. */
static const struct window *best(const struct detect_job *job, double *false_positive) {
  const struct window *found = &job->windows[0];
  for (size_t i = 1; i < job->count; i++)
    if (job->windows[i].score > found->score) found = &job->windows[i];
  *false_positive = fmin(1, found->false_positive * (double)job->count);
  return found;
}

static json_t *report(const struct detect_job *job, bool found, const struct window *window, double false_positive) {
  json_t *list = json_array();
  for (size_t i = 0; i < job->count; i++) {
    const struct window *w = &job->windows[i];
    (void)json_array_append_new(
        list, json_pack("{s:o, s:I, s:o, s:o, s:o}", "begin", session_number(w->begin), "frames", (json_int_t)w->frames,
                        "score", session_number(w->score), "false_positive", session_number(w->false_positive), "scale",
                        session_number(w->scale)));
  }
  return json_pack("{s:o, s:b, s:o, s:o, s:o, s:o, s:o}", "video", session_text(job->video), "found", found, "score",
                   session_number(window->score), "false_positive", session_number(false_positive), "threshold",
                   session_number(ERN_WATERMARK_FALSE_POSITIVE), "scale", session_number(window->scale), "windows",
                   list);
}

static int detect(struct detect_job *job) {
  struct session *session = &job->session;
  if (ern_watermark_detector_open(session->context, job->watermark.key, &job->detector) != ERN_OK ||
      ern_video_reader_open(session->context, job->video, &job->reader) != ERN_OK)
    return session_fail(session);
  if (search(job) != 0) return EXIT_FAILURE;
  double false_positive;
  const struct window *window = best(job, &false_positive);
  const bool found = false_positive <= ERN_WATERMARK_FALSE_POSITIVE;
  if (!session_json_on_stdout(session))
    printf("%s: the watermark of this key is %s: score %.1f at scale %.3f, %zu frames from %.2f s on\n", job->video,
           found ? "found" : "not found", window->score, window->scale, window->frames, window->begin);
  session_note(
      session,
      "a wrong key scores as much with a probability of at most %.2g; the watermark counts as found up to %.0e",
      false_positive, ERN_WATERMARK_FALSE_POSITIVE);
  const int status = session_report(session, report(job, found, window, false_positive));
  return status == 0 && !found ? EXIT_FAILURE : status;
}

int cmd_detect(int argc, char **argv) {
  struct detect_job job = {0};
  struct option own[WATERMARK_OPTIONS + OWN_OPTIONS], output[SESSION_OUTPUT_OPTIONS];
  struct word words[] = {{"VIDEO", &job.video, "any video that FFmpeg reads"}};
  const struct option rows[] = {
      {ARGS_SECONDS("window", &job.seconds, 0.1, 1e6),
       .help = "search each part of this length, such as 10s, for a video of which only a part has the watermark "
               "(default: all of the video at once)"}};
  struct args args = {
      .verb = "detect",
      .summary = "Says whether a video has the watermark that `render --watermark KEY` puts on frames.",
      .usage = "detect VIDEO --watermark KEY [--window SECONDS] [--json FILE]",
      .notes =
          "Exit status: 0 found, 1 not found or failed (the message is on standard error), 2 wrong usage.\n"
          "docs/watermark.md: what it survives, and how often a wrong key is found.",
      .words = words,
      .word_count = 1,
      .groups = {{"What is searched:", own, WATERMARK_OPTIONS + OWN_OPTIONS},
                 {"Output:", output, SESSION_OUTPUT_OPTIONS}}};
  watermark_options(&job.watermark, own);
  own[0].help = "the key that the watermark was made with";
  ARGS_FILL(own + WATERMARK_OPTIONS, rows, OWN_OPTIONS);
  session_output_options(&job.session, output);
  int status = args_parse(&args, argc, argv);
  if (status < 0 && job.watermark.key == NULL) status = args_refuse(&args, "--watermark KEY is missing");
  if (status < 0) status = watermark_check(&job.watermark, &args);
  job.session.inputs[0] = job.video;
  if (status < 0) status = session_open(&job.session, &args);
  if (status >= 0) return status;
  status = detect(&job);
  free(job.windows);
  ern_image_free(job.session.context, &job.frame);
  ern_video_reader_free(&job.reader);
  ern_watermark_detector_free(&job.detector);
  session_close(&job.session);
  return status;
}
