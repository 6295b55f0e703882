/* SPDX-License-Identifier: MIT
 * Writes the synthetic clip as a folder in the public layout, and optionally as a video: draws it frame by frame,
 * writes the transforms last, and removes all files after an error, except where a file of others is among them. */
#include <dirent.h>
#include <errno.h>
#include <inttypes.h>
#include <jansson.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/floats.h"
#include "core/memory.h"
#include "ernerf-lab/synth.h"
#include "ernerf/media.h"
#include "io/file.h"
#include "io/json.h"
#include "io/npy.h"
#include "lab/synth/synth_parts.h"

enum { OPTIONS_COOKIE = 0x45524e59, MIN_SIZE = 64, MAX_SIZE = 1080, MIN_FRAMES = 8, MAX_FRAMES = 100000 };
enum { FRAMES_A_VALIDATION = 11, JPEG_QUALITY = 95, NAME_BYTES = 64, TEXT_LIMIT = 1 << 20 };
enum { MAX_TURN = 40, MAX_CRF = 51, MAX_STRENGTH = 100, DEFAULT_CRF = 18 };

static const char *const part_names[] = {"gt_imgs", "torso_imgs", "ori_imgs", "parsing"};
static const char *const part_endings[] = {"jpg", "png", "lms", "png"};
static const char *const whole_files[] = {
    "bc.jpg", "aud_ds.npy", "aud.wav", "au.csv", "curves.csv", "transforms_train.json", "transforms_val.json"};
enum { PARTS = 4, PARSING = 3, WHOLE_FILES = sizeof whole_files / sizeof whole_files[0] };

/* Everything of a clip while it is made. */
struct work {
  ern_context *context;
  const char *folder;
  const ern_synth_options *options;
  size_t frames;
  bool made_folder, at_video; /* at_video: an error is the video's */
  struct cast {
    struct ern_synth_person person;
    struct ern_synth_layer torso;
    float (*room)[4]; /* [size][size] */
  } cast[2];          /* the second is only used by ERN_SYNTH_CUT */
  size_t cut;         /* the first frame with the second person */
  struct ern_synth_speech speech;
  ern_spoken spoken;              /* if there is a text */
  struct ern_synth_curve *curves; /* [frames] */
  ern_sound sound;
  ern_video_writer *video;
  struct ern_pool *pool;
  size_t first_frame;              /* of the pool's current batch */
  ern_status *outcomes;            /* [threads], of the current batch */
  uint8_t **shown;                 /* [threads], of the current batch: [size][size][4] for the video */
  struct ern_synth_buffers *desks; /* [threads] */
};

ern_synth_options ern_synth_options_default(void) {
  return (ern_synth_options){.cookie = OPTIONS_COOKIE,
                             .size = 512,
                             .frames = 250,
                             .seed = 1,
                             .blink = true,
                             .torso = true,
                             .moving_camera = true,
                             .spoken = {.voice = "en-us", .words_per_minute = 165},
                             .crf = DEFAULT_CRF};
}

