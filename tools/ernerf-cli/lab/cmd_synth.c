/* SPDX-License-Identifier: MIT
 * ernerf synth: writes a synthetic clip. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ernerf-lab/synth.h"
#include "session/progress.h"
#include "session/session.h"
#include "verbs.h"

struct drawing {
  struct progress progress;
  int frames; /* of the whole clip; with a text, its duration decides */
};

static int say_progress(void *user, int done, int total) {
  struct drawing *drawing = user;
  drawing->frames = total;
  progress_at(&drawing->progress, (uint64_t)done, (uint64_t)total, "");
  return session_interrupted();
}

static int make(struct session *session, ern_synth_options *options, const char *folder) {
  struct drawing drawing = {.frames = options->frames};
  const double began = session_seconds();
  if (session_check_json_not_input(session, folder) != 0) return EXIT_FAILURE;
  progress_begin(&drawing.progress, session, "synth", "frames");
  options->seed = session->seed;
  options->progress = say_progress;
  options->user = &drawing;
  const ern_status status = ern_synth_write(session->context, folder, options);
  progress_end(&drawing.progress);
  if (status == ERN_E_CANCELLED && session_interrupted())
    return session_stop_with(session, "stopped; nothing of %s was kept", folder);
  if (status != ERN_OK) return session_fail(session);
  if (options->video != NULL) session_note(session, "%s: the same frames as a video", options->video);
  session_note(session, "%s: %d frames of %d x %d; next: ernerf train %s --time 10m -o portrait.safetensors", folder,
               drawing.frames, options->size, options->size, folder);
  return session_report(
      session, json_pack("{s:o, s:o*, s:i, s:i, s:o, s:b, s:b, s:b, s:b, s:o}", "output", session_text(folder), "video",
                         options->video != NULL ? session_text(options->video) : NULL, "size", options->size, "frames",
                         drawing.frames, "seed", session_whole(session->seed), "blink", options->blink, "torso",
                         options->torso, "moving_camera", options->moving_camera, "parsing", options->parsing,
                         "seconds", session_number(session_seconds() - began)));
}

static bool ends_with(const char *text, const char *end) {
  const size_t length = strlen(text), last = strlen(end);
  return length > last && strcmp(text + length - last, end) == 0;
}

/* NAME:STRENGTH. Returns as args_parse does. */
static int take_fault(struct args *args, const char *text, ern_synth_options *options) {
  static const char *const names[] = {"camera", "occlude", "profile", "still", "cut"}; /* from ERN_SYNTH_CAMERA on */
  static const double most[] = {5.0, 50.0, 80.0, 100.0, 99.0};
  for (int k = 0; k < 5; ++k) {
    const size_t length = strlen(names[k]);
    if (strncmp(text, names[k], length) != 0 || text[length] != ':') continue;
    char *end = NULL;
    options->fault = (enum ern_synth_fault)(ERN_SYNTH_CAMERA + k);
    options->strength = strtod(text + length + 1, &end);
    if (*end == 0 && end != text + length + 1 && options->strength >= 0.1 && options->strength <= most[k]) return -1;
    return args_refuse(args, "--fault is \"%s\", expected a strength from 0.1 to %g after %s:", text, most[k],
                       names[k]);
  }
  return args_refuse(args, "--fault is \"%s\", expected camera, occlude, profile, still or cut, a colon, a strength",
                     text);
}

static int check_usage(struct args *args, ern_synth_options *synth, const char *fault) {
  int status = -1;
  if (synth->text_file == NULL) status = args_forbid(args, "voice words-per-minute", "is of --text");
  if (status < 0 && synth->video == NULL) status = args_forbid(args, "crf", "is of --video");
  if (status < 0 && !synth->moving_camera)
    status = args_forbid(args, "turn", "moves the head, --static-camera does not");
  if (status < 0 && synth->video != NULL && !ends_with(synth->video, ".mp4"))
    status = args_refuse(args, "--video is \"%s\", expected NAME.mp4", synth->video);
  if (status < 0 && fault != NULL) status = take_fault(args, fault, synth);
  return status;
}

