/* SPDX-License-Identifier: MIT */
#include "media/vision_library.h"

#include <dlfcn.h>
#include <string.h>

#include "core/floats.h"
#include "ernerf/media.h"

#define TEXT_OF(x) #x
#define SONAME(major) "libernerf-vision.so." TEXT_OF(major)
static const char library_name[] = SONAME(ERN_VERSION_MAJOR);

ern_status ern_vision_load(ern_context *context, const char *what, void **library, const struct ern_vision **vision) {
  *library = dlopen(library_name, RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE);
  if (*library == NULL)
    return ern_fail(context, ERN_E_UNSUPPORTED,
                    "%s: is computed by %s, which cannot be loaded: %s; expected a libernerf that was built with "
                    "ERNERF_VISION (OpenCV's DNN module)",
                    what, library_name, dlerror());
  *vision = dlsym(*library, "ern_vision");
  if (*vision == NULL || strcmp((*vision)->version, ern_version()) != 0)
    return ern_fail(context, ERN_E_UNSUPPORTED, "%s: %s is of version %s, expected %s", what, library_name,
                    *vision != NULL ? (*vision)->version : "unknown", ern_version());
  return ERN_OK;
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
