/* SPDX-License-Identifier: MIT
 * A device that fails on demand: an OpenCL layer (the loader takes it from OPENCL_LAYERS) between a program and its
 * driver, steered by the environment:
 *
 *   ERNERF_FAULT_HIDE=platforms|devices  none of them is there
 *   ERNERF_FAULT_GPU=1                   a device says that it is a GPU
 *   ERNERF_FAULT_STRANGER=1              the platform's version does not tell which driver it is
 *   ERNERF_FAULT_BUILD=N                 no program builds from source; the log has N lines
 *   ERNERF_FAULT_MEMORY=BYTES            all the memory of the device; a buffer may have half of it
 *   ERNERF_FAULT_LAUNCH=N                launch number N (from 1, and since N changed) fails, and then
 *   ERNERF_FAULT_COUNT=C                 so do launches up to C in all; without it the device is lost: nothing works
 *   ERNERF_FAULT_FILE=PATH               lost as soon as this file is there
 *   ERNERF_FAULT_FIRST_USE=1             memory that is lacking is refused by the first fill instead of at creation
 *   ERNERF_FAULT_PINNED=1                no buffer may be in pinned host memory
 *   ERNERF_FAULT_FILL=BYTES              a fill of so many bytes loses the device, as 2 GiB do with NVIDIA's driver
 *   ERNERF_FAULT_LOCAL=BYTES             local memory of a group; a kernel that has more is not launched
 *   ERNERF_FAULT_GROUP=ITEMS             most items of a group; a larger one is not launched
 *   ERNERF_FAULT_ARGUMENTS=BYTES         most bytes of a kernel's arguments; a kernel that has more is not launched
 *   ERNERF_FAULT_OPTIONS=1               division is not correctly rounded, and no build option is known but -D and
 *                                        -cl-std=CL1.2
 *   ERNERF_FAULT_TIMES=1                 events have no times
 *   ERNERF_FAULT_FLOAT_ADD=2|3           the device has cl_ext_float_atomics, or is AMD's and its compiler has the
 * builtin for additions to floats (as ern_cl_float_add counts); a program that swaps in a loop does not build. -2, -3:
 * it is announced alone ERNERF_FAULT_CODE=-5                 what the calls return; without it CL_DEVICE_NOT_AVAILABLE
 */
#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>
#include <CL/cl_layer.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { LOG_BYTES = 1 << 16 };

static const cl_icd_dispatch *driver; /* the next layer, or the loader's way to a driver */
static cl_icd_dispatch layer;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER; /* of what follows */
static unsigned long long launches, bytes_taken;
static long long launch_fails; /* ERNERF_FAULT_LAUNCH when last looked at */
static bool lost;

static long long number_of(const char *name, long long otherwise) {
  const char *value = getenv(name);
  return value != NULL && value[0] != 0 ? strtoll(value, NULL, 10) : otherwise;
}
static bool hides(const char *what) {
  const char *value = getenv("ERNERF_FAULT_HIDE");
  return value != NULL && strcmp(value, what) == 0;
}
static cl_int fault_code(void) { return (cl_int)number_of("ERNERF_FAULT_CODE", CL_DEVICE_NOT_AVAILABLE); }

/* CL_SUCCESS, or what a call returns now; `launched`: it is a launch. */
static cl_int look(bool launched) {
  const char *file = getenv("ERNERF_FAULT_FILE");
  const long long first = number_of("ERNERF_FAULT_LAUNCH", 0), count = number_of("ERNERF_FAULT_COUNT", 0);
  bool fails = false;
  pthread_mutex_lock(&lock);
  if (first != launch_fails) {
    launch_fails = first;
    launches = 0;
    lost = false;
  }
  if (launched) launches++;
  if (file != NULL && access(file, F_OK) == 0) lost = true;
  if (first > 0 && launches >= (unsigned long long)first) {
    if (count == 0)
      lost = true;
    else
      fails = launched && launches < (unsigned long long)(first + count);
  }
  fails |= lost;
  pthread_mutex_unlock(&lock);
  return fails ? fault_code() : CL_SUCCESS;
}

/* ---- platforms and devices --------------------------------------------------------------------------------------- */

static cl_int CL_API_CALL get_platforms(cl_uint entries, cl_platform_id *platforms, cl_uint *count) {
  if (!hides("platforms")) return driver->clGetPlatformIDs(entries, platforms, count);
  if (count != NULL) *count = 0;
  return -1001; /* CL_PLATFORM_NOT_FOUND_KHR */
}

