"""Go or no-go: every check can pass, warn and fail, and says why."""

import asyncio
import socket
from collections import namedtuple
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from companion.clock import Clock, SystemClock
from companion.config import Profile
from companion.directories import LOCK_NAME, Directories, only_instance
from companion.drivers.livox_health import LidarInfo
from companion.drivers.livox_settings import LivoxSettings
from companion.drivers.px4_param_client import TYPE_INT32, TYPE_REAL32, float_of
from companion.drivers.px4_params import rules
from companion.drivers.px4_session import Px4Session
from companion.drivers.px4_settings import Px4Settings
from companion.errors import StartError
from companion.messages import MavlinkMessage
from companion.preflight import autopilot, host, lidar, table
from companion.preflight.check import Check, guarded, is_go
from companion.yaml_source import loads
from tests.profiles import GOOD

SECOND_NS = 1_000_000_000
Usage = namedtuple("Usage", "total used free")

# Loopback addresses and ports of this file alone, so that no other test or program is in the way.
LIDAR = LivoxSettings.model_validate_json(
    '{"lidar_ip": "127.0.7.2", "host_ip": "127.0.7.1", "broadcast_search": false, "host_ports":'
    ' {"discovery": 47600, "command": 47601, "state": 47602, "points": 47603, "imu": 47604}}'
)


class SteppedClock(SystemClock):
    """Host time that moves only by sleeping."""

    def __init__(self) -> None:
        self.t_ns = 1000 * SECOND_NS

    def now_ns(self) -> int:
        return self.t_ns

    async def sleep(self, duration_ns: int) -> None:
        self.t_ns += duration_ns
        await super().sleep(0)


@pytest.fixture
def profile() -> Profile:
    return loads(GOOD, Profile)


def test_only_a_failure_is_a_no_go() -> None:
    assert is_go([Check("a", "ok", ""), Check("b", "warn", ""), Check("c", "skipped", "")])
    assert not is_go([Check("a", "ok", ""), Check("b", "fail", "")])


def test_an_error_on_purpose_or_of_the_system_fails_its_check_in_one_line() -> None:
    def start() -> Check:
        raise StartError("LiDAR:\n no answer")

    def read() -> Check:
        raise OSError(5, "Input/output error")

    assert guarded("LiDAR", start) == [Check("LiDAR", "fail", "LiDAR: no answer")]
    assert guarded("disk", read) == [Check("disk", "fail", "[Errno 5] Input/output error")]


def test_a_bug_in_a_check_is_not_taken_for_a_failure_of_the_vehicle() -> None:
    with pytest.raises(ZeroDivisionError):
        guarded("x", lambda: Check("x", "ok", str(1 / 0)))


