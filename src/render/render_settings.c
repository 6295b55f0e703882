/* SPDX-License-Identifier: MIT
 * The table of a renderer's settings: one row for each member of ern_render_options, in their order. Defaults, range
 * checks, the program's options and the Python module's structure follow from it. */
#define ERN_SETTINGS ern_render_options
#include "core/setting_table.h"
#include "render/march_ops.h"
#include "render/renderer_state.h"

static const ern_setting table[] = {
    {ERN_ROW_INT(threads, 0, ERN_THREADS_MOST, 0), .help = "threads; 0: one a core"},
    {ERN_ROW_INT(max_steps, 0, ERN_MAX_STEPS, 0), .help = "samples a ray at most; 0: as in training"},
    {ERN_ROW_FLOAT(dt_gamma, -1, 1, -1),
     .help =
         "growth of the sample spacing along a ray with distance; needs more than 128 samples a ray; below 0: as in "
         "training"},
    {ERN_ROW_FLOAT(transmittance_stop, 0, 0.99, 1e-4),
     .help = "end a ray when less than this share of its light is left; models are trained with 1e-4"},
    {ERN_ROW_FLOAT(torso_shrink, 0, 1, 0), .help = "factor of the torso's coordinates; 0: as in training"},
    {ERN_ROW_BOOL(smooth_lips),
     .help = "smooth the lips: the audio code of a frame is 0.35 of the previous frame's and 0.65 of its own"},
    {ERN_ROW_FLOAT(frame_rate, 1, 1000, 25), .help = "frames a second of the video"},
    {ERN_ROW_FLOAT(image_scale, 0.25, 1, 1),
     .help = "render the head at so many times the picture's size, and enlarge it; torso and background stay sharp"},
    {ERN_ROW_BOOL(no_torso), .help = "do not draw the model's torso"},
};

ERN_SETTINGS_FUNCTIONS(render, ern_render_options, 0x45524e33)
