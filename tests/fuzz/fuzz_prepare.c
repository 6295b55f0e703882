/* SPDX-License-Identifier: MIT
 * Any bytes as CLIP/prepare.json and as CLIP/prepare/faces.csv, which a call of `prepare` goes on from. The record's
 * video is one of 8 bytes from second 0, so that a record can be that of the call. */
#include <math.h>
#include <sys/stat.h>

#include "fuzz.h"
#include "prepare/prepare_record.h"

static void read_record(struct ern_prepare_job *job, const uint8_t *bytes, size_t count) {
  static const char *const steps[] = {"face", "pose", "landmarks", "layers", "eyes", "features"};
  int lock = -1;
  fuzz_file("clip/prepare.json", bytes, count);
  if (ern_prepare_record_open(job, &lock) == ERN_OK) {
    const json_int_t frames = json_integer_value(json_object_get(job->record, "frames"));
    FUZZ_REQUIRE(frames >= 0 && frames <= ERN_PREPARE_FRAMES);
    for (size_t i = 0; i < sizeof steps / sizeof *steps; i++) {
      ern_prepare_verdict verdict = {.step = steps[i]};
      job->verdict = &verdict;
      if (ern_prepare_record_has(job, steps[i], "", &verdict))
        FUZZ_REQUIRE(verdict.grade <= ERN_PREPARE_DOUBTFUL && strlen(verdict.words) < ERN_PREPARE_WORDS);
      FUZZ_REQUIRE(ern_prepare_record_enter(job, "", steps, i % 2) == ERN_OK); /* a record it takes can be written */
    }
  } else {
    fuzz_refused(job->context, "clip");
  }
  if (lock >= 0) close(lock);
  json_decref(job->record);
  job->record = NULL;
}

static void read_faces(struct ern_prepare_job *job, const uint8_t *bytes, size_t count) {
  struct ern_found_face *faces = NULL;
  size_t found = 0;
  fuzz_file("clip/prepare/faces.csv", bytes, count);
  if (ern_prepare_faces_read(job, &faces, &found) == ERN_OK) {
    for (size_t i = 0; i < found; i++) {
      const struct ern_found_face *f = &faces[i];
      FUZZ_REQUIRE(f->frame < job->frames && (i == 0 || f->frame > faces[i - 1].frame));
      FUZZ_REQUIRE(isfinite(f->x) && isfinite(f->y) && isfinite(f->width) && isfinite(f->height));
      FUZZ_REQUIRE(!f->has_eyes || (isfinite(f->eyes[0][1]) && isfinite(f->eyes[1][1])));
    }
  } else {
    fuzz_refused(job->context, "clip/prepare/faces.csv");
    FUZZ_REQUIRE(faces == NULL && found == 0);
  }
  ern_release(job->context, faces);
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t count) {
  static const struct timespec times[2];
  const ern_prepare_options options = {.side = 512};
  ern_prepare_verdict verdict = {.step = "face"};
  struct ern_prepare_job job = {.context = fuzz_context(),
                                .video = "fuzz.mp4",
                                .folder = "clip",
                                .options = &options,
                                .side = options.side,
                                .frames = 50,
                                .verdict = &verdict,
                                .figures = json_object()};
  (void)mkdir("clip", 0777);
  (void)mkdir("clip/prepare", 0777);
  fuzz_file("fuzz.mp4", (const uint8_t *)"a video", 8);
  FUZZ_REQUIRE(utimensat(AT_FDCWD, "fuzz.mp4", times, 0) == 0);
  read_record(&job, bytes, count);
  read_faces(&job, bytes, count);
  json_decref(job.figures);
  return 0;
}
