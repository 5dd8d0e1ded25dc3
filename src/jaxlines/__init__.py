"""Differentiable simulation of lumped hydraulic lines, and physical parameters from recorded pressure."""

import ast
import functools
import importlib
import importlib.metadata
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the public names; each is imported when it is first used (see __getattr__)
    from jaxlines.edge.building import StudyError as StudyError
    from jaxlines.edge.circuit_text import circuit_from_toml as circuit_from_toml, circuit_to_toml as circuit_to_toml
    from jaxlines.edge.design_plots import (
        plot_design_gain as plot_design_gain,
        plot_design_input as plot_design_input,
        plot_design_output as plot_design_output,
    )
    from jaxlines.edge.drawing import circuit_svg as circuit_svg
    from jaxlines.edge.experiment_tables import (
        read_conditions as read_conditions,
        read_measurements as read_measurements,
        read_recordings as read_recordings,
        write_conditions as write_conditions,
        write_measurements as write_measurements,
    )
    from jaxlines.edge.plots import (
        plot_bulk_modulus as plot_bulk_modulus,
        plot_channel as plot_channel,
        plot_directions as plot_directions,
        plot_line_response as plot_line_response,
        plot_posterior as plot_posterior,
        plot_profile as plot_profile,
        plot_residuals as plot_residuals,
        plot_starts as plot_starts,
        plot_wave_speed as plot_wave_speed,
    )
    from jaxlines.edge.reading import read_recording as read_recording
    from jaxlines.edge.resampling import resample as resample
    from jaxlines.edge.study import Study as Study, load_study as load_study
    from jaxlines.edge.sweep_plots import (
        plot_band as plot_band,
        plot_ensemble as plot_ensemble,
        plot_histogram as plot_histogram,
        plot_scatter as plot_scatter,
        plot_sensitivity as plot_sensitivity,
    )
    from jaxlines.edge.units import si as si
    from jaxlines.inference.batch import BatchFit as BatchFit, fit_batch as fit_batch
    from jaxlines.inference.budget import Source as Source, measurement_budget as measurement_budget
    from jaxlines.inference.circuit_sweep import circuit_plan as circuit_plan, sweep as sweep
    from jaxlines.inference.comparison import compare as compare
    from jaxlines.inference.design import design as design
    from jaxlines.inference.design_inputs import Knots as Knots, Multisine as Multisine, Scaled as Scaled
    from jaxlines.inference.design_result import Design as Design
    from jaxlines.inference.design_target import Prediction as Prediction
    from jaxlines.inference.distributions import (
        Discrete as Discrete,
        LogNormal as LogNormal,
        LogUniform as LogUniform,
        Normal as Normal,
        Triangular as Triangular,
        Truncated as Truncated,
        Uniform as Uniform,
    )
    from jaxlines.inference.fit import fit as fit
    from jaxlines.inference.fit_result import Fit as Fit
    from jaxlines.inference.identifiability import assess as assess, structure as structure
    from jaxlines.inference.input_noise import InputNoise as InputNoise
    from jaxlines.inference.least_squares import (
        FunctionProblem as FunctionProblem,
        LeastSquaresProblem as LeastSquaresProblem,
        multi_start as multi_start,
        solve as solve,
    )
    from jaxlines.inference.loss import Loss as Loss
    from jaxlines.inference.noise import Noise as Noise
    from jaxlines.inference.parameters import Free as Free, Known as Known
    from jaxlines.inference.posterior import sample_posterior as sample_posterior
    from jaxlines.inference.priors import Prior as Prior
    from jaxlines.inference.profiles import interval as interval, profile_curve as profile_curve
    from jaxlines.inference.recording import Recording as Recording
    from jaxlines.inference.recording_check import check_recording as check_recording
    from jaxlines.inference.robust_covariance import uncertainty_under_noise as uncertainty_under_noise
    from jaxlines.inference.samplers import (
        Grid as Grid,
        LatinHypercube as LatinHypercube,
        MonteCarlo as MonteCarlo,
        Morris as Morris,
        ShapleyEffects as ShapleyEffects,
        Sobol as Sobol,
        SobolIndices as SobolIndices,
    )
    from jaxlines.inference.shooting_function import (
        FunctionWindows as FunctionWindows,
        WindowsSolution as WindowsSolution,
        solve_windows as solve_windows,
    )
    from jaxlines.inference.sweep import run_sweep as run_sweep
    from jaxlines.inference.sweep_result import SweepResult as SweepResult
    from jaxlines.inference.traced import as_function as as_function
    from jaxlines.inference.uncertain import (
        Draws as Draws,
        JointNormal as JointNormal,
        Uncertain as Uncertain,
        from_fit as from_fit,
    )
    from jaxlines.physics.accumulators import Accumulator as Accumulator, NitrogenAccumulator as NitrogenAccumulator
    from jaxlines.physics.air import (
        DissolvingAir as DissolvingAir,
        FreeAir as FreeAir,
        KineticAir as KineticAir,
        LegacySimscapeAir as LegacySimscapeAir,
    )
    from jaxlines.physics.containers import (
        Hose as Hose,
        Pipe as Pipe,
        Vessel as Vessel,
        ViscoelasticHose as ViscoelasticHose,
    )
    from jaxlines.physics.controllers import (
        PIController as PIController,
        PIDController as PIDController,
        SampledController as SampledController,
    )
    from jaxlines.physics.cylinders import (
        DoubleRodCylinder as DoubleRodCylinder,
        RotaryActuator as RotaryActuator,
        SingleRodCylinder as SingleRodCylinder,
    )
    from jaxlines.physics.fluids import Oil as Oil
    from jaxlines.physics.friction import (
        ChurchillFriction as ChurchillFriction,
        HaalandFriction as HaalandFriction,
        LaminarFriction as LaminarFriction,
    )
    from jaxlines.physics.lines import FluidInertia as FluidInertia, Line as Line
    from jaxlines.physics.liquids import DowsonHigginson as DowsonHigginson, Murnaghan as Murnaghan, Tait as Tait
    from jaxlines.physics.machine_losses import WilsonLosses as WilsonLosses
    from jaxlines.physics.mechanics import (
        Angle as Angle,
        Damper as Damper,
        Force as Force,
        Mass as Mass,
        Position as Position,
        RotaryDamper as RotaryDamper,
        RotaryFriction as RotaryFriction,
        RotarySpring as RotarySpring,
        SlidingFriction as SlidingFriction,
        Spring as Spring,
    )
    from jaxlines.physics.motors import (
        BentAxisMotor as BentAxisMotor,
        Brake as Brake,
        Inertia as Inertia,
        LoadTorque as LoadTorque,
        Motor as Motor,
        Supercharge as Supercharge,
    )
    from jaxlines.physics.nitrogen import IdealGas as IdealGas, Nitrogen as Nitrogen
    from jaxlines.physics.pressure_valves import (
        CheckValve as CheckValve,
        CounterbalanceValve as CounterbalanceValve,
        ReducingValve as ReducingValve,
        ReliefValve as ReliefValve,
    )
    from jaxlines.physics.pumps import PressureCompensatedPump as PressureCompensatedPump, Pump as Pump
    from jaxlines.physics.resistances import (
        AnnularLeak as AnnularLeak,
        LaminarLeak as LaminarLeak,
        MinorLoss as MinorLoss,
        Orifice as Orifice,
    )
    from jaxlines.physics.sensors import (
        AngleSensor as AngleSensor,
        DifferentialPressureSensor as DifferentialPressureSensor,
        FlowSensor as FlowSensor,
        LevelSensor as LevelSensor,
        PositionSensor as PositionSensor,
        PressureSensor as PressureSensor,
        SpeedSensor as SpeedSensor,
        StateSensor as StateSensor,
        VelocitySensor as VelocitySensor,
    )
    from jaxlines.physics.servovalve import Servovalve as Servovalve
    from jaxlines.physics.solubility import (
        HenrySolubility as HenrySolubility,
        LinearSolubility as LinearSolubility,
        PolynomialSolubility as PolynomialSolubility,
    )
    from jaxlines.physics.sources import FlowSource as FlowSource, PressureSource as PressureSource, Tank as Tank
    from jaxlines.physics.stops import (
        Backlash as Backlash,
        EndStop as EndStop,
        Gear as Gear,
        RotaryBacklash as RotaryBacklash,
        RotaryEndStop as RotaryEndStop,
    )
    from jaxlines.physics.tables import CurveValve as CurveValve, TableValve as TableValve
    from jaxlines.physics.tanks import OpenTank as OpenTank, SurgeShaft as SurgeShaft
    from jaxlines.physics.valves import ProportionalValve43 as ProportionalValve43, Valve22 as Valve22
    from jaxlines.physics.viscosity import ConstantViscosity as ConstantViscosity, Vogel as Vogel, Walther as Walther
    from jaxlines.physics.weighting import (
        JohnstonWeights as JohnstonWeights,
        KagawaWeights as KagawaWeights,
        SchohlWeights as SchohlWeights,
        TrikhaWeights as TrikhaWeights,
        VitkovskyTurbulentWeights as VitkovskyTurbulentWeights,
        VitkovskyWeights as VitkovskyWeights,
    )
    from jaxlines.simulation.audit import audit as audit
    from jaxlines.simulation.circuit import Circuit as Circuit
    from jaxlines.simulation.ensemble import EnsembleProgram as EnsembleProgram
    from jaxlines.simulation.ensemble_derivatives import (
        EnsembleGradient as EnsembleGradient,
        EnsembleJacobian as EnsembleJacobian,
        ensemble_gradient as ensemble_gradient,
        ensemble_jacobian as ensemble_jacobian,
    )
    from jaxlines.simulation.ensemble_pilot import ensemble as ensemble, prepare_ensemble as prepare_ensemble
    from jaxlines.simulation.ensemble_result import Ensemble as Ensemble
    from jaxlines.simulation.integration import implicit as implicit
    from jaxlines.simulation.line_response import line_response as line_response
    from jaxlines.simulation.linear import linearise as linearise
    from jaxlines.simulation.program_cache import cache_programs as cache_programs
    from jaxlines.simulation.reductions import (
        Crossing as Crossing,
        Custom as Custom,
        Final as Final,
        Peak as Peak,
        RootMeanSquare as RootMeanSquare,
        TimeMean as TimeMean,
        TimeOfPeak as TimeOfPeak,
        TimeQuantile as TimeQuantile,
        Trough as Trough,
    )
    from jaxlines.simulation.segments import choose_segments as choose_segments
    from jaxlines.simulation.signals import Constant as Constant, Sampled as Sampled, Sine as Sine, Step as Step
    from jaxlines.simulation.simulate import simulate as simulate
    from jaxlines.simulation.steady import steady_state as steady_state


@functools.cache
def _homes() -> dict[str, str]:
    """Public name -> the module it comes from, as the imports above say."""
    tree = ast.parse(Path(__file__).read_text(encoding="utf-8"))
    found = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and (n.module or "").startswith("jaxlines.")]
    return {alias.asname or alias.name: node.module or "" for node in found for alias in node.names}


def __getattr__(name: str):
    """Import a public name when it is first used, so that the command line can set up JAX before it loads."""
    if name == "__version__":
        return importlib.metadata.version("jaxlines")
    home = None if name.startswith("__") else _homes().get(name)
    if home is None:
        raise AttributeError(f"module 'jaxlines' has no attribute {name!r}")
    globals()[name] = getattr(importlib.import_module(home), name)
    return globals()[name]


def __dir__() -> list[str]:
    return sorted(["__version__", *_homes()])
