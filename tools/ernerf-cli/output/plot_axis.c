/* SPDX-License-Identifier: MIT */
#include "output/plot_axis.h"

#include <math.h>

static const double margin = 0.06; /* share of the axis beyond the outermost values */

struct plot_axis plot_axis_around(double low, double high, bool log) {
  struct plot_axis axis = {.log = log};
  if (!(low <= high)) low = high = 1;
  double a = log ? log10(low) : low, b = log ? log10(high) : high;
  const double least = log ? 0.1 : fmax(1e-6, 1e-3 * fmax(fabs(a), fabs(b)));
  const double padding = fmax(margin * (b - a), least / 2);
  a -= padding;
  b += padding;
  axis.low = log ? pow(10, a) : a;
  axis.high = log ? pow(10, b) : b;
  return axis;
}

double plot_axis_at(const struct plot_axis *axis, double value) {
  const double share =
      axis->log ? log(value / axis->low) / log(axis->high / axis->low) : (value - axis->low) / (axis->high - axis->low);
  return axis->begin + share * (axis->end - axis->begin);
}

bool plot_axis_shows(const struct plot_axis *axis, double value) {
  return isfinite(value) && (!axis->log || value > 0);
}

static size_t linear_ticks(const struct plot_axis *axis, size_t wanted, double ticks[PLOT_MOST_TICKS]) {
  static const double steps[] = {1, 2, 5, 10};
  const double rough = (axis->high - axis->low) / (double)wanted, power = pow(10, floor(log10(rough)));
  size_t k = 0, count = 0;
  while (k < 3 && steps[k] * power < rough) k++;
  const double step = steps[k] * power;
  for (double i = ceil(axis->low / step); i * step <= axis->high && count < PLOT_MOST_TICKS; i++)
    ticks[count++] = i * step;
  return count;
}

size_t plot_axis_ticks(const struct plot_axis *axis, size_t wanted, double ticks[PLOT_MOST_TICKS]) {
  static const double digits[] = {1, 2, 5};
  if (!axis->log || axis->high < 8 * axis->low) return linear_ticks(axis, wanted, ticks);
  const double decades = log10(axis->high / axis->low);
  const size_t each = 3 * decades <= 2 * (double)wanted ? 3 : 1; /* ticks at 1 2 5 10, or at powers of ten only */
  const double stride = each == 3 ? 1 : ceil(decades / (double)wanted);
  size_t count = 0;
  for (double power = floor(log10(axis->low)); power <= log10(axis->high); power += stride)
    for (size_t k = 0; k < each; k++) {
      const double value = digits[k] * pow(10, power);
      if (value >= axis->low && value <= axis->high && count < PLOT_MOST_TICKS) ticks[count++] = value;
    }
  return count;
}
