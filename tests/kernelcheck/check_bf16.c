/* SPDX-License-Identifier: MIT
 * Products of bf16 pairs: the instructions' emulation against the instructions' definition in scalars, the instructions
 * (where the machine has them) against their emulation, bit for bit; and the packed product made of them against one in
 * scalars that does the same operations in the same order. */
#include "harness.h"

#include "backend_cpu/fused/pack_pairs.h"
#include "bf16_kernels.h"
#include "core/cpu.h"

#if defined(ERN_X86_KERNELS)

enum { TILE = ERN_MLP_TILE };

static const struct {
  const char *name;
  ern_isa isa;
  bf16_product *product;
  bf16_rows *rows;
  bf16_add *add;
  bf16_rows_product *forward, *sums;
} how[] = {
    {"emulated", ERN_ISA_AVX512, bf16_product_emulated, bf16_rows_emulated, bf16_add_emulated, bf16_forward_emulated,
     bf16_sums_emulated},
    {"real", ERN_ISA_AVX512BF16, bf16_product_real, bf16_rows_real, bf16_add_real, bf16_forward_real, bf16_sums_real},
};
enum { HOW = sizeof how / sizeof *how };

/* Between guards, on the one machine that is open. */
struct array {
  struct many span;
  float *data;
  size_t count;
};

static struct array array_make(size_t count) {
  struct array array = {.span = many_empty(count), .count = count};
  array.data = host_reals(0, array.span.on[0]);
  return array;
}

/* Nothing was written around it. */
static void array_check(const struct array *array) {
  const struct machines_mark mark = machines_mark();
  floats_of(0, array->span);
  machines_clear_to(mark);
}

static uint32_t bits_of(float value) {
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  return bits;
}
static float float_of(uint32_t bits) {
  float value;
  memcpy(&value, &bits, sizeof value);
  return value;
}
static bool same(float a, float b) { return bits_of(a) == bits_of(b) || (isnan(a) && isnan(b)); }

/* ---- the definition, a lane at a time ---------------------------------------------------------------------------- */

static double flushed(float value) { return fabsf(value) < FLT_MIN ? copysign(0, (double)value) : (double)value; }

/* One of the two sums. A product of bf16 is exact in double, and so is its sum with a float in long double, whose 64
 * bits end below what 2^-40 of the larger of the two can decide: beyond that the smaller one only breaks ties, for
 * which its sign is enough. */
static float multiply_add(float sum, float a, float b) {
  const double product = flushed(a) * flushed(b), start = flushed(sum);
  const float rounded = fmaf((float)flushed(a), (float)flushed(b), (float)start);
  if (isnan(rounded) || isinf(rounded)) return rounded;
  const long double exact = (long double)product + (long double)start;
  /* at the precision of normal numbers: 24 bits, half an ulp of the binade under FLT_MIN is 2^-151 */
  const bool tiny = fabsl(exact) < (long double)FLT_MIN - 0x1p-151L;
  return tiny || fabsf(rounded) < FLT_MIN ? copysignf(0, exact == 0 ? rounded : (float)(exact > 0 ? 1 : -1)) : rounded;
}

static float add_pair(float sum, uint32_t a, uint32_t b) {
  sum = multiply_add(sum, float_of(a & 0xffff0000u), float_of(b & 0xffff0000u));
  return multiply_add(sum, float_of(a << 16), float_of(b << 16));
}

/* ---- numbers ----------------------------------------------------------------------------------------------------- */

static uint32_t random_bits(uint64_t seed, size_t at) {
  return ern_random_at(seed, 0, (uint32_t)at, ERN_RNG_INIT).word[0];
}

/* Halves that decide something: zeros, denormal numbers and their neighbours, ones, the largest, infinity, NaNs. */
static const uint16_t halves[] = {0x0000, 0x8000, 0x0001, 0x807f, 0x0080, 0x8080, 0x0081, 0x00ff,
                                  0x1f80, 0x9fff, 0x2000, 0x3f7f, 0x3f80, 0xbf80, 0x3f81, 0x4000,
                                  0x5f80, 0x7f7f, 0xff7f, 0x7f80, 0xff80, 0x7fc0, 0x7f81, 0xffff};
