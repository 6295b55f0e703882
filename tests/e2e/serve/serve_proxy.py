#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""ernerf serve behind nginx with TLS, by the lines of examples/serve/nginx.conf: HTTP/1.1, HTTP/2 and the page in
Chromium. Skips without nginx, curl, openssl, Chromium or WebRTC. Usage: serve_proxy.py ERNERF FOLDER CLIPS CLIENT
(whep_client)"""
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
from serve import BASE, FOLDER, PATIENCE, Server, check, make_files, until
from serve_page import Browser, test_page

NAME = "portrait.example.org"
EXAMPLE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../../examples/serve/nginx.conf")
SAY, WATCH = "s" * 40, "w" * 40


class Proxy:
    """nginx with the example's lines, a certificate of its own and a free port."""

    def __init__(self, target):
        with socket.create_server(("127.0.0.1", 0)) as line:
            self.port = line.getsockname()[1]
        key, certificate = (os.path.join(FOLDER, name) for name in ("key.pem", "certificate.pem"))
        subprocess.run(["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", key, "-out", certificate, "-days", "2",
                        "-subj", f"/CN={NAME}", "-addext", f"subjectAltName=DNS:{NAME}"], check=True, stderr=subprocess.DEVNULL)
        with open(EXAMPLE) as file:
            lines = file.read()
        for old, new in ((r"listen 443", f"listen 127.0.0.1:{self.port}"), (r"/etc/ssl/certs/[^;]*", certificate),
                         (r"/etc/ssl/private/[^;]*", key), (r"127\.0\.0\.1:8080", f"127.0.0.1:{target}")):
            lines, count = re.subn(old, new, lines)
            check(count == 1, f"nginx.conf: {count} of {old}")
        temporary = "".join(f"{kind}_temp_path {FOLDER}/{kind};\n" for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi"))
        with open("nginx.conf", "w") as file:
            file.write(f"daemon off;\npid {FOLDER}/nginx.pid;\nerror_log {FOLDER}/nginx.log;\nevents {{}}\nhttp {{\naccess_log off;\n{temporary}{lines}}}\n")
        words = ["nginx", "-e", f"{FOLDER}/nginx.log", "-c", f"{FOLDER}/nginx.conf"]
        if os.geteuid() == 0: # an account without rights
            shutil.chown(FOLDER, "nobody", "nogroup")
            shutil.chown(key, "nobody", "nogroup")
            words = ["setpriv", "--reuid=nobody", "--regid=nogroup", "--clear-groups", *words]
        self.process = subprocess.Popen(words)
        until(lambda: socket.socket().connect_ex(("127.0.0.1", self.port)) == 0 or self.process.poll() is not None, "nginx")

    def curl(self, path, *words, token=SAY, **more):
        """A request whose answer goes to standard output."""
        bearer = ["-H", f"Authorization: Bearer {token}"] if token else []
        return subprocess.Popen(["curl", "-sSN", "--cacert", "certificate.pem", "--resolve", f"{NAME}:{self.port}:127.0.0.1", *bearer, *words,
                                 f"https://{NAME}:{self.port}{path}"], stdout=subprocess.PIPE, **more)

    def ask(self, path, *words, **more):
        """Version and status of an answer, its headers and body."""
        answer = self.curl(path, "-i", *words, **more).communicate(timeout=PATIENCE)[0]
        head, _, body = answer.partition(b"\r\n\r\n")
        version, status = head.split()[:2]
        return version.decode(), int(status), head.decode().lower(), body


def begins(process, what, wanted):
    """Reads until `wanted` has come, while the request goes on."""
    os.set_blocking(process.stdout.fileno(), False)
    data = b""

    def more():
        nonlocal data
        data += process.stdout.read() or b""
        return wanted in data

    until(more, what)
    check(process.poll() is None, f"{what}: it has ended")
    return data


def test_requests(proxy, version):
    words = ["--http2"] if version == "HTTP/2" else ["--http1.1"]
    origin = lambda text: [*words, "-H", f"Origin: {text}"]
    own = f"https://{NAME}:{proxy.port}"
    for path, more, token, expected in [("/", words, None, 200), ("/state", words, None, 401), ("/state", words, WATCH, 200), ("/state", origin(own), WATCH, 200),
                                        ("/state", origin("https://evil.example"), WATCH, 403), ("/state", [*words, "-H", "Host: evil.example"], WATCH, 403),
                                        ("/v1/sessions/head/stop", [*words, "-d", ""], WATCH, 401), ("/v1/sessions/head/stop", [*origin(own), "-d", ""], SAY, 200)]:
        found = proxy.ask(path, *more, token=token)
        check(found[:2] == (version, expected), f"{path} {more} {token}: {found[:2]}, expected {version} {expected}")
    stream, events = (proxy.curl(f"/v1/sessions/head/{name}", *words, token=WATCH) for name in ("stream", "events"))
    begins(stream, "a fragment", b"moof")
    time.sleep(0.2)
    say = proxy.curl("/v1/sessions/head/say?format=s16le&rate=16000", *words, "-X", "POST", "-T", "-", "-H", "Content-Type: audio/raw", stdin=subprocess.PIPE)
    say.stdin.write(b"\x10\x20" * 16000)
    say.stdin.flush()
    begins(events, "the start of a sound of which more comes", b"event: started")
    check(say.poll() is None, "the sound has ended")
    say.stdin.close()
    begins(events, "its end", b"event: ended")
    say.wait(PATIENCE)
    for process in stream, events:
        process.kill()
        process.wait()


def test_webrtc(proxy, client):
    """The answer and the viewer's end pass through the proxy."""
    viewer = subprocess.Popen([client], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    with open("offer", "wb") as file:
        file.write(viewer.stdout.read(int(viewer.stdout.readline())))
    found = proxy.ask("/v1/sessions/head/whep", "--http2", "-H", "Content-Type: application/sdp", "--data-binary", "@offer", token=WATCH)
    check(found[1] == 201, f"{found}")
    viewer.stdin.write(b"%d\n" % len(found[3]) + found[3])
    viewer.stdin.flush()
    until(lambda: viewer.stdout.readline().startswith(b"picture"), "a picture by WebRTC")
    place = "/v1/sessions/head/" + re.search(r"location: (\S+)", found[2])[1]
    check(proxy.ask(place, "--http2", "-X", "DELETE", token=WATCH)[1] == 200, "the end of a viewer by WebRTC")
    viewer.kill()
    viewer.wait()


def main():
    programs = [name for name in ("nginx", "curl", "openssl", "chromium", "setpriv") if shutil.which(name) is None]
    if programs or subprocess.run([sys.argv[4], "--elements"], stdout=subprocess.DEVNULL).returncode != 0:
        print("serve_proxy: skipped: not installed:", *programs or ["GStreamer's elements"])
        sys.exit(77)
    make_files()
    for name, token in ("say", SAY), ("watch", WATCH):
        with open(name, "w") as file:
            file.write(token + "\n")
    with Server(*BASE, "--quality", "draft", "--host", NAME, "--say-token", "say", "--watch-token", "watch", token=SAY) as server:
        proxy = Proxy(server.port)
        try:
            for version in "HTTP/1.1", "HTTP/2":
                test_requests(proxy, version)
            test_webrtc(proxy, sys.argv[4])
            page = Browser("chromium", "--ignore-certificate-errors", f"--host-resolver-rules=MAP {NAME} 127.0.0.1")
            try:
                test_page(server, page, True, f"https://{NAME}:{proxy.port}/")
                check(page.run("typeof RTCPeerConnection") == "function", "the page's WebRTC")
            finally:
                page.close()
        finally:
            proxy.process.send_signal(signal.SIGTERM)
            proxy.process.wait(PATIENCE)
    print("serve_proxy: page, tokens, origins, stream, events, sound as it comes and WebRTC behind nginx with TLS, HTTP/1.1 and HTTP/2")


main()
