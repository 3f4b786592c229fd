"""Base of every module's configuration model."""

from pydantic import BaseModel, ConfigDict


class Settings(BaseModel):
    """Frozen, strict model: unknown keys, wrong types and non-finite numbers are refused.

    Modules declare their own subclass beside their code with units in the field names
    (``voxel_size_m``) and bounds and a description in `pydantic.Field`.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )
