/* SPDX-License-Identifier: MIT
 * No exception and no C++ type leaves this file. */
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <exception>
#include <memory>
#include <new>
#include <opencv2/imgproc.hpp>
#include <vector>

extern "C" {
#include "prepare/head_shape.h"
#include "prepare/pose/pose_align.h"
}

namespace {

constexpr int most_work = 256;       /* pixels a side of the pictures that are compared */
constexpr size_t most_points = 8000; /* more are slower and tell hardly more */
constexpr double hair = 1.3;         /* how far outside of the ellipsoid points are taken, its radius is 1 */
constexpr double blur = 0.8;         /* pixels of work */
constexpr double outlier = 133;      /* squared grey levels at which a pixel has half of the weight */
constexpr double change = 33;        /* variance of a point over frames at which it has half of the weight */
constexpr double noise = 1;          /* variance of a point that shows nothing */
constexpr int steps = 4;             /* of Gauss-Newton */
constexpr int gain_rounds = 4;
constexpr double most_gain = 4;             /* of the light of a frame */
constexpr double most_turn = 0.02;          /* of a step, radians */
constexpr double least_inside = 0.5;        /* share of the weights whose points the picture shows */
constexpr double most_change[] = {10, 0.1}; /* of a refined pose: degrees, share of the depth */

template <typename Work>
ern_status guarded(ern_context *context, Work work) {
  try {
    return work();
  } catch (const std::bad_alloc &) {
    return ern_fail(context, ERN_E_NO_MEMORY, "poses: no memory");
  } catch (const std::exception &error) {
    return ern_fail(context, ERN_E_MEDIA, "poses: %.400s", error.what());
  }
}

struct Pose {
  Eigen::Matrix3d rotation;
  Eigen::Vector3d translation; /* metres */
};

Pose pose_of(const ern_head_pose &p) {
  Pose pose;
  for (int i = 0; i < 3; i++) {
    pose.translation[i] = p.translation[i];
    for (int k = 0; k < 3; k++) pose.rotation(i, k) = p.rotation[i][k];
  }
  return pose;
}

/* A frame, blurred, and its derivatives along a row and a column; CV_32F [work][work]. */
struct Picture {
  cv::Mat grey, right, down;
};

float sample(const cv::Mat &m, double u, double v) {
  const int x = int(u), y = int(v);
  const float a = float(u - x), b = float(v - y);
  const float *p = m.ptr<float>(y) + x, *q = m.ptr<float>(y + 1) + x;
  return (1 - b) * ((1 - a) * p[0] + a * p[1]) + b * ((1 - a) * q[0] + a * q[1]);
}

/* Grey levels of a point over frames. */
struct Levels {
  double sum = 0, squares = 0;
  void add(double level) {
    sum += level;
    squares += level * level;
  }
  double variance(double count) const { return std::max(squares / count - sum / count * (sum / count), 0.0); }
};

}  // namespace

struct ern_pose_align {
  ern_context *context;
  int side, work;
  double focal, centre;                /* pixels of work */
  std::vector<Eigen::Vector3d> points; /* of the head, metres */
  Pose reference;
  /* [points], of the frames that are added: where the frame shows the point, and where the reference does */
  std::vector<Levels> moving, still;
  std::vector<double> mean, steady; /* [points]: grey level, at first that of one frame; weight, 0..1 */
  bool has_mean = false;
  size_t added = 0;
};

