# SPDX-License-Identifier: MIT
"""The C interface of libernerf that the module uses: structs, enums and functions of include/ernerf/*.h, with ctypes.

A struct has the name of the C struct without `ern_`, in capitals. tests/python holds all of them to the headers.
"""
import ctypes
import enum
import os
from ctypes import (CFUNCTYPE, POINTER, Structure, c_bool, c_char, c_char_p, c_double, c_float, c_int, c_int64,
                    c_size_t, c_uint8, c_uint32, c_uint64, c_void_p)

VERSION = (0, 1)  # of the headers that this file is written for: major, minor
ENUM = c_uint32  # what C compilers take for an enum without negative values


class Status(enum.IntEnum):
    """Codes of errors."""
    OK = 0
    E_ARGUMENT = 1
    E_NO_MEMORY = 2
    E_STATE = 3
    E_CANCELLED = 4
    E_IO = 10
    E_MISSING = 11
    E_BUSY = 12
    E_EXISTS = 13
    E_FORMAT = 20
    E_SHAPE = 21
    E_MISMATCH = 22
    E_NONFINITE = 30
    E_UNSUPPORTED = 40
    E_DEVICE = 50
    E_MEDIA = 60


class LogLevel(enum.IntEnum):
    """How important a line of the log is."""
    ERROR = 0
    WARNING = 1
    INFO = 2
    DEBUG = 3


class Backbone(enum.IntEnum):
    """What encodes a position."""
    TRIHASH = 0
    HASH3D = 1
    TRIPLANE = 2
    MLP = 3


class Attention(enum.IntEnum):
    """How the audio code of a frame reaches a position."""
    CHANNEL = 0
    FEATURE = 1
    CONCAT = 2


class EyeAttention(enum.IntEnum):
    """How the eye value of a frame reaches a position."""
    SIGMOID = 0
    CONCAT = 1


class AudioPad(enum.IntEnum):
    """Which windows of speech stand in for those past the ends."""
    EDGE = 0
    ZERO = 1


class Precision(enum.IntEnum):
    """Number format of the factors in the matrix products of a training."""
    DEFAULT = 0
    FP32 = 1
    BF16 = 2
    AUTO = 3


class RaySampling(enum.IntEnum):
    """Which pixels of a frame the rays of a step go through."""
    UNIFORM = 0
    REGIONS = 1
    DUB = 2


class Split(enum.IntEnum):
    """Part of a clip."""
    TRAIN = 0
    VAL = 1


# base.h
LOG = CFUNCTYPE(None, c_void_p, ENUM, c_char_p)


class ContextConfig(Structure):
    _fields_ = [("cookie", c_uint32), ("size", c_uint32), ("allocate", c_void_p), ("release", c_void_p), ("log", LOG),
                ("user", c_void_p), ("keep_files", c_bool)]


# backend.h
class BackendConfig(Structure):
    _fields_ = [("cookie", c_uint32), ("size", c_uint32), ("name", c_char_p), ("isa", c_char_p), ("device", c_int),
                ("deterministic", c_bool), ("tune", c_bool)]


class BackendInfo(Structure):
    _fields_ = [("name", c_char_p), ("isa", c_char_p), ("real_bytes", c_int), ("deterministic", c_bool),
                ("threads", c_int)]


# data.h
class Features(Structure):
    _fields_ = [("data", POINTER(c_float)), ("windows", c_size_t), ("window_length", c_int), ("width", c_int)]


class Pose(Structure):
    _fields_ = [("img_id", c_int64), ("aud_id", c_int64), ("matrix", c_float * 16)]


class PoseList(Structure):
    _fields_ = [("focal", c_double), ("cx", c_double), ("cy", c_double), ("width", c_int), ("height", c_int),
                ("count", c_size_t), ("poses", POINTER(Pose))]


