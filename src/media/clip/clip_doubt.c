/* SPDX-License-Identifier: MIT
 * What looks wrong in a clip whose files are well formed. */
#include <inttypes.h>
#include <math.h>

#include "core/format.h"
#include "core/memory.h"
#include "io/landmarks.h"
#include "io/speech_share.h"
#include "media/clip/clip.h"

enum { LOOKED_MOST = 48, PARSED_MOST = 8, SENTENCE_BYTES = 512 };

/* Outer corners of the eyes this near each other, in shares of the picture's width, belong to no face that a head can
 * be learnt from. */
static const double least_face = 0.02;

struct doubts {
  ern_context *context;
  const char *folder;
  const ern_pose_list *train;
  void (*say)(void *user, const char *sentence);
  void *user;
};

/* Whether a frame's file is doubtful; *wrong stays false where it cannot be read. */
typedef ern_status look(const struct doubts *doubts, const char *path, bool *wrong);

static ern_status look_at_landmarks(const struct doubts *doubts, const char *path, bool *wrong) {
  enum { EYE_RIGHT = 36, EYE_LEFT = 45 };
  float p[ERN_LANDMARKS][2];
  const ern_status status = ern_landmarks_read(doubts->context, path, p);
  if (status != ERN_OK) return status;
  const double size[2] = {doubts->train->width, doubts->train->height};
  *wrong =
      hypot((double)p[EYE_LEFT][0] - p[EYE_RIGHT][0], (double)p[EYE_LEFT][1] - p[EYE_RIGHT][1]) < least_face * size[0];
  for (int c = 0; c < 2; c++) {
    const double middle = ((double)p[EYE_LEFT][c] + p[EYE_RIGHT][c]) / 2;
    *wrong = *wrong || middle < 0 || middle > size[c];
  }
  return ERN_OK;
}

static ern_status look_at_parsing(const struct doubts *doubts, const char *path, bool *wrong) {
  ern_image image = {0};
  const ern_status status = ern_image_read(doubts->context, path, 3, &image);
  if (status != ERN_OK) return status;
  const size_t pixels = (size_t)image.width * (size_t)image.height;
  size_t head = 0, background = 0;
  for (size_t i = 0; i < pixels; i++) {
    const uint8_t *rgb = image.data + 3 * i;
    head += ern_clip_is_head(rgb);
    background += rgb[0] >= 128 && rgb[1] >= 128;
  }
  *wrong = head == 0 || background == 0;
  ern_image_free(doubts->context, &image);
  return ERN_OK;
}

/* Looks at no more than `most` frames' files of one part, evenly spaced. `what` is wrong with the doubtful ones. */
static ern_status look_at(const struct doubts *doubts, ern_clip_part part, size_t most, look *at, const char *what) {
  const size_t count = doubts->train->count, looked = count < most ? count : most;
  size_t wrong = 0;
  int64_t first = 0;
  for (size_t i = 0; i < looked; i++) {
    const int64_t img_id = doubts->train->poses[i * count / looked].img_id;
    char *path = NULL;
    bool odd = false;
    ern_status status = ern_clip_part_path(doubts->context, doubts->folder, part, img_id, &path);
    if (status == ERN_OK) status = at(doubts, path, &odd);
    ern_release(doubts->context, path);
    if (status == ERN_E_NO_MEMORY) return status;
    if (odd && wrong++ == 0) first = img_id;
  }
  if (wrong == 0) return ERN_OK;
  char sentence[SENTENCE_BYTES];
  ern_format(sentence, sizeof sentence, "%s: in %zu of %zu frames that were looked at %s; the first is %" PRId64,
             ern_clip_content(part), wrong, looked, what, first);
  doubts->say(doubts->user, sentence);
  return ERN_OK;
}

static ern_status listen(const struct doubts *doubts) {
  char *path = NULL, sentence[SENTENCE_BYTES];
  ern_sound sound = {0};
  ern_status status = ern_clip_path(doubts->context, doubts->folder, ERN_CLIP_SOUND, &path);
  if (status == ERN_OK) status = ern_sound_read(doubts->context, path, &sound);
  ern_release(doubts->context, path);
  if (status != ERN_OK) return status == ERN_E_NO_MEMORY ? status : ERN_OK;
  const double share = ern_speech_share(&sound);
  if (sound.frames > 0 && share < ERN_SPEECH_SHARE) {
    ern_format(
        sentence, sizeof sentence,
        "aud.wav: speech is heard in %.0f %% of the time, expected %.0f %% or more; a mouth is learnt from speech",
        100 * share, 100 * ERN_SPEECH_SHARE);
    doubts->say(doubts->user, sentence);
  }
  ern_sound_free(doubts->context, &sound);
  return ERN_OK;
}

ern_status ern_clip_doubts(ern_context *context, const char *folder, const ern_pose_list *train,
                           void (*say)(void *user, const char *sentence), void *user) {
  const struct doubts doubts = {context, folder, train, say, user};
  ern_status status = ERN_OK;
  ERN_TRY(look_at(&doubts, ERN_PART_LANDMARKS, LOOKED_MOST, look_at_landmarks,
                  "the landmarks are no face within the picture"));
  ERN_TRY(look_at(&doubts, ERN_PART_PARSING, PARSED_MOST, look_at_parsing, "the mask has no head, or no background"));
  ERN_TRY(listen(&doubts));
fail:
  return status;
}
