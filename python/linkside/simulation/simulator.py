"""Simulate a robot with its sensors and a controller in the loop."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from linkside import _core
from linkside.arguments import numbers, one_of, sized, whole
from linkside.arrays import FloatArray
from linkside.channels import CHANNELS
from linkside.control.controllers import Controller, State, law_of
from linkside.errors import EstimatorError
from linkside.files.tables import ArrowTable
from linkside.files.writing import writing
from linkside.kalman.elastic_joint import ElasticJointFilter
from linkside.observers.acceleration import AccelerationObserver
from linkside.recording.layout import as_columns
from linkside.recording.log import Log
from linkside.recording.motors import encoder_readings
from linkside.recording.writer import EstimateWriter
from linkside.robot import Robot
from linkside.robot.encoders import EncoderReading
from linkside.robot.requirements import refuse_unsupported
from linkside.robot.sensors import Lateness, ThreeAxes
from linkside.robot.wrenches import AXES, reading_noise

Truth: TypeAlias = dict[str, FloatArray]
FeedbackSource: TypeAlias = bool | tuple[_core.ElasticJointFilter, list[int]] | _core.AccelerationObserver
Feedback: TypeAlias = Literal["truth", "sensors"] | ElasticJointFilter | AccelerationObserver

SIGNALS = {channel.signal: channel for channel in CHANNELS.values() if not channel.drives}
"""What sensors measure, in the core's order."""

EXTRA = {channel.signal for channel in CHANNELS.values() if channel.extra}
"""Signals that few robots have."""


@dataclass(frozen=True)
class Sensor:
    """A model of a sensor: low-pass filter, then delay, bias, white noise, quantisation.

    Attributes
    ----------
    noise, bias, resolution
        In the unit of the reading; a resolution of 0 is none.
    delay
        Age of what is read [s].
    corner_frequency
        Of a low-pass of first order [Hz].
    every
        Number of samples for each reading; the others are NaN.
    """

    noise: float = 0.0
    bias: float = 0.0
    resolution: float = 0.0
    delay: float = 0.0
    corner_frequency: float = np.inf
    every: int = 1


@dataclass(frozen=True, eq=False, repr=False)
class Simulation:
    """A run: the recording and the truth.

    Attributes
    ----------
    log
        The recording: sensors, and motor torques, each held from its sample until the next.
    truth
        Columns ``t`` (T,), ``q``, ``dq``, ``ddq``, ``theta``, ``dtheta`` (T, n), ``tool`` (T, 3) if there is one, and
        ``push`` (T, n) where links were pushed, ``d_<joint>`` in files, ``wrench`` (T, 6k) where robot.yaml has
        wrenches that vary, ``<wrench>_fx`` to ``<wrench>_tz`` in files.
        Accelerations are those just before the torque changes.
    known
        The state that was fed back to the controller, (T, n) each.
    """

    robot: Robot
    log: Log
    truth: Truth
    known: State
    _table: dict[str, FloatArray]

    def write(self, folder: str | PathLike[str], *, suffix: Literal[".parquet", ".csv"] = ".parquet") -> None:
        """Write ``log`` and ``truth``, as `Log.read` and ``linkside compare`` read them; each whole or not at all.

        Raises
        ------
        OutputError
            When that cannot be.
        """
        columns = {"t": self.truth["t"]}
        for signal in ("q", "dq", "ddq", "theta", "dtheta"):
            columns |= {f"{signal}_{name}": self.truth[signal][:, j] for j, name in enumerate(self.robot.names)}
        if "push" in self.truth:
            columns |= {f"d_{name}": self.truth["push"][:, j] for j, name in enumerate(self.robot.names)}
        if "wrench" in self.truth:
            names = (column for wrench in self.robot.varying_wrenches for column in wrench.columns)
            columns |= dict(zip(names, self.truth["wrench"].T, strict=True))
        if "tool" in self.truth:
            columns |= {f"tool_{axis}": self.truth["tool"][:, i] for i, axis in enumerate("xyz")}
        with writing(Path(folder)):
            Path(folder).mkdir(parents=True, exist_ok=True)
        paths = (Path(folder) / f"{name}{suffix}" for name in ("log", "truth"))
        log, truth = map(EstimateWriter, paths)
        with log, truth:
            log.write(ArrowTable(pa.table(self._table), "simulation"))
            truth.write(ArrowTable(pa.table(columns), "simulation"))

    def __repr__(self) -> str:
        """Robot, log and truth in one line."""
        return f"Simulation({self.robot!r}, {self.log!r}, truth: {' '.join(self.truth)})"


