/* SPDX-License-Identifier: MIT
 * The frames of `render`. On a device two are drawn at a time, each by a renderer of its own, so that the device has
 * work while a frame is read back. */
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "verbs/render_job.h"

enum { AUDIO_WINDOWS = 8, DRAWERS = 2 };

/* Frames go to the drawers in turn. They are begun in order and, once drawn, handed on in order. */
struct drawing {
  struct render_job *job;
  struct progress *progress;
  pthread_mutex_t mutex; /* guards the rest */
  pthread_cond_t moved;
  size_t begun, handed; /* frames */
  bool stopped;         /* a drawer failed */
  struct drawer *drawers;
  double shared; /* seconds: until when the drawers' shares are counted */
};

struct drawer {
  struct drawing *drawing;
  ern_renderer *renderer; /* NULL: the portrait's, or that of the rate control */
  float *windows;
  size_t first, step; /* its frames: first, first + step, ... */
  ern_frame_times stages;
  bool draws;    /* a frame, now */
  double share;  /* seconds of that frame: of the time in which both draw, each has half */
  double before; /* seconds: when its last frame was handed on */
  int status;
};

bool render_is_behind(const struct render_job *job) {
  return job->portrait.clip != NULL && !job->portrait.info.has_torso && job->portrait.clip_info.has_torso;
}

size_t render_window_bytes(const struct render_job *job) {
  return (size_t)AUDIO_WINDOWS * (size_t)job->features->window_length * (size_t)job->features->width * sizeof(float);
}

ern_status render_frame(const struct render_job *job, ern_renderer *renderer, size_t k, const uint8_t *torso,
                        float *windows, const ern_frame_output *output, ern_frame_times *times) {
  const struct source_frame *source_frame = &job->frame_source.source_frame[k];
  float refined[16];
  frame_source_windows(&job->frame_source, k, job->features, (ern_audio_pad)job->portrait.audio_pad, windows);
  const ern_camera camera = frame_source_camera(&job->frame_source, k, job->portrait.scale, job->size.width,
                                                job->size.height, (ern_fit)job->fit);
  const ern_frame_input input = {.camera = camera,
                                 .head_pose = portrait_refined(&job->portrait, &job->frame_source, k, refined),
                                 .windows = windows,
                                 .window_length = job->features->window_length,
                                 .eye = source_frame->eye,
                                 .individual = ERN_INDIVIDUAL_MEAN,
                                 .background = job->background.image.data,
                                 .torso = torso,
                                 .silence_code = job->silence_pose.code,
                                 .silence_weight = silence_pose_weight(&job->silence_pose, &job->frame_source, k),
                                 .torso_motion = frame_source_motion(&job->frame_source, k)};
  return ern_renderer_frame(renderer, &input, output, times);
}

int render_fail(struct render_job *job, size_t k) {
  return session_fail_with(&job->session, "%s, frame %zu: %s", job->portrait.model_path,
                           job->frame_source.source_frame[k].number, ern_last_error(job->session.context));
}

/* Waits until *turn is k. False: a drawer has failed. */
static bool wait_for_turn(struct drawing *drawing, const size_t *turn, size_t k) {
  pthread_mutex_lock(&drawing->mutex);
  while (!drawing->stopped && *turn != k) pthread_cond_wait(&drawing->moved, &drawing->mutex);
  const bool goes_on = !drawing->stopped;
  pthread_mutex_unlock(&drawing->mutex);
  return goes_on;
}

static void end_turn(struct drawing *drawing, size_t *turn) {
  pthread_mutex_lock(&drawing->mutex);
  *turn += 1;
  pthread_cond_broadcast(&drawing->moved);
  pthread_mutex_unlock(&drawing->mutex);
}

/* The drawer begins or ends a frame: shares out the time since the last such moment. Returns the moment. */
static double share_time(struct drawer *drawer, bool draws) {
  struct drawing *drawing = drawer->drawing;
  struct drawer *drawers = drawing->drawers;
  pthread_mutex_lock(&drawing->mutex);
  const double now = session_seconds();
  const double each = (now - drawing->shared) / (drawers[0].draws && drawers[1].draws ? 2 : 1);
  for (int i = 0; i < DRAWERS; i++)
    if (drawers[i].draws) drawers[i].share += each;
  drawing->shared = now;
  if (draws) drawer->share = 0;
  drawer->draws = draws;
  pthread_mutex_unlock(&drawing->mutex);
  return now;
}

/* The device has the stages of two frames at a time: of what a stage took, the part that is the frame's share. */
static void add_stages(struct drawer *drawer, const ern_frame_times *times, double seconds) {
  const double part = seconds > 0 ? drawer->share / seconds : 1;
  drawer->stages.audio += part * times->audio;
  drawer->stages.torso += part * times->torso;
  drawer->stages.head += part * times->head;
  drawer->stages.output += part * times->output;
}

static int begin(struct drawer *drawer, size_t k, ern_renderer **renderer, const uint8_t **torso,
                 ern_frame_output *output) {
  struct render_job *job = drawer->drawing->job;
  if (session_interrupted())
    return session_stop_with(&job->session, "stopped at frame %zu of %zu%s", k, job->frame_source.count,
                             job->sink.kind == SINK_VIDEO ? ", no video was written" : "");
  *renderer = drawer->renderer != NULL                 ? drawer->renderer
              : rate_control_asked(&job->rate_control) ? rate_control_renderer(&job->rate_control)
                                                       : job->portrait.renderer;
  if (*renderer == NULL) return EXIT_FAILURE;
  if (render_is_behind(job) && background_next_torso(&job->background, &job->session, torso) != 0) return EXIT_FAILURE;
  return sink_next(&job->sink, &job->session, output);
}

