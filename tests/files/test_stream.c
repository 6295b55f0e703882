/* SPDX-License-Identifier: MIT
 * Streams: exact times in every form, sound as it comes, names of files and addresses, and waits that end when asked
 * to. */
#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <pthread.h>
#include <stdbool.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <sys/un.h>
#include <time.h>

#include "stream_support.h"

static void make_fifo(const char *path) {
  (void)unlink(path);
  assert_int_equal(mkfifo(path, 0600), 0);
}

/* ---- the other side of a FIFO ------------------------------------------------------------------------------------ */

struct copy {
  const char *from, *to;
};

static void *copy_all(void *user) {
  const struct copy *copy = user;
  uint8_t bytes[4096];
  const int from = open(copy->from, O_RDONLY | O_CLOEXEC);
  FILE *to = fopen(copy->to, "wb");
  for (ssize_t got = 1; from >= 0 && to != NULL && got > 0;) {
    got = read(from, bytes, sizeof bytes);
    if (got > 0 && fwrite(bytes, 1, (size_t)got, to) != (size_t)got) got = -1;
  }
  if (from >= 0) (void)close(from);
  if (to != NULL) (void)fclose(to);
  return NULL;
}

static void write_through_fifo(const char *to, const ern_stream_options *options, int silent) {
  struct copy copy = {"through", to};
  pthread_t thread;
  make_fifo(copy.from);
  assert_int_equal(pthread_create(&thread, NULL, copy_all, &copy), 0);
  support_ok(context, write_stream_after(copy.from, options, silent));
  assert_int_equal(pthread_join(thread, NULL), 0);
}

/* A sound that begins a second after the first picture. */
static void check_loud(int pipe, const ern_stream_options *options) {
  (void)unlink("loud");
  if (pipe)
    write_through_fifo("loud", options, FPS);
  else
    support_ok(context, write_stream_after("loud", options, FPS));
  const double loud = loud_after_picture("loud");
  if (!(fabs(loud - 1) < 0.005)) fail_msg("%s: the sound begins at %g s, expected 1 s", options->format, loud);
}

/* Of files and of streams, in each form with stamps. AAC's first packet, 1024 samples, comes before the first picture;
 * mpegts begins later than 0 on purpose. */
static void test_each_form_has_exact_times(void **state) {
  (void)state;
  static const char *const forms[] = {"mp4", "matroska", "mpegts", "flv", "nut"};
  const size_t before = descriptors();
  for (size_t i = 0; i < sizeof forms / sizeof *forms; i++) {
    const ern_stream_options options = options_of_stream(forms[i]);
    for (int pipe = 0; pipe < 2; pipe++) {
      (void)unlink("stream");
      if (pipe)
        write_through_fifo("stream", &options, 0);
      else
        support_ok(context, write_stream("stream", &options));
      const struct times times = times_of("stream");
      if (times.pictures != FRAMES || times.wrong != 0)
        fail_msg("%s: %d pictures, %d of them at a wrong time", forms[i], times.pictures, times.wrong);
      const double priming = strcmp(forms[i], "nut") == 0 ? 0 : 1024.0 / RATE, ahead = times.first_picture,
                   most = priming + 0.002;
      if (fabs(times.first_sound - ahead) > most || times.last_sound - ahead < (double)FRAMES / FPS - 0.002 ||
          times.last_sound - ahead > (double)FRAMES / FPS + 2 * most)
        fail_msg("%s: sound from %g to %g s, pictures from %g s", forms[i], times.first_sound, times.last_sound, ahead);
      if (priming > 0) check_loud(pipe, &options);
    }
  }
  assert_int_equal(descriptors(), before);
}

static void test_raw_pictures_and_y4m(void **state) {
  (void)state;
  static uint8_t wanted[SIDE * SIDE * 4], found[SIDE * SIDE * 4];
  struct stat there;
  (void)unlink("stream.rgba");
  (void)unlink("stream.y4m");
  const ern_stream_options options = options_of_stream(NULL);
  support_ok(context, write_stream("stream.rgba", &options));
  FILE *file = fopen("stream.rgba", "rb");
  assert_non_null(file);
  for (int k = 0; k < FRAMES; k++) {
    paint(wanted, k == REPEATED ? k - 1 : k);
    assert_int_equal(fread(found, 1, sizeof found, file), sizeof found);
    assert_memory_equal(found, wanted, sizeof wanted);
  }
  assert_int_equal(fgetc(file), EOF);
  (void)fclose(file);
  support_ok(context, write_stream("stream.y4m", &options));
  assert_int_equal(stat("stream.y4m", &there), 0);
  assert_in_range(there.st_size, FRAMES * (SIDE * SIDE * 3 / 2 + 6), FRAMES * (SIDE * SIDE * 3 / 2 + 6) + 200);
}

