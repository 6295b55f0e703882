/* SPDX-License-Identifier: MIT
 * Bundle adjustment by Ceres Solver. No exception and no C++ type leaves this file. */
#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <algorithm>
#include <cmath>
#include <exception>
#include <new>
#include <vector>

extern "C" {
#include "prepare/pose/bundle.h"
}

namespace {

/* The standard deviation of a tracked point is about half a pixel; a point that is off by several is not on the rigid
 * head. */
constexpr double pixels = 0.5, outlier = 3.0;
/* Standard deviation of a person's head shape from the generic one, metres. */
constexpr double shape_spread = 0.008;
/* Standard deviations of the change from frame to frame of rotation (radians), of lateral translation and of depth
 * (metres). What the pictures determine least (depth) is smoothed most. The Cauchy loss preserves nods. */
constexpr double turn_change = 0.0015, translation_change = 0.0002, depth_change = 0.0001;
/* Weight of the reprojection costs. Flow errors are correlated between neighbouring pixels and frames, so n
 * observations count as 0.1 n. In full they would outweigh the generic head's depth where the head turns little. */
constexpr double reprojection_weight = 0.1;
/* Limit of a residual, beyond any real head; squares of larger ones may overflow. */
constexpr double most_residual = 1e12;

bool finite(double value) { return std::isfinite(value); }
template <int N>
bool finite(const ceres::Jet<double, N> &value) {
  return std::isfinite(value.a) && value.v.allFinite();
}

/* Costs report NaN and overflow themselves: where Ceres finds one, it writes a warning to stderr. */
template <typename T>
bool finite(const T *values, int count) {
  return std::all_of(values, values + count, [](const T &value) { return finite(value); });
}

struct Reprojection {
  double x, y, focal, centre, weight;
  template <typename T>
  bool operator()(const T *pose, const T *point, T *residual) const {
    T p[3];
    ceres::AngleAxisRotatePoint(pose, point, p);
    const T depth = -(p[2] + pose[5]);
    if (depth < T(1e-3)) return false;
    residual[0] = weight / pixels * (centre + focal * (p[0] + pose[3]) / depth - x);
    residual[1] = weight / pixels * (centre - focal * (p[1] + pose[4]) / depth - y);
    return finite(residual, 2);
  }
};

struct KnownReprojection {
  Reprojection seen;
  const double *point;
  template <typename T>
  bool operator()(const T *pose, T *residual) const {
    const T p[3] = {T(point[0]), T(point[1]), T(point[2])};
    return seen(pose, p, residual);
  }
};

struct NearPrior {
  const double *prior;
  template <typename T>
  bool operator()(const T *point, T *residual) const {
    for (int i = 0; i < 3; i++) residual[i] = (point[i] - prior[i]) / shape_spread;
    return finite(residual, 3);
  }
};

/* Second difference of the pose over time. Rotation vectors of neighbouring frames are close, so plain differences
 * suffice. */
struct Smoothness {
  template <typename T>
  bool operator()(const T *before, const T *now, const T *after, T *residual) const {
    for (int i = 0; i < 6; i++) {
      const double spread = i < 3 ? turn_change : i < 5 ? translation_change : depth_change;
      residual[i] = (before[i] - 2.0 * now[i] + after[i]) / spread;
    }
    return finite(residual, 6);
  }
};

float weight_of(const struct ern_bundle &b, const struct ern_observation &seen) {
  return b.weights[seen.point] * seen.share;
}
bool counts(const struct ern_bundle &b, const struct ern_observation &seen) { return weight_of(b, seen) > 0.05F; }

Reprojection reprojection(const struct ern_bundle &b, const struct ern_observation &seen) {
  return {seen.at[0], seen.at[1], b.focal, b.centre, std::sqrt(static_cast<double>(weight_of(b, seen)))};
}

/* `sound`: every cost is finite at the start values. Ceres writes an error to stderr where one is not. */
struct Adjustment {
  /* shared by all costs, of which a path has a million */
  ceres::CauchyLoss reprojection_loss{outlier}, steady{3.0};
  ceres::ScaledLoss scaled;
  ceres::Problem problem;
  bool sound = true;

  explicit Adjustment(double share = 1)
      : scaled(&reprojection_loss, share, ceres::DO_NOT_TAKE_OWNERSHIP), problem(without_losses()) {}

