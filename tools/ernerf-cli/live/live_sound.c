/* SPDX-License-Identifier: MIT */
#include "live/live_sound.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum { PIECE_MS = 20, TEXT_BYTES = 2048, FIRST_SOUND = 30 /* seconds that a program has to make it */ };

static int asks_to_stop(void *user) {
  struct live_sound *sound = user;
  (void)pthread_mutex_lock(&sound->mutex);
  const bool late = sound->patience > 0 && session_seconds() > sound->patience;
  const bool stop = sound->stop || sound->skip || late;
  (void)pthread_mutex_unlock(&sound->mutex);
  return stop ? 1 : 0;
}

/* ---- the thread -------------------------------------------------------------------------------------------------- */

static void remember(struct live_sound *sound, const char *text) {
  (void)pthread_mutex_lock(&sound->mutex);
  free(sound->error);
  sound->error = strdup(text);
  free(sound->why);
  sound->why = strdup(text);
  (void)pthread_mutex_unlock(&sound->mutex);
}

/* An input that ended before its first sample. */
static ern_status no_sound(struct live_sound *sound, const char *url) {
  char text[TEXT_BYTES];
  snprintf(text, sizeof text, "%.1500s: ended without a sample of sound, expected some", url);
  remember(sound, text);
  return ERN_E_MISSING;
}

/* name: of what messages call `url`; NULL: the same. */
static void remember_error(struct live_sound *sound, const char *url, const char *name) {
  char text[TEXT_BYTES], named[TEXT_BYTES];
  const size_t bytes = strlen(url);
  (void)ern_last_error_copy(sound->context, text, sizeof text);
  const bool names = name != NULL && strncmp(text, url, bytes) == 0;
  snprintf(named, sizeof named, "%.1000s%.1000s", names ? name : "", names ? text + bytes : text);
  remember(sound, named);
}

/* Pushes a block of sound. After a cancel, an input of the command line continues; an utterance ends. */
static ern_status push(struct live_sound *sound, const float *samples, size_t frames, bool own) {
  const ern_status status = ern_live_push(sound->live, samples, frames);
  return own && status == ERN_E_CANCELLED ? ERN_OK : status;
}

/* ---- marks: where utterances are in the sound -------------------------------------------------------------------- */

/* Waits for a place: an utterance may be shorter than a frame. NULL: after a cancel. */
static struct live_mark *add_mark(struct live_sound *sound, struct live_mark mark) {
  while (!sound->stop && !sound->skip && sound->mark_count == LIVE_UTTERANCES)
    (void)pthread_cond_wait(&sound->moved, &sound->mutex);
  if (sound->stop || sound->skip) return NULL;
  sound->mark[sound->mark_count] = mark;
  return &sound->mark[sound->mark_count++];
}

static void begin_mark(struct live_sound *sound, unsigned id) {
  (void)pthread_mutex_lock(&sound->mutex);
  (void)add_mark(sound, (struct live_mark){.id = id, .begin = ern_live_samples(sound->live), .end = UINT64_MAX});
  (void)pthread_mutex_unlock(&sound->mutex);
}

/* An utterance that has no mark gave no sound. */
static void end_mark(struct live_sound *sound, unsigned id, bool whole) {
  struct live_mark *mark = NULL;
  (void)pthread_mutex_lock(&sound->mutex);
  for (size_t i = 0; i < sound->mark_count; i++)
    if (sound->mark[i].id == id) mark = &sound->mark[i];
  if (mark == NULL) mark = add_mark(sound, (struct live_mark){.id = id, .failed = true});
  if (mark != NULL && mark->end == UINT64_MAX) mark->end = ern_live_samples(sound->live);
  if (mark != NULL) mark->failed |= !whole;
  if (mark != NULL && mark->failed) {
    mark->why = sound->why;
    sound->why = NULL;
  }
  free(sound->why);
  sound->why = NULL;
  sound->current = 0;
  (void)pthread_mutex_unlock(&sound->mutex);
}

