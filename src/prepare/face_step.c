/* SPDX-License-Identifier: MIT
 * The step "face": finds the face in the whole video, chooses one fixed square around all its positions, and writes the
 * cropped frames. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/format.h"
#include "io/file.h"
#include "prepare/clip_sound.h"
#include "prepare/face_detector.h"
#include "prepare/footage.h"
#include "prepare/prepare_record.h"
#include "prepare/segment.h"
#include "prepare/stabilized_crop.h"

/* seconds of sound that may be missing at the end without a warning */
#define SOUND_SHORTER 0.5

/* seconds by which the video may end before --to without a warning, as times are rounded */
#define PART_SHORTER 0.5

/* ern_face_sharpness of a soft face: docs/prepare.md, "Face" */
#define LEAST_SHARPNESS 0.15

/* seconds from a frame to the picture that it shows, from which on it is a repetition; 0.05 at most at 10 a second */
#define HELD 0.06

enum {
  FEWEST_HELD = 5,                  /* held or left out frames, and 1 % of all, that are worth a word */
  EVERY = 5,                        /* frames from look to look; a look runs the face detector on a frame */
  FACES = 8,                        /* most faces of a look */
  THUMB = 32,                       /* pixels a side of the thumbnails that find cuts */
  QUALITY = 98,                     /* JPEG quality of ori_imgs */
  FAINTEST = 16,                    /* of 32767, -66 dB: no sample of a muted track is larger, dither included */
  PATIENCE = 60 * ERN_PREPARE_RATE, /* frames without a face after which the step gives up, */
  LONG_PATIENCE = 10 * PATIENCE,    /* and where it searches for a segment, which need not have the video's beginning */
  SEARCHED = 4 * ERN_PREPARE_FRAMES, /* most frames that are searched for a segment */
  FEWEST_FRAMES = ERN_PREPARE_RATE,  /* fewest that can be trained on */
  FEW_FRAMES = 10 * ERN_PREPARE_RATE /* with fewer, training learns little */
};

struct area { /* pixels x0 .. x1-1, y0 .. y1-1 */
  int x0, y0, x1, y1;
};

struct scan {
  struct ern_prepare_job *job;
  struct ern_face_detector *detector;
  struct ern_found_face *faces; /* [looks]: the main face of each look; width 0: none */
  size_t looks, capacity, found, with_others;
  float thumb[THUMB * THUMB], change; /* last frame's; mean grey level change */
  float around[THUMB * THUMB];        /* the same of `place`, round the last face that was found */
  struct area place;                  /* empty: no face yet */
  float most_change;                  /* the largest of the picture or of `place`: a small person changes few pixels */
  float usual;                        /* running mean of the change */
  size_t cut;                         /* first frame after a cut; 0: no cut */
  size_t frames, held;                /* of the clip; those that no picture is near in time (HELD) */
  size_t left_out;                    /* pictures of the video that come later than others of their time */
  double end;                         /* time of the video's end in seconds, where the part reaches it; else 0 */
  size_t before;                      /* frames searched for a segment, for the progress */
  bool has_sound;
  struct ern_segment_search *search; /* NULL where no segment is searched for */
  int width, height;
  double aspect;
};

/* Scales an area of the grey picture down by means of blocks. */
static void shrink(const ern_image *image, struct area of, float thumb[THUMB * THUMB]) {
  const int width = of.x1 - of.x0, height = of.y1 - of.y0;
  for (int v = 0; v < THUMB; v++)
    for (int u = 0; u < THUMB; u++) {
      const int x0 = of.x0 + u * width / THUMB, x1 = of.x0 + (u + 1) * width / THUMB;
      const int y0 = of.y0 + v * height / THUMB, y1 = of.y0 + (v + 1) * height / THUMB;
      const int sx = x1 - x0 > 16 ? (x1 - x0) / 8 : 1, sy = y1 - y0 > 16 ? (y1 - y0) / 8 : 1;
      double sum = 0;
      int count = 0;
      for (int y = y0; y < y1; y += sy)
        for (int x = x0; x < x1; x += sx, count++) {
          const uint8_t *p = image->data + 3 * ((size_t)y * (size_t)image->width + (size_t)x);
          sum += 0.3 * p[0] + 0.59 * p[1] + 0.11 * p[2];
        }
      thumb[v * THUMB + u] = count > 0 ? (float)(sum / count) : 0;
    }
}

