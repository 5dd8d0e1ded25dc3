"""Study files: quantities arrive in SI, and every mistake is one line that names file, place and remedy."""

import dataclasses
import typing

import numpy as np
import pytest
from studies import write_study

from jaxlines import FlowSource, Line, Pipe, PressureSensor, PressureSource, Sine, Step, Vessel
from jaxlines.edge.building import StudyError, _public_classes
from jaxlines.edge.study import load_study
from jaxlines.inference.distributions import Normal, Truncated
from jaxlines.inference.noise import Noise
from jaxlines.inference.parameters import Free, Known
from jaxlines.inference.priors import Prior
from jaxlines.physics.component import AbstractComponent
from jaxlines.physics.containers import AbstractContainer
from jaxlines.physics.fields import AbstractSignal, family_of
from jaxlines.physics.fluids import Oil
from jaxlines.physics.sensors import AbstractSensor
from jaxlines.simulation.signals import Sampled

STUDIED = (AbstractComponent, AbstractContainer, AbstractSignal, AbstractSensor, Oil)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return load_study(write_study(tmp_path_factory.mktemp("study")))


def test_circuit_in_si(study):
    line = study.circuit.components["line"]
    assert isinstance(line, Line)
    assert isinstance(line.parts[0], Pipe)
    assert isinstance(line.parts[1], Vessel)
    assert float(line.parts[0].inner_diameter) == pytest.approx(0.04285)
    assert float(line.parts[0].poissons_ratio) == 0.25
    assert float(line.parts[1].volume) == pytest.approx(5e-4)
    assert float(line.path_length) == pytest.approx(20.83)
    assert float(study.circuit["fluid.air_fraction"]) == pytest.approx(0.005)
    assert float(study.circuit["fluid.bulk_modulus"]) == pytest.approx(1.5e9)
    assert float(study.circuit["leak.conductance"]) == pytest.approx(1e-15)
    assert isinstance(study.circuit.components["valve"], FlowSource)
    assert isinstance(study.circuit.components["gauge"], PressureSensor)
    assert list(study.circuit.external_inputs()) == ["flow"]


def test_recording_initial_values_and_noise(study):
    assert study.title == "Control line, bench test"
    assert study.initial == {"A.pressure": pytest.approx(2e5 + 101325.0)}
    assert study.noise == {"A.pressure": pytest.approx(1e4)}
    assert study.recording.channels["A.pressure"][0] == pytest.approx(3e5, rel=0.2)
    assert study.recording.channels["flow"][100] == pytest.approx(1e-4, rel=1e-3)
    assert study.recording.warnings == ()


def test_free_and_known(study):
    assert study.free == (
        Free("fluid.bulk_modulus", (0.6e9, 2.5e9), 2.2e9, "log"),
        Free("initial.A.pressure", (1e5, 5e5), 2e5 + 101325.0),  # from [initial]
    )
    assert study.known == (Known("line.parts.0.length", 0.05),)
    assert study.fit_options == {"derived": ["line.effective_bulk_modulus"], "starts": 1, "seed": 0}


@pytest.mark.parametrize(
    ("change", "starts"),
    [
        (('start = "2.2 GPa"\n', ""), (1.5e9, 301325.0)),
        (('"2 bar_g"', '"measured"'), (2.2e9, None)),
        (('["1 bar_a", "5 bar_a"]', '["1 bar_a", "2 bar_a"]'), (2.2e9, None)),
    ],
)
def test_search_starts_at_the_numbers_of_the_file_where_they_lie_inside_the_bounds(tmp_path, change, starts):
    assert tuple(f.start for f in load_study(write_study(tmp_path, change)).free) == starts


FREE_MODULUS = 'path = "fluid.bulk_modulus"\n'


def test_several_recordings_with_conditions(tmp_path):
    file = 'file = "line.csv"'
    study = load_study(_with_runs(tmp_path, file))
    assert [r.name for r in study.recordings] == ["cold", "warm"] and study.recording is study.recordings[0]
    assert study.recordings[1].conditions["line.parts.1.volume"] == pytest.approx(2e-4)
    assert study.recordings[0].conditions["fluid.bulk_modulus"] == pytest.approx(1.4e9)
    files = load_study(write_study(tmp_path, (file, 'files = ["line.csv", "more.csv"]')))
    assert [r.name for r in files.recordings] == ["line.csv", "more.csv"]


