/* SPDX-License-Identifier: MIT
 * An OpenCL device as a backend: its creation, its streams, and the work sizes of its kernels. */
#include "backend_opencl/backend_opencl.h"

#include "core/status.h"

#if defined(ERN_OPENCL)
#include "backend_opencl/device/probe.h"
#include "backend_opencl/device/program.h"
#include "backend_opencl/device/tune.h"
#include "backend_opencl/opencl.h"
#include "backend_opencl/render.h"
#include "core/memory.h"

/* ---- streams ----------------------------------------------------------------------------------------------------- */

static void stream_free(struct ern_stream *stream) {
  if (stream == NULL) return;
  struct ern_cl_stream *own = ern_cl_stream_of(stream);
  struct ern_backend *table = &own->owner->table;
  if (own->queue != NULL) clFinish(own->queue);
  ern_cl_staging_free(own);
  for (int i = 0; i < ERN_MARKS; i++)
    if (own->mark[i] != NULL) clReleaseEvent(own->mark[i]);
  ern_cl_portrait_free(own);
  for (size_t i = 0; i < own->kernel_count; i++) clReleaseKernel(own->kernels[i].kernel);
  ern_release(table->context, own->kernels);
  table->buffer_free(table, own->figures);
  ern_release(table->context, own->figures_host);
  ern_arena_free(stream->arena);
  if (own->queue != NULL) clReleaseCommandQueue(own->queue);
  ern_release(table->context, own);
}

static ern_status stream_make(struct ern_backend *table, int threads, struct ern_stream **stream) {
  struct ern_cl_backend *backend = (struct ern_cl_backend *)table;
  struct ern_cl_stream *made = NULL;
  ern_status status = ERN_OK;
  cl_int code = CL_SUCCESS;
  (void)threads; /* the driver decides */
  *stream = NULL;
  ERN_TRY(ERN_NEW(table->context, 1, &made));
  made->base.backend = table;
  made->owner = backend;
  made->queue = clCreateCommandQueue(backend->context, backend->device.id, CL_QUEUE_PROFILING_ENABLE, &code);
  ERN_TRY(ern_cl_check(backend, code, "make a queue"));
  ERN_TRY(ern_arena_make(table, &made->base.arena));
  *stream = &made->base;
  return ERN_OK;
fail:
  stream_free(made != NULL ? &made->base : NULL);
  return status;
}

/* ---- the backend ------------------------------------------------------------------------------------------------- */

static void backend_free(struct ern_backend *table) {
  if (table == NULL) return;
  struct ern_cl_backend *backend = (struct ern_cl_backend *)table;
  ern_cl_programs_free(backend);
  if (backend->probe != NULL) clReleaseMemObject(backend->probe);
  if (backend->queue != NULL) clReleaseCommandQueue(backend->queue);
  if (backend->context != NULL) clReleaseContext(backend->context);
  pthread_mutex_destroy(&backend->lock);
  ern_release(table->context, backend);
}

static void fill_table(struct ern_cl_backend *backend, bool deterministic) {
  struct ern_backend *table = &backend->table;
  table->name = "opencl";
  table->isa = backend->device.name;
  table->real_bytes = sizeof(float);
  table->deterministic = deterministic || backend->device.cpu;
  table->stream_make = stream_make;
  table->stream_free = stream_free;
  table->free = backend_free;
  table->mark = ern_cl_mark;
  table->marks_read = ern_cl_marks_read;
  ern_cl_fill_memory(table);
#define ERN_SLOT_FILL(name) table->name = ern_cl_##name;
  ERN_SLOTS(ERN_SLOT_FILL)
#undef ERN_SLOT_FILL
}

