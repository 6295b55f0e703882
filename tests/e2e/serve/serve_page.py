#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""The page of ernerf serve in headless Chromium: it plays by WebRTC and as mp4, says a text, passes on the microphone.
Skips without Chromium. Usage: serve_page.py ERNERF FOLDER CLIPS"""
import base64
import json
import os
import shutil
import socket
import struct
import subprocess
import sys
import time
import urllib.request

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
from serve import BASE, FOLDER, PATIENCE, Server, check, make_files, until

# The mean of the picture's luma, and how much it differs within it.
LOOK = """(() => { const v = document.getElementById('video'), c = document.createElement('canvas');
  c.width = c.height = 32; const g = c.getContext('2d'); g.drawImage(v, 0, 0, 32, 32);
  const p = [...g.getImageData(0, 0, 32, 32).data].filter((x, i) => i % 4 === 1), m = p.reduce((a, b) => a + b) / p.length;
  return {frames: v.getVideoPlaybackQuality().totalVideoFrames, width: v.videoWidth, paused: v.paused, object: !!v.srcObject,
    spread: Math.sqrt(p.reduce((a, b) => a + (b - m) ** 2, 0) / p.length), failed: document.getElementById('failed').textContent,
    events: document.getElementById('events').textContent, sessions: document.getElementById('session').length}; })()"""


class Browser:
    """A page of Chromium, over the DevTools protocol."""

    def __init__(self, program, *more):
        profile = os.path.join(FOLDER, "profile")
        words = ["--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0", "--autoplay-policy=no-user-gesture-required",
                 "--use-fake-ui-for-media-stream", "--use-fake-device-for-media-stream", f"--user-data-dir={profile}", *more, "about:blank"]
        self.process = subprocess.Popen([program, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        port = until(lambda: self.read(os.path.join(profile, "DevToolsActivePort")), "Chromium's port").split()[0]
        pages = json.load(urllib.request.urlopen(f"http://127.0.0.1:{port}/json"))
        path = [page for page in pages if page["type"] == "page"][0]["webSocketDebuggerUrl"].split(port, 1)[1]
        self.line = socket.create_connection(("127.0.0.1", int(port)), timeout=PATIENCE)
        key = base64.b64encode(os.urandom(16)).decode()
        self.line.sendall(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode())
        self.bytes = b""
        while b"\r\n\r\n" not in self.bytes:
            self.bytes += self.line.recv(4096)
        self.bytes = self.bytes.partition(b"\r\n\r\n")[2]
        self.count = 0

    @staticmethod
    def read(path):
        try:
            with open(path) as file:
                return file.read()
        except OSError:
            return ""

    def take(self, count):
        while len(self.bytes) < count:
            more = self.line.recv(65536)
            check(more, "Chromium has left")
            self.bytes += more
        data, self.bytes = self.bytes[:count], self.bytes[count:]
        return data

    def receive(self):
        """A message: one frame of text, as Chromium sends them."""
        length = self.take(2)[1] & 127
        if length > 125:
            length = struct.unpack(">H" if length == 126 else ">Q", self.take(2 if length == 126 else 8))[0]
        return json.loads(self.take(length))

    def call(self, method, **parameters):
        self.count += 1
        text = json.dumps({"id": self.count, "method": method, "params": parameters}).encode()
        length = struct.pack(">B", 128 | len(text)) if len(text) < 126 else struct.pack(">BH", 254, len(text))
        self.line.sendall(b"\x81" + length + bytes(4) + text)  # masked by zeros
        while True:
            answer = self.receive()
            if answer.get("id") == self.count:
                return answer.get("result", answer)

    def run(self, script):
        result = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)["result"]
        return result.get("value")

    def close(self):
        self.process.terminate()
        self.process.wait(PATIENCE)


def plays(page, by_webrtc, what):
    """Pictures come, that are no single colour, without a message."""
    before = until(lambda: [look for look in [page.run(LOOK)] if look["width"] == 32 and look["object"] == by_webrtc], what)[0]["frames"]
    look = until(lambda: [look for look in [page.run(LOOK)] if look["frames"] > before + 20], f"{what}: pictures")[0]
    check(not look["paused"] and look["spread"] > 5 and look["failed"] == "", f"{what}: {look}")


def click(page, name):
    page.run(f"document.getElementById('{name}').click()")


def test_page(server, page, offers, address=None):
    page.call("Page.navigate", url=address or f"http://127.0.0.1:{server.port}/")
    until(lambda: page.run("document.getElementById('token') !== null"), "the page")
    page.run(f"document.getElementById('token').value = '{server.token or ''}'")
    until(lambda: (page.run(LOOK) or {}).get("sessions"), "the page's list of sessions")
    click(page, "watch")
    plays(page, offers, "the page's first choice")
    page.run("document.getElementById('text').value = 'hello'")
    click(page, "say")
    until(lambda: "ended " in page.run(LOOK)["events"], "the end of the text in the page's events")
    click(page, "webrtc")
    plays(page, False, "the mp4")
    check(server.state()["viewers"] == 1, f"viewers: {server.state()['viewers']}")
    click(page, "webrtc")
    plays(page, offers, "the first choice again")
    page.run("document.getElementById('events').textContent = ''")
    click(page, "microphone")
    until(lambda: "started " in page.run(LOOK)["events"], "the microphone in the page's events")
    click(page, "microphone")
    until(lambda: "ended " in page.run(LOOK)["events"], "the end of the microphone")
    click(page, "say")
    click(page, "stop")
    until(lambda: "interrupted " in page.run(LOOK)["events"] or "ended " in page.run(LOOK)["events"], "a stop")
    check(page.run(LOOK)["failed"] == "", f"{page.run(LOOK)}")
    page.call("Page.navigate", url="about:blank")
    until(lambda: server.state()["viewers"] == 0, "the page's viewer has left")


def main():
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        print("serve_page: skipped: neither chromium nor google-chrome is installed")
        sys.exit(77)
    make_files()
    with Server(*BASE, "--quality", "draft") as server:
        offers = server.ask("POST", "/v1/sessions/head/whep", b"v=0\r\n", kind="application/sdp")[0] == 400
        page = Browser(program)
        try:
            test_page(server, page, offers)
        finally:
            page.close()
    print(f"serve_page: plays {'by WebRTC and ' if offers else ''}as mp4, says a text, passes on the microphone, stops")


if __name__ == "__main__":
    main()
