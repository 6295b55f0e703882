/* SPDX-License-Identifier: MIT
 * ernerf serve: portraits that many people watch, and that speak what they are asked to, over HTTP. */
#include <ctype.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

#include "serve/serve_keeper.h"
#include "serve/serve_library.h"
#include "verbs.h"

enum {
  IN_OPTIONS = 3,
  OUT_OPTIONS = 13,
  TOKEN_LEAST = 16,
  TOKEN_BYTES = 512,
  LOOK_MS = 50,
  FILES = 256 /* that are open besides connections: pictures that are read, pipes of sounds that wait */,
  FILES_OF_VIEWER = 16 /* by WebRTC, who takes 9 on a machine of three addresses */
};

struct serve_job {
  struct live_job live; /* the options of every session, and the program's own session */
  const char *models[SERVE_PORTRAITS];
  const char *say_file, *watch_file, *udp_ports;
  int viewers, connections;
  struct ern_http_options http_options;
  char say_token[TOKEN_BYTES], watch_token[TOKEN_BYTES];
  struct serve_keeper keeper;
};

/* ---- words ------------------------------------------------------------------------------------------------------- */

static void in_options(struct serve_job *serve, struct option options[IN_OPTIONS]) {
  const struct option rows[] = {
      {ARGS_TEXT("name", &serve->keeper.name), .choices = "ID",
       .help = "the session's name in addresses: letters, digits, ., - and _ (default PORTRAIT without folder and "
               "ending); with one PORTRAIT"},
      {ARGS_TEXT("tts", &serve->live.sound.tts.program), .choices = "PROGRAM",
       .help = "makes sound of a text: the text on its standard input, the sound on its standard output, in any format "
               "that says what it is (default espeak-ng)"},
      {ARGS_LIST("tts-argument", &serve->live.sound.tts.arguments), .choices = "TEXT",
       .help = "an argument of PROGRAM, again for each; --tts-argument=--quiet where it begins with a dash"}};
  ARGS_FILL(options, rows, IN_OPTIONS);
}

static void out_options(struct serve_job *serve, struct option options[OUT_OPTIONS]) {
  struct ern_http_options *http = &serve->http_options;
  *http = (struct ern_http_options){.listen = "127.0.0.1", .port = 8080, .patience = 10};
  serve->viewers = 64;
  serve->connections = 256;
  const struct option rows[] = {
      {ARGS_INT("port", &http->port, 0, 65535), .help = "to listen at (default 8080; 0: one that is free)"},
      {ARGS_TEXT("listen", &http->listen), .choices = "ADDRESS",
       .help =
           "IP address to listen at (default 127.0.0.1, which admits this machine alone; any other needs both tokens)"},
      {ARGS_TEXT("host", &http->host), .choices = "NAME",
       .help = "name by which browsers reach the server, beside IP addresses and localhost"},
      {ARGS_TEXT("allow-origin", &http->origin), .choices = "ORIGIN",
       .help = "pages of this origin may use the server too, such as https://www.example.org"},
      {ARGS_TEXT("say-token", &serve->say_file), .choices = "FILE",
       .help = "its first line is the token that requests must have which make it speak or change; it may watch too"},
      {ARGS_TEXT("watch-token", &serve->watch_file), .choices = "FILE",
       .help = "its first line is the token that requests must have to watch, and to see events and state"},
      {ARGS_INT("viewers", &serve->viewers, 1, 10000), .help = "most viewers of all sessions (default 64)"},
      {ARGS_INT("connections", &serve->connections, 4, 20000),
       .help = "most connections, those of viewers among them (default 256)"},
      {ARGS_TEXT("stun", &http->stun), .choices = "stun://HOST:PORT",
       .help = "server that tells viewers by WebRTC the server's own address behind a router (default: none)"},
      {ARGS_TEXT("udp-ports", &serve->udp_ports), .choices = "FIRST-LAST",
       .help = "ports for viewers by WebRTC, such as 50000-50199 (default: those that the system chooses)"},
      {ARGS_TEXT("record", &serve->keeper.record), .choices = "FOLDER",
       .help = "records each session as FOLDER/ID-TIME.mp4, from its beginning to its end, as it is coded for viewers"},
      {ARGS_LIST("push", &serve->keeper.push), .choices = "URL",
       .help = "sends the stream there too, as it is coded for viewers, again for each: rtmp://, rtmps://, srt:// or "
               "udp://; one that fails is tried again; with one PORTRAIT"},
      {ARGS_SECONDS("duration", &serve->live.seconds, 0.04, 1e9), .help = "end after T (default: with a signal)"}};
  ARGS_FILL(options, rows, OUT_OPTIONS);
}

static bool is_local(const char *address) { return strncmp(address, "127.", 4) == 0 || strcmp(address, "::1") == 0; }

