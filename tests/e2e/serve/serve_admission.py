#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""ernerf serve refuses a session that the machine is too slow for. Usage: serve_admission.py ERNERF FOLDER CLIPS"""
import json
import os
import sys

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
from serve import BASE, Reader, Server, check, make_files, until

make_files()
# A frame that takes 64 threads is counted as one that takes 64 cores.
with Server(*BASE, "--quality", "draft", "--threads", "64", "--fps", "50") as server:
    for k in range(32):
        status, answer = server.ask("POST", "/v1/sessions", json.dumps({"portrait": "head", "id": f"more{k}"}), kind="application/json")
        if status != 200:
            break
    check(status == 503 and ("too slow for another session" in answer["error"] or k == 31), f"session {k}: {status} {answer}")
    viewer = Reader(server, "/v1/sessions/head/stream")
    until(lambda: b"moof" in viewer.bytes, "the first session goes on")
    viewer.close()
print("serve_admission: a session that the machine is too slow for")
