#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Makes the tables of docs/watermark.md: what is found of a watermark after other codings, and how often a wrong key is
found. Needs ffmpeg with libx264.

    table.py detect BIN FOLDER KEYS SECONDS CHANGES NAME=SOURCE...  a line of JSON for each clip, key and change
    table.py keys BIN FOLDER COUNT FULL SECONDS NAME=SOURCE...       a line of JSON for each clip
    table.py print FILE...                                           the tables of such lines

BIN: the build's bin folder, with ernerf; the tests' watermarkbench is in ../tests/bin of it. FOLDER: for videos, which
may be large. SOURCE: a video, or a pattern of numbered pictures such as clip/gt_imgs/%d.jpg (25 a second). The first
SECONDS of it are used. CHANGES: all, or a regular expression that their names begin with."""
import collections
import json
import re
import subprocess
import sys
from pathlib import Path

X264 = ["-c:v", "libx264", "-pix_fmt", "yuv420p"]
CROP = "crop=trunc(iw*0.45)*2:trunc(ih*0.45)*2:trunc(iw*0.03):trunc(ih*0.07)"
HALF = "scale=trunc(iw/4)*2:trunc(ih/4)*2"
CHANGES = [  # name; for each coding: filter, rate, CRF
    ("as written (x264, CRF 15, veryfast)", []),
    ("x264, CRF 18", [(None, None, 18)]),
    ("x264, CRF 23", [(None, None, 23)]),
    ("x264, CRF 28", [(None, None, 28)]),
    ("CRF 23 twice", [(None, None, 23), (None, None, 23)]),
    ("scaled to 0.75, CRF 23", [("scale=trunc(iw*0.375)*2:trunc(ih*0.375)*2", None, 23)]),
    ("scaled to 0.5, CRF 23", [(HALF, None, 23)]),
    ("cropped by 10 %, CRF 23", [(CROP, None, 23)]),
    ("25 to 30 frames a second, CRF 23", [(None, "30", 23)]),
    ("cropped by 10 %, scaled to 0.5, 30 frames a second, CRF 28", [(CROP + "," + HALF, "30", 28)]),
]
WINDOWS = ("2s", "4s", "10s")
FOUND = 1e-6  # of ernerf detect


def run(*words):
    return subprocess.run([str(w) for w in words], check=True, stdout=subprocess.PIPE, text=True).stdout


def ffmpeg(*words):
    run("ffmpeg", "-v", "error", "-nostdin", "-y", *words)


def clean_video(folder, name, source, seconds):
    """The source as a video without loss."""
    path = Path(folder) / f"{name}.mkv"
    rate = ["-framerate", "25"] if "%" in source else []
    ffmpeg(*rate, "-i", source, "-t", seconds, "-an", "-pix_fmt", "bgr0", "-c:v", "ffv1", path)
    return path


def changed(folder, video, codings):
    for i, (filters, rate, crf) in enumerate(codings):
        to = Path(folder) / f"changed{i}.mp4"
        words = (["-vf", filters] if filters else []) + (["-r", rate] if rate else [])
        ffmpeg("-i", video, *words, *X264, "-crf", crf, to)
        video = to
    return video


def detect(binary, video, key, window):
    """The scores and bounds of the windows."""
    report = Path(video).with_suffix(".json")
    subprocess.run([f"{binary}/ernerf", "detect", video, "--watermark", key, "--window", window, "--json", report, "-y",
                    "--quiet"], check=False)
    return [(w["score"], w["false_positive"]) for w in json.loads(report.read_text())["windows"]]


def detect_all(binary, folder, keys, seconds, changes, sources):
    clips = [(name, clean_video(folder, name, source, seconds)) for name, source in sources]
    for k in range(int(keys)):
        for name, clean in clips:
            marked, key = Path(folder) / "marked.mp4", f"key {k}"
            marked.unlink(missing_ok=True)
            psnr = json.loads(run(f"{binary}/../tests/bin/watermarkbench", "mark", clean, key, marked))["psnr"]
            for change, codings in [c for c in CHANGES if changes == "all" or re.match(changes, c[0])]:
                video = changed(folder, marked, codings)
                found = {w: detect(binary, video, key, w) for w in WINDOWS}
                print(json.dumps({"clip": name, "key": key, "psnr": psnr, "change": change, "found": found}), flush=True)


def keys_all(binary, folder, count, full, seconds, sources):
    for name, source in sources:
        clean = clean_video(folder, name + "-clean", source, seconds)
        line = json.loads(run(f"{binary}/../tests/bin/watermarkbench", "keys", clean, count, full))
        print(json.dumps({"clip": name, **line}), flush=True)


def print_tables(lines):
    marked, wrong = [x for x in lines if "found" in x], [x for x in lines if "keys" in x]
    psnr = collections.defaultdict(list)
    for x in marked:
        psnr[x["clip"]].append(x["psnr"])
    for clip, values in psnr.items():
        print(f"{clip}: PSNR {min(values):.2f} to {max(values):.2f} dB")
    print("\n| change | " + " | ".join(f"{w[:-1]} s" for w in WINDOWS) + " | least score | mean score |")
    print("| --- |" + " --- |" * (len(WINDOWS) + 2))
    for change, _ in CHANGES:
        rows, cells = [x for x in marked if x["change"] == change], []
        for w in WINDOWS:
            bounds = [b for x in rows for _, b in x["found"][w]]
            cells.append(f"{sum(b <= FOUND for b in bounds)} of {len(bounds)}")
        scores = [s for x in rows for w in WINDOWS for s, _ in x["found"][w]]
        if scores:
            print(f"| {change} | " + " | ".join(cells) + f" | {min(scores):.1f} | {sum(scores) / len(scores):.1f} |")
    print("\n| clip | keys, scale 1 | found at 1e-6, 1e-4, 1e-2 | greatest score | keys, all scales | found | greatest score |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for x in wrong:
        above, full = (", ".join(map(str, x[name])) for name in ("above", "above_full"))
        print(f"| {x['clip']} | {x['keys']} | {above} | {x['most']:.2f} | {x['full']} | {full} | {x['most_full']:.2f} |")


def main(words):
    pairs = [w.split("=", 1) for w in words if "=" in w]
    plain = [w for w in words if "=" not in w]
    if len(plain) == 6 and plain[0] == "detect" and pairs:
        detect_all(*plain[1:], pairs)
    elif len(plain) == 6 and plain[0] == "keys" and pairs:
        keys_all(*plain[1:], pairs)
    elif len(plain) >= 2 and plain[0] == "print":
        print_tables([json.loads(line) for path in plain[1:] for line in Path(path).read_text().splitlines()])
    else:
        sys.exit(__doc__)


main(sys.argv[1:])
