/* SPDX-License-Identifier: MIT
 * A synthetic clip, for training and tests. */
#ifndef ERNERF_LAB_SYNTH_H
#define ERNERF_LAB_SYNTH_H

#include "ernerf-lab/spoken.h"

/* What stands behind the person: a window and a shelf; one colour with a soft gradient; many small things of high
 * contrast, some in the colours of the person's skin and hair. */
enum ern_synth_room { ERN_SYNTH_BOOKS, ERN_SYNTH_PLAIN, ERN_SYNTH_CLUTTERED };

/* Faults that make a video hard to prepare. Poses, landmarks and layers still describe what is visible. */
enum ern_synth_fault {
  ERN_SYNTH_NO_FAULT,
  ERN_SYNTH_CAMERA,  /* a hand-held camera pans and nods by `strength` degrees; bc.jpg is what it sees at rest */
  ERN_SYNTH_OCCLUDE, /* a rod of the skin's colour, `strength` hundredths of the side wide, passes before the face in
                        the middle third; it is background in parsing/ */
  ERN_SYNTH_PROFILE, /* the head is turned by `strength` degrees in the middle third */
  ERN_SYNTH_STILL,   /* the last `strength` hundredths of the clip are one frame, repeated */
  ERN_SYNTH_CUT      /* the last `strength` hundredths are another person in another room */
};

typedef struct ern_synth_options {
  uint32_t cookie;
  int size;   /* pixels a side, 64..1080 */
  int frames; /* 8..100000; one in eleven, at least one, is for validation; 0: the duration of the text */
  uint64_t seed;
  bool blink;         /* without: no au.csv, eyes stay open */
  bool torso;         /* without: empty (fully transparent) torso_imgs, only the head and the background in gt_imgs */
  bool moving_camera; /* without: every frame has the first frame's pose */
  /* A file of UTF-8, at most 1 MiB. NULL: syllables of the seed, with their features. A text is spoken by espeak-ng
   * (spoken.h) into aud.wav, the jaw follows its phonemes, and there is no file of features. The seed still chooses the
   * person and the motion of the head. */
  const char *text_file;
  ern_spoken_options spoken;
  /* Degrees, 1..40: the largest yaw of the clip, with nods up to a half and tilts up to a third of it; 0: the seed's,
   * below 12. */
  double turn;
  enum ern_synth_room room;
  /* parsing/ID.png, RGB, AD-NeRF's colours: head (with hair and ears) 0,0,255; neck (bare skin below it) 0,255,0; torso
   * 255,0,0; background 255,255,255. A pixel belongs to the topmost layer whose alpha is at least 0.5. */
  bool parsing;
  /* Also writes the clip as an mp4 with its sound, from the frames before JPEG compression. The path lies outside the
   * folder, or in an existing one. NULL: none. */
  const char *video;
  int crf; /* of the video, H.264, 0..51 */
  enum ern_synth_fault fault;
  double strength; /* 0.1..100, of the fault */
  /* Called after each frame; a non-zero answer cancels (ERN_E_CANCELLED). NULL: none. */
  int (*progress)(void *user, int done, int total);
  void *user;
} ern_synth_options;

ern_synth_options ern_synth_options_default(void);

/* Writes a whole preprocessed clip to `folder`, which must not exist or be empty. Same options: same bytes. After an
 * error the folder is as before; ERN_E_EXISTS: a file of others appeared there, and all files stay. */
ERN_NODISCARD ern_status ern_synth_write(ern_context *context, const char *folder, const ern_synth_options *options);

#endif
