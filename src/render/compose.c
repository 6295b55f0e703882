/* SPDX-License-Identifier: MIT
 * The layers of a frame: the layers behind the head, and the head. */
#include <math.h>
#include <string.h>

#include "model/torso_ops.h"
#include "render/picture_ops.h"
#include "render/ray_reuse.h"
#include "render/upsample_ops.h"

/* The background rows: the caller's background, the caller's torso image over it; premultiplied. */
static ern_status upload_background(ern_renderer *r, const ern_frame_input *input, struct frame *f) {
  struct ern_background_args args = {.pixel = f->background, .opacity = f->torso_opacity.span, .n = f->pixels};
  ern_status status = ERN_OK;
  if (input->background != NULL) {
    ERN_TRY(ern_renderer_buffer(r, BACKGROUND_BYTES, ERN_ELEMENT_BYTE, 3 * f->pixels, &args.background));
    ERN_TRY(r->backend->upload_bytes(r->stream, args.background, input->background, 3 * f->pixels));
  }
  if (input->torso != NULL) {
    ERN_TRY(ern_renderer_buffer(r, TORSO_BYTES, ERN_ELEMENT_BYTE, 4 * f->pixels, &args.torso));
    ERN_TRY(r->backend->upload_bytes(r->stream, args.torso, input->torso, 4 * f->pixels));
  }
  ERN_TRY(r->backend->background(r->stream, &args));
fail:
  return status;
}

/* The model's own torso over the background rows, in place. */
static ern_status torso_layer(ern_renderer *r, const ern_frame_input *input, struct frame *f) {
  const ern_box *frame = &input->camera.frame;
  float motion[ERN_MOTION_VALUES];
  struct ern_render_torso_args args = {
      .pixel = f->background,
      .opacity = f->torso_opacity.span,
      .grid = ern_whole(r->torso_grid, ERN_TORSO_CELLS),
      .threshold = r->torso_threshold,
      .width = input->camera.width,
      .height = input->camera.height,
      .frame = {frame->top, frame->left, frame->right - frame->left, frame->bottom - frame->top},
      .shrink = r->options.torso_shrink,
      .individual = r->individual,
      .motion = motion,
      .parameters = ern_whole(r->parameters, r->field.parameters),
      .field = &r->field};
  memcpy(args.pose, input->camera.pose, sizeof args.pose);
  ern_renderer_torso_motion(r, input, motion);
  return r->backend->render_torso(r->stream, &args);
}

ern_status ern_renderer_background_layers(ern_renderer *r, const ern_frame_input *input) {
  ern_status status = ERN_OK;
  if (r->reuse.on) {
    ERN_TRY(ern_ray_reuse_check_background(r, input));
    if (!r->reuse.behind_changed) return ERN_OK;
  }
  ERN_TRY(upload_background(r, input, &r->frame));
  if (r->field.config.torso) ERN_TRY(torso_layer(r, input, &r->frame));
  r->reuse.behind.known = r->reuse.on;
fail:
  return status;
}

static struct ern_view view_of(const ern_frame_input *input) {
  const ern_camera *camera = &input->camera;
  struct ern_view view = {
      .focal = camera->focal, .cx = camera->cx, .cy = camera->cy, .width = camera->width, .height = camera->height};
  memcpy(view.pose, input->head_pose != NULL ? input->head_pose : camera->pose, sizeof view.pose);
  return view;
}

/* Pixels [low, high] of `count` along an axis whose rays go through the frame [begin, end), with the picture rendered
 * at `ratio` times its size. A frame outside the picture sets no bound. */
static void bound_rays(int *low, int *high, int begin, int end, float ratio, int count) {
  const int first = (int)ceilf((float)begin * ratio - 0.5f), last = (int)ceilf((float)end * ratio - 0.5f) - 1;
  *low = first > 0 ? first : 0;
  *high = last < first ? first : last;
  if (*high > count - 1) *high = count - 1;
  if (*low > *high) *low = 0, *high = count - 1;
}

/* *number = numbers of the pixels that rays go through; outside the frame, those of its nearest pixel. The training saw
 * nothing outside the frame, so the head is undefined there. Does not change *number where the frame is the picture. */
static ern_status number_rays(ern_renderer *r, const ern_box *frame, const struct ern_view *view, float ratio,
                              ern_span *number) {
  const size_t pixels = (size_t)view->width * (size_t)view->height;
  int left, right, top, bottom;
  int32_t *pixel = NULL;
  ern_status status = ERN_OK;
  if (frame->right == frame->left) return ERN_OK;
  bound_rays(&left, &right, frame->left, frame->right, ratio, view->width);
  bound_rays(&top, &bottom, frame->top, frame->bottom, ratio, view->height);
  if (left == 0 && right == view->width - 1 && top == 0 && bottom == view->height - 1) return ERN_OK;
  ERN_TRY(ERN_NEW(r->context, pixels, &pixel));
  int32_t *to = pixel;
  for (int y = 0; y < view->height; y++) {
    const int row = y < top ? top : y > bottom ? bottom : y;
    for (int x = 0; x < view->width; x++) *to++ = row * view->width + (x < left ? left : x > right ? right : x);
  }
  ERN_TRY(ern_scratch_take(r->stream, ERN_ELEMENT_INT32, pixels, number));
  status = r->backend->upload_int32(r->stream, *number, pixel, pixels);
fail:
  ern_release(r->context, pixel);
  return status;
}

