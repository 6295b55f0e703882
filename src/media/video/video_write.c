/* SPDX-License-Identifier: MIT
 * Writes video files (mp4, mov, mkv, webm, gif) through FFmpeg. */
#include <stdio.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "core/sized.h"
#include "ernerf/media.h"
#include "io/file.h"
#include "media/ffmpeg.h"
#include "media/image.h"
#include "media/live/picture_track.h"
#include "media/video/video_frame.h"
#include "media/video/video_sound.h"

struct ern_video_writer {
  ern_context *context;
  const struct ern_video_form *form;
  struct ern_file_writer file;
  ern_status broken; /* status and error text of the first frame that failed */
  char broken_text[1024];
  AVRational rate;
  struct ern_muxer muxer;
  struct ern_picture_track pictures;
  struct ern_sound_track sound;
  struct ern_provenance_texts provenance;
};

static ern_status check_options(ern_context *context, const char *path, const ern_video_options *options) {
  ern_status status = ERN_OK;
  ERN_TRY(ern_image_check_sides(context, path, options->width, options->height));
  ERN_TRY(ern_picture_rate_check(context, path, options->rate_numerator, options->rate_denominator));
  if (!(options->pixel_aspect >= 0.01 && options->pixel_aspect <= 100))
    ERN_TRY(
        ern_fail(context, ERN_E_ARGUMENT, "%s: pixel_aspect is %g, expected 0.01 to 100", path, options->pixel_aspect));
  status = ern_sound_track_check(context, path, options->sound, options->sound_start);
fail:
  return status;
}

/* mp4 and QuickTime. */
static bool has_boxes(const struct ern_video_form *form) {
  return strcmp(form->muxer, "mp4") == 0 || strcmp(form->muxer, "mov") == 0;
}

/* Lets FFmpeg open the temporary file, which `file` has locked, by its name, and writes the container's header. */
static ern_status open_file(ern_video_writer *writer) {
  ern_context *context = writer->context;
  AVFormatContext *container = writer->muxer.container;
  ern_status status = ERN_OK;
  char *url = NULL;
  AVDictionary *options = NULL;
  ERN_TRY(ern_av_url(context, writer->file.temporary, &url));
  container->url = av_strdup(url); /* the second pass of faststart reads the file again by this name */
  int error = container->url != NULL ? avio_open(&container->pb, url, AVIO_FLAG_WRITE) : AVERROR(ENOMEM);
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_IO, writer->file.path, "write", error));
  const bool tagged = writer->provenance.xmp != NULL; /* mp4 has no place of its own for these tags */
  if (has_boxes(writer->form))
    error = av_dict_set(&options, "movflags", tagged ? "+faststart+use_metadata_tags" : "+faststart", 0);
  if (error >= 0) error = avformat_write_header(container, &options);
  if (error >= 0) error = container->pb->error;
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_MEDIA, writer->file.path, "write its head", error));
fail:
  av_dict_free(&options);
  ern_release(context, url);
  return status;
}

ern_status ern_video_writer_open(ern_context *context, const char *path, const ern_video_options *options,
                                 ern_video_writer **writer) {
  ERN_PLAIN_FLOATS;
  if (writer != NULL) *writer = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, options);
  ERN_NEED(context, writer);
  ern_status status = ERN_OK;
  ern_video_writer *made = NULL;
  ern_video_options chosen = ern_video_options_default(0, 0);
  ern_av_disable_log();
  ERN_TRY(ERN_COPY_IN_CONFIG(context, ern_video_options, &chosen, options));
  ERN_TRY(check_options(context, path, &chosen));
  ERN_TRY(ERN_NEW(context, 1, &made));
  made->context = context;
  made->file.descriptor = -1;
  made->form = ern_video_form_of(path);
  struct ern_picture_settings pictures = {
      .coding = ERN_PICTURES_FILE, .preset = chosen.preset, .crf = chosen.crf, .pixel_aspect = chosen.pixel_aspect};
  ERN_TRY(ern_video_codec_of(context, path, made->form, chosen.codec, &pictures.codec));
  ERN_TRY(ern_video_codec_check(context, path, pictures.codec, chosen.crf, chosen.preset));
  if (chosen.sound != NULL && made->form->sound == AV_CODEC_ID_NONE)
    ERN_TRY(ern_fail(context, ERN_E_UNSUPPORTED, "%s: there is a sound for it, and a %s holds none", path,
                     made->form->muxer));
  av_reduce(&made->rate.num, &made->rate.den, chosen.rate_numerator, chosen.rate_denominator, ERN_RATE_PART);
  if (strcmp(made->form->muxer, "gif") == 0 && av_cmp_q(made->rate, (AVRational){100, 1}) > 0)
    ERN_TRY(ern_fail(context, ERN_E_ARGUMENT,
                     "%s: %g frames a second, expected at most 100 in a gif, whose times are in 1/100 s", path,
                     av_q2d(made->rate)));
  ERN_TRY(ern_file_writer_open(context, path, ERN_EXISTING_BY_CONTEXT, &made->file));
  made->muxer = (struct ern_muxer){.context = context, .path = made->file.path, .packet = av_packet_alloc()};
  const int error = avformat_alloc_output_context2(&made->muxer.container, NULL, made->form->muxer, NULL);
  if (error < 0 || made->muxer.packet == NULL) {
    ERN_TRY(ern_av_fail(context, ERN_E_MEDIA, path, "make a video", error < 0 ? error : AVERROR(ENOMEM)));
  }
  ERN_TRY(ern_picture_track_open(&made->muxer, chosen.width, chosen.height, made->rate, &pictures, &made->pictures));
  ERN_TRY(ern_sound_track_open(&made->muxer, chosen.sound, chosen.sound_start, made->form->sound, &made->sound));
  ERN_TRY(ern_provenance_texts_make(context, chosen.provenance, &made->provenance));
  ERN_TRY(ern_muxer_tag(&made->muxer, &made->provenance));
  ERN_TRY(open_file(made));
  *writer = made;
  return ERN_OK;
