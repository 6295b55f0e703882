#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""ernerf serve: viewers of one coded stream, text and sound to say, events, who may ask, and what hostile clients do.
With ERNERF_TEST_LONG more of it. Usage: serve.py ERNERF FOLDER CLIPS (of shared_clips.sh)"""
import hashlib
import http.client
import json
import os
import re
import resource
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

    def __init__(self, *words, token=None):
        self.token = token
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
        fields = {"Authorization": "Bearer " + self.token} if self.token else {}
        sessions = self.ask("GET", "/state", None, fields)[1]["sessions"]
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
            ("POST", "/v1/sessions/head/say", b'{"text": "a", "voice": "de"}', "application/json", 400),
            ("POST", "/v1/sessions/head/background", b'{"colour": "white", "x": 1}', "application/json", 400),
            ("POST", "/v1/sessions", b'{"portrait": "head", "id": "x", "size": 8}', "application/json", 400),
            ("POST", "/v1/sessions/head/say", b"x" * 20000, "text/plain", 413), ("PATCH", "/v1/sessions/head/whep/" + "0" * 32, b"", None, 405),
            ("POST", "/v1/sessions/head/whep", b"", "application/sdp", 400), ("POST", "/v1/sessions/head/whep", b"x" * 70000, "application/sdp", 413),
            ("POST", "/v1/sessions/head/say?format=mp9", b"x", "audio/raw", 400),
            ("POST", "/v1/sessions/head/say?format=s16le&rate=-3", b"x", "audio/raw", 400),
            ("POST", "/v1/sessions/head/say?rate=8000", b"x", "audio/wav", 400)]
    for method, path, body, kind, expected in rows:
        status, answer = server.ask(method, path, body, kind=kind)
        check(status == expected and "error" in answer, f"{method} {path} {body!r:.40}: {status} {answer}")


def test_described(server):
    """openapi.json has every path and method that the server has, and no other; the page may not be embedded."""
    described = {(path, method.upper()) for path, item in server.ask("GET", "/openapi.json")[1]["paths"].items()
                 for method in item if method in ("get", "post", "put", "delete")}
    with open(os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../src/serve/routes.c")) as file:
        routes = re.findall(r'^ *\{"([A-Z]+)", "(/[^"]*)"', file.read(), re.MULTILINE)
    there = {(re.sub(r"\b(ID|KEY)\b", r"{\1}", path), method) for method, path in routes}
    check(len(there) >= 10 and described == there, f"openapi.json: {described ^ there}")
    status, page = server.ask("GET", "/")
    check(status == 200 and b"<video" in page and "frame-ancestors 'self'" in server.fields["Content-Security-Policy"], "page")
    check(server.fields["Cross-Origin-Resource-Policy"] == "same-origin", "the page's policy")
    text = server.ask("GET", "/metrics")[1].decode()
    rows = dict(re.findall(r"^(\w+(?:\{[^}]*\})?) (\S+)$", text, re.MULTILINE))
    check(float(rows['ernerf_session_drawn_total{session="head"}']) > 0 and float(rows["ernerf_requests_total"]) > 10, text)
    check(all(re.fullmatch(r"# TYPE \w+ (counter|gauge)|\w+(\{session=\"head\"\})? -?[0-9.e+-]+", row) for row in text.splitlines()), text)


def test_pieces(server):
    """A sound in several requests with one key is one utterance, heard before its last piece; a stop ends it."""
    events = Reader(server, "/v1/sessions/head/events")
    until(lambda: b":" in events.body(), "the events' first line")
    tone = b"".join(struct.pack("<h", (i * i) % 8000) for i in range(3200))  # 0.2 s
    path = "/v1/sessions/head/say?format=s16le&stream="
    send = lambda key, more="": server.ask("POST", path + key + more, tone, kind="audio/raw")
    number = send("a")[1]["id"]
    for _ in range(3):
        check(send("a")[1]["id"] == number, "a piece is another utterance")
    await_event(events, "started", number)
    check(send("a", "&end=1")[1]["id"] == number, "the last piece")
    ended = await_event(events, "ended", number)
    check(abs(ended["seconds"] - await_event(events, "started", number)["seconds"] - 1) < 0.3, f"five pieces of 0.2 s: {ended}")
    check(send("a")[0] == 409, "a piece after the last one")
    number = send("b")[1]["id"]
    await_event(events, "started", number)
    server.ask("POST", "/v1/sessions/head/stop")
    await_event(events, "interrupted", number)
    until(lambda: send("b")[0] == 409, "a piece after a stop is refused")
    number = send("c")[1]["id"]  # its page is closed: it ends by itself
    await_event(events, "ended", number)
    long = lambda: server.ask("POST", "/v1/sessions/head/say?format=s16le", 37 * tone, kind="audio/raw")
    threading.Thread(target=long, daemon=True).start()
    time.sleep(0.3)
    began = time.monotonic()
    status, answer = server.ask("POST", path + "d", 11 * tone, kind="audio/raw")
    check(status == 202 and time.monotonic() - began > 3.5, "a piece waits for the sound before it")
    check(send("x", "&end=1&rate=7")[0] == 400, "a piece that is refused")
    check(send("d", "&end=1")[1].get("id") == answer["id"], "a piece after one that waited")
    server.ask("POST", "/v1/sessions/head/stop")
    await_event(events, "interrupted", answer["id"])
    events.close()


def test_speech_fails(server):
    """A program that is killed fails its utterance alone."""
    events = Reader(server, "/v1/sessions/head/events")
    until(lambda: b":" in events.body(), "the events' first line")
    with open("clip/aud.wav", "rb") as file:
        status, answer = server.ask("POST", "/v1/sessions/head/say", file.read()[:20001], kind="audio/wav")
    check("cut short" in await_event(events, "failed", answer["id"])["reason"], "a sound that is cut")
    await_event(events, "started", answer["id"])
    number = server.say("hang")
    until(lambda: os.path.exists("pid.txt"), "the program's number")
    with open("pid.txt") as file:
        os.kill(int(file.read()), signal.SIGKILL)
    check("reason" in await_event(events, "failed", number), "a reason")
    await_event(events, "ended", server.say("hello"))
    status, answer = server.ask("POST", "/v1/sessions/head/say", b"no sound at all " * 100, kind="audio/wav")
    check("no sound" in await_event(events, "failed", answer["id"])["reason"], "what is no sound")
    events.close()


# ---- hostile clients ------------------------------------------------------------------------------------------------


def raw(server, request, wait=True):
    """The first bytes of the answer to raw bytes; b"": none."""
    with socket.create_connection(("127.0.0.1", server.port), timeout=5) as line:
        try:
            line.sendall(request)
            return line.recv(4096) if wait else b""
        except OSError:
            return b""


def used(server):
    """Open files and memory in KB of the server."""
    pid = server.process.pid
    with open(f"/proc/{pid}/status") as file:
        return len(os.listdir(f"/proc/{pid}/fd")), int(re.search(r"VmRSS:\s*(\d+)", file.read())[1])


def requests(count, seed=1):
    """Requests of which something is wrong; the seed is that of a small generator of our own."""
    state = seed

    def draw(most):
        nonlocal state
        state = (state * 6364136223846793005 + 1442695040888963407) % 2**64
        return (state >> 33) % most

    noise = lambda most: bytes(draw(256) for _ in range(draw(most)))
    paths = [b"/", b"/state", b"/metrics", b"/v1/sessions/head/say", b"/v1/sessions/head/pose", b"/v1/sessions/head/stop",
             b"/v1/sessions/head/background", b"/v1/sessions/%00/say", b"/" + b"a" * 9000, b"http://evil/", b"*", b"/v1/../.."]
    kinds = [b"text/plain", b"application/json", b"audio/wav", b"image/png", b"audio/" + b"x" * 300, b"application/octet-stream"]
    lengths = [b"Content-Length: -1", b"Content-Length: 99999999999999999999", b"Content-Length: 5", b"Content-Length: x",
               b"Transfer-Encoding: chunked", b"Transfer-Encoding: gzip", b"Content-Length: 3\r\nContent-Length: 7",
               b"Expect: 100-continue\r\nContent-Length: 10"]
    for _ in range(count):
        method = [b"GET", b"POST", b"PUT", b"DELETE", b"HEAD", b"OPTIONS", b"X" * 300, noise(9)][draw(8)]
        fields = [b"Host: localhost", b"Content-Type: " + kinds[draw(len(kinds))], lengths[draw(len(lengths))],
                  b"Authorization: " + noise(40).hex().encode(), b"X: " + b"y" * draw(2) * 40000, b"Range: bytes=0-", b"Last-Event-ID: 99999999999999999999"]
        head = method + b" " + paths[draw(len(paths))] + b"?" + noise(6).hex().encode() + b" HTTP/1.1\r\n" + b"\r\n".join(f for f in fields if draw(3)) + b"\r\n\r\n"
        body = [b"", noise(300), b"{" * 2000, b"ffffffff\r\n" + noise(50), b'{"text": "' + noise(20) + b'"}', b"3\r\nabc\r\n0\r\n\r\n"][draw(6)]
        whole = head + body
        if draw(4) == 0:
            whole = whole[: draw(len(whole) + 1)]
        if draw(4) == 0:
            at = draw(len(whole) + 1)
            whole = whole[:at] + noise(8) + whole[at + draw(8) :]
        yield whole


def test_hostile(server):
    """Requests that are wrong, stand still or leave neither stop the viewers nor stay."""
    viewer = Reader(server, "/v1/sessions/head/stream")
    until(lambda: b"moof" in viewer.bytes, "a fragment")
    base = used(server)
    still = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(20)]
    for line in still[5:]:
        line.sendall(b"POST /v1/sessions/head/say HTTP/1.1\r\nHost: localhost\r\n")
    for line in still[10:]:
        line.sendall(b"Content-Type: text/plain\r\nContent-Length: 100\r\n\r\nabc")
    check(raw(server, b"GET / HTTP/1.1\r\nHost: localhost\r\nX: " + b"x" * 100000 + b"\r\n\r\n").startswith(b"HTTP/1.1 431"), "a long head")
    check(raw(server, b"GET /state HTTP/1.1\r\n\r\n").startswith(b"HTTP/1.1 400"), "no Host")
    check(raw(server, b"GET /state HTTP/1.1\r\nHost: a\r\nHost: localhost\r\n\r\n").startswith(b"HTTP/1.1 400"), "two Hosts")
    for k, request in enumerate(requests(20000 if LONG else 1000)):
        raw(server, request, wait=k % 4 == 0 and request.startswith(b"GET /state"))
    for _ in range(1000 if LONG else 100):  # who watch for a moment
        raw(server, b"GET /v1/sessions/head/stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
    for line in still[:5]:
        line.setblocking(True)
        line.settimeout(PATIENCE)
    for line in still:
        line.settimeout(PATIENCE)
        try:
            check(line.recv(4096) == b"", "who stands still gets an answer")
        except ConnectionError:
            pass
        line.close()
    server.ask("POST", "/v1/sessions/head/stop")  # texts of the requests that were right
    until(lambda: server.state()["viewers"] == 1, "all have left but one")
    until(lambda: used(server)[0] <= base[0] + 2, f"open files: {base[0]} before, {used(server)[0]} after")
    check(used(server)[1] < base[1] + 20000, f"memory: {base[1]} KB before, {used(server)[1]} KB after")
    check(not viewer.ended, "the viewer was stopped")
    viewer.close()
    check_stream(Stream(viewer), "the viewer")


def test_slow_viewer():
    """One who takes nothing is left, when what the system holds for it is full; another goes on."""
    with Server("head.safetensors", "--clip", "clip", "--size", "160x160", "--crf", "1") as server:
        slow = socket.socket()
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.connect(("127.0.0.1", server.port))
        slow.sendall(b"GET /v1/sessions/head/stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
        viewer = Reader(server, "/v1/sessions/head/stream")
        until(lambda: server.state()["viewers"] == 2, "two viewers")
        until(lambda: server.state()["viewers"] == 1, "the end of the slow one", 120)
        count = viewer.bytes.count(b"moof")
        until(lambda: viewer.bytes.count(b"moof") > count + 50, "what the other one sees")
        check(not viewer.ended, "the other viewer was stopped")
        viewer.close()
        slow.close()


def test_who_may():
    """Tokens, Host, Origin and pages of others, in each of which one thing is wrong."""
    say, watch = "s" * 40, "w" * 40
    for name, token in ("say", say), ("watch", watch):
        with open(name, "w") as file:
            file.write(token + "\n")
    words = ["--say-token", "say", "--watch-token", "watch", "--allow-origin", "https://www.example.org", "--host", "portrait.example.org"]
    bearer = lambda token: {"Authorization": "Bearer " + token}
    with Server(*BASE, *words, token=say) as server:
        own = {"Host": "portrait.example.org", "Origin": "https://portrait.example.org"}
        rows = [("GET", "/", {}, 200), ("GET", "/state", {}, 401), ("GET", "/state", bearer("w" * 39), 401),
                ("GET", "/state", bearer("w" * 39 + "x"), 401), ("GET", "/state", bearer(""), 401), ("GET", "/state", bearer(watch), 200),
                ("GET", "/state?token=" + watch, {}, 200), ("GET", "/state?token=x", bearer(watch), 200), ("GET", "/state", bearer(say), 200),
                ("GET", "/metrics", {}, 401), ("GET", "/v1/sessions/head/stream", {}, 401), ("GET", "/v1/sessions/head/events", {}, 401),
                ("GET", "/v1/sessions/none/stream", {}, 401), ("POST", "/v1/sessions/head/whep", bearer("x"), 401),
                ("DELETE", "/v1/sessions/head/whep/" + "0" * 32, {}, 401), ("POST", "/v1/sessions/head/whep", bearer(watch), 415),
                ("POST", "/v1/sessions/head/stop", bearer(watch), 401),
                ("POST", "/v1/sessions/head/say", {}, 401), ("POST", "/v1/sessions/head/stop", bearer(say), 200),
                ("GET", "/state", {"Host": "evil.example", **bearer(watch)}, 403), ("GET", "/state", {"Host": "[::1]:80", **bearer(watch)}, 200),
                ("GET", "/state", {"Host": "[::1].evil.example", **bearer(watch)}, 403), ("GET", "/state", {"Host": "localhost:x", **bearer(watch)}, 403), ("GET", "/state", {**own, **bearer(watch)}, 200),
                ("GET", "/state", {"Origin": "http://evil.example", **bearer(watch)}, 403), ("GET", "/state", {"Origin": "null", **bearer(watch)}, 403),
                ("GET", "/state", {"Origin": "https://www.example.org.evil.example", **bearer(watch)}, 403),
                ("GET", "/state", {"Origin": "https://www.example.org", "Sec-Fetch-Site": "cross-site", **bearer(watch)}, 200),
                ("GET", "/state", {"Sec-Fetch-Site": "cross-site", **bearer(watch)}, 403), ("GET", "/", {"Sec-Fetch-Site": "cross-site"}, 200),
                ("POST", "/v1/sessions/head/stop", {"Origin": "http://evil.example", **bearer(say)}, 403)]
        for method, path, fields, expected in rows:
            status, answer = server.ask(method, path, None, fields)
            check(status == expected, f"{method} {path} {fields}: {status} {answer}")
            allowed = server.fields.get("Access-Control-Allow-Origin")
            check(allowed == (fields.get("Origin") if fields.get("Origin") == "https://www.example.org" else None), f"{fields}: {allowed}")
        status, _ = server.ask("OPTIONS", "/v1/sessions/head/say", None, {"Origin": "https://www.example.org"})
        check(status == 200 and "Authorization" in server.fields["Access-Control-Allow-Headers"], "preflight")
        check(server.ask("OPTIONS", "/v1/sessions/head/say", None, {"Origin": "http://evil.example"})[0] == 403, "preflight of another")
        with open(f"/proc/{server.process.pid}/cmdline") as file:
            check(say not in file.read(), "a list of processes shows the token")


def test_sessions():
    """Two portraits, one of them over a recorded video, and recordings of both, one of which finds the disk full."""
    for name in "one", "two":
        shutil.copytree(os.path.join(CLIPS, "recorded"), name)
        shutil.copy(os.path.join(CLIPS, "recorded_head.safetensors"), name + ".safetensors")
    video = os.path.join(CLIPS, "recorded.mp4")
    with open(video, "rb") as file:
        hash_ = hashlib.sha256(file.read()).hexdigest()
    with open("one/prepare.json", "w") as file:
        steps = {step: {"verdict": "good", "words": ""} for step in ("face", "pose", "landmarks", "layers", "eyes", "features")}
        json.dump({"version": 2, "video": "recorded.mp4", "source": {"bytes": os.path.getsize(video), "from": 0}, "frames": 16,
                   "steps": steps, "crop": {"x": 0, "y": 0, "width": 96, "side": 96, "sha256": hash_}}, file)
    os.mkdir("recorded")
    with Server("one.safetensors", "--video", video, "--name", "filmed", "--tts", "./tts", "--record", "recorded") as server:
        status, answer = server.ask("POST", "/v1/sessions/filmed/background", b'{"colour": "white"}', kind="application/json")
        check(status == 422 and "recorded frames" in answer["error"], f"{status} {answer}")
        events, viewer = (Reader(server, f"/v1/sessions/filmed/{name}") for name in ("events", "stream"))
        until(lambda: b":" in events.body(), "the events' first line")
        status, answer = server.ask("POST", "/v1/sessions/filmed/say", b"hello", kind="text/plain")
        await_event(events, "ended", answer["id"])
        viewer.close()
        check_stream(Stream(viewer), "a recorded video")
        ask = lambda: server.ask("POST", "/v1/sessions", b'{"portrait": "filmed", "id": "short"}', kind="application/json")
        for _ in range(4):  # in a second or two
            check(ask()[0] == 200, "a further session")
            until(lambda: any(session["written"] > 1 for session in server.ask("GET", "/state")[1]["sessions"] if session["id"] == "short"), "frames")
            check(server.ask("DELETE", "/v1/sessions/short")[0] == 200, "its end")
    names = sorted(os.listdir("recorded"))
    check(len(names) == 5 and all(re.fullmatch(r"short-\d{8}T\d{6}Z(-\d)?\.mp4", name) for name in names[1:]), f"{names}")
    for name in names[1:]:
        os.remove(os.path.join("recorded", name))
    names = names[:1]
    check( re.fullmatch(r"filmed-\d{8}T\d{6}Z\.mp4", names[0]), f"{names}")
    with open(os.path.join("recorded", names[0]), "rb") as file:
        data = file.read()
    kinds = [kind for kind, _ in boxes(data)]
    check(kinds.count("moof") > 30 and "mfra" not in kinds, "the recording has few fragments, or a table of them, which grows in memory")
    limit = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))
    words = [ERNERF, "serve", "one.safetensors", "two.safetensors", "--port", "0", "--record", "recorded", "--duration", "4"]
    done = subprocess.run(words, stderr=subprocess.PIPE, text=True, timeout=PATIENCE, preexec_fn=limit)
    check(done.returncode == 0 and done.stderr.count("it is cut") == 2, f"a full disk: {done.returncode} {done.stderr}")
    for name in os.listdir("recorded"):
        with open(os.path.join("recorded", name), "rb") as file:
            data = file.read()
        check(name.endswith(".mp4") and sum(8 + len(part) for _, part in boxes(data)) == len(data) > 5000, f"{name}: {len(data)} bytes")


def test_further_sessions(server):
    """A second session of a portrait, which shares its model and settings; as many as the machine can do; its end."""
    ask = lambda id_, portrait="head": server.ask("POST", "/v1/sessions", json.dumps({"portrait": portrait, "id": id_}), kind="application/json")
    for id_, portrait, expected in ("a/b", "head", 400), ("..", "head", 400), ("x", "none", 422), ("head", "head", 422), (3, "head", 400):
        status, answer = ask(id_, portrait)
        check(status == expected and "error" in answer, f"{id_} {portrait}: {status} {answer}")
    check(ask("second")[0] == 200, "a second session")
    ids = lambda: [session["id"] for session in server.ask("GET", "/state")[1]["sessions"]]
    until(lambda: ids() == ["head", "second"], "the second session")
    viewers = [Reader(server, f"/v1/sessions/{id_}/stream") for id_ in ("head", "second")]
    status, answer = server.ask("POST", "/v1/sessions/second/say", b"hello", kind="text/plain")
    check(status == 202 and answer["id"] == 1, f"{answer}")
    until(lambda: server.ask("GET", "/state")[1]["sessions"][1]["speaking"], "the second session's speech")
    text = server.ask("GET", "/metrics")[1].decode()
    check('ernerf_session_speaking{session="second"} 1' in text and "null" not in text, text)
    until(lambda: all(viewer.bytes.count(b"moof") > 10 for viewer in viewers), "their pictures")
    made = ["head", "second"]
    for k in range(40 if LONG else 1):
        status, answer = ask(f"more{k}")
        if status != 200:
            break
        made.append(f"more{k}")
    until(lambda: ids() == made, "the further sessions")
    check(status == 503 or (not LONG and status == 200), f"{k} further sessions: {status} {answer}")
    check(server.ask("DELETE", "/v1/sessions/none")[0] == 404, "an end of none")
    for id_ in made[1:]:
        check(server.ask("DELETE", f"/v1/sessions/{id_}")[0] == 200, f"the end of {id_}")
    check(ids() == ["head"], f"{ids()}")
    until(lambda: viewers[1].ended, "the end of its stream")
    check(not viewers[0].ended, "the first session's stream has ended")
    for viewer in viewers:
        viewer.close()
        check_stream(Stream(viewer), "a session's viewer")


def test_words():
    """What cannot be served is refused before anything is opened."""
    with open("short", "w") as file:
        file.write("abc\n")
    with open("zero", "w") as file:
        file.write(32 * "a" + "\0" + 32 * "b" + "\n")
    rows = [(["--listen", "0.0.0.0"], 2, "--say-token and --watch-token"), (["--say-token", "short"], 1, "is no token"),
            (["--watch-token", "zero"], 1, "is no token"),
            (["--say-token", "gone"], 1, "gone: cannot be read"), (["--name", "../x"], 2, '--name is "../x"'),
            (["--viewers", "300"], 2, "--connections is 256"), (["--stun", "example.org"], 2, "expected stun://HOST:PORT"),
            (["--stun", "stun://example.org:3478/x"], 2, "expected stun://HOST:PORT"),
            *((["--udp-ports", ports], 2, f'--udp-ports is "{ports}"') for ports in ("5", "7-5", "0-5", "1-65536", " 1-2", "1-2-3", "1-x")),
            (["--voice", "de"], 2, "is espeak-ng's"), (["--listen", "127.0.0.300"], 1, "127.0.0.300"), (["--frames", "0:3"], 2, "video"),
            (["--json", "x.json"], 2, "--json has nothing"), (["-y"], 2, "changes nothing")]
    for words, expected, what in rows:
        done = subprocess.run([ERNERF, "serve", *BASE, "--port", "0", "--duration", "0.1", *words], stderr=subprocess.PIPE, text=True, timeout=PATIENCE)
        check(done.returncode == expected and what in done.stderr, f"{words}: {done.returncode} {done.stderr}")
    for hard, expected in (300, 1), (600, 0):  # 256 connections and 256 other files
        limit = lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (60, hard))
        done = subprocess.run([ERNERF, "serve", *BASE, "--port", "0", "--duration", "0.1"], stderr=subprocess.PIPE, text=True, timeout=PATIENCE, preexec_fn=limit)
        check(done.returncode == expected and ("allows 300 open files" in done.stderr) == (expected == 1), f"{hard} files: {done.stderr}")
    done = subprocess.run([ERNERF, "serve", *BASE, "--port", "0", "--duration", "0.1", "--listen", "::1"], stderr=subprocess.PIPE, text=True, timeout=PATIENCE)
    check("http://[::1]:" in done.stderr or "cannot listen" in done.stderr, f"IPv6: {done.stderr}")
    server = Server(*BASE, "--duration", "3").__enter__()  # which a session that has ended does not prolong
    check(server.ask("DELETE", "/v1/sessions/head")[0] == 200 and server.process.wait(PATIENCE) == 0, "--duration")
    with Server(*BASE) as server:
        done = subprocess.run([ERNERF, "serve", *BASE, "--port", str(server.port)], stderr=subprocess.PIPE, text=True, timeout=PATIENCE)
        check(done.returncode == 1 and "cannot listen" in done.stderr, f"a port that is taken: {done.stderr}")


def make_files():
    shutil.rmtree(FOLDER, ignore_errors=True)
    os.makedirs(FOLDER)
    os.chdir(FOLDER)
    shutil.copytree(os.path.join(CLIPS, "short"), "clip")
    subprocess.run([ERNERF, "train", "clip", "-o", "head.safetensors", "--iters", "8", "--rays", "256", "--levels", "2",
                    "--validate-frames", "1", "--asr-model", "cepstra", "--quiet"], check=True)
    with open("tts", "w") as file:
        file.write('#!/bin/sh\n[ "$1" = -q ] && [ "$2" = "a b" ] || [ $# = 0 ] || exit 5\n'
                   "cat > said.txt\n[ $(cat said.txt) = hang ] && echo $$ > pid.tmp && mv pid.tmp pid.txt && exec sleep 600\n"
                   "exec cat clip/aud.wav\n")
    os.chmod("tts", 0o700)


BASE = ["head.safetensors", "--clip", "clip", "--size", "32x32", "--tts", "./tts", "--tts-argument=-q", "--tts-argument", "a b"]


def main():
    make_files()
    with Server(*BASE) as server:
        for test in test_watch_and_say, test_stop, test_pieces, test_speech_fails, test_changes, test_refused, test_described, test_further_sessions, test_hostile:
            began = time.monotonic()
            test(server)
            print(f"{test.__name__}: {time.monotonic() - began:.1f} s", flush=True)
    test_who_may()
    test_words()
    test_sessions()
    if LONG:
        test_slow_viewer()
    check(not [name for name in os.listdir(os.environ.get("TMPDIR", "/tmp")) if name.startswith("ernerf-serve-")], "a picture is left")
    print("serve: viewers, text, sound, events, changes, refusals, hostile clients, tokens and origins")


if __name__ == "__main__":
    main()
