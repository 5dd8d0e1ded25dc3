"""Time stamps as seconds since the first one."""

import re

import numpy as np

TIME_STAMP = "timestamp"

_CLOCK = re.compile(r"\s*\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?\s*")
FORMATS = (
    "%d.%m.%Y %H:%M:%S.%f",
    "%d.%m.%Y %H:%M:%S,%f",
    "%d.%m.%Y %H:%M:%S",
    "%m/%d/%Y %H:%M:%S.%f",
    "%m/%d/%Y %H:%M:%S",
    "%d/%m/%Y %H:%M:%S.%f",
    "%d/%m/%Y %H:%M:%S",
    "%m/%d/%Y %I:%M:%S.%f %p",
    "%m/%d/%Y %I:%M:%S %p",
    "%Y/%m/%d %H:%M:%S.%f",
    "%Y/%m/%d %H:%M:%S",
)
"""Formats that are tried besides ISO 8601 and clock times; on one day the order of day and month does not matter."""


def _parsed(texts, form: str):
    """Time stamps of a format, or clock times, as seconds; None where the format does not fit."""
    import pandas

    try:
        if form == "clock":
            return pandas.to_timedelta(texts.str.replace(",", ".")).dt.total_seconds().to_numpy(dtype=float)
        stamps = pandas.to_datetime(texts, format="ISO8601" if form == "iso" else form)
    except (ValueError, TypeError):
        return None
    return (stamps - stamps.iloc[0]).dt.total_seconds().to_numpy(dtype=float)


def format_of_stamps(values) -> str | None:
    """The format of time stamps: "" where it need not be said (ISO 8601, clock times, dates), else as in strftime.

    Args: values: cells of a column. Returns: None for cells that are no time stamps in a known format.
    """
    import pandas

    series = pandas.Series(values)
    if series.dtype.kind == "M":
        return ""
    if series.dtype.kind in "iufb" or series.dropna().empty:
        return None
    texts = series.dropna().astype(str).str.strip()
    known = ["clock"] if _CLOCK.fullmatch(texts.iloc[0]) else ["iso", *FORMATS]
    for form in known:
        if _parsed(texts, form) is not None:
            return "" if form in ("iso", "clock") else form
    return None


def seconds_of_stamps(values, form: str, where: str) -> np.ndarray:
    """Seconds since the first time stamp.

    Args: values: cells of a column; form: as in strftime ("%d.%m.%Y %H:%M:%S.%f"), "" to find it; where: for messages.
    Raises: ValueError for cells that are no time stamps of that format.
    """
    import pandas

    series = pandas.Series(values)
    if series.dtype.kind == "M":
        return (series - series.iloc[0]).dt.total_seconds().to_numpy(dtype=float)
    texts = series.astype(str).str.strip()
    found = form or format_of_stamps(texts)
    if found == "":
        found = "clock" if _CLOCK.fullmatch(texts.iloc[0]) else "iso"
    seconds = None if found is None else _parsed(texts, found)
    if seconds is None:
        raise ValueError(
            f"{where}: {texts.iloc[0]!r} is no time stamp in {f'the format {form!r}' if form else 'a known format'}: "
            f'say how it is written, such as "{TIME_STAMP} %d.%m.%Y %H:%M:%S.%f"'
        )
    return seconds - seconds[0]