static bool is_stun(const char *address) {
  char host[256];
  int port = 0, end = 0;
  return sscanf(address, "stun://%255[^:/@?#]:%d%n", host, &port, &end) == 2 && address[end] == 0 && port > 0 &&
         port < 65536;
}

static bool read_ports(const char *text, struct ern_http_options *http) {
  int end = 0;
  return text[strspn(text, "0123456789-")] == 0 &&
         sscanf(text, "%5d-%5d%n", &http->first_port, &http->last_port, &end) == 2 && text[end] == 0 &&
         http->first_port > 0 && http->first_port <= http->last_port && http->last_port < 65536;
}

static int check_usage(struct serve_job *serve, const struct args *args) {
  int status = live_check(&serve->live, args);
  const bool several = serve->models[1] != NULL;
  if (status < 0 && several) status = args_forbid(args, "clip video name push", "is about one PORTRAIT");
  if (status < 0) status = args_forbid(args, "json", "has nothing to write: GET /state gives the figures");
  if (status < 0) status = args_forbid(args, "overwrite", "changes nothing: --record replaces no file");
  for (size_t k = 0; status < 0 && k < serve->keeper.push.count; k++)
    if (!push_takes(serve->keeper.push.text[k]))
      status = args_refuse(args, "--push is \"%s\", expected rtmp://, rtmps://, srt:// or udp:// with a host",
                           serve->keeper.push.text[k]);
  if (status < 0 && serve->live.sound.tts.program == NULL) status = args_forbid(args, "tts-argument", "needs --tts");
  if (status < 0 && serve->live.sound.tts.program != NULL)
    status = args_forbid(args, "voice", "is espeak-ng's, not --tts's");
  if (status < 0 && serve->keeper.name != NULL && !serve_is_name(serve->keeper.name))
    status = args_refuse(args, "--name is \"%s\", expected up to %d letters, digits, ., - and _", serve->keeper.name,
                         SERVE_ID - 1);
  if (status < 0 && !is_local(serve->http_options.listen) && (serve->say_file == NULL || serve->watch_file == NULL))
    status = args_refuse(args, "--listen %s admits other machines: expected --say-token and --watch-token",
                         serve->http_options.listen);
  if (status < 0 && serve->http_options.stun != NULL && !is_stun(serve->http_options.stun))
    status = args_refuse(args, "--stun is \"%s\", expected stun://HOST:PORT", serve->http_options.stun);
  if (status < 0 && serve->udp_ports != NULL && !read_ports(serve->udp_ports, &serve->http_options))
    status = args_refuse(args, "--udp-ports is \"%s\", expected FIRST-LAST, two ports from 1 to 65535 in this order",
                         serve->udp_ports);
  if (status < 0 && serve->connections <= serve->viewers)
    status =
        args_refuse(args, "--connections is %d, expected more than --viewers, %d", serve->connections, serve->viewers);
  return status;
}

/* ---- tokens ------------------------------------------------------------------------------------------------------ */

/* The first line of a file, so that no list of processes shows it. */
static int read_token(struct session *session, const char *path, char token[TOKEN_BYTES]) {
  FILE *file = fopen(path, "r");
  const size_t count = file != NULL ? fread(token, 1, TOKEN_BYTES - 1, file) : 0;
  if (file != NULL) (void)fclose(file);
  if (count == 0) return session_fail_with(session, "%s: cannot be read, expected a line with a token", path);
  token[count] = 0;
  size_t bytes = 0;
  while (bytes < count && isgraph((unsigned char)token[bytes])) bytes++;
  const bool ends = bytes == count || token[bytes] == '\n' || token[bytes] == '\r', /* not at a zero byte */
      plain = ends && bytes >= TOKEN_LEAST && bytes < TOKEN_BYTES - 1;
  token[bytes] = 0;
  if (plain) return 0;
  return session_fail_with(session,
                           "%s: its first line is no token: expected %d to %d visible ASCII characters; `openssl rand "
                           "-hex 32` makes some",
                           path, TOKEN_LEAST, TOKEN_BYTES - 2);
}

static int read_tokens(struct serve_job *serve) {
  struct session *session = &serve->live.session;
  struct ern_http_options *http = &serve->http_options;
  if (serve->say_file != NULL && read_token(session, serve->say_file, serve->say_token) != 0) return EXIT_FAILURE;
  if (serve->watch_file != NULL && read_token(session, serve->watch_file, serve->watch_token) != 0) return EXIT_FAILURE;
  http->say_token = serve->say_file != NULL ? serve->say_token : NULL;
  http->watch_token = serve->watch_file != NULL ? serve->watch_token : NULL;
  http->viewers = (unsigned)serve->viewers;
  http->connections = (unsigned)serve->connections;
  return 0;
}

/* ---- the server ----------------------------------------------------------------------------------------------------
 */

