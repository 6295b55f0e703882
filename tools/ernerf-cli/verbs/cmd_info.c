/* SPDX-License-Identifier: MIT
 * ernerf info: shows the contents of a file, or lists the devices. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ernerf/data.h"
#include "ernerf/model.h"
#include "session/speech_model.h"
#include "verbs.h"

#define GIB (1024.0 * 1024 * 1024)

/* ---- devices ----------------------------------------------------------------------------------------------------- */

struct device_list {
  struct session *session;
  json_t *list;
};

static void take_device(void *user, const ern_device_info *device) {
  struct device_list *devices = user;
  if (!session_json_on_stdout(devices->session)) {
    printf("%-7s %d  %s, %u compute units, %.1f GiB%s%s\n", device->kind, device->number, device->name,
           device->compute_units, (double)device->memory_bytes / GIB, device->version[0] != 0 ? ", " : "",
           device->version);
    if (device->instruction_sets[0] != 0) printf("           instruction sets: %s\n", device->instruction_sets);
    if (strcmp(device->kind, "opencl") == 0)
      printf(
          "           driver %s, %.1f GiB a buffer, %.0f KiB local memory, half precision: %s, subgroups: %s, tuned: "
          "%s\n           float additions in memory: %s, tensor cores: %s, kernels of an earlier use in the cache: "
          "%s\n           the same bytes on every run: "
          "%s\n",
          device->driver, (double)device->buffer_bytes / GIB, (double)device->local_bytes / 1024,
          device->half ? "yes" : "no", device->subgroups ? "yes" : "no", device->tuned ? "yes" : "no",
          device->adds_floats ? "one instruction" : "a loop", device->tensor_cores ? "yes" : "no",
          device->kernels_kept ? "yes" : "no", device->deterministic ? "yes" : "with --set deterministic=yes alone");
  }
  json_array_append_new(
      devices->list,
      json_pack("{s:s, s:i, s:s, s:s, s:s, s:I, s:I, s:s, s:I, s:I, s:b, s:b, s:b, s:b, s:b, s:b, s:b}", "kind",
                device->kind, "number", device->number, "name", device->name, "version", device->version,
                "instruction_sets", device->instruction_sets, "compute_units", (json_int_t)device->compute_units,
                "memory_bytes", (json_int_t)device->memory_bytes, "driver", device->driver, "buffer_bytes",
                (json_int_t)device->buffer_bytes, "local_bytes", (json_int_t)device->local_bytes, "half", device->half,
                "subgroups", device->subgroups, "tuned", device->tuned, "deterministic", device->deterministic,
                "adds_floats", device->adds_floats, "tensor_cores", device->tensor_cores, "kernels_kept",
                device->kernels_kept));
}

static int list_devices(struct session *session) {
  struct device_list devices = {.session = session, .list = json_array()};
  if (ern_devices_list(session->context, take_device, &devices) != ERN_OK) {
    json_decref(devices.list);
    return session_fail(session);
  }
  if (!session_json_on_stdout(session)) printf("\nbackends: auto (the CPU), cpu, opencl (with --device N)\n");
  return session_report(session,
                        json_pack("{s:[s, s, s], s:o}", "backends", "auto", "cpu", "opencl", "devices", devices.list));
}

static void take_tuning(void *user, const ern_tuning *tuning) {
  struct device_list *devices = user;
  const bool known = tuning->best > 0;
  const double ratio = known ? tuning->standard_seconds / tuning->best_seconds : 0;
  if (!session_json_on_stdout(devices->session)) {
    if (known)
      printf("  %-14s %8d %10.3f ms %8d %10.3f ms %7.2f %6d\n", tuning->name, tuning->standard,
             tuning->standard_seconds * 1e3, tuning->best, tuning->best_seconds * 1e3, ratio, tuning->used);
    else
      printf("  %-14s %8d     not measured, the time was over %15d\n", tuning->name, tuning->standard, tuning->used);
  }
  json_array_append_new(devices->list,
                        json_pack("{s:s, s:b, s:i, s:i, s:i, s:f, s:f}", "name", tuning->name, "measured", known,
                                  "standard", tuning->standard, "best", tuning->best, "used", tuning->used,
                                  "standard_seconds", tuning->standard_seconds, "best_seconds", tuning->best_seconds));
}

