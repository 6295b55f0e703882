/* SPDX-License-Identifier: MIT
 * Sound as it comes in, a video with sound out. Several sounds at once share one model: each has a session, a renderer
 * and a thread. The model must be trained on the built-in features (ernerf train --asr-model cepstra). Uses
 * libernerf-media.
 *
 *   cc -std=c17 live_minimal.c $(pkg-config --cflags --libs libernerf-media) -pthread -o live_minimal
 *   ./live_minimal portrait.safetensors transforms_val.json 25 speech.wav out.mp4 [speech2.wav out2.mp4 ...]
 *
 * 25: frames a second of the videos, 1 to 100.
 *
 * A sound is what ern_sound_reader_open takes: a file, "-", an address or a device. An output is what
 * ern_stream_writer_open takes. A file is read as fast as frames are drawn. */
#include <ernerf/ernerf.h>
#include <ernerf/live.h>
#include <ernerf/speech.h>
#include <ernerf/stream.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_SESSIONS = 16, SAMPLE_RATE = 16000, SAMPLES_READ = 640, GREY = 96 };

/* What all sessions share, and only read. */
struct portrait {
  ern_model *model;
  ern_model_info info;
  ern_pose_list poses;
  uint8_t *background; /* [height][width][3] */
  int frame_rate;
};

struct session {
  const struct portrait *portrait;
  const char *sound, *output;
  ern_context *context; /* of its own, as is the backend: the texts of errors are this session's */
  ern_backend *backend;
  ern_sound_reader *reader;
  ern_live *live;
  ern_renderer *renderer;
  ern_stream_writer *writer;
  uint8_t *rgba; /* [height][width][4] */
  uint64_t frames;
  ern_status status;
};

static ern_status session_open(struct session *session) {
  const struct portrait *portrait = session->portrait;
  ern_sound_reader_options reader = ern_sound_reader_options_default();
  ern_live_options live = ern_live_options_default();
  ern_render_options render = ern_render_options_default();
  ern_stream_options stream = ern_stream_options_default(portrait->poses.width, portrait->poses.height);
  reader.rate = live.rate = stream.sound_rate = SAMPLE_RATE;
  stream.sound_channels = 1;
  live.pad = portrait->info.audio_pad;
  live.speech = portrait->info.speech;
  live.rate_numerator = stream.rate_numerator = portrait->frame_rate;
  render.threads = 1; /* the sessions themselves are parallel */
  session->rgba = malloc(4 * (size_t)stream.width * (size_t)stream.height);
  ern_status status = session->rgba != NULL ? ern_context_create(&session->context, NULL) : ERN_E_NO_MEMORY;
  if (status == ERN_OK) status = ern_sound_reader_open(session->context, session->sound, &reader, &session->reader);
  if (status == ERN_OK) status = ern_live_open(session->context, &live, &session->live);
  if (status == ERN_OK) status = ern_backend_create(&session->backend, session->context, NULL);
  if (status == ERN_OK) status = ern_renderer_create(&session->renderer, session->backend, portrait->model, &render);
  if (status == ERN_OK) status = ern_stream_writer_open(session->context, session->output, &stream, &session->writer);
  return status;
}

/* Draws and writes a frame. Poses run back and forth where the sound is longer than the clip. */
static ern_status session_frame(struct session *session, const ern_live_frame *frame) {
  const ern_pose_list *poses = &session->portrait->poses;
  const size_t at = (size_t)(frame->number * 25 / (uint64_t)session->portrait->frame_rate); /* at 25 frames a second */
  ern_frame_input input = {.camera = {.focal = (float)poses->focal,
                                      .cx = (float)poses->cx,
                                      .cy = (float)poses->cy,
                                      .width = poses->width,
                                      .height = poses->height},
                           .individual = ERN_INDIVIDUAL_MEAN,
                           .background = session->portrait->background};
  ern_camera_pose(input.camera.pose, poses->poses[ern_pose_index(at, poses->count)].matrix,
                  session->portrait->info.scale);
  const ern_frame_output output = {.rgba = session->rgba};
  ern_status status = ern_live_draw(frame, session->renderer, &input, &output, NULL);
  if (status == ERN_OK) status = ern_stream_writer_frame(session->writer, session->rgba, frame->sound, frame->samples);
  session->frames += status == ERN_OK;
  return status;
}