def _with_runs(tmp_path, file: str):
    """The study with a table of conditions of two recordings."""
    path = write_study(tmp_path, (file, 'conditions = "runs.csv"'))
    (tmp_path / "more.csv").write_text((tmp_path / "line.csv").read_text())
    rows = "name,file,line.parts.1.volume [L],fluid.bulk_modulus [GPa]\ncold,line.csv,0.5,1.4\nwarm,more.csv,0.2,\n"
    (tmp_path / "runs.csv").write_text(rows)
    return path


def test_priors_ratios_local_parameters_and_losses(tmp_path):
    prior = 'prior = { normal = { mean = "1.4 GPa", sd = "0.1 GPa" }, low = "1 GPa" }\nlocal = true\nratios = [1]\n'
    options = (
        '[fit]\nloss = "student"\nloss_scale = 3.0\nsampling = "latin"\nsteady = true\ncheck = false\nwindows = 5\n'
    )
    inputs = '[fit.input_noise]\nflow = { white = "0.1 L/min", gain = "0.5 %" }\n'
    noise = (
        'noise = { "A.pressure" = "0.1 bar" }',
        'noise."A.pressure" = { absolute = "0.1 bar", relative = "estimated" }',
    )
    changes = (
        (FREE_MODULUS, FREE_MODULUS + prior),
        ("[fit]\n", options),
        ("[simulate]\n", inputs + "[simulate]\n"),
        noise,
    )
    study = load_study(write_study(tmp_path, *changes))
    free = study.free[0]
    assert free.prior == Prior(Truncated(Normal(1.4e9, 1e8), low=1e9))
    assert free.bounds == (1e9, 2.5e9) and free.local and free.ratios == (1.0,)
    noise = study.noise["A.pressure"]
    assert isinstance(noise, Noise) and noise.relative is None and noise.absolute == pytest.approx(1e4)
    assert study.steady
    options = study.fit_options
    assert (options["loss"], options["loss_scale"], options["sampling"]) == ("student", 3.0, "latin")
    assert options["check"] is False and options["windows"] == 5
    assert options["input_noise"]["flow"].white == pytest.approx(0.1 / 6e4)
    assert options["input_noise"]["flow"].gain == pytest.approx(0.005)


def test_delay_and_offset_of_a_recorded_input_are_free(tmp_path):
    bounds = (
        'path = "initial.A.pressure"\nbounds = ["1 bar_a", "5 bar_a"]',
        'path = "flow.delay"\nbounds = ["0 s", "50 ms"]',
    )
    assert load_study(write_study(tmp_path, bounds)).free[1] == Free("flow.delay", (0.0, 0.05))
    offset = (bounds[0], 'path = "flow.offset"\nbounds = ["-1 L/min", "1 L/min"]')
    assert load_study(write_study(tmp_path, offset)).free[1].bounds == pytest.approx((-1 / 6e4, 1 / 6e4))


@pytest.mark.slow
def test_a_study_of_two_recordings_fits_them_together(tmp_path):
    changes = (
        ('file = "line.csv"', 'files = ["line.csv", "more.csv"]'),
        ('path = "initial.A.pressure"', 'path = "initial.A.pressure"\nlocal = true'),
    )
    path = write_study(tmp_path, *changes)
    (tmp_path / "more.csv").write_text((tmp_path / "line.csv").read_text())
    fit = load_study(path).fit(checkpoint=tmp_path / "fit.json")
    assert list(fit.channels) == ["A.pressure [line.csv]", "A.pressure [more.csv]"]
    one, two = (fit.parameters[f"initial.A.pressure [{name}]"].value for name in ("line.csv", "more.csv"))
    assert one == pytest.approx(two, rel=1e-6) and (tmp_path / "fit.json").is_file()


def test_window_of_the_recording(tmp_path):
    file = 'file = "line.csv"'
    study = load_study(write_study(tmp_path, (file, f'{file}\nwindow = ["500 ms", "1 s"]')))
    assert study.recording is not None
    assert (study.recording.times[0], study.recording.times[-1]) == pytest.approx((0.5, 1.0))
    with pytest.raises(StudyError, match=r"recording.window: 0 samples lie between 10 s and 20 s"):
        load_study(write_study(tmp_path, (file, f'{file}\nwindow = ["10 s", "20 s"]')))