static ern_status check_options(ern_context *context, const ern_synth_options *options) {
  if (options->cookie != OPTIONS_COOKIE)
    return ern_fail(context, ERN_E_ARGUMENT, "made-up clip: the options were not made by ern_synth_options_default");
  if (options->size < MIN_SIZE || options->size > MAX_SIZE)
    return ern_fail(context, ERN_E_ARGUMENT, "made-up clip: size is %d, expected %d to %d", options->size, MIN_SIZE,
                    MAX_SIZE);
  if (!(options->text_file != NULL && options->frames == 0) &&
      (options->frames < MIN_FRAMES || options->frames > MAX_FRAMES))
    return ern_fail(context, ERN_E_ARGUMENT, "made-up clip: frames is %d, expected %d to %d", options->frames,
                    MIN_FRAMES, MAX_FRAMES);
  if (options->turn != 0.0 && !(options->turn >= 1.0 && options->turn <= MAX_TURN))
    return ern_fail(context, ERN_E_ARGUMENT, "made-up clip: turn is %g degrees, expected 0, or 1 to %d", options->turn,
                    MAX_TURN);
  if (options->room < ERN_SYNTH_BOOKS || options->room > ERN_SYNTH_CLUTTERED)
    return ern_fail(context, ERN_E_ARGUMENT, "made-up clip: room is %d, expected %d to %d", (int)options->room,
                    ERN_SYNTH_BOOKS, ERN_SYNTH_CLUTTERED);
  if (options->fault < ERN_SYNTH_NO_FAULT || options->fault > ERN_SYNTH_CUT)
    return ern_fail(context, ERN_E_ARGUMENT, "made-up clip: fault is %d, expected %d to %d", (int)options->fault,
                    ERN_SYNTH_NO_FAULT, ERN_SYNTH_CUT);
  if (options->fault != ERN_SYNTH_NO_FAULT && !(options->strength >= 0.1 && options->strength <= MAX_STRENGTH))
    return ern_fail(context, ERN_E_ARGUMENT, "made-up clip: strength of the fault is %g, expected 0.1 to %d",
                    options->strength, MAX_STRENGTH);
  if (options->video != NULL && (options->crf < 0 || options->crf > MAX_CRF))
    return ern_fail(context, ERN_E_ARGUMENT, "made-up clip: crf is %d, expected 0 to %d", options->crf, MAX_CRF);
  return ERN_OK;
}

/* The folder is new or empty, else ERN_E_STATE. */
static ern_status check_folder(ern_context *context, const char *folder, bool *there) {
  DIR *list = opendir(folder);
  *there = list != NULL;
  if (list == NULL) {
    if (errno == ENOENT) return ERN_OK;
    return ern_fail(context, ERN_E_IO, "%s: %s, expected a new or an empty folder", folder, strerror(errno));
  }
  ern_status status = ERN_OK;
  for (const struct dirent *entry = readdir(list); entry != NULL && status == ERN_OK; entry = readdir(list)) {
    if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0) continue;
    status =
        ern_fail(context, ERN_E_STATE, "%s: folder holds %s, expected a new or an empty folder", folder, entry->d_name);
  }
  closedir(list);
  return status;
}

/* A text being written: numbers with a point whatever the locale. */
struct text {
  char *at;
  size_t capacity, length;
};

/* before + value with `places` digits after the point + after. If the buffer is too short, which is an error of this
 * file, the text is truncated. */
static void put_number(struct text *text, const char *before, double value, int places, const char *after) {
  static const int64_t powers[] = {1, 10, 100, 1000, 10000, 100000, 1000000};
  const int64_t scaled = llrint(value * (double)powers[places]), size = scaled < 0 ? -scaled : scaled;
  const size_t left = text->capacity - text->length;
  const int count =
      places == 0
          ? snprintf(text->at + text->length, left, "%s%s%" PRId64 "%s", before, scaled < 0 ? "-" : "", size, after)
          : snprintf(text->at + text->length, left, "%s%s%" PRId64 ".%0*" PRId64 "%s", before, scaled < 0 ? "-" : "",
                     size / powers[places], places, size % powers[places], after);
  text->length += (size_t)count < left ? (size_t)count : left - 1;
}

/* The path of a frame's file, or of a file of the whole clip. */
static ern_status frame_path(struct work *work, int part, size_t frame, char **path) {
  char name[NAME_BYTES];
  snprintf(name, sizeof name, "%s/%zu.%s", part_names[part], frame, part_endings[part]);
  return ern_path_join(work->context, work->folder, name, path);
}

/* Removes all written files, so that no partial clip remains. Ignores errors. */
static void remove_all(struct work *work) {
  char *path = NULL;
  for (int part = 0; part < PARTS; ++part) {
    for (size_t frame = 0; frame < work->frames; ++frame) {
      if (frame_path(work, part, frame, &path) == ERN_OK) (void)unlink(path);
      ern_release(work->context, path);
    }
    if (ern_path_join(work->context, work->folder, part_names[part], &path) == ERN_OK) (void)rmdir(path);
    ern_release(work->context, path);
  }
  for (int k = 0; k < WHOLE_FILES; ++k) {
    if (ern_path_join(work->context, work->folder, whole_files[k], &path) == ERN_OK) (void)unlink(path);
    ern_release(work->context, path);
  }
  if (work->made_folder) (void)rmdir(work->folder);
}