def simulate(
    robot: Robot,
    controller: Controller,
    duration: float,
    rate: float,
    *,
    q: npt.ArrayLike | None = None,
    dq: npt.ArrayLike | None = None,
    theta: npt.ArrayLike | None = None,
    dtheta: npt.ArrayLike | None = None,
    tau: npt.ArrayLike | None = None,
    feedback: Feedback = "truth",
    sensors: Mapping[str, Sensor] | None = None,
    integrator: Literal["rk4", "adaptive"] = "rk4",
    substeps: int = 1,
    rtol: float | None = None,
    atol: float | None = None,
    keep_every: int = 1,
    seed: int = 0,
    push: npt.ArrayLike | None = None,
    wrench: npt.ArrayLike | None = None,
) -> Simulation:
    """Move a robot under a controller, from rest unless said otherwise.

    Both equations of the elastic-joint model are integrated, torques held between samples: springs and frictions as in
    robot.yaml, coupling included.

    Parameters
    ----------
    robot
        The robot.
    controller
        `controllers.JointPD`, `controllers.SimpleAdaptive`, or a function ``(t, state) -> tau``, with ``tau`` (n,).
    duration
        [s].
    rate
        Of sensors and controller [Hz].
    q, dq, theta, dtheta, tau : (n,)
        State and motor torques at the start. Not given: links at zero and at rest; motors where the springs hold
        gravity, as fast as their links; the torques that hold gravity.
    feedback
        What the controller knows of the robot: ``"truth"``, ``"sensors"`` (motors as measured, links assumed to be
        where the motors are), or the estimate of an `ElasticJointFilter` or `AccelerationObserver`, whose robot may
        have other parameters; it starts from the beginning, at the simulation's rate.
    sensors
        A `Sensor` of each kind: ``theta``, ``dtheta``, ``acceleration``, ``rate``, ``q``, ``torque``, ``dq``. A kind
        not given is as robot.yaml has it, or exact; link positions and velocities, and joint torques (what the
        transmission gives the link), are in the log only if given, or if robot.yaml has a ``link_encoder`` or
        ``joint_torque``.
    integrator
        ``"rk4"``, the fourth-order method of Runge and Kutta in fixed steps, the fastest where nothing is stiff;
        or ``"adaptive"``, RODAS (Hairer and Wanner, Solving Ordinary Differential Equations II, 1996, section VI.4),
        an L-stable method of order 4 with exact derivatives, whose steps follow the tolerance and not the stiffness,
        and end at every sample. A vibration smaller than the tolerance is damped instead of followed.
    substeps
        Steps of ``"rk4"`` between samples.
    rtol, atol
        Of ``"adaptive"``: a step may be wrong by ``atol + rtol |x|`` in each position and velocity; 1e-6 and 1e-9 if
        not given.
    keep_every
        Keep every n-th sample.
    seed
        Of the noise: the same seed gives the same bits.
    push : (n,) or (T, n)
        Torque on each link from outside [N m]: a contact, a payload or anything else that robot.yaml lacks. Constant,
        or given at each sample; between two samples their mean acts.
    wrench : (6k,) or (T, 6k)
        Values of the k wrenches of robot.yaml that vary, likewise: of each, force [N] and moment [N m] in its frame.
        None: zero. Those that are measured are in the log, with their sensors' noise.

    Raises
    ------
    EstimatorError
        A setting out of range, a fixed step too large for the stiffness (with the largest stable one), or a
        controller that raises, or gives something that is not n finite numbers.
    NumericalError
        The motion is no longer finite, or no adaptive step is short enough for the tolerance; names the time, and then
        the joint.
    """
    robot.require_masses("a simulation")
    refuse_unsupported(robot, "a simulation")
    models = _models(sensors or {}, robot)
    start = {"q": q, "dq": dq, "theta": theta, "dtheta": dtheta, "tau": tau}
    settings = {
        "count": _count(duration, rate),
        "period": 1.0 / rate,
        **_stepping(integrator, substeps, rtol, atol),
        "keep_every": whole("keep_every", keep_every, least=1),
        "seed": whole("seed", seed),
        **{name: None if value is None else sized(name, value, robot.n).tolist() for name, value in start.items()},
    }
    numbers_of = {"push": (push, robot.n), "wrench": (wrench, len(AXES) * len(robot.varying_wrenches))}
    for name, (path, width) in numbers_of.items():
        settings[name] = None if path is None else _path(name, path, width, settings["count"], settings["period"])
    channels = [dataclasses.asdict(channel) for kind in SIGNALS for channel in models[kind]]
    source = _feedback_source(feedback, robot, 1.0 / rate)
    result = _core.simulate(robot.core, settings, channels, source, law_of(controller, robot))
    lines = _lines(robot, settings["seed"])
    return _assemble(robot, result, lines, left_out=EXTRA - set(sensors or {}) - set(_declared(robot)))


