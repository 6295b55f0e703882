/* SPDX-License-Identifier: MIT
 * An OpenCL driver that ends the process, as some do that lack memory, a device's files or their linker. The loader
 * takes it from a folder named by OCL_ICD_VENDORS; ERNERF_TEST_DEATH says how: "abort", "exit" (with status 3) or
 * "hang". */
#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>
#include <CL/cl_icd.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static cl_int CL_API_CALL die(cl_uint entries, cl_platform_id *platforms, cl_uint *count) {
  const char *how = getenv("ERNERF_TEST_DEATH");
  (void)entries, (void)platforms, (void)count;
  fputs("first words\nNot enough memory to run on this device\n\n", stderr);
  if (how != NULL && strcmp(how, "abort") == 0) abort();
  if (how != NULL && strcmp(how, "exit") == 0) exit(3);
  for (;;) sleep(1);
}

static cl_int CL_API_CALL no_info(cl_platform_id platform, cl_platform_info what, size_t bytes, void *value,
                                  size_t *needed) {
  (void)platform, (void)what, (void)bytes, (void)value, (void)needed;
  return CL_INVALID_PLATFORM;
}

/* A loader asks for these two before it calls either. */
CL_API_ENTRY void *CL_API_CALL clGetExtensionFunctionAddress(const char *name) {
  union {
    cl_int(CL_API_CALL *platforms)(cl_uint, cl_platform_id *, cl_uint *);
    cl_int(CL_API_CALL *info)(cl_platform_id, cl_platform_info, size_t, void *, size_t *);
    void *address;
  } found = {.address = NULL};
  if (strcmp(name, "clIcdGetPlatformIDsKHR") == 0) found.platforms = die;
  if (strcmp(name, "clGetPlatformInfo") == 0) found.info = no_info;
  return found.address;
}