/* ---- frames -------------------------------------------------------------------------------------- */

static ern_status write_parsing(struct work *work, size_t frame, struct ern_synth_buffers *buffers) {
  ern_status status = ERN_OK;
  char *path = NULL;
  ern_synth_buffers_parse(buffers);
  ERN_TRY(frame_path(work, PARSING, frame, &path));
  ERN_TRY(ern_image_write(work->context, path, &buffers->parsing, JPEG_QUALITY));
fail:
  ern_release(work->context, path);
  return status;
}

static ern_status write_landmarks(struct work *work, const struct ern_synth_head *head,
                                  const struct ern_synth_camera *camera, const char *path) {
  struct vec3 points[ERN_LANDMARKS];
  char letters[ERN_LANDMARKS * 64];
  struct text text = {letters, sizeof letters, 0};
  ern_synth_head_landmarks(head, points);
  for (int k = 0; k < ERN_LANDMARKS; ++k) {
    float pixel[2];
    ern_synth_camera_project(camera, points[k], pixel);
    put_number(&text, "", (double)pixel[0], 6, " ");
    put_number(&text, "", (double)pixel[1], 6, "\n");
  }
  return ern_file_write(work->context, path, text.at, text.length, ERN_EXISTING_BY_CONTEXT);
}

static ern_status write_frame(struct work *work, size_t frame, struct ern_synth_buffers *buffers) {
  ern_status status = ERN_OK;
  char *truth = NULL, *cutout = NULL, *landmarks = NULL;
  const struct ern_synth_curve *curve = &work->curves[frame];
  const struct cast *cast = &work->cast[frame >= work->cut ? 1 : 0];
  const int size = work->options->size;
  struct ern_synth_head head;
  struct ern_synth_camera camera;
  ern_synth_head_pose(&head, &cast->person, curve);
  ern_synth_camera_make(size, curve, &camera);
  ern_synth_head_draw(&head, &camera, size, buffers->head);
  if (work->options->torso) ern_synth_torso_draw(&cast->torso, curve, size, buffers->torso, buffers->bare);
  ern_synth_buffers_compose(buffers, cast->room, curve);
  if (work->options->fault == ERN_SYNTH_OCCLUDE)
    ern_synth_buffers_rod(buffers, cast->person.skin, ((double)frame + 0.5) / (double)work->frames,
                          work->options->strength / 100.0);
  ERN_TRY(frame_path(work, 0, frame, &truth));
  ERN_TRY(frame_path(work, 1, frame, &cutout));
  ERN_TRY(frame_path(work, 2, frame, &landmarks));
  ERN_TRY(ern_image_write(work->context, truth, &buffers->truth, JPEG_QUALITY));
  ERN_TRY(ern_image_write(work->context, cutout, &buffers->cutout, JPEG_QUALITY));
  ERN_TRY(write_landmarks(work, &head, &camera, landmarks));
  if (work->options->parsing) ERN_TRY(write_parsing(work, frame, buffers));
fail:
  ern_release(work->context, truth);
  ern_release(work->context, cutout);
  ern_release(work->context, landmarks);
  return status;
}

static void frame_task(void *user, size_t index, int worker) {
  struct work *work = user;
  struct ern_synth_buffers *buffers = &work->desks[worker];
  work->outcomes[index] = write_frame(work, work->first_frame + index, buffers);
  if (work->video != NULL) ern_synth_buffers_show(buffers, work->shown[index]);
}

/* Draws as many frames at a time as there are threads, so that the caller's thread reports progress. */
static ern_status write_frames(struct work *work) {
  const ern_synth_options *options = work->options;
  const size_t threads = (size_t)ern_pool_threads(work->pool);
  for (size_t first = 0; first < work->frames; first += threads) {
    const size_t count = work->frames - first < threads ? work->frames - first : threads;
    work->first_frame = first;
    ern_pool_run(work->pool, count, frame_task, work);
    for (size_t k = 0; k < count; ++k) {
      ern_status status = work->outcomes[k];
      if (status == ERN_OK && work->video != NULL) status = ern_video_writer_frame(work->video, work->shown[k]);
      if (status != ERN_OK) return status;
      if (options->progress != NULL && options->progress(options->user, (int)(first + k) + 1, (int)work->frames) != 0)
        return ern_fail(work->context, ERN_E_CANCELLED, "%s: cancelled after frame %zu of %zu", work->folder,
                        first + k + 1, work->frames);
    }
  }
  return ERN_OK;
}

