/* SPDX-License-Identifier: MIT
 * What outputs say of how they were made, and the file beside them that says more (docs/provenance.md). */
#ifndef ERN_CLI_PROVENANCE_OUTPUT_H
#define ERN_CLI_PROVENANCE_OUTPUT_H

#include "session/portrait.h"

enum { PROVENANCE_OPTIONS = 1 };

struct provenance {
  bool off; /* --no-provenance */
  ern_provenance says;
  char path[4096]; /* of the file beside the output; "": none */
  bool replaces;   /* an earlier one is there, of an output that was deleted */
  char id[128];
  json_t *about; /* what that file holds */
};

/* --no-provenance. */
void provenance_options(struct provenance *provenance, struct option options[PROVENANCE_OPTIONS]);

/* The file beside `output`, NAME.mp4 or numbered pictures: fails where another file is there that this program did not
 * write so, as session_check_output. */
int provenance_check(struct provenance *provenance, struct session *session, const char *output);

/* Hashes the model and what it speaks from (`speech` a file of sound or features, NULL: neither), and warns where the
 * model says nothing of consent. all_trained: as in ern_provenance. Returns 0, or EXIT_FAILURE after a message. */
int provenance_learn(struct provenance *provenance, struct session *session, const struct portrait *portrait,
                     const char *speech, bool all_trained);

/* What the output is to say; NULL: nothing. */
const ern_provenance *provenance_of(const struct provenance *provenance);

/* Writes the file beside the output, with the members of `more` too, which is taken. */
int provenance_write(struct provenance *provenance, struct session *session, json_t *more);

/* What the file beside an output holds; NULL: there is none that this program wrote. The caller owns it. */
json_t *provenance_read(const char *output);
/* In the place of provenance_learn, of an output that is joined of `segments`. says: an array with what provenance_read
 * gave of each, null: nothing. sound: a file, NULL: none. */
int provenance_join(struct provenance *provenance, struct session *session, char *const *segments, const json_t *says,
                    const char *sound);
void provenance_free(struct provenance *provenance);

#endif
