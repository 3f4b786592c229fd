import numpy as np

from companion.messages import FloatArray
from sitl.abstract.random_kernels import draw, mix, uniform


def _drawn(seed: int, first: int, second: int, third: int, number: int) -> tuple[FloatArray, FloatArray]:
    uniforms, normals = np.empty(number), np.empty(number)
    draw(np.uint64(seed), first, second, third, uniforms, normals)
    return uniforms, normals


def test_numbers_have_the_right_distribution() -> None:
    uniforms, normals = _drawn(7, 1, 2, 3, 100_000)
    assert uniforms.min() >= 0.0
    assert uniforms.max() < 1.0
    counts, _ = np.histogram(uniforms, 50, (0.0, 1.0))
    assert np.sum((counts - 2000.0) ** 2 / 2000.0) < 90.0
    assert abs(normals.mean()) < 0.015
    assert abs(normals.std() - 1.0) < 0.01
    assert abs(np.mean(normals**4) - 3.0) < 0.15
    assert abs(np.corrcoef(normals[::2], normals[1::2])[0, 1]) < 0.02


def test_neighbouring_streams_have_nothing_to_do_with_each_other() -> None:
    for axis in range(4):
        names = np.full((2000, 4), 5)
        names[:, axis] += np.arange(2000)
        firsts = np.array([_drawn(a, b, c, d, 2)[1][0] for a, b, c, d in names.tolist()])
        assert abs(firsts.mean()) < 0.1
        assert abs(firsts.std() - 1.0) < 0.07
        assert abs(np.corrcoef(firsts[1:], firsts[:-1])[0, 1]) < 0.08


def test_a_stream_is_the_published_generator_from_its_own_start() -> None:
    state, words = 0, []
    for _ in range(2):
        state = (state + 0x9E3779B97F4A7C15) % 2**64
        words.append(int(mix(np.uint64(state))))
    # The first two numbers of SplitMix64 from state 0.
    assert words == [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4]
    assert uniform(np.uint64(0), 1) == (words[1] >> 11) * 2.0**-53
    uniforms, _ = _drawn(0, 0, 0, 0, 4)
    again, _ = _drawn(0, 0, 0, 0, 4)
    np.testing.assert_array_equal(uniforms, again)
