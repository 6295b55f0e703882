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

/* The built-in kinds of features. The library computes them from a sound, without a network of the user's: 50 rows a
 * second, a row being one vector of features. Models that were trained on a built-in kind have its name in
 * ern_model_info.speech; ern_clip_options.asr_model calls the kinds "articulatory" and "cepstra" (docs/speech.md).
 *
 * ERN_SPEECH_ARTICULATORY: the 13 numbers of ERN_SPEECH_CEPSTRA, then 32 of -1.5 to 1.5, the last layer of a small
 * network that was trained on speech of known phonemes to recognise them and the places of jaw, lips and tongue. They
 * describe the sound 80 ms before the middle of the row's own 20 ms.
 *
 * ERN_SPEECH_CEPSTRA: 13 mel-frequency cepstral coefficients. The power of a row is divided by a level, the largest
 * power of the rows so far; at each row that is within 30 dB of it, the level decays with a time constant of 10 s.
 * Values have no unit and are about -3 to 3. */
#define ERN_SPEECH_ARTICULATORY "articulatory-1"
#define ERN_SPEECH_CEPSTRA "cepstra-1"
enum { ERN_SPEECH_WIDTH = 13, ERN_SPEECH_MOST_WIDTH = 45 }; /* of a row of ERN_SPEECH_CEPSTRA; of the widest kind */

/* Numbers in a row of a built-in kind; 0 for NULL and any other kind. Any thread. */
ERN_API int ern_speech_width(const char *kind);

/* Computes rows of built-in features from sound that comes in piece by piece. One thread at a time uses a stream. */
typedef struct ern_speech_stream ern_speech_stream;

/* rate: samples a second, 1000..384000. channels: 1..8; the features are computed from their mean, and where it loses
 * most of their energy, as with right = -left, from the loudest of them. warp: 0.5..2, 1 for the sound as it is. The
 * centre frequencies of the mel filters are multiplied by warp, which imitates a speaker with a vocal tract of another
 * length. On success the caller owns *stream. */
ERN_API ERN_NODISCARD ern_status ern_speech_stream_open(ern_context *context, int rate, int channels, float warp,
                                                        ern_speech_stream **stream);
/* As ern_speech_stream_open, which is this function for ERN_SPEECH_CEPSTRA, for any built-in kind. ERN_E_ARGUMENT:
 * another kind, or NULL. */
ERN_API ERN_NODISCARD ern_status ern_speech_stream_open_kind(ern_context *context, const char *kind, int rate,
                                                             int channels, float warp, ern_speech_stream **stream);
ERN_API void ern_speech_stream_free(ern_speech_stream **stream); /* accepts NULL and a pointer to NULL */

/* samples: [frames][channels], full scale is 1. The rows are the same, bit for bit, however the sound is divided among
 * calls. A frame here is one sample of each channel. A sample that is not finite is ERN_E_NONFINITE, one beyond 1e6
 * ERN_E_FORMAT; the error text has its time. The frames before its frame have then been taken, it and those after it
 * have not; further sound can be pushed. After ERN_E_NO_MEMORY or ERN_E_MEDIA rows are missing, and every later push or
 * end is ERN_E_STATE. */
ERN_API ERN_NODISCARD ern_status ern_speech_stream_push(ern_speech_stream *stream, const float *samples, size_t frames);

/* Ends the sound: computes the last rows, as if silence followed. Every later push is ERN_E_STATE, and a second end
 * does nothing. After ERN_E_NO_MEMORY or ERN_E_MEDIA rows are missing, and every later push or end is ERN_E_STATE. */
ERN_API ERN_NODISCARD ern_status ern_speech_stream_end(ern_speech_stream *stream);

/* Moves up to `count` rows, the oldest first, into rows[count][width of the kind], and returns their number; 0 where a
 * pointer is NULL. Row r belongs to the sound from 0.02 r to 0.02 (r + 1) seconds. It is computed from that sound and
 * 2.5 ms more at either end. As sound is processed in pieces of 10 ms, it can be pulled when the sound up to
 * 0.02 r + 0.033 seconds has been pushed. The delay of the resampler is added to that: none at 16 kHz, about 2 ms at
 * usual rates, less than 20 ms at 1000 samples a second. */
ERN_API size_t ern_speech_stream_pull(ern_speech_stream *stream, float *rows, size_t count);

/* Computes the built-in features of a sound file: [windows][16][13]. FFmpeg reads the file; the sound has 1000 samples
 * a second at least, is not empty and lasts 4 hours at most, else ERN_E_SHAPE; errors of its samples are those of
 * ern_speech_stream_push. There is one window for each 1/25 s of sound, also for an incomplete last one. Window t holds
 * the rows 2t-8 .. 2t+7; a row before the first or after the last one is replaced by the nearest. warp: as in
 * ern_speech_stream_open. On success the caller owns *features (ern_features_free). */
ERN_API ERN_NODISCARD ern_status ern_speech_features(ern_context *context, const char *path, float warp,
                                                     ern_features *features);

/* As ern_speech_features, which is this function for ERN_SPEECH_CEPSTRA, for any built-in kind: [windows][16][width].
 * ERN_E_ARGUMENT: another kind, or NULL. */
