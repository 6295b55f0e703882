/* SPDX-License-Identifier: MIT
 * From a model, speech features and head poses to frames. base.h defines the terms "plain data", "final" and "may
 * grow". */
#ifndef ERNERF_RENDER_H
#define ERNERF_RENDER_H

#include <stdbool.h>

#include "ernerf/backend.h"
#include "ernerf/data.h"
#include "ernerf/model.h"
#include "ernerf/setting.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- camera ------------------------------------------------------------------------------------------------------ */

/* Plain data, final. */
typedef struct ern_box {
  int top, bottom, left, right; /* rows [top, bottom), columns [left, right) */
} ern_box;

/* How a frame goes into a picture of another aspect. It is never distorted. */
typedef enum ern_fit {
  ERN_FIT_CONTAIN = 0, /* the whole frame is visible; its edge pixels are repeated where it leaves the picture empty */
  ERN_FIT_COVER = 1    /* the frame fills the picture; what lies outside is cut off, as much on either side */
} ern_fit;

/* Where a frame of from_width x from_height lies in a picture of width x height, in pixels; all sides 1 to 1e9; where
 * one is below 1 the box is all zeros. With ERN_FIT_COVER it may reach beyond the picture. It is in the middle, at
 * whole pixels; where both its sides differ from the picture's by less than a pixel, the box is the whole picture. */
ERN_API ern_box ern_fit_box(int from_width, int from_height, int width, int height, ern_fit fit);

/* A pinhole camera in the renderer's coordinate system: x up, y out of the face toward the camera, z to the right
 * in the picture of a face that looks into the camera; the scene is the cube [-bound, bound]^3. Plain data, final. */
typedef struct ern_camera {
  float pose[16];      /* camera to scene, row-major, the last column in scene units. The camera's own x points to the
                          right of its picture, its y down, its z into the scene (ern_camera_pose makes such a pose of a
                          transforms matrix). The matrix can be inverted; entries of its rotation are at most 1000 */
  float focal, cx, cy; /* pixels, focal > 0; cx, cy from the picture's top left corner: the centre of the first pixel is
                          at (0.5, 0.5) */
  int width, height;   /* pixels, 1..8192 */
  ern_box frame;       /* the part of the picture that shows what a training frame shows (ern_fit_box); coordinates of
                          -32768 to 32768. Pixels outside it repeat the nearest pixel's head and torso. All zeros: the
                          whole picture */
} ern_camera;

/* matrix: camera to world of a transforms file. Rows of the result: (m10, -m11, -m12, s m13), (m20, -m21, -m22, s m23),
 * (m00, -m01, -m02, s m03), (0, 0, 0, 1); scale s is ern_model_info.scale. */
ERN_API void ern_camera_pose(float pose[16], const float matrix[16], float scale);

/* Turns the head of a transforms file's matrix, in place: the camera goes around the head's centre, which is the origin
 * of the matrix's world, by `pitch` about the world's x axis, then by -`yaw` about its upright y axis, in degrees. A
 * face that looked into the camera then looks to the right of the picture (yaw > 0) or up (pitch > 0). The distance
 * stays.
 */
ERN_API void ern_pose_turn(float matrix[16], double yaw, double pitch);

/* The same view as a picture of another size: the whole picture of `camera` is scaled and placed as ern_fit_box says,
 * and that box is the result's `frame`. camera->frame is not read. Background and torso pictures that are handed in
 * must be placed likewise. */
ERN_API ern_camera ern_camera_fitted(const ern_camera *camera, int width, int height, ern_fit fit);
/* The same with ERN_FIT_CONTAIN. Both: all zeros for a side below 1. */
ERN_API ern_camera ern_camera_resized(const ern_camera *camera, int width, int height);

/* Which of `count` poses belongs to frame `frame` when there are fewer poses than frames: forward, backward, and so on
 * (0 1 2 1 0 1 ... has period 2*(count-1); with one pose always 0). count >= 1. */
ERN_API size_t ern_pose_index(size_t frame, size_t count);

/* Smooths a path of transforms matrices in place: each translation becomes the mean, and each rotation the chordal mean
 * (the rotation nearest to the mean matrix), over a window of `window` frames (odd, >= 1) cut at the ends.
 * ERN_E_FORMAT: the mean matrix of a window is singular, so it has no nearest rotation. After an error the poses are as
 * they were. */
ERN_API ERN_NODISCARD ern_status ern_poses_smooth(ern_context *context, ern_pose *poses, size_t count, int window);

