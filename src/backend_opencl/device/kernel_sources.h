/* SPDX-License-Identifier: MIT
 * The texts of kernels/NAME.cl, written out at build time by cmake/embed.cmake. */
#ifndef ERN_OPENCL_KERNEL_SOURCES_H
#define ERN_OPENCL_KERNEL_SOURCES_H

#include <stddef.h>

/* Those that a program is made of; the others come before some of them (program.c). */
#define ERN_CL_SOURCES(SOURCE) \
  SOURCE(scan)                 \
  SOURCE(march)                \
  SOURCE(composite)            \
  SOURCE(occupancy)            \
  SOURCE(picture)              \
  SOURCE(upsample)             \
  SOURCE(hashgrid)             \
  SOURCE(mlp)                  \
  SOURCE(activation)           \
  SOURCE(encoding)             \
  SOURCE(attention)            \
  SOURCE(audio)                \
  SOURCE(torso)                \
  SOURCE(losses)               \
  SOURCE(patches)              \
  SOURCE(optimizer)            \
  SOURCE(portrait)             \
  SOURCE(render)               \
  SOURCE(render_torso)         \
  SOURCE(peak)

#define ERN_CL_TEXT(name)                          \
  extern const unsigned char ern_cl_text_##name[]; \
  extern const size_t ern_cl_bytes_##name;
ERN_CL_TEXT(common)
ERN_CL_TEXT(float_add)
ERN_CL_TEXT(samples)
ERN_CL_TEXT(tensor)
ERN_CL_TEXT(tile)
ERN_CL_SOURCES(ERN_CL_TEXT)
#undef ERN_CL_TEXT

#endif