# model.h
class ModelInfo(Structure):
    _fields_ = [("has_torso", c_bool), ("has_eye", c_bool), ("has_view", c_bool), ("has_codes", c_bool),
                ("has_gamma", c_bool), ("backbone", ENUM), ("attention", ENUM), ("eye_attention", ENUM),
                ("levels", c_int), ("feature_width", c_int), ("window_length", c_int), ("codes", c_int),
                ("bound", c_float), ("has_view_settings", c_bool), ("max_steps", c_int), ("dt_gamma", c_float),
                ("torso_shrink", c_float), ("scale", c_float), ("audio_pad", ENUM), ("cameras", c_size_t),
                ("head_steps", c_uint64), ("torso_steps", c_uint64), ("clip", c_char * 65), ("parameters", c_size_t),
                ("parameter_bytes", c_size_t), ("speech", c_char * 64), ("speech_network", c_char * 512),
                ("consent", c_char * 1024), ("dub", c_bool), ("has_torso_motion", c_bool), ("voice_fade", c_float * 2)]


class TensorInfo(Structure):
    _fields_ = [("name", c_char_p), ("dtype", c_char_p), ("dims", c_int), ("shape", c_size_t * 4)]


SAY_TENSOR = CFUNCTYPE(None, c_void_p, POINTER(TensorInfo))


# render.h
class Box(Structure):
    _fields_ = [("top", c_int), ("bottom", c_int), ("left", c_int), ("right", c_int)]


class Camera(Structure):
    _fields_ = [("pose", c_float * 16), ("focal", c_float), ("cx", c_float), ("cy", c_float), ("width", c_int),
                ("height", c_int), ("frame", Box)]


class RenderOptions(Structure):
    """Its members are those that the library describes (open_engine)."""


class FrameInput(Structure):
    _fields_ = [("camera", Camera), ("head_pose", POINTER(c_float)), ("windows", POINTER(c_float)),
                ("window_length", c_int), ("eye", c_float), ("individual", c_size_t), ("background", POINTER(c_uint8)),
                ("torso", POINTER(c_uint8)), ("silence_code", POINTER(c_float)), ("silence_weight", c_float),
                ("wanted", POINTER(c_uint8)), ("torso_motion", POINTER(c_float))]


class FrameOutput(Structure):
    _fields_ = [("rgba", POINTER(c_uint8)), ("rgb", POINTER(c_float)), ("alpha", POINTER(c_float)),
                ("opacity", POINTER(c_float)), ("depth", POINTER(c_float)), ("attention", POINTER(c_float)),
                ("eye", POINTER(c_float))]


# train.h
class Dataset(Structure):  # filled by ern_clip_dataset_sized and handed on; nothing here looks inside
    _fields_ = [("user", c_void_p), ("frames", c_size_t * 2), ("focal", c_double), ("cx", c_double), ("cy", c_double),
                ("width", c_int), ("height", c_int), ("scale", c_float), ("has_eye", c_bool), ("has_torso", c_bool),
                ("features", POINTER(Features)), ("background", POINTER(c_uint8)), ("frame", c_void_p),
                ("pixels", c_void_p), ("identity", c_char_p), ("copies", POINTER(Features)), ("copy_count", c_size_t),
                ("copy_share", c_float), ("speech", c_char_p), ("speech_network", c_char_p), ("head", c_void_p),
                ("speech_noise", c_float), ("fingerprint", c_char_p), ("has_torso_motion", c_bool)]


class Setting(Structure):
    _fields_ = [("name", c_char_p), ("type", ENUM), ("at", c_size_t), ("least", c_double), ("most", c_double),
                ("fallback", c_double), ("words", c_char_p), ("help", c_char_p), ("resume", ENUM), ("scope", ENUM),
                ("same_everywhere", c_bool), ("group", c_char_p)]


SETTING_TYPES = (c_bool, c_int, c_uint64, c_size_t, c_float, c_double, ENUM, c_char_p, c_void_p)  # by ern_setting_type


class TrainConfig(Structure):
    """Its members are those that the library describes (open_engine)."""


class TrainReport(Structure):
    _fields_ = [("step", c_uint64), ("iters", c_uint64), ("loss", c_double), ("psnr", c_double),
                ("samples_per_ray", c_double), ("steps_per_second", c_double), ("seconds_left", c_double),
                ("seconds", c_double)]


PROGRESS = CFUNCTYPE(c_int, c_void_p, POINTER(TrainReport))


class TrainHooks(Structure):
    _fields_ = [("user", c_void_p), ("progress", PROGRESS), ("validation", c_void_p), ("validation_frame", c_void_p)]


