# SPDX-License-Identifier: MIT
"""Talking portraits with libernerf: models, rendering, training and speech features, as NumPy arrays.

    with ernerf.Context() as context, ernerf.Backend(context) as backend:
        model = ernerf.Model(context, "portrait.safetensors")
        renderer = ernerf.Renderer(backend, model)
        speech = context.speech("speech.wav")
        poses = context.poses("transforms_val.json")
        rgb = renderer.frame(poses.view, poses.matrix[0], renderer.windows(speech, 0))  # [height, width, 3]

What a class or option means is said in include/ernerf/*.h, in the comment of the C function or struct. One thread at a
time uses a Renderer, a Trainer or a Clip; threads may share all else. Calls release Python's global lock.

Objects may be closed in any order and any number of times: by close(), by `with`, or by Python when nothing refers to
them. An object's memory is freed once all that was made from it is closed too; an array that shows its memory counts.
No other thread may be in a call on an object that is closed.
"""
import contextlib
import ctypes
import json
import numbers
import operator
import os
import signal
import tempfile
import threading
from collections import namedtuple
from types import SimpleNamespace

import numpy as np

from . import _c
from ._c import Attention, AudioPad, Backbone, EyeAttention, LogLevel, Precision, RaySampling, Split, Status

__version__ = "0.1.0"
__all__ = ["Attention", "AudioPad", "Backbone", "Backend", "Clip", "Context", "Error", "EyeAttention", "LogLevel",
           "Model", "Poses", "Precision", "RaySampling", "Renderer", "Split", "Status", "Trainer", "View"]

View = namedtuple("View", "focal cx cy width height")  # pixels
Poses = namedtuple("Poses", "view img_id aud_id matrix")  # int64 [n], int64 [n], float32 [n, 4, 4] camera to world

_DTYPES = {"F64": "<f8", "F32": "<f4", "F16": "<f2", "I64": "<i8", "I32": "<i4", "I16": "<i2", "I8": "i1",
           "U64": "<u8", "U32": "<u4", "U16": "<u2", "U8": "u1", "BOOL": "?"}
_ENUMS = {"backbone": Backbone, "attention": Attention, "eye_attention": EyeAttention, "audio_pad": AudioPad}
_OUTPUTS = {"rgba": (np.uint8, 4), "rgb": (np.float32, 3), "alpha": (np.float32,), "opacity": (np.float32,),
            "depth": (np.float32,), "attention": (np.float32,), "eye": (np.float32,)}
_INDIVIDUAL_MEAN = ctypes.c_size_t(-1).value
_MOTION_SIDE = 16  # ERN_MOTION_SIDE
_SIDE_MOST = 8192


class Error(Exception):
    """An error of the library: its sentence, and `status`, its code."""

    def __init__(self, status, message):
        super().__init__(message or status.name)
        self.status = status


# ---- arguments -------------------------------------------------------------------------------------------------------

def _path(value, name):
    encoded = os.fsencode(value)
    if b"\0" in encoded:  # where C would take it to end
        raise ValueError(f"{name}: holds a null character")
    return encoded


def _text(value, name):
    if not isinstance(value, str):
        raise TypeError(f"{name} is {value!r}, expected a str")
    return _path(value, name)


def _real(value, name):
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, numbers.Real):
        raise TypeError(f"{name} is {value!r}, expected a number")
    return float(value)


def _integer(value, name, kind=ctypes.c_size_t):
    if isinstance(value, (bool, np.bool_)) or not hasattr(value, "__index__"):
        raise TypeError(f"{name} is {value!r}, expected an integer")
    number = operator.index(value)
    if kind(number).value != number:
        raise ValueError(f"{name} is {number}, which is out of range")
    return number


def _array(value, name, dtype, *shape):
    """`value` as it is, or an aligned copy in C order; None in `shape` is any size."""
    if not isinstance(value, np.ndarray) or isinstance(value, np.ma.MaskedArray):  # C would not see the mask
        raise TypeError(f"{name}: {type(value).__name__}, expected a NumPy array")
    if value.dtype != dtype:
        raise TypeError(f"{name}: dtype {value.dtype}, expected {np.dtype(dtype).name}")
    if value.ndim != len(shape) or any(want not in (None, is_) for want, is_ in zip(shape, value.shape)):
        expected = ", ".join("any" if size is None else str(size) for size in shape)
        raise ValueError(f"{name}: shape {value.shape}, expected ({expected})")
    return np.require(value, requirements=("C", "ALIGNED"))


