/* SPDX-License-Identifier: MIT */
#include "live/live_output.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>

enum { LATE_BINS = 1001, TEXT_BYTES = 2048 };

/* Seconds after a signal that the reader of a pipe or address has to receive the queued frames and the stream's
 * trailer. */
static const double grace = 2;
/* Seconds that an address may take to answer, to take a frame that is waited for, and to take the end of the stream:
 * one whose server reads nothing would be waited for without end. */
static const double patience_of_address = LIVE_PATIENCE;
/* Seconds for which frames are left out before a warning. */
static const double bearable = 5;

const char *live_output_file(const char *url) {
  const char *path = url != NULL ? ern_stream_file(url) : NULL;
  struct stat there;
  if (path == NULL || strcmp(path, "-") == 0) return NULL;
  return stat(path, &there) != 0 || S_ISREG(there.st_mode) || S_ISDIR(there.st_mode) ? path : NULL;
}

static bool is_over(const struct live_output *output) {
  const double now = session_seconds();
  return now >= atomic_load(&output->stop_at) || now >= output->hurried_until;
}

/* A signal ends the wait for the first reader at once, and leaves a later one `grace`. A file is completed. */
static int asks_to_stop(void *user) {
  struct live_output *output = user;
  const bool interrupted = session_interrupted();
  if (interrupted && !output->completes && isinf(output->hurried_until))
    output->hurried_until = session_seconds() + grace;
  return is_over(output) || (!atomic_load(&output->running) && interrupted);
}

static int hand_over(void *user, const void *bytes, size_t count, ern_stream_piece piece) {
  const struct live_output *output = user;
  return output->write(output->write_user, bytes, count, piece);
}

/* ---- the writer's thread ----------------------------------------------------------------------------------------- */

static ern_status open_stream(struct live_output *output) {
  const ern_status status = ern_stream_writer_open(output->context, output->url, &output->options, &output->writer);
  if (status == ERN_OK) {
    atomic_fetch_add(&output->readers, 1);
    atomic_store(&output->open, true);
  }
  return status;
}

static void keep_error(struct live_output *output) {
  char text[TEXT_BYTES];
  (void)ern_last_error_copy(output->context, text, sizeof text);
  output->error = strdup(text);
}

static void count_late(struct live_output *output, double due) {
  const double late = 1000 * (session_seconds() - due);
  const size_t bin = late <= 0 ? 0 : late >= LATE_BINS - 1 ? LATE_BINS - 1 : (size_t)late;
  atomic_fetch_add(&output->late[bin], 1);
  atomic_fetch_add(&output->written, 1);
}

static ern_status write_picture(struct live_output *output, const struct live_picture *picture) {
  if (output->sound != NULL) output->sound(output->write_user, picture->sound, picture->samples);
  if (picture->repeat || picture->recorded == NULL)
    return ern_stream_writer_frame(output->writer, picture->repeat ? NULL : picture->rgba, picture->sound,
                                   picture->samples);
  return ern_stream_writer_patch(output->writer, picture->recorded, picture->part[2] > 0 ? picture->part : NULL,
                                 picture->rgba, picture->sound, picture->samples);
}

/* Serves one reader until it disconnects or the queue ends. It does not get frames from before its connection. */
static ern_status serve(struct live_output *output) {
  ern_status status = output->writer != NULL ? ERN_OK : open_stream(output);
  while (status == ERN_OK) {
    const int place = queue_wait_for_item(&output->queue);
    if (place == QUEUE_CLOSED) break;
    const struct live_picture *picture = &output->pictures[place];
    if (atomic_load(&output->patient)) atomic_store(&output->stop_at, session_seconds() + patience_of_address);
    status = write_picture(output, picture);
    if (status == ERN_OK) count_late(output, picture->due);
    queue_pop(&output->queue);
  }
  return status;
}

/* The file that the output names; false: there is none. */
static bool find_file(const struct live_output *output, struct stat *file) {
  const char *path = output->write == NULL ? ern_stream_file(output->url) : NULL;
  return path != NULL && stat(path, file) == 0 && S_ISREG(file->st_mode);
}

