/* SPDX-License-Identifier: MIT */
#define _XOPEN_SOURCE 700 /* realpath */
#include "session/session.h"

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "ernerf/data.h"
#include "ernerf/media.h"

static atomic_int interrupted; /* number of the signal, which may come to any thread */
static atomic_int stopped_by;  /* the signal that session_stop_with reported */
static atomic_bool json_refused;

/* The next SIGINT or SIGTERM ends the program at once. When a terminal closes, SIGHUP comes twice, from the system and
 * from the shell: both count as one. */
static void catch_interrupt(int number) {
  signal(SIGINT, SIG_DFL);
  signal(SIGTERM, SIG_DFL);
  signal(SIGHUP, SIG_IGN);
  atomic_store(&interrupted, number);
}

bool session_interrupted(void) { return atomic_load(&interrupted) != 0; }

/* ---- options ----------------------------------------------------------------------------------------------------- */

void session_output_options(struct session *session, struct option options[SESSION_OUTPUT_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_FLAG("quiet", &session->quiet), .help = "results, warnings and errors alone: no progress, no notes"},
      {ARGS_JSON("json", &session->json), .help = "the result as one JSON object, on standard output or in a file"},
      {ARGS_FLAG("overwrite", &session->overwrite), .alias = "y",
       .help = "replace output files that exist; without it they are refused"}};
  ARGS_FILL(options, rows, SESSION_OUTPUT_OPTIONS);
}

void session_compute_options(struct session *session, struct option options[SESSION_COMPUTE_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_CHOICE("backend", &session->backend_choice, "auto|cpu|opencl"),
       .help = "where to compute; auto, the default, is the CPU"},
      {ARGS_INT("device", &session->device, 0, 255),
       .help = "number of an OpenCL device, as `ernerf info devices` counts; with --backend opencl"},
      {ARGS_FLAG("deterministic", &session->deterministic), .seldom = true,
       .help = "the same bytes in every run also on OpenCL devices that are no CPU, which makes them slower; not of "
               "train --time, --hold-fps, and --quality where its settings are measured at the start"},
      {ARGS_TEXT("isa", &session->isa), .choices = "NAME",
       .help = "instruction set of the CPU: auto (that in the environment variable ERNERF_ISA, else the fastest that "
               "the CPU has; the default), avx2, avx512, avx512bf16, neon, or ref and ref64: portable C in 32-bit and "
               "64-bit floats, slow"},
      {ARGS_INT("threads", &session->threads, 0, ERN_THREADS_MOST),
       .help = "number of threads; 0: one a core; the result is the same for any number"}};
  ARGS_FILL(options, rows, SESSION_COMPUTE_OPTIONS);
}

void session_seed_options(struct session *session, struct option options[SESSION_SEED_OPTIONS]) {
  const struct option rows[] = {{ARGS_COUNT("seed", &session->seed, 0, 0),
                                 .help = "seed of all random numbers; the same seed gives the same bytes, except "
                                         "with `train --time` (default 0)"}};
  ARGS_FILL(options, rows, SESSION_SEED_OPTIONS);
}

/* ---- messages ---------------------------------------------------------------------------------------------------- */

static void say(struct session *session, const char *before, const char *format, va_list values) {
  char text[4096];
  vsnprintf(text, sizeof text, format, values);
  bytes_plain(text); /* the kind of a model's speech may be anything */
  fprintf(stderr, "%s%s%s\n", atomic_exchange(&session->line_open, false) ? "\n" : "", before, text);
}

static void say_end(struct session *session, const char *format, va_list values) {
  char before[64];
  if (session->held != NULL) {
    vsnprintf(session->held, SESSION_HELD, format, values);
    return;
  }
  if (session->rank > 0)
    snprintf(before, sizeof before, "ernerf %s: rank %d: ", session->verb, session->rank);
  else
    snprintf(before, sizeof before, "ernerf %s: ", session->verb);
  say(session, before, format, values);
}

int session_fail_with(struct session *session, const char *format, ...) {
  va_list values;
  va_start(values, format);
  say_end(session, format, values);
  va_end(values);
  return EXIT_FAILURE;
}

int session_stop_with(struct session *session, const char *format, ...) {
  va_list values;
  va_start(values, format);
  say_end(session, format, values);
  va_end(values);
  atomic_store(&stopped_by, atomic_load(&interrupted));
  return EXIT_FAILURE;
}