def _object(value, kind, name):
    """`value`, of which the C library could not tell that it is an object of another kind."""
    if not isinstance(value, kind):
        raise TypeError(f"{name}: {type(value).__name__}, expected a {kind.__name__}")
    return value


def _pointer(array):
    kinds = {"float32": ctypes.c_float, "uint8": ctypes.c_uint8}
    return array.ctypes.data_as(ctypes.POINTER(kinds[array.dtype.name]))


def _set(struct, name, value, where):
    """Sets a member of a struct, checked: ctypes itself truncates numbers without an error."""
    kind = dict(struct._fields_)[name]
    label = f"{where}: {name}"
    if kind is ctypes.c_char_p:
        value = None if value is None else _path(value, label)
    elif kind is ctypes.c_bool:
        if not isinstance(value, (bool, np.bool_)):
            raise TypeError(f"{label} is {value!r}, expected True or False")
    elif kind in (ctypes.c_float, ctypes.c_double):
        value = _real(value, label)
    else:
        value = _integer(value, label, kind)
    setattr(struct, name, value)


def _filled(fill, kind, options, where, without=()):
    """A configuration with its defaults and the options given by name; `from_` is `from`, a word of Python's."""
    struct = kind()
    fill(ctypes.byref(struct), ctypes.sizeof(struct))
    taken = [name for name, _ in kind._fields_ if name not in ("cookie", "size", *without)]
    for option, value in options.items():
        name = option.rstrip("_")
        if name not in taken:
            raise TypeError(f"{where} has no option {option}; it has {', '.join(taken)}")
        _set(struct, name, value, where)
    return struct


def _plain(name, value):
    """A member of a struct as a value of Python."""
    if isinstance(value, bytes):
        return value.decode(errors="replace")
    if isinstance(value, ctypes.Array):
        return tuple(value)
    return _ENUMS[name](value) if name in _ENUMS else value


def _values(struct):
    return SimpleNamespace(**{name: _plain(name, getattr(struct, name)) for name, _ in struct._fields_})


def _described(describe, handle, kind):
    struct = kind()
    describe(handle, ctypes.byref(struct), ctypes.sizeof(struct))
    return _values(struct)


@contextlib.contextmanager
def _interrupts(raised):
    """In this context Ctrl-C appends a KeyboardInterrupt to `raised`. Python would raise it at the beginning of a
    callback, where ctypes prints and drops exceptions. A program's own handler of SIGINT stays."""
    if (threading.current_thread() is not threading.main_thread()
            or signal.getsignal(signal.SIGINT) is not signal.default_int_handler):
        yield
        return
    signal.signal(signal.SIGINT, lambda *_: raised.append(KeyboardInterrupt()))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


# ---- objects ---------------------------------------------------------------------------------------------------------

class _Object:
    """An object of the C library, and how it is freed: when it is closed and has no users any more. A call is a user."""

    _held = None
    _has_threads = False  # which a child process of os.fork() lacks
    _lock = None  # of an object that one thread at a time may use

    def _own(self, free, handle, *parents):
        """Before the call that makes the object, so that the parents last."""
        self._held, self._users, self._parents, self.closed = [(free, handle)], {}, parents, False
        self._process = os.getpid()
        for parent in parents:
            parent._users[id(self)] = True

    @property
    def _handle(self):
        if self.closed:
            raise ValueError(f"the {type(self).__name__} is closed")
        if self._has_threads and self._process != os.getpid():
            raise ValueError(f"the {type(self).__name__} was made before os.fork(), expected one of this process")
        return self._lasting_handle

    @property
    def _lasting_handle(self):
        """That of a closed object too, as long as it has users."""
        return self._held[0][1]

    def _leave(self, user):
        self._users.pop(id(user), None)
        self._free_unused()

    def _free_unused(self):
        if not self.closed or self._users or self._process != os.getpid():  # freeing would wait for its threads
            return
        try:
            free, handle = self._held.pop()  # only one thread gets it
        except IndexError:
            return
        free(ctypes.byref(handle))
        for parent in self._parents:
            parent._leave(self)

    def close(self):
        """Closes the object; once more does nothing."""
        if self._held is not None:
            self.closed = True
            self._free_unused()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def __del__(self):
        self.close()

    def __reduce_ex__(self, _):  # copy and pickle: both objects would free the same handle
        raise TypeError(f"a {type(self).__name__} cannot be copied or pickled")


