/* SPDX-License-Identifier: MIT */
#include "render/renderer_state.h"

ern_status ern_renderer_room(ern_renderer *r, enum room room, ern_element element, size_t count, ern_span *span) {
  ern_status status = ERN_OK;
  if (r->room[room] == NULL) status = r->backend->buffer_make(r->backend, element, count, &r->room[room]);
  *span = status == ERN_OK ? ern_whole(r->room[room], count) : (ern_span){0};
  return status;
}
