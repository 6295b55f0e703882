/* SPDX-License-Identifier: MIT */
#include "core/sized.h"

#include <string.h>

/* The first members of every configuration struct. */
struct head {
  uint32_t cookie, size;
};

ern_status ern_struct_copy_in(ern_context *context, const char *type, void *own, size_t own_bytes, const void *theirs,
                              size_t bytes) {
  if (bytes > own_bytes)
    return ern_fail(context, ERN_E_UNSUPPORTED,
                    "%s: found %zu bytes, libernerf %s knows %zu: the program was built for a later version", type,
                    bytes, ern_version(), own_bytes);
  memcpy(own, theirs, bytes);
  return ERN_OK;
}

ern_status ern_config_copy_in(ern_context *context, const char *type, void *own, size_t own_bytes, const void *theirs) {
  struct head ours, given;
  memcpy(&ours, own, sizeof ours);
  memcpy(&given, theirs, sizeof given);
  if (given.cookie != ours.cookie || given.size < sizeof given)
    return ern_fail(context, ERN_E_ARGUMENT, "%s: found one that was not made by %s_default", type, type);
  const ern_status status = ern_struct_copy_in(context, type, own, own_bytes, theirs, given.size);
  memcpy(own, &ours, sizeof ours);
  return status;
}

void ern_struct_copy_out(void *theirs, size_t bytes, const void *own, size_t own_bytes) {
  const size_t both = bytes < own_bytes ? bytes : own_bytes;
  if (theirs == NULL) return;
  memcpy(theirs, own, both);
  memset((char *)theirs + both, 0, bytes - both);
}

void ern_config_copy_out(void *theirs, size_t bytes, const void *own, size_t own_bytes) {
  struct head head;
  ern_struct_copy_out(theirs, bytes, own, own_bytes);
  memcpy(&head, own, sizeof head);
  head.size = (uint32_t)bytes;
  ern_struct_copy_out(theirs, bytes < sizeof head ? bytes : sizeof head, &head, sizeof head);
}
