/* SPDX-License-Identifier: MIT
 * `ernerf dub` on a made-up clip with its video: size, rate, length and sound of the output, which is the recorded
 * video outside the lower face; and what is refused. */
#include <libavformat/avformat.h>
#include <math.h>
#include <time.h>

#include "dub/recorded_clip.h"

enum { SIDE = 96, FRAMES = 16, LONGER = 40, SHORTER = 9 };

static struct cli cli;

static void write_record(const char *hash, double from, int x) { recorded_clip_write(hash, from, x, SIDE, FRAMES); }

static int make_all(void **state) {
  (void)state;
  recorded_clip_take(true);
  write_record(NULL, 0, 0);
  cli_run(&cli, "synth longer --size 64 --frames %d --seed 4 --quiet", LONGER);
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "synth shorter --size 64 --frames %d --seed 4 --video shorter.mp4 --quiet", SHORTER);
  cli_expect(&cli, 0, NULL);
  return 0;
}

/* Number of frames of the output; each is the recorded one, from frame `first` on, in its upper quarter. */
static size_t compare(const char *path, double rate, int first) {
  ern_context *context = support_context();
  ern_video_reader *readers[2] = {0};
  ern_image images[2] = {0};
  double seconds = 0;
  bool end = false;
  size_t k = 0, sum = 0;
  support_ok(context, ern_video_reader_open(context, path, &readers[0]));
  support_ok(context, ern_video_reader_open(context, "clip.mp4", &readers[1]));
  support_ok(context, ern_video_reader_seek(readers[1], first / rate));
  for (;; k++) {
    support_ok(context, ern_video_reader_frame(readers[0], &images[0], &seconds, &end));
    if (end) break;
    assert_true(seconds > (double)k / rate - 1e-3 && seconds < (double)k / rate + 1e-3);
    support_ok(context, ern_video_reader_frame(readers[1], &images[1], &seconds, &end));
    assert_false(end);
    assert_true(images[0].width == SIDE && images[0].height == SIDE);
    for (size_t i = 0; i < (size_t)SIDE * SIDE / 4 * 3; i++) sum += (size_t)abs(images[0].data[i] - images[1].data[i]);
  }
  assert_true(sum < k * SIDE * SIDE / 4 * 3 * 4); /* 4 grey levels: H.264 coded twice */
  for (int i = 0; i < 2; i++) {
    ern_image_free(context, &images[i]);
    ern_video_reader_free(&readers[i]);
  }
  ern_context_free(&context);
  return k;
}

static void test_dub(void **state) {
  (void)state;
  write_record(NULL, 0, 0);
  cli_run(&cli, "dub h.safetensors clip.mp4 --clip clip --audio clip/aud.wav -o out.mp4 -y --json - --quiet");
  cli_expect(&cli, 0, NULL);
  json_t *report = cli_json(&cli, NULL);
  assert_int_equal(json_integer_value(json_object_get(report, "frames")), FRAMES);
  assert_int_equal(json_integer_value(json_object_get(report, "left")), 0);
  json_decref(report);
  assert_int_equal(compare("out.mp4", 25, 0), FRAMES);
  json_t *about = cli_json(&cli, "out.mp4.provenance.json");
  const json_t *part = json_array_get(json_object_get(about, "synthetic_seconds"), 0);
  assert_true(json_number_value(json_array_get(part, 1)) == FRAMES / 25.0);
  assert_string_equal(json_string_value(json_object_get(about, "digital_source_type")),
                      "compositeWithTrainedAlgorithmicMedia");
  json_decref(about);
  assert_int_equal(system("grep -aq 'model drew the mouth from 0 s to 0.64 s over a recorded video' out.mp4"), 0);
  ern_context *context = support_context();
  ern_sound sound = {0};
  support_ok(context, ern_sound_read(context, "out.mp4", &sound));
  assert_true(sound.frames > (size_t)sound.rate / 2);
  ern_sound_free(context, &sound);
  ern_context_free(&context);
}

