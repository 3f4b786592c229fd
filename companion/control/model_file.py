"""Where the model of a follower is, and which one it is; nothing here runs it."""

import hashlib
from pathlib import Path

from companion.control.followers.settings import SHIPPED_MODEL, FollowerSettings
from companion.errors import ModelError

MODELS = Path(__file__).parents[1] / "models"
"""Where the models are that come with the companion."""

_SHIPPED_NAME = "follower.onnx"
_MAX_BYTES = 64_000_000


def model_path(settings: FollowerSettings) -> Path:
    """Return the file of the configured model."""
    return MODELS / _SHIPPED_NAME if settings.model == SHIPPED_MODEL else Path(settings.model)


def read_model(path: Path) -> tuple[bytes, str]:
    """Return a model's bytes and their SHA-256.

    Raises:
        ModelError: if there is none, or if it cannot be one.
    """
    if not path.is_file():
        raise ModelError(f"{path}: no such model")
    try:
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}") from None
    if len(data) > _MAX_BYTES:
        raise ModelError(f"{path}: larger than {_MAX_BYTES} bytes, which no follower's model is")
    return data, hashlib.sha256(data).hexdigest()


def pinned(settings: FollowerSettings) -> FollowerSettings:
    """Return settings that fly no other model than the one that is there now.

    So what a flight records of its configuration says which model flew, and a replay takes no other. Where no
    model can be read everything stays as it is: whoever loads it will say why.
    """
    if settings.controller != "policy" or settings.model_sha256 is not None:
        return settings
    try:
        _, sha256 = read_model(model_path(settings))
    except ModelError:
        return settings
    return settings.model_copy(update={"model_sha256": sha256})
