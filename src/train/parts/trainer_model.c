/* SPDX-License-Identifier: MIT */
#include "train/parts/trainer_model.h"

#include <string.h>

#include "core/memory.h"
#include "model/torso_ops.h"

bool ern_trainer_is_foreign(const struct ern_training *t, const ern_model *model) {
  return model->clip[0] != 0 && t->identity[0] != 0 && strcmp(model->clip, t->identity) != 0;
}

void ern_trainer_copy_rows(ern_model *to, const ern_model *from, bool torso) {
  for (int r = 0; r < to->table.rows; r++) {
    const struct ern_parameter *row = &to->table.row[r], *its = ern_parameters_find(&from->table, row->name);
    if (its == NULL || row->torso != torso) continue;
    memcpy(to->block + row->at, from->block + its->at,
           (its->count < row->count ? its->count : row->count) * sizeof(float));
  }
  if (torso) {
    memcpy(to->torso_grid, from->torso_grid, ERN_TORSO_CELLS * sizeof(float));
    to->torso_steps = from->torso_steps;
  } else {
    memcpy(to->bits, from->bits, ERN_OCCUPANCY_BYTES);
    to->head_steps = from->head_steps;
  }
}

ern_status ern_trainer_copy_camera(ern_model *to, const ern_model *from) {
  if (from->cameras == 0) return ERN_OK;
  const ern_status status = ERN_NEW(to->context, 6 * from->cameras, &to->camera);
  if (status != ERN_OK) return status;
  memcpy(to->camera, from->camera, 6 * from->cameras * sizeof(float));
  to->cameras = from->cameras;
  memcpy(to->unseen, from->unseen, sizeof to->unseen);
  return ERN_OK;
}

void ern_trainer_log_codes(const struct ern_training *t, const char *path, int found) {
  const int here = t->model->field.config.codes;
  if (found < here)
    ern_log(t->context, ERN_LOG_INFO,
            "%s: has %d individual codes for the %d of this training: they are kept, the other %d are fresh", path,
            found, here, here - found);
  if (found > here)
    ern_log(t->context, ERN_LOG_INFO,
            "%s: has %d individual codes for the %d of this training: the first %d are kept, the others dropped", path,
            found, here, here);
}

void ern_trainer_keep_consent(const struct ern_training *t, const ern_model *from) {
  if (t->config.consent == NULL && !ern_trainer_is_foreign(t, from))
    memcpy(t->model->consent, from->consent, sizeof t->model->consent);
}

ern_status ern_trainer_choose_precision(struct ern_training *t, const char *path, ern_precision wanted) {
  const bool backend = t->backend->trains_bf16, own = ern_field_is_standard(&t->model->field);
  const bool can = backend && own && !t->config.torso;
  t->bf16 = wanted == ERN_PRECISION_BF16 || (wanted == ERN_PRECISION_AUTO && can);
  if (can || !t->bf16) return ERN_OK;
  if (t->config.torso)
    return ern_fail(t->context, ERN_E_UNSUPPORTED, "%s: precision is bf16, expected fp32 for a torso", path);
  if (!own)
    return ern_fail(t->context, ERN_E_UNSUPPORTED,
                    "%s: precision is bf16, expected fp32 for a head that is not trihash with channel attention", path);
  return ern_fail(t->context, ERN_E_UNSUPPORTED,
                  "%s: precision is bf16, expected fp32 on the backend %s, %s: bf16 needs the cpu's instruction set "
                  "avx512bf16",
                  path, t->backend->name, t->backend->isa);
}
