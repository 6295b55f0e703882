/* SPDX-License-Identifier: MIT
 * What accuracy and time of a render depend on, as plain values: compared, put into words, and one changed at a time.
 */
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

/* Which of them is changed: each by itself, the others being those of the base. */
enum axis { AXIS_SCALE, AXIS_STEPS, AXIS_STOP, AXIS_THRESHOLD, AXIS_UNIT, AXIS_THREADS, AXES };
struct choice {
  enum axis axis;
  double value;              /* of the first four; the number of threads; an OpenCL device */
  const char *backend, *isa; /* of AXIS_UNIT */
};
struct settings settings_with(struct settings settings, const struct choice *choice);

/* How many are not the base's. */
size_t settings_changes(const struct settings *settings, const struct settings *base);
/* "scale 0.5, 8 samples": what is not the base's; `none` where nothing is. */
void settings_name(const struct settings *settings, const struct settings *base, const char *none, struct bytes *name);
/* The words for `ernerf render` that ask for what is not the base's; of all with base NULL. Each begins with a
 * blank. */
void settings_options(const struct settings *settings, const struct settings *base, struct bytes *words);

/* {"max_steps": 16, ...}; NULL without memory. */
json_t *settings_json(const struct settings *settings);
/* The other way round. NULL: it was read; else which member is wrong, and what was expected. */
const char *settings_of_json(struct settings *settings, const json_t *object);

/* What a renderer is made with; the threshold is asked for by ern_renderer_prune_occupancy. */
void settings_apply(const struct settings *settings, ern_render_options *options);

#endif
