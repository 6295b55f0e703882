#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Trains the network of src/media/speech/articulatory.c and writes its weights: train_articulatory.py OUT.safetensors.

It learns from speech whose phonemes are known: espeak-ng's and flite's voices, and the labelled recordings of the Debian
package festvox-ru (one speaker, BSD-like licence). Needs PyTorch, SciPy, libespeak-ng1, flite and festvox-ru; takes about
10 minutes. No file of other people's weights is used.
"""
import argparse
import ctypes
import glob
import json
import os
import random
import re
import struct
import subprocess
import tempfile
import unicodedata
import wave

import numpy as np
import scipy.ndimage
import scipy.signal
import torch
from torch import nn

RATE, HOP, FRAME, BANDS, FLOOR = 16000, 320, 400, 40, 1e-3  # of cepstra.c
DELAY, CHANNELS, OUTPUTS, DILATIONS = 4, 40, 32, (1, 2, 4, 1, 2, 4)  # of articulatory.c; rows
PRIOR, MEMORY = 50, 500  # of articulatory.c: rows of the running mean
CROP = 200  # rows of a training example

# ---- phonemes: ten articulatory targets 0..1, and how much lips, jaw and tongue insist on them (Cohen and Massaro, 1993)
#           jaw  open round wide bilab labd tip  fric back voic  lips jaw tongue
TARGETS = {
    "sil": (.05, .05, .20, .30, .3, .0, .2, .0, .2, .0, .6, .6, .4),
    "p": (.15, .00, .20, .30, 1., .1, .2, .1, .2, .3, 2., .7, .2),
    "m": (.15, .00, .20, .30, 1., .1, .2, .0, .2, 1., 2., .7, .2),
    "f": (.15, .12, .20, .35, .2, 1., .2, .7, .2, .5, 1.6, .7, .2),
    "T": (.20, .30, .20, .40, .0, .1, .9, .5, .2, .6, .6, .6, 1.),
    "t": (.20, .35, .25, .40, .0, .0, 1., .4, .2, .4, .4, .6, 1.),
    "n": (.22, .35, .25, .40, .0, .0, 1., .0, .2, 1., .4, .6, 1.),
    "l": (.30, .40, .25, .40, .0, .0, .9, .0, .3, 1., .4, .5, 1.),
    "r": (.25, .32, .50, .30, .0, .0, .5, .1, .5, 1., .5, .5, .8),
    "s": (.08, .30, .25, .50, .0, .05, .8, 1., .2, .4, .8, 1.3, 1.),
    "S": (.10, .35, .65, .20, .0, .0, .7, 1., .3, .4, 1., 1.2, 1.),
    "k": (.25, .35, .25, .40, .0, .0, .0, .3, 1., .3, .3, .5, 1.),
    "N": (.25, .35, .25, .40, .0, .0, .0, .0, 1., 1., .3, .5, 1.),
    "h": (.35, .42, .25, .40, .0, .0, .0, .3, .5, .3, .2, .2, .3),
    "w": (.20, .12, 1., .00, .3, .0, .0, .0, .7, 1., 1.5, .7, .8),
    "j": (.20, .30, .15, .60, .0, .0, .5, .1, .2, 1., .6, .7, .8),
    "i": (.25, .35, .05, .90, .0, .0, .4, .0, .1, 1., 1., 1., 1.),
    "I": (.35, .42, .10, .65, .0, .0, .35, .0, .15, 1., .8, .8, .8),
    "e": (.42, .50, .05, .75, .0, .0, .3, .0, .2, 1., 1., 1., 1.),
    "E": (.60, .65, .05, .60, .0, .0, .2, .0, .2, 1., 1., 1., 1.),
    "{": (.80, .80, .05, .65, .0, .0, .1, .0, .2, 1., 1., 1., 1.),
    "a": (1., 1., .05, .40, .0, .0, .0, .0, .4, 1., 1.2, 1.2, 1.),
    "V": (.70, .70, .10, .35, .0, .0, .1, .0, .4, 1., .9, .9, .9),
    "O": (.75, .70, .60, .15, .0, .0, .0, .0, .6, 1., 1.1, 1.1, 1.),
    "o": (.50, .45, .80, .05, .0, .0, .0, .0, .7, 1., 1.1, 1., 1.),
    "u": (.25, .20, 1., .00, .1, .0, .0, .0, .9, 1., 1.2, 1., 1.),
    "U": (.32, .30, .70, .15, .0, .0, .0, .0, .7, 1., .9, .8, .8),
    "@": (.40, .45, .20, .35, .0, .0, .2, .0, .3, 1., .5, .5, .5),
    "y": (.25, .25, .90, .10, .05, .0, .4, .0, .1, 1., 1.1, 1., 1.),
    "2": (.42, .42, .70, .20, .0, .0, .2, .0, .2, 1., 1., 1., 1.),
    "3": (.45, .50, .40, .30, .0, .0, .4, .0, .4, 1., .9, .9, .9),
}
NAMES = list(TARGETS)
TARGET = np.array([TARGETS[name][:10] for name in NAMES], np.float32)
INSISTENCE = np.array([TARGETS[name][10:] for name in NAMES], np.float32)
GROUP = np.array([1, 0, 0, 0, 0, 0, 2, 2, 2, 2])  # of a target: 0 lips, 1 jaw, 2 tongue
REACH = np.array([.045, .055, .035])  # seconds

IPA = {}
for phoneme, letters in {
        "p": "pbɓʙ", "m": "m", "f": "fvɸβⱱɱʋ", "T": "θð", "t": "tdʈɖʔ", "n": "nɲɳ", "l": "lɫɭʎɬɮ", "r": "rɹɻɾɽʀʁ",
        "s": "szʦʣ", "S": "ʃʒʂʐɕʑʧʤ", "k": "kɡgcɟqɢ", "N": "ŋɴ", "h": "hɦxɣχħʕʝ", "w": "wʍɰɥ", "j": "j", "i": "i",
        "I": "ɪɨ", "e": "e", "E": "ɛε", "{": "æ", "a": "aɑ", "V": "ʌɐ", "O": "ɔɒ", "o": "oɤ", "u": "uʉɯ", "U": "ʊ",
        "@": "əɘᵻ", "y": "yʏ", "2": "øœɵ", "3": "ɜɝɚɞ"}.items():
    IPA.update(dict.fromkeys(letters, phoneme))
ENGLISH = dict(  # flite's names
    aa="a", ae="{", ah="V", ao="O", aw="a U", ax="@", axr="3", ay="a I", b="p", ch="t S", d="t", dh="T", dx="t", eh="E",
    el="l", em="m", en="n", er="3", ey="e I", f="f", g="k", hh="h", hv="h", ih="I", iy="i", jh="t S", k="k", l="l", m="m",
    n="n", nx="n", ng="N", ow="o U", oy="O I", p="p", r="r", s="s", sh="S", t="t", th="T", uh="U", uw="u", v="f", w="w",
    y="j", z="s", zh="S", pau="sil", brth="sil", ssil="sil", sil="sil")
RUSSIAN = dict(  # festvox-ru's
    pau="sil", a="@", ay="@", i="I", aa="a", oo="O", t="t", n="n", ae="I", j="j", s="s", r="r", k="k", ee="E", v="f", l="l",
    p="p", ll="l", m="m", ii="i", nn="n", d="t", u="U", tt="t", rr="r", z="s", e="e", ss="s", uu="u", g="k", b="p", sh="S",
    vv="f", ch="t S", zh="S", f="f", dd="t", h="h", mm="m", y="I", yy="I", c="t s", pp="p", ur="U", kk="k", sch="S",
    bb="p", zz="s", gg="k", ff="f", hh="h")


def divided(begin, end, names):
    """A span as equal spans of the phonemes `names`: [(begin, end, index)]."""
    step = (end - begin) / len(names)
    return [(begin + k * step, begin + (k + 1) * step, NAMES.index(name)) for k, name in enumerate(names)]


# ---- speech with known phonemes: (voice, samples at 16 kHz, [(begin, end, index)]) ----------------------------------


def read_wav(path):
    with wave.open(path) as file:
        samples = np.frombuffer(file.readframes(file.getnframes()), np.int16).astype(np.float32) / 32768
        rate = file.getframerate()
    return samples if rate == RATE else scipy.signal.resample_poly(samples, RATE, rate).astype(np.float32)


def sentences(folder):
    """English sentences of this machine's licences and of this project's pages."""
    found = set()
    for path in glob.glob("/usr/share/common-licenses/*") + glob.glob(os.path.join(folder, "docs/*.md")):
        text = re.sub(r"\s+", " ", open(path, errors="ignore").read())
        for sentence in re.split(r"(?<=[.!?]) ", text):
            if re.fullmatch(r"[A-Z][A-Za-z ,;'.?!-]{40,220}", sentence) and not re.search("[A-Z]{3}", sentence):
                found.add(sentence)
    return sorted(found)


class Espeak:
    """espeak-ng's library, with its phonemes in the International Phonetic Alphabet."""

    class Id(ctypes.Union):
        _fields_ = [("number", ctypes.c_int), ("name", ctypes.c_char_p), ("string", ctypes.c_char * 8)]

    class Event(ctypes.Structure):
        pass

    def __init__(self):
        self.Event._fields_ = [("type", ctypes.c_int), ("uid", ctypes.c_uint), ("text", ctypes.c_int),
                               ("length", ctypes.c_int), ("audio_ms", ctypes.c_int), ("sample", ctypes.c_int),
                               ("user", ctypes.c_void_p), ("id", self.Id)]
        self.library = ctypes.CDLL("libespeak-ng.so.1")
        self.rate = self.library.espeak_Initialize(2, 0, None, 3)  # synchronous; phonemes, as IPA
        self.sound, self.events = [], []
        self.hook = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.POINTER(ctypes.c_short), ctypes.c_int,
                                     ctypes.POINTER(self.Event))(self.take)
        self.library.espeak_SetSynthCallback(self.hook)

    def take(self, samples, count, events):
        if samples and count > 0:
            self.sound.append(np.ctypeslib.as_array(samples, (count,)).copy())
        k = 0
        while events[k].type != 0:
            if events[k].type == 7:
                self.events.append((events[k].audio_ms / 1000, bytes(events[k].id.string).decode("utf8", "ignore")))
            k += 1
        return 0

    def speak(self, voice, text, speed, pitch, pitch_range):
        self.sound.clear(), self.events.clear()
        if self.library.espeak_SetVoiceByName(voice.encode()) != 0:
            return None
        for parameter, value in ((1, speed), (3, pitch), (4, pitch_range)):
            self.library.espeak_SetParameter(parameter, value, 0)
        encoded = text.encode()
        self.library.espeak_Synth(encoded, len(encoded) + 1, 0, 1, 0, 1, None, None)
        if not self.sound:
            return None
        sound = np.concatenate(self.sound).astype(np.float32) / 32768
        spans, times = [(0, self.events[0][0], 0)] if self.events else [], [t for t, _ in self.events[1:]]
        for (begin, ipa), end in zip(self.events, times + [len(sound) / self.rate]):
            names = [IPA[c] for c in unicodedata.normalize("NFD", ipa) if c in IPA] or ["sil"]
            if end > begin:
                spans += divided(begin, end, names)
        return scipy.signal.resample_poly(sound, RATE, self.rate).astype(np.float32), spans