namespace {

Picture picture_of(const ern_pose_align &a, const uint8_t *grey) {
  const cv::Mat whole(a.side, a.side, CV_8U, const_cast<uint8_t *>(grey));
  Picture p;
  cv::Mat small;
  cv::resize(whole, small, cv::Size(a.work, a.work), 0, 0, cv::INTER_AREA);
  small.convertTo(small, CV_32F);
  cv::GaussianBlur(small, p.grey, cv::Size(0, 0), blur);
  cv::Sobel(p.grey, p.right, CV_32F, 1, 0, 3, 1.0 / 8);
  cv::Sobel(p.grey, p.down, CV_32F, 0, 1, 3, 1.0 / 8);
  return p;
}

/* Where the picture shows a point that is at `seen` before the camera; false: not within it. */
bool place_of(const ern_pose_align &a, const Eigen::Vector3d &seen, double &u, double &v) {
  if (seen[2] > -1e-3) return false;
  u = a.centre + a.focal * seen[0] / -seen[2] - 0.5; /* pixels' centres are whole numbers */
  v = a.centre - a.focal * seen[1] / -seen[2] - 0.5;
  return u >= 1 && v >= 1 && u < a.work - 2 && v < a.work - 2;
}

/* Beyond the picture's border as at it. */
double level_of(const ern_pose_align &a, const Picture &picture, const Pose &pose, const Eigen::Vector3d &point) {
  double u = 0, v = 0;
  (void)place_of(a, pose.rotation * point + pose.translation, u, v);
  const double last = a.work - 1.001;
  return double(sample(picture.grey, std::clamp(u, 0.0, last), std::clamp(v, 0.0, last)));
}

/* By what the picture's grey levels are multiplied to be as bright as the mean picture; hidden points count little. */
double gain_of(const ern_pose_align &a, const Picture &picture, const Pose &pose) {
  double gain = 1;
  for (int round = 0; round < gain_rounds; round++) {
    double sum = 0, wanted = 0;
    for (size_t k = 0; k < a.points.size(); k++) {
      double u, v;
      if (!place_of(a, pose.rotation * a.points[k] + pose.translation, u, v)) continue;
      const double level = double(sample(picture.grey, u, v)), off = gain * level - a.mean[k];
      const double weight = a.steady[k] / (1 + off * off / outlier);
      sum += weight * level;
      wanted += weight * a.mean[k];
    }
    if (!(sum > 0 && wanted > 0)) return 1;
    gain = std::clamp(wanted / sum, 1 / most_gain, most_gain);
  }
  return gain;
}

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

/* Weighted least squares of a turn about the camera and a move, x -> x + turn cross x + move. */
struct Fit {
  Matrix6 normal = Matrix6::Zero(); /* of the normal equations */
  Vector6 right = Vector6::Zero();
  double off = 0;             /* sum of the weighted squares of the residuals */
  double texture = 0;         /* of squared derivatives by the place in the picture, weighted */
  double inside = 0, all = 0; /* weights of the points that the picture shows, and of all */
  /* A residual of the point that is at `seen` before the camera; `by`: its derivative by that place. */
  void add(const Eigen::Vector3d &seen, const Eigen::Vector3d &by, double residual, double weight) {
    Vector6 row;
    row << seen.cross(by), by;
    normal.selfadjointView<Eigen::Upper>().rankUpdate(row, weight);
    right -= weight * residual * row;
    off += weight * residual * residual;
  }
};

/* Adds what the picture says. */
void add_picture(const ern_pose_align &a, const Picture &picture, const Pose &pose, Fit &fit) {
  const double gain = gain_of(a, picture, pose);
  for (size_t k = 0; k < a.points.size(); k++) {
    const Eigen::Vector3d seen = pose.rotation * a.points[k] + pose.translation;
    double u, v;
    fit.all += a.steady[k];
    if (!place_of(a, seen, u, v)) continue;
    const double off = gain * double(sample(picture.grey, u, v)) - a.mean[k];
    const double weight = a.steady[k] / (1 + off * off / outlier);
    const double across = gain * double(sample(picture.right, u, v)),
                 along = -gain * double(sample(picture.down, u, v));
    const double scale = a.focal / -seen[2];
    fit.add(seen, scale * Eigen::Vector3d(across, along, (across * seen[0] + along * seen[1]) / -seen[2]), off, weight);
    fit.texture += weight * (across * across + along * along);
    fit.inside += a.steady[k];
  }
}

/* Adds what the tracks say: the middle of the face stays where they have it, with as much weight as the picture gives
 * to a shift. Beside it, in hair and temples, the picture tells turn and scale. */
void add_tracks(const ern_pose_align &a, const Pose &tracked, const Pose &pose, double texture, Fit &fit) {
  static const Eigen::Vector3d face[] = {{-0.04, 0.05, 0.08}, {0.04, 0.05, 0.08},   {-0.05, 0, 0.07},
                                         {0.05, 0, 0.07},     {-0.03, -0.05, 0.08}, {0.03, -0.05, 0.08}};
  const double weight = 0.5 * texture / (sizeof face / sizeof *face);
  for (const Eigen::Vector3d &point : face) {
    const Eigen::Vector3d seen = pose.rotation * point + pose.translation;
    const Eigen::Vector3d was = tracked.rotation * point + tracked.translation;
    double at[2], before[2];
    if (!place_of(a, seen, at[0], at[1]) || !place_of(a, was, before[0], before[1])) continue;
    const double scale = a.focal / -seen[2];
    fit.add(seen, scale * Eigen::Vector3d(1, 0, seen[0] / -seen[2]), at[0] - before[0], weight);
    fit.add(seen, scale * Eigen::Vector3d(0, -1, -seen[1] / -seen[2]), at[1] - before[1], weight);
  }
}

Pose refined(const ern_pose_align &a, const Picture &picture, const Pose &tracked, const Pose &start) {
  Pose pose = start, best = start;
  double least = HUGE_VAL, texture = 0;
  for (int step = 0; step <= steps; step++) {
    Fit fit;
    add_picture(a, picture, pose, fit);
    if (step == 0) texture = fit.texture;
    add_tracks(a, tracked, pose, texture, fit);
    if (!(fit.inside > least_inside * fit.all && fit.off / fit.inside < least)) break;
    least = fit.off / fit.inside;
    best = pose;
    fit.normal.diagonal() *= 1 + 1e-6;
    Vector6 by = fit.normal.selfadjointView<Eigen::Upper>().ldlt().solve(fit.right);
    if (!by.allFinite()) break;
    const double turn = by.head<3>().norm();
    if (turn > most_turn) by *= most_turn / turn;
    const Eigen::AngleAxisd turned(std::min(turn, most_turn),
                                   turn > 0 ? Eigen::Vector3d(by.head<3>().normalized()) : Eigen::Vector3d::UnitX());
    pose.rotation = turned * pose.rotation;
    pose.translation = turned * pose.translation + by.tail<3>();
  }
  return best;
}

/* The point of the head that a pixel of the reference shows; beside the ellipsoid, where hair and ears are, the point
 * of the ray that is nearest to it. false: none, or one that moves with mouth, jaw or neck. */
bool point_of(const ern_head_pose &reference, double focal, double centre, const double pixel[2], double point[3]) {
  if (!ern_head_intersect(&reference, focal, centre, pixel, true, point) &&
      ern_head_nearest(&reference, focal, centre, pixel, point) > hair)
    return false;
  const bool mouth = point[1] < ERN_HEAD_EYES_Y - 0.060 && std::fabs(point[0]) < 0.050;
  return !mouth && point[1] > -0.060;
}

}  // namespace