ern_status ern_cl_backend_open(ern_context *context, int number, bool deterministic, struct ern_cl_backend **backend) {
  struct ern_cl_backend *made = NULL;
  ern_status status = ERN_OK;
  cl_int code = CL_SUCCESS;
  *backend = NULL;
  ERN_TRY(ERN_NEW(context, 1, &made));
  made->table.context = context;
  if (pthread_mutex_init(&made->lock, NULL) != 0) {
    ern_release(context, made);
    return ern_fail(context, ERN_E_NO_MEMORY, "OpenCL: no lock can be made");
  }
  ERN_TRY(ern_cl_device_open(context, number, &made->device));
  const cl_context_properties properties[] = {CL_CONTEXT_PLATFORM, (cl_context_properties)made->device.platform, 0};
  made->context = clCreateContext(properties, 1, &made->device.id, NULL, NULL, &code);
  ERN_TRY(ern_cl_check(made, code, "open the device"));
  made->queue = clCreateCommandQueue(made->context, made->device.id, 0, &code);
  ERN_TRY(ern_cl_check(made, code, "make a queue"));
  made->probe = clCreateBuffer(made->context, CL_MEM_READ_WRITE, sizeof(cl_uint), NULL, &code);
  ERN_TRY(ern_cl_check(made, code, "make a buffer"));
  fill_table(made, deterministic);
  ern_cl_sizes_set(made);
  *backend = made;
  return ERN_OK;
fail:
  if (made != NULL) backend_free(&made->table);
  return status;
}

/* ---- sizes of kernels ---- */

static const double seconds_unasked = 20, seconds_asked = 120; /* including builds; the last build may exceed it */

/* On a separate backend, with which the programs and memory of the trials are freed. */
static void measure_now(struct ern_cl_backend *backend, int number, bool asked) {
  ern_context *context = backend->table.context;
  const double seconds = asked ? seconds_asked : seconds_unasked;
  struct ern_cl_backend *bench = NULL;
  ern_log(context, ERN_LOG_INFO, "OpenCL: measuring which sizes suit %s, for %g s at most, once", backend->device.name,
          seconds);
  ern_status status = ern_cl_backend_open(context, number, false, &bench);
  if (status == ERN_OK)
    status =
        ern_cl_measure(bench, asked ? ~0u : ern_cl_unknown_tunables(backend->measured), seconds, backend->measured);
  if (status != ERN_OK) ern_log_error(context, ERN_LOG_INFO, "OpenCL: measuring ended early: ");
  if (bench != NULL) bench->table.free(&bench->table);
  if (!ern_cl_tune_write(context, &backend->device, backend->measured))
    ern_log(context, ERN_LOG_INFO, "OpenCL: what was measured cannot be kept");
}

static void tune(struct ern_cl_backend *backend, int number, bool asked) {
  ern_context *context = backend->table.context;
  const struct ern_cl_device *device = &backend->device;
  struct ern_cl_measured *measured = backend->measured;
  char before[ERN_ERROR_BYTES];
  ern_error_keep(context, before);
  ern_cl_tune_read(context, device, measured);
  const bool wanted = asked || (!device->host && !ern_cl_is_tuned(measured));
  if (wanted && (ern_cl_tune_write(context, device, measured) || asked)) measure_now(backend, number, asked);
  ern_error_restore(context, before);
  ern_cl_sizes_set(backend);
}

ern_status ern_opencl_backend_make(ern_context *context, int number, bool deterministic, bool asked,
                                   ern_backend **backend) {
  struct ern_cl_backend *made = NULL;
  bool listed = false;
  int dead = 0;
  *backend = NULL;
  ern_status status = ern_cl_probe(context, number, number, &listed, &dead);
  if (status == ERN_OK) status = ern_cl_backend_open(context, number, deterministic, &made);
  if (status != ERN_OK) return status;
  tune(made, number, asked);
  *backend = &made->table;
  return ERN_OK;
}

void ern_opencl_tuning(const ern_backend *backend, void (*say)(void *user, const ern_tuning *tuning), void *user) {
  const struct ern_cl_backend *own = (const struct ern_cl_backend *)backend;
  for (ern_cl_tunable tunable = 0; tunable < ERN_CL_TUNABLE_COUNT; tunable++) {
    const struct ern_cl_measured *m = &own->measured[tunable];
    const ern_tuning tuning = {.name = ern_cl_tunable_name(tunable),
                               .standard = ern_cl_standard_size(&own->device, tunable),
                               .best = m->standard_ns > 0 ? m->best : 0,
                               .used = own->size[tunable],
                               .standard_seconds = 1e-9 * (double)m->standard_ns,
                               .best_seconds = 1e-9 * (double)m->best_ns};
    say(user, &tuning);
  }
}

