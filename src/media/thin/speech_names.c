/* SPDX-License-Identifier: MIT
 * The names of the kinds of speech features, and the type of a file by its first bytes. */
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include "ernerf/speech.h"

/* The public scripts data_utils/wav2vec.py and data_utils/hubert.py (docs/speech.md, "Networks"). */
static const struct {
  const char *name, *text;
} presets[] = {{"esperanto",
                "{\"kind\":\"esperanto\",\"rate\":16000,\"normalisation\":\"piece\",\"piece_samples\":22400,"
                "\"context_samples\":3200,\"row_samples\":400,\"width\":44,\"window_rows\":16}"},
               {"hubert",
                "{\"kind\":\"hubert\",\"rate\":16000,\"normalisation\":\"sound\",\"piece_samples\":320080,"
                "\"context_samples\":0,\"row_samples\":400,\"width\":1024,\"window_rows\":2}"}};

const char *ern_speech_preset(const char *name) {
  for (size_t i = 0; name != NULL && i < sizeof presets / sizeof *presets; i++)
    if (strcmp(name, presets[i].name) == 0) return presets[i].text;
  return NULL;
}

int ern_speech_width(const char *kind) {
  if (kind == NULL) return 0;
  return strcmp(kind, ERN_SPEECH_ARTICULATORY) == 0 ? ERN_SPEECH_MOST_WIDTH
         : strcmp(kind, ERN_SPEECH_CEPSTRA) == 0    ? ERN_SPEECH_WIDTH
                                                    : 0;
}

const char *ern_speech_kind(const ern_features *features) {
  switch (features != NULL ? features->width : 0) {
    case 29: return "deepspeech";
    case 44: return "esperanto";
    case 1024: return "hubert";
    default: return "";
  }
}

bool ern_speech_is_sound(const char *path) {
  char start[6] = "";
  const size_t length = path != NULL ? strlen(path) : 0;
  if (length > 4 && strcmp(path + length - 4, ".npy") == 0) return false;
  struct stat about; /* a pipe is not opened: that waits for a writer */
  FILE *file = path != NULL && stat(path, &about) == 0 && S_ISREG(about.st_mode) ? fopen(path, "rb") : NULL;
  const bool read = file != NULL && fread(start, 1, sizeof start, file) == sizeof start;
  if (file != NULL) fclose(file);
  return !read || memcmp(start, "\x93NUMPY", sizeof start) != 0;
}
