"""The noise of a channel: known or estimated, the same everywhere or growing with the reading."""

import dataclasses

import numpy as np

from jaxlines.inference.loss import Loss


@dataclasses.dataclass(frozen=True)
class Noise:
    """Standard deviation of a channel's noise: sigma^2 = absolute^2 + (relative * reading)^2.

    Args: absolute, in the channel's unit; relative [-]; None: estimated. The reading is the simulated one, so that an
        outlier does not excuse itself.
    Raises: ValueError for a level that is negative, or both zero.
    Typical values: relative 0.001..0.02; absolute 0.1..0.5 % of the full scale of a pressure transducer.
    """

    absolute: float | None = None
    relative: float | None = 0.0

    def __post_init__(self):
        for name in ("absolute", "relative"):
            level = getattr(self, name)
            if level is not None and not (np.isfinite(level) and level >= 0.0):
                raise ValueError(f"{name} noise must be positive, or None to have it estimated, got {level:g}")
        if self.absolute == 0.0 and self.relative == 0.0:
            raise ValueError("absolute and relative noise are both 0: no noise at all cannot be weighed")

    @property
    def estimated(self) -> bool:
        """Whether anything of it is estimated."""
        return self.absolute is None or self.relative is None

    @property
    def uniform(self) -> bool:
        """Whether it is one number for all samples."""
        return self.relative == 0.0

    def level(self, simulated) -> np.ndarray:
        """Standard deviation at simulated readings, same shape; both parts must be known."""
        assert self.absolute is not None and self.relative is not None
        return np.hypot(self.absolute, self.relative * np.asarray(simulated))


def as_noise(given, channel: str) -> Noise:
    """A noise from a number, a noise, or None (estimated). Raises ValueError that names the channel."""
    if given is None:
        return Noise()
    if isinstance(given, Noise):
        return given
    if not (np.isfinite(given) and given > 0):
        raise ValueError(f"noise of {channel} must be positive, got {given:g}")
    return Noise(absolute=float(given))


def estimate_noise(noise: Noise, residuals, simulated, freedom: float, loss: Loss, floor: float) -> Noise:
    """The noise with what is not known of it estimated from the residuals of a channel by maximum likelihood.

    Minimises sum chi(e/sigma)/(c f) + ln sigma over the unknown parts, where f is the share of the samples that the
    parameters leave as degrees of freedom (n/(n - p) in the textbook formula), chi = e^2/(2 sigma^2) for normal noise
    (see `Loss.scale_cost`) and c the `Loss.consistency`. The term ln sigma is what keeps a relative noise from growing
    without limit. The model's parameters are held while this is done and the weights are held while they are searched;
    the two steps in turn end where both agree (generalised least squares), which has no bias from weights that depend
    on the model.

    Args: residuals, simulated: used samples, SI, shape (samples,); freedom: f; floor: smallest level.
    Reference: Carroll and Ruppert, "Transformation and Weighting in Regression", 1988, ch. 2 and 3.
    """
    if not noise.estimated or residuals.size == 0:
        return noise
    if noise.uniform and loss.kind == "gauss":
        level = np.sqrt((residuals**2).sum() / (residuals.size * freedom))
        return Noise(max(float(level), floor), 0.0)
    from scipy.optimize import minimize

    size = max(float(np.median(np.abs(residuals)) / 0.6745), floor)
    reading = max(float(np.sqrt(np.mean(simulated**2))), 1e-300)
    unknown = [name for name in ("absolute", "relative") if getattr(noise, name) is None]
    start = {"absolute": np.log(size), "relative": np.log(size / reading)}
    lowest = {"absolute": np.log(floor), "relative": np.log(floor / reading)}

    def filled(logs) -> Noise:
        return dataclasses.replace(noise, **dict(zip(unknown, np.exp(logs).tolist(), strict=True)))

    def cost(logs) -> float:
        sigma = np.maximum(filled(logs).level(simulated), floor)
        return float(
            np.mean(loss.scale_cost(residuals / sigma)) / (loss.consistency * freedom) + np.mean(np.log(sigma))
        )

    best = None
    for share in (0.0, -2.0) if len(unknown) == 2 else (0.0,):  # the second start has little absolute noise
        first = np.array([start[name] + (share if name == "absolute" else 0.0) for name in unknown])
        bounds = [(lowest[name], start[name] + 10.0) for name in unknown]
        options = {"xatol": 1e-8, "fatol": 1e-14, "maxiter": 2000}
        found = minimize(
            cost, np.clip(first, *np.transpose(bounds)), method="Nelder-Mead", bounds=bounds, options=options
        )
        best = found if best is None or found.fun < best.fun else best
    assert best is not None
    return filled(best.x)
