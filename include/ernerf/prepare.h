/* SPDX-License-Identifier: MIT
 * libernerf-prepare: from the video of a person to the clip that a training takes (docs/prepare.md). */
#ifndef ERNERF_PREPARE_H
#define ERNERF_PREPARE_H

#include "ernerf/setting.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Plain data, may grow. Strings must outlive the call. */
typedef struct ern_prepare_options {
  uint32_t cookie, size; /* set by ern_prepare_options_default() */
  double from, to;       /* seconds of the video, 0 <= from < to; to = 0 (default): the end of the video */
  int side;              /* pixels a side of the clip's pictures, 128..1024; 512 is the default */
  /* Focal length in pixels of the clip. 0: that of `poses` where given, else 1100/450 of a side, as the face
   * tracking of the public program's preprocessing has it. Not both a focal length and `poses`. */
  double focal;
  bool head_only; /* the torso pictures are fully transparent, and the frames show the head over the background */
  /* Do this step only, even if it is done: "face", "pose", "landmarks", "layers", "eyes" or "features". The steps
   * before it must be done, else ERN_E_STATE. The steps that read its files are then to be done again. NULL: do every
   * step that is not done. */
  const char *only;
  const char *background; /* a picture of what is behind the person, or "key": a screen of one colour. NULL: found */
  /* The next five members, `landmarks` to `features`, are files of the user that replace what a step would compute;
   * NULL: none. landmarks: a folder of ID.lms (68 lines "x y", pixels of the clip); or FILE.csv, OpenFace's table of
   * the video: x_0..x_67, y_0..y_67, timestamp, success; or a network, FILE.onnx. They place the eyes for the step
   * "pose" too. */
  const char *landmarks;
  const char *poses; /* a transforms_*.json with a pose for each frame, translations in metres */
  const char *masks; /* a folder of ID.png in AD-NeRF's colours (docs/prepare.md), or a network, FILE.onnx */
  const char *au; /* a table with a column AU45_r. Rows belong to frames by a column `timestamp`, seconds of the video;
                     without one, row k to frame k of the clip */
  const char *features; /* a .npy of speech features */
  bool anew;            /* overwrite: take a folder of another video or other options too, discard what earlier calls
                           made in it, and replace the user's own files there that have the name of a file of a clip.
                           ERN_E_EXISTS even then: a folder that has files but no prepare.json */
  /* Called now and then, on the thread of the call: `done` of `total` units of work of the step, whose name is one of
   * `only`, or "overlay" while overlay.mp4 is written. A non-zero answer cancels (ERN_E_CANCELLED), and what is done
   * stays. NULL: none. */
  int (*progress)(void *user, const char *step, size_t done, size_t total);
  void *user; /* handed to `progress` */
  /* Take only the best stretch of from..to: without a cut, with a face that is seen and moves, and loud sound. "auto":
   * 180 s where from..to is longer than 300 s, else all of it; "1" to "1800": so many seconds, or all of it
   * where it is not longer. NULL: all of it. */
  const char *segment;
  /* A network that finds faces and eyes, FILE.onnx: YuNet (docs/prepare.md). NULL: OpenCV's cascades. */
  const char *detector;
  /* How much later the sound of the video is than the mouth, which aud.wav makes up for: seconds, "-2" to "2", below 0
   * where it is earlier. "auto" or NULL (default): what the step "features" measures, where it is certain, else 0. */
  const char *sound_offset;
} ern_prepare_options;

/* The members of ern_prepare_options in their order, cookie and size left out (setting.h); NULL past the last. */
ERN_API const ern_setting *ern_prepare_setting(size_t index);

/* The defaults. */
ERN_API void ern_prepare_options_fill(ern_prepare_options *options, size_t bytes);
static inline ern_prepare_options ern_prepare_options_default(void) {
  ern_prepare_options options;
  ern_prepare_options_fill(&options, sizeof options);
  return options;
}

/* How reliable the result of a step is. */
typedef enum ern_prepare_grade {
  ERN_PREPARE_GOOD = 0,
  ERN_PREPARE_DOUBTFUL = 1, /* usable, but a training may give a poor result; words: what is wrong and what helps */
  ERN_PREPARE_REFUSED = 2   /* not usable; the call ends */
} ern_prepare_grade;

