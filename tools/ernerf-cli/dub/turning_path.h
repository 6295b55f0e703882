/* SPDX-License-Identifier: MIT
 * Which frames of a clip a speech shows that lasts longer than the clip: forward and backward, with turns where the
 * head hardly moves. */
#ifndef ERN_CLI_TURNING_PATH_H
#define ERN_CLI_TURNING_PATH_H

#include "session/frame_source.h"

/* The two frames where it turns: each the one whose head moves least, of the two seconds, and a quarter of the frames,
 * at its end. */
void turning_path_ends(const ern_clip *clip, const struct source_frame *frames, size_t begin, size_t end, size_t *low,
                       size_t *high);
/* order[windows]: frames of the clip, from `begin` on up to `end`, not included; where there are more windows than
 * frames, backward from a frame near the end to one near the beginning, forward again, and so on. frames: those of the
 * clip, [end] or more. Returns the number of turns. */
size_t turning_path(const ern_clip *clip, const struct source_frame *frames, size_t begin, size_t end, size_t windows,
                    size_t *order);

#endif
