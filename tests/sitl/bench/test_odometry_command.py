import json
import subprocess
import sys
from pathlib import Path

import pytest

from companion.exit_codes import ExitCode
from sitl.bench.comparison import Result, Row
from sitl.bench.comparison_page import markdown, page, write
from sitl.cli import main

COLUMNS = {"world", "system", "ape_rmse_m", "drift_percent", "ms_median", "ms_p99", "cpu_ms_median"}


def _last(text: str) -> dict[str, object]:
    found: dict[str, object] = json.loads(text.splitlines()[-1])
    return found


def test_the_last_line_of_the_output_is_json_whatever_libraries_print(tmp_path: Path) -> None:
    pytest.importorskip("rko_lio")
    program = "from sitl.cli import main; raise SystemExit(main())"
    options = f"--worlds open_field --systems companion,rko-lio --duration 6 --json --out {tmp_path}"
    done = subprocess.run(
        [sys.executable, "-c", program, "bench", "odometry", *options.split()],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 1
    rows = json.loads(lines[0])["rows"]
    assert [row["system"] for row in rows] == ["companion", "rko_lio"]
    for row in rows:
        assert row.keys() >= COLUMNS
        assert all(isinstance(row[name], float) for name in COLUMNS - {"world", "system"})
    assert json.loads((tmp_path / "results.json").read_text())["rows"] == rows
    assert (tmp_path / "table.md").read_text().count("open_field") == 2
    assert "Plotly.newPlot" in (tmp_path / "odometry.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--worlds", "moon"], "there is no world 'moon'; there are indoor, pillars, forest, open_field"),
        (["--systems", "companion,lio"], "there is no system 'lio'; there are companion, rko_lio"),
        (["--truth", "path.tum"], "--truth goes with --recording"),
        (["--recording", "a.pcap", "--worlds", "indoor"], "--worlds and --recording exclude each other"),
        (["--duration", "1"], "1.0 is not in the range"),
    ],
)
def test_wrong_options_get_one_sentence(
    options: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "odometry", *options, "--json"]) == ExitCode.USAGE
    captured = capsys.readouterr()
    assert sentence in " ".join(captured.err.split())
    assert _last(captured.out)["exit"] == ExitCode.USAGE


def test_a_recording_that_is_not_there_or_is_none_gets_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--systems", "companion", "--out", str(tmp_path), "--json"]
    missing = tmp_path / "missing.pcap"
    assert main(["bench", "odometry", "--recording", str(missing), *options]) == ExitCode.NO_INPUT
    assert str(missing) in capsys.readouterr().err
    text = tmp_path / "text.pcap"
    text.write_text("no packets at all", "utf-8")
    assert main(["bench", "odometry", "--recording", str(text), *options]) == ExitCode.DATA
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_table_shows_what_is_unknown_as_a_dash() -> None:
    text = markdown(
        [Row("indoor", "companion", ape_rmse_m=0.0123, scans=5), Row("a|b", "kiss_icp", note="gone")]
    )
    head, rule, first, second = text.splitlines()
    assert head.count("|") == rule.count("|") == first.count("|") == second.count("|")
    assert "| 1.23 |" in first
    assert second.startswith("| a/b | kiss_icp | - |")


def test_names_on_the_page_are_escaped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("plotly.offline.get_plotlyjs", lambda: "/* plotting </script> library */")
    hostile = "<img src=x onerror=alert(1)></script>"
    text = page([Result(Row(hostile, "companion", note=hostile))])
    assert "<img" not in text
    assert text.count("</script>") == 3


def test_the_page_needs_nothing_from_outside(tmp_path: Path) -> None:
    pytest.importorskip("plotly")
    files = write(tmp_path, [Result(Row("indoor", "companion"))])
    assert [file.name for file in files] == ["results.json", "table.md", "odometry.html"]
    before_library = files[2].read_text("utf-8").partition("Plotly")[0]
    assert "src=" not in before_library
    assert "href=" not in before_library
    assert "default-src 'none'" in before_library
