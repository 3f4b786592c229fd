"""Tuned gains as a profile: a vehicle's own profile extends it, and a campaign's method can name it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from companion.config import load_profile
from companion.control.followers.settings import CommandSettings, FollowerSettings

BASE = "uav_follower.yaml"


def stored_text(follower: FollowerSettings, method: str, remarks: Sequence[str]) -> str:
    """Return a profile that says nothing but a law, all its gains, and limits of its command if unusual.

    Args:
        follower: the settings.
        method: the law.
        remarks: what is to be known about the gains, one line each.
    """
    section: dict[str, Any] = {"method": method}
    if follower.command != CommandSettings():
        section["command"] = follower.command.model_dump()
    section[method] = getattr(follower, method).model_dump()
    head = ["# yaml-language-server: $schema=./profile.schema.json", *(f"# {line}" for line in remarks)]
    body = yaml.safe_dump({"extends": BASE, "follower": section}, sort_keys=False, width=100)
    return "\n".join(head) + "\n" + body


def store(path: Path, text: str) -> None:
    """Write such a profile, after making sure that it loads.

    Raises:
        ProfileError: if it would not, which is if the profile that it extends does not lie beside it.
    """
    unfinished = path.with_name(f".{path.name}.new")
    unfinished.write_text(text, encoding="utf-8")
    try:
        load_profile(unfinished)
    except BaseException:
        unfinished.unlink()
        raise
    unfinished.replace(path)
