"""Configuration of the link."""

import pytest
from pydantic import ValidationError

from companion.drivers.px4_settings import Px4Settings


@pytest.mark.parametrize(
    "url", ["udpin://0.0.0.0:14540", "udpout://192.168.1.10:14550", "serial:///dev/ttyTHS1:921600"]
)
def test_a_link_is_accepted(url: str) -> None:
    assert Px4Settings(url=url).url == url


@pytest.mark.parametrize("url", ["", "udp:14540", "serial:///dev/ttyTHS1", "http://x:1", "raw://"])
def test_what_is_no_link_is_refused(url: str) -> None:
    with pytest.raises(ValidationError, match="is not a link like"):
        Px4Settings(url=url)


def test_ground_stations_come_from_a_list() -> None:
    settings = Px4Settings.model_validate({"ground_stations": [{"system_id": 254, "component_id": 1}]})
    assert settings.ground_stations[0].system_id == 254
    with pytest.raises(ValidationError):
        Px4Settings.model_validate({"ground_stations": [{"system": 254}]})
