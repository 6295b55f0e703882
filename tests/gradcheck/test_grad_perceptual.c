/* SPDX-License-Identifier: MIT
 * The distance of pictures by a convolutional network against its definition in double, and its gradient against
 * central differences of that, on small networks of the architecture of AlexNet and of VGG16 with made weights. */
#include <dlfcn.h>
#include <math.h>

#include "perceptual/perceptual.h"
#include "support.h"

#if ERN_PERCEPTUAL
#define TEXT_OF(x) #x
#define SONAME(major) "libernerf-perceptual.so." TEXT_OF(major)

enum { MOST_LAYERS = 8, MOST_SIDE = 40, MOST_VALUES = 16 * MOST_SIDE * MOST_SIDE, MOST_WEIGHTS = 16 * 16 * 121 };

struct net {
  int layers;
  struct ern_perceptual_layer layer[MOST_LAYERS];
  float weight[MOST_LAYERS][MOST_WEIGHTS], bias[MOST_LAYERS][16], head[MOST_LAYERS][16];
};

static uint32_t noise_state;
static float noise(float low, float high) {
  noise_state = noise_state * 1664525u + 1013904223u;
  return low + (high - low) * (float)(noise_state >> 8) / 16777216.0f;
}

/* {out, size, stride, padding, pool, compared} */
static void make_net(struct net *net, const int (*shape)[6], int layers, uint32_t seed) {
  noise_state = seed;
  net->layers = layers;
  for (int l = 0, in = 3; l < layers; in = shape[l++][0]) {
    struct ern_perceptual_layer *layer = &net->layer[l];
    const int out = shape[l][0], size = shape[l][1];
    const float most = sqrtf(6.0f / (float)(in * size * size));
    *layer = (struct ern_perceptual_layer){.weight = net->weight[l],
                                           .bias = net->bias[l],
                                           .head = shape[l][5] != 0 ? net->head[l] : NULL,
                                           .in = in,
                                           .out = out,
                                           .size = size,
                                           .stride = shape[l][2],
                                           .padding = shape[l][3],
                                           .pool = shape[l][4]};
    assert_true(out * in * size * size <= MOST_WEIGHTS && out <= 16);
    for (int i = 0; i < out * in * size * size; i++) net->weight[l][i] = noise(-most, most);
    for (int i = 0; i < out; i++) net->bias[l][i] = noise(-0.1f, 0.3f), net->head[l][i] = noise(0, 1);
  }
}

/* ---- the definition ---- */

struct picture {
  int channels, height, width;
  double v[MOST_VALUES];
};

static double value_of(const struct picture *p, int c, int y, int x) {
  return y < 0 || x < 0 || y >= p->height || x >= p->width ? 0 : p->v[(c * p->height + y) * p->width + x];
}

static void apply(struct picture *out, const struct picture *in, const struct ern_perceptual_layer *layer) {
  static struct picture pooled;
  pooled = *in;
  if (layer->pool > 0) {
    pooled.height = (in->height - layer->pool) / 2 + 1;
    pooled.width = (in->width - layer->pool) / 2 + 1;
    for (int c = 0; c < in->channels; c++)
      for (int y = 0; y < pooled.height; y++)
        for (int x = 0; x < pooled.width; x++) {
          double most = -INFINITY;
          for (int i = 0; i < layer->pool * layer->pool; i++)
            most = fmax(most, value_of(in, c, 2 * y + i / layer->pool, 2 * x + i % layer->pool));
          pooled.v[(c * pooled.height + y) * pooled.width + x] = most;
        }
  }
  const int k = layer->size;
  out->channels = layer->out;
  out->height = (pooled.height + 2 * layer->padding - k) / layer->stride + 1;
  out->width = (pooled.width + 2 * layer->padding - k) / layer->stride + 1;
  for (int o = 0; o < layer->out; o++)
    for (int y = 0; y < out->height; y++)
      for (int x = 0; x < out->width; x++) {
        double sum = (double)layer->bias[o];
        for (int c = 0; c < layer->in; c++)
          for (int i = 0; i < k * k; i++)
            sum += (double)layer->weight[(o * layer->in + c) * k * k + i] *
                   value_of(&pooled, c, y * layer->stride + i / k - layer->padding,
                            x * layer->stride + i % k - layer->padding);
        out->v[(o * out->height + y) * out->width + x] = fmax(sum, 0);
      }
}

static double norm_at(const struct picture *p, int y, int x) {
  double sum = 0;
  for (int c = 0; c < p->channels; c++) sum += value_of(p, c, y, x) * value_of(p, c, y, x);
  return sqrt(sum) + 1e-10;
}