# media.h
class Image(Structure):
    _fields_ = [("width", c_int), ("height", c_int), ("channels", c_int), ("data", POINTER(c_uint8))]


class ClipOptions(Structure):
    _fields_ = [("cookie", c_uint32), ("size", c_uint32), ("memory_bytes", c_uint64), ("features", c_char_p),
                ("asr_model", c_char_p), ("network", c_void_p)]


class ClipInfo(Structure):
    _fields_ = [("width", c_int), ("height", c_int), ("focal", c_double), ("cx", c_double), ("cy", c_double),
                ("frames", c_size_t * 2), ("features_file", c_char_p), ("has_blink", c_bool), ("has_torso", c_bool),
                ("has_sound", c_bool), ("has_landmarks", c_bool), ("identity", c_char * 65), ("speech", c_char_p),
                ("hears_sound", c_bool), ("speech_network", c_char_p), ("has_parsing", c_bool),
                ("has_torso_motion", c_bool)]


class ClipFrame(Structure):
    _fields_ = [("pose", Pose), ("eye", c_float), ("has_landmarks", c_bool), ("landmarks", c_float * 2 * 68),
                ("torso_motion", c_float * 512)]


class DubInput(Structure):
    _fields_ = [("recorded", POINTER(c_uint8)), ("width", c_int), ("height", c_int), ("square", c_int * 4),
                ("landmarks", c_float * 2 * 68), ("recorded_head", POINTER(Image)), ("box", c_int * 4),
                ("head", POINTER(c_uint8)), ("head_width", c_int), ("head_height", c_int), ("head_scale", c_float * 2)]


# Result and arguments. A function that returns a Status raises ernerf.Error (ernerf.Context._call).
OBJECT = c_void_p
OUT = POINTER(c_void_p)
ENGINE = {
    "ern_version": (c_char_p,),
    "ern_status_name": (c_char_p, ENUM),
    "ern_context_config_fill": (None, POINTER(ContextConfig), c_size_t),
    "ern_context_create": (Status, OUT, POINTER(ContextConfig)),
    "ern_context_free": (None, OUT),
    "ern_last_error_copy": (c_size_t, OBJECT, POINTER(c_char), c_size_t),
    "ern_backend_config_fill": (None, POINTER(BackendConfig), c_size_t),
    "ern_backend_create": (Status, OUT, OBJECT, POINTER(BackendConfig)),
    "ern_backend_free": (None, OUT),
    "ern_backend_describe_sized": (None, OBJECT, POINTER(BackendInfo), c_size_t),
    "ern_features_load": (Status, OBJECT, c_char_p, POINTER(Features)),
    "ern_features_save": (Status, OBJECT, c_char_p, POINTER(Features)),
    "ern_features_free": (None, OBJECT, POINTER(Features)),
    "ern_pose_list_load": (Status, OBJECT, c_char_p, POINTER(PoseList)),
    "ern_pose_list_free": (None, OBJECT, POINTER(PoseList)),
    "ern_model_load": (Status, OUT, OBJECT, c_char_p),
    "ern_model_free": (None, OUT),
    "ern_model_save": (Status, OBJECT, c_char_p),
    "ern_model_describe_sized": (None, OBJECT, POINTER(ModelInfo), c_size_t),
    "ern_file_tensors": (Status, OBJECT, c_char_p, SAY_TENSOR, c_void_p),
    "ern_camera_pose": (None, POINTER(c_float), POINTER(c_float), c_float),
    "ern_audio_windows": (None, POINTER(c_float), POINTER(Features), c_int64, ENUM),
    "ern_render_setting": (POINTER(Setting), c_size_t),
    "ern_render_options_fill": (None, POINTER(RenderOptions), c_size_t),
    "ern_renderer_create": (Status, OUT, OBJECT, OBJECT, POINTER(RenderOptions)),
    "ern_renderer_free": (None, OUT),
    "ern_renderer_accepts": (Status, OBJECT, POINTER(Features), c_char_p),
    "ern_renderer_frame_sized": (Status, OBJECT, POINTER(FrameInput), c_size_t, POINTER(FrameOutput), c_size_t,
                                 c_void_p, c_size_t),
    "ern_train_setting": (POINTER(Setting), c_size_t),
    "ern_train_config_fill": (None, POINTER(TrainConfig), c_size_t),
    "ern_trainer_create_sized": (Status, OUT, OBJECT, POINTER(Dataset), c_size_t, POINTER(TrainConfig)),
    "ern_trainer_free": (None, OUT),
    "ern_trainer_describe_sized": (None, OBJECT, POINTER(TrainReport), c_size_t),
    "ern_trainer_step_sized": (Status, OBJECT, POINTER(TrainReport), c_size_t),
    "ern_trainer_run_sized": (Status, OBJECT, POINTER(TrainHooks), c_size_t),
    "ern_trainer_save": (Status, OBJECT),
    "ern_trainer_model": (Status, OBJECT, OUT),
}
MEDIA = {
    "ern_clip_options_fill": (None, POINTER(ClipOptions), c_size_t),
    "ern_clip_open": (Status, OBJECT, c_char_p, POINTER(ClipOptions), OUT),
    "ern_clip_free": (None, OUT),
    "ern_clip_describe_sized": (None, OBJECT, POINTER(ClipInfo), c_size_t),
    "ern_clip_features": (POINTER(Features), OBJECT),
    "ern_clip_background": (POINTER(Image), OBJECT),
    "ern_clip_frame_at": (POINTER(ClipFrame), OBJECT, ENUM, c_size_t),
    "ern_clip_head": (Status, OBJECT, ENUM, c_size_t, POINTER(Image)),
    "ern_clip_pixels": (Status, OBJECT, ENUM, c_size_t, POINTER(Image), POINTER(Image)),
    "ern_clip_dataset_sized": (None, OBJECT, POINTER(Dataset), c_size_t),
    "ern_dub_box_sized": (Status, OBJECT, POINTER(DubInput), c_size_t, POINTER(c_int)),
    "ern_dub_wanted_sized": (Status, OBJECT, POINTER(DubInput), c_size_t, POINTER(c_uint8)),
    "ern_dub_frame_sized": (Status, OBJECT, POINTER(DubInput), c_size_t, POINTER(c_uint8), POINTER(c_bool)),
    "ern_speech_features_kind": (Status, OBJECT, c_char_p, c_char_p, c_float, POINTER(Features)),
}