/* A head for dubbing says so; what renders it or trains a torso for it warns; it is no head of a portrait. */
static void test_for_dub(void **state) {
  (void)state;
  cli_run(&cli,
          "train clip -o for.safetensors --for dub --iters 5 --rays 256 --levels 2 --validate-frames 1 --asr-model "
          "cepstra --json for.json");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "info for.safetensors");
  cli_expect(&cli, 0, NULL);
  assert_non_null(strstr(cli.out, "use it for       dub"));
  cli_run(&cli, "eval for.safetensors clip --frames 0:1");
  cli_expect(&cli, 0, "was trained for `ernerf dub`: outside the lower face it is blurred", NULL);
  cli_run(&cli, "dub for.safetensors clip.mp4 --clip clip --audio clip/aud.wav -o for.mp4 --frames 0:1");
  cli_expect(&cli, 0, NULL);
  assert_null(strstr(cli.err, "blurred"));
  cli_run(&cli, "train clip -o t.safetensors --torso --head for.safetensors --iters 1 --rays 64 --validate-frames 1");
  cli_expect(&cli, 0, "the head was trained for `ernerf dub`", NULL);
  cli_run(&cli, "train clip -o for.safetensors --for dub --time 10s --torso-shrink 0.7");
  cli_expect(&cli, 2, "--torso-shrink is about the torso, which --for dub lacks", NULL);
  cli_run(&cli, "train clip -o for.safetensors --for dub --set ray-sampling=uniform");
  cli_expect(&cli, 2, "--set ray-sampling and --for both choose rays", NULL);
}

/* `eval --compose dub`: the recorded picture outside the lower face, and figures of its own. The clip's pictures serve
 * as recorded ones. */
static void test_eval(void **state) {
  (void)state;
  cli_run(&cli, "eval h.safetensors clip --compose dub --split all --asr-model cepstra");
  cli_expect(&cli, 1, "ori_imgs/0.jpg", NULL);
  for (int i = 0; i < FRAMES; i++) {
    char from[64], to[64];
    snprintf(from, sizeof from, "../gt_imgs/%d.jpg", i);
    snprintf(to, sizeof to, "clip/ori_imgs/%d.jpg", i);
    assert_int_equal(symlink(from, to), 0);
  }
  cli_run(&cli, "eval h.safetensors clip --compose dub --split all --asr-model cepstra --json e.json --video e.mp4");
  cli_expect(&cli, 0, NULL);
  assert_non_null(strstr(cli.out, "dubbed: lower face PSNR"));
  json_t *all = cli_json(&cli, "e.json"), *dubbed = json_object_get(all, "dubbed");
  const double whole = json_number_value(json_object_get(all, "psnr")),
               lower = json_number_value(json_object_get(dubbed, "psnr_lower_face")),
               seam = json_number_value(json_object_get(dubbed, "seam_gradient"));
  assert_true(lower > 10 && lower < 40 && whole > lower + 3 &&
              json_is_number(json_object_get(dubbed, "psnr_jaw_band")));
  assert_true(seam > 0.5 && seam < 1.5 && json_is_number(json_object_get(dubbed, "flicker")));
  assert_int_equal(json_integer_value(json_object_get(dubbed, "left")), 0);
  json_decref(all);
  cli_run(&cli, "eval h.safetensors clip --compose dub --split all --asr-model cepstra --frames 0:1 --json one.json");
  cli_expect(&cli, 0, NULL);
  json_t *one = cli_json(&cli, "one.json");
  assert_true(json_is_null(json_object_get(json_object_get(one, "dubbed"), "flicker"))); /* it is of two frames */
  json_decref(one);
  cli_run(&cli,
          "train clip -o none.safetensors --iters 1 --rays 64 --levels 2 --validate-frames 1 --asr-model cepstra");
  cli_run(&cli, "eval none.safetensors clip --compose dub --split all --asr-model cepstra --json none.json");
  cli_expect(&cli, 0, "16 of 16 frames are left as recorded", NULL);
  json_t *none = cli_json(&cli, "none.json");
  assert_true(json_is_null(json_object_get(json_object_get(none, "dubbed"), "psnr_lower_face")));
  json_decref(none);
  cli_run(&cli, "eval h.safetensors clip --compose dub --refine-poses");
  cli_expect(&cli, 2, "--refine-poses is about frames that are rendered whole", NULL);
}

