/* SPDX-License-Identifier: MIT
 * speech.h: what its functions do with bad arguments (base.h, "Arguments"). */
#include "arguments.h"

#include <math.h>

#include "ernerf/speech.h"

static const char junk[] = "nowhere/at-all";

static struct {
  ern_context *context;
  ern_speech_stream *stream;
} w;

CHECK(ern_speech_stream_open) {
  ern_speech_stream *stream = (ern_speech_stream *)(void *)&w;
  REFUSED_ALONE(ern_speech_stream_open(NULL, 16000, 1, 1, &stream));
  assert_null(stream);
  REFUSED(w.context, "stream is NULL", ern_speech_stream_open(w.context, 16000, 1, 1, NULL));
  REFUSED(w.context, "expected 1000 to 384000", ern_speech_stream_open(w.context, -1, 1, 1, &stream));
  REFUSED(w.context, "0 channels", ern_speech_stream_open(w.context, 16000, 0, 1, &stream));
  REFUSED(w.context, "warp is 0.4", ern_speech_stream_open(w.context, 16000, 1, 0.4f, &stream));
}
CHECK(ern_speech_stream_open_kind) {
  ern_speech_stream *stream = (ern_speech_stream *)(void *)&w;
  REFUSED_ALONE(ern_speech_stream_open_kind(NULL, ERN_SPEECH_CEPSTRA, 16000, 1, 1, &stream));
  assert_null(stream);
  REFUSED(w.context, "stream is NULL", ern_speech_stream_open_kind(w.context, ERN_SPEECH_CEPSTRA, 16000, 1, 1, NULL));
  REFUSED(w.context, "kind is NULL", ern_speech_stream_open_kind(w.context, NULL, 16000, 1, 1, &stream));
  REFUSED(w.context, "kind is \"hubert\"", ern_speech_stream_open_kind(w.context, "hubert", 16000, 1, 1, &stream));
}
CHECK(ern_speech_width) {
  assert_int_equal(ern_speech_width(NULL), 0);
  assert_int_equal(ern_speech_width("hubert"), 0);
}
CHECK(ern_speech_stream_free) {
  ern_speech_stream *none = NULL;
  ern_speech_stream_free(NULL);
  ern_speech_stream_free(&none);
}
CHECK(ern_speech_stream_push) {
  const float sample = 0;
  REFUSED_ALONE(ern_speech_stream_push(NULL, &sample, 1));
  REFUSED(w.context, "samples is NULL", ern_speech_stream_push(w.stream, NULL, 1));
  support_ok(w.context, ern_speech_stream_push(w.stream, NULL, 0));
}
CHECK(ern_speech_stream_end) { REFUSED_ALONE(ern_speech_stream_end(NULL)); }
CHECK(ern_speech_stream_pull) {
  float row[ERN_SPEECH_WIDTH];
  assert_int_equal(ern_speech_stream_pull(NULL, row, 1), 0);
  assert_int_equal(ern_speech_stream_pull(w.stream, NULL, 1), 0);
  assert_int_equal(ern_speech_stream_pull(w.stream, row, 1), 0);
}
CHECK(ern_speech_features) {
  ern_features features = {.width = 7};
  REFUSED_ALONE(ern_speech_features(NULL, junk, 1, &features));
  assert_int_equal(features.width, 0);
  REFUSED(w.context, "path is NULL", ern_speech_features(w.context, NULL, 1, &features));
  REFUSED(w.context, "features is NULL", ern_speech_features(w.context, junk, 1, NULL));
  REFUSED(w.context, "warp is nan", ern_speech_features(w.context, junk, NAN, &features));
}
CHECK(ern_speech_features_kind) {
  ern_features features = {.width = 7};
  REFUSED_ALONE(ern_speech_features_kind(NULL, junk, ERN_SPEECH_CEPSTRA, 1, &features));
  assert_int_equal(features.width, 0);
  REFUSED(w.context, "path is NULL", ern_speech_features_kind(w.context, NULL, ERN_SPEECH_CEPSTRA, 1, &features));
  REFUSED(w.context, "kind is NULL", ern_speech_features_kind(w.context, junk, NULL, 1, &features));
  REFUSED(w.context, "kind is \"\"", ern_speech_features_kind(w.context, junk, "", 1, &features));
  REFUSED(w.context, "features is NULL", ern_speech_features_kind(w.context, junk, ERN_SPEECH_CEPSTRA, 1, NULL));
}
CHECK(ern_speech_kind) {
  assert_string_equal(ern_speech_kind(NULL), "");
  assert_string_equal(ern_speech_kind(&(ern_features){.width = -3}), "");
}
CHECK(ern_speech_open) {
  ern_features features = {.width = 7};
  REFUSED_ALONE(ern_speech_open(NULL, junk, NULL, &features));
  assert_int_equal(features.width, 0);
  REFUSED(w.context, "path is NULL", ern_speech_open(w.context, NULL, NULL, &features));
  REFUSED(w.context, "features is NULL", ern_speech_open(w.context, junk, NULL, NULL));
}
CHECK(ern_speech_is_sound) { assert_true(ern_speech_is_sound(NULL)); }

