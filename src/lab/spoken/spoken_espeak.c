/* SPDX-License-Identifier: MIT
 * Loads espeak-ng on demand, and collects its sound and the phonemes that it reports. */
#include <string.h>

#include "core/floats.h"
#include "core/memory.h"
#include "core/status.h"
#include "ernerf-lab/spoken.h"

void ern_spoken_free(ern_context *context, ern_spoken *spoken) {
  if (context == NULL || spoken == NULL) return;
  ern_release(context, spoken->sound.data);
  ern_release(context, spoken->phoneme);
  *spoken = (ern_spoken){0};
}

#if !ERN_ESPEAK

bool ern_spoken_is_built(void) { return false; }

ern_status ern_spoken_make(ern_context *context, const char *text, const ern_spoken_options *options,
                           ern_spoken *spoken) {
  (void)text, (void)options;
  *spoken = (ern_spoken){0};
  return ern_fail(context, ERN_E_UNSUPPORTED, "speech: this program was built without espeak-ng (libespeak-ng-dev)");
}

#else

#include <dlfcn.h>
#include <espeak-ng/speak_lib.h>

enum { MOST_SECONDS = 3600 };
static const char library_name[] = "libespeak-ng.so.1";

/* The functions in use, under espeak-ng's names. */
struct espeak {
  void *library;
  int (*initialize)(espeak_AUDIO_OUTPUT, int, const char *, int);
  espeak_ERROR (*set_voice)(const char *);
  espeak_ERROR (*set_parameter)(espeak_PARAMETER, int, int);
  void (*set_callback)(t_espeak_callback *);
  espeak_ERROR (*synth)(const void *, size_t, unsigned, espeak_POSITION_TYPE, unsigned, unsigned, unsigned *, void *);
  espeak_ERROR (*terminate)(void);
};

/* The output of the callback. */
struct taking {
  ern_context *context;
  ern_spoken *spoken;
  size_t capacity, phoneme_capacity;
  ern_status status;
};

bool ern_spoken_is_built(void) { return true; }

static ern_status load(ern_context *context, struct espeak *espeak) {
  espeak->library = dlopen(library_name, RTLD_NOW | RTLD_LOCAL);
  if (espeak->library == NULL)
    return ern_fail(context, ERN_E_UNSUPPORTED, "%s: cannot be loaded: %s (Debian: libespeak-ng1)", library_name,
                    dlerror());
  const struct {
    const char *name;
    void *to;
  } symbols[] = {{"espeak_Initialize", &espeak->initialize},
                 {"espeak_SetVoiceByName", &espeak->set_voice},
                 {"espeak_SetParameter", &espeak->set_parameter},
                 {"espeak_SetSynthCallback", &espeak->set_callback},
                 {"espeak_Synth", &espeak->synth},
                 {"espeak_Terminate", &espeak->terminate}};
  for (size_t i = 0; i < sizeof symbols / sizeof *symbols; i++) {
    void *symbol = dlsym(espeak->library, symbols[i].name);
    if (symbol == NULL)
      return ern_fail(context, ERN_E_UNSUPPORTED, "%s: lacks the function %s", library_name, symbols[i].name);
    memcpy(symbols[i].to, &symbol, sizeof symbol);
  }
  return ERN_OK;
}

/* Room for `more` elements past `count`. */
#define GROW(context, array, count, more, capacity, status)            \
  do {                                                                 \
    if ((count) + (more) <= (capacity)) break;                         \
    const size_t wanted_ = 2 * ((count) + (more));                     \
    void *old_ = (array);                                              \
    (status) = ERN_NEW(context, wanted_, &(array));                    \
    if ((status) != ERN_OK) {                                          \
      (array) = old_;                                                  \
      break;                                                           \
    }                                                                  \
    if ((count) > 0) memcpy((array), old_, (count) * sizeof *(array)); \
    ern_release(context, old_);                                        \
    (capacity) = wanted_;                                              \
  } while (0)

static void take_samples(struct taking *taking, const short *samples, size_t count) {
  ern_sound *sound = &taking->spoken->sound;
  if (sound->frames + count > (size_t)MOST_SECONDS * (size_t)sound->rate) {
    taking->status = ern_fail(taking->context, ERN_E_SHAPE, "speech: the text takes more than %d s", MOST_SECONDS);
    return;
  }
  GROW(taking->context, sound->data, sound->frames, count, taking->capacity, taking->status);
  if (taking->status != ERN_OK) return;
  memcpy(sound->data + sound->frames, samples, count * sizeof *samples);
  sound->frames += count;
}