static cl_int CL_API_CALL get_devices(cl_platform_id platform, cl_device_type type, cl_uint entries,
                                      cl_device_id *devices, cl_uint *count) {
  if (!hides("devices")) return driver->clGetDeviceIDs(platform, type, entries, devices, count);
  if (count != NULL) *count = 0;
  return CL_DEVICE_NOT_FOUND;
}

static cl_int CL_API_CALL get_platform_info(cl_platform_id platform, cl_platform_info what, size_t bytes, void *value,
                                            size_t *needed) {
  static const char stranger[] = "OpenCL 1.2 of a driver that nobody knows";
  if (what != CL_PLATFORM_VERSION || number_of("ERNERF_FAULT_STRANGER", 0) == 0)
    return driver->clGetPlatformInfo(platform, what, bytes, value, needed);
  if (needed != NULL) *needed = sizeof stranger;
  if (value == NULL) return CL_SUCCESS;
  if (bytes < sizeof stranger) return CL_INVALID_VALUE;
  memcpy(value, stranger, sizeof stranger);
  return CL_SUCCESS;
}

/* 0: none */
static cl_ulong limit_of(cl_device_info what) {
  switch (what) {
    case CL_DEVICE_GLOBAL_MEM_SIZE: return (cl_ulong)number_of("ERNERF_FAULT_MEMORY", 0);
    case CL_DEVICE_MAX_MEM_ALLOC_SIZE: return (cl_ulong)number_of("ERNERF_FAULT_MEMORY", 0) / 2;
    case CL_DEVICE_LOCAL_MEM_SIZE: return (cl_ulong)number_of("ERNERF_FAULT_LOCAL", 0);
    case CL_DEVICE_MAX_WORK_GROUP_SIZE: return (cl_ulong)number_of("ERNERF_FAULT_GROUP", 0);
    case CL_DEVICE_MAX_PARAMETER_SIZE: return (cl_ulong)number_of("ERNERF_FAULT_ARGUMENTS", 0);
    default: return 0;
  }
}

enum { SINGLE_FP_ATOMIC_CAPABILITIES = 0x4231, GLOBAL_FP_ATOMIC_ADD = 1 << 1 }; /* of cl_ext_float_atomics */

static cl_int CL_API_CALL get_device_info(cl_device_id device, cl_device_info what, size_t bytes, void *value,
                                          size_t *needed) {
  const long long float_add = llabs(number_of("ERNERF_FAULT_FLOAT_ADD", 0));
  const cl_bitfield adds = GLOBAL_FP_ATOMIC_ADD;
  if (what == SINGLE_FP_ATOMIC_CAPABILITIES && float_add == 2 && bytes == sizeof adds) {
    memcpy(value, &adds, sizeof adds);
    return CL_SUCCESS;
  }
  const cl_int code = driver->clGetDeviceInfo(device, what, bytes, value, needed);
  const cl_ulong limit = limit_of(what);
  cl_ulong found = 0; /* a size_t has as many bytes */
  if (code != CL_SUCCESS || value == NULL || bytes < sizeof found) return code;
  memcpy(&found, value, sizeof found);
  if (what == CL_DEVICE_SINGLE_FP_CONFIG && number_of("ERNERF_FAULT_OPTIONS", 0) > 0)
    found &= ~(cl_ulong)CL_FP_CORRECTLY_ROUNDED_DIVIDE_SQRT;
  if (what == CL_DEVICE_TYPE && number_of("ERNERF_FAULT_GPU", 0) > 0) found = CL_DEVICE_TYPE_GPU;
  if (limit > 0 && found > limit) found = limit;
  memcpy(value, &found, sizeof found);
  if (what == CL_DEVICE_EXTENSIONS && float_add > 0)
    snprintf((char *)value + strlen(value), bytes - strlen(value), " %s",
             float_add == 2 ? "cl_ext_float_atomics" : "cl_amd_device_attribute_query");
  return CL_SUCCESS;
}

/* ---- memory ------------------------------------------------------------------------------------------------------ */

static void give_back(size_t bytes) {
  pthread_mutex_lock(&lock);
  bytes_taken -= bytes;
  pthread_mutex_unlock(&lock);
}

