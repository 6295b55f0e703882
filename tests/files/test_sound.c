/* SPDX-License-Identifier: MIT
 * Sound files: what is written comes back to the sample, other forms become 16-bit, nonsense is refused. */
#include <math.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/memory.h"
#include "encoded_sound.h"
#include "ernerf/media.h"
#include "ernerf/speech.h"
#include "ernerf/stream.h"
#include "io/file.h"
#include "media/sound_decoder.h"
#include "support.h"

static ern_context *context;

static int set_up(void **state) {
  (void)state;
  context = support_context();
  return 0;
}

static int tear_down(void **state) {
  (void)state;
  ern_context_free(&context);
  return 0;
}

static ern_sound noise(int rate, int channels, size_t frames) {
  ern_sound sound = {.rate = rate, .channels = channels, .frames = frames};
  support_ok(context, ERN_NEW(context, frames * (size_t)channels, &sound.data));
  uint32_t seed = 99;
  for (size_t i = 0; i < frames * (size_t)channels; i++) {
    seed = seed * 1664525u + 1013904223u;
    sound.data[i] = (int16_t)(seed >> 16);
  }
  return sound;
}

static void test_round_trip(void **state) {
  (void)state;
  const struct {
    int rate, channels;
    size_t frames;
  } cases[] = {{16000, 1, 16001}, {48000, 2, 30000}, {44100, 6, 5000},
               {384000, 8, 4000}, {8000, 1, 1},      {11025, 3, 777}};
  for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
    ern_sound made = noise(cases[i].rate, cases[i].channels, cases[i].frames), read = {0};
    support_ok(context, ern_sound_write_wav(context, "round.wav", &made));
    support_ok(context, ern_sound_read(context, "round.wav", &read));
    assert_true(read.rate == made.rate && read.channels == made.channels);
    assert_int_equal(read.frames, made.frames);
    assert_memory_equal(read.data, made.data, made.frames * (size_t)made.channels * 2);
    ern_sound_free(context, &made);
    ern_sound_free(context, &read);
    assert_null(read.data);
  }
}

static void test_bytes_of_a_wav(void **state) {
  (void)state;
  int16_t samples[] = {1, -2, 0x1234, -32768};
  const ern_sound made = {.rate = 16000, .channels = 2, .frames = 2, .data = samples};
  const uint8_t expected[] = {'R', 'I', 'F', 'F', 44, 0, 0,    0,    'W', 'A', 'V',  'E',  'f',  'm',  't', ' ', 16, 0,
                              0,   0,   1,   0,   2,  0, 0x80, 0x3e, 0,   0,   0,    0xfa, 0,    0,    4,   0,   16, 0,
                              'd', 'a', 't', 'a', 8,  0, 0,    0,    1,   0,   0xfe, 0xff, 0x34, 0x12, 0,   0x80};
  uint8_t *bytes = NULL;
  size_t count = 0;
  support_ok(context, ern_sound_write_wav(context, "bytes.wav", &made));
  support_ok(context, ern_file_read(context, "bytes.wav", 1000, &bytes, &count));
  assert_int_equal(count, sizeof expected);
  assert_memory_equal(bytes, expected, sizeof expected);
  ern_release(context, bytes);
}

/* A WAV of any form; returns its size. */
static size_t make_wav(uint8_t *wav, int form, int rate, int channels, int bits, const void *data,
                       uint32_t data_bytes) {
  const uint32_t frame = (uint32_t)(channels * bits / 8), size = 36 + data_bytes, bytes = (uint32_t)rate * frame;
  const uint32_t fields[][2] = {{4, 16},    {2, (uint32_t)form}, {2, (uint32_t)channels}, {4, (uint32_t)rate},
                                {4, bytes}, {2, frame},          {2, (uint32_t)bits}};
  memcpy(wav, "RIFF", 4);
  for (int k = 0; k < 4; k++) wav[4 + k] = (uint8_t)(size >> (8 * k));
  memcpy(wav + 8, "WAVEfmt ", 8);
  uint8_t *at = wav + 16;
  for (size_t i = 0; i < sizeof fields / sizeof *fields; i++) {
    for (uint32_t k = 0; k < fields[i][0]; k++) *at++ = (uint8_t)(fields[i][1] >> (8 * k));
  }
  memcpy(at, "data", 4);
  for (int k = 0; k < 4; k++) at[4 + k] = (uint8_t)(data_bytes >> (8 * k));
  memcpy(at + 8, data, data_bytes);
  return 44 + data_bytes;
}