/* Ends the stream; after an error too, as the writer then keeps what a file has. */
static ern_status end_stream(struct live_output *output) {
  struct stat before, after;
  const bool was_there = find_file(output, &before);
  const ern_status status = ern_stream_writer_close(&output->writer);
  output->kept = status != ERN_OK && find_file(output, &after) && (!was_there || after.st_ino != before.st_ino);
  return status;
}

static void *write_frames(void *user) {
  struct live_output *output = user;
  for (;;) {
    ern_status status = serve(output);
    const bool was_open = atomic_exchange(&output->open, false);
    if (output->writer != NULL && status != ERN_E_CANCELLED && !atomic_load(&output->given_up))
      status = end_stream(output);
    ern_stream_writer_abandon(&output->writer);
    if (status == ERN_OK) return NULL;
    output->cut = status == ERN_E_CANCELLED && was_open && !atomic_load(&output->given_up);
    if (status == ERN_E_CANCELLED && is_over(output)) break;
    if (!output->serves_http || status != ERN_E_IO) {
      keep_error(output);
      break;
    }
    while (!queue_is_empty(&output->queue)) queue_pop(&output->queue); /* stale for the next reader */
  }
  queue_break(&output->queue);
  return NULL;
}

/* ---- the drawing thread ------------------------------------------------------------------------------------------ */

static int make_pictures(struct live_output *output, size_t samples) {
  const size_t pixels = (size_t)output->options.width * (size_t)output->options.height;
  const size_t values = samples * (size_t)output->options.sound_channels;
  for (size_t i = 0; i < LIVE_PICTURES; i++) {
    struct live_picture *picture = &output->pictures[i];
    picture->rgba = malloc(4 * pixels);
    picture->sound = malloc((values > 0 ? values : 1) * sizeof(float));
    if (picture->rgba == NULL || picture->sound == NULL)
      return session_fail_with(output->session, "no memory for %d frames of %d x %d", LIVE_PICTURES,
                               output->options.width, output->options.height);
  }
  return 0;
}

int live_output_open(struct live_output *output, struct session *session, struct dimensions size, struct rate rate,
                     int sound_rate, int channels) {
  output->session = session;
  output->context = session->context;
  output->serves_http = output->write == NULL && strncmp(output->url, "http://", 7) == 0;
  output->connects = output->write == NULL && !output->serves_http && ern_stream_file(output->url) == NULL &&
                     strcmp(output->url, "-") != 0;
  output->completes = output->write == NULL && live_output_file(output->url) != NULL;
  output->options = ern_stream_options_default(size.width, size.height);
  output->options.format = output->format;
  output->options.rate_numerator = rate.numerator;
  output->options.rate_denominator = rate.denominator;
  output->options.sound_rate = sound_rate;
  output->options.sound_channels = channels;
  output->options.crf = output->crf;
  output->options.preset = output->preset;
  output->options.profile = output->profile;
  if (output->pixel_aspect > 0) output->options.pixel_aspect = output->pixel_aspect;
  output->options.provenance = output->provenance;
  output->options.stop = asks_to_stop;
  output->options.user = output;
  output->options.write = output->write != NULL ? hand_over : NULL;
  atomic_store(&output->stop_at, INFINITY);
  output->hurried_until = INFINITY;
  output->left_out_last = -INFINITY;
  queue_make(&output->queue, LIVE_PICTURES);
  if (make_pictures(output, (size_t)((double)sound_rate / rate_value(rate)) + 2) != 0) return EXIT_FAILURE;
  if (output->connects) atomic_store(&output->stop_at, session_seconds() + patience_of_address);
  if (!output->serves_http && open_stream(output) != ERN_OK)
    return session_interrupted() ? session_stop_with(session, "stopped before %s had a reader", output->url)
           : is_over(output)
               ? session_fail_with(session, "%s: has not answered for %g s", output->url, patience_of_address)
               : session_fail(session);
  atomic_store(&output->stop_at, INFINITY);
  atomic_store(&output->patient, output->connects && !output->drops);
  atomic_store(&output->running, true);
  if (pthread_create(&output->thread, NULL, write_frames, output) == 0) return 0;
  atomic_store(&output->running, false);
  return session_fail_with(session, "cannot start a thread that writes");
}

