/* SPDX-License-Identifier: MIT
 * The network of perceptual.h by oneDNN, on the CPU. Features between layers are [height][width][channels] (NHWC). No
 * exception and no C++ type leaves this file. */
#include <cmath>
#include <cstdio>
#include <exception>
#include <new>
#include <oneapi/dnnl/dnnl.hpp>
#include <string>
#include <utility>
#include <vector>

#include "core/interface_version.h"
#include "perceptual/perceptual.h"

/* Functions of the OpenMP runtime, NULL where oneDNN was built without OpenMP. */
extern "C" __attribute__((weak)) void omp_set_num_threads(int);
extern "C" __attribute__((weak)) int omp_get_max_threads(void);

namespace {

using dnnl::memory;
using tag = memory::format_tag;

const float shift[3] = {-0.030f, -0.088f, -0.188f}, scale[3] = {0.458f, 0.448f, 0.450f};
const double least_norm = 1e-10;

struct Layer {
  ern_perceptual_layer about; /* its pointers are not used */
  std::vector<float> weight, bias, head;
};

struct TooSmall : std::exception {};

memory::desc features(int channels, int height, int width) {
  return {{1, channels, height, width}, memory::data_type::f32, tag::nhwc};
}

/* One layer for pictures of one size. */
struct Stage {
  memory::desc in, pooled, out;
  dnnl::pooling_forward pool;
  dnnl::pooling_backward pool_bwd;
  dnnl::convolution_forward convolution;
  dnnl::convolution_backward_data convolution_bwd;
  memory weight, weight_bwd, bias; /* in the memory formats of forward and backward */
  memory::desc workspace;
  int height = 0, width = 0; /* of its features */

  Stage(const Layer &layer, int in_height, int in_width, const dnnl::engine &engine, dnnl::stream &stream);
};

memory reordered(const Layer &layer, const memory::desc &wanted, const dnnl::engine &engine, dnnl::stream &stream) {
  const ern_perceptual_layer &l = layer.about;
  const memory::desc plain({l.out, l.in, l.size, l.size}, memory::data_type::f32, tag::oihw);
  memory from(plain, engine, const_cast<float *>(layer.weight.data())), to(wanted, engine);
  dnnl::reorder(from, to).execute(stream, from, to);
  stream.wait();
  return to;
}

Stage::Stage(const Layer &layer, int in_height, int in_width, const dnnl::engine &engine, dnnl::stream &stream) {
  const ern_perceptual_layer &l = layer.about;
  int h = in_height, w = in_width;
  in = pooled = features(l.in, h, w);
  if (l.pool > 0) {
    if (h < l.pool || w < l.pool) throw TooSmall();
    h = (h - l.pool) / 2 + 1, w = (w - l.pool) / 2 + 1;
    pooled = features(l.in, h, w);
    const memory::dims step{2, 2}, window{l.pool, l.pool}, none{0, 0};
    const dnnl::pooling_forward::desc forward(dnnl::prop_kind::forward_training, dnnl::algorithm::pooling_max, in,
                                              pooled, step, window, none, none);
    const dnnl::pooling_forward::primitive_desc about(forward, engine);
    const dnnl::pooling_backward::desc backward(dnnl::algorithm::pooling_max, in, pooled, step, window, none, none);
    pool = dnnl::pooling_forward(about);
    pool_bwd = dnnl::pooling_backward(dnnl::pooling_backward::primitive_desc(backward, engine, about));
    workspace = about.workspace_desc();
  }
  if (h + 2 * l.padding < l.size || w + 2 * l.padding < l.size) throw TooSmall();
  height = (h + 2 * l.padding - l.size) / l.stride + 1, width = (w + 2 * l.padding - l.size) / l.stride + 1;
  out = features(l.out, height, width);
  const memory::desc any({l.out, l.in, l.size, l.size}, memory::data_type::f32, tag::any);
  const memory::desc bias_desc({l.out}, memory::data_type::f32, tag::a);
  const memory::dims step{l.stride, l.stride}, border{l.padding, l.padding};
  const dnnl::convolution_forward::desc forward(dnnl::prop_kind::forward_training, dnnl::algorithm::convolution_direct,
                                                pooled, any, bias_desc, out, step, border, border);
  const dnnl::convolution_forward::primitive_desc about(forward, engine);
  const dnnl::convolution_backward_data::desc backward(dnnl::algorithm::convolution_direct, pooled, any, out, step,
                                                       border, border);
  const dnnl::convolution_backward_data::primitive_desc about_bwd(backward, engine, about);
  convolution = dnnl::convolution_forward(about);
  convolution_bwd = dnnl::convolution_backward_data(about_bwd);
  weight = reordered(layer, about.weights_desc(), engine, stream);
  weight_bwd = reordered(layer, about_bwd.weights_desc(), engine, stream);
  bias = memory(bias_desc, engine, const_cast<float *>(layer.bias.data()));
}

/* The stored values of one picture at a layer. */
struct Activation {
  memory pooled, workspace, out;
};

size_t count_of(const memory &values) { return values.get_desc().get_size() / sizeof(float); }
float *data_of(const memory &values) { return static_cast<float *>(values.get_data_handle()); }

double inverse_norm(const float *f, size_t channels) {
  double sum = 0;
  for (size_t c = 0; c < channels; c++) sum += static_cast<double>(f[c]) * static_cast<double>(f[c]);
  return 1 / (std::sqrt(sum) + least_norm);
}

/* Returns the layer's part of the distance; gradient (NULL: not wanted) = its derivative by f. With u = f/n, n = |f| +
 * 1e-10, and e_c = 2 w_c (u_c - v_c): df_c = (e_c - u_c sum_k e_k f_k/|f|)/n. A pixel without features has none. */
double compare(const Layer &layer, const memory &picture, const memory &truth, float *gradient) {
  const size_t channels = layer.head.size(), pixels = count_of(picture) / channels;
  double sum = 0;
  for (size_t p = 0; p < pixels; p++) {
    const float *f = data_of(picture) + p * channels, *g = data_of(truth) + p * channels;
    const double by_f = inverse_norm(f, channels), by_g = inverse_norm(g, channels);
    double along = 0;
    for (size_t c = 0; c < channels; c++) {
      const double apart = static_cast<double>(f[c]) * by_f - static_cast<double>(g[c]) * by_g;
      const double weight = static_cast<double>(layer.head[c]);
      sum += weight * apart * apart;
      along += 2 * weight * apart * static_cast<double>(f[c]);
    }
    if (gradient == nullptr) continue;
    const double norm = 1 / by_f - least_norm, shrink = norm > 0 ? along * by_f / norm : 0;
    for (size_t c = 0; c < channels; c++) {
      const double apart = static_cast<double>(f[c]) * by_f - static_cast<double>(g[c]) * by_g;
      const double e = 2 * static_cast<double>(layer.head[c]) * apart;
      gradient[p * channels + c] =
          norm > 0 ? static_cast<float>((e - static_cast<double>(f[c]) * shrink) * by_f / static_cast<double>(pixels))
                   : 0;
    }
  }
  return sum / static_cast<double>(pixels);
}

}  // namespace

