/* SPDX-License-Identifier: MIT
 * What moves bytes to, from and on an OpenCL device. */
#include "twin.h"

#if defined(ERN_OPENCL)
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
  struct ern_backend *device = twin.backend[1];
  for (int element = 0; element < 3; element++) {
    struct ern_buffer *buffer = NULL;
    float values[65];
    support_ok(context, device->buffer_make(device, (ern_element)element, 65, &buffer));
    if (element == ERN_ELEMENT_REAL) {
      support_ok(context, device->download_reals(twin.stream[1], values, (ern_span){buffer, 0, 65}, 65));
      for (int i = 0; i < 65; i++) assert_true(values[i] == 0);
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
#else
int main(void) { return 0; }
#endif
