/* SPDX-License-Identifier: MIT */
#include "media/thin/functions.h"

#define TEXT_OF(x) #x
#define VERSION(major, minor, patch) TEXT_OF(major) "." TEXT_OF(minor) "." TEXT_OF(patch)

#define STATUS_ENTRY(name, parameters, arguments, context, empty) .name = name,
#define VALUE_ENTRY(type, name, parameters, arguments, none) .name = name,
#define VOID_ENTRY(name, parameters, arguments, empty) .name = name,
#define FREE_ENTRY(name, parameters, arguments) .name = name,

const struct ern_media_functions ern_media_functions = {
    .version = VERSION(ERN_VERSION_MAJOR, ERN_VERSION_MINOR, ERN_VERSION_PATCH),
    ERN_MEDIA_STATUS(STATUS_ENTRY) ERN_MEDIA_VALUE(VALUE_ENTRY) ERN_MEDIA_VOID(VOID_ENTRY) ERN_MEDIA_FREE(FREE_ENTRY)};