struct ern_perceptual_network {
  std::vector<Layer> layers;
  dnnl::engine engine{dnnl::engine::kind::cpu, 0};
  dnnl::stream stream{engine};
  int height = 0, width = 0; /* that the stages are made for */
  std::vector<Stage> stages;

  void prepare(int new_height, int new_width);
  memory input(const float *picture);
  Activation forward(const Stage &stage, memory &in);
  memory backward(const Stage &stage, const Activation &activation, const memory &dout);
  double distance(const float *picture, const float *truth, float *gradient);
};

void ern_perceptual_network::prepare(int new_height, int new_width) {
  if (height == new_height && width == new_width) return;
  int h = new_height, w = new_width;
  height = width = 0;
  stages.clear();
  for (const Layer &layer : layers) {
    stages.emplace_back(layer, h, w, engine, stream);
    h = stages.back().height, w = stages.back().width;
  }
  height = new_height, width = new_width;
}

memory ern_perceptual_network::input(const float *picture) {
  const size_t pixels = static_cast<size_t>(height) * static_cast<size_t>(width);
  memory made(features(3, height, width), engine);
  for (size_t p = 0; p < pixels; p++)
    for (size_t c = 0; c < 3; c++) data_of(made)[3 * p + c] = (2 * picture[c * pixels + p] - 1 - shift[c]) / scale[c];
  return made;
}

Activation ern_perceptual_network::forward(const Stage &stage, memory &in) {
  Activation a;
  a.pooled = in;
  a.out = memory(stage.out, engine);
  if (stage.pool) {
    a.pooled = memory(stage.pooled, engine);
    a.workspace = memory(stage.workspace, engine);
    stage.pool.execute(stream, {{DNNL_ARG_SRC, in}, {DNNL_ARG_DST, a.pooled}, {DNNL_ARG_WORKSPACE, a.workspace}});
  }
  stage.convolution.execute(
      stream,
      {{DNNL_ARG_SRC, a.pooled}, {DNNL_ARG_WEIGHTS, stage.weight}, {DNNL_ARG_BIAS, stage.bias}, {DNNL_ARG_DST, a.out}});
  stream.wait();
  float *out = data_of(a.out);
  for (size_t i = 0; i < count_of(a.out); i++) out[i] = out[i] > 0 ? out[i] : 0;
  return a;
}

/* Backward pass from the gradient of a layer's features to that of its input. dout: overwritten */
memory ern_perceptual_network::backward(const Stage &stage, const Activation &activation, const memory &dout) {
  for (size_t i = 0; i < count_of(dout); i++)
    if (!(data_of(activation.out)[i] > 0)) data_of(dout)[i] = 0;
  memory dpooled(stage.pooled, engine);
  stage.convolution_bwd.execute(
      stream, {{DNNL_ARG_DIFF_DST, dout}, {DNNL_ARG_WEIGHTS, stage.weight_bwd}, {DNNL_ARG_DIFF_SRC, dpooled}});
  if (!stage.pool_bwd) {
    stream.wait();
    return dpooled;
  }
  memory din(stage.in, engine);
  stage.pool_bwd.execute(
      stream, {{DNNL_ARG_DIFF_DST, dpooled}, {DNNL_ARG_WORKSPACE, activation.workspace}, {DNNL_ARG_DIFF_SRC, din}});
  stream.wait();
  return din;
}

