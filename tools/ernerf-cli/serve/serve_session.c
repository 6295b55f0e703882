/* SPDX-License-Identifier: MIT */
#include "serve/serve_session.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { STATE_FRAMES = 10 /* after so many the server gets the figures again */, BUSY = 503, BROKEN = 500 };

/* ---- what the server calls, on its thread ------------------------------------------------------------------------ */

static void refuse(struct ern_http_reply *reply) {
  reply->status = BUSY;
  snprintf(reply->reason, sizeof reply->reason, "the session ends, or %d utterances wait already", LIVE_UTTERANCES);
}

static unsigned say(void *user, const char *text, struct ern_http_reply *reply) {
  struct serve_session *s = user;
  (void)pthread_mutex_lock(&s->mutex);
  const unsigned id = s->ended ? 0 : live_sound_say(&s->job.sound, true, text);
  (void)pthread_mutex_unlock(&s->mutex);
  if (id == 0) refuse(reply);
  return id;
}

static unsigned say_sound(void *user, const struct ern_http_sound *sound, int *descriptor,
                          struct ern_http_reply *reply) {
  struct serve_session *s = user;
  int made[2];
  reply->status = BROKEN;
  if (!live_tts_pipe(made)) {
    snprintf(reply->reason, sizeof reply->reason, "no pipe for the sound: %s", strerror(errno));
    return 0;
  }
  (void)fcntl(made[1], F_SETFL, O_NONBLOCK);
  const struct live_pipe in = {"the sound", made[0], sound->format, sound->rate, sound->channels};
  (void)pthread_mutex_lock(&s->mutex);
  const bool ended = s->ended;
  const unsigned id = ended ? 0 : live_sound_pipe(&s->job.sound, &in);
  (void)pthread_mutex_unlock(&s->mutex);
  if (ended) (void)close(made[0]);
  if (id == 0) (void)close(made[1]);
  if (id == 0) refuse(reply);
  if (id > 0) *descriptor = made[1];
  return id;
}

static void stop(void *user) {
  struct serve_session *s = user;
  (void)pthread_mutex_lock(&s->mutex);
  if (!s->ended) live_sound_cancel(&s->job.sound);
  (void)pthread_mutex_unlock(&s->mutex);
}

static bool ask(void *user, const char *line, void *bytes, size_t count, void *token, struct ern_http_reply *reply) {
  struct serve_session *s = user;
  (void)pthread_mutex_lock(&s->mutex);
  const bool takes = !s->ended && s->line_count < SERVE_LINES;
  if (takes) {
    struct serve_line *place = &s->lines[s->line_count++];
    *place = (struct serve_line){.bytes = bytes, .count = count, .token = token};
    snprintf(place->text, sizeof place->text, "%s", line);
  }
  (void)pthread_mutex_unlock(&s->mutex);
  reply->status = BUSY;
  snprintf(reply->reason, sizeof reply->reason, "%s", "the session does not take it now: it ends, or others wait");
  return takes;
}

static const struct ern_http_actions actions = {say, say_sound, stop, ask};

/* live_sound.dropped; on the thread of the server. */
static void interrupted(void *user, unsigned id) {
  struct serve_session *s = user;
  const double frames = (double)atomic_load(&s->job.output.written);
  s->http->event(s->stream, "interrupted", id, frames / rate_value(s->job.rate), NULL);
}

/* ---- what the drawing thread calls ------------------------------------------------------------------------------- */

static void show_state(struct serve_session *s) {
  json_t *figures = live_statistics(&s->job);
  json_t *control = json_object_get(figures, "rate_control");
  if (json_is_object(control)) json_object_del(control, "settings"); /* long */
  (void)json_object_del(figures, "readers");
  (void)json_object_set_new(figures, "width", json_integer(s->job.size.width));
  (void)json_object_set_new(figures, "height", json_integer(s->job.size.height));
  json_t *pushes = s->push_count > 0 ? json_array() : NULL;
  for (size_t k = 0; k < s->push_count; k++) (void)json_array_append_new(pushes, push_state(&s->pushes[k]));
  if (pushes != NULL) (void)json_object_set_new(figures, "pushes", pushes);
  char *text = figures != NULL ? json_dumps(figures, JSON_COMPACT | JSON_REAL_PRECISION(9)) : NULL;
  if (text != NULL) s->http->state(s->stream, text);
  free(text);
  json_decref(figures);
}

static void answer(void *user, const char *text) {
  struct serve_session *s = user;
  if (s->file[0] != 0) (void)unlink(s->file);
  s->file[0] = 0;
  free(s->now.bytes);
  if (s->now.token != NULL) s->http->answer(s->now.token, text);
  s->now = (struct serve_line){0};
}

/* Writes the bytes of a line into a file, whose name is added to the line. */
static bool write_picture(struct serve_session *s) {
  const char *folder = getenv("TMPDIR");
  size_t done = 0;
  const int length = snprintf(s->file, sizeof s->file,
                              "%s/ernerf-serve-"
                              "XX"
                              "XX"
                              "XX",
                              folder != NULL ? folder : "/tmp");
  const int file = length < (int)sizeof s->file - 64 ? mkstemp(s->file) : -1;
  if (file < 0) s->file[0] = 0;
  while (file >= 0 && done < s->now.count) {
    const ssize_t put = write(file, (const char *)s->now.bytes + done, s->now.count - done);
    if (put <= 0) break;
    done += (size_t)put;
  }
  if (file >= 0) (void)close(file);
  snprintf(s->line, sizeof s->line, "%s %s", s->now.text, s->file);
  return file >= 0 && done == s->now.count;
}