class _Memory:
    """An object's memory as an array, which keeps the object from being freed."""

    def __init__(self, owner, pointer, shape, writable=False):
        address = ctypes.cast(pointer, ctypes.c_void_p).value
        kind = np.dtype(pointer._type_)
        self.__array_interface__ = {"version": 3, "data": (address, not writable), "shape": tuple(shape),
                                    "typestr": kind.str}
        self._owner = owner
        owner._users[id(self)] = True

    def __del__(self):
        self._owner._leave(self)


class Context(_Object):
    """Receives errors and the log; all other objects are made from one.

    library: the file of libernerf; None: the file that ERNERF_LIBRARY names, else the one that the loader finds.
    log: called with a LogLevel and a line, perhaps in several threads.
    keep_files: a function that writes a file does not replace one.
    """

    def __init__(self, library=None, log=None, keep_files=False):
        if log is not None and not callable(log):
            raise TypeError(f"log is {log!r}, expected a function or None")
        self._engine = _c.open_engine(library)
        self._media_library = None
        config = _filled(self._engine.ern_context_config_fill, _c.ContextConfig, {"keep_files": keep_files}, "Context")
        if log is not None:
            config.log = _c.LOG(lambda _, level, line: log(LogLevel(level), line.decode(errors="replace")))
            self._log = config.log
        handle = ctypes.c_void_p()
        status = self._engine.ern_context_create(ctypes.byref(handle), ctypes.byref(config))
        if status:
            raise Error(Status(status), None)
        self._own(self._engine.ern_context_free, handle)

    @property
    def _media(self):
        if self._media_library is None:
            self._media_library = _c.open_media(self._engine)
        return self._media_library

    def _call(self, function, *arguments):
        """Calls with the handles of objects among the arguments. What a callback closes is freed after the call."""
        handles = [value._handle if isinstance(value, _Object) else value for value in arguments]
        objects = [self, *(value for value in arguments if isinstance(value, _Object))]
        for used in objects:
            used._users[id(handles)] = True
        locked = []
        try:
            for used in [*objects, *(parent for used in objects for parent in used._parents)]:  # a trainer's clip
                if used._lock is not None:
                    if not used._lock.acquire(blocking=False):
                        raise ValueError(f"another thread is in a call on the {type(used).__name__}, expected one at a time")
                    locked.append(used._lock)
            status = function(*handles)
            if status:
                text = ctypes.create_string_buffer(4096)
                self._engine.ern_last_error_copy(self._lasting_handle, text, len(text))
                raise Error(Status(status), text.value.decode(errors="replace"))
        finally:
            for lock in locked:
                lock.release()
            for used in objects:
                used._leave(handles)

    def _features_of(self, function, *arguments):
        features, owner, context = _c.Features(), _Object(), self._handle
        owner._own(lambda pointer: self._engine.ern_features_free(context, pointer), features, self)
        self._call(function, self, *arguments, ctypes.byref(features))
        array = _features_array(owner, features, writable=True)
        owner.close()  # the array is its user
        return array

    def features(self, path):
        """Speech features of a .npy file, float32 [windows, window_length, width]."""
        return self._features_of(self._engine.ern_features_load, _path(path, "path"))

    def speech(self, path, warp=1.0, kind="articulatory-1"):
        """The speech features of a sound file, float32 [windows, 16, 45], or 13 wide of the kind "cepstra-1"."""
        return self._features_of(self._media.ern_speech_features_kind, _path(path, "path"), _text(kind, "kind"),
                                 _real(warp, "warp"))

    def dub_box(self, width, height, landmarks, square=None):
        """x, y, width and height of the part of a frame that dub_frame may draw on; width 0: none.

        landmarks: float32 [68, 2], in shares of the square. square: x, y, width, height in the frame, pixels; None: all
        of it.
        """
        given = _dub_input(width, height, landmarks, square)
        self._call(self._media.ern_dub_box_sized, self, ctypes.byref(given), ctypes.sizeof(given), given.box)
        return tuple(given.box)

    def dub_frame(self, recorded, head, landmarks, *, square=None, head_scale=(1.0, 1.0), recorded_head=None):
        """A recorded frame with the rendered lower face in it, uint8 [height, width, 3], and whether anything is drawn.

        recorded: uint8 [height, width, 3]. landmarks, square: of dub_box. head: uint8 [any, any, 4], rendered for the
        box of dub_box, its alpha the "opacity" of Renderer.frame; None where that box is empty. head_scale: pixels of
        `head` a pixel of the frame, across and down. recorded_head: uint8 [any, any] of the square, 255 where the
        recorded head is (Clip.head), or None.
        """
        recorded = _array(recorded, "recorded", np.uint8, None, None, 3)
        height, width = recorded.shape[:2]
        given = _dub_input(width, height, landmarks, square)
        given.recorded = _pointer(recorded)
        given.box[:] = self.dub_box(width, height, landmarks, square)
        across, down = head_scale
        given.head_scale[:] = _real(across, "head_scale"), _real(down, "head_scale")
        if head is not None:
            head = _array(head, "head", np.uint8, None, None, 4)
            given.head, (given.head_height, given.head_width) = _pointer(head), head.shape[:2]
        if recorded_head is not None:
            recorded_head = _array(recorded_head, "recorded_head", np.uint8, None, None)
            there = _c.Image(recorded_head.shape[1], recorded_head.shape[0], 1, _pointer(recorded_head))
            given.recorded_head = ctypes.pointer(there)
        rgba, drawn = np.empty((height, width, 4), np.uint8), ctypes.c_bool()
        self._call(self._media.ern_dub_frame_sized, self, ctypes.byref(given), ctypes.sizeof(given), _pointer(rgba),
                   ctypes.byref(drawn))
        return rgba[..., :3], drawn.value

    def poses(self, path):
        """The Poses of a transforms file."""
        poses = _c.PoseList()
        self._call(self._engine.ern_pose_list_load, self, _path(path, "path"), ctypes.byref(poses))
        rows = np.array(np.ctypeslib.as_array(poses.poses, (poses.count,)))
        view = View(poses.focal, poses.cx, poses.cy, poses.width, poses.height)
        self._engine.ern_pose_list_free(self._handle, ctypes.byref(poses))
        return Poses(view, rows["img_id"], rows["aud_id"], rows["matrix"].reshape(-1, 4, 4))

    def tensors(self, path):
        """The tensors of a .safetensors file by name, mapped into memory and read when they are used."""
        return self._tensors(self._handle, path)

    def _tensors(self, handle, path):
        checked = _c.SAY_TENSOR(lambda *_: None)
        self._call(self._engine.ern_file_tensors, handle, _path(path, "path"), checked, None)
        with open(path, "rb") as file:
            length = int.from_bytes(file.read(8), "little")
            if length > os.fstat(file.fileno()).st_size:  # a .pth or .npy file, which the check accepts too
                raise ValueError(f"{path}: expected a .safetensors file")
            header = json.loads(file.read(length))
        header.pop("__metadata__", None)
        data = np.memmap(path, np.uint8, "r", 8 + length)
        tensors = {}
        for name, tensor in header.items():
            if tensor["dtype"] not in _DTYPES:
                raise ValueError(f"{path}: tensor {name} is {tensor['dtype']}, for which NumPy has no type")
            begin, end = tensor["data_offsets"]
            tensors[name] = data[begin:end].view(_DTYPES[tensor["dtype"]]).reshape(tensor["shape"])
        return tensors


