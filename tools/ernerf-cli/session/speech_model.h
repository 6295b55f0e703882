/* SPDX-License-Identifier: MIT
 * Which network hears the sound that a verb is given, where it is not the built-in kind of features that is made of it.
 */
#ifndef ERN_CLI_SPEECH_MODEL_H
#define ERN_CLI_SPEECH_MODEL_H

#include "args.h"
#include "ernerf/media.h"
#include "ernerf/model.h"
#include "ernerf/speech.h"
#include "output/progress.h"
#include "session/session.h"

struct speech_model {
  const char *path;            /* of the network; NULL: none */
  const char *needs;           /* a preset's name, or the file of a description; NULL: as the model says */
  ern_speech_network *network; /* NULL: none, or not open */
  struct progress progress;
  char beside[4096]; /* of speech_model_file */
};

enum { SPEECH_MODEL_OPTIONS = 2 };
/* --speech-model --speech-preset. */
void speech_model_options(struct speech_model *speech_model, struct option options[SPEECH_MODEL_OPTIONS]);

/* What does not go together; audio: that of --audio, NULL: none. -1 to go on, else the exit status. */
int speech_model_check(const struct speech_model *speech_model, const struct args *args, const char *audio);

/* The description that is read: that of --speech-preset, else FILE.json beside FILE.onnx; NULL: none. */
const char *speech_model_file(struct speech_model *speech_model);

/* The kind of features that a file has by the name that clips give it, and their width; "": its name does not say. */
const char *speech_model_kind(const char *path, int width);
/* That of a clip's features: of its sound, or as above. */
const char *speech_model_clip_kind(const ern_clip *clip);
/* Whether the model speaks from features of the kind, or one of the two is not known. */
bool speech_model_fits(const ern_model_info *model, const char *kind);
/* Fails where it does not; name: of the features' file. Returns 0, or EXIT_FAILURE after a message. */
int speech_model_check_features(struct session *session, const char *model_path, const ern_model_info *model,
                                const char *name, const char *kind);

/* Opens the network where one is asked for and none is open. model: that will speak, whose kind and network it must be;
 * NULL: none yet. Returns 0, or EXIT_FAILURE after a message. */
int speech_model_open(struct speech_model *speech_model, struct session *session, const char *model_path,
                      const ern_model_info *model);
void speech_model_close(struct speech_model *speech_model);

/* After a call that heard: session_fail, or session_stop_with where Ctrl-C ended it. */
int speech_model_fail(struct session *session, ern_status status);

/* What a model asks of --speech-model: ": the network "NAME" with the SHA-256 1234...", or "". */
void speech_model_wanted(const ern_model_info *model, char words[192]);

#endif
