from pathlib import Path

from companion import __version__
from companion.logs.metadata import FlightMetadata, software_versions, source_commit


def test_versions_name_the_companion_python_and_the_packages_that_fly() -> None:
    versions = software_versions()
    assert versions["companion"] == __version__
    assert {"python", "numpy", "mcap"} <= versions.keys()
    assert all(versions.values())
    assert list(versions) == sorted(versions)


def test_the_commit_is_read_from_the_checkout(tmp_path: Path) -> None:
    assert source_commit(tmp_path) == ""
    git = tmp_path / ".git"
    (git / "refs" / "heads").mkdir(parents=True)
    (git / "HEAD").write_text("ref: refs/heads/main\n")
    assert source_commit(tmp_path) == ""
    (git / "refs" / "heads" / "main").write_text("0123456789abcdef\n")
    assert source_commit(tmp_path) == "0123456789abcdef"
    (git / "HEAD").write_text("fedcba9876543210\n")
    assert source_commit(tmp_path) == "fedcba9876543210"


def test_what_is_unknown_is_left_out_and_seed_zero_is_known() -> None:
    assert FlightMetadata("a", "leader", "flight").table() == {
        "mode": "flight",
        "role": "leader",
        "vehicle": "a",
    }
    table = FlightMetadata("a", "leader", "lockstep", seed=0, calendar_ns=5).table()
    assert (table["seed"], table["calendar_ns"]) == ("0", "5")
