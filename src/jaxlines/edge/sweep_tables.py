"""The layout of the table [sweep] of a study file, checked by pydantic."""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from jaxlines.edge.table_base import Number, Table, as_list, flat


class UncertainTable(Table):
    """[[sweep.uncertain]]: path(s) of a number and one distribution; `within` truncates it."""

    path: Annotated[list[str], BeforeValidator(as_list), Field(min_length=1)]
    name: str = ""
    normal: dict[str, Any] | None = None
    log_normal: dict[str, Any] | None = None
    uniform: dict[str, Any] | None = None
    log_uniform: dict[str, Any] | None = None
    triangular: dict[str, Any] | None = None
    discrete: dict[str, Any] | None = None
    within: Annotated[list[Number], Field(min_length=2, max_length=2)] | None = None
    levels: Annotated[int, Field(ge=1)] | None = None


class CorrelationTable(Table):
    """[[sweep.correlation]]: correlation of the normal scores of two uncertain numbers."""

    between: Annotated[list[str], Field(min_length=2, max_length=2)]
    value: Annotated[float, Field(gt=-1, lt=1)]


class ReductionTable(Table):
    """[[sweep.reduction]]: one number from an output over time; `above`: thresholds whose exceedance is asked for."""

    type: str
    output: str
    name: str = ""
    above: list[Number] = []
    options: dict[str, Any] = {}


class CasesTable(Table):
    """[sweep.cases]: a file with one case a row; path of a number -> column "name [unit]"."""

    file: str
    columns: Annotated[dict[str, str], BeforeValidator(flat), Field(min_length=1)]


class SweepTable(Table):
    """[sweep]."""

    count: Annotated[int, Field(ge=1)] | None = None
    sampler: Literal["sobol", "monte_carlo", "latin_hypercube", "grid", "sobol_indices", "morris", "shapley"] = "sobol"
    seed: Annotated[int, Field(ge=0)] = 0
    second_order: bool = False
    outputs: list[str] = []
    derivatives: bool = False
    kept_series: Annotated[int, Field(ge=0)] = 20
    quantiles: list[Annotated[float, Field(gt=0, lt=1)]] = [0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99]
    engine: str = "auto"
    tolerance: Annotated[float, Field(gt=0, lt=1)] = 1e-4
    precision: Literal["float64", "float32"] = "float64"
    uncertain: list[UncertainTable] = []
    correlation: list[CorrelationTable] = []
    cases: CasesTable | None = None
    reduction: list[ReductionTable] = []