/* PSNR of `eval` of whole frames with these words; `against`: what it says that they were compared with. */
static double psnr_against(const char *words, const char *against) {
  cli_run(&cli, "eval h.safetensors clip --split all --asr-model cepstra --json whole.json -y %s", words);
  cli_expect(&cli, 0, NULL);
  json_t *whole = cli_json(&cli, "whole.json");
  assert_string_equal(json_string_value(json_object_get(whole, "against")), against);
  const double psnr = json_number_value(json_object_get(whole, "psnr"));
  json_decref(whole);
  return psnr;
}

/* Whole frames are compared with the recorded pictures, here another frame's in one place, where there are some. */
static void test_against_long(void **state) {
  (void)state;
  assert_int_equal(unlink("clip/ori_imgs/3.jpg") | symlink("../gt_imgs/12.jpg", "clip/ori_imgs/3.jpg"), 0);
  const double clip = psnr_against("--against clip", "clip");
  assert_true(psnr_against("", "recorded") < clip - 0.01);
  assert_int_equal(unlink("clip/ori_imgs/3.jpg"), 0);
  assert_true(psnr_against("", "clip") == clip);
  cli_run(&cli, "eval h.safetensors clip --split all --asr-model cepstra --against recorded");
  cli_expect(&cli, 1, "ori_imgs/3.jpg", NULL);
  assert_int_equal(symlink("../gt_imgs/3.jpg", "clip/ori_imgs/3.jpg"), 0);
  psnr_against("--against recorded", "recorded");
  cli_run(&cli, "eval h.safetensors clip --setting reconstruction --asr-model cepstra");
  cli_expect(&cli, 0, NULL);
  assert_non_null(strstr(cli.out, "compared with the clip's pictures"));
  cli_run(&cli, "eval h.safetensors clip --compose dub --against clip");
  cli_expect(&cli, 2, "--against is about frames that are rendered whole", NULL);
}

/* The first picture of `path` from second `seconds` on, in its upper quarter: grey levels. */
static void read_top(const char *path, double seconds, uint8_t top[SIDE * SIDE / 4 * 3]) {
  ern_context *context = support_context();
  ern_video_reader *reader = NULL;
  ern_image image = {0};
  bool end = false;
  support_ok(context, ern_video_reader_open(context, path, &reader));
  support_ok(context, ern_video_reader_seek(reader, seconds));
  support_ok(context, ern_video_reader_frame(reader, &image, &seconds, &end));
  assert_false(end);
  memcpy(top, image.data, SIDE * SIDE / 4 * 3);
  ern_image_free(context, &image);
  ern_video_reader_free(&reader);
  ern_context_free(&context);
}

static int report_number(const char *name) {
  json_t *report = cli_json(&cli, NULL);
  const int value = (int)json_integer_value(json_object_get(report, name));
  json_decref(report);
  return value;
}

/* Longer words: the video turns, and never leaves a recorded frame out. */
static void test_longer(void **state) {
  (void)state;
  static uint8_t recorded[FRAMES][SIDE * SIDE / 4 * 3], top[SIDE * SIDE / 4 * 3];
  write_record(NULL, 0, 0);
  cli_run(&cli, "dub h.safetensors clip.mp4 --clip clip --audio longer/aud.wav -o turns.mp4 -y --json - --quiet");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(report_number("frames"), LONGER);
  assert_true(report_number("turns") >= LONGER / FRAMES);
  for (int k = 0; k < FRAMES; k++) read_top("clip.mp4", k / 25.0, recorded[k]);
  for (int k = 0, last = 0; k < LONGER; k++) {
    size_t least = SIZE_MAX;
    int shown = 0;
    read_top("turns.mp4", k / 25.0, top);
    for (int j = last - 1; j <= last + 1; j++) { /* which of the neighbours is it like most? */
      size_t sum = 0;
      if (j < 0 || j >= FRAMES) continue;
      for (size_t i = 0; i < sizeof top; i++) sum += (size_t)abs(top[i] - recorded[j][i]);
      if (sum < least) least = sum, shown = j;
    }
    assert_true(least < sizeof top * 4); /* 4 grey levels: H.264 coded twice */
    last = shown;
  }
}

