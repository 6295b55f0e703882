/* SPDX-License-Identifier: MIT */
#include "output/label.h"

#include <cairo.h>
#include <fontconfig/fontconfig.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

static const double share = 0.05 /* of the shorter side */, least = 5 /* pixels, to be read */,
                    ground = 0.6 /* its opacity */;

void label_options(struct label *label, struct option options[LABEL_OPTIONS]) {
  const struct option rows[] = {{ARGS_TEXT("label", &label->text), .choices = "TEXT",
                                 .help = "text drawn on the frames that says what they are, such as \"made by AI\"; "
                                         "its capitals are 5 % of the shorter side high, 5 pixels at least"},
                                {ARGS_SECONDS("label-time", &label->seconds, 0.04, 1e6), .seldom = true,
                                 .help = "for how long from the first frame on, such as 2s (default: in all frames)"}};
  ARGS_FILL(options, rows, LABEL_OPTIONS);
}

int label_check(const struct label *label, const struct args *args) {
  return label->text == NULL ? args_forbid(args, "label-time", "is about --label") : -1;
}

/* The family that has most letters of the text, and of those the most usual one: cairo draws a text with one font.
 * NULL: no font, or no memory. The caller frees it. */
static char *family_of(const char *text) {
  FcPattern *wanted = FcPatternCreate(), *match = NULL;
  FcCharSet *letters = FcCharSetCreate();
  FcResult result = FcResultNoMatch;
  FcChar8 *name = NULL;
  FcChar32 letter = 0;
  char *family = NULL;
  if (wanted == NULL || letters == NULL) goto fail;
  for (int left = (int)strlen(text), bytes; left > 0; left -= bytes, text += bytes) {
    bytes = FcUtf8ToUcs4((const FcChar8 *)text, &letter, left);
    if (bytes <= 0 || !FcCharSetAddChar(letters, letter)) goto fail;
  }
  if (!FcPatternAddCharSet(wanted, FC_CHARSET, letters) ||
      !FcPatternAddString(wanted, FC_FAMILY, (const FcChar8 *)"sans-serif") ||
      !FcPatternAddInteger(wanted, FC_WEIGHT, FC_WEIGHT_BOLD) || !FcConfigSubstitute(NULL, wanted, FcMatchPattern))
    goto fail;
  FcDefaultSubstitute(wanted);
  match = FcFontMatch(NULL, wanted, &result);
  if (match != NULL && FcPatternGetString(match, FC_FAMILY, 0, &name) == FcResultMatch)
    family = strdup((const char *)name);
fail:
  if (match != NULL) FcPatternDestroy(match);
  if (letters != NULL) FcCharSetDestroy(letters);
  if (wanted != NULL) FcPatternDestroy(wanted);
  return family;
}

/* Characters that cairo's text functions do not lay out: controls, scripts from right to left, and scripts that join or
 * reorder their letters. */
static const struct {
  FcChar32 first, last;
} unsupported[] = {{0x0, 0x1f},       {0x7f, 0x9f},     {0x590, 0xdff} /* Hebrew, Arabic, Indic */,
                   {0xf00, 0x109f},   {0x1780, 0x18af}, {0x1a20, 0x1aaf},
                   {0x1b00, 0x1c7f},  {0x200b, 0x200f}, {0x2028, 0x202e},
                   {0x2060, 0x206f},  {0xa800, 0xa82f}, {0xa840, 0xa8ff},
                   {0xa980, 0xa9df},  {0xaa00, 0xaaff}, {0xabc0, 0xabff},
                   {0xfb1d, 0xfdff},  {0xfe70, 0xfeff}, {0x10800, 0x11fff},
                   {0x1e800, 0x1efff}};

