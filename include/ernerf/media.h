/* SPDX-License-Identifier: MIT
 * libernerf-media: clips, pictures, video and sound. The engine (libernerf) needs none of it. base.h defines the terms
 * "plain data", "may grow", "final", "cookie" and "atomic", and what all functions do with NULL and after errors.
 * FFmpeg's log level, which is one for the process, is set to AV_LOG_FATAL where it is at its default. */
#ifndef ERNERF_MEDIA_H
#define ERNERF_MEDIA_H

#include <stdbool.h>

#include "ernerf/base.h"
#include "ernerf/data.h"
#include "ernerf/train.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- pictures ---------------------------------------------------------------------------------------------------- */

enum { ERN_IMAGE_MAX_SIDE = 8192 }; /* pixels; a larger picture is refused before memory is taken */

/* 8 bits a channel, top row first, channels interleaved. Plain data, final. */
typedef struct ern_image {
  int width, height, channels; /* channels: 1 grey, 3 RGB, 4 RGBA (alpha not premultiplied) */
  uint8_t *data;               /* [height][width][channels]; owned by the holder (ern_image_free) */
} ern_image;

/* How a picture or video was made, which its file then says: as an XMP packet (ISO 16684-1) with IPTC's
 * DigitalSourceType, and with the label of GB 45438-2025 ("AIGC"). PNG and JPEG have the packet in the place that XMP
 * gives it, OpenEXR as the attribute "xmp", an mp4 or mov file as a box at its end, a gif as an application extension.
 * mp4 and mov files have tags too; Matroska, WebM, FLV, NUT and a streamed mp4 have tags alone. MPEG-TS, y4m and raw
 * pictures say nothing. Texts are UTF-8 and read during the call alone. Plain data, may grow. */
typedef struct ern_provenance {
  uint32_t cookie, size; /* set by ern_provenance_default() */
  bool all_trained;      /* false (default): a trained model's picture together with recorded ones, such as a background
                            (compositeWithTrainedAlgorithmicMedia); true: nothing else (trainedAlgorithmicMedia) */
  const char *id;        /* identifies the file, such as a hash (ProduceID of the label): at most 128 of A-Z, a-z, 0-9
                            and "._:-"; NULL (default): none */
  const char *consent;   /* what the person has agreed to (ern_model_info), less than ERN_CONSENT_BYTES; NULL (default)
                            or "": it is not known */
  const char *description; /* what of it is synthetic, in words, UTF-8, less than ERN_CONSENT_BYTES; NULL (default) or
                              "": not said */
} ern_provenance;

/* The defaults. */
ERN_API void ern_provenance_fill(ern_provenance *provenance, size_t bytes);
static inline ern_provenance ern_provenance_default(void) {
  ern_provenance provenance;
  ern_provenance_fill(&provenance, sizeof provenance);
  return provenance;
}

/* Reads a still (PNG, JPEG, OpenEXR, TIFF, BMP, GIF, WebP or PNM, by its content) as 8-bit with 3 or 4 channels: grey
 * is repeated, missing alpha is 255, alpha that was not asked for is dropped (not multiplied in). A picture with an
 * EXIF orientation is turned upright. Colours of an ICC profile of a matrix and curves (Display P3, Adobe RGB, grey)
 * become those of sRGB; a profile of another form is ignored with a warning, and so are primaries or a gamma that a PNG
 * states without a profile (cICP, cHRM, gAMA), as libpng and Pillow ignore them. Values 0..1 of OpenEXR become 0..255
 * without a transfer curve. The colours of a WebP with alpha are right to 1/255 once they are composited; where alpha
 * is 0 they are black. On success the caller owns image->data (ern_image_free). A file whose header has a side
 * above ERN_IMAGE_MAX_SIDE, or a size that the file is too short for, is refused before memory is taken. */
ERN_API ERN_NODISCARD ern_status ern_image_read(ern_context *context, const char *path, int channels, ern_image *image);
/* Width and height, upright, from the header alone. */
ERN_API ERN_NODISCARD ern_status ern_image_size(ern_context *context, const char *path, int *width, int *height);
/* The format follows from the extension: .png (1, 3 or 4 channels) or .jpg, .jpeg (1 or 3, else ERN_E_ARGUMENT; quality
 * 1..100, which .png ignores). Atomic. */
ERN_API ERN_NODISCARD ern_status ern_image_write(ern_context *context, const char *path, const ern_image *image,
                                                 int quality);
/* The same, and the file says how it was made. provenance NULL: it does not. */
ERN_API ERN_NODISCARD ern_status ern_image_write_provenance(ern_context *context, const char *path,
                                                            const ern_image *image, int quality,
                                                            const ern_provenance *provenance);
