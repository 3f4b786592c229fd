"""Preflight checks of the LiDAR and of the network between it and this computer."""

import ipaddress

from companion.clock import SystemClock
from companion.drivers.livox import LivoxDriver
from companion.drivers.livox_endpoints import open_endpoints, resolve_host_ip
from companion.drivers.livox_health import describe_hms
from companion.drivers.livox_settings import LivoxSettings
from companion.preflight.check import Check

STREAM_TIMEOUT_S = 8.0
_NETWORK_BITS = 24  # the Mid-360 leaves the factory with the mask 255.255.255.0


def check_lidar_network(settings: LivoxSettings) -> Check:
    """Find the own address towards the LiDAR, in the LiDAR's network, with its ports free.

    Raises:
        CompanionError: if there is no way to the LiDAR or a port is taken.
    """
    host_ip = resolve_host_ip(settings)
    open_endpoints(settings, host_ip).close()
    network = ipaddress.ip_network(f"{settings.lidar_ip}/{_NETWORK_BITS}", strict=False)
    if ipaddress.ip_address(host_ip) not in network:
        reason = f"the way to {settings.lidar_ip} leaves by {host_ip}, which is not in {network}"
        return Check("LiDAR network", "warn", reason)
    return Check("LiDAR network", "ok", f"{host_ip} reaches {settings.lidar_ip}")


async def check_lidar(settings: LivoxSettings, clock: SystemClock, timeout_s: float) -> Check:
    """Start the LiDAR as a flight does and wait until it streams.

    Raises:
        StartError: if it does not; the text says at which stage and what to look at.
    """
    driver = LivoxDriver(settings, clock, lambda event: None)
    await driver.start(timeout_s)
    info = driver.info
    await driver.stop()
    reason = f"serial {info.serial or 'unknown'}, firmware {info.firmware_version or 'unknown'}, streams"
    if info.hms_codes:
        return Check("LiDAR", "warn", f"{reason}; {'; '.join(map(describe_hms, info.hms_codes))}")
    return Check("LiDAR", "ok", reason)