/* Draws what is due of the sound so far. */
static ern_status session_pull(struct session *session) {
  for (;;) {
    const ern_live_frame *frame = NULL;
    bool ended = false;
    ern_status status = ern_live_pull(session->live, 0, &frame, &ended);
    if (status != ERN_OK || frame == NULL) return status;
    status = session_frame(session, frame);
    if (status != ERN_OK) return status;
  }
}

static void *session_run(void *user) {
  struct session *session = user;
  float samples[SAMPLES_READ];
  size_t count = 0;
  ern_status status = session_open(session);
  do {
    if (status == ERN_OK) status = ern_sound_reader_read(session->reader, samples, SAMPLES_READ, &count);
    if (status == ERN_OK)
      status = count > 0 ? ern_live_push(session->live, samples, count) : ern_live_end(session->live);
    if (status == ERN_OK) status = session_pull(session);
  } while (status == ERN_OK && count > 0);
  if (status == ERN_OK) status = ern_stream_writer_close(&session->writer);
  session->status = status;
  return NULL;
}

static void session_free(struct session *session) {
  ern_stream_writer_abandon(&session->writer); /* what was closed is NULL */
  ern_renderer_free(&session->renderer);
  ern_backend_free(&session->backend);
  ern_live_free(&session->live);
  ern_sound_reader_free(&session->reader);
  ern_context_free(&session->context);
  free(session->rgba);
}

static ern_status portrait_open(ern_context *context, char **words, struct portrait *portrait) {
  ern_status status = ern_model_load(&portrait->model, context, words[1]);
  if (status == ERN_OK) status = ern_pose_list_load(context, words[2], &portrait->poses);
  if (status != ERN_OK) return status;
  ern_model_describe(portrait->model, &portrait->info);
  if (ern_speech_width(portrait->info.speech) == 0) {
    fprintf(stderr, "%s: was trained on speech features that a live session does not compute\n", words[1]);
    return ERN_E_MISMATCH;
  }
  const size_t bytes = 3 * (size_t)portrait->poses.width * (size_t)portrait->poses.height;
  portrait->background = malloc(bytes);
  if (portrait->background == NULL) return ERN_E_NO_MEMORY;
  memset(portrait->background, GREY, bytes);
  return ERN_OK;
}

int main(int count, char **words) {
  struct portrait portrait = {.frame_rate = count > 3 ? atoi(words[3]) : 0};
  struct session sessions[MOST_SESSIONS] = {0};
  pthread_t threads[MOST_SESSIONS];
  const int opened = (count - 4) / 2;
  if (count < 6 || count % 2 != 0 || opened > MOST_SESSIONS || portrait.frame_rate < 1 || portrait.frame_rate > 100) {
    fprintf(stderr, "usage: %s MODEL.safetensors POSES.json FRAMES_A_SECOND SOUND OUT [SOUND OUT ...], at most %d\n",
            words[0], MOST_SESSIONS);
    return 2;
  }
  ern_context *context = NULL;
  int started = 0, failed = 0;
  ern_status status = ern_context_create(&context, NULL);
  if (status == ERN_OK) status = portrait_open(context, words, &portrait);
  if (status != ERN_OK) fprintf(stderr, "%s: %s\n", ern_status_name(status), ern_last_error(context));
  for (; status == ERN_OK && started < opened; started++) {
    struct session *session = &sessions[started];
    *session =
        (struct session){.portrait = &portrait, .sound = words[4 + 2 * started], .output = words[5 + 2 * started]};
    if (pthread_create(&threads[started], NULL, session_run, session) != 0) status = ERN_E_NO_MEMORY;
    if (status != ERN_OK) break;
  }
  for (int i = 0; i < started; i++) {
    pthread_join(threads[i], NULL);
    const struct session *session = &sessions[i];
    if (session->status == ERN_OK)
      printf("%s: %llu frames\n", session->output, (unsigned long long)session->frames);
    else
      fprintf(stderr, "%s: %s: %s\n", session->output, ern_status_name(session->status),
              ern_last_error(session->context));
    failed += session->status != ERN_OK;
    session_free(&sessions[i]);
  }
  free(portrait.background);
  ern_pose_list_free(context, &portrait.poses);
  ern_model_free(&portrait.model);
  ern_context_free(&context);
  return status == ERN_OK && failed == 0 ? 0 : 1;
}
