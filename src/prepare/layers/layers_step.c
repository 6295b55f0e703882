/* SPDX-License-Identifier: MIT
 * The step "layers": person, head, neck and torso of every frame, and the background. The first pass learns from some
 * frames of the whole clip, the second writes the pictures of every frame. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "io/file.h"
#include "prepare/face_detector.h"
#include "prepare/head_shape.h"
#include "prepare/layers/banner.h"
#include "prepare/layers/layers.h"
#include "prepare/stabilized_crop.h"

enum { EXAMPLES = 30, VOTES = 5, QUALITY = 95 };

/* Metres. Where the picture's lower edge is shoulders_below or more under the middle of the head, a person is wider
 * there than twice half_shoulders. Half a head is 0.075 wide. */
static const double shoulders_below = 0.15, half_shoulders = 0.11;
/* The person's share of the picture, or square metres, relative to the median over the frames. Of seven people the
 * share was 0.9 to 1.2. */
static const float least_area = 0.5F, most_area = 1.5F;
/* Share of the picture. */
static const double most_inset = 0.004;

struct voter { /* a frame with a mask, which waits for the masks of its neighbours */
  size_t frame;
  ern_image image;
  uint8_t *mask, *parts; /* [work][work], [side][side] */
  bool has_parts;
};

struct layers {
  struct ern_prepare_job *job;
  struct ern_layer_face *faces; /* [job->frames] */
  struct ern_supplied_masks *supplied;
  struct ern_person_model *model;
  struct ern_person_found found;
  struct ern_banner banner;
  double place;             /* of read_background() */
  struct voter ring[VOTES]; /* frame f is at f % VOTES */
  uint8_t *mask, *voted, *alpha, *behind, *parts, *rgba;
  /* over the frames so far */
  size_t border[16];
  double covered;     /* mean of the areas */
  float *areas;       /* [job->frames]: the person's share of the picture */
  float *jitter;      /* [job->frames]: relative second differences of the area in time (jitter) */
  size_t low, narrow; /* frames that show the shoulders; those of them that are too narrow */
};

static ern_status open_layers(struct layers *l, struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  const size_t pixels = (size_t)job->side * (size_t)job->side;
  const size_t work = (size_t)ern_person_work(job->side) * (size_t)ern_person_work(job->side);
  char path[ERN_PREPARE_PATH];
  l->job = job;
  static const char *const folders[] = {"parsing", "torso_imgs", "gt_imgs"};
  for (size_t i = 0; i < sizeof folders / sizeof *folders; i++) {
    ERN_TRY(ern_prepare_path(job, path, "%s", folders[i]));
    ERN_TRY(ern_folder_make(job->context, path));
  }
  ERN_TRY(ERN_NEW(job->context, job->frames, &l->faces));
  ERN_TRY(ERN_NEW(job->context, job->frames, &l->areas));
  ERN_TRY(ERN_NEW(job->context, job->frames, &l->jitter));
  ERN_TRY(ERN_NEW(job->context, pixels, &l->mask));
  ERN_TRY(ERN_NEW(job->context, pixels, &l->alpha));
  ERN_TRY(ERN_NEW(job->context, pixels, &l->parts));
  ERN_TRY(ERN_NEW(job->context, 3 * pixels, &l->behind));
  ERN_TRY(ERN_NEW(job->context, 4 * pixels, &l->rgba));
  ERN_TRY(ERN_NEW(job->context, work, &l->voted));
  for (int i = 0; i < VOTES; i++) {
    ERN_TRY(ERN_NEW(job->context, work, &l->ring[i].mask));
    ERN_TRY(ERN_NEW(job->context, pixels, &l->ring[i].parts));
  }
  ERN_TRY(ern_layer_faces_read(job, l->faces));
  ERN_TRY(ern_person_model_make(job->context, job->side, &l->model));
  if (job->options->masks != NULL) ERN_TRY(ern_supplied_masks_open(job, &l->supplied));
fail:
  return status;
}

