/* SPDX-License-Identifier: MIT
 * Internals of a renderer: its data on the backend, and the functions that make a frame. */
#ifndef ERN_RENDER_RENDERER_STATE_H
#define ERN_RENDER_RENDERER_STATE_H

#include "core/memory.h"
#include "core/profile.h"
#include "model/model.h"
#include "render/ray_reuse_state.h"
#include "render/stages.h"

#include "ernerf/render.h"

/* Device memory of a frame. It is kept for the next frame of the same size. */
struct frame {
  size_t pixels;
  ern_span number;                                        /* int32: all pixels in order */
  ern_rows background, pixel;                             /* [3] per pixel */
  ern_rows torso_opacity, opacity, depth, attention, eye; /* [1]; the last three zeroed: not wanted */
  ern_rows layer;                                         /* [4]: pixel and opacity */
};

/* Buffers of a frame's spans; those after PLANES are made at their first use. */
enum buffer {
  NUMBER,
  PLANES,
  SMALL,
  DEPTH,
  ATTENTION,
  EYE,
  BACKGROUND_BYTES,
  TORSO_BYTES,
  RGBA,
  RGB,
  ALPHA,
  COLOUR,
  WANTED,
  BUFFERS
};

enum { MAX_WINDOW_LENGTH = 16, AUDIO_CODE_VALUES = ERN_AUDIO_WINDOWS * ERN_AUDIO_CODE };

/* Codes of the last frame's windows, most of which the next frame shares. */
struct audio_code_cache {
  struct ern_buffer *codes[2]; /* [8][A]; the second is workspace to reorder them */
  float *windows;              /* [8][length][width], on the host */
  int length;                  /* of a window; 0: the cache is empty */
};

struct ern_renderer {
  ern_context *context;
  struct ern_backend *backend;
  const ern_model *model;
  struct ern_field field; /* the model's, but the window length is that of the features in use, and the individual codes
                             may be their mean, stored after the parameters */
  size_t individual;      /* row of the frame's individual codes */
  ern_render_options options;
  struct ern_stream *stream;
  struct ern_buffer *parameters, *bits, *torso_grid, *code;
  float torso_threshold;
  struct frame frame;
  struct ern_profile profile; /* of the head of the frame */
  struct ern_buffer *buffer[BUFFERS];
  struct audio_code_cache audio_code;
  bool has_last_code;
  float last_code[ERN_AUDIO_CODE];
  struct ern_ray_reuse reuse;
};

static inline ern_span ern_whole(struct ern_buffer *buffer, size_t count) { return (ern_span){buffer, 0, count}; }

/* *span = the buffer, made at its first use. */
ERN_NODISCARD ern_status ern_renderer_buffer(ern_renderer *r, enum buffer buffer, ern_element element, size_t count,
                                             ern_span *span);

/* *frames: [count], owned by the caller (ern_release); they point into windows and eyes, which have been checked. */
ERN_NODISCARD ern_status ern_renderer_speech_frames(ern_renderer *r, const float *windows, int window_length,
                                                    const float *eyes, size_t count, struct ern_speech_frame **frames);

/* r->code = the audio code of the windows. */
ERN_NODISCARD ern_status ern_renderer_encode_windows(ern_renderer *r, const ern_frame_input *input);

/* The audio code of the frame: smoothed over frames where the options ask for it, and blended with the silence code. */
ERN_NODISCARD ern_status ern_renderer_encode_audio(ern_renderer *r, const ern_frame_input *input);

/* Writes the layers behind the head to the frame's background rows: background, torso picture, the model's own
 * torso. */
ERN_NODISCARD ern_status ern_renderer_background_layers(ern_renderer *r, const ern_frame_input *input);
/* motion: of torso_move for this frame; zeros for a model without torso motion. */
void ern_renderer_torso_motion(const ern_renderer *r, const ern_frame_input *input, float motion[ERN_MOTION_VALUES]);

/* Renders the head over the background rows into the frame's pixels. */
ERN_NODISCARD ern_status ern_renderer_head(ern_renderer *r, const ern_frame_input *input);

/* ERN_E_ARGUMENT where a member is outside of its range. */
ERN_NODISCARD ern_status ern_render_settings_check(ern_context *context, const ern_render_options *options);

#endif
