/* SPDX-License-Identifier: MIT
 * In front of every kernel source. Built with WIDTH (floats in a work-item's vector: 1, 4, 8 or 16), CPU (1 where
 * work-items run on the host's cores) and the device's limits.
 *
 * A span comes as (base, offset) and rows as (base, offset, stride); OPEN makes the pointer, null where there is none:
 *
 *   kernel void ema(SPAN(float, average), SPAN(const float, parameters), float decay, ulong n) {
 *     OPEN(float, average);
 *     OPEN(const float, parameters);
 *
 * Layout: channel c of sample i of rows is at [c*x_stride + i]. */
#define SPAN(type, name) global type *name##_base, ulong name##_at
#define ROWS(type, name) global type *name##_base, ulong name##_at, ulong name##_stride
#define OPEN(type, name) global type *const name = name##_base ? name##_base + name##_at : 0