/* ---- files of the whole clip --------------------------------------------------------------------- */

/* frames first .. end-1 of a transforms_*.json. */
static ern_status write_transforms(struct work *work, const char *name, size_t first, size_t end) {
  ern_status status = ERN_OK;
  char *path = NULL, *text = NULL;
  struct ern_synth_camera camera;
  const int size = work->options->size;
  ern_synth_camera_make(size, &work->curves[0], &camera);
  json_t *root = json_pack("{s:f, s:f, s:f, s:i, s:i, s:[]}", "focal_len", camera.focal, "cx", camera.centre, "cy",
                           camera.centre, "w", size, "h", size, "frames");
  json_t *list = root != NULL ? json_object_get(root, "frames") : NULL;
  for (size_t t = first; t < end && list != NULL; ++t) {
    ern_synth_camera_make(size, &work->curves[t], &camera);
    const double(*m)[4] = (const double(*)[4])camera.matrix;
    json_t *frame =
        json_pack("{s:I, s:I, s:[[f,f,f,f],[f,f,f,f],[f,f,f,f],[f,f,f,f]]}", "img_id", (json_int_t)t, "aud_id",
                  (json_int_t)t, "transform_matrix", m[0][0], m[0][1], m[0][2], m[0][3], m[1][0], m[1][1], m[1][2],
                  m[1][3], m[2][0], m[2][1], m[2][2], m[2][3], m[3][0], m[3][1], m[3][2], m[3][3]);
    if (frame == NULL || json_array_append_new(list, frame) != 0) list = NULL;
  }
  if (list != NULL) text = ern_json_text(work->context, root, JSON_INDENT(1) | JSON_REAL_PRECISION(17));
  if (text == NULL) ERN_TRY(ern_fail(work->context, ERN_E_NO_MEMORY, "%s/%s: no memory for JSON", work->folder, name));
  ERN_TRY(ern_path_join(work->context, work->folder, name, &path));
  ERN_TRY(ern_file_write(work->context, path, text, strlen(text), ERN_EXISTING_BY_CONTEXT));
fail:
  ern_release(work->context, path);
  ern_release(work->context, text);
  json_decref(root);
  return status;
}

/* Writes a header and a line a frame, each at most `line_bytes` long. */
static ern_status write_table(struct work *work, const char *name, const char *header, size_t line_bytes,
                              void (*line)(struct text *text, const struct ern_synth_curve *curve, size_t frame)) {
  ern_status status = ERN_OK;
  char *path = NULL;
  const size_t length = strlen(header);
  struct text text = {NULL, length + line_bytes * work->frames + 1, length};
  ERN_TRY(ern_path_join(work->context, work->folder, name, &path));
  ERN_TRY(ERN_NEW(work->context, text.capacity, &text.at));
  memcpy(text.at, header, length);
  for (size_t t = 0; t < work->frames; ++t) line(&text, &work->curves[t], t);
  ERN_TRY(ern_file_write(work->context, path, text.at, text.length, ERN_EXISTING_BY_CONTEXT));
fail:
  ern_release(work->context, path);
  ern_release(work->context, text.at);
  return status;
}

static void curves_line(struct text *text, const struct ern_synth_curve *curve, size_t frame) {
  const float values[] = {curve->jaw,  curve->width,    curve->blink,    curve->yaw,     curve->pitch,
                          curve->roll, curve->shift[0], curve->shift[1], curve->shift[2]};
  put_number(text, "", (double)frame, 0, "");
  for (size_t k = 0; k < sizeof values / sizeof values[0]; ++k) put_number(text, ",", (double)values[k], 6, "");
  text->at[text->length++] = '\n';
}