fail:
  ern_video_writer_abandon(&made);
  return status;
}

/* Writes rgba, or where there is a recorded frame that one, its part replaced by rgba. */
static ern_status write_frame(ern_video_writer *writer, const ern_video_frame *recorded, const int part[4],
                              const uint8_t *rgba) {
  struct ern_muxer *muxer = &writer->muxer;
  ern_status status = ERN_OK;
  ERN_TRY(recorded == NULL ? ern_picture_track_add(muxer, &writer->pictures, rgba)
                           : ern_picture_track_add_patched(muxer, &writer->pictures, recorded->frame, part, rgba));
  ERN_TRY(ern_sound_track_advance(muxer, &writer->sound, writer->pictures.count, writer->rate, false));
fail:
  return status;
}

/* As write_frame; after a failure it fails in the same way. */
static ern_status write_unless_broken(ern_video_writer *writer, const ern_video_frame *recorded, const int part[4],
                                      const uint8_t *rgba) {
  if (writer->broken == ERN_OK) {
    writer->broken = write_frame(writer, recorded, part, rgba);
    if (writer->broken == ERN_OK) return ERN_OK;
    (void)ern_last_error_copy(writer->context, writer->broken_text, sizeof writer->broken_text);
  }
  return ern_fail(writer->context, writer->broken, "%s", writer->broken_text);
}

ern_status ern_video_writer_frame(ern_video_writer *writer, const uint8_t *rgba) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, writer);
  ERN_NEED(writer->context, rgba);
  return write_unless_broken(writer, NULL, NULL, rgba);
}

ern_status ern_video_writer_patch(ern_video_writer *writer, const ern_video_frame *frame, const int part[4],
                                  const uint8_t *rgba) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, writer);
  ERN_NEED(writer->context, frame);
  const int whole[4] = {0, 0, frame->frame->width, frame->frame->height};
  if (part != NULL) ERN_NEED(writer->context, rgba);
  const ern_status status =
      ern_video_frame_check(writer->context, writer->file.path, frame, part != NULL ? part : whole);
  return status == ERN_OK ? write_unless_broken(writer, frame, part, rgba) : status;
}

/* Flushes the encoders, writes the trailer, closes the file. */
static ern_status finish(ern_video_writer *writer) {
  ern_context *context = writer->context;
  AVFormatContext *container = writer->muxer.container;
  ern_status status = ERN_OK;
  if (writer->broken != ERN_OK) ERN_TRY(ern_fail(context, writer->broken, "%s", writer->broken_text));
  if (writer->pictures.count == 0) {
    ERN_TRY(ern_fail(context, ERN_E_STATE, "%s: not made, for it has 0 frames, expected 1 or more", writer->file.path));
  }
  ERN_TRY(ern_sound_track_advance(&writer->muxer, &writer->sound, writer->pictures.count, writer->rate, true));
  ERN_TRY(ern_muxer_encode(&writer->muxer, writer->pictures.codec, writer->pictures.stream, NULL));
  const bool packed = has_boxes(writer->form) || strcmp(writer->form->muxer, "gif") == 0;
  ERN_TRY(ern_muxer_end(&writer->muxer, packed ? writer->provenance.xmp : NULL));
  avio_flush(container->pb);
  int error = container->pb->error;
  const int closed = avio_closep(&container->pb);
  if (error >= 0) error = closed;
  if (error < 0) ERN_TRY(ern_av_fail(context, ERN_E_IO, writer->file.path, "write the tail", error));
  status = ern_file_writer_commit(&writer->file);
fail:
  return status;
}

ern_status ern_video_writer_close(ern_video_writer **writer) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(NULL, writer);
  ERN_NEED(NULL, *writer);
  const ern_status status = finish(*writer);
  ern_video_writer_abandon(writer);
  return status;
}

void ern_video_writer_abandon(ern_video_writer **writer) {
  if (writer == NULL || *writer == NULL) return;
  ern_video_writer *dying = *writer;
  ern_context *context = dying->context;
  *writer = NULL;
  ern_sound_track_close(&dying->sound);
  ern_picture_track_close(context, &dying->pictures);
  av_packet_free(&dying->muxer.packet);
  if (dying->muxer.container != NULL) avio_closep(&dying->muxer.container->pb);
  avformat_free_context(dying->muxer.container);
  ern_file_writer_abandon(&dying->file);
  ern_provenance_texts_free(context, &dying->provenance);
  ern_release(context, dying);
}