double ern_perceptual_network::distance(const float *picture, const float *truth, float *gradient) {
  const bool wanted = gradient != nullptr;
  memory x = input(picture), y = input(truth);
  std::vector<Activation> kept;
  std::vector<std::vector<float>> gradients(layers.size());
  double sum = 0;
  for (size_t l = 0; l < layers.size(); l++) {
    Activation of_picture = forward(stages[l], x);
    y = forward(stages[l], y).out;
    x = of_picture.out;
    if (wanted) kept.push_back(of_picture);
    if (layers[l].head.empty()) continue;
    if (wanted) gradients[l].resize(count_of(x));
    sum += compare(layers[l], x, y, wanted ? gradients[l].data() : nullptr);
  }
  if (!wanted) return sum;
  memory d(stages.back().out, engine);
  for (size_t i = 0; i < count_of(d); i++) data_of(d)[i] = 0;
  for (size_t l = layers.size(); l-- > 0;) {
    for (size_t i = 0; i < gradients[l].size(); i++) data_of(d)[i] += gradients[l][i];
    d = backward(stages[l], kept[l], d);
  }
  const size_t pixels = static_cast<size_t>(height) * static_cast<size_t>(width);
  for (size_t p = 0; p < pixels; p++)
    for (size_t c = 0; c < 3; c++) gradient[c * pixels + p] = data_of(d)[3 * p + c] * 2 / scale[c];
  return sum;
}

namespace {

void put(char words[ERN_PERCEPTUAL_WORDS], const char *text) { std::snprintf(words, ERN_PERCEPTUAL_WORDS, "%s", text); }

/* Limits OpenMP to one thread in this scope: oneDNN's idle threads spin, which slows down other work on the cores, and
 * sums would depend on the number of threads. */
class OneThread {
 public:
  OneThread() : before_(omp_get_max_threads != nullptr ? omp_get_max_threads() : 1) { set(1); }
  ~OneThread() { set(before_); }
  OneThread(const OneThread &) = delete;
  OneThread &operator=(const OneThread &) = delete;

 private:
  static void set(int threads) {
    if (omp_set_num_threads != nullptr) omp_set_num_threads(threads);
  }
  int before_;
};

/* Runs `work`; turns an exception into a status and an error text. */
template <typename Work>
ern_status guarded(char words[ERN_PERCEPTUAL_WORDS], const Work &work) {
  const OneThread one;
  try {
    work();
    return ERN_OK;
  } catch (const TooSmall &) {
    put(words, "the picture is too small for the network");
    return ERN_E_ARGUMENT;
  } catch (const std::bad_alloc &) {
    put(words, "no memory");
    return ERN_E_NO_MEMORY;
  } catch (const dnnl::error &error) {
    put(words, error.what());
    return error.status == dnnl_out_of_memory ? ERN_E_NO_MEMORY : ERN_E_UNSUPPORTED;
  } catch (const std::exception &error) {
    put(words, error.what());
    return ERN_E_UNSUPPORTED;
  }
}

ern_status open_network(const ern_perceptual_layer *layer, int layers, ern_perceptual_network **network,
                        char words[ERN_PERCEPTUAL_WORDS]) {
  *network = nullptr;
  return guarded(words, [&] {
    auto made = new ern_perceptual_network;
    *network = made;
    for (int i = 0; i < layers; i++) {
      const ern_perceptual_layer &l = layer[i];
      const size_t out = static_cast<size_t>(l.out);
      Layer copy{l, {}, {}, {}};
      copy.weight.assign(l.weight, l.weight + out * static_cast<size_t>(l.in) * static_cast<size_t>(l.size * l.size));
      copy.bias.assign(l.bias, l.bias + out);
      if (l.head != nullptr) copy.head.assign(l.head, l.head + out);
      made->layers.push_back(std::move(copy));
    }
  });
}

ern_status distance_of(ern_perceptual_network *network, const float *picture, const float *truth, int width, int height,
                       double *distance, float *gradient, char words[ERN_PERCEPTUAL_WORDS]) {
  return guarded(words, [&] {
    network->prepare(height, width);
    *distance = network->distance(picture, truth, gradient);
  });
}

void free_network(ern_perceptual_network *network) { delete network; }

#define TEXT_OF(x) #x
#define VERSION_OF(major, minor, patch) TEXT_OF(major) "." TEXT_OF(minor) "." TEXT_OF(patch)

}  // namespace

const struct ern_perceptual ern_perceptual = {ERN_INTERFACE_VERSION,
                                              VERSION_OF(DNNL_VERSION_MAJOR, DNNL_VERSION_MINOR, DNNL_VERSION_PATCH),
                                              open_network, distance_of, free_network};
