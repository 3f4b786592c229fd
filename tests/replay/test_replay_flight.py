"""A recorded flight once more: equal to the byte, and where it is not, what differs, where and why."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.cli import main
from companion.clock import SystemClock
from companion.errors import LogError, ProfileError
from companion.exit_codes import ExitCode
from companion.kernel_cache import load_kernels
from companion.logs import channels
from companion.logs.container_reader import RawMessage
from companion.logs.log_queue import LogEntry
from companion.logs.reader import FlightRecording
from companion.logs.records import QueuePlace
from companion.logs.recovery import add_messages
from companion.logs.tum import read_tum
from companion.messages import FlightState, Setpoint, StateChange
from companion.recordings.flight_packets import FlightPackets
from companion.replay.command import ReplayRequest, replay
from companion.replay.comparison import ChannelResult
from companion.replay.result import ReplayResult
from companion.replay.text import lines_of
from sitl.lockstep import BOOT_NS, fly_lockstep
from sitl.recording_writers.captures import write_pcap
from sitl.scenario import load_scenario, set_stage
from tests.replay.edited_logs import copy_log
from tests.sitl.external_scenario import write_external_scenario
from tests.sitl.short_flight import write_scenario

SECOND_NS = 1_000_000_000
SHORT_NS = BOOT_NS + 4 * SECOND_NS

Output = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight with everything in it: start at rest, take-off, permission, control."""
    folder = tmp_path_factory.mktemp("flown")
    load_kernels()
    stage = set_stage(load_scenario(write_scenario(folder, max_duration_s=9.4)), folder, None)
    fly_lockstep(stage, folder / "flight.mcap")
    return folder / "flight.mcap"


@pytest.fixture(scope="module")
def short(flown: Path) -> Path:
    """Its first four seconds: two at rest, two of odometry."""
    return copy_log(flown, flown.with_name("short.mcap"), until_ns=SHORT_NS)


def run(log: Path, *assignments: str, **wishes: Any) -> ReplayResult:
    return replay(ReplayRequest(log, assignments, **wishes), SystemClock())


def result_of(result: ReplayResult, channel: channels.Channel) -> ChannelResult:
    return next(found for found in result.channels if found.topic == channel.topic)


def text_of(result: ReplayResult) -> str:
    return "\n".join(lines_of(result))


def recorded(log: Path, channel: channels.Channel) -> list[object]:
    return [entry.message for entry in FlightRecording(log).messages(channel)]


