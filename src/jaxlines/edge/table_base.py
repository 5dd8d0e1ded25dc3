"""What the layouts of all tables of a study file share."""

from pydantic import BaseModel, ConfigDict

Number = str | int | float


def flat(value):
    """Tables in tables as one with dotted names, so that `A.pressure = ...` may stand without quotes."""
    if not isinstance(value, dict):
        return value
    flat = {}
    for key, inner in value.items():
        if isinstance(inner, dict):
            flat |= {f"{key}.{rest}": item for rest, item in flat(inner).items()}
        else:
            flat[key] = inner
    return flat


def as_list(value):
    """One text as a list of one."""
    return [value] if isinstance(value, str) else value


class Table(BaseModel):
    """A table of the file; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