def _path(name: str, path: npt.ArrayLike, n: int, count: int, period: float) -> dict[str, Any]:
    """What acts from outside, as the core takes a path in time."""
    values = numbers(name, path)
    if values.shape not in ((n,), (count, n)):
        raise EstimatorError(f"{name} has shape {values.shape}, expected ({n},) or ({count}, {n})")
    times = period * np.arange(count if values.ndim == 2 else 1)
    return {"times": times.tolist(), "values": values.ravel().tolist(), "width": n}


def _stepping(integrator: str, substeps: int, rtol: float | None, atol: float | None) -> dict[str, Any]:
    """Check how time is stepped, as the core takes it."""
    one_of("integrator", integrator, ("rk4", "adaptive"))
    count = whole("substeps", substeps, least=1)
    if integrator == "adaptive":
        if count > 1:
            raise EstimatorError(f"substeps is {count}, but the adaptive integrator takes its steps from rtol and atol")
        return {"substeps": count, "tolerance": (1e-6 if rtol is None else rtol, 1e-9 if atol is None else atol)}
    for name, value in (("rtol", rtol), ("atol", atol)):
        if value is not None:
            raise EstimatorError(f"{name} is {value!r}, but steps of 'rk4' are fixed; set integrator='adaptive'")
    return {"substeps": count, "tolerance": None}


Lines: TypeAlias = dict[str, dict[int, EncoderReading]]
"""By signal and joint: what encoders read."""


def _lines(robot: Robot, seed: int) -> Lines:
    """Encoders' lines with the phases of this run."""
    random = np.random.default_rng(seed)
    found: Lines = {"theta": {}, "q": {}}
    for j, drive in enumerate(robot.drives):
        unknown = {
            "theta": drive.encoder_error.unknown(drive.gear_ratio),
            "q": drive.link_encoder_error.unknown(1.0),
        }
        for signal, lines in unknown.items():
            if lines:
                found[signal][j] = EncoderReading(1.0, 0.0, [(*line, random.uniform(0, 2 * np.pi)) for line in lines])
    return found


