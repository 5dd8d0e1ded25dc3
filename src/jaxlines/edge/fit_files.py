"""Tables that a fit leaves on disk beside its result: uncertainty budgets, classes of identifiability, a posterior."""

import io

import numpy as np

from jaxlines.inference.fit_result import Fit
from jaxlines.inference.identifiability import Identifiability
from jaxlines.inference.posterior import Posterior


def _csv(frame) -> str:
    """A data frame as CSV, nine digits."""
    buffer = io.StringIO()
    frame.to_csv(buffer, index=False, float_format="%.9g", lineterminator="\n")
    return buffer.getvalue()


def budget_table(fit: Fit) -> str:
    """The uncertainty budgets of all parameters as one CSV table, SI; empty when no parameter has an interval.

    A column `parameter` says whose budget a row belongs to; the other columns are those of `Budget.to_frame`.
    """
    import pandas as pd

    frames = [budget.to_frame().assign(parameter=name) for name, budget in fit.budgets().items()]
    if not frames:
        return ""
    every = pd.concat(frames, ignore_index=True)
    return _csv(every[["parameter", *[column for column in every.columns if column != "parameter"]]])


def identifiability_table(classes: dict[str, Identifiability]) -> str:
    """Parameter, class and reason as a CSV table."""
    import pandas as pd

    rows = [{"parameter": name, "class": found.kind, "why": found.sentence} for name, found in classes.items()]
    return _csv(pd.DataFrame(rows))


def posterior_table(fit: Fit, drawn: Posterior) -> str:
    """Draws in SI as a CSV table: chain, draw, parameters, noise factors of the channels, whether it diverged."""
    import pandas as pd

    from jaxlines.inference.fit_tools import values_of

    values = values_of(fit, drawn)
    chains, draws, _ = values.shape
    chain, draw = np.divmod(np.arange(chains * draws), draws)
    columns = {"chain": chain, "draw": draw}
    columns |= {name: values[..., i].ravel() for i, name in enumerate(drawn.labels)}
    columns |= {f"noise factor {c}": drawn.noise_factors[..., c].ravel() for c in range(drawn.noise_factors.shape[-1])}
    return _csv(pd.DataFrame({**columns, "diverged": drawn.divergent.ravel().astype(int)}))


def posterior_summary(fit: Fit, drawn: Posterior) -> dict:
    """What result.json says of a posterior: median, 95 % interval (SI), R-hat, effective draws of each parameter."""
    from jaxlines.inference.fit_tools import values_of

    values = values_of(fit, drawn).reshape(-1, len(drawn.labels))
    low, middle, high = np.quantile(values, [0.025, 0.5, 0.975], axis=0)
    return {
        "parameters": {
            name: {"median": middle[i], "ci95": [low[i], high[i]], "rhat": drawn.rhat[i], "ess": drawn.ess[i]}
            for i, name in enumerate(drawn.labels)
        },
        "draws": int(drawn.divergent.size),
        "divergences": drawn.divergences,
        "warnings": list(drawn.warnings),
    }
