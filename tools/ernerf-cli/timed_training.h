/* SPDX-License-Identifier: MIT
 * What `train --time` trains a head with where no option says it; found by trying (docs/history-small-steps.md). */
#ifndef ERN_CLI_TIMED_TRAINING_H
#define ERN_CLI_TIMED_TRAINING_H

/* On an OpenCL device and among processes each step has a fixed cost: there steps are larger. */
enum { TIMED_RAYS = 512, TIMED_RAYS_AT_ONCE = 2048, TIMED_FRAMES_AT_ONCE = 4, TIMED_EMA_EVERY = 40 };
#define TIMED_PRUNE_SHARE 0.3f

#endif