/* Mean difference from the last thumbnail of the area, whose place the new one takes. */
static float change_of(const ern_image *image, struct area of, float last[THUMB * THUMB]) {
  float thumb[THUMB * THUMB];
  double sum = 0;
  shrink(image, of, thumb);
  for (int i = 0; i < THUMB * THUMB; i++) sum += fabs((double)thumb[i] - (double)last[i]);
  memcpy(last, thumb, sizeof thumb);
  return (float)(sum / (THUMB * THUMB));
}

/* The first frame after a cut, 0: no cut. A cut changes the picture by far more than a moving person does, and by far
 * more than the change before it, as a camera or a person who moves starts more slowly. The first change has none
 * before it and is compared with the one after it. */
static size_t cut_at(const struct scan *s, float before) {
  if (s->frames == 2 && before > 12 && before > 3 * s->change) return 1;
  const bool more = s->change > 12 && s->change > 6 * fmaxf(s->usual, 0.5f) && s->change > 3 * before;
  return s->frames > 1 && more ? s->frames : 0;
}

static void compare(struct scan *s, const ern_image *image) {
  const float change = change_of(image, (struct area){0, 0, image->width, image->height}, s->thumb);
  if (s->frames == 0) return;
  const float before = s->change;
  s->change = change;
  s->most_change = fmaxf(s->most_change, change);
  if (s->place.x1 > 0) s->most_change = fmaxf(s->most_change, change_of(image, s->place, s->around));
  const size_t cut = cut_at(s, before);
  if (s->cut == 0) s->cut = cut;
  if (s->search != NULL && s->search->cut == 0) s->search->cut = cut;
  s->usual += 0.1f * (fminf(s->change, 10) - s->usual);
}

/* The largest face, or one that is nearly as large and nearer to where the last one was. */
static const struct ern_found_face *choose(const struct scan *s, const struct ern_found_face *faces, size_t count) {
  const struct ern_found_face *last = s->looks > 0 ? &s->faces[s->looks - 1] : NULL, *best = &faces[0];
  double least = HUGE_VAL;
  if (last == NULL || last->width <= 0) return best;
  for (size_t i = 0; i < count; i++) {
    const double away = hypot((double)(faces[i].x + 0.5f * faces[i].width - last->x - 0.5f * last->width),
                              (double)(faces[i].y + 0.5f * faces[i].height - last->y - 0.5f * last->height));
    if (faces[i].width < 0.6f * faces[0].width || away >= least) continue;
    least = away;
    best = &faces[i];
  }
  return best;
}

/* The next changes round the face are measured in a square of twice its width. */
static void watch(struct scan *s, const ern_image *image, const struct ern_found_face *face) {
  const float x = face->x + 0.5f * face->width, y = face->y + 0.5f * face->height;
  const struct area place = {(int)fmaxf(x - face->width, 0), (int)fmaxf(y - face->width, 0),
                             (int)fminf(x + face->width, (float)image->width),
                             (int)fminf(y + face->width, (float)image->height)};
  if (place.x1 <= place.x0 || place.y1 <= place.y0) return;
  s->place = place;
  shrink(image, place, s->around);
}

