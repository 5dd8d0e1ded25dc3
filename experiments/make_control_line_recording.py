"""Generate the bundled example recording: one oil-filled control line, pumped up and let down.

It stands in for a bench test of one dead-ended 2-inch control line of the servo hydraulics of the
DSN 70-metre antennas.  The recording is computed, not measured, and on purpose not with the
one-lump model that it is meant to identify: the line is *distributed*, by the method of
characteristics with a discrete gas cavity at every node (DGCM, after Wylie 1984: polytropic gas,
vapour pressure zero), laminar steady friction and wall elasticity in the wave speed.  Servo-valve
flow enters at one end, a laminar leak drains the other.  Unlike in one lump, pressure differs
along the line, waves run and reflect, oil has inertia and friction, and the gauge sees one end.

Held still, the line stores what a mixture of ``exp(-(p - p_atm)/K) + R (p_atm/p)^(1/n)`` (volume
per liquid volume at ``p_atm``, ``R = alpha/(1 - alpha)``) stores in a wall of modulus ``K_c``:

* the reaches carry ``1/K + 1/K_c``, for a liquid of constant tangent modulus the exact storage per
  volume at any pressure, not a linearisation;
* a node of volume ``V`` holds a cavity ``V ln(1 + phi)`` with ``phi(p)`` the gas per liquid.  The
  usual cavity ``V phi`` keeps the gas of a node fixed although the mixture that is pumped in brings
  gas along; the logarithm accounts for it, and its slope is exactly ``1/K_mix - 1/K``.

Left out: change of the bore during the test (pressure / K_c, +-0.02 %), change of density in the
inertia, convective terms (flow / wave speed, 1e-4), unsteady friction, solution of the air.
"""

import argparse
import json
import math
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

BAR = 1e5  # Pa
L_PER_MIN = 1e-3 / 60  # m3/s
P_ATM = 101_325.0  # Pa absolute: ambience, tank, and reference of mixture and bore
P_BORE = 6e6  # Pa absolute: pressure at which the bore is taken, half way up the test

SEED = 42109
RATE, DURATION = 50.0, 30.0  # samples per second, s
PULSES = (  # valve flow: L/min, start s, stop s, ramp s
    (3.9, 1.0, 11.5, 4.5),
    (-3.2, 14.5, 19.0, 1.0),
    (2.6, 20.5, 23.5, 1.0),
    (-3.0, 25.5, 28.0, 1.0),
)
SENSORS = {
    "pressure_full_scale_bar": 400.0,
    "pressure_noise_sd_bar": 0.4,  # 0.1 % of full scale
    "pressure_step_bar": 400.0 / 2**14,
    "flow_full_scale_L_per_min": 10.0,  # either way
    "flow_noise_sd_L_per_min": 0.002,  # 0.02 % of full scale
    "flow_step_L_per_min": 20.0 / 2**14,
}


@dataclass(frozen=True)
class Truth:
    """What an identification should find (first four) and what it is told (the rest), SI units."""

    liquid_modulus_Pa: float = 1.379e9  # tangent modulus, the same at every pressure
    air_fraction: float = 0.007  # of the mixture volume at P_ATM
    leak_m3_per_s_Pa: float = 1.0e-12  # far end to tank
    initial_pressure_Pa_abs: float = 3.0e5
    polytropic_exponent: float = 1.2
    length_m: float = 20.83
    inner_diameter_m: float = 0.04285
    outer_diameter_m: float = 0.06032
    wall_young_Pa: float = 206.84e9
    wall_poisson: float = 0.25
    density_kg_per_m3: float = 850.0  # of the liquid at P_ATM
    kinematic_viscosity_m2_per_s: float = 27.7e-6

    @property
    def area(self):
        return math.pi / 4 * self.inner_diameter_m**2

    @property
    def wall_modulus(self):
        """Container modulus of a thick pipe without axial stress: E / (2 (h + nu)), Pa."""
        inner, outer = self.inner_diameter_m**2, self.outer_diameter_m**2
        return self.wall_young_Pa / 2 / ((outer + inner) / (outer - inner) + self.wall_poisson)

    def gas_per_liquid(self, p):
        """Gas volume over liquid volume, both at absolute pressure ``p``."""
        ratio = self.air_fraction / (1 - self.air_fraction)
        gas = ratio * (P_ATM / p) ** (1 / self.polytropic_exponent)
        return gas * np.exp((p - P_ATM) / self.liquid_modulus_Pa)

    def mixture_density(self, p):
        """Liquid mass per mixture volume, kg/m3 (the mass of the gas is left out)."""
        liquid = self.density_kg_per_m3 * np.exp((p - P_ATM) / self.liquid_modulus_Pa)
        return liquid / (1 + self.gas_per_liquid(p))

    def leak_conductance(self, p):
        """Conductance of the leak by volume at line pressure ``p``, m3/(s Pa).

        In a laminar gap the mass flow is the conductance times the integral of the density over the
        pressures along it, to second order the density at their mean.
        """
        return self.leak_m3_per_s_Pa * self.mixture_density((p + P_ATM) / 2) / self.mixture_density(p)

    def effective_modulus(self, p):
        """Modulus of liquid, gas and wall together, Pa."""
        share = 1 - 1 / (1 + self.gas_per_liquid(p))
        liquid_and_gas = (1 - share) / self.liquid_modulus_Pa + share / self.polytropic_exponent / p
        return 1 / (liquid_and_gas + 1 / self.wall_modulus)


