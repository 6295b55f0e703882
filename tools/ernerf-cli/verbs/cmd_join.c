/* SPDX-License-Identifier: MIT
 * ernerf join: joins videos of successive frames, as `render --frames A:B` writes them, to one video. */
#include <dirent.h>
#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "ernerf/media.h"
#include "output/provenance_output.h"
#include "verbs.h"

enum { OWN_OPTIONS = 3, PATH_BYTES = 4096 };

struct join_job {
  struct session session;
  const char *folder, *out, *wav;
  double start; /* start in the sound, seconds; below 0: by the first segment's provenance file */
  char **segments;
  size_t count;
  json_t *says; /* [count] provenance file of each segment (provenance_read), null: none */
  ern_sound sound;
  struct provenance provenance;
};

/* Digits at `text` without leading zeros, and their number. */
static const char *digits_of(const char *text, size_t *count) {
  static const char digits[] = "0123456789";
  text += strspn(text, "0");
  *count = strspn(text, digits);
  return text;
}

/* Numbers in names are compared as numbers: part2 comes before part10. */
static int by_name(const void *left, const void *right) {
  const char *a = *(char *const *)left, *b = *(char *const *)right;
  while (*a != 0 && *b != 0) {
    size_t a_digits = 0, b_digits = 0;
    const char *a_number = digits_of(a, &a_digits), *b_number = digits_of(b, &b_digits);
    if (a_number + a_digits == a || b_number + b_digits == b) { /* one is no number */
      if (*a != *b) break;
      a++, b++;
      continue;
    }
    if (a_digits != b_digits) return a_digits < b_digits ? -1 : 1;
    const int order = strncmp(a_number, b_number, a_digits);
    if (order != 0) return order;
    a = a_number + a_digits, b = b_number + b_digits;
  }
  return *a != *b ? (unsigned char)*a - (unsigned char)*b : strcmp(*(char *const *)left, *(char *const *)right);
}

static int add_segment(struct join_job *job, const char *name) {
  char path[PATH_BYTES];
  char **more = realloc(job->segments, (job->count + 1) * sizeof *more);
  if (more == NULL || snprintf(path, sizeof path, "%s/%s", job->folder, name) >= (int)sizeof path)
    return session_fail_with(&job->session, "%s: no memory for its names, or one is too long", job->folder);
  job->segments = more;
  job->segments[job->count] = strdup(path);
  return job->segments[job->count++] != NULL ? 0 : session_fail_with(&job->session, "no memory");
}

/* Lists the videos of the folder, in the order of their names. */
static int list_segments(struct join_job *job) {
  DIR *list = opendir(job->folder);
  int status = list != NULL ? 0 : session_fail_with(&job->session, "%s: is no folder that can be read", job->folder);
  for (struct dirent *entry = list != NULL ? readdir(list) : NULL; entry != NULL && status == 0;
       entry = readdir(list)) {
    const char *dot = strrchr(entry->d_name, '.');
    if (entry->d_name[0] != '.' && dot != NULL && strcasecmp(dot, ".mp4") == 0)
      status = add_segment(job, entry->d_name);
  }
  if (list != NULL) closedir(list);
  if (status == 0 && job->count == 0)
    status = session_fail_with(&job->session, "%s: has no .mp4, expected those of render --frames A:B", job->folder);
  if (status == 0) qsort(job->segments, job->count, sizeof *job->segments, by_name);
  return status;
}

/* Reads the provenance files of the segments. The joined video gets one if any segment has one. */
static int read_says(struct join_job *job) {
  job->says = json_array();
  job->provenance.off = true;
  for (size_t k = 0; k < job->count; k++) {
    json_t *says = NULL;
    if (provenance_read(&job->session, job->segments[k], &says) != 0) {
      json_decref(says);
      return EXIT_FAILURE;
    }
    if (says != NULL) job->provenance.off = false;
    if (json_array_append_new(job->says, says != NULL ? says : json_null()) != 0)
      return session_fail_with(&job->session, "no memory");
  }
  return 0;
}

/* Reads the frame range [*first, *end) of a segment from its provenance file. False: not there. */
static bool frames_of(const json_t *about, json_int_t *first, json_int_t *end, double *rate) {
  const json_t *from = json_object_get(about, "first_frame"), *count = json_object_get(about, "frames");
  const char *words = json_string_value(json_object_get(about, "rate"));
  const json_int_t most = 1000000000; /* the file may hold any number, and numbers are added below */
  double whole = 0, part = 1;
  *first = json_integer_value(from);
  *end = *first;
  const bool known = json_is_integer(from) && json_is_integer(count) && *first >= 0 && *first <= most &&
                     json_integer_value(count) >= 0 && json_integer_value(count) <= most && words != NULL &&
                     sscanf(words, "%lf/%lf", &whole, &part) >= 1 && whole > 0 && part > 0;
  if (known) *end += json_integer_value(count);
  *rate = whole / part;
  return known;
}