/* Warns once of frames that are left out again and again, as by a server that reads nothing: such a stream may go on
 * for days. */
static void tell_left_out(struct live_output *output) {
  const double now = session_seconds();
  if (now - output->left_out_last > bearable) {
    output->left_out_since = now;
    output->told = false;
  }
  output->left_out_last = now;
  if (output->told || output->write != NULL || now - output->left_out_since < bearable) return;
  output->told = true;
  session_warn(output->session, "%s: takes frames too slowly or not at all; they are left out, with their sound",
               output->url);
}

struct live_picture *live_output_next(struct live_output *output, bool *failed) {
  *failed = false;
  const bool has_place = queue_has_slot(&output->queue);
  if (output->serves_http && !atomic_load(&output->open) && has_place) return NULL;
  if (!has_place && output->drops) {
    atomic_fetch_add(&output->left_out, 1);
    tell_left_out(output);
    return NULL;
  }
  /* a reader that stopped is not waited for after a signal: the grace of live_output_close begins */
  const struct timespec pause = {.tv_nsec = 10000000};
  while (!queue_has_slot(&output->queue) && !session_interrupted()) (void)nanosleep(&pause, NULL);
  if (!queue_has_slot(&output->queue)) {
    atomic_fetch_add(&output->left_out, 1);
    return NULL;
  }
  const int place = queue_wait_for_slot(&output->queue); /* which does not wait */
  *failed = place == QUEUE_CLOSED;
  return *failed ? NULL : &output->pictures[place];
}

bool live_output_takes_recorded(const struct live_output *output) {
  static const char ending[] = ".rgba";
  const size_t own = sizeof ending - 1, length = strlen(output->url);
  if (output->format != NULL) return strcmp(output->format, "raw") != 0;
  return length < own || strcmp(output->url + length - own, ending) != 0;
}

void live_output_put(struct live_output *output) { queue_push(&output->queue); }

/* patience: seconds to wait for the reader. */
static void stop_writer(struct live_output *output, double patience) {
  if (!atomic_load(&output->running)) return;
  if (output->serves_http && !atomic_load(&output->open)) patience = 0;
  atomic_store(&output->stop_at, session_seconds() + patience);
  queue_end(&output->queue);
  (void)pthread_join(output->thread, NULL);
  atomic_store(&output->running, false);
}

void live_output_close(struct live_output *output, bool soon) {
  if (soon) atomic_store(&output->patient, false);
  stop_writer(output, soon ? grace : output->connects ? patience_of_address : INFINITY);
}

void live_output_fail(struct live_output *output) {
  atomic_store(&output->given_up, true);
  if (atomic_load(&output->running)) queue_break(&output->queue);
  stop_writer(output, 0);
}

void live_output_free(struct live_output *output) {
  live_output_fail(output);
  ern_stream_writer_abandon(&output->writer);
  for (size_t i = 0; i < LIVE_PICTURES; i++) {
    free(output->pictures[i].rgba);
    free(output->pictures[i].sound);
    ern_video_frame_free(&output->pictures[i].recorded);
  }
  if (output->session != NULL) queue_free(&output->queue);
  free(output->error);
}

double live_output_seconds(struct live_output *output) {
  clockid_t clock;
  struct timespec used;
  if (!atomic_load(&output->running) || pthread_getcpuclockid(output->thread, &clock) != 0 ||
      clock_gettime(clock, &used) != 0)
    return 0;
  return (double)used.tv_sec + 1e-9 * (double)used.tv_nsec;
}

double live_output_late(const struct live_output *output, double share) {
  unsigned long long seen = 0;
  const double wanted = share * (double)atomic_load(&output->written);
  for (size_t i = 0; i < LATE_BINS; i++) {
    seen += atomic_load(&output->late[i]);
    if ((double)seen >= wanted && seen > 0) return (double)i;
  }
  return 0;
}
