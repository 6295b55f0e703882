/* SPDX-License-Identifier: MIT
 * The audio code of a frame: windows shared with the frame before are not encoded again. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "render/frame_input.h"
#include "render/renderer_state.h"

/* The last frame's window that equals window t of this one; ERN_AUDIO_WINDOWS: none. */
static size_t window_before(const ern_renderer *r, const ern_frame_input *input, size_t t) {
  const struct audio_code_cache *cache = &r->audio_code;
  const size_t values = (size_t)input->window_length * (size_t)r->field.config.feature_width;
  for (size_t k = 1; k <= ERN_AUDIO_WINDOWS && cache->length == input->window_length; k++) {
    const size_t was = (t + k) % ERN_AUDIO_WINDOWS;
    if (memcmp(input->windows + t * values, cache->windows + was * values, values * sizeof(float)) == 0) return was;
  }
  return ERN_AUDIO_WINDOWS;
}

/* Moves the codes of windows shared with the last frame to their new places and sets bit t of *known for window t.
 * Consecutive frames share seven of eight windows, each one place earlier: one copy moves all seven. */
static ern_status remember(ern_renderer *r, const ern_frame_input *input, unsigned *known) {
  struct audio_code_cache *cache = &r->audio_code;
  ern_status status = ERN_OK;
  size_t was[ERN_AUDIO_WINDOWS];
  *known = 0;
  for (size_t t = 0; t < ERN_AUDIO_WINDOWS; t++) was[t] = window_before(r, input, t);
  for (size_t t = 0, count = 1; t < ERN_AUDIO_WINDOWS; t += count, count = 1) {
    if (was[t] == ERN_AUDIO_WINDOWS) continue;
    while (t + count < ERN_AUDIO_WINDOWS && was[t + count] < ERN_AUDIO_WINDOWS && was[t + count] == was[t] + count)
      count++;
    const ern_span to = {cache->codes[1], t * ERN_AUDIO_CODE, count * ERN_AUDIO_CODE};
    const ern_span from = {cache->codes[0], was[t] * ERN_AUDIO_CODE, count * ERN_AUDIO_CODE};
    ERN_TRY(r->backend->copy(r->stream, to, from, count * ERN_AUDIO_CODE));
    *known |= ((1u << count) - 1) << t;
  }
  struct ern_buffer *moved = cache->codes[1];
  cache->codes[1] = cache->codes[0];
  cache->codes[0] = moved;
fail:
  cache->length = 0; /* until the frame's own windows are stored */
  return status;
}

static ern_status keep_windows(ern_renderer *r, const ern_frame_input *input) {
  const size_t most = (size_t)ERN_AUDIO_WINDOWS * MAX_WINDOW_LENGTH * (size_t)r->field.config.feature_width;
  const size_t values =
      (size_t)ERN_AUDIO_WINDOWS * (size_t)input->window_length * (size_t)r->field.config.feature_width;
  if (r->audio_code.windows == NULL) {
    const ern_status status = ERN_NEW(r->context, most, &r->audio_code.windows);
    if (status != ERN_OK) return status;
  }
  memcpy(r->audio_code.windows, input->windows, values * sizeof(float));
  r->audio_code.length = input->window_length;
  return ERN_OK;
}

ern_status ern_renderer_encode_windows(ern_renderer *r, const ern_frame_input *input) {
  const size_t values =
      (size_t)ERN_AUDIO_WINDOWS * (size_t)input->window_length * (size_t)r->field.config.feature_width;
  const ern_span code = ern_whole(r->code, ERN_AUDIO_CODE);
  struct ern_audio_frame_args args = {
      .audio = {.code = code, .parameters = ern_whole(r->parameters, r->field.parameters), .net = r->field.audio}};
  ern_status status = ERN_OK;
  args.audio.net.window_length = input->window_length;
  ERN_TRY(ern_scratch_take(r->stream, ERN_ELEMENT_REAL, values, &args.audio.windows));
  ERN_TRY(r->backend->upload_reals(r->stream, args.audio.windows, input->windows, values));
  ERN_TRY(remember(r, input, &args.known));
  args.codes = ern_whole(r->audio_code.codes[0], AUDIO_CODE_VALUES);
  ERN_TRY(r->backend->audio_frame(r->stream, &args));
  ERN_TRY(keep_windows(r, input));
fail:
  return status;
}

ern_status ern_renderer_encode_audio(ern_renderer *r, const ern_frame_input *input) {
  const ern_span code = ern_whole(r->code, ERN_AUDIO_CODE);
  float now[ERN_AUDIO_CODE];
  ern_status status = ERN_OK;
  ERN_TRY(ern_renderer_encode_windows(r, input));
  if (!r->options.smooth_lips && !(input->silence_weight > 0)) return ERN_OK;
  ERN_TRY(r->backend->download_reals(r->stream, now, code, ERN_AUDIO_CODE));
  for (int c = 0; c < ERN_AUDIO_CODE; c++) /* before later frames use it */
    if (!isfinite(now[c]))
      ERN_TRY(ern_fail(r->context, ERN_E_NONFINITE,
                       "render: the audio code is not finite: the speech is too loud for the model"));
  if (r->options.smooth_lips) {
    const bool usual = r->options.frame_rate == 25;
    const float last = usual ? 0.35f : powf(0.35f, 25 / r->options.frame_rate), own = usual ? 0.65f : 1 - last;
    for (int c = 0; c < ERN_AUDIO_CODE && r->has_last_code; c++) now[c] = last * r->last_code[c] + own * now[c];
    memcpy(r->last_code, now, sizeof now);
    r->has_last_code = true;
  }
  for (int c = 0; c < ERN_AUDIO_CODE && input->silence_weight > 0; c++)
    now[c] = (1 - input->silence_weight) * now[c] + input->silence_weight * input->silence_code[c];
  ERN_TRY(r->backend->upload_reals(r->stream, code, now, ERN_AUDIO_CODE));
fail:
  return status;
}

ern_status ern_renderer_speech_frames(ern_renderer *r, const float *windows, int window_length, const float *eyes,
                                      size_t count, struct ern_speech_frame **frames) {
  ern_context *context = r->context;
  struct ern_speech_frame *made = NULL;
  ern_status status = ERN_OK;
  *frames = NULL;
  if (count > 0) status = ern_window_length_check(context, &r->field, "render", window_length);
  if (status != ERN_OK) return status;
  const size_t values = (size_t)ERN_AUDIO_WINDOWS * (size_t)window_length * (size_t)r->field.config.feature_width;
  ERN_TRY(ERN_NEW(context, count, &made));
  for (size_t k = 0; k < count; k++) {
    made[k] = (struct ern_speech_frame){windows + k * values, window_length, eyes[k]};
    if (!(eyes[k] >= 0 && eyes[k] <= 1))
      ERN_TRY(ern_fail(context, ERN_E_ARGUMENT, "render: frame %zu of the speech: eye is %g, expected 0 to 1", k,
                       (double)eyes[k]));
    for (size_t i = 0; i < values; i++) {
      char where[64];
      if (ern_feature_fits(made[k].windows[i])) continue;
      snprintf(where, sizeof where, "render: frame %zu of the speech", k);
      ERN_TRY(ern_feature_refuse(context, where, i, made[k].windows[i]));
    }
  }
  *frames = made;
  return ERN_OK;
fail:
  ern_release(context, made);
  return status;
}
