/* SPDX-License-Identifier: MIT */
#include "session/speech_model.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void speech_model_options(struct speech_model *speech_model, struct option options[SPEECH_MODEL_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_TEXT("speech-model", &speech_model->path), .choices = "FILE.onnx",
       .help = "a network that computes features of the sound (docs/speech.md), instead of the built-in kind; through "
               "OpenCV's DNN module"},
      {ARGS_TEXT("speech-preset", &speech_model->needs), .choices = "NAME|FILE.json",
       .help = "description of the network of --speech-model: esperanto or hubert, for 16 kHz sound as in the public "
               "scripts (both untested with the real networks), or a FILE.json of your own (default: that in the "
               "model, else FILE.json beside FILE.onnx)"}};
  ARGS_FILL(options, rows, SPEECH_MODEL_OPTIONS);
}

static bool is_description(const char *name) {
  const char *dot = strrchr(name, '.');
  return dot != NULL && strcmp(dot, ".json") == 0;
}

int speech_model_check(const struct speech_model *speech_model, const struct args *args, const char *audio) {
  if (speech_model->path == NULL)
    return args_forbid(args, "speech-preset", "describes the network of --speech-model, which is not given");
  if (speech_model->needs != NULL && ern_speech_preset(speech_model->needs) == NULL &&
      !is_description(speech_model->needs))
    return args_refuse(args, "--speech-preset is \"%s\", expected esperanto, hubert, or a description's FILE.json",
                       speech_model->needs);
  if (audio != NULL && !ern_speech_is_sound(audio))
    return args_refuse(args, "--speech-model takes a sound, and %s holds features", audio);
  return args_forbid(args, "asr-model",
                     "chooses the clip's features, and --speech-model computes them from its "
                     "sound; expected one of the two");
}

const char *speech_model_file(struct speech_model *speech_model) {
  static const char onnx[] = ".onnx";
  if (speech_model->needs != NULL) return is_description(speech_model->needs) ? speech_model->needs : NULL;
  if (speech_model->path == NULL) return NULL;
  const size_t count = strlen(speech_model->path), tail = sizeof onnx - 1;
  const size_t stem = count > tail && strcmp(speech_model->path + count - tail, onnx) == 0 ? count - tail : count;
  if (stem + sizeof onnx > sizeof speech_model->beside) return NULL; /* exceeds the length of a path */
  snprintf(speech_model->beside, sizeof speech_model->beside, "%.*s.json", (int)stem, speech_model->path);
  return speech_model->beside;
}

static int watch(void *user, size_t done, size_t pieces) {
  struct speech_model *speech_model = user;
  if (done == 0) progress_begin(&speech_model->progress, speech_model->progress.session, "speech", "pieces");
  progress_at(&speech_model->progress, done, pieces, "");
  if (done == pieces) progress_end(&speech_model->progress);
  return session_interrupted();
}

/* The description of the network: by --speech-preset, else by the model; NULL: a file beside the network has it. */
static const char *description_of(const struct speech_model *speech_model, const ern_model_info *model) {
  if (speech_model->needs != NULL) {
    const char *preset = ern_speech_preset(speech_model->needs);
    return preset != NULL ? preset : speech_model->needs;
  }
  if (model == NULL) return NULL;
  return model->speech_network[0] != 0 ? model->speech_network : ern_speech_preset(model->speech);
}

static int check_kind(const struct speech_model *speech_model, struct session *session, const char *model_path,
                      const ern_model_info *model) {
  const char *kind = ern_speech_network_kind(speech_model->network);
  if (model->speech[0] == 0) {
    session_warn(session,
                 "%s: does not say which kind of speech features it was trained on; those of %s (%s) are assumed",
                 model_path, speech_model->path, kind);
    return 0;
  }
  if (strcmp(model->speech, kind) == 0) return 0;
  return session_fail_with(session, "%s: was trained on speech features of the kind %s, and %s computes %s", model_path,
                           model->speech, speech_model->path, kind);
}

const char *speech_model_kind(const char *path, int width) {
  const struct {
    const char *name, *kind;
    int width;
  } files[] = {{"aud_ds.npy", "deepspeech", 29},
               {"aud_eo.npy", "esperanto", 44},
               {"aud_hu.npy", "hubert", 1024},
               {"aud_cep.npy", ERN_SPEECH_CEPSTRA, ern_speech_width(ERN_SPEECH_CEPSTRA)},
               {"aud_art.npy", ERN_SPEECH_ARTICULATORY, ern_speech_width(ERN_SPEECH_ARTICULATORY)}};
  const char *slash = strrchr(path, '/'), *name = slash != NULL ? slash + 1 : path;
  for (size_t i = 0; i < sizeof files / sizeof *files; i++)
    if (strcmp(name, files[i].name) == 0 && width == files[i].width) return files[i].kind;
  return "";
}

const char *speech_model_clip_kind(const ern_clip *clip) {
  ern_clip_info info;
  ern_clip_describe(clip, &info);
  return info.hears_sound ? info.speech : speech_model_kind(info.features_file, ern_clip_features(clip)->width);
}

bool speech_model_fits(const ern_model_info *model, const char *kind) {
  return model->speech[0] == 0 || kind[0] == 0 || strcmp(model->speech, kind) == 0;
}

int speech_model_check_features(struct session *session, const char *model_path, const ern_model_info *model,
                                const char *name, const char *kind) {
  char wanted[192];
  if (speech_model_fits(model, kind)) return 0;
  speech_model_wanted(model, wanted);
  return session_fail_with(session, "%s: was trained on speech features of the kind %s, and %s holds %s; expected %s%s",
                           model_path, model->speech, name, kind,
                           model->speech_network[0] != 0 ? "--speech-model FILE.onnx" : "features of that kind",
                           wanted);
}

int speech_model_open(struct speech_model *speech_model, struct session *session, const char *model_path,
                      const ern_model_info *model) {
  ern_model_info known = {0};
  if (speech_model->path == NULL || speech_model->network != NULL) return 0;
  if (model != NULL) {
    known = *model;
    const ern_features features = {.width = model->feature_width};
    if (known.speech[0] == 0) snprintf(known.speech, sizeof known.speech, "%s", ern_speech_kind(&features));
    if (speech_model->needs != NULL && known.speech_network[0] != 0)
      return session_fail_with(session, "%s: holds a description of its speech network; expected no --speech-preset",
                               model_path);
  }
  const char *description = description_of(speech_model, model != NULL ? &known : NULL);
  if (ern_speech_network_open(session->context, speech_model->path, description, &speech_model->network) != ERN_OK)
    return session_fail(session);
  speech_model->progress.session = session;
  ern_speech_network_watch(speech_model->network, watch, speech_model);
  return model != NULL ? check_kind(speech_model, session, model_path, &known) : 0;
}

void speech_model_close(struct speech_model *speech_model) { ern_speech_network_free(&speech_model->network); }

int speech_model_fail(struct session *session, ern_status status) {
  if (status != ERN_E_CANCELLED || !session_interrupted()) return session_fail(session);
  return session_stop_with(session, "%s", ern_last_error(session->context));
}

void speech_model_wanted(const ern_model_info *model, char words[192]) {
  json_t *root = model->speech_network[0] != 0 ? json_loads(model->speech_network, 0, NULL) : NULL;
  const char *kind = json_string_value(json_object_get(root, "kind")),
             *hash = json_string_value(json_object_get(root, "sha256"));
  words[0] = 0;
  if (kind != NULL && hash != NULL) snprintf(words, 192, ": the network \"%.63s\" with the SHA-256 %.64s", kind, hash);
  json_decref(root);
}
