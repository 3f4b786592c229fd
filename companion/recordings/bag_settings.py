"""What cannot always be told from a ROS bag alone."""

from typing import Literal

from pydantic import Field

from companion.settings import Settings


class BagSettings(Settings):
    """How to read a ROS bag."""

    points_topic: str = Field(default="", max_length=256)
    """Topic with the points; empty: the only one with CustomMsg, otherwise the only one with PointCloud2."""
    imu_topic: str = Field(default="", max_length=256)
    """Topic with the inertial samples; empty: the only one, or the only one beside the points' topic."""
    acceleration_unit: Literal["auto", "g", "m/s^2"] = "auto"
    """Unit of the accelerations; `auto` judges by their size at the start, where the sensor rests."""
