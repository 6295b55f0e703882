/* SPDX-License-Identifier: MIT
 * The settings on which accuracy and time of a render depend, as plain values: functions compare them, print them, and
 * change one at a time. */
#ifndef ERN_CLI_SETTINGS_H
#define ERN_CLI_SETTINGS_H

#include <jansson.h>

#include "bytes.h"
#include "ernerf/render.h"

struct settings {
  int max_steps;
  float transmittance_stop, occupancy_threshold, image_scale;
  char backend[16], isa[24]; /* "cpu" and an instruction set, or "opencl" and "" */
  int device;                /* of OpenCL; 0 else */
  int threads;               /* of the CPU, 0: one a core; 0 of a device */
};

/* The setting that a choice changes; all others keep the base's values. */
enum axis { AXIS_SCALE, AXIS_STEPS, AXIS_STOP, AXIS_THRESHOLD, AXIS_UNIT, AXIS_THREADS, AXES };
struct choice {
  enum axis axis;
  double value;              /* of the first four axes; AXIS_THREADS: number of threads; AXIS_UNIT: OpenCL device */
  const char *backend, *isa; /* of AXIS_UNIT */
};
struct settings settings_with(struct settings settings, const struct choice *choice);

/* Number of settings that differ from the base. */
size_t settings_changes(const struct settings *settings, const struct settings *base);
/* "scale 0.5, 8 samples": the settings that differ from the base; `none` if none does. */
void settings_name(const struct settings *settings, const struct settings *base, const char *none, struct bytes *name);
/* The options of `ernerf render` for the settings that differ from the base; base NULL: for all settings. Each begins
 * with a space. */
void settings_options(const struct settings *settings, const struct settings *base, struct bytes *words);

/* {"max_steps": 16, ...}; NULL without memory. */
json_t *settings_json(const struct settings *settings);
/* Reads the object of settings_json. Returns NULL, or a text that names the wrong member and what was expected. */
const char *settings_of_json(struct settings *settings, const json_t *object);

/* Copies the settings that a renderer is created with; ern_renderer_prune_occupancy applies the occupancy threshold. */
void settings_apply(const struct settings *settings, ern_render_options *options);

#endif
