/* SPDX-License-Identifier: MIT
 * What moves bytes to, from and on an OpenCL device. */
#include "twin.h"

static ern_context *context;
static struct twin twin;

static void test_moves(void **state) {
  (void)state;
  for (size_t s = 0; s < TWIN_SIZES; s++) {
    const size_t n = twin_sizes[s];
    float values[TWIN_MOST];
    twin_fill(values, n, s, 3);
    const struct twin_span from = twin_reals(&twin, values, n), to = twin_take(&twin, ERN_ELEMENT_REAL, n);
    for (int k = 0; k < 2; k++)
      support_ok(context, twin.backend[k]->copy(twin.stream[k], to.on[k], from.on[k], n - n / 3));
    twin_same(&twin, "copied", to, 0, 0);
    for (int k = 0; k < 2; k++)
      support_ok(context, twin.backend[k]->zero(twin.stream[k], ern_span_part(from.on[k], n / 4, n / 2)));
    twin_same(&twin, "cleared in part", from, 0, 0);
    twin_clear(&twin);
  }
}

static void test_buffers_are_clear(void **state) {
  (void)state;
  enum { N = 65 };
  struct ern_backend *device = twin.backend[1];
  struct ern_stream *stream = twin.stream[1];
  static const ern_element elements[] = {ERN_ELEMENT_REAL, ERN_ELEMENT_INT32, ERN_ELEMENT_BYTE};
  for (size_t e = 0; e < sizeof elements / sizeof *elements; e++) {
    struct ern_buffer *buffer = NULL;
    float reals[N] = {0};
    int32_t numbers[N] = {0};
    uint8_t bytes[N] = {0};
    support_ok(context, device->buffer_make(device, elements[e], N, &buffer));
    const ern_span whole = {buffer, 0, N};
    memset(reals, 0x5a, sizeof reals), memset(numbers, 0x5a, sizeof numbers), memset(bytes, 0x5a, sizeof bytes);
    if (elements[e] == ERN_ELEMENT_REAL) support_ok(context, device->download_reals(stream, reals, whole, N));
    if (elements[e] == ERN_ELEMENT_INT32) support_ok(context, device->download_int32(stream, numbers, whole, N));
    if (elements[e] == ERN_ELEMENT_BYTE) support_ok(context, device->download_bytes(stream, bytes, whole, N));
    for (int i = 0; i < N; i++) {
      if (elements[e] == ERN_ELEMENT_REAL) assert_true(reals[i] == 0);
      if (elements[e] == ERN_ELEMENT_INT32) assert_int_equal(numbers[i], 0);
      if (elements[e] == ERN_ELEMENT_BYTE) assert_int_equal(bytes[i], 0);
    }
    device->buffer_free(device, buffer);
    device->buffer_free(device, NULL);
  }
}

static void test_too_much(void **state) {
  (void)state;
  struct ern_backend *device = twin.backend[1];
  struct ern_buffer *buffer = NULL;
  support_expect(context, device->buffer_make(device, ERN_ELEMENT_REAL, SIZE_MAX / 2, &buffer), ERN_E_NO_MEMORY,
                 "OpenCL", "bytes", NULL);
  assert_null(buffer);
  support_expect(context, device->buffer_make(device, ERN_ELEMENT_REAL, (size_t)1 << 50, &buffer), ERN_E_NO_MEMORY,
                 "4503599627370496 bytes", "all memory is", NULL);
  assert_null(buffer);
}

static int set_up(void **state) {
  (void)state;
  context = support_context();
  twin_open(&twin, context);
  return 0;
}
static int tear_down(void **state) {
  (void)state;
  twin_close(&twin);
  ern_context_free(&context);
  return 0;
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_moves), cmocka_unit_test(test_buffers_are_clear),
                                     cmocka_unit_test(test_too_much)};
  return cmocka_run_group_tests_name("opencl memory", tests, set_up, tear_down);
}