static int tune_device(struct session *session) {
  struct device_list devices = {.session = session};
  if (session_backend(session) != ERN_OK) return session_fail(session);
  devices.list = json_array();
  if (!session_json_on_stdout(session))
    printf("device %d: %s\n  size           standard                   best            times     used\n",
           session->device, session->backend_info.isa);
  ern_backend_tuning(session->backend, take_tuning, &devices);
  return session_report(session, json_pack("{s:i, s:s, s:o}", "device", session->device, "name",
                                           session->backend_info.isa, "sizes", devices.list));
}

/* ---- tensors ----------------------------------------------------------------------------------------------------- */

struct tensor_list {
  json_t *list;
  bool state;               /* holds the other values of a training's state */
  bool model;               /* holds tensors of a model */
  size_t moments, averages; /* number of tensors of the optimizer's state and of the EMA */
  int dims;
  size_t shape[4]; /* of the last one */
};

static void take_tensor(void *user, const ern_tensor_info *tensor) {
  struct tensor_list *tensors = user;
  json_t *shape = json_array();
  for (int d = 0; d < tensor->dims; d++) json_array_append_new(shape, json_integer((json_int_t)tensor->shape[d]));
  json_array_append_new(tensors->list, json_pack("{s:s, s:s, s:o}", "name", tensor->name != NULL ? tensor->name : "",
                                                 "dtype", tensor->dtype, "shape", shape));
  const char *name = tensor->name != NULL ? tensor->name : "";
  tensors->moments += strncmp(name, "state.moment.", 13) == 0;
  tensors->averages += strncmp(name, "state.average.", 14) == 0;
  tensors->state |= strncmp(name, "state.", 6) == 0 && strncmp(name, "state.file.", 11) != 0;
  tensors->model |= strcmp(name, "encoder_xy.embeddings") == 0 || strcmp(name, "sigma_net.net.0.weight") == 0;
  tensors->dims = tensor->dims;
  memcpy(tensors->shape, tensor->shape, sizeof tensors->shape);
}

static void print_tensors(json_t *list) {
  size_t index;
  json_t *tensor;
  printf("tensors:\n");
  json_array_foreach(list, index, tensor) {
    char *shape = json_dumps(json_object_get(tensor, "shape"), 0), name[512];
    snprintf(name, sizeof name, "%s", json_string_value(json_object_get(tensor, "name")));
    bytes_plain(name);
    printf("  %-44s %-4s %s\n", name, json_string_value(json_object_get(tensor, "dtype")), shape != NULL ? shape : "");
    free(shape);
  }
}

/* ---- models ------------------------------------------------------------------------------------------------------ */

static json_t *effects_of(const ern_model_info *info) {
  json_t *effects = json_pack("[s]", "audio");
  if (info->has_eye) json_array_append_new(effects, json_string("eye"));
  if (info->has_view) json_array_append_new(effects, json_string("view"));
  if (info->has_codes) json_array_append_new(effects, json_string("codes"));
  if (info->has_torso) json_array_append_new(effects, json_string("torso"));
  return effects;
}

/* The verbs that accept the file. */
static json_t *uses_of(const struct tensor_list *tensors, const ern_model_info *info) {
  json_t *uses = info->dub ? json_pack("[s]", "dub") : json_pack("[s, s]", "render", "eval");
  if (info->has_view && info->backbone == ERN_BACKBONE_TRIHASH && info->attention == ERN_ATTENTION_CHANNEL &&
      info->eye_attention == ERN_EYE_ATTENTION_SIGMOID)
    json_array_append_new(uses, json_string("convert")); /* PyTorch files hold no other effect */
  json_array_append_new(
      uses, json_string(tensors->moments > 0 ? "train --from: goes on at its step" : "train --from: its weights"));
  if (!info->has_torso && !info->dub) json_array_append_new(uses, json_string("train --torso --head"));
  return uses;
}

