/* SPDX-License-Identifier: MIT */
#include "session/pareto.h"

#include <math.h>
#include <stdlib.h>

/* Differences that count as zero: in dB, and as a share of the time. */
static const double unseen = 0.01, unfelt = 0.01;

/* Two-sided points of Student's t by degrees of freedom, 1 to 30; for more than 30, slightly above the true values. */
enum { FREEDOM = 30 };
static const double t95[FREEDOM] = {12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228,
                                    2.201,  2.179, 2.160, 2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086,
                                    2.080,  2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042};
static const double t99[FREEDOM] = {63.657, 9.925, 5.841, 4.604, 4.032, 3.707, 3.499, 3.355, 3.250, 3.169,
                                    3.106,  3.055, 3.012, 2.977, 2.947, 2.921, 2.898, 2.878, 2.861, 2.845,
                                    2.831,  2.819, 2.807, 2.797, 2.787, 2.779, 2.771, 2.763, 2.756, 2.750};

/* The sign of the mean of paired differences, if its magnitude exceeds `least` and it is significant by Student's t;
 * else 0. */
static int sign_of(const double *differences, size_t count, const double student[FREEDOM], double least) {
  if (count < 2) return 0;
  const struct mean_and_deviation found = mean_of(differences, count);
  const double error = found.deviation / sqrt((double)count);
  if (!(fabs(found.mean) > fmax(least, student[count - 1 < FREEDOM ? count - 2 : FREEDOM - 1] * error))) return 0;
  return found.mean > 0 ? 1 : -1;
}

int pareto_compare_ms(const struct candidate *a, const struct candidate *b) {
  double ratios[PARETO_TURNS];
  size_t count = a->turn_count < b->turn_count ? a->turn_count : b->turn_count;
  if (count > PARETO_TURNS) count = PARETO_TURNS;
  for (size_t t = 0; t < count; t++) ratios[t] = log(b->turns[t] / a->turns[t]);
  return sign_of(ratios, count, t99, unfelt);
}

int pareto_compare_db(const struct candidate *a, const struct candidate *b, size_t frames) {
  double differences[PARETO_FRAMES];
  const size_t count = frames < PARETO_FRAMES ? frames : PARETO_FRAMES;
  for (size_t f = 0; f < count; f++) differences[f] = a->db[f] - b->db[f];
  return sign_of(differences, count, t95, unseen);
}

static bool dominates(const struct candidate *a, const struct candidate *b, size_t frames) {
  const int ms = pareto_compare_ms(a, b), db = pareto_compare_db(a, b, frames);
  return ms >= 0 && db >= 0 && ms + db > 0;
}

/* Whether a is shown rather than b if they cannot be distinguished. */
static bool is_simpler(const struct candidate *a, const struct candidate *b) {
  if (a->changes != b->changes) return a->changes < b->changes;
  return a->ms.median < b->ms.median;
}

/* The simplest point on the front that cannot be distinguished from point k; k if there is none. */
static size_t twin_of(const struct place *places, const struct candidate *c, size_t count, size_t frames, size_t k) {
  size_t best = k;
  for (size_t i = 0; i < count; i++) {
    if (places[i].standing != STANDING_FRONT || pareto_compare_ms(&c[i], &c[k]) != 0) continue;
    if (pareto_compare_db(&c[i], &c[k], frames) == 0 && is_simpler(&c[i], &c[best])) best = i;
  }
  return best;
}

/* Among the points with the standing `wanted` that beat k, the one with the best quality; k if there is none. */
static size_t dominating_point(const struct place *places, enum standing wanted, const struct candidate *c,
                               size_t count, size_t frames, size_t k) {
  double best = -INFINITY;
  size_t found = k;
  for (size_t i = 0; i < count; i++) {
    if (places[i].standing != wanted || !dominates(&c[i], &c[k], frames)) continue;
    const double quality = mean_of(c[i].db, frames).mean;
    if (found == k || quality > best) found = i, best = quality;
  }
  return found;
}

static size_t best_unknown(const struct place *places, const struct candidate *c, size_t count, size_t frames) {
  size_t best = count;
  for (size_t k = 0; k < count; k++)
    if (places[k].standing == STANDING_UNKNOWN &&
        (best == count || mean_of(c[k].db, frames).mean > mean_of(c[best].db, frames).mean))
      best = k;
  return best;
}

/* Finds the kernel of the dominance graph: exactly those points are dominated that a point of the front dominates. A
 * point that only dominated points dominate stays on the front; otherwise a chain of neighbours, each slightly better
 * than the next, would remove a whole end of the front. "Measurably better" is not transitive: in a cycle the point
 * with the best quality stays. */
static void find_kernel(struct place *places, const struct candidate *c, size_t count, size_t frames) {
  for (size_t left = count; left > 0;) {
    const size_t before = left;
    for (size_t k = 0; k < count; k++) {
      if (places[k].standing != STANDING_UNKNOWN) continue;
      const size_t by = dominating_point(places, STANDING_FRONT, c, count, frames, k);
      if (by == k && dominating_point(places, STANDING_UNKNOWN, c, count, frames, k) != k) continue;
      places[k] = (struct place){by == k ? STANDING_FRONT : STANDING_DOMINATED, by};
      left--;
    }
    if (left < before) continue;
    const size_t best = best_unknown(places, c, count, frames);
    places[best] = (struct place){STANDING_FRONT, best};
    left--;
  }
}

void pareto_find(struct place *places, const struct candidate *candidates, size_t count, size_t frames) {
  for (size_t k = 0; k < count; k++) places[k] = (struct place){STANDING_UNKNOWN, k};
  find_kernel(places, candidates, count, frames);
  /* begins with the point with the most changes, so that no kept point has a simpler equal */
  for (size_t done = 0; done < count; done++) {
    size_t k = count;
    for (size_t i = 0; i < count; i++)
      if (places[i].standing == STANDING_FRONT && twin_of(places, candidates, count, frames, i) != i &&
          (k == count || is_simpler(&candidates[k], &candidates[i])))
        k = i;
    if (k == count) return;
    places[k] = (struct place){STANDING_EQUAL, twin_of(places, candidates, count, frames, k)};
  }
}
