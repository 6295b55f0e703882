/* SPDX-License-Identifier: MIT
 * Programs: built from embedded sources for one device, or loaded from the user's cache of binaries; for a driver with
 * its own cache (keeps_kernels), always built. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "backend_opencl/device/buffer.h"
#include "backend_opencl/device/cache.h"
#include "backend_opencl/device/kernel_sources.h"
#include "backend_opencl/device/limits.h"
#include "backend_opencl/device/program.h"
#include "core/memory.h"
#include "io/file.h"

enum { OPTION_BYTES = 4096, LOG_BYTES = 1500 /* an error text has 2048 */ };

static const struct {
  const char *name;
  const unsigned char *text;
  const size_t *bytes;
} sources[] = {
#define ENTRY(source) {#source ".cl", ern_cl_text_##source, &ern_cl_bytes_##source},
    ERN_CL_SOURCES(ENTRY)
#undef ENTRY
};

/* The sources of a program: common.cl; tensor.cl where tensor cores may be used; tile.cl for the fused passes,
 * samples.cl for kernels over samples, float_add.cl for the grids; the source itself. */
enum { TEXTS = 4 };
static void texts_of(ern_cl_source source, const char *text[TEXTS], size_t bytes[TEXTS]) {
  const bool fused = source == ERN_CL_render || source == ERN_CL_render_torso,
             samples = source == ERN_CL_activation || source == ERN_CL_attention || source == ERN_CL_encoding;
  text[0] = (const char *)ern_cl_text_common, bytes[0] = ern_cl_bytes_common;
  text[1] = (const char *)ern_cl_text_tensor, bytes[1] = fused || source == ERN_CL_mlp ? ern_cl_bytes_tensor : 0;
  const bool grids = source == ERN_CL_hashgrid;
  text[2] = (const char *)(fused ? ern_cl_text_tile : grids ? ern_cl_text_float_add : ern_cl_text_samples);
  bytes[2] = fused ? ern_cl_bytes_tile : grids ? ern_cl_bytes_float_add : samples ? ern_cl_bytes_samples : 0;
  text[3] = (const char *)sources[source].text, bytes[3] = *sources[source].bytes;
}

void ern_cl_base_options(const struct ern_cl_device *device, ern_cl_source source, char *text, size_t bytes) {
  const ern_cl_float_add way = source == ERN_CL_hashgrid ? device->float_add : ERN_CL_FLOAT_ADD_LOOP;
  snprintf(text, bytes, "-cl-std=%s%s -D WIDTH=%d -D CPU=%d -D NVIDIA=%d", ern_cl_float_add_standard(way),
           device->exact_divide ? " -cl-fp32-correctly-rounded-divide-sqrt" : "", device->width, device->cpu,
           device->nvidia);
}

ern_status ern_cl_program_key(ern_context *context, const struct ern_cl_device *device, ern_cl_source source,
                              const char *options, char key[ERN_CL_KEY_BYTES]) {
  char head[OPTION_BYTES];
  char *all = NULL;
  const int length = snprintf(head, sizeof head, "libernerf %s|%s|%s|%s|%s|%s|", ern_version(), device->name,
                              device->version, device->driver, device->platform_version, options);
  if (length < 0 || (size_t)length >= sizeof head)
    return ern_fail(context, ERN_E_ARGUMENT, "OpenCL: options of %s are too long", sources[source].name);
  const char *text[TEXTS];
  size_t bytes[TEXTS], at = (size_t)length;
  texts_of(source, text, bytes);
  const ern_status status = ERN_NEW(context, at + bytes[0] + bytes[1] + bytes[2] + bytes[3], &all);
  if (status != ERN_OK) return status;
  memcpy(all, head, at);
  for (size_t i = 0; i < TEXTS; at += bytes[i++]) memcpy(all + at, text[i], bytes[i]);
  ern_sha256_hex(all, at, key);
  ern_release(context, all);
  return ERN_OK;
}

