/* SPDX-License-Identifier: MIT
 * What a name that the user gives to live input or output is: a file, or the address of a network. */
#ifndef ERN_MEDIA_ADDRESS_H
#define ERN_MEDIA_ADDRESS_H

#include <stdbool.h>

#include "core/status.h"

/* The bytes of a scheme at the beginning of `url`, as FFmpeg finds it: up to ":", or up to "," in
 * "subfile,,start,...:". 0: there is none. */
size_t ern_scheme_length(const char *url);
/* Sets *path to the path of the file, pipe or device that `url` names, which points into `url`; NULL: it is an address
 * "SCHEME://..." of a network. ERN_E_UNSUPPORTED: it begins with another of FFmpeg's protocols, such as "concat:", or
 * with an unknown scheme and "://". */
ERN_NODISCARD ern_status ern_address_parse(ern_context *context, const char *url, const char **path);

#endif