ERN_API ERN_NODISCARD ern_status ern_speech_features_kind(ern_context *context, const char *path, const char *kind,
                                                          float warp, ern_features *features);

/* Guesses the kind of features from their width: 29 "deepspeech", 44 "esperanto" (wav2vec2 for the language Esperanto,
 * which a script of the public program uses), 1024 "hubert". "" for any other width, also for ERN_SPEECH_WIDTH, which
 * features of other programs have too. The result is a string literal. */
ERN_API const char *ern_speech_kind(const ern_features *features);

/* Reads the features in a .npy file, or computes the built-in features of a sound file. ern_speech_is_sound decides
 * which of the two the file is. kind: the kind that the model needs (ern_model_info.speech, which is "" where it is not
 * known); NULL: any, and ERN_SPEECH_CEPSTRA of a sound. A sound is ERN_E_UNSUPPORTED for a kind that is not built in,
 * as it needs its network. Of a .npy file kind is not checked, as the file does not say it. ern_renderer_accepts
 * compares its width and window length with a model's; features of another kind and the same width pass. On success the
 * caller owns *features (ern_features_free). */
ERN_API ERN_NODISCARD ern_status ern_speech_open(ern_context *context, const char *path, const char *kind,
                                                 ern_features *features);

/* Whether a file is taken for sound, not for features. It holds features if its name ends in ".npy" or its content
 * begins as a .npy file does. true also for NULL, and for a file of another name that cannot be read. */
ERN_API bool ern_speech_is_sound(const char *path);

/* ---- networks ---------------------------------------------------------------------------------------------------- */

/* A network that computes speech features from a wave: an ONNX file, and a description of its input and output
 * (docs/speech.md, "Networks"). The library libernerf-vision computes it, with OpenCV's DNN module; it is loaded when a
 * network is opened. One thread at a time uses a network. OpenCV has one log level for the process: a call that opens
 * or computes a network sets it to silent, and restores it at its end. */
typedef struct ern_speech_network ern_speech_network;

/* path: the ONNX file. description: a JSON object as text, which begins with '{', such as ern_speech_preset() returns
 * and ern_model_info.speech_network holds; or the name of a file with such an object; NULL: the file NAME.json beside
 * NAME.onnx. ERN_E_FORMAT, ERN_E_SHAPE, ERN_E_MISSING: the file or the description is missing or wrong, or the network
 * has another input or output than described. ERN_E_MISMATCH: the description has the SHA-256 of another file.
 * ERN_E_UNSUPPORTED: OpenCV does not support the network, or libernerf-vision cannot be loaded. On success the caller
 * owns *network. */
ERN_API ERN_NODISCARD ern_status ern_speech_network_open(ern_context *context, const char *path,
                                                         const char *description, ern_speech_network **network);
ERN_API void ern_speech_network_free(ern_speech_network **network); /* accepts NULL and a pointer to NULL */

/* The kind of its features, such as "esperanto", and its description: one line of JSON, at most 511 bytes. The
 * description has the SHA-256 of the ONNX file, so it identifies the network that made features. Both texts are valid
 * until the network is freed; "" for NULL. */
ERN_API const char *ern_speech_network_kind(const ern_speech_network *network);
ERN_API const char *ern_speech_network_description(const ern_speech_network *network);

/* The description of the network that a script of the public program uses: name "esperanto" (wav2vec2, 44 numbers a
 * row) or "hubert" (1024). NULL for any other name. The result is a string literal. */
ERN_API const char *ern_speech_preset(const char *name);

/* Sets a callback of ern_speech_network_features; NULL: none (default). That function cuts the sound into pieces of the
 * length that the network takes. It calls `watch`, on the calling thread, before each piece, and once after the last,
 * with the number of pieces done and the number of all. If `watch` returns anything but 0 before a piece, the function
 * ends with ERN_E_CANCELLED. user: handed to `watch`. */
ERN_API void ern_speech_network_watch(ern_speech_network *network, int (*watch)(void *user, size_t done, size_t pieces),
                                      void *user);

/* Computes the features of a sound file: [windows][16 or 2][width], with `window_rows` and `width` of the description.
 * Of n rows, windows of 16 rows are floor(n/2) + 1, with zeros before the first row and after the last; windows of 2
 * rows are floor(n/2) (docs/speech.md). FFmpeg reads the file; the sound has 1000 samples a second at least and lasts 4
 * hours at most. The whole wave, its rows and its windows are in memory at the same time. ERN_E_SHAPE: the sound has
 * fewer samples a second, is too long, or too short for one window, or the network's output has another shape than
 * described. ERN_E_NONFINITE, ERN_E_FORMAT: the sound or the output has a NaN, an infinity, or a number beyond 1e6
 * (sound) or 1e30 (output). ERN_E_ARGUMENT: the file holds features. On success the caller owns *features
 * (ern_features_free). */
ERN_API ERN_NODISCARD ern_status ern_speech_network_features(ern_speech_network *network, const char *path,
                                                             ern_features *features);

#ifdef __cplusplus
}
#endif
#endif
