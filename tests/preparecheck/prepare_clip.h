/* SPDX-License-Identifier: MIT
 * The data that preparecheck reads from a clip's folder. */
#ifndef ERN_TESTS_PREPARE_CLIP_H
#define ERN_TESTS_PREPARE_CLIP_H

#include "core/status.h"
#include "prepare_measures.h"

struct prepared_clip {
  const char *folder;
  struct head_pose *poses; /* [count], by frame */
  size_t count;
  double focal; /* pixels of the clip */
  int width, height;
  struct crop crop; /* from prepare.json; without it the whole picture */
  float *closed;    /* [frames]: AU45_r of au.csv, else blink of curves.csv; row i: frame i. NULL: neither file */
  size_t frames;
};

/* Reads the poses of both transforms files. On success the caller owns the clip (prepared_clip_free). */
ERN_NODISCARD ern_status prepared_clip_read(ern_context *context, const char *folder, struct prepared_clip *clip);
void prepared_clip_free(ern_context *context, struct prepared_clip *clip);

#endif