/* ---- the devices ---- */

/* Probes all devices; false where not even listing them is safe. A device that cannot be used is a warning. */
static bool find_usable(ern_context *context, bool usable[ERN_CL_MAX_DEVICES]) {
  char before[ERN_ERROR_BYTES];
  bool listed = true;
  ern_error_keep(context, before);
  for (int i = 0; i < ERN_CL_MAX_DEVICES; i++) usable[i] = true;
  for (int first = 0, dead = 0; listed && first < ERN_CL_MAX_DEVICES; first = dead + 1) {
    if (ern_cl_probe(context, first, ERN_CL_MAX_DEVICES - 1, &listed, &dead) == ERN_OK) break;
    ern_log_error(context, ERN_LOG_WARNING, "");
    if (listed && dead >= first && dead < ERN_CL_MAX_DEVICES) usable[dead] = false;
    if (dead < first) break; /* an inconsistent answer */
  }
  ern_error_restore(context, before);
  return listed;
}

ern_status ern_opencl_devices_list(ern_context *context, void (*say)(void *, const ern_device_info *), void *user) {
  struct ern_cl_found found[ERN_CL_MAX_DEVICES];
  bool usable[ERN_CL_MAX_DEVICES];
  int platforms = 0;
  if (!find_usable(context, usable)) return ERN_OK;
  const int count = ern_cl_devices_find(found, &platforms);
  if (platforms == 0) ern_log(context, ERN_LOG_INFO, "OpenCL: no driver is installed");
  if (platforms > 0 && count == 0)
    ern_log(context, ERN_LOG_INFO, "OpenCL: %d driver%s installed, but none of them has a device", platforms,
            platforms == 1 ? " is" : "s are");
  for (int i = 0; i < count; i++) {
    if (!usable[i]) continue;
    struct ern_cl_device device = {.platform = found[i].platform, .id = found[i].device};
    ern_cl_device_query(&device);
    struct ern_cl_measured measured[ERN_CL_TUNABLE_COUNT];
    ern_cl_tune_read(context, &device, measured);
    const ern_device_info info = {.kind = "opencl",
                                  .number = i,
                                  .name = device.name,
                                  .version = device.version,
                                  .instruction_sets = "",
                                  .compute_units = device.units,
                                  .memory_bytes = device.memory_bytes,
                                  .driver = device.driver,
                                  .buffer_bytes = device.buffer_bytes,
                                  .local_bytes = device.local_bytes,
                                  .half = device.half,
                                  .subgroups = device.subgroups,
                                  .tuned = ern_cl_is_tuned(measured),
                                  .deterministic = device.cpu,
                                  .adds_floats = device.float_add != ERN_CL_FLOAT_ADD_LOOP,
                                  .tensor_cores = device.tensor,
                                  .kernels_kept = ern_cl_programs_kept(context, &device)};
    say(user, &info);
  }
  return ERN_OK;
}

#else
ern_status ern_opencl_devices_list(ern_context *context, void (*say)(void *, const ern_device_info *), void *user) {
  (void)say, (void)user;
  ern_log(context, ERN_LOG_INFO, "OpenCL: this build is without it");
  return ERN_OK;
}

ern_status ern_opencl_backend_make(ern_context *context, int number, bool deterministic, bool tune,
                                   ern_backend **backend) {
  (void)number, (void)deterministic, (void)tune;
  *backend = NULL;
  return ern_fail(context, ERN_E_UNSUPPORTED, "backend: this build is without OpenCL (ERNERF_OPENCL=OFF)");
}

void ern_opencl_tuning(const ern_backend *backend, void (*say)(void *user, const ern_tuning *tuning), void *user) {
  (void)backend, (void)say, (void)user;
}
#endif