static cl_mem CL_API_CALL create_buffer(cl_context context, cl_mem_flags flags, size_t bytes, void *host,
                                        cl_int *code) {
  const unsigned long long limit = (unsigned long long)number_of("ERNERF_FAULT_MEMORY", 0);
  cl_int found = look(false), ignored = CL_SUCCESS;
  if (code == NULL) code = &ignored;
  pthread_mutex_lock(&lock);
  if (found == CL_SUCCESS && limit > 0 && bytes_taken + bytes > limit && number_of("ERNERF_FAULT_FIRST_USE", 0) == 0)
    found = CL_MEM_OBJECT_ALLOCATION_FAILURE;
  if (found == CL_SUCCESS && (flags & CL_MEM_ALLOC_HOST_PTR) != 0 && number_of("ERNERF_FAULT_PINNED", 0) > 0)
    found = CL_OUT_OF_HOST_MEMORY;
  if (found == CL_SUCCESS) bytes_taken += bytes;
  pthread_mutex_unlock(&lock);
  *code = found;
  if (found != CL_SUCCESS) return NULL;
  const cl_mem memory = driver->clCreateBuffer(context, flags, bytes, host, code);
  if (*code != CL_SUCCESS) give_back(bytes);
  return memory;
}

/* What the program lets go is free at once, though drivers may hold it for a moment longer; it retains nothing twice.
 */
static cl_int CL_API_CALL release_memory(cl_mem memory) {
  size_t bytes = 0;
  if (driver->clGetMemObjectInfo(memory, CL_MEM_SIZE, sizeof bytes, &bytes, NULL) == CL_SUCCESS) give_back(bytes);
  return driver->clReleaseMemObject(memory);
}

/* ---- programs ---------------------------------------------------------------------------------------------------- */

/* Before a source: a compiler that has one of the two additions, and no other way to swap. */
static const char float_adds[] =
    "static inline void faults_add(volatile global uint *at, float value) {\n"
    "  uint before = atomic_or(at, 0), found;\n"
    "  while ((found = atomic_cmpxchg(at, before, as_uint(as_float(before) + value))) != before) before = found;\n"
    "}\n"
    "#define atomic_cmpxchg(...) swaps_in_a_loop\n"
    "#if __OPENCL_C_VERSION__ >= 300\n"
    "#define atomic_fetch_add_explicit(at, value, order) \\\n"
    "  faults_add((volatile global uint *)(at), order == memory_order_relaxed ? (value) : NAN)\n"
    "#else\n"
    "#define __builtin_amdgcn_global_atomic_fadd_f32(at, value) faults_add((volatile global uint *)(at), value)\n"
    "#endif\n";

static cl_program CL_API_CALL create_program(cl_context context, cl_uint count, const char **texts, const size_t *bytes,
                                             cl_int *code) {
  enum { MOST = 8 };
  const char *text[MOST + 1] = {float_adds};
  size_t length[MOST + 1] = {sizeof float_adds - 1};
  if (number_of("ERNERF_FAULT_FLOAT_ADD", 0) <= 0 || count > MOST || bytes == NULL)
    return driver->clCreateProgramWithSource(context, count, texts, bytes, code);
  memcpy(text + 1, texts, count * sizeof *text);
  memcpy(length + 1, bytes, count * sizeof *length);
  return driver->clCreateProgramWithSource(context, count + 1, text, length, code);
}

/* Whether the options are of those that every driver knows. */
static bool are_known(const char *options) {
  char text[LOG_BYTES], *rest = NULL;
  snprintf(text, sizeof text, "%s", options != NULL ? options : "");
  for (char *word = strtok_r(text, " ", &rest); word != NULL; word = strtok_r(NULL, " ", &rest)) {
    if (strcmp(word, "-D") == 0 && strtok_r(NULL, " ", &rest) != NULL) continue;
    if (strcmp(word, "-cl-std=CL1.2") != 0) return false;
  }
  return true;
}

static cl_int CL_API_CALL build(cl_program program, cl_uint count, const cl_device_id *devices, const char *options,
                                void(CL_CALLBACK *done)(cl_program, void *), void *user) {
  size_t source = 0; /* bytes; one made from a binary has none */
  const bool known = driver->clGetProgramInfo(program, CL_PROGRAM_SOURCE, 0, NULL, &source) == CL_SUCCESS;
  if (number_of("ERNERF_FAULT_BUILD", 0) > 0 && known && source > 1) return CL_BUILD_PROGRAM_FAILURE;
  if (number_of("ERNERF_FAULT_OPTIONS", 0) > 0 && !are_known(options)) return CL_INVALID_BUILD_OPTIONS;
  return driver->clBuildProgram(program, count, devices, options, done, user);
}