/* Shorter words: the rest as recorded, with its sound, and known as not synthetic; or nothing. */
static void test_shorter(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_sound sound = {0}, recorded = {0};
  double loud = 0, apart = 0;
  write_record(NULL, 0, 0);
#define SHORT_DUB "dub h.safetensors clip.mp4 --clip clip --audio shorter/aud.wav -y --quiet --json - "
  cli_run(&cli, SHORT_DUB "-o rest.mp4");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(report_number("frames"), FRAMES);
  assert_int_equal(report_number("rest"), FRAMES - SHORTER);
  json_t *about = cli_json(&cli, "rest.mp4.provenance.json");
  const json_t *part = json_array_get(json_object_get(about, "synthetic_seconds"), 0);
  assert_true(json_number_value(json_array_get(part, 1)) == SHORTER / 25.0);
  json_decref(about);
  assert_int_equal(compare("rest.mp4", 25, 0), FRAMES);
  support_ok(context, ern_sound_read(context, "rest.mp4", &sound));
  support_ok(context, ern_sound_read(context, "clip.mp4", &recorded));
  assert_int_equal(sound.rate, recorded.rate);
  const size_t from = (size_t)(sound.rate * (SHORTER / 25.0 + 0.03)), to = (size_t)(sound.rate * 0.6);
  for (size_t i = from; i < to && i < sound.frames && i < recorded.frames; i++) {
    loud += recorded.data[i] * recorded.data[i];
    apart += (sound.data[i] - recorded.data[i]) * (sound.data[i] - recorded.data[i]);
  }
  assert_true(loud > 0 && apart < 0.1 * loud); /* AAC coded twice: 10 dB */
  ern_sound_free(context, &sound);
  ern_sound_free(context, &recorded);
  ern_context_free(&context);
  cli_run(&cli, SHORT_DUB "-o cut.webm --rest cut");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(report_number("frames"), SHORTER);
  cli_run(&cli, SHORT_DUB "-o rest.mkv --codec ffv1"); /* of RGB, so no frame is coded as it was decoded */
  cli_expect(&cli, 0, NULL);
  assert_int_equal(report_number("frames"), FRAMES);
#undef SHORT_DUB
}

static void test_part(void **state) {
  (void)state;
  static uint8_t recorded[SIDE * SIDE / 4 * 3], top[SIDE * SIDE / 4 * 3];
  size_t apart = 0, later = 0;
#define PART_DUB "dub h.safetensors clip.mp4 --clip clip --audio shorter/aud.wav -o part.mp4 -y --json - --quiet "
  write_record(NULL, 0, 0);
  cli_run(&cli, PART_DUB "--from 0.12 --to 0.56");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(report_number("frames"), 11);
  assert_int_equal(compare("part.mp4", 25, 3), 11);
  cli_run(&cli, PART_DUB "--from 0.4");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(report_number("frames"), SHORTER); /* of the six from there on, forward and backward */
  cli_run(&cli, PART_DUB "--from 0.2 --to 0.24");     /* one frame: it stands still, and none after it is shown */
  cli_expect(&cli, 0, NULL);
  assert_int_equal(report_number("frames"), SHORTER);
  read_top("clip.mp4", 0.2, recorded);
  read_top("part.mp4", (SHORTER - 1) / 25.0, top);
  for (size_t i = 0; i < sizeof top; i++) apart += (size_t)abs(top[i] - recorded[i]);
  read_top("clip.mp4", 0.2 + (SHORTER - 1) / 25.0, recorded);
  for (size_t i = 0; i < sizeof top; i++) later += (size_t)abs(top[i] - recorded[i]);
  assert_true(2 * apart < later);
  cli_run(&cli, PART_DUB "--from 0.4 --to 0.4");
  cli_expect(&cli, 2, "--from 0.40 --to 0.40, expected a part of the seconds 0.00 to 0.64 of clip.mp4", NULL);
  cli_run(&cli, PART_DUB "--to 0.7");
  cli_expect(&cli, 2, "--to 0.70, expected a part", NULL);
  cli_run(&cli, PART_DUB "--to 0.4 --frames 0:3");
  cli_expect(&cli, 2, "--frames", NULL);
#undef PART_DUB
}

/* Copies the packets of a file: of the pictures not those from number `gone` up to `next`, and the sound from packet
 * `after` on `late` seconds later. */
