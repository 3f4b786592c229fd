"""Trajectories as text: there and back, and every mistake by its line."""

from pathlib import Path

import numpy as np
import pytest

from companion.errors import LogError
from companion.geometry import rotation
from companion.geometry.trajectory import Trajectory
from companion.logs import tum
from companion.logs.tum import read_tum, write_tum

POSE = "1 2 3 0 0 0 1"


def a_trajectory(n: int = 50) -> Trajectory:
    rng = np.random.default_rng(1)
    t_ns = np.cumsum(rng.integers(1, 10**9, n)) + 1_700_000_000_000_000_000
    return Trajectory(t_ns, rng.normal(size=(n, 3)), rotation.normalize(rng.normal(size=(n, 4))))


def refusal(tmp_path: Path, text: str | bytes) -> str:
    path = tmp_path / "t.tum"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(LogError) as caught:
        read_tum(path)
    assert "\n" not in str(caught.value)
    return str(caught.value).replace(str(path), "FILE")


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    written = a_trajectory()
    write_tum(tmp_path / "t.tum", written)
    read = read_tum(tmp_path / "t.tum")
    assert np.array_equal(read.t_ns, written.t_ns)
    assert np.array_equal(read.p, written.p)
    assert np.allclose(read.q, written.q, atol=1e-15)


def test_columns_are_in_the_order_of_the_format(tmp_path: Path) -> None:
    pose = Trajectory(
        np.array([1_000_000_007]), np.array([[1.0, 2.0, 3.0]]), np.array([[0.5, 0.5, -0.5, 0.5]])
    )
    write_tum(tmp_path / "t.tum", pose)
    assert (tmp_path / "t.tum").read_text().splitlines()[1] == "1.000000007 1.0 2.0 3.0 0.5 -0.5 0.5 0.5"


def test_times_before_zero_survive(tmp_path: Path) -> None:
    t_ns = np.array([-1_500_000_000, -1, 0])
    write_tum(tmp_path / "t.tum", Trajectory(t_ns, np.zeros((3, 3)), np.tile(rotation.IDENTITY, (3, 1))))
    assert read_tum(tmp_path / "t.tum").t_ns.tolist() == t_ns.tolist()


def test_comments_empty_lines_tabs_and_exponents_are_read(tmp_path: Path) -> None:
    path = tmp_path / "t.tum"
    path.write_text(f"# heading\n\n1.403636579763555527e+09\t{POSE}\r\n  # more\n1403636580 {POSE}\n")
    assert read_tum(path).t_ns.tolist() == [1_403_636_579_763_555_527, 1_403_636_580_000_000_000]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"1 {POSE}\n2 1 2 3\n", "FILE:2: found 4 columns"),
        (f"1,{POSE.replace(' ', ',')}\n", "FILE:1: found 1 columns"),
        (f"# x\n\none {POSE}\n", "FILE:3: found something that is no number"),
        (f"1 {POSE}\n1 {POSE}\n", "FILE:2: found a time that does not come after"),
        (f"2 {POSE}\n1 {POSE}\n", "FILE:2: found a time that does not come after"),
        (f"nan {POSE}\n", "FILE:1: found the time nan"),
        (f"1e300 {POSE}\n", "FILE:1: found the time 1e300"),
        (f"1e999999999 {POSE}\n", "FILE:1: found the time"),
        ("1 nan 2 3 0 0 0 1\n", "FILE:1: found a value beyond any flight"),
        ("1 1 2 inf 0 0 0 1\n", "FILE:1: found a value beyond any flight"),
        ("1 1 2 3 0 0 0 0\n", "FILE:1: found a quaternion of length 0"),
        ("1 1 2 3 0 0 0 7\n", "FILE:1: found a quaternion of length 7"),
        ("", "FILE: no pose in it"),
        ("# only words\n", "FILE: no pose in it"),
        (b"\xff\xfe\x00\x01 binary\n", "FILE:1: found"),
        ("1 " + "2" * 5000, "FILE:1: a line of more than 1024 bytes"),
    ],
)
def test_a_mistake_is_named_by_its_line(tmp_path: Path, text: str | bytes, said: str) -> None:
    assert refusal(tmp_path, text).startswith(said)


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tum, "MAX_BYTES", 10)
    assert "allowed are 10" in refusal(tmp_path, f"1 {POSE}\n")
    monkeypatch.undo()
    monkeypatch.setattr(tum, "MAX_POSES", 1)
    assert refusal(tmp_path, f"1 {POSE}\n2 {POSE}\n").startswith("FILE:2: found more than 1 poses")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"nothing\.tum: cannot be read"):
        read_tum(tmp_path / "nothing.tum")


@pytest.mark.parametrize("content", [b"\x89MCAP0\r\n\x01\x02", b"#ROSBAG V2.0\n\x45\x00\x00", b"x" * 5000])
def test_a_file_that_is_no_trajectory_is_not_replaced(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "flight.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=r"flight\.mcap: exists and is no trajectory"):
        write_tum(path, Trajectory(np.zeros(1, dtype=np.int64), np.zeros((1, 3)), rotation.IDENTITY[None]))
    assert path.read_bytes() == content


def test_a_trajectory_is_replaced_and_a_missing_folder_is_named(tmp_path: Path) -> None:
    one = Trajectory(np.zeros(1, dtype=np.int64), np.zeros((1, 3)), rotation.IDENTITY[None])
    for content in (f"1 {POSE}\n", "# only words\n", ""):
        (tmp_path / "t.tum").write_text(content)
        write_tum(tmp_path / "t.tum", one)
        assert read_tum(tmp_path / "t.tum").t_ns.tolist() == [0]
    with pytest.raises(FileNotFoundError, match="no such folder"):
        write_tum(tmp_path / "nowhere" / "t.tum", one)