static ern_status look(struct scan *s, const ern_image *image) {
  ern_status status = ERN_OK;
  struct ern_found_face found[FACES], *larger = NULL;
  size_t count = 0;
  if (s->looks == s->capacity) {
    const size_t capacity = 2 * s->capacity + 256;
    ERN_TRY(ERN_NEW(s->job->context, capacity, &larger));
    if (s->looks > 0) memcpy(larger, s->faces, s->looks * sizeof *larger);
    ern_release(s->job->context, s->faces);
    s->faces = larger;
    s->capacity = capacity;
  }
  ERN_TRY(ern_face_detector_find(s->detector, image, s->aspect, found, FACES, &count));
  struct ern_found_face face = {0};
  if (count > 0) {
    face = *choose(s, found, count);
    s->found++;
    watch(s, image, &face);
    ERN_TRY(ern_face_sharpness(s->job->context, image, &face));
    size_t others = 0; /* with eyes: a detection without eyes is often no face */
    for (size_t i = 0; i < count; i++) others += found[i].has_eyes && found[i].width > 0.5f * face.width;
    s->with_others += others > 1;
  }
  face.frame = s->frames;
  s->faces[s->looks++] = face;
  if (s->search != NULL) ERN_TRY(ern_segment_add(s->job->context, s->search, &face));
fail:
  return status;
}

/* *total: frames that the step processes, for the progress, where the video has `expected`: those of this scan and of
 * writing; with a search, also those of the scan and the writing of the segment. */
static ern_status work_of(const struct scan *s, size_t expected, size_t *total) {
  double length = 0, longer_than = 0;
  *total = s->before + 2 * expected;
  if (s->search == NULL) return ERN_OK;
  const ern_status status = ern_segment_read(s->job->context, s->job->options->segment, &length, &longer_than);
  if ((double)expected > longer_than * ERN_PREPARE_RATE) *total = expected + 2 * (size_t)(length * ERN_PREPARE_RATE);
  return status;
}

static ern_status scan_video(struct scan *s) {
  ern_status status = ERN_OK;
  struct ern_footage footage = {0};
  const ern_image *image = NULL;
  ERN_TRY(ern_footage_open(s->job, &footage));
  if (strstr(footage.info.other_streams, "(video") != NULL)
    ern_log(s->job->context, ERN_LOG_WARNING, "%s: has other pictures too, %s, which are not read; expected one track",
            s->job->video, footage.info.other_streams);
  s->width = footage.info.width;
  s->height = footage.info.height;
  s->aspect = footage.info.pixel_aspect;
  s->has_sound = footage.info.has_sound;
  size_t total = 0;
  ERN_TRY(work_of(s, ern_footage_expected(&footage), &total));
  const size_t most = s->search != NULL ? SEARCHED : ERN_PREPARE_FRAMES;
  const size_t patience = s->search != NULL ? LONG_PATIENCE : PATIENCE;
  for (;; s->frames++) {
    ERN_TRY(ern_footage_next(&footage, &image));
    if (image == NULL) {
      if (!footage.has_next) s->end = footage.now_at + footage.between - footage.first;
      break;
    }
    if (s->frames == most)
      ERN_TRY(ern_fail(s->job->context, ERN_E_SHAPE,
                       "%s: is longer than %zu minutes, expected a part of it: --from SECONDS --to SECONDS%s",
                       s->job->video, most / ERN_PREPARE_RATE / 60, s->search == NULL ? ", or --segment auto" : ""));
    if (image->width != s->width || image->height != s->height)
      ERN_TRY(ern_fail(s->job->context, ERN_E_UNSUPPORTED, "%s: frame %zu is %d x %d, expected %d x %d as the first",
                       s->job->video, s->frames, image->width, image->height, s->width, s->height));
    s->held += fabs(footage.now_at - footage.first - footage.from - (double)s->frames / ERN_PREPARE_RATE) > HELD;
    compare(s, image);
    if (s->frames % EVERY == 0) ERN_TRY(look(s, image));
    if (s->found == 0 && s->frames >= patience) break;
    const size_t done = s->before + s->frames;
    ERN_TRY(ern_prepare_progress(s->job, done, done < total ? total : done + s->frames));
  }
  s->left_out = footage.left_out;
fail:
  ern_footage_close(&footage);
  return status;
}

