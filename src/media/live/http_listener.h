/* SPDX-License-Identifier: MIT
 * An HTTP server for one viewer: waits for a request, checks it, and hands its connection on for a stream. */
#ifndef ERN_MEDIA_HTTP_LISTENER_H
#define ERN_MEDIA_HTTP_LISTENER_H

#include "media/live/descriptor_io.h"

/* Listens at url, "http://HOST:PORT/...", until a GET request is admitted and answered "200 OK". made->stop and
 * made->user are set by the caller; the struct must not move. A page of another site may not read the stream, so Host
 * must be an IP address, "localhost" or HOST, which no DNS server of that site can answer for (DNS rebinding), and
 * Origin must be absent or that Host. Others get an error, and a connection that sends no request keeps none waiting.
 * ERN_E_ARGUMENT: no such url. ERN_E_BUSY: cannot listen there. */
ERN_NODISCARD ern_status ern_http_serve(ern_context *context, const char *url, const char *content_type,
                                        struct ern_descriptor_io *made);

#endif
