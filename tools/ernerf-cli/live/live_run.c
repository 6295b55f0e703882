/* SPDX-License-Identifier: MIT
 * The main loop of live frames: schedules each frame, draws it, and handles late frames. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "live/live_job.h"

/* ---- what a frame shows ------------------------------------------------------------------------------------------ */

/* Advances pose and recorded frame forward and backward through the clip, at the clip's rate, also during silence. */
static int move(struct live_job *job) {
  const bool dubs = job->video.path != NULL;
  if (dubs && live_video_show(&job->video, job->moved) != 0) return EXIT_FAILURE;
  job->place = dubs ? job->video.shown->place : frame_source_cycle(&job->poses, job->rate, job->moved);
  if (job->eye >= 0) job->place.eye = job->eye;
  if (!job->held) job->moved++;
  return 0;
}

static ern_frame_input input_of(struct live_job *job, const struct frame_source *frames, size_t k, float refined[16],
                                const uint8_t *torso) {
  const bool dubs = job->video.path != NULL;
  const int *whole = job->video.dubbed.size;
  return (ern_frame_input){
      .camera = frame_source_camera(frames, k, job->portrait.scale, dubs ? whole[0] : job->size.width,
                                    dubs ? whole[1] : job->size.height, (ern_fit)job->fit),
      .head_pose = portrait_refined(&job->portrait, frames, k, refined),
      .eye = frames->source_frame[k].eye,
      .individual = ERN_INDIVIDUAL_MEAN,
      .background = job->background.image.data,
      .torso = torso,
      .torso_motion = frame_source_motion(frames, k)};
}

/* The clip's own torso picture, where the model has no torso. */
static int find_torso(struct live_job *job, const uint8_t **torso) {
  *torso = NULL;
  if (job->video.path != NULL || job->portrait.info.has_torso || !job->portrait.clip_info.has_torso) return 0;
  return background_torso(&job->background, &job->session, job->portrait.clip, job->place.split, job->place.index,
                          torso);
}

/* The recorded frame with the lower face of `frame`. */
static ern_status draw_over_video(struct live_job *job, const ern_live_frame *frame, ern_renderer *renderer,
                                  ern_frame_input *input, uint8_t *rgba) {
  input->windows = frame->windows;
  input->window_length = frame->window_length;
  input->silence_code = frame->silence_code;
  input->silence_weight = frame->silence_weight;
  const ern_status status = live_video_draw(&job->video, renderer, &job->now, 0, input, rgba);
  job->as_recorded += job->video.dubbed.box[2] == 0;
  return status;
}

static int draw(struct live_job *job, const ern_live_frame *frame, uint8_t *rgba) {
  const uint8_t *torso;
  float refined[16];
  ern_renderer *renderer = !job->unpaced ? rate_control_renderer(&job->rate_control) : job->portrait.renderer;
  if (renderer == NULL || find_torso(job, &torso) != 0) return EXIT_FAILURE;
  ern_frame_input input = input_of(job, &job->now, 0, refined, torso);
  const ern_frame_output output = {.rgba = rgba};
  const ern_status status = job->video.path != NULL ? draw_over_video(job, frame, renderer, &input, rgba)
                                                    : ern_live_draw(frame, renderer, &input, &output, NULL);
  job->drawn += status == ERN_OK;
  return status == ERN_OK ? 0 : session_fail(&job->session);
}

int live_calibration_draw(void *user, ern_renderer *renderer, size_t k, float *rgb) {
  struct live_job *job = user;
  float refined[16];
  ern_frame_input input = input_of(job, &job->poses, k, refined, NULL);
  const ern_frame_output output = {.rgba = job->look, .rgb = rgb};
  frame_source_windows(&job->poses, k, job->features, (ern_audio_pad)job->portrait.audio_pad, job->windows);
  input.windows = job->windows;
  input.window_length = job->features->window_length;
  const ern_status status = job->video.path != NULL
                                ? live_video_draw(&job->video, renderer, &job->poses, k, &input, job->look)
                                : ern_renderer_frame(renderer, &input, &output, NULL);
  if (status == ERN_OK && job->video.path != NULL && rgb != NULL) live_video_colours(&job->video, job->look, rgb);
  return status == ERN_OK ? 0 : session_fail(&job->session);
}

/* ---- time -------------------------------------------------------------------------------------------------------- */

static void count_time(struct live_times *times, double seconds) {
  const double ms = 1000 * seconds;
  times->bin[ms <= 0 ? 0 : ms >= LIVE_MILLISECONDS ? LIVE_MILLISECONDS : (size_t)ms]++;
  times->count++;
}

/* A signal ends the sleep. */
static void sleep_until(double due) {
  const double left = due - session_seconds();
  if (left <= 0) return;
  const double whole = floor(left);
  const struct timespec time = {(time_t)whole, (long)((left - whole) * 1e9)};
  (void)nanosleep(&time, NULL);
}