extern "C" ern_status ern_pose_align_make(ern_context *context, int side, double focal, double centre,
                                          const struct ern_head_pose *reference, struct ern_pose_align **align) {
  *align = nullptr;
  return guarded(context, [&] {
    auto made = std::make_unique<ern_pose_align>();
    std::vector<Eigen::Vector3d> points;
    made->context = context;
    made->side = side;
    made->work = std::min(side, most_work);
    const double scale = double(made->work) / side;
    made->focal = focal * scale;
    made->centre = centre * scale;
    for (int y = 0; y < made->work; y++)
      for (int x = 0; x < made->work; x++) {
        const double pixel[2] = {(x + 0.5) / scale, (y + 0.5) / scale};
        double point[3];
        if (point_of(*reference, focal, centre, pixel, point)) points.emplace_back(point[0], point[1], point[2]);
      }
    const size_t every = points.size() / most_points + 1;
    for (size_t k = 0; k < points.size(); k += every) made->points.push_back(points[k]);
    made->reference = pose_of(*reference);
    made->mean.assign(made->points.size(), 0);
    made->steady.assign(made->points.size(), 1);
    made->moving.assign(made->points.size(), Levels());
    made->still = made->moving;
    *align = made.release();
    return ERN_OK;
  });
}

extern "C" ern_status ern_pose_align_add(struct ern_pose_align *align, const uint8_t *grey,
                                         const struct ern_head_pose *pose) {
  return guarded(align->context, [&] {
    const Picture picture = picture_of(*align, grey);
    const Pose at = pose_of(*pose);
    for (size_t k = 0; k < align->points.size() && !align->has_mean; k++)
      align->mean[k] = level_of(*align, picture, at, align->points[k]);
    align->has_mean = true;
    const double gain = gain_of(*align, picture, at);
    for (size_t k = 0; k < align->points.size(); k++) {
      align->moving[k].add(gain * level_of(*align, picture, at, align->points[k]));
      align->still[k].add(gain * level_of(*align, picture, align->reference, align->points[k]));
    }
    align->added++;
    return ERN_OK;
  });
}

extern "C" void ern_pose_align_mean(struct ern_pose_align *align) {
  const double n = double(align->added);
  for (size_t k = 0; k < align->points.size() && align->added > 0; k++) {
    const double moving = align->moving[k].variance(n), still = align->still[k].variance(n);
    align->mean[k] = align->moving[k].sum / n;
    align->steady[k] = std::max(still - moving, 0.0) / (still + moving + noise) / (1 + moving / change);
    align->moving[k] = align->still[k] = Levels();
  }
  align->added = 0;
}

extern "C" ern_status ern_pose_align_refine(struct ern_pose_align *align, const uint8_t *grey,
                                            const struct ern_head_pose *tracked, struct ern_head_pose *pose) {
  return guarded(align->context, [&] {
    const Pose start = pose_of(*tracked), found = refined(*align, picture_of(*align, grey), start, pose_of(*pose));
    const double turn = Eigen::AngleAxisd(found.rotation * start.rotation.transpose()).angle() * 57.29577951308232;
    const double deeper = found.translation[2] / start.translation[2] - 1;
    if (!(turn < most_change[0] && std::fabs(deeper) < most_change[1])) return ERN_OK;
    for (int i = 0; i < 3; i++) {
      pose->translation[i] = found.translation[i];
      for (int k = 0; k < 3; k++) pose->rotation[i][k] = found.rotation(i, k);
    }
    return ERN_OK;
  });
}

extern "C" void ern_pose_align_free(struct ern_pose_align **align) {
  if (align == nullptr) return;
  delete *align;
  *align = nullptr;
}