static void scale_input(struct picture *p, const double *rgb, int side) {
  static const double shift[3] = {-0.030, -0.088, -0.188}, scale[3] = {0.458, 0.448, 0.450};
  p->channels = 3;
  p->height = p->width = side;
  for (int i = 0; i < 3 * side * side; i++)
    p->v[i] = (2 * rgb[i] - 1 - shift[i / (side * side)]) / scale[i / (side * side)];
}

static double distance_of(const struct net *net, const double *rgb, const double *truth, int side) {
  static struct picture a, b, next;
  double sum = 0;
  scale_input(&a, rgb, side);
  scale_input(&b, truth, side);
  for (int l = 0; l < net->layers; l++) {
    apply(&next, &a, &net->layer[l]);
    a = next;
    apply(&next, &b, &net->layer[l]);
    b = next;
    if (net->layer[l].head == NULL) continue;
    double part = 0;
    for (int y = 0; y < a.height; y++)
      for (int x = 0; x < a.width; x++)
        for (int c = 0; c < a.channels; c++) {
          const double apart = value_of(&a, c, y, x) / norm_at(&a, y, x) - value_of(&b, c, y, x) / norm_at(&b, y, x);
          part += (double)net->layer[l].head[c] * apart * apart;
        }
    sum += part / (a.height * a.width);
  }
  return sum;
}

/* ---- against it ---- */

static const struct ern_perceptual *library;

static int open_library(void **state) {
  (void)state;
  void *handle = dlopen(SONAME(ERN_VERSION_MAJOR), RTLD_NOW);
  if (handle == NULL) fail_msg("%s", dlerror());
  library = dlsym(handle, "ern_perceptual");
  assert_non_null(library);
  return 0;
}

static const int like_alexnet[][6] = {
    {8, 11, 4, 2, 0, 1}, {12, 5, 1, 2, 3, 1}, {16, 3, 1, 1, 3, 1}, {10, 3, 1, 1, 0, 1}, {10, 3, 1, 1, 0, 1}};
static const int like_vgg16[][6] = {{6, 3, 1, 1, 0, 0},  {6, 3, 1, 1, 0, 1},  {8, 3, 1, 1, 2, 0}, {8, 3, 1, 1, 0, 1},
                                    {12, 3, 1, 1, 2, 0}, {12, 3, 1, 1, 0, 1}, {16, 3, 1, 1, 2, 1}};

struct pair {
  int side;
  float picture[3 * MOST_SIDE * MOST_SIDE], truth[3 * MOST_SIDE * MOST_SIDE];
  double x[3 * MOST_SIDE * MOST_SIDE], y[3 * MOST_SIDE * MOST_SIDE];
};

enum kind { NOISE, FLAT, SATURATED, ALIKE, KINDS };

static void fill(struct pair *pair, int side, enum kind kind) {
  pair->side = side;
  for (int i = 0; i < 3 * side * side; i++) {
    const float a = noise(0, 1), b = noise(0, 1);
    pair->picture[i] = kind == NOISE       ? a
                       : kind == FLAT      ? 0.6f
                       : kind == SATURATED ? (float)(a < 0.5f)
                                           : 0.5f + 0.001f * a;
    pair->truth[i] = kind == NOISE ? b : kind == FLAT ? 0.3f : kind == SATURATED ? (float)(b < 0.5f) : 0.5f;
    pair->x[i] = (double)pair->picture[i], pair->y[i] = (double)pair->truth[i];
  }
}

/* The value to 1e-4 of itself; the gradient, at some pixels, to 1e-4 of its largest. Where a max(x, 0) or a maximum of
 * equal values has its corner (flat pictures are full of them) the differences to both sides are not the same, and
 * nothing is compared. Of pictures that differ by 0.001 the features differ by as little: of single precision's 6e-8
 * some 1e-4 of that is left, and sums of them have 1e-3. */