/* Removes detections far from the face's usual position. */
static ern_status drop_outliers(struct scan *s, double *width) {
  ern_status status = ERN_OK;
  float *values = NULL, middle[3] = {0, 0, 0};
  ERN_TRY(ERN_NEW(s->job->context, s->looks, &values));
  for (int c = 0; c < 3; c++) {
    size_t n = 0;
    for (size_t i = 0; i < s->looks; i++) {
      const struct ern_found_face *f = &s->faces[i];
      if (f->width > 0) values[n++] = c == 0 ? f->width : c == 1 ? f->x + 0.5f * f->width : f->y + 0.5f * f->height;
    }
    middle[c] = ern_quantile(values, n, 0.5);
  }
  for (size_t i = 0; i < s->looks; i++) {
    struct ern_found_face *f = &s->faces[i];
    const bool same = fabsf(f->width / middle[0] - 1) < 0.4f &&
                      hypotf(f->x + 0.5f * f->width - middle[1], f->y + 0.5f * f->height - middle[2]) < 2 * middle[0];
    if (f->width > 0 && !same) f->width = 0, s->found--;
  }
  *width = (double)middle[0];
fail:
  ern_release(s->job->context, values);
  return status;
}

/* The median over the faces; 0: not known. */
static ern_status sharpness_of(const struct scan *s, double *sharpness) {
  float *values = NULL;
  size_t n = 0;
  const ern_status status = ERN_NEW(s->job->context, s->looks, &values);
  if (status != ERN_OK) return status;
  for (size_t i = 0; i < s->looks; i++)
    if (s->faces[i].width > 0) values[n++] = s->faces[i].sharpness;
  *sharpness = n > 0 ? (double)ern_quantile(values, n, 0.5) : 0;
  ern_release(s->job->context, values);
  return ERN_OK;
}

static ern_status check_sharpness(const struct scan *s) {
  double sharpness = 0;
  const ern_status status = sharpness_of(s, &sharpness);
  ern_prepare_figure(s->job, "face_sharpness", sharpness);
  if (status == ERN_OK && sharpness > 0 && sharpness < LEAST_SHARPNESS)
    ern_prepare_add_reason(
        s->job, ERN_PREPARE_DOUBTFUL,
        "the face is soft, as one that is out of focus or was enlarged: its fine details have %.2f of "
        "the energy of its coarse ones, expected %.2f; the portrait becomes as soft, and a sharper "
        "recording helps",
        sharpness, LEAST_SHARPNESS);
  return status;
}

/* region: x, y, width, height of the square, pixels of the video (width differs from height where its pixels are not
 * square). */
static void place_crop(struct scan *s, double face, double region[4]) {
  double box[4] = {HUGE_VAL, HUGE_VAL, -HUGE_VAL, -HUGE_VAL}; /* bounding box of the head over all looks */
  for (size_t i = 0; i < s->looks; i++) {
    const struct ern_found_face *f = &s->faces[i];
    if (f->width <= 0) continue;
    box[0] = fmin(box[0], (double)(f->x - 0.25f * f->width));
    box[1] = fmin(box[1], (double)(f->y - 0.45f * f->height));
    box[2] = fmax(box[2], (double)(f->x + 1.25f * f->width));
    box[3] = fmax(box[3], (double)(f->y + 1.25f * f->height));
  }
  const double wide = s->width * s->aspect, most = fmin(wide, s->height); /* unit: a pixel's height */
  double side = fmax(fmax((box[2] - box[0]) * s->aspect * 1.1, (box[3] - box[1]) * 1.1), 2.4 * face * s->aspect);
  if (side > 0.85 * most) side = most;
  side = floor(side);
  const double x = 0.5 * (box[0] + box[2]) * s->aspect - 0.5 * side, y = 0.5 * (box[1] + box[3]) - 0.46 * side;
  region[0] = round(fmin(fmax(x, 0), wide - side) / s->aspect);
  region[1] = round(fmin(fmax(y, 0), s->height - side));
  region[2] = round(side / s->aspect);
  region[3] = side;
}

