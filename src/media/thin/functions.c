/* SPDX-License-Identifier: MIT */
#include "media/thin/functions.h"

#include "core/interface_version.h"

#define STATUS_ENTRY(name, parameters, arguments, context, empty) .name = name,
#define VALUE_ENTRY(type, name, parameters, arguments, none) .name = name,
#define VOID_ENTRY(name, parameters, arguments, empty) .name = name,
#define FREE_ENTRY(name, parameters, arguments) .name = name,

const struct ern_media_functions ern_media_functions = {.version = ERN_INTERFACE_VERSION,
                                                        ERN_MEDIA_STATUS(STATUS_ENTRY) ERN_MEDIA_VALUE(VALUE_ENTRY)
                                                            ERN_MEDIA_VOID(VOID_ENTRY) ERN_MEDIA_FREE(FREE_ENTRY)};
