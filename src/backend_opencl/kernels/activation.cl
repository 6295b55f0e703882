/* SPDX-License-Identifier: MIT
 * Output activations. A group works on one row (samples.cl). */

/* exp may overflow to infinity; the quotient is then 0 */
static inline floatw sigmoid(floatw x) { return 1 / (1 + exp(-x)); }

/* s(x) (1 - s(x)) = e/(1 + e)^2 with e = exp(-|x|): without cancellation where s is near 1 */
static inline floatw sigmoid_derivative(floatw x) {
  const floatw e = exp(-fabs(x));
  return e / ((1 + e) * (1 + e));
}

/* NaN stays NaN. */
static inline floatw clamp_above(floatw x, float high) { return WHERE(x > high, high, x); }
static inline floatw clamp_below(floatw x, float low) { return WHERE(x < low, low, x); }

/* log(1 + exp(x)) = max(x, 0) + log(1 + exp(-|x|)) */
static inline floatw softplus(floatw x) { return clamp_below(x, 0) + log1p(exp(-fabs(x))); }

/* y, x: rows; group = row*blocks + block. One kernel for each kind of ern_activation: `value` is y as a function of
 * `from` = x. */
#define ACTIVATE_FWD(kind, value)                                                                \
  KERNEL activate_fwd_##kind(ROWS(float, y), ROWS(const float, x), uint blocks, ulong n) {       \
    OPEN(float, y);                                                                              \
    OPEN(const float, x);                                                                        \
    const ulong row = (uint)get_group_id(0) / blocks;                                            \
    EACH_SAMPLE(i, (uint)get_group_id(0) % blocks) {                                             \
      const floatw from = loadw_first(x + row * x_stride + i, n - i);                            \
      storew_first(y + row * y_stride + i, value, n - i);                                        \
    }                                                                                            \
  }
ACTIVATE_FWD(density, exp(clamp_above(from, 80)))
ACTIVATE_FWD(colour, 1.002f * sigmoid(from) - 0.001f)
ACTIVATE_FWD(sigmoid, sigmoid(from))
ACTIVATE_FWD(softplus, softplus(from))
ACTIVATE_FWD(relu, clamp_below(from, 0))

/* `value` is dx as a function of `from` = x and `by` = dy; dx may be the same rows as dy. */
#define ACTIVATE_BWD(kind, value)                                                                        \
  KERNEL activate_bwd_##kind(ROWS(float, dx), ROWS(const float, dy), ROWS(const float, x), uint blocks,  \
                             ulong n) {                                                                  \
    OPEN(float, dx);                                                                                     \
    OPEN(const float, dy);                                                                               \
    OPEN(const float, x);                                                                                \
    const ulong row = (uint)get_group_id(0) / blocks;                                                    \
    EACH_SAMPLE(i, (uint)get_group_id(0) % blocks) {                                                     \
      const floatw from = loadw_first(x + row * x_stride + i, n - i);                                    \
      const floatw by = loadw_first(dy + row * dy_stride + i, n - i);                                    \
      storew_first(dx + row * dx_stride + i, value, n - i);                                              \
    }                                                                                                    \
  }
ACTIVATE_BWD(density, by * exp(clamp_below(clamp_above(from, 15), -15)))
ACTIVATE_BWD(colour, by * (1.002f * sigmoid_derivative(from)))
ACTIVATE_BWD(sigmoid, by * sigmoid_derivative(from))
ACTIVATE_BWD(softplus, by * sigmoid(from))
ACTIVATE_BWD(relu, WHERE(from <= 0, 0, by))
