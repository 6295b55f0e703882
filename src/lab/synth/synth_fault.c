/* SPDX-License-Identifier: MIT
 * Faults of the synthetic clip that concern its motion. */
#include <string.h>

#include "core/memory.h"
#include "lab/synth/synth_parts.h"

enum { STREAM_SHAKE = 61, RAMP = 12 /* frames, half a second */ };

/* Sum of two sines of 1.7 and 0.6 s with amplitude `most`. */
static float shake(uint64_t seed, uint64_t which, double seconds, double most) {
  static const double periods[2] = {1.7, 0.6}, shares[2] = {0.75, 0.25};
  double sum = 0.0;
  for (uint64_t k = 0; k < 2; ++k) {
    const double phase = synth_uniform(seed, STREAM_SHAKE, 2 * which + k, 0.0, 1.0);
    sum += most * shares[k] * sin(2.0 * 3.14159265358979323846 * (seconds / periods[k] + phase));
  }
  return (float)sum;
}

/* 1 in the middle third, with ramps inside it. */
static float middle_third(size_t t, size_t frames) {
  const float first = (float)frames / 3.0f, last = 2.0f * first, ramp = minf((float)RAMP, first / 3.0f);
  const float at = (float)t;
  return smoothf(first, first + ramp, at) * smoothf(last, last - ramp, at);
}

ern_status ern_synth_fault_move(ern_context *context, const ern_synth_options *options,
                                const struct ern_synth_speech *speech, struct ern_synth_curve *curves, size_t frames,
                                size_t *cut) {
  ern_status status = ERN_OK;
  const double strength = options->strength;
  struct ern_synth_curve *others = NULL;
  size_t from = frames - (size_t)(strength / 100.0 * (double)frames); /* of a stretch of hundredths to the end */
  if (from > frames - 1) from = frames - 1;
  switch (options->fault) {
    case ERN_SYNTH_NO_FAULT:
    case ERN_SYNTH_OCCLUDE: break;
    case ERN_SYNTH_CAMERA:
      for (size_t t = 0; t < frames; ++t) {
        curves[t].pan = shake(options->seed, 0, (double)t / ERN_SYNTH_FPS, strength);
        curves[t].nod = shake(options->seed, 1, (double)t / ERN_SYNTH_FPS, strength);
      }
      break;
    case ERN_SYNTH_PROFILE:
      for (size_t t = 0; t < frames; ++t) curves[t].yaw = mixf(curves[t].yaw, (float)strength, middle_third(t, frames));
      break;
    case ERN_SYNTH_STILL:
      for (size_t t = from; t < frames; ++t) curves[t] = curves[from];
      break;
    case ERN_SYNTH_CUT:
      ERN_TRY(ERN_NEW(context, frames, &others));
      ern_synth_motion_make(options->seed + 1, speech, options->blink, options->moving_camera, options->turn, others,
                            frames);
      memcpy(curves + from, others + from, (frames - from) * sizeof *curves);
      *cut = from;
      break;
  }
fail:
  ern_release(context, others);
  return status;
}
