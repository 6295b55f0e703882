/* SPDX-License-Identifier: MIT
 * Provenance of outputs: a record in each output of how it was made, and a more detailed file beside it
 * (docs/provenance.md). */
#ifndef ERN_CLI_PROVENANCE_OUTPUT_H
#define ERN_CLI_PROVENANCE_OUTPUT_H

#include "session/portrait.h"

enum { PROVENANCE_OPTIONS = 1 };

struct provenance {
  bool off; /* --no-provenance */
  ern_provenance says;
  bool numbered; /* the output is pictures with a number in their names, out/%05d.png; else one file */
  const char *output;
  char path[4096];                /* of the file beside the output; "": none */
  bool replaces;                  /* overwrites an earlier such file, whose output was deleted */
  char id[128], description[128]; /* what of it is synthetic; "": all, or as the source type says */
  json_t *about;                  /* content of that file */
};

/* --no-provenance. */
void provenance_options(struct provenance *provenance, struct option options[PROVENANCE_OPTIONS]);

/* Names the file beside `output` (one file, or numbered pictures). Fails as session_check_output if a file exists there
 * that is not such a file of this program. */
int provenance_check(struct provenance *provenance, struct session *session, const char *output);

/* Hashes the model and the speech that drives it (`speech`: a file of sound or features, NULL: none), and warns if the
 * model records no consent. all_trained: as in ern_provenance. Returns 0, or EXIT_FAILURE after a message. */
int provenance_learn(struct provenance *provenance, struct session *session, const struct portrait *portrait,
                     const char *speech, bool all_trained);

/* The record for the output; NULL: none. */
const ern_provenance *provenance_of(const struct provenance *provenance);

/* Writes the file beside the output, including the members of `more`, whose reference is taken. */
int provenance_write(struct provenance *provenance, struct session *session, json_t *more);

/* Reads the file beside an output; *about NULL: there is none by this program that says the output's hash. Fails where
 * it says another hash: it is about an earlier output of that name. The caller owns *about, also then. */
int provenance_read(struct session *session, const char *output, json_t **about);
/* Used instead of provenance_learn for an output that is joined from `segments`. says: an array with the result of
 * provenance_read for each, null: none. sound: a file, NULL: none. */
int provenance_join(struct provenance *provenance, struct session *session, char *const *segments, const json_t *says,
                    const char *sound);
void provenance_free(struct provenance *provenance);

#endif