int cmd_synth(int argc, char **argv) {
  struct session session = {0};
  const char *folder = NULL;
  ern_synth_options synth = ern_synth_options_default();
  float turn = 0.0f;
  int room = ERN_SYNTH_BOOKS;
  const char *fault = NULL;
  struct option own[] = {
      {ARGS_INT("size", &synth.size, 64, 1080), .choices = "S", .help = "pixels a side"},
      {ARGS_INT("frames", &synth.frames, 8, 100000),
       .help =
           "number of frames, 25 a second; one in eleven is for validation (default 250, or as long as --text takes)"},
      {ARGS_COUNT("seed", &session.seed, 0, 0),
       .help = "another person, other speech; same seed, same bytes (default 0)"},
      {ARGS_TEXT("text", &synth.text_file), .choices = "FILE.txt",
       .help = "speech: what espeak-ng says of this text; the jaw follows its phonemes (default: made-up syllables)"},
      {ARGS_TEXT("voice", &synth.spoken.voice), .choices = "NAME",
       .help = "voice of --text, one of `espeak-ng --voices`: de, en-us, en-us+f3 (default en-us)"},
      {ARGS_INT("words-per-minute", &synth.spoken.words_per_minute, 80, 450),
       .help = "words a minute of --text, 80 to 450"},
      {ARGS_OFF("no-blink", &synth.blink), .help = "eyes stay open, no au.csv"},
      {ARGS_OFF("no-torso", &synth.torso), .help = "a head alone, empty torso pictures"},
      {ARGS_OFF("static-camera", &synth.moving_camera),
       .help = "the head keeps still: every frame has the first one's pose, unless --fault moves it"},
      {ARGS_FLOAT("turn", &turn, 1, 40), .choices = "DEG",
       .help = "largest turn of the head left or right, 1 to 40 degrees; nods have at most half of it, tilts a third "
               "(default: chosen by the seed, below 12)"},
      {ARGS_CHOICE("room", &room, "books|plain|cluttered"), .help = "what is behind the person (default books)"},
      {ARGS_FLAG("parsing", &synth.parsing),
       .help = "parsing/ID.png too: head, neck, torso and background in AD-NeRF's colours"},
      {ARGS_TEXT("video", &synth.video), .choices = "FILE.mp4",
       .help = "the same frames with the sound as a video too"},
      {ARGS_INT("crf", &synth.crf, 0, 51), .help = "H.264 quality of --video, the lower the better (default 18)"},
      {ARGS_TEXT("fault", &fault), .choices = "NAME:STRENGTH",
       .help = "a fault that makes the video hard to prepare: camera:DEG (0.1 to 5): the camera is held by hand and "
               "turns by DEG; occlude:PERCENT (to 50): a rod of that share of the side passes before the face; "
               "profile:DEG (to 80): the head is turned by DEG for a third of the time; still:PERCENT (to 100): the "
               "last frames are one frame; cut:PERCENT (to 99): the last frames are another person"}};
  struct option output[SESSION_OUTPUT_OPTIONS];
  struct word words[] = {{"DIR", &folder, "folder to make; it must not exist, or be empty"}};
  struct args args = {
      .verb = "synth",
      .summary = "Makes up a preprocessed clip: a head that talks, blinks and moves, with its sound.",
      .usage = "synth DIR [--size S] [--frames N] [--seed K]",
      .words = words,
      .word_count = 1,
      .groups = {{"The clip:", own, sizeof own / sizeof own[0]}, {"Output:", output, SESSION_OUTPUT_OPTIONS}}};
  session_output_options(&session, output);
  int status = args_parse(&args, argc, argv);
  if (status < 0) status = check_usage(&args, &synth, fault);
  synth.turn = (double)turn;
  synth.room = (enum ern_synth_room)room;
  if (synth.text_file != NULL && !args_given(&args, "frames")) synth.frames = 0;
  session.inputs[0] = synth.text_file;
  if (status < 0) status = session_open(&session, &args);
  if (status >= 0) return status;
  status = synth.video != NULL ? session_check_output(&session, synth.video) : 0;
  if (status == 0) status = make(&session, &synth, folder);
  session_close(&session);
  return status;
}
