"""What the layouts of all tables of a study file share."""

from pydantic import BaseModel, ConfigDict

Number = str | int | float


def flat(value):
    """Tables in tables as one with dotted names, so that `A.pressure = ...` may stand without quotes."""
    if not isinstance(value, dict):
        return value
    found = {}
    for key, inner in value.items():
        if isinstance(inner, dict):
            found |= {f"{key}.{rest}": item for rest, item in flat(inner).items()}
        else:
            found[key] = inner
    return found


def as_list(value):
    """One text as a list of one."""
    return [value] if isinstance(value, str) else value


class Table(BaseModel):
    """A table of the file; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
