"""Serialized messages of which a few numbers change: those are written into a copy of one message."""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

_STAMP_AT = 4  # the header comes first, behind four bytes that say how numbers are encoded
_STAMP, _NUMBER = struct.Struct("<iI"), struct.Struct("<d")
_ULP_OFFSETS = sorted(itertools.product(range(-2, 3), repeat=2), key=lambda ij: abs(ij[0]) + abs(ij[1]))  # in ulp
_MARKS = tuple(-1.2345e-200 - k * 1e-203 for k in range(8))  # numbers that stand nowhere else


class MessageForm:
    """A message with a header, in whose serialized form the stamp and some float64 numbers are replaced."""

    def __init__(self, count: int, serialized: Callable[[tuple[float, ...]], Any]) -> None:
        """Take the form of `serialized(numbers)`, little-endian CDR of a message with these `count` numbers."""
        marks = _MARKS[:count]
        self._data = bytes(serialized(marks))
        self._places = [self._data.index(_NUMBER.pack(mark)) for mark in marks]

    def fill(self, seconds: int, nanoseconds: int, numbers: tuple[float, ...]) -> bytes:
        """The message with this stamp in its header, and these numbers."""
        data = bytearray(self._data)
        _STAMP.pack_into(data, _STAMP_AT, seconds, nanoseconds)
        for place, number in zip(self._places, numbers, strict=True):
            _NUMBER.pack_into(data, place, number)
        return bytes(data)


class ArrayForm:
    """A message with a header, in whose serialized form the stamp and an array of float32 numbers are replaced."""

    def __init__(self, count: int, serialized: Callable[[NDArray[np.float32]], Any]) -> None:
        """Take the form of `serialized(numbers)`, little-endian CDR of a message with these `count` numbers."""
        marks = np.linspace(-2.345e30, -1.234e30, count, dtype="<f4")  # numbers that stand nowhere else
        self._data = bytes(serialized(marks))
        self._place = self._data.index(marks.tobytes())
        self._end = self._place + marks.nbytes

    def fill(self, seconds: int, nanoseconds: int, numbers: NDArray[np.float32]) -> bytes:
        """The message with this stamp in its header, and these numbers."""
        data = bytearray(self._data)
        _STAMP.pack_into(data, _STAMP_AT, seconds, nanoseconds)
        data[self._place : self._end] = np.asarray(numbers, dtype="<f4").tobytes()
        return bytes(data)


def quaternion(theta: float) -> tuple[float, float]:
    """Z and w of a rotation by `theta`, in [-pi, pi), about z, rounded so that 2 atan2(z, w) equals `theta` exactly.

    Angles below 1e-300 are excepted. Sine and cosine alone lose the last bit, which can change the selection of
    keyframes in a replay.
    """
    sin, cos = math.sin(0.5 * theta), math.cos(0.5 * theta)
    for i, j in _ULP_OFFSETS:
        z, w = sin + i * math.ulp(sin), cos + j * math.ulp(cos)
        if 2.0 * math.atan2(z, w) == theta:
            return z, w
    return sin, cos
