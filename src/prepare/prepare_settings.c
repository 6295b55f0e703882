/* SPDX-License-Identifier: MIT
 * The table of a preparation's settings: one row for each member of ern_prepare_options, in their order. */
#define ERN_SETTINGS ern_prepare_options
#include "core/setting_table.h"
#include "prepare/prepare_job.h"

typedef int (*progress_function)(void *user, const char *step, size_t done, size_t total);

static const ern_setting table[] = {
    {ERN_ROW_DOUBLE(from, 0, 1e9, 0), .help = "where in the video to begin, seconds"},
    {ERN_ROW_DOUBLE(to, 0, 1e9, 0), .help = "where to end, seconds; 0: the end of the video"},
    {ERN_ROW_INT(side, 128, 1024, 512), .help = "pixels a side of the clip's pictures"},
    {ERN_ROW_DOUBLE(focal, 0, ERN_PREPARE_FOCAL_MOST * 1024, 0),
     .help = "focal length in pixels of the clip; 0: that of the poses, else 1100/450 of a side"},
    {ERN_ROW_BOOL(head_only), .help = "a clip of the head alone"},
    {ERN_ROW_TEXT(only)},
    {ERN_ROW_TEXT(background)},
    {ERN_ROW_TEXT(landmarks)},
    {ERN_ROW_TEXT(poses)},
    {ERN_ROW_TEXT(masks)},
    {ERN_ROW_TEXT(au)},
    {ERN_ROW_TEXT(features)},
    {ERN_ROW_BOOL(anew), .help = "replace what earlier calls made of another video or with other options"},
    {ERN_ROW_POINTER(progress, progress_function)},
    {ERN_ROW_POINTER(user, void *)},
    {ERN_ROW_TEXT(segment)},
    {ERN_ROW_TEXT(detector)},
    {ERN_ROW_TEXT(sound_offset)},
};

ERN_SETTINGS_FUNCTIONS(prepare, ern_prepare_options, 0x70726570)
