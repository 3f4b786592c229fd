"""The vendor's official SDK takes the emulator for a Mid-360."""

import json
import subprocess
from pathlib import Path

import pytest

from companion.clock import SystemClock
from companion.drivers.livox_protocol import BROADCAST_IP
from sitl.livox_emulator import LivoxEmulator, LivoxEmulatorSettings
from sitl.livox_sockets import LivoxSockets
from tests.sitl.livox_feed import RealTimeFeed
from tests.sitl.livox_sdk_environment import SdkUnavailableError, sdk_interpreter

LIDAR_IP, HOST_IP = "127.79.0.2", "127.79.0.1"
TIMEOUT_S = 20.0


def test_the_official_sdk_connects_and_receives_points_and_inertial_samples(tmp_path: Path) -> None:
    try:
        interpreter = sdk_interpreter()
    except SdkUnavailableError as error:
        pytest.skip(f"the vendor's SDK is not available: {error}")
    clock = SystemClock()
    emulator = LivoxEmulator(LivoxEmulatorSettings(lidar_ip=LIDAR_IP), clock.now_ns())
    config = tmp_path / "mid360.json"
    config.write_text(json.dumps(_sdk_configuration()))
    client = Path(__file__).with_name("livox_sdk_client.py")
    command = [str(interpreter), str(client), str(config), str(TIMEOUT_S), "500", "50"]
    try:
        with RealTimeFeed(LivoxSockets(emulator, clock), emulator, clock):
            run = subprocess.run(
                command, capture_output=True, timeout=TIMEOUT_S + 20.0, check=True, cwd=tmp_path
            )
    except OSError as error:
        pytest.skip(f"{BROADCAST_IP} or the sensor's ports cannot be bound here: {error}")
    found = json.loads(run.stdout.splitlines()[-1])
    assert found["initialised"], found
    assert found["info"] == 1, found
    assert found["point_packets"] >= 500, found
    assert found["imu_packets"] >= 50, found
    assert (found["dot_num"], found["time_interval"]) == (96, 4750)
    assert found["acc"] == pytest.approx([0.0, 0.0, 1.0])
    assert found["gyr"] == pytest.approx([0.01, -0.02, 0.03], abs=1e-6)
    x, y, z, reflectivity, tag = found["first_points"][0]
    assert x * x + y * y == pytest.approx(5000**2, rel=1e-3)
    assert (z, tag) == (500, 0)
    assert reflectivity < 150
    assert emulator.malformed == 0


def _sdk_configuration() -> dict[str, object]:
    names = ("cmd_data_port", "push_msg_port", "point_data_port", "imu_data_port", "log_data_port")
    lidar = dict(zip(names, (56_100, 56_200, 56_300, 56_400, 56_500), strict=True))
    host = dict(zip(names, (56_101, 56_201, 56_301, 56_401, 56_501), strict=True))
    # Listing the sensor's address opens the data ports at once; its connection is a search all the same.
    network = [{"host_ip": HOST_IP, "lidar_ip": [LIDAR_IP], **host}]
    return {"master_sdk": True, "MID360": {"lidar_net_info": lidar, "host_net_info": network}}
