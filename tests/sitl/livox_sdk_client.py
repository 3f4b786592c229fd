"""Runs under the interpreter with the vendor's SDK: connects, counts, reports one line of JSON.

Usage: ``python livox_sdk_client.py CONFIG_JSON SECONDS POINTS IMU``. Ends as soon as the information
callback fired and the wanted numbers of point and inertial packets arrived, or after SECONDS.
"""

import importlib
import json
import os
import struct
import sys
import threading
from typing import Any


def main() -> None:
    """Connect as any user of the SDK does."""
    config, seconds, want_points, want_imu = sys.argv[1:5]
    sdk: Any = importlib.import_module("livox_sdk")
    found: dict[str, Any] = {"info": 0, "point_packets": 0, "imu_packets": 0, "handle": 0}
    done = threading.Event()

    def finish_if_done() -> None:
        enough = found["point_packets"] >= int(want_points) and found["imu_packets"] >= int(want_imu)
        if enough and found["info"]:
            done.set()

    def on_info(*arguments: Any) -> None:
        found["info"] += 1
        found["info_arguments"] = [str(argument) for argument in arguments]
        handle = int(arguments[0])
        found["handle"] = handle
        sdk.SetLivoxLidarPclDataType(handle, 1)
        sdk.SetLivoxLidarWorkMode(handle, 1)
        sdk.EnableLivoxLidarImuData(handle)
        finish_if_done()

    def on_points(packet: Any) -> None:
        data = bytes(packet.get_pts_data())
        if not found["point_packets"]:
            found["dot_num"] = int(packet.dot_num)
            found["time_interval"] = int(packet.time_interval)
            found["first_points"] = [list(struct.unpack_from("<iiiBB", data, 14 * i)) for i in range(4)]
        found["point_packets"] += 1
        finish_if_done()

    def on_imu(packet: Any) -> None:
        if not found["imu_packets"]:
            found["acc"], found["gyr"] = list(packet.acc), list(packet.gyr)
        found["imu_packets"] += 1
        finish_if_done()

    found["version"] = list(sdk.GetLivoxLidarSdkVer())
    sdk.DisableLivoxSdkConsoleLogger()
    sdk.SetLivoxLidarInfoChangeCallback(on_info)
    sdk.SetLivoxLidarPointCloudCallBack(on_points)
    sdk.SetLivoxLidarImuDataCallback(on_imu)
    found["initialised"] = bool(sdk.LivoxLidarSdkInit(config))
    done.wait(float(seconds))
    sys.stdout.write(json.dumps(found) + "\n")
    sys.stdout.flush()
    # The SDK's own shutdown can hang; everything worth knowing has been written.
    os._exit(0)


if __name__ == "__main__":
    main()
