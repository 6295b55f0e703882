/* SPDX-License-Identifier: MIT
 * The parameter table: one row a tensor, one block of memory, built from the model's configuration by one function.
 * Optimizer, average, checkpoint, gradient check and `info` iterate it. */
#ifndef ERN_MODEL_PARAMETERS_H
#define ERN_MODEL_PARAMETERS_H

#include "core/status.h"
#include "model/field.h"

enum { ERN_MAX_PARAMETERS = 64, ERN_PARAMETER_DIMS = 3, ERN_PARAMETER_NAME = 64 };

/* Learning-rate groups (docs/maths.md, Update). */
typedef enum ern_group { ERN_GROUP_GRID, ERN_GROUP_NET, ERN_GROUP_AUDIO_ATT } ern_group;

typedef enum ern_init {
  ERN_INIT_UNIFORM, /* [-range, range] */
  ERN_INIT_NORMAL,  /* range * normal(0, 1) */
  ERN_INIT_ANCHORS, /* the key points of docs/maths.md, Torso */
  ERN_INIT_ONE
} ern_init;

struct ern_parameter {
  char name[ERN_PARAMETER_NAME]; /* the public checkpoint's */
  int dims;
  size_t shape[ERN_PARAMETER_DIMS];
  size_t at, count; /* in the block; `at` is a multiple of 16 reals */
  ern_group group;
  bool torso; /* trained with the torso; false: with the head */
  ern_init init;
  float range;
};

struct ern_parameter_table {
  struct ern_parameter row[ERN_MAX_PARAMETERS];
  int rows;
};

/* Checks the configuration and lays out the block. ERN_E_ARGUMENT names the field that is wrong. */
ERN_NODISCARD ern_status ern_parameters_build(ern_context *context, const struct ern_model_config *config,
                                              struct ern_field *field, struct ern_parameter_table *table);

/* Name prefix of the tensors of an encoder's grid: "encoder_xy". */
const char *ern_encoder_grid_name(const struct ern_field *field, int grid);

/* NULL where there is none. */
const struct ern_parameter *ern_parameters_find(const struct ern_parameter_table *table, const char *name);

/* Fresh values of the rows with torso == `torso`; the same for the same seed. block: [field.parameters]. */
void ern_parameters_init(float *block, const struct ern_parameter_table *table, bool torso, uint64_t seed);

#endif
