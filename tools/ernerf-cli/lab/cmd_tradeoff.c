/* SPDX-License-Identifier: MIT
 * ernerf tradeoff: measures the trade-off between accuracy and time of rendering. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "lab/tradeoff_files.h"
#include "lab/tradeoff_measure.h"
#include "lab/tradeoff_page.h"
#include "lab/tradeoff_training.h"
#include "verbs.h"

enum { OWN_OPTIONS = 2 };

/* ---- results ----------------------------------------------------------------------------------------------------- */

static int write_plots(struct tradeoff *t) {
  static const char *const names[TRUTHS][2] = {{"exact.svg", "exact.png"}, {"clip.svg", "clip.png"}};
  int status = 0;
  for (enum reference reference = 0; reference < TRUTHS; reference++)
    for (enum plot_form form = PLOT_SVG; form <= PLOT_PNG && status == 0; form++) {
      struct bytes bytes = {0};
      if (tradeoff_plot(t, reference, form, &bytes) != 0) bytes.failed = true;
      status = session_write_in(&t->session, t->folder, names[reference][form], &bytes);
    }
  return status;
}

static int make_files(struct tradeoff *t) {
  struct bytes page = {0}, csv = {0};
  char path[4096];
  int status = tradeoff_page_make(t, &page);
  if (status == 0) {
    tradeoff_csv(t, &csv);
    status = session_write_in(&t->session, t->folder, "tradeoff.csv", &csv);
  }
  if (status == 0) status = write_plots(t);
  if (status == 0 && snprintf(path, sizeof path, "%s/tradeoff.json", t->folder) >= (int)sizeof path)
    status = session_fail_with(&t->session, "%s: the name is too long", t->folder);
  if (status == 0) status = session_write_json(&t->session, path, tradeoff_json(t));
  if (status == 0) status = session_write_in(&t->session, t->folder, "index.html", &page);
  bytes_free(&page);
  return status;
}

/* Writes all files or none: a failure leaves the files of an earlier run unchanged. */
static int write_all(struct tradeoff *t) {
  session_stage(&t->session);
  return session_write_staged(&t->session, make_files(t));
}

static void print_front(const struct tradeoff *t) {
  size_t order[TRADEOFF_POINTS];
  const size_t count = tradeoff_front(t, REFERENCE_EXACT, order);
  printf("%-44s %21s %9s %18s %18s\n", "the front", "ms a frame (quartiles)", "frames/s", "dB, exact", "dB, clip");
  for (size_t i = 0; i < count; i++) {
    const struct point *p = &t->points[order[i]];
    const struct mean_and_deviation exact = mean_of(p->db[REFERENCE_EXACT], tradeoff_frames(t));
    const struct mean_and_deviation clip = mean_of(p->db[REFERENCE_CLIP], tradeoff_frames(t));
    printf("%-44s %8.2f (%.2f-%.2f) %9.1f %10.2f +- %-5.2f %10.3f +- %-5.2f\n", p->name, p->ms.median, p->ms.low,
           p->ms.high, 1000 / p->ms.median, exact.mean, exact.deviation, clip.mean, clip.deviation);
  }
  printf("\n%zu points, %zu turns, %.0f s; medians with quartiles, means of %zu frames with standard deviations\n",
         t->count, t->turns, t->spent_seconds, tradeoff_frames(t));
  if (t->not_reached[0] + t->not_reached[1] > 0)
    printf("for lack of time %zu settings and %zu combinations were not tried: give more --seconds\n",
           t->not_reached[0], t->not_reached[1]);
  printf("%s/index.html\n", t->folder);
}

/* ---- the verb ---------------------------------------------------------------------------------------------------- */

static int check_outputs(struct tradeoff *t) {
  static const char *const names[] = {"index.html", "tradeoff.csv", "tradeoff.json", "exact.svg",
                                      "exact.png",  "clip.svg",     "clip.png"};
  return session_check_outputs(&t->session, t->folder, names, sizeof names / sizeof *names);
}

static int open_all(struct tradeoff *t, const struct args *args) {
  struct portrait *portrait = &t->portrait;
  struct session *session = &t->session;
  if (check_outputs(t) != 0) return EXIT_FAILURE;
  int status = portrait_open(portrait, session, args);
  speech_model_close(&portrait->source.speech_model);
  if (status != 0) return status;
  const enum frame_source_split split = (enum frame_source_split)portrait->split;
  const ern_features *features = ern_clip_features(portrait->clip);
  if (ern_renderer_accepts(portrait->renderer, features, portrait->features_path) != ERN_OK)
    return session_fail(session);
  if (ern_file_sha256(session->context, portrait->model_path, t->model_sha256) != ERN_OK) return session_fail(session);
  ern_renderer_free(&portrait->renderer); /* each point has its own renderer */
  status = evaluate_open(&t->evaluation, session, portrait->clip, split, portrait->scale,
                         (ern_audio_pad)portrait->audio_pad);
  t->evaluation.recorded_torso = portrait->render.no_torso;
  if (status == 0) status = frame_source_of_clip(&t->speech, session, portrait->clip, split);
  if (status == 0) status = tradeoff_measure_open(t, args);
  t->made_folder = access(t->folder, F_OK) != 0;
  return status == 0 ? session_folder(&t->session, t->folder) : status;
}

