"""The help of every command in one form: purpose, what it does, examples, files, exit codes, related commands."""

from typing import NamedTuple

from jaxlines.edge.exit_codes import DONE, FIT_FAILED, INTERRUPTED, STOPPED, TOO_MANY_FAILED, WRONG_CALL


class Page(NamedTuple):
    """The help of a command. `str` gives it in Markdown.

    Fields: purpose: one line; does: what it does, in Markdown; examples: what for -> command line; exits: exit code ->
    when, beside those of every command; see: related commands; files: file -> what is in it; where they are written.
    """

    purpose: str
    does: str
    examples: dict[str, str]
    exits: dict[int, str]
    see: tuple[str, ...]
    files: dict[str, str] = {}
    where: str = "in `--out`"

    def __str__(self) -> str:
        blocks = [self.purpose, self.does, "**EXAMPLES**", _code(self.examples)]
        if self.files:
            blocks += [f"**FILES** {self.where}".strip(), _list(self.files)]
        exits = dict(sorted({**_EXITS, **self.exits}.items()))
        related = ", ".join(f"`jaxlines {name}`" for name in self.see)
        return "\n\n".join([*blocks, "**EXIT STATUS**", _list(exits), f"**SEE ALSO** {related}"])


_EXITS = {
    DONE: "done",
    WRONG_CALL: "a mistake in the call or in a file, or a simulation that failed: one line on stderr says which",
    INTERRUPTED: "interrupted (Ctrl-C)",
}


def _code(examples: dict[str, str]) -> str:
    """Command lines with what each is for above it."""
    lines = [f"# {what}\n$ {command}" for what, command in examples.items()]
    return "\n".join(["```console", *lines, "```"])


def _list(entries: dict) -> str:
    """Entries with their meaning."""
    return "\n".join(f"- `{name}`: {text}" for name, text in entries.items())


ALL = Page(
    "Simulate lumped hydraulic lines and find their physical parameters in recorded pressure.",
    "A study file (TOML, with units) holds circuit, recording, what is free and what is uncertain. `new` writes one "
    "for a recording, `check` says what is odd in it, `fit` finds its numbers, `sweep` says what uncertain ones do.\n\n"
    "Numbers are printed in units that read well and written in SI. Progress goes to stderr. Completion in your shell: "
    "`jaxlines --install-completion`, once.",
    {
        "try the bundled study": "jaxlines fit example:control-line",
        "begin with a recording of your own": "jaxlines new study.toml --from recording.csv",
        "what a command does, what a key of a study means": "jaxlines fit --help; jaxlines keys fit.free",
    },
    {},
    ("new", "check", "fit", "sweep", "keys"),
)

FIT = Page(
    "Fit the free parameters of a study to its recordings.",
    "Moves the numbers of `[[fit.free]]` within their bounds until the simulated channels lie as near to the recorded "
    "ones as the noise allows, by least squares with exact slopes. States estimates with 95 % intervals under the "
    "noise that the residuals show, what cannot be told apart, what the result rests on, and whether the lumped "
    "model is valid.\n\n"
    "`--assess` walks along the likelihood of each parameter and classes it; `--posterior` samples what the parameters "
    "may be together (extra `posterior`). Both cost many more simulations.",
    {
        "the bundled study": "jaxlines fit example:control-line",
        "results and report in a folder": "jaxlines fit study.toml --out results",
        "with classes of identifiability, 500 draws": "jaxlines fit study.toml --out results --assess --posterior 500",
        "a long fit that may be killed": "jaxlines fit study.toml --checkpoint fit.ckpt",
    },
    {DONE: "fitted; `status` says whether it converged", FIT_FAILED: "the fit failed: no search came to an end"},
    ("check", "simulate", "keys fit"),
    {
        "report.html": "everything on one page that needs nothing else",
        "result.json": "estimates, intervals, correlations, noise, validity, warnings; SI",
        "traces.csv": "measured and simulated channels",
        "budget.csv": "what each standard deviation is made of (Type A and B)",
        "identifiability.csv": "with `--assess`: class of each parameter, and why",
        "posterior.csv": "with `--posterior`: the draws",
    },
)

SIMULATE = Page(
    "Simulate the circuit of a study with the numbers of the file.",
    "Runs the circuit once over the times of `[simulate]`, or of the recording without it, with the inputs of the "
    "file. Prints the range of each output and whether the lumped model is valid. Nothing is fitted.",
    {
        "the bundled study": "jaxlines simulate example:control-line",
        "outputs in a folder": "jaxlines simulate study.toml --out run --quiet",
    },
    {},
    ("check", "fit", "sweep"),
    {"result.json": "range of each output, validity, steps; SI", "traces.csv": "the outputs over time"},
)

CHECK = Page(
    "Read a study, simulate it once, and say what is in it and what looks odd; no fit.",
    "Shows circuit, recording, free and known numbers, and how far the start is from the recording. Then looks at "
    "units, guesses marked CHECK, faults of the recording, validity of the lumped model, what the recording can tell "
    "apart, slopes against differences, and how long a fit will take. Writes nothing.",
    {"before a fit": "jaxlines check study.toml"},
    {DONE: "the study can be read and simulated, also when something looks odd"},
    ("new", "fit", "keys"),
)