CHECK(ern_speech_network_open) {
  ern_speech_network *network = (ern_speech_network *)(void *)&w;
  REFUSED_ALONE(ern_speech_network_open(NULL, junk, NULL, &network));
  assert_null(network);
  REFUSED(w.context, "path is NULL", ern_speech_network_open(w.context, NULL, NULL, &network));
  REFUSED(w.context, "network is NULL", ern_speech_network_open(w.context, junk, NULL, NULL));
}
CHECK(ern_speech_network_free) {
  ern_speech_network *none = NULL;
  ern_speech_network_free(NULL);
  ern_speech_network_free(&none);
}
CHECK(ern_speech_network_kind) { assert_string_equal(ern_speech_network_kind(NULL), ""); }
CHECK(ern_speech_network_description) { assert_string_equal(ern_speech_network_description(NULL), ""); }
CHECK(ern_speech_preset) { assert_null(ern_speech_preset(NULL)); }
CHECK(ern_speech_network_watch) { ern_speech_network_watch(NULL, NULL, NULL); }
CHECK(ern_speech_network_features) { /* with a network: files/test_speech_network */
  ern_features features = {.width = 7};
  REFUSED_ALONE(ern_speech_network_features(NULL, junk, &features));
  assert_int_equal(features.width, 0);
}

static const struct arguments_check table[] = {ROW(ern_speech_stream_open),
                                               ROW(ern_speech_stream_open_kind),
                                               ROW(ern_speech_width),
                                               ROW(ern_speech_stream_free),
                                               ROW(ern_speech_stream_push),
                                               ROW(ern_speech_stream_end),
                                               ROW(ern_speech_stream_pull),
                                               ROW(ern_speech_features),
                                               ROW(ern_speech_features_kind),
                                               ROW(ern_speech_kind),
                                               ROW(ern_speech_open),
                                               ROW(ern_speech_is_sound),
                                               ROW(ern_speech_network_open),
                                               ROW(ern_speech_network_free),
                                               ROW(ern_speech_network_kind),
                                               ROW(ern_speech_network_description),
                                               ROW(ern_speech_preset),
                                               ROW(ern_speech_network_watch),
                                               ROW(ern_speech_network_features)};
enum { CHECKS = sizeof table / sizeof *table };

static void test_every_function_has_a_check(void **state) {
  (void)state;
  assert_int_equal(arguments_cover("include/ernerf/speech.h", table, CHECKS), CHECKS);
}

static void test_arguments(void **state) {
  (void)state;
  w.context = support_context();
  support_ok(w.context, ern_speech_stream_open(w.context, 16000, 1, 1, &w.stream));
  arguments_run(table, CHECKS);
  ern_speech_stream_free(&w.stream);
  ern_context_free(&w.context);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_every_function_has_a_check),
                                     cmocka_unit_test(test_arguments)};
  return cmocka_run_group_tests(tests, NULL, NULL);
}