int session_exit_status(int status) {
  const int number = atomic_load(&stopped_by);
  return status == EXIT_FAILURE && number > 0 ? 128 + number : status;
}

int session_fail(struct session *session) {
  char text[SESSION_HELD];
  (void)ern_last_error_copy(session->context, text, sizeof text);
  return session_fail_with(session, "%s", text[0] != 0 ? text : "failed and gave no reason");
}

void session_warn(struct session *session, const char *format, ...) {
  if (session->rank > 0) return;
  va_list values;
  va_start(values, format);
  say(session, "warning: ", format, values);
  va_end(values);
}

void session_note(struct session *session, const char *format, ...) {
  if (session->quiet || session->rank > 0) return;
  va_list values;
  va_start(values, format);
  say(session, "", format, values);
  va_end(values);
}

void session_note_rank(struct session *session, const char *format, ...) {
  if (session->quiet) return;
  va_list values;
  va_start(values, format);
  say(session, "", format, values);
  va_end(values);
}

/* Whether the library said the same a few lines before: it remarks on a file each time that it reads it. */
static bool was_said(struct session *session, const char *line) {
  uint64_t hash = 0xcbf29ce484222325; /* FNV-1a */
  for (const char *at = line; *at != 0; at++) hash = (hash ^ (unsigned char)*at) * 0x100000001b3;
  for (size_t i = 0; i < SESSION_REMARKS; i++)
    if (atomic_load(&session->remarks[i]) == hash) return true;
  atomic_store(&session->remarks[atomic_fetch_add(&session->remark_count, 1) % SESSION_REMARKS], hash);
  return false;
}

static void log_line(void *user, ern_log_level level, const char *line) {
  struct session *session = user;
  if (level <= ERN_LOG_INFO && was_said(session, line)) return;
  if (level == ERN_LOG_INFO) session_note(session, "%s", line);
  if (level <= ERN_LOG_WARNING) session_warn(session, "%s", line);
}

/* ---- beginning and end ------------------------------------------------------------------------------------------- */

static void catch_signals(void) {
  struct sigaction action = {.sa_handler = catch_interrupt, .sa_flags = SA_RESTART}, before;
  sigemptyset(&action.sa_mask);
  sigaction(SIGINT, &action, NULL);
  sigaction(SIGTERM, &action, NULL);
  if (sigaction(SIGHUP, NULL, &before) == 0 && before.sa_handler != SIG_IGN) /* ignored by nohup */
    sigaction(SIGHUP, &action, NULL);
  /* a write beyond the size limit or without a reader then fails with an error, instead of killing the program */
  action = (struct sigaction){.sa_handler = SIG_IGN};
  sigaction(SIGXFSZ, &action, NULL);
  sigaction(SIGPIPE, &action, NULL);
}

/* *about, of a regular file; else all 0. */
static void see_file(const char *path, struct stat *about) {
  if (path == NULL || stat(path, about) != 0 || !S_ISREG(about->st_mode)) *about = (struct stat){0};
}

static void see_inputs(struct session *session) {
  for (size_t i = 0; i < SESSION_INPUTS; i++) see_file(session->inputs[i], &session->seen[i]);
}

int session_open(struct session *session, const struct args *args) {
  session->verb = args->verb;
  if (args_given(args, "device") && session->backend_choice != SESSION_OPENCL)
    return args_refuse(args, "--device counts OpenCL devices, so it needs --backend opencl");
  if (session->backend_choice == SESSION_OPENCL && !session->beside_cpu) {
    const int status = args_forbid(args, "isa threads", "is about the CPU, which --backend opencl leaves out");
    if (status >= 0) return status;
  }
  ern_context_config config = ern_context_config_default();
  config.log = log_line;
  config.user = session;
  config.keep_files = !session->overwrite && !session->rewrites;
  if (ern_context_create(&session->context, &config) != ERN_OK) return session_fail_with(session, "no memory");
  catch_signals();
  see_inputs(session);
  if (session->json == NULL || session_json_on_stdout(session) || session_check_output(session, session->json) == 0)
    return -1;
  session_close(session);
  return EXIT_FAILURE;
}

