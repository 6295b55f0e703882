/* SPDX-License-Identifier: MIT
 * Which folder includes which: every #include of include/, src/, tools/ and examples/ against the folders of
 * docs/architecture.md. The rules stand in the tables below; a folder without a rule fails. */
#include <fnmatch.h>
#include <stdbool.h>
#include <sys/stat.h>

#include "../support.h"

enum { PATH_BYTES = 1024, LINE_BYTES = 512, ALLOWED = 20 };

/* Patterns are fnmatch's without FNM_PATHNAME: a star matches slashes too. */
struct rule {
  const char *folder;           /* as written in includes: below src/, or "include", "tools", "examples"; a room */
  const char *allowed[ALLOWED]; /* what a quoted include may name, besides the folder itself */
};

/* Types and signatures of operations: the backends, which fill the table, need those of every folder; other folders
 * see those of their own and of the folders to their left. They see core/types.h, core/operations.h and those of their
 * own folder. */
#define OPS "*/*_ops.h"
#define BELOW_MODEL "ernerf/*", "core/*", "io/*", "hashgrid/*", "mlp/*"
/* What a backend fills its table with: operations, and the stages behind the fused slots. */
#define FILLS "ernerf/*", "core/*", OPS, "model/field.h", "mlp/mlp_tile.h", "render/stages.h", "train/step.h"

static const struct rule rules[] = {
    {"include", {"ernerf/*"}},
    {"core", {"ernerf/*"}},
    {"io", {"ernerf/*", "core/*"}},
    {"hashgrid", {"ernerf/*", "core/*"}},
    {"mlp", {"ernerf/*", "core/*"}},
    {"model", {BELOW_MODEL}},
    {"render", {BELOW_MODEL, "model/*"}},
    {"train", {BELOW_MODEL, "model/*", "render/*"}},
    {"train/parts", /* of a training: they do not know the trainer that calls them */
     {BELOW_MODEL, "model/*", "render/*", "train/parts/*", "train/*_ops.h", "train/patch_filter.h",
      "train/run_folder.h", "train/state_about.h", "train/step.h"}},
    {"backend_cpu", {FILLS}},
    {"backend_opencl", {FILLS, "io/file.h", "model/parameters.h"}},
    {"backend", {"ernerf/*", "core/*", "backend_*/*"}},
    {"vision", {"ernerf/*"}},
    {"perceptual", {"ernerf/*"}},
    {"mpi", {"ernerf/*"}},
    {"serve", {"ernerf/*"}},
    {"media", {"ernerf/*", "core/*", "io/*", "vision/*", "perceptual/*"}},
    {"prepare", {"ernerf/*", "core/*", "io/*", "media/speech_network.h"}},
    {"lab", {BELOW_MODEL, "model/*", "render/*", "train/*", "backend_cpu/*", "backend_opencl/*", "ernerf-lab/*"}},
    {"tools", {"ernerf/*"}},
    /* the rooms of the program; each also sees the headers beside main.c, which see no room */
    {"tools/session", {"ernerf/*"}},
    {"tools/output", {"ernerf/*", "session/*"}},
    {"tools/dub", {"ernerf/*", "session/*", "output/*"}},
    {"tools/live", {"ernerf/*", "session/*", "output/*", "dub/*"}},
    {"tools/serve", {"ernerf/*", "session/*", "output/*", "live/*"}},
    {"tools/evaluation", {"ernerf/*", "ernerf-lab/*", "session/*", "dub/*"}},
    {"tools/lab", {"ernerf/*", "ernerf-lab/*", "session/*", "output/*", "evaluation/*"}},
    {"tools/verbs", {"ernerf/*", "ernerf-lab/*", "session/*", "output/*", "evaluation/*", "mpi/mpi_world.h"}},
    {"tools/main", {"ernerf/*", "session/session.h"}},
    {"examples", {"ernerf/*"}},
};

/* Headers from outside that only some folders may see; all else between angle brackets is the C library's. */
static const struct {
  const char *header;
  const char *folders[7];
} outside[] = {
    {"jansson.h", {"io", "model", "train", "lab", "prepare", "serve", "tools"}},
    {"microhttpd.h", {"serve"}},
    {"gst/*", {"serve"}},
    {"zip.h", {"io"}},
    {"CL/*", {"backend_opencl", "tools"}},
    {"*intrin.h", {"backend_cpu"}},
    {"opencv2/*", {"media", "vision", "prepare"}},
    {"oneapi/dnnl/*", {"perceptual"}},
    {"mpi.h", {"mpi"}},
    {"ceres/*", {"prepare"}},
    {"Eigen/*", {"prepare"}},
    {"OpenImageIO/*", {"media"}},
    {"arpa/inet.h", {"media", "serve"}},
    {"libav*", {"media"}},
    {"libsw*", {"media"}},
    {"espeak-ng/*", {"lab"}},
    {"cairo*.h", {"tools"}},
    {"fontconfig/*", {"tools"}},
    {"ernerf/*", {"tools", "examples"}},
};

