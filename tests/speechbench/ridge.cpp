/* SPDX-License-Identifier: MIT
 * Ridge regression by the normal equations and OpenCV's Cholesky decomposition. */
#include "ridge.h"

#include <opencv2/core.hpp>

struct ridge {
  cv::Mat mean, deviation, weight; /* [1][inputs], [1][inputs], [inputs][1] */
  double offset;
};

struct ridge *ridge_fit(const float *x, const double *y, size_t n, size_t inputs, double lambda) {
  cv::Mat a, mean, deviation;
  cv::Mat(int(n), int(inputs), CV_32F, const_cast<float *>(x)).convertTo(a, CV_64F);
  cv::Mat b = cv::Mat(int(n), 1, CV_64F, const_cast<double *>(y)).clone();
  const double offset = cv::mean(b)[0];
  b -= offset;
  cv::reduce(a, mean, 0, cv::REDUCE_AVG);
  a -= cv::repeat(mean, int(n), 1);
  cv::reduce(a.mul(a), deviation, 0, cv::REDUCE_AVG);
  cv::sqrt(deviation, deviation);
  deviation += 1e-6;
  a /= cv::repeat(deviation, int(n), 1);
  cv::Mat weight, squares = a.t() * a + lambda * double(n) * cv::Mat::eye(int(inputs), int(inputs), CV_64F);
  if (!cv::solve(squares, a.t() * b, weight, cv::DECOMP_CHOLESKY)) return nullptr;
  return new ridge{mean, deviation, weight, offset};
}

double ridge_value(const struct ridge *ridge, const float *x) {
  double sum = ridge->offset;
  for (int i = 0; i < ridge->weight.rows; i++)
    sum += (double(x[i]) - ridge->mean.at<double>(i)) / ridge->deviation.at<double>(i) * ridge->weight.at<double>(i);
  return sum;
}

void ridge_weights(const struct ridge *ridge, double *weights) {
  for (int i = 0; i < ridge->weight.rows; i++)
    weights[i] = ridge->weight.at<double>(i) / ridge->deviation.at<double>(i);
}

void ridge_free(struct ridge *ridge) { delete ridge; }