def valve_flow(t):
    """Flow through the servo valve into the line, m3/s at line pressure: raised-cosine pulses."""

    def rise(x):
        return 0.5 - 0.5 * np.cos(np.pi * np.clip(x, 0.0, 1.0))

    t = np.asarray(t, dtype=float)
    pulses = (q * rise((t - a) / ramp) * rise((b - t) / ramp) for q, a, b, ramp in PULSES)
    return L_PER_MIN * sum(pulses)


def simulate(truth, flow, p_init, duration, leaking=True, reaches=16, psi=0.55):
    """March the characteristics; return times, node pressures (time, node) and node lengths."""
    dx = truth.length_m / reaches
    rho, k_wall = truth.density_kg_per_m3, truth.wall_modulus
    speed = math.sqrt(1 / (1 / truth.liquid_modulus_Pa + 1 / k_wall) / rho)
    dt = dx / speed
    times = dt * np.arange(math.ceil(duration / dt) + 1)
    q_in = flow(times)
    bore = truth.area * math.exp((P_BORE - P_ATM) / k_wall)
    drop = 8 * math.pi * rho * truth.kinematic_viscosity_m2_per_s * dx / bore**2
    z_old, z_new = rho * speed / bore - drop / 2, rho * speed / bore + drop / 2
    lengths = np.full(reaches + 1, dx)
    lengths[[0, -1]] = dx / 2
    volume = bore * lengths
    slope = np.full(reaches + 1, 2 / z_new)  # net inflow of a node = supply - slope * p
    slope[0] = 1 / z_new

    p = np.full(reaches + 1, float(p_init))
    q_up, q_down = np.zeros(reaches + 1), np.zeros(reaches + 1)  # flow on either side of a node
    pressures = np.empty((times.size, reaches + 1))
    pressures[0] = p
    for k in range(1, times.size):
        leak = truth.leak_conductance(p[-1]) if leaking else 0.0  # changes slowly: taken one step late
        slope[-1] = 1 / z_new + leak
        plus = p[:-1] + z_old * q_down[:-1]  # C+ arriving at nodes 1 to N
        minus = p[1:] - z_old * q_up[1:]  # C- arriving at nodes 0 to N-1
        supply = np.zeros(reaches + 1)
        supply[1:] += plus / z_new
        supply[:-1] += minus / z_new
        supply[0] += q_in[k]
        supply[-1] += leak * P_ATM
        cavity = volume * np.log1p(truth.gas_per_liquid(p)) - (1 - psi) * dt * (q_up - q_down)
        p = solve_cavities(truth, p, cavity, volume, psi * dt, supply, slope)
        q_up[0], q_up[1:] = q_in[k], (plus - p[1:]) / z_new
        q_down[-1], q_down[:-1] = leak * (p[-1] - P_ATM), (p[:-1] - minus) / z_new
        pressures[k] = p
    return times, pressures, lengths


def solve_cavities(truth, p, cavity, volume, step, supply, slope):
    """Newton at every node: volume ln(1 + phi(p)) = cavity - step * (supply - slope * p)."""
    for _ in range(30):
        phi = truth.gas_per_liquid(p)
        residual = volume * np.log1p(phi) - cavity + step * (supply - slope * p)
        growth = 1 / truth.liquid_modulus_Pa - 1 / (truth.polytropic_exponent * p)
        new = p - residual / (volume * phi / (1 + phi) * growth - step * slope)
        new = np.maximum(new, 0.2 * p)
        change = np.max(np.abs(new / p - 1))
        p = new
        if change < 1e-11:
            return p
    raise RuntimeError("the gas cavities did not converge")


def mass_balance_error(truth, times, pressures, lengths):
    """Largest gap between mass stored and mass fed in, relative to the largest mass stored."""
    bore = truth.area * np.exp((pressures - P_ATM) / truth.wall_modulus)
    stored = np.sum(truth.mixture_density(pressures) * bore * lengths, axis=1)
    end = pressures[:, -1]
    rate = truth.mixture_density(pressures[:, 0]) * valve_flow(times)
    rate = rate - truth.mixture_density(end) * truth.leak_conductance(end) * (end - P_ATM)
    fed = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(times))])
    gained = stored - stored[0]
    return float(np.max(np.abs(gained - fed)) / np.max(gained))