static void copy_packets(const char *from, const char *to, int64_t gone, int64_t next, int64_t after, double late) {
  AVFormatContext *in = NULL, *out = NULL;
  AVPacket *packet = av_packet_alloc();
  int64_t pictures = 0, sounds = 0;
  assert_true(packet != NULL && avformat_open_input(&in, from, NULL, NULL) >= 0);
  assert_true(avformat_alloc_output_context2(&out, NULL, "matroska", to) >= 0);
  for (unsigned i = 0; i < in->nb_streams; i++) {
    AVStream *stream = avformat_new_stream(out, NULL);
    assert_true(stream != NULL && avcodec_parameters_copy(stream->codecpar, in->streams[i]->codecpar) >= 0);
    stream->codecpar->codec_tag = 0;
  }
  assert_true(avio_open(&out->pb, to, AVIO_FLAG_WRITE) >= 0 && avformat_write_header(out, NULL) >= 0);
  while (av_read_frame(in, packet) >= 0) {
    const int i = packet->stream_index;
    const bool sound = in->streams[i]->codecpar->codec_type == AVMEDIA_TYPE_AUDIO;
    const bool left_out = !sound && pictures >= gone && pictures < next;
    pictures += !sound;
    av_packet_rescale_ts(packet, in->streams[i]->time_base, out->streams[i]->time_base);
    if (sound && sounds++ >= after) packet->pts = packet->dts += llround(1000 * late); /* the container's clock: 1 ms */
    if (!left_out) assert_true(av_interleaved_write_frame(out, packet) >= 0);
    av_packet_unref(packet);
  }
  assert_true(av_write_trailer(out) >= 0);
  avio_closep(&out->pb);
  avformat_free_context(out);
  avformat_close_input(&in);
  av_packet_free(&packet);
}

/* Mean square of a channel between two seconds. */
static double power(const ern_sound *sound, int channel, double from, double to) {
  double sum = 0;
  const size_t first = (size_t)(from * sound->rate), past = (size_t)(to * sound->rate);
  assert_true(past <= sound->frames && channel < sound->channels);
  for (size_t i = first; i < past; i++) {
    const double value = sound->data[i * (size_t)sound->channels + (size_t)channel];
    sum += value * value;
  }
  return sum / (double)(past - first);
}

/* words.wav: two channels of 0.36 s, a tone in the left one. */
static void write_words(int rate) {
  ern_context *context = support_context();
  ern_sound sound = {.rate = rate, .channels = 2, .frames = (size_t)(SHORTER * rate / 25)};
  sound.data = calloc(2 * sound.frames, sizeof *sound.data);
  assert_non_null(sound.data);
  for (size_t i = 0; i < sound.frames; i++) sound.data[2 * i] = (int16_t)(8000 * sin(0.3 * (double)i));
  support_ok(context, ern_sound_write_wav(context, "words.wav", &sound));
  free(sound.data);
  ern_context_free(&context);
}

/* The words keep their channels and their rate, and the recorded sound after them is as loud as it was. */
static void test_better_sound(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_sound sound = {0}, recorded = {0};
  write_record(NULL, 0, 0);
  write_words(48000);
  cli_run(&cli, "dub h.safetensors clip.mp4 --clip clip --audio words.wav -o better.mp4 -y --quiet");
  cli_expect(&cli, 0, NULL);
  support_ok(context, ern_sound_read(context, "better.mp4", &sound));
  support_ok(context, ern_sound_read(context, "clip.mp4", &recorded));
  assert_true(sound.rate == 48000 && sound.channels == 2 && recorded.channels == 1);
  assert_true(power(&sound, 0, 0.05, 0.3) > 2e7 && power(&sound, 1, 0.05, 0.3) < 2e5);
  const double loud = power(&recorded, 0, 0.42, 0.6);
  for (int c = 0; c < 2; c++) assert_true(fabs(power(&sound, c, 0.42, 0.6) / loud - 1) < 0.1); /* AAC coded twice */
  ern_sound_free(context, &sound);
  ern_sound_free(context, &recorded);
  ern_context_free(&context);
}