static void close_layers(struct layers *l) {
  ern_context *context = l->job->context;
  ern_person_model_free(l->model);
  ern_supplied_masks_free(l->supplied);
  for (int i = 0; i < VOTES; i++) {
    ern_image_free(context, &l->ring[i].image);
    ern_release(context, l->ring[i].mask);
    ern_release(context, l->ring[i].parts);
  }
  ern_release(context, l->faces);
  ern_release(context, l->areas);
  ern_release(context, l->jitter);
  ern_release(context, l->mask);
  ern_release(context, l->alpha);
  ern_release(context, l->parts);
  ern_release(context, l->behind);
  ern_release(context, l->rgba);
  ern_release(context, l->voted);
}

static ern_status read_frame(const struct ern_prepare_job *job, size_t frame, ern_image *image) {
  char name[64];
  snprintf(name, sizeof name, "ori_imgs/%zu.jpg", frame);
  return ern_prepare_picture(job, name, 3, image);
}

/* Whether the aspect ratios agree to a hundredth. */
static bool has_form(const ern_image *image, int width, int height) {
  const double across = (double)image->width * height, along = (double)image->height * width;
  return fabs(across - along) <= 0.01 * along;
}

/* Crops a background picture with the video's aspect ratio to the clip's square and scales it to the clip's side; a
 * square picture is only scaled. *place: pixels of its square a side over the clip's, or over the video's where these
 * are fewer. */
static ern_status read_background(const struct ern_prepare_job *job, ern_image *background, double *place) {
  ern_status status = ERN_OK;
  ern_image whole = {0};
  const json_t *crop = json_object_get(job->record, "crop");
  double region[4] = {json_number_value(json_object_get(crop, "x")), json_number_value(json_object_get(crop, "y")),
                      json_number_value(json_object_get(crop, "width")),
                      json_number_value(json_object_get(crop, "side"))};
  const double needed = region[3] >= 1 ? fmin(region[3], job->side) : job->side;
  const int width = (int)json_integer_value(json_object_get(crop, "video_width"));
  const int height = (int)json_integer_value(json_object_get(crop, "video_height"));
  ERN_TRY(ern_image_read(job->context, job->options->background, 3, &whole));
  const bool square = has_form(&whole, 1, 1), same = whole.width == width && whole.height == height;
  const bool of_video = same || (!square && width > 0 && height > 0 && has_form(&whole, width, height));
  if (of_video && region[0] >= 0 && region[1] >= 0 && region[2] >= 1 && region[3] >= 1 &&
      region[0] + region[2] <= width && region[1] + region[3] <= height) {
    for (int i = 0; i < 4; i++) region[i] *= i % 2 == 0 ? (double)whole.width / width : (double)whole.height / height;
    *place = region[3] / needed;
    ERN_TRY(ern_picture_crop(job->context, &whole, region, job->side, background));
  } else if (square) {
    *place = whole.height / needed;
    ERN_TRY(ern_image_resize(job->context, &whole, job->side, job->side, background));
  } else {
    ERN_TRY(ern_fail(job->context, ERN_E_SHAPE,
                     "%s: the background is %d x %d, expected the form of the video (%d x %d), or a square of what the "
                     "clip shows",
                     job->options->background, whole.width, whole.height, width, height));
  }
fail:
  ern_image_free(job->context, &whole);
  return status;
}

/* Adds `image`, which is a frame, and one shortly after it. */
static ern_status learn_banner(struct layers *l, size_t frame, const ern_image *image) {
  ern_image later = {0};
  if (frame + ERN_BANNER_GAP >= l->job->frames) return ERN_OK;
  ern_status status = read_frame(l->job, frame + ERN_BANNER_GAP, &later);
  if (status == ERN_OK) status = ern_banner_add(&l->banner, l->job->context, image, &later);
  ern_image_free(l->job->context, &later);
  return status;
}