/* ---- sound in ---------------------------------------------------------------------------------------------------- */

/* Sends the next piece only after the last one was read, but for what is less than one of FFmpeg's packets: a reader
 * that waits for more than there is never ends. */
struct sender {
  const char *path;
  atomic_size_t read;
  int pieces;
};

enum { PIECE = 1600, PACKET = 1024 };

static void *send_pieces(void *user) {
  struct sender *sender = user;
  int16_t samples[PIECE];
  const int to = open(sender->path, O_WRONLY | O_CLOEXEC);
  for (int k = 0; to >= 0 && k < sender->pieces; k++) {
    for (int i = 0; i < PIECE; i++) samples[i] = (int16_t)(k * PIECE + i);
    if (write(to, samples, sizeof samples) != (ssize_t)sizeof samples) break;
    for (int look = 0; look < 100 * PATIENCE && atomic_load(&sender->read) + PACKET < (size_t)(k + 1) * PIECE; look++)
      (void)nanosleep(&(struct timespec){.tv_nsec = 1000000}, NULL);
  }
  if (to >= 0) (void)close(to);
  return NULL;
}

static void test_sound_is_read_as_it_comes(void **state) {
  (void)state;
  struct patience patience = {PATIENCE};
  struct sender sender = {.path = "sound", .pieces = 6};
  float samples[500];
  size_t frames = 1;
  pthread_t thread;
  ern_sound_reader *reader;
  ern_sound_reader_options options = ern_sound_reader_options_default();
  options.format = "s16le";
  options.rate = 16000;
  options.stop = loses_patience;
  options.user = &patience;
  const size_t before = descriptors();
  make_fifo(sender.path);
  assert_int_equal(pthread_create(&thread, NULL, send_pieces, &sender), 0);
  support_ok(context, ern_sound_reader_open(context, sender.path, &options, &reader));
  while (frames > 0) {
    support_ok(context, ern_sound_reader_read(reader, samples, 500, &frames));
    const size_t at = atomic_load(&sender.read);
    for (size_t i = 0; i < frames; i++) assert_true(samples[i] == (float)(int16_t)(at + i) / 32768);
    atomic_fetch_add(&sender.read, frames);
  }
  assert_int_equal(atomic_load(&sender.read), sender.pieces * PIECE);
  ern_sound_reader_free(&reader);
  assert_int_equal(pthread_join(thread, NULL), 0);
  assert_int_equal(descriptors(), before);
}

/* Two transport streams in one file: FFmpeg calls the first packet of the second damaged. */
static void test_joined_transport_streams(void **state) {
  (void)state;
  char said[SUPPORT_LINES] = "";
  ern_context_config config = ern_context_config_default();
  config.log = support_keep_warnings;
  config.user = said;
  ern_context *listening = NULL;
  const ern_stream_options options = options_of_stream("mpegts");
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  double seconds = 0;
  int frames = 0;
  (void)unlink("one.ts");
  support_ok(context, write_stream("one.ts", &options));
  assert_int_equal(system("cat one.ts one.ts > two.ts"), 0);
  support_ok(context, ern_context_create(&listening, &config));
  support_ok(listening, ern_video_reader_open(listening, "two.ts", &reader));
  for (bool end = false; !end; frames += !end)
    support_ok(listening, ern_video_reader_frame(reader, &image, &seconds, &end));
  assert_int_equal(frames, 2 * FRAMES);
  assert_non_null(strstr(said, "two.ts: has lost or damaged packets, or is several files in one"));
  ern_video_reader_free(&reader);
  ern_image_free(listening, &image);
  ern_context_free(&listening);
}

