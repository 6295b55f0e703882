/* SPDX-License-Identifier: MIT
 * Checks a frame's input from the caller before it is used: ERN_E_ARGUMENT names the field, ERN_E_NONFINITE a pose,
 * window or code that is not finite. */
#ifndef ERN_RENDER_FRAME_INPUT_H
#define ERN_RENDER_FRAME_INPUT_H

#include "ernerf/render.h"
#include "io/feature_range.h"
#include "model/field.h"

ERN_NODISCARD ern_status ern_frame_input_check(ern_context *context, const struct ern_field *field,
                                               const ern_frame_input *input);
/* A pose that is finite and can be inverted; `name` begins the message ("render: pose"). */
ERN_NODISCARD ern_status ern_pose_check(ern_context *context, const char *name, const float pose[16]);
/* Refuses a feature and says why; `where` begins the message ("render: speech window"), i is the index of the value. */
ERN_NODISCARD ern_status ern_feature_refuse(ern_context *context, const char *where, size_t i, float value);
/* Checks the length of the speech's windows, in vectors: 1..16, and equal to that of the training where the model knows
 * it (else ERN_E_MISMATCH). `where` begins the message ("render"). */
ERN_NODISCARD ern_status ern_window_length_check(ern_context *context, const struct ern_field *field, const char *where,
                                                 int window_length);
/* Checks only windows and window_length. */
ERN_NODISCARD ern_status ern_frame_windows_check(ern_context *context, const struct ern_field *field,
                                                 const ern_frame_input *input);

#endif
