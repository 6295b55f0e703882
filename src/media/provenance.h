/* SPDX-License-Identifier: MIT
 * Provenance metadata: the texts that state how a file was made, and their place in PNG, JPEG, MP4 and GIF files. */
#ifndef ERN_MEDIA_PROVENANCE_H
#define ERN_MEDIA_PROVENANCE_H

#include "core/status.h"
#include "ernerf/media.h"

/* All NULL where a file gets no provenance. The owner calls ern_provenance_texts_free. */
struct ern_provenance_texts {
  const char *source_type; /* IPTC's URI */
  char *aigc;              /* the label of GB 45438-2025, a JSON object */
  char *description;       /* "": none */
  char *xmp;               /* the XMP packet, with all of it and the consent */
};

/* provenance NULL: *texts is zeroed. ERN_E_ARGUMENT: an id, a consent or a description that media.h does not allow. */
ERN_NODISCARD ern_status ern_provenance_texts_make(ern_context *context, const ern_provenance *provenance,
                                                   struct ern_provenance_texts *texts);
void ern_provenance_texts_free(ern_context *context, struct ern_provenance_texts *texts); /* accepts a zeroed one */

/* *with = the bytes of a whole PNG or JPEG with the packet after the header, *grown bytes; the caller owns it
 * (ern_release). Packets of JPEG have at most 65,502 bytes, which ERN_CONSENT_BYTES keeps them below. */
ERN_NODISCARD ern_status ern_provenance_insert(ern_context *context, const char *xmp, const uint8_t *bytes,
                                               size_t count, uint8_t **with, size_t *grown);

/* The packet as a box of ISO 14496-12 with XMP's UUID, to append to a file; the caller owns it (ern_release). */
ERN_NODISCARD ern_status ern_provenance_box(ern_context *context, const char *xmp, uint8_t **box, size_t *count);

/* The packet as an extension of GIF89a and the trailer behind it, to replace the trailer of a file; the caller owns it
 * (ern_release). */
ERN_NODISCARD ern_status ern_provenance_extension(ern_context *context, const char *xmp, uint8_t **extension,
                                                  size_t *count);

#endif