/* The first pass: learns the model. */
static ern_status learn(struct layers *l, size_t total) {
  struct ern_prepare_job *job = l->job;
  ern_status status = ERN_OK;
  ern_image image = {0}, background = {0};
  const size_t count = job->frames < EXAMPLES ? job->frames : EXAMPLES;
  const char *place = job->options->background;
  const bool key = place != NULL && strcmp(place, "key") == 0;
  if (place != NULL && !key) ERN_TRY(read_background(job, &background, &l->place));
  for (size_t i = 0; i < count; i++) {
    const size_t frame = count > 1 ? i * (job->frames - 1) / (count - 1) : 0;
    bool has_parts = false;
    ERN_TRY(read_frame(job, frame, &image));
    if (l->supplied != NULL)
      ERN_TRY(ern_supplied_mask(l->supplied, frame, image.data, &l->faces[frame], l->mask, l->parts, &has_parts));
    ERN_TRY(ern_person_model_add(l->model, image.data, &l->faces[frame], l->supplied != NULL ? l->mask : NULL));
    ERN_TRY(learn_banner(l, frame, &image));
    ern_image_free(job->context, &image);
    ERN_TRY(ern_prepare_progress(job, i + 1, total));
  }
  ERN_TRY(ern_person_model_learn(l->model, background.data, key, &l->found));
fail:
  ern_image_free(job->context, &image);
  ern_image_free(job->context, &background);
  return status;
}

static ern_status write_picture(struct layers *l, const char *folder, size_t frame, const char *ending, int channels) {
  char path[ERN_PREPARE_PATH], name[64];
  const ern_image image = {.width = l->job->side, .height = l->job->side, .channels = channels, .data = l->rgba};
  snprintf(name, sizeof name, "%s/%zu.%s", folder, frame, ending);
  ern_status status = ern_prepare_register_output(l->job, name, path);
  if (status == ERN_OK) status = ern_image_write(l->job->context, path, &image, QUALITY);
  return status;
}

static ern_status write_parsing(struct layers *l, size_t frame) {
  static const uint8_t colours[4][3] = {{255, 255, 255}, {0, 0, 255}, {0, 255, 0}, {255, 0, 0}};
  const size_t pixels = (size_t)l->job->side * (size_t)l->job->side;
  for (size_t k = 0; k < pixels; k++) memcpy(l->rgba + 3 * k, colours[l->parts[k]], 3);
  return write_picture(l, "parsing", frame, "png", 3);
}

/* Adds a frame to the shares of the picture and to the jitter of the person's area. */
static void measure(struct layers *l, size_t frame) {
  const size_t pixels = (size_t)l->job->side * (size_t)l->job->side;
  double area = 0;
  for (size_t k = 0; k < pixels; k++) area += l->parts[k] != ERN_PART_BACKGROUND ? 1 : 0;
  area /= (double)pixels;
  l->covered += area / (double)l->job->frames;
  l->areas[frame] = (float)area;
  if (frame >= 2 && area > 0)
    l->jitter[frame] = (float)fabs(area - 2 * (double)l->areas[frame - 1] + (double)l->areas[frame - 2]) / (float)area;
}

/* Detects missing shoulders: clothes that never move may be learnt as the background. */
static void measure_shoulders(struct layers *l, size_t frame) {
  static const double origin[3] = {0, 0, 0};
  const struct ern_layer_face *face = &l->faces[frame];
  const int side = l->job->side;
  const uint8_t *lowest = l->parts + (size_t)(side - 1) * (size_t)side;
  const double metre = face->focal / -face->pose.translation[2]; /* pixels */
  double middle[2] = {0, 0};
  int first = 0, last = side - 1;
  if (!ern_head_project(&face->pose, face->focal, face->middle, origin, middle)) return;
  if (side - 1 - middle[1] < shoulders_below * metre) return;
  while (first < side && lowest[first] == ERN_PART_BACKGROUND) first++;
  while (last >= 0 && lowest[last] == ERN_PART_BACKGROUND) last--;
  const double left = fmin(half_shoulders * metre, middle[0] - 1);
  const double right = fmin(half_shoulders * metre, side - 2 - middle[0]);
  l->low++;
  l->narrow += middle[0] - first < left || last - middle[0] < right;
}

