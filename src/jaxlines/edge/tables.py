"""The layout of a study file: its tables and keys, checked by pydantic."""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationError

from jaxlines.edge.building import StudyError, suggest
from jaxlines.edge.design_tables import DesignTable, ExciteTable
from jaxlines.edge.sweep_tables import CasesTable, CorrelationTable, ReductionTable, SweepTable, UncertainTable
from jaxlines.edge.table_base import Number, Table, as_list, flat


class RecordingTable(Table):
    """[recording]: the file or files, their columns, the noise, the window of time, and the conditions of each."""

    file: str = ""
    files: list[str] = Field(default=[], description="several recordings, fitted together, in place of `file`")
    conditions: str = Field(
        default="",
        description="a table with one row a recording: name, perhaps file, and numbers such as `line.length [m]`",
    )
    time: str | list[str]
    channels: Annotated[dict[str, str | list[str]], BeforeValidator(flat)]
    noise: Annotated[dict[str, Number], BeforeValidator(flat)] = {}
    window: Annotated[list[Number], Field(min_length=2, max_length=2)] | None = None


class FreeTable(Table):
    """[[fit.free]]: a parameter to be estimated; the search starts at the number of the file by default."""

    path: Annotated[list[str], BeforeValidator(as_list), Field(min_length=1)]
    bounds: Annotated[list[Number], Field(min_length=2, max_length=2)]
    start: Number | None = None
    transform: Literal["identity", "log", "logit"] = "identity"
    name: str = ""
    ratios: list[float] | None = Field(
        default=None, description="with several paths: the number at each is the value times its ratio"
    )
    local: bool = Field(default=False, description="one value for each recording instead of one for all")
    prior: dict[str, Any] = Field(
        default={},
        description="what is known beforehand: { normal = { mean, sd } }, { log_normal = { median, spread } } or "
        "{ uniform = { low, high } }; low and high beside a normal one truncate it",
    )


class KnownTable(Table):
    """[[fit.known]]: a fixed number with its standard uncertainty."""

    path: str
    sd: Number


class FitTable(Table):
    """[fit]: what is free, what is known, what is derived."""

    free: Annotated[list[FreeTable], Field(min_length=1)]
    known: list[KnownTable] = []
    derived: list[str] = []
    starts: Annotated[int, Field(ge=1)] = 1
    seed: Annotated[int, Field(ge=0)] = 0
    sampling: Literal["sobol", "latin"] = Field(default="sobol", description="how these points are spread")
    windows: Annotated[int, Field(ge=1)] = Field(
        default=1,
        description="in how many parts each recording is cut for the search, so that it stays in step with a ringing "
        "or chaotic recording: each shorter than half a period",
    )
    loss: Literal["gauss", "huber", "student"] = Field(
        default="gauss", description='what residuals cost: "huber" and "student" bear outliers'
    )
    loss_scale: float | None = Field(
        default=None, gt=0, description="where huber bends (standard deviations), degrees of freedom of student"
    )
    check: bool = Field(default=True, description="refuse recordings with grave faults (swapped unit, dead channel)")
    steady: bool = Field(default=False, description="start every recording in the steady state of its first inputs")
    input_noise: Annotated[dict[str, Number], BeforeValidator(flat)] = Field(
        default={},
        description="uncertainty of recorded inputs: standard deviation of samples, or { white, gain, offset }",
    )


class SimulateTable(Table):
    """[simulate]: the times, inputs and outputs of a simulation."""

    stop: Number
    start: Number = "0 s"
    samples: Annotated[int, Field(ge=2)] = 500
    outputs: list[str] = []
    inputs: dict[str, Any] = {}


class NumericsTable(Table):
    """[numerics]: how trajectories are computed."""

    solver: Literal["explicit", "implicit"] = "explicit"
    tolerance: Annotated[float, Field(gt=0, lt=1)] = 1e-7
    max_steps: Annotated[int, Field(ge=1)] = 100_000
    precision: Literal["float64", "float32"] = "float64"


class StudyTable(Table):
    """The whole file. The contents of [fluid] and [circuit] are read from the classes that they describe."""

    title: str = ""
    fluid: dict[str, Any]
    circuit: Annotated[dict[str, dict[str, Any]], Field(min_length=1)]
    initial: Annotated[dict[str, Number], BeforeValidator(flat)] = {}
    recording: RecordingTable | None = None
    fit: FitTable | None = None
    simulate: SimulateTable | None = None
    sweep: SweepTable | None = None
    design: DesignTable | None = None
    numerics: NumericsTable = NumericsTable()


_TABLES = {
    (): StudyTable,
    ("recording",): RecordingTable,
    ("fit",): FitTable,
    ("fit", "free"): FreeTable,
    ("fit", "known"): KnownTable,
    ("simulate",): SimulateTable,
    ("sweep",): SweepTable,
    ("sweep", "uncertain"): UncertainTable,
    ("sweep", "correlation"): CorrelationTable,
    ("sweep", "reduction"): ReductionTable,
    ("sweep", "cases"): CasesTable,
    ("design",): DesignTable,
    ("design", "excite"): ExciteTable,
    ("numerics",): NumericsTable,
}


def _one_line(error: ValidationError) -> str:
    """One of the things that are wrong, with its place; an unknown key is likely to explain the others."""
    errors = error.errors()
    first = next((e for e in errors if e["type"] == "extra_forbidden"), errors[0])
    place = [str(word) for word in first["loc"]]
    if first["type"] in ("extra_forbidden", "missing"):
        *table, key = place
        where = f"{'.'.join(table)}: " if table else ""
        if first["type"] == "missing":
            return f"{where}{key!r} is missing"
        keys = _TABLES[tuple(word for word in table if not word.isdigit())].model_fields
        return f"{where}unknown key {key!r}, {suggest(key, keys)}"
    if first["type"] == "list_type" and tuple(place) in _TABLES:
        return f"{'.'.join(place)}: write [[{'.'.join(place)}]] with two brackets, once for each"
    text = first["msg"][0].lower() + first["msg"][1:].replace("dictionary", "table")
    return f"{'.'.join(place)}: {text}, got {first['input']!r}"


def check_layout(content: dict) -> StudyTable:
    """The tables of a study. Raises StudyError, in one line, for an unknown or missing key or a wrong type."""
    try:
        return StudyTable.model_validate(content)
    except ValidationError as error:
        raise StudyError(_one_line(error)) from error
