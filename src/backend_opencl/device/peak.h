/* SPDX-License-Identifier: MIT
 * Loops that measure the peak rates of an OpenCL device; the benchmark compares kernels with them. In a build without
 * OpenCL none of these functions is called. */
#ifndef ERN_OPENCL_PEAK_H
#define ERN_OPENCL_PEAK_H

#include "core/backend.h"

enum {
  ERN_OPENCL_PEAK_TABLE = 1 << 14, /* floats of the table that reads go to: 64 KiB */
  ERN_OPENCL_PEAK_BLOCK = 1 << 12  /* floats; COPY, UPDATE and MOVE run over a multiple */
};

struct ern_opencl_about {
  unsigned units;        /* compute units */
  bool cpu;              /* kernels in the form for CPUs */
  size_t cache_bytes;    /* of global memory; 0: none, or the driver does not say */
  uint64_t memory_bytes; /* of the device */
  uint64_t buffer_bytes; /* of one buffer at most */
  size_t sink;           /* floats that a loop writes */
};

enum ern_opencl_loop {
  ERN_OPENCL_MULTIPLY, /* multiply-adds in registers; FLOP, two each */
  ERN_OPENCL_GATHER,   /* reads of 32 bits at random places of a table */
  ERN_OPENCL_COPY,     /* bytes, read and written; so are the next two */
  ERN_OPENCL_UPDATE,   /* in place */
  ERN_OPENCL_MOVE,     /* the driver's own copy */
  ERN_OPENCL_LOOPS
};
struct ern_opencl_peak {
  enum ern_opencl_loop loop;
  ern_span sink;     /* real [about.sink]: of the first two */
  ern_span table;    /* real [ERN_OPENCL_PEAK_TABLE]: of GATHER */
  ern_span to, from; /* of the same size: of the streams; UPDATE has no `from` */
};

#if defined(ERN_OPENCL)
void ern_opencl_describe(const struct ern_backend *backend, struct ern_opencl_about *about);
/* Enqueues one loop on the whole device; *done = how many operations that is. */
ERN_NODISCARD ern_status ern_opencl_peak_run(struct ern_stream *stream, const struct ern_opencl_peak *peak,
                                             double *done);
/* Waits until the stream's queue is empty. */
ERN_NODISCARD ern_status ern_opencl_finish(struct ern_stream *stream);
#else
static inline void ern_opencl_describe(const struct ern_backend *backend, struct ern_opencl_about *about) {
  (void)backend;
  *about = (struct ern_opencl_about){0};
}
static inline ern_status ern_opencl_peak_run(struct ern_stream *stream, const struct ern_opencl_peak *peak,
                                             double *done) {
  (void)stream, (void)peak, (void)done;
  return ERN_E_UNSUPPORTED;
}
static inline ern_status ern_opencl_finish(struct ern_stream *stream) {
  (void)stream;
  return ERN_OK;
}
#endif

#endif