/* Converts the faces to pixels of the clip and removes those outside the square. Returns their number. */
static size_t take_faces(struct scan *s, const double region[4]) {
  const double sx = s->job->side / region[2], sy = s->job->side / region[3];
  size_t count = 0;
  for (size_t i = 0; i < s->looks; i++) {
    struct ern_found_face f = s->faces[i];
    if (f.width <= 0) continue;
    f.x = (float)(((double)f.x - region[0]) * sx);
    f.y = (float)(((double)f.y - region[1]) * sy);
    f.width *= (float)sx;
    f.height *= (float)sy;
    for (int e = 0; e < 2 && f.has_eyes; e++) {
      f.eyes[e][0] = (float)(((double)f.eyes[e][0] - region[0]) * sx);
      f.eyes[e][1] = (float)(((double)f.eyes[e][1] - region[1]) * sy);
    }
    if (f.has_eyes && (f.eyes[0][0] < 0 || f.eyes[1][0] < 0)) f.has_eyes = false;
    s->faces[count++] = f;
  }
  return count;
}

/* Scans the whole part, or chooses the segment of options->segment and scans it; *found is false where every segment
 * has a cut. */
static ern_status scan_part(struct scan *s, bool *found) {
  ern_status status = ERN_OK;
  struct ern_prepare_job *job = s->job;
  struct ern_segment_search search = {0};
  double length = 0, longer_than = 0;
  *found = true;
  s->search = job->options->segment != NULL && job->segment[1] <= 0 ? &search : NULL;
  ERN_TRY(scan_video(s));
  if (s->search == NULL) goto fail;
  ERN_TRY(ern_segment_read(job->context, job->options->segment, &length, &longer_than));
  if (s->found == 0 || (double)s->frames <= longer_than * ERN_PREPARE_RATE) goto fail;
  ERN_TRY(ern_segment_choose(job, &search, EVERY, length, found));
  if (!*found) {
    ern_prepare_add_reason(
        job, ERN_PREPARE_REFUSED,
        "no stretch of %g s is without a cut, expected one camera that stands still; --segment SECONDS "
        "asks for fewer, --from and --to choose a part",
        length);
    goto fail;
  }
  ern_release(job->context, s->faces);
  *s = (struct scan){.job = job, .detector = s->detector, .before = s->frames};
  ERN_TRY(scan_video(s));
fail:
  s->search = NULL;
  ern_segment_free(job->context, &search);
  return status;
}

/* Records that the folder belongs to this video, also for a later call that resumes this one. */
static ern_status begin_frames(struct scan *s) {
  ern_status status = ERN_OK;
  struct ern_prepare_job *job = s->job;
  ERN_TRY(ern_prepare_clear(job));
  if (json_object_set_new(job->record, "frames", json_integer((json_int_t)s->frames)) != 0 ||
      json_object_set_new(job->record, "steps", json_object()) != 0 ||
      (job->segment[1] > 0 &&
       json_object_set_new(job->record, "segment",
                           json_pack("{s:f, s:f}", "from", job->segment[0], "to", job->segment[1])) != 0))
    ERN_TRY(ern_fail(job->context, ERN_E_NO_MEMORY, "%s: no memory for its record", job->folder));
  ERN_TRY(ern_prepare_record_save(job));
fail:
  return status;
}

static ern_status write_frames(struct scan *s, const double region[4]) {
  ern_status status = ERN_OK;
  struct ern_prepare_job *job = s->job;
  struct ern_footage footage = {0};
  const ern_image *image = NULL;
  ern_image crop = {0};
  char path[ERN_PREPARE_PATH], name[64];
  ERN_TRY(ern_prepare_path(job, path, "ori_imgs"));
  ERN_TRY(ern_folder_make(job->context, path));
  ERN_TRY(ern_footage_open(job, &footage));
  for (size_t i = 0; i < s->frames; i++) {
    ERN_TRY(ern_footage_next(&footage, &image));
    if (image == NULL) ERN_TRY(ern_fail(job->context, ERN_E_FORMAT, "%s: changed while it was read", job->video));
    ERN_TRY(ern_picture_crop(job->context, image, region, job->side, &crop));
    snprintf(name, sizeof name, "ori_imgs/%zu.jpg", i);
    ERN_TRY(ern_prepare_register_output(job, name, path));
    ERN_TRY(ern_image_write(job->context, path, &crop, QUALITY));
    ern_image_free(job->context, &crop);
    ERN_TRY(ern_prepare_progress(job, s->before + s->frames + i + 1, s->before + 2 * s->frames));
  }
fail:
  ern_image_free(job->context, &crop);
  ern_footage_close(&footage);
  return status;
}

