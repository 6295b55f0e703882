/* SPDX-License-Identifier: MIT
 * Viewers by WebRTC, which begin by a request of WHEP (draft-ietf-wish-whep): an offer, to which the answer is whole.
 */
#ifndef ERN_SERVE_WHEP_H
#define ERN_SERVE_WHEP_H

#include "serve/serve_shared.h"

enum MHD_Result whep_begin(struct request *request); /* POST .../whep */
enum MHD_Result whep_end(struct request *request);
enum MHD_Result whep_delete(struct request *request); /* DELETE .../whep/KEY */

/* The request is over. The caller holds the lock. */
void whep_forget(struct request *request);
/* A part of the stream was written to stream->broadcast; sound that comes with the next one. On the thread that codes.
 */
void whep_picture(struct ern_http_stream *stream, ern_stream_piece piece);
void whep_sound(struct ern_http_stream *stream, const float *samples, size_t frames);
/* Ends those of a stream, whose thread that codes has ended. The caller holds the lock. */
void whep_remove(struct ern_http_stream *stream);
/* Ends all such viewers; the caller holds no lock. */
void whep_close(struct ern_http_server *server);

#endif