/* The pose between two transforms matrices, or two camera poses: the rotation by slerp (constant speed about one axis,
 * the shorter way), the translation by a straight line. share: 0..1; at 0 or below, or NaN, the result is exactly
 * `from`; at 1 or above exactly `to`; where `from` equals `to`, exactly that pose. The residual of a matrix from its
 * nearest rotation is interpolated linearly, and so is a whole 3 x 3 part where one of the two is singular or a
 * reflection. `out` may be one of the two. Any thread. */
ERN_API void ern_pose_interpolate(float out[16], const float from[16], const float to[16], double share);

/* ---- speech ------------------------------------------------------------------------------------------------------ */

/* windows[8][window_length][width] = the windows index-4 .. index+3 of `features`; any index will do. Nothing is
 * written where a size of the features is out of its range (ern_features). Frame k of a video of another rate R lies at
 * index t = 25 k/R: interpolate each number of the windows of floor(t) and floor(t) + 1 linearly, and eye values and
 * silence weights likewise (docs/effects.md, "Another rate"). A live session does so itself (live.h). */
ERN_API void ern_audio_windows(float *windows, const ern_features *features, int64_t index, ern_audio_pad pad);

/* Like ern_audio_windows, with neighbours taken from a list of `count` frames, such as a split of a clip. Frame k of
 * the list uses window rows[k] of `features`, a row outside of them the first or last window; `index` counts in the
 * list. Before its first and after its last frame windows are zeros (ERN_AUDIO_PAD_ZERO). */
ERN_API void ern_audio_windows_of_rows(float *windows, const ern_features *features, const int64_t *rows, size_t count,
                                       int64_t index);

/* What silence looks like in speech features of one kind. Read-only once learnt: any number of threads may use one. */
typedef struct ern_silence ern_silence;

/* Learns to recognise silence from a recording, such as the clip that a model was trained on. loudness:
 * [features->windows], the level of each frame's sound in dB, with any reference level; NULL: frames whose features
 * change little from frame to frame, compared with the others, count as quiet. -infinity is digital silence, NaN not
 * known. ERN_E_STATE: silence cannot be recognised, and the message has the reason: too few quiet or loud frames, too
 * small a difference of level, or features that do not separate the two. ERN_E_NONFINITE, ERN_E_FORMAT: a feature is
 * one that ern_features_load refuses. On success the caller owns *silence. */
ERN_API ERN_NODISCARD ern_status ern_silence_learn(ern_context *context, const ern_features *features,
                                                   const float *loudness, ern_silence **silence);
ERN_API void ern_silence_free(ern_silence **silence); /* accepts NULL and a pointer to NULL */

/* weights[features->windows]: ern_frame_input.silence_weight for each frame of a speech in features of the same kind.
 * It is 0 in speech and in pauses of less than 8 frames. In a silence of 8 frames or more it is 0.2, 0.4, 0.6
 * and 0.8 in the first four frames and 1 in all later ones; where the speech begins with such a silence it is 1 from
 * the first frame on. ERN_E_MISMATCH: features of another width. ERN_E_NONFINITE, ERN_E_FORMAT: as above. */
ERN_API ERN_NODISCARD ern_status ern_silence_weights(const ern_silence *silence, const ern_features *features,
                                                     float *weights);

/* ---- renderer ---------------------------------------------------------------------------------------------------- */

/* Plain data, may grow. */
typedef struct ern_render_options {
  uint32_t cookie, size;    /* set by ern_render_options_default() */
  int threads;              /* of the CPU, 0..ERN_THREADS_MOST; 0 (default): one a core that this process may use.
                               OpenCL ignores it and logs a warning */
  int max_steps;            /* most samples a ray, 1..1024; 0 (default): the model's (ern_model_info) */
  float dt_gamma;           /* growth of the sample spacing with distance, 0..1; -1 (default) to below 0: the model's */
  float transmittance_stop; /* a ray ends when less than this share of its light is left, 0..0.99; default 1e-4, as
                               in training. `ernerf render` has 3e-3, which is faster and less accurate */
  float torso_shrink;       /* factor of the torso coordinates, above 0, at most 1; 0 (default): the model's */
  bool smooth_lips;         /* default false; true: audio code = w * the last frame's + (1 - w) * this one's; w is 0.35
                               at 25 frames a second and 0.35^(25 / frame_rate) in general, so that the lips are as
                               fast at any rate. The renderer's first frame has its own code alone: each video needs a
                               new renderer */
  float frame_rate;         /* frames a second of the video, 1..1000, default 25; smooth_lips needs it */
  float image_scale;        /* the head is rendered at this multiple of the picture's width and height, and upsampled
                               (bicubic) before it is composited over the background, which stays sharp; 0.25..1,
                               default 1 */
  bool no_torso;            /* true: a torso of the model is not drawn, as if the model were a head alone; default
                               false */
} ern_render_options;