ern_status session_backend(struct session *session) {
  static const char *const names[] = {[SESSION_AUTO] = "auto", [SESSION_CPU] = "cpu", [SESSION_OPENCL] = "opencl"};
  ern_backend_config config = ern_backend_config_default();
  config.name = names[session->backend_choice];
  config.isa = session->isa;
  config.device = session->device;
  config.deterministic = session->deterministic;
  config.tune = session->tune;
  const ern_status status = ern_backend_create(&session->backend, session->context, &config);
  if (status == ERN_OK) ern_backend_describe(session->backend, &session->backend_info);
  return status;
}

static void forget_staged(struct session *session) {
  for (size_t i = 0; i < session->staged; i++) {
    free(session->staged_path[i]);
    free(session->staged_bytes[i]);
  }
  session->staged = 0;
  session->staging = false;
}

void session_close(struct session *session) {
  json_decref(session->outputs);
  forget_staged(session);
  session->outputs = NULL;
  ern_backend_free(&session->backend);
  ern_context_free(&session->context);
}

/* ---- the object of --json ---------------------------------------------------------------------------------------- */

static void *json_memory(size_t bytes) {
  void *memory = malloc(bytes);
  if (memory == NULL) atomic_store(&json_refused, true);
  return memory;
}

void session_watch_json(void) { json_set_alloc_funcs(json_memory, free); }

bool session_json_refused(void) { return atomic_load(&json_refused); }

bool session_json_on_stdout(const struct session *session) {
  return session->json != NULL && strcmp(session->json, "-") == 0;
}

/* Bytes of the UTF-8 character at `text`; 0: invalid. Overlong forms and surrogates are invalid, as in jansson. */
static size_t character_bytes(const char *text) {
  size_t bytes = (unsigned char)text[0] < 0x80 ? 1 : 2;
  for (; bytes <= 4; bytes++) {
    json_t *one = strnlen(text, bytes) == bytes ? json_stringn(text, bytes) : NULL;
    json_decref(one);
    if (one != NULL) return bytes;
  }
  return 0;
}

json_t *session_text(const char *text) {
  json_t *whole = json_string(text);
  struct bytes kept = {0};
  if (whole != NULL) return whole;
  while (*text != 0) {
    const size_t bytes = character_bytes(text);
    bytes_print(&kept, "%.*s", bytes > 0 ? (int)bytes : 3, bytes > 0 ? text : "\xef\xbf\xbd");
    text += bytes > 0 ? bytes : 1;
  }
  whole = kept.failed || kept.data == NULL ? NULL : json_stringn((const char *)kept.data, kept.count);
  bytes_free(&kept);
  return whole;
}

json_t *session_whole(uint64_t value) {
  char digits[24];
  if (value <= INT64_MAX) return json_integer((json_int_t)value);
  snprintf(digits, sizeof digits, "%" PRIu64, value);
  return json_string(digits);
}

json_t *session_number(double value) { return isfinite(value) ? json_real(value) : json_null(); }

static int stage(struct session *session, const char *path, const void *bytes, size_t count) {
  const size_t at = session->staged;
  if (at == SESSION_STAGED) return session_fail_with(session, "%s: is one file too many", path);
  session->staged_path[at] = strdup(path);
  session->staged_bytes[at] = malloc(count + 1);
  session->staged_size[at] = count;
  session->staged++;
  if (session->staged_path[at] == NULL || session->staged_bytes[at] == NULL)
    return session_fail_with(session, "no memory for %s", path);
  memcpy(session->staged_bytes[at], bytes, count);
  return 0;
}

void session_stage(struct session *session) { session->staging = true; }

int session_write_staged(struct session *session, int status) {
  const char *paths[SESSION_STAGED];
  const void *bytes[SESSION_STAGED];
  for (size_t i = 0; i < session->staged; i++) paths[i] = session->staged_path[i], bytes[i] = session->staged_bytes[i];
  if (status == 0 && ern_files_save(session->context, session->staged, paths, bytes, session->staged_size) != ERN_OK)
    status = session_fail(session);
  forget_staged(session);
  return status;
}

int session_write(struct session *session, const char *path, const void *bytes, size_t count) {
  if (session->staging) return stage(session, path, bytes, count);
  return ern_file_save(session->context, path, bytes, count) == ERN_OK ? 0 : session_fail(session);
}