/* OpenEXR, 32-bit float: data[height][width][channels], channel names such as "R", "G", "B", "A", "Z". Atomic. */
ERN_API ERN_NODISCARD ern_status ern_image_write_exr(ern_context *context, const char *path, const float *data,
                                                     int width, int height, int channels, const char *const *names);
/* The same, and the file says how it was made. provenance NULL: it does not. */
ERN_API ERN_NODISCARD ern_status ern_image_write_exr_provenance(ern_context *context, const char *path,
                                                                const float *data, int width, int height, int channels,
                                                                const char *const *names,
                                                                const ern_provenance *provenance);
/* Dense optical flow from one grey picture [height][width] to another, 16 to 8192 pixels a side (DIS: Kroeger et al.,
 * "Fast Optical Flow using Dense Inverse Search", ECCV 2016). flow: [height][width][2], the caller's memory; for each
 * pixel of `from` how far it moves, in pixels to the right and down. Computed by libernerf-vision, which is loaded for
 * it; ERN_E_UNSUPPORTED where it is not there. */
ERN_API ERN_NODISCARD ern_status ern_optical_flow(ern_context *context, const uint8_t *from, const uint8_t *to,
                                                  int width, int height, float *flow);
/* Resizes by OpenCV's INTER_AREA, to 1..ERN_IMAGE_MAX_SIDE pixels a side, with the same channels. On success the caller
 * owns resized->data (ern_image_free). resized: another struct than `image`, else ERN_E_ARGUMENT, and it stays. */
ERN_API ERN_NODISCARD ern_status ern_image_resize(ern_context *context, const ern_image *image, int width, int height,
                                                  ern_image *resized);
ERN_API void ern_image_free(ern_context *context, ern_image *image); /* accepts NULL and an empty one */

/* ---- how different pictures look --------------------------------------------------------------------------------- */

/* LPIPS, how different two pictures look: version 0.1 of Zhang et al., "The Unreasonable Effectiveness of Deep Features
 * as a Perceptual Metric" (CVPR 2018), with weights that the user brings. One thread at a time uses it. */
typedef struct ern_lpips ern_lpips;

/* network: AlexNet or VGG16 as torchvision stores it (tensors features.N.weight, features.N.bias). Which of the two it
 * is follows from the shape of features.0.weight. heads: the linear layers of LPIPS for that network
 * (lin0.model.1.weight to lin4.model.1.weight). Each is a .pth file, also of before PyTorch 1.6, or a .safetensors
 * file. On success the caller owns *lpips. Computed by libernerf-perceptual, which is loaded for it; ERN_E_UNSUPPORTED
 * where it is not there. ERN_E_SHAPE, ERN_E_MISSING, ERN_E_NONFINITE: not the weights of such a network; the error
 * names file and tensor. */
ERN_API ERN_NODISCARD ern_status ern_lpips_open(ern_lpips **lpips, ern_context *context, const char *network,
                                                const char *heads);
ERN_API void ern_lpips_free(ern_lpips **lpips); /* accepts NULL and a pointer to NULL */

/* "lpips-alexnet" or "lpips-vgg16"; lives as long as `lpips`. */
ERN_API const char *ern_lpips_name(const ern_lpips *lpips);

/* picture and truth, the recorded one: [3][height][width], red, green, blue, 0..1; at least 31 pixels a side with
 * AlexNet, 16 with VGG16, at most 8192, else ERN_E_ARGUMENT. *distance is 0 for equal pictures and larger the less
 * alike they look; it has no unit. dpicture: d distance/d picture [3][height][width], overwritten; NULL: not wanted.
 * Equation: docs/maths.md, "The fine stage". */
ERN_API ERN_NODISCARD ern_status ern_lpips_distance(ern_lpips *lpips, const float *picture, const float *truth,
                                                    int width, int height, double *distance, float *dpicture);

/* As the loss of the patches of a training's fine stage (ern_train_config.fine_loss). `lpips` must outlive the
 * trainer. */
ERN_API ern_fine_loss ern_lpips_fine_loss(ern_lpips *lpips);

/* ---- networks ---------------------------------------------------------------------------------------------------- */

enum { ERN_NETWORK_DIMS = 8 };

/* A network of the caller's, FILE.onnx, with one input of float numbers and fixed sizes. One thread at a time uses it.
 */
typedef struct ern_network ern_network;

/* Computed by libernerf-vision, which is loaded for it; ERN_E_UNSUPPORTED where it is not there, or where OpenCV does
 * not support the network. The file is checked before OpenCV reads it. On success the caller owns *network. */
