/* SPDX-License-Identifier: MIT
 * The form of a model that a stream keeps for its fused passes. */
#ifndef ERN_OPENCL_RENDER_H
#define ERN_OPENCL_RENDER_H

#include "backend_opencl/device/backend.h"

struct ern_cl_head;  /* of render_rays: render_head.h */
struct ern_cl_torso; /* of render_torso: render_torso.h */

struct ern_cl_portrait {
  ern_span of;                /* the parameters it was made from */
  struct ern_cl_head *head;   /* NULL: a shape that goes through the stages */
  struct ern_cl_torso *torso; /* likewise, or a model without one */
};

void ern_cl_portrait_free(struct ern_cl_stream *stream); /* accepts a stream without one */

#endif
