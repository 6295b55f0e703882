/* SPDX-License-Identifier: MIT */
#include "render/renderer_state.h"

ern_status ern_renderer_buffer(ern_renderer *r, enum buffer buffer, ern_element element, size_t count, ern_span *span) {
  ern_status status = ERN_OK;
  if (r->buffer[buffer] == NULL) status = r->backend->buffer_make(r->backend, element, count, &r->buffer[buffer]);
  *span = status == ERN_OK ? ern_whole(r->buffer[buffer], count) : (ern_span){0};
  return status;
}
