"""Preflight checks that need the LiDAR's network, the LiDAR or the autopilot."""

import asyncio
import ipaddress
import socket
from collections.abc import Callable

from companion.clock import SystemClock
from companion.config import Profile
from companion.drivers.livox_settings import LivoxSettings
from companion.preflight.check import Check

LIDAR_TIMEOUT_S = 8.0
_NETWORK_BITS = 24  # the Mid-360 leaves the factory with the mask 255.255.255.0


def looks(profile: Profile, clock: SystemClock) -> list[tuple[str, Callable[[], Check]]]:
    """Return the name and the action of every check that needs hardware, in order."""
    return [
        ("LiDAR network", lambda: check_lidar_network(profile.lidar)),
        ("LiDAR", lambda: asyncio.run(check_lidar(profile.lidar, clock))),
    ]


def check_lidar_network(settings: LivoxSettings) -> Check:
    """Find the own address towards the LiDAR, in its network, with a free port for its points."""
    name = "LiDAR network"
    host_ip = route_to(settings.lidar_ip) if settings.host_ip == "auto" else settings.host_ip
    network = ipaddress.ip_network(f"{settings.lidar_ip}/{_NETWORK_BITS}", strict=False)
    port = settings.host_ports.points
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((host_ip, port))
        except OSError as error:
            return Check(name, "fail", f"cannot receive on {host_ip}:{port}: {error.strerror}")
    if ipaddress.ip_address(host_ip) not in network:
        return Check(name, "fail", f"the way to {settings.lidar_ip} leaves by {host_ip}, not in {network}")
    return Check(name, "ok", f"{host_ip} reaches {settings.lidar_ip}")


def route_to(ip: str) -> str:
    """Return the own address from which the kernel would send to `ip`; sends nothing.

    Raises:
        OSError: if there is no route.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((ip, 9))
        return str(probe.getsockname()[0])


async def check_lidar(settings: LivoxSettings, clock: SystemClock) -> Check:
    """Start the LiDAR as a flight does and wait until it streams.

    Raises:
        StartError: if it does not; the text says at which stage and what to look at.
    """
    from companion.drivers.livox import LivoxDriver

    driver = LivoxDriver(settings, clock, lambda event: None, lambda datagram: None)
    try:
        await driver.start(LIDAR_TIMEOUT_S)
    finally:
        await driver.stop()
    return Check("LiDAR", "ok", f"{settings.lidar_ip} streams points and IMU")