static void test_what_is_no_sound_is_refused(void **state) {
  (void)state;
  const float broken[4] = {0, 0.5f, NAN, 0};
  float samples[16];
  size_t frames;
  ern_sound_reader *reader;
  ern_sound_reader_options options = ern_sound_reader_options_default();
  support_write_text("words.wav", "these are words and not sound, in more than a few bytes of them\n");
  support_write("broken.f32", broken, sizeof broken);
  support_expect(context, ern_sound_reader_open(context, "words.wav", &options, &reader), ERN_E_FORMAT, "words.wav",
                 NULL);
  assert_null(reader);
  support_expect(context, ern_sound_reader_open(context, "gone.wav", &options, &reader), ERN_E_MISSING, "gone.wav",
                 NULL);
  support_expect(context, ern_sound_reader_open(context, "nodevice:x", &options, &reader), ERN_E_UNSUPPORTED,
                 "nodevice", NULL);
  options.format = "f32le";
  options.rate = 16000;
  support_ok(context, ern_sound_reader_open(context, "broken.f32", &options, &reader));
  support_expect(context, ern_sound_reader_read(reader, samples, 16, &frames), ERN_E_NONFINITE, "broken.f32", NULL);
  ern_sound_reader_free(&reader);
  options.format = "no such form";
  support_expect(context, ern_sound_reader_open(context, "broken.f32", &options, &reader), ERN_E_UNSUPPORTED,
                 "no such form", NULL);
}

/* Writes a stream to a receiver of datagrams at the address, and stores the first one. */
static void receive_first(const char *scheme, const char *path, unsigned char packet[2048]) {
  struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
  socklen_t bytes = sizeof address;
  const struct timeval patience = {5, 0};
  char url[64];
  const int receiver = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  assert_true(receiver >= 0);
  assert_int_equal(bind(receiver, (const struct sockaddr *)&address, bytes), 0);
  assert_int_equal(getsockname(receiver, (struct sockaddr *)&address, &bytes), 0);
  assert_int_equal(setsockopt(receiver, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience), 0);
  snprintf(url, sizeof url, "%s127.0.0.1:%d%s", scheme, ntohs(address.sin_port), path);
  const ern_stream_options options = options_of_stream(NULL);
  support_ok(context, write_stream(url, &options));
  assert_true(recv(receiver, packet, 2048, 0) >= 188);
  (void)close(receiver);
}

/* The scheme of an address decides, whatever its path ends with. */
static void test_scheme_decides_before_ending(void **state) {
  (void)state;
  unsigned char packet[2048] = {0};
  receive_first("udp://", "/live.mp4", packet);
  assert_int_equal(packet[0], 0x47); /* MPEG-TS */
}

/* Receivers of RTP read packets with its header, and know of MPEG-TS alone by its number (RFC 3551) what is in them. */
static void test_rtp_has_its_headers(void **state) {
  (void)state;
  unsigned char packet[2048] = {0};
  const ern_stream_options options = options_of_stream("flv");
  ern_stream_writer *writer = NULL;
  receive_first("rtp://", "", packet);
  assert_int_equal(packet[0], 0x80);
  assert_int_equal(packet[1] & 0x7f, 33);
  assert_int_equal(packet[12], 0x47);
  support_expect(context, ern_stream_writer_open(context, "rtp://127.0.0.1:9", &options, &writer), ERN_E_UNSUPPORTED,
                 "rtp://127.0.0.1:9: format is \"flv\", expected mpegts", NULL);
}

/* An address of RTSP is connected to, though its format is not among those that are found out. */
static void test_rtsp_is_connected_to(void **state) {
  (void)state;
  ern_sound_reader *reader;
  char url[64];
  snprintf(url, sizeof url, "rtsp://127.0.0.1:%d/", free_port());
  support_expect(context, ern_sound_reader_open(context, url, NULL, &reader), ERN_E_IO, url, "refused", NULL);
}

/* FFmpeg says "Input/output error" of a name that no resolver can have. */
static void test_unknown_host(void **state) {
  (void)state;
  const ern_stream_options options = options_of_stream(NULL);
  ern_stream_writer *writer = NULL;
  support_expect(context, ern_stream_writer_open(context, "udp://..:9", &options, &writer), ERN_E_IO,
                 "udp://..:9: cannot connect to it: its host is not known, or nobody answers there", NULL);
}