static void check(const struct net *net, struct ern_perceptual_network *network, struct pair *pair, enum kind kind) {
  static float gradient[3 * MOST_SIDE * MOST_SIDE];
  char words[ERN_PERCEPTUAL_WORDS] = "";
  const double tolerance = kind == ALIKE ? 1e-3 : 1e-4;
  const int count = 3 * pair->side * pair->side;
  double found = -1, alone = -1, largest = 0;
  assert_int_equal(
      library->distance(network, pair->picture, pair->truth, pair->side, pair->side, &found, gradient, words), ERN_OK);
  assert_int_equal(library->distance(network, pair->picture, pair->truth, pair->side, pair->side, &alone, NULL, words),
                   ERN_OK);
  assert_true(found == alone);
  const double expected = distance_of(net, pair->x, pair->y, pair->side);
  if (!(fabs(found - expected) <= tolerance * expected)) fail_msg("distance %.9g, expected %.9g", found, expected);
  for (int i = 0; i < count; i++) largest = fmax(largest, fabs((double)gradient[i]));
  assert_true(largest > 0);
  int smooth = 0;
  for (int i = 7; i < count; i += count / 40) {
    const double h = 3e-8, at = pair->x[i];
    pair->x[i] = at + h;
    const double above = distance_of(net, pair->x, pair->y, pair->side);
    pair->x[i] = at - h;
    const double below = distance_of(net, pair->x, pair->y, pair->side);
    pair->x[i] = at;
    const double bend = (above - 2 * expected + below) / h, difference = (above - below) / (2 * h);
    if (fabs(bend) > 1e-4 * largest) continue;
    smooth++;
    if (!(fabs((double)gradient[i] - difference) <= tolerance * largest))
      fail_msg("gradient [%d] %.9g, expected %.9g; the largest is %.3g", i, (double)gradient[i], difference, largest);
  }
  assert_true(smooth >= (kind == FLAT ? 0 : 30));
}

static void test_definition(void **state) {
  (void)state;
  static struct net net;
  static struct pair pair;
  char words[ERN_PERCEPTUAL_WORDS] = "";
  for (int kind = 0; kind < KINDS; kind++)
    for (int vgg = 0; vgg < 2; vgg++) {
      struct ern_perceptual_network *network = NULL;
      if (vgg == 0)
        make_net(&net, like_alexnet, 5, 3);
      else
        make_net(&net, like_vgg16, 7, 4);
      assert_int_equal(library->open(net.layer, net.layers, &network, words), ERN_OK);
      fill(&pair, vgg == 0 ? 39 : 18, (enum kind)kind);
      check(&net, network, &pair, (enum kind)kind);
      fill(&pair, vgg == 0 ? 31 : 16, (enum kind)kind); /* another size on the same network */
      check(&net, network, &pair, (enum kind)kind);
      library->free(network);
    }
}

/* Equal pictures are at distance 0 without a gradient; a picture without any feature is finite. */
static void test_equal_and_dead(void **state) {
  (void)state;
  static struct net net;
  static struct pair pair;
  static float gradient[3 * MOST_SIDE * MOST_SIDE];
  struct ern_perceptual_network *network = NULL;
  char words[ERN_PERCEPTUAL_WORDS] = "";
  double distance = -1;
  for (int dead = 0; dead < 2; dead++) {
    make_net(&net, like_vgg16, 7, 5);
    for (int l = 0; dead == 1 && l < net.layers; l++)
      for (int i = 0; i < 16; i++) net.bias[l][i] = -100;
    assert_int_equal(library->open(net.layer, net.layers, &network, words), ERN_OK);
    fill(&pair, 16, NOISE);
    assert_int_equal(library->distance(network, pair.picture, dead == 1 ? pair.truth : pair.picture, 16, 16, &distance,
                                       gradient, words),
                     ERN_OK);
    assert_true(distance == 0);
    for (int i = 0; i < 3 * 16 * 16; i++) assert_true(gradient[i] == 0);
    library->free(network);
  }
}

static void test_too_small(void **state) {
  (void)state;
  static struct net net;
  static struct pair pair;
  struct ern_perceptual_network *network = NULL;
  char words[ERN_PERCEPTUAL_WORDS] = "";
  double distance = -1;
  make_net(&net, like_alexnet, 5, 3);
  assert_int_equal(library->open(net.layer, net.layers, &network, words), ERN_OK);
  fill(&pair, 20, NOISE);
  for (int side = 1; side <= 20; side += 19)
    assert_int_equal(library->distance(network, pair.picture, pair.truth, side, side, &distance, NULL, words),
                     ERN_E_ARGUMENT);
  assert_non_null(strstr(words, "too small"));
  assert_int_equal(library->distance(network, pair.picture, pair.truth, 5, 3, &distance, NULL, words), ERN_E_ARGUMENT);
  fill(&pair, 31, NOISE); /* it goes on with a picture that is not */
  assert_int_equal(library->distance(network, pair.picture, pair.truth, 31, 31, &distance, NULL, words), ERN_OK);
  library->free(network);
  library->free(NULL);
}

int main(void) {
  const struct CMUnitTest tests[] = {cmocka_unit_test(test_definition), cmocka_unit_test(test_equal_and_dead),
                                     cmocka_unit_test(test_too_small)};
  return cmocka_run_group_tests(tests, open_library, NULL);
}
#else
int main(void) { return 0; }
#endif