enum { HALVES = sizeof halves / sizeof *halves };
static uint32_t pair_at(uint64_t seed, size_t at, bool tame) {
  const uint32_t bits = random_bits(seed, at);
  if (tame) return (bits & 0x80ff80ffu) | 0x3f003f00u; /* 1/2 to 2, either sign */
  const uint32_t low = bits & 1 ? halves[(bits >> 8) % HALVES] : bits >> 16;
  const uint32_t high = bits & 2 ? halves[(bits >> 16) % HALVES] : bits & 0xffff;
  return low | high << 16;
}

/* ---- the instruction --------------------------------------------------------------------------------------------- */

static void expect_adds(const float *sum, const uint32_t *a, const uint32_t *b) {
  for (size_t h = 0; h < HOW; h++) {
    if (!ern_isa_available(how[h].isa)) continue;
    float found[16];
    memcpy(found, sum, sizeof found);
    how[h].add(found, a, b);
    for (size_t i = 0; i < 16; i++) {
      const float expected = add_pair(sum[i], a[i], b[i]);
      if (!same(found[i], expected))
        fail_msg("%s: %a + %08x.%08x is %a, expected %a", how[h].name, (double)sum[i], a[i], b[i], (double)found[i],
                 (double)expected);
    }
  }
}

static void test_add(void **state) {
  (void)state;
  for (size_t turn = 0; turn < 40000; turn++) {
    float sum[16];
    uint32_t a[16], b[16];
    for (size_t i = 0; i < 16; i++) {
      const size_t at = turn * 16 + i;
      a[i] = pair_at(1, at, turn % 3 == 0);
      b[i] = pair_at(2, at, turn % 3 == 0);
      const uint32_t bits = random_bits(3, at);
      /* any float; a bf16; of the size of the products, so that they cancel */
      sum[i] = turn % 4 == 0   ? float_of(bits)
               : turn % 4 == 1 ? float_of(pair_at(3, at, false) << 16)
                               : -float_of(a[i] & 0xffff0000u) * float_of(b[i] & 0xffff0000u);
    }
    expect_adds(sum, a, b);
  }
}

/* Sums at the end of the normal numbers: 2^-126 less 2^-151 and less, which the denormal grid rounds up to 2^-126. */
static void test_smallest(void **state) {
  (void)state;
  static const float start[] = {FLT_MIN,   -FLT_MIN, FLT_MIN * 1.5f, 0x1.000002p-126f, 0x1.fffffep-127f,
                                0x1p-149f, 0,        -0.0f};
  enum { STARTS = sizeof start / sizeof *start };
  for (int exponent = -160; exponent <= -120; exponent++) {
    for (int s = 0; s < 16; s++) {
      float sum[16];
      uint32_t a[16], b[16];
      for (uint32_t i = 0; i < 16; i++) {
        sum[i] = start[i % STARTS];
        const float factor = ldexpf(1 + (float)s / 16, exponent / 2) * (i < STARTS ? 1 : -1);
        a[i] = bits_of(factor) & 0xffff0000u;
        b[i] = bits_of(ldexpf(1, exponent - exponent / 2)) & 0xffff0000u;
        if (i % 2 == 1) a[i] |= a[i] >> 16, b[i] |= b[i] >> 16;
      }
      expect_adds(sum, a, b);
    }
  }
}

/* ---- conversion -------------------------------------------------------------------------------------------------- */

/* The two nearest bf16 are the float's upper half and the next one. */
static uint32_t nearest(float value) {
  const uint32_t bits = bits_of(value), below = bits >> 16;
  if (isnan(value)) return below | 0x40;
  if (fabsf(value) < FLT_MIN) return below & 0x8000;
  if (isinf(value)) return below;
  const double under = fabs((double)float_of(below << 16));
  const double over = (below & 0x7fff) == 0x7f7f ? 0x1p128 : fabs((double)float_of((below + 1) << 16));
  const double to_under = fabs((double)value) - under, to_over = over - fabs((double)value);
  return to_under < to_over || (to_under == to_over && (below & 1) == 0) ? below : below + 1;
}

