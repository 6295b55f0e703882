/* SPDX-License-Identifier: MIT
 * Speech features by a network: it cuts a sound into pieces of fixed length, joins their rows, and makes windows of the
 * rows. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "io/feature_range.h"
#include "media/speech_network.h"

enum { ROWS_A_SECOND = 50, WINDOW = 16, BEFORE = 8 };

/* How a sound is cut into pieces. Row r begins at sample r hop. The network gives R rows for a piece, of which the
 * first `left` are context; `keep` rows of a piece are used, of the last piece all that remain. The last piece begins
 * earlier, so that it ends with the sound: zeros after the sound would change the rows before them. */
struct plan {
  size_t hop, piece, left, all, keep; /* samples; samples; rows: of context, of a piece (R), of a piece that is kept */
  size_t samples, rows;               /* of the sound */
};

static struct plan plan_of(const struct ern_speech_description *d, size_t samples) {
  struct plan p = {.hop = (size_t)(d->rate / ROWS_A_SECOND), .piece = (size_t)d->piece_samples, .samples = samples};
  const size_t row = (size_t)d->row_samples, context = (size_t)d->context_samples;
  p.left = context / p.hop;
  p.all = (p.piece - row) / p.hop + 1;
  p.keep = (p.piece - 2 * context) / p.hop;
  if (p.keep > p.all - p.left) p.keep = p.all - p.left;
  p.rows = samples < row ? 0 : (samples - row) / p.hop + 1;
  return p;
}

/* Whether the sound ends within the piece of row `done`. As in the public wav2vec.py, a partial hop counts as a whole
 * one. */
static bool is_last(const struct plan *p, size_t done) {
  const size_t begun = (p->samples + p->hop - 1) / p->hop * p->hop; /* samples */
  return begun + p->left * p->hop < done * p->hop + p->piece;
}

/* Rows that are used of the piece of row `done`. */
static size_t rows_given(const struct plan *p, size_t done) {
  const size_t given = is_last(p, done) ? p->all - p->left : p->keep, missing = p->rows - done;
  return given < missing ? given : missing;
}

/* Rows by which the last piece begins earlier. */
static size_t rows_back(const struct plan *p, size_t done) {
  if (!is_last(p, done)) return 0;
  const size_t back = (done * p->hop + p->piece - p->left * p->hop - p->samples) / p->hop;
  return back < done ? back : done;
}

static size_t count_pieces(const struct plan *p) {
  size_t pieces = 0;
  for (size_t done = 0; done < p->rows; done += rows_given(p, done)) pieces++;
  return pieces;
}

/* (x - mean)/sqrt(variance + 1e-7) */
static void normalise(float *x, size_t count) {
  double sum = 0, squares = 0;
  for (size_t i = 0; i < count; i++) sum += (double)x[i];
  const double mean = count > 0 ? sum / (double)count : 0;
  for (size_t i = 0; i < count; i++) squares += ((double)x[i] - mean) * ((double)x[i] - mean);
  const double scale = count > 0 ? 1 / sqrt(squares / (double)count + 1e-7) : 0;
  for (size_t i = 0; i < count; i++) x[i] = (float)(((double)x[i] - mean) * scale);
}

/* The samples of a piece: zeros before the sound, which count in the normalisation's mean, and after it, which do not.
 */
static void cut_piece(const struct plan *p, const float *wave, size_t done, bool normal, float *piece) {
  const size_t first = (done - rows_back(p, done)) * p->hop,
               context = p->left * p->hop, /* sample i is that of first - context + i */
      zeros = first < context ? context - first : 0, from = first + zeros - context,
               there = p->samples - from < p->piece - zeros ? p->samples - from : p->piece - zeros;
  memset(piece, 0, p->piece * sizeof *piece);
  memcpy(piece + zeros, wave + from, there * sizeof *piece);
  if (normal) normalise(piece, zeros + there);
}

/* [...1...][R][width] */
static ern_status check_output(const ern_speech_network *n, const struct plan *p, const struct ern_vision_array *out) {
  const int width = n->description.width;
  bool fits = out->dims >= 2 && out->shape[out->dims - 1] == width && (size_t)out->shape[out->dims - 2] == p->all;
  char shape[160] = "";
  for (int d = 0; d < out->dims; d++) {
    const size_t used = strlen(shape);
    snprintf(shape + used, sizeof shape - used, "%s%d", d > 0 ? ", " : "", out->shape[d]);
    fits &= d >= out->dims - 2 || out->shape[d] == 1;
  }
  if (fits) return ERN_OK;
  return ern_fail(n->context, ERN_E_SHAPE,
                  "%s: its output \"%s\" is [%s], expected [1, %zu, %d]: rows of %d samples (row_samples) in a piece "
                  "of %zu, and %d numbers a row (width)",
                  n->path, n->output, shape, p->all, width, n->description.row_samples, p->piece, width);
}

