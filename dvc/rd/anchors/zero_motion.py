"""H.264 without motion: x264 with all vectors zero, which none of its options gives.

The exhaustive search of x264 with no subpixel refinement (``me=esa, subme=0``) looks at the predicted vector
and at the window around zero. With a search range of −1 no vector is in the window and none but zero stays.
x264 raises the range to 4 when it opens, so it is overwritten in the open encoder. That depends on how one
build lies in memory: everything is checked before, at, and after the change, and whoever decodes the file
must find all vectors zero (`dvc.rd.anchors.decoding`).
"""

import ctypes
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dvc.errors import ConfigError, VideoError
from dvc.video.frames import Plane

BUILD: Final = 165
"""The build of x264 whose layout in memory is known here."""
NO_RANGE: Final = -1
_RANGE, _OTHER_RANGE = 16, 20
_PARAMETER_BYTES = 4096
_GREY = 1  # X264_CSP_I400
_COLOUR = 2  # X264_CSP_I420, the default
# Fields of `x264_param_t` as 32-bit words: i_width, i_height, i_csp, i_bitdepth.
_GEOMETRY = slice(7, 11)
_SEI = 6
_FUNCTIONS: tuple[str, ...] = (
    *("param_default_preset", "param_parse", "param_apply_profile", "picture_init"),
    *("encoder_parameters", "encoder_encode", "encoder_delayed_frames", "encoder_close"),
)

Words = NDArray[np.int32]


class _Image(ctypes.Structure):
    """`x264_image_t`."""

    _fields_ = (
        ("csp", ctypes.c_int),
        ("num_planes", ctypes.c_int),
        ("strides", ctypes.c_int * 4),
        ("planes", ctypes.c_void_p * 4),
    )


class _Picture(ctypes.Structure):
    """`x264_picture_t`, and room for what follows in it."""

    _fields_ = (
        ("type_qp_structure_key", ctypes.c_int * 4),
        ("pts", ctypes.c_int64),
        ("dts", ctypes.c_int64),
        ("parameters", ctypes.c_void_p),
        ("image", _Image),
        ("rest", ctypes.c_char * 2048),
    )


class _NalUnit(ctypes.Structure):
    """`x264_nal_t`."""

    _fields_ = (
        ("ref_idc", ctypes.c_int),
        ("type", ctypes.c_int),
        ("long_start_code", ctypes.c_int),
        ("first_macroblock", ctypes.c_int),
        ("last_macroblock", ctypes.c_int),
        ("num_bytes", ctypes.c_int),
        ("data", ctypes.POINTER(ctypes.c_uint8)),
        ("padding", ctypes.c_int),
    )


def encode_without_motion(
    planes: Iterable[Plane],
    size: tuple[int, int],
    frame_rate: Fraction,
    preset: str,
    parameters: dict[str, str],
) -> Iterator[bytes]:
    """Code luma planes as IPPP with motion vectors of zero."""
    library = _Library(library_path())
    setup = {**parameters, "fps": f"{frame_rate.numerator}/{frame_rate.denominator}", "merange": str(_RANGE)}
    words = library.parameters(preset, setup)
    _check_range(words[library.range_word], _RANGE, "of the parameters")
    words[_GEOMETRY] = (*size, _GREY, 8)
    with library.opened(words) as encoder:
        _set_no_range(library, encoder, size)
        for number, plane in enumerate(planes):
            yield library.encode(encoder, number, plane)
        while library.encoder_delayed_frames(encoder) > 0:
            yield library.encode(encoder, -1, None)
        _check_range(library.read_back(encoder)[library.range_word], NO_RANGE, "after the last picture")


def library_path() -> Path:
    """Find the libx264 that came with PyAV."""
    import av

    folder = Path(av.__file__).parent.parent / "av.libs"
    found = sorted(folder.glob("libx264-*.so.*"))
    if not found:
        raise ConfigError("zero motion: PyAV was installed without a libx264 of its own")
    build = re.search(r"\.so\.(\d+)$", found[0].name)
    if build is None or int(build[1]) != BUILD:
        raise ConfigError(f"zero motion: known for x264 build {BUILD}, not for {found[0].name}")
    return found[0]