enum { ERN_PREPARE_STEPS = 6, ERN_PREPARE_WORDS = 512 };

/* Plain data, final. */
typedef struct ern_prepare_verdict {
  const char *step;              /* a name as in ern_prepare_options.only; NULL: the step is not done */
  ern_prepare_grade grade;       /* of the step's result */
  char words[ERN_PREPARE_WORDS]; /* why, and what to do; where good "" or a remark, such as that no blink was found */
} ern_prepare_verdict;

/* Plain data, may grow. */
typedef struct ern_prepare_result {
  size_t frames;                                   /* of the clip */
  ern_prepare_verdict verdicts[ERN_PREPARE_STEPS]; /* face, pose, landmarks, layers, eyes, features */
} ern_prepare_result;

/* Makes the clip `folder` of a video that FFmpeg reads, and writes its report. A step is skipped if an earlier call did
 * it with the same options and all its files are there.
 * The folder must be absent, empty, or made by an earlier call for the same video (same size in bytes and time of
 * modification), from, to, side and segment; else ERN_E_EXISTS (see `anew`). ERN_E_EXISTS too where a file in it has
 * the name of a clip's file and no call made it, or it was changed since. ERN_E_BUSY: another call works in the folder.
 * ERN_E_ARGUMENT: the video, or a file that an option names, lies in the folder. ERN_E_IO: the folder was moved during
 * the call. Files of the user's are read before a step that
 * needs them removes anything. *result is filled on failure too. A refused step ends the call with ERN_E_UNSUPPORTED,
 * and its words are the message. The report is written then too, with one exception: where "face" is refused, the clip
 * of an earlier call stays as it is, with its report. Uses the threads of OpenCV. On one machine the files have the
 * same bytes for any number of them. */
ERN_API ERN_NODISCARD ern_status ern_prepare_sized(ern_context *context, const char *video, const char *folder,
                                                   const ern_prepare_options *options, ern_prepare_result *result,
                                                   size_t bytes);
static inline ERN_NODISCARD ern_status ern_prepare(ern_context *context, const char *video, const char *folder,
                                                   const ern_prepare_options *options, ern_prepare_result *result) {
  return ern_prepare_sized(context, video, folder, options, result, sizeof *result);
}

/* ---- landmarks --------------------------------------------------------------------------------------------------- */

/* A network that finds the landmarks of a face, FILE.onnx: a square picture of three channels in, x and y of 68 points
 * (300-W) or of 98 (WFLW) out (docs/prepare.md). The file does not say which range of colours, which crop around the
 * face and which unit of the points the network uses. So a program calls _learn with a few pictures whose points are
 * roughly known (`ernerf eval` takes six), then _decide once, then _find for any picture. It uses its context until it
 * is freed (base.h). One thread at a time uses it. */
typedef struct ern_landmark_network ern_landmark_network;

/* On success the caller owns *network. */
ERN_API ERN_NODISCARD ern_status ern_landmark_network_open(ern_context *context, const char *path,
                                                           ern_landmark_network **network);
ERN_API void ern_landmark_network_free(ern_landmark_network **network);
/* Tries all combinations of colour range, crop and unit of the points on a picture, rgb[height][width][3] with sides of
 * 1 to 8192. guess: about where the 68 points are, x and y in pixels. ERN_E_UNSUPPORTED where the network cannot be
 * computed, has no output of 68 or 98 points, or where the guess lies far outside the picture. */
ERN_API ERN_NODISCARD ern_status ern_landmark_network_learn(ern_landmark_network *network, const uint8_t *rgb,
                                                            int width, int height, const float guess[68][2]);
/* Keeps the combination whose points were nearest to the guesses. ERN_E_UNSUPPORTED: none was near, or nothing was
 * learnt. */
ERN_API ERN_NODISCARD ern_status ern_landmark_network_decide(ern_landmark_network *network);
/* points: those of a picture, x and y in pixels. The guess only places the square that is cut out for the network.
 * ERN_E_STATE before _decide. */
ERN_API ERN_NODISCARD ern_status ern_landmark_network_find(ern_landmark_network *network, const uint8_t *rgb, int width,
                                                           int height, const float guess[68][2], float points[68][2]);

#ifdef __cplusplus
}
#endif
#endif