def _features_array(owner, features, writable=False):
    shape = features.windows, features.window_length, features.width
    return np.asarray(_Memory(owner, features.data, shape, writable))


def _features_struct(array, name):
    """The C struct of an array, which must outlive it."""
    array = _array(array, name, np.float32, None, None, None)
    windows, length, width = array.shape
    return _c.Features(_pointer(array), windows, length, width), array


def _dub_input(width, height, landmarks, square):
    given = _c.DubInput(width=_integer(width, "width", ctypes.c_int), height=_integer(height, "height", ctypes.c_int))
    square = (0, 0, width, height) if square is None else tuple(square)
    if len(square) != 4:
        raise ValueError(f"square has {len(square)} numbers, expected 4: x, y, width, height")
    given.square[:] = [_integer(side, "square", ctypes.c_int) for side in square]
    landmarks = _array(landmarks, "landmarks", np.float32, 68, 2)  # a copy may be, which must last
    ctypes.memmove(given.landmarks, landmarks.ctypes.data, landmarks.nbytes)
    return given


class Backend(_Object):
    """A backend that computes models; options: name, isa, device, deterministic, tune (struct ern_backend_config)."""

    def __init__(self, context, **options):
        engine, handle = _object(context, Context, "context")._engine, ctypes.c_void_p()
        config = _filled(engine.ern_backend_config_fill, _c.BackendConfig, options, "Backend")
        self._own(engine.ern_backend_free, handle, context)
        context._call(engine.ern_backend_create, ctypes.byref(handle), context, ctypes.byref(config))
        self._context = context

    @property
    def info(self):
        """name, isa, real_bytes, deterministic, threads (struct ern_backend_info)."""
        return _described(self._context._engine.ern_backend_describe_sized, self._handle, _c.BackendInfo)


