/* SPDX-License-Identifier: MIT
 * The communicator of training over MPI 3: sums in a fixed order, and the other operations.
 *
 * A sum uses recursive halving, then recursive doubling (Rabenseifner 2004, "Optimization of Collective Reduction
 * Operations"): a process sends 2 (size - 1)/size of the values, without those that are 0. MPI_Allreduce would be free
 * to choose the order of summation. No MPI call blocks: waits poll, so that they yield the processor and can be
 * abandoned. */
#include "mpi/mpi_world.h"

#include <limits.h>
#include <mpi.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "core/interface_version.h"

enum { SPINS = 200, MOST_LEVELS = 16, MOST_REQUESTS = 4, VALUES_TAG = 1, FIGURES_TAG = 2 };
static const double give_up_seconds = 0.3;          /* mpirun kills 1 s after its request to end */
static const double exit_wait_seconds[2] = {2, 10}; /* of rank 0, and of others: it may have to save */

struct own {
  MPI_Comm all, exit_communicator;
  bool (*interrupted)(void);
  bool given_up; /* a message may still be in transit */
  int rank, size;
  unsigned char *out, *in; /* [capacity]: packed values to send, and received from another process */
  size_t capacity;
  double *figures;
  size_t figure_count;
};

static ern_status fail(const char *what, int code, char words[ERN_COMMUNICATOR_WORDS]) {
  char text[MPI_MAX_ERROR_STRING] = "";
  int length = 0;
  (void)MPI_Error_string(code, text, &length);
  snprintf(words, ERN_COMMUNICATOR_WORDS, "MPI: %s: %.400s", what, text);
  return ERN_E_IO;
}

/* ---- waiting ----------------------------------------------------------------------------------------------------- */

static void pause_between(unsigned turn) {
  const struct timespec pause = {0, 50 * 1000};
  if (turn < SPINS)
    (void)sched_yield();
  else
    (void)nanosleep(&pause, NULL);
}

static ern_status wait_for(struct own *own, int count, MPI_Request *requests, const char *what,
                           char words[ERN_COMMUNICATOR_WORDS]) {
  MPI_Status statuses[MOST_REQUESTS];
  double asked = 0;
  for (unsigned turn = 0;; turn += turn < SPINS) {
    int done = 0;
    const int code = MPI_Testall(count, requests, &done, statuses);
    if (code != MPI_SUCCESS) own->given_up = true;
    if (code != MPI_SUCCESS) return fail(what, code, words);
    if (done) return ERN_OK;
    pause_between(turn);
    if (own->interrupted == NULL || !own->interrupted()) continue;
    if (asked == 0) asked = MPI_Wtime();
    if (MPI_Wtime() - asked < give_up_seconds) continue;
    own->given_up = true;
    snprintf(words, ERN_COMMUNICATOR_WORDS,
             "was told to end while it waited for another process (%s): that was ended too, or has died", what);
    return ERN_E_IO;
  }
}

/* ---- values without zeros ---------------------------------------------------------------------------------------- */

/* Sparse encoding: each GROUP of values has a bit mask, bit j for value j, followed by the values whose bit is set,
 * those that are not +0. A step reaches a third of a table (docs/scaling.md). The receiver adds +0 for a value that was
 * left out, so the sum is bit-identical. */
enum { GROUP = 64 };

/* The most bytes that `count` packed values take, with room to read one value more. */
static size_t packed_most(size_t count) { return (count + 1) * sizeof(float) + (count / GROUP + 1) * sizeof(uint64_t); }

/* Returns the number of bytes. */
static size_t pack(unsigned char *to, const float *values, size_t count) {
  unsigned char *const begin = to;
  for (size_t i = 0; i < count; i += GROUP) {
    const size_t n = count - i < GROUP ? count - i : GROUP;
    uint64_t there = 0;
    float kept[GROUP];
    size_t k = 0;
    for (size_t j = 0; j < n; j++) {
      uint32_t bits;
      memcpy(&bits, values + i + j, sizeof bits);
      kept[k] = values[i + j];
      there |= (uint64_t)(bits != 0) << j;
      k += bits != 0;
    }
    memcpy(to, &there, sizeof there);
    memcpy(to + sizeof there, kept, k * sizeof *kept);
    to += sizeof there + k * sizeof *kept;
  }
  return (size_t)(to - begin);
}

/* add: adds to the present values; else overwrites them. */
static void unpack(float *to, const unsigned char *from, size_t count, bool add) {
  for (size_t i = 0; i < count; i += GROUP) {
    const size_t n = count - i < GROUP ? count - i : GROUP;
    uint64_t there;
    memcpy(&there, from, sizeof there);
    from += sizeof there;
    for (size_t j = 0; j < n; j++) {
      const bool is = (there >> j & 1) != 0;
      float value;
      memcpy(&value, from, sizeof value);
      value = is ? value : 0;
      from += is ? sizeof value : 0;
      to[i + j] = add ? to[i + j] + value : value;
    }
  }
}

/* ---- the sum ----------------------------------------------------------------------------------------------------- */

