/* SPDX-License-Identifier: MIT
 * ernerf compare: compares two portraits on the same frames. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lab/compare.h"
#include "lab/compare_files.h"
#include "output/plot.h"
#include "session/progress.h"
#include "verbs.h"

/* PICTURE_BYTES: memory for the clip's pictures without `memory`: practically none, as each is read only a few times in
 * a row. */
enum { OWN_OPTIONS = 2 + LPIPS_OPTIONS, PICTURE_BYTES = 1 };

/* ---- opening ----------------------------------------------------------------------------------------------------- */

/* Opens models first: a video is compared with the clip of a model, if there is one. */
static int open_sides(struct compare *c, const struct args *args) {
  struct session *session = &c->session;
  bool video[COMPARE_SIDES];
  int status = 0;
  for (size_t side = 0; side < COMPARE_SIDES; side++) video[side] = compare_side_is_video(c->path[side]);
  struct clip_source *source = &c->asked.source;
  if (source->memory == 0) source->memory = PICTURE_BYTES;
  if (!video[0] && !video[1]) source->memory = (source->memory + 1) / 2; /* each has a clip of its own */
  for (size_t side = 0; side < COMPARE_SIDES && status == 0; side++)
    if (!video[side]) status = compare_side_open(&c->side[side], session, args, &c->asked, c->path[side], NULL);
  ern_clip *clip = video[0] ? c->side[1].portrait.clip : c->side[0].portrait.clip;
  if (status == 0 && video[0] && video[1]) {
    status = clip_source_open(source, session, &c->clip);
    clip = c->clip;
  }
  for (size_t side = 0; side < COMPARE_SIDES && status == 0; side++)
    if (video[side]) status = compare_side_open(&c->side[side], session, args, &c->asked, c->path[side], clip);
  return status;
}

static int open_all(struct compare *c, const struct args *args) {
  if (compare_files_check(c) != 0) return EXIT_FAILURE;
  const int status = open_sides(c, args);
  if (status != 0) return status;
  if (perceptual_distance_open(&c->perceptual, &c->side[0].evaluation) != 0) return EXIT_FAILURE;
  for (size_t side = 0; side < COMPARE_SIDES; side++) {
    const bool lpips = c->perceptual.weights.lpips != NULL;
    if (lpips) c->lpips[side] = calloc(compare_frames(c), sizeof *c->lpips[side]);
    c->evaluated[side] = calloc(compare_frames(c), sizeof *c->evaluated[side]);
    if (c->evaluated[side] == NULL || (lpips && c->lpips[side] == NULL))
      return session_fail_with(&c->session, "no memory for the figures of %zu frames", compare_frames(c));
  }
  return compare_files_open(c);
}

/* ---- the verb ---------------------------------------------------------------------------------------------------- */

/* Draws frame k, or reads it, and evaluates it. */
static int evaluate_side(struct compare *c, size_t side, size_t k) {
  struct compare_side *of = &c->side[side];
  if (compare_side_draw(of, k, &c->evaluated[side][k]) != 0 ||
      evaluate_picture(&of->evaluation, k, &c->evaluated[side][k]) != 0)
    return EXIT_FAILURE;
  return c->lpips[side] != NULL ? perceptual_distance_of(&c->perceptual, &of->evaluation, k, &c->lpips[side][k]) : 0;
}

static int compare_all(struct compare *c) {
  struct session *session = &c->session;
  struct progress progress;
  const size_t count = compare_frames(c);
  const uint8_t *drawn[COMPARE_SIDES];
  for (size_t side = 0; side < COMPARE_SIDES; side++) drawn[side] = c->side[side].evaluation.rgba;
  progress_begin(&progress, session, "compare", "frames");
  for (size_t k = 0; k < count; k++) {
    if (session_interrupted())
      return session_stop_with(session, "stopped at frame %zu of %zu, nothing was written", k, count);
    for (size_t side = 0; side < COMPARE_SIDES; side++)
      if (evaluate_side(c, side, k) != 0) return EXIT_FAILURE;
    if (comparison_add(&c->comparison, &c->side[0].evaluation, drawn, k) != 0) return EXIT_FAILURE;
    progress_at(&progress, k + 1, count, "");
  }
  progress_end(&progress);
  return compare_make_rows(c);
}

static int report(struct compare *c) {
  struct session *session = &c->session;
  if (!session_json_on_stdout(session)) {
    struct bytes text = {0};
    compare_text(c, &text);
    const bool failed = text.failed || text.data == NULL;
    if (!failed) fwrite(text.data, 1, text.count, stdout);
    bytes_free(&text);
    if (failed) return session_fail_with(session, "no memory for a table");
  }
  return session->json != NULL ? session_report(session, compare_json(c)) : 0;
}

