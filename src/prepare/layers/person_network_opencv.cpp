/* SPDX-License-Identifier: MIT
 * Segments the person by a network that the user supplies as an ONNX file, by OpenCV's DNN module. */
#include <cmath>

#include "prepare/layers/layers_opencv.h"
#include "prepare/onnx_network_opencv.h"

namespace {

const ern_network_colours ways[] = {
    {false, {0, 0, 0}, {255, 255, 255}},
    {false, {127.5, 127.5, 127.5}, {127.5, 127.5, 127.5}},
    {false, {123.675, 116.28, 103.53}, {58.395, 57.12, 57.375}},             /* ImageNet */
    {true, {102.890434, 111.25247, 126.91212}, {16047.9, 16019.5, 16920.7}}, /* SINet */
    {true, {0, 0, 0}, {255, 255, 255}},
    {true, {127.5, 127.5, 127.5}, {127.5, 127.5, 127.5}},
    {false, {0, 0, 0}, {1, 1, 1}},
};

}  // namespace

struct ern_person_network {
  ern_context *context;
  std::string path;
  cv::dnn::Net net;
  ern_onnx look;
  int way;    /* index of `ways`, -1: not determined yet */
  bool other; /* the person is the other channel, or has the low values */
};

namespace {

/* Probability of the person with one colour normalisation; CV_32F of the network's size. */
cv::Mat run(ern_person_network &network, const cv::Mat &frame, const ern_network_colours &way) {
  const int *size = network.look.shape;
  cv::Mat small;
  cv::resize(frame, small, cv::Size(size[3], size[2]), 0, 0, cv::INTER_AREA);
  network.net.setInput(ern_network_input(small, way));
  cv::Mat out = network.net.forward(network.look.output[0]);
  if (!out.isContinuous()) out = out.clone();
  if (out.type() != CV_32F || out.dims < 3 || out.dims > 4 || (out.dims == 4 && out.size[0] != 1))
    CV_Error(cv::Error::StsBadSize, "the output is no picture of 32-bit floats");
  const int channels = out.size[out.dims - 3], rows = out.size[out.dims - 2], columns = out.size[out.dims - 1];
  if (channels < 1 || channels > 2) CV_Error(cv::Error::StsBadSize, "the output has not one or two channels");
  if (std::fabs(double(columns) * size[2] - double(rows) * size[3]) > 0.05 * rows * size[3])
    CV_Error(cv::Error::StsBadSize, "the output has another aspect than the input");
  const float *values = out.ptr<float>();
  cv::Mat mask(rows, columns, CV_32F);
  const size_t pixels = size_t(rows) * size_t(columns);
  bool probabilities = true;
  for (size_t k = 0; k < pixels * size_t(channels); k++) {
    if (!std::isfinite(values[k])) CV_Error(cv::Error::StsBadArg, "the output is not finite");
    probabilities = probabilities && values[k] > -1e-3F && values[k] < 1.001F;
  }
  for (size_t k = 0; k < pixels; k++) {
    const float value = channels == 1 ? values[k] : probabilities ? values[pixels + k] : values[pixels + k] - values[k];
    mask.ptr<float>()[k] = probabilities ? value : 1 / (1 + std::exp(-value));
  }
  return mask;
}

/* Mean of the mask over the head minus its mean far above and beside the head. */
double tells(const cv::Mat &mask, const ern_layer_face &face, int side) {
  cv::Mat whole, head(side, side, CV_8U, cv::Scalar(0)), far(side, side, CV_8U, cv::Scalar(255));
  cv::resize(mask, whole, cv::Size(side, side), 0, 0, cv::INTER_LINEAR);
  const int chin = std::max(0, std::min(side, cvRound(face.points[8][1])));
  cv::fillPoly(head, std::vector<std::vector<cv::Point>>{ern_layer_polygon(face.outline, ERN_LAYER_OUTLINE, 0.8)}, 255);
  cv::fillPoly(far, std::vector<std::vector<cv::Point>>{ern_layer_polygon(face.outline, ERN_LAYER_OUTLINE, 1.6)}, 0);
  far.rowRange(chin, side).setTo(0);
  return cv::mean(whole, head)[0] - cv::mean(whole, far)[0];
}

ern_status choose(ern_person_network &network, const cv::Mat &frame, const ern_layer_face &face) {
  double best = 0.4;
  for (size_t k = 0; k < sizeof ways / sizeof *ways; k++) {
    const double score = tells(run(network, frame, ways[k]), face, frame.rows);
    if (std::fabs(score) < best + 0.02) continue;
    best = std::fabs(score);
    network.way = int(k);
    network.other = score < 0;
  }
  if (network.way >= 0) return ERN_OK;
  return ern_fail(network.context, ERN_E_UNSUPPORTED,
                  "%s: the network does not distinguish the head from what is around it in the first frame, with any "
                  "of %zu ways to scale colours; expected a network that finds a person, or --masks with a folder",
                  network.path.c_str(), sizeof ways / sizeof *ways);
}

}  // namespace

ern_status ern_person_network_open(ern_context *context, const char *path, ern_person_network **network) {
  *network = nullptr;
  return ern_layers_guarded(context, [&] {
    *network = new ern_person_network{context, path, {}, {}, -1, false};
    return ern_network_open(context, path, &(*network)->look, &(*network)->net);
  });
}

void ern_person_network_free(ern_person_network *network) { delete network; }

ern_status ern_person_network_run(ern_person_network *network, const uint8_t *rgb, const ern_layer_face *face, int side,
                                  uint8_t *mask) {
  return ern_layers_guarded(network->context, [&] {
    const cv::Mat frame(side, side, CV_8UC3, const_cast<uint8_t *>(rgb));
    cv::Mat found, out(side, side, CV_8U, mask);
    try {
      if (network->way < 0) {
        const ern_status status = choose(*network, frame, *face);
        if (status != ERN_OK) return status;
      }
      found = run(*network, frame, ways[network->way]);
    } catch (const cv::Exception &error) {
      return ern_fail(network->context, ERN_E_UNSUPPORTED, "%s: %.300s; expected one or two channels of the person",
                      network->path.c_str(), error.err.c_str());
    }
    if (network->other) found = 1 - found;
    cv::resize(found, found, cv::Size(side, side), 0, 0, cv::INTER_LINEAR);
    found.convertTo(out, CV_8U, 255);
    return ERN_OK;
  });
}