static void print_state(const struct tensor_list *tensors, json_t *uses) {
  size_t index;
  json_t *use;
  if (tensors->state)
    printf("  training state   optimizer of %zu tensors, average of %zu\n", tensors->moments, tensors->averages);
  printf("  use it for       ");
  json_array_foreach(uses, index, use) printf("%s%s", index > 0 ? ", " : "", json_string_value(use));
  printf("\n");
}

/* Whether the voice moves only what is below a height. */
static bool fades(const ern_model_info *info) { return info->voice_fade[1] > info->voice_fade[0]; }
static json_t *fade_json(const ern_model_info *info) {
  return fades(info) ? json_pack("[f, f]", (double)info->voice_fade[0], (double)info->voice_fade[1]) : json_null();
}

static void print_model(const char *path, const char *kind, const ern_model_info *info, json_t *effects) {
  char *list = json_dumps(effects, 0), wanted[192];
  ern_model_info said = *info; /* its texts may hold anything */
  speech_model_wanted(info, wanted);
  bytes_plain(wanted);
  bytes_plain(said.speech);
  bytes_plain(said.clip);
  bytes_plain(said.consent);
  printf("%s: %s\n", path, kind);
  printf("  steps            head %" PRIu64 ", torso %" PRIu64 "\n", info->head_steps, info->torso_steps);
  printf("  backbone         %s\n", ern_backbone_name(info->backbone));
  printf("  attention        %s%s%s\n", ern_attention_name(info->attention), info->has_eye ? ", of the eyes " : "",
         info->has_eye ? ern_eye_attention_name(info->eye_attention) : "");
  if (info->levels > 1) printf("  levels           %d\n", info->levels);
  printf("  features         %d wide", info->feature_width);
  if (info->window_length > 0) printf(", %d to a window", info->window_length);
  if (said.speech[0] != 0) printf(", %s", said.speech);
  printf("%s\n", wanted);
  printf("  effects          %s\n", list != NULL ? list : "");
  printf("  codes            %d\n", info->codes);
  printf("  bound            %g\n", (double)info->bound);
  printf("  view settings    scale %g, dt_gamma %g, %d samples a ray, torso_shrink %g, audio-pad %s%s\n",
         (double)info->scale, (double)info->dt_gamma, info->max_steps, (double)info->torso_shrink,
         ern_audio_pad_name(info->audio_pad), info->has_view_settings ? "" : " (not said: the defaults)");
  if (fades(info))
    printf("  voice            ends between the heights %.3f and %.3f of the scene\n", (double)info->voice_fade[0],
           (double)info->voice_fade[1]);
  if (info->cameras > 0) printf("  poses            corrected for %zu training frames\n", info->cameras);
  printf("  trained numbers  %zu, %zu bytes\n", info->parameters, info->parameter_bytes);
  printf("  clip             %s\n", said.clip[0] != 0 ? said.clip : "not said");
  printf("  consent          %s\n", said.consent[0] != 0 ? said.consent : "not said");
  free(list);
}

/* Camera settings that other verbs use by default; said: whether the file has them, else these are the library's
 * defaults. */
static json_t *view_json(const ern_model_info *info) {
  return json_pack("{s:b, s:f, s:f, s:i, s:f, s:s}", "said", info->has_view_settings, "scale", (double)info->scale,
                   "dt_gamma", (double)info->dt_gamma, "max_steps", info->max_steps, "torso_shrink",
                   (double)info->torso_shrink, "audio_pad", ern_audio_pad_name(info->audio_pad));
}

/* Lists tensors that are not a model. */
static int describe_tensors(struct session *session, const char *path, json_t *list) {
  if (!session_json_on_stdout(session)) {
    printf("%s: tensors of another program\n  use it for       convert\n", path);
    print_tensors(list);
  }
  return session_report(session, json_pack("{s:o, s:s, s:[s], s:o}", "file", session_text(path), "kind", "tensors",
                                           "uses", "convert", "tensors", list));
}