def espeak_voices(texts, seconds, dice):
    languages = ["en-us"] * 5 + ("en-gb-scotland en-gb-x-rp de es it pt nl ru pl sv fi cs tr da nb hu ro "
                                 "pt-br").split()
    variants = [None] + ("m1 m2 m3 m4 m5 m6 m7 m8 f1 f2 f3 f4 f5 klatt klatt2 klatt3 klatt4 Alicia Andrea Andy Annie Denis "
                         "Diogo Gene Hugo Jacky Lee Marco Mario Michael adam anika antonio belinda benjamin boris caleb "
                         "david edward gustave iven john linda max michel norbert pablo paul pedro quincy rob robert "
                         "sandro shelby steph travis victor zac whisper").split()
    espeak = Espeak()
    while seconds > 0:
        variant = dice.choice(variants)
        voice = dice.choice(languages) + ("+" + variant if variant else "")
        spoken = espeak.speak(voice, " ".join(dice.sample(texts, 2)), dice.randint(120, 230), dice.randint(15, 85),
                              dice.randint(20, 80))
        if spoken is not None and len(spoken[0]) > 3 * RATE:
            seconds -= len(spoken[0]) / RATE
            yield (voice, *spoken)


def flite_voices(texts, dice):
    for voice, seconds in (("slt", 1100), ("rms", 1100), ("awb", 900), ("kal16", 500)):
        while seconds > 0:
            with tempfile.TemporaryDirectory() as folder:
                path = os.path.join(folder, "flite.wav")
                spoken = subprocess.run(["flite", "-voice", voice, "--setf",
                                         f"duration_stretch={dice.uniform(.85, 1.25):.2f}", "-psdur", "-t",
                                         " ".join(dice.sample(texts, 2)), "-o", path],
                                        capture_output=True, text=True, check=True)
                samples = read_wav(path)
            spans, begin = [], 0
            for name, end in (word.split(":") for word in spoken.stdout.split()):
                spans += divided(begin, float(end), ENGLISH[name].split())
                begin = float(end)
            seconds -= len(samples) / RATE
            yield "flite " + voice, samples, spans


