/* SPDX-License-Identifier: MIT
 * Responses, with the fields that all of them have. */
#include <string.h>

#include "serve/serve_shared.h"

enum { BLOCK = 32768 };

/* Other origins' pages may not use it, unless --allow-origin names them; nobody guesses its type. */
static enum MHD_Result finish(struct request *r, unsigned status, const char *type, struct MHD_Response *response) {
  if (response == NULL) return MHD_NO;
  const char *origin = guard_origin(r->server, r->connection);
  (void)MHD_add_response_header(response, "Content-Type", type);
  (void)MHD_add_response_header(response, "Cache-Control", "no-store");
  (void)MHD_add_response_header(response, "X-Content-Type-Options", "nosniff");
  (void)MHD_add_response_header(response, "Referrer-Policy", "no-referrer");
  (void)MHD_add_response_header(response, "Cross-Origin-Resource-Policy",
                                origin != NULL ? "cross-origin" : "same-origin");
  if (r->server->options.origin != NULL) (void)MHD_add_response_header(response, "Vary", "Origin");
  if (origin != NULL) (void)MHD_add_response_header(response, "Access-Control-Allow-Origin", origin);
  if (status == MHD_HTTP_UNAUTHORIZED) (void)MHD_add_response_header(response, "WWW-Authenticate", "Bearer");
  if (status == MHD_HTTP_TOO_MANY_REQUESTS) (void)MHD_add_response_header(response, "Retry-After", "1");
  const enum MHD_Result done = MHD_queue_response(r->connection, status, response);
  MHD_destroy_response(response);
  return done;
}

enum MHD_Result answer_json(struct request *r, unsigned status, json_t *object) {
  char *text = object != NULL ? json_dumps(object, JSON_COMPACT) : NULL;
  json_decref(object);
  if (text == NULL) return MHD_NO;
  return finish(r, status, "application/json",
                MHD_create_response_from_buffer(strlen(text), text, MHD_RESPMEM_MUST_FREE));
}

enum MHD_Result answer_error(struct request *r, unsigned status, const char *reason) {
  json_t *text = json_string(reason);
  if (status >= 400) {
    serve_lock(r->server);
    r->server->refused++;
    serve_unlock(r->server);
  }
  return answer_json(r, status,
                     json_pack("{s:o}", "error", text != NULL ? text : json_string("no reason that is UTF-8")));
}

enum MHD_Result answer_created(struct request *r, const char *location, const char *sdp) {
  struct MHD_Response *response =
      MHD_create_response_from_buffer(strlen(sdp), (void *)(uintptr_t)sdp, MHD_RESPMEM_MUST_COPY);
  if (response != NULL) {
    (void)MHD_add_response_header(response, "Location", location);
    (void)MHD_add_response_header(response, "Access-Control-Expose-Headers", "Location");
  }
  return finish(r, MHD_HTTP_CREATED, "application/sdp", response);
}

enum MHD_Result answer_constant(struct request *r, const char *type, const void *bytes, size_t count) {
  struct MHD_Response *response =
      MHD_create_response_from_buffer(count, (void *)(uintptr_t)bytes, MHD_RESPMEM_PERSISTENT);
  const char *origin = r->server->options.origin;
  char policy[512];
  if (response != NULL) {
    snprintf(policy, sizeof policy,
             "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; media-src "
             "'self' blob:; frame-ancestors 'self' %s",
             origin != NULL ? origin : "");
    (void)MHD_add_response_header(response, "Content-Security-Policy", policy);
  }
  return finish(r, MHD_HTTP_OK, type, response);
}

enum MHD_Result answer_text(struct request *r, const char *type, char *text, size_t count) {
  if (text == NULL) return MHD_NO;
  return finish(r, MHD_HTTP_OK, type, MHD_create_response_from_buffer(count, text, MHD_RESPMEM_MUST_FREE));
}

enum MHD_Result answer_stream(struct request *r, const char *type, MHD_ContentReaderCallback read) {
  return finish(r, MHD_HTTP_OK, type, MHD_create_response_from_callback(MHD_SIZE_UNKNOWN, BLOCK, read, r, NULL));
}

enum MHD_Result answer_methods(struct request *r, const char *methods) {
  struct MHD_Response *response = MHD_create_response_from_buffer(0, NULL, MHD_RESPMEM_PERSISTENT);
  if (response != NULL) {
    (void)MHD_add_response_header(response, "Allow", methods);
    (void)MHD_add_response_header(response, "Access-Control-Allow-Methods", methods);
    (void)MHD_add_response_header(response, "Access-Control-Allow-Headers", "Authorization, Content-Type");
  }
  return finish(r, MHD_HTTP_OK, "text/plain", response);
}