/* Writes the pictures of a frame whose neighbours' masks are in the ring. */
static ern_status finish(struct layers *l, size_t frame, size_t last) {
  struct ern_prepare_job *job = l->job;
  ern_status status = ERN_OK;
  const uint8_t *masks[VOTES];
  const struct ern_layer_face *faces[VOTES];
  size_t count = 0, which = 0;
  struct voter *own = &l->ring[frame % VOTES];
  for (size_t f = frame > VOTES / 2 ? frame - VOTES / 2 : 0; f <= last; f++) {
    if (f == frame) which = count;
    masks[count] = l->ring[f % VOTES].mask;
    faces[count++] = &l->faces[f];
  }
  const uint8_t *rgb = own->image.data, *background = ern_person_model_background(l->model);
  ERN_TRY(ern_person_temporal_mean(l->model, masks, faces, count, which, l->voted));
  ERN_TRY(ern_person_inset_add(l->model, rgb, &l->faces[frame], l->voted));
  ERN_TRY(ern_person_matte(l->model, rgb, l->voted, l->alpha, l->behind, l->border));
  if (own->has_parts) {
    memcpy(l->parts, own->parts, (size_t)job->side * (size_t)job->side);
    for (size_t k = 0; k < (size_t)job->side * (size_t)job->side; k++)
      l->alpha[k] = l->parts[k] == ERN_PART_BACKGROUND ? l->alpha[k] & 127 : l->alpha[k] | 128;
  } else {
    ERN_TRY(ern_head_parts(job->context, rgb, l->alpha, &l->faces[frame], job->side, l->parts));
  }
  measure(l, frame);
  measure_shoulders(l, frame);
  ERN_TRY(write_parsing(l, frame));
  ern_layer_frame(rgb, l->alpha, l->behind, l->parts, background, job->options->head_only, job->side, l->rgba);
  ERN_TRY(write_picture(l, "gt_imgs", frame, "jpg", 3));
  if (job->options->head_only)
    memset(l->rgba, 0, 4 * (size_t)job->side * (size_t)job->side);
  else
    ERN_TRY(ern_layer_torso(job->context, rgb, l->alpha, l->behind, l->parts, job->side, l->rgba));
  ERN_TRY(write_picture(l, "torso_imgs", frame, "png", 4));
fail:
  return status;
}

/* The second pass: writes the pictures. */
static ern_status cut_out(struct layers *l, size_t done, size_t total) {
  struct ern_prepare_job *job = l->job;
  ern_status status = ERN_OK;
  for (size_t f = 0; f < job->frames + VOTES / 2; f++) {
    if (f < job->frames) {
      struct voter *own = &l->ring[f % VOTES];
      ern_image_free(job->context, &own->image);
      ERN_TRY(read_frame(job, f, &own->image));
      if (l->supplied != NULL)
        ERN_TRY(ern_supplied_mask(l->supplied, f, own->image.data, &l->faces[f], l->mask, own->parts, &own->has_parts));
      ERN_TRY(
          ern_person_mask(l->model, own->image.data, &l->faces[f], l->supplied != NULL ? l->mask : NULL, own->mask));
    }
    if (f < VOTES / 2) continue;
    const size_t frame = f - VOTES / 2, last = f < job->frames ? f : job->frames - 1;
    if (frame >= job->frames) break;
    ERN_TRY(finish(l, frame, last));
    ERN_TRY(ern_prepare_progress(job, done + frame + 1, total));
  }
fail:
  return status;
}

