/* SPDX-License-Identifier: MIT */
#include "evaluation/perceptual_distance.h"

#include <stdlib.h>

int perceptual_distance_open(struct perceptual_distance *perceptual, const struct evaluation *evaluation) {
  const size_t pixels = (size_t)evaluation->info.width * (size_t)evaluation->info.height;
  if (perceptual->weights.network == NULL) return 0;
  if (lpips_weights_open(&perceptual->weights, evaluation->session) != 0) return EXIT_FAILURE;
  perceptual->pictures = malloc(6 * pixels * sizeof *perceptual->pictures);
  return perceptual->pictures != NULL ? 0 : session_fail_with(evaluation->session, "no memory for LPIPS");
}

void perceptual_distance_close(struct perceptual_distance *perceptual) {
  lpips_weights_close(&perceptual->weights);
  free(perceptual->pictures);
  perceptual->pictures = NULL;
}

int perceptual_distance_of(struct perceptual_distance *perceptual, const struct evaluation *evaluation, size_t k,
                           double *distance) {
  const struct source_frame *frame = &evaluation->frame_source.source_frame[k];
  const size_t pixels = (size_t)evaluation->info.width * (size_t)evaluation->info.height;
  float *const drawn = perceptual->pictures;
  ern_image truth = {0};
  if (evaluate_truth(evaluation, frame, &truth) != 0) return EXIT_FAILURE;
  for (size_t i = 0; i < pixels; i++)
    for (size_t c = 0; c < 3; c++) {
      drawn[c * pixels + i] = evaluation->rgb[3 * i + c];
      drawn[(3 + c) * pixels + i] = (float)truth.data[3 * i + c] / 255;
    }
  if (ern_lpips_distance(perceptual->weights.lpips, drawn, drawn + 3 * pixels, truth.width, truth.height, distance,
                         NULL) != ERN_OK)
    return session_fail(evaluation->session);
  return 0;
}

int perceptual_distance_add(struct perceptual_distance *perceptual, const struct evaluation *evaluation, size_t k,
                            json_t *row) {
  double distance = 0;
  if (perceptual->weights.lpips == NULL) return 0;
  if (perceptual_distance_of(perceptual, evaluation, k, &distance) != 0) return EXIT_FAILURE;
  perceptual->sum += distance;
  perceptual->frames++;
  json_object_set_new(row, "lpips", session_number(distance));
  return 0;
}
