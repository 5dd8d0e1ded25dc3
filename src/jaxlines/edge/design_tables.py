"""The layout of the table [design] of a study file, checked by pydantic."""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from jaxlines.edge.table_base import Number, Table, as_list, flat


class ExciteTable(Table):
    """[[design.excite]]: an input to be chosen, its limits, and what it starts with."""

    input: str = Field(description="name of the input")
    kind: Literal["knots", "multisine", "scaled"] = Field(
        default="knots",
        description="straight lines between knots, a sum of sines, or a given profile times a factor",
    )
    low: Number = Field(description="lowest level")
    high: Number = Field(description="highest level")
    knots: Annotated[int, Field(ge=2)] | list[Number] | None = Field(
        default=None, description="of knots: how many over the test, or their times"
    )
    start: list[Number] | None = Field(
        default=None, description="values at the knots, or amplitudes, to begin with; the study's own input by default"
    )
    rate: Number | None = Field(default=None, description="steepest slope, in the input's unit per second")
    first: Number | None = Field(default=None, description="fixed value at the first knot")
    last: Number | None = Field(default=None, description="fixed value at the last knot")
    energy: Number | None = Field(
        default=None,
        description='largest integral of the square over time, such as "20 (L/min)^2*s", or "start": that of the start',
    )
    frequencies: list[Number] = Field(default=[], description="of multisine")
    mean: Number | None = Field(default=None, description="of multisine: middle of the level")
    factor: Annotated[list[float], Field(min_length=2, max_length=2)] = Field(
        default=[0.0, 10.0], description="of scaled: smallest and largest factor"
    )


class DesignTable(Table):
    """[design]: the test to be designed."""

    target: Annotated[list[str], BeforeValidator(as_list)] = Field(
        default=[], description="parameter or parameters that the test is for, all by default; --target overrides it"
    )
    criterion: Literal["D", "A", "E", "c"] | None = Field(
        default=None,
        description='what is made small: "c" the standard deviation of one parameter (default); of several "D" the '
        'geometric mean (default), "A" the root mean square, "E" that of the worst combination',
    )
    stop: Number | None = Field(default=None, description="length of the test; that of the recording by default")
    samples: Annotated[int, Field(ge=2)] | None = Field(default=None, description="instants at which can be measured")
    sensors: list[str] = Field(default=[], description="outputs that can be measured; those recorded by default")
    noise: Annotated[dict[str, Number], BeforeValidator(flat)] = Field(
        default={}, description="standard deviation of each; that of [recording.noise] by default"
    )
    limits: Annotated[dict[str, list[Any]], BeforeValidator(flat)] = Field(
        default={}, description='what outputs must keep to: ["1.1 bar_a", "200 bar_a"]; "none" for no limit'
    )
    num_sensors: Annotated[int, Field(ge=1)] | None = Field(default=None, description="how many of the sensors to use")
    num_samples: Annotated[int, Field(ge=1)] | None = Field(default=None, description="how many of the instants to use")
    evenly: bool = Field(default=False, description="instants with a start and an interval instead of freely chosen")
    robust: Literal["nominal", "average", "worst"] = Field(
        default="nominal", description="for the numbers of the file, or average or worst of samples of the priors"
    )
    scenarios: Annotated[int, Field(ge=1)] = Field(default=4, description="how many such samples")
    after_fit: bool = Field(default=False, description="fit the recording first, and add the new test to what it tells")
    starts: Annotated[int, Field(ge=1)] = Field(default=3, description="searches from different profiles")
    max_iterations: Annotated[int, Field(ge=1)] = Field(default=60, description="of each search")
    seed: Annotated[int, Field(ge=0)] = Field(default=0, description="of random starts and samples")
    excite: list[ExciteTable] = Field(default=[], description="inputs to be chosen, one table each")