static void test_conversion(void **state) {
  (void)state;
  static const uint32_t low[] = {0, 1, 0x7fff, 0x8000, 0x8001, 0xffff};
  enum { LOWS = sizeof low / sizeof *low, ROWS = 7, VALUES = 65536 * LOWS };
  const struct array x = array_make(ROWS * TILE), made = array_make(ern_pairs(ROWS) * TILE);
  for (size_t begin = 0; begin < VALUES; begin += ROWS * TILE) {
    for (size_t i = 0; i < ROWS * TILE; i++) {
      const size_t at = (begin + i) % VALUES;
      x.data[i] = float_of((uint32_t)(at / LOWS) << 16 | low[at % LOWS]);
    }
    for (size_t h = 0; h < HOW; h++) {
      if (!ern_isa_available(how[h].isa)) continue;
      how[h].rows(made.data, x.data, ROWS);
      array_check(&made);
      for (size_t i = 0; i < made.count; i++) {
        const size_t row = i / TILE * 2, at = row * TILE + i % TILE;
        const uint32_t first = nearest(x.data[at]), second = row + 1 < ROWS ? nearest(x.data[at + TILE]) : 0;
        const uint32_t found = bits_of(made.data[i]);
        if (found != (first | second << 16))
          fail_msg("%s: %a is %04x, expected %04x; behind it %04x, expected %04x", how[h].name, (double)x.data[at],
                   found & 0xffff, first, found >> 16, second);
        assert_int_equal(ern_bf16(x.data[at]), first);
      }
    }
  }
  machines_clear();
}

/* ---- the product ------------------------------------------------------------------------------------------------- */

struct layer {
  size_t rows, columns, pairs;
  struct array start, weight, packed, x, input;
};

static struct layer layer_make(size_t rows, size_t columns, bool wild, uint64_t seed) {
  struct layer layer = {.rows = rows, .columns = columns, .pairs = ern_pairs(columns)};
  layer.start = array_make(rows * TILE);
  layer.weight = array_make(rows * columns);
  layer.packed = array_make(ern_pack_count(rows, layer.pairs));
  layer.x = array_make(columns * TILE);
  layer.input = array_make(layer.pairs * TILE);
  fill_random(layer.start.data, layer.start.count, seed, 1);
  fill_random(layer.weight.data, layer.weight.count, seed + 1, 1);
  fill_random(layer.x.data, layer.x.count, seed + 2, 1);
  for (size_t i = 0; wild && i < columns * TILE; i++)
    if (random_bits(seed + 3, i) % 16 == 0) layer.x.data[i] = float_of(pair_at(seed + 4, i, false));
  ern_pack_pairs(layer.packed.data, layer.pairs, 0, layer.weight.data, columns, rows, columns);
  array_check(&layer.packed);
  bf16_rows_emulated(layer.input.data, layer.x.data, columns);
  return layer;
}

/* start + W x by the definition, from what is not packed */
static float expected_at(const struct layer *layer, size_t row, size_t sample, bool started) {
  float sum = started ? layer->start.data[row * TILE + sample] : 0;
  for (size_t c = 0; c < layer->columns; c += 2) {
    const float *w = layer->weight.data + row * layer->columns + c, *x = layer->x.data + c * TILE + sample;
    const bool both = c + 1 < layer->columns;
    sum = add_pair(sum, ern_bf16(w[0]) | (both ? ern_bf16(w[1]) << 16 : 0),
                   ern_bf16(x[0]) | (both ? ern_bf16(x[TILE]) << 16 : 0));
  }
  return sum;
}