ERN_API ERN_NODISCARD ern_status ern_network_open(ern_context *context, const char *path, ern_network **network);
ERN_API void ern_network_free(ern_network **network);
/* Fills shape with the sizes of the input and returns how many there are; 0 where an argument is NULL. */
ERN_API int ern_network_input(const ern_network *network, int shape[ERN_NETWORK_DIMS]);
/* Computes the first output that the file names: *count numbers in C order, which belong to the network until the next
 * call. input: as many numbers as its sizes say, in C order. ERN_E_NONFINITE where a number of the output is not
 * finite. */
ERN_API ERN_NODISCARD ern_status ern_network_run(ern_network *network, const float *input, const float **output,
                                                 size_t *count);

/* ---- sound ------------------------------------------------------------------------------------------------------- */

/* Plain data, final. */
typedef struct ern_sound {
  int rate;      /* samples a second, 1..384000 */
  int channels;  /* 1..8 */
  size_t frames; /* samples a channel */
  int16_t *data; /* [frames][channels]; owned by the holder (ern_sound_free) */
} ern_sound;

/* Reads a sound file of any format that FFmpeg reads, as 16-bit samples from second 0 of the file on; gaps become
 * silence. Samples beyond full scale are clipped. ERN_E_NONFINITE: a sample is not finite. At most 2^31 samples of all
 * channels, else ERN_E_SHAPE. On success the caller owns sound->data. */
ERN_API ERN_NODISCARD ern_status ern_sound_read(ern_context *context, const char *path, ern_sound *sound);
ERN_API ERN_NODISCARD ern_status ern_sound_write_wav(ern_context *context, const char *path,
                                                     const ern_sound *sound); /* atomic */
ERN_API void ern_sound_free(ern_context *context, ern_sound *sound);

/* ---- video ------------------------------------------------------------------------------------------------------- */

/* Plain data, may grow. */
typedef struct ern_video_options {
  uint32_t cookie, size; /* set by ern_video_options_default() */
  int width, height;     /* of the frames handed over, 1..ERN_IMAGE_MAX_SIDE; odd sizes are padded by a repeated row or
                            column, so that the file has even ones */
  int rate_numerator, rate_denominator; /* numerator/denominator frames a second, 1/100 to 1000, each part 1..1000000;
                                           default 25, 1 */
  const ern_sound *sound; /* NULL (default): silent. Muxed as AAC, in a .webm as Opus; cut to the length of the pictures
                             at close, not padded. Must outlive the writer. Not with a .gif (ERN_E_UNSUPPORTED) */
  double sound_start;     /* seconds into `sound` at the first frame, 0 <= sound_start < 1e9; default 0 */
  int crf;                /* quality 0..51, of vp9 and av1 0..63, less is better; default 15; ffv1 and gif have none */
  const ern_provenance *provenance; /* what the file says of how it was made; NULL (default): nothing */
  const char *codec;  /* "h264", "hevc", "vp9", "av1" or "ffv1" (without loss), where the file holds it; NULL (default):
                         h264, of a .webm vp9 */
  const char *preset; /* of h264 and hevc: x264's "ultrafast" to "placebo"; NULL (default): "veryfast" */
  double pixel_aspect; /* width of a pixel over its height, as it is to be shown: 0.01 to 100, default 1 */
} ern_video_options;

/* The defaults. */
ERN_API void ern_video_options_fill(ern_video_options *options, size_t bytes);
static inline ern_video_options ern_video_options_default(int width, int height) {
  ern_video_options options;
  ern_video_options_fill(&options, sizeof options);
  options.width = width;
  options.height = height;
  return options;
}

/* A decoded frame of a video, in the file's pixel format. One thread at a time uses a frame; a clone is another. */
typedef struct ern_video_frame ern_video_frame;

/* By the name's ending, in any case: .mp4 .m4v (h264, hevc, vp9, av1), .mov (h264, hevc), .mkv (h264, hevc, vp9, av1,
 * ffv1), .webm (vp9, av1), .gif (256 colours); any other is an mp4. Pictures are yuv420p (BT.709, limited range, tagged
 * so), RGB of ffv1 and gif. Frame k is shown at exactly k/rate seconds, in a .mkv and .webm rounded to a
 * millisecond, and with sound all later by the delay of its encoder (in a .mkv 1024 samples, 64 ms at 16 kHz, in a
 * .webm 6.5 ms), in a .gif, which has at most 100 frames a second, to the nearest 1/100 s. ERN_E_UNSUPPORTED: the file
 * does not hold the codec, or FFmpeg lacks its encoder. Written to a temporary file, which close renames to `path`
 * (base.h, "How files are written"). On success the caller owns *writer, and ends it by close or abandon. One thread at
 * a time uses a writer. */
typedef struct ern_video_writer ern_video_writer;
ERN_API ERN_NODISCARD ern_status ern_video_writer_open(ern_context *context, const char *path,
                                                       const ern_video_options *options, ern_video_writer **writer);