/* Only the sound before `at` is heard. What failed is told of all the same. */
static void cut_marks(struct live_sound *sound, uint64_t at) {
  size_t kept = 0;
  for (size_t i = 0; i < sound->mark_count; i++) {
    struct live_mark mark = sound->mark[i];
    if (mark.begin >= at && !mark.started && !mark.failed) continue;
    if (mark.end > at) mark.end = at;
    sound->mark[kept++] = mark;
  }
  sound->mark_count = kept;
}

/* Pushes the whole sound of `url`; where it is a pipe, as `pipe` says (else NULL). utterance: its ID, 0: the input of
 * the command line. */
static ern_status play(struct live_sound *sound, const char *url, unsigned utterance, const struct live_pipe *pipe) {
  const bool own = utterance == 0;
  const size_t piece = (size_t)sound->rate * PIECE_MS / 1000;
  ern_sound_reader_options options = ern_sound_reader_options_default();
  ern_sound_reader *reader = NULL;
  const char *name = pipe != NULL ? pipe->name : NULL;
  bool begun = false;
  float *samples = malloc(piece * (size_t)sound->channels * sizeof *samples);
  options.rate = sound->rate;
  options.channels = sound->channels;
  if (own) options.format = sound->format;
  if (own && sound->format_rate > 0) options.format_rate = sound->format_rate;
  if (own && sound->format_channels > 0) options.format_channels = sound->format_channels;
  if (pipe != NULL && pipe->format != NULL) {
    options.format = pipe->format;
    options.format_rate = pipe->rate;
    options.format_channels = pipe->channels;
  }
  options.stop = asks_to_stop;
  options.user = sound;
  ern_status status = samples != NULL ? ern_sound_reader_open(sound->context, url, &options, &reader) : ERN_E_NO_MEMORY;
  for (size_t frames = 1; status == ERN_OK && frames > 0;) {
    status = ern_sound_reader_read(reader, samples, piece, &frames);
    if (status == ERN_OK && frames > 0 && !own && !begun) begin_mark(sound, utterance);
    begun |= frames > 0;
    if (frames > 0) sound->patience = 0;
    if (status == ERN_OK && frames > 0) status = push(sound, samples, frames, own);
    atomic_fetch_add(&sound->samples_pushed, status == ERN_OK ? frames : 0);
  }
  ern_sound_reader_free(&reader);
  free(samples);
  if (status != ERN_OK && status != ERN_E_CANCELLED) remember_error(sound, url, name);
  return status == ERN_OK && !begun ? no_sound(sound, name != NULL ? name : url) : status;
}

/* Whether all of it was pushed, or dropped by a cancel. */
static bool speak(struct live_sound *sound, const char *text, unsigned id) {
  char reason[LIVE_TTS_REASON] = "";
  ern_status status = ERN_E_IO;
  const bool begun = live_tts_begin(&sound->tts, text, reason);
  if (begun) {
    sound->patience = session_seconds() + FIRST_SOUND;
    status = play(sound, sound->tts.url, id, &(struct live_pipe){.name = sound->tts.program});
  }
  const bool late = sound->patience > 0 && session_seconds() > sound->patience;
  sound->patience = 0;
  const bool ended = live_tts_end(&sound->tts, status == ERN_OK, reason);
  if (late)
    snprintf(reason, sizeof reason, "%.1500s: made no sound of the text in %d s, and was ended",
             sound->tts.program != NULL ? sound->tts.program : "espeak-ng", FIRST_SOUND);
  const bool fails = late || !begun || (!ended && status != ERN_E_CANCELLED);
  if (fails) remember(sound, reason);
  return !fails && (status == ERN_OK || status == ERN_E_CANCELLED);
}

static void free_utterance(struct live_utterance *utterance) {
  free(utterance->text);
  if (utterance->pipe.descriptor > 0) (void)close(utterance->pipe.descriptor);
}