class Model(_Object):
    """A trained portrait: a .safetensors file, or a .pth checkpoint of the public program."""

    def __init__(self, context, path):
        _object(context, Context, "context")
        self._make(context, lambda handle: context._call(context._engine.ern_model_load, handle, context,
                                                         _path(path, "path")))

    def _make(self, context, load):
        handle = ctypes.c_void_p()
        self._own(context._engine.ern_model_free, handle, context)
        load(ctypes.byref(handle))
        self._context = context
        self.info = _described(context._engine.ern_model_describe_sized, handle, _c.ModelInfo)
        return self

    def save(self, path):
        """Writes the model as a .safetensors file."""
        self._context._call(self._context._engine.ern_model_save, self, _path(path, "path"))

    def tensors(self):
        """The model's tensors by name, as read-only arrays: those that save() writes. Uses a temporary file."""
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "model.safetensors")
            self.save(path)
            return self._context._tensors(self._context._lasting_handle, path)


class Renderer(_Object):
    """Draws frames of a model; options as in struct ern_render_options."""

    _has_threads = True

    def __init__(self, backend, model, **options):
        context = _object(backend, Backend, "backend")._context
        _object(model, Model, "model")
        engine, handle = context._engine, ctypes.c_void_p()
        options = _filled(engine.ern_render_options_fill, _c.RenderOptions, options, "Renderer")
        self._own(engine.ern_renderer_free, handle, backend, model)
        self._lock = threading.RLock()
        context._call(engine.ern_renderer_create, ctypes.byref(handle), backend, model,
                      ctypes.byref(options))
        self._context, self._info = context, model.info

    def windows(self, features, index):
        """The speech input of a frame: the windows index-4 .. index+3, float32 [8, window_length, width]."""
        struct, kept = _features_struct(features, "features")
        self._context._call(self._context._engine.ern_renderer_accepts, self, ctypes.byref(struct), b"features")
        windows = np.empty((8, *kept.shape[1:]), np.float32)
        self._context._engine.ern_audio_windows(_pointer(windows), ctypes.byref(struct),
                                                _integer(index, "index", ctypes.c_int64), self._info.audio_pad)
        return windows

    def frame(self, view, matrix, windows, outputs="rgb", *, background=None, torso=None, eye=0.0, individual=None,
              torso_motion=None):
        """Draws a frame.

        view: a View, such as that of Poses or of a Clip, or anything with its members.
        matrix: float32 [4, 4], camera to world, as in a transforms file.
        windows: of Renderer.windows.
        outputs: members of struct ern_frame_output: a name gives an array, a list of names a list of arrays. "rgb" is
            float32 [height, width, 3] in 0..1, "rgba" uint8 [height, width, 4], the others float32 [height, width].
        background, torso: uint8 [height, width, 3] and [height, width, 4], or None; eye: 0 open .. 1 closed;
            individual: a row of the individual codes, None: their mean; torso_motion: that of a frame of the clip,
            None: predicted (struct ern_frame_input).
        """
        one = isinstance(outputs, str)
        height, width = _integer(view.height, "height", ctypes.c_int), _integer(view.width, "width", ctypes.c_int)
        if not (0 < height <= _SIDE_MOST and 0 < width <= _SIDE_MOST):
            raise ValueError(f"{width} x {height} pixels, expected sides of 1 to {_SIDE_MOST}")
        matrix = _array(matrix, "matrix", np.float32, 4, 4)
        windows = _array(windows, "windows", np.float32, 8, None, self._info.feature_width)
        given = _c.FrameInput(windows=_pointer(windows), window_length=windows.shape[1])
        _set(given, "eye", eye, "frame")
        _set(given, "individual", _INDIVIDUAL_MEAN if individual is None else individual, "frame")
        if background is not None:
            background = _array(background, "background", np.uint8, height, width, 3)
            given.background = _pointer(background)
        if torso is not None:
            torso = _array(torso, "torso", np.uint8, height, width, 4)
            given.torso = _pointer(torso)
        if torso_motion is not None:
            torso_motion = _array(torso_motion, "torso_motion", np.float32, 2, _MOTION_SIDE, _MOTION_SIDE)
            given.torso_motion = _pointer(torso_motion)
        camera = given.camera
        for name in View._fields:
            _set(camera, name, getattr(view, name), "view")
        self._context._engine.ern_camera_pose(camera.pose, _pointer(matrix), self._info.scale)
        wanted, arrays, names = _c.FrameOutput(), {}, [outputs] if one else list(outputs)
        for name in names:
            if name not in _OUTPUTS:
                raise ValueError(f"there is no output {name!r}; there are {', '.join(_OUTPUTS)}")
            dtype, *channels = _OUTPUTS[name]
            arrays[name] = np.empty((height, width, *channels), dtype)
            setattr(wanted, name, _pointer(arrays[name]))
        self._context._call(self._context._engine.ern_renderer_frame_sized, self, ctypes.byref(given),
                            ctypes.sizeof(given), ctypes.byref(wanted), ctypes.sizeof(wanted), None, 0)
        return arrays[outputs] if one else [arrays[name] for name in names]