static void check_place(struct ern_prepare_job *job, const struct ern_person_found *found) {
  const double shift = found->shift * 512 / job->side;
  if (found->shifted >= 0.3 && shift > 1.5)
    ern_prepare_add_reason(
        job, shift > 12 ? ERN_PREPARE_REFUSED : ERN_PREPARE_DOUBTFUL,
        "the camera moves: what is behind the person shifts by %.1f pixels of 512, expected a camera that "
        "stands still (1.5 at most); footage from a tripod helps, or a stretch of it (--from, --to)",
        shift);
  else if (found->unlike > 0.15 && found->unlike_lit < found->unlike / 4)
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "the light changes: in a tenth of the frames what is behind the person is %.0f grey values or more brighter or "
        "darker than in most, and %.0f %% of it differs from frame to frame for that, expected 15 %% at most; a camera "
        "with fixed exposure helps, or a stretch of even light (--from, --to)",
        found->light, 100 * found->unlike);
  else if (found->unlike > 0.15)
    ern_prepare_add_reason(job, ERN_PREPARE_DOUBTFUL,
                           "the background changes: %.0f %% of it differs from frame to frame, expected 15 %% at most; "
                           "--masks helps, or a stretch where it stands still (--from, --to)",
                           100 * found->unlike);
  else if (found->inset > most_inset && job->options->background == NULL)
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "a part of the background changes, at %.0f to %.0f %% of the picture's width and %.0f to %.0f %% of its "
        "height, as an inset picture, a screen or a logo that moves does, and stands still in the portrait; a video "
        "with it cut off helps, or --background with a picture of the place without it",
        100 * found->inset_edges[0], 100 * found->inset_edges[1], 100 * found->inset_edges[2],
        100 * found->inset_edges[3]);
  if (found->supplied_difference > 23)
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "--background %s differs from what is seen beside the person by %.0f grey values, expected 23 at "
        "most: a picture of the same place from the same camera",
        job->options->background, found->supplied_difference);
}

static void check_shoulders(const struct layers *l) {
  ern_prepare_figure(l->job, "narrow_shoulders", l->low > 0 ? (double)l->narrow / (double)l->low : 0);
  if (2 * l->narrow > l->low && !l->job->options->head_only)
    ern_prepare_add_reason(
        l->job, ERN_PREPARE_DOUBTFUL,
        "the person has no shoulders in %zu of the %zu frames that reach down to them, as where clothes "
        "that never move are taken for the background; parsing and torso_imgs show it, --masks or "
        "--head-only helps",
        l->narrow, l->low);
}

/* The square metres that the person takes at the distance of the head, times a constant. */
static float near_area(const struct layers *l, size_t frame) {
  const double distance = l->faces[frame].pose.translation[2];
  return l->areas[frame] * (float)(distance * distance);
}

/* Detects frames in which the person is gone, or fills the picture: who leans toward the camera takes more of the
 * picture, and no more square metres. The jitter, which is read by then, is lost. */
static void check_areas(const struct layers *l) {
  const size_t frames = l->job->frames;
  size_t odd = 0, first = 0;
  for (size_t f = 0; f < frames; f++) l->jitter[f] = l->areas[f];
  const float usual = ern_quantile(l->jitter, frames, 0.5);
  for (size_t f = 0; f < frames; f++) l->jitter[f] = near_area(l, f);
  const float near = ern_quantile(l->jitter, frames, 0.5);
  for (size_t f = frames; f-- > 0;) {
    const float area = l->areas[f], metres = near_area(l, f);
    if ((area < least_area * usual && metres < least_area * near) ||
        (area > most_area * usual && metres > most_area * near)) {
      first = f;
      odd++;
    }
  }
  ern_prepare_figure(l->job, "odd_areas", (double)odd / (double)frames);
  if (odd > 0)
    ern_prepare_add_reason(
        l->job, ERN_PREPARE_DOUBTFUL,
        "in %zu of %zu frames, the first is %zu, the person takes %.0f %% of the picture, expected %.0f to %.0f %% as "
        "in the others: the person is not there, or the mask is wrong; --from and --to choose a part, --masks helps",
        odd, frames, first, 100 * (double)l->areas[first], 100 * (double)(least_area * usual),
        100 * (double)fminf(most_area * usual, 1));
}

static void check_banner(const struct layers *l) {
  const ern_prepare_options *options = l->job->options;
  double top = 0, bottom = 0;
  if (!ern_banner_find(&l->banner, l->job->frames, &top, &bottom) || options->masks != NULL || options->head_only)
    return;
  ern_prepare_add_reason(
      l->job, ERN_PREPARE_DOUBTFUL,
      "a banner moves through the picture without pause, at %.0f to %.0f %% of its height, as running text does, "
      "and becomes a part of the torso; a video with it cut off helps, or --masks, or --head-only",
      100 * top, 100 * bottom);
}

