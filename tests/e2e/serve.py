#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""ernerf serve: viewers of one coded stream, text and sound to say, events, who may ask, and what hostile clients do.
With ERNERF_TEST_LONG more of it. Usage: serve.py ERNERF FOLDER CLIPS (of shared_clips.sh)"""
import http.client
import json
import os
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time

ERNERF, FOLDER, CLIPS = sys.argv[1:4]
LONG = "ERNERF_TEST_LONG" in os.environ
PATIENCE = 60


def check(holds, what):
    if not holds:
        raise SystemExit(f"FAIL: {what}")


def until(found, what, seconds=PATIENCE):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        value = found()
        if value:
            return value
        time.sleep(0.02)
    raise SystemExit(f"FAIL: {what} did not come in {seconds} s")


class Server:
    """`ernerf serve` with a free port; `with` ends it by SIGTERM."""

    def __init__(self, *words):
        self.words = [ERNERF, "serve", *words, "--port", "0"]

    def __enter__(self):
        self.lines = []
        self.process = subprocess.Popen(self.words, stderr=subprocess.PIPE, text=True, errors="replace")
        threading.Thread(target=lambda: self.lines.extend(iter(self.process.stderr.readline, "")), daemon=True).start()
        until(lambda: self.address() or self.process.poll() is not None, "the server")
        check(self.address(), f"no address in: {self.text()}")
        self.port = int(self.address()[1])
        until(lambda: self.state(), "a session")
        return self

    def __exit__(self, kind, *_):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        status = self.process.wait(PATIENCE)
        check(kind or status == 143, f"exit status {status}, expected 143: {self.text()}")

    def text(self):
        return "".join(self.lines)

    def address(self):
        return re.search(r"http://[^ ]*:(\d+)/", self.text())

    def ask(self, method, path, body=None, fields=(), kind=None):
        """Status and body of an answer; a JSON object where it is one."""
        fields = dict(fields)
        if kind:
            fields["Content-Type"] = kind
        line = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)
        try:
            line.request(method, path, body, fields)
            answer = line.getresponse()
            self.fields = answer.headers
            bytes_ = answer.read()
        finally:
            line.close()
        return answer.status, json.loads(bytes_) if answer.headers["Content-Type"] == "application/json" else bytes_

    def state(self):
        sessions = self.ask("GET", "/state")[1]["sessions"]
        return sessions[0] if sessions else None

    def say(self, text, expected=202):
        status, answer = self.ask("POST", "/v1/sessions/head/say", text, kind="text/plain")
        check(status == expected, f"say: {status} {answer}")
        return answer.get("id")


class Reader:
    """A connection that reads in a thread of its own until it is closed."""

    def __init__(self, server, path, fields=""):
        self.bytes = b""
        self.ended = False
        self.line = socket.create_connection(("127.0.0.1", server.port))
        self.line.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n{fields}\r\n".encode())
        threading.Thread(target=self.run, daemon=True).start()

    def run(self):
        try:
            while True:
                more = self.line.recv(65536)
                if not more:
                    break
                self.bytes += more
        except OSError:
            pass
        self.ended = True

    def body(self):
        """Without the pieces' lengths, those that are whole."""
        head, _, rest = self.bytes.partition(b"\r\n\r\n")
        body = b""
        while True:
            length, found, rest = rest.partition(b"\r\n")
            if not found or len(rest) < int(length, 16) + 2 or int(length, 16) == 0:
                return body
            body += rest[: int(length, 16)]
            rest = rest[int(length, 16) + 2 :]

    def close(self):
        self.line.close()


def boxes(data):
    """(kind, content) of the boxes of an mp4 that are whole."""
    at = 0
    while at + 8 <= len(data):
        size, kind = struct.unpack(">I4s", data[at : at + 8])
        if size < 8 or at + size > len(data):
            return
        yield kind.decode(), data[at + 8 : at + size]
        at += size


def inside(content, *path):
    for kind, part in boxes(content):
        if kind == path[0]:
            yield from inside(part, *path[1:]) if len(path) > 1 else [part]