static void test_other_forms_become_16_bit(void **state) {
  (void)state;
  uint8_t wav[200];
  ern_sound read = {0};
  const uint8_t bytes[] = {128, 0, 255, 129};
  support_write("u8.wav", wav, make_wav(wav, 1, 22050, 1, 8, bytes, sizeof bytes));
  support_ok(context, ern_sound_read(context, "u8.wav", &read));
  const int16_t from_bytes[] = {0, -32768, 127 * 256, 256};
  assert_int_equal(read.frames, 4);
  assert_int_equal(read.rate, 22050);
  assert_memory_equal(read.data, from_bytes, sizeof from_bytes);
  ern_sound_free(context, &read);
  const float floats[] = {0.0f, 0.5f, -0.5f, 1.0f, -1.0f, 2.0f, 1e38f, -1e38f};
  support_write("float.wav", wav, make_wav(wav, 3, 48000, 2, 32, floats, sizeof floats));
  support_ok(context, ern_sound_read(context, "float.wav", &read));
  const int16_t from_floats[] = {0, 16384, -16384, 32767, -32768, 32767, 32767, -32768};
  assert_int_equal(read.frames, 4);
  assert_int_equal(read.channels, 2);
  assert_memory_equal(read.data, from_floats, sizeof from_floats);
  ern_sound_free(context, &read);
  support_write("float.wav", wav, make_wav(wav, 3, 48000, 2, 32, (float[]){0, NAN}, 8));
  assert_int_equal(ern_sound_read(context, "float.wav", &read), ERN_E_NONFINITE);
}

static void test_refused_files(void **state) {
  (void)state;
  uint8_t wav[200];
  const int16_t samples[36] = {1, 2, 3};
  ern_sound read = {0};
  support_write_text("text.wav", "this is a text and no sound at all, though its name says otherwise\n");
  support_write("empty.wav", "", 0);
  support_write("fast.wav", wav, make_wav(wav, 1, 384001, 1, 16, samples, sizeof samples));
  support_write("wide.wav", wav, make_wav(wav, 1, 48000, 9, 16, samples, sizeof samples));
  mkdir("folder.wav", 0777);
  unlink("pipe.wav");
  assert_int_equal(mkfifo("pipe.wav", 0666), 0);
  support_expect(context, ern_sound_read(context, "text.wav", &read), ERN_E_FORMAT, "text.wav", NULL);
  support_expect(context, ern_sound_read(context, "empty.wav", &read), ERN_E_FORMAT, "empty.wav", NULL);
  support_expect(context, ern_sound_read(context, "fast.wav", &read), ERN_E_SHAPE, "384001", NULL);
  support_expect(context, ern_sound_read(context, "wide.wav", &read), ERN_E_SHAPE, "9 channels", NULL);
  support_expect(context, ern_sound_read(context, "nothing.wav", &read), ERN_E_MISSING, "nothing.wav", NULL);
  support_expect(context, ern_sound_read(context, "http://localhost/a.wav", &read), ERN_E_MISSING, "http", NULL);
  support_expect(context, ern_sound_read(context, "folder.wav", &read), ERN_E_IO, "folder", NULL);
  support_expect(context, ern_sound_read(context, "pipe.wav", &read), ERN_E_IO, "pipe", NULL);
  assert_null(read.data);
}

static void test_names_are_files(void **state) {
  (void)state;
  const char *const names[] = {"a:b.wav", "pipe:1.wav", "50%d.wav", "what?.wav"};
  ern_sound made = noise(16000, 1, 100), read = {0};
  for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
    support_ok(context, ern_sound_write_wav(context, names[i], &made));
    support_ok(context, ern_sound_read(context, names[i], &read));
    assert_int_equal(read.frames, 100);
    ern_sound_free(context, &read);
  }
  ern_sound_free(context, &made);
}

static void test_no_samples(void **state) {
  (void)state;
  const ern_sound made = {.rate = 16000, .channels = 2};
  ern_sound read = {0};
  support_ok(context, ern_sound_write_wav(context, "none.wav", &made));
  support_ok(context, ern_sound_read(context, "none.wav", &read));
  assert_int_equal(read.frames, 0);
  assert_int_equal(read.rate, 16000);
  assert_int_equal(read.channels, 2);
  ern_sound_free(context, &read);
}