static ern_status reserve(struct own *own, size_t values, size_t figures, char words[ERN_COMMUNICATOR_WORDS]) {
  const size_t bytes = packed_most(values);
  if (values > INT_MAX / 8 || figures > INT_MAX) {
    snprintf(words, ERN_COMMUNICATOR_WORDS, "MPI: %zu values, expected at most %d", values, INT_MAX / 8);
    return ERN_E_UNSUPPORTED;
  }
  if (own->capacity < bytes) {
    free(own->out);
    free(own->in);
    own->out = malloc(bytes);
    own->in = malloc(bytes);
    own->capacity = own->out != NULL && own->in != NULL ? bytes : 0;
  }
  double *more_figures =
      own->figure_count < figures ? realloc(own->figures, figures * sizeof *own->figures) : own->figures;
  if (more_figures != NULL && own->figure_count < figures) own->figure_count = figures;
  if (more_figures != NULL) own->figures = more_figures;
  if (own->capacity >= bytes && own->figure_count >= figures) return ERN_OK;
  snprintf(words, ERN_COMMUNICATOR_WORDS, "no memory for %zu values of another process", values);
  return ERN_E_NO_MEMORY;
}

struct half {
  size_t begin, count;
};

/* Sends the range `sent` of the values and receives the range `back` from another process, which is added where `add`
 * is set. Exchanges the figures where figure_count > 0. */
static ern_status exchange(struct own *own, int partner, float *values, struct half sent, struct half back, bool add,
                           double *figures, size_t figure_count, char words[ERN_COMMUNICATOR_WORDS]) {
  MPI_Request requests[MOST_REQUESTS];
  int count = 0, code = MPI_Irecv(own->in, (int)packed_most(back.count), MPI_BYTE, partner, VALUES_TAG, own->all,
                                  &requests[count++]);
  if (code == MPI_SUCCESS && figure_count > 0)
    code = MPI_Irecv(own->figures, (int)figure_count, MPI_DOUBLE, partner, FIGURES_TAG, own->all, &requests[count++]);
  if (code == MPI_SUCCESS && figure_count > 0)
    code = MPI_Isend(figures, (int)figure_count, MPI_DOUBLE, partner, FIGURES_TAG, own->all, &requests[count++]);
  if (code == MPI_SUCCESS)
    code = MPI_Isend(own->out, (int)pack(own->out, values + sent.begin, sent.count), MPI_BYTE, partner, VALUES_TAG,
                     own->all, &requests[count++]);
  if (code != MPI_SUCCESS) own->given_up = true;
  const ern_status status = code == MPI_SUCCESS ? wait_for(own, count, requests, "the sum of a step", words)
                                                : fail("the sum of a step", code, words);
  if (status == ERN_OK) unpack(values + back.begin, own->in, back.count, add);
  return status;
}

/* a + b is bit-identical to b + a, so each element is summed in the tree's order on any process. */
static ern_status sum(void *user, float *values, size_t count, double *figures, size_t figure_count,
                      char words[ERN_COMMUNICATOR_WORDS]) {
  struct own *own = user;
  struct half mine = {0, count}, sent[MOST_LEVELS];
  int level = 0;
  ern_status status = reserve(own, count - count / 2, figure_count, words);
  for (int apart = 1; apart < own->size && status == ERN_OK; apart *= 2, level++) {
    const struct half low = {mine.begin, mine.count / 2},
                      high = {mine.begin + mine.count / 2, mine.count - mine.count / 2};
    const bool upper = (own->rank & apart) != 0;
    mine = upper ? high : low;
    sent[level] = upper ? low : high;
    status = exchange(own, own->rank ^ apart, values, sent[level], mine, true, figures, figure_count, words);
    for (size_t i = 0; status == ERN_OK && i < figure_count; i++) figures[i] += own->figures[i];
  }
  for (int apart = own->size / 2; apart > 0 && status == ERN_OK; apart /= 2) {
    const struct half *back = &sent[--level];
    status = exchange(own, own->rank ^ apart, values, mine, *back, false, NULL, 0, words);
    mine = (struct half){back->begin < mine.begin ? back->begin : mine.begin, mine.count + back->count};
  }
  return status;
}

/* ---- the others -------------------------------------------------------------------------------------------------- */

static ern_status gather(void *user, float *values, size_t count, char words[ERN_COMMUNICATOR_WORDS]) {
  struct own *own = user;
  const size_t size = (size_t)own->size;
  MPI_Request request;
  int *counts = NULL;
  if (count > INT_MAX || (counts = malloc(2 * size * sizeof *counts)) == NULL) {
    snprintf(words, ERN_COMMUNICATOR_WORDS, "MPI: no memory for %zu values, or they are too many", count);
    return ERN_E_NO_MEMORY;
  }
  int *begins = counts + size;
  for (size_t r = 0; r < size; r++) begins[r] = (int)(count * r / size);
  for (size_t r = 0; r < size; r++) counts[r] = (int)(count * (r + 1) / size) - begins[r];
  const int code = MPI_Iallgatherv(MPI_IN_PLACE, 0, MPI_FLOAT, values, counts, begins, MPI_FLOAT, own->all, &request);
  const ern_status status = code == MPI_SUCCESS ? wait_for(own, 1, &request, "an occupancy refresh", words)
                                                : fail("an occupancy refresh", code, words);
  if (!own->given_up) free(counts);
  return status;
}

