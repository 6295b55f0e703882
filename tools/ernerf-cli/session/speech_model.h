/* SPDX-License-Identifier: MIT
 * The external speech network that computes speech features from a verb's sound, in place of the built-in kind of
 * features. */
#ifndef ERN_CLI_SPEECH_MODEL_H
#define ERN_CLI_SPEECH_MODEL_H

#include "args.h"
#include "ernerf/media.h"
#include "ernerf/model.h"
#include "ernerf/speech.h"
#include "session/progress.h"
#include "session/session.h"

struct speech_model {
  const char *path;            /* of the network; NULL: none */
  const char *needs;           /* name of a preset, or file of a description; NULL: by the model */
  ern_speech_network *network; /* NULL: none, or not open */
  struct progress progress;
  char beside[4096]; /* room for the result of speech_model_file */
};

enum { SPEECH_MODEL_OPTIONS = 2 };
/* --speech-model --speech-preset. */
void speech_model_options(struct speech_model *speech_model, struct option options[SPEECH_MODEL_OPTIONS]);

/* Refuses options that contradict each other. audio: the value of --audio, NULL: none. Returns -1 to continue, else the
 * exit status. */
int speech_model_check(const struct speech_model *speech_model, const struct args *args, const char *audio);

/* The description file that is read: that of --speech-preset, else FILE.json beside FILE.onnx; NULL: none. */
const char *speech_model_file(struct speech_model *speech_model);

/* The kind of features in a file, by its usual name in a clip (such as aud_ds.npy) and their width; "": unknown. */
const char *speech_model_kind(const char *path, int width);
/* The kind of a clip's features: that computed from its sound, else by file name as above. */
const char *speech_model_clip_kind(const ern_clip *clip);
/* Whether the model takes features of this kind. True also if either kind is unknown. */
bool speech_model_fits(const ern_model_info *model, const char *kind);
/* Fails if speech_model_fits is false; name: of the features' file. Returns 0, or EXIT_FAILURE after a message. */
int speech_model_check_features(struct session *session, const char *model_path, const ern_model_info *model,
                                const char *name, const char *kind);

/* Opens the network if one was requested and is not open yet. model: the model to be driven; the network must compute
 * its kind of features and be the one it was trained with. NULL: no model yet. Returns 0, or EXIT_FAILURE after a
 * message. */
int speech_model_open(struct speech_model *speech_model, struct session *session, const char *model_path,
                      const ern_model_info *model);
void speech_model_close(struct speech_model *speech_model);

/* Reports the failure of a call that computed speech features: session_stop_with if Ctrl-C ended it, else session_fail.
 */
int speech_model_fail(struct session *session, ern_status status);

/* Describes the network that a model needs as --speech-model: ": the network "NAME" with the SHA-256 1234...", or "".
 */
void speech_model_wanted(const ern_model_info *model, char words[192]);

#endif