class Stream:
    """What a viewer has: kinds of its boxes, the tracks' time scales, and by fragment {track: (seconds, key)}."""

    def __init__(self, reader):
        data = list(boxes(reader.body()))
        self.kinds = [kind for kind, _ in data]
        scale, sort = {}, {}
        self.fragments = []
        for kind, content in data:
            if kind == "moov":
                for track in inside(content, "trak"):
                    number = struct.unpack(">I", next(inside(track, "tkhd"))[12:16])[0]
                    scale[number] = struct.unpack(">I", next(inside(track, "mdia", "mdhd"))[12:16])[0]
                    sort[number] = next(inside(track, "mdia", "hdlr"))[8:12].decode()
            if kind != "moof":
                continue
            tracks = {}
            for track in inside(content, "traf"):
                header = next(inside(track, "tfhd"))
                number = struct.unpack(">I", header[4:8])[0]
                time_ = next(inside(track, "tfdt"))
                at = struct.unpack(">Q", time_[4:12])[0] if time_[0] == 1 else struct.unpack(">I", time_[4:8])[0]
                flags, count = struct.unpack(">II", next(inside(track, "trun"))[:8])
                key = bool(flags & 4) or not struct.unpack(">I", header[-4:])[0] & 0x10000
                tracks[sort[number]] = (at / scale[number], key, count)
            self.fragments.append(tracks)

    def pictures(self):
        return [tracks["vide"][0] for tracks in self.fragments if "vide" in tracks]


def check_stream(stream, what):
    check(stream.kinds[:2] == ["ftyp", "moov"], f"{what}: begins with {stream.kinds[:3]}")
    check(stream.fragments and stream.fragments[0]["vide"][1], f"{what}: does not begin with a key frame")
    times = stream.pictures()
    check(len(times) >= 5, f"{what}: {len(times)} pictures")
    check(all(abs(b - a - 0.04) < 1e-3 for a, b in zip(times, times[1:])), f"{what}: times {times}")
    for tracks in stream.fragments:
        if len(tracks) == 2: # a packet of sound has 21 ms, and waits until it is full
            check(abs(tracks["vide"][0] - tracks["soun"][0]) <= 0.065, f"{what}: sound and picture apart: {tracks}")


def events_of(reader):
    return [(kind.decode(), json.loads(data))
            for kind, data in re.findall(rb"event: (\w+)\ndata: (.*)\n\n", reader.body())]


def await_event(reader, kind, number):
    return until(lambda: [e for k, e in events_of(reader) if k == kind and e["id"] == number], f"{kind} {number}")[0]


def test_watch_and_say(server):
    """Two viewers of one stream, the second later; text is said, and what becomes of it is told."""
    early, events = (Reader(server, f"/v1/sessions/head/{name}") for name in ("stream", "events"))
    until(lambda: b"moof" in early.bytes, "a fragment")
    until(lambda: b":" in events.body(), "the events' first line")
    time.sleep(1.3)
    late = Reader(server, "/v1/sessions/head/stream")
    until(lambda: server.state()["viewers"] == 2, "two viewers")
    number = server.say("hello")
    check(number == 1, f"the first utterance has the number {number}")
    started, ended = (await_event(events, kind, number) for kind in ("started", "ended"))
    check(0 < started["seconds"] < ended["seconds"], f"{started} {ended}")
    check(abs(ended["seconds"] - started["seconds"] - 1.32) < 0.09, f"33 frames are said from {started} to {ended}")
    check([k for k, e in events_of(events)] == ["queued", "started", "ended"], f"{events_of(events)}")
    until(lambda: server.state()["speaking"] is None and server.state()["drawn"] > 30, "rest in the state")
    for reader in early, late:
        reader.close()
    until(lambda: server.state()["viewers"] == 0, "no viewer")
    check_stream(Stream(early), "the first viewer")
    check_stream(Stream(late), "the second viewer")
    first, second = (Stream(reader).pictures()[0] for reader in (early, late))
    check(second > first and set(Stream(late).pictures()[:5]) <= set(Stream(early).pictures()), "they see two streams")
    events.close()