static ern_status check_rows(const ern_speech_network *n, const float *row, size_t first, size_t rows) {
  const size_t width = (size_t)n->description.width;
  for (size_t i = 0; i < rows * width; i++) {
    if (ern_feature_fits(row[i])) continue;
    return ern_fail(n->context, isfinite(row[i]) ? ERN_E_FORMAT : ERN_E_NONFINITE,
                    "%s: its output \"%s\" at %.2f s is %g in place %zu, expected a finite number, -1e30 to 1e30",
                    n->path, n->output, (double)(first + i / width) / ROWS_A_SECOND, (double)row[i], i % width);
  }
  return ERN_OK;
}

static ern_status run_piece(ern_speech_network *n, const struct plan *p, const float *piece, size_t done, float *rows) {
  struct ern_vision_array in = {.data = piece, .dims = n->dims}, out = {0};
  const size_t width = (size_t)n->description.width, given = rows_given(p, done), skip = p->left + rows_back(p, done);
  char words[ERN_VISION_WORDS] = "";
  ern_status status = ERN_OK;
  memcpy(in.shape, n->shape, sizeof in.shape);
  status = n->vision->run(n->network, &in, n->output, &out, words);
  if (status != ERN_OK)
    return ern_fail(n->context, status,
                    "%s: OpenCV %s cannot compute its output \"%s\": %s; docs/speech.md says how to export it", n->path,
                    n->vision->opencv, n->output, words);
  ERN_TRY(check_output(n, p, &out));
  memcpy(rows + done * width, out.data + skip * width, given * width * sizeof *rows);
  ERN_TRY(check_rows(n, rows + done * width, done, given));
fail:
  return status;
}

static ern_status run_pieces(ern_speech_network *n, const struct plan *p, const float *wave, float *rows) {
  const size_t pieces = count_pieces(p);
  const bool normal = n->description.normalisation == ERN_SPEECH_PIECE;
  float *piece = NULL;
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(n->context, p->piece, &piece));
  for (size_t done = 0, k = 0; done < p->rows; done += rows_given(p, done), k++) {
    if (n->watch != NULL && n->watch(n->user, k, pieces) != 0)
      ERN_TRY(ern_fail(n->context, ERN_E_CANCELLED, "%s: stopped after %zu of %zu pieces of the sound", n->path, k,
                       pieces));
    cut_piece(p, wave, done, normal, piece);
    ERN_TRY(run_piece(n, p, piece, done, rows));
  }
  if (n->watch != NULL) (void)n->watch(n->user, pieces, pieces);
fail:
  ern_release(n->context, piece);
  return status;
}

/* Window t is rows 2t-8 .. 2t+7, zeros past the ends; the number of windows is that of wav2vec.py. */
static ern_status make_windows(ern_speech_network *n, const float *row, size_t rows, ern_features *features) {
  const size_t width = (size_t)n->description.width;
  features->windows = rows / 2 + 1;
  const ern_status status = ERN_NEW(n->context, features->windows * WINDOW * width, &features->data);
  if (status != ERN_OK) return status;
  for (size_t t = 0; t < features->windows; t++)
    for (size_t k = 0; k < WINDOW; k++) {
      const size_t at = 2 * t + k;
      if (at < BEFORE || at - BEFORE >= rows) continue;
      memcpy(features->data + (t * WINDOW + k) * width, row + (at - BEFORE) * width, width * sizeof *row);
    }
  return ERN_OK;
}

ern_status ern_speech_network_features(ern_speech_network *network, const char *path, ern_features *features) {
  ERN_PLAIN_FLOATS;
  if (features != NULL) *features = (ern_features){0};
  ERN_NEED(NULL, network);
  ern_context *context = network->context;
  ERN_NEED(context, path);
  ERN_NEED(context, features);
  const struct ern_speech_description *d = &network->description;
  float *wave = NULL, *row = NULL;
  size_t samples = 0;
  ern_status status = ERN_OK;
  if (!ern_speech_is_sound(path))
    return ern_fail(context, ERN_E_ARGUMENT, "%s: holds features, expected a sound for the network %s", path,
                    network->path);
  ERN_TRY(ern_speech_wave(context, path, d->rate, &wave, &samples));
  const struct plan p = plan_of(d, samples);
  if (p.rows < (d->window_rows == WINDOW ? 1 : 2))
    ERN_TRY(ern_fail(context, ERN_E_SHAPE,
                     "%s: has %zu samples at %d Hz, too few for a window of \"%s\" (row_samples %d)", path, samples,
                     d->rate, d->kind, d->row_samples));
  if (d->normalisation == ERN_SPEECH_SOUND) normalise(wave, samples);
  ERN_TRY(ERN_NEW(context, p.rows * (size_t)d->width, &row));
  ERN_TRY(run_pieces(network, &p, wave, row));
  *features = (ern_features){.window_length = d->window_rows, .width = d->width};
  if (d->window_rows == WINDOW) {
    ERN_TRY(make_windows(network, row, p.rows, features));
  } else { /* rows 2t, 2t+1, as of hubert.py */
    features->windows = p.rows / 2;
    features->data = row;
    row = NULL;
  }
fail:
  if (status != ERN_OK) ern_features_free(context, features);
  ern_release(context, wave);
  ern_release(context, row);
  return status;
}