static void test_refused_writes(void **state) {
  (void)state;
  ern_sound made = noise(16000, 1, 5000), wrong = made, read = {0};
  unlink("kept.wav");
  wrong.rate = 0;
  assert_int_equal(ern_sound_write_wav(context, "kept.wav", &wrong), ERN_E_SHAPE);
  wrong = made;
  wrong.channels = 9;
  assert_int_equal(ern_sound_write_wav(context, "kept.wav", &wrong), ERN_E_SHAPE);
  wrong = made;
  wrong.frames = (size_t)1 << 31;
  assert_int_equal(ern_sound_write_wav(context, "kept.wav", &wrong), ERN_E_SHAPE);
  wrong.data = NULL;
  assert_int_equal(ern_sound_write_wav(context, "kept.wav", &wrong), ERN_E_ARGUMENT);
  assert_int_equal(ern_sound_write_wav(context, "no/such/a.wav", &made), ERN_E_MISSING);
  assert_int_equal(access("kept.wav", F_OK), -1);
  support_ok(context, ern_sound_write_wav(context, "kept.wav", &made));
  struct rlimit old, small;
  assert_int_equal(getrlimit(RLIMIT_FSIZE, &old), 0);
  small = (struct rlimit){.rlim_cur = 4096, .rlim_max = old.rlim_max};
  assert_int_equal(setrlimit(RLIMIT_FSIZE, &small), 0);
  const ern_status full = ern_sound_write_wav(context, "kept.wav", &made);
  assert_int_equal(setrlimit(RLIMIT_FSIZE, &old), 0);
  assert_int_equal(full, ERN_E_IO);
  support_ok(context, ern_sound_read(context, "kept.wav", &read));
  assert_int_equal(read.frames, made.frames);
  ern_sound_free(context, &read);
  ern_sound_free(context, &made);
}

static void test_real_sound(void **state) {
  (void)state;
  char path[1024];
  ern_sound read = {0};
  uint8_t *bytes = NULL;
  size_t count = 0, loud = 0;
  support_shared("real/presenter/aud.wav", path);
  support_ok(context, ern_sound_read(context, path, &read));
  assert_int_equal(read.rate, 16000);
  assert_int_equal(read.channels, 1);
  assert_in_range(read.frames, 220 * 16000 / 25, 20 * 16000); /* at least as long as the 220 pictures */
  for (size_t i = 0; i < read.frames; i++) loud += read.data[i] > 1000 || read.data[i] < -1000;
  assert_true(loud > 1000);
  support_ok(context, ern_file_read(context, path, 1 << 24, &bytes, &count));
  assert_memory_equal(bytes + count - 2 * read.frames, read.data, 2 * read.frames);
  ern_release(context, bytes);
  ern_sound_free(context, &read);
}

/* ---- what changes, waits or comes late ----------------------------------------------------------------------------
 */

/* A track may go on in another format, as in joined transport streams. */
static void test_format_changes(void **state) {
  (void)state;
  enum { FRAMES = 32 };
  float samples[4096];
  bool end = false;
  struct ern_sound_decoder sound, other;
  ern_sound flat = {.rate = 16000, .channels = 1, .frames = FRAMES};
  support_ok(context, ERN_NEW(context, FRAMES, &flat.data));
  for (int i = 0; i < FRAMES; i++) flat.data[i] = 16384; /* 0.5 */
  support_ok(context, ern_sound_write_wav(context, "half.wav", &flat));
  uint8_t wav[200];
  float quarter[FRAMES];
  for (int i = 0; i < FRAMES; i++) quarter[i] = 0.25f;
  support_write("quarter.wav", wav, make_wav(wav, 3, 16000, 1, 32, quarter, sizeof quarter));
  support_ok(context, ern_sound_decoder_open(context, "half.wav", AV_SAMPLE_FMT_FLT, &sound));
  support_ok(context, ern_sound_decoder_open(context, "quarter.wav", AV_SAMPLE_FMT_FLT, &other));
  for (int turn = 0; turn < 2; turn++) {
    support_ok(context, ern_sound_decoder_next(&sound, &end));
    assert_true(!end && sound.frames == FRAMES);
    support_ok(context, ern_sound_decoder_take(&sound, samples));
    for (int i = 0; i < FRAMES; i++) assert_true(samples[i] == (turn == 0 ? 0.5f : 0.25f));
    const struct ern_decoder first = sound.decoder;
    sound.decoder = other.decoder;
    other.decoder = first;
  }
  ern_sound_decoder_close(&sound);
  ern_sound_decoder_close(&other);
  ern_sound_free(context, &flat);
}

