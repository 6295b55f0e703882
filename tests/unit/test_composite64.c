/* SPDX-License-Identifier: MIT
 * The tests of compositing, of the double build. */
#define ERN_DOUBLE
#include "test_composite.c"
