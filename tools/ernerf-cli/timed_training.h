/* SPDX-License-Identifier: MIT
 * Defaults with which `train --time` trains a head, found by experiment (docs/results.md). */
#ifndef ERN_CLI_TIMED_TRAINING_H
#define ERN_CLI_TIMED_TRAINING_H

/* The _AT_ONCE values are for OpenCL devices and several processes: each step has a fixed cost there, so steps are
 * larger. */
enum { TIMED_RAYS = 512, TIMED_RAYS_AT_ONCE = 2048, TIMED_FRAMES_AT_ONCE = 4, TIMED_EMA_EVERY = 40 };
#define TIMED_PRUNE_SHARE 0.3f

#endif
