/* SPDX-License-Identifier: MIT
 * libernerf-media: speech features from sound. */
#ifndef ERNERF_SPEECH_H
#define ERNERF_SPEECH_H

#include <stdbool.h>

#include "ernerf/base.h"
#include "ernerf/data.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The kind that is built in: 13 mel-frequency cepstral coefficients a row, 50 rows a second, relative to how loud the
 * speech has been so far (docs/speech.md). Values are about -3 to 3. */
#define ERN_SPEECH_CEPSTRA "cepstra-1"
enum { ERN_SPEECH_WIDTH = 13 };

/* Sound as it comes, to rows of features. One thread at a time uses a stream. */
typedef struct ern_speech_stream ern_speech_stream;

/* rate: samples a second, 1000..384000; channels: 1..8, their mean is heard. warp: 0.5..2, 1 for the sound as it is;
 * the centre frequencies of the mel filters are multiplied by it, as for a speaker with a vocal tract of another
 * length. */
ERN_API ERN_NODISCARD ern_status ern_speech_stream_open(ern_context *context, int rate, int channels, float warp,
                                                        ern_speech_stream **stream);
ERN_API void ern_speech_stream_free(ern_speech_stream **stream); /* accepts NULL and a pointer to NULL */

/* samples: [frames][channels], full scale is 1. How the sound is cut into calls does not change a bit of the rows. What
 * is not finite is ERN_E_NONFINITE, beyond 1e6 ERN_E_FORMAT, with its time; the sound before it counts. */
ERN_API ERN_NODISCARD ern_status ern_speech_stream_push(ern_speech_stream *stream, const float *samples, size_t frames);

/* The sound ends: makes the last rows, as if silence followed. Nothing can be pushed any more. Where a push or an end
 * has failed for want of memory rows are missing, and every call that follows is ERN_E_STATE. */
ERN_API ERN_NODISCARD ern_status ern_speech_stream_end(ern_speech_stream *stream);

/* Takes up to `count` rows out, rows[count][ERN_SPEECH_WIDTH]; returns how many. Row r is about the sound from 0.02 r
 * to 0.02 (r + 1) seconds, of which it hears 2.5 ms more on either side: it is there once 33 ms of sound after its
 * beginning, and what the resampler holds (under 20 ms), have been pushed. 0 where a pointer is NULL. */
ERN_API size_t ern_speech_stream_pull(ern_speech_stream *stream, float *rows, size_t count);

/* The features of a sound file, anything that FFmpeg reads, up to 4 hours: a window for each 1/25 s that has begun,
 * [windows][16][13]. Window t holds the rows 2t-8 .. 2t+7; past the ends it holds the nearest row. On success the
 * caller owns *features (ern_features_free). */
ERN_API ERN_NODISCARD ern_status ern_speech_features(ern_context *context, const char *path, float warp,
                                                     ern_features *features);

/* The kind that features of this width are: "deepspeech" (29), "esperanto" (44: wav2vec2 by the
 * public script), "hubert" (1024), or "" for others. A literal. */
ERN_API const char *ern_speech_kind(const ern_features *features);

/* Features out of a .npy file, or out of the sound in any other file; the content decides. kind: what a model asks for
 * (ern_model_info.speech), "" for one that is not known; NULL: any. ERN_E_UNSUPPORTED: a sound, and a kind that is not
 * built in, which needs its network. Whether a file of features fits a model, ern_renderer_accepts tells. On success
 * the caller owns *features (ern_features_free).
 */
ERN_API ERN_NODISCARD ern_status ern_speech_open(ern_context *context, const char *path, const char *kind,
                                                 ern_features *features);

/* Whether the file is to be heard and does not hold features: its name does not end in .npy, nor does its content begin
 * like such a file. */
ERN_API bool ern_speech_is_sound(const char *path);

/* ---- networks ---------------------------------------------------------------------------------------------------- */

/* A network that makes speech features of a wave: an ONNX file, and a description of what it needs (docs/speech.md,
 * "Networks"). OpenCV's DNN module computes it, in a library of its own, libernerf-vision, which is loaded when a
 * network is opened. One thread at a time uses a network; OpenCV's level of logging, which is the process's, is off
 * meanwhile. */
typedef struct ern_speech_network ern_speech_network;

/* path: the ONNX file. description: a JSON object as text (it begins with '{'), such as ern_speech_preset() gives and
 * ern_model_info.speech_network holds, or the name of a file that holds one; NULL: the file of the network's name that
 * ends in .json. ERN_E_FORMAT, ERN_E_SHAPE, ERN_E_MISSING: file or description is not what it should be, or they do not
 * belong together; ERN_E_MISMATCH: the description has the SHA-256 of another file; ERN_E_UNSUPPORTED: OpenCV does not
 * take the network, or libernerf-vision cannot be loaded. On success the caller owns *network. */
ERN_API ERN_NODISCARD ern_status ern_speech_network_open(ern_context *context, const char *path,
                                                         const char *description, ern_speech_network **network);
ERN_API void ern_speech_network_free(ern_speech_network **network); /* accepts NULL and a pointer to NULL */

/* The kind of its features, such as "esperanto"; and its description with the SHA-256 of its file: JSON in a line of at
 * most 511 bytes, with which the same features can be made again. They live as long as the network; "" without one. */
ERN_API const char *ern_speech_network_kind(const ern_speech_network *network);
ERN_API const char *ern_speech_network_description(const ern_speech_network *network);

/* The description "esperanto" (wav2vec2, 44 wide) or "hubert" (1024 wide), by the public scripts; NULL: there is none
 * of that name. A literal. */
ERN_API const char *ern_speech_preset(const char *name);

/* From now on `watch` (NULL: nothing) is called before each piece of a sound with the number of pieces done, and of
 * all, and at the end; anything but 0 before a piece ends the work with ERN_E_CANCELLED. */
ERN_API void ern_speech_network_watch(ern_speech_network *network, int (*watch)(void *user, size_t done, size_t pieces),
                                      void *user);

/* The features of a sound file, anything that FFmpeg reads, up to 4 hours: [windows][16 or 2][width]. The memory is
 * that of the wave, the rows and the windows. ERN_E_SHAPE: the sound is too short for a window, or the network's output
 * is not as described; ERN_E_NONFINITE: it has a NaN. On success the caller owns *features (ern_features_free). */
ERN_API ERN_NODISCARD ern_status ern_speech_network_features(ern_speech_network *network, const char *path,
                                                             ern_features *features);

#ifdef __cplusplus
}
#endif
#endif