/* Reports the end of the build log, where compilers write the final error. */
static ern_status build_failed(struct ern_cl_backend *backend, ern_cl_source source, cl_program program, cl_int code) {
  char *log = NULL;
  size_t bytes = 0;
  if (clGetProgramBuildInfo(program, backend->device.id, CL_PROGRAM_BUILD_LOG, 0, NULL, &bytes) == CL_SUCCESS &&
      ERN_NEW(backend->table.context, bytes + 1, &log) == ERN_OK) {
    if (clGetProgramBuildInfo(program, backend->device.id, CL_PROGRAM_BUILD_LOG, bytes, log, NULL) != CL_SUCCESS)
      log[0] = 0;
  }
  const size_t length = log != NULL ? strlen(log) : 0;
  const ern_status status =
      ern_fail(backend->table.context, ERN_E_DEVICE, "OpenCL: %s does not build %s: %s; its log: %s",
               backend->device.name, sources[source].name, ern_cl_error_name(code),
               length == 0          ? "(empty)"
               : length > LOG_BYTES ? log + length - LOG_BYTES
                                    : log);
  ern_release(backend->table.context, log);
  return status;
}

/* NULL where the cache has no binary that this driver accepts. */
static cl_program from_cache(struct ern_cl_backend *backend, const char *key, const char *options) {
  uint8_t *bytes = NULL;
  size_t count = 0;
  cl_int code = CL_SUCCESS, fit = CL_SUCCESS;
  ern_cl_cache_read(backend->table.context, key, &bytes, &count);
  if (bytes == NULL) return NULL;
  const unsigned char *binary = bytes;
  cl_program program =
      clCreateProgramWithBinary(backend->context, 1, &backend->device.id, &count, &binary, &fit, &code);
  if (code == CL_SUCCESS) code = fit;
  if (code == CL_SUCCESS) code = clBuildProgram(program, 1, &backend->device.id, options, NULL, NULL);
  if (code != CL_SUCCESS && program != NULL) {
    clReleaseProgram(program);
    program = NULL;
  }
  ern_release(backend->table.context, bytes);
  return code == CL_SUCCESS ? program : NULL;
}

static void to_cache(struct ern_cl_backend *backend, const char *key, cl_program program) {
  size_t bytes = 0;
  unsigned char *binary = NULL;
  if (clGetProgramInfo(program, CL_PROGRAM_BINARY_SIZES, sizeof bytes, &bytes, NULL) != CL_SUCCESS || bytes == 0)
    return;
  if (ERN_NEW(backend->table.context, bytes, &binary) != ERN_OK) return;
  if (clGetProgramInfo(program, CL_PROGRAM_BINARIES, sizeof binary, &binary, NULL) == CL_SUCCESS)
    ern_cl_cache_write(backend->table.context, key, binary, bytes);
  ern_release(backend->table.context, binary);
}

static ern_status from_source(struct ern_cl_backend *backend, ern_cl_source source, const char *options,
                              cl_program *program) {
  const char *all[TEXTS], *text[TEXTS];
  size_t sizes[TEXTS], bytes[TEXTS];
  cl_uint count = 0; /* of the sources that are not empty: OpenCL takes a length of 0 for a string that ends with a 0 */
  cl_int code = CL_SUCCESS;
  texts_of(source, all, sizes);
  for (size_t i = 0; i < TEXTS; i++)
    if (sizes[i] > 0) text[count] = all[i], bytes[count++] = sizes[i];
  *program = clCreateProgramWithSource(backend->context, count, text, bytes, &code);
  if (code != CL_SUCCESS) return ern_cl_check(backend, code, sources[source].name);
  code = clBuildProgram(*program, 1, &backend->device.id, options, NULL, NULL);
  if (code == CL_SUCCESS) return ERN_OK;
  const ern_status status = build_failed(backend, source, *program, code);
  clReleaseProgram(*program);
  *program = NULL;
  return status;
}

static ern_status keep(struct ern_cl_backend *backend, ern_cl_source source, const char *options, cl_program program) {
  ern_context *context = backend->table.context;
  if (backend->program_count == backend->program_capacity) {
    const size_t capacity = backend->program_capacity > 0 ? 2 * backend->program_capacity : 32;
    struct ern_cl_program *grown = NULL;
    const ern_status status = ERN_NEW(context, capacity, &grown);
    if (status != ERN_OK) return status;
    if (backend->program_count > 0)
      memcpy(grown, backend->programs, backend->program_count * sizeof *backend->programs);
    ern_release(context, backend->programs);
    backend->programs = grown;
    backend->program_capacity = capacity;
  }
  struct ern_cl_program *entry = &backend->programs[backend->program_count];
  *entry = (struct ern_cl_program){.source = source, .program = program};
  const ern_status status = ern_string_copy(context, options, &entry->options);
  if (status == ERN_OK) backend->program_count++;
  return status;
}

