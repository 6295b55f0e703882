/* SPDX-License-Identifier: MIT */
#include "lab/compare_files.h"

#include <dirent.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "lab/compare_page.h"
#include "output/plot.h"

enum { PATH_BYTES = 4096, COLUMNS = 2 * COMPARE_SIDES + 1 };

/* compare.json marks a folder of this program, so it comes first: a folder with any of the files has it. The last two
 * belong to a running comparison: the growing video, and the marker of a folder without compare.json, which is created
 * before the video and removed after all files are renamed. */
static const char *const names[] = {"compare.json", "frames.csv",  "best.png",        "median.png",   "worst.png",
                                    "index.html",   "compare.mp4", "compare.mp4.new", "compare.begun"};
enum { NAMES = sizeof names / sizeof *names, MARK = 0, CSV = 1, PAGE = 5, VIDEO = 6, GROWING = 7, BEGUN = 8 };
/* The member "format" of the two markers. */
static const char whole_format[] = "ernerf.compare", begun_format[] = "ernerf.compare.begun";
/* The temporary file of the video's writer (base.h, "How files are written"). */
#define GROWING_TEMPORARY "compare.mp4.new.ernerf-tmp"

static int path_in(struct compare *c, const char *name, char path[PATH_BYTES]) {
  if (snprintf(path, PATH_BYTES, "%s/%s", c->folder, name) < PATH_BYTES) return 0;
  return session_fail_with(&c->session, "%s: the name is too long", c->folder);
}

/* ---- before ------------------------------------------------------------------------------------------------------ */

/* Whether the name is a temporary file that a killed writer left; the next writer of that file checks that it is stale.
 */
static bool is_left_over(const char *name) {
  static const char suffix[] = ".ernerf-tmp";
  for (size_t i = 0; i < NAMES; i++) {
    const size_t length = strlen(names[i]);
    if (strncmp(name, names[i], length) == 0 && strcmp(name + length, suffix) == 0) return true;
  }
  return false;
}

/* Number of files in the folder, without leftovers; -1: it cannot be read. */
static long count_files(const char *folder) {
  DIR *list = opendir(folder);
  long count = 0;
  if (list == NULL) return -1;
  for (struct dirent *entry = readdir(list); entry != NULL; entry = readdir(list))
    count += strcmp(entry->d_name, ".") != 0 && strcmp(entry->d_name, "..") != 0 && !is_left_over(entry->d_name);
  closedir(list);
  return count;
}

/* Whether the parent of `folder` exists. */
static bool parent_exists(const char *folder) {
  char path[PATH_BYTES];
  size_t length = strlen(folder);
  while (length > 1 && folder[length - 1] == '/') length--;
  return snprintf(path, sizeof path, "%.*s", (int)length, folder) < PATH_BYTES && session_folder_there(path);
}

static bool is_mark(const char *path, const char *wanted) {
  struct stat about;
  if (stat(path, &about) != 0 || !S_ISREG(about.st_mode)) return false;
  json_t *root = json_load_file(path, 0, NULL);
  const char *format = json_string_value(json_object_get(root, "format"));
  const bool ours = format != NULL && strcmp(format, wanted) == 0;
  json_decref(root);
  return ours;
}

int compare_files_check(struct compare *c) {
  struct session *session = &c->session;
  struct stat about;
  char mark[PATH_BYTES], begun[PATH_BYTES];
  if (path_in(c, names[MARK], mark) != 0 || path_in(c, names[BEGUN], begun) != 0) return EXIT_FAILURE;
  const bool killed = !is_mark(mark, whole_format) && is_mark(begun, begun_format);
  if (stat(c->folder, &about) == 0) {
    if (!S_ISDIR(about.st_mode)) return session_fail_with(session, "%s: is no folder", c->folder);
    const long files = count_files(c->folder);
    if (files < 0) return session_fail_with(session, "%s: cannot be read: %s", c->folder, strerror(errno));
    if (files > 0 && !killed && !is_mark(mark, whole_format))
      return session_fail_with(
          session, "%s: holds files that ernerf compare did not make, expected a new or an empty folder", c->folder);
  } else if (!parent_exists(c->folder)) {
    return session_fail_with(session, "%s: the folder around it does not exist", c->folder);
  }
  /* compare_files_open removes the video of a killed comparison */
  if (session_check_outputs(session, c->folder, names, killed ? GROWING : BEGUN) != 0) return EXIT_FAILURE;
  return session_check_json_not_input(session, c->folder);
}

/* Creates the marker in a folder without compare.json. *killed: a killed comparison left the marker; its video is
 * removed. */
static int begin(struct compare *c, bool *killed) {
  char mark[PATH_BYTES], begun[PATH_BYTES], video[PATH_BYTES];
  struct stat about;
  if (path_in(c, names[MARK], mark) != 0 || path_in(c, names[BEGUN], begun) != 0 ||
      path_in(c, names[GROWING], video) != 0)
    return EXIT_FAILURE;
  *killed = is_mark(begun, begun_format);
  if (*killed && lstat(video, &about) == 0 && S_ISREG(about.st_mode)) (void)unlink(video);
  if (*killed || is_mark(mark, whole_format)) return 0;
  c->begun = true; /* also after an error: the file may exist while its folder was not flushed */
  return session_write_json(&c->session, begun, json_pack("{s:s}", "format", begun_format));
}