static double due_of(const struct live_job *job) { return job->began + (double)job->frames / rate_value(job->rate); }

/* ---- a frame ----------------------------------------------------------------------------------------------------- */

/* late: the frame is not drawn; the previous picture is repeated. A recorded video goes on at the next drawn frame, as
 * it would jump else. */
static int make_frame(struct live_job *job, const ern_live_frame *frame, bool late) {
  bool failed;
  const double pulled = session_seconds();
  struct live_picture *picture = live_output_next(&job->output, &failed);
  if (failed) return EXIT_FAILURE;
  const bool repeat = late && job->drawn > 0, stays = job->video.path != NULL && (picture == NULL || repeat);
  if (!stays && move(job) != 0) return EXIT_FAILURE;
  if (picture == NULL) return 0;
  picture->repeat = repeat;
  picture->samples = frame->samples;
  picture->due = job->unpaced ? session_seconds() : due_of(job);
  memcpy(picture->sound, frame->sound, frame->samples * (size_t)job->sound.channels * sizeof(float));
  ern_video_frame_free(&picture->recorded);
  if (!picture->repeat && draw(job, frame, picture->rgba) != 0) return EXIT_FAILURE;
  if (!picture->repeat && job->video.in_place &&
      live_video_cut(&job->video, picture->rgba, picture->part, &picture->recorded) != 0)
    return EXIT_FAILURE;
  if (!picture->repeat && watermark_put(&job->watermark, &job->session, picture->rgba) != 0) return EXIT_FAILURE;
  if (!picture->repeat) label_put(&job->label, frame->seconds, picture->rgba, job->size.width);
  job->repeated += picture->repeat;
  live_output_put(&job->output);
  const double done = session_seconds();
  count_time(&job->to_frame, frame->waiting + 1 / rate_value(job->rate) + done - pulled);
  if (!picture->repeat && !job->unpaced) {
    rate_control_took(&job->rate_control, 1000 * (done - pulled));
    rate_control_late(&job->rate_control, 1000 * (done - due_of(job) - 1 / rate_value(job->rate)));
  }
  return 0;
}

/* Serves the lines that wait: of a flood of them, LINES a frame, so that the stream goes on. */
static void apply_control(struct live_job *job) {
  enum { LINES = 32 };
  const char *line = NULL;
  for (int i = 0; i < LINES && !job->quits && (line = live_control_line(&job->commands)) != NULL; i++)
    live_command(job, line);
  if (job->frames == 0) return; /* where none comes, the error of the sound is why, and the last thing that is said */
  char *error = live_sound_take_error(&job->sound);
  if (error != NULL) session_warn(&job->session, "%s", error);
  free(error);
}

/* Tells the client which utterances the frame begins or ends with. */
static void tell_events(struct live_job *job, const ern_live_frame *frame) {
  static const char *const words[] = {[LIVE_STARTED] = "started", [LIVE_ENDED] = "ended", [LIVE_FAILED] = "failed"};
  unsigned id = 0;
  char *why = NULL;
  job->heard += frame->samples;
  for (enum live_event event; (event = live_sound_event(&job->sound, job->heard, &id, &why)) != LIVE_NONE; free(why))
    live_control_event(&job->commands, words[event], id, why);
}

/* Samples that the first frame needs, else it would get silence: its own duration or its look-ahead (ern_live_options).
 */
static unsigned long long first_samples(const struct live_job *job) {
  const double seconds = fmax((job->look_ahead + 1) / (double)RATE_CLIP, 1 / rate_value(job->rate));
  return (unsigned long long)ceil(seconds * job->sound.rate);
}

int live_run(struct live_job *job) {
  const double period = 1 / rate_value(job->rate);
  const uint64_t most = job->seconds > 0 ? (uint64_t)ceil(job->seconds * rate_value(job->rate)) : UINT64_MAX;
  live_sound_await(&job->sound, first_samples(job));
  job->began = session_seconds();
  for (bool ended = false; !ended && !session_interrupted() && !job->quits && job->frames < most;) {
    const ern_live_frame *frame = NULL;
    if (!job->unpaced) sleep_until(due_of(job));
    apply_control(job);
    if (ern_live_pull(job->live, job->unpaced ? 0.1 : 0, &frame, &ended) != ERN_OK) return session_fail(&job->session);
    if (frame == NULL) continue;
    if (live_control_hears(&job->commands)) tell_events(job, frame);
    if (job->most_delay > 0 && frame->waiting > job->most_delay + (job->look_ahead + 1) / (double)RATE_CLIP) {
      job->skipped++;
      continue;
    }
    const bool late = !job->unpaced && session_seconds() > due_of(job) + period;
    if (make_frame(job, frame, late) != 0) return EXIT_FAILURE;
    job->frames++;
  }
  return 0;
}