/* rgba: [height][width][4]; alpha is ignored. After a frame has failed, each later frame and close fail in the same
 * way. */
ERN_API ERN_NODISCARD ern_status ern_video_writer_frame(ern_video_writer *writer, const uint8_t *rgba);
/* As ern_video_writer_frame, of a plain frame of a reader whose part (x, y, width, height, even numbers; NULL: none) is
 * replaced by rgba, [height][width][4]. The other pixels are coded as they were decoded. ERN_E_UNSUPPORTED: the frame
 * is not plain, has another size than the video, or the codec is not of yuv420p (ffv1). */
ERN_API ERN_NODISCARD ern_status ern_video_writer_patch(ern_video_writer *writer, const ern_video_frame *frame,
                                                        const int part[4], const uint8_t *rgba);
/* Finishes the file and frees the writer, also on failure, when there is no file. ERN_E_STATE: no frame was written. */
ERN_API ERN_NODISCARD ern_status ern_video_writer_close(ern_video_writer **writer);
/* Frees the writer and removes what it wrote; accepts NULL and a pointer to NULL. */
ERN_API void ern_video_writer_abandon(ern_video_writer **writer);
/* Joins `count` (1 or more) mp4 files of writers with the same size, rate and quality to one mp4: their coded pictures
 * as they are, one after the other, frame k of all shown at exactly k/rate seconds. It has the provenance of the first.
 * `sound` and `sound_start` are as in ern_video_options; the sound of the segments is left out. ERN_E_MISMATCH: one has
 * another size, rate, codec, encoder setting that the codec's header has (of vp9 and av1 not the quality) or model.
 * Atomic. */
ERN_API ERN_NODISCARD ern_status ern_video_join(ern_context *context, const char *path, const char *const *segments,
                                                size_t count, const ern_sound *sound, double sound_start);

/* Plain data, may grow. */
typedef struct ern_video_info {
  int width, height;                    /* pixels, upright */
  int rate_numerator, rate_denominator; /* frames a second as FFmpeg guesses them, rounded to parts of at most 1000000;
                                           ern_video_reader_frame has the times of a variable rate */
  double duration;                      /* of the file, seconds, as its container says; 0: it does not */
  bool has_sound;                       /* a stream of sound is there */
  int sound_rate, sound_channels;       /* samples a second, channels; 0, 0 without sound */
  char video_codec[32], pixel_format[32], sound_codec[32]; /* FFmpeg's names: "h264", "yuv420p", "aac" */
  double pixel_aspect;                                     /* width of a pixel over its height, as it is shown */
  double start; /* time stamp at which the file begins, seconds: second t of ern_sound_read has the time stamp start + t
                   of ern_video_reader_frame */
  char other_streams[256]; /* pictures, sound and subtitles that are not read, as many as have place, by number, kind
                              and FFmpeg's name of the codec: "stream 2 (subtitle, mov_text)"; "": there are none */
} ern_video_info;

/* On success the caller owns *reader. One thread at a time uses a reader. */
typedef struct ern_video_reader ern_video_reader;
ERN_API ERN_NODISCARD ern_status ern_video_reader_open(ern_context *context, const char *path,
                                                       ern_video_reader **reader);
ERN_API void ern_video_reader_info_sized(const ern_video_reader *reader, ern_video_info *info, size_t bytes);
static inline void ern_video_reader_info(const ern_video_reader *reader, ern_video_info *info) {
  ern_video_reader_info_sized(reader, info, sizeof *info);
}
/* The next frame as RGB, turned by quarter turns and mirrored as the file asks for. HDR and wide gamuts are converted
 * to SDR, BT.709, and the log says so (ERN_LOG_INFO). image: {0} before the first call, then the same one, whose buffer
 * is reused where it fits; the caller frees it (ern_image_free). *seconds: the frame's time stamp in the file. *end:
 * true, with the image unchanged, after the last frame; else false. */
ERN_API ERN_NODISCARD ern_status ern_video_reader_frame(ern_video_reader *reader, ern_image *image, double *seconds,
                                                        bool *end);
/* The next frame that is read is the first one whose time stamp is `seconds` or later; after the last frame's there is
 * none. Decodes from the key frame before it on. ERN_E_UNSUPPORTED: the container format cannot seek. */
ERN_API ERN_NODISCARD ern_status ern_video_reader_seek(ern_video_reader *reader, double seconds);
/* As ern_video_reader_frame, but the frame stays in the file's pixel format. *frame: the caller frees it, before or
 * after the reader; NULL after the last frame. ERN_E_SHAPE: it has not the size of ern_video_reader_info. */
