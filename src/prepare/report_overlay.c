/* SPDX-License-Identifier: MIT
 * Writes overlay.mp4: every frame with its pose and landmarks drawn, and the sound. */
#include <stdio.h>
#include <unistd.h>

#include "io/landmarks.h"
#include "prepare/report.h"

static ern_status add_frame(struct ern_prepare_job *job, ern_video_writer *writer, size_t frame,
                            const struct ern_head_pose *pose, uint8_t *rgba) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH], name[64];
  float landmarks[ERN_LANDMARKS][2];
  ern_image picture = {0};
  snprintf(name, sizeof name, "ori_imgs/%zu.jpg", frame);
  ERN_TRY(ern_prepare_picture(job, name, 3, &picture));
  ERN_TRY(ern_prepare_path(job, path, "ori_imgs/%zu.lms", frame));
  ERN_TRY(ern_landmarks_read(job->context, path, landmarks));
  ERN_TRY(ern_report_draw(job, &picture, pose, (const float(*)[2])landmarks));
  const size_t pixels = (size_t)picture.width * (size_t)picture.height;
  for (size_t i = 0; i < pixels; i++) {
    for (size_t c = 0; c < 3; c++) rgba[4 * i + c] = picture.data[3 * i + c];
    rgba[4 * i + 3] = 255;
  }
  ERN_TRY(ern_video_writer_frame(writer, rgba));
fail:
  ern_image_free(job->context, &picture);
  return status;
}

ern_status ern_report_overlay(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH];
  struct ern_head_pose *poses = NULL;
  uint8_t *rgba = NULL;
  ern_sound sound = {0};
  ern_video_writer *writer = NULL;
  ern_video_options options = ern_video_options_default(job->side, job->side);
  options.crf = 23;
  ERN_TRY(ERN_NEW(job->context, job->frames, &poses));
  ERN_TRY(ERN_NEW(job->context, 4 * (size_t)job->side * (size_t)job->side, &rgba));
  ERN_TRY(ern_prepare_poses_read(job, poses));
  ERN_TRY(ern_prepare_path(job, path, "aud.wav"));
  if (access(path, F_OK) == 0) {
    ERN_TRY(ern_sound_read(job->context, path, &sound));
    options.sound = &sound;
  }
  ERN_TRY(ern_prepare_register_output(job, "overlay.mp4", path));
  ERN_TRY(ern_video_writer_open(job->context, path, &options, &writer));
  for (size_t i = 0; i < job->frames; i++) {
    ERN_TRY(add_frame(job, writer, i, &poses[i], rgba));
    ERN_TRY(ern_prepare_progress(job, i + 1, job->frames));
  }
  status = ern_video_writer_close(&writer);
fail:
  ern_video_writer_abandon(&writer);
  ern_sound_free(job->context, &sound);
  ern_release(job->context, poses);
  ern_release(job->context, rgba);
  return status;
}
