/* SPDX-License-Identifier: MIT */
#include "media/vision_library.h"

#include <dlfcn.h>

#include "core/floats.h"
#include "ernerf/media.h"
#include "media/loaded_library.h"

#define TEXT_OF(x) #x
#define SONAME(major) "libernerf-vision.so." TEXT_OF(major)

ern_status ern_vision_load(ern_context *context, const char *what, void **library, const struct ern_vision **vision) {
  static const struct ern_loaded_library about = {SONAME(ERN_VERSION_MAJOR), "ern_vision",
                                                  "ERNERF_VISION (OpenCV's DNN module)", NULL};
  const void *table = NULL;
  const ern_status status = ern_library_load(context, what, &about, library, &table);
  *vision = table;
  return status;
}

ern_status ern_optical_flow(ern_context *context, const uint8_t *from, const uint8_t *to, int width, int height,
                            float *flow) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(context, context);
  ERN_NEED(context, from);
  ERN_NEED(context, to);
  ERN_NEED(context, flow);
  enum { LEAST = 16, MOST = 8192 };
  static const char what[] = "optical flow";
  void *library = NULL;
  const struct ern_vision *vision = NULL;
  char words[ERN_VISION_WORDS] = "";
  if (width < LEAST || height < LEAST || width > MOST || height > MOST)
    return ern_fail(context, ERN_E_ARGUMENT, "%s: the pictures are %d x %d, expected %d to %d a side", what, width,
                    height, LEAST, MOST);
  ern_status status = ern_vision_load(context, what, &library, &vision);
  if (status == ERN_OK) {
    status = vision->flow(from, to, width, height, flow, words);
    if (status != ERN_OK) status = ern_fail(context, status, "%s: OpenCV %s: %s", what, vision->opencv, words);
  }
  if (library != NULL) (void)dlclose(library);
  return status;
}