ERN_API ERN_NODISCARD ern_status ern_video_reader_decode(ern_video_reader *reader, ern_video_frame **frame,
                                                         double *seconds);
/* The part (x, y, width, height) of one of the reader's frames as the RGB of ern_video_reader_frame; NULL: all of it. A
 * part is of a plain frame, and of even numbers; in the two pixels at its edge the colour is that of its own pixels
 * alone. */
ERN_API ERN_NODISCARD ern_status ern_video_reader_rgb(ern_video_reader *reader, const ern_video_frame *frame,
                                                      const int part[4], ern_image *image);
ERN_API void ern_video_reader_free(ern_video_reader **reader);
/* Whether the frame's pixels are those that an ern_video_writer codes: upright, yuv420p, BT.709, limited range, even
 * sides. */
ERN_API bool ern_video_frame_is_plain(const ern_video_frame *frame);
/* *clone: the same frame once more, without a copy of its pixels; owned and freed as the frame is. */
ERN_API ERN_NODISCARD ern_status ern_video_frame_clone(ern_context *context, const ern_video_frame *frame,
                                                       ern_video_frame **clone);
ERN_API void ern_video_frame_free(ern_video_frame **frame);

/* ---- a watermark ------------------------------------------------------------------------------------------------- */

/* A pattern that is added to the pixels of a video, and that whoever knows its key can find again (docs/watermark.md):
 * a sum of plane waves with 24 to 64 periods in the length of the shorter side; the key decides their phases. It is the
 * same in each frame, and the same bytes on each machine. ERN_WATERMARK_SIDE: pixels; no frame with a shorter side is
 * marked. ERN_WATERMARK_KEY_BYTES: of a key, with the 0 that ends it. */
enum { ERN_WATERMARK_SIDE = 128, ERN_WATERMARK_KEY_BYTES = 256 };
/* Up to this bound on the probability of a false positive `ernerf detect` takes a watermark as found. */
#define ERN_WATERMARK_FALSE_POSITIVE 1e-6

/* The pattern of a key for frames of one size. Any number of threads may use one at the same time. */
typedef struct ern_watermark ern_watermark;

/* key: 1 to ERN_WATERMARK_KEY_BYTES - 1 bytes, else ERN_E_ARGUMENT. width, height: of the frames, pixels, at least
 * ERN_WATERMARK_SIDE, at most ERN_IMAGE_MAX_SIDE, else ERN_E_SHAPE. On success the caller owns *watermark. */
ERN_API ERN_NODISCARD ern_status ern_watermark_open(ern_context *context, const char *key, int width, int height,
                                                    ern_watermark **watermark);
/* Adds the pattern (RMS 1.2 of 255) to red, green and blue of rgba: [height][width][4]; alpha stays. */
ERN_API ERN_NODISCARD ern_status ern_watermark_put(const ern_watermark *watermark, uint8_t *rgba);
ERN_API void ern_watermark_free(ern_watermark **watermark);

/* Searches frames of a video for the watermark of a key. One thread at a time uses a detector. */
typedef struct ern_watermark_detector ern_watermark_detector;
ERN_API ERN_NODISCARD ern_status ern_watermark_detector_open(ern_context *context, const char *key,
                                                             ern_watermark_detector **detector);
/* The next frame: RGB, all of one size, at least 64 pixels a side, else ERN_E_SHAPE; at most 2^24 frames, else
 * ERN_E_STATE. */
ERN_API ERN_NODISCARD ern_status ern_watermark_detector_frame(ern_watermark_detector *detector, const ern_image *frame);
/* Searches the mean of the frames since the detector was opened, or since the last search, at all offsets and at scales
 * from 0.80 to 1.25. *score: the greatest correlation, in standard deviations of that of a wrong key at one offset and
 * scale; 0 where the frames are blank. *false_positive: a bound, 0 to 1, on the probability that a wrong key scores as
 * much, whatever the frames show; the watermark is taken as found up to ERN_WATERMARK_FALSE_POSITIVE. *scale: the
 * shorter side of the frames that were marked, over that of these frames (above 1: they are cropped). ERN_E_STATE:
 * there were no frames. */
ERN_API ERN_NODISCARD ern_status ern_watermark_detector_search(ern_watermark_detector *detector, double *score,
                                                               double *false_positive, double *scale);
ERN_API void ern_watermark_detector_free(ern_watermark_detector **detector);

/* ---- dubbing ----------------------------------------------------------------------------------------------------- */

/* A recorded frame or a part of it that has all of the box, what is known of the head in it, and a rendered head.
 * Positions are from the corner of what is handed over. Plain data, may grow. */