/* Whether the letters stand side by side in the order of the text; else a message names the first that does not. */
static bool is_plain(struct session *session, const char *text) {
  FcChar32 code = 0;
  for (int left = (int)strlen(text), bytes; left > 0; left -= bytes, text += bytes) {
    bytes = FcUtf8ToUcs4((const FcChar8 *)text, &code, left);
    if (bytes <= 0) return true; /* no UTF-8: family_of refuses it */
    for (size_t i = 0; i < sizeof unsupported / sizeof *unsupported; i++) {
      if (code < unsupported[i].first || code > unsupported[i].last) continue;
      session_fail_with(session,
                        "--label: has U+%04X, expected one line of letters that stand side by side from left to right: "
                        "controls, and scripts such as Hebrew, Arabic and Devanagari, cannot be drawn",
                        (unsigned)code);
      return false;
    }
  }
  return true;
}

/* Creates a context to draw or measure text; for measuring, a surface of one pixel is enough. */
static cairo_t *pen(cairo_surface_t *surface, const char *family, double size) {
  cairo_t *cairo = cairo_create(surface);
  cairo_select_font_face(cairo, family, CAIRO_FONT_SLANT_NORMAL, CAIRO_FONT_WEIGHT_BOLD);
  cairo_set_font_size(cairo, size);
  return cairo;
}

/* The first letter of the text that the font lacks, and its bytes; NULL: it has all. A font's glyph 0 is a box. */
static const char *lacking(cairo_t *cairo, const char *text, int *bytes) {
  cairo_glyph_t *glyphs = NULL;
  cairo_text_cluster_t *clusters = NULL;
  cairo_text_cluster_flags_t flags;
  int glyph_count = 0, cluster_count = 0, glyph = 0;
  const char *found = NULL;
  const cairo_status_t status = cairo_scaled_font_text_to_glyphs(cairo_get_scaled_font(cairo), 0, 0, text, -1, &glyphs,
                                                                 &glyph_count, &clusters, &cluster_count, &flags);
  for (int i = 0; status == CAIRO_STATUS_SUCCESS && found == NULL && i < cluster_count; i++) {
    for (int k = 0; k < clusters[i].num_glyphs; k++)
      if (glyphs[glyph++].index == 0) found = text;
    *bytes = clusters[i].num_bytes;
    text += *bytes;
  }
  cairo_glyph_free(glyphs);
  cairo_text_cluster_free(clusters);
  return found;
}

/* Whether the family has all letters of the text; else a message names the first that it lacks. */
static bool has_letters(struct session *session, const char *family, const char *text) {
  cairo_surface_t *surface = cairo_image_surface_create(CAIRO_FORMAT_ARGB32, 1, 1);
  cairo_t *cairo = pen(surface, family, 10);
  FcChar32 code = 0;
  int bytes = 0;
  const char *letter = lacking(cairo, text, &bytes);
  if (letter != NULL) {
    (void)FcUtf8ToUcs4((const FcChar8 *)letter, &code, bytes);
    session_fail_with(session,
                      "--label: no font here has all letters of \"%s\": %s lacks U+%04X (%.*s); Debian's fonts-unifont "
                      "has most letters, fonts-noto-core and fonts-noto-cjk are finer",
                      text, family, (unsigned)code, bytes, letter);
  }
  cairo_destroy(cairo);
  cairo_surface_destroy(surface);
  return letter == NULL;
}

/* The font size at which capitals are `height` pixels high, and the extents of the text at that size; 0: no font. */
static double measure(const char *family, const char *text, double height, cairo_text_extents_t *box) {
  enum { TRIED = 100 };
  cairo_surface_t *surface = cairo_image_surface_create(CAIRO_FORMAT_ARGB32, 1, 1);
  cairo_t *cairo = pen(surface, family, TRIED);
  cairo_text_extents(cairo, "H", box);
  const double size = box->height > 0 ? TRIED * height / box->height : 0;
  if (size > 0) cairo_set_font_size(cairo, size);
  cairo_text_extents(cairo, text, box);
  cairo_destroy(cairo);
  cairo_surface_destroy(surface);
  return box->height > 0 ? size : 0;
}

/* Cairo's pixels are words of ARGB. */
static void take_pixels(struct label *label, cairo_surface_t *surface) {
  const unsigned char *rows = cairo_image_surface_get_data(surface);
  const int stride = cairo_image_surface_get_stride(surface);
  for (int y = 0; y < label->height; y++) {
    for (int x = 0; x < label->width; x++) {
      uint32_t word;
      uint8_t *to = label->pixels + 4 * ((size_t)y * (size_t)label->width + (size_t)x);
      memcpy(&word, rows + (ptrdiff_t)y * stride + 4 * (ptrdiff_t)x, sizeof word);
      to[0] = (uint8_t)(word >> 16);
      to[1] = (uint8_t)(word >> 8);
      to[2] = (uint8_t)word;
      to[3] = (uint8_t)(word >> 24);
    }
  }
}

static int draw(struct label *label, struct session *session, const char *family, int width, int height) {
  cairo_text_extents_t box;
  const double capital = fmax(least, ceil(share * (width < height ? width : height))), margin = ceil(capital / 2);
  const double size = measure(family, label->text, capital, &box);
  if (!(size > 0)) return session_fail_with(session, "--label: no font here can draw \"%s\"", label->text);
  label->width = (int)ceil(box.width + 2 * margin);
  label->height = (int)ceil(box.height + 2 * margin);
  label->left = (int)margin;
  label->top = height - label->height - (int)margin;
  if (label->left + label->width > width || label->top < 0)
    return session_fail_with(session, "--label: \"%s\" needs %d x %d pixels, the frames have %d x %d", label->text,
                             label->left + label->width, label->height + (int)margin, width, height);
  label->pixels = malloc((size_t)label->width * (size_t)label->height * 4);
  cairo_surface_t *surface = cairo_image_surface_create(CAIRO_FORMAT_ARGB32, label->width, label->height);
  const bool made = label->pixels != NULL && cairo_surface_status(surface) == CAIRO_STATUS_SUCCESS;
  if (made) {
    cairo_t *cairo = pen(surface, family, size);
    cairo_set_source_rgba(cairo, 0, 0, 0, ground);
    cairo_paint(cairo);
    cairo_set_source_rgb(cairo, 1, 1, 1);
    cairo_move_to(cairo, margin - box.x_bearing, margin - box.y_bearing);
    cairo_show_text(cairo, label->text);
    cairo_destroy(cairo);
    cairo_surface_flush(surface);
    take_pixels(label, surface);
  }
  cairo_surface_destroy(surface);
  return made ? 0 : session_fail_with(session, "no memory for a label of %d x %d", label->width, label->height);
}

int label_make(struct label *label, struct session *session, int width, int height) {
  if (label->text == NULL) return 0;
  if (!is_plain(session, label->text)) return EXIT_FAILURE;
  char *family = family_of(label->text);
  int status = EXIT_FAILURE;
  if (family == NULL)
    status = session_fail_with(session, "--label: no font here can draw \"%s\"", label->text);
  else if (has_letters(session, family, label->text))
    status = draw(label, session, family, width, height);
  free(family);
  return status;
}

/* Porter and Duff's "over": alpha A = a + d (1 - a), colour (c a + e d (1 - a))/A. */
static void put_pixel(const uint8_t from[4], uint8_t to[4]) {
  const double left = 1 - from[3] / 255.0, there = to[3] / 255.0, alpha = from[3] / 255.0 + there * left;
  if (!(alpha > 0)) return;
  for (int c = 0; c < 3; c++) to[c] = (uint8_t)fmin(255, (from[c] + to[c] * there * left) / alpha + 0.5);
  to[3] = (uint8_t)(255 * alpha + 0.5);
}

void label_put(const struct label *label, double seconds, uint8_t *rgba, int width) {
  if (label->pixels == NULL || (label->seconds > 0 && seconds >= label->seconds)) return;
  for (int y = 0; y < label->height; y++) {
    uint8_t *row = rgba + 4 * ((size_t)(label->top + y) * (size_t)width + (size_t)label->left);
    const uint8_t *from = label->pixels + 4 * (size_t)y * (size_t)label->width;
    for (int x = 0; x < label->width; x++) put_pixel(from + 4 * x, row + 4 * x);
  }
}

void label_free(struct label *label) {
  free(label->pixels);
  label->pixels = NULL;
}
