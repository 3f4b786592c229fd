"""Chance without memory: every number is a function of where it is used, so order and workers never matter.

A stream is named by a seed and up to three counters. Scalar arithmetic only, in the common subset of
compilers for processors and graphics cards.

Source: G. Steele, D. Lea, C. Flood, "Fast splittable pseudorandom number generators", 2014 (the mixer).
"""

import math

import numpy as np

from companion.compiled import portable, portable_inlined
from companion.messages import FloatArray

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_30, _27, _31, _11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
_ONE = np.uint64(1)
_UNIT = 1.0 / 9007199254740992.0


@portable_inlined
def mix(word: np.uint64) -> np.uint64:
    """Return 64 bits that depend on every bit of a word."""
    word = (word ^ (word >> _30)) * _FIRST
    word = (word ^ (word >> _27)) * _SECOND
    return word ^ (word >> _31)


@portable_inlined
def stream(seed: np.uint64, first: int, second: int, third: int) -> np.uint64:
    """Return the beginning of the stream of a seed that three counters name."""
    word = mix(seed + _GOLDEN)
    word = mix(word ^ (np.uint64(first) * _GOLDEN + _ONE))
    word = mix(word ^ (np.uint64(second) * _GOLDEN + _ONE))
    return mix(word ^ (np.uint64(third) * _GOLDEN + _ONE))


@portable_inlined
def uniform(start: np.uint64, index: int) -> float:
    """Return number `index` of a stream, uniform in [0, 1)."""
    return np.float64(mix(start + np.uint64(index + 1) * _GOLDEN) >> _11) * _UNIT


@portable_inlined
def normal_pair(start: np.uint64, index: int) -> tuple[float, float]:
    """Return the independent standard normal numbers 2 `index` and 2 `index` + 1 of a stream.

    Source: G. Box, M. Muller, "A note on the generation of random normal deviates", 1958.
    """
    radius = math.sqrt(-2.0 * math.log(1.0 - uniform(start, 2 * index)))
    angle = 2.0 * math.pi * uniform(start, 2 * index + 1)
    return radius * math.cos(angle), radius * math.sin(angle)


@portable("void(uint64, int64, int64, int64, float64[::1], float64[::1])")
def draw(
    seed: np.uint64, first: int, second: int, third: int, uniforms: FloatArray, normals: FloatArray
) -> None:
    """Fill arrays from one stream: what kernels draw one by one, for tests and for Python."""
    start = stream(seed, first, second, third)
    for i in range(uniforms.shape[0]):
        uniforms[i] = uniform(start, i)
    for i in range(normals.shape[0]):
        a, b = normal_pair(start, i // 2)
        normals[i] = a if i % 2 == 0 else b
