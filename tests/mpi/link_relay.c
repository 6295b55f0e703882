/* SPDX-License-Identifier: MIT
 * A link of a rate and a delay between two network namespaces, for kernels without netem: a device tun0 in each, and
 * packets that are carried from one to the other, in their order, when a link would have. A packet leaves when those
 * before it have left and its own bytes have passed at the rate, and arrives the delay later. Needs CAP_NET_ADMIN.
 *
 *   link_relay NAMESPACE NAMESPACE GBIT MS     two files such as /proc/PID/ns/net; "ready" when the devices are there
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <linux/if.h>
#include <linux/if_tun.h>
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <time.h>
#include <unistd.h>

enum { SLOTS = 1 << 13, MOST_BYTES = 9000 /* the devices' MTU */ };
static const double spin = 1e-4; /* seconds before its time up to which the writer may sleep: a sleep ends late */

struct packet {
  double due; /* seconds of the clock */
  ssize_t bytes;
  char data[MOST_BYTES];
};

struct way {
  int from, to;
  double rate, delay;     /* bytes a second; seconds */
  struct packet *packets; /* [SLOTS], a queue from tail to head */
  atomic_uint head, tail;
};

static double seconds(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void rest(double duration) {
  const struct timespec time = {(time_t)duration, (long)((duration - (double)(time_t)duration) * 1e9)};
  nanosleep(&time, NULL);
}

static void *read_packets(void *user) {
  struct way *way = user;
  double free_at = 0; /* when the packets that were taken have left */
  for (;;) {
    const unsigned head = atomic_load(&way->head);
    while (head - atomic_load(&way->tail) >= SLOTS) sched_yield();
    struct packet *packet = &way->packets[head % SLOTS];
    packet->bytes = read(way->from, packet->data, sizeof packet->data);
    if (packet->bytes <= 0) continue;
    const double now = seconds();
    free_at = (free_at > now ? free_at : now) + (double)packet->bytes / way->rate;
    packet->due = free_at + way->delay;
    atomic_store(&way->head, head + 1);
  }
  return NULL;
}

static void *write_packets(void *user) {
  struct way *way = user;
  for (;;) {
    const unsigned tail = atomic_load(&way->tail);
    const struct packet *packet = &way->packets[tail % SLOTS];
    const bool there = tail != atomic_load(&way->head);
    const double left = there ? packet->due - seconds() : 0;
    if (!there) {
      rest(spin / 5);
    } else if (left > spin) {
      rest(left - spin / 2);
    } else if (left <= 0) {
      if (write(way->to, packet->data, (size_t)packet->bytes) < 0 && errno != EIO) /* EIO: the device is not up yet */
        perror("link_relay: a packet is lost");
      atomic_store(&way->tail, tail + 1);
    }
  }
  return NULL;
}

/* tun0 of the namespace, which this thread is in afterwards. -1: an error, which errno tells. */
static int open_device(const char *space) {
  struct ifreq request = {.ifr_name = "tun0", .ifr_flags = IFF_TUN | IFF_NO_PI};
  const int file = open(space, O_RDONLY);
  if (file < 0 || setns(file, CLONE_NEWNET) != 0) return -1;
  const int device = open("/dev/net/tun", O_RDWR);
  return device < 0 || ioctl(device, TUNSETIFF, &request) != 0 ? -1 : device;
}

int main(int argc, char **argv) {
  static struct way ways[2];
  pthread_t threads[4];
  const double gbit = argc == 5 ? atof(argv[3]) : 0, ms = argc == 5 ? atof(argv[4]) : -1;
  if (!(gbit > 0 && ms >= 0)) {
    fprintf(stderr, "usage: link_relay NAMESPACE NAMESPACE GBIT MS\n");
    return 2;
  }
  for (int k = 0; k < 2; k++) {
    const int device = open_device(argv[1 + k]);
    if (device < 0) {
      fprintf(stderr, "link_relay: %s: %s\n", argv[1 + k], strerror(errno));
      return 1;
    }
    ways[k].from = ways[1 - k].to = device;
  }
  for (int k = 0; k < 2; k++) {
    ways[k].rate = gbit * 1e9 / 8;
    ways[k].delay = ms * 1e-3;
    ways[k].packets = calloc(SLOTS, sizeof *ways[k].packets);
    if (ways[k].packets == NULL || pthread_create(&threads[2 * k], NULL, read_packets, &ways[k]) != 0 ||
        pthread_create(&threads[2 * k + 1], NULL, write_packets, &ways[k]) != 0) {
      fprintf(stderr, "link_relay: no memory or threads\n");
      return 1;
    }
  }
  puts("ready");
  fflush(stdout);
  pause();
  return 0;
}
