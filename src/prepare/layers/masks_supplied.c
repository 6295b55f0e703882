/* SPDX-License-Identifier: MIT
 * Masks that the user supplied: DIR/ID.png in AD-NeRF's colours or grey, or a network. */
#include <stdio.h>
#include <string.h>

#include "prepare/layers/layers.h"

struct ern_supplied_masks {
  const struct ern_prepare_job *job;
  struct ern_person_network *network; /* NULL: a folder */
  bool coloured;                      /* the files have AD-NeRF's colours; false: they are grey */
  size_t told_by;                     /* the first frame whose file decides that */
};

/* The part of a colour of AD-NeRF's parsing, -1 for any other colour. */
static int part_of(const uint8_t *rgb) {
  const int code = (rgb[0] == 255) + 2 * (rgb[1] == 255) + 4 * (rgb[2] == 255);
  if (rgb[0] % 255 != 0 || rgb[1] % 255 != 0 || rgb[2] % 255 != 0) return -1;
  switch (code) {
    case 1: return ERN_PART_TORSO;
    case 2: return ERN_PART_NECK;
    case 4: return ERN_PART_HEAD;
    case 7: return ERN_PART_BACKGROUND;
    default: return -1;
  }
}

/* A file that is all white is both grey and coloured. */
static ern_status read_file(const struct ern_prepare_job *job, size_t frame, ern_image *image, bool *grey,
                            bool *coloured) {
  ern_status status = ERN_OK;
  char path[ERN_PREPARE_PATH];
  const size_t pixels = (size_t)job->side * (size_t)job->side;
  *grey = *coloured = true;
  const int length = snprintf(path, sizeof path, "%s/%zu.png", job->options->masks, frame);
  if (length < 0 || length >= ERN_PREPARE_PATH)
    ERN_TRY(ern_fail(job->context, ERN_E_ARGUMENT, "%s: the path is too long", job->options->masks));
  ERN_TRY(ern_image_read(job->context, path, 3, image));
  if (image->width != job->side || image->height != job->side)
    ERN_TRY(ern_fail(job->context, ERN_E_SHAPE, "%s: the mask is %d x %d, expected %d x %d as the clip's pictures",
                     path, image->width, image->height, job->side, job->side));
  for (size_t k = 0; k < pixels; k++) {
    const uint8_t *c = image->data + 3 * k;
    *grey = *grey && c[0] == c[1] && c[0] == c[2];
    *coloured = *coloured && part_of(c) >= 0;
  }
  if (!*grey && !*coloured)
    ERN_TRY(ern_fail(job->context, ERN_E_FORMAT,
                     "%s: has other colours than a mask, expected head 0 0 255, neck 0 255 0, torso 255 0 0 and "
                     "background 255 255 255, or grey with the person above 0",
                     path));
fail:
  return status;
}

/* Detects whether the folder's files are coloured or grey. White means background in coloured files, and person in grey
 * files. */
static ern_status detect_form(struct ern_supplied_masks *masks) {
  ern_status status = ERN_OK;
  ern_image image = {0};
  bool grey = true, coloured = true;
  ERN_TRY(ern_prepare_check_count(masks->job, masks->job->options->masks, ".png"));
  for (size_t i = 0; i < masks->job->frames && grey == coloured; i++) {
    ERN_TRY(read_file(masks->job, i, &image, &grey, &coloured));
    ern_image_free(masks->job->context, &image);
    masks->told_by = i;
  }
  masks->coloured = !grey;
fail:
  ern_image_free(masks->job->context, &image);
  return status;
}

ern_status ern_supplied_masks_open(struct ern_prepare_job *job, struct ern_supplied_masks **masks) {
  ern_status status = ERN_OK;
  const char *path = job->options->masks;
  const size_t length = strlen(path);
  ERN_TRY(ERN_NEW(job->context, 1, masks));
  (*masks)->job = job;
  if (length > 5 && strcmp(path + length - 5, ".onnx") == 0)
    ERN_TRY(ern_person_network_open(job->context, path, &(*masks)->network));
  else
    ERN_TRY(detect_form(*masks));
fail:
  return status;
}

void ern_supplied_masks_free(struct ern_supplied_masks *masks) {
  if (masks == NULL) return;
  ern_person_network_free(masks->network);
  ern_release(masks->job->context, masks);
}

static ern_status read_mask(const struct ern_supplied_masks *masks, size_t frame, uint8_t *mask, uint8_t *parts,
                            bool *has_parts) {
  static const char *const forms[] = {"grey", "in colours"};
  ern_status status = ERN_OK;
  const struct ern_prepare_job *job = masks->job;
  ern_image image = {0};
  const size_t pixels = (size_t)job->side * (size_t)job->side;
  bool grey = true, coloured = true;
  ERN_TRY(read_file(job, frame, &image, &grey, &coloured));
  if (masks->coloured ? !coloured : !grey)
    ERN_TRY(ern_fail(job->context, ERN_E_FORMAT, "%s/%zu.png: is %s, and %zu.png is %s; expected all files alike",
                     job->options->masks, frame, forms[coloured], masks->told_by, forms[masks->coloured]));
  for (size_t k = 0; k < pixels; k++) {
    const int part = masks->coloured ? part_of(image.data + 3 * k) : 0;
    parts[k] = (uint8_t)part;
    mask[k] = (masks->coloured ? part > 0 : image.data[3 * k] > 0) ? 255 : 0;
  }
  *has_parts = masks->coloured;
fail:
  ern_image_free(job->context, &image);
  return status;
}

ern_status ern_supplied_mask(struct ern_supplied_masks *masks, size_t frame, const uint8_t *rgb,
                             const struct ern_layer_face *face, uint8_t *mask, uint8_t *parts, bool *has_parts) {
  *has_parts = false;
  if (masks->network == NULL) return read_mask(masks, frame, mask, parts, has_parts);
  return ern_person_network_run(masks->network, rgb, face, masks->job->side, mask);
}

ern_status ern_supplied_masks_check(struct ern_prepare_job *job) {
  ern_status status = ERN_OK;
  const size_t pixels = (size_t)job->side * (size_t)job->side;
  struct ern_supplied_masks *masks = NULL;
  uint8_t *mask = NULL, *parts = NULL;
  bool has_parts = false;
  ERN_TRY(ern_supplied_masks_open(job, &masks));
  ERN_TRY(ERN_NEW(job->context, pixels, &mask));
  ERN_TRY(ERN_NEW(job->context, pixels, &parts));
  for (size_t i = 0; i < job->frames && masks->network == NULL; i++) {
    ERN_TRY(read_mask(masks, i, mask, parts, &has_parts));
    ERN_TRY(ern_prepare_progress(job, i, job->frames));
  }
fail:
  ern_supplied_masks_free(masks);
  ern_release(job->context, mask);
  ern_release(job->context, parts);
  return status;
}
