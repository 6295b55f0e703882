/* SPDX-License-Identifier: MIT
 * Figures of a live run. */
#include "live/live_job.h"

static double time_of(const struct live_times *times, double share) {
  uint64_t seen = 0;
  for (size_t i = 0; i <= LIVE_MILLISECONDS; i++) {
    seen += times->bin[i];
    if (seen > 0 && (double)seen >= share * (double)times->count) return (double)i;
  }
  return 0;
}

json_t *live_statistics(struct live_job *job) {
  const bool controls = !job->unpaced;
  size_t waiting = 0;
  const unsigned speaking = live_sound_speaking(&job->sound, &waiting);
  json_t *late = json_pack("{s:f, s:f, s:f}", "p50", live_output_late(&job->output, 0.5), "p99",
                           live_output_late(&job->output, 0.99), "worst", live_output_late(&job->output, 1));
  json_t *to_frame = json_pack("{s:f, s:f, s:f}", "p50", time_of(&job->to_frame, 0.5), "p99",
                               time_of(&job->to_frame, 0.99), "worst", time_of(&job->to_frame, 1));
  return json_pack("{s:o, s:I, s:I, s:o, s:I, s:I, s:I, s:I, s:I, s:I, s:I, s:o, s:o, s:s, s:o}", "speaking",
                   speaking > 0 ? json_integer((json_int_t)speaking) : json_null(), "queued", (json_int_t)waiting,
                   "frames", (json_int_t)job->frames, "seconds", session_number(session_seconds() - job->began),
                   "drawn", (json_int_t)job->drawn, "repeated", (json_int_t)job->repeated, "as_recorded",
                   (json_int_t)job->as_recorded, "skipped", (json_int_t)job->skipped, "written",
                   (json_int_t)atomic_load(&job->output.written), "left_out",
                   (json_int_t)atomic_load(&job->output.left_out), "readers",
                   (json_int_t)atomic_load(&job->output.readers), "sound_to_frame_ms", to_frame, "late_ms", late,
                   "settings_now", controls ? rate_control_name(&job->rate_control) : "as asked", "rate_control",
                   controls ? rate_control_json(&job->rate_control) : json_null());
}