static cl_int CL_API_CALL get_build_info(cl_program program, cl_device_id device, cl_program_build_info what,
                                         size_t bytes, void *value, size_t *needed) {
  static char text[LOG_BYTES];
  const long long lines = number_of("ERNERF_FAULT_BUILD", 0);
  size_t used = 0;
  if (what != CL_PROGRAM_BUILD_LOG || lines <= 0)
    return driver->clGetProgramBuildInfo(program, device, what, bytes, value, needed);
  pthread_mutex_lock(&lock);
  for (long long i = 1; i <= lines && used < sizeof text - 100; i++)
    used += (size_t)snprintf(text + used, sizeof text - used, "<source>:%lld:1: error: it was told to fail\n", i);
  if (needed != NULL) *needed = used + 1;
  if (value != NULL && bytes > used) memcpy(value, text, used + 1);
  pthread_mutex_unlock(&lock);
  return value == NULL || bytes > used ? CL_SUCCESS : CL_INVALID_VALUE;
}

/* ---- commands ---------------------------------------------------------------------------------------------------- */

static _Thread_local size_t
    argument_bytes; /* of the arguments set since the last first one: libernerf sets all in a row */

static cl_int CL_API_CALL set_argument(cl_kernel kernel, cl_uint index, size_t bytes, const void *value) {
  argument_bytes = (index > 0 ? argument_bytes : 0) + (value == NULL ? sizeof(cl_ulong) : bytes); /* NULL: a pointer */
  return driver->clSetKernelArg(kernel, index, bytes, value);
}

/* CL_SUCCESS, or what a device returns whose limits the launch exceeds. */
static cl_int launch_fits(cl_command_queue queue, cl_kernel kernel, const size_t *local) {
  const unsigned long long local_most = (unsigned long long)number_of("ERNERF_FAULT_LOCAL", 0),
                           group_most = (unsigned long long)number_of("ERNERF_FAULT_GROUP", 0),
                           argument_most = (unsigned long long)number_of("ERNERF_FAULT_ARGUMENTS", 0);
  cl_device_id device = NULL;
  cl_ulong bytes = 0;
  if (argument_most > 0 && argument_bytes > argument_most) return CL_OUT_OF_RESOURCES;
  if (group_most > 0 && local != NULL && *local > group_most) return CL_INVALID_WORK_GROUP_SIZE;
  if (local_most == 0) return CL_SUCCESS;
  cl_int code = driver->clGetCommandQueueInfo(queue, CL_QUEUE_DEVICE, sizeof device, &device, NULL);
  if (code == CL_SUCCESS)
    code = driver->clGetKernelWorkGroupInfo(kernel, device, CL_KERNEL_LOCAL_MEM_SIZE, sizeof bytes, &bytes, NULL);
  return code == CL_SUCCESS && bytes > local_most ? CL_OUT_OF_RESOURCES : code;
}

static cl_int CL_API_CALL launch(cl_command_queue queue, cl_kernel kernel, cl_uint dimensions, const size_t *offset,
                                 const size_t *global, const size_t *local, cl_uint waits, const cl_event *wait,
                                 cl_event *event) {
  cl_int code = look(true);
  if (code == CL_SUCCESS) code = launch_fits(queue, kernel, local);
  if (code != CL_SUCCESS) return code;
  return driver->clEnqueueNDRangeKernel(queue, kernel, dimensions, offset, global, local, waits, wait, event);
}

static cl_int CL_API_CALL read_buffer(cl_command_queue queue, cl_mem memory, cl_bool blocking, size_t offset,
                                      size_t bytes, void *to, cl_uint waits, const cl_event *wait, cl_event *event) {
  const cl_int code = look(false);
  if (code != CL_SUCCESS) return code;
  return driver->clEnqueueReadBuffer(queue, memory, blocking, offset, bytes, to, waits, wait, event);
}

static cl_int CL_API_CALL write_buffer(cl_command_queue queue, cl_mem memory, cl_bool blocking, size_t offset,
                                       size_t bytes, const void *from, cl_uint waits, const cl_event *wait,
                                       cl_event *event) {
  const cl_int code = look(false);
  if (code != CL_SUCCESS) return code;
  return driver->clEnqueueWriteBuffer(queue, memory, blocking, offset, bytes, from, waits, wait, event);
}

