#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""ernerf serve: viewers by WebRTC. Skips where GStreamer lacks a part. Usage: serve_whep.py ERNERF FOLDER CLIPS CLIENT
(whep_client)"""
import http.client
import json
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
from serve import BASE, FOLDER, PATIENCE, Reader, Server, check, make_files, until

CLIENT = sys.argv[4]
SDP = "application/sdp"
QUICK = ["--quality", "draft"]  # settings are not measured


class Viewer:
    """A viewer by WebRTC: what it has decoded, as lines."""

    def __init__(self, server, session="head", folder=None, connects=True):
        self.server = server
        self.process = subprocess.Popen([CLIENT] + ([folder] if folder else []), stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.offer = self.process.stdout.read(int(self.process.stdout.readline()))
        self.status, self.answer = server.ask("POST", f"/v1/sessions/{session}/whep", self.offer, kind=SDP)
        self.location = f"/v1/sessions/{session}/{server.fields['Location']}"
        self.lines = []
        if self.status == 201 and connects:
            self.process.stdin.write(b"%d\n" % len(self.answer) + self.answer)
            self.process.stdin.flush()
            threading.Thread(target=lambda: self.lines.extend(iter(self.process.stdout.readline, b"")), daemon=True).start()

    def seen(self, kind):
        """[(seconds of the stream, the others)] of what it has decoded of that kind."""
        rows = [line.decode().split() for line in list(self.lines)]
        return [(float(row[1]), *map(float, row[2:])) for row in rows if row[0] == kind]

    def leave(self):
        self.process.stdin.close()
        self.process.wait(PATIENCE)

    def kill(self):
        self.process.kill()
        self.process.wait(PATIENCE)


def check_playing(viewer, pictures, what):
    until(lambda: len(viewer.seen("picture")) > pictures and len(viewer.seen("sound")) > pictures, f"{what}: pictures and sound")
    times = [row[0] for row in viewer.seen("picture")]
    steps = sorted(b - a for a, b in zip(times, times[1:]))
    middle = steps[len(steps) // 2]  # it evens out jitter, and gives those that come late together the same time
    check(steps[0] >= 0 and abs(middle - 0.04) < 0.02, f"{what}: steps of pictures {steps[:9]}... {middle}")
    check(all(row[2:] == (32, 32) for row in viewer.seen("picture")), f"{what}: sizes {viewer.seen('picture')[0]}")
    check(all(row[2] == 1920 for row in viewer.seen("sound")[1:]), f"{what}: packets of sound {viewer.seen('sound')[:5]}")


def sound_of(folder):
    """The loudest sample that the viewer has heard."""
    with open(os.path.join(folder, "sound"), "rb") as file:
        data = file.read()
    samples = memoryview(data[: len(data) // 4 * 4]).cast("f")
    return max(map(abs, samples), default=0)


def test_refused(server, offer):
    video = offer.replace(b"H264", b"VP8")
    rows = [(b"x", SDP, 400), (b"", SDP, 400), (b"v=0\r\n", SDP, 400), (offer[:300], SDP, 400), (video, SDP, 400),
            (offer.replace(b"42e01f", b"64001f"), SDP, 400), (offer.replace(b"a=fingerprint", b"a=finger"), SDP, 400),
            (offer.replace(b"sha-256", b"sha-1"), SDP, 400), (offer.replace(b"recvonly", b"sendonly"), SDP, 400), (offer.replace(b"m=audio", b"m=audi"), SDP, 400),
            (offer + b"m=audio 9 UDP/TLS/RTP/SAVPF 0\r\n" * 9, SDP, 400), (offer + b"\0", SDP, 400), (offer * 60, SDP, 413),
            (offer + b"a=candidate:1 1 UDP 1 192.0.2.1 9 typ host\r\n" * 200, SDP, 400),
            (offer.replace(b" 102", b" 102" + b" 9" * 9000, 1), SDP, 400), (offer + b"a=x\r\n" * 9000, SDP, 400), (offer, "text/plain", 415), (offer, None, 415)]
    for body, kind, expected in rows:
        status, answer = server.ask("POST", "/v1/sessions/head/whep", body, kind=kind)
        check(status == expected and "error" in answer, f"{body[:60]} {kind}: {status} {answer}, expected {expected}")
    for body in offer.replace(b"recvonly", b"sendrecv"), offer.replace(b"a=recvonly\r\n", b""), re.sub(rb"a=group:BUNDLE[^\n]*\n", b"", offer):
        status, answer = server.ask("POST", "/v1/sessions/head/whep", body, kind=SDP)
        check(status == 201 and answer.count(b"a=sendonly") == 2, f"an offer of another form: {status} {answer}")
        check(server.ask("DELETE", f"/v1/sessions/head/{server.fields['Location']}")[0] == 200, "its end")
    for method, path, expected in [("GET", "whep", 405), ("PATCH", "whep/" + "0" * 32, 405), ("DELETE", "whep/" + "0" * 32, 404), ("DELETE", "whep/x", 404)]:
        status, answer = server.ask(method, "/v1/sessions/head/" + path)
        check(status == expected, f"{method} {path}: {status} {answer}")
    check(server.ask("POST", "/v1/sessions/none/whep", offer, kind=SDP)[0] == 404, "a session that is none")
    until(lambda: server.state()["viewers"] == 0, "no viewer is left of those")


def test_play(server):
    """Viewers come, hear what is said, and leave in each way; the others notice nothing."""
    first, killed, absent = Viewer(server, folder="."), Viewer(server), Viewer(server, connects=False)
    check((first.status, killed.status, absent.status) == (201, 201, 201), f"{first.answer} {killed.answer} {absent.answer}")
    check(b"profile-level-id=42c0" in first.answer and b"a=candidate" in first.answer and first.answer.count(b"a=sendonly") == 2, f"{first.answer}")
    check(re.search(rb"a=ssrc-group:FID [1-9]\d* [1-9]", first.answer), f"lost packets are not sent again: {first.answer}")
    killed_since = time.monotonic()
    check_playing(first, 10, "the first viewer")
    check_playing(killed, 10, "the second viewer")
    killed.kill()
    absent.kill()
    mp4 = Reader(server, "/v1/sessions/head/stream")
    until(lambda: server.state()["viewers"] == 4, "four viewers")
    status, answer = server.ask("POST", "/v1/sessions/head/whep", first.offer, kind=SDP)
    check(status == 503 and "--viewers" in answer["error"], f"one viewer too many: {status} {answer}")
    mp4.close()
    server.say("hello")
    until(lambda: sound_of(".") > 0.1, "what is said")
    again = until(lambda: [v for v in [Viewer(server)] if v.status == 201 or v.kill()], "a place for another viewer")[0]
    check_playing(again, 10, "another viewer")
    check(server.ask("DELETE", again.location)[0] == 200, "the end of a viewer")
    until(lambda: server.ask("DELETE", again.location)[0] == 404, "its address is gone")
    again.leave()
    until(lambda: server.state()["viewers"] == 1, "those who have gone without a word are noticed", 40)
    check(time.monotonic() - killed_since > 8, "a viewer was dropped early")
    count = len(first.seen("picture"))
    check_playing(first, count + 10, "the first viewer, at the end")
    return first


def test_session_ends(server):
    status, answer = server.ask("POST", "/v1/sessions", json.dumps({"portrait": "head", "id": "second"}), kind="application/json")
    check(status == 200, f"{answer}")
    offer = lambda: Viewer(server, "second")
    viewer = until(lambda: [v for v in [offer()] if v.status == 201 or v.kill()], "a viewer of the second session")[0]
    check_playing(viewer, 5, "the second session")
    check(server.ask("DELETE", "/v1/sessions/second")[0] == 200, "the end of the session")
    count = len(viewer.seen("picture"))
    time.sleep(0.5)
    check(len(viewer.seen("picture")) <= count + 5, "pictures of a session that has ended")
    viewer.leave()


class Stun(threading.Thread):
    """A STUN server that knows one address of everybody's."""

    def __init__(self):
        super().__init__(daemon=True)
        self.line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.line.bind(("0.0.0.0", 0))
        self.start()

    def run(self):
        while True:
            asked, who = self.line.recvfrom(2048)
            mapped = bytes(a ^ b for a, b in zip(struct.pack(">H4B", 4242, 203, 0, 113, 7), b"\x21\x12\x21\x12\xa4\x42"))
            value = struct.pack(">HHBB", 0x20, 8, 0, 1) + mapped  # XOR-MAPPED-ADDRESS
            self.line.sendto(struct.pack(">HH", 0x101, len(value)) + asked[4:20] + value, who)