/* Checks that no frame is missing or repeated, as far as the provenance files tell. */
static int check_frames(struct join_job *job) {
  json_int_t first = 0, end = 0, before = 0;
  double rate = 0;
  bool known = false;
  for (size_t k = 0; k < job->count; k++, before = end) {
    const bool was_known = known;
    known = frames_of(json_array_get(job->says, k), &first, &end, &rate);
    if (k == 0 && job->start < 0) job->start = known ? (double)first / rate : 0;
    if (!known)
      session_warn(&job->session, "%s: no file beside it (.provenance.json) says which frames it has; %s%s",
                   job->segments[k], k == 0 ? "they are taken as the first" : "they are taken to follow those of ",
                   k == 0 ? "" : job->segments[k - 1]);
    if (k > 0 && known && was_known && first != before)
      return session_fail_with(&job->session, "%s: begins with frame %lld, expected %lld, which follows those of %s",
                               job->segments[k], (long long)first, (long long)before, job->segments[k - 1]);
  }
  return 0;
}

/* Members of the joined video's provenance file, in addition to those of the segments. */
static json_t *about_output(const struct join_job *job) {
  const char *slash = strrchr(job->out, '/');
  json_int_t first = 0, end = 0, frames = 0, begin = 0;
  double rate = 0;
  bool known = true;
  for (size_t k = 0; k < job->count; k++, frames += end - first) {
    known &= frames_of(json_array_get(job->says, k), &first, &end, &rate);
    if (k == 0) begin = first;
  }
  return json_pack("{s:o, s:o, s:o}", "output", session_text(slash != NULL ? slash + 1 : job->out), "first_frame",
                   known ? json_integer(begin) : json_null(), "frames", known ? json_integer(frames) : json_null());
}

static int join(struct join_job *job) {
  struct session *session = &job->session;
  int status = session_check_output(session, job->out);
  if (status == 0) status = list_segments(job);
  for (size_t k = 0; k < job->count && status == 0; k++)
    status = session_check_not_input(session, job->segments[k], job->out);
  if (status == 0) status = read_says(job);
  if (status == 0) status = provenance_check(&job->provenance, session, job->out);
  if (status == 0) status = check_frames(job);
  if (status == 0 && job->wav != NULL && ern_sound_read(session->context, job->wav, &job->sound) != ERN_OK)
    status = session_fail(session);
  if (status == 0) status = provenance_join(&job->provenance, session, job->segments, job->says, job->wav);
  if (status != 0) return status;
  if (ern_video_join(session->context, job->out, (const char *const *)job->segments, job->count,
                     job->wav != NULL ? &job->sound : NULL, job->start) != ERN_OK)
    return session_fail(session);
  if (provenance_write(&job->provenance, session, about_output(job)) != 0) return EXIT_FAILURE;
  session_note(session, "%s: %zu videos of %s, %s", job->out, job->count, job->folder,
               job->wav != NULL ? "with one sound over all of them" : "without sound; --wav gives it one");
  return session_report(
      session, json_pack("{s:o, s:I, s:b, s:o}", "output", session_text(job->out), "videos", (json_int_t)job->count,
                         "sound", job->wav != NULL, "sound_start", session_number(job->start)));
}

int cmd_join(int argc, char **argv) {
  struct join_job job = {.start = -1};
  struct option own[OWN_OPTIONS], output[SESSION_OUTPUT_OPTIONS];
  struct word words[] = {
      {"FOLDER", &job.folder,
       "folder of the .mp4 files, which follow each other in the order of their names (part2 before part10)"}};
  const struct option rows[] = {
      {ARGS_TEXT("o", &job.out), .alias = "output", .choices = "OUT.mp4", .help = "the joined video"},
      {ARGS_TEXT("wav", &job.wav), .choices = "SOUND",
       .help = "sound of the joined video, encoded once; that of the segments is left out"},
      {ARGS_SECONDS("wav-start", &job.start, 0, 1e6),
       .help = "where the first frame is in that sound (default: by the number of the frame, which the "
               ".provenance.json beside the first segment has; else 0)"}};
  struct args args = {.verb = "join",
                      .summary = "Makes one video of those that `render --frames A:B` wrote, without re-encoding them.",
                      .usage = "join FOLDER [--wav SOUND] -o OUT.mp4",
                      .words = words,
                      .word_count = 1,
                      .groups = {{"What is made:", own, OWN_OPTIONS}, {"Output:", output, SESSION_OUTPUT_OPTIONS}}};
  ARGS_FILL(own, rows, OWN_OPTIONS);
  session_output_options(&job.session, output);
  int status = args_parse(&args, argc, argv);
  if (status < 0 && job.out == NULL) status = args_refuse(&args, "-o OUT.mp4 is missing");
  if (status < 0 && job.wav == NULL) status = args_forbid(&args, "wav-start", "is about the sound of --wav");
  const char *dot = job.out != NULL ? strrchr(job.out, '.') : NULL;
  if (status < 0 && (dot == NULL || strcasecmp(dot, ".mp4") != 0))
    status = args_refuse(&args, "-o is \"%s\", expected a name that ends in .mp4", job.out);
  job.session.inputs[0] = job.wav;
  job.session.inputs[1] = job.folder; /* with its provenance files */
  if (status < 0) status = session_open(&job.session, &args);
  if (status >= 0) return status;
  status = join(&job);
  for (size_t k = 0; k < job.count; k++) free(job.segments[k]);
  free(job.segments);
  json_decref(job.says);
  provenance_free(&job.provenance);
  ern_sound_free(job.session.context, &job.sound);
  session_close(&job.session);
  return status;
}