NEW = Page(
    "Write a commented study for a recording, with every guess marked CHECK.",
    "Reads the columns of a recording, takes channels, units and a circuit from their names and values, and writes a "
    "study that can be checked and fitted. Geometry and data-sheet values are guesses that no recording tells.\n\n"
    "Templates: `compression` (volume against pressure), `dead-end` (line fed by a measured flow), `valve` (line "
    "behind a servovalve), `cylinder` (cylinder drive), `accumulator`, `long-pipe` (waves between two pressures).",
    {
        "from a CSV file": "jaxlines new study.toml --from recording.csv",
        "with another circuit": "jaxlines new study.toml --from recording.mat --template valve",
        "a file without time": 'jaxlines new study.toml --from recording.csv --step "1 ms"',
    },
    {},
    ("check", "keys", "fit"),
    {"STUDY": "the study, never over an existing one without `--force`"},
    where="",
)

SCHEMA = Page(
    "Print the JSON schema of study files, by which editors complete and check keys.",
    "Editors with a TOML language server take it from a first line `#:schema ./study.schema.json` in the study.",
    {"beside the study": "jaxlines schema --out study.schema.json"},
    {},
    ("keys", "check"),
    {"--out FILE": "the schema, instead of on the standard output"},
    where="",
)

KEYS = Page(
    "Print the keys of study files: type, unit, default and range of each.",
    "Without a name, all tables and classes; with one, its own keys.",
    {
        "free parameters": "jaxlines keys fit.free",
        "a component": "jaxlines keys Line",
        "everything": "jaxlines keys",
    },
    {},
    ("schema", "new"),
)

_FAILED = {TOO_MANY_FAILED: "more than `--max-failed` of the lanes failed; the results are written"}
_COLLECTED = {
    "HASH/report.html": "quantiles, probabilities, causes and bands on one page that needs nothing else",
    "HASH/summary.json": "the same as numbers; SI",
    "HASH/table.parquet": "a row a lane: numbers, reductions, status",
    "HASH/bands.parquet": "quantiles over time, of a sweep with `outputs`",
}

SWEEP = Page(
    "Run the circuit of a study for many values of its uncertain numbers.",
    "Samples `[[sweep.uncertain]]`, simulates each sample, and states quantiles, probabilities and causes of what "
    "`[[sweep.reduction]]` asks. Every chunk of lanes is written once and whole: Ctrl-C, a kill or a full disk lose "
    "nothing that was computed, and `--resume` goes on to the same bytes, also with a larger `--count`.\n\n"
    "`jaxlines sweep STUDY` is `jaxlines sweep run STUDY`.",
    {
        "a thousand lanes": "jaxlines sweep study.toml --out sweep --count 1024",
        "go on, with more": "jaxlines sweep study.toml --out sweep --resume --count 100000",
        "one of twenty jobs of a queue": "jaxlines sweep study.toml --out sweep --shard 3/20",
    },
    {
        **_FAILED,
        STOPPED: "stopped before the end (a full disk, workers that die); go on with `--resume`",
        INTERRUPTED: "interrupted (Ctrl-C, SIGTERM); go on with `--resume`",
    },
    ("sweep status", "sweep collect", "keys sweep"),
    {**_COLLECTED, "HASH/...": "plan, chunks and log of the sweep, whose plan has this hash"},
)

SWEEPS = Page(
    "Run, watch and collect sweeps of uncertain numbers.",
    "`jaxlines sweep STUDY --out DIR` runs one (the same as `jaxlines sweep run`, whose `--help` lists the options); "
    "`status` and `collect` look at its folder, also while it runs.",
    {
        "run": "jaxlines sweep study.toml --out sweep",
        "look": "jaxlines sweep status sweep",
        "collect what is there": "jaxlines sweep collect sweep",
    },
    {**_FAILED, STOPPED: "stopped before the end"},
    ("sweep run", "sweep status", "sweep collect"),
)

STATUS = Page(
    "Say how far the sweeps in a folder are, how fast, and what failed.",
    "Reads the folder alone, so that it can be asked from any machine that sees it. Writes nothing.",
    {"while a sweep runs": "jaxlines sweep status sweep"},
    {},
    ("sweep run", "sweep collect"),
)

COLLECT = Page(
    "Make the table, the statistics and the report from the lanes that are there.",
    "A sweep does it at its end. After the shards of a queue, or before a sweep has ended, it is done by this command.",
    {"after the last job of a queue": "jaxlines sweep collect sweep"},
    _FAILED,
    ("sweep run", "sweep status"),
    _COLLECTED,
    where="in DIR",
)

DESIGN = Page(
    "Choose inputs, sensors and instants of the next test so that a parameter becomes best known.",
    "Predicts the standard deviations that a fit of the test will state, and makes them small: by the profile of each "
    "`[[design.excite]]`, within the limits of levels, rates and outputs, and by the choice of sensors and instants. "
    "The design holds for the numbers of the study: their start or the number of the circuit, or what a fit of the "
    "recording finds (`after_fit = true`).",
    {
        "the test of the bundled study": "jaxlines design example:control-line --out next",
        "for one parameter": "jaxlines design study.toml --target fluid.air_fraction",
        "for several, the worst of them": "jaxlines design study.toml --criterion E",
    },
    {},
    ("check", "fit", "simulate", "keys design"),
    {
        "report.html": "what to run, to measure and to expect, on one page that needs nothing else",
        "design.json": "the design, and what it is predicted to tell; SI",
        "profile-INPUT.csv": "a designed input over time",
        "readings.csv": "what the outputs will show, and when each sensor is read",
        "simulate.toml": "the tables of a study that simulate the test",
    },
)