/* "file:" names a file like any other; FFmpeg's other protocols that lead to files are refused, nested ones too. */
static void test_only_files_and_networks(void **state) {
  (void)state;
  static const char *const others[] = {"cache:other.ts",
                                       "cache:file:other.ts",
                                       "concat:other.ts|other.ts",
                                       "crypto+file://other.ts",
                                       "subfile,,start,0,:a.ts",
                                       "tee:other.ts",
                                       "pipe:1",
                                       "data:audio/wav,other",
                                       "async:http://127.0.0.1/",
                                       "no-such://other.ts",
                                       "unix:other.ts",
                                       "http+file://other.ts"};
  const ern_stream_options options = options_of_stream("mpegts");
  ern_stream_writer *writer;
  ern_sound_reader *reader;
  uint8_t rgba[SIDE * SIDE * 4];
  struct stat there;
  char url[1100] = "file://", *here = getcwd(url + 7, 1000);
  assert_non_null(here);
  strcat(url, "/mine.ts");
  support_write_text("mine.ts", "mine");
  support_ok(context, ern_stream_writer_open(context, url, &options, &writer));
  paint(rgba, 0);
  support_ok(context, ern_stream_writer_frame(writer, rgba, NULL, 0));
  assert_int_equal(stat("mine.ts", &there), 0);
  assert_int_equal(there.st_size, 4); /* until it is whole */
  support_ok(context, ern_stream_writer_close(&writer));
  assert_int_equal(stat("mine.ts", &there), 0);
  assert_true(there.st_size > 188);
  support_write_text("other.ts", "mine");
  for (size_t i = 0; i < sizeof others / sizeof *others; i++) {
    support_expect(context, ern_stream_writer_open(context, others[i], &options, &writer), ERN_E_UNSUPPORTED, others[i],
                   "expected a file", NULL);
    support_expect(context, ern_sound_reader_open(context, others[i], NULL, &reader), ERN_E_UNSUPPORTED, others[i],
                   "expected a file", NULL);
  }
  assert_int_equal(stat("other.ts", &there), 0);
  assert_int_equal(there.st_size, 4);
  support_ok(context, write_stream("./cache:other.ts", &options)); /* a file of that name */
  assert_int_equal(access("cache:other.ts", F_OK), 0);
  support_ok(context, ern_sound_reader_open(context, "file:./cache:other.ts", NULL, &reader));
  ern_sound_reader_free(&reader);
}

/* ---- waits that end ---------------------------------------------------------------------------------------------- */

static void test_waits_end_when_asked_to(void **state) {
  (void)state;
  struct patience patience = {2};
  ern_stream_options options = options_of_stream("raw");
  ern_sound_reader_options sound = ern_sound_reader_options_default();
  ern_sound_reader *reader;
  ern_stream_writer *writer;
  float samples[16] = {0};
  char url[64];
  size_t frames;
  const size_t before = descriptors();
  options.stop = sound.stop = loses_patience;
  options.user = sound.user = &patience;
  make_fifo("alone");
  support_expect(context, ern_stream_writer_open(context, "alone", &options, &writer), ERN_E_CANCELLED, "alone", NULL);
  const int unused = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  assert_int_equal(
      bind(unused, (const struct sockaddr *)&(struct sockaddr_un){AF_UNIX, "socket"}, sizeof(struct sockaddr_un)), 0);
  atomic_store(&patience.left, 2);
  support_expect(context, ern_stream_writer_open(context, "socket", &options, &writer), ERN_E_IO, "socket", NULL);
  assert_int_equal(close(unused), 0);
  options.format = "mp4";
  atomic_store(&patience.left, 2);
  snprintf(url, sizeof url, "http://127.0.0.1:%d/", free_port());
  support_expect(context, ern_stream_writer_open(context, url, &options, &writer), ERN_E_CANCELLED, url, NULL);

  const int other = open("alone", O_RDWR | O_CLOEXEC); /* both sides are there, nobody reads or writes */
  assert_true(other >= 0);
  sound.format = "s16le";
  atomic_store(&patience.left, PATIENCE);
  assert_int_equal(write(other, samples, sizeof samples), sizeof samples);
  atomic_store(&patience.left, 4);
  ern_status status = ern_sound_reader_open(context, "alone", &sound, &reader);
  for (int k = 0; status == ERN_OK && k < 100; k++) status = ern_sound_reader_read(reader, samples, 16, &frames);
  support_expect(context, status, ERN_E_CANCELLED, "alone", NULL);
  ern_sound_reader_free(&reader);
  options.format = "nut";
  atomic_store(&patience.left, 20);
  for (int k = 0; k < 100 && (status = write_stream("alone", &options)) == ERN_OK; k++) continue;
  support_expect(context, status, ERN_E_CANCELLED, "alone", NULL);
  (void)close(other);
  assert_int_equal(descriptors(), before);
}

/* ---- options ----------------------------------------------------------------------------------------------------- */