def recorded_voice():
    folder = "/usr/share/festival/voices/russian/msu_ru_nsh_clunits"
    for path in sorted(glob.glob(folder + "/lab/*.lab")):
        spans, begin = [], 0
        for line in open(path):
            words = line.split()
            if len(words) < 3 or words[0] == "#":
                continue
            spans += divided(begin, float(words[0]), RUSSIAN[words[2]].split())
            begin = float(words[0])
        yield "ru", read_wav(path.replace("/lab/", "/wav/").replace(".lab", ".wav")), spans


# ---- rows -----------------------------------------------------------------------------------------------------------


def mel_of(hertz):
    return 2595 * np.log10(1 + hertz / 700)


def hertz_of(mel):
    return 700 * (10**(mel / 2595) - 1)


def triangles():
    edge = hertz_of(np.linspace(mel_of(60), mel_of(7600), BANDS + 2))[:, None]
    hertz = np.arange(257) * RATE / 512
    weight = np.minimum((hertz - edge[:-2]) / (edge[1:-1] - edge[:-2]),
                        (edge[2:] - hertz) / (edge[2:] - edge[1:-1])).clip(0)
    return (weight / weight.sum(1, keepdims=True)).astype(np.float32)


TRIANGLES, HANN = triangles(), np.hanning(FRAME + 1)[:FRAME].astype(np.float32)