/* A file that names other files may name one that never ends: none is opened. */
static void test_playlists(void **state) {
  (void)state;
  ern_sound sound;
  ern_features features;
  const struct {
    const char *name, *text;
  } lists[] = {{"live.m3u8", "#EXTM3U\n#EXT-X-VERSION:3\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nround.wav\n"},
               {"list.ffconcat", "ffconcat version 1.0\nfile pipe.wav\n"}};
  unlink("pipe.wav");
  assert_int_equal(mkfifo("pipe.wav", 0600), 0);
  for (size_t i = 0; i < sizeof lists / sizeof *lists; i++) {
    support_write_text(lists[i].name, lists[i].text);
    support_expect(context, ern_sound_read(context, lists[i].name, &sound), ERN_E_FORMAT, lists[i].name, "playlist",
                   NULL);
    support_expect(context, ern_speech_features(context, lists[i].name, 1, &features), ERN_E_FORMAT, "playlist", NULL);
  }
}

struct piece {
  int track;      /* 0: mono; 1: stereo, which FFmpeg calls the best */
  double at;      /* s */
  uint8_t filled; /* each byte of its samples */
};

/* Two tracks of 16-bit samples at 16 kHz, of pieces of 0.5 s. */
static void write_tracks(const char *path, const struct piece *piece, size_t pieces) {
  AVFormatContext *container = NULL;
  assert_true(avformat_alloc_output_context2(&container, NULL, "matroska", path) >= 0);
  container->avoid_negative_ts = AVFMT_AVOID_NEG_TS_DISABLED;
  for (int k = 0; k < 2; k++) {
    AVStream *stream = avformat_new_stream(container, NULL);
    assert_non_null(stream);
    stream->time_base = (AVRational){1, 1000};
    stream->codecpar->codec_type = AVMEDIA_TYPE_AUDIO;
    stream->codecpar->codec_id = AV_CODEC_ID_PCM_S16LE;
    stream->codecpar->sample_rate = 16000;
    av_channel_layout_default(&stream->codecpar->ch_layout, k + 1);
  }
  assert_true(avio_open(&container->pb, path, AVIO_FLAG_WRITE) >= 0 && avformat_write_header(container, NULL) >= 0);
  for (size_t i = 0; i < pieces; i++) {
    AVPacket *packet = av_packet_alloc();
    assert_true(packet != NULL && av_new_packet(packet, 8000 * 2 * (piece[i].track + 1)) >= 0);
    memset(packet->data, piece[i].filled, (size_t)packet->size);
    packet->stream_index = piece[i].track;
    packet->pts = (int64_t)(1000 * piece[i].at + 0.5);
    packet->dts = (int64_t)i - 10000; /* must rise, and is not written */
    packet->duration = 500;
    assert_true(av_write_frame(container, packet) >= 0);
    av_packet_free(&packet);
  }
  assert_true(av_write_trailer(container) >= 0);
  avio_closep(&container->pb);
  avformat_free_context(container);
}

/* The sound of a video keeps its time. */
static void test_late_track(void **state) {
  (void)state;
  ern_sound sound;
  ern_features features;
  const struct piece late[] = {{0, 0, 1}, {1, 1, 2}}, later[] = {{0, 0, 1}, {1, 4000, 2}};
  write_tracks("late.mka", late, 2);
  support_ok(context, ern_sound_read(context, "late.mka", &sound));
  assert_int_equal(sound.channels, 2);
  assert_int_equal(sound.frames, 24000);
  for (size_t i = 0; i < 2 * sound.frames; i++) assert_int_equal(sound.data[i], i < 2 * 16000 ? 0 : 0x0202);
  support_ok(context, ern_speech_features(context, "late.mka", 1, &features));
  assert_int_equal(features.windows, 38); /* of 1.5 s */
  ern_sound_free(context, &sound);
  ern_features_free(context, &features);
  write_tracks("later.mka", later, 2);
  support_expect(context, ern_sound_read(context, "later.mka", &sound), ERN_E_UNSUPPORTED, "begins at 4000 s", NULL);
}

