#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""ernerf serve: viewers by WebRTC whose certificate is not that of their offer, who send what none sends, ask for each
packet again and again, or are more than the system has files for. Skips where the openssl program, libsrtp2 or GStreamer
lacks. Usage: serve_hostile_viewer.py ERNERF FOLDER CLIPS"""
import ctypes
import hashlib
import hmac
import os
import random
import re
import select
import shutil
import socket
import ssl
import struct
import subprocess
import sys
import time
import zlib

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
from serve import BASE, Server, check, make_files, until, used

QUICK = ["--quality", "draft"]  # settings are not measured
OWN = 77  # the source of what the viewer sends
NAME, WORD = b"viewer", b"w" * 24  # ice-ufrag and ice-pwd
TYPE = 102  # of the pictures
NONE = 16 * "00:" + 15 * "00:" + "00"


class Crypto(ctypes.Structure):
    _fields_ = [(name, ctypes.c_int) for name in ("cipher", "key", "auth", "auth_key", "tag", "services")]


class Policy(ctypes.Structure):  # srtp_policy_t
    _fields_ = [("which", ctypes.c_int), ("source", ctypes.c_uint32), ("rtp", Crypto), ("rtcp", Crypto), ("key", ctypes.c_void_p),
                ("keys", ctypes.c_void_p), ("count", ctypes.c_ulong), ("window", ctypes.c_ulong), ("rest", ctypes.c_byte * 64)]


def offer(fingerprint):
    """Of one that connects by DTLS itself (setup:active), and looks for the server's address itself (no candidate)."""
    common = (f"c=IN IP4 0.0.0.0\r\na=setup:active\r\na=ice-ufrag:{NAME.decode()}\r\na=ice-pwd:{WORD.decode()}\r\na=rtcp-mux\r\n"
              f"a=recvonly\r\na=fingerprint:sha-256 {fingerprint}\r\n")
    return ("v=0\r\no=- 1 0 IN IP4 0.0.0.0\r\ns=-\r\nt=0 0\r\na=group:BUNDLE v\r\n"
            f"m=video 9 UDP/TLS/RTP/SAVPF {TYPE} 96\r\n{common}a=mid:v\r\na=rtpmap:{TYPE} H264/90000\r\n"
            f"a=fmtp:{TYPE} packetization-mode=1;profile-level-id=42e01f\r\na=rtcp-fb:{TYPE} nack\r\n"
            f"a=rtpmap:96 rtx/90000\r\na=fmtp:96 apt={TYPE}\r\n").encode()


def stun(kind, number, attributes, word):
    body = b"".join(struct.pack(">HH", name, len(value)) + value + bytes(-len(value) % 4) for name, value in attributes)
    head = lambda more: struct.pack(">HHI", kind, len(body) + more, 0x2112A442) + number
    body += struct.pack(">HH", 8, 20) + hmac.new(word, head(24) + body, hashlib.sha1).digest()
    return head(8) + body + struct.pack(">HHI", 0x8028, 4, zlib.crc32(head(8) + body) ^ 0x5354554E)