def rows_of(samples):
    """ern_cepstra_bands of each row: [rows][40], and its power in decibels below the level."""
    samples = np.pad(samples.astype(np.float32), (40, FRAME))
    frames = np.lib.stride_tricks.sliding_window_view(samples, FRAME)[::HOP][:(len(samples) - 40 - FRAME) // HOP]
    frames = frames - frames.mean(1, keepdims=True)
    power, level, levels = (frames**2).mean(1), 1e-5, []
    for value in power:
        level = max(value, level * (np.exp(-.02 / 10) if value > 1e-3 * level else 1), 1e-5)
        levels.append(level)
    levels = np.array(levels)
    spectrum = np.abs(np.fft.rfft(frames * HANN, 512))**2 / (HANN**2).sum() / levels[:, None]
    return np.log(spectrum @ TRIANGLES.T + FLOOR).astype(np.float32), 10 * np.log10(power / levels + 1e-9)


def in_a_room(samples, dice):
    """The speech faster or slower, with reverberation, band limits and noise; and the factor of its times."""
    stretch = 1.0
    if dice.random() < .7:
        stretch = round(dice.uniform(.84, 1.2), 2)
        samples = scipy.signal.resample_poly(samples, round(100 * stretch), 100)
    if dice.random() < .4:
        decay = np.arange(int(dice.uniform(.1, .6) * RATE))
        echo = dice.standard_normal(len(decay)) * np.exp(-6.9 * decay / len(decay))
        echo *= 10**(dice.uniform(-18, -4) / 20) / np.sqrt((echo**2).sum())
        echo[0] = 1
        samples = scipy.signal.fftconvolve(samples, echo)[:len(samples)]
    for share, order, low, high, kind in ((.25, 4, 3400, 7500, "low"), (.25, 2, 60, 250, "high")):
        if dice.random() < share:
            samples = scipy.signal.sosfilt(scipy.signal.butter(order, dice.uniform(low, high), kind, fs=RATE, output="sos"),
                                           samples)
    if dice.random() < .65:
        loud = np.sqrt(np.percentile(np.convolve(samples**2, np.ones(800) / 800, "same")[::400], 95))
        hertz = np.maximum(np.fft.rfftfreq(len(samples), 1 / RATE), 50)
        noise = np.fft.irfft(np.fft.rfft(dice.standard_normal(len(samples))) * hertz**(-dice.uniform(0, .6)), len(samples))
        samples = samples + noise / noise.std() * loud * 10**(-dice.uniform(12, 45) / 20)
    return samples.astype(np.float32), stretch


def truth_of(spans, rows, stretch):
    """Phoneme of each row, and its targets: the mean over the phonemes around, weighted by their dominance."""
    seconds = (np.arange(rows) + .5) / 50
    phoneme = np.zeros(rows, np.uint8)
    total, weight = np.zeros((rows, 10), np.float32), np.full((rows, 10), 1e-6, np.float32)
    for begin, end, index in spans:
        begin, end = begin * stretch, end * stretch
        half = max((end - begin) / 2, .015)
        phoneme[(seconds >= begin) & (seconds < end)] = index
        near = slice(*np.searchsorted(seconds, [begin - .3, end + .3]))
        away = np.maximum(0, np.abs(seconds[near] - (begin + end) / 2) - half / 2)[:, None]
        dominance = INSISTENCE[index] * np.exp(-(away / (REACH + .35 * half))**1.3)
        total[near] += dominance[:, GROUP] * TARGET[index]
        weight[near] += dominance[:, GROUP]
    return phoneme, total / weight


def examples(folder, hours, seed):
    """Each utterance as it is and in a room: (voice, bands, decibels, phonemes, targets)."""
    dice, numbers, texts, made = random.Random(seed), np.random.default_rng(seed), sentences(folder), []
    for speech in (espeak_voices(texts, 3600 * hours, dice), flite_voices(texts, dice), recorded_voice()):
        for voice, samples, spans in speech:
            for copy in range(2):
                heard, stretch = in_a_room(samples, numbers) if copy else (samples, 1.0)
                heard = heard * np.float32(numbers.uniform(.05, 1) / (np.abs(heard).max() + 1e-6))
                bands, decibels = rows_of(heard)
                made.append((voice, bands.astype(np.float16), decibels.astype(np.float32),
                             *truth_of(spans, len(bands), stretch)))
        print(f"{len(made)} utterances, {sum(len(m[3]) for m in made) / 180000:.2f} hours", flush=True)
    return [m for m in made if len(m[3]) > CROP]


# ---- network --------------------------------------------------------------------------------------------------------


class Block(nn.Module):

    def __init__(self, dilation):
        super().__init__()
        self.past = 2 * dilation
        self.wide = nn.Conv1d(CHANNELS, CHANNELS, 3, dilation=dilation, bias=False)
        self.norm = nn.BatchNorm1d(CHANNELS)
        self.narrow = nn.Conv1d(CHANNELS, CHANNELS, 1)

    def forward(self, x):
        return x + self.narrow(torch.relu(self.norm(self.wide(nn.functional.pad(x, (self.past, 0))))))


class Network(nn.Module):
    """[B][40][rows] -> targets [B][10][rows] and phonemes [B][31][rows] of the row DELAY before."""

    def __init__(self):
        super().__init__()
        self.input, self.input_norm = nn.Conv1d(BANDS, CHANNELS, 3), nn.BatchNorm1d(CHANNELS)
        self.blocks, self.norm = nn.ModuleList(Block(d) for d in DILATIONS), nn.BatchNorm1d(CHANNELS)
        self.output = nn.Conv1d(CHANNELS, OUTPUTS, 1)
        self.targets, self.phonemes = nn.Conv1d(OUTPUTS, 10, 1), nn.Conv1d(OUTPUTS, len(NAMES), 1)

    def forward(self, x):
        x = torch.relu(self.input_norm(self.input(nn.functional.pad(x, (2, 0)))))
        for block in self.blocks:
            x = block(x)
        x = torch.tanh(self.output(self.norm(x)))
        return self.targets(x), self.phonemes(x)


def less_running_mean(bands, decibels, mean):
    audible, fade = decibels > -30, np.exp(-1 / MEMORY)
    loud, means = bands[audible].astype(np.float64), np.repeat(mean[None], audible.sum() + 1, 0)
    if len(loud):
        begin = PRIOR * fade**np.arange(1, len(loud) + 1)[:, None]
        total = scipy.signal.lfilter([1], [1, -fade], loud, axis=0)
        count = scipy.signal.lfilter([1], [1, -fade], np.ones(len(loud)))[:, None]
        means[1:] = (begin * mean + total) / (begin + count)
    return (bands - means[np.cumsum(audible)]).astype(np.float32)


def other_throat_and_microphone(bands, dice):
    if dice.random() < .8:
        centre = hertz_of(np.linspace(mel_of(60), mel_of(7600), BANDS + 2)[1:-1]) * np.exp(dice.uniform(-.16, .16))
        place = ((mel_of(centre.clip(0, 7600)) - mel_of(60)) / ((mel_of(7600) - mel_of(60)) / (BANDS + 1)) - 1).clip(0, 38.999)
        left, part = place.astype(int), (place % 1).astype(np.float32)
        bands = bands[:, left] * (1 - part) + bands[:, left + 1] * part
    place = np.arange(BANDS) / BANDS
    bands = bands + sum(dice.normal(0, 1.2 / (k + 1)) * np.cos(np.pi * k * place + dice.uniform(0, 6)) for k in range(4))
    if dice.random() < .6:
        bands = np.logaddexp(bands, dice.uniform(-6.9, -3) + .5 * dice.standard_normal(bands.shape))
    return np.maximum(bands, np.log(FLOOR)).astype(np.float32)


def batch_of(made, mean, dice, count, changed):
    bands, phonemes = np.zeros((count, BANDS, CROP), np.float32), np.zeros((count, CROP), np.int64)
    targets = np.zeros((count, 10, CROP), np.float32)
    for k in range(count):
        _, heard, decibels, phoneme, target = made[dice.integers(len(made))]
        begin = int(dice.integers(len(phoneme) - CROP))
        before = max(0, begin - 600)  # rows for the running mean
        part, crop = slice(before, begin + CROP), slice(begin, begin + CROP)
        heard = heard[part].astype(np.float32)
        if changed:
            heard = other_throat_and_microphone(heard, dice)
        bands[k] = less_running_mean(heard, decibels[part], mean)[begin - before:].T
        target = target[crop].copy()
        loud = np.clip((scipy.ndimage.gaussian_filter1d(decibels[crop], 2) + 30) / 30, 0, 1.2)
        target[:, 0] *= .25 + .75 * loud  # who speaks softly opens the mouth less
        target[:, 1] *= .4 + .6 * loud
        phonemes[k, DELAY:], targets[k, :, DELAY:] = phoneme[crop][:-DELAY], target[:-DELAY].T
    return torch.from_numpy(bands), torch.from_numpy(phonemes), torch.from_numpy(targets)


def train(made, steps, seed):
    torch.manual_seed(seed)
    dice = np.random.default_rng(seed)
    aside = ("+f2", "+m3", "+Alicia", "+anika")
    held, made = [m for m in made if m[0].endswith(aside)], [m for m in made if not m[0].endswith(aside)]
    every = np.concatenate([m[1] for m in made[::5]]).astype(np.float32)
    mean, spread = every.mean(0).astype(np.float64), torch.from_numpy(every.std(0))[None, :, None]
    variance = torch.from_numpy(np.concatenate([m[4] for m in made[:200]])).var(0)[None, :, None]
    test, known = batch_of(held, mean, np.random.default_rng(9), 72, False), slice(30, None)  # rows with a past
    network = Network()
    optimizer = torch.optim.AdamW(network.parameters(), 3e-3, weight_decay=1e-3)
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = 3e-3 * min(1, (step + 1) / 30) * (.5 * (1 + np.cos(np.pi * step / steps)) + .01)
        bands, phonemes, targets = batch_of(made, mean, dice, 24, True)
        found, told = network(bands / spread)
        loss = ((found - targets)**2 / variance)[:, :, known].mean() + .4 * nn.functional.cross_entropy(
            told[:, :, known], phonemes[:, known], label_smoothing=.05)
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 2.0)
        optimizer.step()
        if (step + 1) % 200 == 0 or step + 1 == steps:
            network.eval()
            with torch.no_grad():
                found, told = network(test[0] / spread)
            network.train()
            right = (told.argmax(1) == test[1])[:, known].float().mean()
            jaw = np.corrcoef(found[:, 0, known].flatten(), test[2][:, 0, known].flatten())[0, 1]
            print(f"{step + 1}/{steps} loss {loss:.3f}; voices kept aside: phonemes {right:.3f}, jaw {jaw:.3f}", flush=True)
    return network.eval(), mean, spread