def test_stun(offer):
    own = re.search(rb" UDP \d+ (\d+\.\d+\.\d+\.\d+) ", offer)[1].decode()  # libnice asks no server at the loopback
    with Server(*BASE, *QUICK, "--stun", f"stun://{own}:{Stun().line.getsockname()[1]}") as server:
        status, answer = server.ask("POST", "/v1/sessions/head/whep", offer, kind=SDP)
        test_joins(server, offer)
        status, answer = until(lambda: [found for found in [server.ask("POST", "/v1/sessions/head/whep", offer, kind=SDP)] if found[0] != 429], "an answer")[0]
        check(status == 201 and re.search(rb"a=candidate:.* 203\.0\.113\.7 4242 typ srflx", answer), f"{status} {answer}")


def test_joins(server, offer):
    """Of 40 who come at once, some ten are let in, the others are told to come again."""
    found = []

    def join():
        line = http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE)
        line.request("POST", "/v1/sessions/head/whep", offer, {"Content-Type": SDP})
        answer = line.getresponse()
        found.append((answer.status, answer.headers.get("Retry-After"), answer.read()))

    began = time.monotonic()
    threads = [threading.Thread(target=join) for _ in range(40)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    let_in = sum(status == 201 for status, _, _ in found)
    check(0 < let_in <= 11 + 10 * (time.monotonic() - began), f"{let_in} are let in")
    rest = [(status, retry, b"10 viewers" in text) for status, retry, text in found if status != 201]
    check(len(rest) > 5 and set(rest) == {(429, "1", True)}, f"{set(rest)}")


def test_ports(offer):
    """Three ports are enough for three viewers; the fourth is told that no port is free."""
    with Server(*BASE, *QUICK, "--udp-ports", "42600-42602") as server:
        answers = [server.ask("POST", "/v1/sessions/head/whep", offer, kind=SDP) for _ in range(4)]
        ports = [set(map(int, re.findall(rb"a=candidate:\S+ 1 UDP \d+ \S+ (\d+) ", answer))) for status, answer in answers if status == 201]
        check(1 <= len(ports) <= 3 and all(found and found <= {42600, 42601, 42602} for found in ports), f"{answers}")
        status, answer = answers[-1]
        check(status == 503 and "42600 to 42602" in answer["error"], f"{status} {answer}")


def test_no_elements():
    """Where a plugin of GStreamer's is missing, the other viewers are served."""
    os.environ.update(GST_PLUGIN_SYSTEM_PATH_1_0="/nowhere", GST_REGISTRY=os.path.join(FOLDER, "registry.bin"))
    with Server(*BASE, *QUICK) as server:
        status, answer = server.ask("POST", "/v1/sessions/head/whep", b"v=0\r\n", kind=SDP)
        check(status == 501 and "webrtcbin" in answer["error"], f"{status} {answer}")
        viewer = Reader(server, "/v1/sessions/head/stream")
        until(lambda: b"moof" in viewer.bytes, "a fragment")
        viewer.close()


def main():
    found = subprocess.run([CLIENT, "--elements"], stdout=subprocess.PIPE, text=True, timeout=PATIENCE)
    if found.returncode != 0:
        print("serve_whep: skipped:", found.stdout.strip())
        sys.exit(77)
    make_files()
    if not any(os.path.exists(f"/sys/class/net/{name}/address") for name in os.listdir("/sys/class/net") if name != "lo"):
        print("serve_whep: skipped: the machine has no network but the loopback")
        sys.exit(77)
    os.environ["GST_DEBUG"] = "rtpsession:2"  # of the server, on its standard error
    with Server(*BASE, *QUICK, "--viewers", "4") as server:
        del os.environ["GST_DEBUG"]
        first = test_play(server)
        test_session_ends(server)
        first.leave()
        test_refused(server, first.offer)
        last = Viewer(server)
        check_playing(last, 5, "a viewer at the server's end")
    last.process.send_signal(signal.SIGKILL)
    check("determine running time" not in server.text(), "RTCP does not tell the times of packets")
    test_stun(first.offer)
    test_ports(first.offer)
    test_no_elements()
    print("serve_whep: viewers who come, leave, are killed and never connect; refusals, sessions that end, no plugins")


main()