/* The members of ern_render_options in their order, cookie and size left out (setting.h); NULL past the last. */
ERN_API const ern_setting *ern_render_setting(size_t index);

/* The defaults. */
ERN_API void ern_render_options_fill(ern_render_options *options, size_t bytes);
static inline ern_render_options ern_render_options_default(void) {
  ern_render_options options;
  ern_render_options_fill(&options, sizeof options);
  return options;
}

/* One renderer is used by one thread at a time; several may share a model and a backend. */
typedef struct ern_renderer ern_renderer;

/* `model` and `backend` must outlive the renderer. options NULL: the defaults. The renderer has the context of
 * `backend`: the texts of its errors are there. The model may have another context. */
ERN_API ERN_NODISCARD ern_status ern_renderer_create(ern_renderer **renderer, ern_backend *backend,
                                                     const ern_model *model, const ern_render_options *options);
ERN_API void ern_renderer_free(ern_renderer **renderer); /* accepts NULL and a pointer to NULL */

/* Checks that features fit the model: ERN_E_MISMATCH says both widths, or both lengths of a window where the model's
 * file says its own. `name` is for the message, such as the file. */
ERN_API ERN_NODISCARD ern_status ern_renderer_accepts(const ern_renderer *renderer, const ern_features *features,
                                                      const char *name);

/* Fewer samples, less accuracy: from now on the renderer skips each cell of the occupancy grid whose density (per
 * scene unit), evaluated at the centres of its eight octants, is below `density` for every one of `count` inputs. Each
 * input is a set of audio windows and an eye value of the speech to come. For example, where samples are 0.027 scene
 * units apart, a skipped sample of density 0.1 would have absorbed 0.3 % of the light. windows:
 * [count][8][window_length][width] (ern_audio_windows); eyes: [count], 0..1. Each call replaces the one before; density
 * 0 or count 0 skips nothing; with count 0 `windows` and `eyes` may be NULL, and window_length is ignored. Errors:
 * ERN_E_ARGUMENT, ERN_E_MISMATCH (window_length is not the model's), ERN_E_NONFINITE, ERN_E_NO_MEMORY. */
ERN_API ERN_NODISCARD ern_status ern_renderer_prune_occupancy(ern_renderer *renderer, const float *windows,
                                                              int window_length, const float *eyes, size_t count,
                                                              float density);

/* The audio code of windows [8][window_length][width], as a frame would have it without smooth_lips. The
 * silence code of a clip (ern_frame_input) is the mean of this code over its frames of weight 1 (ern_silence_weights).
 */
ERN_API ERN_NODISCARD ern_status ern_renderer_code(ern_renderer *renderer, const float *windows, int window_length,
                                                   float code[32]);

/* Takes note of a frame that is not rendered: smooth_lips of the frames after it uses its windows
 * [8][window_length][width], so that a part of a video begins as it would in the whole. Does nothing without
 * smooth_lips. Errors as ern_renderer_frame. */
ERN_API ERN_NODISCARD ern_status ern_renderer_skip(ern_renderer *renderer, const float *windows, int window_length);

/* Lets the frames from now on reuse parts of the frame before. Background and torso pictures are reused when the same
 * ones are handed in again, the model's own torso under the same pose. Rays of the head are reused while camera,
 * head_pose, size and individual stay the same, and the same of the outputs depth, attention and eye are wanted. A ray
 * without samples is not rendered again. After four frames in which all of these stayed the same, the rays with samples
 * are rendered at up to 16 keyframes: inputs chosen among `windows` and `eyes`, each as different as possible
 * from those chosen before. That takes as long as 16 frames. A ray that the other keyframes predict well at each
 * keyframe is interpolated from then on; every other ray is rendered in each frame.
 * bound: largest error of a pixel over a background, 0..1; 0.5/255 is half a grey level. It is measured at the
 * keyframes, with a margin. A frame that is farther from the keyframes than they are from each other is rendered whole.
 * 0: only what cannot change is reused. Below 0, as at the beginning: nothing is reused.
 * windows: [count][8][window_length][width] (ern_audio_windows), frames spread over the speech, the more the better;
 * eyes: [count], 0..1. For a bound of 0 or less count may be 0 and both NULL; window_length is ignored. The call
 * forgets what was kept before. Errors: ERN_E_ARGUMENT, ERN_E_MISMATCH (window_length is not the model's),
 * ERN_E_NONFINITE, ERN_E_NO_MEMORY. */