  static ceres::Problem::Options without_losses() {
    ceres::Problem::Options options;
    options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    return options;
  }
};

/* Takes ownership of the cost. */
template <int Residuals, int... Sizes, typename Cost, typename... Blocks>
void add(Adjustment &adjustment, Cost *cost, ceres::LossFunction *loss, Blocks *...blocks) {
  double residual[Residuals];
  bool sound = (*cost)(static_cast<const double *>(blocks)..., residual);
  for (int i = 0; i < Residuals && sound; i++) sound = std::fabs(residual[i]) < most_residual;
  adjustment.sound = adjustment.sound && sound;
  adjustment.problem.AddResidualBlock(new ceres::AutoDiffCostFunction<Cost, Residuals, Sizes...>(cost), loss,
                                      blocks...);
}

void add_known(Adjustment &adjustment, const struct ern_bundle &b, size_t frame) {
  for (size_t k = 0; k < b.seen[frame].count; k++) {
    const struct ern_observation &seen = b.seen[frame].list[k];
    if (!counts(b, seen)) continue;
    add<2, 6>(adjustment, new KnownReprojection{reprojection(b, seen), b.shape[seen.point]}, &adjustment.scaled,
              b.poses[frame].values);
  }
}

ern_status solve(const struct ern_bundle &b, Adjustment &adjustment, ceres::LinearSolverType type, int rounds) {
  ceres::Solver::Options options;
  ceres::Solver::Summary summary;
  options.linear_solver_type = type;
  options.max_num_iterations = rounds;
  options.num_threads = 1; /* several add the sums in another order each time */
  options.function_tolerance = 1e-5;
  options.logging_type = ceres::SILENT;
  if (adjustment.problem.NumResidualBlocks() == 0) return ERN_OK;
  if (!adjustment.sound)
    return ern_fail(b.context, ERN_E_NONFINITE,
                    "bundle adjustment: a point is behind the camera, or is no number; expected a head before it");
  ceres::Solve(options, &adjustment.problem, &summary);
  if (summary.IsSolutionUsable()) return ERN_OK;
  return ern_fail(b.context, ERN_E_NONFINITE, "bundle adjustment: %s", summary.message.c_str());
}

template <typename Work>
ern_status guarded(ern_context *context, Work work) {
  try {
    return work();
  } catch (const std::bad_alloc &) {
    return ern_fail(context, ERN_E_NO_MEMORY, "bundle adjustment: no memory");
  } catch (const std::exception &error) {
    return ern_fail(context, ERN_E_MEDIA, "bundle adjustment: %s", error.what());
  }
}

}  // namespace

extern "C" void ern_bundle_pose_from(const struct ern_head_pose *pose, struct ern_bundle_pose *bundle) {
  double columns[9]; /* Ceres stores matrices column-major */
  for (int i = 0; i < 9; i++) columns[i] = pose->rotation[i % 3][i / 3];
  ceres::RotationMatrixToAngleAxis(columns, bundle->values);
  std::copy_n(pose->translation, 3, bundle->values + 3);
}

extern "C" void ern_bundle_pose_to(const struct ern_bundle_pose *bundle, struct ern_head_pose *pose) {
  double columns[9];
  ceres::AngleAxisToRotationMatrix(bundle->values, columns);
  for (int i = 0; i < 9; i++) pose->rotation[i % 3][i / 3] = columns[i];
  std::copy_n(bundle->values + 3, 3, pose->translation);
}

extern "C" double ern_bundle_residual(const struct ern_bundle *bundle, size_t frame,
                                      const struct ern_observation *seen) {
  double residual[2];
  Reprojection off = reprojection(*bundle, *seen);
  off.weight = pixels;
  if (!off(bundle->poses[frame].values, bundle->shape[seen->point], residual)) return HUGE_VAL;
  return std::hypot(residual[0], residual[1]);
}

extern "C" ern_status ern_bundle_adjust(struct ern_bundle *bundle, const size_t *chosen, size_t count, size_t fixed) {
  return guarded(bundle->context, [&] {
    const struct ern_bundle &b = *bundle;
    Adjustment adjustment(reprojection_weight);
    ceres::Problem &problem = adjustment.problem;
    std::vector<bool> used(b.points, false);
    for (size_t i = 0; i < count; i++)
      for (size_t k = 0; k < b.seen[chosen[i]].count; k++) {
        const struct ern_observation &seen = b.seen[chosen[i]].list[k];
        if (!counts(b, seen)) continue;
        used[seen.point] = true;
        add<2, 6, 3>(adjustment, new Reprojection(reprojection(b, seen)), &adjustment.scaled, b.poses[chosen[i]].values,
                     b.shape[seen.point]);
      }
    for (size_t k = 0; k < b.points; k++)
      if (used[k]) add<3, 3>(adjustment, new NearPrior{b.prior[k]}, nullptr, b.shape[k]);
    if (problem.HasParameterBlock(b.poses[fixed].values)) problem.SetParameterBlockConstant(b.poses[fixed].values);
    return solve(b, adjustment, ceres::DENSE_SCHUR, 12);
  });
}

extern "C" ern_status ern_bundle_one(struct ern_bundle *bundle, size_t frame, size_t *seen) {
  return guarded(bundle->context, [&] {
    Adjustment adjustment;
    add_known(adjustment, *bundle, frame);
    *seen = static_cast<size_t>(adjustment.problem.NumResidualBlocks());
    return *seen >= 6 ? solve(*bundle, adjustment, ceres::DENSE_QR, 15) : ERN_OK;
  });
}

extern "C" ern_status ern_bundle_path(struct ern_bundle *bundle, size_t begin, size_t end) {
  return guarded(bundle->context, [&] {
    const struct ern_bundle &b = *bundle;
    Adjustment adjustment(reprojection_weight);
    ceres::Problem &problem = adjustment.problem;
    for (size_t i = begin; i < end; i++) {
      problem.AddParameterBlock(b.poses[i].values, 6);
      add_known(adjustment, b, i);
      if (i >= 1 && i + 1 < end)
        add<6, 6, 6, 6>(adjustment, new Smoothness(), &adjustment.steady, b.poses[i - 1].values, b.poses[i].values,
                        b.poses[i + 1].values);
    }
    for (size_t i = begin > 0 ? begin - 1 : 0; i < begin; i++)
      if (problem.HasParameterBlock(b.poses[i].values)) problem.SetParameterBlockConstant(b.poses[i].values);
    return solve(b, adjustment, ceres::SPARSE_NORMAL_CHOLESKY, 15);
  });
}