static ern_status broadcast(void *user, void *bytes, size_t count, char words[ERN_COMMUNICATOR_WORDS]) {
  enum { PIECE = 1 << 26 };
  struct own *own = user;
  ern_status status = ERN_OK;
  for (size_t at = 0; at < count && status == ERN_OK; at += PIECE) {
    const size_t left = count - at;
    MPI_Request request;
    const int code =
        MPI_Ibcast((char *)bytes + at, (int)(left < PIECE ? left : PIECE), MPI_BYTE, 0, own->all, &request);
    status = code == MPI_SUCCESS ? wait_for(own, 1, &request, "what rank 0 has", words)
                                 : fail("what rank 0 has", code, words);
  }
  return status;
}

/* ---- beginning and end ------------------------------------------------------------------------------------------- */

static int place_on_machine(const struct own *own) {
  MPI_Comm machine;
  int place = 0;
  if (MPI_Comm_split_type(own->all, MPI_COMM_TYPE_SHARED, own->rank, MPI_INFO_NULL, &machine) != MPI_SUCCESS) return 0;
  (void)MPI_Comm_rank(machine, &place);
  (void)MPI_Comm_free(&machine);
  return place;
}

static ern_status open_world(struct ern_mpi_world *world, bool (*interrupted)(void),
                             char words[ERN_COMMUNICATOR_WORDS]) {
  int provided = 0, code = MPI_Init_thread(NULL, NULL, MPI_THREAD_FUNNELED, &provided);
  struct own *own = calloc(1, sizeof *own);
  *world = (struct ern_mpi_world){.place = 0};
  if (own == NULL) {
    snprintf(words, ERN_COMMUNICATOR_WORDS, "no memory for MPI");
    return ERN_E_NO_MEMORY;
  }
  if (code == MPI_SUCCESS) code = MPI_Comm_dup(MPI_COMM_WORLD, &own->all);
  if (code == MPI_SUCCESS) code = MPI_Comm_dup(MPI_COMM_WORLD, &own->exit_communicator);
  if (code == MPI_SUCCESS) code = MPI_Comm_set_errhandler(own->all, MPI_ERRORS_RETURN);
  if (code == MPI_SUCCESS) code = MPI_Comm_set_errhandler(own->exit_communicator, MPI_ERRORS_RETURN);
  if (code != MPI_SUCCESS) {
    free(own);
    return fail("cannot begin", code, words);
  }
  (void)MPI_Comm_rank(own->all, &own->rank);
  (void)MPI_Comm_size(own->all, &own->size);
  own->interrupted = interrupted;
  *world = (struct ern_mpi_world){{own, own->rank, own->size, sum, gather, broadcast}, place_on_machine(own)};
  return ERN_OK;
}

/* Whether all processes arrive here in time. A process that has given up only waits, as rank 0 may still save. */
static bool exit_barrier(struct own *own) {
  MPI_Request request = MPI_REQUEST_NULL;
  int done = 0;
  const double began = MPI_Wtime(), most = exit_wait_seconds[own->rank > 0];
  if (own->given_up && own->rank == 0) return false;
  if (!own->given_up && MPI_Ibarrier(own->exit_communicator, &request) != MPI_SUCCESS) return false;
  while (!done && MPI_Wtime() - began < most) {
    if (!own->given_up && MPI_Test(&request, &done, MPI_STATUS_IGNORE) != MPI_SUCCESS) return false;
    pause_between(SPINS);
  }
  return done != 0;
}

static void close_world(struct ern_mpi_world *world, int exit_status) {
  struct own *own = world->communicator.user;
  if (own == NULL) return;
  if (exit_status != 0 && !exit_barrier(own)) MPI_Abort(MPI_COMM_WORLD, exit_status);
  (void)MPI_Comm_free(&own->all);
  (void)MPI_Comm_free(&own->exit_communicator);
  (void)MPI_Finalize();
  free(own->out);
  free(own->in);
  free(own->figures);
  free(own);
  *world = (struct ern_mpi_world){.place = 0};
}

#define TEXT_OF(x) #x
#define TEXT(x) TEXT_OF(x)
#ifdef OMPI_MAJOR_VERSION
#define KIND "Open MPI " TEXT(OMPI_MAJOR_VERSION) "." TEXT(OMPI_MINOR_VERSION) "." TEXT(OMPI_RELEASE_VERSION)
#elif defined(MPICH_VERSION)
#define KIND "MPICH " MPICH_VERSION
#else
#define KIND "MPI " TEXT(MPI_VERSION) "." TEXT(MPI_SUBVERSION)
#endif

const struct ern_mpi ern_mpi = {ERN_INTERFACE_VERSION, KIND, open_world, close_world};
