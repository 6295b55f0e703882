/* SPDX-License-Identifier: MIT
 * Sizes that the MLP kernels need. */
#include "mlp/mlp.h"
#include "mlp/mlp_tile.h"

size_t ern_mlp_scratch(const struct ern_mlp *mlp) { return ern_mlp_layout_make(mlp).count; }
