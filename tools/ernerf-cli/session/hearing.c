/* SPDX-License-Identifier: MIT */
#include "session/hearing.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void hearing_options(struct hearing *hearing, struct option options[HEARING_OPTIONS]) {
  const struct option rows[] = {
      {.name = "speech-model",
       .kind = OPTION_TEXT,
       .target = &hearing->path,
       .choices = "FILE.onnx",
       .help = "a network that computes features of the sound (docs/speech.md), instead of the built-in kind; through "
               "OpenCV's DNN module"},
      {.name = "speech-preset",
       .kind = OPTION_TEXT,
       .target = &hearing->needs,
       .choices = "NAME|FILE.json",
       .help = "description of the network of --speech-model: esperanto or hubert, for 16 kHz sound as in the public "
               "scripts (both untested with the real networks), or a FILE.json of your own (default: that in the "
               "model, else FILE.json beside FILE.onnx)"}};
  ARGS_FILL(options, rows, HEARING_OPTIONS);
}

static bool is_description(const char *name) {
  const char *dot = strrchr(name, '.');
  return dot != NULL && strcmp(dot, ".json") == 0;
}

int hearing_check(const struct hearing *hearing, const struct args *args, const char *audio) {
  if (hearing->path == NULL)
    return args_forbid(args, "speech-preset", "describes the network of --speech-model, which is not given");
  if (hearing->needs != NULL && ern_speech_preset(hearing->needs) == NULL && !is_description(hearing->needs))
    return args_refuse(args, "--speech-preset is \"%s\", expected esperanto, hubert, or a description's FILE.json",
                       hearing->needs);
  if (audio != NULL && !ern_speech_is_sound(audio))
    return args_refuse(args, "--speech-model takes a sound, and %s holds features", audio);
  return args_forbid(args, "asr_model",
                     "chooses the clip's features, and --speech-model computes them from its "
                     "sound; expected one of the two");
}

const char *hearing_file(struct hearing *hearing) {
  static const char onnx[] = ".onnx";
  if (hearing->needs != NULL) return is_description(hearing->needs) ? hearing->needs : NULL;
  if (hearing->path == NULL) return NULL;
  const size_t count = strlen(hearing->path), tail = sizeof onnx - 1;
  const size_t stem = count > tail && strcmp(hearing->path + count - tail, onnx) == 0 ? count - tail : count;
  if (stem + sizeof onnx > sizeof hearing->beside) return NULL; /* longer than a path may be */
  snprintf(hearing->beside, sizeof hearing->beside, "%.*s.json", (int)stem, hearing->path);
  return hearing->beside;
}

static int watch(void *user, size_t done, size_t pieces) {
  struct hearing *hearing = user;
  if (done == 0) progress_begin(&hearing->progress, hearing->progress.session, "speech", "pieces");
  progress_at(&hearing->progress, done, pieces, "");
  if (done == pieces) progress_end(&hearing->progress);
  return session_interrupted();
}

/* What the model, if any, says of its features; NULL: a file beside the network is left to say it. */
static const char *description_of(const struct hearing *hearing, const ern_model_info *model) {
  if (hearing->needs != NULL) {
    const char *preset = ern_speech_preset(hearing->needs);
    return preset != NULL ? preset : hearing->needs;
  }
  if (model == NULL) return NULL;
  return model->speech_network[0] != 0 ? model->speech_network : ern_speech_preset(model->speech);
}

static int check_kind(const struct hearing *hearing, struct session *session, const char *model_path,
                      const ern_model_info *model) {
  const char *kind = ern_speech_network_kind(hearing->network);
  if (model->speech[0] == 0) {
    session_warn(session,
                 "%s: does not say which kind of speech features it was trained on; those of %s (%s) are assumed",
                 model_path, hearing->path, kind);
    return 0;
  }
  if (strcmp(model->speech, kind) == 0) return 0;
  return session_fail_with(session, "%s: was trained on speech features of the kind %s, and %s computes %s", model_path,
                           model->speech, hearing->path, kind);
}

const char *hearing_kind(const char *path, int width) {
  static const struct {
    const char *name, *kind;
    int width;
  } files[] = {{"aud_ds.npy", "deepspeech", 29},
               {"aud_eo.npy", "esperanto", 44},
               {"aud_hu.npy", "hubert", 1024},
               {"aud_cep.npy", ERN_SPEECH_CEPSTRA, ERN_SPEECH_WIDTH}};
  const char *slash = strrchr(path, '/'), *name = slash != NULL ? slash + 1 : path;
  for (size_t i = 0; i < sizeof files / sizeof *files; i++)
    if (strcmp(name, files[i].name) == 0 && width == files[i].width) return files[i].kind;
  return "";
}

const char *hearing_clip_kind(const ern_clip *clip) {
  ern_clip_info info;
  ern_clip_describe(clip, &info);
  return info.hears_sound ? info.speech : hearing_kind(info.features_file, ern_clip_features(clip)->width);
}

bool hearing_fits(const ern_model_info *model, const char *kind) {
  return model->speech[0] == 0 || kind[0] == 0 || strcmp(model->speech, kind) == 0;
}

int hearing_check_features(struct session *session, const char *model_path, const ern_model_info *model,
                           const char *name, const char *kind) {
  char wanted[192];
  if (hearing_fits(model, kind)) return 0;
  hearing_wanted(model, wanted);
  return session_fail_with(session, "%s: was trained on speech features of the kind %s, and %s holds %s; expected %s%s",
                           model_path, model->speech, name, kind,
                           model->speech_network[0] != 0 ? "--speech-model FILE.onnx" : "features of that kind",
                           wanted);
}

int hearing_open(struct hearing *hearing, struct session *session, const char *model_path,
                 const ern_model_info *model) {
  ern_model_info known = {0};
  if (hearing->path == NULL || hearing->network != NULL) return 0;
  if (model != NULL) {
    known = *model;
    const ern_features features = {.width = model->feature_width};
    if (known.speech[0] == 0) snprintf(known.speech, sizeof known.speech, "%s", ern_speech_kind(&features));
    if (hearing->needs != NULL && known.speech_network[0] != 0)
      return session_fail_with(session, "%s: holds a description of its speech network; expected no --speech-preset",
                               model_path);
  }
  const char *description = description_of(hearing, model != NULL ? &known : NULL);
  if (ern_speech_network_open(session->context, hearing->path, description, &hearing->network) != ERN_OK)
    return session_fail(session);
  hearing->progress.session = session;
  ern_speech_network_watch(hearing->network, watch, hearing);
  return model != NULL ? check_kind(hearing, session, model_path, &known) : 0;
}

void hearing_close(struct hearing *hearing) { ern_speech_network_free(&hearing->network); }

int hearing_fail(struct session *session, ern_status status) {
  if (status != ERN_E_CANCELLED || !session_interrupted()) return session_fail(session);
  return session_stop_with(session, "%s", ern_last_error(session->context));
}

void hearing_wanted(const ern_model_info *model, char words[192]) {
  json_t *root = model->speech_network[0] != 0 ? json_loads(model->speech_network, 0, NULL) : NULL;
  const char *kind = json_string_value(json_object_get(root, "kind")),
             *hash = json_string_value(json_object_get(root, "sha256"));
  words[0] = 0;
  if (kind != NULL && hash != NULL) snprintf(words, 192, ": the network \"%.63s\" with the SHA-256 %.64s", kind, hash);
  json_decref(root);
}
