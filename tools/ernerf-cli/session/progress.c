/* SPDX-License-Identifier: MIT */
#include "session/progress.h"

#include <math.h>
#include <stdio.h>
#include <unistd.h>

enum { MINUTE = 60, HOUR = 3600, LINE_BYTES = 256 };

static const double redraw_seconds = 0.1, json_seconds = 0.5;
/* Intervals of lines into a pipe: every 5 s for the first patience_seconds, then every minute; also at each twentieth
 * of the work, but at most once a second. */
static const double line_seconds = 5, patience_seconds = 120, late_line_seconds = 60, crowded_seconds = 1;

void progress_begin(struct progress *progress, struct session *session, const char *what, const char *unit) {
  const double now = session_seconds();
  *progress = (struct progress){.session = session, .what = what, .unit = unit, .began = now, .last = now};
  progress->terminal = isatty(STDERR_FILENO) == 1;
}

void progress_duration(double seconds, char text[32]) {
  const double s = isfinite(seconds) && seconds > 0 ? fmin(seconds, 1e9) : 0;
  const long whole = lround(s);
  if (whole < MINUTE)
    snprintf(text, 32, "%ld s", whole);
  else if (whole < HOUR)
    snprintf(text, 32, "%ld min %02ld s", whole / MINUTE, whole % MINUTE);
  else
    snprintf(text, 32, "%ld h %02ld min", whole / HOUR, whole % HOUR / MINUTE);
}

/* Whether a line is due; the last one is always printed. */
static bool is_due(const struct progress *progress, uint64_t done, uint64_t total, double now) {
  const double since = now - progress->last;
  if (done >= total) return done > progress->last_done || progress->terminal;
  if (progress->terminal) return since >= redraw_seconds;
  const double wait = now - progress->began < patience_seconds ? line_seconds : late_line_seconds;
  const bool twentieth = (done - progress->last_done) * 20 >= total;
  return since >= wait || (twentieth && since >= crowded_seconds);
}

/* {"progress": "render", "done": 3, "total": 66, "unit": "frames", "per_second": 8.5, "seconds": 0.4, "seconds_left":
 * 7.4} */
static void say_to_programs(struct progress *progress, uint64_t done, uint64_t total, double rate, double now) {
  if (done < total && now - progress->last < json_seconds) return;
  fprintf(stderr,
          "{\"progress\": \"%s\", \"done\": %llu, \"total\": %llu, \"unit\": \"%s\", \"per_second\": %.3f, "
          "\"seconds\": %.3f, \"seconds_left\": ",
          progress->what, (unsigned long long)done, (unsigned long long)total, progress->unit, rate,
          now - progress->began);
  if (rate > 0)
    fprintf(stderr, "%.3f}\n", (double)(total - done) / rate);
  else
    fprintf(stderr, "null}\n");
  progress->last = now;
}

void progress_at(struct progress *progress, uint64_t done, uint64_t total, const char *more) {
  const double now = session_seconds();
  const double spent = now - progress->began;
  const double rate = progress->rate > 0 ? progress->rate : spent > 0 ? (double)done / spent : 0;
  if (progress->session->progress_form == 1 && total > 0) {
    say_to_programs(progress, done, total, rate, now);
    return;
  }
  if (progress->session->quiet || total == 0 || !is_due(progress, done, total, now)) return;
  char line[LINE_BYTES], left[32];
  progress_duration(rate > 0 ? (double)(total - done) / rate : 0, left);
  const int digits = rate >= 100 ? 0 : rate >= 10 ? 1 : 2;
  snprintf(line, sizeof line, "%s %5.1f%%  %llu/%llu  %.*f %s/s  %s left%s%s", progress->what,
           100 * (double)done / (double)total, (unsigned long long)done, (unsigned long long)total, digits, rate,
           progress->unit, rate > 0 ? left : "?", more[0] != 0 ? "  " : "", more);
  if (progress->terminal) {
    fprintf(stderr, "\r%s\033[K", line);
    fflush(stderr);
    progress->session->line_open = true;
  } else {
    fprintf(stderr, "%s\n", line);
  }
  progress->last = now;
  progress->last_done = done;
}

void progress_end(struct progress *progress) {
  if (!progress->session->line_open) return;
  fprintf(stderr, "\n");
  progress->session->line_open = false;
}