/* Figures and verdict; the bounds come from test footage. covered: mean share of the picture that the person covers;
 * jitter[job->frames]: sorted in place; border: histogram of colour distances along the border, bins 16 wide. */
static void check_person(struct ern_prepare_job *job, const struct ern_person_found *found, double covered,
                         float *jitter, const size_t border[16]) {
  size_t all = 0;
  for (int i = 0; i < 16; i++) all += border[i];
  const double faint = all > 0 ? (double)(border[0] + border[1]) / (double)all : 1;
  const double tremble = (double)ern_quantile(jitter, job->frames, 0.9);
  ern_prepare_figure(job, "person_share", covered);
  ern_prepare_figure(job, "area_tremble", tremble);
  ern_prepare_figure(job, "background_never_seen", found->never_seen);
  ern_prepare_figure(job, "background_unlike", found->unlike);
  ern_prepare_figure(job, "background_unlike_lit", found->unlike_lit);
  ern_prepare_figure(job, "background_light", found->light);
  ern_prepare_figure(job, "background_inset", found->inset);
  ern_prepare_figure(job, "background_shift", found->shift);
  ern_prepare_figure(job, "background_shift_told", found->shifted);
  ern_prepare_figure(job, "border_faint", faint);
  if (job->options->background != NULL) ern_prepare_figure(job, "background_difference", found->supplied_difference);
  if (covered < 0.08 || covered > 0.92)
    ern_prepare_add_reason(
        job, covered < 0.02 || covered > 0.98 ? ERN_PREPARE_REFUSED : ERN_PREPARE_DOUBTFUL,
        "the person takes %.0f %% of the picture, expected 8 to 92 %%; --masks or --background helps", 100 * covered);
  check_place(job, found);
  if (tremble > 0.04)
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "the person's outline trembles: its area changes by %.1f %% from frame to frame, expected 4 %% at "
        "most; --masks or --background helps, or --head-only where only the shoulders are wrong",
        100 * tremble);
  if (faint > 0.4)
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "%.0f %% of the person's outline has the colour of what is behind it, expected 40 %% at most; "
        "--masks helps, or footage before another background",
        100 * faint);
}

ern_status ern_prepare_layers(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  struct layers l = {.job = job};
  const size_t examples = job->frames < EXAMPLES ? job->frames : EXAMPLES,
               total = examples + (job->options->head_only ? 1 : 2) * job->frames;
  char path[ERN_PREPARE_PATH];
  ERN_TRY(ern_prepare_remove_made(job, "torso.npy")); /* an older one, of other frames */
  ERN_TRY(open_layers(&l, job));
  ERN_TRY(learn(&l, total));
  ERN_TRY(cut_out(&l, examples, total));
  ERN_TRY(ern_person_inset_find(l.model, &l.found));
  if (!job->options->head_only)
    ERN_TRY(ern_prepare_body_motion(job, l.faces, ern_person_model_background(l.model), examples + job->frames, total));
  memcpy(l.rgba, ern_person_model_background(l.model), 3 * (size_t)job->side * (size_t)job->side);
  const ern_image background = {.width = job->side, .height = job->side, .channels = 3, .data = l.rgba};
  ERN_TRY(ern_prepare_register_output(job, "bc.jpg", path));
  ERN_TRY(ern_image_write(job->context, path, &background, QUALITY));
  if (l.place > 0 && l.place < 0.99)
    ern_prepare_add_reason(
        job, ERN_PREPARE_DOUBTFUL,
        "--background %s is enlarged %.3g times, and blurred; expected a picture as large as the video",
        job->options->background, 1 / l.place);
  check_person(job, &l.found, l.covered, l.jitter, l.border);
  check_areas(&l);
  check_shoulders(&l);
  check_banner(&l);
fail:
  close_layers(&l);
  return status;
}

ern_status ern_prepare_layers_check(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  const char *place = job->options->background;
  ern_image background = {0};
  double share = 0;
  if (job->options->masks != NULL) ERN_TRY(ern_supplied_masks_check(job));
  if (place != NULL && strcmp(place, "key") != 0) ERN_TRY(read_background(job, &background, &share));
fail:
  ern_image_free(job->context, &background);
  return status;
}
