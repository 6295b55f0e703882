/* SPDX-License-Identifier: MIT
 * The synthetic voice: a pulse train and noise through three moving resonances (formant synthesis). */
#include "lab/synth/synth_parts.h"

enum { STREAM_PITCH = 41, STREAM_HISS = 42 };

/* A resonance: y[n] = gain x[n] + 2 r cos(w) y[n-1] - r^2 y[n-2], gain 1 at zero frequency. */
struct resonance {
  double a1, a2, gain, y1, y2;
};

static void resonance_tune(struct resonance *filter, double hertz, double band) {
  const double pi = 3.14159265358979323846;
  const double r = exp(-pi * band / ERN_SYNTH_RATE);
  filter->a1 = 2.0 * r * cos(2.0 * pi * hertz / ERN_SYNTH_RATE);
  filter->a2 = -r * r;
  filter->gain = 1.0 - filter->a1 - filter->a2;
}

static double resonance_run(struct resonance *filter, double x) {
  const double y = filter->gain * x + filter->a1 * filter->y1 + filter->a2 * filter->y2;
  filter->y2 = filter->y1;
  filter->y1 = y;
  return y;
}

/* Glottal flow over a period (phase 0..1): opens slowly, closes fast, stays closed. */
static double glottis(double phase) {
  if (phase < 0.40)
    return 3.0 * (phase / 0.40) * (phase / 0.40) - 2.0 * (phase / 0.40) * (phase / 0.40) * (phase / 0.40);
  if (phase < 0.56) return 1.0 - ((phase - 0.40) / 0.16) * ((phase - 0.40) / 0.16);
  return 0.0;
}

/* Value of a curve of steps at `at` steps, linear between them. */
static double between(const float *curve, size_t stride, size_t steps, double at) {
  const size_t k = (size_t)at < steps - 1 ? (size_t)at : steps - 2;
  const double part = at - (double)k;
  return (1.0 - part) * (double)curve[k * stride] + part * (double)curve[(k + 1) * stride];
}

void ern_synth_sound_make(uint64_t seed, float voice, const struct ern_synth_speech *speech, int16_t *sound,
                          size_t samples) {
  static const double bands[3] = {80.0, 110.0, 160.0};
  struct resonance mouth[3] = {{0}}, teeth = {0};
  double phase = 0.0, flow = 0.0, rough = 0.0;
  resonance_tune(&teeth, 5200.0, 1800.0);
  for (size_t n = 0; n < samples; ++n) {
    const double seconds = (double)n / ERN_SYNTH_RATE;
    const double at = seconds * ERN_SYNTH_STEPS + ERN_SYNTH_BEFORE;
    if (n % 32 == 0) /* 2 ms */
      for (size_t f = 0; f < 3; ++f)
        resonance_tune(&mouth[f], between(&speech->formants[0][f], 3, speech->steps, at), bands[f]);
    /* louder the wider the mouth is open; melody falls and rises over a second */
    const double jaw = between(speech->jaw, 1, speech->steps, at);
    const double loud = between(speech->loud, 1, speech->steps, at) * (0.35 + 0.65 * jaw);
    const double hiss = between(speech->hiss, 1, speech->steps, at);
    const double start = synth_uniform(seed, STREAM_PITCH, 0, 0.0, 6.28);
    const double pitch = (double)voice * (1.0 + 0.10 * sin(4.1 * seconds + start) + 0.05 * sin(9.7 * seconds));
    phase += pitch / ERN_SYNTH_RATE;
    phase -= floor(phase);
    const double open = glottis(phase), pulse = open - flow; /* the source is the derivative of the flow */
    flow = open;
    const double noise = synth_uniform(seed, STREAM_HISS, n, -1.0, 1.0), sharp = noise - rough;
    rough = noise;
    double x = loud * (8.0 * pulse + 0.02 * noise);
    for (int f = 0; f < 3; ++f) x = resonance_run(&mouth[f], x);
    x += 0.10 * hiss * resonance_run(&teeth, sharp);
    x = tanh(0.55 * x); /* limits to full scale */
    sound[n] = (int16_t)lrint(30000.0 * x);
  }
}