ERN_API ERN_NODISCARD ern_status ern_renderer_reuse_rays(ern_renderer *renderer, const float *windows,
                                                         int window_length, const float *eyes, size_t count,
                                                         float bound);

/* The work of the frames since ern_renderer_reuse_rays. Each keyframe adds 1 to `rays` and to `samples`, and nothing to
 * `frames`: rays/frames is the work of a frame in shares of a whole one, and may be above 1 in a short video.
 * Plain data, may grow. */
typedef struct ern_ray_reuse_work {
  uint64_t frames; /* that were rendered, without keyframes */
  double rays;    /* of each frame the share of its rays with samples that was rendered, 0..1, summed over the frames */
  double samples; /* likewise of their samples in occupied cells */
} ern_ray_reuse_work;

/* That work so far. */
ERN_API void ern_renderer_ray_reuse_work_sized(const ern_renderer *renderer, ern_ray_reuse_work *work, size_t bytes);
static inline ern_ray_reuse_work ern_renderer_ray_reuse_work(const ern_renderer *renderer) {
  ern_ray_reuse_work work;
  ern_renderer_ray_reuse_work_sized(renderer, &work, sizeof work);
  return work;
}

/* Instead of a row of the individual codes: their mean. A row is that of one training frame, and stands for all that
 * its pose, speech and eyes do not tell, such as where the body was. */
#define ERN_INDIVIDUAL_MEAN SIZE_MAX

/* A program sets what it does not use to 0, and `individual` to ERN_INDIVIDUAL_MEAN where the frame is no training
 * frame. Plain data, may grow. */
typedef struct ern_frame_input {
  ern_camera camera;      /* of the picture */
  const float *head_pose; /* [16] pose for the head alone, a refined one (ern_model_refine); NULL: the camera's */
  const float *windows; /* [8][window_length][ern_model_info.feature_width] (ern_audio_windows), each -1e30 to 1e30. The
                           width is not checked here: ern_renderer_accepts does that for the features */
  int window_length;    /* 1..16, that of ern_model_info where it is known */
  float eye;            /* 0 open .. 1 closed; ignored by a model without an eye branch */
  size_t individual;    /* 0..ern_model_info.codes - 1: the individual code of that training frame; ERN_INDIVIDUAL_MEAN:
                           the mean of all, for any other frame. Ignored by a model without codes */
  const uint8_t *background; /* [height][width][3] RGB; NULL: transparent */
  const uint8_t *torso; /* [height][width][4] RGBA, alpha not premultiplied, drawn between background and head; NULL:
                           none. A model with a torso draws its own over it. */
  const float *silence_code; /* [32] that of a clip (ern_renderer_code); may be NULL where silence_weight is 0 */
  float
      silence_weight; /* w, 0..1: the frame's audio code is (1 - w) speech code (after smooth_lips) + w silence_code */
  const uint8_t *wanted; /* [height][width]; 0: the head at this pixel is not needed, and may be left out to save time:
                            then all outputs are as where there is no head. NULL: all of it is needed */
  const float *torso_motion; /* [2][ERN_MOTION_SIDE][ERN_MOTION_SIDE] where the body is, each -1e3 to 1e3; ignored by a
                                model without torso motion. What the picture shows at (r, c), r down from -1 to 1 and c
                                to the right from -1 to 1, is in the body at (r + m_0, c + m_1); m is given at control
                                points, row by row, the first at (-1, -1), the last at (1, 1), and bilinear between
                                them. NULL: the model predicts it from the camera's pose */
} ern_frame_input;

/* Where to put the result; what a NULL member stands for is not computed. Memory is the caller's. Plain data, may grow.
 */
typedef struct ern_frame_output {
  uint8_t *rgba;    /* [height][width][4]; alpha 255 over a background, else straight (not premultiplied) */
  float *rgb;       /* [height][width][3] in [0, 1]; premultiplied where there is no background */
  float *alpha;     /* [height][width], 0..1, of the whole picture */
  float *opacity;   /* [height][width], 0..1, of the head alone: sum of weights */
  float *depth;     /* [height][width] sum of weight * distance from the camera, scene units; 0 without samples */
  float *attention; /* [height][width] sum over samples of the Euclidean norm of the weights that
                       multiply the speech's vector; zeros with ERN_ATTENTION_CONCAT */
  float *eye;       /* [height][width] sum over samples of the eye attention; zeros without one */
} ern_frame_output;