def _assemble(robot: Robot, result: Truth, lines: Lines, *, left_out: set[str]) -> Simulation:
    widths = [SIGNALS[kind].width(robot) for kind in SIGNALS]
    readings = np.split(result.pop("readings"), np.cumsum(widths)[:-1], axis=1)
    signals = dict(zip(SIGNALS, readings, strict=True)) | {"tau": result.pop("tau")}
    for kind in left_out:
        del signals[kind]
    signals |= encoder_readings(signals, lines)
    table = as_columns(robot, {"t": result["t"], **signals}, "simulation")
    known = State(*np.split(result.pop("known"), 4, axis=1))
    return Simulation(robot, Log.from_table(table, robot, "simulation", check=False), result, known, table)


def _models(sensors: Mapping[str, Sensor], robot: Robot) -> dict[str, list[Sensor]]:
    """One model a channel, by kind."""
    if unknown := set(sensors) - set(SIGNALS):
        raise EstimatorError(f"sensors: {min(unknown)!r} is not one of {', '.join(map(repr, SIGNALS))}")
    models = {signal: [Sensor()] * channel.width(robot) for signal, channel in SIGNALS.items()} | _declared(robot)
    return models | {kind: [model] * SIGNALS[kind].width(robot) for kind, model in sensors.items()}


def _declared(robot: Robot) -> dict[str, list[Sensor]]:
    """Models of the sensors that robot.yaml describes, one a channel, by kind."""
    config, n = robot.config, robot.n
    declared = {"theta": [Sensor(resolution=config.encoder.resolution)] * n}
    on_links: dict[str, Sequence[ThreeAxes]] = {
        "acceleration": robot.accelerometers,
        "rate": robot.gyroscopes,
        "position": robot.trackers,
    }
    for signal, carriers in on_links.items():
        declared[signal] = [_late(s, noise=s.noise_std) for s in carriers for _ in s.axes]
    declared["wrench"] = [Sensor(noise=float(noise)) for noise in reading_noise(robot.varying_wrenches)]
    if config.link_encoder is not None:
        declared["q"] = [_late(config.link_encoder, resolution=config.link_encoder.resolution)] * n
    if config.joint_torque is not None:
        declared["torque"] = [_late(config.joint_torque, noise=config.joint_torque.noise_std)] * n
    return declared


def _late(inside: Lateness, *, noise: float = 0.0, resolution: float = 0.0) -> Sensor:
    corner = inside.corner_frequency or np.inf
    return Sensor(noise=noise, resolution=resolution, delay=inside.delay, corner_frequency=corner)


def _feedback_source(feedback: Feedback, robot: Robot, period: float) -> FeedbackSource:
    if isinstance(feedback, AccelerationObserver):
        _same_robot(feedback.robot, robot, "names", "acceleration_channels")
        return feedback.fresh(period)
    if not isinstance(feedback, ElasticJointFilter):
        if feedback not in ("truth", "sensors"):
            raise EstimatorError(
                f"feedback is {feedback!r}, expected 'truth', 'sensors', an ElasticJointFilter or AccelerationObserver"
            )
        return feedback == "truth"
    core, kinds = feedback.fresh(period)
    _same_robot(feedback.robot, robot, "names", "acceleration_channels", "gyroscope_channels")
    names = [kind for kind in SIGNALS for _ in range(SIGNALS[kind].width(robot))]
    wanted = {CHANNELS[kind].signal for kind in kinds}
    return core, [index for index, kind in enumerate(names) if kind in wanted]


def _same_robot(believed: Robot, robot: Robot, *aspects: str) -> None:
    for what in aspects:
        theirs, ours = getattr(believed, what), getattr(robot, what)
        if theirs != ours:
            raise EstimatorError(f"feedback is of another robot: its {what} are {theirs}, expected {ours}")


def _count(duration: float, rate: float) -> int:
    for name, value in (("duration", duration), ("rate", rate)):
        if not 0 < value < np.inf:
            raise EstimatorError(f"{name} is {value!r}, expected a finite number greater than 0")
    return round(duration * rate) + 1
