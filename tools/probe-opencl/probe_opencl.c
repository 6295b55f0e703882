/* SPDX-License-Identifier: MIT
 * Tests OpenCL devices for libernerf in a separate process, because some drivers crash the process that loads them.
 *
 *   ernerf-probe-opencl FIRST LAST
 *
 * lists all devices, then builds and runs a kernel on those with the numbers FIRST to LAST. Before each action that may
 * crash the process it prints a line on standard output: "platforms", "platform NAME", "device NUMBER NAME"; at the end
 * "end". It ignores errors that a driver returns: the library gets the same errors and can report them. */
#define _GNU_SOURCE
#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <unistd.h>

enum { MAX_PLATFORMS = 16, MAX_DEVICES = 64, NAME_BYTES = 256, VALUES = 64 };

static const char kernel_source[] =
    "kernel void add(global float *x) { const ulong mark = 0x%016llx; x[get_global_id(0)] += mark != 0 ? 1.0f : 2.0f; "
    "}";

/* Writes each line with one write(), so that it is complete even if the process crashes next. */
static void say(const char *format, int number, const char *name) {
  char line[NAME_BYTES + 64];
  snprintf(line, sizeof line - 1, format, number, name);
  for (char *at = line; *at != 0; at++)
    if (*at == '\n') *at = ' ';
  strcat(line, "\n");
  if (write(STDOUT_FILENO, line, strlen(line)) < 0) _exit(1);
}

static void run_kernel(cl_context context, cl_device_id device, cl_kernel kernel) {
  const float zeros[VALUES] = {0};
  float values[VALUES];
  const size_t count = VALUES;
  cl_int code = CL_SUCCESS;
  cl_command_queue queue = clCreateCommandQueue(context, device, 0, &code);
  cl_mem memory = code == CL_SUCCESS ? clCreateBuffer(context, CL_MEM_READ_WRITE, sizeof zeros, NULL, &code) : NULL;
  if (code == CL_SUCCESS) code = clEnqueueWriteBuffer(queue, memory, CL_TRUE, 0, sizeof zeros, zeros, 0, NULL, NULL);
  if (code == CL_SUCCESS) code = clSetKernelArg(kernel, 0, sizeof memory, &memory);
  if (code == CL_SUCCESS) code = clEnqueueNDRangeKernel(queue, kernel, 1, NULL, &count, NULL, 0, NULL, NULL);
  if (code == CL_SUCCESS) code = clEnqueueReadBuffer(queue, memory, CL_TRUE, 0, sizeof values, values, 0, NULL, NULL);
  if (memory != NULL) clReleaseMemObject(memory);
  if (queue != NULL) clReleaseCommandQueue(queue);
}

static unsigned long long mix(unsigned long long hash, const void *bytes, size_t count) {
  for (size_t i = 0; i < count; i++) hash = (hash ^ ((const unsigned char *)bytes)[i]) * 0x100000001b3ull; /* FNV-1a */
  return hash;
}

/* Drivers cache compiled kernels. PoCL runs the linker `ld` of PATH to compile, and with a cached kernel does not
 * notice that `ld` is missing. So the source depends on the linker, not only in a comment. */
static void write_source(char source[NAME_BYTES]) {
  const char *at = getenv("PATH");
  unsigned long long hash = 0xcbf29ce484222325ull;
  for (bool found = false; at != NULL && !found;) {
    const size_t length = strcspn(at, ":");
    char path[4096];
    struct stat about;
    if (length < sizeof path - 4) {
      memcpy(path, at, length);
      memcpy(path + length, "/ld", 4);
      found = length > 0 && access(path, X_OK) == 0 && stat(path, &about) == 0;
      if (found) hash = mix(mix(hash, path, strlen(path)), &about.st_mtim, sizeof about.st_mtim);
    }
    at = at[length] == ':' ? at + length + 1 : NULL;
  }
  snprintf(source, NAME_BYTES, kernel_source, hash);
}

static void try_device(cl_platform_id platform, cl_device_id device) {
  const cl_context_properties properties[] = {CL_CONTEXT_PLATFORM, (cl_context_properties)platform, 0};
  char source[NAME_BYTES];
  const char *text = source;
  cl_int code = CL_SUCCESS;
  write_source(source);
  cl_context context = clCreateContext(properties, 1, &device, NULL, NULL, &code);
  cl_program program = code == CL_SUCCESS ? clCreateProgramWithSource(context, 1, &text, NULL, &code) : NULL;
  if (code == CL_SUCCESS) code = clBuildProgram(program, 1, &device, "", NULL, NULL);
  cl_kernel kernel = code == CL_SUCCESS ? clCreateKernel(program, "add", &code) : NULL;
  if (code == CL_SUCCESS) run_kernel(context, device, kernel);
  if (kernel != NULL) clReleaseKernel(kernel);
  if (program != NULL) clReleaseProgram(program);
  if (context != NULL) clReleaseContext(context);
}

int main(int argc, char **argv) {
  cl_platform_id platform[MAX_PLATFORMS], owner[MAX_DEVICES];
  cl_device_id device[MAX_DEVICES];
  cl_uint platforms = 0;
  int count = 0;
  char name[NAME_BYTES];
  if (argc != 3) {
    fputs("usage: ernerf-probe-opencl FIRST LAST; libernerf starts it\n", stderr);
    return 2;
  }
  prctl(PR_SET_PDEATHSIG, SIGKILL); /* end with the library's process */
  say("platforms%.0d%s", 0, "");
  if (clGetPlatformIDs(MAX_PLATFORMS, platform, &platforms) != CL_SUCCESS) platforms = 0;
  for (cl_uint p = 0; p < platforms && p < MAX_PLATFORMS; p++) { /* in the order of the library's numbers */
    cl_device_id found[MAX_DEVICES];
    cl_uint devices = 0;
    name[0] = name[sizeof name - 1] = 0;
    (void)clGetPlatformInfo(platform[p], CL_PLATFORM_NAME, sizeof name - 1, name, NULL);
    say("platform%.0d %s", 0, name);
    if (clGetDeviceIDs(platform[p], CL_DEVICE_TYPE_ALL, MAX_DEVICES, found, &devices) != CL_SUCCESS) continue;
    for (cl_uint d = 0; d < devices && d < MAX_DEVICES && count < MAX_DEVICES; d++) {
      owner[count] = platform[p];
      device[count++] = found[d];
    }
  }
  for (int i = 0; i < count; i++) {
    if (i < atoi(argv[1]) || i > atoi(argv[2])) continue;
    name[0] = name[sizeof name - 1] = 0;
    (void)clGetDeviceInfo(device[i], CL_DEVICE_NAME, sizeof name - 1, name, NULL);
    say("device %d %s", i, name);
    try_device(owner[i], device[i]);
  }
  say("end%.0d%s", 0, "");
  _exit(0); /* skips the exit handlers of drivers */
}