typedef struct ern_dub_input {
  const uint8_t *recorded; /* [height][width][3] RGB */
  int width, height;       /* pixels, 1..ERN_IMAGE_MAX_SIDE */
  int square[4];           /* x, y, width, height: where the clip's square is, pixels; may reach beyond the frame */
  float landmarks[68][2];  /* of the recorded face, x right, y down, in shares of the square (0..1; beyond it -8..8);
                              order of 300-W */
  const ern_image *recorded_head; /* one channel, of the square: 255 where the recorded head is (ern_clip_head); NULL:
                                     not known, all of the square may be drawn on */
  int box[4]; /* x, y, width, height: the part of the frame that the head is rendered for (ern_dub_box), pixels */
  const uint8_t *head; /* [head_height][head_width][4] RGBA, alpha not premultiplied: the rendered head from the corner
                          of `box` on. The alpha is the head's alone (ern_frame_output.opacity) */
  int head_width, head_height; /* pixels, those of the box times head_scale or more, 1..ERN_IMAGE_MAX_SIDE */
  float head_scale[2];         /* pixels of `head` a pixel of the frame, across and down; above 0 */
} ern_dub_input;

/* box: x, y, width, height of the part of the frame that a dubbed frame can differ in, pixels; width and height are 0
 * where there is none: the lower face is not within square and frame, or the face has less than 16 pixels. Reads width,
 * height, square and landmarks. Any number of threads. ERN_E_NONFINITE: a landmark is not finite. ERN_E_ARGUMENT: one
 * is beyond -8..8, as in pixels. */
ERN_API ERN_NODISCARD ern_status ern_dub_box_sized(ern_context *context, const ern_dub_input *input, size_t bytes,
                                                   int box[4]);
static inline ERN_NODISCARD ern_status ern_dub_box(ern_context *context, const ern_dub_input *input, int box[4]) {
  return ern_dub_box_sized(context, input, sizeof *input, box);
}

/* wanted: [head_height][head_width], the caller's: 0 for each pixel of `head` that a dubbed frame neither shows nor
 * takes colours from, so that it need not be rendered (ern_frame_input.wanted), else 255. Reads all but `recorded` and
 * `head`; the box is not empty. Any number of threads. ERN_E_NONFINITE: as above. */
ERN_API ERN_NODISCARD ern_status ern_dub_wanted_sized(ern_context *context, const ern_dub_input *input, size_t bytes,
                                                      uint8_t *wanted);
static inline ERN_NODISCARD ern_status ern_dub_wanted(ern_context *context, const ern_dub_input *input,
                                                      uint8_t *wanted) {
  return ern_dub_wanted_sized(context, input, sizeof *input, wanted);
}

/* The recorded frame with the rendered lower face in it: the mouth, and the skin from the nose to inside the jaw
 * (docs/dub.md). Skin colours come from well inside the rendered head and are continued to the edge of the mask; their
 * low frequencies are matched to the recorded skin around the mask. rgba: [height][width][4], the caller's, alpha 255.
 * *drawn: false where rgba is the recorded frame: `box` is empty (`head` may then be NULL), or the rendered head covers
 * less than half of the mask, or is nowhere in it opaque enough for colours. Any number of threads. ERN_E_NONFINITE: as
 * above. */
ERN_API ERN_NODISCARD ern_status ern_dub_frame_sized(ern_context *context, const ern_dub_input *input, size_t bytes,
                                                     uint8_t *rgba, bool *drawn);
static inline ERN_NODISCARD ern_status ern_dub_frame(ern_context *context, const ern_dub_input *input, uint8_t *rgba,
                                                     bool *drawn) {
  return ern_dub_frame_sized(context, input, sizeof *input, rgba, drawn);
}

/* ---- a preprocessed clip ----------------------------------------------------------------------------------------- */

/* A part of a clip. */
typedef enum ern_split { ERN_SPLIT_TRAIN = 0, ERN_SPLIT_VAL = 1 } ern_split;

/* Plain data, may grow. */
typedef struct ern_clip_options {
  uint32_t cookie, size; /* set by ern_clip_options_default() */
  uint64_t memory_bytes; /* most that kept frames may take; 0: half of the memory that this
                            process may take (ern_device_info of the CPU) */
  const char *features;  /* a file of features, or a sound to compute them of (ern_speech_open), instead of the clip's
                            own; NULL (default): the clip's. Must outlive the open call */
  const char *asr_model; /* "deepspeech" (aud_ds.npy), "esperanto" (aud_eo.npy), "hubert" (aud_hu.npy), "cepstra"
                            (aud_cep.npy, else computed from aud.wav), "articulatory" (aud_art.npy, else computed from
                            aud.wav); NULL (default): the first that is there of aud_ds, aud_eo, aud_hu, aud, aud_cep,
                            aud_art, aud.wav, of which articulatory features are computed. Where `features` is a sound,
                            the built-in kind that is computed from it */
  struct ern_speech_network *network; /* computes the features (speech.h) of the sound `features`, or of aud.wav where
                                         that is NULL; asr_model is then ignored. NULL (default): no network. Must
                                         outlive the open call */
} ern_clip_options;