static int hand_on(struct drawer *drawer, size_t k, const ern_frame_output *output) {
  struct render_job *job = drawer->drawing->job;
  const bool paced = rate_control_asked(&job->rate_control);
  if (output->rgba != NULL && watermark_put(&job->watermark, &job->session, output->rgba) != 0) return EXIT_FAILURE;
  if (output->rgba != NULL) label_put(&job->label, (double)k / rate_value(job->rate), output->rgba, job->size.width);
  sink_put(&job->sink, job->frame_source.source_frame[k].number);
  if (render_is_behind(job)) background_release_torso(&job->background);
  const double now = session_seconds();
  if (paced) rate_control_took(&job->rate_control, 1000 * (now - drawer->before));
  drawer->before = now;
  progress_at(drawer->drawing->progress, k + 1, job->frame_source.count,
              paced ? rate_control_name(&job->rate_control) : "");
  return 0;
}

static int draw(struct drawer *drawer, size_t k) {
  struct drawing *drawing = drawer->drawing;
  const uint8_t *torso = NULL;
  ern_renderer *renderer = NULL;
  ern_frame_output output;
  ern_frame_times times;
  if (!wait_for_turn(drawing, &drawing->begun, k)) return EXIT_FAILURE;
  if (begin(drawer, k, &renderer, &torso, &output) != 0) return EXIT_FAILURE;
  end_turn(drawing, &drawing->begun);
  const double began = share_time(drawer, true);
  const ern_status status = render_frame(drawing->job, renderer, k, torso, drawer->windows, &output, &times);
  const double seconds = share_time(drawer, false) - began;
  if (!wait_for_turn(drawing, &drawing->handed, k)) return EXIT_FAILURE;
  if (status != ERN_OK) return render_fail(drawing->job, k);
  if (hand_on(drawer, k, &output) != 0) return EXIT_FAILURE;
  end_turn(drawing, &drawing->handed);
  add_stages(drawer, &times, seconds);
  return 0;
}

static void *drawer_main(void *argument) {
  struct drawer *drawer = argument;
  struct drawing *drawing = drawer->drawing;
  drawer->before = session_seconds();
  for (size_t k = drawer->first; k < drawing->job->frame_source.count && drawer->status == 0; k += drawer->step)
    drawer->status = draw(drawer, k);
  if (drawer->status == 0) return NULL;
  pthread_mutex_lock(&drawing->mutex);
  drawing->stopped = true;
  pthread_cond_broadcast(&drawing->moved);
  pthread_mutex_unlock(&drawing->mutex);
  return NULL;
}

/* *renderer = a second one, NULL where one alone is to draw: on a CPU a frame takes all cores, and some settings need
 * the frame before. */
static int second_renderer(struct render_job *job, ern_renderer **renderer) {
  struct session *session = &job->session;
  struct portrait second = job->portrait;
  *renderer = NULL;
  if (strcmp(session->backend_info.name, "opencl") != 0 || rate_control_asked(&job->rate_control) ||
      job->portrait.render.smooth_lips || job->frame_reuse.camera_is_still)
    return 0;
  /* one suffices where a second does not fit into the device's memory */
  if (ern_renderer_create(renderer, session->backend, second.model, &second.render) != ERN_OK) return 0;
  second.renderer = *renderer;
  const int status = portrait_prune_occupancy(&second, session, &job->frame_source, job->features);
  return status == 0 ? frame_reuse_open(&job->frame_reuse, &second, session, &job->frame_source, job->features)
                     : status;
}

int render_frames(struct render_job *job, struct progress *progress) {
  struct drawing drawing = {.job = job, .progress = progress};
  struct drawer drawers[DRAWERS] = {{.drawing = &drawing, .windows = job->windows, .step = 1}};
  struct drawer *one = &drawers[0], *two = &drawers[1];
  pthread_t thread;
  *two = (struct drawer){.drawing = &drawing, .first = 1, .step = DRAWERS};
  drawing.drawers = drawers;
  pthread_mutex_init(&drawing.mutex, NULL); /* neither fails on Linux */
  pthread_cond_init(&drawing.moved, NULL);
  one->status = second_renderer(job, &two->renderer);
  two->windows = two->renderer != NULL ? malloc(render_window_bytes(job)) : NULL;
  const bool both = one->status == 0 && two->windows != NULL && pthread_create(&thread, NULL, drawer_main, two) == 0;
  if (both) one->step = DRAWERS;
  if (one->status == 0) drawer_main(one);
  if (both) pthread_join(thread, NULL);
  job->stages = (ern_frame_times){.audio = one->stages.audio + two->stages.audio,
                                  .torso = one->stages.torso + two->stages.torso,
                                  .head = one->stages.head + two->stages.head,
                                  .output = one->stages.output + two->stages.output};
  frame_reuse_add(&job->frame_reuse, job->portrait.renderer);
  if (two->renderer != NULL) frame_reuse_add(&job->frame_reuse, two->renderer);
  ern_renderer_free(&two->renderer);
  free(two->windows);
  pthread_cond_destroy(&drawing.moved);
  pthread_mutex_destroy(&drawing.mutex);
  return one->status != 0 ? one->status : two->status;
}