/* The head over the background rows of `to`, as a picture of the view's size. over: the rows are the frame's. */
static ern_status draw_head(ern_renderer *r, const ern_frame_input *input, const struct ern_view *view,
                            const struct frame *to, bool over) {
  struct ern_render_rays_args args = {
      .pixel = to->pixel,
      .opacity = to->opacity.span,
      .depth = to->depth.span,
      .attention = to->attention.span,
      .eye = to->eye.span,
      .pixel_number = to->number,
      .view = *view,
      .background = to->background,
      .bits = ern_whole(r->bits, ERN_OCCUPANCY_BYTES),
      .parameters = ern_whole(r->parameters, r->field.parameters),
      .field = &r->field,
      .code = ern_whole(r->code, ERN_AUDIO_CODE),
      .eye_value = input->eye,
      .individual = r->individual,
      .settings = {r->field.config.bound, r->options.max_steps, r->options.dt_gamma, ERN_NEAR_PLANE},
      .transmittance_stop = r->options.transmittance_stop,
      .profile = &r->profile,
      .n = to->pixels};
  const struct ern_arena_mark mark = ern_arena_mark(r->stream);
  ern_status status = ERN_OK;
  ERN_TRY(number_rays(r, &input->camera.frame, view, over ? 1 : r->options.image_scale, &args.pixel_number));
  if (input->wanted != NULL && over && !r->reuse.on) { /* a reused frame is a whole one */
    ERN_TRY(ern_renderer_buffer(r, WANTED, ERN_ELEMENT_BYTE, to->pixels, &args.wanted));
    ERN_TRY(r->backend->upload_bytes(r->stream, args.wanted, input->wanted, to->pixels));
  }
  if (r->reuse.on && over) {
    args.colour = (ern_rows){.stride = to->pixel.stride, .rows = 3, .per = ERN_PER_SAMPLE};
    ERN_TRY(ern_renderer_buffer(r, COLOUR, ERN_ELEMENT_REAL, 3 * to->pixel.stride, &args.colour.span));
  }
  status = r->reuse.on ? ern_ray_reuse_head(r, &args, over) : r->backend->render_rays(r->stream, &args);
fail:
  ern_arena_release(r->stream, mark);
  return status;
}

/* The same view with fewer pixels, enough to cover the picture; the last ones may extend beyond it. */
static struct ern_view small_view_of(const struct ern_view *view, float ratio) {
  struct ern_view small = *view;
  small.focal *= ratio;
  small.cx *= ratio;
  small.cy *= ratio;
  small.width = (int)ceilf((float)view->width * ratio);
  small.height = (int)ceilf((float)view->height * ratio);
  return small;
}

/* Memory of the layer that is rendered at low resolution, without a background: its background rows stay zero. */
static ern_status small_frame(ern_renderer *r, const struct frame *f, size_t pixels, struct frame *small) {
  enum { LAYER = 4, BACKGROUND = 3, EXTRAS = 3 };
  const size_t stride = f->opacity.stride; /* that of the full-size frame, whose pixel numbers are shared too */
  const struct {
    ern_rows *rows;
    const ern_rows *wanted;
  } extras[EXTRAS] = {{&small->depth, &f->depth}, {&small->attention, &f->attention}, {&small->eye, &f->eye}};
  ern_span planes;
  const ern_status status =
      ern_renderer_buffer(r, SMALL, ERN_ELEMENT_REAL, (LAYER + BACKGROUND + EXTRAS) * stride, &planes);
  const ern_rows all = {planes, stride, LAYER + BACKGROUND + EXTRAS, ERN_PER_SAMPLE};
  *small = (struct frame){.pixels = pixels,
                          .number = ern_span_part(f->number, 0, pixels),
                          .layer = ern_rows_part(all, 0, LAYER),
                          .pixel = ern_rows_part(all, 0, 3),
                          .opacity = ern_rows_part(all, 3, 1),
                          .background = ern_rows_part(all, LAYER, BACKGROUND)};
  for (int i = 0; i < EXTRAS; i++)
    if (extras[i].wanted->span.buffer != NULL) *extras[i].rows = ern_rows_part(all, LAYER + BACKGROUND + i, 1);
  return status;
}

static ern_status upsample_head(ern_renderer *r, const struct ern_view *view, const struct ern_view *small_view,
                                const struct frame *f, const struct frame *small) {
  const struct {
    ern_rows large, small, background;
  } planes[] = {{f->layer, small->layer, f->background},
                {f->depth, small->depth, {{0}, 0, 0, ERN_PER_SAMPLE}},
                {f->attention, small->attention, {{0}, 0, 0, ERN_PER_SAMPLE}},
                {f->eye, small->eye, {{0}, 0, 0, ERN_PER_SAMPLE}}};
  ern_status status = ERN_OK;
  for (size_t i = 0; i < sizeof planes / sizeof *planes; i++) {
    if (planes[i].large.span.buffer == NULL) continue;
    struct ern_upsample_args args = {.large = planes[i].large,
                                     .small = planes[i].small,
                                     .background = planes[i].background,
                                     .width = view->width,
                                     .height = view->height,
                                     .small_width = small_view->width,
                                     .small_height = small_view->height,
                                     .ratio = r->options.image_scale};
    ERN_TRY(r->backend->upsample(r->stream, &args));
  }
fail:
  return status;
}

ern_status ern_renderer_head(ern_renderer *r, const ern_frame_input *input) {
  struct frame *f = &r->frame;
  const struct ern_view view = view_of(input);
  struct frame small;
  ern_status status = ERN_OK;
  if (r->options.image_scale >= 1) return draw_head(r, input, &view, f, true);
  const struct ern_view small_view = small_view_of(&view, r->options.image_scale);
  ERN_TRY(small_frame(r, f, (size_t)small_view.width * (size_t)small_view.height, &small));
  ERN_TRY(draw_head(r, input, &small_view, &small, false));
  ERN_TRY(upsample_head(r, &view, &small_view, f, &small));
fail:
  return status;
}