/* The defaults. */
ERN_API void ern_clip_options_fill(ern_clip_options *options, size_t bytes);
static inline ern_clip_options ern_clip_options_default(void) {
  ern_clip_options options;
  ern_clip_options_fill(&options, sizeof options);
  return options;
}

/* Plain data, may grow. */
typedef struct ern_clip_info {
  int width, height;          /* pixels */
  double focal, cx, cy;       /* pixels */
  size_t frames[2];           /* by ern_split */
  const char *features_file;  /* name of the file that was read */
  bool has_blink;             /* au.csv with AU45_r is there */
  bool has_torso;             /* torso_imgs is there */
  bool has_sound;             /* aud.wav is there */
  bool has_landmarks;         /* ori_imgs is there, which must then have ID.lms of each frame */
  char identity[65];          /* SHA-256 (hex) of transforms_train.json followed by bc.jpg */
  const char *speech;         /* kind of the features (speech.h); "": not known */
  bool hears_sound;           /* the features were made of a sound */
  const char *speech_network; /* ern_speech_network_description() of what made them; "": no network did */
  bool has_parsing;           /* parsing is there, which must then have ID.png of each frame */
  bool has_torso_motion;      /* torso.npy is there */
} ern_clip_info;

/* The library allocates it, and a program reads it by the pointer of ern_clip_frame_at. Plain data, may grow. */
typedef struct ern_clip_frame {
  ern_pose pose;                         /* its row of the transforms file */
  float eye;                             /* clamp(AU45_r, 0, 2)/2; 0 without au.csv */
  bool has_landmarks;                    /* false: there are none */
  float landmarks[68][2];                /* x right, y down from the top left corner, pixels; order of 300-W */
  float torso_motion[ERN_MOTION_VALUES]; /* of the body, from torso.npy, as of ern_frame_input; zeros without it */
} ern_clip_frame;

/* One thread at a time reads pictures of a clip: ern_clip_pixels, ern_clip_head, ern_clip_measure, and a trainer on its
 * dataset. Any number of threads may read the rest. ern_clip_vary_speech writes: no other thread may use the clip
 * meanwhile, and the copies of a dataset that was made before it are freed. */
typedef struct ern_clip ern_clip;

/* The name of file or folder number `index`, from 0, of those that make a clip: nothing else of a clip's folder is
 * opened, and not every clip has all of them. NULL after the last one. Any thread. */
ERN_API const char *ern_clip_content(size_t index);

/* Opens a folder and reads all but the frames' pixels. The first thing that is wrong is the error;
 * ERN_E_STATE where the clip is of ern_prepare() and a step is not done or was refused.
 * On success the caller owns *clip. */
ERN_API ERN_NODISCARD ern_status ern_clip_open(ern_context *context, const char *folder,
                                               const ern_clip_options *options, ern_clip **clip);
ERN_API void ern_clip_free(ern_clip **clip);
ERN_API void ern_clip_describe_sized(const ern_clip *clip, ern_clip_info *info, size_t bytes);
static inline void ern_clip_describe(const ern_clip *clip, ern_clip_info *info) { /* strings live as long as the clip */
  ern_clip_describe_sized(clip, info, sizeof *info);
}
ERN_API const char *ern_clip_identity(const ern_clip *clip); /* 64 hex digits, see ern_clip_info */
ERN_API const ern_features *ern_clip_features(const ern_clip *clip);
/* Makes copies of the clip's features with the centre frequencies of the mel filters multiplied by warps[count]
 * (0.5..2), as of speakers with other vocal tracts, to augment a training; ern_clip_dataset hands them on. Copies of an
 * earlier call are freed; count 0 frees them alone. ERN_E_STATE where the clip's features come from a file of features,
 * or from a network. */
ERN_API ERN_NODISCARD ern_status ern_clip_vary_speech(ern_clip *clip, const float *warps, size_t count);
/* Those copies; *count of them. They live until the next ern_clip_vary_speech, or as long as the clip. */
ERN_API const ern_features *ern_clip_speech_copies(const ern_clip *clip, size_t *count);
ERN_API const ern_image *ern_clip_background(
    const ern_clip *clip); /* RGB, of the clip's size (INTER_AREA where it was not) */
/* Valid as long as the clip; NULL where index is not below ern_clip_info.frames[split]. */
ERN_API const ern_clip_frame *ern_clip_frame_at(const ern_clip *clip, ern_split split, size_t index);