/* The action units that OpenFace reports, in its order; _c has one more, AU28. */
static const int action_units[] = {1, 2, 4, 5, 6, 7, 9, 10, 12, 14, 15, 17, 20, 23, 25, 26, 28, 45};
enum { ACTION_UNITS = sizeof action_units / sizeof action_units[0], WITHOUT_STRENGTH = 28 };

/* 0..5: lips corner puller, stretcher and tightener from the width, lips part and jaw drop from the jaw, blink. */
static double unit_strength(const struct ern_synth_curve *curve, int unit) {
  const double wide = fmax((double)curve->width, 0.0), narrow = fmax(-(double)curve->width, 0.0);
  switch (unit) {
    case 12: return 1.2 * wide;
    case 20: return 0.8 * wide;
    case 23: return 0.9 * narrow;
    case 25: return fmin(3.2 * (double)curve->jaw, 3.0);
    case 26: return 2.2 * (double)curve->jaw;
    case 45: return 2.0 * (double)curve->blink; /* 2 and above: shut */
    default: return 0.0;
  }
}

static void units_line(struct text *text, const struct ern_synth_curve *curve, size_t frame) {
  put_number(text, "", (double)frame + 1.0, 0, ", 0, ");
  put_number(text, "", (double)frame / ERN_SYNTH_FPS, 3, ", 0.98, 1");
  for (int k = 0; k < ACTION_UNITS; ++k)
    if (action_units[k] != WITHOUT_STRENGTH) put_number(text, ", ", unit_strength(curve, action_units[k]), 2, "");
  for (int k = 0; k < ACTION_UNITS; ++k)
    put_number(text, ", ", unit_strength(curve, action_units[k]) >= 1.0 ? 1.0 : 0.0, 2, "");
  text->at[text->length++] = '\n';
}

static ern_status write_units(struct work *work) {
  char header[512];
  size_t length = (size_t)snprintf(header, sizeof header, "frame, face_id, timestamp, confidence, success");
  for (int k = 0; k < 2 * ACTION_UNITS; ++k) {
    const int unit = action_units[k % ACTION_UNITS];
    if (k < ACTION_UNITS && unit == WITHOUT_STRENGTH) continue;
    length +=
        (size_t)snprintf(header + length, sizeof header - length, ", AU%02d_%c", unit, k < ACTION_UNITS ? 'r' : 'c');
  }
  snprintf(header + length, sizeof header - length, "\n");
  return write_table(work, "au.csv", header, 320, units_line);
}

static ern_status write_features(struct work *work) {
  ern_status status = ERN_OK;
  float *features = NULL;
  char *path = NULL;
  const size_t window = (size_t)ERN_SYNTH_WINDOW * ERN_SYNTH_LETTERS;
  ERN_TRY(ern_path_join(work->context, work->folder, "aud_ds.npy", &path));
  ERN_TRY(ERN_NEW(work->context, work->frames * window, &features));
  for (size_t t = 0; t < work->frames; ++t)
    memcpy(features + t * window, work->speech.logits[2 * t], window * sizeof *features);
  ERN_TRY(ern_npy_write_f32(work->context, path, features, 3,
                            (const size_t[]){work->frames, ERN_SYNTH_WINDOW, ERN_SYNTH_LETTERS}));
fail:
  ern_release(work->context, path);
  ern_release(work->context, features);
  return status;
}

static ern_status write_sound(struct work *work) {
  ern_status status = ERN_OK;
  char *path = NULL;
  const ern_sound *speech = &work->spoken.sound;
  const int rate = work->options->text_file != NULL ? speech->rate : ERN_SYNTH_RATE;
  ern_sound *sound = &work->sound;
  *sound = (ern_sound){.rate = rate, .channels = 1, .frames = work->frames * (size_t)rate / ERN_SYNTH_FPS};
  ERN_TRY(ern_path_join(work->context, work->folder, "aud.wav", &path));
  ERN_TRY(ERN_NEW(work->context, sound->frames, &sound->data));
  if (work->options->text_file != NULL)
    memcpy(sound->data, speech->data,
           (speech->frames < sound->frames ? speech->frames : sound->frames) * sizeof *sound->data);
  else
    ern_synth_sound_make(work->options->seed, work->cast[0].person.voice, &work->speech, sound->data, sound->frames);
  ERN_TRY(ern_sound_write_wav(work->context, path, sound));
fail:
  ern_release(work->context, path);
  return status;
}

