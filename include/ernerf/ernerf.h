/* SPDX-License-Identifier: MIT
 * libernerf: talking portraits, trained and rendered in C (ER-NeRF, ICCV 2023).
 *
 *   ern_context *context = NULL;
 *   ern_backend *backend = NULL;
 *   ern_model *model = NULL;
 *   ern_renderer *renderer = NULL;
 *   if (ern_context_create(&context, NULL) != ERN_OK) ...
 *   if (ern_backend_create(&backend, context, NULL) != ERN_OK) ...    ern_last_error(context) says why
 *   if (ern_model_load(&model, context, "portrait.safetensors") != ERN_OK) ...
 *   if (ern_renderer_create(&renderer, backend, model, NULL) != ERN_OK) ...
 *   for each video frame: ern_audio_windows(), ern_camera_pose(), ern_renderer_frame(); data.h loads features and poses
 *   ern_renderer_free(&renderer); ern_model_free(&model); ern_backend_free(&backend); ern_context_free(&context);
 *
 * Training: train.h. Not included here, of other libraries: media.h, speech.h, live.h, stream.h (libernerf-media),
 * prepare.h (libernerf-prepare). */
#ifndef ERNERF_ERNERF_H
#define ERNERF_ERNERF_H

#include "ernerf/backend.h"
#include "ernerf/base.h"
#include "ernerf/data.h"
#include "ernerf/model.h"
#include "ernerf/render.h"
#include "ernerf/setting.h"
#include "ernerf/train.h"

#endif