struct tally {
  size_t files, includes, faults;
  char text[8192]; /* the faults */
};

static void fault(struct tally *tally, const char *path, int line, const char *what, const char *header) {
  const size_t used = strlen(tally->text);
  tally->faults++;
  snprintf(tally->text + used, sizeof tally->text - used, "\n  %s:%d: %s %s", path, line, what, header);
}

static const struct rule *rule_of(const char *folder) {
  for (size_t i = 0; i < sizeof rules / sizeof *rules; i++)
    if (strcmp(rules[i].folder, folder) == 0) return &rules[i];
  return NULL;
}

/* NULL where `header`, written in a file `name` of `folder`, is fine; else what is wrong. */
static const char *check_quoted(const char *folder, const char *name, const char *header) {
  const struct rule *rule = rule_of(folder);
  if (rule == NULL) return "no rule for the folder";
  const char *room = strchr(folder, '/'), *here = room != NULL ? room + 1 : folder;
  const size_t length = strlen(here);
  const bool own = strncmp(header, here, length) == 0 && header[length] == '/';
  if (fnmatch("*_ops.h", name, 0) == 0)
    return strcmp(header, "core/types.h") == 0 || strcmp(header, "core/operations.h") == 0 ||
                   (own && fnmatch(OPS, header, 0) == 0)
               ? NULL
               : "an _ops.h includes";
  if (strcmp(folder, "backend") == 0 && strcmp(name, "registry.c") != 0 && fnmatch("backend_*", header, 0) == 0)
    return "only registry.c names backends, found";
  if (strchr(header, '/') == NULL) /* beside the file itself: the program's own headers have no folder in their name */
    return strncmp(folder, "tools", 5) == 0 ? NULL : "no folder in the include of";
  if (own || strcmp(header, "core/interface_version.h") == 0) return NULL; /* a constant of the whole source */
  for (size_t i = 0; i < ALLOWED && rule->allowed[i] != NULL; i++)
    if (fnmatch(rule->allowed[i], header, 0) == 0) return NULL;
  return "may not see";
}

static const char *check_bracketed(const char *folder, const char *header) {
  for (size_t i = 0; i < sizeof outside / sizeof *outside; i++) {
    if (fnmatch(outside[i].header, header, 0) != 0) continue;
    for (size_t k = 0; k < 7 && outside[i].folders[k] != NULL; k++)
      if (strcmp(outside[i].folders[k], folder) == 0) return NULL;
    return "may not see";
  }
  return strchr(header, '/') == NULL || strncmp(header, "sys/", 4) == 0 ? NULL : "no rule for";
}

/* `header` and which bracket, out of a line; false where the line includes nothing. */
static bool parse_include(const char *line, char header[LINE_BYTES], char *bracket) {
  line += strspn(line, " \t");
  if (*line++ != '#') return false;
  line += strspn(line, " \t");
  if (strncmp(line, "include", 7) != 0) return false;
  line += 7 + strspn(line + 7, " \t");
  *bracket = *line;
  if (*bracket != '"' && *bracket != '<') return false;
  const size_t length = strcspn(line + 1, *bracket == '"' ? "\"" : ">");
  memcpy(header, line + 1, length);
  header[length] = 0;
  return true;
}

/* The room of a file of the program, "tools/" and a folder's name, or "train/parts"; otherwise its folder. */
static void name_room(const char *path, const char *folder, const char *name, char room[64]) {
  static const char program[] = "/tools/ernerf-cli/";
  const char *inside = strstr(path, program);
  const char *at = inside != NULL ? inside + sizeof program - 1 : NULL, *end = at != NULL ? strchr(at, '/') : NULL;
  const bool is_main = at != NULL && strcmp(name, "main.c") == 0;
  if (end != NULL || is_main)
    snprintf(room, 64, "tools/%.*s", end != NULL ? (int)(end - at) : 4, at);
  else
    snprintf(room, 64, "%s", strstr(path, "/src/train/parts/") != NULL ? "train/parts" : folder);
}

