"""The performance page of the documentation: made from results.json of the experiments, kept in docs/results."""

import json
from pathlib import Path

RESULTS = Path(__file__).parent / "results"
INTRODUCTION = """# Performance

Made from the `results.json` of the scripts in `experiments/`, which anyone can run again: ratios are against a named
competitor in the same run, at an error no smaller than ours. Times depend on the machine; ratios less so.
"""


def performance_page() -> str:
    """Ensembles, fits, sweeps, first result: each as far as its results are there."""
    parts = [INTRODUCTION]
    for name, section in SECTIONS.items():
        path = RESULTS / f"{name}.json"
        if path.is_file():
            result = json.loads(path.read_text(encoding="utf-8"))
            parts.append("\n".join([*section(result), "", *_source(name, result)]))
    return "\n\n".join(parts) + "\n"


def _source(name: str, result: dict) -> list[str]:
    """The command, and what it ran on."""
    machine = result.get("machine") or {}
    cores = machine.get("cores", machine.get("cpu_count", result.get("cores")))
    words = [machine.get("cpu") or machine.get("processor"), f"{cores} cores" if cores else ""]
    words += [f"JAX {machine['jax']}" if "jax" in machine else ""]
    on = ", ".join(word for word in words if word)
    return [f"`python experiments/{name}.py --out out/{name}`" + (f" on {on}." if on else ".")]


def _table(head: list[str], rows: list[list[str]]) -> list[str]:
    return [f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *rows)]


def _number(value, form: str = "{:,.0f}") -> str:
    return "not measured" if value is None else form.format(value)


def _ensembles(result: dict) -> list[str]:
    columns = {"sims_per_second": "{:,.0f}", "rms_error_pa": "{:.3g}", "compile_seconds": "{:.2g}"}
    rows = [
        [row["engine"], row["precision"], row["setting"], *(_number(row[name], form) for name, form in columns.items())]
        for row in result["rows"]
    ]
    head = ["engine", "precision", "setting", "simulations/s", "rms error [Pa]", "compiled in [s]"]
    lines = ["## Ensembles", "", f"A servo axis, {result['lanes']:,} lanes.", "", *_table(head, rows), ""]
    claims = [
        [c["name"], _number(c["value"], "{:.3g}"), f"{c['claimed']:g}", f"{c['aim']:g}", "yes" if c["met"] else "no"]
        for c in result["claims"]
    ]
    lines += _table(["what", "measured", "claimed", "aimed at", "holds"], claims)
    return lines + _why_not_faster(result) + _where_time_goes(result)


def _why_not_faster(result: dict) -> list[str]:
    """What was aimed at and not reached, each beside the bound of the same run."""
    rate = {(row["engine"], row["precision"], row["setting"]): row["sims_per_second"] for row in result["rows"]}
    bound = {kind: rate.get(("SIMD C, best", kind, "3 steps a sample")) for kind in ("float64", "float32")}
    lines = []
    for claim in result["claims"]:
        if claim["reached"] or claim["value"] is None:
            continue
        kind, mine = claim["name"].split()[0], None
        if kind in bound and " over " in claim["name"] and "SIMD" not in claim["name"]:
            mine = rate.get(("jaxlines explicit", kind, "3 steps a sample"))
        if mine and bound[kind]:
            wanted = mine / claim["value"] * claim["aim"]
            lines.append(
                f"- {claim['name']}: {claim['aim']:g} times that peer would be {wanted:,.0f} simulations a second, "
                f"{wanted / bound[kind]:.0%} of what C with the same scheme and SIMD over lanes does on this machine "
                f"({bound[kind]:,.0f})."
            )
        else:
            lines.append(f"- {claim['name']}: {claim['value']:.2g} instead of {claim['aim']:g}.")
    return ["", "### What was aimed at and missed", "", *lines] if lines else []


def _where_time_goes(result: dict) -> list[str]:
    """Parts of a run timed on their own, and what derivatives add."""
    profile = result.get("profile")
    if not profile:
        return []
    bounds = {row["precision"]: result["lanes"] / row["sims_per_second"] for row in _bounds(result)}
    forward, derivatives, shares = [], [], []
    for kind, parts in profile.items():
        part, bound = parts["forward"], bounds.get(kind)
        times = [part["rates"], part["steps"] - part["rates"], part["program"] - part["steps"]]
        times += [part["run"] - part["program"], part["run"], part["whatever the lanes"]]
        forward.append([kind, *(_number(None if t is None else 1e3 * t, "{:.1f}") for t in (*times, bound))])
        if bound is not None:
            shares.append(
                f"- {kind}: the rates alone take {part['rates'] / part['run']:.0%} of a run, Python and copies "
                f"{(part['run'] - part['program']) / part['run']:.0%}; C takes {bound / part['run']:.0%} of it for all."
            )
        part = parts["derivatives"]
        half = [part["forwards, every step stored"], part["backwards"], part["gradient"], part["jacobian"]]
        sizes = ("256", "512", "1024")
        half += [part[f"{name}, {size} lanes at once"] for name in ("gradient", "jacobian") for size in sizes]
        derivatives.append([kind, *(f"{t / part['run']:.2f}" for t in half)])
    first = (
        f"{result['lanes']:,} lanes of the servo axis at 3 steps a sample on all cores, each part timed on its own [ms]"
    )
    head = ["", "rates", "steps around them", "outputs, status", "Python, copies", "run", "of it, whatever the lanes"]
    lines = ["", "### Where the time goes", "", f"{first}, so that differences of some per cent are noise:", ""]
    lines += [*_table([*head, "C with SIMD, plain, the same steps"], forward), "", *shares, ""]
    lines += ["Derivatives, times a run; in the last columns with so many lanes at once instead of what is chosen:", ""]
    head = ["", "forwards, storing", "backwards", "gradient", "Jacobian", "gradient 256", "512", "1024"]
    return [*lines, *_table([*head, "Jacobian 256", "512", "1024"], derivatives)]


def _bounds(result: dict) -> list[dict]:
    """The rows of plain C with as many steps as ours."""
    return [row for row in result["rows"] if row["setting"] == "3 steps a sample" and row["engine"] == "SIMD C, plain"]


def _fits(result: dict) -> list[str]:
    mine = result["jaxlines"]
    lines = [
        "## Fits",
        "",
        f"{result['count']:,} recordings of a servo axis, each fitted on its own: {mine['many']['warm_s']:.2f} s warm, "
        f"{mine['many']['cold_s']:.1f} s with compilation; one recording {mine['one']['warm_s']:.3f} s.",
        "",
    ]
    claims, aims = result["claims"], result["aims"]
    rows = [
        [
            name.replace("_", " "),
            *(f"{number:.3g}" for number in (ratio, claims[name], aims[name])),
            "yes" if ratio >= claims[name] else "no",
        ]
        for name, ratio in result["ratios"].items()
    ]
    return lines + _table(["times faster", "measured", "claimed", "aimed at", "holds"], rows)


def _sweeps(result: dict) -> list[str]:
    return ["## Sweeps", "", f"{result['finding'].split('; all claims')[0]}."]


def _first(result: dict) -> list[str]:
    return ["## The first result", "", f"{result['finding']}."]


SECTIONS = {"speed_ensemble": _ensembles, "speed_fit": _fits, "sweep_scale": _sweeps, "first_result": _first}