static void take_phoneme(struct taking *taking, const espeak_EVENT *event) {
  ern_spoken *spoken = taking->spoken;
  GROW(taking->context, spoken->phoneme, spoken->count, 1, taking->phoneme_capacity, taking->status);
  if (taking->status != ERN_OK) return;
  ern_phoneme *phoneme = &spoken->phoneme[spoken->count++];
  *phoneme = (ern_phoneme){.start = (double)event->sample / spoken->sound.rate};
  size_t from = 0;
  while (from < 8 && event->id.string[from] != 0 && strchr("',;%=|", event->id.string[from]) != NULL) from++;
  memcpy(phoneme->name, event->id.string + from, 8 - from);
  if (phoneme->name[0] == 0) phoneme->name[0] = '_';
}

static int take(short *samples, int count, espeak_EVENT *events) {
  struct taking *taking = events->user_data;
  if (taking->status == ERN_OK && samples != NULL && count > 0) take_samples(taking, samples, (size_t)count);
  for (; taking->status == ERN_OK && events->type != espeakEVENT_LIST_TERMINATED; events++)
    if (events->type == espeakEVENT_PHONEME) take_phoneme(taking, events);
  return taking->status == ERN_OK ? 0 : 1;
}

static ern_status say(const struct espeak *espeak, struct taking *taking, const char *text,
                      const ern_spoken_options *options) {
  ern_spoken *spoken = taking->spoken;
  ern_context *context = taking->context;
  const int rate = espeak->initialize(AUDIO_OUTPUT_SYNCHRONOUS, 0, NULL,
                                      espeakINITIALIZE_PHONEME_EVENTS | espeakINITIALIZE_DONT_EXIT);
  if (rate <= 0)
    return ern_fail(context, ERN_E_UNSUPPORTED, "%s: does not start; expected its data (Debian: espeak-ng-data)",
                    library_name);
  spoken->sound = (ern_sound){.rate = rate, .channels = 1};
  if (espeak->set_voice(options->voice) != EE_OK)
    return ern_fail(context, ERN_E_ARGUMENT, "speech: espeak-ng knows no voice \"%s\"; `espeak-ng --voices` lists them",
                    options->voice);
  espeak->set_callback(take);
  if (espeak->set_parameter(espeakRATE, options->words_per_minute, 0) != EE_OK ||
      espeak->synth(text, strlen(text) + 1, 0, POS_CHARACTER, 0, espeakCHARS_UTF8, NULL, taking) != EE_OK)
    return ern_fail(context, ERN_E_UNSUPPORTED, "%s: does not speak the text", library_name);
  if (taking->status != ERN_OK) return taking->status;
  bool spoke = false;
  for (size_t i = 0; i < spoken->count; i++) spoke = spoke || spoken->phoneme[i].name[0] != '_';
  if (spoken->sound.frames == 0 || !spoke)
    return ern_fail(context, ERN_E_ARGUMENT, "speech: the text has nothing that can be spoken");
  for (size_t i = 0; i < spoken->count; i++)
    spoken->phoneme[i].end =
        i + 1 < spoken->count ? spoken->phoneme[i + 1].start : (double)spoken->sound.frames / spoken->sound.rate;
  return ERN_OK;
}

ern_status ern_spoken_make(ern_context *context, const char *text, const ern_spoken_options *options,
                           ern_spoken *spoken) {
  ERN_PLAIN_FLOATS;
  ern_status status = ERN_OK;
  struct espeak espeak = {0};
  struct taking taking = {.context = context, .spoken = spoken};
  *spoken = (ern_spoken){0};
  if (options->words_per_minute < espeakRATE_MINIMUM || options->words_per_minute > espeakRATE_MAXIMUM)
    return ern_fail(context, ERN_E_ARGUMENT, "speech: %d words a minute, expected %d to %d", options->words_per_minute,
                    espeakRATE_MINIMUM, espeakRATE_MAXIMUM);
  ERN_TRY(load(context, &espeak));
  status = say(&espeak, &taking, text, options);
  (void)espeak.terminate();
fail:
  if (espeak.library != NULL) (void)dlclose(espeak.library);
  if (status != ERN_OK) ern_spoken_free(context, spoken);
  return status;
}

#endif