static int describe_model(struct session *session, const char *path) {
  struct tensor_list tensors = {.list = json_array()};
  ern_model *model = NULL;
  ern_model_info info;
  ern_status status = ern_file_tensors(session->context, path, take_tensor, &tensors);
  if (status == ERN_OK && !tensors.model) return describe_tensors(session, path, tensors.list);
  if (status == ERN_OK) status = ern_model_load(&model, session->context, path);
  if (status != ERN_OK) {
    json_decref(tensors.list);
    return session_fail(session);
  }
  ern_model_describe(model, &info);
  const char *kind = tensors.state ? "state" : info.has_torso ? "head+torso" : "head";
  json_t *effects = effects_of(&info), *uses = uses_of(&tensors, &info),
         *network = info.speech_network[0] != 0 ? json_loads(info.speech_network, 0, NULL) : NULL;
  if (!session_json_on_stdout(session)) {
    print_model(path, kind, &info, effects);
    print_state(&tensors, uses);
    print_tensors(tensors.list);
  }
  ern_model_free(&model);
  const uint64_t step = info.has_torso ? info.torso_steps : info.head_steps;
  return session_report(
      session,
      json_pack("{s:o, s:s, s:I, s:I, s:I, s:s, s:s, s:s, s:i, s:o, s:i, s:i, s:s, s:o, s:i, s:b, s:f, s:o, s:s, s:s, "
                "s:I, s:I, "
                "s:I, s:b, s:o, s:o, s:{s:I, s:I}, s:o}",
                "file", session_text(path), "kind", kind, "step", (json_int_t)step, "head_steps",
                (json_int_t)info.head_steps, "torso_steps", (json_int_t)info.torso_steps, "backbone",
                ern_backbone_name(info.backbone), "attention", ern_attention_name(info.attention), "eye_attention",
                ern_eye_attention_name(info.eye_attention), "levels", info.levels, "effects", effects, "feature_width",
                info.feature_width, "window_length", info.window_length, "speech", info.speech, "speech_network",
                network != NULL ? network : json_null(), "codes", info.codes, "torso_gamma", info.has_gamma, "bound",
                (double)info.bound, "view", view_json(&info), "clip", info.clip, "consent", info.consent, "parameters",
                (json_int_t)info.parameters, "parameter_bytes", (json_int_t)info.parameter_bytes, "cameras",
                (json_int_t)info.cameras, "dub", info.dub, "voice_fade", fade_json(&info), "uses", uses, "state",
                "optimizer_tensors", (json_int_t)tensors.moments, "average_tensors", (json_int_t)tensors.averages,
                "tensors", tensors.list));
}

/* ---- other files ------------------------------------------------------------------------------------------------- */

static const char *features_kind(int width) {
  return width == 29 ? "deepspeech" : width == 44 ? "wav2vec" : width == 1024 ? "hubert" : "unknown";
}

/* An array with the shape of speech features is checked as such; any other is only listed. */
static int describe_array(struct session *session, const char *path) {
  struct tensor_list tensors = {.list = json_array()};
  ern_features features = {0};
  ern_status status = ern_file_tensors(session->context, path, take_tensor, &tensors);
  const bool speech = tensors.dims == 3 && tensors.shape[1] >= 1 && tensors.shape[1] <= 16 && tensors.shape[2] <= 4096;
  if (status == ERN_OK && speech) status = ern_features_load(session->context, path, &features);
  if (status != ERN_OK) {
    json_decref(tensors.list);
    return session_fail(session);
  }
  if (!session_json_on_stdout(session)) {
    printf("%s: %s\n", path, speech ? "clip features" : "array");
    if (speech)
      printf("  windows          %zu (%.2f s)\n  window           %d vectors of %d values (%s)\n", features.windows,
             (double)features.windows / 25, features.window_length, features.width, features_kind(features.width));
    if (speech) printf("  use it for       render --audio, train --audio\n");
    print_tensors(tensors.list);
  }
  json_t *object = json_pack("{s:o, s:s, s:o}", "file", session_text(path), "kind", speech ? "clip features" : "array",
                             "tensors", tensors.list);
  if (speech && object != NULL) {
    json_object_set_new(object, "windows", json_integer((json_int_t)features.windows));
    json_object_set_new(object, "window_length", json_integer(features.window_length));
    json_object_set_new(object, "width", json_integer(features.width));
    json_object_set_new(object, "features", json_string(features_kind(features.width)));
    json_object_set_new(object, "uses", json_pack("[s, s]", "render --audio", "train --audio"));
  }
  ern_features_free(session->context, &features);
  return session_report(session, object);
}