/* Waits for the next utterance of the queue, whose text the caller frees. Text NULL: the program ends. */
static struct live_utterance await_utterance(struct live_sound *sound) {
  struct live_utterance next = {0};
  (void)pthread_mutex_lock(&sound->mutex);
  while (!sound->stop && sound->utterance_count == 0) (void)pthread_cond_wait(&sound->moved, &sound->mutex);
  sound->skip = false;
  if (!sound->stop) {
    next = sound->utterance[0];
    memmove(sound->utterance, sound->utterance + 1, --sound->utterance_count * sizeof *sound->utterance);
  }
  sound->current = next.id;
  (void)pthread_mutex_unlock(&sound->mutex);
  return next;
}

static void end(struct live_sound *sound) {
  if (ern_live_end(sound->live) != ERN_OK) remember_error(sound, "", NULL);
}

static void *read_sound(void *user) {
  struct live_sound *sound = user;
  if (sound->url != NULL) {
    const ern_status status = play(sound, sound->url, 0, NULL);
    if (status != ERN_OK && status != ERN_E_CANCELLED) atomic_store(&sound->failed, true);
    if (!sound->keeps_running)
      end(sound); /* before `input_ended` is set: after that, a frame without sound gets silence */
    atomic_store(&sound->input_ended, true);
  }
  while (sound->keeps_running) {
    struct live_utterance next = await_utterance(sound);
    if (next.text == NULL) break;
    bool whole = next.speaks && speak(sound, next.text, next.id);
    if (!next.speaks) {
      const ern_status status = play(sound, next.text, next.id, next.pipe.descriptor > 0 ? &next.pipe : NULL);
      whole = status == ERN_OK || status == ERN_E_CANCELLED;
    }
    end_mark(sound, next.id, whole);
    free_utterance(&next);
  }
  end(sound);
  return NULL;
}

/* ---- the others -------------------------------------------------------------------------------------------------- */

int live_sound_start(struct live_sound *sound, struct session *session, ern_live *live, int rate, int channels) {
  sound->session = session;
  sound->context = session->context;
  sound->live = live;
  sound->rate = rate;
  sound->channels = channels;
  (void)pthread_mutex_init(&sound->mutex, NULL); /* neither fails on Linux */
  (void)pthread_cond_init(&sound->moved, NULL);
  sound->made = true;
  if (pthread_create(&sound->thread, NULL, read_sound, sound) != 0)
    return session_fail_with(session, "cannot start a thread that reads sound");
  sound->running = true;
  return 0;
}

void live_sound_await(const struct live_sound *sound, unsigned long long samples) {
  const struct timespec pause = {0, 2000000};
  struct stat there;
  const char *file = ern_stream_file(sound->url);
  if (file == NULL || stat(file, &there) != 0 || !S_ISREG(there.st_mode)) return;
  while (atomic_load(&sound->samples_pushed) < samples && !atomic_load(&sound->input_ended) && !session_interrupted())
    (void)nanosleep(&pause, NULL);
}

static unsigned enqueue(struct live_sound *sound, struct live_utterance next) {
  (void)pthread_mutex_lock(&sound->mutex);
  if (next.text != NULL && sound->utterance_count < LIVE_UTTERANCES) {
    next.id = ++sound->last_id;
    sound->utterance[sound->utterance_count++] = next;
  }
  (void)pthread_cond_broadcast(&sound->moved);
  (void)pthread_mutex_unlock(&sound->mutex);
  if (next.id == 0) free_utterance(&next);
  return next.id;
}

unsigned live_sound_say(struct live_sound *sound, bool speaks, const char *text) {
  return enqueue(sound, (struct live_utterance){.speaks = speaks, .text = strdup(text)});
}

unsigned live_sound_pipe(struct live_sound *sound, const struct live_pipe *pipe) {
  char name[32];
  snprintf(name, sizeof name, "/dev/fd/%d", pipe->descriptor);
  return enqueue(sound, (struct live_utterance){.text = strdup(name), .pipe = *pipe});
}