def _open(path, functions):
    try:
        library = ctypes.CDLL(path)
    except OSError as error:
        raise OSError(f"{error}: is libernerf installed? ERNERF_LIBRARY may name its libernerf.so") from None
    for name, (result, *arguments) in functions.items():
        function = getattr(library, name)
        function.restype = ENUM if result is Status else result
        function.argtypes = arguments
    return library


def _describe(structure, setting, engine):
    """The members of `structure`, as the library describes them by setting(index)."""
    fields, index = [("cookie", c_uint32), ("size", c_uint32)], 0
    while found := setting(index):
        fields.append((found.contents.name.decode(), SETTING_TYPES[found.contents.type]))
        index += 1
    if not hasattr(structure, "_fields_"):
        structure._fields_ = fields
    if fields != structure._fields_:
        raise OSError(f"{engine._name}: its struct of {structure.__name__} is not that of the library opened before")


def open_engine(path=None):
    """libernerf: the file `path`, else that of ERNERF_LIBRARY, else the one that the system's loader finds."""
    path = os.fspath(path or os.environ.get("ERNERF_LIBRARY") or f"libernerf.so.{VERSION[0]}")
    library = _open(path, {"ern_version": ENGINE["ern_version"]})
    version = library.ern_version().decode()
    major, minor = (int(number) for number in version.split(".")[:2])
    if major != VERSION[0] or minor < VERSION[1]:
        raise OSError(f"{path}: version {version}, expected {VERSION[0]}.{VERSION[1]} or a later {VERSION[0]}.x")
    engine = _open(path, ENGINE)
    _describe(TrainConfig, engine.ern_train_setting, engine)
    _describe(RenderOptions, engine.ern_render_setting, engine)
    return engine


def open_media(engine):
    """libernerf-media of the same installation."""
    name = f"libernerf-media.so.{VERSION[0]}"
    folder = os.path.dirname(engine._name)
    return _open(os.path.join(folder, name) if folder else name, MEDIA)