static void test_options_are_checked(void **state) {
  (void)state;
  ern_stream_writer *writer;
  ern_stream_options options = options_of_stream("avi");
  support_expect(context, ern_stream_writer_open(context, "x", &options, &writer), ERN_E_UNSUPPORTED, "avi", "matroska",
                 NULL);
  options.format = NULL;
  support_expect(context, ern_stream_writer_open(context, "x.doc", &options, &writer), ERN_E_UNSUPPORTED, "x.doc",
                 NULL);
  options.crf = 52;
  support_expect(context, ern_stream_writer_open(context, "x.mp4", &options, &writer), ERN_E_ARGUMENT, "crf", "52",
                 NULL);
  options = options_of_stream(NULL);
  options.sound_channels = 9;
  support_expect(context, ern_stream_writer_open(context, "x.mp4", &options, &writer), ERN_E_ARGUMENT, "sound_channels",
                 "9", NULL);
  options = options_of_stream(NULL);
  options.width = 0;
  support_expect(context, ern_stream_writer_open(context, "x.mp4", &options, &writer), ERN_E_SHAPE, "x.mp4", NULL);
  assert_int_equal(access("x.mp4", F_OK), -1);
}

/* Nothing is written of a frame whose sound is not finite, and the stream goes on. */
static void test_sound_is_finite(void **state) {
  (void)state;
  static uint8_t rgba[SIDE * SIDE * 4];
  float samples[SAMPLES] = {0};
  ern_stream_writer *writer = NULL;
  const ern_stream_options options = options_of_stream("nut");
  (void)unlink("finite.nut");
  support_ok(context, ern_stream_writer_open(context, "finite.nut", &options, &writer));
  samples[SAMPLES - 1] = NAN;
  support_expect(context, ern_stream_writer_frame(writer, rgba, samples, SAMPLES), ERN_E_NONFINITE, "finite.nut", "639",
                 "nan", NULL);
  samples[SAMPLES - 1] = 0;
  support_ok(context, ern_stream_writer_frame(writer, rgba, samples, SAMPLES));
  support_ok(context, ern_stream_writer_close(&writer));
}

/* Beyond full scale sound is clipped, with its sign. */
static void test_sound_is_clipped(void **state) {
  (void)state;
  static const float levels[] = {2, -2, 1e6f, -1e6f, 1e38f, -1e38f};
  static const char *const forms[] = {"nut", "mp4"};
  static uint8_t rgba[SIDE * SIDE * 4];
  for (size_t f = 0; f < sizeof forms / sizeof *forms; f++) {
    const ern_stream_options options = options_of_stream(forms[f]);
    ern_stream_writer *writer = NULL;
    ern_sound sound = {0};
    (void)unlink("loud");
    support_ok(context, ern_stream_writer_open(context, "loud", &options, &writer));
    for (size_t k = 0; k < sizeof levels / sizeof *levels; k++) {
      float samples[SAMPLES];
      for (int i = 0; i < SAMPLES; i++) samples[i] = levels[k];
      support_ok(context, ern_stream_writer_frame(writer, rgba, samples, SAMPLES));
    }
    support_ok(context, ern_stream_writer_close(&writer));
    support_ok(context, ern_sound_read(context, "loud", &sound));
    for (size_t i = 0; f == 0 && i < sound.frames; i++)
      if ((double)sound.data[i] * (double)levels[i / SAMPLES] < 32767 * fabs((double)levels[i / SAMPLES]))
        fail_msg("sample %zu of level %g is %d", i, (double)levels[i / SAMPLES], sound.data[i]);
    ern_sound_free(context, &sound);
  }
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_each_form_has_exact_times),
      cmocka_unit_test(test_raw_pictures_and_y4m),
      cmocka_unit_test(test_sound_is_read_as_it_comes),
      cmocka_unit_test(test_joined_transport_streams),
      cmocka_unit_test(test_what_is_no_sound_is_refused),
      cmocka_unit_test(test_scheme_decides_before_ending),
      cmocka_unit_test(test_rtp_has_its_headers),
      cmocka_unit_test(test_unknown_host),
      cmocka_unit_test(test_rtsp_is_connected_to),
      cmocka_unit_test(test_waits_end_when_asked_to),
      cmocka_unit_test(test_options_are_checked),
      cmocka_unit_test(test_only_files_and_networks),
      cmocka_unit_test(test_sound_is_finite),
      cmocka_unit_test(test_sound_is_clipped),
  };
  return cmocka_run_group_tests(tests, set_up, tear_down);
}