/* Else so many connections would end the sessions, which could not open a picture. Viewers by WebRTC are refused where
 * there are too few files for them. */
static int allow_files(struct serve_job *serve) {
  struct rlimit files;
  const rlim_t needed = (rlim_t)serve->connections + FILES, wanted = needed + FILES_OF_VIEWER * (rlim_t)serve->viewers;
  if (getrlimit(RLIMIT_NOFILE, &files) != 0 || files.rlim_cur >= wanted) return 0;
  const rlim_t most = files.rlim_max, now = files.rlim_cur;
  files.rlim_cur = wanted < most ? wanted : most;
  if (files.rlim_cur >= needed && (setrlimit(RLIMIT_NOFILE, &files) == 0 || now >= needed)) return 0;
  return session_fail_with(&serve->live.session,
                           "--connections is %d, and the system allows %llu open files, expected %llu (ulimit -n)",
                           serve->connections, (unsigned long long)most, (unsigned long long)needed);
}

static int run(struct serve_job *serve, const struct args *args) {
  struct session *session = &serve->live.session;
  struct serve_keeper *keeper = &serve->keeper;
  struct ern_http_options *http = &serve->http_options;
  char error[1024];
  int status = read_tokens(serve);
  (void)pthread_mutex_init(&keeper->mutex, NULL); /* does not fail on Linux */
  keeper->live = &serve->live;
  keeper->args = args;
  http->keeper = (struct ern_http_keeper){serve_keeper_create, serve_keeper_end, keeper};
  if (status == 0) status = allow_files(serve);
  if (status == 0) status = serve_library_load(&keeper->http, session);
  if (status == 0 && !keeper->http->start(http, &keeper->server, error, sizeof error))
    status = session_fail_with(session, "%s", error);
  if (status == 0 && session_backend(session) != ERN_OK) status = session_fail(session);
  if (status == 0) status = serve_keeper_open(keeper, serve->models);
  const bool six = strchr(http->listen, ':') != NULL; /* an address of IPv6 */
  if (status == 0)
    session_note(session, "serve: http://%s%s%s:%d/", six ? "[" : "", http->listen, six ? "]" : "",
                 keeper->http->port(keeper->server));
  while (status == 0 && !session_interrupted() && serve_keeper_look(keeper))
    (void)nanosleep(&(struct timespec){.tv_nsec = LOOK_MS * 1000000}, NULL);
  if (status == 0 && !session_interrupted() && serve->live.seconds <= 0)
    status = session_fail_with(session, "no session is left");
  serve_keeper_close(keeper);
  if (keeper->http != NULL) keeper->http->stop(&keeper->server);
  if (status == 0 && session_interrupted()) status = session_stop_with(session, "stopped");
  (void)pthread_mutex_destroy(&keeper->mutex);
  session_close(session);
  return status;
}

int cmd_serve(int argc, char **argv) {
  struct serve_job *serve = calloc(1, sizeof *serve);
  struct live_tables *tables = calloc(1, sizeof *tables);
  struct word words[SERVE_PORTRAITS];
  int status = EXIT_FAILURE;
  if (serve == NULL || tables == NULL) {
    fprintf(stderr, "ernerf serve: no memory\n");
    goto fail;
  }
  for (size_t k = 0; k < SERVE_PORTRAITS; k++)
    words[k] = (struct word){"PORTRAIT", &serve->models[k],
                             k > 0 ? "another one, up to 8"
                                   : "a .safetensors file: a head, or head and torso; its clip is the folder "
                                     "with its name without the ending, unless --clip names it"};
  struct args args = {.verb = "serve",
                      .summary = "Serves talking portraits over HTTP: many watch, and let them speak.",
                      .usage =
                          "serve PORTRAIT... [--port N] [--tts PROGRAM]\n"
                          "serve PORTRAIT --clip CLIP [--video VIDEO] [--port N]",
                      .notes = "docs/serve.md: requests, events, who may ask, behind a proxy, figures.",
                      .words = words,
                      .word_count = SERVE_PORTRAITS,
                      .optional_words = SERVE_PORTRAITS - 1};
  serve->live.output.profile = "baseline"; /* which every receiver of WebRTC decodes (RFC 7742) */
  in_options(serve, tables->in);
  out_options(serve, tables->out);
  live_tables_fill(tables, &serve->live, IN_OPTIONS, OUT_OPTIONS, &args);
  status = args_parse(&args, argc, argv);
  if (status < 0) status = check_usage(serve, &args);
  const char *const inputs[SESSION_INPUTS] = {serve->live.portrait.source.path, serve->live.background_file,
                                              serve->live.video.path, serve->live.rate_control.front};
  memcpy(serve->live.session.inputs, inputs, sizeof inputs);
  if (status < 0) status = session_open(&serve->live.session, &args);
  if (status < 0) status = run(serve, &args);
fail:
  free(tables);
  free(serve);
  return status;
}