class Clip(_Object):
    """A folder of frames, poses and speech; options: memory_bytes, features, asr_model (struct ern_clip_options)."""

    def __init__(self, context, folder, **options):
        self._media, handle = _object(context, Context, "context")._media, ctypes.c_void_p()
        options = _filled(self._media.ern_clip_options_fill, _c.ClipOptions, options, "Clip", without=("network",))
        self._own(self._media.ern_clip_free, handle, context)
        self._lock = threading.RLock()
        context._call(self._media.ern_clip_open, context, _path(folder, "folder"), ctypes.byref(options),
                      ctypes.byref(handle))
        self._context = context
        self.info = _described(self._media.ern_clip_describe_sized, handle, _c.ClipInfo)
        self.view = View(self.info.focal, self.info.cx, self.info.cy, self.info.width, self.info.height)

    @property
    def features(self):
        """Speech features, float32 [windows, window_length, width], the clip's own memory."""
        return _features_array(self, self._media.ern_clip_features(self._handle).contents)

    @property
    def background(self):
        """uint8 [height, width, 3], the clip's own memory."""
        image = self._media.ern_clip_background(self._handle).contents
        return np.asarray(_Memory(self, image.data, (image.height, image.width, image.channels)))

    def frame(self, split, index):
        """img_id, aud_id, matrix (float32 [4, 4]), eye, landmarks (float32 [68, 2] or None), torso_motion (float32
        [2, 16, 16] or None) of a frame."""
        frame = self._media.ern_clip_frame_at(self._handle, Split(split), _integer(index, "index"))
        if not frame:
            raise IndexError(f"frame {index} of {self.info.frames[split]}")
        frame = frame.contents
        landmarks = np.array(frame.landmarks, np.float32) if frame.has_landmarks else None
        motion = None
        if self.info.has_torso_motion:
            motion = np.array(frame.torso_motion, np.float32).reshape(2, _MOTION_SIDE, _MOTION_SIDE)
        return SimpleNamespace(img_id=frame.pose.img_id, aud_id=frame.pose.aud_id, eye=frame.eye, landmarks=landmarks,
                               torso_motion=motion,
                               matrix=np.array(frame.pose.matrix, np.float32).reshape(4, 4))

    def pixels(self, split, index):
        """The picture of a frame, uint8 [height, width, 3], and its torso, [height, width, 4] or None."""
        images = _c.Image(), _c.Image()
        self._context._call(self._media.ern_clip_pixels, self, Split(split), _integer(index, "index"),
                            *(ctypes.byref(image) for image in images))
        return tuple(  # the clip uses the memory again for the next frame
            np.array(np.ctypeslib.as_array(image.data, (image.height, image.width, image.channels)))
            if image.data else None for image in images)

    def head(self, split, index):
        """255 where the head of a frame is, 0 where it is not, else unknown, uint8 [height, width]; None: not known."""
        image = _c.Image()
        self._context._call(self._media.ern_clip_head, self, Split(split), _integer(index, "index"), ctypes.byref(image))
        return np.array(np.ctypeslib.as_array(image.data, (image.height, image.width))) if image.data else None


