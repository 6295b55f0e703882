/* SPDX-License-Identifier: MIT */
#include "prepare/footage.h"

#include <math.h>

/* Seconds: a greater step back in time means videos that were concatenated as bytes, which is refused. Frames that
 * overlap by less are skipped. */
#define BEGINS_ANEW 1.0

static ern_status advance(struct ern_footage *f) {
  ern_status status = ERN_OK;
  bool end = false;
  const ern_image free_one = f->now;
  if (f->has_now && f->has_next) f->between = f->next_at - f->now_at;
  f->now = f->next;
  f->now_at = f->next_at;
  f->has_now = f->has_next;
  f->next = free_one;
  for (;; f->left_out += f->next_at >= f->first + f->from) {
    status = ern_video_reader_frame(f->reader, &f->next, &f->next_at, &end);
    f->has_next = status == ERN_OK && !end;
    if (f->has_now && f->has_next && f->next_at < f->now_at - BEGINS_ANEW)
      return ern_fail(f->job->context, ERN_E_FORMAT,
                      "%s: the times of its pictures go back from %.3f s to %.3f s, expected times that rise: its "
                      "parts need to be joined again, as with FFmpeg's concat",
                      f->job->video, f->now_at, f->next_at);
    if (!f->has_now || !f->has_next || f->next_at > f->now_at) return status;
  }
}

ern_status ern_footage_open(const struct ern_prepare_job *job, struct ern_footage *footage) {
  ern_status status = ERN_OK;
  *footage = (struct ern_footage){.job = job, .between = 1.0 / ERN_PREPARE_RATE};
  ern_prepare_part(job, &footage->from, &footage->to);
  ERN_TRY(ern_video_reader_open(job->context, job->video, &footage->reader));
  ern_video_reader_info(footage->reader, &footage->info);
  ERN_TRY(advance(footage));
  if (!footage->has_next)
    ERN_TRY(ern_fail(job->context, ERN_E_FORMAT, "%s: has no frame, expected a video of a person", job->video));
  footage->first = footage->next_at;
  ERN_TRY(advance(footage));
  return ERN_OK;
fail:
  ern_footage_close(footage);
  return status;
}

/* Seconds for which the video's last frame is shown: until the next one would be due, or the file ends. */
static double last_shown(const struct ern_footage *f) {
  const double due = fmin(fmax(f->between, 0.001), 0.5), left = f->info.start + f->info.duration - f->now_at;
  return f->info.duration > 0 ? fmin(due, fmax(left, 1.0 / ERN_PREPARE_RATE)) : due;
}

ern_status ern_footage_next(struct ern_footage *f, const ern_image **frame) {
  const double since = f->from + (double)f->frame / ERN_PREPARE_RATE, at = f->first + since;
  *frame = NULL;
  if (f->to > 0 && since > f->to - 0.5 / ERN_PREPARE_RATE) return ERN_OK;
  while (f->has_next && fabs(f->next_at - at) <= fabs(f->now_at - at)) {
    const ern_status status = advance(f);
    if (status != ERN_OK) return status;
  }
  if (!f->has_next && at > f->now_at + last_shown(f) - 1e-4) return ERN_OK;
  f->frame++;
  *frame = &f->now;
  return ERN_OK;
}

size_t ern_footage_expected(const struct ern_footage *footage) {
  const double end = footage->to > 0 ? footage->to : footage->info.duration;
  const double frames = (end - footage->from) * ERN_PREPARE_RATE;
  return frames >= 1 && frames < 1e7 ? (size_t)frames : 1;
}

void ern_footage_close(struct ern_footage *footage) {
  if (footage->job == NULL) return;
  ern_video_reader_free(&footage->reader);
  ern_image_free(footage->job->context, &footage->now);
  ern_image_free(footage->job->context, &footage->next);
  footage->job = NULL;
}