static int describe_poses(struct session *session, const char *path) {
  ern_pose_list list = {0};
  if (ern_pose_list_load(session->context, path, &list) != ERN_OK) return session_fail(session);
  if (!session_json_on_stdout(session))
    printf(
        "%s: poses\n  frames           %zu\n  picture          %d x %d\n  focal length     %g\n  centre           %g, "
        "%g\n",
        path, list.count, list.width, list.height, list.focal, list.cx, list.cy);
  json_t *object = json_pack("{s:o, s:s, s:I, s:i, s:i, s:f, s:f, s:f}", "file", session_text(path), "kind", "poses",
                             "frames", (json_int_t)list.count, "width", list.width, "height", list.height, "focal",
                             list.focal, "cx", list.cx, "cy", list.cy);
  ern_pose_list_free(session->context, &list);
  return session_report(session, object);
}

static int describe(struct session *session, const char *path) {
  static const struct {
    const char *ending;
    int (*run)(struct session *session, const char *path);
  } kinds[] = {{".safetensors", describe_model},
               {".pth", describe_model},
               {".pt", describe_model},
               {".npy", describe_array},
               {".json", describe_poses}};
  const char *dot = strrchr(path, '.');
  if (strcmp(path, "devices") == 0) return list_devices(session);
  for (size_t i = 0; dot != NULL && i < sizeof kinds / sizeof kinds[0]; i++)
    if (strcmp(dot, kinds[i].ending) == 0) return kinds[i].run(session, path);
  return session_fail_with(
      session,
      "%s: of an unknown kind, expected .safetensors or .pth (a model), .npy (speech features) or .json "
      "(poses); `ernerf check` examines the folder of a clip",
      path);
}

int cmd_info(int argc, char **argv) {
  struct session session = {0};
  const char *path = NULL;
  struct option output[SESSION_OUTPUT_OPTIONS];
  struct option tuning[] = {
      {ARGS_FLAG("tune", &session.tune),
       .help = "measure which sizes of work-groups and tiles suit the device, for two minutes at most, and keep the "
               "result for later runs; a GPU is also measured when it is first used"},
      {ARGS_INT("device", &session.device, 0, 255), .help = "number of the OpenCL device (default 0)"}};
  struct word words[] = {{"FILE", &path, "a .safetensors, .pth, .npy or .json file, or the word devices"}};
  struct args args = {
      .verb = "info",
      .summary = "Lists what is in a model, a feature or a pose file, or the devices that can compute.",
      .usage = "info FILE\ninfo devices [--tune [--device N]]",
      .words = words,
      .word_count = 1,
      .groups = {{"Devices:", tuning, sizeof tuning / sizeof *tuning}, {"Output:", output, SESSION_OUTPUT_OPTIONS}}};
  session_output_options(&session, output);
  int status = args_parse(&args, argc, argv);
  if (status < 0 && strcmp(path, "devices") != 0) status = args_forbid(&args, "tune device", "is for `info devices`");
  if (status < 0 && !session.tune) status = args_forbid(&args, "device", "needs --tune");
  if (session.tune) session.backend_choice = SESSION_OPENCL;
  session.inputs[0] = path;
  if (status < 0) status = session_open(&session, &args);
  if (status >= 0) return status;
  status = session.tune ? tune_device(&session) : describe(&session, path);
  session_close(&session);
  return status;
}
