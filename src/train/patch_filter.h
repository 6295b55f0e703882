/* SPDX-License-Identifier: MIT */
#ifndef ERN_TRAIN_PATCH_FILTER_H
#define ERN_TRAIN_PATCH_FILTER_H

/* filter [ern_patch_filter_count(side)] of patches_ops.h. side: a multiple of ERN_PATCH_UNIT. */
void ern_patch_filter(float *filter, int side);

#endif