int session_write_in(struct session *session, const char *folder, const char *name, struct bytes *bytes) {
  char path[4096];
  int status = EXIT_FAILURE;
  if (bytes->failed || bytes->data == NULL)
    session_fail_with(session, "no memory for %s", name);
  else if (snprintf(path, sizeof path, "%s/%s", folder, name) >= (int)sizeof path)
    session_fail_with(session, "%s: the name is too long", folder);
  else
    status = session_write(session, path, bytes->data, bytes->count);
  bytes_free(bytes);
  return status;
}

/* The object's text, ended by a newline; NULL without memory. */
static char *text_of(json_t *object) {
  char *text = object != NULL ? json_dumps(object, JSON_INDENT(2)) : NULL, *line = NULL;
  if (text != NULL && (line = malloc(strlen(text) + 2)) != NULL) {
    strcpy(line, text);
    strcat(line, "\n");
  }
  free(text);
  return line;
}

int session_write_json(struct session *session, const char *path, json_t *object) {
  char *text = text_of(object);
  json_decref(object);
  int status = 0;
  if (text == NULL || session_json_refused())
    status = session_fail_with(session, "no memory for the JSON object");
  else if (strcmp(path, "-") != 0)
    status = session_write(session, path, text, strlen(text));
  else if (fputs(text, stdout) < 0 || fflush(stdout) != 0)
    status = session_fail_with(session, "standard output: cannot be written: %s", strerror(errno));
  free(text);
  return status;
}

int session_report(struct session *session, json_t *object) {
  if (session->json != NULL) return session_write_json(session, session->json, object);
  json_decref(object);
  return 0;
}

/* ---- small things ------------------------------------------------------------------------------------------------ */

static bool same_file(const char *one, const char *other) {
  struct stat a, b;
  return stat(one, &a) == 0 && stat(other, &b) == 0 && a.st_dev == b.st_dev && a.st_ino == b.st_ino;
}

static int keep_file(struct session *session, const char *input, const char *output) {
  if (!same_file(input, output)) return 0;
  return session_fail_with(session, "%s: is an input (%s), expected another name for the output", output, input);
}

bool session_lies_in(const char *output, const char *folder) {
  char own[4096] = ".";
  char *real = realpath(output, NULL);
  const char *place = real != NULL ? real : output, *slash = strrchr(place, '/');
  if (slash != NULL) snprintf(own, sizeof own, "%.*s", (int)(slash - place) + 1, place);
  free(real);
  return same_file(own, folder);
}

enum { PLACE_BYTES = 4096, MOST_LINKS = 40 };

/* The absolute path with symbolic links resolved; components that do not exist yet keep their names. False: it cannot
 * be resolved. */
static bool place_of(const char *path, char place[PLACE_BYTES]) {
  char at[PLACE_BYTES], target[PLACE_BYTES], *real = NULL;
  int bytes = snprintf(at, sizeof at, "%s", path);
  for (int links = 0; links < MOST_LINKS && bytes < PLACE_BYTES; links++) {
    const ssize_t length = readlink(at, target, sizeof target);
    if (length < 0 || length == sizeof target) break;
    const char *slash = strrchr(at, '/');
    const size_t folder = target[0] != '/' && slash != NULL ? (size_t)(slash - at) + 1 : 0;
    bytes = snprintf(at + folder, sizeof at - folder, "%.*s", (int)length, target) + (int)folder;
  }
  if (bytes >= PLACE_BYTES) return false;
  size_t keep = strlen(at); /* length of the part of `at` that is an existing folder */
  do {
    while (keep > 0 && at[keep - 1] != '/') keep--;
    const char *rest = at + keep;
    snprintf(target, sizeof target, "%.*s", (int)keep, keep > 0 ? at : "");
    if ((real = realpath(keep > 0 ? target : ".", NULL)) != NULL)
      bytes = snprintf(place, PLACE_BYTES, "%s/%s", real, rest);
    else if (keep > 0)
      keep--;
  } while (real == NULL && keep > 0);
  const bool found = real != NULL && bytes < PLACE_BYTES;
  free(real);
  return found;
}