/* Pieces of 0.5 s are put where their times are. */
static void test_times(void **state) {
  (void)state;
  static const struct {
    double at[3];
    size_t begin[4]; /* samples, of the three and of the end */
    const char *said;
  } cases[] = {
      {{0, 0.5, 1}, {0, 8000, 16000, 24000}, ""},
      {{0, 0.539, 1}, {0, 8000, 16000, 24000}, ""}, /* a time that is rounded or trembles */
      {{0, 0.5, 2.25}, {0, 8000, 36000, 44000}, "at 1.000 s a gap of its sound becomes silence, up to 2.250 s"},
      {{0, 0.75, 2}, {0, 12000, 32000, 40000}, "at 1.250 s a gap of its sound becomes silence, up to 2.000 s"},
      {{0, 0.25, 0.75},
       {0, 8000, 12000, 20000},
       "at 0.500 s the repeated part of its sound is left out, as its time stamps go back to 0.250 s"},
      {{2, 0, 3},
       {0, 8000, 16000, 24000},
       "at 2.500 s one piece of its sound is kept in its place, though its time stamp is 0.000 s"},
      {{0, 70, 1}, {0, 8000, 16000, 24000}, "at 0.500 s one piece of its sound is kept in its place"},
      {{0, 0.2, 1}, {0, 8000, 16000, 24000}, "at 0.500 s one piece of its sound is kept in its place"},
      {{2, 2.5, 0},
       {0, 8000, 16000, 24000},
       "at 3.000 s its sound is continued, though its time stamps go back to 0.000 s"},
      {{2, 0, 0.75}, {0, 8000, 20000, 28000}, "at 0.500 s a gap of its sound becomes silence, up to 0.750 s"},
  };
  for (size_t k = 0; k < sizeof cases / sizeof *cases; k++) {
    struct piece piece[3];
    char said[SUPPORT_LINES] = "";
    ern_context *loud = NULL;
    ern_context_config config = ern_context_config_default();
    ern_sound sound = {0};
    ern_features features = {0};
    for (int i = 0; i < 3; i++) piece[i] = (struct piece){1, cases[k].at[i], (uint8_t)(i + 1)};
    write_tracks("times.mka", piece, 3);
    config.log = support_keep_warnings;
    config.user = said;
    assert_int_equal(ern_context_create(&loud, &config), ERN_OK);
    support_ok(loud, ern_sound_read(loud, "times.mka", &sound));
    assert_true(strstr(said, "2 tracks of sound, of which stream 1") && strstr(said, cases[k].said));
    assert_int_equal(strchr(said, '\n')[1] != 0, cases[k].said[0] != 0); /* and nothing else */
    assert_int_equal(sound.frames, cases[k].begin[3]);
    for (size_t i = 0; i < sound.frames; i++) {
      int of = 2;
      while (of > 0 && i < cases[k].begin[of]) of--;
      const bool heard = i < cases[k].begin[of] + 8000;
      assert_int_equal(sound.data[2 * i + 1], heard ? 0x0101 * (of + 1) : 0);
    }
    support_ok(loud, ern_speech_features(loud, "times.mka", 1, &features));
    assert_in_range(features.windows, sound.frames / 640, sound.frames / 640 + 1);
    ern_sound_free(loud, &sound);
    ern_features_free(loud, &features);
    ern_context_free(&loud);
  }
}

/* A reader of live sound gives the beginning too of a file that must be read into to be known. */
static void test_reader_begins(void **state) {
  (void)state;
  static const struct encoded forms[] = {{AV_CODEC_ID_AAC, "adts", 1, 0}, {AV_CODEC_ID_MP2, "mp2", 1, 0}};
  enum { RATE = 48000, COUNT = RATE * 4 / 5 };
  static int16_t data[COUNT];
  for (int i = 0; i < COUNT; i++) data[i] = (int16_t)(8000 * sin(i / 20.0));
  const ern_sound sound = {.rate = RATE, .channels = 1, .frames = COUNT, .data = data};
  for (size_t k = 0; k < sizeof forms / sizeof *forms; k++) {
    ern_sound_reader *reader = NULL;
    float samples[1024];
    size_t all = 0, frames = 1;
    (void)write_encoded("begins", &forms[k], &sound);
    support_ok(context, ern_sound_reader_open(context, "begins", NULL, &reader));
    for (; frames > 0; all += frames) support_ok(context, ern_sound_reader_read(reader, samples, 1024, &frames));
    ern_sound_reader_free(&reader);
    if (all < COUNT) fail_msg("%s: %zu of %d samples", forms[k].form, all, COUNT);
  }
}