def wave_speed_error(truth, p_base):
    """Ring the closed line at ``p_base``; its lowest mode against c / 2L with c = sqrt(K/rho)."""
    c = math.sqrt(truth.effective_modulus(p_base) / truth.density_kg_per_m3)
    period = 2 * truth.length_m / c

    def kick(t):
        """One period of flow in and out again, so that the mean pressure returns."""
        return 1e-6 * np.where(t < period, np.sin(2 * np.pi * t / period), 0.0)

    times, pressures, _ = simulate(truth, kick, p_base, 12 * period, leaking=False)
    late = times > 2 * period
    times, tone = times[late], (pressures[:, 0] - pressures[:, -1])[late]
    up = np.flatnonzero((tone[:-1] < 0) & (tone[1:] >= 0))
    crossings = times[up] - tone[up] * (times[1] - times[0]) / (tone[up + 1] - tone[up])
    return float(2 * truth.length_m / np.mean(np.diff(crossings)) / c - 1)


def sample(times, pressures):
    """What perfect sensors would record: t [s], valve-end gauge pressure [bar], flow [L/min]."""
    t = np.arange(round(DURATION * RATE) + 1) / RATE
    p = (np.interp(t, times, pressures[:, 0]) - P_ATM) / BAR
    return t, p, valve_flow(t) / L_PER_MIN


def sense(p, q):
    """Add white noise and round to the steps of the converters."""
    rng = np.random.default_rng(SEED)
    p = p + SENSORS["pressure_noise_sd_bar"] * rng.standard_normal(p.size)
    q = q + SENSORS["flow_noise_sd_L_per_min"] * rng.standard_normal(q.size)
    p_step, q_step = SENSORS["pressure_step_bar"], SENSORS["flow_step_L_per_min"]
    return p_step * np.round(p / p_step), q_step * np.round(q / q_step)


def write(out, truth, t, p, q, noise_free):
    """Write the recording and the truth behind it; return the size of the recording in bytes."""
    form = "{:.2f},{:.8f},{:.8f}\n" if noise_free else "{:.2f},{:.4f},{:.5f}\n"
    rows = [form.format(*row) for row in zip(t, p + 0.0, q + 0.0, strict=True)]
    text = "t [s],p_line [bar_g],q_valve [L/min]\n" + "".join(rows)
    (out / "control-line.csv").write_text(text, encoding="utf-8", newline="\n")
    facts = {
        "description": "Synthetic: distributed line with entrained air (method of characteristics,"
        " gas cavities at the nodes), valve flow in at one end, laminar leak to a tank at"
        " atmospheric pressure at the other; pressure at the valve end, flow at line pressure.",
        "truth": asdict(truth),
        "reference_pressure_Pa_abs": P_ATM,
        "wall_modulus_Pa": truth.wall_modulus,
        "volume_m3": truth.area * truth.length_m,
        "sensors": SENSORS,
        "noise_free": noise_free,
        "sample_rate_Hz": RATE,
        "seed": SEED,
    }
    save_json(out / "control-line-truth.json", facts)
    return len(text)


def save_json(path, content):
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8", newline="\n")


def main():
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for the files written")
    parser.add_argument("--noise-free", action="store_true", help="sampled, but perfect sensors")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)

    truth = Truth()
    case = (truth, valve_flow, truth.initial_pressure_Pa_abs, DURATION)
    times, pressures, lengths = simulate(*case)
    t, p, q = sample(times, pressures)
    finer = sample(*simulate(*case, reaches=32)[:2])[1]
    recorded = (p, q) if args.noise_free else sense(p, q)
    size = write(args.out, truth, t, *recorded, args.noise_free)

    bases = (3.0, 10.0, 30.0, 100.0)
    waves = {f"{b:g} bar": wave_speed_error(truth, b * BAR) for b in bases}
    results = {
        "samples": t.size,
        "bytes": size,
        "lowest_and_highest_bar_gauge": [float(np.min(p)), float(np.max(p))],
        "lowest_recorded_bar_gauge": float(np.min(recorded[0])),
        "largest_pressure_difference_along_line_bar": float(np.max(np.ptp(pressures, axis=1)) / BAR),
        "mass_balance_error": mass_balance_error(truth, times, pressures, lengths),
        "wave_speed_error": waves,
        "change_with_twice_the_reaches_bar": float(np.max(np.abs(finer - p))),
    }
    checks = {
        "size": 1000 <= t.size <= 3000 and size < 200_000,
        "pressure stays above the atmosphere": results["lowest_recorded_bar_gauge"] > 0,
        "mass balance": results["mass_balance_error"] < 2e-4,
        "wave speed": max(map(abs, waves.values())) < 5e-3,
        "grid": results["change_with_twice_the_reaches_bar"] < 2e-3,
    }
    save_json(args.out / "results.json", results | {"checks": checks, "ok": all(checks.values())})
    print(json.dumps(results, indent=2))
    if not all(checks.values()):
        print("FAILED:", ", ".join(name for name, passed in checks.items() if not passed))
        return 1
    print(
        f"{t.size} samples, {np.min(p):.1f} to {np.max(p):.1f} bar gauge; mass balance within"
        f" {results['mass_balance_error']:.1e}, wave speed within"
        f" {max(map(abs, waves.values())):.1e} of sqrt(K_eff/rho)"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