int session_check_distinct_output(struct session *session, const char *output) {
  char place[PLACE_BYTES] = "", node[64] = "";
  const char *const keys[] = {place, node};
  struct stat about;
  if (session->outputs == NULL) session->outputs = json_object();
  if (!place_of(output, place)) place[0] = 0;
  if (stat(output, &about) == 0)
    snprintf(node, sizeof node, "%ju:%ju", (uintmax_t)about.st_dev, (uintmax_t)about.st_ino);
  for (size_t i = 0; i < 2; i++) {
    const char *other = json_string_value(json_object_get(session->outputs, keys[i]));
    if (other != NULL)
      return session_fail_with(session, "%s: is the same file as %s, which is an output too; expected another name",
                               output, other);
  }
  for (size_t i = 0; i < 2; i++)
    if (keys[i][0] != 0 && json_object_set_new_nocheck(session->outputs, keys[i], json_string_nocheck(output)) != 0)
      return session_fail_with(session, "no memory for the names of outputs");
  return 0;
}

int session_check_json_not_input(struct session *session, const char *folder) {
  char place[PLACE_BYTES], inside[PLACE_BYTES], name[PLACE_BYTES];
  if (session->json == NULL || session_json_on_stdout(session)) return 0;
  if (snprintf(name, sizeof name, "%s/.", folder) >= (int)sizeof name) return 0;
  if (!place_of(session->json, place) || !place_of(name, inside)) return 0;
  inside[strlen(inside) - 1] = 0; /* "FOLDER/" */
  if (strncmp(place, inside, strlen(inside)) != 0) return 0;
  return session_fail_with(session, "%s: is in %s, whose files are written too; expected another folder for --json",
                           session->json, folder);
}

static int keep_clip(struct session *session, const char *clip, const char *output) {
  char path[4096];
  for (size_t i = 0; ern_clip_content(i) != NULL; i++) {
    if (snprintf(path, sizeof path, "%s/%s", clip, ern_clip_content(i)) >= (int)sizeof path)
      continue; /* not openable */
    if (keep_file(session, path, output) != 0) return EXIT_FAILURE;
    if (session_lies_in(output, path))
      return session_fail_with(session, "%s: is among the clip's pictures in %s, expected another folder", output,
                               path);
  }
  return 0;
}

static bool is_clip_content(const char *name) {
  size_t i = 0;
  while (ern_clip_content(i) != NULL && strcmp(ern_clip_content(i), name) != 0) i++;
  return ern_clip_content(i) != NULL;
}

static bool is_clip(const char *folder) {
  char train[PLACE_BYTES + 32];
  return snprintf(train, sizeof train, "%s/transforms_train.json", folder) < (int)sizeof train &&
         access(train, F_OK) == 0;
}

/* Fails if `output` is there and is CLIP/FILE or CLIP/FOLDER/PICTURE of a clip, whether the verb reads that or not. */
static int keep_any_clip(struct session *session, const char *output) {
  char place[PLACE_BYTES], *slash;
  if (access(output, F_OK) != 0 || !place_of(output, place)) return 0;
  for (int up = 0; up < 2 && (slash = strrchr(place, '/')) != NULL; up++) {
    const bool made = session->makes_features && strstr(slash, ".npy") != NULL;
    *slash = 0;
    if (!made && is_clip_content(slash + 1) && is_clip(place))
      return session_fail_with(session, "%s: is a part of the clip %s, expected another name for the output", output,
                               place);
  }
  return 0;
}

int session_check_not_input(struct session *session, const char *input, const char *output) {
  struct stat about;
  if (input == NULL || output == NULL || stat(input, &about) != 0) return 0;
  if (!S_ISDIR(about.st_mode)) return keep_file(session, input, output);
  if (is_clip(input) || access(output, F_OK) != 0 || !session_lies_in(output, input))
    return keep_clip(session, input, output);
  return session_fail_with(session, "%s: is in %s and is an input, expected another name", output, input);
}

int session_check_not_inputs(struct session *session, const char *output) {
  int status = 0;
  for (size_t i = 0; status == 0 && i < SESSION_INPUTS; i++)
    status = session_check_not_input(session, session->inputs[i], output);
  return status;
}

int session_check_folder_has_no_input(struct session *session, const char *folder) {
  for (size_t i = 0; i < SESSION_INPUTS; i++)
    if (session->inputs[i] != NULL && session_lies_in(session->inputs[i], folder))
      return session_fail_with(session,
                               "%s: is an input in %s, whose files this training replaces; expected another -o",
                               session->inputs[i], folder);
  return 0;
}