/* Plain data, may grow. */
typedef struct ern_frame_times {
  double audio, torso, head, output; /* milliseconds: code of the frame, torso layer, head, conversion and read-back; of
                                        an OpenCL device by its own clock, other renderers' work on it included */
  double samples; /* number of samples whose density was computed for the head. NaN: unknown, as an OpenCL device's
                     fused pass does not count them, or all rays were reused (ern_renderer_reuse_rays) */
} ern_frame_times;

/* Renders one frame. times may be NULL. Errors: ERN_E_ARGUMENT names the field; ERN_E_MISMATCH: window_length is not
 * the model's; ERN_E_NONFINITE: a pose, window or silence_code is not finite, or the audio code or an output is not
 * (values too large; never black pixels instead); ERN_E_NO_MEMORY; ERN_E_DEVICE: an OpenCL device failed. */
ERN_API ERN_NODISCARD ern_status ern_renderer_frame_sized(ern_renderer *renderer, const ern_frame_input *input,
                                                          size_t input_bytes, const ern_frame_output *output,
                                                          size_t output_bytes, ern_frame_times *times,
                                                          size_t times_bytes);
static inline ERN_NODISCARD ern_status ern_renderer_frame(ern_renderer *renderer, const ern_frame_input *input,
                                                          const ern_frame_output *output, ern_frame_times *times) {
  return ern_renderer_frame_sized(renderer, input, sizeof *input, output, sizeof *output, times, sizeof *times);
}

/* ---- holding a rate ---------------------------------------------------------------------------------------------- */

/* Chooses for each frame one of several settings of known cost, such as renderers with different options: the most
 * accurate one that holds the budget at the machine's present speed. Time over the budget is recovered over the next 12
 * frames: the controller switches at once to a setting that is cheap enough for that. Time under the budget is
 * credited, for at most 8 frames. It switches back to a more accurate setting after 12 frames in a row in which that
 * would have met the budget. Plain data, final: copy it, drop it. */
typedef struct ern_rate_controller {
  const double *cost; /* [count] ms a frame where nothing else runs, > 0; the most accurate setting first, each cheaper
                         than the one before; the caller's */
  size_t count;       /* >= 1 */
  double budget;      /* ms a frame, > 0 */
  size_t at;          /* the setting to use now */
  double slowness;    /* time of a frame over its cost: a running mean in which the newest frame has weight 0.2 */
  double late;        /* ms behind the budget, at most 24 frames' budget; negative: ahead, at most 8 frames' budget */
  int calm;           /* frames in a row in which a better setting would have fitted */
  size_t better;      /* the one that would have fitted in all of them */
} ern_rate_controller;

/* A list that is NULL or empty makes a controller of zeros, which stays at setting 0 and holds nothing. */
ERN_API void ern_rate_controller_begin(ern_rate_controller *controller, const double *cost, size_t count,
                                       double budget);

/* Tells how long the frame with setting controller->at took: ms from the end of the frame before to its own end. Gives
 * the setting for the next frame. A time that is not a positive number is ignored. */
ERN_API size_t ern_rate_controller_next(ern_rate_controller *controller, double milliseconds);

/* Whether the cheapest setting holds the budget at the machine's present speed. */
ERN_API bool ern_rate_controller_holds(const ern_rate_controller *controller);

/* ---- evaluation -------------------------------------------------------------------------------------------------- */

/* 10 log10(1/MSE) of rgb [height][width][3] in [0, 1] against bytes/255, inside the box (NULL: all), of which the part
 * in the picture counts; 100 dB at most, and where no pixel counts. NaN where rgb or truth is NULL, or a side is
 * below 1. */
ERN_API double ern_psnr(const float *rgb, const uint8_t *truth, int width, int height, const ern_box *box);

/* Mean SSIM (Wang et al. 2004): 11 x 11 Gaussian window, sigma 1.5, K 0.01 and 0.03, per channel, windows inside the
 * picture alone; pictures under 11 pixels a side give ERN_E_ARGUMENT. */
ERN_API ERN_NODISCARD ern_status ern_ssim(ern_context *context, const float *rgb, const uint8_t *truth, int width,
                                          int height, double *ssim);

#ifdef __cplusplus
}
#endif
#endif
