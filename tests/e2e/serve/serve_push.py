#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""ernerf serve --push: one stream to UDP, RTMP and SRT, a recording and viewers at the same time; addresses that fail.
Usage: serve_push.py ERNERF FOLDER CLIPS"""
import os
import socket
import struct
import subprocess
import sys
import threading

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
from serve import BASE, ERNERF, PATIENCE, Reader, Server, Stream, boxes, check, check_stream, make_files, until


class Udp(threading.Thread):
    """Counts what comes as MPEG-TS."""

    def __init__(self):
        super().__init__(daemon=True)
        self.line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.line.bind(("127.0.0.1", 0))
        self.port = self.line.getsockname()[1]
        self.packets = {}
        self.text = b""
        self.start()

    def run(self):
        while True:
            data = self.line.recv(65536)
            for at in range(0, len(data), 188):
                check(data[at] == 0x47, "UDP: no MPEG-TS")
                track = struct.unpack(">H", data[at + 1 : at + 3])[0] & 0x1FFF
                self.packets[track] = self.packets.get(track, 0) + 1


class Rtmp(threading.Thread):
    """An RTMP server for one publisher: counts messages of sound (8) and pictures (9), and keeps the first of each."""

    def __init__(self, port=0):
        super().__init__(daemon=True)
        self.listener = socket.create_server(("127.0.0.1", port))
        self.port = self.listener.getsockname()[1]
        self.count, self.first, self.commands = {}, {}, []
        self.start()

    def close(self):
        """Ends the connection and the server, as one that is restarted."""
        self.listener.close()
        self.line.shutdown(socket.SHUT_RDWR)

    def take(self, count):
        data = b""
        while len(data) < count:
            more = self.line.recv(count - len(data))
            if not more:
                raise ConnectionError
            data += more
        return data

    def tell(self, kind, body, stream=0):
        head = struct.pack(">B", 3) + b"\0\0\0" + struct.pack(">I", len(body))[1:] + bytes([kind]) + struct.pack("<I", stream)
        pieces = [body[k : k + 128] for k in range(0, len(body), 128)]
        self.line.sendall(head + b"\xc3".join(pieces))

    def answer(self, body):
        """A command in AMF0: its name, and the number of the transaction."""
        name = body[3 : 3 + struct.unpack(">H", body[1:3])[0]].decode()
        text = lambda t: struct.pack(">BH", 2, len(t)) + t.encode()
        number = body[3 + len(name) : 12 + len(name)]
        self.commands.append(name)
        if name == "connect":
            self.tell(20, text("_result") + number + b"\x05\x05")
        elif name == "createStream":
            self.tell(20, text("_result") + number + b"\x05" + struct.pack(">Bd", 0, 1))
        elif name == "publish":
            code = b"\x03" + struct.pack(">H", 4) + b"code" + text("NetStream.Publish.Start") + b"\0\0\x09"
            self.tell(20, text("onStatus") + struct.pack(">Bd", 0, 0) + b"\x05" + code, 1)

    def messages(self):
        size, known = 128, {}
        while True:
            first = self.take(1)[0]
            track, form = first & 63, first >> 6
            check(track >= 2, "RTMP: a long number of a chunk stream")
            old = known.setdefault(track, {"length": 0, "kind": 0, "body": b""})
            head = self.take((11, 7, 3, 0)[form])
            if form < 3 and head[:3] == b"\xff\xff\xff":
                self.take(4)
            if form < 2:
                old["length"], old["kind"] = struct.unpack(">I", b"\0" + head[3:6])[0], head[6]
            old["body"] += self.take(min(size, old["length"] - len(old["body"])))
            if len(old["body"]) < old["length"]:
                continue
            body, old["body"] = old["body"], b""
            if old["kind"] == 1:
                size = struct.unpack(">I", body)[0]
            yield old["kind"], body

    def run(self):
        try:
            self.line, _ = self.listener.accept()
            hello = self.take(1537)
            self.line.sendall(b"\x03" + bytes(1536) + hello[1:])
            self.take(1536)
            for kind, body in self.messages():
                self.count[kind] = self.count.get(kind, 0) + 1
                self.first.setdefault(kind, body)
                if kind == 20:
                    self.answer(body)
        except OSError:
            pass


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as line:
        line.bind(("127.0.0.1", 0))
        return line.getsockname()[1]


def listen_srt(port):
    """Another live portrait, whose sound comes by SRT: 1 s of it."""
    return subprocess.Popen([ERNERF, "live", "head.safetensors", "--audio", f"srt://127.0.0.1:{port}?mode=listener", "--clip", "clip", "--size", "32x32", "-o", "heard.y4m", "--duration", "1", "--quiet", "-y"])


def check_recording():
    names = os.listdir("recorded")
    check(len(names) == 1, f"{names}")
    with open(os.path.join("recorded", names[0]), "rb") as file:
        data = file.read()
    check(len([1 for kind, _ in boxes(data) if kind == "moof"]) > 50, "the recording has few fragments")


def pushes(server):
    return {push["to"]: push for push in server.state()["pushes"]}


def test_all_at_once():
    udp, rtmp, srt_port = Udp(), Rtmp(), free_port(socket.SOCK_DGRAM)
    urls = {"udp": f"udp://127.0.0.1:{udp.port}", "rtmp": f"rtmp://127.0.0.1:{rtmp.port}/live/secret", "srt": f"srt://127.0.0.1:{srt_port}?latency=20000"}
    dead = f"rtmp://user:secret@127.0.0.1:{free_port(socket.SOCK_STREAM)}/live/key"
    os.mkdir("recorded")
    words = [word for url in [*urls.values(), dead] for word in ("--push", url)]
    shown = f"rtmp://127.0.0.1:{rtmp.port}/..."
    with Server(*BASE, "--quality", "draft", "--record", "recorded", *words) as server:
        viewer = Reader(server, "/v1/sessions/head/stream")
        until(lambda: rtmp.count.get(9, 0) > 20 and rtmp.count.get(8, 0) > 20, "pictures and sound by RTMP")
        until(lambda: len([k for k, n in udp.packets.items() if n > 20]) >= 2, "two tracks by UDP")
        check(rtmp.first[9][:2] == b"\x17\0" and b"avcC" not in rtmp.first[9] and rtmp.first[8][:2] == b"\xaf\0", f"{rtmp.first[9][:8]} {rtmp.first[8][:8]}")
        until(lambda: pushes(server)[shown]["connected"], "the push in the state")
        state = pushes(server)
        check("secret" not in str(state) and len(state) == 4, f"{state}")
        failed = [push for push in state.values() if push["to"].startswith("rtmp") and push["to"] != shown][0]
        check(not failed["connected"] and failed["failures"] >= 1 and "connect" in failed["error"], f"{failed}")
        listener = listen_srt(srt_port)
        rtmp.close()
        until(lambda: not pushes(server)[shown]["connected"], "the end of the push by RTMP")
        again = Rtmp(rtmp.port)
        until(lambda: again.count.get(9, 0) > 20 and again.first[9][:2] == b"\x17\0", "the push by RTMP once more")
        check(listener.wait(PATIENCE) == 0 and os.path.getsize("heard.y4m") > 25 * 1500, "sound by SRT")
        check(not viewer.ended, "the viewer was stopped")
        viewer.close()
        check_stream(Stream(viewer), "the viewer")
    text = server.text()
    check(text.count("--push") >= 2 and "secret" not in text and "tried again" in text, f"warnings: {text}")
    check_recording()


def test_words():
    for url in "http://127.0.0.1/x", "out.flv", "rtmp://", "file:x.flv":
        done = subprocess.run([ERNERF, "serve", *BASE, "--port", "0", "--duration", "0.1", "--push", url], stderr=subprocess.PIPE, text=True, timeout=PATIENCE)
        check(done.returncode == 2 and "--push" in done.stderr, f"{url}: {done.returncode} {done.stderr}")


make_files()
test_all_at_once()
test_words()
print("serve_push: UDP, RTMP, SRT, a recording and a viewer of one stream; addresses that fail and come back")