static void expect_product(const struct layer *layer, bool started, bool relu) {
  const size_t count = (relu ? ern_pairs(layer->rows) : layer->rows) * TILE;
  for (size_t h = 0; h < HOW; h++) {
    if (!ern_isa_available(how[h].isa)) continue;
    const struct machines_mark mark = machines_mark();
    const struct array out = array_make(count);
    how[h].product(out.data, started ? layer->start.data : NULL, layer->packed.data, layer->input.data, layer->rows,
                   layer->pairs, relu);
    array_check(&out);
    for (size_t i = 0; i < count; i++) {
      const size_t row = i / TILE, sample = i % TILE;
      if (!relu) {
        const float expected = expected_at(layer, row, sample, started);
        if (!same(out.data[i], expected))
          fail_msg("%s, %zu x %zu: row %zu of sample %zu is %a, expected %a", how[h].name, layer->rows, layer->columns,
                   row, sample, (double)out.data[i], (double)expected);
        continue;
      }
      for (size_t half = 0; half < 2; half++) {
        const uint32_t found = bits_of(out.data[i]) >> (16 * half) & 0xffff;
        const float sum = 2 * row + half < layer->rows ? expected_at(layer, 2 * row + half, sample, started) : 0;
        const float expected = sum < 0 ? 0 : sum;
        if (isnan(expected) ? !isnan(float_of(found << 16)) : found != ern_bf16(expected))
          fail_msg("%s, %zu x %zu: row %zu of sample %zu is %04x, expected %04x", how[h].name, layer->rows,
                   layer->columns, 2 * row + half, sample, found, ern_bf16(expected));
      }
    }
    machines_clear_to(mark);
  }
}

/* The model's layers among them: 42 features, 107 inputs of the density in their three parts; 64, 16, 3 and 1 rows. */
static void test_products(void **state) {
  (void)state;
  static const size_t rows[] = {1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 64},
                      columns[] = {1, 2, 3, 6, 7, 16, 36, 39, 42, 64, 107};
  for (size_t r = 0; r < sizeof rows / sizeof *rows; r++) {
    for (size_t c = 0; c < sizeof columns / sizeof *columns; c++) {
      for (int wild = 0; wild < 2; wild++) {
        struct layer layer = layer_make(rows[r], columns[c], wild != 0, 7 * r + c);
        for (int choice = 0; choice < 4; choice++) expect_product(&layer, (choice & 1) != 0, (choice & 2) != 0);
        machines_clear();
      }
    }
  }
}

/* Parts of a layer's input that are packed one by one: each is filled up to whole pairs. */
static void test_parts(void **state) {
  (void)state;
  enum { ROWS = 11, FIRST = 5, SECOND = 4, LAST = 1, COLUMNS = FIRST + SECOND + LAST, PAIRS = 3 + 2 + 1 };
  const struct array weight = array_make(ROWS * COLUMNS), packed = array_make(ern_pack_count(ROWS, PAIRS));
  fill_random(weight.data, weight.count, 31, 1);
  ern_pack_pairs(packed.data, PAIRS, 0, weight.data, COLUMNS, ROWS, FIRST);
  ern_pack_pairs(packed.data, PAIRS, 3, weight.data + FIRST, COLUMNS, ROWS, SECOND);
  ern_pack_pairs(packed.data, PAIRS, 5, weight.data + FIRST + SECOND, COLUMNS, ROWS, LAST);
  array_check(&packed);
  static const int column[PAIRS][2] = {{0, 1}, {2, 3}, {4, -1}, {5, 6}, {7, 8}, {9, -1}};
  for (size_t r = 0; r < ern_pack_count(ROWS, 1); r++) {
    for (size_t p = 0; p < PAIRS; p++) {
      uint32_t expected = 0;
      for (size_t half = 0; half < 2; half++)
        if (r < ROWS && column[p][half] >= 0)
          expected |= ern_bf16(weight.data[r * COLUMNS + (size_t)column[p][half]]) << (16 * half);
      const uint32_t found = bits_of(packed.data[(r / ERN_PACK * PAIRS + p) * ERN_PACK + r % ERN_PACK]);
      assert_int_equal(found, expected);
    }
  }
  machines_clear();
}

/* ---- products of training ---------------------------------------------------------------------------------------- */

/* start + the sum over k of a[k*a_step] b[k*b_step], pair by pair, by the definition */
static float expected_sum(float start, const float *a, size_t a_step, const float *b, size_t b_step, size_t count) {
  float sum = start;
  for (size_t k = 0; k < count; k += 2) {
    const bool both = k + 1 < count;
    sum = add_pair(sum, ern_bf16(a[k * a_step]) | (both ? ern_bf16(a[(k + 1) * a_step]) << 16 : 0),
                   ern_bf16(b[k * b_step]) | (both ? ern_bf16(b[(k + 1) * b_step]) << 16 : 0));
  }
  return sum;
}