enum live_event live_sound_event(struct live_sound *sound, uint64_t heard, unsigned *id, char **why) {
  enum live_event event = LIVE_NONE;
  *why = NULL;
  (void)pthread_mutex_lock(&sound->mutex);
  struct live_mark *mark = sound->mark;
  if (sound->mark_count > 0) {
    *id = mark->id;
    if (!mark->started && heard > mark->begin && mark->end > mark->begin)
      event = LIVE_STARTED;
    else if (heard >= mark->end)
      event = mark->failed ? LIVE_FAILED : LIVE_ENDED;
    mark->started |= event == LIVE_STARTED;
  }
  if (event == LIVE_FAILED || event == LIVE_ENDED) {
    *why = mark->why;
    memmove(mark, mark + 1, --sound->mark_count * sizeof *mark);
    (void)pthread_cond_broadcast(&sound->moved);
  }
  (void)pthread_mutex_unlock(&sound->mutex);
  return event;
}

unsigned live_sound_speaking(struct live_sound *sound, size_t *waiting) {
  *waiting = 0;
  if (!sound->made) return 0;
  (void)pthread_mutex_lock(&sound->mutex);
  const unsigned id = sound->mark_count > 0 && sound->mark[0].started ? sound->mark[0].id : 0;
  *waiting = sound->utterance_count;
  (void)pthread_mutex_unlock(&sound->mutex);
  return id;
}

static void clear_utterances(struct live_sound *sound) {
  for (size_t i = 0; i < sound->utterance_count; i++) free_utterance(&sound->utterance[i]);
  sound->utterance_count = 0;
}

/* Tells of all utterances that are not heard to their end, and forgets their marks. */
static void drop_all(struct live_sound *sound) {
  bool marked = false;
  if (sound->dropped == NULL) return;
  for (size_t i = 0; i < sound->mark_count; i++) {
    sound->dropped(sound->dropped_user, sound->mark[i].id);
    marked |= sound->mark[i].id == sound->current;
    free(sound->mark[i].why);
  }
  sound->mark_count = 0;
  if (sound->current > 0 && !marked) sound->dropped(sound->dropped_user, sound->current);
  for (size_t i = 0; i < sound->utterance_count; i++) sound->dropped(sound->dropped_user, sound->utterance[i].id);
  sound->current = 0;
}

void live_sound_cancel(struct live_sound *sound) {
  (void)pthread_mutex_lock(&sound->mutex);
  drop_all(sound);
  clear_utterances(sound);
  sound->skip = sound->url == NULL || atomic_load(&sound->input_ended); /* an input of the command line continues */
  (void)pthread_cond_broadcast(&sound->moved);
  (void)pthread_mutex_unlock(&sound->mutex);
  if (ern_live_cancel(sound->live) != ERN_OK) remember_error(sound, "", NULL);
  (void)pthread_mutex_lock(&sound->mutex);
  cut_marks(sound, ern_live_samples(sound->live));
  (void)pthread_mutex_unlock(&sound->mutex);
}

char *live_sound_take_error(struct live_sound *sound) {
  (void)pthread_mutex_lock(&sound->mutex);
  char *error = sound->error;
  sound->error = NULL;
  (void)pthread_mutex_unlock(&sound->mutex);
  return error;
}

void live_sound_stop(struct live_sound *sound) {
  if (sound->running) {
    (void)pthread_mutex_lock(&sound->mutex);
    sound->stop = true;
    (void)pthread_cond_broadcast(&sound->moved);
    (void)pthread_mutex_unlock(&sound->mutex);
    end(sound); /* ends a blocked push */
    (void)pthread_join(sound->thread, NULL);
    sound->running = false;
  }
  if (!sound->made) return;
  clear_utterances(sound);
  for (size_t i = 0; i < sound->mark_count; i++) free(sound->mark[i].why);
  sound->mark_count = 0;
  free(sound->why);
  free(sound->error);
  sound->error = sound->why = NULL;
  (void)pthread_mutex_destroy(&sound->mutex);
  (void)pthread_cond_destroy(&sound->moved);
  sound->made = false;
}