int compare_files_open(struct compare *c) {
  struct session *session = &c->session;
  const struct evaluation *evaluation = &c->side[0].evaluation;
  char path[PATH_BYTES], sound[PATH_BYTES];
  bool killed = false;
  const bool fits = snprintf(sound, sizeof sound, "%s/aud.wav", c->asked.source.path) < PATH_BYTES;
  if (path_in(c, names[GROWING], path) != 0) return EXIT_FAILURE;
  if (evaluation->info.width > ERN_IMAGE_MAX_SIDE / COLUMNS)
    return session_fail_with(session, "%s: frames are %d wide, expected %d at most, for %d of them side by side",
                             c->asked.source.path, evaluation->info.width, ERN_IMAGE_MAX_SIDE / COLUMNS, (int)COLUMNS);
  c->made_folder = access(c->folder, F_OK) != 0;
  if (session_folder(session, c->folder) != 0 || begin(c, &killed) != 0) return EXIT_FAILURE;
  if (comparison_open(&c->comparison, evaluation, COMPARE_SIDES, path, fits ? sound : NULL) != 0) return EXIT_FAILURE;
  c->begun |= killed; /* no other process writes the video, so this one removes the marker */
  if (path_in(c, GROWING_TEMPORARY, path) != 0) return EXIT_FAILURE;
  return stat(path, &c->video) == 0 ? 0 : session_fail_with(session, "%s: cannot be read: %s", path, strerror(errno));
}

/* ---- after ------------------------------------------------------------------------------------------------------- */

/* A PNG of A, B, the recorded frame and 4 times the differences from it. */
static int write_picture(struct compare *c, size_t shown) {
  struct session *session = &c->session;
  const struct source_frame *frame = compare_frame(c, c->shown[shown]);
  const int width = c->side[0].evaluation.info.width, height = c->side[0].evaluation.info.height;
  const uint8_t *drawn[COMPARE_SIDES];
  struct bytes png = {0};
  char name[32];
  ern_image truth = {0};
  for (size_t side = 0; side < COMPARE_SIDES; side++) {
    struct evaluated evaluated;
    if (compare_side_draw(&c->side[side], c->shown[shown], &evaluated) != 0) return EXIT_FAILURE;
    drawn[side] = c->side[side].evaluation.rgba;
  }
  if (ern_clip_pixels(c->side[0].evaluation.clip, frame->split, frame->index, &truth, NULL) != ERN_OK)
    return session_fail(session);
  uint8_t *rgb = malloc(3 * COLUMNS * (size_t)width * (size_t)height);
  if (rgb == NULL)
    return session_fail_with(session, "no memory for a picture of %d x %d", (int)COLUMNS * width, height);
  frame_figures_row(rgb, drawn, COMPARE_SIDES, truth.data, (size_t)width, (size_t)height);
  png.failed = plot_png(rgb, (int)COLUMNS * width, height, &png) != 0;
  free(rgb);
  snprintf(name, sizeof name, "%s.png", compare_shown_names[shown]);
  return session_write_in(session, c->folder, name, &png);
}

static int read_file(struct session *session, const char *path, struct bytes *bytes) {
  char part[65536];
  struct stat about;
  FILE *file = fopen(path, "rb");
  if (file == NULL) return session_fail_with(session, "%s: cannot be opened: %s", path, strerror(errno));
  for (size_t count = 1; count > 0 && !bytes->failed;) {
    count = fread(part, 1, sizeof part, file);
    bytes_add(bytes, part, count);
  }
  const bool whole = !ferror(file) && fstat(fileno(file), &about) == 0 && (size_t)about.st_size == bytes->count;
  fclose(file);
  return whole || bytes->failed ? 0 : session_fail_with(session, "%s: cannot be read to its end", path);
}

/* Completes the video, and adds it to the files that are renamed together. */
static int write_video(struct compare *c) {
  struct bytes bytes = {0};
  char path[PATH_BYTES];
  if (path_in(c, names[GROWING], path) != 0 || comparison_finish(&c->comparison) != 0) return EXIT_FAILURE;
  if (read_file(&c->session, path, &bytes) == 0) return session_write_in(&c->session, c->folder, names[VIDEO], &bytes);
  bytes_free(&bytes);
  return EXIT_FAILURE;
}

static int make_files(struct compare *c) {
  struct session *session = &c->session;
  struct bytes csv = {0}, page = {0};
  char mark[PATH_BYTES];
  int status = path_in(c, names[MARK], mark);
  if (status == 0) status = session_write_json(session, mark, compare_json(c));
  if (status == 0) {
    compare_csv(c, &csv);
    status = session_write_in(session, c->folder, names[CSV], &csv);
  }
  for (size_t i = 0; i < COMPARE_SHOWN && status == 0; i++) status = write_picture(c, i);
  if (status == 0) {
    compare_page(c, &page);
    status = session_write_in(session, c->folder, names[PAGE], &page);
  }
  return status == 0 ? write_video(c) : status;
}

int compare_files_write(struct compare *c) {
  session_stage(&c->session);
  return session_write_staged(&c->session, make_files(c));
}

void compare_files_close(struct compare *c, bool done) {
  char path[PATH_BYTES];
  struct stat about;
  comparison_close(&c->comparison);
  if (c->video.st_ino != 0 && path_in(c, names[GROWING], path) == 0 && lstat(path, &about) == 0 &&
      about.st_dev == c->video.st_dev && about.st_ino == c->video.st_ino) /* the file of that name is this video */
    (void)unlink(path);
  if (c->begun && path_in(c, names[BEGUN], path) == 0) (void)unlink(path);
  if (c->made_folder && !done) (void)rmdir(c->folder); /* fails if the folder is not empty */
}