static ern_status open_video(struct work *work) {
  const ern_synth_options *options = work->options;
  ern_video_options video = ern_video_options_default(options->size, options->size);
  video.rate_numerator = ERN_SYNTH_FPS;
  video.sound = &work->sound;
  video.crf = options->crf;
  return ern_video_writer_open(work->context, options->video, &video, &work->video);
}

static ern_status write_room(struct work *work) {
  ern_status status = ERN_OK;
  char *path = NULL;
  const int size = work->options->size;
  ern_image image = {0};
  ERN_TRY(ern_path_join(work->context, work->folder, "bc.jpg", &path));
  ERN_TRY(ern_synth_picture_make(work->context, size, 3, &image));
  for (size_t i = 0; i < (size_t)size * (size_t)size; ++i)
    for (size_t c = 0; c < 3; ++c) image.data[3 * i + c] = ern_synth_to_byte(work->cast[0].room[i][c]);
  ERN_TRY(ern_image_write(work->context, path, &image, JPEG_QUALITY));
fail:
  ern_image_free(work->context, &image);
  ern_release(work->context, path);
  return status;
}

/* ---- all of it ----------------------------------------------------------------------------------- */

/* Speaks the text; a clip without a given length gets the length of its text. */
static ern_status speak(struct work *work) {
  const ern_synth_options *options = work->options;
  uint8_t *text = NULL;
  size_t bytes = 0;
  ern_status status = ern_file_read(work->context, options->text_file, TEXT_LIMIT, &text, &bytes);
  if (status == ERN_OK && strlen((const char *)text) != bytes)
    status = ern_fail(work->context, ERN_E_FORMAT, "%s: byte %zu is 0, expected text", options->text_file,
                      strlen((const char *)text));
  if (status == ERN_OK) status = ern_spoken_make(work->context, (const char *)text, &options->spoken, &work->spoken);
  ern_release(work->context, text);
  if (status != ERN_OK || options->frames > 0) return status;
  const size_t rate = (size_t)work->spoken.sound.rate;
  work->frames = (work->spoken.sound.frames * ERN_SYNTH_FPS + rate - 1) / rate;
  if (work->frames < MIN_FRAMES) work->frames = MIN_FRAMES;
  return ERN_OK;
}

/* The person of a seed with torso and room; `other`: how many seeds on. */
static ern_status engage(struct work *work, struct cast *cast, uint64_t other) {
  ern_status status = ERN_OK;
  const ern_synth_options *options = work->options;
  const uint64_t seed = options->seed + other;
  ern_synth_person_make(seed, &cast->person);
  ERN_TRY(ERN_NEW(work->context, (size_t)options->size * (size_t)options->size, &cast->room));
  ern_synth_room_draw(&cast->person, seed, options->room, options->size, cast->room);
  if (options->torso)
    ERN_TRY(ern_synth_torso_make(work->context, work->pool, &cast->person, options->size, &cast->torso));
fail:
  return status;
}