# ---- weights --------------------------------------------------------------------------------------------------------


def tensors_of(network, mean, spread):
    """As articulatory.c reads them: [tap][input][output], normalisations folded in."""
    values = {name: value.double().numpy() for name, value in network.state_dict().items()}

    def scale_and_shift(norm):
        scale = values[norm + ".weight"] / np.sqrt(values[norm + ".running_var"] + 1e-5)
        return scale, values[norm + ".bias"] - values[norm + ".running_mean"] * scale

    scale, shift = scale_and_shift("input_norm")
    tensors = {"mean": mean, "input": (values["input.weight"] / spread.double().numpy() * scale[:, None, None]).T,
               "input_bias": values["input.bias"] * scale + shift}
    for k in range(len(DILATIONS)):
        scale, shift = scale_and_shift(f"blocks.{k}.norm")
        tensors[f"block.{k}.wide"] = (values[f"blocks.{k}.wide.weight"] * scale[:, None, None]).T
        tensors[f"block.{k}.wide_bias"] = shift
        tensors[f"block.{k}.narrow"] = values[f"blocks.{k}.narrow.weight"][:, :, 0].T
        tensors[f"block.{k}.narrow_bias"] = values[f"blocks.{k}.narrow.bias"]
    scale, shift = scale_and_shift("norm")
    weight = values["output.weight"][:, :, 0]
    tensors["output"], tensors["output_bias"] = (weight * scale).T, values["output.bias"] + weight @ shift
    return tensors


def write(path, tensors):
    header, at, blob = {"__metadata__": {"kind": "articulatory-1"}}, 0, b""
    for name, value in tensors.items():
        half = np.ascontiguousarray(value.astype("<f2"))
        header[name] = {"dtype": "F16", "shape": list(half.shape), "data_offsets": [at, at + half.nbytes]}
        at, blob = at + half.nbytes, blob + half.tobytes()
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    with open(path, "wb") as file:
        file.write(struct.pack("<Q", len(text)) + text + blob)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out")
    parser.add_argument("--steps", type=int, default=5000)
    parser.add_argument("--hours", type=float, default=1.5, help="of espeak-ng's voices")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    folder = os.path.join(os.path.dirname(os.path.abspath(__file__)), "../..")
    made = examples(folder, arguments.hours, arguments.seed)
    write(arguments.out, tensors_of(*train(made, arguments.steps, arguments.seed)))


if __name__ == "__main__":
    main()
