/* SPDX-License-Identifier: MIT
 * The checks of videos for test_arguments_media.c, whose table has their rows: it includes this after `w` and `pixels`.
 */
#ifndef ERN_TESTS_ARGUMENTS_VIDEO_H
#define ERN_TESTS_ARGUMENTS_VIDEO_H

CHECK(ern_video_options_default) { assert_int_equal(ern_video_options_default(-1, 0).width, -1); }
CHECK(ern_video_options_fill) { FILLS(ern_video_options, ern_video_options_fill); }
CHECK(ern_video_writer_open) {
  ern_video_options options = ern_video_options_default(16, 16);
  ern_video_writer *writer = (ern_video_writer *)(void *)&w;
  REFUSED_ALONE(ern_video_writer_open(NULL, "a.mp4", &options, &writer));
  assert_null(writer);
  REFUSED(w.context, "path is NULL", ern_video_writer_open(w.context, NULL, &options, &writer));
  REFUSED(w.context, "options is NULL", ern_video_writer_open(w.context, "a.mp4", NULL, &writer));
  REFUSED(w.context, "writer is NULL", ern_video_writer_open(w.context, "a.mp4", &options, NULL));
  REFUSED(w.context, "ern_video_options_default",
          ern_video_writer_open(w.context, "a.mp4", &(ern_video_options){.width = 16, .height = 16}, &writer));
  options.crf = 99;
  REFUSED(w.context, "crf is 99", ern_video_writer_open(w.context, "a.mp4", &options, &writer));
  options.crf = 15;
  options.rate_denominator = 2501;
  REFUSED(w.context, "is 25/2501 frames", ern_video_writer_open(w.context, "a.mp4", &options, &writer));
  options.rate_denominator = 1;
  options.pixel_aspect = 0;
  REFUSED(w.context, "pixel_aspect is 0", ern_video_writer_open(w.context, "a.mp4", &options, &writer));
  options.pixel_aspect = 1;
  options.sound = &(ern_sound){.rate = 16000, .channels = 1, .frames = 1};
  REFUSED(w.context, "no samples", ern_video_writer_open(w.context, "a.mp4", &options, &writer));
  options.size = offsetof(ern_video_options, sound); /* so it is not looked at */
  support_ok(w.context, ern_video_writer_open(w.context, "a.mp4", &options, &writer));
  ern_video_writer_abandon(&writer);
  options.size = sizeof options + 8;
  REFUSED_LATER(w.context, ern_video_options, ern_video_writer_open(w.context, "a.mp4", &options, &writer));
}
CHECK(ern_video_writer_frame) {
  const ern_video_options options = ern_video_options_default(16, 16);
  ern_video_writer *writer = NULL;
  REFUSED_ALONE(ern_video_writer_frame(NULL, pixels));
  support_ok(w.context, ern_video_writer_open(w.context, "a.mp4", &options, &writer));
  REFUSED(w.context, "ern_video_writer_frame: rgba is NULL", ern_video_writer_frame(writer, NULL));
  support_ok(w.context, ern_video_writer_frame(writer, pixels)); /* the writer is none the worse for it */
  support_ok(w.context, ern_video_writer_close(&writer));
}
CHECK(ern_video_writer_patch) { /* a.mp4 is that of ern_video_writer_frame */
  const ern_video_options options = ern_video_options_default(16, 16);
  const int odd[4] = {0, 0, 3, 2}, outside[4] = {8, 8, 16, 2}, whole[4] = {0, 0, 16, 16};
  ern_video_writer *writer = NULL;
  ern_video_reader *reader = NULL;
  ern_video_frame *frame = NULL;
  double seconds;
  support_ok(w.context, ern_video_reader_open(w.context, "a.mp4", &reader));
  support_ok(w.context, ern_video_reader_decode(reader, &frame, &seconds));
  REFUSED_ALONE(ern_video_writer_patch(NULL, frame, whole, pixels));
  support_ok(w.context, ern_video_writer_open(w.context, "b.mp4", &options, &writer));
  REFUSED(w.context, "frame is NULL", ern_video_writer_patch(writer, NULL, whole, pixels));
  REFUSED(w.context, "rgba is NULL", ern_video_writer_patch(writer, frame, whole, NULL));
  assert_int_equal(ern_video_writer_patch(writer, frame, odd, pixels), ERN_E_SHAPE);
  assert_int_equal(ern_video_writer_patch(writer, frame, outside, pixels), ERN_E_SHAPE);
  support_ok(w.context, ern_video_writer_patch(writer, frame, whole, pixels));
  support_ok(w.context, ern_video_writer_patch(writer, frame, NULL, NULL));
  support_ok(w.context, ern_video_writer_close(&writer));
  ern_video_frame_free(&frame);
  ern_video_reader_free(&reader);
}
CHECK(ern_video_writer_close) {
  ern_video_writer *none = NULL;
  REFUSED_ALONE(ern_video_writer_close(NULL));
  REFUSED_ALONE(ern_video_writer_close(&none));
}
CHECK(ern_video_join) {
  const char *const segments[] = {"absent.mp4", NULL};
  REFUSED_ALONE(ern_video_join(NULL, "joined.mp4", segments, 1, NULL, 0));
  REFUSED(w.context, "path is NULL", ern_video_join(w.context, NULL, segments, 1, NULL, 0));
  REFUSED(w.context, "segments is NULL", ern_video_join(w.context, "joined.mp4", NULL, 1, NULL, 0));
  REFUSED(w.context, "segments[1] is NULL", ern_video_join(w.context, "joined.mp4", segments, 2, NULL, 0));
  REFUSED(w.context, "0 videos", ern_video_join(w.context, "joined.mp4", segments, 0, NULL, 0));
  REFUSED(w.context, "starts at -1", ern_video_join(w.context, "joined.mp4", segments, 1, NULL, -1));
}
CHECK(ern_video_writer_abandon) {
  ern_video_writer *none = NULL;
  ern_video_writer_abandon(NULL);
  ern_video_writer_abandon(&none);
}
CHECK(ern_video_reader_open) {
  ern_video_reader *reader = (ern_video_reader *)(void *)&w;
  REFUSED_ALONE(ern_video_reader_open(NULL, "a.mp4", &reader));
  assert_null(reader);
  REFUSED(w.context, "path is NULL", ern_video_reader_open(w.context, NULL, &reader));
  REFUSED(w.context, "reader is NULL", ern_video_reader_open(w.context, "a.mp4", NULL));
}
CHECK(ern_video_reader_info) {
  ern_video_info info = {.width = 7};
  ern_video_reader_info(NULL, &info);
  assert_int_equal(info.width, 0);
  ern_video_reader_info(NULL, NULL);
}
CHECK(ern_video_reader_info_sized) { /* a.mp4 is that of ern_video_writer_frame */
  ern_video_reader *reader = NULL;
  support_ok(w.context, ern_video_reader_open(w.context, "a.mp4", &reader));
  ern_video_reader_info_sized(reader, NULL, sizeof(ern_video_info));
  KEEPS_TO(ern_video_info, ern_video_reader_info_sized(reader, it, bytes));
  ern_video_reader_free(&reader);
}
CHECK(ern_video_reader_frame) { /* a.mp4 is that of ern_video_writer_frame */
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  double seconds;
  bool end;
  REFUSED_ALONE(ern_video_reader_frame(NULL, &image, &seconds, &end));
  support_ok(w.context, ern_video_reader_open(w.context, "a.mp4", &reader));
  REFUSED(w.context, "image is NULL", ern_video_reader_frame(reader, NULL, &seconds, &end));
  REFUSED(w.context, "seconds is NULL", ern_video_reader_frame(reader, &image, NULL, &end));
  REFUSED(w.context, "end is NULL", ern_video_reader_frame(reader, &image, &seconds, NULL));
  support_ok(w.context, ern_video_reader_frame(reader, &image, &seconds, &end));
  assert_false(end);
  ern_image_free(w.context, &image);
  ern_video_reader_free(&reader);
}
CHECK(ern_video_reader_seek) { /* a.mp4 is that of ern_video_writer_frame */
  ern_video_reader *reader = NULL;
  REFUSED_ALONE(ern_video_reader_seek(NULL, 0));
  support_ok(w.context, ern_video_reader_open(w.context, "a.mp4", &reader));
  REFUSED(w.context, "second nan", ern_video_reader_seek(reader, NAN));
  support_ok(w.context, ern_video_reader_seek(reader, 0));
  ern_video_reader_free(&reader);
}
CHECK(ern_video_reader_decode) {
  ern_video_reader *reader = NULL;
  ern_video_frame *frame = (ern_video_frame *)(void *)&w;
  double seconds;
  REFUSED_ALONE(ern_video_reader_decode(NULL, &frame, &seconds));
  assert_null(frame);
  support_ok(w.context, ern_video_reader_open(w.context, "a.mp4", &reader));
  REFUSED(w.context, "frame is NULL", ern_video_reader_decode(reader, NULL, &seconds));
  REFUSED(w.context, "seconds is NULL", ern_video_reader_decode(reader, &frame, NULL));
  ern_video_reader_free(&reader);
}
CHECK(ern_video_reader_rgb) {
  const int outside[4] = {-2, 0, 4, 4};
  ern_video_reader *reader = NULL;
  ern_video_frame *frame = NULL;
  ern_image image = {0};
  double seconds;
  support_ok(w.context, ern_video_reader_open(w.context, "a.mp4", &reader));
  support_ok(w.context, ern_video_reader_decode(reader, &frame, &seconds));
  REFUSED_ALONE(ern_video_reader_rgb(NULL, frame, NULL, &image));
  REFUSED(w.context, "frame is NULL", ern_video_reader_rgb(reader, NULL, NULL, &image));
  REFUSED(w.context, "image is NULL", ern_video_reader_rgb(reader, frame, NULL, NULL));
  assert_int_equal(ern_video_reader_rgb(reader, frame, outside, &image), ERN_E_SHAPE);
  support_ok(w.context, ern_video_reader_rgb(reader, frame, NULL, &image));
  ern_image_free(w.context, &image);
  ern_video_reader_free(&reader);
  assert_true(ern_video_frame_is_plain(frame));
  ern_video_frame_free(&frame);
}
CHECK(ern_video_frame_is_plain) { assert_false(ern_video_frame_is_plain(NULL)); }
CHECK(ern_video_frame_clone) {
  ern_video_reader *reader = NULL;
  ern_video_frame *frame = NULL, *clone = (ern_video_frame *)(void *)&w;
  double seconds;
  support_ok(w.context, ern_video_reader_open(w.context, "a.mp4", &reader));
  support_ok(w.context, ern_video_reader_decode(reader, &frame, &seconds));
  REFUSED_ALONE(ern_video_frame_clone(NULL, frame, &clone));
  assert_null(clone);
  REFUSED(w.context, "frame is NULL", ern_video_frame_clone(w.context, NULL, &clone));
  REFUSED(w.context, "clone is NULL", ern_video_frame_clone(w.context, frame, NULL));
  support_ok(w.context, ern_video_frame_clone(w.context, frame, &clone));
  ern_video_frame_free(&frame);
  ern_video_reader_free(&reader);
  assert_true(ern_video_frame_is_plain(clone)); /* it outlives both */
  ern_video_frame_free(&clone);
}
CHECK(ern_video_frame_free) {
  ern_video_frame *none = NULL;
  ern_video_frame_free(NULL);
  ern_video_frame_free(&none);
}
CHECK(ern_video_reader_free) {
  ern_video_reader *none = NULL;
  ern_video_reader_free(NULL);
  ern_video_reader_free(&none);
}

#endif
