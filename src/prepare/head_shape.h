/* SPDX-License-Identifier: MIT
 * A generic head in the head's own frame (prepare_job.h): metres, x right in the picture, y up, z out of the face,
 * origin in the middle of the head. The eyes' distance, 63 mm (the adults' mean), is the unit of every clip. */
#ifndef ERN_PREPARE_HEAD_SHAPE_H
#define ERN_PREPARE_HEAD_SHAPE_H

#ifdef __cplusplus
extern "C" {
#endif

#define ERN_HEAD_EYES 0.063 /* between the middles of the eyes */
/* Half axes of the ellipsoid that stands for skull and face without the nose, about the origin. */
#define ERN_HEAD_WIDE 0.075
#define ERN_HEAD_TALL 0.115
#define ERN_HEAD_DEEP 0.100
/* Middle of the eyes. */
#define ERN_HEAD_EYES_Y 0.030
#define ERN_HEAD_EYES_Z 0.085

#ifdef __cplusplus
}
#endif
#endif