def test_simulate_table(study):
    np.testing.assert_allclose(study.times, np.linspace(0.0, 2.0, 50))
    flow = study.inputs["flow"]
    assert isinstance(flow, Step)
    assert (float(flow.before), float(flow.after), float(flow.time)) == pytest.approx((0.0, 10 / 6e4, 0.5))
    assert study.outputs == ("A.pressure", "gauge")


def test_atmosphere_of_the_fluid_counts_for_gauge_pressures(tmp_path):
    change = ('air_fraction = "0.5 %"', 'atmospheric_pressure = "0.9 bar_a"')
    study = load_study(write_study(tmp_path, change))
    assert study.initial["A.pressure"] == pytest.approx(2.9e5)
    plain = load_study(write_study(tmp_path))
    assert plain.recording is not None
    assert study.recording is not None
    shift = plain.recording.channels["A.pressure"] - study.recording.channels["A.pressure"]
    np.testing.assert_allclose(shift, 101325.0 - 0.9e5)


def test_channel_of_a_gauge_sensor_stays_gauge(tmp_path, study):
    swap = ('channels = { "A.pressure" = "p_line', 'channels = { "gauge" = "p_line')
    sensor = load_study(write_study(tmp_path, swap, ('noise = { "A.pressure" = "0.1 bar" }', ""))).recording
    assert sensor is not None
    np.testing.assert_allclose(study.recording.channels["A.pressure"] - sensor.channels["gauge"], 101325.0)


def test_dotted_keys_without_quotes_sines_amplitudes_and_measured_start(tmp_path):
    text = 'flow = { step = { before = "0 L/min", after = "10 L/min", time = "500 ms" } }'
    sine = 'flow = { sine = { mean = "3 L/min", amplitude = "6 L/min", frequency = "2 Hz", phase = "90 deg" } }'
    changes = ((text, sine), ('"A.pressure" = "2 bar_g"\n', 'A.pressure = "measured"\n'))
    study = load_study(write_study(tmp_path, *changes))
    assert float(study.inputs["flow"].amplitude) == pytest.approx(1e-4)
    assert float(study.inputs["flow"].phase) == pytest.approx(np.pi / 2)
    assert study.initial == {"A.pressure": "measured"}
    pressure = ('[circuit.reservoir]\ntype = "Tank"', '[circuit.reservoir]\ntype = "PressureSource"\n'
                'pressure = { sine = { mean = "2 bar_g", amplitude = "1 bar", frequency = "1 Hz" } }')  # fmt: skip
    source = load_study(write_study(tmp_path, pressure)).circuit.components["reservoir"]
    assert isinstance(source, PressureSource)
    assert isinstance(source.pressure, Sine)
    assert (float(source.pressure.mean), float(source.pressure.amplitude)) == pytest.approx((301325.0, 1e5))


def test_every_public_class_can_stand_in_a_study():
    """Each field is a number, a node, a text, a flag, a count or containers: nothing that a table cannot say."""
    open_fields = []
    for kind in _public_classes():
        hints = typing.get_type_hints(kind)
        for field in dataclasses.fields(kind) if dataclasses.is_dataclass(kind) else ():
            hint = hints[field.name]
            simple = {hint, *typing.get_args(hint)} & {str, bool, int}
            plain = simple or family_of(hint) or {"unit", "port"} & set(field.metadata)
            if issubclass(kind, STUDIED) and not plain and not issubclass(kind, Sampled):
                open_fields.append(f"{kind.__name__}.{field.name}: {hint}")
    assert not open_fields


