/* SPDX-License-Identifier: MIT
 * The commands of --control. */
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "live/live_job.h"

static const char words[] =
    "say TEXT, play FILE, stop, hold on|off, eyes 0..1|clip, background FILE|white|black|clip, "
    "statistics, quit";

static void refuse(struct live_job *job, const char *reason) {
  char text[LIVE_LINE];
  snprintf(text, sizeof text, "error: %.3900s", reason);
  live_control_answer(&job->commands, text);
}

/* Why the file that `url` names cannot be played; NULL: it may, or `url` names a device of FFmpeg's or an address. */
static const char *why_unreadable(const char *url) {
  const char *path = ern_stream_file(url);
  struct stat about;
  if (path == NULL || strcmp(path, "-") == 0 || ern_sound_reader_is_device(url)) return NULL;
  if (access(path, R_OK) != 0 || stat(path, &about) != 0) return strerror(errno);
  if (S_ISDIR(about.st_mode)) return strerror(EISDIR);
  return S_ISREG(about.st_mode) || S_ISFIFO(about.st_mode) ? NULL : "is a device, expected a file or FIFO";
}

/* Whether the sound of a regular file can be read; other inputs would block. */
static bool has_sound(struct live_job *job, const char *url) {
  ern_sound_reader_options options = ern_sound_reader_options_default();
  ern_sound_reader *reader = NULL;
  const char *path = ern_stream_file(url);
  struct stat about;
  if (path == NULL || stat(path, &about) != 0 || !S_ISREG(about.st_mode)) return true;
  const bool has = ern_sound_reader_open(job->session.context, url, &options, &reader) == ERN_OK;
  ern_sound_reader_free(&reader);
  return has;
}

static void say(struct live_job *job, bool speaks, const char *rest) {
  char text[LIVE_LINE], reason[LIVE_LINE];
  unsigned id = 0;
  const char *unreadable = speaks ? NULL : why_unreadable(rest);
  if (rest[0] == 0)
    refuse(job, speaks ? "say: expected a text" : "play: expected a file");
  else if (job->sound.url != NULL && !job->sound.keeps_running)
    refuse(job, "say and play: with --audio they need --stay, and are heard after its sound");
  else if (unreadable != NULL) {
    snprintf(text, sizeof text, "play: %.3500s: %s", rest, unreadable);
    refuse(job, text);
  } else if (!speaks && !has_sound(job, rest)) {
    (void)ern_last_error_copy(job->session.context, reason, sizeof reason);
    snprintf(text, sizeof text, "play: %.3500s", reason);
    refuse(job, text);
  } else if ((id = live_sound_say(&job->sound, speaks, rest)) == 0) {
    refuse(job, "say and play: 32 of them wait already");
  } else {
    snprintf(text, sizeof text, "ok %u", id);
    live_control_answer(&job->commands, text);
  }
}

static void set_eyes(struct live_job *job, const char *rest) {
  char *end = NULL;
  errno = 0;
  const float eye = strtof(rest, &end);
  if (job->video.path != NULL) {
    refuse(job, "eyes: are those of the recorded frames of --video");
    return;
  } else if (strcmp(rest, "clip") == 0) {
    job->eye = -1;
  } else if (rest[0] == 0 || end == NULL || *end != 0 || errno != 0 || !(eye >= 0 && eye <= 1)) {
    refuse(job, "eyes: expected 0 (open) to 1 (closed), or clip");
    return;
  } else if (!job->portrait.info.has_eye) {
    refuse(job, "eyes: the model was trained without eye values");
    return;
  } else {
    job->eye = eye;
  }
  live_control_answer(&job->commands, "ok");
}

static void set_background(struct live_job *job, const char *rest) {
  struct background next = {0};
  const char *choice = strcmp(rest, "clip") == 0 ? NULL : rest;
  if (rest[0] == 0) {
    refuse(job, "background: expected a file, white, black or clip");
  } else if (job->video.path != NULL) {
    refuse(job, "background: is that of the recorded frames of --video");
  } else if (background_open(&next, &job->session, choice, job->portrait.clip, job->size.width, job->size.height,
                             (ern_fit)job->fit) != 0) {
    background_free(&next, &job->session);
    refuse(job, "background: cannot be read, standard error says why; the previous one stays");
  } else {
    background_free(&job->background, &job->session);
    job->background = next;
    live_control_answer(&job->commands, "ok");
  }
}

static void answer_statistics(struct live_job *job) {
  json_t *object = live_statistics(job);
  json_t *settings = json_object_get(object, "rate_control");
  if (json_is_object(settings)) json_object_del(settings, "settings"); /* long; the report of --json has it */
  char *text = object != NULL ? json_dumps(object, JSON_COMPACT) : NULL;
  if (text != NULL)
    live_control_answer(&job->commands, text);
  else
    refuse(job, "statistics: no memory");
  free(text);
  json_decref(object);
}

void live_command(struct live_job *job, const char *line) {
  char word[32];
  const size_t length = strcspn(line, " \t");
  const char *rest = line + length + strspn(line + length, " \t");
  snprintf(word, sizeof word, "%.*s", (int)(length < sizeof word ? length : sizeof word - 1), line);
  if (strcmp(word, "say") == 0 || strcmp(word, "play") == 0) {
    say(job, word[0] == 's', rest);
  } else if (strcmp(word, "stop") == 0 && rest[0] == 0) {
    live_sound_cancel(&job->sound);
    live_control_answer(&job->commands, "ok");
  } else if (strcmp(word, "hold") == 0 && (strcmp(rest, "on") == 0 || strcmp(rest, "off") == 0)) {
    job->held = strcmp(rest, "on") == 0;
    live_control_answer(&job->commands, "ok");
  } else if (strcmp(word, "eyes") == 0) {
    set_eyes(job, rest);
  } else if (strcmp(word, "background") == 0) {
    set_background(job, rest);
  } else if (strcmp(word, "statistics") == 0 && rest[0] == 0) {
    answer_statistics(job);
  } else if (strcmp(word, "quit") == 0 && rest[0] == 0) {
    job->quits = true;
    live_control_answer(&job->commands, "ok");
  } else {
    char text[LIVE_LINE];
    snprintf(text, sizeof text, "\"%.200s\" is not known, expected %s", line, words);
    refuse(job, text);
  }
}