def test_stop(server):
    """What is said and what waits is told of once; sound that comes in a body is said, and a new text afterwards."""
    events = Reader(server, "/v1/sessions/head/events")
    until(lambda: b":" in events.body(), "the events' first line")
    with open("clip/aud.wav", "rb") as file:
        status, answer = server.ask("POST", "/v1/sessions/head/say", file.read(), kind="audio/wav")
    check(status == 202, f"{status} {answer}")
    first = answer["id"]
    waiting = server.say("never heard")
    await_event(events, "started", first)
    check(server.ask("POST", "/v1/sessions/head/stop")[0] == 200, "stop")
    for number in first, waiting:
        await_event(events, "interrupted", number)
    last = server.say("again")
    await_event(events, "ended", last)
    told = [(k, e["id"]) for k, e in events_of(events) if k not in ("queued", "started")]
    check(told == [("interrupted", first), ("interrupted", waiting), ("ended", last)], f"{events_of(events)}")
    events.close()


def test_changes(server):
    with open("clip/bc.jpg", "rb") as file:
        picture = file.read()
    rows = [("pose", b'{"hold": true}', "application/json", 200), ("pose", b'{"hold": false}', "application/json", 200),
            ("pose", b'{"eyes": 7}', "application/json", 400), ("pose", b'{"eyes": "x"}', "application/json", 400),
            ("pose", b"[1]", "application/json", 400), ("pose", b"", None, 400),
            ("background", b'{"colour": "white"}', "application/json", 200),
            ("background", b'{"colour": "/etc/passwd"}', "application/json", 400),
            ("background", picture, "image/jpeg", 200), ("background", picture[:500], "image/jpeg", 422),
            ("background", b"#!/bin/sh", "image/png", 422), ("background", b'{"colour": "clip"}', "application/json", 200)]
    for path, body, kind, expected in rows:
        status, answer = server.ask("POST", f"/v1/sessions/head/{path}", body, kind=kind)
        check(status == expected and ("error" in answer) == (expected != 200), f"{path} {body[:40]}: {status} {answer}")


def test_refused(server):
    rows = [("GET", "/v1/sessions/none/stream", None, None, 404), ("GET", "/v1/sessions/head/say", None, None, 405),
            ("GET", "/nothing", None, None, 404), ("GET", "/../etc/passwd", None, None, 404),
            ("GET", "/v1/sessions/..%2fhead/stream", None, None, 404), ("PUT", "/state", b"x", "text/plain", 405),
            ("POST", "/v1/sessions/head/say", b"x", "text/html", 415), ("POST", "/v1/sessions/head/say", b"x", None, 415),
            ("POST", "/v1/sessions/head/say", b"", "text/plain", 400), ("POST", "/v1/sessions/head/say", b" \n", "text/plain", 400),
            ("POST", "/v1/sessions/head/say", b"a\0b", "text/plain", 400), ("POST", "/v1/sessions/head/say", b"\xff", "text/plain", 400),
            ("POST", "/v1/sessions/head/say", b'{"text": 3}', "application/json", 400),
            ("POST", "/v1/sessions/head/say", b'{"text": "a"', "application/json", 400),
            ("POST", "/v1/sessions/head/say", b"x" * 20000, "text/plain", 413),
            ("POST", "/v1/sessions/head/say?format=mp9", b"x", "audio/raw", 400),
            ("POST", "/v1/sessions/head/say?format=s16le&rate=-3", b"x", "audio/raw", 400)]
    for method, path, body, kind, expected in rows:
        status, answer = server.ask(method, path, body, kind=kind)
        check(status == expected and "error" in answer, f"{method} {path} {body!r:.40}: {status} {answer}")


def make_files():
    shutil.rmtree(FOLDER, ignore_errors=True)
    os.makedirs(FOLDER)
    os.chdir(FOLDER)
    shutil.copytree(os.path.join(CLIPS, "short"), "clip")
    subprocess.run([ERNERF, "train", "clip", "-o", "head.safetensors", "--iters", "8", "--rays", "256", "--levels", "2",
                    "--validate-frames", "1", "--asr-model", "cepstra", "--quiet"], check=True)
    with open("tts", "w") as file:
        file.write("#!/bin/sh\ncat > said.txt\nexec cat clip/aud.wav\n")
    os.chmod("tts", 0o700)


BASE = ["head.safetensors", "--clip", "clip", "--size", "32x32", "--tts", "./tts"]


def main():
    make_files()
    with Server(*BASE) as server:
        for test in test_watch_and_say, test_stop, test_changes, test_refused:
            test(server)
    check(not [name for name in os.listdir(os.environ.get("TMPDIR", "/tmp")) if name.startswith("ernerf-serve-")], "a picture is left")
    print("serve: viewers, text, sound, events, changes, refusals")


main()
