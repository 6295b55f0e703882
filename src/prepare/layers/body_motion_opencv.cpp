/* SPDX-License-Identifier: MIT
 * How the body moves: a free-form deformation (Sederberg and Parry, 1986; here bilinear) of each frame onto a
 * reference, fitted to dense optical flow in the pixels of neck and torso, then to the colours of these pixels by
 * Gauss-Newton steps (Lucas and Kanade, 1981). */
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <memory>
#include <opencv2/video/tracking.hpp>

#include "prepare/layers/layers_opencv.h"

struct ern_body_reference {
  ern_context *context;
  int side, work;
  cv::Mat place;               /* the background, CV_32FC3 [work][work] */
  cv::Mat grey, picture;       /* of the reference: CV_8U; CV_32FC3 */
  cv::Mat smooth, down, right; /* the picture blurred, and its derivatives along a column and a row: CV_32FC3 */
  cv::Mat sum, weight;         /* of the frames that are added, on the reference: CV_32FC3, CV_32F */
  cv::Mat stiffness;           /* of the deformation, CV_64F [points][points] */
  cv::Ptr<cv::DISOpticalFlow> flow;
};

namespace {

constexpr int most_work = 256; /* pixels a side of the pictures that are compared: more is slower and hardly better */
constexpr double texture = 9;  /* squared grey levels a pixel at which a pixel has half of the weight */
constexpr double residual = 1; /* pixels of work at which a pixel has half of the weight */
constexpr int rounds = 3;      /* of the reweighted fit */
constexpr int grid_side = ERN_MOTION_SIDE, points = grid_side * grid_side; /* control points */
constexpr double bending = 3, stretching = 0.01; /* weights of second and first differences of control points, in
                                                    pixels with full weight */
constexpr int least_pixels = 200;
constexpr double blur = 0.7;    /* pixels of work: of what colours are compared in */
constexpr double outlier = 400; /* squared distance of two colours at which a pixel has half of the weight */
constexpr int gain_rounds = 4;
constexpr double most_gain = 4;   /* of the light of a frame */
constexpr double noise = 20;      /* squared grey levels: what bending and stretching are weighed against */
constexpr int steps = 3;          /* of Gauss-Newton */
constexpr double most_step = 1.5; /* pixels of work */
constexpr float least_frames = 3; /* that show a pixel of the mean picture */

struct Body {
  cv::Mat picture, mask; /* neck and torso over the background, CV_32FC3; 255 in their pixels, CV_8U */
};

cv::Mat grey_of(const cv::Mat &picture) {
  cv::Mat bytes, grey;
  picture.convertTo(bytes, CV_8UC3);
  cv::cvtColor(bytes, grey, cv::COLOR_RGB2GRAY);
  return grey;
}

Body body_of(const ern_body_reference &r, const uint8_t *rgba, const uint8_t *parts) {
  const cv::Mat whole(r.side, r.side, CV_8UC4, const_cast<uint8_t *>(rgba));
  const cv::Mat part(r.side, r.side, CV_8U, const_cast<uint8_t *>(parts));
  cv::Mat layer(r.side, r.side, CV_32FC3), alpha(r.side, r.side, CV_32F), small, share;
  for (int y = 0; y < r.side; y++)
    for (int x = 0; x < r.side; x++) {
      const cv::Vec4b c = whole.at<cv::Vec4b>(y, x);
      const float a = float(c[3]) / 255;
      alpha.at<float>(y, x) = a;
      layer.at<cv::Vec3f>(y, x) = cv::Vec3f(c[0], c[1], c[2]) * a;
    }
  Body body;
  cv::resize(layer, small, cv::Size(r.work, r.work), 0, 0, cv::INTER_AREA);
  cv::resize(alpha, share, cv::Size(r.work, r.work), 0, 0, cv::INTER_AREA);
  body.picture = small;
  for (int y = 0; y < r.work; y++)
    for (int x = 0; x < r.work; x++)
      body.picture.at<cv::Vec3f>(y, x) += r.place.at<cv::Vec3f>(y, x) * (1 - share.at<float>(y, x));
  cv::resize(part >= ERN_PART_NECK, body.mask, cv::Size(r.work, r.work), 0, 0, cv::INTER_AREA);
  body.mask = body.mask >= 128;
  return body;
}

/* Weights of pixels by their texture, 0..1. */
cv::Mat texture_of(const cv::Mat &grey) {
  cv::Mat across, along, energy;
  cv::Sobel(grey, across, CV_32F, 1, 0, 3, 1.0 / 8);
  cv::Sobel(grey, along, CV_32F, 0, 1, 3, 1.0 / 8);
  cv::GaussianBlur(across.mul(across) + along.mul(along), energy, cv::Size(0, 0), 2);
  return energy / (energy + texture);
}

/* The control points round a pixel of work: number of the first, and weights of it, of the next in its row, and of the
 * two below. */
struct Cell {
  int first;
  double weight[4];
};
constexpr int corner[4] = {0, 1, grid_side, grid_side + 1};

Cell cell_of(int y, int x, int work) {
  const double row = (y + 0.5) / work * (grid_side - 1), column = (x + 0.5) / work * (grid_side - 1);
  const int r = std::min(int(row), grid_side - 2), c = std::min(int(column), grid_side - 2);
  const double down = row - r, right = column - c;
  return {r * grid_side + c, {(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right}};
}

cv::Vec2d moved_by(const cv::Mat &control, const Cell &cell) {
  cv::Vec2d sum(0, 0);
  for (int k = 0; k < 4; k++) sum += cell.weight[k] * control.at<cv::Vec2d>(cell.first + corner[k]);
  return sum;
}

/* The sum of (weight d)^2 over all differences d of control points, in rows and in columns, as a quadratic form. */
cv::Mat stiffness() {
  cv::Mat form = cv::Mat::zeros(points, points, CV_64F);
  const auto add = [&form](double weight, std::initializer_list<std::pair<int, double>> difference) {
    for (const auto &a : difference)
      for (const auto &b : difference) form.at<double>(a.first, b.first) += weight * a.second * b.second;
  };
  for (int p = 0; p < points; p++)
    for (const int step : {1, grid_side}) {
      const int at = step == 1 ? p % grid_side : p / grid_side;
      if (at + 1 < grid_side) add(stretching, {{p, 1}, {p + step, -1}});
      if (at + 2 < grid_side) add(bending, {{p, 1}, {p + step, -2}, {p + 2 * step, 1}});
    }
  return form;
}

/* control, CV_64FC2 [points], pixels of work down and right, of the reweighted least squares of flow - moved_by; false:
 * too few pixels. */
bool fit(const ern_body_reference &r, const cv::Mat &flow, const cv::Mat &mask, const cv::Mat &texture_weight,
         cv::Mat &control) {
  struct Sample {
    Cell cell;
    cv::Vec2d by;
    double weight;
  };
  std::vector<Sample> samples;
  for (int y = 0; y < r.work; y++)
    for (int x = 0; x < r.work; x++) {
      if (mask.at<uchar>(y, x) == 0) continue;
      const cv::Vec2f f = flow.at<cv::Vec2f>(y, x);
      samples.push_back({cell_of(y, x, r.work), {f[1], f[0]}, texture_weight.at<float>(y, x)});
    }
  if (samples.size() < size_t(least_pixels)) return false;
  for (int round = 0; round < rounds; round++) {
    cv::Mat normal = r.stiffness.clone(), right = cv::Mat::zeros(points, 2, CV_64F), solved;
    for (int p = 0; p < points; p++) normal.at<double>(p, p) += 1e-6;
    for (const Sample &s : samples) {
      const cv::Vec2d left = round == 0 ? cv::Vec2d(0, 0) : s.by - moved_by(control, s.cell);
      const double weight = s.weight / (1 + left.dot(left) / (residual * residual));
      for (int a = 0; a < 4; a++) {
        const double share = weight * s.cell.weight[a];
        double *row = normal.ptr<double>(s.cell.first + corner[a]) + s.cell.first;
        for (int b = 0; b < 4; b++) row[corner[b]] += share * s.cell.weight[b];
        right.at<cv::Vec2d>(s.cell.first + corner[a]) += share * s.by;
      }
    }
    if (!cv::solve(normal, right, solved, cv::DECOMP_CHOLESKY)) return false;
    control = solved.reshape(2);
  }
  return true;
}

void set_reference(ern_body_reference &r, const cv::Mat &picture) {
  r.picture = picture;
  r.grey = grey_of(picture);
  cv::GaussianBlur(picture, r.smooth, cv::Size(0, 0), blur);
  cv::Sobel(r.smooth, r.down, CV_32F, 0, 1, 3, 1.0 / 8);
  cv::Sobel(r.smooth, r.right, CV_32F, 1, 0, 3, 1.0 / 8);
}

/* The normal equations of a step d of all control points, first all moves down, then all moves right, pixels of work:
 * the least sum over pixels of weight |reference + derivatives d - picture|^2, and noise times the deformation's
 * stiffness. */
struct Normal {
  Eigen::MatrixXd matrix;
  Eigen::VectorXd right;
};

/* Adds a pixel at which the reference, minus the picture, is `off`. */
void add_pixel(Normal &normal, const Cell &cell, const cv::Vec3f &off, const cv::Vec3f &down, const cv::Vec3f &right) {
  const double weight = 1 / (1 + double(off.dot(off)) / outlier);
  const double tensor[3] = {weight * down.dot(down), weight * down.dot(right), weight * right.dot(right)};
  for (int a = 0; a < 4; a++) {
    const int p = cell.first + corner[a];
    normal.right[p] -= cell.weight[a] * weight * down.dot(off);
    normal.right[points + p] -= cell.weight[a] * weight * right.dot(off);
    for (int b = 0; b < 4; b++) {
      const int q = cell.first + corner[b];
      const double share = cell.weight[a] * cell.weight[b];
      normal.matrix(p, q) += share * tensor[0];
      normal.matrix(points + p, q) += share * tensor[1];
      normal.matrix(p, points + q) += share * tensor[1];
      normal.matrix(points + p, points + q) += share * tensor[2];
    }
  }
}

void add_stiffness(Normal &normal, const cv::Mat &stiffness, const cv::Mat &control) {
  for (int p = 0; p < points; p++)
    for (int q = 0; q < points; q++)
      for (int d = 0; d < 2; d++) {
        const double stiff = noise * stiffness.at<double>(p, q);
        normal.matrix(d * points + p, d * points + q) += stiff;
        normal.right[d * points + p] -= stiff * control.at<cv::Vec2d>(q)[d];
      }
  normal.matrix.diagonal().array() += 1e-3;
}

/* By what the frame's colours are multiplied to be as bright as the reference where both show the same, `seen`. */
double gain_of(const cv::Mat &seen, const cv::Mat &picture, const cv::Mat &mask) {
  double gain = 1;
  for (int round = 0; round < gain_rounds; round++) {
    double sum = 0, wanted = 0;
    for (int y = 0; y < mask.rows; y++)
      for (int x = 0; x < mask.cols; x++) {
        if (mask.at<uchar>(y, x) == 0) continue;
        const cv::Vec3f &own = picture.at<cv::Vec3f>(y, x), &other = seen.at<cv::Vec3f>(y, x);
        const cv::Vec3f off = other - own * float(gain);
        const double weight = 1 / (1 + double(off.dot(off)) / outlier);
        sum += weight * double(own[0] + own[1] + own[2]);
        wanted += weight * double(other[0] + other[1] + other[2]);
      }
    if (!(sum > 0 && wanted > 0)) return 1;
    gain = std::min(std::max(wanted / sum, 1 / most_gain), most_gain);
  }
  return gain;
}

/* Moves the control points by a step. picture, mask: of the frame, blurred and without its border. *gain: of its light.
 */
bool improve(const ern_body_reference &r, const cv::Mat &picture, const cv::Mat &mask, cv::Mat &control, double *gain) {
  Normal normal = {Eigen::MatrixXd::Zero(2 * points, 2 * points), Eigen::VectorXd::Zero(2 * points)};
  cv::Mat place(r.work, r.work, CV_32FC2), seen, down, right;
  for (int y = 0; y < r.work; y++)
    for (int x = 0; x < r.work; x++) {
      const cv::Vec2d by = moved_by(control, cell_of(y, x, r.work));
      place.at<cv::Vec2f>(y, x) = cv::Vec2f(float(x + by[1]), float(y + by[0]));
    }
  cv::remap(r.smooth, seen, place, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  cv::remap(r.down, down, place, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  cv::remap(r.right, right, place, cv::noArray(), cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  *gain = gain_of(seen, picture, mask);
  for (int y = 0; y < r.work; y++)
    for (int x = 0; x < r.work; x++)
      if (mask.at<uchar>(y, x) != 0)
        add_pixel(normal, cell_of(y, x, r.work), seen.at<cv::Vec3f>(y, x) - picture.at<cv::Vec3f>(y, x) * float(*gain),
                  down.at<cv::Vec3f>(y, x), right.at<cv::Vec3f>(y, x));
  add_stiffness(normal, r.stiffness, control);
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver(normal.matrix.sparseView());
  if (solver.info() != Eigen::Success) return false;
  const Eigen::VectorXd step = solver.solve(normal.right);
  if (!step.allFinite()) return false;
  for (int p = 0; p < points; p++)
    for (int d = 0; d < 2; d++)
      control.at<cv::Vec2d>(p)[d] += std::min(std::max(step[d * points + p], -most_step), most_step);
  return true;
}

/* *gain: by what the frame's colours are multiplied to be as bright as the reference. */
bool find(const ern_body_reference &r, const Body &body, cv::Mat &control, double *gain) {
  const cv::Mat grey = grey_of(body.picture);
  cv::Mat flow, smooth, inner;
  r.flow->calc(grey, r.grey, flow);
  if (!fit(r, flow, body.mask, texture_of(grey), control)) return false;
  cv::GaussianBlur(body.picture, smooth, cv::Size(0, 0), blur);
  cv::erode(body.mask, inner, cv::Mat(), cv::Point(-1, -1), 2);
  for (int step = 0; step < steps; step++)
    if (!improve(r, smooth, inner, control, gain)) return false;
  return true;
}

/* Adds a pixel's colour to the four pixels of the reference round (y, x), pixels of work. */
void splat(ern_body_reference &r, double y, double x, const cv::Vec3f &colour) {
  const int top = int(std::floor(y)), left = int(std::floor(x));
  for (int k = 0; k < 4; k++) {
    const int row = top + k / 2, column = left + k % 2;
    if (row < 0 || column < 0 || row >= r.work || column >= r.work) continue;
    const float share = float((1 - std::fabs(y - row)) * (1 - std::fabs(x - column)));
    r.sum.at<cv::Vec3f>(row, column) += colour * share;
    r.weight.at<float>(row, column) += share;
  }
}

}  // namespace

void ern_body_reference_free(ern_body_reference *reference) { delete reference; }

ern_status ern_body_reference_make(ern_context *context, int side, const uint8_t *background, const uint8_t *rgba,
                                   const uint8_t *parts, ern_body_reference **reference) {
  *reference = nullptr;
  return ern_layers_guarded(context, [&] {
    auto made = std::unique_ptr<ern_body_reference>(new ern_body_reference);
    made->context = context;
    made->side = side;
    made->work = std::min(side, most_work);
    const cv::Mat place(side, side, CV_8UC3, const_cast<uint8_t *>(background));
    cv::Mat small;
    cv::resize(place, small, cv::Size(made->work, made->work), 0, 0, cv::INTER_AREA);
    small.convertTo(made->place, CV_32FC3);
    made->flow = cv::DISOpticalFlow::create(cv::DISOpticalFlow::PRESET_MEDIUM);
    made->flow->setFinestScale(0);
    set_reference(*made, body_of(*made, rgba, parts).picture);
    made->sum = cv::Mat::zeros(made->work, made->work, CV_32FC3);
    made->weight = cv::Mat::zeros(made->work, made->work, CV_32F);
    made->stiffness = stiffness();
    *reference = made.release();
    return ERN_OK;
  });
}

ern_status ern_body_reference_add(ern_body_reference *r, const uint8_t *rgba, const uint8_t *parts) {
  return ern_layers_guarded(r->context, [&] {
    cv::Mat control;
    const Body body = body_of(*r, rgba, parts);
    double gain = 1;
    if (!find(*r, body, control, &gain)) return ERN_OK;
    for (int y = 0; y < r->work; y++)
      for (int x = 0; x < r->work; x++) {
        if (body.mask.at<uchar>(y, x) == 0) continue;
        const cv::Vec2d by = moved_by(control, cell_of(y, x, r->work));
        if (std::isfinite(by[0]) && std::isfinite(by[1]) && std::fabs(by[0]) < r->work && std::fabs(by[1]) < r->work)
          splat(*r, y + by[0], x + by[1], body.picture.at<cv::Vec3f>(y, x) * float(gain));
      }
    return ERN_OK;
  });
}

ern_status ern_body_reference_mean(ern_body_reference *r) {
  return ern_layers_guarded(r->context, [&] {
    for (int y = 0; y < r->work; y++)
      for (int x = 0; x < r->work; x++)
        if (r->weight.at<float>(y, x) >= least_frames)
          r->picture.at<cv::Vec3f>(y, x) = r->sum.at<cv::Vec3f>(y, x) / r->weight.at<float>(y, x);
    set_reference(*r, r->picture);
    r->sum.setTo(0);
    r->weight.setTo(0);
    return ERN_OK;
  });
}

ern_status ern_body_reference_find(ern_body_reference *r, const uint8_t *rgba, const uint8_t *parts,
                                   float motion[ERN_MOTION_VALUES], bool *found) {
  return ern_layers_guarded(r->context, [&] {
    cv::Mat control;
    double gain = 1;
    *found = find(*r, body_of(*r, rgba, parts), control, &gain);
    for (int i = 0; i < ERN_MOTION_VALUES && *found; i++) {
      motion[i] = float(control.at<cv::Vec2d>(i % points)[i / points] * 2 / r->work);
      *found = std::isfinite(motion[i]) && std::fabs(motion[i]) < 2;
    }
    return ERN_OK;
  });
}
