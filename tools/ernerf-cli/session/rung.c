/* SPDX-License-Identifier: MIT */
#include "session/rung.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int backend_of(struct rate_control *g, const struct settings *s, ern_backend **backend) {
  const ern_backend_info *own = &g->session->backend_info; /* the session's backend, which the session frees */
  if (strcmp(own->name, s->backend) == 0 &&
      (s->isa[0] == 0 ? g->session->device == s->device : strcmp(own->isa, s->isa) == 0)) {
    *backend = g->session->backend;
    return 0;
  }
  for (size_t i = 0; i < g->units; i++)
    if (strcmp(g->unit[i].backend, s->backend) == 0 && strcmp(g->unit[i].isa, s->isa) == 0 &&
        g->unit[i].device == s->device) {
      *backend = g->unit[i].made;
      return 0;
    }
  if (g->units == RATE_CONTROL_UNITS)
    return session_fail_with(
        g->session, "the measured settings use more different backends and instruction sets than can be open at once");
  ern_backend_config config = ern_backend_config_default();
  config.name = s->backend;
  config.isa = s->isa[0] != 0 ? s->isa : NULL;
  config.device = s->device;
  config.deterministic = g->session->deterministic;
  if (ern_backend_create(backend, g->session->context, &config) != ERN_OK) return session_fail(g->session);
  snprintf(g->unit[g->units].backend, sizeof g->unit[0].backend, "%s", s->backend);
  snprintf(g->unit[g->units].isa, sizeof g->unit[0].isa, "%s", s->isa);
  g->unit[g->units].device = s->device;
  g->unit[g->units++].made = *backend;
  return 0;
}

int rung_make(struct rate_control *g, struct rung *rung) {
  ern_render_options options = g->portrait->render;
  ern_backend *backend = NULL;
  if (rung->renderer != NULL) return 0;
  settings_apply(&rung->settings, &options);
  if (backend_of(g, &rung->settings, &backend) != 0) return EXIT_FAILURE;
  if (ern_renderer_create(&rung->renderer, backend, g->portrait->model, &options) != ERN_OK)
    return session_fail(g->session);
  struct portrait thinned = *g->portrait;
  thinned.renderer = rung->renderer;
  thinned.occupancy_threshold = rung->settings.occupancy_threshold;
  return portrait_prune_occupancy(&thinned, g->session, g->frame_source, g->features);
}
