"""What all tests share."""

import signal
from collections.abc import Iterator

import hypothesis
import pytest
import structlog

from companion.kernel_cache import forget_stale

# These use the sensor's and the autopilot's fixed ports, or measure real time, so two of them must not run
# at once.
_ONE_AT_A_TIME = frozenset(
    {
        "test_companion_process",
        "test_external_odometry_link",
        "test_livox_driver",
        "test_livox_sdk",
        "test_mavlink_sockets",
        "test_odometry_peer",
        "test_preflight_emulated",
        "test_px4_flight",
        "test_px4_link",
        "test_wire",
    }
)


# Timing never decides a test.
hypothesis.settings.register_profile("companion", deadline=None)
hypothesis.settings.load_profile("companion")


def pytest_configure(config: pytest.Config) -> None:
    """Heed Ctrl-C; before anything loads kernels, forget those whose sources have changed."""
    # A shell that starts the tests in the background makes them, and what they start, deaf to Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if not hasattr(config, "workerinput"):
        forget_stale(("sitl",))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests on real sockets, so that the others can share the processor's cores."""
    for item in items:
        if item.path.stem in _ONE_AT_A_TIME:
            item.add_marker(pytest.mark.sockets)


@pytest.fixture(autouse=True)
def journal() -> Iterator[None]:
    """Undo what a command under test made of the journal: it writes to a stream that ends with the test."""
    yield
    structlog.reset_defaults()