static void check_file(struct tally *tally, const char *path, const char *folder, const char *name) {
  char line[LINE_BYTES], header[LINE_BYTES], room[64], bracket = 0;
  FILE *file = fopen(path, "rb");
  assert_non_null(file);
  tally->files++;
  name_room(path, folder, name, room);
  for (int number = 1; fgets(line, sizeof line, file) != NULL; number++) {
    if (!parse_include(line, header, &bracket)) continue;
    tally->includes++;
    const char *wrong = bracket == '"' ? check_quoted(room, name, header) : check_bracketed(folder, header);
    if (wrong != NULL) fault(tally, path, number, wrong, header);
  }
  fclose(file);
}

/* folder NULL: each folder in `path` is one of its own. */
static void check_tree(struct tally *tally, const char *path, const char *folder) {
  DIR *list = opendir(path);
  if (list == NULL) fail_msg("%s: the folder is missing", path);
  for (struct dirent *entry = readdir(list); entry != NULL; entry = readdir(list)) {
    char inside[PATH_BYTES];
    struct stat about;
    if (entry->d_name[0] == '.') continue;
    assert_true(snprintf(inside, sizeof inside, "%s/%s", path, entry->d_name) < (int)sizeof inside);
    assert_int_equal(stat(inside, &about), 0);
    if (S_ISDIR(about.st_mode)) {
      check_tree(tally, inside, folder != NULL ? folder : entry->d_name);
      continue;
    }
    const char *dot = strrchr(entry->d_name, '.');
    if (dot == NULL) continue;
    if (strcmp(dot, ".c") != 0 && strcmp(dot, ".h") != 0 && strcmp(dot, ".cpp") != 0 && strcmp(dot, ".cl") != 0)
      continue;
    if (folder == NULL) fail_msg("%s: code that is in no folder", inside);
    check_file(tally, inside, folder, entry->d_name);
  }
  closedir(list);
}

static void test_tree(void **state) {
  (void)state;
  static const struct {
    const char *path, *folder;
  } trees[] = {{"include", "include"}, {"src", NULL}, {"tools", "tools"}, {"examples", "examples"}};
  const char *source = getenv("ERNERF_SOURCE");
  assert_non_null(source);
  struct tally tally = {0};
  for (size_t i = 0; i < sizeof trees / sizeof *trees; i++) {
    char path[PATH_BYTES];
    assert_true(snprintf(path, sizeof path, "%s/%s", source, trees[i].path) < (int)sizeof path);
    check_tree(&tally, path, trees[i].folder);
  }
  assert_true(tally.files > 80 && tally.includes > 300); /* the tree was really read */
  if (tally.faults != 0) fail_msg("%zu includes against the floor plan:%s", tally.faults, tally.text);
}

