/* SPDX-License-Identifier: MIT
 * The table of a live session's settings: one row for each member of ern_live_options, in their order. */
#define ERN_SETTINGS ern_live_options
#include "core/setting_table.h"
#include "ernerf/live.h"
#include "media/live/live_limits.h"

static const ern_setting table[] = {
    {ERN_ROW_INT(rate, 1000, 384000, 48000), .help = "samples a second of the sound"},
    {ERN_ROW_INT(channels, 1, 8, 1), .help = "channels of the sound"},
    {ERN_ROW_INT(window_length, 0, 16, 0), .help = "vectors of a window of features; 0: sound is pushed"},
    {ERN_ROW_INT(width, 0, 4096, 0), .help = "numbers of a vector of features; 0: sound is pushed"},
    {ERN_ROW_INT(look_ahead, ERN_LIVE_LEAST_LOOK_AHEAD, ERN_LIVE_LOOK_AHEAD, ERN_LIVE_LOOK_AHEAD),
     .help = "frames at 25 a second that a frame waits for; fewer: less delay, less accurate lips"},
    {ERN_ROW_INT(capacity, 20, ERN_LIVE_MOST_CAPACITY, 50), .help = "most sound that waits, in frames at 25 a second"},
    {ERN_ROW_INT(policy, ERN_LIVE_WAIT, ERN_LIVE_REPEAT, ERN_LIVE_WAIT),
     .help = "where more sound comes: 0 wait, 1 drop the oldest frames, 2 repeat frames"},
    {ERN_ROW_INT(rate_numerator, 1, ERN_LIVE_MOST_RATE_PART, 25), .help = "frames a second: numerator"},
    {ERN_ROW_INT(rate_denominator, 1, ERN_LIVE_MOST_RATE_PART, 1), .help = "frames a second: denominator"},
    {ERN_ROW_WORD(pad, ern_audio_pad, "edge|zero", 2, ERN_AUDIO_PAD_EDGE),
     .help = "windows past the ends of the speech: edge repeats the nearest, zero has zeros"},
    {ERN_ROW_BOOL(insert_silence), .help = "every pull returns a frame: silence is inserted where sound is missing"},
    {ERN_ROW_POINTER(silence, const ern_silence *)},
    {ERN_ROW_POINTER(silence_code, const float *)},
    {ERN_ROW_TEXT(speech)},
};

ERN_SETTINGS_FUNCTIONS(live, ern_live_options, 0x45524e4c)