/* Refuses a track without speech, before the frames are written; aud.wav is of the step "features". */
static ern_status check_sound(struct scan *s) {
  struct ern_prepare_job *job = s->job;
  ern_sound sound = {0};
  double missing = 0;
  const ern_status status = ern_prepare_sound_read(job, s->frames, 0, &sound, &missing);
  if (status != ERN_OK || sound.data == NULL) return status;
  int loudest = 0;
  for (size_t i = 0; i < sound.frames; i++)
    if (abs(sound.data[i]) > loudest) loudest = abs(sound.data[i]);
  const double wanted = (double)s->frames / ERN_PREPARE_RATE, end = fmax(wanted - missing, 0);
  double from = 0, to = 0;
  ern_prepare_part(job, &from, &to);
  if (missing > SOUND_SHORTER)
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "the sound ends at %.2f s of the %.2f s of pictures, and silence follows; expected sound to the "
        "end, or --to %.2f",
        end, wanted, from + end);
  if (loudest < FAINTEST && job->options->features == NULL)
    ern_prepare_add_reason(job, ERN_PREPARE_REFUSED,
                           "the sound of the part is silent, and a mouth cannot be learnt without speech; expected a "
                           "video whose sound is not muted, or --features FILE.npy");
  ern_sound_free(job->context, &sound);
  return ERN_OK;
}

/* Text that describes --from and --to in the video; "" where neither is set. */
static void describe_part(const struct scan *s, double from, double to, char text[128]) {
  int used = 0;
  text[0] = 0;
  if (from > 0) used += ern_format(text, 128, " --from %g", from);
  if (to > 0) used += ern_format(text + used, 128 - (size_t)used, " --to %g", to);
  if (used > 0 && s->end > 0) ern_format(text + used, 128 - (size_t)used, " of a video of %.2f s", s->end);
}

/* Adds the verdicts that are known before cropping; false where the video is refused. */
static bool check_scan(struct scan *s) {
  struct ern_prepare_job *job = s->job;
  const double share = s->looks > 0 ? (double)s->found / (double)s->looks : 0;
  const double seconds = (double)s->frames / ERN_PREPARE_RATE;
  double from = 0, to = 0;
  char part[128];
  ern_prepare_part(job, &from, &to);
  describe_part(s, from, to, part);
  ern_prepare_figure(job, "frames", (double)s->frames);
  ern_prepare_figure(job, "faces", share);
  ern_prepare_figure(job, "sound", s->has_sound);
  if (s->frames < FEWEST_FRAMES)
    ern_prepare_add_reason(job, ERN_PREPARE_REFUSED, "the part%s is %.2f s long, expected at least 1 s, better minutes",
                           part, seconds);
  else if (s->found == 0)
    ern_prepare_add_reason(
        job, ERN_PREPARE_REFUSED,
        "no face was found in %.0f s, expected a person who looks into the camera, the face at least a "
        "ninth of the picture's shorter side",
        seconds);
  else if (s->cut > 0)
    ern_prepare_add_reason(job, ERN_PREPARE_REFUSED,
                           "the picture changes at once at %.2f s, as at a cut; expected one camera that stands still: "
                           "--from and --to choose a part without cuts",
                           from + (double)s->cut / ERN_PREPARE_RATE);
  else if (s->most_change < 0.3f)
    ern_prepare_add_reason(job, ERN_PREPARE_REFUSED,
                           "the picture never changes, expected a person who speaks and moves");
  else if (share < 0.5)
    ern_prepare_add_reason(
        job, ERN_PREPARE_REFUSED,
        "a face that looks into the camera was found in %.0f %% of the frames, expected at least 50 %%; "
        "--from and --to choose a part without profile views",
        100 * share);
  if (job->verdict->grade == ERN_PREPARE_REFUSED) return false;
  if (share < 0.8)
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "a face that looks into the camera was found in %.0f %% of the frames, expected at least 80 %%", 100 * share);
  if (s->frames < FEW_FRAMES)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL, "the part is %.1f s long; to learn the mouth takes 60 s or more",
                           seconds);
  if (s->held >= FEWEST_HELD && 100 * s->held > s->frames)
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "for %.1f s of it the video has no pictures of its own, and repeats those around; expected 10 "
        "frames a second or more, without gaps",
        (double)s->held / ERN_PREPARE_RATE);
  if (s->left_out >= FEWEST_HELD && 100 * s->left_out > s->frames)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL,
                           "%zu pictures of the video are left out, as their times are not later than those of the "
                           "pictures before; expected times that rise, or a part where they do: --from, --to",
                           s->left_out);
  if (s->end > 0 && s->end + PART_SHORTER < to)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL, "the video ends at %.2f s, before --to %g", s->end, to);
  if (4 * s->with_others > s->looks)
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "more than one face was found in %.0f %% of the frames; the largest that stays in its place is "
        "taken",
        100.0 * (double)s->with_others / (double)s->looks);
  return true;
}

