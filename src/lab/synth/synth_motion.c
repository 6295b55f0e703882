/* SPDX-License-Identifier: MIT
 * Motion of the synthetic head: blinks, slow rotations and shifts, and the mouth of the speech. */
#include "lab/synth/synth_parts.h"

enum { STREAM_HEAD = 31, STREAM_BLINK = 32 };

/* A sum of slow sines of given amplitudes, with seeded periods (about 6.5, 3.4 and 1.7 s) and phases. */
static float sway(uint64_t seed, uint64_t which, double t, double slow, double middle, double quick) {
  static const double periods[3] = {6.5, 3.4, 1.7};
  const double amplitudes[3] = {slow, middle, quick};
  double sum = 0.0;
  for (uint64_t k = 0; k < 3; ++k) {
    const double period = periods[k] * synth_uniform(seed, STREAM_HEAD, 10 * which + 2 * k, 0.85, 1.2);
    const double phase = synth_uniform(seed, STREAM_HEAD, 10 * which + 2 * k + 1, 0.0, 1.0);
    sum += amplitudes[k] * sin(2.0 * 3.14159265358979323846 * (t / period + phase));
  }
  return (float)sum;
}

static void move_head(uint64_t seed, double t, struct ern_synth_curve *curve) {
  curve->yaw = sway(seed, 0, t, 6.0, 4.0, 2.0);
  curve->pitch = sway(seed, 1, t, 2.8, 2.0, 1.2);
  curve->roll = sway(seed, 2, t, 2.0, 1.3, 0.7);
  curve->shift[0] = sway(seed, 3, t, 0.022, 0.012, 0.004);
  curve->shift[1] = sway(seed, 4, t, 0.010, 0.006, 0.003);
  curve->shift[2] = sway(seed, 5, t, 0.030, 0.015, 0.005);
}

/* Shutting takes 80 ms, shut lasts 40 to 70 ms, opening 120 ms. */
static float lids_at(double since, double shut, double strength) {
  const double closing = 0.080, opening = 0.120;
  if (since < 0.0 || since > closing + shut + opening) return 0.0f;
  const double a = since < closing          ? since / closing
                   : since < closing + shut ? 1.0
                                            : (closing + shut + opening - since) / opening;
  return (float)(strength * a * a * (3.0 - 2.0 * a));
}

/* The first two blinks come early, so that short clips have them; then one every 2 to 4 s. */
static void move_lids(uint64_t seed, struct ern_synth_curve *curves, size_t frames) {
  const double seconds = (double)frames / ERN_SYNTH_FPS;
  double start = fmin(synth_uniform(seed, STREAM_BLINK, 0, 0.35, 0.60), 0.35 * seconds);
  for (uint64_t k = 0; start < seconds; ++k) {
    const double shut = synth_uniform(seed, STREAM_BLINK, 3 * k + 1, 0.04, 0.07);
    const double strength = synth_uniform(seed, STREAM_BLINK, 3 * k + 2, 1.05, 1.35);
    const size_t first = (size_t)(start * ERN_SYNTH_FPS);
    for (size_t t = first; t < frames && t < first + 10; ++t)
      curves[t].blink = maxf(curves[t].blink, lids_at((double)t / ERN_SYNTH_FPS - start, shut, strength));
    start += synth_uniform(seed, STREAM_BLINK, 3 * k + 3, k == 0 ? 1.1 : 2.0, k == 0 ? 1.4 : 4.0);
  }
}

/* Scales the yaw so that its largest value is `turn`. Pitch and roll, whose amplitudes are 6 and 4 degrees for a yaw of
 * 12, are scaled by turn / 12. */
static void turn_by(double turn, struct ern_synth_curve *curves, size_t frames) {
  const float grow = (float)turn / 12.0f;
  float most = 0.0f;
  for (size_t t = 0; t < frames; ++t) most = maxf(most, fabsf(curves[t].yaw));
  for (size_t t = 0; t < frames; ++t) {
    curves[t].yaw *= (float)turn / maxf(most, 1e-3f);
    curves[t].pitch *= grow;
    curves[t].roll *= grow;
  }
}

void ern_synth_motion_make(uint64_t seed, const struct ern_synth_speech *speech, bool blink, bool moving, double turn,
                           struct ern_synth_curve *curves, size_t frames) {
  for (size_t t = 0; t < frames; ++t) {
    curves[t] = (struct ern_synth_curve){0};
    curves[t].jaw = speech->jaw[2 * t + ERN_SYNTH_BEFORE];
    curves[t].width = speech->width[2 * t + ERN_SYNTH_BEFORE];
    move_head(seed, moving ? (double)t / ERN_SYNTH_FPS : 0.0, &curves[t]);
  }
  if (turn > 0.0) turn_by(turn, curves, frames);
  if (blink) move_lids(seed, curves, frames);
}