/* A decoder of Vorbis or Opus gives nothing of what its encoder put before the sound: a click beside pictures is heard
 * at its time by the file, and in a file of sound alone at its place in the sound. */
static void test_encoders_delay(void **state) {
  (void)state;
  static const enum AVCodecID codecs[] = {AV_CODEC_ID_VORBIS, AV_CODEC_ID_OPUS, AV_CODEC_ID_FLAC};
  for (int k = 0; k < 6; k++) {
    const struct encoded how = {.codec = codecs[k / 2], .form = "matroska", .tracks = 1 + k % 2};
    ern_sound sound = {.rate = 48000, .channels = 1, .frames = 48000}, read = {0};
    support_ok(context, ERN_NEW(context, sound.frames, &sound.data));
    for (int i = -3; i <= 3; i++) sound.data[24000 + i] = (int16_t)(30000 - 8000 * abs(i));
    const double shift = write_encoded("click.mka", &how, &sound);
    assert_true((shift > 0.002) == (how.codec != AV_CODEC_ID_FLAC));
    support_ok(context, ern_sound_read(context, "click.mka", &read));
    assert_int_equal(read.rate, 48000);
    int loudest = 0;
    for (int i = 0; i < (int)read.frames; i++)
      if (abs(read.data[i]) > abs(read.data[loudest])) loudest = i;
    const double expected = 24000 + (how.tracks == 2 ? shift * 48000 : 0);
    if (fabs(loudest - expected) > 1.5 * 48) /* 1 ms: the file's unit of time */
      fail_msg("codec %d, %d tracks: the click is heard at %d, expected %.0f", (int)how.codec, how.tracks, loudest,
               expected);
    ern_sound_free(context, &sound);
    ern_sound_free(context, &read);
  }
}

/* One second of noise as FLAC in Ogg; pages of at most `page` microseconds. */
static void write_ogg(const char *path, int64_t page) {
  ern_sound sound = noise(16000, 1, 16000);
  const struct encoded how = {.codec = AV_CODEC_ID_FLAC, .form = "ogg", .tracks = 1, .page = page};
  (void)write_encoded(path, &how, &sound);
  ern_sound_free(context, &sound);
}

/* Ogg has no length in its head; the page that is the last says so. */
static void test_cut_ogg(void **state) {
  (void)state;
  uint8_t *bytes = NULL;
  size_t count = 0, last = 0;
  char said[SUPPORT_LINES] = "";
  ern_sound read = {0};
  ern_context *loud = NULL;
  ern_context_config config = ern_context_config_default();
  config.log = support_keep_warnings;
  config.user = said;
  assert_int_equal(ern_context_create(&loud, &config), ERN_OK);
  write_ogg("whole.ogg", 200000);
  support_ok(loud, ern_sound_read(loud, "whole.ogg", &read));
  assert_int_equal(read.frames, 16000);
  assert_string_equal(said, "");
  ern_sound_free(loud, &read);
  support_ok(loud, ern_file_read(loud, "whole.ogg", 1 << 20, &bytes, &count));
  for (size_t i = 0; i + 4 < count; i++)
    if (memcmp(bytes + i, "OggS", 4) == 0) last = i;
  assert_true(last > count / 2);
  support_write("cut.ogg", bytes, last); /* whole pages */
  support_ok(loud, ern_sound_read(loud, "cut.ogg", &read));
  assert_true(read.frames < 16000);
  assert_non_null(strstr(said, "cut.ogg: may be cut short"));
  ern_sound_free(loud, &read);
  for (size_t more = 4; more < 60; more += 11) {
    support_write("cut.ogg", bytes, last + more);
    support_expect(loud, ern_sound_read(loud, "cut.ogg", &read), ERN_E_FORMAT, "cut.ogg", "last page is not whole",
                   NULL);
  }
  ern_release(loud, bytes);
  ern_context_free(&loud);
}

