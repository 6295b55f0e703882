# SPDX-License-Identifier: MIT
"""The module against what C programs make of the same input, to the bit; and what it says to wrong input.

Runs in a folder that test_module.sh has filled: clip, head.safetensors with head.run and losses.txt (steps.c),
frames.rgba and grey.ppm (render_minimal), speech.npy (`ernerf features`). Needs ERNERF_LIBRARY."""
import copy
import ctypes
import gc
import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import unittest
import unittest.mock

import numpy as np

import ernerf

STEPS = 6
OPTIONS = {"rays": 256, "levels": 4, "seed": 7}


def tensors_of(path):
    """A second reader of .safetensors."""
    with open(path, "rb") as file:
        content = file.read()
    length = int(np.frombuffer(content, "<u8", 1)[0])
    header = json.loads(content[8:8 + length])
    return {name: (tensor["dtype"], tensor["shape"], content[8 + length:][slice(*tensor["data_offsets"])])
            for name, tensor in header.items() if name != "__metadata__"}


class Module(unittest.TestCase):
    def setUp(self):
        self.context = ernerf.Context()
        self.addCleanup(self.context.close)
        self.backend = ernerf.Backend(self.context)

    def says(self, kind, *words):
        """An exception of this kind whose text has these words."""
        return self.assertRaisesRegex(kind, ".*".join(words))

    # ---- the same as C ----

    def test_frames(self):
        model = ernerf.Model(self.context, "head.safetensors")
        renderer = ernerf.Renderer(self.backend, model)
        speech = self.context.features("speech.npy")
        poses = self.context.poses("clip/transforms_val.json")
        height, width = poses.view.height, poses.view.width
        expected = np.fromfile("frames.rgba", np.uint8).reshape(-1, height, width, 4)
        head = f"P6\n{width} {height}\n255\n".encode()
        with open("grey.ppm", "rb") as file:
            grey = [np.frombuffer(file.read(len(head) + 3 * width * height)[len(head):], np.uint8) for _ in expected]
        self.assertEqual(len(expected), len(speech))
        background = np.full((height, width, 3), 96, np.uint8)
        there_and_back = [*range(len(poses.matrix)), *range(len(poses.matrix) - 2, 0, -1)]
        for t in range(0, len(speech), 3):
            view = poses.view, poses.matrix[there_and_back[t % len(there_and_back)]], renderer.windows(speech, t)
            rgba = renderer.frame(*view, "rgba")
            np.testing.assert_array_equal(rgba, expected[t])
            rgb, alpha, again = renderer.frame(*view, ["rgb", "alpha", "rgba"], background=background)
            self.assertEqual((rgb.shape, rgb.dtype, alpha.shape), ((height, width, 3), np.float32, (height, width)))
            np.testing.assert_array_equal(again[..., :3].ravel(), grey[t])
            # bytes are the nearest, in float32: 255 times 2^-24 beside the half
            np.testing.assert_allclose(rgb * np.float64(255), again[..., :3], rtol=0, atol=0.5 + 2e-5)
            np.testing.assert_array_equal(rgb, renderer.frame(*view, background=background))
        first, second = renderer.frame(*view, ["rgb", "rgb"], background=background)
        self.assertIs(first, second)
        np.testing.assert_array_equal(first, rgb)
        self.assertGreater(expected.std(), 0)

    def test_steps(self):
        with open("losses.txt", encoding="ascii") as file:
            expected = [(int(step), float.fromhex(loss)) for step, loss in (line.split() for line in file)]
        clip = ernerf.Clip(self.context, "clip")
        trainer = ernerf.Trainer(self.backend, clip, output="python.safetensors", iters=STEPS, **OPTIONS)
        reports = [trainer.step() for _ in range(STEPS)]
        self.assertEqual([(report.step, report.loss) for report in reports], expected)
        self.assertEqual(len({report.loss for report in reports}), STEPS)
        self.assertEqual((trainer.report.step, trainer.report.iters), (STEPS, STEPS))
        with self.says(ernerf.Error, str(STEPS)) as caught:
            trainer.step()
        self.assertEqual(caught.exception.status, ernerf.Status.E_STATE)
        trainer.save()
        with open("head.safetensors", "rb") as c, open("python.safetensors", "rb") as python:
            self.assertTrue(c.read() == python.read())
        same = trainer.model().tensors()
        for name, (_, shape, content) in tensors_of("head.safetensors").items():
            self.assertEqual((same[name].shape, same[name].tobytes()), (tuple(shape), content), name)

    def test_tensors(self):
        model = ernerf.Model(self.context, "head.safetensors")
        expected = tensors_of("head.safetensors")
        self.assertGreater(len(expected), 10)
        for tensors in (model.tensors(), self.context.tensors("head.safetensors")):
            self.assertEqual(list(tensors), list(expected))
            for name, (dtype, shape, content) in expected.items():
                self.assertEqual(tensors[name].tobytes(), content, name)
                self.assertEqual(tensors[name].shape, tuple(shape), name)
                self.assertTrue(dtype != "F32" or tensors[name].dtype == np.float32, name)
                self.assertFalse(tensors[name].flags.writeable, name)
        self.assertEqual((model.info.backbone, model.info.levels), (ernerf.Backbone.TRIHASH, 4))
        self.assertEqual(model.info.head_steps, STEPS)
        model.save("copy.safetensors")
        self.assertEqual(tensors_of("copy.safetensors"), expected)

    def test_clip_and_sound(self):
        clip = ernerf.Clip(self.context, "clip", asr_model="articulatory")
        file = np.load("speech.npy")
        np.testing.assert_array_equal(self.context.features("speech.npy"), file)
        np.testing.assert_array_equal(self.context.speech("clip/aud.wav"), file)
        np.testing.assert_array_equal(self.context.speech("clip/aud.wav", kind="cepstra-1"), file[:, :, :13])
        np.testing.assert_array_equal(clip.features[:len(file)], file[:len(clip.features)])
        self.assertFalse(clip.features.flags.writeable)
        with open("clip/transforms_train.json", encoding="utf-8") as text:
            transforms = json.load(text)
        self.assertEqual(clip.info.frames[ernerf.Split.TRAIN], len(transforms["frames"]))
        self.assertEqual(clip.view.focal, transforms["focal_len"])
        poses = self.context.poses("clip/transforms_train.json")
        for index, frame in enumerate(transforms["frames"]):
            matrix = np.array(frame["transform_matrix"], np.float32)
            np.testing.assert_array_equal(clip.frame(ernerf.Split.TRAIN, index).matrix, matrix)
            np.testing.assert_array_equal(poses.matrix[index], matrix)
            self.assertEqual((poses.img_id[index], poses.aud_id[index]), (frame["img_id"], frame["aud_id"]))
        first, torso = clip.pixels(ernerf.Split.TRAIN, 0)
        kept = first.copy()
        second, _ = clip.pixels(ernerf.Split.TRAIN, 5)
        np.testing.assert_array_equal(first, kept)
        self.assertGreater(np.abs(first.astype(int) - second).max(), 0)
        self.assertEqual(first.shape, (clip.view.height, clip.view.width, 3))
        self.assertEqual(torso.shape, (clip.view.height, clip.view.width, 4))
        self.assertEqual(clip.background.shape, first.shape)

    def test_dub(self):
        clip = ernerf.Clip(self.context, "clip")
        recorded, _ = clip.pixels(0, 0)
        height, width = recorded.shape[:2]
        landmarks = clip.frame(0, 0).landmarks / np.float32([width, height])
        x, y, wide, tall = self.context.dub_box(width, height, landmarks)
        self.assertTrue(0 <= x < x + wide <= width and 0 <= y < y + tall <= height and wide > 8)
        move, scattered = ctypes.memmove, np.repeat(landmarks, 2, axis=1)[:, ::2]  # not in C order: it is copied
        with unittest.mock.patch("ctypes.memmove", lambda *given: (np.full((68, 2), np.nan, np.float32), move(*given))):
            self.assertEqual(self.context.dub_box(width, height, scattered), (x, y, wide, tall))  # the copy lasts
        head = np.full((tall, wide, 4), (200, 20, 20, 255), np.uint8)
        dubbed, drawn = self.context.dub_frame(recorded, head, landmarks, recorded_head=clip.head(0, 0))
        self.assertTrue(drawn and dubbed.shape == recorded.shape)
        changed = np.argwhere((dubbed != recorded).any(axis=2))
        self.assertGreater(len(changed), 50)
        self.assertTrue((changed >= (y, x)).all() and (changed < (y + tall, x + wide)).all())
        row, column = (landmarks[48:60].mean(axis=0) * (width, height)).astype(int)[::-1]
        self.assertTrue((abs(dubbed[row, column].astype(int) - (200, 20, 20)) <= 16).all())  # the match of colours: 15
        head[..., 3] = 0
        same, drawn = self.context.dub_frame(recorded, head, landmarks)
        np.testing.assert_array_equal(same, recorded)
        self.assertFalse(drawn)
        wide_frame = np.pad(recorded, ((0, 0), (10, 6), (0, 0)))
        head[..., 3] = 255
        moved, _ = self.context.dub_frame(wide_frame, head, landmarks, square=(10, 0, width, height),
                                          recorded_head=clip.head(0, 0))
        np.testing.assert_array_equal(moved[:, 10:10 + width], dubbed)
        with self.says(ValueError, "square has 3 numbers, expected 4"):
            self.context.dub_box(width, height, landmarks, (0, 0, 4))
        with self.says(ernerf.Error, "square"):
            self.context.dub_box(width, height, landmarks, (1, 0, 0, height))
        with self.says(ernerf.Error, "head is NULL"):
            self.context.dub_frame(recorded, None, landmarks)

    def test_run(self):
        seen = []

        def stop(report):  # called after a validation, or half a second: at step 1 to 4
            seen.append(report.step)
            raise KeyboardInterrupt

        def stop_late(report):
            if report.step == report.iters:
                raise ZeroDivisionError

        clip = ernerf.Clip(self.context, "clip")
        options = {"output": "run.safetensors", "iters": 10, "validate_every": 4, "validate_frames": 1, **OPTIONS}
        with ernerf.Trainer(self.backend, clip, **options) as trainer, self.assertRaises(KeyboardInterrupt):
            trainer.run(stop)
        self.assertEqual(len(seen), 1)
        with ernerf.Trainer(self.backend, clip, resume=True, **options) as trainer:
            self.assertEqual(trainer.report.step, seen[0])
            with self.says(ernerf.Error, "step [2-8] of 10") as caught:
                trainer.run(lambda report: True)
            self.assertEqual(caught.exception.status, ernerf.Status.E_CANCELLED)
        with ernerf.Trainer(self.backend, clip, resume=True, **options) as trainer:
            with self.assertRaises(ZeroDivisionError):
                trainer.run(stop_late)
            self.assertEqual(trainer.report.step, 10)
            trainer.run()  # has nothing to do
        head = ernerf.Model(self.context, "run.safetensors")
        torso = ernerf.Trainer(self.backend, clip, head=head, torso=True, iters=1, rays=64)
        torso.step()
        self.assertTrue(torso.model().info.has_torso)

    # ---- closing ----

    def test_interrupted_training(self):
        """Ctrl-C while the library computes."""
        clip = ernerf.Clip(self.context, "clip")
        interrupt = threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT))

        def begin(_):
            if interrupt.ident is None:
                interrupt.start()

        with ernerf.Trainer(self.backend, clip, output="interrupted.safetensors", iters=10**6, **OPTIONS) as trainer:
            with self.assertRaises(KeyboardInterrupt):
                trainer.run(begin)
            self.assertLess(trainer.report.step, 10**6)
        self.assertTrue(os.path.exists("interrupted.safetensors"))
        self.assertIs(signal.getsignal(signal.SIGINT), signal.default_int_handler)

    def test_close(self):
        with ernerf.Context() as context:
            backend, model = ernerf.Backend(context), ernerf.Model(context, "head.safetensors")
            renderer, another = ernerf.Renderer(backend, model), ernerf.Model(context, "head.safetensors")
            features = context.features("speech.npy")
            clip = ernerf.Clip(context, "clip")
            background = clip.background
            expected = features.copy(), background.copy()
        for closed in (model, backend, clip, model, context, clip):  # twice, and before what needs them
            closed.close()
        view, matrix = ernerf.View(150, 16, 16, 32, 32), np.eye(4, dtype=np.float32)
        picture = renderer.frame(view, matrix, renderer.windows(features, 0))
        self.assertEqual(picture.shape, (32, 32, 3))
        self.assertIn("aabb_train", another.tensors())
        another.close()
        renderer.close()
        renderer.close()
        np.testing.assert_array_equal(features, expected[0])
        np.testing.assert_array_equal(background, expected[1])
        self.assertFalse(context._held == [])  # the arrays need it
        del features, background
        gc.collect()
        self.assertEqual((context._held, model._held, clip._held, renderer._held), ([], [], [], []))
        windows = np.zeros((8, 16, 45), np.float32)
        for what, use in (("Model", lambda: model.save("none.safetensors")), ("Clip", lambda: clip.features),
                          ("Backend", lambda: backend.info), ("Context", lambda: context.features("speech.npy")),
                          ("Renderer", lambda: renderer.frame(view, matrix, windows)),
                          ("Context", lambda: ernerf.Model(context, "head.safetensors")),
                          ("Context", lambda: context.tensors("head.safetensors"))):
            with (unittest.mock.patch.object(sys, "unraisablehook") as unraisable,
                  self.says(ValueError, f"the {what} is closed")):
                use()
            unraisable.assert_not_called()  # by what was made in vain

    def test_close_in_callbacks(self):
        """What a callback closes is freed after the call."""
        with ernerf.Context() as context, ernerf.Backend(context) as backend, ernerf.Clip(context, "clip") as clip:
            trainer = ernerf.Trainer(backend, clip, iters=10, validate_every=4, validate_frames=1, **OPTIONS)
            with self.says(ernerf.Error, "of 10") as caught:
                trainer.run(lambda report: trainer.close())
            self.assertEqual(caught.exception.status, ernerf.Status.E_CANCELLED)
            self.assertEqual(trainer._held, [])
            with self.says(ValueError, "the Trainer is closed"):
                trainer.step()
            for use in ("step", "run"):
                trainer = ernerf.Trainer(backend, clip, iters=10, validate_every=4, validate_frames=1, **OPTIONS)
                with self.says(ValueError, rf"the Trainer is in run\(\), expected {use}\(\)"):
                    trainer.run(lambda report: getattr(trainer, use)())
                done = trainer.report.step
                self.assertEqual(trainer.step().step, done + 1)
        context = ernerf.Context(log=lambda level, line: context.close())
        backend = ernerf.Backend(context)
        self.assertTrue(context.closed and context._held)
        backend.close()
        self.assertEqual(context._held, [])

    def test_fork(self):
        """A child process has no threads of its parent's: it neither waits for them nor draws."""
        program = """
import os, sys, ernerf, numpy
context = ernerf.Context()
renderer = ernerf.Renderer(ernerf.Backend(context), ernerf.Model(context, "head.safetensors"), threads=2)
windows = renderer.windows(context.features("speech.npy"), 0)
def frame():
    return renderer.frame(ernerf.View(150, 16, 16, 32, 32), numpy.eye(4, dtype=numpy.float32), windows)
frame()
child = os.fork()
if child == 0:
    try:
        frame()
    except ValueError as error:
        sys.exit(7 if "the Renderer was made before os.fork()" in str(error) else 8)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
        with subprocess.Popen([sys.executable, "-c", program], start_new_session=True) as process:
            try:
                self.assertEqual(process.wait(60), 7)
            finally:
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGKILL)

    def test_threads(self):
        model = ernerf.Model(self.context, "head.safetensors")
        speech, pictures = self.context.features("speech.npy"), [None] * 4
        view, matrix = ernerf.View(150, 16, 16, 32, 32), np.eye(4, dtype=np.float32)

        def draw(number):
            with ernerf.Renderer(self.backend, model, threads=1) as renderer:
                for _ in range(5):
                    pictures[number] = renderer.frame(view, matrix, renderer.windows(speech, 3))

        threads = [threading.Thread(target=draw, args=(number,)) for number in range(len(pictures))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for picture in pictures:
            np.testing.assert_array_equal(picture, pictures[0])

    def test_one_thread_at_a_time(self):
        """A second thread is refused: both would write to the memory of one object."""
        clip, refused = ernerf.Clip(self.context, "clip"), []
        trainer = ernerf.Trainer(self.backend, clip, iters=10, validate_every=4, validate_frames=1, **OPTIONS)

        def use():
            for call in (trainer.model, lambda: clip.pixels(ernerf.Split.TRAIN, 0)):
                try:
                    call()
                except ValueError as error:
                    refused.append(str(error))

        def progress(_):
            thread = threading.Thread(target=use)
            thread.start()
            thread.join()
            return True

        with self.says(ernerf.Error, "of 10"):
            trainer.run(progress)
        clip.pixels(ernerf.Split.TRAIN, 0)
        self.assertEqual(refused, [f"another thread is in a call on the {name}, expected one at a time"
                                   for name in ("Trainer", "Clip")])

    # ---- wrong input ----

    def test_files(self):
        for name, status, use in (
                ("none.safetensors", "E_MISSING", lambda: ernerf.Model(self.context, "none.safetensors")),
                ("speech.npy", "E_FORMAT", lambda: ernerf.Model(self.context, "speech.npy")),
                ("losses.txt", "E_FORMAT", lambda: self.context.tensors("losses.txt")),
                ("none.wav", "E_MISSING", lambda: self.context.speech("none.wav")),
                ("none", "E_MISSING", lambda: ernerf.Clip(self.context, "none")),
                ("head.safetensors", "E_EXISTS", lambda: ernerf.Trainer(
                    self.backend, ernerf.Clip(self.context, "clip"), output="head.safetensors"))):
            with self.says(ernerf.Error, name) as caught:
                use()
            self.assertEqual(caught.exception.status.name, status)
        with self.says(ValueError, "null character"):
            ernerf.Model(self.context, "head\0.safetensors")
        with self.says(OSError, "none.so", "ERNERF_LIBRARY"):
            ernerf.Context(library="./none.so")

    def test_arguments(self):
        model = ernerf.Model(self.context, "head.safetensors")
        renderer = ernerf.Renderer(self.backend, model)
        speech = self.context.features("speech.npy")
        view, matrix = ernerf.View(150, 16, 16, 32, 32), np.eye(4, dtype=np.float32)
        windows = renderer.windows(speech, 0)
        clip = ernerf.Clip(self.context, "clip")

        def frame(view=view, matrix=matrix, windows=windows, outputs="rgb", **others):
            return renderer.frame(view, matrix, windows, outputs, **others)

        frame()
        np.testing.assert_array_equal(frame(windows=np.asfortranarray(windows)), frame())
        for kind, words, use in (
                (TypeError, ("matrix", "float64", "expected float32"), lambda: frame(matrix=np.eye(4))),
                (TypeError, ("matrix", "list", "NumPy"), lambda: frame(matrix=[[1]])),
                (TypeError, ("matrix", "MaskedArray", "NumPy"), lambda: frame(matrix=np.ma.masked_array(np.eye(4, dtype="f4")))),
                (ValueError, ("matrix", "3, 3", "expected", "4, 4"), lambda: frame(matrix=matrix[:3, :3])),
                (ValueError, ("windows", r"expected \(8, any, 45\)"), lambda: frame(windows=windows[:, :, :4])),
                (ValueError, ("background", "16, 32, 3"), lambda: frame(background=np.zeros((16, 32, 3), np.uint8))),
                (TypeError, ("torso", "int64", "uint8"), lambda: frame(torso=np.zeros((32, 32, 4), int))),
                (ValueError, ("output 'colour'", "rgb"), lambda: frame(outputs="colour")),
                (ValueError, ("9000 x 32 pixels", "8192"), lambda: frame(view._replace(width=9000))),
                (ValueError, ("individual is -1", "range"), lambda: frame(individual=-1)),
                (ernerf.Error, ("eye",), lambda: frame(eye=2.0)),
                (TypeError, ("frame: eye is '1', expected a number",), lambda: frame(eye="1")),
                (TypeError, ("eye is True, expected a number",), lambda: frame(eye=True)),
                (TypeError, ("individual is 1.0, expected an integer",), lambda: frame(individual=1.0)),
                (TypeError, ("view: focal is '150', expected a number",), lambda: frame(view._replace(focal="150"))),
                (TypeError, ("height is '32', expected an integer",), lambda: frame(view._replace(height="32"))),
                (TypeError, ("index is '0', expected an integer",), lambda: renderer.windows(speech, "0")),
                (TypeError, ("warp is '1', expected a number",), lambda: self.context.speech("clip/aud.wav", "1")),
                (ValueError, ("kind: holds a null character",),
                 lambda: self.context.speech("clip/aud.wav", kind="cepstra-1\0x")),
                (ernerf.Error, ('kind is "hubert"',), lambda: self.context.speech("clip/aud.wav", kind="hubert")),
                (TypeError, ("image_scale is '1', expected a number",),
                 lambda: ernerf.Renderer(self.backend, model, image_scale="1")),
                (TypeError, ("iters is '9', expected an integer",),
                 lambda: ernerf.Trainer(self.backend, clip, iters="9")),
                (ernerf.Error, ("pose",), lambda: frame(matrix=np.full((4, 4), np.nan, np.float32))),
                (ernerf.Error, ("features", "45"), lambda: renderer.windows(speech[:, :, :4], 0)),
                (TypeError, ("Renderer has no option steps", "max_steps"),
                 lambda: ernerf.Renderer(self.backend, model, steps=3)),
                (ValueError, ("threads is 4294967297",),
                 lambda: ernerf.Renderer(self.backend, model, threads=2**32 + 1)),
                (TypeError, ("smooth_lips is 1", "True or False"),
                 lambda: ernerf.Renderer(self.backend, model, smooth_lips=1)),
                (ernerf.Error, ("max_steps",), lambda: ernerf.Renderer(self.backend, model, max_steps=-3)),
                (ernerf.Error, ("instruction set", "none"), lambda: ernerf.Backend(self.context, isa="none")),
                (TypeError, ("Trainer has no option fine_loss",),
                 lambda: ernerf.Trainer(self.backend, clip, fine_loss=1)),
                (ValueError, ("iters is -1",), lambda: ernerf.Trainer(self.backend, clip, iters=-1)),
                (TypeError, ("context: Backend, expected a Context",),
                 lambda: ernerf.Model(self.backend, "head.safetensors")),
                (TypeError, ("context: Model, expected a Context",), lambda: ernerf.Clip(model, "clip")),
                (TypeError, ("context: Model, expected a Context",), lambda: ernerf.Backend(model)),
                (TypeError, ("backend: Model, expected a Backend",), lambda: ernerf.Renderer(model, self.backend)),
                (TypeError, ("model: Clip, expected a Model",), lambda: ernerf.Renderer(self.backend, clip)),
                (TypeError, ("backend: Model, expected a Backend",), lambda: ernerf.Trainer(model, clip)),
                (TypeError, ("clip: Model, expected a Clip",), lambda: ernerf.Trainer(self.backend, model)),
                (TypeError, ("head: Clip, expected a Model",), lambda: ernerf.Trainer(self.backend, clip, clip)),
                (ValueError, ("speech.npy: expected a .safetensors file",), lambda: self.context.tensors("speech.npy")),
                (TypeError, ("log is 5, expected a function",), lambda: ernerf.Context(log=5)),
                (TypeError, ("a Renderer cannot be copied",), lambda: copy.copy(renderer)),
                (TypeError, ("a Model cannot be copied",), lambda: copy.deepcopy([model])),
                (TypeError, ("a Context cannot be copied",), lambda: pickle.dumps(self.context)),
                (IndexError, ("frame 10000 of",), lambda: clip.frame(ernerf.Split.VAL, 10000)),
                (ernerf.Error, ("10000",), lambda: clip.pixels(ernerf.Split.VAL, 10000))):
            with self.subTest(words), self.says(kind, *words):
                use()
        frame()

    def test_log(self):
        lines = []
        with ernerf.Context(log=lambda level, line: lines.append((level, line))) as context:
            ernerf.Backend(context)
        self.assertTrue(lines)
        self.assertTrue(all(isinstance(level, ernerf.LogLevel) and isinstance(line, str) for level, line in lines))

    def test_version(self):
        version = ctypes.CDLL(os.environ["ERNERF_LIBRARY"]).ern_version
        version.restype = ctypes.c_char_p
        self.assertEqual(version().decode(), ernerf.__version__)


if __name__ == "__main__":
    unittest.main()
