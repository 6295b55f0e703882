/* SPDX-License-Identifier: MIT
 * libernerf-vision: neural networks and optical flow by OpenCV. libernerf-media loads it on first use, so that other
 * programs do not load these OpenCV modules. It does not depend on libernerf: it reports an error as a status and a
 * text. */
#ifndef ERN_VISION_VISION_H
#define ERN_VISION_VISION_H

#include "ernerf/base.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { ERN_VISION_DIMS = 8, ERN_VISION_WORDS = 512 };

/* Numbers in C order. */
struct ern_vision_array {
  const float *data; /* [shape[0]]...[shape[dims - 1]] */
  int dims, shape[ERN_VISION_DIMS];
};

/* One thread at a time uses a network. */
struct ern_vision_network;

/* The functions of the library. A function that fails writes an error text to `words`, without the file's name. */
struct ern_vision {
  const char *version; /* ERN_INTERFACE_VERSION */
  const char *opencv;  /* "4.6.0" */
  /* Makes a network from the bytes of an ONNX file; the caller may free the bytes afterwards. The caller must have
   * validated the sizes in the file (io/onnx.h): OpenCV's importer does not. ERN_E_UNSUPPORTED: the importer refuses
   * the file. */
  ern_status (*open)(const void *bytes, size_t count, struct ern_vision_network **network,
                     char words[ERN_VISION_WORDS]);
  /* Computes the output named `output` from one input. *out is owned by the network and valid until its next call. */
  ern_status (*run)(struct ern_vision_network *network, const struct ern_vision_array *in, const char *output,
                    struct ern_vision_array *out, char words[ERN_VISION_WORDS]);
  void (*free)(struct ern_vision_network *network); /* accepts NULL */
  /* Dense optical flow (DIS, Kroeger et al. 2016) between grey pictures [height][width]: *flow [height][width][2],
   * pixels right and down. */
  ern_status (*flow)(const unsigned char *from, const unsigned char *to, int width, int height, float *flow,
                     char words[ERN_VISION_WORDS]);
};

/* The only exported symbol. */
extern ERN_API const struct ern_vision ern_vision;

#ifdef __cplusplus
}
#endif
#endif
