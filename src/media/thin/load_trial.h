/* SPDX-License-Identifier: MIT
 * Whether a library can be loaded where memory or threads are short. Libraries that libernerf's need, such as log4cplus
 * and OpenImageIO, start threads and allocate while they are loaded; an exception there ends the process. */
#ifndef ERN_MEDIA_THIN_LOAD_TRIAL_H
#define ERN_MEDIA_THIN_LOAD_TRIAL_H

#include <stdbool.h>

/* Where the process has a limit of address space or data (ulimit -v, -d), or cannot start some threads, a child process
 * loads the library first, after those of `first` (NULL at the end, or NULL: none), as its caller does. false: that
 * ended the child. */
bool ern_load_trial(const char *file, const char *const *first);

#endif
