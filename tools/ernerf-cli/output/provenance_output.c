/* SPDX-License-Identifier: MIT */
#include "output/provenance_output.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { SHORT_HASH = 32 /* letters of a hash within the id */, MOST_BYTES = 1 << 24 };

void provenance_options(struct provenance *provenance, struct option options[PROVENANCE_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_FLAG("no-provenance", &provenance->off),
       .help = "do not say in the output that a model made it, and write no OUT.provenance.json beside it"}};
  ARGS_FILL(options, rows, PROVENANCE_OPTIONS);
}

static json_t *read_own(const char *path) {
  struct stat file;
  if (stat(path, &file) != 0 || !S_ISREG(file.st_mode) || file.st_size > MOST_BYTES) return NULL;
  json_t *about = json_load_file(path, JSON_REJECT_DUPLICATES, NULL);
  const char *maker = json_string_value(json_object_get(about, "made_by"));
  if (maker != NULL && strcmp(maker, "ernerf") == 0 && json_object_get(about, "digital_source_type") != NULL)
    return about;
  json_decref(about);
  return NULL;
}

/* Whether this program wrote the file: it remains when only its video was deleted. */
static bool is_own(const char *path) {
  json_t *about = read_own(path);
  json_decref(about);
  return about != NULL;
}

int provenance_read(struct session *session, const char *output, json_t **about) {
  char path[4096 + 32], hash[65];
  *about = snprintf(path, sizeof path, "%s.provenance.json", output) < (int)sizeof path ? read_own(path) : NULL;
  const char *recorded = json_string_value(json_object_get(*about, "sha256"));
  if (recorded == NULL) { /* it does not say which file it is about */
    json_decref(*about);
    *about = NULL;
    return 0;
  }
  if (ern_file_sha256(session->context, output, hash) != ERN_OK) return session_fail(session);
  if (strcmp(recorded, hash) == 0) return 0;
  return session_fail_with(session,
                           "%s: sha256 is \"%.64s\", expected \"%s\", that of %s, which was made again since; "
                           "expected the file that belongs to it, or none",
                           path, recorded, hash, output);
}

/* Numbered pictures share one file, with "all" in place of the number. */
int provenance_check(struct provenance *provenance, struct session *session, const char *output) {
  const char *percent = provenance->numbered ? strchr(output, '%') : NULL,
             *mark = percent != NULL ? strchr(percent, 'd') : NULL;
  const size_t capacity = sizeof provenance->path;
  if (provenance->off) return 0;
  provenance->output = output;
  const int bytes = mark != NULL ? snprintf(provenance->path, capacity, "%.*sall%s.provenance.json",
                                            (int)(percent - output), output, mark + 1)
                                 : snprintf(provenance->path, capacity, "%s.provenance.json", output);
  if (bytes >= (int)capacity) return session_fail_with(session, "%s: the name is too long", output);
  if (!is_own(provenance->path)) return session_check_output(session, provenance->path);
  provenance->replaces = true;
  return session_check_not_inputs(session, provenance->path) == 0
             ? session_check_distinct_output(session, provenance->path)
             : EXIT_FAILURE;
}

/* {"file": NAME, "sha256": ...}, without the folder, which is private. */
static json_t *file_json(struct session *session, const char *path, char hex[65]) {
  const char *slash = strrchr(path, '/');
  if (ern_file_sha256(session->context, path, hex) != ERN_OK) return NULL;
  return json_pack("{s:o, s:s}", "file", session_text(slash != NULL ? slash + 1 : path), "sha256", hex);
}

int provenance_learn(struct provenance *provenance, struct session *session, const struct portrait *portrait,
                     const char *speech, bool all_trained) {
  char model_hash[65] = "", speech_hash[65] = "";
  if (provenance->off) return 0;
  json_t *model = file_json(session, portrait->model_path, model_hash);
  json_t *heard = speech != NULL ? file_json(session, speech, speech_hash) : json_null();
  if (model == NULL || heard == NULL) {
    json_decref(model);
    json_decref(heard);
    return session_fail(session);
  }
  snprintf(provenance->id, sizeof provenance->id, "%.*s%s%.*s", SHORT_HASH, model_hash, speech != NULL ? "-" : "",
           SHORT_HASH, speech_hash);
  provenance->says = ern_provenance_default();
  provenance->says.all_trained = all_trained;
  provenance->says.id = provenance->id;
  provenance->says.consent = portrait->info.consent;
  provenance->says.description = provenance->description;
  provenance->about =
      json_pack("{s:s, s:s, s:s, s:o, s:o, s:s, s:s}", "made_by", "ernerf", "version", ern_version(),
                "digital_source_type", all_trained ? "trainedAlgorithmicMedia" : "compositeWithTrainedAlgorithmicMedia",
                "model", model, "speech", heard, "clip", portrait->info.clip, "consent", portrait->info.consent);
  if (provenance->about == NULL) return session_fail_with(session, "out of memory");
  if (portrait->info.consent[0] == 0)
    session_warn(session, "%s: does not say that the person has agreed; `train --consent TEXT` makes a model say it",
                 portrait->model_path);
  return 0;
}