int session_check_inputs_kept(struct session *session) {
  for (size_t i = 0; i < SESSION_INPUTS; i++) {
    struct stat now;
    const struct stat *then = &session->seen[i];
    see_file(session->inputs[i], &now);
    if (now.st_dev != then->st_dev || now.st_ino != then->st_ino || now.st_size != then->st_size ||
        now.st_mtim.tv_sec != then->st_mtim.tv_sec || now.st_mtim.tv_nsec != then->st_mtim.tv_nsec)
      return session_fail_with(session, "%s: was changed while it was read, expected a file that stays the same",
                               session->inputs[i]);
  }
  return 0;
}

bool session_skips_link(struct session *session, const char *path) {
  struct stat about;
  if (lstat(path, &about) != 0 || !S_ISLNK(about.st_mode)) return false;
  session_warn(session, "%s: is a symbolic link, nothing is written to it", path);
  return true;
}

bool session_keeps_file(struct session *session, const char *path) {
  struct stat about;
  if (session_skips_link(session, path)) return true;
  if (session->overwrite || lstat(path, &about) != 0) return false;
  session_note(session, "%s: is there already and is kept; --overwrite replaces it", path);
  return true;
}

bool session_folder_there(const char *path) {
  char folder[4096];
  struct stat about;
  const char *slash = strrchr(path, '/');
  if (slash == NULL || slash == path) return true;
  if (snprintf(folder, sizeof folder, "%.*s", (int)(slash - path), path) >= (int)sizeof folder) return false;
  return stat(folder, &about) == 0 && S_ISDIR(about.st_mode);
}

int session_check_output(struct session *session, const char *path) {
  struct stat about;
  if (!session_folder_there(path)) return session_fail_with(session, "%s: its folder is not there", path);
  if (session_check_not_inputs(session, path) != 0 || session_check_distinct_output(session, path) != 0)
    return EXIT_FAILURE;
  if (session->overwrite && keep_any_clip(session, path) != 0) return EXIT_FAILURE;
  if (!session->overwrite && stat(path, &about) == 0 && S_ISREG(about.st_mode))
    return session_fail_with(session, "%s: is there already; --overwrite (-y) replaces it", path);
  return ern_file_check_output(session->context, path) == ERN_OK ? 0 : session_fail(session);
}

int session_check_outputs(struct session *session, const char *folder, const char *const *names, size_t count) {
  char path[4096];
  struct stat about;
  const bool there = stat(folder, &about) == 0 && S_ISDIR(about.st_mode);
  for (size_t i = 0; i < count; i++) {
    if (snprintf(path, sizeof path, "%s/%s", folder, names[i]) >= (int)sizeof path)
      return session_fail_with(session, "%s: the name is too long", folder);
    const int status = there ? session_check_output(session, path) : session_check_distinct_output(session, path);
    if (status != 0) return EXIT_FAILURE;
  }
  return 0;
}

int session_check_training(struct session *session, const char *path) {
  char folder[4096], place[PLACE_BYTES]; /* a link is followed */
  if (!session_folder_there(path) || !place_of(path, place) || !session_folder_there(place))
    return session_fail_with(session, "%s: its folder is not there", path);
  if (session_check_not_inputs(session, path) != 0 || session_check_distinct_output(session, path) != 0)
    return EXIT_FAILURE;
  if (snprintf(folder, sizeof folder, "%.*s.run", (int)(strlen(path) - strlen(".safetensors")), path) >=
      (int)sizeof folder)
    return session_fail_with(session, "%s: the name is too long", path);
  return session_check_json_not_input(session, folder);
}

int session_folder(struct session *session, const char *path) {
  struct stat about;
  if (mkdir(path, 0777) != 0 && errno != EEXIST)
    return session_fail_with(session, "%s: cannot be made: %s", path, strerror(errno));
  if (stat(path, &about) != 0 || !S_ISDIR(about.st_mode)) return session_fail_with(session, "%s: is no folder", path);
  if (access(path, W_OK | X_OK) != 0)
    return session_fail_with(session, "%s: cannot be written into: %s", path, strerror(errno));
  return 0;
}