class TestSameBytes:
    def test_a_whole_flight_comes_out_as_recorded(self, flown: Path, tmp_path: Path, capsys: Output) -> None:
        out, tum = tmp_path / "again.mcap", tmp_path / "again.tum"
        status = main(["replay", str(flown), "--out", str(out), "--tum", str(tum), "--json"])
        answer = json.loads(capsys.readouterr().out.splitlines()[-1])
        assert status == ExitCode.OK
        assert answer["equal"] is True
        assert answer["unexplained"] == []
        assert answer["configuration"] == answer["versions"] == []
        counts = {channel["topic"]: channel["equal"] for channel in answer["channels"]}
        for channel in (
            channels.LIDAR_FRAMES,
            channels.ODOMETRY,
            channels.SCAN,
            channels.CLOUD,
            channels.VEHICLE,
            channels.AUTHORISATION,
            channels.SETPOINT,
            channels.MODE_REQUEST,
            channels.STATE,
            channels.PLAN,
            channels.LOG,
            channels.MAVLINK_TX,
        ):
            assert counts[channel.topic] == len(recorded(flown, channel)) > 0, channel.topic
        assert FlightState.ACTIVE in {
            change.current for change in recorded(flown, channels.STATE) if isinstance(change, StateChange)
        }
        # The new log holds the same flight, packets included, and says what it is.
        again = FlightRecording(out)
        assert again.flight["replay_of"] == "flight.mcap"
        assert again.integrity().messages == FlightRecording(flown).integrity().messages
        assert again.integrity().complete
        path = read_tum(tum)
        assert len(path) == counts[channels.SCAN.topic]
        assert np.diff(path.t_ns).mean() == pytest.approx(1e8, rel=0.01)

    def test_a_log_that_was_cut_anywhere_is_replayed_as_far_as_it_goes(
        self, flown: Path, tmp_path: Path
    ) -> None:
        data = flown.read_bytes()
        cut = tmp_path / "cut.mcap.open"
        cut.write_bytes(data[: len(data) // 3])
        result = run(cut)
        assert not result.complete
        assert result.equal, text_of(result)
        assert not result.broken
        assert result_of(result, channels.VEHICLE).equal > 50
        assert "the log was not closed" in text_of(result)

    def test_odometry_alone_comes_out_as_recorded(self, short: Path) -> None:
        result = run(short, odometry_only=True)
        assert result.equal
        assert {found.topic for found in result.channels} == {
            "/lidar/frames",
            "/odometry",
            "/neighbours",
            "/scan",
            "/cloud",
        }
        assert result.recorded_accuracy == result.replayed_accuracy
        assert "equal: every message" in text_of(result)

    def test_samples_are_compared_where_they_were_recorded(self, short: Path) -> None:
        result = run(short, "log.imu=true", odometry_only=True)
        assert [(change.name, change.replayed) for change in result.configuration] == [("log.imu", "true")]
        assert result_of(result, channels.IMU).extra > 700

    def test_a_flight_on_another_process_odometry_comes_out_as_recorded(self, tmp_path: Path) -> None:
        load_kernels()
        scenario = write_external_scenario(tmp_path, max_duration_s=4.5)
        log = tmp_path / "flight.mcap"
        fly_lockstep(set_stage(load_scenario(scenario), tmp_path, None), log)
        assert len(recorded(log, channels.EXTERNAL_ODOMETRY)) > 50
        result = run(log)
        assert result.equal, text_of(result)
        assert result_of(result, channels.SCAN).equal > 10


class TestDifferences:
    def test_changed_messages_are_found_at_their_times(self, flown: Path, tmp_path: Path) -> None:
        changed: dict[str, int] = {}

        def edit(item: RawMessage) -> bytes | None:
            by_role = item.channel.topic == "/setpoint" and b'"reason":"role"' in item.data
            if by_role and "setpoint" not in changed:
                changed["setpoint"] = item.t_ns
                return item.data.replace(b'"yaw_rate":', b'"yaw_rate":1', 1)
            if item.channel.topic == "/state" and b'"current":"ready"' in item.data:
                changed["state"] = item.t_ns
                return None
            if item.channel.topic == "/odometry" and item.sequence == 700:
                changed["odometry"] = item.t_ns
                return item.data.replace(b'"quality":', b'"quality":1', 1)
            return item.data

        result = run(copy_log(flown, tmp_path / "edited.mcap", edit))
        assert result.broken
        setpoint = result_of(result, channels.SETPOINT)
        assert (setpoint.different, setpoint.missing, setpoint.extra) == (1, 0, 0)
        assert setpoint.first is not None
        assert (setpoint.first.t_ns, setpoint.first.field) == (changed["setpoint"], "yaw_rate")
        odometry = result_of(result, channels.ODOMETRY)
        assert odometry.first is not None
        assert (odometry.different, odometry.first.t_ns) == (1, changed["odometry"])
        assert odometry.first.field == "quality"
        assert odometry.first.recorded == "1" + odometry.first.replayed
        assert result.odometry is not None
        assert result.odometry["position_m"] == 0.0
        # A message that the log has lost is no difference of the replay: its number is missing.
        state = result_of(result, channels.STATE)
        assert (state.different, state.missing, state.extra) == (0, 0, 1)
        assert result.missing == {"/state": 1}
        assert result.unexplained == ["/odometry", "/setpoint"]
        text = text_of(result)
        seconds = (changed["setpoint"] - result.start_ns) * 1e-9
        assert f"first on /setpoint at {seconds:.3f} s: yaw_rate: 1" in text
        assert "although configuration and versions are as in flight: /odometry, /setpoint" in text

    def test_a_changed_setting_is_named_and_explains_all_that_differs(
        self, flown: Path, capsys: Output
    ) -> None:
        assert main(["replay", str(flown), "--set", "leader.mission.speed_mps=0.6"]) == ExitCode.OK
        out = capsys.readouterr().out
        assert "leader.mission.speed_mps: 1.5 -> 0.6" in out
        assert "first on /setpoint at " in out
        assert "different, as configuration or versions are" in out

    def test_another_odometry_gives_another_path_and_says_how_far_off(
        self, short: Path, tmp_path: Path
    ) -> None:
        result = run(short, "odometry.fine_cell_m=0.25", odometry_only=True, tum=tmp_path / "t.tum")
        assert not result.equal
        assert not result.broken
        assert result.odometry is not None
        assert 0.0 < result.odometry["position_m"] < 0.1
        assert result.recorded_accuracy is not None
        assert result.replayed_accuracy is not None
        assert result.recorded_accuracy != result.replayed_accuracy
        assert len(read_tum(tmp_path / "t.tum")) > 15

    def test_a_difference_without_a_reason_has_its_own_status(
        self, short: Path, tmp_path: Path, capsys: Output
    ) -> None:
        def edit(item: RawMessage) -> bytes | None:
            turned = item.channel.topic == "/scan" and item.sequence == 3
            return item.data.replace(b'"points":', b'"points":1', 1) if turned else item.data

        log = copy_log(short, tmp_path / "edited.mcap", edit)
        assert main(["replay", str(log), "--odometry-only", "--json"]) == ExitCode.DIFFERENT
        answer = json.loads(capsys.readouterr().out.splitlines()[-1])
        assert (answer["exit"], answer["unexplained"]) == (4, ["/scan"])

    def test_lost_packets_explain_what_differs_after_them(self, short: Path, tmp_path: Path) -> None:
        lost_ns: list[int] = []

        def edit(item: RawMessage) -> bytes | None:
            if item.channel.topic == "/lidar/packets" and item.t_ns > SHORT_NS - SECOND_NS and not lost_ns:
                lost_ns.append(item.t_ns)
                return None
            return item.data

        result = run(copy_log(short, tmp_path / "edited.mcap", edit), odometry_only=True)
        assert result.missing == {"/lidar/packets": 1}
        assert not result.equal
        assert result.unexplained == []
        first = result_of(result, channels.ODOMETRY).first
        assert first is not None
        assert first.t_ns >= lost_ns[0] - SECOND_NS // 10
        assert "different only where the log is incomplete" in text_of(result)

    def test_what_perception_left_out_in_flight_is_left_out_again(self, short: Path, tmp_path: Path) -> None:
        """A scan is declared left out; all that follows differs, because in truth it was not."""
        frame: Any = recorded(short, channels.LIDAR_FRAMES)[-5]
        mark = QueuePlace(frame.t_ns, "scan", frame.t_sensor_start_ns, -1)
        log = tmp_path / "marked.mcap"
        add_messages(short, [LogEntry(channels.QUEUE_PLACE, frame.t_ns, 0, mark)], log)
        result = run(log, odometry_only=True)
        assert result.skipped == 1
        scans = result_of(result, channels.SCAN)
        assert scans.missing == 1
        assert scans.first is not None
        assert f'"sequence": {frame.sequence}' in scans.first.recorded
        assert scans.first.replayed == ""


class TestRefusals:
    @pytest.mark.parametrize(
        ("assignment", "said"),
        [
            ("odometry.fine_cel_m=0.2", "odometry.fine_cel_m: unknown key, did you mean fine_cell_m?"),
            ("odometry.fine_cell_m=99", "odometry.fine_cell_m: found 99, allowed is a number from"),
            ("odometry.fine_cell_m=wide", "odometry.fine_cell_m: found text 'wide', allowed is a number"),
            ("odometry.fine_cell_m=[1", "odometry.fine_cell_m: found no YAML value"),
            ("odometry.fine_cell_m", "found no key.path=value"),
            ("odometry..fine_cell_m=1", "found no key.path=value"),
            ("=1", "found no key.path=value"),
        ],
    )
    def test_a_wrong_assignment_is_one_sentence(
        self, short: Path, capsys: Output, assignment: str, said: str
    ) -> None:
        assert main(["replay", str(short), "--set", assignment]) == ExitCode.CONFIG
        error = capsys.readouterr().err
        assert error.startswith(f"--set {assignment}: {said}")
        assert error.count("\n") == 1

    def test_a_log_without_packets_says_so(self, short: Path, tmp_path: Path) -> None:
        def edit(item: RawMessage) -> bytes | None:
            return None if item.channel.topic == "/lidar/packets" else item.data

        out = tmp_path / "out.mcap"
        with pytest.raises(LogError, match="no raw LiDAR packets in this log"):
            run(copy_log(short, tmp_path / "bare.mcap", edit), out=out)
        assert not out.exists()

    def test_a_log_without_configuration_needs_a_profile(self, short: Path, tmp_path: Path) -> None:
        log = copy_log(short, tmp_path / "bare.mcap", configuration=lambda text: "")
        with pytest.raises(LogError, match="name a profile with --profile"):
            run(log, odometry_only=True)
        profile = tmp_path / "profile.yaml"
        profile.write_text(FlightRecording(short).configuration)
        result = run(log, odometry_only=True, profile=profile)
        assert result.equal

    def test_an_existing_log_is_not_overwritten(self, short: Path, tmp_path: Path) -> None:
        out = tmp_path / "out.mcap"
        out.write_text("precious")
        with pytest.raises(LogError, match="exists already"):
            run(short, out=out)
        assert out.read_text() == "precious"

    @pytest.mark.parametrize("arguments", [[], ["--odometry-only"]])
    def test_what_is_no_recording_is_told_so(
        self, tmp_path: Path, capsys: Output, arguments: Sequence[str]
    ) -> None:
        path = tmp_path / "flight.mcap"
        path.write_bytes(b"not a log")
        assert main(["replay", str(path), *arguments]) == ExitCode.DATA
        assert "no known format" in capsys.readouterr().err
        assert main(["replay", str(tmp_path / "none.mcap")]) == ExitCode.NO_INPUT


class TestOtherVersions:
    def test_settings_that_have_gone_or_come_are_differences_and_no_mistake(
        self, short: Path, tmp_path: Path
    ) -> None:
        def older(text: str) -> str:
            lines = [line for line in text.splitlines() if "chunk_kib" not in line]
            return "\n".join(lines).replace("  raw_lidar:", "  long_gone: 7\n  raw_lidar:") + "\n"

        result = run(copy_log(short, tmp_path / "older.mcap", configuration=older), odometry_only=True)
        changes = {change.name: (change.recorded, change.replayed) for change in result.configuration}
        assert changes == {"log.long_gone": ("7", "(absent)"), "log.chunk_kib": ("(absent)", "64")}
        assert result.equal

    def test_a_recorded_value_that_is_not_allowed_any_more_is_named(
        self, short: Path, tmp_path: Path
    ) -> None:
        log = copy_log(
            short,
            tmp_path / "older.mcap",
            configuration=lambda text: text.replace("chunk_kib: 64", "chunk_kib: 1"),
        )
        with pytest.raises(ProfileError, match=r"log\.chunk_kib: found 1, allowed is"):
            run(log, odometry_only=True)
        assert run(log, "log.chunk_kib=64", odometry_only=True).configuration[0].recorded == "1"


class TestOtherRecordings:
    def test_a_recording_of_the_sensor_alone_gives_the_same_path(
        self, short: Path, tmp_path: Path, capsys: Output
    ) -> None:
        capture, profile = tmp_path / "lidar.pcap", tmp_path / "profile.yaml"
        write_pcap(capture, FlightPackets(short).datagrams())
        profile.write_text(FlightRecording(short).configuration)
        alone = ["replay", str(capture)]
        assert main(alone) == ExitCode.DATA
        assert "replay it with --odometry-only" in capsys.readouterr().err
        assert main([*alone, "--odometry-only"]) == ExitCode.DATA
        assert "name one with --profile" in capsys.readouterr().err
        wanted = [*alone, "--odometry-only", "--profile", str(profile)]
        assert main([*wanted, "--tum", str(tmp_path / "capture.tum")]) == ExitCode.OK
        assert "scans registered along" in capsys.readouterr().out
        run(short, odometry_only=True, tum=tmp_path / "log.tum")
        assert (tmp_path / "capture.tum").read_text() == (tmp_path / "log.tum").read_text()
        capture.write_bytes(capture.read_bytes()[:-100])
        assert main(wanted) == ExitCode.OK
        out = capsys.readouterr().out
        assert "the recording ends early" in out
        assert "the log was not closed" not in out


class TestTrajectory:
    def test_the_recorded_path_and_the_truth_are_written(
        self, short: Path, tmp_path: Path, capsys: Output
    ) -> None:
        for source in ("odometry", "truth"):
            tum = tmp_path / f"{source}.tum"
            assert main(["trajectory", str(short), "--tum", str(tum), "--source", source]) == 0
            assert f"{tum}: {len(read_tum(tum))} poses" in capsys.readouterr().out

    def test_a_log_is_not_replaced_by_its_own_path(self, short: Path, tmp_path: Path, capsys: Output) -> None:
        log = copy_log(short, tmp_path / "flight.mcap")
        content = log.read_bytes()
        for verb in (["trajectory"], ["replay", "--odometry-only"]):
            assert main([*verb, str(log), "--tum", str(log)]) == ExitCode.DATA
            assert "exists and is no trajectory, so it is not replaced" in capsys.readouterr().err
        assert log.read_bytes() == content

    def test_a_log_without_such_poses_says_so(self, short: Path, tmp_path: Path, capsys: Output) -> None:
        log = copy_log(short, tmp_path / "early.mcap", until_ns=BOOT_NS + SECOND_NS // 2)
        arguments = ["trajectory", str(log), "--tum", str(tmp_path / "t.tum")]
        assert main(arguments) == ExitCode.DATA
        assert "no usable pose on /odometry" in capsys.readouterr().err


def test_setpoints_of_the_flight_move_the_vehicle(flown: Path) -> None:
    """The flight these tests rest on is one: otherwise equality would say little."""
    speeds = [np.linalg.norm(s.v_map) for s in recorded(flown, channels.SETPOINT) if isinstance(s, Setpoint)]
    assert max(speeds) > 0.3
