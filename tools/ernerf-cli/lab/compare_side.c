/* SPDX-License-Identifier: MIT */
#include "lab/compare_side.h"

#include <stdlib.h>
#include <string.h>
#include <strings.h>

enum { CLIP_RATE = 25 };

bool compare_side_is_video(const char *path) {
  static const char *const endings[] = {".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".mpg", ".mpeg",
                                        ".ts",  ".mts", ".flv", ".wmv", ".ogv",  ".y4m", ".nut"};
  const char *dot = strrchr(path, '.');
  for (size_t i = 0; dot != NULL && i < sizeof endings / sizeof *endings; i++)
    if (strcasecmp(dot, endings[i]) == 0) return true;
  return false;
}

const char *compare_side_kind(const struct compare_side *side) {
  return side->video ? "video" : portrait_kind(&side->portrait);
}

/* ---- pictures of a video ----------------------------------------------------------------------------------------- */

static int open_reader(struct compare_side *side, struct session *session) {
  ern_video_reader_free(&side->reader);
  side->next = 0;
  const char *path = side->portrait.model_path;
  return ern_video_reader_open(session->context, path, &side->reader) == ERN_OK ? 0 : session_fail(session);
}

static int check_size(const struct compare_side *side, struct session *session, int width, int height) {
  const ern_clip_info *info = &side->evaluation.info;
  if (width == info->width && height == info->height) return 0;
  return session_fail_with(session, "%s: its pictures are %d x %d, expected %d x %d, as the frames of %s",
                           side->portrait.model_path, width, height, info->width, info->height,
                           side->portrait.source.path);
}

static int next_picture(struct compare_side *side, struct session *session, bool *end) {
  double seconds;
  if (ern_video_reader_frame(side->reader, &side->picture, &seconds, end) != ERN_OK) return session_fail(session);
  if (*end) return 0;
  side->next++;
  return check_size(side, session, side->picture.width, side->picture.height);
}

/* Reports that the video ends before picture `expected - 1`. */
static int refuse_short(const struct compare_side *side, struct session *session, size_t expected) {
  static const char *const splits[] = {"training frames", "validation frames", "frames"};
  const struct portrait *portrait = &side->portrait;
  return session_fail_with(session,
                           "%s: has %zu pictures, expected %zu: its k-th is taken for the k-th of the %s of %s, which "
                           "--split and --frames choose",
                           portrait->model_path, side->next, expected, splits[portrait->split], portrait->source.path);
}

/* Reads the video up to the last needed picture; `whole`: all frames of the split are used, so the video must end
 * there. */
static int count_pictures(struct compare_side *side, struct session *session, size_t wanted, bool whole) {
  ern_video_info info;
  bool end = false;
  if (open_reader(side, session) != 0) return EXIT_FAILURE;
  ern_video_reader_info(side->reader, &info);
  if (check_size(side, session, info.width, info.height) != 0) return EXIT_FAILURE;
  while (side->next < wanted) {
    if (session_interrupted()) return session_stop_with(session, "stopped, nothing was written");
    if (next_picture(side, session, &end) != 0) return EXIT_FAILURE;
    if (end) return refuse_short(side, session, wanted);
  }
  if (whole && next_picture(side, session, &end) != 0) return EXIT_FAILURE;
  if (whole && !end)
    session_warn(session, "%s: has more than the %zu pictures that there are frames for; the first %zu are taken",
                 side->portrait.model_path, wanted, wanted);
  if (info.rate_denominator > 0 && info.rate_numerator != CLIP_RATE * info.rate_denominator)
    session_warn(session, "%s: has %.5g pictures a second, and the clip %d; its k-th is taken for the k-th frame",
                 side->portrait.model_path, (double)info.rate_numerator / info.rate_denominator, (int)CLIP_RATE);
  return 0;
}

/* Reads picture `number` into rgb and rgba; for an earlier picture, reopens the video at its beginning. */
static int read_picture(struct compare_side *side, size_t number) {
  struct session *session = side->evaluation.session;
  const size_t pixels = (size_t)side->evaluation.info.width * (size_t)side->evaluation.info.height;
  bool end = false;
  if ((side->reader == NULL || side->next > number) && open_reader(side, session) != 0) return EXIT_FAILURE;
  while (side->next <= number) {
    if (next_picture(side, session, &end) != 0) return EXIT_FAILURE;
    if (end) return refuse_short(side, session, number + 1);
  }
  for (size_t i = 0; i < pixels; i++) {
    const uint8_t *from = side->picture.data + 3 * i;
    uint8_t *to = side->evaluation.rgba + 4 * i;
    memcpy(to, from, 3);
    to[3] = 255;
    for (size_t c = 0; c < 3; c++) side->evaluation.rgb[3 * i + c] = (float)from[c] / 255;
  }
  return 0;
}

/* ---- both -------------------------------------------------------------------------------------------------------- */

static int open_video(struct compare_side *side, struct session *session, const struct args *args, ern_clip *clip) {
  const struct portrait *portrait = &side->portrait;
  struct evaluation *evaluation = &side->evaluation;
  int status =
      evaluate_open(evaluation, session, clip, (enum frame_source_split)portrait->split, 1, ERN_AUDIO_PAD_EDGE);
  if (status != 0) return status;
  evaluation->measures = &side->measures;
  side->measures.flow = session->context;
  const size_t all = evaluation->frame_source.count;
  if (args_given(args, "frames")) status = frame_source_cut(&evaluation->frame_source, args, &portrait->frames);
  if (status != 0) return status;
  const size_t last = evaluation->frame_source.source_frame[evaluation->frame_source.count - 1].number;
  return count_pictures(side, session, last + 1, last + 1 == all);
}

int compare_side_open(struct compare_side *side, struct session *session, const struct args *args,
                      const struct portrait *asked, const char *path, ern_clip *clip) {
  side->portrait = *asked;
  side->portrait.model_path = path;
  side->video = compare_side_is_video(path);
  return side->video ? open_video(side, session, args, clip)
                     : evaluate_open_portrait(&side->evaluation, &side->portrait, session, args, &side->measures);
}

int compare_side_draw(struct compare_side *side, size_t k, struct evaluated *evaluated) {
  if (!side->video)
    return evaluate_draw(&side->evaluation, side->portrait.renderer, side->portrait.model, k, evaluated);
  *evaluated = (struct evaluated){.has_head = false};
  return read_picture(side, side->evaluation.frame_source.source_frame[k].number);
}

void compare_side_close(struct compare_side *side, struct session *session) {
  ern_video_reader_free(&side->reader);
  ern_image_free(session->context, &side->picture);
  evaluate_close(&side->evaluation);
  measures_free(&side->measures);
  portrait_close(&side->portrait);
}