/* The members that are equal in all segments: an object. */
static json_t *said_by_all(const json_t *says) {
  static const char *const own[] = {"output", "sha256", "version",    "first_frame",
                                    "frames", "sound",  "sound_file", "synthetic_seconds"}; /* of one */
  json_t *first = json_array_get(says, 0), *alike = json_is_object(first) ? json_copy(first) : json_object(), *value;
  const char *name;
  void *next;
  for (size_t i = 0; i < sizeof own / sizeof *own; i++) (void)json_object_del(alike, own[i]);
  for (size_t k = 1; k < json_array_size(says); k++) {
    const json_t *other = json_array_get(says, k);
    json_object_foreach_safe(alike, next, name, value) {
      if (!json_equal(json_object_get(other, name), value)) (void)json_object_del(alike, name);
    }
  }
  return alike;
}

/* Name and hash of a segment, and its members that differ between segments, except its former name. */
static json_t *segment_json(struct session *session, const char *path, json_t *says, const json_t *alike) {
  char hex[65];
  const char *name;
  json_t *value, *segment = file_json(session, path, hex);
  bool whole = segment != NULL;
  json_object_foreach(says, name, value) {
    const bool listed = json_object_get(alike, name) != NULL || json_object_get(segment, name) != NULL;
    if (whole && !listed && strcmp(name, "output") != 0) whole = json_object_set(segment, name, value) == 0;
  }
  if (whole) return segment;
  json_decref(segment);
  return NULL;
}

int provenance_join(struct provenance *provenance, struct session *session, char *const *segments, const json_t *says,
                    const char *sound) {
  char hex[65];
  if (provenance->off) return 0;
  json_t *alike = said_by_all(says), *list = json_array();
  json_t *heard = sound != NULL ? file_json(session, sound, hex) : json_null();
  bool whole = alike != NULL && list != NULL && heard != NULL;
  for (size_t k = 0; k < json_array_size(says) && whole; k++)
    whole = json_array_append_new(list, segment_json(session, segments[k], json_array_get(says, k), alike)) == 0;
  if (whole) /* no source type: the segments differ */
    provenance->about = json_pack("{s:s, s:s, s:O?, s:b, s:O, s:O}", "made_by", "ernerf", "version", ern_version(),
                                  "digital_source_type", json_object_get(alike, "digital_source_type"), "sound",
                                  sound != NULL, "sound_file", heard, "segments", list);
  whole = provenance->about != NULL && json_object_update_missing(provenance->about, alike) == 0;
  json_decref(heard);
  json_decref(alike);
  json_decref(list);
  return whole ? 0 : session_fail(session);
}

const ern_provenance *provenance_of(const struct provenance *provenance) {
  return provenance->off ? NULL : &provenance->says;
}

/* Adds the hash of the output, which ties the file to it. Numbered pictures have none. */
static int add_hash(struct provenance *provenance, struct session *session) {
  char hash[65];
  struct stat file;
  if (stat(provenance->output, &file) != 0 || !S_ISREG(file.st_mode)) return 0;
  if (ern_file_sha256(session->context, provenance->output, hash) != ERN_OK) return session_fail(session);
  return json_object_set_new(provenance->about, "sha256", json_string(hash)) == 0
             ? 0
             : session_fail_with(session, "out of memory");
}

int provenance_write(struct provenance *provenance, struct session *session, json_t *more) {
  char *text = NULL;
  int status = 0;
  if (provenance->path[0] != 0) status = add_hash(provenance, session);
  if (provenance->path[0] != 0 && status == 0) {
    if (more != NULL && json_object_update(provenance->about, more) == 0 && !session_json_refused())
      text = json_dumps(provenance->about, JSON_INDENT(2));
    /* of numbered pictures, one that appeared is of a process that drew others */
    const bool replaces = provenance->replaces || provenance->numbered;
    if (text != NULL && replaces && is_own(provenance->path)) (void)unlink(provenance->path);
    if (text == NULL)
      status = session_fail_with(session, "out of memory");
    else if (ern_file_save(session->context, provenance->path, text, strlen(text)) != ERN_OK)
      status = session_fail(session);
  }
  free(text);
  json_decref(more);
  return status;
}

void provenance_free(struct provenance *provenance) {
  json_decref(provenance->about);
  provenance->about = NULL;
}