static void close_all(struct compare *c, bool done) {
  compare_files_close(c, done);
  for (size_t i = 0; i <= COMPARE_SIDES; i++) json_decref(c->rows[i]);
  for (size_t side = 0; side < COMPARE_SIDES; side++) {
    free(c->evaluated[side]);
    free(c->lpips[side]);
    compare_side_close(&c->side[side], &c->session);
  }
  perceptual_distance_close(&c->perceptual);
  ern_clip_free(&c->clip);
  speech_model_close(&c->asked.source.speech_model);
  plot_end();
  session_close(&c->session);
}

static int check_words(const struct compare *c, const struct args *args) {
  static const char of_models[] =
      "audio audio-pad max-steps dt-gamma transmittance-stop occupancy-threshold torso torso-shrink scale image-scale "
      "force asr_model speech-model speech-preset backend device deterministic isa threads";
  if (c->folder == NULL) return args_refuse(args, "-o DIR is missing");
  int status = speech_model_check(&c->asked.source.speech_model, args, c->asked.source.features);
  if (status < 0 && c->asked.source.features != NULL)
    status = args_forbid(args, "asr-model", "chooses the clip's speech, not --audio");
  if (status < 0)
    status = args_forbid(args, "smooth-lips", "needs frames one after the other, and three are drawn again");
  if (status < 0 && compare_side_is_video(c->path[0]) && compare_side_is_video(c->path[1]))
    status = args_forbid(args, of_models, "is about a model, and A and B are both videos");
  return status < 0 ? lpips_weights_check(&c->perceptual.weights, args) : status;
}

static void set_inputs(struct compare *c) {
  const char *const inputs[] = {c->path[0],
                                c->path[1],
                                c->asked.source.path,
                                c->asked.source.features,
                                c->asked.source.speech_model.path,
                                speech_model_file(&c->asked.source.speech_model),
                                c->perceptual.weights.network,
                                c->perceptual.weights.heads};
  static_assert(sizeof inputs / sizeof *inputs <= SESSION_INPUTS, "more inputs than a session looks after");
  memcpy(c->session.inputs, inputs, sizeof inputs);
}

int cmd_compare(int argc, char **argv) {
  struct compare c = {.folder = NULL};
  struct option own[OWN_OPTIONS] = {
      {ARGS_TEXT("o", &c.folder), .alias = "output", .choices = "DIR",
       .help =
           "folder for index.html, frames.csv, compare.json, compare.mp4, best.png, median.png and worst.png: a new "
           "one, an empty one, or with --overwrite one that this verb made; the folder around it must exist"},
      {ARGS_TEXT("audio", &c.asked.source.features), .alias = "aud",
       .help = "the clip's speech from another file, a sound or speech features (.npy), instead of the clip's own"}};
  lpips_weights_options(&c.perceptual.weights, own + OWN_OPTIONS - LPIPS_OPTIONS);
  struct option shared[PORTRAIT_OPTIONS], common[SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS];
  static const char about[] = "a model (.safetensors, .pth), or a video (.mp4, .mkv, .mov ...) of the same frames";
  struct word words[] = {{"A", &c.path[0], about},
                         {"B", &c.path[1], about},
                         {"CLIP", &c.asked.source.path, "folder of the preprocessed clip with the recorded frames"}};
  struct args args = {
      .verb = "compare",
      .summary = "Compares two portraits with the same frames of a clip, side by side: figures, pictures, a video.",
      .usage = "compare A B CLIP -o DIR [--split val] [--frames A:B]",
      .notes =
          "Both are evaluated as by `ernerf eval`, with the same options. A video may come from any program. Its\n"
          "picture k is frame k of the split, counted from 0, also with --frames; its pictures have the clip's "
          "size.\n"
          "With --lpips-network and --lpips-heads LPIPS is reported too. Differences are B - A. best.png is the "
          "frame in which B is best against A by PSNR, worst.png the one in\n"
          "which it is worst. The files of DIR get their names when all of them are complete on the disk.",
      .public_names = true,
      .words = words,
      .word_count = 3,
      .groups = {{"What is compared, and where to:", own, OWN_OPTIONS},
                 {"How:", shared, PORTRAIT_OPTIONS},
                 {"Common:", common, SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS}}};
  portrait_options(&c.asked, FRAME_SOURCE_VAL, shared);
  struct option *memory = shared + PORTRAIT_OPTIONS - CLIP_SOURCE_OPTIONS + 1;
  memory->help = "maximum memory for decoded frames of the clip, such as 512M (default: none is kept)";
  session_compute_options(&c.session, common);
  session_output_options(&c.session, common + SESSION_COMPUTE_OPTIONS);
  args_unlist(&args, "smooth-lips");
  int status = args_parse(&args, argc, argv);
  if (status < 0) status = check_words(&c, &args);
  set_inputs(&c);
  if (status < 0) status = session_open(&c.session, &args);
  if (status >= 0) return status;
  status = open_all(&c, &args);
  if (status == 0) status = compare_all(&c);
  if (status == 0) status = compare_files_write(&c);
  const bool done = status == 0;
  if (done) status = report(&c);
  close_all(&c, done);
  return status;
}
