/* SPDX-License-Identifier: MIT
 * Memory through the context's hooks, sizes checked for overflow. */
#ifndef ERN_CORE_MEMORY_H
#define ERN_CORE_MEMORY_H

#include <stdbool.h>

#include "core/status.h"

/* Alignment, and padding at the end, of everything that ern_allocate returns: one cache line, one AVX-512 register.
 * Kernels may read, never write, up to this many bytes past the end. */
enum { ERN_ALIGNMENT = 64 };

/* Zeroed memory for count items of item_bytes each. A count of 0 gives a valid pointer.
 * NULL on failure: the error says how many bytes were asked for. */
ERN_NODISCARD void *ern_allocate(ern_context *context, size_t count, size_t item_bytes);

/* The status of an allocation that returned `memory`. */
ERN_NODISCARD static inline ern_status ern_allocation_status(const ern_context *context, const void *memory) {
  if (context == NULL) return ERN_E_ARGUMENT;
  return memory != NULL ? ERN_OK : ERN_E_NO_MEMORY;
}

/* *pointer = zeroed memory for count items of the type that it points to; NULL where the status is not ERN_OK. */
#define ERN_NEW(context, count, pointer) \
  ern_allocation_status((context), *(pointer) = ern_allocate((context), (count), sizeof **(pointer)))

/* Accepts NULL. Without a context nothing is released. */
void ern_release(ern_context *context, void *memory);

/* product = a*b, or false where it does not fit. */
static inline bool ern_size_multiply(size_t a, size_t b, size_t *product) {
  return !__builtin_mul_overflow(a, b, product);
}
static inline bool ern_size_add(size_t a, size_t b, size_t *sum) { return !__builtin_add_overflow(a, b, sum); }

/* A copy of a string, owned by the caller (ern_release). */
ERN_NODISCARD ern_status ern_string_copy(ern_context *context, const char *text, char **copy);

#endif