static int measure_and_write(struct tradeoff *t) {
  int status = tradeoff_measure_all(t);
  if (status == 0) status = write_all(t);
  if (status != 0) {
    if (t->made_folder) (void)rmdir(t->folder); /* fails if the folder is not empty */
    return status;
  }
  if (!session_json_on_stdout(&t->session)) print_front(t);
  return t->session.json != NULL ? session_report(&t->session, tradeoff_json(t)) : 0;
}

static void close_all(struct tradeoff *t) {
  tradeoff_measure_close(t);
  plot_end();
  evaluate_close(&t->evaluation);
  frame_source_free(&t->speech);
  portrait_close(&t->portrait);
  session_close(&t->session);
}

static int check_words(const struct tradeoff *t, const struct args *args) {
  if (t->folder == NULL) return args_refuse(args, "-o DIR is missing");
  return args_forbid(args, "smooth-lips",
                     "makes a frame depend on earlier frames, so that settings could not be compared");
}

/* `--training` acts as a separate verb with its own arguments and options. */
static bool asks_for_training(int argc, char **argv) {
  for (int i = 0; i < argc; i++)
    if (strcmp(argv[i], "--training") == 0) return true;
  return false;
}

int cmd_tradeoff(int argc, char **argv) {
  if (asks_for_training(argc, argv)) return tradeoff_training(argc, argv);
  struct tradeoff t = {.seconds = 120};
  struct option own[OWN_OPTIONS] = {
      {ARGS_TEXT("o", &t.folder), .alias = "output", .choices = "DIR",
       .help = "folder for index.html, tradeoff.csv, tradeoff.json and plots; made if missing"},
      {ARGS_FLOAT("seconds", &t.seconds, 1, 86400),
       .help = "seconds for all measurements, about; the exact render and three measurements of a few settings are "
               "made in any case"}};
  struct option shared[PORTRAIT_OPTIONS], common[SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS];
  struct word words[] = {{"MODEL", &t.portrait.model_path, "a .safetensors or .pth file: a head, or head and torso"},
                         {"CLIP", &t.portrait.source.path, "folder of the preprocessed clip that it was trained on"}};
  struct args args = {
      .verb = "tradeoff",
      .summary = "Measures render time against accuracy, for many render settings.",
      .usage =
          "tradeoff MODEL CLIP -o DIR [--seconds 120]\n"
          "tradeoff --training CLIP -o DIR [--seconds 30]     (tradeoff --training --help)",
      .notes =
          "Each setting is changed by itself, then promising combinations are; all are measured in turns. Accuracy "
          "is the PSNR\n"
          "against the frames of the clip, and against an exact render of the same model in double precision. The "
          "options\n"
          "given here are the starting point. --frames has 2 to 16 frames (default four of the split, evenly "
          "spaced). All\n"
          "instruction sets of the CPU are tried; --backend opencl adds a device.",
      .words = words,
      .word_count = 2,
      .groups = {{"What is measured, and where to:", own, OWN_OPTIONS},
                 {"The settings that it starts from:", shared, PORTRAIT_OPTIONS},
                 {"Common:", common, SESSION_OUTPUT_OPTIONS + SESSION_COMPUTE_OPTIONS}}};
  portrait_options(&t.portrait, FRAME_SOURCE_VAL, shared);
  session_compute_options(&t.session, common);
  session_output_options(&t.session, common + SESSION_COMPUTE_OPTIONS);
  int status = args_parse(&args, argc, argv);
  if (status < 0) status = check_words(&t, &args);
  if (status < 0) status = speech_model_check(&t.portrait.source.speech_model, &args, NULL);
  t.session.inputs[0] = t.portrait.model_path;
  t.session.inputs[1] = t.portrait.source.path;
  t.session.inputs[2] = t.portrait.source.speech_model.path;
  t.session.inputs[3] = speech_model_file(&t.portrait.source.speech_model);
  if (status < 0) status = session_open(&t.session, &args);
  if (status >= 0) return status;
  status = open_all(&t, &args);
  if (status == 0) status = measure_and_write(&t);
  close_all(&t);
  return status;
}
