import numpy as np

from companion.messages import FloatArray
from sitl.abstract.random_kernels import draw


def _drawn(seed: int, first: int, second: int, third: int, number: int) -> tuple[FloatArray, FloatArray]:
    uniforms, normals = np.empty(number), np.empty(number)
    draw(np.uint64(seed), first, second, third, uniforms, normals)
    return uniforms, normals


def test_numbers_have_the_right_distribution() -> None:
    uniforms, normals = _drawn(7, 1, 2, 3, 100_000)
    assert 0.0 <= uniforms.min() and uniforms.max() < 1.0
    counts, _ = np.histogram(uniforms, 50, (0.0, 1.0))
    assert np.sum((counts - 2000.0) ** 2 / 2000.0) < 90.0
    assert abs(normals.mean()) < 0.015
    assert abs(normals.std() - 1.0) < 0.01
    assert abs(np.mean(normals**4) - 3.0) < 0.15
    assert abs(np.corrcoef(normals[::2], normals[1::2])[0, 1]) < 0.02


def test_neighbouring_streams_have_nothing_to_do_with_each_other() -> None:
    for axis in range(4):
        firsts = np.array(
            [_drawn(*(5 + k if a == axis else 5 for a in range(4)), 2)[1][0] for k in range(2000)]  # type: ignore[arg-type]
        )
        assert abs(firsts.mean()) < 0.1
        assert abs(firsts.std() - 1.0) < 0.07
        assert abs(np.corrcoef(firsts[1:], firsts[:-1])[0, 1]) < 0.08


def test_the_mixer_gives_the_published_numbers() -> None:
    # SplitMix64 from state 0 begins so; a stream's numbers are those of its own start.
    words, state = [], 0
    for _ in range(2):
        state = (state + 0x9E3779B97F4A7C15) % 2**64
        word = state
        word = (word ^ (word >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
        word = (word ^ (word >> 27)) * 0x94D049BB133111EB % 2**64
        words.append(word ^ (word >> 31))
    assert words == [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4]
    uniforms, _ = _drawn(0, 0, 0, 0, 4)
    again, _ = _drawn(0, 0, 0, 0, 4)
    np.testing.assert_array_equal(uniforms, again)