/* all: the base options and the program's own; key: of its binary */
static ern_status identify(ern_context *context, const struct ern_cl_device *device, ern_cl_source source,
                           const char *options, char all[OPTION_BYTES], char key[ERN_CL_KEY_BYTES]) {
  ern_cl_base_options(device, source, all, OPTION_BYTES);
  const size_t base = strlen(all);
  const int more = snprintf(all + base, OPTION_BYTES - base, " %s", options);
  if (more < 0 || (size_t)more >= OPTION_BYTES - base)
    return ern_fail(context, ERN_E_ARGUMENT, "OpenCL: options of %s are too long", sources[source].name);
  return ern_cl_program_key(context, device, source, all, key);
}

bool ern_cl_programs_kept(ern_context *context, const struct ern_cl_device *device) {
  static const ern_cl_source first[] = {ERN_CL_portrait, ERN_CL_march}; /* of any frame, of any training */
  char all[OPTION_BYTES], key[ERN_CL_KEY_BYTES];
  uint8_t *bytes = NULL;
  size_t count = 0;
  for (size_t i = 0; i < sizeof first / sizeof *first && bytes == NULL; i++)
    if (identify(context, device, first[i], "", all, key) == ERN_OK) ern_cl_cache_read(context, key, &bytes, &count);
  ern_release(context, bytes);
  return bytes != NULL;
}

static ern_status make(struct ern_cl_backend *backend, ern_cl_source source, const char *options, cl_program *program) {
  char all[OPTION_BYTES], key[ERN_CL_KEY_BYTES];
  ern_status status = ERN_OK;
  if (!ern_cl_memory_is_free(ERN_CL_LIMIT_host_bytes))
    ERN_TRY(ern_fail(backend->table.context, ERN_E_NO_MEMORY,
                     "OpenCL: %s: no memory to compile %s; expected %d MiB of addresses that are free (ulimit -v, -d)",
                     backend->device.name, sources[source].name, ERN_CL_LIMIT_host_bytes >> 20));
  ERN_TRY(identify(backend->table.context, &backend->device, source, options, all, key));
  const bool cached = !backend->device.keeps_kernels;
  if (cached) *program = from_cache(backend, key, all);
  if (*program == NULL) {
    ern_log(backend->table.context, ERN_LOG_DEBUG, "OpenCL: building %s", sources[source].name);
    ERN_TRY(from_source(backend, source, all, program));
    if (cached) to_cache(backend, key, *program);
  }
  ERN_TRY(keep(backend, source, options, *program));
  return ERN_OK;
fail:
  if (*program != NULL) clReleaseProgram(*program);
  *program = NULL;
  return status;
}

ern_status ern_cl_program_get(struct ern_cl_backend *backend, ern_cl_source source, const char *options,
                              cl_program *program) {
  ern_status status = ERN_OK;
  *program = NULL;
  if (pthread_mutex_lock(&backend->lock) != 0)
    return ern_fail(backend->table.context, ERN_E_STATE, "OpenCL: the lock of the programs failed");
  for (size_t i = 0; i < backend->program_count && *program == NULL; i++) {
    const struct ern_cl_program *known = &backend->programs[i];
    if (known->source == source && strcmp(known->options, options) == 0) *program = known->program;
  }
  if (*program == NULL) status = make(backend, source, options, program);
  pthread_mutex_unlock(&backend->lock);
  return status;
}

void ern_cl_programs_free(struct ern_cl_backend *backend) {
  for (size_t i = 0; i < backend->program_count; i++) {
    clReleaseProgram(backend->programs[i].program);
    ern_release(backend->table.context, backend->programs[i].options);
  }
  ern_release(backend->table.context, backend->programs);
}