class _Library:
    """libx264, as far as it is needed."""

    param_default_preset: Any
    param_parse: Any
    param_apply_profile: Any
    picture_init: Any
    encoder_parameters: Any
    encoder_encode: Any
    encoder_delayed_frames: Any
    encoder_close: Any

    def __init__(self, path: Path) -> None:
        try:
            library = ctypes.CDLL(str(path))
            for name in _FUNCTIONS:
                setattr(self, name, getattr(library, f"x264_{name}"))
            self.encoder_open = getattr(library, f"x264_encoder_open_{BUILD}")
        except (OSError, AttributeError) as err:
            raise ConfigError(f"zero motion: {path.name} cannot be used: {err}") from err
        self.encoder_open.restype = ctypes.c_void_p
        for function in (self.encoder_delayed_frames, self.encoder_close):
            function.argtypes = [ctypes.c_void_p]
        self.encoder_parameters.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
        self.encoder_encode.argtypes = [ctypes.c_void_p] * 5
        self.range_word = self._find_range()

    def parameters(self, preset: str, parameters: dict[str, str]) -> Words:
        """Return an `x264_param_t` as words that can be changed."""
        buffer = ctypes.create_string_buffer(_PARAMETER_BYTES)
        if self.param_default_preset(buffer, preset.encode(), None) != 0:
            raise ConfigError(f"zero motion: x264 has no preset {preset!r}")
        words: Words = np.frombuffer(memoryview(buffer), np.int32)
        if words[_GEOMETRY].tolist() != [0, 0, _COLOUR, 8]:
            raise ConfigError("zero motion: the parameters of x264 are laid out in an unknown way")
        for name, value in {"log": "-1", **parameters}.items():
            if self.param_parse(buffer, name.encode(), value.encode()) != 0:
                raise ConfigError(f"zero motion: x264 refuses {name}={value}")
        return words

    def _find_range(self) -> int:
        """Find the word of the search range: the only one in which two sets of parameters differ."""
        one, other = (self.parameters("medium", {"merange": str(value)}) for value in (_RANGE, _OTHER_RANGE))
        (differing,) = np.nonzero(one != other)
        if differing.size != 1 or [one[differing[0]], other[differing[0]]] != [_RANGE, _OTHER_RANGE]:
            raise ConfigError("zero motion: the search range cannot be found in the parameters of x264")
        return int(differing[0])

    @contextmanager
    def opened(self, words: Words) -> Iterator[int]:
        """Open an encoder, and close it at the end."""
        pointer = words.ctypes.data_as(ctypes.c_void_p)
        if self.param_apply_profile(pointer, b"high") != 0:
            raise ConfigError("zero motion: x264 refuses profile high")
        encoder = self.encoder_open(pointer)
        if not encoder:
            raise ConfigError("zero motion: x264 refuses the size or the parameters")
        try:
            yield encoder
        finally:
            self.encoder_close(encoder)

    def read_back(self, encoder: int) -> Words:
        """Return the parameters that an open encoder works with."""
        words = np.zeros(_PARAMETER_BYTES // 4, np.int32)
        self.encoder_parameters(encoder, words.ctypes.data)
        return words

    def encode(self, encoder: int, number: int, plane: Plane | None) -> bytes:
        """Code a picture, or None for what is still inside; messages are left out."""
        picture, coded = _Picture(), _Picture()
        if plane is not None:
            rows = np.ascontiguousarray(plane)
            self.picture_init(ctypes.byref(picture))
            picture.pts = number
            picture.image.csp, picture.image.num_planes = _GREY, 1
            picture.image.strides[0], picture.image.planes[0] = rows.strides[0], rows.ctypes.data
        units, count = ctypes.POINTER(_NalUnit)(), ctypes.c_int()
        source = None if plane is None else ctypes.byref(picture)
        size = self.encoder_encode(
            encoder, ctypes.byref(units), ctypes.byref(count), source, ctypes.byref(coded)
        )
        if size < 0:
            raise VideoError(f"zero motion: x264 cannot code picture {number}")
        kept = (units[i] for i in range(count.value) if units[i].type != _SEI)
        return b"".join(ctypes.string_at(unit.data, unit.num_bytes) for unit in kept)


def _set_no_range(library: _Library, encoder: int, size: tuple[int, int]) -> None:
    """Overwrite the search range of an open encoder, once it is sure where that is."""
    before = library.read_back(encoder)
    if before[_GEOMETRY].tolist()[:3] != [*size, _GREY]:
        raise ConfigError("zero motion: the open encoder has other parameters than it was given")
    _check_range(before[library.range_word], _RANGE, "of the open encoder")
    address = ctypes.cast(encoder, ctypes.POINTER(ctypes.c_void_p))[0]
    num_words = int(np.flatnonzero(before)[-1]) + 1
    if not address:
        raise ConfigError("zero motion: the open encoder is laid out in an unknown way")
    memory = np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(ctypes.c_int32)), (num_words,))
    if not np.array_equal(memory, before[:num_words]):
        raise ConfigError("zero motion: the open encoder does not begin with its parameters")
    memory[library.range_word] = NO_RANGE
    after = library.read_back(encoder)
    _check_range(after[library.range_word], NO_RANGE, "as overwritten")
    after[library.range_word] = _RANGE
    if not np.array_equal(after, before):
        raise ConfigError("zero motion: more than the search range has changed")


def _check_range(found: int, expected: int, where: str) -> None:
    if found != expected:
        raise ConfigError(f"zero motion: the search range {where} is {found}, not {expected}")