static cl_int CL_API_CALL copy_buffer(cl_command_queue queue, cl_mem from, cl_mem to, size_t from_offset,
                                      size_t to_offset, size_t bytes, cl_uint waits, const cl_event *wait,
                                      cl_event *event) {
  const cl_int code = look(false);
  if (code != CL_SUCCESS) return code;
  return driver->clEnqueueCopyBuffer(queue, from, to, from_offset, to_offset, bytes, waits, wait, event);
}

static cl_int CL_API_CALL fill_buffer(cl_command_queue queue, cl_mem memory, const void *pattern, size_t pattern_bytes,
                                      size_t offset, size_t bytes, cl_uint waits, const cl_event *wait,
                                      cl_event *event) {
  const long long most = number_of("ERNERF_FAULT_FILL", 0);
  const bool first_use = number_of("ERNERF_FAULT_FIRST_USE", 0) > 0;
  cl_int code = look(false);
  pthread_mutex_lock(&lock);
  if (code == CL_SUCCESS && first_use && bytes_taken > (unsigned long long)number_of("ERNERF_FAULT_MEMORY", 0))
    code = CL_MEM_OBJECT_ALLOCATION_FAILURE;
  pthread_mutex_unlock(&lock);
  if (code != CL_SUCCESS) return code;
  if (most > 0 && bytes >= (size_t)most) {
    pthread_mutex_lock(&lock);
    lost = true;
    pthread_mutex_unlock(&lock);
    return CL_SUCCESS; /* the next call fails */
  }
  return driver->clEnqueueFillBuffer(queue, memory, pattern, pattern_bytes, offset, bytes, waits, wait, event);
}

static cl_int CL_API_CALL get_time(cl_event event, cl_profiling_info what, size_t bytes, void *value, size_t *needed) {
  if (number_of("ERNERF_FAULT_TIMES", 0) > 0) return CL_PROFILING_INFO_NOT_AVAILABLE;
  return driver->clGetEventProfilingInfo(event, what, bytes, value, needed);
}

static cl_int CL_API_CALL finish(cl_command_queue queue) {
  const cl_int code = look(false);
  return code != CL_SUCCESS ? code : driver->clFinish(queue);
}

/* ---- the layer --------------------------------------------------------------------------------------------------- */

CL_API_ENTRY cl_int CL_API_CALL clGetLayerInfo(cl_layer_info what, size_t bytes, void *value, size_t *needed) {
  static const char name[] = "libernerf's faults";
  const cl_layer_api_version version = CL_LAYER_API_VERSION_100;
  const void *from = what == CL_LAYER_API_VERSION ? (const void *)&version : (const void *)name;
  const size_t size = what == CL_LAYER_API_VERSION ? sizeof version : sizeof name;
  if (what != CL_LAYER_API_VERSION && what != CL_LAYER_NAME) return CL_INVALID_VALUE;
  if (value != NULL && bytes < size) return CL_INVALID_VALUE;
  if (value != NULL) memcpy(value, from, size);
  if (needed != NULL) *needed = size;
  return CL_SUCCESS;
}

/* The loader's table may be shorter than ours: entries past its end stay empty. */
CL_API_ENTRY cl_int CL_API_CALL clInitLayer(cl_uint entries, const cl_icd_dispatch *target, cl_uint *entries_here,
                                            const cl_icd_dispatch **table) {
  const size_t known = (size_t)entries * sizeof(void *);
  if (target == NULL || entries_here == NULL || table == NULL) return CL_INVALID_VALUE;
  memcpy(&layer, target, known < sizeof layer ? known : sizeof layer);
  driver = target;
  layer.clGetPlatformIDs = get_platforms;
  layer.clGetDeviceIDs = get_devices;
  layer.clGetPlatformInfo = get_platform_info;
  layer.clGetDeviceInfo = get_device_info;
  layer.clCreateBuffer = create_buffer;
  layer.clReleaseMemObject = release_memory;
  layer.clCreateProgramWithSource = create_program;
  layer.clBuildProgram = build;
  layer.clGetProgramBuildInfo = get_build_info;
  layer.clSetKernelArg = set_argument;
  layer.clEnqueueNDRangeKernel = launch;
  layer.clEnqueueReadBuffer = read_buffer;
  layer.clEnqueueWriteBuffer = write_buffer;
  layer.clEnqueueCopyBuffer = copy_buffer;
  layer.clEnqueueFillBuffer = fill_buffer;
  layer.clGetEventProfilingInfo = get_time;
  layer.clFinish = finish;
  *entries_here = (cl_uint)(sizeof layer / sizeof(void *));
  *table = &layer;
  return CL_SUCCESS;
}