/* The rules themselves, on includes that must be refused and ones that must not. */
static void test_rules(void **state) {
  (void)state;
  static const struct {
    const char *folder, *name, *header;
    bool fine;
  } quoted[] = {
      {"core", "arena.c", "core/memory.h", true},
      {"core", "operations.h", "train/losses_ops.h", false},
      {"core", "arena.c", "io/file.h", false},
      {"io", "npy.c", "hashgrid/hashgrid.h", false},
      {"io", "npy.c", "model/model.h", false},
      {"mlp", "mlp_ref.c", "hashgrid/hashgrid.h", false},
      {"mlp", "mlp_ref.c", "mlp/mlp_tile.h", true},
      {"hashgrid", "hashgrid_ref.c", "io/npy.h", false},
      {"model", "model.c", "io/npy.h", true},
      {"model", "model.c", "render/stages.h", false},
      {"render", "frame.c", "model/model.h", true},
      {"render", "frame.c", "train/step.h", false},
      {"render", "frame.c", "train/losses_ops.h", false},
      {"model", "model.c", "render/render_ops.h", false},
      {"train", "step.c", "backend_cpu/slots.h", false},
      {"backend_cpu", "march.c", "render/stages.h", true},
      {"backend_cpu", "march.c", "model/head.h", false},
      {"backend_cpu", "march.c", "io/file.h", false},
      {"media", "clip.c", "io/npy.h", true},
      {"media", "clip.c", "model/model.h", false},
      {"media", "speech_network.c", "vision/vision.h", true},
      {"vision", "network_opencv.cpp", "core/status.h", false},
      {"media", "clip.c", "render/render_ops.h", false},
      {"prepare", "face_step.c", "io/file.h", true},
      {"prepare", "face_step.c", "media/speech_network.h", true},
      {"prepare", "face_step.c", "media/video.h", false},
      {"prepare", "face_step.c", "model/model.h", false},
      {"prepare", "face_step.c", "vision/vision.h", false},
      {"media", "clip.c", "prepare/prepare_job.h", false},
      {"tools/verbs", "cmd_prepare.c", "prepare/prepare_job.h", false},
      {"media", "clip.c", "ernerf-lab/synth.h", false},
      {"media", "clip.c", "lab/synth/synth_parts.h", false},
      {"render", "frame.c", "ernerf-lab/bench.h", false},
      {"train", "trainer_run.c", "lab/bench/bench_shared.h", false},
      {"lab", "synth.c", "ernerf/media.h", true},
      {"lab", "synth.c", "media/image.h", false},
      {"lab", "bench_scene.c", "lab/bench/bench_shared.h", true},
      {"tools/lab", "cmd_bench.c", "ernerf-lab/bench.h", true},
      {"tools/lab", "cmd_bench.c", "lab/ablation.h", true},
      {"tools/verbs", "cmd_train.c", "lab/ablation.h", false},
      {"tools/session", "speech_model.c", "output/sink.h", false},
      {"tools/output", "sink.c", "session/session.h", true},
      {"tools", "args.h", "session/session.h", false},
      {"tools/cellar", "a.c", "ernerf/base.h", false},
      {"backend", "registry.c", "backend_cpu/backend_cpu.h", true},
      {"backend", "other.c", "backend_cpu/backend_cpu.h", false},
      {"train", "trainer_run.c", "core/x.h", true},
      {"train", "trainer_run.c", "train/parts/trainer_poses.h", true},
      {"train/parts", "trainer_poses.c", "train/parts/trainer_fine.h", true},
      {"train/parts", "trainer_poses.c", "train/trainer.h", false},
      {"train", "step_ops.h", "core/backend.h", false},
      {"train", "step_ops.h", "core/types.h", true},
      {"train", "step_ops.h", "core/operations.h", true},
      {"train", "step_ops.h", "train/losses_ops.h", true},
      {"train", "step_ops.h", "render/march_ops.h", false},
      {"train", "step_ops.h", "train/step.h", false},
      {"tools", "main.c", "args.h", true},
      {"tools/verbs", "cmd_render.c", "session/session.h", true},
      {"tools/main", "main.c", "session/session.h", true},
      {"tools", "main.c", "core/status.h", false},
      {"tools", "main.c", "ernerf/media.h", true},
      {"core", "arena.c", "memory.h", false},
      {"examples", "a.c", "io/npy.h", false},
      {"attic", "a.c", "core/types.h", false},
  };
  for (size_t i = 0; i < sizeof quoted / sizeof *quoted; i++) {
    const char *wrong = check_quoted(quoted[i].folder, quoted[i].name, quoted[i].header);
    if ((wrong == NULL) != quoted[i].fine)
      fail_msg("%s/%s with \"%s\": %s", quoted[i].folder, quoted[i].name, quoted[i].header,
               wrong != NULL ? wrong : "let pass");
  }
  assert_null(check_bracketed("core", "stdio.h"));
  assert_null(check_bracketed("io", "sys/stat.h"));
  assert_null(check_bracketed("media", "opencv2/imgproc.hpp"));
  assert_non_null(check_bracketed("model", "libavutil/log.h"));
  assert_non_null(check_bracketed("mlp", "immintrin.h"));
  assert_non_null(check_bracketed("train", "CL/cl.h"));
  assert_non_null(check_bracketed("core", "gsl/gsl.h"));
  char room[64];
  name_room("/x/tools/ernerf-cli/output/sink.c", "tools", "sink.c", room);
  assert_string_equal(room, "tools/output");
  name_room("/x/tools/ernerf-cli/main.c", "tools", "main.c", room);
  assert_string_equal(room, "tools/main");
  name_room("/x/tools/ernerf-cli/args.c", "tools", "args.c", room);
  assert_string_equal(room, "tools");
  char header[LINE_BYTES], bracket = 0;
  assert_true(parse_include("  # include <math.h> /* x */", header, &bracket) && bracket == '<');
  assert_string_equal(header, "math.h");
  assert_false(parse_include("int include;", header, &bracket));
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_rules), cmocka_unit_test(test_tree)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