static ern_status set_up(struct work *work) {
  ern_status status = ERN_OK;
  ern_context *context = work->context;
  const ern_synth_options *options = work->options;
  const size_t pixels = (size_t)options->size * (size_t)options->size;
  work->cut = work->frames;
  ERN_TRY(ern_pool_make(context, 0, &work->pool));
  const size_t threads = (size_t)ern_pool_threads(work->pool);
  ERN_TRY(ERN_NEW(context, work->frames, &work->curves));
  ERN_TRY(ERN_NEW(context, threads, &work->outcomes));
  ERN_TRY(ERN_NEW(context, threads, &work->shown));
  ERN_TRY(ERN_NEW(context, threads, &work->desks));
  for (size_t k = 0; k < threads; ++k) {
    ERN_TRY(ern_synth_buffers_make(context, options->size, &work->desks[k]));
    if (options->video != NULL) ERN_TRY(ERN_NEW(context, 4 * pixels, &work->shown[k]));
  }
  status = options->text_file != NULL ? ern_synth_speech_follow(context, &work->spoken, work->frames, &work->speech)
                                      : ern_synth_speech_make(context, options->seed, work->frames, &work->speech);
  if (status != ERN_OK) return status;
  ern_synth_motion_make(options->seed, &work->speech, options->blink, options->moving_camera, options->turn,
                        work->curves, work->frames);
  ERN_TRY(ern_synth_fault_move(context, options, &work->speech, work->curves, work->frames, &work->cut));
  for (int k = 0; k < (work->cut < work->frames ? 2 : 1); ++k) ERN_TRY(engage(work, &work->cast[k], (uint64_t)k));
fail:
  return status;
}

static void tear_down(struct work *work) {
  for (int k = 0; work->desks != NULL && k < ern_pool_threads(work->pool); ++k) {
    ern_synth_buffers_free(work->context, &work->desks[k]);
    ern_release(work->context, work->shown[k]);
  }
  for (int k = 0; k < 2; ++k) {
    ern_synth_torso_free(work->context, &work->cast[k].torso);
    ern_release(work->context, work->cast[k].room);
  }
  ern_release(work->context, work->desks);
  ern_release(work->context, work->shown);
  ern_release(work->context, work->outcomes);
  ern_release(work->context, work->curves);
  ern_sound_free(work->context, &work->sound);
  ern_synth_speech_free(work->context, &work->speech);
  ern_spoken_free(work->context, &work->spoken);
  ern_pool_free(work->pool);
}

static ern_status write_all(struct work *work) {
  static const char curves_header[] = "frame,jaw,width,blink,yaw,pitch,roll,shift_right,shift_up,shift_near\n";
  ern_status status = ERN_OK;
  const size_t val = (work->frames + FRAMES_A_VALIDATION - 1) / FRAMES_A_VALIDATION, train = work->frames - val;
  char *path = NULL;
  for (int part = 0; part < (work->options->parsing ? PARTS : PARSING); ++part) {
    ERN_TRY(ern_path_join(work->context, work->folder, part_names[part], &path));
    status = ern_folder_make(work->context, path);
    ern_release(work->context, path);
    if (status != ERN_OK) return status;
  }
  ERN_TRY(write_room(work));
  if (work->options->text_file == NULL) ERN_TRY(write_features(work));
  ERN_TRY(write_sound(work));
  if (work->options->blink) ERN_TRY(write_units(work));
  ERN_TRY(write_table(work, "curves.csv", curves_header, 160, curves_line));
  work->at_video = true;
  if (work->options->video != NULL) ERN_TRY(open_video(work));
  work->at_video = false;
  ERN_TRY(write_frames(work));
  ERN_TRY(write_transforms(work, "transforms_val.json", train, work->frames));
  ERN_TRY(write_transforms(work, "transforms_train.json", 0, train));
  work->at_video = true;
  if (work->video != NULL) ERN_TRY(ern_video_writer_close(&work->video));
fail:
  return status;
}

ern_status ern_synth_write(ern_context *context, const char *folder, const ern_synth_options *options) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(context, context);
  ERN_NEED(context, folder);
  ERN_NEED(context, options);
  ern_status status = ERN_OK;
  bool there = false, writing = false;
  struct work work = {.context = context, .folder = folder, .options = options};
  ERN_TRY(check_options(context, options));
  work.frames = (size_t)options->frames;
  ERN_TRY(check_folder(context, folder, &there));
  if (options->text_file != NULL) ERN_TRY(speak(&work));
  ERN_TRY(set_up(&work));
  work.made_folder = !there;
  writing = true;
  ERN_TRY(ern_folder_make(context, folder));
  ERN_TRY(write_all(&work));
fail:
  ern_video_writer_abandon(&work.video);
  const bool others = status == ERN_E_EXISTS && !work.at_video; /* a file of others is in the folder */
  if (status != ERN_OK && writing && !others) remove_all(&work);
  tear_down(&work);
  return status;
}