/* ins x outs; columns of x behind `ins` are NaNs, which no result may show. */
static void expect_rows(size_t ins, size_t outs, bool wild, uint64_t seed) {
  const size_t row = (ins + 15) / 16 * 16;
  const struct array x = array_make(TILE * row), w = array_make(ins * outs), y = array_make(TILE * outs),
                     begun = array_make(ins * outs), a = array_make(TILE * (row + 16)),
                     b = array_make((TILE + ins) * outs);
  fill_random(x.data, x.count, seed, 1);
  fill_random(w.data, w.count, seed + 1, 1);
  fill_random(y.data, y.count, seed + 2, 1);
  fill_random(begun.data, begun.count, seed + 3, 1);
  for (size_t i = 0; i < x.count; i++) {
    if (wild && random_bits(seed + 4, i) % 16 == 0) x.data[i] = float_of(pair_at(seed + 5, i, false));
    if (i % row >= ins) x.data[i] = NAN;
  }
  for (size_t h = 0; h < HOW; h++) {
    if (!ern_isa_available(how[h].isa)) continue;
    const struct machines_mark mark = machines_mark();
    const struct array out = array_make(TILE * outs), sums = array_make(ins * outs);
    how[h].forward(out.data, x.data, row, w.data, ins, outs, (float *[2]){a.data, b.data});
    memcpy(sums.data, begun.data, sums.count * sizeof *sums.data);
    how[h].sums(sums.data, x.data, row, y.data, ins, outs, (float *[2]){a.data, b.data});
    const struct array *const made[] = {&out, &sums, &a, &b};
    for (size_t i = 0; i < sizeof made / sizeof *made; i++) array_check(made[i]);
    for (size_t i = 0; i < out.count; i++) {
      const float expected = expected_sum(0, x.data + i / outs * row, 1, w.data + i % outs, outs, ins);
      if (!same(out.data[i], expected))
        fail_msg("%s, %zu to %zu: output %zu of sample %zu is %a, expected %a", how[h].name, ins, outs, i % outs,
                 i / outs, (double)out.data[i], (double)expected);
    }
    for (size_t i = 0; i < sums.count; i++) {
      const float sum = expected_sum(0, x.data + i / outs, row, y.data + i % outs, outs, TILE);
      if (!same(sums.data[i], sum + begun.data[i]))
        fail_msg("%s, %zu to %zu: sum %zu is %a, expected %a", how[h].name, ins, outs, i, (double)sums.data[i],
                 (double)(sum + begun.data[i]));
    }
    machines_clear_to(mark);
  }
}

/* The layers' sizes among them: 42 features, 75 inputs of the density, 81 of the colour; 112 hidden units. */
static void test_rows(void **state) {
  (void)state;
  static const size_t ins[] = {1, 2, 3, 15, 16, 17, 31, 32, 33, 42, 64, 65, 75, 81}, outs[] = {16, 32, 48, 64, 80, 112};
  for (size_t i = 0; i < sizeof ins / sizeof *ins; i++) {
    for (size_t o = 0; o < sizeof outs / sizeof *outs; o++) {
      for (int wild = 0; wild < 2; wild++) {
        expect_rows(ins[i], outs[o], wild != 0, 40 + 7 * i + o);
        machines_clear();
      }
    }
  }
}

static int open_one(void **state) {
  (void)state;
  machines_open_as(&(struct machines_wish){.isa = "ref"});
  return 0;
}

int main(void) {
  for (size_t h = 0; h < HOW; h++)
    if (!ern_isa_available(how[h].isa)) print_message("not on this machine: %s\n", how[h].name);
  if (!ern_isa_available(ERN_ISA_AVX512)) return 0;
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_add),      cmocka_unit_test(test_smallest), cmocka_unit_test(test_conversion),
      cmocka_unit_test(test_products), cmocka_unit_test(test_parts),    cmocka_unit_test(test_rows),
  };
  return cmocka_run_group_tests(tests, open_one, close_machines);
}

#else
int main(void) {
  print_message("this build has no kernels for AVX-512\n");
  return 0;
}
#endif