/* Words of a video whose sound begins later than its pictures: the mouth waits for them, and so does the sound. */
static void test_late_words(void **state) {
  (void)state;
  ern_context *context = support_context();
  ern_sound sound = {0}, words = {0};
  double loud = 0, apart = 0;
  write_record(NULL, 0, 0);
  copy_packets("shorter.mp4", "late.mkv", 0, 0, 0, 0.12);
  cli_run(&cli, "dub h.safetensors clip.mp4 --clip clip --audio late.mkv -o late.mp4 -y --quiet --json -");
  cli_expect(&cli, 0, NULL);
  assert_true(report_number("rest") > 0);
  support_ok(context, ern_sound_read(context, "late.mp4", &sound));
  support_ok(context, ern_sound_read(context, "late.mkv", &words));
  assert_int_equal(sound.rate, words.rate);
  for (size_t i = 0; i < (size_t)(0.4 * sound.rate); i++) {
    loud += words.data[i] * words.data[i];
    apart += (sound.data[i] - words.data[i]) * (sound.data[i] - words.data[i]);
  }
  assert_true(loud > 0 && apart < 0.1 * loud); /* AAC coded twice: 10 dB */
  ern_sound_free(context, &sound);
  ern_sound_free(context, &words);
  ern_context_free(&context);
}

/* Frame k is grey, 15 k. */
static void write_grey(const char *path, double pixel_aspect) {
  static uint8_t rgba[SIDE * SIDE * 4];
  ern_context *context = support_context();
  ern_video_options options = ern_video_options_default(SIDE, SIDE);
  ern_video_writer *writer = NULL;
  options.pixel_aspect = pixel_aspect;
  if (strstr(path, ".mkv") != NULL) options.codec = "ffv1"; /* which has no frames that need later ones */
  support_ok(context, ern_video_writer_open(context, path, &options, &writer));
  for (int k = 0; k < FRAMES; k++) {
    memset(rgba, 15 * k, sizeof rgba);
    support_ok(context, ern_video_writer_frame(writer, rgba));
  }
  support_ok(context, ern_video_writer_close(&writer));
  ern_context_free(&context);
}

/* A clip that begins between two recorded frames: its frames are the nearest ones, as `prepare` chooses them. The
 * output's pixels have the shape of the video's. */
static void test_between(void **state) {
  (void)state;
  static uint8_t top[SIDE * SIDE / 4 * 3];
  ern_context *context = support_context();
  ern_video_reader *reader = NULL;
  ern_video_info info;
  char hash[65];
  recorded_clip_grey("steps.mp4", 4.0 / 3, SIDE, SIDE, FRAMES);
  support_ok(context, ern_file_sha256(context, "steps.mp4", hash));
  write_record(hash, 0.03, 0);
  cli_run(&cli, "dub h.safetensors steps.mp4 --clip clip --audio shorter/aud.wav -o between.mp4 --rest cut -y --quiet");
  cli_expect(&cli, 0, NULL);
  for (int k = 0; k < SHORTER; k++) {
    read_top("between.mp4", k / 25.0, top);
    assert_in_range(top[0], 15 * (k + 1) - 4, 15 * (k + 1) + 4);
  }
  support_ok(context, ern_video_reader_open(context, "between.mp4", &reader));
  ern_video_reader_info(reader, &info);
  assert_true(fabs(info.pixel_aspect - 4.0 / 3) < 1e-9);
  ern_video_reader_free(&reader);
  ern_context_free(&context);
}

/* Words with a gap are read for the mouth and for the sound: the gap is told once. */
static void test_told_once(void **state) {
  (void)state;
  write_record(NULL, 0, 0);
  copy_packets("shorter.mp4", "gap.mkv", 0, 0, 3, 0.12);
  cli_run(&cli, "dub h.safetensors clip.mp4 --clip clip --audio gap.mkv -o gap.mp4 -y --quiet --frames 0:1");
  cli_expect(&cli, 0, "warning: gap.mkv: at 0.", NULL);
  assert_null(strstr(strstr(cli.err, "gap.mkv: at ") + 1, "gap.mkv: at "));
}

/* A video of variable rate whose last frame is shown long, as in the clip: its last frames are that one. */
static void test_variable_rate(void **state) {
  (void)state;
  static uint8_t last[SIDE * SIDE / 4 * 3], before[SIDE * SIDE / 4 * 3];
  ern_context *context = support_context();
  char hash[65];
  write_grey("steady.mkv", 1);
  copy_packets("steady.mkv", "variable.mkv", 8, FRAMES - 1, 0, 0);
  support_ok(context, ern_file_sha256(context, "variable.mkv", hash));
  write_record(hash, 0.2, 0);
  cli_run(&cli,
          "dub h.safetensors variable.mkv --clip clip --audio shorter/aud.wav -o variable.mp4 -y --quiet --json -");
  cli_expect(&cli, 0, NULL);
  assert_int_equal(report_number("frames"), FRAMES);
  read_top("variable.mp4", (FRAMES - 1) / 25.0, last);
  read_top("variable.mp4", 10 / 25.0, before); /* of second 0.6 of the video, its last */
  assert_in_range(last[0], before[0] - 1, before[0] + 1);
  ern_context_free(&context);
}