static const char *next_line(void *user) {
  struct serve_session *s = user;
  if (atomic_load(&s->ends)) s->job.quits = true;
  if (s->looks++ % STATE_FRAMES == 0) show_state(s);
  (void)pthread_mutex_lock(&s->mutex);
  const bool waits = s->line_count > 0;
  if (waits) {
    s->now = s->lines[0];
    memmove(s->lines, s->lines + 1, --s->line_count * sizeof *s->lines);
  }
  (void)pthread_mutex_unlock(&s->mutex);
  if (!waits) return NULL;
  snprintf(s->line, sizeof s->line, "%s", s->now.text);
  if (s->now.bytes == NULL || write_picture(s)) return s->line;
  answer(s, "error: the picture cannot be kept in a file of TMPDIR");
  return NULL;
}

/* By the time of the stream, in which a frame that is left out takes none. */
static void event(void *user, const char *word, unsigned id, const char *why) {
  struct serve_session *s = user;
  const double frames = (double)(s->job.drawn + s->job.repeated);
  s->http->event(s->stream, word, id, frames / rate_value(s->job.rate), why);
}

static void *draw(void *user) {
  struct serve_session *s = user;
  struct live_job *job = &s->job;
  s->status = live_run(job);
  (void)pthread_mutex_lock(&s->mutex);
  s->ended = true;
  (void)pthread_mutex_unlock(&s->mutex);
  while (next_line(s) != NULL) answer(s, "error: the session ends");
  live_sound_stop(&job->sound);
  if (s->status == 0)
    live_output_close(&job->output, true);
  else
    live_output_fail(&job->output);
  if (s->status == 0 && job->output.error != NULL)
    s->status = session_fail_with(&job->session, "%s", job->output.error);
  atomic_store(&s->over, true);
  return NULL;
}

/* live_output.write; on the thread that codes. */
static int take(void *user, const void *bytes, size_t count, ern_stream_piece piece) {
  struct serve_session *s = user;
  recording_write(&s->recording, bytes, count, piece);
  return s->http->write(s->stream, bytes, count, piece);
}

/* live_output.sound; on that thread too. */
static void hear(void *user, const float *samples, size_t frames) {
  const struct serve_session *s = user;
  s->http->sound(s->stream, samples, frames);
}

/* ---- opening and closing ----------------------------------------------------------------------------------------- */

int serve_session_open(struct serve_session *s, const struct args *args, const struct ern_http_functions *http,
                       struct ern_http_server *server, const char *record, const struct text_list *push) {
  struct live_job *job = &s->job;
  struct session *session = &job->session;
  (void)pthread_mutex_init(&s->mutex, NULL); /* does not fail on Linux */
  s->made = true;
  s->http = http;
  s->front = (struct live_front){next_line, answer, event, s};
  job->commands.front = &s->front;
  job->sound.keeps_running = true;
  job->sound.dropped = interrupted;
  job->sound.dropped_user = s;
  job->output.url = s->id;
  job->output.drops = true;
  job->output.write = take;
  job->output.sound = hear;
  job->output.write_user = s;
  s->recording.file = -1;
  s->stream = http->add(server, s->id, &actions, s);
  if (s->stream == NULL) return session_fail_with(session, "no memory for the session %s", s->id);
  if (record != NULL && recording_open(&s->recording, session, record, s->id) != 0) return EXIT_FAILURE;
  if (live_open(job, args) != 0) return EXIT_FAILURE;
  session_note(session, "serve: %s: %d x %d, %.4g frames a second", s->id, job->size.width, job->size.height,
               rate_value(job->rate));
  if (s->measured != NULL) *s->measured = job->rate_control;
  while (push != NULL && s->push_count < push->count) {
    const char *url = push->text[s->push_count];
    if (push_open(&s->pushes[s->push_count++], session, url, http, s->stream) != 0) return EXIT_FAILURE;
  }
  char *held = session->held;
  session->held = s->failed;
  s->opened = session_seconds();
  if (pthread_create(&s->thread, NULL, draw, s) != 0) {
    session->held = held;
    return session_fail_with(session, "%s: cannot start a thread that draws", s->id);
  }
  s->running = true;
  return 0;
}

double serve_session_coding(struct serve_session *s) {
  (void)pthread_mutex_lock(&s->mutex); /* the thread that codes is there until `ended` is set */
  const double seconds = s->running && !s->ended ? live_output_seconds(&s->job.output) : -1;
  (void)pthread_mutex_unlock(&s->mutex);
  return seconds;
}

void serve_session_stop(struct serve_session *s) {
  if (s != NULL) atomic_store(&s->ends, true);
}

void serve_session_close(struct serve_session *s) {
  if (s == NULL || !s->made) return;
  serve_session_stop(s);
  for (size_t k = 0; k < s->push_count; k++) push_close(&s->pushes[k]);
  if (s->running) (void)pthread_join(s->thread, NULL);
  if (s->stream != NULL) s->http->remove(&s->stream);
  live_close(&s->job);
  recording_close(&s->recording, &s->job.session);
  (void)pthread_mutex_destroy(&s->mutex);
  s->made = s->running = false;
}