class Viewer:
    """ICE of our own, DTLS of the program openssl, and libsrtp2."""

    def __init__(self, server, fingerprint):
        self.status, self.answer = until(lambda: [found for found in [server.ask("POST", "/v1/sessions/head/whep", offer(fingerprint), kind="application/sdp")] if found[0] != 429], "an answer")[0]
        self.numbers = []  # of packets of pictures
        self.dtls = None
        if self.status != 201:
            return
        text = self.answer.decode()
        self.name = re.search(r"ice-ufrag:(\S+)", text)[1].encode() + b":" + NAME
        self.word = re.search(r"ice-pwd:(\S+)", text)[1].encode()
        self.source = int(re.search(r"a=ssrc-group:FID (\d+) ", text)[1])
        self.server = next((host, int(port)) for host, port in re.findall(r" 1 UDP \d+ (\S+) (\d+) typ host", text) if "." in host)
        self.line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.line.bind((self.server[0], 0))
        self.inner = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)  # to the program
        self.inner.bind(("127.0.0.1", 0))
        self.program = None
        self.reached = False
        until(lambda: self.knock() or self.look(0.1) or self.reached, "an answer by STUN")
        until(lambda: self.shake(), "DTLS")

    def knock(self):
        wish = [(6, self.name), (0x24, struct.pack(">I", 0x6E7F00FF)), (0x802A, bytes(8)), (0x25, b"")]
        self.line.sendto(stun(1, os.urandom(12), wish, self.word), self.server)

    def look(self, seconds):
        """Takes what comes for so long."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            for line in select.select([self.line, self.inner], [], [], left)[0]:
                data, who = line.recvfrom(4096)
                if line is self.inner:
                    self.program = who
                    self.line.sendto(data, self.server)
                elif data[0] < 2 and data[:2] == b"\0\1":
                    mapped = struct.pack(">BBH", 0, 1, who[1] ^ 0x2112) + bytes(a ^ b for a, b in zip(socket.inet_aton(who[0]), b"\x21\x12\xa4\x42"))
                    self.line.sendto(stun(0x101, data[8:20], [(0x20, mapped)], WORD), who)
                elif data[0] < 2:
                    self.reached = True
                elif 20 <= data[0] < 64 and self.program:
                    self.inner.sendto(data, self.program)
                elif data[0] >> 6 == 2 and data[1] & 127 == TYPE:
                    self.numbers.append(struct.unpack(">H", data[2:4])[0])

    def shake(self):
        if not self.dtls:
            port = self.inner.getsockname()[1]
            self.log = open(f"dtls-{port}.txt", "w+b")
            self.dtls = subprocess.Popen(["openssl", "s_client", "-dtls1_2", "-connect", f"127.0.0.1:{port}", "-cert", "own.pem", "-key", "own.key",
                                          "-use_srtp", "SRTP_AES128_CM_SHA1_80", "-keymatexport", "EXTRACTOR-dtls_srtp", "-keymatexportlen", "60"],
                                         stdin=subprocess.PIPE, stdout=self.log, stderr=self.log)
        self.look(0.1)
        self.log.seek(0)
        found = re.search(rb"Keying material: ([0-9A-F]{120})", self.log.read())
        if not found:
            return False
        keys = bytes.fromhex(found[1].decode())
        self.key = ctypes.create_string_buffer(keys[:16] + keys[32:46])
        policy = Policy(which=3, key=ctypes.addressof(self.key))  # any source that is sent
        SRTP.srtp_crypto_policy_set_rtp_default(ctypes.byref(policy.rtp))
        SRTP.srtp_crypto_policy_set_rtp_default(ctypes.byref(policy.rtcp))
        self.srtp = ctypes.c_void_p()
        check(SRTP.srtp_create(ctypes.byref(self.srtp), ctypes.byref(policy)) == 0, "libsrtp2")
        return True

    def send(self, packet, protect="srtp_protect_rtcp"):
        room, count = ctypes.create_string_buffer(packet, 4096), ctypes.c_int(len(packet))
        check(getattr(SRTP, protect)(self.srtp, room, ctypes.byref(count)) == 0, protect)
        self.line.sendto(room.raw[: count.value], self.server)

    def leave(self):
        self.dtls.kill()
        self.dtls.wait()
        self.line.close()


def report(sender=OWN):
    return struct.pack(">BBHI", 0x80, 201, 1, sender)


def watched(server, viewer, what):
    """Whether pictures come to it, who reports."""
    until(lambda: viewer.send(report()) or viewer.look(0.1) or len(viewer.numbers) > 20, f"{what}: packets")


def still_watched(server, viewers, what):
    for viewer in viewers:
        viewer.numbers.clear()
        watched(server, viewer, what)
    for viewer in viewers:
        viewer.leave()


def main():
    global SRTP
    try:
        SRTP = ctypes.CDLL("libsrtp2.so.1")
    except OSError:
        SRTP = None
    if SRTP is None or shutil.which("openssl") is None or shutil.which("prlimit") is None:
        print("serve_hostile_viewer: skipped: openssl, prlimit or libsrtp2 is not installed")
        sys.exit(77)
    SRTP.srtp_init()
    make_files()
    subprocess.run(["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", "own.key", "-out", "own.pem", "-days", "9", "-subj", "/CN=x"], check=True, stderr=subprocess.DEVNULL)
    with open("own.pem") as file:
        own = hashlib.sha256(ssl.PEM_cert_to_DER_cert(file.read())).hexdigest().upper()
    own = ":".join(own[k : k + 2] for k in range(0, 64, 2))
    with Server(*BASE, *QUICK) as server:
        status, answer = server.ask("POST", "/v1/sessions/head/whep", offer(own), kind="application/sdp")
        if status in (501, 503):
            print(f"serve_hostile_viewer: skipped: {answer}")
            sys.exit(77)
        test_certificate(server)
        test_media(server, own)
        test_reports(server, own)
        test_requests(server, own)
        test_sources(server, own)
    test_files(own)
    print("serve_hostile_viewer: another's certificate, media, reports, requests for lost packets, sources, no files left")


def test_certificate(server):
    """One whose certificate is not that of the offer gets nothing."""
    viewer = Viewer(server, NONE)
    viewer.look(2)
    check(not viewer.numbers, f"{len(viewer.numbers)} packets for another's certificate")
    viewer.leave()


def test_media(server, own):
    """Packets of RTP, whose source is that of what it receives, stop neither it nor another."""
    viewer, other = Viewer(server, own), Viewer(server, own.lower())
    watched(server, viewer, "a viewer")
    for k in range(200):
        viewer.send(struct.pack(">BBHII", 0x80, TYPE, k, 90 * k, viewer.source) + bytes(20), "srtp_protect")
        viewer.look(0.002)
    still_watched(server, [viewer, other], "after media")


def test_reports(server, own):
    """Reports of any kind and content stop neither it nor another."""
    viewer, other = Viewer(server, own), Viewer(server, own)
    watched(server, viewer, "a viewer")
    made = random.Random(1)
    for k in range(4000):
        packet = b""
        for _ in range(made.randrange(1, 6)):
            body = made.choice([made.randbytes(4 * made.randrange(50)), struct.pack(">IIII", viewer.source, 2**32 - 1, made.getrandbits(32), 0) * made.randrange(4)])
            packet += struct.pack(">BBHI", 0x80 | made.randrange(32), made.choice([200, 201, 202, 203, 204, 205, 206, 207]), 1 + len(body) // 4, OWN) + body
        viewer.send(packet[:1400])
        if k % 10 == 0:
            viewer.look(0.005)
    still_watched(server, [viewer, other], "after reports")


def test_requests(server, own):
    """Requests for the same packets again and again cost no memory, and others are sent meanwhile."""
    viewer = Viewer(server, own)
    watched(server, viewer, "a viewer")
    before = used(server)[1]
    asked = struct.pack(">HH", viewer.numbers[-1] - 20 & 0xFFFF, 0xFFFF) * 300
    for _ in range(300):
        viewer.send(report() + struct.pack(">BBHII", 0x81, 205, 302, OWN, viewer.source) + asked)
        viewer.look(0.01)
    grown = used(server)[1] - before
    check(grown < 50000, f"{grown} KB for requests of one viewer")
    viewer.numbers.clear()
    until(lambda: viewer.look(0.1) or len(viewer.numbers) > 20, "packets after requests")
    viewer.leave()


def test_sources(server, own):
    """One that reports as thousands of sources is ended."""
    viewer = Viewer(server, own)
    watched(server, viewer, "a viewer")
    for k in range(5000):
        viewer.send(report(1000 + k))
        if k % 50 == 0:
            viewer.look(0.002)
    until(lambda: viewer.send(report()) or server.state()["viewers"] == 0, "its end although it reports")
    viewer.leave()


def test_files(own):
    """Where files are left for some viewers alone, the others are refused: GLib would end the process."""
    server = Server(*BASE, *QUICK)
    server.words = ["prlimit", "--nofile=512:512", *server.words]
    with server:
        found = set()
        end = time.monotonic() + 8
        while time.monotonic() < end and 503 not in found:
            status, answer = server.ask("POST", "/v1/sessions/head/whep", offer(own), kind="application/sdp")
            found.add(status)
            time.sleep(0.1)
        check(found == {201, 503} and "open files" in answer["error"], f"{found} {answer}")


main()
