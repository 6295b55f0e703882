/* SPDX-License-Identifier: MIT */
#include "session/settings.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

struct settings settings_with(struct settings settings, const struct choice *choice) {
  const bool device = choice->backend != NULL && strcmp(choice->backend, "opencl") == 0;
  switch (choice->axis) {
    case AXIS_SCALE: settings.image_scale = (float)choice->value; break;
    case AXIS_STEPS: settings.max_steps = (int)choice->value; break;
    case AXIS_STOP: settings.transmittance_stop = (float)choice->value; break;
    case AXIS_THRESHOLD: settings.occupancy_threshold = (float)choice->value; break;
    case AXIS_THREADS: settings.threads = (int)choice->value; break;
    case AXIS_UNIT:
      snprintf(settings.backend, sizeof settings.backend, "%s", choice->backend);
      snprintf(settings.isa, sizeof settings.isa, "%s", device ? "" : choice->isa);
      settings.device = device ? (int)choice->value : 0;
      if (device) settings.threads = 0;
      break;
    case AXES: break;
  }
  return settings;
}

static bool same(float a, float b) { return fabsf(a - b) <= 1e-6f * fmaxf(fabsf(a), fabsf(b)); }

static bool same_unit(const struct settings *a, const struct settings *b) {
  return strcmp(a->backend, b->backend) == 0 && strcmp(a->isa, b->isa) == 0 && a->device == b->device;
}

size_t settings_changes(const struct settings *a, const struct settings *b) {
  return (size_t)!same(a->image_scale, b->image_scale) + (a->max_steps != b->max_steps) +
         !same(a->transmittance_stop, b->transmittance_stop) + !same(a->occupancy_threshold, b->occupancy_threshold) +
         !same_unit(a, b) + (same_unit(a, b) && a->threads != b->threads);
}

static void add(struct bytes *name, const char *format, ...) ERN_PRINTF(2, 3);
static void add(struct bytes *name, const char *format, ...) {
  char text[64];
  va_list values;
  va_start(values, format);
  vsnprintf(text, sizeof text, format, values);
  va_end(values);
  bytes_print(name, "%s%s", name->count > 0 ? ", " : "", text);
}

void settings_name(const struct settings *s, const struct settings *base, const char *none, struct bytes *name) {
  if (!same(s->image_scale, base->image_scale)) add(name, "scale %.3g", (double)s->image_scale);
  if (s->max_steps != base->max_steps) add(name, "%d sample%s", s->max_steps, s->max_steps == 1 ? "" : "s");
  if (!same(s->transmittance_stop, base->transmittance_stop)) add(name, "stop %.3g", (double)s->transmittance_stop);
  if (!same(s->occupancy_threshold, base->occupancy_threshold))
    add(name, "threshold %.3g", (double)s->occupancy_threshold);
  if (!same_unit(s, base) && s->isa[0] == 0) add(name, "OpenCL device %d", s->device);
  if (!same_unit(s, base) && s->isa[0] != 0) add(name, "%s", s->isa);
  if (same_unit(s, base) && s->threads != base->threads)
    add(name, "%d thread%s", s->threads, s->threads == 1 ? "" : "s");
  if (name->count == 0) bytes_print(name, "%s", none);
}

void settings_options(const struct settings *s, const struct settings *base, struct bytes *words) {
  if (base == NULL || s->max_steps != base->max_steps) bytes_print(words, " --max-steps %d", s->max_steps);
  if (base == NULL || !same(s->transmittance_stop, base->transmittance_stop))
    bytes_print(words, " --set transmittance-stop=%.6g", (double)s->transmittance_stop);
  if (base == NULL || !same(s->occupancy_threshold, base->occupancy_threshold))
    bytes_print(words, " --set occupancy-threshold=%.6g", (double)s->occupancy_threshold);
  if (base == NULL || !same(s->image_scale, base->image_scale))
    bytes_print(words, " --set image-scale=%.6g", (double)s->image_scale);
  const bool unit = base == NULL || !same_unit(s, base);
  if (unit && s->isa[0] == 0) bytes_print(words, " --backend opencl --device %d", s->device);
  if (unit && s->isa[0] != 0) bytes_print(words, " --isa %s", s->isa);
  if (s->isa[0] != 0 && (base == NULL || s->threads != base->threads)) bytes_print(words, " --threads %d", s->threads);
}

json_t *settings_json(const struct settings *s) {
  return json_pack("{s:i, s:f, s:f, s:f, s:s, s:s, s:i, s:i}", "max_steps", s->max_steps, "transmittance_stop",
                   (double)s->transmittance_stop, "occupancy_threshold", (double)s->occupancy_threshold, "image_scale",
                   (double)s->image_scale, "backend", s->backend, "isa", s->isa, "device", s->device, "threads",
                   s->threads);
}

/* Reads the member as a number in [low, high]; `whole`: an integer. */
static bool take(const json_t *object, const char *name, double low, double high, bool whole, double *value) {
  const json_t *member = json_object_get(object, name);
  if (whole ? !json_is_integer(member) : !json_is_number(member)) return false;
  *value = json_number_value(member);
  return *value >= low && *value <= high;
}

static bool take_word(const json_t *object, const char *name, size_t bytes, char *word) {
  const char *text = json_string_value(json_object_get(object, name));
  if (text == NULL || strlen(text) >= bytes || strspn(text, "abcdefghijklmnopqrstuvwxyz0123456789") != strlen(text))
    return false;
  strcpy(word, text);
  return true;
}

const char *settings_of_json(struct settings *settings, const json_t *object) {
  double steps, stop, threshold, scale, device, threads;
  struct settings made = {0};
  if (!json_is_object(object)) return "settings, expected an object";
  if (!take(object, "max_steps", 1, 1024, true, &steps)) return "max_steps, expected a whole number from 1 to 1024";
  if (!take(object, "transmittance_stop", 0, 0.99, false, &stop)) return "transmittance_stop, expected 0 to 0.99";
  if (!take(object, "occupancy_threshold", 0, 1e6, false, &threshold)) return "occupancy_threshold, expected 0 to 1e6";
  if (!take(object, "image_scale", 0.25, 1, false, &scale)) return "image_scale, expected 0.25 to 1";
  if (!take(object, "device", 0, 255, true, &device)) return "device, expected a whole number from 0 to 255";
  if (!take(object, "threads", 0, ERN_THREADS_MOST, true, &threads))
    return "threads, expected a whole number from 0 to 256";
  if (!take_word(object, "backend", sizeof made.backend, made.backend) ||
      (strcmp(made.backend, "cpu") != 0 && strcmp(made.backend, "opencl") != 0))
    return "backend, expected \"cpu\" or \"opencl\"";
  const bool cpu = strcmp(made.backend, "cpu") == 0;
  if (!take_word(object, "isa", sizeof made.isa, made.isa) || cpu != (made.isa[0] != 0))
    return "isa, expected a name, \"\" with opencl";
  made.max_steps = (int)steps;
  made.transmittance_stop = (float)stop;
  made.occupancy_threshold = (float)threshold;
  made.image_scale = (float)scale;
  made.device = (int)device;
  made.threads = (int)threads;
  *settings = made;
  return NULL;
}

void settings_apply(const struct settings *settings, ern_render_options *options) {
  options->max_steps = settings->max_steps;
  options->transmittance_stop = settings->transmittance_stop;
  options->image_scale = settings->image_scale;
  options->threads = settings->threads;
}
