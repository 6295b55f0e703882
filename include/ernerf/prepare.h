/* SPDX-License-Identifier: MIT
 * libernerf-prepare: from the video of a person to the clip that a training takes (docs/prepare.md). */
#ifndef ERNERF_PREPARE_H
#define ERNERF_PREPARE_H

#include "ernerf/base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Plain data, may grow. Strings must outlive the call. */
typedef struct ern_prepare_options {
  uint32_t cookie, size; /* set by ern_prepare_options_default() */
  double from, to;       /* seconds of the video, 0 <= from < to; to 0: its end */
  int side;              /* pixels a side of the clip's pictures, 128..1024; 512 is the default */
  /* Pixels of the clip, focal length; 0: 1100/450 of a side, as the public tracking has it, or that of `poses`. */
  double focal;
  bool head_only; /* the clip gets empty torso pictures, and the frames show the head alone */
  /* One step alone, and again if it was done: "face", "pose", "landmarks", "layers", "eyes", "features". NULL: every
   * step that is not done yet. */
  const char *only;
  const char *background; /* a picture of what is behind the person, or "key": a screen of one colour. NULL: found */
  /* What the user brings in place of a step's own result, NULL: nothing. */
  /* A folder of ID.lms (68 lines "x y", pixels of the clip); or FILE.csv, OpenFace's table of the video: x_0..x_67,
   * y_0..y_67, timestamp, success; or a network, FILE.onnx. They place the eyes for the step "pose" too. */
  const char *landmarks;
  const char *poses; /* a transforms_*.json of all frames */
  const char *masks; /* a folder of ID.png in AD-NeRF's colours (docs/prepare.md), or a network, FILE.onnx */
  const char *au;    /* a table with a column AU45_r: by its timestamp, seconds of the video; a row a frame without */
  const char *features; /* a .npy of speech features */
  bool anew;            /* what an earlier call made in the folder is made again, from whatever video */
  /* Called now and then; a non-zero answer cancels (ERN_E_CANCELLED), and what is done stays. NULL: none. */
  int (*progress)(void *user, const char *step, size_t done, size_t total);
  void *user;
  /* The best stretch of a long video, by the face's places and the sound: "auto": 180 s of a part that is longer than
   * 300 s, or the seconds that are wanted, "1" to "7200". NULL: the whole part. */
  const char *segment;
  /* A network that finds faces and eyes, FILE.onnx: YuNet (docs/prepare.md). NULL: OpenCV's cascades. */
  const char *detector;
} ern_prepare_options;

ERN_API void ern_prepare_options_fill(ern_prepare_options *options, size_t bytes);
static inline ern_prepare_options ern_prepare_options_default(void) {
  ern_prepare_options options;
  ern_prepare_options_fill(&options, sizeof options);
  return options;
}

/* How far the result of a step is to be trusted. */
typedef enum ern_prepare_grade {
  ERN_PREPARE_GOOD = 0,
  ERN_PREPARE_DOUBTFUL = 1, /* a training may be worth its time; the words say what is wrong and what helps */
  ERN_PREPARE_REFUSED = 2
} ern_prepare_grade;

enum { ERN_PREPARE_STEPS = 6, ERN_PREPARE_WORDS = 512 };

/* Plain data, final. */
typedef struct ern_prepare_verdict {
  const char *step; /* a name as in ern_prepare_options.only; NULL: the step was not reached */
  ern_prepare_grade grade;
  char words[ERN_PREPARE_WORDS]; /* why, and what to do; "" where good */
} ern_prepare_verdict;

/* Plain data, may grow. */
typedef struct ern_prepare_result {
  size_t frames; /* of the clip */
  ern_prepare_verdict verdicts[ERN_PREPARE_STEPS];
} ern_prepare_result;

/* Makes the clip `folder` of a video that FFmpeg reads, step by step, and its report. A step that an earlier call did
 * with the same options, and whose files are all there, is not done again. The folder must not exist, be empty, or be
 * of an earlier call for the same video and the same from, to and side (else ERN_E_EXISTS; see `anew`), and stay in its
 * place until the call ends (else ERN_E_IO). What the user brings is read before a step that needs it takes away what
 * an earlier call made. *result is filled also on failure. A step whose verdict is "refused" ends the call with
 * ERN_E_UNSUPPORTED and its words; the report is written then too, unless "face" is refused in a folder with a clip of
 * an earlier call, which stays as it is. Files there by a clip's names that no call made are refused (ERN_E_EXISTS; see
 * `anew`). Uses the threads of OpenCV and Ceres Solver. */
ERN_API ERN_NODISCARD ern_status ern_prepare_sized(ern_context *context, const char *video, const char *folder,
                                                   const ern_prepare_options *options, ern_prepare_result *result,
                                                   size_t bytes);
static inline ERN_NODISCARD ern_status ern_prepare(ern_context *context, const char *video, const char *folder,
                                                   const ern_prepare_options *options, ern_prepare_result *result) {
  return ern_prepare_sized(context, video, folder, options, result, sizeof *result);
}

#ifdef __cplusplus
}
#endif
#endif
