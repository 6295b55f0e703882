/* SPDX-License-Identifier: MIT */
#include "prepare/segment.h"

#include <math.h>
#include <string.h>

#include "io/number.h"
#include "media/speech_network.h"
#include "prepare/footage.h"
#include "prepare/stabilized_crop.h"

enum { SOUND_RATE = 16000, TRIED = 100 /* candidate start positions within a segment's length */ };
static const double auto_length = 180, auto_longer = 300, shortest = 1,
                    longest = 1800; /* seconds; ERN_PREPARE_FRAMES */

struct ern_segment_probe {
  float place[3]; /* centre x, y in widths of the face, and log of the width */
  bool face, loud;
  bool cut, cut_before; /* a cut since the previous probe, up to this one's frame; one before this one's frame */
};

ern_status ern_segment_read(ern_context *context, const char *text, double *length, double *longer_than) {
  const char *at = text;
  *length = auto_length;
  *longer_than = auto_longer;
  if (strcmp(text, "auto") == 0) return ERN_OK;
  if (ern_number_read(&at, text + strlen(text), length) && *at == 0 && *length >= shortest && *length <= longest) {
    *longer_than = *length;
    return ERN_OK;
  }
  return ern_fail(context, ERN_E_ARGUMENT, "prepare: segment is \"%.60s\", expected \"auto\", or seconds of %g to %g",
                  text, shortest, longest);
}

ern_status ern_segment_add(ern_context *context, struct ern_segment_search *search, const struct ern_found_face *face) {
  ern_status status = ERN_OK;
  if (search->count == search->capacity) {
    struct ern_segment_probe *larger = NULL;
    const size_t capacity = 2 * search->capacity + 256;
    ERN_TRY(ERN_NEW(context, capacity, &larger));
    if (search->count > 0) memcpy(larger, search->probes, search->count * sizeof *larger);
    ern_release(context, search->probes);
    search->probes = larger;
    search->capacity = capacity;
  }
  struct ern_segment_probe probe = {
      .face = face->width > 0, .cut = search->cut > 0, .cut_before = search->cut > 0 && search->cut < face->frame};
  if (probe.face) {
    probe.place[0] = face->x / face->width + 0.5f;
    probe.place[1] = (face->y + 0.5f * face->height) / face->width;
    probe.place[2] = logf(face->width);
  }
  search->probes[search->count++] = probe;
  search->cut = 0;
fail:
  return status;
}

void ern_segment_free(ern_context *context, struct ern_segment_search *search) {
  ern_release(context, search->probes);
  *search = (struct ern_segment_search){0};
}

/* Sets `loud` for probes whose sound, up to the next probe, is louder than a tenth (-20 dB) of the video's loud parts
 * (95th percentile); for all probes where there is no sound. */
static ern_status measure_sound(struct ern_prepare_job *job, struct ern_segment_probe *probes, size_t count,
                                size_t every) {
  ern_status status = ERN_OK;
  struct ern_footage footage = {0};
  float *samples = NULL, *levels = NULL, *sorted = NULL;
  size_t length = 0;
  for (size_t i = 0; i < count; i++) probes[i].loud = true;
  ERN_TRY(ern_footage_open(job, &footage));
  if (!footage.info.has_sound) goto fail;
  ERN_TRY(ern_speech_wave(job->context, job->video, SOUND_RATE, &samples, &length));
  ERN_TRY(ERN_NEW(job->context, count, &levels));
  ERN_TRY(ERN_NEW(job->context, count, &sorted));
  const size_t span = every * (SOUND_RATE / ERN_PREPARE_RATE);
  const long long first = llround((footage.first - footage.info.start + job->options->from) * SOUND_RATE);
  for (size_t i = 0; i < count; i++) {
    double sum = 0;
    for (size_t k = 0; k < span; k++) {
      const long long at = first + (long long)(i * span + k);
      if (at >= 0 && (size_t)at < length) sum += (double)samples[at] * (double)samples[at];
    }
    levels[i] = sorted[i] = (float)sqrt(sum / (double)span);
  }
  const float limit = 0.1f * ern_quantile(sorted, count, 0.95);
  for (size_t i = 0; i < count; i++) probes[i].loud = levels[i] > limit;
fail:
  ern_release(job->context, samples);
  ern_release(job->context, levels);
  ern_release(job->context, sorted);
  ern_footage_close(&footage);
  return status;
}

/* The score of a segment, 0..4; below 0 where it has a cut. values: scratch, [length]. */
static double segment_score(const struct ern_segment_probe *probes, size_t length, bool cut_at_end, float *values) {
  size_t faces = 0, loud = 0, n = 0;
  double square = 0;
  for (size_t i = 0; i < length; i++) {
    if (i > 0 && probes[i].cut) return -1;
    faces += probes[i].face;
    loud += probes[i].loud;
  }
  if (cut_at_end) return -1;
  for (int c = 0; c < 3 && faces > 0; c++) {
    n = 0;
    for (size_t i = 0; i < length; i++)
      if (probes[i].face) values[n++] = probes[i].place[c];
    const float low = ern_quantile(values, n, 0.1), high = ern_quantile(values, n, 0.9);
    square += (double)((high - low) * (high - low));
  }
  /* a spread above half a face's width adds nothing, as the clip's square grows with it */
  const double spread = fmin(2 * sqrt(square), 1);
  return (2 * (double)faces + (double)loud) / (double)length + spread;
}

ern_status ern_segment_choose(struct ern_prepare_job *job, const struct ern_segment_search *search, size_t every,
                              double length, bool *found) {
  ern_status status = ERN_OK;
  float *values = NULL;
  const size_t wanted = (size_t)llround(length * ERN_PREPARE_RATE / (double)every);
  const size_t span = wanted < search->count ? wanted : search->count;
  const size_t step = span > TRIED ? span / TRIED : 1;
  double best = -1;
  ERN_TRY(measure_sound(job, search->probes, search->count, every));
  ERN_TRY(ERN_NEW(job->context, span, &values));
  for (size_t begin = 0; begin + span <= search->count; begin += step) {
    const bool cut = begin + span < search->count ? search->probes[begin + span].cut_before : search->cut > 0;
    const double value = segment_score(search->probes + begin, span, cut, values);
    if (value <= best) continue;
    best = value;
    job->segment[0] = job->options->from + (double)(begin * every) / ERN_PREPARE_RATE;
    job->segment[1] = job->segment[0] + (double)(span * every) / ERN_PREPARE_RATE;
  }
  *found = best >= 0;
fail:
  ern_release(job->context, values);
  return status;
}