/* A track that ends long before the length that its file's header has. */
static void test_shorter_than_it_says(void **state) {
  (void)state;
  const struct piece pieces[] = {{1, 0, 1}, {1, 0.5, 2}, {1, 1, 3}, {1, 1.5, 4}};
  uint8_t *bytes = NULL;
  size_t count = 0;
  ern_sound read = {0};
  write_tracks("whole.mka", pieces, 4);
  support_ok(context, ern_file_read(context, "whole.mka", 1 << 20, &bytes, &count));
  support_write("cut.mka", bytes, count - 100000);
  support_expect(context, ern_sound_read(context, "cut.mka", &read), ERN_E_FORMAT, "cut.mka", "cut short", NULL);
  ern_release(context, bytes);
}

/* What is written into a pipe does not know its size; what is cut knows it, and is refused. */
static void test_sizes(void **state) {
  (void)state;
  static int16_t samples[5000];
  static uint8_t wav[sizeof samples + 100];
  for (size_t i = 0; i < 5000; i++) samples[i] = (int16_t)(7 * i);
  const size_t bytes = make_wav(wav, 1, 16000, 1, 16, samples, sizeof samples);
  const uint32_t sizes[] = {0, UINT32_MAX, 0x7ffff000, 0x7fffff00, 1U << 31, sizeof samples, 10002, INT32_MAX};
  for (size_t k = 0; k < sizeof sizes / sizeof *sizes; k++) {
    ern_sound read = {0};
    char expected[64];
    const uint32_t whole = k < 5 ? sizes[k] : (uint32_t)bytes - 8; /* a pipe's file knows neither size */
    for (int b = 0; b < 4; b++) {
      wav[4 + b] = (uint8_t)(whole >> (8 * b));
      wav[bytes - sizeof samples - 4 + (size_t)b] = (uint8_t)(sizes[k] >> (8 * b));
    }
    support_write("sizes.wav", wav, bytes);
    const ern_status status = ern_sound_read(context, "sizes.wav", &read);
    if (k < 6) {
      support_ok(context, status);
      assert_int_equal(read.frames, 5000);
      assert_memory_equal(read.data, samples, sizeof samples);
      ern_sound_free(context, &read);
      continue;
    }
    snprintf(expected, sizeof expected, "has 10000 bytes, expected %u", (unsigned)sizes[k]);
    support_expect(context, status, ERN_E_FORMAT, "sizes.wav", "cut short", expected, NULL);
  }
  /* no samples and another chunk, in a file as long as it says */
  ern_sound none = {0};
  for (int b = 0; b < 4; b++) wav[bytes - sizeof samples - 4 + (size_t)b] = 0;
  memcpy(wav + bytes - sizeof samples, "LIST\x08\0\0\0INFOabcd", 16);
  const size_t shorter = bytes - sizeof samples + 16;
  for (int b = 0; b < 4; b++) wav[4 + b] = (uint8_t)((shorter - 8) >> (8 * b));
  support_write("sizes.wav", wav, shorter);
  support_expect(context, ern_sound_read(context, "sizes.wav", &none), ERN_E_SHAPE, "sizes.wav", "0 samples", NULL);
}

int main(void) {
  signal(SIGXFSZ, SIG_IGN);
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_sizes),
      cmocka_unit_test(test_round_trip),
      cmocka_unit_test(test_bytes_of_a_wav),
      cmocka_unit_test(test_other_forms_become_16_bit),
      cmocka_unit_test(test_refused_files),
      cmocka_unit_test(test_names_are_files),
      cmocka_unit_test(test_no_samples),
      cmocka_unit_test(test_refused_writes),
      cmocka_unit_test(test_real_sound),
      cmocka_unit_test(test_format_changes),
      cmocka_unit_test(test_playlists),
      cmocka_unit_test(test_late_track),
      cmocka_unit_test(test_times),
      cmocka_unit_test(test_encoders_delay),
      cmocka_unit_test(test_reader_begins),
      cmocka_unit_test(test_cut_ogg),
      cmocka_unit_test(test_shorter_than_it_says),
  };
  return cmocka_run_group_tests_name("sound", tests, set_up, tear_down);
}