/* The pixels of a frame: `truth`, the recorded picture, RGB (gt_imgs), and `torso` RGBA (torso_imgs; data NULL where
 * the clip has none). Either may be NULL. The images belong to the clip and are valid until the next ern_clip_pixels or
 * ern_clip_measure on it, or step of a trainer on its dataset. Pictures stay in memory up to
 * ern_clip_options.memory_bytes; others are read again each time. */
ERN_API ERN_NODISCARD ern_status ern_clip_pixels(ern_clip *clip, ern_split split, size_t index, ern_image *truth,
                                                 ern_image *torso);
/* *torso = the RGBA picture of torso_imgs, which the caller frees by ern_image_free (data NULL where the clip has
 * none). Any number of threads may call this at the same time; none may read the clip's pictures by another function
 * meanwhile. Keeps pictures in memory as ern_clip_pixels does. */
ERN_API ERN_NODISCARD ern_status ern_clip_torso(ern_clip *clip, ern_split split, size_t index, ern_image *torso);
/* Which pixels of a frame are the head's (blue in parsing). `head` has one channel: 255 the head, 0 none of it, 128
 * not known. A pixel is not known if the square of 2 e + 1 pixels a side around it has pixels of the head and
 * others, e = width/256, rounded, at least 1. In a frame whose parsing has no head no pixel is known. data is NULL if
 * the clip has no parsing. ERN_E_FORMAT: parsing has other colours (docs/prepare.md). The image belongs to the clip,
 * and is valid as long as those of ern_clip_pixels. */
ERN_API ERN_NODISCARD ern_status ern_clip_head(ern_clip *clip, ern_split split, size_t index, ern_image *head);

/* The clip as the trainer takes it, with scale 4, copy_share 0.5 if there are copies, and speech_noise 0; a program may
 * change these. The clip must outlive the dataset. */
ERN_API void ern_clip_dataset_sized(ern_clip *clip, ern_dataset *dataset, size_t bytes);
static inline void ern_clip_dataset(ern_clip *clip, ern_dataset *dataset) {
  ern_clip_dataset_sized(clip, dataset, sizeof *dataset);
}

/* Figures of a clip that decide which effects are modelled (docs/effects.md). Poses and eye values are those of all
 * training frames, features all windows of the file, pictures those of at most 48 training frames, evenly spaced.
 * Plain data, may grow. */
typedef struct ern_clip_measures {
  size_t frames, looked;   /* training frames; those whose pictures were looked at */
  float eye_low, eye_high; /* the third of the least and the third of the largest eye values, 0..1 (of one or two frames
                              the first, of three or four the second): a value of one or two frames is no blink; 0
                              without au.csv */
  double turn;             /* degrees: widest angle between two directions from which the camera sees the head */
  double camera_turn;      /* degrees: widest angle between the first pose's rotation and another's, roll included */
  double camera_shift;   /* largest distance from the first pose's place to another's, over the first one's distance to
                            the head */
  double feature_change; /* RMS deviation of the features from their mean over the windows, over their RMS */
  double loud;           /* share of the 40 ms pieces of aud.wav whose RMS is above -50 dB of full scale; -1 without a
                            sound that can be read */
  double torso_cover;    /* mean share of the picture under the torso layer; 0 without one */
  double torso_move;     /* RMS distance of the torso's centre (weighted by alpha) from its mean place, pixels */
  double torso_against;  /* the same of the torso's centre minus the head's */
  double light;          /* RMS residual of the cheeks' mean colour, 0..255, after a linear fit on the direction of the
                            camera; -1 where no frame has landmarks */
} ern_clip_measures;
/* The least range of eye values that is a blink: a tenth of open to closed, about one pixel of lid at 512 x 512. */
#define ERN_CLIP_BLINK 0.1
/* The least feature_change of speech: below, the features are the same in every window. */
#define ERN_CLIP_SPEECH 1e-3
/* Reads the pictures that it looks at. */
ERN_API ERN_NODISCARD ern_status ern_clip_measure_sized(ern_clip *clip, ern_clip_measures *measures, size_t bytes);
static inline ERN_NODISCARD ern_status ern_clip_measure(ern_clip *clip, ern_clip_measures *measures) {
  return ern_clip_measure_sized(clip, measures, sizeof *measures);
}

/* `ernerf check`: calls `say` once for each sentence: what is there, what is missing, what follows from that, or which
 * step makes what is missing. ok: 1 there, 0 missing but optional, -1 missing or wrong and needed. Reads every frame's
 * header. Returns ERN_OK when a training can start, else the first error. */
ERN_API ERN_NODISCARD ern_status ern_clip_check(ern_context *context, const char *folder,
                                                void (*say)(void *user, int ok, const char *sentence), void *user);

#ifdef __cplusplus
}
#endif
#endif
