/* SPDX-License-Identifier: MIT
 * Networks by OpenCV's DNN module, on the CPU, and optical flow. No exception and no C++ type leaves this file. */
#include <cstdio>
#include <exception>
#include <new>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/dnn.hpp>
#include <opencv2/video.hpp>
#include <string>

#include "core/interface_version.h"
#include "vision/vision.h"

struct ern_vision_network {
  cv::dnn::Net net;
  cv::Mat out;
};

namespace {

/* Disables OpenCV's log in this scope: it repeats the exceptions' texts on stderr. Its level is process-wide. */
class ScopedLogSilence {
 public:
  ScopedLogSilence() : before_(cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT)) {}
  ~ScopedLogSilence() { cv::utils::logging::setLogLevel(before_); }
  ScopedLogSilence(const ScopedLogSilence &) = delete;
  ScopedLogSilence &operator=(const ScopedLogSilence &) = delete;

 private:
  cv::utils::logging::LogLevel before_;
};

/* The text between the last occurrence of `first` and the next `second`; "" where either is missing. */
std::string between(const std::string &text, const std::string &first, const std::string &second) {
  const size_t at = text.rfind(first);
  if (at == std::string::npos) return "";
  const size_t begin = at + first.size(), end = text.find(second, begin);
  return end == std::string::npos ? "" : text.substr(begin, end - begin);
}

/* The lines after the last "in function '...'", each without its leading "> ", joined to one line. */
std::string below(const std::string &text) {
  const size_t mark = text.rfind(" in function "), begin = mark != std::string::npos ? text.find('\n', mark) : mark;
  std::string line;
  for (size_t i = begin; i < text.size(); i++) {
    const bool gap = text[i] == '\n' || text[i] == ' ' || (text[i] == '>' && (line.empty() || text[i - 1] == '\n'));
    const bool mark_again = text[i] == '>' && i >= 2 && text[i - 1] == ' ' && text[i - 2] == '>';
    if (!gap && !mark_again)
      line += text[i];
    else if (!line.empty() && line.back() != ' ')
      line += ' ';
  }
  while (!line.empty() && line.back() == ' ') line.pop_back();
  while (!line.empty() && (line.front() == ':' || line.front() == ' ')) line.erase(0, 1);
  return line;
}

/* Extracts from "OpenCV(4.6.0) FILE:LINE: error: (-2:Unspecified error) in function 'handleNode' > Node
 * [Einsum@ai.onnx]:(onnx_node!NAME) parse error: OpenCV(4.6.0) FILE:LINE: error: (-2:...) REASON in function..." the
 * operator, its node and the reason. */
void put(const cv::Exception &error, char words[ERN_VISION_WORDS]) {
  const std::string text = error.what(), kind = between(text, "Node [", "@");
  std::string node = between(text, "]:(", ")"), reason = between(text, "error: (", " in function");
  const size_t mark = node.find('!'), code = reason.find(") ");
  if (mark != std::string::npos) node.erase(0, mark + 1);
  if (reason.find("Assertion failed) ") != std::string::npos) reason += " does not hold";
  if (code != std::string::npos)
    reason.erase(0, code + 2);
  else if (!reason.empty() && reason.back() == ')')
    reason = below(text); /* "(-2:Unspecified error) in function" alone: the reason follows */
  if (reason.empty()) reason = error.err.empty() ? text : error.err;
  if (kind.empty())
    snprintf(words, ERN_VISION_WORDS, "%.400s", reason.c_str());
  else
    snprintf(words, ERN_VISION_WORDS, "the operator %.40s (node %.100s): %.300s", kind.c_str(), node.c_str(),
             reason.c_str());
}

/* `work` may throw anything. */
template <typename Work>
ern_status guarded(char words[ERN_VISION_WORDS], Work work) {
  try {
    const ScopedLogSilence hush;
    return work();
  } catch (const cv::Exception &error) {
    put(error, words);
    return error.code == cv::Error::StsNoMem ? ERN_E_NO_MEMORY : ERN_E_UNSUPPORTED;
  } catch (const std::bad_alloc &) {
    snprintf(words, ERN_VISION_WORDS, "no memory");
    return ERN_E_NO_MEMORY;
  } catch (const std::exception &error) {
    snprintf(words, ERN_VISION_WORDS, "%.400s", error.what());
  } catch (...) {
    snprintf(words, ERN_VISION_WORDS, "it failed and gave no reason");
  }
  return ERN_E_UNSUPPORTED;
}

ern_status network_open(const void *bytes, size_t count, ern_vision_network **network, char words[ERN_VISION_WORDS]) {
  ern_vision_network *made = nullptr;
  const ern_status status = guarded(words, [&] {
    made = new ern_vision_network;
    made->net = cv::dnn::readNetFromONNX(static_cast<const char *>(bytes), count);
    made->net.setPreferableBackend(cv::dnn::DNN_BACKEND_OPENCV);
    made->net.setPreferableTarget(cv::dnn::DNN_TARGET_CPU);
    return ERN_OK;
  });
  if (status != ERN_OK) {
    delete made;
    made = nullptr;
  }
  *network = made;
  return status;
}

ern_status network_run(ern_vision_network *network, const ern_vision_array *in, const char *output,
                       ern_vision_array *out, char words[ERN_VISION_WORDS]) {
  return guarded(words, [&] {
    const cv::Mat wave(in->dims, in->shape, CV_32F, const_cast<float *>(in->data));
    network->net.setInput(wave);
    network->out = network->net.forward(output);
    if (!network->out.isContinuous()) network->out = network->out.clone();
    const cv::Mat &made = network->out;
    if (made.type() != CV_32F || made.dims < 1 || made.dims > ERN_VISION_DIMS) {
      snprintf(words, ERN_VISION_WORDS, "the output has %d dimensions of type %s, expected 1 to %d of float", made.dims,
               cv::typeToString(made.type()).c_str(), ERN_VISION_DIMS);
      return ERN_E_UNSUPPORTED;
    }
    *out = ern_vision_array{made.ptr<float>(), made.dims, {}};
    for (int d = 0; d < made.dims; d++) out->shape[d] = made.size[d];
    return ERN_OK;
  });
}

void network_free(ern_vision_network *network) {
  char words[ERN_VISION_WORDS];
  (void)guarded(words, [&] {
    delete network;
    return ERN_OK;
  });
}

ern_status optical_flow(const unsigned char *from, const unsigned char *to, int width, int height, float *flow,
                        char words[ERN_VISION_WORDS]) {
  return guarded(words, [&] {
    const cv::Mat first(height, width, CV_8U, const_cast<unsigned char *>(from)),
        second(height, width, CV_8U, const_cast<unsigned char *>(to));
    cv::Mat made;
    cv::DISOpticalFlow::create(cv::DISOpticalFlow::PRESET_MEDIUM)->calc(first, second, made);
    made.copyTo(cv::Mat(height, width, CV_32FC2, flow));
    return ERN_OK;
  });
}

}  // namespace

const struct ern_vision ern_vision = {ERN_INTERFACE_VERSION, CV_VERSION,   network_open,
                                      network_run,           network_free, optical_flow};