class TestHost:
    def test_python_and_packages_are_those_of_this_installation(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        assert host.check_python().verdict == "ok"
        assert host.check_packages().verdict == "ok"
        monkeypatch.setattr("sys.version_info", (3, 9, 1))
        assert host.check_python().verdict == "fail"
        needed = ["numpy>=2.1", "no-such-thing<2", "gone>1; extra == 'dev'"]
        monkeypatch.setattr("importlib.metadata.requires", lambda name: needed)
        assert host.check_packages() == Check("packages", "fail", "not installed: no-such-thing")

    def test_kernels_that_have_to_be_compiled_are_a_warning(self) -> None:
        clock = SteppedClock()

        def compiling(seconds: int) -> Callable[[], int]:
            def load() -> int:
                clock.t_ns += seconds * SECOND_NS
                return 12

            return load

        assert host.check_kernels(clock, compiling(1)) == Check("kernels", "ok", "12 kernels ready in 1.0 s")
        slow = host.check_kernels(clock, compiling(90))
        assert slow.verdict == "warn"
        assert "companion warmup" in slow.reason

    def test_a_clock_that_was_never_set_is_a_warning(self) -> None:
        assert host.check_calendar(SystemClock().calendar_ns()).verdict == "ok"
        assert host.check_calendar(0).verdict == "warn"

    def test_the_log_folder_is_tried_by_writing(self, tmp_path: Path) -> None:
        assert host.check_log_folder(tmp_path) == Check("log folder", "ok", str(tmp_path))
        assert host.check_log_folder(tmp_path / "a" / "b").reason.endswith("(will be created)")
        assert list(tmp_path.iterdir()) == []
        (tmp_path / "uav1.mcap.open").touch()
        assert host.check_log_folder(tmp_path).verdict == "warn"
        (failure,) = guarded("log folder", lambda: host.check_log_folder(Path("/proc/self/fdinfo")))
        assert failure.verdict == "fail"

    @pytest.mark.parametrize(("free", "verdict"), [(80e9, "ok"), (2e9, "warn"), (0.5e9, "fail")])
    def test_the_disk_must_hold_a_flight(
        self, free: float, verdict: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("shutil.disk_usage", lambda path: Usage(100e9, 0, free))
        assert host.check_disk(tmp_path / "not" / "yet").verdict == verdict

    def test_the_kernel_is_asked_for_the_receive_buffer(self) -> None:
        assert host.check_receive_buffer(65_536).verdict == "ok"
        refused = host.check_receive_buffer(2**30)
        assert refused.verdict == "warn"
        assert "net.core.rmem_max=1073741824" in refused.reason

    @pytest.mark.parametrize(("limit", "verdict"), [(0, "ok"), (-1, "warn")])
    def test_core_files_are_a_warning(
        self, limit: int, verdict: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("resource.getrlimit", lambda which: (limit, -1))
        assert host.check_core_files().verdict == verdict

    def test_a_companion_that_runs_already_is_a_no_go(self, tmp_path: Path) -> None:
        assert host.check_single_instance(tmp_path / "none").verdict == "ok"
        assert host.check_single_instance(tmp_path).verdict == "ok"
        with only_instance(tmp_path / LOCK_NAME):
            assert host.check_single_instance(tmp_path).verdict == "fail"


class TestLidar:
    def test_the_network_is_right_when_address_and_ports_are_free(self) -> None:
        assert lidar.check_lidar_network(LIDAR) == Check("LiDAR network", "ok", "127.0.7.1 reaches 127.0.7.2")

    def test_an_address_in_another_network_is_a_warning(self) -> None:
        settings = LIDAR.model_copy(update={"host_ip": "127.0.8.1"})
        check = lidar.check_lidar_network(settings)
        assert check.verdict == "warn"
        assert "127.0.7.0/24" in check.reason

    def test_an_address_of_nobody_or_a_taken_port_is_named(self) -> None:
        nobody = LIDAR.model_copy(update={"host_ip": "192.0.2.77"})
        (check,) = guarded("LiDAR network", lambda: lidar.check_lidar_network(nobody))
        assert check.verdict == "fail"
        assert "192.0.2.77" in check.reason
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.bind(("127.0.7.1", LIDAR.host_ports.points))
            (check,) = guarded("LiDAR network", lambda: lidar.check_lidar_network(LIDAR))
        assert check.verdict == "fail"
        assert str(LIDAR.host_ports.points) in check.reason

    def test_a_silent_lidar_fails_with_the_stage_at_which_it_is_silent(self) -> None:
        with pytest.raises(StartError, match=r"no answer to discovery from 127\.0\.7\.2"):
            asyncio.run(lidar.check_lidar(LIDAR, SystemClock(), 0.3))

    @pytest.mark.parametrize(("codes", "verdict"), [((), "ok"), ((0x0103,), "warn")])
    def test_a_streaming_lidar_is_ok_and_its_health_codes_are_a_warning(
        self, codes: tuple[int, ...], verdict: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        stopped: list[bool] = []

        class Driver:
            info = replace(LidarInfo(), serial="47MDL", firmware_version="1.2.3.4", hms_codes=codes)

            def __init__(self, *given: object) -> None:
                pass

            async def start(self, timeout_s: float) -> None:
                pass

            async def stop(self) -> None:
                stopped.append(True)

        monkeypatch.setattr(lidar, "LivoxDriver", Driver)
        check = asyncio.run(lidar.check_lidar(LIDAR, SystemClock(), 1.0))
        assert check.verdict == verdict
        assert check.reason.startswith("serial 47MDL, firmware 1.2.3.4, streams")
        assert stopped == [True]


class FakeLink:
    """An autopilot at the end of a link: heartbeats and parameters, nothing else."""

    def __init__(self, parameters: dict[str, int | float], systems: Sequence[int] = (1,)) -> None:
        self.parameters = parameters
        self.systems = systems
        self.sent: list[str] = []
        self.stopped = False

    def __call__(
        self, settings: Px4Settings, session: Px4Session, clock: Clock, on_message: Callable[..., None]
    ) -> "FakeLink":
        self.clock, self.on_message = clock, on_message
        return self

    def heartbeat(self) -> None:
        fields: dict[str, object] = {
            "type": 2, "autopilot": 12, "base_mode": 81, "custom_mode": 50593792, "system_status": 3,
            "mavlink_version": 3,
        }  # fmt: skip
        for system in self.systems:
            self.on_message(MavlinkMessage("HEARTBEAT", system, 1, fields), self.clock.now_ns())

    async def start(self, timeout_s: float) -> None:
        self.heartbeat()

    async def send(self, messages: Sequence[MavlinkMessage]) -> None:
        self.heartbeat()
        for message in messages:
            self.sent.append(message.name)
            name = message.fields.get("param_id")
            if message.name == "PARAM_REQUEST_READ" and name in self.parameters:
                value = self.parameters[str(name)]
                fields: dict[str, object] = {
                    "param_id": name,
                    "param_value": float_of(value),
                    "param_type": TYPE_INT32 if isinstance(value, int) else TYPE_REAL32,
                    "param_count": 1,
                    "param_index": 0,
                }
                self.on_message(MavlinkMessage("PARAM_VALUE", 1, 1, fields), self.clock.now_ns())

    async def stop(self) -> None:
        self.stopped = True


class TestAutopilot:
    def survey(self, profile: Profile, link: FakeLink) -> dict[str, Check]:
        checks = asyncio.run(autopilot.check_autopilot(profile, SteppedClock(), link))
        assert link.stopped
        assert "PARAM_SET" not in link.sent
        return {check.name: check for check in checks}

    def right(self, profile: Profile) -> dict[str, int | float]:
        return {rule.name: rule.recommended for rule in rules(autopilot.needs_of(profile))}

    def test_the_right_autopilot_with_the_right_parameters_is_a_go(self, profile: Profile) -> None:
        checks = self.survey(profile, FakeLink(self.right(profile)))
        assert checks["autopilot"].verdict == "ok"
        assert checks["parameters"].verdict == "ok"
        assert checks["radio control"].verdict == "warn"
        assert checks["battery"] == Check("battery", "warn", "its charge is unknown")

    def test_a_wrong_or_missing_parameter_is_named_with_its_reason(self, profile: Profile) -> None:
        parameters = self.right(profile)
        parameters["EKF2_EV_CTRL"] = 0
        del parameters["EKF2_HGT_REF"]
        checks = self.survey(profile, FakeLink(parameters))
        assert checks["parameter EKF2_EV_CTRL"].verdict == "fail"
        assert "EKF2_EV_CTRL is 0, wanted 11 or 15" in checks["parameter EKF2_EV_CTRL"].reason
        assert "EKF2_HGT_REF is missing" in checks["parameter EKF2_HGT_REF"].reason
        assert "parameters" not in checks

    def test_the_needs_are_those_of_the_profile(self) -> None:
        text = GOOD + "safety: {max_speed_mps: 7.5}\nautopilot: {system_id: 9, min_odometry_quality: 33}\n"
        needs = autopilot.needs_of(loads(text, Profile))
        assert (needs.system_id, needs.max_speed_mps, needs.min_odometry_quality) == (9, 7.5, 33)

    def test_another_autopilot_on_the_link_is_a_warning(self, profile: Profile) -> None:
        checks = self.survey(profile, FakeLink(self.right(profile), systems=(1, 42)))
        assert checks["autopilot"].verdict == "warn"
        assert "42" in checks["autopilot"].reason

    def test_the_link_is_closed_even_when_the_check_breaks(self, profile: Profile) -> None:
        class Broken(FakeLink):
            async def send(self, messages: Sequence[MavlinkMessage]) -> None:
                raise StartError("gone")

        link = Broken({})
        with pytest.raises(StartError, match="gone"):
            asyncio.run(autopilot.check_autopilot(profile, SteppedClock(), link))
        assert link.stopped


class TestTable:
    @pytest.fixture(autouse=True)
    def kernels(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Leave the kernels of the test process compilable."""
        monkeypatch.setattr(table, "load_kernels", lambda: 1)

    def directories(self, tmp_path: Path) -> Directories:
        return Directories(tmp_path / "run", tmp_path / "logs", tmp_path / "state")

    def test_offline_only_the_hardware_is_skipped(self, profile: Profile, tmp_path: Path) -> None:
        checks = table.run_checks(
            profile, Path("p.yaml"), self.directories(tmp_path), SystemClock(), offline=True
        )
        assert [check.name for check in checks if check.verdict == "skipped"] == list(table.HARDWARE)
        assert checks[0] == Check("profile", "ok", "p.yaml: uav1, leader")
        assert is_go(checks)

    def test_online_the_hardware_is_asked_and_its_silence_is_a_no_go(
        self, profile: Profile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        async def silent(*given: Any) -> Check:
            raise StartError("silent")

        monkeypatch.setattr(lidar, "check_lidar", silent)
        monkeypatch.setattr(autopilot, "check_autopilot", silent)
        profile = profile.model_copy(update={"lidar": LIDAR})
        checks = table.run_checks(
            profile, Path("p.yaml"), self.directories(tmp_path), SystemClock(), offline=False
        )
        assert [check.name for check in checks if check.verdict == "fail"] == ["LiDAR", "autopilot"]

    def test_the_table_for_people_holds_every_reason(self, capsys: pytest.CaptureFixture[str]) -> None:
        table.print_table([Check("disk", "fail", "full"), Check("clock", "ok", "[set]")], "uav1")
        out = capsys.readouterr().out
        assert "uav1: NO GO" in out
        assert "full" in out
        assert "[set]" in out