static void check_crop(struct scan *s, double face, const double region[4]) {
  struct ern_prepare_job *job = s->job;
  size_t out = 0;
  for (size_t i = 0; i < s->looks; i++) {
    const struct ern_found_face *f = &s->faces[i];
    out += f->width > 0 &&
           ((double)f->x < region[0] || (double)f->y < region[1] + 0.02 * region[3] ||
            (double)(f->x + f->width) > region[0] + region[2] || (double)(f->y + f->height) > region[1] + region[3]);
  }
  const double share = (double)out / (double)s->found, large = face / region[2] * job->side;
  ern_prepare_figure(job, "face_pixels", large);
  if (share > 0.02)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL, "the face touches the picture's edge in %.0f %% of the frames",
                           100 * share);
  if (region[3] * 1.6 < job->side)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL,
                           "the head is small: %.0f pixels of the video become %d; --size %.0f avoids the enlargement",
                           region[3], job->side, fmax(128, region[3]));
}

ern_status ern_prepare_face(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  struct scan scan = {.job = job};
  double face = 0, region[4] = {0};
  bool found = false;
  ERN_TRY(ern_face_detector_make(job->context, job->options->detector, &scan.detector));
  ERN_TRY(scan_part(&scan, &found));
  if (!found || !check_scan(&scan)) goto fail;
  ERN_TRY(check_sound(&scan));
  if (job->verdict->grade == ERN_PREPARE_REFUSED) goto fail;
  ERN_TRY(drop_outliers(&scan, &face));
  place_crop(&scan, face, region);
  check_crop(&scan, face, region);
  ERN_TRY(check_sharpness(&scan));
  ERN_TRY(begin_frames(&scan));
  ERN_TRY(write_frames(&scan, region));
  job->frames = scan.frames;
  ERN_TRY(ern_prepare_faces_write(job, scan.faces, take_faces(&scan, region)));
  char hash[65]; /* by which `ernerf dub` knows the video */
  ERN_TRY(ern_file_sha256(job->context, job->video, hash));
  json_t *crop =
      json_pack("{s:f, s:f, s:f, s:f, s:i, s:i, s:i, s:s}", "x", region[0], "y", region[1], "width", region[2], "side",
                region[3], "size", job->side, "video_width", scan.width, "video_height", scan.height, "sha256", hash);
  if (crop == NULL || json_object_set_new(job->record, "crop", crop) != 0)
    ERN_TRY(ern_fail(job->context, ERN_E_NO_MEMORY, "%s: no memory for its record", job->folder));
fail:
  ern_face_detector_free(&scan.detector);
  ern_release(job->context, scan.faces);
  return status;
}