/* Words that are replaced while the program starts: the mouth might say the old ones, and the sound the new ones. The
 * record of the clip is a pipe, which the program waits for. */
static void test_words_change(void **state) {
  (void)state;
  size_t count = 0;
  write_record(NULL, 0, 0);
  uint8_t *record = cli_bytes("clip/prepare.json", &count);
  assert_int_equal(remove("clip/prepare.json") | mkfifo("clip/prepare.json", 0600), 0);
  assert_int_equal(system("cp shorter/aud.wav changed.wav; cp longer/aud.wav next.wav"), 0);
  snprintf(cli.line, sizeof cli.line, "dub h.safetensors clip.mp4 --clip clip --audio changed.wav -o none.mp4 --quiet");
  cli_start(&cli, NULL, 0);
  FILE *pipe = fopen("clip/prepare.json", "wb"); /* waits for its reader */
  assert_non_null(pipe);
  assert_int_equal(rename("next.wav", "changed.wav"), 0);
  assert_int_equal(fwrite(record, 1, count, pipe), count);
  fclose(pipe);
  assert_int_equal(remove("clip/prepare.json"), 0);
  support_write("clip/prepare.json", record, count);
  free(record);
  cli_wait(&cli);
  cli_expect(&cli, 1, "changed.wav: was changed while it was read", NULL);
  assert_false(cli_there("none.mp4"));
}

/* Segments of a dubbed video say which frames they have, and which of their own seconds are synthetic. */
static void test_segments(void **state) {
  (void)state;
#define SEGMENT "dub h.safetensors clip.mp4 --clip clip --audio shorter/aud.wav -y --quiet "
  write_record(NULL, 0, 0);
  assert_int_equal(system("rm -rf parts; mkdir parts"), 0);
  cli_run(&cli, SEGMENT "--frames 0:4 -o parts/b.mp4");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, SEGMENT "--frames 4:8 -o parts/a.mp4");
  cli_expect(&cli, 0, NULL);
  cli_run(&cli, "join parts -o joined.mp4 -y");
  cli_expect(&cli, 1, "parts/b.mp4: begins with frame 0, expected 8", NULL);
  assert_int_equal(system("cd parts; for f in a.mp4*; do mv $f c${f#a}; done"), 0);
  cli_run(&cli, "join parts -o joined.mp4 -y");
  cli_expect(&cli, 0, NULL);
  json_t *about = cli_json(&cli, "joined.mp4.provenance.json");
  assert_null(json_object_get(about, "synthetic_seconds"));
  assert_int_equal(json_integer_value(json_object_get(about, "frames")), 8);
  for (size_t k = 0; k < 2; k++)
    assert_non_null(json_object_get(json_array_get(json_object_get(about, "segments"), k), "synthetic_seconds"));
  json_decref(about);
#undef SEGMENT
}

/* A video that gets another's name while the program starts: the prepared one is dubbed, or none. */
static void test_replaced(void **state) {
  (void)state;
  write_record(NULL, 0, 0);
  recorded_clip_grey("grey.mp4", 1, SIDE, SIDE, FRAMES);
  for (int tenths = 0; tenths < 4; tenths++) {
    char command[256];
    support_clear("moved.mp4");
    support_clear("moved_out.mp4");
    snprintf(command, sizeof command,
             "cp clip.mp4 moved.mp4; cp grey.mp4 next.mp4; { sleep 0.%d; mv next.mp4 moved.mp4; } &", tenths);
    assert_int_equal(system(command), 0);
    cli_run(&cli, "dub h.safetensors moved.mp4 --clip clip --audio clip/aud.wav -o moved_out.mp4 -y --quiet");
    if (cli_there("moved_out.mp4"))
      assert_int_equal(compare("moved_out.mp4", 25, 0), FRAMES);
    else
      cli_expect(&cli, 1, "moved.mp4: ", NULL); /* is not the video, or was changed */
    for (int i = 0; i < 1000 && cli_there("next.mp4"); i++)
      (void)nanosleep(&(struct timespec){.tv_nsec = 1000000}, NULL);
  }
}