class Trainer(_Object):
    """Trains on a clip; options as in struct ern_train_config, `from` as `from_`; head is a Model."""

    _has_threads = True
    _runs = False  # run() is being executed

    def __init__(self, backend, clip, head=None, **options):
        context = _object(backend, Backend, "backend")._context
        _object(clip, Clip, "clip")
        engine, handle, dataset = context._engine, ctypes.c_void_p(), _c.Dataset()
        config = _filled(engine.ern_train_config_fill, _c.TrainConfig, options, "Trainer",
                         without=("head", "fine_loss", "communicator"))
        if head is not None:
            config.head = _object(head, Model, "head")._handle
        context._media.ern_clip_dataset_sized(clip._handle, ctypes.byref(dataset), ctypes.sizeof(dataset))
        self._own(engine.ern_trainer_free, handle, backend, clip)
        self._lock = threading.RLock()
        context._call(engine.ern_trainer_create_sized, ctypes.byref(handle), backend, ctypes.byref(dataset),
                      ctypes.sizeof(dataset), ctypes.byref(config))
        self._context = context

    @property
    def report(self):
        """The training's progress: step, iters and seconds."""
        return _described(self._context._engine.ern_trainer_describe_sized, self._handle, _c.TrainReport)

    def _check_idle(self, name):
        if self._runs:
            raise ValueError(f"the Trainer is in run(), expected {name}() before or after it")

    def step(self):
        """Does one step; returns its report: step, iters, loss, psnr, ... (struct ern_train_report)."""
        self._check_idle("step")
        report = _c.TrainReport()
        self._context._call(self._context._engine.ern_trainer_step_sized, self, ctypes.byref(report),
                            ctypes.sizeof(report))
        return _values(report)

    def run(self, progress=None):
        """Steps until all are done, validating and saving as configured.

        progress: called about twice a second with a report; if it returns a value that is true, raises, or closes the
        Trainer, the training saves and stops. run() then raises Error with Status.E_CANCELLED, or what
        progress raised. After Ctrl-C, in the main thread, the training saves and stops too, and run() raises
        KeyboardInterrupt. progress may call save() and model() of the Trainer, but neither step() nor run().
        """
        self._check_idle("run")
        raised = []

        def hook(_, report):
            try:
                stop = progress and progress(_values(report[0]))
                return bool(raised or stop or self.closed)
            except BaseException as error:
                raised.append(error)
                return 1

        hooks = _c.TrainHooks(progress=_c.PROGRESS(hook))
        self._runs = True
        try:
            with _interrupts(raised):
                self._context._call(self._context._engine.ern_trainer_run_sized, self, ctypes.byref(hooks),
                                    ctypes.sizeof(hooks))
        except Error:
            if not raised:
                raise
        finally:
            self._runs = False
        if raised:
            raise raised[0]

    def save(self):
        """Writes the training state and the model to the files that `output` names."""
        self._context._call(self._context._engine.ern_trainer_save, self)

    def model(self):
        """A copy of the Model in its current state."""
        context = self._context
        return Model.__new__(Model)._make(
            context, lambda handle: context._call(context._engine.ern_trainer_model, self, handle))