PIPE = 'type = "Pipe", length = "20.83 m"'
MISTAKES = [
    ((PIPE, 'type = "Pipe", lenght = "20.83 m"'), "circuit.line.parts.0: unknown key 'lenght', did you mean 'length'?"),
    ((PIPE, 'type = "Pipe"'), "circuit.line.parts.0: 'length' is missing (Pipe)"),
    ((PIPE, 'type = "Pip", length = "20.83 m"'), "circuit.line.parts.0: unknown type 'Pip', did you mean 'Pipe'?"),
    ((PIPE, 'length = "20.83 m"'), "circuit.line.parts.0: 'type' is missing; known: "),
    ((PIPE, 'type = "Pipe", length = 20.83'), "circuit.line.parts.0.length: 20.83 has no unit: write it as a text"),
    ((PIPE, 'type = "Pipe", length = "20,83 m"'), "circuit.line.parts.0.length: '20,83 m' is no number with a unit"),
    ((PIPE, 'type = "Pipe", length = "20.83 kg"'), "parts.0.length: unit 'kg' does not measure what is asked for"),
    (("60.32 mm", "60.32 m"), "circuit.line.parts.0: outer_diameter must be 0.0001..25 m, got 60.32 m: was it"),
    (("60.32 mm", "40 mm"), "circuit.line.parts.0: outer_diameter must be larger than inner_diameter"),
    (('type = "LaminarLeak"', 'type = "Leak"'), "circuit.leak: unknown type 'Leak', "),
    (('a = "A"\n', ""), "circuit.leak: 'a' is missing (LaminarLeak)"),
    (('a = "A"', "a = 3"), "circuit.leak.a: expected the name of a node, got 3"),
    (('{ input = "flow" }', '{ inputt = "flow" }'), "circuit.valve.flow: expected a number, { input = "),
    (('{ input = "flow" }', '{ step = { before = "0 L/min" } }'), "circuit.valve.flow.step: 'after' is missing (Step)"),
    (('{ input = "flow" }', "{ input = 3 }"), "circuit.valve.flow.input: expected the name of an input, got 3"),
    (('reference = "gauge"', 'reference = "guage"'), 'circuit.gauge: reference must be "absolute" or "gauge"'),
    (('[circuit.reservoir]', '[circuit.tank]'), "circuit: 'tank' is both a node and a component"),
    (('type = "FlowSource"\nnode = "A"', 'type = "FlowSource"\nnode = "B"'), "circuit: hydraulic node 'B' has no cap"),
    (('density = "850 kg/m^3"\n', ""), "fluid: 'density' is missing (Oil)"),
    (('"1.5 GPa"', '"1.5 GPa_a"'), "fluid.bulk_modulus: unit 'GPa_a': this is a difference or a stiffness"),
    (('"1.5 GPa"', '"1.5 MPa"'), "fluid: bulk_modulus must be 1e+08..1e+11 Pa, got 1.5e+06 Pa"),
    (('air_fraction = "0.5 %"', 'atmospheric_pressure = "1 bar_g"'), "fluid.atmospheric_pressure: '1 bar_g' must be"),
    (('"2 bar_g"', '"2 bar"'), "initial.A.pressure: 'bar' does not say from where it counts: write bar_a"),
    (('"A.pressure" = "2 bar_g"', '"B.pressure" = "2 bar_g"'), "initial: no state is called 'B.pressure', did"),
    (('"A.pressure" = "2 bar_g"', '"A.pressure" = "2 bar_g"\n"tank.pressure" = "1 bar_a"'), "initial: no state is"),
    (('file = "line.csv"', 'file = "lin.csv"'), "lin.csv: no such file"),
    (('file = "line.csv"\n', ""), "recording: 'file' is missing"),
    (('file = "line.csv"', "file = 3"), "recording.file: input should be a valid string, got 3"),
    (('flow = "q_valve [L/min]" }', 'flow = "q_valve [bar_g]" }'), "no column 'q_valve [bar_g]'; the file has"),
    (('"q_valve [L/min]" }', '["q_valve [L/min]", "bar_g"] }'), "unit 'bar_g' does not measure what is asked for"),
    (('flow = "q_valve', 'flo = "q_valve'), "no output or input is called 'flo', did you mean 'flow'?"),
    (('"0.1 bar"', '"0.1 bar_g"'), "noise.A.pressure: unit 'bar_g': this is a difference"),
    (('path = "fluid.bulk_modulus"', 'path = "fluid.bulk_modulos"'), "fit.free.0: no number is called 'fluid.bulk_m"),
    (('path = "initial.A.pressure"', 'path = "initial.C.pressure"'), "fit.free.1: no initial value is called 'C.pres"),
    (('bounds = ["0.6 GPa", "2.5 GPa"]\n', ""), "fit.free.0: 'bounds' is missing"),
    (('["0.6 GPa", "2.5 GPa"]', '["2.5 GPa", "0.6 GPa"]'), "fit.free.0 (numbers in Pa): fluid.bulk_modulus: bounds"),
    (('["0.6 GPa", "2.5 GPa"]', '["0.6 GPa"]'), "fit.free.0.bounds: list should have at least 2 items"),
    (('["1 bar_a", "5 bar_a"]', '["1 bar", "5 bar"]'), "fit.free.1.bounds: 'bar' does not say from where it counts"),
    (('start = "2.2 GPa"', 'start = "22 GPa"'), "fit.free.0 (numbers in Pa): fluid.bulk_modulus: start 2.2e+10 is out"),
    (('transform = "log"', 'transform = "ln"'), "fit.free.0.transform: input should be 'identity', 'log' or 'logit'"),
    (('file = "line.csv"', 'files = ["line.csv"]\nconditions = "no.csv"'), "recording.conditions: "),
    (('file = "line.csv"', 'file = "line.csv"\nfiles = ["a.csv"]'), "recording: give `file` or `files`, not both"),
    ((FREE_MODULUS, FREE_MODULUS + "prior = { gauss = {} }\n"), "fit.free.0.prior: expected one of normal, log_normal"),
    ((FREE_MODULUS, FREE_MODULUS + "prior = { normal = { mean = 3 } }\n"), "prior.normal: it needs mean and sd, got"),
    ((FREE_MODULUS, FREE_MODULUS + "ratios = [1, 2]\n"), "ratios must be one finite number other than 0 for each of"),
    (("[fit]\n", '[fit]\nloss = "hubert"\n'), "fit.loss: input should be 'gauss', 'huber' or 'student'"),
    (("[fit]\n", '[fit]\ninput_noise = { flo = "1 L/min" }\n'), "fit.input_noise: no input is called 'flo'"),
    (('path = "fluid.bulk_modulus"', 'path = ["fluid.bulk_modulus", "fluid.density"]'), "have different units"),
    (('sd = "0.05 m"', 'sd = "-5 cm"'), "fit.known.0: line.parts.0.length: the standard uncertainty must be positive"),
    (("[fit]\n", "[fit]\nstart = 3\n"), "fit: unknown key 'start', did you mean 'starts'?"),
    (("[fit]\n", "[fit]\nstarts = 0\n"), "fit.starts: input should be greater than or equal to 1, got 0"),
    (('stop = "2 s"', 'stop = "-2 s"'), "simulate: stop must be after start, got 0 s and -2 s"),
    (('stop = "2 s"', 'stop = "2 m"'), "simulate.stop: unit 'm' does not measure what is asked for"),
    (('"gauge"]', '"gage"]'), "simulate.outputs: no output is called 'gage', did you mean 'gauge'?"),
    (("flow = { step", "flwo = { step"), "simulate.inputs: no input is called 'flwo', did you mean 'flow'?"),
    (('"10 L/min"', '"10 bar"'), "simulate.inputs.flow.step.after: unit 'bar' does not measure"),
    (("[simulate]", "[simulat]"), "unknown key 'simulat', did you mean 'simulate'?"),
    (("[fluid]", "[fluid"), "not valid TOML: "),
]  # fmt: skip