/* A clip that lacks a frame: the poses after it would be those of other frames of the video. One that lacks its parsing
 * has no bounds of the head. */
static void test_frame_lacks(void **state) {
  (void)state;
  write_record(NULL, 0, 0);
  assert_int_equal(system("rm -rf gap && cp -rL clip gap"), 0);
  json_t *train = cli_json(&cli, "gap/transforms_train.json");
  assert_int_equal(json_array_remove(json_object_get(train, "frames"), 3), 0);
  assert_int_equal(json_dump_file(train, "gap/transforms_train.json", 0), 0);
  json_decref(train);
  cli_run(&cli, "dub h.safetensors clip.mp4 --clip gap --audio clip/aud.wav -o no.mp4 --force");
  cli_expect(&cli, 1, "gap: transforms_train.json and transforms_val.json: frame 3 has img_id 4, expected 3", NULL);
  assert_false(cli_there("no.mp4"));
  assert_int_equal(system("rm -rf gap/parsing && cp clip/transforms_train.json gap"), 0);
  cli_run(&cli, "dub h.safetensors clip.mp4 --clip gap --audio clip/aud.wav -o gap.mp4 -y --frames 0:1");
  cli_expect(&cli, 0, "warning: gap: has no parsing/, so the mouth is also drawn on what is before the face", NULL);
}

static void test_refused(void **state) {
  (void)state;
#define DUB "dub h.safetensors clip.mp4 --clip clip --audio "
  write_record(NULL, 0, 0);
  cli_run(&cli, DUB "clip/aud.wav -o no%%d.png");
  cli_expect(&cli, 2, "expected a video", NULL);
  cli_run(&cli, DUB "clip/aud_ds.npy -o no.mp4");
  cli_expect(&cli, 2, "expected a sound", NULL);
  cli_run(&cli, DUB "clip/aud.wav -o clip.mp4 -y"); /* the video is an input */
  cli_expect(&cli, 1, "clip.mp4", NULL);
  write_record("0000000000000000000000000000000000000000000000000000000000000000", 0, 0);
  cli_run(&cli, DUB "clip/aud.wav -o no.mp4");
  cli_expect(&cli, 1, "clip.mp4: is not the video of clip", "expected 000000000000", NULL);
  cli_run(&cli, DUB "clip/aud.wav -o no.mp4 --torso model");
  cli_expect(&cli, 2, "--torso is about the torso, which stays as recorded", NULL);
  write_record(NULL, 0, 8);
  cli_run(&cli, DUB "clip/aud.wav -o no.mp4");
  cli_expect(&cli, 1, "the square ends at 104, 96, but clip.mp4 has 96 x 96 pixels", NULL);
  write_record(NULL, 0.2, 0);
  cli_run(&cli, DUB "clip/aud.wav -o no.mp4");
  cli_expect(&cli, 1, "clip.mp4: ends before frame 1", NULL);
  cli_replace("clip/prepare.json", "{}", 2);
  cli_run(&cli, DUB "clip/aud.wav -o no.mp4");
  cli_expect(&cli, 1, "clip/prepare.json: has no \"crop\"", NULL);
  support_clear("clip/prepare.json");
  cli_run(&cli, DUB "clip/aud.wav -o no.mp4");
  cli_expect(&cli, 1, "a clip that `ernerf prepare` made of the video is needed", NULL);
  assert_false(cli_there("no.mp4"));
#undef DUB
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(test_dub),          cmocka_unit_test(test_replaced),     cmocka_unit_test(test_for_dub),
      cmocka_unit_test(test_eval),         cmocka_unit_test(test_against_long), cmocka_unit_test(test_longer),
      cmocka_unit_test(test_shorter),      cmocka_unit_test(test_part),         cmocka_unit_test(test_between),
      cmocka_unit_test(test_frame_lacks),  cmocka_unit_test(test_refused),      cmocka_unit_test(test_better_sound),
      cmocka_unit_test(test_late_words),   cmocka_unit_test(test_told_once),    cmocka_unit_test(test_variable_rate),
      cmocka_unit_test(test_words_change), cmocka_unit_test(test_segments)};
  return cmocka_run_group_tests(tests, make_all, NULL);
}
