/* SPDX-License-Identifier: MIT
 * Types of the interface between layers and backends: spans of a backend's memory, rows of numbers, limits.
 *
 * Layout: a quantity with C channels for N samples is stored channel by channel, value (c, i) at c*stride + i, so that
 * a loop over samples runs over contiguous memory. `stride` is at least N. */
#ifndef ERN_CORE_TYPES_H
#define ERN_CORE_TYPES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "ernerf/base.h"

/* The scalar of a backend: float everywhere but in the double build of the reference (ERN_DOUBLE). */
#ifdef ERN_DOUBLE
typedef double ern_real;
#define ERN_REF(name) name##_ref64
#else
typedef float ern_real;
#define ERN_REF(name) name##_ref
#endif

struct ern_backend;
struct ern_stream;
struct ern_buffer; /* memory of a backend, of one element type */

typedef enum ern_element { ERN_ELEMENT_REAL, ERN_ELEMENT_INT32, ERN_ELEMENT_BYTE } ern_element;

/* `count` elements of a buffer from element `at`. A zeroed span means "none". */
typedef struct ern_span {
  struct ern_buffer *buffer;
  size_t at, count;
} ern_span;

/* What a row of numbers has one value for each of. */
typedef enum ern_per { ERN_PER_SAMPLE, ERN_PER_RAY, ERN_PER_BATCH } ern_per;

/* `rows` channels; value (c, i) at span.at + c*stride + i, where i is the sample, the sample's ray, or 0 by `per`. */
typedef struct ern_rows {
  ern_span span;
  size_t stride;
  int rows;
  ern_per per;
} ern_rows;

/* The same with a plain pointer: what kernels see. data NULL: not there. */
struct ern_rows_view {
  ern_real *data;
  size_t stride;
  int rows;
  ern_per per;
};

enum {
  ERN_MAX_PIECES = 4, /* inputs that an MLP concatenates */
  ERN_MLP_MAX_LAYERS = 9,
  ERN_MLP_MAX_WIDTH = 256,
  ERN_GRID_MAX_DIMS = 3,
  ERN_GRID_MAX_LEVELS = 24,
  ERN_MAX_STEPS = 1024, /* samples a ray */
  ERN_SHARDS = 16       /* parts into which sums over samples are split, whatever the number of threads */
};

/* The occupancy grid, which the model keeps and the renderer marches through. */
enum {
  ERN_OCCUPANCY_SIDE = 128,                     /* cells an axis of [-bound, bound]^3 */
  ERN_OCCUPANCY_CELLS = 128 * 128 * 128,        /* in Morton order: x in bit 0, y in bit 1, z in bit 2 */
  ERN_OCCUPANCY_BYTES = ERN_OCCUPANCY_CELLS / 8 /* cell 8n+k is bit k of byte n */
};

#endif