def test_byte_order_mark_of_an_editor_is_let_pass(tmp_path):
    path = write_study(tmp_path)
    path.write_text(path.read_text(encoding="utf-8"), encoding="utf-8-sig")
    assert load_study(path).title == "Control line, bench test"


@pytest.mark.parametrize(("change", "message"), MISTAKES, ids=[message[:50] for _, message in MISTAKES])
def test_mistakes_are_one_line_with_place_and_remedy(tmp_path, change, message):
    path = write_study(tmp_path, change)
    with pytest.raises(StudyError) as caught:
        load_study(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert message in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("source", "message"),
    [("nowhere/study.toml", "nowhere/study.toml: no such file"), ("example:none", "example:none: no such example")],
)
def test_studies_that_are_not_there(source, message):
    with pytest.raises(StudyError, match=message):
        load_study(source)


def test_a_folder_is_no_study(tmp_path):
    with pytest.raises(StudyError, match="is a folder"):
        load_study(tmp_path)


def test_nothing_to_fit_or_to_simulate(tmp_path):
    path = write_study(tmp_path)
    text = path.read_text()
    path.write_text(text[: text.index("[recording]")])
    study = load_study(path)
    with pytest.raises(StudyError, match=r"add a table \[recording\]"):
        study.fit()
    with pytest.raises(StudyError, match=r"add a table \[simulate\]"):
        study.simulate()
