/* SPDX-License-Identifier: MIT
 * What moves bytes to, from and on a machine. */
#include "harness.h"

static void test_moves(void **state) {
  (void)state;
  for (size_t s = 0; s < size_count(); s++) {
    const size_t n = test_sizes[s];
    float values[MOST_SIZE];
    fill_random(values, n, s, 3);
    const struct many from = many_reals(values, n), to = many_empty(n);
    EACH_MACHINE (k)
      support_ok(machines.context, machines.backend[k]->copy(machines.stream[k], to.on[k], from.on[k], n - n / 3));
    expect_bits("copied", to);
    EACH_MACHINE (k)
      support_ok(machines.context,
                 machines.backend[k]->zero(machines.stream[k], ern_span_part(from.on[k], n / 4, n / 2)));
    expect_bits("cleared in part", from);
    machines_clear();
  }
}

/* Of every element type: zeros at first, then what was brought. */
static void test_buffers_are_clear(void **state) {
  (void)state;
  enum { N = 65 };
  static const ern_element elements[] = {ERN_ELEMENT_REAL, ERN_ELEMENT_INT32, ERN_ELEMENT_BYTE};
  EACH_MACHINE (k) {
    for (size_t e = 0; e < COUNT_OF(elements); e++) {
      struct ern_backend *backend = machines.backend[k];
      struct ern_stream *stream = machines.stream[k];
      struct ern_buffer *buffer = NULL;
      const size_t bytes = elements[e] == ERN_ELEMENT_BYTE ? N : 4 * N;
      uint8_t *values = held_memory(4 * N, 1);
      support_ok(machines.context, backend->buffer_make(backend, elements[e], N, &buffer));
      const ern_span whole = {buffer, 0, N};
      memset(values, 0x5a, 4 * N);
      for (int turn = 0; turn < 2; turn++) {
        if (elements[e] == ERN_ELEMENT_REAL)
          support_ok(machines.context, backend->download_reals(stream, (float *)(void *)values, whole, N));
        if (elements[e] == ERN_ELEMENT_INT32)
          support_ok(machines.context, backend->download_int32(stream, (int32_t *)(void *)values, whole, N));
        if (elements[e] == ERN_ELEMENT_BYTE)
          support_ok(machines.context, backend->download_bytes(stream, values, whole, N));
        for (size_t i = 0; i < bytes; i++) assert_int_equal(values[i], turn == 0 ? 0 : 0x3c);
        memset(values, 0x3c, 4 * N);
        machines_fill(k, whole, values, elements[e]);
        memset(values, 0x5a, 4 * N);
      }
      backend->buffer_free(backend, buffer);
      backend->buffer_free(backend, NULL);
      machines.checks += k > 0;
    }
  }
  machines_clear();
}

/* The caller's memory may change as soon as an upload returns, also where more is uploaded than a device stages. */
static void test_uploads_take_copies(void **state) {
  (void)state;
  enum { PIECE = 3 << 20, PIECES = 7, ALL = PIECES * PIECE };
  uint8_t *values = held_memory(ALL, 1);
  EACH_MACHINE (k) {
    struct ern_backend *backend = machines.backend[k];
    struct ern_stream *stream = machines.stream[k];
    struct ern_buffer *buffer = NULL;
    support_ok(machines.context, backend->buffer_make(backend, ERN_ELEMENT_BYTE, ALL, &buffer));
    for (int whole = 0; whole < 2; whole++) {
      for (size_t i = 0; i < (whole ? 1 : PIECES); i++) {
        const ern_span to = {buffer, i * PIECE, whole ? ALL : PIECE};
        memset(values, (int)(i + 1), to.count);
        support_ok(machines.context, backend->upload_bytes(stream, to, values, to.count));
        memset(values, 0x5a, to.count);
      }
      support_ok(machines.context, backend->download_bytes(stream, values, (ern_span){buffer, 0, ALL}, ALL));
      for (size_t i = 0; i < ALL; i++) assert_int_equal(values[i], whole ? 1 : i / PIECE + 1);
    }
    backend->buffer_free(backend, buffer);
    machines.checks += k > 0;
  }
  machines_clear();
}

/* A device's own times are those at which work is done, not those at which it was begun. Another process may hold the
   machine in any one interval, so the least of several turns are compared. */
static void test_marks(void **state) {
  (void)state;
  enum { N = 1 << 20, COPIES = 64, TURNS = 20 };
  EACH_MACHINE (k) {
    struct ern_backend *backend = machines.backend[k];
    struct ern_stream *stream = machines.stream[k];
    struct ern_buffer *buffer = NULL;
    double ms[3] = {-1, -1, -1}, least_of_nothing = INFINITY, least_of_copies = INFINITY;
    support_ok(machines.context, backend->buffer_make(backend, ERN_ELEMENT_BYTE, 2 * N, &buffer));
    for (int turn = 0; turn < TURNS; turn++) { /* marks may be set again */
      support_ok(machines.context, backend->mark(stream, 0));
      support_ok(machines.context, backend->mark(stream, 1));
      for (int i = 0; i < COPIES; i++)
        support_ok(machines.context, backend->copy(stream, (ern_span){buffer, N, N}, (ern_span){buffer, 0, N}, N));
      support_ok(machines.context, backend->mark(stream, 2));
      support_ok(machines.context, backend->marks_read(stream, ms, 3));
      if (is_device(k))
        assert_true(ms[0] == 0 && ms[1] >= 0 && ms[2] >= ms[1]);
      else
        assert_true(ms[0] == -1 && ms[1] == -1 && ms[2] == -1);
      least_of_nothing = fmin(least_of_nothing, ms[1] - ms[0]);
      least_of_copies = fmin(least_of_copies, ms[2] - ms[1]);
    }
    if (is_device(k)) assert_true(least_of_copies > least_of_nothing);
    backend->buffer_free(backend, buffer);
    machines.checks += k > 0;
  }
  machines_clear();
}

static void test_too_much(void **state) {
  (void)state;
  EACH_MACHINE (k) {
    struct ern_backend *backend = machines.backend[k];
    struct ern_buffer *buffer = NULL;
    const char *who = is_device(k) ? "OpenCL" : "", *why = is_device(k) ? "all memory is" : "";
    support_expect(machines.context, backend->buffer_make(backend, ERN_ELEMENT_REAL, SIZE_MAX / 2, &buffer),
                   ERN_E_NO_MEMORY, who, is_device(k) ? "bytes" : "", NULL);
    assert_null(buffer);
    support_expect(machines.context, backend->buffer_make(backend, ERN_ELEMENT_REAL, (size_t)1 << 50, &buffer),
                   ERN_E_NO_MEMORY, is_device(k) ? "4503599627370496" : "bytes", why, NULL);
    assert_null(buffer);
  }
}

static const struct CMUnitTest tests[] = {cmocka_unit_test(test_moves), cmocka_unit_test(test_buffers_are_clear),
                                          cmocka_unit_test(test_uploads_take_copies), cmocka_unit_test(test_marks),
                                          cmocka_unit_test(test_too_much)};
NOUN(memory, NULL, .isa = NULL)
